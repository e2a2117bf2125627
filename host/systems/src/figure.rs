//! Curves of a trial, to be drawn.

/// Panels above each other over one horizontal axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// What it shows, for those who cannot see it.
    pub description: String,
    /// The horizontal axis with its unit, as in `Time (s)`.
    pub axis: &'static str,
    /// From top to bottom.
    pub panels: Vec<Panel>,
}

/// One plot.
#[derive(Clone, Debug, PartialEq)]
pub struct Panel {
    /// The vertical axis with its unit.
    pub title: &'static str,
    /// At most four.
    pub curves: Vec<Curve>,
}

/// A line of a panel.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Name in the legend.
    pub name: &'static str,
    /// From left to right.
    pub points: Vec<(f64, f64)>,
}

impl Curve {
    /// A line through one point for each of `samples`.
    pub fn new<T>(name: &'static str, samples: &[T], point: impl Fn(&T) -> (f64, f64)) -> Self {
        Self { name, points: samples.iter().map(point).collect() }
    }
}

/// A square of ground from above: values of its cells, with paths and marks over them.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// What it shows.
    pub title: String,
    /// Unit of the values, for the scale.
    pub unit: &'static str,
    /// Side of the square, m; its south-western corner is the origin.
    pub side_m: f64,
    /// Cells along a side.
    pub columns: usize,
    /// Values from the south-western cell on, row by row.
    pub values: Vec<f64>,
    /// At most four.
    pub paths: Vec<Curve>,
    /// Places, m, from the origin.
    pub marks_m: Vec<[f64; 2]>,
    /// What the places are, for the legend.
    pub marks_name: &'static str,
}
