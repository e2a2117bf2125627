//! `r4 identify close`: from a board to a better plant file, and what it is worth.

use std::{fs, path::PathBuf, pin::pin};

use anyhow::{Context, bail, ensure};
use futures::future::{Either, select};
use indicatif::ProgressBar;
use r4_driver::Error;
use r4_identify::{
    Identified, Progress, Task,
    data::{self, Mapping, Options, Recorded},
    family::Loadable,
    report::Report,
    task::FileKind,
};
use r4_log::Log;
use r4_plants::{Effect, PlantKind, PlantSpec};
use r4_protocol::{
    Cause, ChannelId, ChannelInfo, ChannelKind, Mode, Parameter, ParameterInfo, SafetyState, Sample, Setpoint,
};
use r4_sim::Pace;
use serde::Serialize;

use super::{
    bar,
    check::{Twins, twins},
    excite::{Plan, TRAIN},
    print, show, write,
};
use crate::{
    args::{Args, seconds},
    output,
    session::{self, Session, Target},
};

/// The motor must be free to move. DIR gets train-1.mcap, train-2.mcap, fresh.mcap, report.json, report.html and plant.toml.
#[derive(Clone, Debug, clap::Args)]
pub(super) struct Close {
    /// The motor, as in osmc0; it must be free to move both ways
    #[arg(long, value_name = "CHANNEL")]
    channel: ChannelId,
    /// Folder for the recordings and results
    #[arg(long, default_value = "r4-identify", value_name = "DIR")]
    out: PathBuf,
    /// What is known of the motor [default: the plant file of the robot]
    #[arg(long, value_name = "FILE")]
    plant_before: Option<PathBuf>,
    /// Robot whose simulated board is the twin: a name or a file [default: the board's own]
    #[arg(long, value_name = "ROBOT")]
    twin: Option<String>,
    /// Largest duty [default: just below what the board allows]
    #[arg(long, value_name = "SHARE")]
    duty: Option<f64>,
    /// How long each of the three recordings is, s
    #[arg(long = "for", default_value = "12", value_parser = seconds, value_name = "SECONDS", allow_negative_numbers = true)]
    seconds: f64,
}

/// How often the motor is looked at, ms.
const LOOK_EVERY_MS: u16 = 5;
/// How often a duty that changes all the time is told to the board, s.
const TELL_EVERY_S: f64 = 0.02;
/// Telemetry may be silent for this long, s.
const SILENT_S: f64 = 0.3;
/// Of what the board allows: it is not to be limited by rounding.
const BELOW_LIMIT: f64 = 0.98;
/// A motor that does not move at the duty that counts as a stall is let go after this share of the time to a trip.
const PATIENCE: f64 = 0.6;
/// The same after a trip, and how often a recording is begun again.
const LESS_PATIENCE: f64 = 0.5;
const ATTEMPTS: usize = 4;
/// Of the range, at either end: a motor there is sent the other way.
const MARGIN: f64 = 0.15;
/// Shorter recordings tell nothing of what is slow.
const SHORTEST_S: f64 = 4.0;

/// What the board says of the motor, SI.
#[derive(Clone, Copy, Debug)]
struct Limits {
    duty_max: f64,
    static_duty: f64,
    stall_duty: f64,
    stall_travel: f64,
    stall_s: f64,
    range: (f64, f64),
    resolution: f64,
}

impl Limits {
    fn new(info: &ChannelInfo, parameters: &[ParameterInfo]) -> anyhow::Result<Self> {
        let channel = info.id;
        let number = |parameter: Parameter| {
            let of = |info: &&ParameterInfo| info.key.channel == Some(channel) && info.key.parameter == parameter;
            let found = parameters.iter().find(of).map(|info| f64::from(info.active));
            found.with_context(|| format!("the board does not tell {} of {channel}", parameter.name()))
        };
        Ok(Self {
            duty_max: number(Parameter::DutyMax)?,
            static_duty: number(Parameter::StaticDuty)?,
            stall_duty: number(Parameter::StallDuty)?,
            stall_travel: number(Parameter::StallTravel)?,
            stall_s: number(Parameter::StallTimeMs)? * 1e-3,
            range: (number(Parameter::PositionMin)?, number(Parameter::PositionMax)?),
            resolution: info.resolution.into(),
        })
    }
}

/// The telemetry has stopped.
#[derive(Debug, thiserror::Error)]
#[error("no telemetry of {channel} for {SILENT_S} s")]
struct Silent {
    channel: ChannelId,
}

/// What `--json` tells.
#[derive(Serialize)]
struct Closed<'r> {
    board: String,
    twin_board: String,
    channel: String,
    #[serde(flatten)]
    report: &'r Report,
    /// Effects that the plant had before.
    declared: Vec<&'static str>,
    recordings: Vec<PathBuf>,
    files: [PathBuf; 3],
    /// The simulated board against the fresh recording.
    twin: Twins,
}

pub(super) fn run(args: &Args, close: &Close) -> anyhow::Result<bool> {
    let channel = close.channel;
    ensure!(
        close.seconds >= SHORTEST_S,
        "recordings of less than {SHORTEST_S} s tell too little: allow more with --for"
    );
    ensure!(
        close.duty.is_none_or(|duty| duty > 0.0 && duty <= 1.0),
        "--duty takes a share of the supply above 0 and up to 1"
    );
    ensure!(args.record.is_none(), "this makes three recordings, in {}: leave --record out", close.out.display());
    let twin_args = twin(args, close.twin.as_deref())?;
    let (declared, supply_v) = declared(&twin_args, close)?;
    fs::create_dir_all(&close.out).with_context(|| format!("cannot make the folder {}", close.out.display()))?;

    let progress = bar();
    let recordings = record(args, close, &progress)?;
    progress.set_message("reading the recordings");
    let (fitted, fresh) = recordings.split_at(TRAIN);
    let found = found(args, close, (&declared, supply_v), (fitted, fresh), &progress)?;
    let learned = (FileKind::Plant, found.loadable.plant().unwrap_or_default().to_owned());
    let files = write(&close.out, (fitted, fresh), args.seed, &found, &learned)?;
    let before = match &close.plant_before {
        Some(file) => file.clone(),
        None => {
            let file = close.out.join("plant-before.toml");
            fs::write(&file, declared.to_toml()).with_context(|| format!("cannot write {}", file.display()))?;
            file
        }
    };
    progress.set_message("the simulated board, before and after");
    let twin = twins(&twin_args, &Log::read(&fresh[0])?, channel, (Some(&before), &files[2]));
    progress.finish_and_clear();
    let twin = twin.with_context(|| format!("cannot compare the simulated board on {}", fresh[0].display()))?;

    let declared: Vec<&str> = declared.effects().iter().map(|effect| effect.name()).collect();
    let better = twin.after.position_rmse <= twin.before.position_rmse;
    if args.json {
        output::json(&Closed {
            board: args.board.to_string(),
            twin_board: twin_args.board.to_string(),
            channel: channel.to_string(),
            report: &found.report,
            declared,
            recordings: recordings.clone(),
            files,
            twin,
        })?;
    } else {
        print::print(&found.report, &files)?;
        if !declared.is_empty() {
            output::line(format_args!("the plant file had {} before", declared.join(", ")))?;
        }
        twin.print()?;
    }
    if !better {
        eprintln!("r4: the simulated board is no nearer to the fresh recording: keep the plant file that you had");
    }
    Ok(better)
}

/// The same arguments for the simulated board that is to be like `--board`.
fn twin(args: &Args, robot: Option<&str>) -> anyhow::Result<Args> {
    let board = match (robot, &args.board) {
        (Some(robot), _) => Target::Sim(robot.to_owned()),
        (None, Target::Sim(robot) | Target::Emu(robot)) => Target::Sim(robot.clone()),
        (None, Target::Link(_)) => {
            let (robot, _) =
                session::run(args, Pace::Free, async |session| Ok(session.board.info().robot.to_string()))?;
            Target::Sim(robot)
        }
    };
    // The board may have other physics than its file says; the twin must not know them.
    Ok(Args { board, blind: None, plant: Vec::new(), ..args.clone() })
}

/// The plant as it was, and the voltage of its supply.
fn declared(twin: &Args, close: &Close) -> anyhow::Result<(PlantSpec, f64)> {
    let name = twin.board.robot()?;
    let robot = r4_boards::load(name).with_context(|| {
        format!("there is no simulated board of {name} to compare with: name a robot or its file with --twin")
    })?;
    let motors = r4_sim::plants(&robot)?;
    let names: Vec<_> = motors.iter().map(|motor| motor.channel.to_string()).collect();
    let motor = motors.into_iter().find(|motor| motor.channel == close.channel);
    let motor = motor
        .with_context(|| format!("{name} has no simulated motor {}: it has {}", close.channel, names.join(", ")))?;
    let spec = close.plant_before.as_deref().map(r4_rig::read_plant).transpose()?.map_or(motor.spec, |(_, spec)| spec);
    Ok((spec, motor.supply_v))
}

/// Makes all recordings; their files.
fn record(args: &Args, close: &Close, progress: &ProgressBar) -> anyhow::Result<Vec<PathBuf>> {
    let mut files = Vec::new();
    let mut patience = PATIENCE;
    let mut attempts = 0;
    while files.len() <= TRAIN {
        let index = files.len();
        let name = if index < TRAIN { format!("train-{}.mcap", index + 1) } else { "fresh.mcap".to_owned() };
        show(progress, Progress { step: format!("recording {name}"), share: 0.0 });
        let (excited, bytes) = session::in_memory(args, Pace::Free, async |session| {
            excite(session, close, index, patience, progress).await
        });
        attempts += 1;
        match excited {
            Ok(_) => {}
            Err(error) if is_stall(&error) && attempts < ATTEMPTS => {
                eprintln!("r4: {} stalled: cleared, and again with less of that", close.channel);
                patience *= LESS_PATIENCE;
                continue;
            }
            Err(error) => return Err(error.context(format!("cannot record {name}"))),
        }
        let file = close.out.join(name);
        fs::write(&file, &bytes).with_context(|| format!("cannot write {}", file.display()))?;
        files.push(file);
    }
    Ok(files)
}

fn is_stall(error: &anyhow::Error) -> bool {
    matches!(session::driver_error(error), Some(Error::Stopped { causes }) if causes.contains(Cause::Stalled))
}

/// One recording: arms, excites, disarms; a stall is cleared.
async fn excite(
    session: &Session<'_>,
    close: &Close,
    index: usize,
    patience: f64,
    progress: &ProgressBar,
) -> anyhow::Result<()> {
    let (board, channel) = (session.board, close.channel);
    let info = board.channel(channel)?;
    let moves = matches!(channel.kind, ChannelKind::Osmc | ChannelKind::Actuator | ChannelKind::Dhb);
    ensure!(
        moves && info.mode(Mode::Duty).is_some() && info.mode(Mode::Position).is_some(),
        "{channel} cannot be excited: a motor with an encoder or a potentiometer can"
    );
    let limits = Limits::new(info, &board.parameters().await?)?;
    let cap = match close.duty {
        Some(duty) if duty > limits.duty_max => {
            bail!("{channel} takes a duty up to {:.3}: give --duty that or less", limits.duty_max)
        }
        Some(duty) => duty,
        None => BELOW_LIMIT * limits.duty_max,
    };
    ensure!(
        cap > limits.static_duty,
        "duty {cap:.3} is no more than what friction takes of {channel} ({:.3}): allow more with --duty",
        limits.static_duty
    );
    let plan = Plan::new(index, close.seconds, limits.static_duty, cap);
    let driven = session.armed(async || drive(session, channel, &plan, &limits, patience, progress).await).await;
    if driven.as_ref().is_err_and(is_stall) {
        board.clear().await.context("cannot clear the stall")?;
    }
    driven
}

/// Tells the board the duties of `plan`, and keeps the motor within its range and from stalling.
async fn drive(
    session: &Session<'_>,
    channel: ChannelId,
    plan: &Plan,
    limits: &Limits,
    patience: f64,
    progress: &ProgressBar,
) -> anyhow::Result<()> {
    let board = session.board;
    let mut telemetry = board.telemetry();
    board.subscribe(channel, LOOK_EVERY_MS).await?;
    let (low, high) = limits.range;
    let inside = (low + MARGIN * (high - low), high - MARGIN * (high - low));
    let mut guard = Guard::new(limits, patience);
    // A motor that begins at one end of its range is sent away from it first.
    let mut direction = 1.0;
    let (mut begin_s, mut told, mut told_s) = (None, None, f64::NEG_INFINITY);
    let mut armed = false;
    loop {
        let frame = match select(pin!(telemetry.next()), pin!(board.sleep_s(SILENT_S))).await {
            Either::Left((frame, _)) => frame?,
            Either::Right(_) => return Err(Silent { channel }.into()),
        };
        // Under way since before it was armed.
        if !armed && frame.state == SafetyState::Disarmed {
            continue;
        }
        armed = true;
        if frame.state != SafetyState::Armed {
            return Err(Error::Stopped { causes: frame.causes }.into());
        }
        let found = frame.samples.iter().find_map(|sample| match *sample {
            Sample::Motor { channel: of, position, .. } if of == channel => Some(position),
            _ => None,
        });
        let Some(position) = found.map(|counts| f64::from(counts) * limits.resolution) else { continue };
        let now_s = frame.device_us as f64 * 1e-6;
        let after_s = now_s - *begin_s.get_or_insert(now_s);
        let Some((part, planned)) = plan.at(after_s) else { return Ok(()) };
        let mut duty = direction * planned;
        if position > inside.1 && duty > 0.0 || position < inside.0 && duty < 0.0 {
            direction = -direction;
            duty = -duty;
        }
        if guard.is_stuck(now_s, part, position, told.unwrap_or(0.0)) {
            duty = 0.0;
        }
        let due = now_s - told_s >= TELL_EVERY_S || duty == 0.0;
        if told != Some(duty) && due {
            board.set(channel, Setpoint { mode: Mode::Duty, value: duty as f32 }).await?;
            (told, told_s) = (Some(duty), now_s);
            progress.set_position((after_s / plan.length_s() * 1_000.0) as u64);
        }
    }
}

/// Lets a motor go before the board takes it for stalled.
struct Guard {
    stall_duty: f64,
    travel: f64,
    patience_s: f64,
    /// Where it was last seen to move, and when.
    moved: Option<(f64, f64)>,
    /// The part of the plan in which it does not.
    stuck_in: Option<usize>,
}

impl Guard {
    fn new(limits: &Limits, patience: f64) -> Self {
        Self {
            stall_duty: limits.stall_duty,
            travel: limits.stall_travel,
            patience_s: patience * limits.stall_s,
            moved: None,
            stuck_in: None,
        }
    }

    /// Whether it is to be left alone for the rest of this part of the plan.
    fn is_stuck(&mut self, now_s: f64, part: usize, position: f64, duty: f64) -> bool {
        let (from, since_s) = *self.moved.get_or_insert((position, now_s));
        if duty.abs() < self.stall_duty || (position - from).abs() >= self.travel {
            self.moved = Some((position, now_s));
        } else if now_s - since_s > self.patience_s {
            self.stuck_in = Some(part);
        }
        self.stuck_in == Some(part)
    }
}

/// What is found in the recordings.
fn found(
    args: &Args,
    close: &Close,
    (declared, supply_v): (&PlantSpec, f64),
    (fitted, fresh): (&[PathBuf], &[PathBuf]),
    progress: &ProgressBar,
) -> anyhow::Result<Identified> {
    let channel = close.channel;
    let (model, position) = match declared.kind() {
        PlantKind::Rotary => ("dc-motor", "position_rad"),
        PlantKind::Linear => ("linear-actuator", "position_m"),
    };
    let options = Options {
        roles: vec![
            Mapping::driving("input", &format!("{channel}.duty")),
            Mapping::measured("output", &format!("{channel}.{position}")),
        ],
        ..Options::default()
    };
    let read = |files: &[PathBuf]| -> anyhow::Result<Recorded> { Ok(data::read(files, &options)?) };
    let (mut train, mut holdout) = (read(fitted)?, read(fresh)?);
    let mut notes: Vec<String> = train.notes.iter().chain(&holdout.notes).map(ToString::to_string).collect();
    let known: Vec<Effect> = declared.effects().iter().map_while(|effect| at_once(effect).map(|_| *effect)).collect();
    if !known.is_empty() {
        let names: Vec<_> = known.iter().map(|effect| effect.name()).collect();
        notes.push(format!("the input is the duty behind what the plant file has of the bridge: {}", names.join(", ")));
    }
    for run in train.runs.iter_mut().chain(&mut holdout.runs) {
        let duties = run.signals.get_mut("input").into_iter().flat_map(|signal| &mut signal.values);
        duties.for_each(|duty| {
            *duty = known.iter().fold(*duty, |duty, effect| at_once(effect).map_or(duty, |of| of(duty)))
        });
    }
    let parameters = [("supply_v".to_owned(), supply_v)].into_iter().filter(|(_, volts)| *volts > 0.0).collect();
    let task =
        Task { model: model.to_owned(), parameters, plant: Some(declared.clone()), seed: args.seed, ..Task::default() };
    let told = |now: Progress| show(progress, now);
    let mut found = r4_identify::identify(&task, &train.runs, &holdout.runs, notes, &told)?;
    if !known.is_empty() {
        // Models of a motor make plants.
        found.loadable = Loadable::Plant(behind(known, found.loadable.plant().unwrap_or_default())?);
    }
    Ok(found)
}

/// What an effect of the bridge makes of a duty, if that takes neither time nor anything but the duty.
fn at_once(effect: &Effect) -> Option<Box<dyn Fn(f64) -> f64 + '_>> {
    match effect {
        Effect::DeadZone(zone) => Some(Box::new(|duty| zone.apply(duty))),
        Effect::GainCurve(curve) => Some(Box::new(|duty| curve.apply(duty))),
        Effect::Saturation(saturation) => Some(Box::new(|duty| saturation.apply(duty))),
        _ => None,
    }
}

/// The plant file of what was found behind effects that were known.
fn behind(known: Vec<Effect>, found: &str) -> anyhow::Result<String> {
    let spec = PlantSpec::from_toml("plant.toml", found).with_context(|| {
        let told: Vec<_> = found.lines().filter_map(|line| line.strip_prefix("# ")).collect();
        format!("no plant file can hold what was found, so nothing can be compared: {}", told.join(" "))
    })?;
    let effects = known.into_iter().chain(spec.effects().iter().copied()).collect();
    let mut all = PlantSpec::new(*spec.model(), spec.source(), effects)?;
    spec.tables().iter().for_each(|table| all.push_table(table.clone()));
    // What the file cannot hold is told in its first lines.
    let comments = found.lines().take_while(|line| line.starts_with('#'));
    Ok(comments.chain([all.to_toml().as_str()]).collect::<Vec<_>>().join("\n"))
}
