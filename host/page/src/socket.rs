//! A WebSocket without its link: bytes in, texts out, and back. Frames are tungstenite's.

use std::{
    collections::VecDeque,
    io::{self, Write},
};

use tungstenite::{
    Error, Message, WebSocket,
    error::CapacityError,
    protocol::{CloseFrame, Role, WebSocketConfig, frame::coding::CloseCode},
};

/// Most bytes of a message from a page: its longest, the one with the token, has about 90.
pub const MOST_MESSAGE: usize = 1024;

/// Reason for the end of a WebSocket.
#[derive(Debug, thiserror::Error)]
pub enum SocketError {
    /// The other end has closed it.
    #[error("the page has closed its socket")]
    Closed,
    /// A message is longer than [`MOST_MESSAGE`].
    #[error("a message of the page has {0} bytes, of at most {MOST_MESSAGE}")]
    TooLong(usize),
    /// A message is no text.
    #[error("a message of the page is no text")]
    NoText,
    /// Bytes that are no WebSocket frame.
    #[error("what comes is no WebSocket: {0}")]
    Broken(#[source] Box<Error>),
}

/// Bytes that have come, and those that are to be sent.
#[derive(Debug, Default)]
struct Bytes {
    incoming: VecDeque<u8>,
    outgoing: Vec<u8>,
}

impl io::Read for Bytes {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.incoming.is_empty() { Err(io::ErrorKind::WouldBlock.into()) } else { self.incoming.read(buffer) }
    }
}

impl Write for Bytes {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.outgoing.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// An end of a WebSocket.
#[derive(Debug)]
pub struct Socket(WebSocket<Bytes>);

impl Socket {
    /// The server's end, after the handshake.
    #[must_use]
    pub fn server() -> Self {
        let limits = WebSocketConfig::default()
            .read_buffer_size(4096)
            .write_buffer_size(0)
            .max_write_buffer_size(usize::MAX)
            .max_message_size(Some(MOST_MESSAGE))
            .max_frame_size(Some(MOST_MESSAGE));
        Self(WebSocket::from_raw_socket(Bytes::default(), Role::Server, Some(limits)))
    }

    /// Takes bytes that have come, and returns the messages that are whole. Pings are answered.
    ///
    /// # Errors
    /// [`SocketError`]
    pub fn receive(&mut self, bytes: &[u8]) -> Result<Vec<String>, SocketError> {
        self.0.get_mut().incoming.extend(bytes);
        let mut texts = Vec::new();
        let ended = loop {
            match self.0.read() {
                Ok(Message::Text(text)) => texts.push(text.as_str().to_owned()),
                Ok(Message::Ping(_) | Message::Pong(_)) => {}
                Ok(Message::Close(_)) | Err(Error::ConnectionClosed | Error::AlreadyClosed) => {
                    break Err(SocketError::Closed);
                }
                Ok(Message::Binary(_) | Message::Frame(_)) => break Err(SocketError::NoText),
                Err(Error::Io(error)) if error.kind() == io::ErrorKind::WouldBlock => break Ok(texts),
                Err(Error::Capacity(CapacityError::MessageTooLong { size, .. })) => {
                    break Err(SocketError::TooLong(size));
                }
                Err(error) => break Err(SocketError::Broken(Box::new(error))),
            }
        };
        // Writes never fail here: they go to memory.
        let _ = self.0.flush();
        ended
    }

    /// Sends a text. After the end of the socket it has no effect.
    pub fn send(&mut self, text: String) {
        let _ = self.0.send(Message::text(text));
    }

    /// Sends the closing frame.
    pub fn close(&mut self) {
        let _ = self.0.close(Some(CloseFrame { code: CloseCode::Policy, reason: "".into() }));
        let _ = self.0.flush();
    }

    /// Bytes that are to be sent, not yet taken.
    #[must_use]
    pub fn waiting(&self) -> usize {
        self.0.get_ref().outgoing.len()
    }

    /// Takes the bytes that are to be sent.
    pub fn take(&mut self) -> Vec<u8> {
        std::mem::take(&mut self.0.get_mut().outgoing)
    }

    /// The browser's end, for tests.
    #[cfg(test)]
    fn client() -> Self {
        Self(WebSocket::from_raw_socket(Bytes::default(), Role::Client, None))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// Texts come through whole and in order, however the network cuts them.
        #[test]
        fn texts_come_through_in_pieces(
            texts in prop::collection::vec(".{0,60}", 0..8),
            piece in 1..50usize,
        ) {
            let (mut browser, mut server) = (Socket::client(), Socket::server());
            texts.iter().for_each(|text| browser.send(text.clone()));
            let mut heard = Vec::new();
            for bytes in browser.take().chunks(piece) {
                heard.extend(server.receive(bytes).expect("a WebSocket"));
            }
            prop_assert_eq!(&heard, &texts);
            texts.iter().for_each(|text| server.send(text.clone()));
            prop_assert_eq!(browser.receive(&server.take()).expect("a WebSocket"), texts);
        }

        #[test]
        fn any_bytes_end_it_or_wait_for_more(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let _ = Socket::server().receive(&bytes);
        }
    }

    fn received(send: impl FnOnce(&mut WebSocket<Bytes>)) -> Result<Vec<String>, SocketError> {
        let (mut browser, mut server) = (Socket::client(), Socket::server());
        send(&mut browser.0);
        server.receive(&browser.take())
    }

    #[test]
    fn what_is_too_long_or_no_text_ends_it() {
        let text =
            |len| move |browser: &mut WebSocket<Bytes>| browser.send(Message::text("x".repeat(len))).expect("sent");
        assert_eq!(received(text(MOST_MESSAGE)).expect("short enough").len(), 1);
        assert!(matches!(received(text(MOST_MESSAGE + 1)), Err(SocketError::TooLong(len)) if len == MOST_MESSAGE + 1));
        let binary = received(|browser| browser.send(Message::binary(vec![1])).expect("sent"));
        assert!(matches!(binary, Err(SocketError::NoText)), "{binary:?}");
        let closed = received(|browser| browser.close(None).expect("sent"));
        assert!(matches!(closed, Err(SocketError::Closed)), "{closed:?}");
        // A browser masks what it sends (RFC 6455, 5.1).
        assert!(matches!(Socket::server().receive(&[0x81, 0x01, b'x']), Err(SocketError::Broken(_))));
    }

    #[test]
    fn pings_are_answered() {
        let (mut browser, mut server) = (Socket::client(), Socket::server());
        browser.0.send(Message::Ping("are you there".into())).expect("sent");
        assert_eq!(server.receive(&browser.take()).expect("a ping"), [""; 0]);
        assert!(server.waiting() > 0);
        browser.0.get_mut().incoming.extend(server.take());
        assert_eq!(browser.0.read().expect("a pong"), Message::Pong("are you there".into()));
    }
}
