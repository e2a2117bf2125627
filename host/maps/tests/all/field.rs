//! Comparison of scalar fields with a dense solve.

use nalgebra::{DMatrix, DVector};
use proptest::{collection::vec, prelude::*};
use r4_maps::{
    field::{Field, FieldError, Reading, Weights},
    grid::{Cell, Frame, Grid, GridError},
    pose::Pose,
};

/// Weights of the published gas maps.
const GAS: Weights = Weights { smoothness: 0.5, reading: 10.0, forgetting_s: 1e6, prior: 1e-4 };

fn frame(columns: usize, rows: usize) -> Frame {
    Frame::new(Pose::default(), 0.2, columns, rows).expect("within the limits")
}

/// Computes means and covariance from the energy as it is written, over all free cells in their order.
fn dense(
    free: &Grid<bool>,
    weights: Weights,
    readings: &[Reading],
    now_s: f64,
) -> (Vec<Cell>, DVector<f64>, DMatrix<f64>) {
    let cells: Vec<Cell> = free.iter().filter(|(_, free)| **free).map(|(cell, _)| cell).collect();
    let mut a = DMatrix::from_diagonal_element(cells.len(), cells.len(), weights.prior);
    let mut h = DVector::zeros(cells.len());
    for (i, one) in cells.iter().enumerate() {
        for (j, other) in cells.iter().enumerate() {
            if one[0].abs_diff(other[0]) + one[1].abs_diff(other[1]) == 1 {
                a[(i, i)] += weights.smoothness;
                a[(i, j)] -= weights.smoothness;
            }
        }
        for reading in readings.iter().filter(|reading| reading.cell == *one) {
            let weight = 1.0 / (1.0 / weights.reading + (now_s - reading.at_s) / weights.forgetting_s);
            a[(i, i)] += weight;
            h[i] += weight * reading.value;
        }
    }
    let covariance = a.cholesky().expect("positive definite").inverse();
    (cells, &covariance * h, covariance)
}

fn worst(field: &Field, cells: &[Cell], means: &DVector<f64>) -> f64 {
    let errors = cells.iter().zip(means.iter()).map(|(cell, mean)| (field.mean(*cell).expect("free") - mean).abs());
    errors.fold(0.0, f64::max)
}

/// Makes a map of 8 × 8 cells with a wall that has a gap, and six readings.
fn walled() -> (Grid<bool>, Vec<Reading>) {
    let free = Grid::from_fn(frame(8, 8), |[column, row]| column != 4 || row == 6);
    let readings = [([0, 0], 3.0), ([2, 5], -1.0), ([3, 7], 12.0), ([5, 1], 40.0), ([7, 7], 0.5), ([6, 4], 7.0)];
    let reading = |(at_s, (cell, value)): (f64, (Cell, f64))| Reading { cell, value, at_s };
    (free, (0..).map(f64::from).zip(readings).map(reading).collect())
}

#[test]
fn messages_come_to_the_means_of_a_dense_solve() {
    let (free, readings) = walled();
    let mut field = Field::new(&free, GAS).unwrap();
    readings.iter().for_each(|reading| field.observe(*reading).unwrap());
    let (cells, means, _) = dense(&free, GAS, &readings, 5.0);
    // A residual of 1e-13 may be an error of λp / λd = 5000 times as much.
    let spent = field.wildfire(1e-13, usize::MAX);
    assert!(spent.settled && worst(&field, &cells, &means) < 1e-8, "{spent:?} {}", worst(&field, &cells, &means));

    let mut field = Field::new(&free, GAS).unwrap();
    readings.iter().for_each(|reading| field.observe(*reading).unwrap());
    let by_residual = field.settle(1e-13, usize::MAX);
    assert!(by_residual.settled && worst(&field, &cells, &means) < 1e-8, "{by_residual:?}");
}

#[test]
fn variances_of_messages_are_too_small_and_those_of_the_factor_exact() {
    let (free, readings) = walled();
    let mut field = Field::new(&free, GAS).unwrap();
    readings.iter().for_each(|reading| field.observe(*reading).unwrap());
    field.settle(1e-13, usize::MAX);
    let (cells, _, covariance) = dense(&free, GAS, &readings, 5.0);
    let (exact, loops) = (field.variances(), field.propagated_variances());
    let mut ratios = Vec::new();
    for (index, cell) in cells.iter().enumerate() {
        let truth = covariance[(index, index)];
        // 56 unknowns and a condition number of 1e5.
        assert!((exact.get(*cell).unwrap().unwrap() / truth - 1.0).abs() < 1e-10);
        ratios.push(loops.get(*cell).unwrap().unwrap() / truth);
    }
    // Here down to a third of the true variance. None is too great: walks that the loops double are missing.
    assert!(ratios.iter().all(|ratio| *ratio < 1.0 + 1e-9), "{ratios:?}");
    let least = ratios.iter().copied().fold(1.0, f64::min);
    assert!((0.2..0.6).contains(&least), "{least}");
}

#[test]
fn on_a_corridor_without_loops_messages_have_the_true_variance() {
    let free = Grid::filled(frame(40, 1), true);
    let readings = [Reading { cell: [3, 0], value: 5.0, at_s: 0.0 }, Reading { cell: [30, 0], value: -5.0, at_s: 2.0 }];
    let mut field = Field::new(&free, GAS).unwrap();
    readings.iter().for_each(|reading| field.observe(*reading).unwrap());
    field.settle(1e-13, usize::MAX);
    let (cells, means, covariance) = dense(&free, GAS, &readings, 2.0);
    assert!(worst(&field, &cells, &means) < 1e-8);
    for (index, cell) in cells.iter().enumerate() {
        let found = field.propagated_variances().get(*cell).unwrap().unwrap();
        assert!((found / covariance[(index, index)] - 1.0).abs() < 1e-8, "{cell:?}");
    }
}

#[test]
fn nothing_passes_a_wall_and_unknown_cells_have_no_value() {
    let free = Grid::from_fn(frame(9, 5), |[column, _]| column != 4);
    let mut field = Field::new(&free, GAS).unwrap();
    field.observe(Reading { cell: [0, 0], value: 100.0, at_s: 0.0 }).unwrap();
    field.solve(1e-6).unwrap();
    assert!(field.mean([3, 4]).unwrap() > 90.0);
    assert_eq!(field.mean([5, 0]), Ok(0.0));
    assert_eq!(field.means().get([4, 0]), Ok(&None));
    assert_eq!(field.mean([4, 0]), Err(FieldError::NotFree { cell: [4, 0] }));
}

#[test]
fn a_solve_and_messages_agree_and_go_on_from_each_other() {
    let (free, readings) = walled();
    let mut field = Field::new(&free, GAS).unwrap();
    readings.iter().for_each(|reading| field.observe(*reading).unwrap());
    let solved = field.solve(1e-7).unwrap();
    let (cells, means, _) = dense(&free, GAS, &readings, 5.0);
    assert!(worst(&field, &cells, &means) < 1e-7 && field.error_bound() < 1e-3, "{solved:?}");
    // At the fixed point no message remains to be sent.
    assert_eq!(field.settle(1e-9, 1000).updates, 0);
    assert!(worst(&field, &cells, &means) < 1e-7);
    // A further reading is propagated from there.
    let next = Reading { cell: [1, 1], value: 9.0, at_s: 6.0 };
    field.observe(next).unwrap();
    field.settle(1e-13, usize::MAX);
    let (cells, means, _) = dense(&free, GAS, &[readings, vec![next]].concat(), 6.0);
    assert!(worst(&field, &cells, &means) < 1e-7);
}

#[test]
fn a_budget_interrupts_and_the_rest_is_kept() {
    let free = Grid::filled(frame(30, 30), true);
    let mut field = Field::new(&free, GAS).unwrap();
    field.observe(Reading { cell: [15, 15], value: 10.0, at_s: 0.0 }).unwrap();
    let mut whole = field.clone();
    let mut updates = 0;
    loop {
        let spent = field.wildfire(1e-6, 50);
        assert!(spent.updates <= 50);
        updates += spent.updates;
        if spent.settled {
            break;
        }
    }
    assert_eq!(updates, whole.wildfire(1e-6, usize::MAX).updates);
    assert_eq!(field.means(), whole.means());
}

#[test]
fn variances_with_a_reading_are_those_after_it() {
    let (free, readings) = walled();
    let mut field = Field::new(&free, GAS).unwrap();
    readings.iter().for_each(|reading| field.observe(*reading).unwrap());
    let foreseen = field.variances_with(&field.variances(), [7, 0]).unwrap();
    field.observe(Reading { cell: [7, 0], value: -3.0, at_s: 5.0 }).unwrap();
    for (cell, variance) in field.variances().iter() {
        match (variance, foreseen.get(cell).unwrap()) {
            (Some(exact), Some(foreseen)) => assert!((foreseen / exact - 1.0).abs() < 1e-6, "{cell:?}"),
            (exact, foreseen) => assert_eq!(exact, foreseen),
        }
    }
}

#[test]
fn impossible_fields_and_readings_are_refused() {
    let (free, _) = walled();
    assert_eq!(Field::new(&free.map(|_| false), GAS).err(), Some(FieldError::NoFreeCell));
    let flat = Weights { prior: 0.0, ..GAS };
    assert_eq!(Field::new(&free, flat).err(), Some(FieldError::Weight { what: "prior", value: 0.0 }));
    let mut field = Field::new(&free, GAS).unwrap();
    let reading = Reading { cell: [0, 0], value: 1.0, at_s: 3.0 };
    assert_eq!(field.observe(Reading { cell: [4, 0], ..reading }), Err(FieldError::NotFree { cell: [4, 0] }));
    assert!(matches!(
        field.observe(Reading { cell: [8, 0], ..reading }),
        Err(FieldError::Grid(GridError::NoCell { .. }))
    ));
    assert!(matches!(field.observe(Reading { value: f64::NAN, ..reading }), Err(FieldError::NotFinite { .. })));
    assert!(matches!(field.observe(Reading { at_s: f64::INFINITY, ..reading }), Err(FieldError::NotFinite { .. })));
    field.observe(reading).unwrap();
    assert_eq!(field.advance(2.0), Err(FieldError::Backwards { asked_s: 2.0, now_s: 3.0 }));
    assert!(field.on(&Grid::filled(frame(3, 3), true)).is_err());
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]
    #[test]
    fn any_map_is_solved_as_a_dense_matrix_is(
        free in vec(prop::bool::weighted(0.7), 110),
        places in vec((0..110usize, -50.0..50.0f64, 0.0..30.0f64), 0..12),
        forgetting_s in 1.0..1e4f64,
    ) {
        let weights = Weights { forgetting_s, ..GAS };
        let free = Grid::of(frame(11, 10), free).unwrap();
        prop_assume!(free.values().iter().any(|free| *free));
        let mut field = Field::new(&free, weights).unwrap();
        let mut readings = Vec::new();
        let mut at_s = 0.0;
        for (index, value, wait_s) in places {
            at_s += wait_s;
            let reading = Reading { cell: free.frame().cell(index), value, at_s };
            if free.values()[index] {
                field.observe(reading).unwrap();
                field.wildfire(0.1, 30);
                readings.push(reading);
            } else {
                prop_assert!(field.observe(reading).is_err());
            }
        }
        let (cells, means, covariance) = dense(&free, weights, &readings, readings.last().map_or(0.0, |last| last.at_s));
        field.solve(1e-6).unwrap();
        prop_assert!(worst(&field, &cells, &means) < 1e-6);
        let variances = field.variances();
        for (index, cell) in cells.iter().enumerate() {
            let found = variances.get(*cell).unwrap().unwrap();
            prop_assert!((found / covariance[(index, index)] - 1.0).abs() < 1e-9, "{:?}", cell);
        }
        // The same readings on a map with one more wall.
        let walled = Grid::from_fn(*free.frame(), |cell| cell[0] != 5 && *free.get(cell).unwrap());
        prop_assume!(walled.values().iter().any(|free| *free));
        let mut moved = field.on(&walled).unwrap();
        let kept: Vec<_> = readings.into_iter().filter(|reading| reading.cell[0] != 5).collect();
        let now_s = field.readings().last().map_or(0.0, |last| last.at_s);
        let (cells, means, _) = dense(&walled, weights, &kept, now_s);
        let solved = moved.solve(1e-6).unwrap();
        let error = worst(&moved, &cells, &means);
        prop_assert!(error < 1e-6, "{} {:?} {} {}", error, solved, moved.error_bound(), means.len());
    }
}
