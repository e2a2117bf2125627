//! Speed of a shaft from its position and a model of its motor.

use crate::within::Within;

/// Position, speed and unmodelled acceleration of a shaft: a third-order Luenberger observer with three equal poles.
///
/// It is told the acceleration that a model expects ([`Observer::predict`]) and corrected by positions
/// ([`Observer::count`], [`Observer::measure`]). What the model does not expect comes to be the disturbance, so that a wrong model
/// leaves no error of the speed at constant speed. Without an acceleration it is the fading-memory polynomial filter of second degree,
/// with a model its delay is that of the model alone.
///
/// An encoder's position is known best at the moment at which its count changes: only then is it corrected by a count, and the gains
/// are those of the time since the last one. Between counts the position stays within the count. So there is no ripple at low speed,
/// where a filter of differences shows each count.
///
/// Gains: α = 1 − z³, β = 1.5 (1 − z)² (1 + z) / h, γ = (1 − z)³ / h², with the pole z = exp(−h/τ) and the time h since the last
/// correction (E. Brookner, *Tracking and Kalman Filtering Made Easy*, Wiley 1998, section 1.3, critically damped g-h-k filter).
#[derive(Clone, Copy, Debug)]
pub struct Observer {
    period_s: f32,
    /// Pole of one period.
    pole: f32,
    /// Factor of γ.
    gamma: f32,
    /// For an encoder: above the lower edge of the count, rad.
    position: f32,
    /// rad/s or m/s
    speed: f32,
    /// rad/s² or m/s²
    disturbance: f32,
}

impl Observer {
    /// An observer at rest, stepped every `period_s`, with three poles of the time constant `time_constant_s`, for a model whose own
    /// speed settles with `motor_s`.
    #[must_use]
    pub fn new(time_constant_s: f32, motor_s: f32, period_s: f32) -> Self {
        // Shorter than two periods, noise is not filtered at all.
        let time_constant_s = time_constant_s.max(2.0 * period_s);
        let pole = libm::expf(-period_s / time_constant_s);
        // A quick motor's own damping holds the speed where the model has it: the slowest pole would fall to 1 / (1 + τ/T) of the
        // others.
        let gamma = 1.0 + time_constant_s / motor_s;
        Self { period_s, pole, gamma, position: 0.0, speed: 0.0, disturbance: 0.0 }
    }

    /// Speed, rad/s or m/s.
    #[must_use]
    pub fn speed(&self) -> f32 {
        self.speed
    }

    /// Acceleration that the model does not explain, rad/s² or m/s².
    #[must_use]
    pub fn disturbance(&self) -> f32 {
        self.disturbance
    }

    /// Lets a period pass in which the model expects `acceleration`.
    pub fn predict(&mut self, acceleration: f32) {
        let change = (acceleration + self.disturbance) * self.period_s;
        self.position += (self.speed + 0.5 * change) * self.period_s;
        self.speed += change;
    }

    /// Takes `counts` more of an encoder with `resolution` rad each, the last change `periods` ago. Returns whether the shaft is as fast
    /// as it was taken to be, or slower because no count came.
    pub fn count(&mut self, counts: i32, periods: u32, resolution: f32) -> bool {
        if counts == 0 {
            // No count in all this time: the position is within the count, and the speed is below one count over it.
            let within = self.position.within(0.0, resolution);
            if within != self.position {
                self.correct(within - self.position, 1);
                self.position = within;
            }
            let most = resolution / (periods as f32 * self.period_s);
            let speed = self.speed.within(-most, most);
            let excess = self.speed - speed;
            // The acceleration that was expected did not come.
            self.disturbance -= (1.0 - self.pole) * excess / self.period_s;
            self.speed = speed;
            return excess == 0.0;
        }
        self.position -= counts as f32 * resolution;
        // The edge was crossed somewhere in this period, in the mean half a period ago.
        let beyond = (0.5 * counts.unsigned_abs() as f32).min(0.5) * resolution;
        let beyond = (0.5 * self.speed.abs() * self.period_s).min(beyond);
        let seen = if counts > 0 { beyond } else { resolution - beyond };
        self.correct(seen - self.position, periods);
        true
    }

    /// Takes a position that is measured each period, rad or m.
    pub fn measure(&mut self, position: f32) {
        self.correct(position - self.position, 1);
    }

    /// Puts it at rest at a position: for an encoder, above the lower edge of the count.
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

/// `base` to the power of `exponent`, by squaring.
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
