//! Free cells as nodes of a graph.

use super::FieldError;
use crate::grid::{Cell, Frame, Grid};

/// Index in place of a neighbour that is not free, or off the grid.
pub(super) const NONE: u32 = u32::MAX;

/// Free cells, numbered row by row, and their free neighbours in +x, +y, -x, -y.
#[derive(Clone, Debug)]
pub(super) struct Lattice {
    nodes: Grid<u32>,
    cells: Vec<u32>,
    pub(super) neighbours: Vec<[u32; 4]>,
}

/// Returns the opposite direction.
pub(super) const fn back(direction: usize) -> usize {
    (direction + 2) % 4
}

impl Lattice {
    pub(super) fn new(free: &Grid<bool>) -> Self {
        let mut cells = Vec::new();
        let mut nodes = free.map(|_| NONE);
        for (index, _) in free.values().iter().enumerate().filter(|(_, free)| **free) {
            // A frame has at most 2²⁸ cells.
            nodes.values_mut()[index] = cells.len() as u32;
            cells.push(index as u32);
        }
        let frame = *free.frame();
        let (columns, rows) = (frame.columns(), frame.rows());
        let neighbours = cells.iter().map(|index| {
            let at = *index as usize;
            let [column, row] = frame.cell(at);
            let node = |is_inside: bool, index: usize| if is_inside { nodes.values()[index] } else { NONE };
            [
                node(column + 1 < columns, at + 1),
                node(row + 1 < rows, at + columns),
                node(column > 0, at.wrapping_sub(1)),
                node(row > 0, at.wrapping_sub(columns)),
            ]
        });
        Self { neighbours: neighbours.collect(), nodes, cells }
    }

    pub(super) const fn frame(&self) -> &Frame {
        self.nodes.frame()
    }

    pub(super) const fn nodes(&self) -> usize {
        self.cells.len()
    }

    pub(super) fn cell(&self, node: usize) -> Cell {
        self.frame().cell(self.cells[node] as usize)
    }

    pub(super) fn node(&self, cell: Cell) -> Result<usize, FieldError> {
        match *self.nodes.get(cell)? {
            NONE => Err(FieldError::NotFree { cell }),
            node => Ok(node as usize),
        }
    }

    /// Iterates over the nodes that share an edge with this one.
    pub(super) fn near(&self, node: usize) -> impl Iterator<Item = usize> + use<> {
        self.neighbours[node].into_iter().filter(|near| *near != NONE).map(|near| near as usize)
    }

    pub(super) fn grid(&self, value: impl Fn(usize) -> f64) -> Grid<Option<f64>> {
        self.nodes.map(|node| if *node == NONE { None } else { Some(value(*node as usize)) })
    }

    /// Adds the nodes of a rectangle of cells to `to`, row by row.
    pub(super) fn within(&self, columns: std::ops::Range<usize>, rows: std::ops::Range<usize>, to: &mut Vec<u32>) {
        for row in rows {
            let start = row * self.frame().columns();
            let nodes = &self.nodes.values()[start + columns.start..start + columns.end];
            to.extend(nodes.iter().filter(|node| **node != NONE));
        }
    }
}
