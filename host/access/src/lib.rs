//! Access control of a shared board: who may do what, decided anew for each request.
//!
//! Paper: Zoughalian et al., "Access Control Mechanism Framework for Assistive Robots in
//! Healthcare", TAROS 2023, which is a block diagram. Roles and attributes follow NIST SP 800-162 (Hu et al., 2014).
//!
//! A [`Guard`] has a [`Policy`], the tokens that its links presented, and a log:
//!
//! - [`decide`] is a pure function from a policy and a request to [`Facts`], and from those to a grant. Everything that
//!   no rule allows is denied.
//! - A [token] is signed by its subject (Ed25519), lives for minutes, names one policy, and opens one link: a
//!   nonce that came before is refused ([`Replay`]).
//! - An [`Emergency`] grants what the rules do not, to roles that may break glass; it is flagged in the log and ends by
//!   itself, also when its flag is left on.
//! - The [log] is a hash chain with a signed head, so that altered, moved, removed and cut entries are detected.
//!
//! Time comes from the caller as Unix time in ms. The crate knows no board, no protocol and no link.
//!
//! Stops and disarming are no actions of a policy: the caller never asks the guard for them, so that safety does not
//! wait for authorisation.

mod action;
pub mod chain;
mod credential;
mod decide;
mod digest;
mod emergency;
mod guard;
pub mod log;
mod policy;
mod present;
mod replay;
pub mod token;

pub use action::{Action, Class, NotAResource, Resource};
pub use credential::{Credential, CredentialError};
pub use decide::{Asker, Basis, Decision, Facts, Reason, Request, decide};
pub use emergency::Emergency;
pub use guard::{Guard, Presented};
pub use policy::{BreakGlass, Policy, PolicyError, Problem, Subject};
pub use present::{Piece, Presenter, Source, Splitter};
pub use replay::Replay;

/// Time of the system's clock since 1970, ms; 0 before that.
#[must_use]
pub fn unix_ms() -> u64 {
    let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH).unwrap_or_default();
    u64::try_from(since.as_millis()).unwrap_or(u64::MAX)
}

/// Ed25519 key of a secret's bytes, for scripts and tests that need the same key each time.
#[must_use]
pub fn signing_key(secret: [u8; 32]) -> ed25519_dalek::SigningKey {
    ed25519_dalek::SigningKey::from_bytes(&secret)
}
