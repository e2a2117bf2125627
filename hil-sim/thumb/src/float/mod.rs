//! Floating point: FPv5-D16 with double precision (DDI0403E A2.5, A6.4 to A6.7), but for memory, which the executor accesses.
//!
//! Results are the architecture's bit for bit, in every rounding mode, with flush to zero, default NaN and the alternative
//! half precision, and so are the cumulative flags of FPSCR: none is left out. Nothing traps: the Cortex-M7 has no
//! trapped floating-point exceptions, either.

mod arithmetic;
mod compare;
mod decode;
mod fast;
mod format;
mod integer;
mod status;
#[cfg(test)]
mod tests;

use fast::Native;
use format::{DOUBLE, Format, HALF, SINGLE};
use integer::Fixed;
use status::{NZCV, Rounding, WRITABLE};

pub(crate) use decode::decode;

/// The extension registers.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub(crate) struct Registers {
    /// S0 to S31 as bits; D(n) is S(2n) and, as its high half, S(2n+1).
    pub(crate) s: [u32; 32],
    /// Status and control; written by [`Registers::set_fpscr`].
    pub(crate) fpscr: u32,
}

/// The core registers, as far as floating point needs them.
pub(crate) trait CoreRegisters {
    fn get(&self, register: u8) -> u32;
    fn set(&mut self, register: u8, value: u32);
    /// N, Z, C, V in bits 31 to 28; the others are anything.
    fn nzcv(&self) -> u32;
    /// As [`CoreRegisters::nzcv`] gives them; the others are zero.
    fn set_nzcv(&mut self, flags: u32);
}

/// What a load or store transfers: so many words in order of address from `first` on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Transfer {
    /// Memory to registers.
    pub(crate) load: bool,
    /// The core register that holds the address; 15 is PC + 4, rounded down to a word.
    pub(crate) base: u8,
    /// The first S register.
    pub(crate) first: u8,
    /// S registers.
    pub(crate) words: u8,
    /// From the base to the first word, bytes.
    pub(crate) offset: i16,
    /// Added to the base after it; 0 is none.
    pub(crate) write_back: i16,
}

/// Data processing of three registers; "accumulator" is the destination before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Three {
    Add,
    Subtract,
    Multiply,
    /// VNMUL.
    NegatedMultiply,
    /// VMLA: product and sum are rounded each.
    MultiplyAdd,
    /// VMLS.
    MultiplySubtract,
    /// VNMLS: product less accumulator.
    NegatedMultiplySubtract,
    /// VNMLA: both negated.
    NegatedMultiplyAdd,
    Divide,
    /// VFMA: rounded once.
    FusedAdd,
    /// VFMS.
    FusedSubtract,
    /// VFNMS: product less accumulator.
    NegatedFusedSubtract,
    /// VFNMA: both negated.
    NegatedFusedAdd,
    /// VMAXNM.
    Maximum,
    /// VMINNM.
    Minimum,
}

/// Where a number that is not whole goes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Toward {
    /// As FPSCR says.
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

/// Data processing of two registers of one width.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Two {
    Move,
    Absolute,
    Negate,
    SquareRoot,
    /// VRINT but VRINTX.
    Whole(Toward),
    /// VRINTX.
    WholeExact,
}

/// A decoded instruction of coprocessors 10 and 11. Registers `d`, `n` and `m` are numbers of S registers, the low half of a D register.
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
    /// VMOV of a constant: its highest 16 bits.
    Immediate {
        double: bool,
        d: u8,
        highest: u16,
    },
    /// VCMP; `signalling` is VCMPE.
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
    /// To a float of this width.
    FromInteger {
        double: bool,
        signed: bool,
        d: u8,
        m: u8,
    },
    /// From a float of this width.
    ToInteger {
        double: bool,
        signed: bool,
        toward: Toward,
        d: u8,
        m: u8,
    },
    /// In place.
    FromFixed {
        double: bool,
        d: u8,
        fixed: Fixed,
    },
    /// In place.
    ToFixed {
        double: bool,
        d: u8,
        fixed: Fixed,
    },
    /// VCVT.F64.F32.
    ToDouble {
        d: u8,
        m: u8,
    },
    /// VCVT.F32.F64.
    ToSingle {
        d: u8,
        m: u8,
    },
    /// VCVTB, VCVTT: the half is in the low or the high halfword of `m`.
    FromHalf {
        double: bool,
        top: bool,
        d: u8,
        m: u8,
    },
    /// As [`Float::FromHalf`], of `d`, of which the other halfword stays.
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
    /// `low` is for S register `first`, `high` for the one after it.
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
    /// VMRS.
    StatusToCore {
        core: u8,
    },
    /// VMRS APSR_nzcv.
    StatusToFlags,
    /// VMSR.
    StatusFromCore {
        core: u8,
    },
    Transfer(Transfer),
}

impl Registers {
    /// Writes FPSCR, of which some bits do not exist.
    pub(crate) fn set_fpscr(&mut self, value: u32) {
        self.fpscr = value & WRITABLE;
    }

    // The numbers are below 32: masked, so that nothing is to be checked.
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
        // Whatever has no more bits than the format is exact.
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

/// A condition of VSEL (A7.3).
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
    /// What a load or store transfers; `None` for everything else.
    pub(crate) fn transfer(&self) -> Option<Transfer> {
        match self {
            Self::Transfer(transfer) => Some(*transfer),
            _ => None,
        }
    }

    /// Everything else; a load or store does nothing here.
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
