//! Loads and stores: unaligned ones (A3.2.1), several registers, write-back.

use core::arch::asm;
use core::ptr::addr_of_mut;

use crate::report::check;

/// Buffer of two pages of 4 KiB, so that it contains a page boundary.
static mut BUFFER: [u8; 8192 + 64] = [0; 8192 + 64];

pub(crate) fn run() {
    // SAFETY: no other code uses the buffer.
    let buffer = unsafe { &mut *addr_of_mut!(BUFFER) };
    for (index, byte) in buffer.iter_mut().enumerate() {
        *byte = index as u8;
    }
    let start = buffer.as_mut_ptr() as u32;
    let boundary = (start + 4096) & !4095;
    unaligned("memory: unaligned loads", "memory: unaligned stores", start + 1, 1);
    unaligned(
        "memory: unaligned loads across pages",
        "memory: unaligned stores across pages",
        boundary - 2,
        (boundary - 2 - start) as u8,
    );
    several(start + 64);
}

fn unaligned(loads: &'static str, stores: &'static str, at: u32, first: u8) {
    let (word, half, signed): (u32, u32, u32);
    let (byte_0, byte_5): (u32, u32);
    // SAFETY: within the buffer.
    unsafe {
        asm!(
            "ldr {w}, [{p}]", "ldrh {h}, [{p}, #1]", "ldrsh {s}, [{p}, #2]",
            w = out(reg) word, h = out(reg) half, s = out(reg) signed, p = in(reg) at,
        );
        asm!(
            "str {v}, [{p}]", "strh {v}, [{p}, #5]", "ldrb {a}, [{p}, #3]", "ldrb {b}, [{p}, #6]",
            v = in(reg) 0xA1B2_C3D4_u32, p = in(reg) at, a = out(reg) byte_0, b = out(reg) byte_5,
        );
    }
    let byte = |offset: u8| u32::from(first.wrapping_add(offset));
    let expected = (byte(0) | byte(1) << 8 | byte(2) << 16 | byte(3) << 24)
        ^ (byte(1) | byte(2) << 8)
        ^ (byte(2) | byte(3) << 8) as u16 as i16 as u32;
    check(loads, word ^ half ^ signed, expected);
    check(stores, byte_0 << 8 | byte_5, 0xA1C3);
}

/// Checks LDM, STM, LDRD, STRD, with write-back; PUSH and POP.
fn several(at: u32) {
    let (after_store, after_load, sum): (u32, u32, u32);
    // SAFETY: within the buffer, and the stack is balanced.
    unsafe {
        asm!(
            "mov {p}, {at}",
            "movs r2, #1", "movs r3, #2", "movs r4, #4", "movs r5, #8",
            "stmia {p}!, {{r2-r5}}",
            "mov {after_store}, {p}",
            "strd r5, r4, [{p}, #-8]!",
            "ldmdb {p}!, {{r2, r3}}",
            "push {{r2, r3}}",
            "ldrd r4, r5, [{p}, #8]",
            "pop {{r2, r3}}",
            "mov {after_load}, {p}",
            "lsls r2, r2, #4", "lsls r4, r4, #8", "lsls r5, r5, #12",
            "adds r2, r2, r3", "adds r4, r4, r5", "adds {sum}, r2, r4",
            p = out(reg) _, at = in(reg) at, after_store = out(reg) after_store, after_load = out(reg) after_load,
            sum = out(reg) sum, out("r2") _, out("r3") _, out("r4") _, out("r5") _,
        );
    }
    check("memory: STM writes back", after_store.wrapping_sub(at), 16);
    check("memory: STRD and LDMDB write back", after_load.wrapping_sub(at), 0);
    // LDMDB loads the words before: r2 = 1, r3 = 2. LDRD loads those that STRD has stored: r4 = 8, r5 = 4.
    check("memory: which register takes which word", sum, 0x4812);
}
