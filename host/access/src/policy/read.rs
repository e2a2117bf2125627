//! Reading of a policy from TOML, with all of its checks.

use std::{
    collections::{BTreeMap, BTreeSet},
    fs,
    ops::{Range, RangeInclusive},
    path::Path,
};

use data_encoding::HEXLOWER;
use serde::Deserialize;
use sha2::{Digest as _, Sha256};
use toml::{Spanned, value::Datetime};

use super::{BreakGlass, Item, Kept, Policy, PolicyError, Problem, Rule, Subject, date};
use crate::{
    Action, Resource,
    action::Class,
    credential::{MAX_NAME, is_name, public_key},
    digest::Digest,
};

/// Range of a token's life, s. Ten seconds allow a renewal over a slow link; an hour is the most that a stolen one is
/// worth.
const LIFE_S: RangeInclusive<u64> = 10..=3600;
/// Life of a token unless the policy says otherwise, s.
const DEFAULT_LIFE_S: u64 = 300;
/// Range of the allowance for clocks, s. Clocks kept by NTP agree within 1 s (RFC 5905, section 10, at a distance of
/// 1.5 s they count as unfit), and each second lengthens the life of a stolen token.
const SKEW_S: RangeInclusive<u64> = 0..=60;
/// Allowance for clocks unless the policy says otherwise, s.
const DEFAULT_SKEW_S: u64 = 5;
/// Range of an emergency's duration, s: at most a shift of 12 hours.
const EMERGENCY_S: RangeInclusive<u64> = 10..=43_200;
/// Range of the rest after an emergency, s: at most a week.
const REST_S: RangeInclusive<u64> = 0..=604_800;
/// Range of a retention, s: at most 30 years.
const RETENTION_S: RangeInclusive<u64> = 1..=946_080_000;

/// Word of a policy with its place.
type Word = Spanned<String>;

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct File {
    name: Word,
    #[serde(default)]
    token: Token,
    break_glass: Option<Glass>,
    #[serde(default)]
    subject: Vec<Person>,
    #[serde(default)]
    item: Vec<Thing>,
    #[serde(default)]
    rule: Vec<Permission>,
}

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
struct Token {
    life_s: Option<Spanned<u64>>,
    skew_s: Option<Spanned<u64>>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Glass {
    roles: Spanned<Vec<Word>>,
    actions: Spanned<Vec<Word>>,
    resources: Spanned<Vec<Word>>,
    life_s: Spanned<u64>,
    rest_s: Spanned<u64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Person {
    name: Word,
    key: Word,
    #[serde(default)]
    roles: Vec<Word>,
    #[serde(default)]
    attributes: BTreeMap<String, String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Thing {
    resource: Word,
    purposes: Spanned<Vec<Word>>,
    consent: Option<Vec<Word>>,
    retention_s: Option<Spanned<u64>>,
    since: Option<Spanned<Datetime>>,
    hours_utc: Option<Spanned<[u8; 2]>>,
    #[serde(default)]
    attributes: BTreeMap<String, String>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Permission {
    roles: Spanned<Vec<Word>>,
    actions: Spanned<Vec<Word>>,
    resources: Spanned<Vec<Word>>,
    #[serde(default)]
    same: Vec<String>,
}

impl Policy {
    /// Reads a policy from a file.
    ///
    /// # Errors
    /// [`PolicyError`], with the line in the file.
    pub fn read(path: &Path) -> Result<Self, PolicyError> {
        let text = fs::read_to_string(path).map_err(|source| PolicyError::Read { path: path.to_owned(), source })?;
        Self::parse(&text)
    }

    /// Reads a policy from its text.
    ///
    /// # Errors
    /// [`PolicyError`], with the line in the text.
    pub fn parse(text: &str) -> Result<Self, PolicyError> {
        let line = |span: Range<usize>| text.get(..span.start).map_or(1, |before| before.matches('\n').count() + 1);
        let file: File = toml::from_str(text).map_err(|error| PolicyError::Syntax {
            line: line(error.span().unwrap_or(0..0)),
            why: error.message().to_owned(),
        })?;
        checked(file, HEXLOWER.encode(&Sha256::digest(text.as_bytes())))
            .map_err(|(span, problem)| PolicyError::Bad { line: line(span), problem })
    }
}

/// Problem with its place in the text.
type Found = (Range<usize>, Problem);

fn checked(file: File, digest: String) -> Result<Policy, Found> {
    let mut subjects = BTreeMap::new();
    let mut known_roles = BTreeSet::new();
    for person in file.subject {
        let (span, subject) = (person.name.span(), subject(person)?);
        known_roles.extend(subject.roles.iter().cloned());
        if let Some(before) = subjects.insert(subject.name.clone(), subject) {
            return Err((span, Problem::Twice(before.name)));
        }
    }
    let mut covered = BTreeSet::new();
    let mut items = Vec::new();
    for thing in file.item {
        let span = thing.resource.span();
        let resource = resource(&thing.resource)?;
        if !covered.insert(resource.clone()) {
            return Err((span, Problem::Twice(resource.to_string())));
        }
        items.push(item(thing, &resource)?);
    }
    let rule = |permission| rule(permission, &known_roles, &covered);
    let rules = file.rule.into_iter().map(rule).collect::<Result<Vec<_>, _>>()?;
    let break_glass = file.break_glass.map(|glass| {
        let Glass { roles, actions, resources, life_s, rest_s } = glass;
        Ok(BreakGlass {
            life_ms: duration_ms("life_s", &life_s, EMERGENCY_S)?,
            rest_ms: duration_ms("rest_s", &rest_s, REST_S)?,
            allows: rule(Permission { roles, actions, resources, same: Vec::new() })?,
        })
    });
    let or_default = |value: Option<Spanned<u64>>, field, default_s: u64, range| match value {
        Some(value) => duration_ms(field, &value, range),
        None => Ok(default_s * 1000),
    };
    Ok(Policy {
        name: name(&file.name)?,
        digest,
        life_ms: or_default(file.token.life_s, "life_s", DEFAULT_LIFE_S, LIFE_S)?,
        skew_ms: or_default(file.token.skew_s, "skew_s", DEFAULT_SKEW_S, SKEW_S)?,
        break_glass: break_glass.transpose()?,
        subjects,
        items,
        rules,
    })
}

fn name(word: &Word) -> Result<String, Found> {
    let text = word.get_ref();
    if is_name(text) {
        Ok(text.clone())
    } else {
        Err((word.span(), Problem::BadName(text.chars().take(MAX_NAME).collect())))
    }
}

fn names(words: &[Word]) -> Result<BTreeSet<String>, Found> {
    words.iter().map(name).collect()
}

fn digests(words: &[Word]) -> Result<Vec<Digest>, Found> {
    words.iter().map(|word| name(word).map(|name| Digest::of(&name))).collect()
}

fn resource(word: &Word) -> Result<Resource, Found> {
    word.get_ref().parse().map_err(|error| (word.span(), Problem::UnknownResource(error)))
}

fn filled(field: &'static str, words: Spanned<Vec<Word>>) -> Result<Vec<Word>, Found> {
    if words.get_ref().is_empty() { Err((words.span(), Problem::Empty(field))) } else { Ok(words.into_inner()) }
}

fn duration_ms(field: &'static str, value: &Spanned<u64>, range: RangeInclusive<u64>) -> Result<u64, Found> {
    let seconds = *value.get_ref();
    if range.contains(&seconds) {
        return Ok(seconds * 1000);
    }
    Err((value.span(), Problem::BadDuration { field, value: seconds, range }))
}

fn subject(person: Person) -> Result<Subject, Found> {
    let key = public_key(person.key.get_ref()).ok_or((person.key.span(), Problem::BadKey))?;
    let (name, roles) = (name(&person.name)?, names(&person.roles)?);
    Ok(Subject { name, key, roles, attributes: person.attributes })
}

fn item(thing: Thing, resource: &Resource) -> Result<Item, Found> {
    let purposes = filled("purposes", thing.purposes)?;
    let known = names(&purposes)?;
    // An item that concerns no person needs no consent: without the key its purposes are enough.
    let consent = thing.consent.as_ref().unwrap_or(&purposes);
    if let Some(other) = consent.iter().find(|word| !known.contains(word.get_ref())) {
        return Err((other.span(), Problem::ConsentWithoutPurpose(other.get_ref().clone())));
    }
    let kept = match (&thing.retention_s, &thing.since) {
        (Some(retention_s), since) => {
            let for_ms = duration_ms("retention_s", retention_s, RETENTION_S)?;
            let since = since.as_ref();
            let since = since.map(|at| date::unix_ms(at.get_ref()).ok_or((at.span(), Problem::BadDate)));
            Some(Kept { since_ms: since.transpose()?, for_ms })
        }
        (None, Some(since)) => return Err((since.span(), Problem::SinceWithoutRetention)),
        (None, None) => None,
    };
    if let Some(hours) = &thing.hours_utc
        && let [from, to] = *hours.get_ref()
        && (from > 23 || to > 24 || from == to)
    {
        return Err((hours.span(), Problem::BadHours([from, to])));
    }
    Ok(Item {
        resource: Digest::of(&resource.to_string()),
        purposes: digests(&purposes)?,
        consent: digests(consent)?,
        kept,
        hours: thing.hours_utc.map(Spanned::into_inner),
        attributes: thing.attributes,
    })
}

fn rule(permission: Permission, known_roles: &BTreeSet<String>, covered: &BTreeSet<Resource>) -> Result<Rule, Found> {
    let roles = filled("roles", permission.roles)?;
    if let Some(unknown) = roles.iter().find(|role| !known_roles.contains(role.get_ref())) {
        return Err((unknown.span(), Problem::NoSuchRole(unknown.get_ref().clone())));
    }
    let mut actions = 0;
    for word in filled("actions", permission.actions)? {
        actions |= action(&word)?.bit();
    }
    let mut resources = Vec::new();
    for word in filled("resources", permission.resources)? {
        let resource = resource(&word)?;
        let class: Class = resource.class();
        // A rule for a class is of use where one item of it exists; a rule for one resource, where that or its class does.
        let is_covered = if resource == Resource::whole(class) {
            covered.iter().any(|item| item.class() == class)
        } else {
            covered.contains(&resource) || covered.contains(&Resource::whole(class))
        };
        if !is_covered {
            return Err((word.span(), Problem::NoItem(resource)));
        }
        resources.push(Digest::of(&resource.to_string()));
    }
    Ok(Rule { roles: roles.into_iter().map(Spanned::into_inner).collect(), actions, resources, same: permission.same })
}

fn action(word: &Word) -> Result<Action, Found> {
    let name = word.get_ref();
    Action::named(name).ok_or_else(|| {
        let problem = match name.as_str() {
            "stop" | "disarm" => Problem::NeverRefused(name.clone()),
            _ => Problem::UnknownAction(name.clone()),
        };
        (word.span(), problem)
    })
}
