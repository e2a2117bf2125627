//! One robot: what is plugged into a carrier, how it is controlled, and what the simulator takes for true.

mod body;
mod drive;
mod field;
mod input;
mod motor;
mod output;
mod read;
mod sensor;
mod simulation;
mod uart;

use r4_protocol::{channel::ChannelId, config::BoardConfig};
use r4_world::{AnyBody, Field, Pose, Scene};

pub(crate) use body::{read_body, read_environment, read_world};
pub use drive::{Ackermann, Drive, SkidSteer, SteeringLaw};
pub use field::{FieldReading, SelfCharge};
pub(crate) use read::read;
pub use sensor::{SimulatedAngle, SimulatedCurrent, SimulatedDistance, SimulatedForce, SimulatedImu, SimulatedPulses};
pub use uart::{GnssOrigin, SimulatedGnss, SimulatedUart, UartDevice};

use crate::carrier::Carrier;

/// A robot that has been read and checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Robot {
    /// The file it comes from.
    pub file: String,
    /// What the firmware is told.
    pub config: BoardConfig,
    /// How it moves over the ground; `None` for one that does not.
    pub drive: Option<Drive>,
    /// What the simulator takes for true; empty when the file has no `[simulation]`.
    pub simulation: Simulation,
    /// The carrier it is built on.
    pub carrier: Carrier,
}

/// The true world, of which the firmware knows only what it measures.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Simulation {
    /// One for each motor of the robot, in the order of [`BoardConfig::motors`].
    pub motors: Vec<SimulatedMotor>,
    /// One for each supply of the robot, in the order of [`BoardConfig::supplies`].
    pub rails: Vec<SimulatedRail>,
    /// True frequency of the servo chip's oscillator, Hz.
    pub servo_oscillator_hz: f64,
    /// One for each servo, in the order of [`BoardConfig::servos`].
    pub servos: Vec<SimulatedServo>,
    /// One for each brushless drive, in the order of [`BoardConfig::bldcs`].
    pub bldcs: Vec<SimulatedBldc>,
    /// One for each stepper, in the order of [`BoardConfig::steppers`].
    pub steppers: Vec<SimulatedStepper>,
    /// One for each range sensor, in the order of [`BoardConfig::ranges`].
    pub ranges: Vec<SimulatedRange>,
    /// One for each analog input, in the order of [`BoardConfig::analogs`].
    pub analogs: Vec<SimulatedAnalog>,
    /// One for each switch, in the order of [`BoardConfig::switches`].
    pub switches: Vec<SimulatedSwitch>,
    /// One for each IMU.
    pub imus: Vec<SimulatedImu>,
    /// One for each current monitor.
    pub currents: Vec<SimulatedCurrent>,
    /// One for each angle sensor.
    pub angles: Vec<SimulatedAngle>,
    /// One for each load cell.
    pub forces: Vec<SimulatedForce>,
    /// One for each optical distance sensor.
    pub distances: Vec<SimulatedDistance>,
    /// Angle sensors that send pulses to range connectors.
    pub pulses: Vec<SimulatedPulses>,
    /// Sensors at the UART connectors.
    pub uarts: Vec<SimulatedUart>,
    /// What couples motors; `None` lets each turn alone.
    pub body: Option<SimulatedBody>,
    /// What is around the body.
    pub scene: Scene,
    /// What sensors on the body read by place, at time 0.
    pub fields: Vec<Field>,
}

/// A sensor names a field that its world does not have.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{channel} reads the field `{asked}`, and the world has {}: name one of these, or use another world", known.join(", "))]
pub struct NoSuchField {
    /// Channel of the sensor.
    pub channel: ChannelId,
    /// The field that it names.
    pub asked: String,
    /// The fields that there are.
    pub known: Vec<String>,
}

/// What a robot is put into.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct World {
    /// Where the body stands at time 0.
    pub start: Pose,
    /// Whether it stands on a stand instead, its wheels in the air.
    pub on_stand: bool,
    /// What is around it.
    pub scene: Scene,
    /// What it has at every place.
    pub fields: Vec<Field>,
}

/// A body, at rest where it starts.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulatedBody {
    /// The physics.
    pub kind: AnyBody,
    /// The channels whose shafts it couples, in the order of its shafts.
    pub channels: Vec<ChannelId>,
}

/// Where a sensor sits on a body, in the body's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mount {
    /// m
    pub place_m: [f64; 2],
    /// Where it looks, counterclockwise from forwards, rad.
    pub yaw_rad: f64,
}

/// An RC servo.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedServo {
    /// Channel of the simulated part.
    pub channel: ChannelId,
    /// Pulse at one end of its travel, s.
    pub pulse_min_s: f64,
    /// Pulse at the other end, s.
    pub pulse_max_s: f64,
    /// Angle at the shorter pulse, rad.
    pub angle_min_rad: f64,
    /// Angle at the longer pulse, rad.
    pub angle_max_rad: f64,
    /// How fast it turns, rad/s.
    pub rate_rad_s: f64,
}

/// A brushless drive with its motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedBldc {
    /// Channel of the simulated part.
    pub channel: ChannelId,
    /// Where it stands still, V: both ends.
    pub dead_zone_v: [f64; 2],
    /// Full speed forwards, V.
    pub forward_v: f64,
    /// Full speed backwards, V, where a voltage reverses it.
    pub reverse_v: Option<f64>,
    /// rad/s
    pub top_speed_rad_s: f64,
    /// s
    pub time_constant_s: f64,
    /// Whether it brakes and holds by its motor, in place of coasting in the dead zone and before it turns round.
    pub four_quadrant: bool,
    /// What makes its motor take loads; `None` for one that turns as its drive wants.
    pub rotor: Option<SimulatedRotor>,
    /// What measures its shaft, if anything does.
    pub encoder: Option<SimulatedEncoder>,
}

/// Inertia of a brushless motor and what its drive can do to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedRotor {
    /// Of the motor and of what turns with it, kg m².
    pub inertia_kg_m2: f64,
    /// Highest torque of the drive, in both directions, N m.
    pub torque_max_nm: f64,
    /// Highest mechanical power that the drive gives, W; infinite for none.
    pub power_max_w: f64,
    /// Torque of the brake, N m.
    pub brake_nm: f64,
}

/// A quadrature encoder on a shaft.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SimulatedEncoder {
    /// Number of its encoder connector on the carrier, from 0.
    pub input: u8,
    /// Lines in one turn; four counts each.
    pub lines_per_turn: u32,
}

/// A stepper motor with its driver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedStepper {
    /// Channel of the simulated part.
    pub channel: ChannelId,
    /// Highest rate at which it starts and stops without losing steps, Hz.
    pub start_rate_hz: f64,
}

/// What is in front of a range sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedRange {
    /// Channel of the simulated part.
    pub channel: ChannelId,
    /// What it sees.
    pub sees: RangeView,
}

/// What a range sensor sees.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RangeView {
    /// Something at a distance that stays, m.
    Constant {
        /// m
        distance_m: f64,
    },
    /// The world, from a place on the body.
    World(Mount),
}

/// What is at an analog input.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulatedAnalog {
    /// Channel of the simulated part.
    pub channel: ChannelId,
    /// V
    pub volts: f64,
    /// True volts for one code of the 16-bit converter.
    pub volts_per_code: f64,
    /// Noise, standard deviation in codes of the 16-bit converter.
    pub noise_rms_codes: f64,
    /// What of the body is measured here, in volts; `None` for a constant voltage.
    pub reads: Option<BodyReading>,
    /// The field that is measured here, in place of both; `None` for none.
    pub field: Option<FieldReading>,
}

/// A sensor that measures something of the body: `zero + per_unit * reading`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyReading {
    /// Number of the quantity among `r4_world::Body::readings`.
    pub number: usize,
    /// What the sensor gives where the quantity is 0, in the unit that it gives.
    pub zero: f64,
    /// What it gives for one unit of the quantity.
    pub per_unit: f64,
}

/// What closes a switch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedSwitch {
    /// Channel of the simulated part.
    pub channel: ChannelId,
    /// The axis or the quantity of the body that closes it.
    pub closed_by: SwitchedBy,
}

/// What closes a switch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SwitchedBy {
    /// An input that is always open: no axis or body reaches the switch.
    Nothing,
    /// A motor or stepper.
    Axis {
        /// Channel of the motor or stepper.
        channel: ChannelId,
        /// Closed below this position, rad. A stepper's is counted from where it stands at time 0.
        below: f64,
    },
    /// A quantity of the body: closed where this is positive.
    Body(BodyReading),
}

impl Simulation {
    /// Whether the robot's file says nothing about the true world, so that it can only be used as hardware.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Checks that the world has the fields that sensors name. A world without any field is right for all: there is nothing in it.
    ///
    /// # Errors
    /// [`NoSuchField`], the first that is not there.
    pub fn check_fields(&self) -> Result<(), NoSuchField> {
        let has = |reading: &&FieldReading| !self.fields.iter().any(|field| field.name == reading.name);
        let sensors = self.analogs.iter().filter_map(|analog| Some((analog.channel, analog.field.as_ref()?)));
        match sensors.into_iter().find(|(_, reading)| !self.fields.is_empty() && has(reading)) {
            None => Ok(()),
            Some((channel, reading)) => Err(NoSuchField {
                channel,
                asked: reading.name.clone(),
                known: self.fields.iter().map(|field| field.name.clone()).collect(),
            }),
        }
    }

    /// Gives the robot another body, at rest where the one before it stood.
    pub fn set_body(&mut self, mut body: SimulatedBody) {
        if let Some(before) = &self.body {
            body.kind.set_pose(before.kind.pose());
        }
        self.body = Some(body);
    }

    /// Puts the robot into a world, in place of the one it was in.
    pub fn enter(&mut self, world: World) {
        self.scene = world.scene;
        self.fields = world.fields;
        if world.on_stand {
            self.body = None;
        }
        if let Some(body) = &mut self.body {
            body.kind.set_pose(world.start);
        }
    }
}

/// A motor with what it drives.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulatedMotor {
    /// The channel whose bridge drives it; the carrier has the bridge's lines.
    pub channel: ChannelId,
    /// Its physics.
    pub plant: PlantFile,
    /// The rail that feeds its bridge, one of [`Simulation::rails`].
    pub rail: ChannelId,
    /// Where it stands at time 0, rad or m.
    pub start: f64,
    /// What measures it, if anything does; an angle sensor is in [`Simulation::angles`].
    pub sensor: Option<SimulatedSensor>,
    /// A second encoder, on the motor's side of its plant's backlash and compliance.
    pub motor_side: Option<SimulatedEncoder>,
}

/// A plant file, not looked into here.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlantFile {
    /// Where it was found.
    pub name: String,
    /// Its text.
    pub text: String,
}

/// What measures a simulated motor, and where it is plugged in.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SimulatedSensor {
    /// Quadrature encoder on the output shaft.
    Encoder {
        /// Number of its encoder connector on the carrier, from 0.
        input: u8,
        /// Lines in one turn; four counts each.
        lines_per_turn: u32,
    },
    /// Potentiometer between the converter's reference and ground.
    Potentiometer {
        /// Which analog input.
        input: u8,
        /// One end of the stroke.
        low: TruePoint,
        /// The other end of the stroke.
        high: TruePoint,
        /// Noise, standard deviation in codes of the 16-bit converter.
        noise_rms_codes: f64,
    },
}

/// What a potentiometer really gives at a position.
#[derive(Clone, Copy, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TruePoint {
    /// Reading of an ideal 10-bit converter, 0 to 1023.
    #[serde(deserialize_with = "crate::number::code_10bit")]
    pub code_10bit: f64,
    /// Position there, m.
    #[serde(deserialize_with = "crate::number::finite")]
    pub position_m: f64,
}

impl TruePoint {
    /// Share of the reference voltage, 0 to 1.
    #[must_use]
    pub fn share(self) -> f64 {
        self.code_10bit / 1023.0
    }
}

/// A supply rail.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedRail {
    /// The channel that measures it.
    pub channel: ChannelId,
    /// Which analog input it is wired to.
    pub analog: u8,
    /// True volts for one code of the 16-bit converter.
    pub volts_per_code: f64,
    /// Voltage without load.
    pub emf_v: f64,
    /// Resistance of the source.
    pub resistance_ohm: f64,
    /// Of a source that takes nothing back, F; `None` for a battery.
    pub capacitance_f: Option<f64>,
    /// Noise, standard deviation in codes of the 16-bit converter.
    pub noise_rms_codes: f64,
}
