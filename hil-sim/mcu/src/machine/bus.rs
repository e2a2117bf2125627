//! Bus behind the core's accesses: the private peripheral bus, and the chip.

use super::error::MachineError;
use super::poll::Polls;
use super::time::Instructions;
use crate::chip::{AccessError, Chip};
use crate::cpu::{Access, Cause, CoreBus, Limits, Masks, NoResult, Processor, Protection, Purpose};
use crate::memory::Region;
use crate::peripheral::{Size, Unmodelled};

/// First address of the private peripheral bus (DDI0403E B3.1).
const PRIVATE: u32 = 0xE000_0000;

/// Access without a result, which ends a run with an error.
pub(super) struct Unanswered {
    pub(super) access: Access,
    write: bool,
    at_ns: u64,
    cause: Unmodelled,
}

impl Unanswered {
    pub(super) fn into_error(self, location: String) -> MachineError {
        let Self { access: Access { address, size, .. }, write, at_ns, cause } = self;
        MachineError::Unmodelled { address, size, write, at_ns, location, cause }
    }
}

/// Passes changes of interrupt lines to the processor.
pub(super) fn take_irqs<S: Chip>(chip: &mut S, cpu: &mut Processor, irqs: &mut Vec<(u16, bool)>) {
    chip.take_irqs(irqs);
    cpu.exceptions.set_nmi(chip.nmi());
    for (irq, level) in irqs.drain(..) {
        let exception = crate::cpu::number::IRQ0 + irq;
        let was_pending = cpu.exceptions.is_pending(exception);
        cpu.exceptions.set_line(irq, level);
        if !was_pending && cpu.exceptions.is_pending(exception) && cpu.event_on_pend() {
            cpu.event = true;
        }
    }
}

/// Passes a change of the core clock to the processor.
pub(super) fn follow_clock<S: Chip>(chip: &S, cpu: &mut Processor, core_hz: &mut u64, now_ns: u64) {
    if *core_hz != chip.core_hz() {
        *core_hz = chip.core_hz();
        cpu.set_core_hz(now_ns, *core_hz);
    }
}

/// Bus of one run of the core.
pub(super) struct Bus<'a, S> {
    chip: &'a mut S,
    cpu: &'a mut Processor,
    time: Instructions,
    t_ns: u64,
    /// Active exception number; no instruction changes it within a run.
    active: u16,
    irqs: &'a mut Vec<(u16, bool)>,
    core_hz: &'a mut u64,
    mapping_version: &'a mut u32,
    code_version: u32,
    exceptions_version: u32,
    /// An exception is pending that only masks hold back.
    pub(super) watch_masks: bool,
    /// The run executes the rest of a block, whatever happens meanwhile.
    pub(super) rest_of_block: bool,
    limit: u64,
    /// Cache for the limit: a time, and the number of this run's instructions before it. Most accesses do not change
    /// the next event.
    next: (u64, u64),
    pub(super) store_fault: bool,
    /// Reason of the refused access with which the run ended.
    pub(super) refused: Option<Cause>,
    /// Accesses that the memory protection unit allows, while it is on.
    protection: Option<&'a Protection>,
    /// Address of a load that was refused before, and must not be made again.
    pub(super) ignored_load: Option<u32>,
    pub(super) failure: Option<Unanswered>,
    /// Only one block is executed; `reads` records its reads.
    pub(super) one_block: bool,
    pub(super) reads: Vec<u32>,
    pub(super) wrote: bool,
    pub(super) polls: &'a mut Polls,
    /// Time at which the access that ended the run must be repeated.
    pub(super) waits_until_ns: Option<u64>,
}

impl<'a, S: Chip> Bus<'a, S> {
    #[expect(clippy::too_many_arguments, reason = "parts of the machine, lent apart from its core")]
    pub(super) fn new(
        chip: &'a mut S,
        cpu: &'a mut Processor,
        time: Instructions,
        t_ns: u64,
        active: u16,
        irqs: &'a mut Vec<(u16, bool)>,
        core_hz: &'a mut u64,
        mapping_version: &'a mut u32,
        protection: Option<&'a Protection>,
        polls: &'a mut Polls,
    ) -> Self {
        let (code_version, exceptions_version) = (chip.memory().code_version(), cpu.exceptions.version());
        let mut bus = Self {
            chip,
            cpu,
            time,
            t_ns,
            active,
            irqs,
            core_hz,
            mapping_version,
            code_version,
            exceptions_version,
            watch_masks: false,
            rest_of_block: false,
            limit: 0,
            next: (0, 0),
            store_fault: false,
            refused: None,
            protection,
            ignored_load: None,
            failure: None,
            one_block: false,
            reads: Vec::new(),
            wrote: false,
            polls,
            waits_until_ns: None,
        };
        bus.limit = bus.instructions();
        bus
    }

    /// Returns the number of this run's instructions until the next action between instructions.
    fn instructions(&mut self) -> u64 {
        let requests = self.cpu.requests;
        // Exceptions that were pending at the start of the run are held back by masks, which `watch_masks` covers.
        let newly_pending = self.exceptions_version != self.cpu.exceptions.version()
            && self.cpu.exceptions.preempting(Masks::NONE).is_some();
        // Each of these must be handled between instructions, so the run ends at the next block.
        let now = self.failure.is_some()
            || self.polls.suspected()
            || self.store_fault
            || newly_pending
            || requests.reset
            || requests.fpu
            || requests.protection
            || self.chip.outside_waits()
            || self.chip.wants_reset()
            || self.chip.is_halted()
            || self.code_version != self.chip.memory().code_version()
            || *self.mapping_version != self.chip.memory().mapping_version();
        if now {
            return 0;
        }
        let next_ns = self.t_ns.min(self.chip.next_event_ns()).min(self.cpu.systick.next_event_ns());
        // The division in `until` is slow; the next event is often the same as at the last access.
        if self.next.0 != next_ns {
            self.next = (next_ns, self.time.until(next_ns));
        }
        self.next.1
    }

    /// Passes on interrupt lines and clock after each access, and renews the limit.
    fn accessed(&mut self, now_ns: u64) {
        take_irqs(self.chip, self.cpu, self.irqs);
        follow_clock(self.chip, self.cpu, self.core_hz, now_ns);
        self.limit = self.instructions();
    }

    /// Returns true for device memory by default (B3.1), where unaligned accesses fault.
    fn is_device(address: u32) -> bool {
        matches!(address, 0x4000_0000..0x6000_0000 | 0xA000_0000..)
    }

    fn read_one(&mut self, address: u32, size: Size, now_ns: u64) -> Result<u32, AccessError> {
        if address >= PRIVATE {
            return Ok(self.cpu.read(address, size, now_ns, self.active)?);
        }
        let memory = self.chip.memory();
        // Protection may keep the core from reading memory by itself.
        let direct = |region: &Region| region.direct().read && !region.has_hole(address, size.bytes());
        if memory.locate(address).is_some_and(|(region, _)| direct(region))
            && let Some(value) = memory.read(address, size)
        {
            return Ok(value);
        }
        self.chip.read(now_ns, address, size)
    }

    fn write_one(&mut self, address: u32, size: Size, value: u32, now_ns: u64) -> Result<(), AccessError> {
        if address >= PRIVATE {
            return Ok(self.cpu.write(address, size, value, now_ns)?);
        }
        let memory = self.chip.memory();
        if memory.locate(address).is_some_and(|(region, _)| region.direct().write)
            && memory.write(address, size, value).is_some()
        {
            return Ok(());
        }
        self.chip.write(now_ns, address, size, value)
    }

    /// Checks an access against the memory protection unit.
    fn check(&mut self, access: &Access, purpose: Purpose) -> Result<(), NoResult> {
        let Some(protection) = self.protection else { return Ok(()) };
        match protection.refuses(access.address, access.size.bytes(), purpose) {
            Some(address) => {
                self.refused = Some(Cause::DataViolation { address });
                Err(NoResult)
            }
            None => Ok(()),
        }
    }

    fn fail(&mut self, access: &Access, write: bool, at_ns: u64, cause: Unmodelled) {
        self.failure.get_or_insert(Unanswered { access: *access, write, at_ns, cause });
    }
}

impl<S: Chip> CoreBus for Bus<'_, S> {
    fn read(&mut self, access: &Access) -> Result<u32, NoResult> {
        if self.ignored_load.take() == Some(access.address) {
            // The hardware's value here is unknown; the model returns 0.
            return Ok(0);
        }
        self.check(access, Purpose::Load)?;
        let Access { address, size, instructions, .. } = *access;
        let now_ns = self.time.after_ns(instructions);
        let unaligned = address & (size.bytes() - 1) != 0;
        let result = if !unaligned {
            self.read_one(address, size, now_ns)
        } else if Self::is_device(address) {
            self.refused = Some(Cause::Unaligned);
            return Err(NoResult);
        } else {
            // Normal memory allows unaligned accesses; the model makes them byte by byte.
            (0..size.bytes()).try_fold(0, |value, byte| {
                let at = address.wrapping_add(byte);
                Ok(value | self.read_one(at, Size::Byte, now_ns)? << (8 * byte))
            })
        };
        if let Ok(value) = result {
            self.polls.read((access.pc, address, value));
        }
        self.accessed(now_ns);
        match result {
            Ok(value) => {
                if self.one_block {
                    self.reads.push(address);
                }
                Ok(value)
            }
            Err(AccessError::Bus) => {
                self.refused = Some(Cause::Load { address });
                Err(NoResult)
            }
            Err(AccessError::Busy { until_ns }) => {
                // The run ends; the machine lets time pass and the core repeats the access.
                self.waits_until_ns = Some(until_ns);
                self.limit = 0;
                Err(NoResult)
            }
            Err(AccessError::Unmodelled(cause)) => {
                self.fail(access, false, now_ns, cause);
                self.limit = 0;
                Err(NoResult)
            }
        }
    }

    fn write(&mut self, access: &Access, value: u32) -> Result<(), NoResult> {
        // After an unmodelled access the rest of the block must not change anything more.
        if self.failure.is_some() {
            return Ok(());
        }
        self.check(access, Purpose::Store)?;
        self.wrote = true;
        self.polls.wrote();
        let Access { address, size, instructions, .. } = *access;
        let now_ns = self.time.after_ns(instructions);
        let unaligned = address & (size.bytes() - 1) != 0;
        let result = if !unaligned {
            self.write_one(address, size, value, now_ns)
        } else if Self::is_device(address) {
            let what = "an unaligned store to device memory".into();
            Err(AccessError::Unmodelled(Unmodelled { peripheral: "core", what }))
        } else {
            let bytes = value.to_le_bytes();
            (0..size.bytes()).try_for_each(|byte| {
                self.write_one(address.wrapping_add(byte), Size::Byte, bytes[byte as usize].into(), now_ns)
            })
        };
        match result {
            Ok(()) => {}
            // Imprecise: the fault is taken after the block, as stores are buffered on the Cortex-M7.
            Err(AccessError::Bus) => self.store_fault = true,
            Err(AccessError::Busy { until_ns }) => {
                self.waits_until_ns = Some(until_ns);
                self.limit = 0;
                return Err(NoResult);
            }
            Err(AccessError::Unmodelled(cause)) => self.fail(access, true, now_ns, cause),
        }
        self.accessed(now_ns);
        Ok(())
    }

    fn limits(&self) -> Limits {
        // One instruction is the least that reaches the next block.
        let instructions = if self.rest_of_block { 1 } else { self.limit };
        let instructions = if self.one_block { instructions.min(1) } else { instructions };
        Limits { instructions, mask_changes: self.watch_masks }
    }

    fn reached(&mut self, instructions: u64) {
        let now_ns = self.time.after_ns(instructions);
        // If the run ends here anyway, the machine handles what is due.
        if now_ns < self.t_ns && self.failure.is_none() {
            self.chip.advance(now_ns);
            self.cpu.advance(now_ns);
            self.accessed(now_ns);
        }
    }

    fn event(&mut self) {
        self.cpu.event = true;
    }

    fn remapped(&mut self) -> Option<&[Region]> {
        let memory = self.chip.memory();
        if *self.mapping_version == memory.mapping_version() {
            return None;
        }
        *self.mapping_version = memory.mapping_version();
        Some(memory.regions())
    }
}
