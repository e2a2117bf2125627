//! Side of the tasks that report the board to a host or a person: telemetry, answers, screen.

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Duration, Instant};
use heapless::Vec;
use r4_protocol::{
    DeviceStats, HotWinding,
    config::{MAX_MOTORS, Place},
};

use super::{state::side, statuses::Status};

side! {
    /// Shared state for reports, which change nothing.
    ReportSide
}

impl<M: RawMutex> ReportSide<'_, M> {
    pub(crate) fn status(&self, place: Place) -> Status {
        self.with(|s| s.statuses.get(place))
    }

    /// Time at which the values of [`ReportSide::status`] were measured; `now` once measurements have stopped.
    pub(crate) fn measured(&self, now: Instant) -> Instant {
        let measured = self.with(|s| s.statuses.measured());
        if now.saturating_duration_since(measured) > self.overrun() { now } else { measured }
    }

    /// Motors whose windings are close to their limit, in the order of the configuration.
    pub(crate) fn hot_windings(&self) -> Vec<HotWinding, MAX_MOTORS> {
        self.with(|s| s.statuses.hot_windings(self.config()))
    }

    pub(crate) fn stats(&self) -> DeviceStats {
        self.with(|s| s.stats)
    }

    /// Time since the host's last heartbeat; `None` without a session.
    pub(crate) fn heartbeat_age(&self) -> Option<Duration> {
        let now = Instant::now();
        self.with(|s| s.sessions.heartbeat_age(now))
    }
}
