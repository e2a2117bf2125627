//! PID controller with derivative on the measurement, back-calculation anti-windup, and a clipped and slew-limited
//! output.

use crate::within::Within;
use r4_protocol::config::PidGains;

/// Limits of the output.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OutputLimits {
    /// Largest magnitude of the output.
    pub magnitude: f32,
    /// Fastest change of the output, 1/s.
    pub slew_per_s: f32,
}

impl OutputLimits {
    /// Limits an integral: no load needs more than the whole range of the output, from one end to the other.
    fn bound(self, integral: f32) -> f32 {
        integral.within(-2.0 * self.magnitude, 2.0 * self.magnitude)
    }
}

/// Time constant with which a loop without an integral part releases an integral, s.
const FORGET_S: f32 = 5.0;

/// PID loop of fixed period.
///
/// `u = kp e + I - kd v + ff`, clipped to ± the magnitude and slew-limited. The derivative acts on the measured rate
/// `v` (relative to the path, where there is one), never on the error: a step of the set point does not kick. There is
/// no time in the interface: the period is fixed, so nothing divides by a measured interval and a wait before the first
/// step leaves no trace.
///
/// Anti-windup: while the output is limited and the error asks for more, integration waits and back-calculation with
/// the tracking time `kp / ki` unloads `I`, though never past zero. Unlimited back-calculation would drive `I` to the
/// limit itself during a long saturation, or far beyond zero on a large step, and either is an overshoot later.
#[derive(Clone, Debug)]
pub struct Pid {
    gains: PidGains,
    period_s: f32,
    integral: f32,
    error: f32,
    rate: f32,
    output: f32,
}

/// Error: the period of a loop must be a positive number of seconds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BadPeriod;

impl Pid {
    /// Creates a loop at rest.
    ///
    /// # Errors
    /// [`BadPeriod`] unless `period_s` is finite and positive.
    pub fn new(gains: PidGains, period_s: f32) -> Result<Self, BadPeriod> {
        if !period_s.is_finite() || period_s <= 0.0 {
            return Err(BadPeriod);
        }
        Ok(Self { gains, period_s, integral: 0.0, error: 0.0, rate: 0.0, output: 0.0 })
    }

    /// Advances one period and returns the output.
    ///
    /// `error` is set point minus measurement, `rate` the filtered rate of the measurement, `feed_forward` a duty.
    ///
    /// An input that is not finite, or too large to compute with, takes the output to 0 at its slew limit and leaves
    /// the rest of the loop unchanged.
    pub fn step(&mut self, error: f32, rate: f32, feed_forward: f32, limits: OutputLimits) -> f32 {
        let PidGains { kp, ki, kd } = self.gains;
        let unlimited = kp * error + self.integral - kd * rate + feed_forward;
        let step = limits.slew_per_s * self.period_s;
        if !unlimited.is_finite() {
            self.output = 0.0f32.within(self.output - step, self.output + step);
            return self.output;
        }
        let output =
            unlimited.within(self.output - step, self.output + step).within(-limits.magnitude, limits.magnitude);
        let excess = unlimited - output;
        self.integral = if excess * error > 0.0 {
            // Without a proportional part the tracking time is one period.
            let tracking = if kp > 0.0 { (ki / kp * self.period_s).min(1.0) } else { 1.0 };
            let unload = (excess * tracking).abs().min(self.integral.abs());
            if self.integral * excess > 0.0 { self.integral - unload.copysign(excess) } else { self.integral }
        } else if ki == 0.0 {
            // The integral comes from other gains, or was pushed: nothing else would ever unload it.
            limits.bound(self.integral - self.integral * (self.period_s / FORGET_S).min(1.0))
        } else {
            limits.bound(self.integral + ki * error * self.period_s)
        };
        self.error = error;
        self.rate = rate;
        self.output = output;
        output
    }

    /// Sets new gains without a jump: the integral absorbs the change of the other parts.
    pub fn set_gains(&mut self, gains: PidGains) {
        let change = (gains.kp - self.gains.kp) * self.error - (gains.kd - self.gains.kd) * self.rate;
        self.integral -= change;
        self.gains = gains;
    }

    /// Integral part of the output, a duty.
    #[must_use]
    pub const fn integral(&self) -> f32 {
        self.integral
    }

    /// Restores the integral to an earlier value, which removes the integration since then.
    pub const fn set_integral(&mut self, integral: f32) {
        self.integral = integral;
    }

    /// Adds `duty` to the integral.
    pub fn push(&mut self, duty: f32, limits: OutputLimits) {
        self.integral = limits.bound(self.integral + duty);
    }

    /// Releases a share of the integral.
    pub fn leak(&mut self, share: f32) {
        self.integral -= self.integral * share;
    }

    /// Releases a share of an integral that opposes `error`.
    pub fn unload_against(&mut self, error: f32, share: f32) {
        if self.integral * error < 0.0 {
            self.integral -= self.integral * share;
        }
    }

    /// Resets the loop to rest with the output `output`, of which `integral` is the integral part.
    pub fn hold(&mut self, output: f32, integral: f32) {
        self.reset(output);
        self.integral = integral;
    }

    /// Resets the loop to rest with the output `output`, from which the slew limit starts, and without an integral.
    pub fn reset(&mut self, output: f32) {
        self.integral = 0.0;
        self.error = 0.0;
        self.rate = 0.0;
        self.output = output;
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const FREE: OutputLimits = OutputLimits { magnitude: f32::MAX, slew_per_s: f32::MAX };
    const PERIOD_S: f32 = 1e-3;

    fn pid(kp: f32, ki: f32, kd: f32) -> Pid {
        Pid::new(PidGains { kp, ki, kd }, PERIOD_S).expect("valid period")
    }

    #[test]
    fn the_three_parts_follow_their_formulas() {
        assert_eq!(pid(2.0, 0.0, 0.0).step(0.5, 9.0, 0.25, FREE), 1.25);
        assert_eq!(pid(0.0, 0.0, 0.5).step(7.0, 3.0, 0.0, FREE), -1.5);
        let mut integral = pid(0.0, 4.0, 0.0);
        let after_a_second = (0..=1000).map(|_| integral.step(0.5, 0.0, 0.0, FREE)).last().expect("stepped");
        // Sum of 1000 values of 0.002 in f32: relative error below 1000 ulp/2.
        assert!((after_a_second - 2.0).abs() < 1e-4, "{after_a_second}");
    }

    #[test]
    fn a_long_saturation_does_not_wind_up() {
        let limits = OutputLimits { magnitude: 0.5, slew_per_s: f32::MAX };
        let mut pid = pid(2.0, 5.0, 0.0);
        for _ in 0..60_000 {
            assert_eq!(pid.step(1.0, 0.0, 0.0, limits), 0.5);
        }
        // Nothing was integrated in that minute: the output follows the sign of the error.
        assert!(pid.step(-0.01, 0.0, 0.0, limits) < 0.0);

        // An integral from before the saturation is unloaded in a few tracking times of kp / ki = 0.4 s.
        let mut loaded = self::pid(2.0, 5.0, 0.0);
        while loaded.step(0.2, 0.0, 0.0, limits) < 0.5 {}
        for _ in 0..4000 {
            loaded.step(1.0, 0.0, 0.0, limits);
        }
        assert!(loaded.step(-0.01, 0.0, 0.0, limits) < 0.0);
    }

    #[test]
    fn output_never_jumps_more_than_the_slew_limit() {
        let limits = OutputLimits { magnitude: 0.9, slew_per_s: 10.0 };
        let mut pid = pid(50.0, 5.0, 0.1);
        let mut last = 0.0;
        for period in 0..2000u16 {
            let error = if period / 100 % 2 == 0 { 1.0 } else { -1.0 };
            let output = pid.step(error, 0.0, 0.0, limits);
            // One rounding error of the sum last + step.
            assert!((output - last).abs() <= 10.0 * PERIOD_S + 1e-6);
            last = output;
        }
    }

    #[test]
    fn without_an_integral_part_what_was_pushed_is_let_go_in_5_s() {
        let mut pid = pid(0.0, 0.0, 0.0);
        pid.push(0.5, FREE);
        let after_5_s = (0..=5000).map(|_| pid.step(1.0, 0.0, 0.0, FREE)).last().expect("stepped");
        // Discrete decay: (1 - 1/5000)^5000.
        assert!((after_5_s - 0.5 * 0.36784).abs() < 1e-4, "{after_5_s}");
    }

    /// The integral is limited to twice the magnitude, in both directions and by every path.
    #[test]
    fn an_integral_is_bounded_from_one_end_of_the_output_to_the_other() {
        let limits = OutputLimits { magnitude: 0.5, slew_per_s: f32::MAX };
        for sign in [1.0, -1.0] {
            let mut pushed = pid(0.0, 1.0, 0.0);
            pushed.push(sign * 9.0, limits);
            assert_eq!(pushed.integral, sign);
            let mut integrated = pid(0.0, 1024.0, 0.0);
            // An opposing feed-forward keeps the output from its limit.
            (0..100).for_each(|_| _ = integrated.step(sign, 0.0, -sign, limits));
            assert_eq!(integrated.integral, sign);
            let mut forgetting = pid(0.0, 0.0, 0.0);
            forgetting.hold(0.0, sign * 9.0);
            forgetting.step(0.0, 0.0, 0.0, limits);
            assert_eq!(forgetting.integral, sign);
        }
    }

    /// While the output is limited and the error asks for more, the integral shrinks by `excess ki / kp` per period and
    /// never passes 0; without a proportional part by the whole excess. An integral of the other sign, or without an
    /// error, stays.
    #[test]
    fn what_is_beyond_the_limit_unloads_the_integral() {
        let limits = OutputLimits { magnitude: 0.5, slew_per_s: f32::MAX };
        for sign in [1.0, -1.0] {
            // Columns: kp, ki, error, feed-forward, and the integral before and after; `kp error + I + ff - 0.5` is the
            // excess.
            for (kp, ki, error, feed_forward, before, after) in [
                (1.0, 128.0, 1.0, 0.0, 0.5, 0.5 - 128.0 * PERIOD_S),
                (2.0, 128.0, 1.0, 0.5, 0.5, 0.5 - 2.5 * 64.0 * PERIOD_S),
                // The tracking time is at least one period.
                (0.5, 4096.0, 0.5, 0.25, 0.75, 0.0),
                (0.25, 4096.0, 1.0, 0.0, 0.75, 0.25),
                (0.0, 1.0, 1.0, 0.0, 0.75, 0.5),
                (0.0, 1.0, 1.0, 1.0, 0.25, 0.0),
                (1.0, 128.0, 2.0, 0.0, -0.25, -0.25),
                (0.0, 1.0, 0.0, 0.0, 0.75, 0.75),
                (0.0, 1.0, 0.0, 2.0, 0.25, 0.25),
            ] {
                let mut pid = pid(kp, ki, 0.0);
                pid.hold(0.0, sign * before);
                assert_eq!(pid.step(sign * error, 0.0, sign * feed_forward, limits), sign * 0.5);
                assert!((pid.integral - sign * after).abs() < 1e-6, "{kp} {ki} {error}: {}, not {after}", pid.integral);
            }
        }
    }

    /// A non-finite input takes the output to exactly 0 at the slew limit, from either side; the integral is kept for
    /// the next valid input.
    #[test]
    fn an_input_that_is_no_number_takes_the_output_to_0() {
        let limits = OutputLimits { magnitude: 0.5, slew_per_s: 125.0 };
        for (sign, bad) in [1.0, -1.0].into_iter().flat_map(|sign| [(sign, f32::NAN), (sign, f32::INFINITY)]) {
            let mut pid = pid(1.0, 1.0, 0.0);
            pid.hold(sign * 0.3125, sign * 0.25);
            for expected in [0.1875, 0.0625, 0.0, 0.0] {
                assert_eq!(pid.step(bad, 0.0, 0.0, limits), sign * expected);
            }
            assert_eq!(pid.step(0.0, bad, 0.0, OutputLimits { slew_per_s: 1e6, ..limits }), 0.0);
            assert_eq!(pid.step(0.0, 0.0, 0.0, limits), sign * 0.125);
            assert_eq!(pid.step(0.0, 0.0, 0.0, limits), sign * 0.25);
        }
    }

    /// Only an integral that opposes the error is unloaded, by the given share.
    #[test]
    fn an_integral_against_the_error_is_unloaded() {
        for (integral, error, after) in
            [(0.5, -0.1, 0.375), (-0.5, 0.1, -0.375), (0.5, 0.1, 0.5), (-0.5, -0.1, -0.5), (0.5, 0.0, 0.5)]
        {
            let mut pid = pid(0.0, 1.0, 0.0);
            pid.hold(0.0, integral);
            pid.unload_against(error, 0.25);
            assert_eq!(pid.integral, after);
        }
    }

    #[test]
    fn a_period_that_is_no_time_is_refused() {
        for bad in [0.0, -1e-3, f32::NAN, f32::INFINITY] {
            assert_eq!(Pid::new(PidGains { kp: 1.0, ki: 0.0, kd: 0.0 }, bad).err(), Some(BadPeriod));
        }
    }

    proptest! {
        #[test]
        fn new_gains_do_not_move_the_output(
            before in [0.0f32..10.0, 0.0..10.0, 0.0..1.0], after in [0.0f32..10.0, 0.0..10.0, 0.0..1.0],
            error in -1.0f32..1.0, speed in -5.0f32..5.0, feed_forward in -1.0f32..1.0,
        ) {
            let mut pid = pid(before[0], before[1], before[2]);
            for _ in 0..100 {
                pid.step(error, speed, feed_forward, FREE);
            }
            let last = pid.step(error, speed, feed_forward, FREE);
            pid.set_gains(PidGains { kp: after[0], ki: after[1], kd: after[2] });
            let next = pid.step(error, speed, feed_forward, FREE);
            // Only the integral may move on, by one period of the old gain; the rest is rounding of sums up to 30.
            prop_assert!((next - last - before[1] * error * PERIOD_S).abs() < 1e-4, "{} -> {}", last, next);
        }

        #[test]
        fn any_input_gives_a_finite_output_within_its_limits(
            inputs in prop::collection::vec((any::<f32>(), any::<f32>(), any::<f32>()), 1..50),
        ) {
            let limits = OutputLimits { magnitude: 0.95, slew_per_s: 20.0 };
            let mut pid = pid(1e3, 1e3, 1e3);
            for (error, speed, feed_forward) in inputs {
                let output = pid.step(error, speed, feed_forward, limits);
                prop_assert!(output.abs() <= 0.95, "{}", output);
            }
            // The loop recovers from any such input.
            for _ in 0..10_000 {
                pid.step(0.0, 0.0, 0.0, limits);
            }
            prop_assert!(pid.step(0.0, 0.0, 0.0, limits).is_finite());
        }
    }
}
