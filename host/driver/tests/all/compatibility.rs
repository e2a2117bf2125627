//! Boards of the version before, by what they were recorded to say, and one that says what none can: the host is told so by a
//! typed error.

use std::{collections::VecDeque, convert::Infallible};

use crate::simulated::{VirtualClock, simulated_link};
use embedded_io_async::{ErrorType, Read};
use r4_driver::{Board, Error, with_board};
use r4_protocol::{Causes, DeviceInfo, Refusal, Reply, SafetyState, ToHost, VERSION, encode_frame, frame::MAX_FRAME};

/// Frames of every message, direction, name and bytes.
const GOLDEN: &str = include_str!("../../../../protocol/tests/golden/v4.txt");
/// A session of a host with a board, who and bytes.
const SESSION: &str = include_str!("../../../../protocol/tests/golden/v4-session.txt");

/// Bytes of the rows that begin with `who`.
fn rows(table: &str, who: &str) -> Vec<Vec<u8>> {
    let rows = table.lines().filter(|line| line.starts_with(who)).filter_map(|line| line.rsplit(' ').next());
    rows.map(|hex| (0..hex.len()).step_by(2).map(|at| u8::from_str_radix(&hex[at..at + 2], 16).expect("hex")).collect())
        .collect()
}

/// A board that says what it was recorded to say, a piece each millisecond, and then closes the link.
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

/// Why there is no session with a board that says `says`.
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

/// A board of version 4 that took the hello, which none does: no panic, no session on what today's host reads otherwise.
#[test]
fn no_message_of_version_4_opens_a_session() {
    let said = rows(GOLDEN, "to-host");
    assert!(said.len() > 60, "{} messages", said.len());
    for bytes in said.iter().chain(&rows(GOLDEN, "to-device")) {
        let error = told(vec![bytes.clone()]);
        assert!(matches!(error, Error::LinkFailed { .. }), "{error:?} of {bytes:02x?}");
    }
    assert!(matches!(told(said), Error::LinkFailed { .. }));
}

/// Heartbeats are sent four to a time-out: without end at one moment where that is 0.
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
        // One that is taken says nothing more, and its link ends.
        assert_eq!(
            matches!(error, Error::WrongReply { request: "hello" }),
            is_refused,
            "{link_timeout_ms} ms: {error:?}"
        );
    }
}
