//! The messages, in both directions.
//!
//! postcard sends the position of an enum's variant: append variants and fields, never reorder or remove.

use core::fmt;

use heapless::{String, Vec};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::{
    channel::{ChannelId, ChannelInfo, MAX_QUANTITIES, Mode, Range},
    config::{MAX_MOTORS, MAX_NAME, MAX_SUPPLIES, PidGains, Tuning},
    cycle::{CYCLE_CHANNELS, Cycle, CycleChannel, CycleState},
    image::ImageInfo,
    log::{LogChunk, LogInfo},
    parameter::ParameterKey,
    state::{Causes, SafetyState},
};

/// Most samples in one [`Telemetry`] frame.
pub const MAX_SAMPLES: usize = 8;

/// Host to board.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum ToDevice {
    /// Something that is answered by exactly one [`ToHost::Response`] with the same `seq`.
    Request {
        /// Chosen by the host, echoed by the board.
        seq: u16,
        /// What is asked.
        request: Request,
    },
    /// "I am alive". Answered by [`ToHost::Heartbeat`]; without one for the link timeout the board trips.
    Heartbeat {
        /// From [`DeviceInfo`]; a heartbeat of another session does not count.
        session: u16,
        /// The host's clock, echoed back.
        host_us: u64,
    },
    /// Set points for the channels of [`Request::Bind`]. Answered by exactly one [`ToHost::Cycle`] with the same `seq`.
    Cycle(Cycle),
}

/// Board to host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum ToHost {
    /// The answer to one request.
    Response {
        /// Of the request.
        seq: u16,
        /// What came of it.
        result: Result<Reply, Refusal>,
    },
    /// The answer to a heartbeat.
    Heartbeat {
        /// From the heartbeat that is answered.
        host_us: u64,
        /// The board's clock when it answered.
        device_us: u64,
        /// Where the supervisor stands.
        state: SafetyState,
        /// Causes latched by a trip.
        causes: Causes,
        /// Motors whose windings are close to what they withstand: see [`Winding::hot`].
        hot: Vec<HotWinding, MAX_MOTORS>,
    },
    /// Samples of subscribed channels.
    Telemetry(Telemetry),
    /// The answer to a cycle.
    Cycle(CycleState),
    /// What the firmware has logged, after [`Request::Log`].
    Log(LogChunk),
}

/// What a host can ask.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum Request {
    /// Opens a session. Must come first; its encoding never changes, so that any two versions can agree or refuse each other: see
    /// [`crate::version`].
    Hello {
        /// [`crate::VERSION`] in which the host wants to talk.
        version: u16,
        /// [`crate::SCHEMA_HASH`] of that version.
        schema: u64,
    },
    /// Closes the session: disarms, ends subscriptions, and the missing heartbeat no longer trips.
    Bye,
    /// Describes channel number `index` in the board's list.
    Describe {
        /// 0 to [`DeviceInfo::channels`] - 1.
        index: u8,
    },
    /// Lets outputs move.
    Arm,
    /// Makes outputs safe in an orderly way.
    Disarm,
    /// Leaves a trip, once no cause is present.
    Clear,
    /// Trips the board: outputs safe, latched.
    Stop,
    /// Commands one channel. One that is refused stops the channel, unless the channel follows a set point that was decided later.
    Set {
        /// Which.
        channel: ChannelId,
        /// To what.
        setpoint: Setpoint,
        /// When the host decided this, on the board's clock.
        sent_us: u64,
        /// How long after `sent_us` it may still be carried out.
        ttl_ms: u16,
    },
    /// Samples of `channel` every `period_ms`; 0 ends them.
    Subscribe {
        /// Which.
        channel: ChannelId,
        /// How often.
        period_ms: u16,
    },
    /// Changes the gains of one loop, without a jump of its output.
    SetGains {
        /// Which.
        channel: ChannelId,
        /// Which of its loops, [`Mode::Position`] or [`Mode::Speed`].
        mode: Mode,
        /// The new gains.
        gains: PidGains,
    },
    /// Counters since power-up.
    Stats,
    /// Describes parameter number `index` of the board's configuration.
    DescribeParameter {
        /// From 0; [`Refusal::NoSuchIndex`] ends the list.
        index: u16,
    },
    /// Changes a parameter; it holds from the next start on, if [`Request::SaveParameters`] follows.
    SetParameter {
        /// Which.
        key: ParameterKey,
        /// In the unit of its field.
        value: f32,
    },
    /// Changes the robot's name, as [`Request::SetParameter`] does a number.
    SetName {
        /// The new name.
        robot: String<MAX_NAME>,
    },
    /// Keeps all changes over a restart: all of them, or none if it fails.
    SaveParameters,
    /// Goes back to what the firmware was built with; saved by [`Request::SaveParameters`] too.
    ResetParameters,
    /// Restarts the board. Refused while it is armed.
    Restart,
    /// A trip out of the history.
    Fault {
        /// 0 is the newest.
        index: u8,
    },
    /// What the board looked like before a trip.
    FaultSnapshot {
        /// Which trip; 0 is the newest.
        index: u8,
        /// Which of its snapshots; 0 is the oldest.
        snapshot: u8,
    },
    /// A transfer on one of the external I2C connectors: a write, then a read, either of which may be empty.
    I2cTransfer {
        /// 0 or 1.
        bus: u8,
        /// 7-bit address.
        address: u8,
        /// Bytes to write.
        write: Vec<u8, MAX_RAW>,
        /// How many bytes to read, up to [`MAX_RAW`].
        read: u8,
    },
    /// Sends bytes out of a UART connector.
    UartWrite {
        /// 0 or 1.
        port: u8,
        /// What to send.
        bytes: Vec<u8, MAX_RAW>,
    },
    /// Takes bytes that a UART connector has received, as many as fit the answer.
    UartRead {
        /// 0 or 1.
        port: u8,
    },
    /// Says what [`ToDevice::Cycle`] over this link means from now on, until the session ends. No channels end it.
    Bind {
        /// In the order of the cycle's numbers.
        channels: Vec<CycleChannel, CYCLE_CHANNELS>,
        /// How long after it was decided a set point may be carried out, and is followed if no other comes.
        ttl_ms: u16,
    },
    /// Sends what the firmware logs, from the oldest that the board still has on, until the session ends or this ends it.
    /// Everything else goes before it.
    Log {
        /// Whether to send it.
        on: bool,
    },
    /// Which image the board runs.
    Image,
    /// Restarts the board into the bootloader that started it, which takes another image over USB. Refused while the board is
    /// armed, and by an image without a bootloader.
    Bootloader,
    /// Gives a channel points of a path, in place of those it has from the first of these on. All are taken or none; refused ones
    /// stop the channel as in [`Request::Set`]. A path that ends at a speed is left along the channel's profile, to rest.
    Follow {
        /// Which.
        channel: ChannelId,
        /// When the host decided this, on the board's clock.
        sent_us: u64,
        /// In the order of their dates.
        points: Vec<PathPoint, MAX_POINTS>,
    },
    /// Changes a motor's feed-forward, and which loop holds its positions, until the next start.
    SetTuning {
        /// Which.
        channel: ChannelId,
        /// The new numbers.
        tuning: Tuning,
    },
}

impl Request {
    /// Whether a board does it once where it is sent again with the same `seq`, in sessions of version
    /// [`REPEATS.since`](crate::version::REPEATS) and later: doing it again would be something else by then, as arming after a disarm, or a set point after
    /// a newer one.
    #[must_use]
    pub const fn is_done_once(&self) -> bool {
        matches!(
            self,
            Self::Arm
                | Self::Clear
                | Self::Set { .. }
                | Self::Follow { .. }
                | Self::SetGains { .. }
                | Self::SetTuning { .. }
                | Self::SetParameter { .. }
                | Self::SetName { .. }
                | Self::ResetParameters
        )
    }
}

/// Most points in one [`Request::Follow`].
pub const MAX_POINTS: usize = 4;
/// Points that a board keeps for each channel, the ones it has passed not counted.
pub const PATH_POINTS: usize = 32;

/// Where a channel is to be at one moment. Between two points it follows the cubic with their positions and speeds (Hermite).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct PathPoint {
    /// When, on the board's clock.
    pub at_us: u64,
    /// rad or m
    pub position: f32,
    /// rad/s or m/s; `None` for the slope at this point of the parabola through it and its neighbours.
    pub speed: Option<f32>,
    /// Duty that is added to the loops' own from the point before to this one, as a share of the supply; 0 for none.
    pub feed_forward: f32,
}

/// Most bytes in one raw transfer.
pub const MAX_RAW: usize = 64;
/// Most bytes of the firmware's version.
pub const MAX_FIRMWARE: usize = 16;

/// A command to a channel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Setpoint {
    /// How the number is meant.
    pub mode: Mode,
    /// rad or m; rad/s or m/s; share of the supply; V; 0 or 1.
    pub value: f32,
}

impl Setpoint {
    /// What a channel follows that has not been told anything.
    pub const NONE: Self = Self { mode: Mode::Duty, value: 0.0 };
}

/// What a board answers when it does as asked.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum Reply {
    /// To [`Request::Hello`].
    Hello(DeviceInfo),
    /// To [`Request::Describe`].
    Channel(ChannelInfo),
    /// To [`Request::Stats`].
    Stats(DeviceStats),
    /// To everything else: it was done.
    Done,
    /// To [`Request::DescribeParameter`].
    Parameter(ParameterInfo),
    /// To [`Request::Fault`].
    Fault(FaultInfo),
    /// To [`Request::FaultSnapshot`].
    FaultSnapshot(FaultSnapshot),
    /// To [`Request::I2cTransfer`] and [`Request::UartRead`].
    Bytes(Vec<u8, MAX_RAW>),
    /// To [`Request::Log`].
    Log(LogInfo),
    /// To [`Request::Image`].
    Image(ImageInfo),
}

/// A parameter and its values.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ParameterInfo {
    /// Which.
    pub key: ParameterKey,
    /// What the board works with.
    pub active: f32,
    /// What it will work with after a restart, if that is saved.
    pub set: f32,
    /// What the firmware was built with.
    pub built_in: f32,
}

/// A trip out of the history.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct FaultInfo {
    /// Counts trips over the board's life; the newest has the highest.
    pub number: u32,
    /// Counts starts of the board, as the history knows them.
    pub start: u32,
    /// Since that start.
    pub device_us: u64,
    /// Every cause, up to when it was recorded.
    pub causes: Causes,
    /// How many [`Request::FaultSnapshot`]s there are.
    pub snapshots: u8,
}

/// What the board looked like at one moment before a trip.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct FaultSnapshot {
    /// Before the trip.
    pub before_ms: u16,
    /// In the order of the board's motor channels.
    pub motors: Vec<MotorSnapshot, MAX_MOTORS>,
    /// In the order of the board's supply channels, V.
    pub supplies_v: Vec<f32, MAX_SUPPLIES>,
}

/// What a motor did at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct MotorSnapshot {
    /// In counts of [`ChannelInfo::resolution`].
    pub position: i32,
    /// rad/s or m/s.
    pub speed: f32,
    /// Share of the supply at the bridge.
    pub duty: f32,
}

/// Who answers, and the session it opened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct DeviceInfo {
    /// The robot's name.
    pub robot: String<MAX_NAME>,
    /// Version of the firmware.
    pub firmware: String<MAX_FIRMWARE>,
    /// For heartbeats.
    pub session: u16,
    /// How many channels [`Request::Describe`] knows.
    pub channels: u8,
    /// The host must send heartbeats more often than this.
    pub link_timeout_ms: u16,
    /// The board's clock.
    pub device_us: u64,
    /// Where the supervisor stands.
    pub state: SafetyState,
    /// Causes latched by a trip.
    pub causes: Causes,
}

/// The share of the processor that a control period is promised to take at most, in 99.9 % of them.
pub const CONTROL_SHARE: f32 = 0.04;

/// What the board counted since power-up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct DeviceStats {
    /// Control ticks run.
    pub ticks: u32,
    /// Control ticks that ended after the next one was due.
    pub late_ticks: u32,
    /// Longest time from the start of a tick to its last output written.
    pub worst_tick_us: u32,
    /// I2C transfers that failed and were repeated.
    pub bus_retries: u32,
    /// Frames taken.
    pub frames: u32,
    /// Frames dropped: bad encoding or checksum, too long, or no message of this version.
    pub bad_frames: u32,
    /// Requests refused.
    pub refused: u32,
    /// Telemetry frames dropped because the link was full.
    pub telemetry_dropped: u32,
    /// Cycles that were not taken.
    pub cycles_refused: u32,
    /// Set points of cycles that grew too old while they were followed: their channels were stopped.
    pub setpoints_expired: u32,
    /// How often the board went off the CAN bus by its own errors (bus-off). It is back on it after 50 ms and 128 times 11
    /// recessive bits.
    pub can_bus_off: u32,
    /// How often one of its error counters on the CAN bus reached the warning limit of 96.
    pub can_warnings: u32,
    /// Most cycles of the processor that the control task took in one period, with those of the interrupts that came meanwhile;
    /// 0 where nobody counts them, as on simulated boards.
    pub worst_tick_cycles: u32,
    /// Control periods in which these were more than [`CONTROL_SHARE`] of the period.
    pub ticks_over_share: u32,
}

/// Why a request was not carried out. Nothing was changed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum Refusal {
    /// The board does not speak that version of the protocol.
    ProtocolMismatch {
        /// The newest that it speaks: its [`crate::VERSION`].
        version: u16,
        /// [`crate::SCHEMA_HASH`] of the board.
        schema: u64,
    },
    /// No session: [`Request::Hello`] must come first.
    NoSession,
    /// Another host's session is alive.
    InUse,
    /// The board has no such channel.
    UnknownChannel {
        /// As asked.
        channel: ChannelId,
    },
    /// The board's list of channels or parameters ends before this.
    NoSuchIndex {
        /// As asked, or 255 when it was more.
        index: u8,
    },
    /// The channel cannot be commanded in this mode.
    WrongMode {
        /// As asked.
        channel: ChannelId,
        /// As asked.
        mode: Mode,
    },
    /// NaN or infinite.
    NotFinite {
        /// As asked.
        channel: ChannelId,
    },
    /// Outside what the channel can take.
    OutOfRange {
        /// As asked.
        channel: ChannelId,
        /// As asked.
        asked: f32,
        /// What it can take.
        range: Range,
    },
    /// Outputs move only while armed.
    NotArmed {
        /// Where the supervisor stands.
        state: SafetyState,
    },
    /// Arming or clearing while causes are present.
    CausesPresent {
        /// Those.
        causes: Causes,
    },
    /// Arming while a trip is latched: clear it first.
    Tripped {
        /// What tripped.
        causes: Causes,
    },
    /// Older than its time-to-live on arrival.
    Expired {
        /// How old.
        age_ms: u32,
        /// How old it may be.
        ttl_ms: u16,
    },
    /// Gains must be 0 to [`PidGains::MAX`].
    BadGains {
        /// As asked.
        channel: ChannelId,
    },
    /// The board has no room for another subscription.
    TooManySubscriptions,
    /// Decided further in the future than its time-to-live: the host has the board's clock wrong.
    ClockAhead {
        /// How far.
        ahead_ms: u32,
    },
    /// Not while the board is in this state: disarm it first.
    NotWhile {
        /// Where the supervisor stands.
        state: SafetyState,
    },
    /// The board's configuration has no such number.
    UnknownParameter {
        /// As asked.
        key: ParameterKey,
    },
    /// With this value the configuration would not be valid.
    BadParameter {
        /// As asked.
        key: ParameterKey,
        /// As asked.
        value: f32,
    },
    /// The board's flash could not be written or read.
    StorageFailed,
    /// No trip of this number, or no snapshot of it.
    NoSuchFault,
    /// No connector of this number, or an address or length it cannot have.
    BadTransfer,
    /// Nothing on the external bus acknowledged.
    NoAcknowledge {
        /// 7-bit address.
        address: u8,
    },
    /// The external bus or port did not come to an end in time.
    TransferFailed,
    /// Arming while something is done that must not be while outputs move: parameters are being saved, or the board is
    /// about to restart.
    Busy,
    /// A channel bound twice, or with a scale that is not finite and above 0.
    BadBinding {
        /// As asked.
        channel: ChannelId,
    },
    /// This firmware has no log: it is a simulated board's.
    NoLog,
    /// This firmware is no image in flash: it is a simulated board's.
    NoImage,
    /// No bootloader has started this firmware: it is a bare image, or a simulated board's.
    NoBootloader,
    /// The first point of a path was dated no later than it arrived.
    Late {
        /// How much earlier.
        late_us: u32,
    },
    /// The board has no room for that many points of a path.
    PathFull {
        /// How many it could take.
        room: u8,
    },
    /// A path without points, with two at one moment or in the wrong order.
    BadPath {
        /// As asked.
        channel: ChannelId,
    },
    /// Between two points of a path, or from where the channel is to the first, or at a point, it would be faster than it may.
    TooFast {
        /// As asked.
        channel: ChannelId,
        /// rad/s or m/s
        asked: f32,
        /// rad/s or m/s
        limit: f32,
    },
    /// An undamaged request that the board does not know: it came with a later version.
    UnknownMessage,
}

impl fmt::Display for Refusal {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::ProtocolMismatch { version, schema } => write!(
                f,
                "the board speaks protocol {version} (schema {schema:016x}), this program {} ({:016x}): \
                 flash the firmware of this release, or use the program of the board's",
                crate::VERSION,
                crate::SCHEMA_HASH
            ),
            Self::UnknownMessage => f.write_str("the board's firmware does not know this request: flash that of this release"),
            Self::NoSession => f.write_str("no session is open: connect again"),
            Self::InUse => f.write_str("another host commands this board: end its session first"),
            Self::UnknownChannel { channel } => {
                write!(f, "the board has no channel {channel}: `r4 info` lists those it has")
            }
            Self::NoSuchIndex { index } => write!(f, "the board's list has no number {index}"),
            Self::WrongMode { channel, mode } => {
                write!(f, "{channel} cannot be commanded by {mode}: `r4 info` lists what it can take")
            }
            Self::NotFinite { channel } => {
                write!(f, "the set point for {channel} is not a finite number")
            }
            Self::OutOfRange { channel, asked, range } => {
                write!(f, "{channel} takes {} to {}, not {asked}", range.min, range.max)
            }
            Self::NotArmed { state: SafetyState::Tripped } => f.write_str("the board has tripped: clear it first"),
            Self::NotArmed { state } => write!(f, "the board is {state}: arm it first"),
            Self::CausesPresent { causes } => {
                write!(f, "still present: {causes}")?;
                causes.iter().try_for_each(|cause| write!(f, "; {}", cause.advice()))
            }
            Self::Tripped { causes } => {
                write!(f, "the board has tripped ({causes}): clear it first")
            }
            Self::Expired { age_ms, ttl_ms } => {
                write!(f, "the command was {age_ms} ms old on arrival and may be {ttl_ms} ms: the link is too slow")
            }
            Self::BadGains { channel } => {
                write!(f, "gains for {channel} must be 0 to 1000000")
            }
            Self::ClockAhead { ahead_ms } => {
                write!(f, "the command is dated {ahead_ms} ms ahead of the board's clock: connect again")
            }
            Self::NotWhile { state } => write!(f, "not while the board is {state}: disarm it first"),
            Self::UnknownParameter { key } => {
                write!(f, "the board has no parameter {key}: `r4 config show` lists those it has")
            }
            Self::BadParameter { key, value } => {
                write!(f, "{key} cannot be {value}: the configuration would not be valid")
            }
            Self::StorageFailed => f.write_str(
                "the board's flash could not be written or read; what was saved before still holds: try again",
            ),
            Self::NoSuchFault => f.write_str("the history has no such trip: `r4 faults` lists those it has"),
            Self::BadTransfer => f.write_str(
                "the board has connectors 0 and 1, 7-bit addresses from 0x08 to 0x77, and up to 64 bytes in a transfer",
            ),
            Self::NoAcknowledge { address } => {
                write!(f, "nothing acknowledged address {address:#04x}: check the wiring and the pull-ups")
            }
            Self::TransferFailed => {
                f.write_str("the transfer did not end in time: check that nothing holds the line, and the baud rate")
            }
            Self::Busy => f.write_str("the board is saving, or about to restart: try again in a moment"),
            Self::BadBinding { channel } => {
                write!(f, "{channel} is in the cycle twice, or has a scale that is not finite and above 0")
            }
            Self::NoLog => f.write_str(
                "a simulated board has no log: that of the firmware's image is read on a real board or an emulated one, as in \
                 emu:osmc-bench",
            ),
            Self::NoImage => f.write_str("a simulated board has no image in flash: a real or an emulated one has"),
            Self::NoBootloader => f.write_str(
                "no bootloader has started this firmware: press the reset button twice if the Arduino bootloader is there, else \
                 flash by a debug probe",
            ),
            Self::Late { late_us } => {
                write!(f, "the path's first point was {late_us} us late on arrival: send points further ahead of their dates")
            }
            Self::PathFull { room } => {
                write!(f, "the board has room for {room} more points of this path: send them when it has passed earlier ones")
            }
            Self::BadPath { channel } => {
                write!(f, "the points of a path for {channel} must be in the order of their dates, each later than the one before")
            }
            Self::TooFast { channel, asked, limit } => {
                write!(f, "the path asks {channel} for a speed of {asked}, and it takes {limit} at most: give it more time")
            }
            Self::TooManySubscriptions => f.write_str("the board has no room for another subscription: end one first"),
        }
    }
}

impl core::error::Error for Refusal {}

/// Samples taken at one moment.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Telemetry {
    /// The board's clock when the motors' positions in it were measured: at the beginning of the last control period that is over.
    pub device_us: u64,
    /// Where the supervisor stands.
    pub state: SafetyState,
    /// Causes latched by a trip.
    pub causes: Causes,
    /// What was subscribed and is due.
    pub samples: Vec<Sample, MAX_SAMPLES>,
}

/// The value of one channel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum Sample {
    /// Of a motor channel.
    Motor {
        /// Which.
        channel: ChannelId,
        /// What it follows.
        setpoint: Setpoint,
        /// In counts of [`ChannelInfo::resolution`].
        position: i32,
        /// rad/s or m/s.
        speed: f32,
        /// Share of the supply at the bridge.
        duty: f32,
        /// In position mode: at the set point and at rest.
        settled: bool,
        /// Whether the position is known, and not only counted from where power came on.
        homed: bool,
        /// How hot its winding is; `None` for a channel whose winding's heat nothing computes.
        winding: Option<Winding>,
    },
    /// Of a channel that has one number and nothing more to tell.
    Scalar {
        /// Which.
        channel: ChannelId,
        /// In the channel's unit.
        value: f32,
    },
    /// Of an input that can fail, or grow old.
    Reading {
        /// Which.
        channel: ChannelId,
        /// In the channel's unit; the last good one where `quality` is not [`Quality::Good`].
        value: f32,
        /// Since it was taken.
        age_ms: u16,
        /// Whether it can be relied on.
        quality: Quality,
    },
    /// Of an encoder.
    Encoder {
        /// Which.
        channel: ChannelId,
        /// In counts of [`ChannelInfo::resolution`].
        position: i32,
        /// rad/s
        speed: f32,
        /// Transitions that no shaft makes, since power-up; only where edges are decoded by the processor.
        illegal: u32,
    },
    /// Of a sensor that measures several numbers together.
    Sensor {
        /// Which.
        channel: ChannelId,
        /// In the order and units of [`ChannelKind::quantities`](crate::ChannelKind::quantities), those behind them 0; the last good ones
        /// where `quality` is not [`Quality::Good`].
        values: [f32; MAX_QUANTITIES],
        /// Since they were taken.
        age_ms: u16,
        /// Whether they can be relied on.
        quality: Quality,
    },
}

/// How hot a motor's winding is, by the board's thermal model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Winding {
    /// Share of what the winding withstands, %, rounded down; at 100 the board trips with [`Cause::Overload`].
    ///
    /// [`Cause::Overload`]: crate::Cause::Overload
    pub heat_percent: u8,
    /// The board's warning before that trip: it begins above 90 %, and ends below 85 %.
    pub hot: bool,
}

/// A motor with [`Winding::hot`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct HotWinding {
    /// Which.
    pub channel: ChannelId,
    /// As [`Winding::heat_percent`].
    pub heat_percent: u8,
}

/// Whether a reading can be relied on.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum Quality {
    /// It can.
    Good,
    /// Nothing has been measured yet.
    None,
    /// Nothing in range reflects: as far as the sensor can tell, or farther.
    OutOfRange,
    /// The sensor does not answer: its echo never begins.
    NoAnswer,
    /// The echo does not end.
    Stuck,
    /// Below what a connected source gives.
    Low,
    /// Above what a connected source gives, or clamped.
    High,
    /// The sensor answers, and has nothing new to tell.
    Stale,
    /// Another chip answers at the sensor's address, or the sensor does not take its settings.
    WrongChip,
    /// One of its numbers is at the end of the sensor's range.
    Saturated,
    /// An angle sensor finds no magnet: its angle means nothing.
    NoMagnet,
    /// The field at an angle sensor is weaker than its gain makes up for: its angle is noisy.
    WeakMagnet,
    /// The field at an angle sensor is stronger than its gain makes up for: its angle may be distorted.
    StrongMagnet,
}

impl fmt::Display for Quality {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Good => "good",
            Self::None => "not measured yet",
            Self::OutOfRange => "nothing in range",
            Self::NoAnswer => "sensor does not answer",
            Self::Stuck => "echo does not end",
            Self::Low => "implausibly low: shorted?",
            Self::High => "implausibly high: open or clamped?",
            Self::Stale => "no new measurement",
            Self::WrongChip => "not the chip that the robot's file names",
            Self::Saturated => "at the end of its range",
            Self::NoMagnet => "no magnet at the sensor",
            Self::WeakMagnet => "magnet too weak or too far away",
            Self::StrongMagnet => "magnet too strong or too near",
        })
    }
}

impl Sample {
    /// The channel it belongs to.
    #[must_use]
    pub const fn channel(&self) -> ChannelId {
        match self {
            Self::Motor { channel, .. }
            | Self::Scalar { channel, .. }
            | Self::Reading { channel, .. }
            | Self::Encoder { channel, .. }
            | Self::Sensor { channel, .. } => *channel,
        }
    }
}
