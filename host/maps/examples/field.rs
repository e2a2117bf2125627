//! Times and errors of the scalar field on a factory of 75 000 cells: `cargo run --release -p r4-maps --example field`.
//!
//! Readings come along the aisles of a hall of 60 m × 50 m, one a second. For each method of updating the means the
//! example prints the time for a reading and the error against a solve to 1e-8; then the error of the variances of
//! belief propagation.

use std::time::Instant;

use r4_maps::{
    field::{Field, FieldError, Reading, Weights},
    grid::{Cell, Frame, Grid},
    pose::Pose,
};
use r4_maths::statistics::{QuantileRule, StatisticsError, quantile};

const READINGS: usize = 200;

#[derive(Debug, thiserror::Error)]
enum Failure {
    #[error(transparent)]
    Field(#[from] FieldError),
    #[error(transparent)]
    Grid(#[from] r4_maps::grid::GridError),
    #[error(transparent)]
    Statistics(#[from] StatisticsError),
}

fn main() -> Result<(), Failure> {
    let frame = Frame::new(Pose::default(), 0.2, 300, 250)?;
    let hall = Grid::filled(frame, true);
    // Shelves of 1 m, aisles of 1.6 m, cross aisles every 12 m.
    let shelves = Grid::from_fn(frame, |[column, row]| column % 13 >= 5 || row % 60 < 10);
    for (name, free) in [("empty hall", &hall), ("hall with shelves", &shelves)] {
        for (forgetting_s, prior) in [(1e6, 1e-4), (100.0, 0.01)] {
            let weights = Weights { smoothness: 0.5, reading: 10.0, forgetting_s, prior };
            let field = Field::new(free, weights)?;
            println!("\n{name}: {} free cells, {READINGS} readings, {weights:?}", field.cells());
            times(&field)?;
        }
    }
    println!("\nVariance of belief propagation over the exact one, prior 1e-4:");
    for (columns, rows, readings) in [(1, 64, 6), (8, 8, 6), (30, 30, 20), (100, 100, 60), (300, 250, 200)] {
        variances(columns, rows, readings)?;
    }
    Ok(())
}

/// Returns the cell of a step along the aisles, 1 cell a second.
fn route(step: usize) -> Cell {
    let (lane, along) = (step / 75, step % 75);
    [8 + 13 * (2 * lane), 20 + if lane.is_multiple_of(2) { along } else { 75 - along }]
}

fn reading(step: usize) -> Reading {
    let value = 40.0 + 30.0 * (step as f64 / 20.0).sin() + 10.0 * ((step * 7919) as f64).sin();
    Reading { cell: route(step), value, at_s: step as f64 }
}

fn times(empty: &Field) -> Result<(), Failure> {
    println!("{:<44} {:>9} {:>9} {:>9} {:>12}", "a reading", "median ms", "p99 ms", "max ms", "last error");
    type Update = fn(&mut Field) -> Result<(), FieldError>;
    let ways: [(&str, Update); 5] = [
        ("wildfire to 1, at most 20 000 cells", |field| Ok(_ = field.wildfire(1.0, 20_000))),
        ("wildfire to 0.01, at most 200 000 cells", |field| Ok(_ = field.wildfire(0.01, 200_000))),
        ("residuals to 0.01, at most 100 000 cells", |field| Ok(_ = field.settle(0.01, 100_000))),
        ("solve to 1e-3", |field| Ok(_ = field.solve(1e-3)?)),
        ("solve to 1e-6", |field| Ok(_ = field.solve(1e-6)?)),
    ];
    for (name, update) in ways {
        let mut field = empty.clone();
        let mut took_ms = Vec::new();
        for step in 0..READINGS {
            let start = Instant::now();
            field.observe(reading(step))?;
            update(&mut field)?;
            took_ms.push(start.elapsed().as_secs_f64() * 1e3);
        }
        let mut solved = field.clone();
        solved.solve(1e-8)?;
        let pairs = field
            .means()
            .values()
            .iter()
            .flatten()
            .copied()
            .zip(solved.means().values().iter().flatten().copied().collect::<Vec<_>>())
            .collect::<Vec<_>>();
        let error = pairs.iter().map(|(a, b)| (a - b).abs()).fold(0.0, f64::max);
        let at = |share| quantile(&took_ms, share, QuantileRule::NearestRank);
        println!("{name:<44} {:>9.2} {:>9.2} {:>9.2} {error:>12.1e}", at(0.5)?, at(0.99)?, at(1.0)?);
    }
    let mut field = empty.clone();
    for step in 0..READINGS {
        field.observe(reading(step))?;
    }
    let start = Instant::now();
    let solved = field.solve(1e-6)?;
    println!("all readings at once: {:.1} ms, {} iterations", start.elapsed().as_secs_f64() * 1e3, solved.iterations);
    let start = Instant::now();
    let variances = field.variances();
    println!("exact variances: {:.0} ms", start.elapsed().as_secs_f64() * 1e3);
    let start = Instant::now();
    field.variances_with(&variances, route(READINGS))?;
    println!("variances with one more reading: {:.1} ms", start.elapsed().as_secs_f64() * 1e3);
    Ok(())
}

fn variances(columns: usize, rows: usize, readings: usize) -> Result<(), Failure> {
    let weights = Weights { smoothness: 0.5, reading: 10.0, forgetting_s: 1e6, prior: 1e-4 };
    let free = Grid::filled(Frame::new(Pose::default(), 0.2, columns, rows)?, true);
    let mut field = Field::new(&free, weights)?;
    for step in 0..readings {
        // Spread over the map, not in rows.
        let cell = [(step * 7919) % columns, (step * 104_729 + 13 * step / columns) % rows];
        field.observe(Reading { cell, value: 1.0, at_s: 0.0 })?;
    }
    field.solve(1e-6)?;
    let (exact, loops) = (field.variances(), field.propagated_variances());
    let exact = exact.values().iter().flatten();
    let ratios: Vec<f64> = loops.values().iter().flatten().zip(exact).map(|(loops, exact)| loops / exact).collect();
    let at = |share| quantile(&ratios, share, QuantileRule::Linear);
    println!(
        "{columns:>3} × {rows:<3} {readings:>3} readings: least {:.3}, median {:.3}, greatest {:.3}; over-confident by up to {:.1}",
        at(0.0)?,
        at(0.5)?,
        at(1.0)?,
        at(0.0)?.recip()
    );
    Ok(())
}
