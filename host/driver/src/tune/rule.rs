//! Design of gains from a motor's model or frequency response, with the resulting phase margin.

use std::f64::consts::PI;

use r4_protocol::config::{FeedForward, PidGains};

use super::{
    Loop, Model, Point,
    complex::{Complex, ONE},
    fit::Fit,
};

/// Reason why a rule gives no gains.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum RuleError {
    /// The motor lags more than a derivative can compensate.
    #[error("at {frequency_rad_s:.0} rad/s the motor lags {lag_deg:.0} deg: no loop has the phase margin there")]
    LagsTooMuch {
        /// Frequency of the oscillation, rad/s.
        frequency_rad_s: f64,
        /// Lag behind the duty, degrees.
        lag_deg: f64,
    },
    /// Even the slowest loop does not have the margin.
    #[error("no loop slower than {closed_s:.1} s leaves a phase margin of {margin_deg:.0} deg on what was found")]
    NoMargin {
        /// Time constant of the slowest loop tried, s.
        closed_s: f64,
        /// Required phase margin, degrees.
        margin_deg: f64,
    },
    /// One count of the sensor would change the duty too much.
    #[error(
        "the sensor is too coarse for this motor: its counts alone would be {duty:.2} of duty in a loop of {closed_s:.1} s, allowed are {allowed:.2}"
    )]
    TooCoarse {
        /// Duty caused by the counts, RMS, as a share of the supply voltage.
        duty: f64,
        /// Largest duty accepted, as a share of the supply voltage.
        allowed: f64,
        /// Time constant of the slowest loop tried, s.
        closed_s: f64,
    },
    /// A number is not finite, or a gain would be too high for the board.
    #[error("the rule gives no gains that a board takes: the experiment says too little of the motor")]
    NoGains,
}

/// Speed estimator of the board.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum SpeedEstimate {
    /// Differences of the position with a low-pass filter.
    LowPass {
        /// Time constant of the filter, s.
        time_s: f64,
    },
    /// Observer: a model of the motor corrected by the position, without lag as far as the model is right.
    Observer {
        /// Time constant of the correction, s.
        time_s: f64,
    },
}

/// Properties of the board that closes a motor's loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoopConditions {
    /// Control period of the loops, s.
    pub period_s: f64,
    /// Estimator that provides the speed.
    pub estimate: SpeedEstimate,
    /// One count of the sensor, rad or m.
    pub resolution: f64,
    /// Lowest and highest speed that the loop is designed for, rad/s or m/s.
    pub speeds: (f64, f64),
}

/// Gains of the loop that a motor follows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Gains {
    /// Position loop from the position error to the duty.
    Position(PidGains),
    /// Speed loop from the speed error to the duty.
    Speed(PidGains),
    /// Position loop around the speed loop.
    Cascade {
        /// Gains of the inner speed loop.
        speed: PidGains,
        /// Set point of the speed per position error, 1/s.
        per_s: f64,
    },
}

/// Gains with the margin and closed-loop time constant of their design.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Design {
    /// Gains of the selected loop.
    pub gains: Gains,
    /// Smallest phase margin on the model and all plausible ones, rad.
    pub margin_rad: f64,
    /// Time constant of the closed loop, s.
    pub closed_s: f64,
}

/// Ratio of the crossover frequency to the integral's corner: its lag at crossover is atan(1/6) = 9.5 degrees, which
/// the rule compensates.
const INTEGRAL_BELOW: f64 = 6.0;
/// Largest phase lead demanded from a derivative.
const MOST_LEAD_RAD: f64 = PI * 70.0 / 180.0;
/// Largest phase lag given to a motor that has more phase than required.
const MOST_LAG_RAD: f64 = PI * 60.0 / 180.0;
/// Delay of the loop in control periods: a result acts in the next period and is held there, half a period more.
const DELAY_PERIODS: f64 = 1.5;
/// Least ratio of the closed loop's time constant to the delay of everything around the motor. Our choice: other values
/// have not been tried.
const DELAYS: f64 = 2.0;
/// Largest duty caused by the counts of a sensor, RMS, as a share of the supply voltage. Our choice. With the noise
/// estimated several times too high, which equals a lower limit, 182 of 200 sampled position loops were good instead of
/// 195: slow loops stop badly over a dead zone.
const COUNT_DUTY: f64 = 0.06;
/// Factor by which the loop is slowed down until it meets its limits, and the time constant at which the search ends,
/// s.
const SLOWER: f64 = 1.1;
const SLOWEST_S: f64 = 5.0;
/// Time constant of the outer position loop in a cascade, in closed speed-loop time constants.
const CASCADE_SLOWER: f64 = 5.0;

impl SpeedEstimate {
    /// Frequency response from the speed to its estimate at `omega`, rad/s.
    ///
    /// The observer counts as having a tenth of its correction's lag: an assumption, because its model is never exact.
    fn at(self, omega: f64) -> Complex {
        let time_s = match self {
            Self::LowPass { time_s } => time_s,
            Self::Observer { time_s } => time_s / 10.0,
        };
        ONE / (ONE + Complex(0.0, omega * time_s))
    }

    /// Returns the equivalent delay of the estimate, s.
    fn delay_s(self) -> f64 {
        match self {
            Self::LowPass { time_s } => time_s,
            Self::Observer { time_s } => time_s / 10.0,
        }
    }

    fn time_s(self) -> f64 {
        let (Self::LowPass { time_s } | Self::Observer { time_s }) = self;
        time_s
    }
}

impl LoopConditions {
    /// Frequency response from the position to the duty of `gains` at `omega`, rad/s, without the negative sign of the
    /// feedback.
    fn controller(&self, gains: Gains, omega: f64) -> Complex {
        let s = Complex(0.0, omega);
        let estimate = self.estimate.at(omega);
        let low_pass = ONE / (ONE + s * self.estimate.time_s());
        let of = |gains: PidGains| [gains.kp, gains.ki, gains.kd].map(f64::from);
        match gains {
            Gains::Position(gains) => {
                let [kp, ki, kd] = of(gains);
                Complex(kp, 0.0) + Complex(ki, 0.0) / s + s * estimate * kd
            }
            Gains::Speed(gains) => {
                let [kp, ki, kd] = of(gains);
                (Complex(kp, 0.0) + Complex(ki, 0.0) / s + s * low_pass * kd) * s * estimate
            }
            Gains::Cascade { speed, per_s } => {
                let [kp, ki, kd] = of(speed);
                let proportional = Complex(kp, 0.0) + Complex(ki, 0.0) / s;
                proportional * (Complex(per_s, 0.0) + s * estimate) + s * s * estimate * low_pass * kd
            }
        }
    }

    /// Phase margin of `gains` on `model`, rad; the lowest of several crossovers; `None` where the open loop's gain
    /// never falls through 1. The delay of the loop is a period and a half.
    #[must_use]
    pub fn phase_margin(&self, model: &Model, gains: Gains) -> Option<f64> {
        /// Number of frequency steps from 0.01 to 10⁴ rad/s; the crossover is interpolated between two of them.
        const STEPS: u32 = 600;
        let delay_s = model.delay_s + DELAY_PERIODS * self.period_s;
        let open = |omega: f64| {
            let s = Complex(0.0, omega);
            let motor = Complex(model.gain, 0.0) / (s * (ONE + s * model.lag_s));
            let open = motor * self.controller(gains, omega);
            // The angle is unwrapped to be continuous from -π on: at lower phases the gain of such a loop is far below
            // 1.
            let angle = open.angle();
            let angle = if angle > PI / 2.0 { angle - 2.0 * PI } else { angle };
            (open.size().ln(), angle - omega * delay_s)
        };
        let frequency = |step: u32| 0.01 * 10_f64.powf(6.0 * f64::from(step) / f64::from(STEPS));
        let mut lowest: Option<f64> = None;
        let mut before = open(frequency(0));
        for step in 1..=STEPS {
            let after = open(frequency(step));
            if before.0 >= 0.0 && after.0 < 0.0 {
                let share = before.0 / (before.0 - after.0);
                let margin = PI + before.1 + share * (after.1 - before.1);
                lowest = Some(lowest.map_or(margin, |known| known.min(margin)));
            }
            before = after;
        }
        lowest
    }

    /// RMS duty caused by the counts of the sensor, as a share of the supply voltage.
    ///
    /// The error of a position is evenly distributed over one count; where counts are rarer than periods, over the
    /// travel in one period. The speed is the difference of such positions, over the estimator's filter or from one
    /// count to the next.
    fn count_duty(&self, gains: Gains) -> f64 {
        let of = |gains: PidGains| [gains.kp, gains.kd].map(f64::from);
        let speed = self.speeds.1;
        let between_s = (self.resolution / speed.max(f64::MIN_POSITIVE)).max(self.period_s);
        let even = 1.0 / 12.0_f64.sqrt();
        let wrong = even * self.resolution.min(speed * self.period_s) / self.estimate.time_s().max(between_s);
        let place = even * self.resolution;
        match gains {
            Gains::Position(gains) => {
                let [kp, kd] = of(gains);
                kp * place + kd * wrong
            }
            Gains::Speed(gains) => of(gains)[0] * wrong,
            Gains::Cascade { speed, per_s } => of(speed)[0] * (wrong + per_s * place),
        }
    }

    /// Returns the delay of everything around the motor in its loop, s: the board's, the speed estimate's, and for a
    /// speed loop half the time between two counts.
    fn delay_s(&self, of: Loop) -> f64 {
        let between_counts_s = self.resolution / self.speeds.0.max(f64::MIN_POSITIVE);
        let of_counts_s = if of == Loop::Speed { between_counts_s / 2.0 } else { 0.0 };
        DELAY_PERIODS * self.period_s + self.estimate.delay_s() + of_counts_s
    }

    /// Designs gains by SIMC. Without `closed_s`, takes the fastest closed loop that keeps the margin on every
    /// plausible model and whose duty stays below the limit for counts, slowed down by the factor `slower`.
    ///
    /// # Errors
    /// [`RuleError`] names the limit that no loop meets.
    pub fn design(
        &self,
        of: Loop,
        fit: &Fit,
        margin_rad: f64,
        closed_s: Option<f64>,
        slower: f64,
    ) -> Result<Design, RuleError> {
        let margin = |gains| {
            let all = std::iter::once(&fit.model).chain(&fit.plausible);
            all.map(|model| self.phase_margin(model, gains)).reduce(|a, b| a.zip(b).map(|(a, b)| a.min(b))).flatten()
        };
        let model = &fit.model;
        let design = |closed_s: f64| -> Result<Design, RuleError> {
            let gains = match of {
                Loop::Position => Gains::Position(position_for(model, closed_s)?),
                Loop::Speed => Gains::Speed(speed_for(model, closed_s)?),
                Loop::Cascade => {
                    let per_s = 1.0 / (CASCADE_SLOWER * closed_s);
                    Gains::Cascade { speed: inner_for(model, closed_s)?, per_s }
                }
            };
            Ok(Design { gains, margin_rad: margin(gains).unwrap_or(0.0), closed_s })
        };
        if let Some(closed_s) = closed_s {
            return design(closed_s);
        }
        let delay_s = model.delay_s + self.delay_s(of);
        let mut closed_s = (1.0 + DELAYS) * delay_s;
        loop {
            let found = design(closed_s)?;
            let duty = self.count_duty(found.gains);
            if found.margin_rad >= margin_rad && duty <= COUNT_DUTY {
                return if slower == 1.0 { Ok(found) } else { design(closed_s * slower) };
            }
            closed_s *= SLOWER;
            if closed_s > SLOWEST_S {
                return Err(if found.margin_rad >= margin_rad {
                    RuleError::TooCoarse { duty, allowed: COUNT_DUTY, closed_s }
                } else {
                    RuleError::NoMargin { closed_s, margin_deg: margin_rad.to_degrees() }
                });
            }
        }
    }
}

/// Share of the identified friction in the feed-forward: with more than all of it a motor would not come to rest.
const OF_FRICTION: f64 = 0.9;

/// Designs the feed-forward: friction, and duty for speed and acceleration of the path.
///
/// Friction is nine tenths of the mean of both directions; their difference is a load, which the integral compensates.
#[must_use]
pub fn feed_forward(fit: &Fit, duty_max: f64) -> FeedForward {
    let Model { gain, lag_s, .. } = fit.model;
    FeedForward {
        static_duty: (OF_FRICTION * fit.friction.mean()).clamp(0.0, 0.9 * duty_max) as f32,
        duty_per_speed: (1.0 / gain) as f32,
        duty_per_acceleration: (lag_s / gain) as f32,
    }
}

fn gains(kp: f64, ki: f64, kd: f64) -> Result<PidGains, RuleError> {
    let gains = PidGains { kp: kp as f32, ki: ki as f32, kd: kd as f32 };
    if gains.is_valid() && gains.kp > 0.0 { Ok(gains) } else { Err(RuleError::NoGains) }
}

/// Designs a position loop whose open loop passes through `point` with gain 1 and phase margin `phase_margin_rad`, the
/// specification of Åström and Hägglund. The integral's corner is at a sixth of that frequency; the lag of the rate's
/// filter, `filter_s`, and the loop's delay of a period and a half are compensated. A motor with more phase than that
/// gets no derivative, and has a larger margin.
///
/// # Errors
/// [`RuleError::LagsTooMuch`] or [`RuleError::NoGains`].
pub fn position_through(
    point: Point,
    phase_margin_rad: f64,
    filter_s: f64,
    period_s: f64,
) -> Result<PidGains, RuleError> {
    let Point { frequency_rad_s: omega, gain, phase_rad } = point;
    let phase_rad = phase_rad - omega * DELAY_PERIODS * period_s;
    let lead = phase_margin_rad - PI - phase_rad;
    let filter = omega * filter_s;
    let (sin, cos) = lead.max(-MOST_LAG_RAD).sin_cos();
    let ultimate = 1.0 / gain;
    // Real and imaginary part of the controller: kp + x filter = ultimate cos, x - kp / below = ultimate sin, with x =
    // kd omega / (1 + filter²).
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

impl Point {
    /// Returns the integrator with a delay that has this point as its speed response. A real motor has more phase below
    /// that frequency, so margins on this model are conservative.
    #[must_use]
    pub fn integrator(&self) -> Model {
        /// Time constant so long that its corner is far below all relevant frequencies, s.
        const LAG_S: f64 = 1e3;
        let delay_s = ((-self.phase_rad - PI / 2.0) / self.frequency_rad_s).max(0.0);
        Model { gain: self.gain * self.frequency_rad_s * LAG_S, lag_s: LAG_S, delay_s }
    }

    /// Converts a point of the position response to one of the speed response.
    #[must_use]
    pub fn of_speed(&self) -> Self {
        Self { gain: self.gain * self.frequency_rad_s, phase_rad: self.phase_rad + PI / 2.0, ..*self }
    }
}

/// Designs a position loop for `model` by SIMC; `closed_s` is the closed loop's time constant plus the delay, s.
///
/// # Errors
/// [`RuleError::NoGains`] for a gain that is not finite or too high.
pub fn position_for(model: &Model, closed_s: f64) -> Result<PidGains, RuleError> {
    let (kc, integral_s) = (1.0 / (model.gain * closed_s), 4.0 * closed_s);
    // The rule is in series form, the board's loop in parallel form.
    gains(kc * (1.0 + model.lag_s / integral_s), kc / integral_s, kc * model.lag_s)
}

/// Designs a speed loop for `model` by SIMC; `closed_s` is the closed loop's time constant plus the delay, s.
///
/// # Errors
/// [`RuleError::NoGains`] for a gain that is not finite or too high.
pub fn speed_for(model: &Model, closed_s: f64) -> Result<PidGains, RuleError> {
    let kp = model.lag_s / (model.gain * closed_s);
    gains(kp, kp / model.lag_s.min(4.0 * closed_s), 0.0)
}

/// Designs the speed loop of a cascade: as [`speed_for`], with an integral half as fast where that is slower than the
/// motor's lag, since the position is an integral already. On the sampled motors 1 to 200, as many cascades are good
/// with either.
fn inner_for(model: &Model, closed_s: f64) -> Result<PidGains, RuleError> {
    let kp = model.lag_s / (model.gain * closed_s);
    gains(kp, kp / model.lag_s.min(8.0 * closed_s), 0.0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tune::Friction;

    const MARGIN_RAD: f64 = PI / 3.0;

    fn point(model: &Model, omega: f64) -> Point {
        let lag = omega * model.lag_s;
        Point {
            frequency_rad_s: omega,
            gain: model.gain / (lag.hypot(1.0) * omega),
            phase_rad: -PI / 2.0 - lag.atan() - omega * model.delay_s,
        }
    }

    fn around(filter_s: f64) -> LoopConditions {
        let estimate = SpeedEstimate::LowPass { time_s: filter_s };
        LoopConditions { period_s: 1e-3, estimate, resolution: 1e-4, speeds: (1.0, 2.0) }
    }

    /// Board without delay, filter and counts.
    const BARE: LoopConditions = LoopConditions {
        period_s: 0.0,
        estimate: SpeedEstimate::LowPass { time_s: 0.0 },
        resolution: 0.0,
        speeds: (1.0, 2.0),
    };

    fn fit(model: Model) -> Fit {
        let friction = Friction { up: 0.12, down: 0.08 };
        Fit { model, friction, residual: 0.0, residual_rms: 0.0, plausible: Vec::new() }
    }

    #[test]
    fn a_loop_through_a_point_has_the_margin_it_says() {
        for (lag_s, delay_s, omega, filter_s) in
            [(0.07, 0.003, 20.0, 0.01), (0.021, 0.003, 40.0, 0.01), (0.07, 0.003, 30.0, 0.0), (0.1, 0.005, 10.0, 0.03)]
        {
            let model = Model { gain: 6.0, lag_s, delay_s };
            let gains = position_through(point(&model, omega), MARGIN_RAD, filter_s, 1e-3).expect("gains");
            let margin = around(filter_s).phase_margin(&model, Gains::Position(gains)).expect("it crosses");
            // A frequency step is 2.3 %; the crossover is interpolated within it.
            assert!((margin - MARGIN_RAD).abs() < 0.01, "{gains:?}: {} deg", margin.to_degrees());
        }
    }

    #[test]
    fn a_motor_with_phase_to_spare_needs_no_derivative() {
        let model = Model { gain: 6.0, lag_s: 0.001, delay_s: 0.002 };
        let gains = position_through(point(&model, 20.0), MARGIN_RAD, 0.01, 1e-3).expect("gains");
        assert_eq!(gains.kd, 0.0);
        assert!(around(0.01).phase_margin(&model, Gains::Position(gains)).expect("it crosses") > MARGIN_RAD);
        let slow = Point { frequency_rad_s: 30.0, gain: 0.01, phase_rad: -PI * 1.3 };
        assert!(matches!(position_through(slow, MARGIN_RAD, 0.01, 1e-3), Err(RuleError::LagsTooMuch { .. })));
    }

    #[test]
    fn simc_has_its_known_margins() {
        let margin_deg =
            |model: &Model, gains| BARE.phase_margin(model, gains).expect("it crosses the gain of 1").to_degrees();
        // With a closed-loop time constant equal to the delay: 90° - 1/2 rad = 61.4° where the integral cancels the
        // lag.
        let lag = Model { gain: 9.0, lag_s: 0.02, delay_s: 0.01 };
        let margin = margin_deg(&lag, Gains::Speed(speed_for(&lag, 0.02).expect("gains")));
        assert!((margin - 61.4).abs() < 0.3, "{margin}");
        // 46.9° on an integrator with a delay (Skogestad 2003, table 1).
        let swing = Point { frequency_rad_s: 30.0, gain: 90.0 / 30.0, phase_rad: -PI / 2.0 - 0.3 };
        let slow = swing.integrator();
        assert!((slow.delay_s - 0.01).abs() < 1e-12, "{slow:?}");
        let margin = margin_deg(&slow, Gains::Speed(speed_for(&slow, 0.02).expect("gains")));
        assert!((margin - 46.9).abs() < 0.3, "{margin}");
        let position = Model { gain: 9.0, lag_s: 0.07, delay_s: 0.01 };
        let margin = margin_deg(&position, Gains::Position(position_for(&position, 0.02).expect("gains")));
        assert!((margin - 46.9).abs() < 0.3, "{margin}");
    }

    /// A cascade whose integral cancels the lag is an integrator with the integral of SIMC, `(s + per_s) / (closed_s
    /// s²)`.
    #[test]
    fn a_cascade_is_the_same_loop_in_other_numbers() {
        let model = Model { gain: 9.0, lag_s: 0.02, delay_s: 0.01 };
        let (closed_s, per_s) = (0.04, 6.25);
        let cascade = Gains::Cascade { speed: speed_for(&model, closed_s).expect("gains"), per_s };
        let margin = BARE.phase_margin(&model, cascade).expect("it crosses");
        // Crossover |L| = 1 at omega: omega² = (omega² + per_s²)^(1/2) / closed_s.
        let omega = (0.5 * (625.0 + (625.0_f64.powi(2) + 4.0 * 625.0 * per_s * per_s).sqrt())).sqrt();
        let expected = (omega / per_s).atan() - omega * 0.01;
        assert!((margin - expected).abs() < 5e-3, "{margin} {expected}");
    }

    #[test]
    fn every_design_keeps_its_margin_on_all_that_is_plausible() {
        for model in [
            Model { gain: 9.0, lag_s: 0.02, delay_s: 0.004 },
            Model { gain: 0.2, lag_s: 0.1, delay_s: 0.0 },
            Model { gain: 40.0, lag_s: 0.3, delay_s: 0.002 },
        ] {
            let other = Model { lag_s: 1.5 * model.lag_s, delay_s: model.delay_s + 0.004, ..model };
            let fit = Fit { plausible: vec![other], ..fit(model) };
            let scale = model.gain / 9.0;
            for estimate in [SpeedEstimate::LowPass { time_s: 0.01 }, SpeedEstimate::Observer { time_s: 0.01 }] {
                let board =
                    LoopConditions { estimate, resolution: 1e-4 * scale, speeds: (scale, 2.0 * scale), ..around(0.0) };
                for of in [Loop::Position, Loop::Speed, Loop::Cascade] {
                    let design = board.design(of, &fit, MARGIN_RAD, None, 1.0).expect("a design");
                    for model in [&model, &other] {
                        let margin = board.phase_margin(model, design.gains).expect("it crosses");
                        assert!(margin >= MARGIN_RAD && design.margin_rad >= MARGIN_RAD, "{of:?} {design:?} {margin}");
                    }
                    let slower = board.design(of, &fit, MARGIN_RAD, None, 2.0).expect("a design");
                    assert!((slower.closed_s / design.closed_s - 2.0).abs() < 1e-9);
                    // A board with less delay does not get a slower loop.
                    let free = LoopConditions { period_s: 1e-5, ..board };
                    assert!(
                        free.design(of, &fit, MARGIN_RAD, None, 1.0).expect("a design").closed_s <= design.closed_s
                    );
                }
            }
        }
    }

    #[test]
    fn a_coarse_sensor_slows_the_loop_down_until_none_is_left() {
        let fit = fit(Model { gain: 9.0, lag_s: 0.1, delay_s: 0.003 });
        let design = |resolution| {
            let board = LoopConditions { resolution, ..around(0.01) };
            board.design(Loop::Position, &fit, MARGIN_RAD, None, 1.0)
        };
        let (fine, coarse) = (design(1e-4).expect("a design"), design(0.2).expect("a design"));
        assert!(coarse.closed_s > 1.5 * fine.closed_s, "{fine:?} {coarse:?}");
        assert!(matches!(design(10.0), Err(RuleError::TooCoarse { .. })));
        let late = Fit { plausible: vec![Model { delay_s: 4.0, ..fit.model }], ..fit.clone() };
        assert!(matches!(
            around(0.01).design(Loop::Speed, &late, MARGIN_RAD, None, 1.0),
            Err(RuleError::NoMargin { .. })
        ));
        let none = Fit { model: Model { gain: f64::MIN_POSITIVE, ..fit.model }, ..fit.clone() };
        assert_eq!(around(0.01).design(Loop::Speed, &none, MARGIN_RAD, None, 1.0), Err(RuleError::NoGains));
    }

    #[test]
    fn a_feed_forward_holds_the_model_on_its_path() {
        let fit = fit(Model { gain: 8.0, lag_s: 0.25, delay_s: 0.003 });
        let FeedForward { static_duty, duty_per_speed, duty_per_acceleration } = feed_forward(&fit, 0.9);
        assert_eq!((duty_per_speed, duty_per_acceleration), (0.125, 0.03125));
        assert!((static_duty - 0.09).abs() < 1e-6);
    }
}
