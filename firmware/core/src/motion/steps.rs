//! Pulse times of a path.
//!
//! A pulse is due when the path passes the middle between two steps, so that the position of the pulses made is always
//! the step nearest to the path. Each moment is solved from the path's own polynomials and rounded to a tick: no error
//! adds up.

use super::{
    numbers::to_f64,
    scurve::{Path, Piece},
};
use crate::{
    platform::{StepAction, StepEvent, Steppers},
    root::sqrt,
};

/// Timing requirements of a driver's lines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DriverTiming {
    /// Set-up time of the direction before the active edge of a pulse, s.
    pub direction_setup_s: f32,
    /// Hold time of the direction after the end of a pulse, s.
    pub direction_hold_s: f32,
    /// Time from enable to the first pulse, s.
    pub enable_setup_s: f32,
    /// Highest pulse rate, Hz.
    pub rate_max_hz: f32,
}

/// [`DriverTiming`] in ticks, each rounded to the safe side.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct TickTiming {
    pub(super) tick_hz: u32,
    /// Shortest time from pulse to pulse, ticks.
    pub(super) spacing: u32,
    /// Time from turning the direction line to the pulse, ticks.
    pub(super) turn_to_pulse: u32,
    /// Time from the start of a pulse to turning the direction line, ticks.
    pub(super) pulse_to_turn: u32,
    /// Time from enable to the first pulse, ticks.
    pub(super) enable: u32,
}

impl TickTiming {
    /// Converts `driver` to ticks of a board's clock. `None` if a time is negative, longer than the clock counts, or
    /// not a number, or if pulses at the highest rate would run into each other.
    #[must_use]
    pub fn new<H: Steppers>(driver: &DriverTiming) -> Option<Self> {
        let ticks = |time_s: f64| {
            let ticks = libm::ceil(time_s * f64::from(H::TICK_HZ) - 1e-3);
            // The limit is half the counter's range, which distinguishes before from after.
            (0.0..f64::from(i32::MAX)).contains(&ticks).then_some(ticks as u32)
        };
        let turn = ticks(driver.direction_setup_s.into())?;
        let hold = ticks(driver.direction_hold_s.into())?;
        let spacing = ticks(1.0 / f64::from(driver.rate_max_hz))?;
        (spacing > H::PULSE_TICKS).then_some(())?;
        Some(Self {
            tick_hz: H::TICK_HZ,
            spacing,
            turn_to_pulse: turn.checked_add(H::DIRECTION_LATENCY_TICKS)?,
            pulse_to_turn: hold.checked_add(H::PULSE_TICKS)?,
            enable: ticks(driver.enable_setup_s.into())?,
        })
    }

    /// Highest rate, steps/s: an integer number of ticks from pulse to pulse.
    #[must_use]
    pub fn rate_max_hz(&self) -> f64 {
        f64::from(self.tick_hz) / f64::from(self.spacing)
    }
}

/// Pulses of one axis along its paths.
///
/// They are within half a tick of the path, and later only where two pulses of opposite direction are closer than the
/// direction line allows: a path that reverses just beyond the middle between two steps.
#[derive(Clone, Debug)]
pub struct Pulses {
    timing: TickTiming,
    /// Position after all pulses emitted so far, steps.
    made: i64,
    /// State of the direction line after them; `None` when unknown.
    direction: Option<bool>,
    last_tick: Option<u64>,
}

impl Pulses {
    /// Creates the state at position 0 with no pulse made.
    #[must_use]
    pub fn new(timing: TickTiming) -> Self {
        Self { timing, made: 0, direction: None, last_tick: None }
    }

    /// Position after all pulses emitted so far, steps.
    #[must_use]
    pub fn made(&self) -> i64 {
        self.made
    }

    /// Shifts the numbering of positions by `by` steps.
    pub fn shift(&mut self, by: i64) {
        self.made = self.made.wrapping_add(by);
    }

    /// Restarts at the motor's position: emitted pulses may not have been made, the last of them not after `tick`.
    pub fn reset(&mut self, position: i64, tick: u64) {
        *self = Self { timing: self.timing, made: position, direction: None, last_tick: Some(tick) };
    }

    /// Emits the events of a path in the time interval `from..to`, ticks after the path's start at tick `start`, in
    /// order. Successive calls must have adjacent intervals.
    ///
    /// The direction line turns as late as permitted, [`TickTiming`]'s time before the pulse, which can be before
    /// `from`.
    pub fn along(&mut self, path: &Path, start: u64, from: u64, to: u64, mut emit: impl FnMut(StepEvent)) {
        let tick_hz = f64::from(self.timing.tick_hz);
        let from_ticks = to_f64(from);
        let (from_s, to_s) = (from_ticks / tick_hz, to_f64(to) / tick_hz);
        let pieces = path.pieces();
        let ends = pieces.iter().skip(1).map(|next| next.start_s).chain([f64::INFINITY]);
        for (piece, end_s) in pieces.iter().zip(ends).take_while(|(piece, _)| piece.start_s < to_s) {
            let (low, high) = (from_s.max(piece.start_s) - piece.start_s, to_s.min(end_s) - piece.start_s);
            if high <= low {
                continue;
            }
            // Never before `from`; the nearest tick, by a conversion that the processor has an instruction for.
            let to_tick =
                |time_s: f64| start + from + u64::from(((piece.start_s + time_s) * tick_hz - from_ticks + 0.5) as u32);
            let mut part = low;
            if may_turn(piece, low, high) {
                for turn in turns(piece).into_iter().filter(|turn| (low..high).contains(turn)) {
                    self.along_one_way(piece, part, turn, to_tick, &mut emit);
                    part = turn;
                }
            }
            self.along_one_way(piece, part, high, to_tick, &mut emit);
        }
    }

    /// Emits the events of a part of a piece in which the speed keeps its sign.
    fn along_one_way(
        &mut self,
        piece: &Piece,
        mut low: f64,
        high: f64,
        to_tick: impl Fn(f64) -> u64,
        emit: &mut impl FnMut(StepEvent),
    ) {
        let ((first, speed), (last, _)) = (piece.distance_and_speed(low), piece.distance_and_speed(high));
        let side = if last > first { 1.0 } else { -1.0 };
        let mut line = piece.start.position.distance_to(self.made) + side / 2.0;
        // First guess by the initial speed; afterwards by the duration of the last step.
        let mut guess = low + (line - first) / speed;
        while side * (last - line) > 0.0 {
            let time_s = passing(piece, line, side, (low, high), guess, SOLVED_TICKS / f64::from(self.timing.tick_hz));
            self.pulse(side > 0.0, to_tick(time_s), emit);
            guess = time_s + (time_s - low);
            low = time_s;
            line += side;
        }
    }

    fn pulse(&mut self, positive: bool, due: u64, emit: &mut impl FnMut(StepEvent)) {
        let TickTiming { spacing, turn_to_pulse, pulse_to_turn, .. } = self.timing;
        let turns = self.direction != Some(positive);
        let apart = if turns { spacing.max(pulse_to_turn + turn_to_pulse) } else { spacing };
        let tick = self.last_tick.map_or(due, |last| due.max(last + u64::from(apart)));
        if turns {
            let turn = tick.saturating_sub(turn_to_pulse.into());
            emit(StepEvent { at: turn as u32, action: StepAction::Direction(positive) });
        }
        emit(StepEvent { at: tick as u32, action: StepAction::Pulse });
        self.direction = Some(positive);
        self.last_tick = Some(tick);
        self.made = self.made.wrapping_add(if positive { 1 } else { -1 });
    }
}

/// Accuracy to which the moment of a step is solved before it is rounded, ticks.
const SOLVED_TICKS: f64 = 0.05;

/// Returns true if a piece's speed may change its sign between two times. It does not where it rises or falls
/// monotonically between two speeds of one sign.
fn may_turn(piece: &Piece, low: f64, high: f64) -> bool {
    let acceleration = |time_s: f64| piece.start.acceleration + piece.jerk * time_s;
    let ((_, first), (_, last)) = (piece.distance_and_speed(low), piece.distance_and_speed(high));
    first * last <= 0.0 || acceleration(low) * acceleration(high) < 0.0
}

/// Times at which a piece's speed changes its sign, in order; NaN or infinite where it does not.
fn turns(piece: &Piece) -> [f64; 2] {
    let (speed, acceleration, jerk) = (piece.start.speed, piece.start.acceleration, piece.jerk);
    if jerk == 0.0 {
        return [-speed / acceleration, f64::NAN];
    }
    let root = sqrt(acceleration * acceleration - 2.0 * jerk * speed);
    let sum = -(acceleration + root.copysign(acceleration));
    let (one, other) = (sum / jerk, 2.0 * speed / sum);
    if one < other { [one, other] } else { [other, one] }
}

/// Time between `low` and `high` at which a piece, moving only to `side`, passes a line: Newton's method, kept inside
/// the interval.
fn passing(piece: &Piece, line: f64, side: f64, (mut low, mut high): (f64, f64), guess: f64, within_s: f64) -> f64 {
    // `max` comes first because it lets no NaN through.
    let mut time_s = guess.max(low).min(high);
    // Bisection alone gets from a second to 1e-12 s in 40 steps.
    for _ in 0..60 {
        let (distance, speed) = piece.distance_and_speed(time_s);
        if side * (distance - line) > 0.0 {
            high = time_s;
        } else {
            low = time_s;
        }
        let newton = time_s - (distance - line) / speed;
        let next = if (low..=high).contains(&newton) { newton } else { (low + high) / 2.0 };
        let change = (next - time_s).abs();
        time_s = next;
        if change <= within_s {
            break;
        }
    }
    time_s
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use proptest::prelude::*;

    use super::{
        super::scurve::{Limits, Motion, Position},
        *,
    };

    const TICK_HZ: f64 = 10e6;
    /// Timing of 100 kHz with 5 us of set-up and 5 us of hold after a pulse of 5 us, as M542 drivers require; 1 ms
    /// periods.
    const TIMING: TickTiming =
        TickTiming { tick_hz: 10_000_000, spacing: 100, turn_to_pulse: 50, pulse_to_turn: 100, enable: 50_000 };
    const PERIOD: u64 = 10_000;

    /// Pulses of a path as (tick, positive), and the final position. Checks what holds for every event.
    fn pulses_of(path: &Path, made: i64, ticks: u64, period: u64) -> Result<(Vec<(u64, bool)>, i64), TestCaseError> {
        let mut pulses = Pulses::new(TIMING);
        pulses.shift(made);
        let (mut told, mut line, mut last_event) = (Vec::new(), None, 0u32);
        for from in (0..ticks).step_by(period as usize) {
            let mut events = Vec::new();
            // Starts at a tick of 1 s, so that nothing is before 0.
            pulses.along(path, 10_000_000, from, from + period, |event| events.push(event));
            for event in events {
                prop_assert!(event.at >= last_event, "out of order");
                match event.action {
                    StepAction::Direction(positive) => {
                        prop_assert!(last_event == 0 || event.at - last_event >= TIMING.pulse_to_turn);
                        line = Some((positive, event.at));
                    }
                    StepAction::Pulse => {
                        let Some((positive, turned)) = line else { panic!("a pulse before any direction") };
                        prop_assert!(event.at - turned >= TIMING.turn_to_pulse);
                        prop_assert!(
                            told.last().is_none_or(|&(last, _)| u64::from(event.at) - last >= TIMING.spacing.into())
                        );
                        told.push((event.at.into(), positive));
                    }
                }
                last_event = event.at;
            }
            // Half a step, or on the line up to rounding.
            let distance = path.at((from + period) as f64 / TICK_HZ).position.distance_to(pulses.made());
            prop_assert!(distance.abs() <= 0.5 + 1e-6, "{distance} steps behind");
        }
        Ok((told, pulses.made()))
    }

    /// Moment at which a path passes the middle between two steps next to a pulse, ticks after its start: bisected from
    /// the path's states alone, between the neighbouring pulses.
    fn ideal_tick(path: &Path, from_step: i64, positive: bool, after: f64, before: f64) -> f64 {
        let beyond = |tick: f64| {
            let ahead = -path.at(tick / TICK_HZ).position.distance_to(from_step);
            if positive { ahead > 0.5 } else { ahead < -0.5 }
        };
        let (mut low, mut high) = (after, before);
        while high - low > 1e-4 {
            let middle = (low + high) / 2.0;
            if beyond(middle) { high = middle } else { low = middle }
        }
        high
    }

    /// Largest deviation of a pulse from its ideal moment, ticks. Leaves out the two about a reversal that are as close
    /// as the direction line allows: the second was pushed away, and the path may be beyond the first's line for too
    /// short a time to be found by bisection.
    fn worst_error(path: &Path, made: i64, ticks: u64, period: u64) -> Result<f64, TestCaseError> {
        let (told, end) = pulses_of(path, made, ticks, period)?;
        let (mut step, mut worst) = (made, 0f64);
        let place = |index: usize| (told[index].0 - 10_000_000) as f64;
        let pushed = |index: usize| {
            let closest = f64::from(TIMING.pulse_to_turn + TIMING.turn_to_pulse);
            told[index].1 != told[index - 1].1 && place(index) - place(index - 1) <= closest
        };
        for (index, &(_, positive)) in told.iter().enumerate() {
            let (first, last) = (index == 0, index + 1 == told.len());
            let after = if first { 0.0 } else { place(index - 1) };
            let before = if last { (ticks + period) as f64 } else { place(index + 1) };
            if (first || !pushed(index)) && (last || !pushed(index + 1)) {
                worst = worst.max((place(index) - ideal_tick(path, step, positive, after, before)).abs());
            }
            step += if positive { 1 } else { -1 };
        }
        prop_assert_eq!(step, end);
        Ok(worst)
    }

    fn limits() -> impl Strategy<Value = Limits> {
        (2.0..5.0f64, 3.0..7.0f64, prop_oneof![Just(0.0), 1e-3..0.5f64]).prop_map(
            |(speed, acceleration, jerk_time_s)| {
                let acceleration = 10f64.powf(acceleration);
                Limits { speed: 10f64.powf(speed), acceleration, jerk: acceleration / jerk_time_s }
            },
        )
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(300))]

        #[test]
        fn pulses_come_within_a_tick_of_the_path(
            limits in limits(), start in -2_147_000_000i64..2_147_000_000, fraction in -0.49..0.49f64, speed in -1.0..1.0f64,
            distance in -2000i64..2000, period in 3_000u64..30_000,
        ) {
            // From any initial speed, so that many of these paths reverse.
            let speed = speed * limits.speed;
            let from = Motion { position: Position { steps: start, fraction }, speed, acceleration: 0.0 };
            let path = Path::to_position(from, start + distance, &limits);
            let ticks = ((path.duration_s() * TICK_HZ) as u64).min(50_000_000);
            let worst = worst_error(&path, start, ticks, period)?;
            // Half a tick of rounding, and the accuracy of both solutions.
            prop_assert!(worst <= 0.5 + SOLVED_TICKS + 1e-3, "{worst} ticks");
        }

        #[test]
        fn a_turn_anywhere_loses_no_pulse(
            fraction in -0.49..0.49f64, acceleration in 1e6..1e8f64, jerk_time_s in prop_oneof![Just(0.0), 1e-4..1e-2f64], period in 1_000u64..400_000,
        ) {
            // Up, and down by as much again; all of it may be in one period.
            let limits = Limits { speed: 1e5, acceleration, jerk: acceleration / jerk_time_s };
            let from = Motion { position: Position { steps: 0, fraction }, speed: 1e5, acceleration: 0.0 };
            let path = Path::to_speed(from, -1e5, &limits);
            let top = path.at(path.duration_s() / 2.0).position;
            let ticks = (path.duration_s() * TICK_HZ) as u64;
            let (told, _) = pulses_of(&path, 0, ticks, period)?;
            let ups = told.iter().take_while(|(_, positive)| *positive).count() as i64;
            prop_assert_eq!(ups, top.steps);
            prop_assert!(told[ups as usize..].iter().all(|(_, positive)| !positive));
            prop_assert!(worst_error(&path, 0, ticks, period)? <= 0.5 + SOLVED_TICKS + 1e-3);
        }

        /// Up, down and up again while the acceleration changes sign: in one piece, and with long periods in one call.
        #[test]
        fn a_piece_that_turns_twice_loses_no_pulse(
            share in 0.1..0.9f64, jerk in 1e8..3e8f64, fraction in -0.49..0.49f64, up: bool, period in 1_000u64..400_000,
        ) {
            let side = if up { 1.0 } else { -1.0 };
            // From 6700 to 20 000 steps/s are lost and regained: the speed passes 0 twice if it starts with a share of
            // that.
            let acceleration = 2e6;
            let speed = share * acceleration * acceleration / (2.0 * jerk);
            let limits = Limits { speed: 1e5, acceleration, jerk };
            let position = Position { steps: 0, fraction };
            let from = Motion { position, speed: side * speed, acceleration: -side * acceleration };
            // So far away that the piece ends beyond both reversals.
            let path = Path::to_speed(from, side * 3e4, &limits);
            let root = (acceleration * acceleration - 2.0 * jerk * speed).sqrt();
            let [top, bottom] = [-root, root].map(|root| path.at((acceleration + root) / jerk).position.steps);
            let ticks = (path.duration_s() * TICK_HZ) as u64;
            let (told, end) = pulses_of(&path, 0, ticks, period)?;
            let back = told.iter().filter(|(_, positive)| *positive != up).count() as i64;
            let out = told.iter().take_while(|(_, positive)| *positive == up).count() as i64;
            prop_assert_eq!((side as i64 * out, side as i64 * back), (top, top - bottom));
            prop_assert_eq!(told.len() as i64, out + back + (end - bottom).abs());
            prop_assert!(worst_error(&path, 0, ticks, period)? <= 0.5 + SOLVED_TICKS + 1e-3);
        }

        /// The pulse back has to wait for the direction line.
        #[test]
        fn a_turn_just_beyond_a_line_is_given_its_time(excess in 1e-9..1e-6f64, acceleration in 1e5..1e7f64) {
            let limits = Limits { speed: 1e5, acceleration, jerk: f64::INFINITY };
            let turning_at = |fraction| {
                let from = Motion { position: Position { steps: 0, fraction }, speed: 1e4, acceleration: 0.0 };
                let path = Path::to_speed(from, -1e4, &limits);
                let top = path.at(1e4 / acceleration).position;
                (path, top)
            };
            // Shifted so that the top exceeds the middle between two steps by the excess.
            let (_, top) = turning_at(0.0);
            let (path, top) = turning_at(0.5 + excess - top.fraction);
            let ticks = (path.duration_s() * TICK_HZ) as u64;
            let (told, _) = pulses_of(&path, 0, ticks, PERIOD)?;
            let back = told.iter().position(|(_, positive)| !positive).expect("it turns");
            prop_assert_eq!(back as i64, top.steps);
            // The time beyond the line, 2 sqrt(2 excess / a), is at most 9 us, and the direction line takes 15 us.
            prop_assert_eq!(told[back].0 - told[back - 1].0, 150);
        }

        #[test]
        fn the_highest_rate_is_kept_to_the_tick(start in -1000i64..1000, fraction in -0.49..0.49f64) {
            let limits = Limits { speed: TIMING.rate_max_hz(), acceleration: 1e6, jerk: 1e8 };
            let from = Motion { position: Position { steps: start, fraction }, speed: 1e5, acceleration: 0.0 };
            let path = Path::to_speed(from, 1e5, &limits);
            let (told, _) = pulses_of(&path, start, 10 * PERIOD, PERIOD)?;
            prop_assert!(told.len().abs_diff(1000) <= 1);
            prop_assert!(told.windows(2).all(|pair| pair[1].0 - pair[0].0 == 100));
            prop_assert!(worst_error(&path, start, 10 * PERIOD, PERIOD)? <= 0.5 + SOLVED_TICKS + 1e-3);
        }
    }
}
