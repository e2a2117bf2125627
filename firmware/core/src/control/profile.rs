//! Trapezoidal path to a position, told as the distance still to go.

use crate::within::Within;
use r4_protocol::config::ProfileLimits;

/// A path with limited speed and acceleration.
///
/// It is kept as the distance to go and not as a position, so that its resolution is best where it matters, near the
/// target, however far from zero that is.
#[derive(Clone, Copy, Debug)]
pub struct Profile {
    limits: ProfileLimits,
    period_s: f32,
    to_go: f32,
    speed: f32,
}

impl Profile {
    /// A path that has arrived.
    #[must_use]
    pub fn new(limits: ProfileLimits, period_s: f32) -> Self {
        Self { limits, period_s, to_go: 0.0, speed: 0.0 }
    }

    /// Starts anew: `distance` away from the target, moving at `speed` (clipped to the limit).
    pub fn start(&mut self, distance: f32, speed: f32) {
        self.to_go = distance;
        self.speed = speed.within(-self.limits.speed, self.limits.speed);
    }

    /// Goes on at `speed`, `distance` away from the target: slows down by the limit from a speed that is above it.
    pub fn join(&mut self, distance: f32, speed: f32) {
        (self.to_go, self.speed) = (distance, speed);
    }

    /// The distance still to go, and the speed.
    #[must_use]
    pub fn now(&self) -> (f32, f32) {
        (self.to_go, self.speed)
    }

    /// Moves the target by `distance` while under way.
    pub fn shift_target(&mut self, distance: f32) {
        self.to_go += distance;
    }

    /// One period along the path; returns the distance still to go and the speed.
    pub fn step(&mut self) -> (f32, f32) {
        let (dt, acceleration) = (self.period_s, self.limits.acceleration);
        let distance = self.to_go.abs();
        let towards = if self.to_go < 0.0 { -1.0 } else { 1.0 };
        // The highest speed from which stopping in steps of `dt` ends exactly at the target: v²/2a + v dt/2 = distance.
        let half = acceleration * dt / 2.0;
        let stoppable = libm::sqrtf(half * half + 2.0 * acceleration * distance) - half;
        let wanted = towards * stoppable.min(self.limits.speed);
        let change = acceleration * dt;
        self.speed = wanted.within(self.speed - change, self.speed + change);
        let moved = self.speed * dt;
        if distance <= change * dt && moved.abs() <= change * dt {
            self.to_go = 0.0;
            self.speed = 0.0;
        } else {
            self.to_go -= moved;
        }
        (self.to_go, self.speed)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn arrives_without_overshoot_in_the_time_of_a_trapezoid(
            distance in prop_oneof![-50.0f32..50.0, -0.05f32..0.05], speed in 0.1f32..10.0, acceleration in 1.0f32..50.0,
        ) {
            let dt = 1e-3;
            let mut profile = Profile::new(ProfileLimits { speed, acceleration }, dt);
            profile.start(distance, 0.0);
            let mut last_speed = 0.0f32;
            let mut periods = 0u32;
            loop {
                let (to_go, now) = profile.step();
                prop_assert!(now.abs() <= speed * 1.000_01);
                // One rounding of speed ± a dt; the last step takes what is left of two.
                let steps = if now == 0.0 { 2.0 } else { 1.0 };
                prop_assert!((now - last_speed).abs() <= steps * acceleration * dt * 1.001 + 1e-6);
                last_speed = now;
                periods += 1;
                // Past the target by no more than the last step, and half an ulp of the distance for each step.
                let roundings = distance.abs() * f32::EPSILON / 2.0 * periods as f32;
                prop_assert!(to_go * distance.signum() >= -acceleration * dt * dt * 2.0 - roundings, "{}", to_go);
                if to_go == 0.0 && now == 0.0 {
                    break;
                }
                prop_assert!(periods < 2_000_000, "never arrived: {} to go", to_go);
            }
            let (d, v, a) = (distance.abs(), speed, acceleration);
            let ideal_s = if d * a > v * v { d / v + v / a } else { 2.0 * (d / a).sqrt() };
            // A few periods for discretisation, a share for f32 sums of thousands of steps.
            prop_assert!((periods as f32 * dt - ideal_s).abs() < 0.02 + 0.02 * ideal_s, "{} periods, ideal {} s", periods, ideal_s);
        }
    }
}
