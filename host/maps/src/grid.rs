//! Grid of square cells in the plane.

pub use r4_maths::path::Cell;
use thiserror::Error;

use crate::pose::{Point, Pose};

/// Error of a grid that cannot be made, or of a place that it does not have.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum GridError {
    /// The cell size is not greater than 0, or the origin is not finite.
    #[error("cells of {cell_m} m at {origin:?}: give a cell size above 0 and a finite origin")]
    Frame {
        /// Side of a cell, m.
        cell_m: f64,
        /// Pose of the grid's corner.
        origin: Pose,
    },
    /// The grid has no cells, or more than [`Frame::MAX_CELLS`].
    #[error("{columns} × {rows} cells: a grid has 1 to {max} of them", max = Frame::MAX_CELLS)]
    Size {
        /// Number of cells in x.
        columns: usize,
        /// Number of cells in y.
        rows: usize,
    },
    /// The point is not on the grid, or not finite.
    #[error("the point {x_m} m, {y_m} m is not on the grid: choose one inside, or make the grid larger")]
    Outside {
        /// x in the world, m.
        x_m: f64,
        /// y in the world, m.
        y_m: f64,
    },
    /// The cell is not on the grid.
    #[error("cell {column}, {row} is outside the grid of {columns} × {rows}")]
    NoCell {
        /// Column of the cell, from 0.
        column: usize,
        /// Row of the cell, from 0.
        row: usize,
        /// Number of columns of the grid.
        columns: usize,
        /// Number of rows of the grid.
        rows: usize,
    },
    /// The number of values is not that of the cells.
    #[error("{values} values for {cells} cells: give one for each")]
    Values {
        /// Number of values given.
        values: usize,
        /// Number of cells of the grid.
        cells: usize,
    },
    /// Two grids that have to cover the same cells do not.
    #[error("the two grids have different frames: make both from one")]
    Unlike,
}

/// Place of a grid in the world, and its division into cells.
///
/// The origin is the outer corner of cell `[0, 0]`. Columns count along the frame's x axis, rows along its y axis (REP 103: x
/// forward, y left), and the frame's yaw turns both.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    origin: Pose,
    cell_m: f64,
    columns: usize,
    rows: usize,
}

impl Frame {
    /// Highest number of cells: indices fit 32 bits, and one `f64` a cell is 2 GiB.
    pub const MAX_CELLS: usize = 1 << 28;

    /// Makes the frame of `columns` × `rows` cells with sides of `cell_m`, its corner at `origin`.
    ///
    /// # Errors
    /// [`GridError::Frame`] and [`GridError::Size`].
    pub fn new(origin: Pose, cell_m: f64, columns: usize, rows: usize) -> Result<Self, GridError> {
        if !(cell_m > 0.0 && cell_m.is_finite() && origin.is_finite()) {
            return Err(GridError::Frame { cell_m, origin });
        }
        match columns.checked_mul(rows) {
            Some(1..=Self::MAX_CELLS) => Ok(Self { origin, cell_m, columns, rows }),
            _ => Err(GridError::Size { columns, rows }),
        }
    }

    /// Returns the pose of the outer corner of cell `[0, 0]`.
    #[must_use]
    pub const fn origin(&self) -> Pose {
        self.origin
    }

    /// Returns the side of a cell, m.
    #[must_use]
    pub const fn cell_m(&self) -> f64 {
        self.cell_m
    }

    /// Returns the number of cells in x.
    #[must_use]
    pub const fn columns(&self) -> usize {
        self.columns
    }

    /// Returns the number of cells in y.
    #[must_use]
    pub const fn rows(&self) -> usize {
        self.rows
    }

    /// Returns the number of cells.
    #[must_use]
    pub const fn cells(&self) -> usize {
        self.columns * self.rows
    }

    /// Returns the cell in which a point of the world lies. The lower edges belong to a cell, the upper ones to the
    /// next.
    ///
    /// # Errors
    /// [`GridError::Outside`].
    ///
    /// ```
    /// use r4_maps::{grid::Frame, pose::Pose};
    /// let frame = Frame::new(Pose::new(-1.0, -1.0, 0.0), 0.5, 4, 4).unwrap();
    /// assert_eq!(frame.cell_at([0.1, -0.6]), Ok([2, 0]));
    /// assert!(frame.cell_at([1.1, 0.0]).is_err());
    /// ```
    pub fn cell_at(&self, [x_m, y_m]: Point) -> Result<Cell, GridError> {
        let [column, row] = self.continuous([x_m, y_m]).map(f64::floor);
        // NaN fails both comparisons.
        if column >= 0.0 && row >= 0.0 && column < self.columns as f64 && row < self.rows as f64 {
            Ok([column as usize, row as usize])
        } else {
            Err(GridError::Outside { x_m, y_m })
        }
    }

    /// Returns the centre of a cell in the world, m; also for cells beyond the grid, as if it went on.
    #[must_use]
    pub fn centre(&self, [column, row]: Cell) -> Point {
        self.origin.outer([(column as f64 + 0.5) * self.cell_m, (row as f64 + 0.5) * self.cell_m])
    }

    /// Returns the coordinates of a point in the grid, in cells: `[0.5, 0.5]` is the centre of cell `[0, 0]`.
    #[must_use]
    pub fn continuous(&self, point: Point) -> Point {
        self.origin.inner(point).map(|along_m| along_m / self.cell_m)
    }

    /// Returns the index of a cell in [`Grid::values`], which is row by row.
    ///
    /// # Errors
    /// [`GridError::NoCell`].
    pub fn index(&self, [column, row]: Cell) -> Result<usize, GridError> {
        let Self { columns, rows, .. } = *self;
        if column < columns && row < rows {
            Ok(row * columns + column)
        } else {
            Err(GridError::NoCell { column, row, columns, rows })
        }
    }

    /// Returns the cell of an index in [`Grid::values`]: the inverse of [`Frame::index`].
    #[must_use]
    pub const fn cell(&self, index: usize) -> Cell {
        [index % self.columns, index / self.columns]
    }

    /// Iterates over the cells that share an edge with this one, as far as they are on the grid: in +x, +y, -x, -y.
    pub fn neighbours(&self, cell: Cell) -> impl Iterator<Item = Cell> + use<> {
        self.around(cell, &EDGES)
    }

    /// Iterates over the cells that share an edge or a corner with this one, as far as they are on the grid.
    pub fn neighbours_8(&self, cell: Cell) -> impl Iterator<Item = Cell> + use<> {
        self.around(cell, &AROUND)
    }

    fn around(&self, [column, row]: Cell, steps: &'static [[isize; 2]]) -> impl Iterator<Item = Cell> + use<> {
        let Self { columns, rows, .. } = *self;
        steps.iter().filter_map(move |[dx, dy]| {
            let cell = [column.checked_add_signed(*dx)?, row.checked_add_signed(*dy)?];
            (cell[0] < columns && cell[1] < rows).then_some(cell)
        })
    }
}

const EDGES: [[isize; 2]; 4] = [[1, 0], [0, 1], [-1, 0], [0, -1]];
const AROUND: [[isize; 2]; 8] = [[1, 0], [0, 1], [-1, 0], [0, -1], [1, 1], [-1, 1], [-1, -1], [1, -1]];

/// Values on a frame, one for each cell.
///
/// ```
/// use r4_maps::{grid::{Frame, Grid}, pose::Pose};
/// let mut seen = Grid::filled(Frame::new(Pose::default(), 0.2, 5, 3).unwrap(), 0u32);
/// *seen.get_mut([4, 2]).unwrap() += 1;
/// assert_eq!(seen.at([0.95, 0.45]), Ok(&1));
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Grid<T> {
    frame: Frame,
    values: Vec<T>,
}

impl<T> Grid<T> {
    /// Makes a grid with the same value in each cell.
    pub fn filled(frame: Frame, value: T) -> Self
    where
        T: Clone,
    {
        Self { values: vec![value; frame.cells()], frame }
    }

    /// Makes a grid of values given row by row.
    ///
    /// # Errors
    /// [`GridError::Values`].
    pub fn of(frame: Frame, values: Vec<T>) -> Result<Self, GridError> {
        if values.len() == frame.cells() {
            Ok(Self { frame, values })
        } else {
            Err(GridError::Values { values: values.len(), cells: frame.cells() })
        }
    }

    /// Makes a grid of the value that `value` returns for each cell.
    pub fn from_fn(frame: Frame, mut value: impl FnMut(Cell) -> T) -> Self {
        Self { values: (0..frame.cells()).map(|index| value(frame.cell(index))).collect(), frame }
    }

    /// Returns the frame of the grid.
    pub const fn frame(&self) -> &Frame {
        &self.frame
    }

    /// Returns the value of a cell.
    ///
    /// # Errors
    /// [`GridError::NoCell`].
    pub fn get(&self, cell: Cell) -> Result<&T, GridError> {
        self.frame.index(cell).map(|index| &self.values[index])
    }

    /// Returns the value of a cell for a change.
    ///
    /// # Errors
    /// [`GridError::NoCell`].
    pub fn get_mut(&mut self, cell: Cell) -> Result<&mut T, GridError> {
        self.frame.index(cell).map(|index| &mut self.values[index])
    }

    /// Returns the value of the cell in which a point of the world lies.
    ///
    /// # Errors
    /// [`GridError::Outside`].
    pub fn at(&self, point: Point) -> Result<&T, GridError> {
        self.frame.cell_at(point).and_then(|cell| self.get(cell))
    }

    /// Returns all values, row by row.
    pub fn values(&self) -> &[T] {
        &self.values
    }

    /// Returns all values for a change, row by row.
    pub fn values_mut(&mut self) -> &mut [T] {
        &mut self.values
    }

    /// Iterates over the cells with their values, row by row.
    pub fn iter(&self) -> impl Iterator<Item = (Cell, &T)> {
        self.values.iter().enumerate().map(|(index, value)| (self.frame.cell(index), value))
    }

    /// Makes a grid of the same frame with another value for each of this one's.
    pub fn map<U>(&self, value: impl FnMut(&T) -> U) -> Grid<U> {
        Grid { frame: self.frame, values: self.values.iter().map(value).collect() }
    }
}

impl Grid<f64> {
    /// Returns the value at a point of the world, bilinear between the centres of cells; within half a cell of the
    /// border that of the border's cells.
    ///
    /// # Errors
    /// [`GridError::Outside`].
    pub fn interpolated(&self, point: Point) -> Result<f64, GridError> {
        self.frame.cell_at(point)?;
        let at = self.frame.continuous(point).map(|along| along - 0.5);
        let last = [self.frame.columns - 1, self.frame.rows - 1];
        let low = [0, 1].map(|axis| (at[axis].max(0.0) as usize).min(last[axis]));
        let high = [0, 1].map(|axis| (low[axis] + 1).min(last[axis]));
        let [u, v] = [0, 1].map(|axis| (at[axis] - low[axis] as f64).clamp(0.0, 1.0));
        let value = |column: usize, row: usize| self.values[row * self.frame.columns + column];
        let lower = value(low[0], low[1]) * (1.0 - u) + value(high[0], low[1]) * u;
        let upper = value(low[0], high[1]) * (1.0 - u) + value(high[0], high[1]) * u;
        Ok(lower * (1.0 - v) + upper * v)
    }
}

/// Scalar field on a grid, with the unit of its values.
#[derive(Clone, Debug, PartialEq)]
pub struct ScalarGrid {
    /// Grid of the values.
    pub grid: Grid<f64>,
    /// Unit of the values as it is printed, such as `ppm` or `V/m`.
    pub unit: String,
}

impl ScalarGrid {
    /// Returns the least and the greatest finite value; `None` if there is none.
    ///
    /// ```
    /// use r4_maps::{grid::{Frame, Grid, ScalarGrid}, pose::Pose};
    /// let grid = Grid::of(Frame::new(Pose::default(), 1.0, 3, 1).unwrap(), vec![2.0, f64::NAN, -1.0]).unwrap();
    /// assert_eq!(ScalarGrid { grid, unit: "V/m".into() }.range(), Some([-1.0, 2.0]));
    /// ```
    #[must_use]
    pub fn range(&self) -> Option<[f64; 2]> {
        let finite = self.grid.values.iter().copied().filter(|value| value.is_finite());
        finite.fold(None, |range: Option<[f64; 2]>, value| {
            Some(range.map_or([value; 2], |[low, high]| [low.min(value), high.max(value)]))
        })
    }
}
