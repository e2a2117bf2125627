//! Detection of missing rows.

use super::{super::clean::quantile, Column, Fault, Run};

/// Number of steps on each side that a step is compared with.
const AROUND: usize = 3;
/// Relative deviation from their median within which all but one of them must lie.
const ALIKE: f64 = 0.2;
/// Relative deviation from a straight line within which each step of an input must lie. With 0.2, the noisy voltage
/// of a position loop (EMPS) has jumps by chance.
const ALIKE_INPUT: f64 = 0.03;
/// Smallest jump, as a multiple of the median step: one missing row makes it 2.
const JUMP: f64 = 1.7;
/// Smallest jump, as a multiple of the largest step around it, if all go in one direction but differ by noise or
/// rounding. A speed that follows a step of the input within two thirds of a sample has such steps too: jumps near a
/// change of the input do not count.
const BLOCK: f64 = 4.0;
/// Share of an input's range that is a change.
const CHANGE: f64 = 0.1;
/// Largest jump, in steps. A longer one may be a step of the set point on top of a ramp.
const LARGEST: f64 = 60.0;
/// Smallest step that is judged, in counts: smaller ones differ by rounding alone.
const COUNTS: f64 = 4.0;
/// Smallest number of jumps that is a fault: fewer may be real steps.
const LEAST: usize = 4;
/// Smallest number of jumps among differing steps: fewer may be chance. Of 3000 good recordings one has four.
const LEAST_BLOCKS: usize = 6;
/// Smallest share of jumps among the places that can be judged.
const LEAST_SHARE: f64 = 0.002;
/// Relative spread (standard deviation over mean) of the intervals between jumps below which they are a beat of two
/// clocks: a source slower or faster than the file. Rows missing at random have 1.
const BEAT: f64 = 0.5;
/// Smallest number of intervals for that test: of fewer, some are alike by chance.
const FEWEST_APART: usize = 12;
/// Share of missing samples above which gaps are a fault.
const GAPS: f64 = 0.01;

/// Looks for steps that are a multiple of those around them, in one direction; of an input, whole multiples only.
pub(super) fn dropped(column: &Column<'_>, column_input: Option<&Column<'_>>) -> Option<Fault> {
    let is_input = column_input.is_none();
    let least = COUNTS * column.grain();
    let (mut judged, mut jumps, mut blocks, mut first_s, mut apart) = (0_usize, 0, 0, None, Vec::new());
    for (place, series) in column.series.iter().enumerate() {
        let moved: Vec<f64> = series.values.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let steps_s: Vec<f64> = series.time_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
        let slopes: Vec<f64> = moved.iter().zip(&steps_s).map(|(moved, step_s)| moved / step_s).collect();
        let mut last = None;
        for at in AROUND..slopes.len().saturating_sub(AROUND) {
            let around = || slopes[at - AROUND..at].iter().chain(&slopes[at + 1..=at + AROUND]).copied();
            let near: Vec<f64> = around().filter(|slope| slope.is_finite()).collect();
            let (Some(usual), true) = (quantile(&near, 0.5), near.len() == 2 * AROUND) else { continue };
            let most = near.iter().map(|slope| slope.abs()).fold(0.0, f64::max);
            let is_one_way = near.iter().all(|slope| slope * usual > 0.0);
            let is_block = !is_input && is_one_way && slopes[at] * usual > 0.0 && slopes[at].abs() > BLOCK * most;
            if is_block && !changes(column_input, place, at) {
                blocks += 1;
                first_s = first_s.or(Some(series.time_s[at]));
                apart.extend(last.map(|last| (at - last) as f64));
                last = Some(at);
                continue;
            }
            // A command has no noise, so its steps lie on a straight line.
            let mean = near.iter().sum::<f64>() / near.len() as f64;
            let places = [-3.0, -2.0, -1.0, 1.0, 2.0, 3.0];
            let bend =
                if is_input { near.iter().zip(places).map(|(slope, at)| slope * at).sum::<f64>() / 28.0 } else { 0.0 };
            let (middle, share) = if is_input { (mean, ALIKE_INPUT) } else { (usual, ALIKE) };
            let off = |(slope, at): (&f64, f64)| (slope - middle - bend * at).abs();
            let alike = near.iter().zip(places).filter(|one| off(*one) <= share * usual.abs()).count();
            // Around a turning point steps are small, and any step is a multiple of another.
            let is_turning = is_input && (!is_one_way || (6.0 * bend).abs() > mean.abs());
            if usual == 0.0
                || is_turning
                || alike + 1 < near.len()
                || (usual * steps_s[at]).abs() < least
                || !slopes[at].is_finite()
            {
                continue;
            }
            judged += 1;
            let times = slopes[at] / middle;
            if (JUMP..LARGEST).contains(&times) {
                jumps += 1;
                first_s = first_s.or(Some(series.time_s[at]));
                apart.extend(last.map(|last| (at - last) as f64));
                last = Some(at);
            }
        }
    }
    // Weighted sum of both kinds, each relative to its own smallest number.
    let is_enough = jumps * LEAST_BLOCKS + blocks * LEAST >= LEAST * LEAST_BLOCKS;
    let jumps = jumps + blocks;
    let is_fault = is_enough && jumps as f64 >= LEAST_SHARE * judged as f64 && !is_beat(&apart);
    let first_s = first_s.filter(|_| is_fault)?;
    Some(Fault::Dropped { column: column.name.to_owned(), jumps, first_s })
}

/// Returns whether the intervals between jumps are nearly equal.
fn is_beat(apart: &[f64]) -> bool {
    let mean = apart.iter().sum::<f64>() / apart.len().max(1) as f64;
    let spread = (apart.iter().map(|one| (one - mean).powi(2)).sum::<f64>() / apart.len().max(1) as f64).sqrt();
    apart.len() >= FEWEST_APART && spread <= BEAT * mean
}

/// Returns whether the input has a step within two samples of `at`.
fn changes(input: Option<&Column<'_>>, series: usize, at: usize) -> bool {
    let Some(input) = input else { return false };
    let [low, high] = input.ends();
    let Some(values) = input.series.get(series).map(|series| series.values) else { return false };
    let around = at.saturating_sub(2)..(at + 3).min(values.len());
    values
        .get(around)
        .is_some_and(|values| values.windows(2).any(|pair| (pair[1] - pair[0]).abs() > CHANGE * (high - low)))
}

/// Looks for gaps in the time stamps of regular recordings.
pub(super) fn gaps(runs: &[&Run]) -> Option<Fault> {
    let steps = || runs.iter().flat_map(|run| run.time_s.windows(2).map(|pair| pair[1] - pair[0]));
    let finite: Vec<f64> = steps().filter(|step| step.is_finite()).collect();
    let median_s = quantile(&finite, 0.5).filter(|median_s| *median_s > 0.0)?;
    let off: Vec<f64> = finite.iter().map(|step| (step - median_s).abs()).collect();
    // An irregular clock has long steps of its own; a tenth of the rows may be missing from a regular one.
    if quantile(&off, 0.7)? > 0.2 * median_s {
        return None;
    }
    let gaps: Vec<f64> = finite.iter().copied().filter(|step| *step > 1.8 * median_s).collect();
    // A logger that writes in bursts pauses at regular intervals, which is no fault.
    let places: Vec<usize> = (0..finite.len()).filter(|&at| finite[at] > 1.8 * median_s).collect();
    if is_beat(&places.windows(2).map(|pair| (pair[1] - pair[0]) as f64).collect::<Vec<_>>()) {
        return None;
    }
    let missing = gaps.iter().map(|step| (step / median_s).round() - 1.0).sum::<f64>() as usize;
    let samples = missing + finite.len();
    let longest_s = gaps.iter().copied().fold(0.0, f64::max);
    (gaps.len() >= 2 && missing as f64 >= GAPS * samples as f64).then_some(Fault::Gaps {
        missing,
        samples,
        gaps: gaps.len(),
        longest_s,
    })
}
