//! State shared by the tasks. Every access is one short critical section; no task can make another wait for longer.

use core::{cell::RefCell, future::Future, pin::pin, task::Context};

use embassy_sync::{
    blocking_mutex::{Mutex, raw::RawMutex},
    signal::Signal,
};
use embassy_time::{Duration, Instant};
use heapless::Vec;
use r4_protocol::{
    Cause, Causes, DeviceStats, HotWinding, ImageInfo, Mode, PathPoint, Quality, Refusal, SafetyState, Setpoint,
    Winding,
    channel::MAX_QUANTITIES,
    config::{
        ANALOG_INPUTS, BoardConfig, DAC_OUTPUTS, ENCODERS, MAX_BLDCS, MAX_MOTORS, MAX_RELAYS, MAX_SENSORS, MAX_SERVOS,
        MAX_SUPPLIES, MotorConfig, PidGains, Place, RANGE_SENSORS, STEPPERS, SWITCHES, Tuning,
    },
};

use crate::{
    channel::resolution,
    log::Log,
    passthrough::Passthrough,
    path::{Leg, Limits, Path},
    ranging,
    safety::{Event, Safety, stop::BrakingStop},
    sensing::range::RangeReading,
    storage::Storage,
};

/// Cause of the processor's start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResetCause {
    /// Power, reset pin or a deliberate restart.
    Normal,
    /// Watchdog reset: the firmware hung.
    Watchdog,
    /// The clock failed, and the processor reset itself.
    Clock,
    /// The firmware failed several times in a row: only links run, and outputs are held safe.
    RepeatedBadStarts,
    /// The image in flash differs from the built one: only links run, as above.
    DamagedImage,
}

impl ResetCause {
    /// Cause that trips the board from its start on; `None` after a start that is no trip.
    #[must_use]
    pub const fn cause(self) -> Option<Cause> {
        match self {
            Self::Normal => None,
            Self::Watchdog => Some(Cause::WatchdogReset),
            Self::Clock => Some(Cause::ClockFault),
            Self::RepeatedBadStarts => Some(Cause::RepeatedBadStarts),
            Self::DamagedImage => Some(Cause::DamagedImage),
        }
    }

    /// Returns true if only links run until the next start.
    const fn holds(self) -> bool {
        matches!(self, Self::RepeatedBadStarts | Self::DamagedImage)
    }
}

/// Program that a board starts when it restarts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Restart {
    /// This same firmware again.
    Firmware,
    /// The bootloader, which waits for another image.
    Bootloader,
}

/// Status of a motor or stepper, as published by the control loop each period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorStatus {
    /// Set point that it follows.
    pub setpoint: Setpoint,
    /// Position, in counts of the channel's resolution.
    pub position: i32,
    /// Speed, in rad/s or m/s.
    pub speed: f32,
    /// Duty: share of the supply at the bridge.
    pub duty: f32,
    /// True at the set point and at rest; in position mode only.
    pub settled: bool,
    /// True if the position is known, and not only counted from power-on.
    pub homed: bool,
    /// Heat of its winding; `None` where it is not computed.
    pub winding: Option<Winding>,
}

impl MotorStatus {
    pub(crate) const IDLE: Self = Self {
        setpoint: Setpoint::NONE,
        position: 0,
        speed: 0.0,
        duty: 0.0,
        settled: false,
        homed: false,
        winding: None,
    };
}

/// Present status of a channel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Status {
    Motor(MotorStatus),
    Scalar(f32),
    Encoder { position: i32, speed: f32, illegal: u32 },
    Reading { value: f32, quality: Quality, taken: Instant },
    Sensor { values: [f32; MAX_QUANTITIES], quality: Quality, taken: Instant },
}

/// State of the supervisor, for the other tasks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SafetyView {
    pub(crate) state: SafetyState,
    pub(crate) causes: Causes,
    /// Counter of armings, so that a command from before the last arming cannot be carried out after it.
    pub(crate) epoch: u16,
    /// True while motors are braked before they are switched off: see [`BrakingStop`].
    pub(crate) braking: bool,
}

/// Number of command slots; a brake is commanded beside its drive.
const OUTPUTS: usize = MAX_MOTORS + 2 * MAX_BLDCS + MAX_SERVOS + STEPPERS + MAX_RELAYS + DAC_OUTPUTS;
/// Maximum number of channels of a board, dead-man's handle and auxiliary stop included.
const CHANNELS: usize =
    OUTPUTS - MAX_BLDCS + ENCODERS + SWITCHES + RANGE_SENSORS + ANALOG_INPUTS + MAX_SUPPLIES + MAX_SENSORS + 2;

/// Index of a channel's status. Outputs come first, and their commands have the same index.
fn slot(place: Place) -> usize {
    const BLDC: usize = MAX_MOTORS;
    const SERVO: usize = BLDC + MAX_BLDCS;
    const STEPPER: usize = SERVO + MAX_SERVOS;
    const RELAY: usize = STEPPER + STEPPERS;
    const DAC: usize = RELAY + MAX_RELAYS;
    const ENCODER: usize = DAC + DAC_OUTPUTS;
    const SWITCH: usize = ENCODER + ENCODERS;
    const RANGE: usize = SWITCH + SWITCHES;
    const ANALOG: usize = RANGE + RANGE_SENSORS;
    const SUPPLY: usize = ANALOG + ANALOG_INPUTS;
    const SENSOR: usize = SUPPLY + MAX_SUPPLIES;
    const DEAD_MAN: usize = SENSOR + MAX_SENSORS;
    match place {
        Place::Motor(index) => index,
        Place::Bldc(index) => BLDC + index,
        Place::Servo(index) => SERVO + index,
        Place::Stepper(index) => STEPPER + index,
        Place::Relay(index) => RELAY + index,
        Place::Dac(index) => DAC + index,
        Place::Encoder(index) => ENCODER + index,
        Place::Switch(index) => SWITCH + index,
        Place::Range(index) => RANGE + index,
        Place::Analog(index) => ANALOG + index,
        Place::Supply(index) => SUPPLY + index,
        Place::Sensor(index) => SENSOR + index,
        Place::DeadMan(index) => DEAD_MAN + index,
    }
}

/// Index of an output's newest command; brakes come behind all others, so that the next speed does not replace a brake
/// command.
fn command_slot(place: Place, mode: Mode) -> usize {
    match (place, mode) {
        (Place::Bldc(index), Mode::Brake) => OUTPUTS - MAX_BLDCS + index,
        _ => slot(place),
    }
}

/// Set of outputs: one bit per command slot.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Commanded(u64);

const _: () = assert!(OUTPUTS <= u64::BITS as usize, "a bit for each slot");

impl Commanded {
    /// Returns true if an output has a command; for a brushless drive, one other than to its brake.
    pub(crate) fn has(self, place: Place) -> bool {
        self.has_slot(slot(place))
    }

    /// Returns true if the brake of a brushless drive has a command.
    pub(crate) fn has_brake(self, bldc: usize) -> bool {
        self.has_slot(command_slot(Place::Bldc(bldc), Mode::Brake))
    }

    /// Indices of those of `count` outputs that have a command; `first` is the first of their kind.
    pub(crate) fn among(self, first: Place, count: usize) -> impl Iterator<Item = usize> {
        let mut left = (self.0 >> slot(first)) as u32;
        let indices = core::iter::from_fn(move || {
            let index = left.trailing_zeros();
            left &= left.checked_sub(1)?;
            Some(index as usize)
        });
        indices.take_while(move |index| *index < count)
    }

    fn has_slot(self, slot: usize) -> bool {
        self.0 >> slot & 1 != 0
    }
}

/// Session of the board's single host.
#[derive(Clone, Copy, Debug)]
struct Session {
    id: u16,
    link: u8,
    last_heartbeat: Instant,
}

/// Set point that was accepted.
#[derive(Clone, Copy, Debug)]
struct Given {
    setpoint: Setpoint,
    /// Time of the host's decision, on the board's clock, µs; limited to its arrival, because a date ahead must not
    /// make all following ones look older.
    sent_us: u64,
    /// Date that it came with, µs.
    dated_us: u64,
}

/// Lease of a cycle's set point: followed until then, unless another comes.
#[derive(Clone, Copy, Debug)]
struct Lease {
    place: Place,
    mode: Mode,
    until: Instant,
}

/// Maximum number of leases: all channels that cycles can move.
const LEASES: usize = MAX_MOTORS + MAX_BLDCS + STEPPERS;

struct State {
    safety: Safety,
    epoch: u16,
    /// Time for which a stop may brake, and the present braking stop.
    brake: Duration,
    braking_stop: Option<BrakingStop>,
    /// Causes present at the supervisor's last pass.
    present: Causes,
    /// Causes present at the control loop's last period.
    control_causes: Causes,
    /// Causes that the processor's own detectors report.
    processor_causes: Causes,
    /// Time of the last control tick; `None` until the control loop runs.
    last_tick: Option<Instant>,
    session: Option<Session>,
    next_session: u16,
    /// Newest command of each output, with the epoch of its arming.
    commands: [Option<(u16, Setpoint)>; OUTPUTS],
    /// Set of outputs that have a command.
    commanded: Commanded,
    /// Newest set point that each output was given in this arming.
    given: [Option<Given>; OUTPUTS],
    /// Leases, at most one for each channel.
    leases: Vec<Lease, LEASES>,
    /// Paths, one for each motor.
    paths: [Path; MAX_MOTORS],
    /// New gains of the position and of the speed loop.
    gains: [[Option<PidGains>; 2]; MAX_MOTORS],
    tunings: [Option<Tuning>; MAX_MOTORS],
    started: bool,
    /// True if only links run; the starting code then holds the outputs safe.
    held: bool,
    ranges: [RangeReading; RANGE_SENSORS],
    /// Number of trips since the start, and the causes of the last one.
    trips: u32,
    trip_causes: Causes,
    /// Number of operations that must not run while outputs move, and therefore prevent arming.
    arming_held: u8,
    /// Configuration as changed by hosts; takes effect at the next start, if it is saved.
    pending: BoardConfig,
    statuses: [Status; CHANNELS],
    /// Time of the measurement of the positions in `statuses`.
    measured: Instant,
    stats: DeviceStats,
}

/// State that the tasks of one board share.
pub struct Shared<M: RawMutex> {
    config: BoardConfig,
    built_in: BoardConfig,
    state: Mutex<M, RefCell<State>>,
    /// Wakes the supervisor: the state has changed or must be checked.
    pub(crate) supervisor: Signal<M, ()>,
    /// Wakes the control loop out of turn: outputs must be made safe.
    pub(crate) make_safe: Signal<M, ()>,
    restart: Signal<M, Restart>,
    /// Storage over a restart; [`crate::storage::run`] serves it.
    pub storage: Storage<M>,
    /// Raw access to connectors; its own task serves it.
    pub passthrough: Passthrough<M>,
    log: Option<Log>,
    image: Option<ImageInfo>,
}

impl<M: RawMutex> Shared<M> {
    /// Creates the state of a board that has just started with `config`: its `built_in` configuration with the saved
    /// changes (see [`crate::storage::parameters::load`]).
    #[must_use]
    pub fn new(config: BoardConfig, built_in: BoardConfig, reset: ResetCause) -> Self {
        let safety = match reset.cause() {
            None => Safety::Disarmed,
            Some(cause) => Safety::Tripped { causes: Causes::only(cause) },
        };
        let valid = config.validate().is_ok();
        let mut statuses = [Status::Scalar(0.0); CHANNELS];
        for (_, place) in config.channels() {
            statuses[slot(place)] = match place {
                Place::Motor(_) | Place::Stepper(_) => Status::Motor(MotorStatus::IDLE),
                Place::Encoder(_) => Status::Encoder { position: 0, speed: 0.0, illegal: 0 },
                // A board that drives nothing gives no pulses.
                Place::Servo(_) if !valid => Status::Scalar(f32::NAN),
                Place::Range(_) | Place::Analog(_) => {
                    Status::Reading { value: 0.0, quality: Quality::None, taken: Instant::now() }
                }
                Place::Sensor(_) => {
                    Status::Sensor { values: [0.0; MAX_QUANTITIES], quality: Quality::None, taken: Instant::now() }
                }
                _ => Status::Scalar(0.0),
            };
        }
        let mut control_causes = Causes::NONE;
        control_causes.set(Cause::BadConfiguration, !valid);
        // This cause is never removed: such a board cannot be armed before its next start.
        if let (true, Some(cause)) = (reset.holds(), reset.cause()) {
            control_causes.set(cause, true);
        }
        Self {
            built_in,
            state: Mutex::new(RefCell::new(State {
                safety,
                epoch: 0,
                brake: Duration::from_millis(config.stop_brake_ms().into()),
                braking_stop: None,
                present: control_causes,
                control_causes,
                processor_causes: Causes::NONE,
                last_tick: None,
                session: None,
                next_session: FIRST_SESSION,
                commands: [None; OUTPUTS],
                commanded: Commanded::default(),
                given: [None; OUTPUTS],
                leases: Vec::new(),
                paths: Default::default(),
                gains: [[None; 2]; MAX_MOTORS],
                tunings: [None; MAX_MOTORS],
                started: false,
                held: reset.holds(),
                // Silence counts from now on, and not from time 0.
                ranges: [RangeReading { updated: Instant::now(), ..RangeReading::NONE }; RANGE_SENSORS],
                trips: u32::from(reset.cause().is_some()),
                trip_causes: safety.causes(),
                arming_held: 0,
                pending: config.clone(),
                statuses,
                measured: Instant::MIN,
                stats: DeviceStats::default(),
            })),
            config,
            supervisor: Signal::new(),
            make_safe: Signal::new(),
            restart: Signal::new(),
            storage: Storage::new(),
            passthrough: Passthrough::new(),
            log: None,
            image: None,
        }
    }

    /// Adds the log of a board.
    #[must_use]
    pub fn with_log(mut self, log: Log) -> Self {
        self.log = Some(log);
        self
    }

    /// Adds the description of the image in flash.
    #[must_use]
    pub fn with_image(mut self, image: ImageInfo) -> Self {
        self.image = Some(image);
        self
    }

    pub(crate) fn image(&self) -> Result<ImageInfo, Refusal> {
        self.image.ok_or(Refusal::NoImage)
    }

    pub(crate) fn log(&self) -> Option<&Log> {
        self.log.as_ref()
    }

    /// Configuration of the board.
    #[must_use]
    pub fn config(&self) -> &BoardConfig {
        &self.config
    }

    fn with<T>(&self, f: impl FnOnce(&mut State) -> T) -> T {
        self.state.lock(|state| f(&mut state.borrow_mut()))
    }

    // Safety state.

    pub(crate) fn safety(&self) -> SafetyView {
        self.with(|s| SafetyView {
            state: s.safety.state(),
            causes: s.safety.causes(),
            epoch: s.epoch,
            braking: s.braking_stop.is_some(),
        })
    }

    /// Returns true if the state differs from `view`. Otherwise the control loop's task, of `context`, is woken when it
    /// has to make outputs safe.
    pub(crate) fn has_changed(&self, view: SafetyView, context: &mut Context<'_>) -> bool {
        loop {
            let signalled = pin!(self.make_safe.wait()).poll(context).is_ready();
            if self.safety() != view {
                // Signal again, since the wait consumed it: the control loop checks once more when its period is over.
                self.make_safe.signal(());
                return true;
            }
            if !signalled {
                return false;
            }
        }
    }

    /// Sets the initial state of a test.
    #[cfg(test)]
    pub(crate) fn set_safety(&self, safety: Safety) {
        self.with(|s| s.safety = safety);
    }

    /// Applies `event` to the state machine with the present causes, and wakes the tasks that must react to a change.
    pub(crate) fn request(&self, event: Event) -> Result<(), Refusal> {
        let (changed, result) = self.with(|s| s.apply(event));
        if changed {
            self.supervisor.signal(());
            self.make_safe.signal(());
        }
        result
    }

    /// Sets or clears a cause that the processor's own detectors report; may be called by interrupts.
    pub fn set_processor_cause(&self, cause: Cause, present: bool) {
        self.with(|s| s.processor_causes.set(cause, present));
        if present {
            self.trip(cause);
        }
    }

    /// Trips for a cause that is over at once.
    pub(crate) fn trip(&self, cause: Cause) {
        // A trip is never refused.
        let _ = self.request(Event::Trip(Causes::only(cause)));
    }

    /// Runs the supervisor's pass: `watched` are the causes that it detects itself; those of the other tasks are added
    /// here.
    pub(crate) fn supervise(&self, mut watched: Causes, now: Instant) -> SafetyView {
        let link_timeout = Duration::from_millis(self.config.link_timeout_ms.into());
        let overrun = Duration::from_micros(u64::from(self.config.control_period_us) * CONTROL_OVERRUN_PERIODS);
        let changed = self.with(|s| {
            let link_lost = s.session.is_some_and(|session| since(session.last_heartbeat, now) > link_timeout);
            watched.set(Cause::LinkLost, link_lost);
            watched.set(Cause::ControlOverrun, s.last_tick.is_some_and(|tick| since(tick, now) > overrun));
            watched.set(Cause::Proximity, ranging::must_stop(&self.config.ranges, &s.ranges, now));
            s.present = watched.union(s.control_causes).union(s.processor_causes);
            // The deadline of a braking stop is checked here, independently of the control loop.
            s.apply(Event::Tick).0
        });
        if changed {
            self.make_safe.signal(());
        }
        self.safety()
    }

    // Control loop.

    /// Records that the brakes of the stop which ended the arming `epoch` are written. No effect if that stop is over.
    pub(crate) fn brakes_written(&self, epoch: u16) {
        self.with(|s| {
            if s.epoch == epoch {
                s.braking_stop = s.braking_stop.map(BrakingStop::written);
            }
        });
    }

    pub(crate) fn control_tick(&self, now: Instant) {
        self.with(|s| s.last_tick = Some(now));
    }

    /// Records that the control loop sets up chips, which takes longer than a period; nothing is driven until its next
    /// tick.
    pub(crate) fn control_pauses(&self) {
        self.with(|s| s.last_tick = None);
    }

    pub(crate) fn set_control_causes(&self, causes: Causes) {
        let new = self.with(|s| {
            let new = causes.bits() & !s.control_causes.bits() != 0;
            s.control_causes = causes;
            new
        });
        if new {
            self.supervisor.signal(());
        }
    }

    /// Publishes the reading of a range sensor; wakes the supervisor when it is a reason to stop.
    pub fn publish_range(&self, index: usize, reading: RangeReading) {
        let taken = reading.measured.unwrap_or(Instant::MIN);
        self.with(|s| s.ranges[index] = reading);
        let status = Status::Reading { value: reading.distance_m, quality: reading.quality, taken };
        self.publish(Place::Range(index), status);
        if reading.stop {
            self.supervisor.signal(());
        }
    }

    /// Takes the newest command of this arming; one of a later arming is left for the next period.
    pub(crate) fn take_command(&self, output: Place, epoch: u16) -> Option<Setpoint> {
        self.take_from(slot(output), epoch)
    }

    /// Takes the newest command to the brake of a brushless drive, like [`Shared::take_command`].
    pub(crate) fn take_brake(&self, bldc: usize, epoch: u16) -> Option<bool> {
        self.take_from(command_slot(Place::Bldc(bldc), Mode::Brake), epoch).map(|setpoint| setpoint.value != 0.0)
    }

    /// Returns the outputs that have a command now, of any arming. Later commands show at the next call.
    pub(crate) fn commanded(&self) -> Commanded {
        self.with(|s| s.commanded)
    }

    fn take_from(&self, slot: usize, epoch: u16) -> Option<Setpoint> {
        let taken = self.with(|s| {
            let taken = s.commands[slot].take_if(|(given, _)| *given == epoch);
            // A command of a later arming than the caller's is still to be taken.
            if s.commands[slot].is_none() {
                s.commanded.0 &= !(1 << slot);
            }
            taken
        });
        taken.map(|(_, setpoint)| setpoint)
    }

    /// Commands those channels to rest whose cycles have stopped coming.
    pub(crate) fn end_leases(&self, now: Instant) {
        self.with(|s| {
            while let Some(place) = s.leases.iter().position(|lease| lease.until < now) {
                let Lease { place, mode, .. } = s.leases.swap_remove(place);
                // Cannot fail: leases are of the present arming.
                let _ = s.command(place, at_rest(mode), now.as_micros());
                s.stats.setpoints_expired = s.stats.setpoints_expired.wrapping_add(1);
            }
        });
    }

    /// Segment of a motor's path at `now_us`.
    pub(crate) fn leg(&self, motor: usize, now_us: u64) -> Leg {
        self.with(|s| s.paths[motor].leg(now_us))
    }

    /// Takes the next new gains of some motor's loop; `None` without any.
    pub(crate) fn take_gains(&self) -> Option<(usize, Mode, PidGains)> {
        self.with(|s| {
            let (index, slot) = s.gains.as_flattened_mut().iter_mut().enumerate().find(|(_, gains)| gains.is_some())?;
            let mode = if index % 2 == 0 { Mode::Position } else { Mode::Speed };
            slot.take().map(|gains| (index / 2, mode, gains))
        })
    }

    /// Takes the next new tuning of some motor; `None` without any.
    pub(crate) fn take_tuning(&self) -> Option<(usize, Tuning)> {
        self.with(|s| {
            let (index, slot) = s.tunings.iter_mut().enumerate().find(|(_, tuning)| tuning.is_some())?;
            slot.take().map(|tuning| (index, tuning))
        })
    }

    /// Records that the outputs are in a known state, or could not be brought into one; hosts may be answered.
    pub(crate) fn set_started(&self) {
        self.with(|s| s.started = true);
    }

    /// Returns true if outputs are in a known state and every range sensor that can stop the board has reported.
    pub(crate) fn has_started(&self) -> bool {
        self.with(|s| {
            let guards = self.config.ranges.iter().zip(&s.ranges).filter(|(range, _)| range.stop_below_m.is_some());
            s.held || s.started && guards.into_iter().all(|(_, reading)| reading.quality != Quality::None)
        })
    }

    /// All causes of the last trip, also when it has been cleared since.
    #[must_use]
    pub fn trip_causes(&self) -> Causes {
        self.with(|s| s.trip_causes)
    }

    /// Number of trips since the start of the board.
    #[must_use]
    pub fn trips(&self) -> u32 {
        self.with(|s| s.trips)
    }

    pub(crate) fn publish(&self, place: Place, status: Status) {
        self.with(|s| s.statuses[slot(place)] = status);
    }

    /// Publishes all statuses of a kind, from `first` on, in one critical section; computing them must be short.
    pub(crate) fn publish_each(&self, first: Place, statuses: impl Iterator<Item = Status>) {
        self.with(|s| {
            let mut slots = s.statuses[slot(first)..].iter_mut();
            statuses.for_each(|status| {
                if let Some(slot) = slots.next() {
                    *slot = status;
                }
            });
        });
    }

    /// Sets the time at which the sensors of the published motor statuses were read.
    pub(crate) fn set_measured(&self, measured: Instant) {
        self.with(|s| s.measured = measured);
    }

    /// Time at which the values of [`Shared::status`] were measured; `now` once measurements have stopped.
    pub(crate) fn measured(&self, now: Instant) -> Instant {
        let longest = Duration::from_micros(u64::from(self.config.control_period_us) * CONTROL_OVERRUN_PERIODS);
        let measured = self.with(|s| s.measured);
        if since(measured, now) > longest { now } else { measured }
    }

    pub(crate) fn status(&self, place: Place) -> Status {
        self.with(|s| s.statuses[slot(place)])
    }

    /// Motors whose windings are close to their limit, in the order of the configuration.
    pub(crate) fn hot_windings(&self) -> Vec<HotWinding, MAX_MOTORS> {
        let motors = self.config.motors.iter().enumerate();
        self.with(|s| {
            let hot = motors.filter_map(|(index, motor)| match s.statuses[slot(Place::Motor(index))] {
                Status::Motor(MotorStatus { winding: Some(Winding { heat_percent, hot: true }), .. }) => {
                    Some(HotWinding { channel: motor.id, heat_percent })
                }
                _ => None,
            });
            hot.collect()
        })
    }

    pub(crate) fn count(&self, f: impl FnOnce(&mut DeviceStats)) {
        self.with(|s| f(&mut s.stats));
    }

    // Configuration and restart.

    /// Configuration that the firmware was built with.
    pub(crate) fn built_in(&self) -> &BoardConfig {
        &self.built_in
    }

    /// Configuration as changed by hosts.
    pub(crate) fn pending(&self) -> BoardConfig {
        self.with(|s| s.pending.clone())
    }

    /// Sets the changed configuration. If two hosts change it at once, the later wins.
    pub(crate) fn set_pending(&self, config: BoardConfig) {
        self.with(|s| s.pending = config);
    }

    /// Prevents arming for the lifetime of the result.
    ///
    /// # Errors
    /// [`Refusal::NotWhile`] while the board is armed.
    pub(crate) fn hold_arming(&self) -> Result<ArmingHeld<'_, M>, Refusal> {
        self.with(|s| match s.safety {
            Safety::Armed => Err(Refusal::NotWhile { state: SafetyState::Armed }),
            Safety::Disarmed | Safety::Tripped { .. } => {
                s.arming_held = s.arming_held.saturating_add(1);
                Ok(())
            }
        })?;
        Ok(ArmingHeld(self))
    }

    /// Requests a restart of the board, which cannot be armed any more.
    ///
    /// # Errors
    /// [`Refusal::NotWhile`] while it is armed, [`Refusal::NoBootloader`] without a bootloader that started the image.
    pub(crate) fn restart(&self, restart: Restart) -> Result<(), Refusal> {
        if restart == Restart::Bootloader && !self.image.is_some_and(|image| image.hosted) {
            return Err(Refusal::NoBootloader);
        }
        core::mem::forget(self.hold_arming()?);
        self.restart.signal(restart);
        Ok(())
    }

    /// Waits for a host's request to restart, which is accepted only while the board is not armed.
    pub async fn restart_requested(&self) -> Restart {
        self.restart.wait().await
    }

    // Links and sessions.

    /// Records the counters of the CAN controller: how often it was off the bus, and how often its error counters
    /// reached the warning limit.
    pub fn note_can(&self, bus_off: u32, warnings: u32) {
        self.count(|stats| (stats.can_bus_off, stats.can_warnings) = (bus_off, warnings));
    }

    pub(crate) fn stats(&self) -> DeviceStats {
        self.with(|s| s.stats)
    }

    /// Stores a command, decided at `sent_us`, for the control loop's next period; a later one replaces it.
    pub(crate) fn command(&self, output: Place, setpoint: Setpoint, sent_us: u64) -> Result<(), Refusal> {
        self.with(|s| s.command(output, setpoint, sent_us))
    }

    /// Stops `output` because a set point for it, decided at `sent_us`, was refused: the host no longer wants the one
    /// in force. An output that follows a set point decided later goes on, so that an old frame that comes late or
    /// twice stops nothing. If the refused one has `expired`, an equal date means the same set point, and the output
    /// goes on, too.
    ///
    /// Only for requests of the link that holds the session: no other link commands outputs, but any link may stop the
    /// whole board.
    pub(crate) fn withdraw(&self, output: Place, sent_us: u64, expired: bool) {
        self.with(|s| {
            let Some(given) = s.given(output) else { return };
            let superseded = if expired { sent_us <= given.dated_us } else { sent_us < given.sent_us };
            if superseded {
                return;
            }
            if let Some(stop) = self.stop_of(output, given.setpoint, s.statuses[slot(output)]) {
                // The error is ignored: nothing is in force unless the board is armed.
                let _ = s.command(output, stop, sent_us);
            }
        });
    }

    /// Set point that stops `output`, which follows `follows` and has `status`; `None` when `follows` itself is a stop.
    fn stop_of(&self, output: Place, follows: Setpoint, status: Status) -> Option<Setpoint> {
        let setpoint = |mode, value| Some(Setpoint { mode, value });
        match (output, status) {
            (Place::Motor(_), _) => Some(at_rest(follows.mode)),
            (Place::Stepper(_), _) => setpoint(Mode::Speed, 0.0),
            // Neutral would release the brake.
            (Place::Bldc(_), _) if follows.mode == Mode::Brake && follows.value != 0.0 => None,
            (Place::Bldc(_), _) => setpoint(Mode::Duty, 0.0),
            // The present angle, on its way.
            (Place::Servo(_), Status::Scalar(angle_rad)) => setpoint(Mode::Position, angle_rad),
            // Open and at the safe voltage, as in the safe state.
            (Place::Relay(_), _) => setpoint(Mode::Switch, 0.0),
            (Place::Dac(index), _) => setpoint(Mode::Voltage, self.config.dacs[index].safe_v),
            _ => None,
        }
    }

    /// Stores the commands of a cycle, each as [`Shared::command`] does, with a lease until `until`. Points of paths,
    /// dated `sent_us`, need no lease: a path ends by itself.
    pub(crate) fn lease(&self, setpoints: &[(Place, Setpoint)], sent_us: u64, until: Instant) -> Result<(), Refusal> {
        let is_point = |setpoint: &Setpoint| setpoint.mode == Mode::Follow;
        let point = |setpoint: &Setpoint| at(sent_us, setpoint.value);
        self.with(|s| {
            // Check all points before any is stored, so that all are taken or none.
            for (place, setpoint) in setpoints.iter().filter(|(_, setpoint)| is_point(setpoint)) {
                self.check_path(s, *place, &[point(setpoint)])?;
            }
            for (place, setpoint) in setpoints {
                if is_point(setpoint) {
                    s.follow(*place, &[point(setpoint)], sent_us)?;
                    continue;
                }
                s.command(*place, *setpoint, sent_us)?;
                // There is room for every channel, and the command has ended the channel's previous lease.
                let _ = s.leases.push(Lease { place: *place, mode: setpoint.mode, until });
            }
            Ok(())
        })
    }

    /// Adds points of a path, decided at `sent_us`, whose numbers were checked, to a motor's path: all of them, or
    /// none.
    pub(crate) fn follow(&self, output: Place, points: &[PathPoint], sent_us: u64) -> Result<(), Refusal> {
        self.with(|s| {
            self.check_path(s, output, points)?;
            s.follow(output, points, sent_us)
        })
    }

    /// Checks that the motor's path can take `points` now.
    fn check_path(&self, state: &State, output: Place, points: &[PathPoint]) -> Result<(), Refusal> {
        let Place::Motor(index) = output else { return Ok(()) };
        let MotorConfig { id: channel, control, .. } = self.config.motors[index];
        let (Some(control), Status::Motor(MotorStatus { position, .. })) = (control, state.statuses[slot(output)])
        else {
            return Err(Refusal::WrongMode { channel, mode: Mode::Follow });
        };
        let position = position as f32 * resolution(control.feedback);
        let now_us = Instant::now().as_micros();
        state.paths[index].check(points, &Limits { channel, position, speed_max: control.speed_max, now_us })
    }

    /// Stores gains for the control loop's next period, armed or not. An open-loop duty has none.
    pub(crate) fn change_gains(&self, motor: usize, mode: Mode, gains: PidGains) {
        self.with(|s| match mode {
            Mode::Position => s.gains[motor][0] = Some(gains),
            Mode::Speed => s.gains[motor][1] = Some(gains),
            _ => {}
        });
    }

    /// Stores a tuning for the control loop's next period, armed or not.
    pub(crate) fn change_tuning(&self, motor: usize, tuning: Tuning) {
        self.with(|s| s.tunings[motor] = Some(tuning));
    }

    /// Opens a session for `link`, and closes the previous session of that link.
    ///
    /// # Errors
    /// [`Refusal::InUse`] while another link's session is alive.
    pub(crate) fn open_session(&self, link: u8, now: Instant) -> Result<u16, Refusal> {
        let timeout = Duration::from_millis(self.config.link_timeout_ms.into());
        self.with(|s| match s.session {
            Some(session) if session.link != link && since(session.last_heartbeat, now) <= timeout => {
                Err(Refusal::InUse)
            }
            _ => Ok(()),
        })?;
        // A new host does not know what the last one left running.
        self.request(Event::Disarm)?;
        Ok(self.with(|s| {
            let id = s.next_session;
            s.next_session = id.wrapping_add(1);
            s.session = Some(Session { id, link, last_heartbeat: now });
            id
        }))
    }

    /// Returns true if `link` holds the session.
    pub(crate) fn has_session(&self, link: u8) -> bool {
        self.with(|s| s.session.is_some_and(|session| session.link == link))
    }

    /// Returns true if a host is connected.
    pub(crate) fn has_host(&self) -> bool {
        let timeout = Duration::from_millis(self.config.link_timeout_ms.into());
        self.heartbeat_age().is_some_and(|age| age <= timeout)
    }

    /// Time since the host's last heartbeat; `None` without a session.
    pub(crate) fn heartbeat_age(&self) -> Option<Duration> {
        let now = Instant::now();
        self.with(|s| s.session.map(|session| since(session.last_heartbeat, now)))
    }

    /// Takes a heartbeat; false when it belongs to no open session.
    pub(crate) fn heartbeat(&self, link: u8, id: u16, now: Instant) -> bool {
        self.with(|s| match &mut s.session {
            Some(session) if session.link == link && session.id == id => {
                session.last_heartbeat = now;
                true
            }
            _ => false,
        })
    }

    /// Closes the session of `link`, and disarms.
    pub(crate) fn close_session(&self, link: u8) {
        if self.has_session(link) {
            // Disarming is never refused.
            let _ = self.request(Event::Disarm);
            self.with(|s| s.session = None);
        }
    }
}

/// Set point that stops a motor, by the mode that it followed.
const fn at_rest(mode: Mode) -> Setpoint {
    match mode {
        // A motor in force mode stays in its place, and so holds the object.
        Mode::Position | Mode::Speed | Mode::Home | Mode::Follow | Mode::Force => {
            Setpoint { mode: Mode::Speed, value: 0.0 }
        }
        _ => Setpoint::NONE,
    }
}

/// Guard returned by [`Shared::hold_arming`].
pub(crate) struct ArmingHeld<'s, M: RawMutex>(&'s Shared<M>);

impl<M: RawMutex> Drop for ArmingHeld<'_, M> {
    fn drop(&mut self) {
        self.0.with(|s| s.arming_held = s.arming_held.saturating_sub(1));
    }
}

/// Time from `then` to `now`; zero when another task has already seen a later moment.
fn since(then: Instant, now: Instant) -> Duration {
    now.saturating_duration_since(then)
}

/// Point of a path for a single set point.
pub(crate) const fn at(at_us: u64, position: f32) -> PathPoint {
    PathPoint { at_us, position, speed: None, feed_forward: 0.0 }
}

/// Number of the first session since the board started.
const FIRST_SESSION: u16 = 1;
/// Number of periods without a tick after which the control loop counts as dead.
const CONTROL_OVERRUN_PERIODS: u64 = 5;

impl State {
    /// Stores a command and ends the lease of its channel: the newest command counts.
    fn command(&mut self, output: Place, setpoint: Setpoint, dated_us: u64) -> Result<(), Refusal> {
        if self.safety != Safety::Armed {
            return Err(Refusal::NotArmed { state: self.safety.state() });
        }
        self.leases.retain(|lease| lease.place != output);
        if let (Place::Motor(index), true) = (output, setpoint.mode != Mode::Follow) {
            self.paths[index].clear();
        }
        let slot = command_slot(output, setpoint.mode);
        self.commands[slot] = Some((self.epoch, setpoint));
        self.commanded.0 |= 1 << slot;
        let sent_us = dated_us.min(Instant::now().as_micros());
        self.given[slot] = Some(Given { setpoint, sent_us, dated_us });
        Ok(())
    }

    /// Adds `points`, which were checked, to the motor's path, and lets it follow that.
    fn follow(&mut self, output: Place, points: &[PathPoint], dated_us: u64) -> Result<(), Refusal> {
        let (Place::Motor(index), Some(last)) = (output, points.last()) else { return Ok(()) };
        self.command(output, Setpoint { mode: Mode::Follow, value: last.position }, dated_us)?;
        self.paths[index].splice(points, Instant::now().as_micros());
        Ok(())
    }

    /// Newest set point that `output`, or its brake, was given in this arming.
    fn given(&self, output: Place) -> Option<Given> {
        let slots = [command_slot(output, Mode::Duty), command_slot(output, Mode::Brake)];
        slots.into_iter().filter_map(|slot| *self.given.get(slot)?).max_by_key(|given| given.sent_us)
    }

    /// Applies `event` to the state machine; returns true if the state changed, and the refusal, if any.
    fn apply(&mut self, event: Event) -> (bool, Result<(), Refusal>) {
        let arms = event == Event::Arm && self.safety == Safety::Disarmed && self.present.is_empty();
        if arms && self.arming_held > 0 {
            return (false, Err(Refusal::Busy));
        }
        let (next, result) = self.safety.next(event, self.present);
        let changed = next.state() != self.safety.state();
        let was_braking = self.braking_stop.is_some();
        // A cause present at power-on, before any host could have armed the board, is not recorded as a trip; otherwise
        // a released handle would push out the recorded ones.
        let heard_of = self.next_session != FIRST_SESSION;
        let trips = changed && next.state() == SafetyState::Tripped && heard_of;
        self.trips = self.trips.wrapping_add(trips.into());
        if changed && next == Safety::Armed {
            self.epoch = self.epoch.wrapping_add(1);
            self.commands = [None; OUTPUTS];
            self.commanded = Commanded::default();
            self.given = [None; OUTPUTS];
            self.leases.clear();
            self.paths.iter_mut().for_each(Path::clear);
        }
        if next.state() == SafetyState::Tripped {
            self.trip_causes = next.causes();
        }
        let now = Instant::now();
        self.braking_stop = match (self.safety, next) {
            (_, Safety::Armed) => None,
            (Safety::Armed, _) => BrakingStop::begin(self.brake, next.causes(), now),
            // A cause that was cleared meanwhile does not matter: it cannot have been one that forbids braking.
            _ => self.braking_stop.filter(|stop| stop.goes_on(next.causes(), now)),
        };
        self.safety = next;
        let brake_ended = was_braking && self.braking_stop.is_none();
        (changed || brake_ended, result)
    }
}

#[cfg(test)]
mod tests;
