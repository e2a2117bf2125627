//! The independent watchdog IWDG1: it runs from its own oscillator and cannot be stopped.
//!
//! It starts before the clocks do, with time for the boot, and is drawn tight before the tasks start. From then on only the
//! supervisor's heartbeat feeds it (see `safety_pins`), so that a supervisor that does not run resets the board, and with it
//! turns the stop lines safe.

use embassy_stm32::pac::{
    IWDG1,
    iwdg::vals::{Key, Pr},
};

/// Reads of the busy flag at most: registers take five cycles of the 32 kHz clock, 0.16 ms, to follow.
const PATIENCE: u32 = 200_000;

/// For the boot: the crystal's start, reading the flash, erasing a damaged log in it (2 s a sector). 4096 periods of
/// 256 cycles of 32 kHz are 32 s.
pub(crate) fn start_for_boot() {
    IWDG1.kr().write(|w| w.set_key(Key::START));
    set(Pr::DIVIDE_BY256, 0xFFF);
}

/// For the tasks: 20 ms, 160 periods of 4 cycles of 32 kHz. The supervisor feeds it every millisecond; it has the highest
/// priority of all tasks, so what delays it is only interrupts and critical sections, far below one more. 17 to 22 ms with the
/// tolerance of the oscillator.
pub(crate) fn tighten() {
    set(Pr::DIVIDE_BY4, 159);
}

/// Begins the period anew.
pub(crate) fn feed() {
    IWDG1.kr().write(|w| w.set_key(Key::RESET));
}

fn set(prescaler: Pr, reload: u16) {
    let busy = || {
        let status = IWDG1.sr().read();
        status.pvu() || status.rvu()
    };
    IWDG1.kr().write(|w| w.set_key(Key::ENABLE));
    // Also if it stays busy: a write that is ignored leaves the longer period.
    let _ = (0..PATIENCE).any(|_| !busy());
    IWDG1.pr().write(|w| w.set_pr(prescaler));
    IWDG1.rlr().write(|w| w.set_rl(reload));
    let _ = (0..PATIENCE).any(|_| !busy());
    feed();
}
