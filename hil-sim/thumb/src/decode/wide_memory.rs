//! Decoder for loads and stores of 32 bits: A5.3.5 to A5.3.10.

use super::{Instruction, Single, Then, bits, index};
use crate::operation::{Index, LOADED, Op, SCRATCH, SP, Width, ZERO};

impl Instruction<'_> {
    /// Emits the addition to a base register after the access.
    fn write_back(&mut self, n: Index, value: u32) {
        self.push(Op::AddValue { d: n, n, value });
        if n == SP && value & 3 != 0 {
            self.push(Op::AlignSp);
        }
    }

    /// Decodes multiple loads and stores: LDM, STM and relatives (A5.3.5).
    pub(super) fn multiple(&mut self, first: u16, second: u16) -> Then {
        let (n, list) = (index(first, 0), second);
        let (before, up, write_back, is_load) =
            (first & 0x100 != 0, first & 0x80 != 0, first & 0x20 != 0, first & 0x10 != 0);
        let to_pc = list >> LOADED != 0;
        let unpredictable = n == 15
            || list == 0
            || list >> SP & 1 != 0
            || write_back && list >> n & 1 != 0
            || to_pc && (!is_load || list >> 14 & 1 != 0);
        // ARMv7-M does not have SRS and RFE.
        if before == up || unpredictable {
            return self.undefined();
        }
        let bytes = 4 * list.count_ones();
        let offset = if up { 0 } else { -(bytes as i8) };
        match (is_load, up, n, write_back) {
            (true, true, SP, true) => {
                self.push(Op::Pop { list });
            }
            (false, false, SP, true) => {
                self.push(Op::Push { list });
            }
            _ => {
                self.push(if is_load { Op::Ldm { n, list, offset } } else { Op::Stm { n, list, offset } });
                if write_back {
                    self.write_back(n, if up { bytes } else { bytes.wrapping_neg() });
                }
            }
        }
        if to_pc { self.end(Op::Exchange { m: LOADED }) } else { Then::Next }
    }

    /// Loads and stores of two words, exclusive accesses and table branches (A5.3.6).
    pub(super) fn dual_or_exclusive(&mut self, first: u16, second: u16) -> Then {
        let (before, up, write_back, is_load) =
            (first & 0x100 != 0, first & 0x80 != 0, first & 0x20 != 0, first & 0x10 != 0);
        if !before && !write_back {
            return self.exclusive(first, second, up, is_load);
        }
        let (n, t, other) = (index(first, 0), index(second, 12), index(second, 8));
        // A base that is also transferred, and PC as base with write-back, are UNPREDICTABLE.
        let written = write_back && (n == 15 || n == t || n == other);
        let not_data = |register| matches!(register, 13 | 15);
        if written || not_data(t) || not_data(other) || is_load && t == other || !is_load && n == 15 {
            return self.undefined();
        }
        let distance = bits(second, 0, 8) * 4;
        let distance = if up { distance } else { distance.wrapping_neg() };
        if n == 15 {
            let offset = self.aligned_pc().wrapping_add(distance);
            return self.push(Op::Ldrd { t, second: other, n: ZERO, offset });
        }
        let offset = if before { distance } else { 0 };
        self.push(if is_load {
            Op::Ldrd { t, second: other, n, offset }
        } else {
            Op::Strd { t, second: other, n, offset }
        });
        if write_back {
            self.write_back(n, distance);
        }
        Then::Next
    }

    /// Decodes exclusive accesses and table branches: LDREX, STREX, TBB and the like.
    fn exclusive(&mut self, first: u16, second: u16, up: bool, is_load: bool) -> Then {
        let (n, t, m) = (index(first, 0), index(second, 12), index(second, 0));
        let width = match bits(second, 4, 4) {
            _ if !up => Width::Word,
            4 => Width::Byte,
            5 => Width::Half,
            kind @ (0 | 1) if is_load && m != 15 => {
                let next = self.address.wrapping_add(4);
                let n = if n == 15 {
                    self.push(Op::Value { d: SCRATCH, value: next });
                    SCRATCH
                } else {
                    n
                };
                return self.end(Op::Table { half: kind == 1, n, m, next });
            }
            _ => return self.undefined(),
        };
        let not_data = |register| matches!(register, 13 | 15);
        if n == 15 || not_data(t) {
            return self.undefined();
        }
        let words = if up { 0 } else { bits(second, 0, 8) as u8 };
        if is_load {
            return self.push(Op::Ldrex { width, t, n, offset: 4 * u16::from(words) });
        }
        let d = if up { m } else { index(second, 8) };
        if not_data(d) || d == n || d == t {
            return self.undefined();
        }
        self.push(Op::Strex { width, d, t, n, words })
    }

    /// Decodes stores of one register (A5.3.10).
    pub(super) fn store(&mut self, first: u16, second: u16) -> Then {
        let single = match bits(first, 5, 2) {
            0 => Single::Strb,
            1 => Single::Strh,
            2 => Single::Str,
            _ => return self.undefined(),
        };
        let (n, t) = (index(first, 0), index(second, 12));
        if n == 15 || t == 15 {
            return self.undefined();
        }
        self.addressed(single, t, n, first & 0x80 != 0, second)
    }

    /// Decodes loads of one register, and memory hints (A5.3.7 to A5.3.9).
    pub(super) fn load(&mut self, first: u16, second: u16) -> Then {
        let signed = first & 0x100 != 0;
        let single = match (bits(first, 5, 2), signed) {
            (0, false) => Single::Ldrb,
            (0, true) => Single::Ldrsb,
            (1, false) => Single::Ldrh,
            (1, true) => Single::Ldrsh,
            (2, false) => Single::Ldr,
            _ => return self.undefined(),
        };
        let (n, t, positive) = (index(first, 0), index(second, 12), first & 0x80 != 0);
        let to_pc = t == 15 && single == Single::Ldr;
        if t == 15 && !to_pc {
            // PLD, PLI and unallocated hints do nothing, because the model has no caches. There are no hints with
            // write-back.
            let hint = n == 15 || positive || second & 0xFC0 == 0 || second & 0xF00 == 0xC00;
            return if hint { Then::Next } else { self.undefined() };
        }
        let into = if to_pc { SCRATCH } else { t };
        let then = if n == 15 {
            let distance = bits(second, 0, 12);
            let distance = if positive { distance } else { distance.wrapping_neg() };
            let address = self.aligned_pc().wrapping_add(distance);
            self.single(single, into, ZERO, address);
            Then::Next
        } else {
            self.addressed(single, into, n, positive, second)
        };
        if then == Then::End {
            return then;
        }
        if to_pc { self.end(Op::Exchange { m: SCRATCH }) } else { self.wrote(t) }
    }

    /// Decodes the addressing mode: a positive offset of 12 bits, one of 8 with write-back, or a register.
    fn addressed(&mut self, single: Single, t: Index, n: Index, positive: bool, second: u16) -> Then {
        if positive {
            self.single(single, t, n, bits(second, 0, 12));
            return Then::Next;
        }
        if second & 0xFC0 == 0 {
            let m = index(second, 0);
            if m == 15 {
                return self.undefined();
            }
            self.single_by(single, t, n, m, bits(second, 4, 2) as u8);
            return Then::Next;
        }
        let (before, up, write_back) = (second & 0x400 != 0, second & 0x200 != 0, second & 0x100 != 0);
        if second & 0x800 == 0 || !before && !write_back || write_back && n == t {
            return self.undefined();
        }
        let distance = bits(second, 0, 8);
        let distance = if up { distance } else { distance.wrapping_neg() };
        self.single(single, t, n, if before { distance } else { 0 });
        if write_back {
            self.write_back(n, distance);
        }
        Then::Next
    }
}
