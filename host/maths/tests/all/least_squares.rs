//! Comparison of fits with those of statsmodels and SciPy, and with values that NIST certifies.

use nalgebra::DMatrix;
use r4_maths::least_squares::{Fit, FitError, linear, nonlinear, weighted};
use serde::Deserialize;

use crate::oracle::{cases, close};

#[derive(Deserialize)]
struct Linear {
    design: Vec<Vec<f64>>,
    observed: Vec<f64>,
    deviations: Vec<f64>,
    parameters: Vec<f64>,
    covariance: Vec<Vec<f64>>,
    lag: usize,
    autocorrelated: Vec<Vec<f64>>,
    residuals: Vec<f64>,
    residual_variance: f64,
    intervals: Vec<[f64; 2]>,
    p_values: Vec<f64>,
    level: f64,
}

fn matrix(rows: &[Vec<f64>]) -> DMatrix<f64> {
    DMatrix::from_fn(rows.len(), rows[0].len(), |row, column| rows[row][column])
}

#[test]
fn linear_fits_are_those_of_statsmodels() {
    for case in cases::<Linear>("linear_fits") {
        let (design, even) = (matrix(&case.design), case.deviations.iter().all(|deviation| *deviation == 1.0));
        let found = weighted(&design, &case.observed, &case.deviations).unwrap();
        if even {
            assert_eq!(linear(&design, &case.observed).unwrap(), found);
        }
        // Rounding errors grow with the condition of the scaled columns, and with its square in the covariance. Both
        // programs have them, and statsmodels those of columns that are not scaled.
        let (one, two) = (1e-14 * found.condition, 1e-13 * found.condition.powi(2));
        let errors = found.standard_errors();
        for (place, expected) in case.parameters.iter().enumerate() {
            close(found.parameters[place], *expected, one);
            // The relative error of a tail is that of t times the steepness of the distribution, about t² here.
            let t = case.parameters[place] / errors[place];
            close(found.p_values()[place], case.p_values[place], two.max(1e-10) * (1.0 + t * t));
            let intervals = found.intervals(case.level).unwrap();
            for (end, expected) in [intervals[place].low, intervals[place].high].iter().zip(case.intervals[place]) {
                assert!(
                    (end - expected).abs() <= two.max(1e-10) * (errors[place] + expected.abs()),
                    "{end} {expected}"
                );
            }
        }
        let autocorrelated = found.clone().autocorrelated(case.lag);
        for (found, expected) in [(&found, &case.covariance), (&autocorrelated, &case.autocorrelated)] {
            for (row, expected) in expected.iter().enumerate() {
                for (column, expected) in expected.iter().enumerate() {
                    let error = (found.covariance[(row, column)] - expected).abs();
                    assert!(error <= two * errors[row] * errors[column], "{row} {column}: {error} {expected}");
                }
            }
        }
        // Residuals are differences of numbers as large as the observations.
        let scale = case.observed.iter().fold(0.0f64, |scale, value| scale.max(value.abs()));
        for (found, expected) in found.residuals.iter().zip(&case.residuals) {
            assert!((found - expected).abs() <= one * scale, "{found} {expected}");
        }
        close(found.residual_variance, case.residual_variance, two);
    }
}

/// Certified values of NIST StRD, Longley: 15 digits.
#[test]
fn longleys_data_have_the_certified_parameters() {
    const CERTIFIED: [(f64, f64); 7] = [
        (-3482258.63459582, 890420.383607373),
        (15.0618722713733, 84.9149257747669),
        (-0.358191792925910e-1, 0.334910077722432e-1),
        (-2.02022980381683, 0.488399681651699),
        (-1.03322686717359, 0.214274163161675),
        (-0.511041056535807e-1, 0.226073200069370),
        (1829.15146461355, 455.478499142212),
    ];
    let longley = &cases::<Linear>("linear_fits")[0];
    let found = linear(&matrix(&longley.design), &longley.observed).unwrap();
    for ((found, error), (certified, certified_error)) in
        found.parameters.iter().zip(found.standard_errors()).zip(CERTIFIED)
    {
        // The condition of the scaled columns is 4e4: of f64's 16 digits 11 remain.
        close(*found, certified, 1e-10);
        close(error, certified_error, 1e-8);
    }
}

#[derive(Deserialize)]
struct Nonlinear {
    name: String,
    x: Vec<f64>,
    y: Vec<f64>,
    start: Vec<f64>,
    parameters: Vec<f64>,
    covariance: Vec<Vec<f64>>,
}

fn saturation(case: &Nonlinear) -> Result<Fit, FitError> {
    nonlinear(&case.start, |b| case.x.iter().zip(&case.y).map(|(x, y)| y - b[0] * (1.0 - (-b[1] * x).exp())).collect())
}

#[test]
fn nonlinear_fits_are_those_of_scipy() {
    for case in cases::<Nonlinear>("nonlinear_fits") {
        let found = saturation(&case).expect(&case.name);
        for (place, expected) in case.parameters.iter().enumerate() {
            // A minimum is flat to the root of rounding; the zero of its gradient is found to about the power 1.3 of
            // that. The derivatives have an error of 1e-10.
            close(found.parameters[place], *expected, 1e-7);
            close(found.standard_errors()[place], case.covariance[place][place].sqrt(), 1e-6);
        }
    }
}

/// Certified values of NIST StRD, Misra1a: 11 digits.
#[test]
fn misras_data_have_the_certified_parameters() {
    let cases = cases::<Nonlinear>("nonlinear_fits");
    let case = cases.iter().find(|case| case.name == "misra1a").unwrap();
    let found = saturation(case).unwrap();
    for (found, certified) in found.parameters.iter().copied().chain(found.standard_errors()).zip([
        2.3894212918e2,
        5.5015643181e-4,
        2.7070075241,
        7.2668688436e-6,
    ]) {
        close(found, certified, 1e-6);
    }
    close(found.residual_variance * 12.0, 1.2455138894e-1, 1e-9);
}

#[test]
fn what_the_data_cannot_tell_is_refused() {
    let twice = DMatrix::from_fn(5, 2, |row, column| (row + 1) as f64 * (column + 1) as f64);
    let observed = [1.0, 2.0, 3.0, 4.0, 5.0];
    assert_eq!(linear(&twice, &observed), Err(FitError::Collinear { rank: 1, parameters: 2 }));
    assert_eq!(linear(&twice, &observed[..4]), Err(FitError::Shape { rows: 5, observed: 4 }));
    assert_eq!(linear(&DMatrix::zeros(5, 0), &observed), Err(FitError::NoParameters));
    assert_eq!(linear(&DMatrix::zeros(5, 1), &observed), Err(FitError::Collinear { rank: 0, parameters: 1 }));
    assert_eq!(linear(&DMatrix::identity(2, 2), &[1.0, 2.0]), Err(FitError::TooFew { observed: 2, parameters: 2 }));
    let hole = [1.0, 2.0, f64::NAN, 4.0, 5.0];
    let ones = DMatrix::repeat(5, 1, 1.0);
    assert_eq!(linear(&ones, &hole), Err(FitError::NotFinite { row: 2 }));
    let deviations = [1.0, 1.0, 1.0, 0.0, 1.0];
    assert_eq!(weighted(&ones, &observed, &deviations), Err(FitError::Deviation { row: 3 }));

    let flat = |numbers: &[f64]| observed.iter().map(|y| y - numbers[0] - numbers[1]).collect();
    assert_eq!(nonlinear(&[1.0, 0.0], flat), Err(FitError::Collinear { rank: 1, parameters: 2 }));
    assert_eq!(nonlinear(&[], |_| vec![1.0]), Err(FitError::NoParameters));
    assert_eq!(nonlinear(&[1.0], |_| vec![1.0, f64::NAN]), Err(FitError::NotFinite { row: 1 }));
    let endless = |numbers: &[f64]| vec![(-numbers[0]).exp(), 2.0 * (-numbers[0]).exp()];
    assert!(matches!(nonlinear(&[1.0], endless), Err(FitError::NotConverged { .. }) | Ok(_)));
}

/// The logarithm has no values below 0, where the first full step leads.
#[test]
fn a_step_to_where_the_model_has_no_value_is_shortened() {
    let fit = nonlinear(&[5.0], |numbers| vec![numbers[0].ln(), 2.0 * numbers[0].ln()]).unwrap();
    close(fit.parameters[0], 1.0, 1e-9);
}
