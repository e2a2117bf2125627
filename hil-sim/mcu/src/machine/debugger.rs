//! Functions for debuggers, besides memory and registers, which are public.

use super::{Change, Machine, MachineError, Stopped, bus};
use crate::chip::{AccessError, Chip};
use crate::cpu::{Core, Register, take::active};
use crate::peripheral::Size;

/// First address of the private peripheral bus (DDI0403E B3.1).
const PRIVATE: u32 = 0xE000_0000;

impl<C: Core, S: Chip> Machine<C, S> {
    /// Executes one instruction, or takes one exception, and stops with [`Reason::Stepped`](super::Reason::Stepped); or
    /// stops for another reason, as [`Machine::run_until`] does, such as a time before the end of a sleep.
    ///
    /// # Errors
    /// Those of [`Machine::run_until`].
    pub fn step_until(&mut self, t_ns: u64) -> Result<Stopped, MachineError> {
        self.stepping = true;
        let stopped = self.run_until(t_ns);
        self.stepping = false;
        stopped
    }

    /// Starts or ends the recording of exceptions for [`Machine::take_changes`].
    pub fn keep_changes(&mut self, on: bool) {
        self.changes = on.then(Vec::new);
    }

    /// Takes the exception entries and returns since the last call, in order.
    pub fn take_changes(&mut self) -> Vec<Change> {
        self.changes.as_mut().map(std::mem::take).unwrap_or_default()
    }

    /// Returns true while the core sleeps until an interrupt or event.
    #[must_use]
    pub fn is_asleep(&self) -> bool {
        self.sleep.is_some()
    }

    /// Reads on the bus at this time, with all side effects on a peripheral: a receive register loses its byte.
    ///
    /// # Errors
    /// Those of a read by the program.
    pub fn bus_read(&mut self, address: u32, size: Size) -> Result<u32, AccessError> {
        let now_ns = self.now_ns();
        let value = if address >= PRIVATE {
            let active = active(&self.core);
            self.cpu.read(address, size, now_ns, active)?
        } else {
            self.chip.read(now_ns, address, size)?
        };
        bus::take_irqs(&mut self.chip, &mut self.cpu, &mut self.irqs);
        Ok(value)
    }

    /// Reads memory without side effects; `None` where no memory holds all of it.
    #[must_use]
    pub fn peek(&self, address: u32, len: usize) -> Option<Vec<u8>> {
        let mut bytes = vec![0; len];
        self.chip.memory().read_slice(address, &mut bytes)?;
        Some(bytes)
    }

    /// Returns PC, with the function that contains it.
    #[must_use]
    pub fn location(&self) -> String {
        self.symbols.locate(self.core.get(Register::Pc))
    }
}
