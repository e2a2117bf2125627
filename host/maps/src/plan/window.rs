//! Dynamic window: the next speeds of a drive, among those that it can reach and from which it can still stop.

use thiserror::Error;

use super::PlanError;
use crate::{
    grid::Grid,
    pose::{Point, Pose, distance_m, wrapped},
};

/// Limits of a differential or skid-steer drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Highest speed ahead, m/s; the drive never goes backwards.
    pub speed_m_s: f64,
    /// Highest turn rate to either side, rad/s.
    pub turn_rad_s: f64,
    /// Highest acceleration and deceleration, m/s².
    pub acceleration_m_s2: f64,
    /// Highest angular acceleration, rad/s².
    pub turn_acceleration_rad_s2: f64,
    /// Smallest distance of an obstacle from the drive's centre, m: the radius of its outline and a margin.
    pub clearance_m: f64,
}

/// Speeds of a drive.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Drive {
    /// Speed straight ahead, m/s.
    pub speed_m_s: f64,
    /// Turn rate, rad/s, positive from +x towards +y.
    pub turn_rad_s: f64,
}

/// Weights of the criteria for a choice; only their ratios matter.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Preference {
    /// Weight of the heading to the target at the end of the period.
    pub heading: f64,
    /// Weight of the free length ahead.
    pub free: f64,
    /// Weight of the speed.
    pub speed: f64,
}

impl Default for Preference {
    /// Returns the published weights: 2, 0.2 and 0.2 (Fox, Burgard, Thrun 1997).
    fn default() -> Self {
        Self { heading: 2.0, free: 0.2, speed: 0.2 }
    }
}

/// Speeds that were chosen, with the free length.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Choice {
    /// The speeds for the next period.
    pub drive: Drive,
    /// Free length of the arc, m, as far as it was searched.
    pub free_m: f64,
}

/// Reason why the drive has to stop.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum Blocked {
    /// The drive is nearer to an obstacle than its clearance, or off the map.
    #[error(
        "an obstacle is {found_m} m from the centre and {needed_m} m are needed: back off by hand, or correct the map"
    )]
    Here {
        /// Distance to the nearest obstacle, m; 0 off the map.
        found_m: f64,
        /// Clearance that the drive needs, m.
        needed_m: f64,
    },
    /// Every reachable pair of speeds ends too near to an obstacle to stop before it.
    #[error("none of {tried} pairs of speeds stops before an obstacle: stop, and plan another way")]
    Ahead {
        /// Number of pairs that were tried.
        tried: usize,
    },
    /// A pose, speed or target is not finite.
    #[error("the pose, the speeds or the target are not finite: stop, and localise again")]
    NotFinite,
}

/// Planner by the dynamic-window approach.
///
/// # Source
/// Fox, Burgard, Thrun, "The Dynamic Window Approach to Collision Avoidance", IEEE Robotics and Automation Magazine 4, 1997.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Local {
    limits: Limits,
    preference: Preference,
    period_s: f64,
}

/// Number of speeds and turn rates tried on each axis of the window: odd, so that the present ones are among them.
const SPEEDS: i32 = 11;
const TURNS: i32 = 21;

/// Longest piece of an arc between two checks of the clearance, in cells: less than one, so that no cell is skipped.
const LOOK_CELLS: f64 = 0.5;

/// Largest drop of the clearance between two checks, in cells: half a piece, with a slope of at most √2 (bilinear
/// between distances).
const SLACK_CELLS: f64 = 0.25 * std::f64::consts::SQRT_2;

impl Local {
    /// Makes the planner for a drive with these limits, called every `period_s`.
    ///
    /// # Errors
    /// [`PlanError::Parameter`].
    pub fn new(limits: Limits, preference: Preference, period_s: f64) -> Result<Self, PlanError> {
        let above_0 = [
            ("speed_m_s", limits.speed_m_s),
            ("turn_rad_s", limits.turn_rad_s),
            ("acceleration_m_s2", limits.acceleration_m_s2),
            ("turn_acceleration_rad_s2", limits.turn_acceleration_rad_s2),
            ("clearance_m", limits.clearance_m),
            ("period_s", period_s),
            ("heading", preference.heading),
            ("free", preference.free),
            ("speed", preference.speed),
        ];
        let bad = above_0.into_iter().find(|(_, value)| !(*value > 0.0 && value.is_finite()));
        bad.map_or(Ok(Self { limits, preference, period_s }), |(what, value)| Err(PlanError::Parameter { what, value }))
    }

    /// Chooses the speeds for the next period, towards `target` (world, m), such as a point of a route some distance
    /// ahead.
    ///
    /// `clearance_m` has the distance to the nearest obstacle of each cell
    /// ([`crate::occupancy::Occupancy::clearance_m`], or [`crate::occupancy::clearance_m`] of all cells that are not
    /// free). After one period with the chosen speeds the drive can still stop before the first place that is too near
    /// to an obstacle.
    ///
    /// # Errors
    /// [`Blocked`]: the caller brakes on the arc that it drives, which was free.
    pub fn choose(&self, clearance_m: &Grid<f64>, pose: Pose, now: Drive, target: Point) -> Result<Choice, Blocked> {
        let finite = pose.is_finite() && target.iter().chain([&now.speed_m_s, &now.turn_rad_s]).all(|x| x.is_finite());
        if !finite {
            return Err(Blocked::NotFinite);
        }
        let needed_m = self.limits.clearance_m;
        let found_m = clear_m(clearance_m, pose.point());
        // The clearance may have dropped by the slack between two checks of the arc.
        if found_m < needed_m - SLACK_CELLS * clearance_m.frame().cell_m() {
            return Err(Blocked::Here { found_m, needed_m });
        }
        let Limits { speed_m_s, turn_rad_s, acceleration_m_s2, turn_acceleration_rad_s2, .. } = self.limits;
        let [reach_m_s, reach_rad_s] = [acceleration_m_s2, turn_acceleration_rad_s2].map(|limit| limit * self.period_s);
        // Farther than this no choice needs to see: one period at full speed, then braking.
        let look_m = self.stopping_m(speed_m_s) + speed_m_s * self.period_s;
        let mut best: Option<(f64, Choice)> = None;
        for step in 0..SPEEDS {
            let share = f64::from(2 * step) / f64::from(SPEEDS - 1) - 1.0;
            let speed_m_s = (now.speed_m_s + share * reach_m_s).clamp(0.0, speed_m_s);
            for side in 0..TURNS {
                let share = f64::from(2 * side) / f64::from(TURNS - 1) - 1.0;
                let turn_rad_s = (now.turn_rad_s + share * reach_rad_s).clamp(-turn_rad_s, turn_rad_s);
                let drive = Drive { speed_m_s, turn_rad_s };
                let free_m = self.free_m(clearance_m, pose, drive, look_m);
                // Admissible only if it can still stop after one more period.
                if self.stopping_m(speed_m_s) + speed_m_s * self.period_s > free_m {
                    continue;
                }
                let value = self.value(pose, drive, target, free_m / look_m);
                if best.is_none_or(|(least, _)| value > least) {
                    best = Some((value, Choice { drive, free_m }));
                }
            }
        }
        best.map(|(_, choice)| choice).ok_or(Blocked::Ahead { tried: (SPEEDS * TURNS) as usize })
    }

    fn stopping_m(&self, speed_m_s: f64) -> f64 {
        speed_m_s * speed_m_s / (2.0 * self.limits.acceleration_m_s2)
    }

    fn value(&self, pose: Pose, drive: Drive, target: Point, free: f64) -> f64 {
        // The heading at the end of the turn: after the period, and the time in which the turn rate can fall to 0.
        let turn_s = self.period_s + drive.turn_rad_s.abs() / (2.0 * self.limits.turn_acceleration_rad_s2);
        let end = after(pose, drive, turn_s);
        let bearing_rad = (target[1] - end.y_m).atan2(target[0] - end.x_m);
        let aligned = 1.0 - wrapped(bearing_rad - end.yaw_rad).abs() / std::f64::consts::PI;
        // Slower where the target is nearer than the stopping distance.
        let to_go_m = distance_m(pose.point(), target);
        let wanted_m_s = (2.0 * self.limits.acceleration_m_s2 * to_go_m).sqrt().min(self.limits.speed_m_s);
        let speed = 1.0 - (drive.speed_m_s - wanted_m_s).abs() / self.limits.speed_m_s;
        self.preference.heading * aligned + self.preference.free * free + self.preference.speed * speed
    }

    /// Returns the length of an arc up to the first place with too little clearance, at most `look_m`.
    fn free_m(&self, clearance_m: &Grid<f64>, pose: Pose, drive: Drive, look_m: f64) -> f64 {
        // Turning on the spot meets nothing: the drive is round for the planner.
        if drive.speed_m_s <= 0.0 {
            return look_m;
        }
        let pieces = (look_m / (LOOK_CELLS * clearance_m.frame().cell_m())).ceil();
        let mut free_m = 0.0;
        for piece in 1..=pieces as usize {
            let along_m = look_m * piece as f64 / pieces;
            let place = after(pose, drive, along_m / drive.speed_m_s).point();
            if clear_m(clearance_m, place) < self.limits.clearance_m {
                break;
            }
            free_m = along_m;
        }
        free_m
    }
}

/// Returns the clearance at a place, m; 0 off the map, and where the map's is not a number.
fn clear_m(clearance_m: &Grid<f64>, place: Point) -> f64 {
    // Infinite without any obstacle, which cannot be interpolated.
    let clear_m = clearance_m.interpolated(place).ok().filter(|clear_m| !clear_m.is_nan());
    clear_m.or_else(|| clearance_m.at(place).ok().copied()).filter(|clear_m| !clear_m.is_nan()).unwrap_or(0.0)
}

/// Returns the pose after some time at constant speeds: on an arc.
fn after(pose: Pose, drive: Drive, time_s: f64) -> Pose {
    let half_rad = 0.5 * drive.turn_rad_s * time_s;
    // sin(x)/x, by its series where x² is below the rounding error.
    let chord = if half_rad.abs() < 1e-8 { 1.0 } else { half_rad.sin() / half_rad };
    let length_m = drive.speed_m_s * time_s * chord;
    let (sin, cos) = (pose.yaw_rad + half_rad).sin_cos();
    Pose::new(pose.x_m + length_m * cos, pose.y_m + length_m * sin, wrapped(pose.yaw_rad + 2.0 * half_rad))
}
