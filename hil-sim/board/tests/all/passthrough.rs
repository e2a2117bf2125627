//! Raw access to the external connectors on virtual time: test doubles of I2C buses, simulated UARTs.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on should stop where it stands")]

use std::{
    cell::RefCell,
    convert::Infallible,
    future::{pending, poll_fn},
    pin::pin,
    rc::Rc,
    task::Poll,
};

use embassy_sync::blocking_mutex::raw::NoopRawMutex;
use embedded_hal::i2c::{Error, ErrorKind, ErrorType, NoAcknowledgeSource, Operation};
use embedded_hal_async::i2c::I2c;
use embedded_io_async::{Read, Write};
use r4_firmware::{
    passthrough::{Passthrough, PassthroughIo},
    platform::Bus,
};
use r4_protocol::{Refusal, Reply, Request};
use r4_sim::{
    Clock, Simulation,
    link::{Port, serial},
};

const US: u64 = 1_000;
const MS: u64 = 1_000_000;
/// Longest duration of a request, ns.
const TIMEOUT_NS: u64 = 100 * MS;
/// Duration of one byte at 100 kHz, ns: nine clocks.
const I2C_BYTE_NS: u64 = 90 * US;
const BAUD: u32 = 115_200;

/// Addresses that answer a read with their address, counting up, after any write.
const ECHOES: [u8; 2] = [0x08, 0x77];
/// Address of a device that holds the clock indefinitely.
const HANGS: u8 = 0x51;
/// Address of a device that acknowledges its address, but no data.
const REFUSES_DATA: u8 = 0x52;
/// Address at which the controller finds the line held low.
const SHORTED: u8 = 0x53;

#[derive(Default)]
struct BusLog {
    /// Address, bytes written, and number of bytes read of each completed transfer.
    transfers: Vec<(u8, Vec<u8>, usize)>,
    recovered: usize,
    /// True while the bus is held, until it is recovered.
    held: bool,
}

struct TestBus {
    clock: Clock,
    log: Rc<RefCell<BusLog>>,
}

#[derive(Debug)]
struct BusError(ErrorKind);

impl Error for BusError {
    fn kind(&self) -> ErrorKind {
        self.0
    }
}

impl ErrorType for TestBus {
    type Error = BusError;
}

impl I2c for TestBus {
    async fn transaction(&mut self, address: u8, operations: &mut [Operation<'_>]) -> Result<(), BusError> {
        if self.log.borrow().held {
            return Err(BusError(ErrorKind::Bus));
        }
        let (mut written, mut bytes_read) = (Vec::new(), 0);
        for operation in operations.iter_mut() {
            match operation {
                Operation::Write(bytes) => written.extend_from_slice(bytes),
                Operation::Read(bytes) => {
                    bytes_read += bytes.len();
                    bytes.iter_mut().zip(0..).for_each(|(byte, number)| *byte = address.wrapping_add(number));
                }
            }
        }
        // a transfer without a clock is invalid; controllers refuse it or hang
        assert!(operations.iter().all(|operation| match operation {
            Operation::Write(bytes) => !bytes.is_empty(),
            Operation::Read(bytes) => !bytes.is_empty(),
        }));
        let acknowledge = |source| Err(BusError(ErrorKind::NoAcknowledge(source)));
        match address {
            HANGS => {
                self.log.borrow_mut().held = true;
                pending().await
            }
            SHORTED => Err(BusError(ErrorKind::Bus)),
            REFUSES_DATA => acknowledge(NoAcknowledgeSource::Data),
            _ if ECHOES.contains(&address) => {
                self.clock.sleep((written.len() + bytes_read + operations.len()) as u64 * I2C_BYTE_NS).await;
                self.log.borrow_mut().transfers.push((address, written, bytes_read));
                Ok(())
            }
            _ => acknowledge(NoAcknowledgeSource::Unknown),
        }
    }
}

impl Bus for TestBus {
    async fn recover(&mut self) {
        self.clock.sleep(100 * US).await;
        let mut log = self.log.borrow_mut();
        log.recovered += 1;
        log.held = false;
    }
}

/// A receiver behind a UART that may fail at first.
struct Receiver {
    port: r4_sim::link::Receiver,
    clock: Clock,
    /// Time until which it reports framing errors, ns.
    failing_until_ns: u64,
}

#[derive(Debug)]
struct Framing;

impl core::fmt::Display for Framing {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("framing")
    }
}

impl core::error::Error for Framing {}

impl embedded_io_async::Error for Framing {
    fn kind(&self) -> embedded_io_async::ErrorKind {
        embedded_io_async::ErrorKind::InvalidData
    }
}

impl embedded_io_async::ErrorType for Receiver {
    type Error = Framing;
}

impl Read for Receiver {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Framing> {
        if self.clock.now_ns() < self.failing_until_ns {
            return Err(Framing);
        }
        Ok(self.port.read(buffer).await.unwrap())
    }
}

/// A transmitter that flow control may hold.
struct Transmitter {
    port: r4_sim::link::Sender,
    held: Rc<RefCell<bool>>,
}

impl embedded_io_async::ErrorType for Transmitter {
    type Error = Infallible;
}

impl Write for Transmitter {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        if *self.held.borrow() {
            pending::<()>().await;
        }
        self.port.write(bytes).await
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        self.port.flush().await
    }
}

/// The other ends of the board's side, which runs as a task.
struct Rig {
    simulation: Simulation,
    clock: Clock,
    passthrough: Rc<Passthrough<NoopRawMutex>>,
    buses: [Rc<RefCell<BusLog>>; 2],
    devices: [Port; 2],
    transmitter_held: Rc<RefCell<bool>>,
    io: Option<PassthroughIo<TestBus, Receiver, Transmitter>>,
}

impl Rig {
    fn new() -> Self {
        let mut rig = Self::idle(0);
        rig.serve();
        rig
    }

    /// A rig that does not serve yet. The receiver of connector 1 fails until `failing_until_ns`.
    fn idle(failing_until_ns: u64) -> Self {
        let simulation = Simulation::default();
        let clock = simulation.clock();
        let buses = [(); 2].map(|()| Rc::new(RefCell::new(BusLog::default())));
        let [(board0, device0), (board1, device1)] = [(); 2].map(|()| serial(&clock, BAUD));
        let transmitter_held = Rc::new(RefCell::new(false));
        let receiver = |port, failing_until_ns| Receiver { port, clock: clock.clone(), failing_until_ns };
        let transmitter = |port, held| Transmitter { port, held };
        let io = PassthroughIo {
            i2c: buses.clone().map(|log| TestBus { clock: clock.clone(), log }),
            uart_rx: [receiver(board0.rx, 0), receiver(board1.rx, failing_until_ns)],
            uart_tx: [transmitter(board0.tx, transmitter_held.clone()), transmitter(board1.tx, Rc::default())],
        };
        let (passthrough, io) = (Rc::new(Passthrough::new()), Some(io));
        Self { simulation, clock, passthrough, buses, devices: [device0, device1], transmitter_held, io }
    }

    fn serve(&mut self) {
        let (passthrough, io) = (self.passthrough.clone(), self.io.take().unwrap());
        self.simulation.spawn(async move {
            passthrough.run(io).await;
        });
    }

    fn request(&mut self, request: &Request) -> Result<Reply, Refusal> {
        self.simulation.block_on(self.passthrough.request(request)).unwrap()
    }

    /// Result of a request, and its duration, ns.
    fn timed(&mut self, request: &Request) -> (Result<Reply, Refusal>, u64) {
        let begin_ns = self.clock.now_ns();
        let result = self.request(request);
        (result, self.clock.now_ns() - begin_ns)
    }

    fn sleep(&mut self, ns: u64) {
        self.simulation.block_on(self.clock.sleep(ns)).unwrap();
    }

    /// Sends from the device at connector `port`, and waits until all bytes have arrived.
    fn receive(&mut self, port: usize, bytes: &[u8]) {
        self.simulation.block_on(self.devices[port].tx.write_all(bytes)).unwrap().unwrap();
        // ten bits each, and one more for a truncated one
        self.sleep((bytes.len() as u64 + 1) * 10_000_000_000 / u64::from(BAUD));
    }

    fn read(&mut self, port: u8) -> Vec<u8> {
        match self.request(&Request::UartRead { port }) {
            Ok(Reply::Bytes(bytes)) => bytes.to_vec(),
            other => panic!("{other:?}"),
        }
    }
}

fn transfer(bus: u8, address: u8, write: &[u8], read: u8) -> Request {
    Request::I2cTransfer { bus, address, write: write.iter().copied().collect(), read }
}

fn uart_write(port: u8, bytes: &[u8]) -> Request {
    Request::UartWrite { port, bytes: bytes.iter().copied().collect() }
}

fn counted(from: u8, len: u8) -> Result<Reply, Refusal> {
    Ok(Reply::Bytes((0..len).map(|number| from + number).collect()))
}

/// Drops `request` when `dies` is ready, if it is not done before.
async fn give_up(dies: impl Future<Output = ()>, request: impl Future) {
    let (mut dies, mut request) = (pin!(dies), pin!(request));
    poll_fn(|context| match (dies.as_mut().poll(context), request.as_mut().poll(context)) {
        (Poll::Pending, Poll::Pending) => Poll::Pending,
        _ => Poll::Ready(()),
    })
    .await;
}

#[test]
fn i2c_transfers_write_and_read_what_was_asked_on_the_bus_that_was_asked() {
    let mut rig = Rig::new();
    assert_eq!(rig.request(&transfer(0, 0x08, &[1, 2, 3], 0)), counted(0x08, 0));
    assert_eq!(rig.request(&transfer(1, 0x77, &[], 64)), counted(0x77, 64));
    assert_eq!(rig.request(&transfer(1, 0x08, &[9; 64], 2)), counted(0x08, 2));
    assert_eq!(rig.buses[0].borrow().transfers, [(0x08, vec![1, 2, 3], 0)]);
    assert_eq!(rig.buses[1].borrow().transfers, [(0x77, vec![], 64), (0x08, vec![9; 64], 2)]);
    // nine clocks for each byte and each address
    assert_eq!(rig.clock.now_ns(), (4 + 65 + 65 + 3) * I2C_BYTE_NS);
    assert!(rig.buses.iter().all(|bus| bus.borrow().recovered == 0));
}

#[test]
fn what_cannot_be_is_refused_at_once_and_reaches_no_connector() {
    let mut rig = Rig::new();
    let bad = [
        transfer(2, 0x08, &[1], 1),
        transfer(u8::MAX, 0x08, &[1], 1),
        transfer(0, 0x07, &[1], 1),
        transfer(0, 0x78, &[1], 1),
        transfer(0, 0x00, &[6], 0),
        transfer(0, 0x08, &[], 0),
        transfer(0, 0x08, &[1], 65),
        transfer(0, 0x08, &[], u8::MAX),
        uart_write(2, b"x"),
        uart_write(0, b""),
        Request::UartRead { port: 2 },
        Request::Stats,
    ];
    for request in bad {
        assert_eq!(rig.timed(&request), (Err(Refusal::BadTransfer), 0), "{request:?}");
    }
    assert!(rig.buses.iter().all(|bus| bus.borrow().transfers.is_empty() && bus.borrow().recovered == 0));
}

#[test]
fn faults_of_the_bus_are_told_apart() {
    let mut rig = Rig::new();
    assert_eq!(rig.request(&transfer(0, 0x30, &[1], 1)), Err(Refusal::NoAcknowledge { address: 0x30 }));
    assert_eq!(rig.buses[0].borrow().recovered, 0, "nobody there is no fault of the bus");
    assert_eq!(rig.request(&transfer(0, REFUSES_DATA, &[1], 0)), Err(Refusal::TransferFailed));
    assert_eq!(rig.request(&transfer(0, SHORTED, &[1], 0)), Err(Refusal::TransferFailed));
    assert_eq!(rig.request(&transfer(0, 0x08, &[1], 1)), counted(0x08, 1));
    assert_eq!(rig.buses[0].borrow().recovered, 2);
}

#[test]
fn a_hanging_transfer_ends_in_time_and_stops_neither_reception_nor_the_other_bus() {
    let mut rig = Rig::new();
    let text: Vec<u8> = (0..60).collect();
    rig.simulation.block_on(rig.devices[1].tx.write_all(&text)).unwrap().unwrap();
    let passthrough = rig.passthrough.clone();
    let (hanging, clock) = (transfer(0, HANGS, &[1], 1), rig.clock.clone());
    // 60 bytes have arrived after 5.2 ms, while the transfer hangs
    let seen = Rc::new(RefCell::new(Vec::new()));
    let (reader, log) = (rig.passthrough.clone(), seen.clone());
    rig.simulation.spawn(async move {
        clock.sleep(6 * MS).await;
        let answer = reader.request(&Request::UartRead { port: 1 }).await;
        log.borrow_mut().push(answer);
    });
    let begin_ns = rig.clock.now_ns();
    let result = rig.simulation.block_on(passthrough.request(&hanging)).unwrap();
    assert_eq!((result, rig.clock.now_ns() - begin_ns), (Err(Refusal::TransferFailed), TIMEOUT_NS));
    assert_eq!(*seen.borrow(), [Ok(Reply::Bytes(text.iter().copied().collect()))]);
    // recovered after its time-out: 100 us, in which the other bus waits too
    let (result, ns) = rig.timed(&transfer(1, 0x08, &[1], 1));
    assert_eq!((result, ns), (counted(0x08, 1), 100 * US + 4 * I2C_BYTE_NS));
    assert_eq!(rig.request(&transfer(0, 0x77, &[1], 1)), counted(0x77, 1));
    assert_eq!(rig.buses[0].borrow().recovered, 1);
}

#[test]
fn links_take_turns_and_get_their_own_answers() {
    let mut rig = Rig::new();
    let answers = Rc::new(RefCell::new(Vec::new()));
    const LINKS: u8 = 6;
    const REQUESTS: u8 = 10;
    for link in 0..LINKS {
        let (passthrough, answers) = (rig.passthrough.clone(), answers.clone());
        rig.simulation.spawn(async move {
            for number in 0..REQUESTS {
                let request = transfer(link % 2, ECHOES[usize::from(link / 2) % 2], &[link], 1 + link + number);
                let answer = passthrough.request(&request).await;
                answers.borrow_mut().push((link, number, answer));
            }
        });
    }
    rig.sleep(1_000 * MS);
    let answers = answers.borrow();
    assert_eq!(answers.len(), usize::from(LINKS * REQUESTS));
    for (link, number, answer) in answers.iter() {
        assert_eq!(*answer, counted(ECHOES[usize::from(link / 2) % 2], 1 + link + number), "link {link}");
    }
    // in the order of the requests: no link is ahead of another by more than one
    let rounds: Vec<_> = answers.iter().map(|(_, number, _)| *number).collect();
    assert!(rounds.is_sorted(), "{rounds:?}");
}

#[test]
fn waiting_for_a_turn_counts() {
    let mut rig = Rig::new();
    let waited = Rc::new(RefCell::new(Vec::new()));
    for address in [HANGS, 0x08] {
        let (passthrough, clock, waited) = (rig.passthrough.clone(), rig.clock.clone(), waited.clone());
        rig.simulation.spawn(async move {
            let answer = passthrough.request(&transfer(0, address, &[1], 1)).await;
            waited.borrow_mut().push((clock.now_ns(), answer));
        });
    }
    rig.sleep(1_000 * MS);
    assert_eq!(
        *waited.borrow(),
        [(TIMEOUT_NS, Err(Refusal::TransferFailed)), (TIMEOUT_NS, Err(Refusal::TransferFailed))]
    );
    assert!(rig.buses[0].borrow().transfers.is_empty(), "what was refused is not carried out later");
    assert_eq!(rig.request(&transfer(0, 0x08, &[1], 1)), counted(0x08, 1));
}

/// A link ends at any time of its request, including the ends of bytes and transfers.
#[test]
fn a_request_that_is_given_up_leaves_the_next_its_own_answer() {
    // nine clocks for each of four bytes, and any clean-up afterwards
    for given_up_ns in (0..5 * I2C_BYTE_NS).step_by(10_000) {
        for abandoned in [transfer(0, 0x08, &[1], 1), transfer(0, HANGS, &[1], 1), uart_write(0, &[1; 64])] {
            let mut rig = Rig::new();
            *rig.transmitter_held.borrow_mut() = true;
            let (passthrough, clock) = (rig.passthrough.clone(), rig.clock.clone());
            let (answer, ns) = rig
                .simulation
                .block_on(async {
                    let dies = clock.sleep(given_up_ns);
                    give_up(dies, passthrough.request(&abandoned)).await;
                    let begin_ns = clock.now_ns();
                    let answer = passthrough.request(&transfer(0, 0x77, &[2], 3)).await;
                    (answer, clock.now_ns() - begin_ns)
                })
                .unwrap();
            assert_eq!(answer, counted(0x77, 3), "{abandoned:?} given up after {given_up_ns} ns");
            // not after the other's time-out: at once, or after the recovery of the bus
            assert!(ns <= 100 * US + 6 * I2C_BYTE_NS, "{ns} ns");
        }
    }
}

#[test]
fn a_link_that_dies_in_the_queue_gives_its_place_up() {
    let mut rig = Rig::new();
    let (passthrough, clock) = (rig.passthrough.clone(), rig.clock.clone());
    let busy = rig.passthrough.clone();
    rig.simulation.spawn(async move {
        for _ in 0..1000 {
            let _ = busy.request(&transfer(0, 0x08, &[1; 64], 64)).await;
        }
    });
    rig.simulation
        .block_on(async {
            // more than the queue could hold, if they were still waiting
            for _ in 0..50 {
                give_up(clock.sleep(MS), passthrough.request(&transfer(0, 0x77, &[1], 1))).await;
            }
            assert_eq!(passthrough.request(&transfer(0, 0x77, &[1], 1)).await, counted(0x77, 1));
        })
        .unwrap();
}

#[test]
fn uart_bytes_come_and_go_on_their_own_connector() {
    let mut rig = Rig::new();
    assert_eq!(rig.read(0), b"");
    rig.receive(0, b"left");
    rig.receive(1, b"right");
    assert_eq!((rig.read(1), rig.read(0), rig.read(0)), (b"right".to_vec(), b"left".to_vec(), b"".to_vec()));
    for (port, text) in [(0, b"to the left"), (1, b"to the east")] {
        assert_eq!(rig.request(&uart_write(port, text)), Ok(Reply::Done));
        // 11 bytes take 0.95 ms
        rig.sleep(2 * MS);
        let mut buffer = [0; 64];
        let rx = &mut rig.devices[usize::from(port)].rx;
        let len = rig.simulation.block_on(rx.read(&mut buffer)).unwrap().unwrap();
        assert_eq!(&buffer[..len], text);
    }
}

#[test]
fn a_full_ring_keeps_the_newest_bytes_and_counts_the_others() {
    let mut rig = Rig::new();
    let sent: Vec<u8> = (0..300u16).map(|number| (number % 251) as u8).collect();
    rig.receive(0, &sent);
    assert_eq!((rig.passthrough.lost(0), rig.passthrough.lost(1), rig.passthrough.lost(2)), (300 - 256, 0, 0));
    let mut read = Vec::new();
    for len in [64, 64, 64, 64, 0] {
        let bytes = rig.read(0);
        assert_eq!(bytes.len(), len);
        read.extend(bytes);
    }
    assert_eq!(read, sent[300 - 256..]);
    rig.receive(0, b"more");
    assert_eq!((rig.read(0), rig.passthrough.lost(0)), (b"more".to_vec(), 44));
}

#[test]
fn a_transmitter_that_takes_nothing_fails_in_time() {
    let mut rig = Rig::new();
    *rig.transmitter_held.borrow_mut() = true;
    assert_eq!(rig.timed(&uart_write(0, b"x")), (Err(Refusal::TransferFailed), TIMEOUT_NS));
    assert_eq!(rig.request(&uart_write(1, b"x")), Ok(Reply::Done));
    *rig.transmitter_held.borrow_mut() = false;
    assert_eq!(rig.request(&uart_write(0, b"x")), Ok(Reply::Done));
}

#[test]
fn a_receiver_that_fails_is_asked_again_and_holds_nothing_up() {
    let mut rig = Rig::idle(50 * MS);
    rig.serve();
    rig.receive(0, b"left");
    rig.receive(1, b"right");
    assert_eq!((rig.read(0), rig.read(1)), (b"left".to_vec(), b"".to_vec()));
    assert_eq!(rig.request(&transfer(0, 0x08, &[1], 1)), counted(0x08, 1));
    rig.sleep(60 * MS);
    assert_eq!(rig.read(1), b"right");
}

#[test]
fn what_nobody_served_in_time_is_not_carried_out_later() {
    let mut rig = Rig::idle(0);
    assert_eq!(rig.timed(&uart_write(0, b"x")), (Err(Refusal::TransferFailed), TIMEOUT_NS));
    rig.serve();
    rig.sleep(10 * MS);
    let mut buffer = [0; 1];
    assert_eq!(rig.simulation.block_on(rig.devices[0].rx.read(&mut buffer)), None, "nothing ever arrives");
    assert_eq!(rig.request(&transfer(0, 0x08, &[1], 1)), counted(0x08, 1));
}
