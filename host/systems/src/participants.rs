//! Studies with people: the order of conditions, fields of tables, and paired differences corrected for the order.

use std::borrow::Cow;

use nalgebra::DMatrix;
use r4_maths::{
    least_squares::{FitError, linear},
    statistics::{Interval, StatisticsError},
};

/// Fewest participants of a comparison: with three, no exact two-sided test of pairs can reach 5 %, nor has the
/// correction for the order two degrees of freedom.
const FEWEST: usize = 4;

/// Reason why conditions cannot be compared over participants.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ParticipantsError {
    /// Fewer than four participants have both conditions.
    #[error("{with_both} participants have both conditions: a comparison needs four")]
    TooFew {
        /// Number of participants with both conditions.
        with_both: usize,
    },
    /// All participants had the conditions in the same order.
    #[error(
        "all participants had the conditions in the same order: order and condition cannot be separated; counterbalance them"
    )]
    OneOrder,
    /// A statistic cannot be computed.
    #[error(transparent)]
    Statistics(#[from] StatisticsError),
    /// A line cannot be fitted.
    #[error(transparent)]
    Fit(#[from] FitError),
}

/// Mean of paired differences without the effect of the order.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OrderCorrected {
    /// Mean difference, in the differences' unit, of participants who had both conditions at the same place.
    pub difference: f64,
    /// 95 % confidence interval of the difference, by Student's t.
    pub interval: Interval,
    /// Two-sided p-value of "no difference".
    pub p_value: f64,
    /// Change of the measured value from one place of the sequence to the next.
    pub per_place: f64,
    /// Two-sided p-value of "the order changes nothing".
    pub per_place_p: f64,
}

impl OrderCorrected {
    /// Regresses `differences`, one for each participant, on `places_apart`: place of the first condition in the
    /// participant's sequence minus that of the second.
    ///
    /// # Errors
    /// [`ParticipantsError::TooFew`] below four participants, [`ParticipantsError::OneOrder`] where all `places_apart`
    /// are equal, or the error of the fit.
    pub fn of(differences: &[f64], places_apart: &[f64]) -> Result<Self, ParticipantsError> {
        let with_both = differences.len().min(places_apart.len());
        if with_both < FEWEST {
            return Err(ParticipantsError::TooFew { with_both });
        }
        if places_apart.iter().all(|place| *place == places_apart[0]) {
            return Err(ParticipantsError::OneOrder);
        }
        // The intercept is the difference at equal places: the contrast removes the order, the pairs remove the person.
        let design = DMatrix::from_fn(with_both, 2, |row, column| if column == 0 { 1.0 } else { places_apart[row] });
        let fit = linear(&design, differences)?;
        let p_values = fit.p_values();
        Ok(Self {
            difference: fit.parameters[0],
            interval: fit.intervals(0.95)?[0],
            p_value: p_values[0],
            per_place: fit.parameters[1],
            per_place_p: p_values[1],
        })
    }
}

/// Sequence in which participant number `participant` has `conditions`: a Williams design. Over 2 `conditions`
/// participants, or `conditions` where that is even, each condition comes equally often at each place and after each
/// other condition.
///
/// # Source
/// Williams, "Experimental Designs Balanced for the Estimation of Residual Effects of Treatments", Australian Journal of
/// Scientific Research A 2, 1949.
#[must_use]
pub fn williams_order(participant: usize, conditions: usize) -> Vec<usize> {
    if conditions == 0 {
        return Vec::new();
    }
    // First row of a Williams design: 0, 1, n-1, 2, n-2, ...
    let zigzag = |place: usize| if place % 2 == 1 { place.div_ceil(2) } else { (conditions - place / 2) % conditions };
    let start = participant % conditions;
    let mut row: Vec<usize> = (0..conditions).map(|place| (zigzag(place) + start) % conditions).collect();
    if conditions % 2 == 1 && (participant / conditions) % 2 == 1 {
        row.reverse();
    }
    row
}

/// Field of a CSV file, quoted where it must be (RFC 4180).
#[must_use]
pub fn csv_field(text: &str) -> Cow<'_, str> {
    if text.contains([',', '"', '\n', '\r']) {
        Cow::Owned(format!("\"{}\"", text.replace('"', "\"\"")))
    } else {
        Cow::Borrowed(text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Every condition comes equally often at each place, and after each other condition.
    #[test]
    fn orders_are_balanced() {
        for (conditions, participants) in [(2, 2), (3, 6), (4, 4)] {
            let rows: Vec<_> = (0..participants).map(|participant| williams_order(participant, conditions)).collect();
            for condition in 0..conditions {
                for place in 0..conditions {
                    let there = rows.iter().filter(|row| row[place] == condition).count();
                    assert_eq!(there * conditions, participants, "{rows:?}");
                }
                for other in (0..conditions).filter(|other| *other != condition) {
                    let behind = rows.iter().filter(|row| row.windows(2).any(|pair| pair == [condition, other]));
                    assert_eq!(behind.count() * conditions, participants, "{rows:?}");
                }
            }
        }
        assert_eq!(williams_order(usize::MAX, 0), Vec::<usize>::new());
    }

    #[test]
    fn the_order_is_removed_exactly() {
        let places_apart = [1.0, -2.0, 1.0, -1.0, 2.0];
        let noise = [0.01, -0.02, -0.01, 0.0, 0.02];
        let differences: Vec<f64> =
            places_apart.iter().zip(noise).map(|(place, noise)| 3.0 - 0.5 * place + noise).collect();
        let found = OrderCorrected::of(&differences, &places_apart).expect("five participants");
        assert!(found.interval.contains(3.0) && (found.per_place + 0.5).abs() < 0.02, "{found:?}");
        assert!(found.p_value < 1e-4 && found.per_place_p < 1e-3, "{found:?}");
        assert_eq!(OrderCorrected::of(&[1.0; 3], &[1.0; 3]), Err(ParticipantsError::TooFew { with_both: 3 }));
        assert_eq!(OrderCorrected::of(&[1.0; 4], &[1.0; 4]), Err(ParticipantsError::OneOrder));
    }

    #[test]
    fn fields_are_quoted_where_they_must_be() {
        assert_eq!(csv_field("soft"), "soft");
        assert_eq!(csv_field("soft, \"5 bar\""), "\"soft, \"\"5 bar\"\"\"");
    }
}
