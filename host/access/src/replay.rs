//! Nonces that came before.

use std::collections::BTreeMap;

use crate::token::Nonce;

/// Nonces of the tokens that were accepted and could still be valid.
///
/// Memory is bounded: only tokens with a valid signature enter, each subject has its own room, and a nonce leaves when
/// its token has expired. A subject without room has to wait until one of its tokens expires.
#[derive(Debug, Default)]
pub struct Replay {
    /// End of validity by subject and nonce, Unix ms.
    seen: BTreeMap<String, BTreeMap<Nonce, u64>>,
}

/// Answer of [`Replay::admit`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Admission {
    /// The nonce is new, and is remembered from now on.
    New,
    /// The nonce came before.
    Seen,
    /// The subject has too many valid tokens.
    Full,
}

impl Replay {
    /// Largest number of valid tokens of a subject. A client renews its token twice per life, and a life is at least
    /// 10 s, so that this is enough for 128 links of one subject.
    pub const ROOM: usize = 256;

    /// Remembers a nonce of `subject` until `until_ms`, Unix ms, unless it came before.
    pub(crate) fn admit(&mut self, subject: &str, nonce: Nonce, until_ms: u64, now_ms: u64) -> Admission {
        let seen = self.seen.entry(subject.to_owned()).or_default();
        seen.retain(|_, until_ms| now_ms <= *until_ms);
        if seen.contains_key(&nonce) {
            return Admission::Seen;
        }
        if seen.len() >= Self::ROOM {
            return Admission::Full;
        }
        seen.insert(nonce, until_ms);
        Admission::New
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn memory_is_bounded_and_freed() {
        let mut replay = Replay::default();
        let nonce = |number: usize| Nonce::from((number as u128).to_le_bytes());
        for number in 0..Replay::ROOM {
            assert_eq!(replay.admit("alice", nonce(number), 100, 0), Admission::New);
        }
        assert_eq!(replay.admit("alice", nonce(7), 100, 0), Admission::Seen);
        assert_eq!(replay.admit("alice", nonce(Replay::ROOM), 100, 0), Admission::Full);
        // The room of another subject is another's.
        assert_eq!(replay.admit("bob", nonce(7), 100, 0), Admission::New);
        assert_eq!(replay.admit("alice", nonce(7), 100, 100), Admission::Seen);
        assert_eq!(replay.admit("alice", nonce(7), 300, 101), Admission::New);
        assert_eq!(replay.seen["alice"].len(), 1);
    }
}
