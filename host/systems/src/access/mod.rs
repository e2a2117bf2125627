//! ACCESS: who may do what with a shared robot, decided anew for each request.
//!
//! Paper: Zoughalian et al., "Access Control Mechanism Framework for Assistive Robots in Healthcare", TAROS 2023: a
//! checklist in a block diagram (authentication, availability, role, normal or emergency, appropriateness) and a log.
//! It prints no numbers, and leaves open how tokens end, how an emergency ends, and how the log is kept.
//!
//! The method is the crate `r4-access`, which guards the board of `r4 serve --policy`. This system measures it: `space`
//! walks an exhaustive space of policies and requests, `day` scripts a day with forgotten emergencies, clocks that are
//! off and intruders, `tamper` damages the log, `timing` measures times and what they say. No board takes part.

mod day;
mod space;
mod tamper;
mod timing;

use std::{cell::RefCell, collections::BTreeMap, rc::Rc};

use r4_access::{
    Asker, Guard, Policy, Request,
    chain::{Head, Verified, verify},
    decide,
    log::Memory,
    signing_key,
    token::Claims,
};

use crate::{About, Arm, Error, Limit, Metric, Paper, REPORTED, Row, Source, Statistic, System, Target, Trial, Values};
use day::{BEGIN_MS, Kind, Step};

/// Robot system ACCESS, listed in [`crate::all`].
#[derive(Debug)]
pub struct Access;

/// Name of the system in commands and records.
const NAME: &str = "access";

/// Names of the arms.
const PAPER: &str = "paper";
const OURS: &str = "ours";
const NO_ALLOWANCE: &str = "ablation:no-allowance";
const LEFT_ON: &str = "ablation:flag-as-is";

/// Private key of the logs in trials.
const LOG_KEY: [u8; 32] = [18; 32];
/// Time between two requests of the scripted emergency, s.
const EMERGENCY_STEP_S: f64 = 30.0;

const fn arm(name: &'static str, does: &'static str) -> Arm {
    Arm { name, does, is_kinematic: true }
}

const fn none_of(name: &'static str) -> Metric {
    let targets = &[Target { arm: OURS, limit: Limit::AtMost(0.0), from: "set by this project" }];
    Metric { name, unit: "1", statistic: Statistic::Mean, source: Source::Simulated, targets }
}

const fn reported(name: &'static str, unit: &'static str) -> Metric {
    Metric { name, unit, statistic: Statistic::Mean, source: Source::Simulated, targets: &[] }
}

/// Arms and metrics of the system.
static ABOUT: About = About {
    name: NAME,
    paper: Paper {
        title: "Access Control Mechanism Framework for Assistive Robots in Healthcare",
        published: "TAROS 2023",
    },
    question: "Which requests to a shared robot are granted that should not be, or denied that should not be?",
    robot: "osmc-bench",
    reported: REPORTED,
    sampled: &[
        "names of roles, items and purposes of the exhaustive space, and the order of its policies' tables",
        "60 links of four members of staff in a day, six requests each, half of them for what the role may do",
        "clocks of the clients wrong by up to 5 s, uniform: the policy's allowance",
        "changes of tokens, and the places of damage in the log",
        "an emergency whose flag stays on for 1 to 6 hours",
    ],
    arms: &[
        arm(
            PAPER,
            "the printed checklist, as we read it: a signed token authenticates a link for good, an emergency lasts as long as its flag",
        ),
        arm(OURS, "tokens with an end, a nonce and an allowance for clocks, emergencies that end, a signed hash chain"),
        arm(NO_ALLOWANCE, "ours without the allowance for clocks"),
        arm(LEFT_ON, "ours with emergencies that last as long as their flag is on, up to half a day"),
    ],
    metrics: &[
        none_of("space_wrong_grants"),
        none_of("space_wrong_denials"),
        reported("space_decisions", "1"),
        reported("space_grants", "1"),
        none_of("wrong_grants"),
        none_of("wrong_denials"),
        none_of("replayed_missed"),
        none_of("expired_missed"),
        none_of("altered_missed"),
        none_of("forged_missed"),
        none_of("tampering_missed"),
        reported("attacks", "1"),
        reported("tamperings", "1"),
        reported("emergency_s", "s"),
    ],
};

impl System for Access {
    fn about(&self) -> &'static About {
        &ABOUT
    }

    fn run(&self, trial: &Trial) -> Result<Values, Error> {
        let steps = day::steps(trial.seed)?;
        let (granted, log) = match trial.arm {
            PAPER => (by_checklist(&steps)?, None),
            NO_ALLOWANCE => by_guard(&steps, &day::policy(0, 600, 3600)?)?,
            LEFT_ON => by_guard(&steps, &day::policy(5, 43_200, 0)?)?,
            _ => by_guard(&steps, &day::policy(5, 600, 3600)?)?,
        };
        let mut values = judged(&steps, &granted);
        if let Some(log) = log {
            let key = signing_key(LOG_KEY).verifying_key();
            let is_intact = |text: &str, head: &Head| verify(text, head, &key).and_then(Verified::complete).is_ok();
            let whole = log.head.as_ref().is_some_and(|head| is_intact(&log.text, head));
            let (tried, missed) = tamper::attempts(trial.seed, &log, is_intact);
            // A log that does not verify undamaged would find any damage.
            let missed = if whole { missed } else { tried };
            values.insert("tamperings".into(), tried as f64);
            values.insert("tampering_missed".into(), missed as f64);
        }
        if trial.arm == OURS {
            let outcome = space::walked(trial.seed).ok_or_else(|| refused("a policy of the exhaustive space"))?;
            values.insert("space_decisions".into(), outcome.decisions as f64);
            values.insert("space_grants".into(), outcome.grants as f64);
            values.insert("space_wrong_grants".into(), outcome.wrong_grants as f64);
            values.insert("space_wrong_denials".into(), outcome.wrong_denials as f64);
        }
        Ok(values)
    }

    fn timings(&self, is_quick: bool) -> Result<Vec<Row>, Error> {
        timing::rows(is_quick)
    }
}

fn refused(what: &str) -> Error {
    Error::Unsuitable { system: NAME, board: what.to_owned(), why: "the library refuses it".into() }
}

fn read(text: &str) -> Result<Policy, Error> {
    Policy::parse(text).map_err(|error| refused(&error.to_string()))
}

/// Decisions of a guard about each step, and its log.
fn by_guard(steps: &[Step], text: &str) -> Result<(Vec<bool>, Option<Memory>), Error> {
    let memory = Rc::<RefCell<Memory>>::default();
    let store = Box::new(memory.clone());
    let mut guard = Guard::new(read(text)?, store, signing_key(LOG_KEY), &Verified::default(), BEGIN_MS);
    let mut granted = Vec::new();
    for step in steps {
        if let Some(token) = &step.token {
            // A token that is not accepted shows in the decision.
            let _ = guard.present(step.link, token, step.at_ms);
        }
        granted.push(guard.decide(step.link, &step.request, step.at_ms).is_granted());
    }
    drop(guard);
    Ok((granted, Some(memory.take())))
}

/// Decisions of the printed checklist about each step.
fn by_checklist(steps: &[Step]) -> Result<Vec<bool>, Error> {
    let policy = read(&day::policy(5, 600, 3600)?)?;
    let mut links = BTreeMap::<u64, Claims>::new();
    let mut decided = |step: &Step| {
        if let Some(claims) = step.token.as_ref().and_then(|token| policy.verified(token).ok()) {
            links.insert(step.link, claims);
        }
        let claims = links.get(&step.link);
        let asker = claims.and_then(|claims| {
            let subject = policy.subject(&claims.subject)?;
            Some(Asker { subject, purpose: &claims.purpose, is_emergency: claims.emergency })
        });
        let Step { request, at_ms, .. }: &Step = step;
        let request: &Request = request;
        decide(&policy, asker.as_ref(), request, BEGIN_MS, *at_ms).is_granted()
    };
    Ok(steps.iter().map(&mut decided).collect())
}

/// Compares decisions with what the script knows.
fn judged(steps: &[Step], granted: &[bool]) -> Values {
    let both = || steps.iter().zip(granted.iter().copied());
    let count = |is: &dyn Fn(&Step, bool) -> bool| both().filter(|(step, granted)| is(step, *granted)).count() as f64;
    let missed = |kind: Kind| count(&|step, granted| step.kind == kind && granted && !step.is_legitimate);
    let is_attack = |kind| !matches!(kind, Kind::Honest | Kind::Emergency);
    Values::from(
        [
            ("wrong_grants", count(&|step, granted| granted && !step.is_legitimate)),
            ("wrong_denials", count(&|step, granted| !granted && step.is_legitimate)),
            ("replayed_missed", missed(Kind::Replayed)),
            ("expired_missed", missed(Kind::Expired)),
            ("altered_missed", missed(Kind::Altered)),
            ("forged_missed", missed(Kind::Forged)),
            ("attacks", count(&|step, _| is_attack(step.kind))),
            ("emergency_s", EMERGENCY_STEP_S * count(&|step, granted| step.kind == Kind::Emergency && granted)),
        ]
        .map(|(name, value)| (name.to_owned(), value)),
    )
}

#[cfg(test)]
mod tests;
