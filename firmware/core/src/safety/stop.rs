//! Stops that brake before they switch off (IEC 60204-1, category 1), as pure functions of time.
//!
//! A stop for causes that leave supply, bus and control loop working ([`Causes::allow_braking`]) delays the stop lines
//! and the motors' relay while the control loop brakes. The supervisor ends it at its deadline, when any other cause
//! appears, or when the control loop has not written the brakes in time: the rest of the stop is then category 0.

use embassy_time::{Duration, Instant};
use r4_protocol::Causes;

/// Time within which the control loop must write the brakes, or the lines stop the board: the documented time in which
/// all motors are written safe.
const WRITTEN_WITHIN: Duration = Duration::from_millis(5);

/// Stop that brakes before it switches off.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BrakingStop {
    until: Instant,
    /// Deadline for writing the brakes; `None` once they are written.
    write_by: Option<Instant>,
}

impl BrakingStop {
    /// Begins a stop at `now` for `causes` on a board that brakes for `brake`; `None` where it is switched off at once.
    #[must_use]
    pub fn begin(brake: Duration, causes: Causes, now: Instant) -> Option<Self> {
        let brakes = brake > Duration::MIN && causes.allow_braking();
        brakes.then_some(Self { until: now + brake, write_by: Some(now + WRITTEN_WITHIN) })
    }

    /// Records that the control loop has written the brakes.
    #[must_use]
    pub fn written(self) -> Self {
        Self { write_by: None, ..self }
    }

    /// Returns true if it still brakes at `now`, where `causes` are all causes since its beginning. Once false, the
    /// stop is over.
    #[must_use]
    pub fn goes_on(self, causes: Causes, now: Instant) -> bool {
        causes.allow_braking() && now < self.until && self.write_by.is_none_or(|by| now < by)
    }
}

#[cfg(test)]
mod tests {
    use r4_protocol::Cause;

    use super::*;

    const BRAKE: Duration = Duration::from_millis(300);

    fn at(ms: u64) -> Instant {
        Instant::from_millis(1000 + ms)
    }

    /// Checks every set of causes, also with bits of later versions.
    #[test]
    fn only_the_causes_that_leave_the_board_working_allow_it() {
        let working = [Cause::Proximity, Cause::LinkLost, Cause::HostStop, Cause::EncoderImplausible, Cause::Stalled];
        // One bit more than there are causes.
        let bits = Cause::ALL.len() + 1;
        for causes in (0..1 << bits).map(Causes::from_bits) {
            let allowed = (0..bits)
                .filter(|bit| causes.bits() >> bit & 1 != 0)
                .all(|bit| Cause::ALL.get(bit).is_some_and(|cause| working.contains(cause)));
            let stop = BrakingStop::begin(BRAKE, causes, at(0));
            assert_eq!(stop.is_some(), allowed, "{causes}");
            let braking = BrakingStop::begin(BRAKE, Causes::NONE, at(0)).expect("a host disarms").written();
            assert_eq!(braking.goes_on(causes, at(1)), allowed, "{causes}");
        }
    }

    #[test]
    fn it_ends_at_its_deadline_or_when_the_brakes_are_not_written() {
        let stop = BrakingStop::begin(BRAKE, Causes::only(Cause::LinkLost), at(0)).expect("it brakes");
        for ms in 0..1000 {
            assert_eq!(stop.goes_on(Causes::NONE, at(ms)), ms < 5, "{ms} ms, not written");
            assert_eq!(stop.written().goes_on(Causes::NONE, at(ms)), ms < 300, "{ms} ms, written");
        }
        assert_eq!(BrakingStop::begin(Duration::MIN, Causes::NONE, at(0)), None);
    }
}
