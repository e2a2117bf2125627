//! Models of one moving axis: `dc-motor`, `axis`, `linear-actuator` and `servo`.
//!
//! All four have the same mechanics (`simulate.rs`), with different names for their two parameters, and with or
//! without a position loop. Internally everything is per unit of inertia; `physical.rs` converts to units.

pub mod bench;
mod command;
mod curve;
mod effect;
mod held;
mod info;
mod period;
mod physical;
mod repeat;
mod run;
mod simulate;
mod smooth;
mod stairs;
mod start;
#[cfg(test)]
mod tests;
mod waves;
mod weak;

use std::{
    collections::BTreeMap,
    f64::consts::{PI, TAU},
    sync::Arc,
};

use r4_plants::{Dependence, PlantSpec};

pub use run::MotionRun;

use crate::{
    data::Quantity,
    family::{Candidate, Curve, Driver, Family, Loadable, Model, Parameter, Range, Simulated, Structure, Term},
    fit::{Effort, Fit},
    report::{CLOCK_DRIFT, Estimate, STAMPS_LATE},
};
use effect::Effect;
use simulate::{Observed, is_placed, simulate, simulate_each};

/// Kind of a model of one axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// Duty or voltage to angle or angular speed.
    DcMotor,
    /// Force, or voltage of a drive of known gain, to position.
    Axis,
    /// Duty or voltage to the position of a rod.
    LinearActuator,
    /// Goal to position under a proportional loop.
    Servo,
}

impl Kind {
    /// All kinds, in the order of the list of models.
    pub const ALL: [Self; 4] = [Self::DcMotor, Self::Axis, Self::LinearActuator, Self::Servo];

    /// Returns the name on the command line and in reports.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::DcMotor => "dc-motor",
            Self::Axis => "axis",
            Self::LinearActuator => "linear-actuator",
            Self::Servo => "servo",
        }
    }
}

/// Units and names of parameters at the output, for reports.
#[derive(Clone, Copy, Debug)]
struct Units {
    distance: &'static str,
    speed: &'static str,
    force: &'static str,
    drag: &'static str,
    viscous: &'static str,
    periods: &'static str,
    input: &'static str,
    input_name: &'static str,
    force_name: &'static str,
    forward_name: &'static str,
    backward_name: &'static str,
    stribeck_name: &'static str,
    gap_name: &'static str,
    offset_name: &'static str,
    drag_name: &'static str,
    viscous_name: &'static str,
    periods_name: &'static str,
}

impl Units {
    const ROTARY: Self = Self {
        distance: "rad",
        speed: "rad/s",
        force: "N m",
        drag: "N m s^2/rad^2",
        viscous: "N m s/rad",
        periods: "1/turn",
        input: "1",
        input_name: "duty",
        force_name: "torque_nm",
        forward_name: "forward_torque_nm",
        backward_name: "backward_torque_nm",
        stribeck_name: "stribeck_rad_s",
        gap_name: "gap_rad",
        offset_name: "offset_rad",
        drag_name: "drag_nm_s2_per_rad2",
        viscous_name: "backward_more_nm_s_per_rad",
        periods_name: "periods_per_turn",
    };
    const LINEAR: Self = Self {
        distance: "m",
        speed: "m/s",
        force: "N",
        drag: "N s^2/m^2",
        viscous: "N s/m",
        periods: "1/m",
        input: "1",
        input_name: "duty",
        force_name: "force_n",
        forward_name: "forward_force_n",
        backward_name: "backward_force_n",
        stribeck_name: "stribeck_m_s",
        gap_name: "gap_m",
        offset_name: "offset_m",
        drag_name: "drag_n_s2_per_m2",
        viscous_name: "backward_more_n_s_per_m",
        periods_name: "periods_per_m",
    };

    const fn with_input(mut self, quantity: Quantity) -> Self {
        (self.input, self.input_name) = match quantity {
            Quantity::Voltage => ("V", "voltage_v"),
            Quantity::Force => ("N", "input_force_n"),
            Quantity::Torque => ("N m", "input_torque_nm"),
            _ => (self.input, self.input_name),
        };
        self
    }
}

/// Magnitudes in the data, from which fits begin.
#[derive(Clone, Debug)]
struct Scales {
    units: Units,
    /// Largest magnitude of the command.
    input: f64,
    /// Range of the output, or of its integral if that is a speed.
    distance: f64,
    speed: f64,
    /// Acceleration by the largest command.
    acceleration: f64,
    /// Median sampling period, s.
    period_s: f64,
    duration_s: f64,
    /// Numbers of waves per turn (or per m) from which a friction over position starts.
    periods: Vec<f64>,
    /// Smallest and largest number of waves per turn (or per m).
    periods_within: [f64; 2],
    /// Numbers of waves per turn (or per m) from which cogging starts.
    cogging: Vec<f64>,
    /// True for a motor whose back-EMF damps it.
    damps_by_emf: bool,
    /// Periods at which the output looks most like sample-and-hold, s.
    stairs_s: Vec<f64>,
    /// True if the input was sampled, false if it was commanded from each sample on.
    input_is_sampled: bool,
}

impl Scales {
    /// Returns the range of the number of waves over position, from half a wave over the whole travel, which is
    /// hardly more than a slope.
    fn waves(&self) -> Range {
        let [fewest, most] = self.periods_within;
        Range::Reflected(fewest, most)
    }
}

/// Constants of the mechanics, computed from the base parameters.
#[derive(Clone, Copy, Debug)]
struct Dynamics {
    k: f64,
    b: f64,
    b_open: f64,
    loop_gain: f64,
    pendulum: f64,
}

/// Known parameters of an axis; `None` for unknown ones.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Known {
    /// Supply, V, if the input is a duty and the supply was not recorded.
    pub supply_v: Option<f64>,
    /// Force per unit of the input, N or N m, of an axis.
    pub gain: Option<f64>,
    /// Duty per rad of error and unit of the servo's gain, 1/rad.
    pub loop_gain: Option<f64>,
    /// Length of a pendulum on a servo, with its mass at the end, m.
    pub arm_m: Option<f64>,
    /// Position of the upper end stop of a linear actuator, m; the lower one is at 0.
    pub stroke_m: Option<f64>,
    /// Largest duty of a servo.
    pub duty_limit: Option<f64>,
    /// Resistance of the motor's winding, Ω; without it torques are known only up to a factor.
    pub resistance_ohm: Option<f64>,
    /// Declared plant with the rest of the parameters.
    pub plant: Option<PlantSpec>,
}

impl Known {
    /// Returns the known effects of the bridge: the first effects of the plant, as long as they act instantaneously.
    pub(crate) fn bridge(&self) -> impl Iterator<Item = r4_plants::Effect> + '_ {
        let effects = self.plant.iter().flat_map(PlantSpec::effects).copied();
        effects.take_while(|effect| effect.at_once(0.0).is_some())
    }
}

/// Returns a duty after the effects of a bridge.
fn through(bridge: &[r4_plants::Effect], duty: f64) -> f64 {
    bridge.iter().fold(duty, |duty, effect| effect.at_once(duty).unwrap_or(duty))
}

/// Model of one moving axis, created for given data.
#[derive(Clone, Debug)]
pub struct Motion {
    kind: Kind,
    known: Known,
    base: Vec<Parameter>,
    effects: Vec<Effect>,
    catalogue: Vec<Candidate>,
    rotary: bool,
    of_speed: bool,
    duty_limit: f64,
    is_duty: bool,
    stops: Option<(f64, f64)>,
    /// Known effects of the bridge, in order; identified effects act before them.
    bridge: Arc<[r4_plants::Effect]>,
    /// True if the voltage behind the duty is unknown.
    supply_assumed: bool,
    scales: Scales,
    places: Places,
}

/// Indexes of optional base parameters.
#[derive(Clone, Copy, Debug, Default)]
struct Places {
    b_open: Option<usize>,
    loop_gain: Option<usize>,
    pendulum: Option<usize>,
    offset: Option<usize>,
    stamps: Option<usize>,
}

/// Number of positions in a turn at which an unrecorded position is first searched for.
const PLACES: u8 = 16;
/// Supply voltage that is assumed if it is unknown, V.
const ASSUMED_V: f64 = 1.0;
/// Standard gravity, m/s² (ISO 80000-3).
const GRAVITY_M_S2: f64 = 9.806_65;
/// Sampling periods by which the output's stamps may be early or late, as part of every base model: as of a logger
/// that stamps before or after it samples, and with the value of the period before. A longer delay is an effect.
const EARLY: f64 = 3.0;
const LATE: f64 = 1.5;
/// Share of the largest earliness beyond which the stamps are at the end of their range.
const ACAUSAL: f64 = 0.98;
/// Share of the largest lateness beyond which an effect that delays is searched for.
const INSIDE: f64 = 0.8;
/// Largest share of a pendulum's mass in the inertia: it cannot fall faster than without an armature.
const NO_ARMATURE: f64 = 1.0;

impl Motion {
    /// Returns possible initial positions of an axis whose position is not recorded.
    fn places(&self) -> impl Iterator<Item = f64> {
        let round = if self.rotary { TAU } else { self.scales.distance };
        (0..PLACES).map(move |place| f64::from(place) / f64::from(PLACES) * round)
    }

    /// Returns whether the position is an angle of which the recordings show enough for a curve over one turn. Half a
    /// turn in one recording is taken as enough: others, which begin elsewhere, show the rest.
    fn is_round(&self) -> bool {
        self.rotary && self.scales.distance > 0.5 * TAU
    }

    fn index(&self, effect: Effect) -> Option<usize> {
        self.effects.iter().position(|&other| other == effect)
    }

    /// Returns the phase of a wave over position, rad, per wave and unit of position (turn in rad, or m).
    fn radians_per_period(&self) -> f64 {
        if self.rotary { 1.0 } else { TAU }
    }

    fn dynamics(&self, base: &[f64]) -> Dynamics {
        let (k, b) = match self.kind {
            // The first parameter is the steady speed per volt, the second the time constant.
            Kind::DcMotor | Kind::LinearActuator | Kind::Servo => (base[0] / base[1], 1.0 / base[1]),
            Kind::Axis => (self.known.gain.unwrap_or(1.0) / base[0], base[1] / base[0]),
        };
        let at = |place: Option<usize>| place.map(|place| base[place]);
        Dynamics {
            k,
            b,
            b_open: at(self.places.b_open).map_or(b, |share| share * b),
            loop_gain: at(self.places.loop_gain).or(self.known.loop_gain).unwrap_or(0.0) * f64::from(self.is_servo()),
            pendulum: at(self.places.pendulum)
                .zip(self.known.arm_m)
                .map_or(0.0, |(share, arm_m)| share * GRAVITY_M_S2 / arm_m),
        }
    }

    /// Returns a structure with this push per volt and damping; nothing else of [`Self::dynamics`] changes.
    fn with_dynamics(&self, mut structure: Structure, k: f64, b: f64) -> Structure {
        let base = &mut structure.base;
        (base[0], base[1]) = match self.kind {
            Kind::DcMotor | Kind::LinearActuator | Kind::Servo => (k / b, 1.0 / b),
            Kind::Axis => {
                let inertia = self.known.gain.unwrap_or(1.0) / k;
                (inertia, b * inertia)
            }
        };
        structure
    }

    /// Returns the structure with correct stamps of the output.
    fn with_true_stamps(&self, mut structure: Structure) -> Structure {
        if let Some(late_s) = self.places.stamps.and_then(|place| structure.base.get_mut(place)) {
            *late_s = 0.0;
        }
        structure
    }

    /// Returns the delay of the output's stamps, s; negative if they are early.
    fn stamps_late_s(&self, base: &[f64]) -> f64 {
        self.places.stamps.and_then(|place| base.get(place)).copied().unwrap_or(0.0)
    }

    fn pendulum_offset(&self, base: &[f64]) -> f64 {
        self.places.offset.map_or(0.0, |place| base[place])
    }

    /// Returns the full duty, beyond which a drive does not amplify its input. For forces, voltages, and duties in
    /// other units, the limit of the drive is unknown and taken to be the largest recorded input.
    fn full_duty(&self) -> f64 {
        if self.is_duty && self.scales.input <= 1.0 { self.duty_limit } else { self.scales.input }
    }

    fn is_servo(&self) -> bool {
        self.kind == Kind::Servo
    }

    /// Returns the base parameters of a kind of model, with the indexes of the optional ones.
    fn base_of(kind: Kind, rotary: bool, known: &Known, coasts: bool, period_s: f64) -> (Vec<Parameter>, Places) {
        let plain = |name, unit, range| Parameter { name, unit, range, absent: None };
        let mut base = match (kind, rotary) {
            (Kind::Axis, true) => vec![
                plain("inertia_kg_m2", "kg m^2", Range::Positive),
                plain("viscous_nm_s_per_rad", "N m s/rad", Range::Positive),
            ],
            (Kind::Axis, false) => {
                vec![plain("mass_kg", "kg", Range::Positive), plain("viscous_n_s_per_m", "N s/m", Range::Positive)]
            }
            (_, true) => vec![
                plain("speed_per_volt_rad_s_per_v", "rad/s/V", Range::Positive),
                plain("time_constant_s", "s", Range::Positive),
            ],
            (_, false) => vec![
                plain("speed_per_volt_m_s_per_v", "m/s/V", Range::Positive),
                plain("time_constant_s", "s", Range::Positive),
            ],
        };
        let mut places = Places::default();
        let mut push = |parameter| {
            base.push(parameter);
            Some(base.len() - 1)
        };
        if coasts {
            places.b_open = push(plain("coasting_share", "1", Range::Between(0.0, 1.0)));
        }
        if kind == Kind::Servo && known.loop_gain.is_none() {
            places.loop_gain = push(plain("duty_per_rad", "1/rad", Range::Positive));
        }
        if kind == Kind::Servo && known.arm_m.is_some() {
            places.pendulum = push(plain("pendulum_share_of_inertia", "1", Range::Between(0.05, NO_ARMATURE)));
            places.offset = push(plain("hanging_at_rad", "rad", Range::Any { scale: 0.05 }));
        }
        places.stamps = push(plain(STAMPS_LATE, "s", Range::Reflected(-EARLY * period_s, LATE * period_s)));
        (base, places)
    }
}

impl Model for Motion {
    type Run = MotionRun;

    fn base(&self) -> &[Parameter] {
        &self.base
    }

    fn catalogue(&self) -> &[Candidate] {
        &self.catalogue
    }

    fn initial(&self, run: &MotionRun) -> (Vec<f64>, Vec<f64>) {
        run.initial(self.of_speed)
    }

    fn predict(&self, structure: &Structure, initial: &[f64], run: &MotionRun, predicted: &mut [f64]) {
        simulate(self, structure, initial, run, predicted, None);
    }

    fn predict_each(
        &self,
        known: &Simulated<'_>,
        others: &[(&Structure, &[f64])],
        run: &MotionRun,
        told: &mut dyn FnMut(usize, &[f64]),
    ) {
        simulate_each(self, known, others, run, told);
    }

    fn measured<'r>(&self, run: &'r MotionRun) -> &'r [f64] {
        &run.all.measured[run.from..run.to]
    }

    fn noise(&self, run: &MotionRun) -> f64 {
        run.all.noise
    }

    fn rounding(&self, run: &MotionRun) -> f64 {
        run.all.rounding
    }
}

impl Family for Motion {
    fn unit(&self) -> &'static str {
        if self.of_speed { self.scales.units.speed } else { self.scales.units.distance }
    }

    fn starts(&self, runs: &[&MotionRun]) -> Vec<Vec<f64>> {
        self.starting_values(runs)
    }

    fn declared(&self) -> Option<Vec<f64>> {
        self.declared_base()
    }

    fn movable(&self, structure: Structure) -> Structure {
        self.movable(structure)
    }

    fn is_early(&self, structure: &Structure) -> bool {
        self.stamps_late_s(&structure.base) < -ACAUSAL * EARLY * self.scales.period_s
    }

    /// Returns the exchange of two successive lags, whose order the data cannot show.
    fn exchanged(&self, structure: &Structure) -> Vec<(String, Structure)> {
        let of_lag = |effect: Effect| {
            let index = self.index(effect)?;
            let place = structure.terms.iter().position(|term| *term == Term::Known(index))?;
            let (lag_s, Dynamics { k, b, .. }) = (structure.added[place][0], self.dynamics(&structure.base));
            if self.places.b_open.is_some() || !(lag_s > 0.0 && b > 0.0) {
                return None;
            }
            // The steady speed for the same push must not change.
            let mut other = self.with_dynamics(structure.clone(), k / (b * lag_s), 1.0 / lag_s);
            other.added[place][0] = 1.0 / b;
            Some((format!("the time constants of {} and of what moves", effect.name()), other))
        };
        [Effect::DriveLag, Effect::SensorLag].into_iter().filter_map(of_lag).collect()
    }

    fn known(&self) -> Option<String> {
        let names: Vec<_> = self.bridge.iter().map(|effect| effect.name()).collect();
        let what = "known of the bridge by the plant file, and kept, behind all that is found of it";
        (!names.is_empty()).then(|| format!("{what}: {}", names.join(", ")))
    }

    fn is_late(&self, structure: &Structure) -> bool {
        self.stamps_late_s(&structure.base) > INSIDE * LATE * self.scales.period_s
    }

    fn simpler(&self, structure: &Structure, place: usize) -> Vec<(Term, Vec<f64>)> {
        let Term::Known(index) = structure.terms[place] else { return vec![] };
        let values = &structure.added[place];
        let term = |effect, values: Vec<f64>| {
            let index = self.index(effect)?;
            structure.of(index).is_none().then_some((Term::Known(index), values))
        };
        let simpler = match self.effects[index] {
            Effect::DirectionFriction => term(Effect::Coulomb, vec![0.5 * (values[0] + values[1])]),
            Effect::Static | Effect::WarmUp => term(Effect::Coulomb, vec![values[0]]),
            // Gravity has the opposite sign in the equation of motion.
            Effect::Cogging if self.rotary => term(Effect::Gravity, vec![values[0], values[1] + PI]),
            _ => None,
        };
        simpler.into_iter().collect()
    }

    /// Returns friction by direction in place of a load and a direction-independent friction: they are equal while
    /// the axis moves.
    fn merged(&self, structure: &Structure) -> Option<([usize; 2], Term, Vec<f64>)> {
        let [coulomb, load, by_direction] =
            [Effect::Coulomb, Effect::ConstantLoad, Effect::DirectionFriction].map(|effect| self.index(effect));
        let place = |index: Option<usize>| {
            structure.terms.iter().position(|term| Some(term) == index.map(Term::Known).as_ref())
        };
        let (one, other) = place(coulomb).zip(place(load))?;
        let (friction, load) = (structure.added[one][0], structure.added[other][0]);
        let values = vec![(friction + load).max(0.0), (friction - load).max(0.0)];
        Some(([one.min(other), one.max(other)], Term::Known(by_direction?), values))
    }

    fn beginnings(&self, structure: &Structure, run: &MotionRun) -> Vec<Vec<f64>> {
        let (guess, _) = self.initial(run);
        if !self.of_speed || !is_placed(self, structure) {
            return vec![guess];
        }
        self.places().map(|place| vec![place, guess[1]]).collect()
    }

    fn guess(
        &self,
        starts: Vec<Structure>,
        current: &Fit,
        runs: &[&MotionRun],
        effort: Effort,
    ) -> Option<(Structure, f64)> {
        self.weakly(starts, current, runs, effort)
    }

    fn guesses_roughly(&self, structure: &Structure) -> bool {
        self.hides_motion(structure)
    }

    fn time_s<'r>(&self, run: &'r MotionRun) -> &'r [f64] {
        &run.all.time_s[run.from..run.to]
    }

    fn name<'r>(&self, run: &'r MotionRun) -> &'r str {
        &run.all.name
    }

    fn input(&self, run: &MotionRun) -> (String, Vec<f64>) {
        (self.scales.units.input_name.to_owned(), run.all.input[run.from..run.to].to_vec())
    }

    fn part(&self, run: &MotionRun, from: usize, to: usize) -> MotionRun {
        let to = (run.from + to).min(run.to);
        MotionRun { all: run.all.clone(), from: (run.from + from).min(to), to }
    }

    fn drivers(&self, structure: &Structure, initial: &[f64], run: &MotionRun) -> Vec<Driver> {
        let mut observed = Observed::default();
        let mut predicted = vec![0.0; run.to - run.from];
        simulate(self, structure, initial, run, &mut predicted, Some(&mut observed));
        let units = &self.scales.units;
        let driver = |over, unit, values| Driver { over, unit, period: None, values };
        let position = observed.position.clone();
        let mut drivers = vec![
            driver(Dependence::Input, units.input, observed.input),
            driver(Dependence::Speed, units.speed, observed.speed),
            driver(Dependence::Position, units.distance, observed.position),
            driver(Dependence::Acceleration, if self.rotary { "rad/s^2" } else { "m/s^2" }, observed.acceleration),
            driver(Dependence::Direction, "1", observed.direction),
            driver(Dependence::Time, "s", observed.time_s),
            driver(Dependence::History, units.distance, observed.history),
        ];
        if run.all.supply_recorded {
            drivers.push(driver(Dependence::Supply, "V", observed.supply));
        }
        if self.is_round() {
            drivers.push(Driver {
                over: Dependence::Position,
                unit: units.distance,
                period: Some(TAU),
                values: position,
            });
        }
        drivers
    }

    fn push(&self, structure: &Structure, run: &MotionRun, residual: &[f64]) -> Option<(Vec<f64>, &'static str)> {
        Some((self.missing_push(structure, run, residual), self.scales.units.force))
    }

    fn estimates(
        &self,
        structure: &Structure,
        deviations: &[Option<f64>],
        intervals: &[Option<[f64; 2]>],
    ) -> (BTreeMap<String, Estimate>, Vec<BTreeMap<String, Estimate>>) {
        self.in_units(structure, deviations, intervals)
    }

    fn units(&self, structure: &Structure) -> Vec<f64> {
        self.factors(structure)
    }

    fn timing(&self, name: &str) -> Option<&'static str> {
        match name {
            STAMPS_LATE => Some(STAMPS_LATE),
            _ if name == Effect::ClockDrift.name() => Some(CLOCK_DRIFT),
            _ => None,
        }
    }

    fn force_per_push(&self, structure: &Structure) -> f64 {
        self.physical(structure).inertia
    }

    fn loadable(&self, structure: &Structure, source: &str) -> Loadable {
        Loadable::Plant(self.plant_file(structure, source))
    }

    fn curves(&self, current: &Fit, driver: (Dependence, Option<f64>), runs: &[&MotionRun]) -> Vec<Curve> {
        self.empty_curves(current, driver, runs)
    }
}
