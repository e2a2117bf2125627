//! Damage to a log, and whether its verification finds it.

use r4_access::{chain, log::Memory};

use crate::Sampler;

/// Kinds of damage to a log.
#[derive(Clone, Copy, Debug)]
enum Damage {
    CutTail,
    CutWithin,
    Removed,
    Repeated,
    Moved,
    Altered,
}

/// Damages a log in every way, a few times each. Returns the number of attempts, and of those that stay unnoticed.
pub(super) fn attempts(seed: u64, log: &Memory, is_intact: impl Fn(&str, &chain::Head) -> bool) -> (u64, u64) {
    let mut sampler = Sampler::new(seed, 3);
    let Some(head) = &log.head else { return (0, 0) };
    let kinds = [Damage::CutTail, Damage::CutWithin, Damage::Removed, Damage::Repeated, Damage::Moved, Damage::Altered];
    let (mut tried, mut missed) = (0, 0);
    for kind in kinds.into_iter().cycle().take(4 * kinds.len()) {
        let damaged = damaged(&mut sampler, &log.text, kind);
        if damaged != log.text {
            tried += 1;
            missed += u64::from(is_intact(&damaged, head));
        }
    }
    (tried, missed)
}

fn damaged(sampler: &mut Sampler, text: &str, kind: Damage) -> String {
    let mut lines: Vec<&str> = text.split_inclusive('\n').collect();
    let mut place = |len: usize| (sampler.uniform(0.0, len as f64) as usize).min(len.saturating_sub(1));
    if lines.len() < 2 {
        return String::new();
    }
    match kind {
        Damage::CutTail => lines.truncate(place(lines.len())),
        Damage::CutWithin => return text.chars().take(place(text.len())).collect(),
        Damage::Removed => {
            lines.remove(place(lines.len()));
        }
        Damage::Repeated => lines.insert(place(lines.len()), lines[0]),
        Damage::Moved => {
            let (first, second) = (place(lines.len()), place(lines.len()));
            lines.swap(first, second);
        }
        // A digit that is another one: the log stays JSON of the same form.
        Damage::Altered => {
            let digits: Vec<usize> =
                text.char_indices().filter(|(_, c)| c.is_ascii_digit()).map(|(at, _)| at).collect();
            let at = digits[place(digits.len())];
            let digit = if text[at..].starts_with('7') { "8" } else { "7" };
            return [&text[..at], digit, &text[at + 1..]].concat();
        }
    }
    lines.concat()
}
