//! Set points for up to four channels, and the state of these channels, in two short messages of fixed length.
//!
//! [`Request::Bind`](crate::Request::Bind) says once which channels, modes and scales are meant. From then on the board
//! answers each [`Cycle`] at once by one [`CycleState`]. With checksum, COBS and delimiter they take [`CYCLE_FRAME`]
//! and [`CYCLE_STATE_FRAME`] bytes, 66 together, whatever their content: numbers are little-endian byte arrays, because
//! postcard encodes integers in as many bytes as their value needs.
//!
//! # Units
//!
//! A set point is an `i16` times the scale of its mode. [`NOTHING`] (-32768) leaves a channel without a set point.
//! Nothing is clipped: a value outside the channel's range is refused, and the whole cycle with it.
//!
//! | mode | scale of a set point |
//! | --- | --- |
//! | position, follow | [`CycleChannel::position_scale`], rad or m |
//! | speed | [`CycleChannel::speed_scale`], rad/s or m/s |
//! | duty | [`DUTY_SCALE`], share of the supply |
//!
//! State of each kind of channel in the answer; [`NOTHING`] replaces a speed or duty that it does not have, or that is
//! beyond ±32767 times the scale:
//!
//! | channel | position, counts of [`ChannelInfo::resolution`](crate::ChannelInfo::resolution) | speed, times its scale | duty, times [`DUTY_SCALE`] | settled |
//! | --- | --- | --- | --- | --- |
//! | `osmc`, `dhb` with an encoder | output shaft, from its zero | rad/s, filtered | at the bridge | rests at its position |
//! | `actuator` | rod, µm | m/s, filtered | at the bridge | rests at its position |
//! | `osmc`, `dhb` without feedback | 0 | 0 | at the bridge | never |
//! | `stepper` | steps commanded | rad/s commanded | 0 | rests at its position |
//! | `bldc` | 0 | [`NOTHING`] | share of full speed commanded | never |
//! | none bound | 0 | [`NOTHING`] | [`NOTHING`] | never |

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::{
    Setpoint,
    channel::{ChannelId, Mode},
    state::{Cause, Causes, SafetyState},
};

/// Maximum number of channels in a cycle.
pub const CYCLE_CHANNELS: usize = 4;
/// Length of the frame of a [`Cycle`], bytes, delimiter included.
pub const CYCLE_FRAME: usize = 21;
/// Length of the frame of a [`CycleState`], bytes, delimiter included.
pub const CYCLE_STATE_FRAME: usize = 45;
/// Scale of a duty: one step as a share of the supply.
pub const DUTY_SCALE: f32 = 1.0 / 32_767.0;
/// Value of a number that is absent: no set point, or no such quantity.
pub const NOTHING: i16 = i16::MIN;

/// Channel of a cycle, and what its numbers mean.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct CycleChannel {
    /// Name of the channel: a motor, a stepper or a brushless drive.
    pub channel: ChannelId,
    /// Mode of its set points in a cycle that names no mode: position, follow, speed or duty.
    pub mode: Mode,
    /// Scale of a position set point: one step, rad or m; finite and above 0.
    pub position_scale: f32,
    /// Scale of a speed, set or measured: one step, rad/s or m/s; finite and above 0.
    pub speed_scale: f32,
}

impl CycleChannel {
    /// Returns one step of a set point in `mode`, or `None` for a mode that no cycle carries.
    #[must_use]
    pub fn scale(&self, mode: Mode) -> Option<f32> {
        match mode {
            Mode::Position | Mode::Follow => Some(self.position_scale),
            Mode::Speed => Some(self.speed_scale),
            Mode::Duty => Some(DUTY_SCALE),
            Mode::Switch | Mode::Voltage | Mode::Brake | Mode::Home | Mode::Force => None,
        }
    }

    /// Converts `steps` of a cycle into a set point, in `mode`, or in the bound mode where the cycle has none. `None`
    /// for [`NOTHING`].
    ///
    /// # Errors
    /// [`Unscaled`] in a mode that no cycle carries.
    pub fn setpoint(&self, mode: Option<Mode>, steps: i16) -> Result<Option<Setpoint>, Unscaled> {
        if steps == NOTHING {
            return Ok(None);
        }
        let mode = mode.unwrap_or(self.mode);
        let scale = self.scale(mode).ok_or(Unscaled)?;
        Ok(Some(Setpoint { mode, value: f32::from(steps) * scale }))
    }

    /// Returns whether both scales are finite and above 0.
    #[must_use]
    pub fn is_scaled(&self) -> bool {
        [self.position_scale, self.speed_scale].into_iter().all(|scale| scale.is_finite() && scale > 0.0)
    }
}

/// Error of a mode whose set points no cycle carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unscaled;

/// Converts `value` to the nearest number of steps; `None` when that is not within ±32767, and for NaN.
#[must_use]
pub fn steps(value: f32, scale: f32) -> Option<i16> {
    let steps = value / scale;
    // Comparisons that are false for NaN, too.
    let fits = steps > -32_767.5 && steps < 32_767.5;
    fits.then_some((if steps < 0.0 { steps - 0.5 } else { steps + 0.5 }) as i16)
}

/// Set points of several channels for one moment. The channels follow them until another cycle comes. When the
/// time to live of the binding has passed since they were decided, the board stops these channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Cycle {
    /// Sequence number, chosen by the host and echoed by the board.
    pub seq: u8,
    /// Mode in bits 0 to 3, as its number among [`Mode`]'s variants, or 15 for the bound modes; bit 4 set for a cycle
    /// without a date; bits 5 to 7 are 0.
    how: u8,
    /// Board's clock when the host decided the set points, low 32 bits. For points of a path ([`Mode::Follow`]), the
    /// moment at which the channels are to be there.
    sent_us: [u8; 4],
    /// Set points, an `i16` for each channel in the order of the binding.
    set: [u8; 2 * CYCLE_CHANNELS],
}

const AS_BOUND: u8 = 15;
const UNDATED: u8 = 1 << 4;

impl Cycle {
    /// Makes a cycle with set points decided at `sent_us` on the board's clock. Without `sent_us` its age counts from
    /// when the board decodes it. Without `mode`, each set point has the mode that its channel was bound with.
    /// [`NOTHING`] leaves a channel out.
    #[must_use]
    pub fn new(seq: u8, mode: Option<Mode>, sent_us: Option<u64>, set: [i16; CYCLE_CHANNELS]) -> Self {
        let undated = if sent_us.is_none() { UNDATED } else { 0 };
        Self {
            seq,
            how: mode.map_or(AS_BOUND, |mode| mode as u8) | undated,
            sent_us: low(sent_us.unwrap_or(0)),
            set: halves(set),
        }
    }

    /// Returns the mode, `None` for the bound modes.
    ///
    /// # Errors
    /// [`NotThisVersion`] for a mode or bits that this version does not know.
    pub fn mode(&self) -> Result<Option<Mode>, NotThisVersion> {
        // Bits 5 to 7 belong to a later version: ignoring them could move a motor in a way that was not meant.
        if self.how & !(AS_BOUND | UNDATED) != 0 {
            return Err(NotThisVersion);
        }
        match self.how & AS_BOUND {
            AS_BOUND => Ok(None),
            mode => Mode::ALL.get(usize::from(mode)).copied().map(Some).ok_or(NotThisVersion),
        }
    }

    /// Returns the age of the set points, µs, when the board's clock is `now_us`: negative for a date ahead of it, 0
    /// without a date. Valid up to half an hour either way: the date wraps after 71 minutes.
    #[must_use]
    pub fn age_us(&self, now_us: u64) -> i32 {
        if self.how & UNDATED != 0 {
            return 0;
        }
        // The wrapping difference of 32 bits is right over their wrap, up to half of it either way.
        (now_us as u32).wrapping_sub(u32::from_le_bytes(self.sent_us)).cast_signed()
    }

    /// Returns the set points, in steps.
    #[must_use]
    pub fn set(&self) -> [i16; CYCLE_CHANNELS] {
        whole(self.set)
    }
}

/// Error of a message with the right length but with values of another version.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotThisVersion;

/// Outcome of a [`Cycle`]. Unless it was taken, none of its set points was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CycleOutcome {
    /// The channels follow the set points.
    Taken = 0,
    /// A channel does not take its set point, or the board is not armed. The board stops the channels that the cycle
    /// has set points for, unless they follow later ones.
    Refused = 1,
    /// The cycle is older than its time to live, or dated as far ahead. Stops channels as [`CycleOutcome::Refused`]
    /// does.
    Stale = 2,
    /// There is no session over this link, or no channel is bound.
    Unbound = 3,
}

/// State of the bound channels, and the outcome of the [`Cycle`] with this `seq`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct CycleState {
    /// Sequence number of the answered cycle.
    pub seq: u8,
    /// Safety state in bits 0 and 1, settled in bits 2 to 5 (one for each channel), outcome in bits 6 and 7.
    flags: u8,
    /// Board's clock, low 24 bits.
    device_us: [u8; 3],
    /// Causes latched by a trip, low 24 bits.
    causes: [u8; 3],
    /// Position of each channel, `i32`.
    position: [u8; 4 * CYCLE_CHANNELS],
    /// Speed of each channel, `i16` times its scale.
    speed: [u8; 2 * CYCLE_CHANNELS],
    /// Duty of each channel, `i16` times 1/32767.
    duty: [u8; 2 * CYCLE_CHANNELS],
}

/// State of one channel, in the units of the table above.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CycleMotor {
    /// Position, counts of the channel's resolution.
    pub position: i32,
    /// Speed in steps of the channel's scale, or [`NOTHING`].
    pub speed: i16,
    /// Duty in steps of [`DUTY_SCALE`], or [`NOTHING`].
    pub duty: i16,
    /// True while the channel rests at its position.
    pub settled: bool,
}

impl CycleMotor {
    /// State in the place of a channel that is not bound.
    pub const NONE: Self = Self { position: 0, speed: NOTHING, duty: NOTHING, settled: false };
}

impl CycleState {
    /// Makes the answer to the cycle `seq`.
    #[must_use]
    pub fn new(
        seq: u8,
        outcome: CycleOutcome,
        device_us: u64,
        (state, causes): (SafetyState, Causes),
        motors: [CycleMotor; CYCLE_CHANNELS],
    ) -> Self {
        let mut flags = state as u8 | (outcome as u8) << 6;
        let mut position = [0; 4 * CYCLE_CHANNELS];
        for (place, motor) in motors.iter().enumerate() {
            flags |= u8::from(motor.settled) << (2 + place);
            position[4 * place..4 * place + 4].copy_from_slice(&motor.position.to_le_bytes());
        }
        Self {
            seq,
            flags,
            device_us: low_24(device_us as u32),
            causes: low_24(causes.bits()),
            position,
            speed: halves(motors.map(|motor| motor.speed)),
            duty: halves(motors.map(|motor| motor.duty)),
        }
    }

    /// Returns the outcome of the cycle.
    #[must_use]
    pub const fn outcome(&self) -> CycleOutcome {
        match self.flags >> 6 {
            0 => CycleOutcome::Taken,
            1 => CycleOutcome::Refused,
            2 => CycleOutcome::Stale,
            _ => CycleOutcome::Unbound,
        }
    }

    /// Returns the state of the board's safety supervisor.
    ///
    /// # Errors
    /// [`NotThisVersion`] for a number that is no state of this version.
    pub const fn state(&self) -> Result<SafetyState, NotThisVersion> {
        match self.flags & 3 {
            0 => Ok(SafetyState::Disarmed),
            1 => Ok(SafetyState::Armed),
            2 => Ok(SafetyState::Tripped),
            _ => Err(NotThisVersion),
        }
    }

    /// Returns the causes latched by a trip.
    #[must_use]
    pub const fn causes(&self) -> Causes {
        Causes::from_bits(of_24(self.causes))
    }

    /// Returns the board's clock when it answered: the time nearest to `near_us` that has these low 24 bits. `near_us`
    /// must be within 8 s of it.
    #[must_use]
    pub const fn device_us(&self, near_us: u64) -> u64 {
        // Difference modulo 2^24: shifting by 8 up and down again extends its sign.
        let ahead = (of_24(self.device_us).wrapping_sub(near_us as u32) << 8).cast_signed() >> 8;
        near_us.wrapping_add_signed(ahead as i64)
    }

    /// Returns the state of the channels, in the order of the binding.
    #[must_use]
    pub fn motors(&self) -> [CycleMotor; CYCLE_CHANNELS] {
        let (speed, duty) = (whole(self.speed), whole(self.duty));
        core::array::from_fn(|place| CycleMotor {
            position: i32::from_le_bytes(core::array::from_fn(|byte| self.position[4 * place + byte])),
            speed: speed[place],
            duty: duty[place],
            settled: self.flags >> (2 + place) & 1 != 0,
        })
    }
}

/// Returns the low 24 bits, little-endian.
const fn low_24(number: u32) -> [u8; 3] {
    let [low, middle, high, _] = number.to_le_bytes();
    [low, middle, high]
}

const fn of_24([low, middle, high]: [u8; 3]) -> u32 {
    u32::from_le_bytes([low, middle, high, 0])
}

/// All causes must fit the 24 bits that a [`CycleState`] has for them.
const _: () = assert!(Cause::ALL.len() <= 24);

/// Returns the low 32 bits, little-endian.
const fn low(us: u64) -> [u8; 4] {
    (us as u32).to_le_bytes()
}

pub(crate) fn whole(bytes: [u8; 2 * CYCLE_CHANNELS]) -> [i16; CYCLE_CHANNELS] {
    core::array::from_fn(|place| i16::from_le_bytes([bytes[2 * place], bytes[2 * place + 1]]))
}

fn halves(numbers: [i16; CYCLE_CHANNELS]) -> [u8; 2 * CYCLE_CHANNELS] {
    core::array::from_fn(|byte| numbers[byte / 2].to_le_bytes()[byte % 2])
}

#[cfg(test)]
mod tests {
    use super::*;

    const SET: [i16; CYCLE_CHANNELS] = [1, -2, NOTHING, 32_767];

    #[test]
    fn modes_are_in_the_order_of_their_variants() {
        for (place, mode) in Mode::ALL.into_iter().enumerate() {
            assert_eq!(mode as usize, place);
            assert_eq!(Cycle::new(0, Some(mode), None, SET).mode(), Ok(Some(mode)));
        }
        assert_eq!(Cycle::new(0, None, Some(1), SET).mode(), Ok(None));
        let no_mode = Mode::ALL.len() as u8..AS_BOUND;
        for how in (5..8).map(|spare| 1 << spare).chain(no_mode) {
            assert_eq!(Cycle { how, ..Cycle::new(0, None, None, SET) }.mode(), Err(NotThisVersion));
        }
    }

    #[test]
    fn an_age_counts_over_the_wrap_of_its_32_bits() {
        const WRAP: u64 = 1 << 32;
        for now_us in [0, 1, WRAP - 1, WRAP, WRAP + 1, 7 * WRAP + 5] {
            for age_us in [0_i32, 1, -1, 100_000, -100_000] {
                let sent_us = now_us.wrapping_add_signed(-i64::from(age_us));
                assert_eq!(Cycle::new(0, None, Some(sent_us), SET).age_us(now_us), age_us);
            }
        }
        assert_eq!(Cycle::new(0, None, None, SET).age_us(12_345), 0, "without a date it is from now");
    }

    #[test]
    fn set_points_and_states_come_back() {
        let cycle = Cycle::new(255, Some(Mode::Speed), Some(u64::MAX), SET);
        assert_eq!((cycle.seq, cycle.set()), (255, SET));

        let motor = |place: i16| CycleMotor {
            position: i32::MIN + i32::from(place),
            speed: -place,
            duty: 100 * place,
            settled: place % 2 == 0,
        };
        let motors = [motor(0), motor(1), motor(2), CycleMotor::NONE];
        let causes = Causes::only(Cause::DeadMan).union(Causes::only(Cause::AuxiliaryStop));
        for outcome in [CycleOutcome::Taken, CycleOutcome::Refused, CycleOutcome::Stale, CycleOutcome::Unbound] {
            for state in [SafetyState::Disarmed, SafetyState::Armed, SafetyState::Tripped] {
                let answer = CycleState::new(9, outcome, 1 << 40, (state, causes), motors);
                assert_eq!((answer.seq, answer.outcome(), answer.state()), (9, outcome, Ok(state)));
                assert_eq!((answer.causes(), answer.motors()), (causes, motors));
            }
        }
        let answer = CycleState::new(9, CycleOutcome::Taken, 0, (SafetyState::Armed, causes), motors);
        assert_eq!(CycleState { flags: 3, ..answer }.state(), Err(NotThisVersion));
    }

    #[test]
    fn every_cause_comes_back() {
        for cause in Cause::ALL {
            let tripped = (SafetyState::Tripped, Causes::only(cause));
            let answer = CycleState::new(0, CycleOutcome::Refused, 0, tripped, [CycleMotor::NONE; CYCLE_CHANNELS]);
            assert_eq!(answer.causes(), Causes::only(cause));
        }
    }

    #[test]
    fn the_boards_clock_is_found_near_ours() {
        const WRAP: u64 = 1 << 24;
        for device_us in [0, 5, WRAP - 1, WRAP, 9 * WRAP + 7, 1 << 32, u64::from(u32::MAX)] {
            let state = (SafetyState::Armed, Causes::NONE);
            let answer = CycleState::new(0, CycleOutcome::Taken, device_us, state, [CycleMotor::NONE; CYCLE_CHANNELS]);
            for error in [0, 1_000_000, -1_000_000, 8_000_000, -8_000_000] {
                if let Some(near_us) = device_us.checked_add_signed(error) {
                    assert_eq!(answer.device_us(near_us), device_us);
                }
            }
        }
    }

    #[test]
    fn steps_are_the_nearest_and_never_clipped() {
        assert_eq!(steps(1.0, DUTY_SCALE), Some(32_767));
        assert_eq!(steps(-1.0, DUTY_SCALE), Some(-32_767));
        assert_eq!([0.49, 0.51, -0.49, -0.51].map(|value| steps(value, 1.0)), [Some(0), Some(1), Some(0), Some(-1)]);
        for beyond in [32_767.6, -32_767.6, f32::INFINITY, f32::NEG_INFINITY, f32::NAN, f32::MAX] {
            assert_eq!(steps(beyond, 1.0), None, "{beyond}");
        }
        for whole in [-32_767_i16, -1, 0, 1, 32_767] {
            assert_eq!(steps(f32::from(whole) * 0.001, 0.001), Some(whole));
        }
        // The ends, which rounding would make -32768, which is `NOTHING`, or 32768.
        for (end, whole) in [(32_767.5_f32, 32_767), (-32_767.5, -32_767)] {
            assert_eq!(steps(end, 1.0), None);
            assert_eq!(steps(end - end.signum() * 0.01, 1.0), Some(whole));
        }
    }

    #[test]
    fn steps_mean_what_their_channel_and_mode_say() {
        let channel = CycleChannel {
            channel: ChannelId::new(crate::ChannelKind::Osmc, 0),
            mode: Mode::Speed,
            position_scale: 0.001,
            speed_scale: 0.25,
        };
        for mode in Mode::ALL {
            let scale = match mode {
                Mode::Position | Mode::Follow => Some(0.001),
                Mode::Speed => Some(0.25),
                Mode::Duty => Some(DUTY_SCALE),
                Mode::Switch | Mode::Voltage | Mode::Brake | Mode::Home | Mode::Force => None,
            };
            assert_eq!(channel.scale(mode), scale);
            for steps in [-32_767, -1, 0, 8, 32_767] {
                let setpoint = scale.map(|scale| Some(Setpoint { mode, value: f32::from(steps) * scale }));
                assert_eq!(channel.setpoint(Some(mode), steps), setpoint.ok_or(Unscaled));
            }
            assert_eq!(channel.setpoint(Some(mode), NOTHING), Ok(None), "left out in any mode");
        }
        assert_eq!(channel.setpoint(None, 8), Ok(Some(Setpoint { mode: Mode::Speed, value: 2.0 })), "as bound");
    }

    #[test]
    fn a_scale_is_finite_and_above_0() {
        let with = |position_scale, speed_scale| CycleChannel {
            channel: ChannelId::new(crate::ChannelKind::Osmc, 0),
            mode: Mode::Speed,
            position_scale,
            speed_scale,
        };
        assert!(with(f32::MIN_POSITIVE, f32::MAX).is_scaled());
        for bad in [0.0, -0.0, -1.0, f32::INFINITY, f32::NEG_INFINITY, f32::NAN] {
            assert!(!with(bad, 1.0).is_scaled() && !with(1.0, bad).is_scaled(), "{bad}");
        }
    }
}
