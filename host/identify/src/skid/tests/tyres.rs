//! Tests with a simulated robot on four tyres, whose equations are independent of the model's.

use r4_maths::statistics::rms;
use rand_distr::{Distribution, Normal, Uniform};
use rand_pcg::Pcg64Mcg;

use super::{Declared, GEOMETRY, Model, Output, SkidRun, SkidSteer, Structure, Term, run};
use crate::{
    data::Run,
    fit::residuals,
    select::{Found, search},
};

/// Sampling period of 50 Hz, s.
const PERIOD_S: f64 = 0.02;
/// Number of integration steps per sample.
const FINE: usize = 20;
const STEP_S: f64 = PERIOD_S / FINE as f64;
/// Standard deviation of the gyro's noise, rad/s.
const NOISE: f64 = 0.005;
const SAMPLES: usize = 600;

/// Brush tyres with combined slip (Pacejka, *Tire and Vehicle Dynamics*, 3.2: a cubic of the slip until all bristles
/// slide) under a rigid body on flat ground.
struct Tyres {
    mass_kg: f64,
    inertia_kg_m2: f64,
    /// Distance between front and rear axle, m.
    wheelbase_m: f64,
    friction: f64,
    /// Slope of the force over slip, as a multiple of the load.
    stiffness: f64,
    forward: f64,
    lateral: f64,
    turn: f64,
}

impl Tyres {
    const fn new() -> Self {
        Self {
            mass_kg: 40.0,
            inertia_kg_m2: 3.0,
            wheelbase_m: 0.5,
            friction: 0.7,
            stiffness: 8.0,
            forward: 0.0,
            lateral: 0.0,
            turn: 0.0,
        }
    }

    /// Advances by [`STEP_S`] with wheels at given rim speeds, m/s.
    fn advance(&mut self, rim_left: f64, rim_right: f64) {
        let load = self.mass_kg * 9.81 / 4.0;
        let (mut along, mut across, mut moment) = (0.0, 0.0, 0.0);
        for (rim, y) in [(rim_left, 0.25), (rim_right, -0.25)] {
            for x in [0.5 * self.wheelbase_m, -0.5 * self.wheelbase_m] {
                let (slide_x, slide_y) = (self.forward - self.turn * y - rim, self.lateral + self.turn * x);
                let slide = slide_x.hypot(slide_y);
                // Bristles of a wheel that hardly rolls stick for long: a floor of the speed keeps the slip finite.
                let slip = slide / rim.abs().max(0.1);
                let share = (self.stiffness * slip / (3.0 * self.friction)).min(1.0);
                let force = self.friction * load * (3.0 * share - 3.0 * share.powi(2) + share.powi(3));
                if slide > 0.0 {
                    let (force_x, force_y) = (-force * slide_x / slide, -force * slide_y / slide);
                    along += force_x;
                    across += force_y;
                    moment += x * force_y - y * force_x;
                }
            }
        }
        let (forward, lateral) = (self.forward, self.lateral);
        self.forward += STEP_S * (along / self.mass_kg + self.turn * lateral);
        self.lateral += STEP_S * (across / self.mass_kg - self.turn * forward);
        self.turn += STEP_S * moment / self.inertia_kg_m2;
    }
}

/// Returns speeds of both sides, rad/s, that ramp to new values each second within 0.2 s; `FINE` values per sample.
fn drive(random: &mut Pcg64Mcg) -> Vec<[f64; 2]> {
    let speeds = Uniform::new_inclusive(-10.0, 10.0).unwrap();
    let mut now = [0.0_f64; 2];
    let mut goal = [0.0_f64; 2];
    let each_s = (1.0 / STEP_S).round() as usize;
    (0..SAMPLES * FINE)
        .map(|at| {
            if at % each_s == 0 {
                goal = [speeds.sample(random), speeds.sample(random)];
            }
            for (now, goal) in now.iter_mut().zip(goal) {
                *now += (goal - *now).clamp(-60.0 * STEP_S, 60.0 * STEP_S);
            }
            now
        })
        .collect()
}

/// Returns runs of a `body` under random speeds of the sides, with a gyro's noise.
fn runs(seed: u64, count: usize, body: &dyn Fn(&[[f64; 2]]) -> Vec<f64>) -> Vec<Run> {
    let mut random = Pcg64Mcg::new(u128::from(seed));
    let noise = Normal::new(0.0, NOISE).unwrap();
    (0..count)
        .map(|number| {
            let sides = drive(&mut random);
            let side = |side: usize| sides.iter().step_by(FINE).map(|sides| sides[side]).collect::<Vec<f64>>();
            let gyro = body(&sides).into_iter().step_by(FINE).map(|turn| turn + noise.sample(&mut random)).collect();
            run(&format!("run {number}"), PERIOD_S, &[("left", side(0)), ("right", side(1)), ("gyro", gyro)])
        })
        .collect()
}

struct Outcome {
    names: Vec<&'static str>,
    found: Found<SkidRun>,
    before: f64,
    after: f64,
}

impl Outcome {
    /// Returns the first value of an effect that was found.
    #[track_caller]
    fn value(&self, name: &str) -> f64 {
        let place = self.names.iter().position(|found| *found == name).unwrap_or_else(|| panic!("{:?}", self.names));
        self.found.last.structure.added[place][0]
    }
}

/// Searches on three runs, and scores on a fourth.
fn outcome(seed: u64, body: &dyn Fn(&[[f64; 2]]) -> Vec<f64>) -> Outcome {
    let declared = Declared { geometry: GEOMETRY, average_s: None };
    let (family, mut runs) = SkidSteer::new(declared, Output::YawRate, &runs(seed, 4, body)).unwrap();
    let held_out = runs.pop().unwrap();
    let found = search(&family, &runs, &|_| ());
    let rmse = |structure: &Structure| rmse(&family, structure, &held_out);
    let name = |term: &Term| match term {
        Term::Known(index) => family.catalogue()[*index].name,
        Term::Curve(_) => "unknown",
    };
    Outcome {
        names: found.last.structure.terms.iter().map(name).collect(),
        before: rmse(&found.base.structure),
        after: rmse(&found.last.structure),
        found,
    }
}

fn rmse(family: &SkidSteer, structure: &Structure, run: &SkidRun) -> f64 {
    rms(&residuals(family, structure, &[], run)).unwrap()
}

#[test]
fn tyres_that_slip_are_named_and_their_track_is_wide() {
    let body = |sides: &[[f64; 2]]| {
        let mut tyres = Tyres::new();
        let turn = |side: &[f64; 2]| {
            let before = tyres.turn;
            tyres.advance(0.1 * side[0], 0.1 * side[1]);
            before
        };
        sides.iter().map(turn).collect()
    };
    let outcome = outcome(1, &body);
    assert_eq!(outcome.names[0], "slip-track");
    // For tyres that all slide, with equal friction along and across, the balance of moments gives 1 + (wheelbase /
    // track)². Here not all tyres slide all the time.
    let wide = outcome.value("slip-track") / GEOMETRY.track_m;
    assert!((wide - 2.0).abs() < 0.15, "{wide}");
    assert!(outcome.after < 0.3 * outcome.before, "{} to {}", outcome.before, outcome.after);
}

#[test]
fn without_slip_nothing_is_named() {
    let body = |sides: &[[f64; 2]]| sides.iter().map(|side| 0.2 * (side[1] - side[0])).collect();
    let outcome = outcome(2, &body);
    assert!(outcome.names.is_empty(), "{:?}", outcome.names);
    // The standard deviation of 600 noise samples is known to 1 / sqrt(1200).
    assert!((outcome.after / NOISE - 1.0).abs() < 4.0 / 1200.0_f64.sqrt(), "{}", outcome.after);
}

#[test]
fn a_limited_body_behind_a_slow_drive_is_named() {
    // A controller that turns at up to 1.4 rad/s, 70 ms late, with drives that take 0.25 s.
    let body = |sides: &[[f64; 2]]| {
        let late = (0.07 / STEP_S).round() as usize;
        let mut turn = 0.0;
        let advance = |at: usize| {
            let side = sides[at.saturating_sub(late)];
            let wanted = (0.2 * (side[1] - side[0])).clamp(-1.4, 1.4);
            let before = turn;
            turn += STEP_S / 0.25 * (wanted - turn);
            before
        };
        (0..sides.len()).map(advance).collect()
    };
    let outcome = outcome(3, &body);
    let mut names = outcome.names.clone();
    names.sort_unstable();
    assert_eq!(names, ["drive-lag", "input-delay", "rate-limit"]);
    for (name, expected, tolerance) in [
        ("rate-limit", 1.4, 0.01),
        // Integration in steps of 1 ms adds as much delay.
        ("drive-lag", 0.25, 0.005),
        ("input-delay", 0.07, 0.003),
    ] {
        let value = outcome.value(name);
        assert!((value - expected).abs() < tolerance, "{name}: {value} instead of {expected}");
    }
    // The residual is noise, and the error of linear interpolation between samples of the ramps.
    assert!(outcome.after < 1.05 * NOISE, "{}", outcome.after);
}
