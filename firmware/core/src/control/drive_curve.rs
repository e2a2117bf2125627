//! Drive curve: steady duty over speed of a motor, learned while it moves.

use crate::within::Within;

/// Number of knots of the curve in each direction, and their speeds as shares of the highest.
const KNOTS: usize = 4;
const SHARES: [f32; KNOTS] = [0.0, 1.0 / 16.0, 0.25, 1.0];
/// Least rise of the curve from rest to the highest speed, as a share of the largest duty: no motor reaches its highest
/// speed with less.
const LEAST_RISE: f32 = 0.2;
/// Share of the highest speed below which a steady speed only gives a lower bound of the duty at rest.
const NEARLY_AT_REST: f32 = 1.0 / 64.0;
/// Share of the largest duty: a motor that moves against this much teaches nothing. No load that it could hold does
/// that, but a sensor that counts the wrong way does, and learning from it would hide the fault.
const OVERPOWERED: f32 = 0.99;
/// Least share of friction in the resistance: with less, a braking motor would get all of the duty at once.
const LEAST_FRICTION: f32 = 0.03;

/// Duty that holds a motor's speed: piecewise linear over the speed, for each direction by itself.
///
/// It contains the sum of friction, dead band, convex speed curve and load. A knot or a direction that has not been
/// seen moves with those that have. A steady load makes the two directions differ, and may make one of them negative.
///
/// The share of friction in the duty at rest shows when a moving motor gets less than that duty: friction brakes it, a
/// dead band does not.
#[derive(Clone, Copy, Debug)]
pub(super) struct DriveCurve {
    /// Speed of the last knot, rad/s or m/s.
    speed_max: f32,
    /// Largest duty of a knot.
    duty_max: f32,
    /// Duty at the knots, forwards and backwards, positive in its own direction.
    duty: [[f32; KNOTS]; 2],
    /// Bit masks of the knots that have been seen, by direction.
    seen: [u8; 2],
    /// Share of the duty at rest that friction takes; a dead band takes the rest.
    friction_share: f32,
}

impl DriveCurve {
    /// Creates the curve `static_duty + duty_per_speed v` with no knot seen.
    pub(super) fn new(static_duty: f32, duty_per_speed: f32, speed_max: f32, duty_max: f32) -> Self {
        let duty = SHARES.map(|share| static_duty + duty_per_speed * speed_max * share);
        Self { speed_max, duty_max, duty: [duty; 2], seen: [0; 2], friction_share: 0.5 }
    }

    /// Returns the segment of a speed >= 0 and the share of the distance along it; the last segment is extrapolated.
    fn place(&self, speed: f32) -> (usize, f32) {
        let share = speed / self.speed_max;
        let knot = usize::from(share > SHARES[1]) + usize::from(share > SHARES[2]);
        (knot, (share - SHARES[knot]) / (SHARES[knot + 1] - SHARES[knot]))
    }

    /// Duty that holds a speed >= 0 in a direction, positive in that direction.
    fn along(&self, side: usize, speed: f32) -> f32 {
        let (knot, share) = self.place(speed);
        let duty = &self.duty[side];
        duty[knot] + (duty[knot + 1] - duty[knot]) * share
    }

    /// Speed that a duty along a direction holds; the duty is at least that at rest.
    fn speed_along(&self, side: usize, along: f32) -> f32 {
        let duty = &self.duty[side];
        let knot = usize::from(along > duty[1]) + usize::from(along > duty[2]);
        let share = (along - duty[knot]) / (duty[knot + 1] - duty[knot]);
        self.speed_max * (SHARES[knot] + (SHARES[knot + 1] - SHARES[knot]) * share)
    }

    /// Slope of the whole curve, duty per speed; used for braking.
    fn slope(&self, side: usize) -> f32 {
        (self.duty[side][KNOTS - 1] - self.duty[side][0]) / self.speed_max
    }

    /// Width of the band between the resistance of one direction and that of the other, as a duty and as a steady
    /// speed.
    fn braking(&self, side: usize) -> (f32, f32) {
        let span = (self.duty[0][0] + self.duty[1][0]).max(0.0);
        (span, span * self.friction_share.max(LEAST_FRICTION) / self.slope(side))
    }

    /// Duty with which a motor settles at the speed `steady` while it moves, or is to move, towards the sign of
    /// `towards`; 0 is a motor at rest, which gets the duty that the load takes.
    pub(super) fn duty(&self, steady: f32, towards: f32) -> f32 {
        if towards == 0.0 {
            return self.load();
        }
        let (sign, side) = if towards < 0.0 { (-1.0, 1) } else { (1.0, 0) };
        let speed = steady * sign;
        if speed >= 0.0 {
            return sign * self.along(side, speed);
        }
        let (span, span_speed) = self.braking(side);
        if -speed < span_speed {
            return sign * (self.duty[side][0] + speed / span_speed * span);
        }
        -sign * self.along(1 - side, -speed - span_speed)
    }

    /// Speed at which a motor that now moves at `speed` settles with `duty`.
    pub(super) fn steady(&self, duty: f32, speed: f32) -> f32 {
        if speed == 0.0 {
            return match (duty > self.duty[0][0], -duty > self.duty[1][0]) {
                (true, _) => self.speed_along(0, duty),
                (_, true) => -self.speed_along(1, -duty),
                _ => 0.0,
            };
        }
        let (sign, side) = if speed < 0.0 { (-1.0, 1) } else { (1.0, 0) };
        let along = duty * sign;
        let short = self.duty[side][0] - along;
        if short <= 0.0 {
            return sign * self.speed_along(side, along);
        }
        let (span, span_speed) = self.braking(side);
        if short < span {
            return -sign * short / span * span_speed;
        }
        -sign * (span_speed + self.speed_along(1 - side, -along))
    }

    /// Duty that friction or a dead band takes at rest, without a load.
    pub(super) fn threshold(&self) -> f32 {
        0.5 * (self.duty[0][0] + self.duty[1][0])
    }

    /// Duty that a load takes at rest, positive if it pulls backwards.
    fn load(&self) -> f32 {
        0.5 * (self.duty[0][0] - self.duty[1][0])
    }

    /// Learns that a motor moving at `speed` settles at `steady` with `duty`, with the weight `share` in 0..=1.
    pub(super) fn learn(&mut self, steady: f32, duty: f32, speed: f32, share: f32) {
        let (sign, side) = if speed < 0.0 { (-1.0, 1) } else { (1.0, 0) };
        let (along, steady) = (duty * sign, steady * sign);
        if along <= -OVERPOWERED * self.duty_max {
            return;
        }
        let short = self.duty[side][0] - along;
        if short <= 0.0 || steady > NEARLY_AT_REST * self.speed_max {
            self.learn_knots(side, steady.max(0.0), along, share);
        } else {
            let (span, _) = self.braking(side);
            if short < span {
                // From s = -friction_share short / slope.
                let found = -steady * self.slope(side) / short;
                // A small shortage of duty carries little information.
                let weight = (20.0 * share * short / span).min(1.0);
                self.friction_share += weight * (found.within(0.0, 1.0) - self.friction_share);
            }
        }
    }

    /// Learns that a motor at rest began to move towards `sign` with the duty `along` in that direction.
    pub(super) fn gave_way(&mut self, sign: f32, along: f32) {
        let side = usize::from(sign < 0.0);
        if along < self.duty[side][0] {
            self.learn_knots(side, 0.0, along, 1.0);
        }
    }

    fn learn_knots(&mut self, side: usize, steady: f32, along: f32, share: f32) {
        let (knot, way) = self.place(steady);
        let way = way.min(1.0);
        let error = share * (along - self.along(side, steady.min(self.speed_max)));
        self.seen[side] |= 1 << (knot + usize::from(way >= 0.5));
        for at in 0..KNOTS {
            let (is_end, change) = match at {
                _ if at <= knot => (at == knot, (1.0 - way) * error),
                _ => (at == knot + 1, way * error),
            };
            // Unseen knots move along: those beyond, and the same knot of the other direction.
            for (of, moves) in [(side, is_end || !self.is_seen(side, at)), (1 - side, !self.is_seen(1 - side, at))] {
                if moves && (of == side || is_end || !self.is_seen(side, at)) {
                    let duty = &mut self.duty[of][at];
                    *duty = (*duty + change).within(-self.duty_max, 2.0 * self.duty_max);
                }
            }
        }
        for duty in &mut self.duty {
            for at in 1..KNOTS {
                let rise = LEAST_RISE * self.duty_max * (SHARES[at] - SHARES[at - 1]);
                duty[at] = duty[at].max(duty[at - 1] + rise);
            }
        }
    }

    fn is_seen(&self, side: usize, at: usize) -> bool {
        self.seen[side] & (1 << at) != 0
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use proptest::prelude::*;

    use super::*;

    const SPEED_MAX: f32 = 5.0;

    /// Curve after learning from a motor with the law `law`, at each of `speeds`, forwards, for 2000 periods of 1 %
    /// each.
    fn learned(prior: (f32, f32), speeds: &[f32], law: impl Fn(f32) -> f32) -> DriveCurve {
        let mut curve = DriveCurve::new(prior.0, prior.1, SPEED_MAX, 0.9);
        for _ in 0..2000 {
            for speed in speeds {
                curve.learn(*speed, law(*speed), *speed, 0.01);
            }
        }
        curve
    }

    /// Prior 0.4 on both sides. Lifting took 0.6, and then the load fell although it got 0.2: 0.4 of load and 0.2 of
    /// friction.
    #[test]
    fn a_load_shows_where_it_falls() {
        let mut curve = DriveCurve::new(0.4, 0.1, SPEED_MAX, 0.9);
        curve.learn_knots(0, 0.0, 0.6, 1.0);
        assert!(curve.load().abs() < 1e-6, "the side that nobody has seen is taken to be alike: {curve:?}");
        curve.gave_way(-1.0, -0.2);
        assert!((curve.load() - 0.4).abs() < 1e-6 && (curve.threshold() - 0.2).abs() < 1e-6, "{curve:?}");
        // A push along the fall carries no new information.
        let before = curve.duty;
        curve.gave_way(-1.0, 0.1);
        assert_eq!(curve.duty, before);
    }

    /// Sample of a motor at the limit whose sensor counts the wrong way.
    #[test]
    fn a_motor_that_moves_against_all_of_its_duty_teaches_nothing() {
        let mut curve = DriveCurve::new(0.4, 0.1, SPEED_MAX, 0.9);
        let before = curve.duty;
        curve.learn(2.0, -0.9, 2.0, 0.1);
        curve.learn(-2.0, 0.9, -2.0, 0.1);
        assert_eq!(curve.duty, before);
        curve.learn(2.0, -0.5, 2.0, 0.1);
        assert_ne!(curve.duty, before, "a heavy load does that");
    }

    proptest! {
        /// Duty and steady speed are inverse functions for any direction of motion, friction and load.
        #[test]
        fn duty_and_steady_speed_are_inverse(
            static_duty in 0.0f32..0.5, duty_per_speed in 0.02f32..0.3, speed in -6.0f32..6.0, forwards: bool,
        ) {
            let curve = DriveCurve::new(static_duty, duty_per_speed, SPEED_MAX, 0.9);
            let towards = if forwards { 1.0 } else { -1.0 };
            let duty = curve.duty(speed, towards);
            let back = curve.steady(duty, towards * 0.1);
            // Two lines per direction, of numbers up to 6 with slopes down to 0.02.
            prop_assert!((back - speed).abs() < 1e-3, "{} by {}, not {}", back, duty, speed);
        }

        /// For any input the curve rises with speed and stays finite.
        #[test]
        fn nothing_it_learns_breaks_it(told in prop::collection::vec((-9.0f32..9.0, -1.0f32..1.0, -9.0f32..9.0), 1..200)) {
            let mut curve = DriveCurve::new(0.0, 0.1, SPEED_MAX, 0.9);
            for (steady, duty, speed) in told {
                curve.learn(steady, duty, speed, 0.5);
            }
            for towards in [1.0, -1.0] {
                let duties = (0..=50u8).map(|step| curve.duty(towards * f32::from(step) / 10.0, towards) * towards);
                let duties: Vec<f32> = duties.collect();
                prop_assert!(duties.iter().all(|duty| duty.is_finite() && duty.abs() < 3.0), "{:?}", duties);
                prop_assert!(duties.windows(2).all(|pair| pair[0] < pair[1]), "{:?}", duties);
            }
        }
    }

    /// Motor with friction 0.3 and 0.1 s/rad, neither known to the configuration, seen at four speeds.
    #[test]
    fn friction_is_learned_without_a_prior_value() {
        let curve = learned((0.0, 0.05), &[0.05, 0.3, 1.2, 4.0], |speed| 0.3 + 0.1 * speed);
        for speed in [0.05, 0.3, 1.2, 4.0] {
            let duty = curve.duty(speed, 1.0);
            assert!((duty - 0.3 - 0.1 * speed).abs() < 0.01, "{speed}: {duty}");
        }
        // The other direction has not been seen and is assumed to be alike.
        assert!((curve.duty(-1.2, -1.0) + 0.42).abs() < 0.03, "{}", curve.duty(-1.2, -1.0));
    }

    /// Friction of 0.2, and a load that takes 0.15 forwards and gives as much backwards.
    #[test]
    fn a_load_makes_the_directions_differ() {
        let mut curve = learned((0.0, 0.1), &[0.05, 0.5, 2.0], |speed| 0.35 + 0.1 * speed);
        for _ in 0..2000 {
            for speed in [-0.05f32, -0.5, -2.0] {
                curve.learn(speed, -0.05 + 0.1 * speed, speed, 0.01);
            }
        }
        assert!((curve.threshold() - 0.2).abs() < 0.02, "{}", curve.threshold());
        assert!((curve.duty(0.0, 0.0) - 0.15).abs() < 0.02, "{}", curve.duty(0.0, 0.0));
    }

    /// Motor that coasts at a duty of 0.1: with friction it would settle at a speed far behind, with a dead band at
    /// none.
    #[test]
    fn a_dead_band_and_friction_are_told_apart_by_how_it_coasts() {
        let of = |steady: f32| {
            let mut curve = DriveCurve::new(0.4, 0.1, SPEED_MAX, 0.9);
            for _ in 0..500 {
                curve.learn(steady, 0.1, 1.0, 0.01);
            }
            curve
        };
        // A shortage of 0.3 of duty at 0.1 s/rad.
        let (friction, dead_band) = (of(-3.0), of(0.0));
        assert!((friction.steady(0.1, 1.0) + 3.0).abs() < 0.1, "{}", friction.steady(0.1, 1.0));
        assert!(dead_band.steady(0.1, 1.0) > -0.2, "{}", dead_band.steady(0.1, 1.0));
        // To brake, it gets a duty near the other side of its dead band even for little; with friction, that brakes for
        // it.
        assert!(dead_band.duty(-0.5, 1.0) < -0.3, "{}", dead_band.duty(-0.5, 1.0));
        assert!(friction.duty(-0.5, 1.0) > 0.3, "{}", friction.duty(-0.5, 1.0));
    }
}
