//! Correlated random numbers.

use rand_distr::{Distribution, StandardNormal};
use rand_pcg::Pcg64;

use crate::parameter::Parameter;

/// Parameter for the correlation time of a noise.
pub(crate) const CORRELATION: Parameter = Parameter::new("correlation_s", "s").within(1e-6, 1e6).typical(0.1);

/// Gaussian process with autocorrelation `exp(-|t| / correlation)` (Ornstein-Uhlenbeck), stepped exactly: its
/// statistics do not depend on the steps.
///
/// # Source
/// Gillespie, *Exact numerical simulation of the Ornstein-Uhlenbeck process and its integral*, Phys. Rev. E 54 (1996).
#[derive(Clone, Debug)]
pub(crate) struct Noise {
    deviation: f64,
    correlation_s: f64,
    value: f64,
    generator: Pcg64,
    step_s: f64,
    kept: f64,
    fresh: f64,
}

impl Noise {
    pub(crate) fn new(deviation: f64, correlation_s: f64, seed: u64, stream: usize) -> Self {
        let mut generator = Pcg64::new(u128::from(seed), stream as u128);
        let start: f64 = StandardNormal.sample(&mut generator);
        Self { deviation, correlation_s, value: deviation * start, generator, step_s: 0.0, kept: 1.0, fresh: 0.0 }
    }

    pub(crate) fn value(&self) -> f64 {
        self.value
    }

    /// Advances by `step_s` and returns the new value.
    pub(crate) fn next(&mut self, step_s: f64) -> f64 {
        if step_s != self.step_s {
            self.step_s = step_s;
            self.kept = libm::exp(-step_s / self.correlation_s);
            self.fresh = self.deviation * libm::sqrt(-libm::expm1(-2.0 * step_s / self.correlation_s));
        }
        let draw: f64 = StandardNormal.sample(&mut self.generator);
        self.value = self.kept * self.value + self.fresh * draw;
        self.value
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn deviation_and_correlation_are_as_asked_whatever_the_step() {
        for step_s in [0.002, 0.02] {
            let mut noise = Noise::new(3.0, 0.1, 7, 0);
            let values: Vec<f64> = (0..400_000).map(|_| noise.next(step_s)).collect();
            let mean_square = |pairs: &mut dyn Iterator<Item = (f64, f64)>| {
                let (sum, count) = pairs.fold((0.0, 0), |(sum, count), (a, b)| (sum + a * b, count + 1));
                sum / f64::from(count)
            };
            let lag = (0.1 / step_s).round() as usize;
            let variance = mean_square(&mut values.iter().map(|v| (*v, *v)));
            let covariance = mean_square(&mut values.iter().zip(&values[lag..]).map(|(a, b)| (*a, *b)));
            // 800 s are at least 4000 independent draws (two correlation times each): 2.3 % deviation of the variance;
            // 4 of those
            assert!((variance / 9.0 - 1.0).abs() < 0.09, "{step_s}: {variance}");
            assert!((covariance / 9.0 - (-1.0f64).exp()).abs() < 0.09, "{step_s}: {covariance}");
        }
    }

    #[test]
    fn streams_and_seeds_differ_and_repeat() {
        let first = |seed, stream| Noise::new(1.0, 1.0, seed, stream).next(0.5);
        assert_eq!(first(1, 0), first(1, 0));
        assert_ne!(first(1, 0), first(2, 0));
        assert_ne!(first(1, 0), first(1, 1));
    }
}
