//! Exception handling: all exceptions enter one dispatcher, which calls the handler that a check has set.

use core::arch::global_asm;
use core::sync::atomic::{AtomicU32, AtomicUsize, Ordering::Relaxed};

/// Exception that was taken.
#[derive(Clone, Copy)]
pub(crate) struct Taken {
    /// Exception number, from IPSR.
    pub(crate) number: u32,
    /// LR on entry (EXC_RETURN).
    pub(crate) exc_return: u32,
    /// Pointer to the frame: R0 to R3, R12, LR, PC, xPSR.
    pub(crate) frame: *mut u32,
}

impl Taken {
    /// Reads a word of the frame.
    pub(crate) fn word(&self, index: usize) -> u32 {
        // SAFETY: the frame is on the stack below this handler, at least 8 words.
        unsafe { self.frame.add(index).read_volatile() }
    }

    /// Changes a word of the frame: it is restored on return.
    pub(crate) fn set_word(&self, index: usize, value: u32) {
        // SAFETY: as for `word`; the effect of the change is the subject of the checks.
        unsafe { self.frame.add(index).write_volatile(value) }
    }
}

pub(crate) type Handler = fn(&Taken);

pub(crate) const HARD_FAULT: usize = 3;
pub(crate) const BUS_FAULT: usize = 5;
pub(crate) const USAGE_FAULT: usize = 6;
pub(crate) const SV_CALL: usize = 11;
pub(crate) const PEND_SV: usize = 14;
pub(crate) const SYS_TICK: usize = 15;
pub(crate) const IRQ0: usize = 16;

const EXCEPTIONS: usize = 48;

static HANDLERS: [AtomicUsize; EXCEPTIONS] = [const { AtomicUsize::new(0) }; EXCEPTIONS];

/// Log of events, a nibble each, the last one lowest.
static LOG: AtomicU32 = AtomicU32::new(0);

/// Number of the last exception without a handler; 0 for none.
pub(crate) static UNEXPECTED: AtomicU32 = AtomicU32::new(0);

pub(crate) fn set(exception: usize, handler: Handler) {
    HANDLERS[exception].store(handler as usize, Relaxed);
}

/// Appends an event to the log.
pub(crate) fn log(what: u32) {
    // No atomic update is needed: handlers that preempt leave the log as they found it, with their own events appended.
    LOG.store(LOG.load(Relaxed) << 4 | what, Relaxed);
}

/// Returns the events since the last call.
pub(crate) fn take_log() -> u32 {
    LOG.swap(0, Relaxed)
}

// Common entry: R0 is the frame, on either stack; LR stays EXC_RETURN, so that the Rust function's return ends the
// handler.
global_asm!(
    ".section .text.handlers, \"ax\"",
    ".thumb_func",
    "r4_exception:",
    "tst lr, #4",
    "ite eq",
    "mrseq r0, msp",
    "mrsne r0, psp",
    "mov r1, lr",
    "mrs r2, ipsr",
    "b r4_dispatch",
    ".irp name, HardFault, MemoryManagement, BusFault, UsageFault, SVCall, PendSV, SysTick, DefaultHandler",
    ".global \\name",
    ".thumb_set \\name, r4_exception",
    ".endr",
);

#[unsafe(no_mangle)]
extern "C" fn r4_dispatch(frame: *mut u32, exc_return: u32, number: u32) {
    let handler = HANDLERS.get(number as usize).map_or(0, |handler| handler.load(Relaxed));
    if handler == 0 {
        UNEXPECTED.store(number, Relaxed);
        crate::report::check("an exception that was not expected", number, 0);
        crate::report::finish();
    }
    // SAFETY: only `set` stores here, and it stores handlers.
    let handler = unsafe { core::mem::transmute::<usize, Handler>(handler) };
    handler(&Taken { number, exc_return, frame });
}
