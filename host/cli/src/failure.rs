//! Kind of failure that ended a command: an exit code, and an object of `--json`, for scripts.

use std::process::ExitCode;

use r4_driver::Error;
use r4_links::OpenError;
use r4_protocol::{ChannelId, Refusal};
use r4_rig::{Error as RigError, Interrupted, NotVirtual};
use serde::Serialize;

use crate::{args::Args, choice::Unclear, output};

/// Kinds of failures; `docs/program.md` lists them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub(crate) enum Kind {
    /// The command line was not understood.
    Usage,
    /// The board refused the request, or the program refused it for the board.
    Refused,
    /// No board was named, and both a real and a simulated one could be meant.
    Unclear,
    /// No board was found, or access to it is denied.
    NoBoard,
    /// Another program uses the board.
    InUse,
    /// The link to the board was lost, or the board does not answer.
    LinkLost,
    /// A motor did not reach its set point.
    NotReached,
    /// The board tripped or was disarmed meanwhile.
    Stopped,
    /// The user pressed Ctrl-C.
    Interrupted,
    /// Any other failure, such as an unreadable file.
    Failed,
}

impl Kind {
    fn exit_code(self) -> u8 {
        match self {
            Self::NotReached | Self::Failed => 1,
            Self::Usage => 2,
            Self::Refused | Self::Unclear => 3,
            Self::NoBoard | Self::InUse | Self::LinkLost => 4,
            Self::Stopped => 5,
            Self::Interrupted => 130,
        }
    }

    /// True for failures on the board or on the link to it.
    fn is_of_a_board(self) -> bool {
        !matches!(self, Self::Usage | Self::Failed)
    }
}

#[derive(Serialize)]
struct Object<'a> {
    error: Failure<'a>,
}

#[derive(Serialize)]
struct Failure<'a> {
    kind: Kind,
    message: &'a str,
    #[serde(skip_serializing_if = "Option::is_none")]
    board: Option<String>,
    #[serde(skip_serializing_if = "Option::is_none")]
    channel: Option<String>,
}

/// Prints the error on stderr, and with `--json` as an object on stdout; returns the exit code.
pub(crate) fn report(args: &Args, error: &anyhow::Error) -> ExitCode {
    let (kind, channel) = classify(error);
    let message = format!("{error:#}");
    eprintln!("r4: {message}");
    if args.json {
        let board = kind.is_of_a_board().then(|| args.board.to_string());
        print(Failure { kind, message: &message, board, channel: channel.map(|channel| channel.to_string()) });
    }
    ExitCode::from(kind.exit_code())
}

/// Prints a usage error as [`report`] does, or the text of `--help` or `--version`; returns the exit code.
pub(crate) fn report_usage(error: &clap::Error, is_json: bool) -> ExitCode {
    // If neither output can be written, only the exit code remains.
    let _ = error.print();
    if !error.use_stderr() {
        return ExitCode::SUCCESS;
    }
    if is_json {
        let message = error.render().to_string();
        let message = message.trim_start_matches("error: ").trim_end();
        print(Failure { kind: Kind::Usage, message, board: None, channel: None });
    }
    ExitCode::from(Kind::Usage.exit_code())
}

fn print(failure: Failure<'_>) {
    // The reader may have closed the output; the exit code remains.
    let _ = output::json(&Object { error: failure });
}

/// Kind of an error, and the channel that it concerns.
fn classify(error: &anyhow::Error) -> (Kind, Option<ChannelId>) {
    // Contexts wrap the error that decides the kind.
    for cause in error.chain() {
        if let Some(error) = cause.downcast_ref::<Error>() {
            return of_driver(error);
        }
        if let Some(error) = cause.downcast_ref::<OpenError>() {
            return (of_open(error), None);
        }
        if cause.is::<Unclear>() {
            return (Kind::Unclear, None);
        }
        match cause.downcast_ref().map(RigError::innermost) {
            Some(RigError::Board(error)) => return of_driver(error),
            Some(RigError::Open(error)) => return (of_open(error), None),
            Some(RigError::Unsuitable(error)) => return (Kind::Refused, Some(error.channel)),
            Some(RigError::NotReached(error)) => return (Kind::NotReached, Some(error.channel)),
            Some(RigError::StateTimedOut { .. }) => return (Kind::NotReached, None),
            Some(RigError::NotVirtual(_)) => return (Kind::Refused, None),
            Some(RigError::Interrupted(_)) => return (Kind::Interrupted, None),
            _ => {}
        }
        if cause.is::<NotVirtual>() {
            return (Kind::Refused, None);
        }
        if cause.is::<Interrupted>() {
            return (Kind::Interrupted, None);
        }
    }
    (Kind::Failed, None)
}

fn of_driver(error: &Error) -> (Kind, Option<ChannelId>) {
    match *error {
        Error::Refused(Refusal::InUse) => (Kind::InUse, None),
        Error::Refused(
            Refusal::UnknownChannel { channel }
            | Refusal::WrongMode { channel, .. }
            | Refusal::NotFinite { channel }
            | Refusal::OutOfRange { channel, .. }
            | Refusal::BadGains { channel },
        ) => (Kind::Refused, Some(channel)),
        Error::Refused(_)
        | Error::UnknownAnswer { .. }
        | Error::NameTooLong { .. }
        | Error::StreamOpen
        | Error::CycleLength { .. } => (Kind::Refused, None),
        Error::TimedOut { .. } | Error::LinkLost { .. } | Error::LinkFailed { .. } | Error::WrongReply { .. } => {
            (Kind::LinkLost, None)
        }
        Error::Stopped { .. } => (Kind::Stopped, None),
        Error::NotFollowed { channel } | Error::NotHomed { channel, .. } | Error::NotSettled { channel, .. } => {
            (Kind::NotReached, Some(channel))
        }
    }
}

fn of_open(error: &OpenError) -> Kind {
    match error {
        OpenError::Busy(_) => Kind::InUse,
        _ => Kind::NoBoard,
    }
}

#[cfg(test)]
mod tests {
    use anyhow::Context;
    use r4_protocol::{Causes, ChannelKind};
    use r4_rig::{NotReached, Unsuitable, scenario::ScenarioError};

    use super::*;

    #[test]
    fn kinds_are_found_under_their_contexts() {
        let channel = ChannelId::new(ChannelKind::Osmc, 3);
        let driver = |error: Error| Err::<(), _>(error).context("cannot arm").context("serial:board").unwrap_err();
        for (error, kind, about) in [
            (driver(Refusal::UnknownChannel { channel }.into()), Kind::Refused, Some(channel)),
            (driver(Refusal::InUse.into()), Kind::InUse, None),
            (driver(Error::LinkLost { silent_ms: 400 }), Kind::LinkLost, None),
            (driver(Error::NotHomed { channel, after_s: 1.0 }), Kind::NotReached, Some(channel)),
            (driver(Error::Stopped { causes: Causes::NONE }), Kind::Stopped, None),
            (RigError::from(Unsuitable { channel, why: String::new() }).into(), Kind::Refused, Some(channel)),
            (RigError::from(NotReached { channel, how: String::new() }).into(), Kind::NotReached, Some(channel)),
            (
                RigError::from(ScenarioError::Step { at_s: 1.0, source: Error::LinkLost { silent_ms: 400 } }).into(),
                Kind::LinkLost,
                None,
            ),
            (OpenError::Busy("/dev/ttyACM0".into()).into(), Kind::InUse, None),
            (OpenError::NoBoard.into(), Kind::NoBoard, None),
            (Interrupted.into(), Kind::Interrupted, None),
            (anyhow::anyhow!("a file"), Kind::Failed, None),
        ] {
            assert_eq!(classify(&error), (kind, about), "{error:#}");
        }
    }
}
