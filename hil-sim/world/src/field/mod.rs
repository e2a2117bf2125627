//! Scalar fields of the world, which sensors on a body read at the place where they are.
//!
//! A field is a state at a time. Asking for a later time steps it there, by steps of its own, so that who asks more often changes
//! nothing: the same seed gives the same bytes. A time before one already asked for counts as that one; to go back, clone the field
//! at time 0.

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

/// Why a field cannot be computed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum FieldError {
    /// A number out of its range.
    #[error("`{what}` {rule}")]
    Number {
        /// Field of the specification.
        what: &'static str,
        /// What must hold.
        rule: &'static str,
    },
    /// The source is in a wall, or where no air comes.
    #[error("`source_m` [{}, {}] is where no air flows: move it to where the inlet's air comes by", .0[0], .0[1])]
    Source(Point),
    /// More filaments than can be stepped.
    #[error("{filaments} filaments at once, and at most {most}: release fewer a second, or shorten `lifetime_s`")]
    TooMany {
        /// In one lifetime.
        filaments: f64,
        /// The limit.
        most: usize,
    },
    /// The air cannot flow.
    #[error(transparent)]
    Flow(#[from] FlowError),
}

/// A field with its name.
#[derive(Clone, Debug, PartialEq)]
pub struct Field {
    /// By which sensors name it.
    pub name: String,
    /// What it is.
    pub kind: FieldKind,
}

/// The kinds of fields.
#[derive(Clone, Debug, PartialEq)]
pub enum FieldKind {
    /// Share of a gas in the air, ppm by volume.
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

    /// Unit of its values.
    #[must_use]
    pub const fn unit(&self) -> &'static str {
        match self.kind {
            FieldKind::Gas(_) => "ppm",
            FieldKind::Electric(_) => "V/m",
        }
    }
}
