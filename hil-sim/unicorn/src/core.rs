//! Cortex-M7 core on Unicorn: [`UnicornCore`].

use std::cell::Cell;
use std::ptr::NonNull;
use std::rc::Rc;

use r4_mcu::Region;
use r4_mcu::cpu::{Core, CoreBus, CoreError, CoreStop, Fault, Register, Why};
use unicorn_engine::{Arch, ArmCpuModel, Mode, RegisterARM, UcHookId, Unicorn, uc_error};

use crate::blocks::{WFE, WFI, YIELD, halfword, is_hint};
use crate::conditional;
use crate::hooks::{Engine, install, refresh_limits, stop};
use crate::mapping::{STUB, executes, map_all};
use crate::registers::number;
use crate::state::State;

/// Numbers of exceptions in the translator.
mod raised {
    pub(super) const UNDEFINED: u32 = 1;
    pub(super) const SVC: u32 = 2;
    pub(super) const PREFETCH_ABORT: u32 = 3;
    pub(super) const DATA_ABORT: u32 = 4;
    pub(super) const BREAKPOINT: u32 = 7;
    pub(super) const EXCEPTION_EXIT: u32 = 8;
    pub(super) const NO_COPROCESSOR: u32 = 17;
    pub(super) const INVALID_STATE: u32 = 18;
    pub(super) const UNALIGNED: u32 = 22;
}

/// Thumb bit of the EPSR.
pub(crate) const THUMB: u32 = 1 << 24;

/// Cortex-M7 core executed by Unicorn.
pub struct UnicornCore {
    engine: Engine,
    /// Memory that is mapped by pointer; held here only to keep it alive.
    mapped: Vec<Rc<[Cell<u8>]>>,
    observed: Vec<UcHookId>,
}

pub(crate) fn failed(what: &str, error: uc_error) -> CoreError {
    CoreError(format!("{what}: {error:?}"))
}

impl UnicornCore {
    /// Creates a processor without memory: call [`Core::map`] next.
    ///
    /// # Errors
    /// [`CoreError`] with Unicorn's error.
    pub fn new() -> Result<Self, CoreError> {
        // Not Mode::MCLASS, which is a Cortex-M33 without double precision.
        let mut engine =
            Unicorn::new_with_data(Arch::ARM, Mode::THUMB, State::new()).map_err(|error| failed("open", error))?;
        engine.ctl_set_cpu_model(ArmCpuModel::CORTEX_M7 as i32).map_err(|error| failed("processor", error))?;
        // Unicorn's own stop addresses are disabled, because address 0, a valid one in ITCM, would be among them.
        engine.ctl_exits_enable().map_err(|error| failed("exits", error))?;
        install(&mut engine).map_err(|error| failed("hooks", error))?;
        Ok(Self { engine, mapped: Vec::new(), observed: Vec::new() })
    }

    fn register(&self, register: RegisterARM) -> u32 {
        // Cannot fail: the register exists in the only processor that this crate creates.
        self.engine.reg_read(register).unwrap_or(0) as u32
    }

    /// Renews the translator's cached digest of mode and privilege, which it recomputes when flags are written under
    /// this name.
    fn renew_mode(&mut self) {
        let flags = self.register(RegisterARM::XPSR);
        let _ = self.engine.reg_write(RegisterARM::APSR_NZCV, flags.into());
    }

    /// Returns true if a hint that ends its block was executed last: PC is behind it.
    fn at_hint(&self, hint: u16) -> bool {
        let state = self.engine.get_data();
        let pc = self.register(RegisterARM::PC);
        let halfword = |back| halfword(state.code(pc.wrapping_sub(back), pc), 0);
        let is = |first: Option<u16>, second| first.is_some_and(|first| is_hint(first, second, hint));
        let at_end = state.block.bytes() > 0 && pc == state.block.end();
        at_end && (is(halfword(2), None) || is(halfword(4), halfword(2)))
    }

    /// Reason why the engine returned by itself.
    fn why(&self, result: Result<(), uc_error>) -> Result<Why, CoreError> {
        let state = self.engine.get_data();
        let pc = self.register(RegisterARM::PC);
        let thumb = self.register(RegisterARM::XPSR) & THUMB != 0;
        let exception = match state.exception {
            Some(raised::SVC) => Some(Why::Svc),
            Some(raised::EXCEPTION_EXIT) => Some(Why::ExceptionReturn(pc | 1)),
            Some(raised::BREAKPOINT) => {
                let operand = halfword(state.code(pc, pc.wrapping_add(2)), 0).unwrap_or(0) as u8;
                Some(Why::Breakpoint(operand))
            }
            Some(raised::UNDEFINED) => Some(Why::Fault(Fault::Undefined)),
            Some(raised::PREFETCH_ABORT) => Some(Why::Fault(Fault::Fetch)),
            Some(raised::DATA_ABORT | raised::UNALIGNED) => Some(Why::Fault(Fault::Unaligned)),
            Some(raised::NO_COPROCESSOR) => Some(Why::Fault(Fault::NoCoprocessor)),
            Some(raised::INVALID_STATE) => Some(Why::Fault(Fault::InvalidState)),
            Some(number) => return Err(CoreError(format!("exception {number} of the translator at {pc:#010x}"))),
            None => None,
        };
        if let Some(why) = exception {
            return Ok(why);
        }
        Ok(match result {
            Ok(()) if self.at_hint(WFI) => Why::Wfi,
            Err(uc_error::INSN_INVALID | uc_error::EXCEPTION) if !thumb => Why::Fault(Fault::InvalidState),
            Err(uc_error::INSN_INVALID) if self.at_hint(WFE) => Why::Wfe,
            Err(uc_error::INSN_INVALID) if self.at_hint(YIELD) => Why::Yield,
            Err(uc_error::INSN_INVALID) => Why::Fault(Fault::Undefined),
            Err(uc_error::READ_PROT) => Why::Fault(Fault::Load),
            Err(uc_error::FETCH_PROT | uc_error::FETCH_UNMAPPED) => Why::Fault(Fault::Fetch),
            Ok(()) => return Err(CoreError(format!("stopped at {pc:#010x} without a reason"))),
            Err(error) => return Err(failed(&format!("run, at {pc:#010x}"), error)),
        })
    }

    fn start(&mut self) -> Result<CoreStop, CoreError> {
        let pc = self.register(RegisterARM::PC);
        let thumb = u32::from(self.register(RegisterARM::XPSR) & THUMB != 0);
        let result = self.engine.emu_start(u64::from(pc | thumb), 0, 0, 0);
        let state = self.engine.get_data_mut();
        if let Some(error) = state.error.take() {
            return Err(error);
        }
        // Before a block: the previous one was executed to its end.
        if let Some(why @ (Why::Limit | Why::MaskChanged)) = state.why {
            return Ok(CoreStop { instructions: state.executed, why });
        }
        let stop_at = state.stop_at;
        let pc = self.register(RegisterARM::PC);
        let why = match self.engine.get_data().why {
            // Within an IT block the engine does not stop: the reason is then that of its later stop.
            Some(why) if stop_at == pc => why,
            _ => self.why(result)?,
        };
        let instructions = self.engine.get_data().instructions_before(pc);
        Ok(CoreStop { instructions, why })
    }

    /// Adds a code hook that stops before an instruction.
    fn stop_before(&mut self, address: u32, why: Why) -> Result<UcHookId, CoreError> {
        self.stop_within(address.into(), address.into(), why)
    }

    /// Adds a code hook that stops before any instruction in a range except the first of the run; 1 and 0 mean
    /// everywhere.
    fn stop_within(&mut self, first: u64, last: u64, why: Why) -> Result<UcHookId, CoreError> {
        let hook = self.engine.add_code_hook(first, last, move |engine, address, _| {
            let state = engine.get_data_mut();
            let address = address as u32;
            if state.first.take() == Some(address) {
                return;
            }
            let start = state.block.address;
            let offset = address.wrapping_sub(start);
            if offset < state.block.bytes() && conditional::is_within(state.code(start, address), offset as usize) {
                return;
            }
            state.why = Some(why);
            state.stop_at = address;
            stop(engine);
        });
        let hook = hook.map_err(|error| failed("observe", error))?;
        self.engine.ctl_flush_tb().map_err(|error| failed("flush", error))?;
        Ok(hook)
    }

    fn remove(&mut self, hook: UcHookId) -> Result<(), CoreError> {
        self.engine.remove_hook(hook).map_err(|error| failed("observe", error))?;
        self.engine.ctl_flush_tb().map_err(|error| failed("flush", error))
    }
}

impl Core for UnicornCore {
    fn map(&mut self, regions: &[Region]) -> Result<(), CoreError> {
        self.mapped = regions.iter().map(|region| Rc::clone(region.bytes())).collect();
        let code = |region: &Region| executes(region).then(|| (region.base, Rc::clone(region.bytes())));
        self.engine.get_data_mut().code = regions.iter().filter_map(code).collect();
        map_all(&mut self.engine, regions).map_err(|error| failed("map", error))
    }

    fn remap(&mut self, regions: &[Region]) -> Result<(), CoreError> {
        crate::mapping::remap(&mut self.engine, regions).map_err(|error| failed("remap", error))
    }

    fn code_changed(&mut self) -> Result<(), CoreError> {
        let state = self.engine.get_data_mut();
        state.cache.clear();
        state.parts.get_mut().clear();
        self.engine.ctl_flush_tb().map_err(|error| failed("flush", error))
    }

    fn get(&self, register: Register) -> u32 {
        self.engine.reg_read(number(register)).unwrap_or(0) as u32
    }

    fn set(&mut self, register: Register, value: u32) {
        let (number, value) = match register {
            Register::Pc => (number(register), value | 1),
            // This name writes every field; the plain one writes only flags.
            Register::Xpsr => (RegisterARM::XPSR_NZCVQG.into(), value | THUMB),
            _ => (number(register), value),
        };
        // Cannot fail: every register exists.
        let _ = self.engine.reg_write(number, value.into());
        if matches!(register, Register::Xpsr | Register::Control) {
            self.renew_mode();
        }
    }

    fn set_fpu(&mut self, on: bool) {
        self.engine.get_data_mut().fpu = on;
    }

    fn clear_exclusive(&mut self) -> Result<(), CoreError> {
        if !std::mem::take(&mut self.engine.get_data_mut().claimed) {
            return Ok(());
        }
        let pc = self.register(RegisterARM::PC);
        let result = self.engine.emu_start(u64::from(STUB) | 1, 0, 0, 0);
        result.map_err(|error| failed("clear the exclusive monitor", error))?;
        self.set(Register::Pc, pc);
        Ok(())
    }

    fn observe(&mut self, addresses: &[u32]) -> Result<(), CoreError> {
        for hook in std::mem::take(&mut self.observed) {
            self.remove(hook)?;
        }
        for address in addresses {
            let hook = self.stop_before(*address, Why::Observed)?;
            self.observed.push(hook);
            // If the instruction is in an IT block, stop before that block.
            for back in (2..conditional::LONGEST).step_by(2) {
                let Some(start) = address.checked_sub(back) else { break };
                if conditional::holds(self.engine.get_data().code(start, *address), back as usize) {
                    let hook = self.stop_before(start, Why::Observed)?;
                    self.observed.push(hook);
                }
            }
        }
        Ok(())
    }

    fn run(&mut self, bus: &mut dyn CoreBus) -> Result<CoreStop, CoreError> {
        self.lend(bus, |core| {
            let mut result = core.start();
            if let (Ok(stop), Some(float_at)) = (&result, core.engine.get_data().float_at) {
                let before = stop.instructions;
                let rest = core.run_to_float(float_at);
                result = rest.map(|stop| CoreStop { instructions: before + stop.instructions, ..stop });
            }
            result
        })
    }

    fn step(&mut self, bus: &mut dyn CoreBus) -> Result<CoreStop, CoreError> {
        let hook = self.stop_within(1, 0, Why::Observed)?;
        let result = self.lend(bus, Self::step_one);
        self.remove(hook)?;
        result
    }

    fn is_within_block(&self) -> bool {
        let block = &self.engine.get_data().block;
        let pc = self.register(RegisterARM::PC);
        block.bytes() > 0 && block.address < pc && pc < block.end()
    }
}

impl UnicornCore {
    /// Calls `run` with the bus lent to the hooks.
    #[allow(unsafe_code, reason = "the bus is lent to hooks for one run")]
    fn lend(
        &mut self,
        bus: &mut dyn CoreBus,
        run: impl FnOnce(&mut Self) -> Result<CoreStop, CoreError>,
    ) -> Result<CoreStop, CoreError> {
        let pc = self.register(RegisterARM::PC);
        // SAFETY: only the lifetime is changed; the pointer is removed from the state before this function returns.
        let lent =
            unsafe { std::mem::transmute::<NonNull<dyn CoreBus + '_>, NonNull<dyn CoreBus>>(NonNull::from(bus)) };
        let state = self.engine.get_data_mut();
        state.bus = Some(lent);
        state.begin(pc);
        refresh_limits(&mut self.engine);
        let result = run(self);
        self.engine.get_data_mut().bus = None;
        result
    }

    /// Executes the instruction at PC, with a hook before the next one.
    fn step_one(&mut self) -> Result<CoreStop, CoreError> {
        let pc = self.register(RegisterARM::PC);
        let result = self.start()?;
        // The block at PC has floating point that is not allowed.
        match self.engine.get_data().float_at {
            Some(at) if at == pc => Ok(CoreStop { instructions: 0, why: Why::Fault(Fault::NoCoprocessor) }),
            Some(at) => {
                let state = self.engine.get_data_mut();
                state.begin(pc);
                state.float_at = Some(at);
                self.start()
            }
            None => Ok(result),
        }
    }

    /// Executes up to `address`, where the block at PC has floating point while that is not allowed.
    fn run_to_float(&mut self, address: u32) -> Result<CoreStop, CoreError> {
        let why = Why::Fault(Fault::NoCoprocessor);
        let pc = self.register(RegisterARM::PC);
        if pc == address {
            return Ok(CoreStop { instructions: 0, why });
        }
        let hook = self.stop_before(address, why)?;
        let state = self.engine.get_data_mut();
        state.begin(pc);
        state.float_at = Some(address);
        let result = self.start();
        self.remove(hook)?;
        result
    }
}
