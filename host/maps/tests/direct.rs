//! Comparison of a field as large as a factory with faer's direct solve: `cargo test -p r4-maps --features direct`.

use r4_maps::{
    field::{Field, Reading, Weights},
    grid::{Frame, Grid},
    pose::Pose,
};

#[test]
fn means_of_a_factory_are_those_of_a_direct_solve() {
    // 60 m × 50 m in cells of 0.2 m, shelves 1 m wide with aisles of 1.6 m.
    let frame = Frame::new(Pose::default(), 0.2, 300, 250).expect("within the limits");
    let free = Grid::from_fn(frame, |[column, row]| column % 13 >= 5 || row % 60 < 10);
    let weights = Weights { smoothness: 0.5, reading: 10.0, forgetting_s: 1e6, prior: 1e-4 };
    let mut field = Field::new(&free, weights).unwrap();
    let aisle = (0..250).map(|step| [8 + 13 * (step / 25), 20 + step % 25]);
    for (step, cell) in aisle.enumerate() {
        let value = 50.0 * (step as f64 / 20.0).sin();
        field.observe(Reading { cell, value, at_s: step as f64 }).unwrap();
        field.wildfire(0.1, 2000);
    }
    field.solve(1e-6).unwrap();
    let direct = field.direct_means().unwrap();
    for (cell, mean) in direct.iter().filter_map(|(cell, mean)| mean.map(|mean| (cell, mean))) {
        assert!((field.mean(cell).unwrap() - mean).abs() < 1e-6, "{cell:?}");
    }
}
