//! Stepper channel: commands, homing, accounting of the position.
//!
//! In each control period the pulses until [`LEAD_PERIODS`] from now are queued in the hardware, with the tick of each.
//! A command acts where the queued pulses end. The only time base is the steppers' clock, so that a late control loop
//! moves no pulse; a loop that is late by more than the queued pulses stops the motor, and that is a [`Fault`].

use core::f64::consts::TAU;

use heapless::Vec;
use r4_protocol::{
    Range,
    config::{HomingConfig, StepperConfig},
};

use super::{
    numbers::to_f64,
    scurve::{Limits, Motion, Path},
    steps::{DriverTiming, Pulses, TickTiming},
};
use crate::platform::{StepAction, StepEvent, Steppers};

/// Lead of the queued pulses, control periods: one may be missed.
pub const LEAD_PERIODS: u64 = 2;

/// Share of the search speed at which the switch is backed off from. The error of the position found is the motor's
/// travel at this speed while the switch is debounced, and in up to one period.
pub const BACK_OFF: f64 = 0.1;

/// Distance after which the search for a switch is given up, as a share of the position range, or of a turn if that has
/// no end.
pub const SEEK_SHARE: f64 = 1.25;

/// Reason why a stepper's configuration cannot work.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum BadStepper {
    /// `steps_per_turn` must not be 0.
    StepsPerTurn,
    /// `speed_max` must be positive and, in steps, at most the driver's highest rate.
    Speed,
    /// `acceleration` must be positive and finite.
    Acceleration,
    /// `jerk` must be 0 or positive, and finite.
    Jerk,
    /// `start_speed` must be 0 or positive.
    StartStopSpeed,
    /// `position` must be an interval within ±2³¹ steps, but for infinite ends.
    Position,
    /// The switch's position must be finite and within ±2³¹ steps, its speed positive and at most `speed_max`.
    Homing,
    /// The driver's times must be positive, the highest rate leave room for a pulse and its pause, and direction set-up
    /// take less than an eighth of a period.
    Timing,
}

/// Command for an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Command {
    /// Move to a position, rad.
    Position(f32),
    /// Move at a speed, rad/s; stops before the ends of the position range.
    Speed(f32),
    /// Find the position: towards the switch at this signed speed, rad/s, and slowly off it again. The position range
    /// does not apply meanwhile.
    Home(f32),
    /// Come to rest, by a ramp.
    Stop,
}

/// Reason why a command was refused; nothing changes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum CommandError {
    /// Value that is NaN or infinite.
    NotFinite,
    /// Value outside the allowed range.
    OutOfRange {
        /// Range that the axis allows.
        allowed: Range,
    },
    /// The axis has no switch to find its position by.
    NoSwitch,
    /// A speed of 0 finds no switch.
    NoSpeed,
}

/// Fault of an axis in a period. The axis stops: at once, after which it no longer counts as homed, or by a ramp where
/// noted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The control loop was late by more than the queued pulses.
    Late,
    /// The hardware did not take all pulses.
    QueueFull,
    /// The hardware made other pulses than were queued.
    Miscounted,
    /// The switch could not be read while it was needed. Stops by a ramp.
    SwitchUnknown,
    /// The switch did not close, or not open again, within [`SEEK_SHARE`]. Stops by a ramp.
    SwitchNotFound,
}

/// Purpose of a path.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Order {
    /// Position to move to, steps.
    Position(i64),
    /// Speed, steps/s, within the position range.
    Speed(f64),
    /// Speed, steps/s, regardless of the position range.
    Seek(f64),
    Stop,
}

/// State of a homing search.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Search {
    /// Speed towards the switch, steps/s.
    speed: f64,
    /// Position at which this phase began, steps.
    began: i64,
    phase: Phase,
}

/// Phase of a homing search.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Phase {
    /// Seek, until the switch closes.
    Seek,
    /// Brake, until the motor rests.
    Brake,
    /// Back off until the switch opens after having been closed: the motor may have passed it.
    BackOff { was_closed: bool },
}

/// Status of an axis for telemetry.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisStatus {
    /// Number of pulses made, as a position; wraps at 32 bits, which commands do not.
    pub position_steps: i32,
    /// Speed of the path where the queued pulses end, rad/s.
    pub speed: f32,
    /// True if all pulses to the commanded position have been made.
    pub settled: bool,
    /// True if the position is that of the switch, and nothing since has put it in doubt.
    pub homed: bool,
    /// True while pulses are being made, or will be.
    pub moving: bool,
}

/// Stepper channel, stepped once each control period.
#[derive(Debug)]
pub struct Axis {
    index: u8,
    config: StepperConfig,
    limits: Limits,
    steps_per_rad: f64,
    tick_hz: f64,
    period: u64,
    /// Clock of the hardware without wrapping, ticks; raw count of its pulses; that count without wrapping, steps.
    now: u64,
    raw: i32,
    position: i64,
    /// True if pulses are to be made: those in the hardware at the last observation, or queued since.
    pending: bool,
    path: Path,
    path_start: u64,
    pulses: Pulses,
    /// Tick until which pulses have been queued, the path's speed there, steps/s, and whether the path rests there.
    told_to: u64,
    speed: f64,
    path_rests: bool,
    /// Purpose of the path, and its replacement.
    order: Order,
    next: Option<Order>,
    search: Option<Search>,
    homed: bool,
    /// Highest speeds in the intervals of pulses queued last, steps/s: the motor is in one of them.
    fastest: [f64; LEAD_PERIODS as usize + 2],
}

impl Axis {
    /// Creates an axis at rest at position 0, not homed.
    ///
    /// # Errors
    /// [`BadStepper`] names the first field that cannot work.
    pub fn new<H: Steppers>(
        index: u8,
        config: StepperConfig,
        driver: &DriverTiming,
        period_us: u32,
        hw: &mut H,
    ) -> Result<Self, BadStepper> {
        let timing = TickTiming::new::<H>(driver).ok_or(BadStepper::Timing)?;
        let period = u64::from(period_us) * u64::from(H::TICK_HZ) / 1_000_000;
        if u64::from(timing.turn_to_pulse) > period / MARGIN_SHARE {
            return Err(BadStepper::Timing);
        }
        let steps_per_rad = f64::from(config.steps_per_turn) / TAU;
        let limits = check(&config, steps_per_rad, timing.rate_max_hz())?;
        Ok(Self {
            index,
            config,
            limits,
            steps_per_rad,
            tick_hz: f64::from(H::TICK_HZ),
            period,
            now: hw.now().into(),
            raw: hw.position(index),
            position: 0,
            pending: false,
            path: Path::rest(Motion::rest(0)),
            path_start: 0,
            pulses: Pulses::new(timing),
            told_to: 0,
            speed: 0.0,
            path_rests: true,
            order: Order::Stop,
            next: None,
            search: None,
            homed: false,
            fastest: [0.0; _],
        })
    }

    /// Takes a command, which acts from the next period on. A repeated command changes nothing.
    ///
    /// # Errors
    /// [`CommandError`]: a command is refused, never clipped.
    pub fn command(&mut self, command: Command) -> Result<(), CommandError> {
        let within = |value: f32, allowed: Range| match value {
            value if !value.is_finite() => Err(CommandError::NotFinite),
            value if !(allowed.min..=allowed.max).contains(&value) => Err(CommandError::OutOfRange { allowed }),
            value => Ok(f64::from(value) * self.steps_per_rad),
        };
        let either_way = |speed: f32| Range::new(-speed, speed);
        let (order, search) = match command {
            Command::Position(position) => {
                let last = (f64::from(i32::MAX) / self.steps_per_rad) as f32;
                let Range { min, max } = self.config.position;
                let target = within(position, Range::new(min.max(-last), max.min(last)))?;
                (Order::Position(libm::round(target) as i64), None)
            }
            Command::Speed(speed) => (Order::Speed(within(speed, either_way(self.config.speed_max))?), None),
            Command::Home(speed) => {
                let homing = self.config.homing.ok_or(CommandError::NoSwitch)?;
                let speed = within(speed, either_way(homing.speed_max))?;
                if speed == 0.0 {
                    return Err(CommandError::NoSpeed);
                }
                if self.search.is_some_and(|search| search.speed == speed) {
                    return Ok(());
                }
                self.homed = false;
                (Order::Seek(speed), Some(Search { speed, began: self.position, phase: Phase::Seek }))
            }
            Command::Stop => (Order::Stop, None),
        };
        self.search = search;
        self.next = Some(order).filter(|order| *order != self.order);
        Ok(())
    }

    /// Advances one period: accounts for the pulses made, and queues the next ones in the hardware. `switch_closed` is
    /// the switch for homing; `None` if it cannot be read.
    ///
    /// # Errors
    /// [`Fault`]; the axis is already stopping.
    pub fn step(&mut self, switch_closed: Option<bool>, hw: &mut impl Steppers) -> Result<(), Fault> {
        self.observe(hw);
        let searched = self.search_on(switch_closed);
        if let Err(fault) = self.tell(hw) {
            self.stop_now(hw);
            self.homed = false;
            return Err(fault);
        }
        searched
    }

    /// Accounts for the clock and the pulses made. Done at least every 2³¹ ticks, also while nothing is commanded.
    pub fn observe(&mut self, hw: &mut impl Steppers) {
        self.now += u64::from(hw.now().wrapping_sub(self.now as u32));
        // Read first: if nothing was pending, the position is final. While the path goes on something is pending
        // anyway.
        self.pending = !self.path_rests || hw.pending(self.index) > 0;
        let raw = hw.position(self.index);
        let moved = i64::from(raw.wrapping_sub(self.raw));
        self.position = self.position.wrapping_add(if self.config.inverted { -moved } else { moved });
        self.raw = raw;
    }

    /// Stops at once and clears the command. If that was faster than the motor can stop, steps may be lost, and then
    /// the axis no longer counts as homed; the position counts every pulse made.
    pub fn stop_now(&mut self, hw: &mut impl Steppers) {
        hw.stop(self.index);
        self.observe(hw);
        let start_stop = f64::from(self.config.start_speed) * self.steps_per_rad;
        if self.fastest.iter().any(|speed| *speed > start_stop) {
            self.homed = false;
        }
        self.pending = hw.pending(self.index) > 0;
        self.path.turn_to_speed(Motion::rest(self.position), 0.0, &self.limits);
        self.path_start = self.now;
        (self.told_to, self.speed, self.path_rests) = (self.now, 0.0, true);
        self.pulses.reset(self.position, self.now);
        self.order = Order::Stop;
        self.next = None;
        self.search = None;
        self.fastest = [0.0; _];
    }

    /// Marks the axis as not homed: something else may have turned the shaft.
    pub fn lose_home(&mut self) {
        self.homed = false;
    }

    /// Status of the axis for telemetry.
    #[must_use]
    pub fn status(&self) -> AxisStatus {
        let moving = !self.rests();
        AxisStatus {
            position_steps: self.position as i32,
            speed: (self.speed / self.steps_per_rad) as f32,
            settled: !moving && matches!(self.order, Order::Position(target) if target == self.position),
            homed: self.homed,
            moving,
        }
    }

    /// Speed computed from the path, for comparison with [`AxisStatus::speed`].
    #[cfg(test)]
    pub(super) fn path_speed(&self) -> f32 {
        (self.path.at(self.path_time_s(self.told_to)).speed / self.steps_per_rad) as f32
    }

    /// Configuration of the axis.
    #[must_use]
    pub fn config(&self) -> &StepperConfig {
        &self.config
    }

    /// Returns true if nothing moves, and nothing will.
    fn rests(&self) -> bool {
        !self.pending && self.next.is_none() && self.path_rests
    }

    fn path_time_s(&self, tick: u64) -> f64 {
        to_f64(tick.saturating_sub(self.path_start)) / self.tick_hz
    }

    // Not inlined, like `turn_to` and `go_on`: what only some periods execute would make the control tick too long for ITCM.
    #[inline(never)]
    fn search_on(&mut self, switch_closed: Option<bool>) -> Result<(), Fault> {
        let (Some(search), Some(homing)) = (self.search, self.config.homing) else { return Ok(()) };
        let Some(closed) = switch_closed else { return self.give_up(Fault::SwitchUnknown) };
        let Range { min, max } = self.config.position;
        let way = f64::from(max - min) * self.steps_per_rad;
        let most = SEEK_SHARE * if way.is_finite() { way } else { self.config.steps_per_turn.into() };
        let gone = self.position.wrapping_sub(search.began).unsigned_abs() as f64;
        let phase = match search.phase {
            Phase::Seek if closed => {
                self.next = Some(Order::Stop);
                Phase::Brake
            }
            Phase::Brake if self.rests() => {
                self.next = Some(Order::Seek(-BACK_OFF * search.speed));
                Phase::BackOff { was_closed: closed }
            }
            Phase::BackOff { was_closed: true } if !closed => {
                self.found(libm::round(f64::from(homing.position) * self.steps_per_rad) as i64);
                return Ok(());
            }
            Phase::Seek | Phase::BackOff { .. } if gone > most => return self.give_up(Fault::SwitchNotFound),
            Phase::BackOff { was_closed: false } if closed => Phase::BackOff { was_closed: true },
            Phase::Seek | Phase::Brake | Phase::BackOff { .. } => return Ok(()),
        };
        self.search = Some(Search { phase, began: self.position, ..search });
        Ok(())
    }

    /// Sets the position at which the switch opens.
    fn found(&mut self, position: i64) {
        let shift = position.wrapping_sub(self.position);
        self.position = position;
        self.pulses.shift(shift);
        self.path.shift(shift);
        self.homed = true;
        self.search = None;
        self.next = Some(Order::Stop);
    }

    fn give_up(&mut self, fault: Fault) -> Result<(), Fault> {
        self.search = None;
        self.next = Some(Order::Stop);
        Err(fault)
    }

    fn tell(&mut self, hw: &mut impl Steppers) -> Result<(), Fault> {
        let [_, first, second, third] = self.fastest;
        self.fastest = [first, second, third, 0.0];
        let in_time = self.told_to >= self.now + self.period / MARGIN_SHARE;
        match (self.path_rests, in_time) {
            (false, false) => return Err(Fault::Late),
            (true, _) if self.next.is_none() => {
                let done = !self.pending && self.now > self.told_to;
                return if done && self.position != self.pulses.made() { Err(Fault::Miscounted) } else { Ok(()) };
            }
            (true, false) => self.told_to = self.now + self.period / 2,
            (_, true) => {}
        }
        if let Some(order) = self.next.take() {
            let motion = self.path.at(self.path_time_s(self.told_to));
            self.turn_to(order, motion);
            self.path_start = self.told_to;
            self.order = order;
        }
        let from = self.told_to;
        self.told_to = from.max(self.now + LEAD_PERIODS * self.period);
        self.go_on(from);
        if self.path_rests {
            self.observe(hw);
        }
        self.queue(from, hw)
    }

    /// Replaces the path by that of an order, starting from a state of motion.
    #[inline(never)]
    fn turn_to(&mut self, order: Order, motion: Motion) {
        let Self { path, limits, .. } = self;
        match order {
            Order::Position(target) => path.turn_to_position(motion, target, limits),
            Order::Stop => path.turn_to_speed(motion, 0.0, limits),
            Order::Seek(speed) => path.turn_to_speed(motion, speed, limits),
            Order::Speed(speed) => {
                let end = if speed > 0.0 { self.config.position.max } else { self.config.position.min };
                if speed == 0.0 || end.is_infinite() {
                    return path.turn_to_speed(motion, speed, limits);
                }
                let end = f64::from(end) * self.steps_per_rad;
                let end = if speed > 0.0 { libm::floor(end) } else { libm::ceil(end) } as i64;
                if motion.position.distance_to(end) * speed <= 0.0 {
                    return path.turn_to_speed(motion, 0.0, limits);
                }
                path.turn_to_position(motion, end, &Limits { speed: speed.abs(), ..*limits });
            }
        }
    }

    /// Records the speed at [`Axis::told_to`], whether the path rests there, and the highest speed since `from`. The
    /// path's extremes are at the ends of pieces, except in a piece that begins with acceleration of the other sign:
    /// there the extreme lies between earlier speeds.
    #[inline(never)]
    fn go_on(&mut self, from: u64) {
        let (from_s, to_s) = (self.path_time_s(from), self.path_time_s(self.told_to));
        self.path.go_on_to(from_s);
        let later = self.path.pieces().iter().skip(1).take_while(|piece| piece.start_s < to_s);
        let ends = [self.speed, self.path.speed_at(to_s)];
        let speeds = later.map(|piece| piece.start.speed).chain(ends);
        let [.., fastest] = &mut self.fastest;
        *fastest = speeds.fold(0.0, |fastest, speed| speed.abs().max(fastest));
        self.speed = ends[1];
        self.path_rests = self.path.rests_at(to_s);
    }

    /// Queues the pulses of `from..told_to` in the hardware.
    fn queue(&mut self, from: u64, hw: &mut impl Steppers) -> Result<(), Fault> {
        let (index, inverted, path_start) = (self.index, self.config.inverted, self.path_start);
        let pending = &mut self.pending;
        let mut events: Vec<StepEvent, 32> = Vec::new();
        let mut taken = Ok(());
        let mut flush = |events: &mut Vec<StepEvent, 32>| {
            if taken.is_ok() && hw.queue(index, events) < events.len() {
                taken = Err(Fault::QueueFull);
            }
            events.clear();
        };
        self.pulses.along(&self.path, path_start, from - path_start, self.told_to - path_start, |mut event| {
            if let StepAction::Direction(positive) = &mut event.action {
                *positive ^= inverted;
            }
            if events.is_full() {
                flush(&mut events);
            }
            let _ = events.push(event);
            *pending = true;
        });
        flush(&mut events);
        taken
    }
}

/// Share of a period by which pulses are queued before they are due, at least.
const MARGIN_SHARE: u64 = 8;

fn check(config: &StepperConfig, steps_per_rad: f64, rate_max_hz: f64) -> Result<Limits, BadStepper> {
    let positive = |value: f32| value > 0.0 && value.is_finite();
    let countable = |position: f32| (f64::from(position) * steps_per_rad).abs() < f64::from(i32::MAX);
    let speed = f64::from(config.speed_max) * steps_per_rad;
    if config.steps_per_turn == 0 {
        return Err(BadStepper::StepsPerTurn);
    }
    // f32 has 7 digits: a speed given in decimals as the highest rate may exceed it by one rounding error.
    if !positive(config.speed_max) || speed > rate_max_hz * (1.0 + f64::from(f32::EPSILON)) {
        return Err(BadStepper::Speed);
    }
    if !positive(config.acceleration) {
        return Err(BadStepper::Acceleration);
    }
    if config.jerk != 0.0 && !positive(config.jerk) {
        return Err(BadStepper::Jerk);
    }
    if config.start_speed.is_nan() || config.start_speed < 0.0 {
        return Err(BadStepper::StartStopSpeed);
    }
    let Range { min, max } = config.position;
    if [min, max].into_iter().any(|end| end.is_nan() || (end.is_finite() && !countable(end))) || min > max {
        return Err(BadStepper::Position);
    }
    let bad_homing = |homing: HomingConfig| {
        !countable(homing.position) || !positive(homing.speed_max) || homing.speed_max > config.speed_max
    };
    if config.homing.is_some_and(bad_homing) {
        return Err(BadStepper::Homing);
    }
    let jerk = if config.jerk == 0.0 { f64::INFINITY } else { f64::from(config.jerk) * steps_per_rad };
    Ok(Limits { speed: speed.min(rate_max_hz), acceleration: f64::from(config.acceleration) * steps_per_rad, jerk })
}
