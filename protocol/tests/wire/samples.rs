//! Hand-written messages: at least one for every enum variant that can travel, and those with extreme values.

use r4_protocol::{
    Cause, Causes, ChannelId, ChannelInfo, ChannelKind, Cycle, CycleChannel, CycleMotor, CycleOutcome, CycleState,
    DeviceInfo, DeviceStats, FaultInfo, FaultSnapshot, HotWinding, ImageInfo, LogChunk, LogInfo, Mode, ModeInfo,
    MotorSnapshot, Parameter, ParameterInfo, ParameterKey, PathPoint, Quality, Range, Refusal, Reply, Request,
    SafetyState, Sample, Setpoint, Telemetry, ToDevice, ToHost, Unit, Winding,
    channel::MAX_QUANTITIES,
    config::{FeedForward, MAX_MOTORS, MAX_SENSORS, MAX_SUPPLIES, PidGains, Tuning},
    cycle::{CYCLE_CHANNELS, NOTHING},
    message::{MAX_POINTS, MAX_RAW, MAX_SAMPLES},
};

const OSMC0: ChannelId = ChannelId::new(ChannelKind::Osmc, 0);
const ACTUATOR1: ChannelId = ChannelId::new(ChannelKind::Actuator, 1);
const SUPPLY0: ChannelId = ChannelId::new(ChannelKind::Supply, 0);
/// Channel name with the longest encoding.
const LAST: ChannelId = ChannelId::new(ChannelKind::DeadMan, u8::MAX);
/// Quiet NaN with fixed bits: those of `f32::NAN` are not guaranteed.
const NAN: f32 = f32::from_bits(0x7FC0_0000);
/// Schema hash of no version, so that the rows do not change with the schema.
const SCHEMA: u64 = 0x0123_4567_89AB_CDEF;

/// Returns the samples to a board. Their names, `what` or `what-which`, are those of the rows in the golden table.
pub(crate) fn to_device() -> Vec<(&'static str, ToDevice)> {
    let mut rows: Vec<(&'static str, ToDevice)> = requests()
        .into_iter()
        .zip(1..)
        .map(|((name, request), seq)| (name, ToDevice::Request { seq, request }))
        .collect();
    rows.extend([
        ("request-seq-0", ToDevice::Request { seq: 0, request: Request::Stats }),
        ("request-seq-127", ToDevice::Request { seq: 127, request: Request::Stats }),
        ("request-seq-128", ToDevice::Request { seq: 128, request: Request::Stats }),
        ("request-seq-largest", ToDevice::Request { seq: u16::MAX, request: Request::Stats }),
        ("request-largest", ToDevice::Request { seq: u16::MAX, request: largest_request() }),
        ("heartbeat", ToDevice::Heartbeat { session: 7, host_us: 1_234_567 }),
        ("heartbeat-zero", ToDevice::Heartbeat { session: 0, host_us: 0 }),
        ("heartbeat-largest", ToDevice::Heartbeat { session: u16::MAX, host_us: u64::MAX }),
    ]);
    rows.extend(cycles().map(|(name, cycle)| (name, ToDevice::Cycle(cycle))));
    rows
}

/// Returns the samples to a host, named in the same way.
pub(crate) fn to_host() -> Vec<(&'static str, ToHost)> {
    let mut rows: Vec<(&'static str, ToHost)> = replies()
        .into_iter()
        .map(|(name, reply)| (name, Ok(reply)))
        .chain(refusals().into_iter().map(|(name, refusal)| (name, Err(refusal))))
        .chain(later_replies().into_iter().map(|(name, reply)| (name, Ok(reply))))
        .chain(later_refusals().into_iter().map(|(name, refusal)| (name, Err(refusal))))
        .chain([("refused-bad-binding", Err(Refusal::BadBinding { channel: OSMC0 }))])
        // Since version 5.
        .chain([
            ("log", Ok(Reply::Log(LogInfo { image: 0x1234_5678 }))),
            ("log-largest", Ok(Reply::Log(LogInfo { image: u32::MAX }))),
            ("refused-no-log", Err(Refusal::NoLog)),
            ("image", Ok(Reply::Image(ImageInfo { hosted: true, bytes: 0x6_E720, crc: 0xCBF4_3926 }))),
            ("image-largest", Ok(Reply::Image(ImageInfo { hosted: true, bytes: u32::MAX, crc: u32::MAX }))),
            ("refused-no-image", Err(Refusal::NoImage)),
            ("refused-no-bootloader", Err(Refusal::NoBootloader)),
            // Since version 9.
            ("refused-late", Err(Refusal::Late { late_us: 1500 })),
            ("refused-path-full", Err(Refusal::PathFull { room: 3 })),
            ("refused-bad-path", Err(Refusal::BadPath { channel: OSMC0 })),
            ("refused-too-fast", Err(Refusal::TooFast { channel: OSMC0, asked: 8.5, limit: 6.5 })),
        ])
        .zip(1..)
        .map(|((name, result), seq)| (name, ToHost::Response { seq, result }))
        .collect();
    rows.push(("response-largest", ToHost::Response { seq: u16::MAX, result: Ok(largest_reply()) }));
    rows.extend(heartbeats());
    rows.extend(telemetry().map(|(name, telemetry)| (name, ToHost::Telemetry(telemetry))));
    rows.extend(cycle_states().map(|(name, state)| (name, ToHost::Cycle(state))));
    rows.extend([
        ("log-chunk", ToHost::Log(LogChunk { position: 1000, bytes: some_bytes(&[0x02, 0x80, 0x00]) })),
        ("log-chunk-none", ToHost::Log(LogChunk { position: 0, bytes: some_bytes(&[]) })),
        ("log-chunk-largest", ToHost::Log(largest_log())),
    ]);
    rows
}

/// Returns set points of cycles.
pub(crate) fn cycles() -> [(&'static str, Cycle); 6] {
    [
        ("cycle", Cycle::new(1, None, Some(1_000_000), [100, -100, 0, NOTHING])),
        ("cycle-zero", Cycle::new(0, Some(Mode::Position), Some(0), [0; CYCLE_CHANNELS])),
        ("cycle-undated", Cycle::new(7, None, None, [1, 2, 3, 4])),
        ("cycle-speed", Cycle::new(128, Some(Mode::Speed), Some(1 << 32), [i16::MAX; CYCLE_CHANNELS])),
        ("cycle-follow", Cycle::new(9, Some(Mode::Follow), Some(1_000_000), [5, -5, NOTHING, NOTHING])),
        ("cycle-largest", Cycle::new(u8::MAX, None, Some(u64::MAX), [-1; CYCLE_CHANNELS])),
    ]
}

/// Returns answers to cycles.
pub(crate) fn cycle_states() -> [(&'static str, CycleState); 5] {
    let motor = |position, speed, duty, settled| CycleMotor { position, speed, duty, settled };
    let armed = (SafetyState::Armed, Causes::NONE);
    let tripped = (SafetyState::Tripped, Causes::from_bits(u32::MAX));
    let two = [motor(-63, 100, -200, true), motor(1000, 0, 0, false), CycleMotor::NONE, CycleMotor::NONE];
    let largest = [motor(-1, -1, -1, true); CYCLE_CHANNELS];
    let none = [CycleMotor::NONE; CYCLE_CHANNELS];
    let zero = [motor(0, 0, 0, false); CYCLE_CHANNELS];
    [
        ("cycle-taken", CycleState::new(1, CycleOutcome::Taken, 2_000_000, armed, two)),
        ("cycle-refused", CycleState::new(2, CycleOutcome::Refused, 2_000_000, tripped, two)),
        ("cycle-stale", CycleState::new(0, CycleOutcome::Stale, 0, (SafetyState::Disarmed, Causes::NONE), zero)),
        ("cycle-unbound", CycleState::new(3, CycleOutcome::Unbound, 2_000_000, armed, none)),
        ("cycle-state-largest", CycleState::new(u8::MAX, CycleOutcome::Unbound, u64::MAX, tripped, largest)),
    ]
}

/// Returns the longest binding.
pub(crate) fn largest_bind() -> Request {
    let channel =
        CycleChannel { channel: LAST, mode: Mode::Home, position_scale: f32::MAX, speed_scale: f32::MIN_POSITIVE };
    Request::Bind { channels: [channel; CYCLE_CHANNELS].into_iter().collect(), ttl_ms: u16::MAX }
}

/// Returns the longest request.
pub(crate) fn largest_request() -> Request {
    let point =
        PathPoint { at_us: u64::MAX, position: f32::MIN, speed: Some(f32::MAX), feed_forward: f32::MIN_POSITIVE };
    Request::Follow { channel: LAST, sent_us: u64::MAX, points: [point; MAX_POINTS].into_iter().collect() }
}

/// Returns the longest raw transfer.
pub(crate) fn largest_transfer() -> Request {
    Request::I2cTransfer { bus: u8::MAX, address: u8::MAX, write: largest_raw(), read: u8::MAX }
}

/// Returns the longest reply.
pub(crate) fn largest_reply() -> Reply {
    let motor = MotorSnapshot { position: i32::MIN, speed: f32::MIN, duty: f32::MIN_POSITIVE };
    Reply::FaultSnapshot(FaultSnapshot {
        before_ms: u16::MAX,
        motors: [motor; MAX_MOTORS].into_iter().collect(),
        supplies_v: [f32::MAX; MAX_SUPPLIES].into_iter().collect(),
    })
}

/// Returns as many bytes as a raw transfer takes.
pub(crate) fn largest_raw() -> heapless::Vec<u8, MAX_RAW> {
    [u8::MAX; MAX_RAW].into_iter().collect()
}

/// Returns the longest piece of a log.
pub(crate) fn largest_log() -> LogChunk {
    LogChunk { position: u32::MAX, bytes: largest_raw() }
}

/// Returns the longest command.
pub(crate) fn largest_set() -> Request {
    Request::Set {
        channel: LAST,
        setpoint: Setpoint { mode: Mode::Home, value: f32::MAX },
        sent_us: u64::MAX,
        ttl_ms: u16::MAX,
    }
}

/// Returns the longest answer to a `Hello`.
pub(crate) fn largest_welcome() -> Reply {
    Reply::Hello(DeviceInfo {
        robot: "thirty-two bytes of a robot name".try_into().expect("32 bytes"),
        firmware: "255.255.65535-rc".try_into().expect("16 bytes"),
        session: u16::MAX,
        channels: u8::MAX,
        link_timeout_ms: u16::MAX,
        device_us: u64::MAX,
        state: SafetyState::Tripped,
        causes: Causes::from_bits(u32::MAX),
    })
}

/// Returns the longest telemetry.
pub(crate) fn largest_telemetry() -> Telemetry {
    Telemetry {
        device_us: u64::MAX,
        state: SafetyState::Tripped,
        causes: Causes::from_bits(u32::MAX),
        samples: (0..MAX_SAMPLES)
            .map(|place| if place < MAX_SENSORS { LARGEST_SENSOR } else { LARGEST_SAMPLE })
            .collect(),
    }
}

/// Longest sample of a sensor. A frame has at most one of each sensor that a board can have.
const LARGEST_SENSOR: Sample =
    Sample::Sensor { channel: LAST, values: [f32::MAX; MAX_QUANTITIES], age_ms: u16::MAX, quality: Quality::Saturated };

const LARGEST_SAMPLE: Sample = Sample::Motor {
    channel: LAST,
    setpoint: Setpoint { mode: Mode::Home, value: f32::MAX },
    position: i32::MIN,
    speed: f32::MIN,
    duty: f32::MIN_POSITIVE,
    settled: true,
    homed: true,
    winding: Some(Winding { heat_percent: u8::MAX, hot: true }),
};

/// Keys of the board, and of the channel and parameter with the longest encoding.
const KEYS: [(&str, ParameterKey); 2] = [
    ("set-parameter-board", ParameterKey { channel: None, parameter: Parameter::LinkTimeoutMs }),
    ("set-parameter-largest", ParameterKey { channel: Some(LAST), parameter: Parameter::StopBrakeMs }),
];

fn requests() -> Vec<(&'static str, Request)> {
    let set = |channel, mode, value| Request::Set {
        channel,
        setpoint: Setpoint { mode, value },
        sent_us: 1_000_000,
        ttl_ms: 50,
    };
    let gains = PidGains { kp: 0.5, ki: 2.0, kd: 0.0625 };
    let subscribe = |kind, index| Request::Subscribe { channel: ChannelId::new(kind, index), period_ms: 20 };
    let i2c = |bytes: &[u8], read| Request::I2cTransfer { bus: 1, address: 0x48, write: some_bytes(bytes), read };
    let mut requests = vec![
        ("hello", Request::Hello { version: 1, schema: SCHEMA }),
        ("hello-largest", Request::Hello { version: u16::MAX, schema: u64::MAX }),
        ("bye", Request::Bye),
        ("describe", Request::Describe { index: 3 }),
        ("describe-largest", Request::Describe { index: u8::MAX }),
        ("arm", Request::Arm),
        ("disarm", Request::Disarm),
        ("clear", Request::Clear),
        ("stop", Request::Stop),
        ("set-position", set(OSMC0, Mode::Position, 1.5)),
        ("set-speed", set(ACTUATOR1, Mode::Speed, -0.02)),
        ("set-duty", set(OSMC0, Mode::Duty, -1.0)),
        ("set-switch", set(ChannelId::new(ChannelKind::Relay, 1), Mode::Switch, 1.0)),
        ("set-minus-zero", set(OSMC0, Mode::Duty, -0.0)),
        ("set-subnormal", set(OSMC0, Mode::Duty, f32::from_bits(1))),
        ("set-nan", set(OSMC0, Mode::Speed, NAN)),
        ("set-infinite", set(OSMC0, Mode::Speed, f32::NEG_INFINITY)),
        ("subscribe-osmc", subscribe(ChannelKind::Osmc, 3)),
        ("subscribe-actuator", subscribe(ChannelKind::Actuator, 1)),
        ("subscribe-dhb", subscribe(ChannelKind::Dhb, 3)),
        ("subscribe-bldc", subscribe(ChannelKind::Bldc, 3)),
        ("subscribe-servo", subscribe(ChannelKind::Servo, 15)),
        ("subscribe-stepper", subscribe(ChannelKind::Stepper, 3)),
        ("subscribe-relay", subscribe(ChannelKind::Relay, 7)),
        ("subscribe-encoder", subscribe(ChannelKind::Encoder, 3)),
        ("subscribe-switch", subscribe(ChannelKind::Switch, 3)),
        ("subscribe-range", subscribe(ChannelKind::Range, 3)),
        ("subscribe-analog", subscribe(ChannelKind::Analog, 5)),
        ("subscribe-supply", subscribe(ChannelKind::Supply, 0)),
        ("subscribe-dac", subscribe(ChannelKind::Dac, 1)),
        ("subscribe-dead-man", subscribe(ChannelKind::DeadMan, 0)),
        ("subscribe-end", Request::Subscribe { channel: SUPPLY0, period_ms: 0 }),
        ("subscribe-largest", Request::Subscribe { channel: LAST, period_ms: u16::MAX }),
        ("set-gains-position", Request::SetGains { channel: ACTUATOR1, mode: Mode::Position, gains }),
        ("set-gains-speed", Request::SetGains { channel: OSMC0, mode: Mode::Speed, gains }),
        ("stats", Request::Stats),
        // Since version 3; at the end, so that the sequence numbers above do not change.
        ("set-voltage", set(ChannelId::new(ChannelKind::Dac, 1), Mode::Voltage, 1.25)),
        ("set-brake", set(ChannelId::new(ChannelKind::Bldc, 2), Mode::Brake, 1.0)),
        ("set-home", set(ChannelId::new(ChannelKind::Stepper, 0), Mode::Home, -0.5)),
        ("set-largest", largest_set()),
        ("describe-parameter", Request::DescribeParameter { index: 127 }),
        ("describe-parameter-largest", Request::DescribeParameter { index: u16::MAX }),
        ("set-name", Request::SetName { robot: "left arm".try_into().expect("short") }),
        ("set-name-empty", Request::SetName { robot: heapless::String::new() }),
        ("save-parameters", Request::SaveParameters),
        ("reset-parameters", Request::ResetParameters),
        ("restart", Request::Restart),
        ("fault", Request::Fault { index: 2 }),
        ("fault-snapshot", Request::FaultSnapshot { index: 2, snapshot: 7 }),
        ("i2c-write", i2c(&[0x01, 0x00, 0xFF], 0)),
        ("i2c-write-read", i2c(&[0x00], 2)),
        ("i2c-read-largest", i2c(&[], MAX_RAW as u8)),
        ("uart-write", Request::UartWrite { port: 0, bytes: some_bytes(b"G0 X1\n") }),
        ("uart-write-largest", Request::UartWrite { port: u8::MAX, bytes: largest_raw() }),
        ("uart-read", Request::UartRead { port: 1 }),
    ];
    requests.extend(KEYS.map(|(name, key)| (name, Request::SetParameter { key, value: 250.0 })));
    // Every parameter, in the row of its name.
    requests.extend(Parameter::all().map(|parameter| {
        let key = ParameterKey { channel: Some(OSMC0), parameter };
        (parameter.name(), Request::SetParameter { key, value: 0.5 })
    }));
    // Since version 4.
    let wheel = CycleChannel { channel: OSMC0, mode: Mode::Speed, position_scale: 0.002, speed_scale: 0.001 };
    let rod = CycleChannel { channel: ACTUATOR1, mode: Mode::Position, position_scale: 1e-6, speed_scale: 1e-6 };
    requests.extend([
        ("bind", Request::Bind { channels: [wheel, rod].into_iter().collect(), ttl_ms: 50 }),
        ("bind-none", Request::Bind { channels: heapless::Vec::new(), ttl_ms: 0 }),
        ("bind-largest", largest_bind()),
    ]);
    // Since version 5.
    requests.extend([("log", Request::Log { on: true }), ("log-end", Request::Log { on: false })]);
    requests.extend([("image", Request::Image), ("bootloader", Request::Bootloader)]);
    // Since version 9.
    let point = |at_us, position, speed| PathPoint { at_us, position, speed, feed_forward: 0.0625 };
    let points = [point(1_010_000, 0.5, None), point(1_020_000, 0.75, Some(-2.0))];
    requests.extend([
        ("set-follow", set(OSMC0, Mode::Follow, 1.5)),
        ("follow", Request::Follow { channel: OSMC0, sent_us: 1_000_000, points: points.into_iter().collect() }),
        ("follow-none", Request::Follow { channel: OSMC0, sent_us: 0, points: heapless::Vec::new() }),
        ("transfer-largest", largest_transfer()),
        // Since version 11.
        ("set-force", set(OSMC0, Mode::Force, 4.5)),
    ]);
    // Since version 10.
    let feed_forward = FeedForward { static_duty: 0.125, duty_per_speed: 0.25, duty_per_acceleration: 0.03125 };
    requests.push((
        "set-tuning",
        Request::SetTuning { channel: OSMC0, tuning: Tuning { feed_forward, cascade_per_s: 8.0 } },
    ));
    requests
}

fn some_bytes(bytes: &[u8]) -> heapless::Vec<u8, MAX_RAW> {
    bytes.iter().copied().collect()
}

fn replies() -> Vec<(&'static str, Reply)> {
    let input = |kind, unit, max, rate_hz| {
        let (id, range) = (ChannelId::new(kind, 2), Range::new(0.0, max));
        Reply::Channel(ChannelInfo { id, unit, range, rate_hz, resolution: 0.0, modes: heapless::Vec::new() })
    };
    let mode = |mode, unit, limit| ModeInfo { mode, unit, range: Range::symmetric(limit) };
    let stats = DeviceStats {
        ticks: 1,
        late_ticks: 2,
        worst_tick_us: 300,
        bus_retries: 4,
        frames: 50_000,
        bad_frames: 6,
        refused: 7,
        telemetry_dropped: 8,
        cycles_refused: 9,
        setpoints_expired: 10,
        can_bus_off: 11,
        can_warnings: 12,
        worst_tick_cycles: 13,
        ticks_over_share: 14,
    };
    vec![
        (
            "welcome",
            Reply::Hello(DeviceInfo {
                robot: "osmc-bench".try_into().expect("short"),
                firmware: "0.1.0".try_into().expect("short"),
                session: 7,
                channels: 4,
                link_timeout_ms: 200,
                device_us: 2_000_000,
                state: SafetyState::Disarmed,
                causes: Causes::NONE,
            }),
        ),
        (
            "channel-rad",
            Reply::Channel(ChannelInfo {
                id: OSMC0,
                unit: Unit::Rad,
                range: Range::symmetric(8.0),
                rate_hz: 1000.0,
                resolution: 0.0015,
                modes: [
                    mode(Mode::Position, Unit::Rad, 8.0),
                    mode(Mode::Speed, Unit::RadPerS, 20.0),
                    mode(Mode::Duty, Unit::Duty, 0.95),
                ]
                .into_iter()
                .collect(),
            }),
        ),
        (
            "channel-m",
            Reply::Channel(ChannelInfo {
                id: ACTUATOR1,
                unit: Unit::M,
                range: Range::new(0.01, 0.09),
                rate_hz: 1000.0,
                resolution: 1e-6,
                modes: [mode(Mode::Speed, Unit::MPerS, 0.02)].into_iter().collect(),
            }),
        ),
        ("channel-v", input(ChannelKind::Supply, Unit::V, 30.0, 100.0)),
        ("channel-imu", input(ChannelKind::Imu, Unit::MPerS2, 39.2266, 100.0)),
        ("channel-current", input(ChannelKind::Current, Unit::A, 40.96, 100.0)),
        ("channel-angle", input(ChannelKind::Angle, Unit::Rad, core::f32::consts::TAU, 1000.0)),
        ("channel-force", input(ChannelKind::Force, Unit::N, 93.75, 80.0)),
        ("channel-distance", input(ChannelKind::Distance, Unit::M, 0.2, 20.0)),
        ("channel-bool", input(ChannelKind::DeadMan, Unit::Bool, 1.0, 1000.0)),
        ("channel-infinite", input(ChannelKind::Range, Unit::M, f32::INFINITY, NAN)),
        ("counters", Reply::Stats(stats)),
        (
            "counters-largest",
            Reply::Stats(DeviceStats {
                ticks: u32::MAX,
                late_ticks: u32::MAX,
                worst_tick_us: u32::MAX,
                bus_retries: u32::MAX,
                frames: u32::MAX,
                bad_frames: u32::MAX,
                refused: u32::MAX,
                telemetry_dropped: u32::MAX,
                cycles_refused: u32::MAX,
                setpoints_expired: u32::MAX,
                can_bus_off: u32::MAX,
                can_warnings: u32::MAX,
                worst_tick_cycles: u32::MAX,
                ticks_over_share: u32::MAX,
            }),
        ),
        ("done", Reply::Done),
    ]
}

/// Returns replies since version 3; after the refusals, so that the sequence numbers of both do not change.
fn later_replies() -> Vec<(&'static str, Reply)> {
    let parameter = |key, set| Reply::Parameter(ParameterInfo { key, active: 200.0, set, built_in: 200.0 });
    let [(_, of_board), (_, of_last)] = KEYS;
    let motor = |position, duty| MotorSnapshot { position, speed: -0.5, duty };
    let fault = FaultInfo {
        number: 12,
        start: 5,
        device_us: 2_000_000,
        causes: Causes::only(Cause::AuxiliaryStop),
        snapshots: 8,
    };
    vec![
        ("parameter", parameter(of_board, 250.0)),
        ("parameter-largest", parameter(of_last, f32::MAX)),
        ("fault", Reply::Fault(fault)),
        (
            "fault-largest",
            Reply::Fault(FaultInfo {
                number: u32::MAX,
                start: u32::MAX,
                device_us: u64::MAX,
                causes: Causes::from_bits(u32::MAX),
                snapshots: u8::MAX,
            }),
        ),
        (
            "fault-snapshot",
            Reply::FaultSnapshot(FaultSnapshot {
                before_ms: 150,
                motors: [motor(-63, 0.25), motor(1000, 0.0)].into_iter().collect(),
                supplies_v: [24.5].into_iter().collect(),
            }),
        ),
        (
            "fault-snapshot-empty",
            Reply::FaultSnapshot(FaultSnapshot {
                before_ms: 0,
                motors: heapless::Vec::new(),
                supplies_v: heapless::Vec::new(),
            }),
        ),
        ("bytes", Reply::Bytes(some_bytes(&[0x00, 0x80, 0xFF]))),
        ("bytes-none", Reply::Bytes(some_bytes(&[]))),
        ("bytes-largest", Reply::Bytes(largest_raw())),
        ("welcome-largest", largest_welcome()),
    ]
}

fn refusals() -> Vec<(&'static str, Refusal)> {
    let range = Range::new(-1.5, 2.5);
    let causes = Causes::only(Cause::DeadMan).union(Causes::only(Cause::SupplyOutOfRange));
    vec![
        ("refused-protocol-mismatch", Refusal::ProtocolMismatch { version: 1, schema: SCHEMA }),
        ("refused-protocol-mismatch-largest", Refusal::ProtocolMismatch { version: u16::MAX, schema: u64::MAX }),
        ("refused-no-session", Refusal::NoSession),
        ("refused-in-use", Refusal::InUse),
        ("refused-unknown-channel", Refusal::UnknownChannel { channel: LAST }),
        ("refused-no-such-index", Refusal::NoSuchIndex { index: u8::MAX }),
        ("refused-wrong-mode", Refusal::WrongMode { channel: SUPPLY0, mode: Mode::Duty }),
        ("refused-not-finite", Refusal::NotFinite { channel: OSMC0 }),
        ("refused-out-of-range", Refusal::OutOfRange { channel: OSMC0, asked: 2.75, range }),
        ("refused-not-armed-disarmed", Refusal::NotArmed { state: SafetyState::Disarmed }),
        ("refused-not-armed-tripped", Refusal::NotArmed { state: SafetyState::Tripped }),
        ("refused-causes-present", Refusal::CausesPresent { causes }),
        ("refused-causes-present-all", Refusal::CausesPresent { causes: every_cause() }),
        ("refused-tripped", Refusal::Tripped { causes: Causes::only(Cause::BadConfiguration) }),
        ("refused-expired", Refusal::Expired { age_ms: 80, ttl_ms: 50 }),
        ("refused-expired-largest", Refusal::Expired { age_ms: u32::MAX, ttl_ms: u16::MAX }),
        ("refused-bad-gains", Refusal::BadGains { channel: ACTUATOR1 }),
        ("refused-too-many-subscriptions", Refusal::TooManySubscriptions),
        ("refused-clock-ahead", Refusal::ClockAhead { ahead_ms: u32::MAX }),
        ("refused-unknown-message", Refusal::UnknownMessage),
        ("refused-denied", Refusal::Denied),
    ]
}

/// Returns refusals since version 3.
fn later_refusals() -> Vec<(&'static str, Refusal)> {
    let [(_, of_board), (_, of_last)] = KEYS;
    vec![
        ("refused-not-while-armed", Refusal::NotWhile { state: SafetyState::Armed }),
        ("refused-unknown-parameter", Refusal::UnknownParameter { key: of_last }),
        ("refused-bad-parameter", Refusal::BadParameter { key: of_board, value: -1.0 }),
        ("refused-bad-parameter-largest", Refusal::BadParameter { key: of_last, value: NAN }),
        ("refused-storage-failed", Refusal::StorageFailed),
        ("refused-no-such-fault", Refusal::NoSuchFault),
        ("refused-bad-transfer", Refusal::BadTransfer),
        ("refused-no-acknowledge", Refusal::NoAcknowledge { address: 0x48 }),
        ("refused-transfer-failed", Refusal::TransferFailed),
        ("refused-busy", Refusal::Busy),
    ]
}

fn heartbeats() -> [(&'static str, ToHost); 5] {
    let beat = |state, causes, hot: &[HotWinding]| ToHost::Heartbeat {
        host_us: 1_234_567,
        device_us: 2_000_000,
        state,
        causes,
        hot: hot.iter().copied().collect(),
    };
    let hot = HotWinding { channel: OSMC0, heat_percent: 83 };
    [
        ("heartbeat-disarmed", beat(SafetyState::Disarmed, Causes::NONE, &[])),
        ("heartbeat-armed", beat(SafetyState::Armed, Causes::NONE, &[])),
        ("heartbeat-hot", beat(SafetyState::Armed, Causes::NONE, &[hot])),
        ("heartbeat-tripped", beat(SafetyState::Tripped, Causes::only(Cause::LinkLost), &[])),
        (
            "heartbeat-largest",
            ToHost::Heartbeat {
                host_us: u64::MAX,
                device_us: u64::MAX,
                state: SafetyState::Tripped,
                causes: Causes::from_bits(u32::MAX),
                hot: [HotWinding { channel: LAST, heat_percent: u8::MAX }; MAX_MOTORS].into_iter().collect(),
            },
        ),
    ]
}

fn telemetry() -> impl Iterator<Item = (&'static str, Telemetry)> {
    let motor = |position, speed, settled| Sample::Motor {
        channel: OSMC0,
        setpoint: Setpoint { mode: Mode::Position, value: 1.5 },
        position,
        speed,
        duty: -0.25,
        settled,
        homed: settled,
        winding: settled.then_some(Winding { heat_percent: 83, hot: true }),
    };
    let reading = |value, age_ms, quality| Sample::Reading {
        channel: ChannelId::new(ChannelKind::Range, 3),
        value,
        age_ms,
        quality,
    };
    let encoder = |position, speed, illegal| Sample::Encoder {
        channel: ChannelId::new(ChannelKind::Encoder, 2),
        position,
        speed,
        illegal,
    };
    let sensor =
        |kind, values, age_ms, quality| Sample::Sensor { channel: ChannelId::new(kind, 1), values, age_ms, quality };
    let volts = Sample::Scalar { channel: SUPPLY0, value: 24.5 };
    let armed = |samples: &[Sample]| Telemetry {
        device_us: 2_000_000,
        state: SafetyState::Armed,
        causes: Causes::NONE,
        samples: samples.iter().copied().collect(),
    };
    [
        ("telemetry-empty", armed(&[])),
        ("telemetry-motor", armed(&[motor(-63, 0.0, true)])),
        ("telemetry-scalar", armed(&[volts])),
        ("telemetry-both", armed(&[motor(1000, 3.5, false), volts])),
        ("telemetry-position-largest", armed(&[motor(i32::MAX, f32::MAX, false)])),
        ("telemetry-nan", armed(&[Sample::Scalar { channel: SUPPLY0, value: NAN }])),
        (
            "telemetry-reading",
            armed(&[
                reading(0.75, 12, Quality::Good),
                reading(0.0, 0, Quality::None),
                reading(4.0, 60, Quality::OutOfRange),
                reading(0.75, 500, Quality::NoAnswer),
                reading(0.75, u16::MAX, Quality::Stuck),
                reading(0.125, 1, Quality::Low),
                reading(5.0, 1, Quality::High),
            ]),
        ),
        ("telemetry-encoder", armed(&[encoder(-1200, 2.5, 0), encoder(i32::MIN, f32::MIN, u32::MAX)])),
        (
            "telemetry-sensor",
            armed(&[
                sensor(ChannelKind::Imu, [0.5, -0.25, 9.75, 0.125, -1.5, 3.0], 3, Quality::Good),
                sensor(ChannelKind::Current, [2.5, 12.0, 0.0, 0.0, 0.0, 0.0], 900, Quality::Stale),
                sensor(ChannelKind::Imu, [0.0; MAX_QUANTITIES], 0, Quality::WrongChip),
                sensor(ChannelKind::Imu, [39.0; MAX_QUANTITIES], 1, Quality::Saturated),
            ]),
        ),
        (
            "telemetry-angle",
            armed(&[
                sensor(ChannelKind::Angle, [3.0, 0.0, 0.0, 0.0, 0.0, 0.0], 1, Quality::NoMagnet),
                sensor(ChannelKind::Angle, [0.5, 0.0, 0.0, 0.0, 0.0, 0.0], 1, Quality::WeakMagnet),
                sensor(ChannelKind::Angle, [6.25, 0.0, 0.0, 0.0, 0.0, 0.0], 1, Quality::StrongMagnet),
            ]),
        ),
        (
            "telemetry-force",
            armed(&[
                sensor(ChannelKind::Force, [-12.5, 0.0, 0.0, 0.0, 0.0, 0.0], 12, Quality::Good),
                sensor(ChannelKind::Distance, [0.0625, 0.0, 0.0, 0.0, 0.0, 0.0], 50, Quality::OutOfRange),
            ]),
        ),
        ("telemetry-largest", largest_telemetry()),
    ]
    .into_iter()
}

fn every_cause() -> Causes {
    Cause::ALL.into_iter().fold(Causes::NONE, |all, cause| all.union(Causes::only(cause)))
}
