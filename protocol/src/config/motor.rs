//! Motors on bridges: wiring, limits, feedback and loops.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use super::{
    ANALOG_INPUTS, AS5600_COUNTS, ConfigError, ENCODERS, MAX_EXACT, STOP_BRAKE_MAX_MS, STOP_BRAKE_RULE, SWITCHES,
    check, finite, finite_range, force::ForceConfig, not_negative, positive,
};
use crate::channel::{ChannelId, ChannelKind, Range};

/// Highest share of the supply that a configuration may allow a bridge. An OSMC's high side needs the rest to refresh
/// its bootstrap, and the makers of the DHB forbid more.
pub const DUTY_HARD_MAX: f32 = 0.98;

/// Motor on a bridge, with its limits, feedback and loops.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct MotorConfig {
    /// [`ChannelKind::Osmc`], [`ChannelKind::Actuator`] or [`ChannelKind::Dhb`], with the bridge connector's number.
    pub id: ChannelId,
    /// Bridge of the motor, and its wiring.
    pub bridge: BridgeConfig,
    /// True where positive duty is to be reverse current through the motor.
    pub inverted: bool,
    /// Highest duty, share of the supply, 0..=[`DUTY_HARD_MAX`].
    pub duty_max: f32,
    /// Fastest change of the duty, 1/s.
    pub duty_slew_per_s: f32,
    /// Feedback and loops; without them the motor takes a duty in open loop only.
    pub control: Option<ControlConfig>,
    /// Supply, winding and thermal limit. Only a motor without feedback may lack it: neither its speed nor its current
    /// is known then, and it has no overload protection.
    pub winding: Option<WindingConfig>,
    /// Time for which a controlled stop brakes this motor, ms: see [`super::BoardConfig::stop_brake_ms`]. Its duty
    /// falls to 0 by `duty_slew_per_s`; at 0 the bridge shorts the motor. A time of 0 lets it coast.
    pub stop_brake_ms: u16,
}

/// Supply and winding of a motor: the data of its current and of its thermal limit.
///
/// The mean current is `((|duty| - dead_duty) supply sign(duty) - back_emf speed) / resistance`, with speed 0 where
/// nothing measures it. The heat, as a share of the thermal limit, follows `(current / rated)²` by a first-order lag of
/// `thermal_s`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct WindingConfig {
    /// Number of the supply channel that feeds the bridge; `None` where none is measured.
    pub supply: Option<u8>,
    /// Supply voltage at which the gains were tuned, V; also used where the supply is not measured.
    pub nominal_v: f32,
    /// Duty below which no current flows, a share of the supply: the bridge's dead zone.
    pub dead_duty: f32,
    /// Resistance of winding and bridge, ohm.
    pub resistance_ohm: f32,
    /// Back-EMF constant at the output, V s/rad or V s/m.
    pub back_emf: f32,
    /// Current that the motor withstands continuously, A.
    pub rated_a: f32,
    /// Thermal time constant of the winding, s.
    pub thermal_s: f32,
    /// Sensor of the motor's current; `None` where the current is computed.
    pub current_sense: Option<CurrentSense>,
}

/// Current sensor on an analog input. Only the magnitude of its current is used.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct CurrentSense {
    /// Number of the analog channel.
    pub analog: u8,
    /// Voltage of the sensor at 0 A, V.
    pub zero_v: f32,
    /// Sensitivity of the sensor, V/A.
    pub volts_per_a: f32,
}

/// Bridge, and the outputs of its PWM chip that drive it.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum BridgeConfig {
    /// OSMC bridge, on [`super::BoardConfig::osmc_pwm`].
    Osmc(BridgeLines),
    /// One motor of a DHB-12, on [`super::BoardConfig::dhb_pwm`].
    Dhb(DhbLines),
}

/// Outputs of the PWM chip that drive the inputs of an OSMC.
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
    /// Returns the four outputs, in the order of the fields.
    #[must_use]
    pub const fn all(self) -> [u8; 4] {
        [self.ahi, self.ali, self.bhi, self.bli]
    }

    /// Returns the lowest of the four outputs.
    #[must_use]
    pub fn first(self) -> u8 {
        lowest(&self.all())
    }
}

/// Outputs of the PWM chip that drive the inputs of one motor of a DHB-12.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct DhbLines {
    /// Input 1: PWM forwards.
    pub in1: u8,
    /// Input 2: PWM backwards.
    pub in2: u8,
    /// Enable input of the motor.
    pub en: u8,
}

impl DhbLines {
    /// Returns the three outputs, in the order of the fields.
    #[must_use]
    pub const fn all(self) -> [u8; 3] {
        [self.in1, self.in2, self.en]
    }

    /// Returns the lowest of the three outputs.
    #[must_use]
    pub fn first(self) -> u8 {
        lowest(&self.all())
    }
}

fn lowest(lines: &[u8]) -> u8 {
    lines.iter().copied().min().unwrap_or(0)
}

/// Feedback of a motor, and its loops.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ControlConfig {
    /// Sensor of the position.
    pub feedback: Feedback,
    /// Range of positions for set points, rad or m.
    pub position: Range,
    /// Highest speed for set points and paths, rad/s or m/s.
    pub speed_max: f32,
    /// Gains of the position loop, whose output is a duty.
    pub position_pid: PidGains,
    /// Gains of the speed loop, whose output is a duty.
    pub speed_pid: PidGains,
    /// Gain of a cascade, 1/s. Above 0, the speed loop holds positions and paths: its set point is the speed of the
    /// path plus this gain times the distance from the path. At 0 the position loop holds them.
    pub cascade_per_s: f32,
    /// Time constant of the low-pass on the measured speed, s.
    pub speed_filter_s: f32,
    /// Limits of the profile to a new position.
    pub profile: ProfileLimits,
    /// Feed-forward from the path, added to the output of both loops.
    pub feed_forward: FeedForward,
    /// Conditions under which a position counts as reached.
    pub settle: SettleConfig,
    /// Conditions under which the motor counts as stalled.
    pub stall: StallConfig,
    /// Conditions under which the motor counts as not following its path.
    pub follow: FollowConfig,
    /// Homing switch; `None` where the zero is the position at power-on, or the feedback is absolute.
    pub homing: Option<HomingConfig>,
    /// Second encoder, on the motor's side of the play between the motor and what `feedback` measures.
    pub motor_side: Option<MotorSideConfig>,
    /// Force control; `None` without a force sensor.
    pub force: Option<ForceConfig>,
}

/// Encoder on the motor's side of a gear with play: speed and damping use it, positions use
/// [`ControlConfig::feedback`].
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct MotorSideConfig {
    /// Number of the encoder counter.
    pub index: u8,
    /// Counts of this encoder in one turn of the output shaft, gear included.
    pub counts_per_turn: u32,
    /// True where positive duty counts down.
    pub inverted: bool,
    /// Largest difference between the two sides, from where they are nearest, rad: the play, the twist of the gear, and
    /// a margin. Beyond it one of the two sensors is not on the shaft that the configuration says.
    pub gap_max: f32,
}

/// Sensor of a motor's position.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub enum Feedback {
    /// Quadrature encoder, with four counts to a line.
    Encoder {
        /// Number of the encoder counter.
        index: u8,
        /// Counts in one turn of the output shaft.
        counts_per_turn: u32,
        /// True where positive duty counts down.
        inverted: bool,
        /// Counts from one index pulse to the next, where the pulse comes in at the switch input of the same number; 0
        /// without one.
        counts_per_index: u32,
    },
    /// Potentiometer on an analog input, calibrated at two points.
    Potentiometer {
        /// Number of the analog input.
        analog: u8,
        /// First calibration point: the lower position.
        low: PotPoint,
        /// Second calibration point: the higher position.
        high: PotPoint,
    },
    /// Absolute angle sensor on the output shaft, one of [`super::BoardConfig::sensors`].
    ///
    /// With a range of positions within one turn, the position is known from the first reading on. With a larger range,
    /// the shaft is assumed to be within half a turn of 0 at power-on.
    Angle {
        /// Number of the sensor's channel.
        angle: u8,
        /// Angle of the sensor at position 0, rad, 0 to 2π.
        zero: f32,
        /// True where positive duty lowers the angle.
        inverted: bool,
    },
    /// PWM output of an AS5600 on the output shaft, at the echo input of a range sensor's connector. Its angle is
    /// absolute as that of [`Feedback::Angle`].
    Pulses {
        /// Number of the range connector: 0 or 1, whose edges a timer captures.
        range: u8,
        /// PWM frames of the sensor per second, as it is set: 115 or 230.
        frames_hz: u16,
        /// Angle of the sensor at position 0, rad, 0 to 2π.
        zero: f32,
        /// True where positive duty lowers the angle.
        inverted: bool,
    },
}

impl Feedback {
    /// Returns whether the sensor measures an angle; false for a length.
    #[must_use]
    pub const fn turns(self) -> bool {
        !matches!(self, Self::Potentiometer { .. })
    }
}

/// Lowest rate at which an angle sensor serves as a motor's feedback, Hz: four control periods of 1 ms between two readings.
pub const ANGLE_RATE_MIN_HZ: u16 = 250;
/// Number of readings in a row that may fail before the motor stops.
pub const ANGLE_READINGS_LOST: u16 = 5;

/// Calibration point of a potentiometer.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct PotPoint {
    /// Code of the 16-bit converter.
    pub code: u16,
    /// Position at this code, m.
    pub position_m: f32,
}

/// Smallest difference of the calibration points, in 16-bit codes: 1/64 of the converter's range still resolves 1/1000
/// of the stroke.
const POT_SPAN: u16 = 1024;
/// Range of codes for calibration points, 1/256 of the range away from either rail, so that a shorted wiper differs
/// from an end.
const POT_CODES: core::ops::RangeInclusive<u16> = 256..=u16::MAX - 256;

/// Homing of an axis: it seeks a switch, backs off it, and takes that place as the configured position.
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
    /// Returns whether the homing fits an axis with these limits.
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
    /// Proportional gain on the error, duty/E.
    pub kp: f32,
    /// Integral gain, duty/(E s).
    pub ki: f32,
    /// Derivative gain on the measured value, duty s/E.
    pub kd: f32,
}

impl ControlConfig {
    /// Returns the numbers, other than gains, that a host may change without a restart.
    #[must_use]
    pub fn tuning(&self) -> Tuning {
        Tuning { feed_forward: self.feed_forward, cascade_per_s: self.cascade_per_s }
    }
}

impl PidGains {
    /// Highest gain: up to it the loop computes finite numbers for any error that a sensor can have.
    pub const MAX: f32 = 1e6;

    /// Returns whether every gain is from 0 to [`PidGains::MAX`].
    #[must_use]
    pub fn is_valid(&self) -> bool {
        [self.kp, self.ki, self.kd].into_iter().all(|gain| (0.0..=Self::MAX).contains(&gain))
    }
}

/// Limits of the profile to a new position.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ProfileLimits {
    /// Highest speed, rad/s or m/s.
    pub speed: f32,
    /// Highest acceleration, rad/s² or m/s².
    pub acceleration: f32,
    /// Highest jerk, rad/s³ or m/s³; 0 for trapezoids, whose acceleration steps.
    pub jerk: f32,
}

/// Feed-forward duty `static_duty sign(v) + duty_per_speed v + duty_per_acceleration a`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct FeedForward {
    /// Duty against static friction: just too little to move the motor.
    pub static_duty: f32,
    /// Duty for the speed, duty s/rad or duty s/m.
    pub duty_per_speed: f32,
    /// Duty for the acceleration, duty s²/rad or duty s²/m.
    pub duty_per_acceleration: f32,
}

/// Numbers of a motor's loops, other than gains, that a host may change without a restart.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct Tuning {
    /// Feed-forward from the path, added to the output of both loops.
    pub feed_forward: FeedForward,
    /// Gain of the cascade: see [`ControlConfig::cascade_per_s`].
    pub cascade_per_s: f32,
}

impl FeedForward {
    /// Returns whether all numbers are finite and none is negative, and `static_duty` is below `duty_max`.
    #[must_use]
    pub fn is_valid(&self, duty_max: f32) -> bool {
        let Self { static_duty, duty_per_speed, duty_per_acceleration } = *self;
        [static_duty, duty_per_speed, duty_per_acceleration].into_iter().all(not_negative) && static_duty < duty_max
    }
}

impl Tuning {
    /// Returns whether a motor of this `duty_max` takes these numbers.
    #[must_use]
    pub fn is_valid(&self, duty_max: f32) -> bool {
        self.feed_forward.is_valid(duty_max) && cascade_is_valid(self.cascade_per_s)
    }
}

fn cascade_is_valid(cascade_per_s: f32) -> bool {
    not_negative(cascade_per_s) && cascade_per_s <= CASCADE_MAX_PER_S
}

/// Condition of a reached position: error and speed stay within these limits for `time_ms`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct SettleConfig {
    /// Largest distance from the set point, rad or m.
    pub error: f32,
    /// Largest speed, rad/s or m/s.
    pub speed: f32,
    /// Time within both limits, ms.
    pub time_ms: u16,
}

/// Condition of a motor that does not follow its path: it is further away than `error` for `time_ms`, in position mode.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct FollowConfig {
    /// Largest distance from the path, rad or m.
    pub error: f32,
    /// Time beyond that distance, ms.
    pub time_ms: u16,
}

/// Condition of a stall: driven with at least `duty`, the motor moves less than `travel` in `time_ms`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct StallConfig {
    /// Lowest duty at which a stall counts, share of the supply.
    pub duty: f32,
    /// Smallest travel of a motor that is not stalled, rad or m.
    pub travel: f32,
    /// Time for that travel, ms.
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
            // Otherwise the supply would be switched off while the motor is still driven.
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
            // The name of the channel says its unit: `osmc` is in rad, `actuator` in m.
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

/// Range of thermal time constants, s: a small winding has some seconds, a large motor's case an hour.
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

/// Number of range connectors whose echo inputs take pulses.
const PULSE_INPUTS: u8 = 2;
/// Number of the encoder that interrupts count; timers count the others.
const INTERRUPT_ENCODER: u8 = 3;
/// Most counts per millisecond of encoder 3 at a motor's highest speed. Twice as many count as an interrupt storm.
pub const ENCODER_3_COUNTS_PER_MS: u32 = 50;

/// Fewest counts between index pulses: below 4 lines in a turn an index pulse, which shows whole lines, is of no use.
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

/// One turn of a shaft, rad.
const TURN: f32 = core::f32::consts::TAU;

/// Highest gain of a cascade, 1/s: one that is faster than the control loop is of no use.
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
                // The limit keeps a count within an i32, with room for an axis that turns beyond its range.
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
