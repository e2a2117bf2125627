//! Errors that identification returns.

use thiserror::Error;

/// Reason why nothing could be identified.
#[derive(Debug, Error)]
pub enum IdentifyError {
    /// There is no run to fit to.
    #[error("no run to fit to: give at least one file with recorded data")]
    NoRuns,
    /// There is no held-out run.
    #[error("no run is held out: give other files with --holdout, or --holdout every:2 to keep every second run")]
    NoHoldout,
    /// A role that the model requires has no column.
    #[error("the model {model} needs a column for `{role}`: name it with --map {role}=COLUMN")]
    MissingRole {
        /// Name of the model.
        model: &'static str,
        /// Role without a column.
        role: &'static str,
    },
    /// The recordings have too few samples.
    #[error("{samples} samples are too few to tell anything: record at least 50 samples over several steps")]
    TooShort {
        /// Number of samples given.
        samples: usize,
    },
    /// Command or output is constant in all runs.
    #[error(
        "nothing moves: command or output is constant in all runs. Record steps both ways with rests between, \
         large enough to move the output"
    )]
    NothingMoves,
    /// A parameter that the model requires is missing.
    #[error("the model {model} needs --param {name}=…: {what}")]
    MissingParameter {
        /// Name of the model.
        model: &'static str,
        /// Name of the parameter.
        name: &'static str,
        /// Meaning of the parameter.
        what: &'static str,
    },
    /// A parameter is unknown to the model.
    #[error("the model {model} knows no parameter {name}; it knows {known}")]
    UnknownParameter {
        /// Name of the model.
        model: &'static str,
        /// Name of the parameter as given.
        name: String,
        /// Parameters that the model has.
        known: String,
    },
    /// A role is unknown to the model.
    #[error("{model} has no role `{role}`: it has {known}")]
    UnknownRole {
        /// Name of the model.
        model: &'static str,
        /// Role as it was given.
        role: String,
        /// Roles that the model has.
        known: String,
    },
    /// A recording is both fitted to and held out.
    #[error(
        "{} is given both to fit to and to test on: give another recording to --holdout, or every:2",
        path.display()
    )]
    InBothParts {
        /// Path of the recording.
        path: std::path::PathBuf,
    },
    /// A parameter is out of its range.
    #[error("{name}={value} is out of range: {allowed}")]
    OutOfRange {
        /// Name of the parameter.
        name: String,
        /// Value as it was given.
        value: f64,
        /// Values that are allowed.
        allowed: &'static str,
    },
    /// There is no model with this name.
    #[error("no model is called {name}; there are {known}")]
    UnknownModel {
        /// Name as it was given.
        name: String,
        /// Names of all models.
        known: String,
    },
    /// The files cannot be read as recordings.
    #[error(transparent)]
    Data(#[from] crate::data::DataError),
    /// The recordings do not suit a static map.
    #[error(transparent)]
    Map(#[from] crate::statics::map::MapError),
    /// The recordings do not suit the model of a held shaft.
    #[error(transparent)]
    Hysteresis(#[from] crate::statics::hysteresis::HysteresisError),
    /// The recordings are no table of working points.
    #[error(transparent)]
    Table(#[from] crate::statics::table::TableError),
    /// The recordings do not suit a skid-steered robot.
    #[error(transparent)]
    Skid(#[from] crate::skid::SkidError),
    /// No values of the base model's parameters give a finite free-run simulation.
    #[error("the model cannot be fitted to these data: {why}")]
    NoFit {
        /// Observation that led to this error.
        why: &'static str,
    },
}
