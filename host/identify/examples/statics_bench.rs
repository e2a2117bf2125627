//! Benchmark of static maps, tables and held shafts on `data/`.
//!
//! `cargo run --release -p r4-identify --example statics_bench [data]`

use std::path::PathBuf;

use r4_identify::{
    IdentifyError,
    statics::{bench, table::gains::GainsEffort},
};

fn main() -> Result<(), IdentifyError> {
    let data = PathBuf::from(std::env::args().nth(1).unwrap_or_else(|| "data".to_owned()));
    for row in bench::rows(&data, GainsEffort::FULL)? {
        println!(
            "{} {:8.3} -> {:7.3} ({:6.2}) {:3} {} | {}",
            if row.met { "met    " } else { "NOT MET" },
            row.baseline,
            row.after,
            row.at_least,
            row.unit,
            row.data,
            row.metric
        );
    }
    Ok(())
}
