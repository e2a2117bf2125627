//! Comparison of two sensors of one quantity: sign, scale, offset and lag of one against the other.
//!
//! Neither signal is differentiated sample by sample. Both are averaged over the same smooth windows (modulating
//! functions): the average of a derivative over a window is exactly a weighted sum of the differences of its
//! integral, and noise falls with the window's length. The averages of the second signal are then regressed on those
//! of the first, with the lag as a shift of the windows, so that it need not be a whole number of samples.

use std::{
    f64::consts::{PI, TAU},
    fmt,
};

use nalgebra::{DMatrix, DVector};

use super::{Quantity, Run, clean::quantile};

/// Relation of a second signal to a first.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Relation {
    /// Both measure the same quantity.
    Same,
    /// The second signal is the rate of the first.
    Derivative,
}

impl Relation {
    /// Returns the relation of two quantities; `None` if they are not comparable.
    #[must_use]
    pub const fn of(first: Quantity, second: Quantity) -> Option<Self> {
        match (first, second) {
            (Quantity::Angle, Quantity::AngularSpeed) | (Quantity::Length, Quantity::Speed) => Some(Self::Derivative),
            (Quantity::Angle, Quantity::Angle)
            | (Quantity::AngularSpeed, Quantity::AngularSpeed)
            | (Quantity::Length, Quantity::Length)
            | (Quantity::Speed, Quantity::Speed)
            | (Quantity::Current | Quantity::Torque, Quantity::Current)
            | (Quantity::Torque, Quantity::Torque) => Some(Self::Same),
            _ => None,
        }
    }
}

/// Estimated number with its standard error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Measured {
    /// Value at the best fit.
    pub value: f64,
    /// Standard error of the value.
    pub std: f64,
}

/// Result of a comparison: `second = scale * first(t - lag) + offset`, or with the rate of the first signal.
#[derive(Clone, Debug, PartialEq)]
pub struct Comparison {
    /// Column of the first signal.
    pub first: String,
    /// Column of the second signal.
    pub second: String,
    /// Relation of the second signal to the first.
    pub relation: Relation,
    /// SI unit of the second signal.
    pub unit: &'static str,
    /// Scale, 1 if both are right. Its standard error includes the attenuation of the regression by noise on the
    /// first signal.
    pub scale: Measured,
    /// Offset of the second signal, in `unit`.
    pub offset: Measured,
    /// Lag of the second signal, s; positive if it is late.
    pub lag_s: Measured,
    /// Correlation at the best lag, -1..=1.
    pub correlation: f64,
    /// Product of the two signals' own motion (see `MOTION`): the least variance that they share if they are one
    /// quantity.
    pub motion: f64,
    /// Median sampling period, s.
    pub period_s: f64,
}

/// Largest lag that is searched, s.
const LONGEST_LAG_S: f64 = 0.5;
/// Length of the shortest window, in samples and in s, whichever is longer. Six samples resolve a window's shape; 50
/// ms keep motion up to 20 Hz.
const SHORTEST_SAMPLES: f64 = 6.0;
const SHORTEST_S: f64 = 0.05;
/// Number of window lengths, each twice the one before; that with the smallest standard error of the scale is used.
const DOUBLED: i32 = 5;
/// Smallest number of windows: four numbers are fitted to them.
const FEWEST: usize = 12;
/// Deviation of the scale from 1 that is not reported: gears, wheels and resistors have tolerances of this magnitude.
const TRIFLE: f64 = 0.02;
/// Standard errors between a number and its expected value that make a finding. With two, one good recording in
/// twenty would be flagged.
const SURE: f64 = 4.0;
/// Prior standard deviation of the second moment of a sensor's low-pass filter, which attenuates fast motion, s²:
/// that of two 35 ms first-order filters.
const FILTER_S2: f64 = 2.5e-3;
/// Autocorrelation of a signal's non-overlapping windows above which it moves, so that what they share is not noise.
const MOTION: f64 = 0.3;
/// Smallest ratio of the squared correlation of two signals to the product of their own autocorrelations at which
/// they are one quantity. Speeds of two different motors reach 0.53.
const UNRELATED: f64 = 0.5;

/// Wrong units that occur, with the factor between the second and the first signal.
const UNITS: [(f64, &str); 6] = [
    (PI / 180.0, "degrees for radians"),
    (180.0 / PI, "degrees for radians"),
    (60.0 / TAU, "revolutions per minute for rad/s"),
    (TAU, "turns for radians"),
    (1e3, "millimetres for metres"),
    (1e2, "centimetres for metres"),
];
/// Relative distance of a scale from a wrong unit's factor within which that unit is named.
const NEAR_UNIT: f64 = 0.05;

impl Comparison {
    fn unit_error(&self) -> Option<&'static str> {
        let size = self.scale.value.abs();
        let near = |factor: f64| (size / factor - 1.0).abs() < NEAR_UNIT.max(SURE * self.scale.std / size).min(0.2);
        UNITS.iter().find(|(factor, _)| near(*factor) || near(1.0 / factor)).map(|(_, what)| *what)
    }

    /// Returns whether the signals have enough common motion for the numbers to be meaningful.
    #[must_use]
    pub fn is_known(&self) -> bool {
        self.scale.std < 0.2 * self.scale.value.abs()
    }

    /// Returns whether both signals move, but not together.
    #[must_use]
    pub fn is_unrelated(&self) -> bool {
        self.correlation.powi(2) < UNRELATED * self.motion
    }

    /// Returns whether the second signal is late or early by more than half a sampling period.
    #[must_use]
    pub fn has_lag(&self) -> bool {
        self.is_known() && self.lag_s.value.abs() > 0.5 * self.period_s + SURE * self.lag_s.std
    }

    /// Describes an error of sign, scale or unit, and what to do next; `None` without one.
    #[must_use]
    pub fn finding(&self) -> Option<String> {
        let (first, second) = (self.against(), &self.second);
        if self.is_unrelated() {
            return Some(format!(
                "`{second}` does not follow {first} at any lag up to {LONGEST_LAG_S} s (correlation {:.2}): check which columns are mapped",
                self.correlation
            ));
        }
        let Measured { value, std } = self.scale;
        if !self.is_known() || (value > 0.0 && (value - 1.0).abs() <= TRIFLE.max(SURE * std)) {
            return None;
        }
        let next = match (value < 0.0, self.unit_error()) {
            (true, Some(unit)) => format!("wrong sign, and {unit}: correct the sign and the unit of one of them"),
            (true, None) => "wrong sign: reverse one of them, or exchange the sensor's wires".to_owned(),
            (false, Some(unit)) => format!("{unit}: correct the unit in the name of one of the columns"),
            (false, None) => "check gear ratio, counts per turn and calibration of both".to_owned(),
        };
        Some(format!("`{second}` is {value:.4} ± {std:.2} times {first}; {next}", std = Digits(std)))
    }

    fn against(&self) -> String {
        match self.relation {
            Relation::Same => format!("`{}`", self.first),
            Relation::Derivative => format!("the derivative of `{}`", self.first),
        }
    }
}

/// Number printed with two digits, without an exponent where that is short.
struct Digits(f64);

impl fmt::Display for Digits {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        let size = self.0.abs();
        if (1e-4..1e4).contains(&size) {
            let places = (1.0 - size.log10().floor()).clamp(0.0, 6.0) as usize;
            write!(out, "{:.places$}", self.0)
        } else if size == 0.0 {
            out.write_str("0")
        } else {
            write!(out, "{:.1e}", self.0)
        }
    }
}

impl fmt::Display for Comparison {
    fn fmt(&self, out: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(out, "`{}` against {}: ", self.second, self.against())?;
        if self.is_unrelated() {
            return write!(out, "not related (correlation {:.2})", self.correlation);
        }
        if !self.is_known() {
            return out.write_str("too little motion in common to compare them");
        }
        let error = match (self.finding(), self.unit_error()) {
            (Some(_), Some(unit)) => format!(" ({unit}?)"),
            _ => String::new(),
        };
        let lag =
            if self.has_lag() { format!(", {:.1} samples", self.lag_s.value / self.period_s) } else { String::new() };
        write!(
            out,
            "scale {:.4} ± {}{error}, offset {} ± {} {}, lag {:.1} ± {} ms{lag}",
            self.scale.value,
            Digits(self.scale.std),
            Digits(self.offset.value),
            Digits(self.offset.std),
            self.unit,
            1e3 * self.lag_s.value,
            Digits(1e3 * self.lag_s.std),
        )
    }
}

/// Two signals of one run, as means from each sample to the next.
struct Pair {
    time_s: Vec<f64>,
    /// Means of the first signal, or of its rate; NaN across gaps, missing values and jumps of a wrapped angle.
    first: Vec<f64>,
    second: Vec<f64>,
}

impl Pair {
    fn of(run: &Run, first: &str, second: &str, relation: Relation) -> Option<Self> {
        let (first, second) = (run.values(first)?, run.values(second)?);
        let time_s = run.time_s.clone();
        if time_s.len() < 3 || first.len() != time_s.len() || second.len() != time_s.len() {
            return None;
        }
        let steps: Vec<f64> = time_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
        // Longer steps are gaps, over which a mean says nothing.
        let longest_s = 5.0 * finite_quantile(&steps, 0.5)?;
        // A wrapped angle, whatever its unit, jumps by most of its range between two samples; no motion does.
        let all = || first.iter().copied().filter(|value| value.is_finite());
        let reach = all().fold(f64::NEG_INFINITY, f64::max) - all().fold(f64::INFINITY, f64::min);
        let is_sound = |at: usize, jump: f64| steps[at] > 0.0 && steps[at] <= longest_s && jump.abs() <= 0.6 * reach;
        let between = |values: &[f64], relation, is_sound: &dyn Fn(usize, f64) -> bool| -> Vec<f64> {
            let one = |(at, pair): (usize, &[f64])| match relation {
                _ if !is_sound(at, pair[1] - pair[0]) => f64::NAN,
                Relation::Same => 0.5 * (pair[0] + pair[1]),
                Relation::Derivative => (pair[1] - pair[0]) / steps[at],
            };
            values.windows(2).enumerate().map(one).collect()
        };
        // Only an angle wraps; a large step of a speed is real.
        let first = match relation {
            Relation::Derivative => between(first, relation, &is_sound),
            Relation::Same => between(first, relation, &|at, jump| is_sound(at, 0.0) && jump.is_finite()),
        };
        let second = between(second, Relation::Same, &|at, jump| is_sound(at, 0.0) && jump.is_finite());
        Some(Self { time_s, first, second })
    }

    /// Returns the mean of `values` under a cosine window; `None` if it reaches beyond the run or over missing
    /// values.
    fn mean(&self, values: &[f64], centre_s: f64, width_s: f64) -> Option<f64> {
        let (from_s, to_s) = (centre_s - 0.5 * width_s, centre_s + 0.5 * width_s);
        if from_s < *self.time_s.first()? || to_s > *self.time_s.last()? {
            return None;
        }
        // Area of the window's weight up to a time, of 1 in all.
        let area = |time_s: f64| {
            let x = ((time_s - centre_s) / width_s).clamp(-0.5, 0.5);
            x + (TAU * x).sin() / TAU
        };
        let start = self.time_s.partition_point(|&time_s| time_s <= from_s).saturating_sub(1);
        let mut sum = 0.0;
        let mut before = area(self.time_s[start]);
        for (time_s, value) in self.time_s[start + 1..].iter().zip(&values[start..]) {
            let now = area(*time_s);
            sum += value * (now - before);
            before = now;
            if *time_s >= to_s {
                break;
            }
        }
        sum.is_finite().then_some(sum)
    }

    fn centres(&self, width_s: f64) -> impl Iterator<Item = f64> + use<> {
        let (start_s, end_s) = (self.time_s[0], self.time_s[self.time_s.len() - 1]);
        let count = ((end_s - start_s) / (0.5 * width_s)).clamp(0.0, 1e6) as usize;
        // Windows overlap by half, so that every sample has the same weight.
        (1..count).map(move |at| start_s + 0.5 * width_s * at as f64)
    }
}

fn finite_quantile(values: &[f64], share: f64) -> Option<f64> {
    let finite: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    quantile(&finite, share)
}

/// Compares two roles over `runs`; `None` if fewer than twelve windows have both, or one signal does not move.
#[must_use]
pub fn compare(runs: &[&Run], first: &str, second: &str, relation: Relation) -> Option<Comparison> {
    let pairs: Vec<Pair> = runs.iter().filter_map(|run| Pair::of(run, first, second, relation)).collect();
    let steps: Vec<f64> = pairs.iter().flat_map(|pair| pair.time_s.windows(2).map(|pair| pair[1] - pair[0])).collect();
    let period_s = finite_quantile(&steps, 0.5).filter(|period_s| *period_s > 0.0)?;
    let longest_s = pairs.iter().map(|pair| pair.time_s[pair.time_s.len() - 1] - pair.time_s[0]).fold(0.0, f64::max);
    let shortest_s = f64::max(SHORTEST_SAMPLES * period_s, SHORTEST_S);
    let widths: Vec<f64> = (0..DOUBLED)
        .map(|times| shortest_s * 2_f64.powi(times))
        .filter(|width_s| *width_s <= 0.25 * longest_s)
        .collect();
    // The shortest windows in which motion exceeds noise have the sharpest peak of the correlation.
    let most_s = LONGEST_LAG_S.min(0.25 * longest_s);
    let (lag_s, correlation, motion) =
        widths.iter().skip(1).chain(widths.first()).find_map(|&width_s| best_lag(&pairs, width_s, most_s))?;
    let names = |role: &str| runs.iter().find_map(|run| run.signals.get(role)).map(|signal| signal.column.clone());
    let unit = runs.iter().find_map(|run| run.signals.get(second)).map_or("", |signal| signal.quantity.si());
    let mut fits: Vec<Fit> = widths.iter().filter_map(|&width_s| Fit::of(&pairs, width_s, lag_s)).collect();
    // If windows of two lengths disagree, noise or filter violate the regression's assumptions: the standard error
    // grows.
    for at in (1..fits.len()).rev() {
        let apart = 0.5 * (fits[at].scale.value - fits[at - 1].scale.value);
        let std = fits[at].scale.std;
        fits[at - 1].scale.std = fits[at - 1].scale.std.hypot(apart.abs().min(2.0 * fits[at - 1].scale.std.max(std)));
    }
    // Short windows have more noise, long ones less motion: the relative error decides.
    let error = |fit: &Fit| (fit.scale.std / fit.scale.value).abs();
    let fit = fits.into_iter().min_by(|a, b| error(a).total_cmp(&error(b)))?;
    Some(Comparison {
        first: names(first)?,
        second: names(second)?,
        relation,
        unit,
        scale: fit.scale,
        offset: fit.offset,
        lag_s: fit.lag_s,
        correlation: if fit.correlation.abs() > correlation.abs() { fit.correlation } else { correlation },
        motion,
        period_s,
    })
}

/// Searches the lag with the best correlation of the windows' means. Returns lag (s), correlation and common motion;
/// `None` if either signal is noise or constant.
fn best_lag(pairs: &[Pair], width_s: f64, longest_s: f64) -> Option<(f64, f64, f64)> {
    // Fine enough for the peak of a correlation that is as wide as a window.
    let step_s = width_s / 8.0;
    let reach = (longest_s / step_s).floor() as i32;
    let second = |pair: &Pair| -> Vec<(f64, f64)> {
        let mean = |centre_s: f64| Some((centre_s, pair.mean(&pair.second, centre_s, width_s)?));
        pair.centres(width_s).filter_map(mean).collect()
    };
    let seconds: Vec<Vec<(f64, f64)>> = pairs.iter().map(second).collect();
    let at = |lag_s: f64| -> Vec<(f64, f64)> {
        let both = |pair: &Pair, (centre_s, second): (f64, f64)| {
            Some((pair.mean(&pair.first, centre_s - lag_s, width_s)?, second))
        };
        let of = |(pair, second): (_, &Vec<(f64, f64)>)| {
            second.iter().filter_map(|one| both(pair, *one)).collect::<Vec<_>>()
        };
        pairs.iter().zip(&seconds).flat_map(of).collect()
    };
    let now = at(0.0);
    let motion = |series: Vec<f64>| {
        let mean = series.iter().sum::<f64>() / series.len() as f64;
        let square: f64 = series.iter().map(|value| (value - mean).powi(2)).sum();
        // Windows two places apart do not overlap.
        let product: f64 = series.windows(3).map(|three| (three[0] - mean) * (three[2] - mean)).sum();
        if square > 0.0 { product / square } else { 0.0 }
    };
    let (first, second) = now.iter().copied().unzip();
    let (first, second) = (motion(first), motion(second));
    if now.len() < FEWEST || first < MOTION || second < MOTION {
        return None;
    }
    let lags: Vec<(f64, f64)> = (-reach..=reach)
        .filter_map(|place| {
            let lag_s = f64::from(place) * step_s;
            let both = at(lag_s);
            // A lag with few common windows may correlate by chance.
            (2 * both.len() >= now.len()).then(|| (lag_s, correlation(&both)))
        })
        .collect();
    let most = lags.iter().map(|(_, correlation)| correlation.powi(2)).fold(0.0, f64::max);
    // Several lags of a periodic motion fit equally well: the shortest is the most likely.
    let enough = 1.0 - 1.5 * (1.0 - most) - 0.01;
    let mut good: Vec<(f64, f64)> = lags.into_iter().filter(|(_, correlation)| correlation.powi(2) >= enough).collect();
    good.sort_by(|a, b| a.0.abs().total_cmp(&b.0.abs()));
    good.first().map(|&(lag_s, correlation)| (lag_s, correlation, first * second))
}

fn correlation(both: &[(f64, f64)]) -> f64 {
    let count = both.len().max(1) as f64;
    let (x, y) = both.iter().fold((0.0, 0.0), |(x, y), one| (x + one.0 / count, y + one.1 / count));
    let sums = both.iter().fold((0.0, 0.0, 0.0), |(xx, yy, xy), one| {
        let (dx, dy) = (one.0 - x, one.1 - y);
        (xx + dx * dx, yy + dy * dy, xy + dx * dy)
    });
    let size = (sums.0 * sums.1).sqrt();
    if size > 0.0 { sums.2 / size } else { 0.0 }
}

/// Regression of the second signal's windows on those of the first.
struct Fit {
    scale: Measured,
    offset: Measured,
    lag_s: Measured,
    correlation: f64,
}

/// Number of steps that refine the lag.
const ROUNDS: usize = 6;
/// Number of windows over which the error may be correlated.
const APART: usize = 4;

impl Fit {
    fn of(pairs: &[Pair], width_s: f64, start_s: f64) -> Option<Self> {
        let mut lag_s = start_s;
        let mut found = None;
        for _ in 0..ROUNDS {
            let (fit, step_s) = Self::at(pairs, width_s, lag_s)?;
            lag_s = (lag_s + step_s.clamp(-0.25 * width_s, 0.25 * width_s))
                .clamp(-1.2 * LONGEST_LAG_S, 1.2 * LONGEST_LAG_S);
            found = Some(Self { lag_s: Measured { value: lag_s, ..fit.lag_s }, ..fit });
        }
        found
    }

    /// Fits with the windows of the first signal shifted by `lag_s`. Returns the fit and the remaining lag, s.
    ///
    /// Regressors are the windows' means and their first and second derivative with respect to the lag. Delay and
    /// filter of a sensor are the first terms of the series of its transfer function, so the scale is that of slow
    /// motion, whatever filter the sensor has.
    fn at(pairs: &[Pair], width_s: f64, lag_s: f64) -> Option<(Self, f64)> {
        let shift_s = width_s / 8.0;
        let mut rows: Vec<[f64; 4]> = Vec::new();
        for pair in pairs {
            let row = |centre_s: f64| {
                let first = |shift_s: f64| pair.mean(&pair.first, centre_s - lag_s - shift_s, width_s);
                let (before, now, after) = (first(-shift_s)?, first(0.0)?, first(shift_s)?);
                let slope = (after - before) / (2.0 * shift_s);
                let bend = (after - 2.0 * now + before) / shift_s.powi(2);
                Some([now, slope, bend, pair.mean(&pair.second, centre_s, width_s)?])
            };
            rows.extend(pair.centres(width_s).filter_map(row));
        }
        if rows.len() < FEWEST {
            return None;
        }
        let count = rows.len() as f64;
        let mut means = [0.0; 4];
        rows.iter().for_each(|row| means.iter_mut().zip(row).for_each(|(mean, value)| *mean += value / count));
        let x = DMatrix::from_fn(rows.len(), 3, |row, column| rows[row][column] - means[column]);
        let y = DVector::from_fn(rows.len(), |row, _| rows[row][3] - means[3]);
        let both: Vec<(f64, f64)> = rows.iter().map(|row| (row[0], row[3])).collect();
        let correlation = correlation(&both);
        let total = y.norm_squared();
        let plain = x.column(0).dot(&y) / x.column(0).norm_squared();
        if !plain.is_finite() || plain == 0.0 || total <= 0.0 {
            return None;
        }
        // The prior of the filter's moment counts as one more observation, with the noise of a fit without it.
        let noise = (total * (1.0 - correlation.powi(2)).max(1e-9) / count).max(f64::MIN_POSITIVE);
        let mut normal = x.transpose() * &x;
        normal[(2, 2)] += noise / (plain * FILTER_S2).powi(2);
        let inverse = normal.try_inverse()?;
        let solution = &inverse * x.transpose() * &y;
        let residual = &y - &x * &solution;
        let variance = residual.norm_squared() / (count - 4.0);
        let inflation = inflation(residual.as_slice());
        let covariance = |place: usize| (variance * inflation * inverse[(place, place)]).max(0.0);
        let scale = solution[0];
        if scale == 0.0 || !scale.is_finite() {
            return None;
        }
        // Noise on the first signal lowers the scale of a regression (attenuation), noise on the second does not: the
        // truth lies between the regression and the inverse regression. Their geometric mean is reported, and half
        // their distance counts as two standard errors.
        let t_square = scale.powi(2) / (variance * inverse[(0, 0)]).max(f64::MIN_POSITIVE);
        let share = t_square / (t_square + count - 4.0);
        let lopsided = 0.25 * scale.abs() * (1.0 / share - 1.0);
        let scale = Measured { value: scale / share.sqrt(), std: (covariance(0) + lopsided.powi(2)).sqrt() };
        let offset = means[3] - scale.value * means[0];
        let offset_std = (variance * inflation / count + (means[0] * scale.std).powi(2)).sqrt();
        let step_s = solution[1] / scale.value;
        let lag_s = Measured { value: lag_s, std: (covariance(1) / scale.value.powi(2)).sqrt() };
        let all = [scale.value, scale.std, offset, offset_std, step_s, lag_s.std];
        let fit = Self { scale, offset: Measured { value: offset, std: offset_std }, lag_s, correlation };
        all.iter().all(|value| value.is_finite()).then_some((fit, step_s))
    }
}

/// Returns the factor by which correlation of the residuals raises the variance of a mean (Bartlett weights, as of
/// Newey and West).
fn inflation(residual: &[f64]) -> f64 {
    let square: f64 = residual.iter().map(|value| value * value).sum();
    let product = |lag: usize| residual.iter().zip(residual.iter().skip(lag)).map(|(a, b)| a * b).sum::<f64>();
    if square <= 0.0 {
        return 1.0;
    }
    let weighted = |lag: usize| (1.0 - lag as f64 / (APART + 1) as f64) * product(lag) / square;
    (1.0 + 2.0 * (1..=APART).map(weighted).sum::<f64>()).max(1.0)
}

#[cfg(test)]
mod tests;
