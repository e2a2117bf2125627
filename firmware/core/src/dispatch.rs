//! From a decoded message to what the board does about it, and to the answer.

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::Instant;
use heapless::{String, Vec};
use r4_protocol::{
    ChannelId, ChannelInfo, DeviceInfo, Mode, ModeInfo, Range, Refusal, Reply, Request, SCHEMA_HASH, Setpoint,
    ToDevice, ToHost, Unit, VERSION,
    config::{Feedback, MotorConfig, RelayRole},
};

use crate::{
    FIRMWARE_VERSION,
    control::motor,
    safety::Event,
    shared::{Output, Shared},
    telemetry::Subscriptions,
};

/// Answers `message`, which came over `link`; `None` for what wants no answer.
pub(crate) fn dispatch<M: RawMutex>(
    shared: &Shared<M>,
    link: u8,
    subscriptions: &mut Subscriptions,
    message: ToDevice,
) -> Option<ToHost> {
    let now = Instant::now();
    match message {
        ToDevice::Heartbeat { session, host_us } => shared.heartbeat(link, session, now).then(|| {
            let view = shared.safety();
            ToHost::Heartbeat { host_us, device_us: now.as_micros(), state: view.state, causes: view.causes }
        }),
        ToDevice::Request { seq, request } => {
            let result = answer(shared, link, subscriptions, request, now);
            if result.is_err() {
                shared.count(|stats| stats.refused = stats.refused.wrapping_add(1));
            }
            Some(ToHost::Response { seq, result })
        }
    }
}

fn answer<M: RawMutex>(
    shared: &Shared<M>,
    link: u8,
    subscriptions: &mut Subscriptions,
    request: Request,
    now: Instant,
) -> Result<Reply, Refusal> {
    match request {
        Request::Hello { version, schema } => {
            if (version, schema) != (VERSION, SCHEMA_HASH) {
                return Err(Refusal::ProtocolMismatch { version: VERSION, schema: SCHEMA_HASH });
            }
            let session = shared.open_session(link, now)?;
            subscriptions.clear();
            return Ok(Reply::Hello(device_info(shared, session, now)));
        }
        // Ending nothing is no error, and a stop is taken from anyone.
        Request::Bye => {
            shared.close_session(link);
            subscriptions.clear();
            return Ok(Reply::Done);
        }
        Request::Stop => {
            shared.trip(r4_protocol::Cause::HostStop);
            return Ok(Reply::Done);
        }
        _ if !shared.has_session(link) => return Err(Refusal::NoSession),
        Request::Describe { index } => {
            return channel_info(shared, usize::from(index)).map(Reply::Channel);
        }
        Request::Stats => return Ok(Reply::Stats(shared.stats())),
        Request::Arm => shared.request(Event::Arm)?,
        Request::Disarm => shared.request(Event::Disarm)?,
        Request::Clear => shared.request(Event::Clear)?,
        Request::Set { channel, setpoint, sent_us, ttl_ms } => {
            let ahead_ms = sent_us.saturating_sub(now.as_micros()) / 1000;
            if ahead_ms > ttl_ms.into() {
                return Err(Refusal::ClockAhead { ahead_ms: u32::try_from(ahead_ms).unwrap_or(u32::MAX) });
            }
            let age_ms = now.as_micros().saturating_sub(sent_us) / 1000;
            if age_ms > ttl_ms.into() {
                let age_ms = u32::try_from(age_ms).unwrap_or(u32::MAX);
                return Err(Refusal::Expired { age_ms, ttl_ms });
            }
            let output = output(shared, channel, setpoint.mode)?;
            check_setpoint(channel, &modes_of(shared, output), setpoint)?;
            shared.command(output, setpoint)?;
        }
        Request::SetGains { channel, mode, gains } => {
            let (Output::Motor(index), Mode::Position | Mode::Speed) = (output(shared, channel, mode)?, mode) else {
                return Err(Refusal::WrongMode { channel, mode });
            };
            if !gains.is_valid() {
                return Err(Refusal::BadGains { channel });
            }
            shared.change_gains(index, mode, gains);
        }
        Request::Subscribe { channel, period_ms } => {
            if !shared.has_channel(channel) {
                return Err(Refusal::UnknownChannel { channel });
            }
            subscriptions.set(channel, period_ms, now).map_err(|_| Refusal::TooManySubscriptions)?;
        }
    }
    Ok(Reply::Done)
}

/// The output that `channel` is, for a command in `mode`.
fn output<M: RawMutex>(shared: &Shared<M>, channel: ChannelId, mode: Mode) -> Result<Output, Refusal> {
    let motor = shared.motor_index(channel).map(Output::Motor);
    let found = motor.or_else(|| shared.relay_index(channel).map(Output::Relay));
    found.ok_or(if shared.has_channel(channel) {
        Refusal::WrongMode { channel, mode }
    } else {
        Refusal::UnknownChannel { channel }
    })
}

fn check_setpoint(channel: ChannelId, modes: &[ModeInfo], setpoint: Setpoint) -> Result<(), Refusal> {
    let Setpoint { mode, value: asked } = setpoint;
    if !asked.is_finite() {
        return Err(Refusal::NotFinite { channel });
    }
    let info = modes.iter().find(|info| info.mode == mode).ok_or(Refusal::WrongMode { channel, mode })?;
    let half_switched = mode == Mode::Switch && asked != 0.0 && asked != 1.0;
    if info.range.contains(asked) && !half_switched {
        Ok(())
    } else {
        Err(Refusal::OutOfRange { channel, asked, range: info.range })
    }
}

fn device_info<M: RawMutex>(shared: &Shared<M>, session: u16, now: Instant) -> DeviceInfo {
    let config = shared.config();
    let view = shared.safety();
    DeviceInfo {
        robot: config.robot.clone(),
        // A crate version is far shorter than the field.
        firmware: String::try_from(FIRMWARE_VERSION).unwrap_or_default(),
        session,
        channels: (config.motors.len() + config.relays.len() + config.supplies.len()) as u8,
        link_timeout_ms: config.link_timeout_ms,
        device_us: now.as_micros(),
        state: view.state,
        causes: view.causes,
    }
}

/// Channel `index` of the list: motors, relays, supplies.
fn channel_info<M: RawMutex>(shared: &Shared<M>, index: usize) -> Result<ChannelInfo, Refusal> {
    let config = shared.config();
    let rate_hz = 1e6 / config.control_period_us as f32;
    let motors = config.motors.iter().enumerate().map(|(index, motor)| {
        let modes = modes_of(shared, Output::Motor(index));
        let resolution = motor::resolution(motor.feedback);
        ChannelInfo { id: motor.id, unit: modes[0].unit, range: modes[0].range, rate_hz, resolution, modes }
    });
    let relays = config.relays.iter().enumerate().map(|(index, relay)| ChannelInfo {
        id: relay.id,
        unit: Unit::Bool,
        range: SWITCH,
        rate_hz,
        resolution: 0.0,
        modes: modes_of(shared, Output::Relay(index)),
    });
    let supplies = config.supplies.iter().map(|supply| ChannelInfo {
        id: supply.id,
        unit: Unit::V,
        range: supply.range_v,
        rate_hz,
        resolution: 0.0,
        modes: Vec::new(),
    });
    motors.chain(relays).chain(supplies).nth(index).ok_or(Refusal::NoSuchIndex { index: index as u8 })
}

/// Off and on.
const SWITCH: Range = Range::new(0.0, 1.0);

/// What an output can be commanded to do: a motor's own quantity first; nothing for the relay in the motors' supply.
fn modes_of<M: RawMutex>(shared: &Shared<M>, output: Output) -> Vec<ModeInfo, 3> {
    match output {
        Output::Motor(index) => motor_modes(&shared.config().motors[index]),
        Output::Relay(index) if shared.config().relays[index].role == RelayRole::MotorPower => Vec::new(),
        Output::Relay(_) => [ModeInfo { mode: Mode::Switch, unit: Unit::Bool, range: SWITCH }].into_iter().collect(),
    }
}

fn motor_modes(motor: &MotorConfig) -> Vec<ModeInfo, 3> {
    let (position, speed) = match motor.feedback {
        Feedback::Encoder { .. } => (Unit::Rad, Unit::RadPerS),
        Feedback::Potentiometer { .. } => (Unit::M, Unit::MPerS),
    };
    [
        ModeInfo { mode: Mode::Position, unit: position, range: motor.position },
        ModeInfo { mode: Mode::Speed, unit: speed, range: Range::symmetric(motor.speed_max) },
        ModeInfo { mode: Mode::Duty, unit: Unit::Duty, range: Range::symmetric(motor.duty_max) },
    ]
    .into_iter()
    .collect()
}
