//! Play between the motor side and the output.

use crate::parameter::{Parameter, fitted};

fitted! {
    /// The output trails the motor side by half a gap in either direction.
    ///
    /// Hysteresis without dynamics of its own: within the gap the output stays at rest, as a load with friction does,
    /// and at the end of the gap it moves with the motor side at once. The inertia of the plant is all at the motor
    /// side; the impact when the gap closes is not modelled.
    ///
    /// # Source
    /// Nordin, Gutman, *Controlling mechanical systems with backlash: a survey*, Automatica 38 (2002), 3.1: the
    /// "hysteresis model" (friction-driven load).
    pub struct Backlash {
        /// Width of the gap: travel of the motor side after a reversal before the output follows, rad or m.
        pub gap: Parameter::new("gap_rad", "rad").linear("gap_m", "m").within(0.0, 10.0).typical(0.02);
    }
}

/// Half the gap, and the position of the output in it.
#[derive(Clone, Debug)]
pub(crate) struct Play {
    half_gap: f64,
    output: f64,
}

impl Play {
    pub(crate) fn new(backlash: &Backlash) -> Self {
        Self { half_gap: 0.5 * backlash.gap, output: 0.0 }
    }

    /// Puts the output where the motor side is, in the middle of the gap.
    pub(crate) fn centre(&mut self, position: f64) {
        self.output = position;
    }

    /// Position and speed of the output for a motor side at `position` with `speed`.
    pub(crate) fn apply(&mut self, position: f64, speed: f64) -> (f64, f64) {
        let (low, high) = (position - self.half_gap, position + self.half_gap);
        let pushed_up = self.output <= low && speed > 0.0;
        let pushed_down = self.output >= high && speed < 0.0;
        self.output = self.output.max(low).min(high);
        (self.output, if pushed_up || pushed_down { speed } else { 0.0 })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reversal_loses_exactly_the_gap() {
        let mut play = Play::new(&Backlash { gap: 0.5 });
        play.centre(1.0);
        assert_eq!(play.apply(1.25, 1.0), (1.0, 1.0)); // half a gap from the middle: contact, just
        assert_eq!(play.apply(2.25, 1.0), (2.0, 1.0));
        assert_eq!(play.apply(2.0, -1.0), (2.0, 0.0)); // 0.25 back: within the gap
        assert_eq!(play.apply(1.75, -1.0), (2.0, -1.0)); // 0.5 back: contact on the other side
        assert_eq!(play.apply(1.25, -1.0), (1.5, -1.0));
    }
}
