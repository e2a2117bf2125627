//! `r4 bench`: measures the limits of firmware, simulator and `r4 identify`. Times are virtual, except for the speed of
//! programs and for links.

mod bus;
#[cfg(feature = "emu")]
pub(crate) mod firmware;
mod identify;
mod link;
mod motion;
pub(crate) mod safety;
mod sim;

use std::rc::Rc;

use anyhow::{anyhow, bail};
use futures::future::join_all;
use r4_boards::Robot;
use r4_driver::Board;
use r4_protocol::{ChannelId, ChannelKind, Mode, Range, Setpoint};
use r4_sim::{Pace, SimBoard, Simulation, VirtualBoard, stop::Outputs};

use crate::{
    args::{self, Args},
    emulated,
    session::{HostClock, Session, Target},
};
use r4_rig::{NotVirtual, Rig, cable::CableState};

/// Default robot of `--board`, which has too few outputs for these measurements.
const DEFAULT: &str = "osmc-bench";
/// Robot that is measured instead.
const EVERYTHING: &str = "every-interface";
const MS: u64 = 1_000_000;

pub(crate) fn run(args: &Args, what: &args::Bench) -> anyhow::Result<bool> {
    match what {
        args::Bench::Bus { seconds } => bus::run(args, *seconds),
        args::Bench::Safety(asked) => safety::run(args, asked),
        args::Bench::Firmware { seconds } => emulated::bench(args, *seconds),
        args::Bench::Link(link) => link::run(args, link),
        args::Bench::Sim => sim::run(args),
        args::Bench::Motion(asked) => motion::run(args, asked),
        args::Bench::Identify(what) => identify::run(args, what),
        args::Bench::Systems(what) => super::system::bench(args, what),
    }
}

/// Robot to measure, with its name; it has every kind of output.
fn robot(args: &Args) -> anyhow::Result<(Target, Robot)> {
    let Target::Sim(name) = &args.board else {
        bail!("this measures simulated boards only: omit --board, or write sim:{EVERYTHING}")
    };
    let name = if name == DEFAULT { EVERYTHING } else { name };
    Ok((Target::Sim(name.to_owned()), with_every_output(name, "sim")?))
}

/// Loads a robot that must have every kind of output; `kind` is that of its board, `sim` or `emu`.
fn with_every_output(name: &str, kind: &str) -> anyhow::Result<Robot> {
    let robot = r4_boards::load(name)?;
    match Outputs::ALL.into_iter().find(|outputs| !outputs.are_on(&robot.config)) {
        None => Ok(robot),
        Some(missing) => {
            bail!(
                "{name} has nothing for `{missing}`: choose a robot with every kind of output, as {kind}:{EVERYTHING}"
            )
        }
    }
}

/// Simulated board with a connected host.
struct Bench<'b> {
    host: &'b Board<HostClock>,
    board: &'b dyn VirtualBoard,
    clock: r4_sim::Clock,
    cable: &'b CableState,
}

/// Powers up a simulated board, connects a host and runs `work`.
fn on_board<T>(robot: &Robot, seed: u64, work: impl AsyncFnOnce(&Bench<'_>) -> anyhow::Result<T>) -> anyhow::Result<T> {
    let mut simulation = Simulation::new(Pace::Free);
    let board: Rc<dyn VirtualBoard> = Rc::new(SimBoard::start(&mut simulation, robot, seed)?);
    let (clock, rig) = (simulation.clock(), Rig::new(Target::Sim(robot.file.clone())));
    let session = rig.attached(board, &clock, async |session| work(&Bench::of(session, clock.clone())?).await);
    simulation.block_on(session).ok_or_else(|| anyhow!("the simulation came to a standstill"))?
}

impl<'b> Bench<'b> {
    fn of(session: &'b Session<'_>, clock: r4_sim::Clock) -> Result<Self, NotVirtual> {
        Ok(Self { host: session.board, board: session.virtual_board()?, clock, cable: session.cable()? })
    }

    async fn sleep_ms(&self, ms: u64) {
        self.clock.sleep(ms * MS).await;
    }

    /// Channels of a kind that accept `mode`, with their ranges.
    fn taking(&self, kind: ChannelKind, mode: Mode) -> impl Iterator<Item = (ChannelId, Range)> {
        let of_kind = self.host.channels().iter().filter(move |info| info.id.kind == kind);
        of_kind.filter_map(move |info| Some((info.id, info.mode(mode)?.range)))
    }

    /// Sends all set points without waiting, then awaits the answers.
    async fn set_all(
        &self,
        commands: impl IntoIterator<Item = (ChannelId, Mode, f32)>,
    ) -> Result<(), r4_driver::Error> {
        let commands = commands.into_iter();
        let sent = commands.map(|(channel, mode, value)| self.host.set(channel, Setpoint { mode, value }));
        join_all(sent).await.into_iter().collect()
    }
}
