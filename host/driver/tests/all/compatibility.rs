//! Boards of versions that are no longer spoken, replayed from recordings, and one that no version allows: the host
//! returns a typed error.

use std::{collections::VecDeque, convert::Infallible};

use crate::simulated::{VirtualClock, simulated_link};
use embedded_io_async::{ErrorType, Read};
use r4_driver::{Board, Error, with_board};
use r4_protocol::{
    Causes, DeviceInfo, Refusal, Reply, SafetyState, ToHost, VERSION, encode_frame,
    frame::{Check, MAX_FRAME, encode_with},
};

#[path = "../../../../protocol/tests/golden/tables.rs"]
mod tables;

use tables::{GOLDEN, SESSION, rows};

/// Replays a board's recorded bytes, one piece per millisecond, and then closes the link.
struct Recorded {
    says: VecDeque<Vec<u8>>,
    clock: VirtualClock,
}

impl ErrorType for Recorded {
    type Error = Infallible;
}

impl Read for Recorded {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        self.clock.0.sleep(1_000_000).await;
        let Some(piece) = self.says.pop_front() else { return Ok(0) };
        buffer[..piece.len()].copy_from_slice(&piece);
        Ok(piece.len())
    }
}

/// Returns the error of opening a session with a board that sends `says`.
fn told(says: Vec<Vec<u8>>) -> Error {
    let mut error = None;
    simulated_link(async |_, tx, clock| {
        let board = Recorded { says: says.into(), clock: clock.clone() };
        error = with_board(board, tx, clock, async |_: &Board<_>| ()).await.err();
        Ok(())
    })
    .expect("time goes on");
    error.expect("no session")
}

#[test]
fn a_board_of_version_4_is_named_with_both_versions() {
    let error = told(rows(SESSION, "refusal"));
    let Error::Refused(Refusal::ProtocolMismatch { version: 4, schema }) = error else { panic!("{error:?}") };
    let text = error.to_string();
    for part in ["protocol 4".to_owned(), format!("{schema:016x}"), format!("this program {VERSION} ")] {
        assert!(text.contains(&part), "{part} in {text}");
    }
}

/// A board of an older version that accepts the hello, which none does: the host neither panics nor opens a session on
/// data which it would misread.
#[test]
fn no_message_of_an_older_version_opens_a_session() {
    for (version, golden) in (1..).zip(GOLDEN) {
        let said = rows(golden, "to-host");
        assert!(said.len() > 30, "version {version}: {} messages", said.len());
        for bytes in said.iter().chain(&rows(golden, "to-device")) {
            let error = told(vec![bytes.clone()]);
            let is_none = matches!(error, Error::LinkFailed { .. } | Error::UnknownAnswer { .. });
            assert!(is_none, "version {version}: {error:?} of {bytes:02x?}");
        }
        assert!(matches!(told(said), Error::LinkFailed { .. }), "version {version}");
    }
}

/// The board's answer is to the hello with number 0.
#[test]
fn an_answer_of_a_later_version_ends_the_wait_and_is_named() {
    let unknown = encode_with(&(0u8, 0u16, 0u8, 200u8), Check::Short, &mut [0; MAX_FRAME]).expect("a frame").to_vec();
    let error = told(vec![unknown]);
    assert!(matches!(error, Error::UnknownAnswer { request: "hello" }), "{error:?}");
}

/// Four heartbeats are sent per time-out: with a time-out of 0 they would be sent without end.
#[test]
fn a_time_out_that_no_board_has_opens_no_session() {
    for (link_timeout_ms, is_refused) in [(0, true), (19, true), (20, false), (1000, false), (1001, true)] {
        let info = DeviceInfo {
            robot: "r".try_into().expect("short"),
            firmware: "f".try_into().expect("short"),
            session: 1,
            channels: 1,
            link_timeout_ms,
            device_us: 0,
            state: SafetyState::Disarmed,
            causes: Causes::NONE,
        };
        let mut buffer = [0; MAX_FRAME];
        let hello = ToHost::Response { seq: 0, result: Ok(Reply::Hello(info)) };
        let error = told(vec![encode_frame(&hello, &mut buffer).expect("a frame").to_vec()]);
        // An accepted hello is followed by nothing, and the link ends.
        assert_eq!(
            matches!(error, Error::WrongReply { request: "hello" }),
            is_refused,
            "{link_timeout_ms} ms: {error:?}"
        );
    }
}
