//! Laws from whiskers to the shell's servo and the wheels, without a board.
//!
//! `d servo = a bend² + b bend + c` every 200 ms is the paper's form; its coefficients are not printed. Ours estimates
//! the positions of the boxes' inner corners. A sample of a whisker is a ray from the position of its hinge when the
//! sample was taken, `late_s` before it is shown; odometry and a model of the servo give that position. While the ray
//! points forwards, its tip lies on the near face of the box; once it points backwards, the corner is where the ray
//! meets the plane of that face. A box that yields leaves the whisker less bent than a standing one would: its corner
//! then seems farther out, and the shell stays wide.
//!
//! Until a corner is known the shell narrows as far as it goes, and while a whisker is bent it does not open again
//! ([`Uses::holds`]). Where the boxes stand the wheels slip, and odometry puts corners in the wrong place; rays then
//! only show when the boxes are passed.

use std::f64::consts::FRAC_PI_2;

use r4_rig::{Odometry, Velocity};

use super::scene::Setup;

/// Speed of every arm, m/s: 93.65 cm in 5 s, the farthest printed mean.
pub const SPEED_M_S: f64 = 0.187;
const STRAIGHT: Velocity = Velocity { forward_m_s: SPEED_M_S, yaw_rad_s: 0.0 };
/// Period of the paper's law, s: printed.
pub const EVERY_S: f64 = 0.2;
/// Bend above which a whisker counts as bent, rad: above most of the sampled play, and noise. With 0.03 a free whisker
/// that returns by only half its play still counts as bent.
pub const BENT_RAD: f64 = 0.06;
/// Bend from which on a whisker that has touched nothing yet counts as bent, rad: six times the noise of its magnet.
/// With [`BENT_RAD`] the first sample of a touch is missed in a quarter of the trials, and the shell narrows 200 ms
/// later.
const ONSET_RAD: f64 = 0.012;

/// Inputs of a law at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Time of the sample, s.
    pub time_s: f64,
    /// Backward bends of the left and right whisker, as shown, rad.
    pub bent_rad: [f64; 2],
    /// Angles of the left and right wheels, rad.
    pub wheels_rad: [f64; 2],
}

/// Commands of a law.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Order {
    /// Angle of the shell's servo, rad; 0 is the widest shell, at rest.
    pub servo_rad: f64,
    /// Velocity of the robot over the ground.
    pub velocity: Velocity,
}

/// A law that maps whisker readings to commands.
#[derive(Clone, Debug)]
pub enum Law {
    /// Law of the paper's form.
    Printed(Printed),
    /// Our law, by rays and corners.
    Ours(Box<Ours>),
}

impl Law {
    /// Returns the next command.
    pub fn next(&mut self, seen: Seen) -> Order {
        match self {
            Self::Printed(law) => law.next(seen),
            Self::Ours(law) => law.next(seen),
        }
    }
}

/// Coefficients of the paper's form.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Coefficients {
    /// Servo step by the bend squared, 1/rad.
    pub a: f64,
    /// Servo step by the bend; dimensionless.
    pub b: f64,
    /// Constant servo step while a whisker is bent, rad.
    pub c: f64,
    /// Share of the angle back to rest that each step returns while both whiskers are free.
    pub returns: f64,
}

/// Law of the paper's form. [`About::sampled`](crate::About::sampled) describes the test bed.
#[derive(Clone, Copy, Debug)]
pub struct Printed {
    coefficients: Coefficients,
    servo_max_rad: f64,
    servo_rad: f64,
    next_s: f64,
}

impl Printed {
    /// Starts with the shell at rest.
    #[must_use]
    pub const fn new(coefficients: Coefficients, setup: &Setup) -> Self {
        Self { coefficients, servo_max_rad: setup.servo_max_rad, servo_rad: 0.0, next_s: f64::NEG_INFINITY }
    }

    fn next(&mut self, seen: Seen) -> Order {
        if seen.time_s >= self.next_s {
            // 1 ms of slack: a sample whose stamp is a little early still counts for its period.
            self.next_s = seen.time_s + EVERY_S - 1e-3;
            let bend_rad = seen.bent_rad[0].max(seen.bent_rad[1]);
            let Coefficients { a, b, c, returns } = self.coefficients;
            self.servo_rad += if bend_rad < BENT_RAD {
                -returns * self.servo_rad
            } else {
                a * bend_rad * bend_rad + b * bend_rad + c
            };
            self.servo_rad = self.servo_rad.clamp(0.0, self.servo_max_rad);
        }
        Order { servo_rad: self.servo_rad, velocity: STRAIGHT }
    }
}

/// Parts of our law that are enabled; ablations disable one each.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Uses {
    /// True: a sample belongs to the robot's position when it was taken; false: to the position when it is shown.
    pub prediction: bool,
    /// True: the hinge follows the present shape of the shell; false: it is taken to be at rest.
    pub shape: bool,
    /// True: the shell stays narrow until its side panels are past the boxes; false: it opens once the whiskers are
    /// free.
    pub waits: bool,
    /// True: the shell does not open while a whisker is bent; false: it opens where the corners seem far enough out.
    pub holds: bool,
}

impl Uses {
    /// All parts of the law, enabled.
    pub const ALL: Self = Self { prediction: true, shape: true, waits: true, holds: true };
}

/// Clearance on both sides of the shell, m. With 4 mm, 19 of seeds 1 to 60 jammed between heavy boxes: the wheels slip
/// while the shell touches, so that odometry, and with it the corners, are up to 2 cm off.
const MARGIN_M: f64 = 0.015;
/// Distance behind the last point that a whisker leaned on at which the shell opens, m: a margin for slip.
const BEHIND_M: f64 = 0.02;
/// Change of a shown angle that counts as a new sample, rad: five times the converter's noise, a twentieth of the bend
/// of one period of travel.
const NEW_RAD: f64 = 2e-3;
/// Distance of a hinge beyond the near face from which on the ray is taken to meet the corner, m: 20 mrad of play shift
/// the corner by 12 mm there, and by twice as much at half the distance.
const CORNER_M: f64 = 0.02;
/// Largest apparent displacement of the near face of a standing box, m. Half of it comes from the noise of two samples
/// and half the play.
const STANDS_M: f64 = 0.012;
/// Signs of the sides, left and right.
const SIGNS: [f64; 2] = [1.0, -1.0];

/// A whisker in the plane, x along the frame and y outwards on its side, m; bearing in rad.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Ray {
    hinge_m: [f64; 2],
    tip_m: [f64; 2],
    bearing_rad: f64,
}

/// Pose and panel angle of the robot at one time.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Place {
    time_s: f64,
    x_m: f64,
    y_m: f64,
    yaw_rad: f64,
    panels_rad: f64,
}

/// Findings of one whisker.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Side {
    shown_rad: f64,
    is_bent: bool,
    /// True once it has been bent: from then on play keeps its magnet back.
    has_touched: bool,
    /// x of the near face, m from the start.
    face_m: Option<f64>,
    /// y of the inner corner, outwards, m; `None` while unknown.
    corner_m: Option<f64>,
    has_yielded: bool,
    /// x of the farthest point that the whisker has leaned on, m.
    last_m: f64,
}

/// Our law: rays, corners and the shell's width.
#[derive(Clone, Debug)]
pub struct Ours {
    setup: Setup,
    uses: Uses,
    track: Vec<Place>,
    odometry: Odometry,
    servo_rad: f64,
    wanted_rad: f64,
    sides: [Side; 2],
}

impl Ours {
    /// Starts at rest, at the origin of its own frame.
    #[must_use]
    pub fn new(setup: Setup, uses: Uses) -> Self {
        let odometry = Odometry::new(&setup.drive);
        let sides = [Side::default(); 2];
        Self { setup, uses, track: Vec::new(), odometry, servo_rad: 0.0, wanted_rad: 0.0, sides }
    }

    fn next(&mut self, seen: Seen) -> Order {
        let now = self.moved(seen);
        let late_s = self.setup.whiskers.late_s + self.setup.settles_s;
        let late_s = if self.uses.prediction { late_s } else { 0.0 };
        let then = self.at(seen.time_s - late_s);
        for (number, bent_rad) in seen.bent_rad.into_iter().enumerate() {
            if (bent_rad - self.sides[number].shown_rad).abs() > NEW_RAD {
                self.sides[number].shown_rad = bent_rad;
                self.take(number, then, bent_rad);
            }
            // The whisker may still lean on this point until the next sample shows otherwise.
            if self.sides[number].is_bent {
                let Ray { tip_m, .. } = self.ray(number, then, bent_rad);
                self.sides[number].last_m = self.sides[number].last_m.max(tip_m[0]);
            }
        }
        self.wanted_rad = self.wanted(now);
        Order { servo_rad: self.wanted_rad, velocity: STRAIGHT }
    }

    /// Updates odometry and the model of the servo.
    fn moved(&mut self, seen: Seen) -> Place {
        let [left_rad, right_rad] = seen.wheels_rad;
        self.odometry.look(left_rad, right_rad);
        let before_s = self.track.last().map_or(seen.time_s, |before| before.time_s);
        let most_rad = self.setup.servo_rad_s * (seen.time_s - before_s);
        self.servo_rad += (self.wanted_rad - self.servo_rad).clamp(-most_rad, most_rad);
        let place = self.odometry.place();
        let panels_rad = self.setup.shell.angle_rad(self.servo_rad);
        let now = Place { time_s: seen.time_s, x_m: place.x_m, y_m: place.y_m, yaw_rad: place.yaw_rad, panels_rad };
        self.track.push(now);
        now
    }

    /// Pose of the robot at a time, from the track.
    fn at(&self, time_s: f64) -> Place {
        let after = self.track.partition_point(|place| place.time_s < time_s).min(self.track.len() - 1);
        self.track[after]
    }

    /// Hinge and tip of a whisker at a pose, and its bearing, rad, from the frame's forward direction outwards.
    fn ray(&self, number: usize, then: Place, bent_rad: f64) -> Ray {
        let (sign, whiskers) = (SIGNS[number], &self.setup.whiskers);
        let panels_rad = if self.uses.shape { then.panels_rad } else { self.setup.shell.rest_rad };
        let ahead_m = 0.5 * self.setup.shell.length_m(panels_rad) + whiskers.hinge_m[0];
        let aside_m = sign * whiskers.hinge_m[1];
        let (sin, cos) = then.yaw_rad.sin_cos();
        let hinge_m = [then.x_m + cos * ahead_m - sin * aside_m, sign * (then.y_m + sin * ahead_m + cos * aside_m)];
        // While a whisker is pushed back its magnet lags by half the play.
        let bearing_rad = sign * then.yaw_rad + whiskers.rest_rad + bent_rad + 0.5 * whiskers.hysteresis_rad;
        let (sin, cos) = bearing_rad.sin_cos();
        let tip_m = [hinge_m[0] + whiskers.length_m * cos, hinge_m[1] + whiskers.length_m * sin];
        Ray { hinge_m, tip_m, bearing_rad }
    }

    /// Processes a sample of a whisker that was taken at pose `then`.
    fn take(&mut self, number: usize, then: Place, bent_rad: f64) {
        let Ray { hinge_m, tip_m, bearing_rad } = self.ray(number, then, bent_rad);
        let length_m = self.setup.whiskers.length_m;
        let side = &mut self.sides[number];
        let free_rad = if side.has_touched { BENT_RAD } else { ONSET_RAD };
        if bent_rad < free_rad {
            let Side { has_touched, last_m, .. } = *side;
            *side = Side { shown_rad: bent_rad, has_touched, last_m, ..Side::default() };
            return;
        }
        (side.is_bent, side.has_touched) = (true, true);
        let face_m = *side.face_m.get_or_insert(tip_m[0]);
        if bearing_rad < FRAC_PI_2 {
            side.has_yielded |= tip_m[0] > face_m + STANDS_M;
            // Only noise moves the face of a standing box: the nearest tip is kept.
            side.face_m = Some(face_m.min(tip_m[0]));
        } else if hinge_m[0] > face_m + CORNER_M {
            // On the plane of the near face, at most at the tip.
            let along_m = ((face_m - hinge_m[0]) / bearing_rad.cos()).clamp(0.0, length_m);
            side.corner_m = Some(hinge_m[1] + along_m * bearing_rad.sin());
        }
        if side.has_yielded && side.corner_m.is_none() {
            side.corner_m = Some(tip_m[1]);
        }
    }

    /// Servo angle, rad, for the known corners.
    fn wanted(&self, now: Place) -> f64 {
        let shell = &self.setup.shell;
        let is_bent = self.sides.iter().any(|side| side.is_bent);
        if !is_bent {
            let rear_m = now.x_m - 0.5 * shell.panel_m;
            let last_m = self.sides[0].last_m.max(self.sides[1].last_m);
            let is_past = rear_m > last_m + BEHIND_M;
            return if is_past || !self.uses.waits { 0.0 } else { self.wanted_rad };
        }
        // Outwards from the robot's axis. A side that has felt nothing yet is taken to be at distance 0: the shell
        // narrows fully.
        let sides = self.sides.iter().zip(SIGNS);
        let room_m = sides.map(|(side, sign)| match side.corner_m {
            Some(corner_m) => corner_m - sign * now.y_m,
            None => 0.0,
        });
        let narrowest_m = room_m.fold(f64::INFINITY, f64::min);
        let half_m = (narrowest_m - MARGIN_M).clamp(0.0, shell.panel_m * shell.rest_rad.sin());
        let wanted_rad = self.setup.servo_rad((half_m / shell.panel_m).asin());
        // While the shell rubs on a corner the wheels slip, and odometry moves that corner outwards by the slip. A
        // shell that opened by it jammed between standing boxes (seeds 5 and 23: 6 and 11 cm of travel).
        if self.uses.holds { wanted_rad.max(self.wanted_rad) } else { wanted_rad }
    }
}
