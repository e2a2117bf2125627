//! Events on the wires, byte by byte, common to both interfaces of the bus.

use embedded_hal::i2c::Operation;

use super::{Disturbance, Fault, I2cBus, Injection, Span, Stuck};
use crate::misuse::{Misuse, MisuseKind};

/// Injected faults that act on one transaction.
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

/// Reasons why a transaction does not continue.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Failure {
    Address { read: bool },
    Data { byte: usize },
    Stuck,
}

/// A transaction from its START on.
#[derive(Clone, Copy, Debug)]
pub(super) struct Transaction {
    start_ns: u64,
    /// First address of the transaction.
    address: u8,
    disturbed: Disturbed,
    /// True if the last address was for reading; `None` before it.
    reading: Option<bool>,
    /// Number of data bytes so far, and since the last address.
    bytes: usize,
    in_segment: usize,
    /// First failure of the transaction.
    failure: Option<Failure>,
}

impl Transaction {
    pub(super) fn is_stuck(&self) -> bool {
        self.failure == Some(Failure::Stuck)
    }

    pub(super) fn has_failed(&self) -> bool {
        self.failure.is_some()
    }

    /// True while its lines are held low at `now_ns`.
    pub(super) fn is_held(&self, now_ns: u64) -> bool {
        self.disturbed.stuck_at_ns <= now_ns && self.disturbed.stuck.is_some_and(|stuck| now_ns < stuck.until_ns)
    }

    /// Applies a fault that is injected during the transaction: only a stuck bus acts.
    pub(super) fn strike(&mut self, injection: &Injection) {
        let Disturbance::StuckLow { persistent } = injection.disturbance else { return };
        let Span::Time { from_ns, until_ns } = injection.span else { return };
        let here = injection.address.is_none_or(|only| only == self.address);
        if here && from_ns < self.disturbed.stuck_at_ns && from_ns < until_ns {
            self.disturbed.stuck_at_ns = from_ns;
            self.disturbed.stuck = Some(Stuck { persistent, until_ns });
        }
    }

    /// Removes all injected faults from the transaction.
    pub(super) fn calm(&mut self) {
        self.disturbed = Disturbed::NOT;
    }

    /// Checks that the bus was not stuck up to `at_ns`.
    #[inline]
    pub(super) fn moves(&mut self, at_ns: u64) -> Result<(), Failure> {
        if self.disturbed.stuck_at_ns < at_ns { Err(self.fail(Failure::Stuck)) } else { Ok(()) }
    }

    #[cold]
    fn fail(&mut self, failure: Failure) -> Failure {
        if failure == Failure::Stuck {
            self.failure = Some(failure);
        }
        self.failure.get_or_insert(failure);
        failure
    }
}

impl I2cBus {
    /// Starts a transaction (START condition).
    pub(super) fn open(&mut self, start_ns: u64, address: u8) -> Transaction {
        let undisturbed = self.injections.is_empty() && self.stuck.is_none();
        let disturbed = if undisturbed { Disturbed::NOT } else { self.disturbed(start_ns, address) };
        self.statistics.transfers += 1;
        self.addressed.clear();
        self.listening.clear();
        Transaction { start_ns, address, disturbed, reading: None, bytes: 0, in_segment: 0, failure: None }
    }

    /// Runs everything between START and STOP; moves `at_ns` to the end of the last clock.
    pub(super) fn walk(
        &mut self,
        transaction: &mut Transaction,
        at_ns: &mut u64,
        operations: &mut [Operation<'_>],
    ) -> Result<(), Failure> {
        let address = transaction.address;
        let byte_ns = self.timing.byte_ns();
        for operation in operations {
            let read = matches!(operation, Operation::Read(_));
            if transaction.reading != Some(read) {
                if transaction.reading.is_some() {
                    self.check_read(transaction, *at_ns);
                    *at_ns = at_ns.saturating_add(self.timing.restart_ns());
                }
                *at_ns = at_ns.saturating_add(self.timing.hold_start_ns + byte_ns);
                self.put_address(transaction, *at_ns, address, read)?;
            }
            match operation {
                Operation::Write(bytes) => {
                    for &sent in *bytes {
                        *at_ns = at_ns.saturating_add(byte_ns);
                        self.put(transaction, *at_ns, sent)?;
                    }
                }
                Operation::Read(buffer) => {
                    for received in &mut **buffer {
                        *at_ns = at_ns.saturating_add(byte_ns);
                        *received = self.get(transaction, *at_ns)?;
                    }
                }
            }
        }
        self.check_read(transaction, *at_ns);
        // the bus may stick between the last byte and STOP
        transaction.moves(at_ns.saturating_add(self.timing.stop_ns()))
    }

    /// Sends the address byte, at the end of its 9th clock.
    pub(super) fn put_address(
        &mut self,
        transaction: &mut Transaction,
        at_ns: u64,
        address: u8,
        read: bool,
    ) -> Result<(), Failure> {
        transaction.moves(at_ns)?;
        transaction.reading = Some(read);
        transaction.in_segment = 0;
        self.statistics.bytes += 1;
        self.listening.clear();
        if transaction.disturbed.address_nack || address > 0x7F {
            return Err(transaction.fail(Failure::Address { read }));
        }
        for (index, chip) in self.chips.iter().enumerate() {
            if chip.borrow().acknowledges(address, read) {
                self.listening.push(index);
                if !self.addressed.contains(&index) {
                    self.addressed.push(index);
                }
                chip.borrow_mut().start(at_ns, address, read);
            }
        }
        let chips = self.listening.len();
        if read && chips > 1 {
            self.report(at_ns, address, MisuseKind::SeveralReaders { address, chips });
        }
        if chips == 0 { Err(transaction.fail(Failure::Address { read })) } else { Ok(()) }
    }

    /// Sends a byte from the controller, at the end of its 9th clock.
    #[inline]
    pub(super) fn put(&mut self, transaction: &mut Transaction, at_ns: u64, sent: u8) -> Result<(), Failure> {
        transaction.moves(at_ns)?;
        self.statistics.bytes += 1;
        let byte = transaction.bytes;
        transaction.bytes += 1;
        transaction.in_segment += 1;
        let Disturbed { data_nack, flip_byte, flip_mask, .. } = transaction.disturbed;
        let on_wire = if byte == flip_byte { sent ^ flip_mask } else { sent };
        if let Some(trace) = &mut self.trace {
            trace.written.push(on_wire);
        }
        let mut acknowledged = false;
        if byte != data_nack {
            for &index in &self.listening {
                acknowledged |= self.chips[index].borrow_mut().write(at_ns, on_wire);
            }
        }
        if acknowledged { Ok(()) } else { Err(transaction.fail(Failure::Data { byte })) }
    }

    /// Reads a byte for the controller, at the end of its 9th clock.
    #[inline]
    pub(super) fn get(&mut self, transaction: &mut Transaction, at_ns: u64) -> Result<u8, Failure> {
        transaction.moves(at_ns)?;
        self.statistics.bytes += 1;
        let byte = transaction.bytes;
        transaction.bytes += 1;
        transaction.in_segment += 1;
        let mut on_wire = 0xFF;
        for &index in &self.listening {
            on_wire &= self.chips[index].borrow_mut().read(at_ns);
        }
        if byte == transaction.disturbed.flip_byte {
            on_wire ^= transaction.disturbed.flip_mask;
        }
        if let Some(trace) = &mut self.trace {
            trace.read.push(on_wire);
        }
        Ok(on_wire)
    }

    /// Ends a transaction by STOP at `stop_ns`, unless the bus is stuck. Returns the time of its end and the failure,
    /// if any.
    pub(super) fn close(&mut self, transaction: Transaction, stop_ns: u64) -> (u64, Option<Fault>) {
        let Transaction { start_ns, address, disturbed, failure, .. } = transaction;
        let mut end_ns = stop_ns;
        let fault = match failure {
            Some(Failure::Stuck) => {
                end_ns = disturbed.stuck_at_ns.max(start_ns);
                self.stuck = disturbed.stuck;
                self.statistics.stuck += 1;
                Some(Fault::StuckLow { since_ns: end_ns })
            }
            Some(Failure::Address { read }) => Some(Fault::AddressNack { address, read, end_ns }),
            Some(Failure::Data { byte }) => Some(Fault::DataNack { address, byte, end_ns }),
            None => None,
        };
        if !transaction.is_stuck() {
            self.statistics.nacks += u64::from(fault.is_some());
            self.tell_stop(stop_ns);
        }
        self.occupy(start_ns, end_ns);
        if let Some(trace) = &mut self.trace {
            trace.finish(start_ns, end_ns, address, fault);
        }
        (end_ns, fault)
    }

    /// Accounts for the time in which the bus was occupied, with the bus-free time after it.
    pub(super) fn occupy(&mut self, start_ns: u64, end_ns: u64) {
        let start_ns = start_ns.max(self.free_at_ns);
        self.free_at_ns = end_ns.saturating_add(self.timing.bus_free_ns);
        self.statistics.busy_ns = self.statistics.busy_ns.saturating_add(self.free_at_ns.saturating_sub(start_ns));
    }

    /// Sends STOP to all chips addressed since the last one.
    pub(super) fn tell_stop(&mut self, stop_ns: u64) {
        for &index in &self.addressed {
            self.chips[index].borrow_mut().stop(stop_ns);
        }
        self.addressed.clear();
    }

    /// Applies nine clocks from `start_ns` to `end_ns`, and returns true if the bus is free.
    pub(super) fn release(&mut self, start_ns: u64, end_ns: u64) -> bool {
        let released = self.stuck.is_none_or(|stuck| !stuck.persistent || stuck.until_ns <= end_ns);
        if released {
            self.stuck = None;
            // a chip that released the bus does not hold it again, even if its fault had lasted longer
            self.injections.retain(|injection| {
                let Span::Time { from_ns, .. } = injection.span else { return true };
                from_ns > start_ns || injection.disturbance != Disturbance::StuckLow { persistent: false }
            });
        }
        released
    }

    /// Reports a read without bytes when the controller ends the segment.
    pub(super) fn check_read(&mut self, transaction: &Transaction, at_ns: u64) {
        if transaction.reading == Some(true) && transaction.in_segment == 0 {
            let address = transaction.address;
            self.report(at_ns, address, MisuseKind::EmptyRead { address });
        }
    }

    #[cold]
    fn report(&mut self, time_ns: u64, address: u8, kind: MisuseKind) {
        self.misuse.report(Misuse { time_ns, chip: Self::NAME, address, kind });
    }

    /// Collects the faults that act on a transaction, and decrements those limited to a number of transactions.
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
