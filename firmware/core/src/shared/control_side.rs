//! Side of the control loop: commands and paths to follow, statuses and causes to publish.

use core::{future::Future, pin::pin, task::Context};

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::Instant;
use r4_protocol::{
    Causes, Mode, Setpoint,
    config::{PidGains, Place, Tuning},
};

use super::{
    commands::{Commanded, at_rest},
    state::side,
    statuses::Status,
    supervision::SafetyView,
};
use crate::path::Leg;

side! {
    /// Shared state for the control loop.
    ControlSide
}

// Commands.
impl<M: RawMutex> ControlSide<'_, M> {
    /// Takes the newest command of this arming; one of a later arming is left for the next period.
    pub(crate) fn take_command(&self, output: Place, epoch: u16) -> Option<Setpoint> {
        // Of a brushless drive, one other than to its brake; the other outputs have one slot for all modes.
        self.with(|s| s.commands.take(output, Mode::Duty, epoch))
    }

    /// Takes the newest command to the brake of a brushless drive, like [`ControlSide::take_command`].
    pub(crate) fn take_brake(&self, bldc: usize, epoch: u16) -> Option<bool> {
        self.with(|s| s.commands.take(Place::Bldc(bldc), Mode::Brake, epoch)).map(|setpoint| setpoint.value != 0.0)
    }

    /// Returns the outputs that have a command now, of any arming. Later commands show at the next call.
    pub(crate) fn commanded(&self) -> Commanded {
        self.with(|s| s.commands.commanded())
    }

    /// Commands those channels to rest whose cycles have stopped coming.
    pub(crate) fn end_leases(&self, now: Instant) {
        self.with(|s| {
            while let Some((place, mode)) = s.commands.take_expired(now) {
                // Cannot fail: leases are of the present arming.
                let _ = s.command(place, at_rest(mode), now.as_micros());
                s.stats.setpoints_expired = s.stats.setpoints_expired.wrapping_add(1);
            }
        });
    }

    /// Segment of a motor's path at `now_us`.
    pub(crate) fn leg(&self, motor: usize, now_us: u64) -> Leg {
        self.with(|s| s.paths.leg(motor, now_us))
    }

    /// Takes the next new gains of some motor's loop; `None` without any.
    pub(crate) fn take_gains(&self) -> Option<(usize, Mode, PidGains)> {
        self.with(|s| s.tunings.take_gains())
    }

    /// Takes the next new tuning of some motor; `None` without any.
    pub(crate) fn take_tuning(&self) -> Option<(usize, Tuning)> {
        self.with(|s| s.tunings.take_tuning())
    }
}

// Safety.
impl<M: RawMutex> ControlSide<'_, M> {
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

    /// Records that the brakes of the stop which ended the arming `epoch` are written. No effect if that stop is over.
    pub(crate) fn brakes_written(&self, epoch: u16) {
        self.with(|s| s.supervision.brakes_written(epoch));
    }

    pub(crate) fn control_tick(&self, now: Instant) {
        self.with(|s| s.supervision.set_last_tick(Some(now)));
    }

    /// Records that the control loop sets up chips, which takes longer than a period; nothing is driven until its next
    /// tick.
    pub(crate) fn control_pauses(&self) {
        self.with(|s| s.supervision.set_last_tick(None));
    }

    pub(crate) fn set_control_causes(&self, causes: Causes) {
        if self.with(|s| s.supervision.set_control_causes(causes)) {
            self.supervisor.signal(());
        }
    }

    /// Records that the outputs are in a known state, or could not be brought into one; hosts may be answered.
    pub(crate) fn set_started(&self) {
        self.with(|s| s.started = true);
    }
}

// Statuses.
impl<M: RawMutex> ControlSide<'_, M> {
    /// Publishes all statuses of a kind, from `first` on, in one critical section; computing them must be short.
    pub(crate) fn publish_each(&self, first: Place, statuses: impl Iterator<Item = Status>) {
        self.with(|s| s.statuses.set_each(first, statuses));
    }

    /// Sets the time at which the sensors of the published motor statuses were read.
    pub(crate) fn set_measured(&self, measured: Instant) {
        self.with(|s| s.statuses.set_measured(measured));
    }
}
