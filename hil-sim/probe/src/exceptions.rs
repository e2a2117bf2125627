//! Exceptions: entry, return, nesting, tail-chaining, PendSV, SVC, stacks (B1.5).

use core::arch::asm;
use core::sync::atomic::{AtomicU32, Ordering::Relaxed};

use crate::handlers::{self, IRQ0, SV_CALL, Taken, log, take_log};
use crate::registers::*;
use crate::report::check;

static SEEN: [AtomicU32; 4] = [const { AtomicU32::new(0) }; 4];

fn see(index: usize, value: u32) {
    SEEN[index].store(value, Relaxed);
}

fn seen(index: usize) -> u32 {
    SEEN[index].load(Relaxed)
}

pub(crate) fn run() {
    nesting();
    tail_chaining();
    priorities();
    pend_sv();
    supervisor_call();
    returns();
    padding();
    vector_table();
    system_tick();
}

/// Three interrupts, each of which makes the next more urgent one pending: they nest, and return in reverse order.
fn nesting() {
    for (irq, priority) in [(0, 0xC0), (1, 0x80), (2, 0x40)] {
        enable(irq, priority);
        handlers::set(IRQ0 + irq as usize, |taken| {
            let irq = taken.number - IRQ0 as u32;
            log(irq + 1);
            if irq == 1 {
                see(0, taken.exc_return);
            }
            if irq < 2 {
                pend(2 << irq);
            } else {
                see(1, read(NVIC_IABR));
                // RETTOBASE is clear: others are active too.
                see(2, read(ICSR) & 0xFFF);
            }
            log(irq + 9);
        });
    }
    pend(1);
    check("exceptions: nesting", take_log(), 0x0012_3BA9);
    check("exceptions: EXC_RETURN of a nested one", seen(0), 0xFFFF_FFF1);
    check("exceptions: active bits", seen(1), 7);
    check("exceptions: VECTACTIVE, and RETTOBASE clear", seen(2), 18);
    check("exceptions: no active bits afterwards", read(NVIC_IABR), 0);
}

/// Interrupts of one priority do not preempt each other; they follow in order of number, on the same frame.
fn tail_chaining() {
    for irq in 3..6 {
        enable(irq, 0x80);
        handlers::set(IRQ0 + irq as usize, |taken| {
            log(taken.number - IRQ0 as u32);
            see(taken.number as usize - IRQ0 - 3, taken.frame as u32);
            if taken.number == 19 {
                // A late one of the same priority, with a lower number than the pending ones.
                write(STIR, 4);
            }
        });
    }
    set_primask(1);
    pend(1 << 5 | 1 << 3);
    check("exceptions: pending but masked", read(ICSR) >> 12 & 0x1FF | read(NVIC_ISPR) << 12, 0x2_8013);
    set_primask(0);
    check("exceptions: tail-chaining in order of number", take_log(), 0x345);
    check("exceptions: tail-chained handlers share a frame", u32::from(seen(0) == seen(1) && seen(1) == seen(2)), 1);
}

/// PRIGROUP: sub-priorities order pending exceptions, and do not preempt (B1.5.4).
fn priorities() {
    for (irq, priority) in [(6, 0x50), (7, 0x40)] {
        enable(irq, priority);
        handlers::set(IRQ0 + irq as usize, |taken| {
            let irq = taken.number - IRQ0 as u32;
            log(irq);
            if irq == 6 {
                pend(1 << 7);
            }
            log(irq + 8);
        });
    }
    // Group priority in bits 7 and 6.
    write(AIRCR, 0x05FA_0500);
    pend(1 << 6);
    check("exceptions: a sub-priority does not preempt", take_log(), 0x6E7F);
    set_primask(1);
    pend(1 << 6 | 1 << 7);
    set_primask(0);
    // First 7; then 6, which makes 7 pending again.
    check("exceptions: a sub-priority orders", take_log(), 0x007F_6E7F);
    write(AIRCR, 0x05FA_0000);
    pend(1 << 6);
    check("exceptions: without groups it preempts", take_log(), 0x67FE);
    check("exceptions: a priority is read back", read_byte(NVIC_IPR + 6).into(), 0x50);
    write(NVIC_ICER, 1 << 6);
    pend(1 << 6);
    check("exceptions: disabled, it stays pending", take_log() | read(NVIC_ISPR), 1 << 6);
    write(NVIC_ICPR, 1 << 6);
    check("exceptions: until it is cleared", read(NVIC_ISPR), 0);
}

/// PendSV at the lowest priority runs when no interrupt runs any more.
fn pend_sv() {
    write_byte(SHPR + 10, 0xF0);
    handlers::set(handlers::PEND_SV, |_| log(15));
    handlers::set(IRQ0 + 8, |_| {
        log(1);
        write(ICSR, PEND_SV);
        barrier();
        pend(1 << 9);
        log(2);
    });
    handlers::set(IRQ0 + 9, |_| log(3));
    enable(8, 0x80);
    enable(9, 0x40);
    pend(1 << 8);
    log(4);
    check("exceptions: PendSV comes last", take_log(), 0x0001_32F4);
    write(ICSR, PEND_SV);
    barrier();
    check("exceptions: PendSV from the main program", take_log(), 0xF);
    set_primask(1);
    write(ICSR, PEND_SV);
    write(ICSR, 1 << 27);
    set_primask(0);
    check("exceptions: PENDSVCLR", take_log(), 0);
}

/// SVC: the number is in the instruction before the stacked PC; values that the handler stores in the frame are
/// restored.
fn supervisor_call() {
    handlers::set(SV_CALL, |taken| {
        // SAFETY: the instruction before the stacked PC.
        let instruction = unsafe { (taken.word(6) as *const u16).sub(1).read_volatile() };
        taken.set_word(0, taken.word(0) * 2 + taken.word(3) + taken.word(4) + u32::from(instruction & 0xFF));
        see(0, ipsr());
        see(1, taken.exc_return);
    });
    let result: u32;
    let mut flags: u32;
    // SAFETY: the handler changes R0 only.
    unsafe {
        asm!(
            "cmp r0, r0", "svc #0x2A", "mrs {f}, APSR",
            f = out(reg) flags, inout("r0") 100_u32 => result, in("r3") 1000_u32, in("r12") 20_000_u32,
        );
    }
    check("exceptions: SVC through its frame", result, 200 + 1000 + 20_000 + 0x2A);
    check("exceptions: flags survive", flags >> 28, 0b0110);
    check("exceptions: IPSR in SVC", seen(0), 11);
}

/// EXC_RETURN shows stack and frame (B1.5.8); CONTROL in handlers (B1.4.4).
fn returns() {
    handlers::set(SV_CALL, |taken| {
        see(0, taken.exc_return);
        see(1, control());
    });
    set_control(0);
    // SAFETY: the handler changes nothing.
    unsafe { asm!("svc #0") };
    check("exceptions: EXC_RETURN, main stack", seen(0), 0xFFFF_FFF9);
    // SAFETY: as above; the operation begins a floating-point context.
    unsafe { asm!("vmov.f32 s0, #1.0", "svc #0", out("s0") _) };
    check("exceptions: EXC_RETURN, with floating point", seen(0), 0xFFFF_FFE9);
    check("exceptions: FPCA is clear in the handler", seen(1) & 4, 0);
    check("exceptions: and set again after it", control() & 4, 4);
    set_control(0);
    let mut stack = [0_u32; 64];
    let top = stack.as_mut_ptr_range().end as u32 & !7;
    // SAFETY: the process stack is used for one exception frame, which fits.
    unsafe {
        asm!(
            "msr PSP, {top}", "mrs {old}, CONTROL", "orr {new}, {old}, #2", "msr CONTROL, {new}", "isb",
            "svc #0",
            "mrs {psp}, PSP", "mov {new}, sp", "msr CONTROL, {old}", "isb",
            "sub {psp}, {psp}, {new}",
            top = in(reg) top, old = out(reg) _, new = out(reg) _, psp = out(reg) stack[0],
        );
    }
    check("exceptions: EXC_RETURN, process stack", seen(0), 0xFFFF_FFFD);
    check("exceptions: SPSEL is clear in the handler", seen(1) & 2, 0);
    check("exceptions: SP was PSP before and after", stack[0], 0);
}

/// A frame on a stack that is aligned to 4 only (B1.5.7) is padded, as shown by bit 9 of the stacked xPSR.
fn padding() {
    handlers::set(SV_CALL, |taken: &Taken| {
        see(0, taken.word(7) >> 9 & 1);
        see(1, taken.frame as u32);
    });
    for padded in [false, true] {
        let (sp, later): (u32, u32);
        // SAFETY: the stack pointer is restored; red zones do not exist.
        unsafe {
            asm!(
                "mov {old}, sp", "bic {t}, {old}, #7", "subs {t}, {t}, {less}", "mov sp, {t}",
                "svc #0",
                "mov {later}, sp", "mov sp, {old}",
                old = out(reg) _, t = out(reg) sp, later = out(reg) later, less = in(reg) if padded { 12_u32 } else { 16 },
            );
        }
        let distance = sp.wrapping_sub(seen(1));
        check("exceptions: padding of the stack", seen(0) << 8 | distance, if padded { 0x124 } else { 0x20 });
        check("exceptions: the stack pointer comes back", later.wrapping_sub(sp), 0);
    }
}

#[repr(C, align(256))]
struct Table([u32; 64]);

static mut TABLE: Table = Table([0; 64]);

core::arch::global_asm!(
    ".section .text.moved, \"ax\"",
    ".global r4_moved_handler",
    ".thumb_func",
    "r4_moved_handler:",
    "movs r0, #0x77",
    "str r0, [sp]",
    "bx lr",
);

unsafe extern "C" {
    fn r4_moved_handler();
}

/// Checks VTOR with another vector table, in RAM.
fn vector_table() {
    let old = read(VTOR);
    let table = core::ptr::addr_of_mut!(TABLE).cast::<u32>();
    let result: u32;
    // SAFETY: copies the table, changes one entry, and restores the old one.
    unsafe {
        for index in 0..64 {
            // Through an address that the compiler does not know to be null, which it is on the an500.
            let entry = core::hint::black_box(old) + 4 * index;
            table.add(index as usize).write_volatile(load(entry));
        }
        table.add(SV_CALL).write_volatile(r4_moved_handler as *const () as u32);
        write(VTOR, table as u32);
        barrier();
        asm!("svc #0", inout("r0") 0_u32 => result);
    }
    check("exceptions: a vector table in RAM", result, 0x77);
    check("exceptions: VTOR reads back", read(VTOR).wrapping_sub(table as u32), 0);
    write(VTOR, old);
    barrier();
}

/// Loads a word, possibly from address 0.
unsafe fn load(address: u32) -> u32 {
    let value;
    // SAFETY: guaranteed by the caller.
    unsafe { asm!("ldr {v}, [{a}]", v = out(reg) value, a = in(reg) address) };
    value
}

/// SysTick registers: COUNTFLAG, reload, current value (B3.3).
fn system_tick() {
    handlers::set(handlers::SYS_TICK, |_| log(1));
    write(SYST_CSR, 0);
    write(SYST_RVR, 9_999);
    write(SYST_CVR, 1234);
    check("systick: writing clears the counter", read(SYST_CVR), 0);
    write(SYST_CSR, 5);
    while read(SYST_CSR) & 1 << 16 == 0 {}
    check("systick: COUNTFLAG is read once, no interrupt", read(SYST_CSR) >> 16 & 1 | take_log(), 0);
    let value = read(SYST_CVR);
    check("systick: the counter is below its reload value", u32::from(value <= 9_999), 1);
    check("systick: reload value", read(SYST_RVR), 9_999);
    write(SYST_CSR, 0);
    write(ICSR, 1 << 26);
    barrier();
    check("systick: pended by ICSR", take_log(), 1);
}
