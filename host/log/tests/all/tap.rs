//! Tests of recordings made from the bytes on a link.
#![allow(clippy::unwrap_used, reason = "test code")]

use std::io::Cursor;

use crate::common::{OSMC, SUPPLY, header, messages};
use r4_log::{About, Log, LoggedRequest, RecordError, Recorded, Tap, Wall};
use r4_protocol::{
    Cause, Causes, ChannelInfo, DeviceInfo, Mode, Refusal, Reply, Request, SCHEMA_HASH, SafetyState, Sample, Setpoint,
    Telemetry, ToDevice, ToHost, VERSION,
    config::PidGains,
    encode_frame,
    frame::{MAX_FRAME, Message},
};

fn frame(message: &impl Message) -> Vec<u8> {
    encode_frame(message, &mut [0; MAX_FRAME]).unwrap().to_vec()
}

fn tap(wall: Wall) -> Tap<Cursor<Vec<u8>>> {
    Tap::new(
        Cursor::new(Vec::new()),
        About {
            board: "sim:osmc-bench".into(),
            seed: Some(3),
            program: "a test".into(),
            command: "record".into(),
            wall,
        },
    )
}

/// Tap with both ends of its link. The board's clock is 5 s ahead of the host's.
struct Link {
    tap: Tap<Cursor<Vec<u8>>>,
    seq: u16,
}

const AHEAD_US: u64 = 5_000_000;

impl Link {
    fn ask(&mut self, now_us: u64, request: Request) {
        self.seq += 1;
        self.tap.sent(now_us, &frame(&ToDevice::Request { seq: self.seq, request }));
    }

    fn answer(&mut self, now_us: u64, result: Result<Reply, Refusal>) {
        self.tap.received(now_us, &frame(&ToHost::Response { seq: self.seq, result }));
    }

    /// Sends hello at 100 µs and describes every channel until 1 ms.
    fn open() -> Self {
        Self::open_at(Wall::Began { unix_ns: 0 })
    }

    fn open_at(wall: Wall) -> Self {
        let mut link = Self { tap: tap(wall), seq: 65_000 };
        link.greet(100, AHEAD_US + 150, header().channels);
        link
    }

    /// Sends hello at `now_us` to a board whose clock reads `device_us` 50 µs later.
    fn greet(&mut self, now_us: u64, device_us: u64, channels: Vec<ChannelInfo>) {
        self.ask(now_us, Request::Hello { version: VERSION, schema: SCHEMA_HASH });
        let info = DeviceInfo {
            robot: "bench \"A\"".try_into().unwrap(),
            firmware: "0.1.0".try_into().unwrap(),
            session: 1,
            channels: channels.len() as u8,
            link_timeout_ms: 200,
            device_us,
            state: SafetyState::Disarmed,
            causes: Causes::NONE,
        };
        self.answer(now_us + 100, Ok(Reply::Hello(info)));
        for (index, channel) in channels.into_iter().enumerate() {
            self.ask(now_us + 200 + index as u64, Request::Describe { index: index as u8 });
            self.answer(now_us + 300 + index as u64, Ok(Reply::Channel(channel)));
        }
    }

    /// Sends samples of the first channel every 10 ms over a range of the board's clock; the host's is `behind_us`
    /// behind it.
    fn samples(&mut self, device_us: std::ops::Range<u64>, behind_us: u64) {
        for device_us in device_us.step_by(10_000) {
            let samples = [Sample::Scalar { channel: SUPPLY, value: 12.0 }].into_iter().collect();
            let (state, causes) = (SafetyState::Disarmed, Causes::NONE);
            let telemetry = Telemetry { device_us, state, causes, samples };
            self.tap.received(device_us - behind_us, &frame(&ToHost::Telemetry(telemetry)));
        }
    }

    fn subscribe(&mut self, now_us: u64) {
        self.ask(now_us, Request::Subscribe { channel: SUPPLY, period_ms: 10 });
        self.answer(now_us, Ok(Reply::Done));
    }

    fn log(self) -> Log {
        Log::from_bytes(self.tap.finish().unwrap().unwrap().get_ref()).unwrap()
    }
}

#[test]
fn log_times_of_a_board_in_real_time_are_those_of_the_wall() {
    const ZERO_NS: u64 = 1_700_000_000_000_000_000;
    let mut link = Link::open_at(Wall::Runs { unix_ns_at_zero: ZERO_NS });
    link.ask(2_000, Request::Arm);
    let file = link.tap.finish().unwrap().unwrap().into_inner();
    let log = Log::from_bytes(&file).unwrap();
    let recorded = log.header.recorded.unwrap();
    // The hello was sent at 100 µs. The date is from `date -u -d @1700000000`.
    assert_eq!((recorded.unix_ns, recorded.at()), (ZERO_NS + 100_000, "2023-11-14T22:13:20Z".to_owned()));
    let arm = messages(&file).into_iter().rfind(|message| message.topic == "/request").unwrap();
    assert_eq!((arm.header.log_time, arm.header.publish_time), (ZERO_NS + 2_000_000, (AHEAD_US + 2_000) * 1_000));
    assert_eq!(log.requests[0].time_s, (AHEAD_US + 2_000) as f64 / 1e6);
}

/// Link with samples from 0.01 s to 0.99 s of the host's clock, then lost for 2 s.
fn lost() -> Link {
    let mut link = Link::open();
    link.subscribe(2_000);
    link.samples(AHEAD_US + 10_000..AHEAD_US + 1_000_000, AHEAD_US);
    link.tap.reopened();
    // A second attempt, which the board does not answer.
    link.ask(2_000_000, Request::Hello { version: VERSION, schema: SCHEMA_HASH });
    link.tap.reopened();
    link
}

#[test]
fn a_lost_link_leaves_a_gap() {
    let mut link = lost();
    link.greet(2_990_000, AHEAD_US + 2_990_050, header().channels);
    link.subscribe(2_991_000);
    link.samples(AHEAD_US + 3_000_000..AHEAD_US + 4_000_000, AHEAD_US);
    let log = link.log();
    let gap = log.gaps[0];
    assert_eq!((log.gaps.len(), gap.restarted, gap.clock_shift_us), (1, false, 0));
    // Last heard at 0.99 s, then 100 µs after the hello.
    assert_eq!((gap.time_s, gap.without_link_s), ((AHEAD_US + 2_990_050) as f64 / 1e6, 2.0001));
    let supply = log.coverage().into_iter().find(|coverage| coverage.channel == SUPPLY).unwrap();
    assert_eq!((supply.samples, supply.missing), (199, Some(0)), "nothing was asked for without a link");
    assert_eq!(gap.to_string(), "2.000 s without a link; the board ran on");
    assert!(log.signals().iter().any(|signal| signal.name == "gap" && signal.samples.len() == 1));
}

#[test]
fn times_go_on_when_the_board_has_restarted() {
    let mut link = lost();
    // The board answers 0.3 s after its restart.
    link.greet(2_990_000, 300_050, header().channels);
    link.subscribe(2_991_000);
    for tick in 1..=100_u64 {
        let samples = [Sample::Scalar { channel: SUPPLY, value: 12.0 }].into_iter().collect();
        let (state, causes) = (SafetyState::Disarmed, Causes::only(Cause::WatchdogReset));
        let telemetry = Telemetry { device_us: 300_000 + tick * 10_000, state, causes, samples };
        link.tap.received(2_990_000 + tick * 10_000, &frame(&ToHost::Telemetry(telemetry)));
    }
    let log = link.log();
    let gap = log.gaps[0];
    assert!(gap.restarted);
    // Without the restart, the clock would still be 5 s ahead of the host's.
    assert_eq!(gap.clock_shift_us, (AHEAD_US + 2_990_000 - 300_000) as i64);
    let times: Vec<_> = log.scalar(SUPPLY).unwrap().samples.iter().map(|sample| sample.0).collect();
    assert_eq!((times.len(), times[99]), (199, (AHEAD_US + 3_000_000) as f64 / 1e6));
    assert!(times.is_sorted());
    assert!(log.states.last().unwrap().causes.contains(Cause::WatchdogReset), "{:?}", log.states);
    let supply = log.coverage().into_iter().find(|coverage| coverage.channel == SUPPLY).unwrap();
    assert_eq!(supply.missing, Some(0));
}

#[test]
fn another_board_ends_the_recording() {
    let mut link = lost();
    link.greet(2_990_000, 300_050, header().channels[1..].to_vec());
    assert!(matches!(link.tap.failure(), Some(RecordError::OtherBoard)), "{:?}", link.tap.failure());
    assert!(matches!(link.tap.finish(), Err(RecordError::OtherBoard)));
}

#[test]
fn a_session_is_recorded_with_everything_that_was_asked_for() {
    let mut link = Link::open();
    let gains = PidGains { kp: 2.0, ki: 0.5, kd: 0.0 };
    let setpoint = Setpoint { mode: Mode::Position, value: 1.5 };
    let set = Request::Set { channel: OSMC, setpoint, sent_us: AHEAD_US + 3_900, ttl_ms: 100 };
    link.ask(1_000, Request::Subscribe { channel: OSMC, period_ms: 1 });
    link.ask(2_000, Request::Arm);
    link.answer(2_100, Ok(Reply::Done));
    link.ask(3_000, Request::SetGains { channel: OSMC, mode: Mode::Position, gains });
    link.ask(4_000, set);
    link.answer(4_100, Err(Refusal::NotArmed { state: SafetyState::Disarmed }));
    let sample = Sample::Motor {
        channel: OSMC,
        setpoint,
        position: 7,
        speed: 0.5,
        duty: 0.25,
        settled: false,
        homed: true,
        winding: None,
    };
    let telemetry = Telemetry {
        device_us: AHEAD_US + 5_000,
        state: SafetyState::Armed,
        causes: Causes::NONE,
        samples: [sample].into_iter().collect(),
    };
    link.tap.received(5_100, &frame(&ToHost::Telemetry(telemetry)));
    let causes = Causes::only(Cause::HostStop);
    let (device_us, state) = (AHEAD_US + 6_000, SafetyState::Tripped);
    link.tap.received(
        6_100,
        &frame(&ToHost::Heartbeat { host_us: 5_900, device_us, state, causes, hot: Default::default() }),
    );
    // Not recorded: every program asks this anew.
    link.ask(6_200, Request::Fault { index: 0 });
    link.ask(7_000, Request::Bye);
    assert_eq!((link.tap.samples(), link.tap.bad_frames(), link.tap.began_us()), (1, 0, Some(100)));
    let log = link.log();
    let recorded = Recorded { unix_ns: 0, program: "a test".into(), command: "record".into(), clock_offset_ns: None };
    assert_eq!(log.header, r4_log::Header { seed: Some(3), recorded: Some(recorded), ..header() });
    assert_eq!(log.warnings, []);
    let asked: Vec<_> = log.requests.iter().map(|logged| (logged.sent_us, logged.to_string())).collect();
    let expected = [
        (900, "subscribe osmc0 1 ms"),
        (1_900, "arm"),
        (2_900, "set-gains osmc0 position kp 2 ki 0.5 kd 0"),
        (3_900, "set osmc0 position 1.5"),
        (6_900, "bye"),
    ];
    assert_eq!(asked, expected.map(|(sent_us, text)| (Some(sent_us), text.to_owned())));
    let LoggedRequest { time_s, request, .. } = &log.requests[2];
    assert_eq!(*request, Request::SetGains { channel: OSMC, mode: Mode::Position, gains });
    assert_eq!(*time_s, 5.003, "by the board's clock");
    assert_eq!((log.commands.len(), log.commands[0].time_s), (1, 5.0039), "as the set point itself says");
    assert_eq!(log.refusals[0].request, "set osmc0 position 1.5");
    assert!(log.refusals[0].reason.contains("arm it first"), "{}", log.refusals[0].reason);
    let states: Vec<_> = log.states.iter().map(|change| (change.time_s, change.state, change.causes)).collect();
    let none = Causes::NONE;
    assert_eq!(
        states,
        [
            (5.00015, SafetyState::Disarmed, none),
            (5.005, SafetyState::Armed, none),
            (5.006, SafetyState::Tripped, causes)
        ]
    );
    assert_eq!(log.motor(OSMC).unwrap().samples[0].time_s, 5.005);
}

#[test]
fn a_recording_does_not_depend_on_how_the_bytes_come() {
    let (mut whole, mut single) = (Link::open(), Link::open());
    let bytes = frame(&ToHost::Heartbeat {
        host_us: 900,
        device_us: AHEAD_US + 950,
        state: SafetyState::Armed,
        causes: Causes::NONE,
        hot: Default::default(),
    });
    whole.tap.received(1_000, &bytes);
    bytes.iter().for_each(|byte| single.tap.received(1_000, &[*byte]));
    assert_eq!(whole.log(), single.log());
}

#[test]
fn damaged_frames_are_counted_and_the_next_good_one_is_recorded() {
    let mut link = Link::open();
    let state = |device_us, state| ToHost::Heartbeat {
        host_us: 900,
        device_us,
        state,
        causes: Causes::NONE,
        hot: Default::default(),
    };
    let mut damaged = frame(&state(AHEAD_US + 1_000, SafetyState::Tripped));
    damaged[3] ^= 0x55;
    link.tap.received(1_000, &damaged);
    link.tap.received(1_100, &frame(&state(AHEAD_US + 1_100, SafetyState::Armed)));
    assert_eq!(link.tap.bad_frames(), 1);
    let states: Vec<_> = link.log().states.iter().map(|change| change.state).collect();
    assert_eq!(states, [SafetyState::Disarmed, SafetyState::Armed]);
}

#[test]
fn without_a_board_nothing_is_written() {
    let mut link = Link { tap: tap(Wall::Began { unix_ns: 0 }), seq: 0 };
    link.ask(0, Request::Hello { version: VERSION, schema: SCHEMA_HASH });
    link.tap.received(10, b"login: \0\0ATZ\0");
    assert!(link.tap.failure().is_none() && link.tap.finish().unwrap().is_none());
}

#[test]
fn a_full_disk_ends_the_recording_and_says_so() {
    #[derive(Debug)]
    struct Full;
    impl std::io::Write for Full {
        fn write(&mut self, _: &[u8]) -> std::io::Result<usize> {
            Err(std::io::ErrorKind::StorageFull.into())
        }
        fn flush(&mut self) -> std::io::Result<()> {
            Ok(())
        }
    }
    let mut tap = Tap::new(
        Full,
        About {
            board: "tcp:localhost:1".into(),
            seed: None,
            program: "a test".into(),
            command: "record".into(),
            wall: Wall::Began { unix_ns: 0 },
        },
    );
    let info = DeviceInfo {
        robot: "a".try_into().unwrap(),
        firmware: "0.1.0".try_into().unwrap(),
        session: 1,
        channels: 0,
        link_timeout_ms: 200,
        device_us: 0,
        state: SafetyState::Disarmed,
        causes: Causes::NONE,
    };
    let request = Request::Hello { version: VERSION, schema: SCHEMA_HASH };
    tap.sent(0, &frame(&ToDevice::Request { seq: 1, request }));
    tap.received(1, &frame(&ToHost::Response { seq: 1, result: Ok(Reply::Hello(info)) }));
    assert!(tap.failure().is_some());
    let error = tap.finish().unwrap_err().to_string();
    assert!(error.contains("free space"), "{error}");
}
