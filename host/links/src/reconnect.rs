//! A session that comes back by itself when its link does.

use std::time::{Duration, Instant};

use async_io::Timer;
use embedded_io_async::{Read, Write};
use r4_driver::{Board, Clock, Error, with_board};
use r4_protocol::{Cause, Refusal};

use crate::{Address, Key, Link, OpenError, open, ports};

/// How often a lost link is tried again.
const RETRY_EVERY: Duration = Duration::from_millis(100);
/// A board's clock that is this far behind where it should be began anew, µs: more than frames wait, and clocks drift in
/// minutes.
const BEGAN_ANEW_US: u64 = 100_000;

/// What became of a link.
#[derive(Clone, Debug, PartialEq)]
pub enum Event {
    /// It is lost; what the board drove stops by itself. It is tried again until it is back.
    Lost {
        /// How that was noticed.
        why: Error,
    },
    /// It is back, with a new session: nothing is armed.
    Back {
        /// Since it was lost.
        after: Duration,
        /// What the board did meanwhile.
        restart: Option<Restart>,
    },
}

/// Why a board began anew.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Restart {
    /// Its watchdog: the firmware hung.
    Watchdog,
    /// Power, the reset button, a new firmware.
    Power,
}

/// Opens a session with the board at `address` and runs `work`, and runs it again in a new session each time that it ended
/// because the link was lost (`is_lost` tells by its error), as soon as the board is there again. A board on USB is looked
/// for by its serial number if its port has another name then.
///
/// Nothing is armed and nothing subscribed in a new session. Its bytes go through what `wrap` makes of the halves of each link that
/// was opened, to listen to them; `|link| (link.rx, link.tx)` leaves them as they are.
///
/// # Errors
/// When the board is not there to begin with, and whatever else `work` ends with.
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
    let usb_serial = match address {
        Address::Serial { path: Some(path), .. } => ports::serial_of(path),
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
                    *path = ports::find_again(serial).or(path.take());
                }
                Timer::after(RETRY_EVERY).await;
                continue;
            }
        };
        let mut heard_us = 0;
        let (rx, tx) = wrap(link);
        let session = with_board(rx, tx, clock.clone(), async |board| {
            if let Some((since, expected_us)) = lost.take() {
                tell(Event::Back { after: since.elapsed(), restart: restart(board, since, expected_us) });
            }
            let result = work(board).await;
            heard_us = board.device_us();
            result
        });
        let why = match session.await {
            Ok(Ok(value)) => return Ok(value),
            Ok(Err(error)) => match is_lost(&error) {
                Some(why) => why,
                None => return Err(error),
            },
            // There, but not answering yet, or not knowing yet that our last session is over.
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

/// The link is the reason, or may be: it may be better once it is opened again.
#[must_use]
pub fn is_of_link(error: &Error) -> bool {
    matches!(error, Error::LinkLost { .. } | Error::LinkFailed { .. } | Error::TimedOut { .. })
}

fn restart<C: Clock>(board: &Board<C>, since: Instant, expected_us: u64) -> Option<Restart> {
    let (_, causes) = board.safety();
    let expected_us = expected_us + since.elapsed().as_micros() as u64;
    let began_anew = board.device_us() + BEGAN_ANEW_US < expected_us;
    match began_anew {
        true if causes.contains(Cause::WatchdogReset) => Some(Restart::Watchdog),
        true => Some(Restart::Power),
        false => None,
    }
}
