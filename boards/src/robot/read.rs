//! From a robot file to a [`Robot`].

use std::{fmt::Display, io::ErrorKind};

use r4_protocol::{
    channel::{ChannelId, ChannelKind},
    config::{
        BoardConfig, BridgeLines, ConfigError, ExpanderConfig, MotorConfig, PwmConfig, RelayConfig, RelayRole,
        SupplyConfig,
    },
};
use serde::Deserialize;

use super::{Robot, Simulation, linear::LinearMotor, rotary::RotaryMotor, simulation};
use crate::{
    carrier::{self, Carrier},
    error::BoardError,
    number::{Interval, channel, control_period_us, link_timeout_ms, optional_positive},
    source::{Claims, Folder, Source},
};

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
    osmc: Vec<RotaryMotor>,
    #[serde(default)]
    actuator: Vec<LinearMotor>,
    #[serde(default)]
    relay: Vec<Relay>,
    #[serde(default)]
    supply: Vec<Supply>,
    simulation: Option<simulation::Tables>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Relay {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    active_low: bool,
    #[serde(default)]
    role: Role,
}

#[derive(Clone, Copy, Default, Deserialize)]
#[serde(rename_all = "kebab-case")]
enum Role {
    #[default]
    General,
    MotorPower,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Supply {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    analog: u8,
    #[serde(default, deserialize_with = "optional_positive")]
    volts_per_code: Option<f32>,
    range_v: Interval,
}

/// Reads and checks a robot file, and the files it names.
pub(crate) fn read(source: &Source, folder: &Folder) -> Result<Robot, BoardError> {
    let file: RobotFile = source.parse()?;
    let carrier_source = folder.read(&format!("{}.toml", file.carrier)).map_err(|(path, why)| {
        let at = source.at("carrier");
        if why.kind() != ErrorKind::NotFound {
            return BoardError::MissingFile { at, path, source: why };
        }
        let known = format!("{}, or put {path} there", crate::CARRIERS.join(", "));
        BoardError::NoSuch { at, what: "carrier", asked: file.carrier.clone(), known }
    })?;
    let carrier = carrier::read(&carrier_source)?;
    let reader = Reader { source, carrier: &carrier };
    let config = reader.config(&file)?;
    let simulation = match &file.simulation {
        Some(tables) => {
            let motors: Vec<_> = config.motors.iter().map(|motor| motor.id).collect();
            let supplies: Vec<_> = config.supplies.iter().map(|supply| supply.id).collect();
            tables.check(&reader, folder, &motors, &supplies)?
        }
        None => Simulation::default(),
    };
    Ok(Robot { file: source.name.clone(), config, simulation, carrier })
}

/// A robot file and the carrier it is checked against.
pub(super) struct Reader<'r> {
    pub(super) source: &'r Source,
    pub(super) carrier: &'r Carrier,
}

impl Reader<'_> {
    fn config(&self, file: &RobotFile) -> Result<BoardConfig, BoardError> {
        let mut claims = Claims::new(self.source);
        // With the path of the table, to find its line when a rule of the firmware does not hold.
        let mut motors: Vec<(MotorConfig, String)> = Vec::new();
        for (index, motor) in file.osmc.iter().enumerate() {
            let path = format!("osmc[{index}]");
            let lines = self.bridge(&mut claims, motor.channel, ChannelKind::Osmc, &path)?;
            let input = format!("{path}.encoder.input");
            self.encoder(motor.encoder.input, &input)?;
            claims.take("encoder", motor.encoder.input, &input)?;
            motors.push((motor.config(lines, self.duty_max(motor.duty_max, &path)?), path));
        }
        for (index, motor) in file.actuator.iter().enumerate() {
            let path = format!("actuator[{index}]");
            let lines = self.bridge(&mut claims, motor.channel, ChannelKind::Actuator, &path)?;
            let input = format!("{path}.potentiometer.input");
            self.analog(motor.potentiometer.input, &input)?;
            claims.take("analog input", motor.potentiometer.input, &input)?;
            motors.push((motor.config(lines, self.duty_max(motor.duty_max, &path)?), path));
        }
        motors.sort_by_key(|(motor, _)| motor.id.index);
        let mut relays = Vec::new();
        for (index, relay) in file.relay.iter().enumerate() {
            let path = format!("relay[{index}]");
            relays.push((self.relay(&mut claims, relay, &path)?, path));
        }
        let mut supplies = Vec::new();
        for (index, supply) in file.supply.iter().enumerate() {
            let path = format!("supply[{index}]");
            supplies.push((self.supply(&mut claims, supply, &path)?, path));
        }

        let carrier = self.carrier;
        let pwm = carrier.device(&carrier.osmc.pwm).map_or(0, |device| device.address);
        let too_many = |field, rule| self.rule(field, rule);
        let config = BoardConfig {
            robot: file.name.clone(),
            control_period_us: file.control_period_us,
            link_timeout_ms: file.link_timeout_ms,
            i2c_hz: carrier.i2c.rate_hz,
            auxiliary_stop: false,
            air_temperature_c: 20.0,
            osmc_pwm: Some(PwmConfig { address: pwm, frequency_hz: carrier.osmc.frequency_hz }),
            dhb_pwm: None,
            servo_pwm: None,
            bldc_dac: None,
            stepper_bank: None,
            bldcs: heapless::Vec::new(),
            servos: heapless::Vec::new(),
            steppers: heapless::Vec::new(),
            dacs: heapless::Vec::new(),
            encoders: heapless::Vec::new(),
            switches: heapless::Vec::new(),
            ranges: heapless::Vec::new(),
            analogs: heapless::Vec::new(),
            motors: fit(motors.iter().map(|(motor, _)| *motor))
                .ok_or_else(|| too_many("osmc", "the firmware has at most 4 motors"))?,
            supplies: fit(supplies.iter().map(|(supply, _)| *supply))
                .ok_or_else(|| too_many("supply", "the firmware has at most 4 supplies"))?,
            // A robot without relays may have a board without the expander.
            expander: carrier
                .device(&carrier.relay.expander)
                .filter(|_| !relays.is_empty())
                .map(|device| ExpanderConfig { address: device.address }),
            relays: fit(relays.iter().map(|(relay, _)| *relay))
                .ok_or_else(|| too_many("relay", "the firmware has at most 8 relays"))?,
        };
        config.validate().map_err(|ConfigError { channel, rule }| {
            let motors = motors.iter().map(|(motor, path)| (motor.id, path));
            let supplies = supplies.iter().map(|(supply, path)| (supply.id, path));
            let relays = relays.iter().map(|(relay, path)| (relay.id, path));
            let table = motors
                .chain(supplies)
                .chain(relays)
                .find(|(id, _)| Some(*id) == channel)
                .map(|(_, path)| path.as_str());
            BoardError::Rule { at: self.source.at(table.unwrap_or_default()), channel, rule }
        })?;
        Ok(config)
    }

    /// The lines of the bridge connector that a channel is named after.
    fn bridge(
        &self,
        claims: &mut Claims<'_>,
        id: ChannelId,
        kind: ChannelKind,
        path: &str,
    ) -> Result<BridgeLines, BoardError> {
        let path = format!("{path}.channel");
        if id.kind != kind {
            let rule = match kind {
                ChannelKind::Osmc => "a channel of an osmc table is named osmc and the connector's number",
                _ => "a channel of an actuator table is named actuator and the connector's number",
            };
            return Err(self.rule(path, rule));
        }
        let connectors = &self.carrier.osmc.connectors;
        let lines = connectors.get(usize::from(id.index));
        let lines = lines.ok_or_else(|| self.no_such("OSMC connector", id.index, connectors.len(), &path))?;
        claims.take("OSMC connector", id.index, path)?;
        Ok(*lines)
    }

    fn duty_max(&self, asked: Option<f32>, path: &str) -> Result<f32, BoardError> {
        let osmc = &self.carrier.osmc;
        match asked {
            Some(duty) if duty > osmc.duty_max_hard => {
                Err(self.rule(format!("{path}.duty_max"), "must be at most osmc.duty_max_hard of the carrier"))
            }
            Some(duty) => Ok(duty),
            None => Ok(osmc.duty_max_default),
        }
    }

    fn relay(&self, claims: &mut Claims<'_>, relay: &Relay, path: &str) -> Result<RelayConfig, BoardError> {
        let path = format!("{path}.channel");
        if relay.channel.kind != ChannelKind::Relay {
            return Err(self.rule(path, "a channel of a relay table is named relay and the output's number"));
        }
        let (index, known) = (relay.channel.index, &self.carrier.relay);
        let bit = known.outputs.get(usize::from(index));
        let bit = bit.ok_or_else(|| self.no_such("relay output", index, known.outputs.len(), &path))?;
        let role = match relay.role {
            Role::General => RelayRole::General,
            Role::MotorPower if index == known.motor_power => RelayRole::MotorPower,
            Role::MotorPower => return Err(self.rule(path, "the motors' supply is on the carrier's relay.motor_power")),
        };
        claims.take("relay output", index, path)?;
        Ok(RelayConfig { id: relay.channel, bit: *bit, active_low: relay.active_low, role })
    }

    fn supply(&self, claims: &mut Claims<'_>, supply: &Supply, path: &str) -> Result<SupplyConfig, BoardError> {
        if supply.channel.kind != ChannelKind::Supply {
            let rule = "a channel of a supply table is named supply and a number";
            return Err(self.rule(format!("{path}.channel"), rule));
        }
        claims.take("channel", supply.channel, format!("{path}.channel"))?;
        self.analog(supply.analog, format!("{path}.analog"))?;
        claims.take("analog input", supply.analog, format!("{path}.analog"))?;
        Ok(SupplyConfig {
            id: supply.channel,
            analog: supply.analog,
            volts_per_code: supply.volts_per_code.unwrap_or(self.carrier.analog.volts_per_code() as f32),
            range_v: supply.range_v.into(),
        })
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

    fn exists(&self, what: &'static str, asked: u8, count: usize, path: impl Display) -> Result<(), BoardError> {
        if usize::from(asked) < count { Ok(()) } else { Err(self.no_such(what, asked, count, path)) }
    }

    fn no_such(&self, what: &'static str, asked: u8, count: usize, path: impl Display) -> BoardError {
        let known = match count.checked_sub(1) {
            Some(last) => format!("0 to {last}"),
            None => "nothing: the carrier has none".to_owned(),
        };
        BoardError::NoSuch { at: self.source.at(path), what, asked: asked.to_string(), known }
    }
}

/// All of `things`, or `None` if there are more than `N`.
fn fit<T, const N: usize>(things: impl Iterator<Item = T>) -> Option<heapless::Vec<T, N>> {
    let mut fitted = heapless::Vec::new();
    for thing in things {
        fitted.push(thing).ok()?;
    }
    Some(fitted)
}
