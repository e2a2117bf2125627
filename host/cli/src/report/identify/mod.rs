//! Page of an identification's report, in the style of a log's page.

use std::{collections::BTreeMap, fmt::Write as _};

use r4_identify::report::{Cause, EffectReport, Estimate, Figures, Report, Score, Table as Curve, Traces};

use super::{
    Align, Cell, Column, Table, document, escaped,
    plot::{Bars, Figure, Line, Panel, color, number},
    series::{Point, extent, framed, with_gaps},
    write_facts, write_figure, write_table,
};

/// Line widths, quarters of a pixel: the measured line is the widest, models lie on it.
const MEASURED: u32 = 14;
const MODEL: u32 = 6;

/// Most runs drawn; the page states how many there are.
const RUNS: usize = 8;

/// Notes on the data that are visible at once; the others are folded.
const NOTES: usize = 8;

/// Page of `report` with plots of `figures`; `files` are facts about the recordings, for the head.
#[must_use]
pub(crate) fn identify(report: &Report, figures: &Figures, files: &[(&str, String)]) -> String {
    let mut body = String::new();
    // Writing to a `String` cannot fail.
    let _ = write_body(&mut body, report, figures, files);
    document(&format!("{}: what the data show", report.model), &body)
}

fn write_body(body: &mut String, report: &Report, figures: &Figures, files: &[(&str, String)]) -> std::fmt::Result {
    let scale = Scale::of(&report.unit, report.last.holdout.rmse.max(report.last.train.rmse));
    write_head(body, report, &scale, files)?;
    write_table(body, &scores(report, &scale))?;
    if figures.ladder.len() > 1 {
        writeln!(body, "<section id=\"ladder\">\n<h2>Error on held-out data, step by step</h2>")?;
        write_svg(body, &ladder(figures, &scale).svg())?;
        body.push_str("</section>\n");
    }
    writeln!(body, "<section id=\"effects\">\n<h2>Effects</h2>")?;
    if report.effects.is_empty() {
        body.push_str("<p>None: no effect explains the base model's residual better than chance.</p>\n");
    }
    for effect in &report.effects {
        write_effect(body, effect, &scale)?;
    }
    body.push_str("</section>\n");
    write_model(body, report)?;
    write_runs(body, figures)?;
    if !figures.causes.is_empty() {
        body.push_str(
            "<section id=\"residual\">\n<h2>Residual against each quantity</h2>\n<p>Means of the residual \
             in bins; the bars are two standard errors. An explained dependence lies on zero.</p>\n",
        );
        for cause in &figures.causes {
            write_figure(body, &cause_figure(cause))?;
        }
        body.push_str("</section>\n");
    }
    write_left(body, report, &scale)?;
    body.push_str(
        "<footer>Errors are those of free-run simulation, from the input and the initial state only, without feedback of \
         measured outputs. Held-out data were not fitted. Long series are drawn as the extremes of short spans of time: \
         no peak is lost.</footer>",
    );
    Ok(())
}

fn write_head(body: &mut String, report: &Report, scale: &Scale, files: &[(&str, String)]) -> std::fmt::Result {
    writeln!(body, "<header>\n<h1>{}: what the data show</h1>", escaped(&report.model))?;
    writeln!(body, "<p class=\"verdict\">{}</p>", escaped(&report.verdict))?;
    let found = match &report.effects[..] {
        [] => "none".to_owned(),
        effects => effects.iter().map(|effect| effect.name.as_str()).collect::<Vec<_>>().join(", "),
    };
    let (before, after) = (report.baseline.holdout.rmse, report.last.holdout.rmse);
    let left = if report.residual.white { "noise" } else { "unexplained structure" };
    let mut facts = vec![
        (
            "Held-out error",
            format!("{} \u{2192} {}{}", scale.text(before), scale.with_unit(after), change(before, after)),
        ),
        ("Effects found", found),
        ("Residual", left.to_owned()),
    ];
    facts.extend(files.iter().cloned());
    write_facts(body, &facts)?;
    body.push_str("</header>\n");
    if !report.notes.is_empty() {
        body.push_str("<div class=\"warnings\"><strong>About the data</strong>\n<ul>\n");
        // Long lists of notes are folded, so that the results stay on the first screen.
        let (first, more) = report.notes.split_at(report.notes.len().min(NOTES));
        for note in first {
            writeln!(body, "<li>{}</li>", escaped(note))?;
        }
        body.push_str("</ul>\n");
        if !more.is_empty() {
            writeln!(body, "<details><summary>{} more</summary>\n<ul>", more.len())?;
            for note in more {
                writeln!(body, "<li>{}</li>", escaped(note))?;
            }
            body.push_str("</ul></details>\n");
        }
        body.push_str("</div>\n");
    }
    let mut places = vec![("effects", "Effects"), ("model", "Model"), ("runs", "Runs")];
    places.extend([("residual", "Residual"), ("left", "Rejected effects")]);
    body.push_str("<nav><span>Below</span>");
    for (id, name) in places {
        write!(body, " <a href=\"#{id}\">{name}</a>")?;
    }
    body.push_str("</nav>\n");
    Ok(())
}

/// Table of model by data, with both kinds of error.
fn scores(report: &Report, scale: &Scale) -> Table {
    let cells = |score: Score| {
        [Cell::Text(scale.text(score.rmse)), Cell::Text(format!("{} %", significant(100.0 * score.nrmse)))]
    };
    let row = |name: &str, train: Score, holdout: Score| {
        [vec![Cell::Text(name.to_owned())], cells(train).to_vec(), cells(holdout).to_vec()].concat()
    };
    let mut rows = vec![row("base model", report.baseline.train, report.baseline.holdout)];
    if !report.effects.is_empty() {
        let name = if report.effects.len() == 1 { "with the effect" } else { "with the effects" };
        rows.push(row(name, report.last.train, report.last.holdout));
    }
    Table {
        caption: "Error of free-run simulation".to_owned(),
        note: Some(
            "RMS over the whole run; NRMSE is its share of the measured signal's standard deviation, so 100 % is no better \
             than a constant."
                .to_owned(),
        ),
        columns: vec![
            column("Model", None, Align::Left),
            column("Fitted data", Some(&scale.unit), Align::Right),
            column("NRMSE", None, Align::Right),
            column("Held-out data", Some(&scale.unit), Align::Right),
            column("NRMSE", None, Align::Right),
        ],
        rows,
    }
}

fn ladder(figures: &Figures, scale: &Scale) -> Bars {
    let rows = figures.ladder.iter().map(|(name, rmse)| (name.clone(), *rmse, scale.with_unit(*rmse)));
    let told: Vec<String> =
        figures.ladder.iter().map(|(name, rmse)| format!("{name} {}", scale.with_unit(*rmse))).collect();
    Bars { description: format!("Error on held-out data: {}", told.join(", ")), rows: rows.collect() }
}

fn write_effect(body: &mut String, effect: &EffectReport, scale: &Scale) -> std::fmt::Result {
    let over = effect.depends_on.join(", ");
    writeln!(body, "<h3>{} <small>depends on {}</small></h3>", escaped(&effect.name), escaped(&over))?;
    let (before, after) = (effect.holdout_rmse_before, effect.holdout_rmse_after);
    let evidence = &effect.evidence;
    let (blocks_before, blocks_after) = (evidence.blocked_rmse_before, evidence.blocked_rmse_after);
    let chance = if evidence.p_value < 1e-4 { "below 0.0001".to_owned() } else { significant(evidence.p_value) };
    let away = match evidence.z {
        z if z > 1_000.0 => "over 1000 standard errors".to_owned(),
        z => format!("{} standard errors", significant(z)),
    };
    write_facts(
        body,
        &[
            (
                "Held-out error",
                format!("{} \u{2192} {}{}", scale.text(before), scale.with_unit(after), change(before, after)),
            ),
            (
                "Error in block cross-validation",
                format!("{} \u{2192} {}", scale.text(blocks_before), scale.with_unit(blocks_after)),
            ),
            ("Blocks improved", format!("{} of {}", evidence.blocks_better[0], evidence.blocks_better[1])),
            ("Chance of that without the effect", chance),
            ("Distance from zero", away),
        ],
    )?;
    if !effect.parameters.is_empty() {
        write_table(body, &estimates(String::new(), &effect.parameters))?;
    }
    if let Some(curve) = &effect.table {
        write_figure(body, &curve_figure(curve))?;
    }
    if !effect.rivals.is_empty() {
        let rows = effect.rivals.iter().map(|rival| {
            let error = Cell::Text(scale.text(rival.blocked_rmse));
            vec![Cell::Text(rival.name.clone()), error, Cell::Text(rival.experiment.clone())]
        });
        let table = Table {
            caption: "Collinear effects, which explain the data as well".to_owned(),
            note: None,
            columns: vec![
                column("Rival", None, Align::Left),
                column("Error in block cross-validation", Some(&scale.unit), Align::Right),
                column("Recording that distinguishes them", None, Align::Left),
            ],
            rows: rows.collect(),
        };
        write_table(body, &table)?;
    }
    Ok(())
}

fn write_model(body: &mut String, report: &Report) -> std::fmt::Result {
    body.push_str("<section id=\"model\">\n<h2>Base model</h2>\n");
    if !report.parameters.is_empty() {
        let caption = if report.effects.is_empty() { String::new() } else { "Beside the effects above".to_owned() };
        write_table(body, &estimates(caption, &report.parameters))?;
    }
    body.push_str("</section>\n");
    Ok(())
}

/// Table of parameters with standard errors and intervals.
fn estimates(caption: String, parameters: &BTreeMap<String, Estimate>) -> Table {
    let intervals = parameters.values().any(|estimate| estimate.interval.is_some());
    let mut assumed = Vec::new();
    let rows = parameters.iter().map(|(name, estimate)| {
        if let Some(assumption) = &estimate.assumed {
            let note = format!("{name}: {assumption}");
            // Several parameters can share an assumption; print it once.
            if !assumed.contains(&note) {
                assumed.push(note);
            }
        }
        let (value, std) = match estimate.std {
            // Two digits of the standard error fix the decimals of the value.
            Some(std) if std.is_finite() && std > 0.0 => {
                let decimals = decimals(std, 2);
                (fixed(estimate.value, decimals), format!("\u{b1} {}", fixed(std, decimals)))
            }
            Some(_) => (significant(estimate.value), String::new()),
            None => (significant(estimate.value), "not fixed by the data".to_owned()),
        };
        let interval = estimate.interval.map_or(String::new(), |[low, high]| {
            // A quarter of a 95 % interval is about one standard error.
            let decimals = decimals((high - low) / 4.0, 2);
            format!("{} to {}", fixed(low, decimals), fixed(high, decimals))
        });
        let unit = if estimate.unit == "1" { String::new() } else { estimate.unit.clone() };
        let cells = [name.clone(), value, std, unit, interval];
        cells.into_iter().take(if intervals { 5 } else { 4 }).map(Cell::Text).collect()
    });
    let rows: Vec<Vec<Cell>> = rows.collect();
    let mut columns = vec![
        column("Parameter", None, Align::Left),
        column("Value", None, Align::Right),
        column("Standard error", None, Align::Left),
        column("Unit", None, Align::Left),
    ];
    if intervals {
        columns.push(column("95 % interval", None, Align::Left));
    }
    Table {
        caption,
        note: (!assumed.is_empty()).then(|| format!("Their scale is assumed. {}", assumed.join("; "))),
        columns,
        rows,
    }
}

fn write_runs(body: &mut String, figures: &Figures) -> std::fmt::Result {
    body.push_str("<section id=\"runs\">\n<h2>Runs: measured, before, after</h2>\n");
    for run in figures.runs.iter().take(RUNS) {
        let kind = if run.held_out { "held out" } else { "fitted to" };
        writeln!(body, "<h3>{} <small>{kind}</small></h3>", escaped(&run.name))?;
        write_figure(body, &run_figure(run))?;
    }
    if figures.runs.len() > RUNS {
        writeln!(body, "<p class=\"note\">{RUNS} of {} runs are drawn.</p>", figures.runs.len())?;
    }
    body.push_str("</section>\n");
    Ok(())
}

fn run_figure(run: &Traces) -> Figure {
    let points = |values: &[f64]| -> Vec<Point> {
        with_gaps(&run.time_s.iter().copied().zip(values.iter().copied()).collect::<Vec<_>>())
    };
    let line =
        |label: &str, color, width, points| Line { label: label.to_owned(), color, width, points, error: vec![] };
    let (name, unit) = &run.output;
    let most = extent(run.measured.iter().map(|value| value.abs())).map_or(0.0, |(_, most)| most);
    let scale = Scale::of(unit, most);
    let scaled = |values: &[f64]| -> Vec<f64> { values.iter().map(|value| value * scale.factor).collect() };
    let lines = vec![
        line("measured", color::FAINT, MEASURED, points(&scaled(&run.measured))),
        line("before", color::ORANGE, MODEL, points(&scaled(&run.before))),
        line("after", color::BLUE, MODEL, points(&scaled(&run.after))),
    ];
    // Limit the range: a diverging model would flatten the measured curve.
    let range = extent(lines[0].points.iter().map(|point| point.1)).unwrap_or((0.0, 1.0));
    let widened = framed((range.0, range.1), f64::MIN_POSITIVE);
    let room = (widened.1 - widened.0) / 2.0;
    let seen = lines[1..].iter().flat_map(|line| line.points.iter().map(|point| point.1));
    let (low, high) = extent(seen).unwrap_or(range);
    let range = (low.min(range.0).max(widened.0 - room), high.max(range.1).min(widened.1 + room));
    let panel = |title: String, note: &str, height, range, lines| Panel {
        title,
        note: note.to_owned(),
        height,
        range,
        lines,
        guides: None,
    };
    let mut panels = vec![panel(format!("{name} ({})", scale.unit), "", 220, framed(range, f64::MIN_POSITIVE), lines)];

    let difference = |model: &[f64]| -> Vec<f64> {
        run.measured.iter().zip(model).map(|(measured, model)| measured - model).collect()
    };
    let (before, after) = (difference(&run.before), difference(&run.after));
    let most = extent(before.iter().chain(&after).map(|value| value.abs())).map_or(0.0, |(_, most)| most);
    // The error is often a thousand times smaller than the signal and gets a unit prefix of its own.
    let small = Scale::of(unit, most);
    let scaled = |values: &[f64]| -> Vec<f64> { values.iter().map(|value| value * small.factor).collect() };
    let errors = vec![
        line("before", color::ORANGE, MODEL, points(&scaled(&before))),
        line("after", color::BLUE, MODEL, points(&scaled(&after))),
    ];
    let reach = most * small.factor;
    let title = format!("Error ({})", small.unit);
    let range = framed((-reach, reach), f64::MIN_POSITIVE);
    panels.push(panel(title, "measured \u{2212} model", 130, range, errors));

    let (name, values) = &run.input;
    if !values.is_empty() {
        let line = line(name, color::PURPLE, MODEL, points(values));
        let range = extent(values.iter().copied()).unwrap_or((0.0, 1.0));
        panels.push(panel(name.clone(), "", 90, framed(range, 1e-6), vec![line]));
    }
    let described = format!("{} against time: measured, before and after", run.output.0);
    let span = spread(run.time_s.iter().copied());
    Figure { description: described, span, axis: "Time (s)".to_owned(), bands: vec![], trips_s: vec![], panels }
}

fn cause_figure(cause: &Cause) -> Figure {
    let reached = cause.before.iter().chain(&cause.after).map(|value| value.abs());
    let scale = Scale::of(&cause.unit, extent(reached).map_or(0.0, |(_, most)| most));
    let of = |values: &[f64]| -> Vec<Point> {
        cause.at.iter().zip(values).map(|(at, value)| (*at, value * scale.factor)).collect()
    };
    let error: Vec<f64> = cause.error.iter().map(|error| error * scale.factor).collect();
    // Bars of length zero draw the marks only.
    let after_error = vec![0.0; cause.after.len()];
    let line = |label: &str, color, points, error| Line { label: label.to_owned(), color, width: MODEL, points, error };
    let ends = of(&cause.before)
        .into_iter()
        .zip(&error)
        .flat_map(|((_, value), error)| [value - error, value + error])
        .chain(of(&cause.after).into_iter().map(|(_, value)| value))
        .chain([0.0]);
    let range = framed(extent(ends).unwrap_or((0.0, 1.0)), f64::MIN_POSITIVE);
    let lines = vec![
        line("before", color::ORANGE, of(&cause.before), error),
        line("after", color::BLUE, of(&cause.after), after_error),
    ];
    one_panel(&format!("Mean residual ({})", scale.unit), &cause.depends_on, &cause.at_unit, &cause.at, range, lines)
}

fn curve_figure(curve: &Curve) -> Figure {
    let points: Vec<Point> = curve.at.iter().copied().zip(curve.values.iter().copied()).collect();
    let error: Vec<f64> = curve.std.iter().map(|std| 2.0 * std).collect();
    let ends = points.iter().zip(&error).flat_map(|((_, value), error)| [value - error, value + error]).chain([0.0]);
    let range = framed(extent(ends).unwrap_or((0.0, 1.0)), f64::MIN_POSITIVE);
    let line = Line { label: "shape".to_owned(), color: color::GREEN, width: MODEL, points, error };
    one_panel(&format!("Its shape ({})", curve.unit), &curve.over, &curve.at_unit, &curve.at, range, vec![line])
}

fn one_panel(title: &str, over: &str, unit: &str, at: &[f64], range: (f64, f64), lines: Vec<Line>) -> Figure {
    let axis = if unit.is_empty() || unit == "1" { over.to_owned() } else { format!("{over} ({unit})") };
    let (first, last) = spread(at.iter().copied());
    // A margin of 2 % keeps error bars at the ends off the frame.
    let margin = 0.02 * (last - first);
    let panel = Panel { title: title.to_owned(), note: String::new(), height: 170, range, lines, guides: None };
    Figure {
        description: format!("{title} against {axis}"),
        span: (first - margin, last + margin),
        axis,
        bands: vec![],
        trips_s: vec![],
        panels: vec![panel],
    }
}

fn write_left(body: &mut String, report: &Report, scale: &Scale) -> std::fmt::Result {
    body.push_str("<section id=\"left\">\n<h2>Rejected effects, and the residual</h2>\n");
    if !report.rejected.is_empty() {
        let rows = report.rejected.iter().map(|rejected| {
            let error = Cell::Text(scale.text(rejected.blocked_rmse));
            vec![Cell::Text(rejected.name.clone()), error, Cell::Text(rejected.reason.clone())]
        });
        let table = Table {
            caption: "Effects that were tried and rejected".to_owned(),
            note: None,
            columns: vec![
                column("Effect", None, Align::Left),
                column("Error in block cross-validation", Some(&scale.unit), Align::Right),
                column("Reason", None, Align::Left),
            ],
            rows: rows.collect(),
        };
        write_table(body, &table)?;
    }
    let unexplained = &report.residual.unexplained;
    if !unexplained.is_empty() {
        let rows = unexplained.iter().map(|left| {
            let share = Cell::Text(format!("{} %", significant(100.0 * left.share)));
            let chance = if left.p_value < 1e-4 { "below 0.0001".to_owned() } else { significant(left.p_value) };
            vec![Cell::Text(left.depends_on.clone()), share, Cell::Text(chance)]
        });
        let table = Table {
            caption: "What the residual still depends on".to_owned(),
            note: None,
            columns: vec![
                column("On", None, Align::Left),
                column("Share of its variance", None, Align::Right),
                column("Chance of that in noise", None, Align::Right),
            ],
            rows: rows.collect(),
        };
        write_table(body, &table)?;
    }
    let left = match (report.residual.white, unexplained.is_empty()) {
        (true, true) => {
            "The residual is white: no correlation over time beyond chance, and it depends on no recorded signal."
        }
        (true, false) => "The residual is white: no correlation over time beyond chance.",
        (false, true) => {
            "The residual is not white: it is correlated over time beyond chance, but depends on no recorded signal."
        }
        (false, false) => "The residual is not white: it is correlated over time beyond chance.",
    };
    writeln!(body, "<p>{left}</p>\n</section>")
}

fn write_svg(body: &mut String, svg: &str) -> std::fmt::Result {
    writeln!(body, "<figure><div class=\"scroll\">\n{svg}</div></figure>")
}

fn column(title: &str, unit: Option<&str>, align: Align) -> Column {
    Column { title: title.to_owned(), unit: unit.filter(|unit| *unit != "1").map(str::to_owned), align }
}

/// Least and greatest value, widened if equal.
fn spread(values: impl Iterator<Item = f64>) -> (f64, f64) {
    match extent(values) {
        Some((low, high)) if low < high => (low, high),
        Some((low, _)) => (low - 0.5, low + 0.5),
        None => (0.0, 1.0),
    }
}

/// Unit prefix for numbers that are neither long nor full of zeros.
pub(crate) struct Scale {
    factor: f64,
    unit: String,
}

impl Scale {
    /// Scale for numbers of magnitude `size` in `unit`.
    pub(crate) fn of(unit: &str, size: f64) -> Self {
        let divisible = matches!(unit, "m" | "rad" | "m/s" | "rad/s" | "V" | "A" | "N m");
        if divisible && size > 0.0 && size < 0.1 {
            Self { factor: 1e3, unit: format!("m{unit}") }
        } else {
            Self { factor: 1.0, unit: unit.to_owned() }
        }
    }

    /// Name of the scaled unit.
    pub(crate) fn unit(&self) -> &str {
        &self.unit
    }

    /// Value in the scaled unit, without the unit.
    pub(crate) fn text(&self, value: f64) -> String {
        significant(self.factor * value)
    }

    fn with_unit(&self, value: f64) -> String {
        if self.unit == "1" { self.text(value) } else { format!("{} {}", self.text(value), self.unit) }
    }
}

/// Relative change from `before` to `after`, in brackets; empty where undefined.
fn change(before: f64, after: f64) -> String {
    let share = 100.0 * (after / before - 1.0);
    if share.is_finite() && before > 0.0 {
        format!(" ({}{} %)", if share >= 0.5 { "+" } else { "" }, number(share, 0))
    } else {
        String::new()
    }
}

/// Decimals that give `value` a number of significant `digits`.
fn decimals(value: f64, digits: i32) -> i32 {
    if value == 0.0 || !value.is_finite() { 0 } else { digits - 1 - value.abs().log10().floor() as i32 }
}

/// Formats with `decimals` digits after the point, or in scientific notation where that is unreadable.
fn fixed(value: f64, decimals: i32) -> String {
    if decimals > 8 || value.abs() >= 1e8 {
        let exponent = value.abs().log10().floor();
        if exponent.is_finite() {
            let digits = (decimals + exponent as i32).clamp(0, 6) as usize;
            return format!("{}e{}", number(value / 10_f64.powf(exponent), digits), number(exponent, 0));
        }
    }
    number(value, decimals.clamp(0, 8) as usize)
}

/// Formats with three significant digits.
pub(crate) fn significant(value: f64) -> String {
    fixed(value, decimals(value, 3))
}

#[cfg(test)]
mod tests;
