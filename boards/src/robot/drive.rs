//! Table `[drive]`: motion of a robot over the ground.

use std::fmt::Display;

use r4_protocol::{
    channel::ChannelId,
    config::{BoardConfig, Feedback},
};
use serde::Deserialize;

use super::read::Reader;
use crate::{
    error::BoardError,
    number::{Interval, channel, channels, finite, optional_positive, positive},
    source::Claims,
};

/// Motion of a robot over the ground. Forwards, left and counter-clockwise are positive.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Drive {
    /// Wheels that do not steer, on two sides.
    SkidSteer(SkidSteer),
    /// Steered front wheels, as of a car.
    Ackermann(Ackermann),
}

/// Wheels on two sides, steered by their difference in speed.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SkidSteer {
    /// Radius of every wheel, m.
    #[serde(deserialize_with = "positive")]
    pub wheel_radius_m: f64,
    /// Difference of the sides' speeds divided by the robot's turn rate, m: the distance between the middles of left
    /// and right wheels, and more where tyres slip in a turn.
    #[serde(deserialize_with = "positive")]
    pub track_m: f64,
    /// Motors of the left wheels; a positive position is forwards.
    #[serde(deserialize_with = "channels")]
    pub left: Vec<ChannelId>,
    /// Motors of the right wheels; a positive position is forwards.
    #[serde(deserialize_with = "channels")]
    pub right: Vec<ChannelId>,
    /// Highest speed that it should be given, m/s.
    #[serde(deserialize_with = "positive")]
    pub speed_max_m_s: f64,
    /// Highest turn rate that it should be given, rad/s.
    #[serde(deserialize_with = "positive")]
    pub turn_rate_max_rad_s: f64,
    /// Speed limit of the wheels, rad/s: the lowest of their motors in the same file. The board refuses set points beyond
    /// it.
    #[serde(skip)]
    pub wheel_speed_max_rad_s: f64,
}

/// Car with a steered front axle.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Ackermann {
    /// Distance between the axles, m.
    #[serde(deserialize_with = "positive")]
    pub wheelbase_m: f64,
    /// Distance between the middles of left and right wheels, m.
    #[serde(deserialize_with = "positive")]
    pub track_m: f64,
    /// Radius of the driven wheels, m.
    #[serde(deserialize_with = "positive")]
    pub wheel_radius_m: f64,
    /// Channel of the linear motor that steers.
    #[serde(deserialize_with = "channel")]
    pub steering: ChannelId,
    /// Steering angle for the position of that motor.
    pub steering_law: SteeringLaw,
    /// Range of steering angles that it should be given, at a single wheel in the middle (bicycle model), rad.
    pub steering_rad: Interval,
    /// Channel of the motor or brushless drive that drives.
    #[serde(deserialize_with = "channel")]
    pub drive: ChannelId,
    /// Ground speed at full duty or full throttle, m/s, for a drive without an encoder.
    #[serde(default, deserialize_with = "optional_positive")]
    pub full_speed_m_s: Option<f64>,
    /// Highest speed that it should be given, m/s.
    #[serde(deserialize_with = "positive")]
    pub speed_max_m_s: f64,
    /// Speed limit of the drive, rad/s: that of its motor in the same file, beyond which the board refuses set points.
    /// Infinite for a drive without an encoder, whose set point is a duty.
    #[serde(skip)]
    pub wheel_speed_max_rad_s: f64,
}

/// Steering angle as a linear function of the position of the linear motor.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SteeringLaw {
    /// Steering angle at position 0, rad.
    #[serde(deserialize_with = "finite")]
    pub rad_at_zero: f64,
    /// Change of the steering angle with the position, rad/m; negative where a longer rod steers to the right.
    #[serde(deserialize_with = "finite")]
    pub rad_per_m: f64,
}

impl SteeringLaw {
    /// Returns the steering angle with the rod at `position_m`, rad; positive to the left.
    #[must_use]
    pub fn angle_rad(self, position_m: f64) -> f64 {
        self.rad_at_zero + self.rad_per_m * position_m
    }

    /// Returns the position of the rod at a steering angle, m.
    #[must_use]
    pub fn position_m(self, angle_rad: f64) -> f64 {
        (angle_rad - self.rad_at_zero) / self.rad_per_m
    }
}

impl Drive {
    /// Checks the drive against the motors that the robot has, and takes the limits of its wheels from them.
    pub(super) fn check(mut self, reader: &Reader<'_>, config: &BoardConfig) -> Result<Self, BoardError> {
        match &mut self {
            Self::SkidSteer(drive) => {
                drive.check(reader, config)?;
                drive.wheel_speed_max_rad_s = speed_max_rad_s(config, drive.left.iter().chain(&drive.right));
            }
            Self::Ackermann(drive) => {
                drive.check(reader, config)?;
                drive.wheel_speed_max_rad_s = speed_max_rad_s(config, [&drive.drive]);
            }
        }
        Ok(self)
    }
}

fn motors(config: &BoardConfig, wanted: fn(Option<Feedback>) -> bool) -> impl Iterator<Item = &ChannelId> + Clone {
    let is_wanted = move |motor: &&r4_protocol::config::MotorConfig| wanted(motor.control.map(|c| c.feedback));
    config.motors.iter().filter(is_wanted).map(|motor| &motor.id)
}

/// Lowest speed limit of some drives, rad/s; infinite for those whose speed no loop controls.
fn speed_max_rad_s<'a>(config: &BoardConfig, wheels: impl IntoIterator<Item = &'a ChannelId>) -> f64 {
    let limits = wheels.into_iter().filter_map(|wheel| {
        let motor = config.motors.iter().find(|motor| motor.id == *wheel)?;
        Some(f64::from(motor.control?.speed_max))
    });
    limits.fold(f64::INFINITY, f64::min)
}

fn turns(feedback: Option<Feedback>) -> bool {
    feedback.is_some_and(Feedback::turns)
}

fn slides(feedback: Option<Feedback>) -> bool {
    matches!(feedback, Some(Feedback::Potentiometer { .. }))
}

impl SkidSteer {
    fn check(&self, reader: &Reader<'_>, config: &BoardConfig) -> Result<(), BoardError> {
        let mut claims = Claims::new(reader.source);
        for (side, wheels) in [("left", &self.left), ("right", &self.right)] {
            let path = format!("drive.skid-steer.{side}");
            if wheels.is_empty() {
                return Err(reader.rule(path, "needs a wheel on each side"));
            }
            for (index, wheel) in wheels.iter().enumerate() {
                let path = format!("{path}[{index}]");
                reader.one_of("motor with an encoder", *wheel, motors(config, turns), path.clone())?;
                // A motor on both sides would turn the robot against itself.
                claims.take("wheel", wheel, path)?;
            }
        }
        Ok(())
    }
}

impl Ackermann {
    fn check(&self, reader: &Reader<'_>, config: &BoardConfig) -> Result<(), BoardError> {
        let path = |field: &dyn Display| format!("drive.ackermann.{field}");
        let with_potentiometer = motors(config, slides);
        reader.one_of("motor with a potentiometer", self.steering, with_potentiometer, path(&"steering"))?;
        let may_drive = motors(config, |feedback| !slides(feedback)).chain(config.bldcs.iter().map(|bldc| &bldc.id));
        reader.one_of("motor that turns", self.drive, may_drive, path(&"drive"))?;
        let is_measured = motors(config, turns).any(|id| *id == self.drive);
        // With an encoder the speed is measured; a second source could contradict it.
        if is_measured == self.full_speed_m_s.is_some() {
            let rule = "full_speed_m_s is for a drive without an encoder, which needs it";
            return Err(reader.rule(path(&"full_speed_m_s"), rule));
        }
        let steering = config.motors.iter().find(|motor| motor.id == self.steering);
        let travel = steering.and_then(|motor| motor.control).map(|control| control.position);
        let Interval { min, max } = self.steering_rad;
        // This also refuses a slope of 0, with which one of the two is infinite.
        let reached = [min, max].map(|angle_rad| self.steering_law.position_m(angle_rad) as f32);
        if !reached.iter().all(|position| travel.is_some_and(|travel| travel.contains(*position))) {
            let rule = "by the steering_law these angles are outside the position_m of the steering motor";
            return Err(reader.rule(path(&"steering_rad"), rule));
        }
        Ok(())
    }
}
