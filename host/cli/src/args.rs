//! What can be typed.

use std::path::PathBuf;

use clap::{Parser, Subcommand};
use r4_protocol::ChannelId;

use crate::{quantity::Quantity, session::Target};

/// Drives R4 boards, real and simulated.
///
/// Exit code 0 only when what the command promises held; 1 when it did not; 2 when it was not understood; 130 after
/// Ctrl-C, which disarms first.
#[derive(Debug, Parser)]
#[command(name = "r4", version, max_term_width = 100)]
pub(crate) struct Args {
    /// The board: `sim:` and a robot's name or file, as in sim:osmc-bench or sim:my-robot.toml
    #[arg(long, global = true, env = "R4_BOARD", default_value = "sim:osmc-bench")]
    pub(crate) board: Target,
    /// Print the result as one JSON object on stdout (`watch`: one per line); messages stay on stderr
    #[arg(long, global = true)]
    pub(crate) json: bool,
    /// Seed of a simulated board's noise
    #[arg(long, global = true, default_value_t = 1)]
    pub(crate) seed: u64,
    /// Simulated seconds per real one, for commands a person watches; `max` is as fast as the machine can
    #[arg(long, global = true, value_parser = parse_pace, value_name = "FACTOR|max", allow_negative_numbers = true)]
    pub(crate) pace: Option<r4_sim::Pace>,
    #[command(subcommand)]
    pub(crate) command: Command,
}

#[derive(Debug, Subcommand)]
pub(crate) enum Command {
    /// Drive the set points of the OSMC evaluation and compare with the paper's results
    Demo(Demo),
    /// What the board is and what its channels can take
    Info,
    /// Arm and stay connected until Ctrl-C, or for a time
    Arm {
        /// Disarm after this long
        #[arg(long = "for", value_parser = seconds, value_name = "SECONDS", allow_negative_numbers = true)]
        seconds: Option<f64>,
    },
    /// Make outputs safe
    Disarm,
    /// Leave a trip behind, once its causes are gone
    Clear,
    /// Arm, send a motor to a position, wait until it rests there, disarm
    Move(Motion),
    /// Arm, turn a motor at a speed for a time, disarm
    Speed(Motion),
    /// Arm, give a motor a share of the supply for a time, disarm
    Duty(Motion),
    /// Arm, close or open a relay for a time, disarm (which opens it)
    Relay(Relay),
    /// Print channels at a steady rate, until Ctrl-C or for a time
    Watch(Watch),
    /// Measure on simulated boards what the firmware promises
    Bench {
        #[command(subcommand)]
        what: Bench,
    },
}

/// Each on sim:every-interface, unless `--board` names another robot with every kind of output.
#[derive(Debug, Subcommand)]
pub(crate) enum Bench {
    /// Bus occupancy and late control periods under growing load
    Bus {
        /// How long each load lasts
        #[arg(long, default_value = "5", value_parser = seconds, value_name = "SECONDS", allow_negative_numbers = true)]
        seconds: f64,
    },
    /// Longest time until outputs are safe, for every cause of a stop
    Safety {
        /// How often causes are injected, in all
        #[arg(long, default_value_t = 10_000, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
        injections: u32,
    },
}

#[derive(Debug, clap::Args)]
pub(crate) struct Demo {
    /// Folder for log.mcap and report.html
    #[arg(long, default_value = "r4-demo", value_name = "DIR")]
    pub(crate) out: PathBuf,
}

#[derive(Debug, clap::Args)]
pub(crate) struct Motion {
    /// The channel, as in osmc0 or actuator1
    pub(crate) channel: ChannelId,
    /// A number with its unit: 90deg 1.57rad 0.25turn 25mm 0.025m | 60rpm 2rad/s 10mm/s | 0.3 or 30%
    #[arg(allow_hyphen_values = true)]
    pub(crate) value: Quantity,
    /// How long: to hold a speed or duty [default: 2], to wait for a position [default: 30]
    #[arg(long = "for", value_parser = seconds, value_name = "SECONDS", allow_negative_numbers = true)]
    pub(crate) seconds: Option<f64>,
}

#[derive(Debug, clap::Args)]
pub(crate) struct Relay {
    /// The relay, as in relay1
    pub(crate) channel: ChannelId,
    /// Closed or open
    pub(crate) state: Contact,
    /// How long to stay armed [default: 2]
    #[arg(long = "for", value_parser = seconds, value_name = "SECONDS", allow_negative_numbers = true)]
    pub(crate) seconds: Option<f64>,
}

/// A relay's contact.
#[derive(Clone, Copy, Debug, PartialEq, clap::ValueEnum)]
pub(crate) enum Contact {
    /// Closed.
    On,
    /// Open.
    Off,
}

#[derive(Debug, clap::Args)]
pub(crate) struct Watch {
    /// Channels [default: all]
    pub(crate) channels: Vec<ChannelId>,
    /// Lines per second
    #[arg(long, default_value_t = 5.0, value_parser = rate)]
    pub(crate) rate: f64,
    /// Stop after this long
    #[arg(long = "for", value_parser = seconds, value_name = "SECONDS", allow_negative_numbers = true)]
    pub(crate) seconds: Option<f64>,
}

fn seconds(text: &str) -> Result<f64, String> {
    match text.trim_end_matches('s').parse::<f64>() {
        Ok(value) if value > 0.0 && value <= 1e6 => Ok(value),
        _ => Err("a number of seconds above 0 and at most 1000000".into()),
    }
}

fn rate(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if (0.1..=500.0).contains(&value) => Ok(value),
        _ => Err("0.1 to 500 per second".into()),
    }
}

fn parse_pace(text: &str) -> Result<r4_sim::Pace, String> {
    if text == "max" {
        return Ok(r4_sim::Pace::Free);
    }
    match text.parse::<f64>() {
        Ok(factor) if (0.01..=1e6).contains(&factor) => Ok(r4_sim::Pace::RealTime(factor)),
        _ => Err("0.01 to 1000000 (1 is real time), or max".into()),
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    use super::*;

    #[test]
    fn definitions_are_consistent() {
        Args::command().debug_assert();
    }
}
