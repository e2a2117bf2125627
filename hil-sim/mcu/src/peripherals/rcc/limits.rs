//! Limits of the clock tree (DS12930, table "Maximum allowed clock frequencies"; RM0399, 9.5.5).

use crate::Clocks;

use super::{Oscillator, Oscillators, Rcc, offset};
use crate::peripherals::pwr::VoltageScale;

/// Returns the highest core and AHB frequencies, Hz; those of the APBs are half of the AHB's.
fn highest(scale: VoltageScale) -> (u64, u64) {
    match scale {
        VoltageScale::Vos0 => (480_000_000, 240_000_000),
        VoltageScale::Vos1 => (400_000_000, 200_000_000),
        VoltageScale::Vos2 => (300_000_000, 150_000_000),
        VoltageScale::Vos3 => (200_000_000, 100_000_000),
    }
}

/// Exception for HSI with all prescalers at 1, with which the chip itself starts at scale 3, where its APBs are limited
/// to 50 MHz.
const AT_RESET_HZ: u64 = 64_000_000;

/// Returns the clocks that are too fast for the voltage.
pub(super) fn too_fast(clocks: &Clocks, scale: VoltageScale) -> Vec<String> {
    let (core, ahb) = highest(scale);
    [
        ("the core", clocks.core_hz, core),
        ("AXI and AHB", clocks.ahb_hz, ahb),
        ("APB1", clocks.apb1_hz, ahb / 2),
        ("APB2", clocks.apb2_hz, ahb / 2),
        ("APB3", clocks.apb3_hz, ahb / 2),
        ("APB4", clocks.apb4_hz, ahb / 2),
    ]
    .into_iter()
    .filter(|(_, hz, limit)| hz > limit && *hz > AT_RESET_HZ)
    .map(|(what, hz, limit)| format!("{what} at {hz} Hz, over the {limit} Hz of {scale} (DS12930, 6.3.1)"))
    .collect()
}

impl Rcc {
    /// Returns the errors in the settings of a PLL that is switched on now.
    pub(super) fn pll_faults(&self, index: usize) -> Vec<String> {
        let pll = self.pll_settings(&Oscillators::default(), index);
        let name = format!("PLL{}", index + 1);
        let config = self.register(offset::PLLCFGR) >> (4 * index);
        let mut faults = Vec::new();
        let reference = pll.reference.hz();
        let range = (config >> 2 & 3) as usize;
        let (lowest, highest) =
            [(1_000_000, 2_000_000), (2_000_000, 4_000_000), (4_000_000, 8_000_000), (8_000_000, 16_000_000)][range];
        if !(lowest..=highest).contains(&reference) {
            faults.push(format!(
                "{name} reference of {reference} Hz is outside {lowest}..={highest} Hz (PLLxRGE = {range})"
            ));
        }
        let vco = pll.vco.hz();
        let (lowest, highest) =
            if config >> 1 & 1 != 0 { (150_000_000, 420_000_000) } else { (192_000_000, 960_000_000) };
        if !(lowest..=highest).contains(&vco) {
            faults.push(format!(
                "{name} VCO at {vco} Hz is outside {lowest}..={highest} Hz (DS12930, PLL characteristics)"
            ));
        }
        let divider = self.register(offset::PLL1DIVR + 8 * index as u32);
        if (divider & 0x1FF) < 3 {
            faults.push(format!("{name} DIVN of {} (RCC_PLLxDIVR: at least 4)", (divider & 0x1FF) + 1));
        }
        if index == 0 && divider >> 9 & 1 == 0 {
            faults.push("PLL1 DIVP is odd (RCC_PLL1DIVR: not allowed)".into());
        }
        faults
    }

    /// Returns the source that PLLCKSELR selects; `None` for no clock.
    pub(super) fn pll_source(&self) -> Option<Oscillator> {
        match self.register(offset::PLLCKSELR) & 3 {
            0 => Some(Oscillator::Hsi),
            1 => Some(Oscillator::Csi),
            2 => Some(Oscillator::Hse),
            _ => None,
        }
    }
}
