//! Real-time clock for the driver.

use std::{
    future::Future,
    sync::OnceLock,
    time::{Duration, Instant},
};

use async_io::Timer;
use futures::FutureExt;
use r4_driver::Clock;

/// Monotonic clock of the machine, from its first use in this process.
#[derive(Clone, Copy, Debug, Default)]
pub struct RealClock;

/// Moment at which the clock shows 0.
fn origin() -> Instant {
    static ORIGIN: OnceLock<Instant> = OnceLock::new();
    *ORIGIN.get_or_init(Instant::now)
}

impl RealClock {
    /// Returns the moment at which this clock shows `at_us`.
    #[must_use]
    pub fn instant(self, at_us: u64) -> Instant {
        origin() + Duration::from_micros(at_us)
    }
}

/// Returns the reading of the machine's shared clock at `moment`, ns, accurate to about a microsecond. All processes
/// share it, so that they can compare moments: `CLOCK_MONOTONIC` on Unix; elsewhere the system time, which may be set.
#[must_use]
pub fn monotonic_ns(moment: Instant) -> u64 {
    let (now, shown_ns) = (Instant::now(), shared_clock_ns());
    let ns = |span: Duration| span.as_nanos() as u64;
    // One of the two differences is 0, because `moment` lies before or after `now`.
    shown_ns.saturating_add(ns(moment.saturating_duration_since(now))) - ns(now.saturating_duration_since(moment))
}

#[cfg(unix)]
fn shared_clock_ns() -> u64 {
    let shown = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
    shown.tv_sec.cast_unsigned() * 1_000_000_000 + shown.tv_nsec.cast_unsigned()
}

#[cfg(not(unix))]
fn shared_clock_ns() -> u64 {
    std::time::SystemTime::UNIX_EPOCH.elapsed().unwrap_or_default().as_nanos() as u64
}

impl Clock for RealClock {
    fn now_us(&self) -> u64 {
        // The cast is safe: 2⁶⁴ µs are 584 000 years.
        origin().elapsed().as_micros() as u64
    }

    fn sleep_until(&self, at_us: u64) -> impl Future<Output = ()> {
        // A moment beyond the range of `Instant` never comes.
        origin().checked_add(Duration::from_micros(at_us)).map_or_else(Timer::never, Timer::at).map(|_| ())
    }
}

#[cfg(test)]
mod tests {
    use crate::block_on;

    use super::*;

    #[test]
    fn a_moment_is_where_the_clock_shows_it() {
        let clock = RealClock;
        let begin_us = clock.now_us();
        // The future waits on the driver's clock: it is never early, and pends for an unreachable moment.
        block_on(clock.sleep_until(begin_us + 2000));
        let (before, shown_us, after) = (Instant::now(), clock.now_us(), Instant::now());
        assert!(shown_us >= begin_us + 2000, "{shown_us} {begin_us}");
        // The clock truncates to whole microseconds.
        assert!((before - Duration::from_micros(1)..=after).contains(&clock.instant(shown_us)));
        assert_eq!(clock.instant(5_000_000).duration_since(clock.instant(2_000_000)), Duration::from_secs(3));
        assert_eq!(clock.sleep_until(u64::MAX).now_or_never(), None);
    }

    #[cfg(unix)]
    #[test]
    fn the_shared_clock_is_the_monotonic_one() {
        let shown_ns = || {
            let shown = rustix::time::clock_gettime(rustix::time::ClockId::Monotonic);
            Duration::try_from(shown).expect("it counts up from 0").as_nanos() as u64
        };
        for _ in 0..1000 {
            let (before_ns, told_ns, after_ns) = (shown_ns(), shared_clock_ns(), shown_ns());
            assert!((before_ns..=after_ns).contains(&told_ns), "{before_ns} {told_ns} {after_ns}");
        }
    }

    #[test]
    fn moments_are_as_far_apart_on_the_monotonic_clock() {
        let now = Instant::now();
        let told_ns = shared_clock_ns();
        let shown_ns = monotonic_ns(now);
        assert!(shown_ns.abs_diff(told_ns) < 60_000_000_000, "{shown_ns} {told_ns}");
        for ms in [1, 1000] {
            let span = Duration::from_millis(ms);
            for other_ns in
                [monotonic_ns(now + span) - span.as_nanos() as u64, monotonic_ns(now - span) + span.as_nanos() as u64]
            {
                // The thread may have been suspended between the two readings.
                assert!(other_ns.abs_diff(shown_ns) < 500_000_000, "{other_ns} {shown_ns}");
            }
        }
    }
}
