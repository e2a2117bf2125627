//! Step response of a loop: rise time, overshoot, settling time, steady error.

/// Characteristics of a step response.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Response {
    /// Rise time from 10 to 90 % of the step, s; `None` where the output never reaches 90 %.
    pub rise_s: Option<f64>,
    /// Overshoot beyond the target, as a share of the step; 0 for none.
    pub overshoot: f64,
    /// Settling time from the command until the error last leaves the band, s; `None` where it still does in the last
    /// tenth.
    pub settling_s: Option<f64>,
    /// Mean of output minus target over the last fifth, in the unit of the output.
    pub steady_error: f64,
}

/// Last share of a recording that counts as steady state.
const STEADY: f64 = 0.2;
/// Share of a recording by which it must have settled: a later settling time may be an artefact of its end.
const SETTLED_BY: f64 = 0.9;

impl Response {
    /// Evaluates `samples` (s since the command, output) of a step from `from` to `to`, with a band of ±`band` around
    /// `to`.
    ///
    /// `None` without samples or without a step.
    #[must_use]
    pub fn of(samples: &[(f64, f64)], from: f64, to: f64, band: f64) -> Option<Self> {
        let (begin_s, end_s) = (samples.first()?.0, samples.last()?.0);
        let step = to - from;
        if !step.is_finite() || step == 0.0 {
            return None;
        }
        let share = |output: f64| (output - from) / step;
        let reached = |level: f64| samples.iter().find(|sample| share(sample.1) >= level).map(|sample| sample.0);
        let rise_s = reached(0.1).zip(reached(0.9)).map(|(low_s, high_s)| high_s - low_s);
        let highest = samples.iter().map(|sample| share(sample.1)).fold(f64::MIN, f64::max);
        let last_outside = samples.iter().rposition(|sample| (sample.1 - to).abs() > band);
        let settling_s = match last_outside {
            None => Some(begin_s),
            Some(index) => samples.get(index + 1).map(|sample| sample.0),
        };
        let settling_s = settling_s.filter(|settling_s| *settling_s <= begin_s + SETTLED_BY * (end_s - begin_s));
        let steady: Vec<f64> = samples
            .iter()
            .filter(|sample| sample.0 >= end_s - STEADY * (end_s - begin_s))
            .map(|sample| sample.1 - to)
            .collect();
        let steady_error = steady.iter().sum::<f64>() / steady.len() as f64;
        Some(Self { rise_s, overshoot: (highest - 1.0).max(0.0), settling_s, steady_error })
    }

    /// Combines two responses to the same step: the worse of each number.
    #[must_use]
    pub fn worse(self, other: Self) -> Self {
        let longer = |a: Option<f64>, b: Option<f64>| a.zip(b).map(|(a, b)| a.max(b));
        let larger = if other.steady_error.abs() > self.steady_error.abs() { other } else { self };
        Self {
            rise_s: longer(self.rise_s, other.rise_s),
            overshoot: self.overshoot.max(other.overshoot),
            settling_s: longer(self.settling_s, other.settling_s),
            steady_error: larger.steady_error,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Step response of a second-order system from 2 to -1 with damping ratio `zeta` and natural frequency 10 rad/s.
    fn answer(zeta: f64) -> Vec<(f64, f64)> {
        const STEP_S: f64 = 1e-5;
        let (mut output, mut rate) = (0.0, 0.0);
        let mut samples = Vec::new();
        for step in 0..300_000 {
            if step % 100 == 0 {
                samples.push((f64::from(step) * STEP_S, 2.0 - 3.0 * output));
            }
            rate += (100.0 * (1.0 - output) - 20.0 * zeta * rate) * STEP_S;
            output += rate * STEP_S;
        }
        samples
    }

    #[test]
    fn a_known_answer_is_read_off() {
        let seen = Response::of(&answer(0.5), 2.0, -1.0, 0.06).expect("a step");
        // Closed forms: overshoot exp(-pi zeta / sqrt(1 - zeta²)); rise time (10 to 90 %) 1.639 / 10 s; 2 % settling
        // time 8.08 / 10 s from the exact response.
        assert!((seen.overshoot - 0.163).abs() < 0.002, "{seen:?}");
        assert!((seen.rise_s.expect("it rises") - 0.1639).abs() < 0.002, "{seen:?}");
        assert!((seen.settling_s.expect("it settles") - 0.808).abs() < 0.01, "{seen:?}");
        assert!(seen.steady_error.abs() < 1e-3, "{seen:?}");
        assert_eq!(Response::of(&answer(1.0), 2.0, -1.0, 0.06).expect("a step").overshoot, 0.0);
    }

    #[test]
    fn what_does_not_come_to_rest_does_not_settle() {
        let cut: Vec<_> = answer(0.5).into_iter().take_while(|sample| sample.0 < 0.3).collect();
        assert_eq!(Response::of(&cut, 2.0, -1.0, 0.06).expect("a step").settling_s, None);
        let short: Vec<_> = answer(0.5).into_iter().take_while(|sample| sample.0 < 0.1).collect();
        let seen = Response::of(&short, 2.0, -1.0, 0.06).expect("a step");
        assert_eq!((seen.rise_s, seen.settling_s), (None, None));
        assert_eq!(seen.worse(Response::of(&answer(0.5), 2.0, -1.0, 0.06).expect("a step")).settling_s, None);
        assert_eq!(Response::of(&[], 0.0, 1.0, 0.1), None);
        assert_eq!(Response::of(&cut, 1.0, 1.0, 0.1), None);
    }
}
