//! The program under test, as a user runs it.

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

/// A run that is not over by then hangs. The longest are those on emulated boards: 34 s by itself on a slow machine.
pub(crate) const PATIENCE: Duration = Duration::from_secs(180);

/// A started `r4`; stopped when dropped.
pub(crate) struct Running {
    pub(crate) child: Child,
    pub(crate) begin: Instant,
    pub(crate) out: Option<Receiver<String>>,
    pub(crate) err: Receiver<String>,
}

/// What a user sees of a run.
#[derive(Debug)]
pub(crate) struct Seen {
    /// `None` when a signal ended it.
    pub(crate) code: Option<i32>,
    pub(crate) out: String,
    pub(crate) err: String,
}

/// `r4` with these arguments, away from the sources and from the user's settings.
pub(crate) fn command(args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_r4"));
    command
        .args(args)
        .current_dir(env!("CARGO_TARGET_TMPDIR"))
        // Named, as most users do; what is said where no board is named has its own test.
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

/// Lines as they come, read in a thread: the pipe is closed when the receiver is dropped.
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

/// The next line, or `None` at the end.
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
        // After `finish` there is nothing left to kill.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

pub(crate) fn r4(args: &[&str]) -> Seen {
    start(command(args)).finish()
}

/// A run that must succeed and say nothing on stderr.
pub(crate) fn good(args: &[&str]) -> String {
    let seen = r4(args);
    assert!(seen.code == Some(0) && seen.err.is_empty(), "{args:?}: {seen:?}");
    seen.out
}

/// The one JSON object on stdout of a run that must succeed.
pub(crate) fn good_json(args: &[&str]) -> Value {
    object(&good(args))
}

pub(crate) fn object(text: &str) -> Value {
    let value: Value = serde_json::from_str(text).unwrap_or_else(|why| panic!("{why}: {text}"));
    assert!(value.is_object(), "{text}");
    value
}

/// What is wrong with how bad input was received, if anything.
pub(crate) fn complaint(args: &[&str], says: &[&str]) -> Option<String> {
    let seen = r4(args);
    let told = says.iter().all(|says| seen.err.contains(says)) && !seen.err.contains("panicked");
    let refused = matches!(seen.code, Some(1..=5));
    // With `--json` there is an object, which says the same.
    let out = match args.contains(&"--json") {
        true => object(&seen.out)["error"]["message"].as_str().is_some_and(|said| seen.err.contains(said)),
        false => seen.out.is_empty(),
    };
    let refused = refused && out;
    (!told || !refused).then(|| format!("{args:?} should say {says:?}: {seen:#?}\n"))
}

/// Each is refused: an exit code of a failure, a message on stderr with all of these words, nothing but that on stdout.
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
