//! A motor under experiment, watched with every sample.

use std::pin::pin;

use futures::future::{Either, select};
use r4_driver::{Board, Error as DriverError, TelemetryStream};
use r4_protocol::{ChannelId, Mode, SafetyState, Sample, Setpoint, Telemetry, Unit};

use crate::{Error, HostClock, Session, quantity::Quantity};

/// Telemetry may be silent for this long, s.
const SILENT_S: f64 = 0.3;

/// What ends an experiment with a motor. The board is disarmed then.
#[derive(Clone, Debug, thiserror::Error)]
pub enum WatchError {
    /// It is where it must not be.
    #[error("{channel} left the travel that was allowed, at {at}: from {low} to {high}")]
    Travel {
        /// The motor.
        channel: ChannelId,
        /// Its position.
        at: Quantity,
        /// The lowest position that was allowed.
        low: Quantity,
        /// The highest position that was allowed.
        high: Quantity,
    },
    /// The experiment takes too long.
    #[error("{channel} was not done within {limit_s:.0} s: --time allows more")]
    Time {
        /// The motor.
        channel: ChannelId,
        /// Time that was allowed, s.
        limit_s: f64,
    },
    /// It does not come to rest where it was sent.
    #[error("{channel} did not come to rest at {target} within {after_s:.1} s")]
    NotSettled {
        /// The motor.
        channel: ChannelId,
        /// Where it was sent.
        target: Quantity,
        /// How long it was waited for, s.
        after_s: f64,
    },
    /// The board tells nothing of it any more.
    #[error("no telemetry of {channel} for {SILENT_S} s")]
    Silent {
        /// The motor.
        channel: ChannelId,
    },
    /// Samples are missing.
    #[error("{lost} telemetry frames were lost: the experiment has holes")]
    Holes {
        /// Frames that were lost.
        lost: u64,
    },
}

/// What a motor did at one moment.
#[derive(Clone, Copy, Debug)]
pub struct Look {
    /// Time on the board's clock, s.
    pub time_s: f64,
    /// Set point that it followed.
    pub setpoint: Setpoint,
    /// Position, rad or m.
    pub position: f64,
    /// Speed, rad/s or m/s.
    pub speed: f64,
    /// Duty, as a share of the supply.
    pub duty: f64,
    /// Whether it rested at its set point.
    pub settled: bool,
}

/// A motor of an armed board, looked at with every sample: it must stay where it may be, be done in time, and nothing that it
/// does may be missed.
///
/// Samples from before the board was armed are passed over.
pub struct MotorWatch<'b> {
    board: &'b Board<HostClock>,
    channel: ChannelId,
    unit: Unit,
    resolution: f64,
    telemetry: TelemetryStream,
    /// Whether the board has been seen armed.
    armed: bool,
    /// Whether no sample may be missing.
    gapless: bool,
    /// Where the motor may be; anywhere while it is sent to where it begins.
    window: Option<(f64, f64)>,
    /// How long all may take, and until when on the board's clock, once it has begun, s.
    limit_s: f64,
    deadline_s: Option<f64>,
}

impl<'b> MotorWatch<'b> {
    /// Subscribes to `channel` with a sample each `every_ms`.
    ///
    /// # Errors
    /// When the board has no such channel, or refuses.
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

    /// Lets all that the motor does from its first look on take at most `limit_s`.
    #[must_use]
    pub fn within(mut self, limit_s: f64) -> Self {
        self.limit_s = limit_s;
        self
    }

    /// Takes a missing sample for an error.
    #[must_use]
    pub fn gapless(mut self) -> Self {
        self.gapless = true;
        self
    }

    /// The motor.
    #[must_use]
    pub fn channel(&self) -> ChannelId {
        self.channel
    }

    /// Where the motor must stay from now on, rad or m; `None` is anywhere.
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

    /// Where the motor is, rad or m, whether the board is armed or not.
    ///
    /// # Errors
    /// [`WatchError::Silent`]; when the link fails.
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

    /// The next look.
    ///
    /// # Errors
    /// [`WatchError`]; that the board stopped; when the link fails.
    pub async fn look(&mut self) -> Result<Look, Error> {
        loop {
            let frame = self.frame().await?;
            let lost = self.telemetry.dropped();
            if self.gapless && lost > 0 {
                return Err(WatchError::Holes { lost }.into());
            }
            // Under way since before it was armed.
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
    /// [`Error::NotCommanded`]
    pub async fn command(&mut self, mode: Mode, value: f64) -> Result<(), Error> {
        let (channel, setpoint) = (self.channel, Setpoint { mode, value: value as f32 });
        self.board.set(channel, setpoint).await.map_err(|source| Error::NotCommanded { channel, source })
    }

    /// Looks for `seconds` on the board's clock; at least once.
    ///
    /// # Errors
    /// As [`MotorWatch::look`].
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
    /// [`WatchError::NotSettled`] after `timeout_s`; as [`MotorWatch::look`] and [`MotorWatch::command`].
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
