//! 3D view of a robot that drives, in Foxglove's schemas: transforms, the way so far, the robot and the world around it.
//!
//! | topic | schema | contents |
//! | --- | --- | --- |
//! | `/tf` | `foxglove.FrameTransforms` | `odom` to `base_link` by the wheels; of a virtual board also `world` to `odom` |
//! | `/path` | `foxglove.PosesInFrame` | the way by the wheels, in `odom` |
//! | `/scene` | `foxglove.SceneUpdate` | robot and rays of its range sensors; of a virtual board also walls, posts, boxes, people, and where the robot really is |
//!
//! Frames follow REP-105: x forwards, y to the left, z up; m and rad. A [`View`] records them with everything else, so
//! that the same file or connection shows them.

mod message;
mod schema;
mod world;

use message::{
    Color, Cube, Cylinder, Entity, FrameTransform, FrameTransforms, LINE_LIST, Line, Pose, PosesInFrame, Quaternion,
    SceneUpdate, Time, Vector3,
};
use r4_log::{Derive, DerivedTopic};
use r4_protocol::{ChannelId, ChannelInfo, ChannelKind, Telemetry};
use serde::Serialize;

pub use world::{SharedLook, WorldLook};

use crate::{Footprint, NewestMotors, Odometry, Place, recorded_sides_rad};

const TRANSFORMS: DerivedTopic =
    DerivedTopic { name: "/tf", schema: "foxglove.FrameTransforms", json_schema: schema::frame_transforms };
const PATH: DerivedTopic =
    DerivedTopic { name: "/path", schema: "foxglove.PosesInFrame", json_schema: schema::poses_in_frame };
const SCENE: DerivedTopic =
    DerivedTopic { name: "/scene", schema: "foxglove.SceneUpdate", json_schema: schema::scene_update };

/// Frame of odometry: the robot's pose when the session was opened.
const ODOM: &str = "odom";
/// Frame of the robot's body, between its wheels.
const BASE: &str = "base_link";
/// Frame of the simulated world.
const WORLD: &str = "world";

/// Least time between two messages of a moving robot, ns. 20 Hz look continuous; not tuned.
const MOVING_EVERY_NS: u64 = 50_000_000;
/// Time after which all is repeated, for viewers that connect later, ns.
const REPEAT_NS: u64 = 1_000_000_000;
/// Distance between two poses of a short way, m: a tenth of a small robot. Not tuned.
const STEP_M: f64 = 0.05;
/// Most poses of the way, which is sent as a whole each second: 512 are about 70 kB of JSON. When there are more, every
/// second one is dropped and the distance doubles, so that a long drive is shown from its start on.
const MOST_POSES: usize = 512;

const ROBOT: Color = Color { r: 0.18, g: 0.45, b: 0.80, a: 1.0 };
const TRUTH: Color = Color { r: 0.25, g: 0.65, b: 0.35, a: 1.0 };
const RAY: Color = Color { r: 0.90, g: 0.45, b: 0.10, a: 1.0 };
const WALL: Color = Color { r: 0.45, g: 0.45, b: 0.45, a: 1.0 };
const MOVABLE: Color = Color { r: 0.75, g: 0.60, b: 0.35, a: 1.0 };
const PERSON: Color = Color { r: 0.85, g: 0.20, b: 0.30, a: 1.0 };

/// Height at which outlines are drawn, m. The world is planar; heights serve the eye only.
const OUTLINE_M: f64 = 0.1;
/// Height of boxes and posts, m.
const OBSTACLE_M: f64 = 0.3;
/// Height of people, m.
const PERSON_M: f64 = 1.7;

/// Returns the world around a virtual board; `None` while there is none.
pub type LookAtWorld = Box<dyn Fn() -> Option<WorldLook>>;

/// View of a robot, derived from its telemetry.
pub struct View {
    footprint: Footprint,
    odometry: Odometry,
    /// World of a virtual board, which is drawn too.
    world: LookAtWorld,
    /// Pose of `odom` in `world`: that of the robot at its first frame; `None` before it, and for boards on a link.
    origin: Option<Place>,
    /// Poses of the way, at least `step_m` apart when they were added.
    way: Vec<Pose>,
    /// Place of the last pose that was added; `None` before the first.
    last: Option<Place>,
    /// Least distance of the next pose from the last, m.
    step_m: f64,
    /// Newest ray of each range sensor that detects something, in the body's frame, m.
    rays_m: Vec<(ChannelId, [f64; 4])>,
    motors: NewestMotors,
    /// Time of the board at the last frame, µs.
    device_us: u64,
    /// Log time of the last transforms, ns.
    sent_ns: Option<u64>,
    /// Log time of the last message with all that stands still, ns.
    repeated_ns: Option<u64>,
}

impl View {
    /// View of a robot with this footprint, in the world that `world` returns.
    #[must_use]
    pub fn new(footprint: Footprint, world: LookAtWorld) -> Self {
        let odometry = Odometry::new(&footprint.drive);
        Self {
            footprint,
            odometry,
            world,
            motors: NewestMotors::default(),
            origin: None,
            way: Vec::new(),
            step_m: STEP_M,
            last: None,
            rays_m: Vec::new(),
            device_us: 0,
            sent_ns: None,
            repeated_ns: None,
        }
    }

    /// Adds the place to the way, unless it is near the last one.
    fn advance(&mut self, place: Place) {
        let moved_m = self.last.map(|last| (place.x_m - last.x_m).hypot(place.y_m - last.y_m));
        if moved_m.is_some_and(|moved_m| moved_m < self.step_m) {
            return;
        }
        if self.way.len() == MOST_POSES {
            let mut is_kept = false;
            self.way.retain(|_| {
                is_kept = !is_kept;
                is_kept
            });
            self.step_m *= 2.0;
        }
        self.last = Some(place);
        self.way.push(pose(place));
    }

    fn transforms(&self, timestamp: Time, place: Place) -> FrameTransforms {
        let transform = |parent_frame_id, child_frame_id, place: Place| FrameTransform {
            timestamp,
            parent_frame_id,
            child_frame_id,
            translation: Vector3::new(place.x_m, place.y_m, 0.0),
            rotation: Quaternion::yaw(place.yaw_rad),
        };
        let mut transforms = vec![transform(ODOM, BASE, place)];
        transforms.extend(self.origin.map(|origin| transform(WORLD, ODOM, origin)));
        FrameTransforms { transforms }
    }

    /// Entities that move, and with `all` those that stand.
    fn scene(&self, timestamp: Time, all: bool, world: Option<&WorldLook>) -> SceneUpdate {
        let mut entities = Vec::new();
        let mut rays = Entity::new(timestamp, BASE, "ranges");
        let ends = self.rays_m.iter().flat_map(|(_, [from_x, from_y, x, y])| [(*from_x, *from_y), (*x, *y)]);
        rays.lines.push(lines(ends, RAY));
        entities.push(rays);
        if all {
            let mut robot = Entity::new(timestamp, BASE, "robot");
            robot.lines.push(lines(ring(&self.footprint.outline_m), ROBOT));
            entities.push(robot);
        }
        if let Some(world) = world {
            let mut movable = Entity::new(timestamp, WORLD, "movable");
            movable.cubes.extend(world.boxes_m.iter().map(cube));
            let people = world.people_m.iter();
            movable.cylinders.extend(people.map(|(place_m, radius_m)| cylinder(*place_m, *radius_m, PERSON_M, PERSON)));
            if let Some(truth) = world.body {
                let mut outline = lines(ring(&self.footprint.outline_m), TRUTH);
                outline.pose = pose(truth);
                movable.lines.push(outline);
            }
            entities.push(movable);
            if all {
                let mut fixed = Entity::new(timestamp, WORLD, "fixed");
                fixed.lines.push(lines(world.walls_m.iter().flatten().map(|[x, y]| (*x, *y)), WALL));
                let posts = world.posts_m.iter();
                fixed
                    .cylinders
                    .extend(posts.map(|(place_m, radius_m)| cylinder(*place_m, *radius_m, OBSTACLE_M, WALL)));
                entities.push(fixed);
            }
        }
        SceneUpdate { deletions: [], entities }
    }
}

impl Derive for View {
    fn derive(
        &mut self,
        channels: &[ChannelInfo],
        telemetry: &Telemetry,
        log_time_ns: u64,
        give: &mut dyn FnMut(DerivedTopic, Vec<u8>),
    ) {
        if telemetry.device_us < self.device_us {
            // The board has restarted: its wheels count from 0 again.
            self.odometry.count_anew();
            self.motors.clear();
        }
        self.device_us = telemetry.device_us;
        for sample in &telemetry.samples {
            let channel = sample.channel();
            if channel.kind == ChannelKind::Range {
                // A sensor that detects nothing has no ray.
                self.rays_m.retain(|(of, _)| *of != channel);
                self.rays_m.extend(self.footprint.ray_m(sample).map(|ray_m| (channel, ray_m)));
            }
        }
        let motors = self.motors.take(&telemetry.samples);
        let sides = motors.and_then(|motors| recorded_sides_rad(channels, &self.footprint.drive, &motors));
        let Some([left_rad, right_rad]) = sides else { return };
        self.odometry.look(left_rad, right_rad);
        let since = |then_ns: Option<u64>| then_ns.map_or(u64::MAX, |then_ns| log_time_ns.abs_diff(then_ns));
        if since(self.sent_ns) < MOVING_EVERY_NS {
            return;
        }
        self.sent_ns = Some(log_time_ns);
        let all = since(self.repeated_ns) >= REPEAT_NS;
        if all {
            self.repeated_ns = Some(log_time_ns);
        }
        let place = self.odometry.place();
        let world = (self.world)();
        if self.origin.is_none() {
            // Odometry has counted since the first frame, so its frame is where the robot was by it then.
            self.origin = world.as_ref().and_then(|world| world.body).map(|truth| origin(truth, place));
        }
        let timestamp = Time::of_ns(log_time_ns);
        give(TRANSFORMS, json(&self.transforms(timestamp, place)));
        self.advance(place);
        if all {
            give(PATH, json(&PosesInFrame { timestamp, frame_id: ODOM, poses: &self.way }));
        }
        give(SCENE, json(&self.scene(timestamp, all, world.as_ref())));
    }
}

fn json(message: &impl Serialize) -> Vec<u8> {
    // Only maps with keys that are no text fail, and messages have none.
    serde_json::to_vec(message).unwrap_or_default()
}

/// Pose on the floor.
fn pose(place: Place) -> Pose {
    Pose::new(Vector3::new(place.x_m, place.y_m, 0.0), place.yaw_rad)
}

/// Pose of the frame in which the robot is at `place`, when it is at `truth` in the world.
fn origin(truth: Place, place: Place) -> Place {
    let yaw_rad = truth.yaw_rad - place.yaw_rad;
    let (sin, cos) = yaw_rad.sin_cos();
    Place {
        x_m: truth.x_m - cos * place.x_m + sin * place.y_m,
        y_m: truth.y_m - sin * place.x_m - cos * place.y_m,
        yaw_rad,
    }
}

/// Box on the floor with these corners, in order around it.
fn cube([a, b, c, _]: &[[f64; 2]; 4]) -> Cube {
    let (along, across) = ([b[0] - a[0], b[1] - a[1]], [c[0] - b[0], c[1] - b[1]]);
    let centre = Vector3::new((a[0] + c[0]) / 2.0, (a[1] + c[1]) / 2.0, OBSTACLE_M / 2.0);
    Cube {
        pose: Pose::new(centre, along[1].atan2(along[0])),
        size: Vector3::new(along[0].hypot(along[1]), across[0].hypot(across[1]), OBSTACLE_M),
        color: MOVABLE,
    }
}

/// Lines at the height of outlines; each pair of points is one.
fn lines(points_m: impl Iterator<Item = (f64, f64)>, color: Color) -> Line {
    Line {
        kind: LINE_LIST,
        pose: pose(Place::default()),
        thickness: 0.02,
        scale_invariant: false,
        points: points_m.map(|(x, y)| Vector3::new(x, y, OUTLINE_M)).collect(),
        color,
        colors: [],
        indices: [],
    }
}

/// Sides of a closed outline as pairs of points, with a mark from its middle forwards.
fn ring(corners_m: &[[f64; 2]]) -> impl Iterator<Item = (f64, f64)> {
    let next = corners_m.iter().cycle().skip(1);
    let front_m = corners_m.iter().map(|[x, _]| *x).fold(0.0, f64::max);
    let sides = corners_m.iter().zip(next).flat_map(|([x, y], [to_x, to_y])| [(*x, *y), (*to_x, *to_y)]);
    sides.chain([(0.0, 0.0), (front_m, 0.0)])
}

fn cylinder([x, y]: [f64; 2], radius_m: f64, height_m: f64, color: Color) -> Cylinder {
    Cylinder {
        pose: Pose::new(Vector3::new(x, y, height_m / 2.0), 0.0),
        size: Vector3::new(2.0 * radius_m, 2.0 * radius_m, height_m),
        bottom_scale: 1.0,
        top_scale: 1.0,
        color,
    }
}

#[cfg(test)]
mod tests;
