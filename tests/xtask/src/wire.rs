//! Task `cargo xtask protocol`: the wire protocol for readers of other languages than Rust, generated from the types
//! themselves.
//!
//! | module | subject |
//! | --- | --- |
//! | `source` | doc comments, types and constants as they are written in the protocol's source |
//! | `constants` | values of constants |
//! | `model` | the types that travel: their schemas joined with the source |
//! | `codec` | frames and messages read by the rules of the page |
//! | `header` | `protocol/r4.h` |
//! | `json` | `protocol/schema.json` |
//! | `lua` | `protocol/r4.lua`, a dissector for Wireshark |
//! | `page` | `docs/protocol.md` |

mod codec;
mod constants;
mod header;
mod json;
mod lua;
mod model;
mod page;
mod source;

use std::{
    fs,
    path::{Path, PathBuf},
    process::ExitCode,
};

use model::Model;
use r4_protocol::VERSION;
use source::Source;

/// Command that renews the files, as they name it.
const RENEWED_BY: &str = "cargo xtask protocol";

/// Action on the files.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) enum Wire {
    #[default]
    Write,
    /// Compares them with the output of the generators.
    Check,
}

/// Golden frame with its row.
struct Golden {
    direction: String,
    name: String,
    frame: Vec<u8>,
}

/// Sources of the files.
struct Input {
    root: PathBuf,
    source: Source,
    model: Model,
    golden: Vec<Golden>,
}

type Generator = fn(&Input) -> Result<String, String>;

/// Files with their generators.
const FILES: [(&str, Generator); 4] = [
    ("protocol/schema.json", json::file),
    ("protocol/r4.h", header::file),
    ("protocol/r4.lua", lua::file),
    ("docs/protocol.md", page::file),
];

impl Wire {
    /// Reads the words after `protocol`.
    ///
    /// # Errors
    /// The word that is no option.
    pub(crate) fn parse(words: &[&str]) -> Result<Self, String> {
        match words {
            [] => Ok(Self::Write),
            ["--check"] => Ok(Self::Check),
            [.., other] => Err(format!("`protocol` takes no `{other}`")),
        }
    }

    pub(crate) fn run(self, root: &Path) -> ExitCode {
        match self.go(root) {
            Ok(()) => ExitCode::SUCCESS,
            Err(problem) => {
                eprintln!("error: {problem}");
                ExitCode::FAILURE
            }
        }
    }

    /// Writes the files that have changed, or compares them.
    ///
    /// # Errors
    /// The source and the types do not fit each other, a file cannot be written, or one is stale.
    pub(crate) fn go(self, root: &Path) -> Result<(), String> {
        let input = Input::read(root)?;
        let mut stale = Vec::new();
        for (name, generator) in FILES {
            let path = root.join(name);
            let text = generator(&input).map_err(|problem| format!("{name}: {problem}"))?;
            if fs::read_to_string(&path).is_ok_and(|old| old == text) {
                continue;
            }
            if self == Self::Write {
                fs::write(&path, text).map_err(|error| format!("{}: {error}", path.display()))?;
                println!("{name}: written");
            } else {
                stale.push(name);
            }
        }
        if stale.is_empty() {
            return Ok(());
        }
        Err(format!(
            "not what the protocol's types and comments make now: {}. Renew with `{RENEWED_BY}`",
            stale.join(", ")
        ))
    }
}

impl Input {
    fn read(root: &Path) -> Result<Self, String> {
        let source = Source::read(&root.join("protocol/src"))?;
        let model = Model::new(&source)?;
        let path = root.join(format!("protocol/tests/golden/v{VERSION}.txt"));
        let text = fs::read_to_string(&path).map_err(|error| format!("{}: {error}", path.display()))?;
        let golden = golden(&text).map_err(|line| format!("{}: `{line}` is no frame", path.display()))?;
        Ok(Self { root: root.into(), source, model, golden })
    }
}

/// Reads the rows of golden frames.
///
/// # Errors
/// The line that is no row.
fn golden(text: &str) -> Result<Vec<Golden>, &str> {
    let row = |line| {
        let [direction, name, hex] = str::split_whitespace(line).collect::<Vec<_>>()[..] else { return Err(line) };
        let pairs = hex.as_bytes().chunks(2).map(|pair| str::from_utf8(pair).unwrap_or_default());
        let frame = pairs.map(|pair| u8::from_str_radix(pair, 16)).collect::<Result<_, _>>().map_err(|_| line)?;
        Ok(Golden { direction: direction.into(), name: name.into(), frame })
    };
    text.lines().filter(|line| !line.starts_with('#')).map(row).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn golden_rows_are_read_and_others_named() {
        let rows = golden("# a comment\nto-device bye 0105\n").expect("rows");
        assert_eq!((rows.len(), rows[0].name.as_str(), &rows[0].frame[..]), (1, "bye", &[1, 5][..]));
        for bad in ["to-device bye", "to-device bye 01z5", "to-device bye 01 05"] {
            assert!(golden(bad).is_err_and(|line| line == bad), "{bad}");
        }
    }

    #[test]
    fn command_lines_are_understood() {
        assert_eq!(Wire::parse(&[]), Ok(Wire::Write));
        assert_eq!(Wire::parse(&["--check"]), Ok(Wire::Check));
        assert!(Wire::parse(&["--chekc"]).is_err_and(|problem| problem.contains("--chekc")));
    }
}
