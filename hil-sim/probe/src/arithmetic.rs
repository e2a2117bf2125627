//! Calculations without processor-specific code: the tests on a PC include this file and compute the same.

/// Digest of a sequence of 64-bit floating-point operations, every one rounded, from the bits of the results.
#[must_use]
pub(crate) fn double_digest(rounds: u32) -> u64 {
    let mut state = 0x2545_F491_4F6C_DD1D_u64;
    let mut sum = 1.0_f64;
    let mut digest = 0_u64;
    for _ in 0..rounds {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        // In the ranges 1..2 and -0.5..0.5.
        let a = f64::from_bits(0x3FF0_0000_0000_0000 | state >> 12);
        let b = f64::from_bits(0x3FF0_0000_0000_0000 | state << 20 >> 12) - 1.5;
        sum = sum * 0.75 + a / (b + 3.0) - b * a;
        digest = digest.rotate_left(7) ^ sum.to_bits();
        digest ^= u64::from((sum * 1000.0) as i32 as u32) ^ u64::from((sum as f32).to_bits());
    }
    digest
}

/// Digest of the same kind for 32 bits.
#[must_use]
pub(crate) fn single_digest(rounds: u32) -> u32 {
    let mut state = 0x9E37_79B9_u32;
    let mut sum = 1.0_f32;
    let mut digest = 0_u32;
    for _ in 0..rounds {
        state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let a = f32::from_bits(0x3F80_0000 | state >> 9);
        let b = (state >> 8) as f32 / 16_777_216.0 - 0.5;
        sum = sum * 0.75 + a / (b + 3.0) - b * a;
        digest = digest.rotate_left(5) ^ sum.to_bits() ^ (sum * 100.0) as i32 as u32;
    }
    digest
}

/// Digest of 64-bit multiplications and divisions, shifts and leading zeros: typical compiled integer code.
#[must_use]
pub(crate) fn integer_digest(rounds: u32) -> u32 {
    let mut state = 0x1234_5678_9ABC_DEF1_u64;
    let mut digest = 0_u32;
    for round in 0..rounds {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
        let (high, low) = ((state >> 32) as u32, state as u32);
        let quotient = high / (low >> 20 | 1);
        let signed = (high as i32).wrapping_div((low as i32 >> 16) | 1);
        let shifted = (state >> (round % 64)) as u32;
        digest = digest.rotate_left(3)
            ^ quotient
            ^ (signed as u32).wrapping_mul(3)
            ^ shifted
            ^ low.leading_zeros()
            ^ high.reverse_bits()
            ^ low.swap_bytes()
            ^ ((u64::from(high) * u64::from(low)) >> 17) as u32;
    }
    digest
}
