//! The instruction set, behind a trait: what a backend does, and what the rest of the processor does for it.
//!
//! A backend executes instructions and keeps the registers. It takes no exceptions, has no interrupt controller and
//! knows no time: it counts instructions. What it cannot do by itself — an access that is not direct (see
//! [`Region::direct`]), sleeping, a fault, a return from an exception — it asks the [`CoreBus`] for, or stops with.

use super::mpu::Protection;
use crate::memory::Region;
use crate::peripheral::Size;

/// A register of the programmers' model (DDI0403E B1.4).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Register {
    /// R0 to R12.
    R(u8),
    /// The stack pointer in use: the bank that mode and CONTROL.SPSEL choose.
    Sp,
    /// R14.
    Lr,
    /// The address of the next instruction, without the Thumb bit. A write is a branch and clears nothing else.
    Pc,
    /// The main stack pointer.
    Msp,
    /// The process stack pointer.
    Psp,
    /// Flags, IT state and, where the backend keeps it, the exception number; EPSR.T reads as one.
    Xpsr,
    /// Bit 0.
    Primask,
    /// Bits 7 to 0.
    Basepri,
    /// Bit 0.
    Faultmask,
    /// nPRIV, SPSEL, FPCA. A write of SPSEL selects the stack whatever the mode.
    Control,
    /// Floating-point status and control.
    Fpscr,
    /// S0 to S31.
    S(u8),
}

/// Where and how a core accesses what is not direct.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Access {
    /// The address.
    pub address: u32,
    /// Width. A wider load or store comes as several accesses, in order of address.
    pub size: Size,
    /// Address of the instruction.
    pub pc: u32,
    /// Instructions executed in this run before that one.
    pub instructions: u64,
}

/// An access is refused: the core stops at the instruction, which has no further effect, with [`Fault::Load`] or [`Fault::Store`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoResult;

/// Until when a core runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Instructions of this run. The core stops before the first block of instructions that begins at or after this
    /// many: it can overshoot by one block, and never stops within one for this reason.
    pub instructions: u64,
    /// Stop as soon as PRIMASK, BASEPRI or FAULTMASK differ from what they were when this was asked for.
    pub mask_changes: bool,
}

/// What a core needs while it runs.
pub trait CoreBus {
    /// A load that is not direct. The address is as the program gave it, aligned or not.
    ///
    /// # Errors
    /// The load is abandoned.
    fn read(&mut self, access: &Access) -> Result<u32, NoResult>;

    /// A store that is not direct, aligned or not. An error of the bus takes effect later, as on the Cortex-M7, which
    /// buffers its stores (imprecise bus faults).
    ///
    /// # Errors
    /// The memory protection unit forbids it.
    fn write(&mut self, access: &Access, value: u32) -> Result<(), NoResult>;

    /// Asked at the start of a run, after each access and after [`CoreBus::reached`], which may change them.
    fn limits(&self) -> Limits;

    /// [`Limits::instructions`] is reached, after so many: what is due is done, and the limits may be others now. Where they
    /// are not, the core stops.
    fn reached(&mut self, _instructions: u64) {}

    /// SEV was, or is about to be, executed in the present block.
    fn event(&mut self);

    /// [`Region::direct`] of some region changed since the core last asked; the regions are then mapped anew.
    fn remapped(&mut self) -> Option<&[Region]>;
}

/// What went wrong with an instruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// [`CoreBus::read`] gave no result to the instruction at PC.
    Load,
    /// [`CoreBus::write`] refused the instruction at PC.
    Store,
    /// An instruction cannot be fetched from PC.
    Fetch,
    /// Undefined instruction at PC.
    Undefined,
    /// Floating-point instruction at PC while CPACR does not allow it.
    NoCoprocessor,
    /// EPSR.T is zero, or the IT state makes no sense.
    InvalidState,
    /// The instruction at PC needs an aligned address (LDM, LDRD, LDREX and the like), and has another.
    Unaligned,
}

/// Why a core stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Why {
    /// [`Limits::instructions`] is reached.
    Limit,
    /// [`Limits::mask_changes`].
    MaskChanged,
    /// WFI was executed; PC is after it.
    Wfi,
    /// WFE was executed, whatever the event register is; PC is after it.
    Wfe,
    /// YIELD was executed; PC is after it.
    Yield,
    /// SVC was executed; PC is after it.
    Svc,
    /// BKPT is at PC, with this operand.
    Breakpoint(u8),
    /// PC is at an address given by [`Core::observe`]; its instruction was not executed.
    Observed,
    /// A branch to an EXC_RETURN value, which is in PC (with bit 0 cleared, as in the argument).
    ExceptionReturn(u32),
    /// A fault.
    Fault(Fault),
}

/// What a run came to.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CoreStop {
    /// Instructions executed, those skipped by IT included.
    pub instructions: u64,
    /// Why it stopped.
    pub why: Why,
}

/// The backend failed by itself: never the program's fault.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the processor backend failed: {0}")]
pub struct CoreError(pub String);

/// A processor that executes the Thumb instructions of a Cortex-M7 with double-precision floating point.
pub trait Core {
    /// Maps every memory, at the start of the machine. The core keeps the references.
    ///
    /// # Errors
    /// The backend's.
    fn map(&mut self, regions: &[Region]) -> Result<(), CoreError>;

    /// Maps regions anew, of which [`Region::direct`] may have changed between runs.
    ///
    /// # Errors
    /// The backend's.
    fn remap(&mut self, regions: &[Region]) -> Result<(), CoreError>;

    /// Instructions in direct memory were changed from outside the core.
    ///
    /// # Errors
    /// The backend's.
    fn code_changed(&mut self) -> Result<(), CoreError>;

    /// The memory protection unit has changed, is on where it was off, or the other way round: what it forbids is not accessed
    /// directly from now on, but by the [`CoreBus`], and not executed.
    ///
    /// # Errors
    /// The backend's, which need not have it.
    fn protect(&mut self, protection: Option<&Protection>) -> Result<(), CoreError> {
        match protection {
            None => Ok(()),
            Some(_) => Err(CoreError("the memory protection unit is not modelled by this core".into())),
        }
    }

    /// Reads a register.
    fn get(&self, register: Register) -> u32;

    /// Writes a register. Exception entry writes CONTROL before the exception number in xPSR, return the other way
    /// round: a backend that keeps the mode ignores SPSEL in handler mode.
    fn set(&mut self, register: Register, value: u32);

    /// Floating point is allowed (CPACR).
    fn set_fpu(&mut self, on: bool);

    /// Clears the monitor of exclusive accesses, as exceptions do.
    ///
    /// # Errors
    /// The backend's.
    fn clear_exclusive(&mut self) -> Result<(), CoreError>;

    /// Stops with [`Why::Observed`] before these instructions, from now on; a run that begins at one executes it.
    /// One within an IT block is stopped at before the IT instruction: no backend need stop within such a block.
    ///
    /// # Errors
    /// The backend's.
    fn observe(&mut self, addresses: &[u32]) -> Result<(), CoreError>;

    /// Executes from PC.
    ///
    /// # Errors
    /// The backend's.
    fn run(&mut self, bus: &mut dyn CoreBus) -> Result<CoreStop, CoreError>;

    /// Executes the instruction at PC, observed or not, and stops with [`Why::Observed`] before the next one, or with
    /// another reason. An IT instruction may be executed together with those that it makes conditional.
    ///
    /// # Errors
    /// The backend's.
    fn step(&mut self, bus: &mut dyn CoreBus) -> Result<CoreStop, CoreError>;

    /// Everything from PC to the end of the block loads, computes and branches, and does nothing else. A core that does not know
    /// says no.
    fn only_looks(&self) -> bool {
        false
    }

    /// The last run stopped within a block of instructions: some of it were executed, and some not.
    fn is_within_block(&self) -> bool;
}
