//! Drive of a bridge: duty and coast share at the motor's terminals.

/// Action of the bridge on the motor's terminals, averaged over a PWM period.
///
/// For `|duty|` of the period the supply is across the motor, for `coast` the terminals are open, and for the rest they
/// are shorted (brake). Ripple within the period is not modelled: exact for a PWM period that is short against `L/R`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drive {
    /// Signed share of the period for which the supply is across the motor, -1..=1; positive drives towards positive
    /// positions.
    pub duty: f64,
    /// Share of the period for which the terminals are open, 0..=1. It takes precedence: `|duty|` is clipped to
    /// `1 - coast`.
    pub coast: f64,
}

impl Drive {
    /// Terminals open: the current decays through the bridge's diodes, afterwards only friction brakes.
    pub const COAST: Self = Self { duty: 0.0, coast: 1.0 };
    /// Terminals shorted: the motor brakes against its back-EMF.
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

    /// Clips both shares to their ranges, `coast` first.
    pub(crate) fn clipped(self) -> Self {
        let coast = self.coast.clamp(0.0, 1.0);
        Self { duty: self.duty.clamp(coast - 1.0, 1.0 - coast), coast }
    }
}
