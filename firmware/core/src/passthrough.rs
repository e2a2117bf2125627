//! Raw access for hosts: the external I2C connectors and the UART connectors.
//!
//! ```text
//!  link tasks ── request ──┬─ turn, job ──> run ──> I2C, UART transmitters
//!                          │<──── answer ────┘
//!                          └─ received <───── run <── UART receivers
//! ```

use core::cell::{Cell, RefCell};

use embassy_futures::{
    join::join3,
    select::{Either, select},
};
use embassy_sync::{
    blocking_mutex::{Mutex, raw::RawMutex},
    semaphore::{FairSemaphore, Semaphore},
    signal::Signal,
};
use embassy_time::{Duration, Instant, Timer, with_deadline, with_timeout};
use embedded_hal_async::i2c::{Error, ErrorKind, NoAcknowledgeSource};
use embedded_io_async::{Read, Write};
use heapless::{Deque, Vec};
use r4_protocol::{Refusal, Reply, Request, message::MAX_RAW};

use crate::platform::Bus;

/// Number of connectors of each kind.
pub const CONNECTORS: usize = 2;
/// Time limit of a request, waiting for other links' requests included.
pub const TIMEOUT: Duration = Duration::from_millis(100);
/// Time limit for freeing a bus: nine clocks at 10 kHz, the slowest, take 1 ms.
const RECOVERY: Duration = Duration::from_millis(5);
/// Pause before a failed receiver is polled again: one that fails permanently must not keep the processor busy.
const RECEIVER_PAUSE: Duration = Duration::from_millis(1);
/// Maximum number of received bytes of a UART connector that wait to be read: 22 ms at 115200 baud.
const RING: usize = 256;
/// Maximum number of requests waiting for their turn: more than a board has links.
const WAITING: usize = 8;

/// Hardware of the connectors.
pub struct PassthroughIo<I, R, W> {
    /// External I2C buses, by connector.
    pub i2c: [I; CONNECTORS],
    /// Receivers of the UART connectors.
    pub uart_rx: [R; CONNECTORS],
    /// Transmitters of the UART connectors.
    pub uart_tx: [W; CONNECTORS],
}

/// State shared by [`run`](Passthrough::run) and the links.
///
/// One request is served at a time, in the order of arrival. A request whose link dies is given up for the next one; it
/// may or may not have been carried out by then.
pub struct Passthrough<M: RawMutex> {
    turn: FairSemaphore<M, WAITING>,
    /// Identifier of the next job, so that the answer to an abandoned request is not taken for another's.
    next_id: Mutex<M, Cell<u32>>,
    job: Signal<M, Job>,
    answer: Signal<M, (u32, Result<Reply, Refusal>)>,
    received: [Mutex<M, RefCell<Received>>; CONNECTORS],
}

struct Job {
    id: u32,
    request: Request,
    deadline: Instant,
}

/// Received bytes of one UART connector. When it is full the oldest are dropped: a late reader needs the device's
/// latest output.
struct Received {
    bytes: Deque<u8, RING>,
    lost: u32,
}

impl Received {
    const fn new() -> Self {
        Self { bytes: Deque::new(), lost: 0 }
    }

    fn push(&mut self, byte: u8) {
        if self.bytes.is_full() {
            self.bytes.pop_front();
            self.lost = self.lost.wrapping_add(1);
        }
        // There is always room: the oldest byte has been removed.
        let _ = self.bytes.push_back(byte);
    }

    fn take(&mut self) -> Vec<u8, MAX_RAW> {
        let len = self.bytes.len().min(MAX_RAW);
        (0..len).filter_map(|_| self.bytes.pop_front()).collect()
    }
}

impl<M: RawMutex> Default for Passthrough<M> {
    fn default() -> Self {
        Self::new()
    }
}

impl<M: RawMutex> Passthrough<M> {
    /// Creates the state without requests or received bytes.
    #[must_use]
    pub const fn new() -> Self {
        Self {
            turn: FairSemaphore::new(1),
            next_id: Mutex::new(Cell::new(0)),
            job: Signal::new(),
            answer: Signal::new(),
            received: [const { Mutex::new(RefCell::new(Received::new())) }; CONNECTORS],
        }
    }

    /// Carries out a [`Request::I2cTransfer`], [`Request::UartWrite`] or [`Request::UartRead`], within [`TIMEOUT`].
    ///
    /// A UART write is done when the transmitter has taken the bytes. Reading never waits: the answer may be empty.
    ///
    /// # Errors
    /// [`Refusal::BadTransfer`] for an invalid connector, address or length, an empty transfer, or another request;
    /// [`Refusal::NoAcknowledge`] when no device answers to the address; [`Refusal::TransferFailed`] for all other
    /// failures: part of the bytes may then have been sent.
    pub async fn request(&self, request: &Request) -> Result<Reply, Refusal> {
        check(request)?;
        if let Request::UartRead { port } = request {
            let received = self.received.get(usize::from(*port)).ok_or(Refusal::BadTransfer)?;
            return Ok(Reply::Bytes(received.lock(|received| received.borrow_mut().take())));
        }
        let deadline = Instant::now() + TIMEOUT;
        let answered = with_deadline(deadline, async {
            let _turn = self.turn.acquire(1).await.map_err(|_| Refusal::TransferFailed)?;
            let id = self.next_id.lock(|next| next.replace(next.get().wrapping_add(1)));
            self.job.signal(Job { id, request: request.clone(), deadline });
            loop {
                match self.answer.wait().await {
                    (of, result) if of == id => return result,
                    _ => {}
                }
            }
        });
        answered.await.unwrap_or(Err(Refusal::TransferFailed))
    }

    /// Number of bytes of UART connector `port` that were dropped unread since power-up, wrapping.
    #[must_use]
    pub fn lost(&self, port: usize) -> u32 {
        self.received.get(port).map_or(0, |received| received.lock(|received| received.borrow().lost))
    }

    /// Serves requests, and receives continuously from both UART connectors.
    pub async fn run<I: Bus, R: Read, W: Write>(&self, io: PassthroughIo<I, R, W>) -> ! {
        let PassthroughIo { i2c, uart_rx: [rx0, rx1], uart_tx } = io;
        let [received0, received1] = &self.received;
        join3(receive(rx0, received0), receive(rx1, received1), self.serve(i2c, uart_tx)).await.0
    }

    async fn serve<I: Bus, W: Write>(&self, mut i2c: [I; CONNECTORS], mut uart_tx: [W; CONNECTORS]) -> ! {
        let mut next = None;
        loop {
            let job = match next.take() {
                Some(job) => job,
                None => self.job.wait().await,
            };
            if Instant::now() >= job.deadline {
                continue;
            }
            let carry_out = with_deadline(job.deadline, carry_out(&job.request, &mut i2c, &mut uart_tx));
            let result = match select(carry_out, self.job.wait()).await {
                Either::First(in_time) => in_time.unwrap_or(Err(Refusal::TransferFailed)),
                // A newer job has its turn only if the caller of this one is gone.
                Either::Second(newer) => {
                    next = Some(newer);
                    Err(Refusal::TransferFailed)
                }
            };
            let failed = result == Err(Refusal::TransferFailed);
            self.answer.signal((job.id, result));
            if let (Request::I2cTransfer { bus, .. }, true) = (&job.request, failed)
                && let Some(bus) = i2c.get_mut(usize::from(*bus))
            {
                // A bus that cannot be freed fails the next transfer too.
                let _ = with_timeout(RECOVERY, bus.recover()).await;
            }
        }
    }
}

fn check(request: &Request) -> Result<(), Refusal> {
    let connector = |number: u8| usize::from(number) < CONNECTORS;
    let possible = match request {
        Request::I2cTransfer { bus, address, write, read } => {
            let something = !write.is_empty() || *read > 0;
            connector(*bus) && (0x08..=0x77).contains(address) && usize::from(*read) <= MAX_RAW && something
        }
        Request::UartWrite { port, bytes } => connector(*port) && !bytes.is_empty(),
        Request::UartRead { port } => connector(*port),
        _ => false,
    };
    if possible { Ok(()) } else { Err(Refusal::BadTransfer) }
}

async fn carry_out<I: Bus, W: Write>(
    request: &Request,
    i2c: &mut [I; CONNECTORS],
    uart_tx: &mut [W; CONNECTORS],
) -> Result<Reply, Refusal> {
    match request {
        Request::I2cTransfer { bus, address, write, read } => {
            let bus = i2c.get_mut(usize::from(*bus)).ok_or(Refusal::BadTransfer)?;
            let mut bytes = Vec::new();
            bytes.resize_default(usize::from(*read)).map_err(|_| Refusal::BadTransfer)?;
            let done = match (write.as_slice(), bytes.as_mut_slice()) {
                (write, []) => bus.write(*address, write).await,
                ([], read) => bus.read(*address, read).await,
                (write, read) => bus.write_read(*address, write, read).await,
            };
            done.map(|()| Reply::Bytes(bytes)).map_err(|error| match error.kind() {
                ErrorKind::NoAcknowledge(NoAcknowledgeSource::Address | NoAcknowledgeSource::Unknown) => {
                    Refusal::NoAcknowledge { address: *address }
                }
                _ => Refusal::TransferFailed,
            })
        }
        Request::UartWrite { port, bytes } => {
            let tx = uart_tx.get_mut(usize::from(*port)).ok_or(Refusal::BadTransfer)?;
            tx.write_all(bytes).await.map(|()| Reply::Done).map_err(|_| Refusal::TransferFailed)
        }
        _ => Err(Refusal::BadTransfer),
    }
}

async fn receive<M: RawMutex, R: Read>(mut rx: R, received: &Mutex<M, RefCell<Received>>) -> ! {
    let mut buffer = [0; 64];
    loop {
        match rx.read(&mut buffer).await {
            Ok(len @ 1..) => received.lock(|received| {
                let mut received = received.borrow_mut();
                buffer.iter().take(len).for_each(|byte| received.push(*byte));
            }),
            // Overrun, framing error or break: the next bytes may be good again.
            _ => Timer::after(RECEIVER_PAUSE).await,
        }
    }
}
