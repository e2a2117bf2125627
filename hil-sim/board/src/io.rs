//! Peripherals of the processor, as the firmware accesses them through its traits.

use std::{cell::RefCell, convert::Infallible, future::poll_fn, rc::Rc, task::Poll};

use embedded_hal::i2c::{Error, ErrorKind, ErrorType, NoAcknowledgeSource, Operation};
use embedded_hal_async::i2c::I2c;
use embedded_io_async::{Read, Write};
use embedded_storage_async::nor_flash::{NorFlash, ReadNorFlash};
use r4_firmware::platform::Bus;

use crate::{
    flash::{Flash, FlashError, SECTOR_BYTES},
    i2c::Fault,
    world::{Controller, World},
};

/// Time without progress after which the controller aborts a transfer, ns: twice the longest transfer on this bus.
const BUS_TIMEOUT_NS: u64 = 1_000_000;

/// I2C controller of the processor.
///
/// A transfer acts on the chips at the time of its STOP, with the exact time of each byte. One that is not acknowledged
/// is reported when it would have ended: too late by its remaining bytes, at most 0.45 ms on this board.
pub(crate) struct BoardBus {
    pub(crate) world: Rc<RefCell<World>>,
    pub(crate) controller: Controller,
}

/// Failed transfer, as the firmware sees it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BusError(Fault);

impl Error for BusError {
    fn kind(&self) -> ErrorKind {
        match self.0 {
            Fault::AddressNack { .. } => ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address),
            Fault::DataNack { .. } => ErrorKind::NoAcknowledge(NoAcknowledgeSource::Data),
            Fault::StuckLow { .. } => ErrorKind::Bus,
        }
    }
}

impl ErrorType for BoardBus {
    type Error = BusError;
}

impl I2c for BoardBus {
    async fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), BusError> {
        let (clock, start_ns, end_ns) = {
            let mut world = self.world.borrow_mut();
            let clock = world.clock().clone();
            let bus = world.bus_of(self.controller);
            if !bus.lines_are_free(clock.now_ns()) {
                // the controller detects a stuck bus before it starts
                return Err(BusError(Fault::StuckLow { since_ns: clock.now_ns() }));
            }
            let start_ns = bus.earliest_start_ns(clock.now_ns());
            let end_ns = start_ns + bus.planned_duration_ns(operations);
            (clock, start_ns, end_ns)
        };
        clock.sleep_until(end_ns).await;
        let result = {
            let mut world = self.world.borrow_mut();
            // bytes keep the times they had from START on
            world.on_bus(self.controller, |bus| bus.execute(start_ns, address, operations))
        };
        match result {
            Ok(_) => Ok(()),
            Err(fault) => {
                if let Fault::StuckLow { since_ns } = fault {
                    clock.sleep_until(since_ns + BUS_TIMEOUT_NS).await;
                }
                Err(BusError(fault))
            }
        }
    }
}

impl Bus for BoardBus {
    async fn recover(&mut self) {
        let (clock, recovery) = {
            let mut world = self.world.borrow_mut();
            let clock = world.clock().clone();
            let recovery = world.bus_of(self.controller).recover(clock.now_ns());
            (clock, recovery)
        };
        clock.sleep_until(recovery.end_ns).await;
    }
}

/// Receiver of a UART connector.
pub(crate) struct UartReceiver {
    pub(crate) world: Rc<RefCell<World>>,
    pub(crate) connector: usize,
}

/// Transmitter of a UART connector.
pub(crate) struct UartTransmitter {
    pub(crate) world: Rc<RefCell<World>>,
    pub(crate) connector: usize,
}

impl embedded_io_async::ErrorType for UartReceiver {
    type Error = Infallible;
}

impl embedded_io_async::ErrorType for UartTransmitter {
    type Error = Infallible;
}

impl Read for UartReceiver {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        poll_fn(|context| {
            let mut world = self.world.borrow_mut();
            let clock = world.clock().clone();
            world.send_due(self.connector);
            let next_ns = world.next_uart_ns(self.connector);
            let port = world.uart_port(self.connector);
            let received = port.line.read(clock.now_ns(), buffer);
            if received.len > 0 || buffer.is_empty() {
                return Poll::Ready(Ok(received.len));
            }
            match next_ns {
                Some(at_ns) => clock.wake_at(at_ns, context.waker()),
                None => port.reader = Some(context.waker().clone()),
            }
            Poll::Pending
        })
        .await
    }
}

impl Write for UartTransmitter {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        let mut world = self.world.borrow_mut();
        let now_ns = world.clock().now_ns();
        let port = world.uart_port(self.connector);
        port.write(now_ns, bytes);
        if let Some(reader) = port.reader.take() {
            reader.wake();
        }
        Ok(bytes.len())
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// Flash of the processor, as the firmware's driver.
pub(crate) struct FlashPort(pub(crate) Rc<RefCell<Flash>>);

impl embedded_storage_async::nor_flash::ErrorType for FlashPort {
    type Error = FlashError;
}

// During a step, only a test that inspects a running board could borrow it too.
#[allow(clippy::await_holding_refcell_ref, reason = "one owner; see above")]
impl ReadNorFlash for FlashPort {
    const READ_SIZE: usize = Flash::<SECTOR_BYTES>::READ_SIZE;

    async fn read(&mut self, offset: u32, bytes: &mut [u8]) -> Result<(), FlashError> {
        self.0.borrow_mut().read(offset, bytes).await
    }

    fn capacity(&self) -> usize {
        self.0.borrow().capacity()
    }
}

#[allow(clippy::await_holding_refcell_ref, reason = "one owner; see above")]
impl NorFlash for FlashPort {
    const WRITE_SIZE: usize = Flash::<SECTOR_BYTES>::WRITE_SIZE;
    const ERASE_SIZE: usize = Flash::<SECTOR_BYTES>::ERASE_SIZE;

    async fn erase(&mut self, from: u32, to: u32) -> Result<(), FlashError> {
        self.0.borrow_mut().erase(from, to).await
    }

    async fn write(&mut self, offset: u32, bytes: &[u8]) -> Result<(), FlashError> {
        self.0.borrow_mut().write(offset, bytes).await
    }
}
