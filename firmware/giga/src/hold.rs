//! Hold mode of a board whose firmware ended badly several times in a row, or whose image in flash is damaged
//! (`image`).
//!
//! It only keeps the outputs safe: the stop lines are driven, the safe state is written to every output chip again and
//! again, and only this feeds the watchdog. No loop is closed, no sensor is read, and of the saved parameters only the
//! CAN bus's rates and the board's number on it are used. The heartbeat stands still, so that a charge pump on it opens
//! the motors' supply. The red light flashes. In the first of two stages the links to hosts run beside it, by
//! interrupts, and the board reports the cause; it cannot be armed. In the second, when the first has ended badly too,
//! nothing else runs at all, from the internal oscillator.
//!
//! Both end by switching off and on, by the reset pin or a debugger; the first also by a host's request to restart.

use r4_protocol::config::BoardConfig;

use crate::{
    cycles::{AT_RESET_MHZ, Deadline, RUNNING_MHZ},
    safety_pins,
    sweep::Sweeper,
    watchdog,
};

/// Interval between two sweeps, of 1.5 ms each: as often as the running firmware rewrites the safe state.
const PERIOD_US: u32 = 16_000;
/// Half a flash of the red light, 0.13 s, in sweeps: three times as fast as any other flashing.
const HALF_FLASH: u32 = 8;

/// Holds the outputs safe beside links that run by interrupts.
pub(crate) fn beside_links(config: &BoardConfig) -> ! {
    hold(config, RUNNING_MHZ)
}

/// Holds the outputs safe with nothing else running.
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
        // A chip that does not answer now is written again in the next turn.
        let _ = sweeper.sweep(config);
        watchdog::feed();
        sweeps = sweeps.wrapping_add(1);
        next.wait();
    }
}
