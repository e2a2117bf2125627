//! Guards of two places that no code may access: address 0, and the end of the stack.
//!
//! Without them a null pointer reads and writes the instruction memory that lies at 0, and a stack overflow continues
//! into the data below the stack. The memory protection unit refuses both; the fault ends the run with a record
//! (`panic.rs`). MemManage stays disabled as an exception of its own, so that it becomes a HardFault, whose handler has
//! its own stack.

use cortex_m::{asm, peripheral::MPU};

/// Guard from address 0 on: large enough for a field of a structure at a null pointer. Code that is linked into ITCM
/// begins behind it.
const NULL: Region = Region { base: 0, size_exponent: 10 };

/// Size of the guard at the end of the stack, as a power of two: no function's frame is so large that it could step
/// over it without a touch (`cargo xtask size` lists the stack). It reduces the usable stack.
const STACK_EXPONENT: u32 = 10;
/// Size of the guard at the end of the stack, bytes.
pub(crate) const STACK_BYTES: usize = 1 << STACK_EXPONENT;

/// Region of memory without access.
struct Region {
    /// Start address, a multiple of the size.
    base: usize,
    /// Size as an exponent of 2, in bytes.
    size_exponent: u32,
}

impl Region {
    /// Value of RBAR with VALID and the region's number (ARMv7-M ARM, B3.5.8).
    fn base_register(&self, number: u32) -> u32 {
        self.base as u32 | 1 << 4 | number
    }

    /// Value of RASR: no access, no execution, strongly ordered so that there are no speculative reads (B3.5.9).
    fn attributes(&self) -> u32 {
        const EXECUTE_NEVER: u32 = 1 << 28;
        EXECUTE_NEVER | (self.size_exponent - 1) << 1 | 1
    }
}

/// Forbids both places from now on; everything else stays accessible as without the unit.
pub(crate) fn start(mpu: &mut MPU) {
    const ENABLE: u32 = 1;
    /// Outside the regions the default map holds.
    const DEFAULT_MAP: u32 = 1 << 2;
    #[allow(unsafe_code, reason = "a symbol of the linker's")]
    // SAFETY: only the address of the symbol is used.
    unsafe extern "C" {
        safe static _stack_end: u8;
    }
    let stack = Region { base: (&raw const _stack_end).addr(), size_exponent: STACK_EXPONENT };
    #[allow(unsafe_code, reason = "changes which memory can be reached")]
    // SAFETY: no reference leads into the two regions: Rust has none to address 0, and the stack does not reach its
    // end.
    unsafe {
        for (region, number) in [NULL, stack].iter().zip(0..) {
            mpu.rbar.write(region.base_register(number));
            mpu.rasr.write(region.attributes());
        }
        mpu.ctrl.write(ENABLE | DEFAULT_MAP);
    }
    asm::dsb();
    asm::isb();
}
