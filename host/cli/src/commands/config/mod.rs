//! `r4 config`: the parameters stored on a board.

mod file;

use std::{fs, path::PathBuf, str::FromStr};

use anyhow::{Context, anyhow, bail, ensure};
use r4_driver::{Board, Clock, Error};
use r4_protocol::{ChannelId, ParameterInfo, ParameterKey, Refusal, config::MAX_NAME};
use r4_rig::ParameterUnits;
use r4_sim::Pace;
use serde::Serialize;

use crate::{
    args::Args,
    output,
    session::{self, Session, Target},
    table,
};

#[derive(Clone, Debug, clap::Subcommand)]
pub(crate) enum Config {
    /// List all parameters, or those of one channel
    Show {
        /// Channel, or `board` for parameters of no channel [default: all]
        scope: Option<Scope>,
    },
    /// Change a parameter; effective after the next restart, once saved
    Set {
        /// Key of the parameter; example: osmc0.position_kp
        #[arg(value_name = "KEY")]
        key: String,
        /// New value, in the unit that `config show` prints
        #[arg(allow_negative_numbers = true)]
        value: f32,
        /// Save to the board's flash at once
        #[arg(long)]
        save: bool,
    },
    /// Change the robot's name; effective after the next restart, once saved
    Name {
        /// New name of the robot
        name: Name,
        /// Save to the board's flash at once
        #[arg(long)]
        save: bool,
    },
    /// Save all changes to the board's flash
    Save,
    /// Restore the values built into the firmware; effective after the next restart, once saved
    Reset {
        /// Save to the board's flash at once
        #[arg(long)]
        save: bool,
    },
    /// Write all parameters to a TOML file
    Export {
        /// TOML file to write; `-` for stdout
        file: PathBuf,
    },
    /// Set all parameters of a TOML file and save them; on an error, set none
    Import {
        /// TOML file to read, as `export` writes it
        file: PathBuf,
    },
}

/// Scope of the parameters that belong to no channel.
const BOARD: &str = "board";

/// Owner of parameters: a channel, or `None` for the board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Scope(Option<ChannelId>);

impl FromStr for Scope {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.parse() {
            Ok(channel) => Ok(Self(Some(channel))),
            Err(_) if text == BOARD => Ok(Self(None)),
            Err(error) => Err(format!("{error}; or `{BOARD}`")),
        }
    }
}

/// Name of a robot, short enough to be stored on a board.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Name(String);

impl FromStr for Name {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text.len() {
            _ if text.chars().any(char::is_control) => Err("no line breaks or other control characters".to_owned()),
            1..=MAX_NAME => Ok(Self(text.to_owned())),
            _ => Err(format!("1 to {MAX_NAME} bytes")),
        }
    }
}

#[derive(Serialize)]
struct Shown {
    board: String,
    parameters: Vec<Parameter>,
}

#[derive(Serialize)]
struct Parameter {
    key: String,
    unit: String,
    active: f32,
    set: f32,
    built_in: f32,
}

impl Parameter {
    fn new(info: &ParameterInfo, units: &ParameterUnits) -> Self {
        let ParameterInfo { key, active, set, built_in } = *info;
        Self { key: key.to_string(), unit: units.unit(key), active, set, built_in }
    }
}

#[derive(Serialize)]
struct Changed {
    board: String,
    #[serde(flatten)]
    parameter: Parameter,
    saved: bool,
}

#[derive(Serialize)]
struct Renamed {
    board: String,
    robot: String,
    saved: bool,
}

#[derive(Serialize)]
struct Saved {
    board: String,
    saved: bool,
}

#[derive(Serialize)]
struct Imported {
    board: String,
    changed: Vec<Change>,
    saved: bool,
}

#[derive(Serialize)]
struct Change {
    key: String,
    from: f32,
    to: f32,
}

pub(crate) fn run(args: &Args, config: &Config) -> anyhow::Result<bool> {
    let saves = match config {
        Config::Set { save, .. } | Config::Name { save, .. } | Config::Reset { save } => *save,
        Config::Save | Config::Import { .. } => true,
        Config::Show { .. } | Config::Export { .. } => false,
    };
    // Refuse before the session: a change on a board without a flash file would be lost silently.
    if saves {
        check_keeps(args)?;
    }
    match config {
        Config::Show { scope } => show(args, *scope),
        Config::Set { key, value, save } => set(args, key, *value, *save),
        Config::Name { name, save } => rename(args, name, *save),
        Config::Save => {
            let waiting = change(args, true, async |session| {
                let parameters = session.board.parameters().await?;
                Ok(parameters.iter().filter(|info| info.set != info.active).count())
            })?;
            done(args, &format!("{waiting} parameters changed since the board's start,"), true)
        }
        Config::Reset { save } => {
            change(args, *save, async |session| Ok(session.board.reset_parameters().await?))?;
            done(args, "all parameters have their built-in values,", *save)
        }
        Config::Export { file } => export(args, file),
        Config::Import { file } => import(args, file),
    }
}

/// Refuses to save on a simulated board without a flash file, whose flash ends with the command.
pub(super) fn check_keeps(args: &Args) -> anyhow::Result<()> {
    ensure!(
        args.flash.is_some() || matches!(args.board, Target::Link(_)),
        "{} loses its parameters when the command ends: name a file for its flash with --flash FILE or R4_FLASH",
        args.board
    );
    Ok(())
}

/// Runs `work`, then saves the parameters if `save` is set.
async fn and_save<T>(
    session: &Session<'_>,
    save: bool,
    work: impl AsyncFnOnce(&Session<'_>) -> anyhow::Result<T>,
) -> anyhow::Result<T> {
    let value = work(session).await?;
    if save {
        session.board.save_parameters().await.context("cannot save")?;
    }
    Ok(value)
}

fn change<T>(args: &Args, save: bool, work: impl AsyncFnOnce(&Session<'_>) -> anyhow::Result<T>) -> anyhow::Result<T> {
    Ok(session::run(args, Pace::Free, async |session| and_save(session, save, work).await)?.0)
}

/// Note on when a change becomes effective.
fn outlook(saved: bool) -> &'static str {
    if saved { "saved: effective after the next restart" } else { "not saved: add --save" }
}

/// Warns that a simulated board loses an unsaved change when the command ends.
pub(super) fn warn_unsaved(args: &Args, saved: bool) {
    if !saved && matches!(args.board, Target::Sim(_) | Target::Emu(_)) {
        eprintln!("r4: a simulated board loses unsaved changes when the command ends: add --save and --flash FILE");
    }
}

fn done(args: &Args, what: &str, saved: bool) -> anyhow::Result<bool> {
    if args.json {
        output::json(&Saved { board: args.board.to_string(), saved })?;
    } else {
        output::line(format_args!("{what} {}", outlook(saved)))?;
    }
    warn_unsaved(args, saved);
    Ok(true)
}

fn show(args: &Args, scope: Option<Scope>) -> anyhow::Result<bool> {
    let (parameters, _) = session::run(args, Pace::Free, async |session| {
        // An unknown channel is an error; a known one without parameters prints "no parameters".
        if let Some(Scope(Some(channel))) = scope {
            session.board.channel(channel)?;
        }
        let mut parameters = session.board.parameters().await?;
        parameters.retain(|info| scope.is_none_or(|Scope(of)| info.key.channel == of));
        Ok(parameters)
    })?;
    let units = ParameterUnits::of(&parameters);
    if args.json {
        let parameters = parameters.iter().map(|info| Parameter::new(info, &units)).collect();
        output::json(&Shown { board: args.board.to_string(), parameters })?;
        return Ok(true);
    }
    if parameters.is_empty() {
        output::line("no parameters")?;
        return Ok(true);
    }
    let mut table = table::new(&["parameter", "value", "after restart", "built in", "unit"], 1..4);
    for ParameterInfo { key, active, set, built_in } in &parameters {
        // Print only values that differ from the active one, so that changes stand out.
        let unless = |value: &f32, same: &f32| if value == same { String::new() } else { shown(*value) };
        table.add_row([
            key.to_string(),
            shown(*active),
            unless(set, active),
            unless(built_in, active),
            units.unit(*key),
        ]);
    }
    output::line(table)?;
    let changed = parameters.iter().filter(|info| info.active != info.built_in).count();
    let waiting = parameters.iter().filter(|info| info.set != info.active).count();
    output::line(format_args!(
        "{} parameters, {changed} not at the built-in value, {waiting} to change at the next restart",
        parameters.len()
    ))?;
    Ok(true)
}

/// Formats a value with the fewest digits that identify it.
fn shown(value: f32) -> String {
    let magnitude = value.abs();
    if magnitude == 0.0 || (1e-4..1e7).contains(&magnitude) { value.to_string() } else { format!("{value:e}") }
}

fn set(args: &Args, key: &str, value: f32, save: bool) -> anyhow::Result<bool> {
    let (info, units) = change(args, save, async |session| {
        let parameters = session.board.parameters().await?;
        // Look the key up first: the board would only refuse it, without naming the nearest one.
        let known = find(&parameters, key).ok_or_else(|| anyhow!("{}", unknown(&parameters, key)))?;
        session.board.set_parameter(known.key, value).await?;
        Ok((ParameterInfo { set: value, ..*known }, ParameterUnits::of(&parameters)))
    })?;
    if args.json {
        let parameter = Parameter::new(&info, &units);
        output::json(&Changed { board: args.board.to_string(), parameter, saved: save })?;
    } else {
        output::line(format_args!("{key} {} -> {}, {}", shown(info.active), shown(value), outlook(save)))?;
    }
    warn_unsaved(args, save);
    Ok(true)
}

fn rename(args: &Args, Name(robot): &Name, save: bool) -> anyhow::Result<bool> {
    let before = change(args, save, async |session| {
        session.board.set_name(robot).await?;
        Ok(session.board.info().robot.to_string())
    })?;
    if args.json {
        output::json(&Renamed { board: args.board.to_string(), robot: robot.clone(), saved: save })?;
    } else {
        output::line(format_args!("robot {before} -> {robot}, {}", outlook(save)))?;
    }
    warn_unsaved(args, save);
    Ok(true)
}

fn find<'p>(parameters: &'p [ParameterInfo], key: &str) -> Option<&'p ParameterInfo> {
    parameters.iter().find(|info| info.key.to_string() == key)
}

/// Error text for an unknown key, with the nearest known one.
fn unknown(parameters: &[ParameterInfo], key: &str) -> String {
    let keys = parameters.iter().map(|info| info.key.to_string());
    let nearest = keys.min_by_key(|known| strsim::damerau_levenshtein(known, key));
    let nearest = nearest.map_or(String::new(), |nearest| format!(", nearest is {nearest}"));
    format!("the board has no parameter {key}{nearest}: `r4 config show` lists those it has")
}

fn export(args: &Args, file: &std::path::Path) -> anyhow::Result<bool> {
    let (text, _) = session::run(args, Pace::Free, async |session| {
        let info = session.board.info();
        let title = format!("Parameters of {} ({}), firmware {}.", info.robot, args.board, info.firmware);
        Ok(file::write(&title, &session.board.parameters().await?))
    })?;
    if file.as_os_str() == "-" {
        output::line(text.trim_end())?;
        return Ok(true);
    }
    fs::write(file, text).with_context(|| format!("cannot write {}", file.display()))?;
    if args.json {
        output::json(&serde_json::json!({ "board": args.board.to_string(), "file": file }))?;
    } else {
        output::line(format_args!("wrote {}", file.display()))?;
    }
    Ok(true)
}

fn import(args: &Args, path: &std::path::Path) -> anyhow::Result<bool> {
    let text = fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    let entries = file::read(&text).map_err(|error| anyhow!("{}:{error}", path.display()))?;
    let (changed, _) = session::run(args, Pace::Free, async |session| {
        let parameters = session.board.parameters().await?;
        let mut changes = Vec::new();
        for entry in &entries {
            let place = format!("{}:{}", path.display(), entry.line);
            let Some(info) = find(&parameters, &entry.key) else {
                bail!("{place}: {}", unknown(&parameters, &entry.key));
            };
            if info.set != entry.value {
                changes.push((place, ParameterInfo { set: entry.value, ..*info }, info.set));
            }
        }
        // Set all parameters before saving, so that the file takes effect completely or not at all.
        let wanted: Vec<_> = changes.iter().map(|(_, info, _)| (info.key, info.set)).collect();
        let (place, error) = match set_all(session.board, &wanted).await {
            Ok(None) => {
                let unsure = "cannot save; after a restart `r4 config show` prints the effective values";
                session.board.save_parameters().await.context(unsure)?;
                return Ok(changes);
            }
            Ok(Some((index, error))) => (changes[index].0.clone(), error),
            Err(error) => (path.display().to_string(), error),
        };
        // Roll back to the values before this command.
        let before: Vec<_> = changes.iter().map(|(_, info, before)| (info.key, *before)).collect();
        match set_all(session.board, &before).await {
            Ok(None) => bail!("{place}: {error}; nothing was changed"),
            _ => bail!("{place}: {error}; the values set before it are not saved: restart the board to discard them"),
        }
    })?;
    let changed = changed.into_iter().map(|(_, info, from)| Change { key: info.key.to_string(), from, to: info.set });
    let changed: Vec<Change> = changed.collect();
    if args.json {
        output::json(&Imported { board: args.board.to_string(), changed, saved: true })?;
        return Ok(true);
    }
    for Change { key, from, to } in &changed {
        output::line(format_args!("{key} {} -> {}", shown(*from), shown(*to)))?;
    }
    output::line(format_args!("{} of {} parameters changed; {}", changed.len(), entries.len(), outlook(true)))?;
    Ok(true)
}

/// Sets all of `values`, retrying refused ones after the others: moving a range may need its upper end changed first,
/// or its lower. Returns the first value that the board refuses in every order, and the refusal.
async fn set_all<C: Clock>(board: &Board<C>, values: &[(ParameterKey, f32)]) -> Result<Option<(usize, Error)>, Error> {
    let mut left: Vec<usize> = (0..values.len()).collect();
    loop {
        let (before, mut refused) = (left.len(), None);
        let mut still = Vec::new();
        for index in left {
            let (key, value) = values[index];
            match board.set_parameter(key, value).await {
                Ok(()) => {}
                Err(error @ Error::Refused(Refusal::BadParameter { .. })) => {
                    still.push(index);
                    refused.get_or_insert((index, error));
                }
                Err(error) => return Err(error),
            }
        }
        // A pass without progress means that no order helps.
        if still.is_empty() || still.len() == before {
            return Ok(refused);
        }
        left = still;
    }
}
