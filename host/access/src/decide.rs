//! Decision about a request: facts of the policy, and the formula that makes a grant of them.

use std::{collections::BTreeSet, fmt};

use serde::{Deserialize, Serialize};
use subtle::Choice;

use crate::{
    Action, Policy, Resource,
    digest::Digest,
    policy::{Item, Rule, Subject},
};

/// Length of an hour, ms.
const HOUR_MS: u64 = 3_600_000;

/// Request as a policy sees it.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Request {
    /// Kind of use that is asked for.
    pub action: Action,
    /// Resource that is used.
    pub resource: Resource,
}

/// Subject that asks, with the claims of its token that decide.
#[derive(Clone, Copy, Debug)]
pub struct Asker<'p> {
    /// Subject of the policy, whose token was verified and has not expired.
    pub subject: &'p Subject,
    /// Purpose that the token names.
    pub purpose: &'p str,
    /// True while an emergency of the subject is in force.
    pub is_emergency: bool,
}

/// Facts about a request, from which [`Facts::basis`] decides.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[expect(clippy::struct_excessive_bools, reason = "each is a variable of the decision's formula")]
pub struct Facts {
    /// The subject is authenticated by a valid token.
    pub auth: bool,
    /// The item exists and is kept.
    pub available: bool,
    /// The item may be used at this hour.
    pub appropriate: bool,
    /// A rule allows the action to one of the subject's roles.
    pub role_ok: bool,
    /// The item is kept for this purpose.
    pub purpose_ok: bool,
    /// The person concerned has consented to this purpose.
    pub consent: bool,
    /// An emergency of the subject is in force.
    pub emergency: bool,
    /// One of the subject's roles may break glass for this action.
    pub breakglass_role: bool,
}

/// Ground of a grant.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Basis {
    /// A rule, the purpose and the consent.
    Rule,
    /// An emergency; flagged in the log.
    BreakGlass,
}

/// First fact that was missing, for administrators only: a client gets no reason.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Reason {
    /// The link has no valid token.
    NotAuthenticated,
    /// No such item, or its retention is over.
    NotAvailable,
    /// Wrong hour of the day.
    NotAppropriate,
    /// No rule for the subject's roles.
    NoRule,
    /// The item is not kept for this purpose.
    WrongPurpose,
    /// No consent to this purpose.
    NoConsent,
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::NotAuthenticated => "no valid token: its subject has to present one that has not expired",
            Self::NotAvailable => "no [[item]] covers the resource, or its retention is over",
            Self::NotAppropriate => "outside `hours_utc` of the item",
            Self::NoRule => "no [[rule]] allows this action on this resource to a role of the subject",
            Self::WrongPurpose => "the token's purpose is not among `purposes` of the item",
            Self::NoConsent => "the token's purpose is not among `consent` of the item",
        })
    }
}

/// Decision about one request.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Decision {
    /// Facts by which the request was decided.
    pub facts: Facts,
    /// Ground of the grant; `None` if the request is denied.
    pub basis: Option<Basis>,
}

impl Decision {
    /// True if the request is granted.
    #[must_use]
    pub const fn is_granted(&self) -> bool {
        self.basis.is_some()
    }
}

impl Facts {
    /// Ground on which these facts grant a request; `None` denies it.
    ///
    /// `grant = auth AND available AND appropriate AND ((role_ok AND purpose_ok AND consent) OR (emergency AND
    /// breakglass_role))`. An emergency never replaces authentication.
    #[must_use]
    pub const fn basis(self) -> Option<Basis> {
        // Without short circuits: all facts are known, and the time shall not say which was missing.
        let is_possible = self.auth & self.available & self.appropriate;
        let by_rule = is_possible & self.role_ok & self.purpose_ok & self.consent;
        let by_emergency = is_possible & self.emergency & self.breakglass_role;
        match (by_rule, by_emergency) {
            (true, _) => Some(Basis::Rule),
            (false, true) => Some(Basis::BreakGlass),
            (false, false) => None,
        }
    }

    /// First missing fact; `None` if the request is granted.
    #[must_use]
    pub fn reason(self) -> Option<Reason> {
        if self.basis().is_some() {
            return None;
        }
        let facts = [
            (self.auth, Reason::NotAuthenticated),
            (self.available, Reason::NotAvailable),
            (self.appropriate, Reason::NotAppropriate),
            (self.role_ok, Reason::NoRule),
            (self.purpose_ok, Reason::WrongPurpose),
            (self.consent, Reason::NoConsent),
        ];
        facts.into_iter().find(|(is, _)| !is).map(|(_, reason)| reason)
    }

    /// Facts in the order of the fields.
    #[must_use]
    pub const fn bits(self) -> [bool; 8] {
        let Self { auth, available, appropriate, role_ok, purpose_ok, consent, emergency, breakglass_role } = self;
        [auth, available, appropriate, role_ok, purpose_ok, consent, emergency, breakglass_role]
    }

    /// Facts of bits in the order of the fields.
    #[must_use]
    pub const fn from_bits(bits: [bool; 8]) -> Self {
        let [auth, available, appropriate, role_ok, purpose_ok, consent, emergency, breakglass_role] = bits;
        Self { auth, available, appropriate, role_ok, purpose_ok, consent, emergency, breakglass_role }
    }
}

/// Facts as one digit each, in the order of the fields: entries of granted and denied requests are of one length.
impl fmt::Display for Facts {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.bits().into_iter().try_for_each(|bit| write!(f, "{}", u8::from(bit)))
    }
}

/// Decides about a request of `asker` (`None`: without a valid token) at `now_ms`; a retention without a date counts
/// from `start_ms`, both Unix ms.
///
/// An item covers the resource that it names, and all of a class if it names that. Where several cover a resource, all
/// have to allow its use.
///
/// The time of a decision depends on the policy, the subject and the action, but not on the resource: every item and
/// every rule is compared with it, by digests and without an early end. [`Resource::MAX_NAME`] keeps hashing to one
/// block.
#[must_use]
pub fn decide(policy: &Policy, asker: Option<&Asker<'_>>, request: &Request, start_ms: u64, now_ms: u64) -> Decision {
    let Request { action, resource } = request;
    let asked = [Digest::of(&resource.to_string()), Digest::of(resource.class().name())];
    let covers = |of: &Digest| of.is(&asked[0]) | of.is(&asked[1]);
    let no_roles = BTreeSet::new();
    let roles = asker.map_or(&no_roles, |asker| &asker.subject.roles);
    let purpose = Digest::of(asker.map_or("", |asker| asker.purpose));

    let (yes, no) = (Choice::from(1), Choice::from(0));
    let (mut exists, mut is_kept, mut appropriate, mut purpose_ok, mut consent) = (no, yes, yes, yes, yes);
    let hour = (now_ms / HOUR_MS % 24) as u8;
    for item in &policy.items {
        let is_other = !covers(&item.resource);
        exists |= !is_other;
        is_kept &= is_other | choice(is_kept_at(item, start_ms, now_ms));
        appropriate &= is_other | choice(is_within(item.hours, hour));
        purpose_ok &= is_other | purpose.is_one_of(&item.purposes);
        consent &= is_other | purpose.is_one_of(&item.consent);
    }
    let allows = |rule: &Rule| {
        let is_covered = rule.resources.iter().fold(no, |found, one| found | covers(one));
        let are_alike = policy.items.iter().fold(yes, |alike, item| {
            alike & (!covers(&item.resource) | choice(asker.is_some_and(|asker| shares(rule, asker.subject, item))))
        });
        is_covered & are_alike & choice(rule.is_for(roles, *action))
    };
    let role_ok = policy.rules.iter().fold(no, |found, rule| found | allows(rule));
    let breakglass_role = policy.break_glass.as_ref().map_or(no, |glass| allows(&glass.allows));
    let facts = Facts {
        auth: asker.is_some(),
        available: bool::from(exists & is_kept),
        appropriate: bool::from(exists & appropriate),
        role_ok: bool::from(role_ok),
        purpose_ok: bool::from(exists & purpose_ok),
        consent: bool::from(exists & consent),
        emergency: asker.is_some_and(|asker| asker.is_emergency),
        breakglass_role: bool::from(breakglass_role),
    };
    Decision { facts, basis: facts.basis() }
}

fn choice(is: bool) -> Choice {
    Choice::from(u8::from(is))
}

/// True if subject and item have the same values of all attributes that a rule compares.
fn shares(rule: &Rule, subject: &Subject, item: &Item) -> bool {
    rule.same.iter().all(|name| subject.attributes.get(name).is_some_and(|of| item.attributes.get(name) == Some(of)))
}

/// True while an item is kept: up to the end of its retention, and not before its date.
fn is_kept_at(item: &Item, start_ms: u64, now_ms: u64) -> bool {
    item.kept.is_none_or(|kept| {
        let since_ms = kept.since_ms.unwrap_or(start_ms);
        now_ms.checked_sub(since_ms).is_some_and(|age_ms| age_ms < kept.for_ms)
    })
}

/// True if an hour of the day is within `hours`, which may go over midnight.
fn is_within(hours: Option<[u8; 2]>, hour: u8) -> bool {
    hours.is_none_or(|[from, to]| if from < to { (from..to).contains(&hour) } else { hour >= from || hour < to })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The formula of the specification as a sum of products, over all 256 rows of its table.
    #[test]
    fn the_whole_table_is_the_formula() {
        let mut granted = [0; 2];
        for row in 0_u32..256 {
            let bit = |place: u32| row >> place & 1 == 1;
            let facts = Facts::from_bits([0, 1, 2, 3, 4, 5, 6, 7].map(bit));
            // Bits 0 to 2, and either bits 3 to 5 or bits 6 and 7.
            let by_rule = row & 0b0011_1111 == 0b0011_1111;
            let by_emergency = row & 0b1100_0111 == 0b1100_0111;
            let expected = if by_rule {
                Some(Basis::Rule)
            } else if by_emergency {
                Some(Basis::BreakGlass)
            } else {
                None
            };
            assert_eq!(facts.basis(), expected, "{facts}");
            assert_eq!(facts.reason().is_some(), expected.is_none(), "{facts}");
            assert_eq!(Facts::from_bits(facts.bits()), facts);
            if let Some(basis) = expected {
                granted[basis as usize] += 1;
            }
        }
        // By a rule: 2 free facts. By an emergency: 3 free ones, less the row in which they hold too.
        assert_eq!(granted, [4, 7]);
    }

    #[test]
    fn hours_may_go_over_midnight() {
        let within = |hours, hour| is_within(Some(hours), hour);
        assert!(within([8, 18], 8) && within([8, 18], 17) && !within([8, 18], 18) && !within([8, 18], 7));
        assert!(within([22, 6], 23) && within([22, 6], 5) && !within([22, 6], 6) && !within([22, 6], 21));
        assert!(within([22, 24], 23) && !within([22, 24], 0) && is_within(None, 3));
    }
}
