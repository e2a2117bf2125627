//! Questions to whoever stands at the robot.

use std::{collections::VecDeque, io, thread};

use anyhow::{Context, anyhow};
use futures::channel::oneshot;

use crate::session::Session;

/// Where answers come from.
pub(super) enum Answers {
    /// From `--answers`, in the order of the questions.
    Given(VecDeque<String>),
    /// A line of standard input each.
    Typed,
    /// From whoever knows the truth.
    #[cfg(test)]
    Known(Box<dyn FnMut(&Session<'_>) -> String>),
}

impl Answers {
    pub(super) fn new(given: &[String]) -> Self {
        if given.is_empty() { Self::Typed } else { Self::Given(given.iter().cloned().collect()) }
    }

    /// Asks on stderr and returns the answer. Time stands still meanwhile on a simulated board; the session with a real one is
    /// kept.
    ///
    /// # Errors
    /// When there is no answer.
    pub(super) async fn ask(&mut self, session: &Session<'_>, question: &str) -> anyhow::Result<String> {
        eprintln!("{question}");
        let nothing = || anyhow!("nothing was answered to: {question}");
        let answer = match self {
            Self::Given(answers) => {
                answers.pop_front().with_context(|| format!("--answers has none to: {question}"))?
            }
            #[cfg(test)]
            Self::Known(answer) => answer(session),
            Self::Typed if session.virtual_board().is_ok() => line().with_context(nothing)?,
            Self::Typed => {
                let (sender, receiver) = oneshot::channel();
                // The heartbeat must go on while a person thinks.
                thread::spawn(move || sender.send(line()));
                receiver.await.ok().flatten().with_context(nothing)?
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
