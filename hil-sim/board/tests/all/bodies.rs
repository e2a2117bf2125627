//! Robots with a body: interaction of motors and body, sensors on the body, and collisions.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use crate::{
    harness::{Bench, bench},
    whole_board::sample,
};
use r4_boards::Robot;
use r4_protocol::{Cause, Causes, ChannelId, ChannelKind, Mode, SafetyState, Sample};
use r4_world::{AnyBody, BalanceTail, Person, Pose, Scene, TailState, Twist};

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
        // While accelerating with about 2 N at each wheel, wheels slip by 2 N x 0.005 1/N = 1 %, over a tenth of the
        // distance.
        assert!(x_m > 0.5 && (x_m / rolled_m - 1.0).abs() < 5e-3, "{x_m} m, {rolled_m} m");
        assert!(y_m.abs() < 0.01 && yaw_rad.abs() < 0.02, "{y_m} m, {yaw_rad} rad");
        assert!((twist(bench).forward_m_s - 4.0 * RADIUS_M).abs() < 0.01);
    });
}

/// The ratio of the tyre's compliances decides which share of the wheels' speed turns the robot at small slip: with the
/// linear law `r b² / (l² + r b²)` (Trimble, Fox 2023), 86 %; with the brush a part slides at once.
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

const MOTOR_1: ChannelId = ChannelId::new(ChannelKind::Bldc, 0);
const MOTOR_2: ChannelId = ChannelId::new(ChannelKind::Bldc, 1);

fn tail(bench: &Bench<'_>) -> BalanceTail {
    let mut world = bench.board.world();
    world.catch_up();
    let Some(AnyBody::BalanceTail(tail)) = world.body() else { panic!("a tail") };
    (**tail).clone()
}

/// Torque of a drive, N m, and speed of its motor, rad/s.
fn motor(bench: &Bench<'_>, channel: ChannelId) -> [f64; 2] {
    let mut world = bench.board.world();
    let drive = world.bldc(channel).expect("it has the drive");
    [drive.torque_nm(), drive.speed_rad_s()]
}

/// Position of an encoder on a motor's shaft by its count, rad.
async fn counted_rad(bench: &Bench<'_>, index: u8) -> f64 {
    let Sample::Encoder { position, .. } = sample(bench, ChannelId::new(ChannelKind::Encoder, index)).await else {
        panic!("an encoder")
    };
    f64::from(position) / 2048.0 * std::f64::consts::TAU
}

/// The motor at the back lifts the tail: its torque is that of the cable's statics, its encoder counts its turns, the
/// person leans forwards under the weight that then hangs farther behind, and when the host stops the board, the brakes
/// hold all of it.
#[test]
fn a_brushless_drive_lifts_a_tail_and_its_brake_holds_it() {
    let robot = r4_boards::load("balance-tail").expect("built in");
    bench(&robot, async |bench| {
        bench.host.arm().await.unwrap();
        // a tenth of 80 rad/s, minus the load over the speed loop's gain of 0.25 N m s/rad
        bench.set(MOTOR_2, Mode::Duty, 0.1).await.unwrap();
        bench.set(MOTOR_1, Mode::Duty, 0.0).await.unwrap();
        bench.sleep_ms(3000).await;
        let [torque_nm, speed_rad_s] = motor(bench, MOTOR_2);
        assert!((0.25 * (8.0 - speed_rad_s) - torque_nm).abs() < 0.02, "{torque_nm} N m, {speed_rad_s} rad/s");
        let TailState { angle_rad: [trunk, first, _], .. } = *tail(bench).state();
        assert!(first > 0.3 && trunk < 0.0, "raised by {first} rad, the person at {trunk} rad");
        // the weight at the back over the ratio, plus 10 % of it and 0.3 N m lost on the way up
        let lifted_nm = -9.80665 * tail(bench).tail_x_m() * 6.9;
        let expected_nm = (lifted_nm + 0.3) / 25.0 / 0.99_f64.powi(10);
        assert!((torque_nm / expected_nm - 1.0).abs() < 0.1, "{torque_nm} N m, {expected_nm} N m");
        bench.host.stop().await.unwrap();
        bench.sleep_ms(200).await;
        let stopped_rad = bench.position(MOTOR_2);
        let counted = counted_rad(bench, 1).await;
        // a count is 3 mrad
        assert!((counted - stopped_rad).abs() < 0.004, "{counted} rad, {stopped_rad} rad");
        bench.sleep_ms(2000).await;
        assert_eq!((bench.position(MOTOR_2), motor(bench, MOTOR_2)[1]), (stopped_rad, 0.0));
        assert!(bench.board.world().misuse().is_empty());
    });
}

/// Values as printed: motor 1 at the back has 0.625 N m, which the ratio of 25 turns into 15.6 N m, and the tail's
/// weight needs 50 N m.
#[test]
fn motor_1_at_the_back_lifts_the_tail_only_a_little() {
    let mut robot = r4_boards::load("balance-tail").expect("built in");
    robot.simulation.body.as_mut().expect("a tail").channels.reverse();
    bench(&robot, async |bench| {
        bench.host.arm().await.unwrap();
        bench.set(MOTOR_1, Mode::Duty, 0.2).await.unwrap();
        bench.set(MOTOR_2, Mode::Duty, 0.0).await.unwrap();
        let mut highest = 0.0_f64;
        for _ in 0..400 {
            bench.sleep_ms(10).await;
            let [torque_nm, speed_rad_s] = motor(bench, MOTOR_1);
            assert!(
                torque_nm <= 0.625 + 1e-9 && torque_nm * speed_rad_s <= 573.0,
                "{torque_nm} N m, {speed_rad_s} rad/s"
            );
            highest = highest.max(tail(bench).state().angle_rad[1]);
        }
        // sin(0.32) of 50 N m, with some oscillation; upright it would be 1.57
        assert!((0.15..0.7).contains(&highest), "{highest} rad");
    });
}

/// Load of the robot file: 10 kg at 0.35 m, 5 s after the start.
#[test]
fn a_person_leans_forwards_under_a_load() {
    let robot = r4_boards::load("balance-tail").expect("built in");
    bench(&robot, async |bench| {
        bench.sleep_ms(4990 - bench.clock.now_ns() / 1_000_000).await;
        assert!(tail(bench).wearer_x_m().abs() < 1e-3, "{} m", tail(bench).wearer_x_m());
        bench.sleep_ms(8000).await;
        // (10 kg 9.81 m/s2 0.35 m) / (stiffness of the ankle minus that of gravity on person, load and tail: 1200 - 662
        // - 103 - 25 N m/rad) times 0.90 m: 75.3 mm, minus 0.3 mm by the sines
        let x_m = tail(bench).wearer_x_m();
        assert!((x_m - 0.0753).abs() < 1e-3, "{x_m} m");
    });
}
