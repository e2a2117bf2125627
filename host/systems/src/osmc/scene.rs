//! Plants that the study samples: each of the three motors has one hidden effect or none.

use std::rc::Rc;

use r4_blind::{Among, NotHidden, Truth, hide_one_of};
use r4_boards::{PlantFile, Robot};
use r4_plants::{Drive, Plant, PlantKind, PlantSpec};
use r4_protocol::config::Feedback;
use r4_rig::{Alter, motor_plants};

use super::bench::{self, Bench};
use super::calibration::Calibration;

/// Effects that may be hidden, with the scale of their sizes: not obvious to an observer.
pub const AMONG: [Among; 7] = [
    Among { effect: "coulomb-friction", size: 0.4 },
    Among { effect: "static-friction", size: 0.4 },
    Among { effect: "dead-zone", size: 0.25 },
    Among { effect: "backlash", size: 0.1 },
    Among { effect: "supply-sag", size: 1.0 },
    Among { effect: "encoder-offset", size: 1.0 },
    Among { effect: "encoder-scale", size: 1.0 },
];

/// Longest time in which a rotary plant turns by the step of Tables 3 to 5 at the duty clip, s: below the 2.75 s of the
/// paper's fastest row, which otherwise no controller could reach.
const STEP_S: [f64; 2] = [1.0, 2.5];
/// Least speed of the actuator at its clip, m/s: a tenth above that of its profile.
const LINEAR_M_S: f64 = 6.6e-3;
/// Time step of the simulation that checks a plant, s.
const TRIED_EVERY_S: f64 = 1e-3;

/// A motor with its hidden effect.
#[derive(Clone, Debug)]
pub struct Motor {
    /// Motor of the paper.
    pub bench: Bench,
    /// Plant as the robot's file declares it.
    pub declared: PlantSpec,
    /// True plant, with the hidden effect.
    pub spec: PlantSpec,
    /// True initial position, rad or m. The zero of a rotary sensor is its position at power-on, so that its hidden
    /// offset is here.
    pub start: f64,
    /// Supply voltage of the motor, V.
    pub supply_v: f64,
    /// Speed and acceleration of the board's profile, rad/s and rad/s² or m/s and m/s².
    pub profile: [f64; 2],
    /// Hidden effect; `None` for none.
    pub truth: Option<Truth>,
}

/// Motors of a seed on one board.
#[derive(Clone, Debug)]
pub struct Scene {
    /// Motors in the order of [`bench::ALL`].
    pub motors: Vec<Motor>,
}

/// Reason why a robot has no such scene.
#[derive(Debug, thiserror::Error)]
pub enum SceneError {
    /// A motor of the paper is missing.
    #[error("its robot has no simulated motor {channel}: sim:osmc-evaluation has all three")]
    NoMotor {
        /// Channel of the missing motor.
        channel: r4_protocol::ChannelId,
    },
    /// A plant file cannot be used.
    #[error(transparent)]
    Plant(#[from] r4_plants::PlantError),
    /// An effect cannot be hidden in a plant.
    #[error(transparent)]
    NotHidden(#[from] NotHidden),
}

impl Scene {
    /// Samples the hidden effects of a robot's motors from a seed.
    ///
    /// # Errors
    /// [`SceneError::NoMotor`] for a missing motor; [`SceneError::Plant`] and [`SceneError::NotHidden`] for a plant
    /// that cannot be used.
    pub fn of(robot: &Robot, seed: u64) -> Result<Self, SceneError> {
        let plants = motor_plants(robot)?;
        let motor = |(bench, index): (Bench, u64)| {
            let channel = bench.channel;
            let plant = plants.iter().find(|plant| plant.channel == channel).ok_or(SceneError::NoMotor { channel })?;
            let (declared, supply_v) = (plant.spec.clone(), plant.supply_v);
            // The seeds of a board's motors are far apart, so that the next seed hides another effect in all of
            // them.
            let hidden =
                hide_one_of(&AMONG, &declared, supply_v, seed ^ (index << 48), &|spec| suits(spec, supply_v, &bench))?;
            let truth = hidden.truth().first().cloned();
            let offset = truth.as_ref().filter(|truth| truth.name == "encoder-offset").map(size);
            let (spec, start) = match offset {
                Some(offset) if declared.kind() == PlantKind::Rotary => (declared.clone(), -offset),
                _ => (hidden.spec().clone(), 0.0),
            };
            let configured = robot.config.motors.iter().find(|motor| motor.id == channel);
            let limits = configured.and_then(|motor| motor.control.as_ref()).map(|control| control.profile);
            let limits = limits.ok_or(SceneError::NoMotor { channel })?;
            let profile = [limits.speed.into(), limits.acceleration.into()];
            Ok(Motor { bench, profile, declared, spec, start, supply_v, truth })
        };
        let motors = bench::ALL.into_iter().zip(0u64..).map(motor).collect::<Result<_, SceneError>>()?;
        Ok(Self { motors })
    }

    /// Returns the function by which a rig changes its robot: the motors become these, the board's configuration gets
    /// `calibrations`, one for each motor.
    #[must_use]
    pub fn altered(&self, calibrations: &[Calibration], change: fn(&mut r4_boards::Robot)) -> Alter {
        let motors: Vec<(Motor, Calibration)> = self.motors.iter().cloned().zip(calibrations.iter().copied()).collect();
        Rc::new(move |robot| {
            for (Motor { bench, spec, start, .. }, calibration) in &motors {
                for simulated in robot.simulation.motors.iter_mut().filter(|motor| motor.channel == bench.channel) {
                    simulated.plant = PlantFile { name: format!("{} of a seed", bench.name), text: spec.to_toml() };
                    simulated.start = *start;
                }
                let configured = robot.config.motors.iter_mut().filter(|motor| motor.id == bench.channel);
                for control in configured.filter_map(|motor| motor.control.as_mut()) {
                    calibration.put_into(&mut control.feedback);
                    // Set points must stay within the calibrated ends.
                    if let Feedback::Potentiometer { low, high, .. } = control.feedback {
                        control.position.min = control.position.min.max(low.position_m);
                        control.position.max = control.position.max.min(high.position_m);
                    }
                }
            }
            change(robot);
        })
    }
}

/// Size of an effect with one parameter, in that parameter's unit; 0 without a parameter.
#[must_use]
pub fn size(truth: &Truth) -> f64 {
    truth.parameters.first().map_or(0.0, |parameter| parameter.value)
}

/// Returns true when the motor can still do at its duty clip what the paper's did.
fn suits(spec: &PlantSpec, supply_v: f64, bench: &Bench) -> bool {
    let mut plant = Plant::new(spec, 0);
    let duty = (bench.clip / 255.0).min(0.98);
    match (spec.kind(), bench.step) {
        (PlantKind::Rotary, Some(step_deg)) => {
            let limit_s = if bench.clip == 255.0 { STEP_S[0] } else { STEP_S[1] };
            // Full duty from rest for the time limit: the plant must turn by 99 % of the step.
            let steps = (limit_s / TRIED_EVERY_S) as usize;
            (0..steps).for_each(|_| plant.advance(Drive::with_brake(duty), supply_v, TRIED_EVERY_S));
            plant.position() >= 0.99 * step_deg.to_radians()
        }
        _ => {
            plant.set_position(0.01);
            (0..1000).for_each(|_| plant.advance(Drive::with_brake(duty), supply_v, TRIED_EVERY_S));
            plant.speed() >= LINEAR_M_S
        }
    }
}

impl Calibration {
    /// Corrects the board's configuration of a sensor that reads `gain · true + offset`.
    pub(super) fn put_into(&self, feedback: &mut Feedback) {
        match feedback {
            Feedback::Encoder { counts_per_turn, .. } => {
                *counts_per_turn = self.counts_per_turn((*counts_per_turn).into());
            }
            Feedback::Potentiometer { low, high, .. } => {
                for point in [low, high] {
                    point.position_m = ((f64::from(point.position_m) - self.offset) / self.gain) as f32;
                }
            }
            // No motor of the paper has such a sensor: it is taken as exact.
            Feedback::Angle { .. } | Feedback::Pulses { .. } => {}
        }
    }
}
