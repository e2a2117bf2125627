//! Execution of multiplications of halfwords, and of double words (DDI0403E A4.4.2).

use crate::operation::{COUNT, Index};
use crate::state::State;

/// Extracts a halfword with its sign.
fn half(value: u32, top: bool) -> i64 {
    i64::from(if top { (value >> 16) as i16 } else { value as i16 })
}

/// Combines the products of the bottom and the top halves; `how` exchanges the second operand's halves or subtracts.
fn products(n: u32, m: u32, how: u8) -> i64 {
    let exchanged = how & 1 != 0;
    let (bottom, top) = (half(n, false) * half(m, exchanged), half(n, true) * half(m, !exchanged));
    if how & 2 == 0 { bottom + top } else { bottom - top }
}

impl State {
    pub(super) fn reg(&self, index: Index) -> u32 {
        self.r[usize::from(index) % COUNT]
    }

    pub(super) fn set_reg(&mut self, index: Index, value: u32) {
        self.r[usize::from(index) % COUNT] = value;
    }

    pub(super) fn long(&self, low: Index, high: Index) -> u64 {
        u64::from(self.reg(high)) << 32 | u64::from(self.reg(low))
    }

    pub(super) fn set_long(&mut self, low: Index, high: Index, value: u64) {
        self.set_reg(low, value as u32);
        self.set_reg(high, (value >> 32) as u32);
    }

    /// Truncates a result to a word; sets Q if it does not fit.
    fn word_sticky(&mut self, value: i64) -> u32 {
        self.q |= i32::try_from(value).is_err();
        value as u32
    }

    /// Executes SMULBB and relatives.
    pub(super) fn smul_halves(&mut self, d: Index, n: Index, m: Index, tops: u8) {
        let product = half(self.reg(n), tops & 2 != 0) * half(self.reg(m), tops & 1 != 0);
        self.set_reg(d, product as u32);
    }

    /// Executes SMULWB and SMULWT.
    pub(super) fn smul_wide(&mut self, d: Index, n: Index, m: Index, top: bool) {
        let product = i64::from(self.reg(n) as i32) * half(self.reg(m), top);
        self.set_reg(d, (product >> 16) as u32);
    }

    pub(super) fn add_sticky(&mut self, d: Index, n: Index, m: Index) {
        let sum = i64::from(self.reg(n) as i32) + i64::from(self.reg(m) as i32);
        let sum = self.word_sticky(sum);
        self.set_reg(d, sum);
    }

    /// Executes SMLAD, SMLSD, SMUAD and SMUSD.
    pub(super) fn dual(&mut self, d: Index, n: Index, m: Index, a: Index, how: u8) {
        let sum = products(self.reg(n), self.reg(m), how) + i64::from(self.reg(a) as i32);
        let sum = self.word_sticky(sum);
        self.set_reg(d, sum);
    }

    /// Executes SMLALD and SMLSLD.
    pub(super) fn dual_long(&mut self, low: Index, high: Index, n: Index, m: Index, how: u8) {
        let sum = products(self.reg(n), self.reg(m), how) as u64;
        self.set_long(low, high, self.long(low, high).wrapping_add(sum));
    }

    /// Executes SMMLA, SMMLS and SMMUL.
    pub(super) fn upper(&mut self, d: Index, n: Index, m: Index, a: Index, how: u8) {
        let product = i64::from(self.reg(n) as i32) * i64::from(self.reg(m) as i32);
        let a = i64::from(self.reg(a) as i32) << 32;
        let sum = if how & 2 == 0 { a.wrapping_add(product) } else { a.wrapping_sub(product) };
        let sum = if how & 1 == 0 { sum } else { sum.wrapping_add(1 << 31) };
        self.set_reg(d, (sum >> 32) as u32);
    }
}
