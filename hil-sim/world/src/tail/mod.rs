//! A standing person with a tail of two links on the back, which motors move by cables.
//!
//! Everything moves in the sagittal plane. The person is an inverted pendulum on an ankle with stiffness, damping and a
//! torque limit; the tail's links hang from a point on the back. Angles turn about the y axis from z to x: forwards for
//! the person, backwards and up for a link that hangs. At angles of 0 the person is upright and the links hang straight
//! down.
//!
//! ```text
//! M(q) q'' + C(q, q') q' + G(q) = [ankle, cable 1, cable 2]      q = [trunk, joint 1, joint 2]
//! cable = k (motor / N - q) + d (motor' / N - q')                load of a shaft = -cable / N
//! ```
//!
//! A joint's angle is that of its link relative to the part before it. Each joint's motor winds a cable that runs
//! `wraps` half turns over pulleys; each transmits `1 - loss` of the force in the direction of motion, so a motor that
//! lifts gives the joint `(1 - loss)^wraps` of the cable's torque, and one that lowers carries as much less of it. A
//! motor's inertia belongs to its shaft's plant; its mass belongs to the link that carries it.
//!
//! # Source
//! Dimensions and masses of the tail: "Prototyping Mechanical Design of a Robotic Tail for Human Balance Support",
//! TAROS 2023. Equations of motion: d'Alembert's principle on points of rotating parts, checked against Pinocchio and
//! MuJoCo (`tests/oracle`).
//!
//! # Accuracy
//! Fourth order (Runge-Kutta) for given motions of the shafts; the cable's torque on a shaft is held over a step, and
//! computed half a step ahead, which neither adds nor removes energy: second order. [`BalanceTail::new`] rejects cables
//! too stiff for [`crate::MAX_STEP_S`] at the joint; at the motor `dt < 2 N sqrt(J / k)` must hold for its inertia `J`,
//! which only its plant knows.
//!
//! Not modelled: steps and falls of the person (a trunk that lies down stays there), end stops of the joints, slack
//! cables, and the reaction of a motor's own acceleration on its link, `1 / N` of its torque on the joint.

#[cfg(test)]
mod tests;

use crate::{
    GRAVITY_M_S2, MAX_STEP_S,
    body::{Body, Inertial, Pose, ShaftMotion, Twist},
    scene::Scene,
};

/// Speed of a joint at which its dry friction reaches 76 %, rad/s: 0.3 % of a typical swing of the tail. Half of it
/// halves the creep of a joint that friction holds, and halves the step at the limit of stability.
const SLIDE_RAD_S: f64 = 0.02;
/// Lean at which the trunk counts as lying on the ground, rad.
const LIES_RAD: f64 = std::f64::consts::FRAC_PI_2;

/// Person who wears the tail. Places are `[forwards, up]` from the ankle along the trunk, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wearer {
    /// Mass without tail and load, kg.
    pub mass_kg: f64,
    /// Height of the centre of mass above the ankle, m.
    pub centre_m: f64,
    /// Moment of inertia about the ankle, kg m².
    pub inertia_kg_m2: f64,
    /// Place of the tail's first joint.
    pub tail_m: [f64; 2],
    /// Balance of the person at the ankle.
    pub ankle: Ankle,
}

/// Balance of the person: a spring about the posture that holds everything upright at the start, and a damper.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ankle {
    /// Stiffness, N m/rad; the person stands only if it exceeds weight times height of the centre of mass.
    pub stiffness_nm_per_rad: f64,
    /// Damping of the ankle, N m s/rad.
    pub damping_nm_s_per_rad: f64,
    /// Largest torque of the foot in either direction, N m; may be infinite.
    pub torque_max_nm: f64,
}

/// A link of the tail with the cable that moves it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Link {
    /// Length from its joint to the next, m.
    pub length_m: f64,
    /// Mass of everything on the link, kg.
    pub mass_kg: f64,
    /// Distance of its centre of mass from its joint, m.
    pub centre_m: f64,
    /// Moment of inertia about its centre of mass, kg m².
    pub inertia_kg_m2: f64,
    /// Cable that moves the joint.
    pub cable: Cable,
}

/// Cable from a motor's shaft to a joint.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cable {
    /// Shaft number of its motor.
    pub shaft: usize,
    /// Turns of the shaft per turn of the joint; negative for opposite directions.
    pub ratio: f64,
    /// Stiffness seen at the joint, N m/rad.
    pub stiffness_nm_per_rad: f64,
    /// Damping seen at the joint, N m s/rad.
    pub damping_nm_s_per_rad: f64,
    /// Half turns of the cable over pulleys.
    pub wraps: f64,
    /// Share of the force lost at each half turn, 0 to below 1.
    pub loss_per_wrap: f64,
    /// Dry friction of the joint's bearings, N m.
    pub friction_nm: f64,
}

/// A load that the person lifts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lift {
    /// Time at which the hands start to take its weight, s.
    pub at_s: f64,
    /// Duration of a linear increase to the whole weight, s.
    pub over_s: f64,
    /// Mass of the load, kg.
    pub mass_kg: f64,
    /// Place of the hands: `[forwards, up]` from the ankle along the trunk, m.
    pub place_m: [f64; 2],
}

/// Reasons why a tail cannot be simulated.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum TailError {
    /// Parameters of the person.
    #[error("mass and height must be positive, the inertia about the ankle at least mass times height squared")]
    Wearer,
    /// Parameters of the ankle, or a person who cannot stand.
    #[error(
        "the ankle needs {needed_nm:.1} N m to hold the person upright with the tail at rest; raise `torque_max_nm`"
    )]
    Ankle {
        /// Torque needed to stand upright, N m.
        needed_nm: f64,
    },
    /// Parameters of a link.
    #[error("link {link}: length, mass and inertia must be positive, its centre of mass not before its joint")]
    Link {
        /// Index of the link, from 0.
        link: usize,
    },
    /// Parameters of a cable.
    #[error(
        "link {link}: the cable needs a ratio other than 0, a loss from 0 to below 1, nothing negative, and shaft 0 or 1"
    )]
    Cable {
        /// Index of the link, from 0.
        link: usize,
    },
    /// A cable that needs shorter steps.
    #[error(
        "link {link}: the cable is too stiff for steps of {MAX_STEP_S} s; at most {most:.3e} N m/rad, or N m s/rad of damping"
    )]
    Stiff {
        /// Index of the link, from 0.
        link: usize,
        /// Largest stable stiffness, N m/rad, or damping, N m s/rad.
        most: f64,
    },
    /// Parameters of the lift.
    #[error("a lift needs a mass and times of 0 or more, and a finite place")]
    Lift,
}

/// Angles and rates of trunk and joints, rad and rad/s.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TailState {
    /// Angles of the trunk from upright, joint 1 from the trunk, joint 2 from link 1.
    pub angle_rad: [f64; 3],
    /// Rates of the same angles.
    pub rate_rad_s: [f64; 3],
}

/// A person with a tail, with its state.
#[derive(Clone, Debug, PartialEq)]
pub struct BalanceTail {
    wearer: Wearer,
    links: [Link; 2],
    lift: Option<Lift>,
    /// Joint angles at which the cables are without force with the shafts at 0, rad.
    slack_rad: [f64; 2],
    /// Lean at which the ankle's spring is without force, rad.
    posture_rad: f64,
    start: TailState,
    state: TailState,
    acceleration_rad_s2: [f64; 3],
    /// Mass in the hands, kg.
    carried_kg: f64,
    cables_nm: [f64; 2],
    pose: Pose,
}

/// Part of a point's place that rotates with one angle: `[forwards, up]` in that angle's frame, m.
type Arm = [f64; 2];

/// A mass of the chain: kg, inertia about its centre in kg m², the index of its angle, and its place as a sum of arms.
type Part = (f64, f64, usize, [Arm; 3]);

/// An arm rotated to the world, `[x, z]`.
fn turned([forward, up]: Arm, [sin, cos]: [f64; 2]) -> [f64; 2] {
    [forward * cos + up * sin, up * cos - forward * sin]
}

/// Equations of motion in absolute angles: `mass · acceleration = force`, including gravity and the centrifugal terms.
struct Motion {
    mass: [[f64; 3]; 3],
    force: [f64; 3],
    /// Potential energy of the masses, relative to the ankle's height, J.
    potential_j: f64,
}

impl BalanceTail {
    /// A person upright and at rest at the origin, with the joints at `rest_rad` while their shafts are at 0.
    ///
    /// # Errors
    /// [`TailError`] names the part whose parameters are out of range.
    pub fn new(wearer: Wearer, links: [Link; 2], rest_rad: [f64; 2], lift: Option<Lift>) -> Result<Self, TailError> {
        let positive = |value: f64| value > 0.0 && value.is_finite();
        let not_negative = |value: f64| value >= 0.0 && value.is_finite();
        let Wearer { mass_kg, centre_m, inertia_kg_m2, tail_m, .. } = wearer;
        let stands = [mass_kg, centre_m, inertia_kg_m2].into_iter().all(positive);
        // to rounding: a point mass has no inertia of its own
        if !stands
            || inertia_kg_m2 < mass_kg * centre_m * centre_m * (1.0 - 1e-9)
            || !tail_m.iter().all(|m| m.is_finite())
        {
            return Err(TailError::Wearer);
        }
        for (number, Link { length_m, mass_kg, centre_m, inertia_kg_m2, cable }) in links.into_iter().enumerate() {
            if ![length_m, mass_kg, inertia_kg_m2].into_iter().all(positive)
                || !not_negative(centre_m)
                || !rest_rad[number].is_finite()
            {
                return Err(TailError::Link { link: number });
            }
            let Cable { shaft, ratio, stiffness_nm_per_rad, damping_nm_s_per_rad, wraps, loss_per_wrap, friction_nm } =
                cable;
            let sizes = [stiffness_nm_per_rad, damping_nm_s_per_rad, wraps, friction_nm];
            if shaft > 1
                || !positive(ratio.abs())
                || !sizes.into_iter().all(not_negative)
                || !(0.0..1.0).contains(&loss_per_wrap)
            {
                return Err(TailError::Cable { link: number });
            }
        }
        if let Some(Lift { at_s, over_s, mass_kg, place_m }) = lift
            && !([at_s, over_s, mass_kg].into_iter().all(not_negative) && place_m.iter().all(|m| m.is_finite()))
        {
            return Err(TailError::Lift);
        }
        let start = TailState { angle_rad: [0.0, rest_rad[0], rest_rad[1]], rate_rad_s: [0.0; 3] };
        let mut body = Self {
            wearer,
            links,
            lift,
            slack_rad: rest_rad,
            posture_rad: 0.0,
            start,
            state: start,
            acceleration_rad_s2: [0.0; 3],
            carried_kg: 0.0,
            cables_nm: [0.0; 2],
            pose: Pose::default(),
        };
        body.balance()?;
        for (number, link) in links.iter().enumerate() {
            let mut torque = [0.0; 3];
            torque[number + 1] = 1.0;
            let per_nm =
                body.accelerations(&start, torque)[number + 1] - body.accelerations(&start, [0.0; 3])[number + 1];
            // limit at which Runge-Kutta's error of a spring's phase in a step reaches 1 %
            let most = 1.0 / (per_nm * MAX_STEP_S * MAX_STEP_S);
            if link.cable.stiffness_nm_per_rad > most {
                return Err(TailError::Stiff { link: number, most });
            }
            let most = 1.0 / (per_nm * MAX_STEP_S);
            if link.cable.damping_nm_s_per_rad > most {
                return Err(TailError::Stiff { link: number, most });
            }
        }
        Ok(body)
    }

    /// Finds the posture and the cables' lengths that hold the body at its start.
    fn balance(&mut self) -> Result<(), TailError> {
        let [trunk_nm, first_nm, second_nm] = self.motion(&self.start).force;
        // from absolute angles: each joint carries everything beyond it
        let holds_nm = [-(trunk_nm + first_nm + second_nm), -(first_nm + second_nm), -second_nm];
        let Ankle { stiffness_nm_per_rad, damping_nm_s_per_rad, torque_max_nm } = self.wearer.ankle;
        let sound = stiffness_nm_per_rad >= 0.0 && damping_nm_s_per_rad >= 0.0 && holds_nm[0].abs() <= torque_max_nm;
        if !sound || stiffness_nm_per_rad == 0.0 && holds_nm[0].abs() > 1e-9 {
            return Err(TailError::Ankle { needed_nm: holds_nm[0].abs() });
        }
        let spring = |torque_nm: f64, stiffness: f64| if stiffness > 0.0 { torque_nm / stiffness } else { 0.0 };
        self.posture_rad = spring(holds_nm[0], stiffness_nm_per_rad);
        for (number, slack_rad) in self.slack_rad.iter_mut().enumerate() {
            *slack_rad += spring(holds_nm[number + 1], self.links[number].cable.stiffness_nm_per_rad);
        }
        Ok(())
    }

    /// Parameters of the person.
    #[must_use]
    pub const fn wearer(&self) -> &Wearer {
        &self.wearer
    }

    /// Links of the tail, from the back outwards.
    #[must_use]
    pub const fn links(&self) -> &[Link; 2] {
        &self.links
    }

    /// Sets the load that the person lifts; `None` for nothing.
    pub fn set_lift(&mut self, lift: Option<Lift>) {
        self.lift = lift;
    }

    /// Present angles and rates.
    #[must_use]
    pub const fn state(&self) -> &TailState {
        &self.state
    }

    /// Present torque of each cable at its joint, before pulley losses, N m.
    #[must_use]
    pub const fn cables_nm(&self) -> [f64; 2] {
        self.cables_nm
    }

    /// Present torque of the ankle, N m, positive forwards.
    #[must_use]
    pub fn ankle_nm(&self) -> f64 {
        self.ankle(&self.state)
    }

    /// Horizontal distance of the person's own centre of mass in front of the ankle, m.
    #[must_use]
    pub fn wearer_x_m(&self) -> f64 {
        self.wearer.centre_m * libm::sin(self.state.angle_rad[0])
    }

    /// Horizontal distance of the tail's centre of mass in front of its joint on the back, m.
    #[must_use]
    pub fn tail_x_m(&self) -> f64 {
        let [trunk, first, second] = self.state.angle_rad;
        let [first, second] = [trunk + first, trunk + first + second].map(|angle| -libm::sin(angle));
        let [inner, outer] = &self.links;
        let sum = (inner.mass_kg * inner.centre_m + outer.mass_kg * inner.length_m) * first
            + outer.mass_kg * outer.centre_m * second;
        sum / (inner.mass_kg + outer.mass_kg)
    }

    /// Masses of the chain, including the load.
    fn parts(&self) -> [Part; 4] {
        let Wearer { mass_kg, centre_m, inertia_kg_m2, tail_m, .. } = self.wearer;
        let [inner, outer] = &self.links;
        let none = [0.0; 2];
        let hangs = |length_m: f64| [0.0, -length_m];
        let place_m = self.lift.map_or(none, |lift| lift.place_m);
        [
            (mass_kg, inertia_kg_m2 - mass_kg * centre_m * centre_m, 0, [[0.0, centre_m], none, none]),
            (self.carried_kg, 0.0, 0, [place_m, none, none]),
            (inner.mass_kg, inner.inertia_kg_m2, 1, [tail_m, hangs(inner.centre_m), none]),
            (outer.mass_kg, outer.inertia_kg_m2, 2, [tail_m, hangs(inner.length_m), hangs(outer.centre_m)]),
        ]
    }

    fn motion(&self, state: &TailState) -> Motion {
        let sums = |[trunk, first, second]: [f64; 3]| [trunk, trunk + first, trunk + first + second];
        let rates = sums(state.rate_rad_s);
        let directions = sums(state.angle_rad).map(|angle| {
            let (sin, cos) = libm::sincos(angle);
            [sin, cos]
        });
        let mut motion = Motion { mass: [[0.0; 3]; 3], force: [0.0; 3], potential_j: 0.0 };
        for (mass_kg, inertia_kg_m2, owner, arms) in self.parts() {
            let at: [_; 3] = std::array::from_fn(|k| turned(arms[k], directions[k]));
            // velocity of the place per rate of each angle: perpendicular to its arm
            let along: [_; 3] = std::array::from_fn(|k| turned([arms[k][1], -arms[k][0]], directions[k]));
            let centrifugal = |axis: usize| (0..3).map(|k| at[k][axis] * rates[k] * rates[k]).sum::<f64>();
            let pull = [centrifugal(0), centrifugal(1) - GRAVITY_M_S2];
            for i in 0..3 {
                motion.force[i] += mass_kg * (along[i][0] * pull[0] + along[i][1] * pull[1]);
                for j in 0..3 {
                    motion.mass[i][j] += mass_kg * (along[i][0] * along[j][0] + along[i][1] * along[j][1]);
                }
            }
            motion.mass[owner][owner] += inertia_kg_m2;
            motion.potential_j += mass_kg * GRAVITY_M_S2 * (at[0][1] + at[1][1] + at[2][1]);
        }
        motion
    }

    /// Accelerations of trunk and joints under the torques of ankle and joints, rad/s².
    fn accelerations(&self, state: &TailState, [ankle_nm, first_nm, second_nm]: [f64; 3]) -> [f64; 3] {
        let Motion { mass, force, .. } = self.motion(state);
        let torque = [ankle_nm - first_nm, first_nm - second_nm, second_nm];
        let [trunk, first, second] = solve(mass, std::array::from_fn(|k| force[k] + torque[k]));
        [trunk, first - trunk, second - first]
    }

    fn ankle(&self, state: &TailState) -> f64 {
        let Ankle { stiffness_nm_per_rad, damping_nm_s_per_rad, torque_max_nm } = self.wearer.ankle;
        let spring_nm = stiffness_nm_per_rad * (self.posture_rad - state.angle_rad[0]);
        (spring_nm - damping_nm_s_per_rad * state.rate_rad_s[0]).clamp(-torque_max_nm, torque_max_nm)
    }

    /// Torque of a cable at its joint before losses, N m.
    fn cable(&self, number: usize, state: &TailState, shaft: ShaftMotion) -> f64 {
        let Cable { ratio, stiffness_nm_per_rad, damping_nm_s_per_rad, .. } = self.links[number].cable;
        let stretch = shaft.position / ratio + self.slack_rad[number] - state.angle_rad[number + 1];
        stiffness_nm_per_rad * stretch + damping_nm_s_per_rad * (shaft.speed / ratio - state.rate_rad_s[number + 1])
    }

    /// Torque that a cable transmits to the joint after losses, N m.
    fn after_losses(&self, number: usize, cable_nm: f64, rate_rad_s: f64) -> f64 {
        let Cable { wraps, loss_per_wrap, friction_nm, .. } = self.links[number].cable;
        let slides = libm::tanh(rate_rad_s / SLIDE_RAD_S);
        // less of it in the direction of motion, more against it
        let lost = -wraps * libm::log1p(-loss_per_wrap) * slides * cable_nm.signum();
        cable_nm * libm::exp(-lost) - friction_nm * slides
    }

    /// Rates and accelerations for the given motion of the shafts, rad/s and rad/s².
    fn derivative(&self, state: &TailState, shafts: [ShaftMotion; 2]) -> TailState {
        let joint = |number: usize| {
            let cable_nm = self.cable(number, state, shafts[self.links[number].cable.shaft]);
            self.after_losses(number, cable_nm, state.rate_rad_s[number + 1])
        };
        let torques = [self.ankle(state), joint(0), joint(1)];
        TailState { angle_rad: state.rate_rad_s, rate_rad_s: self.accelerations(state, torques) }
    }

    /// Advances by classical Runge-Kutta; the shafts' positions are those at the end of the step.
    fn integrate(&mut self, shafts: [ShaftMotion; 2], step_s: f64) {
        let at = |share: f64| {
            shafts.map(|shaft| ShaftMotion { position: shaft.position - (1.0 - share) * step_s * shaft.speed, ..shaft })
        };
        let first = self.derivative(&self.state, at(0.0));
        let second = self.derivative(&self.state.plus(&first, 0.5 * step_s), at(0.5));
        let third = self.derivative(&self.state.plus(&second, 0.5 * step_s), at(0.5));
        let fourth = self.derivative(&self.state.plus(&third, step_s), at(1.0));
        for (slope, weight) in [(&first, 1.0), (&second, 2.0), (&third, 2.0), (&fourth, 1.0)] {
            self.state = self.state.plus(slope, weight * step_s / 6.0);
        }
        self.acceleration_rad_s2 = fourth.rate_rad_s;
        if self.state.angle_rad[0].abs() >= LIES_RAD {
            self.state.angle_rad[0] = LIES_RAD.copysign(self.state.angle_rad[0]);
            self.state.rate_rad_s[0] = 0.0;
        }
    }
}

impl TailState {
    fn plus(&self, slope: &Self, step_s: f64) -> Self {
        Self {
            angle_rad: std::array::from_fn(|k| self.angle_rad[k] + step_s * slope.angle_rad[k]),
            rate_rad_s: std::array::from_fn(|k| self.rate_rad_s[k] + step_s * slope.rate_rad_s[k]),
        }
    }
}

/// Solves a linear system by Cramer's rule: the mass matrix is positive definite, with three eigenvalues of similar
/// magnitude.
fn solve(m: [[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
    let determinant = |m: [[f64; 3]; 3]| {
        m[0][0] * (m[1][1] * m[2][2] - m[1][2] * m[2][1]) - m[0][1] * (m[1][0] * m[2][2] - m[1][2] * m[2][0])
            + m[0][2] * (m[1][0] * m[2][1] - m[1][1] * m[2][0])
    };
    let whole = determinant(m);
    std::array::from_fn(|column| {
        let mut replaced = m;
        for row in 0..3 {
            replaced[row][column] = v[row];
        }
        determinant(replaced) / whole
    })
}

impl Body for BalanceTail {
    fn shafts(&self) -> usize {
        2
    }

    fn step(&mut self, _: &mut Scene, time_s: f64, shafts: &[ShaftMotion], loads: &mut [f64], step_s: f64) {
        loads.fill(0.0);
        let shafts = [0, 1].map(|number| shafts.get(number).copied().unwrap_or_default());
        self.carried_kg = self.lift.map_or(0.0, |Lift { at_s, over_s, mass_kg, .. }| {
            let since_s = time_s - at_s;
            if since_s < 0.0 { 0.0 } else { mass_kg * if since_s < over_s { since_s / over_s } else { 1.0 } }
        });
        self.integrate(shafts, step_s);
        let half_s = 0.5 * step_s;
        let ahead = self.state.plus(&TailState { angle_rad: self.state.rate_rad_s, rate_rad_s: [0.0; 3] }, half_s);
        for (number, link) in self.links.iter().enumerate() {
            let Cable { shaft, ratio, .. } = link.cable;
            let motion = shafts[shaft];
            self.cables_nm[number] = self.cable(number, &self.state, motion);
            let later = ShaftMotion { position: motion.position + half_s * motion.speed, ..motion };
            if let Some(load) = loads.get_mut(shaft) {
                *load -= self.cable(number, &ahead, later) / ratio;
            }
        }
    }

    fn pose(&self) -> Pose {
        self.pose
    }

    fn set_pose(&mut self, pose: Pose) {
        self.pose = pose;
        (self.state, self.acceleration_rad_s2, self.carried_kg) = (self.start, [0.0; 3], 0.0);
    }

    fn twist(&self) -> Twist {
        Twist::default()
    }

    /// Motion of the ankle, in the trunk's frame.
    fn inertial(&self) -> Inertial {
        let (sin, cos) = libm::sincos(self.state.angle_rad[0]);
        Inertial {
            specific_force_m_s2: [-GRAVITY_M_S2 * sin, 0.0, GRAVITY_M_S2 * cos],
            rate_rad_s: [0.0, self.state.rate_rad_s[0], 0.0],
            angular_acceleration_rad_s2: [0.0, self.acceleration_rad_s2[0], 0.0],
        }
    }
}
