//! USART1, 2, 3, 6 and UART4, 5, 7, 8 (RM0399, chapter 51): asynchronous, with and without FIFOs.
//!
//! Each frame takes exactly the time of the kernel clock, PRESC, BRR and OVER8: a run of frames is counted in half bits
//! from the start of the first, so that rounding errors do not accumulate. Sent bytes reach
//! [`Outside::uart_sent`](crate::Outside::uart_sent) at the end of their stop bit; received ones are queued by
//! [`Usart::receive`].
//!
//! Choices where the manual is open: an idle transmitter starts a frame at the moment of the write (the chip waits for
//! its next bit clock, less than a bit); TEACK and REACK follow at once; a byte that began before the receiver was on
//! is lost. IDLE is detected one frame after the receiver was switched on at an idle line (51.5.10), and after each
//! burst.
//!
//! Synchronous, slave, half-duplex, LIN, IrDA and Smartcard modes, mute mode, baud-rate detection, breaks, flow
//! control, driver enable, swapped or inverted lines, and nine data bits without parity are not modelled and end the
//! run.

mod access;
mod receive;
mod registers;
mod transmit;

#[cfg(test)]
mod tests;

use crate::context::{Clocks, Context, Ticks};
use crate::outside::UartByte;

use self::receive::Receiver;
use self::registers::{cr1, cr2, cr3, isr};
use self::transmit::Transmitter;

/// Depth of each FIFO (RM0399, 51.5.4).
const FIFO_DEPTH: usize = 16;

/// Division of the kernel clock by PRESCALER (RM0399, 51.8.14); codes above divide by 256.
const PRESCALER: [u64; 12] = [1, 2, 4, 6, 8, 10, 12, 16, 32, 64, 128, 256];

/// Properties that distinguish the ports.
#[derive(Clone, Copy, Debug)]
struct Port {
    number: u8,
    name: &'static str,
    /// Interrupt number (RM0399, chapter 20).
    irq: u16,
    /// Input numbers of DMAMUX1 (RM0399, table 126).
    rx_request: u8,
    tx_request: u8,
}

const fn port(number: u8, name: &'static str, irq: u16, rx_request: u8) -> Port {
    Port { number, name, irq, rx_request, tx_request: rx_request + 1 }
}

const PORTS: [Port; 8] = [
    port(1, "USART1", 37, 41),
    port(2, "USART2", 38, 43),
    port(3, "USART3", 39, 45),
    port(4, "UART4", 52, 63),
    port(5, "UART5", 53, 65),
    port(6, "USART6", 71, 71),
    port(7, "UART7", 82, 79),
    port(8, "UART8", 83, 81),
];

/// State of one of the eight ports.
#[derive(Clone, Debug)]
pub struct Usart {
    port: Port,
    cr1: u32,
    cr2: u32,
    cr3: u32,
    brr: u32,
    rtor: u32,
    presc: u32,
    /// Flags of ISR that stay until they are cleared.
    kept: u32,
    /// TXFECF was written since the FIFO became empty.
    txfe_cleared: bool,
    kernel_hz: u64,
    transmitter: Transmitter,
    receiver: Receiver,
    /// Lines as last reported: interrupt, DMA for reception, DMA for transmission.
    lines: (bool, bool, bool),
}

impl Usart {
    /// Makes port `number`: 1, 2, 3, 6 are USARTs, 4, 5, 7, 8 UARTs. `None` for any other number.
    #[must_use]
    pub fn new(number: u8) -> Option<Self> {
        let port = *PORTS.iter().find(|port| port.number == number)?;
        Some(Self {
            port,
            cr1: 0,
            cr2: 0,
            cr3: 0,
            brr: 0,
            rtor: 0,
            presc: 0,
            kept: isr::TC,
            txfe_cleared: false,
            kernel_hz: 0,
            transmitter: Transmitter::default(),
            receiver: Receiver::default(),
            lines: (false, false, false),
        })
    }

    /// Returns the name, as in `USART1`.
    #[must_use]
    pub fn name(&self) -> &'static str {
        self.port.name
    }

    /// Queues an incoming byte. Call it before its start bit, at least a frame before `byte.at_ns`, and in order of
    /// time. A later call still receives the byte, but IDLE and the receiver timeout may have come before it.
    pub fn receive(&mut self, byte: UartByte) {
        self.receiver.queue(byte);
    }

    /// Returns the baud rate of both directions by the clock tree at the last access, bit/s; 0 for a stopped clock.
    #[must_use]
    pub fn baud(&self) -> f64 {
        let half_bits = self.half_bits_from(0);
        if half_bits.frequency_hz == 0 {
            return 0.0;
        }
        half_bits.frequency_hz as f64 / half_bits.divider as f64 / 2.0
    }

    /// Returns the duration of a frame from the start bit to the end of the last stop bit, ns, rounded up; `u64::MAX`
    /// for a stopped clock.
    #[must_use]
    pub fn frame_ns(&self) -> u64 {
        self.half_bits_from(0).when_ns(self.frame_half_bits())
    }

    fn kernel_hz_of(&self, clocks: &Clocks) -> u64 {
        match self.port.number {
            1 | 6 => clocks.usart16_hz,
            _ => clocks.usart234578_hz,
        }
    }

    /// Returns the count of half bits from `start_ns` on (RM0399, 51.5.7).
    fn half_bits_from(&self, start_ns: u64) -> Ticks {
        let prescaler = PRESCALER[(self.presc as usize).min(PRESCALER.len() - 1)];
        let brr = u64::from(self.brr);
        let (clocks, divider) = if self.cr1 & cr1::OVER8 == 0 {
            // Without OVER8 a bit takes BRR clocks, so a half bit takes BRR / 2.
            (2, brr)
        } else {
            // With OVER8, BRR[2:0] is USARTDIV[3:0] shifted right by one.
            (4, brr & 0xFFF0 | (brr & 7) << 1)
        };
        let frequency_hz = if divider == 0 { 0 } else { self.kernel_hz * clocks };
        Ticks { start_ns, frequency_hz, divider: divider * prescaler }
    }

    /// Returns the length of a frame in half bits: start bit, data with parity, stop bits.
    fn frame_half_bits(&self) -> u64 {
        let bits = match self.cr1 & (cr1::M1 | cr1::M0) {
            cr1::M0 => 9,
            cr1::M1 => 7,
            _ => 8,
        };
        let stop_half_bits = [2, 1, 4, 3][(self.cr2 >> cr2::STOP_AT & 3) as usize];
        2 * (1 + bits) + stop_half_bits
    }

    /// Returns the mask of the data bits in a frame.
    fn data_mask(&self) -> u8 {
        let bits = match self.cr1 & (cr1::M1 | cr1::M0) {
            cr1::M0 => 9,
            cr1::M1 => 7,
            _ => 8,
        };
        let data = bits - u32::from(self.cr1 & cr1::PCE != 0);
        (0xFF_u32 >> 8_u32.saturating_sub(data)) as u8
    }

    fn on(&self, bit: u32) -> bool {
        self.cr1 & bit != 0
    }

    fn enabled(&self) -> bool {
        self.on(cr1::UE)
    }

    fn fifo(&self) -> bool {
        self.on(cr1::FIFOEN)
    }

    /// Returns the number of characters that the transmitter's FIFO or TDR holds.
    fn transmit_capacity(&self) -> usize {
        if self.fifo() { FIFO_DEPTH } else { 1 }
    }

    /// Returns the number of characters that the receiver holds: its FIFO and RDR, or RDR alone (RM0399, 51.8.9, RXFF).
    fn receive_capacity(&self) -> usize {
        if self.fifo() { FIFO_DEPTH + 1 } else { 1 }
    }

    /// Returns the value of ISR (RM0399, 51.8.9 and 51.8.10).
    fn isr(&self, now_ns: u64) -> u32 {
        let mut value = self.kept;
        let mut set = |condition: bool, bit: u32| {
            if condition {
                value |= bit;
            }
        };
        let waiting = self.transmitter.waiting();
        let held = self.receiver.held();
        set(held > 0, isr::RXNE);
        set(waiting < self.transmit_capacity(), isr::TXE);
        set(self.enabled() && self.on(cr1::TE), isr::TEACK);
        set(self.enabled() && self.on(cr1::RE), isr::REACK);
        set(self.receiver_on() && self.receiver.busy(now_ns, self.frame_ns()), isr::BUSY);
        if self.fifo() {
            set(waiting == 0 && !self.txfe_cleared, isr::TXFE);
            set(held == self.receive_capacity(), isr::RXFF);
            set(FIFO_DEPTH - waiting >= threshold(self.cr3 >> cr3::TXFTCFG_AT), isr::TXFT);
            set(held >= threshold(self.cr3 >> cr3::RXFTCFG_AT), isr::RXFT);
        }
        value
    }

    fn receiver_on(&self) -> bool {
        self.enabled() && self.on(cr1::RE)
    }

    /// Updates the interrupt and request lines from the flags.
    fn update_lines(&mut self, context: &mut Context<'_>) {
        let isr = self.isr(context.now_ns);
        let errors = isr & (isr::FE | isr::NE | isr::ORE) != 0;
        let interrupt = self.enabled()
            && [
                (self.on(cr1::TXEIE), isr & isr::TXE != 0),
                (self.on(cr1::TCIE), isr & isr::TC != 0),
                (self.on(cr1::RXNEIE), isr & (isr::RXNE | isr::ORE) != 0),
                (self.on(cr1::IDLEIE), isr & isr::IDLE != 0),
                (self.on(cr1::PEIE), isr & isr::PE != 0),
                (self.on(cr1::CMIE), isr & isr::CMF != 0),
                (self.on(cr1::RTOIE), isr & isr::RTOF != 0),
                (self.on(cr1::TXFEIE), isr & isr::TXFE != 0),
                (self.on(cr1::RXFFIE), isr & isr::RXFF != 0),
                (self.cr3 & cr3::EIE != 0, errors),
                (self.cr3 & cr3::RXFTIE != 0, isr & isr::RXFT != 0),
                (self.cr3 & cr3::TXFTIE != 0, isr & isr::TXFT != 0),
            ]
            .iter()
            .any(|(enabled, flag)| *enabled && *flag);
        // With DDRE, an error masks the DMA request for reception until its flag is cleared.
        let held_back = self.cr3 & cr3::DDRE != 0 && (errors || isr & isr::PE != 0);
        let lines = (
            interrupt,
            self.receiver_on() && self.cr3 & cr3::DMAR != 0 && isr & isr::RXNE != 0 && !held_back,
            self.enabled() && self.on(cr1::TE) && self.cr3 & cr3::DMAT != 0 && isr & isr::TXE != 0,
        );
        if lines.0 != self.lines.0 {
            context.irq(self.port.irq, lines.0);
        }
        if lines.1 != self.lines.1 {
            context.dma(self.port.rx_request, lines.1);
        }
        if lines.2 != self.lines.2 {
            context.dma(self.port.tx_request, lines.2);
        }
        self.lines = lines;
    }
}

/// Returns the number of characters for a threshold code (RM0399, 51.8.4, TXFTCFG and RXFTCFG).
fn threshold(code: u32) -> usize {
    match code & 7 {
        0 => FIFO_DEPTH / 8,
        1 => FIFO_DEPTH / 4,
        2 => FIFO_DEPTH / 2,
        3 => FIFO_DEPTH * 3 / 4,
        4 => FIFO_DEPTH * 7 / 8,
        _ => FIFO_DEPTH,
    }
}
