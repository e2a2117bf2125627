//! Test that follows the guide: every command of `docs/guide.md`, in its order, in a folder of its own, on boards that
//! are served.
//!
//! A block that begins with `console` is what a user types and sees. It consists of
//!
//! | line | meaning |
//! | --- | --- |
//! | `$ r4 …` | a command; it ends with 0, or with the code that `$ echo $?` after it shows |
//! | `$ r4 … &` | a command in the background; the next step waits for its first line |
//! | `$ kill -INT %1` | Ctrl-C for it; it ends with 0 |
//! | `$ export NAME=VALUE` | sets a variable for the rest |
//! | `…` | lines that are left out |
//! | another | the next line that the command prints, but for its numbers and the width of its columns |

use std::{path::Path, process::Command, time::Instant};

use crate::program::*;
use tempfile::TempDir;

const GUIDE: &str = include_str!("../docs/guide.md");
/// Command that sets a longer link time-out. Served boards run in real time, and a machine that builds and tests may
/// stop a host for longer than the 200 ms after which the guide's board trips.
const PATIENT: &str = "--board sim:osmc-bench --flash board.flash config set board.link_timeout_ms 1000 --save";

/// Command, and the output that the guide shows for it.
struct Step<'g> {
    typed: &'g str,
    shown: Vec<&'g str>,
}

fn steps(guide: &str) -> Vec<Step<'_>> {
    let mut steps: Vec<Step<'_>> = Vec::new();
    let mut in_block = false;
    for line in guide.lines() {
        if line.starts_with("```") {
            in_block = line == "```console";
        } else if let (true, Some(typed)) = (in_block, line.strip_prefix("$ ")) {
            steps.push(Step { typed, shown: Vec::new() });
        } else if in_block {
            steps.last_mut().expect("something is typed before anything is shown").shown.push(line);
        }
    }
    steps
}

/// Returns a line's words without numbers and table borders; the number of a channel, as in `osmc0`, belongs to its
/// name.
fn words(line: &str) -> Vec<String> {
    let of_numbers = |char: char| char.is_ascii_digit() || "+-.".contains(char);
    line.split(|char: char| char.is_whitespace() || ('\u{2500}'..='\u{257f}').contains(&char))
        .map(|word| match word.starts_with(char::is_alphabetic) {
            true => word.to_owned(),
            false => word.replace(of_numbers, ""),
        })
        .filter(|word| !word.is_empty())
        .collect()
}

/// Returns the first line that is shown but not printed in its place; `…` when more is printed than is shown.
fn missing<'g>(shown: &[&'g str], printed: &str) -> Option<&'g str> {
    let mut printed = printed.lines().map(words);
    let mut left_out = false;
    for line in shown {
        if *line == "…" {
            left_out = true;
        } else {
            let wanted = words(line);
            let found = if left_out { printed.any(|line| line == wanted) } else { printed.next() == Some(wanted) };
            if !found {
                return Some(line);
            }
            left_out = false;
        }
    }
    (!left_out && !shown.is_empty() && printed.next().is_some()).then_some("…")
}

/// Subset of a shell that the guide needs.
struct Shell<'f> {
    folder: &'f Path,
    environment: Vec<(&'static str, &'static str)>,
    beside: Option<Running>,
}

impl Shell<'_> {
    fn command(&self, arguments: &str) -> Command {
        let mut command = command(&arguments.split_whitespace().collect::<Vec<_>>());
        command.current_dir(self.folder).envs(self.environment.iter().copied());
        command
    }

    fn serve(&mut self, arguments: &str) {
        assert!(self.beside.is_none(), "one board at a time: {arguments}");
        let served = start(self.command(arguments));
        let line = next(served.out.as_ref().expect("stdout"), served.begin);
        assert!(line.is_some(), "{arguments}: {:?}", served.finish());
        self.beside = Some(served);
    }

    fn interrupt(&mut self) {
        let mut beside = self.beside.take().expect("something runs beside");
        beside.begin = Instant::now();
        let sent = Command::new("kill").args(["-INT", &beside.child.id().to_string()]).status();
        assert!(sent.is_ok_and(|status| status.success()), "kill -INT");
        let ended = beside.finish();
        assert_eq!(ended.code, Some(0), "{ended:?}");
    }

    fn run(&self, arguments: &str, code: i32, shown: &[&str]) {
        let seen = start(self.command(arguments)).finish();
        let printed = [seen.err.clone() + &seen.out, seen.out.clone() + &seen.err];
        let wrong = printed.iter().map(|printed| missing(shown, printed)).min().flatten();
        let without = wrong.map_or_else(String::new, |line| format!(", without the line\n{line}"));
        assert!(
            seen.code == Some(code) && wrong.is_none(),
            "$ r4 {arguments}\nends with {:?}, not {code}{without}:\n{}",
            seen.code,
            printed[0]
        );
    }
}

#[test]
fn every_step_does_what_the_guide_says() {
    let folder = TempDir::new().expect("a folder");
    let mut shell = Shell { folder: folder.path(), environment: Vec::new(), beside: None };
    shell.run(PATIENT, 0, &[]);
    let mut steps = steps(GUIDE).into_iter().peekable();
    let mut run = 0;
    while let Some(Step { typed, shown }) = steps.next() {
        let begin = Instant::now();
        if let Some(setting) = typed.strip_prefix("export ") {
            shell.environment.push(setting.split_once('=').expect("NAME=VALUE"));
        } else if typed == "kill -INT %1" {
            shell.interrupt();
        } else {
            let arguments = typed.strip_prefix("r4 ").unwrap_or_else(|| panic!("not of the guide's kinds: {typed}"));
            run += 1;
            if let Some(arguments) = arguments.strip_suffix(" &") {
                shell.serve(arguments);
            } else {
                let code = steps
                    .next_if(|step| step.typed == "echo $?")
                    .map_or(0, |step| step.shown[0].parse().expect("an exit code"));
                shell.run(arguments, code, &shown);
            }
        }
        eprintln!("{:6.2} s  $ {typed}", begin.elapsed().as_secs_f64());
    }
    assert!(shell.beside.is_none(), "the guide leaves a board running");
    assert!(run >= 20, "the guide has {run} commands: is it read as it should be?");
}

#[test]
fn what_the_guide_shows_is_compared() {
    let printed = "osmc0 at 89.94 deg\n│ a   -1.0 │\nend\n";
    assert_eq!(missing(&["osmc0 at 90.01 deg", "│ a    12 │", "…"], printed), None);
    assert_eq!(missing(&["osmc0 at 90.01 deg", "│ a    12 │"], printed), Some("…"));
    assert_eq!(missing(&["…", "end"], printed), None);
    assert_eq!(missing(&["end"], printed), Some("end"));
    assert_eq!(missing(&["osmc1 at 90.01 deg"], printed), Some("osmc1 at 90.01 deg"));
    assert_eq!(missing(&["…", "osmc0 at 1 mm"], printed), Some("osmc0 at 1 mm"));
}
