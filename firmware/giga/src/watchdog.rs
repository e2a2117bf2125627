//! Independent watchdog IWDG1: it runs from its own oscillator and cannot be stopped.
//!
//! It starts before the clocks do, gets a longer period for the boot when the outputs are safe, and a short one before
//! the tasks start. From then on only the supervisor's heartbeat feeds it (see `safety_pins`), so that a supervisor
//! that does not run resets the board, which also makes the stop lines safe.

use core::sync::atomic::{AtomicBool, Ordering};

use embassy_stm32::pac::{
    IWDG1,
    iwdg::vals::{Key, Pr},
};

/// Maximum number of reads of the busy flag: registers take five cycles of the 32 kHz clock, 0.16 ms, to follow.
const PATIENCE: u32 = 200_000;

/// Starts the watchdog with the period of its reset value, 512 ms: registers take a while to change, and outputs wait.
pub(crate) fn start() {
    IWDG1.kr().write(|w| w.set_key(Key::START));
}

/// Sets the period for the boot: 256 ms, 2048 periods of 4 cycles of 32 kHz (238 to 275 with the tolerance of the
/// oscillator). On the emulated board the longest stretch of the boot without [`feed`] is a fifth of that; if a sector
/// of flash has to be erased, which takes a second or two, the wait for it feeds the watchdog and has a limit of its
/// own (`flash.rs`).
pub(crate) fn allow_boot() {
    set(Pr::DIVIDE_BY4, 2047);
}

/// Number of supervisor heartbeats per feed of the watchdog: every 10 ms of the timers' time.
pub(crate) const BEATS: u8 = 10;
/// Reload value for the tasks: 13 ms, 104 periods of 4 cycles of 32 kHz.
const TASKS_RELOAD: u16 = 103;
/// Window value for the tasks: a feed before 8.5 ms, 68 such periods, also resets.
const TASKS_WINDOW: u16 = TASKS_RELOAD - 68;

/// Sets the period for the tasks: the supervisor feeds it every [`BEATS`] ms. It has the highest priority of all tasks,
/// so only interrupts and critical sections delay it, far below one millisecond.
///
/// The window makes two clocks check each other: LSI, which counts here, and the crystal and PLL behind the
/// supervisor's period. LSI is between 29.8 and 33.6 kHz at any temperature (STM32H747 datasheet, LSI oscillator
/// characteristics), so the window is open at least from 9.2 to 12.4 ms, and at most from 8.1 to 14.0 ms of true time:
/// feeding every 10 ms is right at any temperature, and timers that are more than 24 % too fast or 29 % too slow, as
/// with a crystal of another frequency or a PLL that lost its lock, are found within one period.
pub(crate) fn tighten() {
    BOOTING.store(false, Ordering::Relaxed);
    set(Pr::DIVIDE_BY4, TASKS_RELOAD);
    IWDG1.kr().write(|w| w.set_key(Key::ENABLE));
    // This write refreshes the counter, too (RM0399, 49.3.3).
    IWDG1.winr().write(|w| w.set_win(TASKS_WINDOW));
}

/// Restarts the watchdog's period.
pub(crate) fn feed() {
    IWDG1.kr().write(|w| w.set_key(Key::RESET));
}

/// True until the tasks start.
static BOOTING: AtomicBool = AtomicBool::new(true);

/// Restarts the period while the board boots: for waits that have a limit of their own. Later only the supervisor feeds
/// it.
pub(crate) fn feed_in_boot() {
    if BOOTING.load(Ordering::Relaxed) {
        feed();
    }
}

fn set(prescaler: Pr, reload: u16) {
    let busy = || {
        let status = IWDG1.sr().read();
        status.pvu() || status.rvu()
    };
    IWDG1.kr().write(|w| w.set_key(Key::ENABLE));
    // Continues even if it stays busy: a write that is ignored leaves the longer period.
    let _ = (0..PATIENCE).any(|_| !busy());
    IWDG1.pr().write(|w| w.set_pr(prescaler));
    IWDG1.rlr().write(|w| w.set_rl(reload));
    let _ = (0..PATIENCE).any(|_| !busy());
    feed();
}
