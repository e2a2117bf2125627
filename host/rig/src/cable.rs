//! The cable from the host to a virtual board, to cut.

use std::{cell::Cell, convert::Infallible, rc::Rc};

use embedded_io_async::Write;
use r4_sim::{Clock, link::Sender};

/// Nanoseconds of a byte on the link: ten bits at 1 Mbit/s.
const BYTE_NS: u64 = 10_000;

/// The cable, as the driver writes into it.
pub struct Cable {
    sender: Sender,
    clock: Clock,
    state: Rc<CableState>,
}

/// What became of a cable.
#[derive(Default)]
pub struct CableState {
    /// Whether it is cut: what is sent does not arrive.
    pub cut: Cell<bool>,
    /// When the last byte that was let through has arrived.
    pub arrived_ns: Cell<u64>,
}

impl Cable {
    /// A whole cable, and what to cut it by.
    #[must_use]
    pub fn new(sender: Sender, clock: Clock) -> (Self, Rc<CableState>) {
        let state = Rc::<CableState>::default();
        (Self { sender, clock, state: state.clone() }, state)
    }
}

impl embedded_io_async::ErrorType for Cable {
    type Error = Infallible;
}

impl Write for Cable {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        if self.state.cut.get() {
            return Ok(bytes.len());
        }
        let len = self.sender.write(bytes).await?;
        self.state.arrived_ns.set(self.clock.now_ns().max(self.state.arrived_ns.get()) + len as u64 * BYTE_NS);
        Ok(len)
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        self.sender.flush().await
    }
}
