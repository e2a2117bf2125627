//! Saturating and packed instructions, with their flags (A7.7, A4.4.3).

use core::arch::asm;

use crate::report::check;

/// Clears APSR, executes an instruction on two operands, returns the result and APSR.
macro_rules! two {
    ($instruction:literal, $a:expr, $b:expr) => {{
        let (result, flags): (u32, u32);
        // SAFETY: computes in registers only.
        unsafe {
            asm!(
                "msr APSR_nzcvqg, {zero}",
                concat!($instruction, " {result}, {a}, {b}"),
                "mrs {flags}, APSR",
                result = out(reg) result,
                flags = out(reg) flags,
                zero = in(reg) 0_u32,
                a = in(reg) $a,
                b = in(reg) $b,
            );
        }
        (result, flags)
    }};
}

const Q: u32 = 1 << 27;

pub(crate) fn run() {
    let both = |name, (result, flags): (u32, u32), expected, expected_flags| {
        check(name, result, expected);
        check(name, flags, expected_flags);
    };
    both("dsp: QADD saturates, Q", two!("qadd", 0x7FFF_FFFF_u32, 1_u32), 0x7FFF_FFFF, Q);
    both("dsp: QSUB", two!("qsub", 0x8000_0000_u32, 1_u32), 0x8000_0000, Q);
    // b is doubled first: 0x4000_0000 doubled saturates.
    both("dsp: QDADD", two!("qdadd", 1_u32, 0x4000_0000_u32), 0x7FFF_FFFF, Q);
    both("dsp: QADD16", two!("qadd16", 0x7FFF_8000_u32, 0x0001_FFFF_u32), 0x7FFF_8000, 0);
    // Lanes 1, 2 and 3 carry.
    both("dsp: UADD8, GE", two!("uadd8", 0xFF80_FF01_u32, 0x0180_0102_u32), 0x0000_0003, 0xE << 16);
    both("dsp: SSUB16, GE", two!("ssub16", 0x0005_0001_u32, 0x0003_0002_u32), 0x0002_FFFF, 0xC << 16);
    both("dsp: SMUAD, Q", two!("smuad", 0x8000_8000_u32, 0x8000_8000_u32), 0x8000_0000, Q);
    both("dsp: SMUSD", two!("smusd", 0x0003_0005_u32, 0x0002_0007_u32), 29, 0);
    both("dsp: SMULBT", two!("smulbt", 0x0003_0005_u32, 0xFFFE_0007_u32), (-10_i32) as u32, 0);
    both("dsp: SMMULR", two!("smmulr", 0x4000_0000_u32, 0x0000_0006_u32), 2, 0);
    both("dsp: USAD8", two!("usad8", 0x0110_FF00_u32, 0x0310_00FF_u32), 2 + 255 + 255, 0);
    both("dsp: SXTAB16", two!("sxtab16", 0x0001_0001_u32, 0x0080_007F_u32), 0xFF81_0080, 0);
    both("dsp: SHADD8", two!("shadd8", 0x7F80_01FF_u32, 0x7F80_02FD_u32), 0x7F80_01FE, 0);
    select();
    saturate();
    multiply();
}

/// Checks that SEL takes bytes by the GE flags that UADD8 has set.
fn select() {
    let result: u32;
    // SAFETY: computes in registers only.
    unsafe {
        asm!(
            "uadd8 {t}, {a}, {b}", "sel {r}, {c}, {d}",
            t = out(reg) _, r = out(reg) result,
            a = in(reg) 0xFF80_FF01_u32, b = in(reg) 0x0180_0102_u32, c = in(reg) 0x1111_1111_u32, d = in(reg) 0x2222_2222_u32,
        );
    }
    check("dsp: SEL", result, 0x1111_1122);
}

/// Checks SSAT and USAT, with a shift.
fn saturate() {
    let (signed, unsigned, flags): (u32, u32, u32);
    // SAFETY: computes in registers only.
    unsafe {
        asm!(
            "msr APSR_nzcvqg, {zero}",
            "ssat {s}, #8, {a}, lsl #2", "usat {u}, #4, {n}", "mrs {f}, APSR",
            s = out(reg) signed, u = out(reg) unsigned, f = out(reg) flags, zero = in(reg) 0_u32,
            a = in(reg) 0x21_u32, n = in(reg) -3_i32,
        );
    }
    check("dsp: SSAT of 132 to 8 bits", signed, 127);
    check("dsp: USAT of -3", unsigned, 0);
    check("dsp: Q after saturation", flags, Q);
}

/// Checks long multiplications that accumulate, and bit fields.
fn multiply() {
    let (mut low, mut high) = (0xFFFF_FFFF_u32, 1_u32);
    let (mut slow, mut shigh) = (0xFFFF_FFF0_u32, 0xFFFF_FFFF_u32);
    let mut field = 0xFFFF_0000_u32;
    // SAFETY: computes in registers only.
    unsafe {
        asm!(
            "umaal {low}, {high}, {a}, {a}",
            "smlald {slow}, {shigh}, {x}, {y}",
            "bfi {field}, {a}, #4, #8",
            low = inout(reg) low, high = inout(reg) high, slow = inout(reg) slow, shigh = inout(reg) shigh,
            field = inout(reg) field, a = in(reg) 0xFFFF_FFFF_u32, x = in(reg) 0x0003_0005_u32, y = in(reg) 0x0002_0007_u32,
        );
    }
    // (2^32 - 1)^2 + (2^32 - 1) + 1 = 2^64 - 2^32 + 1.
    check("dsp: UMAAL, low", low, 1);
    check("dsp: UMAAL, high", high, 0xFFFF_FFFF);
    // -16 + 3*2 + 5*7 = 25.
    check("dsp: SMLALD, low", slow, 25);
    check("dsp: SMLALD, high", shigh, 0);
    check("dsp: BFI", field, 0xFFFF_0FF0);
}
