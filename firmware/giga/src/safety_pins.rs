//! Lines that stop the board without the I2C bus, from the first instruction to the last.

use core::convert::Infallible;

use embassy_stm32::{
    exti::ExtiInput,
    gpio::{Input, Level, Output},
    mode::Async,
    pac::{RCC, gpio::vals::Moder},
};
use embassy_time::{Duration, Instant};
use embedded_hal::digital::{ErrorType, InputPin, OutputPin};
use embedded_hal_async::digital::Wait;

use crate::{
    pins::{DAC_LDAC_N, LED_B, LED_G, LED_R, OSMC_DIS, PCA_OE_N},
    watchdog,
};

/// Turns every bridge off: clocks to the ports, levels first, then the outputs.
///
/// This is the firmware's very first action, before it initialises memory or clocks. Lights go off.
pub(crate) fn claim() {
    // All eleven ports, A to K: it costs nothing to enable those that the carrier's file does not use.
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

/// Turns every bridge off, regardless of the lines' owner: for the handlers of panics and faults. Takes no lock.
pub(crate) fn stop() {
    OSMC_DIS.set(true);
    PCA_OE_N.set(true);
    LED_R.set(false);
    LED_G.set(true);
}

/// Sets the lights of hold mode: red alone, which flashes.
pub(crate) fn show_hold(red: bool) {
    LED_R.set(!red);
    LED_G.set(true);
    LED_B.set(true);
}

/// Half a period of [`Flashes`].
const HALF_FLASH: Duration = Duration::from_millis(150);

/// Flashes of red and blue together, 0.3 s each: a fault of the board that does not keep it from working. The lights
/// have their own meanings afterwards, and nothing waits for the flashes.
#[derive(Clone, Copy)]
pub(crate) struct Flashes {
    until: Instant,
}

impl Flashes {
    /// Creates `times` flashes from now on.
    pub(crate) fn new(times: u32) -> Self {
        Self { until: Instant::now() + 2 * times * HALF_FLASH }
    }

    /// State of the lights, true for on; `None` when the flashes are over.
    fn lit(self) -> Option<bool> {
        let left = self.until.checked_duration_since(Instant::now()).filter(|left| *left > Duration::MIN)?;
        Some(left.as_ticks().div_ceil(HALF_FLASH.as_ticks()) % 2 == 0)
    }
}

/// Input of the supervisor.
pub(crate) enum Line {
    /// Dead-man's handle, with an interrupt.
    Watched(ExtiInput<'static, Async>),
    /// Auxiliary stop, polled each millisecond.
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

/// A polled line has no interrupt to wait for: waits never end, except for a level that it already has. The supervisor
/// polls it each period and never waits for it.
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

/// Output of the supervisor.
pub(crate) struct Drive {
    line: Output<'static>,
    also: Also,
}

/// Additional action of a [`Drive`].
enum Also {
    Nothing,
    /// Feeds the watchdog; the number is that of the remaining heartbeats until it does.
    FeedsTheWatchdog(u8),
    Flashes(Flashes),
}

impl Drive {
    /// Creates a plain output.
    pub(crate) fn plain(line: Output<'static>) -> Self {
        Self { line, also: Also::Nothing }
    }

    /// Creates the heartbeat: only the supervisor toggles it, once in each of its periods, and every
    /// [`watchdog::BEATS`] toggles feed the watchdog. So the watchdog checks exactly what an external one at this line
    /// would.
    pub(crate) fn heartbeat(line: Output<'static>) -> Self {
        Self { line, also: Also::FeedsTheWatchdog(watchdog::BEATS) }
    }

    /// Creates a light, on while low, that flashes first. The supervisor writes it in each of its periods, so it needs
    /// no task.
    pub(crate) fn light(line: Output<'static>, flashes: Option<Flashes>) -> Self {
        Self { line, also: flashes.map_or(Also::Nothing, Also::Flashes) }
    }

    fn set(&mut self, mut high: bool) {
        match &mut self.also {
            Also::Nothing => {}
            Also::FeedsTheWatchdog(left) => {
                *left -= 1;
                if *left == 0 {
                    watchdog::feed();
                    *left = watchdog::BEATS;
                }
            }
            Also::Flashes(flashes) => match flashes.lit() {
                Some(lit) => high = !lit,
                None => self.also = Also::Nothing,
            },
        }
        self.line.set_level(if high { Level::High } else { Level::Low });
    }
}

impl ErrorType for Drive {
    type Error = Infallible;
}

impl OutputPin for Drive {
    fn set_low(&mut self) -> Result<(), Infallible> {
        self.set(false);
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Infallible> {
        self.set(true);
        Ok(())
    }
}
