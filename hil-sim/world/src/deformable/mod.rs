//! Robot on wheels in a shell of six hinged panels that one servo narrows, with two whiskers at its nose.
//!
//! ```text
//!            w = 2 s sin(a)                 side panels are parallel to the spine, which is the body's x
//!   ______                                  s: length of a panel, a: angle of front and rear panels against the spine
//!  /      \       L = s + 2 s cos(a)
//! <        >  nose                          a = rest + per_rad * servo, between the ends of the spine's travel
//!  \______/
//! ```
//!
//! The shell follows the servo as long as it is not squeezed: under a squeeze it opens more slowly, at a limit force it
//! stops opening, and beyond that it yields. It is an [`Outline`], whose bumper ends at the panels: the outline's
//! corners lie inside them. It lengthens at both ends alike, so the wheels stay in its middle.
//!
//! A whisker is straight and massless. The farthest point of an obstacle within its reach bends it back, against its
//! spring: a box moves once the spring force exceeds friction. Its hinge has a magnet with some play, whose angle is
//! sampled; the sample appears in the readings after a delay.
//!
//! # Source
//! Hexagon, servo and whiskers: "Traversing Visually-Similar Physically-Different Obstacles with DeforMoBot, a Bio-Inspired Deformable
//! Mobile Robot", TAROS 2023. Its mechanism's dimensions are not printed; the equations are ours.
//!
//! Not modelled: inertia of the shell, forces along the spine on the servo, compliance of the hinges, bending of a
//! whisker along its length, its friction, tilting of boxes.

#[cfg(test)]
mod tests;
mod whisker;

use std::f64::consts::FRAC_PI_2;

pub use whisker::Whiskers;
use whisker::{Shown, Touch, Whisker};

use crate::{
    body::{Body, Inertial, Pose, ShaftMotion, Twist},
    outline::{BUMPER_M, Outline},
    scene::{Point, Scene},
    wheeled::Wheeled,
};

/// Names of the readings, in the order of [`Body::reading`].
const READINGS: [&str; 2] = ["left_rad", "right_rad"];
/// Rate of the panels' angle with which the shell opens without load and yields under twice its holding force, rad/s: a
/// servo of 2 rad/s with half a radian of panel angle per radian.
const OPENS_RAD_S: f64 = 1.0;
/// Change of the panels' angle below which the outline is not recomputed, rad: 0.02 µm at a panel of 0.2 m.
const SAME_RAD: f64 = 1e-7;

/// Six panels of equal length and their servo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shell {
    /// Length of a panel, m.
    pub panel_m: f64,
    /// Angle of the front panels against the spine with the servo at 0, rad.
    pub rest_rad: f64,
    /// Panel angle per radian of the servo; negative: positive servo angles narrow the shell.
    pub per_rad: f64,
    /// Ends of the spine's travel: narrowest and widest angle, rad.
    pub ends_rad: [f64; 2],
    /// Transverse force at which the shell stops opening, N.
    pub holds_n: f64,
    /// Shaft number of the servo.
    pub shaft: usize,
}

impl Shell {
    /// Angle of the front panels at a servo position, rad, clipped to the ends of travel.
    #[must_use]
    pub fn angle_rad(&self, servo_rad: f64) -> f64 {
        (self.rest_rad + self.per_rad * servo_rad).clamp(self.ends_rad[0], self.ends_rad[1])
    }

    /// Width across the side panels at an angle of the front panels, m.
    #[must_use]
    pub fn width_m(&self, angle_rad: f64) -> f64 {
        2.0 * self.panel_m * libm::sin(angle_rad)
    }

    /// Length from nose to tail at an angle of the front panels, m.
    #[must_use]
    pub fn length_m(&self, angle_rad: f64) -> f64 {
        self.panel_m + 2.0 * self.panel_m * libm::cos(angle_rad)
    }

    /// Corners, counterclockwise from the nose, of the hexagon `inside_m` inside the panels, m.
    #[must_use]
    pub fn corners_m(&self, angle_rad: f64, inside_m: f64) -> [Point; 6] {
        let nose_m = 0.5 * self.length_m(angle_rad) - inside_m / libm::sin(angle_rad);
        let (x, y) =
            (0.5 * self.panel_m - inside_m * libm::tan(0.5 * angle_rad), 0.5 * self.width_m(angle_rad) - inside_m);
        [[nose_m, 0.0], [x, y], [-x, y], [-nose_m, 0.0], [-x, -y], [x, -y]]
    }

    fn check(&self, shafts: usize) -> Result<(), DeformableError> {
        let [narrow_rad, wide_rad] = self.ends_rad;
        let is_ordered = 0.0 < narrow_rad && narrow_rad <= self.rest_rad && self.rest_rad <= wide_rad;
        // a hexagon inside the bumper must remain
        let is_wide = self.panel_m.is_finite() && self.panel_m * libm::sin(narrow_rad.max(0.0)) > 1.5 * BUMPER_M;
        let is_strong = self.holds_n > 0.0 && self.holds_n.is_finite();
        if !is_ordered
            || wide_rad > FRAC_PI_2
            || !self.per_rad.is_finite()
            || self.per_rad == 0.0
            || !is_wide
            || !is_strong
        {
            return Err(DeformableError::Shell { least_m: 3.0 * BUMPER_M });
        }
        if self.shaft < shafts { Ok(()) } else { Err(DeformableError::Shaft { shaft: self.shaft, shafts }) }
    }
}

/// Reasons why a deformable robot cannot be simulated.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum DeformableError {
    /// Parameters of the shell that make no hexagon.
    #[error(
        "the shell needs ends_rad [narrowest, widest] above 0 and at most a right angle with rest_rad between them, per_rad other than 0, \
         holds_n above 0, and a width of at least {least_m} m when narrow"
    )]
    Shell {
        /// Smallest width of a valid shell, m.
        least_m: f64,
    },
    /// A shaft that the body does not have.
    #[error("there is no shaft {shaft}: the body couples {shafts}")]
    Shaft {
        /// Shaft number that was given.
        shaft: usize,
        /// Number of shafts of the body.
        shafts: usize,
    },
    /// Parameters of the whiskers that are out of range.
    #[error(
        "whiskers need a length, stiffness and every_s above 0, rest_rad from 0 to half a turn, hinge_m not to the right, no negative \
         hysteresis, noise or late_s, and late_s at most 100 times every_s"
    )]
    Whiskers,
}

/// Chassis on wheels in a shell that narrows, with two whiskers.
#[derive(Clone, Debug, PartialEq)]
pub struct Deformable {
    base: Wheeled,
    shell: Shell,
    whiskers: Whiskers,
    /// Angle of the front panels, rad.
    angle_rad: f64,
    each: [Whisker; 2],
    shown: Shown,
}

impl Deformable {
    /// A robot at rest at the origin, with the servo at 0. The shell's outline replaces that of `base`.
    ///
    /// # Errors
    /// [`DeformableError`] names the parameters that are out of range.
    pub fn new(base: Wheeled, shell: Shell, whiskers: Whiskers) -> Result<Self, DeformableError> {
        shell.check(base.shafts())?;
        whiskers.check()?;
        let corners = shell.corners_m(shell.rest_rad, BUMPER_M).to_vec();
        let outline = Outline::new(corners).map_err(|_| DeformableError::Shell { least_m: 3.0 * BUMPER_M })?;
        let shown = Shown::new(whiskers.seed);
        let base = base.with_outline(outline);
        Ok(Self { base, shell, whiskers, angle_rad: shell.rest_rad, each: [Whisker::default(); 2], shown })
    }

    /// The same robot with changed parameters, at rest at the same pose.
    ///
    /// # Errors
    /// As [`Deformable::new`], for the changed parameters.
    pub fn changed(&self, change: impl FnOnce(&mut Shell, &mut Whiskers)) -> Result<Self, DeformableError> {
        let (mut shell, mut whiskers) = (self.shell, self.whiskers);
        change(&mut shell, &mut whiskers);
        let mut body = Self::new(self.base.clone(), shell, whiskers)?;
        body.set_pose(self.base.pose());
        Ok(body)
    }

    /// Chassis on wheels inside the shell.
    #[must_use]
    pub const fn base(&self) -> &Wheeled {
        &self.base
    }

    /// Lengths, angles and strength of the shell.
    #[must_use]
    pub const fn shell(&self) -> &Shell {
        &self.shell
    }

    /// Parameters of the whiskers.
    #[must_use]
    pub const fn whiskers(&self) -> &Whiskers {
        &self.whiskers
    }

    /// Angle of the front panels against the spine, rad.
    #[must_use]
    pub const fn angle_rad(&self) -> f64 {
        self.angle_rad
    }

    /// Angle of the front panels after a step towards `wanted_rad`, rad, limited by the squeeze.
    fn followed(&self, wanted_rad: f64, step_s: f64) -> f64 {
        let squeezed = self.base.outline().map_or(0.0, Outline::squeezed_n) / self.shell.holds_n;
        let most_rad = self.angle_rad + OPENS_RAD_S * (1.0 - squeezed) * step_s;
        wanted_rad.min(most_rad).max(self.shell.ends_rad[0])
    }

    /// Bend of the left and right whisker, rad, positive backwards.
    #[must_use]
    pub fn bent_rad(&self) -> [f64; 2] {
        self.each.map(|whisker| whisker.bent_rad)
    }
}

impl Body for Deformable {
    fn shafts(&self) -> usize {
        self.base.shafts()
    }

    fn step(&mut self, scene: &mut Scene, time_s: f64, shafts: &[ShaftMotion], loads: &mut [f64], step_s: f64) {
        let servo_rad = shafts.get(self.shell.shaft).map_or(0.0, |shaft| shaft.position);
        let angle_rad = self.followed(self.shell.angle_rad(servo_rad), step_s);
        if (angle_rad - self.angle_rad).abs() > SAME_RAD {
            self.angle_rad = angle_rad;
            let corners = self.shell.corners_m(angle_rad, BUMPER_M);
            if let Some(outline) = self.base.outline_mut() {
                outline.reshape(&corners);
            }
        }
        let pose = self.base.pose();
        let nose_m = 0.5 * self.shell.length_m(self.angle_rad);
        // along the panel, from the nose backwards
        let most_rad = std::f64::consts::PI - self.angle_rad - self.whiskers.rest_rad;
        let (sin, cos) = libm::sincos(pose.yaw_rad);
        for (side, whisker) in [1.0, -1.0].into_iter().zip(&mut self.each) {
            let touch = whisker.step(&self.whiskers, side, (pose, nose_m), most_rad.max(0.0), scene, time_s);
            let Some(Touch { at_m, force_n, box_number }) = touch else { continue };
            if let Some(one) = box_number.and_then(|number| scene.boxes_mut().get_mut(number)) {
                one.push(force_n, at_m);
            }
            let to_body = |[x, y]: Point| [cos * x + sin * y, cos * y - sin * x];
            self.base.push(to_body([-force_n[0], -force_n[1]]), to_body([at_m[0] - pose.x_m, at_m[1] - pose.y_m]));
        }
        self.shown.step(&self.whiskers, time_s, self.each.map(|whisker| whisker.magnet_rad));
        self.base.step(scene, time_s, shafts, loads, step_s);
    }

    fn pose(&self) -> Pose {
        self.base.pose()
    }

    fn set_pose(&mut self, pose: Pose) {
        self.base.set_pose(pose);
        self.each = [Whisker::default(); 2];
    }

    fn twist(&self) -> Twist {
        self.base.twist()
    }

    fn inertial(&self) -> Inertial {
        self.base.inertial()
    }

    fn outline(&self) -> Option<&Outline> {
        self.base.outline()
    }

    fn readings(&self) -> &'static [&'static str] {
        &READINGS
    }

    fn reading(&self, number: usize) -> f64 {
        self.shown.shown_rad.get(number).copied().unwrap_or(0.0)
    }
}
