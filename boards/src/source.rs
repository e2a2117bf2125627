//! Text of a TOML file, with the line of each field and the field at each line.

use std::{
    borrow::Cow,
    collections::HashMap,
    fmt::Display,
    io,
    ops::Range,
    path::{Path, PathBuf},
};

use serde::de::DeserializeOwned;
use toml::{
    Spanned,
    de::{DeTable, DeValue},
};

use crate::{
    error::{BoardError, Location},
    tree::{Fault, Node},
};

/// Makes the list of the files that are part of the program (path below `boards/`, text), and the lists of their names that users type.
macro_rules! built_in {
    (
        $($names:ident: $folder:literal [$($name:literal),+ $(,)?];)+
        + plants: [$($plant:literal),+ $(,)?];
    ) => {
        $(pub(crate) const $names: [&str; [$($name),+].len()] = [$($name),+];)+

        const BUILT_IN: &[(&str, &str)] = &[
            $($((concat!($folder, $name, ".toml"), include_str!(concat!("../", $folder, $name, ".toml"))),)+)+
            $((concat!("plants/", $plant, ".toml"), include_str!(concat!("../plants/", $plant, ".toml"))),)+
        ];
    };
}

built_in! {
    CARRIERS: "" ["r4-carrier"];
    ROBOTS: "" [
        "osmc-bench",
        "osmc-evaluation",
        "openscout",
        "openpodcar",
        "openagribot",
        "balance-tail",
        "every-interface",
        "two-finger-gripper",
        "cable-loop",
        "berry-picker",
        "suction-pad",
        "gas-scout",
        "field-rover",
        "deformobot",
        "cue-desk",
    ];
    WORLDS: "worlds/" [
        "square",
        "stand",
        "factory",
        "open-field",
        "gate",
    ];
    + plants: [
        "osmc-bench-rotary",
        "osmc-bench-actuator",
        "osmc-evaluation-small",
        "openscout-wheel",
        "openpodcar-drive",
        "openagribot-wheel",
        "openagribot-implement",
        "cable-loop-spool",
        "vibration-motor",
    ];
}

/// Folder in which the files that a file names are looked up.
pub(crate) enum Folder {
    /// Only the built-in files.
    BuiltIn,
    /// A folder of the file system, and the built-in files for those that it does not have.
    At(PathBuf),
}

impl Folder {
    /// Reads `path`, relative to this folder.
    ///
    /// # Errors
    /// The path looked for, and the error of reading it.
    pub(crate) fn read(&self, path: &str) -> Result<Source, (String, io::Error)> {
        let outside = match self {
            Self::BuiltIn => Err((path.to_owned(), io::ErrorKind::NotFound.into())),
            Self::At(folder) => Source::read(&folder.join(path)),
        };
        match outside {
            Err((_, why)) if why.kind() == io::ErrorKind::NotFound => Source::built_in(path).ok_or_else(|| {
                let looked_for = match self {
                    Self::BuiltIn => path.to_owned(),
                    Self::At(folder) => folder.join(path).display().to_string(),
                };
                (looked_for, why)
            }),
            read => read,
        }
    }
}

/// Tables of an array, not deserialised yet.
pub(crate) type Tables<'s> = Vec<Spanned<DeValue<'s>>>;

/// One TOML file with its text.
pub(crate) struct Source {
    /// Name of the file as a person sees it.
    pub(crate) name: String,
    pub(crate) text: Cow<'static, str>,
}

impl Source {
    pub(crate) fn built_in(path: &str) -> Option<Self> {
        let (path, text) = BUILT_IN.iter().find(|(known, _)| *known == path)?;
        Some(Self { name: format!("boards/{path}"), text: Cow::Borrowed(text) })
    }

    pub(crate) fn read(path: &Path) -> Result<Self, (String, io::Error)> {
        let name = path.display().to_string();
        match std::fs::read_to_string(path) {
            Ok(text) => Ok(Self { name, text: Cow::Owned(text) }),
            Err(why) => Err((name, why)),
        }
    }

    /// Deserialises the file as a `T`. The error names the line and the field.
    pub(crate) fn parse<T: DeserializeOwned>(&self) -> Result<T, BoardError> {
        self.parse_without([]).map(|(parsed, [])| parsed)
    }

    /// Deserialises the file as a `T` without some arrays of tables, which are returned beside it.
    pub(crate) fn parse_without<T: DeserializeOwned, const N: usize>(
        &self,
        arrays: [&'static str; N],
    ) -> Result<(T, [Tables<'_>; N]), BoardError> {
        let mut root = DeTable::parse(&self.text).map_err(|error| self.malformed(error))?;
        // Removed before deserialising, or `deny_unknown_fields` of `T` would refuse them.
        let taken = arrays.map(|array| root.get_mut().remove(array));
        let parsed = T::deserialize(Node::from(root)).map_err(|fault| self.malformed(fault))?;
        let mut tables = [const { Vec::new() }; N];
        for ((tables, taken), name) in tables.iter_mut().zip(taken).zip(arrays) {
            let Some(taken) = taken else { continue };
            let array = taken.get_ref().as_array().ok_or_else(|| BoardError::Malformed {
                at: self.location(taken.span().start),
                problem: format!("must be an array of tables: write [[{name}]]"),
            })?;
            tables.extend_from_slice(array);
        }
        Ok((parsed, tables))
    }

    pub(crate) fn malformed(&self, fault: impl Into<Fault>) -> BoardError {
        let Fault { message, span } = fault.into();
        let at = match span {
            Some(span) => self.location(span.start),
            // Errors without a span are about the file as a whole.
            None => Location { file: self.name.clone(), line: 1, field: String::new() },
        };
        BoardError::Malformed { at, problem: message.replace('\n', ", ") }
    }

    /// Makes the error of a field `path` that breaks a rule.
    pub(crate) fn rule(&self, path: impl Display, problem: impl Display) -> BoardError {
        BoardError::Malformed { at: self.at(path), problem: problem.to_string() }
    }

    /// Returns the place of the field `path`, written as in `osmc[0].encoder.input`; that of the nearest table around
    /// it if it is left out.
    pub(crate) fn at(&self, path: impl Display) -> Location {
        let field = path.to_string();
        let (root, _) = DeTable::parse_recoverable(&self.text);
        let mut found = 0;
        let mut table = Some(root.get_ref());
        let mut element: Option<&Spanned<DeValue<'_>>> = None;
        for step in field.split(['.', '[']) {
            let next = match step.strip_suffix(']') {
                Some(index) => element
                    .and_then(|value| value.get_ref().as_array())
                    .and_then(|array| index.parse::<usize>().ok().and_then(|index| array.get(index))),
                None => table.and_then(|table| table.iter().find(|(key, _)| key.get_ref() == step)).map(|(_, v)| v),
            };
            // A field that is left out has no line: the nearest table around it was the step before.
            let Some(next) = next else { break };
            found = next.span().start;
            table = next.get_ref().as_table();
            element = Some(next);
        }
        Location { file: self.name.clone(), line: self.line(found), field }
    }

    /// Returns the line and the field at a byte offset.
    fn location(&self, offset: usize) -> Location {
        let (root, _) = DeTable::parse_recoverable(&self.text);
        let field = field_in_table(root.get_ref(), offset).unwrap_or_else(|| self.key_in_line(offset));
        Location { file: self.name.clone(), line: self.line(offset), field }
    }

    fn line(&self, offset: usize) -> usize {
        // Bytes and not characters, because spans are byte offsets.
        let before = self.text.as_bytes().iter().take(offset);
        1 + before.filter(|byte| **byte == b'\n').count()
    }

    /// Returns the text left of the `=`, for a line that is no TOML.
    fn key_in_line(&self, offset: usize) -> String {
        let line = self.text.lines().nth(self.line(offset) - 1).unwrap_or_default();
        line.split_once('=').map(|(key, _)| key.trim().to_owned()).unwrap_or_default()
    }
}

fn covers(span: &Range<usize>, offset: usize) -> bool {
    span.contains(&offset) || span.start == offset
}

fn field_in_table(table: &DeTable<'_>, offset: usize) -> Option<String> {
    table.iter().find_map(|(key, value)| {
        let key_text = key.get_ref();
        match field_in_value(value, offset) {
            Some(inner) if inner.is_empty() || inner.starts_with('[') => Some(format!("{key_text}{inner}")),
            Some(inner) => Some(format!("{key_text}.{inner}")),
            None => covers(&key.span(), offset).then(|| key_text.to_string()),
        }
    })
}

/// Returns the path inside `value` to the offset; empty for the value itself.
///
/// The span of a table with a header covers only the header, so the fields inside are searched first.
fn field_in_value(value: &Spanned<DeValue<'_>>, offset: usize) -> Option<String> {
    let inside = match value.get_ref() {
        DeValue::Table(table) => field_in_table(table, offset),
        DeValue::Array(array) => array.iter().enumerate().find_map(|(index, element)| {
            let inner = field_in_value(element, offset)?;
            let dot = if inner.is_empty() || inner.starts_with('[') { "" } else { "." };
            Some(format!("[{index}]{dot}{inner}"))
        }),
        _ => None,
    };
    // The innermost field that covers the offset wins.
    inside.or_else(|| covers(&value.span(), offset).then(String::new))
}

/// Record of things of which each may be used once in a file.
pub(crate) struct Claims<'s> {
    source: &'s Source,
    taken: HashMap<(&'static str, String), String>,
}

impl<'s> Claims<'s> {
    pub(crate) fn new(source: &'s Source) -> Self {
        Self { source, taken: HashMap::new() }
    }

    /// Takes `name` for the field at `path`.
    ///
    /// # Errors
    /// [`BoardError::UsedTwice`], with the line of the first use.
    pub(crate) fn take(
        &mut self,
        what: &'static str,
        name: impl Display,
        path: impl Display,
    ) -> Result<(), BoardError> {
        let name = name.to_string();
        let path = path.to_string();
        // The later use is reported, with the line of the first.
        match self.taken.insert((what, name.clone()), path.clone()) {
            None => Ok(()),
            Some(first) => {
                let first_line = self.source.at(first).line;
                Err(BoardError::UsedTwice { at: self.source.at(path), what, name, first_line })
            }
        }
    }
}
