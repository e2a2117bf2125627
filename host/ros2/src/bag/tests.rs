//! Comparison of bags with the bytes of an independent implementation, and with the messages of the node itself.

use std::{cell::RefCell, collections::BTreeMap, pin::pin};

use futures::{
    channel::{mpsc::unbounded, oneshot},
    future::{Either, select},
};
use r4_rig::{Error, Rig, Target, recording};

use super::*;
use crate::{
    Door, Order, Request, RosClock,
    message::{
        BatteryState, DiagnosticArray, DiagnosticStatus, Header, Imu, JointState, KeyValue, Odometry, Pose,
        PoseWithCovariance, Quaternion, Range, TFMessage, Text, Time, Transform, TransformStamped, Twist,
        TwistWithCovariance, Vector3,
    },
};

/// Messages encoded by `rosbags`; the file says how it was made.
const FIXTURES: &str = include_str!("../../tests/data/cdr.txt");

/// Expected bytes and definition of a type.
#[derive(Default)]
struct Fixture {
    cdr: Vec<u8>,
    definition: String,
}

fn fixtures() -> BTreeMap<String, Fixture> {
    let mut fixtures: BTreeMap<String, Fixture> = BTreeMap::new();
    let mut kind = String::new();
    for line in FIXTURES.lines() {
        let (key, value) = line.split_once(' ').expect("a key and a value");
        match key {
            "type" => kind = value.replace("/msg/", "/"),
            "cdr" => {
                let byte = |at| u8::from_str_radix(&value[at..at + 2], 16).expect("a byte");
                fixtures.entry(kind.clone()).or_default().cdr = (0..value.len()).step_by(2).map(byte).collect();
            }
            "|" => fixtures.entry(kind.clone()).or_default().definition += &format!("{value}\n"),
            _ => {}
        }
    }
    fixtures
}

fn header(frame: &str) -> Header {
    Header::new(Time { sec: 1_700_000_000, nanosec: 123_456_789 }, frame)
}

fn vector(x: f64, y: f64, z: f64) -> Vector3 {
    Vector3 { x, y, z }
}

/// Returns the messages of `make_cdr.py`.
fn messages() -> Vec<Report> {
    let turned = Quaternion { x: 0.0, y: 0.0, z: 0.6, w: 0.8 };
    let pose = Pose { position: vector(1.5, -2.25, 0.0), orientation: turned };
    let twist = Twist { linear: vector(0.3, 0.0, 0.0), angular: vector(0.0, 0.0, -0.7) };
    let counting = |first: f64| std::array::from_fn(|at| first + at as f64);
    let channel = |name: &str| name.parse().expect("a channel");
    let mut orientation_covariance = [0.0; 9];
    orientation_covariance[0] = -1.0;
    let status = |level, message: &str, keys| DiagnosticStatus {
        level,
        name: "openscout: supervisor".into(),
        message: message.into(),
        hardware_id: "sim:openscout".into(),
        values: vec![KeyValue { key: "state".into(), value: "armed".into() }; keys],
    };
    let transform = TransformStamped {
        header: header("odom"),
        child_frame_id: "base_link".into(),
        transform: Transform { translation: vector(1.5, -2.25, 0.0), rotation: turned },
    };
    vec![
        Report::Joints(JointState {
            header: header(""),
            name: vec!["dhb0".into(), "encoder10".into()],
            position: vec![0.5, -1.0],
            velocity: vec![3.25, f64::NAN],
            effort: Vec::new(),
        }),
        Report::Imu(
            channel("imu0"),
            Imu {
                header: header("imu0"),
                orientation_covariance,
                angular_velocity: vector(0.01, -0.02, 0.03),
                linear_acceleration: vector(0.1, 0.2, 9.81),
                ..Imu::default()
            },
        ),
        Report::Range(
            channel("range0"),
            Range {
                header: header("range0"),
                radiation_type: Range::ULTRASOUND,
                field_of_view: 0.524,
                min_range: 0.02,
                max_range: 4.0,
                range: f32::INFINITY,
                variance: 0.0,
            },
        ),
        Report::Battery(
            channel("supply0"),
            BatteryState {
                header: header("supply0"),
                voltage: 12.25,
                location: "supply0".into(),
                ..BatteryState::default()
            },
        ),
        Report::Odometry(Odometry {
            header: header("odom"),
            child_frame_id: "base_link".into(),
            pose: PoseWithCovariance { pose, covariance: counting(0.0) },
            twist: TwistWithCovariance { twist, covariance: counting(100.0) },
        }),
        Report::Transform(TFMessage { transforms: vec![transform] }),
        Report::State(Text { data: "tripped: link lost".into() }),
        Report::Diagnostics(DiagnosticArray {
            header: header(""),
            status: vec![status(0, "armed", 1), status(2, "", 2)],
        }),
    ]
}

#[test]
fn messages_are_the_bytes_that_rosbags_makes() {
    let fixtures = fixtures();
    let messages = messages();
    assert_eq!(messages.len(), fixtures.len());
    for message in messages {
        let Topic { kind, .. } = message.topic().expect("a topic");
        let made = to_cdr(&message).expect("CDR");
        assert_eq!(made, fixtures[kind].cdr, "{kind}");
    }
}

#[test]
fn definitions_are_those_of_ros_with_all_that_is_inside_them() {
    for (kind, fixture) in fixtures() {
        assert_eq!(definition(&kind).expect("it is listed"), fixture.definition, "{kind}");
    }
    assert_eq!(definition("sensor_msgs/LaserScan"), None);
}

/// Drives a simulated robot through a node for `seconds`, and returns the node's messages and the log of the same session.
fn driven(board: &str, seconds: f64) -> (Vec<Report>, Log) {
    let target: Target = board.parse().expect("a board");
    let rig = Rig::new(target.clone());
    let reports = RefCell::new(Vec::new());
    let tap = |output| recording::tap(&target, 1, "test".into(), "test".into(), output);
    let recorded = rig.recorded(tap, async |session| {
        let (orders, queue) = unbounded();
        let door =
            Door { clock: RosClock::Simulated { start: Stamp::default() }, has_transform: true, is_managed: false };
        let serve = door.serve(session, queue, |report| {
            reports.borrow_mut().push(report);
            true
        });
        let script = async {
            let (answer, armed) = oneshot::channel();
            orders.unbounded_send(Order::Call { request: Request::Arm, answer }).expect("it is served");
            assert!(armed.await.expect("an answer").success);
            for _ in 0..(seconds / 0.02) as u32 {
                let twist = Twist { linear: vector(0.3, 0.0, 0.0), angular: vector(0.0, 0.0, 0.5) };
                orders.unbounded_send(Order::Velocity { stamp: Some(Stamp::default()), twist }).expect("it is served");
                session.board.sleep_s(0.02).await;
            }
        };
        match select(pin!(serve), pin!(script)).await {
            Either::Left((ended, _)) => panic!("the node ended: {ended:?}"),
            Either::Right(((), _)) => Ok::<_, Error>(()),
        }
    });
    recorded.result.expect("a session");
    (reports.into_inner(), Log::from_bytes(&recorded.log).expect("a log"))
}

fn drive_of(log: &Log) -> Option<GroundDrive> {
    GroundDrive::of_board(&log.header.board.parse().expect("a board"), &log.header.robot)
}

/// Removes the stamp: the node's stamps come from its estimate of the board's clock, those of a bag from the board's clock itself.
fn without_stamp(mut report: Report) -> Report {
    let header = match &mut report {
        Report::Odometry(message) => &mut message.header,
        Report::Transform(message) => &mut message.transforms[0].header,
        Report::Joints(message) => &mut message.header,
        Report::Imu(_, message) => &mut message.header,
        Report::Range(_, message) => &mut message.header,
        Report::Battery(_, message) => &mut message.header,
        other => panic!("{other:?} is not of a frame"),
    };
    header.stamp = Time::default();
    report
}

/// Returns the messages of telemetry frames by topic, as bytes, in which NaN equals NaN.
fn of_frames(reports: impl IntoIterator<Item = Report>) -> BTreeMap<String, Vec<Vec<u8>>> {
    let mut topics: BTreeMap<String, Vec<Vec<u8>>> = BTreeMap::new();
    for report in reports {
        if matches!(
            report,
            Report::State(_) | Report::Diagnostics(_) | Report::Clock(_) | Report::Commanded(_) | Report::Deactivated
        ) {
            continue;
        }
        let topic = report.topic().expect("a topic").name.into_owned();
        topics.entry(topic).or_default().push(to_cdr(&without_stamp(report)).expect("CDR"));
    }
    topics
}

#[test]
fn a_bag_has_what_the_node_published() {
    let (published, log) = driven("sim:openscout", 3.0);
    let mut exported = Vec::new();
    source::reports(&log, drive_of(&log).as_ref(), |_, report| exported.push(report));
    let (published, exported) = (of_frames(published), of_frames(exported));
    assert!(published.len() >= 6, "{:?}", published.keys());
    assert_eq!(published.keys().collect::<Vec<_>>(), exported.keys().collect::<Vec<_>>());
    for (topic, published) in &published {
        let exported = &exported[topic];
        // The log also has the session's last frames, which arrive after the node has ended.
        assert!(published.len() >= 10 && exported.len() - published.len() < 10, "{topic}: {}", published.len());
        assert_eq!(published[..], exported[..published.len()], "{topic}");
    }
}

#[test]
fn times_are_those_of_the_recording_and_rise() {
    let (_, mut log) = driven("sim:openscout", 1.0);
    let times = |log: &Log| {
        let mut times = Vec::new();
        source::reports(log, None, |stamp, _| times.push(stamp.as_ns()));
        times
    };
    let recorded = log.header.recorded.clone().expect("a date");
    let first_ns = |log: &Log| (log.time_span_s().expect("samples").0 * 1e6).round() as i64 * 1000;
    let of_virtual = times(&log);
    assert!(of_virtual.is_sorted());
    assert_eq!(of_virtual[0], recorded.unix_ns as i64 + first_ns(&log));
    // A board in real time has a log with wall-clock times.
    log.header.recorded = Some(r4_log::Recorded { clock_offset_ns: Some(1_700_000_000_000_000_000), ..recorded });
    assert_eq!(times(&log)[0], 1_700_000_000_000_000_000 + first_ns(&log));
    log.header.recorded = None;
    assert_eq!(times(&log)[0], first_ns(&log));
}

#[test]
fn a_bag_is_a_folder_that_is_made() {
    let (_, log) = driven("sim:openscout", 1.0);
    let folder = tempfile::tempdir().expect("a folder");
    let place = folder.path().join("run");
    let bag = write_bag(&log, drive_of(&log).as_ref(), &place).expect("a bag");
    let bytes = fs::read(place.join("run_0.mcap")).expect("a file");
    let summary = mcap::Summary::read(&bytes).expect("an MCAP file").expect("a summary");
    let statistics = summary.stats.expect("statistics");
    let mut counts: BTreeMap<String, u64> = BTreeMap::new();
    for (id, channel) in &summary.channels {
        let schema = channel.schema.as_ref().expect("a schema");
        assert_eq!((schema.encoding.as_str(), channel.message_encoding.as_str()), ("ros2msg", "cdr"));
        assert!(channel.metadata["offered_qos_profiles"].starts_with("- history: keep_last\n"));
        counts.insert(channel.topic.clone(), statistics.channel_message_counts[id]);
    }
    let told: BTreeMap<_, _> = bag.topics.iter().map(|topic| (topic.name.clone(), topic.messages)).collect();
    assert_eq!(told, counts);
    assert!(
        ["/odom", "/tf", "/joint_states", "/imu/data", "/r4/state"].iter().all(|topic| counts.contains_key(*topic))
    );
    let metadata = fs::read_to_string(place.join("metadata.yaml")).expect("metadata");
    assert!(
        metadata.contains("    - \"run_0.mcap\"\n") && metadata.contains("    robot: \"openscout\"\n"),
        "{metadata}"
    );

    let again = write_bag(&log, None, &place).expect_err("it is there");
    assert!(matches!(again, BagError::Exists { .. }), "{again}");
    let nowhere = write_bag(&log, None, &folder.path().join("a/b")).expect_err("no such folder");
    assert!(matches!(nowhere, BagError::Io { .. }), "{nowhere}");
    let empty = Log { states: Vec::new(), motors: Vec::new(), ..log };
    let empty = Log { encoders: Vec::new(), readings: Vec::new(), sensors: Vec::new(), scalars: Vec::new(), ..empty };
    let empty = write_bag(&empty, None, &folder.path().join("empty")).expect_err("nothing in it");
    assert!(matches!(empty, BagError::Empty), "{empty}");
}
