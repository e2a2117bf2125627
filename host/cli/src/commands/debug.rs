//! `r4 debug`: runs the firmware's image on an emulated board, under gdb or with a trace.

use anyhow::bail;
use r4_sim::Pace;

use crate::{
    args::{Args, Debug},
    emulated,
    session::{self, Target},
};

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
            "{address} can be reached from other machines, and gdb's protocol has no authentication: serve it at 127.0.0.1, \
             or add --public if all users there may control the board"
        );
    }
    match &debug.scenario {
        Some(path) => {
            let rig = |args: &Args| emulated::debugged(args, debug, session::rig(args, Pace::Free)?);
            super::scenario::play_on(args, rig, std::slice::from_ref(path))
        }
        None => emulated::debug(args, debug),
    }
}
