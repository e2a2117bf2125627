//! Complex arithmetic that frequency responses need.

use std::ops::{Add, Div, Mul};

/// Complex number: real and imaginary part.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Complex(pub(super) f64, pub(super) f64);

pub(super) const ONE: Complex = Complex(1.0, 0.0);

impl Complex {
    pub(super) fn size(self) -> f64 {
        self.0.hypot(self.1)
    }

    /// Returns the angle in -π..=π, rad.
    pub(super) fn angle(self) -> f64 {
        self.1.atan2(self.0)
    }
}

impl Add for Complex {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self(self.0 + other.0, self.1 + other.1)
    }
}

impl Mul for Complex {
    type Output = Self;

    fn mul(self, other: Self) -> Self {
        Self(self.0 * other.0 - self.1 * other.1, self.0 * other.1 + self.1 * other.0)
    }
}

impl Mul<f64> for Complex {
    type Output = Self;

    fn mul(self, factor: f64) -> Self {
        Self(self.0 * factor, self.1 * factor)
    }
}

impl Div for Complex {
    type Output = Self;

    fn div(self, other: Self) -> Self {
        let square = other.0 * other.0 + other.1 * other.1;
        Self((self.0 * other.0 + self.1 * other.1) / square, (self.1 * other.0 - self.0 * other.1) / square)
    }
}
