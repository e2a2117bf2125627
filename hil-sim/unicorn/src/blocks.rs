//! Blocks of instructions as the translator created them: number of instructions, and the special ones among them.

use std::cell::Cell;

/// Halfwords of code from an address on.
pub(crate) type Code<'a> = &'a [Cell<u8>];

/// Block of decoded instructions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Block {
    /// Address of its first instruction.
    pub(crate) address: u32,
    /// Address of the first floating-point instruction; [`Block::NOWHERE`] for none.
    float: u32,
    /// Length in bytes: a block does not leave its page of 4 KiB.
    bytes: u16,
    /// Number of instructions in it.
    pub(crate) instructions: u16,
    /// True if it contains SEV.
    pub(crate) event: bool,
    /// True if it may set the exclusive monitor: it contains LDREX or the like.
    pub(crate) claims: bool,
    /// True if it leaves the exclusive monitor clear when executed to its end.
    pub(crate) releases: bool,
}

impl Block {
    /// Empty block, of no bytes.
    pub(crate) const NONE: Self = Self {
        address: u32::MAX,
        float: Self::NOWHERE,
        bytes: 0,
        instructions: 0,
        event: false,
        claims: false,
        releases: false,
    };

    const NOWHERE: u32 = u32::MAX;

    /// Length of the block, bytes.
    pub(crate) fn bytes(&self) -> u32 {
        self.bytes.into()
    }

    /// Address of the first floating-point instruction; `None` without one.
    pub(crate) fn float(&self) -> Option<u32> {
        (self.float != Self::NOWHERE).then_some(self.float)
    }

    /// Address behind the block.
    pub(crate) fn end(&self) -> u32 {
        self.address.wrapping_add(self.bytes())
    }

    /// Decodes `code`, which begins at `address`. A truncated last instruction counts.
    pub(crate) fn decode(address: u32, code: Code<'_>) -> Self {
        let mut block = Self { address, bytes: code.len() as u16, ..Self::NONE };
        let (mut at, mut conditional) = (0, false);
        while let Some(first) = halfword(code, at) {
            let second = if is_wide(first) { halfword(code, at + 2) } else { None };
            block.instructions += 1;
            block.event |= is_hint(first, second, SEV);
            // Coprocessors 10 and 11 are the floating-point unit (DDI0403E A5.3.18, A6).
            let coprocessor = first & 0xEC00 == 0xEC00 && second.is_some_and(|half| matches!(half >> 8 & 15, 10 | 11));
            if coprocessor && block.float == Self::NOWHERE {
                block.float = address + at as u32;
            }
            // IT has a mask that is not zero (A5.2.5): the following instructions may be skipped.
            conditional |= first & 0xFF00 == 0xBF00 && first & 0xF != 0;
            match exclusive(first, second) {
                Some(true) => (block.claims, block.releases) = (true, false),
                Some(false) => block.releases = !conditional,
                None => {}
            }
            at += if is_wide(first) { 4 } else { 2 };
        }
        block
    }
}

/// Operand of the hint instruction YIELD (DDI0403E A5.2.5).
pub(crate) const YIELD: u16 = 1;
/// Operand of the hint instruction WFE.
pub(crate) const WFE: u16 = 2;
/// Operand of the hint instruction WFI.
pub(crate) const WFI: u16 = 3;
/// Operand of the hint instruction SEV.
pub(crate) const SEV: u16 = 4;

/// Returns true if the instruction has two halfwords (A5.1).
pub(crate) fn is_wide(first: u16) -> bool {
    first >> 11 >= 0b11101
}

/// Effect of an instruction on the exclusive monitor: LDREX, LDREXB, LDREXH claim (true); STREX, STREXB, STREXH, CLREX
/// release (false) (A5.3.6; A7.7.22); `None` for all others.
fn exclusive(first: u16, second: Option<u16>) -> Option<bool> {
    let second = second?;
    match first & 0xFFF0 {
        0xE850 => Some(true),
        0xE840 => Some(false),
        // Table branches share this encoding space.
        0xE8D0 if second & 0x40 != 0 => Some(true),
        0xE8C0 if second & 0x40 != 0 => Some(false),
        0xF3B0 if second & 0xFFF0 == 0x8F20 => Some(false),
        _ => None,
    }
}

/// Halfword at an offset; `None` past the end.
pub(crate) fn halfword(code: Code<'_>, at: usize) -> Option<u16> {
    Some(u16::from_le_bytes([code.get(at)?.get(), code.get(at + 1)?.get()]))
}

/// Returns true if the instruction is this hint, in either encoding (A7.7.263 ff.: T1 and T2).
pub(crate) fn is_hint(first: u16, second: Option<u16>, hint: u16) -> bool {
    first == 0xBF00 | hint << 4 || first == 0xF3AF && second == Some(0x8000 | hint)
}

/// Cache of blocks by address. A later block may replace an earlier one, which is then decoded again when needed.
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

    /// Returns the block, decoded by `decode` if it is not in the cache.
    #[inline]
    pub(crate) fn get(&mut self, address: u32, bytes: u32, decode: impl FnOnce() -> Block) -> &Block {
        // The slot depends on the length too, so that parts of one block have different slots.
        let slot = &mut self.blocks[address.wrapping_add(bytes) as usize / 2 % Self::LEN];
        if slot.address != address || slot.bytes() != bytes {
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
        assert_eq!((block.instructions, block.end(), block.event, block.float()), (4, 0x10C, false, None));
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
        assert_eq!((block.instructions, block.float()), (3, Some(0x202)));
        // MCR to another coprocessor; ldrd is not a coprocessor instruction.
        assert_eq!(Block::decode(0, &code(&[0xEE01, 0x0F10, 0xE9D0, 0x0A00])).float(), None);
    }

    #[test]
    fn what_a_block_does_with_the_exclusive_monitor_is_seen() {
        let of = |halfwords: &[u16]| {
            let block = Block::decode(0, &code(halfwords));
            (block.claims, block.releases)
        };
        // ldrex r0,[r1]; strex r2,r0,[r1]; both; clrex.
        assert_eq!(of(&[0xE851, 0x0F00]), (true, false));
        assert_eq!(of(&[0xE841, 0x0200]), (false, true));
        assert_eq!(of(&[0xE851, 0x0F00, 0xE841, 0x0200]), (true, true));
        assert_eq!(of(&[0xF3BF, 0x8F2F]), (false, true));
        // The first two are ldrexb r0,[r1] and strexh r2,r0,[r1]; tbb [pc,r0] is neither.
        assert_eq!(of(&[0xE8D1, 0x0F4F]), (true, false));
        assert_eq!(of(&[0xE8C1, 0x0F52]), (false, true));
        assert_eq!(of(&[0xE8DF, 0xF000]), (false, false));
        // The `strexeq r2,r0,[r1]` behind `it eq` may be skipped.
        assert_eq!(of(&[0xBF08, 0xE841, 0x0200]), (false, false));
    }
}
