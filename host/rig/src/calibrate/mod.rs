//! Calibration: measurement of the parameters that a board needs about its robot.
//!
//! Each kind measures with the active parameters, takes a person's measurement on the robot, and computes the
//! parameters from both. The board uses them from its next start on.

mod error;
mod motor;
mod servo;
#[cfg(test)]
mod tests;
mod wheel;

use std::future::Future;

use r4_driver::{Board, Clock};
use r4_protocol::{ChannelId, Parameter, ParameterInfo, ParameterKey, Sample, Unit};

use crate::{Error, Quantity, Session, parameters::Parameters};

pub use error::{CalibrateError, NoAnswer};

/// Person at the robot, who measures and answers.
pub trait Person {
    /// Asks a question and returns the answer, without surrounding white space. The session continues while a person
    /// thinks.
    ///
    /// # Errors
    /// [`NoAnswer`] when there is none.
    fn ask(&mut self, session: &Session<'_>, question: &str) -> impl Future<Output = Result<String, NoAnswer>>;
}

/// Kind of a calibration, with its options.
#[derive(Clone, Debug, PartialEq)]
pub enum Calibration {
    /// Counts per turn of a motor's encoder or of an encoder channel.
    Encoder {
        /// Channel of the motor or encoder.
        channel: ChannelId,
        /// Method by which the shaft is turned.
        by: Turning,
    },
    /// Both calibration points of a motor's potentiometer.
    Potentiometer {
        /// Channel of the motor.
        channel: ChannelId,
        /// True: the motor is driven to both positions, a tenth of its range from either end. False: a person moves it.
        drive: bool,
    },
    /// Oscillator of the chip that makes the servos' pulses.
    ServoOscillator {
        /// Channel of any servo; it is held at its largest pulse while a person measures that.
        channel: ChannelId,
    },
    /// Radius of wheels, and the track of a robot that steers by them.
    Wheels {
        /// Motors of the left wheels; or of all wheels, when only the radius is calibrated.
        left: Vec<ChannelId>,
        /// Motors of the right wheels; empty when only the radius is calibrated.
        right: Vec<ChannelId>,
        /// Angle by which every wheel turns.
        turn: Quantity,
    },
}

/// Method by which the shaft of a calibrated encoder is turned.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Turning {
    /// Turns by hand: whole turns between two readings at the same mark.
    ByHand {
        /// Number of turns forwards.
        turns: f64,
    },
    /// A drive by the motor, by an angle of the present calibration; a person measures the true one.
    Driven(Quantity),
}

/// Change of a parameter's value.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Change {
    /// Key of the parameter.
    pub parameter: ParameterKey,
    /// Value that is active now.
    pub from: f32,
    /// Value from the measurement.
    pub to: f32,
}

impl Change {
    fn new(info: &ParameterInfo, to: f64) -> Self {
        Self { parameter: info.key, from: info.active, to: to as f32 }
    }
}

/// Result of a calibration.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Found {
    /// Changed parameters of the board.
    pub changes: Vec<Change>,
    /// Values that are no parameters of the board: TOML for the robot's file.
    pub toml: Option<String>,
    /// Measurement and its uncertainty, in words.
    pub note: String,
}

impl Found {
    /// Sets and saves the changed parameters, which the board uses from its next start on.
    ///
    /// # Errors
    /// [`CalibrateError::NotTaken`] when the board refuses a value; [`CalibrateError::NotSaved`] when it cannot save.
    pub async fn save(&self, session: &Session<'_>) -> Result<(), Error> {
        for &Change { parameter, to, .. } in &self.changes {
            let set = session.board.set_parameter(parameter, to).await;
            set.map_err(|source| CalibrateError::NotTaken { parameter, to, source })?;
        }
        Ok(session.board.save_parameters().await.map_err(CalibrateError::NotSaved)?)
    }
}

/// Runs a calibration: arms where something is driven, and asks `person` for measurements. Nothing is saved.
///
/// # Errors
/// [`CalibrateError`] for a calibration without a result; the error of the board when it refuses or stops, of a motor
/// that does not arrive, or of the link.
pub async fn calibrate(
    session: &Session<'_>,
    calibration: &Calibration,
    person: &mut impl Person,
) -> Result<Found, Error> {
    match calibration {
        Calibration::Encoder { channel, by } => motor::encoder(session, person, *channel, *by).await,
        Calibration::Potentiometer { channel, drive } => motor::potentiometer(session, person, *channel, *drive).await,
        Calibration::ServoOscillator { channel } => servo::oscillator(session, person, *channel).await,
        Calibration::Wheels { left, right, turn } => wheel::run(session, person, left, right, *turn).await,
    }
}

impl Parameters {
    /// Parameter that the channel must have.
    fn need(
        &self,
        channel: ChannelId,
        parameter: Parameter,
        why: &'static str,
    ) -> Result<&ParameterInfo, CalibrateError> {
        self.get(Some(channel), parameter).ok_or(CalibrateError::Unfit { channel, why })
    }
}

/// Telemetry period of a channel, ms, and averaging time, s.
const LOOK_EVERY_MS: u16 = 5;
const LOOK_S: f64 = 0.3;

/// Position of a channel in counts of its resolution: the mean over [`LOOK_S`], in which it must not move.
async fn counts<C: Clock>(board: &Board<C>, channel: ChannelId) -> Result<f64, Error> {
    board.channel(channel)?;
    let mut telemetry = board.telemetry();
    board.subscribe(channel, LOOK_EVERY_MS).await?;
    let (mut sum, mut count, mut begin_us) = (0.0, 0_u32, None);
    loop {
        let frame = telemetry.next().await?;
        let position = frame.samples.iter().find_map(|sample| match *sample {
            Sample::Motor { channel: of, position, .. } | Sample::Encoder { channel: of, position, .. }
                if of == channel =>
            {
                Some(position)
            }
            _ => None,
        });
        let Some(position) = position else { continue };
        sum += f64::from(position);
        count += 1;
        let begin_us = *begin_us.get_or_insert(frame.device_us);
        if frame.device_us.saturating_sub(begin_us) as f64 * 1e-6 >= LOOK_S {
            return Ok(sum / f64::from(count));
        }
    }
}

/// Parses an answered quantity, which must be in `unit`.
fn read(answer: &str, unit: Unit, example: &str) -> Result<f64, CalibrateError> {
    let wrong = |why| CalibrateError::WrongAnswer { answer: answer.to_owned(), why };
    let quantity: Quantity = answer.parse().map_err(wrong)?;
    if quantity.unit != unit {
        return Err(wrong(format!("write it as in {example}")));
    }
    Ok(quantity.value)
}
