//! Machine: a core, the processor around it, the chip around that, and virtual time.
//!
//! Time passes in two ways. While the core executes, it passes with instructions, at
//! [`Settings::instructions_per_second`]; a register access happens at the time of its instruction. While the core
//! sleeps, time jumps to the next event. Interrupts are taken between blocks of instructions. A block ends at the first
//! branch, and at instructions that change which interrupts may be taken (CPSIE, MSR, ISB). So a program's results do
//! not show the difference; only its timing does, by the length of a block.
//!
//! Runs are deterministic, however [`Machine::run_until`] cuts them into pieces.

mod bus;
mod debugger;
mod error;
mod poll;
mod profile;
mod symbols;
mod time;
mod trace;

pub use error::{LoadError, MachineError, Reason, Settings, Stopped};
pub use profile::{Moment, Profile, StackArea};
pub use symbols::Symbols;
pub use trace::{Change, Trace};

use crate::chip::Chip;
use crate::context::ResetCause;
use crate::cpu::take::{Failure, Taker, active, masks};
use crate::cpu::{Cause, Core, CoreStop, Fault, Masks, Processor, Protection, Purpose, Register, Requests, Why};
use crate::memory::Region;
use bus::Bus;
use poll::{OneBlock, Polls};
use time::Instructions;

/// Largest number of iterations of the run loop without progress of time; beyond it the machine reports an error.
/// Nested exceptions need far fewer.
const STANDSTILL: u32 = 10_000;

/// Kind of the core's sleep.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Sleep {
    /// Sleep by WFI or SLEEPONEXIT, until an interrupt.
    Interrupt,
    /// Sleep by WFE, until an event.
    Event,
}

/// Core and chip with their virtual time.
pub struct Machine<C, S> {
    /// Core with the instruction set. A debugger may write its registers between runs.
    pub core: C,
    /// Chip with its peripherals and memories.
    pub chip: S,
    cpu: Processor,
    settings: Settings,
    time: Instructions,
    sleep: Option<Sleep>,
    /// Time until which the core stalls on the bus; it takes no exceptions meanwhile.
    waits_until_ns: Option<u64>,
    core_hz: u64,
    mapping_version: u32,
    code_version: u32,
    irqs: Vec<(u16, bool)>,
    symbols: Symbols,
    trace: Option<Trace>,
    profile: Option<Box<Profile>>,
    /// Exception entries and returns since they were last taken; `None` without recording.
    changes: Option<Vec<Change>>,
    /// Execute a single instruction.
    stepping: bool,
    /// The core stopped within a block: no interrupt is taken before the block's end, as if it had not stopped.
    unfinished: bool,
    just_reset: Option<ResetCause>,
    observed: Vec<u32>,
    /// Address of an observed instruction that was reported, and is to be executed next.
    told: Option<u32>,
    /// Accesses that the memory protection unit allows, while it is on.
    protection: Option<Protection>,
    polls: Polls,
    one_block: OneBlock,
    /// Address of a refused load whose error is ignored: it is about to be executed again.
    ignored_load: Option<u32>,
    runs: u64,
}

impl<C: Core, S: Chip> Machine<C, S> {
    /// Makes a machine at time 0 whose chip has just been powered; load a program, then call [`Machine::reset`].
    ///
    /// # Errors
    /// Those of the core.
    pub fn new(mut core: C, chip: S, settings: Settings) -> Result<Self, MachineError> {
        core.map(chip.memory().regions())?;
        let core_hz = chip.core_hz();
        Ok(Self {
            cpu: Processor::new(0, core_hz, chip.vector_table()),
            settings,
            time: Instructions::new(settings.instructions_per_second),
            sleep: None,
            waits_until_ns: None,
            core_hz,
            mapping_version: chip.memory().mapping_version(),
            code_version: chip.memory().code_version(),
            irqs: Vec::new(),
            symbols: Symbols::default(),
            trace: None,
            profile: None,
            changes: None,
            stepping: false,
            unfinished: false,
            just_reset: None,
            observed: Vec::new(),
            told: None,
            protection: None,
            polls: Polls::new(settings.leave_out_polling),
            one_block: OneBlock::default(),
            ignored_load: None,
            runs: 0,
            core,
            chip,
        })
    }

    /// Writes an ELF file's segments to the memories at their load addresses, and keeps its symbols.
    ///
    /// # Errors
    /// [`LoadError`] for another file format, another processor, or a segment that does not fit.
    pub fn load_elf(&mut self, elf: &[u8]) -> Result<(), LoadError> {
        self.symbols = symbols::load(elf, self.chip.memory())?;
        Ok(())
    }

    /// Resets chip and processor for `cause`; the first instruction is that of the vector table's reset handler.
    ///
    /// # Errors
    /// Those of the core; an unreadable vector table.
    pub fn reset(&mut self, cause: ResetCause) -> Result<(), MachineError> {
        let now_ns = self.now_ns();
        self.chip.reset(now_ns, cause);
        self.core_hz = self.chip.core_hz();
        let table = self.chip.vector_table();
        self.cpu.reset(now_ns, self.core_hz, table);
        self.sleep = None;
        self.waits_until_ns = None;
        self.unfinished = false;
        // The reset may have changed clocks and swapped banks, so the vector table is read after the memory map is up
        // to date.
        self.follow_memory()?;
        let memory = self.chip.memory();
        let word = |address| memory.read(address, crate::Size::Word);
        let (Some(stack), Some(start)) = (word(table), word(table.wrapping_add(4))) else {
            return Err(MachineError::LockUp {
                at_ns: now_ns,
                location: "reset".into(),
                what: format!("no vector table at {table:#010x}"),
            });
        };
        self.core.set(Register::Control, 0);
        // Only EPSR.T is set: Thumb state, thread mode.
        self.core.set(Register::Xpsr, 1 << 24);
        for register in [Register::Primask, Register::Basepri, Register::Faultmask, Register::Fpscr, Register::Psp] {
            self.core.set(register, 0);
        }
        // Hardware leaves these registers undefined; zeros make every run the same.
        (0..=12).for_each(|index| self.core.set(Register::R(index), 0));
        (0..32).for_each(|index| self.core.set(Register::S(index), 0));
        self.core.set(Register::Msp, stack & !3);
        self.core.set(Register::Lr, u32::MAX);
        self.core.set(Register::Pc, start & !1);
        self.core.set_fpu(false);
        self.core.clear_exclusive()?;
        if let Some(profile) = &mut self.profile {
            profile.restarted(self.chip.memory(), stack & !3);
        }
        Ok(())
    }

    /// Returns the virtual time, ns.
    #[must_use]
    pub fn now_ns(&self) -> u64 {
        self.time.now_ns()
    }

    /// Returns the instructions executed since power-on; not a number of cycles.
    #[must_use]
    pub fn instructions(&self) -> u64 {
        self.time.executed()
    }

    /// Returns how often the core was started since power-on: each start costs the real time of many instructions.
    #[must_use]
    pub fn runs(&self) -> u64 {
        self.runs
    }

    /// Returns the processor around the core: exceptions, fault status.
    #[must_use]
    pub fn processor(&self) -> &Processor {
        &self.cpu
    }

    /// Returns the symbols of the loaded program.
    #[must_use]
    pub fn symbols(&self) -> &Symbols {
        &self.symbols
    }

    /// Stops before these instructions from now on, with [`Reason::Observed`]; an empty list ends that. The next run
    /// executes the instruction that was reported, also if others are observed meanwhile.
    ///
    /// # Errors
    /// Those of the core.
    pub fn observe(&mut self, addresses: &[u32]) -> Result<(), MachineError> {
        self.observed = addresses.to_vec();
        self.told = self.told.filter(|told| addresses.contains(told));
        Ok(self.core.observe(addresses)?)
    }

    /// Starts a trace of exceptions.
    pub fn start_trace(&mut self) {
        self.trace = Some(Trace::new());
    }

    /// Returns the trace; `None` if none was started.
    #[must_use]
    pub fn trace(&self) -> Option<Trace> {
        self.trace
    }

    /// Starts to count instructions and stack by exception, right after a reset. `mark` is an instruction whose
    /// executions are recorded if it is also observed. Replaces an earlier profile.
    pub fn start_profile(&mut self, stack: StackArea, mark: Option<u32>) {
        let sp = self.core.get(Register::Msp);
        self.profile = Some(Box::new(Profile::new(stack, mark, self.chip.memory(), sp)));
    }

    /// Returns the profile; `None` if none was started.
    pub fn profile(&mut self) -> Option<&mut Profile> {
        self.profile.as_deref_mut()
    }

    /// Runs to a time, or until another reason for a stop. The run can end up to one block of instructions later.
    ///
    /// # Errors
    /// [`MachineError`] names the reason.
    pub fn run_until(&mut self, t_ns: u64) -> Result<Stopped, MachineError> {
        let mut standstill = (0, 0, 0);
        loop {
            // The rest of an interrupted block comes before everything else, as if the run had not been cut.
            if self.unfinished {
                if let Some(reason) = self.execute(t_ns)? {
                    return Ok(self.stopped(reason));
                }
                continue;
            }
            self.settle()?;
            // Progress is time or instructions; nested exceptions need a few rounds without either.
            standstill = match (self.now_ns(), self.instructions()) {
                (now_ns, executed) if (now_ns, executed) == (standstill.0, standstill.1) => {
                    (now_ns, executed, standstill.2 + 1)
                }
                (now_ns, executed) => (now_ns, executed, 0),
            };
            if standstill.2 > STANDSTILL {
                return Err(self.processor_error("neither time nor instructions pass: an event that never ends".into()));
            }
            if let Some(cause) = self.just_reset.take() {
                return Ok(self.stopped(Reason::Reset(cause)));
            }
            if self.chip.outside_waits() {
                return Ok(self.stopped(Reason::Outside));
            }
            // Events due at `t_ns` have been handled by now, the instructions at `t_ns` have not.
            if self.now_ns() >= t_ns {
                return Ok(self.stopped(Reason::Time));
            }
            if let Some(until_ns) = self.waits_until_ns {
                if until_ns > self.now_ns() {
                    self.time.jump(self.next_event_ns().min(until_ns).clamp(self.now_ns(), t_ns));
                    continue;
                }
                self.waits_until_ns = None;
            }
            if self.chip.is_halted() {
                self.time.jump(self.next_event_ns().clamp(self.now_ns(), t_ns));
                continue;
            }
            if let Some(sleep) = self.sleep {
                if self.wakes(sleep) {
                    self.sleep = None;
                } else {
                    self.time.jump(self.next_event_ns().clamp(self.now_ns(), t_ns));
                    continue;
                }
            }
            // Pending is checked first: the comparison of priorities is slower, and rarely needed.
            if self.cpu.exceptions.is_any_pending()
                && let Some(exception) = self.cpu.exceptions.preempting(masks(&self.core))
            {
                self.take(|taker| taker.enter(exception).map(|()| false))?;
                if self.stepping {
                    return Ok(self.stopped(Reason::Stepped));
                }
            }
            if self.polls.suspected() {
                // A debugger that steps or observes must see each instruction.
                if !self.stepping && self.observed.is_empty() {
                    self.leave_out_polling(t_ns)?;
                    continue;
                }
                self.polls.wrote();
            }
            if let Some(reason) = self.execute(t_ns)? {
                return Ok(self.stopped(reason));
            }
        }
    }

    fn stopped(&self, reason: Reason) -> Stopped {
        Stopped { at_ns: self.now_ns(), reason }
    }

    fn next_event_ns(&self) -> u64 {
        self.chip.next_event_ns().min(self.cpu.systick.next_event_ns())
    }

    /// Advances chip and timers to now, and carries out the consequences.
    fn settle(&mut self) -> Result<(), MachineError> {
        let now_ns = self.now_ns();
        self.chip.advance(now_ns);
        self.cpu.advance(now_ns);
        bus::take_irqs(&mut self.chip, &mut self.cpu, &mut self.irqs);
        bus::follow_clock(&self.chip, &mut self.cpu, &mut self.core_hz, now_ns);
        self.follow_memory()?;
        // The protection request stays: it is handled before the next run, at the priority that is valid then.
        let protection = self.cpu.requests.protection;
        let requests = std::mem::replace(&mut self.cpu.requests, Requests { protection, ..Requests::default() });
        if requests.fpu {
            self.core.set_fpu(self.cpu.fpu_enabled());
        }
        // A software reset precedes one of the chip at the same moment.
        let cause = if requests.reset { Some(ResetCause::Software) } else { self.chip.take_reset() };
        if let Some(cause) = cause {
            self.reset(cause)?;
            self.just_reset = Some(cause);
        }
        Ok(())
    }

    fn follow_memory(&mut self) -> Result<(), MachineError> {
        let memory = self.chip.memory();
        if self.mapping_version != memory.mapping_version() {
            self.mapping_version = memory.mapping_version();
            self.core.remap(memory.regions())?;
        }
        if self.code_version != memory.code_version() {
            self.code_version = memory.code_version();
            self.core.code_changed()?;
        }
        Ok(())
    }

    /// Updates the memory protection unit for the priority of the next code. A change of FAULTMASK within a run takes
    /// effect at the next one.
    fn follow_protection(&mut self) -> Result<(), MachineError> {
        let changed = std::mem::take(&mut self.cpu.requests.protection);
        if !changed && self.protection.is_none() && !self.cpu.has_protection() {
            return Ok(());
        }
        let on = self.cpu.is_protected(masks(&self.core));
        if changed || on != self.protection.is_some() {
            self.protection = on.then(|| self.cpu.protection());
            self.core.protect(self.protection.as_ref())?;
        }
        Ok(())
    }

    /// Returns true if the sleep ends (B1.5.17 and B1.5.18).
    fn wakes(&mut self, sleep: Sleep) -> bool {
        if sleep == Sleep::Event && self.cpu.event {
            self.cpu.event = false;
            return true;
        }
        if !self.cpu.exceptions.is_any_pending() {
            return false;
        }
        let masks = masks(&self.core);
        // WFI wakes also for an interrupt that only PRIMASK holds back; WFE only for one that is taken.
        let unmasked = Masks { primask: masks.primask && sleep == Sleep::Event, ..masks };
        self.cpu.exceptions.preempting(unmasked).is_some()
    }

    /// Executes up to `t_ns` or the next event; returns the reason of an earlier stop.
    fn execute(&mut self, t_ns: u64) -> Result<Option<Reason>, MachineError> {
        let pc = self.core.get(Register::Pc);
        // An instruction reported before is executed now; while stepping every one is.
        if self.told == Some(pc) || self.stepping {
            self.told = None;
        } else if self.observed.contains(&pc) {
            return Ok(Some(self.observed(pc)));
        }
        self.follow_protection()?;
        let executing = active(&self.core);
        // Only if an exception is pending can a change of the masks matter to the run.
        let masked = self.cpu.exceptions.preempting(Masks::NONE).is_some();
        let mut bus = Bus::new(
            &mut self.chip,
            &mut self.cpu,
            self.time,
            t_ns,
            executing,
            &mut self.irqs,
            &mut self.core_hz,
            &mut self.mapping_version,
            self.protection.as_ref(),
            &mut self.polls,
        );
        bus.one_block = self.one_block.is_on();
        bus.watch_masks = masked;
        bus.rest_of_block = std::mem::take(&mut self.unfinished);
        bus.ignored_load = self.ignored_load.take();
        self.runs += 1;
        let run = if self.stepping { self.core.step(&mut bus) } else { self.core.run(&mut bus) };
        let CoreStop { instructions, why } = run?;
        let waits_until_ns = bus.waits_until_ns;
        let (reads, wrote) = (std::mem::take(&mut bus.reads), bus.wrote);
        let (store_fault, refused, failure) = (bus.store_fault, bus.refused.take(), bus.failure.take());
        // Time advances to the failing access, so that the error has its moment.
        if let Some(failure) = failure {
            let location = self.symbols.locate(failure.access.pc);
            self.time.execute(failure.access.instructions.min(instructions));
            return Err(failure.into_error(location));
        }
        self.time.execute(instructions);
        if let Some(profile) = &mut self.profile {
            profile.executed(executing, instructions);
        }
        if self.one_block.is_on() {
            self.one_block.executed(&reads, why == Why::Limit && !wrote && !store_fault);
        }
        // Interrupts are taken between blocks only, wherever an observed instruction has stopped the core.
        self.unfinished = why == Why::Observed && self.core.is_within_block();
        if store_fault && self.ignores_bus_errors() {
            self.cpu.faults.note(Cause::Store);
        } else if store_fault {
            let pended = self.taker().pend_store_fault();
            pended.map_err(|failure| self.failed(failure, self.core.get(Register::Pc)))?;
        }
        match why {
            // No instruction was executed, so there is nothing to report even while stepping.
            Why::Limit if instructions == 0 => return Ok(None),
            Why::Limit | Why::MaskChanged | Why::Yield => {}
            Why::Wfi => self.go_to_sleep(Sleep::Interrupt)?,
            Why::Wfe => self.go_to_sleep(Sleep::Event)?,
            Why::Observed if self.stepping => {}
            Why::Observed => {
                let address = self.core.get(Register::Pc);
                return Ok(Some(self.observed(address)));
            }
            Why::Breakpoint(operand) if self.settings.stop_at_breakpoints => {
                return Ok(Some(Reason::Breakpoint { operand }));
            }
            Why::Breakpoint(_) => self.take(|taker| taker.breakpoint().map(|()| false))?,
            Why::Svc => self.take(|taker| taker.supervisor_call().map(|()| false))?,
            Why::ExceptionReturn(exc_return) => self.take(|taker| taker.leave(exc_return))?,
            // Not a fault: the bus stalls, and the instruction is repeated afterwards.
            Why::Fault(_) if waits_until_ns.is_some() => self.waits_until_ns = waits_until_ns,
            Why::Fault(Fault::Fetch) if self.fetch_waits().is_some() => self.waits_until_ns = self.fetch_waits(),
            Why::Fault(fault) => {
                let cause = match (fault, refused) {
                    // The load is executed once more and then reads 0.
                    (Fault::Load, Some(Cause::Load { address })) if self.ignores_bus_errors() => {
                        self.cpu.faults.note(Cause::Load { address });
                        self.ignored_load = Some(address);
                        return Ok(None);
                    }
                    (Fault::Load | Fault::Store, cause) => cause.unwrap_or(Cause::Unaligned),
                    (Fault::Fetch, _) => {
                        let cause = self.fetch_fault()?;
                        self.flag_fetch(cause);
                        cause
                    }
                    (Fault::Undefined, _) => Cause::Undefined,
                    (Fault::NoCoprocessor, _) => Cause::NoCoprocessor,
                    (Fault::InvalidState, _) => Cause::InvalidState,
                    (Fault::Unaligned, _) => Cause::Unaligned,
                };
                self.take(|taker| taker.fault(cause).map(|()| false))?;
            }
        }
        Ok(self.stepping.then_some(Reason::Stepped))
    }

    /// Notes that an observed instruction is next, and returns the reason for the stop.
    fn observed(&mut self, address: u32) -> Reason {
        self.told = Some(address);
        if let Some(profile) = &mut self.profile {
            profile.observed(address, self.time.now_ns(), active(&self.core));
        }
        Reason::Observed { address }
    }

    /// Returns the time until which the flash with the next instruction is busy, ns.
    fn fetch_waits(&self) -> Option<u64> {
        let pc = self.core.get(Register::Pc);
        // A wide instruction may extend into another bank.
        self.chip.fetch_waits_until_ns(pc).or_else(|| self.chip.fetch_waits_until_ns(pc.wrapping_add(2)))
    }

    /// Classifies a failed fetch: an error of the program, or a restriction of this machine.
    fn fetch_fault(&self) -> Result<Cause, MachineError> {
        let pc = self.core.get(Register::Pc);
        // A wide instruction may lie in two regions.
        let refused = |protection: &Protection| protection.refuses(pc, 4, Purpose::Fetch).is_some();
        if self.protection.as_ref().is_some_and(refused) {
            return Ok(Cause::FetchViolation);
        }
        let unreadable = |region: &Region| [pc, pc.wrapping_add(2)].iter().any(|at| region.has_hole(*at, 2));
        if let Some((region, _)) = self.chip.memory().locate(pc)
            && region.direct().read
            && !unreadable(region)
        {
            return Err(self.processor_error(format!("execution from {} at {pc:#010x} is not modelled", region.bank)));
        }
        if let Some((region, _)) = self.chip.memory().locate(pc)
            && self.chip.memory().kept().contains(&pc)
        {
            return Err(self.processor_error(format!("execution from {} at {pc:#010x} is not modelled", region.bank)));
        }
        // Code is never executed from peripherals, external devices and the system area (B3.1).
        let never = matches!(pc, 0x4000_0000..0x6000_0000 | 0xA000_0000..);
        Ok(if never { Cause::FetchViolation } else { Cause::FetchError })
    }

    /// Makes the flash set its flags for a fetch with a bus error, as for a load.
    fn flag_fetch(&mut self, cause: Cause) {
        let (pc, now_ns) = (self.core.get(Register::Pc), self.time.now_ns());
        let in_flash = |at: u32| self.chip.memory().locate(at).is_some_and(|(region, _)| region.bank.is_flash());
        if cause == Cause::FetchError && in_flash(pc) {
            // The second half of a wide instruction may be the one that fails.
            for at in [pc, pc.wrapping_add(2)] {
                if self.chip.read(now_ns, at & !3, crate::Size::Word).is_err() {
                    break;
                }
            }
            bus::take_irqs(&mut self.chip, &mut self.cpu, &mut self.irqs);
        }
    }

    fn go_to_sleep(&mut self, sleep: Sleep) -> Result<(), MachineError> {
        if self.cpu.sleep_deep() {
            return Err(self.processor_error("SLEEPDEEP: stop and standby modes are not modelled".into()));
        }
        self.sleep = Some(sleep);
        Ok(())
    }

    /// Returns true where CCR.BFHFNMIGN applies: handlers of negative priority, and code under FAULTMASK, ignore bus
    /// errors of data accesses.
    fn ignores_bus_errors(&self) -> bool {
        self.cpu.ignores_bus_faults() && self.cpu.exceptions.execution_priority(masks(&self.core)) < 0
    }

    fn processor_error(&self, what: String) -> MachineError {
        let location = self.symbols.locate(self.core.get(Register::Pc));
        MachineError::Processor { at_ns: self.now_ns(), location, what }
    }

    fn taker(&mut self) -> Taker<'_, C> {
        Taker {
            core: &mut self.core,
            cpu: &mut self.cpu,
            memory: self.chip.memory(),
            protection: self.protection.as_ref(),
        }
    }

    /// Takes or leaves exceptions; `how` returns `true` if the core is to sleep.
    fn take(&mut self, how: impl FnOnce(&mut Taker<'_, C>) -> Result<bool, Failure>) -> Result<(), MachineError> {
        let (from, before) = (self.core.get(Register::Pc), active(&self.core));
        let sp = self.core.get(Register::Msp);
        if let Some(profile) = &mut self.profile {
            profile.leaves_off(self.chip.memory(), before, sp);
        }
        match how(&mut self.taker()) {
            Ok(sleep) => {
                let (at_ns, to, after) = (self.time.now_ns(), self.core.get(Register::Pc), active(&self.core));
                if let Some(profile) = &mut self.profile {
                    profile.goes_on(after, sp, self.core.get(Register::Msp));
                }
                if let Some(trace) = &mut self.trace {
                    trace.exception(at_ns, from, to, after);
                }
                if let Some(changes) = &mut self.changes {
                    changes.push(Change { at_ns, from, to, before, after });
                }
                if sleep {
                    self.go_to_sleep(Sleep::Interrupt)?;
                }
                Ok(())
            }
            Err(failure) => Err(self.failed(failure, from)),
        }
    }

    fn failed(&self, failure: Failure, pc: u32) -> MachineError {
        match failure {
            Failure::LockUp(what) => {
                MachineError::LockUp { at_ns: self.now_ns(), location: self.symbols.locate(pc), what }
            }
            Failure::Core(error) => error.into(),
        }
    }
}
