//! Clients of a board that is served on a socket. All are greeted side by side; the one that opens a session first is the
//! board's host, and until it is gone the others hear that the board is in use.
//!
//! A client that opens no session, or sends no heartbeats in one, is dropped, so that none can keep others out. Bytes that a client
//! sends before its session, and an incomplete frame that it leaves behind, never reach the session of another.

use std::{
    cell::{Cell, RefCell},
    future::{Future, poll_fn},
    io,
    pin::{Pin, pin},
    rc::Rc,
    task::{Context, Poll},
    time::{Duration, Instant},
};

use async_io::Timer;
use embedded_io_async::{Read, Write};
use futures::future::{Either, select};
use r4_links::{Accepted, Link, Listener, Receiver};
use r4_protocol::{FrameDecoder, Refusal, Request, ToDevice, ToHost, encode_frame, frame::MAX_FRAME};

use super::Outbox;

/// Time after which a client without a session or heartbeats is dropped: ten times the board's link time-out.
const SILENT: Duration = Duration::from_secs(2);
/// Most clients at once. One more replaces the client that has waited longest without a session.
const CLIENTS: usize = 64;

/// Message about a client without the key.
pub(in super::super) const TURNED_AWAY: &str = "r4: a client without the key was turned away";
/// Message about a silent client.
pub(in super::super) const DROPPED: &str = "r4: a client without a session or heartbeats was dropped";

/// Connected clients of one board.
pub(super) struct Clients {
    listener: Listener,
    connected: Vec<Client>,
    desk: Rc<Desk>,
    next_number: u64,
}

struct Client {
    number: u64,
    /// Task that serves the client; completes when it has left.
    task: Pin<Box<dyn Future<Output = Left>>>,
}

/// Reason why a client left.
enum Left {
    /// The client closed its end, or its link failed.
    Gone,
    /// The client opened no session, or sent no heartbeats.
    Silent,
}

/// State that the clients share.
struct Desk {
    /// Number of the client that is the board's host; `None` for no client.
    host: Cell<Option<u64>>,
    to_board: RefCell<Vec<u8>>,
    outbox: Rc<Outbox>,
}

impl Clients {
    pub(super) fn new(listener: Listener, outbox: Rc<Outbox>) -> Self {
        let desk = Desk { host: Cell::new(None), to_board: RefCell::default(), outbox };
        Self { listener, connected: Vec::new(), desk: Rc::new(desk), next_number: 0 }
    }

    /// Waits for bytes that the host sends to the board.
    ///
    /// # Errors
    /// [`io::Error`] of the listening socket.
    pub(super) async fn next(&mut self) -> io::Result<Vec<u8>> {
        poll_fn(|context| {
            while let Poll::Ready(accepted) = self.listener.poll_accept(context) {
                match accepted {
                    Ok(Accepted::Client(link)) => self.connect(link),
                    Ok(Accepted::Stranger) => eprintln!("{TURNED_AWAY}"),
                    Err(error) => return Poll::Ready(Err(error)),
                }
            }
            self.serve(context);
            let bytes = self.desk.to_board.take();
            if bytes.is_empty() { Poll::Pending } else { Poll::Ready(Ok(bytes)) }
        })
        .await
    }

    fn connect(&mut self, link: Link) {
        if self.connected.len() >= CLIENTS
            && let Some(longest) = self.connected.iter().position(|client| self.desk.host.get() != Some(client.number))
        {
            self.connected.remove(longest);
        }
        let number = self.next_number;
        self.next_number += 1;
        let task = Box::pin(served(link, self.desk.clone(), number));
        self.connected.push(Client { number, task });
    }

    fn serve(&mut self, context: &mut Context<'_>) {
        let desk = &self.desk;
        self.connected.retain_mut(|client| {
            let Poll::Ready(left) = client.task.as_mut().poll(context) else { return true };
            match left {
                Left::Gone => {}
                Left::Silent => eprintln!("{DROPPED}"),
            }
            if desk.host.get() == Some(client.number) {
                desk.host.set(None);
                // A zero byte ends an incomplete frame, which would otherwise damage the next host's first frame.
                desk.to_board.borrow_mut().push(0);
            }
            false
        });
    }
}

async fn served(Link { rx, mut tx }: Link, desk: Rc<Desk>, number: u64) -> Left {
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
                // `poll_fn` needs no waker: the task is polled after each run of the simulation.
                if bytes.is_empty() { Poll::Pending } else { Poll::Ready(bytes) }
            })
            .await;
            if tx.write_all(&bytes).await.is_err() {
                return;
            }
        }
    };
    // The last branch of the select: bytes that arrived while this machine was busy are read before the time-out is
    // checked.
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

/// Forwards the host's bytes to the board, and refuses requests of other clients. Returns when the link ends.
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
                // A longer sequence of bytes is no frame.
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
                    // Discard output of the board for the previous host.
                    desk.outbox.bytes.borrow_mut().clear();
                    desk.to_board.borrow_mut().append(&mut frame);
                }
                Some(Ok(ToDevice::Request { seq, .. })) if !is_host => {
                    let refusal = if desk.host.get().is_some() { Refusal::InUse } else { Refusal::NoSession };
                    let answer = ToHost::Response { seq, result: Err(refusal) };
                    if let Ok(answer) = encode_frame(&answer, &mut [0; MAX_FRAME])
                        // A client that does not read its answers must not fill the memory.
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

/// True for the delimiter of frames: COBS removes all other zero bytes.
const fn message_ends(byte: u8) -> bool {
    byte == 0
}
