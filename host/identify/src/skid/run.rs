//! Run prepared for the skid-steer model: the speeds of both sides, and the motion of the body.

use std::{f64::consts::TAU, ops::Range, sync::Arc};

use r4_maths::statistics::{QuantileRule, quantile};

use super::{Geometry, Output, SkidError};
use crate::data::{Quantity, Run, Signal};

/// Samples of the speeds of both sides.
#[derive(Debug)]
pub(super) struct Sides {
    pub(super) time_s: Vec<f64>,
    /// Speeds of the left side, rad/s; gaps are interpolated, and no value that touches one is compared.
    pub(super) left: Vec<f64>,
    pub(super) right: Vec<f64>,
    /// Median sampling period, s.
    pub(super) period_s: f64,
}

/// One run. Each measured value is a mean over a span of samples; spans of a gyro are single samples.
#[derive(Clone, Debug)]
pub struct SkidRun {
    pub(super) name: String,
    pub(super) sides: Arc<Sides>,
    /// Samples over which each measured value is the mean, in order and disjoint, except that the spans of a pose
    /// share their end samples.
    pub(super) spans: Vec<Range<usize>>,
    pub(super) time_s: Vec<f64>,
    pub(super) measured: Vec<f64>,
    /// Index of the first simulated sample.
    pub(super) from: usize,
    /// Initial output of a model with memory: the first measured value. `None` if means of long spans are compared,
    /// of which the first would reveal the answer; the run then begins in the steady state of its first input.
    pub(super) start: Option<f64>,
}

impl SkidRun {
    pub(super) fn new(
        geometry: &Geometry,
        output: Output,
        average_s: Option<f64>,
        run: &Run,
    ) -> Result<Self, SkidError> {
        let read = Reader { run, geometry };
        let len = run.time_s.len();
        if len < 3 {
            return Err(SkidError::TooShort { run: run.name.clone(), found: len });
        }
        let mut left = read.side("left")?;
        let mut right = read.side("right")?;
        // Noted before the gaps are bridged: no value in them is compared.
        let unknown: Vec<bool> = left.iter().zip(&right).map(|(l, r)| !l.is_finite() || !r.is_finite()).collect();
        let known = bridge(&run.time_s, &mut left) && bridge(&run.time_s, &mut right);
        let nothing = || SkidError::NothingMeasured { run: run.name.clone() };
        if !known {
            return Err(nothing());
        }
        let (spans, mut measured) = read.body(output, average_s)?;
        if let (Some(average_s), true) = (average_s, spans.is_empty()) {
            let duration_s = run.time_s[len - 1] - run.time_s[0];
            return Err(SkidError::TooShortToAverage { run: run.name.clone(), duration_s, average_s });
        }
        for (span, value) in spans.iter().zip(&mut measured) {
            if unknown[span.clone()].contains(&true) {
                *value = f64::NAN;
            }
        }
        if !measured.iter().any(|value| value.is_finite()) {
            return Err(nothing());
        }
        let time_s = spans.iter().map(|span| 0.5 * (run.time_s[span.start] + run.time_s[span.end - 1])).collect();
        let sides = Sides { period_s: period(&run.time_s), time_s: run.time_s.clone(), left, right };
        let whole =
            Self { name: run.name.clone(), sides: Arc::new(sides), spans, time_s, measured, from: 0, start: None };
        Ok(if average_s.is_some() { whole } else { whole.started() })
    }

    fn started(mut self) -> Self {
        self.from = self.spans.first().map_or(0, |span| span.start);
        self.start = self.measured.iter().take(5).copied().find(|value| value.is_finite());
        self
    }

    pub(super) fn part(&self, from: usize, to: usize) -> Self {
        let to = to.min(self.spans.len());
        let from = from.min(to);
        let part = Self {
            name: self.name.clone(),
            sides: Arc::clone(&self.sides),
            spans: self.spans[from..to].to_vec(),
            time_s: self.time_s[from..to].to_vec(),
            measured: self.measured[from..to].to_vec(),
            from: self.from,
            start: self.start,
        };
        if self.start.is_some() { part.started() } else { part }
    }
}

/// Returns the median sampling period, s.
fn period(time_s: &[f64]) -> f64 {
    let steps: Vec<f64> = time_s.windows(2).map(|pair| pair[1] - pair[0]).collect();
    quantile(&steps, 0.5, QuantileRule::NearestPosition).unwrap_or(1.0)
}

/// Interpolates missing values linearly; returns false if all are missing.
fn bridge(time_s: &[f64], values: &mut [f64]) -> bool {
    let Some(first) = values.iter().position(|value| value.is_finite()) else { return false };
    let start = values[first];
    values[..first].fill(start);
    let mut last = first;
    for at in first + 1..values.len() {
        if values[at].is_finite() {
            let slope = (values[at] - values[last]) / (time_s[at] - time_s[last]);
            for between in last + 1..at {
                values[between] = values[last] + slope * (time_s[between] - time_s[last]);
            }
            last = at;
        }
    }
    let end = values[last];
    values[last..].fill(end);
    true
}

type Spans = (Vec<Range<usize>>, Vec<f64>);

struct Reader<'r> {
    run: &'r Run,
    geometry: &'r Geometry,
}

impl Reader<'_> {
    fn signal(&self, role: &'static str) -> Result<Option<&Signal>, SkidError> {
        let Some(signal) = self.run.signals.get(role) else { return Ok(None) };
        let (expected, found) = (self.run.time_s.len(), signal.values.len());
        if expected != found {
            return Err(SkidError::Length { run: self.run.name.clone(), role, expected, found });
        }
        Ok(Some(signal))
    }

    fn no_unit(&self, signal: &Signal, role: &'static str, units: &'static str) -> SkidError {
        SkidError::Unit { run: self.run.name.clone(), column: signal.column.clone(), role, units }
    }

    /// Returns the speeds of a side's wheels, rad/s; `None` if the role has no column.
    fn wheels(&self, role: &'static str) -> Result<Option<Vec<f64>>, SkidError> {
        let Some(signal) = self.signal(role)? else { return Ok(None) };
        match signal.quantity {
            Quantity::AngularSpeed => Ok(Some(signal.values.clone())),
            Quantity::Speed => {
                Ok(Some(signal.values.iter().map(|speed| speed / self.geometry.wheel_radius_m).collect()))
            }
            _ => Err(self.no_unit(signal, role, "rad/s or m/s (`_rad_s`, `_m_s`)")),
        }
    }

    fn side(&self, role: &'static str) -> Result<Vec<f64>, SkidError> {
        let advice = "map the speed of that side's wheels, or its command, as in `--map left=wheel_left_rad_s`";
        self.wheels(role)?.ok_or_else(|| SkidError::NoRole { run: self.run.name.clone(), role, advice })
    }

    fn in_unit(
        &self,
        role: &'static str,
        quantity: Quantity,
        units: &'static str,
    ) -> Result<Option<&[f64]>, SkidError> {
        match self.signal(role)? {
            Some(signal) if signal.quantity == quantity => Ok(Some(&signal.values)),
            Some(signal) => Err(self.no_unit(signal, role, units)),
            None => Ok(None),
        }
    }

    fn yaw(&self) -> Result<Option<Vec<f64>>, SkidError> {
        Ok(self.in_unit("yaw", Quantity::Angle, "rad or degrees (`_rad`, `_deg`)")?.map(unwrapped))
    }

    /// Returns the motion of the body: spans of samples, and the mean of the output over each.
    fn body(&self, output: Output, average_s: Option<f64>) -> Result<Spans, SkidError> {
        match output {
            Output::YawRate => self.yaw_rate(average_s),
            Output::ForwardSpeed | Output::LateralSpeed => self.along(output, average_s),
        }
    }

    /// Returns the yaw rate from the gyro, the yaw angle, or the wheels if these are not the input. Means of long
    /// spans come from the yaw angle if there is one: its ends give the mean without drift.
    fn yaw_rate(&self, average_s: Option<f64>) -> Result<Spans, SkidError> {
        let gyro = self.in_unit("gyro", Quantity::AngularSpeed, "rad/s (`_rad_s`, `_deg_s`)")?;
        let time_s = &self.run.time_s;
        match (gyro, self.yaw()?, average_s) {
            (Some(gyro), None, Some(average_s)) => Ok(means(time_s, average_s, gyro)),
            (Some(gyro), _, None) => Ok(samples(gyro)),
            (_, Some(yaw), average_s) => {
                let spans = self.pose_spans(&yaw, average_s);
                let rates = spans.iter().map(|span| rise(time_s, &yaw, span)).collect();
                Ok((spans, rates))
            }
            (None, None, average_s) => {
                let (Some(left), Some(right)) = (self.wheels("wheel_left")?, self.wheels("wheel_right")?) else {
                    let advice = "the model needs the body's motion; map the gyro, or the yaw angle, or with commands as \
                                  `left` and `right` the wheels' speeds as `wheel_left` and `wheel_right`";
                    return Err(SkidError::NoRole { run: self.run.name.clone(), role: "gyro", advice });
                };
                let turn: Vec<f64> =
                    left.iter().zip(&right).map(|(&left, &right)| self.geometry.turn(left, right)).collect();
                Ok(average_s.map_or_else(|| samples(&turn), |average_s| means(time_s, average_s, &turn)))
            }
        }
    }

    /// Returns the speed along or across the body, from the steps of the pose.
    fn along(&self, output: Output, average_s: Option<f64>) -> Result<Spans, SkidError> {
        let advice = "speed along and across the body needs `x`, `y` and `yaw`";
        let missing = |role| SkidError::NoRole { run: self.run.name.clone(), role, advice };
        let length = |role| self.in_unit(role, Quantity::Length, "m (`_m`)");
        let (x, y) = (length("x")?.ok_or_else(|| missing("x"))?, length("y")?.ok_or_else(|| missing("y"))?);
        let yaw = self.yaw()?.ok_or_else(|| missing("yaw"))?;
        let time_s = &self.run.time_s;
        let moved = |span: &Range<usize>| {
            let steps = span.clone().zip(span.start + 1..span.end).map(|(a, b)| {
                // The chord of a step has the direction at its middle.
                let (sin, cos) = (0.5 * (yaw[a] + yaw[b])).sin_cos();
                let (dx, dy) = (x[b] - x[a], y[b] - y[a]);
                if output == Output::ForwardSpeed { cos * dx + sin * dy } else { cos * dy - sin * dx }
            });
            steps.sum::<f64>() / (time_s[span.end - 1] - time_s[span.start])
        };
        let spans = self.pose_spans(x, average_s);
        let speeds = spans.iter().map(moved).collect();
        Ok((spans, speeds))
    }

    /// Returns spans of the requested length, or as long as a pose is held.
    fn pose_spans(&self, pose: &[f64], average_s: Option<f64>) -> Vec<Range<usize>> {
        match average_s {
            Some(average_s) => spans(&self.run.time_s, average_s),
            None => held_spans(pose),
        }
    }
}

fn samples(values: &[f64]) -> Spans {
    ((0..values.len()).map(|at| at..at + 1).collect(), values.to_vec())
}

fn means(time_s: &[f64], average_s: f64, values: &[f64]) -> Spans {
    let spans = spans(time_s, average_s);
    let means = spans.iter().map(|span| values[span.clone()].iter().sum::<f64>() / span.len() as f64).collect();
    (spans, means)
}

/// Returns successive spans of a length; one that samples cover by less than three quarters is left out.
fn spans(time_s: &[f64], average_s: f64) -> Vec<Range<usize>> {
    let period_s = period(time_s);
    // Stamps are not exact: half a period of tolerance.
    let of = |at: usize| ((time_s[at] - time_s[0] + 0.5 * period_s) / average_s).floor();
    let mut spans = Vec::new();
    let mut start = 0;
    for end in 1..=time_s.len() {
        if end == time_s.len() || of(end) > of(start) {
            if end - start > 1 && time_s[end - 1] - time_s[start] + period_s >= 0.75 * average_s {
                spans.push(start..end);
            }
            start = end;
        }
    }
    spans
}

/// Returns spans from new value to new value of a pose that is held between (zero-order hold); both end samples
/// belong to each.
fn held_spans(pose: &[f64]) -> Vec<Range<usize>> {
    let changes = pose.windows(2).filter(|pair| pair[0] != pair[1]).count();
    // Longer repetitions than four samples mean that the robot stands still.
    let hold = (pose.len() - 1).checked_div(changes).map_or(1, |hold| hold.clamp(1, 4));
    (0..(pose.len() - 1) / hold).map(|at| at * hold..(at + 1) * hold + 1).collect()
}

/// Returns the rise over time of a span; NaN if an end is missing.
fn rise(time_s: &[f64], values: &[f64], span: &Range<usize>) -> f64 {
    let (first, last) = (span.start, span.end - 1);
    (values[last] - values[first]) / (time_s[last] - time_s[first])
}

/// Returns the angle without its jumps by a turn.
fn unwrapped(yaw: &[f64]) -> Vec<f64> {
    let mut before = f64::NAN;
    let mut turns = 0.0;
    let unwrap = |&yaw: &f64| {
        if yaw.is_finite() {
            if before.is_finite() {
                turns -= ((yaw - before) / TAU).round();
            }
            before = yaw;
        }
        yaw + turns * TAU
    };
    yaw.iter().map(unwrap).collect()
}
