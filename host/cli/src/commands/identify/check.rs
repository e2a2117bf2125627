//! `r4 identify check`

use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use r4_log::Log;
use r4_protocol::ChannelId;
use r4_rig::{
    PlantFile,
    twin::{self, Twins},
};
use r4_sim::Pace;
use serde::Serialize;

use crate::{
    args::Args,
    commands::log,
    output,
    report::{Scale, significant},
    session, table,
};

/// The board is simulated; its controller, loops, limits and protections are in it, and its noise is that of the recording.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct Check {
    /// The log of a run, of this board or of the real one
    #[arg(value_name = "LOG")]
    pub(super) recording: PathBuf,
    /// The motor
    #[arg(long, value_name = "CHANNEL")]
    pub(super) channel: ChannelId,
    /// The plant as it was [default: that of the robot's file]
    #[arg(long, value_name = "FILE")]
    pub(super) plant_before: Option<PathBuf>,
    /// The plant as it is now
    #[arg(long, value_name = "FILE")]
    pub(super) plant_after: PathBuf,
}

#[derive(Serialize)]
struct Report<'a> {
    log: &'a Path,
    board: String,
    channel: String,
    #[serde(flatten)]
    twins: Twins,
}

pub(super) fn run(args: &Args, check: &Check) -> anyhow::Result<bool> {
    ensure!(args.blind.is_none(), "--blind hides what the plants to compare are to tell: leave it out");
    let log = log::read(&check.recording)?;
    let twins = twins(args, &log, check.channel, (check.plant_before.as_deref(), &check.plant_after))
        .with_context(|| check.recording.display().to_string())?;
    let better = twins.after.position_rmse <= twins.before.position_rmse;
    if args.json {
        let (board, channel) = (args.board.to_string(), check.channel.to_string());
        output::json(&Report { log: &check.recording, board, channel, twins })?;
    } else {
        print_twins(&twins)?;
    }
    if !better {
        eprintln!("r4: the simulated board is farther from the recording with {}", check.plant_after.display());
    }
    Ok(better)
}

/// Compares the simulated board that `args` name with a recording, with the plant as it was and as it is now.
pub(super) fn twins(
    args: &Args,
    log: &Log,
    channel: ChannelId,
    (before, after): (Option<&Path>, &Path),
) -> anyhow::Result<Twins> {
    let args = Args { blind: None, record: None, seed: log::seed(args, log), ..args.clone() };
    let plant = |file: &Path| PlantFile { channel, path: file.to_owned() };
    session::catch_interrupts();
    Ok(twin::compare(&session::rig(&args, Pace::Free)?, log, channel, (before.map(plant), plant(after)))?)
}

/// Prints both errors and their ratio.
pub(super) fn print_twins(twins: &Twins) -> anyhow::Result<()> {
    let Twins { before, after, position_unit, speed_unit, samples } = twins;
    let position = Scale::of(position_unit, after.position_rmse);
    let speed = Scale::of(speed_unit, after.speed_rmse);
    let of_position = format!("position ({})", position.unit());
    let of_speed = format!("speed ({})", speed.unit());
    let mut rows = table::new(&["simulated board, RMSE", &of_position, &of_speed, "stopped"], 1..3);
    for (name, twin) in [("plant before", before), ("plant after", after)] {
        rows.add_row([
            name.to_owned(),
            position.text(twin.position_rmse),
            speed.text(twin.speed_rmse),
            twin.stopped.clone().unwrap_or_default(),
        ]);
    }
    output::line(rows)?;
    if after.position_rmse > 0.0 {
        let times = significant(before.position_rmse / after.position_rmse);
        output::line(format_args!("{samples} samples; position {times} times as near as before"))?;
    }
    Ok(())
}
