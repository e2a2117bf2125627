//! The paper's controller: a plain PID on the host, whose output is a duty in 255ths.
//!
//! `u = Kp e + Ki sum(e dt) + Kd de/dt`, its sign the direction, its magnitude clipped. The error is in degrees, for the actuator in
//! counts of a 10-bit converter. The paper prints no units: these are our reading. Degrees are those in which one stopping duty,
//! `D = Kp e`, explains Table 3; counts are what the released code computes with.
//!
//! # Corrected defects of the released code
//! The rotary loop never reads its count (`error = target`); dt is 0 in fast loops, so that the derivative is NaN; the
//! first dt includes the time in which the operator typed; the direction is never 0, so that the motor is never
//! stopped; 16-bit counts of one edge are read without a lock; the actuator's target has a misplaced bracket, 2.99 mm.
//!
//! # Properties kept
//! No profile, no feed-forward, no filter on the derivative, one sum over all set points. The released sum has no
//! bound, but with such a sum a move of 270 degrees overshoots by more than a turn. [`SUM_MAX`] is the bound that Table
//! 4 implies, so that the arm is the better of both readings. Arm `baseline:unbounded-sum` has the sum as released.

/// Gains of the paper's best row, in 255ths of duty.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gains {
    /// Proportional gain, per degree or count.
    pub kp: f64,
    /// Integral gain, per degree or count and second.
    pub ki: f64,
    /// Derivative gain, seconds per degree or count.
    pub kd: f64,
}

/// The gains (10, 4, 3) of Table 5, without steady-state error.
pub const PRINTED: Gains = Gains { kp: 10.0, ki: 4.0, kd: 3.0 };

/// Bound of the sum, degree seconds or count seconds: what Table 4 implies for the moment when the motor stops, by `(Ki
/// S - D) / Kp`.
pub const SUM_MAX: f64 = 62.3;

/// State of the controller.
#[derive(Clone, Copy, Debug)]
pub struct Pid {
    gains: Gains,
    /// Largest magnitude of the output, 255ths.
    clip: f64,
    sum_max: f64,
    sum: f64,
    before: Option<f64>,
}

impl Pid {
    /// Creates a controller with an empty sum. `clip` in 255ths; `sum_max` in degree or count seconds, infinite for
    /// none.
    #[must_use]
    pub const fn new(gains: Gains, clip: f64, sum_max: f64) -> Self {
        Self { gains, clip, sum_max, sum: 0.0, before: None }
    }

    /// Prepares for a new set point: the next step has no derivative.
    pub const fn retarget(&mut self) {
        self.before = None;
    }

    /// Output, 255ths of duty, for an error `dt_s` after the last one. A `dt_s` that is not positive is a repeated
    /// sample: it changes neither sum nor derivative.
    pub fn step(&mut self, error: f64, dt_s: f64) -> f64 {
        let mut slope = 0.0;
        if dt_s > 0.0 {
            self.sum = (self.sum + error * dt_s).clamp(-self.sum_max, self.sum_max);
            slope = self.before.map_or(0.0, |before| (error - before) / dt_s);
            self.before = Some(error);
        }
        let Gains { kp, ki, kd } = self.gains;
        (kp * error + ki * self.sum + kd * slope).clamp(-self.clip, self.clip)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_printed_law_with_a_clip() {
        let mut pid = Pid::new(PRINTED, 230.0, SUM_MAX);
        assert_eq!(pid.step(2.0, 0.01), 10.0 * 2.0 + 4.0 * 0.02, "no derivative at first");
        assert!((pid.step(1.9, 0.01) - (19.0 + 4.0 * 0.039 - 30.0)).abs() < 1e-9);
        assert_eq!(pid.step(-100.0, 0.01), -230.0);
        // A repeated sample must not divide by a dt of 0.
        assert!(pid.step(-100.0, 0.0).is_finite());
    }

    #[test]
    fn the_sum_is_bounded_unless_it_is_as_released() {
        let last = |sum_max| {
            let mut pid = Pid::new(PRINTED, f64::INFINITY, sum_max);
            (0..1000).fold(0.0, |_, _| pid.step(100.0, 0.01))
        };
        assert_eq!(last(SUM_MAX), 1000.0 + 4.0 * SUM_MAX);
        // 10 s of an error of 100: an integral part of four times 1000 beside the proportional 1000.
        assert!((last(f64::INFINITY) - 5000.0).abs() < 1e-6, "{}", last(f64::INFINITY));
    }
}
