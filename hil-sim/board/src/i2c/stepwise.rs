//! Bus interface for a controller with its own timing, which passes the time of each byte.

use super::{Disturbance, I2cBus, Span, Stuck, Transaction};

/// Number of clocks that a chip left in the middle of a byte needs at most to release SDA (UM10204, rev. 6, 3.1.16).
const RELEASING_CLOCKS: u8 = 9;

/// Response to a byte.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Response {
    /// Acknowledged by a chip.
    Ack,
    /// Not acknowledged: STOP or a repeated START has to follow.
    Nack,
    /// The bus is held low: neither the byte nor the transaction ever ends.
    Stuck,
}

impl I2cBus {
    /// Sends START, or within a transaction a repeated one, and the address; `at_ns` is the end of the 9th clock of
    /// that byte.
    ///
    /// The time of the START itself follows from the bus's rate, for statistics, trace and spans of injected faults. A
    /// transaction that its controller left without STOP, for example by a reset, continues: on the wires the START is
    /// a repeated one.
    pub fn start(&mut self, at_ns: u64, address: u8, read: bool) -> Response {
        let mut transaction = match self.open.take() {
            Some(transaction) => {
                self.check_read(&transaction, at_ns);
                transaction
            }
            None => {
                let since_start_ns = self.timing.hold_start_ns + self.timing.byte_ns();
                let last_stop_ns = self.free_at_ns.saturating_sub(self.timing.bus_free_ns);
                self.open(at_ns.saturating_sub(since_start_ns).max(last_stop_ns), address)
            }
        };
        self.recovery = None;
        let acknowledged = self.put_address(&mut transaction, at_ns, address, read).is_ok();
        self.go_on(transaction, at_ns, acknowledged)
    }

    /// Sends a byte to the addressed chips, at the end of its 9th clock. Outside a transaction no chip takes it.
    pub fn write(&mut self, at_ns: u64, byte: u8) -> Response {
        let Some(mut transaction) = self.open.take() else { return self.outside(at_ns) };
        let acknowledged = self.put(&mut transaction, at_ns, byte).is_ok();
        self.go_on(transaction, at_ns, acknowledged)
    }

    /// Reads a byte from the addressed chips, at the end of its 9th clock: 0xFF if no chip drives the line; `None` if
    /// the bus is stuck. The controller's acknowledgement makes no difference to the chips modelled here.
    pub fn read(&mut self, at_ns: u64) -> Option<u8> {
        let Some(mut transaction) = self.open.take() else {
            return (self.outside(at_ns) == Response::Nack).then_some(0xFF);
        };
        let byte = self.get(&mut transaction, at_ns).ok();
        self.go_on(transaction, at_ns, byte.is_some());
        byte
    }

    /// Sends STOP at `at_ns`, which ends the transaction, or a [recovery](Self::clock_pulse), if there is one. There is
    /// no STOP on a stuck bus.
    pub fn stop(&mut self, at_ns: u64) {
        if let Some(mut transaction) = self.open.take() {
            if !transaction.has_failed() {
                self.check_read(&transaction, at_ns);
                // closing reports a bus that sticks before the STOP
                let _ = transaction.moves(at_ns);
            }
            self.close(transaction, at_ns);
        } else if let Some((since_ns, _)) = self.recovery.take() {
            if self.lines_are_free(at_ns) {
                self.tell_stop(at_ns);
            }
            self.occupy(since_ns, at_ns);
        }
    }

    /// Sends a clock pulse that ends at `at_ns`, made by hand with SDA released, as a controller does to free a stuck
    /// bus: after nine of them a chip that was left in the middle of a byte releases SDA. [`Self::recover`] is nine of
    /// them and a STOP.
    pub fn clock_pulse(&mut self, at_ns: u64) {
        let first_ns = at_ns.saturating_sub(self.timing.clock_ns);
        let (since_ns, clocks) = self.recovery.get_or_insert((first_ns, 0));
        *clocks = clocks.saturating_add(1);
        if *clocks >= RELEASING_CLOCKS {
            let since_ns = *since_ns;
            self.release(since_ns, at_ns);
        }
    }

    /// True if both lines are high while the controller releases them.
    #[must_use]
    pub fn lines_are_free(&self, now_ns: u64) -> bool {
        let held = self.stuck.is_some_and(|Stuck { until_ns, .. }| now_ns < until_ns)
            || self.open.is_some_and(|transaction| transaction.is_held(now_ns));
        // a fault with an address acts only while that address is in use
        let shorted = self.injections.iter().any(|injection| {
            let Span::Time { from_ns, until_ns } = injection.span else { return false };
            let sticks = matches!(injection.disturbance, Disturbance::StuckLow { .. }) && injection.address.is_none();
            sticks && (from_ns..until_ns).contains(&now_ns)
        });
        !held && !shorted
    }

    /// Keeps a transaction for its next byte, or ends it if the bus is stuck.
    fn go_on(&mut self, transaction: Transaction, at_ns: u64, acknowledged: bool) -> Response {
        if transaction.is_stuck() {
            self.close(transaction, at_ns);
            return Response::Stuck;
        }
        self.open = Some(transaction);
        if acknowledged { Response::Ack } else { Response::Nack }
    }

    /// Response to a byte outside a transaction.
    fn outside(&self, at_ns: u64) -> Response {
        if self.lines_are_free(at_ns) { Response::Nack } else { Response::Stuck }
    }
}
