//! Floating point of both widths: results, rounding, exceptions in FPSCR (A2.5).

use core::arch::asm;
use core::hint::black_box;

use crate::arithmetic::{double_digest, single_digest};
use crate::report::check;

pub(crate) fn run() {
    let digest = double_digest(black_box(10_000));
    check("float: f64 digest of 10000 rounds, low", digest as u32, 0xB83C_6F7E);
    check("float: f64 digest of 10000 rounds, high", (digest >> 32) as u32, 0x8BAC_74FA);
    check("float: f32 digest of 10000 rounds", single_digest(black_box(10_000)), 0xF1A5_E73E);
    roots();
    fused();
    rounding();
    exceptions();
    conversions();
    moves();
}

/// FPSCR after `$code`, which begins with it cleared.
macro_rules! flags {
    ($($code:literal),* ; $($operands:tt)*) => {{
        let flags: u32;
        // SAFETY: computes in registers only.
        unsafe { asm!("vmsr fpscr, {zero}", $($code,)* "vmrs {flags}, fpscr", zero = in(reg) 0_u32, flags = out(reg) flags, $($operands)*) };
        flags
    }};
}

const INVALID: u32 = 1;
const DIVISION: u32 = 2;
const OVERFLOW: u32 = 4;
const UNDERFLOW: u32 = 8;
const INEXACT: u32 = 16;

fn roots() {
    let (double, single): (f64, f32);
    // SAFETY: computes in registers only.
    unsafe {
        asm!("vsqrt.f64 {r}, {a}", r = out(dreg_low16) double, a = in(dreg_low16) 2.0_f64);
        asm!("vsqrt.f32 {r}, {a}", r = out(sreg) single, a = in(sreg) 2.0_f32);
    }
    // sqrt(2) to nearest.
    check("float: VSQRT.F64, low", double.to_bits() as u32, 0x667F_3BCD);
    check("float: VSQRT.F64, high", (double.to_bits() >> 32) as u32, 0x3FF6_A09E);
    check("float: VSQRT.F32", single.to_bits(), 0x3FB5_04F3);
}

/// Single rounding of fused operations: (1 + 2^-30)^2 - 1 - 2^-29 is 2^-60 exactly, and 0 with two roundings.
fn fused() {
    let a = 1.0 + 1.0 / f64::from(1 << 30);
    let mut sum = -1.0 - 1.0 / f64::from(1 << 29);
    // SAFETY: computes in registers only.
    unsafe { asm!("vfma.f64 {s}, {a}, {a}", s = inout(dreg_low16) sum, a = in(dreg_low16) a) };
    check("float: VFMA.F64 rounds once", (sum.to_bits() >> 32) as u32, 0x3C30_0000);
    let mut twice = -1.0 - 1.0 / f64::from(1 << 29);
    // SAFETY: computes in registers only.
    unsafe { asm!("vmla.f64 {s}, {a}, {a}", s = inout(dreg_low16) twice, a = in(dreg_low16) a) };
    check("float: VMLA.F64 rounds twice", (twice.to_bits() >> 32) as u32, 0);
}

/// Quotient 1 / 3 in all four modes of FPSCR.RMode.
fn rounding() {
    let mut result = 0_u32;
    for mode in 0..4_u32 {
        let third: f32;
        // SAFETY: computes in registers only, and restores the mode.
        unsafe {
            asm!(
                "vmsr fpscr, {mode}", "vdiv.f32 {r}, {a}, {b}", "vmsr fpscr, {zero}",
                mode = in(reg) mode << 22, zero = in(reg) 0_u32, r = out(sreg) third, a = in(sreg) 1.0_f32, b = in(sreg) 3.0_f32,
            );
        }
        result = result << 8 | (third.to_bits() & 0xFF);
    }
    // Nearest and up: ...AB; down and towards zero: ...AA.
    check("float: the four rounding modes", result, 0xABAB_AAAA);
}

fn exceptions() {
    let all = |name, flags: u32, expected| check(name, flags & 0x9F, expected);
    all(
        "float: division by zero",
        flags!("vdiv.f64 {r}, {a}, {b}"; r = out(dreg_low16) _, a = in(dreg_low16) 1.0_f64, b = in(dreg_low16) 0.0_f64),
        DIVISION,
    );
    all("float: 0 / 0", flags!("vdiv.f64 {r}, {a}, {a}"; r = out(dreg_low16) _, a = in(dreg_low16) 0.0_f64), INVALID);
    all(
        "float: overflow",
        flags!("vmul.f32 {r}, {a}, {a}"; r = out(sreg) _, a = in(sreg) 3e38_f32),
        OVERFLOW | INEXACT,
    );
    all(
        "float: underflow",
        flags!("vmul.f32 {r}, {a}, {a}"; r = out(sreg) _, a = in(sreg) 1.1e-20_f32),
        UNDERFLOW | INEXACT,
    );
    all(
        "float: inexact",
        flags!("vadd.f64 {r}, {a}, {b}"; r = out(dreg_low16) _, a = in(dreg_low16) 1.0_f64, b = in(dreg_low16) 1e-30_f64),
        INEXACT,
    );
    all(
        "float: exact",
        flags!("vadd.f64 {r}, {a}, {b}"; r = out(dreg_low16) _, a = in(dreg_low16) 1.0_f64, b = in(dreg_low16) 2.0_f64),
        0,
    );
    let compared = flags!("vcmp.f64 {a}, {b}"; a = in(dreg_low16) f64::NAN, b = in(dreg_low16) 1.0_f64);
    check("float: comparison with a NaN is unordered", compared >> 28, 0b0011);
    let less = flags!("vcmp.f64 {a}, {b}"; a = in(dreg_low16) -1.0_f64, b = in(dreg_low16) 1.0_f64);
    check("float: comparison, less", less >> 28, 0b1000);
}

/// Conversions saturate, and round as the instruction specifies.
fn conversions() {
    let (to_zero, to_nearest, saturated, unsigned): (i32, i32, i32, u32);
    // SAFETY: computes in registers only.
    unsafe {
        asm!(
            "vcvt.s32.f64 {t}, {a}", "vmov {r0}, {t}",
            "vcvtr.s32.f64 {t}, {a}", "vmov {r1}, {t}",
            "vcvt.s32.f64 {t}, {b}", "vmov {r2}, {t}",
            "vcvt.u32.f64 {t}, {c}", "vmov {r3}, {t}",
            t = out(sreg) _, r0 = out(reg) to_zero, r1 = out(reg) to_nearest, r2 = out(reg) saturated, r3 = out(reg) unsigned,
            a = in(dreg_low16) -2.75_f64, b = in(dreg_low16) 1e12_f64, c = in(dreg_low16) -1.0_f64,
        );
    }
    check("float: VCVT towards zero", to_zero as u32, (-2_i32) as u32);
    check("float: VCVTR to nearest", to_nearest as u32, (-3_i32) as u32);
    check("float: VCVT saturates", saturated as u32, i32::MAX as u32);
    check("float: VCVT of a negative number to unsigned", unsigned, 0);
    let half: u32;
    // SAFETY: computes in registers only.
    unsafe {
        asm!("vcvtb.f16.f32 {t}, {a}", "vmov {r}, {t}", t = out(sreg) _, r = out(reg) half, a = in(sreg) 1.5_f32)
    };
    check("float: VCVTB to half precision", half & 0xFFFF, 0x3E00);
    let (selected, maximum, away): (f64, f64, f64);
    // SAFETY: computes in registers only.
    unsafe {
        asm!("cmp {x}, #1", "vseleq.f64 {r}, {a}, {b}", x = in(reg) 1_u32, r = out(dreg_low16) selected, a = in(dreg_low16) 5.0_f64, b = in(dreg_low16) 6.0_f64);
        asm!("vmaxnm.f64 {r}, {a}, {b}", r = out(dreg_low16) maximum, a = in(dreg_low16) f64::NAN, b = in(dreg_low16) 7.0_f64);
        asm!("vrinta.f64 {r}, {a}", r = out(dreg_low16) away, a = in(dreg_low16) 2.5_f64);
    }
    // Instructions that only FPv5 has.
    check("float: VSEL", (selected.to_bits() >> 32) as u32, 0x4014_0000);
    check("float: VMAXNM with a NaN", (maximum.to_bits() >> 32) as u32, 0x401C_0000);
    check("float: VRINTA", (away.to_bits() >> 32) as u32, 0x4008_0000);
}

/// Overlapping registers: D0 is S0 and S1; several are loaded and stored at once.
fn moves() {
    let (low, high): (u32, u32);
    let words = [0x1111_1111_u32, 0x2222_2222, 0x3333_3333, 0x4444_4444];
    // SAFETY: only reads `words`.
    unsafe {
        asm!(
            "vldmia {p}, {{s0-s3}}", "vmov {low}, {high}, d1",
            p = in(reg) words.as_ptr(), low = out(reg) low, high = out(reg) high,
            out("s0") _, out("s1") _, out("s2") _, out("s3") _,
        );
    }
    check("float: D1 is S2 and S3", low ^ high, 0x7777_7777);
}
