//! Blocks of instructions, as the translator made them: how many instructions they hold, and which of them matter.

use std::cell::Cell;

/// Halfwords of code from an address on.
pub(crate) type Code<'a> = &'a [Cell<u8>];

/// A block that was decoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Block {
    /// Its first instruction.
    pub(crate) address: u32,
    /// Bytes.
    pub(crate) bytes: u32,
    /// Instructions.
    pub(crate) instructions: u32,
    /// SEV is among them.
    pub(crate) event: bool,
    /// The first floating-point instruction.
    pub(crate) float: Option<u32>,
}

impl Block {
    /// No block: of no bytes.
    pub(crate) const NONE: Self = Self { address: u32::MAX, bytes: 0, instructions: 0, event: false, float: None };

    /// The address after it.
    pub(crate) fn end(&self) -> u32 {
        self.address.wrapping_add(self.bytes)
    }

    /// Decodes `code`, which begins at `address`. An instruction cut by the end counts.
    pub(crate) fn decode(address: u32, code: Code<'_>) -> Self {
        let mut block = Self { address, bytes: code.len() as u32, instructions: 0, event: false, float: None };
        let mut at = 0;
        while let Some(first) = halfword(code, at) {
            let second = if is_wide(first) { halfword(code, at + 2) } else { None };
            block.instructions += 1;
            block.event |= is_hint(first, second, SEV);
            // Coprocessors 10 and 11 are the floating-point unit (DDI0403E A5.3.18, A6).
            let coprocessor = first & 0xEC00 == 0xEC00 && second.is_some_and(|half| matches!(half >> 8 & 15, 10 | 11));
            if coprocessor && block.float.is_none() {
                block.float = Some(address + at as u32);
            }
            at += if is_wide(first) { 4 } else { 2 };
        }
        block
    }
}

/// Operands of the hint instructions (DDI0403E A5.2.5).
pub(crate) const YIELD: u16 = 1;
/// As [`YIELD`].
pub(crate) const WFE: u16 = 2;
/// As [`YIELD`].
pub(crate) const WFI: u16 = 3;
/// As [`YIELD`].
pub(crate) const SEV: u16 = 4;

/// The instruction has two halfwords (A5.1).
pub(crate) fn is_wide(first: u16) -> bool {
    first >> 11 >= 0b11101
}

/// The halfword at an offset; `None` past the end.
pub(crate) fn halfword(code: Code<'_>, at: usize) -> Option<u16> {
    Some(u16::from_le_bytes([code.get(at)?.get(), code.get(at + 1)?.get()]))
}

/// The instruction is this hint, in either encoding (A7.7.263 ff.: T1 and T2).
pub(crate) fn is_hint(first: u16, second: Option<u16>, hint: u16) -> bool {
    first == 0xBF00 | hint << 4 || first == 0xF3AF && second == Some(0x8000 | hint)
}

/// Blocks by address. A later one takes the place of an earlier one: what is missing is decoded again.
pub(crate) struct Cache {
    blocks: Vec<Block>,
}

impl Cache {
    const LEN: usize = 1 << 14;

    pub(crate) fn new() -> Self {
        Self { blocks: vec![Block::NONE; Self::LEN] }
    }

    pub(crate) fn clear(&mut self) {
        self.blocks.fill(Block::NONE);
    }

    /// The block, decoded by `decode` where it is not known.
    #[inline]
    pub(crate) fn get(&mut self, address: u32, bytes: u32, decode: impl FnOnce() -> Block) -> &Block {
        let slot = &mut self.blocks[address as usize / 2 % Self::LEN];
        if slot.address != address || slot.bytes != bytes {
            *slot = decode();
        }
        slot
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn code(halfwords: &[u16]) -> Vec<Cell<u8>> {
        halfwords.iter().flat_map(|half| half.to_le_bytes()).map(Cell::new).collect()
    }

    #[test]
    fn narrow_and_wide_instructions_are_told_apart() {
        // movs r0,#1; movw r1,#0x1234; bl .; b .
        let block = Block::decode(0x100, &code(&[0x2001, 0xF241, 0x2134, 0xF7FF, 0xFFFE, 0xE7FE]));
        assert_eq!((block.instructions, block.end(), block.event, block.float), (4, 0x10C, false, None));
    }

    #[test]
    fn sev_is_seen_in_both_encodings_and_only_as_an_instruction() {
        assert!(Block::decode(0, &code(&[0x2001, 0xBF40])).event);
        assert!(Block::decode(0, &code(&[0xF3AF, 0x8004])).event);
        // WFE, and a movw whose second halfword looks like SEV.
        assert!(!Block::decode(0, &code(&[0xBF20, 0xF241, 0xBF40])).event);
    }

    #[test]
    fn the_first_floating_point_instruction_is_found() {
        // nop; vadd.f32 s0,s0,s1; vldr d0,[r0]
        let block = Block::decode(0x200, &code(&[0xBF00, 0xEE30, 0x0A20, 0xED90, 0x0B00]));
        assert_eq!((block.instructions, block.float), (3, Some(0x202)));
        // MCR to another coprocessor; ldrd is not a coprocessor's.
        assert_eq!(Block::decode(0, &code(&[0xEE01, 0x0F10, 0xE9D0, 0x0A00])).float, None);
    }
}
