//! Clients of a board that is served on a socket. All are greeted side by side; the one that opens a session first is the
//! board's host, and until it is gone the others hear that the board is in use.
//!
//! Nobody can hold a place: who does not prove to have the key in time, does not open a session or sends no heartbeats is
//! dropped. What a client sends before its session, and half a frame that it leaves behind, reach no other's session.

use std::{
    cell::{Cell, RefCell},
    future::{Future, poll_fn},
    io,
    net::TcpListener,
    pin::{Pin, pin},
    rc::Rc,
    task::{Context, Poll},
    time::{Duration, Instant},
};

use async_io::{Async, Timer};
use embedded_io_async::{Read, Write};
use futures::future::{Either, select};
use r4_links::{Descriptor, Key, Receiver, Transmitter, secure};
use r4_protocol::{FrameDecoder, Refusal, Request, ToDevice, ToHost, encode_frame, frame::MAX_FRAME};

use super::Outbox;

/// A client proves to have the key within this time.
const GREETING: Duration = Duration::from_secs(2);
/// A client without a session, or whose heartbeats do not come, is dropped after this time: ten times as long as a board waits.
const SILENT: Duration = Duration::from_secs(2);
/// Most clients at once. Of more, the one that has waited longest without a session goes.
const CLIENTS: usize = 64;

/// Everyone who is connected.
pub(super) struct Clients {
    listener: Async<TcpListener>,
    key: Option<Rc<Key>>,
    connected: Vec<Client>,
    desk: Rc<Desk>,
    next_number: u64,
}

struct Client {
    number: u64,
    /// All that is done with it; ready when it is gone.
    task: Pin<Box<dyn Future<Output = Left>>>,
}

/// How a client left.
enum Left {
    /// It closed its end, or its link failed.
    Gone,
    /// It did not prove to have the key.
    Stranger,
    /// It opened no session, or sent no heartbeats.
    Silent,
}

/// What the clients have in common.
struct Desk {
    /// Number of the board's host.
    host: Cell<Option<u64>>,
    to_board: RefCell<Vec<u8>>,
    outbox: Rc<Outbox>,
}

impl Clients {
    pub(super) fn new(listener: Async<TcpListener>, key: Option<Key>, outbox: Rc<Outbox>) -> Self {
        let desk = Desk { host: Cell::new(None), to_board: RefCell::default(), outbox };
        Self { listener, key: key.map(Rc::new), connected: Vec::new(), desk: Rc::new(desk), next_number: 0 }
    }

    /// What the host has sent to the board.
    ///
    /// # Errors
    /// The listener's.
    pub(super) async fn next(&mut self) -> io::Result<Vec<u8>> {
        poll_fn(|context| {
            if let Poll::Ready(Err(error)) = self.accept(context) {
                return Poll::Ready(Err(error));
            }
            self.serve(context);
            let bytes = self.desk.to_board.take();
            if bytes.is_empty() { Poll::Pending } else { Poll::Ready(Ok(bytes)) }
        })
        .await
    }

    /// Takes whoever has come; never ready but with an error.
    fn accept(&mut self, context: &mut Context<'_>) -> Poll<io::Result<()>> {
        loop {
            match self.listener.get_ref().accept() {
                Ok((stream, _)) => {
                    // One that is gone again already is nothing to the others.
                    if let Ok(descriptor) = r4_links::tcp(stream) {
                        self.connect(descriptor);
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    futures::ready!(self.listener.poll_readable(context))?;
                }
                Err(error) if matches!(error.kind(), io::ErrorKind::ConnectionAborted | io::ErrorKind::Interrupted) => {
                }
                Err(error) => return Poll::Ready(Err(error)),
            }
        }
    }

    fn connect(&mut self, descriptor: Descriptor) {
        if self.connected.len() >= CLIENTS
            && let Some(longest) = self.connected.iter().position(|client| self.desk.host.get() != Some(client.number))
        {
            self.connected.remove(longest);
        }
        let number = self.next_number;
        self.next_number += 1;
        let task = Box::pin(served(descriptor, self.key.clone(), self.desk.clone(), number));
        self.connected.push(Client { number, task });
    }

    fn serve(&mut self, context: &mut Context<'_>) {
        let desk = &self.desk;
        self.connected.retain_mut(|client| {
            let Poll::Ready(left) = client.task.as_mut().poll(context) else { return true };
            match left {
                Left::Gone => {}
                Left::Stranger => eprintln!("r4: a client without the key was turned away"),
                Left::Silent => eprintln!("r4: a client without a session or heartbeats was dropped"),
            }
            if desk.host.get() == Some(client.number) {
                desk.host.set(None);
                // Ends half a frame, which would take the next host's first one with it.
                desk.to_board.borrow_mut().push(0);
            }
            false
        });
    }
}

async fn served(descriptor: Descriptor, key: Option<Rc<Key>>, desk: Rc<Desk>, number: u64) -> Left {
    let greeted = async {
        match &key {
            None => Ok((Receiver::Bytes(descriptor.clone()), Transmitter::Bytes(descriptor))),
            Some(key) => {
                let (rx, tx) = secure::server(descriptor, key).await?;
                Ok::<_, io::Error>((Receiver::Secure(rx), Transmitter::Secure(tx)))
            }
        }
    };
    let (rx, mut tx) = match select(pin!(greeted), Timer::after(GREETING)).await {
        Either::Left((Ok(ends), _)) => ends,
        Either::Left((Err(_), _)) | Either::Right(_) => return Left::Stranger,
    };
    let heard = Cell::new(Instant::now());
    let answers = RefCell::new(Vec::new());
    let receiving = receive(rx, &desk, number, &heard, &answers);
    let sending = async {
        loop {
            let bytes = poll_fn(|_| {
                let mut bytes = answers.take();
                if desk.host.get() == Some(number) {
                    bytes.extend(desk.outbox.bytes.borrow_mut().drain(..));
                }
                // Polled again after each run of the simulation.
                if bytes.is_empty() { Poll::Pending } else { Poll::Ready(bytes) }
            })
            .await;
            if tx.write_all(&bytes).await.is_err() {
                return;
            }
        }
    };
    // After the other two, so that what has come while this machine was busy elsewhere counts.
    let silence = async {
        while heard.get().elapsed() < SILENT {
            Timer::at(heard.get() + SILENT).await;
        }
    };
    match select(select(pin!(receiving), pin!(sending)), pin!(silence)).await {
        Either::Left(_) => Left::Gone,
        Either::Right(_) => Left::Silent,
    }
}

/// Passes on what the host says, and answers who is not the host. Ends with the link.
async fn receive(mut rx: Receiver, desk: &Desk, number: u64, heard: &Cell<Instant>, answers: &RefCell<Vec<u8>>) {
    let mut decoder = FrameDecoder::new();
    let mut frame = Vec::new();
    let mut buffer = [0; 4096];
    while let Ok(len @ 1..) = rx.read(&mut buffer).await {
        for byte in &buffer[..len] {
            let message = decoder.push::<ToDevice>(*byte);
            let is_host = desk.host.get() == Some(number);
            if is_host {
                desk.to_board.borrow_mut().push(*byte);
            } else if frame.len() < MAX_FRAME {
                // What is longer is no frame.
                frame.push(*byte);
            }
            match message {
                Some(Ok(ToDevice::Heartbeat { .. })) if is_host => heard.set(Instant::now()),
                Some(Ok(ToDevice::Request { request: Request::Hello { .. }, .. })) if is_host => {
                    heard.set(Instant::now());
                }
                Some(Ok(ToDevice::Request { request: Request::Hello { .. }, .. })) if desk.host.get().is_none() => {
                    heard.set(Instant::now());
                    desk.host.set(Some(number));
                    // What the board has said to the host before.
                    desk.outbox.bytes.borrow_mut().clear();
                    desk.to_board.borrow_mut().append(&mut frame);
                }
                Some(Ok(ToDevice::Request { seq, .. })) if !is_host => {
                    let refusal = if desk.host.get().is_some() { Refusal::InUse } else { Refusal::NoSession };
                    let answer = ToHost::Response { seq, result: Err(refusal) };
                    if let Ok(answer) = encode_frame(&answer, &mut [0; MAX_FRAME])
                        && answers.borrow().len() < MAX_FRAME
                    {
                        answers.borrow_mut().extend_from_slice(answer);
                    }
                }
                _ => {}
            }
            if message_ends(*byte) {
                frame.clear();
            }
        }
    }
}

/// Whether a frame ends here: COBS leaves no other 0.
const fn message_ends(byte: u8) -> bool {
    byte == 0
}
