//! `--board emu:`: executes the firmware's ELF file on the emulated processor.

use std::{
    cell::Cell,
    fs::File,
    io::{self, BufWriter, Write},
    net::{Ipv4Addr, SocketAddr, TcpListener},
    path::Path,
    rc::Rc,
};

use anyhow::{Context, bail};
use r4_boards::Robot;
use r4_emu::{
    EmuBoard, Settings,
    gdb::{Server, Starter, State},
    log::{Level, Log, Record},
    tracing::{Tracer, Wanted, resolve},
};
use r4_image::Image;
use r4_rig::Rig;
use r4_sim::{Pace, Simulation, VirtualBoard};
use r4_thumb::ThumbCore;

use crate::{
    args::{Args, Debug, LogLevel},
    session,
};

/// Default address of the gdb server, with the port that debug probes use.
const GDB: SocketAddr = SocketAddr::new(std::net::IpAddr::V4(Ipv4Addr::LOCALHOST), 3333);

/// Default length of a trace, s.
const TRACED_S: f64 = 1.0;
/// Polling period of the end conditions, virtual ns.
const LOOK_EVERY_NS: u64 = 10_000_000;

/// Makes emulated boards print their firmware's log on stderr if `args` ask for it.
pub(crate) fn log(args: &Args, rig: &mut Rig) {
    let Some(level) = args.log else { return };
    rig.emulated.observer = Some(Rc::new(move |board, image| Ok(attach_log(level, board, image)?)));
}

fn attach_log(level: LogLevel, board: &EmuBoard<ThumbCore>, image: &Image) -> anyhow::Result<()> {
    let control_block = board.machine().symbols().address("_SEGGER_RTT");
    board.watch(Log::new(image, control_block, move |record| print(level, &record))?);
    Ok(())
}

/// Finds the image for a robot.
pub(crate) fn image(robot: &str) -> anyhow::Result<Image> {
    Ok(Image::find(robot)?)
}

/// Powers up an emulated board that runs `image`, without a rig around it.
pub(crate) fn start_image(
    simulation: &mut Simulation,
    robot: &Robot,
    seed: u64,
    image: &Image,
) -> anyhow::Result<Rc<dyn VirtualBoard>> {
    Ok(Rc::new(EmuBoard::start(simulation, robot, seed, image, ThumbCore::new(), None, Settings::default())?))
}

/// Attaches gdb and a trace to the emulated board of a rig.
pub(crate) fn debugged(args: &Args, debug: &Debug, rig: Rig) -> anyhow::Result<Rig> {
    Ok(with_debugger(args, debug, rig).0)
}

/// Runs a board without a host, under gdb or with a trace.
pub(crate) fn debug(args: &Args, debug: &Debug) -> anyhow::Result<bool> {
    session::catch_interrupts();
    let (rig, state) = with_debugger(args, debug, session::rig(args, Pace::Free)?);
    let mut simulation = Simulation::new(rig.pace);
    let (board, _) = rig.power_up(&mut simulation)?;
    let state = state.take();
    // Without gdb, which can end the run, a trace needs an end.
    let seconds = debug.seconds.or(if state.is_none() { Some(TRACED_S) } else { None });
    let until_ns = seconds.map_or(u64::MAX, |seconds| (seconds * 1e9) as u64);
    let clock = simulation.clock();
    let gone = || match state.as_ref().map(|state| state.get()) {
        Some(State::Killed) => true,
        Some(State::Detached) => debug.seconds.is_none(),
        _ => false,
    };
    simulation.block_on(async {
        while clock.now_ns() < until_ns && !gone() && !session::is_interrupted() && board.failure().is_none() {
            clock.sleep_until(until_ns.min(clock.now_ns() + LOOK_EVERY_NS)).await;
        }
    });
    if let Some(failure) = board.failure() {
        bail!("the emulated board stopped: {failure}");
    }
    Ok(true)
}

/// State of the gdb session, once a board is powered up; `None` without gdb.
type Debugging = Rc<Cell<Option<Rc<Cell<State>>>>>;

fn with_debugger(args: &Args, debug: &Debug, mut rig: Rig) -> (Rig, Debugging) {
    let gdb = debug.gdb.or(debug.until.map(|_| GDB));
    rig.emulated.settings = Settings { stop_at_breakpoints: gdb.is_some(), ..Settings::default() };
    let debugging = Debugging::default();
    let (level, debug, attached) = (args.log, debug.clone(), debugging.clone());
    rig.emulated.observer = Some(Rc::new(move |board, image| {
        if let Some(level) = level {
            attach_log(level, board, image)?;
        }
        if let Some(path) = &debug.trace {
            board.watch(tracer(board, path, &debug.symbol)?);
        }
        attached.set(gdb.map(|address| serve(board, address, &debug)).transpose()?);
        Ok(())
    }));
    (rig, debugging)
}

fn serve(board: &EmuBoard<ThumbCore>, address: SocketAddr, debug: &Debug) -> anyhow::Result<Rc<Cell<State>>> {
    let listener = TcpListener::bind(address).with_context(|| format!("cannot serve gdb at {address}"))?;
    let attach_at_ns = debug.until.unwrap_or_else(|| debug.attach_at.map_or(0, |seconds| (seconds * 1e9) as u64));
    let server = Server::new(board.shared_machine(), listener, attach_at_ns, Person);
    let state = server.state();
    board.watch(server);
    Ok(state)
}

fn tracer(board: &EmuBoard<ThumbCore>, path: &Path, symbols: &[String]) -> anyhow::Result<Tracer<Box<dyn Write>>> {
    let calls = symbols.iter().map(|name| resolve(board.machine().symbols(), name));
    let calls = calls.collect::<Result<Vec<_>, _>>()?;
    let out: Box<dyn Write> = if path == Path::new("-") {
        Box::new(BufWriter::new(io::stdout()))
    } else {
        let file = File::create(path).with_context(|| format!("cannot write the trace {}", path.display()))?;
        Box::new(BufWriter::new(file))
    };
    // With `--symbol`, trace only calls of those functions.
    let only_calls = !calls.is_empty();
    Ok(Tracer::new(&board.shared_machine(), out, Wanted { calls, only_calls }))
}

/// User at the terminal.
struct Person;

impl Starter for Person {
    fn say(&self, text: &str) {
        eprintln!("r4: {text}");
    }

    fn interrupted(&self) -> bool {
        session::is_interrupted()
    }

    fn killed(&self) {
        session::interrupt();
    }
}

/// Prints a record of the firmware's log if its level is at least `from`.
pub(super) fn print(from: LogLevel, record: &Record) {
    let level = record.level.map(|level| match level {
        Level::Trace => LogLevel::Trace,
        Level::Debug => LogLevel::Debug,
        Level::Info => LogLevel::Info,
        Level::Warn => LogLevel::Warn,
        Level::Error => LogLevel::Error,
    });
    // Records without a level are always printed.
    if level.is_none_or(|level| level >= from) {
        let name = record.level.map_or("", Level::name);
        let read_s = record.read_ns as f64 * 1e-9;
        eprintln!("{read_s:>11.6} s  {name:5} {:>10}  {}", record.stamp, record.message);
    }
}
