//! Direct memory access: DMA1 and DMA2 behind DMAMUX1 (RM0399, DMA and DMAMUX), BDMA behind DMAMUX2.
//!
//! A controller here does not reach the bus itself. Whoever owns the bus asks for one access after another:
//!
//! ```text
//! while let Some(beat) = dma.next_beat() {
//!     let result = match beat.access {
//!         Access::Read => bus.read(beat.address, beat.size),
//!         Access::Write(value) => bus.write(beat.address, beat.size, value).map(|()| 0),
//!     };
//!     // signals of the peripheral that was accessed are carried out here
//!     if let Some(request) = dma.finish_beat(result, &mut context) {
//!         adc12.dma_ended(request, &mut context);
//!     }
//! }
//! ```
//!
//! after each access of the program, each event and each change of a request line. An access takes no time: a transfer is
//! complete at the moment of its last request. So requests never wait for each other, a direct mode error (DMEIF) and a FIFO
//! overrun or underrun (FEIF) cannot happen, and the order of simultaneous requests is that of the arbiter: priority, then
//! number of the stream.
//!
//! Request lines are of two kinds. A receiver's or transmitter's is a level that its data register lowers when the beat reads
//! or writes it. A timer's or a DAC's is a pulse that stays pending until it is served; the multiplexer keeps it
//! ([`Requests`]), and takes it back only when the peripheral lowers the line (its enable bit was cleared, or it was reset).

mod bdma;
mod controller;
mod dma12;
mod mux;
mod stream;
#[cfg(test)]
mod tests;

pub use bdma::Bdma;
pub use dma12::{Dma12, Part};
pub use mux::Requests;

use crate::peripheral::Size;

/// One access to the bus that a controller wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Beat {
    /// For messages: 0 to 7 are DMA1's streams, 8 to 15 DMA2's; BDMA's channels are 0 to 7.
    pub channel: u8,
    /// Where, a multiple of the size.
    pub address: u32,
    /// How wide.
    pub size: Size,
    /// Which way.
    pub access: Access,
}

/// Direction of a [`Beat`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// The value is handed to `finish_beat`, right-aligned.
    Read,
    /// The value to write, right-aligned.
    Write(u32),
}

/// The bus refused a beat: nothing there, memory the controller cannot reach (DTCM, ITCM), memory without a clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BusError;

/// Accesses of one stream at one moment, above which its request is taken to be stuck: the longest transfer is 65535 items,
/// each read and written once.
const STUCK: u32 = 200_000;

/// Tells a request that never falls from a long transfer, so that a mistake does not stop time for ever.
#[derive(Clone, Copy, Debug, Default)]
struct Patience {
    now_ns: u64,
    accesses: u32,
}

impl Patience {
    /// Counts an access; true exactly when it is the one too many.
    fn spend(&mut self, now_ns: u64) -> bool {
        if now_ns != self.now_ns {
            *self = Self { now_ns, accesses: 0 };
        }
        self.accesses += 1;
        self.accesses == STUCK
    }

    /// Nothing more at this moment.
    fn is_over(&self) -> bool {
        self.accesses >= STUCK
    }

    /// Time has passed.
    fn renew(&mut self, now_ns: u64) {
        if now_ns != self.now_ns {
            *self = Self { now_ns, accesses: 0 };
        }
    }
}

const fn size_of_code(code: u32) -> Option<Size> {
    match code & 3 {
        0 => Some(Size::Byte),
        1 => Some(Size::Half),
        2 => Some(Size::Word),
        _ => None,
    }
}
