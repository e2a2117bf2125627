//! Accesses that are narrower than a register.

use crate::peripheral::Size;

const fn mask(size: Size) -> u32 {
    match size {
        Size::Byte => 0xff,
        Size::Half => 0xffff,
        Size::Word => u32::MAX,
    }
}

/// Returns the bits of a 32-bit register that a read of `size` at `offset` gives, right-aligned.
pub(crate) const fn part(register: u32, offset: u32, size: Size) -> u32 {
    (register >> (8 * (offset & 3))) & mask(size)
}

/// Returns a 32-bit register's value after a write of `size` at `offset`; the other bits are those of `register`.
pub(crate) const fn merge(register: u32, offset: u32, size: Size, value: u32) -> u32 {
    let shift = 8 * (offset & 3);
    register & !(mask(size) << shift) | (value & mask(size)) << shift
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_and_bytes_of_a_register() {
        assert_eq!(part(0x1122_3344, 0x10, Size::Half), 0x3344);
        assert_eq!(part(0x1122_3344, 0x12, Size::Half), 0x1122);
        assert_eq!(part(0x1122_3344, 0x13, Size::Byte), 0x11);
        assert_eq!(merge(0x1122_3344, 0x10, Size::Half, 0xdead_beef), 0x1122_beef);
        assert_eq!(merge(0x1122_3344, 0x11, Size::Byte, 0xff), 0x1122_ff44);
        assert_eq!(merge(0x1122_3344, 0x10, Size::Word, 5), 5);
    }
}
