//! Dispatch: from a decoded message to the board's action and the answer.

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::Instant;
use heapless::String;
use r4_protocol::{
    DeviceInfo, LogInfo, Mode, ParameterInfo, Refusal, Reply, Request, SetError, Spoken, ToDevice, ToHost,
    config::{BoardConfig, MotorConfig, Place},
    version::{REPEATS, SPOKEN, accept},
};

use crate::{
    FIRMWARE_VERSION,
    channel::{self, check_points, check_setpoint, modes_of, place},
    cycle::Bound,
    log::Feed,
    safety::Event,
    shared::{HostSide, ReportSide, Restart, at},
    storage::{Done, Job, parameters::Changes},
    telemetry::Subscriptions,
};

mod repeats;

use repeats::Repeats;

/// Outcome of a message.
pub(crate) enum Outcome {
    /// The message gets no answer.
    Nothing,
    /// The answer is ready now.
    Answer(ToHost),
    /// [`carry_out`] will answer it; meanwhile the link goes on.
    Later { seq: u16, request: Request },
}

/// State of the host of one link, until its session ends.
#[derive(Default)]
pub(crate) struct Host {
    pub(crate) subscriptions: Subscriptions,
    pub(crate) log: Feed,
    bound: Bound,
    /// Version of the protocol in which the session was opened; 0 before the first.
    version: u16,
    repeats: Repeats,
}

impl Host {
    fn clear(&mut self) {
        self.subscriptions.clear();
        self.log.clear();
        self.bound.clear();
        self.repeats.clear();
    }

    /// Answers a request; a repeated one gets the same answer again, without being carried out again.
    fn answer<M: RawMutex>(
        &mut self,
        shared: HostSide<'_, M>,
        link: u8,
        (seq, request): (u16, Request),
        now: Instant,
    ) -> Result<Reply, Refusal> {
        if self.version < REPEATS.since || !shared.has_session(link) || !request.is_done_once() {
            self.repeats.forget(seq);
            return answer(shared, link, self, request, now);
        }
        if let Some(before) = self.repeats.answer(seq, &request) {
            return before;
        }
        self.repeats.forget(seq);
        let result = answer(shared, link, self, request.clone(), now);
        self.repeats.remember(seq, request, &result);
        result
    }
}

/// Carries out `message`, which came over `link`, or defers it.
pub(crate) fn dispatch<M: RawMutex>(shared: HostSide<'_, M>, link: u8, host: &mut Host, message: ToDevice) -> Outcome {
    let now = Instant::now();
    match message {
        ToDevice::Heartbeat { session, host_us } if shared.heartbeat(link, session, now) => {
            let view = shared.safety();
            let device_us = now.as_micros();
            let hot = ReportSide::of(&shared).hot_windings();
            Outcome::Answer(ToHost::Heartbeat { host_us, device_us, state: view.state, causes: view.causes, hot })
        }
        ToDevice::Heartbeat { .. } => Outcome::Nothing,
        ToDevice::Cycle(cycle) => Outcome::Answer(host.bound.answer(shared, link, cycle, now)),
        ToDevice::Request { seq, request } if takes_time(&request) && shared.has_session(link) => {
            Outcome::Later { seq, request }
        }
        ToDevice::Request { seq, request } => {
            let result = host.answer(shared, link, (seq, request), now);
            Outcome::Answer(response(shared, seq, result))
        }
    }
}

/// Refuses an undamaged request of a later version. It may be a set point of an unknown kind, so all set points in
/// force end.
pub(crate) fn unknown<M: RawMutex>(shared: HostSide<'_, M>, link: u8, seq: u16, now: Instant) -> ToHost {
    if shared.has_session(link) {
        for (_, place) in shared.config().channels() {
            shared.withdraw(place, now.as_micros(), false);
        }
    }
    response(shared, seq, Err(Refusal::UnknownMessage))
}

/// Returns true if a request waits for flash or for an external device.
fn takes_time(request: &Request) -> bool {
    matches!(
        request,
        Request::SaveParameters
            | Request::Fault { .. }
            | Request::FaultSnapshot { .. }
            | Request::I2cTransfer { .. }
            | Request::UartWrite { .. }
            | Request::UartRead { .. }
    )
}

/// Carries out a request that [`dispatch`] has deferred, and returns the answer.
pub(crate) async fn carry_out<M: RawMutex>(shared: HostSide<'_, M>, seq: u16, request: Request) -> ToHost {
    let result = match request {
        Request::SaveParameters => save(shared).await,
        Request::Fault { index } => shared.storage.request(Job::Fault { index }).await.map(stored),
        Request::FaultSnapshot { index, snapshot } => {
            shared.storage.request(Job::Snapshot { index, snapshot }).await.map(stored)
        }
        raw => shared.passthrough.request(&raw).await,
    };
    response(shared, seq, result)
}

fn stored(done: Done) -> Reply {
    match done {
        Done::Saved => Reply::Done,
        Done::Fault(fault) => Reply::Fault(fault),
        Done::Snapshot(snapshot) => Reply::FaultSnapshot(snapshot),
    }
}

/// Saves the parameters that hosts have changed. A sector may have to be erased, so not while the board is armed.
async fn save<M: RawMutex>(shared: HostSide<'_, M>) -> Result<Reply, Refusal> {
    let _held = shared.hold_arming()?;
    let changes = Changes::between(shared.built_in(), &shared.pending());
    shared.storage.request(Job::Save(changes.map_err(|_| Refusal::StorageFailed)?)).await.map(stored)
}

fn response<M: RawMutex>(shared: HostSide<'_, M>, seq: u16, result: Result<Reply, Refusal>) -> ToHost {
    if result.is_err() {
        shared.count(|stats| stats.refused = stats.refused.wrapping_add(1));
    }
    ToHost::Response { seq, result }
}

fn describe_parameter<M: RawMutex>(shared: HostSide<'_, M>, index: usize) -> Result<ParameterInfo, Refusal> {
    let end = Refusal::NoSuchIndex { index: u8::try_from(index).unwrap_or(u8::MAX) };
    let key = shared.config().parameters().nth(index).ok_or(end)?;
    let active = shared.config().parameter(key).ok_or(end)?;
    let set = shared.pending().parameter(key).unwrap_or(active);
    let built_in = shared.built_in().parameter(key).unwrap_or(active);
    Ok(ParameterInfo { key, active, set, built_in })
}

fn answer<M: RawMutex>(
    shared: HostSide<'_, M>,
    link: u8,
    host: &mut Host,
    request: Request,
    now: Instant,
) -> Result<Reply, Refusal> {
    match request {
        Request::Hello { version, schema } => {
            let version = accept(&SPOKEN, Spoken { version, schema })?;
            let session = shared.open_session(link, now)?;
            host.clear();
            host.version = version;
            return Ok(Reply::Hello(device_info(shared, session, now)));
        }
        // Closing no session is no error, and a stop is accepted from any link.
        Request::Bye => {
            shared.close_session(link);
            host.clear();
            return Ok(Reply::Done);
        }
        Request::Stop => {
            shared.trip(r4_protocol::Cause::HostStop);
            return Ok(Reply::Done);
        }
        _ if !shared.has_session(link) => return Err(Refusal::NoSession),
        Request::Describe { index } => {
            return channel::info(shared.config(), usize::from(index)).map(Reply::Channel);
        }
        Request::Stats => return Ok(Reply::Stats(ReportSide::of(&shared).stats())),
        Request::Arm => shared.request(Event::Arm)?,
        Request::Disarm => shared.request(Event::Disarm)?,
        Request::Clear => shared.request(Event::Clear)?,
        Request::Set { channel, setpoint, sent_us, ttl_ms } => {
            let place = place(shared.config(), channel)?;
            let taken = check_age(sent_us, ttl_ms, now)
                .and_then(|()| check_setpoint(channel, &modes_of(shared.config(), place), setpoint))
                .and_then(|()| match setpoint.mode {
                    Mode::Follow => shared.follow(place, &[at(sent_us, setpoint.value)], sent_us),
                    _ => shared.command(place, setpoint, sent_us),
                });
            if let Err(refusal) = taken {
                // The host wants a different motion by now: its previous set point ends.
                let late = matches!(refusal, Refusal::Expired { .. } | Refusal::Late { .. });
                shared.withdraw(place, sent_us, late);
                return Err(refusal);
            }
        }
        Request::Follow { channel, sent_us, points } => {
            let place = place(shared.config(), channel)?;
            let taken = check_points(shared.config(), channel, place, &points)
                .and_then(|()| shared.follow(place, &points, sent_us));
            if let Err(refusal) = taken {
                shared.withdraw(place, sent_us, matches!(refusal, Refusal::Late { .. }));
                return Err(refusal);
            }
        }
        Request::SetGains { channel, mode, gains } => {
            let place = place(shared.config(), channel)?;
            let known = modes_of(shared.config(), place).iter().any(|info| info.mode == mode);
            let (Place::Motor(index), Mode::Position | Mode::Speed, true) = (place, mode, known) else {
                return Err(Refusal::WrongMode { channel, mode });
            };
            if !gains.is_valid() {
                return Err(Refusal::BadGains { channel });
            }
            shared.change_gains(index, mode, gains);
        }
        Request::SetTuning { channel, tuning } => {
            let place = place(shared.config(), channel)?;
            let motor = if let Place::Motor(index) = place { shared.config().motors.get(index) } else { None };
            let (Place::Motor(index), Some(MotorConfig { duty_max, control: Some(_), .. })) = (place, motor) else {
                return Err(Refusal::WrongMode { channel, mode: Mode::Position });
            };
            if !tuning.is_valid(*duty_max) {
                return Err(Refusal::BadGains { channel });
            }
            shared.change_tuning(index, tuning);
        }
        Request::Subscribe { channel, period_ms } => {
            place(shared.config(), channel)?;
            host.subscriptions.set(channel, period_ms, now).map_err(|_| Refusal::TooManySubscriptions)?;
        }
        Request::DescribeParameter { index } => {
            return describe_parameter(shared, usize::from(index)).map(Reply::Parameter);
        }
        Request::SetParameter { key, value } => {
            let mut config = shared.pending();
            config.set_parameter(key, value).map_err(|error| match error {
                SetError::Unknown(key) => Refusal::UnknownParameter { key },
                SetError::Invalid(_) => Refusal::BadParameter { key, value },
            })?;
            shared.set_pending(config);
        }
        Request::SetName { robot } => shared.set_pending(BoardConfig { robot, ..shared.pending() }),
        Request::ResetParameters => shared.set_pending(shared.built_in().clone()),
        Request::Restart => {
            shared.restart(Restart::Firmware)?;
        }
        Request::Bootloader => shared.restart(Restart::Bootloader)?,
        Request::Image => return shared.image().map(Reply::Image),
        Request::Log { on } => {
            let log = shared.log().ok_or(Refusal::NoLog)?;
            if on {
                host.log.begin(log, now)
            } else {
                host.log.clear()
            }
            return Ok(Reply::Log(LogInfo { image: log.image }));
        }
        Request::Bind { channels, ttl_ms } => host.bound.bind(shared, &channels, ttl_ms)?,
        // Not answered here: [`dispatch`] defers them.
        _ => return Err(Refusal::TransferFailed),
    }
    Ok(Reply::Done)
}

/// Checks that a set point decided at `sent_us` is neither too old nor dated too far ahead.
fn check_age(sent_us: u64, ttl_ms: u16, now: Instant) -> Result<(), Refusal> {
    let ms = |us: u64| u32::try_from(us / 1000).unwrap_or(u32::MAX);
    let (ahead_ms, age_ms) = (ms(sent_us.saturating_sub(now.as_micros())), ms(now.as_micros().saturating_sub(sent_us)));
    match (ahead_ms > ttl_ms.into(), age_ms > ttl_ms.into()) {
        (true, _) => Err(Refusal::ClockAhead { ahead_ms }),
        (_, true) => Err(Refusal::Expired { age_ms, ttl_ms }),
        (false, false) => Ok(()),
    }
}

fn device_info<M: RawMutex>(shared: HostSide<'_, M>, session: u16, now: Instant) -> DeviceInfo {
    let config = shared.config();
    let view = shared.safety();
    DeviceInfo {
        robot: config.robot.clone(),
        // A crate version is far shorter than the field.
        firmware: String::try_from(FIRMWARE_VERSION).unwrap_or_default(),
        session,
        channels: config.channels().count() as u8,
        link_timeout_ms: config.link_timeout_ms,
        device_us: now.as_micros(),
        state: view.state,
        causes: view.causes,
    }
}

#[cfg(test)]
mod tests;
