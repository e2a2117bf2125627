//! Excitation: duties whose recording makes a motor's parameters identifiable, within the limits that the board
//! reports.

mod care;
mod error;
mod plan;

use std::pin::pin;

use futures::future::{Either, select};
use r4_driver::Error as DriverError;
use r4_protocol::{ChannelId, ChannelInfo, ChannelKind, Mode, Parameter, SafetyState, Sample, Setpoint};

use care::Guard;
pub use care::{Care, Excited, Next};
pub use error::ExciteError;
pub use plan::{MORE, Plan, TRAIN};

use crate::{Error, Session, parameters::Parameters};

/// Period of the motor's telemetry, ms.
const TELEMETRY_MS: u16 = 5;
/// Shortest time between two duties of a sine or a ramp, s.
const SEND_EVERY_S: f64 = 0.02;
/// Timeout of the telemetry, s.
const SILENT_S: f64 = 0.3;
/// Largest duty as a share of the board's limit, so that rounding does not exceed it.
const BELOW_LIMIT: f64 = 0.98;
/// Sensor steps of travel above which a motor has moved: one step may be noise, two its rounding.
const LEAST_STEPS: f64 = 2.0;
/// Longest time for a winding to cool, s: four of the time constants that robots here declare (30 s).
const COOLS_WITHIN_S: f64 = 120.0;
/// Share of the range at either end in which the direction of the motor is reversed.
const MARGIN: f64 = 0.15;

/// Experiment with one motor, which must be free to move in both directions.
#[derive(Clone, Copy, Debug)]
pub struct Excitation {
    /// Channel of the motor.
    pub channel: ChannelId,
    /// Length of each recording, s.
    pub length_s: f64,
    /// Largest duty; `None` uses just below the board's limit.
    pub duty: Option<f64>,
}

/// Limits of the motor that the board reports, SI.
#[derive(Clone, Copy, Debug)]
struct Limits {
    duty_max: f64,
    static_duty: f64,
    stall_duty: f64,
    stall_travel: f64,
    stall_s: f64,
    range: (f64, f64),
    resolution: f64,
}

impl Limits {
    fn new(info: &ChannelInfo, parameters: &Parameters) -> Result<Self, Error> {
        let number = |parameter| parameters.active(info.id, parameter).map(f64::from);
        Ok(Self {
            duty_max: number(Parameter::DutyMax)?,
            static_duty: number(Parameter::StaticDuty)?,
            stall_duty: number(Parameter::StallDuty)?,
            stall_travel: number(Parameter::StallTravel)?,
            stall_s: number(Parameter::StallTimeMs)? * 1e-3,
            range: (number(Parameter::PositionMin)?, number(Parameter::PositionMax)?),
            resolution: info.resolution.into(),
        })
    }
}

/// Arms, excites the motor by plan number `index` and disarms. Clears a trip that [`Care`] may avoid the next time.
/// Calls `progress` with the completed share.
///
/// # Errors
/// [`ExciteError`] when the channel cannot be excited; the causes when the board trips. [`Care::judge`] decides whether
/// another attempt helps.
pub async fn excite(
    session: &Session<'_>,
    excitation: &Excitation,
    index: usize,
    care: &Care,
    progress: &dyn Fn(f64),
) -> Result<Excited, Error> {
    let (board, channel) = (session.board, excitation.channel);
    let info = board.channel(channel)?;
    let moves = matches!(channel.kind, ChannelKind::Osmc | ChannelKind::Actuator | ChannelKind::Dhb);
    if !(moves && info.mode(Mode::Duty).is_some() && info.mode(Mode::Position).is_some()) {
        return Err(ExciteError::Unfit { channel }.into());
    }
    let limits = Limits::new(info, &Parameters::of(board).await?)?;
    let cap = match excitation.duty {
        Some(duty) if duty > limits.duty_max => {
            return Err(ExciteError::TooMuch { channel, duty_max: limits.duty_max }.into());
        }
        Some(duty) => duty,
        None => BELOW_LIMIT * limits.duty_max,
    };
    if cap <= limits.static_duty {
        return Err(ExciteError::BelowFriction { channel, duty: cap, static_duty: limits.static_duty }.into());
    }
    // Only the part above friction is reduced; otherwise a gentler excitation might not move the motor at all.
    let cap = limits.static_duty + care.strength * (cap - limits.static_duty);
    let plan = Plan::new(index, excitation.length_s, limits.static_duty, cap);
    let driven = session.armed(async || drive(session, channel, &plan, &limits, care, progress).await).await;
    if driven.as_ref().is_err_and(care::is_avoidable) {
        clear(session).await?;
    }
    driven
}

/// Clears a trip; after overheating, once the winding has cooled.
async fn clear(session: &Session<'_>) -> Result<(), Error> {
    let mut waited_s = 0.0;
    loop {
        match session.board.clear().await {
            Err(DriverError::Refused { .. }) if waited_s < COOLS_WITHIN_S => session.board.sleep_s(1.0).await,
            cleared => return Ok(cleared.map_err(ExciteError::NotCleared)?),
        }
        waited_s += 1.0;
    }
}

/// Sends the duties of `plan`, and keeps the motor within its range and below a stall.
async fn drive(
    session: &Session<'_>,
    channel: ChannelId,
    plan: &Plan,
    limits: &Limits,
    care: &Care,
    progress: &dyn Fn(f64),
) -> Result<Excited, Error> {
    let board = session.board;
    let mut telemetry = board.telemetry();
    board.subscribe(channel, TELEMETRY_MS).await?;
    let (low, high) = limits.range;
    let inside = (low + MARGIN * (high - low), high - MARGIN * (high - low));
    let mut guard = Guard::new(limits, care);
    // A motor that starts at one end of its range is sent away from it first.
    let mut direction = 1.0;
    let (mut begin_s, mut sent, mut sent_s) = (None, None, f64::NEG_INFINITY);
    let (mut lowest, mut highest) = (f64::INFINITY, f64::NEG_INFINITY);
    let mut armed = false;
    loop {
        let frame = match select(pin!(telemetry.next()), pin!(board.sleep_s(SILENT_S))).await {
            Either::Left((frame, _)) => frame?,
            Either::Right(_) => return Err(ExciteError::Silent { channel, silent_s: SILENT_S }.into()),
        };
        // This frame was sent before the board armed.
        if !armed && frame.state == SafetyState::Disarmed {
            continue;
        }
        armed = true;
        if frame.state != SafetyState::Armed {
            return Err(DriverError::Stopped { causes: frame.causes }.into());
        }
        let found = frame.samples.iter().find_map(|sample| match *sample {
            Sample::Motor { channel: of, position, .. } if of == channel => Some(position),
            _ => None,
        });
        let Some(position) = found.map(|counts| f64::from(counts) * limits.resolution) else { continue };
        let now_s = frame.device_us as f64 * 1e-6;
        let after_s = now_s - *begin_s.get_or_insert(now_s);
        (lowest, highest) = (lowest.min(position), highest.max(position));
        let Some((part, planned)) = plan.at(after_s) else {
            return Ok(Excited { moved: highest - lowest > LEAST_STEPS * limits.resolution });
        };
        let mut duty = direction * planned;
        if position > inside.1 && duty > 0.0 || position < inside.0 && duty < 0.0 {
            direction = -direction;
            duty = -duty;
        }
        if guard.is_stuck(now_s, part, position, sent.unwrap_or(0.0)) {
            duty = 0.0;
        }
        let due = now_s - sent_s >= SEND_EVERY_S || duty == 0.0;
        if sent != Some(duty) && due {
            board.set(channel, Setpoint { mode: Mode::Duty, value: duty as f32 }).await?;
            (sent, sent_s) = (Some(duty), now_s);
            progress(after_s / plan.length_s());
        }
    }
}
