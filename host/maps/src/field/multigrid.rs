//! Conjugate gradients, preconditioned by a multigrid of aggregated cells.
//!
//! A level's nodes are the connected parts of squares of 2 × 2 of the level below, so that a coarse node never lies on both sides of
//! a wall; its edges are sums of edges. This is the Galerkin product of a piecewise constant interpolation, and again the matrix
//! of a field.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::lattice::Lattice;

/// What a solve took.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solved {
    /// Greatest absolute residual of A x = h.
    pub residual: f64,
    /// Iterations of conjugate gradients.
    pub iterations: usize,
}

/// Piecewise constant interpolation makes coarse corrections too small: factor by which they are enlarged.
///
/// Braess, "Towards Algebraic Multigrid for Elliptic Problems of Second Order", Computing 55, 1995: 1.8.
const OVER_CORRECTION: f64 = 1.8;

/// Levels stop at as many nodes: a dense factor of them costs 0.1 ms.
const COARSEST: usize = 64;

/// Never reached but by rounding: the maps of `docs/maps.md` take fewer than 60.
const MOST_ITERATIONS: usize = 300;

/// A graph of one level: edges in compressed rows.
#[derive(Clone, Debug)]
struct Level {
    starts: Vec<u32>,
    ends: Vec<u32>,
    weights: Vec<f64>,
    /// Diagonal without readings: sum of edges plus priors.
    base: Vec<f64>,
    /// Where each node lies, in squares of this level.
    squares: Vec<[u32; 2]>,
    /// Node of the next level that each node is part of.
    parents: Vec<u32>,
}

impl Level {
    fn nodes(&self) -> usize {
        self.base.len()
    }

    fn edges(&self, node: usize) -> impl Iterator<Item = (usize, f64)> + '_ {
        let range = self.starts[node] as usize..self.starts[node + 1] as usize;
        self.ends[range.clone()].iter().map(|end| *end as usize).zip(self.weights[range].iter().copied())
    }

    /// Sum of edge weights times the neighbours' values: what A has off its diagonal, negated.
    fn gathered(&self, node: usize, x: &[f64]) -> f64 {
        self.edges(node).map(|(near, weight)| weight * x[near]).sum()
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
                    if square(near) == square(first) {
                        // Inside a coarse node: no edge, and none of its diagonal.
                        base[parent as usize] -= weight;
                        if parents[near] == u32::MAX {
                            parents[near] = parent;
                            stack.push(near);
                        }
                    }
                }
            }
        }
        let mut edges: Vec<(u32, u32, f64)> = Vec::new();
        for node in 0..nodes {
            let far = self.edges(node).filter(|(near, _)| parents[*near] != parents[node]);
            edges.extend(far.map(|(near, weight)| (parents[node], parents[near], weight)));
        }
        edges.sort_unstable_by_key(|(from, to, _)| (*from, *to));
        edges.dedup_by(|next, kept| {
            let is_same = (next.0, next.1) == (kept.0, kept.1);
            if is_same {
                kept.2 += next.2;
            }
            is_same
        });
        let mut starts = vec![0u32; squares.len() + 1];
        edges.iter().for_each(|(from, ..)| starts[*from as usize + 1] += 1);
        (1..starts.len()).for_each(|at| starts[at] += starts[at - 1]);
        self.parents = parents;
        Self {
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
    right: Vec<f64>,
    x: Vec<f64>,
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
        let weights = vec![smoothness; ends.len()];
        let mut levels = vec![Level { starts, ends, weights, base, squares, parents: Vec::new() }];
        while let Some(last) = levels.last_mut()
            && last.nodes() > COARSEST
            // Without edges between its nodes a level has nothing to hand up.
            && !last.ends.is_empty()
        {
            let next = last.coarser();
            levels.push(next);
        }
        Self { levels }
    }

    /// Greatest absolute residual.
    pub(super) fn residual(&self, observed: &[f64], right: &[f64], x: &[f64]) -> f64 {
        let level = &self.levels[0];
        let residual =
            |node: usize| right[node] - (level.base[node] + observed[node]) * x[node] + level.gathered(node, x);
        (0..level.nodes()).map(|node| residual(node).abs()).fold(0.0, f64::max)
    }

    /// Improves `x` until no residual is greater than `tolerance`, or no further.
    pub(super) fn solve(&self, observed: &[f64], right: &[f64], x: &mut [f64], tolerance: f64) -> Solved {
        let finest = &self.levels[0];
        let nodes = finest.nodes();
        let mut cycle = Cycle::new(&self.levels, observed);
        let times = |x: &[f64], to: &mut [f64], diagonal: &[f64]| {
            (0..nodes).for_each(|node| to[node] = diagonal[node] * x[node] - finest.gathered(node, x));
        };
        let mut product = vec![0.0; nodes];
        times(x, &mut product, &cycle.works[0].diagonal);
        let mut residual: Vec<f64> = right.iter().zip(&product).map(|(right, product)| right - product).collect();
        let mut direction = vec![0.0; nodes];
        let (mut before, mut greatest) = (0.0, greatest(&residual));
        let mut iterations = 0;
        while greatest > tolerance && iterations < MOST_ITERATIONS {
            let z = cycle.apply(&residual);
            let now = dot(&residual, z);
            let beta = if iterations == 0 { 0.0 } else { now / before };
            direction.iter_mut().zip(z).for_each(|(direction, z)| *direction = z + beta * *direction);
            times(&direction, &mut product, &cycle.works[0].diagonal);
            let step = now / dot(&direction, &product);
            if !step.is_finite() {
                break;
            }
            greatest = 0.0f64;
            for node in 0..nodes {
                x[node] += step * direction[node];
                residual[node] -= step * product[node];
                greatest = greatest.max(residual[node].abs());
            }
            before = now;
            iterations += 1;
        }
        // Of x itself: the one above was updated, and rounding has parted them.
        Solved { residual: self.residual(observed, right, x), iterations }
    }
}

fn greatest(values: &[f64]) -> f64 {
    values.iter().map(|value| value.abs()).fold(0.0, f64::max)
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// One V-cycle with the readings' weights of the moment.
struct Cycle<'l> {
    levels: &'l [Level],
    works: Vec<Work>,
    /// `None` where the coarsest level has too many parts without connection for a dense factor.
    coarsest: Option<Cholesky<f64, Dyn>>,
}

impl<'l> Cycle<'l> {
    fn new(levels: &'l [Level], observed: &[f64]) -> Self {
        let mut works = Vec::with_capacity(levels.len());
        let mut observed = observed.to_vec();
        for (depth, level) in levels.iter().enumerate() {
            let diagonal = level.base.iter().zip(&observed).map(|(base, observed)| base + observed).collect();
            let zeros = vec![0.0; level.nodes()];
            works.push(Work { diagonal, right: zeros.clone(), x: zeros });
            if let Some(next) = levels.get(depth + 1) {
                let mut sums = vec![0.0; next.nodes()];
                level.parents.iter().zip(&observed).for_each(|(parent, observed)| sums[*parent as usize] += observed);
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
                work.x.copy_from_slice(solved.as_slice());
            } else {
                // Parts that have no edges between them: the diagonal is all.
                (0..nodes).for_each(|node| work.x[node] = work.right[node] / work.diagonal[node]);
            }
            return;
        }
        let (fine, coarse) = self.works.split_at_mut(depth + 1);
        let (work, next) = (&mut fine[depth], &mut coarse[0]);
        // Gauss-Seidel forwards from 0, and backwards below: together symmetric, as conjugate gradients need it.
        work.x.fill(0.0);
        (0..nodes).for_each(|node| {
            work.x[node] = (work.right[node] + level.gathered(node, &work.x)) / work.diagonal[node];
        });
        next.right.fill(0.0);
        for node in 0..nodes {
            let residual = work.right[node] - work.diagonal[node] * work.x[node] + level.gathered(node, &work.x);
            next.right[level.parents[node] as usize] += residual;
        }
        self.level(depth + 1);
        let (fine, coarse) = self.works.split_at_mut(depth + 1);
        let (work, next) = (&mut fine[depth], &coarse[0]);
        (0..nodes).for_each(|node| work.x[node] += OVER_CORRECTION * next.x[level.parents[node] as usize]);
        (0..nodes).rev().for_each(|node| {
            work.x[node] = (work.right[node] + level.gathered(node, &work.x)) / work.diagonal[node];
        });
    }
}
