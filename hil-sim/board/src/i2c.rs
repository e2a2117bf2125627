//! An I2C bus with one controller: every byte at its exact virtual time, in the order of the wire, deterministic.
//!
//! The bus is synchronous: [`I2cBus::execute`] walks a whole transaction at once and tells when each part of it
//! happened; whoever calls it lets virtual time pass. Timing is that of the NXP I2C-bus specification (UM10204, rev. 6,
//! table 10), with the controller at the minimum of every parameter and the clock at the set rate, and no clock
//! stretching (none of the board's chips stretches).
//!
//! ```text
//! START  tHD;STA | 9 clocks: address | 9 clocks per byte | tLOW tSU;STA, START again, tHD;STA | ... | tLOW tSU;STO STOP | tBUF
//! ```

use core::cell::RefCell;
use core::fmt;
use std::collections::VecDeque;
use std::rc::Rc;

use embedded_hal::i2c::Operation;

use crate::misuse::{Misuse, MisuseKind, MisuseLog};

/// A target on the bus, seen from its two wires.
pub trait I2cChip {
    /// Whether the chip would acknowledge this 7-bit address now. No side effects.
    fn acknowledges(&self, address: u8, read: bool) -> bool;
    /// The chip was addressed, and acknowledged; at the end of the 9th clock of the address. Also after a repeated START.
    fn start(&mut self, at_ns: u64, address: u8, read: bool);
    /// A byte from the controller, at the end of its 9th clock; `true` acknowledges it.
    fn write(&mut self, at_ns: u64, byte: u8) -> bool;
    /// A byte for the controller, at the end of its 9th clock.
    fn read(&mut self, at_ns: u64) -> u8;
    /// STOP, after a transaction in which the chip was addressed.
    fn stop(&mut self, at_ns: u64);
}

/// UM10204, rev. 6, table 10, in nanoseconds; one set per mode, chosen by the rate.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Timing {
    /// One clock.
    clock_ns: u64,
    hold_start_ns: u64,
    setup_start_ns: u64,
    setup_stop_ns: u64,
    low_ns: u64,
    bus_free_ns: u64,
}

impl Timing {
    /// Above 1 MHz the times of Fast-mode Plus are used: no chip of the board is faster.
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

/// A transaction that every chip acknowledged.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Done {
    /// START condition; later than asked if the bus was not free.
    pub start_ns: u64,
    /// STOP condition. The next START can follow after the bus-free time.
    pub end_ns: u64,
}

/// A transaction that did not go through.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// No chip acknowledged the address.
    AddressNack {
        /// The address, 7 bits.
        address: u8,
        /// Direction asked for.
        read: bool,
        /// STOP condition.
        end_ns: u64,
    },
    /// No chip acknowledged a data byte.
    DataNack {
        /// The address, 7 bits.
        address: u8,
        /// Which: data bytes of the transaction in both directions, counted from 0.
        byte: usize,
        /// STOP condition.
        end_ns: u64,
    },
    /// SDA or SCL is held low: the transfer never completes. The controller has to time out and to
    /// [recover](I2cBus::recover) the bus.
    StuckLow {
        /// From when on nothing moved.
        since_ns: u64,
    },
}

impl Fault {
    /// When the transfer ended; `None` if it never does.
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
    /// The address is not acknowledged; no chip takes notice.
    AddressNack,
    /// A written data byte is not acknowledged, and not taken. Bytes count as in [`Fault::DataNack`].
    DataNack {
        /// Which byte.
        byte: usize,
    },
    /// Bits of a data byte, written or read, arrive inverted. Bytes count as in [`Fault::DataNack`].
    BitFlip {
        /// Which byte.
        byte: usize,
        /// Which bits.
        mask: u8,
    },
    /// The bus is held low, until recovered.
    StuckLow {
        /// Nine clocks do not help either: a short, not a chip in the middle of a byte.
        persistent: bool,
    },
}

/// When an injected fault acts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Span {
    /// In transactions that start in `from_ns..until_ns`; a stuck bus also stops one that is under way at `from_ns`, and
    /// is free again at `until_ns` if it was not recovered before.
    Time {
        /// First instant.
        from_ns: u64,
        /// First instant after it.
        until_ns: u64,
    },
    /// In the next transactions, as many. A bus that got stuck stays so until recovered, and counts once.
    Transfers {
        /// How many are left.
        count: u32,
    },
}

/// What to inject, when, and to whom.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Injection {
    /// What happens.
    pub disturbance: Disturbance,
    /// When.
    pub span: Span,
    /// Only in transactions with this address; `None` is any.
    pub address: Option<u8>,
}

/// What recovery of a stuck bus achieved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Recovery {
    /// STOP condition after the nine clocks.
    pub end_ns: u64,
    /// Whether the lines are free now.
    pub released: bool,
}

/// Counted since the bus was made, or since [`I2cBus::reset_statistics`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    /// Transactions, START to STOP, also those that failed.
    pub transfers: u64,
    /// Bytes on the wire, addresses included.
    pub bytes: u64,
    /// Transactions that ended at an address or data byte that was not acknowledged.
    pub nacks: u64,
    /// Transactions that never completed.
    pub stuck: u64,
    /// Time for which nobody else could use the bus: START to STOP, and the bus-free time.
    pub busy_ns: u64,
}

impl Statistics {
    /// Share of a time span for which the bus was taken.
    #[must_use]
    pub fn occupancy(&self, span_ns: u64) -> f64 {
        if span_ns == 0 { 0.0 } else { self.busy_ns as f64 / span_ns as f64 }
    }
}

/// One transaction as a logic analyser would show it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct WireRecord {
    /// START condition.
    pub start_ns: u64,
    /// STOP condition; when it stopped moving, if the bus got stuck.
    pub end_ns: u64,
    /// The 7-bit address.
    pub address: u8,
    /// Data bytes written, as they were on the wire, the one not acknowledged included.
    pub written: Vec<u8>,
    /// Data bytes read, as they were on the wire.
    pub read: Vec<u8>,
    /// How it ended.
    pub fault: Option<Fault>,
}

#[derive(Debug, Default)]
struct Trace {
    capacity: usize,
    records: VecDeque<WireRecord>,
    written: Vec<u8>,
    read: Vec<u8>,
}

/// A bus held low.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Stuck {
    persistent: bool,
    /// When it frees itself.
    until_ns: u64,
}

/// The faults that act on one transaction.
#[derive(Clone, Copy, Debug)]
struct Disturbed {
    address_nack: bool,
    data_nack: usize,
    flip_byte: usize,
    flip_mask: u8,
    stuck_at_ns: u64,
    stuck: Option<Stuck>,
}

impl Disturbed {
    const NOT: Self = Self {
        address_nack: false,
        data_nack: usize::MAX,
        flip_byte: usize::MAX,
        flip_mask: 0,
        stuck_at_ns: u64::MAX,
        stuck: None,
    };
}

/// The bus and the chips on it.
pub struct I2cBus {
    rate_hz: u32,
    timing: Timing,
    chips: Vec<Rc<RefCell<dyn I2cChip>>>,
    /// Addressed since the last START; and since the last STOP. Indices, kept to be filled again without allocation.
    listening: Vec<usize>,
    addressed: Vec<usize>,
    free_at_ns: u64,
    injections: Vec<Injection>,
    stuck: Option<Stuck>,
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
    /// What it is called in reports.
    pub const NAME: &str = "I2C bus";

    /// A free bus without chips. The rate is that of SCL; 0 counts as 1.
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

    /// Clock rate.
    #[must_use]
    pub const fn rate_hz(&self) -> u32 {
        self.rate_hz
    }

    /// Sets the clock rate of the following transactions.
    pub fn set_rate_hz(&mut self, rate_hz: u32) {
        self.rate_hz = rate_hz;
        self.timing = Timing::new(rate_hz);
    }

    /// When a transaction asked for at `at_ns` can start: not before the bus-free time after the last one.
    #[must_use]
    pub fn earliest_start_ns(&self, at_ns: u64) -> u64 {
        at_ns.max(self.free_at_ns)
    }

    /// From START to STOP of a transaction in which everything is acknowledged. The bus-free time comes on top.
    ///
    /// As `embedded_hal::i2c::I2c::transaction` has it, neighbours of the same direction are one transfer. A list without
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

    /// One transaction, from START at `start_ns` (or when the bus is free) to STOP.
    ///
    /// Chips get every byte with the time of its 9th clock, so they may be ahead of the caller's clock when this returns:
    /// the caller lets time pass up to the end before it acts on the result.
    ///
    /// # Errors
    /// At the first address or byte that is not acknowledged, after which the controller sends STOP; or if the bus is
    /// held low. What was read until then is in the buffers.
    pub fn execute(&mut self, start_ns: u64, address: u8, operations: &mut [Operation<'_>]) -> Result<Done, Fault> {
        if operations.is_empty() {
            return Ok(Done { start_ns, end_ns: start_ns });
        }
        let start_ns = self.earliest_start_ns(start_ns);
        let undisturbed = self.injections.is_empty() && self.stuck.is_none();
        let disturbed = if undisturbed { Disturbed::NOT } else { self.disturbed(start_ns, address) };
        self.statistics.transfers += 1;
        self.addressed.clear();
        self.listening.clear();

        let mut at_ns = start_ns;
        let outcome = self.walk(&mut at_ns, address, operations, &disturbed);
        let fault = match outcome {
            Ok(()) => {
                at_ns = self.stop(at_ns);
                None
            }
            Err(Nack::Address { read }) => {
                at_ns = self.stop(at_ns);
                self.statistics.nacks += 1;
                Some(Fault::AddressNack { address, read, end_ns: at_ns })
            }
            Err(Nack::Data { byte }) => {
                at_ns = self.stop(at_ns);
                self.statistics.nacks += 1;
                Some(Fault::DataNack { address, byte, end_ns: at_ns })
            }
            Err(Nack::Stuck) => {
                at_ns = disturbed.stuck_at_ns.max(start_ns);
                self.stuck = disturbed.stuck;
                self.statistics.stuck += 1;
                Some(Fault::StuckLow { since_ns: at_ns })
            }
        };
        self.free_at_ns = at_ns.saturating_add(self.timing.bus_free_ns);
        self.statistics.busy_ns = self.statistics.busy_ns.saturating_add(self.free_at_ns - start_ns);
        if let Some(trace) = &mut self.trace {
            trace.finish(start_ns, at_ns, address, fault);
        }
        fault.map_or(Ok(Done { start_ns, end_ns: at_ns }), Err)
    }

    /// Nine clocks and a STOP from the controller, which free the bus from a chip that was left in the middle of a byte
    /// (UM10204, rev. 6, 3.1.16). Chips of the interrupted transaction see the STOP.
    pub fn recover(&mut self, at_ns: u64) -> Recovery {
        let start_ns = self.earliest_start_ns(at_ns);
        let clocked_ns = start_ns.saturating_add(self.timing.byte_ns());
        let end_ns = clocked_ns.saturating_add(self.timing.stop_ns());
        let released = self.stuck.is_none_or(|stuck| !stuck.persistent || stuck.until_ns <= end_ns);
        if released {
            self.stuck = None;
            // what held the bus has let go, also if it would have held it for longer
            self.injections.retain(|injection| {
                let Span::Time { from_ns, .. } = injection.span else { return true };
                from_ns > start_ns || injection.disturbance != Disturbance::StuckLow { persistent: false }
            });
            self.stop(clocked_ns);
        }
        self.free_at_ns = end_ns.saturating_add(self.timing.bus_free_ns);
        self.statistics.busy_ns = self.statistics.busy_ns.saturating_add(self.free_at_ns - start_ns);
        Recovery { end_ns, released }
    }

    /// Adds a fault to those that act.
    pub fn inject(&mut self, injection: Injection) {
        self.injections.push(injection);
    }

    /// Takes all injected faults away; a stuck bus is free.
    pub fn clear_injections(&mut self) {
        self.injections.clear();
        self.stuck = None;
    }

    /// What went over the wire.
    #[must_use]
    pub const fn statistics(&self) -> &Statistics {
        &self.statistics
    }

    /// Counts from zero again.
    pub fn reset_statistics(&mut self) {
        self.statistics = Statistics::default();
    }

    /// Keeps the last transactions, as many as `capacity`; 0 keeps none, which costs nothing.
    pub fn set_trace(&mut self, capacity: usize) {
        self.trace = (capacity > 0).then(|| Trace { capacity, ..Trace::default() });
    }

    /// The kept transactions, oldest first.
    pub fn trace(&self) -> impl Iterator<Item = &WireRecord> {
        self.trace.iter().flat_map(|trace| &trace.records)
    }

    /// What was done against the bus specification.
    #[must_use]
    pub const fn misuse(&self) -> &MisuseLog {
        &self.misuse
    }

    /// The same, to be cleared.
    pub const fn misuse_mut(&mut self) -> &mut MisuseLog {
        &mut self.misuse
    }

    /// Everything between START and STOP; moves `at_ns` to the end of the last clock.
    fn walk(
        &mut self,
        at_ns: &mut u64,
        address: u8,
        operations: &mut [Operation<'_>],
        disturbed: &Disturbed,
    ) -> Result<(), Nack> {
        let mut direction = None;
        let mut byte = 0;
        let mut bytes_in_segment = 0;
        for operation in operations {
            let read = matches!(operation, Operation::Read(_));
            if direction != Some(read) {
                if direction.is_some() {
                    self.check_read(*at_ns, address, direction, bytes_in_segment);
                    self.pass(at_ns, self.timing.restart_ns(), disturbed)?;
                }
                direction = Some(read);
                bytes_in_segment = 0;
                self.address(at_ns, address, read, disturbed)?;
            }
            match operation {
                Operation::Write(bytes) => {
                    for &sent in *bytes {
                        self.write_byte(at_ns, byte, sent, disturbed)?;
                        byte += 1;
                        bytes_in_segment += 1;
                    }
                }
                Operation::Read(buffer) => {
                    for received in &mut **buffer {
                        *received = self.read_byte(at_ns, byte, disturbed)?;
                        byte += 1;
                        bytes_in_segment += 1;
                    }
                }
            }
        }
        self.check_read(*at_ns, address, direction, bytes_in_segment);
        // a bus that sticks between the last byte and STOP
        let mut stop_ns = *at_ns;
        self.pass(&mut stop_ns, self.timing.stop_ns(), disturbed)
    }

    /// START and the address byte.
    fn address(&mut self, at_ns: &mut u64, address: u8, read: bool, disturbed: &Disturbed) -> Result<(), Nack> {
        self.pass(at_ns, self.timing.hold_start_ns + self.timing.byte_ns(), disturbed)?;
        self.statistics.bytes += 1;
        self.listening.clear();
        if disturbed.address_nack || address > 0x7F {
            return Err(Nack::Address { read });
        }
        for (index, chip) in self.chips.iter().enumerate() {
            if chip.borrow().acknowledges(address, read) {
                self.listening.push(index);
                if !self.addressed.contains(&index) {
                    self.addressed.push(index);
                }
                chip.borrow_mut().start(*at_ns, address, read);
            }
        }
        let chips = self.listening.len();
        if read && chips > 1 {
            self.report(*at_ns, address, MisuseKind::SeveralReaders { address, chips });
        }
        if chips == 0 { Err(Nack::Address { read }) } else { Ok(()) }
    }

    #[inline]
    fn write_byte(&mut self, at_ns: &mut u64, byte: usize, sent: u8, disturbed: &Disturbed) -> Result<(), Nack> {
        self.pass(at_ns, self.timing.byte_ns(), disturbed)?;
        self.statistics.bytes += 1;
        let on_wire = if byte == disturbed.flip_byte { sent ^ disturbed.flip_mask } else { sent };
        if let Some(trace) = &mut self.trace {
            trace.written.push(on_wire);
        }
        if byte == disturbed.data_nack {
            return Err(Nack::Data { byte });
        }
        let mut acknowledged = false;
        for &index in &self.listening {
            acknowledged |= self.chips[index].borrow_mut().write(*at_ns, on_wire);
        }
        if acknowledged { Ok(()) } else { Err(Nack::Data { byte }) }
    }

    #[inline]
    fn read_byte(&mut self, at_ns: &mut u64, byte: usize, disturbed: &Disturbed) -> Result<u8, Nack> {
        self.pass(at_ns, self.timing.byte_ns(), disturbed)?;
        self.statistics.bytes += 1;
        let mut on_wire = 0xFF;
        for &index in &self.listening {
            on_wire &= self.chips[index].borrow_mut().read(*at_ns);
        }
        if byte == disturbed.flip_byte {
            on_wire ^= disturbed.flip_mask;
        }
        if let Some(trace) = &mut self.trace {
            trace.read.push(on_wire);
        }
        Ok(on_wire)
    }

    /// STOP, for all chips addressed since the last one; when it happened.
    fn stop(&mut self, at_ns: u64) -> u64 {
        let stop_ns = at_ns.saturating_add(self.timing.stop_ns());
        for &index in &self.addressed {
            self.chips[index].borrow_mut().stop(stop_ns);
        }
        self.addressed.clear();
        stop_ns
    }

    /// Lets `duration_ns` pass, unless the bus sticks within it.
    #[inline]
    fn pass(&self, at_ns: &mut u64, duration_ns: u64, disturbed: &Disturbed) -> Result<(), Nack> {
        *at_ns = at_ns.saturating_add(duration_ns);
        if disturbed.stuck_at_ns < *at_ns { Err(Nack::Stuck) } else { Ok(()) }
    }

    fn check_read(&mut self, at_ns: u64, address: u8, direction: Option<bool>, bytes: usize) {
        if direction == Some(true) && bytes == 0 {
            self.report(at_ns, address, MisuseKind::EmptyRead { address });
        }
    }

    #[cold]
    fn report(&mut self, time_ns: u64, address: u8, kind: MisuseKind) {
        self.misuse.report(Misuse { time_ns, chip: Self::NAME, address, kind });
    }

    /// Collects what acts on a transaction and uses up what is counted in transactions.
    #[cold]
    fn disturbed(&mut self, start_ns: u64, address: u8) -> Disturbed {
        let mut disturbed = Disturbed::NOT;
        self.stuck = self.stuck.filter(|stuck| start_ns < stuck.until_ns);
        if let Some(stuck) = self.stuck {
            return Disturbed { stuck_at_ns: start_ns, stuck: Some(stuck), ..disturbed };
        }
        for injection in &mut self.injections {
            if injection.address.is_some_and(|only| only != address) {
                continue;
            }
            let sticks = matches!(injection.disturbance, Disturbance::StuckLow { .. });
            let (acts_at_ns, until_ns) = match &mut injection.span {
                Span::Time { from_ns, until_ns } if start_ns < *until_ns && *from_ns < *until_ns => {
                    if !sticks && start_ns < *from_ns {
                        continue;
                    }
                    (start_ns.max(*from_ns), *until_ns)
                }
                Span::Transfers { count } if *count > 0 => {
                    *count -= 1;
                    (start_ns, u64::MAX)
                }
                _ => continue,
            };
            match injection.disturbance {
                Disturbance::AddressNack => disturbed.address_nack = true,
                Disturbance::DataNack { byte } => disturbed.data_nack = disturbed.data_nack.min(byte),
                Disturbance::BitFlip { byte, mask } => (disturbed.flip_byte, disturbed.flip_mask) = (byte, mask),
                Disturbance::StuckLow { persistent } if acts_at_ns < disturbed.stuck_at_ns => {
                    disturbed.stuck_at_ns = acts_at_ns;
                    disturbed.stuck = Some(Stuck { persistent, until_ns });
                }
                Disturbance::StuckLow { .. } => {}
            }
        }
        self.injections.retain(|injection| match injection.span {
            Span::Time { until_ns, .. } => start_ns < until_ns,
            Span::Transfers { count } => count > 0,
        });
        disturbed
    }
}

/// Why a walk ended early.
enum Nack {
    Address { read: bool },
    Data { byte: usize },
    Stuck,
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

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Acknowledges one address and as many bytes as told; keeps what it was told, with the time.
    #[derive(Default)]
    struct Target {
        address: u8,
        takes: usize,
        gives: u8,
        taken: Vec<(u64, u8)>,
        starts: Vec<(u64, bool)>,
        stops: Vec<u64>,
    }

    impl I2cChip for Target {
        fn acknowledges(&self, address: u8, _read: bool) -> bool {
            address == self.address
        }
        fn start(&mut self, at_ns: u64, _address: u8, read: bool) {
            self.starts.push((at_ns, read));
        }
        fn write(&mut self, at_ns: u64, byte: u8) -> bool {
            self.taken.push((at_ns, byte));
            self.taken.len() <= self.takes
        }
        fn read(&mut self, _at_ns: u64) -> u8 {
            self.gives
        }
        fn stop(&mut self, at_ns: u64) {
            self.stops.push(at_ns);
        }
    }

    fn target(address: u8) -> Rc<RefCell<Target>> {
        Rc::new(RefCell::new(Target { address, takes: 1000, gives: 0xA5, ..Target::default() }))
    }

    fn bus_with(target: &Rc<RefCell<Target>>) -> I2cBus {
        let mut bus = I2cBus::new(400_000);
        bus.attach(target.clone());
        bus
    }

    // 400 kHz: 2500 ns a clock, 22500 ns a byte; hold START 600; tLOW 1300 and set-up STOP 600
    const BYTE_NS: u64 = 22_500;
    const START_NS: u64 = 600;
    const STOP_NS: u64 = 1_900;

    #[test]
    fn every_byte_has_the_time_of_its_ninth_clock() {
        let chip = target(0x40);
        let mut bus = bus_with(&chip);
        let done = bus.execute(1_000, 0x40, &mut [Operation::Write(&[6, 7])]).unwrap();
        let end_ns = 1_000 + START_NS + 3 * BYTE_NS + STOP_NS;
        assert_eq!(done, Done { start_ns: 1_000, end_ns });
        let chip = chip.borrow();
        assert_eq!(chip.starts, [(1_000 + START_NS + BYTE_NS, false)]);
        assert_eq!(chip.taken, [(1_000 + START_NS + 2 * BYTE_NS, 6), (1_000 + START_NS + 3 * BYTE_NS, 7)]);
        assert_eq!(chip.stops, [end_ns]);
    }

    #[test]
    fn planned_durations() {
        let [a, b, c] = [[0_u8; 3], [0; 3], [0; 3]];
        let mut buffer = [0_u8; 4];
        // rate, operations, expected: clocks, START and repeated START, STOP
        let cases: [(u32, &[Operation<'_>], u64); 6] = [
            (400_000, &[], 0),
            (400_000, &[Operation::Write(&[])], START_NS + BYTE_NS + STOP_NS),
            (400_000, &[Operation::Write(&a)], START_NS + 4 * BYTE_NS + STOP_NS),
            // joined: no second START
            (
                400_000,
                &[Operation::Write(&a), Operation::Write(&b), Operation::Write(&c)],
                START_NS + 10 * BYTE_NS + STOP_NS,
            ),
            (
                400_000,
                &[Operation::Write(&a), Operation::Read(&mut buffer)],
                START_NS + 4 * BYTE_NS + (1_300 + 600 + START_NS) + 5 * BYTE_NS + STOP_NS,
            ),
            // 10 us a clock; tLOW is half a clock there
            (100_000, &[Operation::Write(&a)], 4_000 + 36 * 10_000 + 5_000 + 4_000),
        ];
        for (rate_hz, operations, expected_ns) in cases {
            assert_eq!(I2cBus::new(rate_hz).planned_duration_ns(operations), expected_ns, "{operations:?}");
        }
    }

    #[test]
    fn the_bus_is_free_after_t_buf() {
        for (rate_hz, bus_free_ns) in [(100_000, 4_700), (400_000, 1_300), (1_000_000, 500)] {
            let chip = target(0x40);
            let mut bus = I2cBus::new(rate_hz);
            bus.attach(chip);
            let first = bus.execute(0, 0x40, &mut [Operation::Write(&[1])]).unwrap();
            let second = bus.execute(first.start_ns + 1, 0x40, &mut [Operation::Write(&[1])]).unwrap();
            assert_eq!(second.start_ns, first.end_ns + bus_free_ns);
            assert_eq!(bus.statistics().busy_ns, second.end_ns + bus_free_ns);
        }
    }

    #[test]
    fn stops_at_the_first_byte_not_acknowledged() {
        let chip = target(0x40);
        chip.borrow_mut().takes = 2;
        let mut bus = bus_with(&chip);
        let fault = bus.execute(0, 0x40, &mut [Operation::Write(&[1, 2]), Operation::Write(&[3, 4])]).unwrap_err();
        let end_ns = START_NS + 4 * BYTE_NS + STOP_NS;
        assert_eq!(fault, Fault::DataNack { address: 0x40, byte: 2, end_ns });
        assert_eq!(chip.borrow().stops, [end_ns]);
        let fault = bus.execute(end_ns, 0x41, &mut [Operation::Write(&[1])]).unwrap_err();
        assert!(matches!(fault, Fault::AddressNack { address: 0x41, read: false, .. }));
        assert_eq!(bus.statistics().nacks, 2);
        assert_eq!(bus.statistics().bytes, 5);
    }

    #[test]
    fn chips_at_one_address_share_it() {
        let (first, second) = (target(0x70), target(0x70));
        (first.borrow_mut().gives, second.borrow_mut().gives) = (0xF0, 0x3C);
        first.borrow_mut().takes = 0;
        let mut bus = bus_with(&first);
        bus.attach(second.clone());
        let mut buffer = [0];
        bus.execute(0, 0x70, &mut [Operation::Write(&[9]), Operation::Read(&mut buffer)]).unwrap();
        assert_eq!(buffer, [0x30]);
        assert_eq!(bus.misuse().first()[0].kind, MisuseKind::SeveralReaders { address: 0x70, chips: 2 });
        for chip in [first, second] {
            assert_eq!(chip.borrow().taken.len(), 1);
            assert_eq!(chip.borrow().starts.len(), 2);
            assert_eq!(chip.borrow().stops.len(), 1);
        }
    }

    #[test]
    fn injected_faults() {
        let chip = target(0x40);
        let mut bus = bus_with(&chip);
        bus.set_trace(8);
        let next = |count| Span::Transfers { count };
        let inject = |bus: &mut I2cBus, disturbance, span| bus.inject(Injection { disturbance, span, address: None });

        inject(&mut bus, Disturbance::AddressNack, next(2));
        for _ in 0..2 {
            let fault = bus.execute(0, 0x40, &mut [Operation::Write(&[1])]).unwrap_err();
            assert!(matches!(fault, Fault::AddressNack { .. }));
        }
        assert!(chip.borrow().starts.is_empty());

        inject(&mut bus, Disturbance::DataNack { byte: 1 }, next(1));
        let fault = bus.execute(0, 0x40, &mut [Operation::Write(&[1, 2, 3])]).unwrap_err();
        assert!(matches!(fault, Fault::DataNack { byte: 1, .. }));
        assert_eq!(chip.borrow().taken.len(), 1);

        let flip = Disturbance::BitFlip { byte: 1, mask: 0x81 };
        inject(&mut bus, flip, Span::Time { from_ns: 1_000_000, until_ns: 2_000_000 });
        let mut buffer = [0; 2];
        bus.execute(1_000_000, 0x40, &mut [Operation::Write(&[1]), Operation::Read(&mut buffer)]).unwrap();
        assert_eq!(buffer, [0xA5 ^ 0x81, 0xA5]);
        bus.execute(2_000_000, 0x40, &mut [Operation::Write(&[1, 2])]).unwrap();

        let records: Vec<_> = bus.trace().collect();
        assert_eq!(records.len(), 5);
        assert_eq!(records[3].written, [1]);
        assert_eq!(records[3].read, [0x24, 0xA5]);
        assert_eq!((records[4].start_ns, &records[4].written), (2_000_000, &vec![1, 2]));
    }

    #[test]
    fn a_stuck_bus_needs_nine_clocks() {
        let chip = target(0x40);
        let mut bus = bus_with(&chip);
        let disturbance = Disturbance::StuckLow { persistent: false };
        // within the second data byte
        let from_ns = START_NS + 2 * BYTE_NS + 1;
        bus.inject(Injection { disturbance, span: Span::Time { from_ns, until_ns: u64::MAX }, address: None });
        let fault = bus.execute(0, 0x40, &mut [Operation::Write(&[1, 2, 3])]).unwrap_err();
        assert_eq!(fault, Fault::StuckLow { since_ns: from_ns });
        assert_eq!(fault.end_ns(), None);
        assert_eq!(chip.borrow().taken.len(), 1);
        assert!(matches!(bus.execute(5_000_000, 0x20, &mut [Operation::Write(&[1])]), Err(Fault::StuckLow { .. })));
        let recovery = bus.recover(10_000_000);
        assert_eq!(recovery, Recovery { end_ns: 10_000_000 + BYTE_NS + STOP_NS, released: true });
        bus.execute(10_000_000, 0x40, &mut [Operation::Write(&[1])]).unwrap();
        assert_eq!(bus.statistics().stuck, 2);
    }

    #[test]
    fn a_shorted_bus_stays_stuck() {
        let mut bus = bus_with(&target(0x40));
        let disturbance = Disturbance::StuckLow { persistent: true };
        bus.inject(Injection { disturbance, span: Span::Transfers { count: 1 }, address: None });
        for at_ns in [0, 1_000_000] {
            assert!(matches!(bus.execute(at_ns, 0x40, &mut [Operation::Write(&[1])]), Err(Fault::StuckLow { .. })));
            assert!(!bus.recover(at_ns).released);
        }
        bus.clear_injections();
        bus.execute(2_000_000, 0x40, &mut [Operation::Write(&[1])]).unwrap();
    }

    #[test]
    fn an_empty_read_is_reported() {
        let mut bus = bus_with(&target(0x40));
        bus.execute(0, 0x40, &mut [Operation::Read(&mut [])]).unwrap();
        assert_eq!(bus.misuse().first()[0].kind, MisuseKind::EmptyRead { address: 0x40 });
    }

    proptest! {
        #[test]
        fn executes_in_the_planned_time(
            rate_hz in 1_000u32..2_000_000,
            start_ns in 0u64..1_000_000_000,
            operations in prop::collection::vec((any::<bool>(), prop::collection::vec(any::<u8>(), 0..9)), 1..6),
        ) {
            let chip = target(0x40);
            let mut bus = I2cBus::new(rate_hz);
            bus.attach(chip);
            let mut buffers = operations.clone();
            let mut list: Vec<_> = buffers
                .iter_mut()
                .map(|(read, bytes)| if *read { Operation::Read(bytes) } else { Operation::Write(bytes) })
                .collect();
            let planned_ns = bus.planned_duration_ns(&list);
            let done = bus.execute(start_ns, 0x40, &mut list).unwrap();
            prop_assert_eq!(done.end_ns - done.start_ns, planned_ns);
        }
    }
}
