//! Random variations: Ornstein-Uhlenbeck processes, stepped exactly.

use crate::dice::Dice;

/// Gaussian process with a standard deviation and a correlation time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wander {
    /// Standard deviation, in the unit of the quantity; 0 for a constant.
    pub deviation: f64,
    /// Time in which the correlation falls to 1/e, s.
    pub tau_s: f64,
}

impl Wander {
    /// True if steps of `step_s`, s, are allowed: the correlation time is at least five steps, or the deviation is 0.
    pub(super) fn is_valid(&self, step_s: f64) -> bool {
        self.deviation == 0.0
            || (self.deviation > 0.0
                && self.deviation.is_finite()
                && self.tau_s.is_finite()
                && self.tau_s >= 5.0 * step_s)
    }

    /// A sample of the stationary process.
    pub(super) fn first(&self, dice: &mut Dice) -> f64 {
        if self.deviation == 0.0 { 0.0 } else { self.deviation * dice.normal() }
    }

    /// Value one step of `step_s`, s, after `before`: the exact discretisation (Gillespie, Physical Review E 54, 1996).
    pub(super) fn next(&self, before: f64, step_s: f64, dice: &mut Dice) -> f64 {
        if self.deviation == 0.0 {
            return 0.0;
        }
        let kept = libm::exp(-step_s / self.tau_s);
        kept * before + self.deviation * (1.0 - kept * kept).sqrt() * dice.normal()
    }
}
