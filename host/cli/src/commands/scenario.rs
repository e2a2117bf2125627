//! `r4 scenario`: plays files of timed steps on virtual boards and prints the outcomes, or compares them between a
//! simulated and an emulated board.

use std::path::{Path, PathBuf};

use r4_rig::{
    Rig,
    scenario::{self, Difference, Outcome, Scenario, differences},
};
use r4_sim::Pace;
use serde::Serialize;

use crate::{
    args::{self, Args},
    output,
    session::{self, Target},
    table,
};

#[derive(Serialize)]
struct Played<'a> {
    scenario: String,
    board: String,
    #[serde(flatten)]
    outcome: &'a Outcome,
}

#[derive(Serialize)]
struct Compared {
    rows: Vec<ComparedRow>,
}

#[derive(Serialize)]
struct ComparedRow {
    scenario: String,
    robot: String,
    looks: usize,
    trips: usize,
    /// Largest difference of all checkpoints, as a share of the allowed one.
    worst_share: f64,
    differences: Vec<Difference>,
}

pub(crate) fn run(args: &Args, scenario: &args::Scenario) -> anyhow::Result<bool> {
    if scenario.compare {
        compare(args, &scenario.files)
    } else {
        play_on(args, |args| session::rig(args, Pace::Free), &scenario.files)
    }
}

/// Plays each file on `--board`, or without it on a simulated board of the file's robot.
pub(crate) fn play_on(
    args: &Args,
    rig: impl Fn(&Args) -> anyhow::Result<Rig>,
    files: &[PathBuf],
) -> anyhow::Result<bool> {
    for path in files {
        let scenario = Scenario::read(path)?;
        // The file's robot decides; `--board` only selects simulated or emulated.
        let args = Args { board: args.board.with_robot(&scenario.robot)?, ..args.clone() };
        let outcome = outcome(&args, rig(&args)?, &scenario)?;
        if args.json {
            let (scenario, board) = (name(path), args.board.to_string());
            output::json(&Played { scenario, board, outcome: &outcome })?;
            continue;
        }
        output::line(format_args!("{} on {}", name(path), args.board))?;
        let mut rows = table::new(&["s", "channel", "position", "speed", "state"], 0..1);
        for checkpoint in &outcome.checkpoints {
            for motion in &checkpoint.motions {
                rows.add_row([
                    format!("{:.3}", checkpoint.at_s),
                    motion.channel.clone(),
                    format!("{:.5} {}", motion.position, motion.unit),
                    format!("{:.4} {}/s", motion.speed, motion.unit),
                    checkpoint.state.clone(),
                ]);
            }
        }
        output::line(rows)?;
        for trip in &outcome.trips {
            output::line(format_args!("tripped: {}", trip.join(", ")))?;
        }
        for refused in &outcome.refused {
            output::line(format_args!("refused: {refused}"))?;
        }
    }
    Ok(true)
}

/// Plays each file on a simulated and an emulated board and lists the differences.
fn compare(args: &Args, files: &[PathBuf]) -> anyhow::Result<bool> {
    let mut rows = Vec::new();
    for path in files {
        let scenario = Scenario::read(path)?;
        // Only the emulated board has a firmware log.
        let log = |board: &Target| args.log.filter(|_| matches!(board, Target::Emu(_)));
        let on = |board: Target| {
            let args = Args { log: log(&board), board, ..args.clone() };
            outcome(&args, session::rig(&args, Pace::Free)?, &scenario)
        };
        let simulated = on(Target::Sim(scenario.robot.clone()))?;
        let emulated = on(Target::Emu(scenario.robot.clone()))?;
        let compared = differences(&simulated, &emulated);
        rows.push(ComparedRow {
            scenario: name(path),
            robot: scenario.robot,
            looks: simulated.checkpoints.len(),
            trips: simulated.trips.len(),
            worst_share: compared.worst_share,
            differences: compared.list,
        });
    }
    let agree = rows.iter().all(|row| row.differences.is_empty());
    if args.json {
        output::json(&Compared { rows })?;
        return Ok(agree);
    }
    let mut shown =
        table::new(&["scenario", "robot", "checkpoints", "trips", "worst, share of allowed", "differences"], 2..6);
    for row in &rows {
        shown.add_row([
            row.scenario.clone(),
            row.robot.clone(),
            row.looks.to_string(),
            row.trips.to_string(),
            format!("{:.2}", row.worst_share),
            row.differences.len().to_string(),
        ]);
    }
    output::line(shown)?;
    for row in &rows {
        for difference in &row.differences {
            output::line(format_args!("{}: {difference}", row.scenario))?;
        }
    }
    Ok(agree)
}

fn outcome(args: &Args, rig: Rig, scenario: &Scenario) -> anyhow::Result<Outcome> {
    let (outcome, _) =
        session::run_on(args, &scenario.set_up(rig), async |session| Ok(scenario::play(session, scenario).await?))?;
    Ok(outcome)
}

fn name(path: &Path) -> String {
    path.file_stem().unwrap_or(path.as_os_str()).to_string_lossy().into_owned()
}
