//! Task that drives the screen.

use core::convert::Infallible;

use embassy_time::{Duration, Timer};
use embedded_hal::{digital::OutputPin, spi::SpiDevice};
use mipidsi::interface::SpiInterface;

use super::{
    draw::draw,
    panel::{PanelError, start},
    view::Source,
};

/// Interval between two pictures.
const REFRESH: Duration = Duration::from_millis(200);
/// Pause after a failure before the panel is started again.
const RETRY: Duration = Duration::from_secs(5);
/// Maximum size of an SPI transfer, bytes; pixels are gathered in it.
const BUFFER: usize = 510;

/// SPI bus and lines of the screen.
pub struct ScreenPins<SPI, DC, RST, BL> {
    /// Mode 0, most significant bit first, at most 20 MHz, with its chip select.
    pub spi: SPI,
    /// Low for commands, high for data.
    pub data_command: DC,
    /// Reset line, active low.
    pub reset: RST,
    /// Backlight line; high lights the screen.
    pub backlight: BL,
}

/// Shows `source` indefinitely, five times a second.
///
/// SPI is blocking here: the first picture takes 230 ms at 20 MHz, a change of state up to 160 ms, motion 1 to 2 ms.
/// This task must run alone on an executor of the lowest priority, below the links, so that all others interrupt it.
///
/// An absent screen cannot be detected (see the panel): its pixels go nowhere, without any effect. A screen must be
/// plugged in before power comes on. When SPI or a line fails, the backlight goes off and the task sleeps for 5 s
/// before it starts the panel again.
pub async fn run<S, SPI, DC, RST, BL>(source: &S, mut pins: ScreenPins<SPI, DC, RST, BL>) -> !
where
    S: Source,
    SPI: SpiDevice,
    DC: OutputPin,
    RST: OutputPin,
    BL: OutputPin,
{
    loop {
        // Dark while the panel shows noise. A failing backlight line is ignored: the picture is still drawn.
        let _ = pins.backlight.set_low();
        let Err(PanelError) = show(source, &mut pins).await;
        let _ = pins.backlight.set_low();
        Timer::after(RETRY).await;
    }
}

/// Shows `source` until SPI or a line fails.
async fn show<S, SPI, DC, RST, BL>(
    source: &S,
    pins: &mut ScreenPins<SPI, DC, RST, BL>,
) -> Result<Infallible, PanelError>
where
    S: Source,
    SPI: SpiDevice,
    DC: OutputPin,
    RST: OutputPin,
    BL: OutputPin,
{
    let mut buffer = [0; BUFFER];
    let interface = SpiInterface::new(&mut pins.spi, &mut pins.data_command, &mut buffer);
    let mut panel = start(interface, &mut pins.reset).await?;
    let mut last = None;
    loop {
        let view = source.view();
        draw(&mut panel, &view, last.as_ref()).map_err(|_| PanelError)?;
        last = Some(view);
        let _ = pins.backlight.set_high();
        Timer::after(REFRESH).await;
    }
}
