//! Tests of paths and local planning.

use proptest::{collection::vec, prelude::*};
use r4_maps::{
    grid::{Frame, Grid},
    occupancy::clearance_m,
    plan::{Blocked, Drive, Limits, Local, PlanError, Preference, distances_m, route},
    pose::{Pose, distance_m},
};
use r4_maths::path::PathError;

const LIMITS: Limits =
    Limits { speed_m_s: 0.5, turn_rad_s: 1.5, acceleration_m_s2: 0.5, turn_acceleration_rad_s2: 3.0, clearance_m: 0.3 };
const PERIOD_S: f64 = 0.1;

fn frame(columns: usize, rows: usize) -> Frame {
    Frame::new(Pose::default(), 0.1, columns, rows).expect("within the limits")
}

fn local() -> Local {
    Local::new(LIMITS, Preference::default(), PERIOD_S).expect("within the limits")
}

fn driven(pose: Pose, drive: Drive) -> Pose {
    // In small straight steps, not by the planner's formula for an arc.
    (0..100).fold(pose, |pose, _| {
        let step_s = PERIOD_S / 100.0;
        pose.then(Pose::new(drive.speed_m_s * step_s, 0.0, drive.turn_rad_s * step_s))
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]
    #[test]
    fn distances_to_all_cells_are_those_of_single_ways(free in vec(prop::bool::weighted(0.7), 72), from in 0..72usize) {
        let free = Grid::of(frame(9, 8), free).unwrap();
        let start = free.frame().cell(from);
        match distances_m(&free, start) {
            Ok(all_m) => for (cell, found_m) in all_m.iter() {
                match route(&free, start, cell) {
                    // Equally long paths have their sums in another order.
                    Ok(way) => prop_assert!((way.cost - found_m).abs() < 1e-12),
                    Err(_) => prop_assert!(found_m.is_infinite()),
                }
            },
            Err(why) => {
                prop_assert_eq!(why, PathError::Blocked { column: start[0], row: start[1] }.into());
                prop_assert!(!free.values()[from]);
            }
        }
    }

    #[test]
    fn no_drive_among_obstacles_comes_too_near(obstacles in vec((0..60usize, 0..60usize), 1..25), target in [0.0..6.0, 0.0..6.0]) {
        let marked = Grid::from_fn(frame(60, 60), |[column, row]| {
            obstacles.iter().any(|(x, y)| *x == column && *y == row && (x.abs_diff(30) > 5 || y.abs_diff(30) > 5))
        });
        let clear_m = clearance_m(&marked);
        let (mut pose, mut drive) = (Pose::new(3.05, 3.05, 0.5), Drive::default());
        for _ in 0..150 {
            let next = match local().choose(&clear_m, pose, drive, target) {
                Ok(choice) => choice.drive,
                // The drive brakes on its arc, which was free.
                Err(Blocked::Ahead { .. }) => {
                    let speed_m_s = (drive.speed_m_s - LIMITS.acceleration_m_s2 * PERIOD_S).max(0.0);
                    let share = if drive.speed_m_s > 0.0 { speed_m_s / drive.speed_m_s } else { 0.0 };
                    Drive { speed_m_s, turn_rad_s: share * drive.turn_rad_s }
                }
                Err(why) => return Err(TestCaseError::fail(why.to_string())),
            };
            prop_assert!((next.speed_m_s - drive.speed_m_s).abs() <= LIMITS.acceleration_m_s2 * PERIOD_S + 1e-12);
            prop_assert!((0.0..=LIMITS.speed_m_s).contains(&next.speed_m_s) && next.turn_rad_s.abs() <= LIMITS.turn_rad_s);
            drive = next;
            pose = driven(pose, drive);
            // Arcs are checked every half cell, so that a place is up to 0.025 m from a check, and the distance is
            // interpolated between cells' centres, up to 0.071 m away.
            for (cell, _) in marked.iter().filter(|(_, marked)| **marked) {
                let away_m = distance_m(marked.frame().centre(cell), pose.point());
                prop_assert!(away_m > LIMITS.clearance_m - 0.1, "{} m at {:?}", away_m, pose);
            }
        }
    }
}

#[test]
fn a_route_round_a_wall_is_driven_to_its_end() {
    let marked = Grid::from_fn(frame(60, 40), |[column, row]| column == 30 && row < 28);
    let clear_m = clearance_m(&marked);
    let free = clear_m.map(|clear_m| *clear_m >= LIMITS.clearance_m + 0.1);
    let goal = [5.05, 0.55];
    let way = route(&free, free.frame().cell_at([0.55, 0.55]).unwrap(), free.frame().cell_at(goal).unwrap()).unwrap();
    let (mut pose, mut drive, mut along) = (Pose::new(0.55, 0.55, 0.0), Drive::default(), 0);
    let mut time_s = 0.0;
    while distance_m(pose.point(), goal) > 0.1 {
        while along + 1 < way.nodes.len() && distance_m(free.frame().centre(way.nodes[along]), pose.point()) < 0.5 {
            along += 1;
        }
        drive = local().choose(&clear_m, pose, drive, free.frame().centre(way.nodes[along])).unwrap().drive;
        pose = driven(pose, drive);
        time_s += PERIOD_S;
        assert!(time_s < 2.5 * way.cost / LIMITS.speed_m_s, "{time_s} s for {} m, at {pose:?}", way.cost);
    }
}

#[test]
fn what_blocks_is_said() {
    let marked = Grid::from_fn(frame(40, 20), |[column, _]| column == 20);
    let clear_m = clearance_m(&marked);
    let fast = Drive { speed_m_s: 0.5, turn_rad_s: 0.0 };
    // The drive needs 0.25 m to stop; the wall is at 0.3 m of clearance plus 0.1 m.
    let near = Pose::new(1.65, 1.0, 0.0);
    assert!(matches!(local().choose(&clear_m, near, fast, [3.0, 1.0]), Err(Blocked::Ahead { tried: 231 })));
    assert!(local().choose(&clear_m, near, Drive::default(), [3.0, 1.0]).is_ok());
    let inside = Pose::new(1.95, 1.0, 0.0);
    assert!(matches!(local().choose(&clear_m, inside, fast, [3.0, 1.0]), Err(Blocked::Here { .. })));
    let off = Pose::new(-1.0, 1.0, 0.0);
    assert_eq!(local().choose(&clear_m, off, fast, [3.0, 1.0]), Err(Blocked::Here { found_m: 0.0, needed_m: 0.3 }));
    assert_eq!(local().choose(&clear_m, near, fast, [f64::NAN, 1.0]), Err(Blocked::NotFinite));
    let bad = Limits { turn_rad_s: 0.0, ..LIMITS };
    let refused = Local::new(bad, Preference::default(), PERIOD_S);
    assert_eq!(refused, Err(PlanError::Parameter { what: "turn_rad_s", value: 0.0 }));
}
