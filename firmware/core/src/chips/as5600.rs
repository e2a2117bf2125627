//! ams AS5600: the angle of a magnet in front of it, in 4096 counts to a turn. Page and figure numbers are those of its datasheet, v1-06
//! of 2018-06-20.
//!
//! Only RAW ANGLE is used: ANGLE depends on what may have been burnt into the chip, and does not pass 0 evenly (page 19). The status and
//! the angle behind it come in one transfer; whether the chip keeps both bytes of the angle together in it, the datasheet does not say,
//! so whoever uses the angle must bear a reading that is a multiple of 256 counts off.
//!
//! Nothing tells the chip from another one at its address but that it keeps its settings. One whose supply fails for less than three
//! transfers comes back with the settings that were burnt into it, so with a slower filter, until it is set up again.

use r4_protocol::{
    Quality,
    channel::MAX_QUANTITIES,
    config::{AS5600_COUNTS, As5600Config},
};

use super::sensor::{Driver, Exchange, Outcome};

// Registers (figure 21).
const CONF: u8 = 0x07;
const STATUS: u8 = 0x0B;

/// CONF (figure 22), both bytes: watchdog off and the slow filter alone, which SF says, in the upper one, and the normal power mode
/// without hysteresis in the lower one. The other bits, of the output, are left as they are.
const CONF_KEPT: [u8; 2] = [0xC0, 0xF0];
/// STATUS (figure 23).
const MAGNET_DETECTED: u8 = 1 << 5;
const MAGNET_WEAK: u8 = 1 << 4;
const MAGNET_STRONG: u8 = 1 << 3;

/// What the next transfer is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Before,
    Set,
    Check,
    Angle,
}

/// The driver of one chip.
#[derive(Clone, Debug)]
pub struct As5600 {
    state: State,
    slow_filter: u8,
    /// What CONF is to be.
    configuration: [u8; 2],
}

impl As5600 {
    /// Set up by `config`; it measures by itself, at any rate.
    #[must_use]
    pub fn new(config: &As5600Config, _rate_hz: u16) -> Self {
        // SF: 00 is 16 times, 11 is twice.
        let slow_filter = match config.averages {
            16.. => 0b00,
            8.. => 0b01,
            4.. => 0b10,
            _ => 0b11,
        };
        Self { state: State::Before, slow_filter, configuration: [0; 2] }
    }
}

impl Driver for As5600 {
    fn restart(&mut self) {
        self.state = State::Before;
    }

    fn next(&self) -> Exchange {
        match self.state {
            State::Before | State::Check => Exchange::get(CONF, 2),
            State::Set => Exchange::set_both(CONF, self.configuration),
            State::Angle => Exchange::get(STATUS, 3),
        }
    }

    fn done(&mut self, read: &[u8]) -> Outcome {
        let (state, outcome) = match (self.state, read) {
            (State::Before, [high, low]) => {
                self.configuration = [high & CONF_KEPT[0] | self.slow_filter, low & CONF_KEPT[1]];
                (State::Set, Outcome::Next)
            }
            (State::Set, _) => (State::Check, Outcome::Next),
            (State::Check, read) if *read == self.configuration => (State::Angle, Outcome::Next),
            (State::Angle, [status, high, low]) => {
                let counts = u16::from_be_bytes([*high, *low]) & (AS5600_COUNTS - 1);
                let mut values = [0.0; MAX_QUANTITIES];
                values[0] = f32::from(counts) * (core::f32::consts::TAU / f32::from(AS5600_COUNTS));
                let has = |bit| status & bit != 0;
                let quality = if !has(MAGNET_DETECTED) {
                    Quality::NoMagnet
                } else if has(MAGNET_WEAK) {
                    Quality::WeakMagnet
                } else if has(MAGNET_STRONG) {
                    Quality::StrongMagnet
                } else {
                    Quality::Good
                };
                (State::Angle, Outcome::Reading { values, quality })
            }
            _ => (State::Before, Outcome::WrongChip),
        };
        self.state = state;
        outcome
    }
}

#[cfg(test)]
mod tests {
    use r4_protocol::config::SensorChip;

    use super::{
        super::sensor::tests::{Taken, taken},
        *,
    };

    /// The board plans the bus by what the configuration says of the chip.
    #[test]
    fn transfers_are_as_long_as_the_board_plans_them() {
        let config = As5600Config { averages: 2 };
        let planned = SensorChip::As5600(config).description();
        let taken = taken(&mut As5600::new(&config, 1000), |driver| match driver.state {
            State::Before => [0, 0].into(),
            State::Set => [].into(),
            State::Check => driver.configuration.into(),
            State::Angle => [MAGNET_DETECTED, 0x0F, 0xFF].into(),
        });
        assert_eq!(taken, Taken::planned(&planned));
    }
}
