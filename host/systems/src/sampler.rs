//! Random numbers sampled from a seed, for quantities that a scene file does not declare.

use rand_distr::{Distribution, StandardNormal, StandardUniform};
use rand_pcg::Pcg64;

/// Source of random numbers: the same seed and purpose give the same sequence.
#[derive(Clone, Debug)]
pub struct Sampler(Pcg64);

impl Sampler {
    /// Starts the sequence of a seed and a purpose; the purpose separates independent quantities of one seed.
    #[must_use]
    pub fn new(seed: u64, purpose: u64) -> Self {
        Self(Pcg64::new(u128::from(seed), u128::from(purpose)))
    }

    /// Sample of the uniform distribution between two numbers.
    pub fn uniform(&mut self, low: f64, high: f64) -> f64 {
        let share: f64 = StandardUniform.sample(&mut self.0);
        low + (high - low) * share
    }

    /// Sample of the log-uniform distribution between two positive numbers.
    pub fn log_uniform(&mut self, low: f64, high: f64) -> f64 {
        self.uniform(low.ln(), high.ln()).exp()
    }

    /// Sample of the normal distribution with mean 0 and standard deviation `deviation`.
    pub fn normal(&mut self, deviation: f64) -> f64 {
        let number: f64 = StandardNormal.sample(&mut self.0);
        deviation * number
    }
}
