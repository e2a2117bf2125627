//! The duty changes at no more than a given rate.

use crate::parameter::{Parameter, fitted};

fitted! {
    /// The duty changes at no more than a given rate, from 0 at the start.
    pub struct SlewLimit {
        /// Largest change of duty per second, in either direction.
        pub rate_per_s: Parameter::new("rate_per_s", "1/s").within(1e-3, 1e6).typical(10.0);
    }
}

/// A slew limit and its present output.
#[derive(Clone, Debug)]
pub(crate) struct Slew {
    rate_per_s: f64,
    duty: f64,
}

impl Slew {
    pub(crate) fn new(limit: &SlewLimit) -> Self {
        Self { rate_per_s: limit.rate_per_s, duty: 0.0 }
    }

    /// Mean of the duty over a step: half-way up the ramp, or less than the target by a triangle if the ramp ends
    /// within the step.
    pub(crate) fn apply(&mut self, target: f64, step_s: f64) -> f64 {
        let gap = target - self.duty;
        let reach = self.rate_per_s * step_s;
        if gap.abs() <= reach {
            self.duty = target;
            // a triangle of height `gap` that lasts the share `gap / reach` of the step is missing
            return if gap == 0.0 { target } else { target - 0.5 * gap * (gap.abs() / reach) };
        }
        let from = self.duty;
        self.duty += reach.copysign(gap);
        0.5 * (from + self.duty)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_mean_of_a_ramp_does_not_depend_on_the_steps() {
        // 0 to 0.5 at 2/s takes 0.25 s; over 0.4 s the area is 0.5 · 0.4 − 0.5 · 0.5 · 0.25 = 0.1375
        for steps in [1, 4, 7] {
            let mut slew = Slew::new(&SlewLimit { rate_per_s: 2.0 });
            let step_s = 0.4 / f64::from(steps);
            let area: f64 = (0..steps).map(|_| slew.apply(0.5, step_s) * step_s).sum();
            assert!((area - 0.1375).abs() < 1e-15, "{steps}: {area}"); // a handful of roundings
            assert_eq!(slew.duty, 0.5);
        }
    }
}
