//! The time that a session runs on.

use std::future::Future;

use futures::future::Either;
use r4_driver::Clock;
use r4_links::RealClock;

/// Virtual time of a simulation, or this machine's.
#[derive(Clone)]
pub enum HostClock {
    /// Of a simulation.
    Virtual(r4_sim::Clock),
    /// Of this machine.
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
