//! Faults: their status registers, and the exceptions they raise (DDI0403E B1.5.14, B3.2.15 ff.).

use std::fmt;

use super::exceptions::number;

/// Cause of a fault, as in the status registers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// Instruction fetch from where no code may be executed: IACCVIOL.
    FetchViolation,
    /// Load or store that the memory protection unit forbids: DACCVIOL and MMFAR.
    DataViolation {
        /// Address of the access.
        address: u32,
    },
    /// The memory protection unit forbids the saving of registers at exception entry: MSTKERR.
    StackingViolation,
    /// The memory protection unit forbids their restoring at exception return: MUNSTKERR.
    UnstackingViolation,
    /// Instruction fetch that the bus refused: IBUSERR.
    FetchError,
    /// Load that the bus refused: PRECISERR and BFAR.
    Load {
        /// Address of the load.
        address: u32,
    },
    /// Store that the bus refused: IMPRECISERR.
    Store,
    /// Exception entry could not save registers: STKERR.
    Stacking,
    /// Exception return could not restore them: UNSTKERR.
    Unstacking,
    /// Undefined instruction at PC: UNDEFINSTR.
    Undefined,
    /// Invalid execution state: INVSTATE.
    InvalidState,
    /// Invalid exception return: INVPC.
    InvalidReturn,
    /// Coprocessor disabled or absent: NOCP.
    NoCoprocessor,
    /// Unaligned access by LDM and the like: UNALIGNED.
    Unaligned,
}

/// Text with the event and its flag in CFSR.
impl fmt::Display for Cause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::FetchViolation => f.write_str("instruction fetch from where nothing may be executed (IACCVIOL)"),
            Self::DataViolation { address } => write!(f, "access to {address:#010x}, which is protected (DACCVIOL)"),
            Self::StackingViolation => f.write_str("exception entry on a protected stack (MSTKERR)"),
            Self::UnstackingViolation => f.write_str("exception return from a protected stack (MUNSTKERR)"),
            Self::FetchError => f.write_str("instruction fetch that the bus refused (IBUSERR)"),
            Self::Load { address } => write!(f, "load from {address:#010x} that the bus refused (PRECISERR)"),
            Self::Store => f.write_str("store that the bus refused (IMPRECISERR)"),
            Self::Stacking => f.write_str("exception entry could not save registers (STKERR)"),
            Self::Unstacking => f.write_str("exception return could not restore registers (UNSTKERR)"),
            Self::Undefined => f.write_str("undefined instruction (UNDEFINSTR)"),
            Self::InvalidState => f.write_str("invalid state of the processor (INVSTATE)"),
            Self::InvalidReturn => f.write_str("invalid exception return (INVPC)"),
            Self::NoCoprocessor => f.write_str("floating point while it is not enabled (NOCP)"),
            Self::Unaligned => f.write_str("unaligned access (UNALIGNED)"),
        }
    }
}

impl Cause {
    /// Returns the exception for this cause, to take if it is enabled.
    #[must_use]
    pub const fn exception(self) -> u16 {
        match self {
            Self::FetchViolation | Self::DataViolation { .. } | Self::StackingViolation | Self::UnstackingViolation => {
                number::MEM_MANAGE
            }
            Self::FetchError | Self::Load { .. } | Self::Store | Self::Stacking | Self::Unstacking => number::BUS_FAULT,
            Self::Undefined | Self::InvalidState | Self::InvalidReturn | Self::NoCoprocessor | Self::Unaligned => {
                number::USAGE_FAULT
            }
        }
    }

    /// Returns the bit of the cause in CFSR.
    const fn bit(self) -> u32 {
        match self {
            Self::FetchViolation => 1 << 0,
            Self::DataViolation { .. } => 1 << 1,
            Self::UnstackingViolation => 1 << 3,
            Self::StackingViolation => 1 << 4,
            Self::FetchError => 1 << 8,
            Self::Load { .. } => 1 << 9,
            Self::Store => 1 << 10,
            Self::Unstacking => 1 << 11,
            Self::Stacking => 1 << 12,
            Self::Undefined => 1 << 16,
            Self::InvalidState => 1 << 17,
            Self::InvalidReturn => 1 << 18,
            Self::NoCoprocessor => 1 << 19,
            Self::Unaligned => 1 << 24,
        }
    }
}

const MMFAR_VALID: u32 = 1 << 7;
const BFAR_VALID: u32 = 1 << 15;

/// Bit HFSR.VECTTBL: the vector could not be read.
pub(super) const VECTOR_TABLE: u32 = 1 << 1;
/// Bit HFSR.FORCED: an escalated fault.
pub(super) const FORCED: u32 = 1 << 30;
/// Bit HFSR.DEBUGEVT: a debug event.
pub(super) const DEBUG_EVENT: u32 = 1 << 31;
/// Bit DFSR.BKPT: a breakpoint instruction.
pub(super) const BREAKPOINT: u32 = 1 << 1;

/// Fault status registers: CFSR, HFSR, DFSR, MMFAR, BFAR.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FaultStatus {
    pub(super) configurable: u32,
    pub(super) hard: u32,
    pub(super) debug: u32,
    pub(super) memory_address: u32,
    pub(super) bus_address: u32,
}

impl FaultStatus {
    /// Sets the bits of a cause.
    pub fn note(&mut self, cause: Cause) {
        self.configurable |= cause.bit();
        if let Cause::Load { address } = cause {
            self.bus_address = address;
            self.configurable |= BFAR_VALID;
        }
        if let Cause::DataViolation { address } = cause {
            self.memory_address = address;
            self.configurable |= MMFAR_VALID;
        }
    }
}

impl fmt::Display for FaultStatus {
    /// Formats the registers that are not zero, and the addresses of faults where they are valid.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let bus_address = if self.configurable & BFAR_VALID == 0 { 0 } else { self.bus_address };
        let memory_address = if self.configurable & MMFAR_VALID == 0 { 0 } else { self.memory_address };
        let registers = [
            ("CFSR", self.configurable),
            ("HFSR", self.hard),
            ("DFSR", self.debug),
            ("MMFAR", memory_address),
            ("BFAR", bus_address),
        ];
        let mut separator = "";
        for (name, value) in registers.into_iter().filter(|(_, value)| *value != 0) {
            write!(f, "{separator}{name} {value:#010x}")?;
            separator = ", ";
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refused_load_gives_its_address_and_a_refused_store_does_not() {
        let mut status = FaultStatus::default();
        status.note(Cause::Store);
        assert_eq!((status.configurable, status.bus_address), (0x0000_0400, 0));
        status.note(Cause::Load { address: 0x6000_0004 });
        assert_eq!((status.configurable, status.bus_address), (0x0000_8600, 0x6000_0004));
    }
}
