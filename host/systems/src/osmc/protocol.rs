//! The paper's experiments with one motor of a board: set points, a hold, and the step of Tables 3 to 5.

use std::{
    cell::{Cell, RefCell},
    convert::Infallible,
    pin::pin,
};

use futures::future::{Either, select};
use r4_driver::Error as DriverError;
use r4_protocol::{Mode, SafetyState, Sample};
use r4_rig::{Error, Session};

use super::{
    bench::Bench,
    calibration::{self, Calibration, Reading},
    pid::{PRINTED, Pid},
    response::{Look, Purpose, Response, Segment},
};
use crate::sampler::Sampler;

/// Period of the motor's telemetry and of the host's controller, ms: about the rate to which the prints of the released
/// program limit it.
const PERIOD_MS: u16 = 10;
/// Time to live of the host's duties, ms: five periods.
const DUTY_TTL_MS: u16 = 50;
/// Rest at a set point before the next, s: time for a person to read an instrument.
const REST_S: f64 = 0.5;
/// Timeout of the board's loops for one set point, s; it counts as not reached then.
const TIMEOUT_S: f64 = 15.0;
/// Time within one count of the set point after which the host's controller counts as settled, s.
const RESTED_S: f64 = 0.3;

/// Controller of the motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Controller {
    /// The board's own position loop.
    Board,
    /// The paper's controller, on the host.
    Host {
        /// Bound of the sum, degree or count seconds; infinite for none.
        sum_max: f64,
    },
}

/// Plan of the moves, in their order: purpose, requested true position (rad or m), and the duration of the hold, s.
fn plan(bench: &Bench, hold_s: f64) -> Vec<(Purpose, f64, f64)> {
    let set = |position: f64| position / bench.per_si();
    let mut plan: Vec<_> = bench.set_points.iter().map(|point| (Purpose::SetPoint, set(*point), 0.0)).collect();
    if let Some(last) = bench.set_points.last() {
        plan.push((Purpose::Hold, set(*last), hold_s));
    }
    if let Some(step) = bench.step {
        plan.extend([(Purpose::Return, 0.0, 0.0), (Purpose::Step, set(step), 0.0)]);
    }
    plan
}

/// Runs the evaluation of one motor. A board that stops ends it early: [`Response::stopped`].
///
/// # Errors
/// The error of the board when it does not arm or disarm, or the link fails.
pub async fn evaluate(
    session: &Session<'_>,
    bench: &Bench,
    calibration: &Calibration,
    controller: Controller,
    hold_s: f64,
) -> Result<Response, Error> {
    let mut plan = plan(bench, hold_s);
    plan.iter_mut().for_each(|(_, position, _)| *position = calibration.command(bench, *position));
    watched(session, bench, async |segments| match controller {
        Controller::Board => by_board(session, bench, &plan, segments).await,
        Controller::Host { sum_max } => by_host(session, bench, &plan, sum_max, segments).await,
    })
    .await
}

/// Visits the set points up and down, twice, by the board's loops, and reads sensor and instrument at each.
///
/// # Errors
/// The errors of [`evaluate`].
pub async fn readings(
    session: &Session<'_>,
    bench: &Bench,
    noise: &mut Sampler,
) -> Result<(Response, Vec<Reading>), Error> {
    let up = bench.set_points.iter().chain(bench.set_points.iter().rev());
    let point = |set: &f64| (Purpose::SetPoint, set / bench.per_si(), 0.0);
    let plan: Vec<_> = up.clone().chain(up).map(point).collect();
    let response = watched(session, bench, async |segments| by_board(session, bench, &plan, segments).await).await?;
    let at_rest = |segment: &Segment| {
        let look = response.looks_of(segment).last()?;
        Some(Reading { sensed: look.sensed, measured: calibration::read(bench, look.truth, noise) })
    };
    let readings = response.segments.iter().filter_map(at_rest).collect();
    Ok((response, readings))
}

/// Arms, runs `work`, and records the motor's telemetry meanwhile.
async fn watched(
    session: &Session<'_>,
    bench: &Bench,
    work: impl AsyncFnOnce(&RefCell<Vec<Segment>>) -> Result<(), Error>,
) -> Result<Response, Error> {
    let board = session.board;
    let (looks, segments) = (RefCell::new(Vec::new()), RefCell::new(Vec::new()));
    board.subscribe(bench.channel, PERIOD_MS).await?;
    let resolution = f64::from(board.channel(bench.channel)?.resolution);
    let watch = async {
        let mut telemetry = board.telemetry();
        loop {
            let frame = telemetry.next().await?;
            let at_s = frame.device_us as f64 * 1e-6;
            for sample in &frame.samples {
                if let Sample::Motor { channel, position, duty, .. } = *sample
                    && channel == bench.channel
                {
                    let sensed = f64::from(position) * resolution;
                    let truth = session.true_position(channel).unwrap_or(sensed);
                    looks.borrow_mut().push(Look { at_s, sensed, truth, duty: duty.into() });
                }
            }
        }
    };
    let stopped = Cell::new(None);
    let drive = session.armed(async || match work(&segments).await {
        Err(Error::Board(error @ DriverError::Stopped { .. })) => {
            stopped.set(Some(error.to_string()));
            Ok(())
        }
        ended => ended,
    });
    let ended: Either<Result<(), Error>, Result<Infallible, Error>> = match select(pin!(drive), pin!(watch)).await {
        Either::Left((ended, _)) => Either::Left(ended),
        Either::Right((ended, _)) => Either::Right(ended),
    };
    match ended {
        Either::Left(ended) => ended?,
        Either::Right(Err(error)) => return Err(error),
        Either::Right(Ok(never)) => match never {},
    }
    Ok(Response { looks: looks.into_inner(), segments: segments.into_inner(), stopped: stopped.take() })
}

fn device_s(session: &Session<'_>) -> f64 {
    session.board.device_us() as f64 * 1e-6
}

async fn by_board(
    session: &Session<'_>,
    bench: &Bench,
    plan: &[(Purpose, f64, f64)],
    segments: &RefCell<Vec<Segment>>,
) -> Result<(), Error> {
    let board = session.board;
    for &(purpose, set, hold_s) in plan {
        let from_s = device_s(session);
        let mut settled = true;
        if purpose == Purpose::Hold {
            board.sleep_s(hold_s).await;
        } else {
            match board.move_to(bench.channel, set, TIMEOUT_S).await {
                Ok(_) => {}
                Err(DriverError::NotSettled { .. }) => settled = false,
                Err(error) => return Err(error.into()),
            }
            board.sleep_s(REST_S).await;
        }
        segments.borrow_mut().push(Segment { purpose, set, from_s, until_s: device_s(session), settled });
        // The board may also have tripped during a rest, which no command reports.
        let (state, causes) = board.safety();
        if state == SafetyState::Tripped {
            return Err(DriverError::Stopped { causes }.into());
        }
    }
    Ok(())
}

async fn by_host(
    session: &Session<'_>,
    bench: &Bench,
    plan: &[(Purpose, f64, f64)],
    sum_max: f64,
    segments: &RefCell<Vec<Segment>>,
) -> Result<(), Error> {
    let board = session.board;
    let resolution = f64::from(board.channel(bench.channel)?.resolution);
    let mut telemetry = board.telemetry();
    let mut duties = board.stream(&[(bench.channel, Mode::Duty)], DUTY_TTL_MS).await?;
    // The firmware refuses duties above 0.98: the bridge needs low phases to charge its bootstrap.
    let mut pid = Pid::new(PRINTED, bench.clip.min(0.98 * 255.0), sum_max);
    let mut before_s = f64::NAN;
    for &(purpose, set, hold_s) in plan {
        let from_s = device_s(session);
        let until_s = from_s + if purpose == Purpose::Hold { hold_s } else { bench.patience_s };
        pid.retarget();
        let mut rested_s = from_s;
        while before_s.is_nan() || before_s < until_s {
            let frame = telemetry.next().await?;
            if frame.state == SafetyState::Tripped {
                return Err(DriverError::Stopped { causes: frame.causes }.into());
            }
            let position = frame.samples.iter().find_map(|sample| match *sample {
                Sample::Motor { channel, position, .. } if channel == bench.channel => Some(position),
                _ => None,
            });
            let Some(position) = position else { continue };
            let (at_s, sensed) = (frame.device_us as f64 * 1e-6, f64::from(position) * resolution);
            // Quantised as by the paper's converter and counter.
            let sensed = (sensed / bench.count).round() * bench.count;
            let dt_s = if before_s.is_nan() { 0.0 } else { at_s - before_s };
            before_s = at_s;
            if (set - sensed).abs() > 1.5 * bench.count {
                rested_s = at_s;
            }
            let output = pid.step((set - sensed) * bench.per_error(), dt_s);
            duties.set(&[output / 255.0])?;
        }
        let settled = before_s - rested_s >= RESTED_S;
        segments.borrow_mut().push(Segment { purpose, set, from_s, until_s: before_s, settled });
    }
    Ok(())
}
