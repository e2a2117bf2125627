//! Rigid chassis on wheels: skid-steer, differential and Ackermann robots, depending on the driven and the steered
//! wheels.
//!
//! ```text
//! m (dvx/dt - w vy) = sum Fx         Iz dw/dt = sum (x Fy - y Fx)
//! m (dvy/dt + w vx) = sum Fy         load of a shaft = -F_long R
//! ```
//!
//! Wheels are stiff springs of equal rate under a stiff chassis: each has the normal force due to weight and the
//! acceleration of the last step ([`Chassis::height_m`]); a wheel with a negative one is in the air. The robot neither
//! pitches nor rolls. A wheel's own inertia belongs to its shaft's plant and is no part of the robot's mass.
//!
//! # Accuracy
//! Forces hold over a step: first order in [`crate::MAX_STEP_S`]. Stable while a step is short against the time in
//! which the tyres' springs move a wheel: `dt < 2 sqrt(J c L) / R`, which [`Wheeled::new`] cannot check because the
//! inertias `J` belong to the plants.

use crate::{
    GRAVITY_M_S2,
    body::{Body, Inertial, Pose, ShaftMotion, Twist},
    outline::{Moving, Outline},
    scene::Scene,
    tyre::{Contact, Springs, Tyre, TyreError},
};

/// Mass properties of the chassis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Chassis {
    /// Mass of everything but the rotating parts, kg.
    pub mass_kg: f64,
    /// Moment of inertia about the vertical axis through the centre of mass, kg m².
    pub inertia_kg_m2: f64,
    /// Centre of mass in the body's frame, m.
    pub centre_m: [f64; 2],
    /// Height of the centre of mass above the ground, m, which causes load transfer between wheels.
    pub height_m: f64,
}

/// A wheel, in the body's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wheel {
    /// Contact point when not steered, m.
    pub place_m: [f64; 2],
    /// Radius of the wheel, m.
    pub radius_m: f64,
    /// Shaft number that drives it; `None` rolls freely without inertia.
    pub shaft: Option<usize>,
    /// True if a positive speed of the shaft drives backwards.
    pub inverted: bool,
    /// True if the [`Axle`] steers the wheel.
    pub steered: bool,
    /// Tyre of the wheel; `None` for a caster or ball that carries and slides without friction.
    pub tyre: Option<Tyre>,
}

/// Steering of an Ackermann robot: wheels turn about one point on the line through the axle that is not steered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axle {
    /// Shaft number whose position steers.
    pub shaft: usize,
    /// Angle of a wheel in the middle per unit of the shaft's position, rad/rad or rad/m.
    pub rad_per_unit: f64,
    /// Position of the shaft for straight wheels, rad or m.
    pub straight: f64,
    /// Position of the axle that is not steered, x in the body's frame, m.
    pub fixed_x_m: f64,
    /// Trail: distance behind the steering axis at which the tyre's lateral force acts, m. The actuator holds the
    /// resulting torque.
    pub trail_m: f64,
}

/// Reasons why a chassis cannot be simulated.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ChassisError {
    /// Mass or inertia is not positive, or the height is negative.
    #[error("`mass_kg` and `inertia_kg_m2` must be positive, `height_m` 0 or more")]
    Chassis,
    /// A wheel's radius is not positive, or its place not finite.
    #[error("wheel {wheel}: `radius_m` must be positive and `place_m` finite")]
    Wheel {
        /// Index of the wheel, from 0.
        wheel: usize,
    },
    /// Parameters of a wheel's tyre.
    #[error("wheel {wheel}: {source}")]
    Tyre {
        /// Index of the wheel, from 0.
        wheel: usize,
        /// Error of the tyre.
        source: TyreError,
    },
    /// A shaft that the body does not have.
    #[error("there is no shaft {shaft}: the body couples {shafts}")]
    Shaft {
        /// Shaft number that was given.
        shaft: usize,
        /// Number of shafts of the body.
        shafts: usize,
    },
    /// Wheels on one line, or fewer than three, do not carry a chassis.
    #[error("at least three wheels or casters must carry the chassis, and not all on one line")]
    Support,
    /// The centre of mass is not between the wheels.
    #[error("the centre of mass is not between the wheels: the robot would fall over")]
    FallsOver,
    /// A steered wheel without an axle, or an axle that cannot steer.
    #[error(
        "a steered wheel needs an axle with finite numbers, and must not stand on the line of the fixed axle, `fixed_x_m`"
    )]
    Axle,
}

/// A chassis on wheels with its state.
#[derive(Clone, Debug, PartialEq)]
pub struct Wheeled {
    chassis: Chassis,
    wheels: Vec<Wheel>,
    axle: Option<Axle>,
    shafts: usize,
    contacts: Vec<Contact>,
    /// Precomputed constants of each wheel's tyre; `None` for a caster.
    springs: Vec<Option<Springs>>,
    /// Normal force of each wheel, N; 0 in the air.
    normals_n: Vec<f64>,
    /// Normal force of each wheel for a weight of 1 N, and for moments of 1 N m that load front and left wheels.
    support: Vec<[f64; 3]>,
    /// Outline that collides with obstacles; `None` passes through them.
    outline: Option<Outline>,
    pose: Pose,
    twist: Twist,
    /// Acceleration of the centre of mass over the last step, body frame, m/s².
    acceleration_m_s2: [f64; 2],
    /// Component of that acceleration due to gravity along a slope.
    downhill_m_s2: [f64; 2],
    /// Yaw acceleration over the last step, rad/s².
    yaw_rad_s2: f64,
    /// Additional force for the next step, besides wheels and outline: body frame, N, and moment about the centre of
    /// mass, N m.
    pushed: [f64; 3],
}

impl Wheeled {
    /// A body at rest at the origin.
    ///
    /// # Errors
    /// [`ChassisError`] names the part whose parameters are out of range.
    pub fn new(chassis: Chassis, wheels: Vec<Wheel>, axle: Option<Axle>, shafts: usize) -> Result<Self, ChassisError> {
        let positive = |value: f64| value > 0.0 && value.is_finite();
        let finite = |place: [f64; 2]| place.into_iter().all(f64::is_finite);
        let Chassis { mass_kg, inertia_kg_m2, centre_m, height_m } = chassis;
        if ![mass_kg, inertia_kg_m2].into_iter().all(positive)
            || !finite(centre_m)
            || !(0.0..f64::INFINITY).contains(&height_m)
        {
            return Err(ChassisError::Chassis);
        }
        let shaft_exists =
            |shaft: usize| if shaft < shafts { Ok(()) } else { Err(ChassisError::Shaft { shaft, shafts }) };
        for (number, wheel) in wheels.iter().enumerate() {
            if !positive(wheel.radius_m) || !finite(wheel.place_m) {
                return Err(ChassisError::Wheel { wheel: number });
            }
            let tyre = wheel.tyre.map_or(Ok(()), |tyre| tyre.checked().map(drop));
            tyre.map_err(|source| ChassisError::Tyre { wheel: number, source })?;
            wheel.shaft.map_or(Ok(()), shaft_exists)?;
        }
        if let Some(axle) = axle {
            shaft_exists(axle.shaft)?;
        }
        let steers = |wheel: &Wheel| {
            axle.is_some_and(|Axle { rad_per_unit, straight, fixed_x_m, trail_m, .. }| {
                finite([rad_per_unit, straight]) && finite([fixed_x_m, trail_m]) && wheel.place_m[0] != fixed_x_m
            })
        };
        if !wheels.iter().filter(|wheel| wheel.steered).all(steers) {
            return Err(ChassisError::Axle);
        }
        let support = support(&wheels, chassis.centre_m).ok_or(ChassisError::Support)?;
        if support.iter().any(|[weight, ..]| *weight < 0.0) {
            return Err(ChassisError::FallsOver);
        }
        let mut body = Self {
            contacts: vec![Contact::default(); wheels.len()],
            springs: wheels.iter().map(|wheel| wheel.tyre.as_ref().map(Springs::from)).collect(),
            normals_n: vec![0.0; wheels.len()],
            chassis,
            wheels,
            axle,
            shafts,
            support,
            outline: None,
            pose: Pose::default(),
            twist: Twist::default(),
            acceleration_m_s2: [0.0; 2],
            downhill_m_s2: [0.0; 2],
            yaw_rad_s2: 0.0,
            pushed: [0.0; 3],
        };
        body.press();
        Ok(body)
    }

    /// Adds an outline, which collides with obstacles.
    #[must_use]
    pub fn with_outline(self, outline: Outline) -> Self {
        Self { outline: Some(outline), ..self }
    }

    /// The same body with changed parameters, at rest at the same pose.
    ///
    /// # Errors
    /// As [`Wheeled::new`].
    pub fn changed(&self, change: impl FnOnce(&mut Chassis, &mut [Wheel])) -> Result<Self, ChassisError> {
        let (mut chassis, mut wheels) = (self.chassis, self.wheels.clone());
        change(&mut chassis, &mut wheels);
        let mut body = Self::new(chassis, wheels, self.axle, self.shafts)?;
        body.outline.clone_from(&self.outline);
        body.set_pose(self.pose);
        Ok(body)
    }

    /// Mass, inertia and centre of mass.
    #[must_use]
    pub fn chassis(&self) -> &Chassis {
        &self.chassis
    }

    /// Steering of the body; `None` for a robot that steers by its wheels' speeds.
    #[must_use]
    pub fn axle(&self) -> Option<&Axle> {
        self.axle.as_ref()
    }

    /// Wheels of the body.
    #[must_use]
    pub fn wheels(&self) -> &[Wheel] {
        &self.wheels
    }

    /// Normal force of each wheel under the acceleration of the last step, N; 0 in the air.
    #[must_use]
    pub fn normals_n(&self) -> &[f64] {
        &self.normals_n
    }

    /// Adds a force at a point, body frame, N and m, for the next step.
    pub(crate) fn push(&mut self, [forward_n, left_n]: [f64; 2], at_m: [f64; 2]) {
        let arm_m = [at_m[0] - self.chassis.centre_m[0], at_m[1] - self.chassis.centre_m[1]];
        self.pushed[0] += forward_n;
        self.pushed[1] += left_n;
        self.pushed[2] += arm_m[0] * left_n - arm_m[1] * forward_n;
    }

    /// Outline of the body, for reshaping.
    pub(crate) fn outline_mut(&mut self) -> Option<&mut Outline> {
        self.outline.as_mut()
    }

    /// Updates the wheels' normal forces from weight and acceleration.
    fn press(&mut self) {
        let Chassis { mass_kg, height_m, .. } = self.chassis;
        let [forward_nm, left_nm] = self.acceleration_m_s2.map(|acceleration| -mass_kg * acceleration * height_m);
        for (normal_n, [weight, pitch, roll]) in self.normals_n.iter_mut().zip(&self.support) {
            *normal_n = (weight * mass_kg * GRAVITY_M_S2 + pitch * forward_nm + roll * left_nm).max(0.0);
        }
    }

    /// Force of slopes and obstacles in the body's frame, N, and its moment about the centre of mass, N m.
    fn outside(&mut self, scene: &mut Scene, time_s: f64, step_s: f64) -> [f64; 3] {
        self.downhill_m_s2 = [0.0; 2];
        let pushed = std::mem::take(&mut self.pushed);
        if scene.is_plain() && scene.is_empty() {
            return pushed;
        }
        let (sin, cos) = libm::sincos(self.pose.yaw_rad);
        let to_body = |[x, y]: [f64; 2]| [cos * x + sin * y, cos * y - sin * x];
        let slope = scene.floor(self.pose.to_world(self.chassis.centre_m)).slope;
        let weight_n = self.chassis.mass_kg * GRAVITY_M_S2;
        let [forward, left] = to_body(slope);
        self.downhill_m_s2 = [-GRAVITY_M_S2 * forward, -GRAVITY_M_S2 * left];
        let mut sum = [pushed[0] - weight_n * forward, pushed[1] - weight_n * left, pushed[2]];
        let twist = self.twist();
        let Some(outline) = &mut self.outline else { return sum };
        let velocity_m_s =
            [cos * twist.forward_m_s - sin * twist.left_m_s, sin * twist.forward_m_s + cos * twist.left_m_s];
        let moving =
            Moving { pose: self.pose, velocity_m_s, yaw_rad_s: twist.yaw_rad_s, mass_kg: self.chassis.mass_kg };
        let centre = self.pose.to_world(self.chassis.centre_m);
        outline.touch(scene, time_s, step_s, &moving, |push| {
            let [forward_n, left_n] = to_body(push.force_n);
            let [arm_x, arm_y] = to_body([push.at_m[0] - centre[0], push.at_m[1] - centre[1]]);
            sum = [sum[0] + forward_n, sum[1] + left_n, sum[2] + arm_x * left_n - arm_y * forward_n];
        });
        sum
    }

    /// Steering angle of a wheel, rad, and its derivative by the shaft's position.
    fn steered(&self, wheel: &Wheel, shafts: &[ShaftMotion]) -> (f64, f64) {
        let Some(axle) = self.axle.filter(|_| wheel.steered) else { return (0.0, 0.0) };
        let position = shafts.get(axle.shaft).map_or(0.0, |shaft| shaft.position);
        let middle = (position - axle.straight) * axle.rad_per_unit;
        // Ackermann geometry: all wheels turn about the point given by the steering angle in the middle of the axle
        let (tan, wheelbase_m) = (libm::tan(middle), wheel.place_m[0] - axle.fixed_x_m);
        (libm::atan(wheelbase_m * tan / (wheelbase_m - wheel.place_m[1] * tan)), axle.rad_per_unit)
    }
}

impl Body for Wheeled {
    fn shafts(&self) -> usize {
        self.shafts
    }

    fn step(&mut self, scene: &mut Scene, time_s: f64, shafts: &[ShaftMotion], loads: &mut [f64], step_s: f64) {
        loads.fill(0.0);
        let [mut forward_n, mut left_n, mut yaw_nm] = self.outside(scene, time_s, step_s);
        for (number, wheel) in self.wheels.iter().enumerate() {
            let (Some(tyre), Some(springs)) = (&wheel.tyre, &self.springs[number]) else { continue };
            let (angle, per_unit) = self.steered(wheel, shafts);
            let (sin, cos) = if wheel.steered { libm::sincos(angle) } else { (0.0, 1.0) };
            let arm_m = [wheel.place_m[0] - self.chassis.centre_m[0], wheel.place_m[1] - self.chassis.centre_m[1]];
            let [forward, left] = self.twist.at(arm_m);
            let (along, across) = (cos * forward + sin * left, cos * left - sin * forward);
            let way = if wheel.inverted { -1.0 } else { 1.0 };
            let driven = wheel.shaft.and_then(|shaft| shafts.get(shaft));
            // a freely rolling wheel turns with the ground
            let rim_m_s = driven.map_or(along, |shaft| way * shaft.speed * wheel.radius_m);
            let slip = [along - rim_m_s, across];
            let floor = if scene.is_plain() { None } else { scene.floor(self.pose.to_world(wheel.place_m)).friction };
            let friction = floor.unwrap_or(tyre.friction);
            let [long_n, lat_n] =
                self.contacts[number].step(springs, friction, slip, rim_m_s, self.normals_n[number], step_s);
            if let Some(load) = wheel.shaft.and_then(|shaft| loads.get_mut(shaft)) {
                *load -= way * long_n * wheel.radius_m;
            }
            if let Some(axle) = self.axle.filter(|_| wheel.steered)
                && let Some(load) = loads.get_mut(axle.shaft)
            {
                *load -= lat_n * axle.trail_m * per_unit;
            }
            let (wheel_forward_n, wheel_left_n) = (cos * long_n - sin * lat_n, cos * lat_n + sin * long_n);
            forward_n += wheel_forward_n;
            left_n += wheel_left_n;
            yaw_nm += arm_m[0] * wheel_left_n - arm_m[1] * wheel_forward_n;
        }
        let Chassis { mass_kg, inertia_kg_m2, .. } = self.chassis;
        self.acceleration_m_s2 = [forward_n / mass_kg, left_n / mass_kg];
        self.yaw_rad_s2 = yaw_nm / inertia_kg_m2;
        self.press();
        let before = self.twist();
        let Twist { forward_m_s, left_m_s, yaw_rad_s } = self.twist;
        self.twist = Twist {
            forward_m_s: forward_m_s + (self.acceleration_m_s2[0] + yaw_rad_s * left_m_s) * step_s,
            left_m_s: left_m_s + (self.acceleration_m_s2[1] - yaw_rad_s * forward_m_s) * step_s,
            yaw_rad_s: yaw_rad_s + self.yaw_rad_s2 * step_s,
        };
        // Mean velocity of the step: with that of its end alone a robot that accelerates to 0.47 m/s is 0.12 mm ahead
        // of its wheels, compared with 3 mm of slip of soft tyres.
        self.pose = self.pose.moved(before.mean(self.twist()), step_s);
        scene.step_boxes(step_s);
    }

    fn pose(&self) -> Pose {
        self.pose
    }

    fn set_pose(&mut self, pose: Pose) {
        if let Some(outline) = &mut self.outline {
            outline.moved();
        }
        self.pose = pose;
        self.twist = Twist::default();
        (self.acceleration_m_s2, self.downhill_m_s2, self.yaw_rad_s2) = ([0.0; 2], [0.0; 2], 0.0);
        self.contacts.fill(Contact::default());
    }

    fn twist(&self) -> Twist {
        // the state is the velocity of the centre of mass
        let [x_m, y_m] = self.chassis.centre_m;
        let [forward_m_s, left_m_s] = self.twist.at([-x_m, -y_m]);
        Twist { forward_m_s, left_m_s, ..self.twist }
    }

    fn inertial(&self) -> Inertial {
        let [forward_m_s2, left_m_s2] = self.acceleration_m_s2;
        let [x_m, y_m] = self.chassis.centre_m;
        let centre = Inertial {
            specific_force_m_s2: [
                forward_m_s2 - self.downhill_m_s2[0],
                left_m_s2 - self.downhill_m_s2[1],
                // the robot neither rises nor tilts: on a slope the sum exceeds gravity by the square, 0.5 % at 10 %
                GRAVITY_M_S2,
            ],
            rate_rad_s: [0.0, 0.0, self.twist.yaw_rad_s],
            angular_acceleration_rad_s2: [0.0, 0.0, self.yaw_rad_s2],
        };
        centre.at([-x_m, -y_m, 0.0])
    }

    fn outline(&self) -> Option<&Outline> {
        self.outline.as_ref()
    }
}

/// Normal forces of wheels, stiff springs of equal rate under a stiff chassis, by weight and moments:
/// `N = a + b x + c y` with the sums that balance. `None` if that has no solution.
fn support(wheels: &[Wheel], centre_m: [f64; 2]) -> Option<Vec<[f64; 3]>> {
    let arms = wheels.iter().map(|wheel| [wheel.place_m[0] - centre_m[0], wheel.place_m[1] - centre_m[1]]);
    let arms: Vec<_> = arms.collect();
    let sum = |term: &dyn Fn(&[f64; 2]) -> f64| arms.iter().map(term).sum::<f64>();
    let (count, x, y) = (arms.len() as f64, sum(&|arm| arm[0]), sum(&|arm| arm[1]));
    let (xx, xy, yy) = (sum(&|arm| arm[0] * arm[0]), sum(&|arm| arm[0] * arm[1]), sum(&|arm| arm[1] * arm[1]));
    let matrix = [[count, x, y], [x, xx, xy], [y, xy, yy]];
    let columns = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]].map(|right| solved(matrix, right));
    let [Some(weight), Some(pitch), Some(roll)] = columns else { return None };
    let force = |plane: [f64; 3], arm: &[f64; 2]| plane[0] + plane[1] * arm[0] + plane[2] * arm[1];
    Some(arms.iter().map(|arm| [force(weight, arm), force(pitch, arm), force(roll, arm)]).collect())
}

/// Solves a linear system by Cramer's rule; `None` for wheels on one line, to rounding.
fn solved(matrix: [[f64; 3]; 3], right: [f64; 3]) -> Option<[f64; 3]> {
    let determinant = |m: [[f64; 3]; 3]| {
        m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
            + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
    };
    let whole = determinant(matrix);
    let scale = matrix[0][0] * matrix[1][1] * matrix[2][2];
    let flat = whole.abs() <= 1e-12 * scale;
    let column = |index: usize| {
        let mut replaced = matrix;
        for (row, value) in replaced.iter_mut().zip(right) {
            row[index] = value;
        }
        determinant(replaced) / whole
    };
    (!flat).then(|| [column(0), column(1), column(2)])
}

#[cfg(test)]
mod mujoco;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{MAX_STEP_S, tyre::SlipLaw};

    const HALF_BASE_M: f64 = 0.2;
    const HALF_TRACK_M: f64 = 0.3;
    const RADIUS_M: f64 = 0.1;
    const TYRE: Tyre =
        Tyre { compliance_per_n: [0.002, 0.01], friction: 0.8, relaxation_m: 0.05, law: SlipLaw::Linear };
    const CHASSIS: Chassis = Chassis { mass_kg: 30.0, inertia_kg_m2: 2.0, centre_m: [0.0; 2], height_m: 0.0 };

    /// Wheels front left, front right, rear left, rear right, each on a shaft of its own.
    fn wheels(tyre: Tyre) -> Vec<Wheel> {
        let places = [(1.0, 1.0), (1.0, -1.0), (-1.0, 1.0), (-1.0, -1.0)];
        let wheel = |(shaft, (x, y)): (usize, (f64, f64))| Wheel {
            place_m: [x * HALF_BASE_M, y * HALF_TRACK_M],
            radius_m: RADIUS_M,
            shaft: Some(shaft),
            inverted: false,
            steered: false,
            tyre: Some(tyre),
        };
        places.into_iter().enumerate().map(wheel).collect()
    }

    /// Runs the shafts at constant speeds for `duration_s`, whatever their loads; returns the loads of the last step.
    fn run(body: &mut Wheeled, speeds: &[f64], duration_s: f64) -> Vec<f64> {
        let shafts: Vec<_> = speeds.iter().map(|speed| ShaftMotion { position: 0.0, speed: *speed }).collect();
        let mut loads = vec![0.0; speeds.len()];
        for _ in 0..(duration_s / MAX_STEP_S).round() as usize {
            body.step(&mut Scene::default(), 0.0, &shafts, &mut loads, MAX_STEP_S);
        }
        loads
    }

    /// Balance `b F_long = l F_lat` with the linear law: `w / w_t = r b² / (l² + r b²)`, `r = c_lat / c_long` (Trimble,
    /// Fox 2023, the ratio of the two tests, solved for the rate).
    #[test]
    fn a_spin_turns_as_the_ratio_of_the_compliances_says() {
        for ratio in [1.0, 5.0, 10.0] {
            let tyre = Tyre { compliance_per_n: [0.002, 0.002 * ratio], friction: 10.0, ..TYRE };
            let mut body = Wheeled::new(CHASSIS, wheels(tyre), None, 4).unwrap();
            let rim_m_s = 0.3;
            let speed = rim_m_s / RADIUS_M;
            run(&mut body, &[-speed, speed, -speed, speed], 20.0);
            let (l2, b2) = (HALF_BASE_M * HALF_BASE_M, HALF_TRACK_M * HALF_TRACK_M);
            let expected = rim_m_s / HALF_TRACK_M * ratio * b2 / (l2 + ratio * b2);
            let Twist { forward_m_s, left_m_s, yaw_rad_s } = body.twist();
            // settled to rounding: an equilibrium, independent of the step length
            assert!((yaw_rad_s / expected - 1.0).abs() < 1e-9, "{yaw_rad_s}, {expected}");
            assert!(forward_m_s.abs() < 1e-9 && left_m_s.abs() < 1e-9);
        }
    }

    /// Braking distance `v² / 2 mu g`; the load transfer to the front wheels keeps the sum.
    #[test]
    fn locked_wheels_brake_within_the_distance_of_friction() {
        for (height_m, law) in [(0.0, SlipLaw::Linear), (0.15, SlipLaw::Brush)] {
            let mut body =
                Wheeled::new(Chassis { height_m, ..CHASSIS }, wheels(Tyre { law, ..TYRE }), None, 4).unwrap();
            let speed = 2.0 / RADIUS_M;
            run(&mut body, &[speed; 4], 10.0);
            let before = body.pose().x_m;
            assert!((body.twist().forward_m_s - 2.0).abs() < 1e-6);
            let mut farthest_m = 0.0_f64;
            for _ in 0..3000 {
                run(&mut body, &[0.0; 4], 1e-3);
                farthest_m = farthest_m.max(body.pose().x_m - before);
            }
            let expected_m = 2.0 * 2.0 / (2.0 * 0.8 * GRAVITY_M_S2);
            // Not shorter, except for a step at 2 m/s; longer while bristles bend, by less than half of the mu N c L at
            // which those of the linear law slide, 2.9 mm, or a quarter of three times that.
            assert!((-5e-4..5e-3).contains(&(farthest_m - expected_m)), "{farthest_m}, {expected_m}");
            assert!(body.twist().forward_m_s.abs() < 1e-3, "it stands");
        }
    }

    /// Force balance: the ground's force on the chassis equals the load of the shafts.
    #[test]
    fn shafts_carry_the_force_that_drives() {
        let mut body = Wheeled::new(CHASSIS, wheels(TYRE), None, 4).unwrap();
        let loads = run(&mut body, &[5.0; 4], 0.05);
        let [forward, ..] = body.inertial().specific_force_m_s2;
        assert!(forward > 0.1);
        let force_n = -loads.iter().sum::<f64>() / RADIUS_M;
        assert!((force_n - 30.0 * forward).abs() < 1e-9 * force_n, "{force_n}");
        // an inverted wheel turns the opposite way for the same force
        let mut inverted = wheels(TYRE);
        inverted.iter_mut().for_each(|wheel| wheel.inverted = true);
        let mut body = Wheeled::new(CHASSIS, inverted, None, 4).unwrap();
        let mirrored = run(&mut body, &[-5.0; 4], 0.05);
        assert!(mirrored.iter().zip(&loads).all(|(one, other)| *one == -other));
    }

    /// Two thirds of the weight are on the axle that is twice as near; an acceleration `a` moves `m a h / 2 l` to the
    /// rear.
    #[test]
    fn weight_and_acceleration_are_shared_by_leverage() {
        let chassis = Chassis { centre_m: [HALF_BASE_M / 3.0, 0.0], height_m: 0.2, ..CHASSIS };
        let mut body = Wheeled::new(chassis, wheels(TYRE), None, 4).unwrap();
        let weight_n = 30.0 * GRAVITY_M_S2;
        let expected = [1.0 / 3.0, 1.0 / 3.0, 1.0 / 6.0, 1.0 / 6.0].map(|share| share * weight_n);
        assert!(body.normals_n().iter().zip(expected).all(|(got, expected)| (got - expected).abs() < 1e-9));
        run(&mut body, &[5.0; 4], 0.01);
        let [forward, ..] = body.inertial().specific_force_m_s2;
        let moved_n = 30.0 * forward * 0.2 / (2.0 * HALF_BASE_M);
        for (got, expected) in body
            .normals_n()
            .iter()
            .zip(expected)
            .zip([-0.5, -0.5, 0.5, 0.5])
            .map(|((got, still), share)| (got, still + share * moved_n))
        {
            assert!((got - expected).abs() < 1e-9, "{got}, {expected}");
        }
    }

    /// At low speed, with tyres far from friction, the middle of the rear axle has a turning radius of
    /// `wheelbase / tan(steer)`.
    #[test]
    fn an_ackermann_robot_turns_about_the_line_of_its_rear_axle() {
        let mut wheels = wheels(Tyre { compliance_per_n: [1e-4; 2], ..TYRE });
        wheels.iter_mut().for_each(|wheel| {
            wheel.steered = wheel.place_m[0] > 0.0;
            wheel.shaft = None;
        });
        // the other rear wheel rolls freely: two of one speed would resist the turn
        wheels[2].shaft = Some(0);
        let axle = Axle { shaft: 1, rad_per_unit: 4.0, straight: 0.05, fixed_x_m: -HALF_BASE_M, trail_m: 0.01 };
        let mut body = Wheeled::new(CHASSIS, wheels, Some(axle), 2).unwrap();
        let steer_rad = 0.2_f64;
        let shafts =
            [ShaftMotion { position: 0.0, speed: 2.0 }, ShaftMotion { position: 0.05 + steer_rad / 4.0, speed: 0.0 }];
        let mut loads = [0.0; 2];
        (0..40_000).for_each(|_| body.step(&mut Scene::default(), 0.0, &shafts, &mut loads, MAX_STEP_S));
        let twist = body.twist();
        let radius_m = twist.at([-HALF_BASE_M, 0.0])[0] / twist.yaw_rad_s;
        let expected_m = 2.0 * HALF_BASE_M / steer_rad.tan();
        // slip angles of the forces that turn the robot: `m v² c_lat / wheelbase` of it, 3e-4
        assert!((radius_m / expected_m - 1.0).abs() < 1e-3, "{radius_m} m, {expected_m} m");
        assert!(loads[1].abs() > 0.0, "the actuator holds the wheels");
    }

    /// A body with freely rolling wheels, which only the scene moves.
    fn rolling() -> Wheeled {
        let mut wheels = wheels(TYRE);
        wheels.iter_mut().for_each(|wheel| wheel.shaft = None);
        let corners_m = vec![[0.3, -0.2], [0.3, 0.2], [-0.3, 0.2], [-0.3, -0.2]];
        Wheeled::new(CHASSIS, wheels, None, 0).unwrap().with_outline(Outline::new(corners_m).unwrap())
    }

    #[test]
    fn a_body_that_rolls_into_a_wall_comes_back_slower() {
        for (yaw_rad, speed_m_s) in [(0.0, 2.0), (0.6, 1.0), (-0.2, 0.3)] {
            let mut scene = Scene::default();
            scene.add_walls(&[[1.0, -5.0], [1.0, 5.0]], false).unwrap();
            let mut body = rolling();
            body.set_pose(Pose { yaw_rad, ..Pose::default() });
            body.twist = Twist { forward_m_s: speed_m_s, ..Twist::default() };
            let energy = |twist: Twist| {
                let squared = twist.forward_m_s * twist.forward_m_s + twist.left_m_s * twist.left_m_s;
                CHASSIS.mass_kg * squared + CHASSIS.inertia_kg_m2 * twist.yaw_rad_s * twist.yaw_rad_s
            };
            let (mut deepest_m, before) = (f64::NEG_INFINITY, energy(body.twist));
            for step in 0..16_000 {
                body.step(&mut scene, f64::from(step) * MAX_STEP_S, &[], &mut [], MAX_STEP_S);
                let corners = body.outline().unwrap().corners_m().iter();
                deepest_m = corners.map(|corner| body.pose().to_world(*corner)[0] - 1.0).fold(deepest_m, f64::max);
            }
            // contact is made, and the bumper of 20 mm keeps it off the wall
            assert!((-0.02..0.0).contains(&deepest_m), "{deepest_m} m");
            assert!(energy(body.twist) < 0.5 * before && body.pose().x_m < 0.7, "{:?}", body.twist);
        }
    }

    #[test]
    fn a_slope_pulls_downhill() {
        let mut scene = Scene::default();
        let corners_m = vec![[-9.0, -9.0], [9.0, -9.0], [9.0, 9.0], [-9.0, 9.0]];
        scene.add_surface(crate::Surface { corners_m, friction: None, slope: [0.0, 0.1] }).unwrap();
        let mut body = rolling();
        body.set_pose(Pose { yaw_rad: std::f64::consts::FRAC_PI_2, ..Pose::default() });
        (0..4000).for_each(|_| body.step(&mut scene, 0.0, &[], &mut [], MAX_STEP_S));
        let forward_m_s = body.twist().forward_m_s;
        assert!((forward_m_s + 0.1 * GRAVITY_M_S2).abs() < 1e-9, "{forward_m_s} m/s after a second");
        // locked wheels hold it, by the springs of their bristles, 1 / (c L) each
        let mut held = Wheeled::new(CHASSIS, wheels(TYRE), None, 4).unwrap();
        (0..40_000).for_each(|_| held.step(&mut scene, 0.0, &[ShaftMotion::default(); 4], &mut [0.0; 4], MAX_STEP_S));
        let bent_m = 0.1 * GRAVITY_M_S2 * CHASSIS.mass_kg * TYRE.compliance_per_n[1] * TYRE.relaxation_m / 4.0;
        assert!((held.pose().y_m + bent_m).abs() < 1e-6, "{:?}, {bent_m}", held.pose());
    }

    /// Friction of the floor replaces the tyre's.
    #[test]
    fn locked_wheels_slide_farther_on_ice() {
        let mut scene = Scene::default();
        let corners_m = vec![[-99.0, -9.0], [99.0, -9.0], [99.0, 9.0], [-99.0, 9.0]];
        scene.add_surface(crate::Surface { corners_m, friction: Some(0.1), slope: [0.0; 2] }).unwrap();
        let mut body = Wheeled::new(CHASSIS, wheels(TYRE), None, 4).unwrap();
        body.twist.forward_m_s = 1.0;
        (0..8000).for_each(|_| body.step(&mut scene, 0.0, &[ShaftMotion::default(); 4], &mut [0.0; 4], MAX_STEP_S));
        let expected_m = 1.0 / (2.0 * 0.1 * GRAVITY_M_S2);
        // bristles bend by 3 mu N c L = 3.6 mm at first, as in the braking distance above
        assert!((body.pose().x_m - expected_m).abs() < 4e-3, "{} m, {expected_m} m", body.pose().x_m);
    }

    #[test]
    fn what_cannot_be_computed_is_named() {
        let new = |chassis, wheels| Wheeled::new(chassis, wheels, None, 4).map(drop);
        assert_eq!(new(CHASSIS, wheels(TYRE)), Ok(()));
        assert_eq!(new(Chassis { mass_kg: 0.0, ..CHASSIS }, wheels(TYRE)), Err(ChassisError::Chassis));
        assert_eq!(new(Chassis { centre_m: [0.9, 0.0], ..CHASSIS }, wheels(TYRE)), Err(ChassisError::FallsOver));
        assert_eq!(new(CHASSIS, wheels(TYRE)[..2].to_vec()), Err(ChassisError::Support));
        let one = |change: fn(&mut Wheel)| {
            let mut wheels = wheels(TYRE);
            change(&mut wheels[2]);
            new(CHASSIS, wheels)
        };
        assert_eq!(one(|wheel| wheel.radius_m = 0.0), Err(ChassisError::Wheel { wheel: 2 }));
        assert_eq!(one(|wheel| wheel.shaft = Some(4)), Err(ChassisError::Shaft { shaft: 4, shafts: 4 }));
        assert_eq!(one(|wheel| wheel.steered = true), Err(ChassisError::Axle));
        assert_eq!(
            one(|wheel| wheel.tyre = Some(Tyre { friction: -1.0, ..TYRE })),
            Err(ChassisError::Tyre { wheel: 2, source: TyreError::Friction })
        );
    }
}
