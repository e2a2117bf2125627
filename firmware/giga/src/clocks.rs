//! Clock tree: 480 MHz from the 16 MHz crystal, or from the internal oscillator when the crystal does not start.

use embassy_stm32::{
    pac::RCC,
    rcc::{
        AHBPrescaler, APBPrescaler, Config, HSIPrescaler, Hse, HseMode, Hsi48Config, LsConfig, Pll, PllDiv, PllMul,
        PllPreDiv, PllSource, SupplyConfig, Sysclk, VoltageScale, mux,
    },
    time::Hertz,
};

use crate::cycles::{self, Deadline};

/// Time limit for the start of the crystal: crystals start in 2 ms (STM32H747 datasheet, table 45).
const CRYSTAL_START_US: u32 = 20_000;

/// Source of the processor's clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq, defmt::Format)]
pub(crate) enum Source {
    /// Crystal of the Giga.
    Crystal,
    /// Internal oscillator, 1 % at 25 °C: the crystal did not start.
    Internal,
}

/// Starts the crystal and returns whether it runs. embassy would wait for it indefinitely.
pub(crate) fn probe() -> Source {
    RCC.cr().modify(|w| w.set_hsebyp(false));
    RCC.cr().modify(|w| w.set_hseon(true));
    let patience = Deadline::after_us(CRYSTAL_START_US, cycles::AT_RESET_MHZ);
    while !patience.has_passed() {
        if RCC.cr().read().hserdy() {
            return Source::Crystal;
        }
    }
    RCC.cr().modify(|w| w.set_hseon(false));
    Source::Internal
}

/// Enables the clock security system, for a processor that runs from the crystal: when the crystal stops, the processor
/// continues from the internal oscillator and takes the NMI (`panic.rs`), within about 2 us, instead of standing still
/// with its outputs on.
pub(crate) fn guard() {
    RCC.cr().modify(|w| w.set_hsecsson(true));
}

/// Clock configuration with the same frequencies from either source: processor 480, AXI and AHB 240, APB 120, timers
/// 240 MHz.
///
/// PLL1 supplies the processor's clock and 80 MHz for FDCAN and SPI, PLL2 64 MHz for the ADC, which requires 16 MHz
/// times a power of two, HSI48 the USB clock. The supply is the LDO: the Giga has no coil for the SMPS, and a wrong
/// choice locks the debugger out until power is cut.
pub(crate) fn config(source: Source) -> Config {
    let (pll_source, prediv) = match source {
        Source::Crystal => (PllSource::HSE, PllPreDiv::DIV2),
        Source::Internal => (PllSource::HSI, PllPreDiv::DIV8),
    };
    let mut config = Config::default();
    config.hse = (source == Source::Crystal).then_some(Hse { freq: Hertz(16_000_000), mode: HseMode::Oscillator });
    config.hsi = Some(HSIPrescaler::DIV1);
    // Nothing uses the RTC. Selecting a source for it would reset the backup domain, and its records with it, if a
    // bootloader has chosen another source.
    config.ls = LsConfig::off();
    // Clock of the compensation cell of the fast outputs.
    config.csi = true;
    config.hsi48 = Some(Hsi48Config { sync_from_usb: true });
    // Both PLLs get 8 MHz.
    config.pll1 = Some(Pll {
        source: pll_source,
        prediv,
        mul: PllMul::MUL120,
        divp: Some(PllDiv::DIV2),
        divq: Some(PllDiv::DIV12),
        divr: None,
    });
    config.pll2 =
        Some(Pll { source: pll_source, prediv, mul: PllMul::MUL96, divp: Some(PllDiv::DIV12), divq: None, divr: None });
    config.sys = Sysclk::PLL1_P;
    config.d1c_pre = AHBPrescaler::DIV1;
    config.ahb_pre = AHBPrescaler::DIV2;
    config.apb1_pre = APBPrescaler::DIV2;
    config.apb2_pre = APBPrescaler::DIV2;
    config.apb3_pre = APBPrescaler::DIV2;
    config.apb4_pre = APBPrescaler::DIV2;
    config.voltage_scale = VoltageScale::Scale0;
    config.supply_config = SupplyConfig::LDO;
    config.mux.adcsel = mux::Adcsel::PLL2_P;
    config.mux.fdcansel = mux::Fdcansel::PLL1_Q;
    config.mux.usbsel = mux::Usbsel::HSI48;
    config
}
