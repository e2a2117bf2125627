//! Carriers and robots as data.
//!
//! A *carrier* file describes the board: pins, addresses, connectors, electrical limits. A *robot* file describes what
//! is plugged in, how it is calibrated and controlled and, for the simulator only, the true values of all that.
//! [`load`] reads and checks both and makes the firmware's [`BoardConfig`](r4_protocol::config::BoardConfig).
//!
//! ```
//! let robot = r4_boards::load("osmc-bench")?;
//! assert_eq!(robot.config.motors[0].id.to_string(), "osmc0");
//! assert_eq!(robot.carrier.pin("enc0_a").map(|pin| pin.stm32.to_string()), Some("PJ8".to_owned()));
//! # Ok::<(), r4_boards::BoardError>(())
//! ```

pub mod carrier;
mod error;
mod number;
mod robot;
mod source;
mod tree;

use std::path::Path;

pub use carrier::Carrier;
pub use error::{BoardError, Location};
pub use number::Interval;
pub use robot::{
    Ackermann, BodyReading, Drive, FieldReading, GnssOrigin, Mount, NoSuchField, PlantFile, RangeView, Robot,
    SelfCharge, SimulatedAnalog, SimulatedAngle, SimulatedBldc, SimulatedBody, SimulatedCurrent, SimulatedDistance,
    SimulatedEncoder, SimulatedForce, SimulatedGnss, SimulatedImu, SimulatedMotor, SimulatedPulses, SimulatedRail,
    SimulatedRange, SimulatedRotor, SimulatedSensor, SimulatedServo, SimulatedStepper, SimulatedSwitch, SimulatedUart,
    Simulation, SkidSteer, SteeringLaw, SwitchedBy, TruePoint, UartDevice, World,
};
use source::{CARRIERS, Folder, ROBOTS, Source, WORLDS};

/// Iterates over the names of the built-in robots.
pub fn names() -> impl ExactSizeIterator<Item = &'static str> {
    ROBOTS.into_iter()
}

/// Iterates over the names of the built-in worlds.
pub fn world_names() -> impl ExactSizeIterator<Item = &'static str> {
    WORLDS.into_iter()
}

/// Iterates over the names of the built-in carriers.
pub fn carrier_names() -> impl ExactSizeIterator<Item = &'static str> {
    CARRIERS.into_iter()
}

/// Reads and checks a robot: a name out of [`names`], or the path of a `.toml` file.
///
/// Files that a robot file names (carrier, plants) are looked for in its folder, then among the built-in ones.
///
/// # Errors
/// [`BoardError`] with the first problem: file, line and field.
pub fn load(name_or_path: &str) -> Result<Robot, BoardError> {
    let (source, folder) = find(name_or_path, "robot", &ROBOTS)?;
    robot::read(&source, &folder)
}

/// Reads and checks a carrier: a name out of [`carrier_names`], or the path of a `.toml` file.
///
/// # Errors
/// [`BoardError`] with the first problem: file, line and field.
pub fn load_carrier(name_or_path: &str) -> Result<Carrier, BoardError> {
    carrier::read(&find(name_or_path, "carrier", &CARRIERS)?.0)
}

/// Reads and checks a world: a name out of [`world_names`], or the path of a `.toml` file with a `[world]` and nothing
/// else.
///
/// # Errors
/// [`BoardError`] with the first problem: file, line and field.
pub fn load_world(name_or_path: &str) -> Result<World, BoardError> {
    robot::read_world(&find(name_or_path, "world", &WORLDS)?.0)
}

/// Reads and checks a body for a robot: a `.toml` file with a `[body]` and nothing else, whose channels are motors of
/// the robot. [`SimulatedBody::wheeled_toml`] writes one, [`Simulation::set_body`] gives it to the robot.
///
/// # Errors
/// [`BoardError`] with the first problem: file, line and field.
pub fn load_body(path: &Path, robot: &Robot) -> Result<SimulatedBody, BoardError> {
    let source = Source::read(path).map_err(|(path, source)| BoardError::NotReadable { path, source })?;
    robot::read_body(&source, robot)
}

/// Gives a robot the `[body]` and the `[world]` of a `.toml` file, each if it is there. Other tables of the file are
/// not read: a scenario has its steps beside these two.
///
/// # Errors
/// [`BoardError`] with the first problem of either: file, line and field.
pub fn load_environment(path: &Path, robot: &mut Robot) -> Result<(), BoardError> {
    let source = Source::read(path).map_err(|(path, source)| BoardError::NotReadable { path, source })?;
    robot::read_environment(&source, robot)
}

fn find(name_or_path: &str, what: &'static str, known: &[&'static str]) -> Result<(Source, Folder), BoardError> {
    if name_or_path.ends_with(".toml") {
        let path = Path::new(name_or_path);
        let source = Source::read(path).map_err(|(path, source)| BoardError::NotReadable { path, source })?;
        let folder = path.parent().unwrap_or(Path::new("")).to_owned();
        return Ok((source, Folder::At(folder)));
    }
    let unknown = || BoardError::UnknownName { what, name: name_or_path.to_owned(), known: known.to_vec() };
    let name = known.iter().find(|known| **known == name_or_path).ok_or_else(unknown)?;
    let folder = if what == "world" { "worlds/" } else { "" };
    let source = Source::built_in(&format!("{folder}{name}.toml")).ok_or_else(unknown)?;
    Ok((source, Folder::BuiltIn))
}
