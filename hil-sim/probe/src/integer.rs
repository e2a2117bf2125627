//! Integer instructions: conditional blocks, branches by table, flags (A7.7).

use core::arch::asm;
use core::hint::black_box;

use crate::arithmetic::integer_digest;
use crate::report::check;

pub(crate) fn run() {
    check("integer: digest of 10000 rounds", integer_digest(black_box(10_000)), 0xF493_F723);
    conditional();
    branches();
    division();
    flags();
}

/// IT blocks (A7.7.38): each condition both ways, and flags that an instruction in the block must not change.
fn conditional() {
    let mut result = 0_u32;
    for value in [0_i32, 1, -1] {
        let mut bits: u32;
        // SAFETY: computes in registers only.
        unsafe {
            asm!(
                "movs {bits}, #0",
                "cmp {value}, #0",
                "itete eq",
                "orreq {bits}, {bits}, #1",
                "orrne {bits}, {bits}, #2",
                "orreq {bits}, {bits}, #4",
                "orrne {bits}, {bits}, #8",
                "ittt mi",
                "orrmi {bits}, {bits}, #16",
                "addmi {bits}, {bits}, #32",
                "orrmi {bits}, {bits}, #64",
                "ite gt",
                "orrgt {bits}, {bits}, #128",
                "orrle {bits}, {bits}, #256",
                "it hi",
                "orrhi {bits}, {bits}, #512",
                bits = out(reg) bits,
                value = in(reg) value,
            );
        }
        result = result << 10 | bits;
    }
    // For 0: eq, le. For 1: ne, gt, hi. For -1: ne, mi, le, hi (unsigned).
    check("integer: IT blocks", result, 0x105 << 20 | 0x28A << 10 | 0x37A);
}

/// Branches by TBB, CBZ and CBNZ, and by a load to PC.
fn branches() {
    let mut result = 0_u32;
    for index in 0..4_u32 {
        let mut value: u32;
        // SAFETY: computes in registers only.
        unsafe {
            asm!(
                "tbb [pc, r0]",
                "2: .byte (3f - 2b) / 2, (4f - 2b) / 2, (5f - 2b) / 2, (6f - 2b) / 2",
                "3: movs {value}, #1",
                "b 7f",
                "4: movs {value}, #2",
                "b 7f",
                "5: movs {value}, #4",
                "b 7f",
                "6: movs {value}, #8",
                "7: cbz r0, 8f",
                "adds {value}, #16",
                "8:",
                in("r0") index,
                value = out(reg) value,
                options(nostack),
            );
        }
        result = result << 8 | value;
    }
    check("integer: TBB and CBZ", result, 0x0112_1418);
}

/// SDIV and UDIV: the quotient by zero is zero, without the trap (A3.3.1); the most negative number by -1.
fn division() {
    let (unsigned, signed, zero): (u32, i32, u32);
    // SAFETY: computes in registers only.
    unsafe {
        asm!(
            "udiv {u}, {a}, {b}", "sdiv {s}, {min}, {minus}", "udiv {z}, {a}, {none}",
            u = out(reg) unsigned, s = out(reg) signed, z = out(reg) zero,
            a = in(reg) 0xFFFF_FFFF_u32, b = in(reg) 10_u32, min = in(reg) i32::MIN, minus = in(reg) -1_i32,
            none = in(reg) 0_u32,
        );
    }
    check("integer: UDIV", unsigned, 0x1999_9999);
    check("integer: SDIV of the most negative number by -1", signed as u32, 0x8000_0000);
    check("integer: UDIV by zero", zero, 0);
}

/// APSR after sums and differences with carry (A2.2, AddWithCarry).
fn flags() {
    let (mut first, mut second): (u32, u32);
    // SAFETY: computes in registers only.
    unsafe {
        asm!(
            "adds {t}, {max}, {one}", "mrs {first}, APSR",
            "sbcs {t}, {one}, {max}", "mrs {second}, APSR",
            t = out(reg) _, first = out(reg) first, second = out(reg) second,
            max = in(reg) 0x7FFF_FFFF_u32, one = in(reg) 1_u32,
        );
    }
    // Negative and overflow, no carry; then 1 - 0x7FFF_FFFF - 1: negative, borrow.
    check("integer: flags of ADDS", first >> 28, 0b1001);
    check("integer: flags of SBCS", second >> 28, 0b1000);
}
