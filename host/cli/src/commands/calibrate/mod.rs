//! `r4 calibrate`: what a board has to be told about the robot it is in, measured.
//!
//! Each kind measures with the parameters that hold now, takes what a person has measured on the robot, and computes from both
//! what the parameters should be. The board works with them from its next start on.

mod ask;
mod motor;
mod servo;
#[cfg(test)]
mod tests;
mod wheel;

use anyhow::{Context, ensure};
use r4_driver::{Board, Clock};
use r4_protocol::{ChannelId, Parameter, ParameterInfo, ParameterKey, Sample, Unit};
use r4_sim::Pace;
use serde::Serialize;

use super::config;
use crate::{
    args::Args,
    output,
    session::{self, Session},
    table,
};
use ask::Answers;
use r4_rig::quantity::Quantity;

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Calibrate {
    #[command(subcommand)]
    what: What,
    /// Set what was found and keep it; holds from the next start on
    #[arg(long, global = true)]
    save: bool,
    /// Answers to the questions in their order, instead of standard input, as in 10.2mm,89.7mm
    #[arg(long, global = true, value_delimiter = ',', value_name = "ANSWERS")]
    answers: Vec<String>,
}

#[derive(Clone, Debug, clap::Subcommand)]
enum What {
    /// Counts per turn of a motor's encoder or of an encoder channel
    Encoder {
        /// As in osmc0 or encoder1
        channel: ChannelId,
        /// Whole turns to make by hand between two looks at the same mark
        #[arg(long, default_value_t = 1.0)]
        turns: f64,
        /// Drive so far by what the board believes, and ask how far it really went, as in 720deg
        #[arg(long, allow_hyphen_values = true, conflicts_with = "turns")]
        drive: Option<Quantity>,
    },
    /// Both calibration points of a motor's potentiometer
    Potentiometer {
        /// As in actuator1
        channel: ChannelId,
        /// Drive to both places instead of having it moved by hand: a tenth from either end of the range
        #[arg(long)]
        drive: bool,
    },
    /// Oscillator of the chip that makes the servos' pulses
    Servo {
        /// Any servo, as in servo0; it is held at its largest pulse while you measure
        channel: ChannelId,
    },
    /// Radius of wheels, and the track of a robot that steers by them; printed for the robot's file
    Wheel {
        /// Motors of the left wheels, as in dhb0,dhb2; or all there are, for the radius only
        left: Side,
        /// Motors of the right wheels, as in dhb1,dhb3
        right: Option<Side>,
        /// How far every wheel turns
        #[arg(long, default_value = "2turns")]
        turn: Quantity,
    },
}

/// The motors of one side.
#[derive(Clone, Debug, PartialEq)]
struct Side(Vec<ChannelId>);

impl std::str::FromStr for Side {
    type Err = <ChannelId as std::str::FromStr>::Err;

    fn from_str(text: &str) -> Result<Self, Self::Err> {
        text.split(',').map(str::parse).collect::<Result<_, _>>().map(Self)
    }
}

/// A parameter that should be another.
#[derive(Clone, Debug, Serialize)]
struct Change {
    key: String,
    #[serde(skip)]
    parameter: ParameterKey,
    from: f32,
    to: f32,
}

impl Change {
    fn new(info: &ParameterInfo, to: f64) -> Self {
        Self { key: info.key.to_string(), parameter: info.key, from: info.active, to: to as f32 }
    }
}

/// What was found.
#[derive(Debug, Default)]
struct Found {
    changes: Vec<Change>,
    /// What is no parameter of the board, for the robot's file.
    toml: Option<String>,
    /// How sure it is.
    note: String,
}

#[derive(Serialize)]
struct Report {
    board: String,
    parameters: Vec<Change>,
    toml: Option<String>,
    note: String,
    saved: bool,
}

pub(crate) fn run(args: &Args, calibrate: &Calibrate) -> anyhow::Result<bool> {
    if calibrate.save {
        ensure!(!matches!(calibrate.what, What::Wheel { .. }), "a board keeps nothing of its wheels: leave --save out");
        config::check_keeps(args)?;
    }
    let mut answers = Answers::new(&calibrate.answers);
    let (found, _) = session::run(args, Pace::Free, async |session| work(session, calibrate, &mut answers).await)?;
    let saved = calibrate.save && !found.changes.is_empty();
    if args.json {
        let Found { changes, toml, note } = found;
        output::json(&Report { board: args.board.to_string(), parameters: changes, toml, note, saved })?;
        return Ok(true);
    }
    if !found.changes.is_empty() {
        let mut shown = table::new(&["parameter", "is", "should be"], 1..3);
        for Change { key, from, to, .. } in &found.changes {
            shown.add_row([key.clone(), from.to_string(), to.to_string()]);
        }
        output::line(shown)?;
    }
    output::line(format_args!("{}, on {}", found.note, args.board.described()))?;
    if let Some(toml) = &found.toml {
        output::line(toml.trim_end())?;
    } else {
        output::line(if saved { "saved: holds from the next start on" } else { "not saved: add --save" })?;
    }
    Ok(true)
}

/// Measures, and saves what was found if that is wanted.
async fn work(session: &Session<'_>, calibrate: &Calibrate, answers: &mut Answers) -> anyhow::Result<Found> {
    let found = match &calibrate.what {
        What::Encoder { channel, turns, drive } => motor::encoder(session, answers, *channel, *turns, *drive).await?,
        What::Potentiometer { channel, drive } => motor::potentiometer(session, answers, *channel, *drive).await?,
        What::Servo { channel } => servo::oscillator(session, answers, *channel).await?,
        What::Wheel { left, right, turn } => {
            let right = right.as_ref().map_or(&[][..], |side| &side.0);
            wheel::run(session, answers, &left.0, right, *turn).await?
        }
    };
    if calibrate.save {
        for Change { parameter, to, .. } in &found.changes {
            let refused = || format!("the board does not take {parameter} = {to}: was all measured right?");
            session.board.set_parameter(*parameter, *to).await.with_context(refused)?;
        }
        session.board.save_parameters().await.context("cannot save")?;
    }
    Ok(found)
}

/// A board's parameters.
struct Parameters(Vec<ParameterInfo>);

impl Parameters {
    async fn of<C: Clock>(board: &Board<C>) -> anyhow::Result<Self> {
        Ok(Self(board.parameters().await?))
    }

    fn get(&self, channel: Option<ChannelId>, parameter: Parameter) -> Option<&ParameterInfo> {
        self.0.iter().find(|info| info.key == ParameterKey { channel, parameter })
    }

    /// One that the channel must have.
    fn need(&self, channel: ChannelId, parameter: Parameter, else_say: &str) -> anyhow::Result<&ParameterInfo> {
        self.get(Some(channel), parameter).with_context(|| format!("{channel} {else_say}"))
    }
}

/// How often a channel is looked at, ms, and over how long, s.
const LOOK_EVERY_MS: u16 = 5;
const LOOK_S: f64 = 0.3;

/// Where a channel is, in counts of its resolution: the mean over a moment in which it must not move.
async fn counts<C: Clock>(board: &Board<C>, channel: ChannelId) -> anyhow::Result<f64> {
    board.channel(channel)?;
    let mut telemetry = board.telemetry();
    board.subscribe(channel, LOOK_EVERY_MS).await?;
    let (mut sum, mut count, mut begin_us) = (0.0, 0_u32, None);
    loop {
        let frame = telemetry.next().await?;
        let position = frame.samples.iter().find_map(|sample| match *sample {
            Sample::Motor { channel: of, position, .. } | Sample::Encoder { channel: of, position, .. }
                if of == channel =>
            {
                Some(position)
            }
            _ => None,
        });
        let Some(position) = position else { continue };
        sum += f64::from(position);
        count += 1;
        let begin_us = *begin_us.get_or_insert(frame.device_us);
        if frame.device_us.saturating_sub(begin_us) as f64 * 1e-6 >= LOOK_S {
            return Ok(sum / f64::from(count));
        }
    }
}

/// A typed quantity that must be in `unit`.
fn read(answer: &str, unit: Unit, example: &str) -> anyhow::Result<f64> {
    let quantity: Quantity =
        answer.parse().map_err(|why| anyhow::anyhow!("`{answer}` is not what was asked for: {why}"))?;
    ensure!(quantity.unit == unit, "`{answer}` is not what was asked for: write it as in {example}");
    Ok(quantity.value)
}
