//! Gains from what is known of a motor.
//!
//! A board's loop is `kp e + ki ∫e - kd v`, where `v` is the measured rate behind a low-pass of `filter_s`.

use std::f64::consts::PI;

use r4_protocol::config::PidGains;

use super::{Loop, Model, Point};

/// Why there are no gains by a rule.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RuleError {
    /// No derivative could make up for the lag.
    #[error("at {frequency_rad_s:.0} rad/s the motor lags {lag_deg:.0} deg: no loop has the phase margin there")]
    LagsTooMuch {
        /// Of the swing.
        frequency_rad_s: f64,
        /// Behind the duty.
        lag_deg: f64,
    },
    /// A number is not finite, or a gain would be too high for the board.
    #[error("the rule gives no gains that a board takes: the experiment says too little of the motor")]
    NoGains,
}

/// The corner of the integral is so far below the crossing: it costs there atan(1/6) = 9.5 degrees, which the rule makes up for.
const INTEGRAL_BELOW: f64 = 6.0;
/// The most lead a derivative is asked for.
const MOST_LEAD_RAD: f64 = PI * 70.0 / 180.0;
/// A motor with more phase than it needs is not given more lag than this.
const MOST_LAG_RAD: f64 = PI * 60.0 / 180.0;

fn gains(kp: f64, ki: f64, kd: f64) -> Result<PidGains, RuleError> {
    let gains = PidGains { kp: kp as f32, ki: ki as f32, kd: kd as f32 };
    if gains.is_valid() && gains.kp > 0.0 { Ok(gains) } else { Err(RuleError::NoGains) }
}

/// Gains of a position loop whose open loop goes through `point` with gain 1 and `phase_margin_rad` left, which is the
/// specification of Åström and Hägglund. The integral's corner is at a sixth of that frequency; the rate's filter of
/// `filter_s` is made up for. A motor with more phase than that gets no derivative, and has more margin.
///
/// # Errors
/// [`RuleError`].
pub fn position_through(point: Point, phase_margin_rad: f64, filter_s: f64) -> Result<PidGains, RuleError> {
    let Point { frequency_rad_s: omega, gain, phase_rad } = point;
    let lead = phase_margin_rad - PI - phase_rad;
    let filter = omega * filter_s;
    let (sin, cos) = lead.max(-MOST_LAG_RAD).sin_cos();
    let ultimate = 1.0 / gain;
    // kp + x filter = ultimate cos, x - kp / below = ultimate sin, of which x = kd omega / (1 + filter²).
    let kp = ultimate * (cos - filter * sin) / (1.0 + filter / INTEGRAL_BELOW);
    let x = ultimate * sin + kp / INTEGRAL_BELOW;
    if lead > MOST_LEAD_RAD || kp <= 0.0 {
        return Err(RuleError::LagsTooMuch { frequency_rad_s: omega, lag_deg: -phase_rad.to_degrees() });
    }
    if x >= 0.0 {
        return gains(kp, kp * omega / INTEGRAL_BELOW, x * (1.0 + filter * filter) / omega);
    }
    let kp = ultimate * cos;
    gains(kp, (kp / INTEGRAL_BELOW).min(-ultimate * sin) * omega, 0.0)
}

/// Gains of a speed loop for a motor that at `point`'s frequency is an integrator with a delay, by SIMC with a time
/// constant of that delay: phase margin 47 degrees, and more by what the motor is slower an integrator below that frequency.
/// The delay is taken for `least_delay_s` where the point shows less.
///
/// # Errors
/// [`RuleError::NoGains`].
pub fn speed_through(point: Point, least_delay_s: f64) -> Result<PidGains, RuleError> {
    let Point { frequency_rad_s: omega, gain, phase_rad } = point;
    let delay_s = ((-phase_rad - PI / 2.0) / omega).max(least_delay_s);
    let closed_s = 2.0 * delay_s;
    let kp = 1.0 / (gain * omega * closed_s);
    gains(kp, kp / (4.0 * closed_s), 0.0)
}

/// Gains of a position loop for `model` by SIMC, the closed loop's time constant being `time_constant_s`, or as long as the
/// delay. What filters the rate counts as delay too.
///
/// # Errors
/// [`RuleError::NoGains`].
pub fn position_for(model: &Model, time_constant_s: Option<f64>, filter_s: f64) -> Result<PidGains, RuleError> {
    let delay_s = model.delay_s + filter_s;
    let closed_s = time_constant_s.unwrap_or(delay_s) + delay_s;
    let (kc, integral_s) = (1.0 / (model.gain * closed_s), 4.0 * closed_s);
    // From the series form of the rule to the parallel one of the board.
    gains(kc * (1.0 + model.lag_s / integral_s), kc / integral_s, kc * model.lag_s)
}

/// Gains of a speed loop for `model` by SIMC, the closed loop's time constant being `time_constant_s`, or as long as the delay,
/// in which the filter of the measured speed is seen already.
///
/// # Errors
/// [`RuleError::NoGains`].
pub fn speed_for(model: &Model, time_constant_s: Option<f64>) -> Result<PidGains, RuleError> {
    let closed_s = time_constant_s.unwrap_or(model.delay_s) + model.delay_s;
    let kp = model.lag_s / (model.gain * closed_s);
    gains(kp, kp / model.lag_s.min(4.0 * closed_s), 0.0)
}

/// Phase margin of `gains` on `model`, rad; `None` where the open loop's gain never falls through 1. The lowest, where it does
/// so several times.
#[must_use]
pub fn phase_margin(model: &Model, gains: PidGains, filter_s: f64) -> Option<f64> {
    /// Steps of the frequency from 0.01 to 10⁴ rad/s.
    const STEPS: u32 = 6000;
    let [kp, ki, kd] = [gains.kp, gains.ki, gains.kd].map(f64::from);
    let open = |omega: f64| {
        // kp - j ki/omega + kd j omega / (1 + j omega filter)
        let filter = omega * filter_s;
        let derivative = kd * omega / (1.0 + filter * filter);
        let (real, imaginary) = (kp + derivative * filter, derivative - ki / omega);
        let lag = omega * model.lag_s;
        let integrator = if model.of == Loop::Position { (omega, PI / 2.0) } else { (1.0, 0.0) };
        let gain = real.hypot(imaginary) * model.gain / (lag.hypot(1.0) * integrator.0);
        (gain, imaginary.atan2(real) - lag.atan() - integrator.1 - omega * model.delay_s)
    };
    let frequency = |step: u32| 0.01 * 10_f64.powf(6.0 * f64::from(step) / f64::from(STEPS));
    let mut lowest: Option<f64> = None;
    for step in 1..=STEPS {
        let (before, after) = (open(frequency(step - 1)), open(frequency(step)));
        if before.0 >= 1.0 && after.0 < 1.0 {
            lowest = Some(lowest.map_or(f64::MAX, |known| known).min(PI + after.1));
        }
    }
    lowest
}

#[cfg(test)]
mod tests {
    use super::*;

    const MARGIN_RAD: f64 = PI / 3.0;

    fn point(model: &Model, omega: f64) -> Point {
        let lag = omega * model.lag_s;
        Point {
            frequency_rad_s: omega,
            gain: model.gain / (lag.hypot(1.0) * omega),
            phase_rad: -PI / 2.0 - lag.atan() - omega * model.delay_s,
        }
    }

    #[test]
    fn a_loop_through_a_point_has_the_margin_it_says() {
        for (lag_s, delay_s, omega, filter_s) in
            [(0.07, 0.003, 20.0, 0.01), (0.021, 0.003, 40.0, 0.01), (0.07, 0.003, 30.0, 0.0), (0.1, 0.005, 10.0, 0.03)]
        {
            let model = Model { of: Loop::Position, gain: 6.0, lag_s, delay_s };
            let gains = position_through(point(&model, omega), MARGIN_RAD, filter_s).expect("gains");
            let margin = phase_margin(&model, gains, filter_s).expect("it crosses");
            // A step of the frequency is 0.23 %.
            assert!((margin - MARGIN_RAD).abs() < 0.01, "{gains:?}: {} deg", margin.to_degrees());
        }
    }

    #[test]
    fn a_motor_with_phase_to_spare_needs_no_derivative() {
        let model = Model { of: Loop::Position, gain: 6.0, lag_s: 0.001, delay_s: 0.002 };
        let gains = position_through(point(&model, 20.0), MARGIN_RAD, 0.01).expect("gains");
        assert_eq!(gains.kd, 0.0);
        assert!(phase_margin(&model, gains, 0.01).expect("it crosses") > MARGIN_RAD);
        let slow = Point { frequency_rad_s: 30.0, gain: 0.01, phase_rad: -PI * 1.3 };
        assert!(matches!(position_through(slow, MARGIN_RAD, 0.01), Err(RuleError::LagsTooMuch { .. })));
        assert_eq!(speed_through(Point { gain: 0.0, ..slow }, 0.01), Err(RuleError::NoGains));
    }

    #[test]
    fn simc_has_its_known_margins() {
        // With the time constant of the delay: 90° - 1/2 rad = 61.4° where the integral cancels the lag.
        let lag = Model { of: Loop::Speed, gain: 9.0, lag_s: 0.02, delay_s: 0.01 };
        let margin = phase_margin(&lag, speed_for(&lag, None).expect("gains"), 0.0).expect("it crosses");
        assert!((margin.to_degrees() - 61.4).abs() < 0.3, "{}", margin.to_degrees());
        // 46.9° on an integrator with a delay (Skogestad 2003, table 1).
        let integrator = Point { frequency_rad_s: 30.0, gain: 90.0 / 30.0, phase_rad: -PI / 2.0 - 0.3 };
        let slow = Model { of: Loop::Speed, gain: 90.0 * 1e4, lag_s: 1e4, delay_s: 0.01 };
        let margin = phase_margin(&slow, speed_through(integrator, 0.0).expect("gains"), 0.0).expect("it crosses");
        assert!((margin.to_degrees() - 46.9).abs() < 0.3, "{}", margin.to_degrees());
        let position = Model { of: Loop::Position, gain: 9.0, lag_s: 0.07, delay_s: 0.01 };
        let margin = phase_margin(&position, position_for(&position, None, 0.0).expect("gains"), 0.0).expect("crosses");
        assert!((margin.to_degrees() - 46.9).abs() < 0.3, "{}", margin.to_degrees());
    }

    #[test]
    fn a_longer_time_constant_is_more_cautious() {
        let model = Model { of: Loop::Position, gain: 9.0, lag_s: 0.07, delay_s: 0.005 };
        let of = |time_constant_s| {
            let gains = position_for(&model, Some(time_constant_s), 0.01).expect("gains");
            (gains.kp, phase_margin(&model, gains, 0.01).expect("it crosses"))
        };
        let (fast, slow) = (of(0.02), of(0.1));
        assert!(fast.0 > slow.0 && fast.1 < slow.1, "{fast:?} {slow:?}");
    }
}
