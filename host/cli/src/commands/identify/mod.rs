//! `r4 identify`: fits a model to recordings and finds its unmodelled effects.

mod check;
pub(crate) mod close;
mod models;
mod print;
pub(crate) mod shown;

use std::{
    fs,
    path::{Path, PathBuf},
    time::Duration,
};

use anyhow::{Context, bail};
use clap::{Subcommand, builder::PossibleValuesParser};
use r4_boards::SimulatedBody;
use r4_identify::{
    Identified, Progress, Recordings, Task,
    family::{FittedBody, Loadable},
    report::{Explained, Report},
    task::{self, FileKind},
};
use r4_plants::PlantSpec;
use r4_protocol::ChannelId;
use serde::Serialize;

use crate::{args::Args, args::seconds, output, plants::OtherPlant, report, session};
use shown::Shown;

#[derive(Clone, Debug, clap::Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub(crate) struct Identify {
    #[command(subcommand)]
    what: Option<What>,
    #[command(flatten)]
    question: Option<Question>,
}

#[derive(Clone, Debug, Subcommand)]
enum What {
    /// List all models with their roles, parameters and effects
    Models,
    /// Excite a motor of a board, find the effects missing from its plant file, and compare the simulated board before
    /// and after
    Close(close::Close),
    /// Send the requests of a recorded run to the simulated board with two plants, and print the distance of each from
    /// the recording
    Check(check::Check),
}

impl Identify {
    /// True if it talks to a board rather than only reading recordings.
    pub(crate) fn is_on_a_board(&self) -> bool {
        matches!(self.what, Some(What::Close(_)))
    }
}

/// DIR gets report.json, report.html, and plant.toml or body.toml, which --plant or --body loads; the same `--seed`
/// gives the same bytes.
#[derive(Clone, Debug, clap::Args)]
struct Question {
    /// Recordings to fit: CSV with units in its header, or logs of `r4`; one run per file
    #[arg(required = true, value_name = "TRAIN")]
    train: Vec<PathBuf>,
    /// Held-out recordings, never fitted; or every:N to hold out every Nth run of TRAIN; example: every:2
    #[arg(long, required = true, num_args = 1.., value_name = "TEST|every:N")]
    holdout: Vec<PathBuf>,
    /// Base model; `r4 identify models` describes them
    #[arg(long, value_parser = PossibleValuesParser::new(r4_identify::models().into_iter().map(|model| model.name)))]
    model: String,
    /// Column of the model's role `input`
    #[arg(long, value_name = "COLUMN")]
    input: Option<String>,
    /// Column of the model's role `output`
    #[arg(long, value_name = "COLUMN")]
    output: Option<String>,
    /// Column of another role of the model; example: yaw=yaw_rad
    #[arg(long, num_args = 1.., value_parser = pair, value_name = "ROLE=COLUMN")]
    map: Vec<(String, String)>,
    /// Time column [default: the column named like one, as t_s, time_ms or timestamp]
    #[arg(long, value_name = "COLUMN")]
    time: Option<String>,
    /// Columns whose values separate the runs of one file
    #[arg(long, value_delimiter = ',', value_name = "COLUMN,COLUMN")]
    run: Vec<String>,
    /// Known value of a parameter; examples: supply_v=24, or counts_per_turn=4096 to convert encoder counts to angles
    #[arg(long, num_args = 1.., value_parser = known, value_name = "NAME=VALUE")]
    param: Vec<(String, f64)>,
    /// Part of a held-out recording that its initial state is fitted to; errors are over the whole recording
    #[arg(long, value_enum, default_value_t)]
    protocol: Protocol,
    /// Time after which the search for effects stops, s; the result then depends on the machine [default: no limit]
    #[arg(long, value_parser = seconds, value_name = "SECONDS", allow_negative_numbers = true)]
    budget: Option<f64>,
    /// Folder for the results
    #[arg(long, default_value = "r4-identify", value_name = "DIR")]
    out: PathBuf,
}

#[derive(Clone, Copy, Debug, Default, clap::ValueEnum)]
enum Protocol {
    /// First tenth, and at least 20 samples
    #[default]
    FirstTenth,
    /// First 20 samples, as the nonlinear benchmark on EMPS prescribes
    #[value(name = "first-20")]
    First20,
}

impl From<Protocol> for task::Protocol {
    fn from(protocol: Protocol) -> Self {
        match protocol {
            Protocol::FirstTenth => Self::FirstTenth,
            Protocol::First20 => Self::First20,
        }
    }
}

/// Parses a role and its column from `name=value`.
fn pair(text: &str) -> Result<(String, String), String> {
    match text.split_once('=') {
        Some((name, value)) if !name.is_empty() && !value.is_empty() => Ok((name.to_owned(), value.to_owned())),
        _ => Err("a role and its column with `=` between, as in yaw=yaw_rad".into()),
    }
}

fn known(text: &str) -> Result<(String, f64), String> {
    let parsed = text.split_once('=').and_then(|(name, value)| Some((name.to_owned(), value.parse::<f64>().ok()?)));
    parsed
        .filter(|(name, value)| !name.is_empty() && value.is_finite())
        .ok_or("a name and its number with `=` between, as in supply_v=24".into())
}

pub(crate) fn run(args: &Args, identify: &Identify) -> anyhow::Result<bool> {
    match (&identify.what, &identify.question) {
        (None, Some(question)) => answer(args, question),
        (Some(What::Models), _) => models::run(args),
        (Some(What::Close(close)), _) => close::run(args, close),
        (Some(What::Check(check)), _) => check::run(args, check),
        (None, None) => bail!("name recordings, or `r4 identify models`"),
    }
}

/// Report with the paths of the result files, for `--json`.
#[derive(Serialize)]
struct Written<'r> {
    #[serde(flatten)]
    report: &'r Report,
    files: [PathBuf; 3],
}

fn answer(args: &Args, question: &Question) -> anyhow::Result<bool> {
    let short = |role: &str, column: &Option<String>| column.clone().map(|column| (role.to_owned(), column));
    let named = [short("input", &question.input), short("output", &question.output)].into_iter().flatten();
    let asked = r4_identify::Question {
        train: question.train.clone(),
        holdout: question.holdout.clone(),
        model: question.model.clone(),
        columns: named.chain(question.map.iter().cloned()).collect(),
        time: question.time.clone(),
        split: question.run.clone(),
        parameters: question.param.iter().cloned().collect(),
    };
    let model = asked.model()?;
    let plant = known_plant(args)?;
    let recordings = asked.read()?;
    let notes = recordings.notes();
    for note in &notes {
        eprintln!("r4: {note}");
    }
    let Recordings { train, holdout, parameters } = recordings;

    let progress = Shown::on_stderr();
    let told = |now: Progress| progress.show(now);
    let body = if model.file == FileKind::Body { known_body(args)? } else { None };
    let wheeled = body.as_ref().and_then(SimulatedBody::wheeled).cloned();
    let task = Task {
        model: question.model.clone(),
        parameters,
        plant,
        body: wheeled,
        seed: args.seed,
        protocol: question.protocol.into(),
        budget: question.budget.map(Duration::from_secs_f64),
    };
    let found = r4_identify::identify(&task, &train.runs, &holdout.runs, notes, &told);
    progress.clear();
    let found = found?;

    let learned = match &found.loadable {
        Loadable::Plant(text) => (FileKind::Plant, text.clone()),
        Loadable::Body(fitted) => (FileKind::Body, body_file(fitted, body.map(|body| body.channels))?),
    };
    let files = write(&question.out, (&question.train, &question.holdout), args.seed, &found, &learned)?;
    if args.json {
        output::json(&Written { report: &found.report, files })?;
    } else {
        print::print(&found.report, &files)?;
    }
    // An exit code of its own: a script can distinguish this result from a failure.
    if found.report.explained == Explained::Not {
        return Err(NotExplained.into());
    }
    Ok(true)
}

/// Outcome of an identification that does not explain the recordings; the printed report contains it too.
#[derive(Debug)]
pub(crate) struct NotExplained;

impl std::fmt::Display for NotExplained {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str("the recordings are not explained")
    }
}

impl std::error::Error for NotExplained {}

/// Robot whose channels a body file uses where no robot was named.
const USUAL_ROBOT: &str = "openscout";

/// Returns the text of a body file. Without a named robot, the wheels are on the channels of [`USUAL_ROBOT`].
fn body_file(fitted: &FittedBody, channels: Option<Vec<ChannelId>>) -> anyhow::Result<String> {
    let channels = match channels {
        Some(channels) => channels,
        None => r4_boards::load(USUAL_ROBOT)?.simulation.body.map(|body| body.channels).unwrap_or_default(),
    };
    let mut comments = fitted.provenance.clone();
    for (name, place) in &fitted.left_out {
        eprintln!("r4: {name} was found and is not in the body: {place}");
        comments.push(format!("Found, but not in this file: {name}: {place}."));
    }
    Ok(SimulatedBody::wheeled_toml(&fitted.wheeled, &channels, &comments))
}

/// Writes the report as JSON and HTML and the plant or body file; returns their paths.
fn write(
    out: &Path,
    (train, holdout): (&[PathBuf], &[PathBuf]),
    seed: u64,
    found: &Identified,
    (kind, learned): &(FileKind, String),
) -> anyhow::Result<[PathBuf; 3]> {
    fs::create_dir_all(out).with_context(|| format!("cannot make the folder {}", out.display()))?;
    let files = ["report.json", "report.html", kind.name()].map(|name| out.join(name));
    let listed = |paths: &[PathBuf]| {
        let names: Vec<_> =
            paths.iter().map(|path| path.file_name().unwrap_or(path.as_os_str()).to_string_lossy()).collect();
        match &names[..] {
            [first, .., last] if names.len() > 4 => format!("{first} … {last} ({})", names.len()),
            _ => names.join(", "),
        }
    };
    let facts = [("Fitted to", listed(train)), ("Held out", listed(holdout)), ("Seed", seed.to_string())];
    let page = report::identify(&found.report, &found.figures, &facts);
    let json = serde_json::to_string_pretty(&found.report)? + "\n";
    for (path, text) in files.iter().zip([&json, &page, learned]) {
        fs::write(path, text).with_context(|| format!("cannot write {}", path.display()))?;
    }
    Ok(files)
}

/// Body that `identify` starts from: that of `--body`, or of the robot that `--board` names; `None` where neither is
/// given.
fn known_body(args: &Args) -> anyhow::Result<Option<SimulatedBody>> {
    let robot = match (&args.body, args.is_board_named) {
        (None, false) => return Ok(None),
        (None, true) if !args.board.is_virtual() => return Ok(None),
        _ => r4_boards::load(args.board.robot().context("--body holds for a simulated robot")?)?,
    };
    let Some(file) = &args.body else { return Ok(robot.simulation.body) };
    let body = r4_boards::load_body(file, &robot)?;
    session::uses_other_physics();
    Ok(Some(body))
}

/// Plant file that `identify` starts from, if one is named.
fn known_plant(args: &Args) -> anyhow::Result<Option<PlantSpec>> {
    let plant = match &args.plant[..] {
        [] => return Ok(None),
        [OtherPlant { channel: None, file }] => r4_rig::read_plant(file)?.1,
        _ => bail!("identify takes one plant file without a channel, as in --plant plant.toml"),
    };
    session::uses_other_physics();
    Ok(Some(plant))
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;

    #[derive(Parser)]
    struct Typed {
        #[command(flatten)]
        args: Args,
        #[command(flatten)]
        identify: Identify,
    }

    fn question(typed: &str) -> Option<Identify> {
        let typed = Typed::try_parse_from(["identify"].into_iter().chain(typed.split_whitespace())).ok()?;
        Some(typed.identify)
    }

    #[test]
    fn the_contract_can_be_typed() {
        let typed = "a.csv b.csv --holdout c.csv d.csv --model dc-motor --input duty --output theta_rad \
                     --time time_s --param supply_v=24 r=1.5 --map supply=u_V --run step,window --plant in.toml --out dir";
        let question = question(typed).and_then(|identify| identify.question).unwrap();
        assert_eq!(question.train, ["a.csv", "b.csv"].map(PathBuf::from));
        assert_eq!(question.holdout, ["c.csv", "d.csv"].map(PathBuf::from));
        assert_eq!(question.param, [("supply_v".to_owned(), 24.0), ("r".to_owned(), 1.5)]);
        assert_eq!(question.map, [("supply".to_owned(), "u_V".to_owned())]);
        assert_eq!(question.run, ["step", "window"]);
    }

    #[test]
    fn what_is_no_question_is_not_understood() {
        let whole = "a.csv --holdout b.csv --model dc-motor --input duty --output theta_rad";
        assert!(question(whole).is_some() && question("models").is_some());
        for wrong in ["", "a.csv", "a.csv --model dc-motor", "a.csv --holdout b.csv --model none"] {
            assert!(question(wrong).is_none(), "{wrong}");
        }
        for wrong in ["--param supply_v", "--param supply_v=x", "--param =1", "--param a=inf", "--map yaw", "--map =x"]
        {
            assert!(question(&format!("{whole} {wrong}")).is_none(), "{wrong}");
        }
    }
}
