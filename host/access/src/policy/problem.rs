//! Errors of a policy, each with its line and the next step.

use std::{io, ops::RangeInclusive, path::PathBuf};

use crate::{NotAResource, Resource};

/// A policy cannot be read, or is not valid.
#[derive(Debug, thiserror::Error)]
pub enum PolicyError {
    /// The file cannot be read.
    #[error("cannot read the policy {path}")]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The text is no TOML, or has a key or a type that a policy does not have.
    #[error("line {line} of the policy: {why}; docs/access.md lists its tables and keys")]
    Syntax {
        /// Line number, from 1 on.
        line: usize,
        /// Message of the TOML parser.
        why: String,
    },
    /// A value is not valid.
    #[error("line {line} of the policy: {problem}")]
    Bad {
        /// Line number, from 1 on.
        line: usize,
        /// Value and the next step.
        problem: Problem,
    },
}

/// Reason why a value of a policy is not valid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Problem {
    /// A rule names a stop or the disarming.
    #[error("`{0}` is never refused and needs no rule: leave it out")]
    NeverRefused(String),
    /// A rule names an action that does not exist.
    #[error("there is no action `{0}`: write read, set, arm, clear, configure or transfer")]
    UnknownAction(String),
    /// A resource that does not exist.
    #[error(transparent)]
    UnknownResource(#[from] NotAResource),
    /// A rule names a resource of which no item covers anything.
    #[error(
        "no [[item]] covers {0}, so that this rule never grants it: add an item for it or for its class, with its \
         purposes"
    )]
    NoItem(Resource),
    /// Two subjects have the same name, or two items the same resource.
    #[error("`{0}` is there twice: remove one of them")]
    Twice(String),
    /// A rule's role that no subject has.
    #[error("no subject has the role `{0}`: correct it, or give it to a subject")]
    NoSuchRole(String),
    /// A name that is empty, too long, or not made of letters, digits and `.-_@`.
    #[error("`{0}` is no name: use 1 to 40 letters, digits and the characters . - _ @")]
    BadName(String),
    /// A key that is no Ed25519 public key.
    #[error("this is no public key: copy the line that `r4 access key` prints")]
    BadKey,
    /// A list that may not be empty.
    #[error("`{0}` is empty, so that nothing follows from this table: fill it, or remove the table")]
    Empty(&'static str),
    /// A consent to a purpose that the item does not have.
    #[error("consent to `{0}`, which is no purpose of this item: add it to `purposes`, or remove it here")]
    ConsentWithoutPurpose(String),
    /// A duration outside its range.
    #[error("`{field}` is {value} s: it must be {} to {} s", .range.start(), .range.end())]
    BadDuration {
        /// Key of the policy.
        field: &'static str,
        /// Value in the policy, s.
        value: u64,
        /// Range of the values, s.
        range: RangeInclusive<u64>,
    },
    /// Hours that are no part of a day.
    #[error(
        "`hours_utc` is {0:?}: write the first hour and the hour after the last, two different numbers from 0 to 24"
    )]
    BadHours([u8; 2]),
    /// A date that is none, or before 1970.
    #[error("`since` must be a date from 1970 on, as in 2026-11-28 or 2026-11-28T08:00:00Z")]
    BadDate,
    /// A date without the duration that counts from it.
    #[error("`since` counts only together with `retention_s`: add that")]
    SinceWithoutRetention,
}
