//! Force control of a motor: a loop on a force sensor around that of its position.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::{ConfigError, check, finite, not_negative, positive};
use crate::channel::{ChannelId, Mode, ModeInfo, Range, Unit};

/// Force loop of a motor.
///
/// The loop is an admittance: the position that the motor's position loop holds moves at `speed_per_n` times the error
/// of the force, and at `approach_speed` at most, so that a motor without contact closes at that speed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ForceConfig {
    /// Sensor of the force.
    pub sensor: ForceSensor,
    /// Range of forces for set points, N.
    pub range: Range,
    /// Force of either sign at which the board trips, N: beyond both ends of `range`.
    pub limit_n: f32,
    /// Speed for one newton of error, rad/(s N) or m/(s N): the inverse of the damping. Negative where the force falls
    /// as the position rises. Its product with the stiffness of the contact is the loop's bandwidth, 1/s.
    pub speed_per_n: f32,
    /// Speed at which the motor closes until there is contact, and the highest that the loop commands, rad/s or m/s.
    pub approach_speed: f32,
    /// Force beyond the sensor's zero, of either sign, that counts as contact, N; below half of it the contact counts
    /// as lost.
    pub contact_n: f32,
    /// Error within which a force counts as reached, and the motor rests, N. Below the force of one count of the
    /// position on the stiffest object, the motor goes to and fro between two counts and never settles.
    pub error_n: f32,
    /// Time constant of the low-pass on the measured force, s; 0 for none.
    pub filter_s: f32,
    /// Time constant with which the sensor's zero follows its reading while there is no contact, s: compensation of
    /// drift. 0 keeps the configured zero.
    pub drift_s: f32,
}

/// Sensor of a motor's force.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum ForceSensor {
    /// A voltage on one of [`super::BoardConfig::analogs`].
    Analog {
        /// Number of the analog channel.
        analog: u8,
        /// Voltage without force, V.
        zero_v: f32,
        /// Force per volt, N/V; negative where the voltage falls with the force.
        newtons_per_v: f32,
    },
    /// A load cell, one of [`super::BoardConfig::sensors`], which is read at least [`FORCE_RATE_MIN_HZ`] times a second.
    LoadCell {
        /// Number of the load cell's channel.
        force: u8,
    },
}

/// Lowest rate at which a load cell serves force control, Hz: four control periods of 1 ms between two readings, in
/// which a motor that meets an object moves on.
pub const FORCE_RATE_MIN_HZ: u16 = 250;

impl ForceConfig {
    /// Returns the mode of force control, as channels describe it.
    #[must_use]
    pub fn mode(&self) -> ModeInfo {
        ModeInfo { mode: Mode::Force, unit: Unit::N, range: self.range }
    }

    pub(super) fn validate(&self, id: ChannelId, speed_max: f32) -> Result<(), ConfigError> {
        let rule = |holds: bool, rule| check(Some(id), holds, rule);
        if let ForceSensor::Analog { zero_v, newtons_per_v, .. } = self.sensor {
            rule(
                finite(zero_v) && finite(newtons_per_v) && newtons_per_v != 0.0,
                "a force sensor's zero_v must be finite, and its newtons_per_v other than 0",
            )?;
        }
        let Range { min, max } = self.range;
        rule(finite(min) && finite(max) && min < max, "force range must have a finite min below a finite max")?;
        rule(
            // A set point at an end of the range must not trip the board.
            positive(self.limit_n) && min.abs().max(max.abs()) < self.limit_n,
            "force_limit must be above all forces of the range",
        )?;
        // Its sign is that of the force over the position, so it may be negative.
        rule(finite(self.speed_per_n) && self.speed_per_n != 0.0, "force_gain must be finite and other than 0")?;
        rule(
            positive(self.approach_speed) && self.approach_speed <= speed_max,
            "approach_speed must be positive and at most speed_max",
        )?;
        rule(
            positive(self.contact_n) && self.contact_n < self.limit_n,
            "contact_force must be positive, below force_limit",
        )?;
        rule(positive(self.error_n), "force_error must be positive")?;
        rule(
            not_negative(self.filter_s) && self.filter_s <= 1.0 && not_negative(self.drift_s),
            "a force's filter_s must be 0 to 1, its drift_s not negative",
        )
    }
}
