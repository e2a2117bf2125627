//! Report of the measured times beside their limits: the rows of `--json` and the printed tables.

use std::fmt;

use r4_sim::stop::Outputs;
use serde::Serialize;

use super::run_out::{Group, GroupRan};
use crate::{output, table};

/// Limit of a time, and its origin.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limit {
    pub(super) ms: f64,
    pub(super) from: &'static str,
}

/// Origin of a limit that the project guarantees.
pub(super) const PROMISED: &str = "promised";
/// Origin of a limit that follows from the board's configuration.
pub(super) const CONFIGURED: &str = "configuration";

#[derive(Debug, Serialize)]
pub(super) struct Row {
    cause: String,
    outputs: String,
    max_ms: f64,
    limit_ms: f64,
    injections: u32,
    /// True if the project guarantees the limit.
    promised: bool,
    pub(super) held: bool,
    /// Origin of the limit.
    limit_from: &'static str,
    /// Time until the plants were at rest, ms, and their distance until then, in `rest_unit`; `null` in rows about
    /// outputs.
    rest_ms: Option<f64>,
    rest_distance: Option<f64>,
    rest_unit: Option<&'static str>,
}

impl Row {
    /// Row of one kind of output.
    pub(super) fn new(
        cause: &impl fmt::Display,
        outputs: &impl fmt::Display,
        max_ms: f64,
        limit: Limit,
        injections: u32,
    ) -> Self {
        Self {
            cause: cause.to_string(),
            outputs: outputs.to_string(),
            max_ms,
            limit_ms: limit.ms,
            injections,
            promised: limit.from == PROMISED,
            held: max_ms <= limit.ms,
            limit_from: limit.from,
            rest_ms: None,
            rest_distance: None,
            rest_unit: None,
        }
    }

    /// Row of plants that were followed until rest; a plant that never rests misses the limit too.
    pub(super) fn of_group(cause: &impl fmt::Display, group: &Group, ran: &GroupRan, limit: Limit) -> Self {
        Self {
            // Infinite where the plant was still moving after `RUN_OUT_NS`.
            held: ran.off_ms <= limit.ms && ran.rest_ms.is_finite(),
            rest_ms: Some(ran.rest_ms),
            rest_distance: Some(ran.distance),
            rest_unit: Some(group.unit),
            ..Self::new(cause, group, ran.off_ms, limit, ran.runs)
        }
    }

    /// `OVER ` for a missed limit.
    const fn verdict(&self) -> &'static str {
        if self.held { "" } else { "OVER " }
    }
}

/// Outputs that cannot be commanded any more after a cause.
#[derive(Serialize)]
pub(super) struct OutOfReach {
    pub(super) cause: String,
    pub(super) outputs: String,
}

#[derive(Serialize)]
pub(super) struct Report {
    pub(super) board: String,
    pub(super) simulated: bool,
    pub(super) seed: u64,
    pub(super) injections: u32,
    pub(super) rows: Vec<Row>,
    pub(super) out_of_reach: Vec<OutOfReach>,
}

/// Line of the printed tables.
pub(super) struct Line {
    pub(super) cause: String,
    pub(super) injections: u32,
    /// True if the cause's stop is of category 1 for channels that brake.
    pub(super) brakes: bool,
}

impl Report {
    /// True if every row is within its limit.
    pub(super) fn held(&self) -> bool {
        self.rows.iter().all(|row| row.held)
    }

    fn row(&self, cause: &str, outputs: &impl fmt::Display) -> Option<&Row> {
        let outputs = outputs.to_string();
        self.rows.iter().find(|row| row.cause == cause && row.outputs == outputs)
    }

    /// Prints one line per cause: longest time of each kind of output.
    pub(super) fn print_outputs(&self, lines: &[Line], markdown: bool) -> anyhow::Result<()> {
        let mut header = vec!["cause", "times"];
        header.extend(Outputs::ALL.map(short));
        let mut table = table::new(&header, 1..header.len());
        for line in lines {
            let mut cells = vec![line.cause.clone(), line.injections.to_string()];
            cells.extend(Outputs::ALL.map(|outputs| {
                self.row(&line.cause, &outputs).map_or("-".into(), |row| {
                    let promised = if row.promised { "*" } else { "" };
                    format!("{}{} / {}{promised}", row.verdict(), digits(row.max_ms), digits(row.limit_ms))
                })
            }));
            table.add_row(cells);
        }
        output::line(if markdown { table::markdown(table) } else { table })?;
        let meanings: Vec<_> =
            Outputs::ALL.into_iter().map(|outputs| format!("{}: {outputs}", short(outputs))).collect();
        Ok(output::line(meanings.join("; "))?)
    }

    /// Prints a table per stop category: for each kind of plant, time until off, time until rest, and distance.
    pub(super) fn print_plants(&self, lines: &[Line], groups: &[Group], markdown: bool) -> anyhow::Result<()> {
        for brakes in [true, false] {
            let groups: Vec<_> = groups.iter().filter(|group| group.brakes == brakes).collect();
            if groups.is_empty() {
                continue;
            }
            let heads: Vec<_> = groups.iter().map(|group| group.plants()).collect();
            let mut header = vec!["cause"];
            header.extend(heads.iter().map(String::as_str));
            let mut table = table::new(&header, 1..header.len());
            // Other causes switch off at once the channels that would brake: see the table of category 0.
            for line in lines.iter().filter(|line| line.brakes || !brakes) {
                let mut cells = vec![line.cause.clone()];
                cells.extend(groups.iter().map(|group| {
                    self.row(&line.cause, group).map_or("-".into(), |row| {
                        let [rest_ms, distance] =
                            [row.rest_ms, row.rest_distance].map(|value| value.unwrap_or(f64::NAN));
                        let (off, limit, unit) = (digits(row.max_ms), digits(row.limit_ms), group.unit);
                        format!("{}{off} / {limit}; {}; {} {unit}", row.verdict(), digits(rest_ms), digits(distance))
                    })
                }));
                table.add_row(cells);
            }
            output::line("")?;
            let what = if brakes { "1: braked, then switched off" } else { "0: switched off at once" };
            output::line(format_args!(
                "Plants, category {what}. Longest time until off / its limit, ms; until at rest, ms; travel until then"
            ))?;
            output::line(if markdown { table::markdown(table) } else { table })?;
        }
        Ok(output::line("at rest: slower than 0.05 rad/s or 0.5 mm/s; a plant that moves after 20 s misses its limit")?)
    }
}

/// Column heading of a kind of output.
const fn short(outputs: Outputs) -> &'static str {
    match outputs {
        Outputs::MotorPower => "power",
        Outputs::Bridges => "bridges",
        Outputs::BridgeChips => "chips",
        Outputs::Bldcs => "brushless",
        Outputs::Steppers => "steppers",
        Outputs::Servos => "servos",
        Outputs::Dacs => "analog",
    }
}

/// Formats about three digits, enough for a comparison.
pub(super) fn digits(ms: f64) -> String {
    match ms {
        ms if ms < 10.0 => format!("{ms:.2}"),
        ms if ms < 100.0 => format!("{ms:.1}"),
        ms => format!("{ms:.0}"),
    }
}

#[cfg(test)]
mod tests {
    use super::{super::run_out::groups, *};

    #[test]
    fn a_row_that_misses_its_limit_fails_the_command() {
        let limit = Limit { ms: 5.0, from: CONFIGURED };
        let report = |row: Row| Report {
            board: "sim:every-interface".into(),
            simulated: true,
            seed: 1,
            injections: 2,
            rows: vec![Row::new(&"host stop", &Outputs::Bldcs, 5.0, limit, 1), row],
            out_of_reach: Vec::new(),
        };
        let of = |max_ms| Row::new(&"host stop", &Outputs::Bridges, max_ms, limit, 1);
        assert!(report(of(5.0)).held());
        for max_ms in [5.001, f64::INFINITY, f64::NAN] {
            assert!(!report(of(max_ms)).held(), "{max_ms} ms");
        }
        let groups = groups(&r4_boards::load("every-interface").unwrap());
        let ran = |off_ms, rest_ms| {
            let ran = GroupRan { runs: 1, off_ms, rest_ms, distance: 1.0 };
            report(Row::of_group(&"host stop", &groups[0], &ran, limit))
        };
        assert!(ran(5.0, 9_000.0).held());
        assert!(!ran(5.001, 9_000.0).held() && !ran(5.0, f64::INFINITY).held());
    }
}
