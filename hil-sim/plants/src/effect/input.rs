//! Effects on the duty, before it becomes a voltage.

use super::slew::Slew;
use crate::{
    drive::Drive,
    parameter::{Parameter, fitted},
};

fitted! {
    /// A duty below a threshold has no effect; above, the output continues from zero: `u - D`, so that full duty gives
    /// `1 - D`.
    pub struct DeadZone {
        /// Threshold of the duty, 0 to 1.
        pub duty: Parameter::new("duty", "1").within(0.0, 1.0).typical(0.1);
    }
}

impl DeadZone {
    /// Duty behind the dead zone.
    #[must_use]
    pub fn apply(&self, duty: f64) -> f64 {
        (duty.abs() - self.duty).max(0.0).copysign(duty)
    }
}

fitted! {
    /// The duty acts as a power of itself, `|u|^p`; full duty stays full. Convex (`p > 1`) is the slow start at small
    /// duty of a bridge whose current is discontinuous; put it after a [`DeadZone`] for `(u - D)^p`.
    pub struct GainCurve {
        /// Exponent `p` of the curve.
        pub exponent: Parameter::new("exponent", "1").within(0.1, 10.0).typical(2.0);
    }
}

impl GainCurve {
    /// Duty behind the curve, with the sign of `duty`.
    #[must_use]
    pub fn apply(&self, duty: f64) -> f64 {
        libm::pow(duty.abs(), self.exponent).copysign(duty)
    }
}

fitted! {
    /// The duty is clipped to a symmetric range.
    pub struct Saturation {
        /// Largest magnitude of the duty, 0 to 1.
        pub duty: Parameter::new("duty", "1").within(0.0, 1.0).typical(0.9);
    }
}

impl Saturation {
    /// Duty clipped to the range.
    #[must_use]
    pub fn apply(&self, duty: f64) -> f64 {
        duty.clamp(-self.duty, self.duty)
    }
}

fitted! {
    /// The duty acts with different gains forwards and backwards.
    pub struct DirectionAsymmetry {
        /// Gain on positive duties.
        pub forward_gain: Parameter::new("forward_gain", "1").within(0.0, 2.0).typical(1.0);
        /// Gain on negative duties.
        pub backward_gain: Parameter::new("backward_gain", "1").within(0.0, 2.0).typical(0.9);
    }
}

impl DirectionAsymmetry {
    /// Duty times the gain of its sign.
    #[must_use]
    pub fn apply(&self, duty: f64) -> f64 {
        duty * if duty > 0.0 { self.forward_gain } else { self.backward_gain }
    }
}

fitted! {
    /// The duty acts with the opposite sign: swapped leads.
    pub struct InputSign {}
}

fitted! {
    /// The drive is sampled periodically and held in between (zero-order hold); the first sample is at the start.
    pub struct InputHold {
        /// Sampling period, s.
        pub period_s: Parameter::new("period_s", "s").within(1e-4, 10.0).typical(0.025);
    }
}

fitted! {
    /// The duty acts through a first-order low-pass.
    pub struct DriveLag {
        /// Time constant, s: 1/e of a step is missing after it.
        pub time_constant_s: Parameter::new("time_constant_s", "s").within(1e-6, 100.0).typical(0.02);
    }
}

/// An input effect with its memory. Delays are handled by [`super::delay`].
#[derive(Clone, Debug)]
pub(crate) enum InputStage {
    DeadZone(DeadZone),
    GainCurve(GainCurve),
    Saturation(Saturation),
    DirectionAsymmetry(DirectionAsymmetry),
    Slew(Slew),
    Sign,
    Hold { period_s: f64, left_s: f64, held: Drive },
    Lag { time_constant_s: f64, duty: f64 },
}

/// Tolerance, s: a sample closer than this is due now.
const NOW_S: f64 = 1e-11;

impl InputStage {
    /// True if the output may change while the input does not.
    pub(crate) fn has_memory(&self) -> bool {
        matches!(self, Self::Slew(_) | Self::Hold { .. } | Self::Lag { .. })
    }

    /// Longest time for which the output stays constant, s: a step must not be longer.
    pub(crate) fn constant_for_s(&self) -> f64 {
        match self {
            Self::Hold { period_s, left_s, .. } => {
                if *left_s > NOW_S {
                    *left_s
                } else {
                    *period_s
                }
            }
            _ => f64::INFINITY,
        }
    }

    /// Output over a step; its mean, if it changes within the step.
    pub(crate) fn apply(&mut self, drive: Drive, step_s: f64) -> Drive {
        let duty = match self {
            Self::DeadZone(zone) => zone.apply(drive.duty),
            Self::GainCurve(curve) => curve.apply(drive.duty),
            Self::Saturation(saturation) => saturation.apply(drive.duty),
            Self::DirectionAsymmetry(asymmetry) => asymmetry.apply(drive.duty),
            Self::Slew(slew) => slew.apply(drive.duty, step_s),
            Self::Sign => -drive.duty,
            Self::Hold { period_s, left_s, held } => {
                if *left_s <= NOW_S {
                    *held = drive;
                    *left_s += *period_s;
                }
                *left_s -= step_s;
                return *held;
            }
            Self::Lag { time_constant_s, duty } => {
                let missing = *duty - drive.duty;
                let ratio = step_s / *time_constant_s;
                let lost = -libm::expm1(-ratio);
                *duty = drive.duty + missing * (1.0 - lost);
                drive.duty + missing * (lost / ratio)
            }
        };
        Drive { duty, ..drive }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Effect;

    #[test]
    fn a_dead_zone_swallows_small_duties_and_continues_from_zero() {
        let zone = DeadZone { duty: 0.25 };
        for (duty, left) in [(0.0, 0.0), (0.25, 0.0), (-0.2, 0.0), (0.5, 0.25), (-0.5, -0.25), (1.0, 0.75)] {
            assert_eq!(zone.apply(duty), left, "{duty}");
        }
    }

    #[test]
    fn a_gain_curve_keeps_full_duty_and_the_sign() {
        let curve = GainCurve { exponent: 2.0 };
        for (duty, acting) in [(0.0, 0.0), (0.5, 0.25), (-0.5, -0.25), (1.0, 1.0), (-1.0, -1.0)] {
            assert_eq!(curve.apply(duty), acting, "{duty}");
        }
    }

    #[test]
    fn a_lag_gives_the_mean_of_its_way_whatever_the_steps() {
        // Integral of 0.5 (1 − exp(−t/0.2)) over 0.3 s.
        let expected = 0.5 * (0.3 - 0.2 * (1.0 - (-1.5f64).exp()));
        for steps in [1, 4, 7] {
            let mut lag = InputStage::new(&Effect::DriveLag(DriveLag { time_constant_s: 0.2 })).unwrap();
            let step_s = 0.3 / f64::from(steps);
            let area: f64 = (0..steps).map(|_| lag.apply(Drive::with_brake(0.5), step_s).duty * step_s).sum();
            assert!((area - expected).abs() < 1e-15, "{steps}: {area}"); // a handful of roundings
        }
    }

    #[test]
    fn a_hold_looks_at_its_period_only() {
        let mut hold = InputStage::new(&Effect::InputHold(InputHold { period_s: 0.5 })).unwrap();
        let mut at = |duty, step_s| (hold.constant_for_s(), hold.apply(Drive::with_brake(duty), step_s).duty);
        assert_eq!(at(0.25, 0.125), (0.5, 0.25));
        assert_eq!(at(0.75, 0.375), (0.375, 0.25));
        assert_eq!(at(-0.5, 0.5), (0.5, -0.5));
        assert_eq!(at(1.0, 0.25), (0.5, 1.0));
        assert_eq!(at(0.0, 0.25), (0.25, 1.0));
    }

    #[test]
    fn saturation_and_asymmetry_act_by_sign() {
        assert_eq!(Saturation { duty: 0.9 }.apply(-1.0), -0.9);
        assert_eq!(Saturation { duty: 0.9 }.apply(0.3), 0.3);
        let asymmetry = DirectionAsymmetry { forward_gain: 1.0, backward_gain: 0.5 };
        assert_eq!([asymmetry.apply(0.5), asymmetry.apply(-0.5)], [0.5, -0.25]);
    }
}
