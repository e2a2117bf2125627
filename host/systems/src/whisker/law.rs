//! Laws from whiskers to the shell's servo and the wheels, without a board.
//!
//! `d servo = a bend² + b bend + c` every 200 ms is the paper's form; its coefficients are not printed. Ours works out where the boxes'
//! inner corners are: a sample of a whisker is a ray from where its hinge was when it was taken, `late_s` before it is shown, which odometry
//! and a model of the servo know. While it points forwards its tip lies on the near face of the box; once it points backwards the box's
//! corner is where the ray meets the plane of that face. A box that gives way leaves the whisker less bent than a standing one would: its
//! corner then seems farther out, and the shell stays wide.
//!
//! Until a corner is known the shell narrows as far as it goes, and while a whisker is bent it does not open again ([`Uses::holds`]): where the
//! boxes stand the wheels slip, and no corner is where odometry has it. Rays then say only when the boxes are passed.

use std::f64::consts::FRAC_PI_2;

use r4_rig::{Odometry, Velocity};

use super::scene::Setup;

/// Speed of every arm, m/s: 93.65 cm in 5 s, the farthest printed mean.
pub const SPEED_M_S: f64 = 0.187;
const STRAIGHT: Velocity = Velocity { forward_m_s: SPEED_M_S, yaw_rad_s: 0.0 };
/// How often the paper's law acts, s: printed.
pub const EVERY_S: f64 = 0.2;
/// Bend above which a whisker is not free, rad: most of the play that is sampled, and noise. With 0.03 a free whisker that comes back
/// by half its play still counts as bent.
pub const BENT_RAD: f64 = 0.06;
/// Bend from which on a whisker that has touched nothing yet is not free, rad: six times the noise of its magnet. With [`BENT_RAD`] the first
/// sample of a touch is missed in a quarter of the trials, and the shell narrows 200 ms later.
const ONSET_RAD: f64 = 0.012;

/// What is known at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// s
    pub time_s: f64,
    /// How far left and right whisker are bent backwards, as shown, rad.
    pub bent_rad: [f64; 2],
    /// Angles of the wheels on the left and on the right, rad.
    pub wheels_rad: [f64; 2],
}

/// What is commanded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Order {
    /// The shell's servo, rad; 0 is at rest.
    pub servo_rad: f64,
    /// Of the robot over the ground.
    pub velocity: Velocity,
}

/// A law.
#[derive(Clone, Debug)]
pub enum Law {
    /// The paper's form.
    Printed(Printed),
    /// Ours.
    Ours(Box<Ours>),
}

impl Law {
    /// The next command.
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
    /// Servo angle for a step by the bend squared, 1/rad.
    pub a: f64,
    /// By the bend, 1.
    pub b: f64,
    /// Always, rad.
    pub c: f64,
    /// Share of the way back to rest in each step while both whiskers are free.
    pub returns: f64,
}

/// The paper's form. [`About::sampled`](crate::About::sampled) has the test bed.
#[derive(Clone, Copy, Debug)]
pub struct Printed {
    coefficients: Coefficients,
    servo_max_rad: f64,
    servo_rad: f64,
    next_s: f64,
}

impl Printed {
    /// At rest.
    #[must_use]
    pub const fn new(coefficients: Coefficients, setup: &Setup) -> Self {
        Self { coefficients, servo_max_rad: setup.servo_max_rad, servo_rad: 0.0, next_s: f64::NEG_INFINITY }
    }

    fn next(&mut self, seen: Seen) -> Order {
        if seen.time_s >= self.next_s {
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

/// What of ours is used.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Uses {
    /// A sample belongs to where the robot was when it was taken; else to where it is when it is shown.
    pub prediction: bool,
    /// The hinge is where the present shape has it; else where it is at rest.
    pub shape: bool,
    /// The shell stays narrow until its side panels are past the boxes; else it opens once the whiskers are free.
    pub waits: bool,
    /// The shell does not open while a whisker is bent; else it does where the corners seem far enough out.
    pub holds: bool,
}

impl Uses {
    /// All.
    pub const ALL: Self = Self { prediction: true, shape: true, waits: true, holds: true };
}

/// Room that is left to both sides of the shell, m. With 4 mm 19 of seeds 1 to 60 jammed between heavy boxes: wheels that slip while the shell
/// touches take the odometry, and the corners with it, up to 2 cm off.
const MARGIN_M: f64 = 0.015;
/// The shell opens so far behind the last point that a whisker has leaned on, m: for slip.
const BEHIND_M: f64 = 0.02;
/// Change of a shown angle that is a new sample, rad: five times the converter's noise, a twentieth of what a period of travel bends.
const NEW_RAD: f64 = 2e-3;
/// Way of a hinge past the near face from which on the ray is taken to meet the corner, m: 20 mrad of play make 12 mm of the corner there, and
/// twice as much at half of it.
const CORNER_M: f64 = 0.02;
/// Way by which the near face of a box that stands may seem to move, m. Half of it is what noise of two samples and half the play come to.
const STANDS_M: f64 = 0.012;
/// Left and right.
const SIGNS: [f64; 2] = [1.0, -1.0];

/// A whisker, x along the frame and y outwards on its side, m.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Ray {
    hinge_m: [f64; 2],
    tip_m: [f64; 2],
    bearing_rad: f64,
}

/// Where the robot was.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Place {
    time_s: f64,
    x_m: f64,
    y_m: f64,
    yaw_rad: f64,
    panels_rad: f64,
}

/// What a whisker has found.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Side {
    shown_rad: f64,
    is_bent: bool,
    /// Whether it has ever been bent: from then on play keeps its magnet back.
    has_touched: bool,
    /// x of the near face, m from the start.
    face_m: Option<f64>,
    /// y of the inner corner, outwards, m.
    corner_m: Option<f64>,
    has_yielded: bool,
    /// x of the farthest point it has leaned on, m.
    last_m: f64,
}

/// Ours.
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
    /// At rest at the origin of its own frame.
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
            // It may lean on what is there until the next sample says that it does not.
            if self.sides[number].is_bent {
                let Ray { tip_m, .. } = self.ray(number, then, bent_rad);
                self.sides[number].last_m = self.sides[number].last_m.max(tip_m[0]);
            }
        }
        self.wanted_rad = self.wanted(now);
        Order { servo_rad: self.wanted_rad, velocity: STRAIGHT }
    }

    /// Odometry and the model of the servo.
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

    /// Where it was at a time.
    fn at(&self, time_s: f64) -> Place {
        let after = self.track.partition_point(|place| place.time_s < time_s).min(self.track.len() - 1);
        self.track[after]
    }

    /// Where a whisker's hinge and tip were, and its bearing from forwards of the frame outwards, rad.
    fn ray(&self, number: usize, then: Place, bent_rad: f64) -> Ray {
        let (sign, whiskers) = (SIGNS[number], &self.setup.whiskers);
        let panels_rad = if self.uses.shape { then.panels_rad } else { self.setup.shell.rest_rad };
        let ahead_m = 0.5 * self.setup.shell.length_m(panels_rad) + whiskers.hinge_m[0];
        let aside_m = sign * whiskers.hinge_m[1];
        let (sin, cos) = then.yaw_rad.sin_cos();
        let hinge_m = [then.x_m + cos * ahead_m - sin * aside_m, sign * (then.y_m + sin * ahead_m + cos * aside_m)];
        // While it is pushed back its magnet is behind by half the play.
        let bearing_rad = sign * then.yaw_rad + whiskers.rest_rad + bent_rad + 0.5 * whiskers.hysteresis_rad;
        let (sin, cos) = bearing_rad.sin_cos();
        let tip_m = [hinge_m[0] + whiskers.length_m * cos, hinge_m[1] + whiskers.length_m * sin];
        Ray { hinge_m, tip_m, bearing_rad }
    }

    /// Takes a sample of a whisker that was taken at a place.
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
            side.face_m = Some(face_m.min(tip_m[0]));
        } else if hinge_m[0] > face_m + CORNER_M {
            // On the plane of the near face, or as far out as the tip is.
            let along_m = ((face_m - hinge_m[0]) / bearing_rad.cos()).clamp(0.0, length_m);
            side.corner_m = Some(hinge_m[1] + along_m * bearing_rad.sin());
        }
        if side.has_yielded && side.corner_m.is_none() {
            side.corner_m = Some(tip_m[1]);
        }
    }

    /// Servo angle for what is known of the corners.
    fn wanted(&self, now: Place) -> f64 {
        let shell = &self.setup.shell;
        let is_bent = self.sides.iter().any(|side| side.is_bent);
        if !is_bent {
            let rear_m = now.x_m - 0.5 * shell.panel_m;
            let last_m = self.sides[0].last_m.max(self.sides[1].last_m);
            let is_past = rear_m > last_m + BEHIND_M;
            return if is_past || !self.uses.waits { 0.0 } else { self.wanted_rad };
        }
        // Outwards from the robot's axis; a side that has not been felt is taken to be as near as it may be.
        let sides = self.sides.iter().zip(SIGNS);
        let room_m = sides.map(|(side, sign)| match side.corner_m {
            Some(corner_m) => corner_m - sign * now.y_m,
            None => 0.0,
        });
        let narrowest_m = room_m.fold(f64::INFINITY, f64::min);
        let half_m = (narrowest_m - MARGIN_M).clamp(0.0, shell.panel_m * shell.rest_rad.sin());
        let wanted_rad = self.setup.servo_rad((half_m / shell.panel_m).asin());
        // While the shell rubs on a corner the wheels slip, and the ray puts that corner farther out the farther they do: a shell that opened by
        // it jammed between boxes that stand (seeds 5 and 23: 6 and 11 cm of way).
        if self.uses.holds { wanted_rad.max(self.wanted_rad) } else { wanted_rad }
    }
}
