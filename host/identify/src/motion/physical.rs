//! From numbers per unit of inertia to those of plant files and reports, and to the push that a residual lacks.

use std::{collections::BTreeMap, f64::consts::TAU, fmt::Write};

use r4_plants::{
    DcGearMotor, Dependence, Effect as Listed, EffectInfo, Fitted, InsertionPoint, LinearActuator, Model, PlantKind,
    PlantSpec, Table,
    effect::table::{On, Over},
};

use crate::{
    family::{Acts, Family, Structure, Term},
    report::Estimate,
};

use super::{
    ASSUMED_V, Kind, Motion, MotionRun,
    effect::{Effect, INPUT_LATE, VISCOUS_SHARE},
    smooth::Parabola,
    through,
};

/// A winding whose resistance nobody told, ohm.
const ASSUMED_OHM: f64 = 1.0;
/// The drive of an axis is a source of force: a winding whose back-EMF damps by this share of what the axis is damped by, which is taken
/// off its viscous friction.
const BACK_EMF_SHARE: f64 = 1e-3;
/// Of that winding, least and most, ohm: well within what plant files may have.
const FORCE_SOURCE_OHM: [f64; 2] = [1e-3, 1e2];

/// Smallest inertia and mass of a plant file. A recording in which the output follows the voltage at once fits any smaller one as well;
/// forces do not change with it.
const LIGHTEST_KG_M2: f64 = 1e-9;
const LIGHTEST_KG: f64 = 1e-6;

/// What plant files speak of.
#[derive(Clone, Copy, Debug)]
pub(super) struct Physical {
    /// kg m² or kg, at the output.
    pub(super) inertia: f64,
    /// N m/A or N/A at the output, and V s/rad or V s/m.
    constant: f64,
    resistance_ohm: f64,
    viscous: f64,
}

/// Plant files have straight pieces: so many for each of a curve, which then is off by a 64th of what that bends.
const STRAIGHT: u32 = 8;

impl Motion {
    pub(super) fn physical(&self, structure: &Structure) -> Physical {
        let dynamics = self.dynamics(&structure.base);
        if self.kind == Kind::Axis {
            let inertia = structure.base[0];
            let (gain, viscous) = (self.known.gain.unwrap_or(1.0), structure.base[1]);
            let [least_ohm, most_ohm] = FORCE_SOURCE_OHM;
            // The force of 1 V at rest is constant / resistance, the damping by back-EMF constant² / resistance.
            let resistance_ohm = (BACK_EMF_SHARE * viscous / (gain * gain)).clamp(least_ohm, most_ohm);
            let constant = gain * resistance_ohm;
            let viscous = (viscous - gain * constant).max(0.0);
            return Physical { inertia, constant, resistance_ohm, viscous };
        }
        let (resistance_ohm, viscous) = match self.known.plant.as_ref().map(PlantSpec::model) {
            Some(Model::DcGearMotor(motor)) => (motor.resistance_ohm, motor.viscous_nm_s_per_rad),
            Some(Model::LinearActuator(actuator)) => (actuator.resistance_ohm, actuator.viscous_n_s_per_m),
            None => (self.known.resistance_ohm.unwrap_or(ASSUMED_OHM), 0.0),
        };
        // Steady speed per volt: c / (c² + B R). The viscous part is what an effect that tells it came to; else that of the file,
        // where it leaves a motor.
        let gain = dynamics.k / dynamics.b;
        if let Some(share) = self.viscous_share(structure) {
            let constant = (1.0 - share) / gain;
            let inertia = constant / (resistance_ohm * dynamics.k);
            return Physical { inertia, constant, resistance_ohm, viscous: share * dynamics.b * inertia };
        }
        let root = 1.0 - 4.0 * gain * gain * viscous * resistance_ohm;
        let (constant, viscous) =
            if root >= 0.0 { ((1.0 + root.sqrt()) / (2.0 * gain), viscous) } else { (1.0 / gain, 0.0) };
        Physical { inertia: constant / (resistance_ohm * dynamics.k), constant, resistance_ohm, viscous }
    }

    /// Base values of a motor as its plant file declares it: the inverse of [`Self::physical`]. `None` without such a file, and of an
    /// axis and a servo, which have numbers that no plant file tells.
    pub(super) fn declared_base(&self) -> Option<Vec<f64>> {
        let plant = self.known.plant.as_ref().filter(|_| matches!(self.kind, Kind::DcMotor | Kind::LinearActuator))?;
        let (constant, inertia, resistance_ohm, viscous) = match plant.model() {
            Model::DcGearMotor(motor) => (
                motor.torque_constant_nm_per_a * motor.gear_ratio,
                motor.inertia_kg_m2,
                motor.resistance_ohm,
                motor.viscous_nm_s_per_rad,
            ),
            Model::LinearActuator(actuator) => {
                let turns_rad_per_m = TAU / actuator.lead_m_per_rev;
                (
                    actuator.torque_constant_nm_per_a * turns_rad_per_m,
                    actuator.moving_mass_kg + actuator.rotor_inertia_kg_m2 * turns_rad_per_m.powi(2),
                    actuator.resistance_ohm,
                    actuator.viscous_n_s_per_m,
                )
            }
        };
        // Of the damping times the resistance: what the winding gives, and all.
        let (winding, friction) = (constant * constant, viscous * resistance_ohm);
        let damping = winding + friction;
        let mut base = vec![0.0; self.base.len()];
        (base[0], base[1]) = (constant / damping, inertia * resistance_ohm / damping);
        if let Some(place) = self.places.b_open {
            base[place] = friction / damping;
        }
        Some(base)
    }

    /// Share of the damping that is not back-EMF, of an effect that tells it.
    fn viscous_share(&self, structure: &Structure) -> Option<f64> {
        const TELLING: [Effect; 3] = [Effect::LoadFriction, Effect::SupplySag, Effect::WindingHeating];
        let values = TELLING.iter().find_map(|&effect| structure.of(self.index(effect)?))?;
        // A motor that is all friction would have no constant.
        values.last().map(|share| share.min(0.99))
    }

    /// What the size of torques and forces hangs on without anybody having told it.
    fn scale_is_assumed(&self) -> Option<String> {
        let known = self.kind == Kind::Axis && self.known.gain.is_some()
            || self.known.plant.is_some()
            || self.known.resistance_ohm.is_some();
        let scale = if known {
            None
        } else if self.kind == Kind::Axis {
            Some("gain_per_unit = 1".to_owned())
        } else {
            Some(format!("resistance_ohm = {ASSUMED_OHM}"))
        };
        let all: Vec<String> = scale.into_iter().chain(self.supply_is_assumed()).collect();
        (!all.is_empty()).then(|| all.join(", "))
    }

    fn supply_is_assumed(&self) -> Option<String> {
        self.supply_assumed.then(|| format!("supply_v = {ASSUMED_V}"))
    }

    /// Whether the mechanics has such a number divided by its inertia; what is compared with the command, which may be a force
    /// too, is as it is commanded.
    fn is_per_inertia(&self, name: &str, unit: &str) -> bool {
        let units = &self.scales.units;
        name != units.input_name && [units.force, units.drag, units.viscous].contains(&unit)
    }

    #[allow(clippy::type_complexity)]
    pub(super) fn in_units(
        &self,
        structure: &Structure,
        deviations: &[Option<f64>],
        intervals: &[Option<[f64; 2]>],
    ) -> (BTreeMap<String, Estimate>, Vec<BTreeMap<String, Estimate>>) {
        let physical = self.physical(structure);
        let assumed = self.scale_is_assumed();
        let mut deviations = deviations.iter().copied().chain(std::iter::repeat(None));
        let mut intervals = intervals.iter().copied().chain(std::iter::repeat(None));
        let mut told = |name: &str, unit: &str, value: f64, inertia: f64| {
            let is_force = self.is_per_inertia(name, unit);
            let scale = if is_force { inertia } else { 1.0 };
            let estimate = Estimate {
                value: value * scale,
                std: deviations.next().flatten().map(|deviation| deviation * scale),
                unit: unit.to_owned(),
                interval: intervals.next().flatten().map(|ends| ends.map(|end| end * scale)),
                assumed: match unit {
                    // An inertia is what a known force says it is.
                    _ if is_force || unit.starts_with("kg") => assumed.clone(),
                    _ if unit.ends_with("/V") => self.supply_is_assumed(),
                    _ => None,
                },
            };
            (name.to_owned(), estimate)
        };
        // The base model of an axis is in its units already.
        let of_base = if self.kind == Kind::Axis { 1.0 } else { physical.inertia };
        let base = self.base.iter().zip(&structure.base);
        let base = base.map(|(parameter, &value)| told(parameter.name, parameter.unit, value, of_base)).collect();
        let terms = structure
            .terms
            .iter()
            .zip(&structure.added)
            .map(|(term, values)| match term {
                Term::Known(index) => self.catalogue[*index]
                    .parameters
                    .iter()
                    .zip(values)
                    .map(|(parameter, &value)| told(parameter.name, parameter.unit, value, physical.inertia))
                    .collect(),
                Term::Curve(_) => {
                    values.iter().for_each(|_| drop(told("value", "1", 0.0, 1.0)));
                    BTreeMap::new()
                }
            })
            .collect();
        (base, terms)
    }

    /// The model as a plant file; what such a file cannot hold is told in a comment.
    pub(super) fn plant_file(&self, structure: &Structure, source: &str) -> String {
        let physical = self.physical(structure);
        let kind = if self.rotary { PlantKind::Rotary } else { PlantKind::Linear };
        let model = self.plant_model(&physical);
        let mut left_out = Vec::new();
        let mut effects = Vec::new();
        let mut tables = Vec::new();
        for (term, values) in structure.terms.iter().zip(&structure.added) {
            match term {
                Term::Known(index) => match self.listed(self.effects[*index], values, &physical, kind) {
                    Some(effect) => effects.push(effect),
                    None => left_out.push(self.catalogue[*index].name),
                },
                Term::Curve(curve) => {
                    let over = match curve.over {
                        Dependence::Input => Some(Over::Input),
                        Dependence::Speed => Some(Over::Speed),
                        Dependence::Position => Some(Over::Position),
                        Dependence::Time => Some(Over::Time),
                        Dependence::Supply => Some(Over::Supply),
                        Dependence::History if curve.acts == Acts::Settling => Some(Over::SinceTurn),
                        Dependence::History => Some(Over::History),
                        Dependence::Acceleration | Dependence::Direction => None,
                    };
                    let (on, scale) = match curve.acts {
                        Acts::Push => (On::Force, physical.inertia),
                        Acts::Friction | Acts::Settling => (On::Friction, physical.inertia),
                        Acts::Gain => (On::Gain, 1.0),
                        Acts::Hysteresis => (On::Hysteresis, physical.inertia),
                    };
                    let (at, values) = curve.spline(values).polyline(STRAIGHT);
                    let mut corners: Vec<(f64, f64)> =
                        at.into_iter().zip(values.into_iter().map(|value| value * scale)).collect();
                    if curve.over == Dependence::Speed && curve.acts == Acts::Friction {
                        // It is over the speed without its sign.
                        let backward: Vec<_> = corners.iter().rev().map(|&(at, value)| (-at, value)).collect();
                        corners.splice(0..0, backward);
                    }
                    let (at, values) = corners.into_iter().unzip();
                    let table = over.and_then(|over| Table::new(over, on, curve.period, at, values).ok());
                    match table {
                        Some(table) => tables.push(table),
                        None => left_out.push("a curve"),
                    }
                }
            }
        }
        let mut text = String::new();
        if let Some(assumed) = self.scale_is_assumed() {
            let _ = writeln!(text, "# Torques and forces hold for an assumed {assumed}: the data do not fix it.");
        }
        let lightest = if self.rotary { LIGHTEST_KG_M2 } else { LIGHTEST_KG };
        if physical.inertia < lightest {
            let _ = writeln!(
                text,
                "# The data do not show what moves: {:.1e} was found, and {lightest:.0e} is the least that a plant has.",
                physical.inertia
            );
        }
        // A plant's effects on the duty come after each other: what was found is before what was known.
        let is_of_input = |effect: &Listed| effect.info().insertion == InsertionPoint::Input;
        let (first, last): (Vec<_>, Vec<_>) = effects.into_iter().partition(is_of_input);
        let effects = first.into_iter().chain(self.bridge.iter().copied()).chain(last).collect();
        match PlantSpec::new(model, source, effects) {
            Ok(mut spec) => {
                tables.into_iter().for_each(|table| spec.push_table(table));
                if !left_out.is_empty() {
                    let _ = writeln!(text, "# Found, but not in this file: {}.", left_out.join(", "));
                }
                text + &spec.to_toml()
            }
            Err(error) => {
                let _ = writeln!(text, "# No plant file can hold what was found: {error}.");
                text
            }
        }
    }

    fn plant_model(&self, physical: &Physical) -> Model {
        let given = self.known.plant.as_ref().map(|plant| *plant.model());
        if self.rotary {
            let mut motor = match given {
                Some(Model::DcGearMotor(motor)) => motor,
                _ => DcGearMotor { gear_ratio: 1.0, inductance_h: 0.0, ..DcGearMotor::TYPICAL },
            };
            motor.resistance_ohm = physical.resistance_ohm;
            motor.torque_constant_nm_per_a = physical.constant / motor.gear_ratio;
            motor.inertia_kg_m2 = physical.inertia.max(LIGHTEST_KG_M2);
            motor.viscous_nm_s_per_rad = physical.viscous;
            return Model::DcGearMotor(motor);
        }
        let mut actuator = match given {
            Some(Model::LinearActuator(actuator)) => actuator,
            _ => LinearActuator {
                inductance_h: 0.0,
                efficiency: 1.0,
                rotor_inertia_kg_m2: 0.0,
                lead_m_per_rev: 0.01,
                stroke_m: self.known.stroke_m.unwrap_or(100.0),
                ..LinearActuator::TYPICAL
            },
        };
        let turns = TAU / actuator.lead_m_per_rev;
        actuator.resistance_ohm = physical.resistance_ohm;
        actuator.torque_constant_nm_per_a = physical.constant / turns;
        actuator.rotor_inertia_kg_m2 = actuator.rotor_inertia_kg_m2.min(0.5 * physical.inertia / (turns * turns));
        actuator.moving_mass_kg = (physical.inertia - actuator.rotor_inertia_kg_m2 * turns * turns).max(LIGHTEST_KG);
        actuator.viscous_n_s_per_m = physical.viscous;
        Model::LinearActuator(actuator)
    }

    /// An effect as plant files have it.
    fn listed(&self, effect: Effect, values: &[f64], physical: &Physical, kind: PlantKind) -> Option<Listed> {
        let info = EffectInfo::named(effect.name())?;
        let mut listed = info.typical;
        let candidate = effect.candidate(&self.scales, self.of_speed);
        let mut set = |name: &str, value: f64| listed.set(kind, name, value).ok();
        if effect == Effect::SupplySag {
            set("source_ohm", values[0] * physical.resistance_ohm)?;
        } else if effect == Effect::WindingHeating {
            // Full duty at rest is what a share of one stands for.
            let supply_v = self.known.supply_v.unwrap_or(ASSUMED_V);
            let power_w = (through(&self.bridge, self.scales.input) * supply_v).powi(2) / physical.resistance_ohm;
            set("rise_per_w", values[0] / power_w)?;
            set("time_constant_s", values[1])?;
        } else if effect == Effect::DirectionViscous {
            let more = values[0] * physical.inertia;
            let (forward, backward) = if kind == PlantKind::Rotary {
                ("forward_nm_s_per_rad", "backward_nm_s_per_rad")
            } else {
                ("forward_n_s_per_m", "backward_n_s_per_m")
            };
            set(forward, (-more).max(0.0))?;
            set(backward, more.max(0.0))?;
        } else if effect == Effect::DirectionAsymmetry {
            set("forward_gain", 1.0)?;
            set("backward_gain", values[0])?;
        } else {
            for (parameter, &value) in candidate.parameters.iter().zip(values) {
                if [VISCOUS_SHARE, INPUT_LATE].contains(&parameter.name) {
                    continue;
                }
                let is_force = self.is_per_inertia(parameter.name, parameter.unit);
                let value = match parameter.name {
                    "phase_rad" => value.rem_euclid(TAU),
                    _ if is_force => value * physical.inertia,
                    _ => value,
                };
                let name = if parameter.name == self.scales.units.input_name { "duty" } else { parameter.name };
                set(name, value)?;
            }
        }
        listed.check(kind).ok()?;
        Some(listed)
    }

    /// The push (per unit of inertia, times the inertia) that would have made the residual: its derivatives, smoothed by
    /// a parabola over a window that noise asks for, put into the equation of motion.
    pub(super) fn missing_push(&self, structure: &Structure, run: &MotionRun, residual: &[f64]) -> Vec<f64> {
        let times = self.time_s(run);
        let half_s = (6.0 * self.scales.period_s).max(0.05);
        let inertia = self.physical(structure).inertia;
        let b = self.dynamics(&structure.base).b;
        let (mut from, mut to) = (0, 0);
        (0..residual.len())
            .map(|place| {
                let middle_s = times[place];
                while times[from] < middle_s - half_s {
                    from += 1;
                }
                while to < residual.len() && times[to] <= middle_s + half_s {
                    to += 1;
                }
                let Some(Parabola { value, slope, bend, .. }) =
                    Parabola::through(&times[from..to], &residual[from..to], middle_s)
                else {
                    return f64::NAN;
                };
                inertia * if self.of_speed { slope + b * value } else { bend + b * slope }
            })
            .collect()
    }
}
