//! TCP listener for clients of a board, who prove to have the key before they are let in.

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

/// A client proves to have the key within this time.
const GREETING: Duration = Duration::from_secs(2);
/// Most clients that have not proven it yet. Of more, the oldest is disconnected.
const GREETED_AT_ONCE: usize = 64;

/// TCP listener, and the key that clients must have.
pub struct Listener {
    socket: Async<TcpListener>,
    key: Option<Rc<Key>>,
    greeted: VecDeque<Pin<Box<dyn Future<Output = Option<Link>>>>>,
}

/// Result of one connection.
#[derive(Debug)]
pub enum Accepted {
    /// Link to a client that has proven to have the key, where one is asked for.
    Client(Link),
    /// The client did not prove it in time, and was disconnected.
    Stranger,
}

impl Listener {
    /// Takes a socket that listens. With a key only clients that have it are let in, and what they send is encrypted.
    #[must_use]
    pub fn new(socket: Async<TcpListener>, key: Option<Key>) -> Self {
        Self { socket, key: key.map(Rc::new), greeted: VecDeque::new() }
    }

    /// Accepts the next client. Poll it until it is pending. Handshakes run side by side: a client that stalls keeps no other out.
    ///
    /// # Errors
    /// Those of the operating system when it accepts connections; one that was aborted is none.
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
                self.greeted.remove(place);
                return Poll::Ready(Ok(link.map_or(Accepted::Stranger, Accepted::Client)));
            }
        }
        Poll::Pending
    }

    fn poll_socket(&self, context: &mut Context<'_>) -> Poll<io::Result<Descriptor>> {
        loop {
            match self.socket.get_ref().accept() {
                // One that is closed already concerns no other client.
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
