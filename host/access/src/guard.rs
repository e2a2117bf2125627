//! Guard of a board: policy, presented tokens, emergencies and the log together.

use std::collections::BTreeMap;

use ed25519_dalek::SigningKey;

use crate::{
    Asker, Decision, Emergency, Policy, Replay, Request,
    chain::{Chain, Verified},
    decide,
    log::{Entry, Event, Store},
    replay::Admission,
    token::{Claims, TokenError},
};

/// Time within which decisions alike share one entry of the log, ms: a client that repeats a request, or streams set
/// points, writes at most two entries a second. With half of it, twice as many.
const TOGETHER_MS: u64 = 1000;
/// Largest number of different decisions of which repeats are counted; more are written out.
const COUNTED: usize = 64;

/// Guard of one board. Every request is decided anew, with the token that its link presented last.
pub struct Guard {
    policy: Policy,
    started_ms: u64,
    /// Largest time so far: a clock that is set back does not make a token valid again.
    latest_ms: u64,
    links: BTreeMap<u64, Claims>,
    replay: Replay,
    emergencies: BTreeMap<String, Emergency>,
    log: Writer,
    repeats: BTreeMap<Alike, Repeats>,
}

/// Outcome of a token that a link presented.
pub type Presented = Result<(), TokenError>;

/// Decisions that share one entry.
#[derive(Clone, PartialEq, Eq, PartialOrd, Ord)]
struct Alike {
    link: u64,
    subject: String,
    request: Request,
    decision: Decision,
}

struct Repeats {
    since_ms: u64,
    count: u64,
}

/// End of the log.
struct Writer {
    store: Box<dyn Store>,
    key: SigningKey,
    chain: Chain,
    /// Error of the last write: nothing is granted that cannot be logged.
    has_failed: bool,
}

impl Writer {
    fn put(&mut self, at_ms: u64, event: Event) {
        // After a failure the file may end within a line, and no line may follow it.
        if self.has_failed {
            return;
        }
        let mut chain = self.chain;
        let line = chain.add(&Entry { number: chain.count + 1, at_ms, event });
        self.has_failed = self.store.put(&line, &chain.head(&self.key)).is_err();
        self.chain = chain;
    }
}

impl Guard {
    /// Makes the guard of a policy. `history` is the verified log so far, from which tokens and emergencies before a
    /// restart are known, and `key` signs the log's heads.
    #[must_use]
    pub fn new(policy: Policy, store: Box<dyn Store>, key: SigningKey, history: &Verified, now_ms: u64) -> Self {
        let log = Writer { store, key, chain: history.chain, has_failed: false };
        let mut guard = Self {
            policy,
            started_ms: now_ms,
            latest_ms: now_ms,
            links: BTreeMap::new(),
            replay: Replay::default(),
            emergencies: BTreeMap::new(),
            log,
            repeats: BTreeMap::new(),
        };
        for entry in &history.entries {
            guard.recall(entry, now_ms);
        }
        let started = Event::Started {
            policy: guard.policy.name.clone(),
            digest: guard.policy.digest.clone(),
            unsigned: history.unsigned,
        };
        guard.log.put(now_ms, started);
        guard
    }

    /// Takes nonces and emergencies from an entry of the log before this start.
    fn recall(&mut self, entry: &Entry, now_ms: u64) {
        let Event::Presented { subject, nonce, until_ms, emergency, .. } = &entry.event else { return };
        if now_ms <= *until_ms {
            self.replay.admit(subject, *nonce, *until_ms, now_ms);
        }
        if *emergency {
            self.flagged(subject, entry.at_ms);
        }
    }

    /// Policy of the guard.
    #[must_use]
    pub const fn policy(&self) -> &Policy {
        &self.policy
    }

    /// True after a write of the log failed: everything is denied from then on.
    #[must_use]
    pub const fn has_failed(&self) -> bool {
        self.log.has_failed
    }

    /// Takes a token that `link` presents at `now_ms`, Unix ms. It replaces the one before; a token that is not valid
    /// leaves the link without any.
    ///
    /// # Errors
    /// [`TokenError`], for the log; the client gets no answer, so that it learns nothing from it.
    pub fn present(&mut self, link: u64, token: &str, now_ms: u64) -> Presented {
        let now_ms = self.now(now_ms);
        self.links.remove(&link);
        match self.accepted(token, now_ms) {
            Ok((claims, until_ms)) => {
                let Claims { subject, purpose, emergency, nonce, .. } = claims.clone();
                self.log.put(now_ms, Event::Presented { link, subject, purpose, emergency, nonce, until_ms });
                self.links.insert(link, claims);
                Ok(())
            }
            Err(why) => {
                self.log.put(now_ms, Event::Rejected { link, why });
                Err(why)
            }
        }
    }

    fn accepted(&mut self, token: &str, now_ms: u64) -> Result<(Claims, u64), TokenError> {
        let Policy { name, life_ms, skew_ms, .. } = &self.policy;
        let claims = self.policy.verified(token)?;
        let checked = claims.check(name, *life_ms, *skew_ms, now_ms);
        if !matches!(checked, Ok(()) | Err(TokenError::NotYet)) {
            checked?;
        }
        let until_ms = claims.expires_ms.saturating_add(*skew_ms);
        // A token that came too early is used up as well: who has read it must not present it when its time has come.
        match self.replay.admit(&claims.subject, claims.nonce, until_ms, now_ms) {
            Admission::New => checked.map(|()| (claims, until_ms)),
            Admission::Seen => Err(TokenError::Replayed),
            Admission::Full => Err(TokenError::TooMany),
        }
    }

    /// Decides about a request of `link` at `now_ms`, Unix ms, and logs the decision before it returns it.
    pub fn decide(&mut self, link: u64, request: &Request, now_ms: u64) -> Decision {
        let now_ms = self.now(now_ms);
        let flags = self.valid(link, now_ms).map(|claims| (claims.subject.clone(), claims.emergency));
        let is_emergency = flags.is_some_and(|(subject, emergency)| emergency && self.flagged(&subject, now_ms));
        let claims = self.valid(link, now_ms);
        let asker = claims.and_then(|claims| {
            let subject = self.policy.subject(&claims.subject)?;
            Some(Asker { subject, purpose: &claims.purpose, is_emergency })
        });
        let mut decision = decide(&self.policy, asker.as_ref(), request, self.started_ms, now_ms);
        let subject = claims.map_or_else(String::new, |claims| claims.subject.clone());
        self.note(Alike { link, subject, request: request.clone(), decision }, now_ms);
        if self.log.has_failed {
            decision.basis = None;
        }
        decision
    }

    /// True while the token of `link` is valid: for what goes on between requests, such as samples and motion.
    pub fn is_authenticated(&mut self, link: u64, now_ms: u64) -> bool {
        let now_ms = self.now(now_ms);
        !self.log.has_failed && self.valid(link, now_ms).is_some()
    }

    /// Notes that a link has ended.
    pub fn leave(&mut self, link: u64, now_ms: u64) {
        let now_ms = self.now(now_ms);
        self.flush(now_ms, |alike, _| alike.link == link);
        if self.links.remove(&link).is_some() {
            self.log.put(now_ms, Event::Left { link });
        }
    }

    /// Time that never goes back.
    fn now(&mut self, now_ms: u64) -> u64 {
        self.latest_ms = self.latest_ms.max(now_ms);
        self.latest_ms
    }

    /// Claims of the link's token while it is valid.
    fn valid(&self, link: u64, now_ms: u64) -> Option<&Claims> {
        self.links.get(&link).filter(|claims| claims.check_now(self.policy.skew_ms, now_ms).is_ok())
    }

    /// Notes a subject's flag of an emergency; true while it is in force.
    fn flagged(&mut self, subject: &str, now_ms: u64) -> bool {
        let Some(glass) = &self.policy.break_glass else { return false };
        let emergency = self.emergencies.entry(subject.to_owned()).or_default();
        emergency.flagged(now_ms, glass.life_ms, glass.rest_ms)
    }

    /// Writes a decision, or counts it beside one alike.
    fn note(&mut self, alike: Alike, now_ms: u64) {
        self.flush(now_ms, |_, repeats| now_ms.saturating_sub(repeats.since_ms) >= TOGETHER_MS);
        if let Some(repeats) = self.repeats.get_mut(&alike) {
            repeats.count += 1;
            return;
        }
        if self.repeats.len() >= COUNTED {
            self.flush(now_ms, |_, _| true);
        }
        self.log.put(now_ms, decided(&alike, 0));
        self.repeats.insert(alike, Repeats { since_ms: now_ms, count: 0 });
    }

    /// Writes the numbers of repeats that `is_due` chooses, and forgets these decisions.
    fn flush(&mut self, now_ms: u64, is_due: impl Fn(&Alike, &Repeats) -> bool) {
        let log = &mut self.log;
        self.repeats.retain(|alike, repeats| {
            let is_due = is_due(alike, repeats);
            if is_due && repeats.count > 0 {
                log.put(now_ms, decided(alike, repeats.count));
            }
            !is_due
        });
    }
}

impl Drop for Guard {
    /// Writes the repeats that were counted, so that no decision is missing from the log of a program that ends.
    fn drop(&mut self) {
        self.flush(self.latest_ms, |_, _| true);
    }
}

fn decided(alike: &Alike, repeats: u64) -> Event {
    let Alike { link, subject, request, decision } = alike;
    Event::Decided {
        link: *link,
        subject: subject.clone(),
        action: request.action.to_string(),
        resource: request.resource.to_string(),
        facts: decision.facts.to_string(),
        basis: decision.basis,
        repeats,
    }
}
