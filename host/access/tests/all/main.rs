//! Tests of a guard: tokens, clocks, emergencies, restarts and its log. All time is given.

use std::{cell::RefCell, rc::Rc};

use ed25519_dalek::SigningKey;
use r4_access::{
    Action, Basis, Class, Credential, Decision, Guard, Policy, Reason, Request, Resource,
    chain::{ChainError, Verified, verify},
    log::{Event, Files, Memory},
    token::{Nonce, TokenError},
};

/// Time of the tests' begin, Unix ms: 2026-11-28 00:00 UTC.
const BEGIN_MS: u64 = 1_795_824_000_000;
/// Life of a token in the tests' policy, ms.
const LIFE_MS: u64 = 60_000;
/// Allowance for clocks in the tests' policy, ms.
const SKEW_MS: u64 = 5_000;

fn credential(subject: &str) -> Credential {
    let byte = subject.as_bytes()[0];
    let key = SigningKey::from_bytes(&[byte; 32]);
    Credential::with_key(subject, "ward-3", "care", LIFE_MS / 1000, key).expect("names")
}

fn policy() -> Policy {
    let text = format!(
        r#"
        name = "ward-3"
        [token]
        life_s = 60
        skew_s = 5
        [break_glass]
        roles = ["nurse"]
        actions = ["read"]
        resources = ["log"]
        life_s = 600
        rest_s = 3600
        [[subject]]
        name = "alice"
        key = "{}"
        roles = ["operator"]
        [[subject]]
        name = "nora"
        key = "{}"
        roles = ["nurse"]
        [[item]]
        resource = "channel"
        purposes = ["care"]
        [[item]]
        resource = "log"
        purposes = ["audit"]
        [[rule]]
        roles = ["operator"]
        actions = ["set", "read"]
        resources = ["channel"]
        "#,
        credential("alice").public_key(),
        credential("nora").public_key()
    );
    Policy::parse(&text).expect("valid")
}

/// Guard with its log in memory.
struct Bench {
    guard: Guard,
    memory: Rc<RefCell<Memory>>,
}

const LOG_KEY: [u8; 32] = [42; 32];

impl Bench {
    fn new() -> Self {
        let memory = Rc::<RefCell<Memory>>::default();
        let history = Verified::default();
        Self::after(memory, &history, BEGIN_MS)
    }

    fn after(memory: Rc<RefCell<Memory>>, history: &Verified, now_ms: u64) -> Self {
        let key = SigningKey::from_bytes(&LOG_KEY);
        Self { guard: Guard::new(policy(), Box::new(memory.clone()), key, history, now_ms), memory }
    }

    fn verified(&self) -> Result<Verified, ChainError> {
        let memory = self.memory.borrow();
        let head = memory.head.as_ref().expect("written");
        verify(&memory.text, head, &SigningKey::from_bytes(&LOG_KEY).verifying_key())?.complete()
    }

    fn events(&self) -> Vec<Event> {
        self.verified().expect("intact").entries.into_iter().map(|entry| entry.event).collect()
    }

    fn decide(&mut self, action: Action, class: Class, now_ms: u64) -> Decision {
        self.guard.decide(1, &Request { action, resource: Resource::new(class, "osmc0") }, now_ms)
    }
}

#[test]
fn every_request_is_decided_anew() {
    let mut bench = Bench::new();
    let denied = bench.decide(Action::Set, Class::Channel, BEGIN_MS);
    assert_eq!(denied.facts.reason(), Some(Reason::NotAuthenticated));
    let token = credential("alice").token(false, BEGIN_MS).expect("random");
    assert_eq!(bench.guard.present(1, &token, BEGIN_MS), Ok(()));
    assert_eq!(bench.decide(Action::Set, Class::Channel, BEGIN_MS).basis, Some(Basis::Rule));
    assert_eq!(bench.decide(Action::Set, Class::Log, BEGIN_MS).facts.reason(), Some(Reason::NoRule));
    assert_eq!(bench.decide(Action::Read, Class::Faults, BEGIN_MS).facts.reason(), Some(Reason::NotAvailable));
    // Another link has no part in this token.
    let request = Request { action: Action::Set, resource: Resource::whole(Class::Channel) };
    assert!(!bench.guard.decide(2, &request, BEGIN_MS).is_granted());
    // Its end: one ms before and at the end of the allowance.
    let end_ms = BEGIN_MS + LIFE_MS + SKEW_MS;
    assert!(bench.decide(Action::Set, Class::Channel, end_ms - 1).is_granted());
    assert!(!bench.decide(Action::Set, Class::Channel, end_ms).is_granted());
    assert!(!bench.guard.is_authenticated(1, end_ms));
    // A clock that is set back makes it valid no more.
    assert!(!bench.decide(Action::Set, Class::Channel, BEGIN_MS).is_granted());
}

#[test]
fn tokens_that_are_not_valid_are_rejected_by_their_reason() {
    let mut bench = Bench::new();
    let alice = credential("alice");
    let signer = |byte| SigningKey::from_bytes(&[byte; 32]);
    let claims = alice.claims(false, Nonce::from([1; 16]), BEGIN_MS);
    let good = claims.sign(&signer(b'a'));
    let mut other = claims.clone();
    other.subject = "nora".into();
    let mut elsewhere = claims.clone();
    elsewhere.policy = "ward-4".into();
    let mut long = claims.clone();
    long.expires_ms += 1;
    let mut backwards = claims.clone();
    backwards.expires_ms = backwards.not_before_ms - 1;
    let mut unknown = claims.clone();
    unknown.subject = "mallory".into();
    for (token, why) in [
        (claims.sign(&signer(b'm')), TokenError::WrongSignature),
        // Alice's key under the name of another subject.
        (other.sign(&signer(b'a')), TokenError::WrongSignature),
        (elsewhere.sign(&signer(b'a')), TokenError::OtherPolicy),
        (long.sign(&signer(b'a')), TokenError::TooLong),
        (backwards.sign(&signer(b'a')), TokenError::TooLong),
        (unknown.sign(&signer(b'm')), TokenError::UnknownSubject),
        (good.replace("r4-token-1", "r4-token-2"), TokenError::Malformed),
        (alice.token(false, BEGIN_MS + SKEW_MS + 1).expect("random"), TokenError::NotYet),
        (alice.token(false, BEGIN_MS - LIFE_MS - SKEW_MS).expect("random"), TokenError::Expired),
    ] {
        assert_eq!(bench.guard.present(1, &token, BEGIN_MS), Err(why));
        assert_eq!(bench.events().last(), Some(&Event::Rejected { link: 1, why }));
    }
    assert_eq!(bench.guard.present(1, &good, BEGIN_MS), Ok(()));
    // A replay, on any link, takes the link's token away too.
    assert_eq!(bench.guard.present(2, &good, BEGIN_MS + 1), Err(TokenError::Replayed));
    assert_eq!(bench.guard.present(1, &good, BEGIN_MS + 1), Err(TokenError::Replayed));
    assert!(!bench.decide(Action::Set, Class::Channel, BEGIN_MS + 1).is_granted());
}

#[test]
fn a_token_that_came_too_early_is_used_up() {
    let mut bench = Bench::new();
    let token = credential("alice").token(false, BEGIN_MS + 20_000).expect("random");
    assert_eq!(bench.guard.present(1, &token, BEGIN_MS), Err(TokenError::NotYet));
    // Somebody who has read it presents it again in its time.
    assert_eq!(bench.guard.present(2, &token, BEGIN_MS + 20_000), Err(TokenError::Replayed));
}

#[test]
fn an_emergency_is_granted_flagged_and_ends_though_its_flag_stays_on() {
    let mut bench = Bench::new();
    let nora = credential("nora");
    let read = |bench: &mut Bench, now_ms: u64, flag: bool| {
        let token = nora.token(flag, now_ms).expect("random");
        bench.guard.present(1, &token, now_ms).expect("valid");
        bench.decide(Action::Read, Class::Log, now_ms).basis
    };
    assert_eq!(read(&mut bench, BEGIN_MS, false), None);
    // The flag stays on in every token for three hours: granted for ten minutes.
    let granted = (0..180).filter(|minute| read(&mut bench, BEGIN_MS + minute * 60_000, true).is_some()).count();
    assert_eq!(granted, 10);
    let flagged = |event: &&Event| matches!(event, Event::Decided { basis: Some(Basis::BreakGlass), .. });
    assert_eq!(bench.events().iter().filter(flagged).count(), 10);
    // Off for the rest of an hour, then on again.
    let last_ms = BEGIN_MS + 179 * 60_000;
    assert_eq!(read(&mut bench, last_ms + 3_600_000 - 1, false), None);
    assert_eq!(read(&mut bench, last_ms + 3_600_000, true), Some(Basis::BreakGlass));
    // Break-glass is for reading the log alone, and for its roles alone.
    assert!(!bench.decide(Action::Set, Class::Channel, last_ms + 3_600_000).is_granted());
    let token = credential("alice").token(true, last_ms + 3_600_000).expect("random");
    bench.guard.present(1, &token, last_ms + 3_600_000).expect("valid");
    assert!(!bench.decide(Action::Read, Class::Log, last_ms + 3_600_000).is_granted());
}

#[test]
fn a_restart_forgets_neither_tokens_nor_emergencies() {
    let mut bench = Bench::new();
    let token = credential("nora").token(true, BEGIN_MS).expect("random");
    bench.guard.present(1, &token, BEGIN_MS).expect("valid");
    assert!(bench.decide(Action::Read, Class::Log, BEGIN_MS).is_granted());
    let history = bench.verified().expect("intact");
    let mut again = Bench::after(bench.memory.clone(), &history, BEGIN_MS + 1000);
    assert_eq!(again.guard.present(1, &token, BEGIN_MS + 1000), Err(TokenError::Replayed));
    let late_ms = BEGIN_MS + 600_000;
    let token = credential("nora").token(true, late_ms).expect("random");
    again.guard.present(1, &token, late_ms).expect("valid");
    assert!(!again.decide(Action::Read, Class::Log, late_ms).is_granted());
    assert!(again.events().len() > history.entries.len());
}

#[test]
fn decisions_alike_share_an_entry_and_none_is_missing() {
    let mut bench = Bench::new();
    let token = credential("alice").token(false, BEGIN_MS).expect("random");
    bench.guard.present(1, &token, BEGIN_MS).expect("valid");
    for ms in 0..5000 {
        assert!(bench.decide(Action::Set, Class::Channel, BEGIN_MS + ms).is_granted());
    }
    bench.guard.leave(1, BEGIN_MS + 5000);
    let (mut decided, mut entries) = (0, 0);
    for event in bench.events() {
        if let Event::Decided { repeats, .. } = event {
            entries += 1;
            decided += repeats.max(1);
        }
    }
    assert_eq!((decided, entries), (5000, 10));
}

#[test]
fn a_log_that_cannot_be_written_grants_nothing() {
    struct Full(u32);
    impl r4_access::log::Store for Full {
        fn put(&mut self, _: &str, _: &r4_access::chain::Head) -> std::io::Result<()> {
            self.0 += 1;
            if self.0 > 3 { Err(std::io::ErrorKind::StorageFull.into()) } else { Ok(()) }
        }
    }
    let history = Verified::default();
    let mut guard = Guard::new(policy(), Box::new(Full(0)), SigningKey::from_bytes(&LOG_KEY), &history, BEGIN_MS);
    let token = credential("alice").token(false, BEGIN_MS).expect("random");
    guard.present(1, &token, BEGIN_MS).expect("valid");
    let request = |name: &str| Request { action: Action::Set, resource: Resource::new(Class::Channel, name) };
    assert!(guard.decide(1, &request("osmc0"), BEGIN_MS).is_granted());
    assert!(!guard.decide(1, &request("osmc1"), BEGIN_MS).is_granted());
    assert!(!guard.decide(1, &request("osmc0"), BEGIN_MS).is_granted() && guard.has_failed());
    assert!(!guard.is_authenticated(1, BEGIN_MS));
}

#[test]
fn a_log_in_files_goes_on_after_a_restart_and_refuses_damage() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("ward-3.log");
    let run = |now_ms: u64| {
        let opened = Files::open(&path)?;
        let mut guard = Guard::new(policy(), Box::new(opened.files), opened.key, &opened.verified, now_ms);
        let token = credential("alice").token(false, now_ms).expect("random");
        guard.present(1, &token, now_ms).expect("valid");
        guard.decide(1, &Request { action: Action::Set, resource: Resource::whole(Class::Channel) }, now_ms);
        Ok::<_, r4_access::log::LogError>(opened.verified.entries.len())
    };
    assert_eq!(run(BEGIN_MS).expect("new"), 0);
    assert_eq!(run(BEGIN_MS + 1000).expect("goes on"), 3);
    let text = std::fs::read_to_string(&path).expect("written");
    // The last line cut off.
    let cut = text.trim_end().rfind('\n').expect("lines") + 1;
    std::fs::write(&path, &text[..cut]).expect("written");
    assert!(run(BEGIN_MS + 2000).expect_err("cut").to_string().contains("keep its files as evidence"));
    std::fs::write(&path, &text).expect("written");
    assert_eq!(run(BEGIN_MS + 3000).expect("whole again"), 6);
    // Without its key, or its lines, it is not begun anew.
    for file in ["ward-3.log.key", "ward-3.log"] {
        let (from, to) = (folder.path().join(file), folder.path().join("away"));
        std::fs::rename(&from, &to).expect("moved");
        assert!(run(BEGIN_MS + 4000).is_err(), "{file}");
        std::fs::rename(&to, &from).expect("moved back");
    }
}
