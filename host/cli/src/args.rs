//! Options of all commands, and the arguments of short commands.

use std::{net::SocketAddr, path::PathBuf};

use anyhow::bail;
use clap::{ArgGroup, Subcommand};
use r4_links::LinkKind;
use r4_protocol::{ChannelId, message::MAX_RAW};
use r4_rig::{BadTarget, PlantFile, Quantity, Target};

use crate::plants::{EXAMPLE, OtherPlant};

/// Options of every command: the board, its physics and world, and the form of the output.
#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Args {
    /// Board of the command
    #[arg(long, global = true, env = "R4_BOARD", default_value = "sim:osmc-bench", help = board_help())]
    pub(crate) board: Target,
    /// True if `--board` or `R4_BOARD` named the board
    #[arg(skip)]
    pub(crate) is_board_named: bool,
    /// Print the result as one JSON object on stdout (`watch`: one per line); messages stay on stderr
    #[arg(long, global = true)]
    pub(crate) json: bool,
    /// Seed of a simulated board's noise
    #[arg(long, global = true, default_value_t = 1)]
    pub(crate) seed: u64,
    /// True if `--seed` was given
    #[arg(skip)]
    pub(crate) is_seed_given: bool,
    /// File with a simulated board's flash, which holds parameters and trips; made if there is none
    #[arg(long, global = true, env = "R4_FLASH", value_name = "FILE")]
    pub(crate) flash: Option<PathBuf>,
    /// Other physics for a motor of a simulated board, from a plant file, as in osmc0=plant.toml; may be given several times.
    /// For `identify`: a plant file alone, with what is known already
    #[arg(long, global = true, value_name = "CHANNEL=FILE")]
    pub(crate) plant: Vec<OtherPlant>,
    /// Another body for a simulated robot, from a body file. For `identify`: what is known of the robot's body already
    #[arg(long, global = true, value_name = "FILE")]
    pub(crate) body: Option<PathBuf>,
    /// Hide something in the physics of a simulated robot's body, or of each of its motors, or nothing; `sim reveal SEED` prints it
    #[arg(long, global = true, value_name = "SEED")]
    pub(crate) blind: Option<u64>,
    /// World in which the body of a simulated robot stands: a name, as in square, or a file
    #[arg(long, global = true, value_name = "WORLD")]
    pub(crate) world: Option<String>,
    /// File with the key of a board that is served with one at tcp:
    #[arg(id = "key_file", long = "key", global = true, env = "R4_KEY", value_name = "FILE")]
    pub(crate) key: Option<PathBuf>,
    /// File with a credential or a token for a board that is served with --policy, as `access key` and `access grant` make it
    #[arg(long, global = true, env = "R4_TOKEN", hide_env_values = true, value_name = "FILE")]
    pub(crate) token: Option<PathBuf>,
    /// Simulated seconds per real one, for commands a person watches; `max` is as fast as the machine can
    #[arg(long, global = true, value_parser = parse_pace, value_name = "FACTOR|max", allow_negative_numbers = true)]
    pub(crate) pace: Option<r4_sim::Pace>,
    /// Print the log of the firmware of an emulated or real board on stderr, from this level on [levels: trace, debug, info,
    /// warn, error; without one: trace]. The ELF file of its image decodes it: R4_ELF, or what was built last
    #[arg(
        long,
        global = true,
        env = "R4_LOG",
        value_enum,
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "trace",
        hide_possible_values = true,
        value_name = "LEVEL"
    )]
    pub(crate) log: Option<LogLevel>,
    /// Record what the command does to this log: telemetry, requests and states, as `log` reads them
    #[arg(long, global = true, value_name = "FILE")]
    pub(crate) record: Option<PathBuf>,
    /// Address at which a live view of what would be recorded is served, from [`Foxglove`]
    #[arg(skip)]
    pub(crate) live: Option<SocketAddr>,
}

/// Returns the help of `--board`, which lists the forms of addresses as `r4-links` parses them.
fn board_help() -> String {
    let of_links = LinkKind::all_forms();
    format!(
        "The board: sim: and a robot's name or file, as in sim:osmc-bench or sim:my-robot.toml; emu: for the same with the firmware's \
         image on an emulated processor; or its address: {of_links}. Parts in brackets are optional; without a node it is board 0 of \
         the bus"
    )
}

/// Option of the verbs that have a live view.
#[derive(Clone, Copy, Debug, clap::Args)]
pub(crate) struct Foxglove {
    /// Show it live in Foxglove or Lichtblick, which connect to this address of this machine [default: 127.0.0.1:8765]
    #[arg(
        long,
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "127.0.0.1:8765",
        hide_default_value = true,
        value_name = "ADDRESS"
    )]
    pub(crate) foxglove: Option<SocketAddr>,
}

impl Args {
    /// Returns true if the caller asks for other physics.
    pub(crate) fn asks_for_physics(&self) -> bool {
        self.blind.is_some() || self.body.is_some() || !self.plant.is_empty()
    }

    /// The plant files for the motors of a board.
    pub(crate) fn plants_of_channels(&self) -> anyhow::Result<Vec<PlantFile>> {
        let of_channel = |OtherPlant { channel, file }: &OtherPlant| match channel {
            Some(channel) => Ok(PlantFile { channel: *channel, path: file.clone() }),
            None => bail!("--plant {} names no channel: write {EXAMPLE}", file.display()),
        };
        self.plant.iter().map(of_channel).collect()
    }
}

/// Level of a record of the firmware's log, in ascending order of importance.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, clap::ValueEnum)]
pub(crate) enum LogLevel {
    /// All records, including single steps
    Trace,
    /// Details for developers of the firmware
    Debug,
    /// Normal events
    Info,
    /// Unexpected conditions that the firmware handles
    Warn,
    /// Failures of an operation
    Error,
}

/// Default address of `serve`.
const SERVED_AT: &str = "127.0.0.1:4404";

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Share {
    /// The board, as --board names one; a simulated one runs in real time
    #[arg(value_name = "BOARD")]
    pub(crate) board: Option<Target>,
    /// At this address; port 0 is any that is free
    #[arg(long, default_value = SERVED_AT, value_name = "ADDRESS")]
    pub(crate) tcp: SocketAddr,
    /// Let other machines connect; needs --key, which is then what clients must have
    #[arg(long, requires = "key_file")]
    pub(crate) public: bool,
    /// Authorise every request of clients by this policy, as docs/access.md describes it; the log is FILE.log
    #[arg(long, value_name = "FILE", conflicts_with_all = ["http", "foxglove"])]
    pub(crate) policy: Option<PathBuf>,
    /// Serve a page for browsers too, at this address [default: 127.0.0.1:8404]; port 0 is any that is free
    #[arg(
        long,
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "127.0.0.1:8404",
        hide_default_value = true,
        value_name = "ADDRESS"
    )]
    pub(crate) http: Option<SocketAddr>,
    #[command(flatten)]
    pub(crate) live: Foxglove,
}

#[derive(Clone, Debug, clap::Args)]
#[command(group = ArgGroup::new("where").required(true).args(["pty", "tcp", "slcan", "can"]))]
#[command(group = ArgGroup::new("bus").args(["slcan", "can"]))]
pub(crate) struct Serve {
    /// A robot's name or file, on the emulated board with `emu:` before it
    #[arg(value_name = "ROBOT", value_parser = virtual_board)]
    pub(crate) robot: Target,
    /// On a pseudo-terminal, as a serial port; with a link to it at this path
    #[arg(long, num_args = 0..=1, require_equals = true, value_name = "LINK")]
    #[expect(clippy::option_option, reason = "not given, given without a path, given with one")]
    pub(crate) pty: Option<Option<PathBuf>>,
    /// At this address, for one client at a time; port 0 is any that is free
    #[arg(long, num_args = 0..=1, require_equals = true, default_missing_value = "127.0.0.1:0", value_name = "ADDRESS")]
    pub(crate) tcp: Option<SocketAddr>,
    /// Behind a CAN adapter that speaks slcan on a pseudo-terminal; with a link to it at this path
    #[arg(long, num_args = 0..=1, require_equals = true, value_name = "LINK")]
    #[expect(clippy::option_option, reason = "not given, given without a path, given with one")]
    pub(crate) slcan: Option<Option<PathBuf>>,
    /// On a CAN interface of Linux, as in vcan0
    #[arg(long, value_name = "INTERFACE")]
    pub(crate) can: Option<String>,
    /// The board's number on the CAN bus
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..128), requires = "bus")]
    pub(crate) node: u8,
    /// Let other machines connect to --tcp; needs --key
    #[arg(long, requires_all = ["tcp", "key_file"])]
    pub(crate) public: bool,
}

fn virtual_board(text: &str) -> Result<Target, String> {
    match text.split_once(':') {
        Some(("sim" | "emu", _)) => text.parse().map_err(|error: BadTarget| error.to_string()),
        _ => Ok(Target::Sim(text.to_owned())),
    }
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Scenario {
    /// Play each on a simulated and on an emulated board, and list what differs
    #[arg(long)]
    pub(crate) compare: bool,
    /// Scenarios, as docs/scenarios.md describes them
    #[arg(required = true, value_name = "FILE")]
    pub(crate) files: Vec<PathBuf>,
}

#[derive(Clone, Debug, clap::Args)]
#[command(group = ArgGroup::new("how").required(true).multiple(true).args(["gdb", "trace", "until"]))]
pub(crate) struct Debug {
    /// Halt at the reset and serve gdb at this address, as in 127.0.0.1:3333
    #[arg(long, value_name = "ADDRESS")]
    pub(crate) gdb: Option<SocketAddr>,
    /// Serve gdb at an address that other machines reach: gdb has no password, and may read and change all of the emulated board
    #[arg(long, requires = "gdb")]
    pub(crate) public: bool,
    /// Run freely for this virtual time, s, then halt for gdb
    #[arg(long, value_parser = seconds, value_name = "SECONDS", requires = "gdb")]
    pub(crate) attach_at: Option<f64>,
    /// The same in virtual nanoseconds, as failure messages state it; serves gdb at 127.0.0.1:3333 unless --gdb names another address
    #[arg(long, value_name = "NS", conflicts_with = "attach_at")]
    pub(crate) until: Option<u64>,
    /// Write exceptions, misuses and I2C transfers to a file, one a line; `-` is stdout
    #[arg(long, value_name = "FILE")]
    pub(crate) trace: Option<PathBuf>,
    /// Trace only the calls of this function, with their arguments; may be given several times
    #[arg(long, value_name = "NAME", requires = "trace")]
    pub(crate) symbol: Vec<String>,
    /// Play this scenario during the run; without it no host is connected
    #[arg(long, value_name = "FILE")]
    pub(crate) scenario: Option<PathBuf>,
    /// End after this virtual time, s [default: when gdb leaves, or 1 without gdb]
    #[arg(long = "for", value_parser = seconds, value_name = "SECONDS", conflicts_with = "scenario")]
    pub(crate) seconds: Option<f64>,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Safety {
    /// Number of injected faults [default: on sim: 10000 in all, on emu: 4 for each cause]
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    pub(crate) injections: Option<u32>,
    /// Print the tables as Markdown, as docs/safety.md has them
    #[arg(long)]
    pub(crate) markdown: bool,
}

/// `bus` and `safety` on sim:every-interface, unless `--board` names another robot with every kind of output.
#[derive(Clone, Debug, Subcommand)]
pub(crate) enum Bench {
    /// Bus occupancy and late control periods under growing load
    Bus {
        /// Duration of each load
        #[arg(long, default_value = "5", value_parser = seconds, value_name = "SECONDS", allow_negative_numbers = true)]
        seconds: f64,
    },
    /// Longest time until outputs are safe, for every cause of a stop, and how plants come to rest after it. On emu:
    /// what happens to the processor itself
    Safety(Safety),
    /// Stack, instructions and jitter of the firmware's ELF on an emulated board, emu:osmc-bench unless `--board` says
    Firmware {
        /// Duration of random requests, and then of full load on the links
        #[arg(long, default_value = "10", value_parser = seconds, value_name = "SECONDS", allow_negative_numbers = true)]
        seconds: f64,
    },
    /// Bytes, round trips, rate and clock error of a link to a board; a simulated board, sim:openscout unless `--board` says,
    /// is served on a pseudo-terminal for it
    Link(BenchLink),
    /// Speed and memory of simulated boards, and of emulated ones where there are images for them
    Sim,
    /// Path-following error, synchronisation and tuning of motors on simulated boards
    Motion(BenchMotion),
    /// Results of `r4 identify` on recordings of real machines and on simulated plants with a hidden effect
    Identify(BenchIdentify),
    /// Every robot system's study: metrics with intervals and targets
    Systems(BenchSystems),
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct BenchMotion {
    /// Sampled motors that are tuned, in each mode
    #[arg(long, default_value_t = 200, value_parser = clap::value_parser!(u64).range(1..=100_000))]
    pub(crate) motors: u64,
    /// Seed of the first sampled motor
    #[arg(long, default_value_t = 4001, value_name = "SEED")]
    pub(crate) from: u64,
    /// Do not count the instructions of control ticks on emulated boards
    #[arg(long)]
    pub(crate) no_ticks: bool,
    /// Say of each motor how it came out, on stderr
    #[arg(long)]
    pub(crate) each: bool,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct BenchIdentify {
    /// Folder of the recordings
    #[arg(long, default_value = "data", value_name = "DIR")]
    pub(crate) data: PathBuf,
    /// Simulated plants with one effect of the catalogue; a third as many with two, two thirds with nothing hidden, half with what is in
    /// no catalogue, a third with broken recordings, a sixth as many boards
    #[arg(long, default_value_t = 300, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub(crate) seeds: u32,
    /// The first simulated plant's number: a seed of 1 and `--from 7 --seeds 1` is one plant alone. Without --seed the plants are the
    /// report's, which nothing is tuned on; seeds below 1000000 are for tuning
    #[arg(long, default_value_t = 0, value_name = "NUMBER")]
    pub(crate) from: u32,
    /// Print hidden and found effects of each simulated plant on stderr
    #[arg(long)]
    pub(crate) each: bool,
    /// Run only this group of rows
    #[arg(long, num_args = 1.., value_name = "ROW")]
    pub(crate) only: Vec<IdentifyRows>,
}

/// Group of rows of `bench identify`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub(crate) enum IdentifyRows {
    /// Recordings of a linear axis (EMPS)
    Emps,
    /// Recordings of a skid-steer robot (Husky)
    Husky,
    /// Recordings of a servo with a pendulum (XL330)
    Pendulum,
    /// Gear motors on an H-bridge, recorded
    Micromouse,
    /// Play of bus servos, recorded
    Backlash,
    /// Printed tables of a motor driver's evaluation
    Osmc,
    /// Time that it takes
    Speed,
    /// Simulated plants with one effect of the catalogue
    Blind,
    /// Simulated plants with two effects of the catalogue
    Pairs,
    /// Simulated plants with nothing hidden, every second one with stamps that are off
    Clean,
    /// Simulated plants with an effect that is in no catalogue
    Unlisted,
    /// Simulated plants whose recordings are broken
    Broken,
    /// `identify close` on simulated boards that hide something
    Close,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct BenchSystems {
    /// Run only this system, from `system list`
    #[arg(long, value_name = "NAME")]
    pub(crate) only: Option<String>,
    /// Run few seeds, as a check that everything runs; targets are not meaningful
    #[arg(long)]
    pub(crate) quick: bool,
    /// Number of seeds [default: all on which the system's results are reported, 100 for most; quick 8]
    #[arg(long, value_parser = clap::value_parser!(u64).range(2..=1_000_000))]
    pub(crate) seeds: Option<u64>,
    /// Keep each system's rows in this folder, and do not run a system again whose rows this very program left there with the
    /// same board and seeds. Interrupted runs continue at the next trial, and runs with --only add up
    #[arg(long, value_name = "FOLDER")]
    pub(crate) out: Option<PathBuf>,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct BenchLink {
    /// Duration of the round-trip test, and then of the throughput test
    #[arg(long, default_value = "5", value_parser = seconds, value_name = "SECONDS", allow_negative_numbers = true)]
    pub(crate) seconds: f64,
    /// Cycles in flight during the throughput test
    #[arg(long, default_value_t = 32, value_parser = window, value_name = "CYCLES")]
    pub(crate) window: usize,
    /// Arm a board at the end of a link, with motors at rest; otherwise it refuses set points, and answers all the same. A
    /// virtual board is armed in any case
    #[arg(long)]
    pub(crate) arm: bool,
}

fn window(text: &str) -> Result<usize, String> {
    let window = text.parse().ok().filter(|window| (1..=128).contains(window));
    window.ok_or_else(|| format!("`{text}` is no number of cycles from 1 to 128"))
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Demo {
    /// Another robot: openscout drives round a room in which people step in its way
    #[arg(long)]
    pub(crate) robot: Option<String>,
    /// Folder for log.mcap and report.html
    #[arg(long, default_value = "r4-demo", value_name = "DIR")]
    pub(crate) out: PathBuf,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Motion {
    /// The channel, as in osmc0 or actuator1
    pub(crate) channel: ChannelId,
    /// A number with its unit: 90deg 1.57rad 0.25turn 25mm 0.025m | 60rpm 2rad/s 10mm/s | 0.3 or 30%
    #[arg(allow_hyphen_values = true)]
    pub(crate) value: Quantity,
    /// Duration of a speed or duty [default: 2], or time limit for a position [default: 30]
    #[arg(long = "for", value_parser = seconds, value_name = "SECONDS", allow_negative_numbers = true)]
    pub(crate) seconds: Option<f64>,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Step {
    /// The stepper, as in stepper0
    pub(crate) channel: ChannelId,
    /// Number of steps from the present position; negative is backwards
    #[arg(allow_negative_numbers = true)]
    pub(crate) steps: i32,
    /// Time limit [default: 30]
    #[arg(long = "for", value_parser = seconds, value_name = "SECONDS", allow_negative_numbers = true)]
    pub(crate) seconds: Option<f64>,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Home {
    /// The channel, as in osmc0 or stepper0
    pub(crate) channel: ChannelId,
    /// Speed of the search, as in 1rad/s or -30deg/s; the sign is the direction
    #[arg(long, allow_hyphen_values = true)]
    pub(crate) speed: Quantity,
    /// Time limit [default: 30]
    #[arg(long = "for", value_parser = seconds, value_name = "SECONDS", allow_negative_numbers = true)]
    pub(crate) seconds: Option<f64>,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Held {
    /// The channel, as in servo3 or dac0
    pub(crate) channel: ChannelId,
    /// A number with its unit: 30deg 0.5rad | 1.2V 1200mV
    #[arg(allow_hyphen_values = true)]
    pub(crate) value: Quantity,
    /// Time to stay armed [default: 2]
    #[arg(long = "for", value_parser = seconds, value_name = "SECONDS", allow_negative_numbers = true)]
    pub(crate) seconds: Option<f64>,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Bldc {
    /// The drive, as in bldc0
    pub(crate) channel: ChannelId,
    /// Share of full speed, as in 0.4 or 40%; negative is backwards
    #[arg(allow_hyphen_values = true, required_unless_present = "brake")]
    pub(crate) value: Option<Quantity>,
    /// Apply the brake instead
    #[arg(long, conflicts_with = "value")]
    pub(crate) brake: bool,
    /// Time to stay armed [default: 2]
    #[arg(long = "for", value_parser = seconds, value_name = "SECONDS", allow_negative_numbers = true)]
    pub(crate) seconds: Option<f64>,
}

#[derive(Clone, Debug, clap::Args)]
#[command(group = ArgGroup::new("what").required(true).multiple(true).args(["write", "read"]))]
pub(crate) struct I2c {
    /// The connector, 0 or 1
    pub(crate) bus: u8,
    /// 7-bit address, as in 0x50
    #[arg(value_parser = i2c_address)]
    pub(crate) address: u8,
    /// Bytes to write, in hex, as in 00ff or "00 ff"
    #[arg(long, value_name = "HEX", value_parser = hex)]
    pub(crate) write: Option<Bytes>,
    /// Number of bytes to read after writing
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(1..=MAX_RAW as i64))]
    pub(crate) read: Option<u8>,
}

#[derive(Clone, Debug, clap::Args)]
#[command(group = ArgGroup::new("what").required(true).multiple(true).args(["write", "read"]))]
pub(crate) struct Uart {
    /// The connector, 0 or 1
    pub(crate) port: u8,
    /// Text to send; \r \n \t \\ and \xHH stand for bytes
    #[arg(long, value_name = "TEXT", value_parser = escaped)]
    pub(crate) write: Option<Bytes>,
    /// Print what is received
    #[arg(long)]
    pub(crate) read: bool,
    /// Duration of receiving [default: 0.5]
    #[arg(long = "for", value_parser = seconds, value_name = "SECONDS", requires = "read")]
    pub(crate) seconds: Option<f64>,
}

/// Data to write to a connector.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Bytes(pub(crate) Vec<u8>);

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Relay {
    /// The relay, as in relay1
    pub(crate) channel: ChannelId,
    /// Position of the relay's contact
    pub(crate) state: Contact,
    /// Time to stay armed [default: 2]
    #[arg(long = "for", value_parser = seconds, value_name = "SECONDS", allow_negative_numbers = true)]
    pub(crate) seconds: Option<f64>,
}

/// State of a relay's contact.
#[derive(Clone, Copy, Debug, PartialEq, clap::ValueEnum)]
pub(crate) enum Contact {
    /// Contact closed, load on
    On,
    /// Contact open, load off
    Off,
}

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Watch {
    /// Channels to print [default: all]
    pub(crate) channels: Vec<ChannelId>,
    /// Output lines per second
    #[arg(long, default_value_t = 5.0, value_parser = rate)]
    pub(crate) rate: f64,
    /// Stop after this long
    #[arg(long = "for", value_parser = seconds, value_name = "SECONDS", allow_negative_numbers = true)]
    pub(crate) seconds: Option<f64>,
    #[command(flatten)]
    pub(crate) live: Foxglove,
}

pub(crate) fn seconds(text: &str) -> Result<f64, String> {
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

fn i2c_address(text: &str) -> Result<u8, String> {
    let address = match text.strip_prefix("0x") {
        Some(hex) => u8::from_str_radix(hex, 16),
        None => text.parse(),
    };
    // The others are reserved (I2C-bus specification, UM10204, 3.1.12).
    address.ok().filter(|address| (0x08..=0x77).contains(address)).ok_or("an address from 0x08 to 0x77".into())
}

fn hex(text: &str) -> Result<Bytes, String> {
    let digits: String = text.split_whitespace().collect();
    let digits = digits.strip_prefix("0x").unwrap_or(&digits);
    let bytes = (0..digits.len()).step_by(2).map(|at| {
        let pair = digits.get(at..at + 2).filter(|pair| pair.bytes().all(|digit| digit.is_ascii_hexdigit()))?;
        u8::from_str_radix(pair, 16).ok()
    });
    match bytes.collect::<Option<Vec<u8>>>() {
        Some(bytes) if (1..=MAX_RAW).contains(&bytes.len()) => Ok(Bytes(bytes)),
        _ => Err(format!("1 to {MAX_RAW} bytes of two hex digits each, as in 00ff")),
    }
}

fn escaped(text: &str) -> Result<Bytes, String> {
    let mut bytes = Vec::new();
    let mut rest = text.bytes();
    while let Some(byte) = rest.next() {
        let meant = match (byte, byte == b'\\') {
            (_, false) => Some(byte),
            (_, true) => match rest.next() {
                Some(b'r') => Some(b'\r'),
                Some(b'n') => Some(b'\n'),
                Some(b't') => Some(b'\t'),
                Some(b'\\') => Some(b'\\'),
                Some(b'x') => {
                    let mut digit = || char::from(rest.next()?).to_digit(16);
                    let (high, low) = (digit(), digit());
                    high.zip(low).map(|(high, low)| (16 * high + low) as u8)
                }
                _ => None,
            },
        };
        bytes.push(meant.ok_or(r"after a \ comes r, n, t, \ or x and two hex digits")?);
    }
    if bytes.is_empty() { Err("nothing to send".into()) } else { Ok(Bytes(bytes)) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_are_typed_in_hex_or_as_text() {
        for (typed, bytes) in [("00ff", &[0, 255][..]), ("0x1A", &[26]), ("00 01 0a", &[0, 1, 10])] {
            assert_eq!(hex(typed), Ok(Bytes(bytes.to_vec())), "{typed}");
        }
        let long = "00".repeat(MAX_RAW + 1);
        for bad in ["", "0", "0g", "+1", "00f", "é0", &long] {
            assert!(hex(bad).is_err(), "{bad}");
        }
        assert_eq!(escaped(r"a\r\n\x00\xfF\\é"), Ok(Bytes(b"a\r\n\x00\xFF\\\xC3\xA9".to_vec())));
        for bad in ["", r"\", r"\q", r"\x1", r"\xg0"] {
            assert!(escaped(bad).is_err(), "{bad}");
        }
    }
}
