//! Decoder of the clock tree: frequencies from registers (RM0399, 9.5).

use crate::Clocks;

use super::{Oscillator, Rcc, offset};

/// Frequencies of the oscillators, Hz.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Oscillators {
    /// HSE: the crystal or clock at OSC_IN.
    pub hse_hz: u64,
    /// HSI, internal, 64 MHz.
    pub hsi_hz: u64,
    /// CSI, internal, 4 MHz.
    pub csi_hz: u64,
    /// HSI48, internal, 48 MHz.
    pub hsi48_hz: u64,
    /// LSI, internal, 32 kHz.
    pub lsi_hz: u64,
    /// LSE: the crystal at OSC32_IN.
    pub lse_hz: u64,
}

impl Default for Oscillators {
    /// Oscillators of an Arduino Giga R1, all exact.
    fn default() -> Self {
        Self {
            hse_hz: 16_000_000,
            hsi_hz: 64_000_000,
            csi_hz: 4_000_000,
            hsi48_hz: 48_000_000,
            lsi_hz: 32_000,
            lse_hz: 32_768,
        }
    }
}

/// Frequency as a fraction, so that rounding errors of dividers do not accumulate.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Hertz {
    numerator: u128,
    denominator: u128,
}

impl Hertz {
    pub(super) fn new(hz: u64) -> Self {
        Self { numerator: hz.into(), denominator: 1 }
    }

    fn divided(self, by: u32) -> Self {
        Self { denominator: self.denominator.max(1) * u128::from(by), ..self }
    }

    fn times(self, by: u32) -> Self {
        Self { numerator: self.numerator * u128::from(by), denominator: self.denominator.max(1) }
    }

    /// Returns the frequency rounded to the nearest Hz.
    pub(super) fn hz(self) -> u64 {
        let denominator = self.denominator.max(1);
        ((self.numerator + denominator / 2) / denominator) as u64
    }
}

/// Outputs of one PLL; 0 for an output that is off.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pll {
    /// Reference frequency after DIVM.
    pub(super) reference: Hertz,
    pub(super) vco: Hertz,
    p: Hertz,
    q: Hertz,
    r: Hertz,
}

/// Decodes the prescalers of the AHB and the core (HPRE, D1CPRE).
fn ahb_divider(field: u32) -> u32 {
    match field & 0xF {
        0..=7 => 1,
        code @ 8..=11 => 2 << (code - 8),
        code => 64 << (code - 12),
    }
}

/// Decodes the prescalers of the APBs.
fn apb_divider(field: u32) -> u32 {
    match field & 7 {
        0..=3 => 1,
        code => 2 << (code - 4),
    }
}

/// Returns the timers' clock: that of the AHB if the APB divider is at most 2 (4 with TIMPRE), else 2 (4) times that of
/// the APB (RM0399, 9.5.10).
fn timers(ahb: Hertz, apb: u32, timpre: bool) -> Hertz {
    let times = if timpre { 4 } else { 2 };
    if apb <= times { ahb } else { ahb.divided(apb / times) }
}

impl Rcc {
    /// Returns the outputs of a PLL by its registers, whether it is on or not.
    pub(super) fn pll_settings(&self, oscillators: &Oscillators, index: usize) -> Pll {
        let select = self.register(offset::PLLCKSELR);
        let source = match select & 3 {
            0 => self.hsi(oscillators),
            1 => Hertz::new(oscillators.csi_hz),
            2 => Hertz::new(oscillators.hse_hz),
            _ => Hertz::default(),
        };
        let divm = select >> (4 + 8 * index) & 0x3F;
        if divm == 0 {
            return Pll::default();
        }
        let reference = source.divided(divm);
        let config = self.register(offset::PLLCFGR);
        let divider = self.register(offset::PLL1DIVR + 8 * index as u32);
        let fraction = if config >> (4 * index) & 1 != 0 { self.latched_fraction[index] } else { 0 };
        let vco = reference.times(((divider & 0x1FF) + 1) * 8192 + fraction).divided(8192);
        let output = |number: usize, shift: u32| {
            let enabled = config >> (16 + 3 * index + number) & 1 != 0;
            if enabled { vco.divided((divider >> shift & 0x7F) + 1) } else { Hertz::default() }
        };
        Pll { reference, vco, p: output(0, 9), q: output(1, 16), r: output(2, 24) }
    }

    fn hsi(&self, oscillators: &Oscillators) -> Hertz {
        Hertz::new(oscillators.hsi_hz).divided(1 << (self.register(offset::CR) >> 3 & 3))
    }

    /// Returns all clocks by the registers and the sources that are ready now.
    pub(super) fn decode(&self, oscillators: &Oscillators) -> (Clocks, u64) {
        let when_ready =
            |source: Oscillator, frequency: Hertz| if self.is_ready(source) { frequency } else { Hertz::default() };
        let hsi = when_ready(Oscillator::Hsi, self.hsi(oscillators));
        let csi = when_ready(Oscillator::Csi, Hertz::new(oscillators.csi_hz));
        let hse = if self.hse_swings() { Hertz::new(oscillators.hse_hz) } else { Hertz::default() };
        let hsi48 = when_ready(Oscillator::Hsi48, Hertz::new(oscillators.hsi48_hz));
        let lse = when_ready(Oscillator::Lse, Hertz::new(oscillators.lse_hz));
        let pll = |index: usize| {
            let fed = self.pll_source() != Some(Oscillator::Hse) || self.hse_swings();
            let runs = fed && self.is_ready(Oscillator::PLLS[index]);
            if runs { self.pll_settings(oscillators, index) } else { Pll::default() }
        };
        let plls = [pll(0), pll(1), pll(2)];

        let system = [hsi, csi, hse, plls[0].p][self.system_source as usize];
        let [d1, d2, d3] = [offset::D1CFGR, offset::D2CFGR, offset::D3CFGR].map(|at| self.register(at));
        let core = system.divided(ahb_divider(d1 >> 8));
        let ahb = core.divided(ahb_divider(d1));
        let (apb1, apb2) = (apb_divider(d2 >> 4), apb_divider(d2 >> 8));
        let (apb3, apb4) = (apb_divider(d1 >> 4), apb_divider(d3 >> 4));
        let timpre = self.register(offset::CFGR) >> 15 & 1 != 0;
        let (pclk1, pclk2, pclk4) = (ahb.divided(apb1), ahb.divided(apb2), ahb.divided(apb4));

        let select = |at: u32, shift: u32, bits: u32| (self.register(at) >> shift & ((1 << bits) - 1)) as usize;
        let choose =
            |sources: &[Hertz], at, shift, bits| sources.get(select(at, shift, bits)).copied().unwrap_or_default();
        let per = choose(&[hsi, csi, hse], offset::D1CCIPR, 28, 2);
        let usart = |pclk| [pclk, plls[1].q, plls[2].q, hsi, csi, lse];
        let i2c = |pclk| [pclk, plls[2].r, hsi, csi];
        let none = Hertz::default();
        let usb = choose(&[none, plls[0].q, plls[2].q, hsi48], offset::D2CCIP2R, 20, 2);
        let spi123 = [plls[0].q, plls[1].p, plls[2].p, none, per];
        let clocks = Clocks {
            core_hz: core.hz(),
            ahb_hz: ahb.hz(),
            apb1_hz: pclk1.hz(),
            apb2_hz: pclk2.hz(),
            apb3_hz: ahb.divided(apb3).hz(),
            apb4_hz: pclk4.hz(),
            tim_apb1_hz: timers(ahb, apb1, timpre).hz(),
            tim_apb2_hz: timers(ahb, apb2, timpre).hz(),
            usart16_hz: choose(&usart(pclk2), offset::D2CCIP2R, 3, 3).hz(),
            usart234578_hz: choose(&usart(pclk1), offset::D2CCIP2R, 0, 3).hz(),
            i2c123_hz: choose(&i2c(pclk1), offset::D2CCIP2R, 12, 2).hz(),
            i2c4_hz: choose(&i2c(pclk4), offset::D3CCIPR, 8, 2).hz(),
            spi123_hz: choose(&spi123, offset::D2CCIP1R, 12, 3).hz(),
            fdcan_hz: choose(&[hse, plls[0].q, plls[1].q], offset::D2CCIP1R, 28, 2).hz(),
            adc_hz: choose(&[plls[1].p, plls[2].r, per], offset::D3CCIPR, 16, 2).hz(),
            // The watchdog turns LSI on by itself, so its frequency does not depend on CSR.LSION.
            lsi_hz: oscillators.lsi_hz,
            hsi48_hz: hsi48.hz(),
            lse_hz: lse.hz(),
            lsi_ready_hz: when_ready(Oscillator::Lsi, Hertz::new(oscillators.lsi_hz)).hz(),
            hse_rtc_hz: match self.register(offset::CFGR) >> 8 & 0x3F {
                0 | 1 => 0,
                divider => hse.divided(divider).hz(),
            },
        };
        (clocks, usb.hz())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn prescalers_are_those_of_the_manual() {
        // RM0399, RCC_D1CFGR has no divider by 32.
        assert_eq!([0, 7, 8, 9, 10, 11, 12, 13, 14, 15].map(ahb_divider), [1, 1, 2, 4, 8, 16, 64, 128, 256, 512]);
        assert_eq!([0, 3, 4, 5, 6, 7].map(apb_divider), [1, 1, 2, 4, 8, 16]);
    }

    #[test]
    fn timers_run_at_the_ratio_of_the_manual_s_table() {
        // Expected values of RM0399, table "Ratio between clock timer and pclk", for APB prescalers 1, 2, 4, 8, 16, as
        // divisors of the AHB clock.
        let ahb = Hertz::new(240_000_000);
        let shares = |timpre| [1, 2, 4, 8, 16].map(|apb| 240_000_000 / timers(ahb, apb, timpre).hz());
        assert_eq!(shares(false), [1, 1, 2, 4, 8]);
        assert_eq!(shares(true), [1, 1, 1, 2, 4]);
    }
}
