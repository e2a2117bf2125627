//! Power control (RM0399, 7) of a chip wired for its LDO, as on the Arduino Giga R1.
//!
//! The supply configuration (the low byte of CR3) can be written once after power-on; until then VCORE is not reported
//! as valid. Anything but the LDO alone would leave the Giga's core without supply, out of reach of a debugger until
//! its power is cut: it ends the run. Scale 0 is scale 1 with the overdrive of SYSCFG_PWRCR.
//!
//! A change of the scale takes 20 µs. The manual gives no time; the value only forces programs to wait.
//!
//! **Supply.** The 3.3 V supply at VDD follows a list of changes ([`Pwr::supply_at`]). Below the brown-out level of the
//! option bytes the chip is held in reset, until 377 µs after the supply is back above it. Below 1.62 V it is a
//! power-on reset, in which RAM and everything without a battery is lost. The programmable voltage detector (CR1.PVDEN,
//! PLS) compares with a hysteresis of 100 mV and drives EXTI line 16. Thresholds are the typical ones of DS12930,
//! "Reset and power control block characteristics" (recalled, not looked up).
//!
//! Low-power modes, the analog voltage detector (enabling it ends the run) and the monitors of battery and temperature
//! are not modelled: settings of the latter are stored without effect.

use std::{collections::VecDeque, fmt};

use crate::{
    Context, Peripheral, ResetCause, Signal, Size, Unmodelled,
    peripherals::access::{merged, part},
};

/// Voltage scale of the core, from the highest to the lowest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum VoltageScale {
    /// Core clock up to 480 MHz: scale 1 and overdrive.
    Vos0,
    /// Core clock up to 400 MHz.
    Vos1,
    /// Core clock up to 300 MHz.
    Vos2,
    /// Core clock up to 200 MHz; the scale after reset.
    Vos3,
}

impl fmt::Display for VoltageScale {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Vos0 => "VOS0",
            Self::Vos1 => "VOS1",
            Self::Vos2 => "VOS2",
            Self::Vos3 => "VOS3",
        })
    }
}

const CR1: u32 = 0x00;
const CSR1: u32 = 0x04;
const CR2: u32 = 0x08;
const CR3: u32 = 0x0C;
const CPUCR: u32 = 0x10;
const CPU2CR: u32 = 0x14;
const D3CR: u32 = 0x18;

/// Bit of CR1: write access to the backup domain.
const DBP: u32 = 1 << 8;
/// Supply field of CR3: BYPASS, LDOEN, SMPSEN, SMPSEXTHP, SMPSLEVEL.
const SUPPLY: u32 = 0x3F;
const LDO_ONLY: u32 = 1 << 1;
const SUPPLY_AT_RESET: u32 = 0b110;
const USB33DEN: u32 = 1 << 24;

const SETTLE_NS: u64 = 20_000;

/// Bits of CR1 and CSR1 for the voltage detectors.
const PVDEN: u32 = 1 << 4;
const AVDEN: u32 = 1 << 16;
const PVDO: u32 = 1 << 4;
/// EXTI line of the voltage detectors.
const PVD_LINE: u8 = 16;
/// Rising thresholds of the detector by PLS, mV; code 7 compares a pin (PWR_CR1).
const PVD_RISING_MV: [u32; 7] = [1950, 2100, 2250, 2400, 2550, 2700, 2850];
const PVD_HYSTERESIS_MV: u32 = 100;
/// Falling and rising thresholds of the brown-out reset by BOR_LEV, mV; level 0 is the power-on and power-down reset
/// alone.
const BROWN_OUT_MV: [(u32, u32); 4] = [(1620, 1670), (2000, 2100), (2310, 2410), (2610, 2700)];
/// Duration of the reset after the supply is back, ns.
const RESET_NS: u64 = 377_000;
/// Supply voltage of a healthy board, mV.
pub const NOMINAL_MV: u32 = 3300;

/// State of power control and supply.
pub struct Pwr {
    cr1: u32,
    cr2: u32,
    cr3: u32,
    supply_written: bool,
    cpucr: u32,
    cpu2cr: u32,
    /// Field D3CR.VOS, the requested scale.
    vos: u32,
    overdrive: bool,
    /// Scale before the present change.
    from: VoltageScale,
    /// End of the present change of the scale, ns.
    settled_ns: u64,
    /// The end of the change was handled.
    seen: bool,
    supply: Supply,
    /// Detector output PVDO: the supply is low.
    low: bool,
    /// Brown-out level of the option bytes, BOR_LEV.
    brown_out_level: u8,
}

/// Supply voltage VDD, with the state that depends on it alone.
#[derive(Clone, Debug)]
struct Supply {
    now_mv: u32,
    /// Future changes of VDD in order of time: ns, mV.
    changes: VecDeque<(u64, u32)>,
    /// End of the reset by the supply, ns; `u64::MAX` while the supply is too low; `None` without a reset.
    held_until_ns: Option<u64>,
    /// VDD fell below the power-down threshold since the last check.
    lost: bool,
}

impl Default for Pwr {
    fn default() -> Self {
        Self::new()
    }
}

impl Pwr {
    /// Makes the state after power-on.
    #[must_use]
    pub fn new() -> Self {
        Self {
            cr1: 0xF000_C000,
            cr2: 0,
            cr3: SUPPLY_AT_RESET,
            supply_written: false,
            cpucr: 0,
            cpu2cr: 0,
            vos: 1,
            overdrive: false,
            from: VoltageScale::Vos3,
            settled_ns: 0,
            seen: true,
            supply: Supply { now_mv: NOMINAL_MV, changes: VecDeque::new(), held_until_ns: None, lost: false },
            low: false,
            brown_out_level: 0,
        }
    }

    /// Sets VDD from `at_ns` on, mV. Calls must be in order of time: pending changes later than this one are dropped.
    pub fn supply_at(&mut self, at_ns: u64, millivolts: u32) {
        self.supply.changes.retain(|(other_ns, _)| *other_ns < at_ns);
        self.supply.changes.push_back((at_ns, millivolts));
    }

    /// Returns the present supply voltage VDD, mV.
    #[must_use]
    pub fn supply_mv(&self) -> u32 {
        self.supply.now_mv
    }

    /// Returns true while the supply holds the chip in reset.
    #[must_use]
    pub fn is_held(&self) -> bool {
        self.supply.held_until_ns.is_some()
    }

    /// Returns true if VDD fell so low since the last call that RAM lost its content.
    pub fn take_power_loss(&mut self) -> bool {
        std::mem::take(&mut self.supply.lost)
    }

    /// Resets what a loss of power clears: the supply configuration and CR2 too.
    pub fn power_on(&mut self) {
        let (supply, brown_out_level) = (self.supply.clone(), self.brown_out_level);
        *self = Self { supply, brown_out_level, ..Self::new() };
    }

    /// Sets BOR_LEV of the option bytes, 0 to 3.
    pub fn set_brown_out_level(&mut self, level: u8) {
        self.brown_out_level = level & 3;
    }

    fn follow_supply(&mut self, context: &mut Context<'_>) {
        while let Some((_, millivolts)) = self.supply.changes.pop_front_if(|(at_ns, _)| *at_ns <= context.now_ns) {
            self.supply.now_mv = millivolts;
            let (falling, rising) = BROWN_OUT_MV[usize::from(self.brown_out_level)];
            // The power-on threshold comes first: below it RAM is lost as well, whatever BOR_LEV is.
            if millivolts < BROWN_OUT_MV[0].0 && !self.supply.lost {
                (self.supply.held_until_ns, self.supply.lost) = (Some(u64::MAX), true);
                context.signals.push(Signal::Reset(ResetCause::PowerOn));
            } else if millivolts < falling && self.supply.held_until_ns != Some(u64::MAX) {
                if self.supply.held_until_ns.is_none() {
                    context.signals.push(Signal::Reset(ResetCause::BrownOut));
                }
                self.supply.held_until_ns = Some(u64::MAX);
            } else if millivolts >= rising && self.supply.held_until_ns == Some(u64::MAX) {
                self.supply.held_until_ns = Some(context.now_ns + RESET_NS);
            }
        }
        self.supply.held_until_ns = self.supply.held_until_ns.filter(|until_ns| *until_ns > context.now_ns);
        self.compare(context);
    }

    /// Updates the voltage detector.
    fn compare(&mut self, context: &mut Context<'_>) {
        let rising = PVD_RISING_MV.get((self.cr1 >> 5 & 7) as usize).copied().filter(|_| self.cr1 & PVDEN != 0);
        // The hysteresis: a low supply must reach the rising threshold, a good one fall below the lower threshold.
        let threshold = rising.map(|rising| if self.low { rising } else { rising - PVD_HYSTERESIS_MV });
        let low = threshold.is_some_and(|threshold| self.supply.now_mv < threshold);
        if low != self.low {
            self.low = low;
            context.signals.push(Signal::Exti { line: PVD_LINE, high: low });
        }
    }

    /// Returns the scale that the core can rely on at `now_ns`: during a change, the lower of the two.
    #[must_use]
    pub fn scale(&self, now_ns: u64) -> VoltageScale {
        let target = self.target();
        // A larger `VoltageScale` is a lower voltage.
        if now_ns >= self.settled_ns { target } else { target.max(self.from) }
    }

    /// Returns true if the backup domain is writable (CR1.DBP).
    #[must_use]
    pub fn backup_writable(&self) -> bool {
        self.cr1 & DBP != 0
    }

    /// Returns true if the USB transceiver has its supply (CR3.USB33DEN; its pin always has 3.3 V).
    #[must_use]
    pub fn usb_supplied(&self) -> bool {
        self.cr3 & USB33DEN != 0
    }

    /// Takes the present value of SYSCFG_PWRCR.ODEN.
    pub fn set_overdrive(&mut self, on: bool, context: &mut Context<'_>) {
        if on == self.overdrive {
            return;
        }
        if on && (self.scale(context.now_ns) != VoltageScale::Vos1) {
            context.misuse("PWR", "overdrive without scale 1 being reached before (RM0399, 7.6.2)");
        }
        self.change(context.now_ns, |pwr| pwr.overdrive = on);
    }

    fn target(&self) -> VoltageScale {
        match (self.vos, self.overdrive) {
            (3, true) => VoltageScale::Vos0,
            (3, false) => VoltageScale::Vos1,
            (2, _) => VoltageScale::Vos2,
            _ => VoltageScale::Vos3,
        }
    }

    fn change(&mut self, now_ns: u64, setting: impl FnOnce(&mut Self)) {
        let before = self.scale(now_ns);
        setting(self);
        if self.target() != before {
            (self.from, self.settled_ns, self.seen) = (before, now_ns + SETTLE_NS, false);
        }
    }

    fn value(&self, at: u32, now_ns: u64) -> Option<u32> {
        let settled = u32::from(self.supply_written && now_ns >= self.settled_ns);
        let brought = |at: u32| if self.cr2 & 1 != 0 { at } else { 0 };
        match at {
            CR1 => Some(self.cr1),
            CSR1 => {
                let actual = match self.scale(now_ns) {
                    VoltageScale::Vos0 | VoltageScale::Vos1 => 3,
                    VoltageScale::Vos2 => 2,
                    VoltageScale::Vos3 => 1,
                };
                Some(settled << 13 | actual << 14 | if self.low { PVDO } else { 0 })
            }
            // BRRDY equals BREN, without delay.
            CR2 => Some(self.cr2 | brought(1 << 16)),
            // USB33RDY is set while USB33DEN is, because the supply is always present.
            CR3 => Some(self.cr3 | (self.cr3 & USB33DEN) << 2),
            CPUCR => Some(self.cpucr),
            CPU2CR => Some(self.cpu2cr),
            D3CR => Some(settled << 13 | self.vos << 14),
            _ => None,
        }
    }

    fn write_supply(&mut self, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        if self.supply_written {
            if (value ^ self.cr3) & SUPPLY != 0 {
                context
                    .misuse("PWR", "the supply configuration is changed a second time; the chip ignores it (PWR_CR3)");
            }
        } else if value & SUPPLY & 0b111 == LDO_ONLY {
            self.cr3 = self.cr3 & !SUPPLY | value & SUPPLY;
            (self.supply_written, self.settled_ns) = (true, context.now_ns + SETTLE_NS);
        } else {
            let what = format!(
                "supply configuration {:#04x} is not the LDO alone: this bricks a Giga until its power is cut",
                value & SUPPLY
            );
            return Err(Unmodelled { peripheral: "PWR", what });
        }
        Ok(())
    }
}

impl Peripheral for Pwr {
    fn read(&mut self, offset: u32, size: Size, context: &mut Context<'_>) -> Result<u32, Unmodelled> {
        let value = self.value(offset & !3, context.now_ns).ok_or_else(|| Unmodelled::register("PWR", offset))?;
        Ok(part(value, offset, size))
    }

    fn write(&mut self, offset: u32, size: Size, value: u32, context: &mut Context<'_>) -> Result<(), Unmodelled> {
        let before = self.value(offset & !3, context.now_ns).ok_or_else(|| Unmodelled::register("PWR", offset))?;
        let value = merged(before, offset, size, value);
        match offset & !3 {
            CR1 if value & AVDEN != 0 => {
                return Err(Unmodelled { peripheral: "PWR", what: "the analog voltage detector (CR1.AVDEN)".into() });
            }
            CR1 if value & PVDEN != 0 && value >> 5 & 7 == 7 => {
                return Err(Unmodelled { peripheral: "PWR", what: "the detector's own pin (CR1.PLS = 7)".into() });
            }
            CR1 => {
                self.cr1 = value & 0x0007_C3F1 | 0xF000_0000;
                self.compare(context);
            }
            CR2 if !self.backup_writable() => {
                context.misuse("PWR", "CR2 is written while CR1.DBP is 0; the chip ignores it (PWR_CR2)");
            }
            CR2 => self.cr2 = value & 0b1_0001,
            CR3 => {
                // A byte or half-word write above the supply's byte does not write the supply.
                if offset & 3 == 0 {
                    self.write_supply(value, context)?;
                }
                const OTHERS: u32 = 0x0300_0300;
                self.cr3 = self.cr3 & !OTHERS | value & OTHERS;
            }
            // CSSF clears the flags of Stop and Standby, which are never set; it reads as 0.
            CPUCR => self.cpucr = value & 0x0000_0C07,
            CPU2CR => self.cpu2cr = value & 0x0000_0C07,
            D3CR => {
                let vos = value >> 14 & 3;
                if vos != self.vos && !self.supply_written {
                    context.misuse("PWR", "D3CR.VOS is changed before the supply is configured (RM0399, 7.6.1)");
                }
                if vos != 3 && self.overdrive {
                    context.misuse("PWR", "the scale is lowered with the overdrive on (RM0399, 7.6.2)");
                }
                self.change(context.now_ns, |pwr| pwr.vos = vos);
            }
            _ => {}
        }
        Ok(())
    }

    /// Returns the time of the next change of voltage, ns: the limits of clocks and flash change then.
    fn next_event_ns(&self) -> u64 {
        let settled_ns = if self.seen { u64::MAX } else { self.settled_ns };
        let change_ns = self.supply.changes.front().map_or(u64::MAX, |(at_ns, _)| *at_ns);
        settled_ns.min(change_ns).min(self.supply.held_until_ns.unwrap_or(u64::MAX))
    }

    fn stable_until_ns(&self, _: u32, now_ns: u64) -> Option<u64> {
        // The first settling of the supply is not an event.
        let settled_ns = if now_ns < self.settled_ns { self.settled_ns } else { u64::MAX };
        Some(self.next_event_ns().min(settled_ns))
    }

    fn advance(&mut self, context: &mut Context<'_>) {
        self.seen |= context.now_ns >= self.settled_ns;
        self.follow_supply(context);
    }

    /// Resets the chip's power control. The supply configuration and CR2 survive.
    fn reset(&mut self, context: &mut Context<'_>) {
        let kept = (self.cr2, self.cr3, self.supply_written);
        let (supply, brown_out_level) = (self.supply.clone(), self.brown_out_level);
        *self = Self { supply, brown_out_level, ..Self::new() };
        (self.cr2, self.cr3, self.supply_written) = (kept.0, SUPPLY_AT_RESET & !SUPPLY | kept.1 & SUPPLY, kept.2);
        self.settled_ns = context.now_ns;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::Bench;

    fn supplied() -> (Pwr, Bench) {
        let (mut pwr, mut bench) = (Pwr::new(), Bench::default());
        bench.write(&mut pwr, CR3, LDO_ONLY);
        bench.now_ns += SETTLE_NS;
        (pwr, bench)
    }

    #[test]
    fn the_voltage_is_valid_only_after_the_supply_was_chosen() {
        let (mut pwr, mut bench) = (Pwr::new(), Bench::default());
        bench.now_ns = 1_000_000_000;
        assert_eq!(bench.read(&mut pwr, CSR1), 1 << 14, "scale 3, not ready");
        bench.modify(&mut pwr, CR3, 0b101, 0b010);
        assert_eq!(bench.read(&mut pwr, CSR1) >> 13 & 1, 0);
        bench.now_ns += SETTLE_NS;
        assert_eq!(bench.read(&mut pwr, CSR1) >> 13 & 1, 1);
        bench.assert_no_misuse();
    }

    #[test]
    fn a_supply_that_bricks_a_giga_ends_the_run() {
        // Cases of RM0399, table "Supply configuration control": SMPS alone, SMPS for the LDO, both at once as after
        // reset, bypass.
        for supply in [0b100, 0b1_0110, 0b110, 0b001] {
            let (mut pwr, mut bench) = (Pwr::new(), Bench::default());
            let error = bench.try_write(&mut pwr, CR3, Size::Word, supply).unwrap_err();
            assert!(error.to_string().contains("bricks a Giga"), "{error}");
        }
    }

    #[test]
    fn the_supply_is_chosen_once_per_power_on() {
        let (mut pwr, mut bench) = supplied();
        bench.write(&mut pwr, CR3, 0b100);
        assert_eq!(bench.read(&mut pwr, CR3) & SUPPLY, LDO_ONLY);
        assert_eq!(bench.take_misuse().len(), 1);
        pwr.reset(&mut bench.context());
        assert_eq!(bench.read(&mut pwr, CR3) & SUPPLY, LDO_ONLY);
        assert_eq!(bench.read(&mut pwr, CSR1) >> 13 & 1, 1, "still valid after a reset of the chip");
    }

    #[test]
    fn scale_0_is_reached_through_scale_1_and_overdrive() {
        let (mut pwr, mut bench) = supplied();
        bench.modify(&mut pwr, D3CR, 0b11 << 14, 0b11 << 14);
        assert_eq!(bench.read(&mut pwr, D3CR) >> 13, 0b110, "asked for, not there");
        assert_eq!(pwr.scale(bench.now_ns), VoltageScale::Vos3);
        bench.now_ns += SETTLE_NS;
        assert_eq!(bench.read(&mut pwr, D3CR) >> 13, 0b111);
        assert_eq!(pwr.scale(bench.now_ns), VoltageScale::Vos1);
        pwr.set_overdrive(true, &mut bench.context());
        assert_eq!(pwr.scale(bench.now_ns), VoltageScale::Vos1);
        assert_eq!(pwr.next_event_ns(), bench.now_ns + SETTLE_NS);
        bench.run(&mut pwr, bench.now_ns + SETTLE_NS);
        assert_eq!(pwr.scale(bench.now_ns), VoltageScale::Vos0);
        bench.assert_no_misuse();
    }

    const EVENT: fn(bool) -> Signal = |high| Signal::Exti { line: 16, high };

    #[test]
    fn the_detector_tells_a_falling_supply_and_its_return_with_hysteresis() {
        let (mut pwr, mut bench) = supplied();
        let start_ns = bench.now_ns;
        // PLS 5: 2.7 V rising, 2.6 V falling.
        bench.write(&mut pwr, CR1, 5 << 5 | PVDEN);
        for (ms, millivolts) in [(1, 2_650), (2, 2_599), (3, 2_690), (4, 2_700)] {
            pwr.supply_at(start_ns + ms * 1_000_000, millivolts);
        }
        bench.run(&mut pwr, start_ns + 1_500_000);
        assert_eq!((bench.read(&mut pwr, CSR1) & PVDO, bench.take_signals()), (0, vec![]));
        bench.run(&mut pwr, start_ns + 2_000_000);
        assert_eq!((bench.read(&mut pwr, CSR1) & PVDO, bench.take_signals()), (PVDO, vec![EVENT(true)]));
        bench.run(&mut pwr, start_ns + 3_500_000);
        assert_eq!(bench.take_signals(), []);
        bench.run(&mut pwr, start_ns + 4_000_000);
        assert_eq!((bench.read(&mut pwr, CSR1) & PVDO, bench.take_signals()), (0, vec![EVENT(false)]));
    }

    #[test]
    fn a_detector_that_is_turned_on_too_late_tells_at_once_and_one_that_is_off_never() {
        let (mut pwr, mut bench) = supplied();
        pwr.supply_at(bench.now_ns, 2_000);
        bench.run(&mut pwr, bench.now_ns + 1);
        assert_eq!((bench.read(&mut pwr, CSR1) & PVDO, bench.take_signals()), (0, vec![]));
        bench.write(&mut pwr, CR1, 5 << 5 | PVDEN);
        assert_eq!(bench.take_signals(), [EVENT(true)]);
        for refused in [7 << 5 | PVDEN, AVDEN] {
            assert!(bench.try_write(&mut pwr, CR1, Size::Word, refused).is_err());
        }
    }

    #[test]
    fn a_supply_below_the_level_of_the_option_bytes_holds_the_chip_in_reset_until_it_is_back() {
        for (level, falling_mv, rising_mv) in [(1, 2_000, 2_100), (2, 2_310, 2_410), (3, 2_610, 2_700)] {
            let (mut pwr, mut bench) = supplied();
            pwr.set_brown_out_level(level);
            pwr.supply_at(bench.now_ns + 1_000, falling_mv);
            pwr.supply_at(bench.now_ns + 2_000, falling_mv - 1);
            pwr.supply_at(bench.now_ns + 3_000, rising_mv - 1);
            pwr.supply_at(bench.now_ns + 4_000, rising_mv);
            let start_ns = bench.now_ns;
            bench.run(&mut pwr, start_ns + 1_999);
            assert!(!pwr.is_held());
            bench.run(&mut pwr, start_ns + 2_000);
            assert_eq!(bench.take_signals(), [Signal::Reset(ResetCause::BrownOut)]);
            // In this test the reset is carried out by hand, as the machine would.
            pwr.reset(&mut bench.context());
            bench.run(&mut pwr, start_ns + 4_000 + RESET_NS - 1);
            assert!(pwr.is_held());
            bench.run(&mut pwr, start_ns + 4_000 + RESET_NS);
            assert!(!pwr.is_held() && !pwr.take_power_loss());
            assert_eq!(bench.take_signals(), []);
        }
    }

    #[test]
    fn a_supply_that_goes_altogether_is_a_power_on_and_loses_everything() {
        let (mut pwr, mut bench) = supplied();
        pwr.set_brown_out_level(3);
        pwr.supply_at(bench.now_ns + 1_000, 2_500);
        pwr.supply_at(bench.now_ns + 2_000, 1_619);
        pwr.supply_at(bench.now_ns + 3_000, NOMINAL_MV);
        bench.run(&mut pwr, bench.now_ns + 3_000 + RESET_NS);
        assert_eq!(bench.take_signals(), [ResetCause::BrownOut, ResetCause::PowerOn].map(Signal::Reset));
        assert!(!pwr.is_held() && pwr.take_power_loss());
        pwr.power_on();
        assert_eq!(bench.read(&mut pwr, CR3) & SUPPLY, SUPPLY_AT_RESET, "to be configured again");
    }

    #[test]
    fn overdrive_too_early_and_lowering_under_overdrive_are_misuse() {
        let (mut pwr, mut bench) = supplied();
        pwr.set_overdrive(true, &mut bench.context());
        assert_eq!(bench.take_misuse().len(), 1);
        bench.write(&mut pwr, D3CR, 0b10 << 14);
        assert_eq!(bench.take_misuse().len(), 1);
    }

    #[test]
    fn usb_supply_is_ready_where_it_is_watched() {
        let (mut pwr, mut bench) = supplied();
        assert_eq!(bench.read(&mut pwr, CR3) >> 26 & 1, 0);
        bench.modify(&mut pwr, CR3, 0, USB33DEN);
        assert_eq!(bench.read(&mut pwr, CR3) >> 26 & 1, 1);
        assert!(pwr.usb_supplied());
        bench.assert_no_misuse();
    }

    #[test]
    fn the_backup_domain_is_writable_with_dbp() {
        let (mut pwr, mut bench) = supplied();
        assert!(!pwr.backup_writable());
        bench.write(&mut pwr, CR2, 1);
        assert_eq!(bench.take_misuse().len(), 1);
        bench.modify(&mut pwr, CR1, 0, DBP);
        assert!(pwr.backup_writable());
        bench.write(&mut pwr, CR2, 1);
        assert_eq!(bench.read(&mut pwr, CR2), 1 << 16 | 1);
    }
}
