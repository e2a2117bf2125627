//! The body that couples motors, and what sees the scene from it.

use r4_boards::{Mount, RangeView, Robot, SimulatedBody};
use r4_protocol::ChannelId;
use r4_world::{Body, MAX_STEP_S, Pose, Scene, ShaftMotion, Twist, Wheeled};

use super::{RANGE_SENSORS, World, motor::Motor};
use crate::sensors::hc_sr04::FARTHEST_M;

/// Half the angle in which an HC-SR04 hears a flat target (ElecFreaks sheet: 15 degrees), rad.
const HALF_CONE_RAD: f64 = 15.0 * std::f64::consts::PI / 180.0;

/// Shortest step, s. The world's clock counts 1e-9 s, so anything shorter is rounding.
const SHORTEST_STEP_S: f64 = 1e-12;

/// A body and the motors on its shafts.
pub(super) struct Coupling {
    body: Wheeled,
    /// The motor on each shaft, by its number in the world.
    shafts: Vec<usize>,
    motions: Vec<ShaftMotion>,
    loads: Vec<f64>,
    /// Time that the shafts are ahead of the body, s.
    owed_s: f64,
}

impl Coupling {
    /// Couples those of the world's motors that the body names.
    pub(super) fn new(simulated: &SimulatedBody, motors: &mut [Motor]) -> Self {
        for motor in motors.iter_mut() {
            motor.coupled = simulated.channels.contains(&motor.channel);
        }
        // The file's reader has checked that they exist.
        let place = |channel: &ChannelId| motors.iter().position(|motor| motor.channel == *channel);
        let shafts: Vec<_> = simulated.channels.iter().filter_map(place).collect();
        Self {
            body: simulated.wheeled.clone(),
            motions: vec![ShaftMotion::default(); shafts.len()],
            loads: vec![0.0; shafts.len()],
            shafts,
            owed_s: 0.0,
        }
    }

    /// Lets body and shafts go on together. The motors take the steps that they would take alone. The body takes several of them at
    /// once, up to [`MAX_STEP_S`], so that it costs little where somebody looks at encoders often; its loads hold until it is
    /// stepped again.
    pub(super) fn step(
        &mut self,
        scene: &Scene,
        from_s: f64,
        motors: &mut [Motor],
        dt_s: f64,
        mut advance: impl FnMut(&mut Motor, f64),
    ) {
        for motor in motors.iter_mut().filter(|motor| !motor.coupled) {
            advance(motor, dt_s);
        }
        let mut left_s = dt_s;
        while left_s > SHORTEST_STEP_S {
            let step_s = left_s.min(MAX_STEP_S);
            if self.owed_s + step_s > MAX_STEP_S + SHORTEST_STEP_S {
                self.catch_up(scene, from_s + (dt_s - left_s), motors);
            }
            for number in &self.shafts {
                advance(&mut motors[*number], step_s);
            }
            self.owed_s += step_s;
            left_s -= step_s;
        }
    }

    /// Brings the body to now, and gives the shafts its loads.
    fn catch_up(&mut self, scene: &Scene, now_s: f64, motors: &mut [Motor]) {
        for (motion, number) in self.motions.iter_mut().zip(&self.shafts) {
            let plant = &motors[*number].plant;
            *motion = ShaftMotion { position: plant.position(), speed: plant.speed() };
        }
        self.body.step(scene, now_s, &self.motions, &mut self.loads, self.owed_s);
        self.owed_s = 0.0;
        for (load, number) in self.loads.iter().zip(&self.shafts) {
            motors[*number].plant.set_load(*load);
        }
    }
}

/// Where range sensors sit that look at the scene.
pub(super) fn mounts(robot: &Robot) -> [Option<Mount>; RANGE_SENSORS] {
    let mut mounts = [None; RANGE_SENSORS];
    for range in &robot.simulation.ranges {
        if let (RangeView::World(mount), Some(place)) = (range.sees, mounts.get_mut(usize::from(range.channel.index))) {
            *place = Some(mount);
        }
    }
    mounts
}

impl World {
    /// Lets a range sensor on the body see what is in front of it now.
    pub(super) fn look_ahead(&mut self, connector: usize) {
        let Some(mount) = self.mounts.get(connector).copied().flatten() else { return };
        let Some(pose) = self.pose() else { return };
        let from = pose.to_world(mount.place_m);
        let direction_rad = pose.yaw_rad + mount.yaw_rad;
        let time_s = self.now_ns as f64 * 1e-9;
        let distance_m = self.scene.cone_m(time_s, from, direction_rad, HALF_CONE_RAD, FARTHEST_M);
        if let Some(module) = self.pins.rangers.modules.get_mut(connector) {
            module.set_background_m(distance_m);
        }
    }

    /// Where the body is now; `None` for a robot without one. Since its last step, at most [`MAX_STEP_S`] ago, it moved as it did then.
    pub fn pose(&mut self) -> Option<Pose> {
        self.catch_up();
        self.body.as_ref().map(|coupling| coupling.body.pose().moved(coupling.body.twist(), coupling.owed_s))
    }

    /// How the body moves, at most [`MAX_STEP_S`] ago, in its own frame; `None` for a robot without one.
    pub fn twist(&mut self) -> Option<Twist> {
        self.catch_up();
        self.body.as_ref().map(|coupling| coupling.body.twist())
    }

    /// What is around the body.
    #[must_use]
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The body as it was when somebody looked last; `None` for a robot without one.
    #[must_use]
    pub fn body(&self) -> Option<&Wheeled> {
        self.body.as_ref().map(|coupling| &coupling.body)
    }
}
