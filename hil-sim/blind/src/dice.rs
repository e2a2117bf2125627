//! Pseudo-random numbers from a seed.

use r4_plants::Effect;
use rand_distr::{Distribution, StandardNormal, StandardUniform};
use rand_pcg::Pcg64;

/// Source of random numbers: the same seed and stream give the same sequence.
#[derive(Clone, Debug)]
pub(crate) struct Dice(Pcg64);

impl Dice {
    /// Creates the source; `stream` separates sequences for different purposes.
    pub(crate) fn new(seed: u64, stream: u64) -> Self {
        Self(Pcg64::new(u128::from(seed), u128::from(stream)))
    }

    /// Samples uniformly from `[0, 1)`.
    pub(crate) fn share(&mut self) -> f64 {
        StandardUniform.sample(&mut self.0)
    }

    /// Samples uniformly between two numbers.
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.share()
    }

    /// Samples log-uniformly between two positive numbers.
    pub(crate) fn ratio_between(&mut self, low: f64, high: f64) -> f64 {
        low * libm::pow(high / low, self.share())
    }

    /// Samples an integer below `count`, uniformly.
    pub(crate) fn below(&mut self, count: usize) -> usize {
        ((self.share() * count as f64) as usize).min(count.saturating_sub(1))
    }

    /// Samples 1 or -1, with equal probability.
    pub(crate) fn sign(&mut self) -> f64 {
        if self.share() < 0.5 { 1.0 } else { -1.0 }
    }

    /// Samples an angle uniformly from -π to π, rad.
    pub(crate) fn angle(&mut self) -> f64 {
        self.between(-std::f64::consts::PI, std::f64::consts::PI)
    }

    /// Samples from the standard normal distribution.
    pub(crate) fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }
}

/// Function that samples an effect for a plant of a given scale.
pub(crate) type Draw = fn(&mut Dice, &crate::scale::Scale) -> Effect;
