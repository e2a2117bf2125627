//! Path interpolation: from the points of a path to the reference at the present time.

use crate::path::{Knot, Leg};

/// Reference of a motor at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Reference {
    /// Position, rad or m.
    pub(super) position: f64,
    /// Speed, rad/s or m/s.
    pub(super) speed: f32,
    /// Acceleration, rad/s² or m/s².
    pub(super) acceleration: f32,
    /// Feed-forward duty from the host.
    pub(super) feed_forward: f32,
}

/// Cubic Hermite interpolation between the points of a path.
///
/// It starts from a position and a speed, and goes from there to the next point. If that point is replaced on the way,
/// it continues from the present reference, without a jump of position or speed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Follower {
    /// Start time of the present segment; `None` before the first step.
    from_us: Option<u64>,
    from: (f64, f32),
    to: Option<Knot>,
    /// Last reference, and its time.
    last: Reference,
    last_us: u64,
}

impl Follower {
    /// Creates a follower that starts from `position` at `speed` with the first step.
    pub(super) fn new(position: f64, speed: f32) -> Self {
        let last = Reference { position, speed, ..Reference::default() };
        Self { from_us: None, from: (position, speed), to: None, last, last_us: 0 }
    }

    /// Reference at `now_us`.
    ///
    /// # Errors
    /// The reference at the end of the path, where there is no next point.
    pub(super) fn step(&mut self, leg: Leg, now_us: u64) -> Result<Reference, Reference> {
        let mut from_us = self.from_us.unwrap_or(now_us);
        if let Some(Knot { at_us, position, speed, .. }) = leg.passed
            && at_us > from_us
        {
            (from_us, self.from, self.to) = (at_us, (position.into(), speed), None);
        }
        let (from, from_speed) = self.from;
        let Some(to) = leg.next else {
            let since_s = now_us.saturating_sub(from_us) as f32 * 1e-6;
            let position = from + f64::from(from_speed * since_s);
            // The acceleration is that of the previous period.
            return Err(Reference { position, speed: from_speed, feed_forward: 0.0, ..self.last });
        };
        if self.to.is_some_and(|planned| planned != to) {
            (from_us, self.from) = (self.last_us, (self.last.position, self.last.speed));
        }
        (self.from_us, self.to) = (Some(from_us), Some(to));
        let (from, from_speed) = self.from;
        let span_s = to.at_us.saturating_sub(from_us) as f32 * 1e-6;
        let share = now_us.saturating_sub(from_us) as f32 * 1e-6 / span_s;
        let way = (f64::from(to.position) - from) as f32;
        // With the ends' speeds as distances over the whole span: way = a s³ + b s² + start s at s = 1.
        let (start, end) = (from_speed * span_s, to.speed * span_s);
        let (a, b) = (start + end - 2.0 * way, 3.0 * way - 2.0 * start - end);
        let gone = ((a * share + b) * share + start) * share;
        self.last = Reference {
            position: from + f64::from(gone),
            speed: ((3.0 * a * share + 2.0 * b) * share + start) / span_s,
            acceleration: (6.0 * a * share + 2.0 * b) / (span_s * span_s),
            feed_forward: to.feed_forward,
        };
        self.last_us = now_us;
        Ok(self.last)
    }

    /// Position of the next point if it is within `error` of the last one and both are at rest: the motor pauses until
    /// then. `None` otherwise.
    pub(super) fn pauses(&self, error: f32) -> Option<f32> {
        let (from, from_speed) = self.from;
        let to = self.to.filter(|to| from_speed == 0.0 && to.speed == 0.0)?;
        ((f64::from(to.position) - from).abs() <= f64::from(error)).then_some(to.position)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn knot(at_us: u64, position: f32, speed: f32) -> Knot {
        Knot { at_us, position, speed, feed_forward: 0.25 }
    }

    /// A cubic through two points with the right speeds is reproduced: position, speed and acceleration of t³ - t.
    #[test]
    fn a_cubic_is_followed_exactly() {
        let mut follower = Follower::new(0.0, -1.0);
        let next = knot(2_000_000, 6.0, 11.0);
        for now_us in (0..2_000_000u64).step_by(125_000) {
            let at = follower.step(Leg { passed: None, next: Some(next) }, now_us).expect("under way");
            let t = now_us as f32 * 1e-6;
            let exact = [t * t * t - t, 3.0 * t * t - 1.0, 6.0 * t];
            for (value, exact) in [at.position as f32, at.speed, at.acceleration].into_iter().zip(exact) {
                // Rounding of a few operations on numbers up to 20.
                assert!((value - exact).abs() < 1e-5, "{now_us}: {value}, not {exact}");
            }
            assert_eq!(at.feed_forward, 0.25);
        }
        let passed = Some(next);
        let ended = follower.step(Leg { passed, next: None }, 2_001_000).expect_err("at its end");
        assert!((ended.position - 6.011).abs() < 1e-6 && ended.speed == 11.0, "{ended:?}");
    }

    /// With the next point replaced in the middle, neither position nor speed jumps from one period to the next.
    #[test]
    fn a_changed_plan_is_joined_without_a_jump() {
        let mut follower = Follower::new(0.0, 0.0);
        let plans = [knot(1_000_000, 1.0, 0.0), knot(1_200_000, -1.0, 0.5)];
        let mut last = Reference::default();
        for now_us in (0..1_200_000u64).step_by(1000) {
            let next = plans[usize::from(now_us >= 500_000)];
            let at = follower.step(Leg { passed: None, next: Some(next) }, now_us).expect("under way");
            // Bounds per period: at most 3.73 m/s over both cubics, and 28.4 m/s² where the second begins.
            assert!((at.position - last.position).abs() < 3.75e-3, "{now_us}: {} {}", at.position, last.position);
            assert!((at.speed - last.speed).abs() < 2.9e-2, "{now_us}: {} {}", at.speed, last.speed);
            last = at;
        }
        assert!((last.position + 1.0).abs() < 2e-3);
    }

    #[test]
    fn a_pause_is_told_from_a_way() {
        for (next, pauses) in
            [(knot(1000, 0.01, 0.0), Some(0.01)), (knot(1000, 0.02, 0.0), None), (knot(1000, 0.0, 0.1), None)]
        {
            let mut follower = Follower::new(0.0, 0.0);
            assert_eq!(follower.pauses(0.01), None, "no plan yet");
            follower.step(Leg { passed: None, next: Some(next) }, 0).expect("under way");
            assert_eq!(follower.pauses(0.01), pauses, "{next:?}");
        }
    }
}
