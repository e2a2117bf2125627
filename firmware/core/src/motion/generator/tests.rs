//! Tests of the generator against an independent timer model: shadow registers, periods, and the resulting pulses.

extern crate std;

use std::vec::Vec;

use proptest::prelude::*;

use super::*;
use crate::{
    motion::{
        scurve::{Limits, Motion, Path},
        steps::{DriverTiming, Pulses, TickTiming},
    },
    platform::Steppers,
};

const ROOM: usize = 512;
/// Control period of 1 ms at 10 MHz.
const CONTROL: u64 = 10_000;

/// Timer in PWM mode 1 with preloaded registers, and the clock beside it; both wrap.
#[derive(Debug)]
struct Hardware {
    /// Ticks since the start, and the clock's value at the start.
    time: u64,
    clock_at_start: u32,
    /// Ticks by which the timer was started after the clock.
    skew: u64,
    /// Start of the present period by the timer's own time, its length and kind, and the preloaded ones.
    begin: u64,
    active: (u32, bool),
    preloaded: (u32, bool),
    line: bool,
    /// Pulses with their direction, turns of the line, and writes to the timer, each with its time.
    pulses: Vec<(u64, bool)>,
    turns: Vec<(u64, bool)>,
    loads: Vec<u64>,
    /// Duration of a read of the clock, ticks.
    slowness: u64,
}

impl Hardware {
    fn new(clock_at_start: u32, skew: u64, slowness: u64) -> Self {
        let idle = (IDLE, false);
        Self {
            time: 1000,
            clock_at_start,
            skew,
            begin: 0,
            active: idle,
            preloaded: idle,
            line: true,
            pulses: Vec::new(),
            turns: Vec::new(),
            loads: Vec::new(),
            slowness,
        }
    }

    fn run_to(&mut self, time: u64) {
        self.time = self.time.max(time);
        while self.begin + u64::from(self.active.0) + self.skew <= self.time {
            self.begin += u64::from(self.active.0);
            self.active = self.preloaded;
            if self.active.1 {
                self.pulses.push((self.begin, self.line));
            }
        }
    }

    fn clock(&self) -> u32 {
        self.clock_at_start.wrapping_add(self.time as u32)
    }

    /// Time at which the clock shows the nearby value `tick`.
    fn time_of(&self, tick: u32) -> u64 {
        self.time.saturating_add_signed(until(tick, self.clock()).into())
    }

    /// Number of pulses begun by the clock's present time: the timer, started later, may still be about to make the
    /// last.
    fn position(&mut self) -> i32 {
        let time = self.time;
        self.run_to(time + self.skew);
        let begun = self.pulses.iter().filter(|(begin, _)| *begin <= time);
        begun.map(|(_, positive)| if *positive { 1 } else { -1 }).sum()
    }
}

impl StepTimer for Hardware {
    fn now(&mut self) -> u32 {
        let clock = self.clock();
        self.run_to(self.time + self.slowness);
        clock
    }

    fn preload(&mut self, ticks: u32, pulse: bool) {
        assert!((SHORTEST..=LONGEST).contains(&ticks), "a period of {ticks}");
        self.preloaded = (ticks, pulse);
        self.loads.push(self.time);
    }

    fn turn(&mut self, positive: bool) {
        self.line = positive;
        self.turns.push((self.time, positive));
    }
}

/// Generator on its hardware, served by interrupts up to `latency` ticks late.
#[derive(Debug)]
struct Rig {
    generator: Generator<ROOM>,
    hardware: Hardware,
    wake: u64,
    latency: Vec<u64>,
    served: usize,
}

impl Rig {
    fn new(clock_at_start: u32, skew: u64, slowness: u64, latency: Vec<u64>) -> Self {
        let hardware = Hardware::new(clock_at_start, skew, slowness);
        Self { generator: Generator::new(clock_at_start), hardware, wake: 0, latency, served: 0 }
    }

    /// Runs the interrupt, which does not end while something is due.
    fn serve(&mut self) {
        loop {
            let wake = self.generator.serve(&mut self.hardware);
            self.wake = self.hardware.time_of(wake);
            self.served += 1;
            if self.wake > self.hardware.time {
                break;
            }
        }
    }

    /// Runs interrupts until `time`.
    fn run_to(&mut self, time: u64) {
        loop {
            let at = self.wake + self.latency[self.served % self.latency.len()];
            if at >= time {
                break self.hardware.run_to(time);
            }
            self.hardware.run_to(at);
            self.serve();
        }
    }

    /// Queues events, given by their time.
    fn tell(&mut self, events: &[(u64, StepAction)]) -> usize {
        let at = |time: u64| self.hardware.clock_at_start.wrapping_add(time as u32);
        let events: Vec<_> = events.iter().map(|(time, action)| StepEvent { at: at(*time), action: *action }).collect();
        let taken = self.generator.queue(&events);
        self.serve();
        taken
    }

    fn pending(&mut self) -> u32 {
        let now = self.hardware.clock();
        self.generator.pending(now)
    }

    fn position(&mut self) -> i32 {
        let now = self.hardware.clock();
        self.generator.position(now)
    }
}

/// Events from gaps between pulses; a change of direction lies in the middle of its gap.
fn events(first: u64, gaps: &[(u64, bool)]) -> Vec<(u64, StepAction)> {
    let (mut time, mut line, mut events) = (first, true, Vec::new());
    for (gap, positive) in gaps {
        // The pulse's 40 ticks and hold before the turn, set-up and latency behind.
        let gap = if *positive == line { *gap } else { (*gap).max(250) };
        if *positive != line {
            events.push((time + gap / 2, StepAction::Direction(*positive)));
            line = *positive;
        }
        time += gap;
        events.push((time, StepAction::Pulse));
    }
    events
}

fn pulses_of(events: &[(u64, StepAction)]) -> Vec<u64> {
    events.iter().filter(|(_, action)| *action == StepAction::Pulse).map(|(time, _)| *time).collect()
}

/// Runs of pulses of one direction: number, first gap, and increment per gap.
fn gaps() -> impl Strategy<Value = Vec<(u64, bool)>> {
    let first = prop_oneof![Just(100u64), 100..1100u64, 1000..3000u64, 60_000..150_000u64];
    let run = (1..60u64, first, -20..20i64, any::<bool>(), 0..3u64);
    prop::collection::vec(run, 1..12).prop_map(|runs| {
        let gap = |first: u64, by: i64, jitter: u64, index: u64| {
            (first.saturating_add_signed(by * index as i64) + jitter * (index * 7 % 5)).max(100)
        };
        let one = |(count, first, by, positive, jitter)| {
            (0..count).map(move |index| (gap(first, by, jitter, index), positive))
        };
        runs.into_iter().flat_map(one).collect()
    })
}

/// Longest interrupt latency without effect: the time left in the shortest period, less reads of the clock and of the
/// hardware's position.
const LATENCY: u64 = (SHORTEST - 2 * AFTER - BEFORE) as u64 - 6;

fn rig() -> impl Strategy<Value = Rig> {
    (any::<u32>(), 0..u64::from(AFTER), 1..3u64, prop::collection::vec(0..=LATENCY, 1..9))
        .prop_map(|(clock, skew, slowness, latency)| Rig::new(clock, skew, slowness, latency))
}

/// Queues events one control period at a time, `ahead` of it, calls `look` after each, and lets them be made.
fn tell_all(
    rig: &mut Rig,
    events: &[(u64, StepAction)],
    ahead: u64,
    mut look: impl FnMut(&mut Rig) -> Result<(), TestCaseError>,
) -> Result<(), TestCaseError> {
    let last = events.last().map_or(0, |(time, _)| *time);
    let (mut told, mut now) = (0, 2 * CONTROL - ahead);
    while now < last + CONTROL {
        rig.run_to(now);
        let count = events[told..].iter().take_while(|(time, _)| *time < now + ahead + CONTROL).count();
        prop_assert_eq!(rig.tell(&events[told..told + count]), count);
        told += count;
        look(rig)?;
        now += CONTROL;
    }
    rig.run_to(last + 3 * CONTROL);
    Ok(())
}

/// Checks that the queued pulses are made, in time; `gaps` contain the directions.
fn check(rig: &mut Rig, events: &[(u64, StepAction)], gaps: &[(u64, bool)]) -> Result<(), TestCaseError> {
    let ideal = pulses_of(events);
    prop_assert_eq!(rig.hardware.pulses.len(), ideal.len());
    for ((made, positive), (ideal, (_, told))) in rig.hardware.pulses.iter().zip(ideal.iter().zip(gaps)) {
        prop_assert_eq!(positive, told);
        prop_assert!(made.abs_diff(*ideal) <= ERROR.into(), "{made} for {ideal}");
    }
    prop_assert!(rig.hardware.pulses.windows(2).all(|pair| pair[1].0 - pair[0].0 >= SHORTEST.into()));
    Ok(())
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(400))]

    #[test]
    fn every_pulse_is_made_once_in_order_and_in_time(
        mut rig in rig(), gaps in gaps(), ahead in u64::from(LEAD)..CONTROL,
    ) {
        let events = events(2 * CONTROL, &gaps);
        tell_all(&mut rig, &events, ahead, |rig| {
            prop_assert_eq!(rig.position(), rig.hardware.position());
            let begun = rig.position();
            let pending = rig.pending();
            prop_assert!(pending > 0 || begun == rig.hardware.position());
            Ok(())
        })?;
        check(&mut rig, &events, &gaps)?;
        prop_assert_eq!(rig.pending(), 0);
        prop_assert_eq!(rig.position(), rig.hardware.position());
    }

    /// Pulses of one direction may come early or late; the first after a turn and the last before one must not be off
    /// towards the turn.
    #[test]
    fn the_line_turns_where_it_was_told_between_the_same_pulses(mut rig in rig(), gaps in gaps()) {
        let events = events(2 * CONTROL, &gaps);
        tell_all(&mut rig, &events, CONTROL / 2, |_| Ok(()))?;
        let told: Vec<_> = events.iter().filter_map(|(time, action)| match action {
            StepAction::Direction(positive) => Some((*time, *positive)),
            StepAction::Pulse => None,
        }).collect();
        prop_assert_eq!(rig.hardware.turns.len(), told.len());
        for ((made, positive), (time, told)) in rig.hardware.turns.iter().zip(&told) {
            prop_assert_eq!(positive, told);
            // Latency of the interrupt, and reads of the clock in it and in the one before.
            prop_assert!((*time..=time + LATENCY + 8).contains(made), "{made} for {time}");
        }
        let changes = |index: usize| index == gaps.len() || gaps[index].1 != (index == 0 || gaps[index - 1].1);
        for (index, ((made, _), ideal)) in rig.hardware.pulses.iter().zip(pulses_of(&events)).enumerate() {
            prop_assert!(!changes(index) || *made == ideal, "first after a turn at {made}, not {ideal}");
            prop_assert!(!changes(index + 1) || *made <= ideal, "last before a turn at {made}, not {ideal}");
        }
    }

    #[test]
    fn a_stop_at_any_moment_is_final(
        mut rig in rig(), gaps in gaps(), ahead in u64::from(LEAD)..CONTROL, moment in 0.0..1.0f64, after in 0..3000u64,
        turns: bool,
    ) {
        let events = events(2 * CONTROL, &gaps);
        let last = events.last().map_or(0, |(time, _)| *time);
        let moment = 2 * CONTROL - ahead + ((last + 500 + ahead - 2 * CONTROL) as f64 * moment) as u64;
        let (mut told, mut now) = (0, 2 * CONTROL - ahead);
        while now < moment {
            rig.run_to(now);
            let count = events[told..].iter().take_while(|(time, _)| *time < now + ahead + CONTROL).count();
            rig.tell(&events[told..told + count]);
            told += count;
            now += CONTROL;
        }
        rig.run_to(moment);
        let began = rig.hardware.time;
        rig.generator.stop(&mut rig.hardware);
        let took = rig.hardware.time - began;
        // Near a boundary, plus two reads of up to 2 ticks.
        prop_assert!(took <= u64::from(AFTER + BEFORE) + 4, "{took} ticks");
        let (position, line) = (rig.position(), rig.hardware.line);
        prop_assert_eq!(rig.pending(), 0);
        prop_assert_eq!(position, rig.hardware.position());
        rig.serve();
        let stopped = rig.hardware.time;
        rig.run_to(stopped + after);
        prop_assert_eq!(rig.hardware.position(), position);
        prop_assert_eq!(rig.hardware.line, line);
        prop_assert_eq!(rig.position(), position);
        // It continues from there, in either direction.
        let made = rig.hardware.pulses.len();
        let first = rig.hardware.time + u64::from(LEAD);
        let way = if turns { !line } else { line };
        let turn = turns.then_some((first - 100, StepAction::Direction(way)));
        let more: Vec<_> = turn.into_iter().chain((0..20).map(|index| (first + index * 150, StepAction::Pulse))).collect();
        rig.tell(&more);
        rig.run_to(first + 20 * 150 + 2000);
        prop_assert_eq!(rig.position(), position + if way { 20 } else { -20 });
        for (index, (time, positive)) in rig.hardware.pulses[made..].iter().enumerate() {
            prop_assert_eq!(*positive, way);
            prop_assert!(time.abs_diff(first + index as u64 * 150) <= ERROR.into());
        }
    }

    /// A load that is late by most of the shortest period adds no pulse: the repeated pulse was due, since it lies at
    /// the end of a stretch, and behind the last there is an idle period.
    #[test]
    fn a_pulse_made_again_stands_for_the_next(
        mut rig in rig(), gap in 100..1000u64, count in 1..400u64,
        latency in prop::collection::vec(0..LATENCY + u64::from(SHORTEST - AFTER - BEFORE) - 4, 1..9),
    ) {
        rig.latency = latency;
        let gaps: Vec<_> = (0..count).map(|_| (gap, true)).collect();
        let events = events(2 * CONTROL, &gaps);
        tell_all(&mut rig, &events, CONTROL / 2, |_| Ok(()))?;
        prop_assert_eq!(rig.hardware.pulses.len() as u64, count);
        prop_assert_eq!((rig.pending(), rig.position()), (0, count as i32));
        for ((made, _), ideal) in rig.hardware.pulses.iter().zip(pulses_of(&events)) {
            prop_assert!(made.abs_diff(ideal) <= (2 * SHORTEST + LONGEST).into(), "{made} for {ideal}");
        }
    }

    /// With interrupts that come much too late the count stays true, and nothing comes faster than the driver allows.
    #[test]
    fn late_interrupts_spoil_no_count(
        mut rig in rig(), gaps in gaps(), latency in prop::collection::vec(0..2000u64, 1..9), slowness in 1..u64::from(BEFORE),
        one_way: bool,
    ) {
        rig.latency = latency;
        // Short enough that a write after the last read is in time.
        rig.hardware.slowness = slowness;
        let gaps: Vec<_> = gaps.into_iter().map(|(gap, positive)| (gap, positive || one_way)).collect();
        let events = events(2 * CONTROL, &gaps);
        tell_all(&mut rig, &events, CONTROL / 2, |rig| {
            // Where the line turns, a pulse can come before the interrupt that turns it.
            prop_assert!(!one_way || rig.position() == rig.hardware.position());
            Ok(())
        })?;
        rig.run_to(rig.hardware.time + 100 * CONTROL);
        prop_assert_eq!(rig.pending(), 0);
        prop_assert!(rig.hardware.pulses.windows(2).all(|pair| pair[1].0 - pair[0].0 >= SHORTEST.into()));
        prop_assert!(!one_way || rig.position() == rig.hardware.position());
    }

    /// At the carrier's highest rate and with the steepest ramps that steppers can follow, any path takes less than
    /// 20 000 loads per second.
    #[test]
    fn fast_pulses_need_few_interrupts(
        mut rig in rig(), speed in 20e3..100e3f64, acceleration in 1e4..1e7f64, jerk_time_s in prop_oneof![Just(0.0), 1e-3..0.1f64],
    ) {
        const WITHIN: u64 = 10_000;
        let driver = DriverTiming {
            direction_setup_s: 5e-6, direction_hold_s: 5e-6, enable_setup_s: 5e-3, rate_max_hz: 100e3,
        };
        let timing = TickTiming::new::<Ticks>(&driver).expect("the carrier's");
        let limits = Limits { speed, acceleration, jerk: acceleration / jerk_time_s };
        let path = Path::to_speed(Motion::rest(0), speed, &limits);
        let ticks = ((path.duration_s() + 5e-3) * 10e6) as u64;
        let mut pulses = Pulses::new(timing);
        let mut events = Vec::new();
        pulses.along(&path, 2 * CONTROL, 0, ticks.min(3_000_000), |event| events.push((event.at.into(), event.action)));
        tell_all(&mut rig, &events, CONTROL / 2, |_| Ok(()))?;
        prop_assert_eq!(rig.hardware.pulses.len() as i64, pulses.made());
        let loads = &rig.hardware.loads;
        let most = (0..loads.len()).map(|first| {
            loads[first..].iter().take_while(|load| **load < loads[first] + WITHIN).count()
        }).max();
        prop_assert!(most <= Some(20), "{most:?} loads in a millisecond");
        for (made, ideal) in rig.hardware.pulses.iter().zip(pulses_of(&events)) {
            prop_assert!(made.0.abs_diff(ideal) <= ERROR.into());
        }
    }
}

#[test]
fn a_full_queue_takes_what_fits() {
    let mut rig = Rig::new(u32::MAX - 5000, 0, 1, std::vec![0]);
    let events: Vec<_> = (0..ROOM as u64 + 100).map(|index| (20_000 + 200 * index, StepAction::Pulse)).collect();
    assert_eq!(rig.tell(&events[..ROOM - 1]), ROOM - 1);
    assert_eq!(rig.tell(&events[ROOM - 1..]), 1);
    assert_eq!(rig.pending() as usize, ROOM);
    rig.run_to(20_000 + 200 * 2 * ROOM as u64);
    assert_eq!((rig.pending(), rig.position()), (0, ROOM as i32));
}

/// At the highest rate each interrupt loads the following stretch of 16 pulses, and no more.
#[test]
fn an_interrupt_serves_sixteen_pulses() {
    let mut rig = Rig::new(u32::MAX - 5000, 3, 1, std::vec![0]);
    let events: Vec<_> = (0..8000).map(|index| (2 * CONTROL + 100 * index, StepAction::Pulse)).collect();
    let mut told = 0;
    let all_told = tell_all(&mut rig, &events, CONTROL / 2, |_| {
        told += 1;
        Ok(())
    });
    assert!(all_told.is_ok());
    assert_eq!(rig.position(), 8000);
    let loads: Vec<_> = rig.hardware.loads.iter().filter(|load| **load >= 2 * CONTROL).collect();
    let most = loads.windows(2).map(|pair| (pair[1] - pair[0]) / 100).max();
    assert_eq!(most, Some(MOST.into()), "how long an interrupt takes is bounded");
    let served = rig.served - told;
    assert!(served <= 8000 / 16 * 11 / 10, "{served} interrupts");
}

/// Stops at each tick of two periods, with the latest timer start and the slowest writes that the generator allows for.
#[test]
fn a_stop_at_any_tick_counts_what_is_made() {
    for (skew, slowness) in
        [(0, 1), (u64::from(AFTER) - 1, 1), (0, BEFORE.into()), (u64::from(AFTER) - 1, BEFORE.into())]
    {
        for moment in 0..300 {
            let mut rig = Rig::new(u32::MAX - 5000, skew, slowness, std::vec![0]);
            let events: Vec<_> = (0..40).map(|index| (20_000 + 150 * index, StepAction::Pulse)).collect();
            rig.tell(&events);
            rig.run_to(22_000 + moment);
            rig.generator.stop(&mut rig.hardware);
            let position = rig.position();
            assert!((10..20).contains(&position), "{position}");
            rig.serve();
            rig.run_to(40_000);
            assert_eq!((rig.hardware.position(), rig.position()), (position, position), "{moment}, {skew}, {slowness}");
        }
    }
}

#[test]
fn nothing_to_do_needs_no_interrupts() {
    let mut rig = Rig::new(0, 3, 1, std::vec![0]);
    rig.tell(&[(20_000, StepAction::Direction(false)), (21_000, StepAction::Pulse)]);
    rig.run_to(30_000);
    let served = rig.served;
    // Services: when queued, when the wait begins, for the turn, for the pulse, and for what follows it.
    assert!(served <= 5, "{served}");
    // A minute, in which the clock does not even wrap.
    rig.run_to(600_000_000);
    assert_eq!(rig.served, served);
    assert_eq!((rig.position(), rig.hardware.position()), (-1, -1));
}

/// Clock and pulse length of the board.
struct Ticks;

impl Steppers for Ticks {
    const TICK_HZ: u32 = 10_000_000;
    const PULSE_TICKS: u32 = 40;
    const DIRECTION_LATENCY_TICKS: u32 = 100;

    fn now(&mut self) -> u32 {
        0
    }
    fn enable(&mut self, _: bool) {}
    fn queue(&mut self, _: u8, _: &[StepEvent]) -> usize {
        0
    }
    fn pending(&mut self, _: u8) -> u32 {
        0
    }
    fn position(&mut self, _: u8) -> i32 {
        0
    }
    fn stop(&mut self, _: u8) {}
}
