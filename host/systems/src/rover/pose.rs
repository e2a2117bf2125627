//! Pose of a rover with its uncertainty: wheels and gyroscope propagate it, absolute readings correct it.
//!
//! An extended Kalman filter of x, y, yaw and the gyroscope's bias.
//!
//! # Source
//! Thrun, Burgard, Fox, *Probabilistic Robotics*, MIT Press 2005, 7.4 (EKF localisation).

use nalgebra::{Matrix4, RowVector4, Vector4};
use r4_rig::Place;

/// Process noise: variance of the position per metre of travel, m²/m, and of the yaw per second, rad²/s. Tenfold what
/// the sensors' noise integrates to, since a skidding robot shakes.
const WAY_VARIANCE_M: f64 = 4e-4;
const YAW_VARIANCE_RAD2_S: f64 = 1e-6;
/// Variance of the bias' random walk per second, rad²/s³.
const BIAS_VARIANCE: f64 = 1e-10;

/// Pose of the robot with its uncertainty.
#[derive(Clone, Debug)]
pub struct PoseFilter {
    /// x and y, m; yaw, rad; gyroscope bias, rad/s.
    state: Vector4<f64>,
    covariance: Matrix4<f64>,
}

impl PoseFilter {
    /// Starts at a known pose, with the rate that the gyroscope shows at rest as its bias, rad/s.
    #[must_use]
    pub fn at(start: Place, bias_rad_s: f64) -> Self {
        let deviations = Vector4::new(0.01, 0.01, 0.005, 2e-4);
        Self {
            state: Vector4::new(start.x_m, start.y_m, start.yaw_rad, bias_rad_s),
            covariance: Matrix4::from_diagonal(&deviations.component_mul(&deviations)),
        }
    }

    /// Estimated pose, m and rad.
    #[must_use]
    pub fn place(&self) -> Place {
        Place { x_m: self.state[0], y_m: self.state[1], yaw_rad: self.state[2] }
    }

    /// State vector: x and y, m; yaw, rad; gyroscope bias, rad/s.
    #[must_use]
    pub const fn state(&self) -> &Vector4<f64> {
        &self.state
    }

    /// Propagates the pose by the wheels' displacement, m, and the gyroscope's rate, rad/s, over a time step, s.
    pub fn move_on(&mut self, way_m: f64, rate_rad_s: f64, after_s: f64) {
        if !(way_m.is_finite() && rate_rad_s.is_finite() && after_s > 0.0) {
            return;
        }
        let turned_rad = (rate_rad_s - self.state[3]) * after_s;
        // Midpoint heading: exact to second order for a constant rate within the step.
        let (sin, cos) = (self.state[2] + turned_rad / 2.0).sin_cos();
        self.state += Vector4::new(way_m * cos, way_m * sin, turned_rad, 0.0);
        // Jacobian of the step by the state.
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

    /// Corrects the pose by one reading. `off` is the innovation (reading minus prediction), `row` the derivative of
    /// the reading by the state and `deviation` the reading's standard deviation, all in the reading's unit. Returns
    /// false, and changes nothing, when the innovation exceeds `gate` standard deviations of the prediction.
    pub fn correct(&mut self, row: &RowVector4<f64>, off: f64, deviation: f64, gate: f64) -> bool {
        let variance = (row * self.covariance * row.transpose())[(0, 0)] + deviation * deviation;
        // NaN compares as none and is rejected too.
        if off.abs().partial_cmp(&(gate * variance.sqrt())).is_none_or(std::cmp::Ordering::is_gt) {
            return false;
        }
        let gain = self.covariance * row.transpose() / variance;
        self.state += gain * off;
        let rest = Matrix4::identity() - gain * row;
        // Joseph's form keeps the covariance symmetric.
        self.covariance = rest * self.covariance * rest.transpose() + gain * gain.transpose() * (deviation * deviation);
        true
    }
}
