//! Processes that wander: Ornstein-Uhlenbeck, stepped exactly.

use crate::dice::Dice;

/// A quantity with a standard deviation whose correlation falls to 1/e in a time.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Wander {
    /// Standard deviation, in the unit of what wanders; 0 for nothing.
    pub deviation: f64,
    /// Time in which the correlation falls to 1/e, s.
    pub tau_s: f64,
}

impl Wander {
    /// Whether it can be stepped by `step_s`, s: its time is five steps or more, or it stands still.
    pub(super) fn is_valid(&self, step_s: f64) -> bool {
        self.deviation == 0.0
            || (self.deviation > 0.0
                && self.deviation.is_finite()
                && self.tau_s.is_finite()
                && self.tau_s >= 5.0 * step_s)
    }

    /// A value of the stationary process.
    pub(super) fn first(&self, dice: &mut Dice) -> f64 {
        if self.deviation == 0.0 { 0.0 } else { self.deviation * dice.normal() }
    }

    /// The value one step of `step_s`, s, after `before`: the exact discretisation (Gillespie, Physical Review E 54, 1996).
    pub(super) fn next(&self, before: f64, step_s: f64, dice: &mut Dice) -> f64 {
        if self.deviation == 0.0 {
            return 0.0;
        }
        let kept = libm::exp(-step_s / self.tau_s);
        kept * before + self.deviation * (1.0 - kept * kept).sqrt() * dice.normal()
    }
}
