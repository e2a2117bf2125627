//! Plume of gas as filaments: puffs that the air carries and that grow, with clean air between them.
//!
//! The air is a layer of a given depth in which the gas is mixed, so the plane contains all of it. In each step every
//! filament moves by the flow, by a random velocity common to all (the meander of the centre line) and by a white one
//! of its own (relative dispersion). Its variance grows linearly. Walls stop filaments, and hide a filament from points
//! behind them: the part of its Gaussian beyond a wall is missing from the sum.
//!
//! # Source
//! Farrell, Murlis, Long, Li, Cardé, "Filament-based atmospheric dispersion model to achieve short time-scale structure of odor
//! plumes", Environmental Fluid Mechanics 2, 2002: release, advection by three scales, growth of the filaments. Ours: one layer in
//! place of the third dimension, and walls.

use std::{f64::consts::TAU, sync::Arc};

use super::{FieldError, Flow, FlowSpec, Wander};
use crate::{
    dice::Dice,
    scene::{Point, Scene, dot, minus},
};

/// Step of the filaments, s.
const STEP_S: f64 = 0.1;
/// Radius of a filament's influence in standard deviations: 0.2 % of the gas is outside.
pub(super) const REACH: f64 = 3.5;
/// Largest number of filaments in one lifetime.
const FILAMENTS_MAX: usize = 20_000;
/// Longest run of the source before time 0, s.
const BEFORE_MAX_S: f64 = 3600.0;

/// Gas source and the dispersion of its gas.
#[derive(Clone, Debug, PartialEq)]
pub struct PlumeSpec {
    /// Place of the source, m.
    pub source_m: Point,
    /// Release rate of the gas, m³/s.
    pub release_m3_s: f64,
    /// Filaments released per second, each with the same share of the gas.
    pub filaments_per_s: f64,
    /// Depth of the layer in which the gas is mixed, m.
    pub layer_m: f64,
    /// Standard deviation of a new filament, m.
    pub radius_m: f64,
    /// Growth of the variance of a filament along each axis, m²/s.
    pub growth_m2_s: f64,
    /// Growth of the variance of filaments' places about the centre line along each axis, m²/s.
    pub spread_m2_s: f64,
    /// Random velocity common to all filaments in addition to the flow's, along each axis, m/s.
    pub meander: Wander,
    /// Age at which a filament counts as mixed with the room's air and is removed, s.
    pub lifetime_s: f64,
    /// Time for which the source runs before time 0, s.
    pub running_s: f64,
    /// Seed of all random numbers.
    pub seed: u64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Filament {
    place_m: Point,
    variance_m2: f64,
    born: u64,
}

/// Mass balance of the gas, m³ at the release.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Balance {
    /// Gas released so far, m³.
    pub released_m3: f64,
    /// Gas inside the domain, m³.
    pub inside_m3: f64,
    /// Gas that left through outlets, m³.
    pub left_m3: f64,
    /// Gas removed at the end of the filaments' lifetime, m³.
    pub faded_m3: f64,
}

/// Concentration of a gas in the air, ppm.
#[derive(Clone, Debug, PartialEq)]
pub struct Plume {
    spec: PlumeSpec,
    flow: Arc<Flow>,
    dice: Dice,
    steps: u64,
    filaments: Vec<Filament>,
    meander_m_s: Point,
    released: u64,
    left: u64,
    faded: u64,
}

impl Plume {
    /// The plume at time 0, in a flow computed around the walls and posts of the scene.
    ///
    /// # Errors
    /// [`FieldError`] names the parameter that is out of range.
    pub fn new(spec: PlumeSpec, flow: &FlowSpec, scene: &Scene) -> Result<Self, FieldError> {
        Self::in_flow(spec, Arc::new(Flow::new(flow, scene)?))
    }

    /// The plume at time 0 with changed parameters, in the same flow.
    ///
    /// # Errors
    /// As [`Plume::new`].
    pub fn changed(&self, change: impl FnOnce(&mut PlumeSpec)) -> Result<Self, FieldError> {
        let mut spec = self.spec.clone();
        change(&mut spec);
        Self::in_flow(spec, self.flow.clone())
    }

    fn in_flow(spec: PlumeSpec, flow: Arc<Flow>) -> Result<Self, FieldError> {
        let positive = [
            ("release_m3_s", spec.release_m3_s),
            ("filaments_per_s", spec.filaments_per_s),
            ("layer_m", spec.layer_m),
            ("radius_m", spec.radius_m),
            ("lifetime_s", spec.lifetime_s),
        ];
        let number = |what, rule| FieldError::Number { what, rule };
        if let Some((what, _)) = positive.into_iter().find(|(_, value)| !(*value > 0.0 && value.is_finite())) {
            return Err(number(what, "must be above 0 and finite"));
        }
        let not_negative = [("growth_m2_s", spec.growth_m2_s), ("spread_m2_s", spec.spread_m2_s)];
        if let Some((what, _)) = not_negative.into_iter().find(|(_, value)| !(*value >= 0.0 && value.is_finite())) {
            return Err(number(what, "must be 0 or above and finite"));
        }
        if !(0.0..=BEFORE_MAX_S).contains(&spec.running_s) {
            return Err(number("running_s", "must be 0 to 3600"));
        }
        if !spec.meander.is_valid(STEP_S) {
            return Err(number("meander", "needs a deviation of 0 or above and `tau_s` of 0.5 or more"));
        }
        if !flow.is_wet(spec.source_m) {
            return Err(FieldError::Source(spec.source_m));
        }
        let filaments = spec.filaments_per_s * spec.lifetime_s;
        if filaments > FILAMENTS_MAX as f64 {
            return Err(FieldError::TooMany { filaments, most: FILAMENTS_MAX });
        }
        let mut dice = Dice::new(spec.seed);
        let meander_m_s = [0; 2].map(|_| spec.meander.first(&mut dice));
        let (steps, released, left, faded) = (0, 0, 0, 0);
        Ok(Self { spec, flow, dice, steps, filaments: Vec::new(), meander_m_s, released, left, faded })
    }

    /// Parameters of the plume.
    #[must_use]
    pub const fn spec(&self) -> &PlumeSpec {
        &self.spec
    }

    /// Air flow that carries the gas.
    #[must_use]
    pub fn flow(&self) -> &Flow {
        &self.flow
    }

    /// Mass balance of the gas at the last step.
    #[must_use]
    pub fn balance(&self) -> Balance {
        let share_m3 = self.spec.release_m3_s / self.spec.filaments_per_s;
        Balance {
            released_m3: self.released as f64 * share_m3,
            inside_m3: self.filaments.len() as f64 * share_m3,
            left_m3: self.left as f64 * share_m3,
            faded_m3: self.faded as f64 * share_m3,
        }
    }

    /// Concentration at the last step up to a time, s, in ppm.
    pub(super) fn value(&mut self, time_s: f64, point: Point) -> f64 {
        while (self.steps + 1) as f64 * STEP_S <= time_s + self.spec.running_s {
            self.step();
        }
        let share_m3 = self.spec.release_m3_s / self.spec.filaments_per_s;
        let reach = REACH * REACH;
        let seen = self.filaments.iter().filter_map(|filament| {
            let way = minus(point, filament.place_m);
            let squared = dot(way, way) / filament.variance_m2;
            let is_near = squared < reach && self.flow.sees(filament.place_m, point);
            is_near.then(|| libm::exp(-0.5 * squared) / filament.variance_m2)
        });
        1e6 * share_m3 / (TAU * self.spec.layer_m) * seen.sum::<f64>()
    }

    /// Place, m, and variance, m², of the oldest filament.
    #[cfg(test)]
    pub(super) fn oldest(&self) -> Option<(Point, f64)> {
        self.filaments.first().map(|filament| (filament.place_m, filament.variance_m2))
    }

    fn step(&mut self) {
        let Self { spec, flow, dice, .. } = self;
        let oldest = (spec.lifetime_s / STEP_S) as u64;
        let jump_m = (spec.spread_m2_s * STEP_S).sqrt();
        for velocity in &mut self.meander_m_s {
            *velocity = spec.meander.next(*velocity, STEP_S, dice);
        }
        let (meander_m_s, now) = (self.meander_m_s, self.steps);
        self.filaments.retain_mut(|filament| {
            let air_m_s = flow.velocity_m_s(filament.place_m);
            let way = [0, 1].map(|axis| (air_m_s[axis] + meander_m_s[axis]) * STEP_S + jump_m * dice.normal());
            filament.variance_m2 += spec.growth_m2_s * STEP_S;
            let moved = flow.moved(filament.place_m, way);
            filament.place_m = moved.unwrap_or(filament.place_m);
            let is_old = now - filament.born >= oldest;
            self.left += u64::from(moved.is_none());
            self.faded += u64::from(moved.is_some() && is_old);
            moved.is_some() && !is_old
        });
        self.steps += 1;
        let due = (self.steps as f64 * STEP_S * spec.filaments_per_s) as u64;
        while self.released < due {
            let variance_m2 = spec.radius_m * spec.radius_m;
            self.filaments.push(Filament { place_m: spec.source_m, variance_m2, born: now });
            self.released += 1;
        }
    }
}
