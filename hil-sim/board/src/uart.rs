//! Bytes on a UART line as a receiver takes them, and their disturbances.

use rand_pcg::{Pcg64, rand_core::SeedableRng};

use crate::sensors::uniform;

/// Number of bits on the wire for one byte: start, eight data, stop.
pub(crate) const BITS_PER_BYTE: u64 = 10;

/// Duration of a byte on the wire, ns; 0 baud counts as 1.
pub(crate) fn ns_per_byte(baud: u32) -> u64 {
    BITS_PER_BYTE * 1_000_000_000 / u64::from(baud.max(1))
}

/// A byte as it arrives, with the receiver's flags.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct UartByte {
    /// Time at which its stop bit ends, ns.
    pub at_ns: u64,
    /// Value of the data bits.
    pub value: u8,
    /// Framing error: the stop bit was low.
    pub framing_error: bool,
    /// Noise flag: not all samples of a bit were equal; the majority decided it.
    pub noise: bool,
}

impl UartByte {
    /// A byte that was not disturbed.
    #[must_use]
    pub const fn clean(at_ns: u64, value: u8) -> Self {
        Self { at_ns, value, framing_error: false, noise: false }
    }
}

/// Random disturbance of bytes on a line, sampled when a byte is sent.
///
/// A flipped data bit changes the value, a flipped stop bit is a framing error. A flipped start bit hides the byte:
/// that a receiver may then take a later bit for a start bit is not modelled.
#[derive(Clone, Debug)]
pub struct LineNoise {
    bit_errors: f64,
    spikes: f64,
    generator: Pcg64,
}

impl LineNoise {
    /// A disturbance with shares of bits, 0 to 1: `bit_errors` arrive inverted, `spikes` arrive correctly with one
    /// sample that differs.
    #[must_use]
    pub fn new(bit_errors: f64, spikes: f64, seed: u64) -> Self {
        Self { bit_errors, spikes, generator: Pcg64::seed_from_u64(seed) }
    }

    /// Byte that arrives for one that was sent; `None` if it is not detected at all.
    pub fn pass(&mut self, sent: UartByte) -> Option<UartByte> {
        let mut byte = sent;
        let mut seen = true;
        for bit in 0..BITS_PER_BYTE {
            let draw = uniform(&mut self.generator);
            if draw < self.bit_errors {
                match bit {
                    0 => seen = false,
                    1..=8 => byte.value ^= 1 << (bit - 1),
                    _ => byte.framing_error = true,
                }
            } else if draw < self.bit_errors + self.spikes {
                byte.noise = true;
            }
        }
        seen.then_some(byte)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Shares over 100 000 bytes: each count within 4 standard deviations of its expectation.
    #[test]
    fn bits_are_disturbed_as_often_as_said() {
        const BYTES: u32 = 100_000;
        let mut noise = LineNoise::new(0.01, 0.02, 7);
        let [mut hidden, mut framing, mut spiked, mut flipped] = [0_u32; 4];
        for index in 0..BYTES {
            let sent = UartByte::clean(u64::from(index), index as u8);
            let Some(byte) = noise.pass(sent) else {
                hidden += 1;
                continue;
            };
            assert_eq!(byte.at_ns, sent.at_ns);
            framing += u32::from(byte.framing_error);
            spiked += u32::from(byte.noise);
            flipped += (byte.value ^ sent.value).count_ones();
        }
        let near = |count: u32, of: f64, share: f64| {
            let deviation = (of * share * (1.0 - share)).sqrt();
            assert!((f64::from(count) - of * share).abs() < 4.0 * deviation, "{count} of {of}, not {share}");
        };
        let seen = f64::from(BYTES - hidden);
        near(hidden, f64::from(BYTES), 0.01);
        near(framing, seen, 0.01);
        near(flipped, 8.0 * seen, 0.01);
        // 0.98 of the bits have none; all ten bits of a detected byte
        near(spiked, seen, 1.0 - (1.0 - 0.02_f64 / 0.99) * 0.98_f64.powi(9));
    }

    #[test]
    fn a_quiet_line_changes_nothing() {
        let mut noise = LineNoise::new(0.0, 0.0, 1);
        for value in 0..=255 {
            let sent = UartByte::clean(5, value);
            assert_eq!(noise.pass(sent), Some(sent));
        }
    }
}
