//! Tests of the texts of refusals, states and readings for users.

use std::collections::BTreeSet;

use r4_protocol::{Cause, Causes, Quality, Refusal, SafetyState, ToHost};

use crate::samples;

/// Returns at least one refusal of every variant: the golden table has them all.
fn refusals() -> Vec<Refusal> {
    let refusal = |message| match message {
        ToHost::Response { result: Err(refusal), .. } => Some(refusal),
        _ => None,
    };
    samples::to_host().into_iter().filter_map(|(_, message)| refusal(message)).collect()
}

#[test]
fn a_refusal_says_what_is_wrong_with_what_was_asked() {
    let mut seen = BTreeSet::new();
    for refusal in refusals() {
        let text = refusal.to_string();
        let named = match refusal {
            Refusal::Denied => vec!["--token".into()],
            Refusal::UnknownMessage => vec!["does not know".into()],
            Refusal::ProtocolMismatch { version, schema } => vec![version.to_string(), format!("{schema:016x}")],
            Refusal::UnknownChannel { channel }
            | Refusal::NotFinite { channel }
            | Refusal::BadGains { channel }
            | Refusal::BadBinding { channel } => vec![channel.to_string()],
            Refusal::NoSuchIndex { index } => vec![index.to_string()],
            Refusal::WrongMode { channel, mode } => vec![channel.to_string(), mode.to_string()],
            Refusal::OutOfRange { channel, asked, range } => {
                vec![channel.to_string(), asked.to_string(), range.min.to_string(), range.max.to_string()]
            }
            // Advice on each cause is part of the text.
            Refusal::CausesPresent { causes } => {
                causes.iter().flat_map(|cause| [cause.to_string(), cause.advice().into()]).collect()
            }
            Refusal::Tripped { causes } => vec![causes.to_string()],
            Refusal::Expired { age_ms, ttl_ms } => vec![age_ms.to_string(), ttl_ms.to_string()],
            Refusal::ClockAhead { ahead_ms } => vec![ahead_ms.to_string()],
            Refusal::NotArmed { state } | Refusal::NotWhile { state } => vec![state.to_string()],
            Refusal::UnknownParameter { key } => vec![key.to_string()],
            Refusal::BadParameter { key, value } => vec![key.to_string(), value.to_string()],
            Refusal::NoAcknowledge { address } => vec![format!("{address:#04x}")],
            _ => vec![],
        };
        for word in named {
            assert!(text.contains(&word), "no `{word}` in `{text}`");
        }
        assert!(text.contains(' ') && !text.contains('\n'), "{text}");
        assert!(seen.insert(text), "{refusal:?} says the same as another");
    }
    let tripped = Refusal::NotArmed { state: SafetyState::Tripped }.to_string();
    assert!(tripped.ends_with("clear it first"), "{tripped}");
}

#[test]
fn a_board_that_stopped_names_all_its_causes() {
    let causes = Causes::only(Cause::Proximity).union(Causes::only(Cause::LinkLost));
    let text = Refusal::CausesPresent { causes }.to_string();
    assert_eq!(
        text,
        "still present: proximity, link lost; clear the space in front of the range sensors; \
         keep one host connected; it must send a heartbeat within the timeout"
    );
}

#[test]
fn states_and_readings_are_told_apart() {
    let states = [SafetyState::Disarmed, SafetyState::Armed, SafetyState::Tripped].map(|state| state.to_string());
    assert_eq!(states, ["disarmed", "armed", "tripped"]);
    let qualities = [
        Quality::Good,
        Quality::None,
        Quality::OutOfRange,
        Quality::NoAnswer,
        Quality::Stuck,
        Quality::Low,
        Quality::High,
        Quality::Stale,
        Quality::WrongChip,
        Quality::Saturated,
        Quality::NoMagnet,
        Quality::WeakMagnet,
        Quality::StrongMagnet,
    ];
    let texts: BTreeSet<_> = qualities.iter().map(ToString::to_string).collect();
    assert!(texts.len() == qualities.len() && !texts.contains(""), "{texts:?}");
}
