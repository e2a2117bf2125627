//! Receive buffer of a UART: a ring that a DMA stream fills continuously.
//!
//! The stream is started once and never stopped. Bytes are counted since then, modulo 2^32: laps of the ring by the
//! stream's interrupt, the rest by NDTR. A reader that knows its position therefore never gets a byte twice: either the
//! bytes from there on are still in the ring, or the read reports that it came too late and continues with the
//! following bytes.

use core::sync::atomic::{AtomicU8, AtomicU32, Ordering, fence};

use embassy_stm32::pac::{
    DMAMUX1,
    dma::{
        Dma, St,
        regs::Ixr,
        vals::{Dir, Dmdis, Pl, Size},
    },
};
use embassy_sync::waitqueue::AtomicWaker;

/// Size of one ring, bytes: 10 ms at 1 Mbaud. Half of it must be read while the other half fills.
pub(crate) const RING: usize = 1024;
/// Bytes by which the stream may be ahead of its count: the one that it writes, and those that come during a read.
const MARGIN: u32 = 16;

/// Memory of a ring, and the state that its interrupts update.
pub(super) struct Ring {
    bytes: [AtomicU8; RING],
    laps: AtomicU32,
    /// Waker that is woken when half of the ring was filled, and by the UART when its line falls silent.
    pub(super) waker: AtomicWaker,
}

/// Error: the reader was nearly a lap late, or later. At least this number of bytes is lost.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Late(pub(super) u32);

impl Ring {
    pub(super) const fn new() -> Self {
        Self { bytes: [const { AtomicU8::new(0) }; RING], laps: AtomicU32::new(0), waker: AtomicWaker::new() }
    }
}

/// Stream of DMA1 or DMA2 that fills a ring.
#[derive(Clone, Copy)]
pub(super) struct Stream {
    pub(super) controller: Dma,
    /// Number of the stream, 0 to 7.
    pub(super) number: usize,
    /// Channel of DMAMUX1: the stream's number, plus 8 for DMA2.
    pub(super) channel: usize,
    pub(super) ring: &'static Ring,
}

impl Stream {
    fn registers(self) -> St {
        self.controller.st(self.number)
    }

    fn flags(self) -> Ixr {
        self.controller.isr(self.number / 4).read()
    }

    /// Starts filling the ring with bytes from the register at `from` whenever `request` comes, without end (RM0399,
    /// 15.3.19). Call it once.
    pub(super) fn start(self, request: u8, from: *mut u8) {
        let stream = self.registers();
        DMAMUX1.ccr(self.channel).write(|w| w.set_dmareq_id(request));
        stream.par().write_value(from as u32);
        stream.m0ar().write_value(self.ring.bytes.as_ptr() as u32);
        stream.ndtr().write(|w| w.set_ndt(RING as u16));
        stream.fcr().write(|w| w.set_dmdis(Dmdis::ENABLED));
        stream.cr().write(|w| {
            w.set_dir(Dir::PERIPHERAL_TO_MEMORY);
            w.set_msize(Size::BITS8);
            w.set_psize(Size::BITS8);
            w.set_minc(true);
            w.set_circ(true);
            w.set_pl(Pl::VERY_HIGH);
            // Needed for UARTs: without it the stream can lock up (erratum of the STM32H7's DMA).
            w.set_trbuff(true);
            w.set_htie(true);
            w.set_tcie(true);
            w.set_teie(true);
        });
        stream.cr().modify(|w| w.set_en(true));
    }

    /// Handles the stream's interrupt.
    pub(super) fn on_interrupt(self) {
        let (flags, line) = (self.flags(), self.number % 4);
        // A transfer error is impossible: the addresses are valid and never change.
        assert!(!flags.teif(line), "a bus error of a UART's DMA");
        let complete = flags.tcif(line);
        self.controller.ifcr(self.number / 4).write(|w| {
            w.set_htif(line, flags.htif(line));
            w.set_tcif(line, complete);
        });
        if complete {
            self.ring.laps.fetch_add(1, Ordering::Release);
        }
        self.ring.waker.wake();
    }

    /// Number of bytes received since the start, modulo 2^32. The stream's interrupt must be able to interrupt the
    /// caller.
    fn received(self) -> u32 {
        loop {
            let laps = self.ring.laps.load(Ordering::Acquire);
            let left = u32::from(self.registers().ndtr().read().ndt());
            // NDTR belongs to this lap only if no lap was completed meanwhile, counted or not yet.
            let completed = self.flags().tcif(self.number % 4);
            fence(Ordering::Acquire);
            if !completed && self.ring.laps.load(Ordering::Acquire) == laps {
                return laps.wrapping_mul(RING as u32).wrapping_add(RING as u32).wrapping_sub(left);
            }
        }
    }

    /// Reads the bytes received after `position`, and advances it; 0 if there are none.
    ///
    /// # Errors
    /// [`Late`] if the stream has overwritten some of them; `position` is then that of the newest byte.
    pub(super) fn read(self, position: &mut u32, buffer: &mut [u8]) -> Result<usize, Late> {
        let begin = *position;
        let count = buffer.len().min(self.received().wrapping_sub(begin) as usize);
        for (offset, byte) in (0_u32..).zip(&mut buffer[..count]) {
            *byte = self.ring.bytes[begin.wrapping_add(offset) as usize % RING].load(Ordering::Relaxed);
        }
        // Checked after the copy: the stream may have overwritten the bytes just read.
        fence(Ordering::Acquire);
        let received = self.received();
        let behind = received.wrapping_sub(begin);
        if behind > RING as u32 - MARGIN {
            *position = received;
            return Err(Late(behind));
        }
        *position = begin.wrapping_add(count as u32);
        Ok(count)
    }
}
