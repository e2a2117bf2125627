//! The processor's peripherals, as the firmware reaches them through its traits.

use std::{cell::RefCell, rc::Rc};

use embedded_hal::i2c::{Error, ErrorKind, ErrorType, NoAcknowledgeSource, Operation};
use embedded_hal_async::i2c::I2c;
use r4_firmware::platform::Bus;

use crate::{i2c::Fault, world::World};

/// The controller gives a transfer up after this long without progress: twice the longest transfer on this bus.
const BUS_TIMEOUT_NS: u64 = 1_000_000;

/// The I2C controller.
///
/// A transfer acts on the chips at the moment of its STOP, with the exact time of each byte. One that is not
/// acknowledged is reported when it would have ended: late by what was left of it, at most 0.45 ms on this board.
pub(crate) struct BoardBus(pub(crate) Rc<RefCell<World>>);

/// A transfer that failed, to the firmware.
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
            let world = self.0.borrow();
            let start_ns = world.bus.earliest_start_ns(world.clock().now_ns());
            (world.clock().clone(), start_ns, start_ns + world.bus.planned_duration_ns(operations))
        };
        clock.sleep_until(end_ns).await;
        let result = {
            let mut world = self.0.borrow_mut();
            world.catch_up();
            let result = world.bus.execute(start_ns, address, operations);
            // The expander's pins change with the transfer; the PWM chip's at the end of its cycle.
            world.look_at_lines();
            result
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
            let mut world = self.0.borrow_mut();
            let now_ns = world.clock().now_ns();
            (world.clock().clone(), world.bus.recover(now_ns))
        };
        clock.sleep_until(recovery.end_ns).await;
    }
}
