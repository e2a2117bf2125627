//! Cells that a straight line crosses.

use crate::{
    grid::{Cell, Frame, GridError},
    pose::{Point, distance_m},
};

/// Cell on a line, with the place where the line enters it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Crossing {
    /// Cell that the line crosses.
    pub cell: Cell,
    /// Length of the line up to the cell, m.
    pub entered_m: f64,
}

struct Walk {
    columns: usize,
    rows: usize,
    cell: Option<Cell>,
    step: [isize; 2],
    /// Share of the line at which the next boundary in x and y is crossed.
    next: [f64; 2],
    /// Share of the line from one boundary to the next.
    each: [f64; 2],
    entered: f64,
    length_m: f64,
}

/// Iterates over the cells that the line between two points of the world crosses, in order, up to its end or the grid's
/// border.
///
/// # Errors
/// [`GridError::Outside`] if the line does not start on the grid or does not end at a finite point.
///
/// # Source
/// Amanatides, Woo, "A Fast Voxel Traversal Algorithm for Ray Tracing", Eurographics 1987.
///
/// ```
/// use r4_maps::{grid::Frame, occupancy::traverse, pose::Pose};
/// let frame = Frame::new(Pose::default(), 1.0, 4, 4).unwrap();
/// let cells: Vec<_> = traverse(&frame, [0.5, 0.5], [2.5, 1.2]).unwrap().map(|crossing| crossing.cell).collect();
/// assert_eq!(cells, [[0, 0], [1, 0], [1, 1], [2, 1]]);
/// ```
pub fn traverse(frame: &Frame, from: Point, to: Point) -> Result<impl Iterator<Item = Crossing> + use<>, GridError> {
    let cell = frame.cell_at(from)?;
    if !(to[0].is_finite() && to[1].is_finite()) {
        return Err(GridError::Outside { x_m: to[0], y_m: to[1] });
    }
    let (start, end) = (frame.continuous(from), frame.continuous(to));
    let mut walk = Walk {
        columns: frame.columns(),
        rows: frame.rows(),
        cell: Some(cell),
        step: [0; 2],
        next: [f64::INFINITY; 2],
        each: [f64::INFINITY; 2],
        entered: 0.0,
        length_m: distance_m(from, to),
    };
    for axis in 0..2 {
        let along = end[axis] - start[axis];
        // A line along an axis never crosses a boundary of the other one, whose `next` stays infinite.
        if along != 0.0 {
            let is_up = along > 0.0;
            let boundary = cell[axis] as f64 + if is_up { 1.0 } else { 0.0 };
            walk.step[axis] = if is_up { 1 } else { -1 };
            walk.next[axis] = (boundary - start[axis]) / along;
            walk.each[axis] = along.abs().recip();
        }
    }
    Ok(walk)
}

impl Iterator for Walk {
    type Item = Crossing;

    fn next(&mut self) -> Option<Crossing> {
        let cell = self.cell?;
        let crossing = Crossing { cell, entered_m: self.entered * self.length_m };
        // The nearer boundary decides the next cell.
        let axis = usize::from(self.next[1] < self.next[0]);
        self.entered = self.next[axis];
        self.cell = None;
        // An end on a boundary belongs to the cell before it.
        if self.entered < 1.0
            && let Some(along) = cell[axis].checked_add_signed(self.step[axis])
            && along < [self.columns, self.rows][axis]
        {
            let mut next = cell;
            next[axis] = along;
            self.cell = Some(next);
            self.next[axis] += self.each[axis];
        }
        Some(crossing)
    }
}
