//! Set points for up to four channels and what these do, in two short messages of fixed length.
//!
//! [`Request::Bind`](crate::Request::Bind) says once which channels are meant, in which mode and by which scales. Then each
//! [`Cycle`] down is answered by one [`CycleState`] up, at once. With checksum, COBS and delimiter they take [`CYCLE_FRAME`]
//! and [`CYCLE_STATE_FRAME`] bytes, 66 together, whatever is in them: numbers are little-endian byte arrays, because
//! postcard writes other integers with as many bytes as their value needs.
//!
//! # Units
//!
//! A set point is an `i16` times the scale of its mode. [`NOTHING`] (-32768) says that a channel gets no set point. Nothing
//! is clipped: what lies outside the channel's range is refused, and the whole cycle with it.
//!
//! | mode | scale of a set point |
//! | --- | --- |
//! | position, follow | [`CycleChannel::position_scale`], rad or m |
//! | speed | [`CycleChannel::speed_scale`], rad/s or m/s |
//! | duty | [`DUTY_SCALE`], share of the supply |
//!
//! What each kind of channel answers; [`NOTHING`] stands for a speed or duty that it does not have, or that is beyond
//! ±32767 times the scale:
//!
//! | channel | position, counts of [`ChannelInfo::resolution`](crate::ChannelInfo::resolution) | speed, times its scale | duty, times [`DUTY_SCALE`] | settled |
//! | --- | --- | --- | --- | --- |
//! | `osmc`, `dhb` with an encoder | output shaft, from its zero | rad/s, filtered | at the bridge | rests at its position |
//! | `actuator` | rod, µm | m/s, filtered | at the bridge | rests at its position |
//! | `osmc`, `dhb` with nothing that measures | 0 | 0 | at the bridge | never |
//! | `stepper` | steps told | rad/s told | 0 | rests at its position |
//! | `bldc` | 0 | [`NOTHING`] | share that was commanded | never |
//! | none bound | 0 | [`NOTHING`] | [`NOTHING`] | never |

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::{
    Setpoint,
    channel::{ChannelId, Mode},
    state::{Cause, Causes, SafetyState},
};

/// Most channels of a cycle.
pub const CYCLE_CHANNELS: usize = 4;
/// Bytes of the frame of a [`Cycle`], delimiter included.
pub const CYCLE_FRAME: usize = 21;
/// Bytes of the frame of a [`CycleState`], delimiter included.
pub const CYCLE_STATE_FRAME: usize = 45;
/// One step of a duty, share of the supply.
pub const DUTY_SCALE: f32 = 1.0 / 32_767.0;
/// No set point, or no such quantity, where a number would be.
pub const NOTHING: i16 = i16::MIN;

/// A channel of a cycle, and what its numbers mean.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct CycleChannel {
    /// Which: a motor, a stepper or a brushless drive.
    pub channel: ChannelId,
    /// What its set points are, in a cycle that says nothing else: position, follow, speed or duty.
    pub mode: Mode,
    /// One step of a position that is set, rad or m; finite and above 0.
    pub position_scale: f32,
    /// One step of a speed, set or answered, rad/s or m/s; finite and above 0.
    pub speed_scale: f32,
}

impl CycleChannel {
    /// One step of a set point in `mode`, or `None` when no cycle carries such.
    #[must_use]
    pub fn scale(&self, mode: Mode) -> Option<f32> {
        match mode {
            Mode::Position | Mode::Follow => Some(self.position_scale),
            Mode::Speed => Some(self.speed_scale),
            Mode::Duty => Some(DUTY_SCALE),
            Mode::Switch | Mode::Voltage | Mode::Brake | Mode::Home | Mode::Force => None,
        }
    }

    /// What `steps` of a cycle mean for it: in the cycle's `mode`, or in its own. `None` for [`NOTHING`].
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

    /// Whether both scales are finite and above 0.
    #[must_use]
    pub fn is_scaled(&self) -> bool {
        [self.position_scale, self.speed_scale].into_iter().all(|scale| scale.is_finite() && scale > 0.0)
    }
}

/// No cycle carries set points of this mode.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unscaled;

/// The number of steps nearest to `value`, or `None` when that is not within ±32767.
#[must_use]
pub fn steps(value: f32, scale: f32) -> Option<i16> {
    let steps = value / scale;
    // Not for NaN either.
    let fits = steps > -32_767.5 && steps < 32_767.5;
    fits.then_some((if steps < 0.0 { steps - 0.5 } else { steps + 0.5 }) as i16)
}

/// Set points, all for one moment. They are followed until another comes, or the time-to-live of the binding has passed since
/// they were decided: then the channels they were for are stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Cycle {
    /// Chosen by the host, echoed by the board.
    pub seq: u8,
    /// Mode in bits 0 to 3, its position among [`Mode`]'s variants or 15 for what was bound; bit 4 for one without a date;
    /// bits 5 to 7 are 0.
    how: u8,
    /// When the host decided this, on the board's clock: the low 32 bits. For a point of a path ([`Mode::Follow`]), when the channel
    /// is to be there.
    sent_us: [u8; 4],
    /// `i16` for each channel, in the order in which they were bound.
    set: [u8; 2 * CYCLE_CHANNELS],
}

const AS_BOUND: u8 = 15;
const UNDATED: u8 = 1 << 4;

impl Cycle {
    /// Set points decided at `sent_us` on the board's clock; without that, age counts from when the board decodes them.
    /// Without `mode`, each is meant as its channel was bound. [`NOTHING`] leaves a channel out.
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

    /// Its mode, `None` for what was bound.
    ///
    /// # Errors
    /// [`NotThisVersion`] when bits are set that mean nothing.
    pub fn mode(&self) -> Result<Option<Mode>, NotThisVersion> {
        if self.how & !(AS_BOUND | UNDATED) != 0 {
            return Err(NotThisVersion);
        }
        match self.how & AS_BOUND {
            AS_BOUND => Ok(None),
            mode => Mode::ALL.get(usize::from(mode)).copied().map(Some).ok_or(NotThisVersion),
        }
    }

    /// How long ago the host decided this, µs, when the board's clock is `now_us`; negative for one that is dated ahead, and
    /// 0 for one without a date. Right for up to half an hour either way: the date wraps after 71 minutes.
    #[must_use]
    pub fn age_us(&self, now_us: u64) -> i32 {
        if self.how & UNDATED != 0 {
            return 0;
        }
        (now_us as u32).wrapping_sub(u32::from_le_bytes(self.sent_us)).cast_signed()
    }

    /// The set points, in steps.
    #[must_use]
    pub fn set(&self) -> [i16; CYCLE_CHANNELS] {
        whole(self.set)
    }
}

/// A message of this length, but of another version.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NotThisVersion;

/// What became of a [`Cycle`]. Where it was not taken, none of its set points was.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CycleOutcome {
    /// Its set points are followed.
    Taken = 0,
    /// A set point the channel does not take, or the board is not armed. The channels it has set points for are stopped, unless
    /// they follow later ones.
    Refused = 1,
    /// Older than its time-to-live, or dated as far ahead. Stops channels as [`CycleOutcome::Refused`] does.
    Stale = 2,
    /// No session over this link, or no channels bound.
    Unbound = 3,
}

/// What the bound channels do, and what became of the [`Cycle`] with this `seq`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct CycleState {
    /// Of the cycle.
    pub seq: u8,
    /// State in bits 0 and 1, settled in bits 2 to 5, outcome in bits 6 and 7.
    flags: u8,
    /// The board's clock, its low 24 bits.
    device_us: [u8; 3],
    /// Causes latched by a trip, their low 24 bits.
    causes: [u8; 3],
    /// `i32` for each channel.
    position: [u8; 4 * CYCLE_CHANNELS],
    /// `i16` for each channel.
    speed: [u8; 2 * CYCLE_CHANNELS],
    /// `i16` for each channel.
    duty: [u8; 2 * CYCLE_CHANNELS],
}

/// What one channel does, in the units of the table above.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CycleMotor {
    /// Counts.
    pub position: i32,
    /// Steps of its scale, or [`NOTHING`].
    pub speed: i16,
    /// Steps of [`DUTY_SCALE`], or [`NOTHING`].
    pub duty: i16,
    /// Whether it rests at its position.
    pub settled: bool,
}

impl CycleMotor {
    /// What stands where no channel is bound.
    pub const NONE: Self = Self { position: 0, speed: NOTHING, duty: NOTHING, settled: false };
}

impl CycleState {
    /// An answer.
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

    /// What became of the cycle.
    #[must_use]
    pub const fn outcome(&self) -> CycleOutcome {
        match self.flags >> 6 {
            0 => CycleOutcome::Taken,
            1 => CycleOutcome::Refused,
            2 => CycleOutcome::Stale,
            _ => CycleOutcome::Unbound,
        }
    }

    /// Where the supervisor stands.
    ///
    /// # Errors
    /// [`NotThisVersion`] for a state that there is not.
    pub const fn state(&self) -> Result<SafetyState, NotThisVersion> {
        match self.flags & 3 {
            0 => Ok(SafetyState::Disarmed),
            1 => Ok(SafetyState::Armed),
            2 => Ok(SafetyState::Tripped),
            _ => Err(NotThisVersion),
        }
    }

    /// Causes latched by a trip.
    #[must_use]
    pub const fn causes(&self) -> Causes {
        Causes::from_bits(of_24(self.causes))
    }

    /// The board's clock when it answered: the time nearest to `near_us` that has these low 24 bits. `near_us` must be right to
    /// 8 s.
    #[must_use]
    pub const fn device_us(&self, near_us: u64) -> u64 {
        // The difference modulo 2^24, with its sign.
        let ahead = (of_24(self.device_us).wrapping_sub(near_us as u32) << 8).cast_signed() >> 8;
        near_us.wrapping_add_signed(ahead as i64)
    }

    /// What the channels do, in the order in which they were bound.
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

/// The low 24 bits.
const fn low_24(number: u32) -> [u8; 3] {
    let [low, middle, high, _] = number.to_le_bytes();
    [low, middle, high]
}

const fn of_24([low, middle, high]: [u8; 3]) -> u32 {
    u32::from_le_bytes([low, middle, high, 0])
}

/// Every cause travels in a [`CycleState`].
const _: () = assert!(Cause::ALL.len() <= 24);

/// The low 32 bits.
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
        // Where rounding would make it -32768, which is `NOTHING`, or 32768.
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
