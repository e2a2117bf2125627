//! Digests of names, compared in constant time.

use sha2::{Digest as _, Sha256};
use subtle::{Choice, ConstantTimeEq};

/// SHA-256 of a name. Two digests are compared in the same time, however much of them agrees, so that the time of a
/// decision does not depend on the names that a policy has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Digest([u8; 32]);

impl Digest {
    /// Makes the digest of a name.
    pub(crate) fn of(name: &str) -> Self {
        Self(Sha256::digest(name.as_bytes()).into())
    }

    /// Compares in constant time.
    pub(crate) fn is(&self, other: &Self) -> Choice {
        self.0.ct_eq(&other.0)
    }

    /// Compares with each of `all`, without an early end.
    pub(crate) fn is_one_of(&self, all: &[Self]) -> Choice {
        all.iter().fold(Choice::from(0), |found, one| found | self.is(one))
    }
}
