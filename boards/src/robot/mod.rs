//! Robot file: what is plugged into a carrier, how it is controlled, and the true values that the simulator uses.

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

/// Robot whose file has been read and checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Robot {
    /// File that the robot comes from.
    pub file: String,
    /// Configuration of the firmware.
    pub config: BoardConfig,
    /// Motion of the robot over the ground; `None` for one that does not move.
    pub drive: Option<Drive>,
    /// True values for the simulator; empty when the file has no `[simulation]`.
    pub simulation: Simulation,
    /// Carrier that the robot is built on.
    pub carrier: Carrier,
}

/// True values of a simulated robot and its world, of which the firmware knows only what it measures.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Simulation {
    /// Motors of the robot, in the order of [`BoardConfig::motors`].
    pub motors: Vec<SimulatedMotor>,
    /// Supplies of the robot, in the order of [`BoardConfig::supplies`].
    pub rails: Vec<SimulatedRail>,
    /// True frequency of the servo chip's oscillator, Hz.
    pub servo_oscillator_hz: f64,
    /// Servos, in the order of [`BoardConfig::servos`].
    pub servos: Vec<SimulatedServo>,
    /// Brushless drives, in the order of [`BoardConfig::bldcs`].
    pub bldcs: Vec<SimulatedBldc>,
    /// Steppers, in the order of [`BoardConfig::steppers`].
    pub steppers: Vec<SimulatedStepper>,
    /// Range sensors, in the order of [`BoardConfig::ranges`].
    pub ranges: Vec<SimulatedRange>,
    /// Analog inputs, in the order of [`BoardConfig::analogs`].
    pub analogs: Vec<SimulatedAnalog>,
    /// Switches, in the order of [`BoardConfig::switches`].
    pub switches: Vec<SimulatedSwitch>,
    /// Inertial sensors on the bus.
    pub imus: Vec<SimulatedImu>,
    /// Current monitors on the bus.
    pub currents: Vec<SimulatedCurrent>,
    /// Angle sensors on the bus.
    pub angles: Vec<SimulatedAngle>,
    /// Load cells on the bus.
    pub forces: Vec<SimulatedForce>,
    /// Optical distance sensors on the bus.
    pub distances: Vec<SimulatedDistance>,
    /// Angle sensors that send pulses to range connectors.
    pub pulses: Vec<SimulatedPulses>,
    /// Sensors at the UART connectors.
    pub uarts: Vec<SimulatedUart>,
    /// Body that couples motors; `None` lets each turn alone.
    pub body: Option<SimulatedBody>,
    /// Scene around the body.
    pub scene: Scene,
    /// Fields that sensors on the body read by place, at time 0.
    pub fields: Vec<Field>,
}

/// Error of a sensor that names a field which its world does not have.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{channel} reads the field `{asked}`, and the world has {}: name one of these, or use another world", known.join(", "))]
pub struct NoSuchField {
    /// Channel of the sensor.
    pub channel: ChannelId,
    /// Field that the sensor names.
    pub asked: String,
    /// Fields of the world.
    pub known: Vec<String>,
}

/// World that a robot is put into.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct World {
    /// Pose of the body at time 0.
    pub start: Pose,
    /// True when the body is on a stand instead, its wheels in the air.
    pub on_stand: bool,
    /// Scene around the body.
    pub scene: Scene,
    /// Fields of the world, which have a value at every place.
    pub fields: Vec<Field>,
}

/// Body at rest in its initial pose.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulatedBody {
    /// Type and parameters of the body.
    pub kind: AnyBody,
    /// Channels whose shafts the body couples, in the order of its shafts.
    pub channels: Vec<ChannelId>,
}

/// Place and direction of a sensor on a body, in the body's frame.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Mount {
    /// Place in the body's frame, x forwards and y to the left, m.
    pub place_m: [f64; 2],
    /// Direction of view, counter-clockwise from forwards, rad.
    pub yaw_rad: f64,
}

/// RC servo with its true travel.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedServo {
    /// Channel of the servo.
    pub channel: ChannelId,
    /// Pulse at one end of the travel, s.
    pub pulse_min_s: f64,
    /// Pulse at the other end, s; longer than `pulse_min_s`.
    pub pulse_max_s: f64,
    /// Angle at the shorter pulse, rad.
    pub angle_min_rad: f64,
    /// Angle at the longer pulse, rad.
    pub angle_max_rad: f64,
    /// Speed of the servo, rad/s.
    pub rate_rad_s: f64,
}

/// Brushless drive with its motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedBldc {
    /// Channel of the drive.
    pub channel: ChannelId,
    /// Voltages between which the drive stands still, V: both ends.
    pub dead_zone_v: [f64; 2],
    /// Voltage of full speed forwards, V.
    pub forward_v: f64,
    /// Voltage of full speed backwards, V; `None` where no voltage reverses the drive.
    pub reverse_v: Option<f64>,
    /// Full speed of the shaft, rad/s.
    pub top_speed_rad_s: f64,
    /// Time constant of the speed, s.
    pub time_constant_s: f64,
    /// True when the drive brakes and holds by its motor; otherwise it coasts in the dead zone and before it turns
    /// round.
    pub four_quadrant: bool,
    /// Inertia that makes the motor take loads; `None` for a motor that turns as its drive commands.
    pub rotor: Option<SimulatedRotor>,
    /// Encoder on the shaft, if there is one.
    pub encoder: Option<SimulatedEncoder>,
}

/// Inertia of a brushless motor, and the limits of its drive.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedRotor {
    /// Inertia of the motor and of what turns with it, kg m².
    pub inertia_kg_m2: f64,
    /// Highest torque of the drive, in both directions, N m.
    pub torque_max_nm: f64,
    /// Highest mechanical power of the drive, W; infinite for no limit.
    pub power_max_w: f64,
    /// Torque of the brake, N m.
    pub brake_nm: f64,
}

/// Quadrature encoder on a shaft.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SimulatedEncoder {
    /// Number of its encoder connector on the carrier, from 0.
    pub input: u8,
    /// Lines in one turn, with four counts each.
    pub lines_per_turn: u32,
}

/// Stepper motor with its driver.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedStepper {
    /// Channel of the stepper.
    pub channel: ChannelId,
    /// Highest rate at which it starts and stops without losing steps, Hz.
    pub start_rate_hz: f64,
}

/// Range sensor with what is in front of it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedRange {
    /// Channel of the range sensor.
    pub channel: ChannelId,
    /// Object or world in front of the sensor.
    pub sees: RangeView,
}

/// Object or world in front of a range sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RangeView {
    /// Object at a constant distance.
    Constant {
        /// Distance of the object, m.
        distance_m: f64,
    },
    /// World, as seen from a place on the body.
    World(Mount),
}

/// Analog input with its source.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulatedAnalog {
    /// Channel of the analog input.
    pub channel: ChannelId,
    /// Voltage of a constant source, V.
    pub volts: f64,
    /// True volts for one code of the 16-bit converter.
    pub volts_per_code: f64,
    /// Noise, standard deviation in codes of the 16-bit converter.
    pub noise_rms_codes: f64,
    /// Quantity of the body that is measured here, in volts; `None` for a constant voltage.
    pub reads: Option<BodyReading>,
    /// Field that is measured here, in place of both; `None` for none.
    pub field: Option<FieldReading>,
}

/// Sensor that measures a quantity of the body: `zero + per_unit * reading`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BodyReading {
    /// Number of the quantity among `r4_world::Body::readings`.
    pub number: usize,
    /// Output of the sensor where the quantity is 0, in the sensor's unit.
    pub zero: f64,
    /// Output of the sensor for one unit of the quantity.
    pub per_unit: f64,
}

/// Switch with the axis or the quantity that closes it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedSwitch {
    /// Channel of the switch.
    pub channel: ChannelId,
    /// Axis or quantity of the body that closes the switch.
    pub closed_by: SwitchedBy,
}

/// Axis or quantity of the body that closes a switch.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SwitchedBy {
    /// An input that is always open: no axis or body reaches the switch.
    Nothing,
    /// A motor or stepper, below a position.
    Axis {
        /// Channel of the motor or stepper.
        channel: ChannelId,
        /// Position below which the switch is closed, rad. A stepper's is counted from where it is at time 0.
        below: f64,
    },
    /// A quantity of the body: the switch is closed where the result is positive.
    Body(BodyReading),
}

impl Simulation {
    /// Returns whether the robot's file has no true values, so that it can only be used as hardware.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        *self == Self::default()
    }

    /// Checks that the world has the fields that sensors name. A world without any field passes: it is empty.
    ///
    /// # Errors
    /// [`NoSuchField`] for the first field that does not exist.
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

    /// Gives the robot another body, at rest in the pose of the previous one.
    pub fn set_body(&mut self, mut body: SimulatedBody) {
        if let Some(before) = &self.body {
            body.kind.set_pose(before.kind.pose());
        }
        self.body = Some(body);
    }

    /// Puts the robot into a world, in place of the previous one.
    pub fn enter(&mut self, world: World) {
        self.scene = world.scene;
        self.fields = world.fields;
        // On a stand the wheels touch nothing, so that each motor turns alone.
        if world.on_stand {
            self.body = None;
        }
        if let Some(body) = &mut self.body {
            body.kind.set_pose(world.start);
        }
    }
}

/// Motor with the plant that it drives.
#[derive(Clone, Debug, PartialEq)]
pub struct SimulatedMotor {
    /// Channel whose bridge drives the motor; the carrier has the bridge's lines.
    pub channel: ChannelId,
    /// Plant file of the motor.
    pub plant: PlantFile,
    /// Rail that feeds the bridge, one of [`Simulation::rails`].
    pub rail: ChannelId,
    /// Position at time 0, rad or m.
    pub start: f64,
    /// Sensor of the position, if there is one; angle sensors are in [`Simulation::angles`].
    pub sensor: Option<SimulatedSensor>,
    /// Second encoder, on the motor's side of its plant's backlash and compliance.
    pub motor_side: Option<SimulatedEncoder>,
}

/// Plant file, not parsed here.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PlantFile {
    /// Name of the file, as it was found.
    pub name: String,
    /// Text of the file.
    pub text: String,
}

/// Sensor of a simulated motor, and its connector.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SimulatedSensor {
    /// Quadrature encoder on the output shaft.
    Encoder {
        /// Number of its encoder connector on the carrier, from 0.
        input: u8,
        /// Lines in one turn, with four counts each.
        lines_per_turn: u32,
    },
    /// Potentiometer between the converter's reference and ground.
    Potentiometer {
        /// Number of the analog input.
        input: u8,
        /// Point at one end of the stroke.
        low: TruePoint,
        /// Point at the other end of the stroke.
        high: TruePoint,
        /// Noise, standard deviation in codes of the 16-bit converter.
        noise_rms_codes: f64,
    },
}

/// True reading of a potentiometer at a position.
#[derive(Clone, Copy, Debug, PartialEq, serde::Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TruePoint {
    /// Reading of an ideal 10-bit converter, 0 to 1023.
    #[serde(deserialize_with = "crate::number::code_10bit")]
    pub code_10bit: f64,
    /// Position of the reading, m.
    #[serde(deserialize_with = "crate::number::finite")]
    pub position_m: f64,
}

impl TruePoint {
    /// Returns the share of the reference voltage, 0 to 1.
    #[must_use]
    pub fn share(self) -> f64 {
        self.code_10bit / 1023.0
    }
}

/// Supply rail with its source.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SimulatedRail {
    /// Channel that measures the rail.
    pub channel: ChannelId,
    /// Number of the analog input that it is wired to.
    pub analog: u8,
    /// True volts for one code of the 16-bit converter.
    pub volts_per_code: f64,
    /// Voltage without load, V.
    pub emf_v: f64,
    /// Resistance of the source, ohm.
    pub resistance_ohm: f64,
    /// Capacitance of a source that takes no current back, F; `None` for a battery.
    pub capacitance_f: Option<f64>,
    /// Noise, standard deviation in codes of the 16-bit converter.
    pub noise_rms_codes: f64,
}
