//! Outline of a body and its contact with obstacles.
//!
//! A bumper of thickness [`BUMPER_M`] surrounds the outline: a damped spring that pushes where a corner of the outline,
//! or of an obstacle, is within it. Its stiffness follows from the body's mass, so that the longest step stays short
//! against the spring's period. Sliding along a wall is subject to [`FRICTION`].

use crate::{
    body::Pose,
    scene::{Disc, MovableBox, Point, Scene, Segment, cross, dot, is_inside, length, minus, plus},
};

/// Thickness of the bumper, m: our choice, that of foam on robots of some 10 kg.
pub(crate) const BUMPER_M: f64 = 0.02;
/// Angular frequency of the mass on one spring of the bumper, rad/s. A head-on impact at 2 m/s compresses it by 2.5 mm;
/// with half the frequency, by 4.9 mm. The spring's phase advances by 0.075 rad in the longest step.
const STIFFNESS_RAD_S: f64 = 300.0;
/// Damping ratio of that oscillator. A head-on impact at 2 m/s returns 27 % of the speed.
const DAMPING: f64 = 0.4;
/// Friction coefficient of the bumper on walls: our choice.
const FRICTION: f64 = 0.3;
/// Sliding speed at which friction reaches its full value, m/s.
const SLIDING_M_S: f64 = 0.01;

/// Error of a polygon that is no outline.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("`outline_m` needs at least three corners [x, y], counterclockwise and convex, around the frame's origin")]
pub struct OutlineError;

/// A convex polygon around the origin of a body's frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Outline {
    corners_m: Vec<Point>,
    /// Distance of the farthest corner from the origin, m.
    radius_m: f64,
    /// Relative travel of body and obstacles before contact is possible, m.
    free_m: f64,
    /// Half the sum of the transverse force components on both sides in the last step, N.
    squeezed_n: f64,
}

/// A force on a body and its point of action.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Push {
    /// Force in the world frame, N.
    pub(crate) force_n: Point,
    /// Point of action in the world frame, m.
    pub(crate) at_m: Point,
}

/// Pose and motion of a body, world frame.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Moving {
    pub(crate) pose: Pose,
    /// Velocity of the frame's origin, m/s.
    pub(crate) velocity_m_s: Point,
    pub(crate) yaw_rad_s: f64,
    pub(crate) mass_kg: f64,
}

impl Outline {
    /// An outline with the given corners, counterclockwise around the origin of the body's frame, m.
    ///
    /// # Errors
    /// [`OutlineError`] if it is not convex, or clockwise.
    pub fn new(corners_m: Vec<Point>) -> Result<Self, OutlineError> {
        let count = corners_m.len();
        let corner = |number: usize| corners_m[number % count];
        let turns_left = |number: usize| {
            let (from, at, to) = (corner(number), corner(number + 1), corner(number + 2));
            cross(minus(at, from), minus(to, at)) > 0.0 && cross(minus(at, from), minus([0.0; 2], from)) > 0.0
        };
        if count < 3 || !corners_m.iter().flatten().all(|number| number.is_finite()) || !(0..count).all(turns_left) {
            return Err(OutlineError);
        }
        let radius_m = corners_m.iter().map(|corner| length(*corner)).fold(0.0, f64::max);
        Ok(Self { corners_m, radius_m, free_m: 0.0, squeezed_n: 0.0 })
    }

    /// Corners in the body's frame, m.
    #[must_use]
    pub fn corners_m(&self) -> &[Point] {
        &self.corners_m
    }

    /// Distance from a disc to the outline at a pose, m; 0 or less where they overlap.
    #[must_use]
    pub fn distance_m(&self, pose: Pose, centre_m: Point, radius_m: f64) -> f64 {
        let corners: Vec<Point> = self.corners_m.iter().map(|corner| pose.to_world(*corner)).collect();
        if is_inside(&corners, centre_m) {
            return -radius_m;
        }
        let edge = |number: usize| Segment { from: corners[number], to: corners[(number + 1) % corners.len()] };
        let to_edge = |number| length(minus(edge(number).nearest(centre_m), centre_m));
        (0..corners.len()).map(to_edge).fold(f64::INFINITY, f64::min) - radius_m
    }

    /// Resets the distance to obstacles after the body was moved to another pose.
    pub(crate) fn moved(&mut self) {
        self.free_m = 0.0;
    }

    /// Transverse squeeze in the last step, N.
    pub(crate) const fn squeezed_n(&self) -> f64 {
        self.squeezed_n
    }

    /// Replaces the corners, which must satisfy the conditions of [`Outline::new`].
    pub(crate) fn reshape(&mut self, corners_m: &[Point]) {
        self.corners_m.clear();
        self.corners_m.extend_from_slice(corners_m);
        self.radius_m = corners_m.iter().map(|corner| length(*corner)).fold(0.0, f64::max);
        self.free_m = 0.0;
    }

    /// Calls `push` with every contact force on the body, and applies the reactions to boxes. Obstacles are only
    /// searched once the body may have reached one.
    pub(crate) fn touch(
        &mut self,
        scene: &mut Scene,
        time_s: f64,
        step_s: f64,
        moving: &Moving,
        mut push: impl FnMut(Push),
    ) {
        self.squeezed_n = 0.0;
        self.free_m -= (length(moving.velocity_m_s) + scene.fastest_m_s()) * step_s;
        if self.free_m > 0.0 {
            return;
        }
        let origin = moving.pose.to_world([0.0; 2]);
        let reach_m = self.radius_m + BUMPER_M;
        self.free_m = scene.clearance_m(time_s, origin) - reach_m;
        if self.free_m > 0.0 {
            return;
        }
        let (sin, cos) = libm::sincos(moving.pose.yaw_rad);
        let squeezed_n = &mut self.squeezed_n;
        let mut push = |one: Push| {
            *squeezed_n += 0.5 * (cos * one.force_n[1] - sin * one.force_n[0]).abs();
            push(one);
        };
        let corners: Vec<Point> = self.corners_m.iter().map(|corner| moving.pose.to_world(*corner)).collect();
        for segment in scene.segments() {
            if length(minus(segment.nearest(origin), origin)) < reach_m {
                wall(segment, &corners, origin, |depth_m, normal, at| push(moving.pushed(depth_m, normal, at)));
            }
        }
        for disc in scene.round(time_s) {
            if disc.distance_m(origin) < reach_m {
                post(&disc, &corners, |depth_m, normal, at| push(moving.pushed(depth_m, normal, at)));
            }
        }
        for one in scene.boxes_mut() {
            let centre = [one.pose().x_m, one.pose().y_m];
            if length(minus(centre, origin)) < reach_m + 0.5 * length(one.spec().size_m) {
                let mut pushes = Vec::new();
                meet(one, &corners, |depth_m, normal, at| pushes.push(moving.pushed_by(one, depth_m, normal, at)));
                for Push { force_n, at_m } in pushes {
                    one.push([-force_n[0], -force_n[1]], at_m);
                    push(Push { force_n, at_m });
                }
            }
        }
    }
}

impl Moving {
    /// Force of a bumper compressed by `depth_m`, m, at a point, along the unit vector `normal` away from the obstacle.
    fn pushed(&self, depth_m: f64, normal: Point, at_m: Point) -> Push {
        Self::bumped(self.velocity_at(at_m), self.mass_kg, depth_m, normal, at_m)
    }

    /// As [`Moving::pushed`], for a movable box: the reduced mass of body and box oscillates on the spring.
    fn pushed_by(&self, one: &MovableBox, depth_m: f64, normal: Point, at_m: Point) -> Push {
        let mass_kg = self.mass_kg * one.spec().mass_kg / (self.mass_kg + one.spec().mass_kg);
        Self::bumped(minus(self.velocity_at(at_m), one.velocity_at(at_m)), mass_kg, depth_m, normal, at_m)
    }

    /// Velocity of a point of the body, world frame, m/s.
    fn velocity_at(&self, at_m: Point) -> Point {
        let arm = minus(at_m, [self.pose.x_m, self.pose.y_m]);
        plus(self.velocity_m_s, [-arm[1], arm[0]], self.yaw_rad_s)
    }

    /// Contact force for the velocity of the body's point relative to the obstacle's, m/s, and the mass on the spring,
    /// kg.
    fn bumped(velocity: Point, mass_kg: f64, depth_m: f64, normal: Point, at_m: Point) -> Push {
        let away_m_s = dot(velocity, normal);
        let stiffness = mass_kg * STIFFNESS_RAD_S * STIFFNESS_RAD_S;
        let damping = 2.0 * DAMPING * mass_kg * STIFFNESS_RAD_S;
        // a bumper never pulls
        let pressed_n = (stiffness * depth_m - damping * away_m_s).max(0.0);
        let along = [-normal[1], normal[0]];
        let sliding = (dot(velocity, along) / SLIDING_M_S).clamp(-1.0, 1.0);
        let force_n = plus([normal[0] * pressed_n, normal[1] * pressed_n], along, -FRICTION * sliding * pressed_n);
        Push { force_n, at_m }
    }
}

/// Contacts of the outline's corners with a wall, and of the wall's ends with the outline. `origin` is on the side to
/// which the wall pushes.
fn wall(segment: &Segment, corners: &[Point], origin: Point, mut press: impl FnMut(f64, Point, Point)) {
    let along = minus(segment.to, segment.from);
    let size = length(along);
    if size > 0.0 {
        let side = if cross(along, minus(origin, segment.from)) < 0.0 { -1.0 } else { 1.0 };
        let normal = [-side * along[1] / size, side * along[0] / size];
        for corner in corners {
            let way = minus(*corner, segment.from);
            let (depth_m, share) = (BUMPER_M - dot(way, normal), dot(way, along) / (size * size));
            if depth_m > 0.0 && (0.0..=1.0).contains(&share) {
                press(depth_m, normal, *corner);
            }
        }
    }
    for end in [segment.from, segment.to] {
        poke(end, corners, &mut press);
    }
}

fn post(disc: &Disc, corners: &[Point], mut press: impl FnMut(f64, Point, Point)) {
    let mut deepest: Option<(f64, Point, Point)> = None;
    for (number, to) in corners.iter().enumerate() {
        let from = corners[number.checked_sub(1).unwrap_or(corners.len() - 1)];
        let at = Segment { from, to: *to }.nearest(disc.centre);
        let way = minus(at, disc.centre);
        let distance_m = length(way);
        let depth_m = disc.radius_m + BUMPER_M - distance_m;
        if depth_m > 0.0 && distance_m > 0.0 && deepest.is_none_or(|(deepest_m, ..)| depth_m > deepest_m) {
            deepest = Some((depth_m, [way[0] / distance_m, way[1] / distance_m], at));
        }
    }
    if let Some((depth_m, normal, at)) = deepest {
        press(depth_m, normal, at);
    }
}

/// Contacts of a box's corners with the bumper, and of the bumper's corners, mitred here, with the box.
fn meet(one: &MovableBox, corners: &[Point], mut press: impl FnMut(f64, Point, Point)) {
    let (bumper, its_corners) = (mitred(corners), one.corners_m());
    for corner in its_corners {
        if let Some((depth_m, inwards)) = sunk(corner, &bumper) {
            press(depth_m, inwards, corner);
        }
    }
    for corner in bumper {
        if let Some((depth_m, [x, y])) = sunk(corner, &its_corners) {
            press(depth_m, [-x, -y], corner);
        }
    }
}

/// Unit normal of the edge between two corners, into a convex counterclockwise polygon.
fn inwards(from: Point, to: Point) -> Point {
    let along = minus(to, from);
    let size = length(along);
    [-along[1] / size, along[0] / size]
}

/// Corners of the outline offset by the bumper, with mitred corners.
fn mitred(corners: &[Point]) -> Vec<Point> {
    let count = corners.len();
    let corner = |number: usize| {
        let (before, at, after) =
            (corners[(number + count - 1) % count], corners[number], corners[(number + 1) % count]);
        let (first, second) = (inwards(before, at), inwards(at, after));
        let miter = -BUMPER_M / (1.0 + dot(first, second));
        plus(plus(at, first, miter), second, miter)
    };
    (0..count).map(corner).collect()
}

/// Depth of a point inside a convex counterclockwise polygon, m, from its nearest edge, and the inward normal of that
/// edge; `None` outside.
fn sunk(point: Point, corners: &[Point]) -> Option<(f64, Point)> {
    let mut nearest: Option<(f64, Point)> = None;
    for (number, to) in corners.iter().enumerate() {
        let from = corners[number.checked_sub(1).unwrap_or(corners.len() - 1)];
        let inwards = inwards(from, *to);
        let depth_m = dot(minus(point, from), inwards);
        if depth_m <= 0.0 {
            return None;
        }
        if nearest.is_none_or(|(least_m, _)| depth_m < least_m) {
            nearest = Some((depth_m, inwards));
        }
    }
    nearest
}

/// Contact of a point with an edge of the outline, which yields inwards. Contacts at corners are found by [`wall`].
fn poke(point: Point, corners: &[Point], press: &mut impl FnMut(f64, Point, Point)) {
    let mut shallowest: Option<(f64, Point)> = None;
    for (number, to) in corners.iter().enumerate() {
        let from = corners[number.checked_sub(1).unwrap_or(corners.len() - 1)];
        let along = minus(*to, from);
        let size = length(along);
        let inwards = inwards(from, *to);
        let (way, depth_m) = (minus(point, from), dot(minus(point, from), inwards) + BUMPER_M);
        if depth_m <= 0.0 {
            return;
        }
        let beside = (0.0..=size * size).contains(&dot(way, along));
        if shallowest.is_none_or(|(least_m, _)| depth_m < least_m) {
            shallowest = beside.then_some((depth_m, inwards)).or(shallowest);
        }
    }
    if let Some((depth_m, inwards)) = shallowest {
        press(depth_m, inwards, point);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::BoxSpec;

    fn square(half_m: f64) -> Outline {
        Outline::new(vec![[half_m, -half_m], [half_m, half_m], [-half_m, half_m], [-half_m, -half_m]]).unwrap()
    }

    /// Sum of the contact forces and their moment about the origin, for a body at rest at a pose.
    fn pushes(scene: &Scene, pose: Pose) -> (Point, f64) {
        let moving = Moving { pose, velocity_m_s: [0.0; 2], yaw_rad_s: 0.0, mass_kg: 10.0 };
        let (mut sum, mut moment) = ([0.0; 2], 0.0);
        square(0.2).touch(&mut scene.clone(), 0.0, 0.0, &moving, |push| {
            sum = plus(sum, push.force_n, 1.0);
            moment += cross(minus(push.at_m, [pose.x_m, pose.y_m]), push.force_n);
        });
        (sum, moment)
    }

    const STIFFNESS_N_M: f64 = 10.0 * STIFFNESS_RAD_S * STIFFNESS_RAD_S;

    #[test]
    fn a_wall_pushes_both_corners_straight_back() {
        let mut scene = Scene::default();
        scene.add_walls(&[[1.0, -3.0], [1.0, 3.0]], false).unwrap();
        let at = |x_m: f64| pushes(&scene, Pose { x_m, ..Pose::default() });
        assert_eq!(at(0.77), ([0.0; 2], 0.0), "the bumper ends at 0.78");
        let (force, moment) = at(0.79);
        assert!((force[0] + 2.0 * 0.01 * STIFFNESS_N_M).abs() < 1e-6 && force[1] == 0.0 && moment.abs() < 1e-9);
        // from the other side it pushes the opposite way
        let (behind, _) = at(1.21);
        assert!((behind[0] - 2.0 * 0.01 * STIFFNESS_N_M).abs() < 1e-6, "{behind:?}");
    }

    #[test]
    fn a_post_and_the_end_of_a_wall_push_where_they_are() {
        let mut scene = Scene::default();
        scene.add_post([0.31, 0.1], 0.1).unwrap();
        let (force, moment) = pushes(&scene, Pose::default());
        assert!((force[0] + 0.01 * STIFFNESS_N_M).abs() < 1e-6 && force[1].abs() < 1e-6, "{force:?}");
        assert!((moment - 0.1 * 0.01 * STIFFNESS_N_M).abs() < 1e-6, "{moment}");
        let mut scene = Scene::default();
        scene.add_walls(&[[0.21, 0.1], [3.0, 0.1]], false).unwrap();
        let (force, moment) = pushes(&scene, Pose::default());
        assert!((force[0] + 0.01 * STIFFNESS_N_M).abs() < 1e-6 && force[1].abs() < 1e-6, "{force:?}");
        assert!((moment - 0.1 * 0.01 * STIFFNESS_N_M).abs() < 1e-6, "{moment}");
    }

    /// Corners of a box at an edge, and corners of the outline at a wider box: the same depth gives the same force, and
    /// its reaction on the box.
    #[test]
    fn a_box_pushes_and_is_pushed_alike() {
        let moving = Moving { pose: Pose::default(), velocity_m_s: [0.0; 2], yaw_rad_s: 0.0, mass_kg: 10.0 };
        for across_m in [0.2, 0.8] {
            let mut scene = Scene::default();
            let spec = BoxSpec { size_m: [0.2, across_m], mass_kg: 10.0, friction: 0.0, kinetic_share: 1.0 };
            scene.add_box(spec, Pose { x_m: 0.31, ..Pose::default() }).unwrap();
            let mut sum = [0.0; 2];
            square(0.2).touch(&mut scene, 0.0, 0.0, &moving, |push| sum = plus(sum, push.force_n, 1.0));
            // two corners in contact, reduced mass half the body's
            assert!((sum[0] + 0.01 * STIFFNESS_N_M).abs() < 1e-6 && sum[1].abs() < 1e-9, "{across_m}: {sum:?}");
            scene.step_boxes(1e-3);
            let speed_m_s = scene.boxes()[0].velocity_at([0.31, 0.0])[0];
            assert!((speed_m_s * 10.0 + sum[0] * 1e-3).abs() < 1e-9, "momentum: {speed_m_s}");
        }
    }

    #[test]
    fn discs_are_as_far_away_as_they_are() {
        let at = Pose { x_m: 1.0, yaw_rad: std::f64::consts::FRAC_PI_2, ..Pose::default() };
        for (centre, expected_m) in [([2.0, 0.1], 0.7), ([1.5, 0.6], 0.5 - 0.1), ([1.1, 0.0], -0.1)] {
            let got_m = square(0.2).distance_m(at, centre, 0.1);
            assert!((got_m - expected_m).abs() < 1e-12, "{centre:?}: {got_m}");
        }
    }

    #[test]
    fn an_outline_goes_round_its_origin_and_is_convex() {
        let corners = |corners: &[Point]| Outline::new(corners.to_vec()).map(drop);
        assert_eq!(corners(&[[1.0, -1.0], [1.0, 1.0], [-1.0, 0.0]]), Ok(()));
        for wrong in [
            &[[1.0, 1.0], [1.0, -1.0], [-1.0, 0.0]][..],
            &[[1.0, -1.0], [1.0, 1.0]],
            &[[2.0, -1.0], [2.0, 1.0], [1.0, 0.0]],
            &[[1.0, -1.0], [0.1, 0.0], [1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0]],
            &[[1.0, f64::NAN], [1.0, 1.0], [-1.0, 0.0]],
        ] {
            assert_eq!(corners(wrong), Err(OutlineError), "{wrong:?}");
        }
    }
}
