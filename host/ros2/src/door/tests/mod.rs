//! Tests of the node in virtual time, without DDS: the tests send orders as ROS would, and check the reports.

mod managed;
mod parameters;
mod trajectories;

use std::{cell::RefCell, pin::pin};

use futures::{
    channel::{mpsc::UnboundedSender, oneshot},
    future::{Either, select},
};
use r4_rig::{Rig, Session};

use super::*;
use crate::message::{JointState, JointTrajectory, Odometry as OdometryMessage, Time, Twist, Vector3};

/// ROS time when the simulation begins, s.
const START_S: i32 = 1_000;

/// Access of a test script to a node.
struct Ros<'s> {
    session: &'s Session<'s>,
    orders: UnboundedSender<Order>,
    reports: &'s RefCell<Vec<Report>>,
}

/// Runs a node on a simulated board, and `script` with access to it.
fn beside(board: &str, script: impl AsyncFnOnce(&Ros<'_>)) {
    beside_node(board, false, script);
}

/// Runs a node as [`beside`] does; `is_managed` selects a managed node.
fn beside_node(board: &str, is_managed: bool, script: impl AsyncFnOnce(&Ros<'_>)) {
    let rig = Rig::new(board.parse().expect("a board"));
    let served = rig.run(None, async |session| {
        let (orders, queue) = futures::channel::mpsc::unbounded();
        let reports = RefCell::new(Vec::new());
        let start = Stamp::from_time(Time { sec: START_S, nanosec: 0 }).expect("a moment");
        let door = Door { clock: RosClock::Simulated { start }, has_transform: true, is_managed };
        let serve = door.serve(session, queue, |report| {
            reports.borrow_mut().push(report);
            true
        });
        let ros = Ros { session, orders, reports: &reports };
        match select(pin!(serve), pin!(script(&ros))).await {
            Either::Left((ended, _)) => panic!("the node ended: {ended:?}"),
            Either::Right(((), _)) => Ok::<_, Error>(()),
        }
    });
    served.expect("a session");
}

impl Ros<'_> {
    fn send(&self, order: Order) {
        self.orders.unbounded_send(order).expect("it is served");
    }

    async fn sleep_s(&self, seconds: f64) {
        self.session.board.sleep_s(seconds).await;
    }

    async fn call(&self, request: Request) -> TriggerResponse {
        let (answer, answered) = oneshot::channel();
        self.send(Order::Call { request, answer });
        answered.await.expect("an answer")
    }

    async fn armed(&self) {
        let answer = self.call(Request::Arm).await;
        assert!(answer.success, "{}", answer.message);
    }

    fn velocity(&self, forward_m_s: f64) {
        let twist = Twist { linear: Vector3 { x: forward_m_s, ..Vector3::default() }, ..Twist::default() };
        self.send(Order::Velocity { stamp: Some(Stamp::default()), twist });
    }

    /// Sends a velocity every 20 ms for `seconds`.
    async fn drive(&self, forward_m_s: f64, seconds: f64) {
        for _ in 0..(seconds / 0.02) as u32 {
            self.velocity(forward_m_s);
            self.sleep_s(0.02).await;
        }
    }

    fn last<T>(&self, of: impl Fn(&Report) -> Option<T>) -> Option<T> {
        self.reports.borrow().iter().rev().find_map(of)
    }

    fn odometry(&self) -> OdometryMessage {
        let odometry = self.last(|report| match report {
            Report::Odometry(message) => Some(message.clone()),
            _ => None,
        });
        odometry.expect("odometry")
    }

    fn speed_m_s(&self) -> f64 {
        self.odometry().twist.twist.linear.x
    }

    fn state(&self) -> String {
        let state = self.last(|report| match report {
            Report::State(text) => Some(text.data.clone()),
            _ => None,
        });
        state.expect("a state")
    }

    /// Returns the last position (rad) and speed (rad/s) of a joint.
    fn joint(&self, name: &str) -> (f64, f64) {
        let joints = self.last(|report| match report {
            Report::Joints(joints) => {
                let at = joints.name.iter().position(|of| of == name)?;
                Some((joints.position[at], joints.velocity[at]))
            }
            _ => None,
        });
        joints.expect("joint states")
    }

    /// Returns the message of the last status about commands.
    fn of_commands(&self) -> String {
        let said = self.last(|report| match report {
            Report::Diagnostics(array) => Some(array.status[1].message.clone()),
            _ => None,
        });
        said.expect("diagnostics")
    }
}

#[test]
fn a_robot_drives_while_it_is_told_to_and_stops_by_its_lease() {
    beside("sim:openscout", async |ros| {
        ros.sleep_s(0.1).await;
        assert_eq!(ros.state(), "disarmed");
        ros.armed().await;
        ros.drive(0.3, 1.0).await;
        let fast = ros.odometry();
        assert!((fast.twist.twist.linear.x - 0.3).abs() < 0.05, "{fast:?}");
        assert!(fast.pose.pose.position.x > 0.15 && fast.pose.covariance[0] > 0.0);
        // The last command is up to 20 ms old and its lease is 200 ms: after another 150 ms it still holds.
        ros.sleep_s(0.15).await;
        assert!((ros.speed_m_s() - 0.3).abs() < 0.05, "{}", ros.speed_m_s());
        // The lease has expired, and stopping from 0.3 m/s takes 0.3 s at 1 m/s² (openscout.toml: 17.9 rad/s²).
        ros.sleep_s(0.5).await;
        assert!(ros.speed_m_s().abs() < 0.01, "{}", ros.speed_m_s());
        assert_eq!(ros.state(), "armed");
    });
}

#[test]
fn a_refused_command_ends_the_one_before_at_once() {
    let stale = Order::Velocity { stamp: Some(Stamp::from_ns(1)), twist: Twist::default() };
    let not_finite = Order::Velocity {
        stamp: Some(Stamp::default()),
        twist: Twist { angular: Vector3 { z: f64::NAN, ..Vector3::default() }, ..Twist::default() },
    };
    let unknown = JointState { name: vec!["elbow".into()], velocity: vec![1.0], ..JointState::default() };
    let joints = Order::Joints { stamp: Some(Stamp::default()), joints: unknown };
    let unreadable = Order::Unreadable { topic: "cmd_vel", why: "too short".into() };
    for (bad, says) in [(stale, "s old"), (not_finite, "angular.z"), (joints, "elbow"), (unreadable, "too short")] {
        beside("sim:openscout", async |ros| {
            ros.armed().await;
            ros.drive(0.3, 1.0).await;
            ros.velocity(0.3);
            ros.send(bad);
            // After a round trip and a sample, but well before the lease of the last command would have expired.
            ros.sleep_s(0.15).await;
            assert!(ros.speed_m_s() < 0.25, "{says}: {}", ros.speed_m_s());
            assert!(ros.of_commands().contains(says), "{says}: {}", ros.of_commands());
            ros.drive(0.3, 0.5).await;
            assert_eq!(ros.of_commands(), "taken", "the next one counts");
        });
    }
}

#[test]
fn nothing_moves_before_it_is_armed() {
    beside("sim:openscout", async |ros| {
        ros.drive(0.3, 1.0).await;
        assert_eq!((ros.state().as_str(), ros.speed_m_s()), ("disarmed", 0.0));
        assert!(ros.of_commands().contains("disarmed: call ~/arm first"), "{}", ros.of_commands());
    });
}

#[test]
fn the_estop_topic_trips_and_its_release_neither_clears_nor_arms() {
    beside("sim:openscout", async |ros| {
        ros.armed().await;
        ros.drive(0.3, 0.5).await;
        ros.send(Order::Estop(true));
        ros.sleep_s(0.2).await;
        assert_eq!(ros.state(), "tripped: host stop");
        for request in [Request::Arm, Request::Clear] {
            let refused = ros.call(request).await;
            assert!(!refused.success && refused.message.contains("e-stop topic"), "{refused:?}");
        }
        ros.send(Order::Estop(false));
        ros.sleep_s(0.5).await;
        assert_eq!(ros.state(), "tripped: host stop");
        assert!(!ros.call(Request::Arm).await.success);
        assert!(ros.call(Request::Clear).await.success);
        // The node learns the state from the next heartbeat.
        ros.sleep_s(0.2).await;
        assert_eq!(ros.state(), "disarmed");
        ros.armed().await;
        assert!(ros.call(Request::Stop).await.success);
        ros.sleep_s(0.2).await;
        assert_eq!(ros.state(), "tripped: host stop");
    });
}

#[test]
fn an_estop_behind_a_call_to_arm_wins() {
    beside("sim:openscout", async |ros| {
        let (answer, _armed) = oneshot::channel();
        ros.send(Order::Call { request: Request::Arm, answer });
        // The arming request is already under way when the e-stop arrives, which cannot recall it.
        ros.send(Order::Estop(true));
        ros.sleep_s(0.3).await;
        assert_ne!(ros.session.board.safety().0, SafetyState::Armed);
    });
}

#[test]
fn joints_and_velocities_take_turns() {
    beside("sim:openscout", async |ros| {
        ros.armed().await;
        ros.drive(0.2, 0.5).await;
        let joints = JointState { name: vec!["dhb0".into()], velocity: vec![3.0], ..JointState::default() };
        for _ in 0..50 {
            ros.send(Order::Joints { stamp: Some(Stamp::default()), joints: joints.clone() });
            ros.sleep_s(0.02).await;
        }
        let wheels = ros.last(|report| match report {
            Report::Joints(joints) => Some(joints.clone()),
            _ => None,
        });
        let wheels = wheels.expect("joints");
        let speed = |name: &str| wheels.velocity[wheels.name.iter().position(|of| of == name).expect(name)];
        assert!(speed("dhb0") > 2.0, "{wheels:?}");
        // The moving robot may turn a braked wheel, but no command drives it.
        assert!(speed("dhb1").abs() < 1.0, "{wheels:?}");
        ros.drive(0.2, 1.0).await;
        assert!((ros.speed_m_s() - 0.2).abs() < 0.05, "{}", ros.speed_m_s());
    });
}

#[test]
fn a_robot_without_wheels_takes_joints_only() {
    beside("sim:osmc-bench", async |ros| {
        ros.armed().await;
        ros.velocity(0.1);
        ros.sleep_s(0.1).await;
        assert!(ros.of_commands().contains("joint_commands"), "{}", ros.of_commands());
        let joints = JointState { name: vec!["osmc0".into()], position: vec![0.5], ..JointState::default() };
        for _ in 0..100 {
            ros.send(Order::Joints { stamp: Some(Stamp::default()), joints: joints.clone() });
            ros.sleep_s(0.02).await;
        }
        let reached = ros.last(|report| match report {
            Report::Joints(joints) => joints.name.iter().position(|of| of == "osmc0").map(|at| joints.position[at]),
            _ => None,
        });
        assert!((reached.expect("a joint") - 0.5).abs() < 0.05, "{reached:?}");
    });
}

#[test]
fn stamps_are_simulated_time() {
    beside("sim:openscout", async |ros| {
        ros.sleep_s(2.0).await;
        let clock = ros.last(|report| match report {
            Report::Clock(clock) => Some(clock.clock),
            _ => None,
        });
        // Connecting takes some simulated time before the script starts.
        assert!((START_S + 2..START_S + 4).contains(&clock.expect("a clock").sec), "{clock:?}");
        let (clock, stamp) = (Stamp::from_time(clock.expect("a clock")), Stamp::from_time(ros.odometry().header.stamp));
        let behind_s = clock.expect("a moment").since_s(stamp.expect("a moment"));
        // The age is at most a telemetry period, the delay of the link, and a tick of the clock.
        assert!((-0.01..0.06).contains(&behind_s), "{behind_s}");
    });
}
