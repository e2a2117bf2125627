//! Tests with the recording of a Husky robot: `data/husky_skidsteer`.

use std::{collections::BTreeMap, path::Path};

use r4_maths::statistics::RootMeanSquare;

use super::{Declared, Geometry, Model, Output, SkidRun, SkidSteer, run};
use crate::{
    data::Run,
    family::{Structure, Term},
    fit::{Effort, fit, guessed, residuals},
    select::search,
};

/// Geometry from the recording's README.
pub(super) const GEOMETRY: Geometry = Geometry { wheel_radius_m: 0.165, track_m: 0.55 };
const PERIOD_S: f64 = 0.05;
/// Number of samples in a window of 2 s.
const WINDOW: usize = 40;

/// Consecutive windows of one step of the command. The file counts some transient windows to the step before.
struct Step {
    even: bool,
    /// True for each window in steady state.
    steady: Vec<bool>,
    columns: BTreeMap<String, Vec<f64>>,
}

fn steps() -> Vec<Step> {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data/husky_skidsteer/husky.csv");
    let mut table = csv::Reader::from_path(path).unwrap();
    let names: Vec<String> = table.headers().unwrap().iter().map(str::to_owned).collect();
    let mut steps: Vec<Step> = Vec::new();
    for (sample, row) in table.records().enumerate() {
        let row = row.unwrap();
        let steady = &row[2] == "1";
        if sample % WINDOW == 0 {
            if !steady {
                steps.push(Step { even: false, steady: vec![], columns: BTreeMap::new() });
            }
            steps.last_mut().unwrap().steady.push(steady);
        }
        let step = steps.last_mut().unwrap();
        // The number of the last window is that of its step.
        step.even = row[0].parse::<u32>().unwrap() % 2 == 0;
        for (name, value) in names.iter().zip(&row) {
            step.columns.entry(name.clone()).or_default().push(value.parse().unwrap());
        }
    }
    steps
}

/// Returns the runs of even and of odd steps.
fn even_and_odd(roles: &[(&'static str, &str)], steady_only: bool) -> [Vec<Run>; 2] {
    let mut runs = [Vec::new(), Vec::new()];
    for (number, step) in steps().into_iter().enumerate() {
        let column = |&(role, column): &(&'static str, &str)| {
            let mut values = step.columns[column].clone();
            if steady_only && !matches!(role, "left" | "right") {
                let transient = (0..values.len()).filter(|sample| !step.steady[sample / WINDOW]);
                transient.for_each(|sample| values[sample] = f64::NAN);
            }
            (role, values)
        };
        let roles: Vec<_> = roles.iter().map(column).collect();
        runs[usize::from(!step.even)].push(run(&format!("step {number}"), PERIOD_S, &roles));
    }
    runs
}

struct Split {
    family: SkidSteer,
    fitted: Vec<SkidRun>,
    held_out: Vec<SkidRun>,
}

fn split(roles: &[(&'static str, &str)], average_s: Option<f64>, output: Output, steady_only: bool) -> Split {
    let declared = Declared { geometry: GEOMETRY, average_s };
    let [even, odd] = even_and_odd(roles, steady_only);
    let (family, fitted) = SkidSteer::new(declared, output, &even).unwrap();
    let held_out = odd.iter().map(|run| family.run(declared, run).unwrap()).collect();
    Split { family, fitted, held_out }
}

/// Returns the RMSE of a free-run simulation, and the number of values in it.
fn rmse(family: &SkidSteer, runs: &[SkidRun], structure: &Structure) -> (f64, usize) {
    let residuals = runs.iter().flat_map(|run| residuals(family, structure, &[], run));
    let known: RootMeanSquare = residuals.filter(|residual| residual.is_finite()).collect();
    (known.value().unwrap_or(f64::NAN), known.count())
}

const WHEELS: [(&str, &str); 3] = [("left", "wheel_left_rad_s"), ("right", "wheel_right_rad_s"), ("yaw", "yaw_rad")];
const COMMANDS: [(&str, &str); 4] = [
    ("left", "cmd_left_rad_s"),
    ("right", "cmd_right_rad_s"),
    ("wheel_left", "wheel_left_rad_s"),
    ("wheel_right", "wheel_right_rad_s"),
];

const POSE: [(&str, &str); 5] =
    [("left", "wheel_left_rad_s"), ("right", "wheel_right_rad_s"), ("x", "x_m"), ("y", "y_m"), ("yaw", "yaw_rad")];

/// Result of a search: name and values of each effect, and the held-out RMSE before and after, which it prints.
struct Outcome {
    effects: Vec<(&'static str, Vec<f64>)>,
    before: f64,
    after: f64,
}

impl Outcome {
    fn of(what: &str, split: &Split) -> Self {
        let Split { family, fitted, held_out } = split;
        let found = search(family, fitted, &|_| ());
        let name = |term: &Term| match term {
            Term::Known(index) => family.catalogue()[*index].name,
            Term::Curve(_) => "unknown",
        };
        println!("{what}, RMSE of the {}: fitted, held out", family.output.name());
        let line = |what: &str, structure: &Structure, values: &[f64]| {
            let (fitted, held_out) = (rmse(family, fitted, structure).0, rmse(family, held_out, structure).0);
            println!("  {what:26} {fitted:.4}  {held_out:.4}  {values:.4?}");
            held_out
        };
        let before = line("base", &found.base.structure, &[]);
        for step in &found.steps {
            println!("    {:24} {:.4} on left-out blocks", name(&step.term), step.blocked_rmse[1]);
        }
        let Structure { terms, added, .. } = &found.last.structure;
        let mut so_far = Structure::default();
        for (term, values) in terms.iter().zip(added) {
            so_far.terms.push(term.clone());
            so_far.added.push(values.clone());
            let runs: Vec<&SkidRun> = fitted.iter().collect();
            let initial = guessed(family, &runs);
            let fit = fit(family, &runs, so_far.clone(), initial, Effort::FULL);
            line(name(term), &fit.structure, values);
        }
        let after = line("all", &found.last.structure, &[]);
        Self { effects: terms.iter().map(name).zip(added.iter().cloned()).collect(), before, after }
    }

    /// Returns the first value of an effect.
    #[track_caller]
    fn value(&self, name: &str) -> f64 {
        self.effects.iter().find(|effect| effect.0 == name).unwrap_or_else(|| panic!("{:?}", self.effects)).1[0]
    }
}

#[test]
fn the_published_errors_are_reproduced() {
    let Split { family, fitted, held_out } = split(&WHEELS, Some(2.0), Output::YawRate, true);
    let ideal = Structure::default();
    assert_eq!((rmse(&family, &fitted, &ideal).1, rmse(&family, &held_out, &ideal).1), (202, 200));
    let track = family.catalogue().iter().position(|candidate| candidate.name == "slip-track").unwrap();
    let slip =
        Structure { terms: vec![Term::Known(track)], base: vec![], added: vec![vec![GEOMETRY.track_m / 0.3974]] };
    // README of the recording, three digits: ideal motion, and a single slip factor of 0.397.
    for (structure, expected) in [(ideal, 0.880), (slip, 0.162)] {
        let found = rmse(&family, &held_out, &structure).0;
        assert!((found - expected).abs() < 0.5e-3, "{found} instead of {expected}");
    }
}

#[test]
fn slip_of_a_husky_is_named() {
    let outcome = Outcome::of("wheels", &split(&WHEELS, Some(2.0), Output::YawRate, true));
    assert_eq!(outcome.effects[0].0, "slip-track");
    assert!(outcome.effects[1..].iter().all(|(name, _)| matches!(*name, "slip-limit" | "rate-limit")));
    assert!((outcome.before - 0.880).abs() < 0.5e-3, "{}", outcome.before);
    // README: a regression with quadratic and v·omega terms has an error of 0.160.
    assert!(outcome.after < 0.160, "{}", outcome.after);
}

#[test]
fn what_a_husky_makes_of_commands_is_named() {
    let outcome = Outcome::of("commands", &split(&COMMANDS, None, Output::YawRate, false));
    // README: a hard limit near 1.8 rad/s; 63 % of a step after about 0.67 s, part of which is a delay and a ramp.
    let limit = outcome.value("rate-limit");
    assert!((1.8..1.9).contains(&limit), "{limit}");
    let lag_s = outcome.value("drive-lag");
    assert!((0.2..0.67).contains(&lag_s), "{lag_s}");
    assert!(outcome.after < 0.15, "{} to {}", outcome.before, outcome.after);
}

#[test]
fn a_husky_drives_less_far_than_its_wheels_and_not_about_its_middle() {
    let outcome = Outcome::of("wheels", &split(&POSE, Some(2.0), Output::ForwardSpeed, true));
    // README: 0.168 m/s; a single scale of 0.801 has an error of 0.129 m/s, and the scale depends on turning.
    assert!((outcome.before - 0.168).abs() < 2e-3, "{}", outcome.before);
    assert_eq!(outcome.effects[0].0, "slip-longitudinal-turning");
    assert!(outcome.after < 0.100, "{}", outcome.after);
    let outcome = Outcome::of("wheels", &split(&POSE, Some(2.0), Output::LateralSpeed, false));
    // README: 0.098 m times the body's yaw rate; that of the wheels is 2.5 times as large.
    let centre_m = outcome.value("slip-lateral");
    assert!((centre_m + 0.098 / 2.5).abs() < 0.01, "{centre_m}");
    assert!(outcome.after < 0.95 * outcome.before, "{} to {}", outcome.before, outcome.after);
}
