//! Side of the supervisor: its pass over the causes of all tasks.

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Duration, Instant};
use r4_protocol::{Cause, Causes};

use super::{state::side, supervision::SafetyView};
use crate::safety::Event;

side! {
    /// Shared state for the supervisor.
    SupervisorSide
}

impl<M: RawMutex> SupervisorSide<'_, M> {
    /// Runs the supervisor's pass: `watched` are the causes that it detects itself; those of the other tasks are added
    /// here.
    pub(crate) fn supervise(&self, mut watched: Causes, now: Instant) -> SafetyView {
        let link_timeout = self.link_timeout();
        let overrun = self.overrun();
        let changed = self.with(|s| {
            let link_lost = s.sessions.heartbeat_age(now).is_some_and(|age| age > link_timeout);
            watched.set(Cause::LinkLost, link_lost);
            watched.set(Cause::Proximity, s.ranges.must_stop(&self.config().ranges, now));
            s.supervision.set_watched(watched, overrun, now);
            // The deadline of a braking stop is checked here, independently of the control loop.
            s.apply(Event::Tick).0
        });
        if changed {
            self.make_safe.signal(());
        }
        self.safety()
    }

    /// Returns true if a host is connected.
    pub(crate) fn has_host(&self) -> bool {
        let timeout = self.link_timeout();
        let now = Instant::now();
        self.with(|s| s.sessions.heartbeat_age(now)).is_some_and(|age| age <= timeout)
    }

    fn link_timeout(&self) -> Duration {
        Duration::from_millis(self.config().link_timeout_ms.into())
    }
}
