//! Environment that all peripherals share: time, clocks, and the wires between them.

use std::fmt;

use crate::outside::Outside;

/// Frequencies of the clock tree, Hz; 0 means stopped. The RCC model derives them from its registers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Clocks {
    /// Clock of the processor core.
    pub core_hz: u64,
    /// Clock of AXI and AHB (HCLK3 and the others).
    pub ahb_hz: u64,
    /// Bus clock of APB1 peripherals.
    pub apb1_hz: u64,
    /// Bus clock of APB2 peripherals.
    pub apb2_hz: u64,
    /// Bus clock of APB3 peripherals.
    pub apb3_hz: u64,
    /// Bus clock of APB4 peripherals.
    pub apb4_hz: u64,
    /// Kernel clock of APB1's timers (TIM2 to 7, 12 to 14).
    pub tim_apb1_hz: u64,
    /// Kernel clock of APB2's timers (TIM1, 8, 15 to 17).
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
    /// LSI, the watchdogs' oscillator.
    pub lsi_hz: u64,
    /// HSI48, the 48 MHz oscillator.
    pub hsi48_hz: u64,
    /// LSE, the low-speed crystal.
    pub lse_hz: u64,
    /// LSI if the program has turned it on itself (RCC_CSR), so that timers can capture it.
    pub lsi_ready_hz: u64,
    /// HSE divided by RTCPRE.
    pub hse_rtc_hz: u64,
}

const SECOND: u64 = 1_000_000_000;

/// Exact count of clock ticks over virtual time: rounding errors do not accumulate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Ticks {
    /// Time of tick 0, ns.
    pub start_ns: u64,
    /// Ticks in `divider` seconds: a clock frequency whose divider is separate, below 18 GHz.
    pub frequency_hz: u64,
    /// Divider of the frequency, at least 1.
    pub divider: u64,
}

impl Ticks {
    /// Returns the whole ticks from the start to `now_ns`.
    #[must_use]
    pub fn at(&self, now_ns: u64) -> u64 {
        // The arithmetic fits 64 bits: whole seconds and the rest are separate, and the divider comes last, which does
        // not change the rounding.
        let elapsed = now_ns.saturating_sub(self.start_ns);
        let (seconds, rest) = (elapsed / SECOND, elapsed % SECOND);
        let whole = seconds.wrapping_mul(self.frequency_hz);
        let clocks = whole.wrapping_add(rest * self.frequency_hz / SECOND);
        if self.divider <= 1 { clocks } else { clocks / self.divider }
    }

    /// Returns the first nanosecond at which [`Ticks::at`] gives `ticks`; `u64::MAX` for a stopped clock.
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

/// Cause of a reset of the chip, as in the flags of RCC_RSR.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ResetCause {
    /// Power-on, or a supply below the power-down level.
    PowerOn,
    /// Low level at the NRST pin.
    Pin,
    /// Request by the program (SYSRESETREQ).
    Software,
    /// Time-out of the independent watchdog.
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

/// Signal on a wire from one peripheral to another, or to the core.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Signal {
    /// Interrupt line of the NVIC.
    Irq {
        /// Position in RM0399's vector table for the Cortex-M7, the first after the system exceptions being 0.
        number: u16,
        /// True while the line is asserted.
        level: bool,
    },
    /// Request line to DMAMUX1 (DMA1, DMA2).
    Dma {
        /// Input of DMAMUX1, as in RM0399's table.
        request: u8,
        /// True while the request is asserted.
        level: bool,
    },
    /// Request line to DMAMUX2 (BDMA).
    Bdma {
        /// Input number of DMAMUX2.
        request: u8,
        /// True while the request is asserted.
        level: bool,
    },
    /// Pulse at a timer's trigger output.
    Trigger {
        /// Number of the timer; 12 is TIM12.
        timer: u8,
    },
    /// Change of a timer channel's output (OCx; `complementary` is OCxN).
    TimerOutput {
        /// Number of the timer; 12 is TIM12.
        timer: u8,
        /// Number of the channel, 1 to 4.
        channel: u8,
        /// Time of the change, ns; may lie before the present time, because peripherals compute lazily.
        at_ns: u64,
        /// Level of the output after the change.
        high: bool,
    },
    /// Input of the non-maskable interrupt (RM0399, 9.5.3: the clock security system).
    Nmi {
        /// True while the input is asserted.
        level: bool,
    },
    /// Input of EXTI that is not a pin (RM0399, 21.4, table of the lines).
    Exti {
        /// Number of the line, from 16 on.
        line: u8,
        /// Level of the input from now on.
        high: bool,
    },
    /// Change of the clock tree.
    Clocks,
    /// Reset of the chip.
    Reset(ResetCause),
}

/// Violation of the manual that the chip does not answer with an error.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Misuse {
    /// Virtual time of the violation, ns.
    pub at_ns: u64,
    /// Name of the peripheral, as in `RCC`.
    pub peripheral: &'static str,
    /// Description of the violation, with the manual's section.
    pub what: String,
}

/// Environment of a peripheral while it is accessed or advanced.
pub struct Context<'a> {
    /// Present virtual time, ns.
    pub now_ns: u64,
    /// Frequencies of the clock tree.
    pub clocks: &'a Clocks,
    /// Outside world at the chip's pins.
    pub outside: &'a mut dyn Outside,
    /// Signals given off by the peripheral; they are carried out in order when it returns.
    pub signals: &'a mut Vec<Signal>,
    /// Record of misuse, to append to.
    pub misuse: &'a mut Vec<Misuse>,
}

impl Context<'_> {
    /// Sets the level of an interrupt line.
    pub fn irq(&mut self, number: u16, level: bool) {
        self.signals.push(Signal::Irq { number, level });
    }

    /// Sets the level of a request line of DMAMUX1.
    pub fn dma(&mut self, request: u8, level: bool) {
        self.signals.push(Signal::Dma { request, level });
    }

    /// Reports a violation of the manual.
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
