//! Questions to the person at the robot.

use std::{collections::VecDeque, io, thread};

use futures::channel::oneshot;
use r4_rig::{
    Session,
    calibrate::{NoAnswer, Person},
};

/// Source of the answers.
pub(super) enum Answers {
    /// Answers of `--answers`, in the order of the questions.
    Given(VecDeque<String>),
    /// Lines of standard input, one per answer.
    Typed,
}

impl Answers {
    pub(super) fn new(given: &[String]) -> Self {
        if given.is_empty() { Self::Typed } else { Self::Given(given.iter().cloned().collect()) }
    }
}

impl Person for Answers {
    /// Asks on stderr. A simulated board's time stands still meanwhile; the session with a real board is kept alive.
    async fn ask(&mut self, session: &Session<'_>, question: &str) -> Result<String, NoAnswer> {
        eprintln!("{question}");
        let nothing = || NoAnswer { why: format!("no answer to: {question}") };
        let answer = match self {
            Self::Given(answers) => answers
                .pop_front()
                .ok_or_else(|| NoAnswer { why: format!("--answers has no answer to: {question}") })?,
            Self::Typed if session.virtual_board().is_ok() => line().ok_or_else(nothing)?,
            Self::Typed => {
                let (sender, receiver) = oneshot::channel();
                // Read in a thread of its own: the heartbeat must continue while a person thinks.
                thread::spawn(move || sender.send(line()));
                receiver.await.ok().flatten().ok_or_else(nothing)?
            }
        };
        Ok(answer.trim().to_owned())
    }
}

/// Reads a line of standard input; `None` at its end.
fn line() -> Option<String> {
    let mut line = String::new();
    let read = io::stdin().read_line(&mut line).ok()?;
    (read > 0).then_some(line)
}
