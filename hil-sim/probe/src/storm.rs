//! Interrupt storm: floating point, conditional blocks and long loads under tens of thousands of interrupts (B1.5.7),
//! without any loss.

use core::arch::asm;
use core::hint::black_box;
use core::sync::atomic::{AtomicU32, Ordering::Relaxed};

use crate::arithmetic::{double_digest, integer_digest, single_digest};
use crate::handlers::{self, SYS_TICK};
use crate::registers::*;
use crate::report::check;

/// Number of interrupts: as many as a control loop of 1 kHz sees in half a minute.
const ENOUGH: u32 = 30_000;

static TICKS: AtomicU32 = AtomicU32::new(0);
static WRONG: AtomicU32 = AtomicU32::new(0);
static DIGEST: AtomicU32 = AtomicU32::new(0);

pub(crate) fn run() {
    DIGEST.store(single_digest(black_box(4)), Relaxed);
    let expected = (double_digest(black_box(50)), single_digest(black_box(50)), integer_digest(black_box(50)));
    handlers::set(SYS_TICK, |_| {
        let ticks = TICKS.load(Relaxed) + 1;
        TICKS.store(ticks, Relaxed);
        // Other rounding, other values in every register: the main program must not see any of it. Every other time
        // without this, so that both kinds of frame are tail-chained and returned to.
        if ticks.is_multiple_of(2) {
            clobber();
            if single_digest(black_box(4)) != DIGEST.load(Relaxed) {
                WRONG.fetch_add(1, Relaxed);
            }
        }
    });
    write(SYST_RVR, 1_999);
    write(SYST_CVR, 0);
    write(SYST_CSR, 7);
    let mut rounds = 0_u32;
    let (mut digests, mut kept, mut blocks) = (0_u32, 0_u32, 0_u32);
    while TICKS.load(Relaxed) < ENOUGH {
        let got = (double_digest(black_box(50)), single_digest(black_box(50)), integer_digest(black_box(50)));
        digests += u32::from(got != expected);
        kept += u32::from(!registers_keep(rounds));
        blocks += u32::from(!conditional_blocks());
        rounds += 1;
    }
    write(SYST_CSR, 0);
    check("storm: enough interrupts", u32::from(TICKS.load(Relaxed) >= ENOUGH), 1);
    check("storm: enough work between them", u32::from(rounds >= 100), 1);
    check("storm: digests that differ", digests, 0);
    check("storm: register files that differ", kept, 0);
    check("storm: conditional blocks that differ", blocks, 0);
    check("storm: results of handlers that differ", WRONG.load(Relaxed), 0);
}

/// Changes every caller-saved floating-point register, and every flag.
fn clobber() {
    // SAFETY: the callee may change all of them; the rounding mode is restored, as a handler's compiler expects.
    unsafe {
        asm!(
            "vmov d0, {x}, {x}", "vmov d1, {x}, {x}", "vmov d2, {x}, {x}", "vmov d3, {x}, {x}", "vmov d4, {x}, {x}",
            "vmov d5, {x}, {x}", "vmov d6, {x}, {x}", "vmov d7, {x}, {x}", "vmsr fpscr, {mode}", "vmsr fpscr, {zero}",
            x = in(reg) 0xFFFF_FFFF_u32, mode = in(reg) 0xF0C0_009F_u32, zero = in(reg) 0_u32,
            out("d0") _, out("d1") _, out("d2") _, out("d3") _, out("d4") _, out("d5") _, out("d6") _, out("d7") _,
        );
    }
}

/// Checks that S0 to S31 and FPSCR keep their values for a while.
fn registers_keep(seed: u32) -> bool {
    let mut words = [0_u32; 32];
    for (index, word) in words.iter_mut().enumerate() {
        *word = seed.wrapping_mul(0x9E37_79B9) ^ (index as u32 * 0x0101_0101);
    }
    let mut after = [0_u32; 32];
    let status: u32;
    // SAFETY: reads and writes the two arrays only.
    unsafe {
        asm!(
            "vmsr fpscr, {mode}",
            "vldmia {from}, {{s0-s31}}",
            "movs {n}, #200",
            "2: subs {n}, #1",
            "bne 2b",
            "vstmia {to}, {{s0-s31}}",
            "vmrs {status}, fpscr",
            "vmsr fpscr, {n}",
            from = in(reg) words.as_ptr(), to = in(reg) after.as_mut_ptr(), mode = in(reg) 0x50C0_0000_u32,
            n = out(reg) _, status = out(reg) status,
            out("d0") _, out("d1") _, out("d2") _, out("d3") _, out("d4") _, out("d5") _, out("d6") _, out("d7") _,
            out("d8") _, out("d9") _, out("d10") _, out("d11") _, out("d12") _, out("d13") _, out("d14") _, out("d15") _,
        );
    }
    words == after && status == 0x50C0_0000
}

/// Executes conditional blocks with loads in them repeatedly: interrupts fall between their instructions.
fn conditional_blocks() -> bool {
    let cell = 3_u32;
    let (sum, odd): (u32, u32);
    // SAFETY: only reads `cell`.
    unsafe {
        asm!(
            "movs {sum}, #0", "movs {odd}, #0", "movs {n}, #100",
            "2: tst {n}, #1",
            "itete ne",
            "ldrne {t}, [{p}]",
            "moveq {t}, #5",
            "addne {odd}, #1",
            "addeq {sum}, #7",
            "add {sum}, {t}",
            "subs {n}, #1",
            "bne 2b",
            sum = out(reg) sum, odd = out(reg) odd, n = out(reg) _, t = out(reg) _, p = in(reg) &cell,
        );
    }
    // Executed 50 times each: 3, and 5 + 7.
    sum == 50 * 3 + 50 * 12 && odd == 50
}
