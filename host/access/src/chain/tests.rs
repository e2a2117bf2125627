//! Tests of the chain: every kind of damage is found, in logs of any content.

use proptest::prelude::*;

use super::*;
use crate::log::Event;

fn key(byte: u8) -> SigningKey {
    SigningKey::from_bytes(&[byte; 32])
}

fn event() -> impl Strategy<Value = Event> {
    let text = "\\PC{0,12}";
    prop_oneof![
        any::<u64>().prop_map(|link| Event::Left { link }),
        (text, text, any::<u64>()).prop_map(|(policy, digest, unsigned)| Event::Started { policy, digest, unsigned }),
        (any::<u64>(), text, text, any::<bool>(), any::<[u8; 16]>(), any::<u64>()).prop_map(
            |(link, subject, purpose, emergency, nonce, until_ms)| {
                Event::Presented { link, subject, purpose, emergency, nonce: nonce.into(), until_ms }
            }
        ),
        (any::<u64>(), text, text, text, text, any::<u64>()).prop_map(
            |(link, subject, action, resource, facts, repeats)| {
                Event::Decided {
                    link,
                    subject,
                    action,
                    resource,
                    facts,
                    basis: Some(crate::Basis::BreakGlass),
                    repeats,
                }
            }
        ),
    ]
}

/// Log with its lines, its head, and the entries in it.
fn log(events: Vec<Event>) -> (Vec<String>, Head, Vec<Entry>) {
    let (mut chain, mut lines, mut entries) = (Chain::default(), Vec::new(), Vec::new());
    for (event, number) in events.into_iter().zip(1..) {
        let entry = Entry { number, at_ms: number * 10, event };
        lines.push(chain.add(&entry));
        entries.push(entry);
    }
    (lines, chain.head(&key(1)), entries)
}

fn check(lines: &[String], head: &Head) -> Result<Vec<Entry>, ChainError> {
    Ok(verify(&lines.concat(), head, &key(1).verifying_key())?.complete()?.entries)
}

proptest! {
    #[test]
    fn a_log_is_read_as_it_was_written(events in prop::collection::vec(event(), 0..20)) {
        let (lines, head, entries) = log(events);
        prop_assert!(lines.iter().all(|line| line.matches('\n').count() == 1 && line.ends_with('\n')));
        prop_assert_eq!(check(&lines, &head), Ok(entries));
    }

    #[test]
    fn a_cut_tail_is_found(events in prop::collection::vec(event(), 1..20), cut in any::<prop::sample::Index>()) {
        let (lines, head, _) = log(events);
        let kept = cut.index(lines.len());
        let truncated = ChainError::Truncated { lines: kept as u64, signed: lines.len() as u64 };
        prop_assert_eq!(check(&lines[..kept], &head), Err(truncated));
    }

    #[test]
    fn a_cut_within_a_line_is_found(events in prop::collection::vec(event(), 1..8), cut in any::<prop::sample::Index>()) {
        let (lines, head, _) = log(events);
        let text = lines.concat();
        let cut = cut.index(text.len());
        if let Some(kept) = text.get(..cut) {
            prop_assert!(verify(kept, &head, &key(1).verifying_key()).is_err());
        }
    }

    #[test]
    fn a_removed_line_is_found(events in prop::collection::vec(event(), 1..20), place in any::<prop::sample::Index>()) {
        let (mut lines, head, _) = log(events);
        lines.remove(place.index(lines.len()));
        prop_assert!(check(&lines, &head).is_err());
    }

    #[test]
    fn a_repeated_line_is_found(events in prop::collection::vec(event(), 1..20), place in any::<prop::sample::Index>()) {
        let (mut lines, head, _) = log(events);
        let place = place.index(lines.len());
        lines.insert(place, lines[place].clone());
        prop_assert!(check(&lines, &head).is_err());
    }

    #[test]
    fn moved_lines_are_found(
        events in prop::collection::vec(event(), 2..20), places in any::<[prop::sample::Index; 2]>(),
    ) {
        let (mut lines, head, _) = log(events);
        let [first, second] = places.map(|place| place.index(lines.len()));
        prop_assume!(first != second);
        lines.swap(first, second);
        prop_assert!(check(&lines, &head).is_err());
    }

    #[test]
    fn an_altered_byte_is_found(
        events in prop::collection::vec(event(), 1..10), place in any::<prop::sample::Index>(), byte in 0_u8..128,
    ) {
        let (lines, head, _) = log(events);
        let mut bytes = lines.concat().into_bytes();
        let place = place.index(bytes.len());
        prop_assume!(bytes[place] != byte);
        bytes[place] = byte;
        if let Ok(text) = String::from_utf8(bytes) {
            let read = verify(&text, &head, &key(1).verifying_key()).and_then(Verified::complete);
            prop_assert!(read.is_err(), "{}", text);
        }
    }

    /// Who has no key can make a chain that is right in itself, but no head for it.
    #[test]
    fn a_log_made_anew_is_found(events in prop::collection::vec(event(), 1..10), other in event()) {
        let (lines, head, _) = log(events.clone());
        let mut changed = events;
        changed[0] = other;
        let (made, other_head, _) = log(changed);
        prop_assume!(made != lines);
        prop_assert_eq!(check(&made, &head), Err(ChainError::Replaced { count: made.len() as u64 }));
        let forged = Head { signature: head.signature, ..other_head };
        prop_assert_eq!(check(&made, &forged), Err(ChainError::BadHead));
    }
}

#[test]
fn an_older_head_shows_what_was_appended_and_a_shorter_log() {
    let events: Vec<Event> = (0..5).map(|link| Event::Left { link }).collect();
    let (lines, head, _) = log(events.clone());
    let (_, older, _) = log(events[..3].to_vec());
    assert_eq!(verify(&lines.concat(), &older, &key(1).verifying_key()).map(|read| read.unsigned), Ok(2));
    assert_eq!(check(&lines, &older), Err(ChainError::Unsigned { extra: 2 }));
    // Log and head set back together verify; a newer head, kept elsewhere, shows it.
    assert!(check(&lines[..3], &older).is_ok());
    assert_eq!(check(&lines[..3], &head), Err(ChainError::Truncated { lines: 3, signed: 5 }));
}

#[test]
fn the_key_of_another_log_is_no_key() {
    let (lines, head, _) = log(vec![Event::Left { link: 1 }]);
    assert_eq!(verify(&lines.concat(), &head, &key(2).verifying_key()).err(), Some(ChainError::BadHead));
    let empty = Chain::default().head(&key(1));
    assert!(check(&[], &empty).is_ok());
}
