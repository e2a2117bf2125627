//! Reader of a robot file, which makes a [`Robot`] of it.

use std::{fmt::Display, io::ErrorKind};

use r4_protocol::{
    channel::{ChannelId, ChannelKind},
    config::{
        BoardConfig, BridgeConfig, CanConfig, ConfigError, DacChipConfig, ExpanderConfig, Feedback, HomingConfig,
        MAX_SENSORS, MotorConfig, PwmConfig, SensorConfig,
    },
};
use serde::Deserialize;

use super::{Drive, Robot, Simulation, body, input, motor::Motor, output, sensor, simulation};
use crate::{
    carrier::{self, Carrier},
    error::BoardError,
    number::{air_temperature_c, can_data_kbit_per_s, can_kbit_per_s, can_node, control_period_us, link_timeout_ms},
    source::{Claims, Folder, Source, Tables},
};

/// Arrays of motors; the way in which a table is read depends on the tables inside it.
const MOTORS: [ChannelKind; 3] = [ChannelKind::Osmc, ChannelKind::Actuator, ChannelKind::Dhb];

/// Fields of the file, but for its motors.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct RobotFile {
    name: heapless::String<32>,
    carrier: String,
    #[serde(deserialize_with = "control_period_us")]
    control_period_us: u32,
    #[serde(deserialize_with = "link_timeout_ms")]
    link_timeout_ms: u16,
    #[serde(default)]
    auxiliary_stop: bool,
    #[serde(default)]
    screen: bool,
    #[serde(default = "room_temperature_c", deserialize_with = "air_temperature_c")]
    air_temperature_c: f32,
    #[serde(default)]
    can: Can,
    servo_chip: Option<output::ServoChip>,
    stepper_bank: Option<output::StepperBank>,
    #[serde(default)]
    bldc: Vec<output::Bldc>,
    #[serde(default)]
    servo: Vec<output::Servo>,
    #[serde(default)]
    stepper: Vec<output::Stepper>,
    #[serde(default)]
    relay: Vec<output::Relay>,
    #[serde(default)]
    dac: Vec<output::Dac>,
    #[serde(default)]
    encoder: Vec<input::Encoder>,
    #[serde(default)]
    switch: Vec<input::Switch>,
    #[serde(default)]
    range: Vec<input::RangeSensor>,
    #[serde(default)]
    analog: Vec<input::Analog>,
    #[serde(default)]
    supply: Vec<input::Supply>,
    #[serde(default)]
    imu: Vec<sensor::Imu>,
    #[serde(default)]
    current: Vec<sensor::Current>,
    #[serde(default)]
    angle: Vec<sensor::Angle>,
    #[serde(default)]
    force: Vec<sensor::Force>,
    #[serde(default)]
    distance: Vec<sensor::Distance>,
    drive: Option<Drive>,
    body: Option<body::Body>,
    world: Option<body::WorldTable>,
    simulation: Option<simulation::Tables>,
}

/// CAN bus to hosts.
#[derive(Deserialize)]
#[serde(deny_unknown_fields, default)]
struct Can {
    #[serde(deserialize_with = "can_kbit_per_s")]
    kbit_per_s: u16,
    #[serde(deserialize_with = "can_node")]
    node: u16,
    #[serde(deserialize_with = "can_data_kbit_per_s")]
    data_kbit_per_s: u16,
}

impl Default for Can {
    fn default() -> Self {
        let CanConfig { kbit_per_s, node, data_kbit_per_s } = CanConfig::default();
        Self { kbit_per_s, node, data_kbit_per_s }
    }
}

fn room_temperature_c() -> f32 {
    20.0
}

/// Reads and checks a robot file, and the files it names.
pub(crate) fn read(source: &Source, folder: &Folder) -> Result<Robot, BoardError> {
    let (file, motors): (RobotFile, _) = source.parse_without(MOTORS.map(ChannelKind::name))?;
    let carrier_source = folder.read(&format!("{}.toml", file.carrier)).map_err(|(path, why)| {
        let at = source.at("carrier");
        // A file that exists but cannot be read is another problem than a wrong name.
        if why.kind() != ErrorKind::NotFound {
            return BoardError::MissingFile { at, path, source: why };
        }
        let known = format!("{}, or put {path} there", crate::CARRIERS.join(", "));
        BoardError::NoSuch { at, what: "carrier", asked: file.carrier.clone(), known }
    })?;
    let carrier = carrier::read(&carrier_source)?;
    let reader = Reader { source, carrier: &carrier };
    let config = reader.config(&file, motors)?;
    let drive = file.drive.map(|drive| drive.check(&reader, &config)).transpose()?;
    let simulation = match &file.simulation {
        Some(tables) => {
            let mut simulation = tables.check(&reader, folder, &config, file.body.as_ref())?;
            if let Some(world) = &file.world {
                simulation.enter(world.check(source)?);
                simulation.check_fields().map_err(|why| source.rule("world.field", why))?;
            }
            simulation
        }
        None => {
            let alone = [("body", file.body.is_some()), ("world", file.world.is_some())];
            if let Some((table, _)) = alone.into_iter().find(|(_, is_there)| *is_there) {
                // A body or a world without simulated motors would be ignored silently.
                return Err(reader.rule(table, "needs a [simulation]: without one no motor is simulated"));
            }
            Simulation::default()
        }
    };
    Ok(Robot { file: source.name.clone(), config, drive, simulation, carrier })
}

/// Table of the file that becomes a channel of the firmware. Its array is named as the kind of channel.
pub(super) trait Table {
    /// Configuration of the channel for the firmware.
    type Config;
    /// Kind of the channel.
    const KIND: ChannelKind;

    fn channel(&self) -> ChannelId;

    fn config(&self, place: &mut Place<'_, '_>) -> Result<Self::Config, BoardError>;
}

/// Place of a table in the file, with the claims of the tables before it.
pub(super) struct Place<'p, 's> {
    reader: &'p Reader<'p>,
    pub(super) carrier: &'p Carrier,
    claims: &'p mut Claims<'s>,
    path: String,
}

impl<'p> Place<'p, '_> {
    /// Returns the carrier's connector of a channel; that it exists has been checked.
    pub(super) fn connector<T>(&self, connectors: &'p [T], id: ChannelId) -> Result<&'p T, BoardError> {
        connectors.get(usize::from(id.index)).ok_or_else(|| self.rule("channel", "the carrier has no such connector"))
    }

    pub(super) fn rule(&self, field: &str, rule: &'static str) -> BoardError {
        self.reader.rule(format!("{}.{field}", self.path), rule)
    }

    pub(super) fn take_analog(&mut self, input: u8, field: &str) -> Result<(), BoardError> {
        let path = format!("{}.{field}", self.path);
        self.reader.analog(input, &path)?;
        self.claims.take("analog input", input, path)
    }

    /// Takes an address on the bus with the carrier's chips. No chip of the carrier may have it, used or not.
    pub(super) fn take_address(&mut self, address: u8) -> Result<(), BoardError> {
        let i2c = &self.carrier.i2c;
        let chips = i2c.devices.iter().map(|device| device.address);
        // Chips of the carrier answer on the bus even if the robot does not use them.
        let mut taken = chips.chain(i2c.reserved.iter().map(|reserved| reserved.address));
        if taken.any(|taken| taken == address) {
            return Err(self.rule("address", "must be free on the carrier's I2C bus: see [i2c] of its file"));
        }
        self.claims.take("I2C address", address, format!("{}.address", self.path))
    }

    fn take_encoder(&mut self, input: u8, field: &str) -> Result<(), BoardError> {
        let path = format!("{}.{field}", self.path);
        self.reader.encoder(input, &path)?;
        self.claims.take("motor's encoder", input, path)
    }

    fn motor(&mut self, motor: Motor, kind: ChannelKind) -> Result<MotorConfig, BoardError> {
        let Carrier { osmc, dhb, .. } = self.carrier;
        let (bridge, default, hard) = if kind == ChannelKind::Dhb {
            let lines = *self.connector(&dhb.connectors, motor.channel())?;
            (BridgeConfig::Dhb(lines), dhb.duty_max_default, dhb.duty_max_hard)
        } else {
            let lines = *self.connector(&osmc.connectors, motor.channel())?;
            (BridgeConfig::Osmc(lines), osmc.duty_max_default, osmc.duty_max_hard)
        };
        // The carrier's hard limit is that of its bridge; a robot may only lower it.
        let duty_max = motor.duty_max().unwrap_or(default);
        if duty_max > hard {
            return Err(self.rule("duty_max", "must be at most duty_max_hard of the bridge in the carrier"));
        }
        match &motor {
            Motor::Open(_) => {}
            Motor::Rotary(motor) => {
                let there = [motor.encoder.is_some(), motor.angle.is_some(), motor.pulses.is_some()];
                if there.into_iter().filter(|there| *there).count() != 1 {
                    return Err(self.rule(
                        "channel",
                        "a motor under control needs one of the tables encoder, angle and pulses, and only one",
                    ));
                }
                if let Some(pulses) = &motor.pulses {
                    let path = format!("{}.pulses.range", self.path);
                    self.reader.exists(
                        "range sensor connector",
                        pulses.range,
                        self.carrier.range.connectors.len(),
                        &path,
                    )?;
                    self.claims.take("range sensor connector", pulses.range, path)?;
                }
                if let Some(encoder) = &motor.encoder {
                    self.take_encoder(encoder.input, "encoder.input")?;
                }
                if let Some(side) = &motor.motor_side {
                    self.take_encoder(side.input, "motor_side.input")?;
                }
            }
            Motor::Linear(motor) => self.take_analog(motor.potentiometer.input, "potentiometer.input")?,
        }
        Ok(motor.config(bridge, duty_max))
    }
}

/// Robot file with the carrier that it is checked against.
pub(super) struct Reader<'r> {
    pub(super) source: &'r Source,
    pub(super) carrier: &'r Carrier,
}

/// Path of each channel in the file, for the line of a firmware's rule that does not hold.
type Paths = Vec<(ChannelId, String)>;

impl Reader<'_> {
    fn config(&self, file: &RobotFile, motors: [Tables<'_>; 3]) -> Result<BoardConfig, BoardError> {
        let mut claims = Claims::new(self.source);
        let mut paths = Paths::new();
        macro_rules! list {
            ($field:ident) => {
                self.list(&file.$field, &mut claims, &mut paths)?
            };
        }
        let motors = self.motors(motors, &mut claims, &mut paths)?;
        let (bldcs, servos, steppers) = (list!(bldc), list!(servo), list!(stepper));
        let (relays, dacs) = (list!(relay), list!(dac));
        let (encoders, switches, ranges) = (list!(encoder), list!(switch), list!(range));
        let (analogs, supplies) = (list!(analog), list!(supply));
        let mut sensors: heapless::Vec<SensorConfig, MAX_SENSORS> = list!(imu);
        let currents: heapless::Vec<SensorConfig, MAX_SENSORS> = list!(current);
        let angles: heapless::Vec<SensorConfig, MAX_SENSORS> = list!(angle);
        let forces: heapless::Vec<SensorConfig, MAX_SENSORS> = list!(force);
        let distances: heapless::Vec<SensorConfig, MAX_SENSORS> = list!(distance);
        for (table, more) in [("current", &currents), ("angle", &angles), ("force", &forces), ("distance", &distances)]
        {
            let full = |_| self.rule(table, "the firmware has at most 4 sensors on the bus");
            sensors.extend_from_slice(more).map_err(full)?;
        }

        let carrier = self.carrier;
        let on_bridge = |dhb| motors.iter().any(|motor| matches!(motor.bridge, BridgeConfig::Dhb(_)) == dhb);
        let pwm = |used: bool, chip: &str, frequency_hz| {
            used.then(|| PwmConfig { address: carrier.address(chip), frequency_hz })
        };
        let has_expander = !relays.is_empty() || bldcs.iter().any(|bldc| bldc.lines().next().is_some());
        if !servos.is_empty() && file.servo_chip.is_none() {
            return Err(self.rule("servo[0]", "servos need a [servo_chip] table with hold_when_safe"));
        }
        if !steppers.is_empty() && file.stepper_bank.is_none() {
            let rule = "steppers need a [stepper_bank] table with enable_active_low and hold_when_safe";
            return Err(self.rule("stepper[0]", rule));
        }
        let config = BoardConfig {
            robot: file.name.clone(),
            control_period_us: file.control_period_us,
            link_timeout_ms: file.link_timeout_ms,
            i2c_hz: carrier.i2c.rate_hz,
            auxiliary_stop: file.auxiliary_stop,
            screen: file.screen,
            air_temperature_c: file.air_temperature_c,
            // A carrier may lack the chips that its robot does not use.
            osmc_pwm: pwm(on_bridge(false), &carrier.osmc.pwm, carrier.osmc.frequency_hz),
            dhb_pwm: pwm(on_bridge(true), &carrier.dhb.pwm, carrier.dhb.frequency_hz),
            servo_pwm: file.servo_chip.as_ref().filter(|_| !servos.is_empty()).map(|chip| chip.config(carrier)),
            bldc_dac: (!bldcs.is_empty()).then(|| DacChipConfig {
                address: carrier.address(&carrier.bldc.dac),
                full_scale_v: carrier.bldc.dac_full_scale_v,
            }),
            expander: has_expander.then(|| ExpanderConfig { address: carrier.address(&carrier.relay.expander) }),
            stepper_bank: file.stepper_bank.as_ref().filter(|_| !steppers.is_empty()).map(|bank| bank.config(carrier)),
            motors,
            bldcs,
            servos,
            steppers,
            relays,
            dacs,
            encoders,
            switches,
            ranges,
            analogs,
            supplies,
            can: CanConfig {
                kbit_per_s: file.can.kbit_per_s,
                node: file.can.node,
                data_kbit_per_s: file.can.data_kbit_per_s,
            },
            sensors,
        };
        // These two come before the firmware's rules, because they know the field and not only the channel.
        self.home_switches(&config, &paths)?;
        self.angle_sensors(&config, &paths)?;
        config.validate().map_err(|ConfigError { channel, rule }| {
            let path = channel.and_then(|id| path_of(&paths, id)).unwrap_or_default();
            BoardError::Rule { at: self.source.at(path), channel, rule }
        })?;
        Ok(config)
    }

    fn motors<const N: usize>(
        &self,
        tables: [Tables<'_>; 3],
        claims: &mut Claims<'_>,
        paths: &mut Paths,
    ) -> Result<heapless::Vec<MotorConfig, N>, BoardError> {
        let mut motors = Vec::new();
        for (kind, tables) in MOTORS.into_iter().zip(tables) {
            for (index, table) in tables.into_iter().enumerate() {
                let motor = Motor::parse(kind, table).map_err(|fault| self.source.malformed(fault))?;
                let id = motor.channel();
                let mut place = self.place(claims, kind, index, id)?;
                motors.push(place.motor(motor, kind)?);
                paths.push((id, place.path));
            }
        }
        // Channels are described in this order whatever the order of the tables: OSMC bridges, then DHB, each by
        // number.
        motors.sort_by_key(|motor| (matches!(motor.bridge, BridgeConfig::Dhb(_)), motor.id.index));
        heapless::Vec::from_slice(&motors).map_err(|_| self.rule("osmc", "the firmware has at most 8 motors"))
    }

    fn list<T: Table, const N: usize>(
        &self,
        tables: &[T],
        claims: &mut Claims<'_>,
        paths: &mut Paths,
    ) -> Result<heapless::Vec<T::Config, N>, BoardError> {
        let mut configs = heapless::Vec::new();
        for (index, table) in tables.iter().enumerate() {
            let id = table.channel();
            let mut place = self.place(claims, T::KIND, index, id)?;
            let config = table.config(&mut place)?;
            configs.push(config).map_err(|_| place.rule("channel", "the firmware has no room for so many of them"))?;
            paths.push((id, place.path));
        }
        Ok(configs)
    }

    /// Checks the channel's name against its table and the carrier, and takes its connector.
    fn place<'p, 's>(
        &'p self,
        claims: &'p mut Claims<'s>,
        kind: ChannelKind,
        index: usize,
        id: ChannelId,
    ) -> Result<Place<'p, 's>, BoardError> {
        let path = format!("{}[{index}]", kind.name());
        let field = format!("{path}.channel");
        if id.kind != kind {
            let name = kind.name();
            let problem = format!("a channel of a {name} table is named {name} and a number, as in {name}0");
            return Err(BoardError::Malformed { at: self.source.at(field), problem });
        }
        match self.connectors(kind) {
            Some((what, count)) => {
                self.exists(what, id.index, count, &field)?;
                claims.take(what, id.index, field)?;
            }
            None => claims.take("channel", id, field)?,
        }
        Ok(Place { reader: self, carrier: self.carrier, claims, path })
    }

    /// Returns the connector that the number in a channel's name stands for, and how many of these the carrier has;
    /// `None` where any number is allowed.
    fn connectors(&self, kind: ChannelKind) -> Option<(&'static str, usize)> {
        let Carrier { osmc, dhb, servo, bldc, relay, stepper, encoder, range, analog, dac, .. } = self.carrier;
        Some(match kind {
            ChannelKind::Osmc | ChannelKind::Actuator => ("OSMC connector", osmc.connectors.len()),
            ChannelKind::Dhb => ("DHB connector", dhb.connectors.len()),
            ChannelKind::Bldc => ("BLDC connector", bldc.connectors.len()),
            ChannelKind::Servo => ("servo output", servo.outputs.len()),
            ChannelKind::Stepper => ("stepper connector", stepper.connectors.len()),
            ChannelKind::Relay => ("relay output", relay.outputs.len()),
            ChannelKind::Dac => ("DAC output", dac.outputs.len()),
            ChannelKind::Encoder => ("encoder", encoder.connectors.len()),
            ChannelKind::Switch => ("switch", encoder.connectors.len()),
            ChannelKind::Range => ("range sensor connector", range.connectors.len()),
            ChannelKind::Analog => ("analog input", analog.inputs.len()),
            ChannelKind::Supply
            | ChannelKind::DeadMan
            | ChannelKind::Imu
            | ChannelKind::Current
            | ChannelKind::Angle
            | ChannelKind::Force
            | ChannelKind::Distance => return None,
        })
    }

    /// Checks that a switch used for homing has a table, which says which level is closed.
    fn home_switches(&self, config: &BoardConfig, paths: &Paths) -> Result<(), BoardError> {
        let motors = config.motors.iter().map(|motor| (motor.id, motor.control.and_then(|control| control.homing)));
        let steppers = config.steppers.iter().map(|stepper| (stepper.id, stepper.homing));
        for (id, homing) in motors.chain(steppers) {
            let Some(HomingConfig { switch, .. }) = homing else { continue };
            let asked = ChannelId::new(ChannelKind::Switch, switch);
            let field = format!("{}.homing.switch", path_of(paths, id).unwrap_or_default());
            self.one_of("switch table for", asked, config.switches.iter().map(|switch| &switch.id), field)?;
        }
        Ok(())
    }

    /// Checks that the angle sensor of a motor has a table of its own.
    fn angle_sensors(&self, config: &BoardConfig, paths: &Paths) -> Result<(), BoardError> {
        for motor in &config.motors {
            let Some(Feedback::Angle { angle, .. }) = motor.control.map(|control| control.feedback) else { continue };
            let asked = ChannelId::new(ChannelKind::Angle, angle);
            let field = format!("{}.angle.sensor", path_of(paths, motor.id).unwrap_or_default());
            let known: Vec<_> = config.sensors.iter().map(|sensor| sensor.id).collect();
            let known = known.iter().filter(|id| id.kind == ChannelKind::Angle);
            self.one_of("angle table for", asked, known, field)?;
        }
        Ok(())
    }

    pub(super) fn encoder(&self, input: u8, path: impl Display) -> Result<(), BoardError> {
        self.exists("encoder", input, self.carrier.encoder.connectors.len(), path)
    }

    pub(super) fn analog(&self, input: u8, path: impl Display) -> Result<(), BoardError> {
        self.exists("analog input", input, self.carrier.analog.inputs.len(), path)
    }

    pub(super) fn one_of<'i>(
        &self,
        what: &'static str,
        id: ChannelId,
        known: impl Iterator<Item = &'i ChannelId> + Clone,
        path: String,
    ) -> Result<(), BoardError> {
        if known.clone().any(|known| *known == id) {
            return Ok(());
        }
        let known: Vec<_> = known.map(ToString::to_string).collect();
        let known = if known.is_empty() { "nothing: the robot has none".to_owned() } else { known.join(" or ") };
        Err(BoardError::NoSuch { at: self.source.at(path), what, asked: id.to_string(), known })
    }

    pub(super) fn rule(&self, path: impl Display, rule: &'static str) -> BoardError {
        BoardError::Rule { at: self.source.at(path), channel: None, rule }
    }

    pub(super) fn exists(
        &self,
        what: &'static str,
        asked: u8,
        count: usize,
        path: impl Display,
    ) -> Result<(), BoardError> {
        if usize::from(asked) < count {
            return Ok(());
        }
        let known = match count.checked_sub(1) {
            Some(last) => format!("0 to {last}"),
            None => "nothing: the carrier has none".to_owned(),
        };
        Err(BoardError::NoSuch { at: self.source.at(path), what, asked: asked.to_string(), known })
    }
}

fn path_of(paths: &Paths, id: ChannelId) -> Option<&str> {
    paths.iter().find(|(known, _)| *known == id).map(|(_, path)| path.as_str())
}
