//! Faults of a running processor, injected as a debugger would: code is overwritten in the middle of a run.
//!
//! Tests and `r4 bench safety` break the same things in the same way. The image keeps no hooks for this: what is broken is
//! found by its symbols, and stays broken or is whole again after the reset that it leads to.

use r4_image::{Binary, RECORD_AT, RECORD_BYTES};
use r4_mcu::{Chip, Machine, Reason, Stopped, cpu::Core};

use crate::{
    board::{BoardSoc, EmuBoard},
    watch::{SharedMachine, Watcher},
};

/// The supervisor's executor runs in this interrupt.
const SUPERVISOR: &str = "SAI1";
/// The executor of the links, and in hold mode of what answers there.
const LINKS: &str = "SAI3";
/// The timer behind the firmware's clock: without it no task is woken by time.
const TIME_DRIVER: &str = "TIM5";
/// Where the control task goes on in each of its periods.
const CONTROL: &str = "r4_firmware::control::task::Control<B,P>::tick::{{closure}}";
/// What makes outputs safe at the beginning of a start.
const SWEEP: &str = "r4_giga::sweep::Sweeper::sweep";
/// A panic of the core library, which takes the location alone.
const PANIC: &str = "core::panicking::panic_const::panic_const_div_by_zero";

/// `b .` (DDI0403E, A7.7.12, encoding T2, offset -4).
const LOOP_FOREVER: [u8; 2] = [0xFE, 0xE7];
/// `cpsid i; b .` (B5.2.1).
const MASK_AND_LOOP: [u8; 4] = [0x72, 0xB6, 0xFE, 0xE7];
/// `udf #0` (A7.7.194, encoding T1).
const UNDEFINED: [u8; 2] = [0x00, 0xDE];
/// `movs r0, #0; ldr r0, [r0, #64]` (A7.7.76, A7.7.43): a field of a structure that is not there.
const READ_NULL: [u8; 4] = [0x00, 0x20, 0x00, 0x6C];
/// `movs r0, #0; bx lr` (A7.7.76, A7.7.20).
const RETURN_ZERO: [u8; 4] = [0x00, 0x20, 0x70, 0x47];
/// `push {r0-r7}; b` to it (A7.7.101, A7.7.12).
const PUSH_FOREVER: [u8; 4] = [0xFF, 0xB4, 0xFD, 0xE7];

/// Where the location of an injected panic is, in a part of flash that no image uses.
pub const PANIC_LOCATION: u32 = 0x080F_0000;
/// The line that an injected panic names.
pub const PANIC_LINE: u32 = 4711;
const PANIC_FILE: &[u8] = b"injected.rs";

/// What breaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// The supervisor never returns from its interrupt.
    SupervisorHangs,
    /// The same with all interrupts masked.
    SupervisorHangsMasked,
    /// The executor of the links never returns from its interrupt.
    LinksHang,
    /// No time comes to any task any more.
    TimeDriverHangs,
    /// The control task never returns; the supervisor runs on.
    ControlHangs,
    /// The control task meets an instruction that there is not: a UsageFault, escalated to a HardFault where not enabled.
    UndefinedInstruction,
    /// The control task follows a null pointer.
    NullPointer,
    /// The control task panics.
    Panic,
    /// The control task pushes until the stack ends.
    StackOverflow,
    /// A start does not make outputs safe before its tasks run: what tests of the sweep must notice.
    SweepLeftOut,
}

/// How long a fault stays.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Lasting {
    /// The program is whole again after the next reset of the processor.
    UntilReset,
    /// Every start meets it again.
    Always,
}

/// Why a fault cannot be injected.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FaultError {
    /// The image is of before it had this, or was stripped.
    #[error("the firmware has no symbol `{0}`: build it anew with `cargo xtask firmware`")]
    NoSymbol(&'static str),
    /// The address is not one of the memory map.
    #[error("nothing can be written to {0:#010x}")]
    NoMemory(u32),
}

/// Bytes of the program that were replaced.
#[derive(Clone, Debug)]
pub struct Patch {
    /// Where the program meets it.
    pub address: u32,
    /// What was there, and where each start takes it from.
    before: Vec<(u32, Vec<u8>)>,
}

impl Patch {
    /// Writes code over the program.
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

    /// Puts back what was there.
    ///
    /// # Errors
    /// [`FaultError::NoMemory`].
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
                // A location as rustc makes it: the file's name (pointer, length), line, column.
                let words = [PANIC_LOCATION + 16, PANIC_FILE.len() as u32, PANIC_LINE, 1];
                let location: Vec<u8> =
                    words.into_iter().flat_map(u32::to_le_bytes).chain(PANIC_FILE.iter().copied()).collect();
                Patch::write(machine, &[PANIC_LOCATION], &location)?;
                call_with_location(address_of(machine, PANIC)?)
            }
        })
    }
}

/// `r0 = PANIC_LOCATION; goto function`.
fn call_with_location(function: u32) -> Vec<u8> {
    // movw rN, #low; movt rN, #high (A7.7.76, A7.7.79).
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
    // bx r3 (A7.7.20).
    code.extend(0x4718_u16.to_le_bytes());
    code
}

fn address_of<C: Core>(machine: &Machine<C, BoardSoc>, name: &'static str) -> Result<u32, FaultError> {
    machine.symbols().address(name).ok_or(FaultError::NoSymbol(name))
}

/// Takes the main crystal away when the processor is reset.
struct LoseCrystal;

impl<C: Core> Watcher<C> for LoseCrystal {
    fn after(&mut self, machine: &SharedMachine<C>, stopped: Stopped) {
        if let Reason::Reset(_) = stopped.reason {
            machine.borrow_mut().chip.rcc().fit_crystals(false, true);
        }
    }
}

/// Undoes a patch when the processor is reset.
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
    /// The main crystal is gone from the processor's next reset on.
    pub fn lose_crystal_at_reset(&self) {
        self.watch(LoseCrystal);
    }

    /// Makes the image whole by its record again: what is wrong with it now, it was built with. The record as it was before, and
    /// its address; `None` for a program that has none.
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

    /// Breaks the running program; it acts when the program next comes to the place.
    ///
    /// # Errors
    /// [`FaultError`]; nothing is broken then.
    pub fn inject(&self, fault: Fault, lasting: Lasting) -> Result<Patch, FaultError> {
        let mut machine = self.machine();
        let address = address_of(&machine, fault.place())?;
        let code = fault.code(&mut machine)?;
        let mut places = vec![address];
        if lasting == Lasting::Always {
            // What runs in ITCM is filled from flash at each start.
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
