//! Execution of saturation, and of operations on halves and bytes (DDI0403E A4.4.3, A4.4.4).

use crate::operation::Index;
use crate::state::State;

fn clamp(value: i32, lowest: i32, highest: i32) -> (i32, bool) {
    let clamped = value.clamp(lowest, highest);
    (clamped, clamped != value)
}

/// Computes the sum or difference of two lanes of `bits` bits for parallel instructions, and whether GE is set.
fn lane(kind: u8, bits: u32, n: u32, m: u32, subtract: bool) -> (u32, bool) {
    let mask = (1 << bits) - 1;
    let is_signed = kind & 0x20 == 0;
    let value = |lane: u32| {
        if is_signed { (lane << (32 - bits)) as i32 >> (32 - bits) } else { (lane & mask) as i32 }
    };
    let result = if subtract { value(n) - value(m) } else { value(n) + value(m) };
    let at_least = match (is_signed, subtract) {
        (false, false) => result > mask as i32,
        _ => result >= 0,
    };
    let result = match (kind >> 3 & 3, is_signed) {
        (0, _) => result,
        (1, true) => clamp(result, -(1 << (bits - 1)), (1 << (bits - 1)) - 1).0,
        (1, false) => clamp(result, 0, mask as i32).0,
        _ => result >> 1,
    };
    (result as u32 & mask, at_least)
}

impl State {
    /// Executes SADD16 and relatives. `kind` has in bits 2 to 0 ADD8, ADD16, ASX, -, SUB8, SUB16, SAX; in 4 and 3
    /// plain, saturating, halving; bit 5 is unsigned.
    pub(super) fn parallel(&mut self, kind: u8, d: Index, n: Index, m: Index) {
        let (n, m) = (self.reg(n), self.reg(m));
        let (mut result, mut ge) = (0, 0);
        if kind & 3 == 0 {
            for byte in 0..4 {
                let (lane, at_least) = lane(kind, 8, n >> (8 * byte), m >> (8 * byte), kind & 4 != 0);
                result |= lane << (8 * byte);
                ge |= u8::from(at_least) << byte;
            }
        } else {
            // ASX and SAX exchange the halves of the second operand; ASX subtracts the lower ones, SAX adds them.
            let exchanged = kind & 3 == 2;
            let m = if exchanged { m.rotate_left(16) } else { m };
            let subtract = kind & 4 != 0;
            for (half, subtract) in [(0, subtract ^ exchanged), (1, subtract)] {
                let (lane, at_least) = lane(kind, 16, n >> (16 * half), m >> (16 * half), subtract);
                result |= lane << (16 * half);
                ge |= if at_least { 3 << (2 * half) } else { 0 };
            }
        }
        if kind & 0x18 == 0 {
            self.ge = ge;
        }
        self.set_reg(d, result);
    }

    pub(super) fn sel(&mut self, d: Index, n: Index, m: Index) {
        let mask = (0..4).fold(0, |mask, byte| if self.ge >> byte & 1 != 0 { mask | 0xFF << (8 * byte) } else { mask });
        self.set_reg(d, self.reg(n) & mask | self.reg(m) & !mask);
    }

    /// Executes SSAT: saturates to `bits` bits, 1 to 32.
    pub(super) fn signed_saturated(&mut self, value: i32, bits: u8) -> i32 {
        let highest = i32::MAX >> ((32 - u32::from(bits)) & 31);
        let (value, saturated) = clamp(value, !highest, highest);
        self.q |= saturated;
        value
    }

    /// Executes USAT: saturates to `bits` bits, 0 to 31.
    pub(super) fn unsigned_saturated(&mut self, value: i32, bits: u8) -> u32 {
        let (value, saturated) = clamp(value, 0, ((1_u32 << (bits & 31)) - 1) as i32);
        self.q |= saturated;
        value as u32
    }

    pub(super) fn ssat16(&mut self, d: Index, n: Index, bits: u8) {
        let value = self.reg(n);
        let low = self.signed_saturated((value as i16).into(), bits) as u32;
        let high = self.signed_saturated(((value >> 16) as i16).into(), bits) as u32;
        self.set_reg(d, low & 0xFFFF | high << 16);
    }

    pub(super) fn usat16(&mut self, d: Index, n: Index, bits: u8) {
        let value = self.reg(n);
        let low = self.unsigned_saturated((value as i16).into(), bits);
        let high = self.unsigned_saturated(((value >> 16) as i16).into(), bits);
        self.set_reg(d, low | high << 16);
    }

    fn saturated(&mut self, d: Index, exact: (i32, bool), saturated: i32) {
        self.q |= exact.1;
        self.set_reg(d, if exact.1 { saturated } else { exact.0 } as u32);
    }

    pub(super) fn qadd(&mut self, d: Index, n: Index, m: Index) {
        let (n, m) = (self.reg(n) as i32, self.reg(m) as i32);
        self.saturated(d, n.overflowing_add(m), n.saturating_add(m));
    }

    pub(super) fn qsub(&mut self, d: Index, n: Index, m: Index) {
        let (n, m) = (self.reg(n) as i32, self.reg(m) as i32);
        self.saturated(d, n.overflowing_sub(m), n.saturating_sub(m));
    }
}
