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

/// A client without a session, or whose heartbeats do not come, is dropped after this time: ten times as long as a board waits.
const SILENT: Duration = Duration::from_secs(2);
/// Most clients at once. Of more, the one that has waited longest without a session goes.
const CLIENTS: usize = 64;

/// What is said of who does not have the key.
pub(in super::super) const TURNED_AWAY: &str = "r4: a client without the key was turned away";
/// What is said of who is silent.
pub(in super::super) const DROPPED: &str = "r4: a client without a session or heartbeats was dropped";

/// Everyone who is connected.
pub(super) struct Clients {
    listener: Listener,
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
    pub(super) fn new(listener: Listener, outbox: Rc<Outbox>) -> Self {
        let desk = Desk { host: Cell::new(None), to_board: RefCell::default(), outbox };
        Self { listener, connected: Vec::new(), desk: Rc::new(desk), next_number: 0 }
    }

    /// What the host has sent to the board.
    ///
    /// # Errors
    /// The listener's.
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
                // Ends half a frame, which would take the next host's first one with it.
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
