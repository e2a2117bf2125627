//! Straight walls and discs: intersections with rays, nearest points and distances.
//!
//! Two formulas instead of a library: `parry2d`, against which the tests compare every ray and every distance, takes 46
//! s of processor time to compile, and the program must compile in 400.

/// A point or direction in the plane, m.
pub type Point = [f64; 2];

/// A straight wall without thickness.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Segment {
    pub(crate) from: Point,
    pub(crate) to: Point,
}

/// Round obstacle, such as a post or a person.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Disc {
    pub(crate) centre: Point,
    pub(crate) radius_m: f64,
}

pub(crate) fn minus(one: Point, other: Point) -> Point {
    [one[0] - other[0], one[1] - other[1]]
}

pub(crate) fn plus(point: Point, way: Point, times: f64) -> Point {
    [point[0] + times * way[0], point[1] + times * way[1]]
}

pub(crate) fn dot(one: Point, other: Point) -> f64 {
    one[0] * other[0] + one[1] * other[1]
}

/// Component of `other` perpendicular to `one`, to its left, times the length of `one`.
pub(crate) fn cross(one: Point, other: Point) -> f64 {
    one[0] * other[1] - one[1] * other[0]
}

pub(crate) fn length(way: Point) -> f64 {
    dot(way, way).sqrt()
}

impl Segment {
    /// Nearest point of the wall to another point.
    pub(crate) fn nearest(&self, point: Point) -> Point {
        let along = minus(self.to, self.from);
        let squared = dot(along, along);
        // a wall without length is a point
        let share = if squared > 0.0 { dot(minus(point, self.from), along) / squared } else { 0.0 };
        plus(self.from, along, share.clamp(0.0, 1.0))
    }

    /// Distance along a ray of unit length `direction` to the wall, m; `None` if they do not meet or are parallel.
    pub(crate) fn hit(&self, from: Point, direction: Point) -> Option<f64> {
        let along = minus(self.to, self.from);
        let across = cross(direction, along);
        if across == 0.0 {
            return None;
        }
        let to_wall = minus(self.from, from);
        let way = cross(to_wall, along) / across;
        let share = cross(to_wall, direction) / across;
        (way >= 0.0 && (0.0..=1.0).contains(&share)).then_some(way)
    }
}

impl Disc {
    /// Distance along a ray of unit length `direction` to the disc, m; 0 from inside it.
    pub(crate) fn hit(&self, from: Point, direction: Point) -> Option<f64> {
        let to_centre = minus(self.centre, from);
        let outside = dot(to_centre, to_centre) - self.radius_m * self.radius_m;
        if outside <= 0.0 {
            return Some(0.0);
        }
        let way = dot(to_centre, direction);
        let under_root = way * way - outside;
        // the nearer of both intersections; `outside / farther` avoids the cancellation of `way - root`
        (way > 0.0 && under_root >= 0.0).then(|| outside / (way + under_root.sqrt()))
    }

    /// Distance of a point from the rim, m; negative inside.
    pub(crate) fn distance_m(&self, point: Point) -> f64 {
        length(minus(point, self.centre)) - self.radius_m
    }
}

/// True if a point is inside a polygon, by the number of edges that a ray to the right crosses.
pub(crate) fn is_inside(polygon: &[Point], [x, y]: Point) -> bool {
    let mut inside = false;
    for (number, [to_x, to_y]) in polygon.iter().enumerate() {
        let [from_x, from_y] = polygon[number.checked_sub(1).unwrap_or(polygon.len() - 1)];
        if (from_y > y) != (*to_y > y) && x < from_x + (y - from_y) / (to_y - from_y) * (to_x - from_x) {
            inside = !inside;
        }
    }
    inside
}
