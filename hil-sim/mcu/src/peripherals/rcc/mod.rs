//! Reset and clock control RCC (RM0399, 9).
//!
//! Oscillators and PLLs become ready after the typical start-up times of DS12930, so that a program that does not wait
//! is detected. The clock tree is decoded exactly ([`Rcc::clocks`]); each change of it is a [`Signal::Clocks`].
//!
//! The registers at 0x0D0 to 0x11C are those of the core that accesses them, which is the Cortex-M7; those at 0x130 are
//! the same ones under their other address, and those at 0x190 belong to the Cortex-M4. A block has its clock if either
//! core enables it.
//!
//! The chip ignores writes to PLLSRC, DIVMx, DIVx and DIVxEN of a PLL that is on, and so does the model; an attempt to
//! write a value other than 0 there is reported as misuse. (A program that writes the fields of one PLL with a plain
//! store writes zeros into those of the others, which has no effect.) Reserved bits are read-only.
//!
//! A crystal can stop while it is used ([`Rcc::stop_hse_at`]). With the clock security system on (CR.HSECSSON, 9.5.3)
//! HSE and the PLLs that depend on it are turned off, the core changes to HSI, and the NMI is raised until
//! CICR.HSECSSC. That takes no time in the model; the manual gives none. Without it all clocks from the crystal stop,
//! the core's too: the output of a PLL without a reference is not specified, and this is the worst case. HSERDY keeps
//! its value then, because the manual names no condition that clears it.
//!
//! The Cortex-M4, the security system of LSE, clock outputs (MCO1, MCO2) and the high-resolution timer's clock are not
//! modelled; turning them on ends the run. Wake-up clocks and autonomous mode matter only with low-power modes: their
//! settings are stored.

mod decode;
mod enable;
mod limits;
#[cfg(test)]
mod tests;

use std::fmt;

use crate::{
    Clocks, Context, Peripheral, ResetCause, Signal, Size, Unmodelled,
    peripherals::{
        access::{merged, part},
        pwr::VoltageScale,
    },
};

pub use decode::Oscillators;

/// Offsets of the registers (RM0399, 9.7).
mod offset {
    pub(super) const CR: u32 = 0x00;
    pub(super) const HSICFGR: u32 = 0x04;
    pub(super) const CRRCR: u32 = 0x08;
    pub(super) const CSICFGR: u32 = 0x0C;
    pub(super) const CFGR: u32 = 0x10;
    pub(super) const D1CFGR: u32 = 0x18;
    pub(super) const D2CFGR: u32 = 0x1C;
    pub(super) const D3CFGR: u32 = 0x20;
    pub(super) const PLLCKSELR: u32 = 0x28;
    pub(super) const PLLCFGR: u32 = 0x2C;
    pub(super) const PLL1DIVR: u32 = 0x30;
    pub(super) const PLL1FRACR: u32 = 0x34;
    pub(super) const PLL3FRACR: u32 = 0x44;
    pub(super) const D1CCIPR: u32 = 0x4C;
    pub(super) const D2CCIP1R: u32 = 0x50;
    pub(super) const D2CCIP2R: u32 = 0x54;
    pub(super) const D3CCIPR: u32 = 0x58;
    pub(super) const CIER: u32 = 0x60;
    pub(super) const CIFR: u32 = 0x64;
    pub(super) const CICR: u32 = 0x68;
    pub(super) const BDCR: u32 = 0x70;
    pub(super) const CSR: u32 = 0x74;
    /// First of the nine reset registers, AHB3RSTR.
    pub(super) const RESETS: u32 = 0x7C;
    pub(super) const GCR: u32 = 0xA0;
    pub(super) const D3AMR: u32 = 0xA8;
    /// Registers of the accessing core: RSR, nine enable registers from AHB3ENR on, and nine for sleep from 0xFC on.
    pub(super) const OF_CORE: u32 = 0xD0;
    /// Second address of the Cortex-M7's registers.
    pub(super) const CORE_1: u32 = 0x130;
    /// Address of the Cortex-M4's registers.
    pub(super) const CORE_2: u32 = 0x190;
    pub(super) const END: u32 = 0x1E0;
}

/// Interrupt number of RCC.
const IRQ: u16 = 5;

/// Bits of the register CR.
const HSEON: u32 = 1 << 16;
const HSECSSON: u32 = 1 << 19;
/// Bits of CFGR; MCO1 and MCO2 are off while their prescalers are 0.
const MCO1PRE: u32 = 0xF << 18;
const MCO2PRE: u32 = 0xF << 25;
const HRTIMSEL: u32 = 1 << 14;
/// Bit of CIFR and CICR.
const HSECSSF: u32 = 1 << 10;

/// Oscillator or PLL with a ready flag, numbered as its flag in RCC_CIFR.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Oscillator {
    Lsi,
    Lse,
    Hsi,
    Hse,
    Csi,
    Hsi48,
    Pll1,
    Pll2,
    Pll3,
}

impl fmt::Display for Oscillator {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Lsi => "LSI",
            Self::Lse => "LSE",
            Self::Hsi => "HSI",
            Self::Hse => "HSE",
            Self::Csi => "CSI",
            Self::Hsi48 => "HSI48",
            Self::Pll1 => "PLL1",
            Self::Pll2 => "PLL2",
            Self::Pll3 => "PLL3",
        })
    }
}

impl Oscillator {
    const ALL: [Self; 9] =
        [Self::Lsi, Self::Lse, Self::Hsi, Self::Hse, Self::Csi, Self::Hsi48, Self::Pll1, Self::Pll2, Self::Pll3];
    const PLLS: [Self; 3] = [Self::Pll1, Self::Pll2, Self::Pll3];

    /// Returns the typical time from on to ready, ns (DS12930, tables of the oscillators and of the PLL).
    const fn start_up_ns(self) -> u64 {
        match self {
            Self::Lsi => 80_000,
            Self::Lse => 2_000_000_000,
            Self::Hsi => 1_400,
            Self::Hse => 2_000_000,
            Self::Csi => 1_000,
            Self::Hsi48 => 2_100,
            Self::Pll1 | Self::Pll2 | Self::Pll3 => 50_000,
        }
    }

    /// Returns its enable bit and its ready bit in RCC_CR; `None` for LSE and LSI, which have registers of their own.
    const fn bits(self) -> Option<(u32, u32)> {
        match self {
            Self::Lsi | Self::Lse => None,
            Self::Hsi => Some((1 << 0, 1 << 2)),
            Self::Csi => Some((1 << 7, 1 << 8)),
            Self::Hsi48 => Some((1 << 12, 1 << 13)),
            Self::Hse => Some((1 << 16, 1 << 17)),
            Self::Pll1 => Some((1 << 24, 1 << 25)),
            Self::Pll2 => Some((1 << 26, 1 << 27)),
            Self::Pll3 => Some((1 << 28, 1 << 29)),
        }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum State {
    #[default]
    Off,
    /// Ready at that time, ns; `u64::MAX` for never.
    Starting(u64),
    Ready,
}

/// Writable registers: offset, value after a reset, mask of existing bits.
const PLAIN: [(u32, u32, u32); 17] = [
    (offset::HSICFGR, 0x4000_0000, 0x7F00_0000),
    (offset::CSICFGR, 0x2000_0000, 0x3F00_0000),
    (offset::CFGR, 0, 0xFFFC_FFC7),
    (offset::D1CFGR, 0, 0xF7F),
    (offset::D2CFGR, 0, 0x770),
    (offset::D3CFGR, 0, 0x70),
    (offset::PLL1FRACR, 0, 0xFFF8),
    (offset::PLL1FRACR + 8, 0, 0xFFF8),
    (offset::PLL3FRACR, 0, 0xFFF8),
    (offset::D1CCIPR, 0, 0x3001_0133),
    (offset::D2CCIP1R, 0, 0xB137_71C7),
    (offset::D2CCIP2R, 0, 0x70F0_333F),
    (offset::D3CCIPR, 0, 0x77E3_FF07),
    (offset::CIER, 0, 0x3FF),
    (offset::GCR, 0, 0xF),
    (offset::D3AMR, 0, 0x3129_DEA9),
    (offset::CRRCR, 0, 0),
];

/// State of RCC and the clock tree.
pub struct Rcc {
    oscillators: Oscillators,
    hse_fitted: bool,
    /// Time at which the main crystal stops, ns; `u64::MAX` for never.
    hse_stops_ns: u64,
    lse_fitted: bool,
    states: [State; 9],
    /// Registers below 0xD0, by offset / 4; CR without its ready bits, CFGR without SWS.
    registers: [u32; 0xD0 / 4],
    /// Source of the system clock, as in SWS.
    system_source: u32,
    latched_fraction: [u32; 3],
    flags: u32,
    /// RSR, enable and sleep enable registers of both cores.
    cores: [[u32; 24]; 2],
    backup_writable: bool,
    scale: VoltageScale,
    clocks: Clocks,
    /// Frequencies with exact crystals.
    nominal: Clocks,
    usb_hz: u64,
    reset: Vec<u32>,
    backup_reset: bool,
}

impl Rcc {
    /// Makes RCC in its power-on state, with these oscillators.
    #[must_use]
    pub fn new(oscillators: Oscillators) -> Self {
        let mut rcc = Self {
            oscillators,
            hse_fitted: true,
            hse_stops_ns: u64::MAX,
            lse_fitted: true,
            states: [State::Off; 9],
            registers: [0; 0xD0 / 4],
            system_source: 0,
            latched_fraction: [0; 3],
            flags: 0,
            cores: [[0; 24]; 2],
            backup_writable: false,
            scale: VoltageScale::Vos3,
            clocks: Clocks::default(),
            nominal: Clocks::default(),
            usb_hz: 0,
            reset: Vec::new(),
            backup_reset: false,
        };
        rcc.set_reset_values();
        rcc.note_reset(ResetCause::PowerOn);
        (rcc.clocks, rcc.usb_hz) = rcc.decode(&rcc.oscillators);
        (rcc.nominal, _) = rcc.decode(&Oscillators::default());
        rcc
    }

    /// Returns the present frequencies.
    #[must_use]
    pub fn clocks(&self) -> Clocks {
        self.clocks
    }

    /// Returns the frequencies that the registers give with exact oscillators; limits are judged by them.
    #[must_use]
    pub fn nominal_clocks(&self) -> Clocks {
        self.nominal
    }

    /// Returns the present kernel clock of the USB controllers, Hz.
    #[must_use]
    pub fn usb_hz(&self) -> u64 {
        self.usb_hz
    }

    /// Returns true if the block at a base address has its bus clock. Blocks without an enable bit always have it.
    #[must_use]
    pub fn is_enabled(&self, base: u32) -> bool {
        enable::bits_of(base).is_none_or(|(group, bits)| self.cores.iter().any(|core| core[1 + group] & bits != 0))
    }

    /// Takes the base addresses of the blocks that the program has reset since the last call; the caller resets them.
    pub fn take_resets(&mut self) -> Vec<u32> {
        std::mem::take(&mut self.reset)
    }

    /// Returns true if the program has reset the backup domain (BDCR.BDRST) since the last call.
    pub fn take_backup_reset(&mut self) -> bool {
        std::mem::take(&mut self.backup_reset)
    }

    /// Adds or removes the crystals: without one its ready bit is never set, and a removed one stops.
    pub fn fit_crystals(&mut self, hse: bool, lse: bool) {
        (self.hse_fitted, self.lse_fitted) = (hse, lse);
        for (oscillator, fitted) in [(Oscillator::Hse, hse), (Oscillator::Lse, lse)] {
            let state = &mut self.states[oscillator as usize];
            // HSERDY keeps its value: see the module comment.
            let told_ready = oscillator == Oscillator::Hse && *state == State::Ready;
            if !fitted && *state != State::Off && !told_ready {
                *state = State::Starting(u64::MAX);
            }
        }
    }

    /// Stops the main crystal at `at_ns`; it does not start again.
    pub fn stop_hse_at(&mut self, at_ns: u64) {
        self.hse_stops_ns = at_ns;
    }

    /// Returns true while HSE's crystal oscillates, which the ready flag may not show.
    fn hse_swings(&self) -> bool {
        self.hse_fitted && self.is_ready(Oscillator::Hse)
    }

    /// Changes the oscillators' frequencies: a crystal drifts. Dependent clocks follow at the next
    /// [`Peripheral::advance`].
    pub fn set_oscillators(&mut self, oscillators: Oscillators) {
        self.oscillators = oscillators;
    }

    /// Sets the write permission for BDCR, PWR_CR1.DBP.
    pub fn set_backup_writable(&mut self, writable: bool) {
        self.backup_writable = writable;
    }

    /// Sets the present core voltage; frequencies beyond its limits are reported.
    pub fn set_voltage_scale(&mut self, scale: VoltageScale, context: &mut Context<'_>) {
        if scale != self.scale {
            self.scale = scale;
            self.check_limits(context);
        }
    }

    /// Returns the core voltage set last.
    #[must_use]
    pub fn voltage_scale(&self) -> VoltageScale {
        self.scale
    }

    /// Records the cause of a reset of the chip in RCC_RSR (RM0399, 9.4.4, "Reset source identification"); flags of
    /// earlier resets stay until the program clears them.
    pub fn note_reset(&mut self, cause: ResetCause) {
        const CORES: u32 = 0b11 << 17;
        const DOMAINS: u32 = 0b11 << 19;
        const BROWN_OUT: u32 = 1 << 21;
        const PIN: u32 = 1 << 22;
        const POWER_ON: u32 = 1 << 23;
        const SOFTWARE_1: u32 = 1 << 24;
        const WATCHDOG_1: u32 = 1 << 26;
        let flags = CORES
            | PIN
            | match cause {
                ResetCause::PowerOn => DOMAINS | BROWN_OUT | POWER_ON,
                ResetCause::BrownOut => BROWN_OUT,
                ResetCause::Pin => 0,
                ResetCause::Software => SOFTWARE_1,
                ResetCause::Watchdog => WATCHDOG_1,
            };
        for core in &mut self.cores {
            core[0] = if cause == ResetCause::PowerOn { flags } else { core[0] | flags };
        }
    }

    /// Resets the backup domain, also after a loss of its power: clears LSE and RTC settings.
    pub fn reset_backup(&mut self) {
        *self.register_mut(offset::BDCR) = 0;
        self.states[Oscillator::Lse as usize] = State::Off;
    }

    fn set_reset_values(&mut self) {
        let backup = self.register(offset::BDCR);
        self.registers = [0; 0xD0 / 4];
        for (at, value, _) in PLAIN {
            *self.register_mut(at) = value;
        }
        *self.register_mut(offset::BDCR) = backup & !(1 << 16);
        *self.register_mut(offset::CR) = 1;
        *self.register_mut(offset::PLLCKSELR) = 0x0202_0200;
        *self.register_mut(offset::PLLCFGR) = 0x01FF_0000;
        for pll in 0..3 {
            *self.register_mut(offset::PLL1DIVR + 8 * pll) = 0x0101_0280;
        }
        let lse = self.states[Oscillator::Lse as usize];
        self.states = [State::Off; 9];
        self.states[Oscillator::Lse as usize] = lse;
        self.states[Oscillator::Hsi as usize] = State::Ready;
        (self.system_source, self.latched_fraction, self.flags) = (0, [0; 3], 0);
        for core in &mut self.cores {
            core[1..10].copy_from_slice(&enable::ENABLES_AT_RESET);
            core[11..20].copy_from_slice(&sleep_enables());
        }
    }

    fn register(&self, at: u32) -> u32 {
        self.registers[(at / 4) as usize]
    }

    fn register_mut(&mut self, at: u32) -> &mut u32 {
        &mut self.registers[(at / 4) as usize]
    }

    fn is_ready(&self, oscillator: Oscillator) -> bool {
        self.states[oscillator as usize] == State::Ready
    }

    /// Returns the core whose register is at an offset, and which of its 20: 0 is RSR, then nine enables and, from 11
    /// on, nine sleep enables.
    fn of_core(at: u32) -> Option<(usize, usize)> {
        let (core, from) = match at {
            offset::OF_CORE..offset::CORE_1 => (0, offset::OF_CORE),
            offset::CORE_1..offset::CORE_2 => (0, offset::CORE_1),
            offset::CORE_2..offset::END => (1, offset::CORE_2),
            _ => return None,
        };
        let index = ((at - from) / 4) as usize;
        matches!(index, 0..=9 | 11..=19).then_some((core, index))
    }

    fn value(&self, at: u32) -> Option<u32> {
        if let Some((core, index)) = Self::of_core(at) {
            return Some(self.cores[core][index]);
        }
        match at {
            offset::CR => {
                let ready = |oscillator: &Oscillator| match oscillator.bits() {
                    Some((_, ready)) if self.is_ready(*oscillator) => ready,
                    _ => 0,
                };
                // HSIDIVF, D1CKRDY and D2CKRDY are always set: the divider acts at once, and both domains run.
                const ALWAYS: u32 = 1 << 5 | 1 << 14 | 1 << 15;
                Some(self.register(at) | ALWAYS | Oscillator::ALL.iter().map(ready).fold(0, |all, bit| all | bit))
            }
            offset::CFGR => Some(self.register(at) | self.system_source << 3),
            offset::CIFR => Some(self.flags),
            offset::CICR => Some(0),
            offset::BDCR => Some(self.register(at) | u32::from(self.is_ready(Oscillator::Lse)) << 1),
            offset::CSR => Some(self.register(at) | u32::from(self.is_ready(Oscillator::Lsi)) << 1),
            offset::PLLCKSELR | offset::PLLCFGR => Some(self.register(at)),
            offset::PLL1DIVR..=offset::PLL3FRACR => Some(self.register(at)),
            offset::RESETS..offset::GCR => Some(self.register(at)),
            _ if PLAIN.iter().any(|(plain, ..)| *plain == at) => Some(self.register(at)),
            _ => None,
        }
    }

    fn start(&mut self, oscillator: Oscillator, now_ns: u64) {
        let missing = match oscillator {
            Oscillator::Hse => !self.hse_fitted,
            Oscillator::Lse => !self.lse_fitted,
            _ => false,
        };
        // A missing crystal starts but never becomes ready.
        let ready_ns = if missing { u64::MAX } else { now_ns + oscillator.start_up_ns() };
        self.states[oscillator as usize] = State::Starting(ready_ns);
    }

    /// Turns an oscillator on or off.
    fn switch(&mut self, oscillator: Oscillator, on: bool, now_ns: u64) {
        let state = self.states[oscillator as usize];
        match (on, state) {
            (true, State::Off) => self.start(oscillator, now_ns),
            (false, _) => self.states[oscillator as usize] = State::Off,
            (true, _) => {}
        }
    }

    fn write_cr(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        const WRITABLE: u32 = 0x150D_129B;
        let before = self.register(offset::CR);
        // Only a reset clears HSECSSON (RCC_CR).
        let mut value = value & (WRITABLE | HSECSSON) | before & HSECSSON;
        // The source of the core clock, and those of PLLs that are on, cannot be turned off.
        for (oscillator, number) in
            [(Oscillator::Hsi, 0), (Oscillator::Csi, 1), (Oscillator::Hse, 2), (Oscillator::Pll1, 3)]
        {
            let Some((on, _)) = oscillator.bits() else { continue };
            let by_core = self.system_source == number;
            let by_pll = self.pll_source() == Some(oscillator) && self.any_pll_on();
            if before & on != 0 && value & on == 0 && (by_core || by_pll) {
                context.misuse(
                    "RCC",
                    format!("{oscillator} is turned off while it is used; the chip keeps it on (RCC_CR)"),
                );
                value |= on;
            }
        }
        let divider = 0b11 << 3;
        if (before ^ value) & divider != 0 && self.pll_source() == Some(Oscillator::Hsi) && self.any_pll_on() {
            context.misuse("RCC", "HSIDIV is changed while a PLL runs on HSI; the chip ignores it (RCC_CR)");
            // The write of the other fields still takes effect.
            value = value & !divider | before & divider;
        }
        if (before ^ value) & 1 << 18 != 0 && before & 1 << 16 != 0 {
            context.misuse("RCC", "HSEBYP is changed while HSE is on; the chip ignores it (RCC_CR)");
            value ^= 1 << 18;
        }
        *self.register_mut(offset::CR) = value;
        for oscillator in Oscillator::ALL {
            let Some((on, _)) = oscillator.bits() else { continue };
            // HSIKERON keeps HSI on for peripherals.
            let on = value & on != 0 || oscillator == Oscillator::Hsi && value & 1 << 1 != 0;
            let starts = on && self.states[oscillator as usize] == State::Off;
            self.switch(oscillator, on, context.now_ns);
            let Some(pll) = Oscillator::PLLS.iter().position(|pll| *pll == oscillator) else { continue };
            if starts {
                self.start_pll(pll, context);
            }
        }
        Ok(())
    }

    fn start_pll(&mut self, index: usize, context: &mut Context<'_>) {
        for fault in self.pll_faults(index) {
            context.misuse("RCC", fault);
        }
        // The PLL latches its fraction when it is switched on.
        self.latched_fraction[index] = self.register(offset::PLL1FRACR + 8 * index as u32) >> 3;
        let runs = |source| if source == Oscillator::Hse { self.hse_swings() } else { self.is_ready(source) };
        if !self.pll_source().is_some_and(runs) {
            context.misuse(
                "RCC",
                format!("PLL{} is turned on while its source is not ready: it does not lock", index + 1),
            );
            // It never locks, and the program waits for its ready flag in vain.
            self.states[Oscillator::PLLS[index] as usize] = State::Starting(u64::MAX);
        }
    }

    fn is_on(&self, oscillator: Oscillator) -> bool {
        self.states[oscillator as usize] != State::Off
    }

    fn any_pll_on(&self) -> bool {
        Oscillator::PLLS.into_iter().any(|pll| self.is_on(pll))
    }

    /// Writes a register with locked fields; `locked` is their mask.
    fn write_locked(&mut self, at: u32, value: u32, locked: u32, name: &str, context: &mut Context<'_>) {
        let before = self.register(at);
        let refused = (before ^ value) & locked;
        if refused & value != 0 {
            context.misuse(
                "RCC",
                format!("{name}: bits {refused:#010x} are written while the PLL is on; the chip ignores them"),
            );
        }
        *self.register_mut(at) = before & locked | value & !locked;
    }

    fn write_pll(&mut self, at: u32, value: u32, context: &mut Context<'_>) {
        let on = Oscillator::PLLS.map(|pll| self.is_on(pll));
        // Each PLL that is on locks its own fields.
        let of_each = |mask: fn(usize) -> u32| (0..3).filter(|pll| on[*pll]).fold(0, |all, pll| all | mask(pll));
        match at {
            offset::PLLCKSELR => {
                // The source is common to the PLLs, so any one that is on locks it.
                let source = if on.contains(&true) { 0b11 } else { 0 };
                let locked = source | of_each(|pll| 0x3F << (4 + 8 * pll));
                self.write_locked(at, value & 0x03F3_F3F3, locked, "PLLCKSELR", context);
            }
            offset::PLLCFGR => {
                let locked = of_each(|pll| 0b1110 << (4 * pll) | 0b111 << (16 + 3 * pll));
                let before = self.register(at);
                self.write_locked(at, value & 0x01FF_0FFF, locked, "PLLCFGR", context);
                // A rising FRACEN latches the fraction, also while the PLL runs.
                for pll in 0..3 {
                    let latch = 1 << (4 * pll);
                    if before & latch == 0 && value & latch != 0 {
                        self.latched_fraction[pll] = self.register(offset::PLL1FRACR + 8 * pll as u32) >> 3;
                    }
                }
            }
            _ => {
                let pll = ((at - offset::PLL1DIVR) / 8) as usize;
                let locked = if on[pll] { u32::MAX } else { 0 };
                self.write_locked(at, value & 0x7F7F_FFFF, locked, "PLLxDIVR", context);
            }
        }
    }

    fn write_bdcr(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        const WRITABLE: u32 = 0x0001_831D;
        const LSECSSON: u32 = 1 << 5;
        const SELECT: u32 = 0b11 << 8;
        if !self.backup_writable {
            context.misuse("RCC", "BDCR is written while PWR_CR1.DBP is 0; the chip ignores it (RM0399, 7.4.4)");
            return Ok(());
        }
        if value & LSECSSON != 0 {
            return Err(Unmodelled { peripheral: "RCC", what: "clock security system of LSE (BDCR.LSECSSON)".into() });
        }
        let before = self.register(offset::BDCR);
        let mut value = value & WRITABLE;
        // BDRST: the reset counts once, at its rising edge, and holds the other bits at 0.
        if value & 1 << 16 != 0 {
            self.backup_reset |= before & 1 << 16 == 0;
            self.reset_backup();
            *self.register_mut(offset::BDCR) = 1 << 16;
            return Ok(());
        }
        if before & SELECT != 0 && (before ^ value) & SELECT != 0 {
            context.misuse(
                "RCC",
                "RTCSEL is changed without a reset of the backup domain; the chip ignores it (RCC_BDCR)",
            );
            value = value & !SELECT | before & SELECT;
        }
        *self.register_mut(offset::BDCR) = value;
        self.switch(Oscillator::Lse, value & 1 != 0, context.now_ns);
        Ok(())
    }

    fn write_of_core(&mut self, core: usize, index: usize, value: u32) {
        let register = &mut self.cores[core][index];
        match index {
            // RMVF removes all flags and reads as 0 afterwards.
            0 if value & 1 << 16 != 0 => *register = 0,
            0 => {}
            1..=9 => *register = value & enable::ENABLES[index - 1],
            _ => *register = value & sleep_enables()[index - 11],
        }
    }

    /// Switches the system clock to the source in SW, once that is ready.
    fn follow_switch(&mut self) {
        let wanted = self.register(offset::CFGR) & 7;
        let source = [Oscillator::Hsi, Oscillator::Csi, Oscillator::Hse, Oscillator::Pll1].get(wanted as usize);
        if source.is_some_and(|source| self.is_ready(*source)) {
            self.system_source = wanted;
        }
    }

    /// Handles the stop of the crystal, which the security system detects at once (RM0399, 9.5.3).
    fn follow_crystal(&mut self, context: &mut Context<'_>) {
        if self.hse_stops_ns <= context.now_ns {
            (self.hse_fitted, self.hse_stops_ns) = (false, u64::MAX);
        }
        let cr = self.register(offset::CR);
        // The detector works only while HSE is on and was ready.
        if cr & HSECSSON == 0 || !self.is_ready(Oscillator::Hse) || self.hse_fitted {
            return;
        }
        let mut off = HSEON;
        self.states[Oscillator::Hse as usize] = State::Off;
        if self.pll_source() == Some(Oscillator::Hse) {
            for pll in Oscillator::PLLS {
                off |= pll.bits().map_or(0, |(on, _)| on);
                self.states[pll as usize] = State::Off;
            }
        }
        *self.register_mut(offset::CR) = cr & !off;
        // If the core used HSE directly or through a PLL, the hardware writes HSION and SW (RCC_CR, RCC_CFGR). HSI
        // starts within microseconds, which the switch waits for.
        let source = [None, None, Some(Oscillator::Hse), Some(Oscillator::Pll1)];
        let lost = source.get(self.system_source as usize).copied().flatten();
        // A core that runs on HSI or CSI is not affected.
        if lost.is_some_and(|source| !self.is_ready(source)) {
            *self.register_mut(offset::CR) |= 1;
            *self.register_mut(offset::CFGR) &= !7;
            if self.states[Oscillator::Hsi as usize] == State::Off {
                self.start(Oscillator::Hsi, context.now_ns);
            }
        }
        self.flags |= HSECSSF;
        context.signals.push(Signal::Nmi { level: true });
    }

    fn settle(&mut self, context: &mut Context<'_>) {
        self.follow_crystal(context);
        for oscillator in Oscillator::ALL {
            let bit = 1 << oscillator as u32;
            if let State::Starting(ready_ns) = self.states[oscillator as usize]
                && ready_ns <= context.now_ns
            {
                self.states[oscillator as usize] = State::Ready;
                // The flag is set only with its interrupt enabled (RCC_CIFR).
                self.flags |= bit & self.register(offset::CIER);
            }
        }
        self.follow_switch();
        let (clocks, usb_hz) = self.decode(&self.oscillators);
        self.usb_hz = usb_hz;
        if clocks == self.clocks {
            return;
        }
        self.clocks = clocks;
        context.signals.push(Signal::Clocks);
        let (nominal, _) = self.decode(&Oscillators::default());
        let buses = |clocks: &Clocks| {
            let Clocks { core_hz, ahb_hz, apb1_hz, apb2_hz, apb3_hz, apb4_hz, .. } = *clocks;
            [core_hz, ahb_hz, apb1_hz, apb2_hz, apb3_hz, apb4_hz]
        };
        // Limits are checked again only if a bus clock has changed.
        let changed = buses(&nominal) != buses(&self.nominal);
        self.nominal = nominal;
        if changed {
            self.check_limits(context);
        }
    }

    /// Checks the limits with nominal frequencies: the limits allow for a crystal that runs fast within its tolerance.
    fn check_limits(&self, context: &mut Context<'_>) {
        if self.nominal.core_hz == 0 && self.hse_fitted {
            context.misuse("RCC", "the core's clock stops: its source gives none");
        }
        for fault in limits::too_fast(&self.nominal, self.scale) {
            context.misuse("RCC", fault);
        }
    }
}

fn sleep_enables() -> [u32; enable::GROUPS] {
    let mut bits = enable::ENABLES;
    // SRAM4 has no enable bit, only this one; the hardware semaphores have no bit here.
    bits[3] = bits[3] & !(1 << 25) | 1 << 29;
    bits
}

impl Peripheral for Rcc {
    fn read(&mut self, offset: u32, size: Size, context: &mut Context<'_>) -> Result<u32, Unmodelled> {
        self.advance(context);
        let value = self.value(offset & !3).ok_or_else(|| Unmodelled::register("RCC", offset))?;
        Ok(part(value, offset, size))
    }

    fn write(&mut self, offset: u32, size: Size, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        self.advance(context);
        let at = offset & !3;
        let value = merged(self.value(at).ok_or_else(|| Unmodelled::register("RCC", offset))?, offset, size, value);
        if let Some((core, index)) = Self::of_core(at) {
            self.write_of_core(core, index, value);
            return Ok(());
        }
        match at {
            offset::CR => self.write_cr(value, context)?,
            offset::PLLCKSELR | offset::PLLCFGR => self.write_pll(at, value, context),
            offset::PLL1DIVR..offset::PLL3FRACR if (at - offset::PLL1DIVR).is_multiple_of(8) => {
                self.write_pll(at, value, context)
            }
            offset::CIFR | offset::CRRCR => {}
            offset::CICR => {
                let raised = self.flags & self.register(offset::CIER) != 0;
                if value & self.flags & HSECSSF != 0 {
                    context.signals.push(Signal::Nmi { level: false });
                }
                self.flags &= !value;
                if raised {
                    context.irq(IRQ, self.flags & self.register(offset::CIER) != 0);
                }
            }
            offset::BDCR => self.write_bdcr(value, context)?,
            offset::CSR => {
                *self.register_mut(at) = value & 1;
                self.switch(Oscillator::Lsi, value & 1 != 0, context.now_ns);
            }
            offset::RESETS..offset::GCR => {
                let group = ((at - offset::RESETS) / 4) as usize;
                let value = value & enable::RESETS[group];
                let rising = value & !self.register(at);
                self.reset.extend(enable::bases_of(group, rising));
                *self.register_mut(at) = value;
            }
            offset::GCR if value & 0b1000 != 0 => {
                return Err(Unmodelled { peripheral: "RCC", what: "the Cortex-M4 (GCR.BOOT_C2)".into() });
            }
            offset::CFGR if value & (MCO1PRE | MCO2PRE) != 0 => {
                return Err(Unmodelled { peripheral: "RCC", what: "clock outputs (CFGR.MCO1PRE, MCO2PRE)".into() });
            }
            offset::CFGR if value & HRTIMSEL != 0 => {
                return Err(Unmodelled {
                    peripheral: "RCC",
                    what: "the high-resolution timer's clock (CFGR.HRTIMSEL)".into(),
                });
            }
            _ => {
                let mask = PLAIN.iter().find(|(plain, ..)| *plain == at).map_or(0, |(.., mask)| *mask);
                *self.register_mut(at) = value & mask;
                if at == offset::CFGR {
                    self.check_switch(context);
                }
            }
        }
        self.settle(context);
        Ok(())
    }

    fn next_event_ns(&self) -> u64 {
        let starting = |state: &State| if let State::Starting(ready_ns) = state { *ready_ns } else { u64::MAX };
        self.states.iter().map(starting).min().unwrap_or(u64::MAX).min(self.hse_stops_ns)
    }

    fn stable_until_ns(&self, _: u32, _: u64) -> Option<u64> {
        Some(self.next_event_ns())
    }

    fn advance(&mut self, context: &mut Context<'_>) {
        let raised = self.flags & self.register(offset::CIER) != 0;
        self.settle(context);
        if !raised && self.flags & self.register(offset::CIER) != 0 {
            context.irq(IRQ, true);
        }
    }

    /// Resets the chip's RCC, except the backup domain, the reset flags (see [`Rcc::note_reset`]) and the state of the
    /// crystals.
    fn reset(&mut self, context: &mut Context<'_>) {
        self.set_reset_values();
        self.reset.clear();
        self.scale = VoltageScale::Vos3;
        self.backup_writable = false;
        context.irq(IRQ, false);
        context.signals.push(Signal::Nmi { level: false });
        self.settle(context);
    }
}

impl Rcc {
    fn check_switch(&self, context: &mut Context<'_>) {
        let wanted = self.register(offset::CFGR) & 7;
        match [Oscillator::Hsi, Oscillator::Csi, Oscillator::Hse, Oscillator::Pll1].get(wanted as usize) {
            Some(source) if self.is_ready(*source) => {}
            Some(source) => {
                context.misuse("RCC", format!("SW chooses {source}, which is not ready: the switch waits for it"))
            }
            None => context.misuse("RCC", format!("SW = {wanted} is reserved (RCC_CFGR)")),
        }
    }
}
