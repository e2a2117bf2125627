//! Instruction set behind a trait: the work of a backend, and the services of the rest of the processor.
//!
//! A backend executes instructions and keeps the registers. It takes no exceptions, has no interrupt controller and
//! knows no time: it counts instructions. For everything else (an access that is not direct, see [`Region::direct`],
//! sleeping, a fault, a return from an exception) it calls the [`CoreBus`], or stops.

use super::mpu::Protection;
use crate::memory::Region;
use crate::peripheral::Size;

/// Register of the programmers' model (DDI0403E B1.4).
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Register {
    /// General-purpose registers R0 to R12.
    R(u8),
    /// Stack pointer in use: the bank that mode and CONTROL.SPSEL select.
    Sp,
    /// Link register of the program, R14.
    Lr,
    /// Address of the next instruction, without the Thumb bit. A write is a branch and clears nothing else.
    Pc,
    /// Main stack pointer, MSP.
    Msp,
    /// Process stack pointer, PSP.
    Psp,
    /// Flags, IT state and, where the backend keeps it, the exception number; EPSR.T reads as one.
    Xpsr,
    /// PRIMASK, in bit 0.
    Primask,
    /// BASEPRI, in bits 7 to 0.
    Basepri,
    /// FAULTMASK, in bit 0.
    Faultmask,
    /// CONTROL: nPRIV, SPSEL, FPCA. A write of SPSEL selects the stack in any mode.
    Control,
    /// FPSCR, floating-point status and control.
    Fpscr,
    /// Single-precision registers S0 to S31.
    S(u8),
}

/// Access by a core to memory or peripherals that it cannot access directly.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Access {
    /// Address of the access.
    pub address: u32,
    /// Width of the access. A wider load or store comes as several accesses, in order of address.
    pub size: Size,
    /// Address of the accessing instruction.
    pub pc: u32,
    /// Number of instructions executed in this run before that one.
    pub instructions: u64,
}

/// Refusal of an access: the core stops at the instruction, which has no further effect, with [`Fault::Load`] or
/// [`Fault::Store`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct NoResult;

/// Limits of a core's run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Number of instructions in this run. The core stops before the first block of instructions that begins at or
    /// after this number: it can overshoot by one block, and never stops within one for this reason.
    pub instructions: u64,
    /// Stop as soon as PRIMASK, BASEPRI or FAULTMASK differ from their values at the request of the limits.
    pub mask_changes: bool,
}

/// Services for a core while it runs.
pub trait CoreBus {
    /// Loads where direct access is impossible. The address is as the program gave it, aligned or not.
    ///
    /// # Errors
    /// [`NoResult`] if the load must be abandoned.
    fn read(&mut self, access: &Access) -> Result<u32, NoResult>;

    /// Stores where direct access is impossible, aligned or not. An error of the bus takes effect later, as on the
    /// Cortex-M7, which buffers its stores (imprecise bus faults).
    ///
    /// # Errors
    /// [`NoResult`] if the memory protection unit forbids the store.
    fn write(&mut self, access: &Access, value: u32) -> Result<(), NoResult>;

    /// Returns the limits; called at the start of a run, after each access and after [`CoreBus::reached`], which may
    /// change them.
    fn limits(&self) -> Limits;

    /// Notes that [`Limits::instructions`] is reached, after this number: due work is done, and the limits may be
    /// different now. If they are not, the core stops.
    fn reached(&mut self, _instructions: u64) {}

    /// Notes that SEV was executed, or is about to be, in the present block.
    fn event(&mut self);

    /// Returns the regions to map again if [`Region::direct`] of one has changed since the last call.
    fn remapped(&mut self) -> Option<&[Region]>;
}

/// Fault of an instruction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// [`CoreBus::read`] refused the load of the instruction at PC.
    Load,
    /// [`CoreBus::write`] refused the store of the instruction at PC.
    Store,
    /// No instruction can be fetched from PC.
    Fetch,
    /// The instruction at PC is undefined.
    Undefined,
    /// The instruction at PC is floating-point, and CPACR does not allow it.
    NoCoprocessor,
    /// EPSR.T is zero, or the IT state is invalid.
    InvalidState,
    /// The instruction at PC (LDM, LDRD, LDREX and the like) has an unaligned address.
    Unaligned,
}

/// Reason why a core stopped.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Why {
    /// The run has reached [`Limits::instructions`].
    Limit,
    /// A mask has changed, see [`Limits::mask_changes`].
    MaskChanged,
    /// WFI was executed; PC is after it.
    Wfi,
    /// WFE was executed, whatever the event register holds; PC is after it.
    Wfe,
    /// YIELD was executed; PC is after it.
    Yield,
    /// SVC was executed; PC is after it.
    Svc,
    /// The instruction at PC is BKPT, with this operand.
    Breakpoint(u8),
    /// PC is at an address of [`Core::observe`]; its instruction was not executed.
    Observed,
    /// The program branched to an EXC_RETURN value, which is in PC (with bit 0 cleared, as in the argument).
    ExceptionReturn(u32),
    /// The instruction at PC has a fault.
    Fault(Fault),
}

/// Result of a core's run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CoreStop {
    /// Number of executed instructions, including those skipped by IT.
    pub instructions: u64,
    /// Reason of the stop.
    pub why: Why,
}

/// Failure of the backend itself, never caused by the program.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("the processor backend failed: {0}")]
pub struct CoreError(pub String);

/// Processor that executes the Thumb instructions of a Cortex-M7 with double-precision floating point.
pub trait Core {
    /// Maps every memory at the start of the machine. The core keeps the references.
    ///
    /// # Errors
    /// Those of the backend.
    fn map(&mut self, regions: &[Region]) -> Result<(), CoreError>;

    /// Maps regions again whose [`Region::direct`] may have changed between runs.
    ///
    /// # Errors
    /// Those of the backend.
    fn remap(&mut self, regions: &[Region]) -> Result<(), CoreError>;

    /// Notes that instructions in direct memory were changed from outside the core.
    ///
    /// # Errors
    /// Those of the backend.
    fn code_changed(&mut self) -> Result<(), CoreError>;

    /// Sets the memory protection, after the unit has changed or was turned on or off: from now on forbidden accesses
    /// go to the [`CoreBus`], and forbidden code is not executed.
    ///
    /// # Errors
    /// Those of the backend, which need not support protection.
    fn protect(&mut self, protection: Option<&Protection>) -> Result<(), CoreError> {
        match protection {
            None => Ok(()),
            Some(_) => Err(CoreError("the memory protection unit is not modelled by this core".into())),
        }
    }

    /// Reads the value of a register.
    fn get(&self, register: Register) -> u32;

    /// Writes a register. Exception entry writes CONTROL before the exception number in xPSR, and return does it the
    /// other way round: a backend that keeps the mode ignores SPSEL in handler mode.
    fn set(&mut self, register: Register, value: u32);

    /// Enables or disables floating point (CPACR).
    fn set_fpu(&mut self, on: bool);

    /// Clears the monitor of exclusive accesses, as exceptions do.
    ///
    /// # Errors
    /// Those of the backend.
    fn clear_exclusive(&mut self) -> Result<(), CoreError>;

    /// Sets the instructions before which runs stop with [`Why::Observed`]; a run that begins at one executes it. For
    /// an instruction within an IT block, the stop is before the IT instruction: no backend needs to stop within such a
    /// block.
    ///
    /// # Errors
    /// Those of the backend.
    fn observe(&mut self, addresses: &[u32]) -> Result<(), CoreError>;

    /// Executes from PC until a limit or another reason.
    ///
    /// # Errors
    /// Those of the backend.
    fn run(&mut self, bus: &mut dyn CoreBus) -> Result<CoreStop, CoreError>;

    /// Executes the instruction at PC, observed or not, and stops with [`Why::Observed`] before the next one, or with
    /// another reason. An IT instruction may be executed together with those that it makes conditional.
    ///
    /// # Errors
    /// Those of the backend.
    fn step(&mut self, bus: &mut dyn CoreBus) -> Result<CoreStop, CoreError>;

    /// Returns true if all instructions from PC to the end of the block only load, compute and branch. A core that does
    /// not know returns false.
    fn only_looks(&self) -> bool {
        false
    }

    /// Returns true if the last run stopped within a block of instructions, of which it executed only a part.
    fn is_within_block(&self) -> bool;
}
