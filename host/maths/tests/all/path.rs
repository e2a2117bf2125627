//! Comparison of paths with those of SciPy's Dijkstra.

use proptest::{collection::vec, prelude::*};
use r4_maths::path::{Grid, PathError, astar};
use serde::Deserialize;

use crate::oracle::{SUMS, cases};

#[derive(Deserialize)]
struct Case {
    /// Factors of the cells by rows; `None` is blocked.
    factors: Vec<Vec<Option<f64>>>,
    /// Costs from the first cell; `None` is out of reach.
    costs: Vec<Vec<Option<f64>>>,
}

#[test]
fn paths_cost_what_scipys_dijkstra_says() {
    const CELL_M: f64 = 0.25;
    for Case { factors, costs } in cases::<Case>("grids") {
        let mut grid = Grid::new(factors[0].len(), factors.len(), CELL_M);
        for (row, factors) in factors.iter().enumerate() {
            for (column, factor) in factors.iter().enumerate() {
                grid.set_factor([column, row], factor.unwrap_or(f64::INFINITY)).unwrap();
            }
        }
        let mut reached = 0;
        for (row, costs) in costs.iter().enumerate() {
            for (column, cost) in costs.iter().enumerate() {
                let found = grid.path([0, 0], [column, row]);
                match (cost, factors[row][column]) {
                    (Some(cost), _) => {
                        let found = found.unwrap();
                        // Another one of equally cheap paths has its sum in another order.
                        assert!(
                            (found.cost - CELL_M * cost).abs() <= SUMS * found.cost,
                            "{column} {row}: {found:?} {cost}"
                        );
                        assert_eq!((found.nodes[0], found.nodes.last()), ([0, 0], Some(&[column, row])));
                        reached += 1;
                    }
                    (None, Some(_)) => assert!(matches!(found, Err(PathError::Unreachable { .. })), "{column} {row}"),
                    (None, None) => assert_eq!(found, Err(PathError::Blocked { column, row })),
                }
            }
        }
        assert!(reached > 20, "{reached}");
    }
}

#[test]
fn impossible_requests_are_refused() {
    let mut grid = Grid::new(3, 2, 0.1);
    assert_eq!(grid.block([3, 0]), Err(PathError::Outside { column: 3, row: 0, columns: 3, rows: 2 }));
    assert_eq!(grid.set_factor([0, 0], 0.5), Err(PathError::Cost(0.5)));
    assert!(matches!(grid.set_factor([0, 0], f64::NAN), Err(PathError::Cost(_))));
    assert!(matches!(grid.path([0, 0], [0, 2]), Err(PathError::Outside { .. })));
    assert_eq!(grid.path([1, 1], [1, 1]).map(|path| (path.nodes, path.cost)), Ok((vec![[1, 1]], 0.0)));
    [0, 1].into_iter().for_each(|row| grid.block([1, row]).unwrap());
    assert_eq!(grid.path([0, 0], [2, 0]), Err(PathError::Unreachable { expanded: 2 }));
    assert!(matches!(Grid::new(0, 0, 0.1).path([0, 0], [0, 0]), Err(PathError::Outside { .. })));

    let backwards = |_: &u8, steps: &mut Vec<(u8, f64)>| steps.push((1, -1.0));
    assert_eq!(astar(0u8, backwards, |_| 0.0, |node| *node == 1), Err(PathError::Cost(-1.0)));
}

proptest! {
    #[test]
    fn a_lower_bound_changes_the_work_and_not_the_cost(blocked in vec(any::<bool>(), 64), goal in 0..64usize) {
        let free = |cell: usize| !blocked[cell] || cell.is_multiple_of(3);
        let steps = |cell: &usize, to: &mut Vec<(usize, f64)>| {
            let (x, y) = (cell % 8, cell / 8);
            let around = [(x > 0, -1isize), (x < 7, 1), (y > 0, -8), (y < 7, 8)];
            let near = around.into_iter().filter(|near| near.0).map(|near| cell.wrapping_add_signed(near.1));
            to.extend(near.filter(|near| free(*near)).map(|near| (near, 1.0 + (near % 5) as f64)));
        };
        let away = |cell: &usize| ((cell % 8).abs_diff(goal % 8) + (cell / 8).abs_diff(goal / 8)) as f64;
        let (blind, guided) = (astar(0, steps, |_| 0.0, |cell| *cell == goal), astar(0, steps, away, |cell| *cell == goal));
        prop_assert_eq!(blind.map(|path| path.cost).ok(), guided.map(|path| path.cost).ok());
    }
}
