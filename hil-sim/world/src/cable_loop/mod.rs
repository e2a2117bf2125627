//! Gripper that closes a loop of flexible TPU round a vial: a spool reels in both strands of the loop through a Bowden
//! tube.
//!
//! A lift carries the finger over the vial; two more axes move it forwards and to the left. With the length `S` of the
//! loop outside the finger, a vial of diameter `D` is tight at `S = π D + s0`; retracted, the loop is tight at
//! `S = 2 π r + s0` with its minimum bend radius `r`. Below the tight length each strand is a spring:
//!
//! ```text
//! T_out = (S_tight / 2 - y - z) / c      y: strand outside the finger, unstretched   z: its creep
//! c = S_tight / (2 EA) + 2 cos² β / k_tip
//! N = 2 T_out cos β                      squeeze of the vial between loop and tip
//! T_in = k_bowden (y - u)                u: strand that the spool has paid out, half of the start plus radius times angle
//! T_in exp(-μθ) <= T_out <= T_in exp(μθ) capstan; within these limits y sticks, at one of them it slides
//! ```
//!
//! So `y` is a play operator: `u` moves its two limits, each of which is a balance of two springs in closed form. The
//! vial is held while `2 μ N` exceeds its weight and inertial force; otherwise it slides, and is lost when its top
//! reaches the loop.
//!
//! # Frames
//! Heights are above the table; the tip's place is `[forwards, left]` of its start. Spool: positive pays out. Lift:
//! positive lowers.
//!
//! # Source
//! Sizes of vials, 3 mm clearance, bend radius 5 mm: "Cable-Loop Gripper Add-on for Multimodal Grasping of Lab Supplies", TAROS 2023.
//! Capstan: Euler-Eytelwein. Creep: one Kelvin-Voigt element in series with the spring (standard linear solid).
//!
//! Not modelled: mass of loop and cable; friction of the loop round the vial, so both strands pull alike; motion of the
//! vial along the table to the tip; tilting; motion of neighbours in a rack; buckling of the loop while it is paid out.

#[cfg(test)]
mod tests;

use std::f64::consts::PI;

use crate::{
    GRAVITY_M_S2,
    body::{Body, Inertial, Pose, ShaftMotion, Twist},
    scene::Scene,
};

/// Time constant of the finger on the lift, s: two poles that smooth the steps of the lift's motor. Synthetic: a
/// printed finger at 20 Hz.
const FINGER_S: f64 = 0.008;
/// Time in which a vial that starts to slide flattens the soft tip, s. Synthetic.
const FLATTENS_S: f64 = 0.01;
/// Height from which on the vial counts as being in the air, m.
const IN_AIR_M: f64 = 1e-3;
/// Height of the vial at which the delay of a jerk starts, m.
const LIFTED_M: f64 = 0.02;

/// Spool, loop and tip of the finger.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Finger {
    /// Radius of the spool to the middle of the cable, m.
    pub spool_radius_m: f64,
    /// Length of a tight loop minus the circumference it encloses, `s0`, m.
    pub legs_m: f64,
    /// Minimum bend radius of the loop, m.
    pub bend_radius_m: f64,
    /// Thickness of the loop, m.
    pub thickness_m: f64,
    /// Axial stiffness EA: force that would double a strand's length, N.
    pub strand_n: f64,
    /// Half the angle between the strands at the tip, rad.
    pub half_angle_rad: f64,
    /// Stiffness of the soft tip, N/m.
    pub tip_n_per_m: f64,
    /// Length of the loop outside the finger with the spool at 0, m.
    pub start_m: f64,
}

/// Bowden tube from the spool to the finger.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bowden {
    /// Stiffness of one strand and its share of the tube, N/m.
    pub stiffness_n_per_m: f64,
    /// Friction coefficient times the angle of all bends, `μθ`, rad; 0 for a frictionless tube.
    pub friction_angle: f64,
}

/// Creep of the loop's material.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Creep {
    /// Share of the force that relaxes at a fixed length after a long time, 0 to below 1.
    pub share: f64,
    /// Time constant of creep at constant force, s.
    pub time_s: f64,
}

/// Force sensor behind the tip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TipSensor {
    /// Reading without force at time 0, N.
    pub zero_n: f64,
    /// Drift of the zero, N/s.
    pub drift_n_per_s: f64,
    /// Relative drop of the reading while the vial slides.
    pub slip_share: f64,
}

/// Axes that move the finger, with their travel per radian of the shaft.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Axes {
    /// Height of the loop with the lift at 0, m.
    pub raised_m: f64,
    /// Travel of the lift, m/rad, positive downwards.
    pub lift_m_per_rad: f64,
    /// Travel of the forward axis, m/rad.
    pub ahead_m_per_rad: f64,
    /// Travel of the lateral axis to the left, m/rad.
    pub aside_m_per_rad: f64,
}

/// Vial to be gripped, and its place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vial {
    /// Outer diameter of the vial, m.
    pub diameter_m: f64,
    /// Mass of the vial, kg.
    pub mass_kg: f64,
    /// Height from bottom to top, m.
    pub height_m: f64,
    /// Position of its axis relative to the tip, forwards and to the left, with the axes at 0, m.
    pub place_m: [f64; 2],
    /// Static friction coefficient of its wall on tip and loop.
    pub friction: f64,
    /// Ratio of kinetic to static friction.
    pub kinetic_share: f64,
    /// Squeeze above which it breaks, N.
    pub crush_n: f64,
    /// Free space around it in its rack, m.
    pub clearance_m: f64,
}

/// A knock against the gripper's support while the vial is in the air: a temporary upward acceleration.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Jerk {
    /// Time from the lift of the vial to the knock, s.
    pub after_s: f64,
    /// Duration of the knock, s.
    pub lasts_s: f64,
    /// Acceleration of the support, m/s², positive upwards.
    pub acceleration_m_s2: f64,
}

/// State of the vial relative to the loop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Hold {
    /// Outside the loop, at its initial place.
    #[default]
    Outside,
    /// Inside the loop, gripped or not.
    Inside,
    /// Fallen: it slid out of the loop, or was in the air when the loop opened.
    Dropped,
}

/// Reasons why a gripper cannot be simulated.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum CableLoopError {
    /// Parameters of the finger.
    #[error(
        "radius, lengths and stiffnesses of the finger must be positive, half the angle of the strands below 1.5 rad"
    )]
    Finger,
    /// Parameters of the Bowden tube.
    #[error("the Bowden tube's stiffness must be positive, its friction angle from 0 to 5")]
    Bowden,
    /// Parameters of the creep.
    #[error("creep needs a share from 0 to below 1 and a positive time")]
    Creep,
    /// Parameters of the axes.
    #[error("no axis may move the finger by 0 m for a rad, and the loop must start above the table")]
    Axes,
    /// Parameters of the vial.
    #[error(
        "diameter, mass, height, friction and crushing force of the vial must be positive, its kinetic share above 0 and at most 1"
    )]
    Vial,
}

/// A gripper with a loop, its lift, and a vial.
#[derive(Clone, Debug, PartialEq)]
pub struct CableLoop {
    finger: Finger,
    bowden: Bowden,
    creep: Creep,
    sensor: TipSensor,
    axes: Axes,
    vial: Vial,
    jerk: Option<Jerk>,
    pose: Pose,
    state: State,
}

/// State variables of the gripper.
#[derive(Clone, Copy, Debug, PartialEq)]
struct State {
    time_s: f64,
    /// Length of a strand outside the finger, unstretched, m.
    strand_m: f64,
    /// Length of a strand that the spool has paid out, m.
    paid_m: f64,
    creep_m: f64,
    /// Tension of a strand outside the finger and before the tube, N.
    out_n: f64,
    in_n: f64,
    /// Height of the loop above the table, m, and its rate.
    loop_m: f64,
    loop_m_s: f64,
    /// Place of the tip, forwards and left, m.
    tip_m: [f64; 2],
    hold: Hold,
    /// Height of the loop above the vial's bottom, m.
    grip_m: f64,
    /// Height of the loop above the vial's bottom when it was gripped, m.
    gripped_m: f64,
    slip_m_s: f64,
    /// Flattening of the tip by sliding, 0 to 1.
    flat: f64,
    lifted_at_s: Option<f64>,
    is_crushed: bool,
    squeeze_max_n: f64,
    slip_max_m: f64,
    is_new: bool,
}

impl CableLoop {
    /// A gripper at rest above the vial, with a loop of length [`Finger::start_m`].
    ///
    /// # Errors
    /// [`CableLoopError`] names the part whose parameters are out of range.
    pub fn new(
        (finger, bowden, creep, sensor): (Finger, Bowden, Creep, TipSensor),
        axes: Axes,
        vial: Vial,
        jerk: Option<Jerk>,
    ) -> Result<Self, CableLoopError> {
        let positive = |values: &[f64]| values.iter().all(|value| *value > 0.0 && value.is_finite());
        let Finger {
            spool_radius_m,
            legs_m,
            bend_radius_m,
            thickness_m,
            strand_n,
            half_angle_rad,
            tip_n_per_m,
            start_m,
        } = finger;
        let sizes = [spool_radius_m, legs_m, bend_radius_m, thickness_m, strand_n, tip_n_per_m, start_m];
        if !positive(&sizes) || !(0.0..1.5).contains(&half_angle_rad) {
            return Err(CableLoopError::Finger);
        }
        if !positive(&[bowden.stiffness_n_per_m]) || !(0.0..=5.0).contains(&bowden.friction_angle) {
            return Err(CableLoopError::Bowden);
        }
        if !(0.0..1.0).contains(&creep.share) || !positive(&[creep.time_s]) {
            return Err(CableLoopError::Creep);
        }
        let moves = [axes.lift_m_per_rad, axes.ahead_m_per_rad, axes.aside_m_per_rad];
        if moves.iter().any(|moved| *moved == 0.0 || !moved.is_finite()) || !positive(&[axes.raised_m]) {
            return Err(CableLoopError::Axes);
        }
        let Vial { diameter_m, mass_kg, height_m, friction, kinetic_share, crush_n, clearance_m, .. } = vial;
        if !positive(&[diameter_m, mass_kg, height_m, friction, kinetic_share, crush_n, clearance_m])
            || kinetic_share > 1.0
        {
            return Err(CableLoopError::Vial);
        }
        let state = State::new(&finger, &axes);
        Ok(Self { finger, bowden, creep, sensor, axes, vial, jerk, pose: Pose::default(), state })
    }

    /// Parameters of the finger.
    #[must_use]
    pub const fn finger(&self) -> &Finger {
        &self.finger
    }

    /// Parameters of the Bowden tube.
    #[must_use]
    pub const fn bowden(&self) -> &Bowden {
        &self.bowden
    }

    /// Parameters of the creep.
    #[must_use]
    pub const fn creep(&self) -> &Creep {
        &self.creep
    }

    /// Parameters of the force sensor.
    #[must_use]
    pub const fn sensor(&self) -> &TipSensor {
        &self.sensor
    }

    /// Parameters of the axes.
    #[must_use]
    pub const fn axes(&self) -> &Axes {
        &self.axes
    }

    /// Parameters of the vial.
    #[must_use]
    pub const fn vial(&self) -> &Vial {
        &self.vial
    }

    /// State of the vial relative to the loop.
    #[must_use]
    pub const fn hold(&self) -> Hold {
        self.state.hold
    }

    /// Squeeze of the vial, N; 0 if the loop is tight without one.
    #[must_use]
    pub fn squeeze_n(&self) -> f64 {
        if self.state.hold == Hold::Inside { self.tip_n() } else { 0.0 }
    }

    /// Largest squeeze so far, N.
    #[must_use]
    pub const fn squeeze_max_n(&self) -> f64 {
        self.state.squeeze_max_n
    }

    /// Slip of the vial down in the loop since it was gripped, m: present value and maximum so far.
    #[must_use]
    pub fn slip_m(&self) -> [f64; 2] {
        [self.state.grip_m - self.state.gripped_m, self.state.slip_max_m]
    }

    /// Height of the vial's bottom above the table, m.
    #[must_use]
    pub fn height_m(&self) -> f64 {
        if self.state.hold == Hold::Inside { (self.state.loop_m - self.state.grip_m).max(0.0) } else { 0.0 }
    }

    /// Height of the loop, m.
    #[must_use]
    pub const fn loop_m(&self) -> f64 {
        self.state.loop_m
    }

    /// True once the vial was crushed.
    #[must_use]
    pub const fn is_crushed(&self) -> bool {
        self.state.is_crushed
    }

    /// Tension of a strand before the tube and outside the finger, N, in this order.
    #[must_use]
    pub const fn tensions_n(&self) -> [f64; 2] {
        [self.state.in_n, self.state.out_n]
    }

    /// Length of the loop outside the finger, unstretched, m.
    #[must_use]
    pub fn length_m(&self) -> f64 {
        2.0 * self.state.strand_m
    }

    /// Force on the tip by a vial or the retracted loop, N.
    fn tip_n(&self) -> f64 {
        2.0 * self.state.out_n * libm::cos(self.finger.half_angle_rad)
    }

    /// Length at which the loop is tight, round the vial or by itself, m.
    fn tight_m(&self) -> f64 {
        let least_m = 2.0 * self.finger.bend_radius_m;
        let round_m = if self.state.hold == Hold::Inside { self.vial.diameter_m.max(least_m) } else { least_m };
        PI * round_m + self.finger.legs_m
    }

    /// Compliance of a strand outside the finger, m/N.
    fn compliance_m_per_n(&self) -> f64 {
        let cos = libm::cos(self.finger.half_angle_rad);
        0.5 * self.tight_m() / self.finger.strand_n + 2.0 * cos * cos / self.finger.tip_n_per_m
    }

    /// Updates the play between spool and tip (capstan friction) and the creep.
    fn pull(&mut self, paid_m: f64, step_s: f64) {
        let compliance_m_per_n = self.compliance_m_per_n();
        let outer_n_per_m = 1.0 / compliance_m_per_n;
        // exact for a force that is constant over the step
        let Creep { share, time_s } = self.creep;
        let crept_m = share / (1.0 - share) * compliance_m_per_n * self.state.out_n;
        self.state.creep_m += (crept_m - self.state.creep_m) * -libm::expm1(-step_s / time_s);
        let slack_m = 0.5 * self.tight_m() - self.state.creep_m;
        self.state.paid_m = paid_m;
        if paid_m >= slack_m {
            (self.state.strand_m, self.state.out_n, self.state.in_n) = (paid_m, 0.0, 0.0);
            return;
        }
        let Bowden { stiffness_n_per_m, friction_angle } = self.bowden;
        let balance_m = |share: f64| {
            let inner_n_per_m = share * stiffness_n_per_m;
            (outer_n_per_m * slack_m + inner_n_per_m * paid_m) / (outer_n_per_m + inner_n_per_m)
        };
        let (reeled_m, released_m) = (balance_m(libm::exp(-friction_angle)), balance_m(libm::exp(friction_angle)));
        self.state.strand_m = self.state.strand_m.clamp(released_m, reeled_m);
        self.state.out_n = outer_n_per_m * (slack_m - self.state.strand_m);
        self.state.in_n = stiffness_n_per_m * (self.state.strand_m - paid_m);
    }

    /// True if the loop goes over the vial's top without touching the vial or its neighbours.
    fn fits(&self) -> bool {
        let radius_m = (self.length_m() - self.finger.legs_m) / (2.0 * PI);
        let [ahead_m, aside_m] = [0, 1].map(|axis| self.vial.place_m[axis] - self.state.tip_m[axis]);
        let off_m = libm::hypot(ahead_m - radius_m, aside_m);
        let gap_m = radius_m - 0.5 * self.vial.diameter_m;
        off_m <= gap_m && gap_m + self.finger.thickness_m + off_m <= self.vial.clearance_m
    }

    /// Advances vial and loop by one step, with the loop's acceleration upwards.
    fn carry(&mut self, time_s: f64, acceleration_m_s2: f64, step_s: f64) {
        let Vial { mass_kg, height_m, friction, kinetic_share, .. } = self.vial;
        let State { loop_m, .. } = self.state;
        let is_above = loop_m > height_m;
        match self.state.hold {
            Hold::Outside if !is_above && self.state.is_new => {
                self.state.is_new = false;
                if self.fits() {
                    self.state.hold = Hold::Inside;
                    (self.state.grip_m, self.state.gripped_m, self.state.slip_m_s) = (loop_m, loop_m, 0.0);
                }
            }
            Hold::Outside => self.state.is_new = self.state.is_new || is_above,
            Hold::Dropped => {}
            Hold::Inside => {
                let squeeze_n = self.tip_n();
                let lifted_m = loop_m - self.state.grip_m;
                if squeeze_n <= 0.0 {
                    self.state.slip_m_s = 0.0;
                    if lifted_m > IN_AIR_M {
                        self.state.hold = Hold::Dropped;
                    } else {
                        (self.state.grip_m, self.state.gripped_m) = (loop_m, loop_m);
                        if is_above {
                            (self.state.hold, self.state.is_new) = (Hold::Outside, true);
                        }
                    }
                    return;
                }
                let knock_m_s2 = self.knock(time_s, lifted_m);
                // downward acceleration of the vial relative to the loop, without friction
                let pull_m_s2 = GRAVITY_M_S2 + acceleration_m_s2 + knock_m_s2;
                let held_m_s2 = 2.0 * friction * squeeze_n / mass_kg;
                if self.state.slip_m_s == 0.0 && pull_m_s2.abs() > held_m_s2 {
                    // stores only the direction of a starting slide; the speed follows below
                    self.state.slip_m_s = pull_m_s2.signum() * f64::MIN_POSITIVE;
                }
                if self.state.slip_m_s != 0.0 {
                    let direction = self.state.slip_m_s.signum();
                    let change_m_s = (pull_m_s2 - direction * kinetic_share * held_m_s2) * step_s;
                    self.state.slip_m_s += change_m_s;
                    if self.state.slip_m_s * direction <= 0.0 {
                        self.state.slip_m_s = 0.0;
                    }
                    self.state.grip_m += self.state.slip_m_s * step_s;
                }
                if loop_m < self.state.grip_m {
                    // the vial stands on the table
                    (self.state.grip_m, self.state.slip_m_s) = (loop_m, 0.0);
                }
                let sliding = f64::from(u8::from(self.state.slip_m_s != 0.0));
                self.state.flat += (sliding - self.state.flat) * -libm::expm1(-step_s / FLATTENS_S);
                self.state.slip_max_m = self.state.slip_max_m.max(self.state.grip_m - self.state.gripped_m);
                self.state.squeeze_max_n = self.state.squeeze_max_n.max(squeeze_n);
                self.state.is_crushed |= squeeze_n > self.vial.crush_n;
                if self.state.grip_m >= height_m {
                    self.state.hold = Hold::Dropped;
                }
            }
        }
    }

    /// Present acceleration of the knock, m/s².
    fn knock(&mut self, time_s: f64, lifted_m: f64) -> f64 {
        if lifted_m > LIFTED_M && self.state.lifted_at_s.is_none() {
            self.state.lifted_at_s = Some(time_s);
        }
        let (Some(jerk), Some(lifted_at_s)) = (self.jerk, self.state.lifted_at_s) else { return 0.0 };
        let since_s = time_s - lifted_at_s - jerk.after_s;
        if (0.0..jerk.lasts_s).contains(&since_s) { jerk.acceleration_m_s2 } else { 0.0 }
    }

    /// Distance that the range sensor in the finger measures in front of the tip, m; [`FARTHEST_M`] without an object.
    fn range_m(&self) -> f64 {
        let radius_m = 0.5 * self.vial.diameter_m;
        let [ahead_m, aside_m] = [0, 1].map(|axis| self.vial.place_m[axis] - self.state.tip_m[axis]);
        match self.state.hold {
            // the loop has pulled the vial to the tip
            Hold::Inside if self.state.out_n > 0.0 => 0.0,
            Hold::Outside | Hold::Inside if aside_m.abs() < radius_m => {
                let chord_m = (radius_m * radius_m - aside_m * aside_m).sqrt();
                // a lifted finger looks over a vial that stays on the table
                let sees = self.state.loop_m < self.axes.raised_m + IN_AIR_M;
                if sees { (ahead_m - chord_m).clamp(0.0, FARTHEST_M) } else { FARTHEST_M }
            }
            _ => FARTHEST_M,
        }
    }
}

/// Largest distance that the range sensor measures, m.
pub const FARTHEST_M: f64 = 0.2;

impl State {
    fn new(finger: &Finger, axes: &Axes) -> Self {
        let strand_m = 0.5 * finger.start_m;
        Self {
            time_s: 0.0,
            strand_m,
            paid_m: strand_m,
            creep_m: 0.0,
            out_n: 0.0,
            in_n: 0.0,
            loop_m: axes.raised_m,
            loop_m_s: 0.0,
            tip_m: [0.0; 2],
            hold: Hold::Outside,
            grip_m: axes.raised_m,
            gripped_m: axes.raised_m,
            slip_m_s: 0.0,
            flat: 0.0,
            lifted_at_s: None,
            is_crushed: false,
            squeeze_max_n: 0.0,
            slip_max_m: 0.0,
            is_new: true,
        }
    }
}

impl Body for CableLoop {
    /// Shafts in order: spool, lift, forwards, left.
    fn shafts(&self) -> usize {
        4
    }

    fn step(&mut self, _: &mut Scene, time_s: f64, shafts: &[ShaftMotion], loads: &mut [f64], step_s: f64) {
        loads.fill(0.0);
        let position = |number: usize| shafts.get(number).map_or(0.0, |shaft| shaft.position);
        self.state.time_s = time_s;
        self.state.tip_m = [position(2) * self.axes.ahead_m_per_rad, position(3) * self.axes.aside_m_per_rad];
        let target_m = self.axes.raised_m - position(1) * self.axes.lift_m_per_rad;
        let acceleration_m_s2 =
            (target_m - self.state.loop_m) / (FINGER_S * FINGER_S) - 2.0 * self.state.loop_m_s / FINGER_S;
        self.state.loop_m_s += acceleration_m_s2 * step_s;
        self.state.loop_m += self.state.loop_m_s * step_s;
        self.pull(0.5 * self.finger.start_m + position(0) * self.finger.spool_radius_m, step_s);
        self.carry(time_s, acceleration_m_s2, step_s);
        // both strands pull at the spool
        if let Some(load) = loads.first_mut() {
            *load = 2.0 * self.state.in_n * self.finger.spool_radius_m;
        }
    }

    fn pose(&self) -> Pose {
        self.pose
    }

    fn set_pose(&mut self, pose: Pose) {
        self.pose = pose;
        self.state = State::new(&self.finger, &self.axes);
    }

    fn twist(&self) -> Twist {
        Twist::default()
    }

    fn inertial(&self) -> Inertial {
        Inertial::AT_REST
    }

    fn readings(&self) -> &'static [&'static str] {
        &["force_n", "range_m"]
    }

    fn reading(&self, number: usize) -> f64 {
        match number {
            0 => {
                let TipSensor { zero_n, drift_n_per_s, slip_share } = self.sensor;
                self.tip_n() * (1.0 - slip_share * self.state.flat) + zero_n + drift_n_per_s * self.state.time_s
            }
            1 => self.range_m(),
            _ => 0.0,
        }
    }
}
