//! Choice of the next goal: the paper's utility, and ours.

use r4_maps::{
    grid::{Cell, Grid},
    pose::Point,
};

use super::{plan::Plan, survey::limits};

/// Distance between candidate goals, in cells.
const EVERY: usize = 4;
/// Number of cells to each side of a reading about which it gives information: 0.75 m, less than half an aisle.
const NEAR: usize = 1;
/// Distance of the nearest goal, m: nearer ones lie on the way to others.
const NEAREST_M: f64 = 2.0;

/// Variances by which a goal is chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Variances {
    /// Exact marginal variances of the field.
    Exact,
    /// Variances of belief propagation, which are too small.
    Propagated,
}

/// Utility of a goal.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Utility {
    /// The paper's utility `w1 σ²/σ²max + w2 µ/µmax - w4 d/dmax`; the frontier's term is 0 on a known floor plan.
    Weighted {
        /// Weights of variance, mean and path length.
        weights: [f64; 3],
        /// Variances that the utility uses.
        by: Variances,
    },
    /// Expected squared error along the path that its readings remove, per second of travel. The standard error of a
    /// concentration grows with it, so that `error² = σ² (µ + floor)²`, with σ² relative to that of a cell without
    /// readings.
    ErrorRate {
        /// Concentration added to that of each cell, ppm: the weight of cells without gas.
        floor_ppm: f64,
        /// Time that a goal takes besides driving, s.
        overhead_s: f64,
        /// Variances that the utility uses.
        by: Variances,
    },
}

impl Utility {
    /// Variances that the utility uses.
    #[must_use]
    pub const fn by(&self) -> Variances {
        let (Self::Weighted { by, .. } | Self::ErrorRate { by, .. }) = self;
        *by
    }

    /// Returns the best goal from a position; `None` where no goal can be reached. `blocked` cells are excluded.
    #[must_use]
    pub fn best(
        &self,
        plan: &Plan,
        means: &Grid<Option<f64>>,
        variances: &Grid<Option<f64>>,
        from: Point,
        blocked: &[Cell],
    ) -> Option<Point> {
        let distances_m = plan.distances_m(from)?;
        let frame = *plan.roomy().frame();
        let most = |grid: &Grid<Option<f64>>| grid.values().iter().flatten().copied().fold(1e-12, f64::max);
        let (most_mean, most_variance) = (most(means), most(variances));
        let farthest_m = distances_m.values().iter().copied().filter(|way_m| way_m.is_finite()).fold(1e-12, f64::max);
        let mean = |cell: Cell| means.get(cell).ok().copied().flatten().map(|mean| mean.max(0.0));
        let variance = |cell: Cell| Some(variances.get(cell).ok().copied().flatten()? / most_variance);
        let along = match *self {
            Self::Weighted { .. } => None,
            Self::ErrorRate { floor_ppm, .. } => {
                let error = |cell: Cell| Some(variance(cell)? * (mean(cell)? + floor_ppm).powi(2));
                Some(sums_along(&distances_m, |cell| {
                    let near = block(cell).filter_map(error);
                    near.sum::<f64>()
                }))
            }
        };
        let value = |cell: Cell| {
            let way_m = *distances_m.get(cell).ok()?;
            if !way_m.is_finite() || way_m < NEAREST_M || blocked.contains(&cell) {
                return None;
            }
            Some(match *self {
                Self::Weighted { weights: [by_variance, by_mean, by_path], .. } => {
                    by_variance * variance(cell)? + by_mean * mean(cell)? / most_mean - by_path * way_m / farthest_m
                }
                Self::ErrorRate { overhead_s, .. } => {
                    along.as_ref()?.get(cell).ok()? / (way_m / limits().speed_m_s + overhead_s)
                }
            })
        };
        let candidates = (0..frame.rows())
            .step_by(EVERY / 2)
            .flat_map(|row| (0..frame.columns()).step_by(EVERY).map(move |column| [column, row]));
        let valued = candidates.filter_map(|cell| Some((value(cell)?, cell)));
        let (_, cell) = valued.max_by(|a, b| a.0.total_cmp(&b.0))?;
        Some(frame.centre(cell))
    }
}

/// Cells about which a reading in `cell` gives information.
fn block([column, row]: Cell) -> impl Iterator<Item = Cell> {
    (row.saturating_sub(NEAR)..=row + NEAR)
        .flat_map(move |row| (column.saturating_sub(NEAR)..=column + NEAR).map(move |column| [column, row]))
}

/// Sums of a cell's worth along the shortest path to each cell, without the first cell.
fn sums_along(distances_m: &Grid<f64>, worth: impl Fn(Cell) -> f64) -> Grid<f64> {
    let frame = *distances_m.frame();
    // In the order of distance, so that each cell's predecessor has its sum before the cell itself.
    let distance_m = |cell: Cell| distances_m.get(cell).copied().unwrap_or(f64::INFINITY);
    let mut reached: Vec<Cell> =
        distances_m.iter().filter(|(_, way_m)| way_m.is_finite()).map(|(cell, _)| cell).collect();
    reached.sort_by(|a, b| distance_m(*a).total_cmp(&distance_m(*b)));
    let mut sums = Grid::filled(frame, 0.0);
    for cell in reached {
        let step_m = |near: &Cell| {
            let is_diagonal = near[0] != cell[0] && near[1] != cell[1];
            frame.cell_m() * if is_diagonal { std::f64::consts::SQRT_2 } else { 1.0 }
        };
        let before = frame.neighbours_8(cell).filter(|near| distance_m(*near) < distance_m(cell));
        let before = before.min_by(|a, b| (distance_m(*a) + step_m(a)).total_cmp(&(distance_m(*b) + step_m(b))));
        let Some(before) = before else { continue };
        let sum = sums.get(before).copied().unwrap_or(0.0) + worth(cell) * step_m(&before);
        if let Ok(of) = sums.get_mut(cell) {
            *of = sum;
        }
    }
    sums
}
