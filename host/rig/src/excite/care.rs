//! Adaptation of an excitation to its motor: less duty or shorter stalls after a trip, and more patience for a motor
//! that does not move.

use r4_driver::Error as DriverError;
use r4_protocol::Cause;

use super::{Excitation, ExciteError, Limits};
use crate::Error;

/// Initial share of the stall's trip time after which a motor that does not move gets no duty.
const FIRST_PATIENCE: f64 = 0.6;
/// Factor on that share after a stall.
const LESS_PATIENCE: f64 = 0.5;
/// Factor on the duty beyond friction after a trip that less duty may avoid. With all of it, a shaft of 0.98 Hz behind
/// the motor (tuning seed 60660010) overheats the winding model of `osmc-bench`; with this share it does not.
const LESS_DUTY: f64 = 0.7;
/// Largest number of repeated recordings.
const REPEATS: usize = 4;

/// Limits for the next recording: tightened after a trip, relaxed when a motor does not move.
#[derive(Clone, Copy, Debug)]
pub struct Care {
    /// Share of the stall's trip time; infinite where the board may trip.
    pub(super) patience: f64,
    /// Share of the duty beyond friction.
    pub(super) strength: f64,
    repeats: usize,
    /// True once the motor moved in a kept recording. A later recording in which it stands is valid then: it shows what
    /// holds the motor.
    has_moved: bool,
}

impl Default for Care {
    fn default() -> Self {
        Self { patience: FIRST_PATIENCE, strength: 1.0, repeats: 0, has_moved: false }
    }
}

/// Decision about a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Keep the recording for the fit.
    Keep,
    /// Repeat the recording, for this reason.
    Again(&'static str),
}

impl Care {
    /// Decides about a recording by its result, and adapts the limits for the next one.
    ///
    /// # Errors
    /// [`ExciteError::Immovable`] when the motor moved in no recording, though the duty stayed on up to the board's
    /// stall limit; otherwise the recording's own error, when another attempt does not help.
    pub fn judge(&mut self, excitation: &Excitation, excited: Result<Excited, Error>) -> Result<Next, Error> {
        let is_unlimited = self.patience.is_infinite();
        let immovable = ExciteError::Immovable { channel: excitation.channel };
        let again = match &excited {
            Ok(Excited { moved }) if *moved || self.has_moved => {
                self.has_moved = true;
                return Ok(Next::Keep);
            }
            Ok(_) if is_unlimited => return Err(immovable.into()),
            Ok(_) => {
                // The guard may have cut the duty before a slow motor moved. Without the guard only the board's own
                // limit remains.
                self.patience = f64::INFINITY;
                "did not move: once more, until the board stops it"
            }
            Err(error) if trip(error, &[Cause::Stalled]) && is_unlimited => return Err(immovable.into()),
            Err(error) if trip(error, &[Cause::Stalled]) => {
                self.patience *= LESS_PATIENCE;
                "stalled: cleared, and again with less of that"
            }
            Err(error) if trip(error, &[Cause::Overload, Cause::EncoderImplausible]) => {
                self.strength *= LESS_DUTY;
                "was driven too hard: cleared, and again with less duty"
            }
            // Gentler excitation cannot avoid other errors: without a reason there is no further attempt.
            Err(_) => "",
        };
        self.repeats += 1;
        match excited {
            Err(error) if again.is_empty() || self.repeats > REPEATS => Err(error),
            _ => Ok(Next::Again(again)),
        }
    }
}

/// Result of an excitation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Excited {
    /// True when the motor moved, by more than steps of its sensor that may be noise.
    pub moved: bool,
}

/// Returns true when the board tripped by one of these causes.
fn trip(error: &Error, causes: &[Cause]) -> bool {
    matches!(error, Error::Board(DriverError::Stopped { causes: of }) if causes.iter().any(|cause| of.contains(*cause)))
}

/// Returns true when the board tripped by a cause that another excitation may avoid.
pub(super) fn is_avoidable(error: &Error) -> bool {
    trip(error, &[Cause::Stalled, Cause::Overload, Cause::EncoderImplausible])
}

/// Detector of a motor that does not move, before the board trips because of a stall.
pub(super) struct Guard {
    stall_duty: f64,
    travel: f64,
    patience_s: f64,
    /// Position, rad or m, and time, s, of the last motion.
    moved: Option<(f64, f64)>,
    /// Part of the plan in which the motor does not move; `None` while it does.
    stuck_in: Option<usize>,
}

impl Guard {
    pub(super) fn new(limits: &Limits, care: &Care) -> Self {
        Self {
            stall_duty: limits.stall_duty,
            travel: limits.stall_travel,
            patience_s: care.patience * limits.stall_s,
            moved: None,
            stuck_in: None,
        }
    }

    /// Returns true when the motor gets no duty for the rest of this part of the plan.
    pub(super) fn is_stuck(&mut self, now_s: f64, part: usize, position: f64, duty: f64) -> bool {
        let (from, since_s) = *self.moved.get_or_insert((position, now_s));
        // Below the stall duty the board counts no time either.
        if duty.abs() < self.stall_duty || (position - from).abs() >= self.travel {
            self.moved = Some((position, now_s));
        } else if now_s - since_s > self.patience_s {
            self.stuck_in = Some(part);
        }
        self.stuck_in == Some(part)
    }
}

#[cfg(test)]
mod tests {
    use r4_protocol::{Causes, ChannelId, ChannelKind};

    use super::*;

    const MOTOR: Excitation = Excitation { channel: ChannelId::new(ChannelKind::Osmc, 0), length_s: 15.0, duty: None };

    fn stopped(cause: Cause) -> Result<Excited, Error> {
        Err(DriverError::Stopped { causes: Causes::only(cause) }.into())
    }

    #[test]
    fn each_trip_leaves_less_of_what_made_it() {
        let mut care = Care::default();
        for (cause, patience, strength) in [
            (Cause::Stalled, 0.3, 1.0),
            (Cause::Overload, 0.3, 0.7),
            (Cause::EncoderImplausible, 0.3, 0.49),
            (Cause::Stalled, 0.15, 0.49),
        ] {
            let next = care.judge(&MOTOR, stopped(cause)).expect("another attempt");
            assert!(matches!(next, Next::Again(_)), "{cause}");
            assert!((care.patience - patience).abs() < 1e-12 && (care.strength - strength).abs() < 1e-12, "{cause}");
        }
        let last = care.judge(&MOTOR, stopped(Cause::Stalled));
        assert!(matches!(last, Err(Error::Board(DriverError::Stopped { .. }))), "{last:?}");
    }

    #[test]
    fn what_no_care_avoids_ends_it() {
        for cause in Cause::ALL {
            let avoidable = matches!(cause, Cause::Stalled | Cause::Overload | Cause::EncoderImplausible);
            assert_eq!(Care::default().judge(&MOTOR, stopped(cause)).is_ok(), avoidable, "{cause}");
        }
    }

    #[test]
    fn a_motor_that_never_moves_is_immovable() {
        for second in [Ok(Excited { moved: false }), stopped(Cause::Stalled)] {
            let mut care = Care::default();
            let first = care.judge(&MOTOR, Ok(Excited { moved: false })).expect("another attempt");
            assert!(matches!(first, Next::Again(_)));
            let second = care.judge(&MOTOR, second).expect_err("no motor that moves");
            let Error::Excite(why) = second else { panic!("{second}") };
            assert!(matches!(*why, ExciteError::Immovable { .. }), "{why}");
        }
    }

    #[test]
    fn a_motor_that_moved_once_may_stand_in_another_recording() {
        let mut care = Care::default();
        for moved in [true, false] {
            assert_eq!(care.judge(&MOTOR, Ok(Excited { moved })).expect("kept"), Next::Keep, "{moved}");
        }
    }
}
