//! What a board is told about itself: wiring, limits, gains and calibration.
//!
//! Made from `boards/*.toml`; the firmware takes it as it is and checks it with [`BoardConfig::validate`].

use core::fmt;

use heapless::{String, Vec};
use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::channel::{ChannelId, ChannelKind, Range};

/// Most motor channels on OSMC bridges.
pub const MAX_MOTORS: usize = 4;
/// Most supply rails measured.
pub const MAX_SUPPLIES: usize = 4;
/// Most relays.
pub const MAX_RELAYS: usize = 8;
/// Most analog inputs.
pub const ANALOG_INPUTS: usize = 6;
/// Most quadrature counters.
pub const ENCODERS: usize = 4;
/// No configuration may let a bridge exceed this share: the high side's bootstrap needs the rest.
pub const OSMC_DUTY_HARD_MAX: f32 = 0.98;

/// One R4 board in one robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct BoardConfig {
    /// The robot's name.
    pub robot: String<32>,
    /// Period of the control loop, µs.
    pub control_period_us: u32,
    /// The board trips after this long without a heartbeat, ms; 20 to 1000.
    pub link_timeout_ms: u16,
    /// The PWM chip behind the OSMC bridges.
    pub osmc_pwm: PwmConfig,
    /// Motor channels.
    pub motors: Vec<MotorConfig, MAX_MOTORS>,
    /// Supply rails.
    pub supplies: Vec<SupplyConfig, MAX_SUPPLIES>,
    /// Where the relays are; needed when there are any.
    pub expander: Option<ExpanderConfig>,
    /// Relays.
    pub relays: Vec<RelayConfig, MAX_RELAYS>,
}

/// An MCP23017.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct ExpanderConfig {
    /// 7-bit I2C address.
    pub address: u8,
}

/// A relay on the expander.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct RelayConfig {
    /// [`ChannelKind::Relay`] and its number.
    pub id: ChannelId,
    /// Bit of the expander, 0 to 7 on port A, 8 to 15 on port B.
    pub bit: u8,
    /// Whether a low output closes it. An input, as after power-up, must leave it open either way.
    pub active_low: bool,
    /// What it switches.
    pub role: RelayRole,
}

/// What a relay switches.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub enum RelayRole {
    /// Whatever the user wired to it; open until commanded.
    General,
    /// The motors' supply: closed while armed, opened first on a stop, not commanded by hosts.
    MotorPower,
}

/// A PCA9685.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct PwmConfig {
    /// 7-bit I2C address.
    pub address: u8,
    /// PWM frequency asked for, Hz; the chip has 24 to 1526.
    pub frequency_hz: f32,
}

/// Which outputs of the PWM chip drive which bridge input.
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
        self.ahi.min(self.ali).min(self.bhi).min(self.bli)
    }
}

/// A motor on an OSMC bridge, with its feedback and loops.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct MotorConfig {
    /// [`ChannelKind::Osmc`] or [`ChannelKind::Actuator`], with the bridge connector's number.
    pub id: ChannelId,
    /// Wiring of the bridge.
    pub lines: BridgeLines,
    /// Whether positive duty is reverse current.
    pub inverted: bool,
    /// What measures the position.
    pub feedback: Feedback,
    /// Positions it may be sent to, rad or m.
    pub position: Range,
    /// Highest speed it may be asked for, rad/s or m/s.
    pub speed_max: f32,
    /// Highest share of the supply, 0..=[`OSMC_DUTY_HARD_MAX`].
    pub duty_max: f32,
    /// Fastest change of the duty, 1/s.
    pub duty_slew_per_s: f32,
    /// Position loop; its output is a duty.
    pub position_pid: PidGains,
    /// Speed loop; its output is a duty.
    pub speed_pid: PidGains,
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
}

/// One calibration point of a potentiometer.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct PotPoint {
    /// 16-bit converter code.
    pub code: u16,
    /// Position there, m.
    pub position_m: f32,
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

impl PidGains {
    /// No gain is higher: with any error a sensor can have, the loop computes in finite numbers.
    pub const MAX: f32 = 1e6;

    /// Whether every gain is from 0 to [`PidGains::MAX`].
    #[must_use]
    pub fn is_valid(&self) -> bool {
        [self.kp, self.ki, self.kd].into_iter().all(|gain| (0.0..=Self::MAX).contains(&gain))
    }
}

/// Limits of a trapezoidal path.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ProfileLimits {
    /// rad/s or m/s
    pub speed: f32,
    /// rad/s² or m/s²
    pub acceleration: f32,
}

/// Feed-forward duty `static_duty sign(v) + duty_per_speed v`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct FeedForward {
    /// Duty that just does not move the motor.
    pub static_duty: f32,
    /// duty s / rad, or duty s / m
    pub duty_per_speed: f32,
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

/// A supply rail on a divided analog input.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct SupplyConfig {
    /// [`ChannelKind::Supply`] and its number.
    pub id: ChannelId,
    /// Which analog input.
    pub analog: u8,
    /// Volts at the rail for one count of the 16-bit converter.
    pub volts_per_code: f32,
    /// The board trips outside this, V.
    pub range_v: Range,
}

/// Why a configuration is not taken.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ConfigError {
    /// The motor or supply it is about, or `None` for the board.
    pub channel: Option<ChannelId>,
    /// What must hold.
    pub rule: &'static str,
}

impl fmt::Display for ConfigError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        if let Some(channel) = self.channel {
            write!(f, "{channel}: ")?;
        }
        f.write_str(self.rule)
    }
}

impl core::error::Error for ConfigError {}

impl BoardConfig {
    /// Checks every number on its own and against the others.
    ///
    /// # Errors
    /// The first rule that does not hold.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let board = |holds: bool, rule| check(None, holds, rule);
        board((500..=20_000).contains(&self.control_period_us), "control_period_us must be 500 to 20000")?;
        board((20..=1000).contains(&self.link_timeout_ms), "link_timeout_ms must be 20 to 1000")?;
        board(Range::new(24.0, 1526.0).contains(self.osmc_pwm.frequency_hz), "the PWM chip has 24 to 1526 Hz")?;
        board((0x40..0x78).contains(&self.osmc_pwm.address), "a PCA9685 has an address from 0x40 to 0x77")?;
        let mut lines_used = 0u32;
        let mut encoders_used = 0u32;
        let mut analogs_used = 0u32;
        let take = |used: &mut u32, index: u8| {
            let free = *used & (1 << index) == 0;
            *used |= 1 << index;
            free
        };
        for motor in &self.motors {
            let rule = |holds: bool, rule| check(Some(motor.id), holds, rule);
            motor.validate()?;
            for line in motor.lines.all() {
                rule(line < 16 && take(&mut lines_used, line), "bridge lines must be 0 to 15, each used once")?;
            }
            let first = motor.lines.first();
            rule(
                motor.lines.all().iter().all(|line| line - first < 4),
                "a bridge's lines must be four in a row, so that one transfer sets them",
            )?;
            match motor.feedback {
                Feedback::Encoder { index, .. } => rule(
                    usize::from(index) < ENCODERS && take(&mut encoders_used, index),
                    "the encoder must exist and be used once",
                )?,
                Feedback::Potentiometer { analog, .. } => rule(
                    usize::from(analog) < ANALOG_INPUTS && take(&mut analogs_used, analog),
                    "the analog input must exist and be used once",
                )?,
            }
        }
        for supply in &self.supplies {
            let rule = |holds: bool, rule| check(Some(supply.id), holds, rule);
            rule(supply.id.kind == ChannelKind::Supply, "a supply needs a supply channel name")?;
            rule(
                usize::from(supply.analog) < ANALOG_INPUTS && take(&mut analogs_used, supply.analog),
                "the analog input must exist and be used once",
            )?;
            rule(positive(supply.volts_per_code), "volts_per_code must be positive")?;
            let Range { min, max } = supply.range_v;
            rule(min.is_finite() && max.is_finite() && min < max, "range_v must have a finite min below a finite max")?;
        }
        let mut bits_used = 0u32;
        for relay in &self.relays {
            let rule = |holds: bool, rule| check(Some(relay.id), holds, rule);
            rule(relay.id.kind == ChannelKind::Relay, "a relay needs a relay channel name")?;
            rule(self.expander.is_some(), "a relay needs the expander")?;
            rule(relay.bit < 16 && take(&mut bits_used, relay.bit), "expander bits must be 0 to 15, each used once")?;
        }
        if let Some(expander) = self.expander {
            board((0x20..0x28).contains(&expander.address), "an MCP23017 has an address from 0x20 to 0x27")?;
        }
        let supplies_and_relays = || self.supplies.iter().map(|s| s.id).chain(self.relays.iter().map(|r| r.id));
        let ids = || self.motors.iter().map(|m| m.id).chain(supplies_and_relays());
        for (position, id) in ids().enumerate() {
            check(Some(id), !ids().take(position).any(|other| other == id), "the channel is named twice")?;
        }
        for (position, motor) in self.motors.iter().enumerate() {
            let taken = self.motors[..position].iter().any(|other| other.id.index == motor.id.index);
            check(Some(motor.id), !taken, "the bridge connector is used twice")?;
        }
        Ok(())
    }
}

impl MotorConfig {
    fn validate(&self) -> Result<(), ConfigError> {
        let rule = |holds: bool, rule| check(Some(self.id), holds, rule);
        match (self.id.kind, self.feedback) {
            (ChannelKind::Osmc, Feedback::Encoder { counts_per_turn, .. }) => {
                rule(counts_per_turn > 0, "counts_per_turn must be positive")?;
            }
            (ChannelKind::Actuator, Feedback::Potentiometer { low, high, .. }) => {
                rule(low.code != high.code, "the calibration points need different codes")?;
                rule(
                    low.position_m.is_finite() && high.position_m.is_finite() && low.position_m < high.position_m,
                    "the low calibration point must be below the high one",
                )?;
            }
            _ => rule(false, "an osmc channel needs an encoder, an actuator a potentiometer")?,
        }
        rule(self.id.index < 4, "bridges are numbered 0 to 3")?;
        rule(
            self.position.min.is_finite() && self.position.max.is_finite() && self.position.min < self.position.max,
            "position must have a finite min below a finite max",
        )?;
        rule(positive(self.speed_max), "speed_max must be positive")?;
        rule(self.duty_max > 0.0 && self.duty_max <= OSMC_DUTY_HARD_MAX, "duty_max must be above 0 and at most 0.98")?;
        rule(positive(self.duty_slew_per_s), "duty_slew_per_s must be positive")?;
        rule(self.position_pid.is_valid() && self.speed_pid.is_valid(), "gains must be 0 to 1000000")?;
        rule(not_negative(self.speed_filter_s), "speed_filter_s must not be negative")?;
        rule(
            positive(self.profile.speed) && positive(self.profile.acceleration),
            "profile speed and acceleration must be positive",
        )?;
        rule(
            not_negative(self.feed_forward.static_duty)
                && self.feed_forward.static_duty < self.duty_max
                && not_negative(self.feed_forward.duty_per_speed),
            "feed-forward must not be negative, and static_duty must stay below duty_max",
        )?;
        rule(positive(self.settle.error) && positive(self.settle.speed), "settle error and speed must be positive")?;
        rule(
            positive(self.stall.duty) && positive(self.stall.travel) && self.stall.time_ms > 0,
            "stall duty, travel and time must be positive",
        )?;
        rule(self.stall.duty < self.duty_max, "stall duty must be below duty_max, or a stall is never seen")?;
        rule(positive(self.follow.error) && self.follow.time_ms > 0, "follow error and time must be positive")
    }
}

fn check(channel: Option<ChannelId>, holds: bool, rule: &'static str) -> Result<(), ConfigError> {
    if holds { Ok(()) } else { Err(ConfigError { channel, rule }) }
}

fn positive(value: f32) -> bool {
    value.is_finite() && value > 0.0
}

fn not_negative(value: f32) -> bool {
    value.is_finite() && value >= 0.0
}
