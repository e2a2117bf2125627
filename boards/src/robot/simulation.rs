//! `[simulation]`: what the simulator takes for true.

use std::fmt::Display;

use r4_protocol::channel::{ChannelId, ChannelKind};
use serde::Deserialize;

use super::{PlantFile, SimulatedMotor, SimulatedRail, SimulatedSensor, Simulation, TruePoint, read::Reader};
use crate::{
    error::BoardError,
    number::{channel, finite, not_negative, optional_positive, positive},
    source::{Claims, Folder},
};

#[derive(Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Tables {
    #[serde(default)]
    rotary: Vec<Rotary>,
    #[serde(default)]
    linear: Vec<Linear>,
    #[serde(default)]
    rail: Vec<Rail>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Rotary {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    plant: String,
    #[serde(deserialize_with = "channel")]
    rail: ChannelId,
    encoder: Encoder,
    #[serde(deserialize_with = "finite")]
    start_rad: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Encoder {
    input: u8,
    #[serde(deserialize_with = "positive")]
    lines_per_turn: u32,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Linear {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    plant: String,
    #[serde(deserialize_with = "channel")]
    rail: ChannelId,
    potentiometer: Potentiometer,
    #[serde(deserialize_with = "finite")]
    start_m: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Potentiometer {
    input: u8,
    low: TruePoint,
    high: TruePoint,
    #[serde(deserialize_with = "not_negative")]
    noise_rms_codes: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Rail {
    #[serde(deserialize_with = "channel")]
    channel: ChannelId,
    analog: u8,
    #[serde(default, deserialize_with = "optional_positive")]
    volts_per_code: Option<f64>,
    #[serde(deserialize_with = "positive")]
    emf_v: f64,
    #[serde(deserialize_with = "not_negative")]
    resistance_ohm: f64,
    #[serde(deserialize_with = "not_negative")]
    noise_rms_codes: f64,
}

impl Tables {
    /// Checks the tables against the robot whose motors and supplies are named, and reads the plant files.
    pub(super) fn check(
        &self,
        reader: &Reader<'_>,
        folder: &Folder,
        motors: &[ChannelId],
        supplies: &[ChannelId],
    ) -> Result<Simulation, BoardError> {
        let check = Check { reader, folder, motors, supplies };
        let mut claims = Claims::new(reader.source);
        let mut simulation = Simulation { motors: self.motors(&check, &mut claims)?, ..Simulation::default() };
        for (index, rail) in self.rail.iter().enumerate() {
            simulation.rails.push(rail.check(&check, &mut claims, index)?);
        }
        // Both ways round: what is simulated exists (checked above), and what exists is simulated.
        simulation.motors = in_order(motors, simulation.motors, |motor| motor.channel)
            .ok_or_else(|| reader.rule("simulation", "needs one rotary or linear table for each motor of the robot"))?;
        simulation.rails = in_order(supplies, simulation.rails, |rail| rail.channel)
            .ok_or_else(|| reader.rule("simulation", "needs one rail table for each supply of the robot"))?;
        Ok(simulation)
    }

    fn motors(&self, check: &Check<'_>, claims: &mut Claims<'_>) -> Result<Vec<SimulatedMotor>, BoardError> {
        let mut motors = Vec::new();
        for (index, rotary) in self.rotary.iter().enumerate() {
            motors.push(rotary.check(check, claims, &format!("simulation.rotary[{index}]"))?);
        }
        for (index, linear) in self.linear.iter().enumerate() {
            motors.push(linear.check(check, claims, &format!("simulation.linear[{index}]"))?);
        }
        Ok(motors)
    }
}

fn in_order<T>(order: &[ChannelId], mut things: Vec<T>, id: fn(&T) -> ChannelId) -> Option<Vec<T>> {
    let place = |thing: &T| order.iter().position(|known| *known == id(thing));
    things.sort_by_key(place);
    (things.len() == order.len()).then_some(things)
}

impl Rotary {
    fn check(&self, check: &Check<'_>, claims: &mut Claims<'_>, path: &str) -> Result<SimulatedMotor, BoardError> {
        check.motor(self.channel, ChannelKind::Osmc, format!("{path}.channel"))?;
        check.rail(self.rail, format!("{path}.rail"))?;
        claims.take("channel", self.channel, format!("{path}.channel"))?;
        check.reader.encoder(self.encoder.input, format!("{path}.encoder.input"))?;
        claims.take("encoder", self.encoder.input, format!("{path}.encoder.input"))?;
        let Encoder { input, lines_per_turn } = self.encoder;
        Ok(SimulatedMotor {
            channel: self.channel,
            plant: check.plant(&self.plant, format!("{path}.plant"))?,
            rail: self.rail,
            start: self.start_rad,
            sensor: Some(SimulatedSensor::Encoder { input, lines_per_turn }),
        })
    }
}

impl Linear {
    fn check(&self, check: &Check<'_>, claims: &mut Claims<'_>, path: &str) -> Result<SimulatedMotor, BoardError> {
        check.motor(self.channel, ChannelKind::Actuator, format!("{path}.channel"))?;
        check.rail(self.rail, format!("{path}.rail"))?;
        claims.take("channel", self.channel, format!("{path}.channel"))?;
        let Potentiometer { input, low, high, noise_rms_codes } = self.potentiometer;
        check.reader.analog(input, format!("{path}.potentiometer.input"))?;
        claims.take("analog input", input, format!("{path}.potentiometer.input"))?;
        if low.position_m >= high.position_m {
            let field = format!("{path}.potentiometer.high.position_m");
            return Err(check.reader.rule(field, "must be above the low point's position_m"));
        }
        Ok(SimulatedMotor {
            channel: self.channel,
            plant: check.plant(&self.plant, format!("{path}.plant"))?,
            rail: self.rail,
            start: self.start_m,
            sensor: Some(SimulatedSensor::Potentiometer { input, low, high, noise_rms_codes }),
        })
    }
}

impl Rail {
    fn check(&self, check: &Check<'_>, claims: &mut Claims<'_>, index: usize) -> Result<SimulatedRail, BoardError> {
        let path = |field: &str| format!("simulation.rail[{index}].{field}");
        check.rail(self.channel, path("channel"))?;
        claims.take("channel", self.channel, path("channel"))?;
        check.reader.analog(self.analog, path("analog"))?;
        claims.take("analog input", self.analog, path("analog"))?;
        let &Self { channel, analog, volts_per_code, emf_v, resistance_ohm, noise_rms_codes } = self;
        let volts_per_code = volts_per_code.unwrap_or_else(|| check.reader.carrier.analog.volts_per_code());
        Ok(SimulatedRail { channel, analog, volts_per_code, emf_v, resistance_ohm, noise_rms_codes })
    }
}

struct Check<'c> {
    reader: &'c Reader<'c>,
    folder: &'c Folder,
    motors: &'c [ChannelId],
    supplies: &'c [ChannelId],
}

impl Check<'_> {
    fn motor(&self, id: ChannelId, kind: ChannelKind, path: String) -> Result<(), BoardError> {
        let known = self.motors.iter().filter(|motor| motor.kind == kind);
        self.reader.one_of("motor of that kind", id, known, path)
    }

    fn rail(&self, id: ChannelId, path: String) -> Result<(), BoardError> {
        self.reader.one_of("supply", id, self.supplies.iter(), path)
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
}
