//! Tests of frames: cells and points of the world.

use proptest::{array::uniform3, prelude::*};
use r4_maps::{
    grid::{Frame, Grid, GridError},
    pose::{Pose, distance_m},
};

fn frames() -> impl Strategy<Value = Frame> {
    let pose = (-1e3..1e3, -1e3..1e3, -4.0..4.0).prop_map(|(x, y, yaw)| Pose::new(x, y, yaw));
    (pose, 0.01..10.0, 1..60usize, 1..60usize).prop_map(|(origin, cell_m, columns, rows)| {
        Frame::new(origin, cell_m, columns, rows).expect("within the limits")
    })
}

proptest! {
    #[test]
    fn a_cells_centre_lies_in_it(frame in frames(), share in 0.0..1.0) {
        let index = (share * frame.cells() as f64) as usize;
        let cell = frame.cell(index);
        prop_assert_eq!(frame.index(cell), Ok(index));
        prop_assert_eq!(frame.cell_at(frame.centre(cell)), Ok(cell));
    }

    #[test]
    fn neighbours_are_one_side_away_and_mutual(frame in frames(), share in 0.0..1.0) {
        let cell = frame.cell((share * frame.cells() as f64) as usize);
        for next in frame.neighbours(cell) {
            // Coordinates of up to 2e3 m in 53 bits.
            prop_assert!((distance_m(frame.centre(cell), frame.centre(next)) / frame.cell_m() - 1.0).abs() < 1e-9);
            prop_assert!(frame.neighbours(next).any(|back| back == cell));
        }
        let inside = cell[0] > 0 && cell[1] > 0 && cell[0] + 1 < frame.columns() && cell[1] + 1 < frame.rows();
        prop_assert_eq!(inside, frame.neighbours_8(cell).count() == 8);
    }

    #[test]
    fn a_plane_is_interpolated_exactly(frame in frames(), [u, v] in [0.0..1.0, 0.0..1.0]) {
        let plane = |[x, y]: [f64; 2]| 3.0 * x - 2.0 * y + 1.0;
        let grid = Grid::from_fn(frame, |cell| plane(frame.centre(cell)));
        // Between the centres, where the border's values are not extended.
        let along = |share: f64, cells: usize| (0.5 + share * (cells - 1) as f64) * frame.cell_m();
        let point = frame.origin().outer([along(u, frame.columns()), along(v, frame.rows())]);
        prop_assert!((grid.interpolated(point).unwrap() - plane(point)).abs() < 1e-8);
    }

    #[test]
    fn poses_compose_and_come_back(a in uniform3(-9.0..9.0f64), b in uniform3(-9.0..9.0f64)) {
        let [a, b] = [a, b].map(|[x, y, yaw]| Pose::new(x, y, r4_maps::pose::wrapped(yaw)));
        let back = a.between(a.then(b));
        prop_assert!((back.x_m - b.x_m).abs() < 1e-12 && (back.y_m - b.y_m).abs() < 1e-12);
        prop_assert!(r4_maps::pose::wrapped(back.yaw_rad - b.yaw_rad).abs() < 1e-12);
    }
}

#[test]
fn impossible_grids_and_places_are_refused() {
    let origin = Pose::default();
    assert_eq!(Frame::new(origin, 0.0, 1, 1), Err(GridError::Frame { cell_m: 0.0, origin }));
    assert!(matches!(Frame::new(origin, f64::NAN, 1, 1), Err(GridError::Frame { .. })));
    assert!(matches!(Frame::new(Pose::new(0.0, 0.0, f64::INFINITY), 1.0, 1, 1), Err(GridError::Frame { .. })));
    assert_eq!(Frame::new(origin, 1.0, 0, 4), Err(GridError::Size { columns: 0, rows: 4 }));
    assert!(matches!(Frame::new(origin, 1.0, usize::MAX, 2), Err(GridError::Size { .. })));
    let frame = Frame::new(origin, 1.0, 2, 3).unwrap();
    assert_eq!(frame.index([2, 0]), Err(GridError::NoCell { column: 2, row: 0, columns: 2, rows: 3 }));
    for point in [[-1e-9, 0.5], [2.0, 0.5], [0.5, 3.0], [f64::NAN, 0.5], [0.5, f64::INFINITY]] {
        assert!(matches!(frame.cell_at(point), Err(GridError::Outside { .. })), "{point:?}");
    }
    assert_eq!(Grid::of(frame, vec![0.0; 5]), Err(GridError::Values { values: 5, cells: 6 }));
}
