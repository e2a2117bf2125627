//! Direct wires between RCC, PWR, SYSCFG, the flash and the backup registers.

use crate::{
    Context,
    peripherals::{
        backup::Backup,
        flash::{Flash, FlashCells},
        pwr::Pwr,
        rcc::Rcc,
        syscfg::Syscfg,
    },
};

/// Blocks that are wired to each other.
pub struct Wired<'a, C> {
    /// RCC: clocks and resets.
    pub rcc: &'a mut Rcc,
    /// PWR: core voltage, and write protection of the backup domain.
    pub pwr: &'a mut Pwr,
    /// SYSCFG: overdrive of the core voltage.
    pub syscfg: &'a Syscfg,
    /// Flash with its wait states.
    pub flash: &'a mut Flash<C>,
    /// Backup registers of the RTC.
    pub backup: &'a mut Backup,
}

impl<C: FlashCells> Wired<'_, C> {
    /// Exchanges the states. Call it after each access to one of the blocks, each [`crate::Peripheral::advance`] of RCC
    /// and PWR, and after a reset of the chip. It is idempotent.
    pub fn settle(&mut self, context: &mut Context<'_>) {
        self.pwr.set_overdrive(self.syscfg.overdrive(), context);
        let scale = self.pwr.scale(context.now_ns);
        self.rcc.set_voltage_scale(scale, context);
        self.pwr.set_brown_out_level(self.flash.brown_out_level());
        self.rcc.set_backup_writable(self.pwr.backup_writable());
        self.backup.set_writable(self.pwr.backup_writable());
        if self.rcc.take_backup_reset() {
            self.backup.clear();
        }
        self.flash.set_conditions(self.rcc.nominal_clocks().ahb_hz, scale, context);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        Peripheral, Size,
        peripherals::{flash::PlainCells, pwr::VoltageScale, rcc::Oscillators},
        testing::Bench,
    };

    /// Chip with the five blocks at their addresses.
    struct Chip {
        rcc: Rcc,
        pwr: Pwr,
        syscfg: Syscfg,
        flash: Flash<PlainCells>,
        backup: Backup,
    }

    const RCC: u32 = 0x5802_4400;
    const PWR: u32 = 0x5802_4800;
    const SYSCFG: u32 = 0x5800_0400;
    const FLASH: u32 = 0x5200_2000;
    const RTC: u32 = 0x5800_4000;

    impl Chip {
        fn new() -> Self {
            Self {
                rcc: Rcc::new(Oscillators::default()),
                pwr: Pwr::new(),
                syscfg: Syscfg::new(),
                flash: Flash::new(PlainCells::new()),
                backup: Backup::new(),
            }
        }

        fn wired(&mut self) -> Wired<'_, PlainCells> {
            let Self { rcc, pwr, syscfg, flash, backup } = self;
            Wired { rcc, pwr, syscfg, flash, backup }
        }

        fn block(&mut self, address: u32) -> (&mut dyn Peripheral, u32) {
            match address & !0x3FF {
                RCC => (&mut self.rcc, address - RCC),
                PWR => (&mut self.pwr, address - PWR),
                SYSCFG => (&mut self.syscfg, address - SYSCFG),
                FLASH => (&mut self.flash, address - FLASH),
                RTC => (&mut self.backup, address - RTC),
                _ => panic!("{address:#x}"),
            }
        }

        fn read(&mut self, bench: &mut Bench, address: u32) -> u32 {
            let (block, offset) = self.block(address);
            let value = block.read(offset, Size::Word, &mut bench.context()).unwrap();
            self.wired().settle(&mut bench.context());
            value
        }

        fn write(&mut self, bench: &mut Bench, address: u32, value: u32) {
            let (block, offset) = self.block(address);
            block.write(offset, Size::Word, value, &mut bench.context()).unwrap();
            self.wired().settle(&mut bench.context());
        }

        fn modify(&mut self, bench: &mut Bench, address: u32, clear: u32, set: u32) {
            let value = self.read(bench, address);
            self.write(bench, address, value & !clear | set);
        }

        /// Polls a register every 100 ns, as a program does.
        fn wait(&mut self, bench: &mut Bench, address: u32, mask: u32, value: u32) {
            let deadline_ns = bench.now_ns + 10_000_000;
            while self.read(bench, address) & mask != value {
                bench.now_ns += 100;
                assert!(bench.now_ns < deadline_ns, "{address:#x}: {mask:#x} never becomes {value:#x}");
            }
        }

        /// Boot sequence of embassy-stm32 0.6.0 for a Giga with PLL1 and PLL2; waits after each step.
        fn boot(&mut self, bench: &mut Bench, overdrive: bool) {
            // Step 1: SYSCFG, supply, scale 1, overdrive.
            self.modify(bench, RCC + 0xF4, 0, 1 << 1);
            self.modify(bench, PWR + 0x0C, 0b101, 0b010);
            self.wait(bench, PWR + 0x04, 1 << 13, 1 << 13);
            self.modify(bench, PWR + 0x18, 0, 0b11 << 14);
            self.wait(bench, PWR + 0x18, 1 << 13, 1 << 13);
            if overdrive {
                self.modify(bench, SYSCFG + 0x2C, 0, 1);
                self.wait(bench, PWR + 0x18, 1 << 13, 1 << 13);
            }
            // Step 2: the oscillators HSI, HSE, HSI48, CSI.
            self.modify(bench, RCC, 0b11 << 3, 1);
            self.modify(bench, RCC + 0x10, 7, 0);
            for on in [1 << 16, 1 << 12, 1 << 7] {
                self.modify(bench, RCC, 0, on);
                self.wait(bench, RCC, on << 1, on << 1);
            }
            // Step 3: PLL1 = 8 MHz * 120, P / 2, Q / 12. PLL2 = 8 MHz * 100, P / 16. PLL3 off, by a plain write of
            // PLLCKSELR.
            self.modify(bench, RCC + 0x28, 0x3F << 4 | 3, 2 << 4 | 2);
            self.modify(bench, RCC + 0x2C, 0xF | 7 << 16, 3 << 2 | 3 << 16);
            self.write(bench, RCC + 0x30, 119 | 1 << 9 | 11 << 16 | 1 << 24);
            self.modify(bench, RCC, 0, 1 << 24);
            self.wait(bench, RCC, 1 << 25, 1 << 25);
            self.modify(bench, RCC + 0x28, 0x3F << 12 | 3, 2 << 12 | 2);
            self.modify(bench, RCC + 0x2C, 0xF << 4 | 7 << 19, 3 << 6 | 1 << 19);
            self.write(bench, RCC + 0x38, 99 | 15 << 9 | 1 << 16 | 1 << 24);
            self.modify(bench, RCC, 0, 1 << 26);
            self.wait(bench, RCC, 1 << 27, 1 << 27);
            self.modify(bench, RCC, 1 << 28, 0);
            self.write(bench, RCC + 0x28, 0);
            // Step 4: wait states, LSI for the RTC, prescalers, the switch.
            self.write(bench, FLASH, 2 << 4 | 4);
            self.modify(bench, PWR, 0, 1 << 8);
            self.modify(bench, RCC + 0x74, 0, 1);
            self.wait(bench, RCC + 0x74, 0b10, 0b10);
            self.modify(bench, RCC + 0x70, 0, 1 << 16);
            self.modify(bench, RCC + 0x70, 1 << 16, 0);
            self.modify(bench, RCC + 0x70, 0, 1 << 15 | 0b10 << 8);
            self.modify(bench, RCC + 0x18, 0xF7F, 0b1000 | 0b100 << 4);
            self.modify(bench, RCC + 0x1C, 0x770, 0b100 << 4 | 0b100 << 8);
            self.modify(bench, RCC + 0x20, 0x70, 0b100 << 4);
            self.modify(bench, RCC + 0x10, 7, 3);
            self.wait(bench, RCC + 0x10, 7 << 3, 3 << 3);
            self.modify(bench, SYSCFG + 0x20, 0b11, 1);
            self.wait(bench, SYSCFG + 0x20, 1 << 8, 1 << 8);
        }
    }

    #[test]
    fn a_giga_comes_up_without_a_complaint() {
        let (mut chip, mut bench) = (Chip::new(), Bench::default());
        chip.boot(&mut bench, true);
        bench.assert_no_misuse();
        let clocks = chip.rcc.clocks();
        assert_eq!((clocks.core_hz, clocks.ahb_hz, clocks.adc_hz), (480_000_000, 240_000_000, 50_000_000));
        assert_eq!(chip.rcc.voltage_scale(), VoltageScale::Vos0);
        // The start of the crystal, 2 ms, takes most of the time.
        assert!((2_000_000..3_000_000).contains(&bench.now_ns), "{}", bench.now_ns);
    }

    #[test]
    fn without_overdrive_480_mhz_is_too_fast_for_core_buses_and_flash() {
        let (mut chip, mut bench) = (Chip::new(), Bench::default());
        chip.boot(&mut bench, false);
        let misuse = bench.take_misuse();
        for part in
            ["the core at 480000000 Hz", "APB4 at 120000000 Hz", "LATENCY 4 and WRHIGHFREQ 2 at 240000000 Hz and VOS1"]
        {
            assert!(misuse.iter().any(|what| what.contains(part)), "{part}: {misuse:?}");
        }
    }

    #[test]
    fn backup_registers_follow_the_protection_and_the_domain_s_reset() {
        let (mut chip, mut bench) = (Chip::new(), Bench::default());
        chip.modify(&mut bench, PWR, 0, 1 << 8);
        chip.write(&mut bench, RTC + 0x50, 0xDF59);
        assert_eq!(chip.read(&mut bench, RTC + 0x50), 0xDF59);
        chip.modify(&mut bench, RCC + 0x70, 0, 1 << 16);
        assert_eq!(chip.read(&mut bench, RTC + 0x50), 0);
        bench.assert_no_misuse();
        chip.modify(&mut bench, PWR, 1 << 8, 0);
        chip.write(&mut bench, RTC + 0x50, 1);
        assert_eq!(bench.take_misuse().len(), 1);
    }

    #[test]
    fn a_reset_brings_back_64_mhz_and_scale_3() {
        let (mut chip, mut bench) = (Chip::new(), Bench::default());
        chip.boot(&mut bench, true);
        for block in
            [&mut chip.syscfg as &mut dyn Peripheral, &mut chip.pwr, &mut chip.flash, &mut chip.backup, &mut chip.rcc]
        {
            block.reset(&mut bench.context());
        }
        chip.wired().settle(&mut bench.context());
        assert_eq!(chip.rcc.clocks().core_hz, 64_000_000);
        assert_eq!(chip.rcc.voltage_scale(), VoltageScale::Vos3);
        chip.boot(&mut bench, true);
        assert_eq!(chip.rcc.clocks().core_hz, 480_000_000, "and up again, the supply being configured already");
        bench.assert_no_misuse();
    }
}
