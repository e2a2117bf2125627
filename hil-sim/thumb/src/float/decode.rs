//! Decoder for coprocessors 10 and 11 (DDI0403E A5.3.18, A6.4 to A6.7; the encodings of A7.7.225 ff.).
//!
//! UNPREDICTABLE encodings are treated as undefined: nonzero bits that should be zero, PC where it is no operand,
//! registers past the last.

use super::integer::Fixed;
use super::status::Rounding;
use super::{Float, Three, Toward, Transfer, Two};

/// Fields of an instruction's two halfwords.
#[derive(Clone, Copy)]
struct Fields {
    first: u16,
    second: u16,
}

impl Fields {
    /// Extracts a field of the second halfword.
    fn second(self, low: u16, bits: u16) -> u8 {
        (self.second >> low & ((1 << bits) - 1)) as u8
    }

    fn first(self, low: u16, bits: u16) -> u8 {
        (self.first >> low & ((1 << bits) - 1)) as u8
    }

    fn double(self) -> bool {
        self.second & 0x100 != 0
    }

    /// Combines the four and one bits of a register number to that of its first S register. D16 and above do not exist.
    fn register(four: u8, one: u8, double: bool) -> Option<u8> {
        match (double, one) {
            (false, _) => Some(four << 1 | one),
            (true, 0) => Some(four << 1),
            (true, _) => None,
        }
    }

    fn d(self, double: bool) -> Option<u8> {
        Self::register(self.second(12, 4), self.first(6, 1), double)
    }

    fn n(self, double: bool) -> Option<u8> {
        Self::register(self.first(0, 4), self.second(7, 1), double)
    }

    fn m(self, double: bool) -> Option<u8> {
        Self::register(self.second(0, 4), self.second(5, 1), double)
    }

    /// Returns the core register that is operand or result. SP is allowed, as cores do.
    fn core(self) -> Option<u8> {
        Some(self.second(12, 4)).filter(|core| *core != 15)
    }
}

/// Decodes both halfwords of an instruction of coprocessors 10 and 11; `None` is undefined.
pub(crate) fn decode(first: u16, second: u16) -> Option<Float> {
    let fields = Fields { first, second };
    if second & 0x0E00 != 0x0A00 {
        return None;
    }
    match first & 0xFF00 {
        0xEC00 | 0xED00 if first & 0x01E0 == 0x0040 => pair(fields),
        0xEC00 | 0xED00 => transfer(fields),
        0xEE00 if second & 0x10 == 0 => data(fields),
        0xEE00 => core(fields),
        0xFE00 if second & 0x10 == 0 => unconditional(fields),
        _ => None,
    }
}

/// Decodes VMOV between two core registers and two S registers, or one D register.
fn pair(fields: Fields) -> Option<Float> {
    if fields.second & 0xD0 != 0x10 {
        return None;
    }
    let first = fields.m(fields.double())?;
    let (low, high) = (fields.core()?, fields.first(0, 4));
    let to_core = fields.first & 0x10 != 0;
    if high == 15 || first == 31 || to_core && low == high {
        return None;
    }
    Some(if to_core { Float::PairToCore { low, high, first } } else { Float::PairFromCore { low, high, first } })
}

/// Decodes VLDR, VSTR, VLDM, VSTM, VPUSH and VPOP.
fn transfer(fields: Fields) -> Option<Float> {
    let double = fields.double();
    let (load, base) = (fields.first & 0x10 != 0, fields.first(0, 4));
    let first = fields.d(double)?;
    let immediate = i16::from(fields.second(0, 8));
    let bytes = immediate * 4;
    let (before, up, back) = (fields.first(8, 1) == 1, fields.first(7, 1) == 1, fields.first(5, 1) == 1);
    if before && !back {
        if base == 15 && !load {
            return None;
        }
        let offset = if up { bytes } else { -bytes };
        return Some(Float::Transfer(Transfer {
            load,
            base,
            first,
            words: 1 + u8::from(double),
            offset,
            write_back: 0,
        }));
    }
    // With an odd count of words for D registers (FLDMX, FSTMX), the last word is skipped.
    let words = if double { immediate & !1 } else { immediate };
    let fits = words != 0 && words <= 32 && i16::from(first) + words <= 32;
    let (offset, write_back) = match (before, up, back) {
        (false, true, false) => (0, 0),
        (false, true, true) => (0, bytes),
        (true, false, true) => (-bytes, -bytes),
        _ => return None,
    };
    if !fits || base == 15 {
        return None;
    }
    Some(Float::Transfer(Transfer { load, base, first, words: words as u8, offset, write_back }))
}

/// Decodes transfers of 32 bits between the core and the extension registers.
fn core(fields: Fields) -> Option<Float> {
    let load = fields.first & 0x10 != 0;
    let operation = fields.first(5, 3);
    let low = fields.second & 0xFF;
    if !fields.double() {
        return match operation {
            0 if low & 0x7F == 0x10 => {
                let (core, single) = (fields.core()?, fields.n(false)?);
                Some(if load { Float::ToCore { core, single } } else { Float::FromCore { core, single } })
            }
            // FPSCR is the only one of these registers that exists.
            7 if low == 0x10 && fields.first(0, 4) == 1 => Some(match (load, fields.second(12, 4)) {
                (true, 15) => Float::StatusToFlags,
                (false, 15) => return None,
                (true, core) => Float::StatusToCore { core },
                (false, core) => Float::StatusFromCore { core },
            }),
            _ => None,
        };
    }
    match operation {
        // One half of a D register.
        0 | 1 if low & 0x7F == 0x10 => {
            let (core, single) = (fields.core()?, fields.n(true)? + operation);
            Some(if load { Float::ToCore { core, single } } else { Float::FromCore { core, single } })
        }
        _ => None,
    }
}

/// Decodes data-processing instructions (A6.4).
fn data(fields: Fields) -> Option<Float> {
    let double = fields.double();
    let odd = fields.second & 0x40 != 0;
    let operation = match (fields.first(4, 4) & 0b1011, odd) {
        (0b0000, false) => Three::MultiplyAdd,
        (0b0000, true) => Three::MultiplySubtract,
        (0b0001, false) => Three::NegatedMultiplySubtract,
        (0b0001, true) => Three::NegatedMultiplyAdd,
        (0b0010, false) => Three::Multiply,
        (0b0010, true) => Three::NegatedMultiply,
        (0b0011, false) => Three::Add,
        (0b0011, true) => Three::Subtract,
        (0b1000, false) => Three::Divide,
        (0b1001, false) => Three::NegatedFusedSubtract,
        (0b1001, true) => Three::NegatedFusedAdd,
        (0b1010, false) => Three::FusedAdd,
        (0b1010, true) => Three::FusedSubtract,
        (0b1011, false) => return immediate(fields),
        (0b1011, true) => return other(fields),
        _ => return None,
    };
    three(fields, operation, double)
}

fn three(fields: Fields, operation: Three, double: bool) -> Option<Float> {
    let (d, n, m) = (fields.d(double)?, fields.n(double)?, fields.m(double)?);
    Some(Float::Three { operation, double, d, n, m })
}

/// Decodes VMOV of a constant (VFPExpandImm) to its highest halfword; the rest is zero.
fn immediate(fields: Fields) -> Option<Float> {
    if fields.second & 0xA0 != 0 {
        return None;
    }
    let double = fields.double();
    let d = fields.d(double)?;
    let (high, low) = (u16::from(fields.first(0, 4)), u16::from(fields.second(0, 4)));
    let (sign, exponent) = (high >> 3 << 15, high & 7);
    let repeated = exponent & 4 != 0;
    // The exponent is NOT(b), then b repeated to fill the format, then two bits.
    let highest = if double {
        let middle = if repeated { 0x3FC0 } else { 0x4000 };
        sign | middle | (exponent & 3) << 4 | low
    } else {
        let middle = if repeated { 0x3E00 } else { 0x4000 };
        sign | middle | (exponent & 3) << 7 | low << 3
    };
    Some(Float::Immediate { double, d, highest })
}

/// Decodes the data-processing instructions with two operands.
fn other(fields: Fields) -> Option<Float> {
    let double = fields.double();
    let n = fields.second & 0x80 != 0;
    let (d, m) = (|| fields.d(double), || fields.m(double));
    let two = |operation| Some(Float::Two { operation, double, d: d()?, m: m()? });
    match (fields.first(0, 4), n) {
        (0b0000, false) => two(Two::Move),
        (0b0000, true) => two(Two::Absolute),
        (0b0001, false) => two(Two::Negate),
        (0b0001, true) => two(Two::SquareRoot),
        (0b0010, top) => Some(Float::FromHalf { double, top, d: d()?, m: fields.m(false)? }),
        (0b0011, top) => Some(Float::ToHalf { double, top, d: fields.d(false)?, m: m()? }),
        (0b0100, signalling) => Some(Float::Compare { double, signalling, d: d()?, m: m()? }),
        (0b0101, signalling) if fields.second & 0x2F == 0 => Some(Float::CompareZero { double, signalling, d: d()? }),
        (0b0110, false) => two(Two::Whole(Toward::Status)),
        (0b0110, true) => two(Two::Whole(Toward::Fixed(Rounding::Zero))),
        (0b0111, false) => two(Two::WholeExact),
        (0b0111, true) if double => Some(Float::ToSingle { d: fields.d(false)?, m: fields.m(true)? }),
        (0b0111, true) => Some(Float::ToDouble { d: fields.d(true)?, m: fields.m(false)? }),
        (0b1000, signed) => Some(Float::FromInteger { double, signed, d: d()?, m: fields.m(false)? }),
        (0b1100 | 0b1101, zero) => {
            let toward = if zero { Toward::Fixed(Rounding::Zero) } else { Toward::Status };
            to_integer(fields, fields.first & 1 != 0, toward)
        }
        (0b1010 | 0b1011 | 0b1110 | 0b1111, wide) => {
            let bits = if wide { 32 } else { 16 };
            let fraction = bits - (fields.second(0, 4) << 1 | fields.second(5, 1)) as i8;
            let fixed =
                Fixed { signed: fields.first & 1 == 0, bits: bits as u8, fraction: u8::try_from(fraction).ok()? };
            let d = d()?;
            Some(match fields.first & 4 {
                0 => Float::FromFixed { double, d, fixed },
                _ => Float::ToFixed { double, d, fixed },
            })
        }
        _ => None,
    }
}

fn to_integer(fields: Fields, signed: bool, toward: Toward) -> Option<Float> {
    let double = fields.double();
    Some(Float::ToInteger { double, signed, toward, d: fields.d(false)?, m: fields.m(double)? })
}

/// Decodes VSEL, VMAXNM, VMINNM, VRINTA to M and VCVTA to M, which are never conditional by themselves.
fn unconditional(fields: Fields) -> Option<Float> {
    let double = fields.double();
    let odd = fields.second & 0x40 != 0;
    if fields.first & 0x80 == 0 {
        if odd {
            return None;
        }
        // Conditions of VSEL: EQ, VS, GE, GT.
        let condition = [0, 6, 10, 12][usize::from(fields.first(4, 2))];
        let (d, n, m) = (fields.d(double)?, fields.n(double)?, fields.m(double)?);
        return Some(Float::Select { condition, double, d, n, m });
    }
    match (fields.first(4, 2), odd) {
        (0, false) => three(fields, Three::Maximum, double),
        (0, true) => three(fields, Three::Minimum, double),
        (3, true) => {
            let rounding = [Rounding::NearestAway, Rounding::Nearest, Rounding::Up, Rounding::Down];
            let toward = Toward::Fixed(rounding[usize::from(fields.first(0, 2))]);
            let n = fields.second & 0x80 != 0;
            match fields.first(2, 2) {
                0b10 if !n => {
                    let operation = Two::Whole(toward);
                    Some(Float::Two { operation, double, d: fields.d(double)?, m: fields.m(double)? })
                }
                0b11 => to_integer(fields, n, toward),
                _ => None,
            }
        }
        _ => None,
    }
}
