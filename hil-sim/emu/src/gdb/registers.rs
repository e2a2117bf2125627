//! Registers of a Cortex-M7 as gdb knows them: its features `m-profile`, `vfp` (double precision, 16 registers) and
//! `m-system`.

use std::num::NonZeroUsize;

use gdbstub::arch::{Arch, RegId, Registers};
use gdbstub_arch::arm::ArmBreakpointKind;
use r4_mcu::cpu::{Core, Register};

/// Target description in XML; `number` below assigns gdb's numbers in its order.
const DESCRIPTION: &str = r#"<?xml version="1.0"?><!DOCTYPE target SYSTEM "gdb-target.dtd">
<target version="1.0"><architecture>arm</architecture>
<feature name="org.gnu.gdb.arm.m-profile">
<reg name="r0" bitsize="32"/><reg name="r1" bitsize="32"/><reg name="r2" bitsize="32"/><reg name="r3" bitsize="32"/>
<reg name="r4" bitsize="32"/><reg name="r5" bitsize="32"/><reg name="r6" bitsize="32"/><reg name="r7" bitsize="32"/>
<reg name="r8" bitsize="32"/><reg name="r9" bitsize="32"/><reg name="r10" bitsize="32"/><reg name="r11" bitsize="32"/>
<reg name="r12" bitsize="32"/><reg name="sp" bitsize="32" type="data_ptr"/><reg name="lr" bitsize="32"/>
<reg name="pc" bitsize="32" type="code_ptr"/><reg name="xpsr" bitsize="32"/>
</feature>
<feature name="org.gnu.gdb.arm.vfp">
<reg name="d0" bitsize="64" type="ieee_double"/><reg name="d1" bitsize="64" type="ieee_double"/>
<reg name="d2" bitsize="64" type="ieee_double"/><reg name="d3" bitsize="64" type="ieee_double"/>
<reg name="d4" bitsize="64" type="ieee_double"/><reg name="d5" bitsize="64" type="ieee_double"/>
<reg name="d6" bitsize="64" type="ieee_double"/><reg name="d7" bitsize="64" type="ieee_double"/>
<reg name="d8" bitsize="64" type="ieee_double"/><reg name="d9" bitsize="64" type="ieee_double"/>
<reg name="d10" bitsize="64" type="ieee_double"/><reg name="d11" bitsize="64" type="ieee_double"/>
<reg name="d12" bitsize="64" type="ieee_double"/><reg name="d13" bitsize="64" type="ieee_double"/>
<reg name="d14" bitsize="64" type="ieee_double"/><reg name="d15" bitsize="64" type="ieee_double"/>
<reg name="fpscr" bitsize="32" type="int" group="float"/>
</feature>
<feature name="org.gnu.gdb.arm.m-system">
<reg name="msp" bitsize="32" type="data_ptr"/><reg name="psp" bitsize="32" type="data_ptr"/>
<reg name="primask" bitsize="32"/><reg name="basepri" bitsize="32"/>
<reg name="faultmask" bitsize="32"/><reg name="control" bitsize="32"/>
</feature>
</target>"#;

/// Number of registers in the target description.
const COUNT: usize = 40;

/// Register by gdb's number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Number {
    /// Register of 32 bits.
    Single(Register),
    /// D0 to D15: a pair of single-precision registers of the core.
    Double(u8),
}

/// Iterates over all registers in gdb's order.
fn all() -> impl Iterator<Item = Number> {
    (0..COUNT).filter_map(number)
}

fn number(id: usize) -> Option<Number> {
    let register = match id {
        0..=12 => Register::R(id as u8),
        13 => Register::Sp,
        14 => Register::Lr,
        15 => Register::Pc,
        16 => Register::Xpsr,
        17..=32 => return Some(Number::Double(id as u8 - 17)),
        33 => Register::Fpscr,
        34 => Register::Msp,
        35 => Register::Psp,
        36 => Register::Primask,
        37 => Register::Basepri,
        38 => Register::Faultmask,
        39 => Register::Control,
        _ => return None,
    };
    Some(Number::Single(register))
}

impl Number {
    /// Returns the register's length, bytes.
    pub(super) fn len(self) -> usize {
        match self {
            Self::Single(_) => 4,
            Self::Double(_) => 8,
        }
    }

    pub(super) fn read<C: Core>(self, core: &C) -> u64 {
        match self {
            Self::Single(register) => core.get(register).into(),
            Self::Double(index) => {
                let half = |half| u64::from(core.get(Register::S(2 * index + half)));
                half(0) | half(1) << 32
            }
        }
    }

    pub(super) fn write<C: Core>(self, core: &mut C, value: u64) {
        match self {
            // The core's PC is an address without the Thumb bit.
            Self::Single(Register::Pc) => core.set(Register::Pc, value as u32 & !1),
            Self::Single(register) => core.set(register, value as u32),
            Self::Double(index) => {
                core.set(Register::S(2 * index), value as u32);
                core.set(Register::S(2 * index + 1), (value >> 32) as u32);
            }
        }
    }
}

impl RegId for Number {
    fn from_raw_id(id: usize) -> Option<(Self, Option<NonZeroUsize>)> {
        number(id).map(|number| (number, NonZeroUsize::new(number.len())))
    }
}

/// Values of all registers in gdb's order.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Values([u64; COUNT]);

impl Default for Values {
    fn default() -> Self {
        Self([0; COUNT])
    }
}

impl Values {
    pub(super) fn read<C: Core>(&mut self, core: &C) {
        self.0.iter_mut().zip(all()).for_each(|(value, number)| *value = number.read(core));
    }

    /// Writes only registers whose value differs: writing back a value as read may have another effect.
    pub(super) fn write<C: Core>(&self, core: &mut C) {
        for (value, number) in self.0.iter().zip(all()) {
            if number.read(core) != *value {
                number.write(core, *value);
            }
        }
    }
}

impl Registers for Values {
    type ProgramCounter = u32;

    fn pc(&self) -> u32 {
        self.0[15] as u32
    }

    fn gdb_serialize(&self, mut write_byte: impl FnMut(Option<u8>)) {
        for (value, number) in self.0.iter().zip(all()) {
            value.to_le_bytes()[..number.len()].iter().for_each(|byte| write_byte(Some(*byte)));
        }
    }

    fn gdb_deserialize(&mut self, bytes: &[u8]) -> Result<(), ()> {
        let mut rest = bytes;
        for (value, number) in self.0.iter_mut().zip(all()) {
            let (of_this, after) = rest.split_at_checked(number.len()).ok_or(())?;
            *value = of_this.iter().rev().fold(0, |value, byte| value << 8 | u64::from(*byte));
            rest = after;
        }
        if rest.is_empty() { Ok(()) } else { Err(()) }
    }
}

/// Architecture description of a Cortex-M7 with double-precision floating point.
#[derive(Debug)]
pub(super) enum CortexM7 {}

impl Arch for CortexM7 {
    type Usize = u32;
    type Registers = Values;
    type BreakpointKind = ArmBreakpointKind;
    type RegId = Number;

    fn target_description_xml() -> Option<&'static str> {
        Some(DESCRIPTION)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_description_has_as_many_registers_as_there_are() {
        assert_eq!(DESCRIPTION.matches("<reg ").count(), COUNT);
        assert_eq!(all().count(), COUNT);
    }

    #[test]
    fn values_go_there_and_back() {
        let mut values = Values::default();
        values.0.iter_mut().zip(all()).enumerate().for_each(|(index, (value, number))| {
            *value = if number.len() == 8 { 0x1122_3344_5566_7788 + index as u64 } else { 0x99AA_BB00 + index as u64 };
        });
        let mut bytes = Vec::new();
        values.gdb_serialize(|byte| bytes.extend(byte));
        // Sizes: 24 registers of 32 bits, 16 of 64.
        assert_eq!(bytes.len(), 24 * 4 + 16 * 8);
        let mut back = Values::default();
        back.gdb_deserialize(&bytes).unwrap();
        assert_eq!(back, values);
        assert_eq!(back.gdb_deserialize(&bytes[1..]), Err(()));
    }
}
