//! Poses in the plane.

/// Point, m: `[x, y]`.
pub type Point = [f64; 2];

/// Position and heading in a plane; also the transform from a frame at this pose into the outer frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose {
    /// Position along x, m.
    pub x_m: f64,
    /// Position along y, m.
    pub y_m: f64,
    /// Heading, rad, from +x towards +y.
    pub yaw_rad: f64,
}

impl Pose {
    /// Makes the pose at `x_m`, `y_m` with heading `yaw_rad`.
    #[must_use]
    pub const fn new(x_m: f64, y_m: f64, yaw_rad: f64) -> Self {
        Self { x_m, y_m, yaw_rad }
    }

    /// Returns whether all three numbers are finite.
    #[must_use]
    pub const fn is_finite(&self) -> bool {
        self.x_m.is_finite() && self.y_m.is_finite() && self.yaw_rad.is_finite()
    }

    /// Returns the position, m.
    #[must_use]
    pub const fn point(&self) -> Point {
        [self.x_m, self.y_m]
    }

    /// Returns the outer coordinates, m, of a point given in this pose's frame.
    ///
    /// ```
    /// use r4_maps::pose::Pose;
    /// let [x_m, y_m] = Pose::new(1.0, 2.0, std::f64::consts::FRAC_PI_2).outer([3.0, 0.0]);
    /// assert!((x_m - 1.0).abs() < 1e-12 && (y_m - 5.0).abs() < 1e-12);
    /// ```
    #[must_use]
    pub fn outer(&self, [x_m, y_m]: Point) -> Point {
        let (sin, cos) = self.yaw_rad.sin_cos();
        [self.x_m + cos * x_m - sin * y_m, self.y_m + sin * x_m + cos * y_m]
    }

    /// Returns the coordinates in this pose's frame, m, of an outer point: the inverse of [`Pose::outer`].
    #[must_use]
    pub fn inner(&self, [x_m, y_m]: Point) -> Point {
        let (sin, cos) = self.yaw_rad.sin_cos();
        let [dx_m, dy_m] = [x_m - self.x_m, y_m - self.y_m];
        [cos * dx_m + sin * dy_m, cos * dy_m - sin * dx_m]
    }

    /// Returns the pose in the outer frame of one that is given in this pose's frame; yaw within -π..=π.
    #[must_use]
    pub fn then(&self, inner: Self) -> Self {
        let [x_m, y_m] = self.outer(inner.point());
        Self { x_m, y_m, yaw_rad: wrapped(self.yaw_rad + inner.yaw_rad) }
    }

    /// Returns the pose in this pose's frame of one that is given in the outer frame: the inverse of [`Pose::then`].
    #[must_use]
    pub fn between(&self, outer: Self) -> Self {
        let [x_m, y_m] = self.inner(outer.point());
        Self { x_m, y_m, yaw_rad: wrapped(outer.yaw_rad - self.yaw_rad) }
    }
}

/// Returns the same angle within -π..=π, rad.
///
/// ```
/// assert!((r4_maps::pose::wrapped(7.0) - (7.0 - std::f64::consts::TAU)).abs() < 1e-12);
/// ```
#[must_use]
pub fn wrapped(angle_rad: f64) -> f64 {
    // Exact within the range, where `rem_euclid` would round.
    if angle_rad.abs() <= std::f64::consts::PI {
        return angle_rad;
    }
    (angle_rad + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI
}

/// Returns the distance between two points, m.
#[must_use]
pub fn distance_m(a: Point, b: Point) -> f64 {
    (a[0] - b[0]).hypot(a[1] - b[1])
}
