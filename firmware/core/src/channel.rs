//! Channels of a board by its configuration: units, ranges, modes and resolutions, and the set points that they can take.

use heapless::Vec;
use r4_protocol::{
    ChannelId, ChannelInfo, Mode, ModeInfo, PathPoint, Range, Refusal, Setpoint, Unit,
    channel::MAX_MODES,
    config::{
        AS5600_COUNTS, BoardConfig, ControlConfig, DAC_FULL_SCALE_V, Feedback, HomingConfig, MotorConfig, Place,
        RelayRole, Reverse, SensorDescription, StepperConfig,
    },
};

use crate::ranging;

/// Place of `channel` on the board.
///
/// # Errors
/// [`Refusal::UnknownChannel`] for one that the board does not have.
pub(crate) fn place(config: &BoardConfig, channel: ChannelId) -> Result<Place, Refusal> {
    config.place(channel).ok_or(Refusal::UnknownChannel { channel })
}

/// Count of a potentiometer channel's position on the wire, m.
const POT_RESOLUTION_M: f32 = 1e-6;

/// Returns the size of one count of the channel's position on the wire, rad or m.
pub(crate) fn resolution(feedback: Feedback) -> f32 {
    match feedback {
        Feedback::Encoder { counts_per_turn, .. } => core::f32::consts::TAU / counts_per_turn as f32,
        Feedback::Potentiometer { .. } => POT_RESOLUTION_M,
        Feedback::Angle { .. } | Feedback::Pulses { .. } => core::f32::consts::TAU / AS5600_COUNTS as f32,
    }
}

/// Checks a set point for `channel`, which has `modes`: finite, a known mode, within its range.
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
pub(crate) fn check_points(
    config: &BoardConfig,
    channel: ChannelId,
    place: Place,
    points: &[PathPoint],
) -> Result<(), Refusal> {
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

/// Description of channel `index` of the board's list.
///
/// # Errors
/// [`Refusal::NoSuchIndex`] behind the last channel.
pub(crate) fn info(config: &BoardConfig, index: usize) -> Result<ChannelInfo, Refusal> {
    let (id, place) = config.channels().nth(index).ok_or(Refusal::NoSuchIndex { index: index as u8 })?;
    let modes = modes_of(config, place);
    let (unit, range) = quantity(config, place, &modes);
    Ok(ChannelInfo { id, unit, range, rate_hz: rate_hz(config, place), resolution: count(config, place), modes })
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
fn count(config: &BoardConfig, place: Place) -> f32 {
    const TURN: f32 = core::f32::consts::TAU;
    match place {
        Place::Motor(index) => config.motors[index].control.map_or(0.0, |control| resolution(control.feedback)),
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
