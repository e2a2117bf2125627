//! UARTs: reception by DMA into a ring, continuously; transmission by DMA.
//!
//! embassy sends. Its receiver is not used: after a byte with a framing error or noise it stops its DMA stream and
//! starts it again without setting NDTR and the address anew, which RM0399, 15.3.13 demands. The place where the stream
//! then writes and the place that the reader takes for new may differ, so that old requests can be carried out again;
//! and bytes received until the reader comes are lost. Here the stream never stops ([`Stream`]). A line error costs the
//! damaged byte only; the frames have a CRC.

use core::{
    convert::Infallible,
    future::poll_fn,
    sync::atomic::{AtomicU32, Ordering},
    task::Poll,
};

use embassy_stm32::{
    Peri,
    gpio::{AfType, Flex},
    interrupt::{Interrupt, InterruptExt, typelevel},
    mode::Async,
    pac::{self, usart::Usart},
    peripherals,
    usart::{Config, Instance, RxDma, RxPin, UartTx},
};
use embedded_io_async::{ErrorType, Read};

use super::ring::{Late, Ring, Stream};

/// Baud rate of the host's link at the debug header.
pub(crate) const HOST_BAUD: u32 = 1_000_000;
/// Baud rate of the UART connectors.
pub(crate) const CONNECTOR_BAUD: u32 = 115_200;

/// Configuration with 8 bits, no parity, one stop bit.
pub(crate) fn config(baud: u32) -> Config {
    let mut config = Config::default();
    config.baudrate = baud;
    config
}

/// Receiving half of a UART, below embassy.
pub(crate) struct Port {
    name: &'static str,
    registers: Usart,
    stream: Stream,
    /// Interrupts of the UART and of the stream.
    interrupts: [Interrupt; 2],
    /// Number of line errors found, modulo 2^32; those of one burst count once.
    line_errors: AtomicU32,
}

/// UART with a fixed DMA stream, which must not be used for anything else.
pub(crate) trait Receives: Instance {
    /// DMA stream of its receiver.
    type Stream: RxDma<Self>;
    /// Registers, ring and counters of its receiver.
    const PORT: &'static Port;
}

macro_rules! port {
    ($uart:ident, $dma:ident, $number:literal, $channel:literal, $stream:ident, $vector:ident) => {
        impl Receives for peripherals::$uart {
            type Stream = peripherals::$stream;
            const PORT: &'static Port = {
                static RING: Ring = Ring::new();
                static PORT: Port = Port {
                    name: stringify!($uart),
                    registers: pac::$uart,
                    stream: Stream { controller: pac::$dma, number: $number, channel: $channel, ring: &RING },
                    interrupts: [Interrupt::$uart, Interrupt::$vector],
                    line_errors: AtomicU32::new(0),
                };
                &PORT
            };
        }

        impl typelevel::Handler<typelevel::$uart> for OnLine {
            #[allow(unsafe_code, reason = "the trait's")]
            unsafe fn on_interrupt() {
                <peripherals::$uart as Receives>::PORT.on_line();
            }
        }

        impl typelevel::Handler<typelevel::$vector> for OnRing {
            #[allow(unsafe_code, reason = "the trait's")]
            unsafe fn on_interrupt() {
                <peripherals::$uart as Receives>::PORT.stream.on_interrupt();
            }
        }
    };
}

/// Handler of a UART's interrupt, to be bound *after* embassy's, which serves the transmitter but disables the
/// interrupt of an idle line when it finds one.
pub(crate) struct OnLine;

/// Handler of the interrupt of a receiver's stream, in place of embassy's.
pub(crate) struct OnRing;

port!(USART1, DMA1, 5, 5, DMA1_CH5, DMA1_STREAM5);
port!(USART2, DMA1, 7, 7, DMA1_CH7, DMA1_STREAM7);
port!(UART4, DMA2, 1, 9, DMA2_CH1, DMA2_STREAM1);

impl Port {
    /// Reads and clears line errors and the idle flag. Errors alone do not interrupt (EIE is 0: embassy's handler would
    /// disable the reception); they are found when the line falls silent after them.
    fn on_line(&self) {
        let flags = self.registers.isr().read();
        // Clears only the flags that were read: later events interrupt again.
        self.registers.icr().write(|w| {
            w.set_pe(flags.pe());
            w.set_fe(flags.fe());
            w.set_ne(flags.ne());
            w.set_ore(flags.ore());
            w.set_idle(flags.idle());
        });
        if flags.pe() || flags.fe() || flags.ne() || flags.ore() {
            self.line_errors.fetch_add(1, Ordering::Relaxed);
        }
        // The tasks that change CR1 do not run before this returns, and always find IDLEIE set.
        if !self.registers.cr1().read().idleie() {
            self.registers.cr1().modify(|w| w.set_idleie(true));
        }
        if flags.idle() {
            self.stream.ring.waker.wake();
        }
    }

    /// Starts the receiver of a UART that embassy has set up to send.
    fn start(&self, request: u8) {
        let usart = self.registers;
        // Some bits of CR3 can be written only while UE is 0 (RM0399, 51.8.4). Nothing is being sent yet.
        usart.cr1().modify(|w| w.set_ue(false));
        usart.cr3().modify(|w| {
            // A byte that the stream did not fetch in time is replaced by the next, so that this one is not lost too.
            w.set_ovrdis(true);
            w.set_eie(false);
            // Line errors do not end the DMA requests.
            w.set_ddre(false);
            w.set_dmar(true);
        });
        self.stream.start(request, usart.rdr().as_ptr().cast());
        usart.cr1().modify(|w| {
            w.set_ue(true);
            w.set_re(true);
            w.set_idleie(true);
        });
        for interrupt in self.interrupts {
            interrupt.unpend();
            #[allow(unsafe_code, reason = "turns an interrupt on")]
            // SAFETY: no critical section relies on the interrupt being disabled; its handlers share atomics only.
            unsafe {
                interrupt.enable();
            }
        }
    }
}

/// Starts the receiver of the UART that `_sender` sends with. The receiver owns the DMA stream permanently.
pub(crate) fn receive<T: Receives>(
    _sender: &UartTx<'static, Async>,
    pin: Peri<'static, impl RxPin<T>>,
    stream: Peri<'static, T::Stream>,
) -> Receiver {
    let function = pin.af_num();
    let mut pin = Flex::new(pin);
    pin.set_as_af_unchecked(function, AfType::input(Config::default().rx_pull));
    T::PORT.start(stream.request());
    Receiver { port: T::PORT, position: 0, line_errors: 0, _pin: pin }
}

/// Receiver that continues through all errors on the line.
///
/// Damaged bytes are in the stream, or missing from it: the frame layer finds where a frame begins and whether it is
/// complete. After a read that comes so late that the ring was filled, reading continues with the newest bytes.
pub(crate) struct Receiver {
    port: &'static Port,
    /// Number of bytes read or skipped, modulo 2^32.
    position: u32,
    /// Number of line errors that have been logged.
    line_errors: u32,
    /// Owner of the pin; dropping it would disconnect the pin.
    _pin: Flex<'static>,
}

impl Receiver {
    fn take(&mut self, buffer: &mut [u8]) -> usize {
        let line_errors = self.port.line_errors.load(Ordering::Relaxed);
        if line_errors != self.line_errors {
            self.line_errors = line_errors;
            defmt::info!("{=str}: {=u32} times line errors", self.port.name, line_errors);
        }
        match self.port.stream.read(&mut self.position, buffer) {
            Ok(count) => count,
            Err(Late(bytes)) => {
                defmt::warn!("{=str}: {=u32} bytes lost, read too late", self.port.name, bytes);
                0
            }
        }
    }
}

impl ErrorType for Receiver {
    type Error = Infallible;
}

impl Read for Receiver {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        if buffer.is_empty() {
            return Ok(0);
        }
        poll_fn(|context| {
            // Registered first: a byte that arrives after the check must wake the task.
            self.port.stream.ring.waker.register(context.waker());
            match self.take(buffer) {
                0 => Poll::Pending,
                count => Poll::Ready(Ok(count)),
            }
        })
        .await
    }
}
