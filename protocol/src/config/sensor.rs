//! Sensors on the bus with the output chips: one list for all kinds, one row of [`SensorChip`] for each chip.

use core::ops::RangeInclusive;

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::{ConfigError, check, positive};
use crate::channel::{ChannelId, ChannelKind, Range};

/// Maximum number of sensors on the bus: as many samples as fit a frame of telemetry beside four of motors.
pub const MAX_SENSORS: usize = 4;

/// Standard gravity, m/s² per g, by definition (ISO 80000-3).
const G_M_S2: f32 = 9.806_65;

/// Returns the bits on the bus for a transfer of this many bytes, addresses included: nine each, START, STOP and the
/// time between.
#[must_use]
pub const fn bus_bits(bytes: u32) -> u32 {
    9 * bytes + 3
}

/// Sensor on the bus with the output chips.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct SensorConfig {
    /// Kind of the chip's channel, and its number.
    pub id: ChannelId,
    /// I2C address of the chip, 7 bits.
    pub address: u8,
    /// Readings per second, Hz.
    pub rate_hz: u16,
    /// Chip with its settings.
    pub chip: SensorChip,
}

/// Chips that have a driver, with their settings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum SensorChip {
    /// TDK ICM-20948: accelerations and angular rates about three axes.
    Icm20948(Icm20948Config),
    /// TI INA226: a current, through a shunt, and a voltage.
    Ina226(Ina226Config),
    /// ams AS5600: the angle of a magnet in front of it.
    As5600(As5600Config),
    /// Nuvoton NAU7802: the force on a load cell, from its bridge.
    Nau7802(Nau7802Config),
    /// ST VL6180X: the distance of the object in front of it.
    Vl6180x(Vl6180xConfig),
}

/// Full scales of an ICM-20948.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Icm20948Config {
    /// Largest acceleration, g: 2, 4, 8 or 16.
    pub acceleration_max_g: u8,
    /// Largest angular rate, °/s: 250, 500, 1000 or 2000.
    pub rate_max_deg_s: u16,
}

/// Shunt of an INA226.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Ina226Config {
    /// Shunt resistance, Ω; positive.
    pub shunt_ohm: f32,
}

/// Filter of an AS5600.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct As5600Config {
    /// Averages of the slow filter: 2, 4, 8 or 16. Each doubling halves the power of the noise and doubles the settling
    /// time, from 0.286 ms and 0.043° rms at 2.
    pub averages: u8,
}

/// Gain of an NAU7802, and the load cell in front of it.
///
/// The output of a bridge is proportional to the voltage that feeds it, in mV/V. The converter measures that ratio,
/// whatever the supply.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Nau7802Config {
    /// Gain of the amplifier: 1, 2, 4, 8, 16, 32, 64 or 128. It measures up to 500 mV/V divided by this, either way.
    pub gain: u8,
    /// Force per mV/V of the bridge, N: the cell's rated force divided by its rated output. Negative for a cell mounted
    /// the other way round.
    pub newtons_per_mv_v: f32,
    /// Output of the bridge without a force, mV/V.
    pub zero_mv_v: f32,
}

/// Settings of a VL6180X: none but the rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Vl6180xConfig {}

/// Farthest distance that is read of a VL6180X, m: it is specified up to 0.1 m, and measures bright targets farther
/// away.
pub const VL6180X_FARTHEST_M: f32 = 0.2;

/// Rates of an NAU7802, Hz.
pub const NAU7802_RATES_HZ: [u16; 5] = [10, 20, 40, 80, 320];

/// Ratio at the input of an NAU7802 that is its full scale at gain 1, mV/V: half its reference, which feeds the bridge.
pub const NAU7802_FULL_SCALE_MV_V: f32 = 500.0;

/// Counts of an AS5600 in one turn.
pub const AS5600_COUNTS: u16 = 4096;

/// Largest voltage at a shunt that an INA226 measures, V.
const INA226_SHUNT_V: f32 = 0.081_92;

/// Properties of a chip that the board needs apart from its registers.
#[derive(Clone, Debug, PartialEq)]
pub struct SensorDescription {
    /// Kind of its channel.
    pub kind: ChannelKind,
    /// Range of addresses that the chip can have.
    pub addresses: RangeInclusive<u8>,
    /// Range of rates at which the chip can be read, Hz.
    pub rates_hz: RangeInclusive<u16>,
    /// Range of the first of its quantities, in that quantity's unit.
    pub range: Range,
    /// Bits on the bus of its longest transfer, at most 0.45 ms at 400 kHz.
    pub longest_bits: u32,
    /// Bits on the bus of all transfers of one reading.
    pub reading_bits: u32,
    /// Number of transfers for one reading.
    pub transfers: u32,
}

impl SensorChip {
    /// Returns the properties of the chip.
    #[must_use]
    pub fn description(&self) -> SensorDescription {
        match self {
            // Two addresses, a register and the status; then the same and twelve bytes.
            Self::Icm20948(chip) => SensorDescription {
                kind: ChannelKind::Imu,
                addresses: 0x68..=0x69,
                rates_hz: 5..=400,
                range: Range::symmetric(f32::from(chip.acceleration_max_g) * G_M_S2),
                longest_bits: bus_bits(15),
                reading_bits: bus_bits(4) + bus_bits(15),
                transfers: 2,
            },
            // Ready flag, shunt and bus voltage: two addresses, a register and its two bytes each.
            Self::Ina226(chip) => SensorDescription {
                kind: ChannelKind::Current,
                addresses: 0x40..=0x4F,
                rates_hz: 1..=333,
                range: Range::symmetric(INA226_SHUNT_V / chip.shunt_ohm),
                longest_bits: bus_bits(5),
                reading_bits: 3 * bus_bits(5),
                transfers: 3,
            },
            // Two addresses, a register, the status and two bytes of the angle.
            Self::As5600(_) => SensorDescription {
                kind: ChannelKind::Angle,
                addresses: 0x36..=0x36,
                rates_hz: 1..=1000,
                range: Range::new(0.0, core::f32::consts::TAU),
                longest_bits: bus_bits(6),
                reading_bits: bus_bits(6),
                transfers: 1,
            },
            // Two addresses, a register and the ready flag; then the same and three bytes. A check of the settings
            // reads three bytes.
            Self::Nau7802(chip) => SensorDescription {
                kind: ChannelKind::Force,
                addresses: 0x2A..=0x2A,
                rates_hz: 10..=320,
                range: chip.range(),
                longest_bits: bus_bits(6),
                reading_bits: bus_bits(4) + bus_bits(6),
                transfers: 2,
            },
            // Two addresses, a register of two bytes and three of status; the same and the distance; one address, a
            // register and the value that clears the flag.
            Self::Vl6180x(_) => SensorDescription {
                kind: ChannelKind::Distance,
                addresses: 0x29..=0x29,
                rates_hz: 1..=50,
                range: Range::new(0.0, VL6180X_FARTHEST_M),
                longest_bits: bus_bits(7),
                reading_bits: bus_bits(7) + bus_bits(5) + bus_bits(4),
                transfers: 3,
            },
        }
    }

    fn validate(&self, id: ChannelId, rate_hz: u16) -> Result<(), ConfigError> {
        let rule = |holds: bool, rule| check(Some(id), holds, rule);
        match self {
            Self::Icm20948(chip) => {
                rule([2, 4, 8, 16].contains(&chip.acceleration_max_g), "acceleration_max_g must be 2, 4, 8 or 16")?;
                rule(
                    [250, 500, 1000, 2000].contains(&chip.rate_max_deg_s),
                    "rate_max_deg_s must be 250, 500, 1000 or 2000",
                )
            }
            Self::Ina226(chip) => rule(positive(chip.shunt_ohm), "shunt_ohm must be positive"),
            Self::As5600(chip) => rule([2, 4, 8, 16].contains(&chip.averages), "averages must be 2, 4, 8 or 16"),
            Self::Nau7802(chip) => {
                rule(NAU7802_RATES_HZ.contains(&rate_hz), "rate_hz must be 10, 20, 40, 80 or 320")?;
                rule(chip.gain.is_power_of_two() && chip.gain <= 128, "gain must be 1, 2, 4, 8, 16, 32, 64 or 128")?;
                rule(positive(chip.newtons_per_mv_v.abs()), "newtons_per_mv_v must be positive or negative")?;
                let full_scale_mv_v = NAU7802_FULL_SCALE_MV_V / f32::from(chip.gain);
                // An offset beyond the range would saturate every reading.
                rule(chip.zero_mv_v.abs() < full_scale_mv_v, "zero_mv_v must be within 500 mV/V divided by gain")
            }
            // The chip counts its period in steps of 10 ms.
            Self::Vl6180x(_) => rule(rate_hz > 0 && 100 % rate_hz == 0, "rate_hz must be 1, 2, 4, 5, 10, 20, 25 or 50"),
        }
    }
}

impl Nau7802Config {
    /// Returns the forces at both ends of the converter's range, N.
    fn range(&self) -> Range {
        // A gain of 0 is refused by `validate`, but the range may be asked before.
        let full_scale_mv_v = NAU7802_FULL_SCALE_MV_V / f32::from(self.gain.max(1));
        let [low, high] = [-full_scale_mv_v, full_scale_mv_v].map(|end| (end - self.zero_mv_v) * self.newtons_per_mv_v);
        Range::new(low.min(high), low.max(high))
    }
}

impl SensorConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let rule = |holds: bool, rule| check(Some(self.id), holds, rule);
        let SensorDescription { kind, addresses, rates_hz, .. } = self.chip.description();
        rule(self.id.kind == kind, "the channel's name must be of the kind that the chip measures")?;
        rule(addresses.contains(&self.address), "the chip cannot have this address")?;
        rule(rates_hz.contains(&self.rate_hz), "the chip cannot be read at this rate_hz")?;
        self.chip.validate(self.id, self.rate_hz)
    }
}
