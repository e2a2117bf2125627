//! The simulated world as the view draws it.

use std::sync::{Arc, Mutex};

use r4_sim::world::World;

use crate::Place;

/// Things in the world that move, and those that stand, in the world's frame, m and rad.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WorldLook {
    /// True pose of the robot's body; `None` without one.
    pub(super) body: Option<Place>,
    /// Corners of each movable box, in order around it.
    pub(super) boxes_m: Vec<[[f64; 2]; 4]>,
    /// Centre and radius of each person.
    pub(super) people_m: Vec<([f64; 2], f64)>,
    /// Both ends of each wall.
    pub(super) walls_m: Vec<[[f64; 2]; 2]>,
    /// Centre and radius of each post.
    pub(super) posts_m: Vec<([f64; 2], f64)>,
}

impl WorldLook {
    /// The world at its last update: reading it does not make it catch up, so that a view changes no simulation.
    #[must_use]
    pub fn of(world: &World) -> Self {
        let (scene, time_s) = (world.scene(), world.clock().now_ns() as f64 * 1e-9);
        let body = world.body().map(|body| {
            let pose = body.pose();
            Place { x_m: pose.x_m, y_m: pose.y_m, yaw_rad: pose.yaw_rad }
        });
        Self {
            body,
            boxes_m: scene.boxes().iter().map(|one| one.corners_m()).collect(),
            people_m: scene.people().iter().map(|person| (person.place_m(time_s), person.radius_m)).collect(),
            walls_m: scene.walls_m().collect(),
            posts_m: scene.posts_m().collect(),
        }
    }
}

/// Newest look of a virtual board that another thread of this program simulates; empty until it was looked at.
#[derive(Clone, Debug, Default)]
pub struct SharedLook(Arc<Mutex<Option<WorldLook>>>);

impl SharedLook {
    /// Replaces the look.
    pub fn set(&self, look: WorldLook) {
        // A thread that panicked left a whole look.
        *self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner) = Some(look);
    }

    /// Returns the newest look.
    #[must_use]
    pub fn get(&self) -> Option<WorldLook> {
        self.0.lock().unwrap_or_else(std::sync::PoisonError::into_inner).clone()
    }
}
