//! Sessions with the board that the command line names.

use std::{
    fs,
    pin::{Pin, pin},
    rc::Rc,
    sync::{
        LazyLock,
        atomic::{AtomicBool, Ordering},
    },
};

use anyhow::{Context, bail};
use futures::future::{Either, select};
use r4_access::Source;
use r4_driver::Error as DriverError;
use r4_links::{Address, Event, Key, Restart};
pub(crate) use r4_rig::{Elapsed, HostClock, Interrupted, Session, Target};
use r4_rig::{Error, Interrupt, Notice, Recorded, Rig, recording::SharedTap, view::SharedLook};
use r4_sim::Pace;

use crate::{
    args::Args,
    emulated::{self, LinkLog},
    known,
    record::{self, Recording},
};

/// Interrupt of all sessions, set by Ctrl-C.
static INTERRUPT: LazyLock<Interrupt> = LazyLock::new(Interrupt::default);

/// True after Ctrl-C or [`interrupt`].
pub(crate) fn is_interrupted() -> bool {
    INTERRUPT.is_set()
}

/// Interrupts as Ctrl-C does.
pub(crate) fn interrupt() {
    INTERRUPT.set();
}

/// Lets Ctrl-C end the running work in good order.
pub(crate) fn catch_interrupts() {
    // A second handler cannot be set; the first one does the same.
    let _ = ctrlc::set_handler(interrupt);
}

/// True if a command was ended by Ctrl-C.
pub(crate) fn was_interrupted(error: &anyhow::Error) -> bool {
    error.is::<Interrupted>() || matches!(error.downcast_ref(), Some(Error::Interrupted(_)))
}

/// Error of the driver that made a command fail, if that is the reason.
pub(crate) fn driver_error(error: &anyhow::Error) -> Option<&DriverError> {
    error.chain().find_map(|cause| match cause.downcast_ref().map(Error::innermost) {
        Some(Error::Board(error)) => Some(error),
        _ => cause.downcast_ref(),
    })
}

/// Set once a board has the requested physics.
static HAS_OTHER_PHYSICS: AtomicBool = AtomicBool::new(false);

/// True unless physics were requested that no board had.
pub(crate) fn has_physics_as_asked(args: &Args) -> bool {
    !args.asks_for_physics() || HAS_OTHER_PHYSICS.load(Ordering::Relaxed)
}

/// Notes that the requested physics are used.
pub(crate) fn uses_other_physics() {
    HAS_OTHER_PHYSICS.store(true, Ordering::Relaxed);
}

/// Rig of the board that `args` name, with all their options.
pub(crate) fn rig(args: &Args, default_pace: Pace) -> anyhow::Result<Rig> {
    if let Target::Link(_) = args.board {
        if args.flash.is_some() || args.pace.is_some() || args.world.is_some() {
            eprintln!(
                "r4: --flash, --pace and --world are for simulated boards: {} has its own flash, real time and world",
                args.board
            );
        }
    } else {
        uses_other_physics();
    }
    // A simulated board runs the firmware's code natively, without the image's log.
    if let (Some(_), Target::Sim(name)) = (args.log, &args.board) {
        bail!("a simulated board has no firmware log: use a real or an emulated board, emu:{name}");
    }
    let mut rig = Rig::new(args.board.clone());
    rig.seed = args.seed;
    rig.pace = args.pace.unwrap_or(default_pace);
    rig.flash.clone_from(&args.flash);
    rig.world.clone_from(&args.world);
    rig.plants = args.plants_of_channels()?;
    rig.body.clone_from(&args.body);
    rig.hidden = args.blind;
    rig.interrupt = INTERRUPT.clone();
    rig.notify = Rc::new(|notice: &Notice| eprintln!("r4: {notice}"));
    if let Target::Link(_) = args.board {
        rig.key = key(args)?;
        rig.token = args.token.as_deref().map(Source::read).transpose()?;
    }
    emulated::log(args, &mut rig);
    Ok(rig)
}

/// Connects to the board that `args` name and runs `work` in a session with it, recorded if `--record` says so.
///
/// Ctrl-C disarms, closes the session and is an error.
pub(crate) fn run<T>(
    args: &Args,
    default_pace: Pace,
    work: impl AsyncFnOnce(&Session<'_>) -> anyhow::Result<T>,
) -> anyhow::Result<(T, Elapsed)> {
    run_on(args, &rig(args, default_pace)?, work)
}

/// Runs `work` as [`run`] does, on a rig that was already made from `args`.
pub(crate) fn run_on<T>(
    args: &Args,
    rig: &Rig,
    work: impl AsyncFnOnce(&Session<'_>) -> anyhow::Result<T>,
) -> anyhow::Result<(T, Elapsed)> {
    catch_interrupts();
    match Recording::open(args)? {
        Some(recording) => {
            let result = rig.run(Some(recording.tap()), begun(args, work));
            recording.close(result)
        }
        None => rig.run(None, begun(args, work)),
    }
}

/// Runs `work` as [`run`] does, and returns the recording, for verbs that read their own log. `--record` gets the same
/// bytes.
pub(crate) fn in_memory<T>(
    args: &Args,
    default_pace: Pace,
    work: impl AsyncFnOnce(&Session<'_>) -> anyhow::Result<T>,
) -> (anyhow::Result<(T, Elapsed)>, Vec<u8>) {
    let rig = match rig(args, default_pace) {
        Ok(rig) => rig,
        Err(error) => return (Err(error), Vec::new()),
    };
    catch_interrupts();
    let Recorded { result, log, log_error } = rig.recorded(|output| record::tap(args, output), begun(args, work));
    // An error of the recording counts only if the work succeeded.
    let closed = match (log_error, &args.record) {
        (Some(error), _) => Err(error.into()),
        (None, Some(path)) if !log.is_empty() => {
            record::is_made();
            fs::write(path, &log).with_context(|| format!("cannot write {}", path.display()))
        }
        (None, _) => Ok(()),
    };
    (result.and_then(|value| closed.map(|()| value)), log)
}

/// Wraps `work` with the steps at the beginning of each session.
fn begun<T>(
    args: &Args,
    work: impl AsyncFnOnce(&Session<'_>) -> anyhow::Result<T>,
) -> impl AsyncFnOnce(&Session<'_>) -> anyhow::Result<T> {
    async move |session: &Session<'_>| {
        begin(session);
        logged(args, session, work(session)).await
    }
}

fn begin(session: &Session<'_>) {
    if let Target::Link(address) = session.target() {
        known::remember(address, session.board.channels());
    }
}

/// Runs `work` for commands that watch: on a board at the other end of a link, again after each reconnection, and
/// `tell` is called for each loss and return of the link. `meanwhile` runs without a link; when it ends, the command
/// ends.
///
/// A recording continues with the next session; the time between is a gap in it.
pub(crate) fn keep<T>(
    args: &Args,
    default_pace: Pace,
    mut work: impl AsyncFnMut(&Session<'_>) -> anyhow::Result<T>,
    tell: impl FnMut(Event),
    meanwhile: impl AsyncFnOnce(&HostClock) -> anyhow::Result<T>,
) -> anyhow::Result<T> {
    let Target::Link(address) = &args.board else {
        return Ok(run(args, default_pace, async |session: &Session<'_>| work(session).await)?.0);
    };
    keep_on(args, &rig(args, default_pace)?, address, work, tell, meanwhile)
}

/// Runs `work` as [`keep`] does, on a virtual board that this program serves at an address, with a key.
pub(crate) fn keep_served<T>(
    args: &Args,
    (address, key, look): (&Address, &Key, &SharedLook),
    work: impl AsyncFnMut(&Session<'_>) -> anyhow::Result<T>,
    tell: impl FnMut(Event),
    meanwhile: impl AsyncFnOnce(&HostClock) -> anyhow::Result<T>,
) -> anyhow::Result<T> {
    let mut rig = rig(args, Pace::RealTime(1.0))?;
    rig.key = Some(key.clone());
    rig.look = Some(look.clone());
    keep_on(args, &rig, address, work, tell, meanwhile)
}

fn keep_on<T>(
    args: &Args,
    rig: &Rig,
    address: &Address,
    mut work: impl AsyncFnMut(&Session<'_>) -> anyhow::Result<T>,
    tell: impl FnMut(Event),
    meanwhile: impl AsyncFnOnce(&HostClock) -> anyhow::Result<T>,
) -> anyhow::Result<T> {
    catch_interrupts();
    let recording = Recording::open(args)?;
    let tap: Option<SharedTap> = recording.as_ref().map(Recording::tap);
    let work = async |session: &Session<'_>| {
        begin(session);
        logged(args, session, work(session)).await
    };
    let ended = rig.keep(address, tap, work, driver_error, tell, meanwhile).with_context(|| args.board.to_string());
    match recording {
        Some(recording) => recording.close(ended),
        None => ended,
    }
}

/// Key of the file that `args` name. The file may be a pipe; Ctrl-C ends the wait for its writer.
pub(crate) fn key(args: &Args) -> anyhow::Result<Option<Key>> {
    let Some(path) = &args.key else { return Ok(None) };
    catch_interrupts();
    match Key::read_while(path, || !is_interrupted()) {
        Err(_) if is_interrupted() => Err(Interrupted.into()),
        key => Ok(Some(key?)),
    }
}

/// Message about the loss or return of a link.
pub(crate) fn told(event: &Event) -> String {
    match event {
        Event::Lost { why } => format!("{why}; trying again"),
        Event::Back { after, restart } => {
            let what = match restart {
                None => "the board kept running",
                Some(Restart::Watchdog) => "device reset: watchdog",
                Some(Restart::Power) => "device reset: power, button or new firmware",
            };
            format!("the link is back after {:.1} s; {what}", after.as_secs_f64())
        }
    }
}

/// Prints the firmware log of a board at the end of a link while `work` runs, if `args` ask for it.
async fn logged<T>(
    args: &Args,
    session: &Session<'_>,
    work: impl Future<Output = anyhow::Result<T>>,
) -> anyhow::Result<T> {
    let mut result = None;
    log_until(args, session, pin!(async { result = Some(work.await) })).await?;
    result.context("the work of the session did not end")?
}

/// Prints the firmware log until `work` ends, as [`logged`]. Not generic, so that it is compiled once for all work.
async fn log_until(args: &Args, session: &Session<'_>, work: Pin<&mut dyn Future<Output = ()>>) -> anyhow::Result<()> {
    let (Some(from), Target::Link(_)) = (args.log, session.target()) else {
        work.await;
        return Ok(());
    };
    let mut log = LinkLog::open(session.board, session.clock.clone(), from).await?;
    if let Either::Right(((), work)) = select(work, pin!(log.follow())).await {
        // The link ended; the error of `work` says why.
        work.await;
    }
    log.rest();
    Ok(())
}
