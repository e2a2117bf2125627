//! `r4 identify check`: compares a simulated board with a recording, before and after a change of its physics.

use std::path::{Path, PathBuf};

use anyhow::{Context, bail, ensure};
use r4_log::Log;
use r4_protocol::ChannelId;
use r4_rig::{
    PlantFile,
    twin::{self, Difference, Observed, Physics, Twins},
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

/// Compare either a motor with another plant, or a signal with another body. The simulated board runs its own
/// controller, loops, limits and protections, with the recording's noise seed.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct Check {
    /// Log of a run on this board or on the real one
    #[arg(value_name = "LOG")]
    recording: PathBuf,
    /// Motor whose position and speed are compared; example: osmc0
    #[arg(long, value_name = "CHANNEL", required_unless_present = "signal", requires = "plant_after")]
    channel: Option<ChannelId>,
    /// Plant file of the motor before the change [default: that of the robot's file]
    #[arg(long, value_name = "FILE", requires = "channel")]
    plant_before: Option<PathBuf>,
    /// Plant file of the motor after the change
    #[arg(long, value_name = "FILE", requires = "channel")]
    plant_after: Option<PathBuf>,
    /// Signal that is compared; example: imu0.rate_z_rad_s
    #[arg(long, value_name = "SIGNAL", conflicts_with = "channel", requires = "body_after")]
    signal: Option<String>,
    /// Body file of the robot after the change; before it, `--body` or the robot's file holds
    #[arg(long, value_name = "FILE", requires = "signal")]
    body_after: Option<PathBuf>,
}

#[derive(Serialize)]
struct Report<'a> {
    log: &'a Path,
    board: String,
    /// Motor channel or signal name.
    observed: String,
    #[serde(flatten)]
    twins: Twins,
}

pub(super) fn run(args: &Args, check: &Check) -> anyhow::Result<bool> {
    ensure!(args.blind.is_none(), "--blind hides effects that the compared files may contain: omit it");
    let Check { recording, channel, plant_before, plant_after, signal, body_after } = check;
    let plant = |channel, path: &Path| Physics::Plant(PlantFile { channel, path: path.to_owned() });
    let (observed, before, after, file) = match (channel, plant_after, signal, body_after) {
        (&Some(channel), Some(after), ..) => {
            let before = plant_before.as_deref().map(|file| plant(channel, file));
            (Observed::Motor(channel), before, plant(channel, after), after)
        }
        (.., Some(signal), Some(after)) => {
            (Observed::Signal(signal.clone()), None, Physics::Body(after.clone()), after)
        }
        _ => bail!("name a motor and its plant with --channel and --plant-after, or --signal and --body-after"),
    };
    let log = log::read(recording)?;
    let twins = twins(args, &log, &observed, (before, after)).with_context(|| recording.display().to_string())?;
    let is_as_near = twins.is_as_near();
    if args.json {
        let observed = match observed {
            Observed::Motor(channel) => channel.to_string(),
            Observed::Signal(name) => name,
        };
        output::json(&Report { log: recording, board: args.board.to_string(), observed, twins })?;
    } else {
        print_twins(&twins)?;
    }
    if !is_as_near {
        eprintln!("r4: the simulated board is farther from the recording with {}", file.display());
    }
    Ok(is_as_near)
}

/// Compares the simulated board that `args` name with a recording, with the physics before and after the change.
pub(super) fn twins(
    args: &Args,
    log: &Log,
    observed: &Observed,
    physics: (Option<Physics>, Physics),
) -> anyhow::Result<Twins> {
    // The recording's seed gives the same noise; the hidden effects of `--blind` would falsify the comparison.
    let args = Args { blind: None, record: None, seed: log::seed(args, log), ..args.clone() };
    session::catch_interrupts();
    Ok(twin::compare(&session::rig(&args, Pace::Free)?, log, observed, physics)?)
}

/// Prints the errors of each quantity, and the ratio of the first one's.
pub(super) fn print_twins(twins: &Twins) -> anyhow::Result<()> {
    let Twins { differences, stopped_before, stopped_after, samples } = twins;
    let scales = || differences.iter().map(|of| of.unit.map(|unit| Scale::of(unit, of.rmse_after)));
    let mut heads = vec!["simulated board, RMSE".to_owned()];
    heads.extend(differences.iter().zip(scales()).map(|(of, scale)| match scale {
        Some(scale) => format!("{} ({})", of.name, scale.unit()),
        None => of.name.clone(),
    }));
    heads.push("stopped".to_owned());
    let heads: Vec<&str> = heads.iter().map(String::as_str).collect();
    let mut rows = table::new(&heads, 1..heads.len() - 1);
    let mut add = |name: &str, stopped: &Option<String>, rmse: fn(&Difference) -> f64| {
        let mut row = vec![name.to_owned()];
        row.extend(differences.iter().zip(scales()).map(|(of, scale)| match scale {
            Some(scale) => scale.text(rmse(of)),
            None => significant(rmse(of)),
        }));
        row.push(stopped.clone().unwrap_or_default());
        rows.add_row(row);
    };
    add("before", stopped_before, |of| of.rmse_before);
    add("after", stopped_after, |of| of.rmse_after);
    output::line(rows)?;
    if let Some(first) = differences.first().filter(|first| first.rmse_after > 0.0) {
        let times = significant(first.rmse_before / first.rmse_after);
        output::line(format_args!("{samples} samples; {} {times} times as near as before", first.name))?;
    }
    Ok(())
}
