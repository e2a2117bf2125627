//! Processor state, and bookkeeping during a run.

use r4_mcu::cpu::exceptions::PRIORITY_MASK;
use r4_mcu::cpu::{CoreBus, CoreError, Limits, Register};

use crate::float::{self, Float};
use crate::memory::Memory;
use crate::operation::{COUNT, LR, SP};

/// Bit EPSR.T: Thumb state.
const THUMB: u32 = 1 << 24;
/// Bit CONTROL.SPSEL: thread mode uses PSP.
pub(crate) const PROCESS_STACK: u32 = 1 << 1;
/// Bit CONTROL.FPCA: a floating-point context is active.
pub(crate) const FLOAT_ACTIVE: u32 = 1 << 2;

/// Returns the bits of a priority that the chip has (B1.4.3: in BASEPRI too, the others are zero).
pub(crate) fn priority(value: u32) -> u32 {
    value & u32::from(PRIORITY_MASK)
}

/// Condition flags, stored as the values that they are derived from.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Flags {
    /// Value with the sign of N.
    pub(crate) n: u32,
    /// Value that is zero if Z is set.
    pub(crate) z: u32,
    pub(crate) c: bool,
    /// Value with the sign of V.
    pub(crate) v: u32,
}

/// Truth table per condition: bit n is set if the condition holds for NZCV = n (A7.3).
const HOLDS: [u16; 16] = {
    let mut table = [0; 16];
    let mut flags = 0;
    while flags < 16 {
        let (n, z, c, v) = (flags & 8 != 0, flags & 4 != 0, flags & 2 != 0, flags & 1 != 0);
        let base = [z, c, n, v, c && !z, n == v, n == v && !z, true];
        let mut condition = 0;
        while condition < 16 {
            if base[condition / 2] != (condition % 2 == 1 && condition < 14) {
                table[condition] |= 1 << flags;
            }
            condition += 1;
        }
        flags += 1;
    }
    table
};

impl Flags {
    /// Returns N, Z, C, V in bits 3 to 0.
    #[inline(always)]
    pub(crate) fn nzcv(&self) -> u32 {
        self.n >> 31 << 3 | u32::from(self.z == 0) << 2 | u32::from(self.c) << 1 | self.v >> 31
    }

    pub(crate) fn set_nzcv(&mut self, nzcv: u32) {
        *self = Self { n: nzcv << 28, z: u32::from(nzcv & 4 == 0), c: nzcv & 2 != 0, v: nzcv << 31 };
    }

    #[inline(always)]
    pub(crate) fn holds(&self, condition: u8) -> bool {
        HOLDS[usize::from(condition & 15)] >> self.nzcv() & 1 != 0
    }
}

/// State of the processor and of the current run.
pub(crate) struct State {
    pub(crate) r: [u32; COUNT],
    pub(crate) flags: Flags,
    pub(crate) pc: u32,
    /// APSR.Q, the sticky saturation flag.
    pub(crate) q: bool,
    /// APSR.GE, bits 3 to 0.
    pub(crate) ge: u8,
    /// EPSR.IT, bits 7 to 0.
    pub(crate) it: u8,
    pub(crate) thumb: bool,
    /// IPSR, the exception number; 0 in thread mode.
    pub(crate) exception: u16,
    /// Stack pointer that is not in use.
    other_sp: u32,
    /// PSP is the stack pointer in use.
    process: bool,
    pub(crate) primask: u32,
    pub(crate) basepri: u32,
    pub(crate) faultmask: u32,
    pub(crate) control: u32,
    pub(crate) float: float::Registers,
    /// Floating-point instructions are enabled.
    pub(crate) fpu: bool,
    /// Address that the exclusive monitor watches.
    pub(crate) exclusive: Option<u32>,
    pub(crate) memory: Memory,
    /// Decoded code may be outdated: memory or the memory map has changed.
    pub(crate) stale: bool,
    /// Instructions of this run before the current block.
    pub(crate) executed: u64,
    pub(crate) limits: Limits,
    /// Number of instructions from which on the slow checks run before each block.
    pub(crate) attention_at: u64,
    /// PRIMASK, BASEPRI, FAULTMASK at the last request of `limits`.
    pub(crate) masks: [u32; 3],
    pub(crate) error: Option<CoreError>,
}

impl State {
    pub(crate) fn new() -> Self {
        Self {
            r: [0; COUNT],
            flags: Flags { z: 1, ..Flags::default() },
            pc: 0,
            q: false,
            ge: 0,
            it: 0,
            thumb: true,
            exception: 0,
            other_sp: 0,
            process: false,
            primask: 0,
            basepri: 0,
            faultmask: 0,
            control: 0,
            float: float::Registers::default(),
            fpu: false,
            exclusive: None,
            memory: Memory::new(),
            stale: false,
            executed: 0,
            limits: Limits { instructions: 0, mask_changes: false },
            attention_at: 0,
            masks: [0; 3],
            error: None,
        }
    }

    /// Returns true if instructions run privileged (B1.3.1).
    pub(crate) fn is_privileged(&self) -> bool {
        self.exception != 0 || self.control & 1 == 0
    }

    /// Returns PRIMASK, BASEPRI and FAULTMASK.
    pub(crate) fn masks(&self) -> [u32; 3] {
        [self.primask, self.basepri, self.faultmask]
    }

    /// Requests the limits from the bus again.
    pub(crate) fn refresh_limits(&mut self, bus: &mut dyn CoreBus) {
        self.limits = bus.limits();
        self.masks = self.masks();
        let attention = self.limits.mask_changes || self.stale || self.error.is_some();
        self.attention_at = if attention { 0 } else { self.limits.instructions };
    }

    /// Marks decoded blocks as outdated.
    pub(crate) fn set_stale(&mut self) {
        self.stale = true;
        self.attention_at = 0;
    }

    /// Selects the stack pointer in use from mode and CONTROL.SPSEL.
    fn select_stack(&mut self) {
        let process = self.exception == 0 && self.control & PROCESS_STACK != 0;
        if self.process != process {
            self.process = process;
            std::mem::swap(&mut self.r[usize::from(SP)], &mut self.other_sp);
        }
    }

    /// Returns MSP, or PSP if `process`.
    pub(crate) fn stack(&self, process: bool) -> u32 {
        if self.process == process { self.r[usize::from(SP)] } else { self.other_sp }
    }

    pub(crate) fn set_stack(&mut self, process: bool, value: u32) {
        let sp = if self.process == process { &mut self.r[usize::from(SP)] } else { &mut self.other_sp };
        *sp = value & !3;
    }

    pub(crate) fn set_control(&mut self, value: u32) {
        self.control = value & 7;
        self.select_stack();
    }

    /// Returns APSR with all its fields.
    pub(crate) fn apsr(&self) -> u32 {
        self.flags.nzcv() << 28 | u32::from(self.q) << 27 | u32::from(self.ge) << 16
    }

    pub(crate) fn get(&self, register: Register) -> u32 {
        let it = u32::from(self.it);
        match register {
            Register::R(index) => self.r[usize::from(index.min(12))],
            Register::Sp => self.r[usize::from(SP)],
            Register::Lr => self.r[usize::from(LR)],
            Register::Pc => self.pc,
            Register::Msp => self.stack(false),
            Register::Psp => self.stack(true),
            Register::Xpsr => {
                let thumb = if self.thumb { THUMB } else { 0 };
                self.apsr() | thumb | (it & 3) << 25 | it >> 2 << 10 | u32::from(self.exception)
            }
            Register::Primask => self.primask,
            Register::Basepri => self.basepri,
            Register::Faultmask => self.faultmask,
            Register::Control => self.control,
            Register::Fpscr => self.float.fpscr,
            Register::S(index) => self.float.s[usize::from(index.min(31))],
        }
    }

    pub(crate) fn set(&mut self, register: Register, value: u32) {
        match register {
            Register::R(index) => self.r[usize::from(index.min(12))] = value,
            Register::Sp => self.r[usize::from(SP)] = value & !3,
            Register::Lr => self.r[usize::from(LR)] = value,
            Register::Pc => self.pc = value & !1,
            Register::Msp => self.set_stack(false, value),
            Register::Psp => self.set_stack(true, value),
            Register::Xpsr => {
                self.flags.set_nzcv(value >> 28);
                self.q = value >> 27 & 1 != 0;
                self.ge = (value >> 16 & 15) as u8;
                self.it = (value >> 25 & 3 | value >> 10 << 2 & 0xFC) as u8;
                self.thumb = true;
                self.exception = (value & 0x1FF) as u16;
                self.select_stack();
            }
            Register::Primask => self.primask = value & 1,
            Register::Basepri => self.basepri = priority(value),
            Register::Faultmask => self.faultmask = value & 1,
            Register::Control => self.set_control(value),
            Register::Fpscr => self.float.set_fpscr(value),
            Register::S(index) => self.float.s[usize::from(index.min(31))] = value,
        }
    }
}

/// Core registers lent to a floating-point instruction.
struct Lent<'a> {
    r: &'a mut [u32; COUNT],
    flags: &'a mut Flags,
}

impl float::CoreRegisters for Lent<'_> {
    fn get(&self, register: u8) -> u32 {
        self.r[usize::from(register) % COUNT]
    }

    fn set(&mut self, register: u8, value: u32) {
        self.r[usize::from(register) % COUNT] = value;
    }

    fn nzcv(&self) -> u32 {
        self.flags.nzcv() << 28
    }

    fn set_nzcv(&mut self, flags: u32) {
        self.flags.set_nzcv(flags >> 28);
    }
}

impl State {
    /// Executes a floating-point instruction other than loads and stores.
    pub(crate) fn execute_float(&mut self, float: &Float) {
        float.execute(&mut self.float, &mut Lent { r: &mut self.r, flags: &mut self.flags });
    }
}
