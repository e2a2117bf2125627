//! Index pulses of encoders: their first edge latches the encoder's counter.
//!
//! They use the switch pins, port J 0, 1, 2 and 5. The first three lines have vectors of their own, bound to [`Pulse`].
//! Line 5 shares its vector with the dead-man's handle on line 7, where embassy's handler is: it masks and clears *all*
//! lines that it finds pending, also these. [`Restore`] must be bound after it: a line that is masked although it is
//! waiting has had its edge.
//!
//! A line is unmasked when the control loop asks for it, and masked again by its edge: no line interrupts more than
//! once in a control period, whatever its signal.

use core::cell::RefCell;

use critical_section::{CriticalSection, Mutex};
use embassy_stm32::{
    interrupt::{self, InterruptExt, typelevel},
    pac,
};

use super::{lines, timers};

/// Number of port J for EXTICR.
const PORT_J: u8 = 9;
/// EXTI line of each encoder's switch pin.
const LINES: [usize; 4] = [0, 1, 2, 5];

/// State of an encoder's latch.
#[derive(Clone, Copy, PartialEq)]
enum Latch {
    /// Not used: its line stays masked.
    Unused,
    /// Used, but not requested: its line is masked.
    Masked,
    /// Waiting for an edge that latches the counter.
    Waits,
    /// Latched, not fetched yet: the count at the edge.
    At(u16),
}

static LATCHES: Mutex<RefCell<[Latch; 4]>> = Mutex::new(RefCell::new([Latch::Unused; 4]));

/// Selects the edges of the encoders that have index pulses: for each, true if its line is low during a pulse, `None`
/// without index pulses. The pins must be inputs.
pub(super) fn start(active_low: [Option<bool>; 4]) {
    critical_section::with(|cs| {
        let mut latches = LATCHES.borrow_ref_mut(cs);
        for ((latch, line), active_low) in latches.iter_mut().zip(LINES).zip(active_low) {
            let Some(active_low) = active_low else { continue };
            pac::SYSCFG.exticr(line / 4).modify(|w| w.set_exti(line % 4, PORT_J));
            pac::EXTI.rtsr(0).modify(|w| w.set_line(line, !active_low));
            pac::EXTI.ftsr(0).modify(|w| w.set_line(line, active_low));
            *latch = Latch::Masked;
        }
    });
    #[allow(unsafe_code, reason = "turns interrupts on")]
    // SAFETY: the handlers share state through critical sections only.
    unsafe {
        interrupt::EXTI0.enable();
        interrupt::EXTI1.enable();
        interrupt::EXTI2.enable();
        interrupt::EXTI9_5.enable();
    }
}

/// Returns the count of encoder `index` at its last index pulse since the last call; `None` without one.
pub(super) fn take(index: usize) -> Option<u16> {
    critical_section::with(|cs| {
        let mut latches = LATCHES.borrow_ref_mut(cs);
        let latch = latches.get_mut(index)?;
        let at = match *latch {
            Latch::Unused | Latch::Waits => return None,
            Latch::Masked => None,
            Latch::At(count) => Some(count),
        };
        *latch = Latch::Waits;
        let line = LINES[index];
        // A masked line also becomes pending, after an edge that was not waited for.
        pac::EXTI.pr(0).write(|w| w.set_line(line, true));
        pac::EXTI.imr(0).modify(|w| w.set_line(line, true));
        at
    })
}

/// Latches the counter at the beginning of encoder `index`'s pulse.
fn begun(cs: CriticalSection<'_>, index: usize) {
    let latch = &mut LATCHES.borrow_ref_mut(cs)[index];
    if *latch == Latch::Waits {
        let count = timers().get(index).map(|timer| timer.cnt().read().cnt());
        *latch = Latch::At(count.unwrap_or_else(|| lines::count(cs)));
    }
}

/// Handler of `EXTI0` to `EXTI2`, for the pulse with the same number.
pub struct Pulse;

impl Pulse {
    fn on_edge(index: usize) {
        critical_section::with(|cs| {
            // Latched first, because the counter runs on.
            begun(cs, index);
            pac::EXTI.imr(0).modify(|w| w.set_line(LINES[index], false));
            pac::EXTI.pr(0).write(|w| w.set_line(LINES[index], true));
        });
    }
}

macro_rules! handler {
    ($($vector:ident: $index:literal),+) => {$(
        impl typelevel::Handler<typelevel::$vector> for Pulse {
            #[allow(unsafe_code, reason = "the trait's")]
            unsafe fn on_interrupt() {
                Self::on_edge($index);
            }
        }
    )+};
}

handler!(EXTI0: 0, EXTI1: 1, EXTI2: 2);

/// Handler of `EXTI9_5`, to be bound after embassy's: for line 5, and for the other lines if embassy's handler ran
/// before theirs.
pub struct Restore;

impl typelevel::Handler<typelevel::EXTI9_5> for Restore {
    #[allow(unsafe_code, reason = "the trait's")]
    unsafe fn on_interrupt() {
        critical_section::with(|cs| {
            let open = pac::EXTI.imr(0).read();
            for (index, line) in LINES.into_iter().enumerate() {
                if !open.line(line) {
                    begun(cs, index);
                }
            }
        });
    }
}
