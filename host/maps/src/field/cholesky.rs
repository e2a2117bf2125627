//! Marginal variances by selected inversion of a sparse Cholesky factor.

use super::lattice::Lattice;

/// Maximum number of cells of a rectangle that is not divided further.
const LEAF: usize = 32;

/// Returns the variances of all nodes: the diagonal of A⁻¹.
pub(super) fn marginal_variances(lattice: &Lattice, smoothness: f64, own: &[f64]) -> Vec<f64> {
    let mut order = Vec::with_capacity(lattice.nodes());
    let (columns, rows) = (lattice.frame().columns(), lattice.frame().rows());
    dissect(lattice, [0, columns], [0, rows], &mut order);
    let factor = Factor::new(lattice, smoothness, own, &order);
    let inverse = factor.selected_inverse();
    let mut variances = vec![0.0; order.len()];
    order.iter().zip(inverse).for_each(|(node, variance)| variances[*node as usize] = variance);
    variances
}

/// Finds the order of elimination by nested dissection: two halves first, then the line of cells between them.
fn dissect(lattice: &Lattice, columns: [usize; 2], rows: [usize; 2], order: &mut Vec<u32>) {
    let [wide, high] = [columns[1] - columns[0], rows[1] - rows[0]];
    if wide * high <= LEAF {
        lattice.within(columns[0]..columns[1], rows[0]..rows[1], order);
    } else if wide >= high {
        let middle = columns[0] + wide / 2;
        dissect(lattice, [columns[0], middle], rows, order);
        dissect(lattice, [middle + 1, columns[1]], rows, order);
        lattice.within(middle..middle + 1, rows[0]..rows[1], order);
    } else {
        let middle = rows[0] + high / 2;
        dissect(lattice, columns, [rows[0], middle], order);
        dissect(lattice, columns, [middle + 1, rows[1]], order);
        lattice.within(columns[0]..columns[1], middle..middle + 1, order);
    }
}

/// Factor A = L D Lᵀ with a unit lower triangle, which is kept by columns without its diagonal, rows ascending.
struct Factor {
    starts: Vec<usize>,
    rows: Vec<u32>,
    values: Vec<f64>,
    diagonal: Vec<f64>,
}

const NO_PARENT: u32 = u32::MAX;

impl Factor {
    /// Computes the factor row by row.
    ///
    /// Source: Davis, *Direct Methods for Sparse Linear Systems*, SIAM 2006, 4.1 to 4.7 (elimination tree, row patterns, up-looking
    /// factor).
    fn new(lattice: &Lattice, smoothness: f64, own: &[f64], order: &[u32]) -> Self {
        let nodes = order.len();
        let mut place = vec![0u32; nodes];
        order.iter().enumerate().for_each(|(at, node)| place[*node as usize] = at as u32);
        let before = |row: usize| {
            let near = lattice.near(order[row] as usize).map(|near| place[near] as usize);
            near.filter(move |column| *column < row)
        };
        let mut parent = vec![NO_PARENT; nodes];
        let mut mark = vec![NO_PARENT; nodes];
        let mut counts = vec![0usize; nodes];
        for row in 0..nodes {
            mark[row] = row as u32;
            for mut column in before(row) {
                while mark[column] != row as u32 {
                    if parent[column] == NO_PARENT {
                        parent[column] = row as u32;
                    }
                    counts[column] += 1;
                    mark[column] = row as u32;
                    column = parent[column] as usize;
                }
            }
        }
        let mut starts = vec![0; nodes + 1];
        (0..nodes).for_each(|column| starts[column + 1] = starts[column] + counts[column]);
        let (mut rows, mut values) = (vec![0u32; starts[nodes]], vec![0.0; starts[nodes]]);
        let mut ends = starts.clone();
        let (mut y, mut diagonal) = (vec![0.0; nodes], vec![0.0; nodes]);
        let (mut stack, mut path): (Vec<usize>, Vec<usize>) = (Vec::new(), Vec::new());
        mark.fill(NO_PARENT);
        for row in 0..nodes {
            // Pattern of this row in topological order: paths up the elimination tree, the last found first.
            stack.clear();
            mark[row] = row as u32;
            for mut column in before(row) {
                y[column] -= smoothness;
                path.clear();
                while mark[column] != row as u32 {
                    path.push(column);
                    mark[column] = row as u32;
                    column = parent[column] as usize;
                }
                stack.extend(path.iter().rev());
            }
            let node = order[row] as usize;
            let mut pivot = own[node] + smoothness * lattice.near(node).count() as f64;
            for column in stack.drain(..).rev() {
                let value: f64 = std::mem::take(&mut y[column]);
                let range = starts[column]..ends[column];
                for (below, l) in rows[range.clone()].iter().zip(&values[range]) {
                    y[*below as usize] -= l * value;
                }
                let l = value / diagonal[column];
                pivot -= l * value;
                rows[ends[column]] = row as u32;
                values[ends[column]] = l;
                ends[column] += 1;
            }
            diagonal[row] = pivot;
        }
        Self { starts, rows, values, diagonal }
    }

    /// Computes the diagonal of the inverse by Takahashi's equations, from the last column to the first.
    ///
    /// Z = A⁻¹ has, on the pattern of L, Zᵢⱼ = -Σ Zᵢₖ Lₖⱼ and Zⱼⱼ = 1/Dⱼ - Σ Lₖⱼ Zₖⱼ, sums over the rows k of column j.
    /// All Zᵢₖ in these sums are on the pattern too.
    fn selected_inverse(&self) -> Vec<f64> {
        let nodes = self.diagonal.len();
        let mut inverse = vec![0.0; self.values.len()];
        let mut variances = vec![0.0; nodes];
        // Place of a row in the present column, from 1.
        let mut place = vec![0u32; nodes];
        let mut sums = Vec::new();
        for column in (0..nodes).rev() {
            let range = self.starts[column]..self.starts[column + 1];
            let (rows, values) = (&self.rows[range.clone()], &self.values[range.clone()]);
            sums.clear();
            sums.resize(rows.len(), 0.0);
            rows.iter().enumerate().for_each(|(at, row)| place[*row as usize] = at as u32 + 1);
            let last = rows.last().copied().unwrap_or(0);
            for (at, row) in rows.iter().enumerate() {
                let row = *row as usize;
                sums[at] += variances[row] * values[at];
                let below = self.starts[row]..self.starts[row + 1];
                let mut sum = 0.0;
                for (other, z) in self.rows[below.clone()].iter().zip(&inverse[below]) {
                    let there = place[*other as usize] as usize;
                    if there > 0 {
                        sum += z * values[there - 1];
                        sums[there - 1] += z * values[at];
                    } else if *other > last {
                        break;
                    }
                }
                sums[at] += sum;
            }
            let mut variance = self.diagonal[column].recip();
            for (at, row) in rows.iter().enumerate() {
                place[*row as usize] = 0;
                inverse[range.start + at] = -sums[at];
                variance += values[at] * sums[at];
            }
            variances[column] = variance;
        }
        variances
    }
}
