//! UARTs: received by DMA into a ring all the time, sent by DMA.

use embassy_stm32::{
    mode::Async,
    usart::{Config, Error, RingBufferedUartRx, Uart, UartTx},
};
use embassy_time::{Duration, Timer};
use embedded_io_async::{ErrorType, Read};

/// The link to the host at the debug header.
pub(crate) const HOST_BAUD: u32 = 1_000_000;
/// The UART connectors.
pub(crate) const CONNECTOR_BAUD: u32 = 115_200;
/// Of one receiver: 10 ms at 1 Mbaud. Half of it must be read out while the other half fills.
pub(crate) const RING: usize = 1024;
/// Before a receiver that failed is started again: one that fails for ever must not keep the processor.
const PAUSE: Duration = Duration::from_micros(100);

/// 8 bits, no parity, one stop bit.
pub(crate) fn config(baud: u32) -> Config {
    let mut config = Config::default();
    config.baudrate = baud;
    config
}

/// The two halves of a UART.
pub(crate) fn split(uart: Uart<'static, Async>, ring: &'static mut [u8; RING]) -> (Receiver, UartTx<'static, Async>) {
    let (tx, rx) = uart.split();
    (Receiver(rx.into_ring_buffered(ring)), tx)
}

/// A receiver that goes on after an error.
///
/// A byte with a wrong frame, noise, or a reader that came too late costs what was received up to then, and the time until the
/// receiver runs again, which is why the bytes themselves say where a frame begins. The host's end of a link that is plugged in
/// makes such errors; they must not end the link.
pub(crate) struct Receiver(RingBufferedUartRx<'static>);

impl ErrorType for Receiver {
    type Error = Error;
}

impl Read for Receiver {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Error> {
        loop {
            match self.0.read(buffer).await {
                Ok(len) => return Ok(len),
                Err(_) => Timer::after(PAUSE).await,
            }
        }
    }
}
