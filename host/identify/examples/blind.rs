//! What is found in recordings of blind plants, seed by seed: `blind FROM TO [-v]`.

use r4_blind::{
    Draw,
    experiment::{Length, Recording, Setup, experiment},
};
use r4_identify::{
    Task,
    data::{Quantity, Run, Signal},
    identify,
};
use std::collections::BTreeMap;
fn run(setup: Setup, name: String, recording: &Recording) -> Run {
    let signal =
        |column: &str, quantity, values: &Vec<f64>| Signal { column: column.into(), quantity, values: values.clone() };
    let mut signals = BTreeMap::new();
    let (input, output) = match setup {
        Setup::MotorPosition => (Quantity::Number, Quantity::Angle),
        Setup::MotorSpeed => (Quantity::Number, Quantity::AngularSpeed),
        Setup::AxisPosition => (Quantity::Force, Quantity::Length),
    };
    signals.insert("input".to_owned(), signal(setup.input(), input, &recording.input));
    signals.insert("output".to_owned(), signal(setup.output(), output, &recording.output));
    Run { name, time_s: recording.time_s.clone(), signals }
}
fn main() {
    let args: Vec<u64> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let verbose = std::env::args().any(|a| a == "-v");
    let (mut right, mut listed, mut clean, mut quiet) = (0, 0, 0, 0);
    for seed in args[0]..args[1] {
        let setup = Setup::ALL[seed as usize % 3];
        let draw = if verbose && args.len() > 2 { Draw::Nothing } else { Draw::of(seed) };
        let e = experiment(setup, draw, Length::STANDARD, seed);
        let truth: Vec<String> = e
            .hidden
            .truth()
            .iter()
            .map(|t| format!("{}{:?}", t.name, t.parameters.iter().map(|p| p.value).collect::<Vec<_>>()))
            .collect();
        let train: Vec<Run> = e.train.iter().enumerate().map(|(i, r)| run(setup, format!("t{i}"), r)).collect();
        let hold: Vec<Run> = e.holdout.iter().enumerate().map(|(i, r)| run(setup, format!("h{i}"), r)).collect();
        let mut task = Task {
            model: if setup == Setup::AxisPosition { "axis".into() } else { "dc-motor".into() },
            ..Task::default()
        };
        if setup != Setup::AxisPosition {
            task.parameters.insert("supply_v".into(), e.supply_v);
        }
        let start = std::time::Instant::now();
        let found = identify(&task, &train, &hold, vec![], &|p| {
            if verbose {
                eprintln!("{:6.1} {}", start.elapsed().as_secs_f64(), p.step)
            }
        });
        match found {
            Ok(found) => {
                let r = &found.report;
                let names: Vec<String> = r
                    .effects
                    .iter()
                    .map(|e| {
                        format!(
                            "{}{:?}{}",
                            e.name,
                            e.table.as_ref().map(|t| t.over.clone()).unwrap_or_default(),
                            if e.rivals.is_empty() {
                                String::new()
                            } else {
                                format!("~{}", e.rivals.iter().map(|r| r.name.clone()).collect::<Vec<_>>().join("~"))
                            }
                        )
                    })
                    .collect();
                let first = r.effects.first().map(|e| e.name.clone());
                if truth.is_empty() {
                    clean += 1;
                    if first.is_none() {
                        quiet += 1;
                    }
                } else {
                    listed += 1;
                    if first.is_some_and(|f| truth.iter().any(|t| t.starts_with(&f))) {
                        right += 1;
                    }
                }
                println!(
                    "{seed} {setup:?} {:?} truth {truth:?} found {names:?} hold {:.4} -> {:.4} noise {:.4} ratio {:.2} white {} {:?} {:.1}s",
                    draw,
                    r.baseline.holdout.rmse,
                    r.last.holdout.rmse,
                    e.noise,
                    r.last.holdout.rmse / e.noise,
                    r.residual.white,
                    r.residual.unexplained.iter().map(|u| u.depends_on.clone()).collect::<Vec<_>>(),
                    start.elapsed().as_secs_f64()
                );
                if verbose {
                    println!("{:#?}", r.rejected);
                    println!("{}", found.plant_toml);
                    println!("{:?}\n{:?}", r.parameters, r.effects.iter().map(|e| &e.parameters).collect::<Vec<_>>());
                    println!("base {:?}", e.base);
                }
            }
            Err(error) => println!("{seed} {setup:?} {error}"),
        }
    }
    println!("right {right} of {listed}; quiet {quiet} of {clean}");
}
