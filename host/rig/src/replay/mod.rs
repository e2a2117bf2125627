//! Replays: the requests of a recorded run are sent to a virtual board again, at their times.

mod error;
mod plan;

use std::{pin::pin, task::Poll};

use futures::{
    StreamExt,
    future::{Either, LocalBoxFuture, select},
    poll,
    stream::FuturesUnordered,
};
use r4_driver::{Board, Clock as _, Error as DriverError};
use r4_log::Log;
use r4_protocol::{PathPoint, Request};

pub use error::ReplayError;
pub use plan::{Plan, Step};

use crate::{Error, HostClock, Recorded, Rig, Session, recording};

/// Replays the run of `log` on the board of `rig`. Returns the new log and the offset that maps its times to those of
/// `log`, s.
///
/// # Errors
/// [`Error::Replay`] when the log cannot be replayed; [`Error::NotVirtual`] for a board on a link; the error of a board
/// that fails otherwise than by a refusal.
pub fn again(rig: &Rig, log: &Log) -> Result<(Log, f64), Error> {
    rig.target.robot()?;
    let plan = Plan::of(log).map_err(|error| ReplayError::Unsuitable(Box::new(error)))?;
    let program = concat!("r4-rig ", env!("CARGO_PKG_VERSION")).to_owned();
    let tap = |output| recording::tap(&rig.target, rig.seed, program, "replay".to_owned(), output);
    let Recorded { result, log: bytes, log_error } = rig.recorded(tap, async |session| play(session, &plan).await);
    result?;
    log_error.map_or(Ok(()), |error| Err(ReplayError::NotRecorded(error)))?;
    let again = Log::from_bytes(&bytes).map_err(ReplayError::NotRead)?;
    let shift_s = shift_s(log, &again);
    Ok((again, shift_s))
}

/// Sends every request of `plan` at its time, and returns at the recorded end of the session. The session must be
/// recorded, since times count from the start of the recording.
///
/// # Errors
/// The error of a failed link; refusals and lost answers are part of the run.
pub async fn play(session: &Session<'_>, plan: &Plan) -> Result<(), Error> {
    let (board, clock) = (session.board, &session.clock);
    let began_us = session.tap.as_ref().and_then(|tap| tap.borrow().began_us()).unwrap_or_default();
    // If the recorded link opened faster than this one, all requests are later by the difference.
    let opened_us = clock.now_us() - began_us;
    let late_us = plan.steps.first().map_or(0, |first| opened_us.saturating_sub(first.at_us));
    let at = |after_us: u64| began_us + late_us + after_us;
    let mut under_way: FuturesUnordered<LocalBoxFuture<'_, Result<(), DriverError>>> = FuturesUnordered::new();
    for step in &plan.steps {
        wait(clock, at(step.at_us), &mut under_way).await?;
        let mut sending = request(board, &step.request);
        // Polled once to send it now; its answer comes later.
        match poll!(&mut sending) {
            Poll::Ready(result) => answered(result)?,
            Poll::Pending => under_way.push(sending),
        }
    }
    wait(clock, at(plan.end_us), &mut under_way).await
}

/// Awaits answers until `until_us`.
async fn wait(
    clock: &HostClock,
    until_us: u64,
    under_way: &mut FuturesUnordered<LocalBoxFuture<'_, Result<(), DriverError>>>,
) -> Result<(), Error> {
    let mut sleep = pin!(clock.sleep_until(until_us));
    while !under_way.is_empty() {
        match select(under_way.next(), &mut sleep).await {
            Either::Left((result, _)) => answered(result.unwrap_or(Ok(())))?,
            Either::Right(((), _)) => return Ok(()),
        }
    }
    sleep.await;
    Ok(())
}

/// Returns only errors of the link: refusals and lost answers are part of the run.
fn answered(result: Result<(), DriverError>) -> Result<(), Error> {
    match result {
        Err(error @ (DriverError::LinkLost { .. } | DriverError::LinkFailed { .. })) => Err(error.into()),
        Ok(()) | Err(_) => Ok(()),
    }
}

/// Sends `request` by the driver's function for it.
fn request<'b>(board: &'b Board<HostClock>, request: &'b Request) -> LocalBoxFuture<'b, Result<(), DriverError>> {
    Box::pin(async move {
        match request {
            Request::Arm => board.arm().await,
            Request::Disarm => board.disarm().await,
            Request::Clear => board.clear().await,
            Request::Stop => board.stop().await,
            Request::Set { channel, setpoint, .. } => board.set(*channel, *setpoint).await,
            Request::Subscribe { channel, period_ms } => board.subscribe(*channel, *period_ms).await,
            Request::SetGains { channel, mode, gains } => board.set_gains(*channel, *mode, *gains).await,
            Request::SetTuning { channel, tuning } => board.set_tuning(*channel, *tuning).await,
            Request::Stats => board.stats().await.map(|_| ()),
            Request::SetParameter { key, value } => board.set_parameter(*key, *value).await,
            Request::SetName { robot } => board.set_name(robot).await,
            Request::Follow { channel, points, .. } => {
                // The log counts the points' times from the request; the board expects its own clock.
                let now_us = board.device_us();
                let dated = |point: &PathPoint| PathPoint { at_us: point.at_us.saturating_add(now_us), ..*point };
                board.follow(*channel, &points.iter().map(dated).collect::<Vec<_>>()).await
            }
            Request::SaveParameters => board.save_parameters().await,
            Request::ResetParameters => board.reset_parameters().await,
            Request::Restart => board.restart().await,
            Request::Bootloader => board.restart_in_bootloader().await,
            Request::I2cTransfer { bus, address, write, read } => {
                board.i2c_transfer(*bus, *address, write, *read).await.map(|_| ())
            }
            Request::UartWrite { port, bytes } => board.uart_write(*port, bytes).await,
            Request::UartRead { port } => board.uart_read(*port).await.map(|_| ()),
            // The driver itself sends these at the start and the end of a session, or a recording does not contain
            // them.
            Request::Hello { .. }
            | Request::Bind { .. }
            | Request::Log { .. }
            | Request::Image
            | Request::Bye
            | Request::Describe { .. }
            | Request::DescribeParameter { .. }
            | Request::Fault { .. }
            | Request::FaultSnapshot { .. } => Ok(()),
        }
    })
}

/// Offset that maps the times of `again` to those of `log`, s: it makes the first set points coincide, or without any,
/// the first requests.
#[must_use]
pub fn shift_s(log: &Log, again: &Log) -> f64 {
    let commands = log.commands.first().zip(again.commands.first()).map(|(a, b)| a.time_s - b.time_s);
    let requests = || log.requests.first().zip(again.requests.first()).map(|(a, b)| a.time_s - b.time_s);
    let starts = || log.time_span_s().zip(again.time_span_s()).map(|(a, b)| a.0 - b.0);
    commands.or_else(requests).or_else(starts).unwrap_or_default()
}
