//! Metrics of a motor's response. All definitions are here; the paper prints none.
//!
//! | metric | definition |
//! | --- | --- |
//! | final value | mean over the last 0.3 s of a set point |
//! | error | final value less set point: by the board's sensor in counts, by the true position in deg or mm |
//! | overshoot | farthest beyond the set point by the sensor, until the next command, in % of the step |
//! | rise | from the command to the first sample at 99 % of the way from start to final value, by the sensor |
//! | steady-state error | mean of the true position over the hold, less the set point |
//! | limit cycles | of the hold: reversals of the sensed position, each of more than one count, halved |

use super::bench::Bench;

/// Window at a set point's end over which the final value is averaged, s.
const FINAL_S: f64 = 0.3;
/// Share of the way from start to final value at which the rise ends.
const RISEN: f64 = 0.99;

/// Sample of a motor at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Look {
    /// Time on the board's clock, s.
    pub at_s: f64,
    /// Position by the board's sensor, rad or m.
    pub sensed: f64,
    /// True position, rad or m.
    pub truth: f64,
    /// Duty at the bridge, -1 to 1.
    pub duty: f64,
}

/// Purpose of a move.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    /// A set point of Table 1 or 2.
    SetPoint,
    /// The last set point, held.
    Hold,
    /// The return to 0, of which nothing is measured.
    Return,
    /// The step of Tables 3 to 5.
    Step,
}

/// Time from one set point to the next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Segment {
    /// Purpose of the move.
    pub purpose: Purpose,
    /// Set point of the board, rad or m.
    pub set: f64,
    /// Start on the board's clock, s.
    pub from_s: f64,
    /// End on the board's clock, s.
    pub until_s: f64,
    /// True when the board, or the host's controller, reported that the motor settled.
    pub settled: bool,
}

/// Record of one motor in a session.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Response {
    /// Samples in the order of time.
    pub looks: Vec<Look>,
    /// Segments in the order of time.
    pub segments: Vec<Segment>,
    /// Cause of the board's stop, in words; `None` when it did not stop.
    pub stopped: Option<String>,
}

/// Metrics of a response, in the units of its bench.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Measured {
    /// Error of the true position at each set point, deg or mm, in their order; those after a stop are missing.
    pub true_errors: Vec<f64>,
    /// Largest error by the sensor over all set points, counts.
    pub counts: f64,
    /// Largest overshoot over all steps, %.
    pub overshoot_percent: f64,
    /// Rise time in the step of Tables 3 to 5, s; `None` without a step.
    pub rise_s: Option<f64>,
    /// Magnitude of the steady-state error, deg or mm; `None` without a hold.
    pub steady: Option<f64>,
    /// Limit cycles during the hold; `None` without a hold.
    pub limit_cycles: Option<f64>,
    /// True when every set point was reported as reached and the board did not stop.
    pub is_settled: bool,
}

fn mean(values: impl Iterator<Item = f64>) -> Option<f64> {
    let (sum, count) = values.fold((0.0, 0_u32), |(sum, count), value| (sum + value, count + 1));
    (count > 0).then(|| sum / f64::from(count))
}

impl Response {
    /// Samples of a segment.
    #[must_use]
    pub fn looks_of(&self, segment: &Segment) -> &[Look] {
        let at = |time_s: f64| self.looks.partition_point(|look| look.at_s < time_s);
        &self.looks[at(segment.from_s)..at(segment.until_s).max(at(segment.from_s))]
    }

    fn last(&self, segment: &Segment, of: impl Fn(&Look) -> f64) -> Option<f64> {
        let looks = self.looks_of(segment).iter().filter(|look| look.at_s >= segment.until_s - FINAL_S);
        mean(looks.map(of))
    }

    /// Computes all metrics. `set_true` converts a set point of the board into the requested true position.
    #[must_use]
    pub fn measured(&self, bench: &Bench, set_true: impl Fn(f64) -> f64) -> Measured {
        let mut found = Measured { is_settled: self.stopped.is_none(), ..Measured::default() };
        for segment in &self.segments {
            let looks = self.looks_of(segment);
            let Some(first) = looks.first() else { continue };
            let asked = set_true(segment.set);
            let is_step = matches!(segment.purpose, Purpose::SetPoint | Purpose::Step);
            if is_step {
                let way = segment.set - first.sensed;
                let beyond = looks.iter().map(|look| (look.sensed - segment.set) * way.signum()).fold(0.0, f64::max);
                found.overshoot_percent = found.overshoot_percent.max(100.0 * beyond / way.abs().max(bench.count));
                found.is_settled &= segment.settled;
            }
            match segment.purpose {
                Purpose::SetPoint => {
                    let error = self.last(segment, |look| look.truth).map(|end| (end - asked) * bench.per_si());
                    found.true_errors.extend(error);
                    let sensed = self.last(segment, |look| look.sensed).unwrap_or(f64::INFINITY);
                    // The board's resolution is a 32-bit float: a count is exact to a thousandth only.
                    let counts = ((sensed - segment.set).abs() / bench.count * 1e3).round() / 1e3;
                    found.counts = found.counts.max(counts);
                }
                Purpose::Step => found.rise_s = self.rise_s(segment),
                Purpose::Hold => {
                    let error = mean(looks.iter().map(|look| (look.truth - asked) * bench.per_si()));
                    found.steady = error.map(f64::abs);
                    let sensed: Vec<f64> = looks.iter().map(|look| look.sensed).collect();
                    found.limit_cycles = Some(limit_cycles(&sensed, bench.count));
                }
                Purpose::Return => {}
            }
        }
        found
    }

    fn rise_s(&self, segment: &Segment) -> Option<f64> {
        let looks = self.looks_of(segment);
        let (start, end) = (looks.first()?.sensed, self.last(segment, |look| look.sensed)?);
        let risen = |look: &&Look| (look.sensed - start) * (end - start).signum() >= RISEN * (end - start).abs();
        looks.iter().find(risen).map(|look| look.at_s - segment.from_s)
    }
}

/// Cycles of a position about its set point: reversals of more than `count`, halved.
fn limit_cycles(positions: &[f64], count: f64) -> f64 {
    // Slightly more than a count, so that one count to and fro is no cycle whatever its rounding.
    let least = 1.01 * count;
    let Some(&first) = positions.first() else { return 0.0 };
    let (mut low, mut high, mut direction, mut reversals) = (first, first, 0.0, 0_u32);
    for &position in positions {
        (low, high) = (low.min(position), high.max(position));
        if direction <= 0.0 && position - low > least {
            reversals += u32::from(direction < 0.0);
            (direction, high) = (1.0, position);
        } else if direction >= 0.0 && high - position > least {
            reversals += u32::from(direction > 0.0);
            (direction, low) = (-1.0, position);
        }
    }
    (f64::from(reversals) / 2.0).floor()
}

#[cfg(test)]
mod tests {
    use super::{super::bench::GEARED, *};

    /// Simulated response of the geared motor that approaches 90 degrees by `1 - exp(-t / 0.5 s)`, with a sine of some
    /// counts and a hump in degrees added.
    fn response(purpose: Purpose, swing_counts: f64, over_deg: f64) -> Response {
        let set = 90.0_f64.to_radians();
        let looks = (0..1000).map(|index| {
            let at_s = f64::from(index) * 0.01;
            let swing = swing_counts * GEARED.count * (std::f64::consts::TAU * at_s).sin();
            let hump = over_deg.to_radians() * (-((at_s - 3.0) / 0.2_f64).powi(2)).exp();
            let sensed = if purpose == Purpose::Hold { set } else { set * (1.0 - (-at_s / 0.5).exp()) } + swing + hump;
            Look { at_s, sensed, truth: sensed + 0.01, duty: 0.0 }
        });
        let segment = Segment { purpose, set, from_s: 0.0, until_s: 10.0, settled: true };
        Response { looks: looks.collect(), segments: vec![segment], stopped: None }
    }

    #[test]
    fn a_response_is_measured_as_it_is_defined() {
        let step = response(Purpose::Step, 0.0, 0.0).measured(&GEARED, |set| set);
        // 0.5 s ln 100 = 2.303 s, rounded up to the next sample of 10 ms.
        assert!(step.rise_s.is_some_and(|rise_s| (rise_s - 2.31).abs() < 1e-9), "{step:?}");
        assert_eq!(step.overshoot_percent, 0.0);
        let point = response(Purpose::SetPoint, 0.0, 9.0).measured(&GEARED, |set| set);
        // The hump is 10 % of the step; the exponential is 0.25 % below the set point at its peak.
        assert!((point.overshoot_percent - 9.75).abs() < 0.01, "{point:?}");
        assert!((point.true_errors[0] - 0.01_f64.to_degrees()).abs() < 1e-6 && point.counts < 1e-3, "{point:?}");
    }

    #[test]
    fn swings_of_more_than_a_count_are_limit_cycles() {
        let cycles = |counts| response(Purpose::Hold, counts, 0.0).measured(&GEARED, |set| set).limit_cycles;
        // Ten periods, each with a reversal after its peak and its trough.
        assert_eq!((cycles(0.5), cycles(2.0)), (Some(0.0), Some(10.0)));
        assert_eq!(limit_cycles(&[0.0, 1.0, 2.0, 3.0, 4.0], 1.0), 0.0, "a drift is none");
        assert_eq!(limit_cycles(&[], 1.0), 0.0);
    }
}
