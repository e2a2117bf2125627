//! Log of a session: commands with their times, mistakes and answers, and its export as CSV.

use std::fmt::Write;

use super::{
    cue::{Command, Modality, Zone},
    sus::{self, Answers, BadAnswer, STATEMENTS},
};
use crate::participants::csv_field;

/// Header of the table of trials; a trial's answers are empty until the experimenter fills them in.
const TRIALS_HEADER: &str = "participant,place,modality,time_s,mistakes,timeouts,status,q1,q2,q3,q4,q5,q6,q7,q8,q9,q10";

/// Log of one person's session.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SessionLog {
    /// Code of the participant, never a name.
    pub participant: String,
    /// Trials in their order.
    pub trials: Vec<TrialLog>,
}

/// Log of one trial.
#[derive(Clone, Debug, PartialEq)]
pub struct TrialLog {
    /// Modality of all cues of the trial.
    pub modality: Modality,
    /// Place of the trial in the session, from 1 on.
    pub place: usize,
    /// Commands in their order.
    pub commands: Vec<CommandLog>,
    /// True once all commands are done; false for a trial that a stop of the board ended, which does not count.
    pub is_complete: bool,
    /// Answers to the usability scale after the trial; `None` until they are given.
    pub answers: Option<Answers>,
}

/// Log of one command. Times are of the board's clock, s.
#[derive(Clone, Debug, PartialEq)]
pub struct CommandLog {
    /// Instruction that the cue gave.
    pub command: Command,
    /// Start of each presentation of the cue.
    pub cued_s: Vec<f64>,
    /// Dwells in other zones, which are the mistakes.
    pub mistakes: Vec<(Zone, f64)>,
    /// End of the dwell in the right zone; `None` after a time-out or a stop.
    pub reached_s: Option<f64>,
    /// Time of the time-out; `None` for a command that was reached or stopped.
    pub timed_out_s: Option<f64>,
}

/// One row of the table of trials, as an analysis needs it.
#[derive(Clone, Debug, PartialEq)]
pub struct TrialRow {
    /// Code of the participant.
    pub participant: String,
    /// Place of the trial in the session, from 1 on.
    pub place: usize,
    /// Modality of the trial.
    pub modality: Modality,
    /// Time from the first cue to the last dwell, s.
    pub time_s: f64,
    /// Number of dwells in wrong zones.
    pub mistakes: f64,
    /// Score of the usability scale, 0 to 100; `None` without answers.
    pub sus: Option<f64>,
}

/// Line of a table that cannot be read.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BadTable {
    /// The first line is not that of a table of trials.
    #[error("the first line is not `{TRIALS_HEADER}`: give a trials.csv as the program writes it")]
    Header,
    /// A line has another number of fields, or a field of another kind.
    #[error("line {line}: {field} cannot be read: `{text}`")]
    Field {
        /// Number of the line, from 1 on.
        line: usize,
        /// Name of the field's column.
        field: &'static str,
        /// Text of the field, or of the line if it has too few.
        text: String,
    },
    /// An answer is not on the scale.
    #[error("line {line}: {source}")]
    Answer {
        /// Number of the line, from 1 on.
        line: usize,
        /// Statement and answer.
        source: BadAnswer,
    },
}

impl TrialLog {
    /// Time from the first cue to the end of the last command, s; `None` for a trial that is not complete. A command that
    /// timed out counts with its whole time.
    #[must_use]
    pub fn time_s(&self) -> Option<f64> {
        let from_s = self.commands.first()?.cued_s.first()?;
        let last = self.commands.last()?;
        let to_s = last.reached_s.or(last.timed_out_s)?;
        self.is_complete.then_some(to_s - from_s)
    }

    /// Number of dwells in wrong zones.
    #[must_use]
    pub fn mistakes(&self) -> usize {
        self.commands.iter().map(|command| command.mistakes.len()).sum()
    }

    /// Number of commands that timed out.
    #[must_use]
    pub fn timeouts(&self) -> usize {
        self.commands.iter().filter(|command| command.timed_out_s.is_some()).count()
    }
}

impl SessionLog {
    /// Formats all events as CSV with a header (RFC 4180): cues, wrong and right dwells, time-outs.
    #[must_use]
    pub fn events_csv(&self) -> String {
        let mut text = String::from("participant,place,modality,number,action,zone,event,event_zone,at_s\r\n");
        for trial in &self.trials {
            for (number, log) in trial.commands.iter().enumerate() {
                let action = if log.command.is_pick { "pick" } else { "put" };
                let mut events: Vec<(f64, &str, Zone)> =
                    log.cued_s.iter().map(|at_s| (*at_s, "cue", log.command.zone)).collect();
                events.extend(log.mistakes.iter().map(|(zone, at_s)| (*at_s, "wrong", *zone)));
                events.extend(log.reached_s.map(|at_s| (at_s, "dwell", log.command.zone)));
                events.extend(log.timed_out_s.map(|at_s| (at_s, "timeout", log.command.zone)));
                events.sort_by(|a, b| a.0.total_cmp(&b.0));
                for (at_s, event, zone) in events {
                    // Writing to a String cannot fail.
                    let _ = write!(
                        text,
                        "{},{},{},{},{action},{},{event},{},{at_s:.6}\r\n",
                        csv_field(&self.participant),
                        trial.place,
                        trial.modality.name(),
                        number + 1,
                        log.command.zone.name(),
                        zone.name()
                    );
                }
            }
        }
        text
    }

    /// Formats one row for each trial as CSV with a header. The columns of missing answers are empty, for the
    /// experimenter to fill in.
    #[must_use]
    pub fn trials_csv(&self) -> String {
        let mut text = format!("{TRIALS_HEADER}\r\n");
        for trial in &self.trials {
            let time_s = trial.time_s().map_or(String::new(), |time_s| format!("{time_s:.6}"));
            let status = if trial.is_complete { "complete" } else { "stopped" };
            let answers: String = match &trial.answers {
                Some(answers) => answers.iter().map(|answer| format!(",{answer}")).collect(),
                None => ",".repeat(STATEMENTS),
            };
            let _ = write!(
                text,
                "{},{},{},{time_s},{},{},{status}{answers}\r\n",
                csv_field(&self.participant),
                trial.place,
                trial.modality.name(),
                trial.mistakes(),
                trial.timeouts(),
            );
        }
        text
    }
}

/// Reads the complete trials of a table as [`SessionLog::trials_csv`] writes it, with answers filled in or not. Codes of
/// participants have no commas or quotes. Trials that were stopped are left out.
///
/// # Errors
/// [`BadTable`] with the first line that cannot be read.
pub fn read_trials(text: &str) -> Result<Vec<TrialRow>, BadTable> {
    let mut lines = text.lines().map(str::trim_end).enumerate();
    // A spreadsheet may put a byte order mark before the header.
    if lines.next().map(|(_, line)| line.trim_start_matches('\u{feff}')) != Some(TRIALS_HEADER) {
        return Err(BadTable::Header);
    }
    let mut rows = Vec::new();
    for (place, line) in lines.filter(|(_, line)| !line.is_empty()) {
        rows.extend(row(place + 1, line)?);
    }
    Ok(rows)
}

/// Reads one line; `None` for a trial that was stopped.
fn row(line: usize, text: &str) -> Result<Option<TrialRow>, BadTable> {
    let bad = |field: &'static str, text: &str| BadTable::Field { line, field, text: text.to_owned() };
    let fields: Vec<&str> = text.split(',').map(str::trim).collect();
    let Some((&[participant, order, modality, time, mistakes, _, status], answers)) = fields.split_first_chunk::<7>()
    else {
        return Err(bad("line", text));
    };
    if status != "complete" {
        return Ok(None);
    }
    let modality =
        Modality::ALL.into_iter().find(|known| known.name() == modality).ok_or_else(|| bad("modality", modality))?;
    let number = |field: &'static str, text: &str| {
        text.parse::<f64>().ok().filter(|number| number.is_finite() && *number >= 0.0).ok_or_else(|| bad(field, text))
    };
    let answers: &[&str; STATEMENTS] = answers.try_into().map_err(|_| bad("line", text))?;
    let sus = if answers.iter().all(|answer| answer.is_empty()) {
        None
    } else {
        let mut sheet = [0; STATEMENTS];
        for (answer, text) in sheet.iter_mut().zip(answers) {
            *answer = text.parse().map_err(|_| bad("an answer", text))?;
        }
        Some(sus::score(&sheet).map_err(|source| BadTable::Answer { line, source })?)
    };
    Ok(Some(TrialRow {
        participant: participant.to_owned(),
        place: order.parse().ok().filter(|place| (1..=3).contains(place)).ok_or_else(|| bad("place", order))?,
        modality,
        time_s: number("time_s", time)?,
        mistakes: number("mistakes", mistakes)?,
        sus,
    }))
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn log() -> SessionLog {
        let command = |number: usize, reached_s| CommandLog {
            command: Command { is_pick: number.is_multiple_of(2), zone: Zone::ALL[number % 3] },
            cued_s: vec![number as f64 + 0.25],
            mistakes: if number == 1 { vec![(Zone::Discard, 1.75)] } else { Vec::new() },
            reached_s,
            timed_out_s: reached_s.is_none().then_some(17.5),
        };
        let trial = |place: usize, is_complete, answers| TrialLog {
            modality: Modality::ALL[place - 1],
            place,
            commands: vec![command(0, Some(1.0)), command(1, Some(2.5)), command(2, None)],
            is_complete,
            answers,
        };
        let trials = vec![trial(1, true, Some([4; STATEMENTS])), trial(2, true, None), trial(3, false, None)];
        SessionLog { participant: "P007".into(), trials }
    }

    #[test]
    fn a_table_is_read_as_it_was_written() {
        let rows = read_trials(&log().trials_csv()).expect("our own table");
        let row = |place: usize, sus| TrialRow {
            participant: "P007".into(),
            place,
            modality: Modality::ALL[place - 1],
            time_s: 17.25,
            mistakes: 1.0,
            sus,
        };
        // The stopped trial is not there.
        assert_eq!(rows, [row(1, Some(50.0)), row(2, None)]);
        let events = log().events_csv();
        assert!(events.contains("P007,1,visual,2,put,centre,wrong,discard,1.750000\r\n"), "{events}");
        // Three cues, one mistake, two dwells and a time-out in each of three trials, and the header.
        assert_eq!(events.lines().count(), 1 + 3 * 7);
    }

    #[test]
    fn a_bad_table_says_where() {
        let text = log().trials_csv();
        for (from, to, told) in [
            ("participant,place", "code,place", "the first line is not"),
            (",visual,", ",olfactory,", "line 2: modality cannot be read: `olfactory`"),
            (",17.250000,", ",-1,", "line 2: time_s cannot be read: `-1`"),
            (",4,4,4\r", ",4,4,9\r", "line 2: answer 9 to statement 10 is not in 1 to 5"),
            (",4,4,4\r", ",4,4,\r", "line 2: an answer cannot be read"),
            (",4,4,4\r", ",4,4\r", "line 2: line cannot be read"),
            ("P007,1,", "P007,4,", "line 2: place cannot be read"),
        ] {
            assert!(text.contains(from), "{from}");
            let error = read_trials(&text.replacen(from, to, 1)).expect_err(to).to_string();
            assert!(error.starts_with(told), "{error}");
        }
    }

    proptest! {
        #[test]
        fn arbitrary_text_is_read_or_refused(text in "[ -~\r\n,]{0,200}") {
            let _ = read_trials(&format!("{TRIALS_HEADER}\n{text}"));
        }
    }
}
