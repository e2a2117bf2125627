//! From `--board` to a session with that board.

use std::{
    fs,
    future::Future,
    io,
    path::{Path, PathBuf},
    pin::pin,
    rc::Rc,
    str::FromStr,
    sync::atomic::{AtomicBool, Ordering},
    time::Instant,
};

use anyhow::{Context, anyhow, bail};
use r4_boards::Robot;
use r4_driver::{Board, Clock, with_board};
use r4_sim::{Pace, SimBoard, Simulation, VirtualBoard, flash::Flash};

use crate::{
    args::Args,
    cable::{Cable, CableState},
};

/// What `--board` names.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Target {
    /// A simulated board of this robot: a built-in name or a TOML file.
    Sim(String),
    /// An emulated processor that runs the firmware's ELF, in the same simulated surroundings.
    Emu(String),
}

impl Target {
    /// The same kind of board for another robot.
    pub(crate) fn with_robot(&self, robot: &str) -> Self {
        match self {
            Self::Sim(_) => Self::Sim(robot.to_owned()),
            Self::Emu(_) => Self::Emu(robot.to_owned()),
        }
    }

    /// The robot's name or file.
    pub(crate) fn robot(&self) -> &str {
        let (Self::Sim(robot) | Self::Emu(robot)) = self;
        robot
    }
}

impl FromStr for Target {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once(':') {
            Some(("sim", robot)) if !robot.is_empty() => Ok(Self::Sim(robot.to_owned())),
            Some(("emu", robot)) if !robot.is_empty() => Ok(Self::Emu(robot.to_owned())),
            Some(("serial" | "can" | "tcp", _)) => {
                Err(format!("`{text}`: this version only has simulated and emulated boards, as in sim:osmc-bench"))
            }
            _ => {
                let known: Vec<_> = r4_boards::names().map(|name| format!("sim:{name}")).collect();
                Err(format!(
                    "`{text}` names no board: write sim: and a robot's name or file; built in: {}",
                    known.join(" ")
                ))
            }
        }
    }
}

impl std::fmt::Display for Target {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Sim(robot) => write!(f, "sim:{robot}"),
            Self::Emu(robot) => write!(f, "emu:{robot}"),
        }
    }
}

/// The time a session runs on.
#[derive(Clone)]
pub(crate) struct HostClock(pub(crate) r4_sim::Clock);

impl Clock for HostClock {
    fn now_us(&self) -> u64 {
        self.0.now_ns() / 1000
    }

    fn sleep_until(&self, at_us: u64) -> impl Future<Output = ()> {
        self.0.sleep_until(at_us.saturating_mul(1000))
    }
}

/// A connected board, and what only the program knows about it.
pub(crate) struct Session<'s> {
    pub(crate) board: &'s Board<HostClock>,
    surroundings: Rc<dyn VirtualBoard>,
    cable: Rc<CableState>,
}

impl Session<'_> {
    /// Where a motor's output really is, rad or m, if anything can tell: a simulator can.
    pub(crate) fn true_position(&self, channel: r4_protocol::ChannelId) -> Option<f64> {
        self.surroundings.world().position(channel)
    }

    /// The board with its surroundings, to look at and to break.
    pub(crate) fn virtual_board(&self) -> &dyn VirtualBoard {
        &*self.surroundings
    }

    /// The cable to the board, to cut.
    pub(crate) fn cable(&self) -> &CableState {
        &self.cable
    }

    /// Arms, runs `work`, and disarms whatever came of it.
    pub(crate) async fn armed<T>(&self, work: impl AsyncFnOnce() -> anyhow::Result<T>) -> anyhow::Result<T> {
        self.board.arm().await.context("cannot arm")?;
        let result = work().await;
        let disarmed = self.board.disarm().await;
        let value = result?;
        disarmed.context("cannot disarm; closing the session makes the board stop by itself")?;
        Ok(value)
    }
}

/// How long a simulation ran, in its own time and on the wall.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Elapsed {
    pub(crate) simulated_s: f64,
    pub(crate) wall_s: f64,
}

impl Elapsed {
    pub(crate) fn real_time_factor(self) -> f64 {
        self.simulated_s / self.wall_s.max(1e-9)
    }
}

/// Somebody pressed Ctrl-C.
#[derive(Debug, thiserror::Error)]
#[error("interrupted; the board is disarmed")]
pub(crate) struct Interrupted;

/// How often Ctrl-C is looked for, on the session's clock.
const INTERRUPT_POLL_US: u64 = 10_000;

/// Set by Ctrl-C.
static INTERRUPTED: AtomicBool = AtomicBool::new(false);

/// Somebody has pressed Ctrl-C, or [`interrupt`] was called.
pub(crate) fn is_interrupted() -> bool {
    INTERRUPTED.load(Ordering::Relaxed)
}

/// Does what Ctrl-C does.
pub(crate) fn interrupt() {
    INTERRUPTED.store(true, Ordering::Relaxed);
}

/// Lets Ctrl-C end what runs in good order.
pub(crate) fn catch_interrupts() {
    // A second handler cannot be set; the first one does the same.
    let _ = ctrlc::set_handler(|| INTERRUPTED.store(true, Ordering::Relaxed));
}

/// The file with a simulated board's flash.
struct FlashFile {
    path: PathBuf,
    /// What was in it; nothing before there was a file.
    before: Vec<u8>,
}

impl FlashFile {
    fn open(path: &Path) -> anyhow::Result<Self> {
        let before = match fs::read(path) {
            Ok(before) => before,
            Err(error) if error.kind() == io::ErrorKind::NotFound => Vec::new(),
            Err(error) => return Err(error).with_context(|| format!("cannot read the flash {}", path.display())),
        };
        Ok(Self { path: path.to_owned(), before })
    }

    /// The flash, or `None` where nothing was ever written.
    fn flash(&self) -> anyhow::Result<Option<Flash>> {
        if self.before.is_empty() {
            return Ok(None);
        }
        let flash = Flash::from_bytes(&self.before);
        let path = self.path.display();
        flash.map(Some).ok_or_else(|| anyhow!("{path} is not the flash of a simulated board: name another file"))
    }

    /// Writes what `flash` holds now: all of it, or nothing.
    fn write(&self, flash: &Flash) -> anyhow::Result<()> {
        let now = flash.to_bytes();
        if now == self.before {
            return Ok(());
        }
        let mut beside = self.path.clone().into_os_string();
        beside.push(".new");
        let written = fs::write(&beside, &now).and_then(|()| fs::rename(&beside, &self.path));
        written.with_context(|| format!("cannot write the flash {}", self.path.display()))
    }
}

/// Connects to the board that `args` name and runs `work` in a session with it.
///
/// Ctrl-C disarms, closes the session and is an error.
pub(crate) fn run<T>(
    args: &Args,
    default_pace: Pace,
    work: impl AsyncFnOnce(&Session<'_>) -> anyhow::Result<T>,
) -> anyhow::Result<(T, Elapsed)> {
    let robot: Robot = r4_boards::load(args.board.robot())?;
    let mut simulation = Simulation::new(args.pace.unwrap_or(default_pace));
    let file = args.flash.as_deref().map(FlashFile::open).transpose()?;
    let flash = file.as_ref().map(FlashFile::flash).transpose()?.flatten();
    if args.log.is_some() && matches!(args.board, Target::Sim(_)) {
        eprintln!(
            "r4: a simulated board has no log: that of the firmware's image is read on an emulated one, emu:{}",
            args.board.robot()
        );
    }
    let board = start(args, &mut simulation, &robot, flash)?;
    let clock = simulation.clock();
    let Some(port) = board.connect() else { bail!("the simulated board is already connected") };
    catch_interrupts();
    let begin = Instant::now();
    let (tx, cable) = Cable::new(port.tx, clock.clone());
    let host = with_board(port.rx, tx, HostClock(clock.clone()), async |connected| {
        let session = Session { board: connected, surroundings: board.clone(), cable };
        unless_interrupted(&session, HostClock(clock.clone()), work(&session)).await
    });
    let result = simulation.block_on(host);
    if let Some(failure) = board.failure() {
        bail!("the emulated board stopped: {failure}");
    }
    let result = result.ok_or_else(|| anyhow!("the simulation came to a standstill"))?;
    let elapsed = Elapsed { simulated_s: clock.now_ns() as f64 * 1e-9, wall_s: begin.elapsed().as_secs_f64() };
    if let Some(file) = file {
        file.write(&board.flash())?;
    }
    let value = result.with_context(|| format!("cannot connect to {}", args.board))??;
    Ok((value, elapsed))
}

/// Powers up the virtual board that `args` name.
fn start(
    args: &Args,
    simulation: &mut Simulation,
    robot: &Robot,
    flash: Option<Flash>,
) -> anyhow::Result<Rc<dyn VirtualBoard>> {
    match &args.board {
        Target::Sim(_) => Ok(match flash {
            Some(flash) => Rc::new(SimBoard::start_with(simulation, robot, args.seed, flash)?),
            None => Rc::new(SimBoard::start(simulation, robot, args.seed)?),
        }),
        Target::Emu(_) => crate::emulated::start(args, simulation, robot, flash),
    }
}

async fn unless_interrupted<T>(
    session: &Session<'_>,
    clock: HostClock,
    work: impl Future<Output = anyhow::Result<T>>,
) -> anyhow::Result<T> {
    let interrupt = async {
        while !INTERRUPTED.load(Ordering::Relaxed) {
            clock.sleep_until(clock.now_us() + INTERRUPT_POLL_US).await;
        }
    };
    match futures::future::select(pin!(work), pin!(interrupt)).await {
        futures::future::Either::Left((result, _)) => result,
        futures::future::Either::Right(((), _)) => {
            session.board.disarm().await.context("interrupted; could not disarm, the board stops by itself")?;
            Err(Interrupted.into())
        }
    }
}
