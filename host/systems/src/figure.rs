//! Curves and maps of a trial, drawn on the page of a system.

/// Panels above each other over one horizontal axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// Text alternative of the figure, for readers who cannot see it.
    pub description: String,
    /// The horizontal axis with its unit, as in `Time (s)`.
    pub axis: &'static str,
    /// Panels from top to bottom, which share the horizontal axis.
    pub panels: Vec<Panel>,
}

/// One plot with its vertical axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Panel {
    /// The vertical axis with its unit.
    pub title: &'static str,
    /// Curves of the panel, at most four.
    pub curves: Vec<Curve>,
}

/// A named line of a panel.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Name in the legend.
    pub name: &'static str,
    /// Points of the line, x and y in the axes' units, from left to right.
    pub points: Vec<(f64, f64)>,
}

impl Curve {
    /// Makes a curve with one point for each of `samples`.
    pub fn new<T>(name: &'static str, samples: &[T], point: impl Fn(&T) -> (f64, f64)) -> Self {
        Self { name, points: samples.iter().map(point).collect() }
    }
}

/// A square of ground from above: values of its cells, with paths and marks over them.
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Quantity that the colours show.
    pub title: String,
    /// Unit of the values, for the scale.
    pub unit: &'static str,
    /// Side of the square, m; its south-western corner is the origin.
    pub side_m: f64,
    /// Cells along a side.
    pub columns: usize,
    /// Values from the south-western cell on, row by row.
    pub values: Vec<f64>,
    /// Curves over the map, x and y in m from the origin; at most four.
    pub paths: Vec<Curve>,
    /// Marked positions, m from the origin.
    pub marks_m: Vec<[f64; 2]>,
    /// Meaning of the marks, for the legend.
    pub marks_name: &'static str,
}
