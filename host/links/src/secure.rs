//! A byte link on which both ends know that the other has the same key, and that every byte is the other's.
//!
//! For boards that are served to other machines. Nothing is hidden: what is told can be read on the way, but not changed,
//! repeated, reordered or made up.
//!
//! The server speaks first and says a number used once, nothing else. The client answers with a number of its own and a
//! proof; only then does the server prove itself:
//!
//! ```text
//! server: nonce s, 16 bytes
//! client: nonce c, 16 bytes; HMAC(key, "r4 client" s c), 16 bytes
//! server: HMAC(key, "r4 server" s c), 16 bytes
//! ```
//!
//! Then each direction is records, under a key of its own, HMAC(key, "r4 to server" s c) or HMAC(key, "r4 to client" s c):
//!
//! ```text
//! length of the data, 2 bytes, least significant first | data | HMAC(direction's key, number of the record, 8 bytes | length | data), 16 bytes
//! ```
//!
//! HMAC is that of RFC 2104 with SHA-256, its first 16 bytes. Records are numbered from 0 and come in order on TCP, so the
//! number need not travel, and a record that is repeated or left out fails. Both nonces are in every key: records of another
//! connection fail too.

use std::{
    fmt, fs, io,
    os::unix::fs::PermissionsExt,
    path::{Path, PathBuf},
};

use embedded_io_async::{ErrorType, Read, Write};
use hmac::{Hmac, KeyInit, Mac};
use sha2::Sha256;

use crate::Descriptor;

/// Bytes of a nonce.
const NONCE: usize = 16;
/// Bytes of a proof and of a record's end.
const TAG: usize = 16;
/// Most data of a record: two frames of the protocol.
const MOST_DATA: usize = 512;

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

    /// Reads 64 hex digits from a file that only its owner may read.
    ///
    /// # Errors
    /// [`KeyError`]
    pub fn read(path: &Path) -> Result<Self, KeyError> {
        let failed = |source| KeyError::Read { path: path.to_owned(), source };
        if fs::metadata(path).map_err(failed)?.permissions().mode() & 0o077 != 0 {
            return Err(KeyError::Open(path.to_owned()));
        }
        let text = fs::read_to_string(path).map_err(failed)?;
        Self::from_hex(text.trim()).ok_or_else(|| KeyError::Form(path.to_owned()))
    }

    fn from_hex(text: &str) -> Option<Self> {
        let digits: Vec<u8> = text.chars().map(|digit| Some(digit.to_digit(16)? as u8)).collect::<Option<_>>()?;
        let bytes: Vec<u8> = digits.chunks_exact(2).map(|pair| pair[0] << 4 | pair[1]).collect();
        (digits.len() == 64).then(|| bytes.try_into().ok()).flatten().map(Self)
    }

    fn over(&self, parts: &[&[u8]]) -> Hmac<Sha256> {
        #[expect(clippy::expect_used, reason = "HMAC takes keys of any length")]
        let mut mac = <Hmac<Sha256> as KeyInit>::new_from_slice(&self.0).expect("any length");
        parts.iter().for_each(|part| mac.update(part));
        mac
    }

    fn tag(&self, parts: &[&[u8]]) -> [u8; TAG] {
        let mut tag = [0; TAG];
        tag.copy_from_slice(&self.over(parts).finalize().into_bytes()[..TAG]);
        tag
    }

    /// In a time that tells nothing about where they differ.
    fn verifies(&self, parts: &[&[u8]], tag: &[u8]) -> bool {
        tag.len() == TAG && self.over(parts).verify_truncated_left(tag).is_ok()
    }

    fn derived(&self, parts: &[&[u8]]) -> Self {
        Self(self.over(parts).finalize().into_bytes().into())
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

/// What both directions are derived from.
struct Nonces {
    server: [u8; NONCE],
    client: [u8; NONCE],
}

impl Nonces {
    fn tag(&self, key: &Key, what: &str) -> [u8; TAG] {
        key.tag(&[what.as_bytes(), &self.server, &self.client])
    }

    fn proved(&self, key: &Key, what: &str, tag: &[u8]) -> Result<(), Distrust> {
        if key.verifies(&[what.as_bytes(), &self.server, &self.client], tag) { Ok(()) } else { Err(Distrust::Key) }
    }

    fn directions(&self, key: &Key) -> (Key, Key) {
        let derived = |what: &str| key.derived(&[what.as_bytes(), &self.server, &self.client]);
        (derived("r4 to server"), derived("r4 to client"))
    }
}

fn nonce() -> io::Result<[u8; NONCE]> {
    let mut nonce = [0; NONCE];
    getrandom::fill(&mut nonce).map_err(|error| io::Error::other(error.to_string()))?;
    Ok(nonce)
}

async fn read_exact<R: Read<Error = io::Error>, const N: usize>(rx: &mut R) -> io::Result<[u8; N]> {
    let mut bytes = [0; N];
    match rx.read_exact(&mut bytes).await {
        Ok(()) => Ok(bytes),
        // Whoever does not trust us says nothing.
        Err(embedded_io_async::ReadExactError::UnexpectedEof) => Err(Distrust::Key.into()),
        Err(embedded_io_async::ReadExactError::Other(error)) => Err(error),
    }
}

/// The client's part of the greeting.
///
/// # Errors
/// The link's, and [`Distrust::Key`].
pub async fn client(mut link: Descriptor, key: &Key) -> io::Result<(Receiver, Transmitter)> {
    let nonces = Nonces { server: read_exact(&mut link).await?, client: nonce()? };
    let mut answer = nonces.client.to_vec();
    answer.extend(nonces.tag(key, "r4 client"));
    link.write_all(&answer).await?;
    let proof: [u8; TAG] = read_exact(&mut link).await?;
    nonces.proved(key, "r4 server", &proof)?;
    let (to_server, to_client) = nonces.directions(key);
    Ok((Receiver::new(link.clone(), to_client), Transmitter::new(link, to_server)))
}

/// The server's part of the greeting.
///
/// # Errors
/// The link's, and [`Distrust::Key`]: then nothing was told but a nonce.
pub async fn server(mut link: Descriptor, key: &Key) -> io::Result<(Receiver, Transmitter)> {
    let server = nonce()?;
    link.write_all(&server).await?;
    let nonces = Nonces { server, client: read_exact(&mut link).await? };
    let proof: [u8; TAG] = read_exact(&mut link).await?;
    nonces.proved(key, "r4 client", &proof)?;
    link.write_all(&nonces.tag(key, "r4 server")).await?;
    let (to_server, to_client) = nonces.directions(key);
    Ok((Receiver::new(link.clone(), to_server), Transmitter::new(link, to_client)))
}

/// Makes records.
struct Sealer {
    key: Key,
    number: u64,
}

impl Sealer {
    fn seal(&mut self, data: &[u8]) -> Vec<u8> {
        let len = (data.len() as u16).to_le_bytes();
        let tag = self.key.tag(&[&self.number.to_le_bytes(), &len, data]);
        self.number += 1;
        [&len[..], data, &tag].concat()
    }
}

/// Takes records apart.
struct Opener {
    key: Key,
    number: u64,
    /// Of a record that is not whole yet.
    part: Vec<u8>,
}

impl Opener {
    /// The data of the records that are whole now.
    fn open(&mut self, bytes: &[u8]) -> Result<Vec<u8>, Distrust> {
        self.part.extend_from_slice(bytes);
        let mut data = Vec::new();
        while let Some((len, rest)) = self.part.split_first_chunk::<2>() {
            let size = usize::from(u16::from_le_bytes(*len));
            if size > MOST_DATA {
                return Err(Distrust::Record);
            }
            let (Some(record), Some(tag)) = (rest.get(..size), rest.get(size..size + TAG)) else { break };
            if !self.key.verifies(&[&self.number.to_le_bytes(), len, record], tag) {
                return Err(Distrust::Record);
            }
            data.extend_from_slice(record);
            self.number += 1;
            self.part.drain(..2 + size + TAG);
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

impl Receiver {
    fn new(link: Descriptor, key: Key) -> Self {
        Self { link, opener: Opener { key, number: 0, part: Vec::new() }, waiting: Vec::new() }
    }
}

impl Transmitter {
    fn new(link: Descriptor, key: Key) -> Self {
        Self { link, sealer: Sealer { key, number: 0 } }
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
        let record = self.sealer.seal(&bytes[..len]);
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

    fn both() -> (Sealer, Opener) {
        let key = Key::new([7; 32]);
        (Sealer { key: key.clone(), number: 0 }, Opener { key, number: 0, part: Vec::new() })
    }

    #[test]
    fn tags_are_those_of_rfc_4231() {
        // Its test case 1: a key of 20 bytes, which zeros at its end do not change (RFC 2104, section 2).
        let mut key = [0; 32];
        key[..20].fill(0x0b);
        let tag = Key::new(key).tag(&[b"Hi ", b"There"]);
        assert_eq!(
            tag,
            [0xb0, 0x34, 0x4c, 0x61, 0xd8, 0xdb, 0x38, 0x53, 0x5c, 0xa8, 0xaf, 0xce, 0xaf, 0x0b, 0xf1, 0x2b]
        );
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
        #[test]
        fn records_carry_what_was_sent(parts in prop::collection::vec(prop::collection::vec(any::<u8>(), 0..=MOST_DATA), 1..5), cut in 1_usize..50) {
            let (mut sealer, mut opener) = both();
            let sent: Vec<u8> = parts.iter().flat_map(|part| sealer.seal(part)).collect();
            let received: Vec<u8> = sent.chunks(cut).flat_map(|piece| opener.open(piece).expect("untouched")).collect();
            prop_assert_eq!(received, parts.concat());
        }

        #[test]
        fn nothing_that_was_touched_is_taken(data in prop::collection::vec(any::<u8>(), 1..100), at: prop::sample::Index, bit in 0..8) {
            let (mut sealer, mut opener) = both();
            let mut record = sealer.seal(&data);
            let at = at.index(record.len());
            record[at] ^= 1_u8 << bit;
            // What looks longer is waited for; what is waited for is never taken.
            prop_assert!(opener.open(&record).is_ok_and(|data| data.is_empty()) || opener.number == 0);
            prop_assert_eq!(opener.number, 0);
        }

        #[test]
        fn a_record_is_taken_once_and_in_its_turn(data in prop::collection::vec(any::<u8>(), 1..50)) {
            let (mut sealer, mut opener) = both();
            let (first, second) = (sealer.seal(&data), sealer.seal(&data));
            let mut skipping = both().1;
            prop_assert_eq!(skipping.open(&second), Err(Distrust::Record));
            prop_assert!(opener.open(&first).is_ok());
            prop_assert_eq!(opener.open(&first), Err(Distrust::Record));
        }
    }
}
