//! Comparison of the three modalities over participants: paired and corrected for the order, beside the paper's test.

use r4_maths::statistics::{Alternative, StatisticsError, TTest, holm, welch_t, wilcoxon_signed_rank};

use super::cue::Modality;
use super::log::TrialRow;
use crate::participants::{OrderCorrected, ParticipantsError};

/// Compared pairs of modalities, as places in [`Modality::ALL`]: haptic minus visual, haptic minus auditory, auditory minus
/// visual.
pub const PAIRS: [[usize; 2]; 3] = [[2, 0], [2, 1], [1, 0]];

/// Measured values of one participant who did all three modalities.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Person {
    /// Place of each modality in the person's sequence, 1 to 3, in the order of [`Modality::ALL`].
    pub places: [f64; 3],
    /// Measured value of each modality.
    pub values: [f64; 3],
}

/// Comparison of two modalities.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Comparison {
    /// Compared modalities: the first minus the second.
    pub pair: [Modality; 2],
    /// Paired difference, corrected for the order.
    pub paired: OrderCorrected,
    /// p-value of the paired difference, corrected by Holm's method for the three comparisons.
    pub holm_p: f64,
    /// Exact two-sided p-value of Wilcoxon's signed-rank test, neither corrected for the order nor for three
    /// comparisons; 1 where all pairs are equal.
    pub wilcoxon_p: f64,
    /// The paper's test: Welch's t between the modalities as if other people had done them, not corrected; `None` where
    /// both are constant.
    pub welch: Option<TTest>,
}

/// Comparisons of one measured quantity.
#[derive(Clone, Debug, PartialEq)]
pub struct Measure {
    /// Name of the quantity: `time_s`, `mistakes` or `sus`.
    pub name: &'static str,
    /// Number of participants with the quantity in all modalities.
    pub people: usize,
    /// Comparisons in the order of [`PAIRS`].
    pub comparisons: [Comparison; 3],
}

/// Reason why tables of trials cannot be analysed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum AnalysisError {
    /// A participant has two complete trials of a modality.
    #[error("{participant} has two complete {modality} trials: leave the one out that does not count")]
    Twice {
        /// Code of the participant.
        participant: String,
        /// Name of the modality.
        modality: &'static str,
    },
    /// A quantity cannot be compared.
    #[error("{measure}: {why}")]
    Measure {
        /// Name of the quantity.
        measure: &'static str,
        /// Reason, such as too few participants.
        why: ParticipantsError,
    },
}

/// Compares trial times, mistakes and, where there are answers, usability scores.
///
/// # Errors
/// [`AnalysisError`] for a trial that is there twice, or for too few participants.
pub fn measures(rows: &[TrialRow]) -> Result<Vec<Measure>, AnalysisError> {
    for (at, row) in rows.iter().enumerate() {
        if rows[..at].iter().any(|other| other.participant == row.participant && other.modality == row.modality) {
            let (participant, modality) = (row.participant.clone(), row.modality.name());
            return Err(AnalysisError::Twice { participant, modality });
        }
    }
    let measure = |name: &'static str, of: &dyn Fn(&TrialRow) -> Option<f64>| {
        let people = people(rows, of);
        let comparisons = compare(&people).map_err(|why| AnalysisError::Measure { measure: name, why })?;
        Ok(Measure { name, people: people.len(), comparisons })
    };
    let mut measures =
        vec![measure("time_s", &|row| Some(row.time_s))?, measure("mistakes", &|row| Some(row.mistakes))?];
    if rows.iter().any(|row| row.sus.is_some()) {
        measures.push(measure("sus", &|row| row.sus)?);
    }
    Ok(measures)
}

/// Values of the participants who have a complete trial in each modality, by `value`; the first trial of a modality
/// counts. A trial without the value is as none.
#[must_use]
pub fn people(rows: &[TrialRow], value: impl Fn(&TrialRow) -> Option<f64>) -> Vec<Person> {
    let mut codes: Vec<&str> = rows.iter().map(|row| row.participant.as_str()).collect();
    codes.sort_unstable();
    codes.dedup();
    let person = |code: &&str| {
        let of = |modality: Modality| {
            let mut own = rows.iter().filter(|row| row.participant == **code && row.modality == modality);
            own.find_map(|row| Some((row.place as f64, value(row)?)))
        };
        let [Some(visual), Some(auditory), Some(haptic)] = Modality::ALL.map(of) else { return None };
        Some(Person { places: [visual.0, auditory.0, haptic.0], values: [visual.1, auditory.1, haptic.1] })
    };
    codes.iter().filter_map(person).collect()
}

/// Compares the modalities in pairs, in the order of [`PAIRS`].
///
/// # Errors
/// [`ParticipantsError::TooFew`] below four people; [`ParticipantsError::OneOrder`] where a pair always has the same
/// distance in the sequence; otherwise the error of a statistic.
pub fn compare(people: &[Person]) -> Result<[Comparison; 3], ParticipantsError> {
    let of = |pair: [usize; 2]| {
        let [first, second] = pair.map(|at| people.iter().map(|person| person.values[at]).collect::<Vec<f64>>());
        let differences: Vec<f64> = first.iter().zip(&second).map(|(first, second)| first - second).collect();
        let apart: Vec<f64> = people.iter().map(|person| person.places[pair[0]] - person.places[pair[1]]).collect();
        let paired = OrderCorrected::of(&differences, &apart)?;
        let wilcoxon_p = match wilcoxon_signed_rank(&first, &second, Alternative::TwoSided) {
            Ok(test) => test.p_value,
            Err(StatisticsError::NoSpread) => 1.0,
            Err(error) => return Err(error.into()),
        };
        let welch = match welch_t(&first, &second, Alternative::TwoSided) {
            Ok(test) => Some(test),
            Err(StatisticsError::NoSpread) => None,
            Err(error) => return Err(error.into()),
        };
        let pair = pair.map(|at| Modality::ALL[at]);
        Ok::<_, ParticipantsError>(Comparison { pair, paired, holm_p: 1.0, wilcoxon_p, welch })
    };
    let mut compared = [of(PAIRS[0])?, of(PAIRS[1])?, of(PAIRS[2])?];
    // Equal values in all pairs fit without an error: NaN, and nothing to claim.
    let p_values =
        compared.map(|comparison| if comparison.paired.p_value.is_nan() { 1.0 } else { comparison.paired.p_value });
    for (comparison, p) in compared.iter_mut().zip(holm(&p_values)?) {
        comparison.holm_p = p;
    }
    Ok(compared)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::xrhmi::synthetic::Population;

    fn rows(persons: usize) -> Vec<TrialRow> {
        let people = Population::of_paper(0.7, 0.1).study(5, 1, persons);
        let rows = people.iter().enumerate().flat_map(|(number, person)| {
            Modality::ALL.map(|modality| TrialRow {
                participant: format!("P{number:03}"),
                place: person.places[modality as usize] as usize,
                modality,
                time_s: person.values[modality as usize],
                mistakes: 0.0,
                sus: (number > 2).then_some(50.0 + person.values[modality as usize] / 10.0),
            })
        });
        rows.collect()
    }

    #[test]
    fn tables_are_compared_by_quantity() {
        let measures = measures(&rows(10)).expect("ten people");
        let names: Vec<_> = measures.iter().map(|measure| (measure.name, measure.people)).collect();
        assert_eq!(names, [("time_s", 10), ("mistakes", 10), ("sus", 7)]);
        let [time, mistakes, _] = &measures[..] else { panic!("{measures:?}") };
        for (comparison, pair) in time.comparisons.iter().zip(PAIRS) {
            assert_eq!(comparison.pair, pair.map(|at| Modality::ALL[at]));
            assert!(comparison.holm_p >= comparison.paired.p_value, "{comparison:?}");
        }
        // No one made a mistake: nothing differs, and nothing is claimed.
        assert!(mistakes.comparisons.iter().all(|none| none.holm_p == 1.0 && none.wilcoxon_p == 1.0));
    }

    #[test]
    fn tables_that_say_nothing_are_refused() {
        let mut twice = rows(5);
        twice.push(twice[0].clone());
        let error = measures(&twice).expect_err("a trial twice").to_string();
        assert_eq!(error, "P000 has two complete visual trials: leave the one out that does not count");
        let error = measures(&rows(3)).expect_err("three people").to_string();
        assert!(error.starts_with("time_s: 3 participants have both conditions"), "{error}");
    }
}
