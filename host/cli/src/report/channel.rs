//! Figures of a log's channels.

use r4_log::{EncoderSample, EncoderSeries, Log, MotorSample, MotorSeries, ReadingSeries, ScalarSeries};
use r4_maths::statistics::rms;
use r4_protocol::{ChannelInfo, ChannelKind, Mode, Quality, SafetyState, Unit};

use super::{
    Overlay,
    plot::{Band, Figure, Line, Panel, color, number},
    series::{Point, as_steps, extent, framed, with_gaps, without_repeats},
};

/// Line widths, quarters of a pixel: measured lines lie on the wider set point, so that both are visible where they
/// agree.
const MEASURED: u32 = 6;
const SETPOINT: u32 = 13;

/// Figure of lines over each other: the first of `overlay` is a set point, the others are compared with it.
pub(super) fn overlay_figure(overlay: &Overlay) -> Figure {
    let colors = [color::ORANGE, color::BLUE, color::GREEN, color::PURPLE];
    let lines: Vec<Line> = overlay
        .lines
        .iter()
        .zip(colors)
        .enumerate()
        .map(|(index, ((label, points), color))| {
            let (width, points) = if index == 0 { (SETPOINT, as_steps(points)) } else { (MEASURED, points.clone()) };
            Line { label: label.clone(), color, width, points, error: Vec::new() }
        })
        .collect();
    let times = || lines.iter().flat_map(|line| line.points.iter().map(|point| point.0));
    let duration_s = times().fold(f64::MIN_POSITIVE, f64::max);
    let range = framed(values(&lines).unwrap_or((0.0, 1.0)), f64::MIN_POSITIVE);
    let title = overlay.title.clone();
    let names: Vec<_> = lines.iter().map(|line| line.label.as_str()).collect();
    let description = format!("{title} against time: {}", names.join(", "));
    let panel = Panel { title, note: String::new(), height: 260, range, lines, guides: None };
    Figure {
        description,
        span: (0.0, duration_s),
        axis: format!("Time since {} (s)", overlay.since),
        bands: vec![],
        trips_s: vec![],
        panels: vec![panel],
    }
}

/// Units for people: mm or degrees.
struct Human {
    per_si: f64,
    unit: &'static str,
    speed: &'static str,
}

impl Human {
    const LINEAR: Self = Self { per_si: 1e3, unit: "mm", speed: "mm/s" };
    const ROTARY: Self = Self { per_si: 180.0 / std::f64::consts::PI, unit: "°", speed: "°/s" };

    fn of(series: &MotorSeries) -> Self {
        if series.is_linear() { Self::LINEAR } else { Self::ROTARY }
    }

    /// Value with its unit: a space before mm, none before °.
    fn text(&self, value: f64, decimals: usize) -> String {
        let space = if self.unit == "°" { "" } else { " " };
        format!("{}{space}{}", number(value, decimals), self.unit)
    }
}

/// Figure of one motor channel.
pub(super) fn motor_figure(log: &Log, series: &MotorSeries) -> Figure {
    let clock = Clock::of(log);
    let human = Human::of(series);
    let used = |mode| series.samples.iter().any(|sample| sample.setpoint.mode == mode);
    let mut panels = Vec::new();
    panels.extend(position_panel(series, &human, &clock));
    if used(Mode::Position) {
        panels.extend(error_panel(series, &human, &clock));
    }
    if used(Mode::Speed) {
        panels.extend(speed_panel(series, &human, &clock));
    }
    panels.extend(duty_panel(series, &clock));
    panels.extend(supply_panels(log, &clock));
    let names: Vec<_> = panels.iter().map(|panel| panel.title.as_str()).collect();
    clock.figure(log, format!("{} against time: {}", series.info.id, names.join(", ")), panels)
}

/// Figure of the inputs that are not in the motors' figures; `None` without such inputs.
pub(super) fn input_figure(log: &Log) -> Option<Figure> {
    let clock = Clock::of(log);
    let mut panels = Vec::new();
    if log.motors.is_empty() {
        panels.extend(supply_panels(log, &clock));
    }
    for series in log.scalars.iter().filter(|series| series.info.id.kind != ChannelKind::Supply) {
        panels.extend(input_panel(&series.info, scalar_line(series, &clock, color::BLUE), String::new()));
    }
    for series in &log.readings {
        panels.extend(reading_panel(series, &clock));
    }
    for series in &log.encoders {
        panels.extend(encoder_panels(series, &clock));
    }
    (!panels.is_empty()).then(|| clock.figure(log, "Inputs against time".to_owned(), panels))
}

/// Facts beside the figure of `series`: range, resolution, rate, and error while settled.
pub(super) fn motor_facts(series: &MotorSeries) -> Vec<(&'static str, String)> {
    let human = Human::of(series);
    let info = &series.info;
    let mut facts = Vec::new();
    let resolution = f64::from(info.resolution) * human.per_si;
    let decimals = decimals_for(resolution);
    if info.resolution > 0.0 {
        let range = (f64::from(info.range.min) * human.per_si, f64::from(info.range.max) * human.per_si);
        if range.0.is_finite() && range.1.is_finite() {
            facts.push(("Range", format!("{} to {}", human.text(range.0, 1), human.text(range.1, 1))));
        }
        facts.push(("Resolution", human.text(resolution, if resolution >= 0.1 { 2 } else { decimals + 1 })));
    }
    let samples = series.samples.len();
    let times = || series.samples.iter().map(|sample| sample.time_s);
    let run_s = times().next_back().unwrap_or_default() - times().next().unwrap_or_default();
    let rate = if run_s > 0.0 { format!(", {} Hz", number((samples - 1) as f64 / run_s, 0)) } else { String::new() };
    facts.push(("Samples", format!("{samples}{rate}")));
    if let Some((rms, largest)) = settled_error(series) {
        let text = |value: f64| human.text(value * human.per_si, decimals);
        facts.push(("Error while settled", format!("RMS {}, largest {}", text(rms), text(largest))));
    }
    if let Some((low, high)) = extent(series.samples.iter().map(|sample| sample.duty)) {
        facts.push(("Duty", format!("{} to {}", number(low, 2), number(high, 2))));
    }
    facts
}

/// Decimals that distinguish one count from the next.
fn decimals_for(resolution: f64) -> usize {
    if resolution > 0.0 { (1.0 - resolution.log10().floor()).clamp(0.0, 6.0) as usize } else { 2 }
}

/// Set point minus position; NaN outside position mode.
fn position_error(sample: &MotorSample) -> f64 {
    if sample.setpoint.mode == Mode::Position { sample.setpoint.value - sample.position } else { f64::NAN }
}

/// Root mean square and largest magnitude of the error while the board reports settled.
fn settled_error(series: &MotorSeries) -> Option<(f64, f64)> {
    let settled = series.samples.iter().filter(|sample| sample.settled);
    let errors: Vec<f64> = settled.map(position_error).filter(|error| error.is_finite()).collect();
    let largest = extent(errors.iter().map(|error| error.abs()))?.1;
    Some((rms(&errors).ok()?, largest))
}

/// Start and length of the time axis, s.
struct Clock {
    start_s: f64,
    duration_s: f64,
}

impl Clock {
    fn of(log: &Log) -> Self {
        let (start_s, end_s) = log.time_span_s().unwrap_or((0.0, 1.0));
        Self { start_s, duration_s: if end_s > start_s { end_s - start_s } else { 1.0 } }
    }

    fn points(&self, series: &MotorSeries, value: impl Fn(&MotorSample) -> f64) -> Vec<Point> {
        series.samples.iter().map(|sample| (sample.time_s - self.start_s, value(sample))).collect()
    }

    /// Line of a measured quantity.
    fn measured(&self, series: &MotorSeries, label: &str, value: impl Fn(&MotorSample) -> f64) -> Line {
        let points = with_gaps(&self.points(series, value));
        Line { label: label.to_owned(), color: color::BLUE, width: MEASURED, points, error: Vec::new() }
    }

    /// Line of the set point while it is of `mode`.
    fn setpoint(&self, series: &MotorSeries, mode: Mode, per_si: f64) -> Line {
        let value = |sample: &MotorSample| {
            if sample.setpoint.mode == mode { sample.setpoint.value * per_si } else { f64::NAN }
        };
        let points = as_steps(&without_repeats(&with_gaps(&self.points(series, value))));
        Line { label: "set point".to_owned(), color: color::ORANGE, width: SETPOINT, points, error: Vec::new() }
    }

    fn figure(&self, log: &Log, description: String, panels: Vec<Panel>) -> Figure {
        let mut bands = Vec::new();
        let mut trips_s = Vec::new();
        if log.states.len() > 1 {
            for (index, change) in log.states.iter().enumerate() {
                let from_s = change.time_s - self.start_s;
                let next = log.states.get(index + 1);
                let to_s = next.map_or(self.duration_s, |next| next.time_s - self.start_s);
                let short = change.state.to_string();
                let mut label = short.clone();
                if !change.causes.is_empty() {
                    label += &format!(": {}", change.causes);
                }
                let color = match change.state {
                    SafetyState::Disarmed => color::DISARMED,
                    SafetyState::Armed => color::ARMED,
                    SafetyState::Tripped => color::TRIPPED,
                };
                bands.push(Band { from_s, to_s, label, short, color });
                let was_tripped = index > 0 && log.states[index - 1].state == SafetyState::Tripped;
                if change.state == SafetyState::Tripped && !was_tripped {
                    // A further cause while tripped is no further trip.
                    trips_s.push(from_s);
                }
            }
        }
        let axis = "Time since the start of the log (s)".to_owned();
        Figure { description, span: (0.0, self.duration_s), axis, bands, trips_s, panels }
    }
}

fn values<'a>(lines: impl IntoIterator<Item = &'a Line>) -> Option<(f64, f64)> {
    extent(lines.into_iter().flat_map(|line| line.points.iter().map(|point| point.1)))
}

fn position_panel(series: &MotorSeries, human: &Human, clock: &Clock) -> Option<Panel> {
    let position = clock.measured(series, "position", |sample| sample.position * human.per_si);
    let mut lines = vec![clock.setpoint(series, Mode::Position, human.per_si), position];
    lines.retain(|line| values([line]).is_some());
    let extent = values(&lines[..])?;
    // At least ten counts fill the plot, so that a motor at rest looks at rest.
    let span = 10.0 * f64::from(series.info.resolution) * human.per_si;
    Some(Panel {
        title: format!("Position ({})", human.unit),
        note: String::new(),
        height: 200,
        range: framed(extent, span.max(1e-6)),
        lines,
        guides: None,
    })
}

fn error_panel(series: &MotorSeries, human: &Human, clock: &Clock) -> Option<Panel> {
    let mut line = clock.measured(series, "error", |sample| position_error(sample) * human.per_si);
    line.color = color::GREEN;
    let (low, high) = values([&line])?;
    let largest = low.abs().max(high.abs());
    let resolution = f64::from(series.info.resolution).max(0.0) * human.per_si;
    // Zoom to the error's decay: three times the error while settled, and at least five counts.
    let zoom = settled_error(series).map(|(_, settled)| (3.0 * settled * human.per_si).max(5.0 * resolution));
    let shown = zoom.filter(|zoom| *zoom > 0.0 && *zoom < largest).unwrap_or(largest).max(1.5 * resolution);
    let note = if shown < largest {
        format!("set point \u{2212} position, zoomed: up to {} while moving", human.text(largest, 1))
    } else {
        "set point \u{2212} position".to_owned()
    };
    let guides = (resolution > 0.0).then(|| (vec![-resolution, resolution], "±1 count".to_owned()));
    Some(Panel {
        title: format!("Error ({})", human.unit),
        note,
        height: 120,
        range: framed((-shown, shown), 1e-6),
        lines: vec![line],
        guides,
    })
}

fn speed_panel(series: &MotorSeries, human: &Human, clock: &Clock) -> Option<Panel> {
    let speed = clock.measured(series, "speed", |sample| sample.speed * human.per_si);
    let lines = vec![clock.setpoint(series, Mode::Speed, human.per_si), speed];
    let range = framed(values(&lines[..])?, 1e-3);
    let title = format!("Speed ({})", human.speed);
    Some(Panel { title, note: String::new(), height: 140, range, lines, guides: None })
}

fn duty_panel(series: &MotorSeries, clock: &Clock) -> Option<Panel> {
    let mut duty = clock.measured(series, "duty", |sample| sample.duty);
    duty.color = color::PURPLE;
    let largest = values([&duty]).map(|(low, high)| low.abs().max(high.abs()))?;
    let mut lines = vec![clock.setpoint(series, Mode::Duty, 1.0), duty];
    lines.retain(|line| values([line]).is_some());
    let limits = series.info.mode(Mode::Duty).map(|mode| (f64::from(mode.range.min), f64::from(mode.range.max)));
    let mut reach = largest.max(values(&lines[..]).map_or(0.0, |(low, high)| low.abs().max(high.abs())));
    let guides = limits.filter(|(low, high)| low.is_finite() && high.is_finite()).map(|(low, high)| {
        // Draw a limit only if it leaves a third of the plot to the curve; name it in any case.
        if 3.0 * reach > high.abs().max(low.abs()) {
            reach = reach.max(high.abs()).max(low.abs());
        }
        let label = if low == -high {
            format!("limit ±{}", number(high, 2))
        } else {
            format!("limits {} and {}", number(low, 2), number(high, 2))
        };
        (vec![low, high], label)
    });
    Some(Panel {
        title: "Duty".to_owned(),
        note: "share of the supply".to_owned(),
        height: 120,
        range: framed((-reach, reach), 0.02),
        lines,
        guides,
    })
}

fn scalar_line(series: &ScalarSeries, clock: &Clock, color: plotters::style::RGBColor) -> Line {
    let points: Vec<Point> = series.samples.iter().map(|&(time_s, value)| (time_s - clock.start_s, value)).collect();
    let points = with_gaps(&points);
    let points = if series.info.unit == Unit::Bool { as_steps(&without_repeats(&points)) } else { points };
    Line { label: series.info.id.to_string(), color, width: MEASURED, points, error: Vec::new() }
}

/// Panel of a sensor: draws good values only; the note counts the others.
fn reading_panel(series: &ReadingSeries, clock: &Clock) -> Option<Panel> {
    let good = |quality| quality == Quality::Good;
    let points = series
        .samples
        .iter()
        .map(|sample| (sample.time_s - clock.start_s, if good(sample.quality) { sample.value } else { f64::NAN }));
    let points = with_gaps(&points.collect::<Vec<Point>>());
    let line =
        Line { label: series.info.id.to_string(), color: color::BLUE, width: MEASURED, points, error: Vec::new() };
    let bad = series.samples.iter().filter(|sample| !good(sample.quality));
    let note = match bad.clone().next_back() {
        Some(last) => format!("{} of {} not good, last: {}", bad.count(), series.samples.len(), last.quality),
        None => String::new(),
    };
    input_panel(&series.info, line, note)
}

/// Panels of an encoder's angle and speed.
fn encoder_panels(series: &EncoderSeries, clock: &Clock) -> Vec<Panel> {
    let human = Human::ROTARY;
    let panel = |title: String, note: String, span: f64, value: fn(&EncoderSample) -> f64| {
        let points = series.samples.iter().map(|sample| (sample.time_s - clock.start_s, value(sample) * human.per_si));
        let points = with_gaps(&points.collect::<Vec<Point>>());
        let line = Line { label: title.clone(), color: color::BLUE, width: MEASURED, points, error: Vec::new() };
        let range = framed(values([&line])?, span);
        Some(Panel { title, note, height: 110, range, lines: vec![line], guides: None })
    };
    let illegal = match series.samples.last() {
        Some(last) if last.illegal > 0 => format!("illegal transitions: {}, check its wiring", last.illegal),
        _ => String::new(),
    };
    let id = series.info.id;
    let counts = 10.0 * f64::from(series.info.resolution) * human.per_si;
    let position = panel(format!("{id} ({})", human.unit), illegal, counts.max(1e-6), |sample| sample.position);
    let speed = panel(format!("{id} speed ({})", human.speed), String::new(), 1e-3, |sample| sample.speed);
    position.into_iter().chain(speed).collect()
}

/// One panel per rail: the sag of a rail is small beside the difference between rails.
fn supply_panels(log: &Log, clock: &Clock) -> Vec<Panel> {
    let supplies = log.scalars.iter().filter(|series| series.info.id.kind == ChannelKind::Supply);
    let panel = |series: &ScalarSeries| {
        let line = scalar_line(series, clock, color::INK);
        // At least 0.5 V fill the plot: less is the converter's noise.
        let range = framed(values([&line])?, 0.5);
        let title = format!("{} (V)", series.info.id);
        Some(Panel { title, note: "supply".to_owned(), height: 80, range, lines: vec![line], guides: None })
    };
    supplies.filter_map(panel).collect()
}

fn input_panel(info: &ChannelInfo, line: Line, note: String) -> Option<Panel> {
    let extent = values([&line])?;
    let (range, unit) = match info.unit {
        Unit::Bool => (framed((0.0, 1.0), 1.0), "on = 1".to_owned()),
        unit => (framed(extent, 1e-3), unit.to_string()),
    };
    let title = format!("{} ({unit})", info.id);
    Some(Panel { title, note, height: 110, range, lines: vec![line], guides: None })
}
