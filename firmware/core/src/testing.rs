//! Environment of this crate's tests: a clock that they advance themselves, lines and chips that only store their
//! state.

extern crate std;

use core::{
    cell::{Cell, RefCell},
    future::{Future, poll_fn},
    pin::Pin,
    task::{Context, Poll},
};
use std::{
    boxed::Box,
    collections::BTreeMap,
    rc::Rc,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    task::{Wake, Waker},
    vec::Vec,
};

use embassy_sync::blocking_mutex::raw::{NoopRawMutex, RawMutex};
use embassy_time::{Duration, Instant};
use embedded_hal::{
    digital::{ErrorKind, ErrorType, InputPin, OutputPin},
    i2c,
};
use embedded_hal_async::{digital::Wait, i2c::I2c};
use r4_protocol::config::{BoardConfig, MAX_MOTORS, STEPPERS, SWITCHES};

use crate::{
    platform::{
        AnalogInputs, AnalogOutputs, Bus, ControlCycles, EdgeInputs, Encoders, KeptWords, Pulse, PulseInputs,
        StepAction, StepEvent, Steppers, SwitchInputs,
    },
    shared::{ControlSide, HostSide, ReportSide, ResetCause, Shared, SupervisorSide},
};

/// Sides of the shared state, as the tasks take them.
impl<M: RawMutex> Shared<M> {
    pub(crate) fn as_host(&self) -> HostSide<'_, M> {
        HostSide::of(self)
    }

    pub(crate) fn as_control(&self) -> ControlSide<'_, M> {
        ControlSide::of(self)
    }

    pub(crate) fn as_supervisor(&self) -> SupervisorSide<'_, M> {
        SupervisorSide::of(self)
    }

    pub(crate) fn report(&self) -> ReportSide<'_, M> {
        ReportSide::of(self)
    }
}

/// State of a board that lives as long as its test.
pub(crate) type Board = &'static Shared<NoopRawMutex>;

/// Configuration of a robot from `boards/`, changed so that every stop switches off at once.
pub(crate) fn robot(name: &str) -> BoardConfig {
    let mut config = r4_boards::load(name).expect("the robot is part of the program").config;
    config.motors.iter_mut().for_each(|motor| motor.stop_brake_ms = 0);
    config.bldcs.iter_mut().for_each(|bldc| bldc.stop_brake_ms = 0);
    config.steppers.iter_mut().for_each(|stepper| stepper.stop_brake_ms = 0);
    config
}

pub(crate) fn board(config: BoardConfig, reset: ResetCause) -> Board {
    Box::leak(Box::new(Shared::new(config.clone(), config, reset)))
}

std::thread_local! {
    /// Virtual time, µs; begins late enough that no age reaches back before 0.
    static NOW_US: Cell<u64> = const { Cell::new(1_000_000_000) };
    static SLEEPERS: RefCell<Vec<(u64, Waker)>> = const { RefCell::new(Vec::new()) };
}

/// Clock per thread: tests run in parallel.
struct Clock;

impl embassy_time_driver::Driver for Clock {
    fn now(&self) -> u64 {
        NOW_US.get()
    }

    fn schedule_wake(&self, at_us: u64, waker: &Waker) {
        SLEEPERS.with_borrow_mut(|sleepers| sleepers.push((at_us, waker.clone())));
    }
}

embassy_time_driver::time_driver_impl!(static CLOCK: Clock = Clock);

struct Woken(AtomicBool);

impl Wake for Woken {
    fn wake(self: Arc<Self>) {
        self.0.store(true, Ordering::Relaxed);
    }
}

/// Tasks at descending priority. Each is polled only when it has been woken, so that a missing signal shows.
#[derive(Default)]
pub(crate) struct Tasks(Vec<(Task, Arc<Woken>)>);

type Task = Pin<Box<dyn Future<Output = ()>>>;

impl Tasks {
    /// Adds a task; it first runs with the next [`Tasks::settle`] or [`Tasks::advance`].
    pub(crate) fn spawn(&mut self, task: impl Future + 'static) {
        let task = async {
            task.await;
        };
        self.0.push((Box::pin(task), Arc::new(Woken(AtomicBool::new(true)))));
    }

    /// Runs the woken tasks, until all sleep. No time passes.
    pub(crate) fn settle(&mut self) {
        while let Some((task, woken)) = self.0.iter_mut().find(|(_, woken)| woken.0.swap(false, Ordering::Relaxed)) {
            let waker = Waker::from(woken.clone());
            // Tasks of a board never end.
            assert!(task.as_mut().poll(&mut Context::from_waker(&waker)).is_pending());
        }
    }

    /// Advances the time, from one sleeper's moment to the next.
    pub(crate) fn advance(&mut self, duration: Duration) {
        let end_us = NOW_US.get() + duration.as_micros();
        loop {
            self.settle();
            let due = |sleepers: &mut Vec<(u64, Waker)>| {
                let next = (0..sleepers.len()).min_by_key(|index| sleepers[*index].0)?;
                (sleepers[next].0 <= end_us).then(|| sleepers.swap_remove(next))
            };
            let Some((at_us, waker)) = SLEEPERS.with_borrow_mut(due) else { break };
            NOW_US.set(NOW_US.get().max(at_us));
            waker.wake();
        }
        NOW_US.set(end_us);
    }

    /// Advances the time to a moment, like [`Tasks::advance`].
    pub(crate) fn advance_to(&mut self, moment: Instant) {
        self.advance(moment - Instant::now());
    }
}

/// Line of the processor, seen from both sides.
#[derive(Clone, Default)]
pub(crate) struct Line(Rc<LineState>);

#[derive(Default)]
struct LineState {
    high: Cell<bool>,
    /// Number of changes since power-up.
    edges: Cell<u32>,
    broken: Cell<bool>,
    waiting: RefCell<Vec<Waker>>,
}

impl Line {
    pub(crate) fn new(high: bool) -> Self {
        let line = Self::default();
        line.0.high.set(high);
        line
    }

    pub(crate) fn set(&self, high: bool) {
        if self.0.high.replace(high) != high {
            self.0.edges.set(self.0.edges.get() + 1);
            self.0.waiting.take().into_iter().for_each(Waker::wake);
        }
    }

    pub(crate) fn level(&self) -> bool {
        self.0.high.get()
    }

    pub(crate) fn edges(&self) -> u32 {
        self.0.edges.get()
    }

    /// Breaks the line: from now on it can neither be read nor waited for.
    pub(crate) fn break_off(&self) {
        self.0.broken.set(true);
    }

    /// Waits for `level`, or for any edge since the wait began.
    async fn wait(&self, level: bool) {
        let edges = self.edges();
        poll_fn(|context| {
            if !self.0.broken.get() && (self.level() == level || self.edges() != edges) {
                return Poll::Ready(());
            }
            self.0.waiting.borrow_mut().push(context.waker().clone());
            Poll::Pending
        })
        .await;
    }
}

impl ErrorType for Line {
    type Error = ErrorKind;
}

impl InputPin for Line {
    fn is_high(&mut self) -> Result<bool, ErrorKind> {
        if self.0.broken.get() { Err(ErrorKind::Other) } else { Ok(self.level()) }
    }

    fn is_low(&mut self) -> Result<bool, ErrorKind> {
        self.is_high().map(|high| !high)
    }
}

impl OutputPin for Line {
    fn set_low(&mut self) -> Result<(), ErrorKind> {
        self.set(false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), ErrorKind> {
        self.set(true);
        Ok(())
    }
}

impl Wait for Line {
    async fn wait_for_high(&mut self) -> Result<(), ErrorKind> {
        self.wait(true).await;
        Ok(())
    }

    async fn wait_for_low(&mut self) -> Result<(), ErrorKind> {
        self.wait(false).await;
        Ok(())
    }

    async fn wait_for_rising_edge(&mut self) -> Result<(), ErrorKind> {
        self.wait(false).await;
        self.wait_for_high().await
    }

    async fn wait_for_falling_edge(&mut self) -> Result<(), ErrorKind> {
        self.wait(true).await;
        self.wait_for_low().await
    }

    async fn wait_for_any_edge(&mut self) -> Result<(), ErrorKind> {
        let high = self.level();
        self.wait(!high).await;
        Ok(())
    }
}

/// Bus with chips that store what is written to their registers, with an incrementing pointer, and DACs that store
/// their codes. Transfers take no time.
#[derive(Clone, Default)]
pub(crate) struct Registers(Rc<RegistersState>);

#[derive(Default)]
struct RegistersState {
    /// Register values by chip and register.
    values: RefCell<BTreeMap<(u8, u8), u8>>,
    /// Number of following transfers that are not acknowledged.
    failing: Cell<u32>,
    /// Number of failures before each acknowledged transfer, and the number of failures since the last one.
    stutter: Cell<u32>,
    stuttered: Cell<u32>,
    /// Chip that acknowledges nothing; `None` for none.
    mute: Cell<Option<u8>>,
    clocks: Cell<u32>,
    recoveries: Cell<u32>,
    /// Duration of each transfer; `None` for no time.
    transfer: Cell<Option<Duration>>,
}

/// Error: no chip acknowledges.
#[derive(Debug)]
pub(crate) struct NoAnswer;

impl i2c::Error for NoAnswer {
    fn kind(&self) -> i2c::ErrorKind {
        i2c::ErrorKind::Other
    }
}

impl i2c::ErrorType for Registers {
    type Error = NoAnswer;
}

/// First of the four registers by which a PCA9685 (addresses 0x40 and up) sets all its outputs (datasheet 7.3.4).
const ALL_OUTPUTS: u8 = 0xFA;

/// Addresses of an MCP4728 (datasheet 5.3). It has no register addresses: stored are the 24 bytes of a read, for each
/// output the input register and the EEPROM, three bytes each (figure 5-15).
const DACS: core::ops::Range<u8> = 0x60..0x68;

impl Registers {
    pub(crate) fn get(&self, chip: u8, register: u8) -> u8 {
        self.0.values.borrow().get(&(chip, register)).copied().unwrap_or_default()
    }

    pub(crate) fn set(&self, chip: u8, register: u8, value: u8) {
        self.0.values.borrow_mut().insert((chip, register), value);
    }

    pub(crate) fn fail(&self, transfers: u32) {
        self.0.failing.set(transfers);
    }

    pub(crate) fn recoveries(&self) -> u32 {
        self.0.recoveries.get()
    }

    /// Makes this number of tries fail before each successful one, from now on.
    pub(crate) fn stutter(&self, tries: u32) {
        self.0.stutter.set(tries);
    }

    /// Makes this chip acknowledge nothing, from now on.
    pub(crate) fn mute(&self, chip: u8) {
        self.0.mute.set(Some(chip));
    }

    /// Number of clock pulses of all transfers so far: nine per byte, addresses included. START and STOP have none.
    pub(crate) fn clocks(&self) -> u32 {
        self.0.clocks.get()
    }

    /// Sets the duration of each transfer, from now on.
    pub(crate) fn slow_down(&self, transfer: Duration) {
        self.0.transfer.set(Some(transfer));
    }

    /// Carries out a fast write (5.6.1), multi-write (5.6.2) or sequential write (5.6.3) of a DAC; a fast write leaves
    /// reference and gain unchanged.
    fn take_codes(&self, chip: u8, bytes: &[u8]) {
        let [command, settings @ ..] = bytes else { return };
        let keep = |output: u8, half: u8, [upper, lower]: [u8; 2]| {
            self.set(chip, 6 * output + 3 * half + 1, upper);
            self.set(chip, 6 * output + 3 * half + 2, lower);
        };
        match command >> 3 {
            0b01000 => bytes.chunks_exact(3).for_each(|bytes| keep(bytes[0] >> 1 & 3, 0, [bytes[1], bytes[2]])),
            0b01010 => settings.chunks_exact(2).zip(command >> 1 & 3..).for_each(|(bytes, output)| {
                (0..2).for_each(|half| keep(output, half, [bytes[0], bytes[1]]));
            }),
            _ => bytes.chunks_exact(2).zip(0..).for_each(|(bytes, output)| {
                keep(output, 0, [self.get(chip, 6 * output + 1) & 0x90 | bytes[0], bytes[1]]);
            }),
        }
    }

    /// Byte as read back: each third byte of a DAC has RDY/BSY set, because its EEPROM writes take no time here.
    fn show(&self, chip: u8, register: u8) -> u8 {
        let ready = DACS.contains(&chip) && register.is_multiple_of(3);
        self.get(chip, register) | if ready { 0x80 } else { 0 }
    }

    fn take(&self, chip: u8, bytes: &[u8]) {
        if DACS.contains(&chip) {
            return self.take_codes(chip, bytes);
        }
        let [register, values @ ..] = bytes else { return };
        // The register count comes second: a zip polls its first side once more at the end, and 0xFF + 1 would
        // overflow.
        for (value, register) in values.iter().zip(*register..) {
            if chip >= 0x40 && (ALL_OUTPUTS..ALL_OUTPUTS + 4).contains(&register) {
                (0..16).for_each(|output| self.set(chip, 6 + 4 * output + (register - ALL_OUTPUTS), *value));
            } else {
                self.set(chip, register, *value);
            }
        }
    }
}

impl I2c for Registers {
    async fn transaction(&mut self, chip: u8, operations: &mut [i2c::Operation<'_>]) -> Result<(), NoAnswer> {
        if let Some(transfer) = self.0.transfer.get() {
            embassy_time::Timer::after(transfer).await;
        }
        let failing = self.0.failing.get();
        if failing > 0 {
            self.0.failing.set(failing.saturating_sub(1));
            return Err(NoAnswer);
        }
        let stuttered = self.0.stuttered.get();
        if stuttered < self.0.stutter.get() {
            self.0.stuttered.set(stuttered + 1);
            return Err(NoAnswer);
        }
        self.0.stuttered.set(0);
        if self.0.mute.get() == Some(chip) {
            return Err(NoAnswer);
        }
        let mut pointer = 0;
        for operation in operations {
            let bytes = match operation {
                i2c::Operation::Write(bytes) => bytes.len(),
                i2c::Operation::Read(bytes) => bytes.len(),
            };
            self.0.clocks.set(self.0.clocks.get() + 9 * (1 + bytes as u32));
            match operation {
                i2c::Operation::Write(bytes) => {
                    pointer = bytes.first().copied().unwrap_or(pointer);
                    self.take(chip, bytes);
                }
                i2c::Operation::Read(bytes) => {
                    bytes.iter_mut().zip(pointer..).for_each(|(byte, register)| *byte = self.show(chip, register));
                }
            }
        }
        Ok(())
    }
}

impl Bus for Registers {
    async fn recover(&mut self) {
        self.0.recoveries.set(self.0.recoveries.get() + 1);
    }
}

/// Fake peripherals of the processor, whose values the test sets.
#[derive(Clone, Default)]
pub(crate) struct Peripherals(Rc<PeripheralsState>);

#[derive(Default)]
pub(crate) struct PeripheralsState {
    pub(crate) counts: [Cell<u16>; 4],
    pub(crate) illegal: [Cell<u32>; 4],
    pub(crate) at_index: [Cell<Option<u16>>; 4],
    pub(crate) storm: Cell<bool>,
    pub(crate) pulses: [Cell<Option<Pulse>>; 2],
    /// Switch inputs that are low; all are high at first.
    pub(crate) low: [Cell<bool>; SWITCHES],
    pub(crate) cycles: Cell<u32>,
    pub(crate) codes: [Cell<u16>; 6],
    pub(crate) dacs: [Cell<u16>; 2],
    pub(crate) kept: [Cell<u32>; MAX_MOTORS],
    /// Number of events queued in each step generator, and the remaining room.
    pub(crate) told: [Cell<usize>; STEPPERS],
    pub(crate) room: Cell<usize>,
    pub(crate) steppers_enabled: Cell<bool>,
    /// Steps made by each generator.
    pub(crate) made: [Cell<i32>; STEPPERS],
    /// True if each step is made as soon as it is queued; and the direction of the last step.
    pub(crate) obedient: Cell<bool>,
    pub(crate) directions: [Cell<bool>; STEPPERS],
    /// Action of a task above the control loop while that reads its inputs the next time.
    pub(crate) meanwhile: Cell<Option<Box<dyn FnOnce()>>>,
}

impl core::ops::Deref for Peripherals {
    type Target = PeripheralsState;

    fn deref(&self) -> &PeripheralsState {
        &self.0
    }
}

impl Encoders for Peripherals {
    fn count(&mut self, index: u8) -> u16 {
        self.counts[usize::from(index)].get()
    }

    fn illegal(&mut self, index: u8) -> u32 {
        self.illegal[usize::from(index)].get()
    }

    fn at_index(&mut self, index: u8) -> Option<u16> {
        self.at_index[usize::from(index)].take()
    }
}

impl EdgeInputs for Peripherals {
    fn storm(&mut self) -> bool {
        if let Some(act) = self.meanwhile.take() {
            act();
        }
        self.storm.get()
    }
}

impl PulseInputs for Peripherals {
    fn pulse(&mut self, index: u8) -> Option<Pulse> {
        self.pulses.get(usize::from(index))?.get()
    }
}

impl ControlCycles for Peripherals {
    const CYCLES_HZ: u32 = 1_000_000;

    fn control_cycles(&mut self) -> u32 {
        self.cycles.get()
    }
}

impl SwitchInputs for Peripherals {
    fn is_high(&mut self, number: u8) -> bool {
        !self.low[usize::from(number)].get()
    }
}

impl AnalogOutputs for Peripherals {
    fn set(&mut self, index: u8, code: u16) {
        self.dacs[usize::from(index)].set(code);
    }
}

impl AnalogInputs for Peripherals {
    fn code(&mut self, index: u8) -> u16 {
        self.codes[usize::from(index)].get()
    }
}

impl KeptWords for Peripherals {
    fn kept(&mut self, index: usize) -> u32 {
        self.kept[index].get()
    }

    fn keep(&mut self, index: usize, word: u32) {
        self.kept[index].set(word);
    }
}

/// Step generators that make the steps that the test sets, or, where `obedient`, each step when it is queued.
impl Steppers for Peripherals {
    const TICK_HZ: u32 = 1_000_000;
    const PULSE_TICKS: u32 = 5;
    const DIRECTION_LATENCY_TICKS: u32 = 0;

    fn now(&mut self) -> u32 {
        Instant::now().as_micros() as u32
    }

    fn enable(&mut self, on: bool) {
        self.steppers_enabled.set(on);
    }

    fn queue(&mut self, index: u8, events: &[StepEvent]) -> usize {
        let taken = events.len().min(self.room.get());
        self.room.set(self.room.get() - taken);
        let told = &self.told[usize::from(index)];
        told.set(told.get() + taken);
        for event in events[..taken].iter().filter(|_| self.obedient.get()) {
            let (made, direction) = (&self.made[usize::from(index)], &self.directions[usize::from(index)]);
            match event.action {
                StepAction::Direction(positive) => direction.set(positive),
                StepAction::Pulse => made.set(made.get() + if direction.get() { 1 } else { -1 }),
            }
        }
        taken
    }

    fn pending(&mut self, _: u8) -> u32 {
        0
    }

    fn position(&mut self, index: u8) -> i32 {
        self.made[usize::from(index)].get()
    }

    fn stop(&mut self, _: u8) {}
}

/// Path by Ruckig (Berscheid and Kröger, Robotics: Science and Systems 2021), of one axis to rest: an independent
/// solution of the same problem, from any state within the limits that stays within them when its acceleration is
/// removed. Outside them Ruckig first brakes by rules of its own.
pub(crate) struct Ruckig {
    path: rsruckig::trajectory::Trajectory<1>,
    from: f64,
    /// Units of distance and time in which Ruckig planned.
    unit: f64,
    unit_s: f64,
    /// Duration of the path, s.
    pub(crate) duration_s: f64,
}

impl Ruckig {
    /// Plans a path to rest at `target` from position, speed and acceleration.
    pub(crate) fn to_rest(from: [f64; 3], target: f64, limits: &crate::motion::scurve::Limits) -> Self {
        use rsruckig::{
            error::ThrowErrorHandler, input_parameter::InputParameter, ruckig::Ruckig as Planner,
            trajectory::Trajectory,
        };
        // Ruckig's tolerances are absolute, so highest speed and acceleration are scaled to 1.
        let unit_s = limits.speed / limits.acceleration;
        let unit = limits.speed * unit_s;
        let [position, speed, acceleration] = from;
        let mut input = InputParameter::<1>::new(None);
        (input.current_position[0], input.target_position[0]) = (0.0, (target - position) / unit);
        input.current_velocity[0] = speed / limits.speed;
        input.current_acceleration[0] = acceleration / limits.acceleration;
        (input.max_velocity[0], input.max_acceleration[0]) = (1.0, 1.0);
        input.max_jerk[0] = limits.jerk * unit_s / limits.acceleration;
        let mut path = Trajectory::new(None);
        // Period of Ruckig's own steps, which are not used.
        let mut planner = Planner::<1, ThrowErrorHandler>::new(None, 1e-3);
        planner.calculate(&input, &mut path).expect("a path within the limits");
        let duration_s = path.get_duration() * unit_s;
        Self { path, from: position, unit, unit_s, duration_s }
    }

    /// Position, speed and acceleration at a time.
    pub(crate) fn at(&self, time_s: f64) -> [f64; 3] {
        let zero = || rsruckig::util::DataArrayOrVec::<f64, 1>::new(None, 0.0);
        let mut state = [zero(), zero(), zero()];
        let [position, speed, acceleration] = &mut state;
        let time = time_s / self.unit_s;
        self.path.at_time(time, &mut Some(position), &mut Some(speed), &mut Some(acceleration), &mut None, &mut None);
        let [position, speed, acceleration] = state.map(|value| value[0] * self.unit);
        [self.from + position, speed / self.unit_s, acceleration / (self.unit_s * self.unit_s)]
    }
}
