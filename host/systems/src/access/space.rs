//! Exhaustive space of small policies and requests, with the decision that each has to get.
//!
//! Policies: every set of roles and items that a rule joins (2 roles, 2 items), every set of the purposes of an item
//! and of those with consent (2 purposes). Requests: every set of roles, item, purpose, and every combination of token,
//! retention, hour, emergency and break-glass role. Expected decisions follow from these sets alone: nothing here uses
//! the library's decision or its facts.

use std::fmt::Write as _;

use r4_access::{Action, Asker, Policy, Request, Resource, decide};

use crate::Sampler;

/// Public key that all subjects share: this space has no signatures.
const KEY: &str = "11qYAYKxCrfVS_7TyWQHOg7hcvPapiMlrwIaaPcHURo";
/// Time of a request within the hours of the items, Unix ms: noon of a day.
const NOON_MS: u64 = 1_795_824_000_000 + 12 * 3_600_000;
/// Time of a request outside of the hours, ms earlier.
const NIGHT_MS: u64 = 10 * 3_600_000;
/// Retention of the items, ms.
const KEPT_MS: u64 = 86_400_000;

/// Outcome over the whole space.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Outcome {
    /// Requests that were granted and should not be.
    pub(super) wrong_grants: u64,
    /// Requests that were denied and should not be.
    pub(super) wrong_denials: u64,
    /// All decisions.
    pub(super) decisions: u64,
    /// Decisions that have to be grants.
    pub(super) grants: u64,
}

/// Names of a policy, sampled by a seed: a decision may not depend on them.
struct Names {
    roles: [String; 3],
    items: [String; 3],
    purposes: [String; 3],
    /// Order of the tables in the policy's text.
    is_reversed: bool,
}

impl Names {
    fn of(seed: u64) -> Self {
        let mut sampler = Sampler::new(seed, 1);
        let mut name = |prefix: &str| format!("{prefix}{:06}", sampler.uniform(0.0, 1e6) as u32);
        // A prefix of its own each, so that no two are alike.
        Self {
            roles: ["a", "b", "glass"].map(&mut name),
            items: ["recording/a", "recording/b", "recording/none"].map(&mut name),
            purposes: ["p", "q", "none"].map(&mut name),
            is_reversed: seed % 2 == 1,
        }
    }
}

/// Names of `all` whose bits are set.
fn of_set(all: &[String], set: u32) -> Vec<&str> {
    all.iter().enumerate().filter(|(place, _)| set >> place & 1 == 1).map(|(_, name)| name.as_str()).collect()
}

fn list(names: &[&str]) -> String {
    let quoted: Vec<String> = names.iter().map(|name| format!("\"{name}\"")).collect();
    quoted.join(", ")
}

/// One policy of the space: bits of the pairs of role and item, of the purposes and of the consents.
#[derive(Clone, Copy)]
struct Sets {
    rules: u32,
    purposes: u32,
    consent: u32,
}

impl Sets {
    fn text(self, names: &Names) -> String {
        let mut tables = Vec::new();
        for roles in 0..8 {
            let held = list(&of_set(&names.roles, roles));
            tables.push(format!("[[subject]]\nname = \"s{roles}\"\nkey = \"{KEY}\"\nroles = [{held}]\n"));
        }
        for item in &names.items[..2] {
            let purposes = list(&of_set(&names.purposes[..2], self.purposes));
            let consent = list(&of_set(&names.purposes[..2], self.consent));
            tables.push(format!(
                "[[item]]\nresource = \"{item}\"\npurposes = [{purposes}]\nconsent = [{consent}]\nretention_s = {}\n\
                 hours_utc = [8, 18]\n",
                KEPT_MS / 1000
            ));
        }
        for pair in (0..4).filter(|pair| self.rules >> pair & 1 == 1) {
            let (role, item) = (&names.roles[pair / 2], &names.items[pair % 2]);
            tables.push(format!("[[rule]]\nroles = [\"{role}\"]\nactions = [\"read\"]\nresources = [\"{item}\"]\n"));
        }
        if names.is_reversed {
            tables.reverse();
        }
        let mut text = String::from("name = \"space\"\n");
        let glass = &names.roles[2];
        // Writing to a string cannot fail.
        let _ = write!(
            text,
            "[break_glass]\nroles = [\"{glass}\"]\nactions = [\"read\"]\nresources = [\"recording\"]\nlife_s = 600\n\
             rest_s = 3600\n{}",
            tables.concat()
        );
        text
    }

    /// Decision that a request has to get.
    fn expects(self, asked: &Asked) -> bool {
        let exists = asked.item < 2;
        let has_rule =
            (0..2).any(|role| asked.roles >> role & 1 == 1 && self.rules >> (2 * role + asked.item) & 1 == 1);
        let has_purpose = asked.purpose < 2 && self.purposes >> asked.purpose & 1 == 1;
        let has_consent = asked.purpose < 2 && self.consent >> asked.purpose & 1 == 1;
        let by_rule = has_rule && has_purpose && has_consent;
        let by_glass = asked.is_emergency && asked.roles >> 2 & 1 == 1;
        asked.has_token && exists && asked.is_kept && asked.is_day && asked.is_read && (by_rule || by_glass)
    }
}

/// One request of the space.
#[derive(Clone, Copy)]
#[expect(clippy::struct_excessive_bools, reason = "each is a dimension of the space")]
struct Asked {
    roles: u32,
    item: u32,
    purpose: u32,
    has_token: bool,
    is_kept: bool,
    is_day: bool,
    is_emergency: bool,
    is_read: bool,
}

/// Number of requests for each policy: 8 sets of roles, 3 items, 3 purposes, 5 that are or are not.
const REQUESTS: u32 = 8 * 3 * 3 * 32;

impl Asked {
    fn number(number: u32) -> Self {
        let bit = |place: u32| number >> place & 1 == 1;
        let rest = number >> 8;
        Self {
            roles: number >> 5 & 7,
            item: rest % 3,
            purpose: rest / 3,
            has_token: bit(0),
            is_kept: bit(1),
            is_day: bit(2),
            is_emergency: bit(3),
            is_read: bit(4),
        }
    }
}

/// Decides every request under every policy, with names of a seed. `None` if the library refuses a policy.
pub(super) fn walked(seed: u64) -> Option<Outcome> {
    let names = Names::of(seed);
    let mut outcome = Outcome::default();
    for rules in 0..16 {
        // Items without purposes are no policies; consents are among the purposes.
        for (purposes, consent) in (1..4).flat_map(|purposes| (0..4).map(move |consent| (purposes, consent))) {
            if consent & !purposes != 0 {
                continue;
            }
            let sets = Sets { rules, purposes, consent };
            let policy = Policy::parse(&sets.text(&names)).ok()?;
            for asked in (0..REQUESTS).map(Asked::number) {
                let is_granted = granted(&policy, &names, &asked)?;
                let expected = sets.expects(&asked);
                outcome.decisions += 1;
                outcome.grants += u64::from(expected);
                outcome.wrong_grants += u64::from(is_granted && !expected);
                outcome.wrong_denials += u64::from(!is_granted && expected);
            }
        }
    }
    Some(outcome)
}

fn granted(policy: &Policy, names: &Names, asked: &Asked) -> Option<bool> {
    let subject = policy.subject(&format!("s{}", asked.roles))?;
    let purpose = &names.purposes[asked.purpose as usize];
    let asker = Asker { subject, purpose, is_emergency: asked.is_emergency };
    let resource: Resource = names.items[asked.item as usize].parse().ok()?;
    let request = Request { action: if asked.is_read { Action::Read } else { Action::Set }, resource };
    let now_ms = if asked.is_day { NOON_MS } else { NOON_MS - NIGHT_MS };
    let start_ms = if asked.is_kept { now_ms } else { now_ms - KEPT_MS };
    Some(decide(policy, asked.has_token.then_some(&asker), &request, start_ms, now_ms).is_granted())
}
