//! Soft strip with a suction cup at each end and three inflatable membranes that push the cups apart.
//!
//! Each membrane is fed by a line: a syringe on a stepper's lead screw, a tube, and a 3/2 valve on a relay. Without
//! current the valve vents the line; with current it closes it, or connects it to a supply if there is one. Inflated
//! membranes lengthen the strip, which shears the rims of the cups; beyond a tangential strain a rim leaks, its suction
//! decays and the cup comes off.
//!
//! Quasi-static except for the gas and the membranes' viscosity: no mass, no bending, no curvature of the tissue, which
//! is a plane.

mod membrane;

pub use membrane::{LIMIT_STRETCH, Membrane, MembraneState};

use core::f64::consts::{PI, TAU};

use crate::{
    body::{Body, Inertial, Pose, ShaftMotion, Twist},
    pneumatic::{ATMOSPHERE_PA, Chamber, Restriction},
    scene::Scene,
};

/// Number of membranes: outer, middle, outer.
pub const MEMBRANES: usize = 3;
/// Index of the middle membrane.
pub const MIDDLE: usize = 1;

/// Supply line of a membrane.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Line {
    /// Shaft number of the stepper, whose positive angle pushes the plunger in.
    pub stepper: usize,
    /// Shaft number of the valve's relay.
    pub valve: usize,
    /// Travel of the plunger per turn, m.
    pub lead_m: f64,
    /// Cross-section of the syringe, m².
    pub bore_m2: f64,
    /// Volume of the syringe with the stepper at 0, m³.
    pub syringe_m3: f64,
    /// Volume of tube, valve and sensor, m³.
    pub dead_m3: f64,
    /// Flow path from the line to the membrane.
    pub tube: Restriction,
    /// Flow path through the valve, to the supply or to the atmosphere.
    pub orifice: Restriction,
    /// Leak from the membrane to the atmosphere; a sonic conductance of 0 for a tight one.
    pub leak: Restriction,
}

/// Suction cup at an end of the strip.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cup {
    /// Radius of the rim, m.
    pub radius_m: f64,
    /// Suction (pressure below atmosphere) directly after the cup was pressed on, Pa.
    pub suction_pa: f64,
    /// Tangential force per displacement of the rim, N/m.
    pub stiffness_n_m: f64,
    /// Tangential strain (displacement over radius) beyond which the rim leaks.
    pub leak_strain: f64,
    /// Decay rate of the suction at that strain, 1/s; proportional to the strain beyond it.
    pub leak_per_s: f64,
    /// Share of the tangential force that peels: the cup comes off when it exceeds suction times area.
    pub peel: f64,
}

/// Strip between the two cups.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Strip {
    /// Axial stiffness between the ends, N/m.
    pub stiffness_n_m: f64,
    /// Elongation per growth of the middle membrane's radius, m/m.
    pub middle: f64,
    /// Elongation per growth of an outer membrane's radius, m/m.
    pub outer: f64,
    /// Additional displacement of the near cup's rim per growth of an outer membrane's radius, m/m.
    pub near: f64,
}

/// Pad of strip, cups, membranes and their lines.
#[derive(Clone, Debug, PartialEq)]
pub struct SuctionPad {
    strip: Strip,
    cups: [Cup; 2],
    membranes: [Membrane; MEMBRANES],
    lines: [Line; MEMBRANES],
    supply_pa: Option<f64>,
    state: SuctionState,
}

/// State of a pad, as of its last step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SuctionState {
    /// Gas in syringe and tube of each line.
    pub line: [Chamber; MEMBRANES],
    /// Gas inside each membrane.
    pub balloon: [Chamber; MEMBRANES],
    /// State of each membrane.
    pub membrane: [MembraneState; MEMBRANES],
    /// Suction under each cup, Pa.
    pub suction_pa: [f64; 2],
    /// True for each cup that is attached to the tissue.
    pub is_attached: [bool; 2],
    /// Tangential strain of each rim: displacement over radius.
    pub rim_strain: [f64; 2],
    /// Tangential force on each cup, N.
    pub shear_n: [f64; 2],
}

/// Reasons why a pad cannot be simulated.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SuctionError {
    /// Parameters of a membrane.
    #[error(
        "needs a radius, thickness, modulus, viscosity and time above 0, shares from 0 to below 1, a burst beyond a stretch of 1.5, \
         and stiffening beyond the burst"
    )]
    Membrane {
        /// Index of the membrane.
        membrane: usize,
    },
    /// A membrane whose viscosity is too small for the longest step.
    #[error("the viscosity is too small to be stepped every 0.25 ms: increase viscosity_pa_s")]
    Stiff {
        /// Index of the membrane.
        membrane: usize,
    },
    /// Parameters of a line.
    #[error(
        "needs volumes, bore, lead and conductances above 0 (a leak may be 0), and critical ratios from 0 to below 1"
    )]
    Line {
        /// Index of the line.
        line: usize,
    },
    /// A line whose tube passes more in 0.25 ms than its volumes hold.
    #[error("the tube or valve is too wide for its volumes to be stepped every 0.25 ms: reduce conductance_m3_s_pa")]
    Wide {
        /// Index of the line.
        line: usize,
    },
    /// Parameters of a cup.
    #[error("needs a radius, suction, stiffness, strain and rate above 0, and a peeling share from 0 to 1")]
    Cup {
        /// Index of the cup.
        cup: usize,
    },
    /// Parameters of the strip.
    #[error("needs a stiffness above 0 and elongations of at least 0")]
    Strip,
    /// Pressure of the supply.
    #[error("needs a pressure from 0 to 1 MPa above that of the atmosphere")]
    Supply,
}

impl SuctionPad {
    /// A pad on the tissue, with both cups pressed on and all lines at atmospheric pressure. `supply_pa` is the gauge
    /// pressure of the regulator; `None` if the valves' supply ports are plugged.
    ///
    /// # Errors
    /// [`SuctionError`] names the part whose parameters are out of range.
    pub fn new(
        strip: Strip,
        cups: [Cup; 2],
        membranes: [Membrane; MEMBRANES],
        lines: [Line; MEMBRANES],
        supply_pa: Option<f64>,
    ) -> Result<Self, SuctionError> {
        let is_above = |values: &[f64]| values.iter().all(|value| value.is_finite() && *value > 0.0);
        let is_share = |value: f64| (0.0..1.0).contains(&value);
        if !is_above(&[strip.stiffness_n_m])
            || ![strip.middle, strip.outer, strip.near].iter().all(|value| value.is_finite() && *value >= 0.0)
        {
            return Err(SuctionError::Strip);
        }
        if !supply_pa.is_none_or(|pa| (0.0..=1e6).contains(&pa)) {
            return Err(SuctionError::Supply);
        }
        for (number, cup) in cups.iter().enumerate() {
            let Cup { radius_m, suction_pa, stiffness_n_m, leak_strain, leak_per_s, peel } = *cup;
            if !is_above(&[radius_m, suction_pa, stiffness_n_m, leak_strain, leak_per_s])
                || !(0.0..=1.0).contains(&peel)
            {
                return Err(SuctionError::Cup { cup: number });
            }
        }
        for (number, (membrane, line)) in membranes.iter().zip(&lines).enumerate() {
            let Membrane { radius_m, thickness_m, shear_pa, stiffening, viscosity_pa_s, burst_stretch, .. } = *membrane;
            if !is_above(&[radius_m, thickness_m, shear_pa, stiffening, viscosity_pa_s, membrane.relaxing_s])
                || !is_share(membrane.softening)
                || !is_share(membrane.relaxing)
                || burst_stretch.is_nan()
                || burst_stretch <= 1.5
                || 2.0 * burst_stretch * burst_stretch >= stiffening
            {
                return Err(SuctionError::Membrane { membrane: number });
            }
            // stiffness over stretch: the membrane's at rest, `6 * 2 mu t/r`, and that of its gas, `3 p`
            let stiffness_pa = 12.0 * shear_pa * thickness_m / radius_m + 6.0 * ATMOSPHERE_PA;
            if viscosity_pa_s < stiffness_pa * crate::MAX_STEP_S {
                return Err(SuctionError::Stiff { membrane: number });
            }
            let is_flow = |flow: &Restriction, least: f64| {
                flow.conductance_m3_s_pa.is_finite()
                    && flow.conductance_m3_s_pa >= least
                    && is_share(flow.critical_ratio)
            };
            if !is_above(&[line.lead_m, line.bore_m2, line.syringe_m3, line.dead_m3])
                || !is_flow(&line.tube, 1e-16)
                || !is_flow(&line.orifice, 1e-16)
                || !is_flow(&line.leak, 0.0)
            {
                return Err(SuctionError::Line { line: number });
            }
            let relaxes =
                |flow: &Restriction, volume_m3: f64| flow.relaxation_per_s(volume_m3, 1.0) * crate::MAX_STEP_S;
            let balloon_m3 = membrane.volume_m3(0.9);
            if relaxes(&line.tube, balloon_m3)
                + relaxes(&line.tube, line.dead_m3)
                + relaxes(&line.orifice, line.dead_m3)
                >= 1.0
            {
                return Err(SuctionError::Wide { line: number });
            }
        }
        let state = SuctionState {
            line: lines.map(|line| Chamber::at_rest(line.dead_m3 + line.syringe_m3, 1.0)),
            balloon: membranes.map(|membrane| Chamber::at_rest(membrane.volume_m3(1.0), 1.0)),
            membrane: [MembraneState::default(); MEMBRANES],
            suction_pa: cups.map(|cup| cup.suction_pa),
            is_attached: [true; 2],
            rim_strain: [0.0; 2],
            shear_n: [0.0; 2],
        };
        Ok(Self { strip, cups, membranes, lines, supply_pa, state })
    }

    /// The same pad in air, with both cups detached.
    #[must_use]
    pub fn in_air(mut self) -> Self {
        self.state.is_attached = [false; 2];
        self.state.suction_pa = [0.0; 2];
        self
    }

    /// Parameters of the strip.
    #[must_use]
    pub const fn strip(&self) -> &Strip {
        &self.strip
    }

    /// Parameters of both cups.
    #[must_use]
    pub const fn cups(&self) -> &[Cup; 2] {
        &self.cups
    }

    /// Parameters of the membranes: outer, middle, outer.
    #[must_use]
    pub const fn membranes(&self) -> &[Membrane; MEMBRANES] {
        &self.membranes
    }

    /// Parameters of the membranes' lines.
    #[must_use]
    pub const fn lines(&self) -> &[Line; MEMBRANES] {
        &self.lines
    }

    /// State of the pad as of the last step.
    #[must_use]
    pub const fn state(&self) -> &SuctionState {
        &self.state
    }

    /// Normal force that a cup withstands, N: `dp A`; 0 for a detached cup.
    #[must_use]
    pub fn adhesion_n(&self, cup: usize) -> f64 {
        let Cup { radius_m, .. } = self.cups[cup];
        if self.state.is_attached[cup] { self.state.suction_pa[cup] * PI * radius_m * radius_m } else { 0.0 }
    }

    /// Pressure of the strip on each membrane, Pa. Updates strain and force of each rim.
    fn push(&mut self) -> [f64; MEMBRANES] {
        let Strip { stiffness_n_m, middle, outer, near } = self.strip;
        let state = &mut self.state;
        let grown_m: [f64; MEMBRANES] =
            std::array::from_fn(|number| self.membranes[number].radius_m * (state.membrane[number].stretch - 1.0));
        // a strip with a free end lengthens without force
        let between_n = if state.is_attached == [true; 2] {
            let longer_m = middle * grown_m[MIDDLE] + outer * (grown_m[0] + grown_m[2]);
            let compliance = 1.0 / stiffness_n_m + 1.0 / self.cups[0].stiffness_n_m + 1.0 / self.cups[1].stiffness_n_m;
            longer_m / compliance
        } else {
            0.0
        };
        // radial force, N: derivative of the elastic energy by the radius
        let mut radial_n = [outer * between_n, middle * between_n, outer * between_n];
        for (number, (cup, membrane)) in self.cups.iter().zip([0, 2]).enumerate() {
            let near_m = near * grown_m[membrane];
            let is_attached = state.is_attached[number];
            let near_n = if is_attached { cup.stiffness_n_m * near_m } else { 0.0 };
            radial_n[membrane] += near * near_n;
            state.shear_n[number] = between_n + near_n;
            let moved_m = between_n / cup.stiffness_n_m + near_m;
            state.rim_strain[number] = if is_attached { moved_m.abs() / cup.radius_m } else { 0.0 };
        }
        std::array::from_fn(|number| {
            let radius_m = self.membranes[number].radius_m * state.membrane[number].stretch;
            radial_n[number] / (4.0 * PI * radius_m * radius_m)
        })
    }

    fn step_cups(&mut self, step_s: f64) {
        let state = &mut self.state;
        for (number, cup) in self.cups.iter().enumerate() {
            if !state.is_attached[number] {
                continue;
            }
            let over = state.rim_strain[number] / cup.leak_strain;
            if over > 1.0 {
                state.suction_pa[number] *= 1.0 - (cup.leak_per_s * over * step_s).min(1.0);
            }
            let holds_n = state.suction_pa[number] * PI * cup.radius_m * cup.radius_m;
            if holds_n < cup.peel * state.shear_n[number].abs() {
                state.is_attached[number] = false;
                state.suction_pa[number] = 0.0;
            }
        }
    }

    fn step_line(&mut self, number: usize, shafts: &[ShaftMotion], strip_pa: f64, step_s: f64) {
        let (line, membrane) = (&self.lines[number], &self.membranes[number]);
        let state = &mut self.state;
        let at = |shaft: usize| shafts.get(shaft).map_or(0.0, |shaft| shaft.position);
        let (before, inside) = (state.line[number].pressure_pa, state.balloon[number].pressure_pa);
        let through = line.tube.flow_kg_s(before, inside);
        let outside =
            if at(line.valve) > 0.5 { self.supply_pa.map(|pa| ATMOSPHERE_PA + pa) } else { Some(ATMOSPHERE_PA) };
        let from_valve = outside.map_or(0.0, |pa| line.orifice.flow_kg_s(pa, before));
        let pushed_m3 = at(line.stepper) / TAU * line.lead_m * line.bore_m2;
        // the plunger stops at the bottom of the syringe
        let syringe_m3 = (line.syringe_m3 - pushed_m3).max(0.0);
        state.line[number].step(from_valve - through, line.dead_m3 + syringe_m3, step_s);
        let gauge_pa = state.balloon[number].gauge_pa();
        membrane.step(&mut state.membrane[number], gauge_pa, strip_pa, step_s);
        if state.membrane[number].is_burst {
            state.balloon[number].pressure_pa = ATMOSPHERE_PA;
            return;
        }
        let lost = line.leak.flow_kg_s(inside, ATMOSPHERE_PA);
        let volume_m3 = membrane.volume_m3(state.membrane[number].stretch);
        state.balloon[number].step(through - lost, volume_m3, step_s);
    }
}

impl Body for SuctionPad {
    fn shafts(&self) -> usize {
        self.lines.iter().flat_map(|line| [line.stepper, line.valve]).max().map_or(0, |most| most + 1)
    }

    fn step(&mut self, _scene: &mut Scene, _time_s: f64, shafts: &[ShaftMotion], loads: &mut [f64], step_s: f64) {
        let strip_pa = self.push();
        self.step_cups(step_s);
        for (number, strip_pa) in strip_pa.into_iter().enumerate() {
            self.step_line(number, shafts, strip_pa, step_s);
        }
        loads.fill(0.0);
    }

    /// The pad does not move.
    fn pose(&self) -> Pose {
        Pose::default()
    }

    fn set_pose(&mut self, _pose: Pose) {}

    fn twist(&self) -> Twist {
        Twist::default()
    }

    fn inertial(&self) -> Inertial {
        Inertial::AT_REST
    }

    fn readings(&self) -> &'static [&'static str] {
        &["pressure_0_pa", "pressure_1_pa", "pressure_2_pa"]
    }

    fn reading(&self, number: usize) -> f64 {
        self.state.line.get(number).map_or(0.0, Chamber::gauge_pa)
    }
}

#[cfg(test)]
mod tests;
