//! Logger and paired statistics for trials in which people pick with several tools, one after the other.
//!
//! [`Recorder`] detects picks in the handle's switch as a board reports it, [`to_csv`] writes them, [`williams_order`](crate::participants::williams_order)
//! counterbalances the sequence of the tools over participants, and [`compare`] tests two tools against each other: one
//! difference per participant, with the order of the two as covariate, after removal of the trend over picks.
//!
//! ```
//! use r4_protocol::Sample;
//! use r4_rig::{Error, Rig, Session};
//! use r4_systems::berry::{scene::HANDLE, trials::{Pick, PickResult, Recorder, to_csv}};
//!
//! // `usb:...` with people; a simulated board here, whose handle the example presses by itself.
//! let rig = Rig::new("sim:berry-picker".parse()?);
//! let work = async |session: &Session<'_>| {
//!     let press = |is_pressed| -> Result<(), Error> {
//!         if let Some(r4_world::AnyBody::BerryPicker(tool)) = session.virtual_board()?.world().body_mut() {
//!             tool.press(is_pressed);
//!         }
//!         Ok(())
//!     };
//!     let mut samples = session.board.samples(HANDLE, 5).await?;
//!     let (mut recorder, mut picks) = (Recorder::new(0.020), Vec::new());
//!     for number in 0..400 {
//!         press((100..200).contains(&number))?;
//!         let sample = samples.next().await?;
//!         let (Sample::Scalar { value, .. } | Sample::Reading { value, .. }) = sample.sample else { continue };
//!         if let Some([pressed_s, released_s]) = recorder.push(sample.device_us as f64 * 1e-6, value > 0.5) {
//!             // The observer types what became of the berry.
//!             let result = PickResult::Picked;
//!             let (participant, gripper) = ("P01".to_owned(), "soft".to_owned());
//!             picks.push(Pick { participant, gripper, order: 1, number: picks.len() + 1, pressed_s, released_s, result });
//!         }
//!     }
//!     Ok::<_, Error>(picks)
//! };
//! let (picks, _) = rig.run(None, work)?;
//! assert_eq!(to_csv(&picks).lines().count(), 2, "a header and a pick");
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! The tests use synthetic participants; nothing is claimed about people. With four participants, as in the paper, no
//! exact two-sided test can reach 5 %: of 16 equally likely sign patterns, two are as extreme as all alike.

use std::fmt::Write;

use nalgebra::DMatrix;
use r4_maths::{
    least_squares::{Fit, linear},
    statistics::{Alternative, Interval, mean, paired_t, wilcoxon_signed_rank},
};

use crate::participants::{OrderCorrected, ParticipantsError, csv_field};

/// Result of one pick, noted by the observer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PickResult {
    /// The berry is in the tray.
    Picked,
    /// The berry is on the ground.
    Dropped,
    /// The berry is still on the bush.
    Missed,
}

impl PickResult {
    /// Name of the result in a CSV file.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Picked => "picked",
            Self::Dropped => "dropped",
            Self::Missed => "missed",
        }
    }
}

/// One press of the handle.
#[derive(Clone, Debug, PartialEq)]
pub struct Pick {
    /// Code of the participant, never a name.
    pub participant: String,
    /// Name of the tool.
    pub gripper: String,
    /// Place of the tool in the participant's sequence, from 1 on.
    pub order: usize,
    /// Number of the pick with that tool, from 1 on.
    pub number: usize,
    /// Time of the handle's press, s on the board's clock.
    pub pressed_s: f64,
    /// Time of the handle's release, s on the board's clock.
    pub released_s: f64,
    /// Result, noted by the observer.
    pub result: PickResult,
}

/// Detector of presses in the samples of a switch. An edge counts once the switch has been stable for the debounce
/// time, and has the time of its first sample.
#[derive(Clone, Debug)]
pub struct Recorder {
    debounce_s: f64,
    is_pressed: bool,
    /// Time since which the switch has been in the other state, s; `None` while it agrees with `is_pressed`.
    changed_s: Option<f64>,
    pressed_s: Option<f64>,
}

impl Recorder {
    /// Creates a recorder for a released handle with this debounce time, s; printed: 0.020 s.
    #[must_use]
    pub const fn new(debounce_s: f64) -> Self {
        Self { debounce_s, is_pressed: false, changed_s: None, pressed_s: None }
    }

    /// Takes a sample at `at_s`. Returns the times of press and release, s, when a press has ended.
    pub fn push(&mut self, at_s: f64, is_closed: bool) -> Option<[f64; 2]> {
        if is_closed == self.is_pressed {
            self.changed_s = None;
            return None;
        }
        let changed_s = *self.changed_s.get_or_insert(at_s);
        if at_s - changed_s < self.debounce_s {
            return None;
        }
        self.is_pressed = is_closed;
        self.changed_s = None;
        if is_closed {
            self.pressed_s = Some(changed_s);
            return None;
        }
        Some([self.pressed_s.take()?, changed_s])
    }
}

/// Formats picks as a CSV file with a header (RFC 4180).
#[must_use]
pub fn to_csv(picks: &[Pick]) -> String {
    let mut text = String::from("participant,gripper,order,number,pressed_s,released_s,result\r\n");
    for pick in picks {
        let Pick { participant, gripper, order, number, pressed_s, released_s, result } = pick;
        // Writing to a String cannot fail.
        let _ = write!(
            text,
            "{},{},{order},{number},{pressed_s:.6},{released_s:.6},{}\r\n",
            csv_field(participant),
            csv_field(gripper),
            result.name()
        );
    }
    text
}

/// Comparison of two tools over the participants who used both.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// Number of participants who used both tools.
    pub participants: usize,
    /// Time per pick with the first tool minus that with the second, s: mean over participants, corrected for the
    /// order.
    pub difference_s: f64,
    /// 95 % confidence interval of the difference, by Student's t, s.
    pub interval_s: Interval,
    /// Reduction of a tool's time in second place against first place, s, summed over both tools: twice the learning
    /// from one tool to the next.
    pub order_s: f64,
    /// Two-sided p-value of a paired t-test, not corrected for the order.
    pub t_p: f64,
    /// Two-sided exact p-value of Wilcoxon's signed-rank test.
    pub wilcoxon_p: f64,
    /// Mean slope of the time over picks, s per pick: negative where participants learn.
    pub learning_s_per_pick: f64,
    /// Two-sided p-value of that slope: the participants' slopes against 0.
    pub learning_p: f64,
}

/// Straight line through the times of successive picks, centred: `[level, slope]`, s and s per pick.
fn trend(times_s: &[f64]) -> Result<[f64; 2], ParticipantsError> {
    let middle = 0.5 * (times_s.len() as f64 - 1.0);
    let design = DMatrix::from_fn(times_s.len(), 2, |row, column| if column == 0 { 1.0 } else { row as f64 - middle });
    let Fit { parameters, .. } = linear(&design, times_s)?;
    Ok([parameters[0], parameters[1]])
}

/// Compares the times per pick, from one press to the next, of two tools.
///
/// # Errors
/// [`ParticipantsError::TooFew`] for fewer than four participants with both tools; [`ParticipantsError::OneOrder`] when all used
/// them in the same order; otherwise the error of a fit or statistic.
pub fn compare(picks: &[Pick], first: &str, second: &str) -> Result<Comparison, ParticipantsError> {
    let mut people: Vec<&str> = picks.iter().map(|pick| pick.participant.as_str()).collect();
    people.sort_unstable();
    people.dedup();
    let (mut levels, mut slopes, mut signs) = ([Vec::new(), Vec::new()], Vec::new(), Vec::new());
    for person in people {
        let of = |tool: &str| {
            let mut own: Vec<&Pick> =
                picks.iter().filter(|pick| pick.participant == person && pick.gripper == tool).collect();
            own.sort_by(|a, b| a.pressed_s.total_cmp(&b.pressed_s));
            let times_s: Vec<f64> = own.windows(2).map(|pair| pair[1].pressed_s - pair[0].pressed_s).collect();
            own.first().filter(|_| times_s.len() >= 2).map(|pick| (times_s.clone(), pick.order))
        };
        let (Some((one_s, one_order)), Some((two_s, two_order))) = (of(first), of(second)) else { continue };
        let (one, two) = (trend(&one_s)?, trend(&two_s)?);
        levels[0].push(one[0]);
        levels[1].push(two[0]);
        // One slope per participant: those of the two tools are not independent.
        slopes.push(f64::midpoint(one[1], two[1]));
        // Contrast coding: the intercept of the regression is then the difference without the effect of the order.
        signs.push(if one_order > two_order { 1.0 } else { -1.0 });
    }
    let participants = signs.len();
    let differences_s: Vec<f64> = levels[0].iter().zip(&levels[1]).map(|(one, two)| one - two).collect();
    let corrected = OrderCorrected::of(&differences_s, &signs)?;
    let none = vec![0.0; participants];
    Ok(Comparison {
        participants,
        difference_s: corrected.difference,
        interval_s: corrected.interval,
        // The two orders are two units of the contrast apart.
        order_s: -2.0 * corrected.per_place,
        t_p: paired_t(&levels[0], &levels[1], Alternative::TwoSided)?.p_value,
        wilcoxon_p: wilcoxon_signed_rank(&levels[0], &levels[1], Alternative::TwoSided)?.p_value,
        learning_s_per_pick: mean(&slopes)?,
        learning_p: paired_t(&slopes, &none, Alternative::TwoSided)?.p_value,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Sampler, participants::williams_order};

    /// Synthetic participants: each has a pace of their own, learns over 34 picks and from tool to tool, and scatters.
    fn picks(seed: u64, participants: usize, slower_s: f64) -> Vec<Pick> {
        let mut sampler = Sampler::new(seed, 99);
        let mut picks = Vec::new();
        for participant in 0..participants {
            let pace_s = 2.2 + sampler.normal(0.4);
            let own_s = sampler.normal(0.2);
            for (place, tool) in williams_order(participant, 2).into_iter().enumerate() {
                let mut at_s = 0.0;
                for number in 1..=34 {
                    let learnt_s = -0.008 * number as f64 - 0.2 * place as f64;
                    let tool_s = if tool == 0 { slower_s + own_s } else { 0.0 };
                    picks.push(Pick {
                        participant: format!("P{participant:02}"),
                        gripper: ["soft", "hard"][tool].into(),
                        order: place + 1,
                        number,
                        pressed_s: at_s,
                        released_s: at_s + 0.5,
                        result: PickResult::Picked,
                    });
                    at_s += pace_s + tool_s + learnt_s + sampler.normal(0.3);
                }
            }
        }
        picks
    }

    /// Without a difference, 5 % of the studies' intervals exclude 0, and neither test is below 5 % more often.
    #[test]
    fn no_difference_is_found_in_one_of_twenty() {
        const STUDIES: u64 = 600;
        let found = |is: &dyn Fn(&Comparison) -> bool| {
            (0..STUDIES).filter(|seed| is(&compare(&picks(*seed, 8, 0.0), "soft", "hard").expect("studies"))).count()
        };
        // 30 are expected of 600; a binomial count is above 46 in one of a thousand.
        assert!(found(&|comparison| !comparison.interval_s.contains(0.0)) <= 46);
        assert!(found(&|comparison| comparison.wilcoxon_p <= 0.05) <= 46);
        assert!(found(&|comparison| comparison.t_p <= 0.05) <= 46);
    }

    /// A declared difference of 0.4 s, with a spread of 0.2 s between participants: the standard error with 8
    /// participants is 0.08 s, so that nearly all studies find it.
    #[test]
    fn a_declared_difference_is_found_with_its_learning() {
        let mut found = 0;
        for seed in 1000..1100 {
            let comparison = compare(&picks(seed, 8, 0.4), "soft", "hard").expect("a study");
            found += u32::from(!comparison.interval_s.contains(0.0));
            assert!((comparison.learning_s_per_pick + 0.008).abs() < 0.01, "{comparison:?}");
            assert!((comparison.order_s - 0.4).abs() < 0.6, "{comparison:?}");
        }
        assert!(found >= 90, "{found} of 100");
    }

    #[test]
    fn what_says_nothing_is_refused() {
        assert_eq!(compare(&picks(1, 3, 0.4), "soft", "hard"), Err(ParticipantsError::TooFew { with_both: 3 }));
        let mut same = picks(1, 6, 0.4);
        same.iter_mut().for_each(|pick| pick.order = usize::from(pick.gripper == "hard"));
        assert_eq!(compare(&same, "soft", "hard"), Err(ParticipantsError::OneOrder));
    }

    #[test]
    fn bounces_are_no_presses() {
        let mut recorder = Recorder::new(0.020);
        let closed = |ms: u32| matches!(ms, 100..=101 | 103..=500 | 502..=600);
        let presses: Vec<_> = (0..900).filter_map(|ms: u32| recorder.push(f64::from(ms) * 1e-3, closed(ms))).collect();
        let [[pressed_s, released_s]] = presses[..] else { panic!("{presses:?}") };
        // The press counts from the last bounce on.
        assert!((pressed_s - 0.103).abs() < 1e-9 && (released_s - 0.601).abs() < 1e-9, "{presses:?}");
    }

    #[test]
    fn a_table_has_a_line_for_each_pick() {
        let mut picks = picks(1, 4, 0.0);
        picks.truncate(2);
        picks[1].gripper = "soft, 5 bar".into();
        let text = to_csv(&picks);
        let lines: Vec<_> = text.split_terminator("\r\n").collect();
        assert_eq!(lines.len(), 3);
        assert_eq!(lines[0], "participant,gripper,order,number,pressed_s,released_s,result");
        assert!(lines[2].starts_with("P00,\"soft, 5 bar\",1,2,"), "{text}");
    }
}
