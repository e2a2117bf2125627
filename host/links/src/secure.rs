//! Encrypted byte link: both ends prove possession of the same key, and a third party can neither read nor change a
//! byte.
//!
//! It is meant for boards that are served to other machines. The protocol is Noise
//! (<https://noiseprotocol.org/noise.html>, revision 34) with the pattern `Noise_NNpsk0_25519_ChaChaPoly_BLAKE2s`: an
//! exchange of ephemeral Curve25519 keys under a pre-shared key.
//!
//! ```text
//! client: psk, e        48 bytes; a client without the key is noticed here
//! server: e, ee         48 bytes; a server without it here
//! ```
//!
//! After the handshake each direction is a sequence of records:
//!
//! ```text
//! length of the rest, 2 bytes, least significant first | data, encrypted, and 16 bytes of MAC
//! ```
//!
//! Both ends count records from 0, and TCP keeps their order; the count is the nonce, so that a repeated, reordered or
//! missing record fails. Each direction changes its key one-way ([`REKEY_EVERY`]) long before a nonce could repeat.
//!
//! | against | how |
//! | --- | --- |
//! | a peer without the key | neither end sends more than its part of the handshake |
//! | reading, changing, repeating, reordering, omitting records | ChaCha20-Poly1305 with keys of this connection alone |
//! | a key stolen later | earlier recordings stay secret: both ephemeral keys are gone |
//! | a repeated first message | the server answers, but accepts no record: its sender lacks the ephemeral key |
//!
//! The link does not hide who talks to whom, when, and how much. It cannot prevent cutting the connection, which stops
//! the board as a lost link does, nor delaying it, which heartbeats and the dates of set points bound. A holder of the
//! key may do everything a host may, and can pose as the server.

use std::{
    fmt,
    io::{self, Read as _},
    path::{Path, PathBuf},
    sync::{Arc, Mutex, PoisonError},
};

use embedded_io_async::{ErrorType, Read, Write};
use hmac::{Hmac, Mac};
use sha2::Sha256;
use snow::{Builder, HandshakeState, TransportState};

use crate::{Descriptor, key_file};

/// Name of the protocol in Noise's notation.
const PATTERN: &str = "Noise_NNpsk0_25519_ChaChaPoly_BLAKE2s";
/// Prologue, which both ends must share: it names the form of the records.
const PROLOGUE: &[u8] = b"r4 link, records 1";
/// Length of each handshake message, bytes: an ephemeral key and a MAC.
pub const HANDSHAKE: usize = 32 + TAG;
/// Length of a record's MAC, bytes.
const TAG: usize = 16;
/// Largest data length of a record, bytes: two frames of the R4 protocol.
const MOST_DATA: usize = 512;
/// Number of records after which a direction changes its key, a quarter of an hour of cycles at 1 kHz: earlier data
/// stays secret even if the memory of one end is stolen.
pub const REKEY_EVERY: u64 = 1 << 20;
/// Largest size of a key file, bytes.
const KEY_FILE: u64 = 4096;

/// Pre-shared key of both ends.
#[derive(Clone, PartialEq, Eq)]
pub struct Key([u8; 32]);

impl fmt::Debug for Key {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Key(..)")
    }
}

/// Reason why a file gives no key.
#[derive(Debug, thiserror::Error)]
pub enum KeyError {
    /// The file cannot be read.
    #[error("cannot read the key {}: {source}; make one with `openssl rand -hex 32 > {} && chmod 600 {}`", .path.display(), .path.display(), .path.display())]
    Read {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// Other users may read the file.
    #[error("other users may read the key {}: `chmod 600 {}`", .0.display(), .0.display())]
    Open(PathBuf),
    /// The file does not hold 64 hex digits.
    #[error("{} holds no key: it must be 64 hex digits, as `openssl rand -hex 32` prints them", .0.display())]
    Form(PathBuf),
}

impl Key {
    /// Makes a key of 32 bytes.
    #[must_use]
    pub const fn new(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    /// Generates a random key.
    ///
    /// # Errors
    /// When the operating system provides no random numbers.
    pub fn random() -> io::Result<Self> {
        let pattern = PATTERN.parse().map_err(broken)?;
        let private = snow::Builder::new(pattern).generate_keypair().map_err(broken)?.private;
        private.try_into().map(Self).map_err(|_| io::Error::other("a private key of another length"))
    }

    /// Reads 64 hex digits from a file that only its owner may access.
    ///
    /// # Errors
    /// [`KeyError`] names the reason.
    pub fn read(path: &Path) -> Result<Self, KeyError> {
        Self::read_while(path, || true)
    }

    /// Reads a key as [`Key::read`] does, also from a pipe: calls `goes_on` every 50 ms and waits for the pipe's writer
    /// while it returns true.
    ///
    /// # Errors
    /// [`KeyError`]; [`KeyError::Read`] with [`io::ErrorKind::Interrupted`] after `goes_on` returned false.
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
            // A pipe or device may never end.
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

    /// Derives a token for a service beside links with this key, such as a page: HMAC-SHA-256 of `purpose` by this key. The
    /// token reveals neither the key nor the token of another purpose.
    #[must_use]
    pub fn token(&self, purpose: &str) -> [u8; 32] {
        self.mac(&[b"r4 token, ", purpose.as_bytes()])
    }

    /// Derives the key of the handshake, HMAC-SHA-256 of this one, so that the same file may serve other purposes too.
    fn of_handshake(&self) -> [u8; 32] {
        self.mac(&[PATTERN.as_bytes(), PROLOGUE])
    }

    fn mac(&self, parts: &[&[u8]]) -> [u8; 32] {
        #[expect(clippy::expect_used, reason = "HMAC takes keys of any length")]
        let mut mac = <Hmac<Sha256> as Mac>::new_from_slice(&self.0).expect("any length");
        parts.iter().for_each(|part| mac.update(part));
        mac.finalize().into_bytes().into()
    }
}

/// Reason why the other end is not trusted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Distrust {
    /// The other end does not have the key.
    #[error("the other end does not have this key: both need the same file")]
    Key,
    /// A record was not made by the other end, or is not the next one.
    #[error("a record was changed, repeated or omitted on the way")]
    Record,
}

impl From<Distrust> for io::Error {
    fn from(distrust: Distrust) -> Self {
        Self::new(io::ErrorKind::PermissionDenied, distrust)
    }
}

/// Role in the handshake: the client sends first, the server answers.
#[derive(Clone, Copy)]
enum Role {
    Client,
    Server,
}

/// Makes one end of the handshake.
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

/// Converts errors that the other end cannot cause: no random numbers, or a pattern that is not built in.
fn broken(error: snow::Error) -> io::Error {
    io::Error::other(error)
}

/// Sends the next handshake message.
async fn say(link: &mut Descriptor, handshake: &mut HandshakeState) -> io::Result<()> {
    let mut message = [0; HANDSHAKE];
    let len = handshake.write_message(&[], &mut message).map_err(broken)?;
    link.write_all(&message[..len]).await
}

/// Receives the next handshake message.
async fn hear(link: &mut Descriptor, handshake: &mut HandshakeState) -> io::Result<()> {
    let mut message = [0; HANDSHAKE];
    match link.read_exact(&mut message).await {
        Ok(()) => {}
        // A peer that does not trust this end closes the link without an answer.
        Err(embedded_io_async::ReadExactError::UnexpectedEof) => return Err(Distrust::Key.into()),
        Err(embedded_io_async::ReadExactError::Other(error)) => return Err(error),
    }
    handshake.read_message(&message, &mut []).map_err(|_| Distrust::Key)?;
    Ok(())
}

/// Runs the client's part of the handshake.
///
/// # Errors
/// Those of the link, and [`Distrust::Key`].
pub async fn client(mut link: Descriptor, key: &Key) -> io::Result<(Receiver, Transmitter)> {
    let mut handshake = end(key, Role::Client)?;
    say(&mut link, &mut handshake).await?;
    hear(&mut link, &mut handshake).await?;
    ends(link, handshake)
}

/// Runs the server's part of the handshake. The client's message proves possession of the key, but may be a recording:
/// only its first record belongs to this connection.
///
/// # Errors
/// Those of the link, and [`Distrust::Key`]: then the server has sent nothing.
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
    // Both halves share the transport state, which holds one key per direction.
    let transport = Arc::new(Mutex::new(handshake.into_transport_mode().map_err(broken)?));
    let sealer = Sealer { transport: transport.clone(), rekey_every };
    Ok((sealer, Opener { transport, rekey_every, part: Vec::new(), failed: false }))
}

/// Sealer: encrypts data into records.
struct Sealer {
    transport: Arc<Mutex<TransportState>>,
    rekey_every: u64,
}

impl Sealer {
    /// Makes a record of at most [`MOST_DATA`] bytes of data.
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

/// Opener: decrypts and verifies records.
struct Opener {
    transport: Arc<Mutex<TransportState>>,
    rekey_every: u64,
    /// Bytes of an incomplete record.
    part: Vec<u8>,
    /// A record failed its verification; no further data is accepted.
    failed: bool,
}

impl Opener {
    /// Returns the data of all records that `bytes` completes.
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
            // The sender changes its key after the same record.
            if transport.receiving_nonce().is_multiple_of(self.rekey_every) {
                transport.rekey_incoming();
            }
            self.part.drain(..2 + size);
        }
        Ok(data)
    }
}

/// Receiving half, in which every byte is verified.
pub struct Receiver {
    link: Descriptor,
    opener: Opener,
    /// Bytes verified but not read yet.
    waiting: Vec<u8>,
}

/// Transmitting half, which encrypts all data.
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

    /// Makes both directions of both ends: the client's, then the server's.
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

    /// Makes the sealer and the opener of one direction.
    fn direction() -> (Sealer, Opener) {
        let [(sealer, _), (_, opener)] = both(REKEY_EVERY);
        (sealer, opener)
    }

    #[test]
    fn keys_are_taken_as_rfc_4231_has_them() {
        // Test case 2 of RFC 4231 has a key of 4 bytes, which zeros at its end do not change (RFC 2104, section 2).
        let mut key = [0; 32];
        key[..4].copy_from_slice(b"Jefe");
        let mut mac = <Hmac<Sha256> as Mac>::new_from_slice(&key).expect("any length");
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

    /// The server answers a repeated first message, but its sender cannot make a record.
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
        /// The data arrives unchanged, also over many key changes.
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
            // A larger length makes the opener wait for more bytes; it never accepts them.
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

        /// A truncated record yields no data, however long the opener waits.
        #[test]
        fn part_of_a_record_is_nothing(data in prop::collection::vec(any::<u8>(), 0..100), at: prop::sample::Index) {
            let (mut sealer, mut opener) = direction();
            let record = sealer.seal(&data).expect("sealed");
            prop_assert_eq!(opener.open(&record[..at.index(record.len())]), Ok(Vec::new()));
        }
    }
}
