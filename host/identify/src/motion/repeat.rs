//! Search for the travel after which a missing effect repeats: of a gear, a screw, or a belt with unknown pitch.

use std::f64::consts::TAU;

use nalgebra::Complex;
use r4_plants::Dependence;

use crate::{family::Acts, fit::Fit};

use super::{
    Motion, MotionRun,
    curve::{ROUND, with},
    simulate::Moved,
    weak::{Rest, SHORTEST_S, Seen},
};

/// Smallest and largest number of repetitions over the longest travel.
const LEAST: f64 = 2.0;
const MOST: f64 = 300.0;
/// Distance of the numbers of repetitions that are tried: between two, a wave is off by a quarter at the end.
const APART: f64 = 0.5;
/// Number of steps on each side in a finer search, which is done twice.
const CLOSER: u32 = 10;
/// Smallest share of the residual that a wave must explain to be refined.
const SHARE: f64 = 0.2;
/// Relative distance of the periods in the last refinement, and the number of its refinements.
const NEARER: f64 = 0.1;
const REFINED: i32 = 3;
/// Number of periods tried on each side of the best one in each round, and the largest number of rounds.
const BESIDE: i32 = 3;
const ROUNDS: usize = 8;

/// Recording in which a wave over the travel is searched for.
struct Carrier {
    seen: Seen,
    /// Acceleration by a curve of ones from each sample to the next, for each way in which it acts.
    ones: Vec<Vec<f64>>,
    left: Vec<f64>,
}

/// Numbers of repetitions: the first, their distance, and their count.
type Times = (f64, f64, u32);

impl Carrier {
    fn positions(&self) -> impl Iterator<Item = f64> {
        self.seen.windows.moved.iter().map(|moved| moved.position)
    }

    fn reach(&self) -> f64 {
        let (low, high) =
            self.positions().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), at| (l.min(at), h.max(at)));
        high - low
    }

    /// Returns a complex wave over the position at each sample.
    fn waves(&self, rate: f64) -> Vec<Complex<f64>> {
        self.positions().map(|at| Complex::cis(rate * at)).collect()
    }

    /// Returns the reduction of the sum of squares by a wave that acts on `one`, with optimal amplitude and phase.
    fn explained(&self, waves: &[Complex<f64>], one: &[f64]) -> f64 {
        let [sine, cosine] = [|wave: &Complex<f64>| wave.im, |wave: &Complex<f64>| wave.re].map(|of| {
            let series: Vec<f64> = waves.iter().zip(one).map(|(wave, one)| of(wave) * one).collect();
            self.seen.windows.sums(&series).collect::<Vec<f64>>()
        });
        let product = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let (ss, sc, cc) = (product(&sine, &sine), product(&sine, &cosine), product(&cosine, &cosine));
        let (sl, cl) = (product(&sine, &self.left), product(&cosine, &self.left));
        let determinant = ss * cc - sc * sc;
        if determinant <= 1e-9 * ss * cc {
            return 0.0;
        }
        (cc * sl * sl - 2.0 * sc * sl * cl + ss * cl * cl) / determinant
    }
}

/// Returns, for each of some ways to act, the number of repetitions whose wave explains most, and the reduction of
/// the sum of squares.
fn best(carriers: &[Carrier], ways: &[usize], reach: f64, (first, apart, count): Times) -> Vec<(f64, f64)> {
    let mut explained = vec![vec![0.0; ways.len()]; count as usize];
    for carrier in carriers {
        let rate = |times: f64| TAU * times / reach;
        let (mut waves, turns) = (carrier.waves(rate(first)), carrier.waves(rate(apart)));
        for explained in &mut explained {
            for (explained, &way) in explained.iter_mut().zip(ways) {
                *explained += carrier.explained(&waves, &carrier.ones[way]);
            }
            waves.iter_mut().zip(&turns).for_each(|(wave, turn)| *wave *= turn);
        }
    }
    let all = |way: usize| explained.iter().enumerate().map(move |(step, of)| (of[way], step as f64));
    let best = |way| all(way).max_by(|a, b| a.0.total_cmp(&b.0));
    (0..ways.len()).filter_map(best).map(|(explained, step)| (first + apart * step, explained)).collect()
}

impl Motion {
    /// Returns the travel after which a curve over the position best repeats, for each way in which it may act;
    /// `None` if no repetition is visible.
    pub(super) fn repeats(&self, current: &Fit, acts: &[Acts], runs: &[&MotionRun]) -> Vec<Option<f64>> {
        let nothing = vec![None; acts.len()];
        let Some(carriers) = self.carriers(current, acts, runs) else { return nothing };
        let reach = carriers.iter().map(Carrier::reach).fold(0.0, f64::max);
        // A wave that passes within a window averages out in it.
        let moved = || carriers.iter().flat_map(|carrier| &carrier.seen.windows.moved);
        let speed = moved().map(|Moved { speed, .. }| speed.abs()).sum::<f64>() / moved().count() as f64;
        // A wave must take at least as long as the shortest window.
        let most = (reach / (2.0 * SHORTEST_S * speed)).min(MOST);
        if !most.is_finite() || most < LEAST {
            return nothing;
        }
        let all: f64 = carriers.iter().flat_map(|carrier| &carrier.left).map(|left| left * left).sum();
        let ways: Vec<usize> = (0..acts.len()).collect();
        let count = ((most - LEAST) / APART) as u32 + 1;
        let found = best(&carriers, &ways, reach, (LEAST, APART, count));
        let closer = |(way, (mut times, mut explained)): (usize, (f64, f64))| {
            let mut apart = APART;
            for _ in 0..2 {
                apart /= f64::from(CLOSER);
                let around = (times - apart * f64::from(CLOSER), apart, 2 * CLOSER + 1);
                (times, explained) = *best(&carriers, &[way], reach, around).first()?;
            }
            (explained >= SHARE * all).then(|| self.nearer(current, acts[way], reach / times, NEARER / times, runs))
        };
        found.into_iter().enumerate().map(closer).collect()
    }

    fn carriers(&self, current: &Fit, acts: &[Acts], runs: &[&MotionRun]) -> Option<Vec<Carrier>> {
        let Rest { fit, seen, left, .. } =
            self.shows_curves(current).then(|| self.left_in_windows(current, runs))??;
        let carrier = |((seen, left), initial): ((Seen, Vec<f64>), &Vec<f64>)| {
            let straight = seen.accelerations(self, &fit.structure, initial);
            let ones = |&acts: &Acts| {
                let ones = self.curve(Dependence::Position, None, acts, vec![0.0]);
                let mut bent = with(&fit.structure, &ones);
                bent.added.last_mut().into_iter().flatten().for_each(|value| *value = ones.scale);
                let bent = seen.accelerations(self, &bent, initial);
                bent.iter().zip(&straight).map(|(bent, straight)| (bent - straight) / ones.scale).collect()
            };
            Carrier { ones: acts.iter().map(ones).collect(), seen, left }
        };
        Some(seen.into_iter().zip(left).zip(&fit.initial).map(carrier).collect())
    }

    /// Refines a period: the best of those around it when the rest of the model is fitted with the wave, which the
    /// first search does not do.
    fn nearer(&self, current: &Fit, acts: Acts, mut period: f64, mut apart: f64, runs: &[&MotionRun]) -> f64 {
        let finest = apart / 4.0_f64.powi(REFINED);
        for _ in 0..ROUNDS {
            let left_over = |step: i32| {
                let period = period * (1.0 + apart * f64::from(step));
                let structure = with(&current.structure, &self.round(acts, period, ROUND[0]));
                (self.left_over_windows(structure, current, runs).unwrap_or(f64::INFINITY), step, period)
            };
            let Some((_, step, best)) = (-BESIDE..=BESIDE).map(left_over).min_by(|a, b| a.0.total_cmp(&b.0)) else {
                break;
            };
            period = best;
            // If the outermost is the best, a better one may lie beyond it.
            if step.abs() < BESIDE {
                apart /= 4.0;
            }
            if apart <= finest {
                break;
            }
        }
        period
    }
}

#[cfg(test)]
mod tests {
    use rand_distr::{Distribution, Normal};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::{
        data::{Quantity, Run, Signal},
        family::Structure,
        fit::guessed,
        motion::{Kind, Known},
    };

    /// Mass of 2 kg with 3 N s/m on a given trajectory, under the force it needs if the gain of the drive varies with
    /// the position.
    fn rippled(seed: u64, rate: f64) -> Run {
        let mut dice = Pcg64Mcg::new(seed.into());
        let noise = Normal::new(0.0, 1e-3).expect("a deviation");
        let phase = seed as f64;
        let time_s: Vec<f64> = (0..2400).map(|n| 0.005 * f64::from(n)).collect();
        let waves = [(2.0, 0.9), (0.5, 2.3), (0.2, 4.1)];
        let sum = |of: &dyn Fn(f64, f64) -> f64| waves.iter().map(|&(size, rate)| of(size, rate)).sum::<f64>();
        let place = |t: f64| sum(&|size, rate| size * (rate * t + phase).sin());
        let force = |t: f64| {
            let speed = sum(&|size, rate| size * rate * (rate * t + phase).cos());
            let acceleration = sum(&|size, rate| -size * rate * rate * (rate * t + phase).sin());
            (2.0 * acceleration + 3.0 * speed) / (1.0 + 0.5 * (rate * place(t) + 0.7).sin())
        };
        let signal = |column: &str, quantity, values| Signal { column: column.to_owned(), quantity, values };
        // A force holds from its sample to the next.
        let input = time_s.iter().map(|t| force(t + 0.0025)).collect();
        let output = time_s.iter().map(|&t| place(t) + noise.sample(&mut dice)).collect();
        let signals = [
            ("input".to_owned(), signal("force_n", Quantity::Force, input)),
            ("output".to_owned(), signal("x_m", Quantity::Length, output)),
        ];
        Run { name: seed.to_string(), time_s, origin_s: None, signals: signals.into() }
    }

    #[test]
    fn a_pitch_that_nobody_told_is_found() {
        for rate in [3.0, 11.0] {
            let runs = [1, 2].map(|seed| rippled(seed, rate));
            let (model, runs, _) = Motion::new(Kind::Axis, &Known::default(), &runs, &[]).expect("a model");
            let runs: Vec<&MotionRun> = runs.iter().collect();
            let structure = Structure { base: vec![2.0, 3.0, 0.0], ..Structure::default() };
            let current = Fit::at(&model, &runs, structure, guessed(&model, &runs));
            let found = model.repeats(&current, &[Acts::Gain], &runs)[0].expect("a period");
            // A wave of this rate is off by less than a tenth of its length at the end of 5 m.
            assert!((found - TAU / rate).abs() < 0.1 * (TAU / rate).powi(2) / 5.0, "{rate}: {found}");
        }
    }
}
