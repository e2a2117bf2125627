//! Localisation on the floor plan: wheels and gyroscope propagate the pose, two lidar beams correct it.
//!
//! The filter compares a beam's reading with the distance to the first wall of the plan in its direction. A beam that a
//! small turn would move to another wall is not used. A reading far below the plan's distance comes from a person in
//! the way, and is rejected.
//!
//! # Source
//! Thrun, Burgard, Fox, *Probabilistic Robotics*, MIT Press 2005, 6.3 (beams).

use std::rc::Rc;

use nalgebra::{RowVector4, Vector4};
use r4_maps::pose::Point;

use super::plan::Plan;
use crate::rover::{Fix, PoseFilter};

/// A lidar beam on the robot.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beam {
    /// Position of the lidar: forwards and to the left of the robot's middle, m.
    pub place_m: Point,
    /// Direction of the beam, counterclockwise from forwards, rad.
    pub yaw_rad: f64,
}

/// Lidars at both connectors: forwards from the front edge, and to the left.
pub const BEAMS: [Beam; 2] =
    [Beam { place_m: [0.20, 0.0], yaw_rad: 0.0 }, Beam { place_m: [0.0, 0.18], yaw_rad: std::f64::consts::FRAC_PI_2 }];

/// Standard deviation of a beam's reading: a constant, m, and a share of its length. A TFmini-S has 2 cm and a
/// resolution of 1 cm.
const BEAM_DEVIATION_M: f64 = 0.03;
const BEAM_SHARE: f64 = 0.005;
/// Turn by which a beam must not reach another wall, rad; and the change of its length that indicates one, m, beyond
/// that of a slanted wall.
const TURN_RAD: f64 = 0.03;
const JUMP_M: f64 = 0.15;
/// Gate in standard deviations: readings beyond it come from something that is not on the plan.
const GATE: f64 = 4.0;

/// Longest reading of a lidar that is used, m: its range is 12 m.
const FARTHEST_M: f64 = 11.5;

/// Both lidars in a hall.
#[derive(Clone, Debug)]
pub struct Beams {
    plan: Rc<Plan>,
    frames: [Frames; 2],
    /// Number of readings that agreed with the plan, and of those that did not.
    counts: [u64; 2],
}

impl Beams {
    /// Creates the beams in a hall with this plan.
    #[must_use]
    pub fn new(plan: Rc<Plan>) -> Self {
        Self { plan, frames: Default::default(), counts: [0; 2] }
    }

    /// Corrects the pose by a beam's reading, m, where the plan gives an unambiguous distance.
    fn look(&mut self, pose: &mut PoseFilter, beam: Beam, reading_m: f64) {
        let walls_m = self.plan.walls_m();
        let expected = |state: &Vector4<f64>, turn_rad: f64| {
            let (sin, cos) = state[2].sin_cos();
            let [x_m, y_m] = beam.place_m;
            let from = [state[0] + cos * x_m - sin * y_m, state[1] + sin * x_m + cos * y_m];
            ray_m(walls_m, from, state[2] + beam.yaw_rad + turn_rad)
        };
        let Some(expected_m) = expected(pose.state(), 0.0).filter(|way_m| *way_m < FARTHEST_M) else { return };
        let Some([right_m, left_m]) =
            (|| Some([expected(pose.state(), -TURN_RAD)?, expected(pose.state(), TURN_RAD)?]))()
        else {
            return;
        };
        // Along one straight wall the reciprocal of the length is a sine of the angle: the mean of two directions gives
        // that of the middle.
        let middle_m = 2.0 * TURN_RAD.cos() / (1.0 / right_m + 1.0 / left_m);
        if (middle_m - expected_m).abs() > JUMP_M / 5.0 || (right_m - left_m).abs() > JUMP_M * expected_m.max(1.0) {
            return;
        }
        // Numerical derivatives: walls are straight, and the rounding error is 1e-10 of the derivative.
        const STEP: f64 = 1e-5;
        let mut row = RowVector4::zeros();
        for axis in 0..3 {
            let mut moved = *pose.state();
            moved[axis] += STEP;
            let Some(moved_m) = expected(&moved, 0.0) else { return };
            row[axis] = (moved_m - expected_m) / STEP;
        }
        let deviation_m = BEAM_DEVIATION_M + BEAM_SHARE * expected_m;
        let is_of_plan = pose.correct(&row, reading_m - expected_m, deviation_m, GATE);
        self.counts[usize::from(!is_of_plan)] += 1;
    }
}

impl Fix for Beams {
    fn port(&self, turn: usize) -> Option<u8> {
        Some((turn % BEAMS.len()) as u8)
    }

    fn correct(&mut self, port: u8, bytes: &[u8], pose: &mut PoseFilter) {
        let (Some(frames), Some(beam)) = (self.frames.get_mut(usize::from(port)), BEAMS.get(usize::from(port))) else {
            return;
        };
        let readings = frames.take(bytes);
        let seen: Vec<f64> = readings.into_iter().flatten().filter(|reading_m| *reading_m < FARTHEST_M).collect();
        if !seen.is_empty() {
            self.look(pose, *beam, seen.iter().sum::<f64>() / seen.len() as f64);
        }
    }

    fn counts(&self) -> [u64; 2] {
        self.counts
    }
}

/// Distance from a point in a direction to the first wall, m; `None` without a wall.
#[must_use]
pub fn ray_m(walls_m: &[[Point; 2]], from: Point, direction_rad: f64) -> Option<f64> {
    let (sin, cos) = direction_rad.sin_cos();
    let hits = walls_m.iter().filter_map(|[a, b]| {
        let (wall, to) = ([b[0] - a[0], b[1] - a[1]], [a[0] - from[0], a[1] - from[1]]);
        let across = cos * wall[1] - sin * wall[0];
        let way_m = (to[0] * wall[1] - to[1] * wall[0]) / across;
        let share = (to[0] * sin - to[1] * cos) / across;
        (way_m > 0.0 && (0.0..=1.0).contains(&share)).then_some(way_m)
    });
    hits.min_by(f64::total_cmp)
}

/// Decoder of a TFmini-S byte stream: frames of nine bytes with the distance in cm.
#[derive(Clone, Debug, Default)]
pub struct Frames {
    bytes: Vec<u8>,
}

impl Frames {
    /// Takes bytes and returns the readings that they complete, m; `None` for a frame without an echo.
    pub fn take(&mut self, bytes: &[u8]) -> Vec<Option<f64>> {
        self.bytes.extend_from_slice(bytes);
        let mut readings = Vec::new();
        while let Some(frame) = self.bytes.first_chunk::<9>() {
            let sum = frame[..8].iter().fold(0, |sum: u8, byte| sum.wrapping_add(*byte));
            if frame[..2] != [0x59, 0x59] || sum != frame[8] {
                self.bytes.remove(0);
                continue;
            }
            let number = |place: usize| u16::from_le_bytes([frame[place], frame[place + 1]]);
            let (centimetres, strength) = (number(2), number(4));
            // The manual calls a strength below 100 unreliable.
            readings.push((strength >= 100 && centimetres < 0xFFFF).then(|| f64::from(centimetres) * 1e-2));
            self.bytes.drain(..9);
        }
        readings
    }
}
