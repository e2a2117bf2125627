//! `r4 debug`: the image on an emulated board, under gdb or with a trace.

use anyhow::bail;

use crate::args::{Args, Debug};
use crate::session::Target;

pub(crate) fn run(args: &Args, debug: &Debug) -> anyhow::Result<bool> {
    let Target::Emu(_) = &args.board else {
        bail!(
            "only an emulated board runs the firmware's image: name one, as in --board emu:{}",
            args.board.robot().unwrap_or("osmc-bench")
        );
    };
    if let Some(address) = debug.gdb
        && !address.ip().is_loopback()
        && !debug.public
    {
        bail!(
            "{address} can be reached from other machines, and gdb's protocol asks nobody who they are: serve it at 127.0.0.1, \
             or add --public if everybody there may"
        );
    }
    match &debug.scenario {
        Some(path) => super::scenario::play_one(args, path),
        None => alone(args, debug),
    }
}

/// A board that no host is connected to.
fn alone(args: &Args, debug: &Debug) -> anyhow::Result<bool> {
    use r4_emu::gdb::State;
    use r4_sim::{Pace, Simulation, VirtualBoard as _};

    use crate::{emulated, session};

    /// How long a board is traced when nothing is said, s.
    const TRACED_S: f64 = 1.0;
    /// How often it is looked whether to end, ns.
    const LOOK_EVERY_NS: u64 = 10_000_000;

    let robot = r4_boards::load(args.board.robot()?)?;
    let mut simulation = Simulation::new(args.pace.unwrap_or(Pace::Free));
    session::catch_interrupts();
    let (board, state) = emulated::start_debugged(args, &mut simulation, &robot, None)?;
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
