//! Address space: direct memory by pointer, everything else as I/O without permission.

use r4_mcu::{Bank, Region};
use unicorn_engine::{Prot, Unicorn, uc_error};

use crate::hooks::{install_access, load_result, refresh_limits};
use crate::state::State;

/// Address of a page of this crate's own, in an area that RM0399 leaves reserved: see [`CLREX`].
pub(crate) const STUB: u32 = 0x1F00_0000;

/// Code CLREX; WFI, which clears the exclusive monitor, to which Unicorn has no access.
pub(crate) const CLREX: [u8; 6] = [0xBF, 0xF3, 0x2F, 0x8F, 0x30, 0xBF];

const PAGE: u64 = 0x1000;

/// Maps the whole address space.
pub(crate) fn map_all(engine: &mut Unicorn<'static, State>, regions: &[Region]) -> Result<(), uc_error> {
    engine.mem_map(STUB.into(), PAGE, Prot::EXEC)?;
    engine.mem_write(STUB.into(), &CLREX)?;
    let mut used: Vec<(u64, u64)> = regions.iter().map(|region| span(region.bank)).collect();
    used.push((STUB.into(), PAGE));
    used.sort_unstable();
    let mut from = 0;
    for (base, len) in used.into_iter().chain([(1 << 32, 0)]) {
        if base > from {
            map_io(engine, from, base - from)?;
            install_access(engine, from, base - from)?;
        }
        from = base + len;
    }
    install_access(engine, STUB.into(), PAGE)?;
    for region in regions {
        map_region(engine, region)?;
    }
    Ok(())
}

/// Maps the regions again whose accesses have changed.
pub(crate) fn remap(engine: &mut Unicorn<'_, State>, regions: &[Region]) -> Result<(), uc_error> {
    for region in regions {
        let (base, len) = span(region.bank);
        let mapped_io = engine.mem_regions()?.iter().any(|mapped| mapped.begin == base && mapped.perms == Prot::NONE.0);
        if mapped_io == region.direct().read {
            engine.mem_unmap(base, len)?;
            map_region(engine, region)?;
        }
    }
    Ok(())
}

/// Returns true if this core executes from a region: ITCM and flash only, since stores to executable memory take
/// several times as long.
pub(crate) fn executes(region: &Region) -> bool {
    region.direct().execute && matches!(region.bank, Bank::Itcm | Bank::Flash1 | Bank::Flash2)
}

fn span(bank: Bank) -> (u64, u64) {
    let (base, len) = bank.span();
    (base.into(), len.into())
}

#[allow(unsafe_code, reason = "memory is mapped by pointer")]
fn map_region(engine: &mut Unicorn<'_, State>, region: &Region) -> Result<(), uc_error> {
    let (base, len) = span(region.bank);
    let direct = region.direct();
    for hook in engine.get_data_mut().access_hooks.remove(&base).into_iter().flatten() {
        engine.remove_hook(hook)?;
    }
    if !(direct.read && direct.write) {
        let hooks = install_access(engine, base, len)?;
        engine.get_data_mut().access_hooks.insert(base, hooks);
    }
    if !direct.read {
        return map_io(engine, base, len);
    }
    let mut prot = Prot::READ;
    if direct.write {
        prot |= Prot::WRITE;
    }
    if executes(region) {
        prot |= Prot::EXEC;
    }
    // SAFETY: the bytes are cells, so that they may change behind shared references; `UnicornCore` keeps a reference to
    // them for as long as the engine lives, and the length is theirs.
    unsafe { engine.mem_map_ptr(base, len, Prot::ALL, region.bytes().as_ptr().cast_mut().cast())? };
    // Permissions set afterwards also make the translator drop stores to read-only memory; given at once, they do not.
    engine.mem_protect(base, len, prot)
}

fn map_io(engine: &mut Unicorn<'_, State>, base: u64, len: u64) -> Result<(), uc_error> {
    let base32 = base as u32;
    engine.mmio_map(
        base,
        len,
        Some(move |engine: &mut Unicorn<'_, State>, offset: u64, bytes: usize| {
            let value = load_result(engine, base32.wrapping_add(offset as u32), bytes as u32);
            accessed(engine);
            value
        }),
        Some(|engine: &mut Unicorn<'_, State>, _: u64, _: usize, _: u64| accessed(engine)),
    )?;
    engine.mem_protect(base, len, Prot::NONE)
}

/// Handles memories that an access may have turned on or off. Not done in the permission hook, which Unicorn leaves
/// with pointers into data that mapping frees.
fn accessed(engine: &mut Unicorn<'_, State>) {
    let regions = engine.get_data_mut().bus().remapped();
    if let Some(regions) = regions {
        let regions = regions.to_vec();
        if let Err(error) = remap(engine, &regions) {
            engine.get_data_mut().error.get_or_insert(crate::core::failed("remap", error));
        }
        refresh_limits(engine);
    }
}
