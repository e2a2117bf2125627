//! One robot: what is plugged into a carrier, how it is controlled, and what the simulator takes for true.

mod linear;
mod read;
mod rotary;
mod simulation;

use r4_protocol::{channel::ChannelId, config::BoardConfig};

pub(crate) use read::read;

use crate::carrier::Carrier;

/// A robot that has been read and checked.
#[derive(Clone, Debug, PartialEq)]
pub struct Robot {
    /// The file it comes from.
    pub file: String,
    /// What the firmware is told.
    pub config: BoardConfig,
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
}

impl Simulation {
    /// Whether the robot's file says nothing about the true world, so that it can only be used as hardware.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.motors.is_empty() && self.rails.is_empty()
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
    /// What measures it.
    pub sensor: SimulatedSensor,
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
        /// Which encoder connector.
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
    /// Noise, standard deviation in codes of the 16-bit converter.
    pub noise_rms_codes: f64,
}
