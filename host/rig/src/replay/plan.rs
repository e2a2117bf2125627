//! The requests of a recorded run, with their times.

use r4_log::Log;
use r4_protocol::{Cause, Request, SafetyState};

use super::ReplayError;

/// Requests of a recorded run, with their times.
#[derive(Debug, PartialEq)]
pub struct Plan {
    /// Requests in the order of time.
    pub steps: Vec<Step>,
    /// End of the session, µs since the host said hello.
    pub end_us: u64,
    /// True when arming and subscriptions are inferred from states and samples, because the log has only set points.
    pub inferred: bool,
}

/// A request and its time.
#[derive(Debug, PartialEq)]
pub struct Step {
    /// Time since the host said hello, µs.
    pub at_us: u64,
    /// Request that is sent.
    pub request: Request,
}

/// Longest time between the stamp of a frame and its departure from the board, µs: a control period of 1 ms, and its
/// time on the link.
const FRAME_AFTER_US: u64 = 2_000;
/// Time of an inferred arming before the set point that needs it, s.
const ARM_BEFORE_S: f64 = 0.001;

impl Plan {
    /// Extracts the requests of the run that `log` records.
    ///
    /// # Errors
    /// [`ReplayError::Empty`] for a log without requests and samples.
    pub fn of(log: &Log) -> Result<Self, ReplayError> {
        let (start_s, end_s) = log.time_span_s().ok_or(ReplayError::Empty)?;
        let timed: Option<Vec<(u64, &Request)>> =
            log.requests.iter().map(|logged| Some((logged.sent_us?, &logged.request))).collect();
        let timed = timed.filter(|timed| !timed.is_empty());
        let us = |time_s: f64| ((time_s - start_s).max(0.0) * 1e6).round() as u64;
        let Some(timed) = timed else {
            return Ok(Self { steps: inferred(log, us), end_us: us(end_s), inferred: true });
        };
        let bye = timed.iter().find(|(_, request)| **request == Request::Bye).map(|(at_us, _)| *at_us);
        // Host and board clocks run alike, within the accuracy that the end of a truncated run needs.
        let first = log.requests.first();
        let offset_us = first.map_or(0, |first| first.sent_us.unwrap_or_default().saturating_sub(us(first.time_s)));
        let end_us = bye.unwrap_or_else(|| us(end_s) + offset_us + FRAME_AFTER_US);
        let steps = timed.iter().take_while(|(_, request)| **request != Request::Bye);
        let steps = steps.map(|(at_us, request)| Step { at_us: *at_us, request: (*request).clone() }).collect();
        Ok(Self { steps, end_us, inferred: false })
    }
}

/// Infers the requests that explain the states, samples and set points of the log.
fn inferred(log: &Log, us: impl Fn(f64) -> u64) -> Vec<Step> {
    let mut steps = Vec::new();
    for coverage in log.coverage() {
        let period_ms = coverage.rate_hz.map_or(0.0, |rate_hz| (1000.0 / rate_hz).round());
        if period_ms >= 1.0 {
            let request = Request::Subscribe { channel: coverage.channel, period_ms: period_ms as u16 };
            steps.push(Step { at_us: 0, request });
        }
    }
    let (mut before, mut before_s) = (SafetyState::Disarmed, f64::NEG_INFINITY);
    for change in &log.states {
        let request = match (before, change.state) {
            (SafetyState::Disarmed, SafetyState::Armed) => Some(Request::Arm),
            (SafetyState::Armed, SafetyState::Disarmed) => Some(Request::Disarm),
            (SafetyState::Tripped, SafetyState::Disarmed) => Some(Request::Clear),
            (_, SafetyState::Tripped) if change.causes.contains(Cause::HostStop) => Some(Request::Stop),
            // Other trips are the board's own, and must occur again by themselves.
            _ => None,
        };
        // A state is recorded with the next sample only; an accepted set point proves that the board was armed before.
        let taken = log.commands.iter().find(|command| (before_s..change.time_s).contains(&command.time_s));
        let time_s = match (&request, taken) {
            (Some(Request::Arm), Some(command)) => command.time_s - ARM_BEFORE_S,
            _ => change.time_s,
        };
        steps.extend(request.map(|request| Step { at_us: us(time_s), request }));
        (before, before_s) = (change.state, change.time_s);
    }
    steps.extend(log.requests.iter().map(|logged| Step { at_us: us(logged.time_s), request: logged.request.clone() }));
    // The sort is stable: subscriptions stay before other requests at time 0.
    steps.sort_by_key(|step| step.at_us);
    steps
}
