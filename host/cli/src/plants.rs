//! `--plant`, `--body` and `--blind`: other physics for the motors and the body of a virtual board than its files say.

use std::{
    fs,
    path::{Path, PathBuf},
    str::FromStr,
    sync::atomic::{AtomicBool, Ordering},
};

use anyhow::{Context, bail, ensure};
use r4_blind::{Hidden, Truth};
use r4_boards::{Robot, SimulatedBody};
use r4_plants::PlantSpec;
use r4_protocol::ChannelId;
use r4_sim::VirtualBoard;

use crate::{
    args::{Args, Command},
    session::Target,
};

/// A plant file, for a channel of a board, or for `identify` without one.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct OtherPlant {
    channel: Option<ChannelId>,
    file: PathBuf,
}

/// What a board needs.
const EXAMPLE: &str = "a channel, = and a plant file, as in osmc0=plant.toml";

impl OtherPlant {
    pub(crate) fn new(channel: ChannelId, file: PathBuf) -> Self {
        Self { channel: Some(channel), file }
    }

    /// Whose.
    pub(crate) fn channel(&self) -> Option<ChannelId> {
        self.channel
    }
}

impl FromStr for OtherPlant {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let Some((channel, file)) = text.split_once('=') else {
            return if text.is_empty() { Err(EXAMPLE.into()) } else { Ok(Self { channel: None, file: text.into() }) };
        };
        if file.is_empty() {
            return Err(EXAMPLE.into());
        }
        let channel = channel.parse().map_err(|error| format!("{error}; write {EXAMPLE}"))?;
        Ok(Self { channel: Some(channel), file: file.into() })
    }
}

/// Set once a board has the physics that were asked for.
static DONE: AtomicBool = AtomicBool::new(false);

fn are_asked(args: &Args) -> bool {
    args.blind.is_some() || args.body.is_some() || !args.plant.is_empty()
}

/// Refuses other physics where they cannot be had.
pub(crate) fn check(args: &Args) -> anyhow::Result<()> {
    let is_served = matches!(args.command, Command::Sim { .. } | Command::Identify(_));
    if let (true, false, Target::Link(_)) = (are_asked(args), is_served, &args.board) {
        args.board.robot().context("--plant, --body and --blind change the physics of a simulated board")?;
    }
    Ok(())
}

/// Whether a board had the physics that were asked for, if any were.
pub(crate) fn are_as_asked(args: &Args) -> bool {
    !are_asked(args) || DONE.load(Ordering::Relaxed)
}

/// The plant that `identify` begins with, if one is named.
pub(crate) fn known(args: &Args) -> anyhow::Result<Option<PlantSpec>> {
    let plant = match &args.plant[..] {
        [] => return Ok(None),
        [OtherPlant { channel: None, file }] => read(file)?.1,
        _ => bail!("identify takes one plant file without a channel, as in --plant plant.toml"),
    };
    DONE.store(true, Ordering::Relaxed);
    Ok(Some(plant))
}

/// The robot whose body `identify` begins with, and that body: that of `--body`, or else of the robot that `--board` names.
pub(crate) fn known_body(args: &Args) -> anyhow::Result<Option<SimulatedBody>> {
    let robot = match (&args.body, args.is_board_named) {
        (None, false) => return Ok(None),
        (None, true) if matches!(args.board, Target::Link(_)) => return Ok(None),
        _ => r4_boards::load(args.board.robot().context("--body holds for a simulated robot")?)?,
    };
    let Some(file) = &args.body else { return Ok(robot.simulation.body) };
    let body = r4_boards::load_body(file, &robot)?;
    DONE.store(true, Ordering::Relaxed);
    Ok(Some(body))
}

/// A plant file's name and content.
pub(crate) fn read(file: &Path) -> anyhow::Result<(String, PlantSpec)> {
    let name = file.display().to_string();
    let text = fs::read_to_string(file).with_context(|| format!("cannot read the plant {name}"))?;
    let spec = PlantSpec::from_toml(&name, &text)?;
    Ok((name, spec))
}

/// Does what `--plant` and `--body` say, and what `--blind` says to a body.
pub(crate) fn replace(args: &Args, robot: &mut Robot) -> anyhow::Result<()> {
    if let Some(file) = &args.body {
        let body = r4_boards::load_body(file, robot)?;
        robot.simulation.set_body(body);
        DONE.store(true, Ordering::Relaxed);
    }
    for (index, OtherPlant { channel, file }) in args.plant.iter().enumerate() {
        let again = args.plant[..index].iter().any(|before| before.channel == *channel);
        let Some(channel) = *channel else { bail!("--plant {} names no channel: write {EXAMPLE}", file.display()) };
        ensure!(!again, "--plant gives {channel} two plants: give it one");
        let (name, spec) = read(file)?;
        r4_sim::replace_plant(robot, channel, &name, &spec)?;
        DONE.store(true, Ordering::Relaxed);
    }
    if let Some(seed) = args.blind.filter(|seed| robot.simulation.body.is_some() && r4_blind::is_in_body(*seed))
        && let InRobot::Body(body, _) = hidden(robot, seed)?
    {
        robot.simulation.set_body(*body);
    }
    Ok(())
}

/// What `--blind` hides in a robot: something in its body, or in each of its motors.
pub(crate) enum InRobot {
    /// The body with it, and what it is; `None` where nothing could be hidden.
    Body(Box<SimulatedBody>, Option<Truth>),
    Motors(Vec<(ChannelId, Hidden)>),
}

/// What `--blind` hides in a robot, whose body is that of its file or of `--body`. In which part, is up to the seed.
pub(crate) fn hidden(robot: &Robot, seed: u64) -> anyhow::Result<InRobot> {
    if let Some(body) = robot.simulation.body.as_ref().filter(|_| r4_blind::is_in_body(seed)) {
        let (wheeled, truth) = r4_blind::hide_in_body(&body.wheeled, seed);
        return Ok(InRobot::Body(Box::new(SimulatedBody { wheeled, channels: body.channels.clone() }), truth));
    }
    let motors = r4_sim::plants(robot)?.into_iter().zip(0u64..);
    // Seeds of a board's motors are far apart: the next seed hides something else in all of them.
    let hide =
        |motor: r4_sim::MotorPlant, index: u64| r4_blind::hide(&motor.spec, motor.supply_v, seed ^ (index << 48));
    Ok(InRobot::Motors(motors.map(|(motor, index)| (motor.channel, hide(motor, index))).collect()))
}

/// Does what `--blind` says to motors; a body had it before it was built. Nothing but the physics knows of it.
pub(crate) fn hide(args: &Args, robot: &Robot, board: &dyn VirtualBoard) -> anyhow::Result<()> {
    let Some(seed) = args.blind else { return Ok(()) };
    DONE.store(true, Ordering::Relaxed);
    // On a stand the robot has no body any more.
    let has_body = args.body.is_some() || r4_boards::load(args.board.robot()?)?.simulation.body.is_some();
    if has_body && r4_blind::is_in_body(seed) {
        return Ok(());
    }
    if let InRobot::Motors(motors) = hidden(robot, seed)? {
        for ((channel, hidden), index) in motors.into_iter().zip(0u64..) {
            board.world().set_plant(channel, hidden.plant(args.seed.wrapping_add(index)));
        }
    }
    Ok(())
}
