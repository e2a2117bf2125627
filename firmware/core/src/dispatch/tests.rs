//! Set points that are refused, by every output, mode and reason.

extern crate std;

use r4_protocol::{Cycle, CycleChannel, CycleOutcome, CycleState, cycle::NOTHING};
use std::vec::Vec as List;

use super::*;
use crate::{
    shared::{ResetCause, Status},
    testing::{Board, Tasks, board, robot},
};

const LINK: u8 = 1;
const OTHER_LINK: u8 = 2;
const TTL_MS: u16 = 50;
/// Where servos stand in these tests, rad.
const ANGLE: f32 = 0.123;

/// A board with a host.
struct Bench {
    board: Board,
    host: Host,
    tasks: Tasks,
}

impl Bench {
    fn armed() -> Self {
        let board = board(robot("every-interface"), ResetCause::Normal);
        let mut bench = Self { board, host: Host::default(), tasks: Tasks::default() };
        let hello = Request::Hello { version: VERSION, schema: SCHEMA_HASH };
        assert!(matches!(bench.ask(LINK, hello), Ok(Reply::Hello(_))));
        bench.again();
        for (_, place) in board.config().channels().filter(|(_, place)| matches!(place, Place::Servo(_))) {
            board.publish(place, Status::Scalar(ANGLE));
        }
        bench
    }

    /// Disarms and arms: nothing is in force.
    fn again(&mut self) {
        assert_eq!(self.ask(LINK, Request::Disarm), Ok(Reply::Done));
        assert_eq!(self.ask(LINK, Request::Arm), Ok(Reply::Done));
    }

    fn ask(&mut self, link: u8, request: Request) -> Result<Reply, Refusal> {
        match dispatch(self.board, link, &mut self.host, ToDevice::Request { seq: 0, request }) {
            Outcome::Answer(ToHost::Response { result, .. }) => result,
            _ => panic!("answered at once"),
        }
    }

    fn cycle(&mut self, cycle: Cycle) -> CycleState {
        match dispatch(self.board, LINK, &mut self.host, ToDevice::Cycle(cycle)) {
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

    /// What the control loop would take in its next period.
    fn taken(&self, place: Place) -> Option<Setpoint> {
        let epoch = self.board.safety().epoch;
        let brake = match place {
            Place::Bldc(index) => self.board.take_brake(index, epoch),
            _ => None,
        };
        let brake = brake.map(|on| Setpoint { mode: Mode::Brake, value: on.into() });
        self.board.take_command(place, epoch).or(brake)
    }
}

fn now_us() -> u64 {
    Instant::now().as_micros()
}

/// Every output with every set point that is tried on it.
fn outputs(board: Board) -> List<(ChannelId, Place, ModeInfo)> {
    let config = board.config();
    let of = |(channel, place)| modes_of(config, place).into_iter().map(move |mode| (channel, place, mode));
    config.channels().flat_map(of).collect()
}

/// What stops a channel that follows `follows`; `None` for one that is stopped by it.
fn stop(board: Board, place: Place, follows: Setpoint) -> Option<Setpoint> {
    let setpoint = |mode, value| Some(Setpoint { mode, value });
    match (place, follows.mode) {
        (Place::Motor(_) | Place::Stepper(_), Mode::Position | Mode::Speed | Mode::Home) => setpoint(Mode::Speed, 0.0),
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

/// Set points that a channel refuses, with the time between their decision and their arrival, µs.
fn refused(board: Board, place: Place, mode: &ModeInfo) -> List<(Setpoint, i64)> {
    let Range { min, max } = mode.range;
    let setpoint = |value| Setpoint { mode: mode.mode, value };
    let wrong = [f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN, max + 1.0, min - 1.0];
    let mut all: List<_> = wrong.into_iter().map(|value| (setpoint(value), 0)).collect();
    // Just beyond what may be late or early, and far beyond.
    all.extend([51_000, 10_000_000, -51_000, -10_000_000].map(|late_us| (setpoint(max), late_us)));
    let modes = [Mode::Position, Mode::Speed, Mode::Duty, Mode::Switch, Mode::Voltage, Mode::Brake, Mode::Home];
    let known = modes_of(board.config(), place);
    let others = modes.into_iter().filter(|mode| known.iter().all(|info| info.mode != *mode));
    all.extend(others.map(|mode| (Setpoint { mode, value: 0.0 }, 0)));
    if mode.unit == Unit::Bool {
        all.push((setpoint(0.5), 0));
    }
    all
}

/// Whatever an output follows, and for whatever reason a set point is refused: it stops if that one was decided later, and goes
/// on if it was decided before.
#[test]
fn a_refused_set_point_never_leaves_an_older_one_in_force() {
    let mut bench = Bench::armed();
    // Old ones are decided at most so long ago.
    bench.pass_ms(11_000);
    let mut kinds = List::new();
    for (channel, place, follows) in outputs(bench.board) {
        if !kinds.contains(&(channel.kind, follows.mode)) {
            kinds.push((channel.kind, follows.mode));
        }
        let in_force = Setpoint { mode: follows.mode, value: follows.range.max };
        for mode in modes_of(bench.board.config(), place) {
            for (wrong, late_us) in refused(bench.board, place, &mode) {
                for newer in [true, false] {
                    bench.again();
                    // In force since before the other one was decided, or since just after.
                    let decided_us = now_us().saturating_add_signed(-late_us);
                    let ahead_us = decided_us.saturating_sub(now_us());
                    let sent_us = match (newer, late_us > 0) {
                        (true, true) => {
                            // The clock goes only forwards: the later one comes later.
                            assert_eq!(bench.set(LINK, channel, in_force, now_us()), Ok(Reply::Done));
                            bench.pass_ms(late_us as u64 / 1000 + 1);
                            now_us() - late_us as u64
                        }
                        (true, false) => {
                            assert_eq!(bench.set(LINK, channel, in_force, now_us()), Ok(Reply::Done));
                            now_us() + ahead_us
                        }
                        (false, _) => {
                            assert_eq!(bench.set(LINK, channel, in_force, now_us()), Ok(Reply::Done));
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
    // Two modes of a DHB without feedback, of a DAC, ...: every kind of output is there in every mode.
    assert_eq!(kinds.len(), 4 + 1 + 2 + 1 + 3 + 1 + 1, "{kinds:?}");
}

/// The same set point once more, after its time, is no newer one.
#[test]
fn a_duplicate_stops_nothing() {
    let mut bench = Bench::armed();
    for (channel, place, mode) in outputs(bench.board) {
        bench.again();
        let (setpoint, sent_us) = (Setpoint { mode: mode.mode, value: mode.range.max }, now_us());
        assert_eq!(bench.set(LINK, channel, setpoint, sent_us), Ok(Reply::Done));
        bench.pass_ms(60);
        assert_eq!(bench.taken(place), Some(setpoint));
        let late = bench.set(LINK, channel, setpoint, sent_us);
        assert_eq!(late, Err(Refusal::Expired { age_ms: 60, ttl_ms: TTL_MS }));
        assert_eq!(bench.taken(place), None, "{channel}");
    }
}

/// One that was dated ahead does not hide that the next one is newer.
#[test]
fn a_date_ahead_of_the_clock_counts_as_now() {
    let mut bench = Bench::armed();
    let channel = ChannelId::new(r4_protocol::ChannelKind::Osmc, 0);
    let place = place(bench.board, channel).expect("a motor");
    let setpoint = Setpoint { mode: Mode::Duty, value: 0.5 };
    assert_eq!(bench.set(LINK, channel, setpoint, now_us() + 49_000), Ok(Reply::Done));
    bench.pass_ms(1);
    bench.taken(place);
    bench.set(LINK, channel, Setpoint { mode: Mode::Duty, value: 2.0 }, now_us()).expect_err("refused");
    assert_eq!(bench.taken(place), Some(Setpoint::NONE));
}

/// Who has no session moves no channel, and stops none by a refused set point; the whole board it may stop.
#[test]
fn without_a_session_no_channel_is_stopped() {
    let mut bench = Bench::armed();
    for (channel, place, mode) in outputs(bench.board) {
        let setpoint = Setpoint { mode: mode.mode, value: mode.range.max };
        assert_eq!(bench.set(LINK, channel, setpoint, now_us()), Ok(Reply::Done));
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

/// A cycle is refused whole, and stops all its channels, leased or not; those it leaves out go on.
#[test]
fn a_refused_cycle_stops_what_it_has_set_points_for() {
    let mut bench = Bench::armed();
    let channels: [ChannelId; 3] = [
        ChannelId::new(r4_protocol::ChannelKind::Osmc, 0),
        ChannelId::new(r4_protocol::ChannelKind::Stepper, 0),
        ChannelId::new(r4_protocol::ChannelKind::Osmc, 1),
    ];
    let places = channels.map(|channel| place(bench.board, channel).expect("bound"));
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
