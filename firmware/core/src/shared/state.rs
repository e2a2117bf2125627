//! All shared data behind one lock, and what every task may do with it.

use core::cell::RefCell;

use embassy_sync::{
    blocking_mutex::{Mutex, raw::RawMutex},
    signal::Signal,
};
use embassy_time::{Duration, Instant};
use r4_protocol::{
    Cause, Causes, DeviceStats, ImageInfo, Mode, PathPoint, Refusal, Setpoint,
    config::{BoardConfig, Place},
};

use super::{
    commands::Commands,
    paths::Paths,
    ranges::Ranges,
    sessions::Sessions,
    start::{ResetCause, Restart},
    statuses::{Status, Statuses},
    supervision::{SafetyView, Supervision},
    tunings::Tunings,
};
use crate::{log::Log, passthrough::Passthrough, safety::Event, sensing::range::RangeReading, storage::Storage};

/// Data of all subjects.
pub(super) struct State {
    pub(super) supervision: Supervision,
    pub(super) sessions: Sessions,
    pub(super) commands: Commands,
    pub(super) paths: Paths,
    pub(super) tunings: Tunings,
    pub(super) ranges: Ranges,
    pub(super) statuses: Statuses,
    pub(super) started: bool,
    /// True if only links run; the starting code then holds the outputs safe.
    pub(super) held: bool,
    /// Configuration as changed by hosts; takes effect at the next start, if it is saved.
    pub(super) pending: BoardConfig,
    pub(super) stats: DeviceStats,
}

/// State that the tasks of one board share.
pub struct Shared<M: RawMutex> {
    config: BoardConfig,
    pub(super) built_in: BoardConfig,
    state: Mutex<M, RefCell<State>>,
    /// Wakes the supervisor: the state has changed or must be checked.
    pub(crate) supervisor: Signal<M, ()>,
    /// Wakes the control loop out of turn: outputs must be made safe.
    pub(crate) make_safe: Signal<M, ()>,
    pub(super) restart: Signal<M, Restart>,
    /// Storage over a restart; [`crate::storage::run`] serves it.
    pub storage: Storage<M>,
    /// Raw access to connectors; its own task serves it.
    pub passthrough: Passthrough<M>,
    pub(super) log: Option<Log>,
    pub(super) image: Option<ImageInfo>,
}

impl<M: RawMutex> Shared<M> {
    /// Creates the state of a board that has just started with `config`: its `built_in` configuration with the saved
    /// changes (see [`crate::storage::parameters::load`]).
    #[must_use]
    pub fn new(config: BoardConfig, built_in: BoardConfig, reset: ResetCause) -> Self {
        let valid = config.validate().is_ok();
        Self {
            built_in,
            state: Mutex::new(RefCell::new(State {
                supervision: Supervision::new(&config, valid, reset),
                sessions: Sessions::new(),
                commands: Commands::new(),
                paths: Paths::new(),
                tunings: Tunings::new(),
                ranges: Ranges::new(),
                statuses: Statuses::new(&config, valid),
                started: false,
                held: reset.holds(),
                pending: config.clone(),
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

    /// Configuration of the board.
    #[must_use]
    pub fn config(&self) -> &BoardConfig {
        &self.config
    }

    /// Runs `f` in the critical section, which must be short.
    pub(super) fn with<T>(&self, f: impl FnOnce(&mut State) -> T) -> T {
        self.state.lock(|state| f(&mut state.borrow_mut()))
    }

    pub(crate) fn safety(&self) -> SafetyView {
        self.with(|s| s.supervision.view())
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
        self.with(|s| s.supervision.set_processor_cause(cause, present));
        if present {
            self.trip(cause);
        }
    }

    /// Trips for a cause that is over at once.
    pub(crate) fn trip(&self, cause: Cause) {
        // A trip is never refused.
        let _ = self.request(Event::Trip(Causes::only(cause)));
    }

    /// All causes of the last trip, also when it has been cleared since.
    #[must_use]
    pub fn trip_causes(&self) -> Causes {
        self.with(|s| s.supervision.trip_causes())
    }

    /// Number of trips since the start of the board.
    #[must_use]
    pub fn trips(&self) -> u32 {
        self.with(|s| s.supervision.trips())
    }

    /// Publishes the reading of a range sensor; wakes the supervisor when it is a reason to stop.
    pub fn publish_range(&self, index: usize, reading: RangeReading) {
        let taken = reading.measured.unwrap_or(Instant::MIN);
        self.with(|s| s.ranges.set(index, reading));
        let status = Status::Reading { value: reading.distance_m, quality: reading.quality, taken };
        self.publish(Place::Range(index), status);
        if reading.stop {
            self.supervisor.signal(());
        }
    }

    pub(crate) fn publish(&self, place: Place, status: Status) {
        self.with(|s| s.statuses.set(place, status));
    }

    pub(crate) fn count(&self, f: impl FnOnce(&mut DeviceStats)) {
        self.with(|s| f(&mut s.stats));
    }

    /// Records the counters of the CAN controller: how often it was off the bus, and how often its error counters
    /// reached the warning limit.
    pub fn note_can(&self, bus_off: u32, warnings: u32) {
        self.count(|stats| (stats.can_bus_off, stats.can_warnings) = (bus_off, warnings));
    }

    /// Waits for a host's request to restart, which is accepted only while the board is not armed.
    pub async fn restart_requested(&self) -> Restart {
        self.restart.wait().await
    }

    /// Time without a tick after which the control loop counts as dead.
    pub(super) fn overrun(&self) -> Duration {
        Duration::from_micros(u64::from(self.config.control_period_us) * CONTROL_OVERRUN_PERIODS)
    }

    /// Sets the initial state of a test.
    #[cfg(test)]
    pub(crate) fn set_safety(&self, safety: crate::safety::Safety) {
        self.with(|s| s.supervision.set(safety));
    }
}

/// Number of periods without a tick after which the control loop counts as dead.
const CONTROL_OVERRUN_PERIODS: u64 = 5;

impl State {
    /// Stores a command and ends the lease of its channel: the newest command counts.
    pub(super) fn command(&mut self, output: Place, setpoint: Setpoint, dated_us: u64) -> Result<(), Refusal> {
        let epoch = self.supervision.armed()?;
        if let (Place::Motor(index), true) = (output, setpoint.mode != Mode::Follow) {
            self.paths.clear(index);
        }
        self.commands.put(output, setpoint, epoch, dated_us);
        Ok(())
    }

    /// Adds `points`, which were checked, to the motor's path, and lets it follow that.
    pub(super) fn follow(&mut self, output: Place, points: &[PathPoint], dated_us: u64) -> Result<(), Refusal> {
        let (Place::Motor(index), Some(last)) = (output, points.last()) else { return Ok(()) };
        self.command(output, Setpoint { mode: Mode::Follow, value: last.position }, dated_us)?;
        self.paths.splice(index, points, Instant::now().as_micros());
        Ok(())
    }

    /// Checks that the motor's path can take `points` now.
    pub(super) fn check_path(&self, config: &BoardConfig, output: Place, points: &[PathPoint]) -> Result<(), Refusal> {
        let Place::Motor(index) = output else { return Ok(()) };
        let status = self.statuses.get(output);
        self.paths.check(index, &config.motors[index], status, points, Instant::now().as_micros())
    }

    /// Applies `event` to the state machine; returns true if the state changed, and the refusal, if any.
    pub(super) fn apply(&mut self, event: Event) -> (bool, Result<(), Refusal>) {
        let applied = self.supervision.apply(event, self.sessions.heard_of_any());
        if applied.armed {
            self.commands.clear();
            self.paths.clear_all();
        }
        (applied.changed, applied.result)
    }
}

/// Defines a view of [`Shared`] for one task: what it adds to [`Shared`] itself is for that task alone.
macro_rules! side {
    ($(#[$doc:meta])* $side:ident) => {
        $(#[$doc])*
        pub(crate) struct $side<'s, M: embassy_sync::blocking_mutex::raw::RawMutex>(&'s $crate::shared::state::Shared<M>);

        impl<'s, M: embassy_sync::blocking_mutex::raw::RawMutex> $side<'s, M> {
            /// Takes this side of the shared state.
            pub(crate) const fn of(shared: &'s $crate::shared::state::Shared<M>) -> Self {
                Self(shared)
            }
        }

        impl<M: embassy_sync::blocking_mutex::raw::RawMutex> Clone for $side<'_, M> {
            fn clone(&self) -> Self {
                *self
            }
        }

        impl<M: embassy_sync::blocking_mutex::raw::RawMutex> Copy for $side<'_, M> {}

        impl<M: embassy_sync::blocking_mutex::raw::RawMutex> core::ops::Deref for $side<'_, M> {
            type Target = $crate::shared::state::Shared<M>;

            fn deref(&self) -> &Self::Target {
                self.0
            }
        }
    };
}

pub(super) use side;
