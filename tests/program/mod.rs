//! Program under test, as a user runs it.

#![allow(dead_code, reason = "every file of tests uses a part of it")]

use std::{
    io::{BufRead, BufReader, Read},
    path::Path,
    process::{Child, Command, Stdio},
    sync::mpsc::{Receiver, RecvTimeoutError, channel},
    thread,
    time::{Duration, Instant},
};

use serde_json::Value;

/// Time-out of a run. The longest are on emulated boards: 34 s by itself on a slow machine.
pub(crate) const PATIENCE: Duration = Duration::from_secs(180);

/// Started `r4`, which is stopped when dropped.
pub(crate) struct Running {
    pub(crate) child: Child,
    pub(crate) begin: Instant,
    pub(crate) out: Option<Receiver<String>>,
    pub(crate) err: Receiver<String>,
}

/// Result of a run, as a user sees it.
#[derive(Debug)]
pub(crate) struct Seen {
    /// Exit code; `None` when a signal ended the program.
    pub(crate) code: Option<i32>,
    pub(crate) out: String,
    pub(crate) err: String,
}

/// Makes a command of `r4` with these arguments, away from the sources and from the user's settings.
pub(crate) fn command(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_r4"));
    command
        .args(args)
        .current_dir(env!("CARGO_TARGET_TMPDIR"))
        // A board is named, as most users do; the case without one has its own test.
        .env("R4_BOARD", "sim:osmc-bench")
        .env("XDG_CACHE_HOME", env!("CARGO_TARGET_TMPDIR"))
        .env_remove("R4_FLASH")
        .env_remove("R4_KEY")
        .stdin(Stdio::null());
    command
}

pub(crate) fn start(mut command: Command) -> Running {
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("r4 starts");
    let out = child.stdout.take().map(lines);
    let err = child.stderr.take().map(lines).expect("piped");
    Running { child, begin: Instant::now(), out, err }
}

/// Reads lines in a thread as they come: the pipe is closed when the receiver is dropped.
pub(crate) fn lines(pipe: impl Read + Send + 'static) -> Receiver<String> {
    let (sender, receiver) = channel();
    thread::spawn(move || {
        for line in BufReader::new(pipe).lines().map_while(Result::ok) {
            if sender.send(line).is_err() {
                break;
            }
        }
    });
    receiver
}

/// Returns the next line, or `None` at the end.
pub(crate) fn next(from: &Receiver<String>, begin: Instant) -> Option<String> {
    match from.recv_timeout(PATIENCE.saturating_sub(begin.elapsed())) {
        Ok(line) => Some(line),
        Err(RecvTimeoutError::Disconnected) => None,
        Err(RecvTimeoutError::Timeout) => panic!("r4 is still running after {PATIENCE:?}"),
    }
}

pub(crate) fn rest(from: &Receiver<String>, begin: Instant) -> String {
    std::iter::from_fn(|| next(from, begin)).fold(String::new(), |all, line| all + &line + "\n")
}

impl Running {
    pub(crate) fn finish(mut self) -> Seen {
        let out = self.out.take().map(|out| rest(&out, self.begin)).unwrap_or_default();
        let err = rest(&self.err, self.begin);
        let code = self.child.wait().expect("it has ended").code();
        Seen { code, out, err }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        // After `finish` no process is left, and these fail harmlessly.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

pub(crate) fn r4(args: &[&str]) -> Seen {
    start(command(args)).finish()
}

/// Returns the output of a run that must succeed and print nothing on stderr.
pub(crate) fn good(args: &[&str]) -> String {
    let seen = r4(args);
    assert!(seen.code == Some(0) && seen.err.is_empty(), "{args:?}: {seen:?}");
    seen.out
}

/// Returns the one JSON object on stdout of a run that must succeed.
pub(crate) fn good_json(args: &[&str]) -> Value {
    object(&good(args))
}

pub(crate) fn object(text: &str) -> Value {
    let value: Value = serde_json::from_str(text).unwrap_or_else(|why| panic!("{why}: {text}"));
    assert!(value.is_object(), "{text}");
    value
}

/// Returns what is wrong with the answer to bad input, if anything.
pub(crate) fn complaint(args: &[&str], says: &[&str]) -> Option<String> {
    let seen = r4(args);
    let told = says.iter().all(|says| seen.err.contains(says)) && !seen.err.contains("panicked");
    let refused = matches!(seen.code, Some(1..=5));
    // With `--json` there is an object with the same message.
    let out = match args.contains(&"--json") {
        true => object(&seen.out)["error"]["message"].as_str().is_some_and(|said| seen.err.contains(said)),
        false => seen.out.is_empty(),
    };
    let refused = refused && out;
    (!told || !refused).then(|| format!("{args:?} should say {says:?}: {seen:#?}\n"))
}

/// Expects each run to be refused: with the exit code of a failure, a message on stderr with all of these words, and
/// nothing but that on stdout.
pub(crate) fn all_refused<'a>(cases: impl IntoIterator<Item = (&'a [&'a str], &'a [&'a str])>) {
    let complaints: String = cases.into_iter().filter_map(|(args, says)| complaint(args, says)).collect();
    assert!(complaints.is_empty(), "{complaints}");
}

pub(crate) fn number(value: &Value, field: &str) -> f64 {
    value[field].as_f64().unwrap_or_else(|| panic!("`{field}` is a number in {value}"))
}

pub(crate) fn text<'v>(value: &'v Value, field: &str) -> &'v str {
    value[field].as_str().unwrap_or_else(|| panic!("`{field}` is text in {value}"))
}

pub(crate) fn array<'v>(value: &'v Value, field: &str) -> &'v [Value] {
    value[field].as_array().unwrap_or_else(|| panic!("`{field}` is a list in {value}"))
}

pub(crate) fn path(path: &Path) -> &str {
    path.to_str().expect("a temporary path is UTF-8")
}
