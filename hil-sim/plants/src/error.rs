//! What can be wrong with the description of a plant.

use crate::kind::PlantKind;

/// Why a plant description could not be read.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PlantError {
    /// Not TOML, or not the shape of a plant file.
    #[error("{source_name}:{line}: {error}")]
    Toml {
        /// File, as the caller named it.
        source_name: String,
        /// Line in it, from 1.
        line: usize,
        /// What the TOML reader says, with the offending line.
        error: toml::de::Error,
    },
    /// A field that does not exist, is missing, or holds what it must not.
    #[error("{source_name}:{line}: {error}")]
    Field {
        /// File, as the caller named it.
        source_name: String,
        /// Line in it, from 1; where the table begins for a missing field.
        line: usize,
        /// Which field, and what is wrong.
        error: InvalidField,
    },
}

/// A field of a plant description and what is wrong with it.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{field}: {problem}")]
pub struct InvalidField {
    /// Path from the top of the description, effects counted from 0: `effects[1].torque_nm`.
    pub field: String,
    /// What is wrong.
    pub problem: Problem,
}

/// What is wrong with a field.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Problem {
    /// Outside what the parameter may be, or not a number.
    #[error("{value} is outside {lower:?}..={upper:?} {unit}")]
    OutOfRange {
        /// What was asked for.
        value: f64,
        /// Smallest value allowed.
        lower: f64,
        /// Largest value allowed.
        upper: f64,
        /// Unit of all three.
        unit: &'static str,
    },
    /// There is no such thing.
    #[error("unknown; known are {}", known.join(", "))]
    Unknown {
        /// What there is instead.
        known: Vec<&'static str>,
    },
    /// Must be given and is not.
    #[error("missing; write a number in {unit}")]
    Missing {
        /// Unit in which it is to be given.
        unit: &'static str,
    },
    /// Must be a number and is not.
    #[error("not a number")]
    NotANumber,
    /// Must be a text and is not.
    #[error("not the name of an effect")]
    NotAName,
    /// Must be a list of numbers and is not.
    #[error("not a list of numbers")]
    NotNumbers,
    /// A table must have corners.
    #[error("{corners} corners; write 1 to {most}")]
    Corners {
        /// How many it has.
        corners: usize,
        /// How many it may have.
        most: usize,
    },
    /// A table has a value for each corner.
    #[error("{values} of them for {corners} corners; write one for each in at")]
    Lengths {
        /// In `at`.
        corners: usize,
        /// In `values`.
        values: usize,
    },
    /// The corners of a table go up.
    #[error("corner {corner} is not above the one before; two corners at one place are a jump, more are not possible")]
    NotIncreasing {
        /// Which, counted from 0.
        corner: usize,
    },
    /// The effect exists, but only on the other kind of plant.
    #[error("does not exist on {kind} plants")]
    WrongKind {
        /// What the plant is.
        kind: PlantKind,
    },
    /// There are only so many effects.
    #[error("no such effect: the plant has {effects}")]
    NoSuchEffect {
        /// How many there are.
        effects: usize,
    },
}
