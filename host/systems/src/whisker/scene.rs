//! Boxes and robots that the study samples, and what a program knows of the robot.

use std::rc::Rc;

use r4_boards::{Drive, Robot, SkidSteer};
use r4_protocol::ChannelId;
use r4_rig::Alter;
use r4_world::{AnyBody, BoxSpec, Chassis, Deformable, Pose, Scene, Shell, Whiskers};

use crate::Sampler;

/// Purpose of random numbers.
const OF_CASE: u64 = 1;

/// Along the way and across it, m: printed are 22 x 16.5 x 11.5 cm; that the long side is across is our choice.
pub const BOX_M: [f64; 2] = [0.165, 0.22];
/// Between the boxes, m: printed.
pub const GAP_M: f64 = 0.24;
/// From the nose at rest to the boxes, m: printed.
pub const AHEAD_M: f64 = 0.20;
/// Way after which the side panels, half a panel of 0.21 m before and behind the middle, are past the boxes' far faces, m.
pub const PASSED_M: f64 = 0.21 + AHEAD_M + BOX_M[0] + 0.105;
/// Time of a trial, s: printed.
pub const TRIAL_S: f64 = 5.0;

/// What is in the boxes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Load {
    /// Nothing.
    Light,
    /// 100 g.
    Moderate,
    /// 10 kg.
    Heavy,
}

impl Load {
    /// All, from light to heavy.
    pub const ALL: [Self; 3] = [Self::Light, Self::Moderate, Self::Heavy];

    /// Contents, kg: printed.
    #[must_use]
    pub const fn contents_kg(self) -> f64 {
        match self {
            Self::Light => 0.0,
            Self::Moderate => 0.1,
            Self::Heavy => 10.0,
        }
    }

    /// Name in metrics.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Light => "light",
            Self::Moderate => "moderate",
            Self::Heavy => "heavy",
        }
    }
}

/// A robot before two boxes. [`About::sampled`](crate::About::sampled) has the ranges.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Case {
    /// What both boxes hold.
    pub load: Load,
    /// Mass of the empty boxes, left and right, kg.
    pub empty_kg: [f64; 2],
    /// Their static friction.
    pub friction: [f64; 2],
    /// Kinetic friction as a share of it.
    pub kinetic_share: f64,
    /// How far the robot starts to the left of the gap's middle, m.
    pub aside_m: f64,
    /// Its heading at first, rad.
    pub yaw_rad: f64,
    /// Friction of its tyres.
    pub tyre_friction: f64,
    /// Of the whiskers' springs and its file's.
    pub spring: f64,
    /// Play of the whiskers' magnets, rad.
    pub hysteresis_rad: f64,
    /// Dead time and period of the whiskers' samples, s.
    pub late_s: f64,
    /// s
    pub every_s: f64,
    /// Time at rest before the start, s: where in the period of the samples it falls.
    pub waits_s: f64,
    /// Of the whiskers' noise.
    pub seed: u64,
}

impl Case {
    /// The case of a seed with boxes of one load; masses, friction and the start are the same for all loads.
    #[must_use]
    pub fn of(seed: u64, load: Load) -> Self {
        let mut sampler = Sampler::new(seed, OF_CASE);
        let mut both = |low: f64, high: f64| [sampler.uniform(low, high), sampler.uniform(low, high)];
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

    /// The boxes in the world, before a robot whose nose at rest is so far ahead of its origin, m.
    pub fn put_boxes(&self, nose_m: f64, scene: &mut Scene) -> Result<(), String> {
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

    /// The robot of `nominal` in this case, where it starts.
    ///
    /// # Errors
    /// Why it cannot be computed.
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

    /// Where the robot's middle is at first.
    #[must_use]
    pub fn start(&self) -> Pose {
        Pose { x_m: 0.0, y_m: self.aside_m, yaw_rad: self.yaw_rad }
    }

    /// What a rig does to a robot to make it this case.
    ///
    /// # Errors
    /// What the robot's file has in place of a shell, or why it cannot be computed.
    pub fn altered(&self, robot: &Robot) -> Result<Alter, String> {
        let nominal = shell_of(robot)?;
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

/// The shell, wheels and whiskers of a robot.
pub(super) fn shell_of(robot: &Robot) -> Result<&Deformable, String> {
    match robot.simulation.body.as_ref().map(|body| &body.kind) {
        Some(AnyBody::Deformable(body)) => Ok(body),
        _ => Err("it has no [body.deformable]".into()),
    }
}

/// A whisker's analog input.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Magnet {
    /// The input.
    pub channel: ChannelId,
    /// Volts while the whisker is free.
    pub zero_v: f64,
    /// Volts for each radian that it is bent backwards.
    pub v_per_rad: f64,
}

/// What a program knows of a robot: its data sheet.
#[derive(Clone, Debug, PartialEq)]
pub struct Setup {
    /// What narrows the shell.
    pub servo: ChannelId,
    /// Its last angle, rad; the shell is at rest at 0.
    pub servo_max_rad: f64,
    /// How fast it turns, rad/s.
    pub servo_rad_s: f64,
    /// Its wheels, one on each side.
    pub drive: SkidSteer,
    /// Left and right.
    pub magnets: [Magnet; 2],
    /// From a change of what a whisker shows until the program knows it, s.
    pub settles_s: f64,
    /// The shell.
    pub shell: Shell,
    /// The whiskers.
    pub whiskers: Whiskers,
}

/// On a board: two samples of 10 ms until the input of its low-pass is level again.
const SETTLES_S: f64 = 0.02;

impl Setup {
    /// That of a robot.
    ///
    /// # Errors
    /// What the robot lacks.
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

    /// Angle of the servo at which the front panels have an angle, rad, within the servo's travel.
    #[must_use]
    pub fn servo_rad(&self, panels_rad: f64) -> f64 {
        ((panels_rad - self.shell.rest_rad) / self.shell.per_rad).clamp(0.0, self.servo_max_rad)
    }
}
