//! Ladders of effects fitted to the printed tables of the OSMC evaluation (`host/identify/data/osmc_tables`).
//!
//! `cargo run --release -p r4-identify --example osmc_tables`

use r4_identify::statics::table::{TableError, gains, osmc};

fn main() -> Result<(), TableError> {
    let printed = osmc::Printed::new()?;
    let mut ladders = vec![osmc::rotary(&printed, 1)?, osmc::linear(&printed, 1)?];
    ladders.extend(osmc::closed_forms(&printed, 1)?);
    for ladder in ladders {
        println!("{}", ladder.verdict);
        for step in &ladder.steps {
            println!("  {:42} {:6.2} {:6.2} {}", step.law, step.rmse, step.left_out_rmse, ladder.unit);
            for value in &step.parameters {
                println!("      {} = {:.4} ± {:.4} {}", value.name, value.value, value.std, value.unit);
            }
        }
        for rival in &ladder.rivals {
            println!("  as good: {}; to tell: {}", rival.name, rival.experiment);
        }
        for refused in &ladder.rejected {
            println!("  not {}: {}", refused.law, refused.reason);
        }
        for left in &ladder.unexplained {
            println!("  not explained: {} ({:.2}, p {:.3})", left.depends_on, left.share, left.p_value);
        }
    }
    let start = std::time::Instant::now();
    let report = gains::loop_ladders(&printed, gains::GainsEffort::FULL, 1)?;
    for ladder in &report.ladders {
        println!("target {} deg: rise s, overshoot deg, error deg; cost, of left-out rows", ladder.target_deg);
        for step in &ladder.steps {
            println!(
                "  {:22} {:5.2} {:6.1} {:5.1} {:6.1} {:6.1} {} {}",
                step.effect,
                step.rise_rmse,
                step.overshoot_rmse,
                step.error_rmse,
                step.cost,
                step.left_out_cost,
                if step.taken { "taken:" } else { "refused:" },
                step.reason
            );
            println!("      {:.2?}", step.parameters);
        }
        for left in &ladder.unexplained {
            println!("  not explained: {} ({:.2}, p {:.3})", left.depends_on, left.share, left.p_value);
        }
    }
    println!("{} In {:.1} s.", report.verdict, start.elapsed().as_secs_f64());
    Ok(())
}
