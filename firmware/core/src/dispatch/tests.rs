//! Tests of refused set points, for every output, mode and reason.

extern crate std;

use r4_protocol::{
    ChannelId, ChannelInfo, Cycle, CycleChannel, CycleMotor, CycleOutcome, CycleState, ModeInfo, PathPoint, Range,
    SCHEMA_HASH, SafetyState, Setpoint, Unit, VERSION,
    config::{DAC_FULL_SCALE_V, FeedForward, Reverse, Tuning},
    cycle::NOTHING,
};
use std::vec::Vec as List;

use super::*;
use crate::{
    shared::{MotorStatus, ResetCause, Status},
    testing::{Board, Tasks, board, robot},
};

const LINK: u8 = 1;
const OTHER_LINK: u8 = 2;
const TTL_MS: u16 = 50;
/// Initial angle of servos in these tests, rad.
const ANGLE: f32 = 0.123;

/// Board with a host.
struct Bench {
    board: Board,
    host: Host,
    tasks: Tasks,
    seq: u16,
}

impl Bench {
    fn armed() -> Self {
        let board = board(robot("every-interface"), ResetCause::Normal);
        let mut bench = Self { board, host: Host::default(), tasks: Tasks::default(), seq: 0 };
        let hello = Request::Hello { version: VERSION, schema: SCHEMA_HASH };
        assert!(matches!(bench.ask(LINK, hello), Ok(Reply::Hello(_))));
        bench.again();
        for (_, place) in board.config().channels().filter(|(_, place)| matches!(place, Place::Servo(_))) {
            board.publish(place, Status::Scalar(ANGLE));
        }
        bench
    }

    /// Disarms and arms again, so that no set point is in force.
    fn again(&mut self) {
        assert_eq!(self.ask(LINK, Request::Disarm), Ok(Reply::Done));
        assert_eq!(self.ask(LINK, Request::Arm), Ok(Reply::Done));
    }

    fn ask(&mut self, link: u8, request: Request) -> Result<Reply, Refusal> {
        self.seq += 1;
        self.ask_as(self.seq, link, request)
    }

    fn ask_as(&mut self, seq: u16, link: u8, request: Request) -> Result<Reply, Refusal> {
        match dispatch(self.board.as_host(), link, &mut self.host, ToDevice::Request { seq, request }) {
            Outcome::Answer(ToHost::Response { result, .. }) => result,
            _ => panic!("answered at once"),
        }
    }

    fn cycle(&mut self, cycle: Cycle) -> CycleState {
        match dispatch(self.board.as_host(), LINK, &mut self.host, ToDevice::Cycle(cycle)) {
            Outcome::Answer(ToHost::Cycle(state)) => state,
            _ => panic!("answered at once"),
        }
    }

    fn set(&mut self, link: u8, channel: ChannelId, setpoint: Setpoint, sent_us: u64) -> Result<Reply, Refusal> {
        self.ask(link, Request::Set { channel, setpoint, sent_us, ttl_ms: TTL_MS })
    }

    fn pass_ms(&mut self, ms: u64) {
        self.tasks.advance(embassy_time::Duration::from_millis(ms));
    }

    /// Set point that the control loop would take in its next period.
    fn taken(&self, place: Place) -> Option<Setpoint> {
        let epoch = self.board.safety().epoch;
        let brake = match place {
            Place::Bldc(index) => self.board.as_control().take_brake(index, epoch),
            _ => None,
        };
        let brake = brake.map(|on| Setpoint { mode: Mode::Brake, value: on.into() });
        self.board.as_control().take_command(place, epoch).or(brake)
    }
}

fn now_us() -> u64 {
    Instant::now().as_micros()
}

/// All combinations of an output and a mode.
fn outputs(board: Board) -> List<(ChannelId, Place, ModeInfo)> {
    let config = board.config();
    let of = |(channel, place)| modes_of(config, place).into_iter().map(move |mode| (channel, place, mode));
    config.channels().flat_map(of).collect()
}

/// Set point that stops a channel which follows `follows`; `None` if that itself is a stop.
fn stop(board: Board, place: Place, follows: Setpoint) -> Option<Setpoint> {
    let setpoint = |mode, value| Some(Setpoint { mode, value });
    match (place, follows.mode) {
        (Place::Motor(_) | Place::Stepper(_), Mode::Position | Mode::Speed | Mode::Home | Mode::Follow) => {
            setpoint(Mode::Speed, 0.0)
        }
        (Place::Motor(_), Mode::Duty) => setpoint(Mode::Duty, 0.0),
        (Place::Bldc(_), Mode::Duty) => setpoint(Mode::Duty, 0.0),
        (Place::Bldc(_), Mode::Brake) if follows.value == 1.0 => None,
        (Place::Bldc(_), Mode::Brake) => setpoint(Mode::Duty, 0.0),
        (Place::Servo(_), Mode::Position) => setpoint(Mode::Position, ANGLE),
        (Place::Relay(_), Mode::Switch) => setpoint(Mode::Switch, 0.0),
        (Place::Dac(index), Mode::Voltage) => setpoint(Mode::Voltage, board.config().dacs[index].safe_v),
        other => panic!("no output: {other:?}"),
    }
}

/// Set point that is accepted now, and its date: a point of a path is in the future, and within the motor's reach.
fn good(mode: &ModeInfo) -> (Setpoint, u64) {
    match mode.mode {
        Mode::Follow => (Setpoint { mode: mode.mode, value: 0.0 }, now_us() + 500),
        other => (Setpoint { mode: other, value: mode.range.max }, now_us()),
    }
}

/// Set points that a channel refuses, with the time from their decision to their arrival, µs.
fn refused(board: Board, place: Place, mode: &ModeInfo) -> List<(Setpoint, i64)> {
    let Range { min, max } = mode.range;
    let setpoint = |value| Setpoint { mode: mode.mode, value };
    let wrong = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN, max + 1.0, min - 1.0];
    let mut all: List<_> = wrong.into_iter().map(|value| (setpoint(value), 0)).collect();
    // Just beyond the permitted delay and lead, and far beyond.
    all.extend([51_000, 10_000_000, -51_000, -10_000_000].map(|late_us| (setpoint(max), late_us)));
    let modes =
        [Mode::Position, Mode::Speed, Mode::Duty, Mode::Switch, Mode::Voltage, Mode::Brake, Mode::Home, Mode::Follow];
    let known = modes_of(board.config(), place);
    let others = modes.into_iter().filter(|mode| known.iter().all(|info| info.mode != *mode));
    all.extend(others.map(|mode| (Setpoint { mode, value: 0.0 }, 0)));
    if mode.unit == Unit::Bool {
        all.push((setpoint(0.5), 0));
    }
    all
}

/// For any set point in force and any reason of refusal, the output stops if the refused one was decided later, and
/// goes on if it was decided before.
#[test]
fn a_refused_set_point_never_leaves_an_older_one_in_force() {
    let mut bench = Bench::armed();
    // The oldest set points are this old.
    bench.pass_ms(11_000);
    let mut kinds = List::new();
    for (channel, place, follows) in outputs(bench.board) {
        if !kinds.contains(&(channel.kind, follows.mode)) {
            kinds.push((channel.kind, follows.mode));
        }
        let in_force = good(&follows).0;
        for mode in modes_of(bench.board.config(), place) {
            for (wrong, late_us) in refused(bench.board, place, &mode) {
                for newer in [true, false] {
                    bench.again();
                    // In force since before the other one was decided, or since just after.
                    let decided_us = now_us().saturating_add_signed(-late_us);
                    let ahead_us = decided_us.saturating_sub(now_us());
                    let sent_us = match (newer, late_us > 0) {
                        (true, true) => {
                            // The clock only goes forwards: the later one comes later.
                            assert_eq!(bench.set(LINK, channel, in_force, good(&follows).1), Ok(Reply::Done));
                            bench.pass_ms(late_us as u64 / 1000 + 1);
                            now_us() - late_us as u64
                        }
                        (true, false) => {
                            assert_eq!(bench.set(LINK, channel, in_force, good(&follows).1), Ok(Reply::Done));
                            now_us() + ahead_us
                        }
                        (false, _) => {
                            assert_eq!(bench.set(LINK, channel, in_force, good(&follows).1), Ok(Reply::Done));
                            now_us() - 1 - late_us.unsigned_abs()
                        }
                    };
                    assert_eq!(bench.taken(place), Some(in_force));
                    bench.set(LINK, channel, wrong, sent_us).expect_err("refused");
                    let expected = if newer { stop(bench.board, place, in_force) } else { None };
                    let what =
                        format_args!("{channel} follows {in_force:?}: {wrong:?}, {late_us} us late, newer: {newer}");
                    assert_eq!(bench.taken(place), expected, "{what}");
                    assert_eq!(bench.board.safety().state, r4_protocol::SafetyState::Armed, "{what}");
                }
            }
        }
    }
    // Two modes of a DHB without feedback, of a DAC, and so on: every kind of output occurs in every mode.
    assert_eq!(kinds.len(), 5 + 1 + 2 + 1 + 3 + 1 + 1, "{kinds:?}");
}

/// A duplicate of a set point, after its time, does not count as newer.
#[test]
fn a_duplicate_stops_nothing() {
    let mut bench = Bench::armed();
    for (channel, place, mode) in outputs(bench.board) {
        bench.again();
        let (setpoint, sent_us) = good(&mode);
        assert_eq!(bench.set(LINK, channel, setpoint, sent_us), Ok(Reply::Done));
        bench.pass_ms(61);
        assert_eq!(bench.taken(place), Some(setpoint));
        let late = bench.set(LINK, channel, setpoint, sent_us);
        let age_ms = if mode.mode == Mode::Follow { 60 } else { 61 };
        assert_eq!(late, Err(Refusal::Expired { age_ms, ttl_ms: TTL_MS }));
        assert_eq!(bench.taken(place), None, "{channel}");
    }
}

/// A set point that was dated ahead does not hide that the next one is newer.
#[test]
fn a_date_ahead_of_the_clock_counts_as_now() {
    let mut bench = Bench::armed();
    let channel = ChannelId::new(r4_protocol::ChannelKind::Osmc, 0);
    let place = place(bench.board.config(), channel).expect("a motor");
    let setpoint = Setpoint { mode: Mode::Duty, value: 0.5 };
    assert_eq!(bench.set(LINK, channel, setpoint, now_us() + 49_000), Ok(Reply::Done));
    bench.pass_ms(1);
    bench.taken(place);
    bench.set(LINK, channel, Setpoint { mode: Mode::Duty, value: 2.0 }, now_us()).expect_err("refused");
    assert_eq!(bench.taken(place), Some(Setpoint::NONE));
}

/// A link without a session moves no channel, and stops none by a refused set point; it may stop the whole board.
#[test]
fn without_a_session_no_channel_is_stopped() {
    let mut bench = Bench::armed();
    for (channel, place, mode) in outputs(bench.board) {
        let (setpoint, sent_us) = good(&mode);
        assert_eq!(bench.set(LINK, channel, setpoint, sent_us), Ok(Reply::Done));
        bench.taken(place);
        for value in [f32::NAN, f32::MAX, mode.range.max] {
            let wrong = Setpoint { mode: mode.mode, value };
            assert_eq!(bench.set(OTHER_LINK, channel, wrong, now_us()), Err(Refusal::NoSession));
            assert_eq!(bench.taken(place), None, "{channel}");
        }
    }
    assert_eq!(bench.ask(OTHER_LINK, Request::Stop), Ok(Reply::Done));
    assert_eq!(bench.board.safety().state, r4_protocol::SafetyState::Tripped);
}

/// A cycle is refused as a whole, and stops all its channels, leased or not; channels without a set point in it go on.
#[test]
fn a_refused_cycle_stops_what_it_has_set_points_for() {
    let mut bench = Bench::armed();
    let channels: [ChannelId; 3] = [
        ChannelId::new(r4_protocol::ChannelKind::Osmc, 0),
        ChannelId::new(r4_protocol::ChannelKind::Stepper, 0),
        ChannelId::new(r4_protocol::ChannelKind::Osmc, 1),
    ];
    let places = channels.map(|channel| place(bench.board.config(), channel).expect("bound"));
    let bound =
        channels.map(|channel| CycleChannel { channel, mode: Mode::Speed, position_scale: 1e-3, speed_scale: 1e-3 });
    let bind = Request::Bind { channels: bound.into_iter().collect(), ttl_ms: TTL_MS };
    let speed = |value| Setpoint { mode: Mode::Speed, value };
    for (outcome, steps, late_us, mode) in [
        (CycleOutcome::Refused, [5_001, 0, NOTHING, 0], 0, None),
        (CycleOutcome::Refused, [0, 12_001, NOTHING, 0], 0, None),
        (CycleOutcome::Refused, [0, 0, NOTHING, 0], 0, Some(Mode::Brake)),
        (CycleOutcome::Stale, [0, 0, NOTHING, 0], 51_000, None),
        (CycleOutcome::Stale, [0, 0, NOTHING, 0], -51_000, None),
    ] {
        for leased in [true, false] {
            for newer in [true, false] {
                bench.again();
                assert_eq!(bench.ask(LINK, bind.clone()), Ok(Reply::Done));
                let sent_us = now_us();
                if leased {
                    let cycle = Cycle::new(0, None, Some(sent_us), [1000; 4]);
                    assert_eq!(bench.cycle(cycle).outcome(), CycleOutcome::Taken);
                } else {
                    for channel in channels {
                        assert_eq!(bench.set(LINK, channel, speed(1.0), sent_us), Ok(Reply::Done));
                    }
                }
                bench.pass_ms(52);
                assert_eq!(places.map(|place| bench.taken(place)), [Some(speed(1.0)); 3]);
                let date_us = if newer { now_us().saturating_add_signed(-late_us) } else { sent_us - 1 };
                let cycle = Cycle::new(1, mode, Some(date_us), steps);
                let expected = if newer { outcome } else { CycleOutcome::Stale };
                assert_eq!(bench.cycle(cycle).outcome(), expected);
                let stopped = newer.then_some(speed(0.0));
                let taken = places.map(|place| bench.taken(place));
                assert_eq!(taken, [stopped, stopped, None], "{outcome:?} {steps:?} {late_us} {leased} {newer}");
            }
        }
    }
}

fn id(name: &str) -> ChannelId {
    name.parse().expect("a channel")
}

/// Board without a session.
fn alone() -> Bench {
    let board = board(robot("every-interface"), ResetCause::Normal);
    Bench { board, host: Host::default(), tasks: Tasks::default(), seq: 0 }
}

/// The description of each kind of channel has its quantity, unit, rate, resolution and modes.
#[test]
fn every_kind_of_channel_is_described() {
    const TURN: f32 = core::f32::consts::TAU;
    let of = |mode, unit, min, max| ModeInfo { mode, unit, range: Range::new(min, max) };
    let duty = |max: f32| of(Mode::Duty, Unit::Duty, -max, max);
    let off_on = |mode| of(mode, Unit::Bool, 0.0, 1.0);
    let moves = |range: f32, speed: f32| {
        [of(Mode::Position, Unit::Rad, -range, range), of(Mode::Speed, Unit::RadPerS, -speed, speed)]
    };
    let home = of(Mode::Home, Unit::RadPerS, -2.0, 2.0);
    let motor = moves(62.83186, 5.0);
    let follow = ModeInfo { mode: Mode::Follow, ..motor[0] };
    let stepper = moves(20.0, 12.0);
    let servo = |angle: f32| List::from([of(Mode::Position, Unit::Rad, -angle, angle)]);
    let analog = board(robot("every-interface"), ResetCause::Normal).config().analogs[0];
    let turns = (Unit::Rad, Range::symmetric(f32::MAX));
    let volts = |min, max| (Unit::V, Range::new(min, max));
    let bool = (Unit::Bool, Range::new(0.0, 1.0));
    let own = |modes: &List<ModeInfo>| (modes[0].unit, modes[0].range);
    let outputs = [
        ("osmc0", 1000.0, TURN / 2400.0, List::from([motor[0], motor[1], duty(0.902), follow, home])),
        ("osmc1", 1000.0, TURN / 2400.0, List::from([motor[0], motor[1], duty(0.902), follow])),
        ("dhb0", 1000.0, 0.0, List::from([duty(0.95)])),
        ("stepper1", 1000.0, TURN / 1600.0, List::from([stepper[0], stepper[1], home])),
        ("stepper2", 1000.0, TURN / 1600.0, stepper.to_vec()),
        ("servo0", 50.0, 0.0, servo(0.785)),
        ("servo15", 50.0, 0.0, servo(1.571)),
        ("bldc0", 1000.0, 0.0, List::from([duty(1.0), off_on(Mode::Brake)])),
        ("relay1", 1000.0, 0.0, List::from([off_on(Mode::Switch)])),
        ("dac1", 1000.0, 0.0, List::from([of(Mode::Voltage, Unit::V, 0.5, 2.8)])),
    ];
    let inputs = [
        // The relay in the motors' supply is controlled by the firmware alone.
        ("relay0", 1000.0, 0.0, bool),
        ("encoder1", 1000.0, TURN / 2400.0, turns),
        ("switch2", 1000.0, 0.0, bool),
        // Four sensors take turns of 60 ms.
        (
            "range3",
            1e6 / 240_000.0,
            0.0,
            (Unit::M, board(robot("every-interface"), ResetCause::Normal).config().ranges[3].range_m),
        ),
        ("analog1", 1000.0, 0.0, volts(analog.offset_v, analog.offset_v + 65_535.0 * analog.volts_per_code)),
        ("supply1", 1000.0, 0.0, volts(10.0, 15.0)),
        ("dead-man1", 1000.0, 0.0, bool),
    ];
    let outputs =
        outputs.into_iter().map(|(name, rate_hz, resolution, modes)| (name, rate_hz, resolution, own(&modes), modes));
    let inputs =
        inputs.into_iter().map(|(name, rate_hz, resolution, own)| (name, rate_hz, resolution, own, List::new()));
    let mut bench = Bench::armed();
    let count = bench.board.config().channels().count() as u8;
    let mut described = List::new();
    for index in 0..count {
        let Ok(Reply::Channel(info)) = bench.ask(LINK, Request::Describe { index }) else { panic!("channel {index}") };
        described.push(info);
    }
    assert_eq!(bench.ask(LINK, Request::Describe { index: count }), Err(Refusal::NoSuchIndex { index: count }));
    for (name, rate_hz, resolution, (unit, range), modes) in outputs.chain(inputs) {
        let info = described.iter().find(|info| info.id == id(name)).expect(name);
        let expected =
            ChannelInfo { id: id(name), unit, range, rate_hz, resolution, modes: modes.into_iter().collect() };
        assert_eq!(info, &expected);
    }
}

/// Drives that cannot reverse and drives without a brake; a rod that is measured in metres.
#[test]
fn what_an_output_cannot_do_is_not_described() {
    let mut config = robot("every-interface");
    config.bldcs[0].reverse = Reverse::None;
    config.bldcs[1].brake = None;
    let modes = |name: &str| -> List<_> {
        let of = modes_of(&config, config.place(id(name)).expect("it has it"));
        of.into_iter().map(|info| (info.mode, info.range)).collect()
    };
    assert_eq!(modes("bldc0"), [(Mode::Duty, Range::new(0.0, 1.0)), (Mode::Brake, Range::new(0.0, 1.0))]);
    assert_eq!(modes("bldc1"), [(Mode::Duty, Range::new(-1.0, 1.0))]);
    // The converter cannot give the whole range of the device behind it.
    config.dacs[0].range_v = Range::new(-1.0, 5.0);
    let dac = modes_of(&config, Place::Dac(0));
    assert_eq!(dac[0].range, Range::new(0.0, DAC_FULL_SCALE_V));
    let bench = robot("osmc-bench");
    let rod = modes_of(&bench, bench.place(id("actuator1")).expect("it has one"));
    let units: List<_> = rod.iter().map(|info| (info.mode, info.unit)).collect();
    assert_eq!(
        units,
        [(Mode::Position, Unit::M), (Mode::Speed, Unit::MPerS), (Mode::Duty, Unit::Duty), (Mode::Follow, Unit::M)]
    );
}

/// Both ends of each range and of the time are accepted: 50 ms late or early to the ms, but not 51.
#[test]
fn set_points_are_taken_up_to_every_limit() {
    let mut bench = Bench::armed();
    let outputs = outputs(bench.board).into_iter().filter(|(_, _, info)| info.mode != Mode::Follow);
    for (channel, place, ModeInfo { mode, range, .. }) in outputs {
        for value in [range.min, range.max] {
            for late_us in [0, 50_999, -50_999] {
                bench.again();
                let sent_us = now_us().saturating_add_signed(-late_us);
                assert_eq!(bench.set(LINK, channel, Setpoint { mode, value }, sent_us), Ok(Reply::Done), "{channel}");
                assert_eq!(bench.taken(place), Some(Setpoint { mode, value }));
            }
        }
    }
    let duty = Setpoint { mode: Mode::Duty, value: 0.5 };
    let mut late = |late_us: i64| bench.set(LINK, id("osmc0"), duty, now_us().saturating_add_signed(-late_us));
    assert_eq!(late(51_000), Err(Refusal::Expired { age_ms: 51, ttl_ms: TTL_MS }));
    assert_eq!(late(-51_000), Err(Refusal::ClockAhead { ahead_ms: 51 }));
    let home = Setpoint { mode: Mode::Home, value: 0.0 };
    let nowhere = Refusal::OutOfRange { channel: id("osmc0"), asked: 0.0, range: Range::symmetric(2.0) };
    assert_eq!(bench.set(LINK, id("osmc0"), home, now_us()), Err(nowhere));
}

/// In each message that carries points: a set point, a cycle, a message of points.
#[test]
fn points_of_a_path_are_taken_up_to_every_limit() {
    let mut bench = Bench::armed();
    let channel = id("osmc0");
    let Range { max, .. } = modes_of(bench.board.config(), Place::Motor(0))[3].range;
    let mut single = |value, after_us: i64| {
        bench.again();
        let sent_us = now_us().saturating_add_signed(after_us);
        bench.set(LINK, channel, Setpoint { mode: Mode::Follow, value }, sent_us)
    };
    assert_eq!(single(0.0, 1), Ok(Reply::Done));
    assert_eq!(single(0.0, 50_999), Ok(Reply::Done));
    assert_eq!(single(0.0, 51_000), Err(Refusal::ClockAhead { ahead_ms: 51 }));
    assert_eq!(single(0.0, 0), Err(Refusal::Late { late_us: 0 }));
    assert_eq!(single(0.0, -1500), Err(Refusal::Late { late_us: 1500 }));
    // At most 5 rad/s, from the present position.
    assert_eq!(single(0.2, 40_000), Ok(Reply::Done));
    let fast = Refusal::TooFast { channel, asked: 6.25, limit: 5.0 };
    assert_eq!(single(0.25, 40_000), Err(fast));
    let point = |after_us, position| PathPoint { at_us: now_us() + after_us, position, speed: None, feed_forward: 0.0 };
    let mut follow = |channel: &str, points: &[PathPoint]| {
        let points = points.iter().copied().collect();
        bench.ask(LINK, Request::Follow { channel: id(channel), sent_us: now_us(), points })
    };
    assert_eq!(follow("osmc0", &[point(1, 0.0), point(20_000_000, max)]), Ok(Reply::Done));
    let range = Range::symmetric(max);
    let beyond = max.next_up();
    let refused = Refusal::OutOfRange { channel, asked: beyond, range };
    assert_eq!(follow("osmc0", &[point(20_000_000, beyond)]), Err(refused));
    for bad in [f32::NAN, f32::INFINITY] {
        let not_finite = Err(Refusal::NotFinite { channel });
        assert_eq!(follow("osmc0", &[PathPoint { position: bad, ..point(1, 0.0) }]), not_finite);
        assert_eq!(follow("osmc0", &[PathPoint { speed: Some(bad), ..point(1, 0.0) }]), not_finite);
        assert_eq!(follow("osmc0", &[PathPoint { feed_forward: bad, ..point(1, 0.0) }]), not_finite);
    }
    let duties = Range::symmetric(0.902);
    let hard = |feed_forward| [PathPoint { feed_forward, ..point(1, 0.0) }];
    assert_eq!(follow("osmc0", &hard(-0.902)), Ok(Reply::Done));
    let refused = Refusal::OutOfRange { channel, asked: 0.91, range: duties };
    assert_eq!(follow("osmc0", &hard(0.91)), Err(refused));
    assert_eq!(follow("osmc0", &[]), Err(Refusal::BadPath { channel }));
    for channel in ["dhb0", "stepper0", "servo0", "relay1"] {
        let wrong = Refusal::WrongMode { channel: id(channel), mode: Mode::Follow };
        assert_eq!(follow(channel, &[point(1, 0.0)]), Err(wrong));
    }
    bench.ask(LINK, Request::Disarm).expect("taken");
    let points = [point(1, 0.0)].into_iter().collect();
    let refused = bench.ask(LINK, Request::Follow { channel, sent_us: now_us(), points });
    assert_eq!(refused, Err(Refusal::NotArmed { state: r4_protocol::SafetyState::Disarmed }));
}

/// Points of a cycle have its date, and are accepted all or none; they need no lease.
#[test]
fn a_cycle_carries_points_of_paths() {
    let mut bench = Bench::armed();
    let places = [Place::Motor(0), Place::Motor(1)];
    let channels = ["osmc0", "osmc1"].map(|name| CycleChannel {
        channel: id(name),
        mode: Mode::Follow,
        position_scale: 1e-3,
        speed_scale: 1e-3,
    });
    let bind = Request::Bind { channels: channels.into_iter().collect(), ttl_ms: TTL_MS };
    assert_eq!(bench.ask(LINK, bind), Ok(Reply::Done));
    let stopped = [Some(Setpoint { mode: Mode::Speed, value: 0.0 }); 2];
    for (outcome, steps, after_us) in [
        (CycleOutcome::Taken, [100, -100], Some(40_000)),
        // Points that are too fast, late, too far ahead, or without a date.
        (CycleOutcome::Refused, [100, 5000], Some(40_000)),
        (CycleOutcome::Stale, [0, 0], Some(0)),
        (CycleOutcome::Stale, [0, 0], Some(51_000)),
        (CycleOutcome::Stale, [0, 0], None),
    ] {
        bench.again();
        let sent_us = after_us.map(|after_us| now_us() + after_us);
        let good = Cycle::new(1, None, Some(now_us() + 1000), [0, 0, NOTHING, NOTHING]);
        assert_eq!(bench.cycle(good).outcome(), CycleOutcome::Taken);
        let _ = places.map(|place| bench.taken(place));
        bench.pass_ms(2);
        let sent_us = sent_us.map(|sent_us| sent_us + 2000);
        let cycle = Cycle::new(2, None, sent_us, [steps[0], steps[1], NOTHING, NOTHING]);
        assert_eq!(bench.cycle(cycle).outcome(), outcome, "{steps:?} {after_us:?}");
        let taken = places.map(|place| bench.taken(place));
        if outcome == CycleOutcome::Taken {
            assert_eq!(taken, [0.1, -0.1].map(|value| Some(Setpoint { mode: Mode::Follow, value })));
            bench.pass_ms(500);
            bench.board.as_control().end_leases(Instant::now());
            assert_eq!(places.map(|place| bench.taken(place)), [None; 2], "a path ends by itself");
        } else {
            assert_eq!(taken, stopped, "{steps:?} {after_us:?}");
        }
    }
}

/// The request may have been a newer set point, of a kind that this board does not know.
#[test]
fn a_request_of_a_later_version_is_refused_and_ends_what_is_in_force() {
    let mut bench = Bench::armed();
    let unknown = |bench: &Bench, link| unknown(bench.board.as_host(), link, 9, Instant::now());
    let refused = ToHost::Response { seq: 9, result: Err(Refusal::UnknownMessage) };
    let runs = Setpoint { mode: Mode::Speed, value: 0.5 };
    bench.set(LINK, id("osmc0"), runs, now_us()).expect("taken");
    assert_eq!(bench.taken(Place::Motor(0)), Some(runs));
    bench.pass_ms(2);
    // A link without a session commands nothing, and ends nothing.
    assert_eq!(unknown(&bench, OTHER_LINK), refused);
    assert_eq!(bench.taken(Place::Motor(0)), None, "nothing new");
    assert_eq!(unknown(&bench, LINK), refused);
    assert_eq!(bench.taken(Place::Motor(0)), Some(Setpoint { mode: Mode::Speed, value: 0.0 }));
    assert_eq!(bench.board.report().stats().refused, 2);
}

/// Before a greeting a board reports its version, ends nothing, and stops; it answers nothing else, neither now nor
/// later.
#[test]
fn without_a_greeting_a_board_only_stops() {
    let mut bench = alone();
    for request in
        [Request::Stats, Request::Arm, Request::SaveParameters, Request::Image, Request::UartRead { port: 0 }]
    {
        assert_eq!(bench.ask(LINK, request), Err(Refusal::NoSession));
    }
    assert_eq!(bench.ask(LINK, Request::Bye), Ok(Reply::Done));
    for (version, schema) in [(VERSION + 1, SCHEMA_HASH), (VERSION, SCHEMA_HASH ^ 1)] {
        let refused = bench.ask(LINK, Request::Hello { version, schema });
        assert_eq!(refused, Err(Refusal::ProtocolMismatch { version: VERSION, schema: SCHEMA_HASH }));
    }
    let Ok(Reply::Hello(info)) = bench.ask(LINK, Request::Hello { version: VERSION, schema: SCHEMA_HASH }) else {
        panic!("greeted")
    };
    let config = bench.board.config();
    assert_eq!((info.robot.as_str(), info.link_timeout_ms), ("every-interface", 200));
    assert_eq!(usize::from(info.channels), config.channels().count());
    assert_eq!((info.firmware.as_str(), info.device_us), (FIRMWARE_VERSION, now_us()));
    assert_eq!((info.state, info.causes), (r4_protocol::SafetyState::Disarmed, r4_protocol::Causes::NONE));
    assert_eq!(bench.board.report().stats().refused, 7);
    assert_eq!(bench.ask(LINK, Request::Stats), Ok(Reply::Stats(bench.board.report().stats())));
    // A heartbeat is answered to the host that has the session, and to no other.
    let mut beat = |link, session| {
        let heartbeat = ToDevice::Heartbeat { session, host_us: 7 };
        match dispatch(bench.board.as_host(), link, &mut bench.host, heartbeat) {
            Outcome::Answer(ToHost::Heartbeat { host_us, device_us, .. }) => Some((host_us, device_us)),
            _ => None,
        }
    };
    assert_eq!(beat(LINK, info.session), Some((7, now_us())));
    assert_eq!((beat(LINK, info.session + 1), beat(OTHER_LINK, info.session)), (None, None));
}

#[test]
fn a_host_stops_clears_and_arms() {
    let mut bench = Bench::armed();
    for (request, state) in [
        (Request::Stop, r4_protocol::SafetyState::Tripped),
        (Request::Clear, r4_protocol::SafetyState::Disarmed),
        (Request::Arm, r4_protocol::SafetyState::Armed),
        (Request::Disarm, r4_protocol::SafetyState::Disarmed),
    ] {
        assert_eq!(bench.ask(LINK, request), Ok(Reply::Done));
        assert_eq!(bench.board.safety().state, state);
    }
}

/// Requests that wait for flash or a connector are answered later; impossible ones are refused without waiting.
#[test]
fn what_takes_time_is_answered_later() {
    let mut bench = Bench::armed();
    let raw = || core::iter::empty().collect();
    for request in [
        Request::SaveParameters,
        Request::Fault { index: 0 },
        Request::FaultSnapshot { index: 0, snapshot: 0 },
        Request::I2cTransfer { bus: 0, address: 0x20, write: raw(), read: 1 },
        Request::UartWrite { port: 0, bytes: raw() },
        Request::UartRead { port: 0 },
    ] {
        let message = ToDevice::Request { seq: 3, request: request.clone() };
        match dispatch(bench.board.as_host(), LINK, &mut bench.host, message) {
            Outcome::Later { seq: 3, request: later } => assert_eq!(later, request),
            _ => panic!("{request:?} is put off"),
        }
        assert_eq!(bench.ask(OTHER_LINK, request), Err(Refusal::NoSession));
    }
    // A sector may have to be erased.
    let saved = embassy_futures::block_on(carry_out(bench.board.as_host(), 4, Request::SaveParameters));
    let armed = Refusal::NotWhile { state: r4_protocol::SafetyState::Armed };
    assert_eq!(saved, ToHost::Response { seq: 4, result: Err(armed) });
}

/// Gains are refused from another link, for another mode, for a channel without a loop, or if not finite.
#[test]
fn gains_are_taken_for_the_loops_of_motors() {
    let mut bench = Bench::armed();
    let gains = r4_protocol::config::PidGains { kp: 1.5, ki: 0.0, kd: 0.0 };
    let set = |channel: &str, mode, gains| Request::SetGains { channel: id(channel), mode, gains };
    for mode in [Mode::Position, Mode::Speed] {
        assert_eq!(bench.ask(LINK, set("osmc2", mode, gains)), Ok(Reply::Done));
        assert_eq!(bench.board.as_control().take_gains(), Some((2, mode, gains)));
    }
    for (channel, mode) in [
        ("osmc2", Mode::Duty),
        ("osmc0", Mode::Home),
        ("dhb0", Mode::Speed),
        ("stepper0", Mode::Speed),
        ("servo0", Mode::Position),
    ] {
        let wrong = Refusal::WrongMode { channel: id(channel), mode };
        assert_eq!(bench.ask(LINK, set(channel, mode, gains)), Err(wrong));
    }
    let bad = r4_protocol::config::PidGains { kp: f32::NAN, ..gains };
    assert_eq!(bench.ask(LINK, set("osmc0", Mode::Speed, bad)), Err(Refusal::BadGains { channel: id("osmc0") }));
    assert_eq!(
        bench.ask(LINK, set("osmc7", Mode::Speed, gains)),
        Err(Refusal::UnknownChannel { channel: id("osmc7") })
    );
    assert_eq!(bench.board.as_control().take_gains(), None);
}

/// A tuning is accepted for a motor with loops, within the rules of its configuration.
#[test]
fn a_tuning_is_taken_for_a_motor_with_loops() {
    let mut bench = Bench::armed();
    let feed_forward = FeedForward { static_duty: 0.25, duty_per_speed: 0.5, duty_per_acceleration: 0.0 };
    let good = Tuning { feed_forward, cascade_per_s: 8.0 };
    let set = |channel: &str, tuning| Request::SetTuning { channel: id(channel), tuning };
    assert_eq!(bench.ask(LINK, set("osmc2", good)), Ok(Reply::Done));
    assert_eq!(bench.board.as_control().take_tuning(), Some((2, good)));
    for channel in ["dhb0", "stepper0", "servo0"] {
        let wrong = Refusal::WrongMode { channel: id(channel), mode: Mode::Position };
        assert_eq!(bench.ask(LINK, set(channel, good)), Err(wrong));
    }
    for bad in [
        Tuning { cascade_per_s: -1.0, ..good },
        Tuning { cascade_per_s: f32::NAN, ..good },
        Tuning { feed_forward: FeedForward { static_duty: 1.0, ..feed_forward }, ..good },
        Tuning { feed_forward: FeedForward { duty_per_speed: f32::INFINITY, ..feed_forward }, ..good },
        Tuning { feed_forward: FeedForward { duty_per_acceleration: -0.1, ..feed_forward }, ..good },
    ] {
        assert_eq!(bench.ask(LINK, set("osmc2", bad)), Err(Refusal::BadGains { channel: id("osmc2") }));
    }
    assert_eq!(bench.board.as_control().take_tuning(), None);
}

/// Changed parameters take effect at the next start; until then they are reported beside the active ones.
#[test]
fn parameters_are_changed_for_the_next_start() {
    let mut bench = Bench::armed();
    let count = bench.board.config().parameters().count() as u16;
    let end = Refusal::NoSuchIndex { index: u8::try_from(count).unwrap_or(u8::MAX) };
    assert_eq!(bench.ask(LINK, Request::DescribeParameter { index: count }), Err(end));
    let describe = |bench: &mut Bench, index| match bench.ask(LINK, Request::DescribeParameter { index }) {
        Ok(Reply::Parameter(info)) => info,
        other => panic!("{other:?}"),
    };
    let index =
        (0..count).find(|index| describe(&mut bench, *index).key.parameter == r4_protocol::Parameter::LinkTimeoutMs);
    let index = index.expect("every board has it");
    let before = describe(&mut bench, index);
    assert_eq!((before.active, before.set, before.built_in), (200.0, 200.0, 200.0));
    assert_eq!(bench.ask(LINK, Request::SetParameter { key: before.key, value: 300.0 }), Ok(Reply::Done));
    let after = describe(&mut bench, index);
    assert_eq!((after.active, after.set, after.built_in), (200.0, 300.0, 200.0));
    let bad = Refusal::BadParameter { key: before.key, value: -1.0 };
    assert_eq!(bench.ask(LINK, Request::SetParameter { key: before.key, value: -1.0 }), Err(bad));
    let key = r4_protocol::ParameterKey { channel: Some(id("osmc7")), parameter: r4_protocol::Parameter::DutyMax };
    let unknown = Refusal::UnknownParameter { key };
    assert_eq!(bench.ask(LINK, Request::SetParameter { key, value: 0.5 }), Err(unknown));
    let robot = String::try_from("renamed").expect("short");
    assert_eq!(bench.ask(LINK, Request::SetName { robot }), Ok(Reply::Done));
    let pending = bench.board.as_host().pending();
    assert_eq!((pending.robot.as_str(), pending.link_timeout_ms), ("renamed", 300));
    assert_eq!(bench.ask(LINK, Request::ResetParameters), Ok(Reply::Done));
    assert_eq!(&bench.board.as_host().pending(), bench.board.as_host().built_in());
}

/// Subscriptions, bound channels and the log end with the session, at its end and where another begins.
#[test]
fn what_a_host_asked_for_ends_with_its_session() {
    for last in [Request::Bye, Request::Hello { version: VERSION, schema: SCHEMA_HASH }] {
        let mut bench = Bench::armed();
        let unknown = Request::Subscribe { channel: id("osmc7"), period_ms: 10 };
        assert_eq!(bench.ask(LINK, unknown), Err(Refusal::UnknownChannel { channel: id("osmc7") }));
        assert_eq!(bench.host.subscriptions.next_due(), Instant::MAX);
        assert_eq!(bench.ask(LINK, Request::Subscribe { channel: id("osmc0"), period_ms: 10 }), Ok(Reply::Done));
        assert_ne!(bench.host.subscriptions.next_due(), Instant::MAX);
        let channel = CycleChannel { channel: id("osmc0"), mode: Mode::Duty, position_scale: 1e-3, speed_scale: 1e-3 };
        let bind = Request::Bind { channels: [channel].into_iter().collect(), ttl_ms: TTL_MS };
        assert_eq!(bench.ask(LINK, bind), Ok(Reply::Done));
        let cycle = |bench: &mut Bench| bench.cycle(Cycle::new(0, None, None, [NOTHING; 4])).outcome();
        assert_eq!(cycle(&mut bench), CycleOutcome::Taken);
        assert!(bench.ask(LINK, last).is_ok());
        assert_eq!(bench.host.subscriptions.next_due(), Instant::MAX);
        assert_eq!([0; 2].map(|_| cycle(&mut bench)), [CycleOutcome::Unbound; 2]);
        assert_eq!(bench.board.report().stats().cycles_refused, 2);
    }
}

/// A board sends its log to hosts that ask for it, with the fingerprint of the image whose ELF decodes it.
#[test]
fn a_log_is_begun_and_ended() {
    let mut bench = Bench::armed();
    assert_eq!(bench.ask(LINK, Request::Log { on: true }), Err(Refusal::NoLog));
    let ring: &'static crate::log::Ring = std::boxed::Box::leak(std::boxed::Box::default());
    let config = robot("every-interface");
    let board = crate::shared::Shared::new(config.clone(), config, ResetCause::Normal);
    let board: Board = std::boxed::Box::leak(std::boxed::Box::new(board.with_log(crate::log::Log { ring, image: 5 })));
    let mut bench = Bench { board, ..alone() };
    assert!(bench.ask(LINK, Request::Hello { version: VERSION, schema: SCHEMA_HASH }).is_ok());
    for (on, due) in [(true, Instant::now()), (false, Instant::MAX)] {
        assert_eq!(bench.ask(LINK, Request::Log { on }), Ok(Reply::Log(LogInfo { image: 5 })));
        assert_eq!(bench.host.log.next_due(), due);
    }
}

/// Restarts are requested by their kind; the image is described where there is one.
#[test]
fn a_restart_is_passed_on() {
    let mut bench = Bench::armed();
    let armed = Refusal::NotWhile { state: r4_protocol::SafetyState::Armed };
    assert_eq!(bench.ask(LINK, Request::Restart), Err(armed));
    assert_eq!(bench.ask(LINK, Request::Disarm), Ok(Reply::Done));
    assert_eq!(bench.ask(LINK, Request::Bootloader), Err(Refusal::NoBootloader));
    assert_eq!(bench.ask(LINK, Request::Image), Err(Refusal::NoImage));
    assert_eq!(bench.ask(LINK, Request::Restart), Ok(Reply::Done));
    assert_eq!(embassy_futures::block_on(bench.board.restart_requested()), Restart::Firmware);
}

/// Bound channels are answered with their state, by each channel's own scales.
#[test]
fn a_cycle_answers_what_its_channels_do() {
    let mut bench = Bench::armed();
    let of = |name, mode| CycleChannel { channel: id(name), mode, position_scale: 1e-3, speed_scale: 0.5 };
    let bind =
        |channels: &[CycleChannel]| Request::Bind { channels: channels.iter().copied().collect(), ttl_ms: TTL_MS };
    for (name, mode) in
        [("servo0", Mode::Position), ("osmc0", Mode::Home), ("dhb0", Mode::Speed), ("relay1", Mode::Switch)]
    {
        let refused = Refusal::WrongMode { channel: id(name), mode };
        assert_eq!(bench.ask(LINK, bind(&[of(name, mode)])), Err(refused));
    }
    let twice = [of("osmc0", Mode::Duty), of("osmc1", Mode::Duty), of("osmc0", Mode::Speed)];
    assert_eq!(bench.ask(LINK, bind(&twice)), Err(Refusal::BadBinding { channel: id("osmc0") }));
    let unscaled = CycleChannel { speed_scale: 0.0, ..of("osmc0", Mode::Duty) };
    assert_eq!(bench.ask(LINK, bind(&[unscaled])), Err(Refusal::BadBinding { channel: id("osmc0") }));
    let unknown = Refusal::UnknownChannel { channel: id("osmc7") };
    assert_eq!(bench.ask(LINK, bind(&[of("osmc7", Mode::Duty)])), Err(unknown));

    let channels = [of("osmc1", Mode::Position), of("bldc2", Mode::Duty), of("stepper3", Mode::Speed)];
    assert_eq!(bench.ask(LINK, bind(&channels)), Ok(Reply::Done));
    let places = channels.map(|channel| place(bench.board.config(), channel.channel).expect("bound"));
    let status = MotorStatus { position: -77, speed: 2.0, duty: -1.0, settled: true, ..MotorStatus::IDLE };
    bench.board.publish(places[0], Status::Motor(status));
    bench.board.publish(places[1], Status::Scalar(0.5));
    let sent_us = now_us() - 10_000;
    let state = bench.cycle(Cycle::new(9, None, Some(sent_us), [500, 16_384, 4, NOTHING]));
    assert_eq!((state.seq, state.outcome()), (9, CycleOutcome::Taken));
    let [motor, drive, stepper, none] = state.motors();
    let moving = |position, speed, duty, settled| CycleMotor { position, speed, duty, settled };
    assert_eq!(motor, moving(-77, 4, -32_767, true));
    assert_eq!(drive, moving(0, NOTHING, 16_384, false));
    assert_eq!((stepper, none), (moving(0, 0, 0, false), CycleMotor::NONE));
    let expected = [
        Setpoint { mode: Mode::Position, value: 0.5 },
        Setpoint { mode: Mode::Duty, value: 16_384.0 / 32_767.0 },
        Setpoint { mode: Mode::Speed, value: 2.0 },
    ];
    assert_eq!(places.map(|place| bench.taken(place)), expected.map(Some));
    // The set points are followed for the rest of their time, and then stopped.
    bench.board.as_control().end_leases(Instant::from_micros(sent_us + 50_000));
    assert_eq!(places.map(|place| bench.taken(place)), [None; 3]);
    bench.board.as_control().end_leases(Instant::from_micros(sent_us + 50_001));
    let rest = Setpoint { mode: Mode::Speed, value: 0.0 };
    assert_eq!(places.map(|place| bench.taken(place)), [Some(rest), Some(Setpoint::NONE), Some(rest)]);
    // Limits to the µs, in both directions.
    for (late_us, outcome) in [
        (50_000, CycleOutcome::Taken),
        (50_001, CycleOutcome::Stale),
        (-50_000, CycleOutcome::Taken),
        (-50_001, CycleOutcome::Stale),
    ] {
        bench.again();
        let sent_us = now_us().saturating_add_signed(-late_us);
        let state = bench.cycle(Cycle::new(1, None, Some(sent_us), [0, NOTHING, NOTHING, NOTHING]));
        assert_eq!(state.outcome(), outcome, "{late_us} us");
    }
    // Another link has no session, whatever it has bound.
    let mut other = Host::default();
    assert_eq!(other.bound.bind(bench.board.as_host(), &channels, TTL_MS), Ok(()));
    let cycle = ToDevice::Cycle(Cycle::new(1, None, None, [0; 4]));
    let Outcome::Answer(ToHost::Cycle(state)) = dispatch(bench.board.as_host(), OTHER_LINK, &mut other, cycle) else {
        panic!("answered at once")
    };
    assert_eq!(state.outcome(), CycleOutcome::Unbound);
}

/// A duplicate of a frame, after its time, stops nothing; a refused one of the same date does.
#[test]
fn a_cycle_that_comes_twice_stops_nothing() {
    for (wait_ms, set, outcome, stopped) in
        [(60, 1000, CycleOutcome::Stale, false), (0, 32_000, CycleOutcome::Refused, true)]
    {
        let mut bench = Bench::armed();
        let channel = CycleChannel { channel: id("osmc0"), mode: Mode::Speed, position_scale: 1e-3, speed_scale: 1e-3 };
        let bind = Request::Bind { channels: [channel].into_iter().collect(), ttl_ms: TTL_MS };
        assert_eq!(bench.ask(LINK, bind), Ok(Reply::Done));
        let sent_us = now_us();
        let speed = |value| Setpoint { mode: Mode::Speed, value };
        assert_eq!(bench.set(LINK, id("osmc0"), speed(1.0), sent_us), Ok(Reply::Done));
        bench.pass_ms(wait_ms);
        assert_eq!(bench.taken(Place::Motor(0)), Some(speed(1.0)));
        let cycle = Cycle::new(0, None, Some(sent_us), [set, NOTHING, NOTHING, NOTHING]);
        assert_eq!(bench.cycle(cycle).outcome(), outcome);
        assert_eq!(bench.taken(Place::Motor(0)), stopped.then_some(speed(0.0)));
    }
}

/// A request is carried out once, however often it is sent, and whatever the board's state is by then.
#[test]
fn a_request_that_is_sent_again_is_answered_and_not_done_again() {
    let mut bench = Bench::armed();
    assert_eq!(bench.ask_as(1000, LINK, Request::Disarm), Ok(Reply::Done));
    assert_eq!(bench.ask_as(1001, LINK, Request::Arm), Ok(Reply::Done));
    assert_eq!(bench.ask_as(1002, LINK, Request::Disarm), Ok(Reply::Done));
    let state = |bench: &Bench| bench.board.safety().state;
    assert_eq!(bench.ask_as(1001, LINK, Request::Arm), Ok(Reply::Done));
    assert_eq!(state(&bench), SafetyState::Disarmed);
    // A repeated refusal is answered alike.
    bench.board.trip(r4_protocol::Cause::HostStop);
    let refused = bench.ask_as(1003, LINK, Request::Arm);
    assert!(matches!(refused, Err(Refusal::Tripped { .. })), "{refused:?}");
    assert_eq!(bench.ask_as(1004, LINK, Request::Clear), Ok(Reply::Done));
    assert_eq!(bench.ask_as(1003, LINK, Request::Arm), refused);
    assert_eq!(state(&bench), SafetyState::Disarmed);
    bench.board.trip(r4_protocol::Cause::HostStop);
    assert_eq!(bench.ask_as(1004, LINK, Request::Clear), Ok(Reply::Done));
    assert_eq!(state(&bench), SafetyState::Tripped);
    // A set point behind a newer one, sent twice.
    assert_eq!(bench.ask_as(1010, LINK, Request::Clear), Ok(Reply::Done));
    assert_eq!(bench.ask_as(1011, LINK, Request::Arm), Ok(Reply::Done));
    let channel = "osmc0".parse().expect("a channel");
    let place = bench.board.config().place(channel).expect("it has one");
    let duty = |value| {
        let (setpoint, sent_us) = (Setpoint { mode: Mode::Duty, value }, Instant::now().as_micros());
        Request::Set { channel, setpoint, sent_us, ttl_ms: TTL_MS }
    };
    for (seq, value, taken) in [(1012, 0.1, Some(0.1)), (1013, 0.2, Some(0.2)), (1012, 0.1, None)] {
        assert_eq!(bench.ask_as(seq, LINK, duty(value)), Ok(Reply::Done));
        assert_eq!(bench.taken(place).map(|setpoint| setpoint.value), taken, "{seq}");
    }
    bench.board.trip(r4_protocol::Cause::HostStop);
    // With a new sequence number it is another request.
    assert_eq!(bench.ask_as(1005, LINK, Request::Clear), Ok(Reply::Done));
    assert_eq!(bench.ask_as(1006, LINK, Request::Arm), Ok(Reply::Done));
    assert_eq!(state(&bench), SafetyState::Armed);
}

/// For hosts that do not count, a sequence number refers to the last request that used it.
#[test]
fn a_number_that_is_used_for_something_else_is_no_repeat() {
    let mut bench = Bench::armed();
    for _ in 0..3 {
        assert_eq!(bench.ask_as(7, LINK, Request::Disarm), Ok(Reply::Done));
        assert_eq!(bench.board.safety().state, SafetyState::Disarmed);
        assert_eq!(bench.ask_as(7, LINK, Request::Arm), Ok(Reply::Done));
        assert_eq!(bench.board.safety().state, SafetyState::Armed);
    }
}

/// Nothing is remembered from another session, nor in a session of a version without repeats.
#[test]
fn each_session_begins_with_nothing_remembered() {
    let mut bench = Bench::armed();
    let old = r4_protocol::version::SPOKEN[2];
    assert_eq!(old.version, 12);
    for spoken in [r4_protocol::version::SPOKEN[0], old] {
        let Spoken { version, schema } = spoken;
        assert!(matches!(bench.ask_as(1, LINK, Request::Hello { version, schema }), Ok(Reply::Hello(_))));
        assert_eq!(bench.ask_as(2, LINK, Request::Arm), Ok(Reply::Done));
        assert_eq!(bench.ask_as(3, LINK, Request::Disarm), Ok(Reply::Done));
    }
    assert_eq!(bench.ask_as(2, LINK, Request::Arm), Ok(Reply::Done));
    assert_eq!(bench.board.safety().state, SafetyState::Armed);
}
