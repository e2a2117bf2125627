//! Decoder for instructions of 16 bits (DDI0403E A5.2).

use super::{Instruction, Single, Then, bits, data, index, signed};
use crate::operation::{Index, LOADED, LR, NONE, Op, SCRATCH, SP, ZERO};

/// Extracts the number of a low register, R0 to R7.
fn low(word: u16, lowest: u32) -> Index {
    bits(word, lowest, 3) as Index
}

impl Instruction<'_> {
    pub(super) fn narrow(&mut self, code: u16) -> Then {
        let value = bits(code, 0, 8);
        match code >> 10 {
            0b00_0000..=0b00_1111 => self.arithmetic(code),
            0b01_0000 => self.data_processing(code),
            0b01_0001 => self.special(code),
            0b01_0010 | 0b01_0011 => {
                let address = self.aligned_pc().wrapping_add(value * 4);
                self.single(Single::Ldr, low(code, 8), ZERO, address);
                Then::Next
            }
            0b01_0100..=0b10_0111 => self.load_store(code),
            // ADR; ADD (SP plus immediate).
            0b10_1000 | 0b10_1001 => {
                let value = self.aligned_pc().wrapping_add(value * 4);
                self.push(Op::Value { d: low(code, 8), value })
            }
            0b10_1010 | 0b10_1011 => self.push(Op::AddValue { d: low(code, 8), n: SP, value: value * 4 }),
            0b10_1100..=0b10_1111 => self.miscellaneous(code),
            0b11_0000..=0b11_0011 => self.narrow_multiple(code),
            0b11_0100..=0b11_0111 => match bits(code, 8, 4) {
                14 => self.undefined(),
                15 => self.end(Op::Svc),
                condition => {
                    let target = self.pc().wrapping_add(signed(value, 8) << 1);
                    self.branch_if(condition as u8, target)
                }
            },
            // B; the rest of this range is wide.
            _ => {
                let target = self.pc().wrapping_add(signed(bits(code, 0, 11), 11) << 1);
                self.end(Op::Branch { target })
            }
        }
    }

    /// Shift, add, subtract, move and compare (A5.2.1).
    fn arithmetic(&mut self, code: u16) -> Then {
        let s = !self.conditional;
        let (d, m, value) = (low(code, 0), low(code, 3), bits(code, 0, 8));
        let (amount, third, n) = (bits(code, 6, 5), low(code, 6), low(code, 8));
        match bits(code, 9, 5) {
            0b0_0000..=0b0_1011 => self.shift(s, d, m, bits(code, 11, 2), amount),
            0b0_1100 => self.data(data::ADD, s, d, m, third),
            0b0_1101 => self.data(data::SUB, s, d, m, third),
            0b0_1110 => self.data_value(data::ADD, s, d, m, third.into()),
            0b0_1111 => self.data_value(data::SUB, s, d, m, third.into()),
            0b1_0000..=0b1_0011 => self.data_value(data::ORR, s, n, ZERO, value),
            0b1_0100..=0b1_0111 => self.data_value(data::SUB, true, NONE, n, value),
            0b1_1000..=0b1_1011 => self.data_value(data::ADD, s, n, n, value),
            _ => self.data_value(data::SUB, s, n, n, value),
        }
    }

    /// Data processing of two registers (A5.2.2).
    fn data_processing(&mut self, code: u16) -> Then {
        let s = !self.conditional;
        let (d, m) = (low(code, 0), low(code, 3));
        let shift = |kind| if s { Op::ShiftBys { kind, d, n: d, m } } else { Op::ShiftBy { kind, d, n: d, m } };
        match bits(code, 6, 4) {
            0 => self.data(data::AND, s, d, d, m),
            1 => self.data(data::EOR, s, d, d, m),
            2 => self.push(shift(0)),
            3 => self.push(shift(1)),
            4 => self.push(shift(2)),
            5 => self.data(data::ADC, s, d, d, m),
            6 => self.data(data::SBC, s, d, d, m),
            7 => self.push(shift(3)),
            8 => self.data(data::AND, true, NONE, d, m),
            9 => self.data(data::SUB, s, d, ZERO, m),
            10 => self.data(data::SUB, true, NONE, d, m),
            11 => self.data(data::ADD, true, NONE, d, m),
            12 => self.data(data::ORR, s, d, d, m),
            13 if s => self.push(Op::Muls { d, n: d, m }),
            13 => self.push(Op::Mul { d, n: d, m }),
            14 => self.data(data::BIC, s, d, d, m),
            _ => self.data(data::ORN, s, d, ZERO, m),
        }
    }

    /// Operations on high registers, BX and BLX (A5.2.3).
    fn special(&mut self, code: u16) -> Then {
        let (d, m) = (low(code, 0) | (bits(code, 7, 1) << 3) as u8, index(code, 3));
        match (bits(code, 8, 2), d, m) {
            (0, 15, 15) => self.undefined(),
            (0, 15, _) => {
                let value = self.pc();
                self.push(Op::AddValue { d: SCRATCH, n: m, value });
                self.end(Op::BranchTo { m: SCRATCH })
            }
            (0, _, 15) => {
                let value = self.pc();
                self.data_value(data::ADD, false, d, d, value)
            }
            (0, ..) => self.data(data::ADD, false, d, d, m),
            (1, 15, _) | (1, _, 15) => self.undefined(),
            (1, ..) => self.data(data::SUB, true, NONE, d, m),
            (2, 15, 15) => {
                let target = self.pc();
                self.end(Op::Branch { target })
            }
            (2, 15, _) => self.end(Op::BranchTo { m }),
            (2, _, 15) => {
                let value = self.pc();
                self.data_value(data::ORR, false, d, ZERO, value)
            }
            (2, ..) => self.data(data::ORR, false, d, ZERO, m),
            // BX, BLX.
            (_, _, 15) => self.undefined(),
            _ if code & 0x80 == 0 => self.end(Op::Exchange { m }),
            _ => self.end(Op::CallExchange { m }),
        }
    }

    /// Loads and stores of one register (A5.2.4).
    fn load_store(&mut self, code: u16) -> Then {
        const BY: [Single; 8] = [
            Single::Str,
            Single::Strh,
            Single::Strb,
            Single::Ldrsb,
            Single::Ldr,
            Single::Ldrh,
            Single::Ldrb,
            Single::Ldrsh,
        ];
        let load = code & 0x800 != 0;
        let (t, n, offset) = (low(code, 0), low(code, 3), bits(code, 6, 5));
        let either = |store, from| if load { from } else { store };
        match code >> 12 {
            5 => self.single_by(BY[bits(code, 9, 3) as usize], t, n, low(code, 6), 0),
            6 => self.single(either(Single::Str, Single::Ldr), t, n, offset * 4),
            7 => self.single(either(Single::Strb, Single::Ldrb), t, n, offset),
            8 => self.single(either(Single::Strh, Single::Ldrh), t, n, offset * 2),
            _ => self.single(either(Single::Str, Single::Ldr), low(code, 8), SP, bits(code, 0, 8) * 4),
        }
        Then::Next
    }

    /// Multiple loads and stores: STM (A7.7.159) and LDM (A7.7.41).
    fn narrow_multiple(&mut self, code: u16) -> Then {
        let (n, list) = (low(code, 8), code & 0xFF);
        if list == 0 {
            return self.undefined();
        }
        let value = 4 * list.count_ones();
        if code & 0x800 == 0 {
            self.push(Op::Stm { n, list, offset: 0 });
            return self.push(Op::AddValue { d: n, n, value });
        }
        self.push(Op::Ldm { n, list, offset: 0 });
        if list >> n & 1 == 0 {
            self.push(Op::AddValue { d: n, n, value });
        }
        Then::Next
    }

    /// Miscellaneous instructions: stack, extension, hints, CBZ, IT (A5.2.5).
    fn miscellaneous(&mut self, code: u16) -> Then {
        let (d, m) = (low(code, 0), low(code, 3));
        match code >> 8 & 0xF {
            0 => {
                let value = bits(code, 0, 7) * 4;
                self.data_value(if code & 0x80 == 0 { data::ADD } else { data::SUB }, false, SP, SP, value)
            }
            1 | 3 | 9 | 11 => {
                let target = self.pc().wrapping_add(bits(code, 3, 5) << 1 | bits(code, 9, 1) << 6);
                let n = low(code, 0);
                self.end(if code & 0x800 == 0 { Op::BranchZero { n, target } } else { Op::BranchNotZero { n, target } })
            }
            2 => self.push(match bits(code, 6, 2) {
                0 => Op::Sxth { d, m },
                1 => Op::Sxtb { d, m },
                2 => Op::Uxth { d, m },
                _ => Op::Uxtb { d, m },
            }),
            4 | 5 => match code & 0xFF | (bits(code, 8, 1) as u16) << LR {
                0 => self.undefined(),
                list => self.push(Op::Push { list }),
            },
            6 if code & 0xE8 == 0x60 => self.end(Op::Cps { disable: code & 0x10 != 0, what: (code & 3) as u8 }),
            10 => match bits(code, 6, 2) {
                0 => self.push(Op::Rev { d, m }),
                1 => self.push(Op::Rev16 { d, m }),
                3 => self.push(Op::Revsh { d, m }),
                _ => self.undefined(),
            },
            12 | 13 => match code & 0xFF | (bits(code, 8, 1) as u16) << LOADED {
                0 => self.undefined(),
                list if list >> LOADED == 0 => self.push(Op::Pop { list }),
                list => {
                    self.push(Op::Pop { list });
                    self.end(Op::Exchange { m: LOADED })
                }
            },
            14 => self.end(Op::Bkpt { operand: code as u8 }),
            // An IT within an IT block is undefined.
            15 if code & 0xF != 0 => self.undefined(),
            15 => self.hint(bits(code, 4, 4)),
            _ => self.undefined(),
        }
    }

    /// Decodes hints (A5.2.5, A5.3.4); unknown ones do nothing.
    pub(super) fn hint(&mut self, number: u32) -> Then {
        match number {
            1 => self.end(Op::Yield),
            2 => self.end(Op::Wfe),
            3 => self.end(Op::Wfi),
            4 => self.push(Op::Sev),
            _ => Then::Next,
        }
    }
}
