//! Direct memory access: DMA1 and DMA2 behind DMAMUX1 (RM0399, DMA and DMAMUX), BDMA behind DMAMUX2.
//!
//! A controller does not access the bus itself. The owner of the bus takes one access after another:
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
//! The loop runs after each access of the program, each event and each change of a request line. An access takes no
//! time: a transfer is complete at the moment of its last request. So requests never wait for each other, a direct mode
//! error (DMEIF) and a FIFO overrun or underrun (FEIF) cannot happen, and the order of simultaneous requests is that of
//! the arbiter: priority, then number of the stream.
//!
//! Request lines are of two kinds. A receiver's or transmitter's is a level that its data register lowers when the beat
//! reads or writes it. A timer's or a DAC's is a pulse that stays pending until it is served; the multiplexer keeps it
//! ([`Requests`]), and clears it early only when the peripheral lowers the line (its enable bit was cleared, or it was
//! reset).

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

/// Bus access that a controller wants.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Beat {
    /// Channel, for messages: 0 to 7 are DMA1's streams, 8 to 15 DMA2's; BDMA's channels are 0 to 7.
    pub channel: u8,
    /// Address, a multiple of the size.
    pub address: u32,
    /// Width of the access.
    pub size: Size,
    /// Direction of the access.
    pub access: Access,
}

/// Direction of a [`Beat`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Read; the value goes to `finish_beat`, right-aligned.
    Read,
    /// Write of this value, right-aligned.
    Write(u32),
}

/// Refusal of a beat by the bus: no device at the address, memory the controller cannot reach (DTCM, ITCM), memory
/// without a clock.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BusError;

/// Number of accesses of one stream at one moment above which its request counts as stuck: the longest transfer has
/// 65535 items, each read and written once.
const STUCK: u32 = 200_000;

/// Detector of a request that never falls, as opposed to a long transfer, so that a mistake does not stop virtual time.
#[derive(Clone, Copy, Debug, Default)]
struct Patience {
    now_ns: u64,
    accesses: u32,
}

impl Patience {
    /// Counts an access; returns true exactly for the first one above the limit.
    fn spend(&mut self, now_ns: u64) -> bool {
        if now_ns != self.now_ns {
            *self = Self { now_ns, accesses: 0 };
        }
        self.accesses += 1;
        self.accesses == STUCK
    }

    /// Returns true if no further access is allowed at this moment.
    fn is_over(&self) -> bool {
        self.accesses >= STUCK
    }

    /// Restarts the count when time has passed.
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
