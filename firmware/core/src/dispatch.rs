//! From a decoded message to what the board does about it, and to the answer.

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::Instant;
use heapless::{String, Vec};
use r4_protocol::{
    ChannelId, ChannelInfo, DeviceInfo, Mode, ModeInfo, Range, Refusal, Reply, Request, SCHEMA_HASH, Setpoint,
    ToDevice, ToHost, Unit, VERSION, config::MotorConfig,
};

use crate::{FIRMWARE_VERSION, control::motor, safety::Event, shared::Shared, telemetry::Subscriptions};

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
            let index = motor_index(shared, channel, setpoint.mode)?;
            check_setpoint(&shared.config().motors[index], setpoint)?;
            shared.command(index, setpoint)?;
        }
        Request::SetGains { channel, mode, gains } => {
            let index = motor_index(shared, channel, mode)?;
            if mode == Mode::Duty {
                return Err(Refusal::WrongMode { channel, mode });
            }
            if !gains.is_valid() {
                return Err(Refusal::BadGains { channel });
            }
            shared.change_gains(index, mode, gains);
        }
        Request::Subscribe { channel, period_ms } => {
            if shared.motor_index(channel).is_none() && shared.supply_index(channel).is_none() {
                return Err(Refusal::UnknownChannel { channel });
            }
            subscriptions.set(channel, period_ms, now).map_err(|_| Refusal::TooManySubscriptions)?;
        }
    }
    Ok(Reply::Done)
}

fn motor_index<M: RawMutex>(shared: &Shared<M>, channel: ChannelId, mode: Mode) -> Result<usize, Refusal> {
    shared.motor_index(channel).ok_or_else(|| match shared.supply_index(channel) {
        Some(_) => Refusal::WrongMode { channel, mode },
        None => Refusal::UnknownChannel { channel },
    })
}

fn check_setpoint(motor: &MotorConfig, setpoint: Setpoint) -> Result<(), Refusal> {
    let (channel, asked) = (motor.id, setpoint.value);
    if !asked.is_finite() {
        return Err(Refusal::NotFinite { channel });
    }
    let modes = modes(motor);
    let mode = modes
        .iter()
        .find(|info| info.mode == setpoint.mode)
        .ok_or(Refusal::WrongMode { channel, mode: setpoint.mode })?;
    if mode.range.contains(asked) { Ok(()) } else { Err(Refusal::OutOfRange { channel, asked, range: mode.range }) }
}

fn device_info<M: RawMutex>(shared: &Shared<M>, session: u16, now: Instant) -> DeviceInfo {
    let config = shared.config();
    let view = shared.safety();
    DeviceInfo {
        robot: config.robot.clone(),
        // A crate version is far shorter than the field.
        firmware: String::try_from(FIRMWARE_VERSION).unwrap_or_default(),
        session,
        channels: (config.motors.len() + config.supplies.len()) as u8,
        link_timeout_ms: config.link_timeout_ms,
        device_us: now.as_micros(),
        state: view.state,
        causes: view.causes,
    }
}

/// Channel `index` of the list: motors first, then supplies.
fn channel_info<M: RawMutex>(shared: &Shared<M>, index: usize) -> Result<ChannelInfo, Refusal> {
    let config = shared.config();
    let rate_hz = 1e6 / config.control_period_us as f32;
    if let Some(motor) = config.motors.get(index) {
        let modes = modes(motor);
        return Ok(ChannelInfo {
            id: motor.id,
            unit: modes[0].unit,
            range: modes[0].range,
            rate_hz,
            resolution: motor::resolution(motor.feedback),
            modes,
        });
    }
    let supply = config.supplies.get(index - config.motors.len());
    supply.map_or(Err(Refusal::NoSuchIndex { index: index as u8 }), |supply| {
        Ok(ChannelInfo {
            id: supply.id,
            unit: Unit::V,
            range: supply.range_v,
            rate_hz,
            resolution: 0.0,
            modes: Vec::new(),
        })
    })
}

/// What a motor can be commanded to do. The first is the channel's own quantity.
fn modes(motor: &MotorConfig) -> Vec<ModeInfo, 3> {
    let (position, speed) = match motor.feedback {
        r4_protocol::config::Feedback::Encoder { .. } => (Unit::Rad, Unit::RadPerS),
        r4_protocol::config::Feedback::Potentiometer { .. } => (Unit::M, Unit::MPerS),
    };
    [
        ModeInfo { mode: Mode::Position, unit: position, range: motor.position },
        ModeInfo { mode: Mode::Speed, unit: speed, range: Range::symmetric(motor.speed_max) },
        ModeInfo { mode: Mode::Duty, unit: Unit::Duty, range: Range::symmetric(motor.duty_max) },
    ]
    .into_iter()
    .collect()
}
