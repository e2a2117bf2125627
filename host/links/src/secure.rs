//! A byte link on which both ends know that the other has the same key, and that nobody between them reads or changes a byte.
//!
//! For boards that are served to other machines. The Noise protocol (<https://noiseprotocol.org/noise.html>, revision 34) with
//! the pattern `Noise_NNpsk0_25519_ChaChaPoly_BLAKE2s`: an exchange of fresh Curve25519 keys under a key that both know before.
//!
//! ```text
//! client: psk, e        48 bytes; a client without the key is noticed here
//! server: e, ee         48 bytes; a server without it here
//! ```
//!
//! Then each direction is records:
//!
//! ```text
//! length of what follows, 2 bytes, least significant first | data, encrypted, and 16 bytes of MAC
//! ```
//!
//! Records are counted from 0 by both ends and come in order on TCP; the count is the nonce, so that one that is repeated,
//! reordered or left out fails. Each end takes a new key, one way ([`REKEY_EVERY`]), long before a nonce could come again.
//!
//! | against | how |
//! | --- | --- |
//! | who has not the key | neither end says anything but its part of the handshake |
//! | reading, changing, repeating, reordering, leaving out on the way | ChaCha20-Poly1305 under keys of this connection alone |
//! | a key that is stolen later | what was recorded before stays secret: both ephemeral keys are gone |
//! | a first message that is repeated | the server answers it, and takes no record: who repeats has not the ephemeral key |
//!
//! Not hidden: who talks to whom, when, and how much. Not prevented: cutting the connection, which stops the board as a lost
//! link does, and delaying it, which heartbeats and the dates of set points bound. Whoever has the key may do all that a host
//! may, and may pass for the server.

use std::{
    fmt,
    io::{self, Read as _},
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use embedded_io_async::{ErrorType, Read, Write};
use hmac::{Hmac, KeyInit, Mac};
use sha2::Sha256;
use snow::{Builder, HandshakeState, TransportState};

use crate::{Descriptor, key_file};

/// Name of the protocol in the framework's words.
const PATTERN: &str = "Noise_NNpsk0_25519_ChaChaPoly_BLAKE2s";
/// What both ends must mean by it, besides the pattern: the form of records.
const PROLOGUE: &[u8] = b"r4 link, records 1";
/// Bytes of each message of the handshake: an ephemeral key and a MAC.
pub const HANDSHAKE: usize = 32 + TAG;
/// Bytes of a record's MAC.
const TAG: usize = 16;
/// Most data of a record: two frames of the protocol.
const MOST_DATA: usize = 512;
/// Each direction takes a new key after so many records, a quarter of an hour of cycles at 1 kHz: what was sent before stays
/// secret from who takes the memory of one end.
pub const REKEY_EVERY: u64 = 1 << 20;
/// Most bytes of a file that may be a key.
const KEY_FILE: u64 = 4096;

/// What both ends must know.
#[derive(Clone, PartialEq, Eq)]
pub struct Key([u8; 32]);

impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Key(..)")
    }
}

/// Why a file gives no key.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    /// It cannot be read.
    #[error("cannot read the key {}: {source}; make one with `openssl rand -hex 32 > {} && chmod 600 {}`", .path.display(), .path.display(), .path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// The operating system's words.
        source: io::Error,
    },
    /// Others may read it.
    #[error("other users may read the key {}: `chmod 600 {}`", .0.display(), .0.display())]
    Open(PathBuf),
    /// It holds something else.
    #[error("{} holds no key: it must be 64 hex digits, as `openssl rand -hex 32` prints them", .0.display())]
    Form(PathBuf),
}

impl Key {
    /// A key of 32 bytes.
    #[must_use]
    pub const fn new(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    /// A key that nobody else has.
    ///
    /// # Errors
    /// Where the operating system gives no random numbers.
    pub fn random() -> io::Result<Self> {
        let pattern = PATTERN.parse().map_err(broken)?;
        let private = snow::Builder::new(pattern).generate_keypair().map_err(broken)?.private;
        private.try_into().map(Self).map_err(|_| io::Error::other("a private key of another length"))
    }

    /// Reads 64 hex digits from a file that only its owner may read.
    ///
    /// # Errors
    /// [`KeyError`]
    pub fn read(path: &Path) -> Result<Self, KeyError> {
        Self::read_while(path, || true)
    }

    /// As [`Key::read`], for a path that may be a pipe: asks `goes_on` every 50 ms whether to wait for its writer.
    ///
    /// # Errors
    /// [`KeyError`]; [`KeyError::Read`] with [`io::ErrorKind::Interrupted`] when it did not go on.
    pub fn read_while(path: &Path, mut goes_on: impl FnMut() -> bool) -> Result<Self, KeyError> {
        let failed = |source| KeyError::Read { path: path.to_owned(), source };
        let mut file = key_file::open(path).map_err(failed)?;
        let metadata = file.metadata().map_err(failed)?;
        if key_file::is_open_to_others(&metadata) {
            return Err(KeyError::Open(path.to_owned()));
        }
        let is_pipe = key_file::is_pipe(&metadata);
        let mut bytes = Vec::new();
        loop {
            if is_pipe && !key_file::has_data(&file).map_err(failed)? {
                if !goes_on() {
                    return Err(failed(io::ErrorKind::Interrupted.into()));
                }
                continue;
            }
            let mut some = [0; 512];
            match file.read(&mut some) {
                Ok(0) => break,
                Ok(len) => bytes.extend_from_slice(&some[..len]),
                Err(error) if error.kind() == io::ErrorKind::Interrupted => {}
                Err(error) if error.kind() == io::ErrorKind::WouldBlock => {}
                Err(error) => return Err(failed(error)),
            }
            if bytes.len() as u64 > KEY_FILE {
                return Err(KeyError::Form(path.to_owned()));
            }
        }
        let text = str::from_utf8(&bytes).ok();
        text.and_then(|text| Self::from_hex(text.trim())).ok_or_else(|| KeyError::Form(path.to_owned()))
    }

    fn from_hex(text: &str) -> Option<Self> {
        let digits: Vec<u8> = text.chars().map(|digit| Some(digit.to_digit(16)? as u8)).collect::<Option<_>>()?;
        let bytes: Vec<u8> = digits.chunks_exact(2).map(|pair| pair[0] << 4 | pair[1]).collect();
        (digits.len() == 64).then(|| bytes.try_into().ok()).flatten().map(Self)
    }

    /// Token for something that is served beside links with this key, such as a page: HMAC-SHA-256 of `purpose` by this key. Who learns
    /// the token has neither the key nor the token of another purpose.
    #[must_use]
    pub fn token(&self, purpose: &str) -> [u8; 32] {
        self.mac(&[b"r4 token, ", purpose.as_bytes()])
    }

    /// Key of the handshake: HMAC-SHA-256 of this one, so that the same file may serve something else too.
    fn of_handshake(&self) -> [u8; 32] {
        self.mac(&[PATTERN.as_bytes(), PROLOGUE])
    }

    fn mac(&self, parts: &[&[u8]]) -> [u8; 32] {
        #[expect(clippy::expect_used, reason = "HMAC takes keys of any length")]
        let mut mac = <Hmac<Sha256> as KeyInit>::new_from_slice(&self.0).expect("any length");
        parts.iter().for_each(|part| mac.update(part));
        mac.finalize().into_bytes().into()
    }
}

/// The other end is not trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Distrust {
    /// It does not have the key.
    #[error("the other end does not have this key: both need the same file")]
    Key,
    /// A record is not the other end's, or not the next one.
    #[error("a record was changed, repeated or left out on the way")]
    Record,
}

impl From<Distrust> for io::Error {
    fn from(distrust: Distrust) -> Self {
        Self::new(io::ErrorKind::PermissionDenied, distrust)
    }
}

/// Who speaks first, and who answers.
#[derive(Clone, Copy)]
enum Role {
    Client,
    Server,
}

/// An end of the handshake.
fn end(key: &Key, role: Role) -> io::Result<HandshakeState> {
    let psk = key.of_handshake();
    let pattern = PATTERN.parse().map_err(broken)?;
    let builder = Builder::new(pattern).psk(0, &psk).and_then(|builder| builder.prologue(PROLOGUE)).map_err(broken)?;
    match role {
        Role::Client => builder.build_initiator(),
        Role::Server => builder.build_responder(),
    }
    .map_err(broken)
}

/// What no other end can cause: no random numbers, or a pattern that is not built in.
fn broken(error: snow::Error) -> io::Error {
    io::Error::other(error)
}

/// Sends the next message of the handshake.
async fn say(link: &mut Descriptor, handshake: &mut HandshakeState) -> io::Result<()> {
    let mut message = [0; HANDSHAKE];
    let len = handshake.write_message(&[], &mut message).map_err(broken)?;
    link.write_all(&message[..len]).await
}

/// Takes the next message of the handshake.
async fn hear(link: &mut Descriptor, handshake: &mut HandshakeState) -> io::Result<()> {
    let mut message = [0; HANDSHAKE];
    match link.read_exact(&mut message).await {
        Ok(()) => {}
        // Whoever does not trust us says nothing.
        Err(embedded_io_async::ReadExactError::UnexpectedEof) => return Err(Distrust::Key.into()),
        Err(embedded_io_async::ReadExactError::Other(error)) => return Err(error),
    }
    handshake.read_message(&message, &mut []).map_err(|_| Distrust::Key)?;
    Ok(())
}

/// The client's part of the greeting.
///
/// # Errors
/// The link's, and [`Distrust::Key`].
pub async fn client(mut link: Descriptor, key: &Key) -> io::Result<(Receiver, Transmitter)> {
    let mut handshake = end(key, Role::Client)?;
    say(&mut link, &mut handshake).await?;
    hear(&mut link, &mut handshake).await?;
    ends(link, handshake)
}

/// The server's part of the greeting. The client has proved to have the key, but perhaps to somebody else and long ago: only
/// its first record is of this connection.
///
/// # Errors
/// The link's, and [`Distrust::Key`]: then nothing was said.
pub async fn server(mut link: Descriptor, key: &Key) -> io::Result<(Receiver, Transmitter)> {
    let mut handshake = end(key, Role::Server)?;
    hear(&mut link, &mut handshake).await?;
    say(&mut link, &mut handshake).await?;
    ends(link, handshake)
}

fn ends(link: Descriptor, handshake: HandshakeState) -> io::Result<(Receiver, Transmitter)> {
    let (sealer, opener) = directions(handshake, REKEY_EVERY)?;
    Ok((Receiver { link: link.clone(), opener, waiting: Vec::new() }, Transmitter { link, sealer }))
}

fn directions(handshake: HandshakeState, rekey_every: u64) -> io::Result<(Sealer, Opener)> {
    let transport = Arc::new(Mutex::new(handshake.into_transport_mode().map_err(broken)?));
    let sealer = Sealer { transport: transport.clone(), rekey_every };
    Ok((sealer, Opener { transport, rekey_every, part: Vec::new(), failed: false }))
}

/// Makes records.
struct Sealer {
    transport: Arc<Mutex<TransportState>>,
    rekey_every: u64,
}

impl Sealer {
    /// A record of at most [`MOST_DATA`].
    fn seal(&mut self, data: &[u8]) -> io::Result<Vec<u8>> {
        let mut record = vec![0; 2 + data.len() + TAG];
        let transport = &mut *self.transport.lock().unwrap_or_else(PoisonError::into_inner);
        let len = transport.write_message(data, &mut record[2..]).map_err(broken)?;
        record[..2].copy_from_slice(&(len as u16).to_le_bytes());
        if transport.sending_nonce().is_multiple_of(self.rekey_every) {
            transport.rekey_outgoing();
        }
        Ok(record)
    }
}

/// Takes records apart.
struct Opener {
    transport: Arc<Mutex<TransportState>>,
    rekey_every: u64,
    /// Of a record that is not whole yet.
    part: Vec<u8>,
    /// After a record that is not the next one nothing is taken any more.
    failed: bool,
}

impl Opener {
    /// The data of the records that are whole now.
    fn open(&mut self, bytes: &[u8]) -> Result<Vec<u8>, Distrust> {
        if self.failed {
            return Err(Distrust::Record);
        }
        let opened = self.next(bytes);
        self.failed = opened.is_err();
        opened
    }

    fn next(&mut self, bytes: &[u8]) -> Result<Vec<u8>, Distrust> {
        self.part.extend_from_slice(bytes);
        let mut data = Vec::new();
        let transport = &mut *self.transport.lock().unwrap_or_else(PoisonError::into_inner);
        while let Some((len, rest)) = self.part.split_first_chunk::<2>() {
            let size = usize::from(u16::from_le_bytes(*len));
            if !(TAG..=MOST_DATA + TAG).contains(&size) {
                return Err(Distrust::Record);
            }
            let Some(record) = rest.get(..size) else { break };
            let mut opened = [0; MOST_DATA + TAG];
            let len = transport.read_message(record, &mut opened).map_err(|_| Distrust::Record)?;
            data.extend_from_slice(&opened[..len]);
            if transport.receiving_nonce().is_multiple_of(self.rekey_every) {
                transport.rekey_incoming();
            }
            self.part.drain(..2 + size);
        }
        Ok(data)
    }
}

/// What comes from the other end, each byte of it verified.
pub struct Receiver {
    link: Descriptor,
    opener: Opener,
    /// Verified and not read yet.
    waiting: Vec<u8>,
}

/// What goes to the other end.
pub struct Transmitter {
    link: Descriptor,
    sealer: Sealer,
}

impl fmt::Debug for Receiver {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Receiver").field("link", &self.link).finish_non_exhaustive()
    }
}

impl fmt::Debug for Transmitter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Transmitter").field("link", &self.link).finish_non_exhaustive()
    }
}

impl ErrorType for Receiver {
    type Error = io::Error;
}

impl Read for Receiver {
    async fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        while self.waiting.is_empty() {
            let mut bytes = [0; 1024];
            let len = self.link.read(&mut bytes).await?;
            if len == 0 {
                return Ok(0);
            }
            self.waiting = self.opener.open(&bytes[..len])?;
        }
        let len = buffer.len().min(self.waiting.len());
        buffer[..len].copy_from_slice(&self.waiting[..len]);
        self.waiting.drain(..len);
        Ok(len)
    }
}

impl ErrorType for Transmitter {
    type Error = io::Error;
}

impl Write for Transmitter {
    async fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        let len = bytes.len().min(MOST_DATA);
        let record = self.sealer.seal(&bytes[..len])?;
        self.link.write_all(&record).await?;
        Ok(len)
    }

    async fn flush(&mut self) -> io::Result<()> {
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// Both directions of both ends: of the client, and of the server.
    fn both(rekey_every: u64) -> [(Sealer, Opener); 2] {
        let key = Key::new([7; 32]);
        let mut client = end(&key, Role::Client).expect("built in");
        let mut server = end(&key, Role::Server).expect("built in");
        let mut message = [0; HANDSHAKE];
        for client_says in [true, false] {
            let (from, to) = if client_says { (&mut client, &mut server) } else { (&mut server, &mut client) };
            assert_eq!(from.write_message(&[], &mut message), Ok(HANDSHAKE));
            assert_eq!(to.read_message(&message, &mut []), Ok(0));
        }
        [client, server].map(|end| directions(end, rekey_every).expect("the handshake is over"))
    }

    /// Sealer and opener of one direction.
    fn direction() -> (Sealer, Opener) {
        let [(sealer, _), (_, opener)] = both(REKEY_EVERY);
        (sealer, opener)
    }

    #[test]
    fn keys_are_taken_as_rfc_4231_has_them() {
        // Its test case 2 has a key of 4 bytes, which zeros at its end do not change (RFC 2104, section 2).
        let mut key = [0; 32];
        key[..4].copy_from_slice(b"Jefe");
        let mut mac = <Hmac<Sha256> as KeyInit>::new_from_slice(&key).expect("any length");
        mac.update(b"what do ya want for nothing?");
        assert!(mac.finalize().into_bytes().starts_with(&[0x5b, 0xdc, 0xc1, 0x46, 0xbf, 0x60, 0x75, 0x4e]));
        assert_ne!(Key::new(key).of_handshake(), key, "the file's key itself is not used");
        assert_ne!(Key::new(key).of_handshake(), Key::new([1; 32]).of_handshake());
    }

    #[test]
    fn without_the_key_no_message_is_taken() {
        let mut stranger = end(&Key::new([8; 32]), Role::Client).expect("built in");
        let mut server = end(&Key::new([7; 32]), Role::Server).expect("built in");
        let mut message = [0; HANDSHAKE];
        stranger.write_message(&[], &mut message).expect("fits");
        server.read_message(&message, &mut []).expect_err("another key");
    }

    /// The server answers a first message that it has heard before, but who repeats it can make no record.
    #[test]
    fn a_repeated_greeting_opens_nothing() {
        let key = Key::new([7; 32]);
        let mut client = end(&key, Role::Client).expect("built in");
        let mut first = [0; HANDSHAKE];
        client.write_message(&[], &mut first).expect("fits");
        let mut answers = Vec::new();
        let mut openers = Vec::new();
        for _ in 0..2 {
            let mut server = end(&key, Role::Server).expect("built in");
            server.read_message(&first, &mut []).expect("of the key");
            let mut answer = [0; HANDSHAKE];
            server.write_message(&[], &mut answer).expect("fits");
            answers.push(answer);
            openers.push(directions(server, REKEY_EVERY).expect("over").1);
        }
        assert_ne!(answers[0], answers[1]);
        client.read_message(&answers[0], &mut []).expect("of the key");
        let record = directions(client, REKEY_EVERY).expect("over").0.seal(b"arm").expect("sealed");
        assert_eq!(openers[1].open(&record), Err(Distrust::Record), "recorded in the other connection");
        assert_eq!(openers[0].open(&record), Ok(b"arm".to_vec()));
    }

    #[test]
    fn what_is_sent_cannot_be_read_on_the_way_nor_sent_back() {
        let [(mut client, mut of_client), (mut server, mut of_server)] = both(REKEY_EVERY);
        let said = [0x42; 100];
        let record = client.seal(&said).expect("sealed");
        assert!(!record.windows(4).any(|part| part == &said[..4]));
        assert_ne!(record, client.seal(&said).expect("sealed"), "the same twice looks different");
        assert_eq!(of_client.open(&record), Err(Distrust::Record), "each direction has its own key");
        assert_eq!(of_server.open(&record), Ok(said.to_vec()));
        let answer = server.seal(b"").expect("sealed");
        assert_eq!(answer.len(), 2 + TAG, "also nothing is signed");
        let rekey_s = REKEY_EVERY / 1000;
        assert!((900..1200).contains(&rekey_s), "{rekey_s} s of cycles at 1 kHz under one key");
    }

    #[test]
    fn a_key_is_not_printed() {
        assert_eq!(format!("{:?}", Key::new([0x5a; 32])), "Key(..)");
    }

    #[test]
    fn a_token_is_made_of_the_key_and_its_purpose() {
        // By Python: hmac.new(b"\x5a" * 32, b"r4 token, page", hashlib.sha256).
        let page = [
            0x12, 0xc0, 0x09, 0x2c, 0x81, 0x8b, 0x48, 0x5f, 0xc7, 0xc7, 0x6e, 0xb3, 0x3c, 0xa2, 0x9c, 0x9f, 0x3a, 0x14,
            0x5b, 0xc0, 0xd6, 0x52, 0xa1, 0x23, 0x34, 0x72, 0x09, 0x69, 0x68, 0x07, 0x6d, 0x95,
        ];
        let key = Key::new([0x5a; 32]);
        assert_eq!(key.token("page"), page);
        assert_ne!(key.token("other"), page);
        assert_ne!(key.of_handshake(), page);
    }

    #[test]
    fn keys_are_hex() {
        let text = "00ff".repeat(16);
        assert_eq!(Key::from_hex(&text).map(|key| key.0[..2].to_vec()), Some(vec![0, 0xff]));
        for bad in ["", "00", &"0g".repeat(32), &"00".repeat(33)] {
            assert_eq!(Key::from_hex(bad), None, "{bad}");
        }
    }

    proptest! {
        /// Also over many changes of the key.
        #[test]
        fn records_carry_what_was_sent(
            parts in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..=MOST_DATA), 1..20),
            cut in 1_usize..50,
            rekey_every in 1_u64..5,
        ) {
            let [(mut sealer, mut answers), (mut answerer, mut opener)] = both(rekey_every);
            for part in &parts {
                let sent = sealer.seal(part).expect("sealed");
                let received: Vec<u8> = sent.chunks(cut).flat_map(|piece| opener.open(piece).expect("untouched")).collect();
                prop_assert_eq!(&received, part);
                let back = answerer.seal(part).expect("sealed");
                prop_assert_eq!(&answers.open(&back).expect("untouched"), part);
            }
        }

        #[test]
        fn nothing_that_was_touched_is_taken(data in prop::collection::vec(any::<u8>(), 1..100), at: prop::sample::Index, bit in 0..8) {
            let (mut sealer, mut opener) = direction();
            let mut record = sealer.seal(&data).expect("sealed");
            let at = at.index(record.len());
            record[at] ^= 1_u8 << bit;
            // What looks longer is waited for; what is waited for is never taken.
            let opened = opener.open(&record);
            prop_assert!(opened == Ok(Vec::new()) || opened == Err(Distrust::Record));
            let after = opener.open(&sealer.seal(&data).expect("sealed"));
            prop_assert!(after == Ok(Vec::new()) || after == Err(Distrust::Record), "and nothing after it");
        }

        #[test]
        fn a_record_is_taken_once_and_in_its_turn(data in prop::collection::vec(any::<u8>(), 1..50), missing in 1..5) {
            let (mut sealer, mut opener) = direction();
            let first = sealer.seal(&data).expect("sealed");
            prop_assert_eq!(opener.open(&first), Ok(data.clone()));
            prop_assert_eq!(opener.open(&first), Err(Distrust::Record), "repeated");
            let (mut sealer, mut opener) = direction();
            let records: Vec<_> = (0..=missing).map(|_| sealer.seal(&data).expect("sealed")).collect();
            prop_assert_eq!(opener.open(records.last().expect("some")), Err(Distrust::Record), "left out");
            let (mut sealer, mut opener) = direction();
            let (first, second) = (sealer.seal(&data).expect("sealed"), sealer.seal(&data).expect("sealed"));
            prop_assert_eq!(opener.open(&[second, first].concat()), Err(Distrust::Record), "reordered");
        }

        #[test]
        fn lengths_that_no_record_has_are_refused_at_once(size in prop_oneof![0..TAG as u16, (MOST_DATA + TAG) as u16 + 1..=u16::MAX]) {
            let (_, mut opener) = direction();
            prop_assert_eq!(opener.open(&size.to_le_bytes()), Err(Distrust::Record));
        }

        /// A record that is cut short is nothing, however long one waits.
        #[test]
        fn part_of_a_record_is_nothing(data in prop::collection::vec(any::<u8>(), 0..100), at: prop::sample::Index) {
            let (mut sealer, mut opener) = direction();
            let record = sealer.seal(&data).expect("sealed");
            prop_assert_eq!(opener.open(&record[..at.index(record.len())]), Ok(Vec::new()));
        }
    }
}
