//! Lean of the trunk, estimated from an inertial sensor on it.

/// Time constant of the complementary filter, s: slower than a lift, which takes about a second, so that the sensor's
/// own acceleration does not appear as a lean. Experiment: seeds 1 to 30 of `r4 system study tail --arms ours`. With
/// half the time constant the median excursion is 0.416 of that without a tail, with this one 0.403.
const TIME_CONSTANT_S: f64 = 5.0;

/// One sample of the sensor, in the trunk's frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sample {
    /// Rate of the lean, rad/s, positive forwards.
    pub rate_rad_s: f64,
    /// Specific force forwards and up, m/s²; `[0, 9.8]` upright at rest.
    pub force_m_s2: [f64; 2],
}

/// Complementary filter of rate and specific force: fast changes come from the rate, the mean from gravity.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Lean {
    angle_rad: f64,
    rate_rad_s: f64,
    /// Offset of the rate, measured at rest, rad/s.
    bias_rad_s: f64,
}

impl Lean {
    /// Starts from samples at rest; upright and without offset when there are none.
    #[must_use]
    pub fn at_rest(samples: &[Sample]) -> Self {
        let count = samples.len().max(1) as f64;
        let bias_rad_s = samples.iter().map(|sample| sample.rate_rad_s).sum::<f64>() / count;
        let angle_rad = samples.iter().map(|sample| leans(sample.force_m_s2)).sum::<f64>() / count;
        Self { angle_rad, rate_rad_s: 0.0, bias_rad_s }
    }

    /// Takes the next sample, `after_s` later. Returns the lean, rad, and its rate, rad/s.
    pub fn next(&mut self, sample: Sample, after_s: f64) -> (f64, f64) {
        let rate_rad_s = sample.rate_rad_s - self.bias_rad_s;
        self.angle_rad += f64::midpoint(self.rate_rad_s, rate_rad_s) * after_s;
        self.rate_rad_s = rate_rad_s;
        let share = (after_s / TIME_CONSTANT_S).clamp(0.0, 1.0);
        self.angle_rad += share * (leans(sample.force_m_s2) - self.angle_rad);
        (self.angle_rad, rate_rad_s)
    }
}

/// Lean at which gravity alone causes this specific force, rad.
fn leans([forward, up]: [f64; 2]) -> f64 {
    (-forward).atan2(up)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A lean of 0.1 rad within a second, held; the sensor is 1.1 m above the ankle, its rate is off by 2 mrad/s.
    #[test]
    fn a_lean_is_followed_through_its_acceleration_and_an_offset() {
        let sample = |time_s: f64| {
            let (phase, is_moving) = (std::f64::consts::PI * time_s, time_s < 1.0);
            let angle = if is_moving { 0.05 * (1.0 - phase.cos()) } else { 0.1 };
            let rate = if is_moving { 0.05 * std::f64::consts::PI * phase.sin() } else { 0.0 };
            let turning = if is_moving { 0.05 * std::f64::consts::PI.powi(2) * phase.cos() } else { 0.0 };
            let force_m_s2 = [-9.81 * angle.sin() + 1.1 * turning, 9.81 * angle.cos()];
            (angle, Sample { rate_rad_s: rate + 2e-3, force_m_s2 })
        };
        let still = Sample { rate_rad_s: 2e-3, force_m_s2: [0.0, 9.81] };
        let mut lean = Lean::at_rest(&[still; 10]);
        for step in 1..=300 {
            let (angle_rad, sample) = sample(f64::from(step) * 0.01);
            let (found_rad, _) = lean.next(sample, 0.01);
            // The sensor's acceleration, 0.54 m/s² or 0.055 rad, acts for half a second of the filter's 5 s.
            assert!((found_rad - angle_rad).abs() < 5e-3, "{found_rad} rad of {angle_rad} at step {step}");
        }
    }
}
