//! Session that reconnects by itself after its link was lost.

use std::time::{Duration, Instant};

use async_io::Timer;
use embedded_io_async::{Read, Write};
use r4_driver::{Board, Clock, Error, with_board};
use r4_protocol::{Cause, Causes, Refusal};

use crate::{Address, Key, Link, OpenError, open, ports};

/// Interval between attempts to reopen a lost link.
const RETRY_EVERY: Duration = Duration::from_millis(100);
/// Lag of the board's clock behind its expected reading that means a restart, µs: more than frames wait and more than
/// clocks drift apart in minutes.
const BEGAN_ANEW_US: u64 = 100_000;

/// Change in the state of a link.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// The link was lost; the board stops its outputs by itself. The link is reopened until it is back.
    Lost {
        /// Error that ended the link.
        why: Error,
    },
    /// The link is back with a new session, in which nothing is armed.
    Back {
        /// Time since the link was lost.
        after: Duration,
        /// Restart of the board meanwhile, if any.
        restart: Option<Restart>,
    },
}

/// Reason for a board's restart.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Restart {
    /// The board's watchdog expired: its firmware hung.
    Watchdog,
    /// Power failure, the reset button, or a new firmware.
    Power,
}

/// Opens a session with the board at `address` and runs `work`. If `work` ends because the link was lost (`is_lost`
/// decides by its error), opens a new session as soon as the board is back and runs `work` again. A board on USB is
/// searched by its serial number, in case its port has a new name.
///
/// A new session is disarmed and has no subscriptions. The bytes pass through the halves that `wrap` makes of each
/// opened link, for example to record them; `|link| (link.rx, link.tx)` passes them unchanged.
///
/// # Errors
/// The error of the first connection; later any error of `work` that is no loss of the link.
pub async fn with_reconnect<C, R, W, T, E>(
    address: &Address,
    key: Option<&Key>,
    clock: C,
    mut wrap: impl FnMut(Link) -> (R, W),
    mut work: impl AsyncFnMut(&Board<C>) -> Result<T, E>,
    is_lost: impl Fn(&E) -> Option<Error>,
    mut tell: impl FnMut(Event),
) -> Result<T, E>
where
    C: Clock,
    R: Read,
    W: Write,
    E: From<OpenError> + From<Error>,
{
    // Read before the first loss: a port that has vanished has no serial number any more.
    let usb_serial = match address {
        Address::Serial { path: Some(path), .. } => ports::serial_of(ports::list().unwrap_or_default(), path),
        _ => None,
    };
    let mut lost: Option<(Instant, u64)> = None;
    let mut at = address.clone();
    loop {
        let link = match open(&at, key).await {
            Ok(link) => link,
            Err(error) if lost.is_none() => return Err(error.into()),
            Err(_) => {
                if let (Address::Serial { path, .. }, Some(serial)) = (&mut at, &usb_serial) {
                    *path = ports::find_again(ports::list().unwrap_or_default(), serial).or(path.take());
                }
                Timer::after(RETRY_EVERY).await;
                continue;
            }
        };
        let mut heard_us = 0;
        let (rx, tx) = wrap(link);
        let session = with_board(rx, tx, clock.clone(), async |board| {
            if let Some((since, heard_us)) = lost.take() {
                let after = since.elapsed();
                let restart = restart(heard_us, after, board.device_us(), board.safety().1);
                tell(Event::Back { after, restart });
            }
            let result = work(board).await;
            // The board's clock when it was last heard: after the loss it decides whether the board has restarted.
            heard_us = board.device_us();
            result
        });
        let why = match session.await {
            Ok(Ok(value)) => return Ok(value),
            Ok(Err(error)) => match is_lost(&error) {
                Some(why) => why,
                None => return Err(error),
            },
            // The link is open, but the board does not answer yet, or still holds the previous session.
            Err(error) if lost.is_some() && (is_of_link(&error) || error == Error::Refused(Refusal::InUse)) => {
                Timer::after(RETRY_EVERY).await;
                continue;
            }
            Err(error) => return Err(error.into()),
        };
        tell(Event::Lost { why });
        lost = Some((Instant::now(), heard_us));
    }
}

/// Returns true for an error that a new link may cure.
#[must_use]
pub fn is_of_link(error: &Error) -> bool {
    matches!(error, Error::LinkLost { .. } | Error::LinkFailed { .. } | Error::TimedOut { .. })
}

/// Detects a restart of a board whose clock showed `heard_us` when it was last heard and shows `device_us` now, `after`
/// later.
fn restart(heard_us: u64, after: Duration, device_us: u64, causes: Causes) -> Option<Restart> {
    let expected_us = heard_us + after.as_micros() as u64;
    match device_us + BEGAN_ANEW_US < expected_us {
        true if causes.contains(Cause::WatchdogReset) => Some(Restart::Watchdog),
        true => Some(Restart::Power),
        false => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        RealClock, block_on,
        fake_board::{FakeBoard, Session},
    };

    #[derive(Debug, PartialEq)]
    enum Ended {
        NotThere,
        Board(Error),
    }

    impl From<OpenError> for Ended {
        fn from(_: OpenError) -> Self {
            Self::NotThere
        }
    }

    impl From<Error> for Ended {
        fn from(error: Error) -> Self {
            Self::Board(error)
        }
    }

    /// Requests a stop in each session until one succeeds; returns the number of sessions with a request, and the
    /// events.
    fn stop(address: &Address) -> (Result<u32, Ended>, Vec<Event>) {
        let (mut events, mut sessions) = (Vec::new(), 0);
        let work = async |board: &Board<RealClock>| {
            sessions += 1;
            board.stop().await?;
            Ok(sessions)
        };
        let is_lost = |ended: &Ended| match ended {
            Ended::Board(error) if is_of_link(error) => Some(error.clone()),
            _ => None,
        };
        let tell = |event| events.push(event);
        let ended = with_reconnect(address, None, RealClock, |link| (link.rx, link.tx), work, is_lost, tell);
        (block_on(ended), events)
    }

    #[test]
    fn a_session_comes_back_when_the_board_takes_it_again() {
        let cut = Session { device_us: 10_000_000, ends_at_stop: true, ..Session::default() };
        let in_use = Session { refusal: Some(Refusal::InUse), ..Session::default() };
        let back = Session { causes: Causes::only(Cause::WatchdogReset), ..Session::default() };
        let fake = FakeBoard::new(&[cut, in_use, back]);
        let (ended, events) = stop(&fake.address);
        assert_eq!(ended, Ok(2));
        assert!(
            matches!(
                events[..],
                [Event::Lost { why: Error::LinkFailed { .. } }, Event::Back { restart: Some(Restart::Watchdog), .. }]
            ),
            "{events:?}"
        );
    }

    #[test]
    fn only_a_link_that_was_there_is_waited_for() {
        let refused = |refusal| Session { refusal: Some(refusal), ..Session::default() };
        let in_use = FakeBoard::new(&[refused(Refusal::InUse)]);
        assert_eq!(stop(&in_use.address), (Err(Ended::Board(Error::Refused(Refusal::InUse))), vec![]));
        // The board was connected before, but now refuses for another reason.
        let cut = Session { ends_at_stop: true, ..Session::default() };
        let other = FakeBoard::new(&[cut, refused(Refusal::StorageFailed)]);
        let (ended, events) = stop(&other.address);
        assert_eq!(ended, Err(Ended::Board(Error::Refused(Refusal::StorageFailed))));
        assert!(matches!(events[..], [Event::Lost { .. }]), "{events:?}");
        let nowhere = Address::Serial { path: Some("/dev/no-such-port".into()), baud: 9600 };
        assert_eq!(stop(&nowhere), (Err(Ended::NotThere), vec![]));
    }

    #[test]
    fn a_clock_that_is_behind_tells_of_a_restart() {
        let after = Duration::from_millis(500);
        let watchdog = Causes::only(Cause::WatchdogReset).union(Causes::only(Cause::LinkLost));
        let others = Causes::only(Cause::LinkLost);
        // The board was last heard at 10 s: without a restart its clock shows 10.5 s now, or some 0.1 s less if frames
        // waited.
        for (device_us, began_anew) in [
            (10_500_000, false),
            (10_400_000, false),
            (60_000_000, false),
            (10_399_999, true),
            (400_000, true),
            (0, true),
        ] {
            let why = |causes| restart(10_000_000, after, device_us, causes);
            assert_eq!(why(watchdog), began_anew.then_some(Restart::Watchdog), "{device_us}");
            assert_eq!(why(others), began_anew.then_some(Restart::Power), "{device_us}");
        }
    }

    #[test]
    fn what_a_link_may_be_the_reason_of_is_tried_again() {
        for of_link in [
            Error::LinkLost { silent_ms: 200 },
            Error::LinkFailed { reason: "unplugged".into() },
            Error::TimedOut { request: "hello", after_ms: 100 },
        ] {
            assert!(is_of_link(&of_link), "{of_link}");
        }
        for other in [
            Error::Refused(Refusal::InUse),
            Error::WrongReply { request: "hello" },
            Error::Stopped { causes: Causes::NONE },
            Error::StreamOpen,
        ] {
            assert!(!is_of_link(&other), "{other}");
        }
    }
}
