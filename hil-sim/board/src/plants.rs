//! Replacement of the physics that a robot's files describe for its motors.

use r4_boards::{PlantFile, Robot};
use r4_plants::{PlantError, PlantKind, PlantSpec};
use r4_protocol::ChannelId;

/// A motor of a robot as it is simulated.
#[derive(Clone, Debug, PartialEq)]
pub struct MotorPlant {
    /// Channel of the bridge that drives it.
    pub channel: ChannelId,
    /// Description of its physics.
    pub spec: PlantSpec,
    /// Voltage of its rail without load, V.
    pub supply_v: f64,
}

/// Reasons why a motor cannot have a plant.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ReplaceError {
    /// Channel that is no simulated motor.
    #[error("{file} has no simulated motor {channel}: it has {}", list(known))]
    NoSuchMotor {
        /// Name of the robot's file.
        file: String,
        /// Channel that was given.
        channel: ChannelId,
        /// Channels of the simulated motors.
        known: Vec<ChannelId>,
    },
    /// Plant of the other kind, which the motor's sensors would not fit.
    #[error("{channel} is a {has} plant, and this one is {asked}: name another channel or plant")]
    Kind {
        /// Channel of the motor.
        channel: ChannelId,
        /// Kind of its present plant.
        has: PlantKind,
        /// Kind of the new plant.
        asked: PlantKind,
    },
    /// Error in the robot's own file of the plant.
    #[error(transparent)]
    Plant(#[from] PlantError),
}

fn list(channels: &[ChannelId]) -> String {
    let names: Vec<_> = channels.iter().map(ToString::to_string).collect();
    if names.is_empty() { "none".into() } else { names.join(", ") }
}

/// All simulated motors of a robot, in the order of its file.
///
/// # Errors
/// [`PlantError`] if a plant's file is wrong.
pub fn plants(robot: &Robot) -> Result<Vec<MotorPlant>, PlantError> {
    let simulation = &robot.simulation;
    let plant = |motor: &r4_boards::SimulatedMotor| {
        let rail = simulation.rails.iter().find(|rail| rail.channel == motor.rail);
        Ok(MotorPlant {
            channel: motor.channel,
            spec: PlantSpec::from_toml(&motor.plant.name, &motor.plant.text)?,
            supply_v: rail.map_or(0.0, |rail| rail.emf_v),
        })
    };
    simulation.motors.iter().map(plant).collect()
}

/// Replaces the physics of a motor, for every board that is created from `robot` afterwards.
///
/// # Errors
/// [`ReplaceError`] if there is no such motor, or if a rotary plant would replace a linear one or the other way round;
/// `robot` is unchanged then.
pub fn replace_plant(robot: &mut Robot, channel: ChannelId, name: &str, spec: &PlantSpec) -> Result<(), ReplaceError> {
    let motors = &mut robot.simulation.motors;
    let known = motors.iter().map(|motor| motor.channel).collect();
    let motor = motors.iter_mut().find(|motor| motor.channel == channel);
    let motor = motor.ok_or_else(|| ReplaceError::NoSuchMotor { file: robot.file.clone(), channel, known })?;
    let has = PlantSpec::from_toml(&motor.plant.name, &motor.plant.text)?.kind();
    if has != spec.kind() {
        return Err(ReplaceError::Kind { channel, has, asked: spec.kind() });
    }
    motor.plant = PlantFile { name: name.into(), text: spec.to_toml() };
    Ok(())
}
