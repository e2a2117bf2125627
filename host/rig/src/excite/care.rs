//! Care taken with an excited motor: what it may be given before it moves, and how much less after a trip.

use r4_driver::Error as DriverError;
use r4_protocol::Cause;

use super::{Excitation, ExciteError, Limits};
use crate::Error;

/// Share of the time to a stall's trip after which a motor that does not move gets no duty, at first.
const FIRST_PATIENCE: f64 = 0.6;
/// Factor of that share after a stall.
const LESS_PATIENCE: f64 = 0.5;
/// Factor of the duty beyond friction after a trip that less duty may avoid. A shaft of 0.98 Hz behind the motor (tuning seed 60660010)
/// overheats the winding model of `osmc-bench` at all of it, and does not at this share.
const LESS_DUTY: f64 = 0.7;
/// Largest number of recordings that are begun again.
const REPEATS: usize = 4;

/// Care with which recordings are made. Grows when the board trips, shrinks when a motor does not move.
#[derive(Clone, Copy, Debug)]
pub struct Care {
    /// Share of the time to a stall's trip; infinite where the board may trip.
    pub(super) patience: f64,
    /// Share of the duty beyond friction.
    pub(super) strength: f64,
    repeats: usize,
    /// Whether it moved in a recording that was kept: one in which it stands tells what holds it.
    has_moved: bool,
}

impl Default for Care {
    fn default() -> Self {
        Self { patience: FIRST_PATIENCE, strength: 1.0, repeats: 0, has_moved: false }
    }
}

/// What to do about a recording.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// Keep it.
    Keep,
    /// Make it again, for this reason.
    Again(&'static str),
}

impl Care {
    /// What to do about a recording in which the motor travelled so far (rad or m), or that ended with an error; changes how the next
    /// is made.
    ///
    /// # Errors
    /// [`ExciteError::Immovable`] when the motor has not moved in any recording though the board would have stopped it before it was let go, or the
    /// error that came in when another attempt does not help.
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
            Err(_) => "",
        };
        self.repeats += 1;
        match excited {
            Err(error) if again.is_empty() || self.repeats > REPEATS => Err(error),
            _ => Ok(Next::Again(again)),
        }
    }
}

/// What came of an excitation.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Excited {
    /// Whether the motor moved, by more than steps of its sensor that may be noise.
    pub moved: bool,
}

/// Whether the board tripped by one of these causes.
fn trip(error: &Error, causes: &[Cause]) -> bool {
    matches!(error, Error::Board(DriverError::Stopped { causes: of }) if causes.iter().any(|cause| of.contains(*cause)))
}

/// Whether the board tripped by what another way to excite the motor may avoid.
pub(super) fn is_avoidable(error: &Error) -> bool {
    trip(error, &[Cause::Stalled, Cause::Overload, Cause::EncoderImplausible])
}

/// Detects a motor that does not move, before the board trips because of a stall.
pub(super) struct Guard {
    stall_duty: f64,
    travel: f64,
    patience_s: f64,
    /// Position and time of the last motion.
    moved: Option<(f64, f64)>,
    /// The part of the plan in which the motor does not move.
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

    /// Whether the motor gets no duty for the rest of this part of the plan.
    pub(super) fn is_stuck(&mut self, now_s: f64, part: usize, position: f64, duty: f64) -> bool {
        let (from, since_s) = *self.moved.get_or_insert((position, now_s));
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
