//! Reads of flash that survive a bus error.
//!
//! A word of 256 bits with two wrong bits, as a power cut during programming may leave, sets DBECCERR and answers the
//! read with a bus error (RM0399, 4.3 "Error code correction"), which on a Cortex-M7 is a precise BusFault. With
//! FAULTMASK the execution priority is -1 (ARMv7-M Architecture Reference Manual, B1.4.3), and at a priority below 0
//! CCR.BFHFNMIGN makes the processor ignore data bus faults of loads instead of locking up (B3.2.8). The load then
//! returns an arbitrary value and execution continues. CFSR.PRECISERR or IMPRECISERR show the fault. A synchronisation
//! barrier before FAULTMASK is cleared makes a late error arrive inside.

use core::sync::atomic::{Ordering, compiler_fence};

use cortex_m::{asm, peripheral::SCB};

/// Bits of SCB.CCR and SCB.CFSR.
const BFHFNMIGN: u32 = 1 << 8;
const BUS_FAULTS: u32 = 0xFF << 8;
const PRECISERR: u32 = 1 << 9;
const IMPRECISERR: u32 = 1 << 10;

/// Runs `reads` with data bus faults ignored; returns its result, and true if there was a fault. Nothing else runs
/// meanwhile.
pub(crate) fn ignored<R>(reads: impl FnOnce() -> R) -> (R, bool) {
    #[allow(unsafe_code, reason = "survives a bus error")]
    // SAFETY: CCR and CFSR are only changed here, by code that nothing can interrupt.
    unsafe {
        let scb = &*SCB::PTR;
        core::arch::asm!("cpsid f", options(nostack, preserves_flags));
        compiler_fence(Ordering::SeqCst);
        scb.ccr.modify(|ccr| ccr | BFHFNMIGN);
        scb.cfsr.write(BUS_FAULTS);
        asm::dsb();
        asm::isb();
        let result = reads();
        asm::dsb();
        asm::isb();
        let faults = scb.cfsr.read();
        scb.cfsr.write(BUS_FAULTS);
        scb.ccr.modify(|ccr| ccr & !BFHFNMIGN);
        asm::dsb();
        asm::isb();
        compiler_fence(Ordering::SeqCst);
        core::arch::asm!("cpsie f", options(nostack, preserves_flags));
        (result, faults & (PRECISERR | IMPRECISERR) != 0)
    }
}
