//! Comparison of minima with those of SciPy.

use std::cell::Cell;

use r4_maths::minimise::{Effort, Minimum, global, nelder_mead};
use serde::Deserialize;

use crate::oracle::cases;

const EFFORT: Effort = Effort { points: 30, generations: 100, simplex: 600 };

#[derive(Deserialize)]
struct Case {
    bounds: Vec<(f64, f64)>,
    start: Vec<f64>,
    at: Vec<f64>,
    value: f64,
}

fn rosenbrock(at: &[f64]) -> f64 {
    at.windows(2).map(|x| 100.0 * (x[1] - x[0] * x[0]).powi(2) + (1.0 - x[0]).powi(2)).sum()
}

#[test]
fn minima_are_those_of_scipys_simplex() {
    for Case { bounds, start, at, value } in cases::<Case>("minima") {
        let found = nelder_mead(&bounds, &start, 2000, rosenbrock);
        let anywhere = global(&bounds, EFFORT, 1, rosenbrock);
        for found in [found, anywhere] {
            // A smooth minimum is flat to the root of rounding, 1.5e-8, divided by the curvatures, of which the least
            // is 0.4.
            let off = found.at.iter().zip(&at).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
            assert!(off < 1e-6 && (found.value - value).abs() < 1e-12, "{found:?} {at:?} {value}");
        }
    }
}

#[test]
fn the_global_search_is_not_caught_by_the_first_hollow() {
    // Rastrigin's function has 11² local minima within these bounds.
    let hollows = |at: &[f64]| at.iter().map(|x| x * x + 10.0 - 10.0 * (std::f64::consts::TAU * x).cos()).sum();
    for seed in 0..10 {
        assert!(global(&[(-5.12, 5.12); 2], EFFORT, seed, hollows).value < 1e-6, "{seed}");
    }
}

#[test]
fn stays_within_the_bounds_and_is_repeatable() {
    let bounds = [(2.0, 3.0), (-1.0, 4.0)];
    let slope = |at: &[f64]| {
        assert!(at.iter().zip(bounds).all(|(value, (low, high))| (low..=high).contains(value)), "{at:?}");
        at[0] - at[1]
    };
    let found = global(&bounds, EFFORT, 7, slope);
    assert_eq!(found.at, [2.0, 4.0]);
    assert_eq!(found, global(&bounds, EFFORT, 7, slope));
    // A start outside is moved to the bound.
    assert_eq!(nelder_mead(&bounds, &[-9.0, 9.0], 100, slope).at, [2.0, 4.0]);
}

#[test]
fn what_is_no_number_is_avoided_and_nothing_to_vary_is_looked_at_once() {
    let root = |at: &[f64]| if at[0] < 0.0 { f64::NAN } else { at[0] };
    assert!(global(&[(-1.0, 1.0)], EFFORT, 3, root).value < 1e-9);
    assert_eq!(global(&[], EFFORT, 3, |_| 5.0), Minimum { at: vec![], value: 5.0 });
    assert_eq!(nelder_mead(&[], &[], 100, |_| 5.0), Minimum { at: vec![], value: 5.0 });
    assert_eq!(nelder_mead(&[(0.0, 1.0)], &[0.5], 100, |_| f64::NAN).value, f64::INFINITY);
}

#[test]
fn the_budget_of_evaluations_is_kept() {
    let count = Cell::new(0);
    let bowl = |at: &[f64]| {
        count.set(count.get() + 1);
        at.iter().map(|x| (x - 2.0).powi(2)).sum()
    };
    let found = nelder_mead(&[(-10.0, 10.0); 3], &[5.0, -5.0, 1.0], 300, bowl);
    // The last step may take a reflection, a contraction and three shrunk vertices.
    assert!(count.get() <= 304, "{}", count.get());
    assert!(found.value < 1e-8, "{found:?}");
    let longer = nelder_mead(&[(-10.0, 10.0); 3], &[5.0, -5.0, 1.0], 2000, bowl);
    assert!(longer.value < 1e-12, "{longer:?}");
}
