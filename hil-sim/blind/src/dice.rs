//! Chance, by a seed.

use r4_plants::Effect;
use rand_distr::{Distribution, StandardNormal, StandardUniform};
use rand_pcg::Pcg64;

/// Where draws come from: the same seed and stream give the same draws.
#[derive(Clone, Debug)]
pub(crate) struct Dice(Pcg64);

impl Dice {
    /// `stream` tells apart what is drawn for different purposes.
    pub(crate) fn new(seed: u64, stream: u64) -> Self {
        Self(Pcg64::new(u128::from(seed), u128::from(stream)))
    }

    /// In `[0, 1)`.
    pub(crate) fn share(&mut self) -> f64 {
        StandardUniform.sample(&mut self.0)
    }

    /// Evenly between two numbers.
    pub(crate) fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.share()
    }

    /// Evenly between two positive numbers on a logarithmic scale.
    pub(crate) fn ratio_between(&mut self, low: f64, high: f64) -> f64 {
        low * libm::pow(high / low, self.share())
    }

    /// Below `count`.
    pub(crate) fn below(&mut self, count: usize) -> usize {
        ((self.share() * count as f64) as usize).min(count.saturating_sub(1))
    }

    /// 1 or -1.
    pub(crate) fn sign(&mut self) -> f64 {
        if self.share() < 0.5 { 1.0 } else { -1.0 }
    }

    /// An angle within a turn.
    pub(crate) fn angle(&mut self) -> f64 {
        self.between(-std::f64::consts::PI, std::f64::consts::PI)
    }

    /// Mean 0, deviation 1.
    pub(crate) fn normal(&mut self) -> f64 {
        StandardNormal.sample(&mut self.0)
    }
}

/// One way to draw an effect.
pub(crate) type Draw = fn(&mut Dice, &crate::scale::Scale) -> Effect;
