//! Hash chain of the log: lines of JSON, a signed head beside them, and their verification.
//!
//! A line is `{"hash":"HEX","entry":ENTRY}`. Its hash is SHA-256 over the hash of the line before and the bytes of the
//! entry as they stand; the first line follows 32 zero bytes. The [`Head`] has the number of lines and the last hash,
//! signed, so that missing lines at the end are detected too.

use data_encoding::{BASE64URL_NOPAD, HEXLOWER};
use ed25519_dalek::{Signature, Signer, SigningKey, VerifyingKey};
use serde::{Deserialize, Serialize};
use sha2::{Digest as _, Sha256};

use crate::log::Entry;

/// Text around the hash and the entry of a line.
const PARTS: [&str; 3] = [r#"{"hash":""#, r#"","entry":"#, "}"];
/// Number of hex digits of a hash.
const DIGITS: usize = 64;
/// Prefix of the signed bytes of a head.
const SIGNED_AS: &[u8] = b"r4 access log head 1\0";

/// SHA-256 of a line and all lines before it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Link([u8; 32]);

impl Link {
    fn next(self, entry: &str) -> Self {
        Self(Sha256::new().chain_update(self.0).chain_update(entry.as_bytes()).finalize().into())
    }
}

/// Head of a log: number of its lines and hash of the last, signed by the log's key.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Head {
    /// Number of lines.
    pub count: u64,
    /// Hash of the last line, 64 hex digits.
    pub hash: String,
    /// Ed25519 signature of both, base64url.
    pub signature: String,
}

impl Head {
    fn signed(count: u64, link: Link) -> Vec<u8> {
        [SIGNED_AS, &count.to_le_bytes(), &link.0].concat()
    }

    /// Hash of the last line, if the signature is that of `key`.
    fn verified(&self, key: &VerifyingKey) -> Option<Link> {
        let hash: [u8; 32] = HEXLOWER.decode(self.hash.as_bytes()).ok()?.try_into().ok()?;
        let signature: [u8; 64] = BASE64URL_NOPAD.decode(self.signature.as_bytes()).ok()?.try_into().ok()?;
        let signed = Self::signed(self.count, Link(hash));
        key.verify_strict(&signed, &Signature::from_bytes(&signature)).ok().map(|()| Link(hash))
    }
}

/// End of a chain, to which lines are added.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Chain {
    /// Number of lines so far.
    pub(crate) count: u64,
    link: Link,
}

impl Chain {
    /// Adds an entry. Returns its line with the newline.
    pub(crate) fn add(&mut self, entry: &Entry) -> String {
        // Entries are plain data: JSON of them cannot fail.
        let text = serde_json::to_string(entry).unwrap_or_default();
        self.link = self.link.next(&text);
        self.count += 1;
        format!("{}{}{}{text}{}\n", PARTS[0], HEXLOWER.encode(&self.link.0), PARTS[1], PARTS[2])
    }

    /// Signs the head of the chain as it is now.
    pub(crate) fn head(&self, key: &SigningKey) -> Head {
        let signature = key.sign(&Head::signed(self.count, self.link));
        Head {
            count: self.count,
            hash: HEXLOWER.encode(&self.link.0),
            signature: BASE64URL_NOPAD.encode(&signature.to_bytes()),
        }
    }
}

/// Defect of a log.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ChainError {
    /// A line has another form.
    #[error("line {line} is no line of an access log: it was altered, or the file is another")]
    Malformed {
        /// Line number, from 1 on.
        line: u64,
    },
    /// A line has another number than its place.
    #[error("line {line} has the number {found}: entries were removed, repeated or moved")]
    Misplaced {
        /// Line number, from 1 on.
        line: u64,
        /// Number in the entry.
        found: u64,
    },
    /// A hash is not that of the line and of those before it.
    #[error("line {line} does not follow from the lines before it: an entry was altered, removed or moved")]
    Altered {
        /// Line number, from 1 on.
        line: u64,
    },
    /// The head is not signed by the log's key, or has another form.
    #[error("the head is not signed by the log's key: it was altered, or this is the key of another log")]
    BadHead,
    /// Entries are missing at the end.
    #[error("the log has {lines} entries, its signed head {signed}: the last {} were cut off", signed - lines)]
    Truncated {
        /// Lines of the log.
        lines: u64,
        /// Lines by the head.
        signed: u64,
    },
    /// The line that the head names has another hash.
    #[error("entry {count} is not the one that the head was signed for: the log was replaced")]
    Replaced {
        /// Number of lines by the head.
        count: u64,
    },
    /// Entries after the signed head.
    #[error(
        "{extra} entries follow the signed head: the program was killed between both writes (at most one), or somebody \
         appended them"
    )]
    Unsigned {
        /// Number of entries behind the head.
        extra: u64,
    },
}

/// Verified log; the default is a log without entries.
#[derive(Clone, Debug, Default)]
pub struct Verified {
    /// Entries in their order.
    pub entries: Vec<Entry>,
    /// End of the chain.
    pub chain: Chain,
    /// Entries behind the signed head.
    pub unsigned: u64,
}

impl Verified {
    /// Requires that the head covers all entries.
    ///
    /// # Errors
    /// [`ChainError::Unsigned`].
    pub fn complete(self) -> Result<Self, ChainError> {
        if self.unsigned == 0 { Ok(self) } else { Err(ChainError::Unsigned { extra: self.unsigned }) }
    }
}

/// Verifies a log against its head and the log's public key. An older head of the same log, kept elsewhere, verifies too:
/// the entries after it count as unsigned then.
///
/// # Errors
/// [`ChainError`]: the first defect.
pub fn verify(text: &str, head: &Head, key: &VerifyingKey) -> Result<Verified, ChainError> {
    let signed = head.verified(key).ok_or(ChainError::BadHead)?;
    let (mut chain, mut entries) = (Chain::default(), Vec::new());
    let mut at_head = (head.count == 0).then_some(Link::default());
    for (line, number) in text.split_terminator('\n').zip(1..) {
        let malformed = ChainError::Malformed { line: number };
        let (hash, text) = split(line).ok_or(malformed.clone())?;
        let entry: Entry = serde_json::from_str(text).map_err(|_| malformed)?;
        if entry.number != number {
            return Err(ChainError::Misplaced { line: number, found: entry.number });
        }
        let link = chain.link.next(text);
        if hash != HEXLOWER.encode(&link.0) {
            return Err(ChainError::Altered { line: number });
        }
        chain = Chain { count: number, link };
        if number == head.count {
            at_head = Some(link);
        }
        entries.push(entry);
    }
    match at_head {
        None => Err(ChainError::Truncated { lines: chain.count, signed: head.count }),
        Some(link) if link != signed => Err(ChainError::Replaced { count: head.count }),
        // A last line without its newline was cut within it.
        Some(_) if !text.is_empty() && !text.ends_with('\n') => Err(ChainError::Malformed { line: chain.count }),
        Some(_) => Ok(Verified { entries, chain, unsigned: chain.count - head.count }),
    }
}

/// Hash and entry of a line.
fn split(line: &str) -> Option<(&str, &str)> {
    let (hash, rest) = line.strip_prefix(PARTS[0])?.split_at_checked(DIGITS)?;
    Some((hash, rest.strip_prefix(PARTS[1])?.strip_suffix(PARTS[2])?))
}

#[cfg(test)]
mod tests;
