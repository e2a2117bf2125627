//! Faults that recordings show without a model.
//!
//! | module | fault | evidence |
//! | --- | --- | --- |
//! | `saturated` | a sensor at the end of its range | it stays exactly at an extreme, entered and left at speed, or without its noise |
//! | `dropped` | rows that are missing | lone steps of a multiple of those around them; gaps in the time stamps |
//! | `order` | rows out of order | successive samples are uncorrelated |
//! | `reaction` | a wrong column | the input's history explains none of the output's motion |

mod dropped;
mod order;
mod reaction;
mod saturated;
#[cfg(test)]
mod tests;

use super::{Quantity, Run};

/// Fault of a recording, with its evidence and what to do next.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum Fault {
    /// A sensor at the end of its range.
    #[error(
        "`{column}` is saturated at {limit:.4} {unit}: {samples} samples in {stretches} stretches have exactly this value, {evidence}; record \
         with a wider range or less motion, or leave these samples empty"
    )]
    Saturated {
        /// Name of the sensor's column.
        column: String,
        /// Limit at which the sensor stays: its largest or smallest value, in `unit`.
        limit: f64,
        /// SI unit of `limit`.
        unit: &'static str,
        /// Number of samples at the limit, in stretches of at least three.
        samples: usize,
        /// Number of stretches at the limit.
        stretches: usize,
        /// Evidence that this is no rest.
        evidence: Evidence,
    },
    /// Steps are a multiple of those around them, because rows are missing.
    #[error(
        "`{column}` jumps by a multiple of its steps around in {jumps} places, the first at {first_s:.3} s: rows are missing although the time \
         stamps go on evenly; record the time of each row, or record again"
    )]
    Dropped {
        /// Name of the column that jumps.
        column: String,
        /// Number of jumps in all recordings.
        jumps: usize,
        /// Time of the first jump in its run, s.
        first_s: f64,
    },
    /// The time stamps have gaps.
    #[error(
        "{missing} of {samples} samples are missing, in {gaps} gaps of the time stamps, the longest {longest_s:.3} s; look for what \
         loses rows between sensor and file"
    )]
    Gaps {
        /// Number of samples that would fill the gaps.
        missing: usize,
        /// Number of present and missing samples.
        samples: usize,
        /// Number of gaps, in all recordings together.
        gaps: usize,
        /// Longest time between two samples, s.
        longest_s: f64,
    },
    /// Successive samples are uncorrelated: the rows are out of order.
    #[error(
        "successive samples of `{column}` have a correlation of {correlation:.2}: the rows are out of order, or the column is noise; sort \
         the rows by time, or map another column"
    )]
    Shuffled {
        /// Name of the column that is out of order.
        column: String,
        /// Correlation of each sample with the next, -1..=1.
        correlation: f64,
    },
    /// The output does not react to the input.
    #[error(
        "`{output}` does not react to `{input}`: its history explains {:.0} % of the motion, no more than the history of another moment \
         ({:.0} %); check which columns are mapped, and that the drive was on", share * 100.0, chance * 100.0
    )]
    NoReaction {
        /// Column of the output.
        output: String,
        /// Column of the input.
        input: String,
        /// Share of the variance that a regression on the input's history explains.
        share: f64,
        /// The same share with the input shifted in time: what chance explains.
        chance: f64,
    },
}

/// Evidence that a sensor which stays at an extreme is saturated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Evidence {
    /// The sensor has noise elsewhere, but none at the limit.
    NoNoise,
    /// The signal stops within one sample and later continues as fast.
    AtSpeed,
}

impl std::fmt::Display for Evidence {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        out.write_str(match self {
            Self::NoNoise => "without the noise that it has elsewhere",
            Self::AtSpeed => "entered and left at full speed",
        })
    }
}

/// One column of a run.
#[derive(Clone, Copy)]
struct Series<'r> {
    time_s: &'r [f64],
    values: &'r [f64],
}

/// One column in all runs that have it.
struct Column<'r> {
    name: &'r str,
    unit: &'static str,
    /// True for a speed: a drive acts on the value itself, not on its rate.
    is_speed: bool,
    series: Vec<Series<'r>>,
}

impl<'r> Column<'r> {
    fn of(runs: &[&'r Run], role: &str) -> Option<Self> {
        let signals = || runs.iter().filter_map(|run| run.signals.get(role).map(|signal| (*run, signal)));
        let (_, first) = signals().next()?;
        let series = |(run, signal): (&'r Run, &'r super::Signal)| {
            let (time_s, values) = (&run.time_s[..], &signal.values[..]);
            (time_s.len() == values.len()).then_some(Series { time_s, values })
        };
        let is_speed = matches!(first.quantity, Quantity::AngularSpeed | Quantity::Speed);
        Some(Self {
            name: &first.column,
            unit: first.quantity.si(),
            is_speed,
            series: signals().filter_map(series).collect(),
        })
    }

    fn finite(&self) -> impl Iterator<Item = f64> {
        self.series.iter().flat_map(|series| series.values.iter().copied()).filter(|value| value.is_finite())
    }

    /// Returns the smallest and the largest value.
    fn ends(&self) -> [f64; 2] {
        [self.finite().fold(f64::INFINITY, f64::min), self.finite().fold(f64::NEG_INFINITY, f64::max)]
    }

    /// Returns the quantisation step of a converter or an encoder, of which all values are whole multiples but for an
    /// offset; 0 for other columns.
    fn grain(&self) -> f64 {
        let mut values: Vec<f64> = self.finite().collect();
        values.sort_by(f64::total_cmp);
        let [low, high] = [values.first(), values.last()].map(|value| value.copied().unwrap_or(0.0));
        let steps: Vec<f64> =
            values.windows(2).map(|pair| pair[1] - pair[0]).filter(|step| *step > 1e-9 * (high - low)).collect();
        let grain = steps.iter().copied().fold(f64::INFINITY, f64::min);
        let is_whole = |step: &f64| {
            let counts = step / grain;
            (counts - counts.round()).abs() < 0.05
        };
        if steps.iter().all(is_whole) && grain.is_finite() { grain } else { 0.0 }
    }
}

/// Returns the faults of the outputs of `runs`, and of their rows.
///
/// `inputs` and `outputs` are roles; those that a run lacks are skipped.
#[must_use]
pub fn faults(runs: &[&Run], inputs: &[&str], outputs: &[&str]) -> Vec<Fault> {
    let columns = |roles: &[&str]| roles.iter().filter_map(|role| Column::of(runs, role)).collect::<Vec<_>>();
    let (inputs, outputs) = (columns(inputs), columns(outputs));
    let shuffled: Vec<Fault> = outputs.iter().filter_map(|output| order::shuffled(output, &inputs)).collect();
    if !shuffled.is_empty() {
        // Rows out of order make all other tests meaningless.
        return shuffled;
    }
    let mut found: Vec<Fault> =
        outputs.iter().flat_map(|output| saturated::saturated(output, inputs.first())).collect();
    found.extend(dropped::gaps(runs));
    // The rate of a body on several wheels steps where their friction does, which no input shows.
    let judged = outputs.iter().filter(|output| !output.is_speed || inputs.len() == 1);
    let of_outputs = judged.filter_map(|output| dropped::dropped(output, inputs.first()));
    found.extend(of_outputs.chain(inputs.iter().filter_map(|input| dropped::dropped(input, None))).next());
    // Two inputs that are constant through most of a run, such as the sides of a robot, make an uninformative
    // regression.
    if inputs.len() == 1 {
        found.extend(outputs.iter().filter_map(|output| reaction::none(output, &inputs)));
    }
    found
}
