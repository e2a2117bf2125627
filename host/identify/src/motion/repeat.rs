//! How often along its way what a model of an axis lacks repeats itself: a gear, a screw, a belt whose pitch nobody told.

use std::f64::consts::TAU;

use r4_plants::Dependence;

use crate::family::{Acts, Structure};

use super::{
    Motion, MotionRun,
    curve::{ROUND, with},
    simulate::Moved,
    weak::{SHORTEST_S, Seen},
};

/// Times that it has to repeat itself over the longest way, at least and at most.
const LEAST: f64 = 2.0;
const MOST: f64 = 300.0;
/// Neighbours among the numbers of times that are tried: a wave that is off by so much is a quarter off at the end.
const APART: f64 = 0.25;
/// A search closer by has so many steps on each side, twice.
const CLOSER: i32 = 10;
/// A wave that explains less than this share of what is left is not looked at closer.
const SHARE: f64 = 0.2;
/// The share of one time by which periods differ that are tried in the end, and how often closer by.
const NEARER: f64 = 0.1;
const REFINED: usize = 3;

/// A recording, where a wave over its way would show.
struct Carrier {
    seen: Seen,
    /// What a curve of ones would do, from each sample to the next.
    one: Vec<f64>,
    left: Vec<f64>,
}

impl Carrier {
    fn positions(&self) -> impl Iterator<Item = f64> {
        self.seen.windows.moved.iter().map(|moved| moved.position)
    }

    fn reach(&self) -> f64 {
        let (low, high) =
            self.positions().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), at| (l.min(at), h.max(at)));
        high - low
    }

    /// How much of what is left a wave explains, whatever its phase.
    fn explained(&self, rate: f64) -> f64 {
        let waves: Vec<(f64, f64)> = self.positions().map(|at| (rate * at).sin_cos()).collect();
        let [sine, cosine] = [|wave: &(f64, f64)| wave.0, |wave: &(f64, f64)| wave.1].map(|of| {
            let series: Vec<f64> = waves.iter().zip(&self.one).map(|(wave, one)| of(wave) * one).collect();
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

impl Motion {
    /// The way after which a curve over the position would best repeat itself; `None` where nothing is seen of that.
    pub(super) fn repeats(&self, structure: &Structure, acts: Acts, runs: &[&MotionRun]) -> Option<f64> {
        let (fit, seen, left) = self.left_in_windows(structure, runs)?;
        let ones = self.curve(Dependence::Position, None, acts, vec![0.0]);
        let mut bent = with(&fit.structure, &ones);
        bent.added.last_mut()?.fill(ones.scale);
        let carriers = seen.into_iter().zip(left).zip(&fit.initial).map(|((seen, left), initial)| {
            let [straight, bent] =
                [&fit.structure, &bent].map(|structure| seen.accelerations(self, structure, initial));
            let one = bent.iter().zip(straight).map(|(bent, straight)| (bent - straight) / ones.scale).collect();
            Carrier { seen, one, left }
        });
        let carriers: Vec<Carrier> = carriers.collect();
        let reach = carriers.iter().map(Carrier::reach).fold(0.0, f64::max);
        // A wave that passes within a window is not seen in it.
        let moved = || carriers.iter().flat_map(|carrier| &carrier.seen.windows.moved);
        let speed = moved().map(|Moved { speed, .. }| speed.abs()).sum::<f64>() / moved().count() as f64;
        let most = (reach / (2.0 * SHORTEST_S * speed)).min(MOST);
        if !most.is_finite() || most < LEAST {
            return None;
        }
        let explained = |times: f64| carriers.iter().map(|carrier| carrier.explained(TAU * times / reach)).sum::<f64>();
        let best = |all: &mut dyn Iterator<Item = f64>| {
            all.map(|times| (explained(times), times)).max_by(|a, b| a.0.total_cmp(&b.0)).map(|best| best.1)
        };
        let count = ((most - LEAST) / APART) as u32;
        let mut times = best(&mut (0..=count).map(|step| LEAST + APART * f64::from(step)))?;
        let mut apart = APART;
        for _ in 0..2 {
            apart /= f64::from(CLOSER);
            times = best(&mut (-CLOSER..=CLOSER).map(|step| times + apart * f64::from(step)))?;
        }
        // The rest of the model was not fitted with it: now both are.
        let all: f64 = carriers.iter().flat_map(|carrier| &carrier.left).map(|left| left * left).sum();
        if explained(times) < SHARE * all {
            return None;
        }
        let (mut period, mut apart) = (reach / times, NEARER / times);
        for _ in 0..REFINED {
            let left_over = |step: i32| {
                let period = period * (1.0 + apart * f64::from(step));
                let left = self.left_over_windows(with(structure, &self.round(acts, period, ROUND[0])), runs);
                (left.unwrap_or(f64::INFINITY), period)
            };
            period = (-3..=3).map(left_over).min_by(|a, b| a.0.total_cmp(&b.0)).map_or(period, |best| best.1);
            apart /= 4.0;
        }
        Some(period)
    }
}

#[cfg(test)]
mod tests {
    use rand_distr::{Distribution, Normal};
    use rand_pcg::Pcg64Mcg;

    use super::*;
    use crate::{
        data::{Quantity, Run, Signal},
        motion::{Kind, Known},
    };

    /// A mass of 2 kg with 3 N s/m on a way that is given, under the force that it takes where the drive is stronger and
    /// weaker over the way.
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
        Run { name: seed.to_string(), time_s, signals: signals.into() }
    }

    #[test]
    fn a_pitch_that_nobody_told_is_found() {
        for rate in [3.0, 11.0] {
            let runs = [1, 2].map(|seed| rippled(seed, rate));
            let (model, runs, _) = Motion::new(Kind::Axis, &Known::default(), &runs, &[]).expect("a model");
            let structure = Structure { base: vec![2.0, 3.0], ..Structure::default() };
            let found = model.repeats(&structure, Acts::Gain, &runs.iter().collect::<Vec<_>>()).expect("a period");
            // A wave of this rate is off by less than a tenth of its length at the end of 5 m.
            assert!((found - TAU / rate).abs() < 0.1 * (TAU / rate).powi(2) / 5.0, "{rate}: {found}");
        }
    }
}
