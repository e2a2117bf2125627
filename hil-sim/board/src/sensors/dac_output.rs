//! Output of the processor's 12-bit digital-to-analog converter.
//!
//! `VREF · code / 4096`, then gain and offset error, then the range of the output: with its buffer on 0.2 V to VREF -
//! 0.2 V (STM32H747 data sheet, DAC characteristics; from memory, not checked), without it 0 V to VREF. Most parts get
//! closer to the rails: the limits are the guaranteed range.

const CODES: f64 = 4096.0;
/// Mask of the register's twelve bits; higher bits are ignored.
const CODE_MASK: u16 = 0x0FFF;
/// Distance of the buffer's range from the rails, V.
const BUFFER_MARGIN_V: f64 = 0.2;

/// Parameters of one output. [`new`](Self::new) has no errors.
#[derive(Clone, Debug, PartialEq)]
pub struct DacOutput {
    /// Reference voltage of the converter, V.
    pub reference_v: f64,
    /// True while the output buffer is on.
    pub buffered: bool,
    /// Relative error of the gain.
    pub gain_error: f64,
    /// Offset added to the output, V.
    pub offset_v: f64,
}

impl DacOutput {
    /// An output without errors, at a reference of 3.3 V.
    #[must_use]
    pub const fn new(buffered: bool) -> Self {
        Self { reference_v: 3.3, buffered, gain_error: 0.0, offset_v: 0.0 }
    }

    /// Voltage of a code without load, V.
    #[must_use]
    pub fn volts(&self, code: u16) -> f64 {
        let [low_v, high_v] = self.limits_v();
        let volts = f64::from(code & CODE_MASK) / CODES * self.reference_v * (1.0 + self.gain_error) + self.offset_v;
        volts.max(low_v).min(high_v)
    }

    /// Code whose voltage is nearest to `volts`, the inverse; `None` outside the range of the output.
    #[must_use]
    pub fn code(&self, volts: f64) -> Option<u16> {
        let [low_v, high_v] = self.limits_v();
        let code = (volts - self.offset_v) / (self.reference_v * (1.0 + self.gain_error)) * CODES;
        let reachable = (low_v..=high_v).contains(&volts) && (0.0..=f64::from(CODE_MASK)).contains(&code.round());
        reachable.then_some(code.round() as u16)
    }

    /// Lowest and highest voltage, V.
    fn limits_v(&self) -> [f64; 2] {
        let margin_v = if self.buffered { BUFFER_MARGIN_V } else { 0.0 };
        [margin_v, self.reference_v - margin_v]
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn the_buffer_keeps_off_the_rails() {
        // 0.2 V lies between codes 248 and 249, 3.1 V between 3847 and 3848
        let (bare, buffered) = (DacOutput::new(false), DacOutput::new(true));
        for (code, bare_v, buffered_v) in [
            (0, 0.0, 0.2),
            (248, 248.0 * 3.3 / 4096.0, 0.2),
            (249, 249.0 * 3.3 / 4096.0, 249.0 * 3.3 / 4096.0),
            (2048, 1.65, 1.65),
            (3847, 3847.0 * 3.3 / 4096.0, 3847.0 * 3.3 / 4096.0),
            (3848, 3848.0 * 3.3 / 4096.0, 3.1),
            (4095, 3.3 - 3.3 / 4096.0, 3.1),
            // bits 12 to 15 do not exist
            (0xF800, 1.65, 1.65),
        ] {
            // rounding of doubles
            assert!((bare.volts(code) - bare_v).abs() < 1e-12, "{code}");
            assert!((buffered.volts(code) - buffered_v).abs() < 1e-12, "{code}");
        }
    }

    #[test]
    fn errors_stay_within_the_rails() {
        let output = DacOutput { gain_error: 0.02, offset_v: -0.01, ..DacOutput::new(false) };
        assert!((output.volts(2048) - (1.65 * 1.02 - 0.01)).abs() < 1e-12);
        assert_eq!(output.volts(0), 0.0);
        assert_eq!(output.volts(4095), 3.3);
        for volts in [-0.001, 3.301, f64::NAN] {
            assert_eq!(output.code(volts), None);
        }
        assert_eq!(DacOutput::new(true).code(0.19), None);
    }

    proptest! {
        #[test]
        fn the_inverse_gives_the_code_back(
            code in 0..4096_u16, buffered in any::<bool>(), gain_error in -0.05..0.05_f64, offset_v in -0.02..0.02_f64,
        ) {
            let output = DacOutput { gain_error, offset_v, ..DacOutput::new(buffered) };
            let volts = output.volts(code);
            let [low_v, high_v] = output.limits_v();
            if low_v < volts && volts < high_v {
                prop_assert_eq!(output.code(volts), Some(code));
            }
        }
    }
}
