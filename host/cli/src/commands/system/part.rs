//! Parts of `r4 bench systems`: one system's rows in a file of `--out`, so that a later run need not repeat them. While a system runs,
//! a second file has the records of its trials.

use std::{
    fs::{self, File},
    io::Write,
    path::{Path, PathBuf},
    sync::{Mutex, PoisonError},
};

use anyhow::Context;
use r4_systems::{Row, study::Record};
use serde::{Deserialize, Serialize};
use sha2::{Digest, Sha256};

/// Program and settings that the rows of a part depend on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Made {
    /// SHA-256 of the program's file: a version number is the same before and after a change.
    pub(super) program: String,
    pub(super) board: String,
    pub(super) first_seed: u64,
    pub(super) seeds: u64,
    pub(super) is_quick: bool,
}

/// Rows of one system's study, and of its timings.
#[derive(Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Found {
    pub(super) rows: Vec<Row>,
    pub(super) timings: Vec<Row>,
}

#[derive(Serialize, Deserialize)]
struct Part {
    made: Made,
    found: Found,
}

/// SHA-256 of this program's file, in hexadecimal.
pub(super) fn program() -> anyhow::Result<String> {
    let path = std::env::current_exe().context("cannot find this program's file")?;
    let bytes = fs::read(&path).with_context(|| format!("cannot read {}", path.display()))?;
    Ok(Sha256::digest(&bytes).iter().map(|byte| format!("{byte:02x}")).collect())
}

/// Records of a system's trials so far, in a file that grows while the system runs: `made` on the first line, a record on each other.
pub(super) struct Trials {
    path: PathBuf,
    file: Mutex<File>,
    /// Records of an interrupted run.
    pub(super) done: Vec<Record>,
}

impl Trials {
    /// Begins the file, with the records that it already has if it was made as `made` says.
    fn begin(folder: &Path, system: &str, made: &Made) -> anyhow::Result<Self> {
        let path = folder.join(format!("{system}.trials.jsonl"));
        let before = fs::read_to_string(&path).unwrap_or_default();
        let mut lines = before.lines();
        let is_same =
            lines.next().and_then(|line| serde_json::from_str::<Made>(line).ok()).is_some_and(|of| of == *made);
        // The last line may be half a record.
        let records = lines.map_while(|line| serde_json::from_str(line).ok());
        // What could not be run is run again.
        let done: Vec<Record> =
            if is_same { records.filter(|record: &Record| record.failed.is_none()).collect() } else { Vec::new() };
        if !done.is_empty() {
            eprintln!(
                "r4: {}: {} trials of this program with these settings, not run again",
                path.display(),
                done.len()
            );
        }
        let mut file = tempfile::NamedTempFile::new_in(folder)?;
        file.write_all(&line(made)?)?;
        for record in &done {
            file.write_all(&line(record)?)?;
        }
        Ok(Self { file: Mutex::new(file.persist(&path)?), path, done })
    }

    /// Adds the record of a trial. A file that cannot be written costs the trial only if the run is interrupted.
    pub(super) fn add(&self, record: &Record) {
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        if let Err(error) = line(record).and_then(|line| Ok(file.write_all(&line)?)) {
            eprintln!("r4: a trial cannot be kept in {}: {error}", self.path.display());
        }
    }
}

fn line(value: &impl Serialize) -> anyhow::Result<Vec<u8>> {
    let mut line = serde_json::to_vec(value)?;
    line.push(b'\n');
    Ok(line)
}

/// Returns what `folder` has of a system if it was made as `made` says; runs the system and keeps what it found otherwise.
pub(super) fn kept(
    folder: &Path,
    system: &str,
    made: Made,
    run: impl FnOnce(&Trials) -> anyhow::Result<Found>,
) -> anyhow::Result<Found> {
    let path = folder.join(format!("{system}.json"));
    if path.exists() {
        let part = read(&path)?;
        if part.made == made {
            eprintln!("r4: {}: rows of this program with these settings, not run again", path.display());
            return Ok(part.found);
        }
        eprintln!("r4: {}: of another program or other settings, run again", path.display());
    }
    let trials =
        Trials::begin(folder, system, &made).with_context(|| format!("cannot write into {}", folder.display()))?;
    let part = Part { made, found: run(&trials)? };
    write(&path, folder, &part).with_context(|| format!("cannot write {}", path.display()))?;
    fs::remove_file(&trials.path).with_context(|| format!("cannot remove {}", trials.path.display()))?;
    Ok(part.found)
}

fn read(path: &Path) -> anyhow::Result<Part> {
    let text = fs::read_to_string(path).with_context(|| format!("cannot read {}", path.display()))?;
    serde_json::from_str(&text).with_context(|| {
        format!("{} is no part of `r4 bench systems`: remove it, or name another folder", path.display())
    })
}

/// Writes a part under a temporary name first: an interrupted run leaves no half of one.
fn write(path: &Path, folder: &Path, part: &Part) -> anyhow::Result<()> {
    let mut file = tempfile::NamedTempFile::new_in(folder)?;
    serde_json::to_writer(&mut file, part)?;
    file.flush()?;
    file.persist(path)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_part_is_run_once_for_each_program_and_settings() {
        let folder = tempfile::tempdir().expect("a folder");
        let made = Made { program: "00".into(), board: "sim:x".into(), first_seed: 1001, seeds: 2, is_quick: false };
        let row = serde_json::json!({
            "system": "s", "arm": "ours", "metric": "m", "unit": "1", "n": 2, "failed": 0, "value": 0.5, "lo": 0.25, "hi": 0.75,
            "method": "mean", "source": "simulated", "board": "sim", "seeds": [1001, 1002], "target": {"at_least": 0.9}, "met": false,
        });
        let row: Row = serde_json::from_value(row).expect("a row");
        let found = || Found { rows: vec![row.clone()], timings: Vec::new() };
        let first = kept(folder.path(), "s", made.clone(), |_| Ok(found())).expect("a run");
        assert_eq!(first, found());
        let again = kept(folder.path(), "s", made.clone(), |_| panic!("run again")).expect("a part");
        assert_eq!(again, found());
        let others = [
            Made { program: "01".into(), ..made.clone() },
            Made { board: "emu:x".into(), ..made.clone() },
            Made { seeds: 3, ..made.clone() },
        ];
        for other in others {
            let mut runs = 0;
            let run = |_: &Trials| {
                runs += 1;
                Ok(found())
            };
            kept(folder.path(), "s", other, run).expect("a run");
            assert_eq!(runs, 1);
        }
        // A run that fails leaves the part before it.
        assert!(kept(folder.path(), "s", made.clone(), |_| anyhow::bail!("no board")).is_err());
        kept(folder.path(), "s", Made { seeds: 3, ..made.clone() }, |_| panic!("run again")).expect("a part");
        fs::write(folder.path().join("s.json"), "{").expect("a file");
        let damaged = kept(folder.path(), "s", made, |_| Ok(found())).expect_err("half a file").to_string();
        assert!(damaged.contains("s.json") && damaged.contains("remove it"), "{damaged}");
    }

    #[test]
    fn an_interrupted_run_keeps_its_trials() {
        let folder = tempfile::tempdir().expect("a folder");
        let made = Made { program: "00".into(), board: "sim:x".into(), first_seed: 1, seeds: 3, is_quick: false };
        let record = |seed| Record {
            system: "s".into(),
            arm: "ours".into(),
            board: "sim".into(),
            seed,
            values: [("m".to_owned(), 0.5)].into(),
            failed: None,
        };
        let interrupted = kept(folder.path(), "s", made.clone(), |trials| {
            [1, 2].map(record).iter().for_each(|record| trials.add(record));
            anyhow::bail!("interrupted")
        });
        assert!(interrupted.is_err());
        // As if killed in the middle of a line.
        let path = folder.path().join("s.trials.jsonl");
        let text = fs::read_to_string(&path).expect("a file");
        fs::write(&path, &text[..text.len() - 9]).expect("a file");
        let other = Made { program: "01".into(), ..made.clone() };
        for (made, done) in [(made.clone(), vec![record(1)]), (other, Vec::new()), (made, Vec::new())] {
            let stopped = kept(folder.path(), "s", made, |trials| {
                assert_eq!(trials.done, done);
                anyhow::bail!("interrupted")
            });
            assert!(stopped.is_err());
        }
    }
}
