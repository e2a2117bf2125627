//! Census of the effects hidden by seeds: frequencies and run time. `cargo run --release -p r4-blind --example census
//! [SEEDS]`.

use std::{collections::BTreeMap, time::Instant};

use r4_blind::{
    Draw,
    experiment::{Length, Setup, experiment},
};
use r4_maths::statistics::median;

fn main() {
    let seeds: u64 = std::env::args().nth(1).and_then(|text| text.parse().ok()).unwrap_or(50);
    for setup in Setup::ALL {
        for draw in [Draw::Listed, Draw::Pair, Draw::Unlisted] {
            let begin = Instant::now();
            let (mut names, mut spread) = (BTreeMap::<_, u32>::new(), Vec::new());
            for seed in 0..seeds {
                let made = experiment(setup, draw, Length::STANDARD, seed);
                spread.push(made.noise * 31.6);
                if made.hidden.truth().is_empty() {
                    *names.entry("nothing").or_default() += 1;
                }
                made.hidden.truth().iter().for_each(|truth| *names.entry(truth.name).or_default() += 1);
            }
            spread.sort_by(f64::total_cmp);
            let seconds = begin.elapsed().as_secs_f64();
            println!(
                "{setup:?}, {draw:?}: {:.2} s each, spread of the output {:.2} to {:.2} (median {:.2})",
                seconds / seeds as f64,
                spread[0],
                spread[spread.len() - 1],
                median(&spread).unwrap_or(f64::NAN)
            );
            for (name, count) in names {
                println!("  {count:4} {name}");
            }
        }
    }
}
