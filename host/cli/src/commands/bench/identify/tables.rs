//! Printed tables of the OSMC evaluation: the laws they support, those they refute, and the unexplained remainder.

use anyhow::Context;
use r4_identify::statics::table::{
    Ladder,
    gains::{GainsEffort, GainsLadder, loop_ladders},
    osmc::{Printed, closed_forms, linear, rotary},
};

use super::{Bench, Bound, Row};

/// Rung of a ladder: its law, the RMSE that others computed for it, and the last digit of that.
type Rung = (&'static str, f64, f64);

const ROTARY: &[Rung] =
    &[("none", 2.12, 0.01), ("constant", 0.71, 0.01), ("scale", 0.30, 0.01), ("offset and scale", 0.22, 0.01)];
const LINEAR: &[Rung] = &[
    ("none", 2.10, 0.01),
    ("released formula", 1.18, 0.01),
    ("constant", 0.63, 0.01),
    ("offset and scale", 0.59, 0.01),
    ("released formula, stops beyond", 0.63, 0.01),
];
/// Expected rungs of the ladders of Tables 3 to 5: errors, overshoot over Ki, overshoot over Kd, rise.
const CLOSED: [&[Rung]; 4] = [
    &[("none", 19.8, 0.1), ("constant", 5.7, 0.1), ("stopping duty over Kp", 1.60, 0.01)],
    &[
        ("none", 11.2, 0.1),
        ("integral sum at the same stopping duty", 0.94, 0.01),
        ("integral sum at its own stopping duty", 0.20, 0.01),
    ],
    &[("exponential in Kd", 0.41, 0.01)],
    &[("constant and inverse of Kp", 0.01, 0.01)],
];

/// Row of the number of rungs with the expected error, within half of the last digit.
fn rungs(data: &str, ladder: &Ladder, expected: &[Rung]) -> Row {
    let off = |&(law, rmse, digit): &Rung| match ladder.step(law) {
        // Half of the last digit, and 0.01 for the rounding of floats.
        Some(step) if (step.rmse - rmse).abs() <= 0.51 * digit => None,
        Some(step) => Some(format!("{law}: {:.3} instead of {rmse}", step.rmse)),
        None => Some(format!("{law} is missing")),
    };
    let off: Vec<_> = expected.iter().filter_map(off).collect();
    let [good, all] = [expected.len() - off.len(), expected.len()].map(|count| count as f64);
    let detail = if off.is_empty() { ladder.verdict.clone() } else { off.join(", ") };
    let row =
        Row::error(data, &format!("{}: laws with the known error", ladder.quantity), "laws", [f64::NAN, good, all]);
    Row { bound: Bound::AtLeast, met: good >= all, ..row }.with(detail)
}

/// Row of the chosen law, compared with no law.
fn chosen(data: &str, ladder: &Ladder, law: &str, at_most: f64) -> Row {
    let rmse = |law: &str| ladder.step(law).map_or(f64::NAN, |step| step.rmse);
    let unit = if ladder.unit == "mm" { "mm" } else { "deg" };
    let metric = format!("{}, RMSE of the rows it is fitted to", ladder.quantity);
    let row = Row::error(data, &metric, unit, [rmse("none"), rmse(&ladder.chosen), at_most]);
    Row { met: row.met && ladder.chosen == law, ..row }.with(ladder.chosen.clone())
}

pub(super) fn osmc(bench: &Bench<'_>) -> anyhow::Result<Vec<Row>> {
    const LOOP: &str = "OSMC Tables 3-5";
    let printed = Printed::new()?;
    bench.progress.set_message("printed laws");
    let (rotary, linear) = (rotary(&printed, bench.seed)?, linear(&printed, bench.seed)?);
    let short = linear.rejected.iter().find(|refused| refused.law.ends_with("stops short"));
    let mut rows = vec![
        // Limits as printed: two digits, rounded.
        chosen("OSMC Table 1", &rotary, "scale", 0.305),
        rungs("OSMC Table 1", &rotary, ROTARY),
        chosen("OSMC Table 2", &linear, "released formula, stops beyond", 0.635),
        rungs("OSMC Table 2", &linear, LINEAR),
        Row::claim("OSMC Table 2", "stopping short (friction) refused", short.is_some())
            .with(short.map_or_else(String::new, |refused| refused.reason.clone())),
    ];
    for (ladder, expected) in closed_forms(&printed, bench.seed)?.iter().zip(CLOSED) {
        rows.push(rungs(&ladder.data.clone(), ladder, expected));
    }
    bench.progress.set_message("simulated loops");
    let report = loop_ladders(&printed, GainsEffort::FULL, bench.seed)?;
    let all = |holds: &dyn Fn(&GainsLadder) -> bool| !report.ladders.is_empty() && report.ladders.iter().all(holds);
    let friction = |ladder: &GainsLadder| ladder.steps.last().is_some_and(|step| !step.taken);
    let reasons = report.ladders.iter().filter_map(|ladder| ladder.steps.last().map(|step| step.reason.clone()));
    rows.push(Row::claim(LOOP, "static friction refused", all(&friction)).with(reasons.collect::<Vec<_>>().join("; ")));
    for ladder in &report.ladders {
        // In the order of adding: each effect improves a column of its own.
        let column = |place: usize, of: fn(&r4_identify::statics::table::gains::GainsStep) -> f64| {
            let step = ladder.steps.get(place)?;
            Some((step.effect, of(ladder.steps.first()?), of(step)))
        };
        for (quantity, unit, limit, found) in [
            ("rise", "s", 0.8, column(1, |step| step.rise_rmse)),
            ("steady-state error", "deg", 4.5, column(2, |step| step.error_rmse)),
            ("overshoot", "deg", 4.0, column(3, |step| step.overshoot_rmse)),
            ("rise", "s", 0.5, column(4, |step| step.rise_rmse)),
        ] {
            let (effect, before, after) = found.context("a ladder ends too soon")?;
            let metric = format!("{quantity}, {:.0} deg as target, RMSE with {effect}", ladder.target_deg);
            rows.push(Row::error(LOOP, &metric, unit, [before, after, limit]));
        }
    }
    let kd = report.leaves_kd_open();
    rows.push(Row::claim(LOOP, "a trend over Kd left unexplained", kd).with(report.unexplained.join(", ")));
    rows.push(Row::claim(LOOP, "target left open", !report.target_identified).with(report.verdict));
    Ok(rows)
}
