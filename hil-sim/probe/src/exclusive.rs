//! Exclusive accesses with the monitor (A3.4).

use core::arch::asm;
use core::ptr::addr_of_mut;

use crate::handlers::{self, SV_CALL};
use crate::report::check;

static mut WORD: u32 = 5;

/// Executes LDREX, the given instructions, and STREX of 9; returns the status, and the word afterwards.
macro_rules! exclusive {
    ($($between:literal),*) => {{
        let status: u32;
        // SAFETY: no other code uses the word.
        unsafe {
            addr_of_mut!(WORD).write_volatile(5);
            asm!(
                "ldrex {t}, [{p}]", $($between,)* "movs {t}, #9", "strex {s}, {t}, [{p}]",
                t = out(reg) _, s = out(reg) status, p = in(reg) addr_of_mut!(WORD),
            );
            status << 8 | addr_of_mut!(WORD).read_volatile()
        }
    }};
}

pub(crate) fn run() {
    handlers::set(SV_CALL, |_| {});
    check("exclusive: STREX succeeds", exclusive!(), 0x009);
    check("exclusive: STREX after CLREX fails", exclusive!("clrex"), 0x105);
    check("exclusive: STREX after an exception fails", exclusive!("svc #0"), 0x105);
    let status: u32;
    let byte: u32;
    // SAFETY: no other code uses the word.
    unsafe {
        addr_of_mut!(WORD).write_volatile(0x55);
        asm!(
            "ldrexb {b}, [{p}]", "adds {t}, {b}, #1", "strexb {s}, {t}, [{p}]", "ldrexh {t}, [{p}]", "adds {t}, #1",
            "strexh {b}, {t}, [{p}]", "adds {s}, {s}, {b}",
            b = out(reg) byte, t = out(reg) _, s = out(reg) status, p = in(reg) addr_of_mut!(WORD),
        );
        check("exclusive: bytes and halfwords", addr_of_mut!(WORD).read_volatile() << 8 | status | byte, 0x5700);
    }
}
