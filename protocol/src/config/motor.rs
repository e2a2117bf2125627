//! Motors on bridges: wiring, limits, feedback and loops.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::{
    ANALOG_INPUTS, AS5600_COUNTS, ConfigError, ENCODERS, MAX_EXACT, STOP_BRAKE_MAX_MS, STOP_BRAKE_RULE, SWITCHES,
    check, finite, finite_range, force::ForceConfig, not_negative, positive,
};
use crate::channel::{ChannelId, ChannelKind, Range};

/// No configuration may let a bridge exceed this share: an OSMC's high side needs the rest to refresh its bootstrap, and the
/// makers of the DHB forbid more.
pub const DUTY_HARD_MAX: f32 = 0.98;

/// A motor on a bridge.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct MotorConfig {
    /// [`ChannelKind::Osmc`], [`ChannelKind::Actuator`] or [`ChannelKind::Dhb`], with the bridge connector's number.
    pub id: ChannelId,
    /// Which bridge, and its wiring.
    pub bridge: BridgeConfig,
    /// Whether positive duty is reverse current.
    pub inverted: bool,
    /// Highest share of the supply, 0..=[`DUTY_HARD_MAX`].
    pub duty_max: f32,
    /// Fastest change of the duty, 1/s.
    pub duty_slew_per_s: f32,
    /// Feedback and loops; without them the motor takes an open duty only.
    pub control: Option<ControlConfig>,
    /// Supply, winding and thermal limit. Only a motor without feedback may lack it: neither its speed nor its current is
    /// known then, and it has no overload protection.
    pub winding: Option<WindingConfig>,
    /// How long a controlled stop brakes this motor, ms: see [`super::BoardConfig::stop_brake_ms`]. Its duty falls to 0 by
    /// `duty_slew_per_s`; at 0 the bridge shorts the motor. 0 lets it coast.
    pub stop_brake_ms: u16,
}

/// Supply and winding of a motor: what its current is computed from, and how much of it the winding withstands.
///
/// The mean current is `((|duty| - dead_duty) supply sign(duty) - back_emf speed) / resistance`, with speed 0 where nothing
/// measures it. The heat, as a share of what the winding withstands, follows `(current / rated)²` by a first-order lag of
/// `thermal_s`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct WindingConfig {
    /// Number of the supply channel that feeds the bridge; `None` where none is measured.
    pub supply: Option<u8>,
    /// Supply voltage that the gains were tuned at, V; stands for the measured one where there is none.
    pub nominal_v: f32,
    /// Duty below which no current flows: a bridge's dead zone.
    pub dead_duty: f32,
    /// Of the winding and the bridge, ohm.
    pub resistance_ohm: f32,
    /// Back-EMF constant at the output, V s/rad or V s/m.
    pub back_emf: f32,
    /// Current that the motor withstands continuously, A.
    pub rated_a: f32,
    /// Thermal time constant of the winding, s.
    pub thermal_s: f32,
    /// What measures the motor's current; `None` where it is computed.
    pub current_sense: Option<CurrentSense>,
}

/// A current sensor on an analog input. Only the magnitude of its current is used.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct CurrentSense {
    /// Number of the analog channel.
    pub analog: u8,
    /// Its voltage at 0 A, V.
    pub zero_v: f32,
    /// V/A
    pub volts_per_a: f32,
}

/// A bridge and which outputs of its PWM chip drive it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum BridgeConfig {
    /// OSMC, on [`super::BoardConfig::osmc_pwm`].
    Osmc(BridgeLines),
    /// One motor of a DHB-12, on [`super::BoardConfig::dhb_pwm`].
    Dhb(DhbLines),
}

/// Which outputs of the PWM chip drive which input of an OSMC.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct BridgeLines {
    /// High side of leg A.
    pub ahi: u8,
    /// Low side of leg A.
    pub ali: u8,
    /// High side of leg B.
    pub bhi: u8,
    /// Low side of leg B.
    pub bli: u8,
}

impl BridgeLines {
    /// The four lines, in the order of the fields.
    #[must_use]
    pub const fn all(self) -> [u8; 4] {
        [self.ahi, self.ali, self.bhi, self.bli]
    }

    /// The lowest of the four.
    #[must_use]
    pub fn first(self) -> u8 {
        lowest(&self.all())
    }
}

/// Which outputs of the PWM chip drive which input of one motor of a DHB-12.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct DhbLines {
    /// PWM forwards.
    pub in1: u8,
    /// PWM backwards.
    pub in2: u8,
    /// Enable.
    pub en: u8,
}

impl DhbLines {
    /// The three lines, in the order of the fields.
    #[must_use]
    pub const fn all(self) -> [u8; 3] {
        [self.in1, self.in2, self.en]
    }

    /// The lowest of the three.
    #[must_use]
    pub fn first(self) -> u8 {
        lowest(&self.all())
    }
}

fn lowest(lines: &[u8]) -> u8 {
    lines.iter().copied().min().unwrap_or(0)
}

/// What a motor's loops need to know.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ControlConfig {
    /// What measures the position.
    pub feedback: Feedback,
    /// Positions it may be sent to, rad or m.
    pub position: Range,
    /// Highest speed it may be asked for, rad/s or m/s.
    pub speed_max: f32,
    /// Position loop; its output is a duty.
    pub position_pid: PidGains,
    /// Speed loop; its output is a duty.
    pub speed_pid: PidGains,
    /// Above 0, positions and paths are held by the speed loop: its speed is that of the path and so much for each rad or m of
    /// distance from it, 1/s. At 0 they are held by the position loop.
    pub cascade_per_s: f32,
    /// Time constant of the low-pass on the measured speed, s.
    pub speed_filter_s: f32,
    /// Path to a new position.
    pub profile: ProfileLimits,
    /// Feed-forward from the path, added to both loops.
    pub feed_forward: FeedForward,
    /// When a position counts as reached.
    pub settle: SettleConfig,
    /// When a motor counts as stalled.
    pub stall: StallConfig,
    /// When a motor counts as not following its path.
    pub follow: FollowConfig,
    /// How it finds its zero; `None` when it is where power came on, or the feedback is absolute.
    pub homing: Option<HomingConfig>,
    /// A second encoder, on the motor's side of play between the motor and what `feedback` measures.
    pub motor_side: Option<MotorSideConfig>,
    /// Force control; `None` without a force sensor.
    pub force: Option<ForceConfig>,
}

/// An encoder on the motor's side of a gear with play: speed and damping follow it, positions follow [`ControlConfig::feedback`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct MotorSideConfig {
    /// Which counter.
    pub index: u8,
    /// Its counts in one turn of the output shaft, gear included.
    pub counts_per_turn: u32,
    /// Whether positive duty counts down.
    pub inverted: bool,
    /// Most that the two sides may be apart from where they are nearest, rad: the play, what the gear twists, and room. Beyond it
    /// one of the two sensors is not on the shaft that it is said to be on.
    pub gap_max: f32,
}

/// What measures a motor's position.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum Feedback {
    /// Quadrature counter, four counts to a line.
    Encoder {
        /// Which counter.
        index: u8,
        /// Counts in one turn of the output shaft.
        counts_per_turn: u32,
        /// Whether positive duty counts down.
        inverted: bool,
        /// Counts from one index pulse to the next, where it comes in at the switch input of the same number; 0 without.
        counts_per_index: u32,
    },
    /// Potentiometer on an analog input, calibrated at two points.
    Potentiometer {
        /// Which analog input.
        analog: u8,
        /// First point.
        low: PotPoint,
        /// Second point.
        high: PotPoint,
    },
    /// Absolute angle sensor on the output shaft, one of [`super::BoardConfig::sensors`].
    ///
    /// With a range of positions within one turn the position is known from the first reading on; with a larger one, power-on is
    /// taken to be within half a turn of 0.
    Angle {
        /// Number of its channel.
        angle: u8,
        /// Angle that is position 0, rad, 0 to 2π.
        zero: f32,
        /// Whether positive duty lowers the angle.
        inverted: bool,
    },
    /// The PWM output of an AS5600 on the output shaft, at the echo input of a range sensor's connector. Its angle is absolute as
    /// that of [`Feedback::Angle`].
    Pulses {
        /// Which connector: 0 or 1, whose edges a timer captures.
        range: u8,
        /// Frames a second that the sensor is set to: 115 or 230.
        frames_hz: u16,
        /// Angle that is position 0, rad, 0 to 2π.
        zero: f32,
        /// Whether positive duty lowers the angle.
        inverted: bool,
    },
}

impl Feedback {
    /// Whether it measures an angle, and not a length.
    #[must_use]
    pub const fn turns(self) -> bool {
        !matches!(self, Self::Potentiometer { .. })
    }
}

/// Lowest rate at which an angle sensor serves as a motor's feedback, Hz: four control periods of 1 ms between two readings.
pub const ANGLE_RATE_MIN_HZ: u16 = 250;
/// Readings that may fail before the motor stops.
pub const ANGLE_READINGS_LOST: u16 = 5;

/// One calibration point of a potentiometer.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct PotPoint {
    /// 16-bit converter code.
    pub code: u16,
    /// Position there, m.
    pub position_m: f32,
}

/// Calibration points are no nearer, in 16-bit codes: 1/64 of the converter's range still tells 1/1000 of the stroke.
const POT_SPAN: u16 = 1024;
/// Codes of calibration points, 1/256 of the range away from either rail: room to tell a shorted wiper from an end.
const POT_CODES: core::ops::RangeInclusive<u16> = 256..=u16::MAX - 256;

/// How an axis finds its position: it seeks a switch, backs off it, and takes that place as known.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct HomingConfig {
    /// Number of the switch input.
    pub switch: u8,
    /// Position at which the switch opens again when left slowly, rad.
    pub position: f32,
    /// Highest speed it may be sought at, rad/s.
    pub speed_max: f32,
}

pub(super) const HOMING_RULE: &str =
    "homing needs a switch from 0 to 3, a position in range and a positive speed of at most speed_max";

impl HomingConfig {
    /// Whether it fits an axis with these limits.
    pub(super) fn is_valid(&self, position: Range, speed_max: f32) -> bool {
        usize::from(self.switch) < SWITCHES
            && position.contains(self.position)
            && positive(self.speed_max)
            && self.speed_max <= speed_max
    }
}

/// Gains of a PID loop whose output is a duty. E is the unit of the error (rad, m, rad/s or m/s).
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct PidGains {
    /// duty / E
    pub kp: f32,
    /// duty / (E s)
    pub ki: f32,
    /// duty s / E, on the measurement
    pub kd: f32,
}

impl ControlConfig {
    /// What of it a host may change without a restart, besides gains.
    #[must_use]
    pub fn tuning(&self) -> Tuning {
        Tuning { feed_forward: self.feed_forward, cascade_per_s: self.cascade_per_s }
    }
}

impl PidGains {
    /// No gain is higher: with any error a sensor can have, the loop computes in finite numbers.
    pub const MAX: f32 = 1e6;

    /// Whether every gain is from 0 to [`PidGains::MAX`].
    #[must_use]
    pub fn is_valid(&self) -> bool {
        [self.kp, self.ki, self.kd].into_iter().all(|gain| (0.0..=Self::MAX).contains(&gain))
    }
}

/// Limits of a path.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ProfileLimits {
    /// rad/s or m/s
    pub speed: f32,
    /// rad/s² or m/s²
    pub acceleration: f32,
    /// rad/s³ or m/s³; 0 for trapezoids, whose acceleration jumps.
    pub jerk: f32,
}

/// Feed-forward duty `static_duty sign(v) + duty_per_speed v + duty_per_acceleration a`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct FeedForward {
    /// Duty that just does not move the motor.
    pub static_duty: f32,
    /// duty s / rad, or duty s / m
    pub duty_per_speed: f32,
    /// duty s² / rad, or duty s² / m
    pub duty_per_acceleration: f32,
}

/// What a host may change of a motor's loops besides their gains, without a restart.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Tuning {
    /// Feed-forward from the path.
    pub feed_forward: FeedForward,
    /// As [`ControlConfig::cascade_per_s`].
    pub cascade_per_s: f32,
}

impl FeedForward {
    /// Whether nothing in it is negative or not finite, and `static_duty` stays below `duty_max`.
    #[must_use]
    pub fn is_valid(&self, duty_max: f32) -> bool {
        let Self { static_duty, duty_per_speed, duty_per_acceleration } = *self;
        [static_duty, duty_per_speed, duty_per_acceleration].into_iter().all(not_negative) && static_duty < duty_max
    }
}

impl Tuning {
    /// Whether a motor of this `duty_max` takes it.
    #[must_use]
    pub fn is_valid(&self, duty_max: f32) -> bool {
        self.feed_forward.is_valid(duty_max) && cascade_is_valid(self.cascade_per_s)
    }
}

fn cascade_is_valid(cascade_per_s: f32) -> bool {
    not_negative(cascade_per_s) && cascade_per_s <= CASCADE_MAX_PER_S
}

/// When a position counts as reached: error and speed within these for `time_ms`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct SettleConfig {
    /// rad or m
    pub error: f32,
    /// rad/s or m/s
    pub speed: f32,
    /// ms
    pub time_ms: u16,
}

/// A motor that is further than `error` from its path for `time_ms`, in position mode, does not follow it.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct FollowConfig {
    /// rad or m
    pub error: f32,
    /// ms
    pub time_ms: u16,
}

/// A motor driven with at least `duty` that moves less than `travel` in `time_ms` is stalled.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct StallConfig {
    /// Share of the supply.
    pub duty: f32,
    /// rad or m
    pub travel: f32,
    /// ms
    pub time_ms: u16,
}

impl MotorConfig {
    pub(super) fn validate(&self) -> Result<(), ConfigError> {
        let rule = |holds: bool, rule| check(Some(self.id), holds, rule);
        rule(self.id.index < 4, "bridges are numbered 0 to 3")?;
        rule(positive(self.duty_max) && self.duty_max <= DUTY_HARD_MAX, "duty_max must be above 0 and at most 0.98")?;
        rule(positive(self.duty_slew_per_s), "duty_slew_per_s must be positive")?;
        rule(self.stop_brake_ms <= STOP_BRAKE_MAX_MS, STOP_BRAKE_RULE)?;
        rule(
            self.stop_brake_ms == 0 || f32::from(self.stop_brake_ms) * self.duty_slew_per_s >= 1000.0 * self.duty_max,
            "stop_brake_ms must leave duty_max time to fall to 0 by duty_slew_per_s",
        )?;
        match (self.bridge, self.id.kind) {
            (BridgeConfig::Osmc(lines), ChannelKind::Osmc | ChannelKind::Actuator) => rule(
                lines.all().iter().all(|line| line - lines.first() < 4),
                "a bridge's lines must be four in a row, so that one transfer sets them",
            )?,
            (BridgeConfig::Dhb(lines), ChannelKind::Dhb) => rule(
                lines.all().iter().all(|line| line - lines.first() < 3),
                "a bridge's lines must be three in a row, so that one transfer sets them",
            )?,
            _ => rule(false, "osmc and actuator channels are on OSMC bridges, dhb channels on DHB bridges")?,
        }
        if let Some(winding) = &self.winding {
            winding.validate(self)?;
        }
        let Some(control) = &self.control else {
            return rule(self.id.kind != ChannelKind::Actuator, "an actuator needs a potentiometer");
        };
        match (self.id.kind, control.feedback) {
            (ChannelKind::Osmc, Feedback::Potentiometer { .. }) => {
                rule(false, "an osmc channel has an encoder or an angle sensor")?;
            }
            (ChannelKind::Actuator, Feedback::Encoder { .. } | Feedback::Angle { .. } | Feedback::Pulses { .. }) => {
                rule(false, "an actuator has a potentiometer")?;
            }
            _ => {}
        }
        rule(self.winding.is_some(), "a motor with feedback needs a winding, for its overload protection")?;
        control.validate(self)
    }
}

/// Thermal time constants, s: a small winding has some seconds, a large motor's case an hour.
const THERMAL_S: Range = Range::new(0.1, 36_000.0);

impl WindingConfig {
    fn validate(&self, motor: &MotorConfig) -> Result<(), ConfigError> {
        let rule = |holds: bool, rule| check(Some(motor.id), holds, rule);
        rule(positive(self.nominal_v), "nominal_v must be positive")?;
        rule(
            not_negative(self.dead_duty) && self.dead_duty < motor.duty_max,
            "dead_duty must not be negative, and must stay below duty_max",
        )?;
        rule(positive(self.resistance_ohm), "resistance_ohm must be positive")?;
        rule(not_negative(self.back_emf), "back_emf must not be negative")?;
        rule(positive(self.rated_a), "rated_a must be positive")?;
        rule(THERMAL_S.contains(self.thermal_s), "thermal_s must be 0.1 to 36000")?;
        let Some(CurrentSense { zero_v, volts_per_a, .. }) = self.current_sense else { return Ok(()) };
        rule(
            finite(zero_v) && positive(volts_per_a),
            "a current sensor's zero_v must be finite, and its volts_per_a positive",
        )
    }
}

/// Range connectors whose echo inputs take pulses.
const PULSE_INPUTS: u8 = 2;
/// The encoder that interrupts count; timers count the others.
const INTERRUPT_ENCODER: u8 = 3;
/// Counts in a millisecond that encoder 3 may make at a motor's highest speed. Twice as many are taken for a storm.
pub const ENCODER_3_COUNTS_PER_MS: u32 = 50;

/// An encoder of fewer lines than 4 in a turn has no use for an index pulse, which tells whole lines.
const INDEX_LEAST: u32 = 16;
impl MotorSideConfig {
    fn validate(&self, motor: &MotorConfig, control: &ControlConfig) -> Result<(), ConfigError> {
        let rule = |holds: bool, rule| check(Some(motor.id), holds, rule);
        rule(usize::from(self.index) < ENCODERS, "the motor side's encoder must exist and be used by one motor")?;
        rule((1..=MAX_EXACT).contains(&self.counts_per_turn), "motor_side_counts must be 1 to 16777216")?;
        let counts = |position: f32| position / TURN * self.counts_per_turn as f32;
        rule(
            self.index != INTERRUPT_ENCODER || counts(control.speed_max) * 1e-3 <= ENCODER_3_COUNTS_PER_MS as f32,
            "encoder 3 counts by interrupts, at most 50 counts a ms at speed_max: use encoders 0 to 2",
        )?;
        let Range { min, max } = control.position;
        rule(counts(min).abs() <= 1e9 && counts(max).abs() <= 1e9, "position must be within 1e9 counts of 0")?;
        rule(positive(self.gap_max) && self.gap_max < TURN, "gap_max must be above 0 and below one turn")
    }
}

/// rad
const TURN: f32 = core::f32::consts::TAU;

/// A cascade that is faster than the control loop makes no sense.
const CASCADE_MAX_PER_S: f32 = 1000.0;

impl ControlConfig {
    /// The encoder counters that it takes.
    pub fn encoders(&self) -> impl Iterator<Item = u8> + use<> {
        let output = if let Feedback::Encoder { index, .. } = self.feedback { Some(index) } else { None };
        output.into_iter().chain(self.motor_side.map(|side| side.index))
    }

    fn validate(&self, motor: &MotorConfig) -> Result<(), ConfigError> {
        let rule = |holds: bool, rule| check(Some(motor.id), holds, rule);
        rule(finite_range(self.position), "position must have a finite min below a finite max")?;
        let Range { min, max } = self.position;
        match self.feedback {
            Feedback::Encoder { index, counts_per_turn, counts_per_index, .. } => {
                rule(usize::from(index) < ENCODERS, "the encoder must exist and be used by one motor")?;
                rule((1..=MAX_EXACT).contains(&counts_per_turn), "counts_per_turn must be 1 to 16777216")?;
                rule(
                    counts_per_index == 0 || (INDEX_LEAST..=MAX_EXACT).contains(&counts_per_index),
                    "counts_per_index must be 16 to 16777216, or 0 without an index pulse",
                )?;
                // So that a count is an i32, with room for what an axis may turn beyond its range.
                let counts_per_ms = self.speed_max / core::f32::consts::TAU * counts_per_turn as f32 * 1e-3;
                rule(
                    index != INTERRUPT_ENCODER || counts_per_ms <= ENCODER_3_COUNTS_PER_MS as f32,
                    "encoder 3 counts by interrupts, at most 50 counts a ms at speed_max: use encoders 0 to 2",
                )?;
                let counts = |position: f32| (position / core::f32::consts::TAU * counts_per_turn as f32).abs();
                rule(counts(min) <= 1e9 && counts(max) <= 1e9, "position must be within 1e9 counts of 0")?;
            }
            Feedback::Potentiometer { analog, low, high } => {
                rule(usize::from(analog) < ANALOG_INPUTS, "the analog input must exist and be used once")?;
                rule(
                    low.code.abs_diff(high.code) >= POT_SPAN,
                    "the calibration points need different codes, at least 1024 apart",
                )?;
                rule(
                    [low, high].iter().all(|point| POT_CODES.contains(&point.code)),
                    "the calibration points need codes from 256 to 65279, or a shorted wiper passes for an end",
                )?;
                rule(
                    finite_range(Range::new(low.position_m, high.position_m)),
                    "the low calibration point must be below the high one",
                )?;
                rule(
                    low.position_m <= min && max <= high.position_m,
                    "position must lie between the calibration points, beyond which the sensor counts as broken",
                )?;
                rule(self.homing.is_none(), "a potentiometer needs no homing")?;
            }
            Feedback::Angle { zero, .. } | Feedback::Pulses { zero, .. } => {
                rule(Range::new(0.0, TURN).contains(zero), "the zero angle must be 0 to 6.2831855")?;
                let counts = |position: f32| (position / TURN * f32::from(AS5600_COUNTS)).abs();
                rule(counts(min) <= 1e9 && counts(max) <= 1e9, "position must be within 1e9 counts of 0")?;
                rule(
                    self.homing.is_none() || max - min > TURN,
                    "an angle sensor with a range within one turn needs no homing",
                )?;
                if let Feedback::Pulses { range, frames_hz, .. } = self.feedback {
                    rule(range < PULSE_INPUTS, "pulses need range connector 0 or 1, whose edges a timer captures")?;
                    rule(
                        frames_hz == 115 || frames_hz == 230,
                        "frames_hz must be 115 or 230: shorter pulses are over before they are captured",
                    )?;
                }
            }
        }
        if let Some(side) = &self.motor_side {
            rule(self.feedback.turns(), "motor_side is for motors that turn")?;
            side.validate(motor, self)?;
        }
        rule(positive(self.speed_max), "speed_max must be positive")?;
        rule(self.position_pid.is_valid() && self.speed_pid.is_valid(), "gains must be 0 to 1000000")?;
        rule(cascade_is_valid(self.cascade_per_s), "cascade must be 0 to 1000, in 1/s")?;
        rule(
            not_negative(self.speed_filter_s) && self.speed_filter_s <= 1.0,
            "speed_filter_s must be 0 to 1, or the speed is known too late",
        )?;
        rule(
            positive(self.profile.speed) && positive(self.profile.acceleration) && not_negative(self.profile.jerk),
            "profile speed and acceleration must be positive, jerk not negative",
        )?;
        rule(self.profile.speed <= self.speed_max, "profile speed must be at most speed_max")?;
        rule(
            self.feed_forward.is_valid(motor.duty_max),
            "feed-forward must not be negative, and static_duty must stay below duty_max",
        )?;
        rule(positive(self.settle.error) && positive(self.settle.speed), "settle error and speed must be positive")?;
        rule(
            positive(self.stall.duty) && positive(self.stall.travel) && self.stall.time_ms > 0,
            "stall duty, travel and time must be positive",
        )?;
        rule(self.stall.duty < motor.duty_max, "stall duty must be below duty_max, or a stall is never seen")?;
        rule(positive(self.follow.error) && self.follow.time_ms > 0, "follow error and time must be positive")?;
        rule(self.homing.is_none_or(|homing| homing.is_valid(self.position, self.speed_max)), HOMING_RULE)?;
        self.force.map_or(Ok(()), |force| force.validate(motor.id, self.speed_max))
    }
}
