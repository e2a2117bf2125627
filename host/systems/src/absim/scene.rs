//! Fields and fleets that the study samples.

use std::f64::consts::PI;

use r4_rig::Place;

use crate::sampler::Sampler;

/// Purposes of the random numbers; durations have one sequence for each cell.
const OF_SCENE: u64 = 10;
const OF_DURATIONS: u64 = 1_000_000;

/// A field, its robots and their task.
#[derive(Clone, Debug, PartialEq)]
pub struct Scene {
    /// Seed of soil and noise.
    pub seed: u64,
    /// Number of robots in the fleet.
    pub robots: usize,
    /// Side of the square field, m.
    pub side_m: f64,
    /// Cells of the map along a side.
    pub cells: usize,
    /// Number of samples to be taken.
    pub samples: usize,
    /// Time at which all goals are cancelled, s.
    pub deadline_s: f64,
    /// Poses of the robots at the start.
    pub starts: Vec<Place>,
}

impl Scene {
    /// Samples a scene from a seed: the robots start on the southern edge of the field, whose side is sampled around
    /// `side_m`.
    #[must_use]
    pub fn sampled(seed: u64, robots: usize, side_m: f64, samples: usize) -> Self {
        let mut sampler = Sampler::new(seed, OF_SCENE);
        let side_m = side_m * sampler.uniform(0.75, 1.25);
        let mut start = |_| Place { x_m: sampler.uniform(0.0, side_m), y_m: 0.0, yaw_rad: sampler.uniform(-PI, PI) };
        let starts = (0..robots).map(&mut start).collect();
        Self { seed, robots, side_m, cells: (side_m.round() as usize).max(1), samples, deadline_s: 3_600.0, starts }
    }

    /// Scene of the study: three robots, 24 samples on a plot of about 20 m.
    #[must_use]
    pub fn of(seed: u64) -> Self {
        Self::sampled(seed, 3, 20.0, 24)
    }

    /// Scene with one robot that takes four samples on a plot of about 6 m: short enough for an emulated processor.
    #[must_use]
    pub fn small(seed: u64) -> Self {
        Self::sampled(seed, 1, 6.0, 4)
    }

    /// Duration of a sample, s. It is a property of the soil, unknown to the coordinator in advance.
    #[must_use]
    pub fn sampling_s(&self, cell: usize) -> f64 {
        Sampler::new(self.seed, OF_DURATIONS + cell as u64).uniform(3.0, 7.0)
    }
}
