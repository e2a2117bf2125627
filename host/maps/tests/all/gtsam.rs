//! Comparison of scalar fields with GTSAM's elimination: `tests/oracle/gmrf.py`.

use r4_maps::{
    field::{Field, Reading, Weights},
    grid::{Frame, Grid},
    pose::Pose,
};
use serde::Deserialize;

#[derive(Deserialize)]
struct Oracle {
    fields: Vec<Case>,
}

#[derive(Deserialize)]
struct Case {
    columns: usize,
    rows: usize,
    free: Vec<bool>,
    smoothness: f64,
    reading: f64,
    prior: f64,
    /// Readings as column, row and value.
    readings: Vec<(usize, usize, f64)>,
    mean: Vec<f64>,
    variance: Vec<f64>,
}

#[test]
fn means_and_variances_are_those_of_gtsam() {
    let oracle: Oracle = serde_json::from_str(include_str!("../oracle/gmrf.json")).expect("written by gmrf.py");
    assert_eq!(oracle.fields.len(), 3);
    for case in oracle.fields {
        let frame = Frame::new(Pose::default(), 0.2, case.columns, case.rows).expect("within the limits");
        let free = Grid::of(frame, case.free).expect("one for each cell");
        let Case { smoothness, reading, prior, .. } = case;
        // Readings do not age here: GTSAM's factors have no age.
        let mut field = Field::new(&free, Weights { smoothness, reading, forgetting_s: 1e12, prior }).unwrap();
        for (column, row, value) in case.readings {
            field.observe(Reading { cell: [column, row], value, at_s: 0.0 }).unwrap();
        }
        field.solve(1e-9).unwrap();
        let variances = field.variances();
        let cells = free.iter().filter(|(_, free)| **free).map(|(cell, _)| cell);
        for (cell, (mean, variance)) in cells.zip(case.mean.into_iter().zip(case.variance)) {
            assert!((field.mean(cell).unwrap() - mean).abs() < 1e-6, "{cell:?}");
            let found = variances.get(cell).unwrap().unwrap();
            assert!((found / variance - 1.0).abs() < 1e-6, "{cell:?}: {found}, {variance}");
        }
    }
}
