//! Byte links to hosts, and the UART connectors.
//!
//! | number | link |
//! | --- | --- |
//! | 0 | USART1, the debug header: 1 Mbaud 8N1 |
//! | 1 | FDCAN2: classic frames, bit rate and node of the configuration |
//! | 2 | USB-C: a serial port |
//!
//! All three share one type per direction, so that the code that serves a link is in flash once and not three times.

pub(crate) mod can;
mod ring;
pub(crate) mod uart;
pub(crate) mod usb;

use embassy_stm32::{mode::Async, usart::UartTx};
use embedded_io_async::{ErrorKind, ErrorType, Read, Write};

/// Error of a failed link: a USB host that is gone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Gone;

impl core::fmt::Display for Gone {
    fn fmt(&self, formatter: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        formatter.write_str("the host is gone")
    }
}

impl core::error::Error for Gone {}

impl embedded_io_async::Error for Gone {
    fn kind(&self) -> ErrorKind {
        ErrorKind::NotConnected
    }
}

/// Byte stream from a host.
#[expect(clippy::large_enum_variant, reason = "each lies in its task's memory; there is no heap to box one in")]
pub(crate) enum Receiver {
    Uart(uart::Receiver),
    Can(can::Receiver),
    Usb(usb::Receiver),
}

impl ErrorType for Receiver {
    type Error = Gone;
}

impl Read for Receiver {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Gone> {
        match self {
            Self::Uart(link) => link.read(buffer).await.map_err(|never| match never {}),
            Self::Can(link) => link.read(buffer).await.map_err(|never| match never {}),
            Self::Usb(link) => link.read(buffer).await.map_err(|_| Gone),
        }
    }
}

/// Byte stream to a host.
pub(crate) enum Sender {
    Uart(UartTx<'static, Async>),
    Can(can::Sender),
    Usb(usb::Sender),
}

impl ErrorType for Sender {
    type Error = Gone;
}

impl Write for Sender {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Gone> {
        match self {
            Self::Uart(link) => Write::write(link, bytes).await.map_err(|_| Gone),
            Self::Can(link) => link.write(bytes).await.map_err(|never| match never {}),
            Self::Usb(link) => link.write(bytes).await.map_err(|_| Gone),
        }
    }

    async fn flush(&mut self) -> Result<(), Gone> {
        match self {
            Self::Uart(link) => Write::flush(link).await.map_err(|_| Gone),
            Self::Can(link) => link.flush().await.map_err(|never| match never {}),
            Self::Usb(link) => link.flush().await.map_err(|_| Gone),
        }
    }
}
