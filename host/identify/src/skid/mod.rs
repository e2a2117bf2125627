//! `skid-steer`: what both sides of a skid-steered robot do, and what its body does.
//!
//! | role | unit | |
//! | --- | --- | --- |
//! | `left`, `right` | rad/s or m/s | speed of the wheels of each side, or their commands |
//! | `gyro` | rad/s | yaw rate, positive to the left |
//! | `yaw` | rad | yaw angle; jumps of a turn are taken out |
//! | `x`, `y` | m | position, for the speeds along and across the body |
//! | `wheel_left`, `wheel_right` | rad/s or m/s | speed of the wheels, as output, where `left` and `right` are commands |
//!
//! The base model is the ideal differential drive of the declared geometry. Nothing of it is fitted: its error is that of
//! a prediction without slip. The output is one of [`Output`]; RMSE is of that.
//!
//! What is measured is compared sample by sample, or with `average_s` as means over successive spans of so many seconds,
//! with the mean of the free run over the same samples.
//!
//! ```text
//! sides → delay of the drives or the encoders → lag per side → scale, dead zone → ideal motion → slip → limits → slew → lag → sensor
//! ```
//!
//! Between samples the sides' speeds are straight lines: a command that steps is late by half a sample on average.

mod body;
mod effect;
mod error;
mod run;
mod simulate;
#[cfg(test)]
mod tests;

use std::collections::BTreeMap;

use r4_plants::Dependence;
use r4_world::Wheeled;

pub use error::SkidError;
pub use run::SkidRun;

use crate::{
    data,
    family::{Acts, Candidate, Curve, Driver, Family, Loadable, Model, Parameter, Structure},
    fit::Fit,
    task::{FileKind, ModelInfo, ParameterInfo, RoleInfo},
};
use effect::{Effect, Scales};
use simulate::{CIRCLE, Ideal, directions, mean_over_spans, simulate};

/// Corners of a curve over a line and over the circle of directions.
const CORNERS: usize = 9;
const CORNERS_ROUND: usize = 16;

/// What is known of the robot, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geometry {
    /// Of the wheels.
    pub wheel_radius_m: f64,
    /// Between the middles of the left and right wheels.
    pub track_m: f64,
}

impl Geometry {
    /// Yaw rate without slip, rad/s, of the sides' speeds, rad/s.
    #[must_use]
    pub fn turn(&self, left: f64, right: f64) -> f64 {
        self.wheel_radius_m * (right - left) / self.track_m
    }
}

/// Which motion of the body is modelled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Output {
    /// rad/s, from the gyro, the yaw angle or the wheels.
    YawRate,
    /// m/s along the body, from the pose.
    ForwardSpeed,
    /// m/s across the body, positive to the left, from the pose.
    LateralSpeed,
}

impl Output {
    /// All, in the order of the list of models.
    pub const ALL: [Self; 3] = [Self::YawRate, Self::ForwardSpeed, Self::LateralSpeed];

    /// Name of the model with this output.
    #[must_use]
    pub const fn model(self) -> &'static str {
        match self {
            Self::YawRate => "skid-steer",
            Self::ForwardSpeed => "skid-steer-forward",
            Self::LateralSpeed => "skid-steer-lateral",
        }
    }

    /// What the RMSE is of.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::YawRate => "yaw rate",
            Self::ForwardSpeed => "forward speed",
            Self::LateralSpeed => "lateral speed",
        }
    }
}

/// What is declared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Declared {
    /// Of the robot.
    pub geometry: Geometry,
    /// Compare means over spans of so many seconds instead of samples.
    pub average_s: Option<f64>,
}

impl Declared {
    /// From `--param name=value`.
    ///
    /// # Errors
    /// A length that is missing or is none, or a name that the model does not have.
    pub fn from_parameters(given: &BTreeMap<String, f64>) -> Result<Self, SkidError> {
        const NAMES: [&str; 3] = ["wheel_radius_m", "track_m", "average_s"];
        if let Some(name) = given.keys().find(|name| !NAMES.contains(&name.as_str())) {
            return Err(SkidError::UnknownParameter { name: name.clone() });
        }
        let optional = |name: &'static str| match given.get(name) {
            Some(&value) if value.is_finite() && value > 0.0 => Ok(Some(value)),
            Some(&value) => Err(SkidError::BadParameter { name, value }),
            None => Ok(None),
        };
        let needed = |name, example| optional(name)?.ok_or(SkidError::NoParameter { name, example });
        Ok(Self {
            geometry: Geometry {
                wheel_radius_m: needed("wheel_radius_m", "0.165")?,
                track_m: needed("track_m", "0.55")?,
            },
            average_s: optional("average_s")?,
        })
    }
}

/// The model.
#[derive(Clone, Debug)]
pub struct SkidSteer {
    geometry: Geometry,
    output: Output,
    scales: Scales,
    /// Of the catalogue, by its index.
    effects: Vec<Effect>,
    catalogue: Vec<Candidate>,
    /// Speeds of the sides at which the robot turned, rad/s: where a body has to turn as the model does.
    turns: Vec<(f64, f64)>,
    /// As it was known, or on four wheels of that geometry.
    body: Wheeled,
    is_body_known: bool,
}

impl SkidSteer {
    /// The model for some runs, and these as it wants them.
    ///
    /// # Errors
    /// Roles without a column, columns in other units, and runs from which no slip could be seen.
    pub fn new(declared: Declared, output: Output, runs: &[data::Run]) -> Result<(Self, Vec<SkidRun>), SkidError> {
        let Declared { geometry, average_s } = declared;
        let read = |run| SkidRun::new(&geometry, output, average_s, run);
        let runs = runs.iter().map(read).collect::<Result<Vec<_>, _>>()?;
        let scales = Scales::of(&geometry, &runs)?;
        if output == Output::YawRate && scales.turn == 0.0 {
            return Err(SkidError::NeverTurns);
        }
        let effects = Effect::of(output, average_s.is_some());
        let catalogue = effects.iter().map(|effect| effect.candidate(&geometry, output, &scales)).collect();
        let turns = body::turns(&geometry, &scales, &runs);
        let body = body::assumed(&geometry).map_err(|source| SkidError::NoBody { geometry, source })?;
        Ok((Self { geometry, output, scales, effects, catalogue, turns, body, is_body_known: false }, runs))
    }

    /// With what is known of the robot's body; what is fitted takes its place in it.
    #[must_use]
    pub fn with_body(self, known: Option<Wheeled>) -> Self {
        match known {
            Some(body) => Self { body, is_body_known: true, ..self },
            None => self,
        }
    }

    /// For the list of models.
    #[must_use]
    pub fn info(output: Output) -> ModelInfo {
        let role = |name, driving, required, what| RoleInfo { name, required, driving, what };
        let mut roles = vec![
            role("left", true, true, "speed of the left wheels, or their command"),
            role("right", true, true, "speed of the right wheels, or their command"),
        ];
        let pose = output != Output::YawRate;
        roles.push(role("yaw", false, pose, "yaw angle, positive to the left"));
        if pose {
            roles.push(role("x", false, true, "position"));
            roles.push(role("y", false, true, "position, to the left of x"));
        } else {
            roles.push(role("gyro", false, false, "yaw rate, positive to the left; the gyro, the yaw or the wheels"));
            roles.push(role("wheel_left", false, false, "speed of the left wheels, where `left` is a command"));
            roles.push(role("wheel_right", false, false, "speed of the right wheels, where `right` is a command"));
        }
        let parameter = |name, unit, what| ParameterInfo { name, unit, what };
        ModelInfo {
            name: output.model(),
            summary: match output {
                Output::YawRate => "skid-steered robot: speeds or commands of both sides to yaw rate",
                Output::ForwardSpeed => "skid-steered robot: speeds of both sides to speed along the body",
                Output::LateralSpeed => "skid-steered robot: speeds of both sides to speed across the body",
            },
            roles,
            parameters: vec![
                parameter("wheel_radius_m", "m", "of the wheels; needed"),
                parameter("track_m", "m", "between the middles of left and right wheels; needed"),
                parameter("average_s", "s", "compare means over spans of this length instead of samples"),
            ],
            effects: Effect::of(output, false).into_iter().map(Effect::name).collect(),
            file: FileKind::Body,
        }
    }

    /// A run that is to be predicted by a model made for others.
    ///
    /// # Errors
    /// As [`SkidSteer::new`].
    pub fn run(&self, declared: Declared, run: &data::Run) -> Result<SkidRun, SkidError> {
        SkidRun::new(&self.geometry, self.output, declared.average_s, run)
    }
}

impl Scales {
    fn of(geometry: &Geometry, runs: &[SkidRun]) -> Result<Self, SkidError> {
        let ideal = |run: &SkidRun| {
            let sides = run.sides.clone();
            (0..sides.time_s.len()).map(move |at| (sides.left[at], sides.right[at])).collect::<Vec<_>>()
        };
        let wheels: Vec<(f64, f64)> = runs.iter().flat_map(ideal).collect();
        let size =
            |of: &dyn Fn(f64, f64) -> f64| high(wheels.iter().map(|&(left, right)| of(left, right).abs()).collect());
        let wheel = size(&|left: f64, right: f64| left.abs().max(right.abs()));
        let first = runs.first().ok_or(SkidError::NoRun)?;
        if wheel == 0.0 {
            return Err(SkidError::NeverDrives);
        }
        let measured = runs.iter().flat_map(|run| &run.measured).filter(|value| value.is_finite());
        let output = high(measured.map(|value| value.abs()).collect());
        let duration_s = |run: &SkidRun| run.sides.time_s.last().copied().unwrap_or(0.0) - run.sides.time_s[0];
        let tiny = f64::MIN_POSITIVE;
        Ok(Self {
            wheel,
            // A robot that only turns still has a size of speed.
            speed: size(&|left, right| geometry.ideal(left, right).forward).max(1e-3 * wheel * geometry.wheel_radius_m),
            turn: size(&|left, right| geometry.turn(left, right)),
            output: if output > 0.0 { output } else { wheel * geometry.wheel_radius_m },
            period_s: first.sides.period_s,
            duration_s: runs.iter().map(duration_s).fold(tiny, f64::max),
        })
    }
}

/// What 95 % of those that are not zero do not exceed: standing still has no size.
fn high(mut values: Vec<f64>) -> f64 {
    values.retain(|&value| value > 0.0);
    values.sort_by(f64::total_cmp);
    values.get(values.len() * 95 / 100).or(values.last()).copied().unwrap_or(0.0)
}

impl Model for SkidSteer {
    type Run = SkidRun;

    fn base(&self) -> &[Parameter] {
        // Declared, not fitted: a fitted gain would hide slip.
        &[]
    }

    fn catalogue(&self) -> &[Candidate] {
        &self.catalogue
    }

    fn initial(&self, _run: &SkidRun) -> (Vec<f64>, Vec<f64>) {
        // A run begins with the first value measured.
        (vec![], vec![])
    }

    fn predict(&self, structure: &Structure, _initial: &[f64], run: &SkidRun, predicted: &mut [f64]) {
        simulate(self, structure, run, predicted);
    }

    fn measured<'r>(&self, run: &'r SkidRun) -> &'r [f64] {
        &run.measured
    }
}

impl Family for SkidSteer {
    fn unit(&self) -> &'static str {
        match self.output {
            Output::YawRate => "rad/s",
            Output::ForwardSpeed | Output::LateralSpeed => "m/s",
        }
    }

    fn starts(&self, _runs: &[&SkidRun]) -> Vec<Vec<f64>> {
        vec![vec![]]
    }

    fn time_s<'r>(&self, run: &'r SkidRun) -> &'r [f64] {
        &run.time_s
    }

    fn name<'r>(&self, run: &'r SkidRun) -> &'r str {
        &run.name
    }

    fn input(&self, run: &SkidRun) -> (String, Vec<f64>) {
        let (name, of): (_, fn(&Ideal) -> f64) = match self.output {
            Output::YawRate | Output::LateralSpeed => ("turn without slip, rad/s", |ideal| ideal.turn),
            Output::ForwardSpeed => ("speed without slip, m/s", |ideal| ideal.forward),
        };
        (name.to_owned(), mean_over_spans(&self.geometry, run, |ideal, _| of(ideal)))
    }

    fn loadable(&self, structure: &Structure, source: &str) -> Loadable {
        Loadable::Body(Box::new(self.fitted_body(structure, source)))
    }

    fn part(&self, run: &SkidRun, from: usize, to: usize) -> SkidRun {
        run.part(from, to)
    }

    fn drivers(&self, _structure: &Structure, _initial: &[f64], run: &SkidRun) -> Vec<Driver> {
        let sides = &*run.sides;
        let turn_at = |at: usize| self.geometry.turn(sides.left[at], sides.right[at]);
        let driver = |over, unit, values| Driver { over, unit, period: None, values };
        let mean = |of: &dyn Fn(usize) -> f64| mean_over_spans(&self.geometry, run, |_, at| of(at));
        let acceleration = |at: usize| {
            let before = at.saturating_sub(1);
            if before == at { 0.0 } else { (turn_at(at) - turn_at(before)) / (sides.time_s[at] - sides.time_s[before]) }
        };
        vec![
            driver(Dependence::Input, "rad/s", mean(&turn_at)),
            driver(Dependence::Speed, "m/s", mean_over_spans(&self.geometry, run, |ideal, _| ideal.forward)),
            Driver {
                over: Dependence::Direction,
                unit: "rad",
                period: Some(CIRCLE),
                values: directions(&self.geometry, run),
            },
            driver(Dependence::Acceleration, "rad/s^2", mean(&acceleration)),
            driver(Dependence::Time, "s", mean(&|at| sides.time_s[at] - sides.time_s[0])),
        ]
    }

    fn curves(&self, current: &Fit, driver: (Dependence, Option<f64>), runs: &[&SkidRun]) -> Vec<Curve> {
        let (over, period) = driver;
        if current.structure.curves().any(|(curve, _)| curve.over == over) {
            return vec![];
        }
        let line = |low: f64, high: f64| {
            let corner = |corner| low + (high - low) * corner as f64 / (CORNERS - 1) as f64;
            if high > low { (0..CORNERS).map(corner).collect() } else { vec![] }
        };
        let (at_unit, at): (_, Vec<f64>) = match over {
            Dependence::Input => ("rad/s", line(-self.scales.turn, self.scales.turn)),
            Dependence::Speed => ("m/s", line(-self.scales.speed, self.scales.speed)),
            Dependence::Time => {
                ("s", line(0.0, runs.iter().filter_map(|run| run.time_s.last()).copied().fold(0.0, f64::max)))
            }
            Dependence::Direction => {
                let corner = |corner| (corner as f64 / CORNERS_ROUND as f64 - 0.5) * CIRCLE;
                ("rad", (0..CORNERS_ROUND).map(corner).collect())
            }
            _ => return vec![],
        };
        let push = (Acts::Push, self.unit(), 0.1 * self.scales.output);
        let gain = (Acts::Gain, "1", 0.1);
        let ways = match (over, self.output) {
            // The direction of standing still means nothing, and across the body nothing is driven.
            (Dependence::Direction, Output::LateralSpeed) => vec![],
            (Dependence::Direction, _) => vec![gain],
            (_, Output::LateralSpeed) => vec![push],
            _ => vec![push, gain],
        };
        ways.into_iter()
            .filter(|_| !at.is_empty())
            .map(|(acts, unit, scale)| Curve { over, at_unit, unit, at: at.clone(), period, acts, scale })
            .collect()
    }
}
