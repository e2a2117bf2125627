//! Tests of splines and roots.

use std::f64::consts::TAU;

use proptest::{collection::vec, prelude::*};
use r4_maths::{
    root::{RootError, bisect, brent},
    spline::{Spline, SplineError},
};
use serde::Deserialize;

use crate::oracle::cases;

#[derive(Deserialize)]
struct Curve {
    knots: Vec<f64>,
    values: Vec<f64>,
    x: Vec<f64>,
    period: Option<f64>,
    bessel: Vec<f64>,
    natural: Option<Vec<f64>>,
    natural_slope: Option<Vec<f64>>,
    monotone: Option<Vec<f64>>,
    monotone_slope: Option<Vec<f64>>,
}

#[test]
fn splines_are_those_of_scipy() {
    // Values of a few units, slopes of a few tens over knots 0.2 apart: rounding errors, times the condition of less
    // than 10 of the tridiagonal system.
    const WITHIN: f64 = 1e-11;
    for case in cases::<Curve>("splines") {
        let (knots, values) = (&case.knots, &case.values);
        let compare = |name: &str, of: &dyn Fn(f64) -> f64, expected: &[f64]| {
            for (x, expected) in case.x.iter().zip(expected) {
                assert!(
                    (of(*x) - expected).abs() < WITHIN,
                    "{name}, {} knots, {x}: {} {expected}",
                    knots.len(),
                    of(*x)
                );
            }
        };
        let bessel = Spline::through(knots, values, case.period);
        compare("bessel", &|x| bessel.value(x), &case.bessel);
        if case.period.is_some() {
            continue;
        }
        assert_eq!(Spline::bessel(knots, values), Ok(bessel));
        let natural = Spline::natural(knots, values).unwrap();
        compare("natural", &|x| natural.value(x), case.natural.as_deref().unwrap());
        let monotone = Spline::monotone(knots, values).unwrap();
        compare("monotone", &|x| monotone.value(x), case.monotone.as_deref().unwrap());
        // Not at the end itself, from which on our curves are constant.
        let last = *case.x.last().unwrap();
        let slope = |curve: &Spline, x: f64, expected: f64| if x < last { curve.slope(x) } else { expected };
        for (name, curve, slopes) in
            [("natural", &natural, case.natural_slope.as_ref()), ("monotone", &monotone, case.monotone_slope.as_ref())]
        {
            for (x, expected) in case.x.iter().zip(slopes.unwrap()) {
                let found = slope(curve, *x, *expected);
                assert!((found - expected).abs() < 10.0 * WITHIN, "{name} slope at {x}: {found} {expected}");
            }
        }
    }
}

#[test]
fn a_parabola_is_itself_and_ends_are_constant() {
    let at = [-1.0, 0.0, 0.5, 2.0, 2.5];
    let of = |x: f64| 1.0 - 2.0 * x + 0.5 * x * x;
    let spline = Spline::bessel(&at, &at.map(of)).unwrap();
    for x in [-1.0, -0.3, 0.0, 0.2, 1.1, 1.9, 2.3, 2.5] {
        assert!((spline.value(x) - of(x)).abs() < 1e-12, "{x}: {}", spline.value(x));
    }
    assert_eq!([spline.value(-9.0), spline.value(f64::INFINITY)], [of(-1.0), of(2.5)]);
}

#[test]
fn a_wave_goes_round_without_a_seam() {
    let at: Vec<f64> = (0..12).map(|n| f64::from(n) * TAU / 12.0).collect();
    let values: Vec<f64> = at.iter().map(|x| (x + 1.0).sin()).collect();
    let spline = Spline::through(&at, &values, Some(TAU));
    let (fine, followed) = spline.polyline(8);
    assert_eq!((fine.len(), fine[8], followed[8]), (96, at[1], values[1]));
    for n in -200..200 {
        let x = 0.1 * f64::from(n);
        // Slopes are wrong by h² / 6 (h = TAU / 12), which changes a cubic by h times 0.096 of that; the rest is less.
        assert!((spline.value(x) - (x + 1.0).sin()).abs() < 0.003, "{x}: {}", spline.value(x));
    }
}

#[test]
fn few_knots_are_lines_and_bad_ones_are_refused() {
    assert_eq!(Spline::through(&[], &[], None).value(1.0), 0.0);
    assert_eq!(Spline::through(&[3.0], &[2.0], None).value(1.0), 2.0);
    assert_eq!(Spline::through(&[3.0], &[2.0], Some(1.0)).value(7.5), 2.0);
    for of in [Spline::bessel, Spline::natural, Spline::monotone] {
        assert_eq!(of(&[3.0], &[2.0]).unwrap().value(9.0), 2.0);
        let line = of(&[0.0, 2.0], &[0.0, 1.0]).unwrap();
        assert_eq!([-1.0, 0.5, 9.0].map(|x| line.value(x)), [0.0, 0.25, 1.0]);
        assert_eq!(of(&[], &[]), Err(SplineError::Count { knots: 0, values: 0 }));
        assert_eq!(of(&[1.0, 2.0], &[1.0]), Err(SplineError::Count { knots: 2, values: 1 }));
        assert_eq!(of(&[1.0, 1.0], &[1.0, 2.0]), Err(SplineError::Knot { index: 1 }));
        assert_eq!(of(&[1.0, 2.0], &[f64::NAN, 2.0]), Err(SplineError::Knot { index: 0 }));
    }
}

proptest! {
    #[test]
    fn every_curve_goes_through_its_knots_and_pchip_stays_between(
        steps in vec((0.1..3.0f64, -5.0..5.0f64), 1..12), share in 0.0..1.0f64,
    ) {
        let knots: Vec<f64> = steps.iter().scan(0.0, |at, (step, _)| { *at += step; Some(*at) }).collect();
        let values: Vec<f64> = steps.iter().map(|(_, value)| *value).collect();
        for of in [Spline::bessel, Spline::natural, Spline::monotone] {
            let curve = of(&knots, &values).unwrap();
            for (knot, value) in knots.iter().zip(&values) {
                prop_assert_eq!(curve.value(*knot), *value);
            }
        }
        let monotone = Spline::monotone(&knots, &values).unwrap();
        for (x, y) in knots.windows(2).zip(values.windows(2)) {
            let value = monotone.value(x[0] + share * (x[1] - x[0]));
            // Rounding errors of values of a few units.
            prop_assert!(value >= y[0].min(y[1]) - 1e-12 && value <= y[0].max(y[1]) + 1e-12, "{} {:?}", value, y);
        }
    }

    #[test]
    fn both_methods_end_within_the_tolerance_of_any_cubics_root(root in -5.0..5.0f64, bend in 0.0..4.0f64, power in -12..-1i32) {
        let tolerance = 10.0f64.powi(power);
        let f = |x: f64| (x - root) * (1.0 + bend * (x - root).powi(2));
        for found in [bisect(f, -6.0, 7.0, tolerance).unwrap(), brent(f, -6.0, 7.0, tolerance).unwrap()] {
            prop_assert!((found - root).abs() <= tolerance.max(1e-14), "{} {}", found, root);
        }
    }
}

#[derive(Deserialize)]
struct Root {
    name: String,
    low: f64,
    high: f64,
    tolerance: f64,
    root: f64,
}

#[test]
fn roots_are_those_of_scipy() {
    for Root { name, low, high, tolerance, root } in cases::<Root>("roots") {
        let f = |x: f64| match &*name {
            "cubic" => x.powi(3) - 2.0 * x - 5.0,
            "cosine" => x.cos() - x,
            "steep" => (20.0 * x).exp() - 1e3,
            "flat" => (x - 0.3).powi(9),
            "pole" => 1.0 / (x - 4.0) + 1.0,
            other => panic!("{other}"),
        };
        // The guaranteed tolerance, and a few last bits.
        let within = tolerance + 4.0 * f64::EPSILON;
        for found in [bisect(f, low, high, tolerance).unwrap(), brent(f, low, high, tolerance).unwrap()] {
            assert!((found - root).abs() <= within, "{name}: {found} {root}");
        }
        assert_eq!(brent(f, high, low, tolerance).map(|found| (found - root).abs() <= within), Ok(true), "{name}");
    }
}

#[test]
fn brent_needs_fewer_evaluations_than_bisection() {
    let count = std::cell::Cell::new(0);
    let f = |x: f64| {
        count.set(count.get() + 1);
        x.cos() - x
    };
    bisect(f, 0.0, 1.0, 1e-12).unwrap();
    let halvings = count.replace(0);
    brent(f, 0.0, 1.0, 1e-12).unwrap();
    // 1e-12 takes 40 halvings.
    assert!(halvings >= 40 && count.get() <= 12, "{halvings} {}", count.get());
}

#[test]
fn what_has_no_root_is_refused() {
    for of in [bisect, brent] as [fn(fn(f64) -> f64, f64, f64, f64) -> Result<f64, RootError>; 2] {
        assert_eq!(of(|x| x * x + 1.0, -1.0, 1.0, 1e-9), Err(RootError::SameSign { at_low: 2.0, at_high: 2.0 }));
        assert_eq!(of(f64::sqrt, -1.0, 1.0, 1e-9), Err(RootError::NotANumber { at: -1.0 }));
        assert!(matches!(of(|x| x, f64::NAN, 1.0, 1e-9), Err(RootError::Input(_))));
        assert_eq!(of(|x| x, -1.0, 1.0, -1.0), Err(RootError::Input(-1.0)));
        assert_eq!((of(|x| x, 0.0, 1.0, 0.0), of(|x| x, -1.0, 0.0, 0.0)), (Ok(0.0), Ok(0.0)));
        // A jump is found where the sign changes, to the last bit.
        let jump = of(|x| if x < 0.7 { -1.0 } else { 1.0 }, 0.0, 1.0, 0.0).unwrap();
        assert!((jump - 0.7).abs() <= 4.0 * f64::EPSILON, "{jump}");
    }
}
