//! First-order low-pass filter with DC gain 1.

/// Low-pass `y += (x - y) dt / (tau + dt)`: backward Euler of `tau y' = x - y`, DC gain exactly 1.
#[derive(Clone, Copy, Debug)]
pub struct LowPass {
    share: f32,
    value: f32,
}

impl LowPass {
    /// Creates a filter of time constant `tau_s`, stepped every `period_s`, at rest at 0.
    #[must_use]
    pub fn new(tau_s: f32, period_s: f32) -> Self {
        Self { share: period_s / (tau_s + period_s), value: 0.0 }
    }

    /// Takes one input and returns the filtered value.
    pub fn step(&mut self, input: f32) -> f32 {
        self.value += (input - self.value) * self.share;
        self.value
    }

    /// Takes the same input `times` times, in one call.
    pub fn step_times(&mut self, input: f32, times: u32) -> f32 {
        // Remaining share of the difference: (1 - share)^times, by squaring.
        let (mut left, mut power, mut times) = (1.0, 1.0 - self.share, times);
        while times > 0 {
            if times & 1 != 0 {
                left *= power;
            }
            power *= power;
            times >>= 1;
        }
        self.value = input + (self.value - input) * left;
        self.value
    }

    /// Filtered value of the last step.
    #[must_use]
    pub fn value(&self) -> f32 {
        self.value
    }

    /// Puts the filter at rest at `value`.
    pub fn reset(&mut self, value: f32) {
        self.value = value;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_reaches_63_percent_after_tau_and_ends_exactly_there() {
        let mut filter = LowPass::new(0.1, 1e-3);
        let after_tau = (0..100).map(|_| filter.step(1.0)).last().expect("stepped");
        // Backward Euler: 1 - (1 + 1/100)^-100 = 0.6303; the exact exponential is 0.6321.
        assert!((after_tau - 0.6303).abs() < 1e-3, "{after_tau}");
        let end = (0..5000).map(|_| filter.step(1.0)).last().expect("stepped");
        // The filter stops where a step is lost in the rounding: half an ulp over the share of a period, 3e-8 / 0.01.
        assert!((end - 1.0).abs() < 6e-6, "DC gain is 1: {end}");
        assert_eq!(filter.value(), end);
        filter.reset(-2.5);
        assert_eq!((filter.value(), filter.step(-2.5)), (-2.5, -2.5), "at rest there");
    }

    #[test]
    fn the_same_input_at_once_is_the_same_as_one_by_one() {
        for times in (0..520).step_by(13) {
            let [mut one_by_one, mut at_once] = [LowPass::new(0.02, 1e-3); 2];
            one_by_one.reset(-3.0);
            at_once.reset(-3.0);
            (0..times).for_each(|_| _ = one_by_one.step(2.0));
            // Steps are lost in the rounding, as above: 1.2e-7 / 0.048.
            let (expected, value) = (one_by_one.value(), at_once.step_times(2.0, times));
            assert!((value - expected).abs() < 3e-6, "{times} times: {value}, not {expected}");
        }
    }
}
