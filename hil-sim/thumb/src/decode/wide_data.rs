//! Decoder for data processing of 32 bits: A5.3.1, A5.3.3, A5.3.11 to A5.3.17.

use super::{Instruction, Then, bits, data, index};
use crate::operation::{Index, NONE, Op, SCRATCH, SCRATCH2, ZERO};

/// Expands a constant (`ThumbExpandImm_C`, A5.3.2); returns it with the carry, if it sets one.
fn expanded(value: u32) -> (u32, Option<bool>) {
    let byte = value & 0xFF;
    match value >> 8 {
        0 => (byte, None),
        1 => (byte << 16 | byte, None),
        2 => (byte << 24 | byte << 8, None),
        3 => (byte * 0x0101_0101, None),
        _ => {
            let result = (value & 0x7F | 0x80).rotate_right(value >> 7);
            (result, Some(result >> 31 != 0))
        }
    }
}

/// Extracts the amount of a shift from imm3 and imm2.
fn amount(second: u16) -> u32 {
    bits(second, 12, 3) << 2 | bits(second, 6, 2)
}

fn is_logical(operation: u32) -> bool {
    operation <= data::EOR
}

/// Replaces registers encoded as 15 by the absent first operand or destination; `None` where they are undefined.
fn operands(operation: u32, s: bool, d: Index, n: Index) -> Option<(Index, Index)> {
    let n = match n {
        15 if matches!(operation, data::ORR | data::ORN) => ZERO,
        15 => return None,
        n => n,
    };
    let d = match d {
        15 if s && matches!(operation, data::AND | data::EOR | data::ADD | data::SUB) => NONE,
        15 => return None,
        d => d,
    };
    Some((d, n))
}

impl Instruction<'_> {
    /// Data processing with an expanded constant (A5.3.1).
    pub(super) fn modified_immediate(&mut self, first: u16, second: u16) -> Then {
        let (operation, s) = (bits(first, 5, 4), first & 0x10 != 0);
        let Some((d, n)) = operands(operation, s, index(second, 8), index(first, 0)) else { return self.undefined() };
        let (value, carry) = expanded(bits(first, 10, 1) << 11 | bits(second, 12, 3) << 8 | bits(second, 0, 8));
        if operation == data::PKH {
            return self.undefined();
        }
        if s && is_logical(operation)
            && let Some(carry) = carry
        {
            self.push(Op::SetCarry { carry });
        }
        self.data_value(operation, s, d, n, value)
    }

    /// Data processing with a shifted register (A5.3.11).
    pub(super) fn shifted_register(&mut self, first: u16, second: u16) -> Then {
        let (operation, s) = (bits(first, 5, 4), first & 0x10 != 0);
        let (m, kind, amount) = (index(second, 0), bits(second, 4, 2), amount(second));
        let Some((d, n)) = operands(operation, s, index(second, 8), index(first, 0)) else { return self.undefined() };
        if m == 15 || second & 0x8000 != 0 {
            return self.undefined();
        }
        if operation == data::PKH {
            let top = second & 0x20 != 0;
            if s || second & 0x10 != 0 {
                return self.undefined();
            }
            self.shift(false, SCRATCH, m, kind, amount);
            return self.push(if top { Op::Pkhtb { d, n, m: SCRATCH } } else { Op::Pkhbt { d, n, m: SCRATCH } });
        }
        match (operation, kind, amount) {
            (_, 0, 0) => self.data(operation, s, d, n, m),
            // MOV with a shift is the shift.
            (data::ORR, ..) if n == ZERO => self.shift(s, d, m, kind, amount),
            (data::ADD, 0, _) if !s => {
                self.push(Op::AddShifted { d, n, m, left: amount as u8 });
                self.wrote(d)
            }
            _ => {
                self.shift(s && is_logical(operation), SCRATCH, m, kind, amount);
                self.data(operation, s, d, n, SCRATCH)
            }
        }
    }

    /// Data processing with a plain constant (A5.3.3).
    pub(super) fn plain_immediate(&mut self, first: u16, second: u16) -> Then {
        let (operation, d, n) = (bits(first, 4, 5), index(second, 8), index(first, 0));
        let value = bits(first, 10, 1) << 11 | bits(second, 12, 3) << 8 | bits(second, 0, 8);
        let (lsb, last) = (amount(second) as u8, bits(second, 0, 5) as u8);
        let pc = self.aligned_pc();
        if d == 15 || n == 15 && !matches!(operation, 0 | 4 | 10 | 12 | 22) {
            return self.undefined();
        }
        let wide = n.into();
        match operation {
            // ADDW, SUBW; of PC they are ADR.
            0 if n == 15 => self.push(Op::Value { d, value: pc.wrapping_add(value) }),
            0 => self.data_value(data::ADD, false, d, n, value),
            10 if n == 15 => self.push(Op::Value { d, value: pc.wrapping_sub(value) }),
            10 => self.data_value(data::SUB, false, d, n, value),
            // MOVW, MOVT.
            4 => self.data_value(data::ORR, false, d, ZERO, bits_of(wide) | value),
            12 => self.push(Op::Top { d, value: (bits_of(wide) | value) as u16 }),
            18 if lsb == 0 => self.push(Op::Ssat16 { d, n, bits: (last & 15) + 1 }),
            26 if lsb == 0 => self.push(Op::Usat16 { d, n, bits: last & 15 }),
            16 | 18 | 24 | 26 => {
                let kind = if operation & 2 == 0 { 0 } else { 2 };
                let n = if lsb == 0 {
                    n
                } else {
                    self.shift(false, SCRATCH, n, kind, lsb.into());
                    SCRATCH
                };
                self.push(if operation < 24 {
                    Op::Ssat { d, n, bits: last + 1 }
                } else {
                    Op::Usat { d, n, bits: last }
                })
            }
            20 if lsb + last < 32 => self.push(Op::Sbfx { d, n, lsb, width: last + 1 }),
            28 if lsb + last < 32 => self.push(Op::Ubfx { d, n, lsb, width: last + 1 }),
            22 if last >= lsb => {
                let n = if n == 15 { ZERO } else { n };
                self.push(Op::Bfi { d, n, lsb, width: last - lsb + 1 })
            }
            _ => self.undefined(),
        }
    }

    /// Data processing of registers: shifts, extensions, parallel and miscellaneous operations (A5.3.12 to A5.3.15).
    pub(super) fn register(&mut self, first: u16, second: u16) -> Then {
        let (n, d, m) = (index(first, 0), index(second, 8), index(second, 0));
        let (group, what) = (bits(first, 4, 4), bits(second, 4, 4));
        if second >> 12 != 15 || d == 15 || m == 15 {
            return self.undefined();
        }
        match (group, what) {
            (0..=7, 0) if n != 15 => {
                let kind = (group >> 1) as u8;
                self.push(if group & 1 == 0 { Op::ShiftBy { kind, d, n, m } } else { Op::ShiftBys { kind, d, n, m } })
            }
            (0..=5, 8..=11) => self.extend(group, d, n, m, what & 3),
            (8.., 0..=7) if n != 15 && group & 3 != 3 && what & 3 != 3 => {
                let kind = (group & 7) as u8 | (what << 3) as u8;
                self.push(Op::Parallel { kind, d, n, m })
            }
            (8, 8..=11) if n != 15 => {
                let n = if what & 1 == 0 {
                    n
                } else {
                    self.push(Op::Qadd { d: SCRATCH, n, m: n });
                    SCRATCH
                };
                self.push(if what & 2 == 0 { Op::Qadd { d, n: m, m: n } } else { Op::Qsub { d, n: m, m: n } })
            }
            (9, 8) => self.push(Op::Rev { d, m }),
            (9, 9) => self.push(Op::Rev16 { d, m }),
            (9, 10) => self.push(Op::Rbit { d, m }),
            (9, 11) => self.push(Op::Revsh { d, m }),
            (10, 8) if n != 15 => self.push(Op::Sel { d, n, m }),
            (11, 8) => self.push(Op::Clz { d, m }),
            _ => self.undefined(),
        }
    }

    /// Emits SXTH, SXTAH and the like: `m` rotated by `bytes`, extended, and added to `n`.
    fn extend(&mut self, group: u32, d: Index, n: Index, m: Index, bytes: u32) -> Then {
        let m = if bytes == 0 {
            m
        } else {
            self.push(Op::Ror { d: SCRATCH, m, by: 8 * bytes as u8 });
            SCRATCH
        };
        let to = if n == 15 { d } else { SCRATCH };
        self.push(match group {
            0 => Op::Sxth { d: to, m },
            1 => Op::Uxth { d: to, m },
            2 => Op::Sxtb16 { d: to, m },
            3 => Op::Uxtb16 { d: to, m },
            4 => Op::Sxtb { d: to, m },
            _ => Op::Uxtb { d: to, m },
        });
        match group {
            _ if n == 15 => Then::Next,
            2 | 3 => self.push(Op::AddHalves { d, n, m: SCRATCH }),
            _ => self.push(Op::Add { d, n, m: SCRATCH }),
        }
    }

    /// Multiplication with a result of 32 bits (A5.3.16).
    pub(super) fn multiply(&mut self, first: u16, second: u16) -> Then {
        let (n, a, d, m) = (index(first, 0), index(second, 12), index(second, 8), index(second, 0));
        let (group, what) = (bits(first, 4, 3), bits(second, 4, 2));
        if second & 0xC0 != 0 || d == 15 || n == 15 || m == 15 {
            return self.undefined();
        }
        let alone = a == 15;
        let a = if alone { ZERO } else { a };
        let exchanged = (what & 1) as u8;
        match (group, what) {
            (0, 0) if alone => self.push(Op::Mul { d, n, m }),
            (0, 0) => self.push(Op::Mla { d, n, m, a }),
            (0, 1) if !alone => self.push(Op::Mls { d, n, m, a }),
            (1, _) if alone => self.push(Op::SmulHalves { d, n, m, tops: what as u8 }),
            (1, _) => {
                self.push(Op::SmulHalves { d: SCRATCH, n, m, tops: what as u8 });
                self.push(Op::AddSticky { d, n: SCRATCH, m: a })
            }
            (2, 0 | 1) => self.push(Op::Dual { d, n, m, a, how: exchanged }),
            (3, 0 | 1) if alone => self.push(Op::SmulWide { d, n, m, top: what == 1 }),
            (3, 0 | 1) => {
                self.push(Op::SmulWide { d: SCRATCH, n, m, top: what == 1 });
                self.push(Op::AddSticky { d, n: SCRATCH, m: a })
            }
            (4, 0 | 1) => self.push(Op::Dual { d, n, m, a, how: 2 | exchanged }),
            (5, 0 | 1) => self.push(Op::Upper { d, n, m, a, how: exchanged }),
            (6, 0 | 1) if !alone => self.push(Op::Upper { d, n, m, a, how: 2 | exchanged }),
            (7, 0) if alone => self.push(Op::Usad8 { d, n, m }),
            (7, 0) => {
                self.push(Op::Usad8 { d: SCRATCH2, n, m });
                self.push(Op::Add { d, n: SCRATCH2, m: a })
            }
            _ => self.undefined(),
        }
    }

    /// Multiplication with a result of 64 bits, and division (A5.3.17).
    pub(super) fn long_multiply(&mut self, first: u16, second: u16) -> Then {
        let (n, low, high, m) = (index(first, 0), index(second, 12), index(second, 8), index(second, 0));
        let (group, what) = (bits(first, 4, 3), bits(second, 4, 4));
        if n == 15 || m == 15 || high == 15 {
            return self.undefined();
        }
        if what == 15 {
            return match group {
                1 if low == 15 => self.push(Op::Sdiv { d: high, n, m }),
                3 if low == 15 => self.push(Op::Udiv { d: high, n, m }),
                _ => self.undefined(),
            };
        }
        if low == 15 || low == high {
            return self.undefined();
        }
        let exchanged = (what & 1) as u8;
        match (group, what) {
            (0, 0) => self.push(Op::Smull { low, high, n, m }),
            (2, 0) => self.push(Op::Umull { low, high, n, m }),
            (4, 0) => self.push(Op::Smlal { low, high, n, m }),
            (6, 0) => self.push(Op::Umlal { low, high, n, m }),
            (6, 6) => self.push(Op::Umaal { low, high, n, m }),
            (4, 8..=11) => {
                self.push(Op::SmulHalves { d: SCRATCH, n, m, tops: (what & 3) as u8 });
                self.push(Op::AddLong { low, high, m: SCRATCH })
            }
            (4, 12 | 13) => self.push(Op::DualLong { low, high, n, m, how: exchanged }),
            (5, 12 | 13) => self.push(Op::DualLong { low, high, n, m, how: 2 | exchanged }),
            _ => self.undefined(),
        }
    }
}

/// Moves imm4 of MOVW and MOVT to its place in the constant.
fn bits_of(n: u32) -> u32 {
    n << 12
}

#[cfg(test)]
mod tests {
    use super::expanded;

    #[test]
    fn constants_are_expanded_as_the_manual_says() {
        // Expected values are those of A5.3.2, table A5-11.
        assert_eq!(expanded(0x0AB), (0xAB, None));
        assert_eq!(expanded(0x1AB), (0x00AB_00AB, None));
        assert_eq!(expanded(0x2AB), (0xAB00_AB00, None));
        assert_eq!(expanded(0x3AB), (0xABAB_ABAB, None));
        // Rotated by 8: 1bcdefgh at the top; by 31: at the bottom, one to the left.
        assert_eq!(expanded(0x42B), (0xAB00_0000, Some(true)));
        assert_eq!(expanded(0xFAB), (0x156, Some(false)));
    }
}
