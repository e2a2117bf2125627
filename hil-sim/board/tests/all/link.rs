//! Raw bytes on the board's link: any data is survived, counted or refused, and moves nothing; the next good frame is
//! accepted.

use crate::harness::{
    Device, LINEAR, MS, ROTARY, RawHost, SUPPLY_24, bench, frame, osmc_bench, power_up, raw_bench, raw_bench_of,
};
use proptest::prelude::*;
use r4_boards::Robot;
use r4_protocol::{
    Cause, Causes, ChannelId, ChannelInfo, ChannelKind, Cycle, CycleChannel, CycleMotor, CycleOutcome, CycleState,
    Mode, ModeInfo, PathPoint, Range, Refusal, Reply, Request, SCHEMA_HASH, SafetyState, Sample, Setpoint, Telemetry,
    ToDevice, ToHost, VERSION, config::PidGains, cycle::NOTHING, frame::MAX_FRAME,
};
use r4_sim::{Simulation, uart::LineNoise};

const NO_MOTOR: ChannelId = ChannelId::new(ChannelKind::Osmc, 3);
const GAINS: PidGains = PidGains { kp: 1.0, ki: 0.0, kd: 0.0 };

/// A command with the present time: the board's clock is the simulation's.
fn set(device: &Device, channel: ChannelId, mode: Mode, value: f32) -> Request {
    set_at(device.clock.now_ns() / 1000, channel, mode, value)
}

fn set_at(sent_us: u64, channel: ChannelId, mode: Mode, value: f32) -> Request {
    Request::Set { channel, setpoint: Setpoint { mode, value }, sent_us, ttl_ms: 50 }
}

fn nothing_moved(device: &Device) {
    for (channel, start) in [(ROTARY, 0.0), (LINEAR, osmc_bench().simulation.motors[1].start)] {
        let position = device.board.world().position(channel).expect("the bench has the channel");
        assert!(position == start && device.duty(channel) == 0.0, "{channel} at {position}");
    }
}

/// One bit error in 5000 bits: of 400 requests of about ten bytes about one in fifty is lost. None is misunderstood,
/// and when the line is quiet again everything is as before.
#[test]
fn a_noisy_line_loses_frames_and_says_so() {
    raw_bench(&osmc_bench(), async |host, device| {
        host.hello().await;
        let before = host.stats().await.bad_frames;
        device.board.disturb_link(Some(LineNoise::new(2e-4, 0.0, 1)), None);
        let mut answers = 0;
        for seq in 1000..1400_u16 {
            // a delimiter of its own: noise in the preceding one costs one frame, not two
            host.send_bytes(&[0]).await;
            host.send(&ToDevice::Request { seq, request: Request::Stats }).await;
            let heard = host.listen(2).await;
            answers += heard.iter().filter(|message| matches!(message, ToHost::Response { result: Ok(_), .. })).count();
        }
        device.board.disturb_link(None, None);
        let lost = host.stats().await.bad_frames - before;
        assert!((1..40).contains(&lost), "{lost} frames lost");
        assert_eq!(answers + lost as usize, 400, "each frame is taken or counted");
        nothing_moved(device);
    });
}

/// The board sends not even a delimiter: on a CAN bus others would receive it, and alone on one a controller would
/// repeat it indefinitely.
#[test]
fn a_board_says_nothing_until_it_is_spoken_to() {
    raw_bench(&osmc_bench(), async |host, _| {
        assert_eq!(host.bytes(500).await, 0);
        host.send_bytes(b"\x05noise\0").await;
        host.send(&ToDevice::Heartbeat { session: 1, host_us: 0 }).await;
        assert_eq!(host.bytes(500).await, 0, "neither is answered");
        assert_eq!(host.ask(Request::Stats).await, Err(Refusal::NoSession));
        assert_eq!(host.bytes(500).await, 0);
    });
}

#[test]
fn before_a_hello_everything_but_stopping_is_refused() {
    raw_bench(&osmc_bench(), async |host, device| {
        let requests = [
            Request::Describe { index: 0 },
            Request::Arm,
            Request::Disarm,
            Request::Clear,
            set(device, ROTARY, Mode::Duty, 0.8),
            Request::Subscribe { channel: ROTARY, period_ms: 1 },
            Request::SetGains { channel: ROTARY, mode: Mode::Position, gains: GAINS },
            Request::Stats,
        ];
        for request in requests {
            assert_eq!(host.ask(request.clone()).await, Err(Refusal::NoSession), "{request:?}");
        }
        host.send(&ToDevice::Heartbeat { session: 1, host_us: 0 }).await;
        assert_eq!(host.listen(20).await, [], "a heartbeat without a session is not answered");
        assert_eq!(host.ask(Request::Bye).await, Ok(Reply::Done));
        assert_eq!(host.hello().await.state, SafetyState::Disarmed);
        assert_eq!(host.ask(Request::Bye).await, Ok(Reply::Done));
        assert_eq!(host.ask(Request::Stop).await, Ok(Reply::Done), "anyone may stop the board");
        let info = host.hello().await;
        assert_eq!((info.state, info.causes), (SafetyState::Tripped, Causes::only(Cause::HostStop)));
        nothing_moved(device);
    });
}

#[test]
fn another_version_or_schema_gets_no_session() {
    raw_bench(&osmc_bench(), async |host, _| {
        for (version, schema) in [(VERSION + 1, SCHEMA_HASH), (VERSION, SCHEMA_HASH ^ 1), (0, 0)] {
            let refused = host.ask(Request::Hello { version, schema }).await;
            assert_eq!(refused, Err(Refusal::ProtocolMismatch { version: VERSION, schema: SCHEMA_HASH }));
            assert_eq!(host.ask(Request::Arm).await, Err(Refusal::NoSession));
        }
        // a refused hello does not end the existing session
        host.hello().await;
        host.ask(Request::Hello { version: VERSION + 1, schema: SCHEMA_HASH }).await.unwrap_err();
        host.stats().await;
    });
}

#[test]
fn a_simulated_board_has_no_log_and_says_so() {
    raw_bench(&osmc_bench(), async |host, _| {
        assert_eq!(host.ask(Request::Log { on: true }).await, Err(Refusal::NoSession));
        host.hello().await;
        for on in [true, false] {
            assert_eq!(host.ask(Request::Log { on }).await, Err(Refusal::NoLog));
        }
        assert!(host.listen(50).await.iter().all(|message| !matches!(message, ToHost::Log(_))));
    });
}

/// A frame with one of its bytes changed, without creating a delimiter inside.
fn changed(mut bytes: Vec<u8>, place: usize) -> Vec<u8> {
    bytes[place] = if bytes[place] == 0xFF { 1 } else { bytes[place] + 1 };
    bytes
}

#[test]
fn damaged_frames_are_counted_and_the_next_good_one_is_taken() {
    raw_bench(&osmc_bench(), async |host, device| {
        host.hello().await;
        let arm = frame(&ToDevice::Request { seq: 999, request: Request::Arm });
        let repeated = [&arm[..3], &arm[2..]].concat();
        let swapped = [&arm[..1], &[arm[2], arm[1]], &arm[3..]].concat();
        let cases: [(&str, Vec<u8>, u32); 12] = [
            ("only delimiters", vec![0; 50], 0),
            ("garbage", b"\x01\x02 no frame at all \xFF\xFE\0".to_vec(), 1),
            ("one byte", vec![7, 0], 1),
            ("a CRC without a message", vec![3, 0xFF, 0xFF, 0], 1),
            ("a frame cut short", [&arm[..arm.len() - 3], &[0]].concat(), 1),
            ("a frame without its beginning", arm[2..].to_vec(), 1),
            ("a changed byte of the message", changed(arm.clone(), 2), 1),
            ("a changed byte of the CRC", changed(arm.clone(), arm.len() - 2), 1),
            ("a repeated byte", repeated, 1),
            ("bytes in the wrong order", swapped, 1),
            ("a frame longer than any", [vec![1; MAX_FRAME + 1], vec![0]].concat(), 1),
            ("a frame far longer than any", [vec![0xAA; 5000], vec![0]].concat(), 1),
        ];
        for (what, bytes, bad) in cases {
            let before = host.stats().await;
            host.send_bytes(&bytes).await;
            let after = host.stats().await;
            assert_eq!(after.bad_frames - before.bad_frames, bad, "{what}");
            // the frame of the request itself
            assert_eq!(after.frames - before.frames, 1, "{what}");
            host.listen(10).await;
        }
        assert_eq!(host.hello().await.state, SafetyState::Disarmed);
        nothing_moved(device);
    });
}

/// A frame without its delimiter is lost together with the next one; the one after is accepted.
#[test]
fn a_lost_delimiter_costs_one_more_frame() {
    raw_bench(&osmc_bench(), async |host, _| {
        host.hello().await;
        let stats = |seq| frame(&ToDevice::Request { seq, request: Request::Stats });
        let first = stats(1);
        host.send_bytes(&[&first[..first.len() - 1], &stats(2), &stats(3)].concat()).await;
        let heard = host.listen(20).await;
        assert!(matches!(heard[..], [ToHost::Response { seq: 3, result: Ok(Reply::Stats(_)) }]), "{heard:?}");
    });
}

/// Range of a motor of the bench in a mode.
fn range_of(motor: usize, mode: Mode) -> Range {
    let motor = osmc_bench().config.motors[motor];
    let control = motor.control.expect("a measured motor");
    match mode {
        Mode::Position => control.position,
        Mode::Speed => Range::symmetric(control.speed_max),
        Mode::Duty => Range::symmetric(motor.duty_max),
        other => unreachable!("no motor has the mode {other}"),
    }
}

#[test]
fn commands_a_channel_cannot_take_are_refused_by_their_reason() {
    raw_bench(&osmc_bench(), async |host, device| {
        host.hello().await;
        host.ask(Request::Arm).await.unwrap();
        for (index, channel) in [(0, ROTARY), (1, LINEAR)] {
            for mode in [Mode::Position, Mode::Speed, Mode::Duty] {
                let range = range_of(index, mode);
                for asked in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
                    let refused = host.ask(set(device, channel, mode, asked)).await;
                    assert_eq!(refused, Err(Refusal::NotFinite { channel }), "{mode} {asked}");
                }
                for asked in [range.max * 1.001, range.min - 0.001, f32::MAX, f32::MIN] {
                    let refused = host.ask(set(device, channel, mode, asked)).await;
                    assert_eq!(refused, Err(Refusal::OutOfRange { channel, asked, range }), "{mode}");
                }
            }
        }
        // 51 ms old with 50 ms to live; a board younger than that would get a time before its start
        host.listen(100).await;
        let late = set_at(device.clock.now_ns() / 1000 - 51_000, ROTARY, Mode::Duty, 0.8);
        let bad_gains = PidGains { kp: f32::NAN, ..GAINS };
        let cases = [
            (late, Refusal::Expired { age_ms: 51, ttl_ms: 50 }),
            (set(device, NO_MOTOR, Mode::Duty, 0.8), Refusal::UnknownChannel { channel: NO_MOTOR }),
            (set(device, SUPPLY_24, Mode::Duty, 0.8), Refusal::WrongMode { channel: SUPPLY_24, mode: Mode::Duty }),
            (set(device, SUPPLY_24, Mode::Speed, 0.8), Refusal::WrongMode { channel: SUPPLY_24, mode: Mode::Speed }),
            (Request::Describe { index: 7 }, Refusal::NoSuchIndex { index: 7 }),
            (Request::Describe { index: 255 }, Refusal::NoSuchIndex { index: 255 }),
            (Request::Subscribe { channel: NO_MOTOR, period_ms: 1 }, Refusal::UnknownChannel { channel: NO_MOTOR }),
            (
                Request::SetGains { channel: ROTARY, mode: Mode::Duty, gains: GAINS },
                Refusal::WrongMode { channel: ROTARY, mode: Mode::Duty },
            ),
            (
                Request::SetGains { channel: ROTARY, mode: Mode::Speed, gains: bad_gains },
                Refusal::BadGains { channel: ROTARY },
            ),
        ];
        let before = host.stats().await.refused;
        for (place, (request, refusal)) in (1..).zip(cases) {
            assert_eq!(host.ask(request.clone()).await, Err(refusal), "{request:?}");
            assert_eq!(host.stats().await.refused - before, place);
        }
        nothing_moved(device);
        // not because nothing could move: the same request with valid numbers does
        host.ask(set(device, ROTARY, Mode::Duty, 0.8)).await.unwrap();
        host.listen(20).await;
        assert!(device.duty(ROTARY) > 0.0);
    });
}

/// Reasons for the refusal of a set point that is newer than the one in force.
#[derive(Clone, Copy, Debug)]
enum Refused {
    NotFinite,
    AboveRange,
    BelowRange,
    WrongMode,
    Expired,
    Ahead,
}

impl Refused {
    const ALL: [Self; 6] =
        [Self::NotFinite, Self::AboveRange, Self::BelowRange, Self::WrongMode, Self::Expired, Self::Ahead];

    /// A set point for a channel that is refused for this reason at `now_us`.
    fn request(self, info: &ChannelInfo, mode: &ModeInfo, now_us: u64) -> Request {
        let Range { min, max } = mode.range;
        let other = [Mode::Voltage, Mode::Switch].into_iter().find(|other| info.mode(*other).is_none());
        let (mode, value, sent_us) = match self {
            Self::NotFinite => (mode.mode, f32::NAN, now_us),
            Self::AboveRange => (mode.mode, max + 1.0, now_us),
            Self::BelowRange => (mode.mode, min - 1.0, now_us),
            Self::WrongMode => (other.expect("no channel has both"), max, now_us),
            Self::Expired => (mode.mode, max, now_us - 51_000),
            Self::Ahead => (mode.mode, max, now_us + 60_000),
        };
        set_at(sent_us, info.id, mode, value)
    }
}

/// Newest sample of a channel.
async fn sample_of(host: &mut RawHost, channel: ChannelId) -> Sample {
    host.ask(Request::Subscribe { channel, period_ms: 1 }).await.expect("a channel");
    let heard = host.listen(3).await;
    host.ask(Request::Subscribe { channel, period_ms: 0 }).await.expect("a channel");
    host.listen(1).await;
    let samples = heard.into_iter().rev().filter_map(|message| match message {
        ToHost::Telemetry(Telemetry { samples, .. }) => samples.first().copied(),
        _ => None,
    });
    samples.into_iter().next().expect("a sample each millisecond")
}

/// Keeps the session alive for `ms`.
async fn wait(host: &mut RawHost, session: u16, ms: u64) {
    for part in 0..ms.div_ceil(50) {
        host.send(&ToDevice::Heartbeat { session, host_us: 0 }).await;
        host.listen((ms - 50 * part).min(50)).await;
    }
}

/// Disarms and arms, sets `setpoint` for a channel, and runs `then` once it is followed; returns true if it is followed
/// 100 ms later. A channel that stops does so within that time: the end of a ramp to rest counts from its last 0.06 s.
async fn is_followed_after(
    host: &mut RawHost,
    device: &Device,
    info: &ChannelInfo,
    setpoint: Setpoint,
    then: impl AsyncFnOnce(&mut RawHost, u64),
) -> bool {
    let session = host.hello().await.session;
    host.ask(Request::Clear).await.expect("accepted");
    host.ask(Request::Arm).await.expect("accepted");
    let sent_us = now_us(device);
    host.ask(set_at(sent_us, info.id, setpoint.mode, setpoint.value)).await.expect("accepted");
    // the motors' supply comes 50 ms after arming
    wait(host, session, 110).await;
    then(host, sent_us).await;
    host.listen(5).await;
    let first = sample_of(host, info.id).await;
    wait(host, session, 100).await;
    let last = sample_of(host, info.id).await;
    assert_eq!(host.hello().await.causes, Causes::NONE, "{setpoint:?} of {}", info.id);
    match (first, last) {
        (Sample::Motor { .. }, Sample::Motor { setpoint: last, .. }) if last == setpoint => true,
        (Sample::Motor { .. }, Sample::Motor { setpoint: last, .. }) => {
            assert_eq!(last.value, 0.0, "{}: {last:?}", info.id);
            assert!(last.mode == if setpoint.mode == Mode::Duty { Mode::Duty } else { Mode::Speed }, "{last:?}");
            false
        }
        (Sample::Scalar { value: first, .. }, Sample::Scalar { value: last, .. }) => match info.id.kind {
            ChannelKind::Bldc if last == 0.0 => false,
            ChannelKind::Bldc => {
                assert!(last > first, "{first} then {last}");
                true
            }
            ChannelKind::Dac if last == setpoint.value => true,
            ChannelKind::Dac => {
                assert_eq!(last, 0.0, "its safe voltage");
                false
            }
            _ => last == setpoint.value,
        },
        other => panic!("{other:?}"),
    }
}

/// For every kind of output and mode, and any reason: a refused set point ends the older one, unless it is older itself
/// or a repetition.
#[test]
fn a_refused_set_point_never_leaves_the_older_one_in_force() {
    raw_bench(&r4_boards::load("every-interface").expect("built in"), async |host, device| {
        // it answers when all its range sensors have a reading
        host.listen(1000).await;
        let count = host.hello().await.channels;
        let mut outputs: Vec<ChannelInfo> = Vec::new();
        for index in 0..count {
            let Ok(Reply::Channel(info)) = host.ask(Request::Describe { index }).await else { panic!("described") };
            // one of each kind: all are built alike, except servos, which arrive before anything could be refused
            let stays = info.modes.is_empty() || info.id.kind == ChannelKind::Servo;
            if !stays && outputs.iter().all(|known| known.id.kind != info.id.kind) {
                outputs.push(info);
            }
        }
        let kinds: Vec<_> = outputs.iter().map(|info| info.id.kind).collect();
        for kind in [ChannelKind::Osmc, ChannelKind::Dhb, ChannelKind::Bldc, ChannelKind::Stepper] {
            assert!(kinds.contains(&kind), "{kinds:?}");
        }
        assert!(kinds.contains(&ChannelKind::Relay) && kinds.contains(&ChannelKind::Dac), "{kinds:?}");
        let mut cases = 0;
        for info in &outputs {
            // a point of a path is of the past when it is being followed
            for mode in info.modes.iter().filter(|mode| !matches!(mode.mode, Mode::Brake | Mode::Follow)) {
                let value = match mode.mode {
                    Mode::Switch => 1.0,
                    // slow, so that the home is not found within the test
                    Mode::Home => 0.5,
                    _ => mode.range.max * 0.4,
                };
                let setpoint = Setpoint { mode: mode.mode, value };
                for refused in Refused::ALL {
                    let what = format!("{} in {}, {refused:?}", info.id, mode.mode);
                    let newer = async |host: &mut RawHost, _| {
                        let request = refused.request(info, mode, now_us(device));
                        host.ask(request).await.expect_err("refused");
                    };
                    assert!(!is_followed_after(host, device, info, setpoint, newer).await, "{what}: goes on");
                    cases += 1;
                }
                let older = async |host: &mut RawHost, sent_us: u64| {
                    // a repetition, after its time to live; an older one, after its time to live; an invalid older one
                    for (sent_us, value) in [(sent_us, setpoint.value), (sent_us - 1, 0.0), (sent_us - 1, f32::NAN)] {
                        host.ask(set_at(sent_us, info.id, mode.mode, value)).await.expect_err("refused");
                    }
                };
                let followed = is_followed_after(host, device, info, setpoint, older).await;
                assert!(followed, "{} in {}: stopped by an older one", info.id, mode.mode);
            }
        }
        // 4 modes of a motor that can home, 3 of such a stepper, and 4 others
        assert_eq!(cases, 6 * 11, "{kinds:?}");
    });
}

/// An active brake stays on: neutral would release it.
#[test]
fn a_refused_set_point_releases_no_brake() {
    raw_bench(&r4_boards::load("every-interface").expect("built in"), async |host, device| {
        host.listen(1000).await;
        let channel = ChannelId::new(ChannelKind::Bldc, 0);
        let braked = || device.board.world().bldc(channel).expect("a drive").is_braking();
        for (mode, value) in [(Mode::Duty, 2.0), (Mode::Brake, 0.5)] {
            let session = host.hello().await.session;
            host.ask(Request::Arm).await.unwrap();
            host.ask(set(device, channel, Mode::Duty, 0.3)).await.unwrap();
            wait(host, session, 110).await;
            assert!(!braked());
            host.ask(set(device, channel, Mode::Brake, 1.0)).await.unwrap();
            wait(host, session, 20).await;
            assert!(braked());
            host.ask(set(device, channel, mode, value)).await.expect_err("refused");
            wait(host, session, 50).await;
            assert!(braked());
        }
    });
}

/// A refused cycle ends the set points of its channels, leased or not; an older one ends nothing.
#[test]
fn a_refused_cycle_never_leaves_older_set_points_in_force() {
    raw_bench(&osmc_bench(), async |host, device| {
        for leased in [true, false] {
            let too_fast = |seq, sent_us| Cycle::new(seq, None, Some(sent_us), steps(5001, NOTHING));
            for (case, outcome, ends) in [
                ("newer and wrong", CycleOutcome::Refused, true),
                ("newer and wrong, undated", CycleOutcome::Refused, true),
                ("newer and late", CycleOutcome::Stale, true),
                ("older and wrong", CycleOutcome::Refused, false),
                ("older and late", CycleOutcome::Stale, false),
                ("wrong for the other channel alone", CycleOutcome::Refused, false),
            ] {
                let session = host.hello().await.session;
                host.listen(60).await;
                host.ask(bind(if outcome == CycleOutcome::Stale { 50 } else { 500 })).await.unwrap();
                host.ask(Request::Arm).await.unwrap();
                let sent_us = now_us(device);
                if leased {
                    let cycle = Cycle::new(0, None, Some(sent_us), steps(2000, NOTHING));
                    assert_eq!(turn(host, cycle).await.outcome(), CycleOutcome::Taken);
                } else {
                    host.ask(set_at(sent_us, ROTARY, Mode::Speed, 2.0)).await.unwrap();
                }
                host.listen(5).await;
                assert_eq!(setpoint_of(host, ROTARY).await, Setpoint { mode: Mode::Speed, value: 2.0 });
                let late = outcome == CycleOutcome::Stale;
                if late {
                    wait(host, session, 80).await;
                }
                let refused = match case {
                    "newer and wrong" => too_fast(1, now_us(device)),
                    "newer and wrong, undated" => Cycle::new(1, None, None, steps(5001, NOTHING)),
                    "newer and late" => too_fast(1, sent_us + 1000),
                    "wrong for the other channel alone" => Cycle::new(1, None, None, steps(NOTHING, -1)),
                    _ => too_fast(1, sent_us - 1000),
                };
                assert_eq!(turn(host, refused).await.outcome(), outcome, "{case}");
                let told = setpoint_of(host, ROTARY).await;
                // a leased set point ends with its time to live in any case
                let value = if ends || (leased && late) { 0.0 } else { 2.0 };
                assert_eq!(told, Setpoint { mode: Mode::Speed, value }, "{case}, leased: {leased}");
            }
        }
    });
}

#[test]
fn commands_are_refused_unless_armed() {
    raw_bench(&osmc_bench(), async |host, device| {
        host.hello().await;
        for (request, state) in [(Request::Disarm, SafetyState::Disarmed), (Request::Stop, SafetyState::Tripped)] {
            host.ask(request).await.unwrap();
            let refused = host.ask(set(device, ROTARY, Mode::Duty, 0.8)).await;
            assert_eq!(refused, Err(Refusal::NotArmed { state }));
        }
        host.ask(Request::Clear).await.unwrap();
        host.ask(Request::Arm).await.unwrap();
        host.listen(20).await;
        nothing_moved(device);
    });
}

/// Frames of commands that come again, as a recording that is played back or from a link that repeats them: in their own
/// session, disarmed and armed, and in a later one. What was decided for another moment moves nothing.
#[test]
fn frames_of_commands_move_nothing_when_they_come_again() {
    raw_bench(&osmc_bench(), async |host, device| {
        let request = |seq, request| frame(&ToDevice::Request { seq, request });
        let position = || device.board.world().position(ROTARY).expect("the bench has the channel");
        // no command is accepted before the board has started
        host.listen(100).await;
        let mut session = host.hello().await.session;
        host.ask(bind(50)).await.unwrap();
        let cycle = Cycle::new(1, None, Some(now_us(device)), steps(2000, NOTHING));
        let point = PathPoint { at_us: now_us(device) + 40_000, position: 0.01, speed: None, feed_forward: 0.0 };
        let points = [point].into_iter().collect();
        let frames = [
            request(5000, Request::Arm),
            request(5001, Request::Follow { channel: ROTARY, sent_us: now_us(device), points }),
            frame(&ToDevice::Cycle(cycle)),
            request(5002, set(device, ROTARY, Mode::Duty, 0.3)),
        ];
        // answers to the requests in their order, and the outcome of the cycle
        let played = async |host: &mut RawHost| {
            host.send_bytes(&frames.concat()).await;
            let (mut results, mut outcomes) = (Vec::new(), Vec::new());
            for message in host.listen(10).await {
                match message {
                    ToHost::Response { result, .. } => results.push(result),
                    ToHost::Cycle(state) => outcomes.push(state.outcome()),
                    _ => {}
                }
            }
            (results, outcomes)
        };
        assert_eq!(played(host).await, (vec![Ok(Reply::Done); 3], vec![CycleOutcome::Taken]));
        // the motors' supply comes 50 ms after arming
        wait(host, session, 110).await;
        assert!(device.duty(ROTARY) > 0.0, "they move the motor when they are new");
        for (case, expected) in [
            ("disarmed", vec![Ok(Reply::Done); 3]),
            ("armed", vec![Ok(Reply::Done); 3]),
            ("in another session", Vec::new()),
        ] {
            host.ask(Request::Disarm).await.unwrap();
            wait(host, session, 2000).await;
            if case == "armed" {
                host.ask(Request::Arm).await.unwrap();
            }
            if expected.is_empty() {
                session = host.hello().await.session;
                host.ask(bind(50)).await.unwrap();
            }
            let begin = position();
            let (results, outcomes) = played(host).await;
            assert_eq!(outcomes, [CycleOutcome::Stale], "{case}");
            if expected.is_empty() {
                let late = matches!(
                    results[..],
                    [Ok(Reply::Done), Err(Refusal::Late { .. }), Err(Refusal::Expired { ttl_ms: 50, .. })]
                );
                assert!(late, "{case}: {results:?}");
            } else {
                // each is taken for a repeat of itself, and answered as it was then
                assert_eq!(results, expected, "{case}");
            }
            for _ in 0..100 {
                host.listen(1).await;
                assert_eq!(device.duty(ROTARY), 0.0, "{case}");
            }
            // a tenth of its encoder's count
            assert!((position() - begin).abs() < 2.6e-4, "{case}");
            host.send(&ToDevice::Heartbeat { session, host_us: 7 }).await;
            let expected = if case == "disarmed" { SafetyState::Disarmed } else { SafetyState::Armed };
            let heard = host.listen(2).await;
            assert!(matches!(heard[..], [ToHost::Heartbeat { state, .. }] if state == expected), "{case}: {heard:?}");
        }
    });
}

#[test]
fn a_heartbeat_of_another_session_does_not_keep_the_link() {
    raw_bench(&osmc_bench(), async |host, device| {
        for (other, state) in [(0, SafetyState::Armed), (1, SafetyState::Tripped)] {
            let session = host.hello().await.session;
            host.ask(Request::Arm).await.unwrap();
            // 300 ms, longer than the link timeout of 200 ms
            let mut answers = 0;
            for _ in 0..6 {
                host.send(&ToDevice::Heartbeat { session: session.wrapping_add(other), host_us: 7 }).await;
                let heard = host.listen(50).await;
                answers += heard.iter().filter(|m| matches!(m, ToHost::Heartbeat { host_us: 7, .. })).count();
            }
            assert_eq!(answers, if other == 0 { 6 } else { 0 });
            let armed = host.ask(set(device, ROTARY, Mode::Duty, 0.0)).await;
            assert_eq!(armed, if other == 0 { Ok(Reply::Done) } else { Err(Refusal::NotArmed { state }) });
        }
    });
}

#[test]
fn telemetry_of_every_channel_at_the_highest_rate_holds_nothing_up() {
    bench(&osmc_bench(), async |bench| {
        bench.host.arm().await.unwrap();
        let mut telemetry = bench.host.telemetry();
        let channels: Vec<_> = bench.host.channels().iter().map(|channel| channel.id).collect();
        for channel in &channels {
            bench.host.subscribe(*channel, 1).await.unwrap();
        }
        // both motors in motion, and reversing
        for (rotary, linear) in [(3.0, 0.02), (-3.0, 0.005)] {
            bench.set(ROTARY, Mode::Position, rotary).await.unwrap();
            bench.set(LINEAR, Mode::Position, linear).await.unwrap();
            while telemetry.try_next().is_some() {}
            let begin_ns = bench.clock.now_ns();
            bench.sleep_ms(1000).await;
            let mut samples = vec![0; channels.len()];
            while let Some(frame) = telemetry.try_next() {
                for sample in frame.samples {
                    samples[channels.iter().position(|channel| *channel == sample.channel()).unwrap()] += 1;
                }
            }
            // one each millisecond, except for those in transmission at either end
            let expected = (bench.clock.now_ns() - begin_ns) / MS;
            assert!(samples.iter().all(|count| expected.abs_diff(*count) <= 2), "{samples:?} in {expected} ms");
        }
        let stats = bench.host.stats().await.unwrap();
        assert_eq!((stats.late_ticks, stats.telemetry_dropped), (0, 0), "the longest took {} us", stats.worst_tick_us);
    });
}

/// Binding of the cycles in these tests: the bench's rotary motor by its speed, 1 mrad/s per step, its actuator by its
/// position, 1 um per step.
fn bind(ttl_ms: u16) -> Request {
    let channels = [of_cycle(ROTARY, Mode::Speed), of_cycle(LINEAR, Mode::Position)];
    Request::Bind { channels: channels.into_iter().collect(), ttl_ms }
}

fn of_cycle(channel: ChannelId, mode: Mode) -> CycleChannel {
    CycleChannel { channel, mode, position_scale: if channel == LINEAR { 1e-6 } else { 1e-3 }, speed_scale: 1e-3 }
}

/// Set points for the two channels of [`bind`].
fn steps(rotary: i16, linear: i16) -> [i16; 4] {
    [rotary, linear, 1234, 5678]
}

/// Sends `cycle` and returns its answer; panics if there is none, or another message.
async fn turn(host: &mut RawHost, cycle: Cycle) -> CycleState {
    host.send(&ToDevice::Cycle(cycle)).await;
    match host.listen(2).await[..] {
        [ToHost::Cycle(state)] if state.seq == cycle.seq => state,
        ref other => panic!("{other:?} to {cycle:?}"),
    }
}

fn now_us(device: &Device) -> u64 {
    device.clock.now_ns() / 1000
}

#[test]
fn a_cycle_moves_what_is_bound_and_tells_what_it_does() {
    raw_bench(&osmc_bench(), async |host, device| {
        host.hello().await;
        host.ask(bind(50)).await.unwrap();
        host.ask(Request::Arm).await.unwrap();
        let start_us = device.board.world().position(LINEAR).unwrap() * 1e6;
        let mut last = None;
        // 1.5 s: 2 rad/s, and 20 mm from the rod's position
        for turn_number in 0..150_u64 {
            let target = start_us as i16 + 10_000;
            let cycle = Cycle::new(turn_number as u8, None, Some(now_us(device)), steps(2000, target));
            let state = turn(host, cycle).await;
            assert_eq!((state.outcome(), state.state()), (CycleOutcome::Taken, Ok(SafetyState::Armed)));
            assert_eq!(state.causes(), Causes::NONE);
            let age_us = now_us(device) - state.device_us(now_us(device));
            assert!(age_us <= 2000, "the board's clock is the simulation's: {age_us} us");
            if turn_number % 5 == 0 {
                let session = 1;
                host.send(&ToDevice::Heartbeat { session, host_us: 0 }).await;
            }
            host.listen(8).await;
            last = Some(state);
        }
        let [rotary, linear, unbound, last] = last.unwrap().motors();
        assert!((1900..2100).contains(&rotary.speed), "{rotary:?}");
        let resolution = std::f64::consts::TAU / 2400.0;
        let position = device.board.world().position(ROTARY).unwrap();
        assert!((f64::from(rotary.position) * resolution - position).abs() < 0.1, "{rotary:?} at {position} rad");
        assert!((f64::from(rotary.duty) / 32_767.0 - device.duty(ROTARY)).abs() < 0.05, "{rotary:?}");
        assert!(f64::from(linear.position) - start_us > 5_000.0, "{linear:?} from {start_us} um");
        assert_eq!([unbound, last], [CycleMotor::NONE; 2]);
        assert_eq!(host.stats().await.cycles_refused, 0);
    });
}

#[test]
fn a_cycle_is_refused_whole_and_always_answered() {
    raw_bench(&osmc_bench(), async |host, device| {
        let cycle = |seq, rotary, linear| Cycle::new(seq, None, Some(now_us(device)), steps(rotary, linear));
        let mut refused = 0;
        let mut expect = async |host: &mut RawHost, what: &str, cycle, outcome| {
            let state = turn(host, cycle).await;
            assert_eq!(state.outcome(), outcome, "{what}");
            refused += u32::from(outcome != CycleOutcome::Taken);
            if outcome != CycleOutcome::Taken {
                // a period has passed, in which it would have moved
                nothing_moved(device);
            }
            state
        };
        // no command is accepted before the board has started
        host.listen(100).await;
        let unbound = expect(host, "no session", cycle(1, 100, 0), CycleOutcome::Unbound).await;
        assert_eq!(unbound.motors(), [CycleMotor::NONE; 4]);
        host.hello().await;
        expect(host, "nothing bound", cycle(2, 100, 0), CycleOutcome::Unbound).await;
        host.ask(bind(50)).await.unwrap();
        let disarmed = expect(host, "not armed", cycle(3, 100, 0), CycleOutcome::Refused).await;
        assert_eq!(disarmed.state(), Ok(SafetyState::Disarmed));
        expect(host, "only asked", cycle(4, NOTHING, NOTHING), CycleOutcome::Taken).await;
        host.ask(Request::Arm).await.unwrap();
        host.listen(60).await;

        // 5.001 rad/s with a limit of 5, and 1 um below the rod's range: the other set point is valid each time
        expect(host, "too fast", cycle(5, 5001, 50_00), CycleOutcome::Refused).await;
        expect(host, "too short", cycle(6, 100, -1), CycleOutcome::Refused).await;
        for mode in [Mode::Switch, Mode::Voltage, Mode::Brake, Mode::Home] {
            let other = Cycle::new(7, Some(mode), Some(now_us(device)), steps(100, NOTHING));
            expect(host, "a mode no cycle has", other, CycleOutcome::Refused).await;
        }
        for (age_us, outcome) in [(51_000, CycleOutcome::Stale), (-52_000, CycleOutcome::Stale)] {
            let sent_us = now_us(device).checked_add_signed(-age_us).unwrap();
            expect(host, "old, or dated ahead", Cycle::new(8, None, Some(sent_us), steps(100, NOTHING)), outcome).await;
        }
        let stats = host.stats().await;
        assert_eq!((stats.cycles_refused, stats.refused), (refused, 0));

        // not because nothing could move: in either of the other modes, and without a date
        let duty = Cycle::new(9, Some(Mode::Duty), Some(now_us(device)), steps(20_000, NOTHING));
        assert_eq!(turn(host, duty).await.outcome(), CycleOutcome::Taken);
        host.listen(20).await;
        assert!(device.duty(ROTARY) > 0.3 && device.duty(LINEAR) == 0.0);
        let undated = Cycle::new(10, Some(Mode::Position), None, steps(-1000, NOTHING));
        assert_eq!(turn(host, undated).await.outcome(), CycleOutcome::Taken);
        // the end of the session ends the binding
        host.hello().await;
        assert_eq!(turn(host, cycle(11, 0, 0)).await.outcome(), CycleOutcome::Unbound);
    });
}

#[test]
fn what_no_cycle_can_move_is_not_bound() {
    raw_bench(&osmc_bench(), async |host, _| {
        let bind =
            |channels: &[CycleChannel]| Request::Bind { channels: channels.iter().copied().collect(), ttl_ms: 50 };
        assert_eq!(host.ask(bind(&[])).await, Err(Refusal::NoSession));
        host.hello().await;
        let relay = ChannelId::new(ChannelKind::Relay, 1);
        let wrong = |channel, mode| Refusal::WrongMode { channel, mode };
        let bad = Refusal::BadBinding { channel: ROTARY };
        let good = of_cycle(ROTARY, Mode::Speed);
        let no_motor = of_cycle(NO_MOTOR, Mode::Duty);
        let cases = [
            (vec![good, no_motor], Refusal::UnknownChannel { channel: NO_MOTOR }),
            (vec![of_cycle(relay, Mode::Switch)], wrong(relay, Mode::Switch)),
            (vec![of_cycle(SUPPLY_24, Mode::Duty)], wrong(SUPPLY_24, Mode::Duty)),
            (vec![of_cycle(ROTARY, Mode::Home)], wrong(ROTARY, Mode::Home)),
            (vec![of_cycle(ROTARY, Mode::Voltage)], wrong(ROTARY, Mode::Voltage)),
            (vec![good, of_cycle(ROTARY, Mode::Duty)], bad),
            (vec![CycleChannel { speed_scale: 0.0, ..good }], bad),
            (vec![CycleChannel { speed_scale: f32::NAN, ..good }], bad),
            (vec![CycleChannel { position_scale: f32::INFINITY, ..good }], bad),
            (vec![CycleChannel { position_scale: -1.0, ..good }], bad),
        ];
        for (channels, refusal) in cases {
            assert_eq!(host.ask(bind(&channels)).await, Err(refusal), "{channels:?}");
            assert_eq!(turn(host, Cycle::new(0, None, None, [NOTHING; 4])).await.outcome(), CycleOutcome::Unbound);
        }
        assert_eq!(host.ask(bind(&[good])).await, Ok(Reply::Done));
        assert_eq!(turn(host, Cycle::new(0, None, None, [NOTHING; 4])).await.outcome(), CycleOutcome::Taken);
        assert_eq!(host.ask(bind(&[])).await, Ok(Reply::Done));
        assert_eq!(turn(host, Cycle::new(0, None, None, [NOTHING; 4])).await.outcome(), CycleOutcome::Unbound);
    });
}

/// Two channels whose cycles stop: the one that has had a single command since then continues.
#[test]
fn the_set_points_of_cycles_that_stop_coming_end() {
    const TTL_MS: u64 = 50;
    for mode in [Mode::Position, Mode::Speed, Mode::Duty] {
        raw_bench(&osmc_bench(), async |host, device| {
            let session = host.hello().await.session;
            let heartbeat = ToDevice::Heartbeat { session, host_us: 0 };
            let channels = [of_cycle(ROTARY, mode), of_cycle(LINEAR, Mode::Duty)];
            let bind = Request::Bind { channels: channels.into_iter().collect(), ttl_ms: TTL_MS as u16 };
            host.ask(bind).await.unwrap();
            host.ask(Request::Arm).await.unwrap();
            host.ask(Request::Subscribe { channel: ROTARY, period_ms: 1 }).await.unwrap();
            let mut sent_us = 0;
            for turn in 0..50 {
                sent_us = now_us(device);
                let rotary = if mode == Mode::Duty { 26_000 } else { 3000 };
                host.send(&ToDevice::Cycle(Cycle::new(turn, None, Some(sent_us), steps(rotary, 10_000)))).await;
                host.send(&heartbeat).await;
                host.listen(if turn == 49 { 1 } else { 20 }).await;
            }
            let speed = device.board.world().speed(ROTARY).unwrap();
            assert!(speed > 0.5, "{mode}: it must run before it can stop: {speed} rad/s");
            host.ask(set(device, LINEAR, Mode::Duty, 0.3)).await.unwrap();
            host.send(&heartbeat).await;

            let at_rest = Setpoint { mode: if mode == Mode::Duty { mode } else { Mode::Speed }, value: 0.0 };
            let stopped_us = host.listen(100).await.into_iter().find_map(|message| match message {
                ToHost::Telemetry(Telemetry { device_us, samples, .. }) => match samples[..] {
                    [Sample::Motor { setpoint, .. }] if setpoint == at_rest => Some(device_us),
                    _ => None,
                },
                _ => None,
            });
            // sampled each millisecond, as is telemetry
            let after_us = stopped_us.expect("it stops") - sent_us;
            assert!((TTL_MS * 1000..TTL_MS * 1000 + 3000).contains(&after_us), "{mode}: after {after_us} us");
            for _ in 0..15 {
                host.send(&heartbeat).await;
                host.listen(100).await;
            }
            let speed = device.board.world().speed(ROTARY).unwrap();
            assert!(speed.abs() < 0.05, "{mode}: {speed} rad/s");
            assert!(device.duty(LINEAR) > 0.2, "a single command holds");
            assert_eq!(host.stats().await.setpoints_expired, 1);
            host.ask(Request::Subscribe { channel: ROTARY, period_ms: 0 }).await.unwrap();
            host.listen(10).await;
            let state = turn(host, Cycle::new(0, None, None, [NOTHING; 4])).await;
            assert_eq!(state.state(), Ok(SafetyState::Armed), "cycles that stop coming are no trip");
        });
    }
}

/// The board's clock has 32 bits in a cycle, which wrap after 71 minutes.
#[test]
fn cycles_go_on_when_the_32_bits_of_their_clock_wrap() {
    const WRAP_US: u64 = 1 << 32;
    // Time starts before the board: it is on for a second when the clock wraps.
    let late = |simulation: &mut Simulation, robot: &Robot| {
        let clock = simulation.clock();
        simulation.block_on(clock.sleep((WRAP_US - 1_000_000) * 1000)).expect("time goes on");
        power_up(simulation, robot)
    };
    raw_bench_of(&late, &osmc_bench(), async |host, device| {
        host.hello().await;
        host.ask(bind(50)).await.unwrap();
        // Without heartbeats meanwhile it trips; cycles that only query are still answered.
        host.listen((WRAP_US - 20_000 - now_us(device)) / 1000).await;
        let mut outcomes = Vec::new();
        for seq in 250..=260_u32 {
            let sent_us = now_us(device);
            let state = turn(host, Cycle::new(seq as u8, None, Some(sent_us), [NOTHING; 4])).await;
            let device_us = state.device_us(now_us(device));
            assert!((sent_us..sent_us + 2000).contains(&device_us), "{device_us}, sent at {sent_us}");
            outcomes.push((sent_us < WRAP_US, state.outcome()));
            host.listen(3).await;
        }
        assert!(outcomes.iter().any(|(before, _)| *before) && outcomes.iter().any(|(before, _)| !before));
        assert!(outcomes.iter().all(|(_, outcome)| *outcome == CycleOutcome::Taken), "{outcomes:?}");
        let sent_us = now_us(device) - 60_000;
        assert!(sent_us < WRAP_US && now_us(device) > WRAP_US);
        let old = turn(host, Cycle::new(1, None, Some(sent_us), [NOTHING; 4])).await;
        assert_eq!(old.outcome(), CycleOutcome::Stale, "also over the wrap");
    });
}

/// Whole frames, parts of frames and noise, but never a whole request to arm.
fn any_bytes() -> impl Strategy<Value = Vec<u8>> {
    let message = prop_oneof![
        any::<u64>().prop_map(|schema| Request::Hello { version: VERSION, schema }),
        Just(Request::Hello { version: VERSION, schema: SCHEMA_HASH }),
        Just(Request::Clear),
        Just(Request::Bye),
        Just(Request::Stats),
        (any::<u8>()).prop_map(|index| Request::Describe { index }),
        (any::<u8>(), any::<u16>()).prop_map(|(index, period_ms)| Request::Subscribe {
            channel: ChannelId::new(ChannelKind::Osmc, index),
            period_ms,
        }),
        (any::<f32>(), any::<u64>(), any::<u16>()).prop_map(|(value, sent_us, ttl_ms)| Request::Set {
            channel: ROTARY,
            setpoint: Setpoint { mode: Mode::Duty, value },
            sent_us,
            ttl_ms,
        }),
        Just(bind(50)),
        any::<[f32; 3]>().prop_map(|[kp, ki, kd]| Request::SetGains {
            channel: ROTARY,
            mode: Mode::Speed,
            gains: PidGains { kp, ki, kd },
        }),
    ];
    let whole = (any::<u16>(), message).prop_map(|(seq, request)| frame(&ToDevice::Request { seq, request }));
    let beat =
        (any::<u16>(), any::<u64>()).prop_map(|(session, host_us)| frame(&ToDevice::Heartbeat { session, host_us }));
    let cycle = (any::<u8>(), any::<Option<u64>>(), any::<[i16; 4]>())
        .prop_map(|(seq, sent_us, set)| frame(&ToDevice::Cycle(Cycle::new(seq, None, sent_us, set))));
    // COBS makes the damage visible to the CRC: a flipped bit gives no other valid frame
    let damaged = (any::<u16>(), any::<prop::sample::Index>(), 0..8u8).prop_map(|(seq, place, bit)| {
        let mut arm = frame(&ToDevice::Request { seq, request: Request::Arm });
        let place = place.index(arm.len() - 1);
        arm[place] ^= 1 << bit;
        arm
    });
    let noise = prop::collection::vec(any::<u8>(), 0..300);
    let piece = prop_oneof![3 => whole, 1 => beat, 1 => cycle, 2 => damaged, 2 => noise];
    prop::collection::vec(piece, 0..12).prop_map(|pieces| pieces.concat())
}

/// Set points that the bench follows after `set` for the channels of [`bind`]; `None` if it is refused.
fn followed(mode: Option<Mode>, set: [i16; 4]) -> Option<[Option<Setpoint>; 2]> {
    let of = |motor: usize, bound: CycleChannel| {
        if set[motor] == NOTHING {
            return Some(None);
        }
        let mode = mode.unwrap_or(bound.mode);
        let value = f32::from(set[motor]) * bound.scale(mode)?;
        range_of(motor, mode).contains(value).then_some(Some(Setpoint { mode, value }))
    };
    Some([of(0, of_cycle(ROTARY, Mode::Speed))?, of(1, of_cycle(LINEAR, Mode::Position))?])
}

/// Mode, age in µs, and set points of a cycle.
type AnyCycle = (Option<Mode>, Option<i64>, [i16; 4]);

fn any_cycle() -> impl Strategy<Value = AnyCycle> {
    let modes = vec![Mode::Position, Mode::Speed, Mode::Duty, Mode::Switch, Mode::Voltage, Mode::Brake, Mode::Home];
    let mode = proptest::option::of(proptest::sample::select(modes));
    let steps = || prop_oneof![3 => -50..50_i16, 2 => any::<i16>(), 1 => Just(NOTHING)];
    // sampling both motors takes some 10 ms of the time to live
    let age_us = prop_oneof![3 => -30_000..30_000_i64, 1 => 51_000..1_000_000_i64, 1 => -1_000_000..-52_000_i64];
    (mode, proptest::option::of(age_us), [steps(), steps(), steps(), steps()])
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, cases: 48, ..ProptestConfig::default() })]

    /// For any content of a cycle, the motors follow set points that single commands could have set, or their earlier
    /// ones.
    #[test]
    fn any_cycle_is_followed_as_single_commands_are_or_not_at_all(cycles in prop::collection::vec(any_cycle(), 1..12)) {
        raw_bench(&osmc_bench(), async |host: &mut RawHost, device: &Device| {
            let session = host.hello().await.session;
            host.ask(bind(50)).await.unwrap();
            host.listen(1000).await;
            host.hello().await;
            host.ask(bind(50)).await.unwrap();
            host.ask(Request::Clear).await.unwrap();
            host.ask(Request::Arm).await.unwrap();
            for (seq, (mode, age_us, set)) in cycles.iter().copied().enumerate() {
                let sent_us = age_us.map(|age_us| now_us(device).checked_add_signed(-age_us).unwrap());
                let state = turn(host, Cycle::new(seq as u8, mode, sent_us, set)).await;
                let expected = match (age_us, followed(mode, set)) {
                    (Some(age_us), _) if age_us.abs() > 50_000 => CycleOutcome::Stale,
                    (_, None) => CycleOutcome::Refused,
                    (_, Some(_)) => CycleOutcome::Taken,
                };
                assert_eq!(state.outcome(), expected, "{mode:?} {age_us:?} {set:?}");
                let told = [setpoint_of(host, ROTARY).await, setpoint_of(host, LINEAR).await];
                if expected == CycleOutcome::Taken {
                    for (told, followed) in told.iter().zip(followed(mode, set).unwrap()) {
                        assert!(followed.is_none_or(|followed| *told == followed), "{told:?}, not {followed:?}");
                    }
                }
                for (motor, told) in told.iter().enumerate() {
                    assert!(range_of(motor, told.mode).contains(told.value), "{told:?}");
                }
                host.send(&ToDevice::Heartbeat { session: session + 1, host_us: 0 }).await;
                host.listen(1).await;
            }
            assert_eq!(host.hello().await.causes, Causes::NONE);
        });
    }
}

/// Set point that a motor follows, by its telemetry.
async fn setpoint_of(host: &mut RawHost, channel: ChannelId) -> Setpoint {
    host.ask(Request::Subscribe { channel, period_ms: 1 }).await.expect("a channel");
    let heard = host.listen(2).await;
    host.ask(Request::Subscribe { channel, period_ms: 0 }).await.expect("a channel");
    host.listen(1).await;
    let last = heard.into_iter().rev().find_map(|message| match message {
        ToHost::Telemetry(Telemetry { samples, .. }) => match samples[..] {
            [Sample::Motor { setpoint, .. }] => Some(setpoint),
            _ => None,
        },
        _ => None,
    });
    last.expect("a sample each millisecond")
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn any_bytes_are_survived_and_never_arm(bytes in any_bytes(), chunk in 1..100usize, session: bool) {
        raw_bench(&osmc_bench(), async |host: &mut RawHost, device: &Device| {
            if session {
                host.hello().await;
            }
            for chunk in bytes.chunks(chunk) {
                host.send_bytes(chunk).await;
                assert!(device.is_off(ROTARY) && device.is_off(LINEAR));
            }
            // ends any open frame
            host.send_bytes(&[0]).await;
            host.listen(50).await;
            // armed without a command is braked, not off
            assert!(device.is_off(ROTARY) && device.is_off(LINEAR), "armed");
            let causes = host.hello().await.causes;
            assert!(causes == Causes::NONE || causes == Causes::only(Cause::LinkLost), "{causes}");
            nothing_moved(device);
            assert_eq!(device.board.world().misuse(), []);
        });
    }
}
