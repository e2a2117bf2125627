//! Verbs of the program, and the complete command line.

use clap::{CommandFactory, FromArgMatches, Parser, Subcommand, parser::ValueSource};

use crate::{
    args::{
        Args, Bench, Bldc, Debug, Demo, Held, Home, I2c, Motion, Relay, Scenario, Serve, Share, Step, Uart, Watch,
        seconds,
    },
    commands::{self, bridge::Bridge, config::Config},
};

/// Drive R4 boards, real and simulated
///
/// Exit codes: 0 the command achieved its result; 1 it did not; 2 usage error; 3 refused; 4 no link to the board, or
/// the link was lost; 5 the board stopped; 130 interrupted by Ctrl-C, after disarming.
#[derive(Clone, Debug, Parser)]
#[command(name = "r4", version, max_term_width = 100)]
pub(crate) struct Typed {
    #[command(flatten)]
    pub(crate) args: Args,
    #[command(subcommand)]
    pub(crate) command: Command,
}

impl Typed {
    /// Parses the command line.
    ///
    /// # Errors
    /// [`clap::Error`] of a usage error; also carries the text of `--help` and `--version`.
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
    /// Drive the set points of the OSMC evaluation and compare with the paper's results, or drive a robot round a room
    Demo(Demo),
    /// Print the board's identity, state, and channels with their ranges
    Info,
    /// Arm and stay connected until Ctrl-C, or for a time
    Arm {
        /// Disarm after this time [default: on Ctrl-C]
        #[arg(long = "for", value_parser = seconds, value_name = "SECONDS", allow_negative_numbers = true)]
        seconds: Option<f64>,
    },
    /// Disarm: make outputs safe
    Disarm,
    /// Clear a trip, once its causes are gone
    Clear,
    /// Arm, move a motor or stepper to a position, wait until it rests there, disarm
    Move(Motion),
    /// Arm, move motors along paths from a table, all starting together, wait until they rest, disarm
    Follow {
        /// CSV with the columns time_s, osmc0.position_rad, and optionally osmc0.speed_rad_s and osmc0.duty; in m for
        /// an actuator
        #[arg(value_name = "FILE")]
        file: std::path::PathBuf,
    },
    /// Arm, move a stepper by whole steps, wait until it rests, disarm
    Step(Step),
    /// Arm, seek the home switch of a motor or stepper, wait until it rests there, disarm
    Home(Home),
    /// Arm, run a motor or stepper at a speed for a time, disarm
    Speed(Motion),
    /// Arm, run a motor at a duty (share of the supply) for a time, disarm
    Duty(Motion),
    /// Arm, press with a force for a time, with a motor that has a force sensor, disarm; example: `r4 press dhb0 5N`
    Press(Motion),
    /// Arm, close or open a relay for a time, disarm (which opens it)
    Relay(Relay),
    /// Arm, hold a servo at an angle for a time, disarm
    Servo(Held),
    /// Arm, run or brake a brushless drive for a time, disarm (which stops it)
    Bldc(Bldc),
    /// Arm, output a voltage for a time, disarm (which outputs the safe voltage)
    Dac(Held),
    /// Print channels at a steady rate, until Ctrl-C or for a time
    Watch(Watch),
    /// Watch all channels on a screen; arm, type set points, disarm, clear and stop by keys
    Monitor(crate::commands::monitor::Monitor),
    /// Drive a robot on wheels by keys, while the dead-man key is held
    Drive(crate::commands::drive::Drive),
    /// Tune a motor's loop by an experiment on the board, compare with the present gains, disarm
    Tune(crate::commands::tune::Tune),
    /// Measure parameters of encoders, potentiometers, servos and wheels
    Calibrate(crate::commands::calibrate::Calibrate),
    /// Show and change the parameters of the board
    #[command(subcommand)]
    Config(Config),
    /// List the trips stored on the board, or its state before one of them
    Faults {
        /// Trip to show; 0 is the newest [default: list all]
        index: Option<u8>,
    },
    /// Write the firmware to a board's flash, over a debug probe or USB
    Flash(commands::flash::Flash),
    /// Write to a device on an external I2C connector, then read from it
    I2c(I2c),
    /// Send and receive on a UART connector
    Uart(Uart),
    /// Play files of timed steps on a virtual board, and print or compare the outcomes
    Scenario(Scenario),
    /// Run the firmware's image on an emulated board under a debugger or with a trace
    Debug(Debug),
    /// Serve a board to hosts that speak another protocol
    Bridge {
        #[command(subcommand)]
        what: Bridge,
    },
    /// Run the board as a node in ROS 2, until Ctrl-C
    Ros2(commands::ros2::Ros2),
    /// Record runs, inspect them, and replay them on a simulated board
    #[command(subcommand)]
    Log(commands::log::Log),
    /// Make an HTML page of a log: set points, plots, states
    Report(commands::report::Report),
    /// Fit a model to recordings, find its unmodelled effects, and write the better plant file
    Identify(Box<commands::identify::Identify>),
    /// List robot systems of published papers, run one, or study one over seeds
    System {
        #[command(subcommand)]
        what: commands::system::Systems,
    },
    /// Repeat a paper's whole evaluation on blind plants, beside the paper's results
    Evaluate {
        #[command(subcommand)]
        what: commands::evaluate::Evaluations,
    },
    /// List serial ports, and which of them are boards
    Ports,
    /// Share a board until Ctrl-C: one program commands it, any number watch [default: at tcp:127.0.0.1:4404]
    Serve(Share),
    /// Make keys and tokens for a board that is served with a policy, check the policy, verify its log
    Access {
        #[command(subcommand)]
        what: crate::commands::access::Access,
    },
    /// Serve a virtual board to other programs, or reveal its hidden effects
    Sim {
        #[command(subcommand)]
        what: Sim,
    },
    /// Measure the firmware's limits on simulated boards, and the results of `r4 identify` on recordings
    Bench {
        #[command(subcommand)]
        what: Bench,
    },
    /// Print a script that completes verbs and options in a shell
    Completions(crate::commands::completions::Completions),
    /// Print the manual page of the program or of a verb, or write all of them
    Man(crate::commands::man::Manual),
}

/// Actions with a virtual board.
#[derive(Clone, Debug, Subcommand)]
pub(crate) enum Sim {
    /// Serve it in real time, until Ctrl-C; the first line on stdout is its address
    Serve(Serve),
    /// Print the effects that --blind hides in a robot
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

    /// Commands of a page: with `false` those to type, behind a prompt or not; with `true` those that its text names.
    fn commands_of(page: &str) -> Vec<(String, bool)> {
        let is_ours = |(command, _): &(String, bool)| command.starts_with("r4 ");
        let typed = page.lines().map(|line| (line.trim_start_matches("$ ").to_owned(), false));
        let named = page.split('`').skip(1).step_by(2).map(|span| (span.replace('\n', " "), true));
        typed.chain(named).filter(is_ours).collect()
    }

    /// Words of a command as a shell splits it, without what follows `#`, `&`, `|`, `>` or two spaces, after which a
    /// page explains it.
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
                // Skip patterns: ellipses, alternatives and placeholders are no commands.
                let stands_for = |word: &String| word.contains(['\u{2026}', '[', '|', '<']) || word == "COMMAND";
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

    /// Pages with lists of what the code has in a table: verbs, links, robots, systems.
    #[test]
    fn pages_list_what_there_is() {
        let root = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
        let names = |page: &str, what: &str| {
            let text = std::fs::read_to_string(root.join(page)).unwrap_or_else(|error| panic!("{page}: {error}"));
            assert!(text.contains(what), "{page} lacks {what}");
        };
        for verb in Typed::command().get_subcommands() {
            names("docs/program.md", &format!("r4 {} ", verb.get_name()));
        }
        for kind in &r4_links::LINK_KINDS {
            for page in ["README.md", "docs/program.md", "docs/python.md", "host/python/python/r4/__init__.py"] {
                names(page, &format!("`{}:", kind.prefix));
            }
        }
        for robot in r4_boards::names() {
            names("docs/program.md", &format!("`{robot}`"));
            names("boards/README.md", &format!("| `{robot}` |"));
        }
        for system in r4_systems::all() {
            let name = system.about().name;
            names("README.md", &format!("(docs/systems/{name}.md)"));
            names(&format!("docs/systems/{name}.md"), name);
        }
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
