//! Devices on the board's connectors: a UART whose output is wired to its input, and an I2C EEPROM.

use std::collections::VecDeque;

use crate::i2c::I2cChip;
use crate::misuse::{Misuse, MisuseKind, MisuseLog};
use crate::uart::{LineNoise, UartByte, ns_per_byte};

/// A byte on the wire.
#[derive(Clone, Copy, Debug)]
struct OnWire {
    start_ns: u64,
    end_ns: u64,
    /// Byte at its arrival; `None` if noise hid it.
    byte: Option<UartByte>,
}

/// Result of a read.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Received {
    /// Number of bytes put into the buffer.
    pub len: usize,
    /// Number of bytes lost since the last read, because the receiver was full: the UART's overrun flag.
    pub lost: u64,
}

/// A UART, 8N1, whose output is wired to its input. The sender never blocks: written bytes follow each other without
/// gaps.
#[derive(Clone, Debug)]
pub struct UartLoopback {
    ns_per_byte: u64,
    capacity: usize,
    now_ns: u64,
    under_way: VecDeque<OnWire>,
    received: VecDeque<UartByte>,
    lost: u64,
    noise: Option<LineNoise>,
    connected: bool,
    connected_since_ns: u64,
}

impl UartLoopback {
    /// A connected pair at `baud` bits per second (0 counts as 1), with a receiver that holds `capacity` bytes: 16 in
    /// the processor's own FIFO, more with a buffer behind it.
    #[must_use]
    pub fn new(baud: u32, capacity: usize) -> Self {
        Self {
            ns_per_byte: ns_per_byte(baud),
            capacity,
            now_ns: 0,
            under_way: VecDeque::new(),
            received: VecDeque::new(),
            lost: 0,
            noise: None,
            connected: true,
            connected_since_ns: 0,
        }
    }

    /// Sends bytes after those in transmission.
    pub fn write(&mut self, at_ns: u64, bytes: &[u8]) {
        self.advance(at_ns);
        let mut start_ns = self.under_way.back().map_or(self.now_ns, |last| last.end_ns);
        for &byte in bytes {
            let end_ns = start_ns + self.ns_per_byte;
            self.put(start_ns, end_ns, byte);
            start_ns = end_ns;
        }
    }

    /// Sends a byte with its own timing, whose stop bit ended at `at_ns`; it has arrived at that time.
    pub fn sent(&mut self, at_ns: u64, byte: u8) {
        let start_ns = at_ns.saturating_sub(self.ns_per_byte);
        let start_ns = self.under_way.back().map_or(start_ns, |last| start_ns.max(last.end_ns.min(at_ns)));
        self.put(start_ns, at_ns, byte);
    }

    /// Next byte that has arrived up to and at `at_ns`, for a receiver with its own buffer: none is lost here.
    pub fn take_arrived(&mut self, at_ns: u64) -> Option<UartByte> {
        self.now_ns = self.now_ns.max(at_ns);
        if let Some(byte) = self.received.pop_front() {
            return Some(byte);
        }
        loop {
            let next = self.under_way.pop_front_if(|next| next.end_ns <= self.now_ns)?;
            if let Some(byte) = next.byte.filter(|_| self.was_connected(&next)) {
                return Some(byte);
            }
        }
    }

    /// Adds noise to bytes sent from now on; `None` ends it.
    pub fn disturb(&mut self, noise: Option<LineNoise>) {
        self.noise = noise;
    }

    fn put(&mut self, start_ns: u64, end_ns: u64, value: u8) {
        let sent = UartByte::clean(end_ns, value);
        let byte = self.noise.as_mut().map_or(Some(sent), |noise| noise.pass(sent));
        self.under_way.push_back(OnWire { start_ns, end_ns, byte });
    }

    /// True if the wire was connected from start to stop bit.
    fn was_connected(&self, byte: &OnWire) -> bool {
        self.connected && byte.start_ns >= self.connected_since_ns
    }

    /// Reads bytes that arrived up to and at `at_ns`, oldest first, as many as `buffer` holds; the others stay.
    pub fn read(&mut self, at_ns: u64, buffer: &mut [u8]) -> Received {
        self.advance(at_ns);
        let len = buffer.len().min(self.received.len());
        for (slot, byte) in buffer.iter_mut().zip(self.received.drain(..len)) {
            *slot = byte.value;
        }
        Received { len, lost: std::mem::take(&mut self.lost) }
    }

    /// Arrival time of the next byte in transmission, ns, even if it will be lost.
    #[must_use]
    pub fn next_arrival_ns(&self) -> Option<u64> {
        self.under_way.front().map(|next| next.end_ns)
    }

    /// Connects or disconnects the wire: only bytes that were connected from start to stop bit arrive.
    pub fn set_connected(&mut self, at_ns: u64, connected: bool) {
        self.advance(at_ns);
        if connected && !self.connected {
            self.connected_since_ns = self.now_ns;
        }
        self.connected = connected;
    }

    fn advance(&mut self, to_ns: u64) {
        self.now_ns = self.now_ns.max(to_ns);
        while let Some(next) = self.under_way.pop_front_if(|next| next.end_ns <= self.now_ns) {
            // a driver drops bytes without a stop bit
            let Some(byte) = next.byte.filter(|byte| !byte.framing_error && self.was_connected(&next)) else {
                continue;
            };
            if self.received.len() < self.capacity {
                self.received.push_back(byte);
            } else {
                self.lost += 1;
            }
        }
    }
}

/// Size of the EEPROM, bytes.
const SIZE: usize = 256;
/// Size of a page, bytes.
const PAGE: usize = 8;
/// Lowest device address: 1010 A2 A1 A0.
const ADDRESS: u8 = 0x50;
/// Longest duration of a write, ns.
const WRITE_NS: u64 = 5_000_000;

/// Phase of an I2C transfer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Transfer {
    /// Not addressed, or addressed for reading.
    None,
    /// Addressed for writing; the next byte is a word address.
    WordAddress,
    /// Addressed for writing; data bytes follow.
    Data,
}

/// EEPROM 24C02: 256 bytes on I2C, in pages of 8. Write-protect is tied low.
///
/// A write starts at STOP and takes 5 ms, during which the chip acknowledges nothing: polling its address detects the
/// end. A write past the end of a page continues at its start. A read continues from the last word used, and past the
/// end of the memory at 0.
///
/// [`acknowledges`](I2cChip::acknowledges) has no time: the caller of a transfer first calls [`advance`](Self::advance)
/// with its start, or the chip stays busy.
///
/// # Source
/// Atmel AT24C02B data sheet (5126): device operation, write operations, read operations.
#[derive(Clone, Debug)]
pub struct Eeprom24c02 {
    address: u8,
    memory: [u8; SIZE],
    /// Address of the next word.
    pointer: u8,
    transfer: Transfer,
    /// Data of the present write for each byte of the page, the address of its start, and the number of bytes.
    page: [Option<u8>; PAGE],
    first_word: u8,
    taken: usize,
    busy_until_ns: u64,
    now_ns: u64,
    misuse: MisuseLog,
}

impl Eeprom24c02 {
    /// Name of the chip in reports.
    pub const NAME: &str = "24C02";

    /// A chip as delivered, all bytes 0xFF, at a 7-bit `address` from 0x50 to 0x57; only the three lower bits count.
    #[must_use]
    pub fn new(address: u8) -> Self {
        Self {
            address: ADDRESS | address & 0b111,
            memory: [0xFF; SIZE],
            pointer: 0,
            transfer: Transfer::None,
            page: [None; PAGE],
            first_word: 0,
            taken: 0,
            busy_until_ns: 0,
            now_ns: 0,
            misuse: MisuseLog::new(),
        }
    }

    /// Advances the chip to `to_ns`, and completes a write that ends by then.
    pub fn advance(&mut self, to_ns: u64) {
        self.now_ns = self.now_ns.max(to_ns);
    }

    /// True while a write is in progress, at the last [`advance`](Self::advance).
    #[must_use]
    pub const fn is_busy(&self) -> bool {
        self.now_ns < self.busy_until_ns
    }

    /// Content of the memory, including a write in progress.
    #[must_use]
    pub const fn memory(&self) -> &[u8; SIZE] {
        &self.memory
    }

    /// Violations of the data sheet so far.
    #[must_use]
    pub const fn misuse(&self) -> &MisuseLog {
        &self.misuse
    }

    /// Violations so far, mutable, so that a test can clear them.
    pub const fn misuse_mut(&mut self) -> &mut MisuseLog {
        &mut self.misuse
    }

    #[cold]
    fn report(&mut self, kind: MisuseKind) {
        self.misuse.report(Misuse { time_ns: self.now_ns, chip: Self::NAME, address: self.address, kind });
    }
}

impl I2cChip for Eeprom24c02 {
    fn acknowledges(&self, address: u8, _read: bool) -> bool {
        address == self.address && !self.is_busy()
    }

    fn start(&mut self, at_ns: u64, _address: u8, read: bool) {
        self.advance(at_ns);
        let bytes = std::mem::take(&mut self.taken);
        if bytes > 0 {
            self.page = [None; PAGE];
            self.report(MisuseKind::WriteWithoutStop { bytes });
        }
        self.transfer = if read { Transfer::None } else { Transfer::WordAddress };
    }

    fn write(&mut self, at_ns: u64, byte: u8) -> bool {
        self.advance(at_ns);
        match self.transfer {
            Transfer::None => return false,
            Transfer::WordAddress => {
                (self.pointer, self.first_word) = (byte, byte);
                self.transfer = Transfer::Data;
            }
            Transfer::Data => {
                let in_page = usize::from(self.pointer) % PAGE;
                self.page[in_page] = Some(byte);
                self.pointer = if in_page == PAGE - 1 { self.pointer - in_page as u8 } else { self.pointer + 1 };
                self.taken += 1;
                if self.taken == PAGE + 1 {
                    self.report(MisuseKind::PageOverrun { word: self.first_word, page_bytes: PAGE });
                }
            }
        }
        true
    }

    fn read(&mut self, at_ns: u64) -> u8 {
        self.advance(at_ns);
        let byte = self.memory[usize::from(self.pointer)];
        self.pointer = self.pointer.wrapping_add(1);
        byte
    }

    fn stop(&mut self, at_ns: u64) {
        self.advance(at_ns);
        self.transfer = Transfer::None;
        if std::mem::take(&mut self.taken) > 0 {
            self.busy_until_ns = self.now_ns + WRITE_NS;
            let first = usize::from(self.first_word) / PAGE * PAGE;
            for (byte, written) in self.memory[first..first + PAGE].iter_mut().zip(&mut self.page) {
                *byte = written.take().unwrap_or(*byte);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::i2c::{Done, Fault, I2cBus};
    use embedded_hal::i2c::Operation;
    use proptest::prelude::*;
    use std::{cell::RefCell, rc::Rc};

    fn read(uart: &mut UartLoopback, at_ns: u64) -> (Vec<u8>, u64) {
        let mut buffer = [0; 100];
        let Received { len, lost } = uart.read(at_ns, &mut buffer);
        (buffer[..len].to_vec(), lost)
    }

    #[test]
    fn bytes_come_back_after_their_time() {
        // 10 bits at 115200 bit/s: 86.805 us
        let mut uart = UartLoopback::new(115_200, 16);
        uart.write(1_000, b"ab");
        assert_eq!(uart.next_arrival_ns(), Some(87_805));
        assert_eq!(read(&mut uart, 87_804), (vec![], 0));
        assert_eq!(read(&mut uart, 87_805), (b"a".to_vec(), 0));
        // joins the byte in transmission
        uart.write(100_000, b"c");
        assert_eq!(read(&mut uart, 1_000 + 3 * 86_805 - 1), (b"b".to_vec(), 0));
        assert_eq!(read(&mut uart, 1_000 + 3 * 86_805), (b"c".to_vec(), 0));
        // and starts at once on an idle line
        uart.write(1_000_000, b"d");
        assert_eq!(uart.next_arrival_ns(), Some(1_086_805));
    }

    #[test]
    fn a_small_buffer_leaves_the_rest() {
        let mut uart = UartLoopback::new(1_000_000, 16);
        uart.write(0, b"abc");
        let mut two = [0; 2];
        assert_eq!(uart.read(30_000, &mut two), Received { len: 2, lost: 0 });
        assert_eq!(&two, b"ab");
        assert_eq!(read(&mut uart, 30_000), (b"c".to_vec(), 0));
    }

    #[test]
    fn a_full_receiver_loses_the_newest_and_says_so_once() {
        let mut uart = UartLoopback::new(1_000_000, 16);
        let bytes: Vec<u8> = (0..20).collect();
        uart.write(0, &bytes);
        assert_eq!(read(&mut uart, 180_000), (bytes[..16].to_vec(), 2));
        assert_eq!(read(&mut uart, 200_000), (vec![18, 19], 0));
        let mut none = UartLoopback::new(1_000_000, 0);
        none.write(0, b"a");
        assert_eq!(read(&mut none, 10_000), (vec![], 1));
    }

    #[test]
    fn only_whole_bytes_pass_a_wire_that_is_plugged() {
        let mut uart = UartLoopback::new(1_000_000, 16);
        uart.write(0, b"abcdefg");
        uart.set_connected(15_000, false);
        uart.set_connected(40_000, true);
        uart.set_connected(55_000, false);
        uart.set_connected(55_001, true);
        // connected already: no change
        uart.set_connected(65_000, true);
        assert_eq!(read(&mut uart, 100_000), (b"aeg".to_vec(), 0));
    }

    proptest! {
        /// Queries that take nothing do not change the result.
        #[test]
        fn uart_lazy_equals_eager(
            actions in prop::collection::vec((0..300_000_u64, 0..8_u8, prop::collection::vec(any::<u8>(), 0..30)), 1..20),
            baud in 9_600..2_000_000_u32,
        ) {
            let (mut lazy, mut eager) = (UartLoopback::new(baud, 16), UartLoopback::new(baud, 16));
            let mut at_ns = 0;
            for (after_ns, what, bytes) in actions {
                let mut lost = 0;
                for step in 0..5 {
                    lost += eager.read(at_ns + after_ns * step / 5, &mut []).lost;
                }
                eager.lost += lost;
                at_ns += after_ns;
                match what {
                    0..3 => [&mut lazy, &mut eager].into_iter().for_each(|uart| uart.set_connected(at_ns, what > 0)),
                    3..6 => [&mut lazy, &mut eager].into_iter().for_each(|uart| uart.write(at_ns, &bytes)),
                    _ => prop_assert_eq!(read(&mut lazy, at_ns), read(&mut eager, at_ns)),
                }
            }
            prop_assert_eq!(read(&mut lazy, u64::MAX), read(&mut eager, u64::MAX));
        }
    }

    /// An EEPROM at 0x50 on a bus of 400 kHz.
    struct Bench {
        bus: I2cBus,
        chip: Rc<RefCell<Eeprom24c02>>,
    }

    impl Bench {
        fn new() -> Self {
            let chip = Rc::new(RefCell::new(Eeprom24c02::new(0x50)));
            let mut bus = I2cBus::new(400_000);
            bus.attach(chip.clone());
            Self { bus, chip }
        }

        fn run(&mut self, at_ns: u64, operations: &mut [Operation<'_>]) -> Result<Done, Fault> {
            self.chip.borrow_mut().advance(at_ns);
            self.bus.execute(at_ns, 0x50, operations)
        }

        fn write(&mut self, at_ns: u64, bytes: &[u8]) -> Result<Done, Fault> {
            self.run(at_ns, &mut [Operation::Write(bytes)])
        }

        fn read<const N: usize>(&mut self, at_ns: u64, word: u8) -> [u8; N] {
            let mut bytes = [0; N];
            self.run(at_ns, &mut [Operation::Write(&[word]), Operation::Read(&mut bytes)]).expect("acknowledged");
            bytes
        }

        fn kinds(&self) -> Vec<MisuseKind> {
            self.chip.borrow().misuse().first().iter().map(|misuse| misuse.kind).collect()
        }
    }

    const S: u64 = 1_000_000_000;

    /// 8.68 us a byte at 1.152 Mbit/s; the wire was not connected for all of the second byte.
    #[test]
    fn bytes_of_a_sender_with_its_own_timing_come_back_when_they_end() {
        let mut uart = UartLoopback::new(1_152_000, 1);
        uart.sent(10_000, b'a');
        uart.sent(20_000, b'b');
        uart.sent(40_000, b'c');
        assert_eq!(uart.next_arrival_ns(), Some(10_000));
        assert_eq!(uart.take_arrived(9_999), None);
        uart.set_connected(12_000, false);
        uart.set_connected(13_000, true);
        assert_eq!(uart.take_arrived(50_000), Some(UartByte::clean(10_000, b'a')));
        assert_eq!(uart.take_arrived(50_000), Some(UartByte::clean(40_000, b'c')));
        uart.disturb(Some(LineNoise::new(1.0, 0.0, 1)));
        uart.sent(60_000, b'd');
        assert_eq!(uart.take_arrived(100_000), None, "no start bit");
    }

    #[test]
    fn a_page_is_written_and_read_back() {
        let mut bench = Bench::new();
        assert_eq!(bench.read(0, 0x10), [0xFF; 4]);
        bench.write(S, &[0x10, 1, 2, 3, 4, 5, 6, 7, 8]).expect("acknowledged");
        assert_eq!(bench.read(2 * S, 0x0F), [0xFF, 1, 2, 3, 4, 5, 6, 7, 8, 0xFF]);
        // part of a page leaves the other bytes
        bench.write(3 * S, &[0x12, 30, 31]).expect("acknowledged");
        assert_eq!(bench.read(4 * S, 0x10), [1, 2, 30, 31, 5]);
        assert_eq!(bench.kinds(), []);
    }

    #[test]
    fn busy_for_5_ms_after_stop() {
        let mut bench = Bench::new();
        let end_ns = bench.write(0, &[0, 1]).expect("acknowledged").end_ns;
        for (after_ns, read) in [(100_000, false), (4_999_999, true)] {
            let mut byte = [0];
            let operation = if read { Operation::Read(&mut byte) } else { Operation::Write(&[]) };
            let fault = bench.run(end_ns + after_ns, &mut [operation]).expect_err("busy");
            assert!(matches!(fault, Fault::AddressNack { address: 0x50, .. }), "{fault}");
            assert!(bench.chip.borrow().is_busy());
        }
        bench.write(end_ns + 5_000_000, &[]).expect("acknowledged");
        // polling is no misuse, and writes nothing
        assert_eq!(bench.kinds(), []);
        assert!(!bench.chip.borrow().is_busy());
    }

    #[test]
    fn a_long_write_goes_round_in_its_page() {
        let mut bench = Bench::new();
        bench.write(0, &[0x26, 1, 2, 3]).expect("acknowledged");
        assert_eq!(bench.read(S, 0x20), [3, 0xFF, 0xFF, 0xFF, 0xFF, 0xFF, 1, 2, 0xFF]);
        assert_eq!(bench.kinds(), []);
        bench.write(2 * S, &[0xF8, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10]).expect("acknowledged");
        assert_eq!(bench.read(3 * S, 0xF8), [9, 10, 3, 4, 5, 6, 7, 8]);
        assert_eq!(bench.kinds(), [MisuseKind::PageOverrun { word: 0xF8, page_bytes: 8 }]);
    }

    #[test]
    fn a_read_goes_on_where_the_last_ended_and_past_the_end_at_0() {
        let mut bench = Bench::new();
        bench.write(0, &[0xFF, 9]).expect("acknowledged");
        bench.write(S, &[0x00, 10, 11]).expect("acknowledged");
        assert_eq!(bench.read(2 * S, 0xFF), [9, 10]);
        let mut byte = [0];
        bench.run(3 * S, &mut [Operation::Read(&mut byte)]).expect("acknowledged");
        assert_eq!(byte, [11]);
    }

    #[test]
    fn data_without_stop_is_dropped() {
        let mut bench = Bench::new();
        let mut byte = [0];
        bench.run(0, &mut [Operation::Write(&[0x40, 1, 2]), Operation::Read(&mut byte)]).expect("acknowledged");
        assert_eq!(bench.kinds(), [MisuseKind::WriteWithoutStop { bytes: 2 }]);
        assert!(!bench.chip.borrow().is_busy());
        assert_eq!(bench.chip.borrow().memory(), &[0xFF; 256]);
        bench.write(S, &[0x42, 3]).expect("acknowledged");
        assert_eq!(bench.read(2 * S, 0x40), [0xFF, 0xFF, 3, 0xFF]);
    }

    #[test]
    fn answers_at_its_own_address_only() {
        let chip = Eeprom24c02::new(0x2B);
        assert!((0..0x80).all(|address| chip.acknowledges(address, false) == (address == 0x53)));
    }

    proptest! {
        /// Writes page by page, as the data sheet requires, store any data.
        #[test]
        fn keeps_what_is_written_by_the_rules(writes in prop::collection::vec((any::<u8>(), any::<[u8; 8]>()), 1..30)) {
            let mut bench = Bench::new();
            let mut expected = [0xFF; 256];
            let mut at_ns = 0;
            for (word, bytes) in writes {
                let room = 8 - usize::from(word) % 8;
                let mut message = vec![word];
                message.extend_from_slice(&bytes[..room]);
                at_ns = bench.write(at_ns, &message).expect("acknowledged").end_ns + 5_000_000;
                expected[usize::from(word)..][..room].copy_from_slice(&bytes[..room]);
            }
            prop_assert_eq!(bench.read::<256>(at_ns, 0), expected);
            prop_assert!(bench.chip.borrow().misuse().is_empty());
        }
    }
}
