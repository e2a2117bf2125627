//! `r4 calibrate`: what a board has to be told about the robot it is in, measured.

mod ask;

use anyhow::ensure;
use r4_protocol::ChannelId;
use r4_rig::{
    Quantity,
    calibrate::{Calibration, Change, Found, Turning},
};
use r4_sim::Pace;
use serde::Serialize;

use super::config;
use crate::{args::Args, output, session, table};
use ask::Answers;

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

impl What {
    fn calibration(&self) -> Calibration {
        match *self {
            Self::Encoder { channel, drive: Some(distance), .. } => {
                Calibration::Encoder { channel, by: Turning::Driven(distance) }
            }
            Self::Encoder { channel, turns, drive: None } => {
                Calibration::Encoder { channel, by: Turning::ByHand { turns } }
            }
            Self::Potentiometer { channel, drive } => Calibration::Potentiometer { channel, drive },
            Self::Servo { channel } => Calibration::ServoOscillator { channel },
            Self::Wheel { ref left, ref right, turn } => {
                let right = right.as_ref().map_or(Vec::new(), |side| side.0.clone());
                Calibration::Wheels { left: left.0.clone(), right, turn }
            }
        }
    }
}

/// A parameter that should be another.
#[derive(Serialize)]
struct Row {
    key: String,
    from: f32,
    to: f32,
}

#[derive(Serialize)]
struct Report {
    board: String,
    parameters: Vec<Row>,
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
    let calibration = calibrate.what.calibration();
    let (found, _) = session::run(args, Pace::Free, async |session| {
        let found = r4_rig::calibrate::calibrate(session, &calibration, &mut answers).await?;
        if calibrate.save {
            found.save(session).await?;
        }
        Ok(found)
    })?;
    let saved = calibrate.save && !found.changes.is_empty();
    if args.json {
        let Found { changes, toml, note } = found;
        let row = |Change { parameter, from, to }| Row { key: parameter.to_string(), from, to };
        let parameters = changes.into_iter().map(row).collect();
        output::json(&Report { board: args.board.to_string(), parameters, toml, note, saved })?;
        return Ok(true);
    }
    if !found.changes.is_empty() {
        let mut shown = table::new(&["parameter", "is", "should be"], 1..3);
        for Change { parameter, from, to } in &found.changes {
            shown.add_row([parameter.to_string(), from.to_string(), to.to_string()]);
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
