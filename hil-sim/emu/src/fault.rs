//! Faults of the running processor, injected as a debugger would: code is overwritten in the middle of a run.
//!
//! Tests and `r4 bench safety` inject the same faults in the same way. The image has no hooks for this: the place is
//! found by its symbol, and the fault persists or is repaired after the reset that it causes.

use r4_image::{Binary, RECORD_AT, RECORD_BYTES};
use r4_mcu::{Chip, Machine, Reason, Stopped, cpu::Core};

use crate::{
    board::{BoardSoc, EmuBoard},
    watch::{SharedMachine, Watcher},
};

/// Interrupt that runs the supervisor's executor.
const SUPERVISOR: &str = "SAI1";
/// Interrupt that runs the executor of the links, and in hold mode the code that answers there.
const LINKS: &str = "SAI3";
/// Interrupt of the timer behind the firmware's clock: without it no task wakes by time.
const TIME_DRIVER: &str = "TIM5";
/// Function with which the control task continues in each of its periods.
const CONTROL: &str = "r4_firmware::control::task::Control<B,P>::tick::{{closure}}";
/// Function that makes outputs safe at the beginning of a start.
const SWEEP: &str = "r4_giga::sweep::Sweeper::sweep";
/// Panic of the core library that takes only a location as argument.
const PANIC: &str = "core::panicking::panic_const::panic_const_div_by_zero";

/// Machine code of `b .` (DDI0403E, A7.7.12, encoding T2, offset -4).
const LOOP_FOREVER: [u8; 2] = [0xFE, 0xE7];
/// Machine code of `cpsid i; b .` (B5.2.1).
const MASK_AND_LOOP: [u8; 4] = [0x72, 0xB6, 0xFE, 0xE7];
/// Machine code of `udf #0` (A7.7.194, encoding T1).
const UNDEFINED: [u8; 2] = [0x00, 0xDE];
/// Machine code of `movs r0, #0; ldr r0, [r0, #64]` (A7.7.76, A7.7.43): reads a field through a null pointer.
const READ_NULL: [u8; 4] = [0x00, 0x20, 0x00, 0x6C];
/// Machine code of `movs r0, #0; bx lr` (A7.7.76, A7.7.20).
const RETURN_ZERO: [u8; 4] = [0x00, 0x20, 0x70, 0x47];
/// Machine code of `push {r0-r7}` and a branch back to it (A7.7.101, A7.7.12).
const PUSH_FOREVER: [u8; 4] = [0xFF, 0xB4, 0xFD, 0xE7];

/// Address of the location of an injected panic, in a part of flash that no image uses.
pub const PANIC_LOCATION: u32 = 0x080F_0000;
/// Line number that an injected panic reports.
pub const PANIC_LINE: u32 = 4711;
const PANIC_FILE: &[u8] = b"injected.rs";

/// Fault to inject into the program.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The supervisor never returns from its interrupt.
    SupervisorHangs,
    /// The supervisor never returns, with all interrupts masked.
    SupervisorHangsMasked,
    /// The executor of the links never returns from its interrupt.
    LinksHang,
    /// The time driver hangs: no task wakes by time any more.
    TimeDriverHangs,
    /// The control task never returns; the supervisor runs on.
    ControlHangs,
    /// The control task executes an undefined instruction: a UsageFault, escalated to a HardFault where not enabled.
    UndefinedInstruction,
    /// The control task reads through a null pointer.
    NullPointer,
    /// The control task panics.
    Panic,
    /// The control task pushes registers until the stack ends.
    StackOverflow,
    /// A start does not make outputs safe before its tasks run; tests of the sweep must detect this.
    SweepLeftOut,
}

/// Duration of a fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lasting {
    /// The program is restored at the next reset of the processor.
    UntilReset,
    /// The fault is in flash too, so that every start has it.
    Always,
}

/// Reason why a fault cannot be injected.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FaultError {
    /// The image is older than the symbol, or was stripped.
    #[error("the firmware has no symbol `{0}`: build it anew with `cargo xtask firmware`")]
    NoSymbol(&'static str),
    /// The address is not in the memory map.
    #[error("nothing can be written to {0:#010x}")]
    NoMemory(u32),
}

/// Overwritten bytes of the program.
#[derive(Clone, Debug)]
pub struct Patch {
    /// Address at which the program executes the fault.
    pub address: u32,
    /// Original bytes with their addresses, also those in flash from which each start copies.
    before: Vec<(u32, Vec<u8>)>,
}

impl Patch {
    /// Writes `code` at all `places` and keeps the original bytes.
    fn write<C: Core>(machine: &mut Machine<C, BoardSoc>, places: &[u32], code: &[u8]) -> Result<Self, FaultError> {
        let memory = machine.chip.memory();
        let mut patch = Self { address: places[0], before: Vec::new() };
        for address in places {
            let mut before = vec![0; code.len()];
            memory.read_slice(*address, &mut before).ok_or(FaultError::NoMemory(*address))?;
            memory.write_slice(*address, code).ok_or(FaultError::NoMemory(*address))?;
            patch.before.push((*address, before));
        }
        Ok(patch)
    }

    /// Restores the original bytes.
    ///
    /// # Errors
    /// [`FaultError::NoMemory`] for an address outside the memory map.
    pub fn undo<C: Core>(&self, machine: &mut Machine<C, BoardSoc>) -> Result<(), FaultError> {
        self.before.iter().try_for_each(|(address, before)| {
            machine.chip.memory().write_slice(*address, before).ok_or(FaultError::NoMemory(*address))
        })
    }
}

impl Fault {
    fn place(self) -> &'static str {
        match self {
            Self::SupervisorHangs | Self::SupervisorHangsMasked => SUPERVISOR,
            Self::LinksHang => LINKS,
            Self::SweepLeftOut => SWEEP,
            Self::TimeDriverHangs => TIME_DRIVER,
            Self::ControlHangs | Self::UndefinedInstruction | Self::NullPointer | Self::Panic | Self::StackOverflow => {
                CONTROL
            }
        }
    }

    fn code<C: Core>(self, machine: &mut Machine<C, BoardSoc>) -> Result<Vec<u8>, FaultError> {
        Ok(match self {
            Self::SupervisorHangs | Self::LinksHang | Self::TimeDriverHangs | Self::ControlHangs => {
                LOOP_FOREVER.to_vec()
            }
            Self::SupervisorHangsMasked => MASK_AND_LOOP.to_vec(),
            Self::UndefinedInstruction => UNDEFINED.to_vec(),
            Self::NullPointer => READ_NULL.to_vec(),
            Self::SweepLeftOut => RETURN_ZERO.to_vec(),
            Self::StackOverflow => PUSH_FOREVER.to_vec(),
            Self::Panic => {
                // Layout of `core::panic::Location` as rustc emits it: file name (pointer, length), line, column.
                let words = [PANIC_LOCATION + 16, PANIC_FILE.len() as u32, PANIC_LINE, 1];
                let location: Vec<u8> =
                    words.into_iter().flat_map(u32::to_le_bytes).chain(PANIC_FILE.iter().copied()).collect();
                Patch::write(machine, &[PANIC_LOCATION], &location)?;
                call_with_location(address_of(machine, PANIC)?)
            }
        })
    }
}

/// Assembles `r0 = PANIC_LOCATION; goto function`.
fn call_with_location(function: u32) -> Vec<u8> {
    // Encodings of movw rN, #low and movt rN, #high (A7.7.76, A7.7.79).
    let mov = |register: u32, value: u32, top: bool| {
        let first = if top { 0xF2C0 } else { 0xF240 } | value >> 12 & 0xF | (value >> 11 & 1) << 10;
        let second = (value >> 8 & 7) << 12 | register << 8 | value & 0xFF;
        (first | second << 16).to_le_bytes()
    };
    let mut code = Vec::new();
    for (register, value) in [(0, PANIC_LOCATION), (3, function | 1)] {
        code.extend(mov(register, value & 0xFFFF, false));
        code.extend(mov(register, value >> 16, true));
    }
    // Encoding of bx r3 (A7.7.20).
    code.extend(0x4718_u16.to_le_bytes());
    code
}

fn address_of<C: Core>(machine: &Machine<C, BoardSoc>, name: &'static str) -> Result<u32, FaultError> {
    machine.symbols().address(name).ok_or(FaultError::NoSymbol(name))
}

/// Watcher that removes the main crystal when the processor is reset.
struct LoseCrystal;

impl<C: Core> Watcher<C> for LoseCrystal {
    fn after(&mut self, machine: &SharedMachine<C>, stopped: Stopped) {
        if let Reason::Reset(_) = stopped.reason {
            machine.borrow_mut().chip.rcc().fit_crystals(false, true);
        }
    }
}

/// Watcher that undoes a patch when the processor is reset.
struct Repair(Option<Patch>);

impl<C: Core> Watcher<C> for Repair {
    fn after(&mut self, machine: &SharedMachine<C>, stopped: Stopped) {
        if let (Reason::Reset(_), Some(patch)) = (stopped.reason, &self.0)
            && patch.undo(&mut machine.borrow_mut()).is_ok()
        {
            self.0 = None;
        }
    }
}

impl<C: Core + 'static> EmuBoard<C> {
    /// Removes the main crystal at the processor's next reset.
    pub fn lose_crystal_at_reset(&self) {
        self.watch(LoseCrystal);
    }

    /// Recomputes the image's seal over the patched code, so that the image counts as built with the fault. Returns the
    /// address and the original bytes of the record; `None` for a program without one.
    fn seal(&self, machine: &Machine<C, BoardSoc>) -> Option<(u32, Vec<u8>)> {
        let start = self.segments.iter().map(|segment| segment.stored_at()).min()?;
        let end = self.segments.iter().map(|segment| segment.stored_end()).max()?;
        let mut binary = Binary { start, bytes: vec![0; (end - start).next_multiple_of(RECORD_BYTES as u32) as usize] };
        machine.chip.memory().read_slice(start, &mut binary.bytes)?;
        let record = |binary: &Binary| Some(binary.bytes.get(RECORD_AT..RECORD_AT + RECORD_BYTES)?.to_vec());
        let before = record(&binary)?;
        r4_image::seal(&mut binary).ok()?;
        let address = start + RECORD_AT as u32;
        machine.chip.memory().write_slice(address, &record(&binary)?)?;
        Some((address, before))
    }

    /// Injects a fault into the running program; it acts when the program next executes the place.
    ///
    /// # Errors
    /// [`FaultError`]; the program is unchanged then.
    pub fn inject(&self, fault: Fault, lasting: Lasting) -> Result<Patch, FaultError> {
        let mut machine = self.machine();
        let address = address_of(&machine, fault.place())?;
        let code = fault.code(&mut machine)?;
        let mut places = vec![address];
        if lasting == Lasting::Always {
            // Code in ITCM is copied from flash at each start, so the copy in flash is patched too.
            let stored = self.segments.iter().find_map(|segment| segment.stored(address));
            places.extend(stored.filter(|stored| *stored != address));
        }
        let mut patch = Patch::write(&mut machine, &places, &code)?;
        if lasting == Lasting::Always {
            patch.before.extend(self.seal(&machine));
        }
        drop(machine);
        if lasting == Lasting::UntilReset {
            self.watch(Repair(Some(patch.clone())));
        }
        Ok(patch)
    }
}
