//! I2C bus with one controller: every byte at its exact virtual time, in the order of the wire, deterministic.
//!
//! The bus is synchronous, and has two interfaces. [`I2cBus::execute`] runs a whole transaction at once and reports the
//! times of its parts; the caller lets virtual time pass. A controller with its own timing goes [byte by
//! byte](I2cBus::start) and passes the time of each. Chips, injected faults, statistics and trace are the same for
//! both. The timing of the first is that of the NXP I2C-bus specification (UM10204, rev. 6, table 10), with the
//! controller at the minimum of every parameter and the clock at the set rate, and no clock stretching (none of the
//! board's chips stretches).
//!
//! ```text
//! START  tHD;STA | 9 clocks: address | 9 clocks per byte | tLOW tSU;STA, START again, tHD;STA | ... | tLOW tSU;STO STOP | tBUF
//! ```

use core::cell::RefCell;
use core::fmt;
use std::collections::VecDeque;
use std::rc::Rc;

use embedded_hal::i2c::Operation;

mod stepwise;
#[cfg(test)]
mod tests;
mod transaction;

use crate::misuse::MisuseLog;
pub use stepwise::Response;
use transaction::Transaction;

/// A target on the bus, as seen from its two wires.
pub trait I2cChip {
    /// True if the chip would acknowledge this 7-bit address now. No side effects.
    fn acknowledges(&self, address: u8, read: bool) -> bool;
    /// Handles an acknowledged address, at the end of its 9th clock; also after a repeated START.
    fn start(&mut self, at_ns: u64, address: u8, read: bool);
    /// Takes a byte from the controller, at the end of its 9th clock; `true` acknowledges it.
    fn write(&mut self, at_ns: u64, byte: u8) -> bool;
    /// Returns a byte for the controller, at the end of its 9th clock.
    fn read(&mut self, at_ns: u64) -> u8;
    /// Handles the STOP of a transaction in which the chip was addressed.
    fn stop(&mut self, at_ns: u64);
}

/// Timing parameters of UM10204, rev. 6, table 10, ns; one set per mode, selected by the rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Timing {
    /// Period of SCL, ns.
    clock_ns: u64,
    hold_start_ns: u64,
    setup_start_ns: u64,
    setup_stop_ns: u64,
    low_ns: u64,
    bus_free_ns: u64,
}

impl Timing {
    /// Parameters for a rate. Above 1 MHz those of Fast-mode Plus apply: no chip of the board is faster.
    fn new(rate_hz: u32) -> Self {
        let clock_ns = 1_000_000_000_u64.div_ceil(u64::from(rate_hz.max(1)));
        let [hold_start_ns, setup_start_ns, setup_stop_ns, low_ns, bus_free_ns] = match rate_hz {
            0..=100_000 => [4_000, 4_700, 4_000, 4_700, 4_700],
            100_001..=400_000 => [600, 600, 600, 1_300, 1_300],
            _ => [260, 260, 260, 500, 500],
        };
        let low_ns = clock_ns.div_ceil(2).max(low_ns);
        Self { clock_ns, hold_start_ns, setup_start_ns, setup_stop_ns, low_ns, bus_free_ns }
    }

    const fn byte_ns(&self) -> u64 {
        9 * self.clock_ns
    }

    const fn stop_ns(&self) -> u64 {
        self.low_ns + self.setup_stop_ns
    }

    const fn restart_ns(&self) -> u64 {
        self.low_ns + self.setup_start_ns
    }
}

/// Result of a transaction that every chip acknowledged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Done {
    /// Time of the START condition, ns; later than requested if the bus was not free.
    pub start_ns: u64,
    /// Time of the STOP condition, ns. The next START can follow after the bus-free time.
    pub end_ns: u64,
}

/// Failure of a transaction.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// No chip acknowledged the address.
    AddressNack {
        /// Address that was sent, 7 bits.
        address: u8,
        /// Direction that was requested: true for a read.
        read: bool,
        /// Time of the STOP condition, ns.
        end_ns: u64,
    },
    /// No chip acknowledged a data byte.
    DataNack {
        /// Address of the transaction, 7 bits.
        address: u8,
        /// Index of the byte: data bytes of the transaction in both directions, from 0.
        byte: usize,
        /// Time of the STOP condition, ns.
        end_ns: u64,
    },
    /// SDA or SCL is held low: the transfer never completes. The controller has to time out and to
    /// [recover](I2cBus::recover) the bus.
    StuckLow {
        /// Time from which on the bus is held, ns.
        since_ns: u64,
    },
}

impl Fault {
    /// Time at which the transfer ended, ns; `None` if it never does.
    #[must_use]
    pub const fn end_ns(&self) -> Option<u64> {
        match *self {
            Self::AddressNack { end_ns, .. } | Self::DataNack { end_ns, .. } => Some(end_ns),
            Self::StuckLow { .. } => None,
        }
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match *self {
            Self::AddressNack { address, read, .. } => {
                let direction = if read { "read" } else { "write" };
                write!(f, "no chip acknowledged address 0x{address:02X} ({direction})")
            }
            Self::DataNack { address, byte, .. } => {
                write!(f, "data byte {byte} of a transfer with 0x{address:02X} was not acknowledged")
            }
            Self::StuckLow { since_ns } => write!(f, "bus held low since {since_ns} ns"),
        }
    }
}

impl std::error::Error for Fault {}

/// A fault to inject.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Disturbance {
    /// The address is not acknowledged, and no chip sees it.
    AddressNack,
    /// A written data byte is neither acknowledged nor taken. Bytes count as in [`Fault::DataNack`].
    DataNack {
        /// Index of the byte, from 0.
        byte: usize,
    },
    /// Bits of a data byte, written or read, are inverted. Bytes count as in [`Fault::DataNack`].
    BitFlip {
        /// Index of the byte, from 0.
        byte: usize,
        /// Mask of the inverted bits.
        mask: u8,
    },
    /// The bus is held low until it is recovered.
    StuckLow {
        /// True if nine clocks do not free it: a short circuit, not a chip in the middle of a byte.
        persistent: bool,
    },
}

/// Transactions in which an injected fault acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Span {
    /// Transactions that start in `from_ns..until_ns`; a stuck bus also interrupts one in progress at `from_ns`, and is
    /// free again at `until_ns` if it was not recovered before.
    Time {
        /// Start of the time, ns, inclusive.
        from_ns: u64,
        /// End of the time, ns, exclusive.
        until_ns: u64,
    },
    /// The next `count` transactions. A bus that is stuck stays so until recovered, and counts once.
    Transfers {
        /// Number of transactions left.
        count: u32,
    },
}

/// A fault with its time and its address.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Injection {
    /// Kind of the fault.
    pub disturbance: Disturbance,
    /// Transactions in which it acts.
    pub span: Span,
    /// Address of the transactions it is limited to; `None` for all.
    pub address: Option<u8>,
}

/// Result of the recovery of a stuck bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Recovery {
    /// Time of the STOP condition after the nine clocks, ns.
    pub end_ns: u64,
    /// True if the lines are free now.
    pub released: bool,
}

/// Counters since the bus was created, or since [`I2cBus::reset_statistics`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    /// Number of transactions, START to STOP, failed ones included.
    pub transfers: u64,
    /// Number of bytes on the wire, addresses included.
    pub bytes: u64,
    /// Number of transactions that ended at an address or data byte without acknowledgement.
    pub nacks: u64,
    /// Number of transactions that never completed.
    pub stuck: u64,
    /// Time for which the bus was occupied, ns: START to STOP, and the bus-free time.
    pub busy_ns: u64,
}

impl Statistics {
    /// Share of a time span for which the bus was occupied.
    #[must_use]
    pub fn occupancy(&self, span_ns: u64) -> f64 {
        if span_ns == 0 { 0.0 } else { self.busy_ns as f64 / span_ns as f64 }
    }
}

/// One transaction as a logic analyser would show it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WireRecord {
    /// Time of the START condition, ns.
    pub start_ns: u64,
    /// Time of the STOP condition, ns; if the bus got stuck, that time.
    pub end_ns: u64,
    /// Address of the transaction, 7 bits.
    pub address: u8,
    /// Data bytes written, as they were on the wire, including one that was not acknowledged.
    pub written: Vec<u8>,
    /// Data bytes read, as they were on the wire.
    pub read: Vec<u8>,
    /// Failure of the transaction; `None` if it was completed.
    pub fault: Option<Fault>,
}

#[derive(Debug, Default)]
struct Trace {
    capacity: usize,
    records: VecDeque<WireRecord>,
    written: Vec<u8>,
    read: Vec<u8>,
}

/// State of a bus that is held low.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Stuck {
    persistent: bool,
    /// Time at which it frees itself, ns.
    until_ns: u64,
}

/// The bus and the chips on it.
pub struct I2cBus {
    rate_hz: u32,
    timing: Timing,
    chips: Vec<Rc<RefCell<dyn I2cChip>>>,
    /// Indices of the chips addressed since the last START, and since the last STOP. Kept so that they are filled
    /// without allocation.
    listening: Vec<usize>,
    addressed: Vec<usize>,
    free_at_ns: u64,
    injections: Vec<Injection>,
    stuck: Option<Stuck>,
    /// Transaction in progress of a controller that goes byte by byte.
    open: Option<Transaction>,
    /// Start, ns, and number of the clocks that a controller gave a stuck bus by hand.
    recovery: Option<(u64, u8)>,
    statistics: Statistics,
    trace: Option<Trace>,
    misuse: MisuseLog,
}

impl fmt::Debug for I2cBus {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("I2cBus")
            .field("rate_hz", &self.rate_hz)
            .field("chips", &self.chips.len())
            .field("free_at_ns", &self.free_at_ns)
            .field("injections", &self.injections)
            .field("statistics", &self.statistics)
            .finish_non_exhaustive()
    }
}

impl I2cBus {
    /// Name of the bus in reports.
    pub const NAME: &str = "I2C bus";

    /// A free bus without chips. `rate_hz` is the frequency of SCL; 0 counts as 1.
    #[must_use]
    pub fn new(rate_hz: u32) -> Self {
        Self {
            rate_hz,
            timing: Timing::new(rate_hz),
            chips: Vec::new(),
            listening: Vec::new(),
            addressed: Vec::new(),
            free_at_ns: 0,
            injections: Vec::new(),
            stuck: None,
            open: None,
            recovery: None,
            statistics: Statistics::default(),
            trace: None,
            misuse: MisuseLog::new(),
        }
    }

    /// Connects a chip. It must not be borrowed elsewhere while [`execute`](Self::execute) runs.
    pub fn attach(&mut self, chip: Rc<RefCell<dyn I2cChip>>) {
        self.chips.push(chip);
        self.listening.reserve(self.chips.len());
        self.addressed.reserve(self.chips.len());
    }

    /// Clock rate of SCL, Hz.
    #[must_use]
    pub const fn rate_hz(&self) -> u32 {
        self.rate_hz
    }

    /// Sets the clock rate of the following transactions, Hz.
    pub fn set_rate_hz(&mut self, rate_hz: u32) {
        self.rate_hz = rate_hz;
        self.timing = Timing::new(rate_hz);
    }

    /// Earliest start of a transaction requested at `at_ns`, ns: not before the bus-free time after the last one.
    #[must_use]
    pub fn earliest_start_ns(&self, at_ns: u64) -> u64 {
        at_ns.max(self.free_at_ns)
    }

    /// Duration from START to STOP of a transaction in which everything is acknowledged, ns, without the bus-free time.
    ///
    /// As for `embedded_hal::i2c::I2c::transaction`, neighbours of the same direction are one transfer. A list without
    /// operations takes no time.
    #[must_use]
    pub fn planned_duration_ns(&self, operations: &[Operation<'_>]) -> u64 {
        let timing = &self.timing;
        let mut duration_ns = 0;
        let mut direction = None;
        for operation in operations {
            let (read, length) = match operation {
                Operation::Read(buffer) => (true, buffer.len()),
                Operation::Write(bytes) => (false, bytes.len()),
            };
            if direction != Some(read) {
                if direction.is_some() {
                    duration_ns += timing.restart_ns();
                }
                direction = Some(read);
                duration_ns += timing.hold_start_ns + timing.byte_ns();
            }
            duration_ns += length as u64 * timing.byte_ns();
        }
        if direction.is_some() { duration_ns + timing.stop_ns() } else { 0 }
    }

    /// Runs one transaction, from START at `start_ns` (or when the bus is free) to STOP.
    ///
    /// Chips get every byte with the time of its 9th clock, so they may be ahead of the caller's clock when this
    /// returns: the caller lets time pass up to the end before it uses the result.
    ///
    /// # Errors
    /// [`Fault::AddressNack`] or [`Fault::DataNack`] at the first address or byte that is not acknowledged, after which
    /// the controller sends STOP; [`Fault::StuckLow`] if the bus is held low. The buffers contain the bytes read until
    /// then.
    pub fn execute(&mut self, start_ns: u64, address: u8, operations: &mut [Operation<'_>]) -> Result<Done, Fault> {
        if operations.is_empty() {
            return Ok(Done { start_ns, end_ns: start_ns });
        }
        let start_ns = self.earliest_start_ns(start_ns);
        let mut transaction = self.open(start_ns, address);
        let mut at_ns = start_ns;
        // the transaction itself records the failure
        let _ = self.walk(&mut transaction, &mut at_ns, operations);
        let (end_ns, fault) = self.close(transaction, at_ns.saturating_add(self.timing.stop_ns()));
        fault.map_or(Ok(Done { start_ns, end_ns }), Err)
    }

    /// Sends nine clocks and a STOP, which free the bus from a chip that was left in the middle of a byte (UM10204,
    /// rev. 6, 3.1.16). Chips of the interrupted transaction see the STOP.
    pub fn recover(&mut self, at_ns: u64) -> Recovery {
        let start_ns = self.earliest_start_ns(at_ns);
        let end_ns = start_ns.saturating_add(self.timing.byte_ns()).saturating_add(self.timing.stop_ns());
        let released = self.release(start_ns, end_ns);
        if released {
            self.tell_stop(end_ns);
        }
        self.occupy(start_ns, end_ns);
        Recovery { end_ns, released }
    }

    /// Adds a fault to the active ones.
    pub fn inject(&mut self, injection: Injection) {
        if let Some(transaction) = &mut self.open {
            transaction.strike(&injection);
        }
        self.injections.push(injection);
    }

    /// Removes all injected faults; a stuck bus becomes free.
    pub fn clear_injections(&mut self) {
        self.injections.clear();
        self.stuck = None;
        if let Some(transaction) = &mut self.open {
            transaction.calm();
        }
    }

    /// Counters of the traffic on the bus.
    #[must_use]
    pub const fn statistics(&self) -> &Statistics {
        &self.statistics
    }

    /// Resets the counters to zero.
    pub fn reset_statistics(&mut self) {
        self.statistics = Statistics::default();
    }

    /// Keeps the last `capacity` transactions; 0 keeps none, at no cost.
    pub fn set_trace(&mut self, capacity: usize) {
        self.trace = (capacity > 0).then(|| Trace { capacity, ..Trace::default() });
    }

    /// Kept transactions, oldest first.
    pub fn trace(&self) -> impl Iterator<Item = &WireRecord> {
        self.trace.iter().flat_map(|trace| &trace.records)
    }

    /// Violations of the bus specification so far.
    #[must_use]
    pub const fn misuse(&self) -> &MisuseLog {
        &self.misuse
    }

    /// Violations so far, mutable, so that a test can clear them.
    pub const fn misuse_mut(&mut self) -> &mut MisuseLog {
        &mut self.misuse
    }
}

impl Trace {
    fn finish(&mut self, start_ns: u64, end_ns: u64, address: u8, fault: Option<Fault>) {
        if self.records.len() >= self.capacity {
            self.records.pop_front();
        }
        let (written, read) = (core::mem::take(&mut self.written), core::mem::take(&mut self.read));
        self.records.push_back(WireRecord { start_ns, end_ns, address, written, read, fault });
    }
}
