//! Target of files with parameters, as `r4 config import` reads them with the program's own module.

#[allow(dead_code, reason = "the program uses the rest")]
#[path = "../../../host/cli/src/commands/config/file.rs"]
mod file;

use std::collections::BTreeMap;

use r4_protocol::{ParameterInfo, ParameterKey};

/// Target: reads any text. Accepted values are finite and refer to lines that exist; accepted parameters are read the
/// same when they are written again.
///
/// # Panics
/// An accepted file breaks one of these rules.
pub fn config(bytes: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(bytes) else { return false };
    let Ok(entries) = file::read(text) else { return false };
    let lines = 1 + bytes.iter().filter(|byte| **byte == b'\n').count();
    let mut known: BTreeMap<String, (ParameterKey, f32)> = BTreeMap::new();
    for file::Entry { line, key, value } in entries {
        assert!((1..=lines).contains(&line) && value.is_finite(), "{line}: {key} = {value}");
        if let Ok(key) = key.parse::<ParameterKey>() {
            known.insert(key.to_string(), (key, value));
        }
    }
    let infos: Vec<_> =
        known.values().map(|(key, set)| ParameterInfo { key: *key, active: 0.0, set: *set, built_in: 0.0 }).collect();
    let again = file::read(&file::write("again", &infos)).expect("what is written is read");
    let again: Vec<_> = again.into_iter().map(|entry| (entry.key, entry.value.to_bits())).collect();
    let before: Vec<_> = known.iter().map(|(key, (_, value))| (key.clone(), value.to_bits())).collect();
    assert_eq!(again, before);
    !before.is_empty()
}
