//! The planar world: walls, posts, walking people, boxes that can be pushed, floors with their own friction, and
//! slopes.
//!
//! Everything except the boxes is a function of time. Boxes are moved by the step of a [`Wheeled`](crate::Wheeled)
//! body, or of one built on it, so a scene with boxes must have exactly one such body.

mod boxes;
mod shapes;

pub use boxes::{BoxSpec, MovableBox};
pub use shapes::Point;
pub(crate) use shapes::{Disc, Segment, cross, dot, is_inside, length, minus, plus};

use crate::Pose;

/// A person who walks in straight lines from place to place.
#[derive(Clone, Debug, PartialEq)]
pub struct Person {
    /// Radius of the disc that represents a person, m.
    pub radius_m: f64,
    /// Times, s, strictly increasing, and the place at each. Before the first and after the last the person stands
    /// there.
    pub path: Vec<(f64, Point)>,
}

impl Person {
    /// Place of the person at a time, world frame, m.
    #[must_use]
    pub fn place_m(&self, time_s: f64) -> Point {
        let after = self.path.partition_point(|(at_s, _)| *at_s <= time_s);
        match (after.checked_sub(1).and_then(|before| self.path.get(before)), self.path.get(after)) {
            (Some((from_s, from)), Some((to_s, to))) => {
                plus(*from, minus(*to, *from), (time_s - from_s) / (to_s - from_s))
            }
            (Some((_, place)), None) | (None, Some((_, place))) => *place,
            (None, None) => [f64::INFINITY; 2],
        }
    }

    fn fastest_m_s(&self) -> f64 {
        let speed = |pair: &[(f64, Point)]| length(minus(pair[1].1, pair[0].1)) / (pair[1].0 - pair[0].0);
        self.path.windows(2).map(speed).fold(0.0, f64::max)
    }

    fn disc(&self, time_s: f64) -> Disc {
        Disc { centre: self.place_m(time_s), radius_m: self.radius_m }
    }
}

/// A part of the floor with its own friction and slope.
#[derive(Clone, Debug, PartialEq)]
pub struct Surface {
    /// Corners of the part, in order, m.
    pub corners_m: Vec<Point>,
    /// Friction coefficient of tyres on it; `None` keeps the tyre's own.
    pub friction: Option<f64>,
    /// Rise of the floor per metre in the world's x and y, m/m.
    pub slope: [f64; 2],
}

/// Reasons why something cannot stand in a scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SceneError {
    /// Too few points, or one that is not finite.
    #[error("`points_m` needs at least {least} points [x, y] with finite numbers")]
    Points {
        /// Smallest number of points.
        least: usize,
    },
    /// A post or person without a size or place.
    #[error("`radius_m` must be positive and the place finite")]
    Disc,
    /// A path whose times do not increase.
    #[error("`path` needs points [time_s, x_m, y_m] with finite numbers and increasing times")]
    Path,
    /// A box without a size, mass or place.
    #[error(
        "a box needs `size_m` and `mass_kg` above 0, `friction` of 0 or more, `kinetic_share` from 0 to 1 and a finite place"
    )]
    Box,
    /// Friction or slope that a floor cannot have.
    #[error("`friction` must be 0 or more, and `slope` at most 1 each way: 45 degrees")]
    Floor,
}

/// Walls, obstacles, people, boxes and floors around the robots.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Scene {
    segments: Vec<Segment>,
    discs: Vec<Disc>,
    people: Vec<Person>,
    surfaces: Vec<Surface>,
    boxes: Vec<MovableBox>,
    /// Highest speed of the people, m/s.
    fastest_m_s: f64,
}

/// Floor properties at a point.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Floor {
    /// Friction coefficient of tyres; `None` keeps the tyre's own.
    pub friction: Option<f64>,
    /// Rise per metre in the world's x and y, m/m.
    pub slope: [f64; 2],
}

impl Scene {
    /// Adds walls from point to point; `closed` also from the last to the first.
    ///
    /// # Errors
    /// [`SceneError::Points`] for fewer points than a wall needs, or one that is not finite.
    pub fn add_walls(&mut self, points_m: &[Point], closed: bool) -> Result<(), SceneError> {
        let least = if closed { 3 } else { 2 };
        if points_m.len() < least || !points_m.iter().flatten().all(|number| number.is_finite()) {
            return Err(SceneError::Points { least });
        }
        self.segments.extend(points_m.windows(2).map(|pair| Segment { from: pair[0], to: pair[1] }));
        if let (true, [first, .., last]) = (closed, points_m) {
            self.segments.push(Segment { from: *last, to: *first });
        }
        Ok(())
    }

    /// Adds a post, a round obstacle.
    ///
    /// # Errors
    /// [`SceneError::Disc`] if radius or place are invalid.
    pub fn add_post(&mut self, centre_m: Point, radius_m: f64) -> Result<(), SceneError> {
        if !(radius_m > 0.0 && radius_m.is_finite() && centre_m.into_iter().all(f64::is_finite)) {
            return Err(SceneError::Disc);
        }
        self.discs.push(Disc { centre: centre_m, radius_m });
        Ok(())
    }

    /// Adds a walking person.
    ///
    /// # Errors
    /// [`SceneError::Disc`] for the radius, [`SceneError::Path`] for the path.
    pub fn add_person(&mut self, person: Person) -> Result<(), SceneError> {
        if !(person.radius_m > 0.0 && person.radius_m.is_finite()) {
            return Err(SceneError::Disc);
        }
        let finite = |(at_s, place): &(f64, Point)| at_s.is_finite() && place.iter().all(|number| number.is_finite());
        let increases = person.path.windows(2).all(|pair| pair[0].0 < pair[1].0);
        if person.path.is_empty() || !person.path.iter().all(finite) || !increases {
            return Err(SceneError::Path);
        }
        self.fastest_m_s = self.fastest_m_s.max(person.fastest_m_s());
        self.people.push(person);
        Ok(())
    }

    /// Adds a part of the floor; where two overlap, the later one applies.
    ///
    /// # Errors
    /// [`SceneError::Points`] for the corners, [`SceneError::Floor`] for friction or slope.
    pub fn add_surface(&mut self, surface: Surface) -> Result<(), SceneError> {
        if surface.corners_m.len() < 3 || !surface.corners_m.iter().flatten().all(|number| number.is_finite()) {
            return Err(SceneError::Points { least: 3 });
        }
        let friction = surface.friction.is_none_or(|friction| (0.0..f64::INFINITY).contains(&friction));
        if !friction || !surface.slope.iter().all(|slope| slope.abs() <= 1.0) {
            return Err(SceneError::Floor);
        }
        self.surfaces.push(surface);
        Ok(())
    }

    /// Adds a box at rest.
    ///
    /// # Errors
    /// [`SceneError::Box`] for parameters out of range.
    pub fn add_box(&mut self, spec: BoxSpec, pose: Pose) -> Result<(), SceneError> {
        self.boxes.push(MovableBox::new(spec, pose)?);
        Ok(())
    }

    /// Removes all boxes from the scene.
    pub fn clear_boxes(&mut self) {
        self.boxes.clear();
    }

    /// Boxes at their present poses.
    #[must_use]
    pub fn boxes(&self) -> &[MovableBox] {
        &self.boxes
    }

    pub(crate) fn boxes_mut(&mut self) -> &mut [MovableBox] {
        &mut self.boxes
    }

    /// Advances all boxes by `step_s` under the forces on them.
    pub(crate) fn step_boxes(&mut self, step_s: f64) {
        self.boxes.iter_mut().for_each(|one| one.step(step_s));
    }

    /// Edges of all boxes.
    fn edges(&self) -> impl Iterator<Item = Segment> {
        self.boxes.iter().flat_map(|one| {
            let corners = one.corners_m();
            [0, 1, 2, 3].map(|number| Segment { from: corners[number], to: corners[(number + 1) % 4] })
        })
    }

    /// People in the scene.
    #[must_use]
    pub fn people(&self) -> &[Person] {
        &self.people
    }

    /// Straight walls, as pairs of end points, for drawing.
    pub fn walls_m(&self) -> impl Iterator<Item = [Point; 2]> {
        self.segments.iter().map(|segment| [segment.from, segment.to])
    }

    /// Posts, as centre and radius, for drawing.
    pub fn posts_m(&self) -> impl Iterator<Item = (Point, f64)> {
        self.discs.iter().map(|disc| (disc.centre, disc.radius_m))
    }

    /// Highest speed of anything in the scene, m/s.
    #[must_use]
    pub fn fastest_m_s(&self) -> f64 {
        self.boxes.iter().map(MovableBox::fastest_m_s).fold(self.fastest_m_s, f64::max)
    }

    /// True if the whole floor is level and leaves the tyres' friction.
    #[must_use]
    pub fn is_plain(&self) -> bool {
        self.surfaces.is_empty()
    }

    /// True if nothing stands on the floor.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.segments.is_empty() && self.discs.is_empty() && self.people.is_empty() && self.boxes.is_empty()
    }

    /// Floor properties at a point.
    #[must_use]
    pub fn floor(&self, point: Point) -> Floor {
        let surface = self.surfaces.iter().rev().find(|surface| is_inside(&surface.corners_m, point));
        surface.map_or(Floor::default(), |surface| Floor { friction: surface.friction, slope: surface.slope })
    }

    /// Distance from a point in a direction, rad, to the first obstacle, m; `None` if there is none within
    /// `farthest_m`.
    #[must_use]
    pub fn ray_m(&self, time_s: f64, from: Point, direction_rad: f64, farthest_m: f64) -> Option<f64> {
        let (sin, cos) = libm::sincos(direction_rad);
        let walls = self.segments.iter().filter_map(|segment| segment.hit(from, [cos, sin]));
        let boxes = self.edges().filter_map(|edge| edge.hit(from, [cos, sin]));
        let discs = self.round(time_s).filter_map(|disc| disc.hit(from, [cos, sin]));
        nearest(walls.chain(boxes).chain(discs), farthest_m)
    }

    /// Distance from a point to the nearest obstacle in a cone about a direction, m, as an ultrasonic sensor measures
    /// it. `None` if there is none within `farthest_m`. `half_angle_rad` is below a quarter of a turn.
    #[must_use]
    pub fn cone_m(
        &self,
        time_s: f64,
        from: Point,
        direction_rad: f64,
        half_angle_rad: f64,
        farthest_m: f64,
    ) -> Option<f64> {
        let edges = [direction_rad - half_angle_rad, direction_rad + half_angle_rad].map(libm::sincos);
        let [right, left] = edges.map(|(sin, cos)| [cos, sin]);
        let is_in_cone = |point: Point| {
            let way = minus(point, from);
            cross(right, way) >= 0.0 && cross(way, left) >= 0.0
        };
        // candidates: the nearest point of an obstacle, if it is in the cone; otherwise an end of it or its point at an
        // edge of the cone
        let wall = |segment: &Segment| {
            let ends = [segment.nearest(from), segment.from, segment.to].into_iter().filter(|point| is_in_cone(*point));
            let ends = ends.map(|point| length(minus(point, from)));
            let edges = [right, left].into_iter().filter_map(|edge| segment.hit(from, edge));
            nearest(ends.chain(edges), farthest_m)
        };
        let disc = |disc: Disc| {
            let distance_m = disc.distance_m(from).max(0.0);
            let straight = (distance_m == 0.0 || is_in_cone(disc.centre)).then_some(distance_m);
            let edges = [right, left].into_iter().filter_map(|edge| disc.hit(from, edge));
            nearest(straight.into_iter().chain(edges), farthest_m)
        };
        let boxes: Vec<Segment> = self.edges().collect();
        let straight = self.segments.iter().chain(&boxes).filter_map(wall);
        nearest(straight.chain(self.round(time_s).filter_map(disc)), farthest_m)
    }

    /// Distance from a point to the nearest obstacle, m; infinite in an empty scene, 0 inside an obstacle.
    #[must_use]
    pub fn clearance_m(&self, time_s: f64, point: Point) -> f64 {
        let walls = self.segments.iter().map(|segment| length(minus(segment.nearest(point), point)));
        let boxes = self.boxes.iter().map(|one| {
            let corners = one.corners_m();
            if is_inside(&corners, point) {
                return 0.0;
            }
            let edge = |number: usize| Segment { from: corners[number], to: corners[(number + 1) % 4] };
            (0..4).map(|number| length(minus(edge(number).nearest(point), point))).fold(f64::INFINITY, f64::min)
        });
        let discs = self.round(time_s).map(|disc| disc.distance_m(point).max(0.0));
        walls.chain(boxes).chain(discs).fold(f64::INFINITY, f64::min)
    }

    pub(crate) fn segments(&self) -> &[Segment] {
        &self.segments
    }

    pub(crate) fn posts(&self) -> impl Iterator<Item = Disc> {
        self.discs.iter().copied()
    }

    /// Posts and people at a time.
    pub(crate) fn round(&self, time_s: f64) -> impl Iterator<Item = Disc> {
        self.discs.iter().copied().chain(self.people.iter().map(move |person| person.disc(time_s)))
    }
}

fn nearest(ways_m: impl Iterator<Item = f64>, farthest_m: f64) -> Option<f64> {
    ways_m.filter(|way_m| *way_m <= farthest_m).min_by(f64::total_cmp)
}

#[cfg(test)]
mod tests;
