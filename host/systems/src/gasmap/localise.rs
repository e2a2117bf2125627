//! Where the robot is on the floor plan: wheels and gyroscope carry its pose on, two lidar beams correct it.
//!
//! An extended Kalman filter of x, y, yaw and the gyroscope's bias. A beam's reading is compared with the distance to the first wall of
//! the plan in its direction; where a small turn would make it meet another wall, it says nothing. What is far nearer than the plan has it
//! is somebody in the way, and is left out.
//!
//! # Source
//! Thrun, Burgard, Fox, *Probabilistic Robotics*, MIT Press 2005, 7.4 (EKF localisation), 6.3 (beams).

use nalgebra::{Matrix4, RowVector4, Vector4};
use r4_maps::pose::Point;
use r4_rig::Place;

/// A beam on the robot: its place, m, and direction, rad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Beam {
    /// m
    pub place_m: Point,
    /// Counterclockwise from forwards, rad.
    pub yaw_rad: f64,
}

/// The lidars at both connectors: ahead over the front edge, and to the left.
pub const BEAMS: [Beam; 2] =
    [Beam { place_m: [0.20, 0.0], yaw_rad: 0.0 }, Beam { place_m: [0.0, 0.18], yaw_rad: std::f64::consts::FRAC_PI_2 }];

/// Variance of the way for each metre of it, m, and of the yaw by the gyroscope for each second, rad²/s: tenfold what its noise adds up
/// to, since a skidding robot shakes.
const WAY_VARIANCE_M: f64 = 4e-4;
const YAW_VARIANCE_RAD2_S: f64 = 1e-6;
/// Of the bias' random walk, rad²/s³.
const BIAS_VARIANCE: f64 = 1e-10;
/// Standard deviation of a beam's reading, m: of a TFmini-S, 2 cm and 1 cm of resolution, and as a share of its length.
const BEAM_DEVIATION_M: f64 = 0.03;
const BEAM_SHARE: f64 = 0.005;
/// Turn by which a beam must not come to another wall, rad; and the change of its length that says so, m, besides that of a slanted wall.
const TURN_RAD: f64 = 0.03;
const JUMP_M: f64 = 0.15;
/// Readings farther off than this are of something that is not on the plan, in standard deviations.
const GATE: f64 = 4.0;

/// Pose of the robot with its uncertainty.
#[derive(Clone, Debug)]
pub struct Localised {
    state: Vector4<f64>,
    covariance: Matrix4<f64>,
    /// Beams that agreed with the plan, and that did not.
    counts: [u64; 2],
}

impl Localised {
    /// At a pose that is known, with the rate that the gyroscope shows at rest, rad/s.
    #[must_use]
    pub fn at(start: Place, bias_rad_s: f64) -> Self {
        let deviations = Vector4::new(0.01, 0.01, 0.005, 2e-4);
        Self {
            state: Vector4::new(start.x_m, start.y_m, start.yaw_rad, bias_rad_s),
            covariance: Matrix4::from_diagonal(&deviations.component_mul(&deviations)),
            counts: [0; 2],
        }
    }

    /// The pose.
    #[must_use]
    pub fn place(&self) -> Place {
        Place { x_m: self.state[0], y_m: self.state[1], yaw_rad: self.state[2] }
    }

    /// Beams that agreed with the plan, and that did not.
    #[must_use]
    pub const fn counts(&self) -> [u64; 2] {
        self.counts
    }

    /// Carries the pose on by the wheels' way, m, and the gyroscope's rate, rad/s, over a time, s.
    pub fn move_on(&mut self, way_m: f64, rate_rad_s: f64, after_s: f64) {
        if !(way_m.is_finite() && rate_rad_s.is_finite() && after_s > 0.0) {
            return;
        }
        let turned_rad = (rate_rad_s - self.state[3]) * after_s;
        let (sin, cos) = (self.state[2] + turned_rad / 2.0).sin_cos();
        self.state += Vector4::new(way_m * cos, way_m * sin, turned_rad, 0.0);
        let mut by = Matrix4::identity();
        by[(0, 2)] = -way_m * sin;
        by[(1, 2)] = way_m * cos;
        by[(0, 3)] = way_m * sin * after_s / 2.0;
        by[(1, 3)] = -way_m * cos * after_s / 2.0;
        by[(2, 3)] = -after_s;
        self.covariance = by * self.covariance * by.transpose();
        let along = WAY_VARIANCE_M * way_m.abs();
        self.covariance[(0, 0)] += along;
        self.covariance[(1, 1)] += along;
        self.covariance[(2, 2)] += YAW_VARIANCE_RAD2_S * after_s;
        self.covariance[(3, 3)] += BIAS_VARIANCE * after_s;
    }

    /// Corrects the pose by a beam's reading, m. Returns whether it was of a wall of the plan.
    pub fn correct(&mut self, walls_m: &[[Point; 2]], beam: Beam, reading_m: f64, farthest_m: f64) -> bool {
        let expected = |state: &Vector4<f64>, turn_rad: f64| {
            let (sin, cos) = state[2].sin_cos();
            let [x_m, y_m] = beam.place_m;
            let from = [state[0] + cos * x_m - sin * y_m, state[1] + sin * x_m + cos * y_m];
            ray_m(walls_m, from, state[2] + beam.yaw_rad + turn_rad)
        };
        let Some(expected_m) = expected(&self.state, 0.0).filter(|way_m| *way_m < farthest_m) else { return false };
        let Some([right_m, left_m]) =
            (|| Some([expected(&self.state, -TURN_RAD)?, expected(&self.state, TURN_RAD)?]))()
        else {
            return false;
        };
        // Along one straight wall the reciprocals of the lengths are a sine of the angle: their mean is that of the middle.
        let middle_m = 2.0 * TURN_RAD.cos() / (1.0 / right_m + 1.0 / left_m);
        if (middle_m - expected_m).abs() > JUMP_M / 5.0 || (right_m - left_m).abs() > JUMP_M * expected_m.max(1.0) {
            return false;
        }
        // Numerical derivatives: a wall is straight, and rounding is 1e-10 of them.
        const STEP: f64 = 1e-5;
        let mut row = RowVector4::zeros();
        for axis in 0..3 {
            let mut moved = self.state;
            moved[axis] += STEP;
            let Some(moved_m) = expected(&moved, 0.0) else { return false };
            row[axis] = (moved_m - expected_m) / STEP;
        }
        let deviation_m = BEAM_DEVIATION_M + BEAM_SHARE * expected_m;
        let variance = (row * self.covariance * row.transpose())[(0, 0)] + deviation_m * deviation_m;
        let off_m = reading_m - expected_m;
        if off_m.abs() > GATE * variance.sqrt() {
            self.counts[1] += 1;
            return false;
        }
        self.counts[0] += 1;
        let gain = self.covariance * row.transpose() / variance;
        self.state += gain * off_m;
        let rest = Matrix4::identity() - gain * row;
        // Joseph's form stays symmetric.
        self.covariance =
            rest * self.covariance * rest.transpose() + gain * gain.transpose() * (deviation_m * deviation_m);
        true
    }
}

/// Distance from a point in a direction to the first wall, m.
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

/// Bytes of a TFmini-S, as they come: frames of nine with the distance in cm.
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
            // The manual calls less than 100 unreliable.
            readings.push((strength >= 100 && centimetres < 0xFFFF).then(|| f64::from(centimetres) * 1e-2));
            self.bytes.drain(..9);
        }
        readings
    }
}
