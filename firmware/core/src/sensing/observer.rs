//! Speed observer: speed of a shaft from its position and a model of its motor.

use crate::within::Within;

/// Position, speed and unmodelled acceleration of a shaft: a third-order Luenberger observer with three equal poles.
///
/// The input is the acceleration that a model expects ([`Observer::predict`]); measured positions correct the state
/// ([`Observer::count`], [`Observer::measure`]). Acceleration that the model does not explain becomes the disturbance,
/// so a wrong model leaves no error of the speed at constant speed. Without an acceleration this is the fading-memory
/// polynomial filter of second degree; with a model its delay is that of the model alone.
///
/// The position of an encoder is known best at the moment at which its count changes: only then does a count correct
/// the state, with the gains for the time since the last one. Between counts the position stays within the count. This
/// avoids the ripple at low speed, where a filter of differences shows each count.
///
/// Gains: α = 1 − z³, β = 1.5 (1 − z)² (1 + z) / h, γ = (1 − z)³ / h², with the pole z = exp(−h/τ) and the time h since
/// the last correction (E. Brookner, *Tracking and Kalman Filtering Made Easy*, Wiley 1998, section 1.3, critically
/// damped g-h-k filter).
#[derive(Clone, Copy, Debug)]
pub struct Observer {
    period_s: f32,
    /// Pole z for one control period.
    pole: f32,
    /// Factor on the gain γ.
    gamma: f32,
    /// Position, rad or m; for an encoder above the lower edge of the count, rad.
    position: f32,
    /// Estimated speed, rad/s or m/s.
    speed: f32,
    /// Unmodelled acceleration, rad/s² or m/s².
    disturbance: f32,
}

impl Observer {
    /// Creates an observer at rest, stepped every `period_s`, with three poles of the time constant `time_constant_s`,
    /// for a model whose own speed settles with `motor_s`.
    #[must_use]
    pub fn new(time_constant_s: f32, motor_s: f32, period_s: f32) -> Self {
        // With less than two periods, noise would not be filtered at all.
        let time_constant_s = time_constant_s.max(2.0 * period_s);
        let pole = libm::expf(-period_s / time_constant_s);
        // A fast motor's own damping pulls the speed towards the model's: without this factor the slowest pole would
        // fall to 1 / (1 + τ/T) of the others.
        let gamma = 1.0 + time_constant_s / motor_s;
        Self { period_s, pole, gamma, position: 0.0, speed: 0.0, disturbance: 0.0 }
    }

    /// Estimated speed, rad/s or m/s.
    #[must_use]
    pub fn speed(&self) -> f32 {
        self.speed
    }

    /// Acceleration that the model does not explain, rad/s² or m/s².
    #[must_use]
    pub fn disturbance(&self) -> f32 {
        self.disturbance
    }

    /// Advances the state by one period, in which the model expects `acceleration`, rad/s² or m/s².
    pub fn predict(&mut self, acceleration: f32) {
        let change = (acceleration + self.disturbance) * self.period_s;
        self.position += (self.speed + 0.5 * change) * self.period_s;
        self.speed += change;
    }

    /// Takes `counts` new encoder counts of `resolution` rad each, the last change `periods` ago. Returns false if the
    /// speed had to be reduced because no count came.
    pub fn count(&mut self, counts: i32, periods: u32, resolution: f32) -> bool {
        if counts == 0 {
            // No count in all this time: the position is within the count, and the speed is below one count over that
            // time.
            let within = self.position.within(0.0, resolution);
            if within != self.position {
                self.correct(within - self.position, 1);
                self.position = within;
            }
            let most = resolution / (periods as f32 * self.period_s);
            let speed = self.speed.within(-most, most);
            let excess = self.speed - speed;
            // The expected acceleration did not happen.
            self.disturbance -= (1.0 - self.pole) * excess / self.period_s;
            self.speed = speed;
            return excess == 0.0;
        }
        self.position -= counts as f32 * resolution;
        // The edge was crossed within this period, on average half a period ago.
        let beyond = (0.5 * counts.unsigned_abs() as f32).min(0.5) * resolution;
        let beyond = (0.5 * self.speed.abs() * self.period_s).min(beyond);
        let seen = if counts > 0 { beyond } else { resolution - beyond };
        self.correct(seen - self.position, periods);
        true
    }

    /// Takes the position measured in this period, rad or m.
    pub fn measure(&mut self, position: f32) {
        self.correct(position - self.position, 1);
    }

    /// Resets the observer to rest at a position: for an encoder, above the lower edge of the count.
    pub fn rest(&mut self, position: f32) {
        *self = Self { position, speed: 0.0, disturbance: 0.0, ..*self };
    }

    fn correct(&mut self, innovation: f32, periods: u32) {
        let mut pole = self.pole;
        if periods != 1 {
            pole = power(pole, periods);
        }
        let (rest, time_s) = (1.0 - pole, periods as f32 * self.period_s);
        let rate = innovation / time_s;
        self.position += (1.0 - pole * pole * pole) * innovation;
        self.speed += 1.5 * rest * rest * (1.0 + pole) * rate;
        self.disturbance += self.gamma * rest * rest * rest * rate / time_s;
    }
}

/// Returns `base` to the power of `exponent`, by squaring.
fn power(base: f32, mut exponent: u32) -> f32 {
    let (mut product, mut square) = (1.0, base);
    while exponent > 0 {
        if exponent & 1 != 0 {
            product *= square;
        }
        square *= square;
        exponent >>= 1;
    }
    product
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::{f64::consts::TAU, vec::Vec};

    use super::*;

    const PERIOD_S: f32 = 1e-3;
    const FILTER_S: f32 = 0.01;
    /// One count of an encoder with 2400 counts per turn, rad.
    const COUNT: f32 = core::f32::consts::TAU / 2400.0;

    /// Estimated speeds of a shaft at `position`, rad, with an encoder read each ms and a model that expects
    /// `acceleration`.
    fn seen(periods: u32, position: impl Fn(f64) -> f64, acceleration: impl Fn(f64) -> f64) -> Vec<f64> {
        let mut observer = Observer::new(FILTER_S, 0.07, PERIOD_S);
        observer.rest(COUNT / 2.0);
        let counts = |period: u32| (position(f64::from(period) * 1e-3) / f64::from(COUNT)).floor() as i64;
        let (mut last, mut since) = (counts(0), 0);
        let mut speeds = Vec::new();
        for period in 1..=periods {
            observer.predict(acceleration((f64::from(period) - 0.5) * 1e-3) as f32);
            since += 1;
            let now = counts(period);
            observer.count((now - last) as i32, since, COUNT);
            if now != last {
                (last, since) = (now, 0);
            }
            speeds.push(f64::from(observer.speed()));
        }
        speeds
    }

    /// Speeds from a count in 20 ms to 100 counts per ms show no ripple beyond that of one count more or less, and of
    /// its time within the period, over the observer's three time constants; less where counts come less often than
    /// that.
    #[test]
    fn a_constant_speed_is_seen_without_ripple() {
        for counts_per_ms in [0.05, 0.37, 1.0, 7.3, 100.0] {
            let speed = counts_per_ms * 1e3 * f64::from(COUNT);
            let late = seen(3000, |t| speed * t, |_| 0.0).split_off(1500);
            let worst = late.iter().map(|seen| (seen - speed).abs()).fold(0.0, f64::max);
            let ripple = (1.25 * f64::from(COUNT) / (3.0 * f64::from(FILTER_S))).min(0.15 * speed);
            assert!(worst < ripple, "{counts_per_ms} counts/ms: {worst} rad/s off, of {speed}");
        }
    }

    /// Gain and delay, s, at a frequency: a swing of 60 degrees on top of a steady turn.
    fn response(hz: f64, model: f64) -> (f64, f64) {
        let omega = TAU * hz;
        let (amplitude, steady) = (30.0 / omega, 40.0);
        let position = move |t: f64| steady * t + amplitude / omega * (1.0 - (omega * t).cos());
        let acceleration = move |t: f64| model * amplitude * omega * (omega * t).cos();
        let speeds = seen(3000, position, acceleration);
        let (mut sin, mut cos) = (0.0f64, 0.0f64);
        let late = speeds.iter().enumerate().skip(1000);
        let count = late.len() as f64;
        for (index, speed) in late {
            let t = (index + 1) as f64 * 1e-3;
            sin += 2.0 / count * (speed - steady) * (omega * t).sin();
            cos += 2.0 / count * (speed - steady) * (omega * t).cos();
        }
        (sin.hypot(cos) / amplitude, -cos.atan2(sin) / omega)
    }

    /// With the right model there is no lag. A low-pass of the same time constant has a gain of 0.62 at 20 Hz, and 7.2
    /// ms of delay.
    #[test]
    fn with_a_model_a_swing_is_seen_without_lag() {
        for hz in [2.0, 10.0, 20.0, 40.0] {
            let (gain, delay_s) = response(hz, 1.0);
            // Counts are seen within a period, and the position moves at the speed of the period's end.
            assert!((gain - 1.0).abs() < 0.03 && delay_s.abs() < 1e-3, "{hz} Hz: {gain}, {delay_s} s");
        }
        // A model that takes the motor for a third lighter than it is.
        let (gain, delay_s) = response(20.0, 0.67);
        assert!((0.7..1.3).contains(&gain) && delay_s.abs() < 5e-3, "{gain}, {delay_s} s");
    }

    /// A model that stays wrong by 10 rad/s² leaves no error of a constant speed.
    #[test]
    fn a_wrong_model_leaves_no_error_at_constant_speed() {
        let late = seen(3000, |t| 3.0 * t, |_| 10.0).split_off(2000);
        let mean = late.iter().sum::<f64>() / late.len() as f64;
        assert!((mean - 3.0).abs() < 0.02, "{mean}");
    }

    #[test]
    fn a_shaft_that_a_model_expects_to_move_and_that_does_not_stands() {
        let speeds = seen(2000, |_| 0.5 * f64::from(COUNT), |_| 40.0);
        // At most one count over the time without counts.
        for (period, speed) in (1u32..).zip(&speeds).skip(10) {
            assert!(*speed <= f64::from(COUNT) / (f64::from(period) * 1e-3) * 1.001, "{period}: {speed}");
        }
    }
}
