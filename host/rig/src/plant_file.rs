//! Physics of a virtual board's motors and body from files that replace those of its robot's file.

use std::{
    fs, io,
    path::{Path, PathBuf},
};

use r4_blind::{Hidden, Truth};
use r4_boards::{BoardError, Robot, SimulatedBody};
use r4_plants::{PlantSpec, error::PlantError};
use r4_protocol::ChannelId;
use r4_sim::ReplaceError;
use r4_world::AnyBody;

/// A plant file for one motor of a board.
#[derive(Clone, Debug, PartialEq)]
pub struct PlantFile {
    /// Channel of the motor.
    pub channel: ChannelId,
    /// Path of the file.
    pub path: PathBuf,
}

/// Error of a plant file.
#[derive(Debug, thiserror::Error)]
pub enum PlantFileError {
    /// The file cannot be read.
    #[error("cannot read the plant {path}")]
    NotReadable {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The file describes no valid plant.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// The robot has no such motor, or one of another kind.
    #[error(transparent)]
    Replace(#[from] ReplaceError),
    /// Two files were given for the same motor.
    #[error("--plant gives {0} two plants: give it one")]
    Twice(ChannelId),
}

/// Reads a plant file; returns its name and content.
///
/// # Errors
/// [`PlantFileError::NotReadable`] when it cannot be read; [`PlantFileError::Plant`] when it describes no valid plant.
pub fn read_plant(path: &Path) -> Result<(String, PlantSpec), PlantFileError> {
    let name = path.display().to_string();
    let not_readable = |source| PlantFileError::NotReadable { path: path.to_owned(), source };
    let text = fs::read_to_string(path).map_err(not_readable)?;
    let spec = PlantSpec::from_toml(&name, &text)?;
    Ok((name, spec))
}

/// Replaces plants of `robot`'s motors by those in `files`.
///
/// # Errors
/// [`PlantFileError`] for a file that cannot be used for its motor.
pub fn replace_plants(robot: &mut Robot, files: &[PlantFile]) -> Result<(), PlantFileError> {
    for (index, PlantFile { channel, path }) in files.iter().enumerate() {
        if files[..index].iter().any(|before| before.channel == *channel) {
            return Err(PlantFileError::Twice(*channel));
        }
        let (name, spec) = read_plant(path)?;
        r4_sim::replace_plant(robot, *channel, &name, &spec)?;
    }
    Ok(())
}

/// Replaces the body of `robot` by that of a file, at rest at the pose of the former one.
///
/// # Errors
/// [`BoardError`] when the file contains no body for this robot.
pub fn replace_body(robot: &mut Robot, file: &Path) -> Result<(), BoardError> {
    let body = r4_boards::load_body(file, robot)?;
    robot.simulation.set_body(body);
    Ok(())
}

/// Hidden effect of a seed in a robot: in its body, or in each of its motors.
#[derive(Clone, Debug)]
pub enum InRobot {
    /// Body with the effect, and its truth; `None` where no effect could be hidden.
    Body(Box<SimulatedBody>, Option<Truth>),
    /// Motors with their effects.
    Motors(Vec<(ChannelId, Hidden)>),
}

/// Samples the hidden effects of `robot` from `seed`, which also decides between body and motors.
///
/// # Errors
/// [`PlantError`] when a plant of the robot's file is not valid.
pub fn hidden(robot: &Robot, seed: u64) -> Result<InRobot, PlantError> {
    if let Some(body) = &robot.simulation.body
        && let Some(wheeled) = body.wheeled().filter(|_| r4_blind::is_in_body(seed))
    {
        let (wheeled, truth) = r4_blind::hide_in_body(wheeled, seed);
        let kind = AnyBody::Wheeled(Box::new(wheeled));
        return Ok(InRobot::Body(Box::new(SimulatedBody { kind, channels: body.channels.clone() }), truth));
    }
    let motors = r4_sim::plants(robot)?.into_iter().zip(0u64..);
    // The seeds of a board's motors are far apart, so that the next seed hides another effect in all of them.
    let hide =
        |motor: r4_sim::MotorPlant, index: u64| r4_blind::hide(&motor.spec, motor.supply_v, seed ^ (index << 48));
    Ok(InRobot::Motors(motors.map(|(motor, index)| (motor.channel, hide(motor, index))).collect()))
}
