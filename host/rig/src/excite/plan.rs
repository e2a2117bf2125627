//! Duties over time that excite a motor's friction, inertia and nonlinearities.

use std::f64::consts::TAU;

/// Duties over time of one recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    parts: Vec<Part>,
    /// Duty that overcomes friction.
    low: f64,
    /// Largest duty of the plan.
    cap: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Part {
    duration_s: f64,
    shape: Shape,
}

/// Shape of a part. Numbers are shares of the duty beyond friction, negative backwards, unless stated otherwise.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Shape {
    Rest,
    Hold(f64),
    /// Triangle from zero to a share of the largest duty and back, forwards and then backwards.
    Ramp(f64),
    /// Four sines without a common period, up to the largest duty; the number shifts their phases.
    Sines(f64),
}

/// Number of recordings for the fit; one more, whose plan has this index, is held out.
pub const TRAIN: usize = 2;
/// Number of further recordings for the fit, whose plans follow: with long holds, for a motor whose parameters the
/// first ones do not determine. Eccentricity, torque ripple or position-dependent friction show over whole turns only.
pub const MORE: usize = 2;

/// Frequencies of the sines, Hz; none is a multiple of another.
const SINES_HZ: [f64; 4] = [0.31, 0.73, 1.37, 2.9];
/// Scale of the sum of four unit sines, which it seldom exceeds; the sum is clipped there.
const PEAK: f64 = 2.8;

/// Length of a plan before it is stretched, s.
const LENGTH_S: f64 = 12.0;

impl Plan {
    /// Creates the plan of recording number `index` with length `length_s`, up to a duty of `cap`, for a motor that
    /// starts to move at about `low`.
    #[must_use]
    pub fn new(index: usize, length_s: f64, low: f64, cap: f64) -> Self {
        use Shape::{Hold, Ramp, Rest, Sines};
        let parts: &[(f64, Shape)] = match index {
            // Holds for friction and gain, a ramp for the dead zone, sines for inertia and lags.
            0 => &[
                (0.3, Rest),
                (0.7, Hold(0.5)),
                (0.4, Rest),
                (0.7, Hold(-0.5)),
                (0.4, Rest),
                (0.7, Hold(1.0)),
                (0.7, Hold(-1.0)),
                (0.4, Rest),
                (3.4, Ramp(1.0)),
                (3.2, Sines(0.0)),
                (0.7, Hold(0.75)),
                (0.4, Rest),
            ],
            1 => &[
                (0.3, Rest),
                (3.0, Sines(1.0)),
                (0.3, Rest),
                (0.8, Hold(0.9)),
                (0.5, Hold(-0.7)),
                (0.3, Rest),
                (3.2, Ramp(-0.85)),
                (1.6, Hold(-0.95)),
                (0.4, Rest),
                (1.2, Hold(0.7)),
                (0.4, Rest),
            ],
            // The held-out plan has the same shapes in another order and with other sizes.
            TRAIN => &[
                (0.3, Rest),
                (0.9, Hold(-0.8)),
                (0.4, Rest),
                (0.9, Hold(0.6)),
                (0.5, Hold(-0.9)),
                (0.5, Hold(0.95)),
                (0.4, Rest),
                (4.0, Sines(2.0)),
                (2.6, Ramp(0.95)),
                (1.1, Hold(0.85)),
                (0.4, Rest),
            ],
            // Long holds of whole turns, for effects that depend on the position.
            3 => &[
                (0.3, Rest),
                (3.2, Hold(1.0)),
                (0.4, Rest),
                (3.2, Hold(-1.0)),
                (0.4, Rest),
                (2.0, Hold(0.6)),
                (2.1, Hold(-0.6)),
                (0.4, Rest),
            ],
            _ => &[
                (0.3, Rest),
                (2.6, Hold(-0.85)),
                (0.4, Rest),
                (2.6, Hold(0.85)),
                (2.0, Hold(-1.0)),
                (0.3, Rest),
                (3.4, Ramp(1.0)),
                (0.4, Rest),
            ],
        };
        let parts =
            parts.iter().map(|&(duration_s, shape)| Part { duration_s: duration_s * length_s / LENGTH_S, shape });
        Self { parts: parts.collect(), low: low.min(cap), cap }
    }

    /// Duration of the whole plan, s.
    #[must_use]
    pub fn length_s(&self) -> f64 {
        self.parts.iter().map(|part| part.duration_s).sum()
    }

    /// Part of the plan at `time_s` and its duty; `None` after the end.
    #[must_use]
    pub fn at(&self, time_s: f64) -> Option<(usize, f64)> {
        let mut begin_s = 0.0;
        for (place, part) in self.parts.iter().enumerate() {
            if time_s < begin_s + part.duration_s {
                let after_s = time_s - begin_s;
                return Some((place, self.duty(part, after_s)));
            }
            begin_s += part.duration_s;
        }
        None
    }

    fn duty(&self, part: &Part, after_s: f64) -> f64 {
        match part.shape {
            Shape::Rest => 0.0,
            Shape::Hold(share) => (self.low + share.abs() * (self.cap - self.low)).copysign(share),
            Shape::Ramp(share) => {
                let quarter = 4.0 * after_s / part.duration_s;
                let wave = match quarter {
                    quarter if quarter < 1.0 => quarter,
                    quarter if quarter < 3.0 => 2.0 - quarter,
                    quarter => quarter - 4.0,
                };
                share * self.cap * wave
            }
            Shape::Sines(turn) => {
                let sines = SINES_HZ.iter().zip(1_u8..);
                let sum: f64 =
                    sines.map(|(hz, number)| (TAU * hz * after_s + turn * f64::from(number * number)).sin()).sum();
                // Rare peaks are clipped, so that the usual amplitude comes close to the limit.
                self.cap * (sum / PEAK).clamp(-1.0, 1.0)
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_plan_keeps_to_the_duty_and_begins_and_ends_at_rest() {
        for index in 0..=TRAIN + MORE {
            let plan = Plan::new(index, 6.0, 0.3, 0.8);
            let times = || (0..6_000_u32).map(|step| f64::from(step) * 1e-3).filter(|time_s| *time_s < plan.length_s());
            let duties: Vec<f64> = times().filter_map(|time_s| Some(plan.at(time_s)?.1)).collect();
            assert!((plan.length_s() - 6.0).abs() < 0.25 && plan.at(plan.length_s() + 0.01).is_none());
            assert!(duties.iter().all(|duty| duty.abs() <= 0.8));
            let (low, high) =
                duties.iter().fold((0.0_f64, 0.0_f64), |(low, high), &duty| (low.min(duty), high.max(duty)));
            assert!(low < -0.7 && high > 0.7, "both ways");
            assert!(duties.first() == Some(&0.0) && duties.last() == Some(&0.0));
        }
    }

    #[test]
    fn no_two_recordings_are_alike() {
        let duties = |index| {
            let plan = Plan::new(index, 12.0, 0.3, 0.8);
            (0..1_000_u32).map(|step| plan.at(f64::from(step) * 0.01).map_or(0.0, |(_, duty)| duty)).collect::<Vec<_>>()
        };
        let all: Vec<_> = (0..=TRAIN + MORE).map(duties).collect();
        for (index, one) in all.iter().enumerate() {
            assert!(all[..index].iter().all(|other| other != one), "{index}");
        }
    }
}
