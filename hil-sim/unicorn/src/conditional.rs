//! IT blocks (DDI0403E A7.7.38), within which the translator cannot stop.

use crate::blocks::{Code, halfword, is_wide};

/// Length of the longest IT block, bytes: IT and four instructions of four bytes.
pub(crate) const LONGEST: u32 = 2 + 4 * 4;

/// Number of instructions that an instruction makes conditional; 0 if it is not IT.
fn conditional(first: u16) -> u32 {
    match first {
        0xBF00..=0xBFFF if first & 0xF != 0 => 4 - u32::from(first).trailing_zeros(),
        _ => 0,
    }
}

fn len(first: u16) -> usize {
    if is_wide(first) { 4 } else { 2 }
}

/// Returns true if the instruction at an offset is in an IT block, but not the IT itself. `code` begins with an
/// instruction outside of one.
pub(crate) fn is_within(code: Code<'_>, offset: usize) -> bool {
    let (mut at, mut left) = (0, 0);
    while let (true, Some(first)) = (at < offset, halfword(code, at)) {
        left = if left > 0 { left - 1 } else { conditional(first) };
        at += len(first);
    }
    left > 0
}

/// Returns true if `code` begins with IT, whose block contains the instruction at an offset.
pub(crate) fn holds(code: Code<'_>, offset: usize) -> bool {
    let Some(first) = halfword(code, 0) else { return false };
    let mut at = 2;
    for _ in 0..conditional(first) {
        if at == offset {
            return true;
        }
        at += halfword(code, at).map_or(2, len);
    }
    false
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;

    use super::*;

    fn code(halfwords: &[u16]) -> Vec<Cell<u8>> {
        halfwords.iter().flat_map(|half| half.to_le_bytes()).map(Cell::new).collect()
    }

    #[test]
    fn an_it_block_is_as_long_as_its_mask_says() {
        // Code: cmp r1,#0; ite ge; movge r5,#1; movlt.w r5,#2; nop.
        let code = code(&[0x2900, 0xBFAC, 0x2501, 0xF04F, 0x0502, 0xBF00]);
        let within = [0, 2, 4, 6, 10].map(|offset| is_within(&code, offset));
        assert_eq!(within, [false, false, true, true, false]);
        let held = [0, 2, 4, 6, 8].map(|offset| holds(&code[2..], offset));
        assert_eq!(held, [false, true, true, false, false]);
        assert!(!holds(&code, 2), "not IT");
    }
}
