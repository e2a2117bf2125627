//! Square roots by the processor's instruction where it has one, else by `libm`.
//!
//! Both round correctly (IEEE 754), so results are the same to the bit on a board and on a host. No stable function of `core` reaches
//! the Cortex-M7's `vsqrt`; `libm` computes roots in software, in 220 bytes of code for an `f32` and 376 for an `f64`. Planning one
//! stepper path takes a root for each evaluation of the root search in `motion/scurve.rs`.

#[cfg(not(target_arch = "arm"))]
pub(crate) use libm::{sqrt, sqrtf};

/// Square root in `f64`; NaN for negative numbers.
#[cfg(target_arch = "arm")]
#[inline(always)]
#[allow(unsafe_code, reason = "one instruction between two registers, which touches nothing else")]
pub(crate) fn sqrt(number: f64) -> f64 {
    let root;
    // SAFETY: the instruction reads and writes only the two given registers, and flags that are not read.
    unsafe {
        core::arch::asm!("vsqrt.f64 {}, {}", lateout(dreg_low16) root, in(dreg_low16) number, options(pure, nomem, nostack))
    };
    root
}

/// Square root in `f32`; NaN for negative numbers.
#[cfg(target_arch = "arm")]
#[inline(always)]
#[allow(unsafe_code, reason = "one instruction between two registers, which touches nothing else")]
pub(crate) fn sqrtf(number: f32) -> f32 {
    let root;
    // SAFETY: as above.
    unsafe { core::arch::asm!("vsqrt.f32 {}, {}", lateout(sreg) root, in(sreg) number, options(pure, nomem, nostack)) };
    root
}
