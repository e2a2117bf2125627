//! Tests of RCC with a program's sequences, step by step.

use proptest::prelude::*;

use super::*;
use crate::testing::Bench;

fn bench() -> (Rcc, Bench) {
    (Rcc::new(Oscillators::default()), Bench::default())
}

fn wait_for(rcc: &mut Rcc, bench: &mut Bench, at: u32, mask: u32) {
    let deadline_ns = bench.now_ns + 3_000_000_000;
    while bench.read(rcc, at) & mask == 0 {
        assert!(bench.now_ns < deadline_ns, "{mask:#x} of register {at:#x} never comes");
        bench.run(rcc, bench.now_ns + 10_000);
    }
}

/// Configures the Giga's clocks with PLL1 from HSE: 16 MHz / 2 * 120 = 960 MHz, P 480 MHz, Q 80 MHz; AHB 240, APBs 120
/// MHz.
fn full_speed(rcc: &mut Rcc, bench: &mut Bench) {
    rcc.set_voltage_scale(VoltageScale::Vos0, &mut bench.context());
    bench.modify(rcc, offset::CR, 0, 1 << 16);
    wait_for(rcc, bench, offset::CR, 1 << 17);
    bench.write(rcc, offset::PLLCKSELR, 2 << 4 | 2);
    bench.write(rcc, offset::PLLCFGR, 0b11 << 2 | 0b011 << 16);
    bench.write(rcc, offset::PLL1DIVR, 119 | 1 << 9 | 11 << 16 | 1 << 24);
    bench.modify(rcc, offset::CR, 0, 1 << 24);
    wait_for(rcc, bench, offset::CR, 1 << 25);
    bench.write(rcc, offset::D1CFGR, 0b1000 | 0b100 << 4);
    bench.write(rcc, offset::D2CFGR, 0b100 << 4 | 0b100 << 8);
    bench.write(rcc, offset::D3CFGR, 0b100 << 4);
    bench.modify(rcc, offset::CFGR, 7, 3);
}

#[test]
fn the_chip_starts_on_64_mhz() {
    let (mut rcc, mut bench) = bench();
    let clocks = rcc.clocks();
    assert_eq!(
        (clocks.core_hz, clocks.ahb_hz, clocks.apb1_hz, clocks.tim_apb1_hz),
        (64_000_000, 64_000_000, 64_000_000, 64_000_000)
    );
    assert_eq!(bench.read(&mut rcc, offset::CR) & 0b111, 0b101, "HSI on and ready");
    assert_eq!(bench.read(&mut rcc, offset::CFGR) >> 3 & 7, 0);
}

#[test]
fn the_giga_s_480_mhz() {
    let (mut rcc, mut bench) = bench();
    full_speed(&mut rcc, &mut bench);
    bench.modify(&mut rcc, offset::D2CCIP1R, 0, 1 << 28);
    let clocks = rcc.clocks();
    assert_eq!((clocks.core_hz, clocks.ahb_hz), (480_000_000, 240_000_000));
    assert_eq!([clocks.apb1_hz, clocks.apb2_hz, clocks.apb3_hz, clocks.apb4_hz], [120_000_000; 4]);
    assert_eq!([clocks.tim_apb1_hz, clocks.tim_apb2_hz], [240_000_000; 2], "APB / 2: the AHB's clock");
    assert_eq!(clocks.fdcan_hz, 80_000_000, "PLL1 Q");
    assert_eq!(clocks.spi123_hz, 80_000_000, "PLL1 Q is the default");
    assert_eq!(bench.read(&mut rcc, offset::CFGR) >> 3 & 7, 3);
    assert!(bench.take_signals().contains(&Signal::Clocks));
    bench.assert_no_misuse();
}

#[test]
fn a_crystal_that_is_fast_by_50_ppm_makes_everything_fast_by_50_ppm() {
    let mut bench = Bench::default();
    let mut rcc = Rcc::new(Oscillators { hse_hz: 16_000_800, ..Oscillators::default() });
    full_speed(&mut rcc, &mut bench);
    assert_eq!(rcc.clocks().core_hz, 480_024_000);
    assert_eq!(rcc.clocks().tim_apb2_hz, 240_012_000);
    bench.assert_no_misuse();
    rcc.set_oscillators(Oscillators { hse_hz: 15_999_200, ..Oscillators::default() });
    bench.take_signals();
    rcc.advance(&mut bench.context());
    assert_eq!(rcc.clocks().core_hz, 479_976_000);
    assert_eq!(bench.take_signals(), [Signal::Clocks]);
}

#[test]
fn without_a_crystal_hse_is_never_ready() {
    let (mut rcc, mut bench) = bench();
    rcc.fit_crystals(false, true);
    bench.modify(&mut rcc, offset::CR, 0, 1 << 16);
    bench.run(&mut rcc, 10_000_000_000);
    assert_eq!(bench.read(&mut rcc, offset::CR) >> 16 & 0b11, 0b01);
    assert_eq!(rcc.next_event_ns(), u64::MAX);
    // The core stays on HSI although HSE is requested.
    bench.modify(&mut rcc, offset::CFGR, 7, 2);
    assert_eq!(rcc.clocks().core_hz, 64_000_000);
    assert_eq!(bench.take_misuse().len(), 1);
}

#[test]
fn a_running_pll_keeps_its_divider() {
    let (mut rcc, mut bench) = bench();
    full_speed(&mut rcc, &mut bench);
    // A plain write for another PLL puts zeros into this one's fields.
    bench.write(&mut rcc, offset::PLLCKSELR, 0);
    assert_eq!(bench.read(&mut rcc, offset::PLLCKSELR), 2 << 4 | 2);
    bench.assert_no_misuse();
    // Other values are misuse.
    bench.write(&mut rcc, offset::PLLCKSELR, 1 << 4 | 2);
    bench.write(&mut rcc, offset::PLL1DIVR, 59 | 1 << 9);
    bench.write(&mut rcc, offset::PLLCFGR, 0b10 << 2 | 0b111 << 16);
    assert_eq!(bench.take_misuse().len(), 3);
    assert_eq!(rcc.clocks().core_hz, 480_000_000);
}

#[test]
fn what_the_core_runs_on_cannot_be_turned_off() {
    let (mut rcc, mut bench) = bench();
    full_speed(&mut rcc, &mut bench);
    bench.modify(&mut rcc, offset::CR, 1 << 16, 0);
    bench.modify(&mut rcc, offset::CR, 1 << 24, 0);
    assert_eq!(bench.take_misuse().len(), 2);
    assert_eq!(rcc.clocks().core_hz, 480_000_000);
    bench.modify(&mut rcc, offset::CR, 1, 0);
    assert_eq!(bench.read(&mut rcc, offset::CR) >> 2 & 1, 0, "HSI may go");
    bench.assert_no_misuse();
}

#[test]
fn too_fast_for_the_voltage_is_misuse() {
    let (mut rcc, mut bench) = bench();
    full_speed(&mut rcc, &mut bench);
    bench.assert_no_misuse();
    rcc.set_voltage_scale(VoltageScale::Vos1, &mut bench.context());
    let misuse = bench.take_misuse();
    // Core, AHB and four APBs are each 20 % above the limit of scale 1.
    assert_eq!(misuse.len(), 6, "{misuse:?}");
    assert!(misuse[0].contains("480000000 Hz, over the 400000000 Hz of VOS1"), "{}", misuse[0]);
}

#[test]
fn a_pll_out_of_its_range_is_misuse() {
    let (mut rcc, mut bench) = bench();
    // HSI / 1 = 64 MHz is four times the highest reference; times 129 with the reset values it is 8.256 GHz.
    bench.write(&mut rcc, offset::PLLCKSELR, 1 << 4);
    bench.modify(&mut rcc, offset::CR, 0, 1 << 24);
    let misuse = bench.take_misuse();
    assert!(misuse.iter().any(|what| what.contains("reference of 64000000 Hz")), "{misuse:?}");
    assert!(misuse.iter().any(|what| what.contains("VCO at 8256000000 Hz")), "{misuse:?}");
}

#[test]
fn the_fraction_is_taken_when_it_is_enabled() {
    let (mut rcc, mut bench) = bench();
    // HSI / 8 = 8 MHz, * (31, or 31.5 once the fraction counts) = 248 or 252 MHz, / 2.
    bench.write(&mut rcc, offset::PLLCKSELR, 8 << 4);
    bench.write(&mut rcc, offset::PLLCFGR, 0b11 << 2 | 1 << 16);
    bench.write(&mut rcc, offset::PLL1DIVR, 30 | 1 << 9);
    bench.write(&mut rcc, offset::PLL1FRACR, 4096 << 3);
    bench.write(&mut rcc, offset::D1CFGR, 0b1010);
    bench.modify(&mut rcc, offset::CR, 0, 1 << 24);
    wait_for(&mut rcc, &mut bench, offset::CR, 1 << 25);
    bench.modify(&mut rcc, offset::CFGR, 7, 3);
    assert_eq!(rcc.clocks().core_hz, 124_000_000);
    bench.modify(&mut rcc, offset::PLLCFGR, 0, 1);
    assert_eq!(rcc.clocks().core_hz, 126_000_000);
    bench.write(&mut rcc, offset::PLL1FRACR, 0);
    assert_eq!(rcc.clocks().core_hz, 126_000_000, "not before FRACEN rises again");
    bench.assert_no_misuse();
}

#[test]
fn kernel_clocks_come_from_where_their_mux_points() {
    let (mut rcc, mut bench) = bench();
    full_speed(&mut rcc, &mut bench);
    assert_eq!(rcc.clocks().adc_hz, 0, "PLL2 P is off");
    bench.write(&mut rcc, offset::D3CCIPR, 0b10 << 16);
    bench.write(&mut rcc, offset::D1CCIPR, 0b10 << 28);
    assert_eq!(rcc.clocks().adc_hz, 16_000_000, "PER_CK from HSE");
    bench.write(&mut rcc, offset::D2CCIP2R, 3 | 1 << 3 | 2 << 12 | 3 << 20);
    let clocks = rcc.clocks();
    assert_eq!((clocks.usart234578_hz, clocks.usart16_hz, clocks.i2c123_hz), (64_000_000, 0, 64_000_000));
    assert_eq!(rcc.usb_hz(), 0, "HSI48 is off");
    bench.modify(&mut rcc, offset::CR, 0, 1 << 12);
    wait_for(&mut rcc, &mut bench, offset::CR, 1 << 13);
    assert_eq!(rcc.usb_hz(), 48_000_000);
}

#[test]
fn enables_of_both_addresses_are_one_register_and_the_other_core_has_its_own() {
    const GPIOB: u32 = 0x5802_0400;
    let (mut rcc, mut bench) = bench();
    assert!(!rcc.is_enabled(GPIOB));
    assert!(rcc.is_enabled(0x5200_2000), "the flash registers have no enable bit");
    assert!(rcc.is_enabled(0x5800_4000), "the RTC is on after a reset");
    bench.write(&mut rcc, 0x140, 1 << 1);
    assert!(rcc.is_enabled(GPIOB));
    assert_eq!(bench.read(&mut rcc, 0xE0), 1 << 1);
    bench.write(&mut rcc, 0xE0, 0);
    assert!(!rcc.is_enabled(GPIOB));
    bench.write(&mut rcc, 0x1A0, 1 << 1);
    assert!(rcc.is_enabled(GPIOB));
    assert_eq!(bench.read(&mut rcc, 0xE0), 0);
}

#[test]
fn a_rising_reset_bit_resets_once() {
    let (mut rcc, mut bench) = bench();
    // Bit 22 of APB1LRSTR resets I2C2.
    bench.write(&mut rcc, 0x90, 1 << 22);
    bench.write(&mut rcc, 0x90, 1 << 22);
    assert_eq!(rcc.take_resets(), [0x4000_5800]);
    bench.write(&mut rcc, 0x90, 0);
    assert_eq!(rcc.take_resets(), []);
    // One bit resets both FDCANs, their calibration unit and message RAM.
    bench.write(&mut rcc, 0x94, 1 << 8);
    assert_eq!(rcc.take_resets().len(), 4);
}

#[test]
fn reset_flags_tell_causes_until_they_are_removed() {
    let (mut rcc, mut bench) = bench();
    assert_eq!(bench.read(&mut rcc, offset::OF_CORE), 0x00FE_0000);
    bench.modify(&mut rcc, offset::OF_CORE, 0, 1 << 16);
    assert_eq!(bench.read(&mut rcc, offset::OF_CORE), 0);
    rcc.note_reset(ResetCause::Watchdog);
    rcc.reset(&mut bench.context());
    assert_eq!(bench.read(&mut rcc, 0x130), 0x0446_0000);
    rcc.note_reset(ResetCause::Software);
    assert_eq!(bench.read(&mut rcc, offset::OF_CORE), 0x0546_0000);
}

#[test]
fn the_backup_domain_needs_dbp_and_outlives_a_reset() {
    let (mut rcc, mut bench) = bench();
    bench.write(&mut rcc, offset::BDCR, 1);
    assert_eq!(bench.read(&mut rcc, offset::BDCR), 0);
    assert_eq!(bench.take_misuse().len(), 1);
    rcc.set_backup_writable(true);
    bench.write(&mut rcc, offset::BDCR, 1);
    wait_for(&mut rcc, &mut bench, offset::BDCR, 0b10);
    bench.modify(&mut rcc, offset::BDCR, 0, 1 << 15 | 1 << 8);
    rcc.reset(&mut bench.context());
    assert_eq!(bench.read(&mut rcc, offset::BDCR), 0x8103);
    rcc.set_backup_writable(true);
    bench.modify(&mut rcc, offset::BDCR, 3 << 8, 2 << 8);
    assert_eq!(bench.read(&mut rcc, offset::BDCR) >> 8 & 3, 1, "chosen once");
    bench.write(&mut rcc, offset::BDCR, 1 << 16);
    bench.write(&mut rcc, offset::BDCR, 0);
    assert!(rcc.take_backup_reset());
    assert!(!rcc.take_backup_reset());
    assert_eq!(bench.read(&mut rcc, offset::BDCR), 0);
}

#[test]
fn ready_interrupts_are_raised_and_cleared() {
    let (mut rcc, mut bench) = bench();
    bench.write(&mut rcc, offset::CIER, 1);
    bench.write(&mut rcc, offset::CSR, 1);
    assert_eq!(rcc.next_event_ns(), 80_000);
    bench.run(&mut rcc, 100_000);
    assert_eq!(bench.read(&mut rcc, offset::CIFR), 1);
    assert!(bench.take_signals().contains(&Signal::Irq { number: IRQ, level: true }));
    bench.write(&mut rcc, offset::CICR, 1);
    assert_eq!(bench.read(&mut rcc, offset::CIFR), 0);
    assert!(bench.take_signals().contains(&Signal::Irq { number: IRQ, level: false }));
}

#[test]
fn what_is_not_modelled_ends_the_run() {
    let (mut rcc, mut bench) = bench();
    assert!(bench.try_read(&mut rcc, 0x14, Size::Word).is_err());
    assert!(bench.try_write(&mut rcc, 0x1FC, Size::Word, 0).is_err());
    assert!(bench.try_write(&mut rcc, offset::GCR, Size::Word, 1 << 3).is_err(), "starts the other core");
}

proptest! {
    #[test]
    fn whatever_is_written_the_clocks_stay_in_proportion(writes in proptest::collection::vec((0..0x1E0_u32, any::<u32>()), 0..60)) {
        let (mut rcc, mut bench) = bench();
        for (at, value) in writes {
            let _ = bench.try_write(&mut rcc, at & !3, Size::Word, value);
            bench.run(&mut rcc, bench.now_ns + 3_000_000);
        }
        let clocks = rcc.clocks();
        prop_assert!(clocks.core_hz > 0 || !bench.misuse.is_empty(), "a clock that stops without a word");
        prop_assert!(clocks.ahb_hz <= clocks.core_hz);
        for apb_hz in [clocks.apb1_hz, clocks.apb2_hz, clocks.apb3_hz, clocks.apb4_hz] {
            prop_assert!(apb_hz <= clocks.ahb_hz);
        }
        prop_assert!(clocks.tim_apb1_hz >= clocks.apb1_hz && clocks.tim_apb1_hz <= clocks.ahb_hz);
    }
}

/// Makes RCC at full speed, with the security system on and HSI off.
fn guarded() -> (Rcc, Bench) {
    let (mut rcc, mut bench) = bench();
    full_speed(&mut rcc, &mut bench);
    bench.modify(&mut rcc, offset::CR, 0, HSECSSON);
    bench.modify(&mut rcc, offset::CR, 1, 0);
    bench.take_signals();
    (rcc, bench)
}

#[test]
fn a_crystal_that_stops_under_the_security_system_raises_the_nmi_and_leaves_the_core_on_hsi() {
    let (mut rcc, mut bench) = guarded();
    let stops_ns = bench.now_ns + 1_000_000;
    rcc.stop_hse_at(stops_ns);
    bench.run(&mut rcc, stops_ns - 1);
    assert_eq!((bench.take_signals(), rcc.clocks().core_hz), (vec![], 480_000_000));
    bench.run(&mut rcc, stops_ns + 10_000);
    assert_eq!(bench.take_signals().first(), Some(&Signal::Nmi { level: true }));
    // Afterwards HSI runs, HSE and the PLL are off and not ready; SW and SWS select HSI; dividers stay.
    assert_eq!(bench.read(&mut rcc, offset::CR) & 0x0303_0005, 0x0000_0005);
    assert_eq!(bench.read(&mut rcc, offset::CFGR) & 0x3F, 0);
    assert_eq!((rcc.clocks().core_hz, rcc.clocks().ahb_hz, rcc.clocks().apb1_hz), (64_000_000, 32_000_000, 16_000_000));
    assert_eq!(bench.read(&mut rcc, offset::CIFR) & HSECSSF, HSECSSF);
    // The NMI stays until its flag is cleared here.
    bench.write(&mut rcc, offset::CICR, 0x3FF);
    assert_eq!(bench.take_signals().iter().filter(|signal| matches!(signal, Signal::Nmi { .. })).count(), 0);
    bench.write(&mut rcc, offset::CICR, HSECSSF);
    assert_eq!(bench.take_signals(), [Signal::Nmi { level: false }]);
    // The crystal never becomes ready again, and its security system stays on.
    bench.modify(&mut rcc, offset::CR, 0, HSEON);
    bench.run(&mut rcc, bench.now_ns + 1_000_000_000);
    assert_eq!(bench.read(&mut rcc, offset::CR) >> 16 & 0b1011, 0b1001);
    assert_eq!(bench.take_signals(), []);
    bench.assert_no_misuse();
}

#[test]
fn a_crystal_that_stops_without_the_security_system_stops_everything_that_runs_on_it() {
    let (mut rcc, mut bench) = bench();
    full_speed(&mut rcc, &mut bench);
    bench.take_signals();
    rcc.stop_hse_at(bench.now_ns + 500);
    bench.run(&mut rcc, bench.now_ns + 500);
    assert_eq!((rcc.clocks().core_hz, rcc.clocks().ahb_hz, rcc.clocks().spi123_hz), (0, 0, 0));
    assert_eq!(rcc.clocks().lsi_hz, 32_000);
    assert_eq!(bench.take_signals(), [Signal::Clocks]);
    assert_eq!(bench.read(&mut rcc, offset::CR) >> 16 & 0b11, 0b11, "nothing tells");
    // Only a reset recovers: it selects HSI, without HSE.
    rcc.reset(&mut bench.context());
    assert_eq!(rcc.clocks().core_hz, 64_000_000);
    bench.modify(&mut rcc, offset::CR, 0, HSEON);
    bench.run(&mut rcc, bench.now_ns + 1_000_000_000);
    assert_eq!(bench.read(&mut rcc, offset::CR) >> 16 & 0b11, 0b01);
    bench.assert_no_misuse();
}

#[test]
fn the_security_system_is_turned_off_by_a_reset_only_and_minds_a_crystal_in_use_only() {
    let (mut rcc, mut bench) = guarded();
    bench.modify(&mut rcc, offset::CR, HSECSSON, 0);
    assert_eq!(bench.read(&mut rcc, offset::CR) & HSECSSON, HSECSSON);
    rcc.reset(&mut bench.context());
    bench.take_signals();
    assert_eq!(bench.read(&mut rcc, offset::CR) & HSECSSON, 0);
    // The security system is on before HSE; a crystal that never starts is not a failure of a running one.
    bench.modify(&mut rcc, offset::CR, 0, HSECSSON);
    rcc.fit_crystals(false, true);
    bench.modify(&mut rcc, offset::CR, 0, HSEON);
    bench.run(&mut rcc, bench.now_ns + 1_000_000_000);
    assert_eq!(bench.take_signals(), []);
}

#[test]
fn clock_outputs_and_other_clocks_that_are_not_modelled_end_the_run() {
    let (mut rcc, mut bench) = bench();
    rcc.set_backup_writable(true);
    for (at, bits) in
        [(offset::CFGR, 1 << 18), (offset::CFGR, 1 << 25), (offset::CFGR, 1 << 14), (offset::BDCR, 1 << 5)]
    {
        let error = bench.try_write(&mut rcc, at, Size::Word, bits).unwrap_err();
        assert!(error.to_string().starts_with("RCC: "), "{error}");
    }
    // Selecting the source of an output that is off has no effect.
    bench.write(&mut rcc, offset::CFGR, 0b010 << 22 | 0b001 << 29);
    bench.assert_no_misuse();
}
