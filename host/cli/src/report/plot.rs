//! Plots: panels that share a horizontal axis, as one SVG; and bar charts.

use plotters::{
    prelude::*,
    style::text_anchor::{HPos, Pos, VPos},
};

use serde_json::json;

use super::series::{Point, clipped, decimated, ticks};

/// Units per pixel at natural size: the SVG backend draws in whole units only.
const UNITS: i32 = 4;
const WIDTH: i32 = 1_000;
const LEFT: i32 = 62;
const RIGHT: i32 = 14;
const TITLE: i32 = 26;
const GAP: i32 = 12;
const STRIP: i32 = 20;
const FOOT: i32 = 40;
const TEXT: i32 = 12;

/// Colours of the light page; the dark page maps them by these values, so that each has one meaning. Lines are from the
/// colour-blind-safe palette of Okabe and Ito (<https://jfly.uni-koeln.de/color/>).
pub(super) mod color {
    use plotters::style::RGBColor;

    pub(crate) const INK: RGBColor = RGBColor(0x1B, 0x1F, 0x24);
    pub(crate) const MUTED: RGBColor = RGBColor(0x57, 0x60, 0x6A);
    pub(crate) const GRID: RGBColor = RGBColor(0xE6, 0xE9, 0xED);
    pub(crate) const FRAME: RGBColor = RGBColor(0xB1, 0xB9, 0xC2);
    /// Guide line, dashed by the style sheet.
    pub(crate) const GUIDE: RGBColor = RGBColor(0x7B, 0x85, 0x90);
    /// Trip line, dashed by the style sheet.
    pub(crate) const TRIP: RGBColor = RGBColor(0xD5, 0x5E, 0x00);

    /// Wide line below others.
    pub(crate) const FAINT: RGBColor = RGBColor(0x9A, 0xA4, 0xAE);
    pub(crate) const BLUE: RGBColor = RGBColor(0x00, 0x72, 0xB2);
    pub(crate) const ORANGE: RGBColor = RGBColor(0xE6, 0x9F, 0x00);
    pub(crate) const GREEN: RGBColor = RGBColor(0x00, 0x9E, 0x73);
    pub(crate) const PURPLE: RGBColor = RGBColor(0xCC, 0x79, 0xA7);

    pub(crate) const ARMED: RGBColor = RGBColor(0xBF, 0xE7, 0xDA);
    pub(crate) const DISARMED: RGBColor = RGBColor(0xDF, 0xE3, 0xE8);
    pub(crate) const TRIPPED: RGBColor = RGBColor(0xF5, 0xCD, 0xB3);
}

/// One line of a panel.
pub(super) struct Line {
    /// Name in the legend.
    pub(super) label: String,
    pub(super) color: RGBColor,
    /// Width, quarters of a pixel.
    pub(super) width: u32,
    pub(super) points: Vec<Point>,
    /// Half heights of the error bars, one per point; empty for a line without bars and marks.
    pub(super) error: Vec<f64>,
}

/// Panel with a vertical axis of its own.
pub(super) struct Panel {
    /// Title, with the unit.
    pub(super) title: String,
    /// Note beside the title, less prominent.
    pub(super) note: String,
    /// Height of the plot area, pixels.
    pub(super) height: i32,
    /// Range of the vertical axis; lines are clipped to it.
    pub(super) range: (f64, f64),
    /// Lines, drawn in this order.
    pub(super) lines: Vec<Line>,
    /// Dashed horizontal lines, and their name.
    pub(super) guides: Option<(Vec<f64>, String)>,
}

/// Named span of time.
pub(super) struct Band {
    pub(super) from_s: f64,
    pub(super) to_s: f64,
    /// Label, drawn where it fits.
    pub(super) label: String,
    /// Shorter label, drawn where `label` does not fit.
    pub(super) short: String,
    pub(super) color: RGBColor,
}

/// Panels above each other.
pub(super) struct Figure {
    /// Description for readers who cannot see the figure.
    pub(super) description: String,
    /// Ends of the horizontal axis.
    pub(super) span: (f64, f64),
    /// Title of the horizontal axis.
    pub(super) axis: String,
    /// Bands above the panels; may be empty.
    pub(super) bands: Vec<Band>,
    /// Times marked in every panel, s.
    pub(super) trips_s: Vec<f64>,
    pub(super) panels: Vec<Panel>,
}

type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;
type Drawn = Result<(), DrawingAreaErrorKind<std::io::Error>>;

impl Figure {
    fn height(&self) -> i32 {
        let strip = if self.bands.is_empty() { 0 } else { TITLE + STRIP + GAP };
        strip + self.panels.iter().map(|panel| TITLE + panel.height + GAP).sum::<i32>() - GAP + FOOT
    }

    /// Returns the figure as an `<svg>` element that fills the available width.
    pub(super) fn svg(&self) -> String {
        let (width, height) = (WIDTH * UNITS, self.height().max(FOOT) * UNITS);
        let mut svg = String::new();
        {
            let area = SVGBackend::with_string(&mut svg, (width.unsigned_abs(), height.unsigned_abs()));
            let area = area.into_drawing_area();
            // Drawing into a string cannot fail; an error would only leave the picture incomplete.
            let _ = self.draw(&area).and_then(|()| area.present());
        }
        described(&svg, &self.description, Some(&self.geometry()))
    }

    /// Places of panels and lines in viewBox units, as JSON: `plot.js` needs it to read off the plot.
    fn geometry(&self) -> String {
        let strip = if self.bands.is_empty() { 0 } else { TITLE + STRIP + GAP };
        let mut top = strip;
        let panels: Vec<_> = self
            .panels
            .iter()
            .map(|panel| {
                let first = top + TITLE;
                top = first + panel.height + GAP;
                let lines: Vec<_> =
                    panel.lines.iter().map(|line| json!({"label": line.label, "color": hex(line.color)})).collect();
                let ends = (first * UNITS, (first + panel.height) * UNITS);
                let (low, high) = panel.range;
                json!({"title": panel.title, "top": ends.0, "bottom": ends.1, "low": low, "high": high, "lines": lines})
            })
            .collect();
        json!({
            "axis": self.axis,
            "left": LEFT * UNITS,
            "right": (WIDTH - RIGHT) * UNITS,
            // Place of the reading: below the tick labels, above the axis title.
            "foot": (top - GAP + 26) * UNITS,
            "bandsTop": TITLE * UNITS,
            "bandsBottom": if self.bands.is_empty() { 0 } else { (TITLE + STRIP) * UNITS },
            "grid": hex(color::GRID),
            "span": [self.span.0, self.span.1],
            "panels": panels,
        })
        .to_string()
    }

    fn draw(&self, area: &Area) -> Drawn {
        let mut top = 0;
        if !self.bands.is_empty() {
            text(area, (LEFT, top + TITLE - 8), HPos::Left, "Safety state", color::INK, true)?;
            self.draw_bands(area, top + TITLE)?;
            top += TITLE + STRIP + GAP;
        }
        for (index, panel) in self.panels.iter().enumerate() {
            let last = index + 1 == self.panels.len();
            self.draw_panel(area, panel, top, last)?;
            top += TITLE + panel.height + GAP;
        }
        Ok(())
    }

    fn x(&self, at: f64) -> f64 {
        let (first, last) = self.span;
        f64::from(LEFT) + (at - first) / (last - first) * f64::from(WIDTH - LEFT - RIGHT)
    }

    fn draw_bands(&self, area: &Area, top: i32) -> Drawn {
        for band in &self.bands {
            let (left, right) = (self.x(band.from_s), self.x(band.to_s));
            let corners = [units((left, f64::from(top))), units((right, f64::from(top + STRIP)))];
            area.draw(&Rectangle::new(corners, band.color.filled()))?;
            let fitting = [&band.label, &band.short].into_iter().find(|label| text_width(label) + 8.0 < right - left);
            let position = (left as i32 + 6, top + STRIP / 2 + 4);
            text(area, position, HPos::Left, fitting.map_or("", |label| label), color::INK, false)?;
        }
        Ok(())
    }

    fn draw_panel(&self, area: &Area, panel: &Panel, top: i32, last: bool) -> Drawn {
        let (low, high) = panel.range;
        let (first, end) = (top + TITLE, top + TITLE + panel.height);
        let y = |value: f64| f64::from(end) - (value - low) / (high - low) * f64::from(panel.height);
        let (left, right) = (f64::from(LEFT), f64::from(WIDTH - RIGHT));

        text(area, (LEFT, top + TITLE - 8), HPos::Left, &panel.title, color::INK, true)?;
        // Bold text is about 8 % wider.
        let note = LEFT + (text_width(&panel.title) * 1.08) as i32 + 10;
        text(area, (note, top + TITLE - 8), HPos::Left, &panel.note, color::MUTED, false)?;
        draw_legend(area, panel, top + TITLE - 8)?;

        // About 12 labels fit the width.
        let (times, decimals) = ticks(self.span.0, self.span.1, 12);
        for time_s in times {
            let x = self.x(time_s);
            stroke(area, &[(x, f64::from(first)), (x, f64::from(end))], color::GRID, 4)?;
            if last {
                text(area, (x as i32, end + 17), HPos::Center, &number(time_s, decimals), color::MUTED, false)?;
            }
        }
        if last {
            text(area, ((LEFT + WIDTH - RIGHT) / 2, end + 34), HPos::Center, &self.axis, color::INK, false)?;
        }
        // One label per 25 px.
        let (values, decimals) = ticks(low, high, (panel.height / 25).unsigned_abs().max(2));
        for value in values {
            let zero = if value == 0.0 && low < 0.0 { color::FRAME } else { color::GRID };
            stroke(area, &[(left, y(value)), (right, y(value))], zero, 4)?;
            let position = (LEFT - 8, y(value) as i32 + 4);
            text(area, position, HPos::Right, &number(value, decimals), color::MUTED, false)?;
        }
        for value in panel.guides.iter().flat_map(|(values, _)| values) {
            if (low..=high).contains(value) {
                stroke(area, &[(left, y(*value)), (right, y(*value))], color::GUIDE, 5)?;
            }
        }
        for time_s in &self.trips_s {
            let x = self.x(*time_s);
            stroke(area, &[(x, f64::from(first)), (x, f64::from(end))], color::TRIP, 5)?;
        }
        let frame = [units((left, f64::from(first))), units((right, f64::from(end)))];
        area.draw(&Rectangle::new(frame, color::FRAME.stroke_width(4)))?;
        for line in &panel.lines {
            for (&(at, value), &error) in line.points.iter().zip(&line.error) {
                let (low, high) = (y((value + error).min(high)), y((value - error).max(low)));
                let x = self.x(at);
                if low.is_finite() && high.is_finite() && low <= high {
                    stroke(area, &[(x, low), (x, high)], line.color, 4)?;
                    let mark = [(x - 3.0, y(value) - 3.0), (x + 3.0, y(value) + 3.0)];
                    area.draw(&Rectangle::new(mark.map(units), line.color.filled()))?;
                }
            }
            for part in clipped(&decimated(&line.points), panel.range) {
                let part: Vec<Point> = part.iter().map(|&(time_s, value)| (self.x(time_s), y(value))).collect();
                stroke(area, &part, line.color, line.width)?;
            }
        }
        Ok(())
    }
}

/// Bar chart of names and numbers. The first bar, and each one longer than the bar above it, are highlighted.
pub(super) struct Bars {
    /// Description for readers who cannot see the chart.
    pub(super) description: String,
    /// Name, value, and text after the bar.
    pub(super) rows: Vec<(String, f64, String)>,
}

/// Height of one bar and the space below it, pixels.
const BAR: i32 = 26;

impl Bars {
    /// Returns the chart as an `<svg>` element that fills the available width.
    pub(super) fn svg(&self) -> String {
        let height = (BAR * self.rows.len().max(1) as i32 + GAP) * UNITS;
        let mut svg = String::new();
        {
            let area = SVGBackend::with_string(&mut svg, ((WIDTH * UNITS).unsigned_abs(), height.unsigned_abs()));
            let area = area.into_drawing_area();
            // Cannot fail, as in `Figure::svg`.
            let _ = self.draw(&area).and_then(|()| area.present());
        }
        described(&svg, &self.description, None)
    }

    fn draw(&self, area: &Area) -> Drawn {
        let widest = |texts: &mut dyn Iterator<Item = &String>| texts.map(|text| text_width(text)).fold(0.0, f64::max);
        let left = widest(&mut self.rows.iter().map(|row| &row.0)).min(f64::from(WIDTH) / 3.0) + 12.0;
        let room = f64::from(WIDTH) - left - widest(&mut self.rows.iter().map(|row| &row.2)) - 24.0;
        let most =
            self.rows.iter().map(|row| row.1).filter(|value| value.is_finite()).fold(f64::MIN_POSITIVE, f64::max);
        for (index, (name, value, behind)) in self.rows.iter().enumerate() {
            let top = f64::from(BAR * index as i32) + 4.0;
            let baseline = top as i32 + 14;
            let right = left + if value.is_finite() { room.max(50.0) * value.max(0.0) / most } else { 0.0 };
            let worse = index == 0 || *value > self.rows[index - 1].1;
            let color = if worse { color::ORANGE } else { color::BLUE };
            text(area, (left as i32 - 10, baseline), HPos::Right, name, color::INK, false)?;
            area.draw(&Rectangle::new([units((left, top)), units((right, top + 18.0))], color.filled()))?;
            text(area, (right as i32 + 8, baseline), HPos::Left, behind, color::MUTED, false)?;
        }
        Ok(())
    }
}

/// Adds the description and the geometry for the page's script to an SVG.
fn described(svg: &str, description: &str, geometry: Option<&str>) -> String {
    let label = super::escaped(description);
    let geometry = geometry.map_or_else(String::new, |json| format!(" data-plot=\"{}\"", super::escaped(json)));
    svg.replacen("<svg ", &format!("<svg class=\"plot\" role=\"img\" aria-label=\"{label}\"{geometry} "), 1)
}

/// Formats a colour as the SVG backend does.
fn hex(color: RGBColor) -> String {
    format!("#{:02X}{:02X}{:02X}", color.0, color.1, color.2)
}

/// Draws the legend at the right end of the title's line.
fn draw_legend(area: &Area, panel: &Panel, baseline: i32) -> Drawn {
    let guides = panel.guides.iter().map(|(_, label)| (label, color::GUIDE, 5));
    let lines = panel.lines.iter().map(|line| (&line.label, line.color, line.width));
    let entries: Vec<_> = lines.chain(guides).collect();
    let several = entries.len() > 1;
    let mut right = f64::from(WIDTH - RIGHT);
    // The title already names a single line.
    for (label, color, width) in entries.into_iter().rev().filter(|_| several) {
        right -= text_width(label);
        text(area, (right as i32, baseline), HPos::Left, label, color::MUTED, false)?;
        right -= 6.0;
        let y = f64::from(baseline - 4);
        stroke(area, &[(right - 20.0, y), (right, y)], color, width.max(6))?;
        right -= 20.0 + 16.0;
    }
    Ok(())
}

fn units((x, y): (f64, f64)) -> (i32, i32) {
    let units = f64::from(UNITS);
    ((x * units).round() as i32, (y * units).round() as i32)
}

fn stroke(area: &Area, path: &[(f64, f64)], color: RGBColor, width: u32) -> Drawn {
    let mut path: Vec<_> = path.iter().map(|&point| units(point)).collect();
    // Points that round to the same unit draw nothing.
    path.dedup();
    if path.len() < 2 {
        return Ok(());
    }
    area.draw(&PathElement::new(path, color.stroke_width(width)))
}

/// Draws text; `position` is on its baseline.
fn text(area: &Area, (x, y): (i32, i32), anchor: HPos, text: &str, color: RGBColor, bold: bool) -> Drawn {
    if text.is_empty() {
        return Ok(());
    }
    // The backend writes 1/1.24 of the size, and puts `Bottom` half an x-height (about a quarter of the size) above.
    let size = f64::from(TEXT * UNITS) * 1.24;
    let style = if bold { FontStyle::Bold } else { FontStyle::Normal };
    let style = TextStyle::from(("sans-serif", size, style)).pos(Pos::new(anchor, VPos::Bottom)).color(&color);
    area.draw(&Text::new(text.to_owned(), (x * UNITS, y * UNITS + TEXT), style))
}

/// Approximate width of text, pixels: the viewer's font is not known here.
fn text_width(text: &str) -> f64 {
    text.chars().count() as f64 * f64::from(TEXT) * 0.58
}

/// Formats a number with a typographic minus sign; a dash if it is not finite.
pub(super) fn number(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return "\u{2013}".to_owned();
    }
    let digits = format!("{:.decimals$}", value.abs());
    let negative = value < 0.0 && digits.contains(|digit| ('1'..='9').contains(&digit));
    if negative { format!("\u{2212}{digits}") } else { digits }
}
