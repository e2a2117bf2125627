//! The model `skid-steer`: motion of a skid-steered robot's body from the speeds of its sides.
//!
//! | role | unit | |
//! | --- | --- | --- |
//! | `left`, `right` | rad/s or m/s | speed of the wheels of each side, or their commands |
//! | `gyro` | rad/s | yaw rate, positive to the left |
//! | `yaw` | rad | yaw angle; jumps by a turn are removed |
//! | `x`, `y` | m | position, for the speeds along and across the body |
//! | `wheel_left`, `wheel_right` | rad/s or m/s | speed of the wheels as an output, if `left` and `right` are commands |
//!
//! The base model is the ideal differential drive with the declared geometry. None of it is fitted: its error is that
//! of a prediction without slip. The output is one of [`Output`], which the RMSE refers to.
//!
//! The comparison is sample by sample, or with `average_s` by means over successive spans of this length, with the
//! mean of the free-run simulation over the same samples.
//!
//! ```text
//! sides → delay of the drives or the encoders → lag per side → scale, dead zone → ideal motion → slip → limits → slew → lag → sensor
//! ```
//!
//! The sides' speeds are interpolated linearly between samples: a command that steps is late by half a sample on
//! average.

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

/// Number of knots of a curve over a line, and over the circle of directions.
const CORNERS: usize = 9;
const CORNERS_ROUND: usize = 16;

/// Geometry of the robot, which is declared.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Geometry {
    /// Radius of the wheels, m.
    pub wheel_radius_m: f64,
    /// Track: distance between the middles of the left and right wheels, m.
    pub track_m: f64,
}

impl Geometry {
    /// Returns the yaw rate without slip, rad/s, from the sides' speeds, rad/s; positive to the left.
    #[must_use]
    pub fn turn(&self, left: f64, right: f64) -> f64 {
        self.wheel_radius_m * (right - left) / self.track_m
    }
}

/// Motion of the body that is modelled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Output {
    /// Yaw rate, rad/s, from the gyro, the yaw angle or the wheels; positive to the left.
    YawRate,
    /// Speed along the body, m/s, from the pose.
    ForwardSpeed,
    /// Speed across the body, m/s, positive to the left, from the pose.
    LateralSpeed,
}

impl Output {
    /// All outputs, in the order of the list of models.
    pub const ALL: [Self; 3] = [Self::YawRate, Self::ForwardSpeed, Self::LateralSpeed];

    /// Returns the name of the model with this output.
    #[must_use]
    pub const fn model(self) -> &'static str {
        match self {
            Self::YawRate => "skid-steer",
            Self::ForwardSpeed => "skid-steer-forward",
            Self::LateralSpeed => "skid-steer-lateral",
        }
    }

    /// Returns the name of the quantity that the RMSE refers to.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::YawRate => "yaw rate",
            Self::ForwardSpeed => "forward speed",
            Self::LateralSpeed => "lateral speed",
        }
    }
}

/// Declared parameters of the model.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Declared {
    /// Geometry of the robot.
    pub geometry: Geometry,
    /// Length of the spans whose means are compared, s; `None` to compare samples.
    pub average_s: Option<f64>,
}

impl Declared {
    /// Reads the parameters given as `--param name=value`.
    ///
    /// # Errors
    /// An error for a missing or invalid length, or a name that the model does not have.
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

/// Model of a skid-steered robot for one output.
#[derive(Clone, Debug)]
pub struct SkidSteer {
    geometry: Geometry,
    output: Output,
    scales: Scales,
    /// Effects in the order of the catalogue.
    effects: Vec<Effect>,
    catalogue: Vec<Candidate>,
    /// Speeds of the sides at which the robot turned, rad/s: there the body has to turn as the model does.
    turns: Vec<(f64, f64)>,
    /// Body of the robot: the known one, or one on four wheels of the declared geometry.
    body: Wheeled,
    is_body_known: bool,
}

impl SkidSteer {
    /// Creates the model for some runs, and prepares these.
    ///
    /// # Errors
    /// An error for a role without a column, a column in another unit, or runs in which no slip could be seen.
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

    /// Returns the model with the known body of the robot; fitted values replace those in it.
    #[must_use]
    pub fn with_body(self, known: Option<Wheeled>) -> Self {
        match known {
            Some(body) => Self { body, is_body_known: true, ..self },
            None => self,
        }
    }

    /// Returns the description for the list of models.
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

    /// Prepares a run for a model that was created from other runs.
    ///
    /// # Errors
    /// Errors of [`SkidSteer::new`].
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
            // A robot that only turns on the spot must still have a scale of speed.
            speed: size(&|left, right| geometry.ideal(left, right).forward).max(1e-3 * wheel * geometry.wheel_radius_m),
            turn: size(&|left, right| geometry.turn(left, right)),
            output: if output > 0.0 { output } else { wheel * geometry.wheel_radius_m },
            period_s: first.sides.period_s,
            duration_s: runs.iter().map(duration_s).fold(tiny, f64::max),
        })
    }
}

/// Returns the 95 % quantile of the values above zero, 0 without any: standing still does not count.
fn high(mut values: Vec<f64>) -> f64 {
    values.retain(|&value| value > 0.0);
    values.sort_by(f64::total_cmp);
    values.get(values.len() * 95 / 100).or(values.last()).copied().unwrap_or(0.0)
}

impl Model for SkidSteer {
    type Run = SkidRun;

    fn base(&self) -> &[Parameter] {
        // The geometry is declared: a fitted gain would hide slip.
        &[]
    }

    fn catalogue(&self) -> &[Candidate] {
        &self.catalogue
    }

    fn initial(&self, _run: &SkidRun) -> (Vec<f64>, Vec<f64>) {
        // A run begins with the first measured value, so there is nothing to fit.
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
        // A second curve over the same quantity would be nearly collinear with the first.
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
            // At rest the direction is undefined, and the drives cause no lateral speed.
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
