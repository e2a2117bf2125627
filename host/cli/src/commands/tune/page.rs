//! Report page of a tuning run.

use r4_log::Log;
use r4_protocol::ChannelId;
use r4_rig::{
    quantity::human,
    tune::{AnswerSample, Outcome},
};

use super::{finding, rows, rule, verdict};
use crate::report::{self, Align, Cell, Column, Overlay};

/// Returns the page as HTML.
pub(super) fn html(log: &Log, channel: ChannelId, board: &str, outcome: &Outcome) -> String {
    let plan = &outcome.plan;
    let column = |title: &str, align| Column { title: title.into(), unit: None, align };
    let verdict = verdict(outcome, channel);
    let table = report::Table {
        caption: format!("Gains and the response to steps, {} loop", plan.name()),
        note: Some(format!("{} {}. On the board: {verdict}.", finding(outcome), rule(outcome))),
        columns: vec![
            column("", Align::Left),
            column("Unit", Align::Left),
            column("Present", Align::Right),
            column("Proposed", Align::Right),
        ],
        rows: rows(outcome).into_iter().map(|row| row.map(Cell::Text).to_vec()).collect(),
    };
    let (per_si, unit, _) = human(plan.unit());
    let line = |samples: &[AnswerSample], of: fn(&AnswerSample) -> f64| {
        samples.iter().map(|sample| (sample.time_s, of(sample) * per_si)).collect::<Vec<_>>()
    };
    let mut lines = vec![("set point".to_owned(), line(&outcome.before.samples, |sample| sample.setpoint))];
    lines.push(("present gains".to_owned(), line(&outcome.before.samples, |sample| sample.output)));
    if let Ok(after) = &outcome.after {
        lines.push(("proposed gains".to_owned(), line(&after.samples, |sample| sample.output)));
    }
    let overlay = Overlay { title: format!("{} ({unit})", plan.mode()), since: "the step", lines };
    report::page(log, &format!("Tuning of {channel} on {board}"), &[table], &[overlay], None)
}
