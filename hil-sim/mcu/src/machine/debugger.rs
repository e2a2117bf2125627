//! What a debugger asks for besides memory and registers, which are public.

use super::{Change, Machine, MachineError, Stopped, bus};
use crate::chip::{AccessError, Chip};
use crate::cpu::{Core, Register, take::active};
use crate::peripheral::Size;

/// The private peripheral bus begins here (DDI0403E B3.1).
const PRIVATE: u32 = 0xE000_0000;

impl<C: Core, S: Chip> Machine<C, S> {
    /// Executes one instruction, or takes one exception, and stops with [`Reason::Stepped`](super::Reason::Stepped); or with
    /// another reason, as [`Machine::run_until`] does, a moment that comes before the end of a sleep among them.
    ///
    /// # Errors
    /// As [`Machine::run_until`].
    pub fn step_until(&mut self, t_ns: u64) -> Result<Stopped, MachineError> {
        self.stepping = true;
        let stopped = self.run_until(t_ns);
        self.stepping = false;
        stopped
    }

    /// Keeps exceptions from now on, for [`Machine::take_changes`], or no longer.
    pub fn keep_changes(&mut self, on: bool) {
        self.changes = on.then(Vec::new);
    }

    /// Exceptions taken and left since this was asked for last, in order.
    pub fn take_changes(&mut self) -> Vec<Change> {
        self.changes.as_mut().map(std::mem::take).unwrap_or_default()
    }

    /// The core sleeps until an interrupt or event.
    #[must_use]
    pub fn is_asleep(&self) -> bool {
        self.sleep.is_some()
    }

    /// A read on the bus at this moment, with everything it does to a peripheral: a byte that is read is taken.
    ///
    /// # Errors
    /// What a program's read would meet.
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

    /// Bytes from memory as they are, without any effect; `None` where no memory is, or not all of it.
    #[must_use]
    pub fn peek(&self, address: u32, len: usize) -> Option<Vec<u8>> {
        let mut bytes = vec![0; len];
        self.chip.memory().read_slice(address, &mut bytes)?;
        Some(bytes)
    }

    /// Where the program is: PC, with the function that holds it.
    #[must_use]
    pub fn location(&self) -> String {
        self.symbols.locate(self.core.get(Register::Pc))
    }
}
