//! Safety state with its causes and trips: kept by the supervisor, changed by any task that trips, read by all.

use embassy_time::{Duration, Instant};
use r4_protocol::{Cause, Causes, Refusal, SafetyState, config::BoardConfig};

use super::start::ResetCause;
use crate::safety::{Event, Safety, stop::BrakingStop};

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

/// Result of an event.
pub(super) struct Applied {
    /// True if outputs change: the state is another one, or a braking stop has ended.
    pub(super) changed: bool,
    /// True if the board has been armed: earlier commands are void.
    pub(super) armed: bool,
    /// Refusal of the event, if any.
    pub(super) result: Result<(), Refusal>,
}

/// Safety state of the board, and what decides about it.
pub(super) struct Supervision {
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
    /// Number of trips since the start, and the causes of the last one.
    trips: u32,
    trip_causes: Causes,
    /// Number of operations that must not run while outputs move, and therefore prevent arming.
    arming_held: u8,
}

impl Supervision {
    /// Creates the state of a board that has just started, with a `valid` configuration or not.
    pub(super) fn new(config: &BoardConfig, valid: bool, reset: ResetCause) -> Self {
        let safety = match reset.cause() {
            None => Safety::Disarmed,
            Some(cause) => Safety::Tripped { causes: Causes::only(cause) },
        };
        let mut control_causes = Causes::NONE;
        control_causes.set(Cause::BadConfiguration, !valid);
        // This cause is never removed: such a board cannot be armed before its next start.
        if let (true, Some(cause)) = (reset.holds(), reset.cause()) {
            control_causes.set(cause, true);
        }
        Self {
            safety,
            epoch: 0,
            brake: Duration::from_millis(config.stop_brake_ms().into()),
            braking_stop: None,
            present: control_causes,
            control_causes,
            processor_causes: Causes::NONE,
            last_tick: None,
            trips: u32::from(reset.cause().is_some()),
            trip_causes: safety.causes(),
            arming_held: 0,
        }
    }

    pub(super) fn view(&self) -> SafetyView {
        SafetyView {
            state: self.safety.state(),
            causes: self.safety.causes(),
            epoch: self.epoch,
            braking: self.braking_stop.is_some(),
        }
    }

    /// Epoch of the present arming.
    ///
    /// # Errors
    /// [`Refusal::NotArmed`] while the board is not armed.
    pub(super) fn armed(&self) -> Result<u16, Refusal> {
        if self.safety == Safety::Armed {
            Ok(self.epoch)
        } else {
            Err(Refusal::NotArmed { state: self.safety.state() })
        }
    }

    /// All causes of the last trip, also when it has been cleared since.
    pub(super) fn trip_causes(&self) -> Causes {
        self.trip_causes
    }

    /// Number of trips since the start of the board.
    pub(super) fn trips(&self) -> u32 {
        self.trips
    }

    /// Takes the causes that the supervisor has detected; those of the control loop, of its silence for longer than
    /// `overrun`, and of the processor are added here.
    pub(super) fn set_watched(&mut self, mut watched: Causes, overrun: Duration, now: Instant) {
        let late = self.last_tick.is_some_and(|tick| now.saturating_duration_since(tick) > overrun);
        watched.set(Cause::ControlOverrun, late);
        self.present = watched.union(self.control_causes).union(self.processor_causes);
    }

    /// Sets the causes of the control loop; returns true if one of them is new.
    pub(super) fn set_control_causes(&mut self, causes: Causes) -> bool {
        let new = causes.bits() & !self.control_causes.bits() != 0;
        self.control_causes = causes;
        new
    }

    pub(super) fn set_processor_cause(&mut self, cause: Cause, present: bool) {
        self.processor_causes.set(cause, present);
    }

    /// Records the time of a control tick; `None` while the control loop does not run.
    pub(super) fn set_last_tick(&mut self, tick: Option<Instant>) {
        self.last_tick = tick;
    }

    /// Records that the brakes of the stop which ended the arming `epoch` are written.
    pub(super) fn brakes_written(&mut self, epoch: u16) {
        if self.epoch == epoch {
            self.braking_stop = self.braking_stop.map(BrakingStop::written);
        }
    }

    /// Prevents arming until [`Supervision::release_arming`].
    ///
    /// # Errors
    /// [`Refusal::NotWhile`] while the board is armed.
    pub(super) fn hold_arming(&mut self) -> Result<(), Refusal> {
        match self.safety {
            Safety::Armed => Err(Refusal::NotWhile { state: SafetyState::Armed }),
            Safety::Disarmed | Safety::Tripped { .. } => {
                self.arming_held = self.arming_held.saturating_add(1);
                Ok(())
            }
        }
    }

    pub(super) fn release_arming(&mut self) {
        self.arming_held = self.arming_held.saturating_sub(1);
    }

    /// Applies `event` to the state machine; `heard_of` is true once a host has been there.
    pub(super) fn apply(&mut self, event: Event, heard_of: bool) -> Applied {
        let arms = event == Event::Arm && self.safety == Safety::Disarmed && self.present.is_empty();
        if arms && self.arming_held > 0 {
            return Applied { changed: false, armed: false, result: Err(Refusal::Busy) };
        }
        let (next, result) = self.safety.next(event, self.present);
        let changed = next.state() != self.safety.state();
        let was_braking = self.braking_stop.is_some();
        // A cause present at power-on, before any host could have armed the board, is not recorded as a trip; otherwise
        // a released handle would push out the recorded ones.
        let trips = changed && next.state() == SafetyState::Tripped && heard_of;
        self.trips = self.trips.wrapping_add(trips.into());
        let armed = changed && next == Safety::Armed;
        if armed {
            self.epoch = self.epoch.wrapping_add(1);
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
        Applied { changed: changed || brake_ended, armed, result }
    }

    /// Sets the state of a test.
    #[cfg(test)]
    pub(super) fn set(&mut self, safety: Safety) {
        self.safety = safety;
    }

    /// Sets everything that [`Supervision::apply`] depends on, for its test, with a history of 7 trips and the last epoch.
    #[cfg(test)]
    pub(super) fn set_up(&mut self, safety: Safety, present: Causes, arming_held: u8) {
        (self.safety, self.present, self.arming_held) = (safety, present, arming_held);
        (self.epoch, self.trips, self.trip_causes) = (u16::MAX, 7, Causes::NONE);
    }

    #[cfg(test)]
    pub(super) fn state(&self) -> Safety {
        self.safety
    }
}
