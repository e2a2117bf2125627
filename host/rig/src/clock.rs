//! Clock of a session, virtual or real.

use std::future::Future;

use futures::future::Either;
use r4_driver::Clock;
use r4_links::RealClock;

/// Virtual time of a simulation, or real time of this computer.
#[derive(Clone)]
pub enum HostClock {
    /// Clock of a simulation, which advances by its events.
    Virtual(r4_sim::Clock),
    /// Clock of this computer.
    Real(RealClock),
}

impl Clock for HostClock {
    fn now_us(&self) -> u64 {
        match self {
            Self::Virtual(clock) => clock.now_ns() / 1000,
            Self::Real(clock) => clock.now_us(),
        }
    }

    fn sleep_until(&self, at_us: u64) -> impl Future<Output = ()> {
        match self {
            Self::Virtual(clock) => Either::Left(clock.sleep_until(at_us.saturating_mul(1000))),
            Self::Real(clock) => Either::Right(clock.sleep_until(at_us)),
        }
    }
}
