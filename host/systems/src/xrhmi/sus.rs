//! System Usability Scale: scores of answers, and the means that a printed number can stand for.

/// Number of statements, answered from 1 (disagree) to 5 (agree).
pub const STATEMENTS: usize = 10;
/// Step of a score.
const STEP: f64 = 2.5;

/// Answers of one person.
pub type Answers = [u8; STATEMENTS];

/// An answer that is not on the scale.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("answer {answer} to statement {statement} is not in 1 to 5: correct it in the table")]
pub struct BadAnswer {
    /// Number of the statement, from 1 on.
    pub statement: usize,
    /// Answer as given.
    pub answer: u8,
}

/// Returns the score of a person's answers, 0 to 100: 2.5 (Σ odd (x - 1) + Σ even (5 - x)).
///
/// # Errors
/// [`BadAnswer`] for the first answer outside 1 to 5.
///
/// # Source
/// Brooke, "SUS: A Quick and Dirty Usability Scale", in *Usability Evaluation in Industry*, Taylor & Francis 1996.
pub fn score(answers: &Answers) -> Result<f64, BadAnswer> {
    let mut points = 0u32;
    for (place, answer) in answers.iter().enumerate() {
        if !(1..=5).contains(answer) {
            return Err(BadAnswer { statement: place + 1, answer: *answer });
        }
        // Statements 1, 3, 5, ... praise the system, the others criticise it.
        points += u32::from(if place % 2 == 0 { answer - 1 } else { 5 - answer });
    }
    Ok(STEP * f64::from(points))
}

/// Means of `people` scores that are printed as `printed` with `decimals` digits, whichever way a tie is rounded.
#[must_use]
pub fn attainable(printed: f64, decimals: i32, people: u32) -> Vec<f64> {
    if people == 0 {
        return Vec::new();
    }
    let step = STEP / f64::from(people);
    // The allowance is for binary fractions: 54.25 - 54.2 is not exactly a half of the last digit.
    let half = 0.5 * 10f64.powi(-decimals) + 1e-9;
    let first = ((printed - half) / step).ceil().max(0.0) as u32;
    (first..=40 * people).map(|steps| f64::from(steps) * step).take_while(|mean| *mean <= printed + half).collect()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn scores_are_brookes() {
        assert_eq!(score(&[5, 1, 5, 1, 5, 1, 5, 1, 5, 1]), Ok(100.0));
        assert_eq!(score(&[1, 5, 1, 5, 1, 5, 1, 5, 1, 5]), Ok(0.0));
        assert_eq!(score(&[3; 10]), Ok(50.0));
        // Brooke's own example: 22 points.
        assert_eq!(score(&[5, 4, 2, 1, 2, 3, 2, 4, 4, 5]), Ok(45.0));
        assert_eq!(score(&[3, 3, 0, 3, 3, 3, 3, 3, 3, 3]), Err(BadAnswer { statement: 3, answer: 0 }));
    }

    /// Of ten people only 54.25 is printed as 54.2; a mean of 54.2 does not exist.
    #[test]
    fn the_printed_mean_is_54_25() {
        assert_eq!(attainable(54.2, 1, 10), [54.25]);
        assert_eq!(attainable(78.25, 2, 10), [78.25]);
        assert_eq!(attainable(76.5, 1, 10), [76.5]);
        assert_eq!(attainable(54.3, 1, 10), [54.25], "rounded up it is the same mean");
        assert_eq!(attainable(54.1, 1, 10), Vec::<f64>::new());
        assert_eq!(attainable(54.2, 1, 0), Vec::<f64>::new());
    }

    proptest! {
        #[test]
        fn the_mean_of_ten_is_a_multiple_of_a_quarter(sheets in prop::collection::vec(prop::array::uniform10(1u8..=5), 10)) {
            let scores: Vec<f64> = sheets.iter().map(|sheet| score(sheet).expect("on the scale")).collect();
            prop_assert!(scores.iter().all(|score| (0.0..=100.0).contains(score)));
            let mean = scores.iter().sum::<f64>() / 10.0;
            prop_assert_eq!((4.0 * mean).fract(), 0.0);
            prop_assert!(attainable((mean * 10.0).round() / 10.0, 1, 10).contains(&mean));
        }
    }
}
