//! Tokens on a link: frames beside those of the protocol.
//!
//! A token goes over a link as its text and a zero byte, between two frames of the protocol, which end with a zero byte
//! too. A board drops it as a damaged frame, so that messages of the protocol and boards stay as they are.

use std::path::Path;

use embedded_io_async::{ErrorType, Write};

use crate::{
    Credential, CredentialError,
    credential::read_secret,
    token::{MAGIC, MAX_TOKEN},
};

/// Part of the bytes that came over a link.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Piece {
    /// Bytes of the protocol.
    Bytes(Vec<u8>),
    /// Text of a token.
    Token(String),
}

/// Separates the tokens of a link from the frames of the protocol.
#[derive(Debug, Default)]
pub struct Splitter {
    held: Vec<u8>,
    within: Within,
}

/// Place within the bytes of a link.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Within {
    /// Begin of a frame, which may be a token.
    #[default]
    Begin,
    /// Frame of the protocol.
    Frame,
    Token,
    /// Token that is too long.
    Overlong,
}

impl Splitter {
    /// Takes received bytes. Returns the pieces that they complete, in their order. At most a token's length is held.
    pub fn push(&mut self, bytes: &[u8]) -> Vec<Piece> {
        let (mut pieces, mut plain) = (Vec::new(), Vec::new());
        for byte in bytes {
            self.byte(*byte, &mut pieces, &mut plain);
        }
        if !plain.is_empty() {
            pieces.push(Piece::Bytes(plain));
        }
        pieces
    }

    fn byte(&mut self, byte: u8, pieces: &mut Vec<Piece>, plain: &mut Vec<u8>) {
        match self.within {
            Within::Frame => plain.push(byte),
            Within::Begin => {
                self.held.push(byte);
                if self.held == MAGIC.as_bytes() {
                    self.within = Within::Token;
                } else if !MAGIC.as_bytes().starts_with(&self.held) {
                    plain.append(&mut self.held);
                    self.within = Within::Frame;
                }
            }
            Within::Token if byte == 0 => {
                // In the order of the link: what came before it is decided before it.
                if !plain.is_empty() {
                    pieces.push(Piece::Bytes(std::mem::take(plain)));
                }
                let text = String::from_utf8_lossy(&self.held).into_owned();
                pieces.push(Piece::Token(text));
            }
            Within::Token if self.held.len() >= MAX_TOKEN => self.within = Within::Overlong,
            Within::Token => self.held.push(byte),
            Within::Overlong => {}
        }
        if byte == 0 {
            self.held.clear();
            self.within = Within::Begin;
        }
    }
}

/// Origin of the tokens that a client presents.
#[derive(Clone, Debug)]
pub enum Source {
    /// A key, with which each link gets tokens of its own, renewed before they expire.
    Key(Box<Credential>),
    /// One token, for one link.
    Token(String),
}

impl Source {
    /// Reads a credential, or a token that `r4 access grant` printed, from a file that only its owner may read.
    ///
    /// # Errors
    /// [`CredentialError`] names the reason.
    pub fn read(path: &Path) -> Result<Self, CredentialError> {
        let text = read_secret(path)?;
        match text.trim() {
            token if token.starts_with(MAGIC) => Ok(Self::Token(token.to_owned())),
            _ => Credential::read(path).map(|credential| Self::Key(Box::new(credential))),
        }
    }
}

/// Transmitter that presents tokens: before the first byte, and again when half of a token's life is over.
pub struct Presenter<W> {
    tx: W,
    source: Option<Source>,
    now_ms: Box<dyn Fn() -> u64>,
    /// Time of the next token, Unix ms; `None` when there is none.
    next_ms: Option<u64>,
    /// The last byte ended a frame.
    is_between: bool,
}

impl<W> Presenter<W> {
    /// Wraps a transmitter; without a source it changes nothing. `now_ms` is the client's clock, Unix ms.
    pub fn new(tx: W, source: Option<Source>, now_ms: impl Fn() -> u64 + 'static) -> Self {
        let next_ms = source.as_ref().map(|_| 0);
        Self { tx, source, now_ms: Box::new(now_ms), next_ms, is_between: true }
    }

    /// Token that is due now.
    fn due(&mut self) -> Option<String> {
        let now_ms = (self.now_ms)();
        if !self.is_between || now_ms < self.next_ms? {
            return None;
        }
        match self.source.as_ref()? {
            Source::Token(token) => {
                self.next_ms = None;
                Some(token.clone())
            }
            Source::Key(credential) => {
                self.next_ms = Some(now_ms + credential.life_s.saturating_mul(500));
                // Without random numbers there is no token, and requests are denied.
                credential.token(false, now_ms).ok()
            }
        }
    }
}

impl<W: ErrorType> ErrorType for Presenter<W> {
    type Error = W::Error;
}

impl<W: Write> Write for Presenter<W> {
    async fn write(&mut self, buffer: &[u8]) -> Result<usize, W::Error> {
        if let Some(token) = self.due() {
            self.tx.write_all(token.as_bytes()).await?;
            self.tx.write_all(&[0]).await?;
        }
        let written = self.tx.write(buffer).await?;
        if let Some(last) = buffer.get(..written).and_then(<[u8]>::last) {
            self.is_between = *last == 0;
        }
        Ok(written)
    }

    async fn flush(&mut self) -> Result<(), W::Error> {
        self.tx.flush().await
    }
}

#[cfg(test)]
mod tests {
    use std::convert::Infallible;

    use futures::executor::block_on;
    use proptest::prelude::*;

    use super::*;

    /// Transmitter that takes at most three bytes at a time.
    #[derive(Default)]
    struct Wire(Vec<u8>);

    impl ErrorType for Wire {
        type Error = Infallible;
    }

    impl Write for Wire {
        async fn write(&mut self, buffer: &[u8]) -> Result<usize, Infallible> {
            let len = buffer.len().min(3);
            self.0.extend_from_slice(&buffer[..len]);
            Ok(len)
        }

        async fn flush(&mut self) -> Result<(), Infallible> {
            Ok(())
        }
    }

    thread_local!(static NOW_MS: std::cell::Cell<u64> = const { std::cell::Cell::new(0) });

    #[test]
    fn a_key_presents_tokens_between_frames_and_renews_them() {
        let credential = Credential::make("alice", "ward-3", "operation", 60).expect("made");
        let source = Some(Source::Key(Box::new(credential)));
        let mut tx = Presenter::new(Wire::default(), source, || NOW_MS.get());
        let mut frames = Vec::new();
        for second in 0..100_u64 {
            NOW_MS.set(1_000_000 + second * 1000);
            let frame = [b'r', b'4', second as u8 + 1, 7, 0];
            block_on(tx.write_all(&frame)).expect("infallible");
            frames.extend(frame);
        }
        let mut splitter = Splitter::default();
        let (mut plain, mut tokens) = (Vec::new(), 0);
        for piece in splitter.push(&tx.tx.0) {
            match piece {
                Piece::Bytes(bytes) => plain.extend(bytes),
                Piece::Token(token) => {
                    assert!(token.starts_with(MAGIC));
                    tokens += 1;
                }
            }
        }
        // At 0, 30, 60 and 90 s.
        assert_eq!((plain == frames, tokens), (true, 4));
    }

    proptest! {
        /// Frames and tokens in any order and in pieces of any size come apart as they were joined.
        #[test]
        fn tokens_and_frames_come_apart(
            parts in prop::collection::vec((any::<bool>(), prop::collection::vec(1_u8.., 0..40)), 0..20),
            cuts in prop::collection::vec(1_usize..30, 1..60),
        ) {
            let (mut bytes, mut frames, mut tokens) = (Vec::new(), Vec::new(), Vec::new());
            for (is_token, content) in parts {
                if is_token {
                    let token = format!("{MAGIC}{}", content.iter().map(|byte| char::from(byte % 90 + 33)).collect::<String>());
                    bytes.extend_from_slice(token.as_bytes());
                    tokens.push(token);
                } else {
                    prop_assume!(!content.starts_with(MAGIC.as_bytes()));
                    bytes.extend_from_slice(&content);
                    frames.extend_from_slice(&content);
                    frames.push(0);
                }
                bytes.push(0);
            }
            let (mut splitter, mut plain, mut found, mut rest) = (Splitter::default(), Vec::new(), Vec::new(), &bytes[..]);
            for cut in cuts.into_iter().chain([usize::MAX]) {
                let (now, later) = rest.split_at(cut.min(rest.len()));
                rest = later;
                for piece in splitter.push(now) {
                    match piece {
                        Piece::Bytes(bytes) => plain.extend(bytes),
                        Piece::Token(token) => found.push(token),
                    }
                }
            }
            prop_assert_eq!((plain, found), (frames, tokens));
        }
    }

    #[test]
    fn a_token_without_an_end_holds_no_memory() {
        let mut splitter = Splitter::default();
        splitter.push(MAGIC.as_bytes());
        for _ in 0..100 {
            assert_eq!(splitter.push(&[b'a'; 1000]), []);
        }
        assert!(splitter.held.len() <= MAX_TOKEN);
        assert_eq!(splitter.push(&[0, 1, 0]), [Piece::Bytes(vec![1, 0])]);
    }
}
