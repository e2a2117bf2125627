//! `r4 demo`: what a virtual robot does, looked at without knowing anything about it.

mod osmc;
mod square;

use std::{borrow::Cow, fs, path::Path};

use anyhow::Context;
use r4_boards::Drive;
use r4_log::Log;
use sha2::{Digest, Sha256};

use crate::{
    args::{Args, Demo},
    session::Target,
};

/// The world of the robots that drive, where none is named.
const WORLD: &str = "square";

/// Runs the demo of the robot: round a room for one that drives on a body, the set points of the OSMC evaluation for all others.
pub(crate) fn run(args: &Args, demo: &Demo) -> anyhow::Result<bool> {
    let mut args = Cow::Borrowed(args);
    if let Some(robot) = &demo.robot {
        let board = args.board.with_robot(robot).context("--robot is for simulated boards")?;
        args.to_mut().board = board;
    }
    let robot = match &args.board {
        Target::Sim(name) | Target::Emu(name) => Some(r4_boards::load(name)?),
        Target::Link(_) => None,
    };
    match robot {
        Some(robot) if robot.simulation.body.is_some() => {
            if let Some(Drive::SkidSteer(drive)) = robot.drive {
                args.to_mut().world.get_or_insert_with(|| WORLD.into());
                return square::run(&args, demo, &drive);
            }
            osmc::run(&args, demo)
        }
        _ => osmc::run(&args, demo),
    }
}

fn write(path: &Path, bytes: &[u8]) -> anyhow::Result<()> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder).with_context(|| format!("cannot make the folder {}", folder.display()))?;
    }
    fs::write(path, bytes).with_context(|| format!("cannot write {}", path.display()))
}

/// Of the log as a table, which is the same for the same board and seed. `r4 log export LOG --csv - | sha256sum` prints it.
fn table_sha256(log: &Log) -> anyhow::Result<String> {
    let mut table = Vec::new();
    log.write_csv(&mut table)?;
    Ok(Sha256::digest(&table).iter().map(|byte| format!("{byte:02x}")).collect())
}
