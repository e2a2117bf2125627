//! Floor plan of a hall: cells on which a field is mapped, cells in which the robot's centre may be, and paths over
//! them.

use r4_maps::{
    grid::{Cell, Frame, Grid},
    occupancy::{clearance_m, is_clear},
    plan::{distances_m, route},
    pose::{Point, Pose, distance_m},
};

/// Side of a mission's cell, m: a quarter of an aisle. The published maps have 0.2 m, at which times and errors are
/// measured.
pub const CELL_M: f64 = 0.5;
/// Distance of the robot's path from cells that are not free, between centres of cells, m: half a cell more than 0.75 m
/// from a wall.
const ROOM_M: f64 = 1.0;
/// Distance between the lawn-mower's rows, m: that between aisles.
const PITCH_M: f64 = 4.0;

/// Floor plan of a hall, as cells.
#[derive(Clone, Debug)]
pub struct Plan {
    walls_m: Vec<[Point; 2]>,
    free: Grid<bool>,
    roomy: Grid<bool>,
    cramped: Grid<bool>,
}

impl Plan {
    /// Computes the plan of a hall with these walls in cells of `cell_m`; the cells connected to `start_m` are free.
    ///
    /// # Errors
    /// The reason in words: no walls, a start outside them, or no position far enough from every wall.
    pub fn of(walls_m: Vec<[Point; 2]>, start_m: Point, cell_m: f64) -> Result<Self, String> {
        let points = || walls_m.iter().flatten();
        let bound = |axis: usize, of: fn(f64, f64) -> f64, from: f64| points().map(|point| point[axis]).fold(from, of);
        let low = [0, 1].map(|axis| bound(axis, f64::min, f64::INFINITY));
        let high = [0, 1].map(|axis| bound(axis, f64::max, f64::NEG_INFINITY));
        // A margin of one cell on each side, which is not free.
        let counts = [0, 1].map(|axis| ((high[axis] - low[axis]) / cell_m).round() as usize + 2);
        let origin = Pose::new(low[0] - cell_m, low[1] - cell_m, 0.0);
        let frame = Frame::new(origin, cell_m, counts[0], counts[1]).map_err(|error| error.to_string())?;
        let first = frame.cell_at(start_m).map_err(|error| format!("the start: {error}"))?;
        let mut free = Grid::filled(frame, false);
        let mut open = vec![first];
        while let Some(cell) = open.pop() {
            let Ok(seen) = free.get_mut(cell) else { continue };
            if std::mem::replace(seen, true) {
                continue;
            }
            let from = frame.centre(cell);
            let is_open = |next: &Cell| !walls_m.iter().any(|wall| crosses(*wall, [from, frame.centre(*next)]));
            open.extend(frame.neighbours(cell).filter(is_open));
        }
        let clear_m = clearance_m(&free.map(|free| !free));
        let roomy = Grid::from_fn(frame, |cell| {
            matches!(free.get(cell), Ok(true)) && clear_m.get(cell).is_ok_and(|clear_m| *clear_m >= ROOM_M)
        });
        if !roomy.values().contains(&true) {
            return Err(format!("no place is {ROOM_M} m from every wall"));
        }
        Ok(Self { cramped: roomy.map(|roomy| !roomy), walls_m, free, roomy })
    }

    /// Walls of the hall, both ends of each, m.
    #[must_use]
    pub fn walls_m(&self) -> &[[Point; 2]] {
        &self.walls_m
    }

    /// Cells that contain air.
    #[must_use]
    pub const fn free(&self) -> &Grid<bool> {
        &self.free
    }

    /// Cells in which the robot's centre may be.
    #[must_use]
    pub const fn roomy(&self) -> &Grid<bool> {
        &self.roomy
    }

    /// Cell of the robot's paths that is nearest to a position, within 2 m; `None` without one.
    #[must_use]
    pub fn nearest(&self, at: Point) -> Option<Cell> {
        let frame = self.roomy.frame();
        let [column, row] = frame.cell_at(at).ok()?;
        let reach = (2.0 / frame.cell_m()) as usize;
        let near = (row.saturating_sub(reach)..=row + reach)
            .flat_map(|row| (column.saturating_sub(reach)..=column + reach).map(move |column| [column, row]));
        let near = near.filter(|cell| matches!(self.roomy.get(*cell), Ok(true)));
        near.min_by(|a, b| distance_m(frame.centre(*a), at).total_cmp(&distance_m(frame.centre(*b), at)))
    }

    /// Lengths of the shortest paths from a position, m; `None` when it is far from every path.
    #[must_use]
    pub fn distances_m(&self, from: Point) -> Option<Grid<f64>> {
        distances_m(&self.roomy, self.nearest(from)?).ok()
    }

    /// Corners of the shortest path, without the first, m; `None` where there is none. The path avoids `blocked` cells.
    #[must_use]
    pub fn way(&self, from: Point, to: Point, blocked: &[Cell]) -> Option<Vec<Point>> {
        let frame = *self.roomy.frame();
        let mut roomy = self.roomy.clone();
        let start = self.nearest(from)?;
        for cell in blocked.iter().filter(|cell| **cell != start) {
            roomy.get_mut(*cell).map(|roomy| *roomy = false).ok()?;
        }
        let cells = route(&roomy, start, self.nearest(to)?).ok()?.nodes;
        let cramped = if blocked.is_empty() { &self.cramped } else { &roomy.map(|roomy| !roomy) };
        // A corner remains only where the straight line to the next cell would leave the roomy cells.
        let mut corners = Vec::new();
        let mut here = frame.centre(*cells.first()?);
        for pair in cells.windows(2) {
            let next = frame.centre(pair[1]);
            if !is_clear(cramped, here, next).unwrap_or(false) {
                here = frame.centre(pair[0]);
                corners.push(here);
            }
        }
        corners.push(frame.centre(*cells.last()?));
        Some(corners)
    }

    /// Ends of the lawn-mower's rows, m, from south to north, in alternating directions.
    #[must_use]
    pub fn rows_m(&self) -> Vec<[Point; 2]> {
        let frame = self.roomy.frame();
        let [low_m, high_m] = [[0, 0], [frame.columns() - 1, frame.rows() - 1]].map(|cell| frame.centre(cell));
        let mut rows = Vec::new();
        let mut y_m = low_m[1] + CELL_M / 2.0 + 5.0;
        while y_m < high_m[1] - 4.0 {
            let mut ends = [[low_m[0] + 4.0, y_m], [high_m[0] - 4.0, y_m]];
            if rows.len() % 2 == 1 {
                ends.reverse();
            }
            rows.push(ends);
            y_m += PITCH_M;
        }
        rows
    }
}

/// Returns true when two segments cross or touch.
fn crosses([a, b]: [Point; 2], [c, d]: [Point; 2]) -> bool {
    let side = |from: Point, to: Point, of: Point| {
        (to[0] - from[0]) * (of[1] - from[1]) - (to[1] - from[1]) * (of[0] - from[0])
    };
    side(a, b, c) * side(a, b, d) <= 0.0 && side(c, d, a) * side(c, d, b) <= 0.0
}
