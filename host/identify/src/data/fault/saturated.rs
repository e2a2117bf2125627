//! Detection of a sensor at the end of its range.
//!
//! Good recordings stay at an extreme as well: a motor at rest with a coarse encoder, an actuator at its end stop.
//! Two properties distinguish a saturated sensor. (1) Noise: if all samples have noise, also the slow ones, none can
//! repeat exactly except at a limit. (2) Motion: a mechanism at rest begins to move with a displacement that grows
//! with the square of time, while a sensor comes back from its limit at speed. A drive so quick that it leaves a stop
//! at full speed within a sample does so when the input changes; the sensor comes back later.

use r4_maths::statistics::robust_deviation;

use super::{Column, Evidence, Fault, Series};

/// Smallest number of consecutive samples exactly at an extreme.
const LEAST: usize = 3;
/// Smallest length of a stretch that is judged by speed: a sensor on a bus may repeat a value in the middle of a
/// quick reversal.
const LEAST_AT_SPEED: usize = 6;
/// Samples after which displacements from the limit are compared with those after twice as many. At constant speed
/// the latter are at most (2n - 1) / (n - 1) times as large, if the first sample is only just off the limit; from
/// rest under constant acceleration 4 times.
const SPANS: [usize; 2] = [2, 4];
/// Margin on that bound, for curvature and rounding.
const MARGIN: f64 = 1.1;
/// Smallest displacement that is motion at speed, as a share of the largest steps.
const AT_SPEED: f64 = 0.1;
/// Smallest displacement at speed, in counts: with fewer, rounding decides the ratio above.
const COUNTS: f64 = 6.0;
/// Share of its range by which the input must step to count as a change that the output may follow at once.
const CHANGE: f64 = 0.1;
/// Number of samples before the output leaves in which the input may have changed. Static friction holds an actuator
/// at its stop for some of them after a sine reverses.
const JUST_BEFORE: usize = 8;

/// Consecutive samples `from..to` of a run at the limit.
struct Stretch {
    series: usize,
    from: usize,
    to: usize,
}

pub(super) fn saturated(column: &Column<'_>, input: Option<&Column<'_>>) -> Vec<Fault> {
    let [low, high] = column.ends();
    if low.is_nan() || high.is_nan() || high - low <= 0.0 || column.finite().count() < 50 {
        return Vec::new();
    }
    let grain = column.grain();
    // Both ends of the range are tested alike.
    let find = |(limit, other): (f64, f64)| {
        let stretches = stretches(column, limit);
        let samples = stretches.iter().map(|stretch| stretch.to - stretch.from).sum();
        // Direction from the limit into the range.
        let inwards = (other - limit).signum();
        let evidence = if has_no_noise(column, &stretches, grain) {
            Evidence::NoNoise
        } else if is_left_at_speed(column, input, limit, inwards, &stretches, grain) {
            Evidence::AtSpeed
        } else {
            return None;
        };
        let (column, unit) = (column.name.to_owned(), column.unit);
        Some(Fault::Saturated { column, limit, unit, samples, stretches: stretches.len(), evidence })
    };
    [(high, low), (low, high)].into_iter().filter_map(find).collect()
}

/// Returns the stretches at a limit, but for one that begins a run: a sensor may repeat its first value until it has
/// another.
fn stretches(column: &Column<'_>, limit: f64) -> Vec<Stretch> {
    let mut found = Vec::new();
    for (series, Series { values, .. }) in column.series.iter().enumerate() {
        let mut from = 0;
        while from < values.len() {
            let length = values[from..].iter().take_while(|value| **value == limit).count();
            if length >= LEAST && from > 0 {
                found.push(Stretch { series, from, to: from + length });
            }
            from += length.max(1);
        }
    }
    found
}

/// Returns whether slow samples elsewhere have noise, so that a stretch at the limit is not chance.
fn has_no_noise(column: &Column<'_>, stretches: &[Stretch], grain: f64) -> bool {
    let Some(longest) = stretches.iter().map(|stretch| stretch.to - stretch.from).max() else { return false };
    let [low, high] = column.ends();
    let fives = || {
        let of = |series: &Series<'_>| series.values.windows(5).map(<[f64]>::to_vec).collect::<Vec<_>>();
        let fives = column.series.iter().flat_map(of);
        fives.filter(|five| five.iter().all(|value| value.is_finite() && *value != low && *value != high))
    };
    let bend = |five: &[f64], at: usize| five[at - 1] - 2.0 * five[at] + five[at + 1];
    let bends: Vec<f64> = fives().map(|five| bend(&five, 2)).collect();
    let Ok(noise) = robust_deviation(&bends).map(|deviation| deviation / 6.0_f64.sqrt()) else { return false };
    // Over four samples, noise alone makes a displacement with sqrt(2) standard deviations: within three of these,
    // the signal is as good as at rest.
    let slow: Vec<Vec<f64>> =
        fives().filter(|five| (five[4] - five[0]).abs() <= 3.0 * 2.0_f64.sqrt() * noise).collect();
    // 1e-5 of the range is the error of arithmetic and of printed digits.
    if noise < grain || noise < 1e-5 * (high - low) || slow.len() < 30 {
        return false;
    }
    let (mut square, mut product, mut repeats) = (0.0, 0.0, 0);
    for five in &slow {
        let [before, after] = [bend(five, 1), bend(five, 2)];
        square += 0.5 * (before * before + after * after);
        product += before * after;
        repeats += usize::from(five[2] == five[3]);
    }
    // Second differences of white noise have a correlation of -2/3; those of a smooth curve have a positive one.
    let is_white = product < -0.4 * square;
    let is_small = (square / slow.len() as f64 / 6.0).sqrt() < 0.3 * noise;
    let chance = (repeats.max(1) as f64 / slow.len() as f64).min(1.0);
    // Probability of the longest stretch if values repeat independently, times the number of places where it may
    // begin.
    let at_random = chance.powi(i32::try_from(longest - 1).unwrap_or(i32::MAX)) * column.finite().count() as f64;
    is_white && !is_small && at_random < 1e-3
}

/// Returns whether a third of the stretches, and at least one, is entered and left at speed.
fn is_left_at_speed(
    column: &Column<'_>,
    input: Option<&Column<'_>>,
    limit: f64,
    inwards: f64,
    stretches: &[Stretch],
    grain: f64,
) -> bool {
    let pairs =
        column.series.iter().flat_map(|series| series.values.windows(3).map(|three| (three[2] - three[0]).abs()));
    let mut steps: Vec<f64> = pairs.filter(|step| step.is_finite()).collect();
    steps.sort_by(f64::total_cmp);
    let Some(&fast) = steps.get(steps.len() * 19 / 20) else { return false };
    let least = f64::max(COUNTS * grain, AT_SPEED * fast);
    let is_steady = |place: &dyn Fn(usize) -> Option<usize>, values: &[f64]| {
        let way = |samples: usize| Some(inwards * (values.get(place(samples)?)? - limit));
        SPANS.iter().any(|&span| {
            let [Some(first), Some(one), Some(two)] = [way(1), way(span), way(2 * span)] else { return false };
            let most = MARGIN * (2 * span - 1) as f64 / (span - 1) as f64;
            first > 0.0 && one >= least && (1.4 * one..=most * one).contains(&two)
        })
    };
    let at_speed = stretches.iter().filter(|stretch| {
        let values = column.series[stretch.series].values;
        if stretch.to - stretch.from < LEAST_AT_SPEED {
            return false;
        }
        let is_entered = is_steady(&|samples| stretch.from.checked_sub(samples), values);
        is_entered && is_steady(&|samples| Some(stretch.to + samples - 1), values) && !follows(input, stretch)
    });
    let at_speed = at_speed.count();
    at_speed > 0 && 3 * at_speed >= stretches.len()
}

/// Returns whether the input changes or reverses just before the output leaves the limit.
fn follows(input: Option<&Column<'_>>, stretch: &Stretch) -> bool {
    let Some(input) = input else { return false };
    let [low, high] = input.ends();
    let Some(values) = input.series.get(stretch.series).map(|series| series.values) else { return false };
    let around = stretch.to.saturating_sub(JUST_BEFORE)..(stretch.to + 1).min(values.len());
    let is_change = |pair: &[f64]| {
        (pair[1] - pair[0]).abs() > CHANGE * (high - low) || (pair[0] * pair[1] <= 0.0 && pair[0] != pair[1])
    };
    values.get(around).is_some_and(|values| values.windows(2).any(is_change))
}
