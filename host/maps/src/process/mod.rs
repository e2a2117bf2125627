//! Gaussian-process regression of a field that varies with place and, alike at every place, with time.
//!
//! A reading is spatial part + temporal part + noise. On one drive both parts are confounded: only places that are
//! visited again at another time separate them, which the variances of the parts show.

mod sites;

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};
use r4_maths::minimise::{Effort, global};
pub use sites::{Criterion, next_sites};
use thiserror::Error;

use crate::pose::{Point, distance_m};

/// Reason why numbers allow no regression.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum ProcessError {
    /// A parameter is not finite and above 0.
    #[error("{what} is {value}: a finite number above 0 is needed")]
    Parameter {
        /// Name of the parameter.
        what: &'static str,
        /// Value of the parameter.
        value: f64,
    },
    /// A sample is not finite.
    #[error("sample {index} is not finite: leave it out")]
    NotFinite {
        /// Index of the sample, from 0.
        index: usize,
    },
    /// The covariance of the samples is not positive definite in 53 bits.
    #[error(
        "sample {index} is so close to another one that the noise of {noise} does not tell them apart: use more noise, or one of them"
    )]
    Singular {
        /// Sample at which the factor ended, from 0.
        index: usize,
        /// Standard deviation of the noise.
        noise: f64,
    },
    /// There are too few items to fit to or to choose from.
    #[error("{what}: give at least {least}")]
    TooFew {
        /// Name of the items.
        what: &'static str,
        /// Number of items that are needed.
        least: usize,
    },
}

/// Kernel s_s² exp(-|Δx|² / (2 l²)) + s_t² exp(-|Δt| / τ), and noise.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Kernel {
    /// Standard deviation of the spatial part (s_s), in the field's unit.
    pub place_deviation: f64,
    /// Length over which the spatial part varies (l), m.
    pub length_m: f64,
    /// Standard deviation of the temporal part (s_t), in the field's unit.
    pub time_deviation: f64,
    /// Time over which the temporal part varies (τ), s.
    pub time_s: f64,
    /// Standard deviation of a reading's noise, in the field's unit.
    pub noise: f64,
}

impl Kernel {
    fn check(&self) -> Result<(), ProcessError> {
        let Self { place_deviation, length_m, time_deviation, time_s, noise } = *self;
        let all = [
            ("place_deviation", place_deviation),
            ("length_m", length_m),
            ("time_deviation", time_deviation),
            ("time_s", time_s),
            ("noise", noise),
        ];
        let bad = all.into_iter().find(|(_, value)| !(*value > 0.0 && value.is_finite()));
        bad.map_or(Ok(()), |(what, value)| Err(ProcessError::Parameter { what, value }))
    }

    /// Returns the covariance of the spatial part between two places, unit².
    #[must_use]
    pub fn place(&self, a: Point, b: Point) -> f64 {
        self.place_deviation.powi(2) * (-0.5 * (distance_m(a, b) / self.length_m).powi(2)).exp()
    }

    /// Returns the covariance of the temporal part between two times, unit².
    #[must_use]
    pub fn time(&self, a_s: f64, b_s: f64) -> f64 {
        self.time_deviation.powi(2) * (-(a_s - b_s).abs() / self.time_s).exp()
    }

    fn both(&self, a: &Sample, b: &Sample) -> f64 {
        self.place(a.at, b.at) + self.time(a.at_s, b.at_s)
    }
}

/// Sample of the field: a reading with its place and time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sample {
    /// Place of the reading, m.
    pub at: Point,
    /// Time of the reading, s on the caller's clock.
    pub at_s: f64,
    /// Value of the reading, in the field's unit.
    pub value: f64,
}

/// Mean and variance of a normal distribution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Normal {
    /// Mean, in the field's unit.
    pub mean: f64,
    /// Variance, unit²; not below 0.
    pub variance: f64,
}

/// Prediction at a place and time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Prediction {
    /// Spatial part of the field.
    pub place: Normal,
    /// Temporal part of the field.
    pub time: Normal,
    /// Sum of both parts, without noise.
    pub sum: Normal,
}

/// Gaussian-process regression on samples, which are added one at a time.
///
/// The mean of both parts before any sample is 0: subtract a known offset first.
///
/// ```
/// use r4_maps::process::{Kernel, Process, Sample};
/// let kernel = Kernel { place_deviation: 10.0, length_m: 2.0, time_deviation: 1.0, time_s: 60.0, noise: 0.1 };
/// let mut process = Process::new(kernel).unwrap();
/// process.add(Sample { at: [0.0, 0.0], at_s: 0.0, value: 8.0 }).unwrap();
/// let [near, far] = [[0.1, 0.0], [50.0, 0.0]].map(|at| process.predict(at, 0.0).place);
/// assert!((near.mean - 8.0).abs() < 0.2 && near.variance < 2.0);
/// assert!(far.mean.abs() < 1e-9 && (far.variance - 100.0).abs() < 1e-9);
/// ```
///
/// # Source
/// Rasmussen, Williams, *Gaussian Processes for Machine Learning*, MIT Press 2006, algorithm 2.1; sums of kernels: 4.2.4.
#[derive(Clone, Debug)]
pub struct Process {
    kernel: Kernel,
    samples: Vec<Sample>,
    factor: Option<Cholesky<f64, Dyn>>,
    /// Product of (K + noise²)⁻¹ and the values.
    weights: DVector<f64>,
}

impl Process {
    /// Makes a regression without samples.
    ///
    /// # Errors
    /// [`ProcessError::Parameter`].
    pub fn new(kernel: Kernel) -> Result<Self, ProcessError> {
        kernel.check()?;
        Ok(Self { kernel, samples: Vec::new(), factor: None, weights: DVector::zeros(0) })
    }

    /// Makes a regression on samples.
    ///
    /// # Errors
    /// [`ProcessError::Parameter`], [`ProcessError::NotFinite`] and [`ProcessError::Singular`].
    pub fn of(kernel: Kernel, samples: &[Sample]) -> Result<Self, ProcessError> {
        let mut process = Self::new(kernel)?;
        // Before the cubic time of the factor.
        for (index, sample) in samples.iter().enumerate() {
            check(index, sample)?;
        }
        if samples.is_empty() {
            return Ok(process);
        }
        let own = |i, j| if i == j { kernel.noise.powi(2) } else { 0.0 };
        let covariance = |i: usize, j: usize| kernel.both(&samples[i], &samples[j]) + own(i, j);
        let factor = Cholesky::new(DMatrix::from_fn(samples.len(), samples.len(), covariance));
        let last = samples.len() - 1;
        process.factor = Some(factor.ok_or(ProcessError::Singular { index: last, noise: kernel.noise })?);
        process.samples = samples.to_vec();
        process.weigh();
        Ok(process)
    }

    /// Adds a sample, in a time that grows with the square of their number.
    ///
    /// # Errors
    /// [`ProcessError::NotFinite`] and [`ProcessError::Singular`]; the regression is as it was before.
    pub fn add(&mut self, sample: Sample) -> Result<(), ProcessError> {
        let index = self.samples.len();
        check(index, &sample)?;
        let noise = self.kernel.noise;
        let own = self.kernel.both(&sample, &sample) + noise.powi(2);
        let factor = match &self.factor {
            None => Cholesky::new(DMatrix::from_element(1, 1, own)),
            Some(factor) => {
                // Extending the factor by a row takes quadratic time; a new factor would take cubic time.
                let mut column = self.column(|other| self.kernel.both(&sample, other)).push(own);
                column[index] = own;
                let grown = factor.insert_column(index, column);
                grown.l_dirty()[(index, index)].is_finite().then_some(grown)
            }
        };
        let factor = factor.filter(|factor| factor.l_dirty()[(index, index)] > 0.0);
        self.factor = Some(factor.ok_or(ProcessError::Singular { index, noise })?);
        self.samples.push(sample);
        self.weigh();
        Ok(())
    }

    fn weigh(&mut self) {
        let values = DVector::from_iterator(self.samples.len(), self.samples.iter().map(|sample| sample.value));
        self.weights = self.factor.as_ref().map_or(DVector::zeros(0), |factor| factor.solve(&values));
    }

    fn column(&self, covariance: impl Fn(&Sample) -> f64) -> DVector<f64> {
        DVector::from_iterator(self.samples.len(), self.samples.iter().map(covariance))
    }

    /// Returns the kernel with its parameters.
    #[must_use]
    pub const fn kernel(&self) -> &Kernel {
        &self.kernel
    }

    /// Returns the samples so far.
    #[must_use]
    pub fn samples(&self) -> &[Sample] {
        &self.samples
    }

    /// Predicts the field at a place, m, and time, s.
    #[must_use]
    pub fn predict(&self, at: Point, at_s: f64) -> Prediction {
        let place = self.column(|sample| self.kernel.place(at, sample.at));
        let time = self.column(|sample| self.kernel.time(at_s, sample.at_s));
        let [place_prior, time_prior] = [self.kernel.place_deviation, self.kernel.time_deviation].map(|s| s * s);
        let sum = &place + &time;
        Prediction {
            place: self.normal(place_prior, &place),
            time: self.normal(time_prior, &time),
            sum: self.normal(place_prior + time_prior, &sum),
        }
    }

    fn normal(&self, prior: f64, column: &DVector<f64>) -> Normal {
        let explained = self.whitened(column).norm_squared();
        // Rounding may make the remaining variance negative where the samples explain all of it.
        Normal { mean: column.dot(&self.weights), variance: (prior - explained).max(0.0) }
    }

    /// Returns L⁻¹ times a vector, with L the factor of the samples' covariance.
    fn whitened(&self, column: &DVector<f64>) -> DVector<f64> {
        let solved = self.factor.as_ref().and_then(|factor| factor.l_dirty().solve_lower_triangular(column));
        solved.unwrap_or_else(|| DVector::zeros(0))
    }

    /// Returns the covariance of the spatial part between places, unit², given the samples.
    #[must_use]
    pub fn place_covariance(&self, places: &[Point]) -> DMatrix<f64> {
        let whitened: Vec<DVector<f64>> = places
            .iter()
            .map(|place| self.whitened(&self.column(|sample| self.kernel.place(*place, sample.at))))
            .collect();
        DMatrix::from_fn(places.len(), places.len(), |i, j| {
            self.kernel.place(places[i], places[j]) - whitened[i].dot(&whitened[j])
        })
    }

    /// Returns the covariance of the pattern at places, unit², given the samples: of the spatial part less its mean over
    /// these places.
    ///
    /// A constant can belong to either part, so that the samples never determine the spatial part's mean. Its variance
    /// keeps that of every place up; a reader of a map asks how places differ, which this covariance describes.
    #[must_use]
    pub fn pattern_covariance(&self, places: &[Point]) -> DMatrix<f64> {
        let mut covariance = self.place_covariance(places);
        // The matrix is symmetric: means of rows are those of columns.
        let means = covariance.row_mean();
        let mean = means.mean();
        for ((i, j), value) in
            (0..places.len()).flat_map(|j| (0..places.len()).map(move |i| (i, j))).zip(covariance.iter_mut())
        {
            *value += mean - means[i] - means[j];
        }
        covariance
    }

    /// Returns the natural logarithm of the samples' probability density under the kernel.
    #[must_use]
    pub fn log_likelihood(&self) -> f64 {
        let quadratic: f64 =
            self.samples.iter().zip(self.weights.iter()).map(|(sample, weight)| sample.value * weight).sum();
        let diagonal =
            self.factor.iter().flat_map(|factor| factor.l_dirty().diagonal().iter().copied().collect::<Vec<_>>());
        // The determinant is the square of the product of the factor's diagonal.
        let half_determinant: f64 = diagonal.map(f64::ln).sum();
        -0.5 * quadratic - half_determinant - 0.5 * self.samples.len() as f64 * std::f64::consts::TAU.ln()
    }

    /// Returns a regression on the same samples with the kernel of greatest likelihood between two kernels, parameter
    /// by parameter. The same seed gives the same result.
    ///
    /// A parameter that is the same in both is not changed. Search: [`r4_maths::minimise::global`] over the logarithms.
    ///
    /// # Errors
    /// [`ProcessError::TooFew`] below 3 samples, [`ProcessError::Parameter`] and [`ProcessError::Singular`].
    pub fn fitted(&self, low: Kernel, high: Kernel, effort: Effort, seed: u64) -> Result<Self, ProcessError> {
        const LEAST: usize = 3;
        low.check()?;
        high.check()?;
        if self.samples.len() < LEAST {
            return Err(ProcessError::TooFew { what: "samples to fit a kernel to", least: LEAST });
        }
        // All parameters are scales: in logarithms the search covers decades evenly and stays positive.
        let bounds: Vec<(f64, f64)> =
            numbers(&low).into_iter().zip(numbers(&high)).map(|(low, high)| (low.ln(), high.ln())).collect();
        let cost = |at: &[f64]| Self::of(kernel(at), &self.samples).map_or(f64::INFINITY, |fit| -fit.log_likelihood());
        Self::of(kernel(&global(&bounds, effort, seed, cost).at), &self.samples)
    }
}

fn check(index: usize, sample: &Sample) -> Result<(), ProcessError> {
    let finite = sample.at.iter().chain([&sample.at_s, &sample.value]).all(|number| number.is_finite());
    if finite { Ok(()) } else { Err(ProcessError::NotFinite { index }) }
}

fn numbers(kernel: &Kernel) -> [f64; 5] {
    [kernel.place_deviation, kernel.length_m, kernel.time_deviation, kernel.time_s, kernel.noise]
}

/// Makes a kernel of the logarithms of its numbers, in the order of [`numbers`].
fn kernel(at: &[f64]) -> Kernel {
    let number = |index: usize| at.get(index).map_or(f64::NAN, |log| log.exp());
    let [place_deviation, length_m, time_deviation, time_s, noise] = [0, 1, 2, 3, 4].map(number);
    Kernel { place_deviation, length_m, time_deviation, time_s, noise }
}
