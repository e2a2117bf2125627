//! Recordings of a sampled plant with a hidden effect, in the form that an identifier reads.

use std::{
    fmt,
    io::{self, Write},
};

use r4_plants::{DcGearMotor, LinearActuator, Model, PlantSpec};

use crate::{
    Draw, Hidden, NEVER, Search,
    dice::Dice,
    excitation,
    scale::Scale,
    search,
    watch::{Output, Plan, noise},
};

/// Kind of experiment: the driven plant and the recorded output.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Setup {
    /// Motor with a gear: duty to the position of its encoder.
    MotorPosition,
    /// Motor with a gear: duty to the speed of its output.
    MotorSpeed,
    /// Mass on a rail: force to position.
    AxisPosition,
}

impl fmt::Display for Setup {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::MotorPosition => "motor, position",
            Self::MotorSpeed => "motor, speed",
            Self::AxisPosition => "axis, position",
        })
    }
}

/// Current that gives an axis' force at a duty of 1, A, and resistance of its winding, Ω. The back-EMF of such a winding
/// damps the axis by `force² / (current² · resistance)`: at most 0.6 mN s/m for 80 N.
const AXIS_A: f64 = 1e3;
const AXIS_OHM: f64 = 10.0;
/// Length of the rail, m: the axis starts in its middle and never reaches its ends.
const RAIL_M: f64 = 100.0;

impl Setup {
    /// All kinds of experiment.
    pub const ALL: [Self; 3] = [Self::MotorPosition, Self::MotorSpeed, Self::AxisPosition];

    /// Name of the input's column: duty as a share of the supply, or force, N.
    #[must_use]
    pub const fn input(self) -> &'static str {
        match self {
            Self::MotorPosition | Self::MotorSpeed => "duty",
            Self::AxisPosition => "force_n",
        }
    }

    /// Name of the output's column, with its unit.
    #[must_use]
    pub const fn output(self) -> &'static str {
        match self {
            Self::MotorPosition => "theta_rad",
            Self::MotorSpeed => "speed_rad_s",
            Self::AxisPosition => "position_m",
        }
    }

    /// Effects of the catalogue that are not hidden in these recordings, with the reason.
    #[must_use]
    pub fn excluded(self) -> Vec<(&'static str, &'static str)> {
        let own: &[(&str, &str)] = match self {
            Self::MotorPosition => &[("constant-load", "a shaft is drawn with a weight off its axis instead")],
            Self::MotorSpeed => &[
                ("constant-load", "a shaft is drawn with a weight off its axis instead"),
                ("eccentricity", "the recorded speed is the output's, not that of a sensor"),
                ("sensor-lag", "the recorded speed is the output's, not that of a sensor"),
                ("sensor-hold", "the recorded speed is the output's, not that of a sensor"),
            ],
            Self::AxisPosition => &[
                ("supply-sag", "the recorded input is a force, whatever makes it"),
                ("winding-heating", "the recorded input is a force, whatever makes it"),
            ],
        };
        NEVER.iter().chain(own).copied().collect()
    }

    /// Offset that is subtracted from the plant's position in the output of a run that starts at `start`.
    pub(crate) fn zero(self, start: f64) -> f64 {
        if self == Self::AxisPosition { start } else { 0.0 }
    }

    pub(crate) fn output_kind(self) -> Output {
        match self {
            Self::MotorPosition | Self::AxisPosition => Output::Position,
            Self::MotorSpeed => Output::Speed,
        }
    }
}

/// One recording; all columns have the same length.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// Time stamps, s: 200 per second, from 0.
    pub time_s: Vec<f64>,
    /// Input, held from its sample to the next; see [`Setup::input`].
    pub input: Vec<f64>,
    /// Open-circuit voltage of the supply, V; empty for an axis.
    pub supply_v: Vec<f64>,
    /// Measured output, with noise; see [`Setup::output`].
    pub output: Vec<f64>,
    /// Speed of the output, rad/s or m/s, from a second sensor with noise of its own; empty without that sensor.
    pub speed: Vec<f64>,
    /// Position of the plant at the start of the run, rad or m, in the plant's own coordinate.
    pub start: f64,
    /// Output without noise: the prediction of a perfect model.
    pub clean: Vec<f64>,
}

/// Recordings of one plant, with the truth about it.
#[derive(Clone, Debug)]
pub struct Experiment {
    /// Kind of the experiment.
    pub setup: Setup,
    /// Recordings for the fit.
    pub train: Vec<Recording>,
    /// Held-out recordings, never used in the fit; driven differently.
    pub holdout: Vec<Recording>,
    /// Standard deviation of the noise, 30 dB below the output of the train runs: the residual of a perfect model.
    pub noise: f64,
    /// Plant without the hidden effect.
    pub base: PlantSpec,
    /// Plant with the hidden effect.
    pub hidden: Hidden,
    /// Input at a duty of 1: 1, or the force, N.
    pub input_per_duty: f64,
    /// Supply voltage of the simulation, V.
    pub supply_v: f64,
}

/// Number and length of an experiment's runs.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Length {
    /// Number of runs for the fit.
    pub train: usize,
    /// Number of held-out runs.
    pub holdout: usize,
    /// Length of each run, s.
    pub seconds: f64,
}

impl Length {
    /// Standard length: 3 train runs of 12 s and 2 held out.
    pub const STANDARD: Self = Self { train: 3, holdout: 2, seconds: 12.0 };
}

/// Creates recordings of a plant that is sampled from the seed, like its drive, its noise, and its hidden effect.
///
/// The last recordings are held out; with an unlisted effect, those that stay in the range of the others.
#[must_use]
pub fn experiment(setup: Setup, draw: Draw, length: Length, seed: u64) -> Experiment {
    let mut dice = Dice::new(seed, 3 + setup as u64);
    let (base, supply_v, input_per_duty) = match setup {
        Setup::MotorPosition | Setup::MotorSpeed => motor(&mut dice),
        Setup::AxisPosition => axis(&mut dice),
    };
    let scale = Scale::of(&base, supply_v);
    let first = dice.below(4);
    let plans: Vec<Plan> = (0..length.train + length.holdout)
        .map(|number| Plan {
            start: match setup {
                Setup::AxisPosition => scale.centre,
                Setup::MotorPosition | Setup::MotorSpeed => dice.angle(),
            },
            duty: excitation::run(&mut dice, &scale, first + number, length.seconds),
        })
        .collect();
    let output = setup.output_kind();
    let excluded: Vec<_> = setup.excluded().iter().map(|(name, _)| *name).collect();
    let watched = &plans[..length.train.min(2)];
    let place = Search { spec: &base, scale: &scale, plans: watched, output, excluded: &excluded };
    let hidden = search(&place, draw, &mut dice);

    let clean: Vec<Vec<f64>> = plans
        .iter()
        .map(|plan| {
            let zero = setup.zero(plan.start);
            hidden.parts.outputs(plan, supply_v, output).into_iter().map(|value| value - zero).collect()
        })
        .collect();
    let held_out = if draw == Draw::Unlisted {
        least_beyond(&clean, length.holdout)
    } else {
        (length.train..clean.len()).collect()
    };
    let is_held_out = |place: &usize| held_out.contains(place);
    let fitted: Vec<_> =
        (0..clean.len()).filter(|place| !is_held_out(place)).map(|place| clean[place].clone()).collect();
    let noise = noise(&fitted);
    let recordings = plans.into_iter().zip(clean).map(|(plan, clean)| Recording {
        time_s: (0..clean.len()).map(|index| index as f64 / excitation::RATE_HZ).collect(),
        input: plan.duty.iter().map(|duty| duty * input_per_duty).collect(),
        supply_v: if setup == Setup::AxisPosition { Vec::new() } else { vec![supply_v; clean.len()] },
        output: clean.iter().map(|value| value + noise * dice.normal()).collect(),
        speed: Vec::new(),
        start: plan.start,
        clean,
    });
    let (mut train, mut holdout) = (Vec::new(), Vec::new());
    for (place, recording) in recordings.enumerate() {
        if is_held_out(&place) { &mut holdout } else { &mut train }.push(recording);
    }
    Experiment { setup, train, holdout, noise, base, hidden, input_per_duty, supply_v }
}

/// Indices of the `count` outputs that exceed the range of the others least, in value and in change from sample to
/// sample. For effects without a formula: an estimator learns a curve, which does not extrapolate. At least one output
/// is not among them.
fn least_beyond(outputs: &[Vec<f64>], count: usize) -> Vec<usize> {
    fn range<'v>(series: impl Iterator<Item = &'v Vec<f64>>) -> (f64, f64) {
        series
            .flatten()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), &value| (low.min(value), high.max(value)))
    }
    let changes: Vec<Vec<f64>> =
        outputs.iter().map(|output| output.windows(2).map(|pair| pair[1] - pair[0]).collect()).collect();
    // Excess as a share of the others' range.
    let beyond = |held_out: &[usize]| -> f64 {
        let share = |series: &[Vec<f64>]| {
            let others = series.iter().enumerate().filter(|(place, _)| !held_out.contains(place));
            let (low, high) = range(others.map(|(_, other)| other));
            let (lower, higher) = range(held_out.iter().map(|&place| &series[place]));
            ((low - lower).max(0.0) + (higher - high).max(0.0)) / (high - low).max(f64::MIN_POSITIVE)
        };
        share(outputs) + share(&changes)
    };
    let mut held_out = Vec::new();
    for _ in 0..count.min(outputs.len().saturating_sub(1)) {
        let with = |place: usize| [&held_out[..], &[place]].concat();
        let others = (0..outputs.len()).filter(|place| !held_out.contains(place));
        held_out.extend(others.min_by(|&a, &b| beyond(&with(a)).total_cmp(&beyond(&with(b)))));
    }
    held_out
}

/// Samples a motor of some size; returns it with its supply, V, and an input of 1 per duty.
fn motor(dice: &mut Dice) -> (PlantSpec, f64, f64) {
    let supply_v = if dice.share() < 0.5 { 12.0 } else { 24.0 };
    // Sampled by its observable properties: speed without load, time constant, resistance, and share of viscous
    // friction.
    let (speed, time_constant_s) = (dice.ratio_between(4.0, 14.0), dice.ratio_between(0.03, 0.15));
    let (resistance_ohm, gear_ratio) = (dice.ratio_between(0.5, 4.0), dice.ratio_between(10.0, 60.0));
    let per_speed_v = supply_v / speed;
    let damping = per_speed_v * per_speed_v / resistance_ohm;
    let model = DcGearMotor {
        resistance_ohm,
        inductance_h: resistance_ohm * dice.between(0.0, 1e-3),
        torque_constant_nm_per_a: per_speed_v / gear_ratio,
        gear_ratio,
        inertia_kg_m2: time_constant_s * damping,
        viscous_nm_s_per_rad: damping * dice.between(0.02, 0.25),
    };
    (in_range(Model::DcGearMotor(model)), supply_v, 1.0)
}

/// Samples a mass on a rail; returns it with the voltage that drives it, V, and the force for a duty of 1, N.
fn axis(dice: &mut Dice) -> (PlantSpec, f64, f64) {
    let force_n = dice.ratio_between(20.0, 80.0);
    let mass_kg = dice.ratio_between(1.0, 8.0);
    let lead_m_per_rev = 0.01;
    let model = LinearActuator {
        resistance_ohm: AXIS_OHM,
        inductance_h: 0.0,
        torque_constant_nm_per_a: force_n / AXIS_A * lead_m_per_rev / std::f64::consts::TAU,
        lead_m_per_rev,
        efficiency: 1.0,
        rotor_inertia_kg_m2: 0.0,
        moving_mass_kg: mass_kg,
        viscous_n_s_per_m: mass_kg / dice.ratio_between(0.15, 0.6),
        stroke_m: RAIL_M,
    };
    (in_range(Model::LinearActuator(model)), AXIS_A * AXIS_OHM, force_n)
}

/// Creates a plant of this model, or of the typical one if a sampled value is out of range.
fn in_range(model: Model) -> PlantSpec {
    let source = "drawn by a seed, no measured plant";
    let typical = Model::ALL.into_iter().find(|typical| typical.kind() == model.kind()).unwrap_or(model);
    PlantSpec::new(model, source, Vec::new())
        .or_else(|_| PlantSpec::new(typical, source, Vec::new()))
        .expect("typical values are in range")
}

impl Recording {
    /// Writes the recording as CSV with a header, without [`Recording::clean`].
    ///
    /// # Errors
    /// Errors of writing to `out`.
    pub fn write_csv(&self, setup: Setup, out: &mut impl Write) -> io::Result<()> {
        let supply = if self.supply_v.is_empty() { "" } else { ",supply_v" };
        let speed = match setup {
            _ if self.speed.is_empty() => "",
            Setup::MotorPosition | Setup::MotorSpeed => ",speed_rad_s",
            Setup::AxisPosition => ",speed_m_s",
        };
        writeln!(out, "time_s,{}{supply},{}{speed}", setup.input(), setup.output())?;
        for (index, time_s) in self.time_s.iter().enumerate() {
            write!(out, "{time_s},{}", self.input[index])?;
            if let Some(volts) = self.supply_v.get(index) {
                write!(out, ",{volts}")?;
            }
            write!(out, ",{}", self.output[index])?;
            if let Some(speed) = self.speed.get(index) {
                write!(out, ",{speed}")?;
            }
            writeln!(out)?;
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_axis_is_driven_by_the_recorded_force_alone() {
        for seed in 0..100 {
            let (spec, supply_v, force_n) = axis(&mut Dice::new(seed, 0));
            let Model::LinearActuator(axis) = *spec.model() else { panic!("{spec:?}") };
            let constant = axis.torque_constant_nm_per_a * std::f64::consts::TAU / axis.lead_m_per_rev;
            assert!((constant * supply_v / axis.resistance_ohm / force_n - 1.0).abs() < 1e-12);
            // The back-EMF adds a thousandth of the friction at most.
            let damping = constant * constant / axis.resistance_ohm;
            assert!(damping < 1e-3 * axis.viscous_n_s_per_m, "{damping} of {}", axis.viscous_n_s_per_m);
        }
    }

    #[test]
    fn recordings_that_stay_within_the_others_are_held_out() {
        let ramp = |to: f64, samples: usize| (0..samples).map(|at| to * at as f64 / samples as f64).collect::<Vec<_>>();
        let outputs = [ramp(1.0, 100), ramp(5.0, 100), ramp(3.0, 100), ramp(-1.0, 100)];
        assert_eq!(least_beyond(&outputs, 2), [0, 2]);
        // One recording always remains for the fit.
        assert_eq!(least_beyond(&outputs, 9).len(), 3);
        // The second has the range of the others, but changes ten times as fast.
        let outputs = [ramp(1.0, 100), ramp(1.0, 10), ramp(1.0, 100)];
        assert_eq!(least_beyond(&outputs, 1), [0]);
    }
}
