//! Armed motion with a verdict: commands a channel, watches it, makes it safe, and compares the result with the
//! request.
//!
//! ```
//! use r4_rig::{Error, Rig};
//!
//! let rig = Rig::new("sim:osmc-bench".parse()?);
//! let (driven, _) = rig.run(None, async |session| {
//!     let quarter = "90deg".parse().expect("an angle");
//!     session.move_to("osmc0".parse().expect("a channel"), quarter, 10.0).await
//! })?;
//! assert!(driven.held && driven.end.settled);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use r4_driver::{Error as DriverError, Motion, Until};
use r4_protocol::{ChannelId, ChannelInfo, ChannelKind, Mode, Sample, Setpoint, Unit};

use crate::{Error, Session, quantity::Quantity};

/// A channel does not accept the request; nothing was sent.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{channel} {why}")]
pub struct Unsuitable {
    /// Channel of the request.
    pub channel: ChannelId,
    /// Reason as the end of a sentence that begins with the channel's name.
    pub why: String,
}

/// A motor did not reach what was requested in time.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{channel} {how}")]
pub struct NotReached {
    /// Channel of the motor.
    pub channel: ChannelId,
    /// Behaviour of the motor, as the end of a sentence that begins with the channel's name.
    pub how: String,
}

/// Tolerance of a held duty: the bridge resolves 1/4096.
const DUTY_WITHIN: f64 = 0.001;
/// Tolerance of a held speed as a share of it, plus the resolution of a motor's sensor at low speed, rad/s and m/s.
const SPEED_WITHIN: f64 = 0.1;
const RAD_S_RESOLVED: f64 = 0.02;
const M_S_RESOLVED: f64 = 0.000_3;
/// Tolerance of a held value, rad, V or share: smaller than the resolution of the outputs' pulses and codes.
const VALUE_WITHIN: f64 = 0.001;
/// Telemetry period of a stepper before it steps, ms.
const LOOK_EVERY_MS: u16 = 10;

/// Result of a commanded motion.
#[derive(Clone, Debug)]
pub struct Driven {
    /// Description of the channel by the board.
    pub info: ChannelInfo,
    /// Mode of the set point.
    pub mode: Mode,
    /// Requested value, in the unit of the mode.
    pub set: Quantity,
    /// State of the motor in the last sample.
    pub end: Motion,
    /// True when the request was fulfilled at the end: the position at rest; the home found; the speed in its
    /// direction, within 10 % or the sensor's resolution; the duty within the bridge's resolution.
    pub held: bool,
}

/// Result of holding an output at one value for a time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct HeldOutput {
    /// Value that the output reported at the end, in `unit`; NaN for none.
    pub value: f64,
    /// Unit of the output.
    pub unit: Unit,
    /// True when the reported value was the requested one.
    pub held: bool,
}

/// Converts a quantity to a set point of a channel, and checks it against the channel's description.
///
/// # Errors
/// [`Unsuitable`] when the channel has no such mode, or accepts another unit or range.
pub fn setpoint(info: &ChannelInfo, mode: Mode, quantity: Quantity) -> Result<Setpoint, Unsuitable> {
    let unsuitable = |why| Unsuitable { channel: info.id, why };
    let Some(takes) = info.mode(mode) else {
        return Err(unsuitable(format!("cannot be commanded by {mode}: `r4 info` lists what it can take")));
    };
    if takes.unit != quantity.unit {
        let example = match takes.unit {
            Unit::Rad => "an angle, as in 90deg or 1.57rad",
            Unit::RadPerS => "a speed, as in 60deg/s, 1rad/s or 10rpm",
            Unit::M => "a length, as in 25mm or 0.025m",
            Unit::MPerS => "a speed, as in 5mm/s",
            Unit::Duty => "a share of the supply without a unit, as in 0.3 or 30%",
            Unit::V => "a voltage, as in 1.2V or 1200mV",
            Unit::N => "a force, as in 3N or 500mN",
            Unit::Bool | Unit::MPerS2 | Unit::A => "nothing that can be typed",
        };
        return Err(unsuitable(format!("takes as {mode} {example}")));
    }
    let setpoint = Setpoint { mode, value: quantity.value as f32 };
    if !takes.range.contains(setpoint.value) {
        let limit = |value: f32| quantity.like(value.into(), takes.unit);
        let (min, max) = (limit(takes.range.min), limit(takes.range.max));
        return Err(unsuitable(format!("takes a {mode} from {min} to {max}, not {quantity}")));
    }
    Ok(setpoint)
}

impl Session<'_> {
    /// Converts a quantity to a set point of a channel, and checks it against the channel's description.
    ///
    /// # Errors
    /// [`Error::Unsuitable`] when the channel does not accept it; [`Error::Board`] when the board has no such channel.
    pub fn setpoint(&self, channel: ChannelId, mode: Mode, quantity: Quantity) -> Result<Setpoint, Error> {
        Ok(setpoint(self.board.channel(channel)?, mode, quantity)?)
    }

    /// Arms, sends a motor or stepper to a position (rad or m), waits until it rests there, at most `timeout_s`, and
    /// disarms.
    ///
    /// # Errors
    /// The errors of [`Session::drive`].
    pub async fn move_to(&self, channel: ChannelId, position: Quantity, timeout_s: f64) -> Result<Driven, Error> {
        self.drive(channel, Mode::Position, position, Until::Settled { timeout_s }).await
    }

    /// Arms, moves a stepper by whole steps from its present position, waits until it rests, at most `timeout_s`, and
    /// disarms.
    ///
    /// # Errors
    /// [`Unsuitable`] for a channel that is no stepper; otherwise the errors of [`Session::drive`].
    pub async fn step(&self, channel: ChannelId, steps: i32, timeout_s: f64) -> Result<Driven, Error> {
        let board = self.board;
        let resolution = f64::from(board.channel(channel)?.resolution);
        if channel.kind != ChannelKind::Stepper {
            let why = "is no stepper: `r4 move` sends it to a position".to_owned();
            return Err(Unsuitable { channel, why }.into());
        }
        let mut telemetry = board.telemetry();
        board.subscribe(channel, LOOK_EVERY_MS).await?;
        let counts = loop {
            let frame = telemetry.next().await?;
            let position = frame.samples.iter().find_map(|sample| match *sample {
                Sample::Motor { channel: of, position, .. } if of == channel => Some(position),
                _ => None,
            });
            if let Some(position) = position {
                break position;
            }
        };
        // Computed from the counted position, so that rounding errors of repeated moves do not add up.
        let position = (f64::from(counts) + f64::from(steps)) * resolution;
        self.move_to(channel, Quantity::new(position, Unit::Rad), timeout_s).await
    }

    /// Arms, commands a motor or stepper, follows it until `until`, and disarms.
    ///
    /// # Errors
    /// [`Unsuitable`], before anything is sent, when the channel does not accept the command or does not report its
    /// motion; [`NotReached`] when it did not come to rest in time; the error of the board when it refuses, stops, does
    /// not arm or disarm, or of the link. A request that was merely not held is no error: see [`Driven::held`].
    pub async fn drive(&self, channel: ChannelId, mode: Mode, set: Quantity, until: Until) -> Result<Driven, Error> {
        let setpoint = self.setpoint(channel, mode, set)?;
        if let verb @ ("servo" | "bldc") = channel.kind.name() {
            let why = format!("does not report how it moves: command it with `r4 {verb}`");
            return Err(Unsuitable { channel, why }.into());
        }
        let info = self.board.channel(channel)?.clone();
        // The inner result is checked after the disarm: a failed disarm is reported before the motor's own error.
        let end = self.armed(async || Ok::<_, Error>(self.board.drive(channel, setpoint, until).await)).await?;
        let end = match end {
            Err(DriverError::NotSettled { position, after_s, .. }) => {
                let (position, board) = (set.like(position, info.unit), self.target().described());
                let how = format!("was not settled after {after_s:.1} s: at {position}, asked for {set}, on {board}");
                return Err(NotReached { channel, how }.into());
            }
            end => end?,
        };
        let held = has_held(&info, mode, set, &end);
        Ok(Driven { info, mode, set, end, held })
    }

    /// Arms, holds an output at one value for `seconds`, and disarms. `set` is a quantity for `mode`, or `None` for a
    /// mode without a value, such as a brake.
    ///
    /// # Errors
    /// [`Unsuitable`], before anything is sent, when the channel does not accept the request; the error of the board
    /// when it refuses, stops, does not arm or disarm, or of the link.
    pub async fn hold(
        &self,
        channel: ChannelId,
        mode: Mode,
        set: Option<Quantity>,
        seconds: f64,
    ) -> Result<HeldOutput, Error> {
        let info = self.board.channel(channel)?;
        let setpoint = match set {
            Some(set) => setpoint(info, mode, set)?,
            None if info.mode(mode).is_none() => {
                let why = format!("has no {mode}: `r4 info` lists what it can take");
                return Err(Unsuitable { channel, why }.into());
            }
            None => Setpoint { mode, value: 1.0 },
        };
        let hold = async || Ok::<_, Error>(self.board.hold(channel, setpoint, seconds).await?);
        let value = self.armed(hold).await?;
        // A brake reports a duty of 0.
        let asked = set.map_or(0.0, |set| set.value);
        Ok(HeldOutput { value, unit: info.unit, held: (value - asked).abs() <= VALUE_WITHIN })
    }
}

/// Returns true when a motion fulfilled its request.
fn has_held(info: &ChannelInfo, mode: Mode, set: Quantity, end: &Motion) -> bool {
    match mode {
        Mode::Position | Mode::Force => end.settled,
        Mode::Home => end.homed,
        Mode::Duty => (end.duty - set.value).abs() <= DUTY_WITHIN,
        _ => {
            let resolved = if info.unit == Unit::M { M_S_RESOLVED } else { RAD_S_RESOLVED };
            let within = SPEED_WITHIN * set.value.abs() + resolved;
            // A motor that stands does not hold even the lowest requested speed.
            let turns = set.value == 0.0 || end.speed * set.value > 0.0;
            turns && (end.speed - set.value).abs() <= within.min(set.value.abs().max(resolved))
        }
    }
}

#[cfg(test)]
mod tests {
    use r4_protocol::{ModeInfo, Range};

    use super::*;

    fn motor() -> ChannelInfo {
        let range = Range::new(-1.0, 1.0);
        let mode = |mode, unit| ModeInfo { mode, unit, range };
        ChannelInfo {
            id: ChannelId::new(ChannelKind::Osmc, 0),
            unit: Unit::Rad,
            range,
            rate_hz: 1000.0,
            resolution: 0.001,
            modes: [mode(Mode::Position, Unit::Rad), mode(Mode::Speed, Unit::RadPerS)].into_iter().collect(),
        }
    }

    #[test]
    fn what_a_channel_does_not_take_is_told_in_its_unit() {
        let info = motor();
        let refused =
            |mode, text: &str| setpoint(&info, mode, text.parse().expect("a quantity")).expect_err(text).to_string();
        assert_eq!(
            setpoint(&info, Mode::Position, "0.5rad".parse().expect("an angle")),
            Ok(Setpoint { mode: Mode::Position, value: 0.5 })
        );
        assert_eq!(refused(Mode::Duty, "0.5"), "osmc0 cannot be commanded by duty: `r4 info` lists what it can take");
        assert_eq!(refused(Mode::Position, "5mm"), "osmc0 takes as position an angle, as in 90deg or 1.57rad");
        assert_eq!(
            refused(Mode::Position, "1.1rad"),
            "osmc0 takes a position from -1.0000 rad to 1.0000 rad, not 1.1000 rad"
        );
    }

    #[test]
    fn a_slow_speed_is_not_held_by_a_motor_that_stands() {
        let info = motor();
        let held = |set, speed| {
            let end = Motion { position: 0.0, speed, duty: 0.0, settled: false, homed: false, after_s: 1.0 };
            has_held(&info, Mode::Speed, Quantity::new(set, Unit::RadPerS), &end)
        };
        assert!(held(1.0, 1.1) && !held(1.0, 1.13) && held(-1.0, -0.9) && !held(1.0, -1.0));
        assert!(held(0.0, 0.019) && !held(0.0, 0.021), "what the sensor resolves");
        assert!(held(0.01, 0.001) && !held(0.01, 0.0), "it turns, if not well");
    }
}
