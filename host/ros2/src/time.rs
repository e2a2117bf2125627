//! Time stamps of ROS messages.

use crate::message::Time;

const NS_PER_S: i64 = 1_000_000_000;

/// Point in ROS time, ns since 1970 (UTC), or in simulated time.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub struct Stamp(i64);

impl Stamp {
    /// Creates a stamp from its time, ns.
    #[must_use]
    pub fn from_ns(ns: i64) -> Self {
        Self(ns)
    }

    /// Returns the time of the stamp, ns.
    #[must_use]
    pub fn as_ns(self) -> i64 {
        self.0
    }

    /// Returns the current time of this machine's clock.
    #[must_use]
    pub fn of_machine() -> Self {
        // A clock before 1970 counts as 1970; then no stamp appears too old.
        let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
        Self(i64::try_from(since.as_nanos()).unwrap_or(i64::MAX))
    }

    /// Converts the time in a message; `None` when its nanoseconds are a second or more, which is invalid.
    #[must_use]
    pub fn from_time(time: Time) -> Option<Self> {
        let ns = i64::from(time.nanosec);
        (ns < NS_PER_S).then(|| Self(i64::from(time.sec) * NS_PER_S + ns))
    }

    /// Converts the stamp to the time in a message, limited to what its 32-bit seconds hold: 1901 to 2038.
    #[must_use]
    pub fn to_time(self) -> Time {
        match i32::try_from(self.0.div_euclid(NS_PER_S)) {
            // The remainder is below 10⁹, so it fits.
            Ok(sec) => Time { sec, nanosec: self.0.rem_euclid(NS_PER_S) as u32 },
            Err(_) if self.0 < 0 => Time { sec: i32::MIN, nanosec: 0 },
            Err(_) => Time { sec: i32::MAX, nanosec: 999_999_999 },
        }
    }

    /// Returns true for 0, which in a message means no stamp.
    #[must_use]
    pub fn is_none(self) -> bool {
        self.0 == 0
    }

    /// Returns the time from `other` to this stamp, s; negative when this one is earlier.
    #[must_use]
    pub fn since_s(self, other: Self) -> f64 {
        self.0.saturating_sub(other.0) as f64 * 1e-9
    }

    /// Returns the stamp `us` later, µs.
    #[must_use]
    pub fn plus_us(self, us: i64) -> Self {
        Self(self.0.saturating_add(us.saturating_mul(1000)))
    }
}

/// Source of ROS time, with its relation to a session's clock.
#[derive(Clone, Copy, Debug)]
pub enum RosClock {
    /// This machine's clock, which other nodes stamp by, too.
    Machine,
    /// Clock of a simulated board, which is published on `/clock`.
    Simulated {
        /// ROS time at the start of the simulation.
        start: Stamp,
    },
}

impl RosClock {
    /// Returns the current ROS time, when the session's clock shows `now_us`.
    #[must_use]
    pub fn now(self, now_us: u64) -> Stamp {
        match self {
            Self::Machine => Stamp::of_machine(),
            Self::Simulated { start } => start.plus_us(now_us.cast_signed()),
        }
    }

    /// Returns the ROS time at which the session's clock showed `at_us`, when it shows `now_us` now.
    #[must_use]
    pub fn at(self, at_us: u64, now_us: u64) -> Stamp {
        self.now(now_us).plus_us(at_us.cast_signed().saturating_sub(now_us.cast_signed()))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn moments_that_no_message_has_become_the_nearest_ones() {
        assert_eq!(Stamp::from_time(Time { sec: 1, nanosec: 1_000_000_000 }), None);
        assert_eq!(Stamp::from_ns(-1).to_time(), Time { sec: -1, nanosec: 999_999_999 });
        assert_eq!(Stamp::from_ns(i64::MAX).to_time(), Time { sec: i32::MAX, nanosec: 999_999_999 });
        assert_eq!(Stamp::from_ns(i64::MIN).to_time(), Time { sec: i32::MIN, nanosec: 0 });
        assert!(Stamp::from_time(Time::default()).is_some_and(Stamp::is_none));
    }

    #[test]
    fn simulated_time_goes_by_the_board_and_not_by_the_machine() {
        let clock = RosClock::Simulated { start: Stamp::from_ns(5_000_000_000) };
        assert_eq!(clock.now(1_500_000).to_time(), Time { sec: 6, nanosec: 500_000_000 });
        assert_eq!(clock.at(1_000_000, 1_500_000).to_time(), Time { sec: 6, nanosec: 0 });
    }

    proptest! {
        #[test]
        fn what_a_message_has_comes_back(sec in any::<i32>(), nanosec in 0u32..1_000_000_000) {
            let time = Time { sec, nanosec };
            prop_assert_eq!(Stamp::from_time(time).expect("a moment").to_time(), time);
        }
    }
}
