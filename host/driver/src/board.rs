//! A connected board.

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
    connection::{Answer, State},
    streams::{LogStream, SampleStream, SentStream, TelemetryStream, lock},
};

/// A request without an answer after this long has failed.
const REQUEST_TIMEOUT_MS: u32 = 500;
/// The same for what waits for the board's flash, of which a sector takes 2 s to erase: the board gives up after 10 s.
const FLASH_TIMEOUT_MS: u32 = 11_000;
/// A request that may be repeated is, when there is no answer after this long; as often as its time allows.
const REPEAT_AFTER_MS: u32 = 150;
/// How long a hello waits for its answer, again and again: a board that has just come back is found soon, and one on a slow
/// link at all. One that answers none of them is not there.
const HELLO_TIMEOUTS_MS: [u32; 5] = [100, 200, 400, 500, 500];
/// Set points older than this on arrival are refused by the board.
const SETPOINT_TTL_MS: u16 = 100;

/// A board with an open session. Made by [`crate::with_board`].
pub struct Board<C> {
    pub(crate) wire: Wire<C>,
    info: DeviceInfo,
    channels: Vec<ChannelInfo>,
}

/// Requests and their answers.
pub(crate) struct Wire<C> {
    pub(crate) clock: C,
    pub(crate) state: Arc<Mutex<State>>,
    outgoing: mpsc::UnboundedSender<ToDevice>,
    next_seq: AtomicU16,
    /// The board does what is sent again once: see [`REPEATS`].
    repeats: AtomicBool,
}

/// How long [`Board::drive`] follows a motor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Until {
    /// Until it rests at its position; after the time-out it is an error.
    Settled {
        /// s
        timeout_s: f64,
    },
    /// For this long.
    Elapsed {
        /// s
        seconds: f64,
    },
    /// Until it has found its home and rests; after the time-out it is an error. For [`Mode::Home`].
    Homed {
        /// s
        timeout_s: f64,
    },
}

/// What a motor did when [`Board::drive`] looked last.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// rad or m; NaN for a motor whose position nothing measures.
    pub position: f64,
    /// rad/s or m/s; with [`Until::Elapsed`] the mean of the last 0.1 s.
    pub speed: f64,
    /// Share of the supply; 0 for a stepper.
    pub duty: f64,
    /// Whether it rested at its position.
    pub settled: bool,
    /// Whether its position was known, and not only counted from where power came on.
    pub homed: bool,
    /// From the command to that look, s.
    pub after_s: f64,
}

/// How often a motor is looked at while it is driven, ms.
const LOOK_EVERY_MS: u16 = 10;
/// The speed at the end of a time is the mean over this time, s. One sample has the ripple of the encoder's counts: ±5 % at
/// 60 deg/s and 2400 counts a turn. Halved, the mean would be over five samples instead of ten.
const MEAN_SPEED_S: f64 = 0.1;

impl<C: Clock> Board<C> {
    /// Says hello and asks for every channel.
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

    /// Says hello in the newest version that both speak.
    /// Returns that, too, and when the hello was sent.
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

    /// Says hello until it is answered: the first bytes on a fresh link are often lost or glued to others.
    async fn hello_in(Spoken { version, schema }: Spoken, wire: &Wire<C>) -> Result<(DeviceInfo, u64), Error> {
        let mut waited_ms = 0;
        for after_ms in HELLO_TIMEOUTS_MS {
            let sent_us = wire.clock.now_us();
            let hello = Request::Hello { version, schema };
            // Not the same one again: each opens a session of its own, and the last one counts.
            match wire.send_request("hello", hello, Some(after_ms)).await {
                // Heartbeats go by it: with another there would be none, or nothing else.
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

    /// Ends the session. Whether the answer arrives changes nothing: without heartbeats the board ends it too.
    pub(crate) async fn close(&self) {
        let _ = self.wire.request("bye", Request::Bye).await;
    }

    /// Who this is, as told when the session was opened.
    #[must_use]
    pub fn info(&self) -> &DeviceInfo {
        &self.info
    }

    /// The channels, as the board describes them.
    #[must_use]
    pub fn channels(&self) -> &[ChannelInfo] {
        &self.channels
    }

    /// What the board says of `channel`.
    ///
    /// # Errors
    /// [`Refusal::UnknownChannel`] when it has no such channel.
    pub fn channel(&self, channel: ChannelId) -> Result<&ChannelInfo, Error> {
        let found = self.channels.iter().find(|info| info.id == channel);
        found.ok_or(Error::Refused(Refusal::UnknownChannel { channel }))
    }

    /// Where the supervisor stood when it was last heard of.
    #[must_use]
    pub fn safety(&self) -> (SafetyState, Causes) {
        lock(&self.wire.state).safety.unwrap_or((SafetyState::Disarmed, Causes::NONE))
    }

    /// Motors whose windings are close to what they withstand, and how hot they are, when the board was last heard of: it is the
    /// board that warns, before it trips.
    #[must_use]
    pub fn hot_windings(&self) -> Vec<HotWinding> {
        lock(&self.wire.state).hot.clone()
    }

    /// Frames from the board that were damaged and dropped.
    #[must_use]
    pub fn bad_frames(&self) -> u64 {
        lock(&self.wire.state).bad_frames
    }

    /// The board's clock now, µs, as far as heartbeats tell.
    #[must_use]
    pub fn device_us(&self) -> u64 {
        lock(&self.wire.state).clock.device_us(self.wire.clock.now_us())
    }

    /// The driver's clock when the board's showed `device_us`, both in µs, as far as heartbeats tell.
    #[must_use]
    pub fn host_us(&self, device_us: u64) -> u64 {
        lock(&self.wire.state).clock.host_us(device_us)
    }

    /// How wrong [`Board::device_us`] and [`Board::host_us`] may be now, µs. Half the shortest round trip is in it: that one
    /// way takes longer than the other cannot be seen.
    #[must_use]
    pub fn clock_uncertainty_us(&self) -> f64 {
        // The answer to the hello was the first round trip.
        lock(&self.wire.state).clock.uncertainty_us(self.wire.clock.now_us()).unwrap_or(f64::INFINITY)
    }

    /// Seconds on the driver's clock.
    #[must_use]
    pub fn now_s(&self) -> f64 {
        self.wire.clock.now_us() as f64 * 1e-6
    }

    /// Waits.
    pub async fn sleep_s(&self, seconds: f64) {
        self.wire.clock.sleep_until(self.wire.clock.now_us() + (seconds.max(0.0) * 1e6) as u64).await;
    }

    /// Lets outputs move.
    ///
    /// # Errors
    /// [`Refusal::CausesPresent`] or [`Refusal::Tripped`], besides what befalls any request.
    pub async fn arm(&self) -> Result<(), Error> {
        self.wire.done("arm", Request::Arm).await
    }

    /// Makes outputs safe.
    ///
    /// # Errors
    /// What befalls any request.
    pub async fn disarm(&self) -> Result<(), Error> {
        self.wire.done("disarm", Request::Disarm).await
    }

    /// Leaves a trip behind.
    ///
    /// # Errors
    /// [`Refusal::CausesPresent`], besides what befalls any request.
    pub async fn clear(&self) -> Result<(), Error> {
        self.wire.done("clear", Request::Clear).await
    }

    /// Trips the board.
    ///
    /// # Errors
    /// What befalls any request.
    pub async fn stop(&self) -> Result<(), Error> {
        self.wire.done("stop", Request::Stop).await
    }

    /// Commands a channel. The board follows it from its next control period on.
    ///
    /// # Errors
    /// A refusal that says what the channel takes, besides the errors of any request. A refused set point stops the channel:
    /// it does not go on with the one before.
    pub async fn set(&self, channel: ChannelId, setpoint: Setpoint) -> Result<(), Error> {
        self.wire.done("set", self.wire.set(channel, setpoint)).await
    }

    /// Gives a motor points of a path, dated on the board's clock, in place of those it has from the first of these on. The board
    /// keeps [`PATH_POINTS`](r4_protocol::message::PATH_POINTS) of them and goes along the cubic between two; without more it comes to rest along its profile. Paths of
    /// several channels, and of several boards by [`Board::device_us`], begin together because their dates do.
    ///
    /// # Errors
    /// [`Refusal::Late`], [`Refusal::PathFull`], [`Refusal::BadPath`], [`Refusal::TooFast`] and those of any set point, besides
    /// the errors of any request. Refused points stop the channel.
    pub async fn follow(&self, channel: ChannelId, points: &[PathPoint]) -> Result<(), Error> {
        // A path without points is refused by the board.
        let none: &[PathPoint] = &[];
        for points in points.chunks(MAX_POINTS).chain(points.is_empty().then_some(none)) {
            let sent_us = lock(&self.wire.state).date_us(self.wire.clock.now_us());
            let points = points.iter().copied().collect();
            self.wire.done("follow", Request::Follow { channel, sent_us, points }).await?;
        }
        Ok(())
    }

    /// Changes the gains of one loop until power-down.
    ///
    /// # Errors
    /// [`Refusal::BadGains`] or [`Refusal::WrongMode`], besides what befalls any request.
    pub async fn set_gains(&self, channel: ChannelId, mode: Mode, gains: PidGains) -> Result<(), Error> {
        self.wire.done("set gains", Request::SetGains { channel, mode, gains }).await
    }

    /// Changes a motor's feed-forward, and which loop holds its positions, until power-down.
    ///
    /// # Errors
    /// [`Refusal::BadGains`] or [`Refusal::WrongMode`], besides what befalls any request.
    pub async fn set_tuning(&self, channel: ChannelId, tuning: Tuning) -> Result<(), Error> {
        self.wire.done("set tuning", Request::SetTuning { channel, tuning }).await
    }

    /// Asks for samples of `channel` every `period_ms`; 0 ends them. Read them from [`Board::telemetry`].
    ///
    /// # Errors
    /// [`Refusal::TooManySubscriptions`], besides what befalls any request.
    pub async fn subscribe(&self, channel: ChannelId, period_ms: u16) -> Result<(), Error> {
        self.wire.done("subscribe", Request::Subscribe { channel, period_ms }).await?;
        let subscriptions = &mut lock(&self.wire.state).subscriptions;
        subscriptions.retain(|(other, _)| *other != channel);
        if period_ms > 0 {
            subscriptions.push((channel, period_ms));
        }
        Ok(())
    }

    /// What is subscribed to, and every how many ms: to be asked for again on a new connection.
    #[must_use]
    pub fn subscriptions(&self) -> Vec<(ChannelId, u16)> {
        lock(&self.wire.state).subscriptions.clone()
    }

    /// Subscribes to `channel` every `period_ms`, as [`Board::subscribe`] does, and gives its samples from now on. The period is
    /// the channel's: the last one asked for holds for all who read it.
    ///
    /// # Errors
    /// As [`Board::subscribe`].
    pub async fn samples(&self, channel: ChannelId, period_ms: u16) -> Result<SampleStream, Error> {
        let samples = lock(&self.wire.state).samples.open(channel);
        self.subscribe(channel, period_ms).await?;
        Ok(samples)
    }

    /// Every message but heartbeats, when it leaves from now on: for a record of what was asked.
    #[must_use]
    pub fn sent(&self) -> SentStream {
        lock(&self.wire.state).sent.open()
    }

    /// What the firmware logs, from the oldest that the board still has on, and which image writes it: only its ELF decodes it.
    /// Asked for again in the same session, it goes on where it is.
    ///
    /// # Errors
    /// [`Refusal::NoLog`], besides what befalls any request.
    pub async fn log(&self) -> Result<(LogInfo, LogStream), Error> {
        // Before the board is asked, so that nothing is missed.
        let log = lock(&self.wire.state).log.open();
        match self.wire.request("log", Request::Log { on: true }).await? {
            Reply::Log(info) => Ok((info, log)),
            _ => Err(Error::WrongReply { request: "log" }),
        }
    }

    /// All telemetry from now on.
    #[must_use]
    pub fn telemetry(&self) -> TelemetryStream {
        lock(&self.wire.state).telemetry.open()
    }

    /// What the board has counted.
    ///
    /// # Errors
    /// What befalls any request.
    pub async fn stats(&self) -> Result<DeviceStats, Error> {
        match self.wire.request("stats", Request::Stats).await? {
            Reply::Stats(stats) => Ok(stats),
            _ => Err(Error::WrongReply { request: "stats" }),
        }
    }

    /// Sends `channel` to `target` (rad or m) and waits until it rests there, at most `timeout_s`.
    ///
    /// # Errors
    /// As [`Board::drive`].
    pub async fn move_to(&self, channel: ChannelId, target: f64, timeout_s: f64) -> Result<Motion, Error> {
        let setpoint = Setpoint { mode: Mode::Position, value: target as f32 };
        self.drive(channel, setpoint, Until::Settled { timeout_s }).await
    }

    /// Seeks the home switch of `channel` at `speed` (rad/s, its sign being the direction) and waits until the channel rests
    /// there, at most `timeout_s`.
    ///
    /// # Errors
    /// As [`Board::drive`].
    pub async fn home(&self, channel: ChannelId, speed: f64, timeout_s: f64) -> Result<Motion, Error> {
        let setpoint = Setpoint { mode: Mode::Home, value: speed as f32 };
        self.drive(channel, setpoint, Until::Homed { timeout_s }).await
    }

    /// Commands `channel`, a motor or stepper, and follows it by its telemetry. The board keeps following the set point
    /// afterwards.
    ///
    /// # Errors
    /// [`Error::Stopped`] when the board trips or is disarmed, [`Error::NotSettled`] or [`Error::NotHomed`] after the
    /// time-out, besides what befalls any request.
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
                // Under way when the command was sent, and so still of the last one.
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

    /// Commands `channel`, an output that has one number, and returns that number after `seconds`: what the output is
    /// then told, in its unit.
    ///
    /// # Errors
    /// [`Error::Stopped`] when the board trips or is disarmed, besides what befalls any request.
    pub async fn hold(&self, channel: ChannelId, setpoint: Setpoint, seconds: f64) -> Result<f64, Error> {
        self.channel(channel)?;
        self.drive_until(channel, setpoint, seconds, |sample, after_s| match *sample {
            Sample::Scalar { value, .. } if after_s >= seconds => Ok(Some(value.into())),
            _ => Ok(None),
        })
        .await
    }

    /// Commands `channel` and shows `look` its samples, with the seconds since the command, until that returns something.
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
        // By our clock, should the board's telemetry never show what was asked for.
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

    /// Every parameter of the board's configuration, in its order.
    ///
    /// # Errors
    /// What befalls any request.
    pub async fn parameters(&self) -> Result<Vec<ParameterInfo>, Error> {
        let mut parameters = Vec::new();
        loop {
            // A board has some hundreds, at most 52 for each of its channels.
            let index = parameters.len() as u16;
            match self.wire.request("describe parameter", Request::DescribeParameter { index }).await {
                Ok(Reply::Parameter(parameter)) => parameters.push(parameter),
                Ok(_) => return Err(Error::WrongReply { request: "describe parameter" }),
                Err(Error::Refused(Refusal::NoSuchIndex { .. })) => return Ok(parameters),
                Err(error) => return Err(error),
            }
        }
    }

    /// Changes a parameter. The board works with it after a restart, if [`Board::save_parameters`] has kept it.
    ///
    /// # Errors
    /// [`Refusal::UnknownParameter`] or [`Refusal::BadParameter`], besides what befalls any request.
    pub async fn set_parameter(&self, key: ParameterKey, value: f32) -> Result<(), Error> {
        self.wire.done("set parameter", Request::SetParameter { key, value }).await
    }

    /// Changes the robot's name, as [`Board::set_parameter`] does a number.
    ///
    /// # Errors
    /// [`Error::NameTooLong`], besides what befalls any request.
    pub async fn set_name(&self, robot: &str) -> Result<(), Error> {
        let robot = robot.try_into().map_err(|_| Error::NameTooLong { most_bytes: MAX_NAME })?;
        self.wire.done("set name", Request::SetName { robot }).await
    }

    /// Keeps all changes over a restart: all of them, or none if it fails. May take seconds.
    ///
    /// # Errors
    /// [`Refusal::NotWhile`] on an armed board, [`Refusal::StorageFailed`], besides what befalls any request.
    pub async fn save_parameters(&self) -> Result<(), Error> {
        self.wire.done("save parameters", Request::SaveParameters).await
    }

    /// Takes all changes back to what the firmware was built with; kept by [`Board::save_parameters`] too.
    ///
    /// # Errors
    /// What befalls any request.
    pub async fn reset_parameters(&self) -> Result<(), Error> {
        self.wire.done("reset parameters", Request::ResetParameters).await
    }

    /// Restarts the board, which ends this session: connect again afterwards.
    ///
    /// # Errors
    /// [`Refusal::NotWhile`] on an armed board, besides what befalls any request.
    pub async fn restart(&self) -> Result<(), Error> {
        self.wire.done("restart", Request::Restart).await
    }

    /// Which image the board runs.
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

    /// The trips that the board remembers, the newest first.
    ///
    /// # Errors
    /// [`Refusal::StorageFailed`], besides what befalls any request.
    pub async fn faults(&self) -> Result<Vec<FaultInfo>, Error> {
        let mut faults: Vec<FaultInfo> = Vec::new();
        for index in 0..=u8::MAX {
            match self.fault(index).await {
                // A trip meanwhile moves all others one back.
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

    /// What the board looked like before trip `index`, 0 being the newest trip; the oldest look first.
    ///
    /// # Errors
    /// [`Refusal::NoSuchFault`] when it remembers no such trip, besides what befalls any request.
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
    /// either may be nothing.
    ///
    /// # Errors
    /// [`Refusal::BadTransfer`] for more than [`MAX_RAW`] bytes or what cannot be, [`Refusal::NoAcknowledge`],
    /// [`Refusal::TransferFailed`], besides what befalls any request.
    pub async fn i2c_transfer(&self, bus: u8, address: u8, write: &[u8], read: u8) -> Result<Vec<u8>, Error> {
        let write = write.try_into().map_err(|_| Refusal::BadTransfer)?;
        self.wire.bytes("I2C transfer", Request::I2cTransfer { bus, address, write, read }).await
    }

    /// Sends `bytes` out of UART connector `port`, 0 or 1.
    ///
    /// # Errors
    /// [`Refusal::BadTransfer`] or [`Refusal::TransferFailed`], when part of the bytes may have been sent, besides what
    /// befalls any request.
    pub async fn uart_write(&self, port: u8, bytes: &[u8]) -> Result<(), Error> {
        for bytes in bytes.chunks(MAX_RAW) {
            let bytes = bytes.try_into().map_err(|_| Refusal::BadTransfer)?;
            self.wire.done("UART write", Request::UartWrite { port, bytes }).await?;
        }
        Ok(())
    }

    /// Takes what UART connector `port`, 0 or 1, has received, up to [`MAX_RAW`] bytes. Never waits: there may be nothing.
    ///
    /// # Errors
    /// [`Refusal::BadTransfer`], besides what befalls any request.
    pub async fn uart_read(&self, port: u8) -> Result<Vec<u8>, Error> {
        self.wire.bytes("UART read", Request::UartRead { port }).await
    }
}

/// How long the answer to `request` may take.
fn timeout_ms(request: &Request) -> u32 {
    match request {
        Request::SaveParameters | Request::Fault { .. } | Request::FaultSnapshot { .. } => FLASH_TIMEOUT_MS,
        _ => REQUEST_TIMEOUT_MS,
    }
}

/// Whether it may be sent again when no answer comes: doing it twice is doing it once, or the board does it once (`remembers`). Not what is
/// dated or reaches an external device, and not what waits for flash, of which a board does one after another.
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
        // Not from 0: an answer to a host before us, still under way, must not pass for one to us.
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

    /// A set point that is decided now.
    pub(crate) fn set(&self, channel: ChannelId, setpoint: Setpoint) -> Request {
        let sent_us = lock(&self.state).date_us(self.clock.now_us());
        Request::Set { channel, setpoint, sent_us, ttl_ms: SETPOINT_TTL_MS }
    }

    /// Sends a request whose answer nobody waits for.
    pub(crate) fn tell(&self, request: Request) {
        let seq = self.next_seq.fetch_add(1, Ordering::Relaxed);
        self.send(ToDevice::Request { seq, request });
    }

    async fn request(&self, name: &'static str, request: Request) -> Result<Reply, Error> {
        self.send_request(name, request, None).await
    }

    /// Sends a request, at once and before everything that is sent later. The future is its answer, and sends the request again where that may
    /// be done and no answer comes. Without `after_ms` the answer may take as long as the request allows.
    ///
    /// # Errors
    /// Of the future: [`Error::TimedOut`], a refusal, or why the link has ended.
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
        let waiting = self.begin(name);
        // After the end of the link there is nobody to send it to.
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
                // With the same number: whichever answer comes first is taken, and the other is passed over.
                send(waiting.seq);
            }
        }
    }

    /// Makes a number for a request, whose answer is waited for from now on.
    ///
    /// # Errors
    /// Why the link has ended.
    fn begin(&self, name: &'static str) -> Result<Waiting, Error> {
        let seq = self.next_seq.fetch_add(1, Ordering::Relaxed);
        let (sender, answer) = oneshot::channel();
        let mut state = lock(&self.state);
        if let Some(end) = &state.end {
            return Err(end.clone());
        }
        state.pending.insert(seq, sender);
        Ok(Waiting { state: self.state.clone(), name, seq, answer })
    }

    /// Sends a message after those before. After the end of the link there is nobody to tell.
    pub(crate) fn send(&self, message: ToDevice) {
        let _ = self.outgoing.unbounded_send(message);
    }
}

/// A request that waits for its answer.
struct Waiting {
    state: Arc<Mutex<State>>,
    name: &'static str,
    seq: u16,
    answer: oneshot::Receiver<Answer>,
}

impl Waiting {
    /// The answer, or why there will be none; `None` when `until` was first.
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

/// Also when nobody waits any more.
impl Drop for Waiting {
    fn drop(&mut self) {
        lock(&self.state).pending.remove(&self.seq);
    }
}
