//! Minimal chip around the processor, and the functions that run it.

#![allow(dead_code, clippy::unwrap_used, reason = "each test file uses a part; failing is a test's way to speak")]

use r4_mcu::chip::{AccessError, Chip};
use r4_mcu::cpu::{Core, Register};
use r4_mcu::{Bank, Machine, Memory, Reason, ResetCause, Settings, Size, Unmodelled};
use r4_thumb::ThumbCore;
use r4_unicorn::UnicornCore;

/// Core that the tests create and run.
pub(crate) trait Tested: Core + Sized {
    fn create() -> Self;
}

impl Tested for UnicornCore {
    fn create() -> Self {
        Self::new().unwrap()
    }
}

impl Tested for ThumbCore {
    fn create() -> Self {
        Self::new()
    }
}

/// Makes each of these functions, which are generic over [`Tested`], a test of every core.
macro_rules! for_every_core {
    ($($test:ident,)*) => {
        mod unicorn {
            $(#[test] fn $test() { super::$test::<r4_unicorn::UnicornCore>(); })*
        }
        mod thumb {
            $(#[test] fn $test() { super::$test::<r4_thumb::ThumbCore>(); })*
        }
    };
}
pub(crate) use for_every_core;

/// First address of the chip's only peripheral.
pub(crate) const PERIPHERAL: u32 = 0x4000_0000;

/// Minimal chip. Registers of its peripheral, by offset:
///
/// | offset | write | read |
/// | --- | --- | --- |
/// | 0x00 | sets interrupt line `value & 0xFF` to bit 8 | 0 |
/// | 0x04 | sets line 0 high in `value` nanoseconds | nanoseconds now, low half |
/// | 0x08 | clock of SRAM1 on or off | on or off |
/// | 0x0C | requests a watchdog reset | 0 |
/// | 0x10 | requests that the outside runs | 0 |
/// | 0x14 | sets the core clock, Hz | core clock, Hz |
///
/// Storage gives bus errors in its first 32 bytes, and has memory in the rest. Everything else below 0x6000_0000 is not
/// modelled; above that there are bus errors.
pub(crate) struct TestChip {
    pub(crate) memory: Memory,
    pub(crate) irqs: Vec<(u16, bool)>,
    pub(crate) alarm_ns: u64,
    pub(crate) reset: Option<ResetCause>,
    pub(crate) outside: bool,
    pub(crate) core_hz: u64,
    pub(crate) writes: Vec<(u64, u32, u32)>,
    /// True if the next event is always now.
    pub(crate) stuck: bool,
}

impl TestChip {
    pub(crate) fn new() -> Self {
        Self {
            memory: Memory::new(),
            irqs: Vec::new(),
            alarm_ns: u64::MAX,
            reset: None,
            outside: false,
            core_hz: 480_000_000,
            writes: Vec::new(),
            stuck: false,
        }
    }
}

/// Returns true for addresses of peripherals, most of which this chip does not have.
fn is_peripheral(address: u32) -> bool {
    matches!(address, 0x4000_0000..0x6000_0000)
}

fn unmodelled(address: u32) -> AccessError {
    Unmodelled { peripheral: "test", what: format!("nothing at {address:#010x}") }.into()
}

impl Chip for TestChip {
    fn memory(&self) -> &Memory {
        &self.memory
    }

    fn read(&mut self, now_ns: u64, address: u32, size: Size) -> Result<u32, AccessError> {
        match address {
            0x0818_0020..0x0820_0000 => self.memory.read(address, size).ok_or(AccessError::Bus),
            0x4000_0004 => Ok(now_ns as u32),
            0x4000_0008 => Ok(self.memory.is_enabled(Bank::Sram1).into()),
            0x4000_0014 => Ok(self.core_hz as u32),
            0x4000_0000..0x4000_0004 | 0x4000_000C..0x4000_0014 => Ok(0),
            _ if is_peripheral(address) => Err(unmodelled(address)),
            _ => Err(AccessError::Bus),
        }
    }

    fn write(&mut self, now_ns: u64, address: u32, _: Size, value: u32) -> Result<(), AccessError> {
        self.writes.push((now_ns, address, value));
        match address {
            0x4000_0000 => self.irqs.push((value as u16 & 0xFF, value & 0x100 != 0)),
            0x4000_0004 => self.alarm_ns = now_ns + u64::from(value),
            0x4000_0008 => self.memory.set_enabled(Bank::Sram1, value != 0),
            0x4000_000C => self.reset = Some(ResetCause::Watchdog),
            0x4000_0010 => self.outside = true,
            0x4000_0014 => self.core_hz = value.into(),
            _ if is_peripheral(address) => return Err(unmodelled(address)),
            _ => return Err(AccessError::Bus),
        }
        Ok(())
    }

    fn advance(&mut self, now_ns: u64) {
        if self.alarm_ns <= now_ns {
            self.alarm_ns = u64::MAX;
            self.irqs.push((0, true));
        }
    }

    fn next_event_ns(&self) -> u64 {
        if self.stuck || self.reset.is_some() { 0 } else { self.alarm_ns }
    }

    fn take_irqs(&mut self, changes: &mut Vec<(u16, bool)>) {
        changes.append(&mut self.irqs);
    }

    fn take_reset(&mut self) -> Option<ResetCause> {
        self.reset.take()
    }

    fn reset(&mut self, _: u64, _: ResetCause) {
        self.alarm_ns = u64::MAX;
        self.core_hz = 480_000_000;
        self.memory.set_enabled(Bank::Sram1, false);
    }

    fn outside_waits(&self) -> bool {
        self.outside
    }

    fn core_hz(&self) -> u64 {
        self.core_hz
    }
}

/// Creates a machine with nothing loaded.
pub(crate) fn machine<C: Tested>(settings: Settings) -> Machine<C, TestChip> {
    Machine::new(C::create(), TestChip::new(), settings).unwrap()
}

/// Runs a program that uses semihosting to its end; returns its output, and true if it reports success.
pub(crate) fn run_semihosted<C: Core>(machine: &mut Machine<C, TestChip>, until_ns: u64) -> (String, bool) {
    let mut text = Vec::new();
    loop {
        let stopped =
            machine.run_until(until_ns).unwrap_or_else(|error| panic!("{error}\n{}", String::from_utf8_lossy(&text)));
        assert_eq!(stopped.reason, Reason::Breakpoint { operand: 0xAB }, "{}", String::from_utf8_lossy(&text));
        let argument = machine.core.get(Register::R(1));
        match machine.core.get(Register::R(0)) {
            // SYS_WRITE0: text up to a zero.
            4 => text.extend(
                (argument..)
                    .map(|at| machine.chip.memory.read(at, Size::Byte).unwrap() as u8)
                    .take_while(|byte| *byte != 0),
            ),
            // SYS_EXIT with ADP_Stopped_ApplicationExit for success.
            0x18 => return (String::from_utf8(text).unwrap(), argument == 0x2_0026),
            operation => panic!("semihosting operation {operation:#x}"),
        }
        let pc = machine.core.get(Register::Pc);
        machine.core.set(Register::Pc, pc + 2);
    }
}
