//! From `--board` to a session with that board.

use std::{
    cell::Cell,
    convert::Infallible,
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
use futures::future::{Either, select};
use r4_boards::Robot;
use r4_driver::{Board, Clock, with_board};
use r4_links::{Address, BadAddress, Event, Key, RealClock, Restart, is_of_link, with_reconnect};
use r4_protocol::{
    ChannelId, Mode,
    config::{BoardConfig, PidGains},
};
use r4_sim::{
    Pace, SimBoard, Simulation, VirtualBoard,
    flash::{Flash, SECTOR_BYTES},
    kept::{self, Loaded, Saved},
};

use crate::{
    args::{Args, Command},
    cable::{Cable, CableState},
    emulated::{self, LinkLog},
    heat::Warned,
    known, plants,
    record::{Listened, Recording, SharedTap},
};

/// What `--board` names.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Target {
    /// A simulated board of this robot: a built-in name or a TOML file.
    Sim(String),
    /// An emulated processor that runs the firmware's ELF, in the same simulated surroundings.
    Emu(String),
    /// A board at the other end of a link: a real one, or one that [`r4 sim serve`](crate::commands::serve) serves.
    Link(Address),
}

impl Target {
    /// The same kind of board for another robot; a link leads to the board that it leads to.
    pub(crate) fn with_robot(&self, robot: &str) -> anyhow::Result<Self> {
        match self {
            Self::Sim(_) => Ok(Self::Sim(robot.to_owned())),
            Self::Emu(_) => Ok(Self::Emu(robot.to_owned())),
            Self::Link(_) => Err(NotVirtual(self.clone()).into()),
        }
    }

    /// Its name, and that it is not a real board.
    pub(crate) fn described(&self) -> String {
        match self {
            Self::Sim(_) => format!("{self} (simulated)"),
            Self::Emu(_) => format!("{self} (emulated)"),
            Self::Link(_) => self.to_string(),
        }
    }

    /// The robot's name or file, of a virtual board.
    pub(crate) fn robot(&self) -> Result<&str, NotVirtual> {
        match self {
            Self::Sim(robot) | Self::Emu(robot) => Ok(robot),
            Self::Link(_) => Err(NotVirtual(self.clone())),
        }
    }
}

/// What was asked for needs a board whose world can be looked at and changed.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{0} is a board at the other end of a link: this needs a simulated one, as in --board sim:osmc-bench")]
pub(crate) struct NotVirtual(Target);

impl FromStr for Target {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.split_once(':') {
            Some(("sim", robot)) if !robot.is_empty() => Ok(Self::Sim(robot.to_owned())),
            Some(("emu", robot)) if !robot.is_empty() => Ok(Self::Emu(robot.to_owned())),
            Some(("serial" | "can" | "tcp", _)) => {
                text.parse().map(Self::Link).map_err(|error: BadAddress| error.to_string())
            }
            _ => {
                let known: Vec<_> = r4_boards::names().map(|name| format!("sim:{name}")).collect();
                Err(format!(
                    "`{text}` names no board: write sim: and a robot's name or file, or serial:, tcp: or can: and where it is; \
                     built in: {}",
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
            Self::Link(address) => address.fmt(f),
        }
    }
}

/// The time a session runs on.
#[derive(Clone)]
pub(crate) enum HostClock {
    /// Of a simulation.
    Virtual(r4_sim::Clock),
    /// Of this machine.
    Real(RealClock),
}

impl Clock for HostClock {
    fn now_us(&self) -> u64 {
        match self {
            Self::Virtual(clock) => clock.now_ns() / 1000,
            Self::Real(clock) => clock.now_us(),
        }
    }

    fn sleep_until(&self, at_us: u64) -> impl Future<Output = ()> {
        match self {
            Self::Virtual(clock) => Either::Left(clock.sleep_until(at_us.saturating_mul(1000))),
            Self::Real(clock) => Either::Right(clock.sleep_until(at_us)),
        }
    }
}

/// A connected board, and what only the program knows about it.
pub(crate) struct Session<'s> {
    pub(crate) board: &'s Board<HostClock>,
    /// Gains that the board gets back when the work is done, however that ends.
    gains_at_end: Cell<Option<(ChannelId, Mode, PidGains)>>,
    /// `None` at the end of a link.
    surroundings: Option<(Rc<dyn VirtualBoard>, Rc<CableState>)>,
    target: &'s Target,
    /// Of which hot windings a person has been warned.
    pub(crate) warned: Warned,
    /// What the driver's time is.
    pub(crate) clock: HostClock,
    /// What is recorded of this session.
    pub(crate) tap: Option<SharedTap>,
}

impl Session<'_> {
    /// Where a motor's output really is, rad or m, if anything can tell: a simulator can.
    pub(crate) fn true_position(&self, channel: ChannelId) -> Option<f64> {
        self.surroundings.as_ref()?.0.world().position(channel)
    }

    /// The board with its surroundings, to look at and to break.
    pub(crate) fn virtual_board(&self) -> Result<&dyn VirtualBoard, NotVirtual> {
        self.surroundings.as_ref().map(|(board, _)| &**board).ok_or_else(|| NotVirtual(self.target.clone()))
    }

    /// The cable to a virtual board, to cut.
    pub(crate) fn cable(&self) -> Result<&CableState, NotVirtual> {
        self.surroundings.as_ref().map(|(_, cable)| &**cable).ok_or_else(|| NotVirtual(self.target.clone()))
    }

    /// Has the board given these gains of one loop when the work is done, also when it fails or is interrupted; `None` takes
    /// that back.
    pub(crate) fn gains_at_end(&self, gains: Option<(ChannelId, Mode, PidGains)>) {
        self.gains_at_end.set(gains);
    }

    /// Arms, runs `work`, and disarms whatever came of it. Warns meanwhile of windings that become hot.
    pub(crate) async fn armed<T>(&self, work: impl AsyncFnOnce() -> anyhow::Result<T>) -> anyhow::Result<T> {
        self.board.arm().await.context("cannot arm")?;
        let result = match select(pin!(work()), pin!(self.watch_heat())).await {
            Either::Left((result, _)) => result,
            Either::Right((never, _)) => match never {},
        };
        self.warned.tell(&self.board.hot_windings());
        let disarmed = self.board.disarm().await;
        let value = result?;
        disarmed.context("cannot disarm; closing the session makes the board stop by itself")?;
        Ok(value)
    }
}

/// How often hot windings are looked for, s: heartbeats tell of them.
const HEAT_EVERY_S: f64 = 0.05;

impl Session<'_> {
    async fn watch_heat(&self) -> Infallible {
        loop {
            self.warned.tell(&self.board.hot_windings());
            self.board.sleep_s(HEAT_EVERY_S).await;
        }
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
pub(crate) struct FlashFile {
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
        let whole = Flash::<SECTOR_BYTES>::new(kept::SECTORS).to_bytes().len();
        let flash = Flash::from_bytes(&self.before).filter(|_| self.before.len() == whole);
        let (path, len) = (self.path.display(), self.before.len());
        flash.map(Some).ok_or_else(|| {
            anyhow!(
                "{path} is not the flash of a simulated board, or not all of it ({len} bytes; a whole one has {whole}): name \
                 another file, or move this one away to begin with an empty flash"
            )
        })
    }

    /// Says what of `flash` a board that was built with `config` does not use.
    fn review(&self, flash: &Flash, config: &BoardConfig) {
        let path = self.path.display();
        let instead = "the board starts as it was built, and the next `r4 config save` replaces it";
        let Loaded { saved, skipped, .. } = kept::review(flash, config);
        match saved {
            Saved::Nothing => {}
            Saved::Changes if skipped.count == 0 => {}
            Saved::Changes => {
                eprintln!("r4: {path}: {} saved parameters do not fit this robot and are not used", skipped.count);
            }
            Saved::OtherRobot(other) => {
                eprintln!("r4: {path}: its parameters are of the robot {other}, not {}: {instead}", config.robot);
            }
            Saved::NewerLayout(layout) => {
                eprintln!("r4: {path}: its parameters are of a newer firmware (layout {layout}): {instead}");
            }
            Saved::Damaged => eprintln!("r4: {path}: its parameters are damaged: {instead}"),
        }
    }

    /// Writes what `flash` holds now: all of it, or nothing.
    pub(crate) fn write(&self, flash: &Flash) -> anyhow::Result<()> {
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

/// Connects to the board that `args` name and runs `work` in a session with it, which is recorded where `--record` says.
///
/// Ctrl-C disarms, closes the session and is an error.
pub(crate) fn run<T>(
    args: &Args,
    default_pace: Pace,
    work: impl AsyncFnOnce(&Session<'_>) -> anyhow::Result<T>,
) -> anyhow::Result<(T, Elapsed)> {
    match Recording::open(args)? {
        Some(recording) => {
            let result = run_with(args, default_pace, Some(recording.tap()), work);
            recording.close(result)
        }
        None => run_with(args, default_pace, None, work),
    }
}

/// The same, recorded by `tap`.
pub(crate) fn run_with<T>(
    args: &Args,
    default_pace: Pace,
    tap: Option<SharedTap>,
    work: impl AsyncFnOnce(&Session<'_>) -> anyhow::Result<T>,
) -> anyhow::Result<(T, Elapsed)> {
    if let Target::Link(address) = &args.board {
        return run_on(args, address, tap, work);
    }
    let mut simulation = Simulation::new(args.pace.unwrap_or(default_pace));
    let (board, file) = power_up(args, &mut simulation)?;
    let clock = simulation.clock();
    let Some(port) = board.connect() else { bail!("the simulated board is already connected") };
    catch_interrupts();
    let begin = Instant::now();
    let (tx, cable) = Cable::new(port.tx, clock.clone());
    let host_clock = HostClock::Virtual(clock.clone());
    let (rx, tx) = (Listened::new(port.rx, tap.as_ref(), &host_clock), Listened::new(tx, tap.as_ref(), &host_clock));
    let host = with_board(rx, tx, host_clock.clone(), async |connected| {
        let surroundings = Some((board.clone(), cable));
        let session = Session {
            board: connected,
            gains_at_end: Cell::new(None),
            warned: Warned::default(),
            surroundings,
            target: &args.board,
            clock: host_clock.clone(),
            tap,
        };
        unless_interrupted(&session, host_clock, work(&session)).await
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

/// The key that `args` name. Its file may be a pipe, on whose writer Ctrl-C ends the wait.
pub(crate) fn key(args: &Args) -> anyhow::Result<Option<Key>> {
    let Some(path) = &args.key else { return Ok(None) };
    match Key::read_while(path, || !is_interrupted()) {
        Err(_) if is_interrupted() => Err(Interrupted.into()),
        key => Ok(Some(key?)),
    }
}

/// The same on a board at the other end of a link.
fn run_on<T>(
    args: &Args,
    address: &Address,
    tap: Option<SharedTap>,
    work: impl AsyncFnOnce(&Session<'_>) -> anyhow::Result<T>,
) -> anyhow::Result<(T, Elapsed)> {
    warn_of_virtual_options(args);
    catch_interrupts();
    let begin = Instant::now();
    let value = r4_links::block_on(async {
        let link = r4_links::open(address, key(args)?.as_ref()).await?;
        let clock = HostClock::Real(RealClock);
        let (rx, tx) = (Listened::new(link.rx, tap.as_ref(), &clock), Listened::new(link.tx, tap.as_ref(), &clock));
        let connected = with_board(rx, tx, clock.clone(), async |connected| {
            known::remember(address, connected.channels());
            let session = Session {
                board: connected,
                gains_at_end: Cell::new(None),
                warned: Warned::default(),
                surroundings: None,
                target: &args.board,
                clock: clock.clone(),
                tap,
            };
            unless_interrupted(&session, clock, logged(args, &session, work(&session))).await
        });
        connected.await.with_context(|| format!("cannot connect to {}", args.board))?
    })?;
    let wall_s = begin.elapsed().as_secs_f64();
    Ok((value, Elapsed { simulated_s: wall_s, wall_s }))
}

/// The same for what a person watches: on a board at the other end of a link `work` is run again each time that a lost link is
/// back, and `tell` is told of both. Without a link there is `meanwhile`; where that ends, all does.
///
/// A recording goes on with the next session; the time between is a gap in it.
pub(crate) fn keep<T>(
    args: &Args,
    default_pace: Pace,
    mut work: impl AsyncFnMut(&Session<'_>) -> anyhow::Result<T>,
    tell: impl FnMut(Event),
    meanwhile: impl AsyncFnOnce(&HostClock) -> anyhow::Result<T>,
) -> anyhow::Result<T> {
    let Target::Link(address) = &args.board else { return Ok(run(args, default_pace, work)?.0) };
    warn_of_virtual_options(args);
    catch_interrupts();
    let clock = HostClock::Real(RealClock);
    let key = key(args)?;
    let recording = Recording::open(args)?;
    let tap = recording.as_ref().map(Recording::tap);
    let has_session = Cell::new(false);
    let connected = with_reconnect(
        address,
        key.as_ref(),
        clock.clone(),
        |link| {
            if let Some(tap) = &tap {
                tap.borrow_mut().reopened();
            }
            (Listened::new(link.rx, tap.as_ref(), &clock), Listened::new(link.tx, tap.as_ref(), &clock))
        },
        async |board| {
            has_session.set(true);
            known::remember(address, board.channels());
            let session = Session {
                board,
                gains_at_end: Cell::new(None),
                warned: Warned::default(),
                surroundings: None,
                target: &args.board,
                clock: clock.clone(),
                tap: tap.clone(),
            };
            let result = unless_interrupted(&session, clock.clone(), logged(args, &session, work(&session))).await;
            has_session.set(false);
            result
        },
        |error| error.downcast_ref().filter(|error| is_of_link(error)).cloned(),
        tell,
    );
    let ended = r4_links::block_on(async {
        // A session disarms first.
        let interrupted = async {
            while !is_interrupted() || has_session.get() {
                clock.sleep_until(clock.now_us() + INTERRUPT_POLL_US).await;
            }
        };
        match select(pin!(connected), select(pin!(interrupted), pin!(meanwhile(&clock)))).await {
            Either::Left((result, _)) | Either::Right((Either::Right((result, _)), _)) => result,
            Either::Right((Either::Left(_), _)) => Err(Interrupted.into()),
        }
    });
    let ended = ended.with_context(|| args.board.to_string());
    drop(tap);
    match recording {
        Some(recording) => recording.close(ended),
        None => ended,
    }
}

/// What became of a link, in a line.
pub(crate) fn told(event: &Event) -> String {
    match event {
        Event::Lost { why } => format!("{why}; trying again"),
        Event::Back { after, restart } => {
            let what = match restart {
                None => "the board ran on meanwhile",
                Some(Restart::Watchdog) => "device reset: watchdog",
                Some(Restart::Power) => "device reset: power, button or new firmware",
            };
            format!("the link is back after {:.1} s; {what}", after.as_secs_f64())
        }
    }
}

fn warn_of_virtual_options(args: &Args) {
    if args.flash.is_some() || args.pace.is_some() || args.world.is_some() {
        eprintln!(
            "r4: --flash, --pace and --world are for simulated boards: {} has its own flash, real time and world",
            args.board
        );
    }
}

/// Powers up the virtual board that `args` name, with the flash in its file.
pub(crate) fn power_up(
    args: &Args,
    simulation: &mut Simulation,
) -> anyhow::Result<(Rc<dyn VirtualBoard>, Option<FlashFile>)> {
    let name = args.board.robot()?;
    let mut robot: Robot = r4_boards::load(name)?;
    plants::replace(args, &mut robot)?;
    if let Some(world) = &args.world {
        let world = r4_boards::load_world(world)?;
        if robot.simulation.body.is_none() {
            bail!(
                "{name} has no [body] to stand in a world: add one to its file (boards/README.md), or leave out --world"
            );
        }
        robot.simulation.enter(world);
    }
    let file = args.flash.as_deref().map(FlashFile::open).transpose()?;
    let flash = file.as_ref().map(FlashFile::flash).transpose()?.flatten();
    if let (Some(file), Some(flash)) = (&file, &flash) {
        file.review(flash, &robot.config);
    }
    // Of two boards that are compared the emulated one has a log.
    let compared = matches!(&args.command, Command::Scenario(scenario) if scenario.compare);
    if args.log.is_some() && matches!(args.board, Target::Sim(_)) && !compared {
        bail!(
            "a simulated board has no log: that of the firmware's image is read on a real or an emulated one, emu:{name}"
        );
    }
    let board = start(args, simulation, &robot, flash)?;
    plants::hide(args, &robot, &*board)?;
    Ok((board, file))
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
        Target::Emu(_) => emulated::start(args, simulation, robot, flash),
        Target::Link(_) => Err(NotVirtual(args.board.clone()).into()),
    }
}

/// Prints what the firmware logs while `work` runs, where `args` ask for it.
async fn logged<T>(
    args: &Args,
    session: &Session<'_>,
    work: impl Future<Output = anyhow::Result<T>>,
) -> anyhow::Result<T> {
    let Some(from) = args.log else { return work.await };
    let mut log = LinkLog::open(session.board, session.clock.clone(), from).await?;
    let result = match select(pin!(work), pin!(log.follow())).await {
        Either::Left((result, _)) => result,
        // The link ended, of which the work will say more.
        Either::Right(((), work)) => work.await,
    };
    log.rest();
    result
}

/// Until Ctrl-C.
async fn interrupted(clock: &HostClock) {
    while !is_interrupted() {
        clock.sleep_until(clock.now_us() + INTERRUPT_POLL_US).await;
    }
}

async fn unless_interrupted<T>(
    session: &Session<'_>,
    clock: HostClock,
    work: impl Future<Output = anyhow::Result<T>>,
) -> anyhow::Result<T> {
    let result = match select(pin!(work), pin!(interrupted(&clock))).await {
        Either::Left((result, _)) => result,
        Either::Right(((), _)) => {
            session.board.disarm().await.context("interrupted; could not disarm, the board stops by itself")?;
            Err(Interrupted.into())
        }
    };
    let Some((channel, mode, gains)) = session.gains_at_end.take() else { return result };
    let put_back = session.board.set_gains(channel, mode, gains).await;
    let value = result?;
    put_back.with_context(|| format!("{channel} has other gains than it began with: restart the board"))?;
    Ok(value)
}
