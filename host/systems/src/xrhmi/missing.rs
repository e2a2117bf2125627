//! Search for an effect in the command times of a study: order of the trials, practice within them, or miscounted buzzes.
//!
//! The participant is the unit: each gives one number for each effect, so that a person's own habits do not count as many
//! observations.
//!
//! | effect | number of a participant | size |
//! | --- | --- | --- |
//! | `order` | mean time of a command by trial; persons, modalities and place regressed together | s per place |
//! | `practice` | slope of the time over the commands of a trial, mean of three trials | s per command |
//! | `miscount` | haptic cues with both bands against those with one, minus the same of the other modalities | s per cue |

use nalgebra::DMatrix;
use r4_maths::{
    least_squares::linear,
    statistics::{Alternative, Interval, holm, mean, mean_interval, paired_t},
};

use super::synthetic::PersonTimes;
use crate::participants::ParticipantsError;

/// Level at which an effect is claimed, after Holm's correction for three candidates: of a hundred clean studies, one
/// claims something.
const LEVEL: f64 = 0.01;

/// Names of the candidates.
pub const NAMES: [&str; 3] = ["order", "practice", "miscount"];

/// An effect that the times show.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Found {
    /// Name of the effect, of [`NAMES`].
    pub name: &'static str,
    /// Size of the effect, in the unit of the table.
    pub size_s: f64,
    /// 95 % confidence interval of the size.
    pub interval: Interval,
    /// p-value, corrected for the candidates.
    pub p_value: f64,
}

/// Searches for the effect that a study's times show; `None` where they show none.
///
/// # Errors
/// The error of a fit or a statistic, such as for fewer than two people.
pub fn found(people: &[PersonTimes]) -> Result<Option<Found>, ParticipantsError> {
    let practice: Vec<f64> = people.iter().map(slope).collect::<Result<_, _>>()?;
    let miscount: Vec<f64> = people.iter().map(contrast).collect::<Result<_, _>>()?;
    let candidates = [by_order(people)?, of_mean(&practice)?, of_mean(&miscount)?];
    let corrected = holm(&candidates.map(|(_, _, p)| p))?;
    let best = (0..NAMES.len()).min_by(|a, b| corrected[*a].total_cmp(&corrected[*b]));
    let claimed = best.filter(|best| corrected[*best] < LEVEL);
    Ok(claimed.map(|best| {
        let (size_s, interval, _) = candidates[best];
        Found { name: NAMES[best], size_s, interval, p_value: corrected[best] }
    }))
}

type Tested = (f64, Interval, f64);

fn of_mean(values: &[f64]) -> Result<Tested, ParticipantsError> {
    let nothing = vec![0.0; values.len()];
    let test = paired_t(values, &nothing, Alternative::TwoSided)?;
    Ok((test.difference, mean_interval(values, 0.95)?, test.p_value))
}

/// Regresses the mean time of each trial on person, modality and place.
fn by_order(people: &[PersonTimes]) -> Result<Tested, ParticipantsError> {
    let mut times_s = Vec::new();
    for person in people {
        for commands in &person.commands {
            times_s.push(mean(&commands.iter().map(|(time_s, _)| *time_s).collect::<Vec<_>>())?);
        }
    }
    let persons = people.len();
    // Columns: one for each person, auditory and haptic against visual, place.
    let design = DMatrix::from_fn(3 * persons, persons + 3, |row, column| {
        let (person, modality) = (row / 3, row % 3);
        if column < persons {
            f64::from(u8::from(column == person))
        } else if column == persons + 2 {
            people[person].places[modality]
        } else {
            f64::from(u8::from(column - persons + 1 == modality))
        }
    });
    let fit = linear(&design, &times_s)?;
    let place = persons + 2;
    Ok((fit.parameters[place], fit.intervals(0.95)?[place], fit.p_values()[place]))
}

/// Slope of a person's times over the commands of a trial, s per command, mean of the trials.
fn slope(person: &PersonTimes) -> Result<f64, ParticipantsError> {
    let mut slopes = Vec::new();
    for commands in &person.commands {
        let times_s: Vec<f64> = commands.iter().map(|(time_s, _)| *time_s).collect();
        let design = DMatrix::from_fn(times_s.len(), 2, |row, column| if column == 0 { 1.0 } else { row as f64 });
        slopes.push(linear(&design, &times_s)?.parameters[1]);
    }
    Ok(mean(&slopes)?)
}

/// Extra time of haptic cues with both bands, s, beyond that of the same zones in the other modalities.
fn contrast(person: &PersonTimes) -> Result<f64, ParticipantsError> {
    let mut extra_s = [0.0; 3];
    for (extra_s, commands) in extra_s.iter_mut().zip(&person.commands) {
        let of = |is: bool| {
            mean(&commands.iter().filter(|(_, is_both)| *is_both == is).map(|(time_s, _)| *time_s).collect::<Vec<_>>())
        };
        *extra_s = of(true)? - of(false)?;
    }
    Ok(extra_s[2] - f64::midpoint(extra_s[0], extra_s[1]))
}
