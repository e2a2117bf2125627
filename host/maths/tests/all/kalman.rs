//! Comparison of filters with that of statsmodels.

use nalgebra::{DMatrix, DVector, dmatrix, dvector};
use r4_maths::kalman::{Kalman, KalmanError};
use serde::Deserialize;

use crate::oracle::cases;

#[derive(Deserialize)]
struct Case {
    transition: Vec<Vec<f64>>,
    process: Vec<Vec<f64>>,
    noise: f64,
    start: Vec<f64>,
    measured: Vec<f64>,
    states: Vec<Vec<f64>>,
    covariances: Vec<Vec<Vec<f64>>>,
    log_likelihoods: Vec<f64>,
}

fn matrix(rows: &[Vec<f64>]) -> DMatrix<f64> {
    DMatrix::from_fn(rows.len(), rows[0].len(), |row, column| rows[row][column])
}

#[test]
fn filtered_states_are_those_of_statsmodels() {
    // Rounding errors of some 60 steps of a contracting recursion on numbers of about 1.
    const WITHIN: f64 = 1e-11;
    for case in cases::<Case>("kalman") {
        let (transition, process) = (matrix(&case.transition), matrix(&case.process));
        let start = DMatrix::from_diagonal(&DVector::from_vec(case.start.clone()));
        let mut filter = Kalman::new(DVector::zeros(2), start).unwrap();
        for (step, measured) in case.measured.iter().enumerate() {
            if step > 0 {
                filter.predict(&transition, &process).unwrap();
            }
            let innovation = filter.update(&dvector![*measured], &dmatrix![1.0, 0.0], &dmatrix![case.noise]).unwrap();
            let state = filter.state() - DVector::from_vec(case.states[step].clone());
            assert!(state.amax() < WITHIN, "{step}: {state}");
            let covariance = filter.covariance() - matrix(&case.covariances[step]);
            assert!(covariance.amax() < WITHIN, "{step}: {covariance}");
            let density = innovation.log_likelihood - case.log_likelihoods[step];
            assert!(density.abs() < 100.0 * WITHIN, "{step}: {density}");
        }
    }
}

/// Locates a point from range and bearing on a circle around it, as an extended filter linearises them.
#[test]
fn an_extended_filter_finds_a_beacon() {
    let beacon = [2.0, -1.0f64];
    let mut filter = Kalman::new(dvector![1.9, -0.9], DMatrix::identity(2, 2) * 0.01).unwrap();
    let noise = dmatrix![1e-4, 0.0; 0.0, 1e-4];
    for step in 0..40 {
        let angle = 0.2 * f64::from(step);
        let from = [0.5 * angle.cos(), 0.5 * angle.sin()];
        let view = |x: f64, y: f64| ((x - from[0]).hypot(y - from[1]), (y - from[1]).atan2(x - from[0]));
        let (measured, (range, bearing)) = (view(beacon[0], beacon[1]), view(filter.state()[0], filter.state()[1]));
        let (dx, dy) = (filter.state()[0] - from[0], filter.state()[1] - from[1]);
        let jacobian = dmatrix![dx / range, dy / range; -dy / range.powi(2), dx / range.powi(2)];
        let turn =
            (measured.1 - bearing + std::f64::consts::PI).rem_euclid(std::f64::consts::TAU) - std::f64::consts::PI;
        filter.predict_extended(filter.state().clone(), &DMatrix::identity(2, 2), &DMatrix::zeros(2, 2)).unwrap();
        filter.update_extended(dvector![measured.0 - range, turn], &jacobian, &noise).unwrap();
    }
    let error = (filter.state()[0] - beacon[0]).hypot(filter.state()[1] - beacon[1]);
    // Measurements have no noise: the remaining error is that of the first linearisation, 0.14² / (2 × 1.8²) rad at 1.8
    // m, or 5 mm.
    assert!(error < 0.01, "{error}");
}

#[test]
fn a_refused_step_changes_nothing() {
    let mut filter = Kalman::new(dvector![1.0, 2.0], DMatrix::identity(2, 2)).unwrap();
    let before = filter.clone();
    let shape = filter.predict(&DMatrix::identity(3, 3), &DMatrix::identity(2, 2));
    assert!(matches!(shape, Err(KalmanError::Shape { rows: 3, expected_rows: 2, .. })), "{shape:?}");
    let nan = dvector![f64::NAN];
    let refused = filter.update(&nan, &dmatrix![1.0, 0.0], &dmatrix![1.0]);
    assert_eq!(refused, Err(KalmanError::NotFinite { what: "the measurement" }));
    let refused = filter.update(&dvector![1.0], &dmatrix![0.0, 0.0], &dmatrix![0.0]);
    assert_eq!(refused, Err(KalmanError::Singular));
    let refused = filter.predict(&(DMatrix::identity(2, 2) * 1e200), &DMatrix::identity(2, 2));
    assert_eq!(refused, Err(KalmanError::NotFinite { what: "the covariance" }));
    assert_eq!(filter, before);
}
