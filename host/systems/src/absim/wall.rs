//! Model of the coordinator's compute time in simulated time.

use super::mission::Work;
use crate::sampler::Sampler;

/// Factors printed in the paper: nominal factor, and simulated seconds per second of wall time.
pub const PRINTED: [(f64, f64); 2] = [(10.0, 2.87), (15.0, 14.18)];

/// Compute time of a cell's update in the creation of goals, and of a bid in their allocation, s. Declared: with these,
/// 27.6 % of the simulated time of the median trial of seeds 1 to 30 is compute time, the share that follows from the
/// paper's 2.87 at 10. Half of both give 16 %.
const UPDATE_S: f64 = 6e-4;
const BID_S: f64 = 1.6e-2;
/// Standard deviation of the logarithm of a compute time measured on the wall. Declared: 10 % from run to run.
const JITTER: f64 = 0.1;
/// Time for which simulated time still runs at the nominal factor after the coordinator requested 1, s on the wall: a
/// topic's message and a period of the simulator's clock. Declared.
const SLOWS_AFTER_S: f64 = 0.05;

/// Share of simulated time that ran at 1, from the achieved and the nominal factor: `1 / achieved = share + (1 - share)
/// / nominal`.
#[must_use]
pub fn share_at_1(nominal: f64, achieved: f64) -> f64 {
    (1.0 / achieved - 1.0 / nominal) / (1.0 - 1.0 / nominal)
}

/// Factor achieved with a nominal one when this share of simulated time runs at 1.
#[must_use]
pub fn achieved(nominal: f64, share: f64) -> f64 {
    1.0 / (share + (1.0 - share) / nominal)
}

/// Source of the compute time.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Charging {
    /// No compute time is charged.
    Free,
    /// Counted operations, charged on the event clock, without a wall clock.
    Declared,
    /// Measured on the wall while simulated time runs on: at 1 if `slows`, else at the nominal factor.
    Measured {
        /// Slows simulated time down while the coordinator computes.
        slows: bool,
    },
}

/// A wall clock beside the event clock, with the noise of a computer. It is a model, so that a study can repeat it.
#[derive(Clone, Debug)]
pub struct Wall {
    factor: f64,
    charging: Charging,
    noise: Sampler,
    computed_s: f64,
    charged_us: u64,
}

impl Wall {
    /// Creates a wall clock on which simulated time runs `factor` times as fast. Each factor has its own noise: a real
    /// run is never repeated exactly.
    #[must_use]
    pub fn new(seed: u64, factor: f64, charging: Charging) -> Self {
        let noise = Sampler::new(seed, OF_WALL ^ factor.to_bits());
        Self { factor, charging, noise, computed_s: 0.0, charged_us: 0 }
    }

    /// Simulated time that passes while the coordinator computes, µs.
    pub fn charge_us(&mut self, work: Work) -> u64 {
        let declared_s = work.updates as f64 * UPDATE_S + work.bids as f64 * BID_S;
        let on_wall_s = declared_s * self.noise.normal(JITTER).exp();
        self.computed_s += on_wall_s;
        let simulated_s = match self.charging {
            Charging::Free => 0.0,
            Charging::Declared => declared_s,
            Charging::Measured { slows: false } => on_wall_s * self.factor,
            Charging::Measured { slows: true } => {
                let before_s = on_wall_s.min(SLOWS_AFTER_S);
                before_s * self.factor + (on_wall_s - before_s)
            }
        };
        let charged_us = (simulated_s * 1e6).round() as u64;
        self.charged_us += charged_us;
        charged_us
    }

    /// Simulated time that was charged, s.
    #[must_use]
    pub fn charged_s(&self) -> f64 {
        self.charged_us as f64 * 1e-6
    }

    /// Simulated seconds per second of wall time in a run that took `simulated_s`: navigation at the nominal factor,
    /// plus the compute time.
    #[must_use]
    pub fn speed_factor(&self, simulated_s: f64) -> f64 {
        simulated_s / ((simulated_s - self.charged_s()).max(0.0) / self.factor + self.computed_s)
    }
}

/// Purpose of the random numbers of the wall clock.
const OF_WALL: u64 = 12;
