//! Static maps: the steady output for a constant input level, and the nonlinearities of that relation.

use std::sync::Arc;

use r4_maths::statistics;
use r4_plants::Dependence;
use thiserror::Error;

use super::plant::SettlingMap;
use crate::data::{Quantity, Run};
use crate::family::{Acts, Candidate, Curve, Driver, Family, Loadable, Model, Parameter, Range, Structure, Term};
use crate::fit::Fit;
use crate::task::{FileKind, ModelInfo, RoleInfo};

/// Reason why a recording is no map.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum MapError {
    /// A role has no column.
    #[error("{run}: no column is mapped to `{role}`: name one with --{role} COLUMN or --map {role}=COLUMN")]
    NoRole {
        /// Name of the recording.
        run: String,
        /// Name of the role, `input` or `output`.
        role: &'static str,
    },
    /// Too few rows have both an input and an output.
    #[error("{run}: {rows} rows have an input and an output, {needed} are needed: record more levels")]
    TooFew {
        /// Name of the recording.
        run: String,
        /// Number of rows with both.
        rows: usize,
        /// Smallest number of rows.
        needed: usize,
    },
    /// The input has one level only.
    #[error("the input never changes from {level}: record the output at several levels, both ways, zero among them")]
    ConstantInput {
        /// Level of the input.
        level: f64,
    },
    /// The output is constant.
    #[error("the output never changes from {value}: is it the right column, and were levels high enough to move it?")]
    ConstantOutput {
        /// Value of the output.
        value: f64,
    },
}

/// Smallest number of rows that can be fitted.
const LEAST_ROWS: usize = 8;

/// Levels in the order in which they were held, with the outputs.
#[derive(Clone, Debug, PartialEq)]
pub struct MapRun {
    name: String,
    /// Unit of the output.
    unit: &'static str,
    time_s: Arc<[f64]>,
    input: Arc<[f64]>,
    /// Supply of each row; empty if it was not recorded.
    supply: Arc<[f64]>,
    /// Signed travel of the input since its last reversal.
    since_turn: Arc<[f64]>,
    /// Index in `input` of the first row of `measured`.
    first: usize,
    measured: Vec<f64>,
}

impl MapRun {
    /// Takes the roles `input`, `output` and optionally `supply` of a recording. A row without an input keeps the
    /// level before it, and its output is not used.
    ///
    /// # Errors
    /// An error for a missing role, or fewer than eight rows with both.
    pub fn new(run: &Run) -> Result<Self, MapError> {
        let role = |role| run.values(role).ok_or_else(|| MapError::NoRole { run: run.name.clone(), role });
        let (input, output) = (role("input")?, role("output")?);
        let measured: Vec<f64> =
            input.iter().zip(output).map(|(u, &y)| if u.is_finite() && y.is_finite() { y } else { f64::NAN }).collect();
        let rows = measured.iter().filter(|y| y.is_finite()).count();
        if rows < LEAST_ROWS {
            return Err(MapError::TooFew { run: run.name.clone(), rows, needed: LEAST_ROWS });
        }
        let supply = run.values("supply").filter(|supply| supply.iter().any(|v| *v > 0.0));
        // Before the first known level the input is taken as 0.
        let input = held(input, 0.0, |u| u.is_finite());
        Ok(Self {
            name: run.name.clone(),
            unit: unit(run),
            time_s: run.time_s.clone().into(),
            since_turn: since_turn(&input),
            input,
            supply: supply.map_or_else(
                || Arc::new([]) as Arc<[f64]>,
                |supply| {
                    let first = supply.iter().copied().find(|v| *v > 0.0).unwrap_or(1.0);
                    held(supply, first, |v| v > 0.0)
                },
            ),
            first: 0,
            measured,
        })
    }

    /// Number of rows of a run that takes up a level from rest.
    const HELD: usize = 2;

    /// Returns a run in which a level is taken up from rest and held.
    fn at_rest(unit: &'static str, level: f64, supply: f64) -> Self {
        Self {
            name: String::new(),
            unit,
            time_s: Arc::new([0.0, 0.0]),
            input: Arc::new([0.0, level]),
            supply: Arc::new([supply, supply]),
            since_turn: Arc::new([0.0, level.abs()]),
            first: 0,
            measured: vec![f64::NAN; Self::HELD],
        }
    }

    /// Returns the levels of the rows of [`Model::measured`].
    #[must_use]
    pub fn input(&self) -> &[f64] {
        &self.input[self.first..self.first + self.measured.len()]
    }

    /// Returns whether the input follows the order of rows, with a correlation above 0.9.
    fn goes_one_way(&self) -> bool {
        let rows = self.input.len() as f64;
        let (mean, middle) = (self.input.iter().sum::<f64>() / rows, (rows - 1.0) / 2.0);
        let (mut uu, mut ut, mut tt) = (0.0, 0.0, 0.0);
        for (row, u) in self.input.iter().enumerate() {
            let (u, t) = (u - mean, row as f64 - middle);
            uu += u * u;
            ut += u * t;
            tt += t * t;
        }
        ut * ut > 0.81 * uu * tt
    }

    /// Iterates over input and output of the measured rows.
    fn rows(&self) -> impl Iterator<Item = (f64, f64)> {
        self.input().iter().copied().zip(self.measured.iter().copied()).filter(|(_, y)| y.is_finite())
    }
}

/// Divides one sweep into two: the second has the output of every `every`th row, counted from row `every - 1`, the
/// first has the others. Halves of a sweep would not cover the same levels. Both parts know all inputs. `None` if
/// `every` is below 2, or if a part has fewer than eight rows.
pub fn alternate_rows(run: &Run, every: usize) -> Option<(Run, Run)> {
    let only = |second: bool| {
        let mut part = run.clone();
        let output = part.signals.get_mut("output")?;
        for (row, value) in output.values.iter_mut().enumerate() {
            if (row % every == every - 1) != second {
                *value = f64::NAN;
            }
        }
        (output.values.iter().filter(|value| value.is_finite()).count() >= LEAST_ROWS).then_some(part)
    };
    if every < 2 { None } else { only(false).zip(only(true)) }
}

/// Returns the SI unit of the output of a recording.
pub(super) fn unit(run: &Run) -> &'static str {
    match run.signals.get("output").map(|signal| signal.quantity) {
        Some(Quantity::Angle) => "rad",
        Some(Quantity::AngularSpeed) => "rad/s",
        Some(Quantity::Length) => "m",
        Some(Quantity::Speed) => "m/s",
        Some(Quantity::Voltage) => "V",
        Some(Quantity::Force) => "N",
        Some(Quantity::Torque) => "N m",
        Some(Quantity::Current) => "A",
        Some(Quantity::Temperature) => "°C",
        Some(Quantity::Number) | None => "1",
    }
}

/// Replaces values that are not good by the one before, and those before the first good one by `first`.
fn held(values: &[f64], first: f64, good: impl Fn(f64) -> bool) -> Arc<[f64]> {
    let hold = |last: &mut f64, &value: &f64| {
        if good(value) {
            *last = value;
        }
        Some(*last)
    };
    values.iter().scan(first, hold).collect()
}

/// Returns the signed travel of the input since its last reversal.
fn since_turn(input: &[f64]) -> Arc<[f64]> {
    let (mut turn, mut way) = (input.first().copied().unwrap_or(0.0), 0.0);
    let step = |pair: &[f64]| {
        let step = pair[1] - pair[0];
        if step * way < 0.0 {
            turn = pair[0];
        }
        if step != 0.0 {
            way = step.signum();
        }
        pair[1] - turn
    };
    let first = input.first().map(|_| 0.0);
    first.into_iter().chain(input.windows(2).map(step)).collect()
}

/// Nonlinearity that may be part of the map.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Bend {
    DeadZone,
    StaticFriction,
    Saturation,
    GainCurve,
    QuadraticDrag,
    DirectionAsymmetry,
    Offset,
    Supply,
    SupplyDrive,
    Hysteresis,
    Settling,
    Drift,
}

impl Bend {
    const fn name(self) -> &'static str {
        match self {
            Self::DeadZone => "dead-zone",
            Self::StaticFriction => "static-friction",
            Self::Saturation => "saturation",
            Self::GainCurve => "gain-curve",
            Self::QuadraticDrag => "quadratic-drag",
            Self::DirectionAsymmetry => "direction-asymmetry",
            Self::Offset => "offset",
            Self::Supply => "supply",
            Self::SupplyDrive => "supply-drive",
            Self::Hysteresis => "hysteresis",
            Self::Settling => "slow-settling",
            Self::Drift => "drift",
        }
    }
}

/// Values of all nonlinearities, absent ones at the value without effect; `[forward, backward]` if directions differ.
#[derive(Clone, Copy, Debug)]
struct Shape {
    gain: f64,
    dead: [f64; 2],
    start: [f64; 2],
    curvature: [f64; 2],
    exponent: [f64; 2],
    sharpness: [f64; 2],
    drag: f64,
    gain_share: f64,
    offset: f64,
    supply: f64,
    supply_drive: f64,
    play: f64,
    settling_s: f64,
    drift_per_s: f64,
}

/// The model `static-map`: output = gain · input, with nonlinearities.
///
/// | role | meaning |
/// | --- | --- |
/// | `input` | duty or command, any unit |
/// | `output` | speed or whatever else settles |
/// | `supply` | may be missing; its unit cancels |
///
/// Let x be the part of |input| above the dead zone, and d its direction; parameters may differ between directions.
/// With saturation, `output = d · gain · x / (1 + (c x)^n)^(1/n)`; a gain curve replaces x by `X (x / X)^p`. A
/// sharpness n of 1 bends softly, one of 8 and above is nearly a clip.
#[derive(Clone, Debug)]
pub struct StaticMap {
    base: Vec<Parameter>,
    catalogue: Vec<Candidate>,
    /// Nonlinearity of each entry of the catalogue, with the directions that its parameters belong to.
    bends: Vec<(Bend, Vec<usize>)>,
    unit: &'static str,
    /// Largest magnitude of the input.
    span: f64,
    /// Lowest and highest level.
    seen: [f64; 2],
    /// Range of the input over which a start from rest is smoothed, so that its level has a gradient.
    smear: f64,
    /// Largest magnitude of the output.
    height: f64,
    /// Supply at which `gain` holds.
    supply_ref: f64,
    /// True if the level only changed in one direction: then time and history are collinear with the level.
    one_way: bool,
}

impl StaticMap {
    /// Creates a model for some runs, which set ranges, initial guesses and the effects that can be tried.
    ///
    /// # Errors
    /// An error for a constant input or output.
    pub fn new(runs: &[&MapRun], unit: &'static str) -> Result<Self, MapError> {
        let rows = || runs.iter().flat_map(|run| run.rows());
        let (low, high) = extent(rows().map(|(u, _)| u));
        if low >= high {
            return Err(MapError::ConstantInput { level: low });
        }
        let (least, most) = extent(rows().map(|(_, y)| y));
        if least >= most {
            return Err(MapError::ConstantOutput { value: least });
        }
        let (span, height) = (low.abs().max(high.abs()), least.abs().max(most.abs()));
        let mut steps: Vec<f64> = Vec::new();
        for run in runs {
            let levels: Vec<f64> = run.rows().map(|(u, _)| u).collect();
            steps.extend(levels.windows(2).map(|pair| (pair[1] - pair[0]).abs()).filter(|step| *step > 0.0));
        }
        let supplies: Vec<f64> = runs.iter().flat_map(|run| run.supply.iter().copied()).collect();
        // Referred to the median supply, the gain hardly correlates with the exponent of the supply.
        let supply_ref = if supplies.is_empty() { 1.0 } else { median(&supplies) };
        let mut map = Self {
            base: vec![Parameter {
                name: "gain",
                unit: "output/input",
                range: Range::Any { scale: height / span },
                absent: None,
            }],
            catalogue: Vec::new(),
            bends: Vec::new(),
            unit,
            span,
            seen: [low, high],
            // With an eighth of the median step, the rows next to a start in the middle between them are off by 2 %
            // of the jump.
            smear: (median(&steps) / 8.0).max(1e-4 * span),
            height,
            supply_ref,
            one_way: runs.iter().all(|run| run.goes_one_way()),
        };
        let found = Found::of(runs, height, span);
        for bend in BENDS {
            if let Some((candidate, sides)) = map.candidate(bend, &found) {
                map.bends.push((bend, sides));
                map.catalogue.push(candidate);
            }
        }
        Ok(map)
    }

    /// Name of the model, for `--model`.
    pub const NAME: &str = "static-map";

    /// Returns the description for the list of models.
    #[must_use]
    pub fn info() -> ModelInfo {
        let role = |name, required, driving, what| RoleInfo { name, required, driving, what };
        ModelInfo {
            name: Self::NAME,
            summary: "a level that is held to what the output settles at",
            roles: vec![
                role("input", true, true, "level: duty, volts, any command"),
                role("output", true, false, "what settles, such as a speed"),
                role("supply", false, true, "voltage of the supply"),
            ],
            parameters: vec![],
            effects: BENDS.iter().map(|bend| bend.name()).collect(),
            file: FileKind::Plant,
        }
    }

    /// Returns the model for some recordings, and the prepared recordings: those to fit to and those held out.
    ///
    /// # Errors
    /// Errors of [`MapRun::new`] and [`StaticMap::new`].
    pub fn prepare(train: &[Run], holdout: &[Run]) -> Result<(Self, Vec<MapRun>, Vec<MapRun>), MapError> {
        let make = |runs: &[Run]| runs.iter().map(MapRun::new).collect::<Result<Vec<_>, _>>();
        let (train, holdout) = (make(train)?, make(holdout)?);
        Ok((Self::new(&train.iter().collect::<Vec<_>>(), train.first().map_or("1", |run| run.unit))?, train, holdout))
    }

    /// Returns the supply at which the gain and all levels hold, in the unit of the recording; 1 if none was
    /// recorded.
    #[must_use]
    pub fn supply_ref(&self) -> f64 {
        self.supply_ref
    }

    fn candidate(&self, bend: Bend, found: &Found) -> Option<(Candidate, Vec<usize>)> {
        use Dependence::{Direction, History, Input, Speed, Supply, Time};
        let (span, height) = (self.span, self.height);
        let one = |name, unit, range, absent| vec![Parameter { name, unit, range, absent: Some(absent) }];
        // One parameter for each recorded direction; that of a single direction holds for both.
        let sides = if bend == Bend::StaticFriction { found.started() } else { found.moved() };
        let each = |names: [&'static str; 2], unit, range, absent| -> Vec<Parameter> {
            sides.iter().flat_map(|&side| one(names[side], unit, range, absent)).collect()
        };
        let both = |values: &[f64]| -> Vec<Vec<f64>> { values.iter().map(|&value| vec![value; sides.len()]).collect() };
        let levels = |found: [f64; 2]| sides.iter().map(|&side| found[side]).collect::<Vec<f64>>();
        let shares = |values: &[f64]| values.iter().map(|share| vec![share * span]).collect::<Vec<_>>();
        let (depends_on, parameters, starts, experiment): (&'static [Dependence], _, _, _) = match bend {
            Bend::DeadZone => (
                &[Input, Direction],
                each(["forward", "backward"], "input", Range::NotNegative { scale: 0.02 * span }, 0.0),
                [vec![levels(found.dead)], both(&[0.05 * span, 0.2 * span])].concat(),
                "hold levels about zero, close together, in both directions",
            ),
            Bend::StaticFriction => (
                &[Input, Direction, History],
                each(["start_forward", "start_backward"], "input", Range::NotNegative { scale: 0.05 * span }, 0.0),
                // The start level has no gradient from afar, so the fit begins at both ends and in the middle of the
                // observed range.
                found.starts.map(levels).to_vec(),
                "from rest, raise the level until it moves, then lower it until it stops; both directions, several times",
            ),
            Bend::Saturation => (
                &[Input, Direction],
                [
                    each(["forward", "backward"], "1/input", Range::NotNegative { scale: 0.1 / span }, 0.0),
                    sides
                        .iter()
                        .map(|&side| Parameter {
                            name: ["sharpness_forward", "sharpness_backward"][side],
                            unit: "1",
                            range: Range::Between(SHARPNESS[0], SHARPNESS[1]),
                            absent: None,
                        })
                        .collect(),
                ]
                .concat(),
                [[1.0, 6.0], [4.0, 1.5], [4.0, 6.0], [10.0, 1.5]]
                    .map(|[curvature, sharpness]| {
                        [vec![curvature / span; sides.len()], vec![sharpness; sides.len()]].concat()
                    })
                    .to_vec(),
                "hold levels up to the largest, evenly spaced, in both directions",
            ),
            Bend::GainCurve => (
                &[Input, Direction],
                each(["exponent_forward", "exponent_backward"], "1", Range::Between(0.1, 6.0), 1.0),
                both(&[0.7, 1.5]),
                "hold levels evenly spaced from just above the dead-zone to the largest",
            ),
            Bend::QuadraticDrag => (
                &[Speed],
                one("share", "1/output", Range::NotNegative { scale: 0.05 / height }, 0.0),
                vec![vec![0.3 / height], vec![2.0 / height]],
                "hold levels up to the largest, once more with the load taken off",
            ),
            Bend::DirectionAsymmetry => (
                &[Direction],
                one("share", "1", Range::Between(-1.0, 1.0), 0.0),
                vec![vec![0.1], vec![-0.1]],
                "hold the same levels in both directions",
            ),
            Bend::Offset => (
                &[],
                one("output", self.unit, Range::Any { scale: 0.02 * height }, 0.0),
                vec![vec![0.0]],
                "record the output with the supply off",
            ),
            Bend::Supply => (
                &[Supply],
                one("exponent", "1", Range::Any { scale: 0.2 }, 0.0),
                vec![vec![1.0]],
                "the same levels at two supply voltages at least 10 % apart",
            ),
            Bend::SupplyDrive => (
                &[Supply, Input],
                one("exponent", "1", Range::Any { scale: 0.2 }, 0.0),
                vec![vec![1.0]],
                "the same levels, small ones among them, at two supply voltages at least 10 % apart",
            ),
            Bend::Hysteresis => (
                &[Input, History],
                one("half_width", "input", Range::NotNegative { scale: 0.02 * span }, 0.0),
                shares(&[0.02, 0.1]),
                "sweep up and down over the same levels, twice, once with longer holds",
            ),
            Bend::Settling => (
                &[History, Time],
                one("time_s", "s", Range::NotNegative { scale: 0.2 * found.row_s }, 0.0),
                vec![vec![0.5 * found.row_s], vec![2.0 * found.row_s]],
                "the same levels held ten times as long",
            ),
            Bend::Drift => (
                &[Time],
                one("per_s", "1/s", Range::Any { scale: 0.02 / found.length_s }, 0.0),
                vec![vec![0.0]],
                "one level held as long as the whole sweep, and the sweep repeated after it",
            ),
        };
        let offered = match bend {
            Bend::DirectionAsymmetry => found.moving == [true, true],
            Bend::StaticFriction => !sides.is_empty(),
            Bend::Supply | Bend::SupplyDrive => found.supply_changes,
            Bend::Hysteresis => found.up_and_down,
            Bend::Settling => found.row_s > 0.0,
            Bend::Drift => found.length_s > 0.0 && !self.one_way,
            _ => true,
        };
        // Saturation has a shape of its own that can reproduce these.
        let excludes: &[&str] =
            if matches!(bend, Bend::GainCurve | Bend::QuadraticDrag) { &["saturation"] } else { &[] };
        offered.then_some((
            Candidate { name: bend.name(), depends_on, parameters, starts, experiment, excludes, led_by: None },
            sides,
        ))
    }

    fn shape(&self, structure: &Structure) -> Shape {
        let mut shape = Shape {
            gain: structure.base.first().copied().unwrap_or(0.0),
            dead: [0.0; 2],
            start: [0.0; 2],
            curvature: [0.0; 2],
            exponent: [1.0; 2],
            sharpness: [1.0; 2],
            drag: 0.0,
            gain_share: 0.0,
            offset: 0.0,
            supply: 0.0,
            supply_drive: 0.0,
            play: 0.0,
            settling_s: 0.0,
            drift_per_s: 0.0,
        };
        for (term, values) in structure.terms.iter().zip(&structure.added) {
            let (Term::Known(place), Some(&value)) = (term, values.first()) else { continue };
            let Some((bend, sides)) = self.bends.get(*place) else { continue };
            let each = of_sides(sides, values);
            match bend {
                Bend::DeadZone => shape.dead = each,
                Bend::StaticFriction => {
                    // The other direction has no observed start, so it has none in the model.
                    sides.iter().for_each(|&side| shape.start[side] = each[side]);
                }
                Bend::Saturation => {
                    shape.curvature = each;
                    if let Some(sharpness) = values.get(sides.len()..).filter(|values| !values.is_empty()) {
                        shape.sharpness = of_sides(sides, sharpness);
                    }
                }
                Bend::GainCurve => shape.exponent = each,
                Bend::QuadraticDrag => shape.drag = value,
                Bend::DirectionAsymmetry => shape.gain_share = value,
                Bend::Offset => shape.offset = value,
                Bend::Supply => shape.supply = value,
                Bend::SupplyDrive => shape.supply_drive = value,
                Bend::Hysteresis => shape.play = value,
                Bend::Settling => shape.settling_s = value,
                Bend::Drift => shape.drift_per_s = value,
            }
        }
        shape
    }
}

/// Returns one value for each direction; a single one holds for both.
fn of_sides(sides: &[usize], values: &[f64]) -> [f64; 2] {
    let mut each = [values[0]; 2];
    for (&side, &value) in sides.iter().zip(values) {
        each[side] = value;
    }
    each
}

const BENDS: [Bend; 12] = [
    Bend::DeadZone,
    Bend::Saturation,
    Bend::GainCurve,
    Bend::QuadraticDrag,
    Bend::StaticFriction,
    Bend::DirectionAsymmetry,
    Bend::Offset,
    Bend::Supply,
    Bend::SupplyDrive,
    Bend::Hysteresis,
    Bend::Settling,
    Bend::Drift,
];

/// Properties of the recordings that guide the fit; `[forward, backward]`.
struct Found {
    /// Largest level without an output.
    dead: [f64; 2],
    /// Smallest, median and largest level at which it started from rest; 0 if it never did.
    starts: [[f64; 2]; 3],
    moving: [bool; 2],
    up_and_down: bool,
    supply_changes: bool,
    /// Median time between rows, s.
    row_s: f64,
    /// Duration of the longest run, s.
    length_s: f64,
}

impl Found {
    fn of(runs: &[&MapRun], height: f64, span: f64) -> Self {
        // Outputs below 2 % of the largest are rest: more than a speed from counted edges shows at rest.
        let still = |y: f64| y.abs() < 0.02 * height;
        let mut dead = [0.0f64; 2];
        let mut moving = [false; 2];
        let mut starts: [Vec<f64>; 2] = [Vec::new(), Vec::new()];
        let (mut up, mut down) = (0usize, 0usize);
        let mut rows_s = Vec::new();
        let mut length_s = 0.0f64;
        for run in runs {
            let rows: Vec<(f64, f64)> = run.rows().collect();
            for &(u, y) in &rows {
                let side = usize::from(u < 0.0);
                if !still(y) {
                    moving[side] = true;
                } else if u.abs() < span {
                    dead[side] = dead[side].max(u.abs());
                }
            }
            for pair in rows.windows(2) {
                let [(u0, y0), (u1, y1)] = [pair[0], pair[1]];
                up += usize::from(u1 > u0);
                down += usize::from(u1 < u0);
                if still(y0) && !still(y1) && u1.abs() > u0.abs() && u0 * u1 >= 0.0 {
                    // The start lies somewhere between the two levels.
                    starts[usize::from(u1 < 0.0)].push(f64::midpoint(u0.abs(), u1.abs()));
                }
            }
            let window = &run.time_s[run.first..run.first + run.measured.len()];
            rows_s.extend(window.windows(2).map(|pair| pair[1] - pair[0]));
            length_s = length_s.max(window.last().zip(window.first()).map_or(0.0, |(last, first)| last - first));
        }
        let (low, high) = extent(runs.iter().flat_map(|run| run.supply.iter().copied()));
        let [mut forward, mut backward] = starts;
        let middle = [median(&forward), median(&backward)];
        [&mut forward, &mut backward].into_iter().for_each(|levels| levels.sort_unstable_by(f64::total_cmp));
        Self {
            dead,
            starts: [
                [forward.first(), backward.first()].map(|level| level.copied().unwrap_or(0.0)),
                middle,
                [forward.last(), backward.last()].map(|level| level.copied().unwrap_or(0.0)),
            ],
            moving,
            // At least one step in ten must go the other way.
            up_and_down: up.min(down) * 10 >= up.max(down) && up.min(down) > 1,
            // A change of less than 2 % shows an exponent only through its noise.
            supply_changes: high > 1.02 * low,
            row_s: median(&rows_s),
            length_s,
        }
    }

    /// Returns the directions in which it moved.
    fn moved(&self) -> Vec<usize> {
        (0..2).filter(|&side| self.moving[side]).collect()
    }

    /// Returns the directions in which it started from rest.
    fn started(&self) -> Vec<usize> {
        (0..2).filter(|&side| self.starts[0][side] > 0.0).collect()
    }
}

/// Returns the smallest and the largest value; (∞, -∞) if there are none.
fn extent(values: impl Iterator<Item = f64>) -> (f64, f64) {
    values.fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), value| (low.min(value), high.max(value)))
}

/// Returns the median of the values that are not NaN; 0 if there are none.
pub(crate) fn median(values: &[f64]) -> f64 {
    let known: Vec<f64> = values.iter().copied().filter(|value| !value.is_nan()).collect();
    statistics::median(&known).unwrap_or(0.0)
}

/// Range of the sharpness; at its upper end the corner differs from that of a clip by 4 %.
const SHARPNESS: [f64; 2] = [0.5, 16.0];

/// Returns `x / (1 + (c x)^n)^(1/n)`: x if it is small, 1/c if it is large, with a corner between for a large n.
fn saturated(x: f64, c: f64, n: f64) -> f64 {
    let share = c * x;
    if share <= 0.0 {
        x
    } else if share <= 1.0 {
        x / (1.0 + share.powf(n)).powf(1.0 / n)
    } else {
        1.0 / c / (1.0 + share.powf(-n)).powf(1.0 / n)
    }
}

/// Returns the solution y of `y + drag y² = x`.
fn dragged(x: f64, drag: f64) -> f64 {
    2.0 * x / (1.0 + (1.0 + 4.0 * drag * x).sqrt())
}

impl Shape {
    /// Returns the row from which the prediction of row `first` depends on nothing earlier.
    fn begin(&self, first: usize, level: impl Fn(usize) -> f64) -> usize {
        if self.play > 0.0 || self.settling_s > 0.0 {
            return 0;
        }
        if self.start == [0.0; 2] {
            return first;
        }
        // The state is known where the level forces rest or motion.
        let known = |row: usize| {
            let level = level(row);
            let side = usize::from(level < 0.0);
            level.abs() <= self.dead[side] || level.abs() > self.start[side].max(self.dead[side])
        };
        (0..first).rev().find(|&row| known(row)).unwrap_or(0)
    }

    /// Returns the output for the part `x` of a level above the dead zone of its direction.
    fn output(&self, x: f64, backward: usize, scale: f64) -> f64 {
        let exponent = self.exponent[backward];
        let way = if backward == 0 { 1.0 } else { -1.0 };
        #[expect(clippy::float_cmp, reason = "exactly one where there is no gain curve")]
        let x = if exponent == 1.0 { x } else { scale * (x / scale).powf(exponent) };
        let x = saturated(x, self.curvature[backward], self.sharpness[backward]);
        let size = self.gain.abs() * (1.0 + way * self.gain_share);
        way * self.gain.signum() * dragged(size * x, self.drag)
    }
}

impl Model for StaticMap {
    type Run = MapRun;

    fn base(&self) -> &[Parameter] {
        &self.base
    }

    fn catalogue(&self) -> &[Candidate] {
        &self.catalogue
    }

    fn initial(&self, _: &MapRun) -> (Vec<f64>, Vec<f64>) {
        (Vec::new(), Vec::new())
    }

    /// Predicts the outputs of a machine that was at rest at level zero before the first row.
    fn predict(&self, structure: &Structure, _: &[f64], run: &MapRun, predicted: &mut [f64]) {
        let shape = self.shape(structure);
        // Half of the range as the fixed point of a gain curve, so that its exponent hardly changes the gain.
        let scale = 0.5 * self.span;
        let (mut level, mut settled) = (0.0f64, 0.0);
        // Direction of the current motion, `None` at rest.
        let mut moving = None;
        let end = run.first + run.measured.len();
        let supply = |row: usize| run.supply.get(row).map_or(1.0, |supply| supply / self.supply_ref);
        let driven = |row: usize| {
            run.input[row] * if shape.supply_drive == 0.0 { 1.0 } else { supply(row).powf(shape.supply_drive) }
        };
        for row in shape.begin(run.first, driven)..end {
            let (supply, input) = (supply(row), driven(row));
            // Play: the level follows the input at a distance of at most its half width.
            level = level.clamp(input - shape.play, input + shape.play);
            let backward = usize::from(level < 0.0);
            let dead = shape.dead[backward];
            let above = level.abs() - dead;
            let mut target = 0.0;
            if above > 0.0 {
                target = shape.output(above, backward, scale);
                let start = shape.start[backward];
                if start > 0.0 && moving != Some(backward) {
                    // A logistic function instead of a step gives the start level a gradient.
                    let over = (level.abs() - start.max(dead)) / self.smear;
                    let started = 1.0 / (1.0 + (-over).exp());
                    moving = (started > 0.5).then_some(backward);
                    target *= started;
                }
            } else {
                moving = None;
            }
            if shape.supply != 0.0 {
                target *= supply.powf(shape.supply);
            }
            target *= 1.0 + shape.drift_per_s * run.time_s[row];
            // The first row has no predecessor and counts as settled.
            let passed_s = row.checked_sub(1).map_or(f64::INFINITY, |before| run.time_s[row] - run.time_s[before]);
            settled = if shape.settling_s > 0.0 {
                target + (settled - target) * (-passed_s / shape.settling_s).exp()
            } else {
                target
            };
            if row >= run.first {
                predicted[row - run.first] = settled + shape.offset;
            }
        }
        for (curve, values) in structure.curves() {
            let spline = curve.spline(values);
            for (at, out) in predicted.iter_mut().enumerate() {
                *out += spline.value(run.driver(curve.over, run.first + at, self.supply_ref));
            }
        }
    }

    fn measured<'r>(&self, run: &'r MapRun) -> &'r [f64] {
        &run.measured
    }
}

impl Family for StaticMap {
    fn unit(&self) -> &'static str {
        self.unit
    }

    /// Returns the slope of the regression through zero, and a steeper one for maps that saturate.
    fn starts(&self, runs: &[&MapRun]) -> Vec<Vec<f64>> {
        let (mut uy, mut uu) = (0.0, 0.0);
        for (u, y) in runs.iter().flat_map(|run| run.rows()) {
            uy += u * y;
            uu += u * u;
        }
        let slope = if uu > 0.0 { uy / uu } else { 0.0 };
        vec![vec![slope], vec![3.0 * slope]]
    }

    fn time_s<'r>(&self, run: &'r MapRun) -> &'r [f64] {
        &run.time_s[run.first..run.first + run.measured.len()]
    }

    fn name<'r>(&self, run: &'r MapRun) -> &'r str {
        &run.name
    }

    fn part(&self, run: &MapRun, from: usize, to: usize) -> MapRun {
        let to = to.min(run.measured.len());
        let from = from.min(to);
        MapRun { first: run.first + from, measured: run.measured[from..to].to_vec(), ..run.clone() }
    }

    /// Cuts blocks of four rows: rows are nearly independent, and a map is not used beyond the levels it was fitted
    /// to.
    fn blocks(&self, run: &MapRun) -> Option<usize> {
        Some(run.rows().count() / 4)
    }

    fn drivers(&self, _: &Structure, _: &[f64], run: &MapRun) -> Vec<Driver> {
        use Dependence::{Direction, History, Input, Supply, Time};
        let of = |over, unit| {
            let values = (0..run.measured.len()).map(|at| run.driver(over, run.first + at, self.supply_ref)).collect();
            Driver { over, unit, period: None, values }
        };
        let mut drivers = vec![of(Input, "input"), of(Direction, "1"), of(Time, "s"), of(History, "input")];
        if !run.supply.is_empty() {
            drivers.push(of(Supply, "1"));
        }
        drivers
    }

    fn input(&self, run: &MapRun) -> (String, Vec<f64>) {
        ("input".to_owned(), run.input().to_vec())
    }

    /// Returns a plant that settles at the map's value when a level is taken up from rest.
    fn loadable(&self, structure: &Structure, source: &str) -> Loadable {
        let (structure, left_out) = super::of_the_level(self, structure);
        let settles_at = |level: f64| {
            let run = MapRun::at_rest(self.unit, level, self.supply_ref);
            let mut settled = [0.0; MapRun::HELD];
            self.predict(&structure, &[], &run, &mut settled);
            settled[MapRun::HELD - 1]
        };
        let map = SettlingMap {
            unit: self.unit,
            source,
            full: if self.span <= 1.0 { 1.0 } else { self.span },
            seen: self.seen,
            supply_v: (self.supply_ref != 1.0).then_some(self.supply_ref),
            settles_at: &settles_at,
            left_out,
        };
        Loadable::Plant(map.plant_file())
    }

    fn curves(&self, _: &Fit, (over, period): (Dependence, Option<f64>), runs: &[&MapRun]) -> Vec<Curve> {
        use Dependence::{History, Input, Supply, Time};
        let at_unit = match over {
            Time | History if self.one_way => return vec![],
            Input | History => "input",
            Time => "s",
            Supply => "1",
            _ => return vec![],
        };
        let mut seen: Vec<f64> = Vec::new();
        for run in runs {
            let rows = run.measured.iter().enumerate().filter(|(_, y)| y.is_finite());
            seen.extend(rows.map(|(at, _)| run.driver(over, run.first + at, self.supply_ref)));
        }
        seen.sort_unstable_by(f64::total_cmp);
        let Some((&low, &high)) = seen.first().zip(seen.last()) else { return vec![] };
        // Equal levels must not become two knots.
        let gap = 1e-3 * (high - low);
        // Knots are dense where rows are: at least six rows to a piece, and at most twelve pieces.
        let pieces = (seen.len() / 6).min(12);
        let mut at: Vec<f64> = Vec::new();
        for piece in 0..=pieces {
            let value = seen[piece * (seen.len() - 1) / pieces.max(1)];
            if at.last().is_none_or(|&last| value > last + gap) {
                at.push(value);
            }
        }
        if at.len() < 3 {
            return vec![];
        }
        vec![Curve { over, at_unit, unit: self.unit, at, period, acts: Acts::Push, scale: 0.02 * self.height }]
    }
}

impl MapRun {
    /// Returns the value that the output of a row may depend on. History is the signed travel of the input since its
    /// last reversal.
    fn driver(&self, over: Dependence, row: usize, supply_ref: f64) -> f64 {
        match over {
            Dependence::Input => self.input[row],
            Dependence::Direction if self.input[row] == 0.0 => 0.0,
            Dependence::Direction => self.input[row].signum(),
            Dependence::Supply => self.supply.get(row).map_or(1.0, |supply| supply / supply_ref),
            Dependence::Time => self.time_s[row],
            Dependence::History => self.since_turn[row],
            _ => f64::NAN,
        }
    }
}

#[cfg(test)]
mod tests;
