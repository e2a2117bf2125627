//! Versions of the protocol, and how a board and a host agree on one.
//!
//! From version 12 on the protocol only grows, by variants at the end of enums. A board and a host can therefore talk
//! whenever there is a version that both speak, and use the newest such one:
//!
//! 1. The host sends a hello in its newest version ([`Request::Hello`](crate::Request::Hello)).
//! 2. A board that speaks this version opens a session of it.
//! 3. Any other board refuses, and names its own newest version ([`Refusal::ProtocolMismatch`]). A host that speaks that one sends
//!    a second hello in it.
//!
//! The bytes of hello and of its refusal are the same in all versions. A request of a later version that reaches the
//! board all the same is refused by name ([`Refusal::UnknownMessage`]) and not carried out. The board then ends the set
//! points in force, because the request may have been a newer one. A host ends a request whose answer it does not know
//! with an error.

use postcard_schema::key::hash::fnv1a64::hash_ty_path;

use crate::{Cause, Refusal, ToDevice, ToHost, channel, config, cycle, log, message};

/// Version of the messages in this crate, the newest that it speaks.
pub const VERSION: u16 = 14;

/// Hash over the shape of every message type. It detects two builds of the same [`VERSION`] that differ all the same.
///
/// The hash covers names, types and variants, the capacity of each list and text, and the number of causes; not units
/// and meanings.
pub const SCHEMA_HASH: u64 = {
    // Two FNV-1a hashes; the paths of the two directions differ, so that exchanging their types changes the result.
    let mut hash = u64::from_le_bytes(hash_ty_path::<ToDevice>("r4/to-device"))
        ^ u64::from_le_bytes(hash_ty_path::<ToHost>("r4/to-host")).rotate_left(1);
    // Capacities are not part of a schema; FNV-1a's step adds them to the hash.
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

/// Version of the protocol as hello and its refusal name it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Spoken {
    /// Number of the version: its [`VERSION`].
    pub version: u16,
    /// Hash of the version: its [`SCHEMA_HASH`]. A build between two releases has a hash of its own.
    pub schema: u64,
}

/// Versions that this crate speaks, newest first. A new one goes in front, with the hash of the one before written out:
/// see `CHANGELOG.md`.
pub const SPOKEN: [Spoken; 3] = [
    Spoken { version: VERSION, schema: SCHEMA_HASH },
    // Versions 13 and 12 have the same shapes.
    Spoken { version: 13, schema: 0x2FCC_40F3_2856_D804 },
    Spoken { version: 12, schema: 0x2FCC_40F3_2856_D804 },
];

/// Rule for requests that are sent again with the same `seq`: from this version on a board carries them out once.
pub const REPEATS: Repeats = Repeats { since: 13, remembered: 8 };

/// Memory of a board for requests that it has answered, so that a host may ask again when no answer came.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Repeats {
    /// Lowest version of a session in which the board remembers requests.
    pub since: u16,
    /// Number of requests that it remembers.
    pub remembered: usize,
}

/// Returns the version of the session that a hello in `asked` opens on a board that speaks `spoken`.
///
/// # Errors
/// [`Refusal::ProtocolMismatch`] with the newest of `spoken`, where `asked` is none of these.
pub fn accept(spoken: &[Spoken], asked: Spoken) -> Result<u16, Refusal> {
    let newest = spoken.first().copied().unwrap_or(Spoken { version: 0, schema: 0 });
    let mismatch = Refusal::ProtocolMismatch { version: newest.version, schema: newest.schema };
    spoken.iter().find(|one| **one == asked).map(|one| one.version).ok_or(mismatch)
}

/// Returns the version in which a host that speaks `spoken` sends another hello, after a board whose newest version is
/// `board` refused one in `said`; `None` unless it speaks the board's newest version, and that is older than `said`.
#[must_use]
pub fn again(spoken: &[Spoken], said: Spoken, board: Spoken) -> Option<Spoken> {
    // Only downwards, or two that refuse each other would say hello indefinitely.
    spoken.iter().copied().find(|one| *one == board && board.version < said.version)
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec;

    use super::*;

    /// Returns versions `newest` down to `oldest`, as a build of `newest` speaks them.
    fn spoken(newest: u16, oldest: u16) -> Vec<Spoken> {
        (oldest..=newest).rev().map(|version| Spoken { version, schema: u64::from(version) << 8 }).collect()
    }

    /// Returns the version of the session, or the refusal that remains, and the number of hellos.
    fn session(host: &[Spoken], board: &[Spoken]) -> (Result<u16, Refusal>, u32) {
        let (mut says, mut hellos) = (host[0], 1);
        loop {
            let answer = accept(board, says);
            let Err(Refusal::ProtocolMismatch { version, schema }) = answer else { return (answer, hellos) };
            let Some(other) = again(host, says, Spoken { version, schema }) else { return (answer, hellos) };
            (says, hellos) = (other, hellos + 1);
        }
    }

    /// Tries all hosts and boards of six versions, whichever oldest version each still speaks.
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
