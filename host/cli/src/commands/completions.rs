//! `r4 completions`, and the answers to a shell at each Tab.
//!
//! The shell runs the program with the unfinished line. The program opens no board then, since a board may be busy or
//! slow: channels of a virtual board come from its robot's file, those of any other board from the cache of [channels
//! last seen](crate::known).

use std::{env, ffi::OsStr, path::Path};

use clap::Arg;
use clap_complete::{
    ArgValueCompleter, CompleteEnv, CompletionCandidate, PathCompleter, Shell,
    engine::ValueCompleter,
    env::{Elvish, EnvCompleter, Fish, Powershell, Zsh},
};
use r4_links::ports::{self, Port};
use r4_protocol::{ChannelId, ChannelKind};

use super::config::Scope;
use crate::{known, output, session::Target};

#[derive(Clone, Debug, clap::Args)]
pub(crate) struct Completions {
    /// Shell to write the completion script for
    pub(crate) shell: Shell,
}

/// Environment variable that the shells' scripts set to request completions.
const VARIABLE: &str = "R4_COMPLETE";

/// Completion script for bash. bash splits words at `:` and `=`, which occur inside the names of boards.
const BASH: &str = r#"_r4() {
    local IFS=$'\013' words candidates
    local line="${COMP_LINE:0:COMP_POINT}"
    IFS=$' \t\n' read -ra words <<< "$line"
    [[ -z "$line" || "$line" == *[[:space:]] ]] && words+=("")
    local last="${words[${#words[@]}-1]}"
    candidates=( $(_CLAP_IFS="$IFS" _CLAP_COMPLETE_INDEX=$((${#words[@]} - 1)) \
        VARIABLE=bash r4 -- "${words[@]}" 2> /dev/null) ) || candidates=()
    # Options are for who has typed a dash, or where there is nothing else.
    if [[ "$last" != -* ]]; then
        local candidate words=()
        for candidate in "${candidates[@]}"; do
            [[ "$candidate" == -* ]] || words+=("$candidate")
        done
        [[ ${#words[@]} -eq 0 ]] || candidates=("${words[@]}")
    fi
    # What stands before the last of them stays.
    local kept="${last%"${last##*[:=]}"}"
    COMPREPLY=( "${candidates[@]#"$kept"}" )
    if [[ ${#COMPREPLY[@]} -eq 1 && "${COMPREPLY[0]}" =~ [=/:]$ ]]; then
        compopt -o nospace 2> /dev/null
    fi
}
complete -o bashdefault -F _r4 r4
"#;

pub(crate) fn run(completions: &Completions) -> anyhow::Result<bool> {
    let mut script = Vec::new();
    let shell: &dyn EnvCompleter = match completions.shell {
        Shell::Bash => {
            output::bytes(BASH.replace("VARIABLE", VARIABLE).as_bytes())?;
            return Ok(true);
        }
        Shell::Elvish => &Elvish,
        Shell::Fish => &Fish,
        Shell::PowerShell => &Powershell,
        Shell::Zsh => &Zsh,
        other => anyhow::bail!("{other} cannot be completed"),
    };
    shell.write_registration(VARIABLE, "r4", "r4", "r4", &mut script)?;
    output::bytes(&script)?;
    Ok(true)
}

/// Answers a shell's request for completions and ends the program; returns if there is no request.
pub(crate) fn answer(typed: fn() -> clap::Command) {
    CompleteEnv::with_factory(|| completed(typed(), "")).var(VARIABLE).complete();
}

/// Adds a completer to each argument of `command` and its subcommands whose type has one.
fn completed(command: clap::Command, name: &str) -> clap::Command {
    use std::any::TypeId;
    let kinds = kinds_of(name);
    let with_completer = |arg: Arg| {
        let of = arg.get_value_parser().type_id();
        if of == TypeId::of::<ChannelId>() || of == TypeId::of::<Scope>() {
            arg.add(ArgValueCompleter::new(move |typed: &OsStr| channels(typed, kinds)))
        } else if of == TypeId::of::<Target>() {
            arg.add(ArgValueCompleter::new(boards))
        } else {
            arg
        }
    };
    command.mut_args(with_completer).mut_subcommands(|sub| {
        let name = sub.get_name().to_owned();
        completed(sub, &name)
    })
}

/// Channel kinds that a verb accepts; empty for all kinds.
fn kinds_of(verb: &str) -> &'static [ChannelKind] {
    use ChannelKind::{Actuator, Bldc, Dac, Dhb, Osmc, Relay, Servo, Stepper};
    match verb {
        "move" | "speed" | "duty" | "home" | "tune" => &[Osmc, Actuator, Dhb, Stepper],
        "step" => &[Stepper],
        "relay" => &[Relay],
        "servo" => &[Servo],
        "bldc" => &[Bldc],
        "dac" => &[Dac],
        _ => &[],
    }
}

fn channels(typed: &OsStr, kinds: &[ChannelKind]) -> Vec<CompletionCandidate> {
    let typed = typed.to_string_lossy();
    let all = board_of(env::args().skip(1)).map_or_else(Vec::new, |board| channels_of(&board));
    let wanted = all.into_iter().filter(|id| kinds.is_empty() || kinds.contains(&id.kind));
    wanted.map(|id| id.to_string()).filter(|id| id.starts_with(&*typed)).map(CompletionCandidate::new).collect()
}

/// Board that an unfinished command line names, or `R4_BOARD`, or the default board.
fn board_of(line: impl Iterator<Item = String>) -> Option<Target> {
    let line: Vec<String> = line.collect();
    // clap accepts `--board X` and `--board=X`; of several, take the last one.
    let named = line.iter().enumerate().rev().find_map(|(at, word)| match word.strip_prefix("--board=") {
        Some(board) => Some(board.to_owned()),
        None => (word == "--board").then(|| line.get(at + 1).cloned()).flatten(),
    });
    let named = named.or_else(|| env::var("R4_BOARD").ok());
    named.unwrap_or_else(|| "sim:osmc-bench".to_owned()).parse().ok()
}

fn channels_of(board: &Target) -> Vec<ChannelId> {
    match board {
        Target::Sim(robot) | Target::Emu(robot) => r4_boards::load(robot)
            .map_or_else(|_| Vec::new(), |robot| robot.config.channels().map(|(id, _)| id).collect()),
        Target::Link(address) => known::channels(address),
    }
}

fn boards(typed: &OsStr) -> Vec<CompletionCandidate> {
    let typed = typed.to_string_lossy();
    let robots = r4_boards::names().flat_map(|name| [format!("sim:{name}"), format!("emu:{name}")]);
    let found = ports::list().unwrap_or_default().into_iter().filter(Port::is_board);
    let real = found.map(|port| format!("serial:{}", port.path.display()));
    let all = robots.chain(real).chain(["serial:auto".to_owned()]).chain(known::boards());
    let mut all: Vec<String> = all.filter(|board| board.starts_with(&*typed)).collect();
    // Files of robots, after `sim:` or `emu:`.
    if let Some((kind @ ("sim" | "emu"), path)) = typed.split_once(':') {
        let is_robot = |path: &Path| path.is_dir() || path.extension().is_some_and(|extension| extension == "toml");
        let files = PathCompleter::any().filter(is_robot).complete(OsStr::new(path));
        all.extend(files.iter().map(|file| format!("{kind}:{}", file.get_value().to_string_lossy())));
    }
    all.sort();
    // A board may be connected and known from before.
    all.dedup();
    all.into_iter().map(CompletionCandidate::new).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_board_of_a_line_is_the_last_that_is_named() {
        let board = |line: &str| board_of(line.split(' ').map(str::to_owned)).map(|board| board.to_string());
        for line in [
            "r4 move --board sim:openscout",
            "r4 --board=sim:openscout move",
            "r4 --board x --board sim:openscout move ",
            "r4 --board x --board=sim:openscout move",
            "r4 --board=x --board sim:openscout move",
        ] {
            assert_eq!(board(line).as_deref(), Some("sim:openscout"), "{line}");
        }
        assert_eq!(board("r4 --board nothing:here move"), None);
    }

    #[test]
    fn a_verb_takes_the_kinds_of_channels_that_it_moves() {
        let of = |kinds| {
            channels_of(&Target::Sim("every-interface".into())).into_iter().filter(move |id| {
                let kinds: &[ChannelKind] = kinds;
                kinds.contains(&id.kind)
            })
        };
        for verb in ["move", "step", "relay", "servo", "bldc", "dac"] {
            assert!(of(kinds_of(verb)).count() > 0, "{verb}");
        }
        assert!(channels_of(&Target::Sim("no-such-robot".into())).is_empty());
    }
}
