//! Core with memory and a bus, and the outcome of a case on it.

use r4_mcu::cpu::{Access, Core, CoreBus, CoreError, CoreStop, Limits, NoResult, Register, Why};
use r4_mcu::{Bank, Memory, Region};

use super::case::{AROUND, CODE, Case, DATA, WFI};

/// Value of xPSR in handler mode, for some exception.
const HANDLER: u32 = 1 << 24 | 15;

/// Registers that the translator shows to privileged programs only.
const PRIVILEGED: [Register; 5] =
    [Register::Msp, Register::Psp, Register::Primask, Register::Basepri, Register::Faultmask];

/// Every other register of the core.
fn registers() -> impl Iterator<Item = Register> {
    let others = [Register::Sp, Register::Lr, Register::Pc, Register::Xpsr, Register::Control, Register::Fpscr];
    (0..13).map(Register::R).chain(others).chain((0..32).map(Register::S))
}

/// Bus outside of memory: a value for each address, and a list of all accesses.
struct Bus {
    accesses: Vec<(char, Access, u32)>,
    events: u32,
    refused: bool,
    limits: Limits,
}

impl CoreBus for Bus {
    fn read(&mut self, access: &Access) -> Result<u32, NoResult> {
        self.accesses.push(('r', *access, 0));
        let value = access.address.wrapping_mul(0x9E37_79B9) ^ 0x1234_5678;
        let mask = u32::MAX >> (32 - 8 * access.size.bytes());
        if self.refused { Err(NoResult) } else { Ok(value & mask) }
    }
    fn write(&mut self, access: &Access, value: u32) -> Result<(), NoResult> {
        let mask = u32::MAX >> (32 - 8 * access.size.bytes());
        self.accesses.push(('w', *access, value & mask));
        Ok(())
    }
    fn limits(&self) -> Limits {
        self.limits
    }
    fn event(&mut self) {
        self.events += 1;
    }
    fn remapped(&mut self) -> Option<&[Region]> {
        None
    }
}

/// Outcome of a case on one core.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Outcome {
    pub(crate) stop: Result<CoreStop, String>,
    pub(crate) registers: Vec<(Register, u32)>,
    pub(crate) accesses: Vec<(char, Access, u32)>,
    pub(crate) events: u32,
    pub(crate) data: Vec<u8>,
}

impl Outcome {
    pub(crate) fn register(&self, register: Register) -> u32 {
        self.registers.iter().find(|(name, _)| *name == register).map_or(0, |(_, value)| *value)
    }

    pub(crate) fn set_register(&mut self, register: Register, value: u32) {
        self.registers.iter_mut().filter(|(name, _)| *name == register).for_each(|(_, old)| *old = value);
    }
}

/// Method of executing a case.
#[derive(Clone, Copy)]
pub(crate) enum Way {
    /// One call of [`Core::run`].
    Run,
    /// Calls of [`Core::step`], at most this number.
    Steps(u32),
}

/// Steps until one ends by anything but the next instruction; all instructions are counted.
fn steps(core: &mut impl Core, count: u32, bus: &mut Bus) -> Result<CoreStop, CoreError> {
    let mut executed = 0;
    for _ in 1..count {
        let stop = core.step(bus)?;
        executed += stop.instructions;
        // A core may, but need not, report a change of a mask.
        if !matches!(stop.why, Why::Observed | Why::MaskChanged) {
            return Ok(CoreStop { instructions: executed, ..stop });
        }
    }
    let stop = core.step(bus)?;
    let why = if stop.why == Why::MaskChanged { Why::Observed } else { stop.why };
    Ok(CoreStop { instructions: executed + stop.instructions, why })
}

pub(crate) struct Rig<C> {
    pub(crate) core: C,
    pub(crate) memory: Memory,
}

impl<C: Core> Rig<C> {
    pub(crate) fn new(mut core: C) -> Self {
        let memory = Memory::new();
        for bank in [Bank::Flash1, Bank::Flash2, Bank::Itcm] {
            let (base, len) = bank.span();
            let code: Vec<u8> = std::iter::repeat_n(WFI.to_le_bytes(), len as usize / 2).flatten().collect();
            memory.write_slice(base, &code).expect("a memory holds its own length");
        }
        core.map(memory.regions()).expect("maps");
        Self { core, memory }
    }

    /// Copies the contents of memory from another rig.
    pub(crate) fn copy_memory<D>(&self, other: &Rig<D>) {
        for (to, from) in self.memory.regions().iter().zip(other.memory.regions()) {
            to.bytes().iter().zip(from.bytes().iter()).for_each(|(to, from)| to.set(from.get()));
        }
    }

    /// Executes a case from a state that does not depend on the previous case.
    pub(crate) fn run(&mut self, case: &Case, way: Way) -> Outcome {
        let mut code: Vec<u8> = case.code.iter().flat_map(|half| half.to_le_bytes()).collect();
        code.resize(64, 0);
        for at in (case.code.len() * 2..64).step_by(2) {
            code[at..at + 2].copy_from_slice(&WFI.to_le_bytes());
        }
        self.memory.write_slice(CODE, &code).expect("there is flash");
        self.memory.write_slice(DATA - AROUND, &case.data).expect("there is RAM");
        let core = &mut self.core;
        core.code_changed().expect("forgets");
        core.set_fpu(case.fpu);
        // In handler mode everything is privileged.
        core.set(Register::Xpsr, HANDLER);
        core.set(Register::Control, 0);
        core.set(Register::Xpsr, 1 << 24);
        core.set(Register::Control, 0);
        // The translator executes CLREX for this, which must not be conditional by the state of the previous case.
        core.clear_exclusive().expect("clears");
        core.set(Register::Msp, case.msp);
        core.set(Register::Psp, case.psp);
        for (register, value) in (0..13).zip(case.r) {
            core.set(Register::R(register), value);
        }
        core.set(Register::Lr, case.r[14]);
        for (register, value) in (0..32).zip(case.s) {
            core.set(Register::S(register), value);
        }
        core.set(Register::Fpscr, case.fpscr);
        core.set(Register::Primask, case.masks[0]);
        core.set(Register::Basepri, case.masks[1]);
        core.set(Register::Faultmask, case.masks[2]);
        core.set(Register::Pc, CODE);
        core.set(Register::Control, case.control);
        core.set(Register::Xpsr, case.xpsr);
        let limits = Limits { instructions: 100, mask_changes: case.mask_changes };
        let mut bus = Bus { accesses: Vec::new(), events: 0, refused: case.refused, limits };
        let stop = match way {
            Way::Run => core.run(&mut bus),
            Way::Steps(count) => steps(core, count, &mut bus),
        };
        let stop = stop.map_err(|error| error.to_string());
        let mut data = vec![0; 2 * AROUND as usize];
        self.memory.read_slice(DATA - AROUND, &mut data).expect("there is RAM");
        let mut registers: Vec<_> = registers().map(|register| (register, core.get(register))).collect();
        core.set(Register::Xpsr, HANDLER);
        registers.extend(PRIVILEGED.map(|register| (register, core.get(register))));
        // A block executed in steps may report the SEV in it with each step.
        let events = if matches!(way, Way::Run) { bus.events } else { 0 };
        Outcome { stop, registers, accesses: bus.accesses, events, data }
    }
}
