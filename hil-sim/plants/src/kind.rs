//! Kinds of plants, rotary and linear, which decide the units at the output.

use std::fmt;

/// Kind of motion of the output, which decides the unit of every quantity there.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum PlantKind {
    /// Rotary output: rad, rad/s, N m.
    Rotary,
    /// Linear output: m, m/s, N.
    Linear,
}

impl fmt::Display for PlantKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(PerKind { rotary: "rotary", linear: "linear" }.of(*self))
    }
}

/// One value for each kind of plant.
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
