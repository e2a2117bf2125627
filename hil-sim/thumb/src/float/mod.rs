//! Floating point: FPv5-D16 with double precision (DDI0403E A2.5, A6.4 to A6.7), except memory accesses, which the
//! executor makes.
//!
//! Results equal the architecture's bit for bit, in every rounding mode, with flush to zero, default NaN and the
//! alternative half precision, and so do all cumulative flags of FPSCR. Nothing traps: the Cortex-M7 has no trapped
//! floating-point exceptions, either.

mod arithmetic;
mod compare;
mod decode;
mod fast;
mod format;
mod integer;
#[cfg(test)]
mod oracle;
mod status;
#[cfg(test)]
mod tests;

use fast::Native;
use format::{DOUBLE, Format, HALF, SINGLE};
use integer::Fixed;
use status::{NZCV, Rounding, WRITABLE};

pub(crate) use decode::decode;

/// Extension registers of the floating-point unit.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Registers {
    /// S0 to S31 as bits; D(n) is S(2n) and, as its high half, S(2n+1).
    pub(crate) s: [u32; 32],
    /// FPSCR, status and control; written by [`Registers::set_fpscr`].
    pub(crate) fpscr: u32,
}

/// Access to the core registers that floating point needs.
pub(crate) trait CoreRegisters {
    fn get(&self, register: u8) -> u32;
    fn set(&mut self, register: u8, value: u32);
    /// Returns N, Z, C, V in bits 31 to 28; the other bits are undefined.
    fn nzcv(&self) -> u32;
    /// Sets N, Z, C, V from bits 31 to 28; the other bits are zero.
    fn set_nzcv(&mut self, flags: u32);
}

/// Words that a load or store transfers, in order of address, from register `first` on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Transfer {
    /// Direction of the transfer: true from memory to registers.
    pub(crate) load: bool,
    /// Core register with the address; 15 is PC + 4, rounded down to a word.
    pub(crate) base: u8,
    /// Number of the first S register.
    pub(crate) first: u8,
    /// Number of S registers, one word each.
    pub(crate) words: u8,
    /// Offset of the first word from the base, bytes.
    pub(crate) offset: i16,
    /// Number added to the base afterwards, bytes; 0 for none.
    pub(crate) write_back: i16,
}

/// Data processing with three registers; the accumulator is the destination's old value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Three {
    Add,
    Subtract,
    Multiply,
    /// VNMUL: the negated product.
    NegatedMultiply,
    /// VMLA: accumulator plus product, with both rounded.
    MultiplyAdd,
    /// VMLS: accumulator minus product.
    MultiplySubtract,
    /// VNMLS: product minus accumulator.
    NegatedMultiplySubtract,
    /// VNMLA: negated product minus accumulator.
    NegatedMultiplyAdd,
    Divide,
    /// VFMA: accumulator plus product, rounded once.
    FusedAdd,
    /// VFMS: accumulator minus product, rounded once.
    FusedSubtract,
    /// VFNMS: product minus accumulator, rounded once.
    NegatedFusedSubtract,
    /// VFNMA: negated product minus accumulator, rounded once.
    NegatedFusedAdd,
    /// VMAXNM: the larger of two.
    Maximum,
    /// VMINNM: the smaller of two.
    Minimum,
}

/// Rounding mode of a conversion to an integer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Toward {
    /// The mode that FPSCR selects.
    Status,
    Fixed(Rounding),
}

impl Toward {
    fn rounding(self, fpscr: u32) -> Rounding {
        match self {
            Self::Status => Rounding::of(fpscr),
            Self::Fixed(rounding) => rounding,
        }
    }
}

/// Data processing with two registers of one width.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Two {
    Move,
    Absolute,
    Negate,
    SquareRoot,
    /// VRINT variants, except VRINTX.
    Whole(Toward),
    /// VRINTX, which records an inexact result.
    WholeExact,
}

/// Decoded instruction of coprocessors 10 and 11. Registers `d`, `n` and `m` are numbers of S registers, the low half
/// of a D register.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Float {
    Three {
        operation: Three,
        double: bool,
        d: u8,
        n: u8,
        m: u8,
    },
    Two {
        operation: Two,
        double: bool,
        d: u8,
        m: u8,
    },
    /// VSEL; the condition is EQ, VS, GE or GT in the encoding of A7.3.
    Select {
        condition: u8,
        double: bool,
        d: u8,
        n: u8,
        m: u8,
    },
    /// VMOV of a constant, given by its highest 16 bits.
    Immediate {
        double: bool,
        d: u8,
        highest: u16,
    },
    /// VCMP, or VCMPE if `signalling`.
    Compare {
        double: bool,
        signalling: bool,
        d: u8,
        m: u8,
    },
    CompareZero {
        double: bool,
        signalling: bool,
        d: u8,
    },
    /// VCVT from an integer to a float of this width.
    FromInteger {
        double: bool,
        signed: bool,
        d: u8,
        m: u8,
    },
    /// VCVT from a float of this width to an integer.
    ToInteger {
        double: bool,
        signed: bool,
        toward: Toward,
        d: u8,
        m: u8,
    },
    /// VCVT from fixed point, in place.
    FromFixed {
        double: bool,
        d: u8,
        fixed: Fixed,
    },
    /// VCVT to fixed point, in place.
    ToFixed {
        double: bool,
        d: u8,
        fixed: Fixed,
    },
    /// VCVT.F64.F32: single to double.
    ToDouble {
        d: u8,
        m: u8,
    },
    /// VCVT.F32.F64: double to single.
    ToSingle {
        d: u8,
        m: u8,
    },
    /// VCVTB, VCVTT from half precision: the value is in the low or the high halfword of `m`.
    FromHalf {
        double: bool,
        top: bool,
        d: u8,
        m: u8,
    },
    /// VCVTB, VCVTT to half precision: writes one halfword of `d` and keeps the other, as selected for
    /// [`Float::FromHalf`].
    ToHalf {
        double: bool,
        top: bool,
        d: u8,
        m: u8,
    },
    ToCore {
        core: u8,
        single: u8,
    },
    FromCore {
        core: u8,
        single: u8,
    },
    /// VMOV to two core registers: `low` gets S register `first`, `high` the one after it.
    PairToCore {
        low: u8,
        high: u8,
        first: u8,
    },
    PairFromCore {
        low: u8,
        high: u8,
        first: u8,
    },
    /// VMRS to a core register.
    StatusToCore {
        core: u8,
    },
    /// VMRS APSR_nzcv: copies the flags.
    StatusToFlags,
    /// VMSR from a core register.
    StatusFromCore {
        core: u8,
    },
    Transfer(Transfer),
}

impl Registers {
    /// Writes FPSCR; only existing bits are stored.
    pub(crate) fn set_fpscr(&mut self, value: u32) {
        self.fpscr = value & WRITABLE;
    }

    // The mask removes the bounds check: the numbers are below 32 anyway.
    #[inline]
    fn single(&self, register: u8) -> u32 {
        self.s[usize::from(register & 31)]
    }

    #[inline]
    fn set_single(&mut self, register: u8, value: u32) {
        self.s[usize::from(register & 31)] = value;
    }

    #[inline]
    fn float(&self, double: bool, register: u8) -> u64 {
        let low = u64::from(self.single(register));
        if double { low | u64::from(self.single(register | 1)) << 32 } else { low }
    }

    #[inline]
    fn set_float(&mut self, double: bool, register: u8, bits: u64) {
        self.set_single(register, bits as u32);
        if double {
            self.set_single(register | 1, (bits >> 32) as u32);
        }
    }

    #[inline]
    fn three<F: Native>(&mut self, operation: Three, double: bool, d: u8, n: u8, m: u8) {
        let negate = |bits| F::FORMAT.negate(bits);
        let (old, a, b) = (self.float(double, d), self.float(double, n), self.float(double, m));
        let fpscr = &mut self.fpscr;
        let result = match operation {
            Three::Add => fast::add::<F>(a, b, fpscr),
            Three::Subtract => fast::subtract::<F>(a, b, fpscr),
            Three::Multiply => fast::multiply::<F>(a, b, fpscr),
            Three::NegatedMultiply => negate(fast::multiply::<F>(a, b, fpscr)),
            Three::MultiplyAdd => {
                let product = fast::multiply::<F>(a, b, fpscr);
                fast::add::<F>(old, product, fpscr)
            }
            Three::MultiplySubtract => {
                let product = fast::multiply::<F>(a, b, fpscr);
                fast::add::<F>(old, negate(product), fpscr)
            }
            Three::NegatedMultiplySubtract => {
                let product = fast::multiply::<F>(a, b, fpscr);
                fast::add::<F>(negate(old), product, fpscr)
            }
            Three::NegatedMultiplyAdd => {
                let product = fast::multiply::<F>(a, b, fpscr);
                fast::add::<F>(negate(old), negate(product), fpscr)
            }
            Three::Divide => fast::divide::<F>(a, b, fpscr),
            Three::FusedAdd => fast::fused::<F>(old, a, b, fpscr),
            Three::FusedSubtract => fast::fused::<F>(old, negate(a), b, fpscr),
            Three::NegatedFusedSubtract => fast::fused::<F>(negate(old), a, b, fpscr),
            Three::NegatedFusedAdd => fast::fused::<F>(negate(old), negate(a), b, fpscr),
            Three::Maximum => fast::extreme::<F>(a, b, true, fpscr),
            Three::Minimum => fast::extreme::<F>(a, b, false, fpscr),
        };
        self.set_float(double, d, result);
    }

    fn two(&mut self, operation: Two, double: bool, d: u8, m: u8) {
        let format = width(double);
        let bits = self.float(double, m);
        let fpscr = &mut self.fpscr;
        let result = match operation {
            Two::Move => bits,
            Two::Absolute => format.absolute(bits),
            Two::Negate => format.negate(bits),
            Two::SquareRoot if double => fast::square_root::<f64>(bits, fpscr),
            Two::SquareRoot => fast::square_root::<f32>(bits, fpscr),
            Two::Whole(toward) => integer::round_to_whole(format, bits, toward.rounding(*fpscr), false, fpscr),
            Two::WholeExact => integer::round_to_whole(format, bits, Rounding::of(*fpscr), true, fpscr),
        };
        self.set_float(double, d, result);
    }

    fn compare(&mut self, double: bool, a: u64, b: u64, signalling: bool) {
        let compare = if double { fast::compare::<f64> } else { fast::compare::<f32> };
        let flags = compare(a, b, signalling, &mut self.fpscr);
        self.fpscr = self.fpscr & !NZCV | flags;
    }

    fn convert_fixed(&mut self, float: Float) {
        match float {
            Float::FromFixed { double, d, fixed } => {
                let value = self.single(d);
                let bits = integer::from_fixed(width(double), value, fixed, Rounding::Nearest, &mut self.fpscr);
                self.set_float(double, d, bits);
            }
            Float::ToFixed { double, d, fixed } => {
                let bits = self.float(double, d);
                let value = integer::to_fixed(width(double), bits, fixed, Rounding::Zero, &mut self.fpscr);
                self.set_float(double, d, value);
            }
            _ => {}
        }
    }

    fn set_to_integer(&mut self, double: bool, signed: bool, rounding: Rounding, d: u8, m: u8) {
        let bits = self.float(double, m);
        let convert = if double { fast::to_integer::<f64> } else { fast::to_integer::<f32> };
        let value = convert(bits, signed, rounding, &mut self.fpscr);
        self.set_single(d, value);
    }

    fn set_from_integer(&mut self, double: bool, signed: bool, d: u8, m: u8) {
        let value = self.single(m);
        // The conversion is exact for an integer with no more bits than the format.
        let number = if signed { f64::from(value as i32) } else { f64::from(value) };
        if double {
            return self.set_float(true, d, number.to_bits());
        }
        let single = number as f32;
        if fast::applies(self.fpscr) || f64::from(single) == number {
            return self.set_single(d, single.to_bits());
        }
        let fixed = Fixed { signed, bits: 32, fraction: 0 };
        let bits = integer::from_fixed(SINGLE, value, fixed, Rounding::of(self.fpscr), &mut self.fpscr);
        self.set_single(d, bits as u32);
    }
}

fn width(double: bool) -> Format {
    if double { DOUBLE } else { SINGLE }
}

/// Evaluates a condition of VSEL (A7.3).
fn holds(condition: u8, flags: u32) -> bool {
    let (n, z, v) = (flags >> 31 & 1, flags >> 30 & 1, flags >> 28 & 1);
    match condition {
        0 => z == 1,
        6 => v == 1,
        10 => n == v,
        _ => z == 0 && n == v,
    }
}

impl Float {
    /// Returns the transfer of a load or store; `None` for other instructions.
    pub(crate) fn transfer(&self) -> Option<Transfer> {
        match self {
            Self::Transfer(transfer) => Some(*transfer),
            _ => None,
        }
    }

    /// Executes all other instructions; does nothing for a load or store.
    #[inline]
    pub(crate) fn execute(&self, registers: &mut Registers, core: &mut impl CoreRegisters) {
        match *self {
            Self::Three { operation, double: false, d, n, m } => registers.three::<f32>(operation, false, d, n, m),
            Self::Three { operation, double: true, d, n, m } => registers.three::<f64>(operation, true, d, n, m),
            Self::Two { operation, double, d, m } => registers.two(operation, double, d, m),
            Self::Select { condition, double, d, n, m } => {
                let chosen = if holds(condition, core.nzcv()) { n } else { m };
                registers.set_float(double, d, registers.float(double, chosen));
            }
            Self::Immediate { double, d, highest } => {
                let bits = u64::from(highest) << if double { 48 } else { 16 };
                registers.set_float(double, d, bits);
            }
            Self::Compare { double, signalling, d, m } => {
                registers.compare(double, registers.float(double, d), registers.float(double, m), signalling);
            }
            Self::CompareZero { double, signalling, d } => {
                registers.compare(double, registers.float(double, d), 0, signalling);
            }
            Self::FromInteger { double, signed, d, m } => registers.set_from_integer(double, signed, d, m),
            Self::ToInteger { double, signed, toward, d, m } => {
                registers.set_to_integer(double, signed, toward.rounding(registers.fpscr), d, m);
            }
            Self::FromFixed { .. } | Self::ToFixed { .. } => registers.convert_fixed(*self),
            Self::ToDouble { d, m } => {
                let bits = fast::to_double(registers.float(false, m), &mut registers.fpscr);
                registers.set_float(true, d, bits);
            }
            Self::ToSingle { d, m } => {
                let bits = fast::to_single(registers.float(true, m), &mut registers.fpscr);
                registers.set_float(false, d, bits);
            }
            Self::FromHalf { double, top, d, m } => {
                let half = (registers.single(m) >> if top { 16 } else { 0 }) & 0xFFFF;
                let bits = format::convert(HALF, width(double), half.into(), &mut registers.fpscr);
                registers.set_float(double, d, bits);
            }
            Self::ToHalf { double, top, d, m } => {
                let bits = registers.float(double, m);
                let half = format::convert(width(double), HALF, bits, &mut registers.fpscr) as u32;
                let old = registers.single(d);
                let new = if top { old & 0xFFFF | half << 16 } else { old & 0xFFFF_0000 | half };
                registers.set_single(d, new);
            }
            Self::ToCore { core: register, single } => core.set(register, registers.single(single)),
            Self::FromCore { core: register, single } => registers.set_single(single, core.get(register)),
            Self::PairToCore { low, high, first } => {
                core.set(low, registers.single(first));
                core.set(high, registers.single(first + 1));
            }
            Self::PairFromCore { low, high, first } => {
                registers.set_single(first, core.get(low));
                registers.set_single(first + 1, core.get(high));
            }
            Self::StatusToCore { core: register } => core.set(register, registers.fpscr),
            Self::StatusToFlags => core.set_nzcv(registers.fpscr & NZCV),
            Self::StatusFromCore { core: register } => registers.set_fpscr(core.get(register)),
            Self::Transfer(_) => {}
        }
    }
}
