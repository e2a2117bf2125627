//! A motor under experiment, watched with every sample.

use std::pin::pin;

use anyhow::Context;
use futures::future::{Either, select};
use r4_driver::{Board, Error, TelemetryStream, tune::Loop};
use r4_protocol::{ChannelId, Mode, SafetyState, Sample, Setpoint, Unit};

use crate::session::{HostClock, Session};
use r4_rig::quantity::Quantity;

/// How often the motor is looked at, ms.
pub(super) const LOOK_EVERY_MS: u16 = 2;
pub(super) const LOOK_EVERY_S: f64 = LOOK_EVERY_MS as f64 * 1e-3;
/// Telemetry may be silent for this long, s.
const SILENT_S: f64 = 0.3;

/// What ends an experiment. The board is disarmed then.
#[derive(Clone, Debug, thiserror::Error)]
pub(super) enum Abort {
    #[error("{channel} left the travel that was allowed, at {at}: from {low} to {high}")]
    Travel { channel: ChannelId, at: Quantity, low: Quantity, high: Quantity },
    #[error("{channel} was not done within {limit_s:.0} s: --time allows more")]
    Time { channel: ChannelId, limit_s: f64 },
    #[error("{channel} did not come to rest at {target} within {after_s:.1} s")]
    NotSettled { channel: ChannelId, target: Quantity, after_s: f64 },
    #[error("no telemetry of {channel} for {SILENT_S} s")]
    Silent { channel: ChannelId },
    #[error("{lost} telemetry frames were lost: the experiment has holes")]
    Holes { lost: u64 },
}

/// What a motor did at one moment, in SI.
#[derive(Clone, Copy, Debug)]
pub(super) struct Look {
    /// On the board's clock, s.
    pub(super) time_s: f64,
    pub(super) setpoint: Setpoint,
    pub(super) position: f64,
    pub(super) speed: f64,
    pub(super) duty: f64,
    pub(super) settled: bool,
}

impl Look {
    /// What this loop measures.
    pub(super) fn output(&self, of: Loop) -> f64 {
        match of {
            Loop::Position => self.position,
            Loop::Speed => self.speed,
        }
    }
}

/// A motor under experiment.
pub(super) struct Rig<'b> {
    board: &'b Board<HostClock>,
    channel: ChannelId,
    unit: Unit,
    resolution: f64,
    telemetry: TelemetryStream,
    /// Whether the board has been seen armed.
    armed: bool,
    /// Where the motor may be; anywhere while it is sent to where it begins.
    window: Option<(f64, f64)>,
    /// How long all may take, and until when on the board's clock, once it has begun, s.
    limit_s: f64,
    deadline_s: Option<f64>,
}

impl<'b> Rig<'b> {
    /// `channel`, seen every [`LOOK_EVERY_MS`]; all it does may take `limit_s`.
    pub(super) async fn new(session: &Session<'b>, channel: ChannelId, limit_s: f64) -> anyhow::Result<Self> {
        let board = session.board;
        let info = board.channel(channel)?;
        let telemetry = board.telemetry();
        board.subscribe(channel, LOOK_EVERY_MS).await?;
        Ok(Self {
            board,
            channel,
            unit: info.unit,
            resolution: info.resolution.into(),
            telemetry,
            armed: false,
            window: None,
            limit_s,
            deadline_s: None,
        })
    }

    /// Where the motor is, armed or not.
    pub(super) async fn position(&mut self) -> anyhow::Result<f64> {
        loop {
            let frame = match select(pin!(self.telemetry.next()), pin!(self.board.sleep_s(SILENT_S))).await {
                Either::Left((frame, _)) => frame?,
                Either::Right(_) => return Err(Abort::Silent { channel: self.channel }.into()),
            };
            let position = frame.samples.iter().find_map(|sample| match *sample {
                Sample::Motor { channel, position, .. } if channel == self.channel => Some(position),
                _ => None,
            });
            if let Some(position) = position {
                return Ok(f64::from(position) * self.resolution);
            }
        }
    }

    /// Where the motor must stay from now on.
    pub(super) fn stay_within(&mut self, window: Option<(f64, f64)>) {
        self.window = window;
    }

    fn quantity(&self, value: f64) -> Quantity {
        Quantity::new(value, self.unit)
    }

    /// The next look.
    ///
    /// # Errors
    /// [`Abort`], or that the board stopped.
    pub(super) async fn look(&mut self) -> anyhow::Result<Look> {
        loop {
            let frame = match select(pin!(self.telemetry.next()), pin!(self.board.sleep_s(SILENT_S))).await {
                Either::Left((frame, _)) => frame?,
                Either::Right(_) => return Err(Abort::Silent { channel: self.channel }.into()),
            };
            let lost = self.telemetry.dropped();
            if lost > 0 {
                return Err(Abort::Holes { lost }.into());
            }
            // Under way since before it was armed.
            if !self.armed && frame.state == SafetyState::Disarmed {
                continue;
            }
            self.armed = true;
            if frame.state != SafetyState::Armed {
                return Err(Error::Stopped { causes: frame.causes }.into());
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
                return Err(Abort::Travel { channel: self.channel, at, low, high }.into());
            }
            if time_s > *self.deadline_s.get_or_insert(time_s + self.limit_s) {
                return Err(Abort::Time { channel: self.channel, limit_s: self.limit_s }.into());
            }
            return Ok(look);
        }
    }

    /// Commands the motor.
    pub(super) async fn command(&mut self, mode: Mode, value: f64) -> anyhow::Result<()> {
        let setpoint = Setpoint { mode, value: value as f32 };
        self.board.set(self.channel, setpoint).await.with_context(|| format!("cannot command {}", self.channel))
    }

    /// Looks for `seconds` on the board's clock.
    pub(super) async fn watch(&mut self, seconds: f64) -> anyhow::Result<Vec<Look>> {
        let first = self.look().await?;
        let mut looks = vec![first];
        while looks.last().is_some_and(|last| last.time_s - first.time_s < seconds) {
            looks.push(self.look().await?);
        }
        Ok(looks)
    }

    /// Sends the motor to a position and waits until it rests there.
    pub(super) async fn go_to(&mut self, target: f64, timeout_s: f64) -> anyhow::Result<()> {
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
                return Err(Abort::NotSettled { channel: self.channel, target, after_s }.into());
            }
        }
    }
}
