//! Two fingers on a palm of variable width, with an object between them that rolls, slips, and stands on its faces.
//!
//! Everything moves in a plane: an object lies on a table, the gripper beside it. The frame's origin is the middle of
//! the palm, x points from the left finger's joint to the right one's, y away from the palm. Finger angles count from
//! x, counterclockwise.
//!
//! ```text
//! servo's set point -- k_servo -- output shaft (encoder) -- play, k_link -- finger = contact = object
//! ```
//!
//! A servo's position loop is a spring between its set point (the board's pulses) and its output shaft, which carries
//! the encoder; its motor damps the shaft against the housing by the slope of torque over speed. Play and compliance
//! between shaft and finger are behind the encoder and invisible to it. The palm's servo moves both joints by a rack
//! and two pinions; friction holds the carriages while the rack moves within its play.
//!
//! The object is a square with rounded edges, four arcs about the corners of a smaller square; with a radius of half the side it is a
//! disc. Fingers are flat. Each arc that touches a finger has a normal spring and a tangential one, which Coulomb's law limits: rolling
//! of a contact along the finger (`db = -r dtheta`), slip, and the change from one edge of a face to the other follow from that alone.
//! Table friction acts on the object's centre and its rotation.
//!
//! # Source
//! Geometry: "Object Feature Reconstruction via Robotic In-Hand-Manipulation and Haptic Proprioception", TAROS 2023. Contact: Cundall,
//! Strack, "A discrete numerical model for granular assemblies", Géotechnique 29 (1979) 47-65.
//!
//! # Accuracy
//! Semi-implicit Euler in steps of at most [`STEP_S`]; [`GripError::Pads`] rejects contacts stiffer than the limit of
//! stability.
//!
//! Not modelled: weight of fingers and object in the plane, ends of the fingers (an object that passes them is free), deformation of
//! the pads other than that of the springs, torque limits and heat of the servos.

#[cfg(test)]
mod tests;

use crate::{
    GRAVITY_M_S2,
    body::{Body, Inertial, Pose, ShaftMotion, Twist},
    dice::Dice,
    scene::Scene,
};

/// Longest step of the contacts, s.
const STEP_S: f64 = 1.25e-4;
/// Speed at which table friction reaches its full value, m/s: a hundredth of a typical pushing speed.
const TABLE_SLIDE_M_S: f64 = 1e-3;
/// Angle of the fingers with their servos at 0: at right angles to the palm.
const UPRIGHT_RAD: f64 = std::f64::consts::FRAC_PI_2;
/// Names of the readings, in the order of [`Body::reading`].
const READINGS: [&str; 3] = ["left_rad", "right_rad", "palm_rad"];

/// Palm with rack and pinions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Palm {
    /// Distance between the fingers' joints with the servo at 0, m.
    pub zero_m: f64,
    /// Change of that distance per radian of the servo, m/rad.
    pub m_per_rad: f64,
    /// Play of the rack, as distance between the joints, m.
    pub play_m: f64,
}

/// A finger and the servo that turns it; both fingers are equal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Finger {
    /// Length from the joint to the tip, m.
    pub length_m: f64,
    /// Distance from the line through the joint to the gripping surface, m.
    pub half_width_m: f64,
    /// Moment of inertia about the joint, kg m².
    pub inertia_kg_m2: f64,
    /// Stiffness between output shaft and finger, N m/rad.
    pub link_nm_per_rad: f64,
    /// Damping between output shaft and finger, N m s/rad.
    pub link_nm_s_per_rad: f64,
    /// Play between output shaft and finger, from end to end, rad.
    pub play_rad: f64,
    /// Stiffness of the servo's position loop, N m/rad.
    pub servo_nm_per_rad: f64,
    /// Slope of the servo motor's torque over speed, N m s/rad.
    pub servo_nm_s_per_rad: f64,
}

/// Contact properties of fingers and object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pads {
    /// Normal and tangential stiffness, N/m.
    pub stiffness_n_per_m: f64,
    /// Normal and tangential damping, N s/m.
    pub damping_n_s_per_m: f64,
    /// Coulomb friction coefficient of the contacts.
    pub friction: f64,
    /// Relaxation rate of the tangential spring, 1/s: 0 for dry pads, more for wet ones, on which contacts creep.
    pub creep_per_s: f64,
}

/// Object in the gripper: a square with rounded edges, or a disc.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Held {
    /// Distance between opposite faces, m.
    pub side_m: f64,
    /// Radius of its edges, m; half of the side for a disc.
    pub edge_m: f64,
    /// Mass of the object, kg.
    pub mass_kg: f64,
    /// Coulomb friction coefficient on the table.
    pub table_friction: f64,
    /// Initial place of its centre, m.
    pub place_m: [f64; 2],
    /// Initial angle of its faces against the palm's axis, rad.
    pub angle_rad: f64,
}

/// Encoders on the output shafts of the three servos.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Encoders {
    /// Quantisation step of a reading, rad.
    pub step_rad: f64,
    /// Noise before the quantisation, standard deviation, rad.
    pub noise_rad: f64,
    /// Zero errors of left, right and palm encoder, rad.
    pub offset_rad: [f64; 3],
    /// Seed of the noise generator.
    pub seed: u64,
}

/// Reasons why a gripper cannot be simulated.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum GripError {
    /// Parameters of the palm.
    #[error("the palm needs a distance above 0, m_per_rad other than 0, and no negative play")]
    Palm,
    /// Parameters of the fingers.
    #[error("a finger needs a length, inertia, stiffness and damping above 0, and no negative play or half width")]
    Finger,
    /// Parameters of the pads, or contacts that need shorter steps.
    #[error("pads must not be negative, and at most {most_n_per_m:.3e} N/m stiff for this object and these fingers")]
    Pads {
        /// Largest stable stiffness, N/m.
        most_n_per_m: f64,
    },
    /// Parameters of the object.
    #[error("an object needs a side and mass above 0, edges from 0 to half the side, and no negative friction")]
    Object,
    /// Parameters of the encoders.
    #[error("encoders need a step above 0 and no negative noise")]
    Encoders,
}

/// Contact of a finger with the object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Touch {
    /// Distance from the joint to the centre of the contacts' normal forces, m: b or d of the four-bar linkage.
    pub distance_m: f64,
    /// Place of that point in the plane, m.
    pub place_m: [f64; 2],
    /// Sum of the normal forces, N.
    pub normal_n: f64,
    /// True if any of its contacts slid in the last step.
    pub slides: bool,
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
struct Side {
    shaft_rad: f64,
    finger_rad: f64,
    rate_rad_s: f64,
    /// Deflections of the tangential springs at the object's arcs, m.
    springs_m: [f64; 4],
    touch: Option<Touch>,
}

/// Two fingers and an object. Shafts: the servos of the left finger, the right finger and the palm, all without load.
#[derive(Clone, Debug, PartialEq)]
pub struct TwoFingers {
    palm: Palm,
    finger: Finger,
    pads: Pads,
    held: Held,
    encoders: Encoders,
    sides: [Side; 2],
    /// Distance between the joints, m.
    width_m: f64,
    place_m: [f64; 2],
    angle_rad: f64,
    velocity_m_s: [f64; 2],
    rate_rad_s: f64,
    shown_rad: [f64; 3],
    noise: Dice,
    has_started: bool,
    pose: Pose,
}

fn cross([ax, ay]: [f64; 2], [bx, by]: [f64; 2]) -> f64 {
    ax * by - ay * bx
}

fn dot([ax, ay]: [f64; 2], [bx, by]: [f64; 2]) -> f64 {
    ax * bx + ay * by
}

impl TwoFingers {
    /// A gripper with an object, at rest; the fingers move to their servos' positions at the first step.
    ///
    /// # Errors
    /// [`GripError`] names the part whose parameters are out of range.
    pub fn new(palm: Palm, finger: Finger, pads: Pads, held: Held, encoders: Encoders) -> Result<Self, GripError> {
        let positive = |value: f64| value > 0.0 && value.is_finite();
        let not_negative = |value: f64| value >= 0.0 && value.is_finite();
        if !positive(palm.zero_m) || !palm.m_per_rad.is_finite() || palm.m_per_rad == 0.0 || !not_negative(palm.play_m)
        {
            return Err(GripError::Palm);
        }
        let Finger { length_m, half_width_m, inertia_kg_m2, link_nm_per_rad, link_nm_s_per_rad, play_rad, .. } = finger;
        let Finger { servo_nm_per_rad, servo_nm_s_per_rad, .. } = finger;
        let above = [length_m, inertia_kg_m2, link_nm_per_rad, servo_nm_per_rad, servo_nm_s_per_rad];
        if !above.into_iter().all(positive)
            || ![half_width_m, link_nm_s_per_rad, play_rad].into_iter().all(not_negative)
        {
            return Err(GripError::Finger);
        }
        let is_shaped = positive(held.side_m) && positive(held.mass_kg) && not_negative(held.edge_m);
        let is_placed = held.place_m.iter().all(|place| place.is_finite()) && held.angle_rad.is_finite();
        if !is_shaped || !is_placed || held.edge_m > 0.5 * held.side_m || !not_negative(held.table_friction) {
            return Err(GripError::Object);
        }
        // Two contacts on a mass m oscillate at sqrt(2 k / m), on its inertia m s²/6 at up to sqrt(6 k / m); a finger
        // at its tip at l sqrt(k / I). Semi-implicit steps are stable up to 2 divided by that frequency; half of it
        // leaves margin for the damping.
        let inverse = (6.0 / held.mass_kg).max(length_m * length_m / inertia_kg_m2);
        let most_n_per_m = 1.0 / (STEP_S * STEP_S * inverse);
        let numbers = [pads.stiffness_n_per_m, pads.damping_n_s_per_m, pads.friction, pads.creep_per_s];
        if !numbers.into_iter().all(not_negative) || pads.stiffness_n_per_m > most_n_per_m {
            return Err(GripError::Pads { most_n_per_m });
        }
        let offsets = encoders.offset_rad.iter().all(|offset| offset.is_finite());
        if !positive(encoders.step_rad) || !not_negative(encoders.noise_rad) || !offsets {
            return Err(GripError::Encoders);
        }
        Ok(Self {
            palm,
            finger,
            pads,
            held,
            encoders,
            sides: [Side::default(); 2],
            width_m: palm.zero_m,
            place_m: held.place_m,
            angle_rad: held.angle_rad,
            velocity_m_s: [0.0; 2],
            rate_rad_s: 0.0,
            shown_rad: [0.0; 3],
            noise: Dice::new(encoders.seed),
            has_started: false,
            pose: Pose::default(),
        })
    }

    /// Parameters of the palm.
    #[must_use]
    pub const fn palm(&self) -> &Palm {
        &self.palm
    }

    /// Parameters of either finger.
    #[must_use]
    pub const fn finger(&self) -> &Finger {
        &self.finger
    }

    /// Contact properties of the surfaces.
    #[must_use]
    pub const fn pads(&self) -> &Pads {
        &self.pads
    }

    /// Parameters of the object, with its initial place.
    #[must_use]
    pub const fn held(&self) -> &Held {
        &self.held
    }

    /// Parameters of the encoders.
    #[must_use]
    pub const fn encoders(&self) -> &Encoders {
        &self.encoders
    }

    /// Distance between the fingers' joints, m.
    #[must_use]
    pub const fn width_m(&self) -> f64 {
        self.width_m
    }

    /// Angles of left and right finger, rad.
    #[must_use]
    pub fn finger_rad(&self) -> [f64; 2] {
        self.sides.map(|side| side.finger_rad)
    }

    /// Contacts of left and right finger with the object; `None` for a finger without contact.
    #[must_use]
    pub fn touches(&self) -> [Option<Touch>; 2] {
        self.sides.map(|side| side.touch)
    }

    /// Centre of the object, m.
    #[must_use]
    pub const fn object_m(&self) -> [f64; 2] {
        self.place_m
    }

    /// Angle of the object, rad, counterclockwise.
    #[must_use]
    pub const fn object_rad(&self) -> f64 {
        self.angle_rad
    }

    /// Speed of the object's centre, m/s.
    #[must_use]
    pub fn object_m_s(&self) -> f64 {
        libm::hypot(self.velocity_m_s[0], self.velocity_m_s[1])
    }

    fn show(&mut self, palm_rad: f64) {
        let true_rad = [self.sides[0].shaft_rad - UPRIGHT_RAD, self.sides[1].shaft_rad - UPRIGHT_RAD, palm_rad];
        for (number, angle_rad) in true_rad.into_iter().enumerate() {
            let Encoders { step_rad, noise_rad, offset_rad, .. } = self.encoders;
            let felt_rad = angle_rad + offset_rad[number] + noise_rad * self.noise.normal();
            self.shown_rad[number] = libm::round(felt_rad / step_rad) * step_rad;
        }
    }

    /// Centres of the object's arcs relative to its centre, m, and their number.
    fn arcs(&self) -> ([[f64; 2]; 4], usize) {
        let half_m = 0.5 * self.held.side_m - self.held.edge_m;
        // a disc has one: four at one place would be four times as stiff
        if half_m < 1e-6 {
            return ([[0.0; 2]; 4], 1);
        }
        let (sin, cos) = libm::sincos(self.angle_rad);
        let (x, y) = (half_m * (cos - sin), half_m * (cos + sin));
        ([[x, y], [-y, x], [-x, -y], [y, -x]], 4)
    }

    /// Advances by one step: forces of all contacts, then servos, fingers and object.
    fn advance(&mut self, set_rad: [f64; 2], widens_m_s: f64, step_s: f64) {
        let Pads { stiffness_n_per_m, damping_n_s_per_m, friction, creep_per_s } = self.pads;
        let Finger { length_m, half_width_m, .. } = self.finger;
        let edge_m = self.held.edge_m;
        let (arcs, count) = self.arcs();
        let (mut force_n, mut torque_nm, mut joints_nm) = ([0.0; 2], 0.0, [0.0; 2]);
        for (number, (side, joint_nm)) in self.sides.iter_mut().zip(&mut joints_nm).enumerate() {
            let sign = if number == 0 { -0.5 } else { 0.5 };
            let (joint_m, joint_m_s) = ([sign * self.width_m, 0.0], sign * widens_m_s);
            let (sin, cos) = libm::sincos(side.finger_rad);
            let along = [cos, sin];
            let inwards = if number == 0 { [sin, -cos] } else { [-sin, cos] };
            let (mut weight_n, mut moment_m_n, mut slides) = (0.0, 0.0, false);
            for (spring_m, arc) in side.springs_m.iter_mut().zip(arcs).take(count) {
                let centre_m = [self.place_m[0] + arc[0] - joint_m[0], self.place_m[1] + arc[1] - joint_m[1]];
                let gap_m = dot(centre_m, inwards) - half_width_m - edge_m;
                let along_m = dot(centre_m, along);
                if gap_m >= 0.0 || !(0.0..=length_m).contains(&along_m) {
                    *spring_m = 0.0;
                    continue;
                }
                // lever arms from the joint, and from the object's centre
                let contact_m = [centre_m[0] - edge_m * inwards[0], centre_m[1] - edge_m * inwards[1]];
                let arm_m = [arc[0] - edge_m * inwards[0], arc[1] - edge_m * inwards[1]];
                let relative_m_s = [
                    self.velocity_m_s[0] - joint_m_s - self.rate_rad_s * arm_m[1] + side.rate_rad_s * contact_m[1],
                    self.velocity_m_s[1] + self.rate_rad_s * arm_m[0] - side.rate_rad_s * contact_m[0],
                ];
                let normal_n = (-stiffness_n_per_m * gap_m - damping_n_s_per_m * dot(relative_m_s, inwards)).max(0.0);
                let slip_m_s = dot(relative_m_s, along);
                *spring_m += (slip_m_s - creep_per_s * *spring_m) * step_s;
                let mut along_n = -stiffness_n_per_m * *spring_m - damping_n_s_per_m * slip_m_s;
                let most_n = friction * normal_n;
                if along_n.abs() > most_n {
                    along_n = along_n.clamp(-most_n, most_n);
                    *spring_m = -along_n / stiffness_n_per_m.max(f64::MIN_POSITIVE);
                    slides = true;
                }
                let contact_n =
                    [normal_n * inwards[0] + along_n * along[0], normal_n * inwards[1] + along_n * along[1]];
                force_n = [force_n[0] + contact_n[0], force_n[1] + contact_n[1]];
                torque_nm += cross(arm_m, contact_n);
                *joint_nm -= cross(contact_m, contact_n);
                weight_n += normal_n;
                moment_m_n += normal_n * along_m;
            }
            side.touch = (weight_n > 0.0).then(|| {
                let along_m = moment_m_n / weight_n;
                let place_m = [0, 1].map(|axis| joint_m[axis] + along_m * along[axis] + half_width_m * inwards[axis]);
                Touch { distance_m: libm::hypot(along_m, half_width_m), place_m, normal_n: weight_n, slides }
            });
        }
        let Finger { inertia_kg_m2, link_nm_per_rad, link_nm_s_per_rad, play_rad, servo_nm_per_rad, .. } = self.finger;
        for (number, side) in self.sides.iter_mut().enumerate() {
            let bent_rad = side.shaft_rad - side.finger_rad;
            let taken_up_rad = bent_rad - bent_rad.clamp(-0.5 * play_rad, 0.5 * play_rad);
            let servo_nm = servo_nm_per_rad * (set_rad[number] - side.shaft_rad);
            // the link's damper acts only where its spring does; the shaft is massless, so its speed follows from the
            // torques
            let link_s = if taken_up_rad == 0.0 { 0.0 } else { link_nm_s_per_rad };
            let resists = self.finger.servo_nm_s_per_rad + link_s;
            let pushed = servo_nm - link_nm_per_rad * taken_up_rad + link_s * side.rate_rad_s;
            let shaft_rad_s = pushed / resists;
            let link_nm = link_nm_per_rad * taken_up_rad + link_s * (shaft_rad_s - side.rate_rad_s);
            side.shaft_rad += shaft_rad_s * step_s;
            side.rate_rad_s += (link_nm + joints_nm[number]) / inertia_kg_m2 * step_s;
            side.finger_rad += side.rate_rad_s * step_s;
        }
        let Held { side_m, mass_kg, table_friction, .. } = self.held;
        let weight_n = table_friction * mass_kg * GRAVITY_M_S2;
        let speed_m_s = libm::hypot(self.velocity_m_s[0], self.velocity_m_s[1]);
        let drag = weight_n / speed_m_s.max(TABLE_SLIDE_M_S);
        // friction of a square that turns on the spot acts at a mean distance of 0.38 of its side
        let arm_m = 0.38 * side_m;
        let turning_m_s = (self.rate_rad_s * arm_m).abs().max(TABLE_SLIDE_M_S);
        let turning_drag = weight_n * arm_m * arm_m / turning_m_s;
        for ((velocity_m_s, place_m), force_n) in self.velocity_m_s.iter_mut().zip(&mut self.place_m).zip(force_n) {
            *velocity_m_s += (force_n - drag * *velocity_m_s) / mass_kg * step_s;
            *place_m += *velocity_m_s * step_s;
        }
        let inertia_kg_m2 = mass_kg * side_m * side_m / 6.0;
        self.rate_rad_s += (torque_nm - turning_drag * self.rate_rad_s) / inertia_kg_m2 * step_s;
        self.angle_rad += self.rate_rad_s * step_s;
    }
}

impl Body for TwoFingers {
    fn shafts(&self) -> usize {
        3
    }

    fn step(&mut self, _: &mut Scene, _: f64, shafts: &[ShaftMotion], loads: &mut [f64], step_s: f64) {
        loads.fill(0.0);
        let [left, right, palm] = shafts else { return };
        let end_rad = [left, right].map(|shaft| UPRIGHT_RAD + shaft.position);
        if !self.has_started {
            self.has_started = true;
            self.width_m = self.palm.zero_m + self.palm.m_per_rad * palm.position;
            for (side, set_rad) in self.sides.iter_mut().zip(end_rad) {
                (side.shaft_rad, side.finger_rad) = (set_rad, set_rad);
            }
        }
        let asked_m = self.palm.zero_m + self.palm.m_per_rad * palm.position;
        let count = libm::ceil(step_s / STEP_S - 1e-9).max(1.0);
        let part_s = step_s / count;
        let begin_m = self.width_m;
        let end_m = begin_m.clamp(asked_m - 0.5 * self.palm.play_m, asked_m + 0.5 * self.palm.play_m);
        for part in 1..=count as usize {
            self.width_m = begin_m + (end_m - begin_m) * part as f64 / count;
            self.advance(end_rad, (end_m - begin_m) / step_s, part_s);
        }
        self.show(palm.position);
    }

    fn pose(&self) -> Pose {
        self.pose
    }

    fn set_pose(&mut self, pose: Pose) {
        self.pose = pose;
    }

    fn twist(&self) -> Twist {
        Twist::default()
    }

    fn inertial(&self) -> Inertial {
        Inertial::AT_REST
    }

    fn readings(&self) -> &'static [&'static str] {
        &READINGS
    }

    fn reading(&self, number: usize) -> f64 {
        self.shown_rad.get(number).copied().unwrap_or(0.0)
    }
}
