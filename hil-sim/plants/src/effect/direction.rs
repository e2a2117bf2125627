//! The two directions of a motion.

/// Direction of a motion, or of a force at rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Direction {
    Forward,
    Backward,
}

impl Direction {
    /// Direction of a nonzero number.
    pub(crate) fn of(number: f64) -> Self {
        if number > 0.0 { Self::Forward } else { Self::Backward }
    }

    pub(crate) fn sign(self) -> f64 {
        if self == Self::Forward { 1.0 } else { -1.0 }
    }

    pub(crate) fn reverse(self) -> Self {
        if self == Self::Forward { Self::Backward } else { Self::Forward }
    }
}
