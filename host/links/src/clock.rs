//! Real time, for the driver.

use std::{
    future::Future,
    sync::OnceLock,
    time::{Duration, Instant},
};

use async_io::Timer;
use futures::FutureExt;
use r4_driver::Clock;

/// The machine's monotonic clock, from the first time that it is asked in this process.
#[derive(Clone, Copy, Debug, Default)]
pub struct RealClock;

/// When time began.
fn origin() -> Instant {
    static ORIGIN: OnceLock<Instant> = OnceLock::new();
    *ORIGIN.get_or_init(Instant::now)
}

impl RealClock {
    /// The moment at which this clock shows `at_us`.
    #[must_use]
    pub fn instant(self, at_us: u64) -> Instant {
        origin() + Duration::from_micros(at_us)
    }
}

impl Clock for RealClock {
    fn now_us(&self) -> u64 {
        // 2⁶⁴ µs are 584 000 years.
        origin().elapsed().as_micros() as u64
    }

    fn sleep_until(&self, at_us: u64) -> impl Future<Output = ()> {
        // A moment too far away to be told never comes.
        origin().checked_add(Duration::from_micros(at_us)).map_or_else(Timer::never, Timer::at).map(|_| ())
    }
}
