//! Private peripheral bus: registers of the system control space, and the processor's state behind them.

use super::debug::Debug;
use super::exceptions::{Exceptions, Masks, number};
use super::faults::FaultStatus;
use super::mpu::{Mpu, Protection};
use super::nvic;
use super::systick::SysTick;
use crate::peripheral::{Size, Unmodelled};

/// CPUID: Cortex-M7 r1p1, as in the STM32H747 (DDI0489D 3.3, PM0253).
const CPUID: u32 = 0x411F_C271;

/// ICTR for 240 interrupts: (7 + 1) times 32, less the 16 system exceptions.
const ICTR: u32 = 7;

/// AIRCR.VECTKEY for writes, and its value in reads.
const KEY: u32 = 0x05FA;
const KEY_READS: u32 = 0xFA05;

const SYSRESETREQ: u32 = 1 << 2;
const VECTCLRACTIVE_VECTRESET: u32 = 0b11;

/// CCR bits: STKALIGN reads as one on this processor.
const CCR_RESET: u32 = 1 << 9;
const UNALIGN_TRP: u32 = 1 << 3;
const DIV_0_TRP: u32 = 1 << 4;
const BFHFNMIGN: u32 = 1 << 8;
const CCR_WRITABLE: u32 = 0x0007_031B | UNALIGN_TRP;

/// FPCCR after reset: ASPEN and LSPEN.
const FPCCR_RESET: u32 = 3 << 30;
const AUTOMATIC_SAVE: u32 = 1 << 31;

/// Requests of the program by writes to registers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Requests {
    /// Reset of the chip, AIRCR.SYSRESETREQ.
    pub reset: bool,
    /// Change of CPACR, which enables floating point.
    pub fpu: bool,
    /// Write to the memory protection unit.
    pub protection: bool,
}

/// State of a processor around its instruction set.
#[derive(Clone, Debug)]
pub struct Processor {
    /// Pending and active exceptions.
    pub exceptions: Exceptions,
    /// Fault status and address registers.
    pub faults: FaultStatus,
    /// System timer with its exception, SysTick.
    pub systick: SysTick,
    /// Debug components: DWT, ITM, DEMCR.
    pub debug: Debug,
    /// Event register of WFE and SEV (B1.5.18).
    pub event: bool,
    /// Requests that the machine has not handled yet.
    pub requests: Requests,
    mpu: Mpu,
    vector_table: u32,
    sleep_control: u32,
    configuration: u32,
    coprocessors: u32,
    auxiliary: u32,
    float_control: u32,
    pub(super) float_frame: u32,
    cache_select: u32,
    tcm_control: [u32; 2],
}

impl Processor {
    /// Makes the state after power-on.
    #[must_use]
    pub fn new(now_ns: u64, core_hz: u64, vector_table: u32) -> Self {
        Self {
            exceptions: Exceptions::new(),
            faults: FaultStatus::default(),
            systick: SysTick::new(now_ns, core_hz),
            debug: Debug::new(now_ns, core_hz),
            event: false,
            requests: Requests::default(),
            mpu: Mpu::default(),
            vector_table,
            sleep_control: 0,
            configuration: CCR_RESET,
            coprocessors: 0,
            auxiliary: 0,
            float_control: FPCCR_RESET,
            float_frame: 0,
            cache_select: 0,
            // Reset values of ITCMCR and DTCMCR: 64 and 128 KiB, enabled (DDI0489D 3.3.6; sizes of the chip).
            tcm_control: [0x39, 0x41],
        }
    }

    /// Resets the processor; the debug components keep their state.
    pub fn reset(&mut self, now_ns: u64, core_hz: u64, vector_table: u32) {
        let mut exceptions = self.exceptions.clone();
        exceptions.reset();
        *self = Self { exceptions, debug: self.debug.clone(), ..Self::new(now_ns, core_hz, vector_table) };
        // The cycle counter continues, at the rate of the clock after the reset.
        self.debug.set_core_hz(now_ns, core_hz);
    }

    /// Sets the frequency of the core clock, Hz.
    pub fn set_core_hz(&mut self, now_ns: u64, core_hz: u64) {
        self.systick.set_core_hz(now_ns, core_hz);
        self.debug.set_core_hz(now_ns, core_hz);
    }

    /// Advances the timers to `now_ns`.
    pub fn advance(&mut self, now_ns: u64) {
        if self.systick.advance(now_ns) {
            self.exceptions.set_pending(number::SYS_TICK);
        }
    }

    /// Returns the address of the vector table, VTOR.
    #[must_use]
    pub fn vector_table(&self) -> u32 {
        self.vector_table
    }

    /// Returns true if privileged code may use floating point: CPACR gives access to CP10 and CP11.
    #[must_use]
    pub fn fpu_enabled(&self) -> bool {
        self.coprocessors >> 20 & 0b0101 == 0b0101
    }

    /// Returns true if memory protection applies to code at this priority (B3.5.2: HFNMIENA).
    #[must_use]
    pub fn is_protected(&self, masks: Masks) -> bool {
        self.mpu.is_on() && (self.mpu.is_on_in_fault_handlers() || self.exceptions.execution_priority(masks) >= 0)
    }

    /// Returns the accesses that the memory protection unit allows while it is on.
    #[must_use]
    pub fn protection(&self) -> Protection {
        self.mpu.protection()
    }

    /// Returns MPU_CTRL.ENABLE: the memory protection unit is on.
    #[must_use]
    pub fn has_protection(&self) -> bool {
        self.mpu.is_on()
    }

    /// Returns FPCCR.ASPEN: exceptions save floating-point registers.
    #[must_use]
    pub fn saves_float(&self) -> bool {
        self.float_control & AUTOMATIC_SAVE != 0
    }

    /// Returns SCR.SLEEPONEXIT: the core sleeps after the last handler.
    #[must_use]
    pub fn sleep_on_exit(&self) -> bool {
        self.sleep_control & 1 << 1 != 0
    }

    /// Returns SCR.SLEEPDEEP: sleep means a low-power mode.
    #[must_use]
    pub fn sleep_deep(&self) -> bool {
        self.sleep_control & 1 << 2 != 0
    }

    /// Returns SCR.SEVONPEND: a new pending interrupt is an event.
    #[must_use]
    pub fn event_on_pend(&self) -> bool {
        self.sleep_control & 1 << 4 != 0
    }

    /// Returns CCR.BFHFNMIGN: handlers of negative priority ignore bus errors.
    #[must_use]
    pub fn ignores_bus_faults(&self) -> bool {
        self.configuration & BFHFNMIGN != 0
    }

    /// Returns CCR.NONBASETHRDENA: a nested handler may return to thread mode.
    #[must_use]
    pub fn any_level_returns_to_thread(&self) -> bool {
        self.configuration & 1 != 0
    }

    /// Reads an address from 0xE000_0000 on; `active` is the exception number in IPSR.
    ///
    /// # Errors
    /// [`Unmodelled`] for a register without a model.
    pub fn read(&mut self, address: u32, size: Size, now_ns: u64, active: u16) -> Result<u32, Unmodelled> {
        let word = address & !3;
        let value = if size == Size::Word || in_bytes(word) { self.read_word(word, now_ns, active) } else { None };
        let shift = address & 3;
        let mask = u32::MAX >> (32 - 8 * size.bytes());
        value.map(|value| value >> (8 * shift) & mask).ok_or_else(|| unmodelled(address, size))
    }

    /// Writes to an address from 0xE000_0000 on.
    ///
    /// # Errors
    /// [`Unmodelled`] for a register, or a use of one, without a model.
    pub fn write(&mut self, address: u32, size: Size, value: u32, now_ns: u64) -> Result<(), Unmodelled> {
        let word = address & !3;
        let shift = 8 * (address & 3);
        let value = match size {
            Size::Word => Some(value),
            // Ones clear bits here, so the other bytes must not be written back.
            _ if word == 0xE000_ED28 => Some(value << shift),
            _ if in_bytes(word) => self.read_word(word, now_ns, 0).map(|old| {
                let mask = (u32::MAX >> (32 - 8 * size.bytes())) << shift;
                old & !mask | value << shift & mask
            }),
            _ => None,
        };
        let value = value.ok_or_else(|| unmodelled(address, size))?;
        self.write_word(word, value, now_ns).ok_or_else(|| {
            let what = format!("write of {value:#010x} to {address:#010x} is not modelled");
            Unmodelled { peripheral: "PPB", what }
        })
    }

    fn read_word(&mut self, address: u32, now_ns: u64, active: u16) -> Option<u32> {
        let offset = match address {
            0xE000_0000..0xE000_2000 => return self.debug.read(address & 0x1FFF, now_ns),
            0xE000_E000..0xE000_F000 => address & 0xFFF,
            _ => return None,
        };
        Some(match offset {
            0x004 => ICTR,
            0x008 => self.auxiliary,
            0x010..0x01C => {
                self.advance(now_ns);
                self.systick.read(offset - 0x010, now_ns)?
            }
            0x100..0xD00 => nvic::read(&self.exceptions, offset)?,
            0xD00 => CPUID,
            0xD04 => self.interrupt_control(active),
            0xD08 => self.vector_table,
            0xD0C => KEY_READS << 16 | u32::from(self.exceptions.prigroup) << 8,
            0xD10 => self.sleep_control,
            0xD14 => self.configuration,
            0xD18 | 0xD1C | 0xD20 => {
                let first = (offset - 0xD18 + 4) as u16;
                u32::from_le_bytes(std::array::from_fn(|byte| self.exceptions.priority_field(first + byte as u16)))
            }
            0xD24 => self.handler_control(),
            0xD28 => self.faults.configurable,
            0xD2C => self.faults.hard,
            0xD30 => self.faults.debug,
            0xD34 => self.faults.memory_address,
            0xD38 => self.faults.bus_address,
            0xD3C => 0,
            0xD40..0xD80 => identification(offset)?,
            // CCSIDR: 16 KiB of instruction and data cache each, 32 bytes per line, 2 and 4 ways (DDI0489D 3.3.4,
            // RM0399 2.1).
            0xD80 if self.cache_select & 1 == 1 => 0xF01F_E009,
            0xD80 => 0xF00F_E019,
            0xD84 => self.cache_select,
            0xD88 => self.coprocessors,
            0xD90..0xDBC => self.mpu.read(offset - 0xD90)?,
            // DHCSR reads 0: no debugger is connected.
            0xDF0 => 0,
            0xDFC => self.debug.demcr(),
            0xF34 => self.float_control,
            0xF38 => self.float_frame,
            0xF3C => 0,
            // Values of MVFR0 to 2: single and double precision, FPv5 (DDI0489D 8.3).
            0xF40 => 0x1011_0221,
            0xF44 => 0x1200_0011,
            0xF48 => 0x0000_0040,
            0xF90 => self.tcm_control[0],
            0xF94 => self.tcm_control[1],
            _ => return None,
        })
    }

    fn write_word(&mut self, address: u32, value: u32, now_ns: u64) -> Option<()> {
        let offset = match address {
            0xE000_0000..0xE000_2000 => return self.debug.write(address & 0x1FFF, value, now_ns),
            0xE000_E000..0xE000_F000 => address & 0xFFF,
            _ => return None,
        };
        match offset {
            0x008 => self.auxiliary = value,
            0x010..0x01C => {
                self.advance(now_ns);
                self.systick.write(offset - 0x010, value, now_ns)?;
            }
            0x100..0xD00 => nvic::write(&mut self.exceptions, offset, value)?,
            0xD04 => self.pend(value),
            0xD08 => self.vector_table = value & !0x7F,
            0xD0C => return self.reset_control(value),
            // Writable bits: SEVEXTONPEND, SLEEPDEEP, SLEEPONEXIT.
            0xD10 => self.sleep_control = value & 0x16,
            0xD14 if value & (UNALIGN_TRP | DIV_0_TRP) != 0 => return None,
            0xD14 => self.configuration = value & CCR_WRITABLE | CCR_RESET,
            0xD18 | 0xD1C | 0xD20 => {
                let first = (offset - 0xD18 + 4) as u16;
                for (byte, priority) in value.to_le_bytes().into_iter().enumerate() {
                    let exception = first + byte as u16;
                    if implemented(exception) {
                        self.exceptions.set_priority_field(exception, priority);
                    }
                }
            }
            0xD24 => self.set_handler_control(value),
            0xD28 => self.faults.configurable &= !value,
            0xD2C => self.faults.hard &= !value,
            0xD30 => self.faults.debug &= !value,
            0xD34 => self.faults.memory_address = value,
            0xD38 => self.faults.bus_address = value,
            0xD84 => self.cache_select = value & 0xF,
            0xD88 => {
                self.coprocessors = value & 0x00F0_0000;
                self.requests.fpu = true;
            }
            0xD90..0xDBC => {
                self.mpu.write(offset - 0xD90, value)?;
                self.requests.protection = true;
            }
            0xDFC => self.debug.set_demcr(value, now_ns)?,
            0xF00 => nvic::trigger(&mut self.exceptions, value),
            // LSPACT and the related bits are state of lazy saving, which the model does not have.
            0xF34 => self.float_control = value & FPCCR_RESET,
            0xF38 => self.float_frame = value & !7,
            0xF3C if value == 0 => {}
            // Cache and branch predictor maintenance does nothing: the model has no caches.
            0xF50 | 0xF58..0xF7C => {}
            0xF90 => self.tcm_control[0] = self.tcm_control[0] & !7 | value & 7,
            0xF94 => self.tcm_control[1] = self.tcm_control[1] & !7 | value & 7,
            _ => return None,
        }
        Some(())
    }

    /// Returns the value of ICSR (B3.2.4).
    fn interrupt_control(&self, active: u16) -> u32 {
        let exceptions = &self.exceptions;
        let flag = |bit: u32, exception| u32::from(exceptions.is_pending(exception)) << bit;
        let external = exceptions.pending.iter().any(|exception| exception >= number::IRQ0);
        let others = exceptions.active.iter().filter(|exception| *exception != active).count();
        flag(31, number::NMI)
            | flag(28, number::PEND_SV)
            | flag(26, number::SYS_TICK)
            | u32::from(external) << 22
            | u32::from(exceptions.next_pending().unwrap_or(0)) << 12
            | u32::from(others == 0) << 11
            | u32::from(active)
    }

    fn pend(&mut self, value: u32) {
        for (set, clear, exception) in
            [(31, None, number::NMI), (28, Some(27), number::PEND_SV), (26, Some(25), number::SYS_TICK)]
        {
            if value >> set & 1 == 1 {
                self.exceptions.set_pending(exception);
            } else if clear.is_some_and(|bit: u32| value >> bit & 1 == 1) {
                self.exceptions.clear_pending(exception);
            }
        }
    }

    /// Writes AIRCR; ignored without the key.
    fn reset_control(&mut self, value: u32) -> Option<()> {
        if value >> 16 != KEY {
            return Some(());
        }
        if value & VECTCLRACTIVE_VECTRESET != 0 {
            // These bits are reserved for debuggers.
            return None;
        }
        self.exceptions.prigroup = (value >> 8 & 7) as u8;
        self.exceptions.changed();
        self.requests.reset |= value & SYSRESETREQ != 0;
        Some(())
    }

    /// Returns the value of SHCSR (B3.2.13).
    fn handler_control(&self) -> u32 {
        let exceptions = &self.exceptions;
        let active = ACTIVE_BITS.iter().map(|(bit, exception)| (bit, exceptions.is_active(*exception)));
        let pending = PENDING_BITS.iter().map(|(bit, exception)| (bit, exceptions.is_pending(*exception)));
        let enabled = ENABLE_BITS.iter().map(|(bit, exception)| (bit, exceptions.enabled.get(*exception)));
        active.chain(pending).chain(enabled).fold(0, |word, (bit, on)| word | u32::from(on) << bit)
    }

    /// Writes SHCSR. On hardware, operating systems can write the active bits to manipulate exceptions; this model
    /// ignores them.
    fn set_handler_control(&mut self, value: u32) {
        for (bit, exception) in PENDING_BITS {
            if value >> bit & 1 == 1 {
                self.exceptions.set_pending(exception);
            } else {
                self.exceptions.clear_pending(exception);
            }
        }
        for (bit, exception) in ENABLE_BITS {
            self.exceptions.set_enabled(exception, value >> bit & 1 == 1);
        }
    }
}

const ACTIVE_BITS: [(u32, u16); 7] = [
    (0, number::MEM_MANAGE),
    (1, number::BUS_FAULT),
    (3, number::USAGE_FAULT),
    (7, number::SV_CALL),
    (8, number::DEBUG_MONITOR),
    (10, number::PEND_SV),
    (11, number::SYS_TICK),
];

const PENDING_BITS: [(u32, u16); 4] =
    [(12, number::USAGE_FAULT), (13, number::MEM_MANAGE), (14, number::BUS_FAULT), (15, number::SV_CALL)];

const ENABLE_BITS: [(u32, u16); 3] = [(16, number::MEM_MANAGE), (17, number::BUS_FAULT), (18, number::USAGE_FAULT)];

/// Returns true for system exceptions with a priority in SHPR.
fn implemented(exception: u16) -> bool {
    matches!(exception, 4..=6 | 11 | 12 | 14 | 15)
}

/// Returns true for registers with byte and halfword access (B3.2, B3.4): IPR, SHPR, CFSR.
fn in_bytes(word: u32) -> bool {
    matches!(word, 0xE000_E400..0xE000_E4F0 | 0xE000_ED18..0xE000_ED24 | 0xE000_ED28)
}

/// Returns a register of processor and instruction set features, or of the cache type (DDI0489D table 3-3, 3-11).
fn identification(offset: u32) -> Option<u32> {
    Some(match offset {
        0xD40 => 0x0000_0030,
        0xD44 => 0x0000_0200,
        0xD48 => 0x0010_0000,
        0xD4C => 0,
        0xD50 => 0x0010_0030,
        0xD54 => 0,
        0xD58 => 0x0100_0000,
        0xD5C => 0,
        0xD60 => 0x0110_1110,
        0xD64 => 0x0211_2000,
        0xD68 => 0x2023_2231,
        0xD6C => 0x0111_1131,
        0xD70 => 0x0131_0132,
        0xD78 => 0x0900_0003,
        0xD7C => 0x8303_C003,
        _ => return None,
    })
}

fn unmodelled(address: u32, size: Size) -> Unmodelled {
    Unmodelled { peripheral: "PPB", what: format!("{size} access to {address:#010x} is not modelled") }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn processor() -> Processor {
        Processor::new(0, 480_000_000, 0x0800_0000)
    }

    fn read(processor: &mut Processor, address: u32) -> u32 {
        processor.read(address, Size::Word, 0, 0).unwrap()
    }

    #[test]
    fn priorities_are_written_by_bytes() {
        let mut cpu = processor();
        cpu.write(0xE000_E405, Size::Byte, 0xA7, 0).unwrap();
        cpu.write(0xE000_ED22, Size::Half, 0xF0E0, 0).unwrap();
        assert_eq!(read(&mut cpu, 0xE000_E404), 0x0000_A000);
        assert_eq!(cpu.read(0xE000_E405, Size::Byte, 0, 0), Ok(0xA0));
        assert_eq!(read(&mut cpu, 0xE000_ED20), 0xF0E0_0000);
        assert_eq!(cpu.exceptions.priority(number::PEND_SV), 0xE0);
        cpu.write(0xE000_ED1C, Size::Word, u32::MAX, 0).unwrap();
        assert_eq!(read(&mut cpu, 0xE000_ED1C), 0xF000_0000);
    }

    #[test]
    fn other_registers_take_words_only() {
        let mut cpu = processor();
        assert!(cpu.read(0xE000_ED08, Size::Byte, 0, 0).is_err());
        assert!(cpu.write(0xE000_E100, Size::Byte, 1, 0).is_err());
        assert!(cpu.read(0xE000_5000, Size::Word, 0, 0).is_err());
    }

    #[test]
    fn the_reset_register_needs_its_key() {
        let mut cpu = processor();
        cpu.write(0xE000_ED0C, Size::Word, 0x0000_0704, 0).unwrap();
        assert_eq!((cpu.requests.reset, read(&mut cpu, 0xE000_ED0C)), (false, 0xFA05_0000));
        cpu.write(0xE000_ED0C, Size::Word, 0x05FA_0304, 0).unwrap();
        assert_eq!((cpu.requests.reset, read(&mut cpu, 0xE000_ED0C)), (true, 0xFA05_0300));
    }

    #[test]
    fn icsr_tells_what_is_pending_and_active() {
        let mut cpu = processor();
        cpu.exceptions.set_enabled(number::IRQ0 + 5, true);
        cpu.exceptions.set_line(5, true);
        cpu.write(0xE000_ED04, Size::Word, 1 << 28, 0).unwrap();
        cpu.exceptions.set_priority_field(number::PEND_SV, 0xF0);
        assert_eq!(cpu.read(0xE000_ED04, Size::Word, 0, 0), Ok(1 << 28 | 1 << 22 | 21 << 12 | 1 << 11));
        cpu.exceptions.activate(number::IRQ0 + 5);
        assert_eq!(cpu.read(0xE000_ED04, Size::Word, 0, 21), Ok(1 << 28 | 14 << 12 | 1 << 11 | 21));
        cpu.write(0xE000_ED04, Size::Word, 1 << 27, 0).unwrap();
        assert_eq!(cpu.read(0xE000_ED04, Size::Word, 0, 21), Ok(1 << 11 | 21));
    }

    #[test]
    fn fault_status_is_cleared_by_ones_in_its_own_byte() {
        let mut cpu = processor();
        cpu.faults.configurable = 0x0101_8201;
        cpu.write(0xE000_ED29, Size::Byte, 0x82, 0).unwrap();
        assert_eq!(read(&mut cpu, 0xE000_ED28), 0x0101_0001);
        assert_eq!(cpu.read(0xE000_ED2A, Size::Half, 0, 0), Ok(0x0101));
    }

    #[test]
    fn faults_are_enabled_by_shcsr() {
        let mut cpu = processor();
        assert!(!cpu.exceptions.can_take(number::BUS_FAULT, super::super::Masks::NONE));
        cpu.write(0xE000_ED24, Size::Word, 1 << 17, 0).unwrap();
        assert!(cpu.exceptions.can_take(number::BUS_FAULT, super::super::Masks::NONE));
        assert_eq!(read(&mut cpu, 0xE000_ED24), 1 << 17);
    }

    #[test]
    fn floating_point_is_allowed_by_cpacr() {
        let mut cpu = processor();
        assert!(!cpu.fpu_enabled());
        cpu.write(0xE000_ED88, Size::Word, 0xF << 20, 0).unwrap();
        assert!(cpu.fpu_enabled() && cpu.requests.fpu);
        // Access to one of the two coprocessors is not enough.
        cpu.write(0xE000_ED88, Size::Word, 3 << 20, 0).unwrap();
        assert!(!cpu.fpu_enabled());
    }

    #[test]
    fn caches_are_described_and_their_maintenance_is_accepted() {
        let mut cpu = processor();
        // Expected: 128 sets of 4 ways of 32 bytes; 256 sets of 2 ways.
        assert_eq!(read(&mut cpu, 0xE000_ED80), 0xF00F_E019);
        cpu.write(0xE000_ED84, Size::Word, 1, 0).unwrap();
        assert_eq!(read(&mut cpu, 0xE000_ED80), 0xF01F_E009);
        for operation in [0xF50, 0xF58, 0xF60, 0xF70, 0xF74, 0xF78] {
            cpu.write(0xE000_E000 + operation, Size::Word, 0, 0).unwrap();
        }
        cpu.write(0xE000_ED14, Size::Word, 3 << 16, 0).unwrap();
        assert_eq!(read(&mut cpu, 0xE000_ED14), 3 << 16 | 1 << 9);
    }

    #[test]
    fn traps_that_are_not_modelled_are_refused() {
        let mut cpu = processor();
        assert!(cpu.write(0xE000_ED14, Size::Word, DIV_0_TRP, 0).is_err());
        cpu.write(0xE000_ED14, Size::Word, BFHFNMIGN, 0).unwrap();
        assert_eq!(read(&mut cpu, 0xE000_ED14), BFHFNMIGN | 1 << 9);
        assert!(cpu.ignores_bus_faults());
    }

    #[test]
    fn a_reset_keeps_the_cycle_counter_and_lines() {
        let mut cpu = processor();
        cpu.debug.set_demcr(1 << 24, 0).unwrap();
        cpu.exceptions.set_line(3, true);
        cpu.exceptions.activate(19);
        cpu.write(0xE000_ED08, Size::Word, 0x2000_0000, 0).unwrap();
        cpu.reset(10, 64_000_000, 0x0800_0000);
        assert_eq!((read(&mut cpu, 0xE000_EDFC), read(&mut cpu, 0xE000_ED08)), (1 << 24, 0x0800_0000));
        assert!(cpu.exceptions.is_pending(19) && !cpu.exceptions.is_active(19));
    }
}
