//! `r4 demo`: a first demonstration on a virtual robot, without any set-up.

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

/// World of the driving robots where `--world` names none.
const WORLD: &str = "square";

/// Runs the demo of the robot: a drive round a room for a skid-steer robot with a body, the set points of the OSMC
/// evaluation for all others.
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

/// SHA-256 of the log as a CSV table, the same for the same board and seed: `r4 log export LOG --csv - | sha256sum`
/// prints it too.
fn table_sha256(log: &Log) -> anyhow::Result<String> {
    let mut table = Vec::new();
    log.write_csv(&mut table)?;
    Ok(Sha256::digest(&table).iter().map(|byte| format!("{byte:02x}")).collect())
}
