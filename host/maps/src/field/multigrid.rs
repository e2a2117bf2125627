//! Conjugate gradients, preconditioned by a multigrid of aggregated cells.
//!
//! A level's nodes are the connected parts of squares of 2 × 2 of the level below, so that a coarse node never lies on
//! both sides of a wall; its edges are sums of edges. This is the Galerkin product of a piecewise constant
//! interpolation, and has again the form of a field's matrix.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::{FieldError, lattice::Lattice};

/// Result of a solve.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solved {
    /// Estimate of the greatest error of a mean, in the field's unit.
    pub estimate: f64,
    /// Number of iterations of conjugate gradients.
    pub iterations: usize,
}

impl Solved {
    pub(super) fn within(self, tolerance: f64) -> Result<Self, FieldError> {
        if self.estimate <= tolerance {
            Ok(self)
        } else {
            Err(FieldError::NotConverged { reached: self.estimate, iterations: self.iterations })
        }
    }
}

/// Divisor of a coarse level's edges. Piecewise constant interpolation makes the level too stiff, and its corrections
/// too small: edges between squares of twice the side sum to 2 λ, where the differential equation has λ. Priors and
/// readings need no correction.
///
/// Braess, "Towards Algebraic Multigrid for Elliptic Problems of Second Order", Computing 55, 1995: 1.8.
const STIFFNESS: f64 = 1.8;

/// Factor of the error estimate, which is a cycle on the residual. Compared with a solve to 1e-8 the greatest error was
/// up to 2.8 times the greatest element of it (`example field`, hall with shelves).
const ESTIMATE: f64 = 5.0;

/// Number of nodes at which coarsening stops; they are solved by a dense factor.
const COARSEST: usize = 64;

/// Limit that only rounding can reach: the maps of `docs/maps.md` take fewer than 30 iterations.
const MOST_ITERATIONS: usize = 300;

/// Graph of one level: edges in compressed rows, those to earlier nodes first. Vectors have one element more than there
/// are nodes, which is 0.
#[derive(Clone, Debug)]
struct Level {
    starts: Vec<u32>,
    /// First edge of each node that leads to a later node.
    middles: Vec<u32>,
    ends: Vec<u32>,
    weights: Vec<f64>,
    /// Diagonal without readings: sum of edges plus priors.
    base: Vec<f64>,
    /// Position of each node, in squares of this level.
    squares: Vec<[u32; 2]>,
    /// Node of the next level that each node is part of.
    parents: Vec<u32>,
    /// Neighbours in +x, +y, -x, -y, on the finest level only, where all edges have one weight. A missing neighbour is
    /// the element after the last node.
    four: Vec<[u32; 4]>,
    smoothness: f64,
}

impl Level {
    fn nodes(&self) -> usize {
        self.base.len()
    }

    fn edges(&self, node: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let range = self.starts[node] as usize..self.starts[node + 1] as usize;
        self.ends[range.clone()].iter().map(|end| *end as usize).zip(self.weights[range].iter().copied())
    }

    fn product(&self, range: std::ops::Range<u32>, x: &[f64]) -> f64 {
        let range = range.start as usize..range.end as usize;
        let edges = self.ends[range.clone()].iter().zip(&self.weights[range]);
        edges.map(|(near, weight)| weight * x[*near as usize]).sum()
    }

    /// Returns the sum of edge weights times the values of earlier neighbours.
    fn lower(&self, node: usize, x: &[f64]) -> f64 {
        match self.four.get(node) {
            Some([_, _, left, down]) => self.smoothness * (x[*left as usize] + x[*down as usize]),
            None => self.product(self.starts[node]..self.middles[node], x),
        }
    }

    /// Returns the sum of edge weights times the values of later neighbours.
    fn upper(&self, node: usize, x: &[f64]) -> f64 {
        match self.four.get(node) {
            Some([right, up, ..]) => self.smoothness * (x[*right as usize] + x[*up as usize]),
            None => self.product(self.middles[node]..self.starts[node + 1], x),
        }
    }

    /// Returns both sums: the row of A without its diagonal, negated.
    fn gathered(&self, node: usize, x: &[f64]) -> f64 {
        self.lower(node, x) + self.upper(node, x)
    }

    fn coarser(&mut self) -> Self {
        let nodes = self.nodes();
        let square = |node: usize| self.squares[node].map(|along| along / 2);
        let mut parents = vec![u32::MAX; nodes];
        let (mut squares, mut base, mut stack) = (Vec::new(), Vec::new(), Vec::new());
        for first in 0..nodes {
            if parents[first] != u32::MAX {
                continue;
            }
            let parent = squares.len() as u32;
            squares.push(square(first));
            base.push(0.0);
            parents[first] = parent;
            stack.push(first);
            while let Some(node) = stack.pop() {
                base[parent as usize] += self.base[node];
                for (near, weight) in self.edges(node) {
                    // Subtracts the edges from the diagonal, so that the prior remains; edges are added below.
                    base[parent as usize] -= weight;
                    if square(near) == square(first) && parents[near] == u32::MAX {
                        parents[near] = parent;
                        stack.push(near);
                    }
                }
            }
        }
        let mut edges: Vec<(u32, u32, f64)> = Vec::new();
        for node in 0..nodes {
            let far = self.edges(node).filter(|(near, _)| parents[*near] != parents[node]);
            // Edges inside of a coarse node vanish.
            edges.extend(far.map(|(near, weight)| (parents[node], parents[near], weight / STIFFNESS)));
        }
        // Rows in order, and in each row earlier nodes first, as `lower` and `upper` expect.
        edges.sort_unstable_by_key(|(from, to, _)| (*from, *to));
        // Parallel edges between the same two nodes add up; sorting has made them neighbours.
        edges.dedup_by(|next, kept| {
            let is_same = (next.0, next.1) == (kept.0, kept.1);
            if is_same {
                kept.2 += next.2;
            }
            is_same
        });
        let mut starts = vec![0u32; squares.len() + 1];
        for (from, _, weight) in &edges {
            starts[*from as usize + 1] += 1;
            // Restores the diagonal from the weights as they are after division.
            base[*from as usize] += weight;
        }
        (1..starts.len()).for_each(|at| starts[at] += starts[at - 1]);
        self.parents = parents;
        let earlier =
            |node: usize| edges[..].partition_point(|(from, to, _)| (*from as usize, *to as usize) < (node, node));
        Self {
            middles: (0..squares.len()).map(|node| earlier(node) as u32).collect(),
            four: Vec::new(),
            smoothness: 0.0,
            starts,
            ends: edges.iter().map(|edge| edge.1).collect(),
            weights: edges.iter().map(|edge| edge.2).collect(),
            base,
            squares,
            parents: Vec::new(),
        }
    }
}

#[derive(Clone, Debug)]
pub(super) struct Hierarchy {
    levels: Vec<Level>,
}

/// Vectors of one level during a solve.
struct Work {
    diagonal: Vec<f64>,
    /// Reciprocals of the diagonal: a division would be the longest part of each step, for which the next one waits.
    reciprocal: Vec<f64>,
    right: Vec<f64>,
    x: Vec<f64>,
}

impl Work {
    /// Sweeps forwards from a solution of 0: later neighbours add nothing.
    ///
    /// A node waits for the one before. On the finest level, where that is the left neighbour or none, its share is added last.
    fn forwards(&mut self, level: &Level) {
        let Self { reciprocal, right, x, .. } = self;
        for (node, (right, reciprocal)) in right.iter().zip(&*reciprocal).enumerate() {
            x[node] = match level.four.get(node) {
                Some([_, _, left, down]) => {
                    (right + level.smoothness * x[*down as usize]) * reciprocal
                        + level.smoothness * reciprocal * x[*left as usize]
                }
                None => (right + level.lower(node, x)) * reciprocal,
            };
        }
    }

    /// Sweeps backwards. On the finest level the share of the right neighbour, for which a node waits, is added last.
    fn backwards(&mut self, level: &Level) {
        let Self { reciprocal, right, x, .. } = self;
        for (node, (right, reciprocal)) in right.iter().zip(&*reciprocal).enumerate().rev() {
            x[node] = match level.four.get(node) {
                Some([ahead, up, left, down]) => {
                    let others = x[*up as usize] + x[*left as usize] + x[*down as usize];
                    (right + level.smoothness * others) * reciprocal
                        + level.smoothness * reciprocal * x[*ahead as usize]
                }
                None => (right + level.gathered(node, x)) * reciprocal,
            };
        }
    }
}

impl Hierarchy {
    pub(super) fn new(lattice: &Lattice, smoothness: f64, prior: f64) -> Self {
        let nodes = lattice.nodes();
        let (mut starts, mut ends) = (vec![0u32], Vec::new());
        let (mut base, mut squares) = (Vec::with_capacity(nodes), Vec::with_capacity(nodes));
        for node in 0..nodes {
            ends.extend(lattice.near(node).map(|near| near as u32));
            let edges = ends.len() - starts[node] as usize;
            starts.push(ends.len() as u32);
            base.push(prior + smoothness * edges as f64);
            squares.push(lattice.cell(node).map(|along| along as u32));
        }
        let four = lattice.neighbours.iter().map(|near| near.map(|near| near.min(nodes as u32))).collect();
        let weights = vec![smoothness; ends.len()];
        let (middles, parents) = (Vec::new(), Vec::new());
        let mut levels = vec![Level { starts, middles, ends, weights, base, squares, parents, four, smoothness }];
        while let Some(last) = levels.last_mut()
            && last.nodes() > COARSEST
            // A level without edges between its nodes cannot be coarsened.
            && !last.ends.is_empty()
        {
            let next = last.coarser();
            levels.push(next);
        }
        Self { levels }
    }

    /// Returns the greatest absolute residual of means.
    pub(super) fn residual(&self, observed: &[f64], right: &[f64], means: &[f64]) -> f64 {
        let level = &self.levels[0];
        let padded = [means, &[0.0]].concat();
        let residual = |node: usize| {
            right[node] - (level.base[node] + observed[node]) * means[node] + level.gathered(node, &padded)
        };
        (0..level.nodes()).map(|node| residual(node).abs()).fold(0.0, f64::max)
    }

    /// Improves `means` until the multigrid's estimate of the greatest error is within `tolerance`.
    pub(super) fn solve(&self, observed: &[f64], right: &[f64], means: &mut [f64], tolerance: f64) -> Solved {
        let finest = &self.levels[0];
        let nodes = finest.nodes();
        let mut cycle = Cycle::new(&self.levels, observed);
        let x = [&*means, &[0.0]].concat();
        let residual = |node: usize| right[node] - cycle.works[0].diagonal[node] * x[node] + finest.gathered(node, &x);
        let mut residual: Vec<f64> = (0..nodes).map(residual).collect();
        let (mut direction, mut product) = (vec![0.0; nodes + 1], vec![0.0; nodes]);
        let mut before = 0.0;
        let mut solved = Solved { estimate: f64::INFINITY, iterations: 0 };
        while solved.iterations < MOST_ITERATIONS {
            // The preconditioned residual is also an estimate of the error, so the check costs nothing.
            let z = &cycle.apply(&residual)[..nodes];
            solved.estimate = ESTIMATE * z.iter().map(|z| z.abs()).fold(0.0, f64::max);
            if solved.estimate <= tolerance {
                break;
            }
            let now = dot(&residual, z);
            // The first direction is that of steepest descent.
            let beta = if solved.iterations == 0 { 0.0 } else { now / before };
            direction.iter_mut().zip(z).for_each(|(direction, z)| *direction = z + beta * *direction);
            let diagonal = &cycle.works[0].diagonal;
            let mut curvature = 0.0;
            for node in 0..nodes {
                product[node] = diagonal[node] * direction[node] - finest.gathered(node, &direction);
                curvature += product[node] * direction[node];
            }
            let step = now / curvature;
            // A residual of 0 in all nodes leaves no direction: 0 / 0.
            if !step.is_finite() {
                break;
            }
            means.iter_mut().zip(&direction).for_each(|(mean, direction)| *mean += step * direction);
            residual.iter_mut().zip(&product).for_each(|(residual, product)| *residual -= step * product);
            before = now;
            solved.iterations += 1;
        }
        solved
    }
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// V-cycle with the present weights of the readings.
struct Cycle<'l> {
    levels: &'l [Level],
    works: Vec<Work>,
    /// Dense factor; `None` where the coarsest level has too many unconnected parts for one.
    coarsest: Option<Cholesky<f64, Dyn>>,
}

impl<'l> Cycle<'l> {
    fn new(levels: &'l [Level], observed: &[f64]) -> Self {
        let mut works = Vec::with_capacity(levels.len());
        let mut observed = observed.to_vec();
        for (depth, level) in levels.iter().enumerate() {
            let diagonal: Vec<f64> = level.base.iter().zip(&observed).map(|(base, observed)| base + observed).collect();
            let reciprocal = diagonal.iter().map(|diagonal| diagonal.recip()).collect();
            let (right, x) = (vec![0.0; level.nodes()], vec![0.0; level.nodes() + 1]);
            works.push(Work { diagonal, reciprocal, right, x });
            if let Some(next) = levels.get(depth + 1) {
                let mut sums = vec![0.0; next.nodes()];
                level.parents.iter().zip(&observed).for_each(|(parent, observed)| sums[*parent as usize] += observed);
                // A coarse node has all readings of its cells.
                observed = sums;
            }
        }
        let coarsest = levels.last().zip(works.last()).filter(|(level, _)| level.nodes() <= COARSEST);
        let coarsest = coarsest.and_then(|(level, work)| {
            let mut a = DMatrix::from_diagonal(&DVector::from_column_slice(&work.diagonal));
            (0..level.nodes()).for_each(|node| level.edges(node).for_each(|(near, weight)| a[(node, near)] -= weight));
            Cholesky::new(a)
        });
        Self { levels, works, coarsest }
    }

    fn apply(&mut self, residual: &[f64]) -> &[f64] {
        self.works[0].right.copy_from_slice(residual);
        self.level(0);
        &self.works[0].x
    }

    fn level(&mut self, depth: usize) {
        let level = &self.levels[depth];
        let nodes = level.nodes();
        if depth + 1 == self.levels.len() {
            let work = &mut self.works[depth];
            if let Some(factor) = &self.coarsest {
                let solved = factor.solve(&DVector::from_column_slice(&work.right));
                work.x[..nodes].copy_from_slice(solved.as_slice());
            } else {
                // Without edges the diagonal is the whole matrix.
                (0..nodes).for_each(|node| work.x[node] = work.right[node] * work.reciprocal[node]);
            }
            return;
        }
        let (fine, coarse) = self.works.split_at_mut(depth + 1);
        let (work, next) = (&mut fine[depth], &mut coarse[0]);
        // Gauss-Seidel forwards from 0 here, and backwards below: together symmetric, as conjugate gradients need it.
        work.forwards(level);
        next.right.fill(0.0);
        for node in 0..nodes {
            // The residual after the sweep: each node was solved without its later neighbours.
            next.right[level.parents[node] as usize] += level.upper(node, &work.x);
        }
        self.level(depth + 1);
        let (fine, coarse) = self.works.split_at_mut(depth + 1);
        let (work, next) = (&mut fine[depth], &coarse[0]);
        work.x.iter_mut().zip(&level.parents).for_each(|(x, parent)| *x += next.x[*parent as usize]);
        work.backwards(level);
    }
}
