//! Sessions with a board, and the parts that programs above its channels share.
//!
//! A [`Rig`] opens a board by its name, `sim:`, `emu:` (with the feature `emu`) or a link, and runs a program in a [`Session`] with it:
//!
//! ```
//! use r4_rig::{Error, Rig};
//!
//! let rig = Rig::new("sim:osmc-bench".parse()?);
//! let (robot, _) = rig.run(None, async |session| Ok::<_, Error>(session.board.info().robot.to_string()))?;
//! assert_eq!(robot, "osmc-bench");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! A [`Fleet`] runs several virtual boards on one clock. A [`BoardThread`] keeps a board on a thread of its own, for
//! blocking callers.
//!
//! The other modules are pure: they take measurements and return set points for channels.
//!
//! Frames are those of REP-103: x forwards, y to the left, angles counterclockwise; SI units.

mod advice;
mod board_thread;
pub mod cable;
pub mod calibrate;
mod clock;
pub mod emulated;
mod error;
pub mod excite;
mod flash_file;
mod fleet;
mod footprint;
mod ground;
pub mod heat;
mod inertial;
mod interrupt;
pub mod motion;
mod notice;
mod odometry;
mod parameter_units;
mod parameters;
pub mod path;
mod plant_file;
pub mod quantity;
mod query;
pub mod recording;
pub mod replay;
mod rig;
pub mod round;
mod route;
pub mod scenario;
mod sequence;
mod session;
mod target;
pub mod tune;
pub mod twin;
pub mod view;
pub mod watch;
mod work;

pub use advice::next_step;
pub use board_thread::{BoardThread, Call, Desk};
pub use clock::HostClock;
pub use error::Error;
pub use flash_file::{FlashFile, FlashFileError};
pub use fleet::Fleet;
pub use footprint::Footprint;
pub use ground::{GroundDrive, NewestMotors, Velocity, recorded_sides_rad, sides_rad, sides_rad_s};
pub use inertial::{InertialReading, inertial_reading, inertial_sensor};
pub use interrupt::{Interrupt, Interrupted};
pub use motion::{Driven, HeldOutput, NotReached, Unsuitable};
pub use notice::Notice;
pub use odometry::{Odometry, Place, WHEEL_VARIANCE_M};
pub use parameter_units::ParameterUnits;
pub use path::{Followed, PathError, Paths};
pub use plant_file::{InRobot, PlantFile, PlantFileError, hidden, read_plant, replace_body, replace_plants};
pub use quantity::Quantity;
pub use r4_sim::{MotorPlant, Pace, plants as motor_plants};
pub use rig::{Alter, Elapsed, Notify, Recorded, Rig};
pub use route::{Follower, Limits};
pub use sequence::{Sequence, Visit};
pub use session::Session;
pub use target::{BadTarget, NotVirtual, Target};
pub use watch::{Look, MotorWatch, WatchError};
