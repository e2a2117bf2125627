//! Controller of the panel: ILI9488, 320 by 480 pixels, used in landscape.
//!
//! Its serial interface takes 18 bits per pixel in three bytes and at most 20 MHz (datasheet 17.4.3): a full picture
//! takes 184 ms. Reading its identification is not practical: a read may be clocked at 6.6 MHz at most, and common
//! panels do not release SDO, or do not connect it. So an absent screen cannot be detected.

use embassy_time::{Duration, Timer};
use embedded_graphics::pixelcolor::Rgb666;
use embedded_hal::{delay::DelayNs, digital::OutputPin, spi::SpiDevice};
use mipidsi::{
    Builder, ConfigurationError, Display, InitError,
    dcs::{
        BitsPerPixel, EnterNormalMode, ExitSleepMode, InterfaceExt, PixelFormat, SetAddressMode, SetDisplayOn,
        SetInvertMode, SetPixelFormat,
    },
    interface::{Interface, InterfaceKind, SpiInterface},
    models::{Model, ModelInitError},
    options::{ColorInversion, ColorOrder, ModelOptions, Orientation, Rotation},
};

/// Length of the reset pulse; the line must be low for at least 10 us.
const RESET_LOW: Duration = Duration::from_micros(20);
/// Time from the end of a reset to SLPOUT, if the panel was awake before it.
const RESET_TO_SLEEP_OUT: Duration = Duration::from_millis(120);
/// Time from SLPOUT to the next command: 5 ms, in which the controller loads its defaults. Its supplies settle in 120
/// ms.
const SLEEP_OUT: Duration = Duration::from_millis(120);

/// Driver of the panel, once awake.
pub type Panel<'a, SPI, DC> = Display<SpiInterface<'a, SPI, DC>, Ili9488, AlreadyReset>;

/// Error: the panel's bus or one of its lines failed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PanelError;

/// Resets and wakes the panel; takes 240 ms, without blocking. The panel then shows the noise in its memory.
///
/// # Errors
/// [`PanelError`] when SPI or a line fails; an absent panel is no error.
pub async fn start<'a, SPI, DC, RST>(
    mut interface: SpiInterface<'a, SPI, DC>,
    reset: &mut RST,
) -> Result<Panel<'a, SPI, DC>, PanelError>
where
    SPI: SpiDevice,
    DC: OutputPin,
    RST: OutputPin,
{
    reset.set_low().map_err(|_| PanelError)?;
    Timer::after(RESET_LOW).await;
    reset.set_high().map_err(|_| PanelError)?;
    Timer::after(RESET_TO_SLEEP_OUT).await;
    interface.write_command(ExitSleepMode).map_err(|_| PanelError)?;
    Timer::after(SLEEP_OUT).await;
    Builder::new(Ili9488, interface)
        .reset_pin(AlreadyReset)
        // The glass has its colour filters in this order, and its columns run from right to left.
        .color_order(ColorOrder::Bgr)
        .orientation(Orientation::new().flip_horizontal().rotate(Rotation::Deg90))
        .invert_colors(ColorInversion::Normal)
        .init(&mut AlreadyReset)
        .map_err(|_: InitError<_, _>| PanelError)
}

/// Model of an ILI9488 that is already awake.
///
/// `mipidsi` has a model of its own, which sends commands immediately after SLPOUT, and blocks during its waits.
pub struct Ili9488;

impl Model for Ili9488 {
    type ColorFormat = Rgb666;
    const FRAMEBUFFER_SIZE: (u16, u16) = (320, 480);

    fn init<DELAY, DI>(
        &mut self,
        interface: &mut DI,
        _: &mut DELAY,
        options: &ModelOptions,
    ) -> Result<SetAddressMode, ModelInitError<DI::Error>>
    where
        DELAY: DelayNs,
        DI: Interface,
    {
        if DI::KIND != InterfaceKind::Serial4Line {
            return Err(ModelInitError::InvalidConfiguration(ConfigurationError::UnsupportedInterface));
        }
        let address_mode = SetAddressMode::from(options);
        let format = PixelFormat::with_all(BitsPerPixel::from_rgb_color::<Rgb666>());
        interface.write_command(SetPixelFormat::new(format))?;
        interface.write_command(address_mode)?;
        interface.write_command(SetInvertMode::new(options.invert_colors))?;
        interface.write_command(EnterNormalMode)?;
        interface.write_command(SetDisplayOn)?;
        Ok(address_mode)
    }
}

/// Replacement for the reset line and the blocking waits, which [`start`] has already done: without a line `mipidsi`
/// would put the controller to sleep by a software reset.
pub struct AlreadyReset;

impl embedded_hal::digital::ErrorType for AlreadyReset {
    type Error = core::convert::Infallible;
}

impl OutputPin for AlreadyReset {
    fn set_low(&mut self) -> Result<(), Self::Error> {
        Ok(())
    }

    fn set_high(&mut self) -> Result<(), Self::Error> {
        Ok(())
    }
}

impl DelayNs for AlreadyReset {
    fn delay_ns(&mut self, _: u32) {}
}
