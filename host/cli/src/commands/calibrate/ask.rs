//! Questions to whoever stands at the robot.

use std::{collections::VecDeque, io, thread};

use futures::channel::oneshot;
use r4_rig::{
    Session,
    calibrate::{NoAnswer, Person},
};

/// Where answers come from.
pub(super) enum Answers {
    /// From `--answers`, in the order of the questions.
    Given(VecDeque<String>),
    /// A line of standard input each.
    Typed,
}

impl Answers {
    pub(super) fn new(given: &[String]) -> Self {
        if given.is_empty() { Self::Typed } else { Self::Given(given.iter().cloned().collect()) }
    }
}

impl Person for Answers {
    /// Asks on stderr. Time stands still meanwhile on a simulated board; the session with a real one is kept.
    async fn ask(&mut self, session: &Session<'_>, question: &str) -> Result<String, NoAnswer> {
        eprintln!("{question}");
        let nothing = || NoAnswer { why: format!("nothing was answered to: {question}") };
        let answer = match self {
            Self::Given(answers) => {
                answers.pop_front().ok_or_else(|| NoAnswer { why: format!("--answers has none to: {question}") })?
            }
            Self::Typed if session.virtual_board().is_ok() => line().ok_or_else(nothing)?,
            Self::Typed => {
                let (sender, receiver) = oneshot::channel();
                // The heartbeat must go on while a person thinks.
                thread::spawn(move || sender.send(line()));
                receiver.await.ok().flatten().ok_or_else(nothing)?
            }
        };
        Ok(answer.trim().to_owned())
    }
}

/// The next line of standard input; `None` at its end.
fn line() -> Option<String> {
    let mut line = String::new();
    let read = io::stdin().read_line(&mut line).ok()?;
    (read > 0).then_some(line)
}
