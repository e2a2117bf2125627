//! Other physics for a robot's motors than its files describe.

use r4_boards::{PlantFile, Robot};
use r4_plants::{PlantError, PlantKind, PlantSpec};
use r4_protocol::ChannelId;

/// A motor of a robot as it is simulated.
#[derive(Clone, Debug, PartialEq)]
pub struct MotorPlant {
    /// Whose bridge drives it.
    pub channel: ChannelId,
    /// Its physics.
    pub spec: PlantSpec,
    /// Of its rail without load.
    pub supply_v: f64,
}

/// Why a motor cannot have a plant.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ReplaceError {
    /// There is no such motor.
    #[error("{file} has no simulated motor {channel}: it has {}", list(known))]
    NoSuchMotor {
        /// Of the robot.
        file: String,
        /// Which was asked for.
        channel: ChannelId,
        /// Which there are.
        known: Vec<ChannelId>,
    },
    /// What measures it would not fit.
    #[error("{channel} is a {has} plant, and this one is {asked}: name another channel or plant")]
    Kind {
        /// Which motor.
        channel: ChannelId,
        /// What it is.
        has: PlantKind,
        /// What it was to be.
        asked: PlantKind,
    },
    /// The robot's own file of it is wrong.
    #[error(transparent)]
    Plant(#[from] PlantError),
}

fn list(channels: &[ChannelId]) -> String {
    let names: Vec<_> = channels.iter().map(ToString::to_string).collect();
    if names.is_empty() { "none".into() } else { names.join(", ") }
}

/// Every simulated motor of a robot, in the order of its file.
///
/// # Errors
/// When a plant's file is wrong.
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

/// Gives a motor other physics: every board that is made of `robot` afterwards has them.
///
/// # Errors
/// When there is no such motor, or a rotary plant was to take the place of a linear one or the other way round; nothing
/// is changed then.
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
