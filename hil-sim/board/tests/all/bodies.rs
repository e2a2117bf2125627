//! Robots with a body: what their wheels do to it and it to them, and what they see and bump into.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use crate::harness::{Bench, bench};
use r4_boards::Robot;
use r4_protocol::{Cause, Causes, ChannelId, ChannelKind, Mode, SafetyState};
use r4_world::{Person, Pose, Scene, Twist};

const RADIUS_M: f64 = 0.056;
const HALF_TRACK_M: f64 = 0.151;
const HALF_BASE_M: f64 = 0.12;

fn wheel(index: u8) -> ChannelId {
    ChannelId::new(ChannelKind::Dhb, index)
}

fn openscout(scene: impl FnOnce(&mut Scene)) -> Robot {
    let mut robot = r4_boards::load("openscout").expect("built in");
    scene(&mut robot.simulation.scene);
    robot
}

/// Sets the speeds of left and right wheels, rad/s.
async fn drive(bench: &Bench<'_>, left: f32, right: f32) {
    for (index, speed) in [left, right, left, right].into_iter().enumerate() {
        bench.set(wheel(index as u8), Mode::Speed, speed).await.unwrap();
    }
}

fn pose(bench: &Bench<'_>) -> Pose {
    bench.board.world().pose().expect("it has a body")
}

fn twist(bench: &Bench<'_>) -> Twist {
    bench.board.world().twist().expect("it has a body")
}

#[test]
fn wheels_drive_the_body_and_roll_with_it() {
    let robot = openscout(|_| {});
    bench(&robot, async |bench| {
        bench.host.arm().await.unwrap();
        drive(bench, 4.0, 4.0).await;
        bench.sleep_ms(3000).await;
        let Pose { x_m, y_m, yaw_rad } = pose(bench);
        let rolled_m = bench.position(wheel(0)) * RADIUS_M;
        // While it accelerates, with about 2 N at each wheel, wheels slip by 2 N x 0.005 1/N = 1 %, over a tenth of the way.
        assert!(x_m > 0.5 && (x_m / rolled_m - 1.0).abs() < 5e-3, "{x_m} m, {rolled_m} m");
        assert!(y_m.abs() < 0.01 && yaw_rad.abs() < 0.02, "{y_m} m, {yaw_rad} rad");
        assert!((twist(bench).forward_m_s - 4.0 * RADIUS_M).abs() < 0.01);
    });
}

/// The ratio of the tyre's compliances says how much of the wheels' speed turns the robot, if slip is little: with the linear law
/// `r b² / (l² + r b²)` (Trimble, Fox 2023), 86 %; the brush's slides a little at once.
#[test]
fn a_skid_steer_robot_turns_less_than_its_wheels_say() {
    let robot = openscout(|_| {});
    bench(&robot, async |bench| {
        bench.host.arm().await.unwrap();
        drive(bench, -3.0, 3.0).await;
        bench.sleep_ms(2000).await;
        let (l2, b2, ratio) = (HALF_BASE_M * HALF_BASE_M, HALF_TRACK_M * HALF_TRACK_M, 4.0);
        let kinematic = 3.0 * RADIUS_M / HALF_TRACK_M;
        let expected = kinematic * ratio * b2 / (l2 + ratio * b2);
        let Twist { forward_m_s, yaw_rad_s, .. } = twist(bench);
        assert!((yaw_rad_s / expected - 1.0).abs() < 0.06, "{yaw_rad_s} rad/s, {expected} rad/s of {kinematic}");
        assert!(forward_m_s.abs() < 0.01, "{forward_m_s} m/s");
    });
}

#[test]
fn a_wall_that_no_sensor_sees_stops_the_robot() {
    let robot = openscout(|scene| scene.add_walls(&[[-0.6, -2.0], [-0.6, 2.0]], false).unwrap());
    bench(&robot, async |bench| {
        bench.host.arm().await.unwrap();
        drive(bench, -4.0, -4.0).await;
        bench.sleep_ms(6000).await;
        let x_m = pose(bench).x_m;
        assert!((-0.40..-0.375).contains(&x_m), "the rear bumper of 20 mm is at the wall: {x_m} m");
        assert!(twist(bench).forward_m_s.abs() < 1e-3);
    });
}

#[test]
fn a_person_in_front_trips_the_board_before_anybody_is_touched() {
    let robot = openscout(|scene| {
        let path = vec![(2.0, [1.2, 2.0]), (3.0, [1.2, 0.1])];
        scene.add_person(Person { radius_m: 0.2, path }).unwrap();
    });
    bench(&robot, async |bench| {
        bench.host.arm().await.unwrap();
        drive(bench, 4.0, 4.0).await;
        let tripped = loop {
            let (state, causes) = bench.safety().await;
            if state == SafetyState::Tripped {
                break causes;
            }
            assert!(bench.clock.now_ns() < 8_000_000_000, "nobody was seen");
        };
        assert_eq!(tripped, Causes::only(Cause::Proximity));
        bench.sleep_ms(1000).await;
        let front_m = pose(bench).x_m + 0.20;
        assert!((0.8..1.0).contains(&front_m), "it stands {front_m} m from the start, the person at 1.0 m");
        assert!(twist(bench).forward_m_s.abs() < 1e-3);
    });
}
