//! What can be wrong with a task.

use thiserror::Error;

/// Why nothing can be identified.
#[derive(Debug, Error)]
pub enum IdentifyError {
    /// No run to fit to.
    #[error("no run to fit to: give at least one file with recorded data")]
    NoRuns,
    /// No run that is held out.
    #[error("no run is held out: give other files with --holdout, or --holdout every:2 to keep every second run")]
    NoHoldout,
    /// A role of the model has no column.
    #[error("the model {model} needs a column for `{role}`: name it with --map {role}=COLUMN")]
    MissingRole {
        /// The model.
        model: &'static str,
        /// The role.
        role: &'static str,
    },
    /// Too few samples.
    #[error("{samples} samples are too few to tell anything: record at least 50 samples over several steps")]
    TooShort {
        /// There are.
        samples: usize,
    },
    /// Command or output is constant.
    #[error(
        "nothing moves: command or output is constant in all runs. Record steps both ways with rests between, \
         large enough to move the output"
    )]
    NothingMoves,
    /// A parameter that a model needs.
    #[error("the model {model} needs --param {name}=…: {what}")]
    MissingParameter {
        /// The model.
        model: &'static str,
        /// Of the parameter.
        name: &'static str,
        /// What it is.
        what: &'static str,
    },
    /// A parameter that no model knows.
    #[error("the model {model} knows no parameter {name}; it knows {known}")]
    UnknownParameter {
        /// The model.
        model: &'static str,
        /// As given.
        name: String,
        /// Those there are.
        known: String,
    },
    /// A role that the model does not have.
    #[error("{model} has no role `{role}`: it has {known}")]
    UnknownRole {
        /// The model.
        model: &'static str,
        /// As given.
        role: String,
        /// Those there are.
        known: String,
    },
    /// A recording is given twice.
    #[error(
        "{} is given both to fit to and to test on: give another recording to --holdout, or every:2",
        path.display()
    )]
    InBothParts {
        /// Its file.
        path: std::path::PathBuf,
    },
    /// A parameter out of its range.
    #[error("{name}={value} is out of range: {allowed}")]
    OutOfRange {
        /// Of the parameter.
        name: String,
        /// As given.
        value: f64,
        /// What it may be.
        allowed: &'static str,
    },
    /// No model of this name.
    #[error("no model is called {name}; there are {known}")]
    UnknownModel {
        /// As given.
        name: String,
        /// Those there are.
        known: String,
    },
    /// What is in the files will not do.
    #[error(transparent)]
    Data(#[from] crate::data::DataError),
    /// What is in the files will not do for a map.
    #[error(transparent)]
    Map(#[from] crate::statics::map::MapError),
    /// What is in the files shows no play.
    #[error(transparent)]
    Hysteresis(#[from] crate::statics::hysteresis::HysteresisError),
    /// What is in the files is no table.
    #[error(transparent)]
    Table(#[from] crate::statics::table::TableError),
    /// What is in the files will not do for a skid-steered robot.
    #[error(transparent)]
    Skid(#[from] crate::skid::SkidError),
    /// The base model could not follow any run at all.
    #[error("the model cannot be fitted to these data: {why}")]
    NoFit {
        /// What was seen.
        why: &'static str,
    },
}
