//! TI INA226: current through a shunt and voltage of its bus. Section and table numbers are those of its datasheet,
//! SBOS547A.

use embassy_time::Duration;
use r4_protocol::{channel::MAX_QUANTITIES, config::Ina226Config};

use super::sensor::{Driver, Exchange, Outcome, saturation};

// Registers (table 2).
const CONFIGURATION: u8 = 0x00;
const SHUNT_VOLTAGE: u8 = 0x01;
const BUS_VOLTAGE: u8 = 0x02;
const MASK_ENABLE: u8 = 0x06;
const MANUFACTURER_ID: u8 = 0xFE;
const DIE_ID: u8 = 0xFF;

/// Values of the identity registers: "TI" (7.6.9) and the die (7.6.10).
const MANUFACTURER: [u8; 2] = *b"TI";
const DIE: [u8; 2] = [0x22, 0x60];
/// CONFIGURATION (7.6.1): reset, after which all registers are as after power-up.
const RESET: [u8; 2] = [0x80, 0x00];
/// CONFIGURATION: bit 14, which always reads 1; continuous conversions of shunt and bus, 1.1 ms each.
const CONTINUOUS: u16 = 1 << 14 | 0b100 << 6 | 0b100 << 3 | 0b111;
const AVERAGES_AT: u16 = 9;
/// Numbers of conversions that the chip can average (table 6).
const AVERAGES: [u32; 8] = [1, 4, 16, 64, 128, 256, 512, 1024];
/// Longest time of one shunt and one bus conversion of nominally 1.1 ms each (6.5), µs.
const BOTH_US: u32 = 2 * 1210;
/// MASK_ENABLE (7.6.7), lower byte: all conversions and averages are done.
const CONVERSION_READY: u8 = 1 << 3;
/// Volts per count of the shunt and bus registers (7.6.2, 7.6.3).
const SHUNT_V: f32 = 2.5e-6;
const BUS_V: f32 = 1.25e-3;
/// Time from a reset to the registers' values: our choice, the datasheet gives none.
const START_UP: Duration = Duration::from_millis(1);

/// Step of the driver: the transfer that follows.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Manufacturer,
    Die,
    Reset,
    Set,
    Check,
    Status,
    Shunt,
    Bus,
}

/// Driver of one INA226.
#[derive(Clone, Debug)]
pub struct Ina226 {
    state: State,
    configuration: [u8; 2],
    amperes_per_count: f32,
    /// Shunt voltage of the reading under way, counts.
    counts: i16,
}

impl Ina226 {
    /// Creates a driver for `rate_hz` readings per second, 1 to 333. Each reading is the mean of as many conversions as
    /// fit its period.
    #[must_use]
    pub fn new(config: &Ina226Config, rate_hz: u16) -> Self {
        let period_us = 1_000_000 / u32::from(rate_hz.max(1));
        let averages = AVERAGES.iter().rposition(|count| count * BOTH_US <= period_us).unwrap_or(0) as u16;
        Self {
            state: State::Manufacturer,
            configuration: (CONTINUOUS | averages << AVERAGES_AT).to_be_bytes(),
            amperes_per_count: SHUNT_V / config.shunt_ohm,
            counts: 0,
        }
    }
}

impl Driver for Ina226 {
    fn restart(&mut self) {
        self.state = State::Manufacturer;
    }

    fn next(&self) -> Exchange {
        match self.state {
            State::Manufacturer => Exchange::get(MANUFACTURER_ID, 2),
            State::Die => Exchange::get(DIE_ID, 2),
            State::Reset => Exchange::set_both(CONFIGURATION, RESET),
            State::Set => Exchange::set_both(CONFIGURATION, self.configuration),
            State::Check => Exchange::get(CONFIGURATION, 2),
            State::Status => Exchange::get(MASK_ENABLE, 2),
            State::Shunt => Exchange::get(SHUNT_VOLTAGE, 2),
            State::Bus => Exchange::get(BUS_VOLTAGE, 2),
        }
    }

    fn done(&mut self, read: &[u8]) -> Outcome {
        let (state, outcome) = match (self.state, read) {
            (State::Manufacturer, read) if *read == MANUFACTURER => (State::Die, Outcome::Next),
            (State::Die, read) if *read == DIE => (State::Reset, Outcome::Next),
            (State::Reset, _) => (State::Set, Outcome::Wait(START_UP)),
            (State::Set, _) => (State::Check, Outcome::Next),
            (State::Check, read) if *read == self.configuration => (State::Status, Outcome::Next),
            (State::Status, [_, low]) if low & CONVERSION_READY != 0 => (State::Shunt, Outcome::Next),
            (State::Status, _) => (State::Status, Outcome::NotReady),
            (State::Shunt, [high, low]) => {
                self.counts = i16::from_be_bytes([*high, *low]);
                (State::Bus, Outcome::Next)
            }
            (State::Bus, [high, low]) => {
                let mut values = [0.0; MAX_QUANTITIES];
                let bus = u16::from_be_bytes([*high, *low]);
                let measured = [f32::from(self.counts) * self.amperes_per_count, f32::from(bus) * BUS_V];
                values.iter_mut().zip(measured).for_each(|(value, measured)| *value = measured);
                let saturated = self.counts == i16::MAX || self.counts == i16::MIN;
                (State::Status, Outcome::Reading { values, quality: saturation(saturated) })
            }
            _ => (State::Manufacturer, Outcome::WrongChip),
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
        let config = Ina226Config { shunt_ohm: 0.005 };
        let planned = SensorChip::Ina226(config).description();
        let taken = taken(&mut Ina226::new(&config, 100), |driver| match driver.state {
            State::Manufacturer => MANUFACTURER.into(),
            State::Die => DIE.into(),
            State::Check => driver.configuration.into(),
            _ => [0, CONVERSION_READY].into(),
        });
        assert_eq!(taken, Taken::planned(&planned));
    }

    /// The number of averages is the largest whose conversions, at most 2.42 ms for each pair, fit the period of the
    /// readings.
    #[test]
    fn a_reading_is_the_mean_of_what_its_period_has_room_for() {
        for (rate_hz, averages) in [(333, 0), (104, 0), (103, 1), (25, 2), (1, 5)] {
            let driver = Ina226::new(&Ina226Config { shunt_ohm: 0.1 }, rate_hz);
            assert_eq!(driver.configuration[0] >> 1 & 7, averages, "{rate_hz} Hz");
        }
    }
}
