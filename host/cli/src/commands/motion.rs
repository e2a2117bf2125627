//! `r4 move`, `r4 speed`, `r4 duty`

use r4_driver::Until;
use r4_protocol::Mode;
use r4_sim::Pace;
use serde::Serialize;

use super::{setpoint, speed_unit};
use crate::{
    args::{Args, Motion},
    output,
    quantity::Quantity,
    session,
};

/// What became of one command, in SI.
#[derive(Serialize)]
struct Outcome {
    board: String,
    channel: String,
    mode: String,
    unit: String,
    set: f64,
    position: f64,
    speed: f64,
    duty: f64,
    seconds: f64,
    settled: bool,
}

/// A speed or duty is held this long unless told otherwise, s.
const HOLD_S: f64 = 2.0;
/// A position is given up after this long unless told otherwise, s.
const TIMEOUT_S: f64 = 30.0;

pub(crate) fn run(args: &Args, motion: &Motion, mode: Mode) -> anyhow::Result<bool> {
    let (channel, set) = (motion.channel, motion.value);
    let until = match mode {
        Mode::Position => Until::Settled { timeout_s: motion.seconds.unwrap_or(TIMEOUT_S) },
        Mode::Speed | Mode::Duty | Mode::Switch => Until::Elapsed { seconds: motion.seconds.unwrap_or(HOLD_S) },
    };
    let ((end, position_unit), _) = session::run(args, Pace::Free, async |session| {
        let setpoint = setpoint(session, channel, mode, set)?;
        let position_unit = session.board.channel(channel)?.unit;
        let end = session.armed(async || Ok(session.board.drive(channel, setpoint, until).await?)).await?;
        Ok((end, position_unit))
    })?;
    if args.json {
        output::json(&Outcome {
            board: args.board.to_string(),
            channel: channel.to_string(),
            mode: mode.to_string(),
            unit: set.unit.to_string(),
            set: set.value,
            position: end.position,
            speed: end.speed,
            duty: end.duty,
            seconds: end.after_s,
            settled: end.settled,
        })?;
        return Ok(true);
    }
    let position = Quantity { value: end.position, unit: position_unit };
    let speed = Quantity { value: end.speed, unit: speed_unit(position_unit) };
    match mode {
        Mode::Position => {
            output::line(format_args!("{channel} rests at {position}, asked for {set}, after {:.2} s", end.after_s))?;
        }
        Mode::Speed | Mode::Duty | Mode::Switch => output::line(format_args!(
            "{channel} at {position}, moving at {speed}, duty {:.3}, after {:.2} s of {mode} {set}; now stopped",
            end.duty, end.after_s
        ))?,
    }
    Ok(true)
}
