//! Scripted day of a shared robot: honest clients with clocks that are off, a forgotten emergency, and intruders.
//!
//! The script knows of each step who does it and whether it is legitimate, from its own tables. Nothing here uses the
//! library's decision.

use r4_access::{Action, Credential, Request, Resource, token::Nonce};

use crate::{Error, Sampler};

/// Begin of the day, Unix ms: 2026-11-28 00:00 UTC.
pub(super) const BEGIN_MS: u64 = 1_795_824_000_000;
/// Life of a token, ms.
const LIFE_MS: u64 = 60_000;
/// Allowance of the policy for clocks, ms.
const SKEW_MS: f64 = 5_000.0;
/// Duration of an emergency, ms.
const EMERGENCY_MS: u64 = 600_000;
/// Number of links in a day.
const LINKS: u64 = 60;

/// Members of staff with their roles.
const STAFF: [(&str, &str); 4] =
    [("olga", "operator"), ("nora", "nurse"), ("emil", "engineer"), ("rita", "researcher")];
/// Role, action and resource of each rule.
const RULES: [(&str, &str, &str); 6] = [
    ("operator", "set", "channel"),
    ("operator", "arm", "board"),
    ("nurse", "read", "channel"),
    ("engineer", "configure", "configuration"),
    ("engineer", "read", "log"),
    ("researcher", "read", "recording"),
];
/// Classes of the items that exist.
const ITEMS: [&str; 5] = ["board", "channel", "configuration", "log", "recording"];
/// Purpose of all items.
const PURPOSE: &str = "care";

/// Kind of a step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Kind {
    /// A member of staff with a token of its own.
    Honest,
    /// A request after the end of the link's token.
    Expired,
    /// A token that came before, on another link.
    Replayed,
    /// A token whose claims or signature were changed.
    Altered,
    /// A token signed by another key.
    Forged,
    /// A flag of an emergency, within its time or long after it.
    Emergency,
}

/// One step of the day.
#[derive(Clone, Debug)]
pub(super) struct Step {
    pub(super) kind: Kind,
    pub(super) link: u64,
    /// Token that the link presents before the request; `None` if it presents none now.
    pub(super) token: Option<String>,
    /// Time of the guard's clock, Unix ms.
    pub(super) at_ms: u64,
    pub(super) request: Request,
    /// True if the request has to be granted.
    pub(super) is_legitimate: bool,
}

fn credential(name: &str) -> Result<Credential, Error> {
    let mut secret = [0; 32];
    secret[..name.len()].copy_from_slice(name.as_bytes());
    Credential::with_key(name, "ward-3", PURPOSE, LIFE_MS / 1000, r4_access::signing_key(secret)).map_err(broken)
}

fn broken(why: impl std::fmt::Display) -> Error {
    Error::Unsuitable { system: super::NAME, board: "the scripted day".into(), why: why.to_string() }
}

/// Text of the policy, with an allowance for clocks and the times of an emergency, s.
pub(super) fn policy(skew_s: u64, emergency_s: u64, rest_s: u64) -> Result<String, Error> {
    let mut text = format!(
        "name = \"ward-3\"\n[token]\nlife_s = 60\nskew_s = {skew_s}\n[break_glass]\nroles = [\"nurse\"]\n\
         actions = [\"read\"]\nresources = [\"log\"]\nlife_s = {emergency_s}\nrest_s = {rest_s}\n"
    );
    for (name, role) in STAFF {
        let key = credential(name)?.public_key();
        text += &format!("[[subject]]\nname = \"{name}\"\nkey = \"{key}\"\nroles = [\"{role}\"]\n");
    }
    for item in ITEMS {
        text += &format!("[[item]]\nresource = \"{item}\"\npurposes = [\"{PURPOSE}\"]\n");
    }
    for (role, action, resource) in RULES {
        text += &format!("[[rule]]\nroles = [\"{role}\"]\nactions = [\"{action}\"]\nresources = [\"{resource}\"]\n");
    }
    Ok(text)
}

/// Sampler of a whole number below `end`.
fn below(sampler: &mut Sampler, end: u64) -> u64 {
    (sampler.uniform(0.0, end as f64) as u64).min(end - 1)
}

/// Steps of the day of a seed, in the order of their times.
pub(super) fn steps(seed: u64) -> Result<Vec<Step>, Error> {
    let mut sampler = Sampler::new(seed, 2);
    let mut steps = Vec::new();
    for link in 0..LINKS {
        // A link every 20 minutes, and intruders on links of their own.
        let begin_ms = BEGIN_MS + link * 1_200_000;
        honest(&mut sampler, 10 * link, begin_ms, &mut steps)?;
    }
    left_on(&mut sampler, &mut steps)?;
    steps.sort_by_key(|step| step.at_ms);
    Ok(steps)
}

/// Link of a member of staff for a few minutes, with what intruders make of its token.
fn honest(sampler: &mut Sampler, link: u64, begin_ms: u64, steps: &mut Vec<Step>) -> Result<(), Error> {
    let (name, role) = STAFF[below(sampler, STAFF.len() as u64) as usize];
    let member = credential(name)?;
    // The client's clock is off by up to the allowance, less the milliseconds of rounding.
    let error_ms = sampler.uniform(1.0 - SKEW_MS, SKEW_MS - 1.0) as i64;
    let client_ms = |at_ms: u64| at_ms.saturating_add_signed(error_ms);
    let nonce = |sampler: &mut Sampler| Nonce::from(std::array::from_fn(|_| below(sampler, 256) as u8));
    let key = |name: &str| credential(name).map(|credential| credential.signing_key().clone());
    let mut at_ms = begin_ms;
    let claims = member.claims(false, nonce(sampler), client_ms(at_ms));
    let token = claims.sign(&key(name)?);
    let mut presented = Some(token.clone());
    for _ in 0..6 {
        let (request, is_legitimate) = request(sampler, role)?;
        steps.push(Step { kind: Kind::Honest, link, token: presented.take(), at_ms, request, is_legitimate });
        at_ms += 1 + below(sampler, 8_000);
    }
    // An intruder has read the token, and presents it on a link of its own within its life and after it.
    let wanted = wanted(role)?;
    let attack = |kind, place: u64, token: String, at_ms| Step {
        kind,
        link: link + place,
        token: Some(token),
        at_ms,
        request: wanted.clone(),
        is_legitimate: false,
    };
    steps.push(attack(Kind::Replayed, 1, token.clone(), at_ms));
    steps.push(attack(Kind::Replayed, 2, token.clone(), begin_ms + LIFE_MS + 60_000));
    let mut altered = claims.clone();
    match below(sampler, 4) {
        0 => altered.expires_ms += 1_000,
        1 => altered.emergency = true,
        2 => altered.nonce = nonce(sampler),
        _ => altered.subject = STAFF[(below(sampler, 3) as usize + 1) % STAFF.len()].0.into(),
    }
    // The claims of one token under the signature of another.
    let (signed, other) = (altered.sign(&key("mallory")?), token.rsplit_once('.').map(|(_, signature)| signature));
    let body = signed.rsplit_once('.').map_or("", |(body, _)| body);
    if altered != claims {
        steps.push(attack(Kind::Altered, 3, format!("{body}.{}", other.unwrap_or("")), at_ms));
    }
    let mut bytes = token.clone().into_bytes();
    let place = below(sampler, bytes.len() as u64) as usize;
    bytes[place] = if bytes[place] == b'A' { b'B' } else { b'A' };
    steps.push(attack(Kind::Altered, 4, String::from_utf8_lossy(&bytes).into_owned(), at_ms + 1));
    let mut forged = claims.clone();
    forged.nonce = nonce(sampler);
    steps.push(attack(Kind::Forged, 5, forged.sign(&key("mallory")?), at_ms + 2));
    // The same link goes on after the end of its token, by more than twice the allowance.
    let late_ms = begin_ms + LIFE_MS + 3 * SKEW_MS as u64 + below(sampler, 300_000);
    steps.push(Step { kind: Kind::Expired, link, token: None, at_ms: late_ms, request: wanted, is_legitimate: false });
    Ok(())
}

/// Emergency of a nurse whose flag stays on for hours.
fn left_on(sampler: &mut Sampler, steps: &mut Vec<Step>) -> Result<(), Error> {
    let nurse = credential("nora")?;
    let begin_ms = BEGIN_MS + 3_600_000 + below(sampler, 36_000_000);
    let hours = 1 + below(sampler, 6);
    // Every 30 s with a new token, which says that the emergency goes on.
    for (count, at_ms) in (begin_ms..begin_ms + hours * 3_600_000).step_by(30_000).enumerate() {
        let nonce = Nonce::from(std::array::from_fn(|_| below(sampler, 256) as u8));
        steps.push(Step {
            kind: Kind::Emergency,
            link: 10_000 + count as u64,
            token: Some(nurse.claims(true, nonce, at_ms).sign(nurse.signing_key())),
            at_ms,
            request: asked("read", "log")?,
            is_legitimate: at_ms < begin_ms + EMERGENCY_MS,
        });
    }
    Ok(())
}

/// Request for something that the role may do.
fn wanted(role: &str) -> Result<Request, Error> {
    let rule = RULES.iter().find(|(of, _, _)| *of == role).copied();
    let (_, action, resource) = rule.ok_or_else(|| broken("a role without a rule"))?;
    asked(action, resource)
}

/// Request of any action on any item, and whether the role may do that.
fn request(sampler: &mut Sampler, role: &str) -> Result<(Request, bool), Error> {
    if below(sampler, 2) == 0 {
        return Ok((wanted(role)?, true));
    }
    let action = Action::ALL[below(sampler, Action::ALL.len() as u64) as usize].name();
    let class = ["board", "channel", "configuration", "log", "recording", "faults", "bus"];
    let resource = class[below(sampler, class.len() as u64) as usize];
    let is_legitimate = RULES.contains(&(role, action, resource));
    Ok((asked(action, resource)?, is_legitimate))
}

fn asked(action: &str, resource: &str) -> Result<Request, Error> {
    let action = Action::named(action).ok_or_else(|| broken(action))?;
    let resource: Resource = resource.parse().map_err(broken)?;
    Ok(Request { action, resource })
}
