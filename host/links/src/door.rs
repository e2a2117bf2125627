//! Where clients of a board come in: a TCP port, and behind it the proof that they have the key.

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
/// Most clients that have not proven it yet. Of more, the one that has come first goes.
const GREETED_AT_ONCE: usize = 64;

/// A TCP port, and the key that clients must have.
pub struct Door {
    listener: Async<TcpListener>,
    key: Option<Rc<Key>>,
    greeted: VecDeque<Pin<Box<dyn Future<Output = Option<Link>>>>>,
}

/// Who has come.
#[derive(Debug)]
pub enum Comer {
    /// A client.
    Client(Link),
    /// Somebody who did not prove to have the key in time, and was turned away.
    Stranger,
}

impl Door {
    /// A door at a port that is listened at. With a key only those come in who have it, and all they send is encrypted.
    #[must_use]
    pub fn new(listener: Async<TcpListener>, key: Option<Key>) -> Self {
        Self { listener, key: key.map(Rc::new), greeted: VecDeque::new() }
    }

    /// Ready with the next that comes. Clients are greeted side by side: nobody can keep another out.
    ///
    /// # Errors
    /// The listener's.
    pub fn poll_next(&mut self, context: &mut Context<'_>) -> Poll<io::Result<Comer>> {
        while let Poll::Ready(accepted) = self.poll_accept(context) {
            let descriptor = accepted?;
            if self.greeted.len() == GREETED_AT_ONCE {
                self.greeted.pop_front();
            }
            self.greeted.push_back(Box::pin(greet(descriptor, self.key.clone())));
        }
        for place in 0..self.greeted.len() {
            if let Poll::Ready(link) = self.greeted[place].as_mut().poll(context) {
                self.greeted.remove(place);
                // Others may be ready, too: whoever polls this does so until it is pending.
                return Poll::Ready(Ok(link.map_or(Comer::Stranger, Comer::Client)));
            }
        }
        Poll::Pending
    }

    fn poll_accept(&self, context: &mut Context<'_>) -> Poll<io::Result<Descriptor>> {
        loop {
            match self.listener.get_ref().accept() {
                // One that is gone again already is nothing to the others.
                Ok((stream, _)) => {
                    if let Ok(descriptor) = tcp(stream) {
                        return Poll::Ready(Ok(descriptor));
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
