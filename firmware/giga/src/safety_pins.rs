//! The lines that stop the board without the I2C bus, from the first instruction to the last.

use core::convert::Infallible;

use embassy_stm32::{
    exti::ExtiInput,
    gpio::{Input, Output},
    mode::Async,
    pac::{RCC, gpio::vals::Moder},
};
use embassy_time::{Duration, block_for};
use embedded_hal::digital::{ErrorType, InputPin, OutputPin};
use embedded_hal_async::digital::Wait;

use crate::{
    pins::{DAC_LDAC_N, LED_B, LED_G, LED_R, OSMC_DIS, PCA_OE_N},
    watchdog,
};

/// Turns every bridge off: clocks to the ports, levels first, then the outputs.
///
/// The very first thing that the firmware does, before it clears its memory's users or touches a clock. Lights go off.
pub(crate) fn claim() {
    // All eleven ports, A to K; what they control is not known before the carrier's file is read, which is at build time, and
    // they cost nothing.
    RCC.ahb4enr().modify(|w| w.0 |= 0x7FF);
    // A port's clock runs two cycles after the write; reading it back takes longer.
    let _ = RCC.ahb4enr().read();
    for (line, high) in
        [(OSMC_DIS, true), (PCA_OE_N, true), (DAC_LDAC_N, false), (LED_R, true), (LED_G, true), (LED_B, true)]
    {
        line.set(high);
        line.registers().moder().modify(|w| w.set_moder(usize::from(line.number), Moder::OUTPUT));
    }
}

/// Turns every bridge off, whoever drives the lines: for the handlers of panics and faults. Takes no lock.
pub(crate) fn stop() {
    OSMC_DIS.set(true);
    PCA_OE_N.set(true);
    LED_R.set(false);
    LED_G.set(true);
}

/// Red and blue together, `times` times, in 0.3 s each: a fault of the board that does not keep it from working. For the
/// boot, when the lights have no other meaning yet.
pub(crate) fn blink(times: u32) {
    for _ in 0..times {
        for high in [false, true] {
            LED_R.set(high);
            LED_B.set(high);
            block_for(Duration::from_millis(150));
        }
    }
}

/// An input of the supervisor.
pub(crate) enum Line {
    /// The dead-man's handle, with an interrupt.
    Watched(ExtiInput<'static, Async>),
    /// The auxiliary stop, looked at each millisecond.
    Polled(Input<'static>),
}

impl ErrorType for Line {
    type Error = Infallible;
}

impl InputPin for Line {
    fn is_high(&mut self) -> Result<bool, Infallible> {
        Ok(match self {
            Self::Watched(line) => line.is_high()?,
            Self::Polled(line) => line.is_high()?,
        })
    }

    fn is_low(&mut self) -> Result<bool, Infallible> {
        self.is_high().map(|high| !high)
    }
}

/// A polled line has no interrupt to wait for: waits for it never end, except for a level that it has. The supervisor looks
/// at it each period and never waits for it.
impl Wait for Line {
    async fn wait_for_high(&mut self) -> Result<(), Infallible> {
        match self {
            Self::Watched(line) => line.wait_for_high().await,
            Self::Polled(line) => {
                if line.is_low()? {
                    core::future::pending::<()>().await;
                }
            }
        }
        Ok(())
    }

    async fn wait_for_low(&mut self) -> Result<(), Infallible> {
        match self {
            Self::Watched(line) => line.wait_for_low().await,
            Self::Polled(line) => {
                if line.is_high()? {
                    core::future::pending::<()>().await;
                }
            }
        }
        Ok(())
    }

    async fn wait_for_rising_edge(&mut self) -> Result<(), Infallible> {
        match self {
            Self::Watched(line) => line.wait_for_rising_edge().await,
            Self::Polled(_) => core::future::pending().await,
        }
        Ok(())
    }

    async fn wait_for_falling_edge(&mut self) -> Result<(), Infallible> {
        match self {
            Self::Watched(line) => line.wait_for_falling_edge().await,
            Self::Polled(_) => core::future::pending().await,
        }
        Ok(())
    }

    async fn wait_for_any_edge(&mut self) -> Result<(), Infallible> {
        match self {
            Self::Watched(line) => line.wait_for_any_edge().await,
            Self::Polled(_) => core::future::pending().await,
        }
        Ok(())
    }
}

/// An output of the supervisor.
pub(crate) struct Drive {
    line: Output<'static>,
    feeds: bool,
}

impl Drive {
    /// A plain output.
    pub(crate) fn plain(line: Output<'static>) -> Self {
        Self { line, feeds: false }
    }

    /// The heartbeat: the supervisor alone turns it, once in each of its periods, and each turn feeds the watchdog. So the
    /// watchdog watches exactly what an external one at this line would.
    pub(crate) fn heartbeat(line: Output<'static>) -> Self {
        Self { line, feeds: true }
    }
}

impl ErrorType for Drive {
    type Error = Infallible;
}

impl OutputPin for Drive {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.line.set_low();
        if self.feeds {
            watchdog::feed();
        }
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.line.set_high();
        if self.feeds {
            watchdog::feed();
        }
        Ok(())
    }
}
