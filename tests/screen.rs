//! Tests of `r4` on a whole terminal: the screens, the state of the terminal afterwards, and the texts for shells and
//! `man`.
#![cfg(unix)]

use crate::program;
use std::{
    collections::BTreeSet,
    fs::{self, File},
    io::{BufRead, BufReader, Read, Write},
    os::fd::OwnedFd,
    path::Path,
    process::{Child, Command, ExitStatus, Stdio},
    sync::mpsc::{Receiver, RecvTimeoutError, channel},
    thread,
    time::{Duration, Instant},
};

use rustix::{
    fs::{Mode, OFlags},
    pty::{OpenptFlags, grantpt, openpt, ptsname, unlockpt},
    termios::{LocalModes, Winsize, tcgetattr, tcsetwinsize},
};
use tempfile::TempDir;

/// Time-out: a screen that has not come after this long never comes.
const PATIENCE: Duration = Duration::from_secs(60);
/// Repeat time of a key that is held.
const REPEAT: Duration = Duration::from_millis(33);

// A terminal.

/// Screen of a terminal that got these bytes: the subset of terminal functions that the program uses.
struct Grid {
    cells: Vec<Vec<char>>,
    row: usize,
    column: usize,
    is_alternate: bool,
    is_cursor_hidden: bool,
    /// Beginning of a sequence that is not complete.
    begun: Vec<u8>,
}

impl Grid {
    fn new() -> Self {
        Self { cells: Vec::new(), row: 0, column: 0, is_alternate: false, is_cursor_hidden: false, begun: Vec::new() }
    }

    fn take(&mut self, byte: u8) {
        self.begun.push(byte);
        match self.begun.as_slice() {
            [0x1b] | [0x1b, b'['] => return,
            [0x1b, b'[', parameters @ .., last] => {
                if !(0x40..=0x7e).contains(last) {
                    return;
                }
                let (parameters, last) = (String::from_utf8_lossy(parameters).into_owned(), *last);
                self.control(&parameters, last);
            }
            [0x1b, ..] => {}
            text => match std::str::from_utf8(text) {
                Ok(text) => {
                    let text = text.to_owned();
                    text.chars().for_each(|c| self.print(c));
                }
                Err(error) if error.error_len().is_none() => return,
                Err(error) => panic!("the program printed what is no text: {error}"),
            },
        }
        self.begun.clear();
    }

    fn control(&mut self, parameters: &str, last: u8) {
        match (parameters, last) {
            (place, b'H') => {
                let mut numbers = place.split(';').map(|number| number.parse().unwrap_or(1).max(1usize) - 1);
                (self.row, self.column) = (numbers.next().unwrap_or(0), numbers.next().unwrap_or(0));
            }
            ("2", b'J') => self.cells.clear(),
            ("?1049", b'h' | b'l') => {
                self.is_alternate = last == b'h';
                self.cells.clear();
            }
            ("?25", b'h' | b'l') => self.is_cursor_hidden = last == b'l',
            // Colours, and modes without an effect here.
            (_, b'm' | b'h' | b'l') => {}
            other => panic!("a sequence that this terminal does not know: {other:?}"),
        }
    }

    fn print(&mut self, c: char) {
        match c {
            '\r' => self.column = 0,
            '\n' => self.row += 1,
            c => {
                self.cells.resize_with((self.row + 1).max(self.cells.len()), Vec::new);
                let row = &mut self.cells[self.row];
                row.resize((self.column + 1).max(row.len()), ' ');
                row[self.column] = c;
                self.column += 1;
            }
        }
    }

    fn text(&self) -> String {
        self.cells.iter().map(|row| row.iter().collect::<String>().trim_end().to_owned() + "\n").collect()
    }
}

/// `r4` on a terminal of its own.
struct OnTerminal {
    child: Child,
    keys: File,
    /// The program's end, kept open to read its settings afterwards.
    end: OwnedFd,
    bytes: Receiver<Vec<u8>>,
    grid: Grid,
    begin: Instant,
}

impl OnTerminal {
    fn start(args: &[&str]) -> Self {
        let keys =
            openpt(OpenptFlags::RDWR | OpenptFlags::NOCTTY | OpenptFlags::CLOEXEC).expect("a terminal does this");
        grantpt(&keys).expect("a terminal does this");
        unlockpt(&keys).expect("a terminal does this");
        let path = ptsname(&keys, Vec::new()).expect("a terminal does this");
        let end = rustix::fs::open(&path, OFlags::RDWR | OFlags::NOCTTY | OFlags::CLOEXEC, Mode::empty())
            .expect("a terminal does this");
        tcsetwinsize(&keys, Winsize { ws_row: 24, ws_col: 80, ws_xpixel: 0, ws_ypixel: 0 })
            .expect("a terminal does this");
        // Made the controlling terminal: otherwise the program would read the size of the terminal that the tests run
        // in.
        let mut command = Command::new("setsid");
        command.args(["--ctty", "--wait", env!("CARGO_BIN_EXE_r4")]).args(args).env("TERM", "xterm-256color");
        command.env_remove("R4_BOARD").env_remove("R4_FLASH").env_remove("NO_COLOR");
        let side = || Stdio::from(end.try_clone().expect("a terminal does this"));
        let child =
            command.stdin(side()).stdout(side()).stderr(side()).spawn().expect("setsid, of util-linux, starts r4");
        let keys = File::from(keys);
        let mut printed = keys.try_clone().expect("a terminal does this");
        let (sender, bytes) = channel();
        thread::spawn(move || {
            let mut buffer = [0; 4096];
            while let Ok(len @ 1..) = printed.read(&mut buffer) {
                if sender.send(buffer[..len].to_vec()).is_err() {
                    break;
                }
            }
        });
        Self { child, keys, end, bytes, grid: Grid::new(), begin: Instant::now() }
    }

    /// Reads output until there is some or `patience` has passed; false when there is none.
    fn look(&mut self, patience: Duration) -> bool {
        assert!(self.begin.elapsed() < PATIENCE, "waited too long; the screen is\n{}", self.grid.text());
        match self.bytes.recv_timeout(patience) {
            Ok(bytes) => bytes.into_iter().for_each(|byte| self.grid.take(byte)),
            Err(RecvTimeoutError::Timeout) => return false,
            Err(RecvTimeoutError::Disconnected) => panic!("nobody holds the terminal"),
        }
        true
    }

    /// Waits until the screen is as it should be, and returns its text.
    fn until(&mut self, is_so: impl Fn(&str) -> bool) -> String {
        loop {
            let text = self.grid.text();
            if is_so(&text) {
                return text;
            }
            self.look(Duration::from_secs(1));
        }
    }

    fn until_shows(&mut self, what: &str) -> String {
        self.until(|text| text.contains(what))
    }

    fn press(&mut self, keys: &str) {
        self.keys.write_all(keys.as_bytes()).expect("a terminal does this");
    }

    /// Holds a key as a keyboard does, until the screen is as it should be.
    fn hold(&mut self, key: &str, is_so: impl Fn(&str) -> bool) -> String {
        let mut due = Instant::now();
        loop {
            let text = self.grid.text();
            if is_so(&text) {
                return text;
            }
            if Instant::now() >= due {
                self.press(key);
                due = Instant::now() + REPEAT;
            }
            self.look(due.saturating_duration_since(Instant::now()));
        }
    }

    fn resize(&self, columns: u16, rows: u16) {
        tcsetwinsize(&self.keys, Winsize { ws_row: rows, ws_col: columns, ws_xpixel: 0, ws_ypixel: 0 })
            .expect("a terminal does this");
    }

    /// Returns how the program ends, and whether the terminal has its former settings.
    fn ends(&mut self) -> (ExitStatus, bool) {
        let status = loop {
            if let Some(status) = self.child.try_wait().expect("a child can be asked") {
                break status;
            }
            self.look(Duration::from_millis(10));
        };
        while self.look(Duration::from_millis(100)) {}
        let modes = tcgetattr(&self.end).expect("a terminal does this").local_modes;
        let is_cooked = modes.contains(LocalModes::ICANON | LocalModes::ECHO | LocalModes::ISIG);
        (status, is_cooked && !self.grid.is_alternate && !self.grid.is_cursor_hidden)
    }

    /// Checks that the program ends with this code and restores the terminal.
    fn ends_well(&mut self, code: i32) {
        let (status, is_restored) = self.ends();
        assert_eq!(status.code(), Some(code), "{}", self.grid.text());
        assert!(is_restored, "the terminal was left in disorder");
    }
}

impl Drop for OnTerminal {
    fn drop(&mut self) {
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

/// Returns the badge of the state as a whole word: `ARMED` is a part of `DISARMED`.
fn state(text: &str) -> &str {
    text.lines().nth(1).and_then(|line| line.split_whitespace().next()).unwrap_or_default()
}

// monitor

#[test]
fn monitor_arms_stops_and_clears_by_keys() {
    let mut screen = OnTerminal::start(&["--board", "sim:openscout", "monitor"]);
    let text =
        screen.until(|text| state(text) == "DISARMED" && text.contains("12.60 V") && text.contains("round trip 0."));
    for there in ["openscout", "dhb3", "dead-man held", "q quit"] {
        assert!(text.contains(there), "{there} is not on\n{text}");
    }
    assert!(screen.grid.is_alternate && screen.grid.is_cursor_hidden);
    screen.press("a");
    screen.until(|text| state(text) == "ARMED" && text.contains("arm: done"));
    screen.press(" ");
    screen.until(|text| state(text) == "TRIPPED" && text.contains("host stop"));
    screen.press("a");
    screen.until_shows("arm: the board has tripped");
    screen.press("c");
    screen.until(|text| state(text) == "DISARMED");
    screen.press("a");
    screen.until(|text| state(text) == "ARMED");
    screen.press("d");
    screen.until(|text| state(text) == "DISARMED");
    screen.press("\x1b[B\x1b[B");
    screen.until_shows("\u{25b8} dhb2");
    screen.press("\x1b[A");
    screen.until_shows("\u{25b8} dhb1");
    screen.press("q");
    screen.ends_well(0);
}

/// The board is shared: the screen shows what another program does with it, and goes on when that program dies.
#[test]
fn monitor_goes_on_when_the_commanding_program_dies() {
    let server = program::start(program::command(&["serve", "sim:osmc-bench", "--tcp", "127.0.0.1:0"]));
    let first = program::next(server.out.as_ref().expect("stdout"), server.begin).expect("a first line");
    let board = format!("tcp:{}", program::text(&program::object(&first), "tcp"));
    let mut screen = OnTerminal::start(&["--board", &board, "monitor"]);
    screen.until(|text| state(text) == "DISARMED" && text.contains("osmc0"));
    let arguments = ["--board", &board, "speed", "osmc0", "1rad/s", "--for", "30"];
    let driving = program::start(program::command(&arguments));
    screen.until(|text| state(text) == "ARMED");
    screen.press("d");
    screen.until_shows("another host commands");
    assert_eq!(state(&screen.grid.text()), "ARMED");
    // The commanding program is killed: the board trips, and the screen goes on.
    drop(driving);
    screen.until(|text| state(text) == "TRIPPED" && text.contains("link lost"));
    screen.press("q");
    screen.ends_well(0);
}

#[test]
fn monitor_uses_a_larger_screen() {
    let mut screen = OnTerminal::start(&["--board", "sim:every-interface", "monitor"]);
    let text = screen.until_shows("osmc0");
    assert!(!text.contains("-30 s"), "no room for a graph on\n{text}");
    screen.resize(120, 40);
    screen.until(|text| text.contains("-30 s") && text.lines().count() >= 39 && text.contains("last 15 s"));
    // The screen shrinks again.
    screen.resize(80, 24);
    screen.until(|text| !text.contains("-30 s") && text.lines().count() <= 24 && text.contains("last 5 s"));
    screen.press("q");
    screen.ends_well(0);
}

#[test]
fn ctrl_c_and_signals_give_the_terminal_back() {
    // In raw mode Ctrl-C is a key and no signal.
    let mut screen = OnTerminal::start(&["--board", "sim:openscout", "monitor"]);
    screen.until_shows("dhb0");
    screen.press("\x03");
    screen.ends_well(0);
    let mut screen = OnTerminal::start(&["--board", "sim:openscout", "monitor"]);
    screen.until_shows("dhb0");
    let killed = Command::new("kill").args(["-TERM", &screen.child.id().to_string()]).status().unwrap();
    assert!(killed.success());
    screen.ends_well(0);
    let mut screen = OnTerminal::start(&["--board", "sim:openscout", "drive"]);
    screen.until_shows("dhb0");
    screen.press("\x03");
    screen.ends_well(130);
    screen.until_shows("interrupted; the board is disarmed");
}

/// Serves a board on `--pty` or `--slcan` at this path.
fn serve(how: &str, link: &Path) -> Child {
    let mut server = program::command(&["sim", "serve", "openscout", &format!("{how}={}", link.display())])
        .stdout(Stdio::piped())
        .spawn()
        .expect("r4 starts");
    let mut line = String::new();
    BufReader::new(server.stdout.take().expect("piped")).read_line(&mut line).expect("a line");
    assert!(line.contains(&how[2..]), "{line}");
    server
}

#[test]
fn monitor_shows_that_a_serial_link_is_lost_and_connects_again() {
    loses_and_finds("--pty", "serial:");
}

#[test]
fn monitor_shows_that_a_can_link_is_lost_and_connects_again() {
    loses_and_finds("--slcan", "can:slcan:");
}

fn loses_and_finds(how: &str, link_kind: &str) {
    let folder = TempDir::new().expect("a folder");
    let link = folder.path().join("board");
    let mut server = serve(how, &link);
    let mut screen = OnTerminal::start(&["--board", &format!("{link_kind}{}", link.display()), "monitor"]);
    screen.until(|text| state(text) == "DISARMED" && text.contains("12.60 V"));
    screen.press("a");
    screen.until(|text| state(text) == "ARMED");
    server.kill().expect("it runs");
    server.wait().expect("it ran");
    let text = screen.until(|text| state(text) == "NO" && text.contains("LOST"));
    assert!(text.contains("last state armed"), "{text}");
    let mut server = serve(how, &link);
    screen.until(|text| state(text) == "DISARMED" && text.contains("the link is back"));
    // Keys work without a board, too.
    server.kill().expect("it runs");
    server.wait().expect("it ran");
    screen.until(|text| state(text) == "NO" && text.contains("LOST"));
    screen.press("q");
    screen.ends_well(0);
}

// drive

/// Reads set point and speed of a wheel, deg/s.
fn wheel(text: &str, channel: &str) -> Option<(f64, f64)> {
    let line = text.lines().find(|line| line.contains(channel))?;
    let words: Vec<&str> = line.split_whitespace().collect();
    Some((words.get(2)?.parse().ok()?, words.get(4)?.parse().ok()?))
}

#[test]
fn drive_turns_wheels_while_space_is_held() {
    drives("sim:openscout");
}

#[test]
fn drive_turns_wheels_of_a_board_on_a_can_bus() {
    let folder = TempDir::new().unwrap();
    let link = folder.path().join("board");
    let mut server = serve("--slcan", &link);
    drives(&format!("can:slcan:{}", link.display()));
    server.kill().unwrap();
    server.wait().unwrap();
}

fn drives(board: &str) {
    let mut screen = OnTerminal::start(&["--board", board, "drive"]);
    screen.until(|text| state(text) == "DISARMED" && wheel(text, "dhb3").is_some());
    screen.press("\r");
    screen.until(|text| state(text) == "ARMED");
    // Two steps forwards, one to the left, and the dead-man key only once.
    screen.press("wwa ");
    let text = screen.until(|text| text.contains("40 % forwards") && text.contains("20 % left"));
    assert!(text.contains("released"), "{text}");
    let told = |text: &str| wheel(text, "dhb0").zip(wheel(text, "dhb1"));
    let text = screen.hold(" ", |text| {
        told(text).is_some_and(|(left, right)| right.1 > 100.0 && left.1 > 50.0 && right.0 > left.0 && left.0 > 0.0)
    });
    assert!(text.contains("HELD"), "{text}");
    // The key is released.
    let text = screen.until(|text| text.contains("released"));
    assert_eq!(told(&text).map(|(left, right)| (left.0, right.0)), Some((0.0, 0.0)));
    let still = |speed: f64| speed.abs() < 5.0;
    screen.until(|text| told(text).is_some_and(|(left, right)| still(left.1) && still(right.1)));
    assert_eq!(state(&screen.grid.text()), "ARMED");
    screen.press("\x1b");
    screen.until(|text| state(text) == "TRIPPED" && text.contains("host stop"));
    screen.press("c");
    screen.until(|text| state(text) == "DISARMED");
    screen.press("q");
    screen.ends_well(0);
}

/// A steered front axle, and a drive without a speed sensor.
#[test]
fn drive_steers_front_wheels_while_space_is_held() {
    let mut screen = OnTerminal::start(&["--board", "sim:openpodcar", "drive"]);
    // Angle in degrees; to the right is negative.
    let front = |text: &str| {
        let line = text.lines().find(|line| line.contains("front wheels"))?;
        let words: Vec<&str> = line.split_whitespace().collect();
        let angle: f64 = words.get(3)?.parse().ok()?;
        Some(if words.get(5)?.starts_with("right") { -angle } else { angle })
    };
    screen.until(|text| state(text) == "DISARMED" && front(text).is_some());
    screen.press("\r");
    screen.until(|text| state(text) == "ARMED");
    screen.press("wwddd ");
    let text = screen.until(|text| text.contains("40 % forwards") && text.contains("60 % right"));
    assert!(text.contains("released") && text.contains("stay as they are"), "{text}");
    let duty = |text: &str| {
        text.lines().find(|line| line.starts_with("drive"))?.split_whitespace().last()?.parse::<f64>().ok()
    };
    // 60 % of 25 degrees are 15; 40 % of 0.2 m/s are a duty of 0.039 of the 2.04 m/s at full duty.
    let text = screen.hold(" ", |text| {
        front(text).is_some_and(|angle| (angle + 15.0).abs() < 1.0)
            && duty(text).is_some_and(|duty| (duty - 0.039).abs() < 0.002)
    });
    assert!(text.contains("HELD") && text.contains("set point 14.99 deg right"), "{text}");
    let text = screen.until(|text| text.contains("released") && duty(text).is_some_and(|duty| duty.abs() < 0.001));
    assert!(text.contains("stay as they are") && front(&text).is_some_and(|angle| angle < -10.0), "{text}");
    screen.press("q");
    screen.ends_well(0);
}

#[test]
fn drive_ends_with_the_link() {
    let folder = TempDir::new().unwrap();
    let link = folder.path().join("board");
    let mut server = serve("--pty", &link);
    // The robot's file is found by the name that the board reports.
    let mut screen = OnTerminal::start(&["--board", &format!("serial:{}", link.display()), "drive"]);
    screen.until(|text| state(text) == "DISARMED" && wheel(text, "dhb3").is_some());
    server.kill().unwrap();
    server.wait().unwrap();
    screen.ends_well(4);
    screen.until_shows("r4: ");
}

/// Returns exit code, stdout and stderr of a run without a terminal.
fn seen(args: &[&str]) -> (Option<i32>, String, String) {
    let output = program::command(args).output().expect("r4 starts");
    let text = |bytes| String::from_utf8(bytes).expect("text");
    (output.status.code(), text(output.stdout), text(output.stderr))
}

#[test]
fn what_cannot_be_driven_is_told_before_the_screen() {
    for (args, word, code) in [
        (["--board", "sim:osmc-bench", "drive", ""].as_slice(), "of this robot are unknown", 1),
        (&["--board", "sim:openpodcar", "drive", "--speed=90%"], "takes a duty", 3),
        (&["--board", "sim:openscout", "drive", "--left=dhb0,dhb2", "--right=dhb0"], "named twice", 1),
        (&["--board", "sim:openscout", "drive", "--left=supply0", "--right=dhb0"], "cannot be commanded", 3),
        (&["--board", "sim:openscout", "drive", "--speed=1000rpm"], "takes a speed", 3),
        (&["--board", "sim:openscout", "drive", "--speed=-1rpm"], "above 0", 1),
        (&["--board", "sim:openscout", "drive", "--speed=90deg"], "takes as speed", 3),
        (&["--board", "sim:openscout", "drive", "--gamepad"], "gamepad", 1),
    ] {
        let args: Vec<&str> = args.iter().copied().filter(|arg| !arg.is_empty()).collect();
        let mut screen = OnTerminal::start(&args);
        screen.ends_well(code);
        let text = screen.until_shows("r4: ");
        let text = text.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(text.contains(word), "{args:?}: {text}");
    }
}

#[test]
fn without_a_terminal_there_is_a_message() {
    for (verb, word) in [("monitor", "r4 watch"), ("drive", "r4 speed")] {
        let (code, out, err) = seen(&["--board", "sim:openscout", verb]);
        assert_eq!((code, out.as_str()), (Some(1), ""), "{err}");
        assert!(err.contains("needs a terminal") && err.contains(word), "{err}");
        let (code, _, err) = seen(&["--board", "sim:openscout", "--json", verb]);
        assert!(code == Some(1) && err.contains("no JSON"), "{err}");
    }
}

// completions, man

/// Returns the verbs that the help lists.
fn verbs() -> BTreeSet<String> {
    let (_, help, _) = seen(&["help"]);
    let listed = help.lines().skip_while(|line| *line != "Commands:").skip(1).take_while(|line| !line.is_empty());
    // Continued lines of descriptions are indented further.
    let verbs = listed.filter(|line| line.starts_with("  ") && !line.starts_with("   "));
    verbs.filter_map(|line| line.split_whitespace().next()).filter(|verb| *verb != "help").map(str::to_owned).collect()
}

/// Returns the program's answer to a shell that completes the last of `words`.
fn completed(shell: &str, words: &[&str]) -> Vec<String> {
    let mut command = program::command(&["--"]);
    command.args(words).env("R4_COMPLETE", shell).env("_CLAP_IFS", "\n");
    command.env("_CLAP_COMPLETE_INDEX", (words.len() - 1).to_string());
    let output = command.output().expect("r4 starts");
    assert!(output.status.success() && output.stderr.is_empty(), "{shell} {words:?}: {output:?}");
    String::from_utf8_lossy(&output.stdout).lines().map(str::to_owned).collect()
}

#[test]
fn every_shell_can_complete_every_verb() {
    let verbs = verbs();
    assert!(verbs.len() > 20 && verbs.contains("monitor"), "{verbs:?}");
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let (code, script, err) = seen(&["completions", shell]);
        assert_eq!((code, err.as_str()), (Some(0), ""));
        assert!(script.contains("R4_COMPLETE"), "{script}");
        let offered = completed(shell, &["r4", ""]);
        for verb in &verbs {
            // Some shells also get a description.
            assert!(offered.iter().any(|line| line.starts_with(verb.as_str())), "{shell} does not know {verb}");
        }
    }
    let (code, _, err) = seen(&["completions", "command.com"]);
    assert!(code == Some(2) && err.contains("zsh"), "{err}");
}

/// Completes words in a real bash, which also breaks them at colons.
#[test]
fn bash_completes() {
    let (_, script, _) = seen(&["completions", "bash"]);
    let folder = TempDir::new().unwrap();
    let file = folder.path().join("r4.bash");
    fs::write(&file, script).unwrap();
    let program = Path::new(env!("CARGO_BIN_EXE_r4")).parent().unwrap().display();
    let offered = |line: &str| {
        let ask = format!(
            "PATH={program}:$PATH; source {}; COMP_LINE='{line}'; COMP_POINT=${{#COMP_LINE}}; _r4; echo ${{COMPREPLY[@]}}",
            file.display()
        );
        let mut bash = Command::new("bash");
        bash.args(["--norc", "-c", &ask]).current_dir(folder.path()).env_remove("R4_BOARD");
        let output = bash.env("XDG_CACHE_HOME", folder.path()).output().ok()?;
        Some(String::from_utf8_lossy(&output.stdout).trim().to_owned())
    };
    if offered("r4").is_none() {
        eprintln!("not run: there is no bash");
        return;
    }
    fs::write(folder.path().join("mine.toml"), "").unwrap();
    for (line, expected) in [
        ("r4 mo", "move monitor"),
        ("r4 relay rel", "relay0 relay1"),
        ("r4 --board sim:openscout speed ", "dhb0 dhb1 dhb2 dhb3"),
        ("r4 speed --board=sim:openscout ", "dhb0 dhb1 dhb2 dhb3"),
        // Without the text before the last colon, which bash keeps.
        ("r4 --board sim:osmc", "osmc-bench osmc-evaluation"),
        ("r4 --board=sim:osmc-b", "osmc-bench"),
        ("r4 watch --board sim:min", "mine.toml"),
        ("r4 --board can:can0 relay rel", ""),
        ("r4 --board sim:openscout watch --ra", "--rate"),
    ] {
        assert_eq!(offered(line).as_deref(), Some(expected), "{line}");
    }
}

/// Completes channels of a board at the other end of a link, which is not asked again: those that it had when it was
/// last seen.
#[test]
fn channels_of_a_board_are_those_last_seen() {
    let cache = TempDir::new().unwrap();
    let tty = cache.path().join("tty");
    let board = format!("serial:{}", tty.display());
    let with = |args: &[&str]| {
        let mut command = program::command(args);
        command.env("XDG_CACHE_HOME", cache.path()).env("_CLAP_COMPLETE_INDEX", "4").env("_CLAP_IFS", "\n");
        command
    };
    let offered = || {
        let output =
            with(&["--", "r4", "--board", &board, "watch", "dhb"]).env("R4_COMPLETE", "bash").output().unwrap();
        String::from_utf8_lossy(&output.stdout).replace('\n', " ")
    };
    assert_eq!(offered(), "", "it was never seen");
    let mut serving =
        program::start(program::command(&["sim", "serve", "openscout", &format!("--pty={}", tty.display())]));
    program::next(serving.out.as_ref().unwrap(), serving.begin).unwrap();
    serving.out = None;
    assert!(with(&["--board", &board, "info"]).output().unwrap().status.success());
    drop(serving);
    assert_eq!(offered(), "dhb0 dhb1 dhb2 dhb3");
}

#[test]
fn every_verb_has_a_page() {
    let folder = TempDir::new().unwrap();
    let out = folder.path().join("man1");
    let (code, printed, err) = seen(&["man", "--out", out.to_str().unwrap()]);
    assert_eq!((code, printed.as_str(), err.as_str()), (Some(0), "", ""));
    let page = |name: &str| fs::read_to_string(out.join(name)).unwrap_or_else(|error| panic!("{name}: {error}"));
    for verb in verbs() {
        assert!(page(&format!("r4-{verb}.1")).contains("EXIT STATUS"), "{verb}");
    }
    assert!(page("r4-sim-serve.1").contains("slcan"));
    let program = page("r4.1");
    for there in [".SH NAME", "EXIT STATUS", "Ctrl\\-C", "\\-\\-board"] {
        assert!(program.contains(there), "{there} is not in\n{program}");
    }
    assert_eq!(seen(&["man"]).1, program);
    assert_eq!(seen(&["man", "sim", "serve"]).1, page("r4-sim-serve.1"));
    let (code, _, err) = seen(&["man", "fly"]);
    assert!(code == Some(1) && err.contains("no command `fly`"), "{err}");
}
