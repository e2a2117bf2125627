//! The model `table` as a task: recorded columns against laws that need no declaration.

use std::collections::BTreeMap;

use statrs::distribution::{ContinuousCDF, StudentsT};

use super::super::{map::unit, plant::SettlingMap};
use super::{About, Ladder, Law, Step, TableError, climb, errors, general, squares};
use crate::data::Run;
use crate::family::Loadable;
use crate::report::{
    EffectReport, Estimate, Evidence, Explained, Figures, Rejected, Report, ResidualReport, Rival, Score, Scores,
    Traces,
};
use crate::task::{FileKind, Identified, ModelInfo, RoleInfo};

/// Name of the model, for `--model`.
pub const NAME: &str = "table";

const INPUTS: [&str; 3] = ["input", "input_2", "input_3"];

/// Returns the description for the list of models.
#[must_use]
pub fn info() -> ModelInfo {
    let role = |name, required, driving, what| RoleInfo { name, required, driving, what };
    ModelInfo {
        name: NAME,
        summary: "closed-form laws against the rows of a table, each judged by rows it was not fitted to",
        roles: vec![
            role("input", true, true, "a column of the table"),
            role("input_2", false, true, "another"),
            role("input_3", false, true, "another"),
            role("output", true, false, "the column that the laws are to tell"),
        ],
        parameters: vec![],
        effects: vec![
            "constant",
            "equal",
            "proportional",
            "straight line",
            "inverse",
            "power",
            "exponential",
            "saturation",
        ],
        file: FileKind::Plant,
    }
}

/// Returns the rows of recordings, inputs first and the output last, without incomplete ones.
fn rows(runs: &[Run], roles: &[&str]) -> Vec<Vec<f64>> {
    let row = |run: &Run, at: usize| -> Option<Vec<f64>> {
        let cell =
            |role: &&str| run.values(role).and_then(|values| values.get(at)).copied().filter(|cell| cell.is_finite());
        roles.iter().map(cell).collect()
    };
    runs.iter().flat_map(|run| (0..run.time_s.len()).filter_map(|at| row(run, at)).collect::<Vec<_>>()).collect()
}

/// Searches for the law of a table. Without held-out rows, leave-one-out cross-validation replaces them.
///
/// # Errors
/// An error for a missing role, or fewer than three rows.
pub fn identify(train: &[Run], holdout: &[Run], notes: Vec<String>, seed: u64) -> Result<Identified, TableError> {
    let first = train.first();
    let has = |role: &&str| first.is_some_and(|run| run.signals.contains_key(*role));
    for role in ["input", "output"] {
        if !has(&role) {
            return Err(TableError::NoColumn {
                column: role.to_owned(),
                columns: first
                    .map_or_else(String::new, |run| run.signals.keys().cloned().collect::<Vec<_>>().join(", ")),
            });
        }
    }
    let inputs: Vec<&str> = INPUTS.into_iter().filter(|role| has(role)).collect();
    let roles: Vec<&str> = inputs.iter().copied().chain(["output"]).collect();
    let (fitted, held_out) = (rows(train, &roles), rows(holdout, &roles));
    let unit = first.map_or("1", unit);
    let about = About { data: "the table", quantity: "output", unit, columns: &inputs };
    let laws = general(&inputs, &fitted);
    let ladder = climb(&about, &fitted, &laws, seed)?;
    Ok(report(&ladder, &laws, &inputs, &fitted, &held_out, notes))
}

fn values(step: &Step) -> Vec<f64> {
    step.parameters.iter().map(|value| value.value).collect()
}

fn report(
    ladder: &Ladder,
    laws: &[Law],
    inputs: &[&str],
    fitted: &[Vec<f64>],
    held_out: &[Vec<f64>],
    notes: Vec<String>,
) -> Identified {
    // The base model is the best law without a parameter: zero, or an input as it is.
    let plain = ladder.steps.iter().filter(|step| step.parameters.is_empty());
    let base = plain.min_by(|a, b| a.rmse.total_cmp(&b.rmse)).unwrap_or(&ladder.steps[0]);
    let chosen = ladder.best().unwrap_or(base);
    let spread = |rows: &[Vec<f64>]| {
        let outputs: Vec<f64> = rows.iter().filter_map(|row| row.last().copied()).collect();
        let mean = outputs.iter().sum::<f64>() / outputs.len() as f64;
        (outputs.iter().map(|y| (y - mean).powi(2)).sum::<f64>() / outputs.len() as f64).sqrt()
    };
    let law_of = |step: &Step| laws.iter().find(|law| law.name == step.law);
    let held_out_rmse = |step: &Step| match law_of(step) {
        Some(law) if !held_out.is_empty() => (squares(law, &values(step), held_out) / held_out.len() as f64).sqrt(),
        _ => step.left_out_rmse,
    };
    let score = |rmse: f64, mae: f64, rows| Score { rmse, nrmse: rmse / spread(rows), mae };
    let mean =
        |magnitudes: &mut dyn Iterator<Item = f64>, rows: &[Vec<f64>]| magnitudes.sum::<f64>() / rows.len() as f64;
    let mae = |step: &Step, rows: &[Vec<f64>]| {
        law_of(step).map_or(f64::NAN, |law| mean(&mut errors(law, &values(step), rows).map(f64::abs), rows))
    };
    let left_out_mae = |step: &Step| mean(&mut step.left_out_squares.iter().map(|square| square.sqrt()), fitted);
    let scores = |step: &Step| Scores {
        train: score(step.rmse, mae(step, fitted), fitted),
        holdout: if held_out.is_empty() {
            score(step.left_out_rmse, left_out_mae(step), fitted)
        } else {
            score(held_out_rmse(step), mae(step, held_out), held_out)
        },
    };
    let estimates: BTreeMap<String, Estimate> = chosen
        .parameters
        .iter()
        .map(|value| {
            let estimate = Estimate {
                value: value.value,
                std: Some(value.std),
                unit: value.unit.to_owned(),
                interval: value.interval,
                assumed: None,
            };
            (value.name.to_owned(), estimate)
        })
        .collect();
    let mut effects = Vec::new();
    if chosen.law != base.law {
        let sizes = chosen.parameters.iter().map(|value| value.value.abs() / value.std.max(f64::MIN_POSITIVE));
        let better =
            base.left_out_squares.iter().zip(&chosen.left_out_squares).filter(|(before, after)| after < before);
        effects.push(EffectReport {
            name: chosen.law.clone(),
            depends_on: vec!["input".to_owned()],
            parameters: estimates.clone(),
            holdout_rmse_before: held_out_rmse(base),
            holdout_rmse_after: held_out_rmse(chosen),
            evidence: Evidence {
                blocked_rmse_before: base.left_out_rmse,
                blocked_rmse_after: chosen.left_out_rmse,
                p_value: (chance(&base.left_out_squares, &chosen.left_out_squares) * laws.len() as f64).min(1.0),
                blocks_better: [better.count(), fitted.len()],
                z: sizes.fold(0.0, f64::max).min(1e6),
            },
            rivals: ladder
                .rivals
                .iter()
                .map(|rival| Rival {
                    name: rival.name.clone(),
                    blocked_rmse: ladder.step(&rival.name).map_or(chosen.left_out_rmse, |step| step.left_out_rmse),
                    experiment: rival.experiment.clone(),
                })
                .collect(),
            table: None,
        });
    }
    let rejected = ladder.rejected.iter().map(|refused| Rejected {
        name: refused.law.clone(),
        blocked_rmse: ladder.step(&refused.law).map_or(f64::NAN, |step| step.left_out_rmse),
        reason: refused.reason.clone(),
    });
    let predicted = |step: &Step| -> Vec<f64> {
        let of = |row: &Vec<f64>| {
            let (_, x) = row.split_last()?;
            law_of(step).map(|law| (law.predict)(&values(step), x))
        };
        fitted.iter().map(|row| of(row).unwrap_or(f64::NAN)).collect()
    };
    let figures = Figures {
        ladder: ladder.steps.iter().map(|step| (step.law.clone(), step.left_out_rmse)).collect(),
        runs: vec![Traces {
            name: "rows".to_owned(),
            held_out: false,
            time_s: (0..fitted.len()).map(|row| row as f64).collect(),
            input: (inputs[0].to_owned(), fitted.iter().map(|row| row[0]).collect()),
            output: ("output".to_owned(), ladder.unit.clone()),
            measured: fitted.iter().filter_map(|row| row.last().copied()).collect(),
            before: predicted(base),
            after: predicted(chosen),
        }],
        causes: vec![],
    };
    let column = |at: usize| fitted.iter().map(move |row| row[at]);
    let mean = |at: usize| column(at).sum::<f64>() / fitted.len() as f64;
    // A plant has one input; the other columns are held at their means.
    let others: Vec<f64> = (1..inputs.len()).map(mean).collect();
    let settles_at = |level: f64| {
        let row: Vec<f64> = [level].into_iter().chain(others.iter().copied()).collect();
        law_of(chosen).map_or(0.0, |law| (law.predict)(&values(chosen), &row))
    };
    let largest = column(0).map(f64::abs).fold(0.0, f64::max);
    let map = SettlingMap {
        unit: &ladder.unit,
        source: &format!("r4 identify --model {NAME}, law `{}` of {} rows", chosen.law, fitted.len()),
        full: if largest <= 1.0 { 1.0 } else { largest },
        seen: [column(0).fold(f64::INFINITY, f64::min), column(0).fold(f64::NEG_INFINITY, f64::max)],
        supply_v: None,
        settles_at: &settles_at,
        left_out: inputs[1..]
            .iter()
            .zip(&others)
            .map(|(role, mean)| format!("{role}, held at its mean {mean:?}"))
            .collect(),
    };
    let loadable = Loadable::Plant(map.plant_file());
    let [baseline, last] = [base, chosen].map(scores);
    let errors = [baseline, last].map(|scores| scores.holdout.nrmse);
    let report = Report {
        model: NAME.to_owned(),
        // A law counts as an effect with a size: one that fits well needs no further effects.
        explained: Explained::of(errors, true, ladder.unexplained.is_empty()),
        suspicions: Vec::new(),
        unit: ladder.unit.clone(),
        baseline,
        effects,
        last,
        parameters: estimates,
        residual: ResidualReport { white: ladder.unexplained.is_empty(), unexplained: ladder.unexplained.clone() },
        timing: BTreeMap::new(),
        rejected: rejected.collect(),
        notes,
        verdict: ladder.verdict.clone(),
    };
    Identified { report, figures, loadable }
}

/// Returns the probability that errors of rows did not fall, by a one-sided t-test of their differences.
fn chance(before: &[f64], after: &[f64]) -> f64 {
    let rows = before.len() as f64;
    let differences: Vec<f64> = before.iter().zip(after).map(|(before, after)| before - after).collect();
    let mean = differences.iter().sum::<f64>() / rows;
    let variance = differences.iter().map(|difference| (difference - mean).powi(2)).sum::<f64>() / (rows - 1.0);
    if variance <= 0.0 {
        return if mean > 0.0 { 0.0 } else { 1.0 };
    }
    StudentsT::new(0.0, 1.0, rows - 1.0).map_or(1.0, |students| students.sf(mean / (variance / rows).sqrt()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::data::{Quantity, Signal};

    fn recorded(columns: &[(&str, &[f64])]) -> Run {
        let signal =
            |values: &[f64]| Signal { column: "c".into(), quantity: Quantity::Length, values: values.to_vec() };
        let rows = u32::try_from(columns[0].1.len()).unwrap();
        Run {
            name: "table".into(),
            time_s: (0..rows).map(f64::from).collect(),
            origin_s: None,
            signals: columns.iter().map(|(role, values)| ((*role).to_owned(), signal(values))).collect(),
        }
    }

    #[test]
    fn a_table_becomes_a_report() {
        let run = recorded(&[
            ("input", &[1.0, 2.0, 4.0, 5.0, f64::NAN, 8.0]),
            ("output", &[24.1, 11.9, 6.05, 4.8, 4.0, 3.0]),
        ]);
        let later = recorded(&[("input", &[10.0]), ("output", &[2.4])]);
        let Identified { report, loadable, .. } = identify(&[run], &[later], vec![], 1).unwrap();
        assert_eq!(report.effects[0].name, "inverse of input");
        assert!((report.parameters["factor"].value - 24.0).abs() < 0.2);
        assert!(report.last.holdout.rmse < 0.02 && report.baseline.holdout.rmse > 2.0, "{report:?}");
        let Scores { train, holdout } = report.last;
        assert!(train.mae <= train.rmse && holdout.mae <= holdout.rmse, "{report:?}");
        let text = loadable.plant().unwrap();
        assert!(text.contains("law `inverse of input`"), "{text}");
        let plant = r4_plants::PlantSpec::from_toml("plant.toml", text).unwrap();
        // The rod settles where the law says: 24 over the level, and full duty is the highest level of 8.
        let mut rod = r4_plants::Plant::new(&plant, 1);
        rod.advance(r4_plants::Drive::with_brake(1.0), 12.0, 2.0);
        assert!((rod.position() - report.parameters["factor"].value / 8.0).abs() < 1e-6, "{}", rod.position());
    }

    #[test]
    fn a_table_without_its_columns_or_rows_says_so() {
        let run = recorded(&[("input", &[1.0, 2.0]), ("output", &[2.0, 4.0])]);
        assert!(matches!(
            identify(std::slice::from_ref(&run), &[], vec![], 1),
            Err(TableError::TooFew { rows: 2, .. })
        ));
        let without = recorded(&[("input", &[1.0, 2.0])]);
        assert!(matches!(identify(&[without], &[], vec![], 1), Err(TableError::NoColumn { .. })));
        assert!(identify(&[], &[], vec![], 1).is_err());
    }
}
