//! Fake core that keeps registers and executes nothing, for tests of the processor around it.

use std::collections::HashMap;

use super::core::{Core, CoreBus, CoreError, CoreStop, Register};
use crate::memory::Region;

/// Register file of the fake core, with both stack pointers banked as in a real one.
#[derive(Default)]
pub(crate) struct FakeCore {
    registers: HashMap<Register, u32>,
    pub(crate) monitor_cleared: u32,
}

impl FakeCore {
    fn bank(&self, register: Register) -> Register {
        let handler = self.get(Register::Xpsr) & 0x1FF != 0;
        match register {
            Register::Sp if !handler && self.get(Register::Control) & 2 != 0 => Register::Psp,
            Register::Sp => Register::Msp,
            other => other,
        }
    }
}

impl Core for FakeCore {
    fn map(&mut self, _: &[Region]) -> Result<(), CoreError> {
        Ok(())
    }

    fn remap(&mut self, _: &[Region]) -> Result<(), CoreError> {
        Ok(())
    }

    fn code_changed(&mut self) -> Result<(), CoreError> {
        Ok(())
    }

    fn get(&self, register: Register) -> u32 {
        let register = if register == Register::Sp { self.bank(register) } else { register };
        self.registers.get(&register).copied().unwrap_or(0)
    }

    fn set(&mut self, register: Register, value: u32) {
        self.registers.insert(self.bank(register), value);
    }

    fn set_fpu(&mut self, _: bool) {}

    fn clear_exclusive(&mut self) -> Result<(), CoreError> {
        self.monitor_cleared += 1;
        Ok(())
    }

    fn observe(&mut self, _: &[u32]) -> Result<(), CoreError> {
        Ok(())
    }

    fn run(&mut self, _: &mut dyn CoreBus) -> Result<CoreStop, CoreError> {
        Err(CoreError("a fake core executes nothing".into()))
    }

    fn step(&mut self, bus: &mut dyn CoreBus) -> Result<CoreStop, CoreError> {
        self.run(bus)
    }

    fn is_within_block(&self) -> bool {
        false
    }
}
