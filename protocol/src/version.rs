//! Versions of the protocol, and how a board and a host agree on one.
//!
//! From version 12 on the protocol is only ever added to: variants at the end of enums. A board and a host therefore talk whenever there
//! is a version that both speak, in the newest such one:
//!
//! 1. The host says hello in its newest version ([`Request::Hello`](crate::Request::Hello)).
//! 2. A board that speaks it opens a session of that version.
//! 3. Another refuses, and tells its own newest one ([`Refusal::ProtocolMismatch`]). A host that speaks that one says hello again, in it.
//!
//! The bytes of hello and of its refusal are the same in all versions. What the other side does not know all the same, a request or an answer
//! that came with a later version, is refused by name ([`Refusal::UnknownMessage`]); it is not carried out, and a board ends the set points in
//! force, because it may have been a newer one.

use postcard_schema::key::hash::fnv1a64::hash_ty_path;

use crate::{Cause, Refusal, ToDevice, ToHost, channel, config, cycle, log, message};

/// Newest version of the messages in this crate.
pub const VERSION: u16 = 13;

/// Hash over the shape of every message type; two builds of the same [`VERSION`] that still differ are caught by it.
///
/// It sees names, types and variants, how much each list and text holds, and how many causes there are; not units and
/// meanings.
pub const SCHEMA_HASH: u64 = {
    // `from_le_bytes` of two FNV-1a hashes; the paths keep the two directions apart.
    let mut hash = u64::from_le_bytes(hash_ty_path::<ToDevice>("r4/to-device"))
        ^ u64::from_le_bytes(hash_ty_path::<ToHost>("r4/to-host")).rotate_left(1);
    // What a schema does not tell of a type, hashed on by FNV-1a's step.
    let capacities = [
        message::MAX_SAMPLES,
        message::MAX_RAW,
        message::MAX_FIRMWARE,
        channel::MAX_MODES,
        config::MAX_NAME,
        config::MAX_MOTORS,
        config::MAX_SUPPLIES,
        Cause::ALL.len(),
        cycle::CYCLE_CHANNELS,
        log::MAX_LOG,
        message::MAX_POINTS,
    ];
    let mut place = 0;
    while place < capacities.len() {
        hash = (hash ^ capacities[place] as u64).wrapping_mul(0x0100_0000_01B3);
        place += 1;
    }
    hash
};

/// A version of the protocol, as hello and its refusal name it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Spoken {
    /// Its [`VERSION`].
    pub version: u16,
    /// Its [`SCHEMA_HASH`]: that of a build between two releases is no other's.
    pub schema: u64,
}

/// Every version that this crate speaks, newest first. A new one goes in front, with the hash of the one before written out: see
/// `CHANGELOG.md`.
pub const SPOKEN: [Spoken; 2] =
    [Spoken { version: VERSION, schema: SCHEMA_HASH }, Spoken { version: 12, schema: 0x2FCC_40F3_2856_D804 }];

/// From which version on a request may be sent again with the same `seq`, to be done once.
pub const REPEATS: Repeats = Repeats { since: 13, remembered: 8 };

/// What a board remembers of requests that it has answered, so that a host may ask again where no answer came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Repeats {
    /// Version of the session from which on it does.
    pub since: u16,
    /// How many requests.
    pub remembered: usize,
}

/// The board's answer to a hello in `asked`: the version of the session.
///
/// # Errors
/// [`Refusal::ProtocolMismatch`] with the newest of `spoken`, where `asked` is none of these.
pub fn accept(spoken: &[Spoken], asked: Spoken) -> Result<u16, Refusal> {
    let newest = spoken.first().copied().unwrap_or(Spoken { version: 0, schema: 0 });
    let mismatch = Refusal::ProtocolMismatch { version: newest.version, schema: newest.schema };
    spoken.iter().find(|one| **one == asked).map(|one| one.version).ok_or(mismatch)
}

/// In which version a host that speaks `spoken` says hello again, after one in `said` was refused by a board whose newest is `board`.
/// `None` where there is no such version.
#[must_use]
pub fn again(spoken: &[Spoken], said: Spoken, board: Spoken) -> Option<Spoken> {
    spoken.iter().copied().find(|one| *one == board && board.version < said.version)
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use super::*;

    /// Versions `newest` down to `oldest`, as a build of `newest` speaks them.
    fn spoken(newest: u16, oldest: u16) -> Vec<Spoken> {
        (oldest..=newest).rev().map(|version| Spoken { version, schema: u64::from(version) << 8 }).collect()
    }

    /// The version of the session, or the refusal that the host is left with, and how many hellos it took.
    fn session(host: &[Spoken], board: &[Spoken]) -> (Result<u16, Refusal>, u32) {
        let (mut says, mut hellos) = (host[0], 1);
        loop {
            let answer = accept(board, says);
            let Err(Refusal::ProtocolMismatch { version, schema }) = answer else { return (answer, hellos) };
            let Some(other) = again(host, says, Spoken { version, schema }) else { return (answer, hellos) };
            (says, hellos) = (other, hellos + 1);
        }
    }

    /// All hosts and boards of six versions, whichever oldest version each still speaks.
    #[test]
    fn any_two_talk_in_the_newest_version_that_both_speak() {
        let all = || (1..=6).flat_map(|newest| (1..=newest).map(move |oldest| (newest, oldest)));
        for (host, board) in all().flat_map(|host| all().map(move |board| (host, board))) {
            let common = host.0.min(board.0);
            let (session, hellos) = session(&spoken(host.0, host.1), &spoken(board.0, board.1));
            let expected = if common >= host.1.max(board.1) {
                Ok(common)
            } else {
                Err(Refusal::ProtocolMismatch { version: board.0, schema: u64::from(board.0) << 8 })
            };
            assert_eq!(session, expected, "{host:?} {board:?}");
            assert!(hellos <= 2, "{host:?} {board:?}: {hellos}");
        }
    }

    #[test]
    fn a_build_between_two_releases_is_no_other() {
        let (host, mut board) = (spoken(3, 2), spoken(3, 2));
        board[0].schema ^= 1;
        let refusal = Refusal::ProtocolMismatch { version: 3, schema: board[0].schema };
        assert_eq!(session(&host, &board), (Err(refusal), 1));
    }

    #[test]
    fn the_versions_of_this_crate_go_down_one_by_one() {
        assert_eq!(SPOKEN[0], Spoken { version: VERSION, schema: SCHEMA_HASH });
        assert!(SPOKEN.windows(2).all(|pair| pair[0].version == pair[1].version + 1));
    }
}
