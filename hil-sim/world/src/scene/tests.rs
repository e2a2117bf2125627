//! Rays and distances compared with `parry2d`, which shares no code with ours.

use parry2d_f64::{
    math::{Pose, Vector},
    query::{PointQuery, Ray, RayCast},
    shape::{Ball, Segment},
};
use proptest::prelude::*;

use super::*;

const FAR_M: f64 = 50.0;

/// A scene, and the same shapes for the oracle.
#[derive(Debug)]
struct Both {
    scene: Scene,
    segments: Vec<[Point; 2]>,
    balls: Vec<(Point, f64)>,
}

fn point() -> impl Strategy<Value = Point> {
    prop::array::uniform2(-5.0..5.0f64)
}

fn both() -> impl Strategy<Value = Both> {
    let walls = prop::collection::vec((point(), point()), 0..6);
    let posts = prop::collection::vec((point(), 0.05..1.0f64), 0..4);
    (walls, posts).prop_map(|(walls, posts)| {
        let mut scene = Scene::default();
        walls.iter().for_each(|(from, to)| scene.add_walls(&[*from, *to], false).unwrap());
        posts.iter().for_each(|(centre, radius_m)| scene.add_post(*centre, *radius_m).unwrap());
        Both { scene, segments: walls.into_iter().map(|(from, to)| [from, to]).collect(), balls: posts }
    })
}

impl Both {
    fn ray_m(&self, from: Point, direction_rad: f64) -> Option<f64> {
        let direction = Vector::new(direction_rad.cos(), direction_rad.sin());
        let ray = Ray::new(Vector::from(from), direction);
        let walls = self.segments.iter().filter_map(|[from, to]| {
            Segment::new(Vector::from(*from), Vector::from(*to)).cast_local_ray(&ray, FAR_M, true)
        });
        let balls = self.balls.iter().filter_map(|(centre, radius_m)| {
            Ball::new(*radius_m).cast_ray(&Pose::translation(centre[0], centre[1]), &ray, FAR_M, true)
        });
        walls.chain(balls).min_by(f64::total_cmp)
    }

    fn distance_m(&self, point: Point) -> f64 {
        let point = Vector::from(point);
        let walls = self.segments.iter().map(|[from, to]| {
            Segment::new(Vector::from(*from), Vector::from(*to)).distance_to_local_point(point, true)
        });
        let balls = self.balls.iter().map(|(centre, radius_m)| {
            Ball::new(*radius_m).distance_to_point(&Pose::translation(centre[0], centre[1]), point, true)
        });
        walls.chain(balls).fold(f64::INFINITY, f64::min)
    }
}

fn same(ours: Option<f64>, theirs: Option<f64>) -> bool {
    match (ours, theirs) {
        // rounding of coordinates of 5 m, times the flattest angle that 1e-9 of the cases have
        (Some(ours), Some(theirs)) => (ours - theirs).abs() < 1e-8,
        (ours, theirs) => ours == theirs,
    }
}

proptest! {
    #[test]
    fn rays_and_distances_are_those_of_parry(both in both(), from in point(), direction_rad in -4.0..4.0f64) {
        let (ours, theirs) = (both.scene.ray_m(0.0, from, direction_rad, FAR_M), both.ray_m(from, direction_rad));
        prop_assert!(same(ours, theirs), "{ours:?} {theirs:?}");
        let (ours, theirs) = (both.scene.clearance_m(0.0, from), both.distance_m(from));
        prop_assert!(ours == theirs || (ours - theirs).abs() < 1e-12, "{ours} {theirs}");
    }

    /// The nearest hit of many rays in the cone, which can only overestimate the distance slightly.
    #[test]
    fn a_cone_hears_what_the_nearest_of_its_rays_meets(
        both in both(), from in point(), direction_rad in -4.0..4.0f64, half_rad in 0.05..0.5f64,
    ) {
        let rays = 2000;
        let angles = (0..=rays).map(|ray| direction_rad + half_rad * (2.0 * f64::from(ray) / f64::from(rays) - 1.0));
        let nearest = angles.filter_map(|angle| both.ray_m(from, angle)).min_by(f64::total_cmp);
        let cone = both.scene.cone_m(0.0, from, direction_rad, half_rad, FAR_M);
        // the cone may be nearer: the end of a wall between two rays is hit by neither
        if let Some(nearest_m) = nearest {
            prop_assert!(cone.is_some_and(|cone_m| cone_m <= nearest_m + 1e-9), "{cone:?} {nearest_m}");
        }
        if let Some(cone_m) = cone {
            prop_assert!(cone_m >= both.distance_m(from) - 1e-9);
        }
    }
}

#[test]
fn a_cone_is_as_wide_as_it_is() {
    let mut scene = Scene::default();
    // a wall 2 m ahead that starts 1 m to the left
    scene.add_walls(&[[2.0, 1.0], [2.0, 3.0]], false).unwrap();
    let at = |half_rad: f64| scene.cone_m(0.0, [0.0, 0.0], 0.0, half_rad, FAR_M);
    assert_eq!(at(0.46), None);
    // atan(1 / 2) = 0.4636 is the direction of its end
    assert!((at(0.47).unwrap() - 5.0_f64.sqrt()).abs() < 1e-12);
    assert_eq!(scene.cone_m(0.0, [0.0, 0.0], 0.0, 0.47, 2.2), None, "it is too far");
}

#[test]
fn people_walk_from_place_to_place_and_stay() {
    let mut scene = Scene::default();
    let person = Person { radius_m: 0.25, path: vec![(1.0, [3.0, 2.0]), (3.0, [3.0, 0.0]), (4.0, [3.0, 0.0])] };
    scene.add_person(person).unwrap();
    let ahead = |time_s: f64| scene.ray_m(time_s, [0.0, 0.0], 0.0, FAR_M);
    assert_eq!([0.0, 1.0, 2.5].map(ahead), [None; 3]);
    assert_eq!([3.0, 100.0].map(ahead), [Some(2.75); 2]);
    assert_eq!(scene.people()[0].place_m(2.0), [3.0, 1.0]);
    assert_eq!(scene.fastest_m_s(), 1.0);
}

#[test]
fn the_later_of_two_floors_counts() {
    let mut scene = Scene::default();
    let square = |side_m: f64| vec![[0.0, 0.0], [side_m, 0.0], [side_m, side_m], [0.0, side_m]];
    let ice = Surface { corners_m: square(4.0), friction: Some(0.1), slope: [0.0; 2] };
    let ramp = Surface { corners_m: square(1.0), friction: None, slope: [0.2, 0.0] };
    scene.add_surface(ice).unwrap();
    scene.add_surface(ramp).unwrap();
    assert_eq!(scene.floor([2.0, 3.0]), Floor { friction: Some(0.1), slope: [0.0; 2] });
    assert_eq!(scene.floor([0.5, 0.5]), Floor { friction: None, slope: [0.2, 0.0] });
    assert_eq!(scene.floor([-1.0, 0.5]), Floor::default());
}

#[test]
fn what_cannot_stand_is_named() {
    let mut scene = Scene::default();
    assert_eq!(scene.add_walls(&[[0.0, 0.0]], false), Err(SceneError::Points { least: 2 }));
    assert_eq!(scene.add_walls(&[[0.0, 0.0], [1.0, f64::NAN], [2.0, 0.0]], true), Err(SceneError::Points { least: 3 }));
    assert_eq!(scene.add_post([0.0, 0.0], 0.0), Err(SceneError::Disc));
    let person = |path: &[(f64, Point)]| Person { radius_m: 0.2, path: path.to_vec() };
    assert_eq!(scene.add_person(person(&[])), Err(SceneError::Path));
    assert_eq!(scene.add_person(person(&[(1.0, [0.0; 2]), (1.0, [1.0; 2])])), Err(SceneError::Path));
    let corners_m = vec![[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]];
    let floor = Surface { corners_m, friction: Some(-0.1), slope: [0.0; 2] };
    assert_eq!(scene.add_surface(floor), Err(SceneError::Floor));
    assert_eq!(scene, Scene::default());
}
