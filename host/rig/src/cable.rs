//! Cable from the host to a virtual board, which a test can cut.

use std::{cell::Cell, convert::Infallible, rc::Rc};

use embedded_io_async::Write;
use r4_sim::{Clock, link::Sender};

/// Time of a byte on the link, ns: ten bits at 1 Mbit/s.
const BYTE_NS: u64 = 10_000;

/// Writer of the driver's bytes, through the cable.
pub struct Cable {
    sender: Sender,
    clock: Clock,
    state: Rc<CableState>,
}

/// State of a cable, shared with the test that cuts it.
#[derive(Default)]
pub struct CableState {
    /// True when the cable is cut: bytes sent are lost.
    pub cut: Cell<bool>,
    /// Time at which the last byte that passed arrives, ns.
    pub arrived_ns: Cell<u64>,
}

impl Cable {
    /// Creates a cable that is not cut, with its state.
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
