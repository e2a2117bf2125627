//! Reading of files into runs.

use std::{
    collections::BTreeMap,
    ffi::OsStr,
    fs,
    path::{Path, PathBuf},
    str::FromStr,
};

use super::{DataError, Note, Quantity, Run, Signal, clean, log, runs, table};

/// Assignment of a column to a role of a model.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Mapping {
    /// Name of the role, such as `input`.
    pub role: String,
    /// Name of the column in the file.
    pub column: String,
    /// True for an input, which the model needs at every time; false for an output that is compared with the
    /// prediction.
    pub driving: bool,
}

impl Mapping {
    /// Returns the mapping of a column that is an input.
    #[must_use]
    pub fn driving(role: &str, column: &str) -> Self {
        Self { role: role.to_owned(), column: column.to_owned(), driving: true }
    }

    /// Returns the mapping of a column that is compared with the prediction.
    #[must_use]
    pub fn measured(role: &str, column: &str) -> Self {
        Self { role: role.to_owned(), column: column.to_owned(), driving: false }
    }
}

/// Options of reading files.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Options {
    /// Name of the time column; `None` to search for one (`t_s`, `time`, `timestamp_ms` …). A log has its own time.
    pub time: Option<String>,
    /// True if the order of rows may replace a missing time column.
    pub untimed: bool,
    /// Roles and columns: at least one; no role and no column twice.
    pub roles: Vec<Mapping>,
    /// Columns whose values separate the runs within a file; text is allowed.
    pub split: Vec<String>,
    /// Counts per turn, to convert columns in encoder counts to angles.
    pub counts_per_turn: Option<f64>,
}

/// Runs read from files.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Recorded {
    /// Runs in the order of the files and rows.
    pub runs: Vec<Run>,
    /// Group of each run, from 0. Runs with the same number belong together (equal values in [`Options::split`]) and
    /// are held out together.
    pub groups: Vec<usize>,
    /// Notes on what was set aside, repaired or assumed.
    pub notes: Vec<Note>,
}

/// Choice of the held-out runs.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Holdout {
    /// All runs of these files.
    Files(Vec<PathBuf>),
    /// The last of every N groups of runs.
    Every(usize),
}

impl Holdout {
    /// Parses a list of files, or the single entry `every:N`.
    ///
    /// # Errors
    /// [`DataError::Holdout`] for an `every:` without a number of at least 2, or beside files.
    pub fn parse(given: &[PathBuf]) -> Result<Self, DataError> {
        let every = |path: &PathBuf| path.to_str().is_some_and(|text| text.starts_with("every:"));
        match given {
            [one] if every(one) => one.to_string_lossy().parse(),
            many => match many.iter().find(|path| every(path)) {
                Some(mixed) => Err(DataError::Holdout { text: mixed.display().to_string() }),
                None => Ok(Self::Files(many.to_vec())),
            },
        }
    }
}

impl FromStr for Holdout {
    type Err = DataError;

    fn from_str(text: &str) -> Result<Self, DataError> {
        let Some(number) = text.strip_prefix("every:") else { return Ok(Self::Files(vec![text.into()])) };
        match number.parse() {
            Ok(every) if every >= 2 => Ok(Self::Every(every)),
            _ => Err(DataError::Holdout { text: text.to_owned() }),
        }
    }
}

impl Recorded {
    /// Divides the runs: the last of every `every` groups is held out. The notes stay with the first part.
    ///
    /// # Errors
    /// [`DataError::OneRun`] if one of the parts would be empty, [`DataError::Holdout`] if `every` is below 2.
    pub fn alternate(self, every: usize) -> Result<(Self, Self), DataError> {
        if every < 2 {
            return Err(DataError::Holdout { text: format!("every:{every}") });
        }
        // Groups, not runs, are held out: runs of one group may be too similar for a test.
        let found = self.groups.iter().max().map_or(0, |last| last + 1);
        if found < every {
            return Err(DataError::OneRun { found, every });
        }
        let (mut train, mut holdout) = (Self { notes: self.notes, ..Self::default() }, Self::default());
        for (run, group) in self.runs.into_iter().zip(self.groups) {
            let part = if group % every == every - 1 { &mut holdout } else { &mut train };
            part.runs.push(run);
            part.groups.push(group);
        }
        Ok((train, holdout))
    }
}

/// One file as columns of numbers, one row per sample.
#[derive(Debug, Default)]
pub(super) struct Raw {
    /// Name of the time column, and whether the name has a unit; `None` if rows are numbered.
    pub(super) time: Option<(String, bool)>,
    /// Time of each row, s; NaN if the file has none.
    pub(super) time_s: Vec<f64>,
    /// True if the times are those of a board's clock.
    pub(super) by_board: bool,
    /// Columns in the order of the roles: name, quantity, and one SI value per row.
    pub(super) columns: Vec<(String, Quantity, Vec<f64>)>,
    /// Values of the split columns in each row; empty without such columns.
    pub(super) keys: Vec<String>,
    /// Line of each row in the file, from 1.
    pub(super) lines: Vec<u64>,
}

/// Reads `files`, in this order.
///
/// # Errors
/// A [`DataError`] that names the file, and the line and column if there is one.
pub fn read(files: &[PathBuf], options: &Options) -> Result<Recorded, DataError> {
    if files.is_empty() {
        return Err(DataError::NoFile);
    }
    let name = |path: &Path| path.file_name().map(OsStr::to_owned);
    let mut all = Recorded::default();
    for path in files {
        let bytes = fs::read(path).map_err(|why| DataError::Io { path: path.clone(), why })?;
        // Messages show only the file's name, unless several files have the same.
        let alone = files.iter().filter(|other| name(other) == name(path)).count() == 1;
        let label = match name(path) {
            Some(name) if alone => name.to_string_lossy().into_owned(),
            _ => path.display().to_string(),
        };
        let one = read_bytes(&label, &bytes, options)?;
        let first = all.groups.iter().max().map_or(0, |last| last + 1);
        all.runs.extend(one.runs);
        all.groups.extend(one.groups.iter().map(|group| first + group));
        all.notes.extend(one.notes);
    }
    Ok(all)
}

/// Reads a file from memory; `file` is its name in messages.
///
/// # Errors
/// Errors of [`read`], except [`DataError::Io`].
pub fn read_bytes(file: &str, bytes: &[u8], options: &Options) -> Result<Recorded, DataError> {
    for (index, mapping) in options.roles.iter().enumerate() {
        for before in &options.roles[..index] {
            if before.role == mapping.role {
                return Err(DataError::RoleTwice { role: mapping.role.clone() });
            }
            if before.column == mapping.column {
                return Err(DataError::ColumnTwice {
                    column: mapping.column.clone(),
                    first: before.role.clone(),
                    second: mapping.role.clone(),
                });
            }
        }
    }
    if bytes.is_empty() {
        return Err(DataError::Empty { file: file.to_owned() });
    }
    let mut notes = Vec::new();
    let raw = if log::is_log(file, bytes) {
        log::read(file, bytes, options, &mut notes)?
    } else {
        table::read(file, bytes, options, &mut notes)?
    };
    for (column, _, values) in &raw.columns {
        if values.iter().all(|value| value.is_nan()) {
            return Err(DataError::AllMissing { file: file.to_owned(), column: column.clone() });
        }
    }
    let mut pieces = runs::split(file, &raw, &mut notes)?;
    clean::clean(file, &raw, &options.roles, &mut pieces, &mut notes);
    let mut recorded = Recorded { notes, ..Recorded::default() };
    for piece in pieces {
        let signals = options.roles.iter().zip(&raw.columns).zip(piece.values).map(
            |((mapping, (column, quantity, _)), values)| {
                (mapping.role.clone(), Signal { column: column.clone(), quantity: *quantity, values })
            },
        );
        recorded.runs.push(Run {
            name: piece.name,
            time_s: piece.time_s,
            origin_s: piece.origin_s,
            signals: signals.collect::<BTreeMap<_, _>>(),
        });
        recorded.groups.push(piece.group);
    }
    Ok(recorded)
}
