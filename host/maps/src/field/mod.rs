//! Scalar field on the free cells of a map, as a Gauss-Markov random field that readings are added to.
//!
//! The field minimises the energy (twice the negative logarithm of its density)
//!
//! Σ over edges `smoothness` (xᵢ - xⱼ)² + Σ over readings λ(age) (xᵢ - z)² + Σ over cells `prior` xᵢ²,
//!
//! with edges between free neighbours only, so that no value passes a wall. Its mean solves A x = h and its covariance
//! is A⁻¹. Means come from Gaussian belief propagation (`messages`), which is local and can be interrupted at any time,
//! and from conjugate gradients preconditioned by multigrid (`multigrid`), which also remove the errors of long
//! wavelength that take messages thousands of sweeps. Variances come from a sparse Cholesky factor by selected
//! inversion (`cholesky`): those of belief propagation are too small on grids, which have loops. `docs/maps.md` has the
//! measurements.

mod cholesky;
#[cfg(feature = "direct")]
mod direct;
mod lattice;
mod messages;
mod multigrid;

use lattice::Lattice;
use messages::Messages;
pub use messages::Spent;
use multigrid::Hierarchy;
pub use multigrid::Solved;
use thiserror::Error;

use crate::grid::{Cell, Grid, GridError};

/// Error of a field that cannot be made, or of a reading that it cannot take.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum FieldError {
    /// The grid does not have this place.
    #[error(transparent)]
    Grid(#[from] GridError),
    /// The map has no free cell.
    #[error("the map has no free cell: wait until it has some")]
    NoFreeCell,
    /// The cell of a reading is not free.
    #[error("cell {cell:?} is not free: take the nearest free cell, or correct the map")]
    NotFree {
        /// Cell of the reading.
        cell: Cell,
    },
    /// A weight is not finite and above 0.
    #[error("{what} is {value}: a finite number above 0 is needed")]
    Weight {
        /// Name of the weight.
        what: &'static str,
        /// Value of the weight.
        value: f64,
    },
    /// A reading or a time is not finite.
    #[error("{what} is {value}: leave out readings that are not finite")]
    NotFinite {
        /// Name of the number.
        what: &'static str,
        /// Value of the number.
        value: f64,
    },
    /// The time is before an earlier one.
    #[error("time {asked_s} s is before {now_s} s: give times in order")]
    Backwards {
        /// Time asked for, s.
        asked_s: f64,
        /// Time of the field, s.
        now_s: f64,
    },
    /// The iterations ended before the tolerance was reached, because of rounding.
    #[error("an error bound of {reached} after {iterations} iterations: ask for a larger one")]
    NotConverged {
        /// Bound of the error that was reached, in the unit of the field.
        reached: f64,
        /// Number of iterations that ran.
        iterations: usize,
    },
}

/// Weights of the energy: inverse variances, in 1/(unit of the field)², except for `forgetting_s`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Weights {
    /// Inverse variance of the difference between neighbours (λp): the higher, the smoother is the field.
    pub smoothness: f64,
    /// Inverse variance of a fresh reading (λo).
    pub reading: f64,
    /// Ratio of time to variance, s/unit² (λt): a reading's variance grows by `age / forgetting_s`, so that it has half
    /// its weight after `forgetting_s / reading` seconds.
    pub forgetting_s: f64,
    /// Inverse variance of each cell about 0 without any reading (λd).
    pub prior: f64,
}

impl Weights {
    fn check(&self) -> Result<(), FieldError> {
        let Self { smoothness, reading, forgetting_s, prior } = *self;
        let all = [("smoothness", smoothness), ("reading", reading), ("forgetting_s", forgetting_s), ("prior", prior)];
        let bad = all.into_iter().find(|(_, value)| !(*value > 0.0 && value.is_finite()));
        bad.map_or(Ok(()), |(what, value)| Err(FieldError::Weight { what, value }))
    }

    /// Returns the inverse variance of a reading of this age: 1 / (1/reading + age/forgetting).
    ///
    /// ```
    /// let weights = r4_maps::field::Weights { smoothness: 0.5, reading: 10.0, forgetting_s: 100.0, prior: 1e-2 };
    /// assert_eq!(weights.of_age(0.0), 10.0);
    /// assert_eq!(weights.of_age(10.0), 5.0);
    /// ```
    #[must_use]
    pub fn of_age(&self, age_s: f64) -> f64 {
        (self.reading.recip() + age_s / self.forgetting_s).recip()
    }
}

/// Reading of the field at one cell.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Reading {
    /// Cell of the reading, a free one.
    pub cell: Cell,
    /// Value of the reading, in the field's unit.
    pub value: f64,
    /// Time of the reading, s on the caller's clock.
    pub at_s: f64,
}

/// Scalar field: its cells, readings, and the beliefs of all cells.
///
/// ```
/// use r4_maps::{field::{Field, Reading, Weights}, grid::{Frame, Grid}, pose::Pose};
/// let free = Grid::filled(Frame::new(Pose::default(), 0.2, 20, 20).unwrap(), true);
/// let weights = Weights { smoothness: 0.5, reading: 10.0, forgetting_s: 1e6, prior: 1e-2 };
/// let mut field = Field::new(&free, weights).unwrap();
/// field.observe(Reading { cell: [5, 5], value: 40.0, at_s: 0.0 }).unwrap();
/// // While driving: near the reading, in a short time.
/// field.wildfire(0.01, 10_000);
/// // With time to spare: everywhere.
/// field.solve(1e-6).unwrap();
/// let near = field.mean([6, 5]).unwrap();
/// assert!(near > field.mean([15, 15]).unwrap() && near < 40.0);
/// ```
#[derive(Clone, Debug)]
pub struct Field {
    lattice: Lattice,
    weights: Weights,
    /// Readings, each with its node.
    readings: Vec<(usize, Reading)>,
    now_s: f64,
    /// Sum of the weights of each node's readings.
    observed: Vec<f64>,
    /// Sum of weight times value of each node's readings: h.
    information: Vec<f64>,
    messages: Messages,
    hierarchy: Hierarchy,
}

impl Field {
    /// Makes a field without readings on the free cells of a map.
    ///
    /// # Errors
    /// [`FieldError::NoFreeCell`] and [`FieldError::Weight`].
    pub fn new(free: &Grid<bool>, weights: Weights) -> Result<Self, FieldError> {
        weights.check()?;
        let lattice = Lattice::new(free);
        let nodes = lattice.nodes();
        if nodes == 0 {
            return Err(FieldError::NoFreeCell);
        }
        Ok(Self {
            messages: Messages::new(&lattice, weights.smoothness, weights.prior),
            hierarchy: Hierarchy::new(&lattice, weights.smoothness, weights.prior),
            observed: vec![0.0; nodes],
            information: vec![0.0; nodes],
            readings: Vec::new(),
            now_s: f64::NEG_INFINITY,
            lattice,
            weights,
        })
    }

    /// Makes a field with the same readings on a map that has changed. Means of cells that were free begin at their
    /// former values; the error is that of a field whose messages have not settled ([`Field::solve`]). Readings in
    /// cells that are not free any more are dropped.
    ///
    /// # Errors
    /// [`FieldError::NoFreeCell`], and [`GridError::Unlike`] for a map of another frame.
    pub fn on(&self, free: &Grid<bool>) -> Result<Self, FieldError> {
        if free.frame() != self.lattice.frame() {
            return Err(GridError::Unlike.into());
        }
        let mut moved = Self::new(free, self.weights)?;
        moved.now_s = self.now_s;
        for (_, reading) in &self.readings {
            if let Ok(node) = moved.lattice.node(reading.cell) {
                moved.readings.push((node, *reading));
            }
        }
        moved.weigh();
        let mean = |node| self.mean(moved.lattice.cell(node)).unwrap_or(0.0);
        let means: Vec<f64> = (0..moved.lattice.nodes()).map(mean).collect();
        moved.messages.set_means(&moved.lattice, &means, false);
        Ok(moved)
    }

    /// Returns the number of free cells.
    #[must_use]
    pub fn cells(&self) -> usize {
        self.lattice.nodes()
    }

    /// Iterates over the readings so far, in the order in which they were taken.
    pub fn readings(&self) -> impl Iterator<Item = &Reading> {
        self.readings.iter().map(|(_, reading)| reading)
    }

    /// Adds a reading, and lets the older ones age to its time. Beliefs change only with [`Field::wildfire`],
    /// [`Field::settle`] or [`Field::solve`].
    ///
    /// # Errors
    /// [`FieldError::NotFree`], [`FieldError::NotFinite`], [`FieldError::Backwards`], [`FieldError::Grid`]; nothing is changed.
    pub fn observe(&mut self, reading: Reading) -> Result<(), FieldError> {
        let node = self.lattice.node(reading.cell)?;
        if !reading.value.is_finite() {
            return Err(FieldError::NotFinite { what: "the reading", value: reading.value });
        }
        self.advance(reading.at_s)?;
        self.readings.push((node, reading));
        let weight = self.weights.reading;
        self.set(node, self.observed[node] + weight, self.information[node] + weight * reading.value);
        Ok(())
    }

    /// Lets all readings age to a time, s.
    ///
    /// # Errors
    /// [`FieldError::NotFinite`] and [`FieldError::Backwards`]; nothing is changed.
    pub fn advance(&mut self, now_s: f64) -> Result<(), FieldError> {
        if !now_s.is_finite() {
            return Err(FieldError::NotFinite { what: "the time", value: now_s });
        }
        if now_s < self.now_s {
            return Err(FieldError::Backwards { asked_s: now_s, now_s: self.now_s });
        }
        if now_s > self.now_s {
            self.now_s = now_s;
            self.weigh();
        }
        Ok(())
    }

    /// Adds up all readings' weights at the field's time.
    fn weigh(&mut self) {
        let nodes = self.lattice.nodes();
        let (mut observed, mut information) = (vec![0.0; nodes], vec![0.0; nodes]);
        let mut touched = Vec::with_capacity(self.readings.len());
        for (node, reading) in &self.readings {
            let weight = self.weights.of_age(self.now_s - reading.at_s);
            observed[*node] += weight;
            information[*node] += weight * reading.value;
            touched.push(*node);
        }
        touched.sort_unstable();
        touched.dedup();
        touched.into_iter().for_each(|node| self.set(node, observed[node], information[node]));
    }

    fn set(&mut self, node: usize, observed: f64, information: f64) {
        self.observed[node] = observed;
        self.information[node] = information;
        self.messages.set(node, self.weights.prior + observed, information);
    }

    /// Sends messages from the newest readings, in the order in which cells are reached, until no cell's mean has
    /// changed by more than `threshold` (in the field's unit) since it last sent, or `budget` cells were updated.
    /// Remaining updates are kept for the next call.
    ///
    /// # Source
    /// Messages: Weiss, Freeman, "Correctness of Belief Propagation in Gaussian Graphical Models of Arbitrary Topology", Neural
    /// Computation 13, 2001; Bickson, *Gaussian Belief Propagation: Theory and Application*, thesis 2008. Schedule: Ranganathan,
    /// Kaess, Dellaert, "Loopy SAM", IJCAI 2007.
    pub fn wildfire(&mut self, threshold: f64, budget: usize) -> Spent {
        self.messages.wildfire(&self.lattice, threshold, budget)
    }

    /// Sends messages of the cells with the greatest residual first, for idle time; ends as [`Field::wildfire`] does.
    ///
    /// # Source
    /// Elidan, McGraw, Koller, "Residual Belief Propagation", UAI 2006.
    pub fn settle(&mut self, threshold: f64, budget: usize) -> Spent {
        self.messages.settle(&self.lattice, threshold, budget)
    }

    /// Solves for the means of all cells to `tolerance` (in the field's unit), by preconditioned conjugate gradients
    /// from the present beliefs; messages correct them from then on.
    ///
    /// The error is estimated by the preconditioner, times a factor of five. [`Field::error_bound`] is rigorous, and
    /// thousands of times greater. Errors against a direct solve are in `docs/maps.md`.
    ///
    /// # Errors
    /// [`FieldError::NotConverged`]; the means are then the best that were found.
    ///
    /// # Source
    /// Hestenes, Stiefel 1952; aggregation multigrid: Braess, Computing 55, 1995.
    pub fn solve(&mut self, tolerance: f64) -> Result<Solved, FieldError> {
        let mut means: Vec<f64> = (0..self.lattice.nodes()).map(|node| self.messages.mean(node)).collect();
        let solved = self.hierarchy.solve(&self.observed, &self.information, &mut means, tolerance);
        self.messages.set_means(&self.lattice, &means, true);
        solved.within(tolerance)
    }

    /// Returns a rigorous upper bound of the error of all means, in the field's unit: the greatest residual divided by
    /// the prior, by which A is diagonally dominant (Varah, Linear Algebra and its Applications 11, 1975).
    #[must_use]
    pub fn error_bound(&self) -> f64 {
        let means: Vec<f64> = (0..self.lattice.nodes()).map(|node| self.messages.mean(node)).collect();
        self.hierarchy.residual(&self.observed, &self.information, &means) / self.weights.prior
    }

    /// Returns the mean of a free cell, as far as it has been propagated.
    ///
    /// # Errors
    /// [`FieldError::NotFree`] and [`FieldError::Grid`].
    pub fn mean(&self, cell: Cell) -> Result<f64, FieldError> {
        self.lattice.node(cell).map(|node| self.messages.mean(node))
    }

    /// Returns the means of all cells; `None` where the map is not free.
    #[must_use]
    pub fn means(&self) -> Grid<Option<f64>> {
        self.lattice.grid(|node| self.messages.mean(node))
    }

    /// Returns the variances of belief propagation, unit²: **too small** on a map with loops, by up to 4.6 times in
    /// `docs/maps.md` (Weiss, Freeman 2001 prove means only). For comparison; plans use [`Field::variances`].
    #[must_use]
    pub fn propagated_variances(&self) -> Grid<Option<f64>> {
        let precisions = self.messages.precisions(&self.lattice);
        self.lattice.grid(|node| precisions[node].recip())
    }

    /// Returns the exact marginal variances of all cells at the field's time, unit²; `None` where the map is not free.
    ///
    /// # Source
    /// Selected inversion of a sparse Cholesky factor: Takahashi, Fagan, Chin, 1973; Erisman, Tinney, "On Computing Certain
    /// Elements of the Inverse of a Sparse Matrix", Communications of the ACM 18, 1975. Order of elimination: nested dissection,
    /// George, SIAM Journal on Numerical Analysis 10, 1973.
    #[must_use]
    pub fn variances(&self) -> Grid<Option<f64>> {
        let diagonal: Vec<f64> = self.observed.iter().map(|observed| observed + self.weights.prior).collect();
        let variances = cholesky::marginal_variances(&self.lattice, self.weights.smoothness, &diagonal);
        self.lattice.grid(|node| variances[node])
    }

    /// Returns the exact variances after a further fresh reading in `cell`, from `variances` before it: without another
    /// factor, in the time of one [`Field::solve`]. For the value of a planned reading, or the effect of one that was
    /// taken.
    ///
    /// # Errors
    /// [`FieldError::NotFree`], [`FieldError::Grid`], [`GridError::Unlike`] for variances of another map, and
    /// [`FieldError::NotConverged`].
    ///
    /// # Source
    /// Sherman, Morrison, Annals of Mathematical Statistics 21, 1950.
    pub fn variances_with(&self, variances: &Grid<Option<f64>>, cell: Cell) -> Result<Grid<Option<f64>>, FieldError> {
        // Relative to the variance of a reading.
        const TOLERANCE: f64 = 1e-7;
        if variances.frame() != self.lattice.frame() {
            return Err(GridError::Unlike.into());
        }
        let node = self.lattice.node(cell)?;
        let nodes = self.lattice.nodes();
        let (mut unit, mut column) = (vec![0.0; nodes], vec![0.0; nodes]);
        unit[node] = 1.0;
        let tolerance = TOLERANCE / self.weights.reading;
        self.hierarchy.solve(&self.observed, &unit, &mut column, tolerance).within(tolerance)?;
        let gain = self.weights.reading / (1.0 + self.weights.reading * column[node]);
        let old = |node| variances.get(self.lattice.cell(node)).ok().copied().flatten();
        Ok(self.lattice.grid(|node| old(node).map_or(f64::NAN, |old| old - gain * column[node] * column[node])))
    }
}
