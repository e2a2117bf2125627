//! What a board has to be told about the robot it is in, measured.
//!
//! Each kind measures with the parameters that hold now, takes what a person has measured on the robot, and computes from both
//! what the parameters should be. The board works with them from its next start on.

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

/// Somebody at the robot, who measures and answers.
pub trait Person {
    /// Asks a question and returns the answer, without white space around it. The session goes on while a person thinks.
    ///
    /// # Errors
    /// [`NoAnswer`]
    fn ask(&mut self, session: &Session<'_>, question: &str) -> impl Future<Output = Result<String, NoAnswer>>;
}

/// What is calibrated, and how.
#[derive(Clone, Debug, PartialEq)]
pub enum Calibration {
    /// Counts per turn of a motor's encoder or of an encoder channel.
    Encoder {
        /// The motor or encoder.
        channel: ChannelId,
        /// How its shaft is turned.
        by: Turning,
    },
    /// Both calibration points of a motor's potentiometer.
    Potentiometer {
        /// The motor.
        channel: ChannelId,
        /// Whether it is driven to both places, a tenth of its range from either end; otherwise a person moves it.
        drive: bool,
    },
    /// Oscillator of the chip that makes the servos' pulses.
    ServoOscillator {
        /// Any servo; it is held at its largest pulse while a person measures that.
        channel: ChannelId,
    },
    /// Radius of wheels, and the track of a robot that steers by them.
    Wheels {
        /// Motors of the left wheels, or of all, for the radius only.
        left: Vec<ChannelId>,
        /// Motors of the right wheels.
        right: Vec<ChannelId>,
        /// How far every wheel turns, an angle.
        turn: Quantity,
    },
}

/// How a shaft is turned whose encoder is calibrated.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Turning {
    /// By hand, by whole turns between two looks at the same mark.
    ByHand {
        /// Turns forwards.
        turns: f64,
    },
    /// By its motor, by an angle that the board believes; a person tells how far it really went.
    Driven(Quantity),
}

/// A parameter that should have another number.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Change {
    /// The parameter.
    pub parameter: ParameterKey,
    /// Its number in force.
    pub from: f32,
    /// The number that was measured.
    pub to: f32,
}

impl Change {
    fn new(info: &ParameterInfo, to: f64) -> Self {
        Self { parameter: info.key, from: info.active, to: to as f32 }
    }
}

/// The result of a calibration.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Found {
    /// Parameters of the board.
    pub changes: Vec<Change>,
    /// What is no parameter of the board, for the robot's file.
    pub toml: Option<String>,
    /// What was measured and how sure it is, in words.
    pub note: String,
}

impl Found {
    /// Sets the parameters that were found and keeps them; they hold from the board's next start on.
    ///
    /// # Errors
    /// [`CalibrateError::NotTaken`], [`CalibrateError::NotSaved`]
    pub async fn save(&self, session: &Session<'_>) -> Result<(), Error> {
        for &Change { parameter, to, .. } in &self.changes {
            let set = session.board.set_parameter(parameter, to).await;
            set.map_err(|source| CalibrateError::NotTaken { parameter, to, source })?;
        }
        Ok(session.board.save_parameters().await.map_err(CalibrateError::NotSaved)?)
    }
}

/// Measures, arming where something is to be driven, and asks `person` what only a person can see. Nothing is saved.
///
/// # Errors
/// [`CalibrateError`]; when the board refuses or stops, a motor does not arrive, or the link fails.
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
    /// One that the channel must have.
    fn need(
        &self,
        channel: ChannelId,
        parameter: Parameter,
        why: &'static str,
    ) -> Result<&ParameterInfo, CalibrateError> {
        self.get(Some(channel), parameter).ok_or(CalibrateError::Unfit { channel, why })
    }
}

/// How often a channel is looked at, ms, and over how long, s.
const LOOK_EVERY_MS: u16 = 5;
const LOOK_S: f64 = 0.3;

/// Where a channel is, in counts of its resolution: the mean over a moment in which it must not move.
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

/// A quantity that was answered, which must be in `unit`.
fn read(answer: &str, unit: Unit, example: &str) -> Result<f64, CalibrateError> {
    let wrong = |why| CalibrateError::WrongAnswer { answer: answer.to_owned(), why };
    let quantity: Quantity = answer.parse().map_err(wrong)?;
    if quantity.unit != unit {
        return Err(wrong(format!("write it as in {example}")));
    }
    Ok(quantity.value)
}
