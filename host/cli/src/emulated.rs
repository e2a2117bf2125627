//! `--board emu:`: the firmware's ELF on the emulated processor.

use std::rc::Rc;

use anyhow::Context;
use r4_boards::Robot;
use r4_emu::{EmuBoard, Image};
use r4_sim::{Simulation, VirtualBoard, flash::Flash};
use r4_unicorn::UnicornCore;

use crate::args::Args;

/// Powers up an emulated board and says on stderr which image it runs.
pub(crate) fn start(
    args: &Args,
    simulation: &mut Simulation,
    robot: &Robot,
    flash: Option<Flash>,
) -> anyhow::Result<Rc<dyn VirtualBoard>> {
    let image = Image::find(args.board.robot())?;
    eprintln!("r4: runs {}, SHA-256 {}", image.path().display(), image.digest());
    let core = UnicornCore::new().context("the emulated processor does not start")?;
    let board = EmuBoard::start(simulation, robot, args.seed, &image, core, flash, Default::default())?;
    Ok(Rc::new(board))
}
