//! Boxes and robots that the study samples, and the values that a program knows of the robot.

use std::rc::Rc;

use r4_boards::{Drive, Robot, SkidSteer};
use r4_protocol::ChannelId;
use r4_rig::Alter;
use r4_world::{AnyBody, BoxSpec, Chassis, Deformable, Pose, Scene, Shell, Whiskers};

use crate::Sampler;

/// Purpose of the random numbers of a case.
const OF_CASE: u64 = 1;

/// Size of a box along and across the direction of travel, m. Printed are 22 x 16.5 x 11.5 cm; that the long side is
/// across is our choice.
pub const BOX_M: [f64; 2] = [0.165, 0.22];
/// Gap between the boxes, m: printed.
pub const GAP_M: f64 = 0.24;
/// Distance from the nose at rest to the boxes, m: printed.
pub const AHEAD_M: f64 = 0.20;
/// Travel after which the side panels, half a panel of 0.21 m before and behind the middle, are past the boxes' far
/// faces, m.
pub const PASSED_M: f64 = 0.21 + AHEAD_M + BOX_M[0] + 0.105;
/// Duration of a trial, s: printed.
pub const TRIAL_S: f64 = 5.0;

/// Contents of the boxes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Load {
    /// Boxes without any contents.
    Light,
    /// Boxes with 100 g.
    Moderate,
    /// Boxes with 10 kg.
    Heavy,
}

impl Load {
    /// All loads, from light to heavy.
    pub const ALL: [Self; 3] = [Self::Light, Self::Moderate, Self::Heavy];

    /// Mass of the contents, kg: printed.
    #[must_use]
    pub const fn contents_kg(self) -> f64 {
        match self {
            Self::Light => 0.0,
            Self::Moderate => 0.1,
            Self::Heavy => 10.0,
        }
    }

    /// Name of the load in metrics.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Light => "light",
            Self::Moderate => "moderate",
            Self::Heavy => "heavy",
        }
    }
}

/// A robot in front of two boxes. [`About::sampled`](crate::About::sampled) has the ranges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Case {
    /// Load of both boxes.
    pub load: Load,
    /// Mass of the empty boxes, left and right, kg.
    pub empty_kg: [f64; 2],
    /// Static friction of the boxes, left and right.
    pub friction: [f64; 2],
    /// Kinetic friction as a share of the static.
    pub kinetic_share: f64,
    /// Start of the robot to the left of the gap's middle, m.
    pub aside_m: f64,
    /// Heading of the robot at the start, rad.
    pub yaw_rad: f64,
    /// Friction coefficient of the robot's tyres.
    pub tyre_friction: f64,
    /// Stiffness of the whiskers' springs over that of the robot's file.
    pub spring: f64,
    /// Play of the whiskers' magnets, rad.
    pub hysteresis_rad: f64,
    /// Dead time of the whiskers' samples, s.
    pub late_s: f64,
    /// Period of the whiskers' samples, s.
    pub every_s: f64,
    /// Time at rest before the start, s: it decides the phase of the start in the samples' period.
    pub waits_s: f64,
    /// Seed of the whiskers' noise.
    pub seed: u64,
}

impl Case {
    /// Samples the case of a seed with boxes of one load; masses, friction and the start are the same for all loads.
    #[must_use]
    pub fn of(seed: u64, load: Load) -> Self {
        let mut sampler = Sampler::new(seed, OF_CASE);
        let mut both = |low: f64, high: f64| [sampler.uniform(low, high), sampler.uniform(low, high)];
        // Nothing sampled depends on the load: all loads of a seed share boxes and start.
        let (empty_kg, friction) = (both(0.14, 0.18), both(0.35, 0.45));
        Self {
            load,
            empty_kg,
            friction,
            kinetic_share: sampler.uniform(0.8, 0.95),
            aside_m: sampler.uniform(-0.02, 0.02),
            yaw_rad: sampler.uniform(-0.05, 0.05),
            tyre_friction: sampler.uniform(0.6, 0.8),
            spring: sampler.uniform(0.95, 1.05),
            hysteresis_rad: sampler.uniform(0.01, 0.05),
            late_s: 0.2,
            every_s: 0.2,
            waits_s: 0.3 + sampler.uniform(0.0, 0.2),
            seed,
        }
    }

    /// Puts the boxes into the world, in front of a robot whose nose at rest is `nose_m` ahead of its origin.
    pub fn put_boxes(&self, nose_m: f64, scene: &mut Scene) -> Result<(), String> {
        // The robot's file may have boxes of its own.
        scene.clear_boxes();
        for (number, side) in [1.0, -1.0].into_iter().enumerate() {
            let spec = BoxSpec {
                size_m: BOX_M,
                mass_kg: self.empty_kg[number] + self.load.contents_kg(),
                friction: self.friction[number],
                kinetic_share: self.kinetic_share,
            };
            let x_m = nose_m + AHEAD_M + 0.5 * BOX_M[0];
            let pose = Pose { x_m, y_m: side * 0.5 * (GAP_M + BOX_M[1]), yaw_rad: 0.0 };
            scene.add_box(spec, pose).map_err(|why| why.to_string())?;
        }
        Ok(())
    }

    /// The robot of `nominal` in this case, at its start.
    ///
    /// # Errors
    /// The reason in words when the changed body is not valid.
    pub fn body(&self, nominal: &Deformable) -> Result<Deformable, String> {
        let base = nominal.base().changed(|_: &mut Chassis, wheels| {
            for tyre in wheels.iter_mut().filter_map(|wheel| wheel.tyre.as_mut()) {
                tyre.friction = self.tyre_friction;
            }
        });
        let whiskers = Whiskers {
            stiffness_nm_per_rad: nominal.whiskers().stiffness_nm_per_rad * self.spring,
            hysteresis_rad: self.hysteresis_rad,
            late_s: self.late_s,
            every_s: self.every_s,
            seed: self.seed,
            ..*nominal.whiskers()
        };
        let base = base.map_err(|why| why.to_string())?;
        let mut body = Deformable::new(base, *nominal.shell(), whiskers).map_err(|why| why.to_string())?;
        r4_world::Body::set_pose(&mut body, self.start());
        Ok(body)
    }

    /// Pose of the robot's middle at the start.
    #[must_use]
    pub fn start(&self) -> Pose {
        Pose { x_m: 0.0, y_m: self.aside_m, yaw_rad: self.yaw_rad }
    }

    /// Returns the function by which a rig changes its robot to this case.
    ///
    /// # Errors
    /// The reason in words: the robot has no shell, or the changed body is not valid.
    pub fn altered(&self, robot: &Robot) -> Result<Alter, String> {
        let nominal = shell_of(robot)?;
        // Built outside the closure, so that an invalid case is an error here.
        let body = self.body(nominal)?;
        let nose_m = 0.5 * nominal.shell().length_m(nominal.shell().rest_rad);
        let mut scene = robot.simulation.scene.clone();
        self.put_boxes(nose_m, &mut scene)?;
        Ok(Rc::new(move |robot| {
            robot.simulation.scene.clone_from(&scene);
            if let Some(simulated) = &mut robot.simulation.body {
                simulated.kind = AnyBody::Deformable(Box::new(body.clone()));
            }
        }))
    }
}

/// The shell, wheels and whiskers of a robot; an error in words when it has none.
pub(super) fn shell_of(robot: &Robot) -> Result<&Deformable, String> {
    match robot.simulation.body.as_ref().map(|body| &body.kind) {
        Some(AnyBody::Deformable(body)) => Ok(body),
        _ => Err("it has no [body.deformable]".into()),
    }
}

/// Analog input of one whisker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Magnet {
    /// Channel of the input.
    pub channel: ChannelId,
    /// Voltage while the whisker is free, V.
    pub zero_v: f64,
    /// Gain for backward bends, V/rad.
    pub v_per_rad: f64,
}

/// Channels and datasheet values that a program knows of its robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// Channel of the servo that narrows the shell.
    pub servo: ChannelId,
    /// Largest angle of the servo, rad; the shell is at rest at 0.
    pub servo_max_rad: f64,
    /// Rated speed of the servo, rad/s.
    pub servo_rad_s: f64,
    /// Wheels, one on each side.
    pub drive: SkidSteer,
    /// Analog inputs of the left and right whisker.
    pub magnets: [Magnet; 2],
    /// Delay from a change of a whisker's shown value until the program knows it, s.
    pub settles_s: f64,
    /// Geometry of the shell.
    pub shell: Shell,
    /// Geometry and sampling of the whiskers.
    pub whiskers: Whiskers,
}

/// Delay on a board, s: two samples of 10 ms until the input of its low-pass is constant again.
const SETTLES_S: f64 = 0.02;

impl Setup {
    /// Reads the setup of a robot.
    ///
    /// # Errors
    /// The part that the robot lacks, in words.
    pub fn of(robot: &Robot) -> Result<Self, String> {
        let body = shell_of(robot)?;
        let channels = robot.simulation.body.as_ref().map_or(&[][..], |body| &body.channels);
        let servo = *channels.get(body.shell().shaft).ok_or("its shell has no servo")?;
        let config = robot.config.servos.iter().find(|config| config.id == servo).ok_or("its shell has no servo")?;
        let Some(Drive::SkidSteer(drive)) = &robot.drive else { return Err("it has no [drive.skid-steer]".into()) };
        let magnet = |number: usize| {
            let of = |analog: &r4_boards::SimulatedAnalog| {
                let reads = analog.reads.filter(|reads| reads.number == number)?;
                Some(Magnet { channel: analog.channel, zero_v: reads.zero, v_per_rad: reads.per_unit })
            };
            let found = robot.simulation.analogs.iter().find_map(of);
            found.ok_or_else(|| format!("no analog input reads whisker {number}"))
        };
        Ok(Self {
            servo,
            servo_max_rad: f64::from(config.low.angle_rad.max(config.high.angle_rad)),
            servo_rad_s: f64::from(config.speed_max),
            drive: drive.clone(),
            magnets: [magnet(0)?, magnet(1)?],
            settles_s: SETTLES_S,
            shell: *body.shell(),
            whiskers: *body.whiskers(),
        })
    }

    /// Servo angle, rad, for an angle of the front panels, rad, limited to the servo's travel.
    #[must_use]
    pub fn servo_rad(&self, panels_rad: f64) -> f64 {
        ((panels_rad - self.shell.rest_rad) / self.shell.per_rad).clamp(0.0, self.servo_max_rad)
    }
}
