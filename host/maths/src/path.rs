//! Shortest paths: A* on any graph and on a grid.

use std::{
    cmp::Ordering,
    collections::{BinaryHeap, HashMap, hash_map::Entry},
    hash::Hash,
};

use thiserror::Error;

/// Reason why there is no path.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum PathError {
    /// No path leads from the start to the goal.
    #[error("no way leads there: all {expanded} places that can be reached were searched")]
    Unreachable {
        /// Number of nodes that were expanded.
        expanded: usize,
    },
    /// A step has a cost that is negative or NaN.
    #[error("a step costs {0}: costs are 0 or more")]
    Cost(f64),
    /// The cell is not on the grid.
    #[error("cell {column}, {row} is outside the grid of {columns} × {rows}")]
    Outside {
        /// Column of the cell, from 0.
        column: usize,
        /// Row of the cell, from 0.
        row: usize,
        /// Number of columns of the grid.
        columns: usize,
        /// Number of rows of the grid.
        rows: usize,
    },
    /// The start or the goal is blocked.
    #[error("cell {column}, {row} is blocked: choose a free one")]
    Blocked {
        /// Column of the cell, from 0.
        column: usize,
        /// Row of the cell, from 0.
        row: usize,
    },
}

/// Path with its cost.
#[derive(Clone, Debug, PartialEq)]
pub struct Path<N> {
    /// Nodes from the start to the goal, both included.
    pub nodes: Vec<N>,
    /// Sum of the steps' costs.
    pub cost: f64,
}

struct Open<N> {
    estimate: f64,
    cost: f64,
    order: usize,
    node: N,
}

impl<N> PartialEq for Open<N> {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl<N> Eq for Open<N> {}

impl<N> PartialOrd for Open<N> {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl<N> Ord for Open<N> {
    /// Orders by the least estimate, then by the higher cost so far, then by age. The order, and with it the choice
    /// among equally cheap paths, is always the same.
    fn cmp(&self, other: &Self) -> Ordering {
        let by_cost = other.estimate.total_cmp(&self.estimate).then(self.cost.total_cmp(&other.cost));
        by_cost.then(other.order.cmp(&self.order))
    }
}

/// Finds the cheapest path from `start` to a node that `is_goal` accepts, by A*.
///
/// `neighbours` puts the nodes that can be reached from a node, with the cost of the step, into the given list.
/// `remaining` is a lower bound of the cost from a node to the goal, in the same unit. The path is cheapest if this
/// bound never exceeds the true cost; 0 makes it Dijkstra's algorithm. A step of infinite cost is no step. Of equally
/// cheap paths the result is always the same.
///
/// # Errors
/// [`PathError::Unreachable`] and [`PathError::Cost`]. The search of an infinite graph without a goal does not end.
///
/// # Source
/// Hart, Nilsson, Raphael, "A Formal Basis for the Heuristic Determination of Minimum Cost Paths", IEEE Transactions on Systems
/// Science and Cybernetics 4, 1968.
///
/// ```
/// // From 1 to 10 by doubling (cost 3) or adding one (cost 1).
/// let steps = |n: &u32, to: &mut Vec<(u32, f64)>| to.extend([(2 * n, 3.0), (n + 1, 1.0)].into_iter().filter(|to| to.0 <= 10));
/// let path = r4_maths::path::astar(1, steps, |_| 0.0, |n| *n == 10).unwrap();
/// assert_eq!((path.nodes, path.cost), (vec![1, 2, 3, 4, 5, 10], 7.0));
/// ```
pub fn astar<N: Clone + Eq + Hash>(
    start: N,
    mut neighbours: impl FnMut(&N, &mut Vec<(N, f64)>),
    remaining: impl Fn(&N) -> f64,
    is_goal: impl Fn(&N) -> bool,
) -> Result<Path<N>, PathError> {
    // Cost from the start, and the previous node.
    let mut known: HashMap<N, (f64, Option<N>)> = HashMap::from([(start.clone(), (0.0, None))]);
    let mut open = BinaryHeap::from([Open { estimate: bound(remaining(&start))?, cost: 0.0, order: 0, node: start }]);
    let (mut steps, mut order, mut expanded) = (Vec::new(), 0, 0);
    while let Some(Open { cost, node, .. }) = open.pop() {
        // A cheaper path to the node was found after this entry was made.
        if known.get(&node).is_some_and(|(best, _)| *best < cost) {
            continue;
        }
        if is_goal(&node) {
            let mut nodes = vec![node];
            while let Some((_, Some(before))) = nodes.last().and_then(|node| known.get(node)) {
                nodes.push(before.clone());
            }
            nodes.reverse();
            return Ok(Path { nodes, cost });
        }
        expanded += 1;
        steps.clear();
        neighbours(&node, &mut steps);
        for (next, step) in steps.drain(..) {
            let cost = cost + bound(step)?;
            if cost.is_infinite() {
                continue;
            }
            match known.entry(next.clone()) {
                Entry::Occupied(old) if old.get().0 <= cost => continue,
                Entry::Occupied(mut old) => *old.get_mut() = (cost, Some(node.clone())),
                Entry::Vacant(new) => _ = new.insert((cost, Some(node.clone()))),
            }
            order += 1;
            open.push(Open { estimate: cost + bound(remaining(&next))?, cost, order, node: next });
        }
    }
    Err(PathError::Unreachable { expanded })
}

fn bound(cost: f64) -> Result<f64, PathError> {
    if cost >= 0.0 { Ok(cost) } else { Err(PathError::Cost(cost)) }
}

/// Grid of square cells, each with a factor for the cost of crossing it.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    columns: usize,
    rows: usize,
    cell_m: f64,
    factors: Vec<f64>,
}

/// Cell by its column and row, from 0.
pub type Cell = [usize; 2];

impl Grid {
    /// Makes a free grid of cells with sides of `cell_m`, m.
    ///
    /// ```
    /// use r4_maths::path::Grid;
    /// let mut grid = Grid::new(3, 3, 0.1);
    /// grid.block([1, 1]).unwrap();
    /// let path = grid.path([0, 0], [2, 2]).unwrap();
    /// // Round the corner: the diagonal is blocked, and corners are not cut.
    /// assert!((path.cost - 0.4).abs() < 1e-12 && path.nodes.len() == 5);
    /// ```
    #[must_use]
    pub fn new(columns: usize, rows: usize, cell_m: f64) -> Self {
        Self { columns, rows, cell_m, factors: vec![1.0; columns * rows] }
    }

    /// Blocks a cell.
    ///
    /// # Errors
    /// [`PathError::Outside`].
    ///
    /// ```
    /// assert!(r4_maths::path::Grid::new(2, 2, 0.1).block([2, 0]).is_err());
    /// ```
    pub fn block(&mut self, cell: Cell) -> Result<(), PathError> {
        self.set_factor(cell, f64::INFINITY)
    }

    /// Sets the cost of a cell to `factor` times its length, for example near walls; infinity blocks it.
    ///
    /// # Errors
    /// [`PathError::Outside`], and [`PathError::Cost`] for factors below 1: straight lines must stay the lower bound.
    ///
    /// ```
    /// use r4_maths::path::Grid;
    /// let mut grid = Grid::new(3, 2, 1.0);
    /// grid.set_factor([1, 0], 9.0).unwrap();
    /// let path = grid.path([0, 0], [2, 0]).unwrap();
    /// assert!(!path.nodes.contains(&[1, 0]));
    /// ```
    pub fn set_factor(&mut self, cell: Cell, factor: f64) -> Result<(), PathError> {
        let index = self.index(cell)?;
        if factor.is_nan() || factor < 1.0 {
            return Err(PathError::Cost(factor));
        }
        self.factors[index] = factor;
        Ok(())
    }

    /// Finds the cheapest path between the centres of two cells, in eight directions. The cost is in m where all
    /// factors are 1.
    ///
    /// A step costs its length times the mean factor of both cells. A diagonal step needs both cells beside it free.
    ///
    /// # Errors
    /// [`PathError::Outside`], [`PathError::Blocked`] and [`PathError::Unreachable`].
    ///
    /// # Source
    /// Hart, Nilsson, Raphael 1968 (see [`astar`]); the octile distance as lower bound.
    ///
    /// ```
    /// let path = r4_maths::path::Grid::new(4, 4, 0.5).path([0, 0], [3, 3]).unwrap();
    /// assert!((path.cost - 1.5 * 2.0f64.sqrt()).abs() < 1e-12);
    /// ```
    pub fn path(&self, from: Cell, to: Cell) -> Result<Path<Cell>, PathError> {
        for cell in [from, to] {
            if self.factors[self.index(cell)?].is_infinite() {
                return Err(PathError::Blocked { column: cell[0], row: cell[1] });
            }
        }
        let octile_m = |cell: &Cell| {
            let [x, y] = [0, 1].map(|axis| cell[axis].abs_diff(to[axis]) as f64);
            // Smaller by more than rounding can add along the path, or the bound could exceed the cost by a last bit.
            self.cell_m * (x.max(y) + (std::f64::consts::SQRT_2 - 1.0) * x.min(y)) * (1.0 - 1e-12)
        };
        astar(from, |cell, steps| self.steps(*cell, steps), octile_m, |cell| *cell == to)
    }

    fn steps(&self, cell: Cell, steps: &mut Vec<(Cell, f64)>) {
        let here = self.factor(cell[0], cell[1]);
        for (dx, dy) in [(1, 0), (0, 1), (-1, 0), (0, -1), (1, 1), (-1, 1), (-1, -1), (1, -1)] {
            let (Some(x), Some(y)) = (cell[0].checked_add_signed(dx), cell[1].checked_add_signed(dy)) else { continue };
            let is_diagonal = dx != 0 && dy != 0;
            let beside = self.factor(x, cell[1]).max(self.factor(cell[0], y));
            if is_diagonal && beside.is_infinite() {
                continue;
            }
            let length_m = self.cell_m * if is_diagonal { std::f64::consts::SQRT_2 } else { 1.0 };
            let factor = f64::midpoint(here, self.factor(x, y));
            if factor.is_finite() {
                steps.push(([x, y], length_m * factor));
            }
        }
    }

    /// Returns the factor of a cell; infinite outside of the grid.
    fn factor(&self, column: usize, row: usize) -> f64 {
        self.index([column, row]).map_or(f64::INFINITY, |index| self.factors[index])
    }

    fn index(&self, [column, row]: Cell) -> Result<usize, PathError> {
        let Self { columns, rows, .. } = *self;
        if column < columns && row < rows {
            Ok(row * columns + column)
        } else {
            Err(PathError::Outside { column, row, columns, rows })
        }
    }
}
