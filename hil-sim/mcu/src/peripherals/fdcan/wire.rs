//! Duration of a frame on the wire: every bit of it, with its stuff bits (ISO 11898-1:2015; RM0399, 59.4.4).
//!
//! Classic frames are stuffed from SOF to the end of the CRC, which is computed; FD frames from SOF to the end of the data,
//! with fixed stuff bits in the CRC field. With bit-rate switching the clock changes at the sample points of BRS and of the
//! CRC delimiter.

use crate::outside::CanFrame;

use super::ram::dlc;

/// Length of a bit in kernel clocks: up to the sample point, and from there on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct BitTime {
    pub(super) before_sample: u64,
    pub(super) after_sample: u64,
}

impl BitTime {
    pub(super) fn new(prescaler: u32, segment_1: u32, segment_2: u32) -> Self {
        let quantum = u64::from(prescaler) + 1;
        Self { before_sample: quantum * (u64::from(segment_1) + 2), after_sample: quantum * (u64::from(segment_2) + 1) }
    }

    /// Returns the length of a bit in kernel clocks.
    pub(super) fn clocks(self) -> u64 {
        self.before_sample + self.after_sample
    }
}

/// Bits of ACK delimiter and EOF.
pub(super) const AFTER_ACK_BITS: u64 = 8;
/// Bits of the intermission between frames.
pub(super) const INTERMISSION_BITS: u64 = 3;

/// Sequence of bits with the stuff bits inserted between them, counted.
#[derive(Default)]
struct Stuffed {
    bits: u64,
    run: u32,
    last: bool,
    stuff_due: bool,
    crc: u32,
    /// Number of bits up to and including BRS, with stuff bits.
    to_brs: u64,
}

impl Stuffed {
    fn push(&mut self, bit: bool) {
        if self.stuff_due {
            self.bits += 1;
            self.last = !self.last;
            self.run = 1;
        }
        // Polynomial of CRC-15: x^15 + x^14 + x^10 + x^8 + x^7 + x^4 + x^3 + 1.
        let feedback = (self.crc >> 14 & 1 == 1) != bit;
        self.crc = self.crc << 1 & 0x7FFF ^ if feedback { 0x4599 } else { 0 };
        self.run = if self.bits > 0 && bit == self.last { self.run + 1 } else { 1 };
        self.last = bit;
        self.bits += 1;
        self.stuff_due = self.run == 5;
    }

    fn push_bits(&mut self, value: u32, count: u32) {
        for nth in (0..count).rev() {
            self.push(value >> nth & 1 == 1);
        }
    }

    fn header(frame: &CanFrame, esi: bool) -> Self {
        let mut stuffed = Self::default();
        stuffed.push(false); // SOF
        if frame.extended {
            stuffed.push_bits(frame.id >> 18, 11);
            stuffed.push_bits(0b11, 2); // SRR, IDE
            stuffed.push_bits(frame.id, 18);
        } else {
            stuffed.push_bits(frame.id, 11);
        }
        if frame.fd {
            stuffed.push(false); // RRS
            if !frame.extended {
                stuffed.push(false); // IDE
            }
            stuffed.push_bits(0b10, 2); // FDF, res
            stuffed.push(frame.bit_rate_switch);
            stuffed.to_brs = stuffed.bits;
            stuffed.push(esi);
        } else {
            stuffed.push(frame.remote);
            stuffed.push_bits(0, 2); // IDE or r1, r0
        }
        stuffed.push_bits(dlc(frame.data.len()), 4);
        for byte in &frame.data {
            stuffed.push_bits(u32::from(*byte), 8);
        }
        stuffed
    }
}

/// Returns the kernel clocks from the start of SOF to the end of the acknowledge slot.
pub(super) fn clocks_to_ack(frame: &CanFrame, esi: bool, non_iso: bool, nominal: BitTime, data: BitTime) -> u64 {
    let mut stuffed = Stuffed::header(frame, esi);
    if !frame.fd {
        let crc = stuffed.crc;
        stuffed.push_bits(crc, 15);
        let bits = stuffed.bits + u64::from(stuffed.stuff_due);
        // Two more bits: CRC delimiter and acknowledge slot.
        return (bits + 2) * nominal.clocks();
    }
    let crc_bits = if frame.data.len() <= 16 { 17 } else { 21 };
    let field_bits: u64 = if non_iso { crc_bits } else { 4 + crc_bits };
    // A fixed stuff bit precedes the first bit and follows each four bits.
    let bits = stuffed.bits + field_bits + field_bits.div_ceil(4);
    if !frame.bit_rate_switch {
        return (bits + 2) * nominal.clocks();
    }
    let before_brs = (stuffed.to_brs - 1) * nominal.clocks();
    let brs = nominal.before_sample + data.after_sample;
    let fast = (bits - stuffed.to_brs) * data.clocks();
    let delimiter = data.before_sample + nominal.after_sample;
    before_brs + brs + fast + delimiter + nominal.clocks()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    const NOMINAL: BitTime = BitTime { before_sample: 7, after_sample: 3 };
    const FAST: BitTime = BitTime { before_sample: 2, after_sample: 1 };

    fn frame(id: u32, data: &[u8]) -> CanFrame {
        CanFrame { id, extended: false, remote: false, fd: false, bit_rate_switch: false, data: data.to_vec() }
    }

    fn bits(frame: &CanFrame) -> u64 {
        clocks_to_ack(frame, false, false, NOMINAL, FAST) / NOMINAL.clocks()
    }

    #[test]
    fn crc_15_has_its_published_check_value() {
        // Published check value: CRC-15/CAN of "123456789" is 0x059E (reveng.sourceforge.io catalogue).
        let mut stuffed = Stuffed::default();
        for byte in b"123456789" {
            stuffed.push_bits(u32::from(*byte), 8);
        }
        assert_eq!(stuffed.crc, 0x059E);
    }

    #[test]
    fn a_frame_without_stuffing_has_34_bits_and_its_data() {
        // Identifier 0x555 without data: 0 10101010101 0 0 0 0000 needs one stuff bit in 0 0 0 0000; then its CRC.
        let empty = frame(0x555, &[]);
        let mut stuffed = Stuffed::header(&empty, false);
        assert_eq!(stuffed.bits, 19 + 1);
        let crc = stuffed.crc;
        stuffed.push_bits(crc, 15);
        assert_eq!(bits(&empty), stuffed.bits + u64::from(stuffed.stuff_due) + 2);
    }

    #[test]
    fn the_worst_case_is_one_stuff_bit_after_five_then_every_four() {
        // With identifier 0x000 and zeros, the bits from SOF to the first of DLC are a run of zeros.
        let zeros = frame(0, &[0; 8]);
        // The 34 + 64 bits to be stuffed give at most (98 - 1) / 4 = 24 stuff bits, and the run of zeros at least 80 /
        // 5.
        let stuff_bits = bits(&zeros) - 2 - 98;
        assert!((16..=24).contains(&stuff_bits), "{stuff_bits}");
    }

    #[test]
    fn fd_with_a_faster_data_phase() {
        let slow = CanFrame { fd: true, ..frame(0x555, &[0x55; 16]) };
        let fast = CanFrame { bit_rate_switch: true, ..slow.clone() };
        // SOF, 11, RRS, IDE, FDF, res: 16; BRS, ESI, DLC: 6; 128 data bits; with 21 + 6 bits of CRC field and two more.
        // 0101010101 0 0 | 1 0 | 0 0 | 1010 has no five equal bits.
        assert_eq!(bits(&slow), 16 + 6 + 128 + 27 + 2);
        // In the other frame BRS is recessive: still no five equal bits. The slow rate applies before BRS and in the
        // slot; two bits are split.
        let clocks = clocks_to_ack(&fast, false, false, NOMINAL, FAST);
        assert_eq!(clocks, 16 * 10 + (7 + 1) + (5 + 128 + 27) * 3 + (2 + 3) + 10);
        // Above 16 bytes the CRC is CRC-21: 25 + 7 bits; before ISO there is no stuff count: 17 + 5 bits.
        let long = CanFrame { data: vec![0x55; 20], ..slow.clone() };
        assert_eq!(bits(&long), 16 + 6 + 160 + 32 + 2);
        assert_eq!(clocks_to_ack(&slow, false, true, NOMINAL, FAST) / 10, 16 + 6 + 128 + 22 + 2);
    }

    proptest! {
        #[test]
        fn a_frame_is_within_the_limits_of_the_standard(id in 0..0x800_u32, data in prop::collection::vec(any::<u8>(), 0..=8)) {
            let length = 34 + 8 * data.len() as u64;
            let bits = bits(&frame(id, &data)) - 2;
            prop_assert!((length..=length + (length - 1) / 4).contains(&bits));
        }
    }
}
