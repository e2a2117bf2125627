//! Strategies for any message at all: every variant, every value a field can hold.

use proptest::{
    arbitrary::any,
    collection::vec,
    option,
    prelude::{BoxedStrategy, Just, Strategy},
    prop_oneof,
    sample::select,
    strategy::ValueTree,
    test_runner::TestRunner,
};
use r4_protocol::{
    Causes, ChannelId, ChannelInfo, ChannelKind, Cycle, CycleChannel, CycleMotor, CycleOutcome, CycleState, DeviceInfo,
    DeviceStats, FaultInfo, FaultSnapshot, HotWinding, ImageInfo, LogChunk, LogInfo, Mode, ModeInfo, MotorSnapshot,
    Parameter, ParameterInfo, ParameterKey, PathPoint, Quality, Range, Refusal, Reply, Request, SafetyState, Sample,
    Setpoint, Telemetry, ToDevice, ToHost, Unit, Winding,
    channel::MAX_MODES,
    config::{FeedForward, MAX_MOTORS, MAX_NAME, MAX_SENSORS, MAX_SUPPLIES, PidGains, Tuning},
    cycle::CYCLE_CHANNELS,
    message::{MAX_FIRMWARE, MAX_POINTS, MAX_RAW, MAX_SAMPLES},
};

use crate::coverage;

/// Samples messages to a board.
pub(crate) fn to_device() -> BoxedStrategy<ToDevice> {
    prop_oneof![
        6 => (u16s(), request()).prop_map(|(seq, request)| ToDevice::Request { seq, request }),
        1 => (u16s(), u64s()).prop_map(|(session, host_us)| ToDevice::Heartbeat { session, host_us }),
        1 => cycle().prop_map(ToDevice::Cycle),
    ]
    .boxed()
}

/// Samples set points of cycles.
pub(crate) fn cycle() -> impl Strategy<Value = Cycle> {
    let set = any::<[i16; CYCLE_CHANNELS]>();
    (any::<u8>(), proptest::option::of(mode()), proptest::option::of(u64s()), set)
        .prop_map(|(seq, mode, sent_us, set)| Cycle::new(seq, mode, sent_us, set))
}

/// Samples answers to cycles.
pub(crate) fn cycle_state() -> impl Strategy<Value = CycleState> {
    use CycleOutcome::{Refused, Stale, Taken, Unbound};
    let motor = any::<(i32, i16, i16, bool)>().prop_map(|(position, speed, duty, settled)| CycleMotor {
        position,
        speed,
        duty,
        settled,
    });
    let motors = [motor.clone(), motor.clone(), motor.clone(), motor];
    (any::<u8>(), select(vec![Taken, Refused, Stale, Unbound]), u64s(), (state(), causes()), motors)
        .prop_map(|(seq, outcome, device_us, safety, motors)| CycleState::new(seq, outcome, device_us, safety, motors))
}

/// Samples messages to a host.
pub(crate) fn to_host() -> BoxedStrategy<ToHost> {
    let result = prop_oneof![reply().prop_map(Ok), refusal().prop_map(Err)];
    prop_oneof![
        3 => (u16s(), result).prop_map(|(seq, result)| ToHost::Response { seq, result }),
        1 => (u64s(), u64s(), state(), causes(), vec(hot_winding(), 0..=MAX_MOTORS)).prop_map(
            |(host_us, device_us, state, causes, hot)| ToHost::Heartbeat {
                host_us,
                device_us,
                state,
                causes,
                hot: hot.into_iter().collect()
            }
        ),
        2 => telemetry().prop_map(ToHost::Telemetry),
        1 => cycle_state().prop_map(ToHost::Cycle),
        1 => (any::<u32>(), raw()).prop_map(|(position, bytes)| ToHost::Log(LogChunk { position, bytes })),
    ]
    .boxed()
}

fn hot_winding() -> impl Strategy<Value = HotWinding> {
    (channel(), any::<u8>()).prop_map(|(channel, heat_percent)| HotWinding { channel, heat_percent })
}

fn winding() -> impl Strategy<Value = Winding> {
    any::<(u8, bool)>().prop_map(|(heat_percent, hot)| Winding { heat_percent, hot })
}

fn request() -> BoxedStrategy<Request> {
    prop_oneof![control_request(), service_request()].boxed()
}

fn control_request() -> BoxedStrategy<Request> {
    prop_oneof![
        (u16s(), u64s()).prop_map(|(version, schema)| Request::Hello { version, schema }),
        any::<u8>().prop_map(|index| Request::Describe { index }),
        select(vec![Request::Bye, Request::Arm, Request::Disarm, Request::Clear, Request::Stop, Request::Stats]),
        (channel(), setpoint(), u64s(), u16s()).prop_map(|(channel, setpoint, sent_us, ttl_ms)| Request::Set {
            channel,
            setpoint,
            sent_us,
            ttl_ms
        }),
        (channel(), u16s()).prop_map(|(channel, period_ms)| Request::Subscribe { channel, period_ms }),
        (channel(), mode(), gains()).prop_map(|(channel, mode, gains)| Request::SetGains { channel, mode, gains }),
        (channel(), tuning()).prop_map(|(channel, tuning)| Request::SetTuning { channel, tuning }),
    ]
    .boxed()
}

/// Samples requests about parameters, trips and raw transfers.
fn service_request() -> BoxedStrategy<Request> {
    prop_oneof![
        u16s().prop_map(|index| Request::DescribeParameter { index }),
        (key(), f32s()).prop_map(|(key, value)| Request::SetParameter { key, value }),
        string::<MAX_NAME>().prop_map(|robot| Request::SetName { robot }),
        select(vec![Request::SaveParameters, Request::ResetParameters, Request::Restart]),
        select(vec![Request::Image, Request::Bootloader]),
        any::<u8>().prop_map(|index| Request::Fault { index }),
        any::<(u8, u8)>().prop_map(|(index, snapshot)| Request::FaultSnapshot { index, snapshot }),
        (any::<(u8, u8, u8)>(), raw()).prop_map(|((bus, address, read), write)| Request::I2cTransfer {
            bus,
            address,
            write,
            read
        }),
        (any::<u8>(), raw()).prop_map(|(port, bytes)| Request::UartWrite { port, bytes }),
        any::<u8>().prop_map(|port| Request::UartRead { port }),
        any::<bool>().prop_map(|on| Request::Log { on }),
        (vec(cycle_channel(), 0..=CYCLE_CHANNELS), u16s())
            .prop_map(|(channels, ttl_ms)| Request::Bind { channels: channels.into_iter().collect(), ttl_ms }),
        (channel(), u64s(), vec(path_point(), 0..=MAX_POINTS)).prop_map(|(channel, sent_us, points)| Request::Follow {
            channel,
            sent_us,
            points: points.into_iter().collect()
        }),
    ]
    .boxed()
}

fn path_point() -> impl Strategy<Value = PathPoint> {
    (u64s(), f32s(), option::of(f32s()), f32s()).prop_map(|(at_us, position, speed, feed_forward)| PathPoint {
        at_us,
        position,
        speed,
        feed_forward,
    })
}

fn cycle_channel() -> impl Strategy<Value = CycleChannel> {
    (channel(), mode(), f32s(), f32s()).prop_map(|(channel, mode, position_scale, speed_scale)| CycleChannel {
        channel,
        mode,
        position_scale,
        speed_scale,
    })
}

fn reply() -> BoxedStrategy<Reply> {
    prop_oneof![
        device_info().prop_map(Reply::Hello),
        channel_info().prop_map(Reply::Channel),
        stats().prop_map(Reply::Stats),
        any::<u32>().prop_map(|image| Reply::Log(LogInfo { image })),
        (any::<bool>(), u32s(), u32s()).prop_map(|(hosted, bytes, crc)| Reply::Image(ImageInfo { hosted, bytes, crc })),
        Just(Reply::Done),
        parameter_info().prop_map(Reply::Parameter),
        fault_info().prop_map(Reply::Fault),
        fault_snapshot().prop_map(Reply::FaultSnapshot),
        raw().prop_map(Reply::Bytes),
    ]
    .boxed()
}

fn refusal() -> BoxedStrategy<Refusal> {
    prop_oneof![
        (u16s(), u64s()).prop_map(|(version, schema)| Refusal::ProtocolMismatch { version, schema }),
        select(vec![Refusal::NoSession, Refusal::InUse, Refusal::TooManySubscriptions]),
        channel().prop_map(|channel| Refusal::UnknownChannel { channel }),
        any::<u8>().prop_map(|index| Refusal::NoSuchIndex { index }),
        (channel(), mode()).prop_map(|(channel, mode)| Refusal::WrongMode { channel, mode }),
        channel().prop_map(|channel| Refusal::NotFinite { channel }),
        (channel(), f32s(), range()).prop_map(|(channel, asked, range)| Refusal::OutOfRange { channel, asked, range }),
        state().prop_map(|state| Refusal::NotArmed { state }),
        causes().prop_map(|causes| Refusal::CausesPresent { causes }),
        causes().prop_map(|causes| Refusal::Tripped { causes }),
        (u32s(), u16s()).prop_map(|(age_ms, ttl_ms)| Refusal::Expired { age_ms, ttl_ms }),
        channel().prop_map(|channel| Refusal::BadGains { channel }),
        u32s().prop_map(|ahead_ms| Refusal::ClockAhead { ahead_ms }),
        state().prop_map(|state| Refusal::NotWhile { state }),
        key().prop_map(|key| Refusal::UnknownParameter { key }),
        (key(), f32s()).prop_map(|(key, value)| Refusal::BadParameter { key, value }),
        select(vec![
            Refusal::StorageFailed,
            Refusal::NoSuchFault,
            Refusal::BadTransfer,
            Refusal::TransferFailed,
            Refusal::Busy,
            Refusal::NoLog,
            Refusal::NoImage,
            Refusal::NoBootloader,
            Refusal::UnknownMessage,
            Refusal::Denied
        ]),
        any::<u8>().prop_map(|address| Refusal::NoAcknowledge { address }),
        channel().prop_map(|channel| Refusal::BadBinding { channel }),
        channel().prop_map(|channel| Refusal::BadPath { channel }),
        u32s().prop_map(|late_us| Refusal::Late { late_us }),
        any::<u8>().prop_map(|room| Refusal::PathFull { room }),
        (channel(), f32s(), f32s()).prop_map(|(channel, asked, limit)| Refusal::TooFast { channel, asked, limit }),
    ]
    .boxed()
}

fn device_info() -> impl Strategy<Value = DeviceInfo> {
    (string::<MAX_NAME>(), string::<MAX_FIRMWARE>(), u16s(), any::<u8>(), u16s(), u64s(), state(), causes()).prop_map(
        |(robot, firmware, session, channels, link_timeout_ms, device_us, state, causes)| DeviceInfo {
            robot,
            firmware,
            session,
            channels,
            link_timeout_ms,
            device_us,
            state,
            causes,
        },
    )
}

fn channel_info() -> impl Strategy<Value = ChannelInfo> {
    let modes =
        vec((mode(), unit(), range()).prop_map(|(mode, unit, range)| ModeInfo { mode, unit, range }), 0..=MAX_MODES);
    (channel(), unit(), range(), f32s(), f32s(), modes).prop_map(|(id, unit, range, rate_hz, resolution, modes)| {
        ChannelInfo { id, unit, range, rate_hz, resolution, modes: modes.into_iter().collect() }
    })
}

fn stats() -> impl Strategy<Value = DeviceStats> {
    std::array::from_fn::<_, 14, _>(|_| u32s()).prop_map(
        |[
            ticks,
            late_ticks,
            worst_tick_us,
            bus_retries,
            frames,
            bad_frames,
            refused,
            telemetry_dropped,
            cycles_refused,
            setpoints_expired,
            can_bus_off,
            can_warnings,
            worst_tick_cycles,
            ticks_over_share,
        ]| DeviceStats {
            ticks,
            late_ticks,
            worst_tick_us,
            bus_retries,
            frames,
            bad_frames,
            refused,
            telemetry_dropped,
            cycles_refused,
            setpoints_expired,
            can_bus_off,
            can_warnings,
            worst_tick_cycles,
            ticks_over_share,
        },
    )
}

fn parameter_info() -> impl Strategy<Value = ParameterInfo> {
    (key(), f32s(), f32s(), f32s()).prop_map(|(key, active, set, built_in)| ParameterInfo {
        key,
        active,
        set,
        built_in,
    })
}

fn fault_info() -> impl Strategy<Value = FaultInfo> {
    (u32s(), u32s(), u64s(), causes(), any::<u8>()).prop_map(|(number, start, device_us, causes, snapshots)| {
        FaultInfo { number, start, device_us, causes, snapshots }
    })
}

fn fault_snapshot() -> impl Strategy<Value = FaultSnapshot> {
    let motor =
        (any::<i32>(), f32s(), f32s()).prop_map(|(position, speed, duty)| MotorSnapshot { position, speed, duty });
    (u16s(), vec(motor, 0..=MAX_MOTORS), vec(f32s(), 0..=MAX_SUPPLIES)).prop_map(|(before_ms, motors, supplies_v)| {
        FaultSnapshot { before_ms, motors: motors.into_iter().collect(), supplies_v: supplies_v.into_iter().collect() }
    })
}

fn telemetry() -> impl Strategy<Value = Telemetry> {
    // A frame has at most one sample of each sensor, so at most as many as a board has sensors.
    let sensors = vec(sensor_sample(), 0..=MAX_SENSORS);
    let others = vec(sample(), 0..=MAX_SAMPLES - MAX_SENSORS);
    (u64s(), state(), causes(), sensors, others).prop_map(|(device_us, state, causes, sensors, others)| Telemetry {
        device_us,
        state,
        causes,
        samples: sensors.into_iter().chain(others).collect(),
    })
}

fn sample() -> impl Strategy<Value = Sample> {
    prop_oneof![
        (channel(), setpoint(), any::<i32>(), f32s(), f32s(), any::<(bool, bool)>(), option::of(winding())).prop_map(
            |(channel, setpoint, position, speed, duty, (settled, homed), winding)| Sample::Motor {
                channel,
                setpoint,
                position,
                speed,
                duty,
                settled,
                homed,
                winding
            }
        ),
        (channel(), f32s()).prop_map(|(channel, value)| Sample::Scalar { channel, value }),
        (channel(), f32s(), u16s(), quality()).prop_map(|(channel, value, age_ms, quality)| Sample::Reading {
            channel,
            value,
            age_ms,
            quality
        }),
        (channel(), any::<i32>(), f32s(), u32s()).prop_map(|(channel, position, speed, illegal)| Sample::Encoder {
            channel,
            position,
            speed,
            illegal
        }),
    ]
}

fn sensor_sample() -> impl Strategy<Value = Sample> {
    let values = proptest::array::uniform6(f32s());
    (channel(), values, u16s(), quality()).prop_map(|(channel, values, age_ms, quality)| Sample::Sensor {
        channel,
        values,
        age_ms,
        quality,
    })
}

fn quality() -> impl Strategy<Value = Quality> {
    use Quality::{
        Good, High, Low, NoAnswer, NoMagnet, None, OutOfRange, Saturated, Stale, StrongMagnet, Stuck, WeakMagnet,
        WrongChip,
    };
    select(vec![
        Good,
        None,
        OutOfRange,
        NoAnswer,
        Stuck,
        Low,
        High,
        Stale,
        WrongChip,
        Saturated,
        NoMagnet,
        WeakMagnet,
        StrongMagnet,
    ])
}

fn key() -> impl Strategy<Value = ParameterKey> {
    let parameters: Vec<_> = Parameter::all().collect();
    (proptest::option::of(channel()), select(parameters))
        .prop_map(|(channel, parameter)| ParameterKey { channel, parameter })
}

/// Samples up to as many bytes as a raw transfer takes.
fn raw() -> impl Strategy<Value = heapless::Vec<u8, MAX_RAW>> {
    vec(any::<u8>(), 0..=MAX_RAW).prop_map(|bytes| bytes.into_iter().collect())
}

fn channel() -> impl Strategy<Value = ChannelId> {
    use ChannelKind::{
        Actuator, Analog, Angle, Bldc, Current, Dac, DeadMan, Dhb, Distance, Encoder, Force, Imu, Osmc, Range, Relay,
        Servo, Stepper, Supply, Switch,
    };
    let kinds = vec![
        Osmc, Actuator, Dhb, Bldc, Servo, Stepper, Relay, Encoder, Switch, Range, Analog, Supply, Dac, DeadMan, Imu,
        Current, Angle, Force, Distance,
    ];
    (select(kinds), any::<u8>()).prop_map(|(kind, index)| ChannelId::new(kind, index))
}

fn unit() -> impl Strategy<Value = Unit> {
    select(vec![
        Unit::Rad,
        Unit::RadPerS,
        Unit::M,
        Unit::MPerS,
        Unit::Duty,
        Unit::V,
        Unit::Bool,
        Unit::MPerS2,
        Unit::A,
        Unit::N,
    ])
}

fn mode() -> impl Strategy<Value = Mode> {
    select(vec![
        Mode::Position,
        Mode::Speed,
        Mode::Duty,
        Mode::Switch,
        Mode::Voltage,
        Mode::Brake,
        Mode::Home,
        Mode::Follow,
        Mode::Force,
    ])
}

fn state() -> impl Strategy<Value = SafetyState> {
    select(vec![SafetyState::Disarmed, SafetyState::Armed, SafetyState::Tripped])
}

/// Samples sets of causes, including bits without a cause, which a newer board may use.
fn causes() -> impl Strategy<Value = Causes> {
    any::<u32>().prop_map(Causes::from_bits)
}

fn setpoint() -> impl Strategy<Value = Setpoint> {
    (mode(), f32s()).prop_map(|(mode, value)| Setpoint { mode, value })
}

fn range() -> impl Strategy<Value = Range> {
    (f32s(), f32s()).prop_map(|(min, max)| Range { min, max })
}

fn gains() -> impl Strategy<Value = PidGains> {
    (f32s(), f32s(), f32s()).prop_map(|(kp, ki, kd)| PidGains { kp, ki, kd })
}

fn tuning() -> impl Strategy<Value = Tuning> {
    (f32s(), f32s(), f32s(), f32s()).prop_map(|(static_duty, duty_per_speed, duty_per_acceleration, cascade_per_s)| {
        Tuning { feed_forward: FeedForward { static_duty, duty_per_speed, duty_per_acceleration }, cascade_per_s }
    })
}

/// Samples every bit pattern, NaNs among them, and half the time one with many zero bytes, which are the special case
/// of COBS.
fn f32s() -> impl Strategy<Value = f32> {
    (any::<u32>(), select(vec![u32::MAX, 0xFFFF_0000, 0])).prop_map(|(bits, mask)| f32::from_bits(bits & mask))
}

/// Samples as many short as long numbers: their length on the wire depends on their value.
fn u16s() -> impl Strategy<Value = u16> {
    (any::<u16>(), 0..16u32).prop_map(|(value, shift)| value >> shift)
}

fn u32s() -> impl Strategy<Value = u32> {
    (any::<u32>(), 0..32u32).prop_map(|(value, shift)| value >> shift)
}

fn u64s() -> impl Strategy<Value = u64> {
    (any::<u64>(), 0..64u32).prop_map(|(value, shift)| value >> shift)
}

/// Samples up to `N` bytes of any characters.
fn string<const N: usize>() -> impl Strategy<Value = heapless::String<N>> {
    vec(any::<char>(), 0..=N).prop_map(|characters| {
        let mut text = heapless::String::new();
        // A character that does not fit is left out.
        characters.into_iter().for_each(|character| drop(text.push(character)));
        text
    })
}

#[test]
fn the_strategies_have_every_variant() {
    // The rarest variants are the 53 parameters, each in one of some 500 pairs of messages: one of them is missed in 8000
    // with probability 4e-6. The generator is seeded, so it is the same 8000 each time.
    let mut runner = TestRunner::deterministic();
    let mut seen = coverage::Variants::new();
    for _ in 0..8000 {
        coverage::note(&to_device().new_tree(&mut runner).expect("no filters").current(), &mut seen);
        coverage::note(&to_host().new_tree(&mut runner).expect("no filters").current(), &mut seen);
    }
    let missing: Vec<_> = coverage::all().difference(&seen).cloned().collect();
    assert!(missing.is_empty(), "no strategy gives {missing:?}");
}
