//! Command `r4 sim serve`: runs a virtual board in real time, for programs that connect to it as to a real one.

pub(super) mod clients;
mod terminal;

use std::{
    cell::{Cell, RefCell},
    collections::VecDeque,
    future::{Future, poll_fn},
    io,
    net::{SocketAddr, TcpListener},
    path::PathBuf,
    pin::pin,
    rc::Rc,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
        mpsc,
    },
    task::Poll,
    thread::{self, JoinHandle},
    time::{Duration, Instant},
};

use anyhow::{Context, anyhow, bail};
use async_io::{Async, Timer};
use clients::Clients;
use embedded_io_async::{Read, Write};
use futures::future::{Either, select};
use r4_links::{Address, Descriptor, Key, Listener, Receiver, Transmitter, bus::End, monotonic_ns, slcan};
use r4_protocol::{FrameDecoder, Refusal, Reply, ToHost, can::Node, frame::MAX_FRAME};
use r4_rig::view::{SharedLook, WorldLook};
use r4_sim::ResetCause;
use r4_sim::{Pace, Simulation, VirtualBoard, link::Port};
use serde::Serialize;
use terminal::Terminal;

use crate::{
    args::{Args, Serve},
    output,
    session::{self, Target},
};

/// Baud rate of a simulated board's link without a delay for its bytes: the served link is USB and no UART.
const NO_TIME: u32 = u32::MAX;
/// Delay behind real time that the simulation makes up by running faster. Longer delays are skipped: a busy machine must
/// not make the board believe that its host was silent.
const HURRY: Duration = Duration::from_millis(20);
/// Period of the check for Ctrl-C.
const LOOK_EVERY: Duration = Duration::from_millis(50);
/// Capacity for bytes that no client has read yet; further ones are dropped.
const OUTBOX: usize = 16 * 1024;

/// Address of a served board, in JSON.
#[derive(Serialize)]
#[serde(rename_all = "snake_case")]
enum Where {
    Pty(PathBuf),
    Tcp(String),
    Slcan(PathBuf),
    #[cfg(target_os = "linux")]
    Can(String),
}

/// First line of the output, in JSON.
#[derive(Serialize)]
struct FirstLine {
    #[serde(flatten)]
    place: Where,
    /// Reading of CLOCK_MONOTONIC at virtual time 0, when a simulated board's clock starts, ns. With it a client on this
    /// machine can check its estimate of that clock.
    epoch_ns: u64,
}

/// Later line of the output: from the virtual time `from_ns` on, the epoch is `epoch_ns`, because real time was skipped.
#[derive(Serialize)]
struct Shifted {
    epoch_ns: u64,
    from_ns: u64,
}

/// Connection of a served board.
enum Place {
    /// Port with at most one client.
    Port(Option<Terminal>, Receiver, Transmitter),
    /// Listener for clients that connect and disconnect.
    Listener(Listener),
}

pub(crate) fn run(args: &Args, serve: &Serve) -> anyhow::Result<bool> {
    let args = virtual_board(args, &serve.robot)?;
    session::catch_interrupts();
    let (place, address) = place(&args, serve)?;
    let told = |origin| output::json(&FirstLine { place: address, epoch_ns: monotonic_ns(origin) });
    power_up(&args, place, Until { ends: &session::is_interrupted, reports_shifts: true, look: None }, told)
        .map(|()| true)
}

/// Returns the arguments for a served virtual board.
///
/// # Errors
/// An error for `--pace`, which a served board does not have.
fn virtual_board(args: &Args, board: &Target) -> anyhow::Result<Args> {
    if args.pace.is_some() {
        bail!("a served board runs in real time, as its clients do: leave --pace out");
    }
    Ok(Args { board: board.clone(), ..args.clone() })
}

/// End of serving a virtual board, and reports while it lasts.
#[derive(Clone, Copy)]
struct Until<'s> {
    /// Returns true when serving is to end; called every [`LOOK_EVERY`].
    ends: &'s dyn Fn() -> bool,
    /// True prints each [`Shifted`] as a line on stdout.
    reports_shifts: bool,
    /// Where other threads look at the board's world; `None` where none does.
    look: Option<&'s SharedLook>,
}

/// Powers a virtual board up and serves it. `ready` is called once, before the first client, with the real time at virtual
/// time 0.
fn power_up(
    args: &Args,
    place: Place,
    until: Until<'_>,
    ready: impl FnOnce(Instant) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let mut simulation = Simulation::new(Pace::Free);
    let (board, file) = session::rig(args, Pace::Free)?.power_up(&mut simulation)?;
    if matches!(args.board, Target::Sim(_)) {
        board.set_link_baud(NO_TIME);
    }
    let served = Served::new(&mut simulation, board.clone(), until)?;
    ready(served.origin)?;
    let served = r4_links::block_on(served.run(place));
    // Written after an error, too: the board's writes until then would be lost otherwise.
    let written = file.map_or(Ok(()), |file| file.write(&board.flash()));
    // The board's own error comes first: it is the cause, where both fail.
    served.and(written.map_err(Into::into))
}

/// Virtual board that a thread of this program serves, for this program alone.
pub(super) struct Background {
    pub(super) address: Address,
    pub(super) key: Key,
    /// World around the board.
    pub(super) look: SharedLook,
    ends: Arc<AtomicBool>,
    thread: JoinHandle<anyhow::Result<()>>,
}

impl Background {
    /// Powers the board up on a thread of its own, and returns when clients can connect to it.
    ///
    /// # Errors
    /// The error of the start: an unknown robot, a wrong plant or flash file, `--pace`.
    pub(super) fn start(args: &Args) -> anyhow::Result<Self> {
        let args = virtual_board(args, &args.board)?;
        // The random key keeps other programs of this machine away from the board.
        let key = Key::random().context("cannot make a key")?;
        let socket = Async::<TcpListener>::bind(([127, 0, 0, 1], 0)).context("cannot listen on this machine")?;
        let at = socket.get_ref().local_addr().context("cannot listen on this machine")?;
        let address = Address::Tcp { host: at.ip().to_string(), port: at.port() };
        let (ends, look) = (Arc::<AtomicBool>::default(), SharedLook::default());
        let (is_ready, ready) = mpsc::channel();
        let thread = thread::Builder::new().name(args.board.to_string()).spawn({
            let (key, ends, look) = (key.clone(), ends.clone(), look.clone());
            move || {
                let told = |_| is_ready.send(()).context("no task waits for the board");
                let place = Place::Listener(Listener::new(socket, Some(key)));
                let until = Until { ends: &|| ends.load(Ordering::Relaxed), reports_shifts: false, look: Some(&look) };
                match power_up(&args, place, until, told) {
                    // `end` stops the board as Ctrl-C would, which is no error here.
                    Err(error) if error.is::<session::Interrupted>() => Ok(()),
                    ended => ended,
                }
            }
        });
        let started = Self { address, key, look, ends, thread: thread.context("cannot start a thread")? };
        match ready.recv() {
            Ok(()) => Ok(started),
            // The thread has ended without a signal; its result says why.
            Err(_) => Err(started.end().err().unwrap_or_else(|| anyhow!("the board did not start"))),
        }
    }

    /// Switches the board off, which writes its flash.
    ///
    /// # Errors
    /// The error with which serving ended.
    pub(super) fn end(self) -> anyhow::Result<()> {
        self.ends.store(true, Ordering::Relaxed);
        self.thread.join().unwrap_or_else(|_| Err(anyhow!("the simulated board failed")))
    }
}

/// Opens the connection on which the board is served, and returns it with its address.
fn place(args: &Args, serve: &Serve) -> anyhow::Result<(Place, Where)> {
    let end = || {
        let node = Node::new(serve.node).ok_or_else(|| anyhow!("a node's number is at most {}", Node::COUNT - 1));
        node.map(End::Board)
    };
    if let Some(name) = &serve.pty {
        let terminal = Terminal::open(name.as_deref())?;
        let ((rx, tx), path) = (bytes(terminal.descriptor()), terminal.path().to_owned());
        return Ok((Place::Port(Some(terminal), rx, tx), Where::Pty(path)));
    }
    if let Some(name) = &serve.slcan {
        let terminal = Terminal::open(name.as_deref())?;
        let ((rx, tx), path) = (slcan::ends(terminal.descriptor().clone(), end()?), terminal.path().to_owned());
        return Ok((Place::Port(Some(terminal), Receiver::Slcan(rx), Transmitter::Slcan(tx)), Where::Slcan(path)));
    }
    if let Some(interface) = &serve.can {
        return bus(interface, end()?);
    }
    let address = serve.tcp.ok_or_else(|| anyhow!("nowhere to serve the board"))?;
    let (listener, at) = listen(args, address, serve.public)?;
    Ok((Place::Listener(listener), Where::Tcp(at.to_string())))
}

/// Listens for clients at an address: a loopback address, or any with `public` and a key. Returns the actual address, in
/// which a port of 0 is replaced.
fn listen(args: &Args, address: SocketAddr, public: bool) -> anyhow::Result<(Listener, SocketAddr)> {
    let (socket, at) = bind(args, address, public)?;
    Ok((Listener::new(socket, session::key(args)?), at))
}

/// Binds a socket as [`listen`] does, for callers that check the key in another way.
pub(super) fn bind(args: &Args, address: SocketAddr, public: bool) -> anyhow::Result<(Async<TcpListener>, SocketAddr)> {
    let only_for_some = public && args.key.is_some();
    if !address.ip().is_loopback() && !only_for_some {
        bail!(
            "{address} can be reached from other machines, and any program that reaches it can move the robot: serve it on 127.0.0.1, or \
             with --public and a --key that only those have who may"
        );
    }
    let socket = Async::<TcpListener>::bind(address).with_context(|| format!("cannot listen at {address}"))?;
    let at = socket.get_ref().local_addr().context("cannot listen")?;
    Ok((socket, at))
}

#[cfg(target_os = "linux")]
fn bus(interface: &str, end: End) -> anyhow::Result<(Place, Where)> {
    let (rx, tx) = r4_links::can::open(interface, end)?;
    Ok((Place::Port(None, Receiver::Can(rx), Transmitter::Can(tx)), Where::Can(interface.to_owned())))
}

#[cfg(not(target_os = "linux"))]
fn bus(interface: &str, _: End) -> anyhow::Result<(Place, Where)> {
    bail!("{interface}: only Linux has interfaces for CAN; serve the board with --slcan")
}

fn bytes(descriptor: &Descriptor) -> (Receiver, Transmitter) {
    (Receiver::Bytes(descriptor.clone()), Transmitter::Bytes(descriptor.clone()))
}

/// Frames from the board that no client has read yet.
#[derive(Default)]
struct Outbox {
    bytes: RefCell<VecDeque<u8>>,
    dropped: Cell<u64>,
    /// Beginning of a frame whose end has not come yet.
    partial: RefCell<Vec<u8>>,
    /// Requests of clients that are not the board's host, until their answers are fetched.
    asides: RefCell<Vec<Aside>>,
}

/// Request of a client that is not the board's host. The board answers it among its answers to the host.
struct Aside {
    client: u64,
    /// Sequence number that the client chose.
    seq: u16,
    /// Sequence number towards the board, which the host does not use at present.
    board_seq: u16,
    result: Option<Result<Reply, Refusal>>,
}

impl Outbox {
    /// Takes bytes of the board as they come, and keeps whole frames.
    fn push(&self, bytes: &[u8]) {
        for part in bytes.split_inclusive(|byte| *byte == 0) {
            let mut frame = self.partial.take();
            frame.extend_from_slice(part);
            if frame.last() != Some(&0) && frame.len() < MAX_FRAME {
                self.partial.replace(frame);
            } else if !self.is_aside(&frame) {
                self.keep(&frame);
            }
        }
    }

    fn keep(&self, frame: &[u8]) {
        let mut waiting = self.bytes.borrow_mut();
        let room = OUTBOX - waiting.len();
        if frame.len() > room {
            // All or nothing: clients cannot decode a part of a frame.
            self.dropped.set(self.dropped.get() + frame.len() as u64);
            return;
        }
        waiting.extend(frame);
    }

    /// Keeps a frame's result apart and returns true if the frame answers an aside.
    fn is_aside(&self, frame: &[u8]) -> bool {
        let mut asides = self.asides.borrow_mut();
        if asides.is_empty() {
            return false;
        }
        let mut decoder = FrameDecoder::new();
        let message = frame.iter().find_map(|byte| decoder.push::<ToHost>(*byte));
        let Some(Ok(ToHost::Response { seq, result })) = message else { return false };
        let Some(aside) = asides.iter_mut().find(|aside| aside.board_seq == seq && aside.result.is_none()) else {
            return false;
        };
        aside.result = Some(result);
        true
    }

    /// Forgets what the board had begun when it restarted: it will not go on with that.
    fn restart(&self) {
        self.partial.borrow_mut().clear();
        self.asides.borrow_mut().retain(|aside| aside.result.is_some());
    }
}

/// Board that is being served.
struct Served<'s> {
    simulation: &'s mut Simulation,
    board: Rc<dyn VirtualBoard>,
    to_board: r4_sim::link::Sender,
    outbox: Rc<Outbox>,
    /// Real time at virtual time 0, later by the skipped time.
    origin: Instant,
    /// Set when the board requests a restart.
    restart: Rc<Cell<bool>>,
    /// Time of the last look at the world; `None` before the first.
    looked: Option<Instant>,
    until: Until<'s>,
}

impl<'s> Served<'s> {
    fn new(simulation: &'s mut Simulation, board: Rc<dyn VirtualBoard>, until: Until<'s>) -> anyhow::Result<Self> {
        let outbox = Rc::<Outbox>::default();
        let restart = Rc::<Cell<bool>>::default();
        let to_board = connect(simulation, &board, &outbox, &restart)?;
        Ok(Self { simulation, board, to_board, outbox, origin: Instant::now(), restart, looked: None, until })
    }

    async fn run(mut self, place: Place) -> anyhow::Result<()> {
        let served = match place {
            Place::Port(_pty, mut rx, mut tx) => self.with_client(&mut rx, &mut tx).await,
            Place::Listener(listener) => self.with_clients(Clients::new(listener, self.outbox.clone())).await,
        };
        if self.outbox.dropped.get() > 0 {
            eprintln!("r4: {} bytes of the board were dropped: no client read them", self.outbox.dropped.get());
        }
        served
    }

    async fn with_clients(&mut self, mut clients: Clients) -> anyhow::Result<()> {
        loop {
            let bytes = self.meanwhile(clients.next()).await?.context("cannot accept a client")?;
            self.receive(&bytes)?;
        }
    }

    /// Transfers bytes in both directions until the client is gone.
    async fn with_client(&mut self, rx: &mut Receiver, tx: &mut Transmitter) -> anyhow::Result<()> {
        let mut buffer = [0; 4096];
        let outbox = self.outbox.clone();
        let mut sending = pin!(send(&outbox, tx));
        loop {
            let len = {
                let mut reading = pin!(rx.read(&mut buffer));
                let both = poll_fn(|context| {
                    if let Poll::Ready(error) = sending.as_mut().poll(context) {
                        return Poll::Ready(Err(error));
                    }
                    reading.as_mut().poll(context)
                });
                self.meanwhile(both).await?
            };
            match len {
                Ok(len) if len > 0 => self.receive(&buffer[..len])?,
                // A read of 0 bytes means that the client is gone.
                Ok(_) => return Err(Gone(None).into()),
                Err(error) => return Err(Gone(Some(error)).into()),
            }
        }
    }

    /// Passes bytes from a client to the board at the current virtual time.
    fn receive(&mut self, bytes: &[u8]) -> anyhow::Result<()> {
        let to_board = &mut self.to_board;
        let written = self.simulation.block_on(async { to_board.write_all(bytes).await });
        written.map(|_| ()).ok_or_else(|| anyhow!("the simulation came to a standstill"))
    }

    /// Waits for a future outside the simulation, while the board runs in real time.
    async fn meanwhile<T>(&mut self, outside: impl Future<Output = T>) -> anyhow::Result<T> {
        let mut outside = pin!(outside);
        loop {
            self.catch_up()?;
            if (self.until.ends)() {
                return Err(session::Interrupted.into());
            }
            // Sleep until the board's next event, but no longer than the period of the check for Ctrl-C.
            let next = self.simulation.clock().next_wake().map(|next_ns| self.origin + Duration::from_nanos(next_ns));
            let latest = Instant::now() + LOOK_EVERY;
            let timer = Timer::at(next.map_or(latest, |next| next.min(latest)));
            if let Either::Left((value, _)) = select(outside.as_mut(), timer).await {
                // The caller acts on the result at the virtual time of its arrival.
                self.catch_up()?;
                return Ok(value);
            }
        }
    }

    /// Runs the simulation up to the current real time.
    fn catch_up(&mut self) -> anyhow::Result<()> {
        // Read once: the real time that this run takes is made up by the next one.
        let begin = Instant::now();
        let behind =
            begin.saturating_duration_since(self.origin + Duration::from_nanos(self.simulation.clock().now_ns()));
        // A delay of LOOK_EVERY is normal, since the wait between two calls takes up to that long.
        if behind > LOOK_EVERY + HURRY {
            let too_much = behind - HURRY;
            self.origin += too_much;
            eprintln!("r4: this machine was busy for {} ms; the board's clock stood still", too_much.as_millis());
            // A closed stdout is no reason to stop the board.
            let from_ns = self.simulation.clock().now_ns();
            if self.until.reports_shifts {
                let _ = output::json(&Shifted { epoch_ns: monotonic_ns(self.origin), from_ns });
            }
        }
        let clock = self.simulation.clock();
        let to_ns = begin.saturating_duration_since(self.origin).as_nanos() as u64;
        if to_ns > clock.now_ns() {
            self.simulation
                .block_on(clock.sleep_until(to_ns))
                .ok_or_else(|| anyhow!("the simulation came to a standstill"))?;
        }
        if let Some(failure) = self.board.failure() {
            bail!("the emulated board stopped: {failure}");
        }
        if let Some(look) = self.until.look
            && self.looked.is_none_or(|looked| begin.duration_since(looked) >= LOOK_EVERY)
        {
            self.looked = Some(begin);
            look.set(WorldLook::of(&self.board.world()));
        }
        if self.restart.take() {
            self.board.restart(self.simulation, ResetCause::Normal);
            self.outbox.restart();
            self.to_board = connect(self.simulation, &self.board, &self.outbox, &self.restart)?;
        }
        Ok(())
    }
}

/// Error when the client has closed the connection.
#[derive(Debug, thiserror::Error)]
#[error("the client is gone")]
struct Gone(#[source] Option<io::Error>);

/// Connects to a board that has started, with tasks in the simulation that store its output and detect a requested restart.
fn connect(
    simulation: &mut Simulation,
    board: &Rc<dyn VirtualBoard>,
    outbox: &Rc<Outbox>,
    restart: &Rc<Cell<bool>>,
) -> anyhow::Result<r4_sim::link::Sender> {
    let Some(Port { mut rx, tx }) = board.connect() else { bail!("the board is connected already") };
    let outbox = outbox.clone();
    simulation.spawn(async move {
        let mut buffer = [0; 1024];
        loop {
            let Ok(len) = rx.read(&mut buffer).await;
            outbox.push(&buffer[..len]);
        }
    });
    let (board, restart) = (board.clone(), restart.clone());
    simulation.spawn(async move {
        board.restart_requested().await;
        restart.set(true);
    });
    Ok(tx)
}

/// Sends the bytes of the outbox until an error, which is returned.
async fn send(outbox: &Outbox, tx: &mut Transmitter) -> io::Error {
    loop {
        let bytes: Vec<u8> = outbox.bytes.borrow_mut().drain(..).collect();
        if bytes.is_empty() {
            // The caller polls this after each run of the simulation.
            let mut looked = false;
            poll_fn(|_| if std::mem::replace(&mut looked, true) { Poll::Ready(()) } else { Poll::Pending }).await;
            continue;
        }
        if let Err(error) = tx.write_all(&bytes).await {
            return error;
        }
    }
}
