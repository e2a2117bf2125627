//! Table `[simulation]`: the true values that the simulator uses. The robot's configuration is the default of each.

use std::fmt::Display;

use r4_protocol::{
    channel::{ChannelId, ChannelKind},
    config::{
        AnalogConfig, BldcConfig, BoardConfig, Feedback, MotorConfig, RangeConfig, Reverse, SensorChip, SensorConfig,
        ServoConfig, StepperConfig, SupplyConfig, SwitchConfig,
    },
};
use r4_world::Scene;
use serde::Deserialize;

use super::{
    BodyReading, PlantFile, RangeView, SimulatedAnalog, SimulatedAngle, SimulatedBldc, SimulatedCurrent,
    SimulatedDistance, SimulatedEncoder, SimulatedForce, SimulatedImu, SimulatedMotor, SimulatedPulses, SimulatedRail,
    SimulatedRange, SimulatedRotor, SimulatedSensor, SimulatedServo, SimulatedStepper, SimulatedSwitch, Simulation,
    SwitchedBy, TruePoint,
    body::{Body, MountTable},
    field::ReadingTable,
    output::NOMINAL_OSCILLATOR_HZ,
    read::Reader,
    uart::{self, GnssTable, LidarTable},
};
use crate::{
    error::BoardError,
    number::{
        Interval, channel, finite, not_negative, optional_channel, optional_finite, optional_not_negative,
        optional_oscillator_hz, optional_positive,
    },
    source::{Claims, Folder},
};

/// Noise of the 16-bit converter with 13 effective bits: 2^3 / sqrt(12). Our choice.
const NOISE_RMS_CODES: f64 = 2.3;
/// Resistance of a supply, ohm: our choice.
const RAIL_OHM: f64 = 0.1;
/// Half the width of a brushless drive's dead zone, V: our choice.
const DEAD_ZONE_V: f64 = 0.05;
/// Full speed of a brushless drive, rad/s: our choice.
const BLDC_TOP_SPEED_RAD_S: f64 = 100.0;
/// Time constant of a brushless drive, s: our choice.
const BLDC_TIME_CONSTANT_S: f64 = 0.2;
/// Highest start speed of a stepper, as a multiple of the configured one: our choice.
const START_MARGIN: f64 = 2.0;
const WHOLE_LINES: &str = "counts_per_turn of the robot is no multiple of 4: say the encoder's lines_per_turn";
/// Lowest start rate of a stepper, Hz: our choice.
const START_RATE_MIN_HZ: f64 = 100.0;

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Tables {
    #[serde(default, deserialize_with = "optional_oscillator_hz")]
    servo_oscillator_hz: Option<f64>,
    #[serde(default)]
    rotary: Vec<Rotary>,
    #[serde(default)]
    linear: Vec<Linear>,
    #[serde(default)]
    rail: Vec<Rail>,
    #[serde(default)]
    servo: Vec<Servo>,
    #[serde(default)]
    bldc: Vec<Bldc>,
    #[serde(default)]
    stepper: Vec<Stepper>,
    #[serde(default)]
    range: Vec<Range>,
    #[serde(default)]
    analog: Vec<Analog>,
    #[serde(default)]
    switch: Vec<Switch>,
    #[serde(default)]
    imu: Vec<SimulatedImu>,
    #[serde(default)]
    current: Vec<SimulatedCurrent>,
    #[serde(default)]
    angle: Vec<SimulatedAngle>,
    #[serde(default)]
    force: Vec<Force>,
    #[serde(default)]
    distance: Vec<Distance>,
    #[serde(default)]
    pulses: Vec<SimulatedPulses>,
    #[serde(default)]
    lidar: Vec<LidarTable>,
    #[serde(default)]
    gnss: Vec<GnssTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Rotary {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    plant: String,
    #[serde(default, deserialize_with = "optional_channel")]
    rail: Option<ChannelId>,
    encoder: Option<Encoder>,
    motor_side: Option<Encoder>,
    #[serde(default, deserialize_with = "finite")]
    start_rad: f64,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct Encoder {
    input: u8,
    #[serde(deserialize_with = "crate::number::positive")]
    lines_per_turn: u32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Linear {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    plant: String,
    #[serde(default, deserialize_with = "optional_channel")]
    rail: Option<ChannelId>,
    potentiometer: Option<Potentiometer>,
    #[serde(default, deserialize_with = "finite")]
    start_m: f64,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct Potentiometer {
    input: u8,
    low: TruePoint,
    high: TruePoint,
    #[serde(default = "noise_rms_codes", deserialize_with = "not_negative")]
    noise_rms_codes: f64,
}

fn noise_rms_codes() -> f64 {
    NOISE_RMS_CODES
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Rail {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    analog: Option<u8>,
    #[serde(default, deserialize_with = "optional_positive")]
    volts_per_code: Option<f64>,
    #[serde(default, deserialize_with = "optional_positive")]
    emf_v: Option<f64>,
    #[serde(default, deserialize_with = "optional_not_negative")]
    resistance_ohm: Option<f64>,
    #[serde(default, deserialize_with = "optional_positive")]
    capacitance_f: Option<f64>,
    #[serde(default, deserialize_with = "optional_not_negative")]
    noise_rms_codes: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Servo {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    low: Option<ServoEnd>,
    high: Option<ServoEnd>,
    #[serde(default, deserialize_with = "optional_positive")]
    speed_rad_s: Option<f64>,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct ServoEnd {
    #[serde(deserialize_with = "crate::number::positive")]
    pulse_s: f64,
    #[serde(deserialize_with = "finite")]
    angle_rad: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Bldc {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    dead_zone_v: Option<Interval>,
    #[serde(default, deserialize_with = "optional_finite")]
    forward_v: Option<f64>,
    #[serde(default, deserialize_with = "optional_finite")]
    reverse_v: Option<f64>,
    #[serde(default, deserialize_with = "optional_positive")]
    top_speed_rad_s: Option<f64>,
    #[serde(default, deserialize_with = "optional_positive")]
    time_constant_s: Option<f64>,
    #[serde(default)]
    four_quadrant: bool,
    rotor: Option<Rotor>,
    encoder: Option<Encoder>,
}

#[derive(Clone, Copy, Deserialize)]
#[serde(deny_unknown_fields)]
struct Rotor {
    #[serde(deserialize_with = "crate::number::positive")]
    inertia_kg_m2: f64,
    #[serde(deserialize_with = "crate::number::positive")]
    torque_max_nm: f64,
    #[serde(default, deserialize_with = "optional_positive")]
    power_max_w: Option<f64>,
    #[serde(default, deserialize_with = "optional_positive")]
    brake_nm: Option<f64>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Stepper {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    #[serde(deserialize_with = "crate::number::positive")]
    start_rate_hz: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Range {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    #[serde(default, deserialize_with = "optional_positive")]
    distance_m: Option<f64>,
    mount: Option<MountTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Analog {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    #[serde(default, deserialize_with = "optional_finite")]
    volts: Option<f64>,
    #[serde(default, deserialize_with = "optional_positive")]
    volts_per_code: Option<f64>,
    #[serde(default, deserialize_with = "optional_not_negative")]
    noise_rms_codes: Option<f64>,
    /// Quantity of the body that is measured there, in place of `volts`.
    body: Option<AnalogReading>,
    /// Field that is measured there, in place of both.
    field: Option<ReadingTable>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct AnalogReading {
    reading: String,
    #[serde(default, deserialize_with = "finite")]
    zero_v: f64,
    #[serde(deserialize_with = "finite")]
    volts_per_unit: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Force {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    #[serde(default, deserialize_with = "optional_finite")]
    force_n: Option<f64>,
    /// Quantity of the body that presses on it, in place of `force_n`.
    body: Option<SensorReading>,
    #[serde(default, deserialize_with = "optional_finite")]
    newtons_per_mv_v: Option<f64>,
    #[serde(default, deserialize_with = "optional_finite")]
    zero_mv_v: Option<f64>,
    #[serde(default, deserialize_with = "not_negative")]
    noise_n: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Distance {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    #[serde(default, deserialize_with = "optional_not_negative")]
    distance_m: Option<f64>,
    /// Quantity of the body that is the distance, in place of `distance_m`.
    body: Option<SensorReading>,
    #[serde(default = "grey", deserialize_with = "crate::number::positive")]
    reflectance: f64,
    #[serde(default, deserialize_with = "finite")]
    offset_m: f64,
}

/// Returns the reflectance of the grey target in the VL6180X's tables.
fn grey() -> f64 {
    0.17
}

/// Quantity of the body in the sensor's unit: `zero + per_unit * reading`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SensorReading {
    reading: String,
    #[serde(default, deserialize_with = "finite")]
    zero: f64,
    #[serde(default = "as_it_is", deserialize_with = "finite")]
    per_unit: f64,
}

fn as_it_is() -> f64 {
    1.0
}

/// Switch that is closed by an axis, or by a quantity of the body.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Switch {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    #[serde(default, deserialize_with = "optional_channel")]
    axis: Option<ChannelId>,
    #[serde(default, deserialize_with = "optional_finite")]
    closed_below_rad: Option<f64>,
    reading: Option<String>,
    #[serde(default, deserialize_with = "optional_finite")]
    closed_above: Option<f64>,
}

/// Returns the motors that may turn: without feedback nothing says that they slide.
pub(super) fn may_turn(motors: &[MotorConfig]) -> Vec<ChannelId> {
    let slides = |feedback: Feedback| !feedback.turns();
    let motors = motors.iter().filter(|motor| !motor.control.is_some_and(|control| slides(control.feedback)));
    motors.map(|motor| motor.id).collect()
}

/// Returns the channels, besides motors, whose outputs may turn a body's shaft.
pub(super) fn others_that_turn(config: &BoardConfig) -> impl Iterator<Item = ChannelId> + '_ {
    let bldcs = config.bldcs.iter().map(|bldc| bldc.id);
    let servos = config.servos.iter().map(|servo| servo.id);
    bldcs.chain(servos).chain(config.steppers.iter().map(|stepper| stepper.id))
}

/// Returns the motors that may slide: without feedback nothing says that they turn.
pub(super) fn may_slide(motors: &[MotorConfig]) -> Vec<ChannelId> {
    let turns = |motor: &MotorConfig| motor.control.is_some_and(|control| control.feedback.turns());
    let motors = motors.iter().filter(|motor| !turns(motor));
    motors.map(|motor| motor.id).collect()
}

/// Table about one channel.
trait About {
    /// Name of the array that the table is in.
    const NAME: &str;
    fn channel(&self) -> ChannelId;
}

macro_rules! about {
    ($($Table:ident $name:literal),*) => {
        $(impl About for $Table {
            const NAME: &str = concat!("simulation.", $name);

            fn channel(&self) -> ChannelId {
                self.channel
            }
        })*
    };
}

about!(Rotary "rotary", Linear "linear", Rail "rail", Servo "servo", Bldc "bldc", Stepper "stepper");
about!(Range "range", Analog "analog", Switch "switch", SimulatedImu "imu", SimulatedCurrent "current");
about!(SimulatedAngle "angle", Force "force", Distance "distance");

impl Tables {
    /// Checks the tables against the robot's configuration, and reads the plant files.
    pub(super) fn check(
        &self,
        reader: &Reader<'_>,
        folder: &Folder,
        config: &BoardConfig,
        body: Option<&Body>,
    ) -> Result<Simulation, BoardError> {
        let body = body.map(|body| body.check(reader, config)).transpose()?;
        let has_body = body.is_some();
        let readings = body.as_ref().map_or(&[][..], |body| body.kind.readings());
        if let Some(body) = &body {
            let turns = |bldc: &&Bldc| bldc.rotor.is_some();
            // Only a brushless drive with a rotor takes the load of a body.
            let known: Vec<_> = self.bldc.iter().filter(turns).map(|bldc| bldc.channel).collect();
            let drives = body.channels.iter().filter(|channel| channel.kind == ChannelKind::Bldc);
            for id in drives {
                reader.one_of("simulated brushless drive with a rotor", *id, known.iter(), "body".into())?;
            }
        }
        let mut check = Check { reader, folder, config, claims: Claims::new(reader.source), has_body, readings };
        let on_bus = |kind| -> Vec<SensorConfig> {
            config.sensors.iter().filter(|sensor| sensor.id.kind == kind).copied().collect()
        };
        // By default the chip is as it was calibrated.
        let calibrated_hz = config.servo_pwm.map_or(NOMINAL_OSCILLATOR_HZ, |chip| chip.oscillator_hz);
        Ok(Simulation {
            motors: check.motors(self)?,
            rails: check.each(&self.rail, &config.supplies, |supply| supply.id, Check::rail)?,
            servo_oscillator_hz: self.servo_oscillator_hz.unwrap_or(calibrated_hz.into()),
            servos: check.each(&self.servo, &config.servos, |servo| servo.id, Check::servo)?,
            bldcs: check.each(&self.bldc, &config.bldcs, |bldc| bldc.id, Check::bldc)?,
            steppers: check.each(&self.stepper, &config.steppers, |stepper| stepper.id, Check::stepper)?,
            ranges: check.each(&self.range, &config.ranges, |range| range.id, Check::range)?,
            analogs: check.each(&self.analog, &config.analogs, |analog| analog.id, Check::analog)?,
            imus: check.each(&self.imu, &on_bus(ChannelKind::Imu), |imu| imu.id, Check::imu)?,
            currents: check.each(&self.current, &on_bus(ChannelKind::Current), |current| current.id, Check::current)?,
            angles: check.each(&self.angle, &on_bus(ChannelKind::Angle), |angle| angle.id, Check::angle)?,
            forces: check.each(&self.force, &on_bus(ChannelKind::Force), |force| force.id, Check::force)?,
            distances: check.each(
                &self.distance,
                &on_bus(ChannelKind::Distance),
                |sensor| sensor.id,
                Check::distance,
            )?,
            pulses: check.pulses(&self.pulses)?,
            switches: check.each(&self.switch, &config.switches, |switch| switch.id, Check::switch)?,
            uarts: uart::check(reader, &mut check.claims, has_body, (&self.lidar, &self.gnss))?,
            body,
            // The world is added by `Simulation::enter`, which also moves the body.
            scene: Scene::default(),
            fields: Vec::new(),
        })
    }
}

struct Check<'c> {
    reader: &'c Reader<'c>,
    folder: &'c Folder,
    config: &'c BoardConfig,
    claims: Claims<'c>,
    has_body: bool,
    /// Names of the quantities of the body that sensors may measure.
    readings: &'static [&'static str],
}

impl Check<'_> {
    /// Makes the true values of each of the robot's `configs`. `truth` is given the table about it, if there is one,
    /// and its path.
    fn each<T: About, C, S>(
        &mut self,
        tables: &[T],
        configs: &[C],
        id: fn(&C) -> ChannelId,
        truth: impl Fn(&mut Self, &C, Option<&T>, &str) -> Result<S, BoardError>,
    ) -> Result<Vec<S>, BoardError> {
        let known: Vec<_> = configs.iter().map(id).collect();
        for (index, table) in tables.iter().enumerate() {
            self.channel(table.channel(), &known, format!("{}[{index}].channel", T::NAME))?;
        }
        let mut truths = Vec::new();
        for config in configs {
            let found = tables.iter().position(|table| table.channel() == id(config));
            // Without a table an error can only point at `[simulation]` itself.
            let path = found.map_or_else(|| "simulation".to_owned(), |index| format!("{}[{index}]", T::NAME));
            truths.push(truth(self, config, found.map(|index| &tables[index]), &path)?);
        }
        Ok(truths)
    }

    /// Checks that a simulated channel exists, and is simulated only once.
    fn channel(&mut self, id: ChannelId, known: &[ChannelId], path: String) -> Result<(), BoardError> {
        self.reader.one_of("channel of that kind", id, known.iter(), path.clone())?;
        self.claims.take("channel", id, path)
    }

    fn motors(&mut self, tables: &Tables) -> Result<Vec<SimulatedMotor>, BoardError> {
        let motors = &self.config.motors;
        let (may_turn, may_slide) = (may_turn(motors), may_slide(motors));
        let mut simulated = Vec::new();
        for (index, rotary) in tables.rotary.iter().enumerate() {
            let path = format!("simulation.rotary[{index}]");
            self.channel(rotary.channel, &may_turn, format!("{path}.channel"))?;
            simulated.push(self.rotary(rotary, &path)?);
        }
        for (index, linear) in tables.linear.iter().enumerate() {
            let path = format!("simulation.linear[{index}]");
            self.channel(linear.channel, &may_slide, format!("{path}.channel"))?;
            simulated.push(self.linear(linear, &path)?);
        }
        // The simulation has the order of the configuration, whatever the order of the tables.
        simulated.sort_by_key(|found| motors.iter().position(|motor| motor.id == found.channel));
        if simulated.len() < motors.len() {
            let rule = "needs one rotary or linear table for each motor of the robot";
            return Err(self.reader.rule("simulation", rule));
        }
        Ok(simulated)
    }

    fn feedback(&self, id: ChannelId) -> Option<Feedback> {
        let motor = self.config.motors.iter().find(|motor| motor.id == id)?;
        motor.control.map(|control| control.feedback)
    }

    fn rotary(&mut self, rotary: &Rotary, path: &str) -> Result<SimulatedMotor, BoardError> {
        let input_path = format!("{path}.encoder.input");
        let sensor = match (rotary.encoder, self.feedback(rotary.channel)) {
            (Some(Encoder { input, lines_per_turn }), _) => Some((input, lines_per_turn)),
            // An encoder has whole lines with four counts each.
            (None, Some(Feedback::Encoder { index, counts_per_turn, .. })) if counts_per_turn % 4 == 0 => {
                Some((index, counts_per_turn / 4))
            }
            (None, Some(Feedback::Encoder { .. })) => return Err(self.reader.rule(path, WHOLE_LINES)),
            (None, _) => None,
        };
        if let Some((input, _)) = sensor {
            self.reader.encoder(input, &input_path)?;
            self.claims.take("encoder", input, input_path)?;
        }
        let motor_side = self.motor_side(rotary, path)?;
        Ok(SimulatedMotor {
            channel: rotary.channel,
            plant: self.plant(&rotary.plant, format!("{path}.plant"))?,
            rail: self.rail_of(rotary.rail, path)?,
            start: rotary.start_rad,
            sensor: sensor.map(|(input, lines_per_turn)| SimulatedSensor::Encoder { input, lines_per_turn }),
            motor_side,
        })
    }

    /// Returns the encoder on the motor's side of the plant's play: the configured one, where the file says nothing.
    fn motor_side(&mut self, rotary: &Rotary, path: &str) -> Result<Option<SimulatedEncoder>, BoardError> {
        let motor = self.config.motors.iter().find(|motor| motor.id == rotary.channel);
        let configured = motor.and_then(|motor| motor.control?.motor_side);
        let (input, lines_per_turn) = match (rotary.motor_side, configured) {
            (Some(Encoder { input, lines_per_turn }), _) => (input, lines_per_turn),
            (None, Some(side)) if side.counts_per_turn % 4 == 0 => (side.index, side.counts_per_turn / 4),
            (None, Some(_)) => return Err(self.reader.rule(path, WHOLE_LINES)),
            (None, None) => return Ok(None),
        };
        let input_path = format!("{path}.motor_side.input");
        self.reader.encoder(input, &input_path)?;
        self.claims.take("encoder", input, input_path)?;
        Ok(Some(SimulatedEncoder { input, lines_per_turn }))
    }

    fn linear(&mut self, linear: &Linear, path: &str) -> Result<SimulatedMotor, BoardError> {
        let input_path = format!("{path}.potentiometer.input");
        let sensor = match (linear.potentiometer, self.feedback(linear.channel)) {
            (Some(Potentiometer { input, low, high, noise_rms_codes }), _) => {
                if low.position_m >= high.position_m {
                    let field = format!("{path}.potentiometer.high.position_m");
                    return Err(self.reader.rule(field, "must be above the low point's position_m"));
                }
                Some((input, [low, high], noise_rms_codes))
            }
            (None, Some(Feedback::Potentiometer { analog, low, high })) => {
                // The configuration has 16-bit codes, the simulation those of an ideal 10-bit converter.
                let points = [low, high].map(|point| TruePoint {
                    code_10bit: f64::from(point.code) / 65_535.0 * 1023.0,
                    position_m: point.position_m.into(),
                });
                Some((analog, points, NOISE_RMS_CODES))
            }
            (None, _) => None,
        };
        if let Some((input, ..)) = sensor {
            self.reader.analog(input, &input_path)?;
            self.claims.take("analog input", input, input_path)?;
        }
        Ok(SimulatedMotor {
            channel: linear.channel,
            plant: self.plant(&linear.plant, format!("{path}.plant"))?,
            rail: self.rail_of(linear.rail, path)?,
            start: linear.start_m,
            sensor: sensor.map(|(input, [low, high], noise_rms_codes)| SimulatedSensor::Potentiometer {
                input,
                low,
                high,
                noise_rms_codes,
            }),
            motor_side: None,
        })
    }

    /// Returns the rail that a motor's table names, or the robot's only one.
    fn rail_of(&self, asked: Option<ChannelId>, path: &str) -> Result<ChannelId, BoardError> {
        let supplies = &self.config.supplies;
        match (asked, supplies.as_slice()) {
            (None, [only]) => Ok(only.id),
            (None, _) => Err(self.reader.rule(path, "needs a rail: the supply that feeds the motor's bridge")),
            (Some(rail), _) => {
                let known = supplies.iter().map(|supply| &supply.id);
                self.reader.one_of("supply", rail, known, format!("{path}.rail"))?;
                Ok(rail)
            }
        }
    }

    fn plant(&self, plant: &str, path: impl Display) -> Result<PlantFile, BoardError> {
        let read = self.folder.read(plant);
        let source = read.map_err(|(looked_for, source)| BoardError::MissingFile {
            at: self.reader.source.at(path),
            path: looked_for,
            source,
        })?;
        Ok(PlantFile { name: source.name, text: source.text.into_owned() })
    }

    fn rail(&mut self, config: &SupplyConfig, rail: Option<&Rail>, path: &str) -> Result<SimulatedRail, BoardError> {
        let path = format!("{path}.analog");
        let analog = rail.and_then(|rail| rail.analog).unwrap_or(config.analog);
        self.reader.analog(analog, &path)?;
        self.claims.take("analog input", analog, path)?;
        // By default the supply is in the middle of its range, so that it trips nothing.
        let half_way_v = f64::midpoint(config.range_v.min.into(), config.range_v.max.into());
        Ok(SimulatedRail {
            channel: config.id,
            analog,
            volts_per_code: rail.and_then(|rail| rail.volts_per_code).unwrap_or(config.volts_per_code.into()),
            emf_v: rail.and_then(|rail| rail.emf_v).unwrap_or(half_way_v),
            resistance_ohm: rail.and_then(|rail| rail.resistance_ohm).unwrap_or(RAIL_OHM),
            capacitance_f: rail.and_then(|rail| rail.capacitance_f),
            noise_rms_codes: rail.and_then(|rail| rail.noise_rms_codes).unwrap_or(NOISE_RMS_CODES),
        })
    }

    fn servo(&mut self, config: &ServoConfig, servo: Option<&Servo>, path: &str) -> Result<SimulatedServo, BoardError> {
        let end = |point: r4_protocol::config::ServoPoint| ServoEnd {
            pulse_s: point.pulse_s.into(),
            angle_rad: point.angle_rad.into(),
        };
        let low = servo.and_then(|servo| servo.low).unwrap_or(end(config.low));
        let high = servo.and_then(|servo| servo.high).unwrap_or(end(config.high));
        if low.pulse_s >= high.pulse_s || low.angle_rad == high.angle_rad {
            let rule = "the low end's pulse must be shorter than the high end's, and their angles differ";
            return Err(self.reader.rule(path, rule));
        }
        Ok(SimulatedServo {
            channel: config.id,
            pulse_min_s: low.pulse_s,
            pulse_max_s: high.pulse_s,
            angle_min_rad: low.angle_rad,
            angle_max_rad: high.angle_rad,
            rate_rad_s: servo.and_then(|servo| servo.speed_rad_s).unwrap_or(config.speed_max.into()),
        })
    }

    fn bldc(&mut self, config: &BldcConfig, bldc: Option<&Bldc>, path: &str) -> Result<SimulatedBldc, BoardError> {
        let neutral_v = f64::from(config.neutral_v);
        let dead_zone_v = Interval { min: neutral_v - DEAD_ZONE_V, max: neutral_v + DEAD_ZONE_V };
        let dead_zone_v = bldc.and_then(|bldc| bldc.dead_zone_v).unwrap_or(dead_zone_v);
        let forward_v = bldc.and_then(|bldc| bldc.forward_v).unwrap_or(config.forward_v.into());
        let reverse_v = match config.reverse {
            Reverse::Voltage { full_v } => Some(f64::from(full_v)),
            Reverse::None | Reverse::Line { .. } => None,
        };
        let reverse_v = bldc.and_then(|bldc| bldc.reverse_v).or(reverse_v);
        if forward_v <= dead_zone_v.max || reverse_v.is_some_and(|volts| volts >= dead_zone_v.min) {
            let rule = "a simulated drive goes forwards above its dead_zone_v, and backwards, if by voltage, below it";
            return Err(self.reader.rule(path, rule));
        }
        let encoder = bldc.and_then(|bldc| bldc.encoder);
        if let Some(Encoder { input, .. }) = encoder {
            let path = format!("{path}.encoder.input");
            self.reader.encoder(input, &path)?;
            self.claims.take("encoder", input, path)?;
        }
        let rotor = bldc.and_then(|bldc| bldc.rotor);
        Ok(SimulatedBldc {
            channel: config.id,
            four_quadrant: bldc.is_some_and(|bldc| bldc.four_quadrant),
            rotor: rotor.map(|Rotor { inertia_kg_m2, torque_max_nm, power_max_w, brake_nm }| SimulatedRotor {
                inertia_kg_m2,
                torque_max_nm,
                power_max_w: power_max_w.unwrap_or(f64::INFINITY),
                // Our choice: without a value of its own the brake is as strong as the motor.
                brake_nm: brake_nm.unwrap_or(torque_max_nm),
            }),
            encoder: encoder.map(|Encoder { input, lines_per_turn }| SimulatedEncoder { input, lines_per_turn }),
            dead_zone_v: [dead_zone_v.min, dead_zone_v.max],
            forward_v,
            reverse_v,
            top_speed_rad_s: bldc.and_then(|bldc| bldc.top_speed_rad_s).unwrap_or(BLDC_TOP_SPEED_RAD_S),
            time_constant_s: bldc.and_then(|bldc| bldc.time_constant_s).unwrap_or(BLDC_TIME_CONSTANT_S),
        })
    }

    fn stepper(
        &mut self,
        config: &StepperConfig,
        stepper: Option<&Stepper>,
        _: &str,
    ) -> Result<SimulatedStepper, BoardError> {
        let steps_per_rad = f64::from(config.steps_per_turn) / std::f64::consts::TAU;
        let configured_hz = START_MARGIN * f64::from(config.start_speed) * steps_per_rad;
        let start_rate_hz = stepper.map_or(configured_hz.max(START_RATE_MIN_HZ), |stepper| stepper.start_rate_hz);
        Ok(SimulatedStepper { channel: config.id, start_rate_hz })
    }

    fn range(&mut self, config: &RangeConfig, range: Option<&Range>, path: &str) -> Result<SimulatedRange, BoardError> {
        let nearest_m = config.stop_below_m.unwrap_or(config.range_m.min);
        // By default an object is in range and beyond the limit, so that it trips nothing.
        let half_way_m = f64::midpoint(nearest_m.into(), config.range_m.max.into());
        let sees = match range.map(|range| (range.distance_m, range.mount)) {
            None => RangeView::Constant { distance_m: half_way_m },
            Some((Some(distance_m), None)) => RangeView::Constant { distance_m },
            Some((None, Some(_))) if !self.has_body => {
                return Err(self.reader.rule(format!("{path}.mount"), "the robot has no [body] to mount it on"));
            }
            Some((None, Some(mount))) => RangeView::World(mount.into()),
            Some(_) => return Err(self.reader.rule(path, "needs distance_m, or mount, and not both")),
        };
        Ok(SimulatedRange { channel: config.id, sees })
    }

    fn analog(
        &mut self,
        config: &AnalogConfig,
        analog: Option<&Analog>,
        path: &str,
    ) -> Result<SimulatedAnalog, BoardError> {
        self.claims.take("analog input", config.id.index, path)?;
        // By default the voltage is plausible.
        let half_way_v = f64::midpoint(config.plausible_v.min.into(), config.plausible_v.max.into());
        let field = analog.and_then(|analog| analog.field.as_ref());
        if let (Some(table), Some(reading)) = (analog, field) {
            if table.volts.is_some() || table.body.is_some() {
                return Err(self.reader.rule(path, "needs volts, body or field, and only one of them"));
            }
            if !self.has_body {
                return Err(self.reader.rule(format!("{path}.field"), "the robot has no [body] to mount it on"));
            }
            if !reading.is_finite() {
                return Err(self.reader.rule(format!("{path}.field.at_m"), "numbers must be finite"));
            }
        }
        Ok(SimulatedAnalog {
            field: field.map(Into::into),
            channel: config.id,
            volts: analog.and_then(|analog| analog.volts).unwrap_or(half_way_v),
            volts_per_code: analog.and_then(|analog| analog.volts_per_code).unwrap_or(config.volts_per_code.into()),
            noise_rms_codes: analog.and_then(|analog| analog.noise_rms_codes).unwrap_or(NOISE_RMS_CODES),
            reads: analog
                .and_then(|analog| analog.body.as_ref())
                .map(|body| self.analog_reading(body, path))
                .transpose()?,
        })
    }

    fn imu(
        &mut self,
        config: &SensorConfig,
        imu: Option<&SimulatedImu>,
        path: &str,
    ) -> Result<SimulatedImu, BoardError> {
        let imu = imu.copied().unwrap_or_else(|| SimulatedImu::new(config.id));
        if imu.is_finite() { Ok(imu) } else { Err(self.reader.rule(path, "numbers must be finite")) }
    }

    /// Makes a current monitor; without a table it is in the only supply.
    fn current(
        &mut self,
        config: &SensorConfig,
        current: Option<&SimulatedCurrent>,
        path: &str,
    ) -> Result<SimulatedCurrent, BoardError> {
        let Some(current) = current else {
            // With several supplies a default would be a guess.
            let [supply] = &self.config.supplies[..] else {
                return Err(self
                    .reader
                    .rule(path, "needs a [[simulation.current]] table that says whose current it sees"));
            };
            return Ok(SimulatedCurrent { channel: config.id, of: supply.id, shunt_ohm: None });
        };
        let supplies = self.config.supplies.iter().map(|supply| &supply.id);
        let known = supplies.chain(self.config.motors.iter().map(|motor| &motor.id));
        self.reader.one_of("supply or motor", current.of, known, format!("{path}.of"))?;
        Ok(*current)
    }

    /// Makes an angle sensor; without a table it is on the shaft of the motor that it controls, with the configured
    /// zero.
    fn angle(
        &mut self,
        config: &SensorConfig,
        angle: Option<&SimulatedAngle>,
        path: &str,
    ) -> Result<SimulatedAngle, BoardError> {
        let Some(angle) = angle else {
            let mut motors = self.config.motors.iter();
            let controlled = motors.find_map(|motor| match motor.control?.feedback {
                Feedback::Angle { angle, zero, .. } if angle == config.id.index => Some((motor.id, f64::from(zero))),
                _ => None,
            });
            let (of, zero_rad) = controlled.unzip();
            return Ok(SimulatedAngle { channel: config.id, of, zero_rad: zero_rad.unwrap_or_default() });
        };
        if let Some(of) = angle.of {
            let known = may_turn(&self.config.motors);
            self.reader.one_of("motor that turns", of, known.iter(), format!("{path}.of"))?;
        }
        Ok(*angle)
    }

    /// Makes a load cell; without a table it has no load, and the configured properties.
    fn force(
        &mut self,
        config: &SensorConfig,
        force: Option<&Force>,
        path: &str,
    ) -> Result<SimulatedForce, BoardError> {
        let SensorChip::Nau7802(chip) = config.chip else {
            return Err(self.reader.rule(path, "the channel is no load cell"));
        };
        let configured = SimulatedForce {
            channel: config.id,
            force_n: 0.0,
            reads: None,
            newtons_per_mv_v: chip.newtons_per_mv_v.into(),
            zero_mv_v: chip.zero_mv_v.into(),
            noise_n: 0.0,
        };
        let Some(force) = force else { return Ok(configured) };
        if force.force_n.is_some() && force.body.is_some() {
            return Err(self.reader.rule(path, "needs force_n, or body, and not both"));
        }
        if force.newtons_per_mv_v == Some(0.0) {
            return Err(self.reader.rule(format!("{path}.newtons_per_mv_v"), "must not be 0"));
        }
        let reads = force.body.as_ref().map(|body| self.sensor_reading(body, path)).transpose()?;
        Ok(SimulatedForce {
            force_n: force.force_n.unwrap_or(configured.force_n),
            reads,
            newtons_per_mv_v: force.newtons_per_mv_v.unwrap_or(configured.newtons_per_mv_v),
            zero_mv_v: force.zero_mv_v.unwrap_or(configured.zero_mv_v),
            noise_n: force.noise_n,
            ..configured
        })
    }

    /// Makes an optical distance sensor; without a table it has nothing in front of it.
    fn distance(
        &mut self,
        config: &SensorConfig,
        distance: Option<&Distance>,
        path: &str,
    ) -> Result<SimulatedDistance, BoardError> {
        let nothing =
            SimulatedDistance { channel: config.id, distance_m: None, reads: None, reflectance: grey(), offset_m: 0.0 };
        let Some(&Distance { distance_m, ref body, reflectance, offset_m, .. }) = distance else { return Ok(nothing) };
        if distance_m.is_some() && body.is_some() {
            return Err(self.reader.rule(path, "needs distance_m, or body, or neither, and not both"));
        }
        if reflectance > 1.0 {
            return Err(self.reader.rule(format!("{path}.reflectance"), "must be at most 1"));
        }
        let reads = body.as_ref().map(|body| self.sensor_reading(body, path)).transpose()?;
        Ok(SimulatedDistance { distance_m, reads, reflectance, offset_m, ..nothing })
    }

    /// Makes the angle sensors that send pulses to range connectors: those of tables and, for every other motor that is
    /// controlled by pulses, one as configured.
    fn pulses(&mut self, tables: &[SimulatedPulses]) -> Result<Vec<SimulatedPulses>, BoardError> {
        let connectors = self.reader.carrier.range.connectors.len();
        let mut sources = tables.to_vec();
        for (index, table) in tables.iter().enumerate() {
            let path = format!("simulation.pulses[{index}].connector");
            self.reader.exists("range sensor connector", table.connector, connectors, &path)?;
            self.claims.take("range sensor connector", table.connector, path)?;
            if let Some(of) = table.of {
                let known = may_turn(&self.config.motors);
                let path = format!("simulation.pulses[{index}].of");
                self.reader.one_of("motor that turns", of, known.iter(), path)?;
            }
        }
        for motor in &self.config.motors {
            let feedback = motor.control.map(|control| control.feedback);
            let Some(Feedback::Pulses { range, frames_hz, zero, .. }) = feedback else { continue };
            if !tables.iter().any(|table| table.connector == range) {
                sources.push(SimulatedPulses {
                    connector: range,
                    of: Some(motor.id),
                    zero_rad: zero.into(),
                    frames_hz: frames_hz.into(),
                });
            }
        }
        Ok(sources)
    }

    /// Makes a switch; without a table the axis that is homed by it closes it, at the configured position.
    fn switch(
        &mut self,
        config: &SwitchConfig,
        switch: Option<&Switch>,
        path: &str,
    ) -> Result<SimulatedSwitch, BoardError> {
        let motors = self.config.motors.iter().map(|motor| (motor.id, motor.control.and_then(|c| c.homing)));
        let steppers = self.config.steppers.iter().map(|stepper| (stepper.id, stepper.homing));
        let mut axes = motors.chain(steppers);
        if let Some(switch) = switch {
            let closed_by = match (switch.axis, switch.closed_below_rad, &switch.reading, switch.closed_above) {
                (Some(channel), Some(below), None, None) => {
                    let known: Vec<_> = axes.map(|(id, _)| id).collect();
                    self.reader.one_of("motor or stepper", channel, known.iter(), format!("{path}.axis"))?;
                    SwitchedBy::Axis { channel, below }
                }
                (None, None, Some(reading), Some(above)) => {
                    let number = self.reading(reading, format!("{path}.reading"))?;
                    // Closed where `reading - above` is positive.
                    SwitchedBy::Body(BodyReading { number, zero: -above, per_unit: 1.0 })
                }
                _ => {
                    let rule = "needs axis and closed_below_rad, or reading of the body and closed_above";
                    return Err(self.reader.rule(path, rule));
                }
            };
            return Ok(SimulatedSwitch { channel: config.id, closed_by });
        }
        let homed = axes.find_map(|(id, homing)| {
            let homing = homing.filter(|homing| homing.switch == config.id.index)?;
            Some(SwitchedBy::Axis { channel: id, below: f64::from(homing.position) })
        });
        Ok(SimulatedSwitch { channel: config.id, closed_by: homed.unwrap_or(SwitchedBy::Nothing) })
    }

    /// Returns the number of a quantity of the body by its name.
    fn reading(&self, name: &str, path: String) -> Result<usize, BoardError> {
        let number = self.readings.iter().position(|known| *known == name);
        number.ok_or_else(|| {
            let rule = match self.readings {
                [] => "there is no [body] that sensors could measure anything of".to_owned(),
                known => format!("the body has no `{name}`: it has {}", known.join(", ")),
            };
            self.reader.source.rule(path, rule)
        })
    }

    fn sensor_reading(&self, table: &SensorReading, path: &str) -> Result<BodyReading, BoardError> {
        let number = self.reading(&table.reading, format!("{path}.body.reading"))?;
        Ok(BodyReading { number, zero: table.zero, per_unit: table.per_unit })
    }

    fn analog_reading(&self, table: &AnalogReading, path: &str) -> Result<BodyReading, BoardError> {
        let number = self.reading(&table.reading, format!("{path}.body.reading"))?;
        Ok(BodyReading { number, zero: table.zero_v, per_unit: table.volts_per_unit })
    }
}
