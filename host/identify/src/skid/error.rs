//! Why recordings are no use for a skid-steer model, and what to do about it.

use r4_world::ChassisError;

use super::Geometry;

/// Why a skid-steer model cannot be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SkidError {
    /// Geometry is declared, never guessed: a wrong one looks like slip.
    #[error("`{name}` is missing: measure it and give it, as in `--param {name}={example}`")]
    NoParameter {
        /// Which.
        name: &'static str,
        /// What it may look like.
        example: &'static str,
    },
    /// A length that is none.
    #[error("`{name}` is {value}: it has to be above zero and finite")]
    BadParameter {
        /// Which.
        name: &'static str,
        /// What was given.
        value: f64,
    },
    /// No chassis of this geometry can be computed.
    #[error("no robot has wheels of {} m, {} m apart: {source}; measure them again", geometry.wheel_radius_m, geometry.track_m)]
    NoBody {
        /// As declared.
        geometry: Geometry,
        /// What is wrong.
        source: ChassisError,
    },
    /// A parameter that the model does not have.
    #[error("skid-steer has no parameter `{name}`: it takes wheel_radius_m, track_m and average_s")]
    UnknownParameter {
        /// Which.
        name: String,
    },
    /// A role without a column.
    #[error("{run}: no column is mapped to `{role}`: {advice}")]
    NoRole {
        /// Name of the run.
        run: String,
        /// Which.
        role: &'static str,
        /// What to map.
        advice: &'static str,
    },
    /// A column of another kind.
    #[error("{run}: `{column}` as `{role}` is not in {units}: name the column with its unit")]
    Unit {
        /// Name of the run.
        run: String,
        /// The column.
        column: String,
        /// What it was mapped to.
        role: &'static str,
        /// Endings that would do.
        units: &'static str,
    },
    /// Columns of different length, or time that does not run.
    #[error("{run}: `{role}` has {found} samples and time has {expected}: read the file again, each row one sample")]
    Length {
        /// Name of the run.
        run: String,
        /// Which.
        role: &'static str,
        /// Samples of time.
        expected: usize,
        /// Samples of the role.
        found: usize,
    },
    /// Nothing to simulate.
    #[error("{run}: {found} samples are too few: record a second or more, at 10 Hz or more")]
    TooShort {
        /// Name of the run.
        run: String,
        /// How many.
        found: usize,
    },
    /// No span to take a mean over.
    #[error("{run}: {duration_s:.2} s are less than average_s={average_s}: record longer, or give a shorter average_s")]
    TooShortToAverage {
        /// Name of the run.
        run: String,
        /// Of the run.
        duration_s: f64,
        /// As given.
        average_s: f64,
    },
    /// No moment at which both wheels and the motion are known.
    #[error("{run}: there is no moment at which both sides and the motion of the body are known: record them together")]
    NothingMeasured {
        /// Name of the run.
        run: String,
    },
    /// No run at all.
    #[error("there is no run: name at least one recording")]
    NoRun,
    /// Both sides always alike.
    #[error(
        "the sides never run at different speeds: slip in turning cannot be seen; record arcs and turns on the spot, both ways"
    )]
    NeverTurns,
    /// Standing still.
    #[error("the wheels never turn: record driving forwards, backwards and turning")]
    NeverDrives,
}
