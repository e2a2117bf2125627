//! Dispatch: from a decoded message to the board's action and the answer.

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::Instant;
use heapless::{String, Vec};
use r4_protocol::{
    ChannelId, ChannelInfo, DeviceInfo, LogInfo, Mode, ModeInfo, ParameterInfo, PathPoint, Range, Refusal, Reply,
    Request, SetError, Setpoint, Spoken, ToDevice, ToHost, Unit,
    channel::MAX_MODES,
    config::{
        BoardConfig, ControlConfig, DAC_FULL_SCALE_V, HomingConfig, MotorConfig, Place, RelayRole, Reverse,
        SensorDescription, StepperConfig,
    },
    version::{REPEATS, SPOKEN, accept},
};

use crate::{
    FIRMWARE_VERSION,
    control::motor,
    cycle::Bound,
    log::Feed,
    ranging,
    safety::Event,
    shared::{Restart, Shared, at},
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
        shared: &Shared<M>,
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
pub(crate) fn dispatch<M: RawMutex>(shared: &Shared<M>, link: u8, host: &mut Host, message: ToDevice) -> Outcome {
    let now = Instant::now();
    match message {
        ToDevice::Heartbeat { session, host_us } if shared.heartbeat(link, session, now) => {
            let view = shared.safety();
            let device_us = now.as_micros();
            let hot = shared.hot_windings();
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
pub(crate) fn unknown<M: RawMutex>(shared: &Shared<M>, link: u8, seq: u16, now: Instant) -> ToHost {
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
pub(crate) async fn carry_out<M: RawMutex>(shared: &Shared<M>, seq: u16, request: Request) -> ToHost {
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
async fn save<M: RawMutex>(shared: &Shared<M>) -> Result<Reply, Refusal> {
    let _held = shared.hold_arming()?;
    let changes = Changes::between(shared.built_in(), &shared.pending());
    shared.storage.request(Job::Save(changes.map_err(|_| Refusal::StorageFailed)?)).await.map(stored)
}

fn response<M: RawMutex>(shared: &Shared<M>, seq: u16, result: Result<Reply, Refusal>) -> ToHost {
    if result.is_err() {
        shared.count(|stats| stats.refused = stats.refused.wrapping_add(1));
    }
    ToHost::Response { seq, result }
}

fn describe_parameter<M: RawMutex>(shared: &Shared<M>, index: usize) -> Result<ParameterInfo, Refusal> {
    let end = Refusal::NoSuchIndex { index: u8::try_from(index).unwrap_or(u8::MAX) };
    let key = shared.config().parameters().nth(index).ok_or(end)?;
    let active = shared.config().parameter(key).ok_or(end)?;
    let set = shared.pending().parameter(key).unwrap_or(active);
    let built_in = shared.built_in().parameter(key).unwrap_or(active);
    Ok(ParameterInfo { key, active, set, built_in })
}

fn answer<M: RawMutex>(
    shared: &Shared<M>,
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
            return channel_info(shared, usize::from(index)).map(Reply::Channel);
        }
        Request::Stats => return Ok(Reply::Stats(shared.stats())),
        Request::Arm => shared.request(Event::Arm)?,
        Request::Disarm => shared.request(Event::Disarm)?,
        Request::Clear => shared.request(Event::Clear)?,
        Request::Set { channel, setpoint, sent_us, ttl_ms } => {
            let place = place(shared, channel)?;
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
            let place = place(shared, channel)?;
            let taken = check_points(shared.config(), channel, place, &points)
                .and_then(|()| shared.follow(place, &points, sent_us));
            if let Err(refusal) = taken {
                shared.withdraw(place, sent_us, matches!(refusal, Refusal::Late { .. }));
                return Err(refusal);
            }
        }
        Request::SetGains { channel, mode, gains } => {
            let place = place(shared, channel)?;
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
            let place = place(shared, channel)?;
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
            place(shared, channel)?;
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

pub(crate) fn place<M: RawMutex>(shared: &Shared<M>, channel: ChannelId) -> Result<Place, Refusal> {
    shared.config().place(channel).ok_or(Refusal::UnknownChannel { channel })
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

pub(crate) fn check_setpoint(channel: ChannelId, modes: &[ModeInfo], setpoint: Setpoint) -> Result<(), Refusal> {
    let Setpoint { mode, value: asked } = setpoint;
    if !asked.is_finite() {
        return Err(Refusal::NotFinite { channel });
    }
    let info = modes.iter().find(|info| info.mode == mode).ok_or(Refusal::WrongMode { channel, mode })?;
    let nowhere = mode == Mode::Home && asked == 0.0;
    let half_switched = info.unit == Unit::Bool && asked != 0.0 && asked != 1.0;
    if info.range.contains(asked) && !half_switched && !nowhere {
        Ok(())
    } else {
        Err(Refusal::OutOfRange { channel, asked, range: info.range })
    }
}

/// Checks the values of a path's points against the channel's ranges; their times and speeds are checked against the
/// stored points.
fn check_points(config: &BoardConfig, channel: ChannelId, place: Place, points: &[PathPoint]) -> Result<(), Refusal> {
    let modes = modes_of(config, place);
    let limit = |mode| modes.iter().find(|info| info.mode == mode).map(|info| info.range);
    let (Some(_), Some(duties)) = (limit(Mode::Follow), limit(Mode::Duty)) else {
        return Err(Refusal::WrongMode { channel, mode: Mode::Follow });
    };
    for PathPoint { position, speed, feed_forward, .. } in points {
        check_setpoint(channel, &modes, Setpoint { mode: Mode::Follow, value: *position })?;
        if !feed_forward.is_finite() || speed.is_some_and(|speed| !speed.is_finite()) {
            return Err(Refusal::NotFinite { channel });
        }
        if !duties.contains(*feed_forward) {
            return Err(Refusal::OutOfRange { channel, asked: *feed_forward, range: duties });
        }
    }
    Ok(())
}

fn device_info<M: RawMutex>(shared: &Shared<M>, session: u16, now: Instant) -> DeviceInfo {
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

/// Description of channel `index` of the board's list.
fn channel_info<M: RawMutex>(shared: &Shared<M>, index: usize) -> Result<ChannelInfo, Refusal> {
    let config = shared.config();
    let (id, place) = config.channels().nth(index).ok_or(Refusal::NoSuchIndex { index: index as u8 })?;
    let modes = modes_of(config, place);
    let (unit, range) = quantity(config, place, &modes);
    Ok(ChannelInfo { id, unit, range, rate_hz: rate_hz(config, place), resolution: resolution(config, place), modes })
}

/// Range of a switched output: 0 is off, 1 is on.
const SWITCH: Range = Range::new(0.0, 1.0);

/// Unit and range of a channel's measurement or, for a pure output, of its set point.
fn quantity(config: &BoardConfig, place: Place, modes: &[ModeInfo]) -> (Unit, Range) {
    const FULL_CODE: f32 = 65_535.0;
    match (place, modes.first()) {
        (Place::Encoder(_), _) => (Unit::Rad, Range::symmetric(f32::MAX)),
        (Place::Range(index), _) => (Unit::M, config.ranges[index].range_m),
        (Place::Analog(index), _) => {
            let analog = &config.analogs[index];
            (Unit::V, Range::new(analog.offset_v, analog.offset_v + FULL_CODE * analog.volts_per_code))
        }
        (Place::Supply(index), _) => (Unit::V, config.supplies[index].range_v),
        (Place::Sensor(index), _) => {
            let SensorDescription { kind, range, .. } = config.sensors[index].chip.description();
            // Every kind of sensor on the bus has quantities.
            (kind.quantities().first().map_or(Unit::Bool, |first| first.unit), range)
        }
        // The first mode of a motor is its own quantity.
        (_, Some(first)) => (first.unit, first.range),
        (_, None) => (Unit::Bool, SWITCH),
    }
}

/// Rate at which a channel is measured or driven, Hz.
fn rate_hz(config: &BoardConfig, place: Place) -> f32 {
    match place {
        Place::Range(_) => 1e6 / ranging::cycle(config.ranges.len()).as_micros() as f32,
        Place::Sensor(index) => config.sensors[index].rate_hz.into(),
        Place::Servo(_) => config.servo_pwm.map_or(0.0, |chip| chip.frequency_hz),
        _ => 1e6 / config.control_period_us as f32,
    }
}

/// Size of one count of a channel's position, rad or m; 0 without a position.
fn resolution(config: &BoardConfig, place: Place) -> f32 {
    const TURN: f32 = core::f32::consts::TAU;
    match place {
        Place::Motor(index) => config.motors[index].control.map_or(0.0, |control| motor::resolution(control.feedback)),
        Place::Stepper(index) => TURN / config.steppers[index].steps_per_turn as f32,
        Place::Encoder(index) => TURN / config.encoders[index].counts_per_turn as f32,
        _ => 0.0,
    }
}

/// Modes in which an output can be commanded: a motor's own quantity first; none for the relay in the motors' supply.
pub(crate) fn modes_of(config: &BoardConfig, place: Place) -> Vec<ModeInfo, MAX_MODES> {
    let mode = |mode, unit, range| ModeInfo { mode, unit, range };
    match place {
        Place::Motor(index) => motor_modes(&config.motors[index]),
        Place::Stepper(index) => {
            let StepperConfig { position, speed_max, homing, .. } = config.steppers[index];
            let moves = [
                mode(Mode::Position, Unit::Rad, position),
                mode(Mode::Speed, Unit::RadPerS, Range::symmetric(speed_max)),
            ];
            moves.into_iter().chain(home_mode(homing)).collect()
        }
        Place::Servo(index) => [mode(Mode::Position, Unit::Rad, config.servos[index].position())].into_iter().collect(),
        Place::Bldc(index) => {
            let bldc = &config.bldcs[index];
            let backwards = if bldc.reverse == Reverse::None { 0.0 } else { -1.0 };
            let speed = mode(Mode::Duty, Unit::Duty, Range::new(backwards, 1.0));
            let brake = bldc.brake.map(|_| mode(Mode::Brake, Unit::Bool, SWITCH));
            [speed].into_iter().chain(brake).collect()
        }
        Place::Relay(index) if config.relays[index].role == RelayRole::General => {
            [mode(Mode::Switch, Unit::Bool, SWITCH)].into_iter().collect()
        }
        Place::Dac(index) => {
            let Range { min, max } = config.dacs[index].range_v;
            let range = Range::new(min.max(0.0), max.min(DAC_FULL_SCALE_V));
            [mode(Mode::Voltage, Unit::V, range)].into_iter().collect()
        }
        _ => Vec::new(),
    }
}

fn motor_modes(motor: &MotorConfig) -> Vec<ModeInfo, MAX_MODES> {
    let duty = ModeInfo { mode: Mode::Duty, unit: Unit::Duty, range: Range::symmetric(motor.duty_max) };
    let Some(ControlConfig { feedback, position, speed_max, homing, force, .. }) = motor.control else {
        return [duty].into_iter().collect();
    };
    let (position_unit, speed_unit) =
        if feedback.turns() { (Unit::Rad, Unit::RadPerS) } else { (Unit::M, Unit::MPerS) };
    let position = ModeInfo { mode: Mode::Position, unit: position_unit, range: position };
    let speed = ModeInfo { mode: Mode::Speed, unit: speed_unit, range: Range::symmetric(speed_max) };
    let follow = ModeInfo { mode: Mode::Follow, ..position };
    let force = force.map(|force| force.mode());
    [position, speed, duty, follow].into_iter().chain(home_mode(homing)).chain(force).collect()
}

fn home_mode(homing: Option<HomingConfig>) -> Option<ModeInfo> {
    let range = Range::symmetric(homing?.speed_max);
    Some(ModeInfo { mode: Mode::Home, unit: Unit::RadPerS, range })
}

#[cfg(test)]
mod tests;
