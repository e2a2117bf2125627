//! Power control (RM0399, 7) of a chip that is wired for its LDO, as on the Arduino Giga R1.
//!
//! The supply configuration (the low byte of CR3) can be written once after power-on; until then VCORE is not said to be
//! valid. Anything but the LDO alone would leave the Giga's core without supply, out of reach of a debugger until its
//! power is cut: it ends the run. Scale 0 is scale 1 with the overdrive of SYSCFG_PWRCR.
//!
//! A change of the scale takes 20 µs. The manual gives no time; this is only so that a program has to wait.
//! Low-power modes, voltage detectors and the monitors of battery and temperature are not modelled: their settings are
//! kept, and nothing comes of them. Turning on a detector ends the run.

use crate::{
    Context, Peripheral, Size, Unmodelled,
    peripherals::access::{merged, part},
};

/// Core voltage, from the highest to the lowest.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum VoltageScale {
    /// Up to 480 MHz: scale 1 and overdrive.
    Vos0,
    /// Up to 400 MHz.
    Vos1,
    /// Up to 300 MHz.
    Vos2,
    /// Up to 200 MHz, after reset.
    Vos3,
}

const CR1: u32 = 0x00;
const CSR1: u32 = 0x04;
const CR2: u32 = 0x08;
const CR3: u32 = 0x0C;
const CPUCR: u32 = 0x10;
const CPU2CR: u32 = 0x14;
const D3CR: u32 = 0x18;

/// CR1.
const DBP: u32 = 1 << 8;
/// CR3: BYPASS, LDOEN, SMPSEN, SMPSEXTHP, SMPSLEVEL.
const SUPPLY: u32 = 0x3F;
const LDO_ONLY: u32 = 1 << 1;
const SUPPLY_AT_RESET: u32 = 0b110;
const USB33DEN: u32 = 1 << 24;

const SETTLE_NS: u64 = 20_000;

/// PWR.
pub struct Pwr {
    cr1: u32,
    cr2: u32,
    cr3: u32,
    supply_written: bool,
    cpucr: u32,
    cpu2cr: u32,
    /// D3CR.VOS.
    vos: u32,
    overdrive: bool,
    /// What the regulator gave before.
    from: VoltageScale,
    /// When it gives what is asked for.
    settled_ns: u64,
    /// Advanced since then.
    seen: bool,
}

impl Default for Pwr {
    fn default() -> Self {
        Self::new()
    }
}

impl Pwr {
    /// After power-on.
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
        }
    }

    /// The scale that the core can rely on at `now_ns`: during a change, the lower of the two.
    #[must_use]
    pub fn scale(&self, now_ns: u64) -> VoltageScale {
        let target = self.target();
        if now_ns >= self.settled_ns { target } else { target.max(self.from) }
    }

    /// Whether the backup domain can be written (CR1.DBP).
    #[must_use]
    pub fn backup_writable(&self) -> bool {
        self.cr1 & DBP != 0
    }

    /// Whether the USB transceiver has its supply (CR3.USB33DEN; 3.3 V are always on its pin).
    #[must_use]
    pub fn usb_supplied(&self) -> bool {
        self.cr3 & USB33DEN != 0
    }

    /// SYSCFG_PWRCR.ODEN, as it was written.
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
                Some(settled << 13 | actual << 14)
            }
            // BRRDY follows BREN.
            CR2 => Some(self.cr2 | brought(1 << 16)),
            // USB33RDY: the supply is there, and is looked at while USB33DEN is set.
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
            CR1 if value & (1 << 4 | 1 << 16) != 0 => {
                return Err(Unmodelled { peripheral: "PWR", what: "voltage detectors (CR1.PVDEN, AVDEN)".into() });
            }
            CR1 => self.cr1 = value & 0x0007_C3F1 | 0xF000_0000,
            CR2 if !self.backup_writable() => {
                context.misuse("PWR", "CR2 is written while CR1.DBP is 0; the chip ignores it (PWR_CR2)");
            }
            CR2 => self.cr2 = value & 0b1_0001,
            CR3 => {
                // A byte or half-word above the supply's is no write of the supply.
                if offset & 3 == 0 {
                    self.write_supply(value, context)?;
                }
                const OTHERS: u32 = 0x0300_0300;
                self.cr3 = self.cr3 & !OTHERS | value & OTHERS;
            }
            // CSSF removes the flags of Stop and Standby, which are never set, and reads as 0.
            CPUCR => self.cpucr = value & 0x0000_0807,
            CPU2CR => self.cpu2cr = value & 0x0000_0807,
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

    /// When the voltage arrives: the limits of clocks and flash are others from then on.
    fn next_event_ns(&self) -> u64 {
        if self.seen { u64::MAX } else { self.settled_ns }
    }

    fn advance(&mut self, context: &mut Context<'_>) {
        self.seen |= context.now_ns >= self.settled_ns;
    }

    /// A reset of the chip. The supply configuration and CR2 outlive it.
    fn reset(&mut self, context: &mut Context<'_>) {
        let kept = (self.cr2, self.cr3, self.supply_written);
        *self = Self::new();
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
        // SMPS alone, SMPS for the LDO, both at once as after reset, bypass: RM0399, table "Supply configuration control".
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
