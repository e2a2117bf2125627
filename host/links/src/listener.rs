//! TCP listener for clients of a board, which must prove possession of the key before they are accepted.

use std::{
    collections::VecDeque,
    future::Future,
    io,
    net::TcpListener,
    pin::{Pin, pin},
    rc::Rc,
    task::{Context, Poll},
    time::Duration,
};

use async_io::{Async, Timer};
use futures::future::{Either, select};

use crate::{Descriptor, Key, Link, Receiver, Transmitter, secure, tcp};

/// Time limit for the handshake with a client.
const GREETING: Duration = Duration::from_secs(2);
/// Largest number of unfinished handshakes; beyond it the oldest client is disconnected.
const GREETED_AT_ONCE: usize = 64;

/// Listening socket with the key that clients must have.
pub struct Listener {
    socket: Async<TcpListener>,
    key: Option<Rc<Key>>,
    greeted: VecDeque<Pin<Box<dyn Future<Output = Option<Link>>>>>,
}

/// Result of one connection.
#[derive(Debug)]
pub enum Accepted {
    /// Link to a client that has proven possession of the key, where one is required.
    Client(Link),
    /// The client did not prove it in time and was disconnected.
    Stranger,
}

impl Listener {
    /// Wraps a listening socket. With a key, only clients with the same key are accepted, and the links are encrypted.
    #[must_use]
    pub fn new(socket: Async<TcpListener>, key: Option<Key>) -> Self {
        Self { socket, key: key.map(Rc::new), greeted: VecDeque::new() }
    }

    /// Accepts the next client. Poll it until it is pending. Handshakes run concurrently: a stalling client does not
    /// keep others out.
    ///
    /// # Errors
    /// Those of the operating system when it accepts connections; an aborted connection is no error.
    pub fn poll_accept(&mut self, context: &mut Context<'_>) -> Poll<io::Result<Accepted>> {
        while let Poll::Ready(socket) = self.poll_socket(context) {
            let descriptor = socket?;
            if self.greeted.len() == GREETED_AT_ONCE {
                self.greeted.pop_front();
            }
            self.greeted.push_back(Box::pin(greet(descriptor, self.key.clone())));
        }
        for place in 0..self.greeted.len() {
            if let Poll::Ready(link) = self.greeted[place].as_mut().poll(context) {
                // Later places have moved, so only one handshake is taken per call; the caller polls again.
                self.greeted.remove(place);
                return Poll::Ready(Ok(link.map_or(Accepted::Stranger, Accepted::Client)));
            }
        }
        Poll::Pending
    }

    fn poll_socket(&self, context: &mut Context<'_>) -> Poll<io::Result<Descriptor>> {
        loop {
            match self.socket.get_ref().accept() {
                // A failure here means that this client has disconnected already, which does not concern the others.
                Ok((stream, _)) => {
                    if let Ok(descriptor) = tcp(stream) {
                        return Poll::Ready(Ok(descriptor));
                    }
                }
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {
                    futures::ready!(self.socket.poll_readable(context))?;
                }
                Err(error) if matches!(error.kind(), io::ErrorKind::ConnectionAborted | io::ErrorKind::Interrupted) => {
                }
                Err(error) => return Poll::Ready(Err(error)),
            }
        }
    }
}

async fn greet(descriptor: Descriptor, key: Option<Rc<Key>>) -> Option<Link> {
    let Some(key) = key else {
        return Some(Link { rx: Receiver::Bytes(descriptor.clone()), tx: Transmitter::Bytes(descriptor) });
    };
    let greeted = secure::server(descriptor, &key);
    match select(pin!(greeted), Timer::after(GREETING)).await {
        Either::Left((Ok((rx, tx)), _)) => Some(Link { rx: Receiver::Secure(rx), tx: Transmitter::Secure(tx) }),
        Either::Left((Err(_), _)) | Either::Right(_) => None,
    }
}
