//! Tests of axes and their bank on drivers that carry out events to the tick and check the requirements of a driver's
//! data sheet.

extern crate std;

use core::f64::consts::TAU;
use std::{collections::VecDeque, vec, vec::Vec};

use proptest::prelude::*;
use r4_protocol::{
    Range,
    config::{HomingConfig, StepperConfig},
};

use super::{
    Bank, NotTaken,
    axis::{Axis, AxisStatus, BACK_OFF, BadStepper, Command, CommandError, Fault},
    steps::DriverTiming,
};
use crate::platform::{StepAction, StepEvent, Steppers};

/// Timing of the slower of DM542T and M542: 5 us about a turn of the direction, 5 ms after enable; 100 kHz.
const DRIVER: DriverTiming =
    DriverTiming { direction_setup_s: 5e-6, direction_hold_s: 5e-6, enable_setup_s: 5e-3, rate_max_hz: 100e3 };
const PERIOD_US: u32 = 1000;
const PERIOD: u64 = 10_000;

/// One driver, with its history.
#[derive(Default)]
struct Driver {
    queue: VecDeque<(u64, StepAction)>,
    direction: bool,
    turned: Option<u64>,
    position: i32,
    /// Tick of each pulse, and whether the direction line was positive.
    pulses: Vec<(u64, bool)>,
    /// Pulses up minus pulses down, including lost ones.
    sum: i64,
}

/// Board with four drivers. Panics on a violation of a driver's data sheet or of [`Steppers`].
struct Board {
    now: u64,
    enabled: Option<u64>,
    drivers: [Driver; 4],
    /// Number of events in a queue: those of 2.5 periods at 100 kHz.
    room: usize,
    /// Index of a pulse to lose; `None` for none.
    loses: Option<usize>,
}

impl Default for Board {
    fn default() -> Self {
        // Starts shortly before the counter wraps, and near the wrap of the positions.
        let driver = || Driver { position: i32::MAX - 3, ..Driver::default() };
        Self {
            now: u64::from(u32::MAX) - 1_234_567,
            enabled: None,
            drivers: [driver(), driver(), driver(), driver()],
            room: 250,
            loses: None,
        }
    }
}

impl Board {
    fn run_to(&mut self, tick: u64) {
        for driver in &mut self.drivers {
            while let Some(&(at, action)) = driver.queue.front().filter(|(at, _)| *at <= tick) {
                driver.queue.pop_front();
                let last = driver.pulses.last().map(|pulse| pulse.0);
                match action {
                    StepAction::Direction(positive) => {
                        // Hold counts from the end of the pulse; the turn may be as late as the interrupt.
                        assert!(last.is_none_or(|last| at >= last + 50 + 50), "hold: {last:?}, turned at {at}");
                        driver.direction = positive;
                        driver.turned = Some(at + u64::from(Self::DIRECTION_LATENCY_TICKS));
                    }
                    StepAction::Pulse => {
                        let enabled = self.enabled.expect("a pulse without enable");
                        assert!(at >= enabled + 50_000, "{} ticks after enable", at - enabled);
                        assert!(driver.turned.is_none_or(|turned| at >= turned + 50), "set-up: pulse at {at}");
                        assert!(last.is_none_or(|last| at >= last + 100), "spacing: {last:?}, {at}");
                        driver.pulses.push((at, driver.direction));
                        driver.sum += if driver.direction { 1 } else { -1 };
                        if self.loses != Some(driver.pulses.len()) {
                            driver.position = driver.position.wrapping_add(if driver.direction { 1 } else { -1 });
                        }
                    }
                }
            }
        }
        self.now = tick;
    }

    /// Pulses up minus pulses down.
    fn sum(&self, axis: usize) -> i64 {
        self.drivers[axis].sum
    }
}

impl Steppers for Board {
    const TICK_HZ: u32 = 10_000_000;
    const PULSE_TICKS: u32 = 50;
    const DIRECTION_LATENCY_TICKS: u32 = 20;

    fn now(&mut self) -> u32 {
        self.now as u32
    }
    fn enable(&mut self, on: bool) {
        self.enabled = on.then_some(self.enabled.unwrap_or(self.now));
        if !on {
            assert!(self.drivers.iter().all(|driver| driver.queue.is_empty()), "pulses would go on without enable");
        }
    }
    fn queue(&mut self, axis: u8, events: &[StepEvent]) -> usize {
        let driver = &mut self.drivers[usize::from(axis)];
        let taken = events.len().min(self.room - driver.queue.len());
        for event in &events[..taken] {
            let ahead = event.at.wrapping_sub(self.now as u32) as i32;
            assert!(ahead > 0, "an event in the past: {ahead}");
            let at = self.now + ahead as u64;
            assert!(driver.queue.back().is_none_or(|last| last.0 <= at), "out of order");
            driver.queue.push_back((at, event.action));
        }
        taken
    }
    fn pending(&mut self, axis: u8) -> u32 {
        self.drivers[usize::from(axis)].queue.len() as u32
    }
    fn position(&mut self, axis: u8) -> i32 {
        self.drivers[usize::from(axis)].position
    }
    fn stop(&mut self, axis: u8) {
        self.drivers[usize::from(axis)].queue.clear();
    }
}

/// Stepper with 16 micro-steps of 1.8 degrees: 509 steps per radian, 51 kHz at full speed.
fn config() -> StepperConfig {
    StepperConfig {
        id: r4_protocol::ChannelId::new(r4_protocol::ChannelKind::Stepper, 0),
        steps_per_turn: 3200,
        inverted: false,
        speed_max: 100.0,
        acceleration: 1000.0,
        jerk: 50_000.0,
        start_speed: 2.0,
        position: Range::new(-300.0, 300.0),
        homing: None,
        stop_brake_ms: 0,
    }
}

fn steps(rad: f32) -> i64 {
    (f64::from(rad) * 3200.0 / TAU).round() as i64
}

struct Rig {
    board: Board,
    axis: Axis,
}

impl Rig {
    fn new(config: StepperConfig) -> Self {
        let mut board = Board::default();
        // Enabled long ago.
        board.enabled = Some(board.now - 1_000_000);
        let axis = Axis::new(0, config, &DRIVER, PERIOD_US, &mut board).expect("a good configuration");
        Self { board, axis }
    }

    /// Runs one period, called `late` ticks after its time.
    fn period(&mut self, late: u64, closed: Option<bool>) -> Result<AxisStatus, Fault> {
        let due = self.board.now + PERIOD;
        self.board.run_to(due + late);
        let result = self.axis.step(closed, &mut self.board);
        self.board.now = due;
        assert_eq!(self.axis.status().speed, self.axis.path_speed());
        result.map(|()| self.axis.status())
    }

    /// Runs until nothing moves, and returns the number of periods.
    fn rest(&mut self) -> u64 {
        for period in 0..20_000 {
            if !self.period(0, None).expect("no fault").moving {
                return period;
            }
        }
        panic!("never at rest: {:?}", self.axis.status());
    }

    fn command(&mut self, command: Command) {
        self.axis.command(command).expect("a good command");
    }

    fn check_books(&self) {
        assert_eq!(i64::from(self.axis.status().position_steps), self.board.sum(0));
    }
}

#[test]
fn a_position_is_reached_in_the_time_of_its_path_and_kept() {
    for jerk in [0.0, 50_000.0] {
        let mut rig = Rig::new(StepperConfig { jerk, ..config() });
        for target in [1.0f32, -20.0, 250.0, 250.002, 0.0] {
            let before = f64::from(rig.axis.status().position_steps);
            rig.command(Command::Position(target));
            let took_s = rig.rest() as f64 * 1e-3;
            assert_eq!(rig.board.sum(0), steps(target));
            assert!(rig.axis.status().settled);
            rig.check_books();
            let way = (steps(target) as f64 - before).abs() * TAU / 3200.0;
            let (v, a) = (100.0, 1000.0);
            let trapezoid_s = if way > v * v / a { way / v + v / a } else { 2.0 * (way / a).sqrt() };
            // The jerk adds a / j = 20 ms with a cruise, and less than 4 (d / 2j)^(1/3) without one; 2 periods are
            // queued ahead, a move begins half a period in, and rest is seen in the next.
            let most_s = if jerk == 0.0 { trapezoid_s } else { trapezoid_s + (4.0 * (way / 1e5).cbrt()).min(0.041) };
            assert!((trapezoid_s - 0.002..most_s + 0.004).contains(&took_s), "{took_s} s, {trapezoid_s} s");
        }
    }
}

#[test]
fn a_move_told_all_at_once_is_under_way_until_its_last_pulse() {
    // Out and back by a step of 1.8 degrees within the first call's 2.5 periods: 0.7 ms per step.
    let mut rig = Rig::new(StepperConfig { steps_per_turn: 200, acceleration: 57e3, jerk: 0.0, ..config() });
    for target in [-1.8f32, 0.0] {
        rig.command(Command::Position(target.to_radians()));
        let first = rig.period(0, None).expect("no fault");
        assert!(first.moving && !first.settled, "{first:?}");
        rig.rest();
        assert_eq!(rig.board.sum(0), libm::roundf(target / 1.8) as i64);
        assert!(rig.axis.status().settled);
    }
}

#[test]
fn an_inverted_axis_turns_the_other_way_and_counts_the_same() {
    let mut rig = Rig::new(StepperConfig { inverted: true, ..config() });
    rig.command(Command::Position(3.0));
    rig.rest();
    assert_eq!(i64::from(rig.axis.status().position_steps), steps(3.0));
    assert_eq!(rig.board.sum(0), -steps(3.0));
}

#[test]
fn a_speed_is_held_and_ends_before_the_end_of_the_range() {
    let mut rig = Rig::new(config());
    rig.command(Command::Speed(20.0));
    for _ in 0..200 {
        rig.period(0, None).expect("no fault");
    }
    assert!((rig.axis.status().speed - 20.0).abs() < 1e-4);
    let pulses = &rig.board.drivers[0].pulses;
    let last = pulses.len() - 1;
    let interval = (pulses[last].0 - pulses[last - 100].0) as f64 / 100.0;
    // One tick in a hundred intervals.
    assert!((interval - 10e6 / (20.0 * 3200.0 / TAU)).abs() < 0.01);
    rig.rest();
    // The range ends at 152 788.7 steps on either side.
    assert_eq!(rig.axis.status().position_steps, 152_788);
    rig.check_books();
    rig.command(Command::Speed(5.0));
    assert_eq!(rig.rest(), 0, "beyond the end there is no way");
    rig.command(Command::Speed(-5.0));
    rig.period(0, None).expect("no fault");
    assert!(rig.period(0, None).expect("no fault").speed < 0.0);
    rig.command(Command::Speed(-100.0));
    rig.rest();
    assert_eq!(rig.axis.status().position_steps, -152_788);
}

#[test]
fn without_ends_only_the_count_of_steps_is_one() {
    let mut rig = Rig::new(StepperConfig { position: Range::new(f32::NEG_INFINITY, f32::INFINITY), ..config() });
    for speed in [-5.0, 20.0, -5.0] {
        rig.command(Command::Speed(speed));
        for _ in 0..100 {
            rig.period(0, None).expect("no fault");
        }
        assert!((rig.axis.status().speed - speed).abs() < 1e-4);
    }
    // 2³¹ steps are 4 216 574 rad.
    for side in [1.0, -1.0] {
        rig.command(Command::Position(side * 4.216e6));
        let refused = rig.axis.command(Command::Position(side * 4.217e6));
        assert!(
            matches!(refused, Err(CommandError::OutOfRange { allowed }) if (4.216e6..4.217e6).contains(&allowed.max))
        );
    }
}

#[test]
fn a_late_loop_moves_no_pulse_and_one_too_late_is_a_fault() {
    let run = |late: &dyn Fn(u64) -> u64| {
        let mut rig = Rig::new(config());
        rig.command(Command::Position(40.0));
        rig.period(0, None).expect("no fault");
        for period in 1..700 {
            rig.period(late(period), None).expect("not too late");
        }
        assert_eq!(rig.board.sum(0), steps(40.0));
        core::mem::take(&mut rig.board.drivers[0].pulses)
    };
    let on_time = run(&|_| 0);
    // Late by up to 0.85 of a period, so that the next call comes as much too early.
    assert_eq!(on_time, run(&|period| period * 7919 % 8500));

    let mut rig = Rig::new(config());
    rig.command(Command::Position(40.0));
    for _ in 0..200 {
        rig.period(0, None).expect("no fault");
    }
    rig.axis.observe(&mut rig.board);
    let late = rig.board.now + 3 * PERIOD;
    rig.board.run_to(late);
    assert_eq!(rig.axis.step(None, &mut rig.board), Err(Fault::Late));
    rig.check_books();
    let status = rig.axis.status();
    assert!(!status.moving && !status.settled);
}

/// Two periods are queued ahead, and pulses an eighth of one before they are due.
#[test]
fn a_loop_is_late_when_an_eighth_of_a_period_is_left() {
    for (late, expected) in [(2 * PERIOD - 1250, Ok(())), (2 * PERIOD - 1249, Err(Fault::Late))] {
        let mut rig = Rig::new(config());
        rig.command(Command::Position(40.0));
        for _ in 0..200 {
            rig.period(0, None).expect("no fault");
        }
        rig.board.run_to(rig.board.now + late);
        assert_eq!(rig.axis.step(None, &mut rig.board), expected);
    }
}

#[test]
fn stopping_at_once_loses_no_step_in_the_books() {
    let mut rig = Rig::new(StepperConfig { homing: Some(HOMING), ..config() });
    home(&mut rig, 20.0, -500..=0).expect("homes");
    rig.command(Command::Position(100.0));
    for _ in 0..150 {
        rig.period(0, None).expect("no fault");
    }
    rig.board.run_to(rig.board.now + 3_333);
    let offset = i64::from(rig.axis.status().position_steps);
    rig.axis.stop_now(&mut rig.board);
    assert!(i64::from(rig.axis.status().position_steps) > offset, "pulses of the last third of a period");
    assert!(!rig.axis.status().homed, "at {} rad/s", 90);
    let before = rig.board.drivers[0].pulses.len();
    for _ in 0..20 {
        assert!(!rig.period(0, None).expect("no fault").moving);
    }
    assert_eq!(rig.board.drivers[0].pulses.len(), before);
    rig.command(Command::Position(-1.0));
    rig.rest();
    assert_eq!(i64::from(rig.axis.status().position_steps), steps(-1.0));
}

#[test]
fn a_slow_stop_at_once_keeps_home() {
    let mut rig = Rig::new(StepperConfig { homing: Some(HOMING), ..config() });
    home(&mut rig, 20.0, -500..=0).expect("homes");
    for (speed, homed) in [(1.9, true), (2.1, false)] {
        rig.command(Command::Speed(speed));
        for _ in 0..100 {
            rig.period(0, None).expect("no fault");
        }
        rig.axis.stop_now(&mut rig.board);
        assert_eq!(rig.axis.status().homed, homed, "{speed}");
    }
    // At rest, for a motor that cannot start at any speed.
    let mut rig = Rig::new(StepperConfig { start_speed: 0.0, homing: Some(HOMING), ..config() });
    home(&mut rig, 20.0, -500..=0).expect("homes");
    for _ in 0..5 {
        rig.period(0, None).expect("no fault");
    }
    rig.axis.stop_now(&mut rig.board);
    assert!(rig.axis.status().homed);
    // A move so short that it is over between two calls, but fast.
    let fast = StepperConfig { acceleration: 1e6, jerk: 0.0, homing: Some(HOMING), ..config() };
    let mut rig = Rig::new(fast);
    home(&mut rig, 15.0, -500..=0).expect("homes");
    for _ in 0..5 {
        rig.period(0, None).expect("no fault");
    }
    let here = f32::from(rig.axis.status().position_steps as i16) * TAU as f32 / 3200.0;
    rig.command(Command::Position(here + 0.1));
    rig.period(0, None).expect("no fault");
    rig.board.run_to(rig.board.now + 6_000);
    rig.axis.stop_now(&mut rig.board);
    assert!(!rig.axis.status().homed);
}

#[test]
fn hardware_that_loses_a_pulse_or_has_no_room_is_noticed() {
    let mut rig = Rig::new(config());
    rig.board.loses = Some(77);
    rig.command(Command::Position(1.0));
    let fault = (0..1000).find_map(|_| rig.period(0, None).err());
    assert_eq!(fault, Some(Fault::Miscounted));
    assert_eq!(i64::from(rig.axis.status().position_steps), steps(1.0) - 1);

    // Moves that end anywhere in a period, with a loop in time and one that is late now and then.
    for (steps_to_go, late) in (8..60).flat_map(|steps_to_go| [(steps_to_go, 0), (steps_to_go, 5000)]) {
        let mut rig = Rig::new(StepperConfig { steps_per_turn: 200, acceleration: 57e3, jerk: 0.0, ..config() });
        rig.board.loses = Some(7);
        rig.command(Command::Position(steps_to_go as f32 * 1.8f32.to_radians()));
        let fault = (0..30).find_map(|period| rig.period(late * (period * 3919 % 100) / 100, None).err());
        assert_eq!(fault, Some(Fault::Miscounted), "{steps_to_go} steps, late by up to {late}");
    }

    let mut rig = Rig::new(config());
    rig.board.room = 20;
    rig.command(Command::Position(100.0));
    let fault = (0..1000).find_map(|_| rig.period(0, None).err());
    assert_eq!(fault, Some(Fault::QueueFull));
    rig.check_books();
}

const HOMING: HomingConfig = HomingConfig { switch: 0, position: -2.0, speed_max: 30.0 };

/// Homes at a switch that is closed within `zone`, steps from where the board's motor began.
fn home(rig: &mut Rig, speed: f32, zone: core::ops::RangeInclusive<i64>) -> Result<(), Fault> {
    rig.command(Command::Home(speed));
    for period in 0..20_000 {
        let closed = zone.contains(&rig.board.sum(0));
        let status = rig.period(0, Some(closed))?;
        if period % 7 == 0 && !status.homed && status.moving {
            rig.command(Command::Home(speed));
        }
        if status.homed && !status.moving {
            return Ok(());
        }
    }
    panic!("never homed: {:?}", rig.axis.status());
}

#[test]
fn homing_finds_the_edge_of_the_switch_from_anywhere() {
    let config = StepperConfig { homing: Some(HOMING), ..config() };
    // From before the switch, from on it, and through short ones that the motor passes: at once, and while it brakes.
    let zones =
        [(20.0, 3000..=9000), (-20.0, -9000..=-3000), (20.0, -100..=2000), (30.0, 3000..=3010), (30.0, 3000..=3100)];
    for (speed, zone) in zones {
        let mut rig = Rig::new(config);
        home(&mut rig, speed, zone.clone()).expect("homes");
        let edge = if speed > 0.0 { *zone.start() } else { *zone.end() };
        let found = rig.board.sum(0) - i64::from(rig.axis.status().position_steps) + steps(HOMING.position);
        // Behind the edge by the travel of backing off in a period, and the step that opens the switch.
        let most = (f64::from(speed.abs()) * BACK_OFF * 3200.0 / TAU * 1e-3).ceil() as i64 + 1;
        assert!((found - edge).abs() <= most, "{found} for {edge}");
    }
}

#[test]
fn homing_without_a_switch_ends_in_rest() {
    let config = StepperConfig { homing: Some(HOMING), position: Range::new(-1.0, 9.0), ..config() };
    let mut rig = Rig::new(config);
    assert_eq!(home(&mut rig, 20.0, 1_000_000..=2_000_000), Err(Fault::SwitchNotFound));
    rig.rest();
    // The distance is 1.25 x 10 rad, two periods of 20 rad/s, and braking: v²/2a + v a/2j = 0.4 rad.
    assert!((steps(12.5)..steps(12.97)).contains(&rig.board.sum(0)), "{}", rig.board.sum(0));
    let mut rig = Rig::new(config);
    assert_eq!(home(&mut rig, 20.0, -1_000_000..=2_000_000), Err(Fault::SwitchNotFound), "stuck");
    rig.rest();
    // The switch closes on the way and stays closed: the distance back counts from there.
    let mut rig = Rig::new(config);
    rig.command(Command::Home(20.0));
    let mut closed = false;
    let fault = (0..20_000).find_map(|_| {
        closed |= rig.board.sum(0) >= 5000;
        rig.period(0, Some(closed)).err()
    });
    assert_eq!(fault, Some(Fault::SwitchNotFound));
    rig.rest();
    // Braking as above, 12.5 rad back, and 0.02 rad from a tenth of the speed.
    let turned = 5000 + steps(0.4);
    let end = rig.board.sum(0);
    assert!((turned - steps(12.6)..turned - steps(12.3)).contains(&end), "{end}");
    let mut rig = Rig::new(config);
    rig.command(Command::Home(20.0));
    assert_eq!(rig.period(0, None), Err(Fault::SwitchUnknown));
    assert!(!rig.axis.status().homed);
}

#[test]
fn bad_commands_are_refused_and_bad_configurations_named() {
    let mut rig = Rig::new(config());
    let range = |range: Range| Err(CommandError::OutOfRange { allowed: range });
    assert_eq!(rig.axis.command(Command::Position(f32::NAN)), Err(CommandError::NotFinite));
    assert_eq!(rig.axis.command(Command::Position(300.1)), range(Range::new(-300.0, 300.0)));
    assert_eq!(rig.axis.command(Command::Speed(-100.1)), range(Range::new(-100.0, 100.0)));
    assert_eq!(rig.axis.command(Command::Home(1.0)), Err(CommandError::NoSwitch));
    assert_eq!(rig.rest(), 0);

    let mut board = Board::default();
    let mut why = |config| Axis::new(0, config, &DRIVER, PERIOD_US, &mut board).err();
    assert_eq!(why(config()), None);
    assert_eq!(why(StepperConfig { steps_per_turn: 0, ..config() }), Some(BadStepper::StepsPerTurn));
    // 100 kHz is 196.35 rad/s.
    assert_eq!(why(StepperConfig { speed_max: 196.34, ..config() }), None);
    assert_eq!(why(StepperConfig { speed_max: 196.36, ..config() }), Some(BadStepper::Speed));
    assert_eq!(why(StepperConfig { acceleration: 0.0, ..config() }), Some(BadStepper::Acceleration));
    assert_eq!(why(StepperConfig { jerk: -1.0, ..config() }), Some(BadStepper::Jerk));
    for (start_speed, expected) in
        [(0.0, None), (-1.0, Some(BadStepper::StartStopSpeed)), (f32::NAN, Some(BadStepper::StartStopSpeed))]
    {
        assert_eq!(why(StepperConfig { start_speed, ..config() }), expected, "{start_speed}");
    }
    // 2³¹ steps are 4 216 574 rad.
    for (min, max, expected) in [
        (1.0, 1.0, None),
        (1.0, 0.0, Some(BadStepper::Position)),
        (f32::NAN, 1.0, Some(BadStepper::Position)),
        (-4.216e6, 4.216e6, None),
        (-4.217e6, 0.0, Some(BadStepper::Position)),
        (0.0, 4.217e6, Some(BadStepper::Position)),
        (f32::NEG_INFINITY, f32::INFINITY, None),
    ] {
        assert_eq!(why(StepperConfig { position: Range::new(min, max), ..config() }), expected, "{min}..{max}");
    }
    for (position, speed_max, expected) in [
        (-2.0, 100.0, None),
        (-2.0, 101.0, Some(BadStepper::Homing)),
        (-2.0, 0.0, Some(BadStepper::Homing)),
        (4.217e6, 30.0, Some(BadStepper::Homing)),
        (f32::NAN, 30.0, Some(BadStepper::Homing)),
    ] {
        let homing = Some(HomingConfig { position, speed_max, ..HOMING });
        assert_eq!(why(StepperConfig { homing, ..config() }), expected, "{position}, {speed_max}");
    }
    let slow = DriverTiming { direction_setup_s: 1e-3, ..DRIVER };
    assert_eq!(Axis::new(0, config(), &slow, PERIOD_US, &mut Board::default()).err(), Some(BadStepper::Timing));
}

/// In f32 the highest rate can exceed itself by a rounding error.
#[test]
fn the_highest_rate_is_a_good_speed_in_any_unit() {
    for steps_per_turn in 200..1000 {
        let why = |speed_max| {
            let config = StepperConfig { steps_per_turn, speed_max, ..config() };
            Axis::new(0, config, &DRIVER, PERIOD_US, &mut Board::default()).err()
        };
        let speed = 100e3 * TAU / f64::from(steps_per_turn);
        assert_eq!(why(speed as f32), None, "{steps_per_turn}");
        assert_eq!(why((speed * (1.0 + 1e-6)) as f32), Some(BadStepper::Speed), "{steps_per_turn}");
    }
}

/// Axes that brake come to rest by their ramps, the others stop at once. The drivers stay enabled, and commands are
/// refused.
#[test]
fn a_stop_that_brakes_ramps_those_that_brake() {
    let mut board = Board::default();
    let configs = [(0, 400), (1, 0)].map(|(index, stop_brake_ms)| StepperConfig {
        id: r4_protocol::ChannelId::new(r4_protocol::ChannelKind::Stepper, index),
        jerk: 0.0,
        stop_brake_ms,
        ..config()
    });
    let mut bank = Bank::new(&configs, &DRIVER, false, false, PERIOD_US, &mut board).expect("good");
    let run = |bank: &mut Bank, board: &mut Board, periods| {
        for _ in 0..periods {
            board.run_to(board.now + PERIOD);
            bank.step(|_| None, board, |index, fault| panic!("stepper {index}: {fault:?}"));
        }
    };
    assert!(!bank.is_armed());
    bank.arm(&mut board);
    assert!(bank.is_armed());
    assert_eq!([0, 1].map(|index| bank.command(index, Command::Speed(30.0))), [Ok(()); 2]);
    run(&mut bank, &mut board, 100);
    bank.brake(&mut board);
    let began = [0, 1].map(|axis| board.sum(axis));
    assert!(!bank.is_armed());
    assert_eq!(bank.command(0, Command::Speed(30.0)), Err(NotTaken::NotArmed));
    run(&mut bank, &mut board, 50);
    // The distance v²/2a is 0.45 rad; two periods of 0.03 rad were queued, and the ramp begins where they end.
    let way = board.sum(0) - began[0];
    assert!((steps(0.45)..=steps(0.45 + 3.0 * 0.03)).contains(&way), "{way}");
    assert_eq!(board.sum(1), began[1]);
    assert!(bank.status().all(|status| !status.moving) && board.enabled.is_some());
}

/// Without the enable a shaft can be turned: its position is known only while the enable holds it.
#[test]
fn a_shaft_that_is_let_go_is_not_where_it_was() {
    for hold in [false, true] {
        let mut board = Board::default();
        let config = StepperConfig { homing: Some(HOMING), ..config() };
        let mut bank = Bank::new(&[config], &DRIVER, false, hold, PERIOD_US, &mut board).expect("good");
        let status = |bank: &Bank| bank.status().next().expect("it has one");
        bank.arm(&mut board);
        assert_eq!(bank.command(0, Command::Home(20.0)), Ok(()));
        for _ in 0..1000 {
            let closed = (-500..=0).contains(&board.sum(0));
            board.run_to(board.now + PERIOD);
            bank.step(|_| Some(closed), &mut board, |_, fault| panic!("{fault:?}"));
        }
        assert!(status(&bank).homed && !status(&bank).moving);
        bank.make_safe(&mut board);
        assert_eq!(status(&bank).homed, hold);
    }
}

#[test]
fn the_bank_wakes_its_drivers_first_and_stops_all_at_once() {
    for hold in [false, true] {
        let mut board = Board::default();
        // So fast that the first pulse comes 0.14 ms after the path begins.
        let configs = [0, 1, 2, 3].map(|index| StepperConfig {
            id: r4_protocol::ChannelId::new(r4_protocol::ChannelKind::Stepper, index),
            acceleration: 1e5,
            jerk: 0.0,
            ..config()
        });
        let mut bank = Bank::new(&configs, &DRIVER, false, hold, PERIOD_US, &mut board).expect("good");
        let no_switch = |_| None;
        let no_fault = |index, fault| panic!("stepper {index}: {fault:?}");
        assert_eq!(bank.command(0, Command::Position(1.0)), Err(NotTaken::NotArmed));
        assert_eq!(bank.command(4, Command::Stop), Err(NotTaken::NoStepper));
        for round in 0..3 {
            let armed_at = board.now;
            bank.arm(&mut board);
            for index in 0..4 {
                bank.command(index, Command::Speed(30.0 + index as f32)).expect("taken");
            }
            for _ in 0..100 {
                board.run_to(board.now + PERIOD);
                bank.step(no_switch, &mut board, no_fault);
            }
            let first = board.drivers[0].pulses.iter().find(|pulse| pulse.0 > armed_at).expect("moves").0 - armed_at;
            // Wake-up time, the period in which its end is seen, half a period ahead, and the first step.
            let wake = if hold && round > 0 { 0 } else { 50_000 };
            assert!((wake.max(PERIOD) + PERIOD / 2..wake + 2 * PERIOD).contains(&first), "{first}");
            board.run_to(board.now + 5_000);
            bank.make_safe(&mut board);
            assert_eq!(board.enabled.is_some(), hold);
            let made: Vec<usize> = board.drivers.iter().map(|driver| driver.pulses.len()).collect();
            for _ in 0..20 {
                board.run_to(board.now + PERIOD);
                bank.step(no_switch, &mut board, no_fault);
            }
            assert_eq!(made, board.drivers.iter().map(|driver| driver.pulses.len()).collect::<Vec<_>>());
            let books: Vec<i64> = bank.status().map(|status| status.position_steps.into()).collect();
            assert_eq!(books, (0..4).map(|axis| board.sum(axis)).collect::<Vec<_>>());
        }
    }
}

#[derive(Clone, Debug)]
enum Act {
    Command(Command),
    StopNow,
    Nothing,
}

fn act() -> impl Strategy<Value = Act> {
    prop_oneof![
        (-300.0..300.0f32).prop_map(|position| Act::Command(Command::Position(position))),
        (-1.0..1.0f32).prop_map(|position| Act::Command(Command::Position(position))),
        (-100.0..100.0f32).prop_map(|speed| Act::Command(Command::Speed(speed))),
        Just(Act::Command(Command::Stop)),
        Just(Act::StopNow),
        Just(Act::Nothing),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(200))]

    /// The fake board checks spacing, set-up, hold, order, and that no event is in the past.
    #[test]
    fn whatever_is_asked_the_drivers_are_treated_well_and_the_books_are_right(
        acts in prop::collection::vec((act(), 1..60usize), 1..30),
        // From 2 to 100 kHz at full speed, and up to 50 million steps/s².
        steps_per_turn in prop::sample::select(vec![200u32, 3200, 6280]),
        acceleration in 1.0..5.0f32,
        jerk in prop_oneof![Just(0.0), 3.0..7.0f32],
        inverted: bool,
        lateness in prop::collection::vec(0u64..8_000, 16),
    ) {
        let jerk = if jerk == 0.0 { 0.0 } else { 10f32.powf(jerk) };
        let acceleration = 10f32.powf(acceleration);
        let mut rig = Rig::new(StepperConfig { steps_per_turn, inverted, acceleration, jerk, ..config() });
        let side = if inverted { -1 } else { 1 };
        let mut late = lateness.into_iter().cycle();
        for (act, periods) in acts {
            match act {
                Act::Command(command) => rig.command(command),
                Act::StopNow => rig.axis.stop_now(&mut rig.board),
                Act::Nothing => {}
            }
            for _ in 0..periods {
                let status = rig.period(late.next().unwrap_or(0), None).expect("no fault");
                prop_assert_eq!(i64::from(status.position_steps), side * rig.board.sum(0));
                prop_assert!(status.speed.abs() <= 100.001);
            }
        }
        rig.command(Command::Position(0.0));
        rig.rest();
        prop_assert_eq!(rig.board.sum(0), 0);
    }
}

proptest! {
    #[test]
    fn whole_numbers_become_the_nearest(whole: u64) {
        prop_assert_eq!(super::numbers::to_f64(whole), whole as f64);
        prop_assert_eq!(super::numbers::to_f64(whole >> 32), (whole >> 32) as f64);
    }
}
