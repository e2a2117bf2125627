//! Parameters as TOML: one table per channel, and one for the board.

use std::{collections::BTreeMap, fmt, fmt::Write as _};

use r4_protocol::ParameterInfo;
use r4_rig::ParameterUnits;
use toml::{Spanned, Value};

/// One value of a parameter file.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Entry {
    /// Line of the value, counted from 1.
    pub(super) line: usize,
    /// Key of the parameter, as in osmc0.position_kp; the board decides whether it exists.
    pub(super) key: String,
    pub(super) value: f32,
}

/// Error in a parameter file, with its line.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Mistake {
    line: usize,
    what: String,
}

impl fmt::Display for Mistake {
    /// Writes line and error, to follow the file's name.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}: {}", self.line, self.what)
    }
}

/// Returns the text of a parameter file: `title` as a comment, and the values that are effective after the next
/// restart.
pub(super) fn write(title: &str, parameters: &[ParameterInfo]) -> String {
    let mut text = format!("# {title}\n");
    let mut table = String::new();
    let units = ParameterUnits::of(parameters);
    for info in parameters {
        let ParameterInfo { set, built_in, .. } = info;
        let key = info.key.to_string();
        let Some((scope, name)) = key.split_once('.') else { continue };
        if scope != table {
            // Writing to a `String` cannot fail.
            let _ = write!(text, "\n[{scope}]\n");
            table = scope.to_owned();
        }
        // `{:?}` writes the shortest float that reads back as the same number, with the decimal point that TOML
        // requires.
        let _ = write!(text, "{name} = {set:?}");
        let unit = units.unit(info.key);
        let built_in = if set == built_in { String::new() } else { format!("built in: {built_in:?}") };
        let notes: Vec<String> = [unit, built_in].into_iter().filter(|note| !note.is_empty()).collect();
        if !notes.is_empty() {
            let _ = write!(text, " # {}", notes.join("; "));
        }
        text.push('\n');
    }
    text
}

/// Reads the values of a parameter file in the order of its lines.
///
/// # Errors
/// The first [`Mistake`]: no TOML, not a table of numbers, or a number that is not finite.
pub(super) fn read(text: &str) -> Result<Vec<Entry>, Mistake> {
    type Table = BTreeMap<Spanned<String>, Spanned<Value>>;
    let line = |offset: usize| 1 + text.bytes().take(offset).filter(|byte| *byte == b'\n').count();
    let tables: BTreeMap<String, Table> = toml::from_str(text).map_err(|error| Mistake {
        line: line(error.span().map_or(0, |span| span.start)),
        what: format!("{}; a file has tables like [osmc0] and in them numbers like position_kp = 4.0", error.message()),
    })?;
    let mut entries = Vec::new();
    for (scope, table) in tables {
        for (name, value) in table {
            let line = line(name.span().start);
            let key = format!("{scope}.{}", name.get_ref());
            let number = match value.into_inner() {
                Value::Float(number) => number as f32,
                Value::Integer(number) => number as f32,
                other => {
                    return Err(Mistake { line, what: format!("{key} must be a number, not a {}", other.type_str()) });
                }
            };
            if !number.is_finite() {
                return Err(Mistake { line, what: format!("{key} must be a finite number") });
            }
            entries.push(Entry { line, key, value: number });
        }
    }
    // Tables are read in alphabetical order; users expect that of the file.
    entries.sort_by_key(|entry| entry.line);
    Ok(entries)
}

#[cfg(test)]
mod tests {
    use r4_protocol::ParameterKey;

    use super::*;

    fn info(key: &str, set: f32, built_in: f32) -> ParameterInfo {
        let key: ParameterKey = key.parse().expect("a key");
        ParameterInfo { key, active: built_in, set, built_in }
    }

    #[test]
    fn what_is_written_is_read() {
        let parameters = [
            info("board.link_timeout_ms", 200.0, 200.0),
            info("osmc0.position_kp", 0.1, 4.0),
            info("osmc0.position_max", f32::MAX, f32::MAX),
            info("osmc0.counts_per_turn", 2400.0, 2400.0),
            info("actuator1.position_kp", -1e-9, 0.0),
        ];
        let text = write("Bench.", &parameters);
        assert_eq!(
            text,
            "# Bench.\n\n[board]\nlink_timeout_ms = 200.0 # ms\n\n[osmc0]\nposition_kp = 0.1 # duty/rad; built in: 4.0\n\
             position_max = 3.4028235e38 # rad\ncounts_per_turn = 2400.0\n\n[actuator1]\nposition_kp = -1e-9 # duty/m; built in: 0.0\n"
        );
        let read: Vec<_> = read(&text).expect("it is TOML").into_iter().map(|entry| (entry.key, entry.value)).collect();
        let written: Vec<_> = parameters.iter().map(|info| (info.key.to_string(), info.set)).collect();
        assert_eq!(read, written);
    }

    #[test]
    fn lines_are_told() {
        let entries = read("# x\n\n[b]\nz = 1\n[a]\ny = 2.5\n").expect("it is TOML");
        let entries: Vec<_> = entries.iter().map(|entry| (entry.line, entry.key.as_str(), entry.value)).collect();
        assert_eq!(entries, [(4, "b.z", 1.0), (6, "a.y", 2.5)]);
        for (text, line, says) in [
            ("[osmc0]\nposition_kp = \"4\"\n", 2, "osmc0.position_kp must be a number"),
            ("[osmc0]\n\nposition_kp = nan\n", 3, "finite"),
            ("[osmc0]\nposition_kp = 1e300\n", 2, "finite"),
            ("[osmc0]\nposition_kp = \n", 2, "numbers like"),
            ("[osmc0]\na = 1\na = 2\n", 3, "duplicate key"),
            ("position_kp = 4.0\n", 1, "tables like"),
        ] {
            let mistake = read(text).expect_err("a mistake").to_string();
            assert!(mistake.starts_with(&format!("{line}: ")) && mistake.contains(says), "{text}: {mistake}");
        }
    }
}
