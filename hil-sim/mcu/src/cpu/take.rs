//! Exception entry and return (DDI0403E B1.5.6 to B1.5.8), faults and their escalation (B1.5.14).

use super::core::{Core, CoreError, Register};
use super::exceptions::{Masks, number};
use super::faults::{BREAKPOINT, Cause, DEBUG_EVENT, FORCED, VECTOR_TABLE};
use super::mpu::{Protection, Purpose};
use super::registers::Processor;
use crate::memory::Memory;
use crate::peripheral::Size;

/// Bit CONTROL.SPSEL: PSP in thread mode.
const PROCESS_STACK: u32 = 1 << 1;
/// Bit CONTROL.FPCA: floating-point context active.
const FLOAT_ACTIVE: u32 = 1 << 2;

/// Exception number field of xPSR (IPSR).
const EXCEPTION: u32 = 0x1FF;
/// Flags of xPSR: N, Z, C, V, Q, GE.
const FLAGS: u32 = 0xF80F_0000;
/// Bit EPSR.T: Thumb state.
const THUMB: u32 = 1 << 24;
/// Bit of xPSR in a frame: the stack was padded to 8 bytes.
const PADDED: u32 = 1 << 9;

/// Size of a frame without and with floating-point registers, bytes.
const BASIC: u32 = 0x20;
const EXTENDED: u32 = 0x68;

/// Bit 4 of EXC_RETURN: a basic frame.
const RETURN_BASIC: u32 = 1 << 4;

/// First registers of a basic frame, from its lowest address.
const CALLER_SAVED: [Register; 6] =
    [Register::R(0), Register::R(1), Register::R(2), Register::R(3), Register::R(12), Register::Lr];

/// Failure to take an exception, for which no other exception can be taken: see B1.5.15.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Failure {
    /// The processor locks up.
    #[error("{0}")]
    LockUp(String),
    /// The core's backend has failed.
    #[error(transparent)]
    Core(#[from] CoreError),
}

/// Processor, core and memory while exceptions are taken or left.
pub struct Taker<'a, C> {
    /// Core with the registers.
    pub core: &'a mut C,
    /// Rest of the processor.
    pub cpu: &'a mut Processor,
    /// Memory with the stacks and the vector table.
    pub memory: &'a Memory,
    /// Accesses that the memory protection unit allows, while it is on.
    pub protection: Option<&'a Protection>,
}

/// Returns the exception masks of a core.
pub fn masks<C: Core>(core: &C) -> Masks {
    Masks {
        primask: core.get(Register::Primask) & 1 == 1,
        faultmask: core.get(Register::Faultmask) & 1 == 1,
        basepri: core.get(Register::Basepri) as u8,
    }
}

/// Returns the exception whose handler a core executes; 0 for thread mode.
pub fn active<C: Core>(core: &C) -> u16 {
    (core.get(Register::Xpsr) & EXCEPTION) as u16
}

impl<C: Core> Taker<'_, C> {
    /// Takes an exception: saves registers and starts the handler.
    ///
    /// # Errors
    /// Lock-up if neither its vector and stack nor HardFault's can be used.
    pub fn enter(&mut self, exception: u16) -> Result<(), Failure> {
        let control = self.core.get(Register::Control);
        let float = control & FLOAT_ACTIVE != 0 && self.cpu.saves_float();
        let handler = active(self.core) != 0;
        // EXC_RETURN (B1.5.8): 1 to a handler, 9 to thread mode on MSP, 0xD to thread mode on PSP.
        let mut exc_return = match (handler, control & PROCESS_STACK != 0) {
            (true, _) => 0xFFFF_FFF1,
            (false, false) => 0xFFFF_FFF9,
            (false, true) => 0xFFFF_FFFD,
        };
        if float {
            exc_return &= !RETURN_BASIC;
        }
        // A derived exception of the stacking competes with the original one by priority.
        let mut exception = exception;
        if let Err(cause) = self.push(float) {
            self.cpu.faults.note(cause);
            let derived = self.escalate(cause.exception(), "the stack cannot be written")?;
            // The original exception stays pending, unless it is the more urgent one.
            self.cpu.exceptions.set_pending(exception);
            if self.cpu.exceptions.priority(derived) < self.cpu.exceptions.priority(exception) {
                exception = derived;
            } else {
                self.cpu.exceptions.set_pending(derived);
            }
        }
        self.start_handler(exception, exc_return)
    }

    /// Takes a fault of the instruction at PC.
    ///
    /// # Errors
    /// Lock-up if no fault can be taken.
    pub fn fault(&mut self, cause: Cause) -> Result<(), Failure> {
        self.cpu.faults.note(cause);
        let exception = self.escalate(cause.exception(), &cause.to_string())?;
        self.enter(exception)
    }

    /// Takes SVCall after an SVC instruction.
    ///
    /// # Errors
    /// Lock-up if no exception can be taken.
    pub fn supervisor_call(&mut self) -> Result<(), Failure> {
        let exception = self.escalate(number::SV_CALL, "SVC")?;
        self.enter(exception)
    }

    /// Takes BKPT at PC without a debugger: a HardFault, because the debug monitor is not modelled.
    ///
    /// # Errors
    /// Lock-up if HardFault cannot be taken.
    pub fn breakpoint(&mut self) -> Result<(), Failure> {
        self.cpu.faults.debug |= BREAKPOINT;
        self.cpu.faults.hard |= DEBUG_EVENT;
        // Within NMI and HardFault no fault can be taken.
        if !self.cpu.exceptions.can_take(number::HARD_FAULT, masks(self.core)) {
            return Err(Failure::LockUp("BKPT".into()));
        }
        self.enter(number::HARD_FAULT)
    }

    /// Reports an earlier store that was refused: an asynchronous BusFault, or HardFault where that is not enabled.
    ///
    /// # Errors
    /// Lock-up in the handlers of HardFault and NMI.
    pub fn pend_store_fault(&mut self) -> Result<(), Failure> {
        self.cpu.faults.note(Cause::Store);
        // The fault is asynchronous: it waits for its priority like an interrupt.
        if self.cpu.exceptions.enabled.get(number::BUS_FAULT) {
            self.cpu.exceptions.set_pending(number::BUS_FAULT);
            return Ok(());
        }
        let exception = self.escalate(number::BUS_FAULT, "a store was refused")?;
        self.cpu.exceptions.set_pending(exception);
        Ok(())
    }

    /// Returns from a handler by `exc_return`, or continues with the handler of a pending exception. Returns `true` if
    /// the processor is in thread mode again and must sleep (SLEEPONEXIT).
    ///
    /// # Errors
    /// Lock-up if no exception can be taken.
    pub fn leave(&mut self, exc_return: u32) -> Result<bool, Failure> {
        let returning = active(self.core);
        let nested = self.cpu.exceptions.active_count();
        let to_thread = exc_return & 0xF != 1;
        // Valid values are 0xFFFF_FFE1 to 0xFFFF_FFFD with the last digit 1, 9 or 0xD.
        let shape = exc_return | 0x1F == u32::MAX && matches!(exc_return & 0xF, 1 | 9 | 0xD);
        // The last active handler returns to thread mode, others to a handler; NONBASETHRDENA allows exceptions.
        let depth = if to_thread { nested == 1 || self.cpu.any_level_returns_to_thread() } else { nested > 1 };
        let was_active = self.cpu.exceptions.is_active(returning);
        self.cpu.exceptions.deactivate(returning);
        // A return from any handler but NMI's clears FAULTMASK (B1.5.8).
        if returning != number::NMI {
            self.core.set(Register::Faultmask, 0);
        }
        if !(shape && depth && was_active) {
            return self.refuse(Cause::InvalidReturn, exc_return);
        }
        if let Some(next) = self.cpu.exceptions.preempting(masks(self.core)) {
            // Tail-chaining: the frame stays on the stack.
            self.start_handler(next, exc_return)?;
            return Ok(false);
        }
        let process = exc_return & 0xF == 0xD;
        let bank = if process { Register::Psp } else { Register::Msp };
        let float = exc_return & RETURN_BASIC == 0;
        let frame = match self.pop(self.core.get(bank), float) {
            Ok(frame) => frame,
            Err(cause) => return self.refuse(cause, exc_return),
        };
        // The frame must agree with EXC_RETURN about the mode.
        if (frame.xpsr & EXCEPTION == 0) != to_thread {
            return self.refuse(Cause::InvalidReturn, exc_return);
        }
        self.restore(&frame, bank, process);
        // An exception return is an event, and clears the exclusive monitor.
        self.cpu.event = true;
        self.core.clear_exclusive()?;
        if frame.xpsr & THUMB == 0 {
            self.fault(Cause::InvalidState)?;
            return Ok(false);
        }
        Ok(to_thread && self.cpu.sleep_on_exit())
    }

    /// Turns an impossible return into a fault, on the present frame (B1.5.8).
    fn refuse(&mut self, cause: Cause, exc_return: u32) -> Result<bool, Failure> {
        self.cpu.faults.note(cause);
        let exception = self.escalate(cause.exception(), &cause.to_string())?;
        self.start_handler(exception, exc_return | 0xF000_0000)?;
        Ok(false)
    }

    /// Returns the exception to take for a synchronous one: itself, or HardFault.
    fn escalate(&mut self, exception: u16, what: &str) -> Result<u16, Failure> {
        let masks = masks(self.core);
        if self.cpu.exceptions.can_take(exception, masks) {
            return Ok(exception);
        }
        if !self.cpu.exceptions.can_take(number::HARD_FAULT, masks) {
            return Err(Failure::LockUp(what.into()));
        }
        // FORCED marks a HardFault that replaces a disabled or too low fault.
        self.cpu.faults.hard |= FORCED;
        Ok(number::HARD_FAULT)
    }

    /// Starts a handler after its frame was made (`ExceptionTaken`).
    fn start_handler(&mut self, exception: u16, exc_return: u32) -> Result<(), Failure> {
        let mut exception = exception;
        let vector = match self.vector(exception) {
            Some(vector) => vector,
            None => {
                // An unreadable vector becomes a HardFault; if that is the one, the processor locks up.
                self.cpu.faults.hard |= VECTOR_TABLE;
                let tables = "the vector table cannot be read";
                if exception == number::HARD_FAULT {
                    return Err(Failure::LockUp(tables.into()));
                }
                exception = number::HARD_FAULT;
                self.vector(exception).ok_or_else(|| Failure::LockUp(tables.into()))?
            }
        };
        let control = self.core.get(Register::Control);
        let flags = self.core.get(Register::Xpsr) & FLAGS;
        self.core.set(Register::Control, control & !(PROCESS_STACK | FLOAT_ACTIVE));
        self.core.set(Register::Xpsr, flags | THUMB | u32::from(exception));
        self.core.set(Register::Lr, exc_return);
        self.core.set(Register::Pc, vector & !1);
        self.cpu.exceptions.activate(exception);
        self.cpu.event = true;
        self.core.clear_exclusive()?;
        if vector & 1 == 0 {
            // Bit 0 of the vector is clear: the handler would be Arm code.
            return self.fault(Cause::InvalidState);
        }
        Ok(())
    }

    fn vector(&self, exception: u16) -> Option<u32> {
        self.load(self.cpu.vector_table().wrapping_add(4 * u32::from(exception)))
    }

    fn load(&self, address: u32) -> Option<u32> {
        let (region, _) = self.memory.locate(address)?;
        if !region.direct().read {
            return None;
        }
        self.memory.read(address, Size::Word)
    }

    fn store(&self, address: u32, value: u32) -> Option<()> {
        let (region, _) = self.memory.locate(address)?;
        if !region.direct().write {
            return None;
        }
        self.memory.write(address, Size::Word, value)
    }

    /// Stores a word on the stack.
    fn save(&self, address: u32, value: u32) -> Result<(), Cause> {
        if self.protection.is_some_and(|protection| !protection.allows(address, Purpose::Store)) {
            return Err(Cause::StackingViolation);
        }
        self.store(address, value).ok_or(Cause::Stacking)
    }

    /// Saves registers (`PushStack`). `Err` means that some could not be stored; the stack pointer has moved
    /// nevertheless.
    fn push(&mut self, float: bool) -> Result<(), Cause> {
        let sp = self.core.get(Register::Sp);
        let padding = sp >> 2 & 1;
        let frame = sp.wrapping_sub(if float { EXTENDED } else { BASIC }) & !7;
        let xpsr = self.core.get(Register::Xpsr) & !PADDED | (padding * PADDED);
        self.core.set(Register::Sp, frame);
        for (word, register) in (0_u32..).zip(CALLER_SAVED) {
            self.save(frame.wrapping_add(4 * word), self.core.get(register))?;
        }
        self.save(frame.wrapping_add(0x18), self.core.get(Register::Pc))?;
        self.save(frame.wrapping_add(0x1C), xpsr)?;
        if float {
            let at = frame.wrapping_add(BASIC);
            for index in 0..16 {
                self.save(at.wrapping_add(4 * u32::from(index)), self.core.get(Register::S(index)))?;
            }
            self.save(at.wrapping_add(0x40), self.core.get(Register::Fpscr))?;
            self.cpu.float_frame = at;
        }
        Ok(())
    }

    /// Reads the registers that [`Taker::push`] saved.
    fn pop(&self, frame: u32, float: bool) -> Result<Frame, Cause> {
        let word = |index: u32| {
            let address = frame.wrapping_add(4 * index);
            if self.protection.is_some_and(|protection| !protection.allows(address, Purpose::Load)) {
                return Err(Cause::UnstackingViolation);
            }
            self.load(address).ok_or(Cause::Unstacking)
        };
        let mut registers = [0; 6];
        for (index, register) in (0_u32..).zip(&mut registers) {
            *register = word(index)?;
        }
        let (pc, xpsr) = (word(6)?, word(7)?);
        let float = if float {
            let mut saved = [0; 17];
            for (index, register) in (8_u32..).zip(&mut saved) {
                *register = word(index)?;
            }
            Some(saved)
        } else {
            None
        };
        let size = if float.is_some() { EXTENDED } else { BASIC };
        let padding = if xpsr & PADDED == 0 { 0 } else { 4 };
        let sp = frame.wrapping_add(size) | padding;
        Ok(Frame { registers, pc, xpsr, float, sp })
    }

    fn restore(&mut self, frame: &Frame, bank: Register, process: bool) {
        for (register, value) in CALLER_SAVED.into_iter().zip(frame.registers) {
            self.core.set(register, value);
        }
        if let Some(float) = &frame.float {
            for index in 0..16 {
                self.core.set(Register::S(index), float[usize::from(index)]);
            }
            self.core.set(Register::Fpscr, float[16]);
        }
        self.core.set(bank, frame.sp);
        let control = self.core.get(Register::Control) & !(PROCESS_STACK | FLOAT_ACTIVE);
        let selected = if process { PROCESS_STACK } else { 0 } | if frame.float.is_some() { FLOAT_ACTIVE } else { 0 };
        self.core.set(Register::Xpsr, frame.xpsr & !PADDED | THUMB);
        self.core.set(Register::Control, control | selected);
        self.core.set(Register::Pc, frame.pc & !1);
    }
}

/// Registers restored from a stack.
struct Frame {
    registers: [u32; 6],
    pc: u32,
    xpsr: u32,
    float: Option<[u32; 17]>,
    /// Stack pointer after the frame is removed.
    sp: u32,
}

#[cfg(test)]
mod tests;
