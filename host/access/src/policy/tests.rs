//! Tests of policies: errors with their lines, and decisions by single properties.

use super::*;
use crate::{Asker, Class, Facts, Request, Resource, decide};

const KEY: &str = "11qYAYKxCrfVS_7TyWQHOg7hcvPapiMlrwIaaPcHURo";

/// Policy with one subject, item and rule, and `more` behind them.
fn text(item: &str, rule: &str, more: &str) -> String {
    format!(
        "name = \"p\"\n[[subject]]\nname = \"alice\"\nkey = \"{KEY}\"\nroles = [\"nurse\"]\nattributes = {{ ward = \"3\" }}\n\
         [[item]]\nresource = \"recording\"\npurposes = [\"care\", \"study\"]\n{item}\n\
         [[rule]]\nroles = [\"nurse\"]\nactions = [\"read\"]\nresources = [\"recording\"]\n{rule}\n{more}"
    )
}

fn facts(text: &str, resource: &str, purpose: &str, now_ms: u64) -> Facts {
    let policy = Policy::parse(text).expect("valid");
    let subject = policy.subject("alice").expect("known");
    let asker = Asker { subject, purpose, is_emergency: false };
    let request = Request { action: Action::Read, resource: resource.parse().expect("a resource") };
    decide(&policy, Some(&asker), &request, 0, now_ms).facts
}

#[test]
fn each_error_names_its_line_and_the_next_step() {
    for (item, rule, more, line, says) in [
        ("", "actions = [\"fly\"]", "", 15, "duplicate key"),
        ("consent = [\"sale\"]", "", "", 10, "no purpose of this item"),
        ("retention_s = 0", "", "", 10, "must be 1 to"),
        ("hours_utc = [8, 8]", "", "", 10, "hour after the last"),
        ("hours_utc = [8, 25]", "", "", 10, "0 to 24"),
        ("since = 2026-11-28", "", "", 10, "add that"),
        ("retention_s = 5\nsince = 12:00:00", "", "", 11, "from 1970 on"),
        ("colour = 1", "", "", 10, "unknown field"),
        (
            "",
            "",
            "[[rule]]\nroles = [\"nurse\"]\nactions = [\"stop\"]\nresources = [\"recording\"]",
            18,
            "never refused",
        ),
        (
            "",
            "",
            "[[rule]]\nroles = [\"nurse\"]\nactions = [\"fly\"]\nresources = [\"recording\"]",
            18,
            "no action `fly`",
        ),
        (
            "",
            "",
            "[[rule]]\nroles = [\"nurse\"]\nactions = [\"set\"]\nresources = [\"channel/osmc0\"]",
            19,
            "no [[item]]",
        ),
        ("", "", "[[rule]]\nroles = [\"nurse\"]\nactions = [\"set\"]\nresources = [\"wing\"]", 19, "no resource"),
        (
            "",
            "",
            "[[rule]]\nroles = [\"surgeon\"]\nactions = [\"set\"]\nresources = [\"recording\"]",
            17,
            "role `surgeon`",
        ),
        ("", "", "[[rule]]\nroles = []\nactions = [\"set\"]\nresources = [\"recording\"]", 17, "is empty"),
        ("", "", "[[item]]\nresource = \"recording\"\npurposes = [\"care\"]", 17, "twice"),
        ("", "", "[[subject]]\nname = \"bob\"\nkey = \"abc\"", 18, "r4 access key"),
        ("", "", "[token]\nlife_s = 5", 17, "10 to 3600"),
        ("", "", "[token]\nskew_s = 61", 17, "0 to 60"),
    ] {
        let error = Policy::parse(&text(item, rule, more)).expect_err(says).to_string();
        assert!(error.starts_with(&format!("line {line} ")) && error.contains(says), "{says}: {error}");
    }
}

#[test]
fn the_absent_is_denied() {
    let none = "name = \"p\"";
    assert_eq!(Policy::parse(none).expect("valid").subjects().count(), 0);
    let policy = Policy::parse(none).expect("valid");
    let request = Request { action: Action::Read, resource: Resource::whole(Class::Log) };
    let decision = decide(&policy, None, &request, 0, 0);
    assert_eq!((decision.facts.bits(), decision.basis), ([false; 8], None));
}

#[test]
fn retention_counts_from_its_date() {
    let until = |since: &str| text(&format!("retention_s = 100\n{since}"), "", "");
    let is = |text: &str, seconds: u64| facts(text, "recording/a", "care", seconds * 1000).available;
    let dated = until("since = 1970-01-01T00:16:40Z");
    assert!(!is(&dated, 999) && is(&dated, 1000) && is(&dated, 1099) && !is(&dated, 1100));
    // Without a date it counts from the start of the guard, here 0.
    let undated = until("");
    assert!(is(&undated, 99) && !is(&undated, 100));
}

#[test]
fn purpose_and_consent_are_of_the_item() {
    let text = text("consent = [\"care\"]", "", "");
    let of = |purpose| {
        let facts = facts(&text, "recording/a", purpose, 0);
        (facts.purpose_ok, facts.consent)
    };
    assert_eq!((of("care"), of("study"), of("sale")), ((true, true), (true, false), (false, false)));
}

#[test]
fn an_item_of_its_own_narrows_its_class() {
    let text = text("", "", "[[item]]\nresource = \"recording/b\"\npurposes = [\"care\"]\nhours_utc = [8, 18]");
    let at_night = facts(&text, "recording/b", "care", 0);
    assert!(!at_night.appropriate && at_night.role_ok);
    assert!(facts(&text, "recording/a", "care", 0).appropriate);
    assert!(!facts(&text, "recording/b", "study", 0).purpose_ok && facts(&text, "recording/a", "study", 0).purpose_ok);
}

#[test]
fn compared_attributes_must_be_there_and_alike() {
    let role_ok = |item: &str, same: &str| facts(&text(item, same, ""), "recording/a", "care", 0).role_ok;
    assert!(role_ok("attributes = { ward = \"3\" }", "same = [\"ward\"]"));
    assert!(!role_ok("attributes = { ward = \"4\" }", "same = [\"ward\"]"));
    assert!(!role_ok("", "same = [\"ward\"]") && !role_ok("", "same = [\"floor\"]"));
    assert!(role_ok("attributes = { ward = \"4\" }", ""));
}
