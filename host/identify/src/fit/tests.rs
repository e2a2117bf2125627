//! Tests of confidence intervals against closed forms and their coverage.

use r4_plants::Dependence;
use rand_distr::{Distribution, Normal};

use super::{Effort, Fit, Problem, fit};
use crate::family::{Candidate, Curve, Driver, Family, Loadable, Model, Parameter, Range, Structure};

/// Model that is a function of time with parameters.
struct Formula {
    base: Vec<Parameter>,
    of: fn(&[f64], f64) -> f64,
}

#[derive(Clone)]
struct Points {
    time_s: Vec<f64>,
    measured: Vec<f64>,
}

impl Model for Formula {
    type Run = Points;

    fn base(&self) -> &[Parameter] {
        &self.base
    }

    fn catalogue(&self) -> &[Candidate] {
        &[]
    }

    fn initial(&self, _: &Points) -> (Vec<f64>, Vec<f64>) {
        (vec![], vec![])
    }

    fn predict(&self, structure: &Structure, _: &[f64], run: &Points, predicted: &mut [f64]) {
        for (place, &time_s) in predicted.iter_mut().zip(&run.time_s) {
            *place = (self.of)(&structure.base, time_s);
        }
    }

    fn measured<'r>(&self, run: &'r Points) -> &'r [f64] {
        &run.measured
    }
}

impl Family for Formula {
    fn unit(&self) -> &'static str {
        "1"
    }

    fn starts(&self, _: &[&Points]) -> Vec<Vec<f64>> {
        vec![vec![1.0; self.base.len()]]
    }

    fn time_s<'r>(&self, run: &'r Points) -> &'r [f64] {
        &run.time_s
    }

    fn name<'r>(&self, _: &'r Points) -> &'r str {
        "points"
    }

    fn part(&self, run: &Points, from: usize, to: usize) -> Points {
        Points { time_s: run.time_s[from..to].to_vec(), measured: run.measured[from..to].to_vec() }
    }

    fn drivers(&self, _: &Structure, _: &[f64], _: &Points) -> Vec<Driver> {
        vec![]
    }

    fn loadable(&self, _: &Structure, _: &str) -> Loadable {
        Loadable::Plant(String::new())
    }

    fn curves(&self, _: &Fit, _: (Dependence, Option<f64>), _: &[&Points]) -> Vec<Curve> {
        vec![]
    }
}

impl Formula {
    fn new(ranges: &[Range], of: fn(&[f64], f64) -> f64) -> Self {
        let parameter = |&range| Parameter { name: "number", unit: "1", range, absent: None };
        Self { base: ranges.iter().map(parameter).collect(), of }
    }

    /// Returns measurements at `count` times up to `end_s`, s, with normal noise.
    fn points(&self, truth: &[f64], count: u32, end_s: f64, noise: f64, seed: u64) -> Points {
        let mut random = rand_pcg::Pcg64::new(u128::from(seed), 1);
        let noise = Normal::new(0.0, noise).expect("a deviation");
        let time_s: Vec<f64> = (1..=count).map(|at| end_s * f64::from(at) / f64::from(count)).collect();
        let measured = time_s.iter().map(|&t| (self.of)(truth, t) + noise.sample(&mut random)).collect();
        Points { time_s, measured }
    }

    fn fitted(&self, run: &Points, base: &[f64]) -> Fit {
        let structure = Structure { base: base.to_vec(), ..Structure::default() };
        fit(self, &[run], structure, vec![vec![]], Effort { robust: false, ..Effort::FULL })
    }
}

const ANY: Range = Range::Any { scale: 1.0 };

fn line(base: &[f64], t: f64) -> f64 {
    base[0] + base[1] * t
}

fn rise(base: &[f64], t: f64) -> f64 {
    base[0] * -(-t / base[1]).exp_m1()
}

/// The cost is a parabola in which both parameters are correlated (the mean time is not zero).
#[test]
fn of_a_straight_line_an_interval_is_two_deviations_either_way() {
    let model = Formula::new(&[ANY, ANY], line);
    let points = model.points(&[1.0, -2.0], 200, 3.0, 0.1, 1);
    let fit = model.fitted(&points, &[0.0, 0.0]);
    let deviations = fit.deviations(&model, &[&points]);
    for ((value, deviation), interval) in
        fit.structure.base.iter().zip(deviations).zip(fit.clone().with_intervals(&model, &[&points]).1)
    {
        let (deviation, [low, high]) = (deviation.expect("known"), interval.expect("bounded"));
        for reach in [value - low, high - value] {
            // Numerical differences are accurate to 1e-4, and the solver's error is a hundredth of the rise, half of
            // it in the root.
            assert!((reach / deviation - 1.96).abs() < 0.02, "{value} ± {deviation}: {low} to {high}");
        }
    }
}

/// Gain and time constant of a rise that is recorded for one time constant only: a longer one with more gain looks
/// nearly the same, a shorter one does not.
#[test]
fn of_a_time_constant_an_interval_is_lopsided_and_covers_the_truth() {
    let model = Formula::new(&[Range::Positive, Range::Positive], rise);
    let (mut covered, mut lopsided, mut bounded) = (0, 0, 0);
    for seed in 0..100 {
        let points = model.points(&[1.0, 0.5], 40, 0.5, 0.02, seed);
        let fit = model.fitted(&points, &[1.2, 0.4]);
        let Some([low, high]) = fit.clone().with_intervals(&model, &[&points]).1[1] else { continue };
        let value = fit.structure.base[1];
        assert!(0.0 < low && low < value && value < high, "seed {seed}: {low} to {high} of {value}");
        bounded += 1;
        covered += u32::from((low..=high).contains(&0.5));
        lopsided += u32::from(high - value > 1.2 * (value - low));
    }
    assert!(bounded >= 95, "{bounded}");
    // 95 of 100 are expected, with a standard deviation of 2.2; the limit is three of these below.
    assert!(covered >= bounded - 12, "{covered} of {bounded}");
    assert_eq!(lopsided, bounded);
}

/// A ripple on the value has a minimum of the cost every 4 mm, of which a descent finds the next one only.
#[test]
fn a_profile_that_finds_less_replaces_the_fit() {
    let ripple = |base: &[f64], _| base[0] + 1.5e-3 * (base[0] * std::f64::consts::TAU / 4e-3).sin();
    let model = Formula::new(&[ANY], ripple);
    let points = model.points(&[1.0], 100, 1.0, 0.1, 4);
    let stuck = model.fitted(&points, &[1.05]);
    let (found, intervals) = stuck.clone().with_intervals(&model, &[&points]);
    let mean = points.measured.iter().sum::<f64>() / 100.0;
    let [off, left] = [&stuck, &found].map(|fit| (fit.structure.base[0] - mean).abs());
    // The mean has a standard error of 10 mm: two ripples are within it.
    assert!(off > 20e-3 && left < 8e-3, "{off} {left}");
    let [low, high] = intervals[0].expect("bounded");
    assert!((low - (mean - 19.6e-3)).abs() < 8e-3 && (high - (mean + 19.6e-3)).abs() < 8e-3, "{low} to {high}");
}

#[test]
fn an_interval_ends_with_the_range() {
    let model = Formula::new(&[ANY, Range::NotNegative { scale: 1.0 }], line);
    let points = model.points(&[1.0, 0.0], 100, 1.0, 0.1, 2);
    let fit = model.fitted(&points, &[0.0, 0.5]);
    let [low, high] = fit.clone().with_intervals(&model, &[&points]).1[1].expect("bounded");
    assert!(low == 0.0 && high > 0.0, "{low} to {high}");
    // Only the final value of this rise is visible: it ends before the first sample at 20 ms, to 1 % if the time
    // constant is 5 ms or less.
    let model = Formula::new(&[Range::Positive, Range::Positive], rise);
    let points = model.points(&[1.0, 1e-3], 50, 1.0, 0.01, 3);
    let [low, high] = model.fitted(&points, &[1.0, 1e-3]).with_intervals(&model, &[&points]).1[1].expect("bounded");
    assert!(low == 0.0 && (3e-3..1e-2).contains(&high), "{low} to {high}");
}

/// Only the initial slope of this rise is visible: any slower one with more gain fits equally well.
#[test]
fn what_the_data_do_not_bound_has_no_interval() {
    let model = Formula::new(&[Range::Positive, Range::Positive], rise);
    // The curve deviates from the best line by up to 0.005, a tenth of the noise, at 50 samples: half a standard
    // deviation in all.
    let points = model.points(&[1.0, 0.5], 50, 0.1, 0.05, 3);
    let intervals = model.fitted(&points, &[1.0, 0.5]).with_intervals(&model, &[&points]).1;
    assert_eq!(intervals, [None, None]);
}

#[test]
fn what_is_held_stays_while_the_rest_is_fitted() {
    let model = Formula::new(&[Range::Positive, Range::Positive], rise);
    let points = model.points(&[1.0, 0.5], 100, 2.0, 0.01, 4);
    let structure = Structure { base: vec![2.0, 0.3], ..Structure::default() };
    let runs = [&points];
    let mut problem = Problem::new(&model, &runs, structure, vec![vec![]], vec![vec![1.0; 100]]);
    problem.held = Some(1);
    let (at_first, held) = (problem.cost, problem.structure.base[1]);
    let solved = problem.solved(Effort::FULL);
    assert_eq!(solved.structure.base[1].to_bits(), held.to_bits());
    // With a given time constant, the gain is a linear regression.
    let shape: Vec<f64> = points.time_s.iter().map(|t| rise(&[1.0, held], *t)).collect();
    let gain =
        shape.iter().zip(&points.measured).map(|(s, m)| s * m).sum::<f64>() / shape.iter().map(|s| s * s).sum::<f64>();
    assert!((solved.structure.base[0] / gain - 1.0).abs() < 1e-5 && solved.cost < at_first);
}

#[test]
fn a_step_beyond_a_reflecting_end_comes_back() {
    let range = Range::Reflected(-3.0, 1.5);
    let at = |value: f64, step: f64| range.value(range.variable(value) + step / 4.5);
    for (value, step, expected) in
        [(0.0, 1.0, 1.0), (1.0, 1.0, 1.0), (1.5, 0.25, 1.25), (-3.0, -0.5, -2.5), (0.0, 9.0, 0.0), (-1.0, -13.0, -1.0)]
    {
        assert!((at(value, step) - expected).abs() < 1e-12, "{value} {step}: {}", at(value, step));
    }
}

#[test]
fn what_mostly_stands_still_has_the_noise_of_its_rounding() {
    let step = 0.01;
    // It turns for one second of every five, at 0.5 per second.
    let way = |t: f64| 0.5 * ((t / 5.0).floor() + (t % 5.0).min(1.0));
    let rounded: Vec<f64> = (0..2000).map(|n| (way(0.005 * f64::from(n)) / step).round() * step).collect();
    let noise = super::white_noise(&rounded);
    assert!((noise / (step / 12.0_f64.sqrt()) - 1.0).abs() < 1e-6, "{noise}");
    assert_eq!(super::white_noise(&[2.0; 50]), 0.0);
}
