//! ams AS5600 magnetic angle sensor, 4096 counts per turn. Page and figure numbers are those of its datasheet, v1-06 of
//! 2018-06-20.
//!
//! The driver uses only RAW ANGLE: ANGLE depends on what may have been burnt into the chip and has an uneven step at 0
//! (page 19). Status and angle come in one transfer. The datasheet does not say whether the chip latches both bytes of
//! the angle together, so the user of the angle must tolerate a reading that is off by a multiple of 256 counts.
//!
//! The chip has no identity register; the only check is that it keeps its settings. A chip whose supply fails for less
//! than three transfers restarts with its burnt-in settings, thus with a slower filter, until it is set up again.

use r4_protocol::{
    Quality,
    channel::MAX_QUANTITIES,
    config::{AS5600_COUNTS, As5600Config},
};

use super::sensor::{Driver, Exchange, Outcome};

// Registers (figure 21).
const CONF: u8 = 0x07;
const STATUS: u8 = 0x0B;

/// Bits of the two CONF bytes (figure 22) that the driver leaves as they are. It sets the upper byte to watchdog off
/// and slow filter only (SF), the lower byte to normal power mode without hysteresis. The kept bits concern the output.
const CONF_KEPT: [u8; 2] = [0xC0, 0xF0];
/// STATUS register bits (figure 23).
const MAGNET_DETECTED: u8 = 1 << 5;
const MAGNET_WEAK: u8 = 1 << 4;
const MAGNET_STRONG: u8 = 1 << 3;

/// Step of the driver: the transfer that follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Before,
    Set,
    Check,
    Angle,
}

/// Driver of one AS5600.
#[derive(Clone, Debug)]
pub struct As5600 {
    state: State,
    slow_filter: u8,
    /// CONF as it must read back after the set-up.
    configuration: [u8; 2],
}

impl As5600 {
    /// Creates a driver with the filter of `config`. The rate has no influence: the chip measures on its own.
    #[must_use]
    pub fn new(config: &As5600Config, _rate_hz: u16) -> Self {
        // SF (figure 22): 00 averages 16 samples, 11 averages 2.
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

    /// The bus schedule relies on the transfer lengths in the configuration's chip description.
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
