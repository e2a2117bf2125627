//! The verbs, and what is typed as a whole.

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand, parser::ValueSource};

use crate::{
    args::{
        Args, Bench, Bldc, Debug, Demo, Held, Home, I2c, Motion, Relay, Scenario, Serve, Share, Step, Uart, Watch,
        seconds,
    },
    commands::{self, bridge::Bridge, config::Config},
};

/// Drives R4 boards, real and simulated.
///
/// Exit code 0 only when what the command promises held; 1 when it did not; 2 when it was not understood; 3 when it was refused;
/// 4 when there is no link to the board, or not any more; 5 when the board stopped; 130 after Ctrl-C, which disarms first.
#[derive(Clone, Debug, Parser)]
#[command(name = "r4", version, max_term_width = 100)]
pub(crate) struct Typed {
    #[command(flatten)]
    pub(crate) args: Args,
    #[command(subcommand)]
    pub(crate) command: Command,
}

impl Typed {
    /// What was typed.
    ///
    /// # Errors
    /// What clap says of it; also the text of `--help` and `--version`.
    pub(crate) fn from_command_line() -> Result<Self, clap::Error> {
        let matches = Self::command().try_get_matches()?;
        let is_given = |name| matches.value_source(name).is_some_and(|source| source != ValueSource::DefaultValue);
        let (is_board_named, is_seed_given) = (is_given("board"), is_given("seed"));
        let mut typed = Self::from_arg_matches(&matches)?;
        typed.args.is_board_named = is_board_named;
        typed.args.is_seed_given = is_seed_given;
        Ok(typed)
    }
}

#[derive(Clone, Debug, Subcommand)]
pub(crate) enum Command {
    /// Drive the set points of the OSMC evaluation and compare with the paper's results, or a robot round a room
    Demo(Demo),
    /// What the board is and what its channels can take
    Info,
    /// Arm and stay connected until Ctrl-C, or for a time
    Arm {
        /// Disarm after this long
        #[arg(long = "for", value_parser = seconds, value_name = "SECONDS", allow_negative_numbers = true)]
        seconds: Option<f64>,
    },
    /// Make outputs safe
    Disarm,
    /// Leave a trip behind, once its causes are gone
    Clear,
    /// Arm, send a motor or stepper to a position, wait until it rests there, disarm
    Move(Motion),
    /// Arm, let motors follow paths from a table, all beginning at once, wait until they rest, disarm
    Follow {
        /// CSV: time_s, then osmc0.position_rad and, if wanted, osmc0.speed_rad_s and osmc0.duty; for an actuator in m
        #[arg(value_name = "FILE")]
        file: std::path::PathBuf,
    },
    /// Arm, move a stepper by whole steps, wait until it rests, disarm
    Step(Step),
    /// Arm, seek the home switch of a motor or stepper, wait until it rests there, disarm
    Home(Home),
    /// Arm, turn a motor or stepper at a speed for a time, disarm
    Speed(Motion),
    /// Arm, give a motor a share of the supply for a time, disarm
    Duty(Motion),
    /// Arm, press with a motor that has a force sensor for a time, as in `r4 press dhb0 5N`, disarm
    Press(Motion),
    /// Arm, close or open a relay for a time, disarm (which opens it)
    Relay(Relay),
    /// Arm, hold a servo at an angle for a time, disarm
    Servo(Held),
    /// Arm, drive or brake a brushless drive for a time, disarm (which stops it)
    Bldc(Bldc),
    /// Arm, give a voltage for a time, disarm (which gives the safe voltage)
    Dac(Held),
    /// Print channels at a steady rate, until Ctrl-C or for a time
    Watch(Watch),
    /// Watch everything on a screen; arm, type set points, disarm, clear and stop by keys
    Monitor(crate::commands::monitor::Monitor),
    /// Drive a robot on wheels by keys, as long as the dead-man key is held
    Drive(crate::commands::drive::Drive),
    /// Find gains for a motor's loop by an experiment on the board, compare with the present ones, disarm
    Tune(crate::commands::tune::Tune),
    /// Measure what the board must know of its encoders, potentiometers, servos and wheels
    Calibrate(crate::commands::calibrate::Calibrate),
    /// Show and change the parameters of the board
    #[command(subcommand)]
    Config(Config),
    /// Trips that the board remembers, or what it looked like before one of them
    Faults {
        /// Which trip: 0 is the newest
        index: Option<u8>,
    },
    /// Write the firmware into a board's flash, over a debug probe or USB
    Flash(commands::flash::Flash),
    /// Write to a device on an external I2C connector, then read from it
    I2c(I2c),
    /// Send and receive on a UART connector
    Uart(Uart),
    /// Play files that say what is done to a virtual board, and print or compare what came of it
    Scenario(Scenario),
    /// Run the firmware's image on an emulated board under a debugger or with a trace
    Debug(Debug),
    /// A board for hosts that speak another protocol
    Bridge {
        #[command(subcommand)]
        what: Bridge,
    },
    /// Be the board's node in ROS 2, until Ctrl-C
    Ros2(commands::ros2::Ros2),
    /// Record runs, look at them, and play them again on a simulated board
    #[command(subcommand)]
    Log(commands::log::Log),
    /// Make an HTML page of a log: set points, plots, states
    Report(commands::report::Report),
    /// Fit a model to recordings, tell what it does not explain and which effect it lacks, and write the better plant
    Identify(Box<commands::identify::Identify>),
    /// Robot systems of published papers: list them, run one, study one over seeds
    System {
        #[command(subcommand)]
        what: commands::system::Systems,
    },
    /// Repeat a paper's whole evaluation on blind plants, with the paper beside
    Evaluate {
        #[command(subcommand)]
        what: commands::evaluate::Evaluations,
    },
    /// Serial ports, and which of them are boards
    Ports,
    /// Share a board: one program commands it, any number watch, at tcp:127.0.0.1:4404 unless told otherwise; until Ctrl-C
    Serve(Share),
    /// Make a virtual board that other programs connect to
    Sim {
        #[command(subcommand)]
        what: Sim,
    },
    /// Measure what the firmware promises, on simulated boards, and what `r4 identify` does, on recordings
    Bench {
        #[command(subcommand)]
        what: Bench,
    },
    /// Print a script with which a shell completes verbs and options
    Completions(crate::commands::completions::Completions),
    /// Print the manual page of the program or of a verb, or write all of them
    Man(crate::commands::man::Manual),
}

/// What is made of a virtual board.
#[derive(Clone, Debug, Subcommand)]
pub(crate) enum Sim {
    /// Serve it in real time, until Ctrl-C; the first line on stdout says where
    Serve(Serve),
    /// What --blind hides in the motors of a robot
    Reveal(crate::commands::reveal::Reveal),
}

#[cfg(test)]
mod tests {
    use clap::error::ErrorKind;

    use super::*;
    use crate::args::LogLevel;

    #[test]
    fn definitions_are_consistent() {
        Typed::command().debug_assert();
    }

    /// What a page has people type, behind a prompt or not, and `false`; the verbs that its text names, and `true`.
    fn commands_of(page: &str) -> Vec<(String, bool)> {
        let is_ours = |(command, _): &(String, bool)| command.starts_with("r4 ");
        let typed = page.lines().map(|line| (line.trim_start_matches("$ ").to_owned(), false));
        let named = page.split('`').skip(1).step_by(2).map(|span| (span.replace('\n', " "), true));
        typed.chain(named).filter(is_ours).collect()
    }

    /// As a shell has them: without what follows `#`, `&`, `|`, `>` or two spaces, behind which a page says what it does.
    fn words_of(command: &str) -> Vec<String> {
        let command = command.split("  ").next().unwrap_or(command);
        let mut words = vec![String::new()];
        let mut quote = None;
        for letter in command.chars() {
            match (quote, letter) {
                (None, '\'' | '"') => quote = Some(letter),
                (Some(open), close) if open == close => quote = None,
                (None, '#' | '&' | '|' | '>' | ';') if words.last().is_none_or(String::is_empty) => break,
                (None, ' ') => words.push(String::new()),
                _ => words.last_mut().expect("there is one").push(letter),
            }
        }
        words.retain(|word| !word.is_empty());
        words
    }

    #[test]
    fn every_page_types_what_is_understood() {
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let docs = std::fs::read_dir(root.join("docs")).expect("a folder").map(|entry| entry.expect("an entry").path());
        let more = ["README.md", "CONTRIBUTING.md", "ARCHITECTURE.md", "boards/README.md", "firmware/giga/README.md"];
        let (mut seen, mut problems) = (0, Vec::new());
        for path in docs.filter(|path| path.extension() == Some("md".as_ref())).chain(more.map(|page| root.join(page)))
        {
            let page = std::fs::read_to_string(&path).expect("a page");
            for (command, is_named) in commands_of(&page) {
                let words = words_of(&command);
                // What is left out, one of several, or a name to be put in, is no command.
                let stands_for = |word: &String| word.contains(['\u{2026}', '[', '|', '<']) || word == "VERB";
                if words.iter().any(stands_for) {
                    continue;
                }
                seen += 1;
                let Err(problem) = Typed::try_parse_from(&words) else { continue };
                let is_short =
                    is_named && matches!(problem.kind(), ErrorKind::MissingRequiredArgument | ErrorKind::InvalidValue);
                if problem.use_stderr() && !is_short {
                    problems.push(format!("{}: {command}: {problem}", path.display()));
                }
            }
        }
        assert!(problems.is_empty(), "{}", problems.join("\n"));
        assert!(seen > 150, "{seen} commands found");
    }

    #[test]
    fn a_log_has_a_level_only_behind_an_equals_sign() {
        let parsed = |typed: &[&str]| Typed::try_parse_from([&["r4"], typed].concat()).map(|typed| typed.args.log).ok();
        assert_eq!(parsed(&["--log", "info"]), Some(Some(LogLevel::Trace)));
        assert_eq!(parsed(&["info", "--log=warn"]), Some(Some(LogLevel::Warn)));
        assert_eq!(parsed(&["--log=loud", "info"]), None);
    }

    #[test]
    fn debugging_needs_to_know_how() {
        let parsed = |typed: &str| Typed::try_parse_from(["r4", "debug"].into_iter().chain(typed.split(' '))).is_ok();
        for good in ["--gdb 127.0.0.1:3333", "--gdb [::1]:1 --attach-at 0.5", "--until 5", "--trace - --symbol main"] {
            assert!(parsed(good), "{good}");
        }
        for bad in [
            "--scenario a.toml",
            "--gdb 3333",
            "--attach-at 1",
            "--symbol main",
            "--until 5 --gdb [::1]:1 --attach-at 1",
        ] {
            assert!(!parsed(bad), "{bad}");
        }
    }
}
