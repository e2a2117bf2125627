//! Errors in the description of a plant.

use crate::kind::PlantKind;

/// Reasons why a plant description could not be read.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PlantError {
    /// Not TOML, or not the shape of a plant file.
    #[error("{source_name}:{line}: {error}")]
    Toml {
        /// Name of the file, as the caller passed it.
        source_name: String,
        /// Line in the file, from 1.
        line: usize,
        /// Error of the TOML reader, with the offending line.
        error: toml::de::Error,
    },
    /// A field that does not exist, is missing, or holds an invalid value.
    #[error("{source_name}:{line}: {error}")]
    Field {
        /// Name of the file, as the caller passed it.
        source_name: String,
        /// Line in the file, from 1; the start of the table for a missing field.
        line: usize,
        /// Path of the field and its problem.
        error: InvalidField,
    },
}

/// A field of a plant description and its problem.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("{field}: {problem}")]
pub struct InvalidField {
    /// Path from the top of the description, effects counted from 0: `effects[1].torque_nm`.
    pub field: String,
    /// Problem with the field's value or name.
    pub problem: Problem,
}

/// Problem with a field of a plant description.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Problem {
    /// Value outside the parameter's bounds, or not a number.
    #[error("{value} is outside {lower:?}..={upper:?} {unit}")]
    OutOfRange {
        /// Value that was given.
        value: f64,
        /// Smallest value allowed, inclusive.
        lower: f64,
        /// Largest value allowed, inclusive.
        upper: f64,
        /// Unit of the value and both bounds.
        unit: &'static str,
    },
    /// Unknown name of a model, effect or parameter.
    #[error("unknown; known are {}", known.join(", "))]
    Unknown {
        /// Names that exist instead.
        known: Vec<&'static str>,
    },
    /// Required field that is missing.
    #[error("missing; write a number in {unit}")]
    Missing {
        /// Unit in which the value must be given.
        unit: &'static str,
    },
    /// Value that must be a number.
    #[error("not a number")]
    NotANumber,
    /// Value that must be the name of an effect.
    #[error("not the name of an effect")]
    NotAName,
    /// Value that must be a list of numbers.
    #[error("not a list of numbers")]
    NotNumbers,
    /// Number of knots of a table outside 1 to the limit.
    #[error("{corners} corners; write 1 to {most}")]
    Corners {
        /// Number of knots given.
        corners: usize,
        /// Largest number of knots allowed.
        most: usize,
    },
    /// Table whose two lists differ in length; each knot needs one value.
    #[error("{values} of them for {corners} corners; write one for each in at")]
    Lengths {
        /// Number of knots in `at`.
        corners: usize,
        /// Number of values in `values`.
        values: usize,
    },
    /// Knots of a table that do not increase.
    #[error("corner {corner} is not above the one before; two corners at one place are a jump, more are not possible")]
    NotIncreasing {
        /// Index of the offending knot, from 0.
        corner: usize,
    },
    /// Effect that exists, but only on the other kind of plant.
    #[error("does not exist on {kind} plants")]
    WrongKind {
        /// Kind of this plant.
        kind: PlantKind,
    },
    /// Index of an effect that the plant does not have.
    #[error("no such effect: the plant has {effects}")]
    NoSuchEffect {
        /// Number of effects the plant has.
        effects: usize,
    },
}
