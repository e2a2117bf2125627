//! Messages between a page and this program on the page's socket, as JSON.

use serde::{Deserialize, Serialize};

use crate::{
    floor::{Place, Shape},
    view::{Channel, Values},
};

/// Message of a page.
#[derive(Debug, PartialEq, Eq, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub(crate) enum FromPage {
    /// First: the token that it was served with, or that its user has entered.
    Hello {
        /// Token, 64 hex digits.
        token: String,
    },
    /// "I am alive, and I have shown this".
    Beat {
        /// [`Look::tick_ms`] of the newest look that it has.
        tick_ms: u64,
    },
    /// Press of a button.
    Ask(Ask),
}

/// Request of a user to the board.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Ask {
    /// Arms the board: outputs may move.
    Arm,
    /// Disarms the board: outputs are safe.
    Disarm,
    /// Leaves a trip behind.
    Clear,
    /// Stops the board: it trips.
    Stop,
}

/// Message to a page.
#[derive(Debug, Serialize)]
#[serde(rename_all = "snake_case")]
pub(crate) enum ToPage<'a> {
    /// First: which board it is.
    Board(Card<'a>),
    /// State of the board at present.
    Look(Look<'a>),
    /// Counters of board and link.
    Counters(Vec<Counter>),
    /// Result of a request.
    Answer {
        /// Request that this answers.
        ask: Ask,
        /// `None` where it was done.
        error: Option<String>,
    },
    /// The board's link has ended.
    Lost {
        /// Reason for the end, in words.
        why: &'a str,
    },
    /// The page is not let in.
    Refused {
        /// Why, and what to do.
        why: String,
    },
}

/// Which board it is.
#[derive(Debug, Serialize)]
pub(crate) struct Card<'a> {
    pub(crate) address: &'a str,
    /// `simulated`, `emulated` or `real`.
    pub(crate) kind: &'static str,
    pub(crate) robot: &'a str,
    pub(crate) firmware: &'a str,
    pub(crate) link_timeout_ms: u16,
    /// Period in which the page has to send heartbeats, ms.
    pub(crate) beat_ms: u32,
    pub(crate) channels: &'a [Channel],
    /// `None` where there is no view of the floor.
    pub(crate) shape: Option<Shape<'a>>,
}

/// State of the board at present.
#[derive(Debug, Serialize)]
pub(crate) struct Look<'a> {
    /// The program's clock, ms: the page's beats carry it back.
    pub(crate) tick_ms: u64,
    /// The board's clock in its last telemetry, s.
    pub(crate) board_s: f64,
    /// Time since the board's last message, ms.
    pub(crate) silent_ms: u64,
    /// `disarmed`, `armed` or `tripped`.
    pub(crate) state: String,
    pub(crate) causes: Vec<Reason>,
    /// Next step for the user.
    pub(crate) next: &'static str,
    /// Windings that are hot, in words.
    pub(crate) hot: Vec<String>,
    /// Client that commands: `this page` or `another program`; absent without one.
    pub(crate) commands: Option<&'static str>,
    pub(crate) values: &'a [Values],
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) place: Option<Place>,
}

/// Why the board has tripped.
#[derive(Debug, Serialize)]
pub(crate) struct Reason {
    pub(crate) cause: String,
    pub(crate) advice: &'static str,
}

/// A number worth seeing.
#[derive(Debug, Serialize)]
pub(crate) struct Counter {
    pub(crate) name: &'static str,
    pub(crate) value: String,
    /// True if the value indicates a problem.
    pub(crate) is_bad: bool,
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn read(text: &str) -> Option<FromPage> {
        serde_json::from_str(text).ok()
    }

    #[test]
    fn pages_say_this_and_nothing_else() {
        assert_eq!(read(r#"{"hello":{"token":"5a"}}"#), Some(FromPage::Hello { token: "5a".into() }));
        assert_eq!(read(r#"{"beat":{"tick_ms":17}}"#), Some(FromPage::Beat { tick_ms: 17 }));
        for (word, ask) in [("arm", Ask::Arm), ("disarm", Ask::Disarm), ("clear", Ask::Clear), ("stop", Ask::Stop)] {
            assert_eq!(read(&format!(r#"{{"ask":"{word}"}}"#)), Some(FromPage::Ask(ask)));
        }
        for bad in
            ["", "{}", "[]", r#"{"ask":"go"}"#, r#"{"beat":{"tick_ms":-1}}"#, r#"{"beat":{"tick_ms":1,"more":2}}"#]
        {
            assert_eq!(read(bad), None, "{bad}");
        }
    }

    proptest! {
        #[test]
        fn any_text_is_a_message_or_none(text in ".{0,200}") {
            let _ = read(&text);
        }
    }
}
