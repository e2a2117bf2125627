//! Views of the ground from above: coloured cells with paths and marks.

use std::fmt::Write as _;

use r4_systems::View;

use super::{
    escaped,
    plot::number,
    series::{extent, ticks},
};

/// Sizes in pixels: figure width, side of a view, left ends of both views, width of the scale, space above and below.
const WIDTH: f64 = 1_000.0;
const SIDE: f64 = 400.0;
const LEFT: [f64; 2] = [40.0, 545.0];
const SCALE: f64 = 14.0;
const TOP: f64 = 30.0;
const FOOT: f64 = 44.0;
/// Overlap of cells, pixels, so that rounded edges leave no gaps.
const OVERLAP: f64 = 0.3;
/// Colours of low to high values, from matplotlib's "viridis"; then those of paths on them.
const COLORS: [[f64; 3]; 5] =
    [[68.0, 1.0, 84.0], [59.0, 82.0, 139.0], [33.0, 145.0, 140.0], [94.0, 201.0, 98.0], [253.0, 231.0, 37.0]];
const PATHS: [&str; 4] = ["#FFFFFF", "#FF8A5C", "#1B1F24", "#9ADCFF"];

/// Places views side by side above `panels`, an `<svg>` element with a size of its own.
pub(super) fn above(views: &[View], panels: &str, description: &str) -> String {
    let size = |name: &str| {
        let value = panels.split_once(&format!(" {name}=\""))?.1.split_once('"')?.0;
        value.parse::<f64>().ok()
    };
    let (width, height) = (size("width").unwrap_or(WIDTH), size("height").unwrap_or(WIDTH));
    let rows = views.len().div_ceil(2) as f64 * (TOP + SIDE + FOOT);
    let below = height * WIDTH / width;
    let whole = rows + below;
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH}\" height=\"{whole}\" viewBox=\"0 0 {WIDTH} {whole}\" \
         role=\"img\" aria-label=\"{}\" font-family=\"sans-serif\" font-size=\"12\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"#FFFFFF\"/>\n",
        escaped(description)
    );
    // One colour scale for all views, so that they can be compared.
    let values = views.iter().flat_map(|view| &view.values).copied();
    let range = extent(values).unwrap_or((0.0, 1.0));
    for (index, view) in views.iter().enumerate() {
        let _ = draw(&mut svg, view, range, [LEFT[index % 2], (index / 2) as f64 * (TOP + SIDE + FOOT) + TOP]);
    }
    // The panels keep their viewBox; only their size changes.
    let placed = panels.replacen(&format!(" width=\"{width}\""), &format!(" y=\"{rows}\" width=\"{WIDTH}\""), 1);
    svg.push_str(&placed.replacen(&format!(" height=\"{height}\""), &format!(" height=\"{below}\""), 1));
    svg.push_str("</svg>\n");
    svg
}

fn draw(svg: &mut String, view: &View, (low, high): (f64, f64), [left, top]: [f64; 2]) -> std::fmt::Result {
    let cell = SIDE / view.columns.max(1) as f64;
    let at = |[x_m, y_m]: [f64; 2]| [left + x_m / view.side_m * SIDE, top + SIDE - y_m / view.side_m * SIDE];
    writeln!(
        svg,
        "<text x=\"{left}\" y=\"{}\" font-weight=\"bold\" fill=\"#1B1F24\">{}</text>",
        top - 10.0,
        escaped(&view.title)
    )?;
    writeln!(svg, "<g shape-rendering=\"crispEdges\">")?;
    for (row, values) in view.values.chunks(view.columns.max(1)).enumerate() {
        let y = top + SIDE - (row + 1) as f64 * cell;
        let colors: Vec<String> = values.iter().map(|value| color((value - low) / (high - low))).collect();
        let mut column = 0;
        // Merge neighbours of one colour into one rectangle.
        for alike in colors.chunk_by(|one, other| one == other) {
            let (x, width) = (left + column as f64 * cell, alike.len() as f64 * cell + OVERLAP);
            writeln!(
                svg,
                "<rect x=\"{x:.2}\" y=\"{y:.2}\" width=\"{width:.2}\" height=\"{:.2}\" fill=\"{}\"/>",
                cell + OVERLAP,
                alike[0]
            )?;
            column += alike.len();
        }
    }
    writeln!(svg, "</g>")?;
    for (path, color) in view.paths.iter().zip(PATHS) {
        let points = path.points.iter().map(|(x_m, y_m)| at([*x_m, *y_m]));
        let points: String = points.map(|[x, y]| format!("{x:.1},{y:.1} ")).collect();
        writeln!(
            svg,
            "<polyline fill=\"none\" stroke=\"{color}\" stroke-width=\"2\" stroke-linejoin=\"round\" points=\"{points}\"/>"
        )?;
    }
    for mark_m in &view.marks_m {
        let [x, y] = at(*mark_m);
        writeln!(
            svg,
            "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"4\" fill=\"#FFFFFF\" stroke=\"#1B1F24\" stroke-width=\"1.5\"/>"
        )?;
    }
    axes(svg, view, [left, top])?;
    legend(svg, view, [left, top])?;
    scale(svg, view, (low, high), [left + SIDE + 10.0, top])
}

fn axes(svg: &mut String, view: &View, [left, top]: [f64; 2]) -> std::fmt::Result {
    writeln!(
        svg,
        "<rect x=\"{left}\" y=\"{top}\" width=\"{SIDE}\" height=\"{SIDE}\" fill=\"none\" stroke=\"#B1B9C2\"/>"
    )?;
    let (places, decimals) = ticks(0.0, view.side_m, 6);
    for place_m in places {
        let (along, text) = (place_m / view.side_m * SIDE, number(place_m, decimals));
        let (x, y) = (left + along, top + SIDE - along);
        writeln!(
            svg,
            "<text x=\"{x:.1}\" y=\"{}\" text-anchor=\"middle\" fill=\"#57606A\">{text}</text>",
            top + SIDE + 15.0
        )?;
        writeln!(
            svg,
            "<text x=\"{}\" y=\"{:.1}\" text-anchor=\"end\" fill=\"#57606A\">{text}</text>",
            left - 5.0,
            y + 4.0
        )?;
    }
    writeln!(
        svg,
        "<text x=\"{}\" y=\"{}\" text-anchor=\"end\" fill=\"#1B1F24\">m</text>",
        left + SIDE,
        top + SIDE + 30.0
    )
}

/// Draws the legend below the axis.
fn legend(svg: &mut String, view: &View, [left, top]: [f64; 2]) -> std::fmt::Result {
    let y = top + SIDE + 30.0;
    let mut x = left;
    for (path, color) in view.paths.iter().zip(PATHS) {
        // A dark background makes the light colours visible.
        writeln!(svg, "<rect x=\"{x}\" y=\"{}\" width=\"24\" height=\"10\" fill=\"#3B528B\"/>", y - 9.0)?;
        writeln!(svg, "<path stroke=\"{color}\" stroke-width=\"2\" d=\"M{x} {}h24\"/>", y - 4.0)?;
        writeln!(svg, "<text x=\"{}\" y=\"{y}\" fill=\"#57606A\">{}</text>", x + 30.0, escaped(path.name))?;
        x += 46.0 + 7.0 * path.name.len() as f64;
    }
    if !view.marks_m.is_empty() {
        writeln!(
            svg,
            "<circle cx=\"{}\" cy=\"{}\" r=\"4\" fill=\"#FFFFFF\" stroke=\"#1B1F24\" stroke-width=\"1.5\"/>",
            x + 8.0,
            y - 4.0
        )?;
        writeln!(svg, "<text x=\"{}\" y=\"{y}\" fill=\"#57606A\">{}</text>", x + 18.0, escaped(view.marks_name))?;
    }
    Ok(())
}

fn scale(svg: &mut String, view: &View, (low, high): (f64, f64), [left, top]: [f64; 2]) -> std::fmt::Result {
    const STEPS: u32 = 40;
    let step = SIDE / f64::from(STEPS);
    for index in 0..STEPS {
        let color = color((f64::from(index) + 0.5) / f64::from(STEPS));
        let y = top + SIDE - f64::from(index + 1) * step;
        writeln!(
            svg,
            "<rect x=\"{left}\" y=\"{y:.2}\" width=\"{SCALE}\" height=\"{:.2}\" fill=\"{color}\"/>",
            step + 0.3
        )?;
    }
    let (values, decimals) = ticks(low, high, 6);
    for value in values {
        let y = top + SIDE - (value - low) / (high - low) * SIDE + 4.0;
        let text = number(value, decimals);
        writeln!(svg, "<text x=\"{}\" y=\"{y:.1}\" fill=\"#57606A\">{text}</text>", left + SCALE + 4.0)?;
    }
    writeln!(svg, "<text x=\"{left}\" y=\"{}\" fill=\"#1B1F24\">{}</text>", top - 10.0, escaped(view.unit))
}

/// Colour for a share of the range, 0 to 1.
fn color(share: f64) -> String {
    let place = share.clamp(0.0, 1.0) * (COLORS.len() - 1) as f64;
    let index = (place as usize).min(COLORS.len() - 2);
    let (from, to) = (COLORS[index], COLORS[index + 1]);
    let mixed = [0, 1, 2].map(|axis| (from[axis] + (to[axis] - from[axis]) * (place - index as f64)).round() as u8);
    format!("#{:02X}{:02X}{:02X}", mixed[0], mixed[1], mixed[2])
}
