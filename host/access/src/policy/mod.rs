//! Policy: subjects with roles and attributes, items with purposes and retention, rules that join them.

mod date;
mod problem;
mod read;

use std::collections::{BTreeMap, BTreeSet};

use ed25519_dalek::VerifyingKey;

use crate::{
    Action,
    digest::Digest,
    token::{Claims, TokenError},
};

pub use problem::{PolicyError, Problem};

/// Policy of one board, read from TOML and checked. Whatever it does not allow is denied.
///
/// ```
/// let policy = r4_access::Policy::parse(r#"
///     name = "ward-3"
///     [[subject]]
///     name = "alice"
///     key = "11qYAYKxCrfVS_7TyWQHOg7hcvPapiMlrwIaaPcHURo"
///     roles = ["operator"]
///     [[item]]
///     resource = "channel"
///     purposes = ["operation"]
///     [[rule]]
///     roles = ["operator"]
///     actions = ["read", "set"]
///     resources = ["channel"]
/// "#)?;
/// assert_eq!((policy.name(), policy.subjects().count()), ("ward-3", 1));
/// # Ok::<_, r4_access::PolicyError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Policy {
    pub(crate) name: String,
    pub(crate) digest: String,
    pub(crate) life_ms: u64,
    pub(crate) skew_ms: u64,
    pub(crate) break_glass: Option<BreakGlass>,
    pub(crate) subjects: BTreeMap<String, Subject>,
    pub(crate) items: Vec<Item>,
    pub(crate) rules: Vec<Rule>,
}

/// Person or program that can sign tokens.
#[derive(Clone, Debug)]
pub struct Subject {
    /// Name in tokens and in the log.
    pub name: String,
    /// Roles, which rules name.
    pub roles: BTreeSet<String>,
    pub(crate) key: VerifyingKey,
    pub(crate) attributes: BTreeMap<String, String>,
}

/// Emergency access: roles that may use it, and for what.
#[derive(Clone, Debug)]
pub struct BreakGlass {
    /// Duration of an emergency from its first use, ms.
    pub life_ms: u64,
    /// Time that the flag has to be off after an emergency before another begins, ms.
    pub rest_ms: u64,
    pub(crate) allows: Rule,
}

/// Protected item: a resource with the purposes for which it is kept.
#[derive(Clone, Debug)]
pub(crate) struct Item {
    pub(crate) resource: Digest,
    pub(crate) purposes: Vec<Digest>,
    /// Purposes to which the person concerned has consented.
    pub(crate) consent: Vec<Digest>,
    pub(crate) kept: Option<Kept>,
    /// First hour, and hour after the last, of the day in UTC at which the item may be used.
    pub(crate) hours: Option<[u8; 2]>,
    pub(crate) attributes: BTreeMap<String, String>,
}

/// Retention of an item.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Kept {
    /// Time from which the retention counts, Unix ms; `None` for the start of the guard.
    pub(crate) since_ms: Option<u64>,
    /// Duration of the retention, ms.
    pub(crate) for_ms: u64,
}

/// Permission of roles to act on resources.
#[derive(Clone, Debug)]
pub(crate) struct Rule {
    pub(crate) roles: Vec<String>,
    /// Set of [`Action::bit`].
    pub(crate) actions: u8,
    pub(crate) resources: Vec<Digest>,
    /// Attributes that subject and item must share.
    pub(crate) same: Vec<String>,
}

impl Rule {
    /// True if one of the roles has this rule for an action; the resource is compared elsewhere, in constant time.
    pub(crate) fn is_for(&self, roles: &BTreeSet<String>, action: Action) -> bool {
        self.actions & action.bit() != 0 && self.roles.iter().any(|role| roles.contains(role))
    }
}

impl Policy {
    /// Name of the policy, which tokens must carry as their audience.
    #[must_use]
    pub fn name(&self) -> &str {
        &self.name
    }

    /// SHA-256 of the policy's text in hex digits, as the log has it.
    #[must_use]
    pub fn digest(&self) -> &str {
        &self.digest
    }

    /// Longest life of a token, ms.
    #[must_use]
    pub const fn token_life_ms(&self) -> u64 {
        self.life_ms
    }

    /// Largest error of a client's clock, ms: tokens are accepted this long before and after their times.
    #[must_use]
    pub const fn clock_skew_ms(&self) -> u64 {
        self.skew_ms
    }

    /// Emergency access; `None` if the policy allows none.
    #[must_use]
    pub const fn break_glass(&self) -> Option<&BreakGlass> {
        self.break_glass.as_ref()
    }

    /// Reads a token and checks its signature with the key of its subject; times and nonce are left to the caller.
    ///
    /// # Errors
    /// [`TokenError::Malformed`], [`TokenError::UnknownSubject`] and [`TokenError::WrongSignature`].
    pub fn verified(&self, token: &str) -> Result<Claims, TokenError> {
        Claims::verified(token, |subject| self.subjects.get(subject).map(|subject| subject.key))
    }

    /// Subjects in the order of their names.
    pub fn subjects(&self) -> impl Iterator<Item = &Subject> {
        self.subjects.values()
    }

    /// Returns the subject of this name; `None` if the policy has none.
    #[must_use]
    pub fn subject(&self, name: &str) -> Option<&Subject> {
        self.subjects.get(name)
    }
}

#[cfg(test)]
mod tests;
