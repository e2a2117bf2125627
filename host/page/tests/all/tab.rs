//! A browser that has the page open, by its bytes: HTTP, then a WebSocket with the page's messages.

use std::{cell::Cell, collections::VecDeque, convert::Infallible, future::poll_fn, io, pin::pin, rc::Rc, task::Poll};

use embassy_sync::{blocking_mutex::raw::NoopRawMutex, pipe::Pipe};
use embedded_io_async::{ErrorType, Read, Write};
use futures::future::{Either, select};
use r4_driver::Clock;
use serde_json::{Value, json};
use tungstenite::{Error, Message, WebSocket, protocol::Role};

use crate::{Door, simulated::VirtualClock};

/// One direction of a connection, with as many bytes as a network holds for a browser that does not read.
type Wire = Rc<Pipe<NoopRawMutex, 8192>>;

/// The server's receiving end.
pub(crate) struct Receiver {
    wire: Wire,
    is_closed: Rc<Cell<bool>>,
}

/// The server's sending end.
pub(crate) struct Sender(Wire);

impl ErrorType for Receiver {
    type Error = Infallible;
}

impl ErrorType for Sender {
    type Error = Infallible;
}

impl Read for Receiver {
    async fn read(&mut self, buffer: &mut [u8]) -> Result<usize, Infallible> {
        let mut reading = pin!(self.wire.read(buffer));
        let read = poll_fn(|context| match self.is_closed.get() {
            true => Poll::Ready(0),
            false => reading.as_mut().poll(context),
        });
        Ok(read.await)
    }
}

impl Write for Sender {
    async fn write(&mut self, bytes: &[u8]) -> Result<usize, Infallible> {
        Ok(self.0.write(bytes).await)
    }

    async fn flush(&mut self) -> Result<(), Infallible> {
        Ok(())
    }
}

/// Browser's end of the link.
pub(crate) struct Connection {
    from: Wire,
    to: Wire,
    is_closed: Rc<Cell<bool>>,
    clock: VirtualClock,
}

/// Two ends of a connection without delay.
pub(crate) fn connection(clock: VirtualClock) -> (Connection, Receiver, Sender) {
    let (to, from, is_closed) = (Wire::new(Pipe::new()), Wire::new(Pipe::new()), Rc::<Cell<bool>>::default());
    let there = (Receiver { wire: to.clone(), is_closed: is_closed.clone() }, Sender(from.clone()));
    (Connection { from, to, is_closed, clock }, there.0, there.1)
}

impl Connection {
    pub(crate) async fn send(&mut self, bytes: &[u8]) {
        let mut left = bytes;
        while !left.is_empty() {
            left = &left[self.to.write(left).await..];
        }
    }

    /// Returns the message that comes within `seconds`; `None` without one.
    async fn receive(&mut self, seconds: f64) -> Option<Vec<u8>> {
        let mut buffer = vec![0; 4096];
        let until_us = self.clock.now_us() + (seconds * 1e6) as u64;
        let len = match select(pin!(self.from.read(&mut buffer)), pin!(self.clock.sleep_until(until_us))).await {
            Either::Left((len, _)) => len,
            Either::Right(((), _)) => return None,
        };
        buffer.truncate(len);
        Some(buffer)
    }

    /// All that comes until nothing has for 0.1 s.
    pub(crate) async fn answer(&mut self) -> String {
        let mut answer = Vec::new();
        while let Some(bytes) = self.receive(0.1).await {
            answer.extend(bytes);
        }
        String::from_utf8(answer).expect("text")
    }

    /// Closes it, as the operating system does for a browser that has ended.
    pub(crate) async fn close(&mut self) {
        self.is_closed.set(true);
        // The other end notices with its next byte.
        self.send(b"\0").await;
    }
}

/// Bytes of a WebSocket in memory.
#[derive(Default)]
struct Bytes {
    incoming: VecDeque<u8>,
    outgoing: Vec<u8>,
}

impl io::Read for Bytes {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if self.incoming.is_empty() {
            Err(io::ErrorKind::WouldBlock.into())
        } else {
            io::Read::read(&mut self.incoming, buffer)
        }
    }
}

impl io::Write for Bytes {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.outgoing.extend_from_slice(bytes);
        Ok(bytes.len())
    }

    fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

/// Host and port of the page in these tests.
pub(crate) const HOST: &str = "127.0.0.1:8404";

/// The head of a request that asks for a WebSocket.
pub(crate) fn upgrade(host: &str, origin: &str) -> String {
    format!(
        "GET /socket HTTP/1.1\r\nHost: {host}\r\nOrigin: {origin}\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n\
         Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n"
    )
}

/// The page, as its script behaves.
pub(crate) struct Tab {
    pub(crate) connection: Connection,
    web: WebSocket<Bytes>,
    /// Returns the newest state message.
    pub(crate) look: Value,
    /// The board, as it was described first.
    pub(crate) board: Value,
    /// All else, in order.
    pub(crate) said: Vec<Value>,
}

impl Tab {
    /// Opens the page's socket, and says hello with `token`.
    pub(crate) async fn with_token(door: &Door<'_, '_>, token: &str) -> Self {
        let mut connection = door.connect();
        connection.send(upgrade(HOST, &format!("http://{HOST}")).as_bytes()).await;
        let answer = connection.receive(1.0).await.expect("an answer");
        let (head, rest) = answer.split_at(answer.windows(4).position(|end| end == b"\r\n\r\n").expect("a head") + 4);
        assert!(head.starts_with(b"HTTP/1.1 101 "), "{}", String::from_utf8_lossy(head));
        let web = WebSocket::from_raw_socket(Bytes::default(), Role::Client, None);
        let mut tab = Self { connection, web, look: Value::Null, board: Value::Null, said: Vec::new() };
        tab.take(rest.to_vec());
        tab.say(&json!({ "hello": { "token": token } })).await;
        tab
    }

    /// The same with the right token, and waits for the first look.
    pub(crate) async fn open(door: &Door<'_, '_>) -> Self {
        let mut tab = Self::with_token(door, &door.token).await;
        tab.until("a look", |tab| tab.look.is_object()).await;
        tab
    }

    pub(crate) async fn message(&mut self, message: Message) {
        self.web.send(message).expect("an open socket");
        let bytes = std::mem::take(&mut self.web.get_mut().outgoing);
        self.connection.send(&bytes).await;
    }

    pub(crate) async fn say(&mut self, message: &Value) {
        self.message(Message::text(message.to_string())).await;
    }

    pub(crate) async fn ask(&mut self, what: &str) {
        self.say(&json!({ "ask": what })).await;
    }

    /// A beat that has seen the newest look.
    pub(crate) async fn beat(&mut self) {
        let tick_ms = self.look["tick_ms"].as_u64().unwrap_or(0);
        self.say(&json!({ "beat": { "tick_ms": tick_ms } })).await;
    }

    fn take(&mut self, bytes: Vec<u8>) {
        self.web.get_mut().incoming.extend(bytes);
        loop {
            match self.web.read() {
                Ok(Message::Text(text)) => {
                    let mut message: Value = serde_json::from_str(&text).expect("JSON");
                    match () {
                        () if message["look"].is_object() => self.look = message["look"].take(),
                        () if message["board"].is_object() => self.board = message["board"].take(),
                        () => self.said.push(message),
                    }
                }
                Ok(_) | Err(Error::ConnectionClosed) => return,
                Err(Error::Io(error)) if error.kind() == io::ErrorKind::WouldBlock => return,
                Err(error) => panic!("{error}"),
            }
        }
    }

    /// Listens for `seconds`, and beats 20 times a second if `beats`.
    pub(crate) async fn listen(&mut self, seconds: f64, beats: bool) {
        let until_us = self.connection.clock.now_us() + (seconds * 1e6) as u64;
        while self.connection.clock.now_us() < until_us {
            if beats {
                self.beat().await;
            }
            let next_us = until_us.min(self.connection.clock.now_us() + 50_000);
            while self.connection.clock.now_us() < next_us {
                let left_s = (next_us - self.connection.clock.now_us()) as f64 * 1e-6;
                if let Some(bytes) = self.connection.receive(left_s).await {
                    self.take(bytes);
                }
            }
        }
    }

    /// Beats until something is so.
    pub(crate) async fn until(&mut self, what: &str, is_so: impl Fn(&Self) -> bool) {
        for _ in 0..200 {
            if is_so(self) {
                return;
            }
            self.listen(0.01, true).await;
        }
        panic!("not {what} after 2 s: {} {:?}", self.look, self.said);
    }

    /// Asks, and returns what is answered: `None` for done, or why not.
    pub(crate) async fn order(&mut self, what: &str) -> Option<String> {
        self.said.clear();
        self.ask(what).await;
        let is_answer = |said: &Value| said["answer"]["ask"] == what;
        self.until("answered", |tab| tab.said.iter().any(is_answer)).await;
        let answer = self.said.iter().find(|said| is_answer(said)).expect("answered");
        answer["answer"]["error"].as_str().map(str::to_owned)
    }

    pub(crate) fn state(&self) -> &str {
        self.look["state"].as_str().unwrap_or("unknown")
    }

    /// Causes of a trip, by their names.
    pub(crate) fn causes(&self) -> Vec<&str> {
        let causes = self.look["causes"].as_array().into_iter().flatten();
        causes.filter_map(|cause| cause["cause"].as_str()).collect()
    }
}
