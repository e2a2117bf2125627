//! Interrupt masks PRIMASK, BASEPRI, FAULTMASK (B1.4.3), and waiting (B1.5.17 to B1.5.19).

use core::arch::asm;
use core::sync::atomic::{AtomicU32, Ordering::Relaxed};

use crate::handlers::{self, IRQ0, SV_CALL, SYS_TICK, log, take_log};
use crate::registers::*;
use crate::report::check;

static TICKS: AtomicU32 = AtomicU32::new(0);

pub(crate) fn run() {
    base_priority();
    fault_mask();
    wait_for_interrupt();
    wait_for_event();
}

fn base_priority() {
    for (irq, priority) in [(10, 0x40), (11, 0x20)] {
        enable(irq, priority);
        handlers::set(IRQ0 + irq as usize, |taken| log(taken.number - IRQ0 as u32));
    }
    set_basepri(0x40);
    pend(1 << 10 | 1 << 11);
    check("masks: BASEPRI holds back its own level, not a higher one", take_log(), 0xB);
    check("masks: held back is pending", read(NVIC_ISPR), 1 << 10);
    set_basepri(0x50);
    check("masks: lowered, it is taken", take_log(), 0xA);
    set_basepri_max(0x80);
    check("masks: BASEPRI_MAX only raises: not by 0x80", basepri() & 0xF0, 0x50);
    set_basepri_max(0x20);
    check("masks: BASEPRI_MAX raises", basepri() & 0xF0, 0x20);
    set_basepri_max(0);
    check("masks: BASEPRI_MAX ignores zero", basepri() & 0xF0, 0x20);
    set_basepri(0);
    set_primask(1);
    check("masks: PRIMASK", primask(), 1);
    pend(1 << 11);
    // SAFETY: changes only PRIMASK.
    unsafe { asm!("cpsie i") };
    log(1);
    check("masks: CPSIE takes what is pending at once", take_log(), 0xB1);
}

/// FAULTMASK is set within a handler, and cleared by its return.
fn fault_mask() {
    handlers::set(SV_CALL, |_| {
        // SAFETY: changes only FAULTMASK.
        unsafe { asm!("cpsid f") };
        pend(1 << 11);
        log(faultmask());
    });
    // SAFETY: the handler changes nothing else.
    unsafe { asm!("svc #0") };
    check("masks: FAULTMASK holds back until the return clears it", take_log(), 0x1B);
    check("masks: FAULTMASK is clear", faultmask(), 0);
}

/// WFI wakes by an interrupt that PRIMASK holds back, and the handler does not run until PRIMASK is cleared.
fn wait_for_interrupt() {
    handlers::set(SYS_TICK, |_| {
        TICKS.fetch_add(1, Relaxed);
    });
    TICKS.store(0, Relaxed);
    set_primask(1);
    write(SYST_RVR, 49_999);
    write(SYST_CVR, 0);
    write(SYST_CSR, 7);
    // SAFETY: only waits.
    unsafe { asm!("wfi") };
    check("masks: WFI wakes although masked", TICKS.load(Relaxed) << 8 | read(ICSR) >> 26 & 1, 1);
    write(SYST_CSR, 6);
    set_primask(0);
    barrier();
    check("masks: then the handler runs, once", TICKS.load(Relaxed), 1);
    write(SYST_CVR, 0);
    write(SYST_CSR, 7);
    for _ in 0..10 {
        let before = TICKS.load(Relaxed);
        while TICKS.load(Relaxed) == before {
            // SAFETY: only waits; an interrupt before it wakes the next round.
            unsafe { asm!("wfi") };
        }
    }
    write(SYST_CSR, 0);
    check("masks: ten more by WFI", TICKS.load(Relaxed), 11);
}

/// SEV sets the event register: the WFE after it does not wait. Nothing else would wake the processor, so one that
/// loses the event hangs here.
fn wait_for_event() {
    // SAFETY: only waits, for an event signalled before.
    unsafe { asm!("sev", "wfe", "sev", "nop", "wfe") };
    check("masks: WFE after SEV goes on", 1, 1);
}
