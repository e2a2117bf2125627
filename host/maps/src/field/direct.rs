//! Direct solve by the sparse Cholesky factor of the crate `faer`: the reference for the other solvers.

use faer::{
    Mat, Side,
    linalg::solvers::Solve,
    sparse::{SparseColMat, Triplet},
};

use super::{Field, FieldError};
use crate::grid::Grid;

impl Field {
    /// Returns the means of all cells by a direct solve, independent of messages and multigrid; `None` where the map is
    /// not free.
    ///
    /// # Errors
    /// [`FieldError::NotConverged`] if the factor does not exist, which only rounding can cause.
    ///
    /// # Source
    /// Davis, *Direct Methods for Sparse Linear Systems*, SIAM 2006, by the crate `faer`.
    pub fn direct_means(&self) -> Result<Grid<Option<f64>>, FieldError> {
        let nodes = self.lattice.nodes();
        let mut triplets = Vec::with_capacity(3 * nodes);
        let mut right = Mat::zeros(nodes, 1);
        for node in 0..nodes {
            let edges = self.lattice.near(node).count() as f64;
            let diagonal = self.weights.prior + self.observed[node] + self.weights.smoothness * edges;
            triplets.push(Triplet::new(node, node, diagonal));
            let lower = self.lattice.near(node).filter(|near| *near > node);
            triplets.extend(lower.map(|near| Triplet::new(near, node, -self.weights.smoothness)));
            right[(node, 0)] = self.information[node];
        }
        let failed = FieldError::NotConverged { reached: f64::INFINITY, iterations: 0 };
        let matrix = SparseColMat::<usize, f64>::try_new_from_triplets(nodes, nodes, &triplets).map_err(|_| failed)?;
        let factor = matrix.sp_cholesky(Side::Lower).map_err(|_| failed)?;
        let means = factor.solve(&right);
        Ok(self.lattice.grid(|node| means[(node, 0)]))
    }
}
