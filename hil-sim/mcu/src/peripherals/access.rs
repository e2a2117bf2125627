//! Byte and half-word accesses to 32-bit registers.

use crate::Size;

/// Returns the part of a register that an access of `size` at `offset` reads, right-aligned.
pub(crate) fn part(word: u32, offset: u32, size: Size) -> u32 {
    let shifted = word >> (8 * (offset & 3));
    match size {
        Size::Byte => shifted & 0xFF,
        Size::Half => shifted & 0xFFFF,
        Size::Word => shifted,
    }
}

/// Returns the register after a write of a part; the other bits are those of `word`.
pub(crate) fn merged(word: u32, offset: u32, size: Size, value: u32) -> u32 {
    let shift = 8 * (offset & 3);
    let mask = match size {
        Size::Byte => 0xFF_u32,
        Size::Half => 0xFFFF,
        Size::Word => u32::MAX,
    } << shift;
    word & !mask | value << shift & mask
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_byte_and_a_half_word_are_where_little_endian_has_them() {
        assert_eq!(part(0x4433_2211, 2, Size::Byte), 0x33);
        assert_eq!(part(0x4433_2211, 2, Size::Half), 0x4433);
        assert_eq!(merged(0x4433_2211, 1, Size::Byte, 0xAA), 0x4433_AA11);
        assert_eq!(merged(0x4433_2211, 2, Size::Half, 0xBBAA), 0xBBAA_2211);
        assert_eq!(merged(0x4433_2211, 0, Size::Word, 7), 7);
    }
}
