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
