//! SPI1 as a transmitting master (RM0399, chapter 53).
//!
//! Each data frame takes its clocks, back to back while the FIFO holds one, and is passed to
//! [`Outside::spi_sent`](crate::Outside::spi_sent) at the end of its last clock. A transfer begins at the moment it may
//! (the chip takes a few clocks to synchronise).
//!
//! MISO is not connected: in full-duplex mode frames are received and fill the RxFIFO, up to the overrun, but their
//! content is not modelled, so that reading one ends the run. So do slave mode, receivers, half duplex, TI mode, I2S,
//! CRC, and the SS input pin.

mod access;
mod registers;

#[cfg(test)]
mod tests;

use std::collections::VecDeque;

use crate::context::{Context, Ticks};

use self::registers::{cfg1, cfg2, cr1, sr};

const NAME: &str = "SPI1";
const CONTROLLER: u8 = 1;
/// Interrupt number of SPI1 (RM0399, chapter 20).
const IRQ: u16 = 35;
/// Input numbers of DMAMUX1 (RM0399, 18.3.2).
const RX_REQUEST: u8 = 37;
const TX_REQUEST: u8 = 38;
/// Size of each FIFO, bytes (table 435).
const FIFO_BYTES: usize = 16;

/// Frame being sent on the wire.
#[derive(Clone, Copy, Debug)]
struct Shifting {
    frame: u32,
    /// Clocks of SCK in a run of frames without a gap.
    clocks: Ticks,
    end: u64,
}

/// Registers, FIFOs and transfer state of SPI1.
#[derive(Clone, Debug)]
pub struct Spi {
    cr1: u32,
    cr2: u32,
    cfg1: u32,
    cfg2: u32,
    ier: u32,
    crcpoly: u32,
    udrdr: u32,
    i2scfgr: u32,
    /// Flags EOT, TXTF, OVR, MODF, TSERF, SUSP.
    flags: u32,
    to_send: VecDeque<u32>,
    /// Number of frames in the RxFIFO.
    received: usize,
    shifting: Option<Shifting>,
    /// A suspension was requested by CSUSP.
    suspend: bool,
    /// Frames of a transfer with TSIZE that are not sent yet, and not written yet.
    unsent: u32,
    unwritten: u32,
    kernel_hz: u64,
    lines: [bool; 3],
}

impl Default for Spi {
    fn default() -> Self {
        Self::new()
    }
}

impl Spi {
    /// Makes SPI1 in its reset state.
    #[must_use]
    pub fn new() -> Self {
        Self {
            cr1: 0,
            cr2: 0,
            cfg1: 0x0007_0007,
            cfg2: 0,
            ier: 0,
            crcpoly: 0x107,
            udrdr: 0,
            i2scfgr: 0,
            flags: 0,
            to_send: VecDeque::new(),
            received: 0,
            shifting: None,
            suspend: false,
            unsent: 0,
            unwritten: 0,
            kernel_hz: 0,
            lines: [false; 3],
        }
    }

    /// Returns the frequency of SCK by the clock tree at the last access, Hz.
    #[must_use]
    pub fn sck_hz(&self) -> f64 {
        self.kernel_hz as f64 / self.divider() as f64
    }

    fn divider(&self) -> u64 {
        2 << (self.cfg1 >> cfg1::MBR_AT & 7)
    }

    fn enabled(&self) -> bool {
        self.cr1 & cr1::SPE != 0
    }

    /// Returns the number of bits in a data frame.
    fn bits(&self) -> u32 {
        (self.cfg1 & cfg1::DSIZE) + 1
    }

    /// Returns the bytes of a register access for one frame: 1, 2 or 4.
    fn access_bytes(&self) -> usize {
        match self.bits() {
            ..=8 => 1,
            9..=16 => 2,
            _ => 4,
        }
    }

    /// Returns the number of frames that a FIFO holds (53.4.11).
    fn capacity(&self) -> usize {
        FIFO_BYTES / self.bits().div_ceil(8) as usize
    }

    /// Returns the number of frames in a packet.
    fn packet(&self) -> usize {
        (self.cfg1 >> cfg1::FTHLV_AT & 0xF) as usize + 1
    }

    fn counted(&self) -> bool {
        self.cr2 & 0xFFFF != 0
    }

    fn full_duplex(&self) -> bool {
        self.cfg2 >> cfg2::COMM_AT & 3 == 0
    }

    /// Starts the next frame, `at` clocks into a run, if there is one.
    fn load(&mut self, clocks: Ticks, at: u64) {
        let running = self.enabled() && self.cr1 & cr1::CSTART != 0 && self.flags & (sr::SUSP | sr::MODF) == 0;
        if self.shifting.is_some() || !running {
            return;
        }
        let Some(frame) = self.to_send.pop_front() else { return };
        self.shifting = Some(Shifting { frame, clocks, end: at + u64::from(self.bits()) });
    }

    /// Starts or continues a transfer at `at_ns`.
    fn start(&mut self, at_ns: u64) {
        // Idle clocks between SS, if the hardware drives it, and the first clock.
        let idle = if self.cfg2 & cfg2::SSOE != 0 { u64::from(self.cfg2 & cfg2::MSSI) } else { 0 };
        self.load(Ticks { start_ns: at_ns, frequency_hz: self.kernel_hz, divider: self.divider() }, idle);
    }

    fn next_ns(&self) -> u64 {
        self.shifting.map_or(u64::MAX, |shifting| shifting.clocks.when_ns(shifting.end))
    }

    fn bring_to_now(&mut self, context: &mut Context<'_>) {
        self.kernel_hz = context.clocks.spi123_hz;
        while self.next_ns() <= context.now_ns && self.next_ns() != u64::MAX {
            self.frame_sent(self.next_ns(), context);
        }
    }

    fn frame_sent(&mut self, at_ns: u64, context: &mut Context<'_>) {
        let Some(sent) = self.shifting.take() else { return };
        let bits = self.bits();
        let mut frame = sent.frame & (u32::MAX >> (32 - bits));
        if self.cfg2 & cfg2::LSBFRST != 0 {
            frame = frame.reverse_bits() >> (32 - bits);
        }
        // The frame is reported with its most significant bit first on the wire.
        context.outside.spi_sent(CONTROLLER, at_ns, frame, bits as u8);
        if self.full_duplex() {
            if self.received < self.capacity() {
                self.received += 1;
            } else {
                self.flags |= sr::OVR;
            }
        }
        if self.counted() {
            self.count_sent();
        }
        if std::mem::take(&mut self.suspend) {
            self.cr1 &= !cr1::CSTART;
            self.flags |= sr::SUSP;
        }
        self.load(sent.clocks, sent.end + u64::from(self.cfg2 >> cfg2::MIDI_AT & 0xF));
    }

    /// Counts a sent frame of TSIZE; after the last one TSER applies, or the end.
    fn count_sent(&mut self) {
        self.unsent = self.unsent.saturating_sub(1);
        if self.unsent > 0 {
            return;
        }
        let extension = self.cr2 >> 16;
        if extension > 0 {
            // TSER moves to TSIZE, so that the transfer continues without an end.
            self.cr2 = extension;
            self.unsent = extension;
            self.unwritten += extension;
            self.flags |= sr::TSERF;
        } else {
            self.flags |= sr::EOT;
            self.cr1 &= !cr1::CSTART;
        }
    }

    fn sr(&self) -> u32 {
        let mut value = self.flags;
        let mut set = |condition: bool, bit: u32| {
            if condition {
                value |= bit;
            }
        };
        let room = self.capacity() - self.to_send.len().min(self.capacity());
        let wanted =
            if self.counted() && self.enabled() { self.packet().min(self.unwritten as usize) } else { self.packet() };
        let space = wanted > 0 && room >= wanted;
        let packet = self.received >= self.packet();
        set(space, sr::TXP);
        set(packet, sr::RXP);
        set(space && packet, sr::DXP);
        let done =
            if self.counted() { self.flags & sr::EOT != 0 } else { self.to_send.is_empty() && self.shifting.is_none() };
        set(done, sr::TXC);
        let bytes = self.bits().div_ceil(8) as usize;
        set(self.received * bytes >= 4, sr::RXWNE);
        if bytes <= 2 {
            value |= ((self.received % (4 / bytes)) as u32) << sr::RXPLVL_AT;
        }
        value | self.unsent << sr::CTSIZE_AT
    }

    /// Updates the interrupt and request lines from the flags.
    fn update_lines(&mut self, context: &mut Context<'_>) {
        let sr = self.sr();
        // EOTIE also enables the interrupts of SUSP and TXC.
        let ending = self.ier & sr::EOT != 0 && sr & (sr::SUSP | sr::TXC) != 0;
        let lines = [
            self.ier & sr & (sr::CLEARED | 7) & !sr::SUSP != 0 || ending,
            self.enabled() && self.cfg1 & cfg1::RXDMAEN != 0 && sr & sr::RXP != 0,
            self.enabled() && self.cfg1 & cfg1::TXDMAEN != 0 && sr & sr::TXP != 0,
        ];
        if lines[0] != self.lines[0] {
            context.irq(IRQ, lines[0]);
        }
        if lines[1] != self.lines[1] {
            context.dma(RX_REQUEST, lines[1]);
        }
        if lines[2] != self.lines[2] {
            context.dma(TX_REQUEST, lines[2]);
        }
        self.lines = lines;
    }
}
