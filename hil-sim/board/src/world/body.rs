//! The body that couples motors, and the sensors on it that see the scene.

use r4_boards::{BodyReading, Mount, RangeView, Robot, SimulatedBody};
use r4_protocol::{ChannelId, config::RelayConfig};
use r4_world::{AnyBody, Inertial, MAX_STEP_S, Pose, Scene, ShaftMotion, Twist, Wheeled};

use super::{
    RANGE_SENSORS, World,
    drives::{Bldc, Servo},
    motor::Motor,
    stepping::Axis,
};
use crate::sensors::hc_sr04::FARTHEST_M;

/// Half the opening angle in which an HC-SR04 detects a flat target (ElecFreaks sheet: 15 degrees), rad.
const HALF_CONE_RAD: f64 = 15.0 * std::f64::consts::PI / 180.0;

/// Longest step of a body, ns.
const MAX_STEP_NS: u64 = (MAX_STEP_S * 1e9) as u64;

/// Everything in a world that turns shafts.
pub(super) struct Movers<'w> {
    pub(super) motors: &'w mut [Motor],
    pub(super) bldcs: &'w mut [Bldc],
    pub(super) servos: &'w mut [Servo],
    pub(super) steppers: &'w mut [Axis],
    pub(super) relays: &'w [Relay],
}

/// A relay and its contact.
#[derive(Clone, Copy)]
pub(super) struct Relay {
    pub(super) config: RelayConfig,
    /// State of the contact at the last change of its line.
    pub(super) is_closed: bool,
}

/// Drive of one of the body's shafts, by its index in the world.
#[derive(Clone, Copy)]
enum Shaft {
    Motor(usize),
    Bldc(usize),
    /// Servo, which follows its pulses: its model takes no load.
    Servo(usize),
    /// Stepper, which follows its pulses: its model takes no load.
    Stepper(usize),
    /// Relay, a shaft at 1 while closed, which takes no load.
    Relay(usize),
}

/// A body with the drives of its shafts.
pub(super) struct Coupling {
    body: AnyBody,
    shafts: Vec<Shaft>,
    motions: Vec<ShaftMotion>,
    loads: Vec<f64>,
    /// Time by which the shafts are ahead of the body, ns.
    owed_ns: u64,
}

impl Coupling {
    /// Couples those of the world's movers that the body names.
    pub(super) fn new(simulated: &SimulatedBody, movers: Movers<'_>) -> Self {
        let named = |channel| simulated.channels.contains(&channel);
        movers.motors.iter_mut().for_each(|motor| motor.coupled = named(motor.channel));
        movers.bldcs.iter_mut().for_each(|bldc| bldc.coupled = named(bldc.channel));
        // the file's reader has checked that they exist
        let place = |channel: &ChannelId| {
            let motor = movers.motors.iter().position(|motor| motor.channel == *channel).map(Shaft::Motor);
            let bldc = || movers.bldcs.iter().position(|bldc| bldc.channel == *channel).map(Shaft::Bldc);
            let servo = || movers.servos.iter().position(|servo| servo.channel == *channel).map(Shaft::Servo);
            let stepper = || movers.steppers.iter().position(|axis| axis.channel == *channel).map(Shaft::Stepper);
            let relay = || movers.relays.iter().position(|relay| relay.config.id == *channel).map(Shaft::Relay);
            motor.or_else(bldc).or_else(servo).or_else(stepper).or_else(relay)
        };
        let shafts: Vec<_> = simulated.channels.iter().filter_map(place).collect();
        Self {
            body: simulated.kind.clone(),
            motions: vec![ShaftMotion::default(); shafts.len()],
            loads: vec![0.0; shafts.len()],
            shafts,
            owed_ns: 0,
        }
    }

    /// Advances body and shafts together. The motors take the same steps as without a body. The body takes several of
    /// them at once, up to [`MAX_STEP_S`], so that frequent queries of encoders cost little; its loads hold until its
    /// next step.
    pub(super) fn step(
        &mut self,
        scene: &mut Scene,
        [from_ns, until_ns]: [u64; 2],
        movers: &mut Movers<'_>,
        mut advance: impl FnMut(&mut Motor, f64),
    ) {
        let dt_s = (until_ns - from_ns) as f64 * 1e-9;
        for motor in movers.motors.iter_mut().filter(|motor| !motor.coupled) {
            advance(motor, dt_s);
        }
        let mut now_ns = from_ns;
        while now_ns < until_ns {
            let step_ns = (until_ns - now_ns).min(MAX_STEP_NS);
            if self.owed_ns + step_ns > MAX_STEP_NS {
                self.catch_up(scene, now_ns, movers);
            }
            now_ns += step_ns;
            for shaft in &self.shafts {
                match *shaft {
                    Shaft::Motor(number) => advance(&mut movers.motors[number], step_ns as f64 * 1e-9),
                    Shaft::Bldc(number) => movers.bldcs[number].drive.advance(now_ns),
                    // they take no load that could be late: read when the body is stepped
                    Shaft::Servo(_) | Shaft::Stepper(_) | Shaft::Relay(_) => {}
                }
            }
            self.owed_ns += step_ns;
        }
    }

    /// Pose of the body, extrapolated at the velocity of its last step over the time that it lags.
    pub(super) fn pose(&self) -> Pose {
        self.body.pose().moved(self.body.twist(), self.owed_ns as f64 * 1e-9)
    }

    /// Mean of the absolute speeds of its shafts, rad/s or m/s.
    pub(super) fn turning(&self) -> f64 {
        let speeds = self.motions.iter().map(|motion| motion.speed.abs());
        speeds.sum::<f64>() / self.motions.len().max(1) as f64
    }

    /// Readings of an ideal inertial sensor at the body's origin, at most [`MAX_STEP_S`] old.
    pub(super) fn inertial(&self) -> Inertial {
        self.body.inertial()
    }

    /// Advances the body to the present time, and sets the shafts' loads.
    fn catch_up(&mut self, scene: &mut Scene, now_ns: u64, movers: &mut Movers<'_>) {
        for (motion, shaft) in self.motions.iter_mut().zip(&self.shafts) {
            let (position, speed) = match *shaft {
                Shaft::Motor(number) => {
                    let plant = &movers.motors[number].plant;
                    (plant.position(), plant.speed())
                }
                Shaft::Bldc(number) => {
                    let drive = movers.bldcs[number].at(now_ns);
                    (drive.position_rad(), drive.speed_rad_s())
                }
                Shaft::Servo(number) => {
                    let servo = movers.servos[number].at(now_ns);
                    (servo.angle_rad(), servo.speed_rad_s())
                }
                Shaft::Stepper(number) => {
                    let axis = &mut movers.steppers[number];
                    axis.catch_up(now_ns);
                    (axis.angle_rad(), axis.speed_rad_s())
                }
                Shaft::Relay(number) => (f64::from(u8::from(movers.relays[number].is_closed)), 0.0),
            };
            *motion = ShaftMotion { position, speed };
        }
        let owed_s = self.owed_ns as f64 * 1e-9;
        self.body.step(scene, now_ns as f64 * 1e-9, &self.motions, &mut self.loads, owed_s);
        self.owed_ns = 0;
        for (load, shaft) in self.loads.iter().zip(&self.shafts) {
            match *shaft {
                Shaft::Motor(number) => movers.motors[number].plant.set_load(*load),
                Shaft::Bldc(number) => movers.bldcs[number].drive.set_load(*load),
                Shaft::Servo(_) | Shaft::Stepper(_) | Shaft::Relay(_) => {}
            }
        }
    }

    /// Output of a sensor on the body, at most [`MAX_STEP_S`] old, with its gain and offset.
    pub(super) fn measured(&self, of: BodyReading) -> f64 {
        of.zero + of.per_unit * self.body.reading(of.number)
    }
}

/// Mounts of the range sensors that see the scene.
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
    /// Updates the distance in front of a range sensor on the body.
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

    /// Pose of the body; `None` for a robot without one. Extrapolated from its last step, at most [`MAX_STEP_S`] ago.
    pub fn pose(&mut self) -> Option<Pose> {
        self.catch_up();
        self.body.as_ref().map(Coupling::pose)
    }

    /// Velocity of the body in its own frame, at most [`MAX_STEP_S`] old; `None` for a robot without one.
    pub fn twist(&mut self) -> Option<Twist> {
        self.catch_up();
        self.body.as_ref().map(|coupling| coupling.body.twist())
    }

    /// Scene around the body.
    #[must_use]
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// The body at its last update; `None` for a robot without one.
    #[must_use]
    pub fn body(&self) -> Option<&AnyBody> {
        self.body.as_ref().map(|coupling| &coupling.body)
    }

    /// The body, mutable, for changes other than by its shafts: an object that is put down, a load that is removed.
    /// `None` for a robot without one.
    pub fn body_mut(&mut self) -> Option<&mut AnyBody> {
        self.catch_up();
        self.body.as_mut().map(|coupling| &mut coupling.body)
    }

    /// As [`World::body`], for a robot on wheels; `None` for all others.
    #[must_use]
    pub fn wheeled(&self) -> Option<&Wheeled> {
        if let Some(AnyBody::Wheeled(body)) = self.body() { Some(body) } else { None }
    }
}
