//! Search for the period of a sensor that holds its value (sample-and-hold): the recording has steps a period apart.

use super::{MotionRun, period::Search};

/// Number of periods that are offered.
const OFFERED: usize = 3;
/// Tolerance within which a step belongs to a sample, s.
const ALMOST_S: f64 = 1e-9;
/// Shortest and longest period, in samples, and the longest in s.
const SHORTEST: f64 = 2.0;
const LONGEST: f64 = 600.0;
const LONGEST_S: f64 = 0.6;

/// Changes of a recording from each sample to the next.
struct Changes {
    /// Times of the samples that end the changes, s since slots began.
    time_s: Vec<f64>,
    /// Magnitudes of the changes, relative to their mean.
    size: Vec<f64>,
}

impl Changes {
    fn of(run: &MotionRun) -> Self {
        let time_s = run.all.time_s.iter().map(|time_s| run.all.slots_s + time_s);
        let known = time_s.zip(&run.all.measured).filter(|(_, value)| value.is_finite());
        let (time_s, values): (Vec<f64>, Vec<f64>) = known.unzip();
        let mut size: Vec<f64> = values.windows(2).map(|pair| (pair[1] - pair[0]).abs()).collect();
        let mean = size.iter().sum::<f64>() / size.len().max(1) as f64;
        size.iter_mut().for_each(|size| *size -= mean);
        Self { time_s: time_s.into_iter().skip(1).collect(), size }
    }

    /// Returns the sum of the changes at which a slot of this length ends, and their number, up to a time; slots
    /// begin at 0.
    fn at_steps(&self, period_s: f64, until_s: f64) -> (f64, f64) {
        let (mut place, mut stride, mut sum, mut count) = (0, 0, 0.0, 0.0);
        let first_s = self.time_s.first().copied().unwrap_or(0.0);
        let mut next_s = period_s * (1.0 + ((first_s - ALMOST_S) / period_s).floor().max(0.0));
        while next_s < until_s {
            // The next step is about as many samples later as the last one.
            let from = place;
            place = (from + stride).min(self.time_s.len());
            while place > from && self.time_s[place - 1] + ALMOST_S >= next_s {
                place -= 1;
            }
            while self.time_s.get(place).is_some_and(|time_s| time_s + ALMOST_S < next_s) {
                place += 1;
            }
            let Some(time_s) = self.time_s.get(place) else { break };
            stride = place - from;
            sum += self.size[place];
            count += 1.0;
            next_s = (((time_s + ALMOST_S) / period_s).floor() + 1.0) * period_s;
            if next_s <= *time_s {
                // So late that adding a period does not change the number.
                break;
            }
        }
        (sum, count)
    }
}

/// Returns the periods at which recordings look most like sampled and held, s; best first.
///
/// A held value changes where a slot ends and is level within it, but for noise. Twice the period misses half of the
/// steps, half the period hits one only every other time: both stand out less from chance.
pub(super) fn periods(runs: &[MotionRun], sample_s: f64) -> Vec<f64> {
    let changes: Vec<Changes> = runs.iter().map(Changes::of).collect();
    let stands_out = |period_s: f64, stretch_s: f64| {
        let add = |(sum, count): (f64, f64), (one, ones): (f64, f64)| (sum + one, count + ones);
        let all = changes.iter().map(|changes| changes.at_steps(period_s, stretch_s));
        let (sum, count) = all.fold((0.0, 0.0), add);
        // Without the square root, a sum of random changes would grow with their number.
        sum / count.max(1.0).sqrt()
    };
    let from_s = runs.iter().map(|run| run.all.slots_s).fold(0.0, f64::max);
    let until_s = runs.iter().filter_map(|run| Some(run.all.slots_s + run.all.time_s.last()?)).fold(0.0, f64::max);
    Search {
        between_s: [SHORTEST * sample_s, LONGEST_S.min(LONGEST * sample_s)],
        from_s,
        until_s,
        // A step that is a sample late is not counted.
        noticed_s: |period_s: f64| period_s.min(sample_s),
        offered: OFFERED,
    }
    .best(stands_out)
}

#[cfg(test)]
mod tests {
    use rand_distr::{Distribution, Normal};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::data::{Quantity, Run, Signal};

    #[test]
    fn stairs_are_found_under_noise() {
        let noise = Normal::new(0.0, 0.03).expect("a deviation");
        for (seed, period_s) in [(1, 0.0173), (2, 0.0547), (3, 0.2163)] {
            let mut dice = Pcg64Mcg::new(seed);
            // Two recordings of 12 s at 200 Hz.
            let runs = [1.0, 2.0].map(|phase: f64| {
                let time_s: Vec<f64> = (0..2400).map(|n| 0.005 * f64::from(n)).collect();
                let place = |t: f64| (1.3 * t + phase).sin() + 0.4 * (7.1 * t).sin();
                let held = time_s.iter().map(|t| place((t / period_s).floor() * period_s));
                let output = held.map(|place| place + noise.sample(&mut dice)).collect();
                let signal = |quantity, values| Signal { column: String::new(), quantity, values };
                let signals = [
                    ("input".to_owned(), signal(Quantity::Number, vec![0.0; 2400])),
                    ("output".to_owned(), signal(Quantity::Angle, output)),
                ];
                MotionRun::new(&Run { name: String::new(), time_s, origin_s: None, signals: signals.into() }, 12.0)
                    .expect("a run")
            });
            let found = periods(&runs, 0.005)[0];
            // The last step is off by less than a sample.
            assert!((found / period_s - 1.0).abs() < 0.005 / 12.0, "{period_s}: {found}");
        }
    }

    #[test]
    fn a_pause_without_end_ends() {
        let changes = Changes { time_s: vec![0.01, 0.02, 1e17, 2e17], size: vec![1.0; 4] };
        assert_eq!(changes.at_steps(0.01, f64::INFINITY), (3.0, 3.0));
    }
}
