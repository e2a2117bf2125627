//! Errors of recordings and parameters of a skid-steer model, with advice.

use r4_world::ChassisError;

use super::Geometry;

/// Reason why a skid-steer model cannot be created.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SkidError {
    /// A length is missing: geometry is declared, never guessed, because a wrong one looks like slip.
    #[error("`{name}` is missing: measure it and give it, as in `--param {name}={example}`")]
    NoParameter {
        /// Name of the parameter.
        name: &'static str,
        /// Example of a value.
        example: &'static str,
    },
    /// A length is not above zero or not finite.
    #[error("`{name}` is {value}: it has to be above zero and finite")]
    BadParameter {
        /// Name of the parameter.
        name: &'static str,
        /// Value as it was given.
        value: f64,
    },
    /// No chassis can have this geometry.
    #[error("no robot has wheels of {} m, {} m apart: {source}; measure them again", geometry.wheel_radius_m, geometry.track_m)]
    NoBody {
        /// Geometry as it was declared.
        geometry: Geometry,
        /// Error of the chassis.
        source: ChassisError,
    },
    /// A parameter is unknown to the model.
    #[error("skid-steer has no parameter `{name}`: it takes wheel_radius_m, track_m and average_s")]
    UnknownParameter {
        /// Name of the parameter.
        name: String,
    },
    /// A role has no column.
    #[error("{run}: no column is mapped to `{role}`: {advice}")]
    NoRole {
        /// Name of the run.
        run: String,
        /// Name of the role.
        role: &'static str,
        /// Advice on what to map.
        advice: &'static str,
    },
    /// A column has another unit than its role requires.
    #[error("{run}: `{column}` as `{role}` is not in {units}: name the column with its unit")]
    Unit {
        /// Name of the run.
        run: String,
        /// Name of the column.
        column: String,
        /// Role that it was mapped to.
        role: &'static str,
        /// Units that are allowed.
        units: &'static str,
    },
    /// A column and the time have different lengths.
    #[error("{run}: `{role}` has {found} samples and time has {expected}: read the file again, each row one sample")]
    Length {
        /// Name of the run.
        run: String,
        /// Name of the role.
        role: &'static str,
        /// Number of samples of time.
        expected: usize,
        /// Number of values of the role.
        found: usize,
    },
    /// The run has too few samples to be simulated.
    #[error("{run}: {found} samples are too few: record a second or more, at 10 Hz or more")]
    TooShort {
        /// Name of the run.
        run: String,
        /// Number of samples in the run.
        found: usize,
    },
    /// The run is shorter than a span to average over.
    #[error("{run}: {duration_s:.2} s are less than average_s={average_s}: record longer, or give a shorter average_s")]
    TooShortToAverage {
        /// Name of the run.
        run: String,
        /// Duration of the run, s.
        duration_s: f64,
        /// Length of a span as declared, s.
        average_s: f64,
    },
    /// At no time are both wheels and the motion known.
    #[error("{run}: there is no moment at which both sides and the motion of the body are known: record them together")]
    NothingMeasured {
        /// Name of the run.
        run: String,
    },
    /// No run was given.
    #[error("there is no run: name at least one recording")]
    NoRun,
    /// Both sides always have the same speed.
    #[error(
        "the sides never run at different speeds: slip in turning cannot be seen; record arcs and turns on the spot, both ways"
    )]
    NeverTurns,
    /// The wheels never turn.
    #[error("the wheels never turn: record driving forwards, backwards and turning")]
    NeverDrives,
}
