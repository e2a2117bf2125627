//! Screen of `r4 monitor`: a pure function of the state and the size.

use r4_protocol::{Causes, ChannelId, ChannelKind, Quality, Sample, Setpoint, Unit};
use ratatui::{
    Frame,
    layout::{Constraint, Layout, Rect},
    style::{Color, Modifier, Style},
    symbols::Marker,
    text::{Line, Span},
    widgets::{Axis, Block, Borders, Chart, Dataset, GraphType, Paragraph},
};

use super::{
    order::takes,
    state::{MOST_MARKED, Row, State, View},
};
use crate::{
    commands::watch,
    screen::state::{QUIET, WRONG, badge, wrapped},
};
use r4_rig::{
    ParameterUnits,
    quantity::{Quantity, human, speed_unit},
};

/// Time span of one cell of a sparkline, s.
const CELL_S: f64 = 0.25;
/// Time span of the graph, s.
const GRAPH_S: f64 = 30.0;
/// Fewest lines of a graph; a shorter one is not drawn.
const GRAPH_LINES: u16 = 6;
/// Terminal height, lines, from which a graph is always drawn, and the graph's height then.
const TALL: (u16, u16) = (34, 12);

/// Terminal width from which the graph is beside the channels and lists are below them.
const WIDE: u16 = 140;
/// Width of the channels then, with 6 s of history.
const LIST_WIDTH: u16 = COLUMNS as u16 + 24;
/// Fewest lines for lists below the channels, titles included; fewer are not drawn.
const LEAST_PANEL: u16 = 9;
/// Colours of the signals on the graph: of the sixteen that every terminal has, without red, which marks faults.
const COLOURS: [Color; MOST_MARKED] =
    [Color::Cyan, Color::Yellow, Color::Magenta, Color::Green, Color::LightBlue, Color::White];

/// Summary of the keys, one line.
pub(super) const HELP: &str = "a arm  d disarm  c clear  space STOP  s set  g graph  p t lists  ? help  q quit";
/// Keys and their actions, for the help page.
pub(super) const KEYS: [(&str, &str); 14] = [
    ("space", "STOP: trips the board; also while a set point is typed"),
    ("a", "arm"),
    ("d", "disarm: outputs become safe"),
    ("c", "clear a trip, once its causes are gone"),
    ("\u{2191} \u{2193} page home end", "select a channel; scroll a list"),
    ("s, Enter", "type a set point with its unit, as in 90deg"),
    ("  Enter", "send it: it holds until the next, a disarming, a trip"),
    ("  Esc, Ctrl-U", "leave without sending; clear the line"),
    ("g", "channel onto the graph or off it: up to six"),
    ("p", "parameters, from those of the selected channel on"),
    ("t", "trips stored on the board"),
    ("?", "this page"),
    ("Esc", "back to the channels"),
    ("q, Ctrl-C", "quit: stops what moves and disarms the board"),
];

pub(super) fn draw(frame: &mut Frame<'_>, state: &State) {
    let area = frame.area();
    let mut foot_lines = match (&state.prompt, &state.message) {
        (Some(_), _) => prompt(state, area.width),
        (None, Some(message)) => {
            wrapped(&message.text, area.width, if message.is_error { WRONG } else { Style::new() })
        }
        (None, None) => vec![Line::default()],
    };
    foot_lines.push(Line::styled(HELP, Style::new().add_modifier(Modifier::REVERSED)));
    let (above, below) = (6, u16::try_from(foot_lines.len()).unwrap_or(u16::MAX));
    let [head, middle, foot] =
        Layout::vertical([Constraint::Length(above), Constraint::Fill(1), Constraint::Length(below)]).areas(area);
    frame.render_widget(Paragraph::new(self::head(state, head.width)), head);
    frame.render_widget(Paragraph::new(foot_lines), foot);
    match state.view {
        View::Help => draw_list(frame, "keys", &help(middle.width), 0, middle),
        View::Parameters => draw_list(frame, "parameters", &parameters(state, None), state.scroll, middle),
        View::Trips => draw_list(frame, "trips, the newest first", &trips(state), state.scroll, middle),
        View::Channels if area.width >= WIDE => {
            let [left, _, right] =
                Layout::horizontal([Constraint::Length(LIST_WIDTH), Constraint::Length(2), Constraint::Fill(1)])
                    .areas(middle);
            draw_left(frame, state, left);
            draw_graph(frame, state, right);
        }
        View::Channels => draw_narrow(frame, state, middle),
    }
}

/// Draws the channels, and a graph below them where there is room.
fn draw_narrow(frame: &mut Frame<'_>, state: &State, area: Rect) {
    let rows = u16::try_from(state.rows.len()).unwrap_or(u16::MAX);
    let room = area.height.saturating_sub(1);
    let left_over = room.saturating_sub(rows);
    let graph = match left_over {
        GRAPH_LINES.. => left_over,
        _ if frame.area().height >= TALL.0 => TALL.1,
        _ => 0,
    };
    let [list, graph_area] = Layout::vertical([Constraint::Fill(1), Constraint::Length(graph)]).areas(area);
    draw_channels(frame, state, list);
    if graph > 0 {
        draw_graph(frame, state, graph_area);
    }
}

/// Draws the header and the channels.
fn draw_channels(frame: &mut Frame<'_>, state: &State, area: Rect) {
    let [head, list] = Layout::vertical([Constraint::Length(1), Constraint::Fill(1)]).areas(area);
    frame.render_widget(header(area.width), head);
    draw_rows(frame, state, list);
}

/// Draws the channels, and where there is room the parameters of the selected one and the trips.
fn draw_left(frame: &mut Frame<'_>, state: &State, area: Rect) {
    let lines = |count: usize| u16::try_from(count + 1).unwrap_or(u16::MAX);
    let selected = state.rows.get(state.selected).map(|row| row.info.id);
    let (of_selected, trips) = (parameters(state, selected), trips(state));
    let room = area.height.saturating_sub(lines(state.rows.len()));
    let room = if room < LEAST_PANEL { 0 } else { room };
    // At most a third of the room for the trips; the parameters get the rest.
    let trips_height = lines(trips.len()).min(room / 3);
    let [list, middle, below] = Layout::vertical([
        Constraint::Fill(1),
        Constraint::Length(lines(of_selected.len()).min(room - trips_height)),
        Constraint::Length(trips_height),
    ])
    .areas(area);
    draw_channels(frame, state, list);
    if room > 0 {
        let name = selected.map_or_else(String::new, |id| format!(" of {id}"));
        draw_list(frame, &format!("parameters{name} (p: all)"), &of_selected, 0, middle);
        draw_list(frame, "trips, the newest first (t: all)", &trips, 0, below);
    }
}

/// Draws a list below its title, from line `first`; the last line counts the lines that do not fit.
fn draw_list(frame: &mut Frame<'_>, title: &str, lines: &[Line<'static>], first: usize, area: Rect) {
    let room = usize::from(area.height.saturating_sub(1));
    let first = first.min(lines.len().saturating_sub(room));
    let mut shown: Vec<Line<'static>> = lines.iter().skip(first).take(room).cloned().collect();
    let below = lines.len() - first - shown.len();
    if let (Some(last), true) = (shown.last_mut(), below > 0) {
        *last = Line::styled(format!("  \u{2193} {} more", below + 1), QUIET);
    }
    let block = Block::new().borders(Borders::TOP).title(format!(" {title} "));
    frame.render_widget(Paragraph::new(shown).block(block), area);
}

fn help(width: u16) -> Vec<Line<'static>> {
    const KEY: usize = 22;
    let mut lines = Vec::new();
    for (key, does) in KEYS {
        for (index, line) in wrapped(does, width.saturating_sub(KEY as u16 + 4), Style::new()).into_iter().enumerate() {
            let key = if index == 0 { key } else { "" };
            let bold = Style::new().add_modifier(Modifier::BOLD);
            lines.push(Line::from(vec![Span::styled(format!("  {key:<KEY$}"), bold), Span::raw(line.to_string())]));
        }
    }
    lines
}

/// Lines of the parameters of channel `of`, or of all.
fn parameters(state: &State, of: Option<ChannelId>) -> Vec<Line<'static>> {
    let Some(all) = &state.parameters else { return vec![Line::styled("  not read yet", QUIET)] };
    let units = ParameterUnits::of(all);
    let shown = all.iter().filter(|info| of.is_none() || info.key.channel == of);
    let lines: Vec<Line<'static>> = shown
        .map(|info| {
            let name = if of.is_some() { info.key.parameter.to_string() } else { info.key.to_string() };
            let mut line = format!("  {name:<31}{:>10} {:<13}", info.active, units.unit(info.key));
            if info.set != info.active {
                line += &format!(" {} after a restart", info.set);
            } else if info.active != info.built_in {
                line += &format!(" built in: {}", info.built_in);
            }
            let changed = info.set != info.active || info.active != info.built_in;
            Line::styled(line, if changed { Style::new().add_modifier(Modifier::BOLD) } else { Style::new() })
        })
        .collect();
    if lines.is_empty() { vec![Line::styled("  none", QUIET)] } else { lines }
}

fn trips(state: &State) -> Vec<Line<'static>> {
    let Some(all) = &state.trips else { return vec![Line::styled("  not read yet", QUIET)] };
    if all.is_empty() {
        return vec![Line::styled("  none stored", QUIET)];
    }
    let line = |(index, info): (usize, &r4_protocol::FaultInfo)| {
        let seconds = info.device_us as f64 / 1e6;
        Line::raw(format!(
            "  {index:>2}  trip {:<5} {seconds:>10.3} s after start {:<5} {}",
            info.number, info.start, info.causes
        ))
    };
    all.iter().enumerate().map(line).collect()
}

/// Lines of the prompt: the typed set point, the channel's range, and the error.
fn prompt(state: &State, width: u16) -> Vec<Line<'static>> {
    let (Some(prompt), Some(row)) = (&state.prompt, state.rows.get(state.selected)) else { return Vec::new() };
    let bold = Style::new().add_modifier(Modifier::BOLD);
    let mut lines = vec![Line::from(vec![
        Span::styled(format!("{} on {}: ", row.info.id, state.board), bold),
        Span::raw(prompt.text.clone()),
        Span::styled(" ", Style::new().add_modifier(Modifier::REVERSED)),
    ])];
    let takes = takes(&row.info).unwrap_or_default();
    lines.extend(wrapped(&format!("{takes}; Enter sends, Esc leaves, space STOPS"), width, QUIET));
    lines.extend(prompt.error.iter().flat_map(|error| wrapped(error, width, WRONG)));
    lines
}

/// Lines of state, causes, supply and link.
fn head(state: &State, width: u16) -> Vec<Line<'static>> {
    let is_lost = state.link.lost.is_some();
    let time = format!("{:.1} s", state.device_s);
    let name = format!("{}  {}  firmware {}", state.robot, state.board, state.firmware);
    let gap = usize::from(width).saturating_sub(name.chars().count() + time.chars().count());
    let title = Line::styled(format!("{name}{}{time}", " ".repeat(gap)), Style::new().add_modifier(Modifier::BOLD));
    let (causes, advice) = words(state);
    let style = if state.causes.is_empty() && causes.is_empty() { Style::new() } else { WRONG };
    let badge = badge(Some(state.safety).filter(|_| !is_lost));
    let supplies = rows_of(state, ChannelKind::Supply).map(|row| format!("{} {} V", row.info.id, value(row)));
    let [first, second] = link(state, width);
    // After the link is lost, the last values are drawn as old.
    let inputs = Span::styled(supplies.chain(inputs(state)).collect::<Vec<_>>().join("  "), freshness(state));
    vec![
        title,
        Line::from(vec![badge, Span::raw("  "), Span::styled(causes, style)]),
        Line::styled(advice, QUIET),
        labelled("supply", inputs),
        labelled("link", first),
        labelled("", second),
    ]
}

fn freshness(state: &State) -> Style {
    if state.link.lost.is_some() { QUIET } else { Style::new() }
}

/// Width of a label, characters.
const LABEL: u16 = 8;

fn labelled(label: &str, text: impl Into<Line<'static>>) -> Line<'static> {
    let mut line = text.into();
    line.spans.insert(0, Span::styled(format!("{label:<0$}", usize::from(LABEL)), QUIET));
    line
}

/// Causes of a trip, or hot windings, with advice to the user.
fn words(state: &State) -> (String, String) {
    if state.link.lost.is_some() {
        let last = format!("last state {}, {}", state.safety, causes(state.causes));
        return (last, "without heartbeats from its host, a board makes its outputs safe".into());
    }
    let hot: Vec<_> = state.rows.iter().filter_map(|row| watch::hot(row.sample.as_ref()?)).collect();
    if state.causes.is_empty() && !hot.is_empty() {
        let windings: Vec<_> = hot.iter().map(r4_rig::heat::words).collect();
        return (windings.join(", "), "drive it less, or let it cool; at 100 % the board trips".into());
    }
    let advice = r4_rig::next_step(state.safety, state.causes);
    // `Causes` would print "no causes", which is noise on an armed board.
    let causes = if state.causes.is_empty() { String::new() } else { causes(state.causes) };
    (causes, advice.into())
}

fn causes(causes: Causes) -> String {
    if causes.is_empty() { "no causes".into() } else { causes.to_string() }
}

fn rows_of(state: &State, kind: ChannelKind) -> impl Iterator<Item = &Row> {
    state.rows.iter().filter(move |row| row.info.id.kind == kind)
}

/// Dead-man switch and auxiliary stop, as text.
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

/// Two lines about the link: quality, and lost or damaged frames.
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

/// Width of the columns before the sparkline.
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
    // Keep the selected channel in the middle of the list, except at the list's ends.
    let first = state.selected.saturating_sub(visible / 2).min(all.saturating_sub(visible));
    let rows = state.rows.iter().enumerate().skip(first).take(visible);
    let lines: Vec<Line<'static>> = rows
        .map(|(index, row)| {
            // Arrows mark a list that continues beyond the screen.
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

/// Value as text, or its fault.
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
    // The host's clock stands while the link is lost; the old rate would be shown on.
    let hz = if state.link.lost.is_some() { 0.0 } else { row.rate.hz(state.now_s) };
    let is_bad = matches!(row.sample, Some(Sample::Reading { quality, .. } | Sample::Sensor { quality, .. }) if quality != Quality::Good);
    let is_selected = mark == '\u{25b8}';
    let style = match (is_bad, is_selected) {
        (true, _) => WRONG,
        (_, true) => Style::new().add_modifier(Modifier::BOLD),
        _ => freshness(state),
    };
    let name = row.info.id.to_string();
    let on_graph = colour(state, row.info.id);
    let dot = Span::styled(
        if on_graph.is_some() { "\u{25cf}" } else { " " },
        Style::new().fg(on_graph.unwrap_or(Color::Reset)),
    );
    let text = format!("{name:<11}{number:>12} {unit:<5}{speed:>9} {speed_unit:<6}{duty:>7}{hz:>6.1} ");
    let cells = usize::from(width).saturating_sub(COLUMNS);
    let line = row.cells(state.device_s, cells, CELL_S).into_iter().map(bar).collect::<String>();
    let line = Span::styled(line, Style::new().fg(on_graph.unwrap_or(Color::Cyan)));
    Line::from(vec![Span::styled(mark.to_string(), style), dot, Span::styled(text, style), line])
}

/// Bar of one of eight heights, for a share of 0 to 1.
fn bar(share: Option<f64>) -> char {
    const BARS: [char; 8] =
        ['\u{2581}', '\u{2582}', '\u{2583}', '\u{2584}', '\u{2585}', '\u{2586}', '\u{2587}', '\u{2588}'];
    share.map_or(' ', |share| BARS[((share * 8.0) as usize).min(7)])
}

/// Colour of a channel on the graph; `None` if it is not marked.
fn colour(state: &State, id: ChannelId) -> Option<Color> {
    state.marked.iter().position(|marked| *marked == id).map(|at| COLOURS[at % MOST_MARKED])
}

/// Draws the history of the marked channels, or of the selected one.
fn draw_graph(frame: &mut Frame<'_>, state: &State, area: Rect) {
    let marked: Vec<&Row> =
        state.marked.iter().filter_map(|id| state.rows.iter().find(|row| row.info.id == *id)).collect();
    match (marked.as_slice(), state.rows.get(state.selected)) {
        ([], Some(selected)) => draw_signal(frame, state, selected, COLOURS[0], area),
        ([only], _) => draw_signal(frame, state, only, COLOURS[0], area),
        ([], None) => {}
        (several, _) => draw_signals(frame, state, several, area),
    }
}

/// Draws several signals. Signals of one unit share its axis; otherwise each is scaled to its own lowest and highest
/// value, which the legend prints.
fn draw_signals(frame: &mut Frame<'_>, state: &State, rows: &[&Row], area: Rect) {
    let since_s = state.device_s - GRAPH_S;
    let all: Vec<[f64; 2]> = rows.iter().map(|row| row.bounds(since_s)).collect();
    let is_one_unit = rows.iter().all(|row| row.info.unit == rows[0].info.unit);
    let common = all.iter().fold([f64::MAX, f64::MIN], |[low, high], own| [low.min(own[0]), high.max(own[1])]);
    let points: Vec<Vec<(f64, f64)>> = rows
        .iter()
        .zip(&all)
        .map(|(row, own)| {
            let recent = row.history.iter().filter(|(at_s, _)| *at_s >= since_s);
            let scaled = |value: f64| if is_one_unit { value } else { (value - own[0]) / (own[1] - own[0]) };
            recent.map(|(at_s, value)| (at_s - state.device_s, scaled(*value))).collect()
        })
        .collect();
    let datasets = points.iter().zip(COLOURS).map(|(points, colour)| dataset(points, colour)).collect();
    // Break the legend into as many lines as it needs.
    let mut legend: Vec<Line<'static>> = vec![Line::raw(" ")];
    for ((row, own), colour) in rows.iter().zip(&all).zip(COLOURS) {
        let [low, high] = own.map(|value| Quantity::new(value, row.info.unit));
        let range = if is_one_unit { String::new() } else { format!(" {} to {high}", low.number()) };
        let entry = Span::styled(format!("\u{25cf} {}{range}  ", row.info.id), Style::new().fg(colour));
        let full = legend.last().is_some_and(|line| line.width() + entry.width() > usize::from(area.width));
        if full {
            legend.push(Line::raw(" "));
        }
        if let Some(line) = legend.last_mut() {
            line.push_span(entry);
        }
    }
    let (bounds, labels) = if is_one_unit {
        let unit = rows[0].info.unit;
        if let Some(line) = legend.last_mut() {
            line.push_span(Span::raw(format!("in {} ", human(unit).1)));
        }
        (common, common.map(|value| Quantity::new(value, unit).number()))
    } else {
        ([0.0, 1.0], ["lowest".to_owned(), "highest".to_owned()])
    };
    draw_chart(frame, datasets, legend, bounds, labels, area);
}

fn dataset(points: &[(f64, f64)], colour: Color) -> Dataset<'_> {
    Dataset::default().marker(Marker::Braille).graph_type(GraphType::Line).style(Style::new().fg(colour)).data(points)
}

fn draw_chart(
    frame: &mut Frame<'_>,
    datasets: Vec<Dataset<'_>>,
    mut title: Vec<Line<'static>>,
    bounds: [f64; 2],
    labels: [String; 2],
    area: Rect,
) {
    let axis = Style::new().add_modifier(Modifier::DIM);
    let more = title.split_off(title.len().min(1));
    let height = u16::try_from(more.len() + 1).unwrap_or(u16::MAX);
    let [head, area] = Layout::vertical([Constraint::Length(height), Constraint::Fill(1)]).areas(area);
    let block = Block::new().borders(Borders::TOP).title(title.pop().unwrap_or_default());
    frame.render_widget(Paragraph::new(more).block(block), head);
    let chart = Chart::new(datasets)
        .x_axis(Axis::default().bounds([-GRAPH_S, 0.0]).labels([format!("-{GRAPH_S} s"), "now".into()]).style(axis))
        .y_axis(Axis::default().bounds(bounds).labels(labels).style(axis));
    frame.render_widget(chart, area);
}

/// Draws the history of one channel.
fn draw_signal(frame: &mut Frame<'_>, state: &State, row: &Row, colour: Color, area: Rect) {
    let since_s = state.device_s - GRAPH_S;
    let points: Vec<(f64, f64)> = row
        .history
        .iter()
        .filter(|(at_s, _)| *at_s >= since_s)
        .map(|(at_s, value)| (at_s - state.device_s, *value))
        .collect();
    let bounds = row.bounds(since_s);
    let label = |value: f64| Quantity::new(value, row.info.unit).number();
    draw_chart(frame, vec![dataset(&points, colour)], vec![title(row).into()], bounds, bounds.map(label), area);
}

fn title(row: &Row) -> String {
    let unit = human(row.info.unit).1;
    let mut title = format!(" {}", row.info.id);
    if !unit.is_empty() {
        title += &format!(" in {unit}");
    }
    if let Some(Sample::Motor { setpoint: Setpoint { mode, value }, settled, homed, winding, .. }) = row.sample {
        let unit = row.info.mode(mode).map_or(Unit::Duty, |info| info.unit);
        title += &format!(", set point {mode} {}", Quantity::new(value.into(), unit));
        title += if settled { ", settled" } else { "" };
        title += if homed { ", homed" } else { "" };
        if let Some(winding) = winding {
            title += &format!(", winding {} %", winding.heat_percent);
        }
    }
    if let Some(Sample::Reading { quality, age_ms, .. } | Sample::Sensor { quality, age_ms, .. }) = row.sample {
        title += &format!(", {quality}, {age_ms} ms old");
    }
    title + " "
}
