//! What a bridge does to a motor's terminals.

/// What the bridge does to the motor's terminals, averaged over a PWM period.
///
/// Of the period, the supply is across the motor for `|duty|` and the terminals are open for `coast`; for the rest they
/// are shorted (brake). Ripple within the period is left out: exact for a PWM fast against `L/R`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drive {
    /// Signed share of time the supply is across the motor, -1..=1; positive drives towards positive positions.
    pub duty: f64,
    /// Share of time the terminals are open, 0..=1. It comes first: `|duty|` is at most what it leaves.
    pub coast: f64,
}

impl Drive {
    /// Terminals open: the current decays through the bridge's diodes, then nothing brakes but friction.
    pub const COAST: Self = Self { duty: 0.0, coast: 1.0 };
    /// Terminals shorted.
    pub const BRAKE: Self = Self { duty: 0.0, coast: 0.0 };

    /// Supply across the motor for a signed share of time, brake for the rest (slow decay).
    #[must_use]
    pub const fn with_brake(duty: f64) -> Self {
        Self { duty, coast: 0.0 }
    }

    /// Supply across the motor for a signed share of time, terminals open for the rest (fast decay).
    #[must_use]
    pub const fn with_coast(duty: f64) -> Self {
        Self { duty, coast: 1.0 - duty.abs() }
    }

    /// Both shares in their ranges.
    pub(crate) fn clipped(self) -> Self {
        let coast = self.coast.clamp(0.0, 1.0);
        Self { duty: self.duty.clamp(coast - 1.0, 1.0 - coast), coast }
    }
}
