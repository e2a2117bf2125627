//! Channels: the numbered, typed inputs and outputs of a board, as a host sees them.

use core::{fmt, str::FromStr};

use heapless::Vec;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Kind of a channel. postcard sends the variant's position: append, never reorder or remove.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, Schema)]
#[serde(rename_all = "kebab-case")]
pub enum ChannelKind {
    /// Rotary motor on an OSMC bridge, closed loop by encoder.
    Osmc,
    /// Linear actuator on an OSMC bridge, closed loop by potentiometer.
    Actuator,
    /// Motor on a dual H-bridge (DHB-12).
    Dhb,
    /// Brushless drive: a voltage sets the speed, lines set direction and brake.
    Bldc,
    /// RC servo, set by pulse width.
    Servo,
    /// Stepper with a step/direction driver.
    Stepper,
    /// Relay, open or closed.
    Relay,
    /// Quadrature encoder as a channel of its own.
    Encoder,
    /// Switch input beside an encoder connector.
    Switch,
    /// Ultrasonic range sensor (trigger and echo).
    Range,
    /// Analog input behind a voltage divider.
    Analog,
    /// Supply rail, measured by an analog input.
    Supply,
    /// Output of the processor's digital-to-analog converter.
    Dac,
    /// Dead-man's handle (number 0) or auxiliary stop (number 1).
    DeadMan,
    /// Inertial measurement unit on the I2C bus.
    Imu,
    /// Current monitor on the I2C bus.
    Current,
    /// Absolute angle sensor on the I2C bus.
    Angle,
    /// Load cell on the I2C bus.
    Force,
    /// Optical distance sensor on the I2C bus.
    Distance,
}

/// One of the quantities that a channel measures together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quantity {
    /// Name with the unit, as in logs and programs.
    pub field: &'static str,
    /// Unit of the quantity on the wire.
    pub unit: Unit,
}

/// Maximum number of quantities that a channel measures together.
pub const MAX_QUANTITIES: usize = 6;

impl ChannelKind {
    const NAMES: [(Self, &'static str); 19] = [
        (Self::Osmc, "osmc"),
        (Self::Actuator, "actuator"),
        (Self::Dhb, "dhb"),
        (Self::Bldc, "bldc"),
        (Self::Servo, "servo"),
        (Self::Stepper, "stepper"),
        (Self::Relay, "relay"),
        (Self::Encoder, "encoder"),
        (Self::Switch, "switch"),
        (Self::Range, "range"),
        (Self::Analog, "analog"),
        (Self::Supply, "supply"),
        (Self::Dac, "dac"),
        (Self::DeadMan, "dead-man"),
        (Self::Imu, "imu"),
        (Self::Current, "current"),
        (Self::Angle, "angle"),
        (Self::Force, "force"),
        (Self::Distance, "distance"),
    ];

    /// Returns the quantities that a channel of this kind measures together, in the order of
    /// [`Sample::Sensor`](crate::Sample::Sensor)'s values; empty for a channel with one value.
    #[must_use]
    pub const fn quantities(self) -> &'static [Quantity] {
        const fn quantity(field: &'static str, unit: Unit) -> Quantity {
            Quantity { field, unit }
        }
        match self {
            Self::Imu => {
                const {
                    &[
                        quantity("acceleration_x_m_s2", Unit::MPerS2),
                        quantity("acceleration_y_m_s2", Unit::MPerS2),
                        quantity("acceleration_z_m_s2", Unit::MPerS2),
                        quantity("rate_x_rad_s", Unit::RadPerS),
                        quantity("rate_y_rad_s", Unit::RadPerS),
                        quantity("rate_z_rad_s", Unit::RadPerS),
                    ]
                }
            }
            Self::Current => const { &[quantity("current_a", Unit::A), quantity("voltage_v", Unit::V)] },
            Self::Angle => const { &[quantity("angle_rad", Unit::Rad)] },
            Self::Force => const { &[quantity("force_n", Unit::N)] },
            Self::Distance => const { &[quantity("distance_m", Unit::M)] },
            _ => &[],
        }
    }

    /// Returns the name used on command lines and in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        Self::NAMES[self as usize].1
    }
}

/// Name of one channel of a board, written `osmc0`, `actuator1`, `supply0` …
///
/// The number is the connector's: `osmc1` and `actuator1` are two uses of the same bridge connector.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, Schema)]
pub struct ChannelId {
    /// Kind of the channel.
    pub kind: ChannelKind,
    /// Number of the channel among those of its kind, from 0.
    pub index: u8,
}

impl ChannelId {
    /// Makes the name of channel number `index` of `kind`.
    #[must_use]
    pub const fn new(kind: ChannelKind, index: u8) -> Self {
        Self { kind, index }
    }
}

impl fmt::Display for ChannelId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}{}", self.kind.name(), self.index)
    }
}

/// Error of text that is no channel name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotAChannel;

impl fmt::Display for NotAChannel {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("not a channel name: write a kind and a number, as in osmc0 or actuator1")
    }
}

impl core::error::Error for NotAChannel {}

impl FromStr for ChannelId {
    type Err = NotAChannel;

    fn from_str(text: &str) -> Result<Self, NotAChannel> {
        let (name, digits) = text.split_at(text.find(|c: char| c.is_ascii_digit()).ok_or(NotAChannel)?);
        let (kind, _) = ChannelKind::NAMES.into_iter().find(|(_, known)| *known == name).ok_or(NotAChannel)?;
        Ok(Self { kind, index: digits.parse().map_err(|_| NotAChannel)? })
    }
}

/// Physical unit of a value on the wire.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum Unit {
    /// Angle at the output shaft, radians.
    Rad,
    /// Angular speed at the output shaft, radians per second.
    RadPerS,
    /// Position of a rod or distance, metres.
    M,
    /// Speed of a rod, metres per second.
    MPerS,
    /// Duty as a share of the supply, -1..=1.
    Duty,
    /// Voltage of a rail, input or output, volts.
    V,
    /// Boolean: 1 for on, 0 for off.
    Bool,
    /// Acceleration, metres per second squared.
    MPerS2,
    /// Current through a shunt, amperes.
    A,
    /// Force at a sensor or set point, newtons.
    N,
}

impl Unit {
    /// All units, in the order of the variants.
    pub const ALL: [Self; 10] = [
        Self::Rad,
        Self::RadPerS,
        Self::M,
        Self::MPerS,
        Self::Duty,
        Self::V,
        Self::Bool,
        Self::MPerS2,
        Self::A,
        Self::N,
    ];
}

impl fmt::Display for Unit {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Rad => "rad",
            Self::RadPerS => "rad/s",
            Self::M => "m",
            Self::MPerS => "m/s",
            Self::Duty => "duty",
            Self::V => "V",
            Self::Bool => "bool",
            Self::MPerS2 => "m/s2",
            Self::A => "A",
            Self::N => "N",
        })
    }
}

/// Mode of a set point: the quantity that it sets.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum Mode {
    /// Position, rad or m, in closed loop.
    Position,
    /// Speed, rad/s or m/s, in closed loop.
    Speed,
    /// Duty in open loop, a share of the supply; for a brushless drive a share of full speed.
    Duty,
    /// Switch state: 1 on, 0 off.
    Switch,
    /// Voltage of an analog output, V.
    Voltage,
    /// Brake: 1 applied, 0 released.
    Brake,
    /// Homing: seeks the home switch at this speed; the sign is the direction.
    Home,
    /// Position at the moment that the set point is dated with, on a smooth path through the points given before and
    /// after it: see [`PathPoint`](crate::PathPoint).
    Follow,
    /// Force, N, that the motor presses with.
    Force,
}

impl Mode {
    /// All modes, in the order of the variants.
    pub const ALL: [Self; 9] = [
        Self::Position,
        Self::Speed,
        Self::Duty,
        Self::Switch,
        Self::Voltage,
        Self::Brake,
        Self::Home,
        Self::Follow,
        Self::Force,
    ];
}

impl fmt::Display for Mode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Position => "position",
            Self::Speed => "speed",
            Self::Duty => "duty",
            Self::Switch => "switch",
            Self::Voltage => "voltage",
            Self::Brake => "brake",
            Self::Home => "home",
            Self::Follow => "follow",
            Self::Force => "force",
        })
    }
}

/// Closed interval of `f32`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Range {
    /// Lowest value of the interval.
    pub min: f32,
    /// Highest value of the interval.
    pub max: f32,
}

impl Range {
    /// Makes the interval from `min` to `max`.
    #[must_use]
    pub const fn new(min: f32, max: f32) -> Self {
        Self { min, max }
    }

    /// Makes the interval from `-limit` to `limit`.
    #[must_use]
    pub const fn symmetric(limit: f32) -> Self {
        Self { min: -limit, max: limit }
    }

    /// Returns whether `value` lies in the interval, ends included; false for NaN.
    #[must_use]
    pub fn contains(self, value: f32) -> bool {
        value >= self.min && value <= self.max
    }
}

/// Mode that a channel takes set points in.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ModeInfo {
    /// Mode of the set points.
    pub mode: Mode,
    /// Unit of the set points.
    pub unit: Unit,
    /// Range of set points that the channel takes.
    pub range: Range,
}

/// Description of a channel, as the board itself gives it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ChannelInfo {
    /// Name of the channel.
    pub id: ChannelId,
    /// Unit of the measured value or, for a pure output, of the set point.
    pub unit: Unit,
    /// Range of that value, in `unit`.
    pub range: Range,
    /// Rate at which the value is updated.
    pub rate_hz: f32,
    /// Value of one count of `position` in a [`crate::Sample`], in `unit`; 0 for a channel without position.
    pub resolution: f32,
    /// Modes in which the channel takes set points; empty for an input.
    pub modes: Vec<ModeInfo, MAX_MODES>,
}

/// Maximum number of modes of one channel.
pub const MAX_MODES: usize = 6;

impl ChannelInfo {
    /// Returns unit and range of set points in `mode`, or `None` when the channel does not have that mode.
    #[must_use]
    pub fn mode(&self, mode: Mode) -> Option<&ModeInfo> {
        self.modes.iter().find(|info| info.mode == mode)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_come_back() {
        for (kind, name) in ChannelKind::NAMES {
            assert_eq!(kind.name(), name, "the table is in the order of the variants");
            let id = ChannelId::new(kind, 15);
            let mut text = heapless::String::<16>::new();
            core::fmt::write(&mut text, format_args!("{id}")).expect("fits");
            assert_eq!(text.parse(), Ok(id));
        }
        for bad in ["", "osmc", "7", "motor1", "osmc-1", "osmc256", "OSMC0", "osmc0 "] {
            assert_eq!(bad.parse::<ChannelId>(), Err(NotAChannel), "{bad}");
        }
    }
}
