//! Decoder for instructions of 32 bits (DDI0403E A5.3): selection of the group, branches and control.

use super::{Instruction, Then, bits, index, signed};
use crate::operation::Op;

impl Instruction<'_> {
    pub(super) fn wide(&mut self, first: u16, second: u16) -> Then {
        match (bits(first, 11, 2), bits(first, 4, 7)) {
            (1, group) if group & 0x64 == 0 => self.multiple(first, second),
            (1, group) if group & 0x64 == 4 => self.dual_or_exclusive(first, second),
            (1, group) if group & 0x60 == 0x20 => self.shifted_register(first, second),
            (1, _) => self.coprocessor(first, second),
            (2, _) if second & 0x8000 != 0 => self.branch_or_control(first, second),
            (2, group) if group & 0x20 == 0 => self.modified_immediate(first, second),
            (2, _) => self.plain_immediate(first, second),
            (_, group) if group & 0x71 == 0 => self.store(first, second),
            (_, group) if group & 0x61 == 1 => self.load(first, second),
            (_, group) if group & 0x70 == 0x20 => self.register(first, second),
            (_, group) if group & 0x78 == 0x30 => self.multiply(first, second),
            (_, group) if group & 0x78 == 0x38 => self.long_multiply(first, second),
            (_, group) if group & 0x40 != 0 => self.coprocessor(first, second),
            _ => self.undefined(),
        }
    }

    /// Branches and miscellaneous control (A5.3.4).
    fn branch_or_control(&mut self, first: u16, second: u16) -> Then {
        let sign = bits(first, 10, 1);
        let (j1, j2) = (bits(second, 13, 1), bits(second, 11, 1));
        let low = bits(second, 0, 11) << 1;
        // B T4, BL T1: J bits are inverted where the sign is zero.
        let far = || {
            let (i1, i2) = (!(j1 ^ sign) & 1, !(j2 ^ sign) & 1);
            signed(sign << 24 | i1 << 23 | i2 << 22 | bits(first, 0, 10) << 12 | low, 25)
        };
        match (second & 0x4000 != 0, second & 0x1000 != 0) {
            (false, true) => {
                let target = self.pc().wrapping_add(far());
                self.end(Op::Branch { target })
            }
            (true, true) => {
                let target = self.pc().wrapping_add(far());
                self.end(Op::Call { target })
            }
            (true, false) => self.undefined(),
            (false, false) if bits(first, 7, 3) != 7 => {
                let offset = signed(sign << 20 | j2 << 19 | j1 << 18 | bits(first, 0, 6) << 12 | low, 21);
                let target = self.pc().wrapping_add(offset);
                self.branch_if(bits(first, 6, 4) as u8, target)
            }
            (false, false) => self.control(first, second),
        }
    }

    /// Decodes MSR, MRS, hints and barriers.
    fn control(&mut self, first: u16, second: u16) -> Then {
        let special = second as u8;
        match (first & 0xFFF0, first & 0xF) {
            (0xF380, n) if second & 0x3300 == 0 && n < 15 => {
                self.end(Op::Msr { n: n as u8, special, mask: bits(second, 10, 2) as u8 })
            }
            (0xF3A0, 15) if second & 0x2F00 == 0 => self.hint(bits(second, 0, 8)),
            (0xF3B0, 15) if second & 0x2F00 == 0x0F00 => match bits(second, 4, 4) {
                2 => self.push(Op::Clrex),
                // DSB and DMB need no action: accesses are made in order, one after the other.
                4 | 5 => Then::Next,
                6 => Then::End,
                _ => self.undefined(),
            },
            (0xF3E0, 15) if second & 0x2000 == 0 && !matches!(index(second, 8), 13 | 15) => {
                self.push(Op::Mrs { d: index(second, 8), special })
            }
            _ => self.undefined(),
        }
    }
}
