//! Paths over an occupancy grid, and the next speeds that follow one.

mod window;

use std::{cmp::Reverse, collections::BinaryHeap};

use r4_maths::path::{Grid as Costs, Path, PathError};
use thiserror::Error;
pub use window::{Blocked, Choice, Drive, Limits, Local, Preference};

use crate::grid::{Cell, Grid, GridError};

/// Error of a path that cannot be planned.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum PlanError {
    /// The grid does not have this place.
    #[error(transparent)]
    Grid(#[from] GridError),
    /// There is no path, or the start or goal is not free.
    #[error(transparent)]
    Path(#[from] PathError),
    /// A parameter of the drive or the planner is out of range.
    #[error("{what} is {value}: a finite number above 0 is needed")]
    Parameter {
        /// Name of the parameter.
        what: &'static str,
        /// Value of the parameter.
        value: f64,
    },
}

/// Returns the lengths, m, of the shortest paths from a cell to all others over free cells in eight directions;
/// infinite where there is none.
///
/// Diagonal steps need both cells beside them free, as in [`route`], which has the same costs.
///
/// # Errors
/// [`PlanError::Grid`], and [`PathError::Blocked`] for a start that is not free.
///
/// # Source
/// Dijkstra, "A Note on Two Problems in Connexion with Graphs", Numerische Mathematik 1, 1959.
///
/// ```
/// use r4_maps::{grid::{Frame, Grid}, plan::distances_m, pose::Pose};
/// let free = Grid::from_fn(Frame::new(Pose::default(), 0.5, 3, 3).unwrap(), |[column, row]| column != 1 || row == 2);
/// let distances_m = distances_m(&free, [0, 0]).unwrap();
/// // Through the gap at the top: corners are not cut.
/// assert!((distances_m.get([2, 0]).unwrap() - 3.0).abs() < 1e-12);
/// assert!(distances_m.get([1, 0]).unwrap().is_infinite());
/// ```
pub fn distances_m(free: &Grid<bool>, from: Cell) -> Result<Grid<f64>, PlanError> {
    let frame = *free.frame();
    let start = frame.index(from)?;
    if !free.values()[start] {
        return Err(PathError::Blocked { column: from[0], row: from[1] }.into());
    }
    let mut distances_m = Grid::filled(frame, f64::INFINITY);
    let best_m = distances_m.values_mut();
    best_m[start] = 0.0;
    // The bits of a non-negative number have its order.
    let mut open = BinaryHeap::from([Reverse((0.0f64.to_bits(), start))]);
    let is_free = |cell: Cell| matches!(free.get(cell), Ok(true));
    while let Some(Reverse((bits, index))) = open.pop() {
        let so_far_m = f64::from_bits(bits);
        if so_far_m > best_m[index] {
            continue;
        }
        let cell = frame.cell(index);
        for next in frame.neighbours_8(cell).filter(|next| is_free(*next)) {
            let is_diagonal = next[0] != cell[0] && next[1] != cell[1];
            if is_diagonal && !(is_free([next[0], cell[1]]) && is_free([cell[0], next[1]])) {
                continue;
            }
            let step_m = frame.cell_m() * if is_diagonal { std::f64::consts::SQRT_2 } else { 1.0 };
            let there = next[1] * frame.columns() + next[0];
            if so_far_m + step_m < best_m[there] {
                best_m[there] = so_far_m + step_m;
                open.push(Reverse((best_m[there].to_bits(), there)));
            }
        }
    }
    Ok(distances_m)
}

/// Finds the shortest path between two cells over free cells, by A* ([`r4_maths::path`]); its cost is in m.
///
/// # Errors
/// [`PlanError::Path`].
pub fn route(free: &Grid<bool>, from: Cell, to: Cell) -> Result<Path<Cell>, PlanError> {
    let frame = free.frame();
    let mut costs = Costs::new(frame.columns(), frame.rows(), frame.cell_m());
    for (cell, _) in free.iter().filter(|(_, free)| !**free) {
        costs.block(cell)?;
    }
    Ok(costs.path(from, to)?)
}
