//! HTML page of a run, self-contained: no network, no fonts. A small script in it reads off plots and zooms.
//!
//! The same log and tables give the same bytes.

mod channel;
mod evaluation;
mod identify;
mod map;
mod plot;
mod series;
mod system;
mod view;

use std::fmt::Write as _;

use r4_log::Log;
use r4_protocol::Request;

pub(crate) use evaluation::evaluation;
pub(crate) use identify::{Scale, identify, significant};
pub(crate) use map::Map;
use plot::{Figure, number};
pub(crate) use system::system;

const PAGE: &str = include_str!("page.html");
const STYLE: &str = include_str!("style.css");
const SCRIPT: &str = include_str!("plot.js");

/// Table above the plots.
#[derive(Clone, Debug)]
pub(crate) struct Table {
    /// Caption; empty where a heading above names the table.
    pub(crate) caption: String,
    /// Note below the table: source of the numbers and meaning of the limits.
    pub(crate) note: Option<String>,
    /// Columns from left to right.
    pub(crate) columns: Vec<Column>,
    /// Rows from top to bottom, each with a cell per column.
    pub(crate) rows: Vec<Vec<Cell>>,
}

/// Head of a column.
#[derive(Clone, Debug)]
pub(crate) struct Column {
    /// Heading of the column.
    pub(crate) title: String,
    /// Unit of the column's numbers.
    pub(crate) unit: Option<String>,
    /// Alignment of the column's cells.
    pub(crate) align: Align,
}

/// Horizontal alignment of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Align {
    /// Flush left, for text.
    Left,
    /// Flush right, for numbers.
    Right,
}

/// Cell of a table.
#[derive(Clone, Debug)]
pub(crate) enum Cell {
    /// Text, or a number already formatted.
    Text(String),
    /// Number; a dash if it is not finite.
    Number {
        /// Value in the column's unit.
        value: f64,
        /// Digits after the decimal point.
        decimals: usize,
    },
    /// Result of a check, counted in the head of the page.
    Verdict {
        /// True if the check passed.
        pass: bool,
        /// Text of the result, such as "passed" or "0.3 V too low".
        text: String,
    },
}

/// Lines on one time axis, for comparison.
#[derive(Clone, Debug)]
pub(crate) struct Overlay {
    /// Quantity of the vertical axis, with its unit.
    pub(crate) title: String,
    /// Zero of the time axis, as in "the step".
    pub(crate) since: &'static str,
    /// Names and points (s, value): the set point first, then up to three others.
    pub(crate) lines: Vec<(String, Vec<(f64, f64)>)>,
}

/// Page for `log`, headed `title`, with `tables` above the plots.
#[must_use]
pub(crate) fn html(log: &Log, title: &str, tables: &[Table]) -> String {
    page(log, title, tables, &[], None)
}

/// Page as [`html`] returns it, with a `map` below the head and `overlays` between the tables and the plots of the log.
#[must_use]
pub(crate) fn page(log: &Log, title: &str, tables: &[Table], overlays: &[Overlay], map: Option<&Map>) -> String {
    let mut body = String::new();
    // Writing to a `String` cannot fail.
    let _ = write_body(&mut body, log, title, tables, overlays, map);
    // The title in a browser's tab and history identifies the run.
    let recorded = log.header.recorded.as_ref().map(|recorded| format!(", {}", recorded.at()));
    document(&format!("{title} \u{2013} {}{}", log.header.board, recorded.unwrap_or_default()), &body)
}

/// Complete page around `body`, which is HTML.
fn document(title: &str, body: &str) -> String {
    // Escaped text contains no "<!--", so that no inserted text is taken for a placeholder.
    PAGE.replace("<!--title-->", &escaped(title))
        .replace("<!--style-->", STYLE.trim_end())
        .replace("<!--script-->", SCRIPT.trim_end())
        .replace("<!--body-->", body)
}

/// Escapes `text` for HTML, attributes included.
fn escaped(text: &str) -> String {
    let mut html = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' => html.push_str("&amp;"),
            '<' => html.push_str("&lt;"),
            '>' => html.push_str("&gt;"),
            '"' => html.push_str("&quot;"),
            '\'' => html.push_str("&#39;"),
            other => html.push(other),
        }
    }
    html
}

fn write_body(
    body: &mut String,
    log: &Log,
    title: &str,
    tables: &[Table],
    overlays: &[Overlay],
    map: Option<&Map>,
) -> std::fmt::Result {
    write_head(body, log, title, tables)?;
    if let Some(map) = map {
        writeln!(body, "<section>\n<h2>{}</h2>", escaped(&map.title))?;
        writeln!(body, "<figure><div class=\"scroll\">\n{}</div></figure>\n</section>", map.svg())?;
    }
    for table in tables {
        write_table(body, table)?;
    }
    for overlay in overlays {
        write_figure(body, &channel::overlay_figure(overlay))?;
    }
    // A single state is the initial one: it never changed.
    if log.states.len() > 1 {
        write_table(body, &state_table(log))?;
    }
    if let Some(table) = request_table(log) {
        write_table(body, &table)?;
    }
    if log.motors.len() > 1 {
        body.push_str("<nav><span>Plots</span>");
        for series in &log.motors {
            let id = series.info.id;
            write!(body, " <a href=\"#{id}\">{id}</a>")?;
        }
        body.push_str("</nav>\n");
    }
    for series in &log.motors {
        let id = series.info.id;
        let kind = if series.is_linear() { "linear" } else { "rotary" };
        writeln!(body, "<section id=\"{id}\">\n<h2>{id} <small>{kind}</small></h2>")?;
        write_facts(body, &channel::motor_facts(series))?;
        write_figure(body, &channel::motor_figure(log, series))?;
        body.push_str("</section>\n");
    }
    if let Some(figure) = channel::input_figure(log) {
        body.push_str("<section>\n<h2>Inputs</h2>\n");
        write_figure(body, &figure)?;
        body.push_str("</section>\n");
    }
    body.push_str(
        "<footer>All times are the board's clock. Long series are drawn as the extremes of short spans of time: \
         no peak is lost.</footer>",
    );
    Ok(())
}

fn write_head(body: &mut String, log: &Log, title: &str, tables: &[Table]) -> std::fmt::Result {
    writeln!(body, "<header>\n<h1>{}</h1>", escaped(title))?;
    // Verdicts can be in any column.
    let verdicts = tables.iter().flat_map(|table| table.rows.iter().flatten());
    let verdicts: Vec<bool> =
        verdicts.filter_map(|cell| if let Cell::Verdict { pass, .. } = cell { Some(*pass) } else { None }).collect();
    let (all, passed) = (verdicts.len(), verdicts.iter().filter(|pass| **pass).count());
    match all {
        0 => {}
        _ if passed == all => writeln!(body, "<p class=\"outcome pass\">\u{2713} {passed} of {all} passed</p>")?,
        _ => writeln!(body, "<p class=\"outcome fail\">\u{2717} {} of {all} failed</p>", all - passed)?,
    }
    let header = &log.header;
    let mut facts = vec![("Robot", header.robot.clone()), ("Board", header.board.clone())];
    if let Some(recorded) = &header.recorded {
        facts.push(("Recorded", recorded.at()));
        facts.push(("Command", recorded.command.clone()));
        facts.push(("Program", recorded.program.clone()));
    }
    facts.extend([
        ("Firmware", header.firmware.clone()),
        ("Protocol", header.protocol_version.to_string()),
        ("Duration", format!("{} s", number(log.duration_s(), 3))),
    ]);
    facts.extend(header.seed.map(|seed| ("Seed", seed.to_string())));
    if let Some((start_s, _)) = log.time_span_s() {
        facts.push(("Board's clock at the start", format!("{} s", number(start_s, 3))));
    }
    write_facts(body, &facts)?;
    body.push_str("</header>\n");
    if !log.warnings.is_empty() {
        body.push_str("<div class=\"warnings\"><strong>This log is not complete</strong>\n<ul>\n");
        for warning in &log.warnings {
            writeln!(body, "<li>{}</li>", escaped(&warning.to_string()))?;
        }
        body.push_str("</ul></div>\n");
    }
    Ok(())
}

fn write_facts(body: &mut String, facts: &[(&str, String)]) -> std::fmt::Result {
    body.push_str("<dl class=\"facts\">\n");
    for (name, value) in facts {
        writeln!(body, "<div><dt>{name}</dt><dd>{}</dd></div>", escaped(value))?;
    }
    body.push_str("</dl>\n");
    Ok(())
}

fn write_figure(body: &mut String, figure: &Figure) -> std::fmt::Result {
    writeln!(body, "<figure><div class=\"scroll\">\n{}</div></figure>", figure.svg())
}

fn write_table(body: &mut String, table: &Table) -> std::fmt::Result {
    let class = |align: Align| if align == Align::Right { " class=\"right\"" } else { "" };
    writeln!(body, "<div class=\"table\"><div class=\"scroll\"><table>")?;
    if !table.caption.is_empty() {
        writeln!(body, "<caption>{}</caption>", escaped(&table.caption))?;
    }
    body.push_str("<thead><tr>");
    let is_verdict = |index: usize| table.rows.iter().any(|row| matches!(row.get(index), Some(Cell::Verdict { .. })));
    for (index, column) in table.columns.iter().enumerate() {
        let class = if is_verdict(index) { " class=\"verdict-column\"" } else { class(column.align) };
        write!(body, "<th scope=\"col\"{class}>{}", escaped(&column.title))?;
        if let Some(unit) = &column.unit {
            write!(body, " <span>({})</span>", escaped(unit))?;
        }
        body.push_str("</th>");
    }
    body.push_str("</tr></thead>\n<tbody>\n");
    for row in &table.rows {
        body.push_str("<tr>");
        for (index, cell) in row.iter().enumerate() {
            let align = table.columns.get(index).map_or(Align::Left, |column| column.align);
            match cell {
                Cell::Text(text) => write!(body, "<td{}>{}</td>", class(align), escaped(text))?,
                Cell::Number { value, decimals } => {
                    write!(body, "<td{}>{}</td>", class(align), number(*value, *decimals))?;
                }
                Cell::Verdict { pass, text } => {
                    let (kind, mark) = if *pass { ("pass", "\u{2713}") } else { ("fail", "\u{2717}") };
                    write!(body, "<td class=\"{kind}\"><span>{mark} {}</span></td>", escaped(text))?;
                }
            }
        }
        body.push_str("</tr>\n");
    }
    body.push_str("</tbody></table></div>\n");
    if let Some(note) = &table.note {
        writeln!(body, "<p class=\"note\">{}</p>", escaped(note))?;
    }
    body.push_str("</div>\n");
    Ok(())
}

/// Most rows of the request table; more would be unreadable.
const MOST_REQUESTS: usize = 100;

/// Table of requests and refusals, without set points, which are plotted, subscriptions and requests for counters.
fn request_table(log: &Log) -> Option<Table> {
    let start_s = log.time_span_s().map_or(0.0, |(start_s, _)| start_s);
    let quiet = |request: &Request| matches!(request, Request::Set { .. } | Request::Subscribe { .. } | Request::Stats);
    let asked = log.requests.iter().filter(|logged| !quiet(&logged.request));
    let asked = asked.map(|logged| (logged.time_s, logged.to_string(), String::new()));
    let refused = log.refusals.iter().map(|refused| (refused.time_s, refused.request.clone(), refused.reason.clone()));
    let mut rows: Vec<(f64, String, String)> = asked.chain(refused).collect();
    // Refusals are recorded apart from requests; merge both by time.
    rows.sort_by(|a, b| a.0.total_cmp(&b.0));
    let left_out = rows.len().saturating_sub(MOST_REQUESTS);
    // The column of reasons would be empty without refusals.
    let columns = if log.refusals.is_empty() { 2 } else { 3 };
    let cells = rows.into_iter().take(MOST_REQUESTS).map(|(time_s, request, reason)| {
        let time = Cell::Number { value: time_s - start_s, decimals: 3 };
        [time, Cell::Text(request), Cell::Text(reason)].into_iter().take(columns).collect()
    });
    let column = |title: &str, unit: Option<&str>, align| Column {
        title: title.to_owned(),
        unit: unit.map(str::to_owned),
        align,
    };
    let table = Table {
        caption: "Requests".to_owned(),
        note: (left_out > 0).then(|| format!("{left_out} more are not shown.")),
        columns: [
            column("Time", Some("s"), Align::Right),
            column("Request", None, Align::Left),
            column("Refused because", None, Align::Left),
        ]
        .into_iter()
        .take(columns)
        .collect(),
        rows: cells.collect(),
    };
    (!table.rows.is_empty()).then_some(table)
}

fn state_table(log: &Log) -> Table {
    let start_s = log.time_span_s().map_or(0.0, |(start_s, _)| start_s);
    let rows = log.states.iter().map(|change| {
        let causes = if change.causes.is_empty() { String::new() } else { change.causes.to_string() };
        let advice: Vec<&str> = change.causes.iter().map(|cause| cause.advice()).collect();
        let time = Cell::Number { value: change.time_s - start_s, decimals: 3 };
        vec![time, Cell::Text(change.state.to_string()), Cell::Text(causes), Cell::Text(advice.join("; "))]
    });
    let column = |title: &str, unit: Option<&str>, align| Column {
        title: title.to_owned(),
        unit: unit.map(str::to_owned),
        align,
    };
    Table {
        caption: "Safety state".to_owned(),
        note: None,
        columns: vec![
            column("Time", Some("s"), Align::Right),
            column("State", None, Align::Left),
            column("Causes", None, Align::Left),
            column("What to do", None, Align::Left),
        ],
        rows: rows.collect(),
    }
}

#[cfg(test)]
mod tests {
    use std::io::Cursor;

    use r4_log::{Header, Recorder};
    use r4_protocol::{
        Cause, Causes, ChannelId, ChannelInfo, ChannelKind, Mode, ModeInfo, Quality, Range, SafetyState, Sample,
        Setpoint, Telemetry, Unit,
    };

    use super::*;

    const HOSTILE: &str = "<script>alert('&\"')</script><!--body-->";

    /// Log of a motor that reaches a set point of 90 degrees, and a trip.
    fn log(ticks: u16) -> Log {
        let id = ChannelId::new(ChannelKind::Osmc, 0);
        let range = Range::symmetric(3.2);
        let duty = ModeInfo { mode: Mode::Duty, unit: Unit::Duty, range: Range::symmetric(0.9) };
        let position = ModeInfo { mode: Mode::Position, unit: Unit::Rad, range };
        let motor = ChannelInfo {
            id,
            unit: Unit::Rad,
            range,
            rate_hz: 1_000.0,
            resolution: 0.001,
            modes: [position, duty].into_iter().collect(),
        };
        let header = Header {
            robot: HOSTILE.into(),
            board: "sim:bench".into(),
            firmware: "0.1.0".into(),
            protocol_version: 1,
            channels: vec![motor],
            seed: None,
            recorded: Some(r4_log::Recorded {
                unix_ns: 1_791_000_000_000_000_000,
                program: "r4 0.1.0".into(),
                command: "r4 <demo>".into(),
                clock_offset_ns: None,
            }),
        };
        let mut recorder = Recorder::new(Cursor::new(Vec::new()), &header).expect("a vector takes everything");
        for tick in 0..ticks {
            let (state, causes) = match tick {
                ..900 => (SafetyState::Armed, Causes::NONE),
                900.. => (SafetyState::Tripped, Causes::only(Cause::DeadMan)),
            };
            let sample = Sample::Motor {
                channel: id,
                setpoint: Setpoint { mode: Mode::Position, value: std::f32::consts::FRAC_PI_2 },
                position: i32::from(tick).min(1_571),
                speed: 1.0,
                duty: 0.5,
                settled: tick > 1_580,
                homed: true,
                winding: None,
            };
            let samples = [sample].into_iter().collect();
            let frame = Telemetry { device_us: 5_000_000 + u64::from(tick) * 1_000, state, causes, samples };
            recorder.telemetry(&frame).expect("the channel is in the header");
        }
        Log::from_bytes(&recorder.finish().expect("finished").into_inner()).expect("a log")
    }

    fn table() -> Table {
        let column = |title: &str| Column { title: title.into(), unit: Some("<V>".into()), align: Align::Right };
        let verdict = |pass| Cell::Verdict { pass, text: HOSTILE.into() };
        Table {
            caption: HOSTILE.into(),
            note: Some(HOSTILE.into()),
            columns: vec![column("a"), column("b")],
            rows: vec![
                vec![Cell::Number { value: -1.25, decimals: 1 }, verdict(true)],
                vec![Cell::Number { value: f64::NAN, decimals: 1 }, verdict(false)],
                vec![Cell::Text(HOSTILE.into())],
            ],
        }
    }

    /// Log of a range sensor that stops answering halfway, and of a turning encoder with an illegal transition.
    fn input_log() -> Log {
        let channel = |kind, unit, resolution| ChannelInfo {
            id: ChannelId::new(kind, 0),
            unit,
            range: Range::symmetric(f32::MAX),
            rate_hz: 1_000.0,
            resolution,
            modes: Default::default(),
        };
        let (range, encoder) =
            (channel(ChannelKind::Range, Unit::M, 0.0), channel(ChannelKind::Encoder, Unit::Rad, 0.01));
        let samples = |tick: i16| {
            let quality = if tick < 100 { Quality::Good } else { Quality::NoAnswer };
            let reading = Sample::Reading { channel: range.id, value: 0.5, age_ms: 0, quality };
            let (position, illegal) = (tick.into(), u32::from(tick > 150));
            [reading, Sample::Encoder { channel: encoder.id, position, speed: 10.0, illegal }]
        };
        let header = Header {
            robot: "bench".into(),
            board: "sim:bench".into(),
            firmware: "0.1.0".into(),
            protocol_version: 3,
            channels: vec![range.clone(), encoder.clone()],
            seed: None,
            recorded: Some(r4_log::Recorded {
                unix_ns: 1_791_000_000_000_000_000,
                program: "r4 0.1.0".into(),
                command: "r4 <demo>".into(),
                clock_offset_ns: None,
            }),
        };
        let mut recorder = Recorder::new(Cursor::new(Vec::new()), &header).expect("a vector takes everything");
        for tick in 0..200_i16 {
            let device_us = u64::from(tick.unsigned_abs()) * 1_000;
            let samples = samples(tick).into_iter().collect();
            let frame = Telemetry { device_us, state: SafetyState::Disarmed, causes: Causes::NONE, samples };
            recorder.telemetry(&frame).expect("the channels are in the header");
        }
        Log::from_bytes(&recorder.finish().expect("finished").into_inner()).expect("a log")
    }

    #[test]
    fn readings_and_encoders_are_plotted_with_what_is_wrong() {
        let page = html(&input_log(), "run", &[]);
        for expected in [
            "range0 (m)",
            "100 of 200 not good, last: sensor does not answer",
            "encoder0 (°)",
            "encoder0 speed (°/s)",
            "illegal transitions: 1,",
        ] {
            assert!(page.contains(expected), "{expected}");
        }
    }

    #[test]
    fn nothing_that_is_shown_is_taken_for_markup() {
        let page = html(&log(2_000), HOSTILE, &[table()]);
        assert!(!page.contains("<!--") && !page.contains("<V>"));
        assert_eq!((page.matches("<script").count(), page.matches("</script>").count()), (1, 1), "the page's own");
        assert_eq!(page.matches("&lt;script&gt;").count(), 8, "title twice, robot, caption, note, three cells");
    }

    #[test]
    fn a_page_needs_nothing_else_and_is_the_same_twice() {
        let page = html(&log(2_000), "run", &[table()]);
        assert_eq!(page, html(&log(2_000), "run", &[table()]));
        for outside in ["src=", "@import", "url(h", "url(/", "<link", "fetch(", "XMLHttpRequest", "import "] {
            assert!(!page.contains(outside), "{outside}");
        }
        let addresses = page.matches("http").count();
        assert_eq!(addresses, page.matches("http://www.w3.org/2000/svg").count(), "a name, not an address");
        let geometry = page.split("data-plot=\"").nth(1).and_then(|rest| rest.split('"').next()).expect("a plot");
        let geometry: serde_json::Value = serde_json::from_str(&geometry.replace("&quot;", "\"")).expect("JSON");
        // The page's script finds lines by their colours.
        let color = geometry["panels"][0]["lines"][0]["color"].as_str().expect("a colour");
        assert!(page.contains(&format!("stroke=\"{color}\"")), "{color}");
    }

    #[test]
    fn the_head_counts_verdicts_and_the_plots_follow() {
        let page = html(&log(2_000), "run", &[table()]);
        for expected in
            ["1 of 2 failed", "1.999 s", "5.000 s", "Position (°)", "Error (°)", "limit ±0.90", "tripped: dead-man"]
        {
            assert!(page.contains(expected), "{expected}");
        }
        let when = "2026-10-03T04:00:00Z";
        for expected in [&format!("<title>run \u{2013} sim:bench, {when}</title>"), when, "r4 &lt;demo&gt;", "r4 0.1.0"]
        {
            assert!(page.contains(expected), "{expected}");
        }
        assert!(page.contains(&number(-1.25, 1)) && number(-1.25, 1).starts_with('\u{2212}'));
        assert_eq!(number(-0.001, 1), "0.0");
        assert!(html(&log(2_000), "run", &[]).matches("</p>").count() == 0, "no verdict without a table");
    }

    #[test]
    fn every_length_of_log_has_a_page() {
        for ticks in [0, 1, 2, 3, 901] {
            let page = html(&log(ticks), "run", &[]);
            assert!(page.ends_with("</html>\n"), "{ticks}");
            assert_eq!(page.matches("<svg").count(), usize::from(ticks > 0), "{ticks}");
            assert!(!page.contains("NaN") && !page.contains("inf\""), "{ticks}");
        }
    }
}
