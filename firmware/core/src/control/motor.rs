//! Motor channel: feedback, loops, path, limits and watch.

use embassy_time::Instant;
use r4_protocol::{
    Cause, Causes, Mode, Setpoint,
    config::{ControlConfig, FeedForward, Feedback, PidGains, Tuning},
};

use super::{
    follower::{Follower, Reference},
    force::{Force, Press},
    landing::Landing,
    model::{Aim, Model},
    motor_side::MotorSide,
    pid::{BadPeriod, OutputLimits, Pid},
    profile::{Moment, Profile, Ramp},
    watch::{Seen, Watch},
};
use crate::{
    channel::resolution,
    path::Leg,
    root::sqrtf,
    sensing::{
        angle::{Angle, Mounting, Reading},
        encoder::Encoder,
        filter::LowPass,
        index::Index,
        potentiometer::Potentiometer,
    },
    shared::MotorStatus,
    within::Within,
};

enum Sensor {
    Encoder(Encoder),
    Potentiometer(Potentiometer),
    Angle(Angle),
}

/// Sensor values of a motor in one period.
#[derive(Clone, Copy, Debug)]
pub struct Raw {
    /// Sensor value at the output.
    pub output: Output,
    /// Counter of the encoder on the motor's side; ignored where there is none.
    pub motor_side: u16,
}

/// Value of the sensor at a motor's output.
#[derive(Clone, Copy, Debug)]
pub enum Output {
    /// Counter of an encoder, or code of a converter.
    Code(u16),
    /// Last reading of an angle sensor, and the present time.
    Angle(Option<Reading>, Instant),
}

impl From<u16> for Raw {
    fn from(code: u16) -> Self {
        Self { output: Output::Code(code), motor_side: 0 }
    }
}

/// Motor channel, stepped once each control period: [`Motor::sense`], then [`Motor::step`].
pub struct Motor {
    control: ControlConfig,
    limits: OutputLimits,
    period_s: f32,
    sensor: Sensor,
    /// Model of the motor; `None` where the configuration has too few parameters for it.
    model: Option<Model>,
    motor_side: Option<MotorSide>,
    /// Force control; `None` without a force sensor.
    force: Option<Force>,
    position_loop: Pid,
    speed_loop: Pid,
    profile: Profile,
    setpoint: Setpoint,
    /// Position set point, rad or m.
    target: f32,
    following: Following,
    /// Landing of a motor with a model at a position.
    landing: Landing,
    /// Path being followed, also while the motor pauses on it; `None` without one.
    path: Option<Follower>,
    /// Position, rad or m; 64 bits so that a wheel may turn for days without losing counts.
    position: f64,
    position_counts: i32,
    /// Offset added to an encoder's counts since its zero was found.
    zero_counts: i32,
    homed: bool,
    /// Index pulses of the encoder, if it has them, and the position at a pulse since the last step, counts.
    index: Option<Index>,
    index_at: Option<i32>,
    /// State of the home switch, true for closed; `None` without one or while unknown.
    switch_closed: Option<bool>,
    speed: f32,
    /// Filtered rate of change of the speed, for the derivative of the speed loop.
    acceleration: LowPass,
    acceleration_now: f32,
    /// End of the range at which the motor stands: 1, -1, or 0 for none.
    at_end: f32,
    /// Duty requested by the loops, and duty that the bridge applies.
    duty: f32,
    applied: f32,
    /// Last duty passed to the bridge, as a share of the actual supply.
    output: f32,
    /// Supply voltage over its nominal value, and the inverse: the loops' duties are shares of the nominal supply.
    supply_share: f32,
    supply_gain: f32,
    watch: Watch,
}

/// State of the present mode.
#[derive(Clone, Copy)]
enum Following {
    /// Open-loop duty, without state.
    Duty,
    /// Speed mode: state of the ramp to the set point, and of the hold at speed 0.
    Speed { reference: Ramp, hold: Option<Hold> },
    /// Position mode: state of the approach.
    Position(Approach),
    /// Path mode: reference at the present time.
    Path(Reference),
    /// Homing: state of the search for the zero.
    Home(Homing),
    /// Force mode: reference of the position loop, which the force loop moves.
    Force(Press),
}

/// State of the search for the zero.
#[derive(Clone, Copy)]
struct Homing {
    /// Speed of the search for the switch, rad/s; its sign is the direction.
    speed: f32,
    /// State of the ramp to the search speed.
    reference: Ramp,
    /// True once the switch has been found and is being left again.
    backing_off: bool,
    /// True if the switch has been closed on the way back: a motor that overshoots a short cam finds it open on the far
    /// side, which is no zero.
    seen_again: bool,
    /// True if the next index pulse is the zero.
    awaits_index: bool,
    /// Position at which the search began, rad.
    start: f64,
}

/// State of the approach to a position.
#[derive(Clone, Copy, Default)]
struct Approach {
    /// Distance from the path, rad or m.
    path_error: f32,
    /// True within the band around the target in which the position counts as reached.
    near: bool,
    /// Direction in which friction was last compensated.
    towards: f32,
    at_rest_s: f32,
    /// State of the hold while settled.
    hold: Option<Hold>,
}

/// State of the hold of a settled motor.
#[derive(Clone, Copy)]
struct Hold {
    duty: f32,
    /// Duty and position at which it came to rest.
    at_rest: (f32, f64),
    /// True if it has moved since, so that friction alone does not hold it.
    slipped: bool,
}

/// Time constant with which a settled motor's duty is released, s.
const LET_GO_S: f32 = 1.0;
/// Time constant with which an integral that opposes the motion to the target is released, s.
const UNLOAD_S: f32 = 1.0;
/// Time constant with which the integral of a motor with a model is released along a path, s: that with which its curve
/// is learned.
const LEAK_S: f32 = 0.1;
/// Rate at which the duty of a motor that stands short of its target rises until it moves, 1/s.
const BREAK_AWAY_PER_S: f32 = 0.1;
/// Path error at which the path waits for a motor at the limit of its duty, as a share of the error at which it counts
/// as not following.
const WAIT_SHARE: f32 = 0.25;
/// One count with its rounding, in counts.
const A_COUNT: f32 = 1.0005;
/// Share of a limit that counts as the limit, for rounding.
const AT_LIMIT: f32 = 0.999;
/// Range of the compensated supply voltage, as shares of the nominal one: a failing sensor must not drive a motor more
/// than twice as hard.
const SUPPLY_SHARES: (f32, f32) = (0.5, 2.0);
/// Share of the search speed at which the switch is left again: its opening is the zero.
const BACK_OFF: f32 = 0.2;
/// Multiple of the whole range after which a search has missed the switch.
const SEARCH_RANGES: f32 = 1.2;
/// Duty below which a motor on a bridge does not respond.
const NO_DUTY: f32 = 0.01;

impl Motor {
    /// Creates a motor at rest, without command.
    ///
    /// # Errors
    /// [`BadPeriod`] unless `period_s` is finite and positive.
    pub fn new(control: ControlConfig, limits: OutputLimits, period_s: f32) -> Result<Self, BadPeriod> {
        let filter_s = control.speed_filter_s;
        Ok(Self {
            model: Model::new(&control, limits.magnitude, period_s),
            supply_share: 1.0,
            supply_gain: 1.0,
            output: 0.0,
            sensor: match control.feedback {
                Feedback::Encoder { inverted, .. } => Sensor::Encoder(Encoder::new(inverted, period_s, filter_s)),
                Feedback::Potentiometer { low, high, .. } => {
                    Sensor::Potentiometer(Potentiometer::new(low, high, period_s, filter_s))
                }
                Feedback::Angle { zero, inverted, .. } | Feedback::Pulses { zero, inverted, .. } => {
                    let range = (control.position.min, control.position.max);
                    let speed_max = control.speed_max;
                    Sensor::Angle(Angle::new(Mounting { zero, inverted, range, speed_max, filter_s }))
                }
            },
            motor_side: control
                .motor_side
                .map(|side| MotorSide::new(side, control.feedback, control.settle.speed, period_s, filter_s)),
            force: control.force.map(|force| Force::new(force, period_s)),
            position_loop: Pid::new(control.position_pid, period_s)?,
            speed_loop: Pid::new(control.speed_pid, period_s)?,
            profile: Profile::new(control.profile, period_s),
            setpoint: Setpoint { mode: Mode::Duty, value: 0.0 },
            target: 0.0,
            following: Following::Duty,
            landing: Landing::default(),
            path: None,
            position: 0.0,
            position_counts: 0,
            zero_counts: 0,
            // A potentiometer always knows its position; an angle sensor does within one turn.
            homed: match control.feedback {
                Feedback::Encoder { .. } => false,
                Feedback::Potentiometer { .. } => true,
                Feedback::Angle { .. } | Feedback::Pulses { .. } => {
                    control.position.max - control.position.min <= core::f32::consts::TAU
                }
            },
            index: match control.feedback {
                Feedback::Encoder { counts_per_index, .. } => Index::new(counts_per_index),
                _ => None,
            },
            index_at: None,
            switch_closed: None,
            speed: 0.0,
            acceleration: LowPass::new(filter_s, period_s),
            acceleration_now: 0.0,
            at_end: 0.0,
            duty: 0.0,
            applied: 0.0,
            watch: Watch::default(),
            period_s,
            limits,
            control,
        })
    }

    /// Takes the sensor values of this period and the state of the home switch (true for closed), where there is one.
    ///
    /// Returns [`Cause::EncoderImplausible`] when a sensor cannot be at its reported position, or reports none.
    pub fn sense(&mut self, raw: impl Into<Raw>, switch_closed: Option<bool>) -> Causes {
        self.sense_raw(raw.into(), switch_closed)
    }

    // A function of its own: inlined into a loop over motors it would make that carry a pointer to each field.
    #[inline(never)]
    fn sense_raw(&mut self, raw: Raw, switch_closed: Option<bool>) -> Causes {
        self.switch_closed = switch_closed;
        let resolution = resolution(self.control.feedback);
        let last_speed = self.speed;
        let duty = self.applied / self.supply_gain;
        let mut causes = match (&mut self.sensor, raw.output) {
            (Sensor::Encoder(encoder), Output::Code(raw)) => {
                let (counts, counts_per_s) = encoder.update(raw);
                self.position_counts = counts.wrapping_add(self.zero_counts);
                self.position = f64::from(self.position_counts) * f64::from(resolution);
                self.speed = match &mut self.model {
                    Some(model) if self.motor_side.is_none() => model.count(encoder, duty, resolution),
                    _ => counts_per_s * resolution,
                };
                Causes::NONE
            }
            (Sensor::Potentiometer(pot), Output::Code(raw)) => match pot.update(raw) {
                Ok((position_m, speed_m_s)) => {
                    self.position = position_m.into();
                    self.position_counts = (position_m / resolution) as i32;
                    self.speed = match &mut self.model {
                        Some(model) => model.measure(position_m, duty),
                        None => speed_m_s,
                    };
                    Causes::NONE
                }
                Err(_) => {
                    if let Some(model) = &mut self.model {
                        model.lose();
                    }
                    Causes::only(Cause::EncoderImplausible)
                }
            },
            (Sensor::Angle(angle), Output::Angle(newest, now)) => match angle.update(newest, now) {
                Some((counts, counts_per_s)) => {
                    let counts = counts + f64::from(self.zero_counts);
                    self.position_counts = libm::round(counts) as i32;
                    self.position = counts * f64::from(resolution);
                    self.speed = counts_per_s * resolution;
                    Causes::NONE
                }
                None => {
                    // The number of turns until the sensor is found again is unknown.
                    self.homed &= angle.is_absolute();
                    Causes::only(Cause::EncoderImplausible)
                }
            },
            // The values' kinds always match: their reader uses the same configuration.
            _ => Causes::only(Cause::EncoderImplausible),
        };
        if let Some(side) = &mut self.motor_side {
            let play = side.update(raw.motor_side, causes.is_empty().then_some(self.position));
            self.speed = match &mut self.model {
                Some(model) => model.count(side.encoder(), duty, side.resolution()),
                None => side.speed(),
            };
            causes.set(Cause::EncoderImplausible, causes.contains(Cause::EncoderImplausible) || play.is_err());
        }
        self.acceleration_now = self.acceleration.step((self.speed - last_speed) / self.period_s);
        causes
    }

    /// Takes the counter at an index pulse since the last period, after [`Motor::sense`].
    ///
    /// Returns [`Cause::EncoderImplausible`] when counts were lost since the previous pulse; the motor is then no
    /// longer homed.
    // Called once a turn, so it may stay in flash.
    #[inline(never)]
    pub fn sense_index(&mut self, raw: u16) -> Causes {
        let (Sensor::Encoder(encoder), Some(index)) = (&self.sensor, &mut self.index) else { return Causes::NONE };
        let at = encoder.position_at(raw);
        self.index_at = Some(at.wrapping_add(self.zero_counts));
        if !index.update(at, self.speed / resolution(self.control.feedback)) {
            return Causes::NONE;
        }
        self.homed = false;
        Causes::only(Cause::EncoderImplausible)
    }

    /// Returns true if an index pulse is the zero and no switch has to be found before.
    fn homes_by_index(&self) -> bool {
        let Feedback::Encoder { index, counts_per_index: 1.., .. } = self.control.feedback else { return false };
        self.control.homing.is_some_and(|homing| homing.switch == index)
    }

    /// Takes a command, which dispatch has checked.
    // Not called each period, so it may stay in flash.
    #[inline(never)]
    pub fn command(&mut self, setpoint: Setpoint) {
        if setpoint.mode == Mode::Follow {
            // From here on the path's points command it: see `follow`.
            self.begin_path();
            return;
        }
        self.path = None;
        let last = core::mem::replace(&mut self.setpoint, setpoint);
        let repeated = setpoint == last;
        if !repeated {
            self.landing = Landing::default();
        }
        let shift = setpoint.value - self.target;
        if setpoint.mode == Mode::Position {
            self.target = setpoint.value;
        }
        self.following = match (self.following, setpoint.mode) {
            // A host that repeats its set point must not disturb a motor that rests there, or a search under way.
            (Following::Position(approach), Mode::Position) if repeated => Following::Position(approach),
            (Following::Home(homing), Mode::Home) if repeated => Following::Home(homing),
            (Following::Position(Approach { towards, .. }), Mode::Position) => {
                self.profile.shift_target(shift);
                Following::Position(Approach { towards, ..Approach::default() })
            }
            (Following::Path(reference), Mode::Position) => {
                self.profile.join(self.distance_from(reference.position), self.motion());
                Following::Position(Approach::default())
            }
            (_, Mode::Position) => {
                let duty = self.duty;
                self.position_holder().reset(duty);
                self.profile.join(self.distance(), self.motion());
                Following::Position(Approach::default())
            }
            (Following::Speed { reference, hold }, Mode::Speed) => Following::Speed { reference, hold },
            (_, Mode::Speed) => {
                self.speed_loop.reset(self.duty);
                Following::Speed { reference: self.motion(), hold: None }
            }
            // A new force does not make the motor release the object.
            (Following::Force(press), Mode::Force) => Following::Force(Press { at_force_s: 0.0, ..press }),
            (_, Mode::Force) => {
                let duty = self.duty;
                self.position_holder().reset(duty);
                Following::Force(Press { position: self.position, speed: self.speed, at_force_s: 0.0 })
            }
            (_, Mode::Home) => {
                self.speed_loop.reset(self.duty);
                self.homed = false;
                self.index_at = None;
                let start = self.position;
                Following::Home(Homing {
                    speed: setpoint.value,
                    reference: self.motion(),
                    backing_off: false,
                    seen_again: false,
                    awaits_index: self.homes_by_index(),
                    start,
                })
            }
            // Dispatch rejects the switch mode for motors; a path was begun above.
            (_, Mode::Duty | Mode::Switch | Mode::Voltage | Mode::Brake | Mode::Follow) => Following::Duty,
        };
    }

    /// Commanded speed and acceleration at present; in open loop the actual speed.
    fn motion(&self) -> Ramp {
        match self.following {
            Following::Position(_) => {
                let Moment { speed, acceleration, .. } = self.profile.now();
                Ramp { speed, acceleration }
            }
            Following::Path(Reference { speed, acceleration, .. }) => Ramp { speed, acceleration },
            Following::Speed { reference, .. } | Following::Home(Homing { reference, .. }) => reference,
            Following::Force(Press { speed, .. }) => Ramp { speed, acceleration: 0.0 },
            Following::Duty => Ramp { speed: self.speed, acceleration: 0.0 },
        }
    }

    /// Begins to follow a path from the motor's present reference, or from its position.
    fn begin_path(&mut self) {
        if self.path.is_some() {
            return;
        }
        let (position, speed) = match self.following {
            Following::Position(_) => {
                let Moment { to_go, speed, .. } = self.profile.now();
                (f64::from(self.target) - f64::from(to_go), speed)
            }
            _ => {
                let duty = self.duty;
                self.position_holder().reset(duty);
                (self.position, self.speed)
            }
        };
        self.path = Some(Follower::new(position, speed));
        if !matches!(self.following, Following::Position(_)) {
            self.following = Following::Path(Reference { position, speed, ..Reference::default() });
        }
    }

    /// Returns true if the motor follows a path: [`Motor::follow`] must then precede [`Motor::step`].
    pub(super) fn follows(&self) -> bool {
        self.path.is_some()
    }

    /// Takes the path's segment at `now_us`.
    pub(super) fn follow(&mut self, leg: Leg, now_us: u64) {
        let Some(path) = &mut self.path else { return };
        let reference = match path.step(leg, now_us) {
            Ok(reference) => reference,
            Err(end) => {
                self.end_path(end);
                return;
            }
        };
        let pause = path.pauses(self.control.settle.error);
        self.setpoint = Setpoint { mode: Mode::Follow, value: reference.position as f32 };
        match (self.following, pause) {
            // A pause is held like any other position.
            (Following::Position(_), Some(_)) => {}
            (_, Some(target)) => self.come_to_rest(target, reference),
            _ => self.following = Following::Path(reference),
        }
    }

    /// Ends a path without further points: continues along the profile to rest.
    #[inline(never)]
    fn end_path(&mut self, end: Reference) {
        // A path that brakes until its last point must not continue to brake: with a deceleration above this, limited
        // jerk would reverse the motor.
        let most = sqrtf(2.0 * self.control.profile.jerk * end.speed.abs());
        let end = Reference { acceleration: end.acceleration.within(-most, most), ..end };
        let Reference { position, speed, acceleration, .. } = end;
        let stopping = f64::from(self.profile.stopping(Ramp { speed, acceleration }));
        let range = self.control.position;
        let target = ((position + stopping) as f32).within(range.min, range.max);
        self.path = None;
        if !matches!(self.following, Following::Position(_)) {
            self.come_to_rest(target, end);
        }
        self.setpoint = Setpoint { mode: Mode::Position, value: self.target };
    }

    /// Continues to `target` from the path's last reference.
    fn come_to_rest(&mut self, target: f32, reference: Reference) {
        self.target = target;
        self.landing = Landing::default();
        let Reference { position, speed, acceleration, .. } = reference;
        self.profile.join(self.distance_from(position), Ramp { speed, acceleration });
        self.following = Following::Position(Approach::default());
    }

    /// Clears the command and the state of the loops: the outputs are being made safe.
    pub fn stop(&mut self) {
        self.setpoint = Setpoint { mode: Mode::Duty, value: 0.0 };
        self.following = Following::Duty;
        self.path = None;
        self.duty = 0.0;
        self.applied = 0.0;
        self.output = 0.0;
        self.watch = Watch::default();
    }

    /// Sets new gains of one loop, without a jump of the output.
    pub fn set_gains(&mut self, mode: Mode, gains: PidGains) {
        match mode {
            Mode::Position => self.position_loop.set_gains(gains),
            Mode::Speed => self.speed_loop.set_gains(gains),
            Mode::Duty | Mode::Switch | Mode::Voltage | Mode::Brake | Mode::Home | Mode::Follow | Mode::Force => {}
        }
    }

    /// Sets a new feed-forward and a new position loop, which starts from the present duty.
    pub fn set_tuning(&mut self, Tuning { feed_forward, cascade_per_s }: Tuning) {
        let is_other_loop = (cascade_per_s == 0.0) != (self.control.cascade_per_s == 0.0);
        if self.control.feed_forward != feed_forward {
            self.control.feed_forward = feed_forward;
            // The curve was learned relative to the previous parameters.
            self.model = Model::new(&self.control, self.limits.magnitude, self.period_s);
        }
        self.control.cascade_per_s = cascade_per_s;
        if is_other_loop && matches!(self.following, Following::Position(_) | Following::Path(_) | Following::Force(_))
        {
            let held = self.straight(self.duty);
            self.position_holder().hold(held, held);
        }
    }

    /// Advances one period; returns the duty for the bridge and the causes seen in the motor's response.
    pub fn step(&mut self) -> (f32, Causes) {
        // Limits as shares of the nominal supply.
        let OutputLimits { magnitude, slew_per_s } = self.limits;
        let limits =
            OutputLimits { magnitude: magnitude * self.supply_share, slew_per_s: slew_per_s * self.supply_share };
        let mut causes = Causes::NONE;
        let (wanted, following) = match self.following {
            Following::Position(approach) => self.step_position(approach, limits),
            Following::Path(reference) => self.step_path(reference, limits),
            Following::Speed { reference, hold } => self.step_speed(reference, hold, limits),
            Following::Home(homing) => {
                let (duty, following, missed) = self.step_home(homing, limits);
                causes.set(Cause::EncoderImplausible, missed);
                (duty, following)
            }
            Following::Force(press) => self.step_force(press, limits),
            Following::Duty => {
                let step = limits.slew_per_s * self.period_s;
                let wanted = self.setpoint.value / self.supply_gain;
                let duty = wanted.within(self.duty - step, self.duty + step);
                (duty.within(-limits.magnitude, limits.magnitude), Following::Duty)
            }
        };
        self.duty = wanted;
        self.following = following;
        self.at_end = self.end_of_range();
        if wanted * self.at_end > 0.0 {
            self.duty = 0.0;
            self.position_loop.reset(0.0);
            self.speed_loop.reset(0.0);
            match &mut self.following {
                Following::Speed { reference, hold } => (*reference, *hold) = (Ramp::default(), None),
                Following::Position(approach) => approach.hold = None,
                Following::Force(press) => press.speed = 0.0,
                Following::Duty | Following::Path(_) | Following::Home(_) => {}
            }
        }
        let (path_error, wants_motion) = match self.following {
            Following::Position(approach) => (approach.path_error, !approach.near),
            Following::Path(reference) => {
                let error = self.path_error(reference);
                (error, reference.speed != 0.0 || error.abs() > self.control.settle.error)
            }
            Following::Speed { reference, hold } => (0.0, reference.speed != 0.0 && hold.is_none()),
            Following::Home(_) => (0.0, true),
            // In contact the force shows that the motor is driven, and the object keeps it from moving.
            Following::Force(press) => {
                let is_free = self.force.as_ref().is_none_or(|force| !force.in_contact());
                (0.0, is_free && press.speed != 0.0)
            }
            Following::Duty => (0.0, false),
        };
        // A change of the supply must not change the duty faster than the slew limit.
        let step = self.limits.slew_per_s * self.period_s;
        let most = self.limits.magnitude;
        let duty = (self.duty * self.supply_gain).within(self.output - step, self.output + step).within(-most, most);
        self.output = if wanted * self.at_end > 0.0 { 0.0 } else { duty };
        let duty = self.output;
        let friction = self.friction() * self.supply_gain;
        let seen = Seen { duty, position: self.position, path_error, wants_motion, friction };
        let watched = self.watch.step(seen, resolution(self.control.feedback), self.period_s, &self.control);
        (duty, causes.union(watched))
    }

    /// Takes the voltage of the motor's supply as a share of the nominal one, for which the loops are tuned.
    pub(super) fn set_supply(&mut self, share: f32) {
        self.supply_share = share.within(SUPPLY_SHARES.0, SUPPLY_SHARES.1);
        self.supply_gain = 1.0 / self.supply_share;
    }

    /// Takes the duty that the bridge made of the last one: 0 while it rests between directions.
    pub fn set_applied(&mut self, duty: f32) {
        self.applied = duty;
    }

    /// Returns the duty that the bridge applies and the speed, rad/s or m/s.
    pub(super) fn applied(&self) -> (f32, f32) {
        (self.applied, self.speed)
    }

    fn step_position(&mut self, last: Approach, limits: OutputLimits) -> (f32, Following) {
        let distance = self.distance();
        let before = self.profile.now();
        // The path waits for a motor at its limits: it still travels the whole path, only later.
        let waits = self.model.is_some()
            && before.speed * last.path_error > 0.0
            && last.path_error.abs() > WAIT_SHARE * self.control.follow.error
            && self.duty.abs() >= AT_LIMIT * limits.magnitude
            && self.duty * before.speed > 0.0;
        let moment = if waits { Moment { acceleration: 0.0, ..before } } else { self.profile.step() };
        let Moment { to_go, speed: path_speed, acceleration: path_acceleration } = moment;
        let near = to_go == 0.0 && distance.abs() <= self.band(last.near);
        if self.is_settled() && !near {
            // The motor was pushed away; it returns along a path like any other.
            self.profile.start(distance, self.speed);
        }
        let at_rest = near && self.speed.abs() <= self.control.settle.speed;
        let at_rest_s = if at_rest { last.at_rest_s + self.period_s } else { 0.0 };
        let path_error = distance - to_go;
        // While the path moves, friction is compensated in its direction; afterwards towards the target. Within the
        // band this stays unchanged: without it a load would fall.
        let towards = match (path_speed != 0.0, near) {
            (true, _) => path_speed.signum(),
            (false, false) => distance.signum(),
            // A known load is held without friction compensation, and a motor that still moves is braked.
            (false, true) if self.model.is_some() => {
                if at_rest {
                    0.0
                } else {
                    self.speed.signum()
                }
            }
            (false, true) => last.towards,
        };
        let approach = Approach { path_error, near, towards, at_rest_s, hold: None };
        if self.rests_long_enough(at_rest_s) {
            let hold = self.let_go(last.hold.unwrap_or(self.new_hold()));
            // The share that overcame friction is added again by the feed-forward when the motor moves on, in either
            // direction; the rest is what the load takes.
            let friction = self.feed_forward(towards, 0.0, 0.0);
            let overcame =
                if hold.duty * friction > 0.0 { friction.abs().min(hold.duty.abs()).copysign(friction) } else { 0.0 };
            let held = self.straight(hold.duty);
            self.position_holder().hold(held, held - overcame);
            return (hold.duty, Following::Position(Approach { hold: Some(hold), ..approach }));
        }
        if path_speed == 0.0 && !self.crosses_gap() {
            // The integral that moved the motor along its path opposes the return from beyond the target.
            let share = self.period_s / UNLOAD_S;
            self.position_holder().unload_against(distance, share);
            let least = self.least_motion();
            if let Some(model) = &mut self.model {
                self.landing.step(self.position, distance, near, least, self.period_s, model);
            } else if !near && self.speed.abs() <= self.control.settle.speed {
                // Standing short of its target: the integral of a small error would take long to overcome friction.
                let push = (BREAK_AWAY_PER_S * self.period_s).copysign(distance);
                self.position_holder().push(push, limits);
            }
        } else if self.model.is_some() {
            self.landing.begin(self.position);
        }
        let duty = self.feed_forward(towards, path_speed, path_acceleration);
        let aim = if path_speed == 0.0 { self.landing.aim(towards, near) } else { Aim::along(towards) };
        (self.hold_to_path(path_error, path_speed, aim, duty, limits), Following::Position(approach))
    }

    /// Distance from the target within which it counts as reached; `near` if it already was.
    fn band(&self, near: bool) -> f32 {
        let error = self.control.settle.error;
        match self.control.feedback {
            // The learned curve brings a motor back without hunting, and a count has no noise; but a motor can always
            // be one count off.
            Feedback::Encoder { .. } if self.model.is_some() => error.max(A_COUNT * resolution(self.control.feedback)),
            _ if !near => error,
            // Left only at twice the error that enters it: noise at the edge must not restart the motor.
            _ => 2.0 * error,
        }
    }

    /// Returns the duty of the loop that holds positions, `error` away from a path of `path_speed`.
    fn hold_to_path(&mut self, error: f32, path_speed: f32, aim: Aim, feed_forward: f32, limits: OutputLimits) -> f32 {
        let bounds = self.loop_limits(limits, aim.sign);
        if self.model.is_some() && path_speed != 0.0 {
            // The duty of the path is learned; an integral built up on the way would overshoot at its end.
            let share = self.period_s / LEAK_S;
            self.position_holder().leak(share);
        }
        // Relative to the path: the path's own motion is not damped.
        let rate = self.speed - path_speed;
        let output = if self.control.cascade_per_s == 0.0 {
            let integral = self.position_loop.integral();
            let output = self.position_loop.step(error, rate, feed_forward, bounds);
            if self.crosses_gap() {
                self.position_loop.set_integral(integral);
            }
            output
        } else {
            let fastest = self.control.speed_max;
            let wanted = (path_speed + self.control.cascade_per_s * error).within(-fastest, fastest);
            self.speed_loop.step(wanted - self.speed, self.acceleration_now, feed_forward, bounds)
        };
        self.driven(output, aim, limits)
    }

    /// Limits of a loop's output that correspond to those of the duty.
    fn loop_limits(&self, limits: OutputLimits, towards: f32) -> OutputLimits {
        self.model.as_ref().map_or(limits, |model| model.limits(limits, towards))
    }

    /// Returns the motor's duty for a loop's output, within slew and magnitude limits.
    fn driven(&self, output: f32, aim: Aim, limits: OutputLimits) -> f32 {
        let Some(model) = &self.model else { return output };
        let step = limits.slew_per_s * self.period_s;
        let duty = model.drive(output, aim).within(self.duty - step, self.duty + step);
        duty.within(-limits.magnitude, limits.magnitude)
    }

    /// Loop output for a duty at rest.
    fn straight(&self, duty: f32) -> f32 {
        self.model.as_ref().map_or(duty, |model| model.straight(duty))
    }

    /// Returns true while the motor crosses the backlash and the output stands: the error then does not last.
    fn crosses_gap(&self) -> bool {
        self.motor_side.as_ref().is_some_and(MotorSide::crosses)
    }

    /// Loop that holds positions.
    fn position_holder(&mut self) -> &mut Pid {
        if self.control.cascade_per_s == 0.0 { &mut self.position_loop } else { &mut self.speed_loop }
    }

    /// Advances the force loop by one period. Without a reliable force the motor holds its position:
    /// [`Motor::sense_force`] trips.
    // Few motors use it, so it may stay in flash.
    #[inline(never)]
    fn step_force(&mut self, last: Press, limits: OutputLimits) -> (f32, Following) {
        let press = match &self.force {
            Some(force) => force.step(last, self.setpoint.value, self.position, self.control.profile.acceleration),
            None => Press { speed: 0.0, ..last },
        };
        let range = self.control.position;
        let press = Press { position: press.position.within(range.min.into(), range.max.into()), ..press };
        let towards = if press.speed == 0.0 { 0.0 } else { press.speed.signum() };
        let duty = self.feed_forward(towards, press.speed, 0.0);
        let error = (press.position - self.position) as f32;
        (self.hold_to_path(error, press.speed, Aim::along(towards), duty, limits), Following::Force(press))
    }

    /// Takes the force of this period, N; `None` while unknown. Has no effect on a motor without force control.
    ///
    /// Returns [`Cause::ForceLimit`] beyond the limit, in every mode, and [`Cause::EncoderImplausible`] when a motor in
    /// force mode has lost its sensor.
    #[inline(never)]
    pub fn sense_force(&mut self, newtons: Option<f32>) -> Causes {
        let Some(force) = &mut self.force else { return Causes::NONE };
        force.measure(newtons);
        let mut causes = Causes::NONE;
        causes.set(Cause::ForceLimit, force.is_beyond_limit());
        causes.set(Cause::EncoderImplausible, force.is_lost() && matches!(self.following, Following::Force(_)));
        causes
    }

    fn step_path(&mut self, reference: Reference, limits: OutputLimits) -> (f32, Following) {
        let Reference { speed, acceleration, feed_forward, .. } = reference;
        let towards = if speed == 0.0 { 0.0 } else { speed.signum() };
        let duty = self.feed_forward(towards, speed, acceleration) + feed_forward;
        let error = self.path_error(reference);
        (self.hold_to_path(error, speed, Aim::along(towards), duty, limits), Following::Path(reference))
    }

    /// Distance from the measured position to the path's present reference, rad or m.
    fn path_error(&self, reference: Reference) -> f32 {
        (reference.position - self.position) as f32
    }

    /// Hold of a motor that has just come to rest.
    fn new_hold(&self) -> Hold {
        Hold { duty: self.duty, at_rest: (self.duty, self.position), slipped: false }
    }

    /// Releases the duty of a settled motor slowly: a loop that kept integrating over stiction would hunt, and one that
    /// released at once would drop a load. If the motor slips, the duty at which it came to rest is restored and kept.
    fn let_go(&self, mut hold: Hold) -> Hold {
        let (duty_at_rest, position_at_rest) = hold.at_rest;
        // Slip counts against the duty only: a motor that still creeps along with it is released all the more.
        let slip = (position_at_rest - self.position) as f32 * duty_at_rest.signum();
        // A duty within friction holds no load.
        let holds = duty_at_rest.abs() > self.friction();
        hold.slipped |= holds && slip > self.control.settle.error / 2.0;
        if hold.slipped {
            let step = self.limits.slew_per_s * self.period_s;
            hold.duty = duty_at_rest.within(hold.duty - step, hold.duty + step);
        } else {
            hold.duty -= hold.duty * self.period_s / LET_GO_S;
            if hold.duty.abs() < NO_DUTY {
                hold.duty = 0.0;
            }
        }
        hold
    }

    fn step_speed(&mut self, mut ramp: Ramp, hold: Option<Hold>, limits: OutputLimits) -> (f32, Following) {
        // Slow enough to stop before the end of the range.
        let range = self.control.position;
        let rooms = [self.position - f64::from(range.min), f64::from(range.max) - self.position];
        let rooms = rooms.map(|room| room as f32);
        let wanted = ramp.step(self.setpoint.value, rooms, &self.control.profile, self.period_s);
        let Ramp { speed: reference, acceleration } = ramp;
        // Standing still takes no more duty than the load does: the rest would only heat the motor.
        let stands = self.speed.abs() <= self.control.settle.speed;
        // After one slip the load is left to the loop, which starts from the duty that held it.
        let slipped = hold.filter(|hold| hold.slipped && wanted == 0.0);
        if wanted == 0.0 && reference == 0.0 && stands && slipped.is_none() {
            let hold = self.let_go(hold.unwrap_or(self.new_hold()));
            let duty = if hold.slipped { hold.at_rest.0 } else { hold.duty };
            let (before, held) = (self.straight(self.duty), self.straight(duty));
            self.speed_loop.hold(before, held);
            return (hold.duty, Following::Speed { reference: ramp, hold: Some(hold) });
        }
        let following = Following::Speed { reference: ramp, hold: slipped };
        let towards = if reference == 0.0 { 0.0 } else { reference.signum() };
        let path_duty = self.feed_forward(towards, reference, acceleration);
        let bounds = self.loop_limits(limits, towards);
        let output = self.speed_loop.step(reference - self.speed, self.acceleration_now, path_duty, bounds);
        (self.driven(output, Aim::along(towards), limits), following)
    }

    /// Seeks the switch, leaves it again slowly, and takes its opening, or the next index pulse, as the known place.
    /// The flag is true if the search has gone too far.
    fn step_home(&mut self, mut homing: Homing, limits: OutputLimits) -> (f32, Following, bool) {
        let goes_back = homing.reference.speed * homing.speed < 0.0 && self.speed * homing.speed <= 0.0;
        if let (Some(at), true) = (self.index_at.take(), homing.awaits_index) {
            return self.find_zero(at, homing);
        }
        match (homing.backing_off, self.switch_closed) {
            _ if homing.awaits_index => {}
            (false, Some(true)) => homing.backing_off = true,
            (true, Some(true)) => homing.seen_again |= goes_back,
            (true, Some(false)) if homing.seen_again && self.index.is_some() => homing.awaits_index = true,
            (true, Some(false)) if homing.seen_again => return self.find_zero(self.position_counts, homing),
            _ => {}
        }
        let wanted = if homing.backing_off { -BACK_OFF * homing.speed } else { homing.speed };
        // The ends of the range are not known yet.
        homing.reference.step(wanted, [f32::INFINITY; 2], &self.control.profile, self.period_s);
        let Ramp { speed: reference, acceleration } = homing.reference;
        let path_duty = self.feed_forward(reference.signum(), reference, acceleration);
        let error = reference - self.speed;
        let bounds = self.loop_limits(limits, reference);
        let output = self.speed_loop.step(error, self.acceleration_now, path_duty, bounds);
        let duty = self.driven(output, Aim::along(reference), limits);
        let range = self.control.position.max - self.control.position.min;
        let missed = (self.position - homing.start).abs() as f32 > SEARCH_RANGES * range;
        (duty, Following::Home(homing), missed)
    }

    /// Ends the search: the place with the present count `at` is the known one.
    #[inline(never)]
    fn find_zero(&mut self, at: i32, homing: Homing) -> (f32, Following, bool) {
        self.set_zero(at);
        self.landing = Landing::default();
        let duty = self.duty;
        self.position_holder().reset(duty);
        self.profile.join(self.distance(), homing.reference);
        (self.duty, Following::Position(Approach::default()), false)
    }

    /// Sets the zero: the place with the present count `at` is the known one, and the position to rest at.
    fn set_zero(&mut self, at: i32) {
        let Some(homing) = self.control.homing else { return };
        let resolution = resolution(self.control.feedback);
        let shift = (libm::roundf(homing.position / resolution) as i32).wrapping_sub(at);
        if let Some(side) = &mut self.motor_side {
            side.shift(f64::from(shift) * f64::from(resolution));
        }
        self.zero_counts = self.zero_counts.wrapping_add(shift);
        self.position_counts = self.position_counts.wrapping_add(shift);
        self.position = f64::from(self.position_counts) * f64::from(resolution);
        self.target = homing.position;
        self.homed = true;
        self.watch = Watch::default();
    }

    fn feed_forward(&self, towards: f32, speed: f32, acceleration: f32) -> f32 {
        if let Some(model) = &self.model {
            return model.feed_forward(speed, acceleration);
        }
        let FeedForward { static_duty, duty_per_speed, duty_per_acceleration } = self.control.feed_forward;
        static_duty * towards + duty_per_speed * speed + duty_per_acceleration * acceleration
    }

    /// Least displacement that counts as motion, rad or m: a count, or more than the noise of a potentiometer.
    fn least_motion(&self) -> f32 {
        match self.control.feedback {
            Feedback::Encoder { .. } => 0.5 * resolution(self.control.feedback),
            _ => 0.5 * self.control.settle.error,
        }
    }

    /// Duty that friction takes.
    fn friction(&self) -> f32 {
        let configured = self.control.feed_forward.static_duty;
        self.model.as_ref().map_or(configured, |model| model.threshold().max(configured))
    }

    /// Distance from the measured position to the target, rad or m.
    fn distance(&self) -> f32 {
        self.distance_from(self.position)
    }

    fn distance_from(&self, position: f64) -> f32 {
        (f64::from(self.target) - position) as f32
    }

    /// End of the range at which the motor stands. A position at the very end may be held from both sides; in other
    /// modes the motor has left an end only by more than its sensor's noise, or the noise would drive it there again
    /// and again.
    fn end_of_range(&self) -> f32 {
        let range = self.control.position;
        let error = self.control.settle.error;
        let room = |end: f32| match self.following {
            Following::Position(_) | Following::Path(_) | Following::Force(_) => -error,
            Following::Speed { .. } | Following::Duty if self.at_end == end => error,
            Following::Speed { .. } | Following::Duty | Following::Home(_) => 0.0,
        };
        if let Following::Home(_) = self.following {
            // The search does not know the ends yet.
            return 0.0;
        }
        if self.position >= f64::from(range.max - room(1.0)) {
            1.0
        } else if self.position <= f64::from(range.min + room(-1.0)) {
            -1.0
        } else {
            0.0
        }
    }

    fn is_settled(&self) -> bool {
        match self.following {
            Following::Position(approach) => self.rests_long_enough(approach.at_rest_s),
            Following::Force(press) => self.rests_long_enough(press.at_force_s),
            _ => false,
        }
    }

    fn rests_long_enough(&self, at_rest_s: f32) -> bool {
        at_rest_s * 1e3 >= f32::from(self.control.settle.time_ms)
    }

    /// State of the channel for telemetry.
    #[must_use]
    pub fn status(&self) -> MotorStatus {
        MotorStatus {
            setpoint: self.setpoint,
            position: self.position_counts,
            speed: self.speed,
            duty: self.applied,
            settled: self.is_settled(),
            homed: self.homed,
            winding: None,
        }
    }
}

#[cfg(test)]
mod tests;
