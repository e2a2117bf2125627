//! Debuggee of gdb: the machine's registers, memory and breakpoints.

use std::io::Write;

use gdbstub::{
    common::Signal,
    target::{
        Target, TargetError, TargetResult,
        ext::{
            base::{
                BaseOps,
                single_register_access::{SingleRegisterAccess, SingleRegisterAccessOps},
                singlethread::{
                    SingleThreadBase, SingleThreadRangeStepping, SingleThreadRangeSteppingOps, SingleThreadResume,
                    SingleThreadResumeOps, SingleThreadSingleStep, SingleThreadSingleStepOps,
                },
            },
            breakpoints::{Breakpoints, BreakpointsOps, HwBreakpoint, HwBreakpointOps, SwBreakpoint, SwBreakpointOps},
            monitor_cmd::MonitorCmdOps,
        },
    },
};
use gdbstub_arch::arm::ArmBreakpointKind;
use r4_mcu::{Bank, Chip, Size, cpu::Core};

use super::registers::{CortexM7, Number, Values};
use crate::{board::BoardSoc, tracing::Tracer, watch::SharedMachine};

/// Part of the system control space (DDI0403E B3.2) that can be read without side effects: NVIC, system control block,
/// and floating point; gdb needs it to unwind exceptions. SysTick, below, clears a flag when it is read.
const CONTROL_SPACE: std::ops::Range<u32> = 0xE000_E100..0xE000_F000;

/// Mode in which the machine continues.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Resume {
    Continue,
    Step,
    /// Steps instructions while PC is in the range from the first address to before the second.
    Range(u32, u32),
}

/// View of the machine for gdb.
pub(super) struct Inferior<C> {
    pub(super) machine: SharedMachine<C>,
    pub(super) breakpoints: Vec<u32>,
    pub(super) resume: Resume,
    pub(super) tracer: Option<Tracer<Box<dyn Write>>>,
    /// Reason why the machine cannot go on.
    pub(super) failure: Option<String>,
}

impl<C: Core> Target for Inferior<C> {
    type Arch = CortexM7;
    type Error = String;

    fn base_ops(&mut self) -> BaseOps<'_, CortexM7, String> {
        BaseOps::SingleThread(self)
    }

    fn support_breakpoints(&mut self) -> Option<BreakpointsOps<'_, Self>> {
        Some(self)
    }

    fn support_monitor_cmd(&mut self) -> Option<MonitorCmdOps<'_, Self>> {
        Some(self)
    }
}

impl<C: Core> Inferior<C> {
    /// Reads bytes at an address up to the end of its region; returns their number, which may be less than requested,
    /// or 0.
    fn read(&self, start: u32, into: &mut [u8]) -> usize {
        let mut machine = self.machine.borrow_mut();
        if CONTROL_SPACE.contains(&start) {
            let words = into.chunks_mut(4).zip((start..).step_by(4));
            let mut read = 0;
            for (bytes, address) in words {
                let Ok(word) = machine.bus_read(address, Size::Word) else { break };
                read += bytes.len();
                bytes.copy_from_slice(&word.to_le_bytes()[..bytes.len()]);
            }
            return if start.is_multiple_of(4) { read } else { 0 };
        }
        let len = into.len().min(Self::reaches(&machine.chip, start) as usize);
        machine.chip.memory().read_slice(start, &mut into[..len]).map_or(0, |()| len)
    }

    /// Returns the number of bytes from an address to the end of its region that gdb may access.
    fn reaches(chip: &BoardSoc, start: u32) -> u32 {
        let memory = chip.memory();
        let Some((region, offset)) = memory.locate(start) else { return 0 };
        // The cells of these sectors are outside the memory map, and reading them on the bus can set an error flag.
        let kept = memory.kept();
        if kept.contains(&start) || chip.is_closed() && (region.bank.is_flash() || region.bank == Bank::Backup) {
            return 0;
        }
        let end = region.base + region.len();
        if (start..end).contains(&kept.start) { kept.start - start } else { region.len() - offset }
    }
}

impl<C: Core> SingleThreadBase for Inferior<C> {
    fn read_registers(&mut self, values: &mut Values) -> TargetResult<(), Self> {
        values.read(&self.machine.borrow().core);
        Ok(())
    }

    fn write_registers(&mut self, values: &Values) -> TargetResult<(), Self> {
        values.write(&mut self.machine.borrow_mut().core);
        Ok(())
    }

    fn support_single_register_access(&mut self) -> Option<SingleRegisterAccessOps<'_, (), Self>> {
        Some(self)
    }

    fn read_addrs(&mut self, start: u32, data: &mut [u8]) -> TargetResult<usize, Self> {
        match self.read(start, data) {
            0 if !data.is_empty() => Err(TargetError::NonFatal),
            read => Ok(read),
        }
    }

    fn write_addrs(&mut self, start: u32, data: &[u8]) -> TargetResult<(), Self> {
        let machine = self.machine.borrow();
        let fits = data.len() as u64 <= u64::from(Self::reaches(&machine.chip, start));
        if !fits || machine.chip.memory().write_slice(start, data).is_none() {
            return Err(TargetError::NonFatal);
        }
        Ok(())
    }

    fn support_resume(&mut self) -> Option<SingleThreadResumeOps<'_, Self>> {
        Some(self)
    }
}

impl<C: Core> SingleRegisterAccess<()> for Inferior<C> {
    fn read_register(&mut self, (): (), register: Number, into: &mut [u8]) -> TargetResult<usize, Self> {
        let bytes = register.read(&self.machine.borrow().core).to_le_bytes();
        into[..register.len()].copy_from_slice(&bytes[..register.len()]);
        Ok(register.len())
    }

    fn write_register(&mut self, (): (), register: Number, value: &[u8]) -> TargetResult<(), Self> {
        if value.len() != register.len() {
            return Err(TargetError::NonFatal);
        }
        let value = value.iter().rev().fold(0, |value, byte| value << 8 | u64::from(*byte));
        register.write(&mut self.machine.borrow_mut().core, value);
        Ok(())
    }
}

impl<C: Core> SingleThreadResume for Inferior<C> {
    fn resume(&mut self, _: Option<Signal>) -> Result<(), String> {
        self.resume = Resume::Continue;
        Ok(())
    }

    fn support_single_step(&mut self) -> Option<SingleThreadSingleStepOps<'_, Self>> {
        Some(self)
    }

    fn support_range_step(&mut self) -> Option<SingleThreadRangeSteppingOps<'_, Self>> {
        Some(self)
    }
}

impl<C: Core> SingleThreadSingleStep for Inferior<C> {
    fn step(&mut self, _: Option<Signal>) -> Result<(), String> {
        self.resume = Resume::Step;
        Ok(())
    }
}

impl<C: Core> SingleThreadRangeStepping for Inferior<C> {
    fn resume_range_step(&mut self, start: u32, end: u32) -> Result<(), String> {
        self.resume = Resume::Range(start, end);
        Ok(())
    }
}

impl<C: Core> Breakpoints for Inferior<C> {
    fn support_sw_breakpoint(&mut self) -> Option<SwBreakpointOps<'_, Self>> {
        Some(self)
    }

    fn support_hw_breakpoint(&mut self) -> Option<HwBreakpointOps<'_, Self>> {
        Some(self)
    }
}

impl<C: Core> Inferior<C> {
    fn add(&mut self, address: u32) -> bool {
        let address = address & !1;
        if !self.breakpoints.contains(&address) {
            self.breakpoints.push(address);
        }
        true
    }

    fn remove(&mut self, address: u32) -> bool {
        let before = self.breakpoints.len();
        self.breakpoints.retain(|known| *known != address & !1);
        self.breakpoints.len() != before
    }
}

// Both kinds of breakpoint are the same: the machine observes the address, and nothing is written to flash.

impl<C: Core> SwBreakpoint for Inferior<C> {
    fn add_sw_breakpoint(&mut self, address: u32, _: ArmBreakpointKind) -> TargetResult<bool, Self> {
        Ok(self.add(address))
    }

    fn remove_sw_breakpoint(&mut self, address: u32, _: ArmBreakpointKind) -> TargetResult<bool, Self> {
        Ok(self.remove(address))
    }
}

impl<C: Core> HwBreakpoint for Inferior<C> {
    fn add_hw_breakpoint(&mut self, address: u32, _: ArmBreakpointKind) -> TargetResult<bool, Self> {
        Ok(self.add(address))
    }

    fn remove_hw_breakpoint(&mut self, address: u32, _: ArmBreakpointKind) -> TargetResult<bool, Self> {
        Ok(self.remove(address))
    }
}
