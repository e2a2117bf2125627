//! What the tasks share. Every access is one short critical section; no task can make another wait for longer.

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
    control::motor::resolution,
    cycle::at_rest,
    log::Log,
    passthrough::Passthrough,
    path::{Leg, Limits, Path},
    ranging,
    safety::{Event, Safety, stop::BrakingStop},
    sensing::range::RangeReading,
    storage::Storage,
};

/// Why the processor started.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResetCause {
    /// Power, reset pin or a deliberate restart.
    Normal,
    /// A watchdog bit: the firmware hung.
    Watchdog,
    /// The clock failed, and the processor reset itself.
    Clock,
    /// The firmware ended badly several times in a row: nothing runs but links, and outputs are only held safe.
    RepeatedBadStarts,
    /// The image in flash is not what was built: as above.
    DamagedImage,
}

impl ResetCause {
    /// What trips the board from its start on; `None` after a start that is no trip.
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

    /// Whether nothing runs but links, until the next start.
    const fn holds(self) -> bool {
        matches!(self, Self::RepeatedBadStarts | Self::DamagedImage)
    }
}

/// What a board starts when it restarts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Restart {
    /// This firmware.
    Firmware,
    /// The bootloader, which waits for another image.
    Bootloader,
}

/// What a motor or stepper does, as published by the control loop each period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MotorStatus {
    /// What it follows.
    pub setpoint: Setpoint,
    /// In counts of the channel's resolution.
    pub position: i32,
    /// rad/s or m/s
    pub speed: f32,
    /// Share of the supply at the bridge.
    pub duty: f32,
    /// In position mode: at the set point and at rest.
    pub settled: bool,
    /// Whether the position is known, and not only counted from where power came on.
    pub homed: bool,
    /// How hot its winding is; `None` where nothing computes that.
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

/// What a channel does or shows now.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Status {
    Motor(MotorStatus),
    Scalar(f32),
    Encoder { position: i32, speed: f32, illegal: u32 },
    Reading { value: f32, quality: Quality, taken: Instant },
    Sensor { values: [f32; MAX_QUANTITIES], quality: Quality, taken: Instant },
}

/// Where the supervisor stands, for the other tasks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct SafetyView {
    pub(crate) state: SafetyState,
    pub(crate) causes: Causes,
    /// Counts armings, so that a command from before the last one cannot be carried out after it.
    pub(crate) epoch: u16,
    /// Motors are being braked before they are switched off: see [`BrakingStop`].
    pub(crate) braking: bool,
}

/// Channels that take commands; a brake is commanded beside its drive.
const OUTPUTS: usize = MAX_MOTORS + 2 * MAX_BLDCS + MAX_SERVOS + STEPPERS + MAX_RELAYS + DAC_OUTPUTS;
/// Most channels of a board, the dead-man's handle and the auxiliary stop with them.
const CHANNELS: usize =
    OUTPUTS - MAX_BLDCS + ENCODERS + SWITCHES + RANGE_SENSORS + ANALOG_INPUTS + MAX_SUPPLIES + MAX_SENSORS + 2;

/// Where a channel's status is kept. Outputs come first, and their commands are kept in the same place.
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

/// Where the newest command of an output is kept; a brake's after all others, so that the next speed does not replace it.
fn command_slot(place: Place, mode: Mode) -> usize {
    match (place, mode) {
        (Place::Bldc(index), Mode::Brake) => OUTPUTS - MAX_BLDCS + index,
        _ => slot(place),
    }
}

/// A set of outputs: a bit for each slot of a command.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Commanded(u64);

const _: () = assert!(OUTPUTS <= u64::BITS as usize, "a bit for each slot");

impl Commanded {
    /// Whether an output has a command; for a brushless drive, another than to its brake.
    pub(crate) fn has(self, place: Place) -> bool {
        self.has_slot(slot(place))
    }

    /// Whether the brake of a brushless drive has one.
    pub(crate) fn has_brake(self, bldc: usize) -> bool {
        self.has_slot(command_slot(Place::Bldc(bldc), Mode::Brake))
    }

    /// Those of `count` outputs that have a command, by their indices; `first` is the first of their kind.
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

/// The one host session a board can have.
#[derive(Clone, Copy, Debug)]
struct Session {
    id: u16,
    link: u8,
    last_heartbeat: Instant,
}

/// A set point that was taken.
#[derive(Clone, Copy, Debug)]
struct Given {
    setpoint: Setpoint,
    /// When the host decided it, on the board's clock; never later than its arrival, because one dated ahead must not make all that
    /// follow look older.
    sent_us: u64,
    /// The date it came with.
    dated_us: u64,
}

/// A set point of a cycle: followed for so long, unless another comes.
#[derive(Clone, Copy, Debug)]
struct Lease {
    place: Place,
    mode: Mode,
    until: Instant,
}

/// Channels that cycles can move.
const LEASES: usize = MAX_MOTORS + MAX_BLDCS + STEPPERS;

struct State {
    safety: Safety,
    epoch: u16,
    /// How long a stop may brake, and the one that does.
    brake: Duration,
    braking_stop: Option<BrakingStop>,
    /// Causes that hold now, by the supervisor's last look.
    present: Causes,
    /// Causes that hold now, by the control loop's last period.
    control_causes: Causes,
    /// Causes that the processor sees by its own detectors.
    processor_causes: Causes,
    /// `None` until the control loop runs.
    last_tick: Option<Instant>,
    session: Option<Session>,
    next_session: u16,
    /// With the arming they were given in.
    commands: [Option<(u16, Setpoint)>; OUTPUTS],
    /// Which of these there are.
    commanded: Commanded,
    /// Newest set point that each output was given in this arming.
    given: [Option<Given>; OUTPUTS],
    /// One for each channel at most.
    leases: Vec<Lease, LEASES>,
    /// Of each motor.
    paths: [Path; MAX_MOTORS],
    /// Of the position and of the speed loop.
    gains: [[Option<PidGains>; 2]; MAX_MOTORS],
    tunings: [Option<Tuning>; MAX_MOTORS],
    started: bool,
    /// Only links run; whoever started them holds the outputs safe.
    held: bool,
    ranges: [RangeReading; RANGE_SENSORS],
    /// Trips since the start, and the causes of the last.
    trips: u32,
    trip_causes: Causes,
    /// How many hold arming back: something is done that must not be while outputs move.
    arming_held: u8,
    /// The configuration as hosts have changed it; it holds from the next start on, if it is saved.
    pending: BoardConfig,
    statuses: [Status; CHANNELS],
    /// When the positions in them were measured.
    measured: Instant,
    stats: DeviceStats,
}

/// What the tasks of one board share.
pub struct Shared<M: RawMutex> {
    config: BoardConfig,
    built_in: BoardConfig,
    state: Mutex<M, RefCell<State>>,
    /// Wakes the supervisor: the state changed or must be looked at.
    pub(crate) supervisor: Signal<M, ()>,
    /// Wakes the control loop out of turn: outputs must be made safe.
    pub(crate) make_safe: Signal<M, ()>,
    restart: Signal<M, Restart>,
    /// What is kept over a restart; [`crate::storage::run`] serves it.
    pub storage: Storage<M>,
    /// Raw access to connectors; its own task serves it.
    pub passthrough: Passthrough<M>,
    log: Option<Log>,
    image: Option<ImageInfo>,
}

impl<M: RawMutex> Shared<M> {
    /// The state of a board that has just started with `config`: the configuration it was `built_in` with, and what was
    /// saved of it since (see [`crate::storage::parameters::load`]).
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
                // Of a board that drives nothing: without pulses.
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
        // No task takes it away again: such a board cannot be armed before its next start.
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
                // Silent from now on, and not from the beginning of time.
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

    /// The same on a board that has a log.
    #[must_use]
    pub fn with_log(mut self, log: Log) -> Self {
        self.log = Some(log);
        self
    }

    /// The same on a board that runs an image in flash.
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

    /// The board's configuration.
    #[must_use]
    pub fn config(&self) -> &BoardConfig {
        &self.config
    }

    fn with<T>(&self, f: impl FnOnce(&mut State) -> T) -> T {
        self.state.lock(|state| f(&mut state.borrow_mut()))
    }

    // Safety.

    pub(crate) fn safety(&self) -> SafetyView {
        self.with(|s| SafetyView {
            state: s.safety.state(),
            causes: s.safety.causes(),
            epoch: s.epoch,
            braking: s.braking_stop.is_some(),
        })
    }

    /// Whether the state is another than in `view`. Where it is not, the control loop's task, of `context`, is woken when it is to
    /// make safe.
    pub(crate) fn has_changed(&self, view: SafetyView, context: &mut Context<'_>) -> bool {
        loop {
            let signalled = pin!(self.make_safe.wait()).poll(context).is_ready();
            if self.safety() != view {
                // Taken back: the control loop looks once more when its period is over.
                self.make_safe.signal(());
                return true;
            }
            if !signalled {
                return false;
            }
        }
    }

    /// The state that a test begins with.
    #[cfg(test)]
    pub(crate) fn set_safety(&self, safety: Safety) {
        self.with(|s| s.safety = safety);
    }

    /// Puts `event` to the state machine with the causes that are present, and wakes whoever must act on a change.
    pub(crate) fn request(&self, event: Event) -> Result<(), Refusal> {
        let (changed, result) = self.with(|s| s.apply(event));
        if changed {
            self.supervisor.signal(());
            self.make_safe.signal(());
        }
        result
    }

    /// A cause that the processor sees by its own detectors is present from now on, or no longer; for its interrupts.
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

    /// The supervisor's look: `watched` are the causes it sees itself; those of the other tasks are added here.
    pub(crate) fn supervise(&self, mut watched: Causes, now: Instant) -> SafetyView {
        let link_timeout = Duration::from_millis(self.config.link_timeout_ms.into());
        let overrun = Duration::from_micros(u64::from(self.config.control_period_us) * CONTROL_OVERRUN_PERIODS);
        let changed = self.with(|s| {
            let link_lost = s.session.is_some_and(|session| since(session.last_heartbeat, now) > link_timeout);
            watched.set(Cause::LinkLost, link_lost);
            watched.set(Cause::ControlOverrun, s.last_tick.is_some_and(|tick| since(tick, now) > overrun));
            watched.set(Cause::Proximity, ranging::must_stop(&self.config.ranges, &s.ranges, now));
            s.present = watched.union(s.control_causes).union(s.processor_causes);
            // The deadline of a stop that brakes is looked at here, whatever the control loop does.
            s.apply(Event::Tick).0
        });
        if changed {
            self.make_safe.signal(());
        }
        self.safety()
    }

    // Control.

    /// The brakes of the stop that ended this arming are written. Nothing where it is over.
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

    /// The control loop sets chips up, which takes longer than periods do; nothing is driven until its next tick.
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

    /// What a range sensor shows; wakes the supervisor when that is a reason to stop.
    pub fn publish_range(&self, index: usize, reading: RangeReading) {
        let taken = reading.measured.unwrap_or(Instant::MIN);
        self.with(|s| s.ranges[index] = reading);
        let status = Status::Reading { value: reading.distance_m, quality: reading.quality, taken };
        self.publish(Place::Range(index), status);
        if reading.stop {
            self.supervisor.signal(());
        }
    }

    /// The newest command of this arming; one of a later arming is left for the next period.
    pub(crate) fn take_command(&self, output: Place, epoch: u16) -> Option<Setpoint> {
        self.take_from(slot(output), epoch)
    }

    /// The newest command to the brake of a brushless drive, as [`Shared::take_command`].
    pub(crate) fn take_brake(&self, bldc: usize, epoch: u16) -> Option<bool> {
        self.take_from(command_slot(Place::Bldc(bldc), Mode::Brake), epoch).map(|setpoint| setpoint.value != 0.0)
    }

    /// Which outputs have a command now, of whichever arming. What is given from here on is seen the next time.
    pub(crate) fn commanded(&self) -> Commanded {
        self.with(|s| s.commanded)
    }

    fn take_from(&self, slot: usize, epoch: u16) -> Option<Setpoint> {
        let taken = self.with(|s| {
            let taken = s.commands[slot].take_if(|(given, _)| *given == epoch);
            // One of a later arming than the caller's is still to be taken.
            if s.commands[slot].is_none() {
                s.commanded.0 &= !(1 << slot);
            }
            taken
        });
        taken.map(|(_, setpoint)| setpoint)
    }

    /// Commands the channels to rest whose cycles have stopped coming.
    pub(crate) fn end_leases(&self, now: Instant) {
        self.with(|s| {
            while let Some(place) = s.leases.iter().position(|lease| lease.until < now) {
                let Lease { place, mode, .. } = s.leases.swap_remove(place);
                // Leases are of the present arming.
                let _ = s.command(place, at_rest(mode), now.as_micros());
                s.stats.setpoints_expired = s.stats.setpoints_expired.wrapping_add(1);
            }
        });
    }

    /// Where the path of a motor leads at `now_us`.
    pub(crate) fn leg(&self, motor: usize, now_us: u64) -> Leg {
        self.with(|s| s.paths[motor].leg(now_us))
    }

    /// The next new gains of some motor's loop, if there are any.
    pub(crate) fn take_gains(&self) -> Option<(usize, Mode, PidGains)> {
        self.with(|s| {
            let (index, slot) = s.gains.as_flattened_mut().iter_mut().enumerate().find(|(_, gains)| gains.is_some())?;
            let mode = if index % 2 == 0 { Mode::Position } else { Mode::Speed };
            slot.take().map(|gains| (index / 2, mode, gains))
        })
    }

    /// The next new tuning of some motor, if there is any.
    pub(crate) fn take_tuning(&self) -> Option<(usize, Tuning)> {
        self.with(|s| {
            let (index, slot) = s.tunings.iter_mut().enumerate().find(|(_, tuning)| tuning.is_some())?;
            slot.take().map(|tuning| (index, tuning))
        })
    }

    /// The outputs are in a known state, or could not be brought into one; hosts may be answered.
    pub(crate) fn set_started(&self) {
        self.with(|s| s.started = true);
    }

    /// Whether outputs are in a known state and every range sensor that can stop the board has been heard.
    pub(crate) fn has_started(&self) -> bool {
        self.with(|s| {
            let guards = self.config.ranges.iter().zip(&s.ranges).filter(|(range, _)| range.stop_below_m.is_some());
            s.held || s.started && guards.into_iter().all(|(_, reading)| reading.quality != Quality::None)
        })
    }

    /// Every cause of the last trip, also when it has been cleared since.
    #[must_use]
    pub fn trip_causes(&self) -> Causes {
        self.with(|s| s.trip_causes)
    }

    /// Trips since the start of the board.
    #[must_use]
    pub fn trips(&self) -> u32 {
        self.with(|s| s.trips)
    }

    pub(crate) fn publish(&self, place: Place, status: Status) {
        self.with(|s| s.statuses[slot(place)] = status);
    }

    /// The same for all of a kind, from the `first` on, in one critical section: what is short to compute.
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

    /// The motors' statuses that are being published are of a look at their sensors at `measured`.
    pub(crate) fn set_measured(&self, measured: Instant) {
        self.with(|s| s.measured = measured);
    }

    /// When what [`Shared::status`] shows was measured; `now`, where nobody measures any more.
    pub(crate) fn measured(&self, now: Instant) -> Instant {
        let longest = Duration::from_micros(u64::from(self.config.control_period_us) * CONTROL_OVERRUN_PERIODS);
        let measured = self.with(|s| s.measured);
        if since(measured, now) > longest { now } else { measured }
    }

    pub(crate) fn status(&self, place: Place) -> Status {
        self.with(|s| s.statuses[slot(place)])
    }

    /// The motors whose windings are close to what they withstand, in the order of the configuration.
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

    // Configuration.

    /// What the firmware was built with.
    pub(crate) fn built_in(&self) -> &BoardConfig {
        &self.built_in
    }

    /// The configuration as hosts have changed it.
    pub(crate) fn pending(&self) -> BoardConfig {
        self.with(|s| s.pending.clone())
    }

    /// Takes a changed configuration. Of two hosts that change it at once, the later wins.
    pub(crate) fn set_pending(&self, config: BoardConfig) {
        self.with(|s| s.pending = config);
    }

    /// Keeps the board from being armed for as long as the result lives.
    ///
    /// # Errors
    /// [`Refusal::NotWhile`] while it is.
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

    /// Asks whoever runs the board to restart it, which cannot be armed any more.
    ///
    /// # Errors
    /// [`Refusal::NotWhile`] while it is armed, [`Refusal::NoBootloader`] where none has started it.
    pub(crate) fn restart(&self, restart: Restart) -> Result<(), Refusal> {
        if restart == Restart::Bootloader && !self.image.is_some_and(|image| image.hosted) {
            return Err(Refusal::NoBootloader);
        }
        core::mem::forget(self.hold_arming()?);
        self.restart.signal(restart);
        Ok(())
    }

    /// Ready when a host has asked for a restart, which is only taken while the board is not armed.
    pub async fn restart_requested(&self) -> Restart {
        self.restart.wait().await
    }

    // Links.

    /// What the CAN controller has counted: how often it was off the bus, and how often its counters reached the warning limit.
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

    /// Stops `output` because a set point for it, decided at `sent_us`, was refused: the one it follows is not what the host
    /// wants any more. An output that follows a set point decided later goes on, so that an old frame that comes late or
    /// twice stops nothing. Of one that `expired` the same date is the same set point, and it goes on, too.
    ///
    /// Only for requests of the link that holds the session: nobody else commands outputs, and who has none may still stop
    /// the whole board.
    pub(crate) fn withdraw(&self, output: Place, sent_us: u64, expired: bool) {
        self.with(|s| {
            let Some(given) = s.given(output) else { return };
            let superseded = if expired { sent_us <= given.dated_us } else { sent_us < given.sent_us };
            if superseded {
                return;
            }
            if let Some(stop) = self.stop_of(output, given.setpoint, s.statuses[slot(output)]) {
                // Nothing is in force unless the board is armed.
                let _ = s.command(output, stop, sent_us);
            }
        });
    }

    /// Set point that stops `output`, which follows `follows` and shows `status`; `None` when that is a stop.
    fn stop_of(&self, output: Place, follows: Setpoint, status: Status) -> Option<Setpoint> {
        let setpoint = |mode, value| Some(Setpoint { mode, value });
        match (output, status) {
            (Place::Motor(_), _) => Some(at_rest(follows.mode)),
            (Place::Stepper(_), _) => setpoint(Mode::Speed, 0.0),
            // Neutral would release the brake.
            (Place::Bldc(_), _) if follows.mode == Mode::Brake && follows.value != 0.0 => None,
            (Place::Bldc(_), _) => setpoint(Mode::Duty, 0.0),
            // Where it is, on its way.
            (Place::Servo(_), Status::Scalar(angle_rad)) => setpoint(Mode::Position, angle_rad),
            // As in the safe state.
            (Place::Relay(_), _) => setpoint(Mode::Switch, 0.0),
            (Place::Dac(index), _) => setpoint(Mode::Voltage, self.config.dacs[index].safe_v),
            _ => None,
        }
    }

    /// Stores the commands of a cycle, each as [`Shared::command`] does, to be followed until then if no other comes. Points of
    /// paths, dated `sent_us`, need no such end: a path ends by itself.
    pub(crate) fn lease(&self, setpoints: &[(Place, Setpoint)], sent_us: u64, until: Instant) -> Result<(), Refusal> {
        let is_point = |setpoint: &Setpoint| setpoint.mode == Mode::Follow;
        let point = |setpoint: &Setpoint| at(sent_us, setpoint.value);
        self.with(|s| {
            // All of them, or none.
            for (place, setpoint) in setpoints.iter().filter(|(_, setpoint)| is_point(setpoint)) {
                self.check_path(s, *place, &[point(setpoint)])?;
            }
            for (place, setpoint) in setpoints {
                if is_point(setpoint) {
                    s.follow(*place, &[point(setpoint)], sent_us)?;
                    continue;
                }
                s.command(*place, *setpoint, sent_us)?;
                // There is room for every channel, and the command has ended the lease it had.
                let _ = s.leases.push(Lease { place: *place, mode: setpoint.mode, until });
            }
            Ok(())
        })
    }

    /// Gives a motor points of a path, decided at `sent_us`, whose numbers were checked: all of them, or none.
    pub(crate) fn follow(&self, output: Place, points: &[PathPoint], sent_us: u64) -> Result<(), Refusal> {
        self.with(|s| {
            self.check_path(s, output, points)?;
            s.follow(output, points, sent_us)
        })
    }

    /// Whether the motor's path could take `points` now.
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

    /// Stores gains for the control loop's next period, armed or not. Open duty has none.
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

    /// Opens a session for `link`, closing the one that link had.
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
        // A host that starts anew does not know what the last one left running.
        self.request(Event::Disarm)?;
        Ok(self.with(|s| {
            let id = s.next_session;
            s.next_session = id.wrapping_add(1);
            s.session = Some(Session { id, link, last_heartbeat: now });
            id
        }))
    }

    /// Whether `link` holds the session.
    pub(crate) fn has_session(&self, link: u8) -> bool {
        self.with(|s| s.session.is_some_and(|session| session.link == link))
    }

    /// Whether a host is connected.
    pub(crate) fn has_host(&self) -> bool {
        let timeout = Duration::from_millis(self.config.link_timeout_ms.into());
        self.heartbeat_age().is_some_and(|age| age <= timeout)
    }

    /// Since the host was last heard; `None` without one.
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

    /// Ends the session of `link` in an orderly way.
    pub(crate) fn close_session(&self, link: u8) {
        if self.has_session(link) {
            // Disarming is never refused.
            let _ = self.request(Event::Disarm);
            self.with(|s| s.session = None);
        }
    }
}

/// See [`Shared::hold_arming`].
pub(crate) struct ArmingHeld<'s, M: RawMutex>(&'s Shared<M>);

impl<M: RawMutex> Drop for ArmingHeld<'_, M> {
    fn drop(&mut self) {
        self.0.with(|s| s.arming_held = s.arming_held.saturating_sub(1));
    }
}

/// From `then` to `now`; nothing when another task has already seen a later moment.
fn since(then: Instant, now: Instant) -> Duration {
    now.saturating_duration_since(then)
}

/// The point of a path that a single set point is.
pub(crate) const fn at(at_us: u64, position: f32) -> PathPoint {
    PathPoint { at_us, position, speed: None, feed_forward: 0.0 }
}

/// Number of the first session since the board started.
const FIRST_SESSION: u16 = 1;
/// The control loop counts as dead after this many periods without a tick.
const CONTROL_OVERRUN_PERIODS: u64 = 5;

impl State {
    /// Ends the lease of the channel, too: the newest command counts.
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

    /// Lets a motor follow its path with `points` from here on, which were checked.
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

    /// Returns whether the state changed.
    fn apply(&mut self, event: Event) -> (bool, Result<(), Refusal>) {
        let arms = event == Event::Arm && self.safety == Safety::Disarmed && self.present.is_empty();
        if arms && self.arming_held > 0 {
            return (false, Err(Refusal::Busy));
        }
        let (next, result) = self.safety.next(event, self.present);
        let changed = next.state() != self.safety.state();
        let was_braking = self.braking_stop.is_some();
        // What holds when the board is switched on, before any host could have armed it, is no trip to remember; or a released
        // handle would push out those that are.
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
            // A cause that was cleared meanwhile does not count: none that forbids braking can have been among them.
            _ => self.braking_stop.filter(|stop| stop.goes_on(next.causes(), now)),
        };
        self.safety = next;
        let brake_ended = was_braking && self.braking_stop.is_none();
        (changed || brake_ended, result)
    }
}

#[cfg(test)]
mod tests;
