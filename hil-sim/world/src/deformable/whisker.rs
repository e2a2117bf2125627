//! Whiskers: sprung, straight, massless, on hinges beside the nose; each rests against the first obstacle in its way.

use std::{collections::VecDeque, f64::consts::PI};

use super::DeformableError;
use crate::{
    Pose,
    dice::Dice,
    scene::{Point, Scene, Segment, dot, length, minus, plus},
};

/// Both whiskers, mirror images, and their angle sensors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Whiskers {
    /// Hinge of the left whisker relative to the nose: forwards (negative: behind it) and to the left, m.
    pub hinge_m: [f64; 2],
    /// Length from the hinge to the tip, m.
    pub length_m: f64,
    /// Free direction of the left whisker, rad to the left of forwards.
    pub rest_rad: f64,
    /// Stiffness of the spring, N m/rad.
    pub stiffness_nm_per_rad: f64,
    /// Play between whisker and magnet, from end to end, rad; the reading has this hysteresis.
    pub hysteresis_rad: f64,
    /// Sampling period of the magnets' angles, s.
    pub every_s: f64,
    /// Delay from a sample to its reading, s.
    pub late_s: f64,
    /// Noise of a sample, standard deviation, rad.
    pub noise_rad: f64,
    /// Seed of the noise generator.
    pub seed: u64,
}

impl Whiskers {
    pub(super) fn check(&self) -> Result<(), DeformableError> {
        let positive = [self.length_m, self.stiffness_nm_per_rad, self.every_s];
        let not_negative = [self.hysteresis_rad, self.late_s, self.noise_rad];
        let is_right = positive.iter().all(|value| *value > 0.0 && value.is_finite())
            && not_negative.iter().all(|value| (0.0..f64::INFINITY).contains(value))
            && (0.0..PI).contains(&self.rest_rad)
            && self.hinge_m.iter().all(|place| place.is_finite())
            && self.hinge_m[1] >= 0.0;
        // a longer queue is a mistake in the parameters, and costs memory
        if is_right && self.late_s <= 100.0 * self.every_s { Ok(()) } else { Err(DeformableError::Whiskers) }
    }
}

/// State of one whisker.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Whisker {
    /// Bend from the free direction, rad; positive backwards.
    pub(super) bent_rad: f64,
    /// Angle of the magnet, rad, within the play of `bent_rad`.
    pub(super) magnet_rad: f64,
}

/// Contact of a whisker with an obstacle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Touch {
    /// Contact point, world frame, m.
    pub(super) at_m: Point,
    /// Force of the whisker on the obstacle, world frame, N.
    pub(super) force_n: Point,
    /// Index of the box; `None` for a fixed obstacle.
    pub(super) box_number: Option<usize>,
}

/// Part of an obstacle within a whisker's reach: its ends as bends, rad, with their points.
#[derive(Clone, Copy, Debug)]
struct Span {
    ends: [(f64, Point); 2],
    box_number: Option<usize>,
}

impl Whisker {
    /// Updates bend and magnet, and returns the contact with an obstacle. `side` is 1 for the left whisker and -1 for
    /// the right one; `most_rad` is the bend at which it lies on the shell.
    pub(super) fn step(
        &mut self,
        spec: &Whiskers,
        side: f64,
        (body, nose_m): (Pose, f64),
        most_rad: f64,
        scene: &Scene,
        time_s: f64,
    ) -> Option<Touch> {
        let hinge = body.to_world([nose_m + spec.hinge_m[0], side * spec.hinge_m[1]]);
        let (sin, cos) = libm::sincos(body.yaw_rad);
        // the discontinuity of atan2 is straight behind the hinge, inside the robot
        let bend = |point: Point| {
            let [x, y] = minus(point, hinge);
            side * libm::atan2(cos * y - sin * x, cos * x + sin * y) - spec.rest_rad
        };
        let spans = spans(scene, time_s, hinge, spec.length_m, bend);
        // lower limit by obstacles that push it back, upper limit by obstacles it has passed; its spring acts in
        // between
        let (mut low, mut high) = ((-0.5 * PI, None), (most_rad, None));
        for span in spans {
            let [first, last] = span.ends;
            if self.bent_rad >= f64::midpoint(first.0, last.0) {
                if last.0 > low.0 {
                    low = (last.0, Some((last.1, span.box_number)));
                }
            } else if first.0 < high.0 {
                high = (first.0, Some((first.1, span.box_number)));
            }
        }
        let (bent_rad, touch) = match (low, high) {
            ((at, touch), _) if at > 0.0 => (at, touch),
            (_, (at, touch)) if at < 0.0 => (at, touch),
            _ => (0.0, None),
        };
        // an obstacle that presses it onto the shell pushes the shell from here on
        self.bent_rad = bent_rad.clamp(-0.5 * PI, most_rad);
        let half_rad = 0.5 * spec.hysteresis_rad;
        self.magnet_rad = self.magnet_rad.clamp(self.bent_rad - half_rad, self.bent_rad + half_rad);
        let (at_m, box_number) = touch?;
        let arm = minus(at_m, hinge);
        let distance_m = length(arm).max(0.1 * spec.length_m);
        // force across the whisker, in the direction of its return: forwards while bent backwards, which is clockwise
        // on the left
        let size_n = spec.stiffness_nm_per_rad * self.bent_rad / distance_m;
        let across = [side * arm[1] / distance_m, -side * arm[0] / distance_m];
        Some(Touch { at_m, force_n: across.map(|part| size_n * part), box_number })
    }
}

/// Parts of all obstacles within reach of a hinge.
fn spans(scene: &Scene, time_s: f64, hinge: Point, reach_m: f64, bend: impl Fn(Point) -> f64) -> Vec<Span> {
    let mut spans = Vec::new();
    let mut add = |points: &mut dyn Iterator<Item = Point>, box_number| {
        let all = points.map(|point| (bend(point), point));
        let ends = all.fold(None, |ends: Option<[(f64, Point); 2]>, end| {
            let [first, last] = ends.unwrap_or([end; 2]);
            Some([if end.0 < first.0 { end } else { first }, if end.0 > last.0 { end } else { last }])
        });
        if let Some(ends) = ends {
            spans.push(Span { ends, box_number });
        }
    };
    let edge_points = |edge: Segment| {
        let near = [edge.from, edge.to].into_iter().filter(move |point| length(minus(*point, hinge)) <= reach_m);
        near.chain(crossings(edge, hinge, reach_m))
    };
    for segment in scene.segments() {
        add(&mut edge_points(*segment), None);
    }
    for (number, one) in scene.boxes().iter().enumerate() {
        let centre = [one.pose().x_m, one.pose().y_m];
        if length(minus(centre, hinge)) > reach_m + 0.5 * length(one.spec().size_m) {
            continue;
        }
        let corners = one.corners_m();
        let edges = [0, 1, 2, 3].map(|number| Segment { from: corners[number], to: corners[(number + 1) % 4] });
        add(&mut edges.into_iter().flat_map(edge_points), Some(number));
    }
    for disc in scene.round(time_s) {
        let way = minus(disc.centre, hinge);
        let distance_m = length(way);
        if disc.distance_m(hinge) >= reach_m || distance_m <= disc.radius_m {
            continue;
        }
        let tangent_m = libm::sqrt(distance_m * distance_m - disc.radius_m * disc.radius_m);
        // the tangent's contact point, or the tip where that is out of reach (law of cosines)
        let touches_m = tangent_m.min(reach_m);
        let cos = (distance_m * distance_m + touches_m * touches_m - disc.radius_m * disc.radius_m)
            / (2.0 * distance_m * touches_m);
        let sin = libm::sqrt((1.0 - cos * cos).max(0.0));
        let unit = way.map(|part| part / distance_m);
        let at = |sin: f64| {
            let turned = [cos * unit[0] - sin * unit[1], sin * unit[0] + cos * unit[1]];
            plus(hinge, turned, touches_m)
        };
        add(&mut [at(sin), at(-sin)].into_iter(), None);
    }
    spans
}

/// Intersections of a straight edge with a circle, none to two.
fn crossings(edge: Segment, centre: Point, radius_m: f64) -> impl Iterator<Item = Point> {
    let (from, along) = (edge.from, minus(edge.to, edge.from));
    let (squared, ahead) = (dot(along, along), dot(minus(centre, from), along));
    let foot = plus(from, along, if squared > 0.0 { ahead / squared } else { 0.0 });
    let across = minus(centre, foot);
    let half = (radius_m * radius_m - dot(across, across)).max(0.0);
    let is_met = squared > 0.0 && dot(across, across) < radius_m * radius_m;
    let shares = if is_met {
        let half = libm::sqrt(half / squared);
        [ahead / squared - half, ahead / squared + half]
    } else {
        [f64::NAN; 2]
    };
    shares.into_iter().filter(|share| (0.0..=1.0).contains(share)).map(move |share| plus(from, along, share))
}

/// Samples of both magnets, delayed until they become readings.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Shown {
    next_s: f64,
    waiting: VecDeque<(f64, [f64; 2])>,
    pub(super) shown_rad: [f64; 2],
    noise: Dice,
}

impl Shown {
    pub(super) fn new(seed: u64) -> Self {
        Self { next_s: 0.0, waiting: VecDeque::new(), shown_rad: [0.0; 2], noise: Dice::new(seed) }
    }

    /// Samples when a period is over, and publishes samples whose delay is over.
    pub(super) fn step(&mut self, spec: &Whiskers, time_s: f64, magnets_rad: [f64; 2]) {
        // tolerance for the rounding of summed steps, far below a step
        let now_s = time_s + 1e-9;
        if now_s >= self.next_s {
            let sample = magnets_rad.map(|magnet_rad| magnet_rad + spec.noise_rad * self.noise.normal());
            self.waiting.push_back((time_s + spec.late_s, sample));
            self.next_s = spec.every_s * (libm::floor(now_s / spec.every_s) + 1.0);
        }
        while let Some((_, sample)) = self.waiting.pop_front_if(|(at_s, _)| *at_s <= now_s) {
            self.shown_rad = sample;
        }
    }
}
