//! Tests of tables and differences of runs, and of logs of earlier versions.
#![allow(clippy::unwrap_used, reason = "test code")]

use std::io::Cursor;

use crate::common::{IMU, OSMC, RANGE, SWITCH, header, run};
use r4_log::{Log, Recorder, compare};
use r4_protocol::{Cause, Causes, Mode, Quality, Request, SafetyState, Sample, Telemetry};

fn table(log: &Log) -> Vec<Vec<String>> {
    let mut csv = Vec::new();
    log.write_csv(&mut csv).unwrap();
    let text = String::from_utf8(csv).unwrap();
    text.lines().map(|line| line.split(',').map(str::to_owned).collect()).collect()
}

#[test]
fn a_table_has_what_was_recorded_and_nothing_else() {
    let log = Log::from_bytes(&run()).unwrap();
    let rows = table(&log);
    let column = |name: &str| rows[0].iter().position(|head| head == name).unwrap_or_else(|| panic!("{name}"));
    let cell = |row: usize, name: &str| rows[row][column(name)].as_str();
    assert_eq!(rows[0][0], "time_s");
    assert_eq!(rows.len(), 24, "a head, twenty frames, a state, two commands");
    assert!(rows.iter().all(|row| row.len() == rows[0].len()));
    assert_eq!(rows[1][0], "0.000001");
    for (name, value) in [
        ("osmc0.setpoint_position_rad", "1.5"),
        ("osmc0.position_counts", "7"),
        ("osmc0.speed_rad_s", "0.25"),
        ("osmc0.settled", "0"),
        ("actuator1.setpoint_speed_m_s", "-0.01"),
        ("actuator1.speed_m_s", "0.25"),
        ("dhb2.duty", "0.033333335"),
        ("supply0.voltage_v", "24.5"),
        ("switch3.on", "1"),
        ("encoder4.illegal", "3"),
        ("range5.distance_m", "0.75"),
        ("range5.quality", "good"),
        ("state", "armed"),
    ] {
        assert_eq!(cell(1, name), value, "{name}");
    }
    // All digits are written: the number read back is identical to the number recorded.
    let position = log.motor(OSMC).unwrap().samples[0].position;
    assert_eq!(cell(1, "osmc0.position_rad").parse::<f64>().unwrap().to_bits(), position.to_bits());
    // State changes and commands have rows without measurements, and a state is only in the row of its change.
    assert_eq!((cell(21, "state"), cell(21, "osmc0.position_rad"), cell(2, "state")), ("disarmed", "", ""));
    assert_eq!((cell(22, "osmc0.command_position_rad"), cell(22, "osmc0.duty")), ("1.5", ""));
    assert!(!rows[0].iter().any(|head| head == "dhb2.position_rad"), "nothing measures it");
}

#[test]
fn two_things_of_one_moment_get_two_rows() {
    let mut recorder = Recorder::new(Cursor::new(Vec::new()), &header()).unwrap();
    for request in [Request::Arm, Request::Stop] {
        recorder.request(1_000, Some(5), &request).unwrap();
    }
    let log = Log::from_bytes(recorder.finish().unwrap().get_ref()).unwrap();
    assert_eq!(table(&log), [["time_s", "request"], ["0.001000", "arm"], ["0.001000", "stop"]]);
}

/// Builds a run with a switch and a range reading every 10 ms from `start_us` on. Ticks in `without` are lost.
fn readings(start_us: u64, without: std::ops::Range<u64>, value: impl Fn(f64) -> f32) -> Log {
    let mut recorder = Recorder::new(Cursor::new(Vec::new()), &header()).unwrap();
    for tick in (0..100).filter(|tick| !without.contains(tick)) {
        let device_us = start_us + tick * 10_000;
        let value = value(device_us as f64 * 1e-6);
        let quality = r4_protocol::Quality::Good;
        let samples = [
            Sample::Scalar { channel: SWITCH, value: f32::from(value > 0.5) },
            Sample::Reading { channel: RANGE, value, age_ms: 3, quality },
        ];
        let samples = samples.into_iter().collect();
        recorder.telemetry(&Telemetry { device_us, state: SafetyState::Armed, causes: Causes::NONE, samples }).unwrap();
    }
    Log::from_bytes(recorder.finish().unwrap().get_ref()).unwrap()
}

#[test]
fn differences_are_seen_from_both_sides() {
    let ramp = |time_s: f64| time_s as f32;
    let of = |a: &Log, b: &Log, shift_s, name: &str| {
        compare(a, b, shift_s).into_iter().find(|difference| difference.name == name).unwrap()
    };
    let (a, distance) = (readings(0, 0..0, ramp), "range5.distance_m");
    assert!(compare(&a, &a, 0.0).iter().all(|difference| difference.is_identical() && difference.compared > 0));

    // A straight line sampled at other times is the same line; a step is at most a sample away.
    let between = readings(4_000, 0..0, ramp);
    let difference = of(&a, &between, 0.0, distance);
    assert!(difference.max.unwrap() < 1e-6 && difference.compared == 198, "{difference:?}");
    assert_eq!(difference.one_sided, [1, 1], "the first of one and the last of the other");
    assert_eq!(of(&a, &between, 0.0, "switch3.on").max, Some(0.0));
    // The same samples on another clock, which the shift cancels.
    assert!(of(&a, &readings(5_000_000, 0..0, |time_s| ramp(time_s - 5.0)), -5.0, distance).max.unwrap() < 1e-6);

    let half = readings(0, 0..0, |time_s| if time_s < 0.5 { 0.25 } else { 0.0 });
    let off = of(&readings(0, 0..0, |_| 0.0), &half, 0.0, distance);
    assert_eq!((off.max, off.unequal, off.one_sided), (Some(0.25), 100, [0, 0]));
    assert!((off.rms.unwrap() - 0.25 / 2_f64.sqrt()).abs() < 1e-9, "{off:?}");

    // Values are not interpolated over a gap.
    let gap = of(&a, &readings(0, 20..40, ramp), 0.0, distance);
    assert_eq!((gap.samples, gap.one_sided, gap.compared), ([100, 80], [20, 0], 160));
    let swapped = of(&readings(0, 20..40, ramp), &a, 0.0, distance);
    assert_eq!((swapped.one_sided, swapped.max), ([0, 20], Some(0.0)));
    let never = of(&a, &Log::from_bytes(&run()).unwrap(), 0.0, "osmc0.duty");
    assert_eq!((never.samples, never.one_sided, never.max), ([0, 20], [0, 20], None));
}

#[test]
fn words_are_the_same_or_not() {
    let (a, b) = (readings(0, 0..0, |_| 1.0), Log::from_bytes(&run()).unwrap());
    let differences = compare(&a, &b, 0.0);
    let states = differences.iter().find(|difference| difference.name == "state").unwrap();
    assert_eq!((states.max, states.unequal > 0), (None, true), "{states:?}");
}

#[test]
fn what_was_subscribed_and_never_came_is_missing() {
    let mut recorder = Recorder::new(Cursor::new(Vec::new()), &header()).unwrap();
    recorder.request(0, Some(0), &Request::Subscribe { channel: SWITCH, period_ms: 10 }).unwrap();
    recorder.request(0, Some(1), &Request::Subscribe { channel: RANGE, period_ms: 10 }).unwrap();
    recorder.request(0, Some(2), &Request::Subscribe { channel: IMU, period_ms: 10 }).unwrap();
    for tick in (1..=100).filter(|tick| *tick != 7 && !(50..60).contains(tick)) {
        let values = [0.5; 6];
        let inertial = Sample::Sensor { channel: IMU, values, age_ms: 0, quality: Quality::Good };
        let samples = [Sample::Scalar { channel: SWITCH, value: 0.0 }, inertial].into_iter().collect();
        let (state, causes) = (SafetyState::Armed, Causes::NONE);
        recorder.telemetry(&Telemetry { device_us: tick * 10_000 + tick % 3 * 1_000, state, causes, samples }).unwrap();
    }
    recorder.request(1_005_000, Some(3), &Request::Bye).unwrap();
    let log = Log::from_bytes(recorder.finish().unwrap().get_ref()).unwrap();
    let coverage = log.coverage();
    let of = |channel| coverage.iter().find(|coverage| coverage.channel == channel).unwrap();
    for channel in [SWITCH, IMU] {
        assert_eq!((of(channel).samples, of(channel).missing), (89, Some(11)), "{channel}");
    }
    assert_eq!((of(RANGE).samples, of(RANGE).missing, of(RANGE).longest_gap_s), (0, Some(99), None));
    let gap_s = of(SWITCH).longest_gap_s.unwrap();
    assert!((gap_s - 0.11).abs() < 0.003, "{gap_s}");
    let without = Log::from_bytes(&run()).unwrap().coverage();
    assert!(without.iter().all(|coverage| coverage.missing.is_none()), "this log does not say what was asked for");
}

/// `tests/data/protocol-3.mcap` was recorded by a program of protocol 3: the first set point of `r4 demo` on a bench
/// whose limit of the following error is so narrow that it trips.
#[test]
fn a_log_of_protocol_3_is_read() {
    let log = Log::read(concat!(env!("CARGO_MANIFEST_DIR"), "/../../tests/data/protocol-3.mcap")).unwrap();
    assert_eq!(log.warnings, []);
    assert_eq!((log.header.protocol_version, log.header.seed), (3, None));
    assert_eq!((log.header.robot.as_str(), log.header.channels.len()), ("osmc-bench", 7));
    assert_eq!(log.commands.len(), 1);
    assert_eq!((log.commands[0].channel, log.commands[0].setpoint.mode), (OSMC, Mode::Position));
    assert_eq!((log.requests.len(), log.requests[0].sent_us), (1, None));
    let states: Vec<_> = log.states.iter().map(|change| change.state).collect();
    assert_eq!(states, [SafetyState::Armed, SafetyState::Tripped]);
    assert!(log.states[1].causes.contains(Cause::Stalled), "{}", log.states[1].causes);
    assert!(log.motor(OSMC).unwrap().samples.len() > 50);
    assert!(log.signals().iter().any(|signal| signal.name == "supply1.voltage_v"));
}
