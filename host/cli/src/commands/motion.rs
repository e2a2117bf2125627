//! `r4 move`, `r4 step`, `r4 home`, `r4 speed`, `r4 duty`, `r4 press`: motions of one motor or stepper.

use anyhow::ensure;
use r4_driver::Until;
use r4_protocol::Mode;
use r4_rig::{Driven, quantity::speed_unit};
use r4_sim::Pace;
use serde::Serialize;

use crate::{
    args::{self, Args},
    output,
    session::{self, Session},
};

/// Result of one motion, in SI units.
#[derive(Serialize)]
struct Outcome {
    board: String,
    channel: String,
    mode: String,
    unit: String,
    set: f64,
    /// Final position; null without a sensor.
    position: f64,
    speed: f64,
    duty: f64,
    seconds: f64,
    settled: bool,
    homed: bool,
    /// True if the requested motion was reached or held at the end.
    held: bool,
}

/// Default hold time of a speed, duty or force, s.
const HOLD_S: f64 = 2.0;
/// Default time-out of a position, s.
const TIMEOUT_S: f64 = 30.0;
pub(crate) fn run(args: &Args, motion: &args::Motion, mode: Mode) -> anyhow::Result<bool> {
    let until = match mode {
        Mode::Position => Until::Settled { timeout_s: motion.seconds.unwrap_or(TIMEOUT_S) },
        _ => Until::Elapsed { seconds: motion.seconds.unwrap_or(HOLD_S) },
    };
    let drive = async |session: &Session<'_>| Ok(session.drive(motion.channel, mode, motion.value, until).await?);
    report(args, session::run(args, Pace::Free, drive)?.0)
}

pub(crate) fn home(args: &Args, home: &args::Home) -> anyhow::Result<bool> {
    // At speed 0 the search would only end by its time-out.
    ensure!(home.speed.value != 0.0, "a home switch is sought at a speed other than 0");
    let until = Until::Homed { timeout_s: home.seconds.unwrap_or(TIMEOUT_S) };
    let drive = async |session: &Session<'_>| Ok(session.drive(home.channel, Mode::Home, home.speed, until).await?);
    report(args, session::run(args, Pace::Free, drive)?.0)
}

pub(crate) fn step(args: &Args, step: &args::Step) -> anyhow::Result<bool> {
    let timeout_s = step.seconds.unwrap_or(TIMEOUT_S);
    let drive = async |session: &Session<'_>| Ok(session.step(step.channel, step.steps, timeout_s).await?);
    report(args, session::run(args, Pace::Free, drive)?.0)
}

/// Prints the result; false if the request was not reached or held.
fn report(args: &Args, driven: Driven) -> anyhow::Result<bool> {
    let Driven { info, mode, set, end, held } = driven;
    let (channel, position_unit, board) = (info.id, info.unit, args.board.described());
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
            homed: end.homed,
            held,
        })?;
    }
    let position = set.like(end.position, position_unit);
    let speed = set.like(end.speed, speed_unit(position_unit));
    // A motor without a sensor reports only its duty; a stepper has none.
    let place = if end.position.is_nan() { String::new() } else { format!(" at {position}, moving at {speed},") };
    let duty = info.mode(Mode::Duty).map_or(String::new(), |_| format!(" duty {:.3},", end.duty));
    let after_s = end.after_s;
    match mode {
        _ if args.json => {}
        Mode::Position => {
            output::line(format_args!(
                "{channel} rests at {position}, asked for {set}, after {after_s:.2} s, on {board}"
            ))?;
        }
        Mode::Home => {
            output::line(format_args!(
                "{channel} has found its home and rests at {position}, after {after_s:.2} s, on {board}"
            ))?;
        }
        _ => output::line(format_args!(
            "{channel}{place}{duty} after {after_s:.2} s of {mode} {set}, on {board}; now stopped"
        ))?,
    }
    if !held {
        eprintln!("r4: {channel} did not hold {mode} {set}: it was{place}{duty} after {after_s:.2} s, on {board}");
    }
    Ok(held)
}
