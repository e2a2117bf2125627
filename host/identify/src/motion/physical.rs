//! Conversion from parameters per unit of inertia to those of plant files and reports, and from a residual to the
//! missing push.

use std::{collections::BTreeMap, f64::consts::TAU, fmt::Write};

use r4_plants::{
    DcGearMotor, Dependence, Effect as Listed, EffectInfo, Fitted, InsertionPoint, LinearActuator, Model, PlantKind,
    PlantSpec, Table,
    effect::table::{On, Over},
};

use crate::{
    family::{Acts, Family, Parameter, Structure, Term},
    report::Estimate,
};

use super::{
    ASSUMED_V, Kind, Motion, MotionRun,
    effect::{Effect, INPUT_LATE, VISCOUS_SHARE},
    smooth::Parabola,
    through,
};

/// Winding resistance that is assumed if it is unknown, Ω.
const ASSUMED_OHM: f64 = 1.0;
/// Share of an axis' damping that its drive contributes in a plant file. The drive is a force source, modelled as a
/// winding with this little back-EMF damping, which is subtracted from the viscous friction.
const BACK_EMF_SHARE: f64 = 1e-3;
/// Smallest and largest resistance of that winding, Ω: well within the limits of plant files.
const FORCE_SOURCE_OHM: [f64; 2] = [1e-3, 1e2];

/// Smallest inertia and mass in a plant file. A recording in which the output follows the voltage at once fits any
/// smaller one equally well; forces do not change with it.
const LIGHTEST_KG_M2: f64 = 1e-9;
const LIGHTEST_KG: f64 = 1e-6;

/// Parameters of a plant file.
#[derive(Clone, Copy, Debug)]
pub(super) struct Physical {
    /// Inertia at the output, kg m² or kg.
    pub(super) inertia: f64,
    /// Force constant at the output, N m/A or N/A, equal to the back-EMF constant, V s/rad or V s/m.
    constant: f64,
    resistance_ohm: f64,
    viscous: f64,
}

/// Number of straight pieces in a plant file for each piece of a curve: the error is 1/64 of the piece's bend.
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
        // The steady speed per volt is c / (c² + B R). The viscous friction B comes from an effect that determines
        // it, else from the plant file, if that leaves a real solution for c.
        let gain = dynamics.k / dynamics.b;
        if let Some(share) = self.viscous_share(structure) {
            let constant = (1.0 - share) / gain;
            let inertia = constant / (resistance_ohm * dynamics.k);
            return Physical { inertia, constant, resistance_ohm, viscous: share * dynamics.b * inertia };
        }
        // A negative radicand means that no motor with the declared friction reaches the fitted speed.
        let root = 1.0 - 4.0 * gain * gain * viscous * resistance_ohm;
        let (constant, viscous) =
            if root >= 0.0 { ((1.0 + root.sqrt()) / (2.0 * gain), viscous) } else { (1.0 / gain, 0.0) };
        Physical { inertia: constant / (resistance_ohm * dynamics.k), constant, resistance_ohm, viscous }
    }

    /// Returns the base parameters of a motor as its plant file declares it: the inverse of [`Self::physical`].
    /// `None` without such a file, and for an axis or a servo, which have parameters that no plant file has.
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
        // Damping times resistance: by back-EMF, and by friction.
        let (winding, friction) = (constant * constant, viscous * resistance_ohm);
        let damping = winding + friction;
        let mut base = vec![0.0; self.base.len()];
        (base[0], base[1]) = (constant / damping, inertia * resistance_ohm / damping);
        if let Some(place) = self.places.b_open {
            base[place] = friction / damping;
        }
        Some(base)
    }

    /// Returns the share of friction in the damping, from an effect that determines it.
    fn viscous_share(&self, structure: &Structure) -> Option<f64> {
        const TELLING: [Effect; 3] = [Effect::LoadFriction, Effect::SupplySag, Effect::WindingHeating];
        let values = TELLING.iter().find_map(|&effect| structure.of(self.index(effect)?))?;
        // A motor with friction only would have no torque constant.
        values.last().map(|share| share.min(0.99))
    }

    /// Returns the assumptions that the scale of torques and forces depends on; `None` if it is known.
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

    /// Returns whether the mechanics uses a parameter divided by the inertia. A parameter that is compared with the
    /// command, which may be a force too, is as commanded.
    fn is_per_inertia(&self, name: &str, unit: &str) -> bool {
        let units = &self.scales.units;
        name != units.input_name && [units.force, units.drag, units.viscous].contains(&unit)
    }

    /// Returns the factor from each parameter to its unit: the inertia for forces and dampings.
    pub(super) fn factors(&self, structure: &Structure) -> Vec<f64> {
        let inertia = self.physical(structure).inertia;
        let of = |parameter: &Parameter, inertia: f64| {
            if self.is_per_inertia(parameter.name, parameter.unit) { inertia } else { 1.0 }
        };
        // The base parameters of an axis are already in its units.
        let of_base = if self.kind == Kind::Axis { 1.0 } else { inertia };
        let mut factors: Vec<f64> = self.base.iter().map(|parameter| of(parameter, of_base)).collect();
        for (term, values) in structure.terms.iter().zip(&structure.added) {
            match term {
                Term::Known(index) => {
                    factors.extend(self.catalogue[*index].parameters.iter().map(|parameter| of(parameter, inertia)));
                }
                Term::Curve(curve) => {
                    let factor = if curve.acts == Acts::Gain { 1.0 } else { inertia };
                    factors.extend(values.iter().map(|_| factor));
                }
            }
        }
        factors
    }

    #[allow(clippy::type_complexity)]
    pub(super) fn in_units(
        &self,
        structure: &Structure,
        deviations: &[Option<f64>],
        intervals: &[Option<[f64; 2]>],
    ) -> (BTreeMap<String, Estimate>, Vec<BTreeMap<String, Estimate>>) {
        let assumed = self.scale_is_assumed();
        let mut factors = self.factors(structure).into_iter();
        let mut deviations = deviations.iter().copied().chain(std::iter::repeat(None));
        let mut intervals = intervals.iter().copied().chain(std::iter::repeat(None));
        let mut told = |name: &str, unit: &str, value: f64| {
            let factor = factors.next().unwrap_or(1.0);
            let estimate = Estimate {
                value: value * factor,
                std: deviations.next().flatten().map(|deviation| deviation * factor),
                unit: unit.to_owned(),
                interval: intervals.next().flatten().map(|ends| ends.map(|end| end * factor)),
                assumed: match unit {
                    // An inertia scales with the assumed force.
                    _ if self.is_per_inertia(name, unit) || unit.starts_with("kg") => assumed.clone(),
                    _ if unit.ends_with("/V") => self.supply_is_assumed(),
                    _ => None,
                },
            };
            (name.to_owned(), estimate)
        };
        let base = self.base.iter().zip(&structure.base);
        let base = base.map(|(parameter, &value)| told(parameter.name, parameter.unit, value)).collect();
        let terms = structure
            .terms
            .iter()
            .zip(&structure.added)
            .map(|(term, values)| match term {
                Term::Known(index) => self.catalogue[*index]
                    .parameters
                    .iter()
                    .zip(values)
                    .map(|(parameter, &value)| told(parameter.name, parameter.unit, value))
                    .collect(),
                Term::Curve(_) => {
                    values.iter().for_each(|_| drop(told("value", "1", 0.0)));
                    BTreeMap::new()
                }
            })
            .collect();
        (base, terms)
    }

    /// Returns the model as a plant file; a comment in it lists what such a file cannot hold.
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
                        // In the estimator the curve is over the magnitude of the speed, in the plant file over the
                        // signed speed.
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
        // A plant's effects on the duty act in their order: the identified ones come before the known bridge.
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

    /// Returns an effect as plant files have it; `None` if they cannot hold it.
    fn listed(&self, effect: Effect, values: &[f64], physical: &Physical, kind: PlantKind) -> Option<Listed> {
        let info = EffectInfo::named(effect.name())?;
        let mut listed = info.typical;
        let candidate = effect.candidate(&self.scales, self.of_speed);
        let mut set = |name: &str, value: f64| listed.set(kind, name, value).ok();
        if effect == Effect::SupplySag {
            set("source_ohm", values[0] * physical.resistance_ohm)?;
        } else if effect == Effect::WindingHeating {
            // A rise of one refers to full duty at rest.
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

    /// Returns the push (per unit of inertia, times the inertia) that would cause the residual: its derivatives,
    /// smoothed by a parabola over a window that is long enough for the noise, inserted in the equation of motion.
    pub(super) fn missing_push(&self, structure: &Structure, run: &MotionRun, residual: &[f64]) -> Vec<f64> {
        let times = self.time_s(run);
        // A second derivative needs a window of several samples against noise.
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
