//! Figures of the robot systems.

use super::{
    plot::{Figure, Line, Panel, color},
    series::{extent, framed},
    view,
};

/// Height of a panel, pixels.
const HEIGHT: i32 = 170;
/// Width of a line, quarters of a pixel.
const WIDTH: u32 = 6;
const COLORS: [plotters::style::RGBColor; 4] = [color::BLUE, color::ORANGE, color::GREEN, color::PURPLE];

/// Converts a system's figure for drawing.
pub(super) fn drawn(figure: &r4_systems::Figure) -> Figure {
    let points = |axis: fn(&(f64, f64)) -> f64| {
        let curves = figure.panels.iter().flat_map(|panel| &panel.curves);
        extent(curves.flat_map(|curve| &curve.points).map(axis)).unwrap_or((0.0, 1.0))
    };
    Figure {
        description: figure.description.clone(),
        span: points(|(x, _)| *x),
        axis: figure.axis.to_owned(),
        bands: Vec::new(),
        trips_s: Vec::new(),
        panels: figure.panels.iter().map(panel).collect(),
    }
}

/// Figure of a system below its views from above, as a self-contained SVG file.
pub(crate) fn system(figure: &r4_systems::Figure, views: &[r4_systems::View]) -> String {
    let panels = drawn(figure).svg().replacen('>', "><rect width=\"100%\" height=\"100%\" fill=\"#FFFFFF\"/>", 1);
    if views.is_empty() { panels } else { view::above(views, &panels, &figure.description) }
}

fn panel(panel: &r4_systems::Panel) -> Panel {
    let values = panel.curves.iter().flat_map(|curve| &curve.points).map(|(_, value)| *value);
    let line = |(curve, color): (&r4_systems::Curve, _)| Line {
        label: curve.name.to_owned(),
        color,
        width: WIDTH,
        points: curve.points.clone(),
        error: Vec::new(),
    };
    Panel {
        title: panel.title.to_owned(),
        note: String::new(),
        height: HEIGHT,
        range: framed(extent(values).unwrap_or((0.0, 1.0)), 1e-9),
        lines: panel.curves.iter().zip(COLORS).map(line).collect(),
        guides: None,
    }
}
