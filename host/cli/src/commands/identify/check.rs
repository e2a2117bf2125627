//! `r4 identify check`

use std::path::{Path, PathBuf};

use anyhow::{Context, ensure};
use r4_log::{Log, MotorSample, MotorSeries};
use r4_protocol::{ChannelId, SafetyState};
use serde::Serialize;

use crate::{
    args::Args,
    commands::log,
    output,
    plants::OtherPlant,
    report::{Scale, significant},
    table,
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

/// How far the simulated board is from a recording.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Twin {
    /// Root mean square, rad or m: from where each began if it turns.
    pub(super) position_rmse: f64,
    /// Root mean square, rad/s or m/s.
    pub(super) speed_rmse: f64,
    /// Why the simulated board stopped, where it did and the recorded one did not.
    pub(super) stopped: Option<String>,
}

/// With both plants.
#[derive(Clone, Debug, Serialize)]
pub(super) struct Twins {
    pub(super) before: Twin,
    pub(super) after: Twin,
    position_unit: &'static str,
    speed_unit: &'static str,
    samples: usize,
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
        twins.print()?;
    }
    if !better {
        eprintln!("r4: the simulated board is farther from the recording with {}", check.plant_after.display());
    }
    Ok(better)
}

/// The simulated board that `args` name against a recording, with the plant as it was and as it is now.
pub(super) fn twins(
    args: &Args,
    log: &Log,
    channel: ChannelId,
    (before, after): (Option<&Path>, &Path),
) -> anyhow::Result<Twins> {
    args.board.robot()?;
    let recorded = log.motor(channel).with_context(|| {
        let motors: Vec<_> = log.motors.iter().map(|motor| motor.info.id.to_string()).collect();
        format!("the log has no samples of a motor {channel}: it has {}", list(&motors))
    })?;
    let (position_unit, speed_unit) = if recorded.is_linear() { ("m", "m/s") } else { ("rad", "rad/s") };
    let before = twin(args, log, recorded, before)?;
    let after = twin(args, log, recorded, Some(after))?;
    Ok(Twins { before, after, position_unit, speed_unit, samples: recorded.samples.len() })
}

fn list(names: &[String]) -> String {
    if names.is_empty() { "none".to_owned() } else { names.join(", ") }
}

fn twin(args: &Args, log: &Log, recorded: &MotorSeries, plant: Option<&Path>) -> anyhow::Result<Twin> {
    let channel = recorded.info.id;
    let mut plants = args.plant.clone();
    if let Some(file) = plant {
        plants.retain(|other| other.channel != Some(channel));
        plants.push(OtherPlant { channel: Some(channel), file: file.to_owned() });
    }
    let args = Args { plant: plants, blind: None, record: None, ..args.clone() };
    let (again, shift_s) = log::again(&args, log)?;
    let simulated = again.motor(channel).with_context(|| format!("the simulated board told nothing of {channel}"))?;
    let stopped = |log: &Log| log.states.iter().find(|state| state.state == SafetyState::Tripped).map(|it| it.causes);
    let stopped = stopped(&again).filter(|_| stopped(log).is_none()).map(|causes| causes.to_string());
    let rmse = |value: fn(&MotorSample) -> f64, from_start| rmse(recorded, simulated, shift_s, value, from_start);
    // An angle is counted from where power came on, which is not the same place in a simulation; a rod's place is known.
    let position_rmse = rmse(|sample| sample.position, !recorded.is_linear());
    let speed_rmse = rmse(|sample| sample.speed, false);
    let none = "the simulated board told nothing at the times of the recording";
    Ok(Twin { position_rmse: position_rmse.context(none)?, speed_rmse: speed_rmse.context(none)?, stopped })
}

/// Root mean square of what a number of two runs differs by, at the moments of the first; straight between those of the
/// second, whose times are moved by `shift_s`. `None` where they have no moment in common.
fn rmse(
    recorded: &MotorSeries,
    simulated: &MotorSeries,
    shift_s: f64,
    value: fn(&MotorSample) -> f64,
    from_start: bool,
) -> Option<f64> {
    let zero = |series: &MotorSeries| series.samples.first().map(value).filter(|_| from_start).unwrap_or(0.0);
    let (zero_recorded, zero_simulated) = (zero(recorded), zero(simulated));
    let (mut sum, mut count) = (0.0, 0.0);
    for sample in &recorded.samples {
        let at_s = sample.time_s - shift_s;
        let after = simulated.samples.partition_point(|other| other.time_s < at_s);
        let (Some(right), left) = (simulated.samples.get(after), after.saturating_sub(1)) else { continue };
        let left = &simulated.samples[left];
        let step_s = right.time_s - left.time_s;
        // Before the first there is nothing to compare with.
        if at_s < left.time_s && at_s != right.time_s {
            continue;
        }
        let share = if step_s > 0.0 { (at_s - left.time_s) / step_s } else { 1.0 };
        let there = value(left) + share * (value(right) - value(left)) - zero_simulated;
        let difference = value(sample) - zero_recorded - there;
        if difference.is_finite() {
            sum += difference * difference;
            count += 1.0;
        }
    }
    (count > 0.0).then(|| f64::sqrt(sum / count))
}

impl Twins {
    pub(super) fn print(&self) -> anyhow::Result<()> {
        let Self { before, after, position_unit, speed_unit, samples } = self;
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
}
