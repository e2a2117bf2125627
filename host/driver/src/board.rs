//! Handle of a connected board: its requests, and the sending and repeating behind them.

use std::{
    collections::VecDeque,
    pin::pin,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, AtomicU16, Ordering},
    },
};

use futures::{
    channel::{mpsc, oneshot},
    future::{Either, select},
};
use r4_protocol::{
    Causes, ChannelId, ChannelInfo, DeviceInfo, DeviceStats, FaultInfo, FaultSnapshot, HotWinding, ImageInfo, LogInfo,
    Mode, ParameterInfo, ParameterKey, PathPoint, Refusal, Reply, Request, SafetyState, Sample, Setpoint, Spoken,
    Telemetry, ToDevice,
    config::{LINK_TIMEOUT_MS, MAX_NAME, PidGains, Tuning},
    message::{MAX_POINTS, MAX_RAW},
    version::{self, REPEATS, SPOKEN},
};

use crate::{
    Clock, Error,
    connection::{Answer, Pending, State},
    streams::{LogStream, SampleStream, SentStream, TelemetryStream, lock},
};

/// A request without an answer after this long has failed.
const REQUEST_TIMEOUT_MS: u32 = 500;
/// Time-out of requests that wait for the board's flash: erasing a sector takes 2 s, and the board gives up after 10 s.
const FLASH_TIMEOUT_MS: u32 = 11_000;
/// A request that may be repeated is sent again when no answer arrives within this time, until its time-out.
const REPEAT_AFTER_MS: u32 = 150;
/// Time-outs of successive hellos, ms. The first ones are short, so that a board that has just started is found soon;
/// the later ones allow for a slow link. A board that answers none of them counts as absent.
const HELLO_TIMEOUTS_MS: [u32; 5] = [100, 200, 400, 500, 500];
/// Set points older than this on arrival are refused by the board.
const SETPOINT_TTL_MS: u16 = 100;

/// Board with an open session; [`crate::with_board`] makes it.
pub struct Board<C> {
    pub(crate) wire: Wire<C>,
    info: DeviceInfo,
    channels: Vec<ChannelInfo>,
}

/// Request side of a connection: numbers requests, sends them, and matches answers to them.
pub(crate) struct Wire<C> {
    pub(crate) clock: C,
    pub(crate) state: Arc<Mutex<State>>,
    outgoing: mpsc::UnboundedSender<ToDevice>,
    next_seq: AtomicU16,
    /// The board remembers answered requests and carries out a repeated one only once: see [`REPEATS`].
    repeats: AtomicBool,
}

/// End condition of [`Board::drive`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Until {
    /// Ends when the motor rests at its position; after the time-out with an error.
    Settled {
        /// Longest wait for rest, s.
        timeout_s: f64,
    },
    /// Ends after a fixed time, whatever the motor does then.
    Elapsed {
        /// Duration from the command, s.
        seconds: f64,
    },
    /// Ends when the motor has found its home and rests; after the time-out with an error. For [`Mode::Home`].
    Homed {
        /// Longest search for the home switch, s.
        timeout_s: f64,
    },
}

/// State of a motor in the last sample that [`Board::drive`] received.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Position, rad or m; NaN for a motor without a position sensor.
    pub position: f64,
    /// Speed, rad/s or m/s; with [`Until::Elapsed`] the mean of the last 0.1 s.
    pub speed: f64,
    /// Duty as a share of the supply voltage; 0 for a stepper.
    pub duty: f64,
    /// The motor rests at its position.
    pub settled: bool,
    /// The position is referred to the home switch, not only counted from power-up.
    pub homed: bool,
    /// Time from the command to this sample, s.
    pub after_s: f64,
}

/// Telemetry period of a motor while it is driven, ms.
const LOOK_EVERY_MS: u16 = 10;
/// Averaging time of the speed that [`Until::Elapsed`] returns, s. One sample has the ripple of the encoder's counts:
/// ±5 % at 60 deg/s and 2400 counts per revolution. Half this time would average over five samples instead of ten.
const MEAN_SPEED_S: f64 = 0.1;

impl<C: Clock> Board<C> {
    /// Opens a session with a hello, then reads the description of each channel.
    pub(crate) async fn open(wire: Wire<C>) -> Result<Self, Error> {
        let (info, sent_us, version) = Self::hello(&wire).await?;
        wire.repeats.store(version >= REPEATS.since, Ordering::Relaxed);
        let heartbeat = lock(&wire.state).open(&info, sent_us, wire.clock.now_us());
        // Also wakes the transmitter, which keeps the session from now on.
        wire.send(heartbeat);
        let mut channels = Vec::new();
        for index in 0..info.channels {
            match wire.request("describe", Request::Describe { index }).await? {
                Reply::Channel(channel) => channels.push(channel),
                _ => return Err(Error::WrongReply { request: "describe" }),
            }
        }
        Ok(Self { wire, info, channels })
    }

    /// Sends a hello in the newest version that both ends speak. Returns the board's description, the host's time when
    /// that hello was sent, µs, and the version.
    async fn hello(wire: &Wire<C>) -> Result<(DeviceInfo, u64, u16), Error> {
        let mut says = SPOKEN[0];
        loop {
            let refused = match Self::hello_in(says, wire).await {
                Err(Error::Refused(Refusal::ProtocolMismatch { version, schema })) => Spoken { version, schema },
                told => return told.map(|(info, sent_us)| (info, sent_us, says.version)),
            };
            let Some(other) = version::again(&SPOKEN, says, refused) else {
                let Spoken { version, schema } = refused;
                return Err(Refusal::ProtocolMismatch { version, schema }.into());
            };
            says = other;
        }
    }

    /// Repeats the hello until the board answers: the first bytes on a fresh link are often lost or joined to others.
    async fn hello_in(Spoken { version, schema }: Spoken, wire: &Wire<C>) -> Result<(DeviceInfo, u64), Error> {
        let mut waited_ms = 0;
        for after_ms in HELLO_TIMEOUTS_MS {
            let sent_us = wire.clock.now_us();
            let hello = Request::Hello { version, schema };
            // Each hello has a new number: each opens a session of its own, and the last one counts.
            match wire.send_request("hello", hello, Some(after_ms)).await {
                // The heartbeat period follows from this time-out: with one out of range there would be no heartbeats,
                // or nothing else.
                Ok(Reply::Hello(info)) if LINK_TIMEOUT_MS.contains(&info.link_timeout_ms) => {
                    return Ok((info, sent_us));
                }
                Ok(_) => return Err(Error::WrongReply { request: "hello" }),
                Err(Error::TimedOut { after_ms, .. }) => waited_ms += after_ms,
                Err(error) => return Err(error),
            }
        }
        Err(Error::TimedOut { request: "hello", after_ms: waited_ms })
    }

    /// Ends the session. A lost answer changes nothing: without heartbeats the board ends the session by itself.
    pub(crate) async fn close(&self) {
        let _ = self.wire.request("bye", Request::Bye).await;
    }

    /// Description that the board gave when the session was opened.
    #[must_use]
    pub fn info(&self) -> &DeviceInfo {
        &self.info
    }

    /// Channels in the board's order, as the board describes them.
    #[must_use]
    pub fn channels(&self) -> &[ChannelInfo] {
        &self.channels
    }

    /// Returns the board's description of `channel`.
    ///
    /// # Errors
    /// [`Refusal::UnknownChannel`] when it has no such channel.
    pub fn channel(&self, channel: ChannelId) -> Result<&ChannelInfo, Error> {
        let found = self.channels.iter().find(|info| info.id == channel);
        found.ok_or(Error::Refused(Refusal::UnknownChannel { channel }))
    }

    /// Returns the safety state and causes from the board's last message that had them: a heartbeat, telemetry, the
    /// answer to a cycle, or the answer to arming.
    #[must_use]
    pub fn safety(&self) -> (SafetyState, Causes) {
        lock(&self.wire.state).safety.unwrap_or((SafetyState::Disarmed, Causes::NONE))
    }

    /// Motors with windings close to their temperature limit, from the board's last heartbeat. The board warns with
    /// them before it trips.
    #[must_use]
    pub fn hot_windings(&self) -> Vec<HotWinding> {
        lock(&self.wire.state).hot.clone()
    }

    /// Number of frames from the board that were damaged and dropped.
    #[must_use]
    pub fn bad_frames(&self) -> u64 {
        lock(&self.wire.state).bad_frames
    }

    /// Estimate of the board's clock now, µs, from the heartbeats.
    #[must_use]
    pub fn device_us(&self) -> u64 {
        lock(&self.wire.state).clock.device_us(self.wire.clock.now_us())
    }

    /// Time of the driver's clock at which the board's clock showed `device_us`, both µs; an estimate from the
    /// heartbeats.
    #[must_use]
    pub fn host_us(&self, device_us: u64) -> u64 {
        lock(&self.wire.state).clock.host_us(device_us)
    }

    /// Bound of the error of [`Board::device_us`] and [`Board::host_us`] now, µs. It contains half the shortest round
    /// trip, because a difference between the two directions cannot be observed.
    #[must_use]
    pub fn clock_uncertainty_us(&self) -> f64 {
        // The answer to the hello was the first round trip.
        lock(&self.wire.state).clock.uncertainty_us(self.wire.clock.now_us()).unwrap_or(f64::INFINITY)
    }

    /// Returns the time of the driver's clock, s.
    #[must_use]
    pub fn now_s(&self) -> f64 {
        self.wire.clock.now_us() as f64 * 1e-6
    }

    /// Waits for `seconds` of the driver's clock; a negative time counts as 0.
    pub async fn sleep_s(&self, seconds: f64) {
        self.wire.clock.sleep_until(self.wire.clock.now_us() + (seconds.max(0.0) * 1e6) as u64).await;
    }

    /// Arms the board: its outputs may move from now on.
    ///
    /// # Errors
    /// [`Refusal::CausesPresent`] or [`Refusal::Tripped`], besides the errors of any request.
    pub async fn arm(&self) -> Result<(), Error> {
        self.wire.done("arm", Request::Arm).await
    }

    /// Disarms the board, which makes its outputs safe.
    ///
    /// # Errors
    /// Those of any request.
    pub async fn disarm(&self) -> Result<(), Error> {
        self.wire.done("disarm", Request::Disarm).await
    }

    /// Clears a latched trip, which leaves the board disarmed.
    ///
    /// # Errors
    /// [`Refusal::CausesPresent`], besides the errors of any request.
    pub async fn clear(&self) -> Result<(), Error> {
        self.wire.done("clear", Request::Clear).await
    }

    /// Trips the board, as a stop button does.
    ///
    /// # Errors
    /// Those of any request.
    pub async fn stop(&self) -> Result<(), Error> {
        self.wire.done("stop", Request::Stop).await
    }

    /// Sends a set point to a channel. The board follows it from its next control period on.
    ///
    /// # Errors
    /// A refusal with the values that the channel accepts, besides the errors of any request. A refused set point stops
    /// the channel: it does not continue with the previous one.
    pub async fn set(&self, channel: ChannelId, setpoint: Setpoint) -> Result<(), Error> {
        self.wire.done("set", self.wire.set(channel, setpoint)).await
    }

    /// Sends a motor points of a path, dated on the board's clock. They replace the points it holds from the date of
    /// the first one on. The board keeps [`PATH_POINTS`](r4_protocol::message::PATH_POINTS) of them and follows the
    /// cubic between two; when the points end, it comes to rest along its profile. Paths of several channels, and of
    /// several boards by [`Board::device_us`], start together because their points have the same dates.
    ///
    /// # Errors
    /// [`Refusal::Late`], [`Refusal::PathFull`], [`Refusal::BadPath`], [`Refusal::TooFast`] and those of any set point,
    /// besides the errors of any request. Refused points stop the channel.
    pub async fn follow(&self, channel: ChannelId, points: &[PathPoint]) -> Result<(), Error> {
        // An empty path is sent too: the board refuses it.
        let none: &[PathPoint] = &[];
        for points in points.chunks(MAX_POINTS).chain(points.is_empty().then_some(none)) {
            let sent_us = lock(&self.wire.state).date_us(self.wire.clock.now_us());
            let points = points.iter().copied().collect();
            self.wire.done("follow", Request::Follow { channel, sent_us, points }).await?;
        }
        Ok(())
    }

    /// Changes the gains of one control loop until power-down.
    ///
    /// # Errors
    /// [`Refusal::BadGains`] or [`Refusal::WrongMode`], besides the errors of any request.
    pub async fn set_gains(&self, channel: ChannelId, mode: Mode, gains: PidGains) -> Result<(), Error> {
        self.wire.done("set gains", Request::SetGains { channel, mode, gains }).await
    }

    /// Changes a motor's feed-forward, and the loop that holds its positions, until power-down.
    ///
    /// # Errors
    /// [`Refusal::BadGains`] or [`Refusal::WrongMode`], besides the errors of any request.
    pub async fn set_tuning(&self, channel: ChannelId, tuning: Tuning) -> Result<(), Error> {
        self.wire.done("set tuning", Request::SetTuning { channel, tuning }).await
    }

    /// Subscribes to samples of `channel` every `period_ms`; 0 ends the subscription. [`Board::telemetry`] returns the
    /// samples.
    ///
    /// # Errors
    /// [`Refusal::TooManySubscriptions`], besides the errors of any request.
    pub async fn subscribe(&self, channel: ChannelId, period_ms: u16) -> Result<(), Error> {
        self.wire.done("subscribe", Request::Subscribe { channel, period_ms }).await?;
        let subscriptions = &mut lock(&self.wire.state).subscriptions;
        subscriptions.retain(|(other, _)| *other != channel);
        if period_ms > 0 {
            subscriptions.push((channel, period_ms));
        }
        Ok(())
    }

    /// Returns the subscribed channels, each with its period in ms, to subscribe to them again on a new connection.
    #[must_use]
    pub fn subscriptions(&self) -> Vec<(ChannelId, u16)> {
        lock(&self.wire.state).subscriptions.clone()
    }

    /// Subscribes to `channel` every `period_ms`, as [`Board::subscribe`] does, and returns a stream of its samples
    /// from now on. The period belongs to the channel: the last subscription sets it for all streams.
    ///
    /// # Errors
    /// Those of [`Board::subscribe`].
    pub async fn samples(&self, channel: ChannelId, period_ms: u16) -> Result<SampleStream, Error> {
        let samples = lock(&self.wire.state).samples.open(channel);
        self.subscribe(channel, period_ms).await?;
        Ok(samples)
    }

    /// Stream of every message but heartbeats, as it is sent from now on: to record the set points with the
    /// measurements.
    #[must_use]
    pub fn sent(&self) -> SentStream {
        lock(&self.wire.state).sent.open()
    }

    /// Starts the firmware's log. Returns the image that writes it (only its ELF file decodes it) and a stream that
    /// begins with the oldest text the board still holds. A second call in the same session continues at the present
    /// place.
    ///
    /// # Errors
    /// [`Refusal::NoLog`], besides the errors of any request.
    pub async fn log(&self) -> Result<(LogInfo, LogStream), Error> {
        // The stream is opened before the request, so that it misses nothing.
        let log = lock(&self.wire.state).log.open();
        match self.wire.request("log", Request::Log { on: true }).await? {
            Reply::Log(info) => Ok((info, log)),
            _ => Err(Error::WrongReply { request: "log" }),
        }
    }

    /// Stream of all telemetry from now on.
    #[must_use]
    pub fn telemetry(&self) -> TelemetryStream {
        lock(&self.wire.state).telemetry.open()
    }

    /// Returns the board's counters.
    ///
    /// # Errors
    /// Those of any request.
    pub async fn stats(&self) -> Result<DeviceStats, Error> {
        match self.wire.request("stats", Request::Stats).await? {
            Reply::Stats(stats) => Ok(stats),
            _ => Err(Error::WrongReply { request: "stats" }),
        }
    }

    /// Moves `channel` to `target` (rad or m) and waits at most `timeout_s` until it rests there.
    ///
    /// # Errors
    /// Those of [`Board::drive`].
    pub async fn move_to(&self, channel: ChannelId, target: f64, timeout_s: f64) -> Result<Motion, Error> {
        let setpoint = Setpoint { mode: Mode::Position, value: target as f32 };
        self.drive(channel, setpoint, Until::Settled { timeout_s }).await
    }

    /// Seeks the home switch of `channel` at `speed` (rad/s; its sign is the direction) and waits at most `timeout_s`
    /// until the channel rests there.
    ///
    /// # Errors
    /// Those of [`Board::drive`].
    pub async fn home(&self, channel: ChannelId, speed: f64, timeout_s: f64) -> Result<Motion, Error> {
        let setpoint = Setpoint { mode: Mode::Home, value: speed as f32 };
        self.drive(channel, setpoint, Until::Homed { timeout_s }).await
    }

    /// Sends a set point to `channel`, a motor or stepper, and follows its telemetry until `until`. The board continues
    /// to follow the set point afterwards.
    ///
    /// # Errors
    /// [`Error::Stopped`] when the board trips or is disarmed, [`Error::NotSettled`] or [`Error::NotHomed`] after the
    /// time-out, besides the errors of any request.
    pub async fn drive(&self, channel: ChannelId, setpoint: Setpoint, until: Until) -> Result<Motion, Error> {
        let info = self.channel(channel)?;
        let (unit, resolution) = (info.unit, f64::from(info.resolution));
        let (Until::Settled { timeout_s: limit_s }
        | Until::Elapsed { seconds: limit_s }
        | Until::Homed { timeout_s: limit_s }) = until;
        let (mut followed_once, mut searched) = (false, false);
        let mut speeds: VecDeque<(f64, f64)> = VecDeque::new();
        self.drive_until(channel, setpoint, limit_s, |sample, after_s| {
            let Sample::Motor { setpoint: followed, position, speed, duty, settled, homed, .. } = *sample else {
                return Ok(None);
            };
            match (followed == setpoint, followed_once) {
                (true, _) => followed_once = true,
                // This sample was on its way when the set point was sent, and still shows the previous one.
                (false, false) => return Ok(None),
                (false, true) => return Err(Error::NotFollowed { channel }),
            }
            searched |= !homed;
            let position = if resolution > 0.0 { f64::from(position) * resolution } else { f64::NAN };
            let mut speed = f64::from(speed);
            if let Until::Elapsed { .. } = until {
                speeds.push_back((after_s, speed));
                while speeds.front().is_some_and(|(at_s, _)| after_s - at_s >= MEAN_SPEED_S) {
                    speeds.pop_front();
                }
                speed = speeds.iter().map(|(_, speed)| speed).sum::<f64>() / speeds.len() as f64;
            }
            let motion = Motion { position, speed, duty: duty.into(), settled, homed, after_s };
            match until {
                Until::Settled { .. } if settled => Ok(Some(motion)),
                Until::Settled { timeout_s } if after_s > timeout_s => {
                    Err(Error::NotSettled { channel, target: setpoint.value.into(), position, unit, after_s })
                }
                Until::Elapsed { seconds } if after_s >= seconds => Ok(Some(motion)),
                Until::Homed { .. } if searched && homed && settled => Ok(Some(motion)),
                Until::Homed { timeout_s } if after_s > timeout_s => Err(Error::NotHomed { channel, after_s }),
                Until::Settled { .. } | Until::Elapsed { .. } | Until::Homed { .. } => Ok(None),
            }
        })
        .await
    }

    /// Sends a set point to `channel`, an output with one number, and returns that number after `seconds`: the value
    /// which the output then has, in its unit.
    ///
    /// # Errors
    /// [`Error::Stopped`] when the board trips or is disarmed, besides the errors of any request.
    pub async fn hold(&self, channel: ChannelId, setpoint: Setpoint, seconds: f64) -> Result<f64, Error> {
        self.channel(channel)?;
        self.drive_until(channel, setpoint, seconds, |sample, after_s| match *sample {
            Sample::Scalar { value, .. } if after_s >= seconds => Ok(Some(value.into())),
            _ => Ok(None),
        })
        .await
    }

    /// Sends a set point to `channel` and calls `look` with each of its samples and the seconds since the command,
    /// until it returns a result.
    async fn drive_until<T>(
        &self,
        channel: ChannelId,
        setpoint: Setpoint,
        limit_s: f64,
        mut look: impl FnMut(&Sample, f64) -> Result<Option<T>, Error>,
    ) -> Result<T, Error> {
        let mut telemetry = self.telemetry();
        self.subscribe(channel, LOOK_EVERY_MS).await?;
        let begin_us = self.device_us();
        self.set(channel, setpoint).await?;
        // The deadline is one of the driver's clock, because the telemetry may never show this set point.
        let deadline_us =
            self.wire.clock.now_us() + (limit_s.max(0.0) * 1e6) as u64 + u64::from(REQUEST_TIMEOUT_MS) * 1000;
        loop {
            let frame: Telemetry =
                match select(pin!(telemetry.next()), pin!(self.wire.clock.sleep_until(deadline_us))).await {
                    Either::Left((frame, _)) => frame?,
                    Either::Right(((), _)) => return Err(Error::NotFollowed { channel }),
                };
            if frame.state != SafetyState::Armed {
                return Err(Error::Stopped { causes: frame.causes });
            }
            let after_s = frame.device_us.saturating_sub(begin_us) as f64 / 1e6;
            for sample in frame.samples.iter().filter(|sample| sample.channel() == channel) {
                if let Some(done) = look(sample, after_s)? {
                    return Ok(done);
                }
            }
        }
    }

    /// Returns all parameters of the board's configuration, in the board's order.
    ///
    /// # Errors
    /// Those of any request.
    pub async fn parameters(&self) -> Result<Vec<ParameterInfo>, Error> {
        let mut parameters = Vec::new();
        loop {
            // The index fits 16 bits: a board has a few hundred parameters, at most 52 per channel.
            let index = parameters.len() as u16;
            match self.wire.request("describe parameter", Request::DescribeParameter { index }).await {
                Ok(Reply::Parameter(parameter)) => parameters.push(parameter),
                Ok(_) => return Err(Error::WrongReply { request: "describe parameter" }),
                Err(Error::Refused(Refusal::NoSuchIndex { .. })) => return Ok(parameters),
                Err(error) => return Err(error),
            }
        }
    }

    /// Changes a parameter. The board works with the new value after a restart, if [`Board::save_parameters`] has
    /// stored it.
    ///
    /// # Errors
    /// [`Refusal::UnknownParameter`] or [`Refusal::BadParameter`], besides the errors of any request.
    pub async fn set_parameter(&self, key: ParameterKey, value: f32) -> Result<(), Error> {
        self.wire.done("set parameter", Request::SetParameter { key, value }).await
    }

    /// Changes the robot's name, under the conditions of [`Board::set_parameter`].
    ///
    /// # Errors
    /// [`Error::NameTooLong`], besides the errors of any request.
    pub async fn set_name(&self, robot: &str) -> Result<(), Error> {
        let robot = robot.try_into().map_err(|_| Error::NameTooLong { most_bytes: MAX_NAME })?;
        self.wire.done("set name", Request::SetName { robot }).await
    }

    /// Stores all changes in flash, so that they survive a restart: all of them, or none if it fails. May take seconds.
    ///
    /// # Errors
    /// [`Refusal::NotWhile`] on an armed board, [`Refusal::StorageFailed`], besides the errors of any request.
    pub async fn save_parameters(&self) -> Result<(), Error> {
        self.wire.done("save parameters", Request::SaveParameters).await
    }

    /// Resets all parameters to the values built into the firmware; [`Board::save_parameters`] stores this too.
    ///
    /// # Errors
    /// Those of any request.
    pub async fn reset_parameters(&self) -> Result<(), Error> {
        self.wire.done("reset parameters", Request::ResetParameters).await
    }

    /// Restarts the board, which ends this session: connect again afterwards.
    ///
    /// # Errors
    /// [`Refusal::NotWhile`] on an armed board, besides the errors of any request.
    pub async fn restart(&self) -> Result<(), Error> {
        self.wire.done("restart", Request::Restart).await
    }

    /// Returns the identity of the image that the board runs.
    ///
    /// # Errors
    /// [`Refusal::NoImage`], besides the errors of any request.
    pub async fn image(&self) -> Result<ImageInfo, Error> {
        match self.wire.request("image", Request::Image).await? {
            Reply::Image(info) => Ok(info),
            _ => Err(Error::WrongReply { request: "image" }),
        }
    }

    /// Restarts the board into its bootloader, which ends this session.
    ///
    /// # Errors
    /// [`Refusal::NoBootloader`], [`Refusal::NotWhile`] on an armed board, besides the errors of any request.
    pub async fn restart_in_bootloader(&self) -> Result<(), Error> {
        self.wire.done("bootloader", Request::Bootloader).await
    }

    /// Returns the trips that the board remembers, the newest first.
    ///
    /// # Errors
    /// [`Refusal::StorageFailed`], besides the errors of any request.
    pub async fn faults(&self) -> Result<Vec<FaultInfo>, Error> {
        let mut faults: Vec<FaultInfo> = Vec::new();
        for index in 0..=u8::MAX {
            match self.fault(index).await {
                // A trip during this loop moves all others one place back, so one may appear twice.
                Ok(fault) if faults.last().is_some_and(|last| last.number <= fault.number) => {}
                Ok(fault) => faults.push(fault),
                Err(Error::Refused(Refusal::NoSuchFault)) => break,
                Err(error) => return Err(error),
            }
        }
        Ok(faults)
    }

    async fn fault(&self, index: u8) -> Result<FaultInfo, Error> {
        match self.wire.request("fault", Request::Fault { index }).await? {
            Reply::Fault(fault) => Ok(fault),
            _ => Err(Error::WrongReply { request: "fault" }),
        }
    }

    /// Returns the snapshots that the board took before trip `index`, the oldest first; 0 is the newest trip.
    ///
    /// # Errors
    /// [`Refusal::NoSuchFault`] when the board remembers no such trip, besides the errors of any request.
    pub async fn fault_snapshots(&self, index: u8) -> Result<Vec<FaultSnapshot>, Error> {
        let mut snapshots = Vec::new();
        for snapshot in 0..self.fault(index).await?.snapshots {
            match self.wire.request("fault snapshot", Request::FaultSnapshot { index, snapshot }).await? {
                Reply::FaultSnapshot(snapshot) => snapshots.push(snapshot),
                _ => return Err(Error::WrongReply { request: "fault snapshot" }),
            }
        }
        Ok(snapshots)
    }

    /// Writes to the device at 7-bit `address` of the external I2C connector `bus`, 0 or 1, then reads `read` bytes;
    /// either part may be empty.
    ///
    /// # Errors
    /// [`Refusal::BadTransfer`] for more than [`MAX_RAW`] bytes or an impossible transfer, [`Refusal::NoAcknowledge`],
    /// [`Refusal::TransferFailed`], besides the errors of any request.
    pub async fn i2c_transfer(&self, bus: u8, address: u8, write: &[u8], read: u8) -> Result<Vec<u8>, Error> {
        let write = write.try_into().map_err(|_| Refusal::BadTransfer)?;
        self.wire.bytes("I2C transfer", Request::I2cTransfer { bus, address, write, read }).await
    }

    /// Sends `bytes` through UART connector `port`, 0 or 1.
    ///
    /// # Errors
    /// [`Refusal::BadTransfer`] or [`Refusal::TransferFailed`], after which part of the bytes may have been sent,
    /// besides the errors of any request.
    pub async fn uart_write(&self, port: u8, bytes: &[u8]) -> Result<(), Error> {
        for bytes in bytes.chunks(MAX_RAW) {
            let bytes = bytes.try_into().map_err(|_| Refusal::BadTransfer)?;
            self.wire.done("UART write", Request::UartWrite { port, bytes }).await?;
        }
        Ok(())
    }

    /// Returns the bytes that UART connector `port`, 0 or 1, has received, at most [`MAX_RAW`]. Does not wait: the
    /// result may be empty.
    ///
    /// # Errors
    /// [`Refusal::BadTransfer`], besides the errors of any request.
    pub async fn uart_read(&self, port: u8) -> Result<Vec<u8>, Error> {
        self.wire.bytes("UART read", Request::UartRead { port }).await
    }
}

/// Returns the time-out of `request`, ms.
fn timeout_ms(request: &Request) -> u32 {
    match request {
        Request::SaveParameters | Request::Fault { .. } | Request::FaultSnapshot { .. } => FLASH_TIMEOUT_MS,
        _ => REQUEST_TIMEOUT_MS,
    }
}

/// Returns true for a request that may be sent again when no answer arrives: it is idempotent, or the board remembers
/// its answer (`remembers`). Excluded are requests with a date, those that reach an external device, and those that
/// wait for flash, which the board carries out one after another.
fn may_be_repeated(request: &Request, remembers: bool) -> bool {
    let is_same_twice = matches!(
        request,
        Request::Describe { .. }
            | Request::Stats
            | Request::Subscribe { .. }
            | Request::Log { .. }
            | Request::Image
            | Request::Bind { .. }
            | Request::DescribeParameter { .. }
            | Request::Disarm
            | Request::Stop
            | Request::Bye
    );
    let is_dated = matches!(request, Request::Set { .. } | Request::Follow { .. });
    is_same_twice || remembers && request.is_done_once() && !is_dated
}

impl<C: Clock> Wire<C> {
    pub(crate) fn new(clock: C, state: Arc<Mutex<State>>, outgoing: mpsc::UnboundedSender<ToDevice>) -> Self {
        // The first number comes from the clock, not 0: a late answer to the previous host must not match a request of
        // ours.
        let next_seq = AtomicU16::new((clock.now_us() >> 4) as u16);
        Self { clock, state, outgoing, next_seq, repeats: AtomicBool::new(false) }
    }

    pub(crate) async fn done(&self, name: &'static str, request: Request) -> Result<(), Error> {
        match self.request(name, request).await? {
            Reply::Done => Ok(()),
            _ => Err(Error::WrongReply { request: name }),
        }
    }

    async fn bytes(&self, name: &'static str, request: Request) -> Result<Vec<u8>, Error> {
        match self.request(name, request).await? {
            Reply::Bytes(bytes) => Ok(bytes.to_vec()),
            _ => Err(Error::WrongReply { request: name }),
        }
    }

    /// Makes the request for a set point with the present time as its date.
    pub(crate) fn set(&self, channel: ChannelId, setpoint: Setpoint) -> Request {
        let sent_us = lock(&self.state).date_us(self.clock.now_us());
        Request::Set { channel, setpoint, sent_us, ttl_ms: SETPOINT_TTL_MS }
    }

    /// Sends a request without waiting for its answer.
    pub(crate) fn tell(&self, request: Request) {
        let seq = self.next_seq.fetch_add(1, Ordering::Relaxed);
        self.send(ToDevice::Request { seq, request });
    }

    async fn request(&self, name: &'static str, request: Request) -> Result<Reply, Error> {
        self.send_request(name, request, None).await
    }

    /// Sends a request, at once and before everything that is sent later. The returned future resolves to its answer,
    /// and sends the request again where that is allowed and no answer arrives. Without `after_ms` the time-out is that
    /// of the request.
    ///
    /// # Errors
    /// Those of the future: [`Error::TimedOut`], a refusal, or the error that ended the link.
    pub(crate) fn send_request(
        &self,
        name: &'static str,
        request: Request,
        after_ms: Option<u32>,
    ) -> impl Future<Output = Result<Reply, Error>> + use<C> {
        let after_ms = after_ms.unwrap_or_else(|| timeout_ms(&request));
        let repeat_ms = match may_be_repeated(&request, self.repeats.load(Ordering::Relaxed)) {
            true => REPEAT_AFTER_MS,
            false => after_ms,
        };
        let (clock, outgoing) = (self.clock.clone(), self.outgoing.clone());
        let begin_us = clock.now_us();
        let waiting = self.begin(name, request == Request::Arm);
        // Sending fails only after the end of the link, when no other end exists.
        let send = move |seq| drop(outgoing.unbounded_send(ToDevice::Request { seq, request: request.clone() }));
        if let Ok(waiting) = &waiting {
            send(waiting.seq);
        }
        async move {
            let mut waiting = waiting?;
            let mut waited_ms = 0;
            loop {
                waited_ms = if waited_ms + 2 * repeat_ms > after_ms { after_ms } else { waited_ms + repeat_ms };
                let until_us = begin_us + u64::from(waited_ms) * 1000;
                if let Some(result) = waiting.answer(clock.sleep_until(until_us)).await {
                    return result;
                }
                if waited_ms >= after_ms {
                    return Err(Error::TimedOut { request: name, after_ms });
                }
                // The number stays the same: the first answer counts, and a second one matches no request.
                send(waiting.seq);
            }
        }
    }

    /// Assigns a number to a request and registers it for its answer.
    ///
    /// # Errors
    /// The error that ended the link.
    fn begin(&self, name: &'static str, arms: bool) -> Result<Waiting, Error> {
        let seq = self.next_seq.fetch_add(1, Ordering::Relaxed);
        let (sender, answer) = oneshot::channel();
        let mut state = lock(&self.state);
        if let Some(end) = &state.end {
            return Err(end.clone());
        }
        state.pending.insert(seq, Pending { answer: sender, arms });
        Ok(Waiting { state: self.state.clone(), name, seq, answer })
    }

    /// Queues a message behind the earlier ones; drops it after the end of the link.
    pub(crate) fn send(&self, message: ToDevice) {
        let _ = self.outgoing.unbounded_send(message);
    }
}

/// Request that waits for its answer.
struct Waiting {
    state: Arc<Mutex<State>>,
    name: &'static str,
    seq: u16,
    answer: oneshot::Receiver<Answer>,
}

impl Waiting {
    /// Waits for the answer, or the error that replaces it; `None` when `until` resolves first.
    async fn answer(&mut self, until: impl Future<Output = ()>) -> Option<Result<Reply, Error>> {
        match select(&mut self.answer, pin!(until)).await {
            Either::Left((Ok(Answer::Told(result)), _)) => Some(result.map_err(Error::from)),
            Either::Left((Ok(Answer::Unknown), _)) => Some(Err(Error::UnknownAnswer { request: self.name })),
            // The link ended, which dropped the sender.
            Either::Left((Err(_), _)) => {
                let end = lock(&self.state).end.clone();
                Some(Err(end.unwrap_or(Error::TimedOut { request: self.name, after_ms: 0 })))
            }
            Either::Right(((), _)) => None,
        }
    }
}

/// Dropping it removes the request from the table, also when its caller stopped waiting.
impl Drop for Waiting {
    fn drop(&mut self) {
        lock(&self.state).pending.remove(&self.seq);
    }
}
