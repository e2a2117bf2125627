//! Pneumatic gripper that picks berries from a bush: supply, valve, cylinder, fingers, berries on stalks, tray.
//!
//! ```text
//! compressor -> receiver -> regulator -> 5/2 valve -> two chambers -> rod -> fingers -> berry -> stalk
//! dp/dt = n/V (R T mdot - p dV/dt)                     each chamber, flow by ISO 6358
//! m x'' = p_close A_close - p_open A_open - k_bend x - ratio F - c x' - F_coulomb sign x'
//! F = k (d - gap), 1/k = 1/k_fingers + 1/k_berry       squeeze of a berry of diameter d
//! ```
//!
//! The travel `x` of the rod is 0 with the fingers open. The valve has a coil and a spring: without current the spring
//! opens the fingers, so a board without power neither closes them nor holds what is between them. Two axes move the
//! tool: `reach` towards the bush and back over the tray, `row` along the bush; the tray moves along the row with the
//! tool.
//!
//! # Picking
//! # Picking
//! A berry is between the fingers if it fits the gap when they come over it; a finger pushes away one that does not.
//! Closed fingers hold it by friction, `2 mu F` times the share of the pads that still touches it. A tool that pulls
//! away tenses the stalk: the berry detaches at its force, or slips along the pads first. It falls when friction no
//! longer carries its weight: into the tray where the fingers are over it, on the ground elsewhere. A squeeze above its
//! crush force damages it.
//!
//! Not modelled: leaves and other berries in the way, swinging of canes, the berry's inertia (5 g at 6 m/s² are 0.03
//! N), heating of the air, leaks, flow in the regulator.

#[cfg(test)]
mod tests;

use std::f64::consts::FRAC_PI_4;

use crate::{
    GRAVITY_M_S2, MAX_STEP_S,
    body::{Body, Inertial, Pose, ShaftMotion, Twist},
    pneumatic::{ATMOSPHERE_PA, Chamber, REFERENCE_KG_M3, Restriction},
    scene::Scene,
};

/// Polytropic exponent of the air in chambers whose walls warm it within a stroke of 50 ms: between 1 and 1.4, the
/// usual mean in pneumatics (ISO 6358-1 leaves it open).
const CHAMBER_EXPONENT: f64 = 1.2;
/// Names of the readings, in the order of [`Body::reading`].
const READINGS: &[&str] = &["close_pressure_pa", "supply_pa", "trigger", "gap_m", "squeeze_n"];

/// Compressed air: a compressor that runs between two pressures, its receiver, and a regulator behind it. Pressures are
/// gauge.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AirSupply {
    /// Volume of the receiver, m³.
    pub receiver_m3: f64,
    /// Free air that the compressor delivers while it runs, m³/s.
    pub compressor_m3_s: f64,
    /// Gauge pressures of the receiver below which the compressor starts and above which it stops, Pa.
    pub runs_between_pa: [f64; 2],
    /// Setting of the regulator, gauge, Pa.
    pub regulated_pa: f64,
}

/// A 5/2 valve with a coil and a spring, on a relay.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CoilValve {
    /// Shaft number of the valve's relay.
    pub shaft: usize,
    /// Delays from the relay's contact to the spool in its other position, s: on by the coil, and back by the spring.
    pub delay_s: [f64; 2],
    /// Flow path from the regulator into a chamber, with its tube.
    pub inlet: Restriction,
    /// Flow path from a chamber to the atmosphere, with its tube and throttle.
    pub exhaust: Restriction,
}

/// Double-acting pneumatic cylinder with end cushions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cylinder {
    /// Diameter of the piston, m.
    pub bore_m: f64,
    /// Diameter of the rod, m.
    pub rod_m: f64,
    /// Travel of the rod from end to end, m.
    pub stroke_m: f64,
    /// Volume of tube, fitting and end cap beside each chamber, m³.
    pub dead_m3: f64,
    /// Mass of everything that moves with the rod, kg.
    pub mass_kg: f64,
    /// Dry friction of the seals, N.
    pub coulomb_n: f64,
    /// Viscous friction of the rod, N s/m.
    pub viscous_n_s_per_m: f64,
    /// Additional viscous friction within the last [`Cylinder::CUSHION_M`] before either end, N s/m.
    pub cushion_n_s_per_m: f64,
    /// True if the rod extends to close the fingers. Otherwise it retracts, and the closing side has the annular area.
    pub closes_outwards: bool,
}

impl Cylinder {
    /// Length of the cushions, m.
    pub const CUSHION_M: f64 = 1.5e-3;

    /// Areas on which air closes and opens the fingers, m², in this order.
    #[must_use]
    pub fn areas_m2(&self) -> [f64; 2] {
        let piston_m2 = FRAC_PI_4 * self.bore_m * self.bore_m;
        let ring_m2 = piston_m2 - FRAC_PI_4 * self.rod_m * self.rod_m;
        if self.closes_outwards { [piston_m2, ring_m2] } else { [ring_m2, piston_m2] }
    }
}

/// Fingers that close with the rod.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fingers {
    /// Distance between opposite pads at a travel of 0, m.
    pub open_gap_m: f64,
    /// Reduction of the gap per travel of the rod, m/m.
    pub gap_ratio: f64,
    /// Stiffness of both pads in series, N/m.
    pub stiffness_n_per_m: f64,
    /// Stiffness against bending of the fingers as seen by the rod, N per metre of its travel.
    pub bending_n_per_m: f64,
    /// Half the length of the pads along the reach, m.
    pub pad_m: f64,
}

/// Axes that move the tool.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ToolAxes {
    /// Shaft numbers of reach and row.
    pub shafts: [usize; 2],
    /// Travel per radian of a shaft, m/rad.
    pub m_per_rad: f64,
    /// Reach up to which the fingers are over the tray, m.
    pub tray_m: f64,
}

/// A berry on its stalk.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Berry {
    /// Position on the bush: reach and row, m.
    pub place_m: [f64; 2],
    /// Diameter of the berry, m.
    pub diameter_m: f64,
    /// Mass of the berry, kg.
    pub mass_kg: f64,
    /// Stiffness across its diameter, N/m.
    pub stiffness_n_per_m: f64,
    /// Coulomb friction coefficient of a pad on it.
    pub friction: f64,
    /// Stiffness of stalk and cane along the reach, N/m.
    pub stalk_n_per_m: f64,
    /// Tension of the stalk at which the berry detaches, N.
    pub detach_n: f64,
    /// Squeeze above which it is damaged, N.
    pub crush_n: f64,
}

/// Place of a berry.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Place {
    /// Hanging on its stalk.
    Hanging,
    /// Off its stalk, between the fingers.
    Held,
    /// Lying in the tray.
    Tray,
    /// Lying on the ground.
    Ground,
}

/// Outcome for a berry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Fate {
    /// Present place of the berry.
    pub place: Place,
    /// True once it was squeezed above its crush force.
    pub is_crushed: bool,
    /// Highest squeeze so far, N.
    pub squeeze_max_n: f64,
    /// Speed of the fingers along reach and row at its release, m/s; 0 before.
    pub released_m_s: f64,
}

/// Parameters out of range, by the part they belong to.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum BerryError {
    /// Parameters of the air supply.
    #[error(
        "the supply needs a receiver, a flow, pressures above the atmosphere and a compressor that stops above where it starts"
    )]
    Supply,
    /// Parameters of the valve.
    #[error(
        "the valve needs positive conductances, a critical ratio from 0 to below 1 and delays that are not negative"
    )]
    Valve,
    /// Parameters of the cylinder.
    #[error(
        "the cylinder needs a bore above its rod, a stroke, a volume beside each chamber, a mass, and friction that is not negative"
    )]
    Cylinder,
    /// Parameters of the fingers.
    #[error("the fingers need a gap that stays open over the stroke, stiffness, and pads")]
    Fingers,
    /// A chamber that one step of the simulation would empty.
    #[error(
        "the valve fills the smallest chamber too fast for steps of {} s: dead_m3 must be at least {least_m3:e}",
        MAX_STEP_S
    )]
    Stiff {
        /// Smallest dead volume that is stable, m³.
        least_m3: f64,
    },
    /// Parameters of a berry.
    #[error(
        "berry {berry} needs a size, a mass, stiffness, friction and forces above 0, and must fit between open fingers"
    )]
    Berry {
        /// Index of the berry, from 0.
        berry: usize,
    },
}

/// State of the berry that the pads are over.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Over {
    berry: usize,
    /// True if it fitted between the fingers when they came over it.
    fits: bool,
    /// Position along the pads, positive towards the bush, m.
    offset_m: f64,
    /// True while the fingers touch it.
    touched: bool,
}

/// Gripper, bush and tray with their state.
#[derive(Clone, Debug, PartialEq)]
pub struct BerryPicker {
    supply: AirSupply,
    valve: CoilValve,
    cylinder: Cylinder,
    fingers: Fingers,
    axes: ToolAxes,
    berries: Vec<Berry>,
    fates: Vec<Fate>,
    receiver: Chamber,
    compressor_runs: bool,
    /// Chambers of the closing and of the opening side.
    chambers: [Chamber; 2],
    /// True while the valve feeds the closing side, and the time for which the coil has asked for the other position,
    /// s.
    is_switched: bool,
    asked_s: f64,
    travel_m: f64,
    speed_m_s: f64,
    squeeze_n: f64,
    over: Option<Over>,
    tool_m: [f64; 2],
    trigger: bool,
}

impl BerryPicker {
    /// A gripper with open fingers, a full receiver, and a bush.
    ///
    /// # Errors
    /// [`BerryError`] names the part whose parameters are out of range.
    pub fn new(
        supply: AirSupply,
        valve: CoilValve,
        cylinder: Cylinder,
        fingers: Fingers,
        axes: ToolAxes,
        berries: Vec<Berry>,
    ) -> Result<Self, BerryError> {
        let positive = |values: &[f64]| values.iter().all(|value| value.is_finite() && *value > 0.0);
        let not_negative = |values: &[f64]| values.iter().all(|value| value.is_finite() && *value >= 0.0);
        let [low_pa, high_pa] = supply.runs_between_pa;
        if !positive(&[supply.receiver_m3, supply.compressor_m3_s, supply.regulated_pa, low_pa, high_pa - low_pa]) {
            return Err(BerryError::Supply);
        }
        let flows = [valve.inlet, valve.exhaust];
        if !flows.iter().all(|flow| positive(&[flow.conductance_m3_s_pa]) && (0.0..1.0).contains(&flow.critical_ratio))
            || !not_negative(&valve.delay_s)
        {
            return Err(BerryError::Valve);
        }
        let Cylinder { bore_m, rod_m, stroke_m, dead_m3, mass_kg, .. } = cylinder;
        if !positive(&[bore_m, rod_m, bore_m - rod_m, stroke_m, dead_m3, mass_kg])
            || !not_negative(&[cylinder.coulomb_n, cylinder.viscous_n_s_per_m, cylinder.cushion_n_s_per_m])
        {
            return Err(BerryError::Cylinder);
        }
        let closed_m = fingers.open_gap_m - fingers.gap_ratio * stroke_m;
        if !positive(&[closed_m, fingers.gap_ratio, fingers.stiffness_n_per_m, fingers.pad_m])
            || !not_negative(&[fingers.bending_n_per_m])
        {
            return Err(BerryError::Fingers);
        }
        // explicit steps are stable up to a chamber's relaxation time, which is proportional to its volume
        let of_a_cubic_metre = |flow: &Restriction| flow.relaxation_per_s(1.0, CHAMBER_EXPONENT);
        let least_m3 = flows.iter().map(of_a_cubic_metre).fold(0.0, f64::max) * MAX_STEP_S;
        if dead_m3 < least_m3 {
            return Err(BerryError::Stiff { least_m3 });
        }
        for (number, berry) in berries.iter().enumerate() {
            let Berry { diameter_m, mass_kg, stiffness_n_per_m, friction, stalk_n_per_m, detach_n, crush_n, .. } =
                *berry;
            let values = [diameter_m, mass_kg, stiffness_n_per_m, friction, stalk_n_per_m, detach_n, crush_n];
            if !positive(&values)
                || diameter_m >= fingers.open_gap_m
                || !berry.place_m.iter().all(|place| place.is_finite())
            {
                return Err(BerryError::Berry { berry: number });
            }
        }
        let mut receiver = Chamber::at_rest(supply.receiver_m3, 1.0);
        receiver.pressure_pa += high_pa;
        let [_, open_m2] = cylinder.areas_m2();
        let mut open = Chamber::at_rest(dead_m3 + open_m2 * stroke_m, CHAMBER_EXPONENT);
        open.pressure_pa += supply.regulated_pa.min(high_pa);
        let hanging = Fate { place: Place::Hanging, is_crushed: false, squeeze_max_n: 0.0, released_m_s: 0.0 };
        Ok(Self {
            supply,
            valve,
            cylinder,
            fingers,
            axes,
            fates: vec![hanging; berries.len()],
            berries,
            receiver,
            compressor_runs: false,
            chambers: [Chamber::at_rest(dead_m3, CHAMBER_EXPONENT), open],
            is_switched: false,
            asked_s: 0.0,
            travel_m: 0.0,
            speed_m_s: 0.0,
            squeeze_n: 0.0,
            over: None,
            tool_m: [0.0; 2],
            trigger: false,
        })
    }

    /// Parameters of the air supply.
    #[must_use]
    pub fn supply(&self) -> &AirSupply {
        &self.supply
    }

    /// Parameters of the valve.
    #[must_use]
    pub fn valve(&self) -> &CoilValve {
        &self.valve
    }

    /// Parameters of the cylinder.
    #[must_use]
    pub fn cylinder(&self) -> &Cylinder {
        &self.cylinder
    }

    /// Parameters of the fingers.
    #[must_use]
    pub fn fingers(&self) -> &Fingers {
        &self.fingers
    }

    /// Parameters of the axes.
    #[must_use]
    pub fn axes(&self) -> &ToolAxes {
        &self.axes
    }

    /// Berries, in the order of the bush.
    #[must_use]
    pub fn berries(&self) -> &[Berry] {
        &self.berries
    }

    /// Outcome for each of [`BerryPicker::berries`], in the same order.
    #[must_use]
    pub fn fates(&self) -> &[Fate] {
        &self.fates
    }

    /// Sets the microswitch in the handle, which the user of the tool presses.
    pub fn press(&mut self, is_pressed: bool) {
        self.trigger = is_pressed;
    }

    /// Gap between the pads without an object, m.
    #[must_use]
    pub fn gap_m(&self) -> f64 {
        self.fingers.open_gap_m - self.fingers.gap_ratio * self.travel_m
    }

    /// Squeeze force between the fingers, N.
    #[must_use]
    pub fn squeeze_n(&self) -> f64 {
        self.squeeze_n
    }

    /// Travel of the rod, m; 0 with the fingers open.
    #[must_use]
    pub fn travel_m(&self) -> f64 {
        self.travel_m
    }

    /// Reach and row of the fingers, m.
    #[must_use]
    pub fn tool_m(&self) -> [f64; 2] {
        self.tool_m
    }

    /// Gauge pressures of the closing and the opening chamber, Pa.
    #[must_use]
    pub fn pressures_pa(&self) -> [f64; 2] {
        self.chambers.map(|chamber| chamber.gauge_pa())
    }

    /// Gauge pressure of the receiver, Pa.
    #[must_use]
    pub fn receiver_pa(&self) -> f64 {
        self.receiver.gauge_pa()
    }

    /// Pneumatic force on the piston, N, positive towards closed fingers.
    #[must_use]
    pub fn air_n(&self) -> f64 {
        let [close_m2, open_m2] = self.cylinder.areas_m2();
        let [close_pa, open_pa] = self.pressures_pa();
        close_pa * close_m2 - open_pa * open_m2
    }

    fn switch(&mut self, is_on: bool, step_s: f64) {
        if is_on == self.is_switched {
            self.asked_s = 0.0;
            return;
        }
        self.asked_s += step_s;
        if self.asked_s >= self.valve.delay_s[usize::from(!is_on)] {
            self.is_switched = is_on;
            self.asked_s = 0.0;
        }
    }

    fn air(&mut self, step_s: f64) {
        let [low_pa, high_pa] = self.supply.runs_between_pa;
        let receiver_pa = self.receiver.gauge_pa();
        // two-point control: once started, the compressor runs up to the upper pressure
        self.compressor_runs = receiver_pa < if self.compressor_runs { high_pa } else { low_pa };
        let delivered_kg_s = if self.compressor_runs { self.supply.compressor_m3_s * REFERENCE_KG_M3 } else { 0.0 };
        let source_pa = (self.supply.regulated_pa + ATMOSPHERE_PA).min(self.receiver.pressure_pa);
        let [close_m2, open_m2] = self.cylinder.areas_m2();
        let volumes_m3 = [
            self.cylinder.dead_m3 + close_m2 * self.travel_m,
            self.cylinder.dead_m3 + open_m2 * (self.cylinder.stroke_m - self.travel_m),
        ];
        let mut taken_kg_s = 0.0;
        for (side, chamber) in self.chambers.iter_mut().enumerate() {
            let is_fed = (side == 0) == self.is_switched;
            let flow_kg_s = if is_fed {
                let flow_kg_s = self.valve.inlet.flow_kg_s(source_pa, chamber.pressure_pa);
                taken_kg_s += flow_kg_s;
                flow_kg_s
            } else {
                -self.valve.exhaust.flow_kg_s(chamber.pressure_pa, ATMOSPHERE_PA)
            };
            chamber.step(flow_kg_s, volumes_m3[side], step_s);
        }
        // a regulator without relief passes no air back to the receiver
        self.receiver.step(delivered_kg_s - taken_kg_s.max(0.0), self.supply.receiver_m3, step_s);
    }

    fn rod(&mut self, step_s: f64) {
        let Cylinder { stroke_m, mass_kg, coulomb_n, viscous_n_s_per_m, cushion_n_s_per_m, .. } = self.cylinder;
        let fingers = &self.fingers;
        let driven_n = self.air_n() - fingers.bending_n_per_m * self.travel_m - fingers.gap_ratio * self.squeeze_n;
        let to_end_m = self.travel_m.min(stroke_m - self.travel_m);
        let damping = viscous_n_s_per_m + if to_end_m < Cylinder::CUSHION_M { cushion_n_s_per_m } else { 0.0 };
        // friction and damping are implicit, so they never reverse the rod's motion
        let pushed_m_s = self.speed_m_s + driven_n / mass_kg * step_s;
        let slid_m_s = (pushed_m_s.abs() - coulomb_n / mass_kg * step_s).max(0.0);
        let slowed_m_s = slid_m_s / (1.0 + damping / mass_kg * step_s);
        self.speed_m_s = slowed_m_s.copysign(pushed_m_s);
        self.travel_m += self.speed_m_s * step_s;
        if !(0.0..=stroke_m).contains(&self.travel_m) {
            self.travel_m = self.travel_m.clamp(0.0, stroke_m);
            self.speed_m_s = 0.0;
        }
    }

    /// Finds the berry that the pads come over, and records if it fits between the fingers.
    fn come_over(&mut self) {
        let [reach_m, row_m] = self.tool_m;
        if let Some(over) = self.over {
            let is_held = self.fates[over.berry].place == Place::Held;
            let left = (self.berries[over.berry].place_m[0] - reach_m).abs() > self.fingers.pad_m;
            if is_held || over.touched || !left {
                return;
            }
            self.over = None;
        }
        let half_m = 0.5 * self.fingers.open_gap_m;
        let gap_m = self.gap_m();
        let near = |(number, berry): (usize, &Berry)| {
            let aside_m = (berry.place_m[1] - row_m).abs();
            let touches = (berry.place_m[0] - reach_m).abs() <= self.fingers.pad_m && aside_m < half_m;
            let is_there = touches && self.fates[number].place == Place::Hanging;
            is_there.then_some((number, aside_m))
        };
        let nearest = self.berries.iter().enumerate().filter_map(near).min_by(|a, b| a.1.total_cmp(&b.1));
        if let Some((berry, aside_m)) = nearest {
            let Berry { place_m, diameter_m, .. } = self.berries[berry];
            let fits = aside_m + 0.5 * diameter_m <= 0.5 * gap_m;
            self.over = Some(Over { berry, fits, offset_m: place_m[0] - reach_m, touched: false });
        }
    }

    fn hold(&mut self, speed_m_s: f64) {
        self.squeeze_n = 0.0;
        let Some(mut over) = self.over.filter(|over| over.fits) else { return };
        let berry = self.berries[over.berry];
        let [reach_m, _] = self.tool_m;
        let squashed_m = berry.diameter_m - self.gap_m();
        let stiffness = 1.0 / (1.0 / self.fingers.stiffness_n_per_m + 1.0 / berry.stiffness_n_per_m);
        self.squeeze_n = (stiffness * squashed_m).max(0.0);
        let fate = &mut self.fates[over.berry];
        fate.squeeze_max_n = fate.squeeze_max_n.max(self.squeeze_n);
        fate.is_crushed |= self.squeeze_n > berry.crush_n;
        let is_touched = squashed_m > 0.0;
        if is_touched && !over.touched {
            over.offset_m = berry.place_m[0] - reach_m;
        }
        over.touched = is_touched;
        let share = (1.0 - over.offset_m.abs() / (2.0 * self.fingers.pad_m)).max(0.0);
        let friction_n = 2.0 * berry.friction * self.squeeze_n * share;
        match fate.place {
            Place::Hanging if is_touched => {
                let pulled_m = berry.place_m[0] - reach_m - over.offset_m;
                let mut tension_n = berry.stalk_n_per_m * pulled_m.abs();
                if tension_n > friction_n {
                    tension_n = friction_n;
                    over.offset_m = berry.place_m[0] - reach_m - (friction_n / berry.stalk_n_per_m).copysign(pulled_m);
                }
                if over.offset_m.abs() > self.fingers.pad_m {
                    // outside the pads: the berry swings back on its stalk
                    self.squeeze_n = 0.0;
                    over.touched = false;
                    over.fits = false;
                } else if tension_n >= berry.detach_n {
                    fate.place = Place::Held;
                }
            }
            Place::Held if friction_n < berry.mass_kg * GRAVITY_M_S2 => {
                fate.place = if reach_m <= self.axes.tray_m { Place::Tray } else { Place::Ground };
                fate.released_m_s = speed_m_s;
                self.squeeze_n = 0.0;
                self.over = None;
                return;
            }
            _ => {}
        }
        self.over = Some(over);
    }
}

impl Body for BerryPicker {
    fn shafts(&self) -> usize {
        3
    }

    fn step(&mut self, _scene: &mut Scene, _time_s: f64, shafts: &[ShaftMotion], loads: &mut [f64], step_s: f64) {
        loads.fill(0.0);
        let motion = |shaft: usize| shafts.get(shaft).copied().unwrap_or_default();
        let axes = self.axes.shafts.map(motion);
        self.tool_m = axes.map(|axis| axis.position * self.axes.m_per_rad);
        let speed_m_s = self.axes.m_per_rad * axes[0].speed.hypot(axes[1].speed);
        self.switch(motion(self.valve.shaft).position > 0.5, step_s);
        self.rod(step_s);
        self.air(step_s);
        self.come_over();
        self.hold(speed_m_s);
    }

    /// The pose of the bush, which is the origin.
    fn pose(&self) -> Pose {
        Pose::default()
    }

    /// Ignored: the bush does not move.
    fn set_pose(&mut self, _pose: Pose) {}

    fn twist(&self) -> Twist {
        Twist::default()
    }

    fn inertial(&self) -> Inertial {
        Inertial::AT_REST
    }

    fn readings(&self) -> &'static [&'static str] {
        READINGS
    }

    fn reading(&self, number: usize) -> f64 {
        match number {
            0 => self.chambers[0].gauge_pa(),
            1 => self.receiver.gauge_pa().min(self.supply.regulated_pa),
            2 => f64::from(u8::from(self.trigger)),
            3 => self.gap_m(),
            4 => self.squeeze_n,
            _ => 0.0,
        }
    }
}
