//! Watch over a motor in an experiment, with every telemetry sample.

use std::pin::pin;

use futures::future::{Either, select};
use r4_driver::{Board, Error as DriverError, TelemetryStream};
use r4_protocol::{ChannelId, Mode, SafetyState, Sample, Setpoint, Telemetry, Unit};

use crate::{Error, HostClock, Session, quantity::Quantity};

/// Timeout of the telemetry, s.
const SILENT_S: f64 = 0.3;

/// Error that ends an experiment with a motor. The board is disarmed then.
#[derive(Clone, Debug, thiserror::Error)]
pub enum WatchError {
    /// The motor left its allowed travel.
    #[error("{channel} left the travel that was allowed, at {at}: from {low} to {high}")]
    Travel {
        /// Channel of the motor.
        channel: ChannelId,
        /// Position of the motor.
        at: Quantity,
        /// Lowest allowed position of the motor.
        low: Quantity,
        /// Highest allowed position of the motor.
        high: Quantity,
    },
    /// The experiment exceeds its time limit.
    #[error("{channel} was not done within {limit_s:.0} s: --time allows more")]
    Time {
        /// Channel of the motor.
        channel: ChannelId,
        /// Time limit of the experiment, s.
        limit_s: f64,
    },
    /// The motor does not settle at its set point.
    #[error("{channel} did not come to rest at {target} within {after_s:.1} s")]
    NotSettled {
        /// Channel of the motor.
        channel: ChannelId,
        /// Position that it was sent to.
        target: Quantity,
        /// Time since the set point, s.
        after_s: f64,
    },
    /// Telemetry of the motor has stopped.
    #[error("no telemetry of {channel} for {SILENT_S} s")]
    Silent {
        /// Channel of the motor.
        channel: ChannelId,
    },
    /// Samples are missing, which the experiment does not allow.
    #[error("{lost} telemetry frames were lost: the experiment has holes")]
    Holes {
        /// Number of lost telemetry frames.
        lost: u64,
    },
}

/// Sample of a motor at one moment.
#[derive(Clone, Copy, Debug)]
pub struct Look {
    /// Time on the board's clock, s.
    pub time_s: f64,
    /// Set point in force.
    pub setpoint: Setpoint,
    /// Position, rad or m.
    pub position: f64,
    /// Speed, rad/s or m/s.
    pub speed: f64,
    /// Duty as a share of the supply, -1 to 1.
    pub duty: f64,
    /// True when the motor rested at its set point.
    pub settled: bool,
}

/// A motor of an armed board, checked with every sample: it must stay within its travel and time limit, and no sample
/// may be missed.
///
/// Samples from before the board was armed are skipped.
pub struct MotorWatch<'b> {
    board: &'b Board<HostClock>,
    channel: ChannelId,
    unit: Unit,
    resolution: f64,
    telemetry: TelemetryStream,
    /// True once the board has been seen armed.
    armed: bool,
    /// True when no sample may be missing.
    gapless: bool,
    /// Allowed travel, rad or m; `None` allows any position, while the motor is sent to its start.
    window: Option<(f64, f64)>,
    /// Time limit, s; and deadline on the board's clock, s, set by the first sample.
    limit_s: f64,
    deadline_s: Option<f64>,
}

impl<'b> MotorWatch<'b> {
    /// Subscribes to `channel` with a sample every `every_ms`.
    ///
    /// # Errors
    /// [`Error::Board`] when the board has no such channel, or refuses.
    pub async fn new(session: &Session<'b>, channel: ChannelId, every_ms: u16) -> Result<Self, Error> {
        let board = session.board;
        let info = board.channel(channel)?;
        let telemetry = board.telemetry();
        board.subscribe(channel, every_ms).await?;
        Ok(Self {
            board,
            channel,
            unit: info.unit,
            resolution: info.resolution.into(),
            telemetry,
            armed: false,
            gapless: false,
            window: None,
            limit_s: f64::INFINITY,
            deadline_s: None,
        })
    }

    /// Sets a time limit for everything from the first sample on, s.
    #[must_use]
    pub fn within(mut self, limit_s: f64) -> Self {
        self.limit_s = limit_s;
        self
    }

    /// Makes a missing sample an error.
    #[must_use]
    pub fn gapless(mut self) -> Self {
        self.gapless = true;
        self
    }

    /// Channel of the motor.
    #[must_use]
    pub fn channel(&self) -> ChannelId {
        self.channel
    }

    /// Sets the allowed travel from now on, rad or m; `None` allows any position.
    pub fn stay_within(&mut self, window: Option<(f64, f64)>) {
        self.window = window;
    }

    fn quantity(&self, value: f64) -> Quantity {
        Quantity::new(value, self.unit)
    }

    async fn frame(&mut self) -> Result<Telemetry, Error> {
        match select(pin!(self.telemetry.next()), pin!(self.board.sleep_s(SILENT_S))).await {
            Either::Left((frame, _)) => Ok(frame?),
            Either::Right(_) => Err(WatchError::Silent { channel: self.channel }.into()),
        }
    }

    /// Returns the position of the motor, rad or m, whether the board is armed or not.
    ///
    /// # Errors
    /// [`WatchError::Silent`] without telemetry; the error of the link.
    pub async fn position(&mut self) -> Result<f64, Error> {
        loop {
            let frame = self.frame().await?;
            let counts = frame.samples.iter().find_map(|sample| match *sample {
                Sample::Motor { channel, position, .. } if channel == self.channel => Some(position),
                _ => None,
            });
            if let Some(counts) = counts {
                return Ok(f64::from(counts) * self.resolution);
            }
        }
    }

    /// Waits for the next sample and checks it.
    ///
    /// # Errors
    /// [`WatchError`] when a limit is exceeded; the cause when the board stopped; the error of the link.
    pub async fn look(&mut self) -> Result<Look, Error> {
        loop {
            let frame = self.frame().await?;
            let lost = self.telemetry.dropped();
            // A fit would take the samples around a gap as neighbours in time.
            if self.gapless && lost > 0 {
                return Err(WatchError::Holes { lost }.into());
            }
            // This frame was sent before the board armed.
            if !self.armed && frame.state == SafetyState::Disarmed {
                continue;
            }
            self.armed = true;
            if frame.state != SafetyState::Armed {
                return Err(DriverError::Stopped { causes: frame.causes }.into());
            }
            let time_s = frame.device_us as f64 * 1e-6;
            let look = frame.samples.iter().find_map(|sample| match *sample {
                Sample::Motor { channel, setpoint, position, speed, duty, settled, .. } if channel == self.channel => {
                    let position = f64::from(position) * self.resolution;
                    Some(Look { time_s, setpoint, position, speed: speed.into(), duty: duty.into(), settled })
                }
                _ => None,
            });
            let Some(look) = look else { continue };
            if let Some((low, high)) = self.window
                && !(low..=high).contains(&look.position)
            {
                let [at, low, high] = [look.position, low, high].map(|value| self.quantity(value));
                return Err(WatchError::Travel { channel: self.channel, at, low, high }.into());
            }
            if time_s > *self.deadline_s.get_or_insert(time_s + self.limit_s) {
                return Err(WatchError::Time { channel: self.channel, limit_s: self.limit_s }.into());
            }
            return Ok(look);
        }
    }

    /// Commands the motor; the unit of `value` is that of the mode.
    ///
    /// # Errors
    /// [`Error::NotCommanded`] when the board refuses.
    pub async fn command(&mut self, mode: Mode, value: f64) -> Result<(), Error> {
        let (channel, setpoint) = (self.channel, Setpoint { mode, value: value as f32 });
        self.board.set(channel, setpoint).await.map_err(|source| Error::NotCommanded { channel, source })
    }

    /// Samples the motor for `seconds` on the board's clock, at least once.
    ///
    /// # Errors
    /// The errors of [`MotorWatch::look`].
    pub async fn watch(&mut self, seconds: f64) -> Result<Vec<Look>, Error> {
        let first = self.look().await?;
        let mut looks = vec![first];
        while looks.last().is_some_and(|last| last.time_s - first.time_s < seconds) {
            looks.push(self.look().await?);
        }
        Ok(looks)
    }

    /// Sends the motor to a position, rad or m, and waits until it rests there.
    ///
    /// # Errors
    /// [`WatchError::NotSettled`] after `timeout_s`; the errors of [`MotorWatch::look`] and [`MotorWatch::command`].
    pub async fn go_to(&mut self, target: f64, timeout_s: f64) -> Result<(), Error> {
        self.command(Mode::Position, target).await?;
        let asked = Setpoint { mode: Mode::Position, value: target as f32 };
        let mut begin_s = None;
        loop {
            let look = self.look().await?;
            if look.settled && look.setpoint == asked {
                return Ok(());
            }
            let after_s = look.time_s - *begin_s.get_or_insert(look.time_s);
            if after_s > timeout_s {
                let target = self.quantity(target);
                return Err(WatchError::NotSettled { channel: self.channel, target, after_s }.into());
            }
        }
    }
}
