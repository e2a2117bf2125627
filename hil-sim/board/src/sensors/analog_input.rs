//! Divided, zener-clamped analog input with the 16-bit converter behind it.
//!
//! ```text
//!  volts ── R upper ──┬── converter, 3.3 V reference
//!             R lower ┴ zener, both to ground
//! ```
//!
//! # The clamp
//! A zener does not clamp at one voltage: it leaks below it. With `u` the voltage of the unloaded divider, the pin has
//!
//! ```text
//! v = u - knee · ln(1 + exp((u - clamp) / knee))
//! ```
//!
//! This is a model, not a data sheet: a leakage current that grows by e every `knee` volts and, through the divider's
//! resistance, lowers the reading. Far below the clamp it has no effect, at `u = clamp` it takes 0.69 knee, above it
//! the pin stays at the clamp. Its inverse is `u = v - knee · ln(1 - exp((v - clamp) / knee))`.

use rand_pcg::Pcg64;

use super::normal;

/// Nominal reference of the converter, V.
const REFERENCE_V: f64 = 3.3;
/// Largest code of the 16-bit converter.
const CODE_MAX: f64 = 65_535.0;

/// Fault of the wiring.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum AnalogFault {
    /// Nothing is connected: the lower resistor pulls the pin to ground.
    Open,
    /// The input touches ground.
    ShortToGround,
    /// The input touches a rail.
    ShortToRail {
        /// Voltage of the rail, V.
        volts: f64,
    },
    /// The divider's lower resistor is open: the pin sees the input undivided, up to the clamp.
    LowerResistorOpen,
}

/// Parameters of one input. All fields may be changed at any time; [`new`](Self::new) has no errors.
#[derive(Clone, Debug, PartialEq)]
pub struct AnalogInput {
    /// Nominal ratio of the voltages at the input and the pin: 15.15 for 50 V.
    pub ratio: f64,
    /// Relative error of the ratio; with two 1 % resistors up to 0.02.
    pub ratio_error: f64,
    /// Highest voltage of the pin, V.
    pub clamp_v: f64,
    /// Softness of the clamp, V, see above; 0 is an ideal one.
    pub knee_v: f64,
    /// Relative error of the reference.
    pub reference_error: f64,
    /// Offset of the converter, codes.
    pub offset_codes: f64,
    /// Gaussian noise of a single sample, codes rms.
    pub noise_rms_codes: f64,
    /// Number of samples that the converter averages in hardware for one reading; 0 counts as 1.
    pub samples: u16,
    /// Fault of the wiring, if there is one.
    pub fault: Option<AnalogFault>,
}

impl AnalogInput {
    /// An input without errors and noise, behind a zener of 3.6 V with a knee of 50 mV (our choice: 0.1 mV are lost at
    /// full scale).
    #[must_use]
    pub const fn new(ratio: f64) -> Self {
        Self {
            ratio,
            ratio_error: 0.0,
            clamp_v: 3.6,
            knee_v: 0.05,
            reference_error: 0.0,
            offset_codes: 0.0,
            noise_rms_codes: 0.0,
            samples: 1,
            fault: None,
        }
    }

    /// Code of the converter with `volts` at the input. NaN reads as 0.
    ///
    /// Every sample is a whole code within range; their average is rounded to nearest, as by the processor's
    /// oversampling.
    #[must_use]
    pub fn code(&self, volts: f64, noise: &mut Pcg64) -> u16 {
        if self.noise_rms_codes == 0.0 {
            return self.code_without_noise(volts);
        }
        let sample = |_| u64::from(quantized(self.sample(volts, noise)));
        let samples = u64::from(self.samples.max(1));
        let sum: u64 = (0..samples).map(sample).sum();
        ((sum + samples / 2) / samples) as u16
    }

    /// One sample before rounding and clipping, codes.
    pub(crate) fn sample(&self, volts: f64, noise: &mut Pcg64) -> f64 {
        let exact = self.exact_code(volts);
        if self.noise_rms_codes == 0.0 {
            return exact;
        }
        exact + normal(noise) * self.noise_rms_codes
    }

    /// Code of the converter without noise.
    #[must_use]
    pub fn code_without_noise(&self, volts: f64) -> u16 {
        quantized(self.exact_code(volts))
    }

    /// Input voltage for the middle of a code, V, the inverse; `None` at either end of the range, at the clamp, and
    /// with a fault.
    #[must_use]
    pub fn volts(&self, code: u16) -> Option<f64> {
        let pin_v = (f64::from(code) - self.offset_codes) / CODE_MAX * self.reference_v();
        if self.fault.is_some() || code == 0 || code == u16::MAX || pin_v >= self.clamp_v {
            return None;
        }
        let bend_v = if self.knee_v > 0.0 {
            self.knee_v * libm::log(-libm::expm1((pin_v - self.clamp_v) / self.knee_v))
        } else {
            0.0
        };
        Some((pin_v - bend_v) * self.true_ratio())
    }

    fn exact_code(&self, volts: f64) -> f64 {
        self.pin_v(volts) / self.reference_v() * CODE_MAX + self.offset_codes
    }

    fn pin_v(&self, volts: f64) -> f64 {
        let divided_v = match self.fault {
            None => volts / self.true_ratio(),
            Some(AnalogFault::Open | AnalogFault::ShortToGround) => 0.0,
            Some(AnalogFault::ShortToRail { volts }) => volts / self.true_ratio(),
            Some(AnalogFault::LowerResistorOpen) => volts,
        };
        if self.knee_v > 0.0 {
            let above = (divided_v - self.clamp_v) / self.knee_v;
            // ln(1 + exp(x)) without overflow
            divided_v - self.knee_v * (above.max(0.0) + libm::log1p(libm::exp(-above.abs())))
        } else {
            divided_v.min(self.clamp_v)
        }
    }

    fn true_ratio(&self) -> f64 {
        self.ratio * (1.0 + self.ratio_error)
    }

    fn reference_v(&self) -> f64 {
        REFERENCE_V * (1.0 + self.reference_error)
    }
}

fn quantized(code: f64) -> u16 {
    code.round().clamp(0.0, CODE_MAX) as u16
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use rand_pcg::rand_core::SeedableRng;

    #[test]
    fn codes_of_an_input_without_errors() {
        let input = AnalogInput::new(16.0);
        // full scale is 52.8 V at 65535 codes; the knee takes 50 mV x exp(-6) = 0.12 mV, 2.5 codes, there
        for (volts, code) in [(0.0, 0), (-5.0, 0), (26.4, 32_768), (12.0, 14_894), (52.8, 65_533), (500.0, 65_535)] {
            assert_eq!(input.code_without_noise(volts), code, "{volts}");
        }
        assert_eq!(input.code_without_noise(f64::NAN), 0);
    }

    #[test]
    fn errors_move_the_code_as_they_should() {
        let input = AnalogInput::new(10.0);
        let code = |input: AnalogInput| f64::from(input.code_without_noise(10.0));
        // 1 V at the pin; codes are rounded
        let close = |code: f64, expected: f64| (code - expected).abs() <= 0.5;
        let ideal = 65_535.0 / 3.3;
        assert!(close(code(input.clone()), ideal));
        assert!(close(code(AnalogInput { ratio_error: 0.02, ..input.clone() }), ideal / 1.02));
        assert!(close(code(AnalogInput { reference_error: -0.01, ..input.clone() }), ideal / 0.99));
        assert!(close(code(AnalogInput { offset_codes: -40.0, ..input }), ideal - 40.0));
    }

    #[test]
    fn the_knee_bends_by_the_documented_law() {
        let input = AnalogInput { clamp_v: 2.0, knee_v: 0.1, ..AnalogInput::new(1.0) };
        for (volts, lost_v) in [(1.0, 0.1 * 4.54e-5), (1.9, 0.031_33), (2.0, 0.069_31), (2.2, 0.212_69), (5.0, 3.0)] {
            let pin_v = f64::from(input.code_without_noise(volts)) / 65_535.0 * 3.3;
            // half a code is 25 uV
            assert!((volts - pin_v - lost_v).abs() < 4e-5, "{volts}: {pin_v}");
        }
        let ideal = AnalogInput { clamp_v: 2.0, knee_v: 0.0, ..AnalogInput::new(1.0) };
        assert_eq!([1.99, 2.0, 9.0].map(|volts| ideal.code_without_noise(volts)), [39_520, 39_718, 39_718]);
    }

    #[test]
    fn faults() {
        let broken = |fault| AnalogInput { fault: Some(fault), ..AnalogInput::new(16.0) };
        for (fault, code) in [
            (AnalogFault::Open, 0),
            (AnalogFault::ShortToGround, 0),
            (AnalogFault::ShortToRail { volts: 5.0 }, 6_206),
            (AnalogFault::LowerResistorOpen, 65_535),
        ] {
            let input = broken(fault);
            assert_eq!(input.code_without_noise(24.0), code, "{fault:?}");
            assert_eq!(input.volts(1_000), None);
        }
    }

    #[test]
    fn noise_has_the_set_deviation_and_averages_out() {
        let mut noise = Pcg64::seed_from_u64(4);
        for (samples, expected) in [(0, 20.0), (1, 20.0), (16, 5.0), (256, 1.25)] {
            let input = AnalogInput { noise_rms_codes: 20.0, samples, ..AnalogInput::new(16.0) };
            let codes: Vec<_> = (0..2_000).map(|_| f64::from(input.code(12.0, &mut noise))).collect();
            let mean = codes.iter().sum::<f64>() / 2_000.0;
            let deviation = (codes.iter().map(|code| (code - mean).powi(2)).sum::<f64>() / 2_000.0).sqrt();
            // four standard errors, 1 / sqrt(2 x 2000) of the deviation; rounding adds 1/12 to the variance
            let expected = f64::hypot(expected, (1.0_f64 / 12.0).sqrt());
            assert!((deviation / expected - 1.0).abs() < 0.065, "{samples}: {deviation}");
            assert!((mean - 14_894.1).abs() < 4.0 * expected / 2_000_f64.sqrt() + 0.05, "{samples}: {mean}");
        }
    }

    #[test]
    fn noise_is_clipped_with_the_range() {
        let mut noise = Pcg64::seed_from_u64(4);
        let input = AnalogInput { noise_rms_codes: 1e6, samples: 1, ..AnalogInput::new(16.0) };
        let codes: Vec<_> = (0..100).map(|_| input.code(12.0, &mut noise)).collect();
        assert!(codes.contains(&0) && codes.contains(&65_535));
    }

    fn any_input() -> impl Strategy<Value = AnalogInput> {
        (
            1.0..30.0_f64,
            -0.05..0.05_f64,
            2.0..5.0_f64,
            prop_oneof![Just(0.0), 0.001..0.3_f64],
            -0.02..0.02_f64,
            -99.0..99.0_f64,
        )
            .prop_map(|(ratio, ratio_error, clamp_v, knee_v, reference_error, offset_codes)| AnalogInput {
                ratio_error,
                clamp_v,
                knee_v,
                reference_error,
                offset_codes,
                ..AnalogInput::new(ratio)
            })
    }

    proptest! {
        #[test]
        fn the_inverse_gives_the_code_back(input in any_input(), code in any::<u16>()) {
            let reachable = (f64::from(code) - input.offset_codes) / CODE_MAX * input.reference_v() < input.clamp_v;
            prop_assert_eq!(input.volts(code).is_some(), reachable && code != 0 && code != u16::MAX);
            if let Some(volts) = input.volts(code) {
                prop_assert_eq!(input.code_without_noise(volts), code);
            }
        }

        #[test]
        fn codes_rise_with_the_voltage(input in any_input(), volts in -10.0..200.0_f64, more in 0.0..50.0_f64) {
            prop_assert!(input.code_without_noise(volts) <= input.code_without_noise(volts + more));
        }

        #[test]
        fn without_noise_samples_do_not_matter(input in any_input(), volts in -10.0..200.0_f64, samples in any::<u16>()) {
            let code = input.code_without_noise(volts);
            prop_assert_eq!(AnalogInput { samples, ..input }.code(volts, &mut Pcg64::seed_from_u64(0)), code);
        }
    }
}
