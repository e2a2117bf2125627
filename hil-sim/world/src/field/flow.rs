//! Steady air flow round the walls of a scene: potential flow on a grid.
//!
//! Walls close the faces between the cells that they separate, so they need no thickness. Conjugate gradients solve
//! Laplace's equation for the potential, with a given speed at the inlets and one pressure at the outlets. Within a
//! cell each component of the velocity is linear along its own axis (Raviart-Thomas elements of lowest order), so the
//! flow is free of divergence and does not pass through walls. Potential flow has no wakes: behind a shelf the air
//! follows the corner without whirling.

use crate::scene::{Point, Scene, Segment, cross, length, minus};

/// Largest number of cells of a grid.
const CELLS_MAX: usize = 100_000;
/// Norm of the final residual relative to that at the start. At 1e-10 the cells' divergence is below 1e-8 of the
/// inlet's flow.
const RESIDUAL: f64 = 1e-10;

/// Domain of the flow and its openings.
#[derive(Clone, Debug, PartialEq)]
pub struct FlowSpec {
    /// Lower and upper corner of the domain, m. Its rim is closed except for the openings.
    pub corners_m: [Point; 2],
    /// Side of a cell, m; narrower passages are closed.
    pub cell_m: f64,
    /// Parts of the rim where air enters, each from point to point, m.
    pub inlets_m: Vec<[Point; 2]>,
    /// Parts of the rim where air leaves, each from point to point, m.
    pub outlets_m: Vec<[Point; 2]>,
    /// Air speed in the inlets, m/s.
    pub speed_m_s: f64,
}

/// Reasons why a flow cannot be computed.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FlowError {
    /// Parameters that make no grid.
    #[error(
        "the domain needs lower and upper corners, `cell_m` and `speed_m_s` above 0, and at most {CELLS_MAX} cells"
    )]
    Grid,
    /// An opening that is not on the rim.
    #[error("`{which}` {number} is on no side of the domain: give two points on one side, a cell or more apart")]
    Opening {
        /// Name of the field, `inlets_m` or `outlets_m`.
        which: &'static str,
        /// Index of the opening, from 0.
        number: usize,
    },
    /// Inlet and outlet separated by walls.
    #[error("air of an inlet reaches no outlet: open the walls between, or make `cell_m` smaller than the passages")]
    Closed,
}

/// A computed flow field.
#[derive(Clone, Debug, PartialEq)]
pub struct Flow {
    from_m: Point,
    cell_m: f64,
    size: [usize; 2],
    /// Velocity through the lower face of each cell and the upper one of the last, by axis, m/s.
    faces: [Vec<f64>; 2],
    /// True for faces that air passes, by axis.
    open: [Vec<bool>; 2],
    /// True for cells connected to an outlet.
    wet: Vec<bool>,
}

impl Flow {
    /// The flow around the walls and posts of a scene, without people.
    ///
    /// # Errors
    /// [`FlowError`] if the specification makes no grid, an opening is not on the rim, or no air can flow.
    pub fn new(spec: &FlowSpec, scene: &Scene) -> Result<Self, FlowError> {
        let [from_m, to_m] = spec.corners_m;
        let extent = minus(to_m, from_m);
        let counts = extent.map(|side| (side / spec.cell_m).round());
        let fits = counts.iter().all(|count| *count >= 1.0) && counts[0] * counts[1] <= CELLS_MAX as f64;
        if !(spec.cell_m > 0.0 && fits && spec.speed_m_s > 0.0 && spec.speed_m_s.is_finite()) {
            return Err(FlowError::Grid);
        }
        let size = counts.map(|count| count as usize);
        let faces = [vec![0.0; (size[0] + 1) * size[1]], vec![0.0; size[0] * (size[1] + 1)]];
        let open = [vec![true; faces[0].len()], vec![true; faces[1].len()]];
        let mut flow = Self { from_m, cell_m: spec.cell_m, size, faces, open, wet: vec![false; size[0] * size[1]] };
        flow.close(scene);
        let inlets = flow.openings("inlets_m", &spec.inlets_m)?;
        let outlets = flow.openings("outlets_m", &spec.outlets_m)?;
        flow.flood(&outlets);
        let (sides, wet) = (inlets.iter().chain(&outlets), &flow.wet);
        if inlets.is_empty() || outlets.is_empty() || !sides.clone().all(|opening| wet[opening.cell]) {
            return Err(FlowError::Closed);
        }
        flow.solve(&inlets, &outlets, spec.speed_m_s);
        Ok(flow)
    }

    fn cell(&self, [x, y]: [usize; 2]) -> usize {
        y * self.size[0] + x
    }

    /// Index of the face of `axis` at the lower side of a cell; with one more along the axis, at its upper side.
    fn face(&self, axis: usize, [x, y]: [usize; 2]) -> usize {
        if axis == 0 { y * (self.size[0] + 1) + x } else { y * self.size[0] + x }
    }

    fn centre(&self, [x, y]: [usize; 2]) -> Point {
        let middle = |number: usize| (number as f64 + 0.5) * self.cell_m;
        [self.from_m[0] + middle(x), self.from_m[1] + middle(y)]
    }

    fn cells(&self) -> impl Iterator<Item = [usize; 2]> + use<> {
        let [across, up] = self.size;
        (0..up).flat_map(move |y| (0..across).map(move |x| [x, y]))
    }

    /// Closes the rim, and the faces between cells that a wall or post separates.
    fn close(&mut self, scene: &Scene) {
        let posts: Vec<_> = scene.posts().collect();
        for at in self.cells() {
            let here = self.centre(at);
            for axis in 0..2 {
                let face = self.face(axis, at);
                let mut upper = at;
                upper[axis] += 1;
                if upper[axis] == self.size[axis] {
                    let rim = self.face(axis, upper);
                    self.open[axis][rim] = false;
                }
                if at[axis] == 0 {
                    self.open[axis][face] = false;
                    continue;
                }
                let mut below = here;
                below[axis] -= self.cell_m;
                let between = Segment { from: below, to: here };
                let walled = scene.segments().iter().any(|wall| crosses(wall, &between));
                let full = posts.iter().any(|post| post.distance_m(here) < 0.0 || post.distance_m(below) < 0.0);
                self.open[axis][face] = !(walled || full);
            }
        }
    }

    /// Faces of the rim within the given parts.
    fn openings(&self, which: &'static str, parts: &[[Point; 2]]) -> Result<Vec<Opening>, FlowError> {
        let mut openings = Vec::new();
        for (number, [from, to]) in parts.iter().enumerate() {
            let before = openings.len();
            for axis in 0..2 {
                for last in [false, true] {
                    let end = if last { self.size[axis] } else { 0 };
                    let rim_m = self.from_m[axis] + end as f64 * self.cell_m;
                    if (from[axis] - rim_m).abs() > 0.5 * self.cell_m || (to[axis] - rim_m).abs() > 0.5 * self.cell_m {
                        continue;
                    }
                    let (low_m, high_m) = (from[1 - axis].min(to[1 - axis]), from[1 - axis].max(to[1 - axis]));
                    for along in 0..self.size[1 - axis] {
                        let mut at = [along; 2];
                        at[axis] = if last { end - 1 } else { 0 };
                        if !(low_m..=high_m).contains(&self.centre(at)[1 - axis]) {
                            continue;
                        }
                        let cell = self.cell(at);
                        at[axis] = end;
                        openings.push(Opening { axis, face: self.face(axis, at), cell, last });
                    }
                }
            }
            if openings.len() == before {
                return Err(FlowError::Opening { which, number });
            }
        }
        Ok(openings)
    }

    /// Marks the cells connected to an outlet.
    fn flood(&mut self, outlets: &[Opening]) {
        let mut next: Vec<usize> = outlets.iter().map(|outlet| outlet.cell).collect();
        while let Some(cell) = next.pop() {
            if !std::mem::replace(&mut self.wet[cell], true) {
                next.extend(self.neighbours(cell).into_iter().flatten());
            }
        }
    }

    /// Neighbours of a cell behind its open faces.
    fn neighbours(&self, cell: usize) -> [Option<usize>; 4] {
        let at = [cell % self.size[0], cell / self.size[0]];
        let strides = [1, self.size[0]];
        std::array::from_fn(|side| {
            let (axis, upwards) = (side / 2, side % 2 == 1);
            let mut face = at;
            face[axis] += usize::from(upwards);
            let inside = if upwards { face[axis] < self.size[axis] } else { at[axis] > 0 };
            let there = if upwards { cell + strides[axis] } else { cell.wrapping_sub(strides[axis]) };
            (inside && self.open[axis][self.face(axis, face)]).then_some(there)
        })
    }

    /// Solves for the potential by conjugate gradients (Hestenes, Stiefel 1952), and derives the velocity at the faces.
    fn solve(&mut self, inlets: &[Opening], outlets: &[Opening], speed_m_s: f64) {
        let count = self.wet.len();
        let links: Vec<_> = (0..count).map(|cell| self.neighbours(cell)).collect();
        // the outlet is half a cell away from the centre of its cell
        let mut outflow = vec![0.0; count];
        outlets.iter().for_each(|outlet| outflow[outlet.cell] += 2.0);
        let mut residual = vec![0.0; count];
        inlets.iter().for_each(|inlet| residual[inlet.cell] += speed_m_s * self.cell_m);
        let apply = |of: &[f64], to: &mut [f64]| {
            for (cell, value) in to.iter_mut().enumerate() {
                let around = links[cell].iter().flatten().map(|other| of[cell] - of[*other]).sum::<f64>();
                *value = outflow[cell] * of[cell] + around;
            }
        };
        let mut potential = vec![0.0; count];
        let (mut direction, mut image) = (residual.clone(), vec![0.0; count]);
        let square = |of: &[f64]| of.iter().map(|value| value * value).sum::<f64>();
        let mut left = square(&residual);
        let enough = left * RESIDUAL * RESIDUAL;
        // in exact arithmetic, as many steps as cells are sufficient
        for _ in 0..count {
            if left <= enough {
                break;
            }
            apply(&direction, &mut image);
            let along = direction.iter().zip(&image).map(|(one, other)| one * other).sum::<f64>();
            let step = left / along;
            for cell in 0..count {
                potential[cell] += step * direction[cell];
                residual[cell] -= step * image[cell];
            }
            let before = std::mem::replace(&mut left, square(&residual));
            for (towards, rest) in direction.iter_mut().zip(&residual) {
                *towards = rest + left / before * *towards;
            }
        }
        let strides = [1, self.size[0]];
        for at in self.cells() {
            let cell = self.cell(at);
            for axis in 0..2 {
                let face = self.face(axis, at);
                if at[axis] > 0 && self.open[axis][face] {
                    self.faces[axis][face] = (potential[cell - strides[axis]] - potential[cell]) / self.cell_m;
                }
            }
        }
        for (openings, is_inlet) in [(inlets, true), (outlets, false)] {
            for Opening { axis, face, cell, last } in openings.iter().copied() {
                let inwards_m_s = if is_inlet { speed_m_s } else { -2.0 * potential[cell] / self.cell_m };
                self.faces[axis][face] = if last { -inwards_m_s } else { inwards_m_s };
                // no filament leaves through an inlet
                self.open[axis][face] = !is_inlet;
            }
        }
    }

    /// Indices of the cell around a point; `None` outside the domain.
    fn around(&self, point: Point) -> Option<[usize; 2]> {
        let at = [0, 1].map(|axis| ((point[axis] - self.from_m[axis]) / self.cell_m).floor());
        let inside = (0..2).all(|axis| at[axis] >= 0.0 && at[axis] < self.size[axis] as f64);
        inside.then(|| at.map(|number| number as usize))
    }

    /// Side of a cell, m.
    #[must_use]
    pub const fn cell_m(&self) -> f64 {
        self.cell_m
    }

    /// True if air from an inlet can reach the point.
    #[must_use]
    pub fn is_wet(&self, point: Point) -> bool {
        self.around(point).is_some_and(|at| self.wet[self.cell(at)])
    }

    /// Velocity of the air, m/s; 0 outside the domain.
    #[must_use]
    pub fn velocity_m_s(&self, point: Point) -> Point {
        let Some(at) = self.around(point) else { return [0.0; 2] };
        [0, 1].map(|axis| {
            let share = (point[axis] - self.from_m[axis]) / self.cell_m - at[axis] as f64;
            let mut upper = at;
            upper[axis] += 1;
            let [low, high] = [at, upper].map(|face| self.faces[axis][self.face(axis, face)]);
            low + share * (high - low)
        })
    }

    /// Point after a displacement `way`, m, of at most a cell along each axis; it slides along closed faces. `None` if
    /// it leaves through an outlet.
    pub(super) fn moved(&self, mut point: Point, way: Point) -> Option<Point> {
        for axis in 0..2 {
            let at = self.around(point)?;
            let from = point;
            point[axis] += way[axis].clamp(-self.cell_m, self.cell_m);
            let place = (point[axis] - self.from_m[axis]) / self.cell_m;
            let mut face = at;
            if place >= (at[axis] + 1) as f64 {
                face[axis] += 1;
            } else if place >= at[axis] as f64 {
                continue;
            }
            if !self.open[axis][self.face(axis, face)] {
                point = from;
            }
        }
        self.around(point).map(|_| point)
    }

    /// True if no closed face is on the straight line between two points of the domain.
    pub(super) fn sees(&self, from: Point, to: Point) -> bool {
        let way = minus(to, from);
        let steps = (length(way) / (0.5 * self.cell_m)).ceil().max(1.0);
        let step = way.map(|part| part / steps);
        let mut at = from;
        for _ in 0..steps as usize {
            let expected = [at[0] + step[0], at[1] + step[1]];
            if self.moved(at, step) != Some(expected) {
                return false;
            }
            at = expected;
        }
        true
    }
}

/// Face of the rim that belongs to an opening.
#[derive(Clone, Copy, Debug)]
struct Opening {
    axis: usize,
    face: usize,
    cell: usize,
    /// True at the upper end of its axis.
    last: bool,
}

/// True if a wall separates the ends of the line `way`: it crosses it, or ends on it.
fn crosses(wall: &Segment, way: &Segment) -> bool {
    let side = |line: &Segment, point: Point| cross(minus(line.to, line.from), minus(point, line.from));
    let (one, other) = (side(wall, way.from), side(wall, way.to));
    let (from, to) = (side(way, wall.from), side(way, wall.to));
    // a line that starts on the wall belongs to one side of it
    (one >= 0.0) != (other >= 0.0) && from * to <= 0.0
}
