//! Field of soil compaction, and its map from samples.
//!
//! The sampled field and the map share no code: the field is a sum of waves, the map is kriging with a covariance of
//! another shape.

use std::f64::consts::TAU;

use crate::sampler::Sampler;

/// Purpose of the random numbers of the field.
const OF_FIELD: u64 = 11;

/// Mean of the field, kPa. Roots grow badly above it, so that a farmer asks where it is exceeded. Declared.
const MEAN_KPA: f64 = 2_000.0;
/// Prior of the map before the first sample: standard deviation, kPa, and range, m. The middle of the sampled ranges;
/// 6 m of the map's Matérn covariance fall off nearly as 4.5 m of the field's Gaussian one.
const PRIOR_KPA: f64 = 450.0;
const RANGE_M: f64 = 6.0;
/// Standard deviation of a penetrometer's reading, kPa. Declared.
pub const NOISE_OF_SAMPLE_KPA: f64 = 50.0;

/// Number of waves in a field. With 100 the distribution of its values is normal to within what a map can resolve.
const WAVES: usize = 100;

/// Penetration resistance over a square field, kPa: a declared random field, not a measured one.
#[derive(Clone, Debug)]
pub struct Soil {
    mean_kpa: f64,
    deviation_kpa: f64,
    /// Wave numbers along x and y, rad/m, and phase, rad.
    waves: Vec<[f64; 3]>,
}

impl Soil {
    /// Samples the field of a seed. [`About::sampled`](crate::About::sampled) has the ranges.
    #[must_use]
    pub fn of(seed: u64) -> Self {
        let mut sampler = Sampler::new(seed, OF_FIELD);
        let deviation_kpa = sampler.uniform(300.0, 600.0);
        let length_m = sampler.uniform(3.0, 6.0);
        // Normal wave numbers give a covariance of exp(-d² / (2 L²)): Rahimi, Recht, "Random features for large-scale kernel
        // machines", NIPS 2007.
        let mut wave = |_| [sampler.normal(1.0 / length_m), sampler.normal(1.0 / length_m), sampler.uniform(0.0, TAU)];
        Self { mean_kpa: MEAN_KPA, deviation_kpa, waves: (0..WAVES).map(&mut wave).collect() }
    }

    /// Penetration resistance at a position, kPa.
    #[must_use]
    pub fn at(&self, [x_m, y_m]: [f64; 2]) -> f64 {
        let sum: f64 = self.waves.iter().map(|[x, y, phase]| (x * x_m + y * y_m + phase).cos()).sum();
        self.mean_kpa + self.deviation_kpa * (2.0 / self.waves.len() as f64).sqrt() * sum
    }
}

/// A map over a square grid by simple kriging: each sample updates mean and variance of all cells.
///
/// # Source
/// Rasmussen, Williams, *Gaussian Processes for Machine Learning*, MIT Press 2006, 2.2 and A.4: rows of the Cholesky factor, one for each
/// sample, so that a sample costs cells times samples. The covariance is a Matérn function of order 3/2.
#[derive(Clone, Debug)]
pub struct Map {
    cells_m: Vec<[f64; 2]>,
    /// Rows of the Cholesky factor: over samples, then over cells.
    rows: Vec<Vec<f64>>,
    mean_kpa: Vec<f64>,
    variance: Vec<f64>,
}

impl Map {
    /// Creates a map without samples, of `cells` by `cells` over a field of side `side_m`.
    #[must_use]
    pub fn new(side_m: f64, cells: usize) -> Self {
        let cell_m = side_m / cells as f64;
        let middle = |index: usize| (index as f64 + 0.5) * cell_m;
        let cells_m: Vec<_> = (0..cells * cells).map(|index| [middle(index % cells), middle(index / cells)]).collect();
        let (mean_kpa, variance) = (vec![MEAN_KPA; cells_m.len()], vec![PRIOR_KPA * PRIOR_KPA; cells_m.len()]);
        Self { cells_m, rows: Vec::new(), mean_kpa, variance }
    }

    /// Middle of a cell, m from the field's origin.
    #[must_use]
    pub fn place_m(&self, cell: usize) -> [f64; 2] {
        self.cells_m[cell]
    }

    /// Number of cells in the map.
    #[must_use]
    pub fn cells(&self) -> usize {
        self.cells_m.len()
    }

    /// Estimated mean of each cell, kPa, row by row.
    #[must_use]
    pub fn mean_kpa(&self) -> &[f64] {
        &self.mean_kpa
    }

    /// Index of the cell with the largest kriging variance; of several, the first.
    #[must_use]
    pub fn least_known(&self) -> usize {
        let mut best = 0;
        for (cell, variance) in self.variance.iter().enumerate() {
            if *variance > self.variance[best] {
                best = cell;
            }
        }
        best
    }

    /// Adds a sample in the middle of a cell. A sample without a value, which is still to be taken, only reduces the
    /// variance.
    pub fn add(&mut self, cell: usize, value_kpa: Option<f64>) {
        let [x_m, y_m] = self.cells_m[cell];
        let at_sample: Vec<f64> = self.rows.iter().map(|row| row[cell]).collect();
        let scale = (self.variance[cell] + NOISE_OF_SAMPLE_KPA * NOISE_OF_SAMPLE_KPA).sqrt();
        let covariance = |[other_x_m, other_y_m]: [f64; 2]| {
            let distance = 3.0_f64.sqrt() * (other_x_m - x_m).hypot(other_y_m - y_m) / RANGE_M;
            PRIOR_KPA * PRIOR_KPA * (1.0 + distance) * (-distance).exp()
        };
        let mut row: Vec<f64> = self.cells_m.iter().map(|place_m| covariance(*place_m)).collect();
        for (before, factor) in self.rows.iter().zip(at_sample) {
            row.iter_mut().zip(before).for_each(|(entry, before)| *entry -= factor * before);
        }
        row.iter_mut().for_each(|entry| *entry /= scale);
        let surprise = value_kpa.map_or(0.0, |value_kpa| (value_kpa - self.mean_kpa[cell]) / scale);
        for (cell, entry) in row.iter().enumerate() {
            self.mean_kpa[cell] += entry * surprise;
            self.variance[cell] -= entry * entry;
        }
        self.rows.push(row);
    }

    /// True penetration resistance in the middle of each cell, kPa.
    #[must_use]
    pub fn truth_kpa(&self, soil: &Soil) -> Vec<f64> {
        self.cells_m.iter().map(|place_m| soil.at(*place_m)).collect()
    }
}
