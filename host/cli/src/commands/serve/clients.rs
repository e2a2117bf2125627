//! Clients of a board that is served on a socket. All are greeted side by side; the one that opens a session first is the
//! board's host, and until it is gone the others hear that the board is in use. A stop reaches the board from any client,
//! with or without a session, as on the links of a board.
//!
//! A client that opens no session, or sends no heartbeats in one, is dropped, so that none can keep others out. The board gets whole
//! frames only: bytes that a client sends before its session, and an incomplete frame that it leaves behind, never reach the
//! session of another.

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
use r4_protocol::{FrameDecoder, Refusal, Reply, Request, ToDevice, ToHost, encode_frame, frame::MAX_FRAME};

use super::{Aside, Outbox};

/// Time after which a client without a session or heartbeats is dropped: ten times the board's link time-out.
const SILENT: Duration = Duration::from_secs(2);
/// Maximum number of stops that wait for the board's answer. The oldest is forgotten when there are more, so that a client
/// cannot fill the memory; the stop itself is passed on.
const MAX_ASIDES: usize = 64;
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
    /// Sequence number of the host's last request.
    host_seq: Cell<u16>,
    /// Number of asides so far, wrapping.
    asides: Cell<u16>,
    /// Frames for the board, each complete.
    to_board: RefCell<Vec<u8>>,
    outbox: Rc<Outbox>,
}

impl Desk {
    /// Takes a complete frame of a client, with its delimiter, and the message in it, if any. The frame goes to the board
    /// if the client is its host. Returns the answer to a request of any other client, unless the board is to give it.
    fn take(&self, client: u64, frame: &[u8], message: Option<&ToDevice>, heard: &Cell<Instant>) -> Option<ToHost> {
        let hello = matches!(message, Some(ToDevice::Request { request: Request::Hello { .. }, .. }));
        if hello && self.host.get().is_none() {
            self.host.set(Some(client));
            // Discard output of the board for the previous host.
            self.outbox.bytes.borrow_mut().clear();
        }
        if self.host.get() == Some(client) {
            if hello || matches!(message, Some(ToDevice::Heartbeat { .. })) {
                heard.set(Instant::now());
            }
            if let Some(ToDevice::Request { seq, .. }) = message {
                self.host_seq.set(*seq);
            }
            self.to_board.borrow_mut().extend_from_slice(frame);
            return None;
        }
        let Some(ToDevice::Request { seq, request }) = message else { return None };
        let result = match request {
            Request::Stop => {
                self.stop(client, *seq);
                return None;
            }
            // Closing no session is no error.
            Request::Bye => Ok(Reply::Done),
            _ if self.host.get().is_some() => Err(Refusal::InUse),
            _ => Err(Refusal::NoSession),
        };
        Some(ToHost::Response { seq: *seq, result })
    }

    /// Passes a stop of a client that is not the host on to the board.
    fn stop(&self, client: u64, seq: u16) {
        // The host's requests in flight have numbers just below its last one, so half the numbers away is free.
        let board_seq = self.host_seq.get().wrapping_add(0x8000).wrapping_add(self.asides.get() % 0x4000);
        self.asides.set(self.asides.get().wrapping_add(1));
        let stop = ToDevice::Request { seq: board_seq, request: Request::Stop };
        if let Ok(frame) = encode_frame(&stop, &mut [0; MAX_FRAME]) {
            self.to_board.borrow_mut().extend_from_slice(frame);
            let mut asides = self.outbox.asides.borrow_mut();
            if asides.len() == MAX_ASIDES {
                asides.remove(0);
            }
            asides.push(Aside { client, seq, board_seq, result: None });
        }
    }

    /// Fetches the board's answers to a client's asides.
    fn fetch(&self, client: u64) -> Vec<ToHost> {
        let mut asides = self.outbox.asides.borrow_mut();
        let fetched = asides.extract_if(.., |aside| aside.client == client && aside.result.is_some());
        let answer = |Aside { seq, result, .. }| Some(ToHost::Response { seq, result: result? });
        fetched.filter_map(answer).collect()
    }
}

impl Clients {
    pub(super) fn new(listener: Listener, outbox: Rc<Outbox>) -> Self {
        let desk = Desk {
            host: Cell::new(None),
            host_seq: Cell::new(0),
            asides: Cell::new(0),
            to_board: RefCell::default(),
            outbox,
        };
        Self { listener, connected: Vec::new(), desk: Rc::new(desk), next_number: 0 }
    }

    /// Waits for frames that clients send to the board.
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
            }
            false
        });
        let is_here = |number| self.connected.iter().any(|client| client.number == number);
        // An answer that has not come yet must still be kept apart from the host's.
        desk.outbox.asides.borrow_mut().retain(|aside| aside.result.is_none() || is_here(aside.client));
    }
}

async fn served(Link { rx, mut tx }: Link, desk: Rc<Desk>, number: u64) -> Left {
    let heard = Cell::new(Instant::now());
    let answers = RefCell::new(Vec::new());
    let receiving = receive(rx, &desk, number, &heard, &answers);
    let sending = async {
        loop {
            let bytes = poll_fn(|_| {
                desk.fetch(number).iter().for_each(|answer| tell(&answers, answer));
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

/// Adds a message to those that a client has not received yet.
fn tell(answers: &RefCell<Vec<u8>>, answer: &ToHost) {
    if let Ok(frame) = encode_frame(answer, &mut [0; MAX_FRAME])
        // A client that does not read its answers must not fill the memory.
        && answers.borrow().len() < MAX_FRAME
    {
        answers.borrow_mut().extend_from_slice(frame);
    }
}

/// Forwards the host's frames to the board, and answers requests of other clients. Returns when the link ends.
async fn receive(mut rx: Receiver, desk: &Desk, number: u64, heard: &Cell<Instant>, answers: &RefCell<Vec<u8>>) {
    let mut decoder = FrameDecoder::new();
    let mut frame = Vec::new();
    let mut buffer = [0; 4096];
    while let Ok(len @ 1..) = rx.read(&mut buffer).await {
        for byte in &buffer[..len] {
            let message = decoder.push::<ToDevice>(*byte).and_then(Result::ok);
            // A longer sequence of bytes is no frame; its beginning shows the board that.
            if frame.len() < MAX_FRAME || ends_frame(*byte) {
                frame.push(*byte);
            }
            if ends_frame(*byte) {
                if let Some(answer) = desk.take(number, &frame, message.as_ref(), heard) {
                    tell(answers, &answer);
                }
                frame.clear();
            }
        }
    }
}

/// True for the delimiter of frames: COBS removes all other zero bytes.
const fn ends_frame(byte: u8) -> bool {
    byte == 0
}
