//! Question about files: the recordings to fit to, those to hold out, and the roles of their columns.

use std::{collections::BTreeMap, fs, path::PathBuf};

use crate::{
    IdentifyError, ModelInfo,
    data::{self, Holdout, Mapping, Options, Recorded},
    models,
    statics::{hold_out, map::StaticMap, table::task as table},
};

/// Parameter that belongs to an encoder.
const COUNTS: &str = "counts_per_turn";

/// Files, the model that is to explain them, and known parameters.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Question {
    /// Recordings to fit to: CSV with units in its header, or logs.
    pub train: Vec<PathBuf>,
    /// Held-out recordings, or the single entry `every:N`.
    pub holdout: Vec<PathBuf>,
    /// Name of the base model.
    pub model: String,
    /// Pairs of a role of the model and a column of the files.
    pub columns: Vec<(String, String)>,
    /// Name of the time column; `None` to search for one.
    pub time: Option<String>,
    /// Columns whose values separate the runs within a file.
    pub split: Vec<String>,
    /// Known parameters by name. `counts_per_turn` converts encoder counts to angles, unless the model has such a
    /// parameter itself.
    pub parameters: BTreeMap<String, f64>,
}

/// Runs that a question refers to.
#[derive(Clone, Debug, PartialEq)]
pub struct Recordings {
    /// Runs to fit to.
    pub train: Recorded,
    /// Runs that are held out.
    pub holdout: Recorded,
    /// Known parameters of the model.
    pub parameters: BTreeMap<String, f64>,
}

impl Recordings {
    /// Returns the notes of reading (what was set aside, repaired or assumed), each once.
    #[must_use]
    pub fn notes(&self) -> Vec<String> {
        let mut notes: Vec<String> = Vec::new();
        for note in self.train.notes.iter().chain(&self.holdout.notes).map(ToString::to_string) {
            if !notes.contains(&note) {
                notes.push(note);
            }
        }
        notes
    }
}

impl Question {
    /// Returns the model that the question names.
    ///
    /// # Errors
    /// [`IdentifyError::UnknownModel`] if there is no such model.
    pub fn model(&self) -> Result<ModelInfo, IdentifyError> {
        models().into_iter().find(|model| model.name == self.model).ok_or_else(|| {
            let known = models().iter().map(|model| model.name).collect::<Vec<_>>().join(", ");
            IdentifyError::UnknownModel { name: self.model.clone(), known }
        })
    }

    /// Reads the files of the question.
    ///
    /// # Errors
    /// An [`IdentifyError`] for a model or role that does not exist, a file in both parts, or data that cannot be
    /// used.
    pub fn read(&self) -> Result<Recordings, IdentifyError> {
        let model = self.model()?;
        let mut parameters = self.parameters.clone();
        // The parameter belongs to the encoder unless the model declares one of that name.
        let own = model.parameters.iter().any(|parameter| parameter.name == COUNTS);
        let counts_per_turn = if own { parameters.get(COUNTS).copied() } else { parameters.remove(COUNTS) };
        if let Some(value) = counts_per_turn.filter(|counts| *counts <= 0.0) {
            return Err(IdentifyError::OutOfRange { name: COUNTS.to_owned(), value, allowed: "above 0" });
        }
        let options = Options {
            time: self.time.clone(),
            // These models are static, so the order of rows replaces a missing time column.
            untimed: [StaticMap::NAME, table::NAME].contains(&model.name),
            roles: self.roles(&model)?,
            split: self.split.clone(),
            counts_per_turn,
        };
        let (train, holdout) = self.parts(&options)?;
        Ok(Recordings { train, holdout, parameters })
    }

    /// Returns the role of each column, checked against those of the model.
    fn roles(&self, model: &ModelInfo) -> Result<Vec<Mapping>, IdentifyError> {
        let mapping = |(role, column): &(String, String)| match model.roles.iter().find(|known| known.name == role) {
            Some(known) => Ok(Mapping { role: role.clone(), column: column.clone(), driving: known.driving }),
            None => {
                let known = model.roles.iter().map(|known| known.name).collect::<Vec<_>>().join(", ");
                Err(IdentifyError::UnknownRole { model: model.name, role: role.clone(), known })
            }
        };
        self.columns.iter().map(mapping).collect()
    }

    /// Reads the runs to fit to and the held-out runs.
    fn parts(&self, options: &Options) -> Result<(Recorded, Recorded), IdentifyError> {
        match Holdout::parse(&self.holdout)? {
            Holdout::Every(every) => {
                let mut all = data::read(&self.train, options)?;
                // Some models can divide a single recording.
                let parts = all.runs.iter().map(|run| hold_out(&self.model, run, every)).collect::<Option<Vec<_>>>();
                // With several recordings, whole ones are held out.
                let Some(parts) = parts.filter(|parts| parts.len() == 1) else { return Ok(all.alternate(every)?) };
                let (fitted, held_out) = parts.into_iter().unzip();
                all.runs = fitted;
                let rest = Recorded { runs: held_out, groups: all.groups.clone(), notes: vec![] };
                Ok((all, rest))
            }
            Holdout::Files(files) => {
                // One file may be given by two paths.
                let place = |path: &PathBuf| fs::canonicalize(path).unwrap_or_else(|_| path.clone());
                let fitted: Vec<_> = self.train.iter().map(place).collect();
                if let Some(both) = files.iter().find(|file| fitted.contains(&place(file))) {
                    return Err(IdentifyError::InBothParts { path: both.clone() });
                }
                Ok((data::read(&self.train, options)?, data::read(&files, options)?))
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn question() -> Question {
        let column = |role: &str, column: &str| (role.to_owned(), column.to_owned());
        Question {
            train: vec!["a.csv".into()],
            holdout: vec!["b.csv".into()],
            model: "dc-motor".into(),
            columns: vec![column("input", "u"), column("output", "y")],
            ..Question::default()
        }
    }

    #[test]
    fn a_role_the_model_has_not_is_answered_with_those_it_has() {
        let mut question = question();
        question.columns.push(("yaw".into(), "z".into()));
        let said = question.read().expect_err("no such role").to_string();
        assert!(said.starts_with("dc-motor has no role `yaw`: it has ") && said.contains("input"), "{said}");
    }

    #[test]
    fn what_makes_no_sense_is_said_before_any_file_is_read() {
        let unknown = Question { model: "none".into(), ..question() };
        assert!(matches!(unknown.read(), Err(IdentifyError::UnknownModel { .. })));
        let counts = Question { parameters: BTreeMap::from([(COUNTS.to_owned(), 0.0)]), ..question() };
        assert!(matches!(counts.read(), Err(IdentifyError::OutOfRange { value: 0.0, .. })));
        let both = Question { holdout: vec!["a.csv".into()], ..question() };
        assert!(matches!(both.read(), Err(IdentifyError::InBothParts { .. })));
    }
}
