//! Hooks: counting, stopping, and accesses to memory that is not mapped directly.

use r4_mcu::Size;
use r4_mcu::cpu::{Access, NoResult, Why};
use unicorn_engine::{HookType, MemType, Prot, RegisterARM, TlbEntry, TlbType, UcHookId, Unicorn, uc_error};

use crate::blocks::Block;
use crate::core::THUMB;
use crate::mapping::STUB;
use crate::state::{State, slice};

pub(crate) type Engine = Unicorn<'static, State>;

/// End of ITCM: its contents may be changed by any store, so blocks below are decoded each time.
pub(crate) const CACHED_FROM: u32 = 0x0001_0000;

/// Installs the hooks that apply to every address.
pub(crate) fn install(engine: &mut Engine) -> Result<(), uc_error> {
    // The range 1 > 0 means everywhere.
    engine.add_block_hook(1, 0, |engine, address, bytes| block(engine, address as u32, bytes))?;
    engine.ctl_set_tlb_type(TlbType::VIRTUAL)?;
    engine.add_tlb_hook(1, 0, translate)?;
    engine.add_intr_hook(|engine, number| {
        engine.get_data_mut().exception = Some(number);
        stop(engine);
    })?;
    Ok(())
}

/// Handles the first access to a page, or the first after a change of the mapping. Addresses map to themselves. Data
/// memory is reported as not executable, which makes stores several times faster: otherwise the translator searches for
/// translated code at each.
fn translate(engine: &mut Unicorn<'_, State>, address: u64, kind: MemType) -> Option<TlbEntry> {
    if kind == MemType::FETCH {
        return Some(TlbEntry { paddr: address, perms: Prot::ALL });
    }
    clear_it_state(engine);
    let code = !engine.get_data().code(address as u32, address as u32 + 1).is_empty();
    let perms = if code { Prot::ALL } else { Prot::READ | Prot::WRITE };
    Some(TlbEntry { paddr: address, perms })
}

/// Installs the hooks for accesses without permission, for these addresses only: within the range of such a hook,
/// Unicorn's translated code makes every store by a slow path.
pub(crate) fn install_access(engine: &mut Unicorn<'_, State>, base: u64, len: u64) -> Result<[UcHookId; 2], uc_error> {
    let last = base + len - 1;
    let load = engine.add_mem_hook(HookType::MEM_READ_PROT, base, last, |engine, _: MemType, address, bytes, _| {
        load(engine, address as u32, bytes as u32)
    })?;
    let store =
        engine.add_mem_hook(HookType::MEM_WRITE_PROT, base, last, |engine, _: MemType, address, bytes, value| {
            store(engine, address as u32, bytes as u32, value as u64);
            true
        })?;
    Ok([load, store])
}

/// Gets the limits from the bus again.
pub(crate) fn refresh_limits(engine: &mut Unicorn<'_, State>) {
    let limits = engine.get_data_mut().bus().limits();
    if limits.mask_changes {
        let masks = masks(engine);
        engine.get_data_mut().masks = masks;
    }
    engine.get_data_mut().limits = limits;
}

fn masks(engine: &Unicorn<'_, State>) -> [u32; 3] {
    // None of these reads can fail: the registers exist in the only processor that this crate creates.
    [RegisterARM::PRIMASK, RegisterARM::BASEPRI, RegisterARM::FAULTMASK]
        .map(|register| engine.reg_read(register).unwrap_or(0) as u32)
}

/// Ends the run as soon as Unicorn can: at the next block, or before the instruction of a code hook.
pub(crate) fn stop(engine: &mut Unicorn<'_, State>) {
    if let Err(error) = engine.emu_stop() {
        engine.get_data_mut().error.get_or_insert(crate::core::failed("stop", error));
    }
}

/// Handles the beginning of a block.
fn block(engine: &mut Unicorn<'_, State>, address: u32, bytes: u32) {
    if address == STUB {
        return;
    }
    let state = engine.get_data_mut();
    // The previous block was executed to its end.
    if state.block.releases {
        state.claimed = false;
    }
    let reached = state.executed >= state.limits.instructions;
    if state.limits.mask_changes {
        let before = state.masks;
        if masks(engine) != before {
            engine.get_data_mut().why = Some(Why::MaskChanged);
            return stop(engine);
        }
    }
    if reached && limit_stands(engine) {
        engine.get_data_mut().why = Some(Why::Limit);
        return stop(engine);
    }
    let state = engine.get_data_mut();
    let (cache, code) = (&mut state.cache, &state.code);
    let decode = || Block::decode(address, slice(code, address, address.wrapping_add(bytes)));
    let block = if address >= CACHED_FROM { *cache.get(address, bytes, decode) } else { decode() };
    if !state.fpu && block.float().is_some() && state.float_at != block.float() {
        state.float_at = block.float();
        state.why = Some(Why::Limit);
        return stop(engine);
    }
    state.block = block;
    state.executed += u64::from(block.instructions);
    state.claimed |= block.claims;
    if block.event {
        state.bus().event();
    }
}

/// Handles a reached limit: returns false if, after due events are handled, there is a new limit, which avoids stopping
/// and starting again.
#[cold]
fn limit_stands(engine: &mut Unicorn<'_, State>) -> bool {
    let executed = engine.get_data().executed;
    engine.get_data_mut().bus().reached(executed);
    refresh_limits(engine);
    let state = engine.get_data();
    state.executed >= state.limits.instructions
}

fn access(engine: &mut Unicorn<'_, State>, address: u32, size: Size) -> Access {
    // The permission hook has updated the register.
    let pc = engine.reg_read(RegisterARM::PC).unwrap_or(0) as u32;
    Access { address, size, pc, instructions: engine.get_data().instructions_before(pc) }
}

/// Clears the state of an IT block. To know the program counter, Unicorn has also restored that state, as if the
/// instruction were to be executed again. The translated block that continues has it within its code; left in the
/// processor, it would make the *next* block conditional.
fn clear_it_state(engine: &mut Unicorn<'_, State>) {
    // Cannot fail: the register exists.
    let _ = engine.reg_write(RegisterARM::EPSR, THUMB.into());
}

/// Size and number of the bus accesses of an access: a double word is two words.
fn parts(bytes: u32) -> (Size, u32) {
    match bytes {
        1 => (Size::Byte, 1),
        2 => (Size::Half, 1),
        4 => (Size::Word, 1),
        _ => (Size::Word, 2),
    }
}

/// Carries out a load without permission, and keeps the result for [`load_result`]. `false` abandons the instruction.
fn load(engine: &mut Unicorn<'_, State>, address: u32, bytes: u32) -> bool {
    let (size, count) = parts(bytes);
    // An unaligned load is repeated as two aligned ones, at the rounded address and after it.
    let base = address & !(bytes - 1);
    let mut window = [0; 16];
    for part in 0..count {
        let offset = part * 4;
        let access = access(engine, address.wrapping_add(offset), size);
        match engine.get_data_mut().bus().read(&access) {
            Ok(value) => {
                let at = access.address.wrapping_sub(base) as usize;
                window[at..at + size.bytes() as usize].copy_from_slice(&value.to_le_bytes()[..size.bytes() as usize]);
            }
            Err(NoResult) => return false,
        }
    }
    let state = engine.get_data_mut();
    state.window.base = base;
    state.window.bytes = window;
    refresh_limits(engine);
    clear_it_state(engine);
    true
}

/// Result of the load that was just carried out.
pub(crate) fn load_result(engine: &mut Unicorn<'_, State>, address: u32, bytes: u32) -> u64 {
    let window = &engine.get_data().window;
    let at = (address.wrapping_sub(window.base) as usize).min(8);
    let mut value = [0; 8];
    value[..bytes as usize].copy_from_slice(&window.bytes[at..at + bytes as usize]);
    u64::from_le_bytes(value)
}

/// Carries out a store without permission. Unicorn then continues with it to a place where it has no effect: read-only
/// memory, or the I/O callback.
fn store(engine: &mut Unicorn<'_, State>, address: u32, bytes: u32, value: u64) {
    let (from, to) = engine.get_data().window.repeated;
    if bytes == 1 && (from..to).contains(&address) {
        // A part of an unaligned store that was made already.
        return;
    }
    let (size, count) = parts(bytes);
    for part in 0..count {
        let access = access(engine, address.wrapping_add(part * 4), size);
        // No store is refused: this core has no memory protection (see `Core::protect`).
        let _ = engine.get_data_mut().bus().write(&access, (value >> (part * 32)) as u32);
    }
    let unaligned = address & (bytes - 1) != 0;
    engine.get_data_mut().window.repeated = if unaligned { (address, address.saturating_add(bytes)) } else { (0, 0) };
    refresh_limits(engine);
    clear_it_state(engine);
}
