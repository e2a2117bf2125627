//! Scalar fields of the world, which sensors on a body read at their place.
//!
//! A field has a state at a time. A query for a later time advances it by steps of its own, so the frequency of queries
//! does not matter: the same seed gives the same bytes. A query for an earlier time is answered for the time already
//! reached; to go back, clone the field at time 0.

mod electric;
mod flow;
mod lag;
mod ou;
mod plume;
#[cfg(test)]
mod tests;

pub use electric::{Charge, Cloud, Electric, ElectricSpec};
pub use flow::{Flow, FlowError, FlowSpec};
pub use lag::Lag;
pub use ou::Wander;
pub use plume::{Balance, Plume, PlumeSpec};

use crate::scene::Point;

/// Reasons why a field cannot be computed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FieldError {
    /// Parameter out of its range.
    #[error("`{what}` {rule}")]
    Number {
        /// Name of the parameter.
        what: &'static str,
        /// Rule that the parameter violates.
        rule: &'static str,
    },
    /// A source inside a wall, or where no air flows.
    #[error("`source_m` [{}, {}] is where no air flows: move it to where the inlet's air comes by", .0[0], .0[1])]
    Source(Point),
    /// More filaments than the limit.
    #[error("{filaments} filaments at once, and at most {most}: release fewer a second, or shorten `lifetime_s`")]
    TooMany {
        /// Filaments released in one lifetime.
        filaments: f64,
        /// Largest number of filaments.
        most: usize,
    },
    /// Error of the air flow.
    #[error(transparent)]
    Flow(#[from] FlowError),
}

/// A field with its name.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// Name by which sensors refer to the field.
    pub name: String,
    /// Kind of the field with its state.
    pub kind: FieldKind,
}

/// Kinds of fields, by the quantity.
#[derive(Clone, Debug, PartialEq)]
pub enum FieldKind {
    /// Volume fraction of a gas in the air, ppm.
    Gas(Box<Plume>),
    /// Vertical potential gradient, V/m.
    Electric(Box<Electric>),
}

impl Field {
    /// Value at a time, s, and a point, m, in [`Field::unit`].
    pub fn value(&mut self, time_s: f64, point: Point) -> f64 {
        match &mut self.kind {
            FieldKind::Gas(plume) => plume.value(time_s, point),
            FieldKind::Electric(electric) => electric.value(time_s, point),
        }
    }

    /// Unit of the field's values, `ppm` or `V/m`.
    #[must_use]
    pub const fn unit(&self) -> &'static str {
        match self.kind {
            FieldKind::Gas(_) => "ppm",
            FieldKind::Electric(_) => "V/m",
        }
    }
}
