//! How a plant's output moves, which decides the units of everything at it.

use std::fmt;

/// How the output moves, and with it the unit of everything at the output.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PlantKind {
    /// rad, rad/s, N m.
    Rotary,
    /// m, m/s, N.
    Linear,
}

impl fmt::Display for PlantKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(PerKind { rotary: "rotary", linear: "linear" }.of(*self))
    }
}

/// One thing for each kind of plant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct PerKind<T> {
    pub(crate) rotary: T,
    pub(crate) linear: T,
}

impl<T: Copy> PerKind<T> {
    pub(crate) const fn of(&self, kind: PlantKind) -> T {
        match kind {
            PlantKind::Rotary => self.rotary,
            PlantKind::Linear => self.linear,
        }
    }
}
