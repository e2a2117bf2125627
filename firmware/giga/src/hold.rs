//! Hold mode: what a board does whose firmware ended badly several times in a row, or is not whole in flash (`image`).
//!
//! It only keeps its outputs safe: the stop lines are driven, every output chip is told its safe state again and again, and that
//! alone feeds the watchdog. No loop is closed, no sensor is read, of what was saved only the CAN bus's rates and the board's number
//! on it are used, and the heartbeat stands still, so that a charge pump on it opens the motors' supply. The red light flashes. In
//! the first of two stages the links to hosts run beside it, by interrupts, and the board answers why; it cannot be armed. In the
//! second, when the first has ended badly too, nothing else runs at all, from the internal oscillator.
//!
//! Both are left by switching off and on, by the reset pin or a debugger; the first also by a host's request to restart.

use r4_protocol::config::BoardConfig;

use crate::{
    cycles::{AT_RESET_MHZ, Deadline, RUNNING_MHZ},
    safety_pins,
    sweep::Sweeper,
    watchdog,
};

/// From one sweep to the next, each of 1.5 ms: as often as the running firmware writes the safe state again.
const PERIOD_US: u32 = 16_000;
/// Half a flash of the red light, 0.13 s: three times as fast as anything else that flashes.
const HALF_FLASH: u32 = 8;

/// Holds the outputs beside links that run by interrupts.
pub(crate) fn beside_links(config: &BoardConfig) -> ! {
    hold(config, RUNNING_MHZ)
}

/// Holds the outputs, and nothing else runs.
pub(crate) fn alone(config: &BoardConfig) -> ! {
    cortex_m::interrupt::disable();
    hold(config, AT_RESET_MHZ)
}

fn hold(config: &BoardConfig, mhz: u32) -> ! {
    let mut sweeper = Sweeper::new(mhz);
    let mut sweeps: u32 = 0;
    loop {
        let next = Deadline::after_us(PERIOD_US, mhz);
        safety_pins::stop();
        safety_pins::show_hold((sweeps / HALF_FLASH).is_multiple_of(2));
        // A chip that does not answer now is told again in the next turn.
        let _ = sweeper.sweep(config);
        watchdog::feed();
        sweeps = sweeps.wrapping_add(1);
        next.wait();
    }
}
