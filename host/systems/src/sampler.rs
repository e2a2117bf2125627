//! Random numbers by seed, for what a scene does not declare.

use rand_distr::{Distribution, StandardNormal, StandardUniform};
use rand_pcg::Pcg64;

/// Source of random numbers: the same seed and purpose give the same numbers.
#[derive(Clone, Debug)]
pub struct Sampler(Pcg64);

impl Sampler {
    /// Numbers of `purpose`, which sets apart what one seed decides.
    #[must_use]
    pub fn new(seed: u64, purpose: u64) -> Self {
        Self(Pcg64::new(u128::from(seed), u128::from(purpose)))
    }

    /// Uniform between two numbers.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        let share: f64 = StandardUniform.sample(&mut self.0);
        low + (high - low) * share
    }

    /// Uniform between two positive numbers on a logarithmic scale.
    pub fn log_uniform(&mut self, low: f64, high: f64) -> f64 {
        self.uniform(low.ln(), high.ln()).exp()
    }

    /// Normal, of mean 0.
    pub fn normal(&mut self, deviation: f64) -> f64 {
        let number: f64 = StandardNormal.sample(&mut self.0);
        deviation * number
    }
}
