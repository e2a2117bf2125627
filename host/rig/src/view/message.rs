//! Messages in Foxglove's well-known schemas, as far as the view of a robot needs them.
//!
//! Names, fields and units are those of <https://docs.foxglove.dev/docs/sdk/schemas>; the tests beside Foxglove's own
//! definitions are in `tests/foxglove`.

use serde::Serialize;

/// `foxglove.Time`
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub(super) struct Time {
    sec: u64,
    nsec: u32,
}

impl Time {
    pub(super) fn of_ns(ns: u64) -> Self {
        Self { sec: ns / 1_000_000_000, nsec: (ns % 1_000_000_000) as u32 }
    }
}

/// `foxglove.Vector3` and `foxglove.Point3`, m.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub(super) struct Vector3 {
    pub(super) x: f64,
    pub(super) y: f64,
    pub(super) z: f64,
}

impl Vector3 {
    /// Rounds to 0.1 mm: a third of the digits, and less than a wheel encoder resolves.
    pub(super) fn new(x: f64, y: f64, z: f64) -> Self {
        let rounded = |value_m: f64| (value_m * 1e4).round() / 1e4;
        Self { x: rounded(x), y: rounded(y), z: rounded(z) }
    }
}

/// `foxglove.Quaternion`
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Quaternion {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

impl Quaternion {
    /// Rotation about z, rad.
    pub(super) fn yaw(yaw_rad: f64) -> Self {
        let (z, w) = (yaw_rad / 2.0).sin_cos();
        Self { x: 0.0, y: 0.0, z, w }
    }
}

/// `foxglove.Pose`
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Pose {
    pub(super) position: Vector3,
    pub(super) orientation: Quaternion,
}

impl Pose {
    pub(super) fn new(position: Vector3, yaw_rad: f64) -> Self {
        Self { position, orientation: Quaternion::yaw(yaw_rad) }
    }
}

/// `foxglove.FrameTransform`
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct FrameTransform {
    pub(super) timestamp: Time,
    pub(super) parent_frame_id: &'static str,
    pub(super) child_frame_id: &'static str,
    pub(super) translation: Vector3,
    pub(super) rotation: Quaternion,
}

/// `foxglove.FrameTransforms`
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct FrameTransforms {
    pub(super) transforms: Vec<FrameTransform>,
}

/// `foxglove.PosesInFrame`
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct PosesInFrame<'a> {
    pub(super) timestamp: Time,
    pub(super) frame_id: &'static str,
    pub(super) poses: &'a [Pose],
}

/// `foxglove.Color`, 0 to 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct Color {
    pub(super) r: f64,
    pub(super) g: f64,
    pub(super) b: f64,
    pub(super) a: f64,
}

/// Kind of a line: each pair of points is one.
pub(super) const LINE_LIST: u8 = 2;

/// `foxglove.LinePrimitive`
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Line {
    #[serde(rename = "type")]
    pub(super) kind: u8,
    pub(super) pose: Pose,
    /// Thickness, m.
    pub(super) thickness: f64,
    pub(super) scale_invariant: bool,
    pub(super) points: Vec<Vector3>,
    pub(super) color: Color,
    pub(super) colors: [Color; 0],
    pub(super) indices: [u32; 0],
}

/// `foxglove.CubePrimitive`
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Cube {
    pub(super) pose: Pose,
    pub(super) size: Vector3,
    pub(super) color: Color,
}

/// `foxglove.CylinderPrimitive`
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Cylinder {
    pub(super) pose: Pose,
    pub(super) size: Vector3,
    pub(super) bottom_scale: f64,
    pub(super) top_scale: f64,
    pub(super) color: Color,
}

/// `foxglove.SceneEntity`, with the shapes that the view uses; the other lists stay empty.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct Entity {
    pub(super) timestamp: Time,
    pub(super) frame_id: &'static str,
    pub(super) id: &'static str,
    /// Zero: until another entity with this id comes.
    pub(super) lifetime: Time,
    /// True moves the entity with its frame.
    pub(super) frame_locked: bool,
    pub(super) metadata: [(); 0],
    pub(super) arrows: [(); 0],
    pub(super) cubes: Vec<Cube>,
    pub(super) spheres: [(); 0],
    pub(super) cylinders: Vec<Cylinder>,
    pub(super) lines: Vec<Line>,
    pub(super) triangles: [(); 0],
    pub(super) texts: [(); 0],
    pub(super) models: [(); 0],
}

impl Entity {
    pub(super) fn new(timestamp: Time, frame_id: &'static str, id: &'static str) -> Self {
        Self {
            timestamp,
            frame_id,
            id,
            lifetime: Time::default(),
            frame_locked: true,
            metadata: [],
            arrows: [],
            cubes: Vec::new(),
            spheres: [],
            cylinders: Vec::new(),
            lines: Vec::new(),
            triangles: [],
            texts: [],
            models: [],
        }
    }
}

/// `foxglove.SceneUpdate`
#[derive(Clone, Debug, PartialEq, Serialize)]
pub(super) struct SceneUpdate {
    pub(super) deletions: [(); 0],
    pub(super) entities: Vec<Entity>,
}
