//! `r4 calibrate`: measures parameters that depend on the robot around the board.

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
    /// Set the measured parameters and save them to the board's flash; effective after the next restart
    #[arg(long, global = true)]
    save: bool,
    /// Answers to the questions, in their order, instead of standard input; example: 10.2mm,89.7mm
    #[arg(long, global = true, value_delimiter = ',', value_name = "ANSWERS")]
    answers: Vec<String>,
}

#[derive(Clone, Debug, clap::Subcommand)]
enum What {
    /// Measure counts per turn of a motor's encoder or of an encoder channel
    Encoder {
        /// Motor or encoder channel; examples: osmc0, encoder1
        channel: ChannelId,
        /// Whole turns to make by hand between two sightings of the same mark
        #[arg(long, default_value_t = 1.0)]
        turns: f64,
        /// Drive this far by the board's present calibration, and ask for the true distance; example: 720deg
        #[arg(long, allow_hyphen_values = true, conflicts_with = "turns")]
        drive: Option<Quantity>,
    },
    /// Measure both calibration points of a motor's potentiometer
    Potentiometer {
        /// Motor with the potentiometer; example: actuator1
        channel: ChannelId,
        /// Drive to both points, a tenth of the range from either end [default: the motor is moved by hand]
        #[arg(long)]
        drive: bool,
    },
    /// Measure the oscillator of the PWM chip that makes the servos' pulses
    Servo {
        /// Servo that is held at its longest pulse while you measure it; example: servo0
        channel: ChannelId,
    },
    /// Measure the radius of the wheels and the track of a skid-steer robot; prints both for the robot's file
    Wheel {
        /// Motors of the left wheels, or of all wheels to measure only the radius; example: dhb0,dhb2
        left: Side,
        /// Motors of the right wheels; example: dhb1,dhb3
        right: Option<Side>,
        /// Angle by which every wheel turns
        #[arg(long, default_value = "2turns")]
        turn: Quantity,
    },
}

/// Motors on one side of the robot.
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

/// Parameter whose value should change.
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
        ensure!(!matches!(calibrate.what, What::Wheel { .. }), "a board stores no wheel parameters: omit --save");
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
        let mut shown = table::new(&["parameter", "present", "new"], 1..3);
        for Change { parameter, from, to } in &found.changes {
            shown.add_row([parameter.to_string(), from.to_string(), to.to_string()]);
        }
        output::line(shown)?;
    }
    output::line(format_args!("{}, on {}", found.note, args.board.described()))?;
    if let Some(toml) = &found.toml {
        output::line(toml.trim_end())?;
    } else {
        output::line(if saved { "saved: effective after the next restart" } else { "not saved: add --save" })?;
    }
    Ok(true)
}
