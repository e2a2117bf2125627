//! Channels: the numbered, typed inputs and outputs by which a host knows a board.

use core::{fmt, str::FromStr};

use heapless::Vec;
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// What a channel is. postcard sends the variant's position: append, never reorder or remove.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, Schema)]
#[serde(rename_all = "kebab-case")]
pub enum ChannelKind {
    /// Rotary motor on an OSMC bridge, closed loop by encoder.
    Osmc,
    /// Linear actuator on an OSMC bridge, closed loop by potentiometer.
    Actuator,
    /// Motor on a dual H-bridge (DHB-12).
    Dhb,
    /// Brushless drive: speed voltage, direction, brake.
    Bldc,
    /// RC servo.
    Servo,
    /// Step/direction driver.
    Stepper,
    /// Relay.
    Relay,
    /// Quadrature encoder.
    Encoder,
    /// The switch beside an encoder.
    Switch,
    /// Ultrasonic range sensor.
    Range,
    /// Divided analog input.
    Analog,
    /// Supply rail.
    Supply,
    /// Digital-to-analog output.
    Dac,
    /// Dead-man's handle.
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

/// One of the numbers that a channel measures together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quantity {
    /// Its name with its unit, as logs and programs have it.
    pub field: &'static str,
    /// Its unit.
    pub unit: Unit,
}

/// Most numbers that a channel measures together.
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

    /// What a channel of this kind measures together, in the order of [`Sample::Sensor`](crate::Sample::Sensor)'s values; nothing for a
    /// channel with one number.
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

    /// The name used on command lines and in files.
    #[must_use]
    pub fn name(self) -> &'static str {
        Self::NAMES[self as usize].1
    }
}

/// One channel of a board, written `osmc0`, `actuator1`, `supply0` …
///
/// The number is the connector's: `osmc1` and `actuator1` are two uses of the same bridge connector.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize, Schema)]
pub struct ChannelId {
    /// What it is.
    pub kind: ChannelKind,
    /// Which of its kind, from 0.
    pub index: u8,
}

impl ChannelId {
    /// The channel `kind` number `index`.
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

/// The text is no channel name.
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
    /// Radians at the output shaft.
    Rad,
    /// Radians per second at the output shaft.
    RadPerS,
    /// Metres.
    M,
    /// Metres per second.
    MPerS,
    /// Share of the supply, -1..=1.
    Duty,
    /// Volts.
    V,
    /// On or off.
    Bool,
    /// Metres per second squared.
    MPerS2,
    /// Amperes.
    A,
    /// Newtons.
    N,
}

impl Unit {
    /// Every unit, in the order of the variants.
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

/// How a channel is commanded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum Mode {
    /// Closed loop on position.
    Position,
    /// Closed loop on speed.
    Speed,
    /// Open loop: a share of the supply.
    Duty,
    /// On (1) or off (0).
    Switch,
    /// A voltage.
    Voltage,
    /// Brake applied (1) or released (0).
    Brake,
    /// Seek the home switch at this speed; the sign is the direction.
    Home,
    /// Be at this position at the moment that the set point is dated with, on a smooth path through the points given before and
    /// after it: see [`PathPoint`](crate::PathPoint).
    Follow,
    /// Press with this force.
    Force,
}

impl Mode {
    /// Every mode, in the order of the variants.
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

/// A closed interval of `f32`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Range {
    /// Lowest value taken.
    pub min: f32,
    /// Highest value taken.
    pub max: f32,
}

impl Range {
    /// The interval from `min` to `max`.
    #[must_use]
    pub const fn new(min: f32, max: f32) -> Self {
        Self { min, max }
    }

    /// The interval from `-limit` to `limit`.
    #[must_use]
    pub const fn symmetric(limit: f32) -> Self {
        Self { min: -limit, max: limit }
    }

    /// Whether `value` lies inside; false for NaN.
    #[must_use]
    pub fn contains(self, value: f32) -> bool {
        value >= self.min && value <= self.max
    }
}

/// One way to command a channel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ModeInfo {
    /// The mode.
    pub mode: Mode,
    /// Unit of the set point.
    pub unit: Unit,
    /// Set points the channel takes.
    pub range: Range,
}

/// What a channel is and can take, as the board itself describes it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ChannelInfo {
    /// Its name.
    pub id: ChannelId,
    /// Unit of what it measures or, for a pure output, of what it takes.
    pub unit: Unit,
    /// Range of that value.
    pub range: Range,
    /// How often the value is updated.
    pub rate_hz: f32,
    /// One count of [`crate::Sample`]'s `position`, in `unit`; 0 where the channel has no position.
    pub resolution: f32,
    /// How it may be commanded; empty for an input.
    pub modes: Vec<ModeInfo, MAX_MODES>,
}

/// Most ways to command one channel.
pub const MAX_MODES: usize = 6;

impl ChannelInfo {
    /// The range of set points in `mode`, or `None` when the channel does not have that mode.
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
