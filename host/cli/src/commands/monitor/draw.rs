//! The screen: a function of the state and the size, and of nothing else.

use r4_protocol::{Causes, ChannelKind, Quality, SafetyState, Sample, Setpoint, Unit};
use ratatui::{
    Frame,
    layout::{Constraint, Layout, Rect},
    style::{Color, Modifier, Style},
    symbols::Marker,
    text::{Line, Span},
    widgets::{Axis, Block, Borders, Chart, Dataset, GraphType, Paragraph},
};

use super::state::{Row, State};
use crate::{
    commands::{speed_unit, watch},
    quantity::{Quantity, human},
    screen::state::{QUIET, WRONG, badge, wrapped},
};

/// One cell of a sparkline, s.
const CELL_S: f64 = 0.25;
/// What the graph of the selected channel shows, s.
const GRAPH_S: f64 = 30.0;
/// Lines of a graph: fewer show nothing.
const GRAPH_LINES: u16 = 6;
/// From this height on there is always room for a graph, of so many lines.
const TALL: (u16, u16) = (34, 12);

/// What keys do.
pub(super) const HELP: &str = "a arm  d disarm  c clear  space STOP  \u{2191}\u{2193} select  q quit (disarms)";

pub(super) fn draw(frame: &mut Frame<'_>, state: &State) {
    let area = frame.area();
    let mut foot_lines = match &state.message {
        Some(message) => wrapped(&message.text, area.width, if message.is_error { WRONG } else { Style::new() }),
        None => vec![Line::default()],
    };
    foot_lines.push(Line::styled(HELP, Style::new().add_modifier(Modifier::REVERSED)));
    let (above, below) = (7, u16::try_from(foot_lines.len()).unwrap_or(u16::MAX));
    let rows = u16::try_from(state.rows.len()).unwrap_or(u16::MAX);
    let room = area.height.saturating_sub(above + below);
    let left_over = room.saturating_sub(rows);
    let graph = match left_over {
        GRAPH_LINES.. => left_over,
        _ if area.height >= TALL.0 => TALL.1,
        _ => 0,
    };
    let [head, list, graph_area, foot] = Layout::vertical([
        Constraint::Length(above),
        Constraint::Fill(1),
        Constraint::Length(graph),
        Constraint::Length(below),
    ])
    .areas(area);
    frame.render_widget(Paragraph::new(self::head(state, head.width)), head);
    draw_rows(frame, state, list);
    if let Some(row) = state.rows.get(state.selected).filter(|_| graph > 0) {
        draw_graph(frame, state, row, graph_area);
    }
    frame.render_widget(Paragraph::new(foot_lines), foot);
}

/// State, causes, supply and link.
fn head(state: &State, width: u16) -> Vec<Line<'static>> {
    let is_lost = state.link.lost.is_some();
    let time = format!("{:.1} s", state.device_s);
    let name = format!("{}  {}  firmware {}", state.robot, state.board, state.firmware);
    let gap = usize::from(width).saturating_sub(name.chars().count() + time.chars().count());
    let title = Line::styled(format!("{name}{}{time}", " ".repeat(gap)), Style::new().add_modifier(Modifier::BOLD));
    let (causes, advice) = words(state);
    let style = if state.causes.is_empty() { Style::new() } else { WRONG };
    let badge = badge(Some(state.safety).filter(|_| !is_lost));
    let supplies = rows_of(state, ChannelKind::Supply).map(|row| format!("{} {} V", row.info.id, value(row)));
    let [first, second] = link(state, width);
    // What was heard before the link was lost is history.
    let inputs = Span::styled(supplies.chain(inputs(state)).collect::<Vec<_>>().join("  "), freshness(state));
    vec![
        title,
        Line::from(vec![badge, Span::raw("  "), Span::styled(causes, style)]),
        Line::styled(advice, QUIET),
        labelled("supply", inputs),
        labelled("link", first),
        labelled("", second),
        header(width),
    ]
}

fn freshness(state: &State) -> Style {
    if state.link.lost.is_some() { QUIET } else { Style::new() }
}

/// Width of a label.
const LABEL: u16 = 8;

fn labelled(label: &str, text: impl Into<Line<'static>>) -> Line<'static> {
    let mut line = text.into();
    line.spans.insert(0, Span::styled(format!("{label:<0$}", usize::from(LABEL)), QUIET));
    line
}

/// What trips the board, and what a person does about it.
fn words(state: &State) -> (String, String) {
    if state.link.lost.is_some() {
        let last = format!("last heard of {}, {}", state.safety, causes(state.causes));
        return (last, "a board that hears nothing from its host makes its outputs safe by itself".into());
    }
    let advice = match (state.causes.iter().next(), state.safety) {
        (Some(cause), _) => cause.advice(),
        (None, SafetyState::Armed) => "outputs follow what they are told",
        (None, SafetyState::Disarmed) => "outputs are safe",
        (None, SafetyState::Tripped) => "outputs are safe; clear it when it is safe to go on",
    };
    let causes = if state.causes.is_empty() { String::new() } else { causes(state.causes) };
    (causes, advice.into())
}

fn causes(causes: Causes) -> String {
    if causes.is_empty() { "no causes".into() } else { causes.to_string() }
}

fn rows_of(state: &State, kind: ChannelKind) -> impl Iterator<Item = &Row> {
    state.rows.iter().filter(move |row| row.info.id.kind == kind)
}

/// The dead-man's handle and the auxiliary stop, in words.
fn inputs(state: &State) -> impl Iterator<Item = String> {
    rows_of(state, ChannelKind::DeadMan).map(|row| {
        let is_good = match row.sample {
            Some(Sample::Scalar { value, .. } | Sample::Reading { value, .. }) => Some(value > 0.5),
            _ => None,
        };
        match (row.info.id.index, is_good) {
            (0, Some(true)) => "dead-man held".into(),
            (0, Some(false)) => "dead-man RELEASED".into(),
            (_, Some(true)) => "stop button released".into(),
            (_, Some(false)) => "stop button PRESSED".into(),
            (_, None) => format!("{} -", row.info.id),
        }
    })
}

/// How the board is heard, and what was lost.
fn link(state: &State, width: u16) -> [Line<'static>; 2] {
    let link = &state.link;
    if let Some(why) = &link.lost {
        let mut lines =
            wrapped(&format!("LOST, trying again: {why}"), width.saturating_sub(LABEL), Style::new()).into_iter();
        return [lines.next(), lines.next()]
            .map(|line| Line::from(Span::styled(line.unwrap_or_default().to_string(), WRONG)));
    }
    let counted = match &link.stats {
        Some(stats) => format!("; at the board: {} bad, {} dropped", stats.bad_frames, stats.telemetry_dropped),
        None => String::new(),
    };
    let counted = format!("here: {} bad frames, {} dropped{counted}", link.bad, link.dropped);
    if let Some(silent_s) = state.silent_s() {
        return [Span::styled(format!("SILENT for {silent_s:.1} s"), WRONG).into(), counted.into()];
    }
    let round_trip = match link.round_trip_ms {
        Some((last, longest)) => format!("round trip {last:.2} ms, longest {longest:.2}"),
        None => "round trip -".into(),
    };
    let unanswered = match link.unanswered {
        0 => String::new(),
        count => format!("  {count} unanswered"),
    };
    let rate = link.frames.hz(state.now_s);
    [format!("{round_trip}  {rate:.0} frames/s{unanswered}").into(), counted.into()]
}

/// Width of what is before the sparkline.
const COLUMNS: usize = 60;

fn header(width: u16) -> Line<'static> {
    let text = format!("  {:<11}{:>12} {:<5}{:>9} {:<6}{:>7}{:>6} ", "channel", "value", "", "speed", "", "duty", "Hz");
    let seconds = usize::from(width).saturating_sub(COLUMNS) as f64 * CELL_S;
    let last = if seconds >= 2.0 { format!("last {seconds:.0} s") } else { String::new() };
    let text = format!("{text}{last}");
    Line::styled(format!("{text:<0$}", usize::from(width)), Style::new().add_modifier(Modifier::UNDERLINED))
}

fn draw_rows(frame: &mut Frame<'_>, state: &State, area: Rect) {
    let (all, visible) = (state.rows.len(), usize::from(area.height));
    let first = state.selected.saturating_sub(visible / 2).min(all.saturating_sub(visible));
    let rows = state.rows.iter().enumerate().skip(first).take(visible);
    let lines: Vec<Line<'static>> = rows
        .map(|(index, row)| {
            // Where the list goes on beyond the screen.
            let more_above = index == first && first > 0;
            let more_below = index + 1 == first + visible && index + 1 < all;
            let mark = match (index == state.selected, more_above, more_below) {
                (true, ..) => '\u{25b8}',
                (_, true, _) => '\u{2191}',
                (_, _, true) => '\u{2193}',
                _ => ' ',
            };
            row_line(state, row, mark, area.width)
        })
        .collect();
    frame.render_widget(Paragraph::new(lines), area);
}

/// The value as people read it, or what is wrong with it.
fn value(row: &Row) -> String {
    row.sample.as_ref().map_or("-".into(), |sample| watch::columns(&row.info, sample)[0].clone())
}

fn row_line(state: &State, row: &Row, mark: char, width: u16) -> Line<'static> {
    let [number, speed, duty] = row
        .sample
        .as_ref()
        .map_or(["-".into(), String::new(), String::new()], |sample| watch::columns(&row.info, sample));
    let unit = human(row.info.unit).1;
    let speed_unit = if speed.is_empty() { "" } else { human(speed_unit(row.info.unit)).1 };
    let hz = if state.link.lost.is_some() { 0.0 } else { row.rate.hz(state.now_s) };
    let is_bad = matches!(row.sample, Some(Sample::Reading { quality, .. }) if quality != Quality::Good);
    let is_selected = mark == '\u{25b8}';
    let style = match (is_bad, is_selected) {
        (true, _) => WRONG,
        (_, true) => Style::new().add_modifier(Modifier::BOLD),
        _ => freshness(state),
    };
    let name = row.info.id.to_string();
    let text = format!("{mark} {name:<11}{number:>12} {unit:<5}{speed:>9} {speed_unit:<6}{duty:>7}{hz:>6.1} ");
    let cells = usize::from(width).saturating_sub(COLUMNS);
    let line = row.cells(state.device_s, cells, CELL_S).into_iter().map(bar).collect::<String>();
    Line::from(vec![Span::styled(text, style), Span::styled(line, Style::new().fg(Color::Cyan))])
}

/// One of eight heights, for 0 to 1.
fn bar(share: Option<f64>) -> char {
    const BARS: [char; 8] =
        ['\u{2581}', '\u{2582}', '\u{2583}', '\u{2584}', '\u{2585}', '\u{2586}', '\u{2587}', '\u{2588}'];
    share.map_or(' ', |share| BARS[((share * 8.0) as usize).min(7)])
}

/// What the selected channel has done.
fn draw_graph(frame: &mut Frame<'_>, state: &State, row: &Row, area: Rect) {
    let since_s = state.device_s - GRAPH_S;
    let points: Vec<(f64, f64)> = row
        .history
        .iter()
        .filter(|(at_s, _)| *at_s >= since_s)
        .map(|(at_s, value)| (at_s - state.device_s, *value))
        .collect();
    let bounds = row.bounds(since_s);
    let label = |value: f64| Quantity::new(value, row.info.unit).number();
    let axis = Style::new().add_modifier(Modifier::DIM);
    let dataset = Dataset::default()
        .marker(Marker::Braille)
        .graph_type(GraphType::Line)
        .style(Style::new().fg(Color::Cyan))
        .data(&points);
    let chart = Chart::new(vec![dataset])
        .block(Block::new().borders(Borders::TOP).title(title(row)))
        .x_axis(Axis::default().bounds([-GRAPH_S, 0.0]).labels([format!("-{GRAPH_S} s"), "now".into()]).style(axis))
        .y_axis(Axis::default().bounds(bounds).labels(bounds.map(label)).style(axis));
    frame.render_widget(chart, area);
}

fn title(row: &Row) -> String {
    let unit = human(row.info.unit).1;
    let mut title = format!(" {}", row.info.id);
    if !unit.is_empty() {
        title += &format!(" in {unit}");
    }
    if let Some(Sample::Motor { setpoint: Setpoint { mode, value }, settled, homed, .. }) = row.sample {
        let unit = row.info.mode(mode).map_or(Unit::Duty, |info| info.unit);
        title += &format!(", told {mode} {}", Quantity::new(value.into(), unit));
        title += if settled { ", settled" } else { "" };
        title += if homed { ", homed" } else { "" };
    }
    if let Some(Sample::Reading { quality, age_ms, .. }) = row.sample {
        title += &format!(", {quality}, {age_ms} ms old");
    }
    title + " "
}
