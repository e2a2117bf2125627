//! Physics of a virtual board's motors and body other than those of its robot's file.

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
    /// The motor.
    pub channel: ChannelId,
    /// The file.
    pub path: PathBuf,
}

/// A plant file cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum PlantFileError {
    /// It cannot be read.
    #[error("cannot read the plant {path}")]
    NotReadable {
        /// The file.
        path: PathBuf,
        /// Why not.
        source: io::Error,
    },
    /// It describes no plant.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// The robot has no such motor, or one of another kind.
    #[error(transparent)]
    Replace(#[from] ReplaceError),
    /// The same motor has two plants.
    #[error("--plant gives {0} two plants: give it one")]
    Twice(ChannelId),
}

/// Name and content of a plant file.
///
/// # Errors
/// When it cannot be read, or describes no plant.
pub fn read_plant(path: &Path) -> Result<(String, PlantSpec), PlantFileError> {
    let name = path.display().to_string();
    let not_readable = |source| PlantFileError::NotReadable { path: path.to_owned(), source };
    let text = fs::read_to_string(path).map_err(not_readable)?;
    let spec = PlantSpec::from_toml(&name, &text)?;
    Ok((name, spec))
}

/// Gives motors of `robot` the plants in `files`.
///
/// # Errors
/// When a file cannot be used for its motor.
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

/// Gives `robot` the body of a file, at rest where the one before it stood.
///
/// # Errors
/// When the file is no body for this robot.
pub fn replace_body(robot: &mut Robot, file: &Path) -> Result<(), BoardError> {
    let body = r4_boards::load_body(file, robot)?;
    robot.simulation.set_body(body);
    Ok(())
}

/// What a seed hides in a robot: something in its body, or in each of its motors.
#[derive(Clone, Debug)]
pub enum InRobot {
    /// The body with it, and what it is; `None` where nothing could be hidden.
    Body(Box<SimulatedBody>, Option<Truth>),
    /// The motors with it.
    Motors(Vec<(ChannelId, Hidden)>),
}

/// What `seed` hides in `robot`. In which part, is up to the seed.
///
/// # Errors
/// When a plant of the robot's file is wrong.
pub fn hidden(robot: &Robot, seed: u64) -> Result<InRobot, PlantError> {
    if let Some(body) = &robot.simulation.body
        && let Some(wheeled) = body.wheeled().filter(|_| r4_blind::is_in_body(seed))
    {
        let (wheeled, truth) = r4_blind::hide_in_body(wheeled, seed);
        let kind = AnyBody::Wheeled(Box::new(wheeled));
        return Ok(InRobot::Body(Box::new(SimulatedBody { kind, channels: body.channels.clone() }), truth));
    }
    let motors = r4_sim::plants(robot)?.into_iter().zip(0u64..);
    // Seeds of a board's motors are far apart: the next seed hides something else in all of them.
    let hide =
        |motor: r4_sim::MotorPlant, index: u64| r4_blind::hide(&motor.spec, motor.supply_v, seed ^ (index << 48));
    Ok(InRobot::Motors(motors.map(|(motor, index)| (motor.channel, hide(motor, index))).collect()))
}
