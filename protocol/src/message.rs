//! Messages between host and board, in both directions.
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

/// Maximum number of samples in one [`Telemetry`] frame.
pub const MAX_SAMPLES: usize = 8;

/// Message from a host to a board.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum ToDevice {
    /// Request, which the board answers by exactly one [`ToHost::Response`] with the same `seq`.
    Request {
        /// Sequence number, chosen by the host and echoed by the board.
        seq: u16,
        /// Request that the board is to carry out.
        request: Request,
    },
    /// Sign of life. The board answers it by [`ToHost::Heartbeat`], and trips when none comes for the link time-out.
    Heartbeat {
        /// Session number from [`DeviceInfo`]; a heartbeat of another session does not count.
        session: u16,
        /// Host's clock, echoed by the board.
        host_us: u64,
    },
    /// Set points for the channels of [`Request::Bind`]. The board answers by exactly one [`ToHost::Cycle`] with the
    /// same `seq`.
    Cycle(Cycle),
}

/// Message from a board to a host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum ToHost {
    /// Answer to one request.
    Response {
        /// Sequence number of the answered request.
        seq: u16,
        /// Reply to a request that was carried out, or the reason why it was refused.
        result: Result<Reply, Refusal>,
    },
    /// Answer to a heartbeat.
    Heartbeat {
        /// Host's clock from the answered heartbeat.
        host_us: u64,
        /// Board's clock when it answered.
        device_us: u64,
        /// State of the safety supervisor.
        state: SafetyState,
        /// Causes latched by a trip.
        causes: Causes,
        /// Motors whose windings are close to their thermal limit: see [`Winding::hot`].
        hot: Vec<HotWinding, MAX_MOTORS>,
    },
    /// Samples of subscribed channels.
    Telemetry(Telemetry),
    /// Answer to a cycle.
    Cycle(CycleState),
    /// Piece of the firmware's log, after [`Request::Log`].
    Log(LogChunk),
}

/// Request of a host.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum Request {
    /// Opens a session, and must come first. Its encoding never changes, so that any two versions can agree or refuse
    /// each other: see [`crate::version`].
    Hello {
        /// Protocol version ([`crate::VERSION`]) that the host wants to talk.
        version: u16,
        /// Schema hash ([`crate::SCHEMA_HASH`]) of that version.
        schema: u64,
    },
    /// Closes the session: disarms the board and ends subscriptions; missing heartbeats no longer trip it.
    Bye,
    /// Describes channel number `index` in the board's list.
    Describe {
        /// Place in the list, 0 to [`DeviceInfo::channels`] - 1.
        index: u8,
    },
    /// Arms the board, so that outputs follow set points.
    Arm,
    /// Disarms the board: it makes its outputs safe in an orderly way.
    Disarm,
    /// Leaves a trip; refused while a cause is present.
    Clear,
    /// Trips the board: it makes its outputs safe and latches that state.
    Stop,
    /// Gives one channel a set point. A refused one stops the channel, unless the channel follows a set point that was
    /// decided later.
    Set {
        /// Channel of the set point.
        channel: ChannelId,
        /// Mode and value of the set point.
        setpoint: Setpoint,
        /// Board's clock when the host decided the set point.
        sent_us: u64,
        /// Time to live: the set point may be carried out until this long after `sent_us`.
        ttl_ms: u16,
    },
    /// Subscribes to samples of `channel`; a period of 0 ends them.
    Subscribe {
        /// Channel to be sampled.
        channel: ChannelId,
        /// Period of the samples; 0 ends them.
        period_ms: u16,
    },
    /// Changes the gains of one loop, without a step of its output.
    SetGains {
        /// Channel of the motor.
        channel: ChannelId,
        /// Loop to be changed: [`Mode::Position`] or [`Mode::Speed`].
        mode: Mode,
        /// New gains of the loop.
        gains: PidGains,
    },
    /// Asks for the counters since power-up.
    Stats,
    /// Describes parameter number `index` of the board's configuration.
    DescribeParameter {
        /// Place in the list, from 0; [`Refusal::NoSuchIndex`] marks its end.
        index: u16,
    },
    /// Changes a parameter. The new value holds from the next start on, if [`Request::SaveParameters`] follows.
    SetParameter {
        /// Parameter to be changed.
        key: ParameterKey,
        /// New value, in the parameter's unit.
        value: f32,
    },
    /// Changes the robot's name, in the same way as [`Request::SetParameter`] changes a number.
    SetName {
        /// New name of the robot.
        robot: String<MAX_NAME>,
    },
    /// Saves all changes, so that they hold after a restart: all of them, or none on failure.
    SaveParameters,
    /// Resets all parameters to their built-in values; [`Request::SaveParameters`] saves that, too.
    ResetParameters,
    /// Restarts the board. Refused while it is armed.
    Restart,
    /// Asks for one trip of the fault history.
    Fault {
        /// Place in the history; 0 is the newest trip.
        index: u8,
    },
    /// Asks for the state of the board at one moment before a trip.
    FaultSnapshot {
        /// Place of the trip in the history; 0 is the newest.
        index: u8,
        /// Number of the snapshot; 0 is the oldest.
        snapshot: u8,
    },
    /// Transfers data on one of the external I2C connectors: a write, then a read, either of which may be empty.
    I2cTransfer {
        /// Number of the I2C connector, 0 or 1.
        bus: u8,
        /// I2C address of 7 bits.
        address: u8,
        /// Bytes to write; empty to read only.
        write: Vec<u8, MAX_RAW>,
        /// Number of bytes to read, up to [`MAX_RAW`].
        read: u8,
    },
    /// Sends bytes out of a UART connector.
    UartWrite {
        /// Number of the UART connector, 0 or 1.
        port: u8,
        /// What to send.
        bytes: Vec<u8, MAX_RAW>,
    },
    /// Takes the bytes that a UART connector has received, as many as fit the answer.
    UartRead {
        /// Number of the UART connector, 0 or 1.
        port: u8,
    },
    /// Binds channels: says what [`ToDevice::Cycle`] over this link means from now on, until the session ends. An empty
    /// list ends it.
    Bind {
        /// Channels, modes and scales, in the order of the numbers in a cycle.
        channels: Vec<CycleChannel, CYCLE_CHANNELS>,
        /// Time to live: a set point may be carried out until this long after it was decided, and is followed no longer
        /// than that if no other comes.
        ttl_ms: u16,
    },
    /// Switches the firmware's log on or off. The board sends it from the oldest bytes that it still has, until the
    /// session ends or a request switches it off. All other messages go first.
    Log {
        /// True to send the log, false to end it.
        on: bool,
    },
    /// Asks which image the board runs.
    Image,
    /// Restarts the board into the bootloader that started it, which takes another image over USB. Refused while the board is
    /// armed, and by an image without a bootloader.
    Bootloader,
    /// Gives a channel points of a path. They replace its points from the first of these on. The board takes all or
    /// none; refused points stop the channel as in [`Request::Set`]. At the end of a path with a speed, the channel's
    /// profile takes it to rest.
    Follow {
        /// Channel of the path.
        channel: ChannelId,
        /// Board's clock when the host decided the points.
        sent_us: u64,
        /// Points of the path, in the order of their dates.
        points: Vec<PathPoint, MAX_POINTS>,
    },
    /// Changes a motor's feed-forward and the loop that holds its positions, until the next start.
    SetTuning {
        /// Channel of the motor.
        channel: ChannelId,
        /// New feed-forward and cascade gain.
        tuning: Tuning,
    },
}

impl Request {
    /// Returns whether a board carries this request out only once when it is sent again with the same `seq`, in
    /// sessions of version [`REPEATS.since`](crate::version::REPEATS) and later. For these requests a second time would
    /// mean something else by then: arming after a disarm, or a set point after a newer one.
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

/// Maximum number of points in one [`Request::Follow`].
pub const MAX_POINTS: usize = 4;
/// Number of points that a board keeps for each channel, not counting those it has passed.
pub const PATH_POINTS: usize = 32;

/// Dated point of a channel's path. Between two points the channel follows the cubic with their positions and speeds
/// (Hermite).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct PathPoint {
    /// Board's clock when the channel is to be at the point.
    pub at_us: u64,
    /// Position at the point, rad or m.
    pub position: f32,
    /// Speed at the point, rad/s or m/s; `None` takes the slope of the parabola through this point and its neighbours.
    pub speed: Option<f32>,
    /// Duty that is added to the loops' output from the point before to this one, a share of the supply; 0 adds
    /// nothing.
    pub feed_forward: f32,
}

/// Maximum number of bytes in one raw transfer.
pub const MAX_RAW: usize = 64;
/// Maximum length of the firmware's version, bytes.
pub const MAX_FIRMWARE: usize = 16;

/// Set point of a channel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Setpoint {
    /// Mode, which says what quantity `value` is.
    pub mode: Mode,
    /// Value in the unit of the mode: rad or m; rad/s or m/s; share of the supply; V; 0 or 1; N.
    pub value: f32,
}

impl Setpoint {
    /// Set point of a channel that has not been given any: no duty.
    pub const NONE: Self = Self { mode: Mode::Duty, value: 0.0 };
}

/// Answer to a request that was carried out.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum Reply {
    /// Answer to [`Request::Hello`]: the board and the session.
    Hello(DeviceInfo),
    /// Answer to [`Request::Describe`]: one channel.
    Channel(ChannelInfo),
    /// Answer to [`Request::Stats`]: the counters.
    Stats(DeviceStats),
    /// Answer to requests without data of their own: it was done.
    Done,
    /// Answer to [`Request::DescribeParameter`]: one parameter.
    Parameter(ParameterInfo),
    /// Answer to [`Request::Fault`]: one trip.
    Fault(FaultInfo),
    /// Answer to [`Request::FaultSnapshot`]: the state at one moment.
    FaultSnapshot(FaultSnapshot),
    /// Answer to [`Request::I2cTransfer`] and [`Request::UartRead`]: the bytes that were read.
    Bytes(Vec<u8, MAX_RAW>),
    /// Answer to [`Request::Log`]: the image that the log belongs to.
    Log(LogInfo),
    /// Answer to [`Request::Image`]: the image that runs.
    Image(ImageInfo),
}

/// Parameter with its values.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ParameterInfo {
    /// Name of the parameter.
    pub key: ParameterKey,
    /// Value that the board works with.
    pub active: f32,
    /// Value after the next restart, if it is saved.
    pub set: f32,
    /// Value that the firmware was built with.
    pub built_in: f32,
}

/// Trip of the fault history.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct FaultInfo {
    /// Number of the trip over the board's life; the newest has the highest.
    pub number: u32,
    /// Number of the start in which the board tripped; the history counts starts with a trip.
    pub start: u32,
    /// Board's clock at the trip: time since that start.
    pub device_us: u64,
    /// Causes that were present by the time the trip was recorded.
    pub causes: Causes,
    /// Number of snapshots for [`Request::FaultSnapshot`].
    pub snapshots: u8,
}

/// State of the board at one moment before a trip.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct FaultSnapshot {
    /// Time from the snapshot to the trip.
    pub before_ms: u16,
    /// Motors in the order of the board's motor channels.
    pub motors: Vec<MotorSnapshot, MAX_MOTORS>,
    /// Supply voltages in the order of the board's supply channels.
    pub supplies_v: Vec<f32, MAX_SUPPLIES>,
}

/// State of a motor at one moment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, Schema)]
pub struct MotorSnapshot {
    /// Position in counts of [`ChannelInfo::resolution`].
    pub position: i32,
    /// Speed, rad/s or m/s.
    pub speed: f32,
    /// Duty at the bridge, a share of the supply.
    pub duty: f32,
}

/// Board that answers a Hello, and the session that this opened.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct DeviceInfo {
    /// Name of the robot.
    pub robot: String<MAX_NAME>,
    /// Version of the firmware.
    pub firmware: String<MAX_FIRMWARE>,
    /// Session number, which heartbeats carry.
    pub session: u16,
    /// Number of channels that [`Request::Describe`] knows.
    pub channels: u8,
    /// Link time-out: the host must send heartbeats more often than this.
    pub link_timeout_ms: u16,
    /// Board's clock when it answered.
    pub device_us: u64,
    /// State of the safety supervisor.
    pub state: SafetyState,
    /// Causes latched by a trip.
    pub causes: Causes,
}

/// Limit of the processor time of a control period, a share of the period: 99.9 % of the periods stay within it.
pub const CONTROL_SHARE: f32 = 0.04;

/// Counters of a board since power-up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct DeviceStats {
    /// Control ticks that ran.
    pub ticks: u32,
    /// Control ticks that ended after the next one was due.
    pub late_ticks: u32,
    /// Longest time from the start of a tick to the end of its last write to an output.
    pub worst_tick_us: u32,
    /// I2C transfers that failed and were repeated.
    pub bus_retries: u32,
    /// Frames that were taken.
    pub frames: u32,
    /// Frames that were dropped: bad encoding or checksum, too long, or no message of this version.
    pub bad_frames: u32,
    /// Requests that were refused.
    pub refused: u32,
    /// Telemetry frames dropped because the link was full.
    pub telemetry_dropped: u32,
    /// Cycles that were refused.
    pub cycles_refused: u32,
    /// Set points of cycles whose time to live ended while they were followed; their channels were stopped.
    pub setpoints_expired: u32,
    /// Times that the board went off the CAN bus because of its own errors (bus-off). It comes back after 50 ms and 128
    /// times 11 recessive bits.
    pub can_bus_off: u32,
    /// Times that one of the board's error counters on the CAN bus reached the warning limit of 96.
    pub can_warnings: u32,
    /// Most processor cycles that the control task took in one period, including interrupts in that time; 0 where they
    /// are not counted, as on simulated boards.
    pub worst_tick_cycles: u32,
    /// Control periods in which the control task took more than [`CONTROL_SHARE`] of the period.
    pub ticks_over_share: u32,
}

/// Reason why a request was not carried out. Nothing was changed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum Refusal {
    /// The board does not speak that version of the protocol.
    ProtocolMismatch {
        /// Newest version that the board speaks: its [`crate::VERSION`].
        version: u16,
        /// Schema hash ([`crate::SCHEMA_HASH`]) of the board.
        schema: u64,
    },
    /// There is no session: [`Request::Hello`] must come first.
    NoSession,
    /// Another host has a session that is alive.
    InUse,
    /// The board has no such channel.
    UnknownChannel {
        /// Channel of the request.
        channel: ChannelId,
    },
    /// The board's list of channels or parameters ends before this.
    NoSuchIndex {
        /// Index of the request, or 255 when it was higher.
        index: u8,
    },
    /// The channel does not take set points in this mode.
    WrongMode {
        /// Channel of the request.
        channel: ChannelId,
        /// Mode of the request.
        mode: Mode,
    },
    /// The value is NaN or infinite.
    NotFinite {
        /// Channel of the request.
        channel: ChannelId,
    },
    /// The value is outside the channel's range.
    OutOfRange {
        /// Channel of the request.
        channel: ChannelId,
        /// Value of the request.
        asked: f32,
        /// Range of values that the channel takes.
        range: Range,
    },
    /// The board is not armed: outputs move only while it is.
    NotArmed {
        /// State of the safety supervisor.
        state: SafetyState,
    },
    /// Causes are present, so the board cannot be armed or cleared.
    CausesPresent {
        /// Causes that are present.
        causes: Causes,
    },
    /// A trip is latched, so the board cannot be armed: clear it first.
    Tripped {
        /// Causes latched by the trip.
        causes: Causes,
    },
    /// The set point was older than its time to live on arrival.
    Expired {
        /// Age of the set point on arrival.
        age_ms: u32,
        /// Time to live of the set point.
        ttl_ms: u16,
    },
    /// A gain is not within 0 to [`PidGains::MAX`].
    BadGains {
        /// Channel of the request.
        channel: ChannelId,
    },
    /// The board has no room for another subscription.
    TooManySubscriptions,
    /// The set point is dated further in the future than its time to live: the host has the board's clock wrong.
    ClockAhead {
        /// Time by which the date is ahead of the board's clock.
        ahead_ms: u32,
    },
    /// The board does not do this in its present state: disarm it first.
    NotWhile {
        /// State of the safety supervisor.
        state: SafetyState,
    },
    /// The board's configuration has no such parameter.
    UnknownParameter {
        /// Parameter of the request.
        key: ParameterKey,
    },
    /// The configuration would not be valid with this value.
    BadParameter {
        /// Parameter of the request.
        key: ParameterKey,
        /// Value of the request.
        value: f32,
    },
    /// The board's flash could not be written or read.
    StorageFailed,
    /// There is no trip of this number, or no such snapshot of it.
    NoSuchFault,
    /// There is no connector of this number, or the address or length is out of range.
    BadTransfer,
    /// No device on the external bus acknowledged.
    NoAcknowledge {
        /// I2C address of 7 bits.
        address: u8,
    },
    /// The transfer on the external bus or port did not end in time.
    TransferFailed,
    /// The board cannot be armed while it saves parameters or is about to restart.
    Busy,
    /// A channel is bound twice, or with a scale that is not finite and above 0.
    BadBinding {
        /// Channel of the binding.
        channel: ChannelId,
    },
    /// This firmware has no log: the board is simulated.
    NoLog,
    /// This firmware is no image in flash: the board is simulated.
    NoImage,
    /// No bootloader has started this firmware: it is a bare image, or the board is simulated.
    NoBootloader,
    /// The first point of a path was dated at or before its arrival.
    Late {
        /// Time from the date of the point to its arrival.
        late_us: u32,
    },
    /// The board has no room for as many points of a path.
    PathFull {
        /// Number of points that the board has room for.
        room: u8,
    },
    /// A path has no points, or its dates do not increase.
    BadPath {
        /// Channel of the path.
        channel: ChannelId,
    },
    /// The path is faster than the channel's speed limit: between two points, from the channel's position to the first
    /// point, or at a point.
    TooFast {
        /// Channel of the path.
        channel: ChannelId,
        /// Speed that the path needs, rad/s or m/s.
        asked: f32,
        /// Speed limit of the channel, rad/s or m/s.
        limit: f32,
    },
    /// The board does not know this request, although it is undamaged: it came with a later version.
    UnknownMessage,
    /// The guard of a shared board denies the request. It gives no reason, so that the answer does not say whether the
    /// channel, parameter or trip exists. Boards themselves never send it.
    Denied,
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
            Self::Denied => f.write_str(
                "access denied: present a valid token of a subject who may do this, by --token or R4_TOKEN; who serves the board \
                 finds the reason by `r4 access log`",
            ),
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
    /// Board's clock when the motors' positions were measured: at the beginning of the last complete control period.
    pub device_us: u64,
    /// State of the safety supervisor.
    pub state: SafetyState,
    /// Causes latched by a trip.
    pub causes: Causes,
    /// Samples of subscribed channels that are due.
    pub samples: Vec<Sample, MAX_SAMPLES>,
}

/// Sample of one channel.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum Sample {
    /// Sample of a motor or stepper.
    Motor {
        /// Channel of the motor.
        channel: ChannelId,
        /// Set point that the motor follows.
        setpoint: Setpoint,
        /// Position in counts of [`ChannelInfo::resolution`].
        position: i32,
        /// Speed, rad/s or m/s.
        speed: f32,
        /// Duty at the bridge, a share of the supply.
        duty: f32,
        /// True in position mode while the motor rests at its set point.
        settled: bool,
        /// True where the zero of the position is known; false while positions count from where power came on.
        homed: bool,
        /// Heat of the motor's winding; `None` for a channel without a thermal model.
        winding: Option<Winding>,
    },
    /// Sample of a channel with one value and no quality.
    Scalar {
        /// Channel of the value.
        channel: ChannelId,
        /// Value in the channel's unit.
        value: f32,
    },
    /// Sample of an input that can fail, or become old.
    Reading {
        /// Channel of the input.
        channel: ChannelId,
        /// Value in the channel's unit; the last good one where `quality` is not [`Quality::Good`].
        value: f32,
        /// Age of the measurement.
        age_ms: u16,
        /// Quality of the measurement.
        quality: Quality,
    },
    /// Sample of an encoder.
    Encoder {
        /// Channel of the encoder.
        channel: ChannelId,
        /// Position in counts of [`ChannelInfo::resolution`].
        position: i32,
        /// Speed of the shaft, rad/s.
        speed: f32,
        /// Illegal transitions since power-up, which no shaft can make; counted only where the processor decodes the
        /// edges.
        illegal: u32,
    },
    /// Sample of a sensor that measures several quantities together.
    Sensor {
        /// Channel of the sensor.
        channel: ChannelId,
        /// Values in the order and units of [`ChannelKind::quantities`](crate::ChannelKind::quantities), the rest 0;
        /// the last good ones where `quality` is not [`Quality::Good`].
        values: [f32; MAX_QUANTITIES],
        /// Age of the measurement.
        age_ms: u16,
        /// Quality of the measurement.
        quality: Quality,
    },
}

/// Heat of a motor's winding, by the board's thermal model.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Winding {
    /// Share of the winding's thermal limit, %, rounded down; at 100 the board trips with [`Cause::Overload`].
    ///
    /// [`Cause::Overload`]: crate::Cause::Overload
    pub heat_percent: u8,
    /// Warning before that trip: true from above 90 % until below 85 %.
    pub hot: bool,
}

/// Motor with a hot winding: see [`Winding::hot`].
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct HotWinding {
    /// Channel of the motor.
    pub channel: ChannelId,
    /// Share of the winding's thermal limit: see [`Winding::heat_percent`].
    pub heat_percent: u8,
}

/// Quality of a measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum Quality {
    /// The measurement can be relied on.
    Good,
    /// Nothing has been measured yet.
    None,
    /// Nothing reflects within the sensor's range.
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
    /// One of the quantities is at the end of the sensor's range.
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
    /// Returns the channel that the sample belongs to.
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
