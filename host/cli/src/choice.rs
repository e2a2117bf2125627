//! Choice of the board for a command that names none: a simulated board, unless a real one is connected.

use std::path::PathBuf;

use r4_links::ports::{self, Port};

use crate::{args::Args, session::Target, verbs::Command};

/// Error of a command without `--board` while a real board is connected: either could be meant.
#[derive(Debug, PartialEq, thiserror::Error)]
#[error(
    "a real board is connected at {}, and no board was named: write --board serial:{} for it, or --board {simulated} for a \
     simulated one; R4_BOARD names one for all commands",
    names(.real), .real[0].display()
)]
pub(crate) struct Unclear {
    real: Vec<PathBuf>,
    simulated: Target,
}

fn names(paths: &[PathBuf]) -> String {
    let names: Vec<_> = paths.iter().map(|path| path.display().to_string()).collect();
    names.join(" and ")
}

/// Refuses a command whose board is ambiguous; notes on stderr when an unnamed board is the default, simulated one.
pub(crate) fn check(args: &Args, command: &Command) -> Result<(), Unclear> {
    let boards = || {
        let found = ports::list().unwrap_or_default().into_iter().filter(Port::is_board);
        found.map(|port| port.path).collect()
    };
    if let Some(note) = decide(args, command, boards)? {
        eprintln!("r4: {note}");
    }
    Ok(())
}

/// Decides as [`check`] does, with `boards` as the list of connected real boards; returns the note for stderr.
fn decide(args: &Args, command: &Command, boards: impl FnOnce() -> Vec<PathBuf>) -> Result<Option<String>, Unclear> {
    // Ports are listed only where the choice depends on them.
    if args.is_board_named || !opens_a_session(command) {
        return Ok(None);
    }
    let real = boards();
    if !real.is_empty() {
        return Err(Unclear { real, simulated: args.board.clone() });
    }
    Ok(Some(format!("no board was named: this is {}; --board or R4_BOARD names another", args.board.described())))
}

/// True for a command that opens a session with the board of `--board`, which may be real. The others use no board, or
/// start simulated boards of their own and print that, as `demo` does.
fn opens_a_session(command: &Command) -> bool {
    match command {
        Command::Info
        | Command::Arm { .. }
        | Command::Disarm
        | Command::Clear
        | Command::Move(_)
        | Command::Follow { .. }
        | Command::Step(_)
        | Command::Home(_)
        | Command::Speed(_)
        | Command::Duty(_)
        | Command::Press(_)
        | Command::Relay(_)
        | Command::Servo(_)
        | Command::Bldc(_)
        | Command::Dac(_)
        | Command::Watch(_)
        | Command::Monitor(_)
        | Command::Drive(_)
        | Command::Tune(_)
        | Command::Calibrate(_)
        | Command::Config(_)
        | Command::Faults { .. }
        | Command::I2c(_)
        | Command::Uart(_)
        | Command::Bridge { .. }
        | Command::Ros2(_)
        | Command::Log(crate::commands::log::Log::Record(_)) => true,
        Command::Serve(share) => share.board.is_none(),
        Command::Identify(identify) => identify.is_on_a_board(),
        Command::Demo(_)
        | Command::Flash(_)
        | Command::Scenario(_)
        | Command::Debug(_)
        | Command::Log(_)
        | Command::Report(_)
        | Command::System { .. }
        | Command::Evaluate { .. }
        | Command::Access { .. }
        | Command::Ports
        | Command::Sim { .. }
        | Command::Bench { .. }
        | Command::Completions(_)
        | Command::Man(_) => false,
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use super::*;
    use crate::verbs::Typed;

    fn decided(
        typed: &str,
        is_board_named: bool,
        boards: impl FnOnce() -> Vec<PathBuf>,
    ) -> Result<Option<String>, Unclear> {
        let Typed { args, command } = Typed::try_parse_from(typed.split(' ')).expect("typed well");
        decide(&Args { is_board_named, ..args }, &command, boards)
    }

    #[test]
    fn a_real_board_is_never_passed_over() {
        let real = || vec![PathBuf::from("/dev/ttyACM0"), PathBuf::from("/dev/ttyACM1")];
        for typed in ["r4 move osmc0 90deg", "r4 disarm", "r4 config save", "r4 drive", "r4 log record"] {
            let refused = decided(typed, false, real).expect_err(typed).to_string();
            for choice in ["--board serial:/dev/ttyACM0", "--board sim:osmc-bench", "/dev/ttyACM1", "R4_BOARD"] {
                assert!(refused.contains(choice), "{typed}: {refused}");
            }
            assert_eq!(decided(typed, true, real), Ok(None), "{typed}");
            let note = decided(typed, false, Vec::new).expect(typed).expect("a note");
            assert!(note.contains("sim:osmc-bench (simulated)") && note.contains("--board"), "{note}");
        }
        for typed in ["r4 demo", "r4 ports", "r4 log info a.mcap", "r4 bench sim", "r4 sim serve osmc-bench --pty"] {
            assert_eq!(decided(typed, false, real), Ok(None), "{typed}");
        }
    }
}
