//! Prediction error of the kinematic model on full boards of other seeds: `cargo run --release -p r4-learn --example
//! model FIRST COUNT`.

use r4_learn::{
    Error,
    kinematic::{MODEL, Model},
};

fn main() -> Result<(), Error> {
    let mut numbers = std::env::args().skip(1).filter_map(|word| word.parse().ok());
    let (first, count) = (numbers.next().unwrap_or(9), numbers.next().unwrap_or(8));
    let seeds: Vec<u64> = (first..first + count).collect();
    let (identified_m, ideal_m) = (MODEL.error_m(&seeds)?, Model::IDEAL.error_m(&seeds)?);
    println!(
        "seeds {first} to {}: RMS over 1 s {:.1} mm, ideal wheels {:.1} mm",
        first + count - 1,
        identified_m * 1e3,
        ideal_m * 1e3
    );
    Ok(())
}
