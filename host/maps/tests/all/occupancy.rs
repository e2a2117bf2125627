//! Tests of occupancy by rays, and of distances.

use proptest::{collection::vec, prelude::*};
use r4_maps::{
    grid::{Frame, Grid, GridError},
    occupancy::{InverseSensor, Occupancy, OccupancyError, State, clearance_m, is_clear, traverse},
    pose::{Pose, distance_m},
};

fn frame(columns: usize, rows: usize) -> Frame {
    Frame::new(Pose::new(-1.0, 2.0, 0.3), 0.25, columns, rows).expect("within the limits")
}

proptest! {
    #[test]
    fn a_line_crosses_the_cells_that_points_on_it_lie_in([a, b, c, d] in [0.001..9.999f64, 0.001..7.999, 0.001..9.999, 0.001..7.999]) {
        let frame = frame(10, 8);
        let [from, to] = [[a, b], [c, d]].map(|cells| frame.origin().outer(cells.map(|along| along * 0.25)));
        let crossed: Vec<_> = traverse(&frame, from, to).unwrap().collect();
        for pair in crossed.windows(2) {
            prop_assert!(frame.neighbours(pair[0].cell).any(|next| next == pair[1].cell));
            prop_assert!(pair[0].entered_m <= pair[1].entered_m);
        }
        prop_assert!(crossed.last().unwrap().entered_m <= distance_m(from, to));
        // Each point in between lies in the cell that was entered last, or on its edge.
        for step in 0..=200 {
            let share = f64::from(step) / 200.0;
            let point = [from[0] + share * (to[0] - from[0]), from[1] + share * (to[1] - from[1])];
            let cells = frame.continuous(point);
            let inside = crossed.iter().any(|crossing| {
                (0..2).all(|axis| (-1e-9..=1.0 + 1e-9).contains(&(cells[axis] - crossing.cell[axis] as f64)))
            });
            prop_assert!(inside, "{point:?} of {crossed:?}");
        }
    }

    #[test]
    fn distances_are_those_of_a_search_over_all_cells(marked in vec(prop::bool::weighted(0.1), 63)) {
        let frame = frame(9, 7);
        let marked = Grid::of(frame, marked).unwrap();
        for (cell, found_m) in clearance_m(&marked).iter() {
            let there = marked.iter().filter(|(_, marked)| **marked).map(|(other, _)| distance_m(frame.centre(cell), frame.centre(other)));
            let expected_m = there.fold(f64::INFINITY, f64::min);
            prop_assert!(*found_m == expected_m || (found_m - expected_m).abs() < 1e-12, "{cell:?} {found_m} {expected_m}");
        }
    }

    #[test]
    fn any_ray_is_taken_or_refused(x in -2.0..4.0, y in 1.0..6.0, bearing in -9.0..9.0, range in prop_oneof![-1.0..20.0, Just(f64::NAN), Just(f64::INFINITY)]) {
        let mut map = Occupancy::new(frame(10, 8), InverseSensor::lidar(6.0)).unwrap();
        let before = map.clone();
        if map.insert(Pose::new(x, y, 0.1), bearing, range).is_err() {
            prop_assert_eq!(map, before);
        } else {
            prop_assert_ne!(map, before);
        }
    }
}

#[test]
fn log_odds_add_up_and_are_clamped() {
    let sensor = InverseSensor { end_occupied: 0.8, crossed_occupied: 0.3, ..InverseSensor::lidar(5.0) };
    let frame = Frame::new(Pose::default(), 1.0, 5, 1).unwrap();
    let mut map = Occupancy::new(frame, sensor).unwrap();
    map.insert(Pose::new(0.5, 0.5, 0.0), 0.0, 3.0).unwrap();
    // Bayes' rule by hand: odds 0.8/0.2 once, then 0.3/0.7.
    assert!((map.probability([3, 0]).unwrap() - 0.8).abs() < 1e-12);
    map.insert(Pose::new(0.5, 0.5, 0.0), 0.0, f64::INFINITY).unwrap();
    let odds: f64 = 4.0 * 3.0 / 7.0;
    assert!((map.probability([3, 0]).unwrap() - odds / (1.0 + odds)).abs() < 1e-12);
    assert!((map.probability([4, 0]).unwrap() - 0.3).abs() < 1e-12);
    (0..50).for_each(|_| map.insert(Pose::new(0.5, 0.5, 0.0), 0.0, 3.0).unwrap());
    assert!((map.probability([3, 0]).unwrap() - sensor.clamp[1]).abs() < 1e-12);
    // An obstacle that moved away is forgotten after at most ln(0.97/0.03 × 0.88/0.12) / ln(0.7/0.3) rays.
    (0..7).for_each(|_| map.insert(Pose::new(0.5, 0.5, 0.0), 0.0, f64::INFINITY).unwrap());
    assert_eq!(map.state([3, 0]), Ok(State::Free));
}

#[test]
fn inflation_keeps_a_round_robot_off_walls_and_the_unknown() {
    let frame = Frame::new(Pose::default(), 0.1, 30, 30).unwrap();
    let mut map = Occupancy::new(frame, InverseSensor::lidar(5.0)).unwrap();
    for degree in (0..3600).map(|tenth| f64::from(tenth) / 10.0) {
        // A round room with a radius of 1.2 m.
        map.insert(Pose::new(1.5, 1.5, 0.0), degree.to_radians(), 1.2).unwrap();
    }
    let free = map.free_for(0.4);
    assert_eq!(free.at([1.5, 1.5]), Ok(&true));
    for (cell, is_free) in free.iter() {
        let radius_m = distance_m(frame.centre(cell), [1.5, 1.5]);
        // Walls are the cells in which the rays end; their centres are up to half a diagonal (0.071 m) off.
        assert!(!is_free || radius_m < 1.2 - 0.4 + 0.071, "{cell:?}");
        assert!(*is_free || radius_m > 1.2 - 0.4 - 0.071, "{cell:?}");
    }
    assert_eq!(map.state([0, 0]), Ok(State::Unknown));
}

#[test]
fn contradictory_parameters_and_readings_are_refused() {
    let frame = frame(4, 4);
    for sensor in [
        InverseSensor { end_occupied: 0.5, ..InverseSensor::lidar(5.0) },
        InverseSensor { crossed_occupied: 0.0, ..InverseSensor::lidar(5.0) },
        InverseSensor { clamp: [0.4, 0.9], ..InverseSensor::lidar(5.0) },
        InverseSensor::lidar(f64::INFINITY),
        InverseSensor::lidar(f64::NAN),
    ] {
        assert!(matches!(Occupancy::new(frame, sensor), Err(OccupancyError::Model { .. })), "{sensor:?}");
    }
    let mut map = Occupancy::new(frame, InverseSensor::lidar(5.0)).unwrap();
    let inside = Pose::new(-0.9, 2.4, 0.0);
    assert!(matches!(map.insert(inside, 0.0, -0.1), Err(OccupancyError::Reading { .. })));
    assert!(matches!(map.insert(inside, f64::NAN, 1.0), Err(OccupancyError::Reading { .. })));
    assert!(matches!(map.insert(Pose::default(), 0.0, 1.0), Err(OccupancyError::Grid(GridError::Outside { .. }))));
    let none = Grid::filled(frame, false);
    assert_eq!(is_clear(&none, inside.point(), [-0.7, 2.6]), Ok(true));
    assert!(is_clear(&none, inside.point(), [f64::NAN, 2.6]).is_err());
}
