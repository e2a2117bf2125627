//! Follower of waypoints: turns towards a point, drives there, and slows down before obstacles.

use std::{collections::VecDeque, f64::consts::PI};

use crate::{ground::Velocity, odometry::Place};

/// Limits of the motion along a route.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Highest forward speed, m/s.
    pub speed_m_s: f64,
    /// Highest turn rate, rad/s.
    pub turn_rate_rad_s: f64,
    /// Deceleration in front of waypoints and obstacles, m/s².
    pub braking_m_s2: f64,
    /// Distance that is kept free in front, m.
    pub stop_m: f64,
    /// Distance within which a waypoint counts as reached, m.
    pub reached_m: f64,
}

/// Bearing from which on the robot stops and turns on the spot, rad. Our choice.
const FACING_RAD: f64 = 0.35;
/// Bearing at which the turn on the spot ends, rad. Our choice.
const FACED_RAD: f64 = 0.05;
/// Gain of the turn rate by the bearing, 1/s. Our choice: slow against the 20 ms of a telemetry period and the 20 ms in
/// which a wheel follows.
const TURN_PER_S: f64 = 2.0;

/// Follower of waypoints in their order.
#[derive(Clone, Debug)]
pub struct Follower {
    limits: Limits,
    places_m: VecDeque<[f64; 2]>,
    turns: bool,
}

impl Follower {
    /// Creates a follower of these waypoints, m, in the frame of the odometry.
    #[must_use]
    pub fn new(limits: Limits, places_m: impl IntoIterator<Item = [f64; 2]>) -> Self {
        Self { limits, places_m: places_m.into_iter().collect(), turns: false }
    }

    /// Number of waypoints that are not reached yet.
    #[must_use]
    pub fn places_left(&self) -> usize {
        self.places_m.len()
    }

    /// Velocity at a pose, with `free_m` of free distance in front; `None` once all waypoints are reached.
    ///
    /// The robot does not drive towards an obstacle nearer than [`Limits::stop_m`]: it stands until the obstacle is
    /// gone. It still turns on the spot.
    pub fn velocity(&mut self, at: Place, free_m: f64) -> Option<Velocity> {
        let Limits { speed_m_s, turn_rate_rad_s, braking_m_s2, stop_m, reached_m } = self.limits;
        let (to_x, to_y) = loop {
            let [x_m, y_m] = *self.places_m.front()?;
            let (to_x, to_y) = (x_m - at.x_m, y_m - at.y_m);
            if to_x.hypot(to_y) > reached_m {
                break (to_x, to_y);
            }
            self.places_m.pop_front();
            self.turns = true;
        };
        let aside_rad = wrapped(to_y.atan2(to_x) - at.yaw_rad);
        self.turns = aside_rad.abs() > if self.turns { FACED_RAD } else { FACING_RAD };
        let yaw_rad_s = (TURN_PER_S * aside_rad).clamp(-turn_rate_rad_s, turn_rate_rad_s);
        if self.turns {
            return Some(Velocity { forward_m_s: 0.0, yaw_rad_s });
        }
        // The speed from which the robot still stops in time.
        let within = |way_m: f64| (2.0 * braking_m_s2 * way_m.max(0.0)).sqrt();
        let to_place = within(to_x.hypot(to_y) - reached_m / 2.0);
        let forward_m_s = speed_m_s.min(to_place).min(within(free_m - stop_m));
        if forward_m_s == 0.0 {
            return Some(Velocity::default());
        }
        Some(Velocity { forward_m_s, yaw_rad_s })
    }
}

/// Wraps an angle to -π..π, rad.
fn wrapped(angle_rad: f64) -> f64 {
    let turned = (angle_rad + PI).rem_euclid(2.0 * PI);
    turned - PI
}

#[cfg(test)]
mod tests {
    use super::*;

    const LIMITS: Limits =
        Limits { speed_m_s: 0.3, turn_rate_rad_s: 1.0, braking_m_s2: 0.3, stop_m: 0.4, reached_m: 0.05 };
    const STEP_S: f64 = 0.02;

    /// Simulates an ideal robot that follows for at most `most_s`; returns its final pose and the time, s.
    fn followed(
        follower: &mut Follower,
        mut at: Place,
        free_m: impl Fn(Place, f64) -> f64,
        most_s: f64,
    ) -> (Place, f64) {
        let mut time_s = 0.0;
        while let Some(Velocity { forward_m_s, yaw_rad_s }) = follower.velocity(at, free_m(at, time_s)) {
            assert!((0.0..=LIMITS.speed_m_s).contains(&forward_m_s) && yaw_rad_s.abs() <= LIMITS.turn_rate_rad_s);
            at.x_m += forward_m_s * at.yaw_rad.cos() * STEP_S;
            at.y_m += forward_m_s * at.yaw_rad.sin() * STEP_S;
            at.yaw_rad += yaw_rad_s * STEP_S;
            time_s += STEP_S;
            if time_s > most_s {
                break;
            }
        }
        (at, time_s)
    }

    #[test]
    fn a_square_is_driven_to_its_end() {
        let corners = [[1.0, 0.0], [1.0, 1.0], [0.0, 1.0], [0.0, 0.0]];
        let mut follower = Follower::new(LIMITS, corners);
        let (at, time_s) = followed(&mut follower, Place::default(), |_, _| f64::INFINITY, 60.0);
        assert_eq!(follower.places_left(), 0);
        assert!(at.x_m.hypot(at.y_m) <= LIMITS.reached_m, "{at:?}");
        // 3.8 m at 0.3 m/s and three turns of 90 degrees at 1 rad/s are 17.4 s; turning in and slowing down take
        // additional time.
        assert!((17.4..26.0).contains(&time_s), "{time_s} s");
    }

    #[test]
    fn it_waits_for_what_is_in_the_way_and_goes_on() {
        let mut follower = Follower::new(LIMITS, [[3.0, 0.0]]);
        // An obstacle at 1.5 m until 20 s.
        let wall = |at: Place, time_s: f64| if time_s < 20.0 { 1.5 - at.x_m } else { f64::INFINITY };
        let (at, _) = followed(&mut follower.clone(), Place::default(), wall, 19.0);
        // Between two calls the robot moves by less than 1 mm at its speed there.
        assert!((1.0..=1.101).contains(&at.x_m), "{at:?} is {} m in front of it", 1.5 - at.x_m);
        let (at, time_s) = followed(&mut follower, Place::default(), wall, 60.0);
        assert!(time_s > 20.0 && (at.x_m - 3.0).abs() <= LIMITS.reached_m);
    }

    #[test]
    fn it_turns_the_short_way_before_it_drives() {
        let mut follower = Follower::new(LIMITS, [[-1.0, -0.1]]);
        let velocity = follower.velocity(Place { yaw_rad: -8.0 * PI, ..Place::default() }, 10.0).unwrap();
        assert!(velocity.forward_m_s == 0.0 && velocity.yaw_rad_s < 0.0, "{velocity:?}");
        assert_eq!(Follower::new(LIMITS, []).velocity(Place::default(), 1.0), None);
    }
}
