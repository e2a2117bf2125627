//! Faults: escalation, frames, status registers (B1.5.14, B3.2.15 ff.).

use core::arch::asm;
use core::sync::atomic::{AtomicU32, Ordering::Relaxed};

use crate::handlers::{self, BUS_FAULT, HARD_FAULT, SV_CALL, Taken, USAGE_FAULT, log, take_log};
use crate::registers::*;
use crate::report::check;

/// Values of R0 to R3, R12, LR, PC, xPSR of the last fault, and its exception number.
static FRAME: [AtomicU32; 9] = [const { AtomicU32::new(0) }; 9];

fn frame(index: usize) -> u32 {
    FRAME[index].load(Relaxed)
}

/// Stores the frame, and returns behind the instruction, whose length its first halfword shows (A5.1).
fn skip(taken: &Taken) {
    for (index, word) in FRAME[..8].iter().enumerate() {
        word.store(taken.word(index), Relaxed);
    }
    FRAME[8].store(taken.number, Relaxed);
    let pc = taken.word(6);
    // SAFETY: PC is the address of the instruction that faulted.
    let first = unsafe { (pc as *const u16).read_volatile() };
    taken.set_word(6, pc + if first >> 11 >= 0b11101 { 4 } else { 2 });
}

pub(crate) fn run() {
    for exception in [HARD_FAULT, BUS_FAULT, USAGE_FAULT] {
        handlers::set(exception, skip);
    }
    hard_fault();
    usage_fault();
    bus_fault();
    in_handlers();
}

fn hard_fault() {
    let pc: u32;
    // SAFETY: the handler returns after the undefined instruction.
    unsafe {
        asm!(
            "adr {pc}, 2f", "movs r0, #0xA0", "movs r1, #0xA1", "movs r2, #0xA2", "movs r3, #0xA3",
            "mov r12, {twelve}", "cmp r0, r0",
            ".p2align 2", "2: udf #1",
            pc = out(reg) pc, twelve = in(reg) 0xAC_u32,
            out("r0") _, out("r1") _, out("r2") _, out("r3") _, out("r12") _,
        );
    }
    check("faults: UDF is a HardFault", frame(8), 3);
    let registers = (0..4).fold(0, |word, index| word << 8 | frame(index));
    check("faults: the frame holds R0 to R3", registers, 0xA0A1_A2A3);
    check("faults: and R12", frame(4), 0xAC);
    check("faults: and the instruction's address", frame(6).wrapping_sub(pc & !1), 0);
    check("faults: and flags, with Thumb", frame(7) & 0xF100_0000, 0x6100_0000);
    check("faults: HFSR.FORCED", read(HFSR), 1 << 30);
    check("faults: CFSR.UNDEFINSTR", read(CFSR), 1 << 16);
    write(HFSR, 1 << 30);
    write(CFSR, 1 << 16);
    check("faults: cleared by ones", read(HFSR) | read(CFSR), 0);
}

fn usage_fault() {
    write(SHCSR, 1 << 18);
    // SAFETY: the handler returns after the undefined instruction.
    unsafe { asm!("udf #2") };
    check("faults: enabled, it is a UsageFault", frame(8) | read(HFSR), 6);
    write(CFSR, 0xFFFF_FFFF);
    // SAFETY: as above; within an IT block, the rest of which is executed.
    let result: u32;
    unsafe {
        asm!(
            "movs {r}, #0", "cmp {r}, #0", "itttt eq", "addeq {r}, #1", ".inst.n 0xDE01", "addeq {r}, #2", "addeq {r}, #4",
            r = out(reg) result,
        );
    }
    // UDF may be unconditional in an IT block or not; in either case both additions follow.
    check("faults: an IT block goes on after one", result, 7);
    write(CFSR, 0xFFFF_FFFF);
    write(SHCSR, 0);
}

/// Load from an address without memory (the chip's external memory, with no controller set up).
fn bus_fault() {
    write(SHCSR, 1 << 17);
    let mut value = 0x55_u32;
    // SAFETY: the handler returns after the load.
    unsafe { asm!("ldr {v}, [{a}]", v = inout(reg) value, a = in(reg) 0x9000_0010_u32) };
    check("faults: a refused load is a BusFault", frame(8), 5);
    check("faults: PRECISERR and BFARVALID", read(CFSR), 0x8200);
    check("faults: BFAR", read(BFAR), 0x9000_0010);
    check("faults: the register is not changed", value, 0x55);
    write(CFSR, 0xFFFF_FFFF);
    write(SHCSR, 0);
    // SAFETY: as above.
    unsafe { asm!("ldr {v}, [{a}]", v = out(reg) _, a = in(reg) 0x9000_0010_u32) };
    check("faults: disabled, a HardFault", frame(8) << 4 | read(HFSR) >> 30, 0x31);
    write(CFSR, 0xFFFF_FFFF);
    write(HFSR, 0xFFFF_FFFF);
}

/// A fault in a handler preempts it; SVC under PRIMASK escalates.
fn in_handlers() {
    handlers::set(SV_CALL, |_| {
        log(1);
        // SAFETY: the HardFault handler returns after the instruction.
        unsafe { asm!("udf #3") };
        log(frame(8));
    });
    // SAFETY: as above.
    unsafe { asm!("svc #0") };
    check("faults: a fault within a handler", take_log(), 0x13);
    check("faults: its frame says which", frame(7) & 0x1FF, 11);
    write(CFSR, 0xFFFF_FFFF);
    write(HFSR, 0xFFFF_FFFF);
    set_primask(1);
    // SAFETY: escalates to the HardFault handler, which skips the instruction behind the SVC: a 16-bit no-operation.
    unsafe { asm!("svc #0", "nop") };
    set_primask(0);
    check("faults: SVC under PRIMASK is a HardFault", take_log() << 4 | frame(8), 3);
    check("faults: FORCED without a cause", read(HFSR) | read(CFSR), 1 << 30);
    write(HFSR, 0xFFFF_FFFF);
}
