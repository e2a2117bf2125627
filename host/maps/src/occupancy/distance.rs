//! Exact Euclidean distances to marked cells.

use crate::grid::Grid;

/// Returns distances, m; see [`super::clearance_m`].
pub(super) fn transform(marked: &Grid<bool>) -> Grid<f64> {
    let (columns, rows) = (marked.frame().columns(), marked.frame().rows());
    let mut squared = marked.map(|marked| if *marked { 0.0 } else { f64::INFINITY });
    let mut hull = Hull::default();
    let values = squared.values_mut();
    let mut line = Vec::new();
    // The squared distance separates: along the columns first, then along the rows of the result.
    for column in 0..columns {
        line.clear();
        line.extend((0..rows).map(|row| values[row * columns + column]));
        hull.of(&line);
        (0..rows).for_each(|row| values[row * columns + column] = hull.next(row, &line));
    }
    for row in values.chunks_exact_mut(columns) {
        line.clear();
        line.extend_from_slice(row);
        hull.of(&line);
        row.iter_mut().enumerate().for_each(|(column, value)| *value = hull.next(column, &line));
    }
    squared.map(|squared| squared.sqrt() * marked.frame().cell_m())
}

/// Lower envelope of the parabolas `(x - at)² + line[at]`.
#[derive(Default)]
struct Hull {
    /// Parabolas of the envelope: the vertex, and the x from which on it is the lowest.
    parabolas: Vec<(usize, f64)>,
    current: usize,
}

impl Hull {
    fn of(&mut self, line: &[f64]) {
        self.parabolas.clear();
        self.current = 0;
        for (at, height) in line.iter().enumerate().filter(|(_, height)| height.is_finite()) {
            let mut from = f64::NEG_INFINITY;
            // A parabola that is nowhere the lowest any more is removed.
            while let Some(&(other, other_from)) = self.parabolas.last() {
                let [x, other_x] = [at as f64, other as f64];
                from = (height + x * x - line[other] - other_x * other_x) / (2.0 * (x - other_x));
                if from > other_from {
                    break;
                }
                self.parabolas.pop();
                from = f64::NEG_INFINITY;
            }
            self.parabolas.push((at, from));
        }
    }

    /// Returns the squared distance at `x`, in cells. `x` must grow from call to call.
    fn next(&mut self, x: usize, line: &[f64]) -> f64 {
        while self.parabolas.get(self.current + 1).is_some_and(|(_, from)| *from < x as f64) {
            self.current += 1;
        }
        let parabola = self.parabolas.get(self.current);
        parabola.map_or(f64::INFINITY, |(at, _)| (x as f64 - *at as f64).powi(2) + line[*at])
    }
}
