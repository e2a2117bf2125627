//! What peripherals share: time, clocks, and the wires between them.

use std::fmt;

use crate::outside::Outside;

/// Frequencies that the clock tree gives, Hz; 0 is stopped. Made by the RCC model from its registers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Clocks {
    /// The processor core.
    pub core_hz: u64,
    /// AXI and AHB (HCLK3 and the others).
    pub ahb_hz: u64,
    /// APB1 peripherals.
    pub apb1_hz: u64,
    /// APB2 peripherals.
    pub apb2_hz: u64,
    /// APB3 peripherals.
    pub apb3_hz: u64,
    /// APB4 peripherals.
    pub apb4_hz: u64,
    /// Timers of APB1 (TIM2 to 7, 12 to 14).
    pub tim_apb1_hz: u64,
    /// Timers of APB2 (TIM1, 8, 15 to 17).
    pub tim_apb2_hz: u64,
    /// Kernel clock of USART1 and 6.
    pub usart16_hz: u64,
    /// Kernel clock of USART2, 3, UART4, 5, 7, 8.
    pub usart234578_hz: u64,
    /// Kernel clock of I2C1 to 3.
    pub i2c123_hz: u64,
    /// Kernel clock of I2C4.
    pub i2c4_hz: u64,
    /// Kernel clock of SPI1 to 3.
    pub spi123_hz: u64,
    /// Kernel clock of both FDCANs.
    pub fdcan_hz: u64,
    /// Kernel clock of the ADCs.
    pub adc_hz: u64,
    /// The watchdogs' oscillator.
    pub lsi_hz: u64,
    /// 48 MHz oscillator.
    pub hsi48_hz: u64,
    /// Low-speed crystal.
    pub lse_hz: u64,
    /// The watchdogs' oscillator where the program has turned it on itself (RCC_CSR): what timers can capture.
    pub lsi_ready_hz: u64,
    /// The main crystal divided by RTCPRE.
    pub hse_rtc_hz: u64,
}

const SECOND: u64 = 1_000_000_000;

/// A count of clock ticks against virtual time, exact: no rounding adds up.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ticks {
    /// The moment of tick 0.
    pub start_ns: u64,
    /// Ticks in `per_ns` / 1e9 seconds: a frequency and its divider. Below 18 GHz.
    pub frequency_hz: u64,
    /// Divider of the frequency, at least 1.
    pub divider: u64,
}

impl Ticks {
    /// Whole ticks from the start to `now_ns`.
    #[must_use]
    pub fn at(&self, now_ns: u64) -> u64 {
        // In 64 bits: whole seconds and the rest apart, and the divider last, which rounds no differently.
        let elapsed = now_ns.saturating_sub(self.start_ns);
        let (seconds, rest) = (elapsed / SECOND, elapsed % SECOND);
        let whole = seconds.wrapping_mul(self.frequency_hz);
        let clocks = whole.wrapping_add(rest * self.frequency_hz / SECOND);
        if self.divider <= 1 { clocks } else { clocks / self.divider }
    }

    /// The first nanosecond at which [`Ticks::at`] gives `ticks`; `u64::MAX` when the clock is stopped.
    #[must_use]
    pub fn when_ns(&self, ticks: u64) -> u64 {
        if self.frequency_hz == 0 {
            return u64::MAX;
        }
        let Some(clocks) = ticks.checked_mul(self.divider.max(1)) else { return u64::MAX };
        let (seconds, rest) = (clocks / self.frequency_hz, clocks % self.frequency_hz);
        let ns = seconds.saturating_mul(SECOND).saturating_add((rest * SECOND).div_ceil(self.frequency_hz));
        ns.saturating_add(self.start_ns)
    }
}

/// Why the chip was reset; as the flags of RCC_RSR tell.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResetCause {
    /// Power came on.
    PowerOn,
    /// The NRST pin.
    Pin,
    /// SYSRESETREQ.
    Software,
    /// The independent watchdog.
    Watchdog,
    /// The supply fell below the brown-out level.
    BrownOut,
}

impl fmt::Display for ResetCause {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::PowerOn => "power on",
            Self::Pin => "reset pin (NRST)",
            Self::Software => "software (SYSRESETREQ)",
            Self::Watchdog => "independent watchdog",
            Self::BrownOut => "brown-out",
        })
    }
}

/// A wire from one peripheral to another, or to the core.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Signal {
    /// An interrupt line of the NVIC.
    Irq {
        /// Position in RM0399's vector table for the Cortex-M7, the first after the system exceptions being 0.
        number: u16,
        /// Asserted.
        level: bool,
    },
    /// A request to DMAMUX1 (DMA1, DMA2).
    Dma {
        /// Input of DMAMUX1, as in RM0399's table.
        request: u8,
        /// Asserted.
        level: bool,
    },
    /// A request to DMAMUX2 (BDMA).
    Bdma {
        /// Input of DMAMUX2.
        request: u8,
        /// Asserted.
        level: bool,
    },
    /// The trigger output of a timer.
    Trigger {
        /// 12 is TIM12.
        timer: u8,
    },
    /// A timer's channel changes its output (OCx; `complementary` is OCxN).
    TimerOutput {
        /// 12 is TIM12.
        timer: u8,
        /// 1 to 4.
        channel: u8,
        /// When: may lie before the present moment, by what was not looked at since.
        at_ns: u64,
        /// The level.
        high: bool,
    },
    /// The non-maskable interrupt's input (RM0399, 9.5.3: the clock security system).
    Nmi {
        /// Asserted.
        level: bool,
    },
    /// An input of EXTI that is no pin (RM0399, 21.4, table of the lines).
    Exti {
        /// From 16 on.
        line: u8,
        /// The level from now on.
        high: bool,
    },
    /// The clock tree has changed.
    Clocks,
    /// The chip is reset.
    Reset(ResetCause),
}

/// Something that the manual forbids, and that the chip does not answer with an error.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Misuse {
    /// When.
    pub at_ns: u64,
    /// Which peripheral, as in `RCC`.
    pub peripheral: &'static str,
    /// What, with the manual's section.
    pub what: String,
}

/// What a peripheral can see and do while it is accessed or advanced.
pub struct Context<'a> {
    /// Virtual time.
    pub now_ns: u64,
    /// The clock tree.
    pub clocks: &'a Clocks,
    /// What the pins are wired to.
    pub outside: &'a mut dyn Outside,
    /// Where signals go; carried out, in order, when the peripheral returns.
    pub signals: &'a mut Vec<Signal>,
    /// Where misuse goes.
    pub misuse: &'a mut Vec<Misuse>,
}

impl Context<'_> {
    /// Sets an interrupt line.
    pub fn irq(&mut self, number: u16, level: bool) {
        self.signals.push(Signal::Irq { number, level });
    }

    /// Sets a request line of DMAMUX1.
    pub fn dma(&mut self, request: u8, level: bool) {
        self.signals.push(Signal::Dma { request, level });
    }

    /// Reports what the manual forbids.
    pub fn misuse(&mut self, peripheral: &'static str, what: impl Into<String>) {
        self.misuse.push(Misuse { at_ns: self.now_ns, peripheral, what: what.into() });
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        #[test]
        fn a_tick_begins_when_it_is_said_to(
            start_ns in 0..1_u64 << 40, frequency_hz in 1..500_000_000_u64, divider in 1..65_537_u64, ticks in 0..1_u64 << 32,
        ) {
            let base = Ticks { start_ns, frequency_hz, divider };
            let at_ns = base.when_ns(ticks);
            prop_assume!(at_ns < u64::MAX);
            prop_assert!(base.at(at_ns) >= ticks);
            prop_assert!(at_ns == start_ns || base.at(at_ns - 1) < ticks);
        }
    }
}
