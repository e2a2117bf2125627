//! Calibration of the oscillator of the servos' pulses.

use r4_protocol::{ChannelId, ChannelKind, Mode, Parameter, Setpoint};

use super::{CalibrateError, Change, Found, Person};
use crate::{Error, Session, parameters::Parameters};

/// Number of steps in a PWM cycle (PCA9685 datasheet, 7.3.3).
const STEPS: f64 = 4096.0;
/// Time for a servo to arrive, s.
const MOVE_S: f64 = 2.0;
/// Largest deviation of an oscillator, as a share; more is a wrong measurement.
const MOST_OFF: f64 = 0.2;

/// Measurement by a person.
enum Measured {
    /// Length of a pulse, s.
    Pulse(f64),
    Hz(f64),
}

/// Calibrates the oscillator from a measured pulse length or pulse frequency.
pub(crate) async fn oscillator(
    session: &Session<'_>,
    person: &mut impl Person,
    channel: ChannelId,
) -> Result<Found, Error> {
    let board = session.board;
    let info = board.channel(channel)?;
    if channel.kind != ChannelKind::Servo {
        return Err(CalibrateError::Unfit { channel, why: "is no servo" }.into());
    }
    let parameters = Parameters::of(board).await?;
    let oscillator = parameters.get(None, Parameter::ServoOscillatorHz).ok_or(CalibrateError::NoServoChip)?;
    let of = |parameter| parameters.need(channel, parameter, "is no servo").map(|info| f64::from(info.active));
    let (pulse_s, angle) = (of(Parameter::PulseHigh)?, of(Parameter::AngleHigh)?);
    let assumed_hz = f64::from(oscillator.active);
    // Datasheet, 7.3.5. The firmware computes the prescaler from the assumed frequency, whatever the oscillator really
    // does.
    let prescale = (assumed_hz / (STEPS * f64::from(info.rate_hz))).round();
    let step_s = prescale / assumed_hz;
    let steps = (pulse_s / step_s).round();
    let setpoint = Setpoint { mode: Mode::Position, value: angle as f32 };
    let measured = session
        .armed(async || {
            board.hold(channel, setpoint, MOVE_S).await?;
            let question = format!(
                "{channel} gets pulses that should be {:.1} us long, {:.2} times a second. What do you measure, as in \
                 1985us or 50.8Hz?",
                steps * step_s * 1e6,
                1.0 / (STEPS * step_s)
            );
            Ok::<_, Error>(read(&person.ask(session, &question).await?)?)
        })
        .await?;
    let true_hz = match measured {
        Measured::Pulse(seconds) => steps * prescale / seconds,
        Measured::Hz(hz) => STEPS * prescale * hz,
    };
    let off = true_hz / assumed_hz - 1.0;
    if off.is_nan() || off.abs() > MOST_OFF {
        return Err(CalibrateError::OscillatorFarOff { true_hz, off }.into());
    }
    let note = format!("the oscillator runs at {:.3} MHz, {:+.2} % from what was assumed", true_hz * 1e-6, off * 100.0);
    Ok(Found { changes: vec![Change::new(oscillator, true_hz.round())], toml: None, note })
}

fn read(answer: &str) -> Result<Measured, CalibrateError> {
    let number = |text: &str| text.trim().parse::<f64>().ok().filter(|value| value.is_finite() && *value > 0.0);
    let measured = if let Some(text) = answer.strip_suffix("us") {
        number(text).map(|us| Measured::Pulse(us * 1e-6))
    } else if let Some(text) = answer.strip_suffix("ms") {
        number(text).map(|ms| Measured::Pulse(ms * 1e-3))
    } else {
        answer.strip_suffix("Hz").and_then(number).map(Measured::Hz)
    };
    measured.ok_or_else(|| CalibrateError::WrongAnswer {
        answer: answer.to_owned(),
        why: "write it as in 1985us, 1.985ms or 50.8Hz".to_owned(),
    })
}
