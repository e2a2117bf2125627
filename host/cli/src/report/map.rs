//! Map of a robot's world from above, with the same scale on both axes.

use std::fmt::Write as _;

use super::{escaped, plot::number};

/// Map from above; all coordinates in m.
#[derive(Clone, Debug, Default)]
pub(crate) struct Map {
    /// Heading of the map.
    pub(crate) title: String,
    /// Walls by their end points.
    pub(crate) walls_m: Vec<[[f64; 2]; 2]>,
    /// Posts by centre and radius.
    pub(crate) posts_m: Vec<([f64; 2], f64)>,
    /// Paths and radii of people.
    pub(crate) people_m: Vec<(Vec<[f64; 2]>, f64)>,
    /// Paths of the robot: name and points, at most three.
    pub(crate) ways_m: Vec<(String, Vec<[f64; 2]>)>,
    /// Outlines of the robot at some moments.
    pub(crate) outlines_m: Vec<Vec<[f64; 2]>>,
    /// Places of events, with their texts.
    pub(crate) events_m: Vec<([f64; 2], String)>,
}

/// Widths of map and legend, pixels.
const WIDTH: f64 = 760.0;
const LEGEND: f64 = 300.0;
const MARGIN_M: f64 = 0.15;
const WAYS: [(&str, f64, &str); 3] = [("#0072B2", 2.5, ""), ("#E69F00", 2.0, "7 5"), ("#009E73", 2.0, "2 4")];

impl Map {
    /// Lower left and upper right corner of everything drawn, m.
    fn extent_m(&self) -> [[f64; 2]; 2] {
        let discs = self.posts_m.iter().copied();
        let people = self.people_m.iter().flat_map(|(way, radius_m)| way.iter().map(|place| (*place, *radius_m)));
        let around = discs.chain(people).flat_map(|([x, y], r)| [[x - r, y - r], [x + r, y + r]]);
        let points = self.walls_m.iter().flatten().copied();
        let points = points.chain(self.ways_m.iter().flat_map(|(_, way)| way.iter().copied())).chain(around);
        let points =
            points.chain(self.outlines_m.iter().flatten().copied()).filter(|point| point.iter().all(|n| n.is_finite()));
        points.fold([[f64::INFINITY; 2], [f64::NEG_INFINITY; 2]], |[low, high], point| {
            [[low[0].min(point[0]), low[1].min(point[1])], [high[0].max(point[0]), high[1].max(point[1])]]
        })
    }

    /// Returns the map as an `<svg>` element; empty if there is nothing to draw.
    pub(super) fn svg(&self) -> String {
        let [low, high] = self.extent_m();
        if !low.iter().chain(&high).all(|number| number.is_finite()) {
            return String::new();
        }
        // A margin keeps walls at the edge visible at full width.
        let (low, high) = (low.map(|number| number - MARGIN_M), high.map(|number| number + MARGIN_M));
        let scale = WIDTH / (high[0] - low[0]);
        let height = scale * (high[1] - low[1]);
        // The picture's y axis points down.
        let at = |[x, y]: [f64; 2]| [(x - low[0]) * scale, (high[1] - y) * scale];
        let points = |points: &[[f64; 2]]| {
            points.iter().fold(String::new(), |mut text, point| {
                let [x, y] = at(*point);
                let _ = write!(text, "{x:.1},{y:.1} ");
                text
            })
        };
        let mut svg = format!(
            "<svg class=\"map\" viewBox=\"0 0 {:.0} {height:.0}\" role=\"img\" aria-label=\"{}\">\n<g fill=\"none\" \
             stroke-linejoin=\"round\">\n",
            WIDTH + LEGEND,
            escaped(&self.title)
        );
        // Writing to a `String` cannot fail, here and below.
        for metre in low[0].ceil() as i64..=high[0].floor() as i64 {
            let x = at([metre as f64, 0.0])[0];
            let _ = writeln!(svg, "<path stroke=\"#E6E9ED\" d=\"M{x:.1} 0V{height:.1}\"/>");
        }
        for metre in low[1].ceil() as i64..=high[1].floor() as i64 {
            let y = at([0.0, metre as f64])[1];
            let _ = writeln!(svg, "<path stroke=\"#E6E9ED\" d=\"M0 {y:.1}H{WIDTH:.1}\"/>");
        }
        for [from, to] in &self.walls_m {
            let _ =
                writeln!(svg, "<polyline stroke=\"#1B1F24\" stroke-width=\"3\" points=\"{}\"/>", points(&[*from, *to]));
        }
        for (centre, radius_m) in &self.posts_m {
            let [x, y] = at(*centre);
            let _ = writeln!(
                svg,
                "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{:.1}\" stroke=\"#1B1F24\" stroke-width=\"3\"/>",
                radius_m * scale
            );
        }
        for (way, radius_m) in &self.people_m {
            let _ = writeln!(svg, "<polyline stroke=\"#CC79A7\" stroke-width=\"1.5\" points=\"{}\"/>", points(way));
            for place in way {
                let [x, y] = at(*place);
                let _ = writeln!(
                    svg,
                    "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{:.1}\" stroke=\"#CC79A7\" stroke-width=\"1.5\"/>",
                    radius_m * scale
                );
            }
        }
        for outline in &self.outlines_m {
            let _ = writeln!(svg, "<polygon stroke=\"#9AA4AE\" points=\"{}\"/>", points(outline));
        }
        for ((_, way), (color, width, dashes)) in self.ways_m.iter().zip(WAYS) {
            let _ = writeln!(
                svg,
                "<polyline stroke=\"{color}\" stroke-width=\"{width}\" stroke-dasharray=\"{dashes}\" points=\"{}\"/>",
                points(way)
            );
        }
        svg.push_str("</g>\n<g font-size=\"14\" fill=\"#1B1F24\">\n");
        let column = WIDTH + 16.0;
        let mut row = 22.0;
        for ((name, _), (color, width, dashes)) in self.ways_m.iter().zip(WAYS) {
            let _ = writeln!(
                svg,
                "<path stroke=\"{color}\" stroke-width=\"{width}\" stroke-dasharray=\"{dashes}\" d=\"M{column} {:.1}h28\"/>",
                row - 5.0
            );
            let _ = writeln!(svg, "<text x=\"{}\" y=\"{row}\">{}</text>", column + 36.0, escaped(name));
            row += 22.0;
        }
        for (color, what, is_there) in [
            ("#CC79A7", "people and their paths", !self.people_m.is_empty()),
            ("#1B1F24", "walls and posts", !(self.walls_m.is_empty() && self.posts_m.is_empty())),
            ("#9AA4AE", "outline of the robot", !self.outlines_m.is_empty()),
        ] {
            if is_there {
                let _ =
                    writeln!(svg, "<path stroke=\"{color}\" stroke-width=\"2\" d=\"M{column} {:.1}h28\"/>", row - 5.0);
                let _ = writeln!(svg, "<text x=\"{}\" y=\"{row}\">{what}</text>", column + 36.0);
                row += 22.0;
            }
        }
        row += 10.0;
        for (number, (place, what)) in self.events_m.iter().enumerate() {
            let [x, y] = at(*place);
            let name = number + 1;
            let _ = writeln!(svg, "<circle cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"10\" fill=\"#F5CDB3\"/>");
            let _ = writeln!(
                svg,
                "<text x=\"{x:.1}\" y=\"{:.1}\" text-anchor=\"middle\" font-weight=\"600\">{name}</text>",
                y + 5.0
            );
            let _ = writeln!(svg, "<circle cx=\"{}\" cy=\"{}\" r=\"10\" fill=\"#F5CDB3\"/>", column + 10.0, row - 5.0);
            let _ = writeln!(
                svg,
                "<text x=\"{}\" y=\"{row}\" text-anchor=\"middle\" font-weight=\"600\">{name}</text>",
                column + 10.0
            );
            let _ = writeln!(svg, "<text x=\"{}\" y=\"{row}\">{}</text>", column + 28.0, escaped(what));
            row += 24.0;
        }
        let metre = at([low[0] + 1.0, low[1]])[0];
        let y = height - 12.0;
        let _ = writeln!(svg, "<path stroke=\"#1B1F24\" stroke-width=\"2\" d=\"M{column} {y:.1}h{metre:.1}\"/>");
        let _ = writeln!(svg, "<text x=\"{column}\" y=\"{:.1}\">{} m</text>\n</g></svg>", y - 8.0, number(1.0, 0));
        svg
    }
}
