//! `r4 move`, `r4 step`, `r4 home`, `r4 speed`, `r4 duty`

use anyhow::ensure;
use r4_driver::{Error, Motion, Until};
use r4_protocol::{ChannelId, ChannelInfo, ChannelKind, Mode, Sample, Unit};
use r4_sim::Pace;
use serde::Serialize;

use super::{NotReached, Unsuitable, setpoint, speed_unit};
use crate::{
    args::{self, Args},
    output,
    session::{self, Session},
};
use r4_rig::quantity::Quantity;

/// What became of one command, in SI.
#[derive(Serialize)]
struct Outcome {
    board: String,
    channel: String,
    mode: String,
    unit: String,
    set: f64,
    /// Null where nothing measures it.
    position: f64,
    speed: f64,
    duty: f64,
    seconds: f64,
    settled: bool,
    homed: bool,
    /// Whether what was asked for held at the end.
    held: bool,
}

/// A duty counts as held within this: the bridge has 1/4096.
const DUTY_WITHIN: f64 = 0.001;
/// A speed counts as held within this share of it, and what a motor's sensor resolves at low speed, rad/s and m/s.
const SPEED_WITHIN: f64 = 0.1;
const RAD_S_RESOLVED: f64 = 0.02;
const M_S_RESOLVED: f64 = 0.000_3;

/// A speed or duty is held this long unless told otherwise, s.
const HOLD_S: f64 = 2.0;
/// A position is given up after this long unless told otherwise, s.
const TIMEOUT_S: f64 = 30.0;
/// How often a stepper is looked at before it steps, ms.
const LOOK_EVERY_MS: u16 = 10;

/// What was asked of a motor, and what it did.
struct Driven {
    info: ChannelInfo,
    mode: Mode,
    set: Quantity,
    end: Result<Motion, Error>,
}

pub(crate) fn run(args: &Args, motion: &args::Motion, mode: Mode) -> anyhow::Result<bool> {
    let until = match mode {
        Mode::Position => Until::Settled { timeout_s: motion.seconds.unwrap_or(TIMEOUT_S) },
        _ => Until::Elapsed { seconds: motion.seconds.unwrap_or(HOLD_S) },
    };
    let drive = async |session: &Session<'_>| drive(session, motion.channel, mode, motion.value, until).await;
    report(args, session::run(args, Pace::Free, drive)?.0)
}

pub(crate) fn home(args: &Args, home: &args::Home) -> anyhow::Result<bool> {
    ensure!(home.speed.value != 0.0, "a home switch is sought at a speed other than 0");
    let until = Until::Homed { timeout_s: home.seconds.unwrap_or(TIMEOUT_S) };
    let drive = async |session: &Session<'_>| drive(session, home.channel, Mode::Home, home.speed, until).await;
    report(args, session::run(args, Pace::Free, drive)?.0)
}

pub(crate) fn step(args: &Args, step: &args::Step) -> anyhow::Result<bool> {
    let channel = step.channel;
    let until = Until::Settled { timeout_s: step.seconds.unwrap_or(TIMEOUT_S) };
    let drive = async |session: &Session<'_>| {
        let board = session.board;
        let resolution = f64::from(board.channel(channel)?.resolution);
        if channel.kind != ChannelKind::Stepper {
            let why = "is no stepper: `r4 move` sends it to a position".to_owned();
            return Err(Unsuitable { channel, why }.into());
        }
        let mut telemetry = board.telemetry();
        board.subscribe(channel, LOOK_EVERY_MS).await?;
        let counts = loop {
            let frame = telemetry.next().await?;
            let position = frame.samples.iter().find_map(|sample| match *sample {
                Sample::Motor { channel: of, position, .. } if of == channel => Some(position),
                _ => None,
            });
            if let Some(position) = position {
                break position;
            }
        };
        let value = (f64::from(counts) + f64::from(step.steps)) * resolution;
        drive(session, channel, Mode::Position, Quantity::new(value, Unit::Rad), until).await
    };
    report(args, session::run(args, Pace::Free, drive)?.0)
}

async fn drive(
    session: &Session<'_>,
    channel: ChannelId,
    mode: Mode,
    set: Quantity,
    until: Until,
) -> anyhow::Result<Driven> {
    let setpoint = setpoint(session, channel, mode, set)?;
    if let verb @ ("servo" | "bldc") = channel.kind.name() {
        let why = format!("does not report how it moves: command it with `r4 {verb}`");
        return Err(Unsuitable { channel, why }.into());
    }
    let info = session.board.channel(channel)?.clone();
    let end = session.armed(async || anyhow::Ok(session.board.drive(channel, setpoint, until).await)).await?;
    Ok(Driven { info, mode, set, end })
}

/// Prints what came of it; false when it did not hold.
fn report(args: &Args, driven: Driven) -> anyhow::Result<bool> {
    let Driven { info, mode, set, end } = driven;
    let (channel, position_unit, board) = (info.id, info.unit, args.board.described());
    let end = match end {
        Err(Error::NotSettled { position, after_s, .. }) => {
            let position = set.like(position, position_unit);
            let how = format!("was not settled after {after_s:.1} s: at {position}, asked for {set}, on {board}");
            return Err(NotReached { channel, how }.into());
        }
        end => end?,
    };
    let held = match mode {
        Mode::Position => end.settled,
        Mode::Home => end.homed,
        Mode::Duty => (end.duty - set.value).abs() <= DUTY_WITHIN,
        _ => {
            let resolved = if position_unit == Unit::M { M_S_RESOLVED } else { RAD_S_RESOLVED };
            let within = SPEED_WITHIN * set.value.abs() + resolved;
            // However low a speed is asked for, a motor that stands does not hold it.
            let turns = set.value == 0.0 || end.speed * set.value > 0.0;
            turns && (end.speed - set.value).abs() <= within.min(set.value.abs().max(resolved))
        }
    };
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
    // A motor without a sensor has only its duty to tell, a stepper has none.
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
