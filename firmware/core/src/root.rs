//! Square roots.
//!
//! Rounded once, as the standard says, whoever computes them: the board's processor has an instruction, which no stable function of
//! `core` reaches, and `libm` takes 60 instructions for an `f32` and 110 for an `f64`. A new path of a stepper takes a dozen.

#[cfg(not(target_arch = "arm"))]
pub(crate) use libm::{sqrt, sqrtf};

/// Of a number that is not negative; NaN of others.
#[cfg(target_arch = "arm")]
#[inline(always)]
#[allow(unsafe_code, reason = "one instruction between two registers, which touches nothing else")]
pub(crate) fn sqrt(number: f64) -> f64 {
    let root;
    // SAFETY: it reads and writes the two registers it is given, and flags that nobody reads.
    unsafe {
        core::arch::asm!("vsqrt.f64 {}, {}", lateout(dreg_low16) root, in(dreg_low16) number, options(pure, nomem, nostack))
    };
    root
}

/// Of a number that is not negative; NaN of others.
#[cfg(target_arch = "arm")]
#[inline(always)]
#[allow(unsafe_code, reason = "one instruction between two registers, which touches nothing else")]
pub(crate) fn sqrtf(number: f32) -> f32 {
    let root;
    // SAFETY: as above.
    unsafe { core::arch::asm!("vsqrt.f32 {}, {}", lateout(sreg) root, in(sreg) number, options(pure, nomem, nostack)) };
    root
}
