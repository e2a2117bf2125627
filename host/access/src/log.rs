//! Log of a guard: its entries, and their file.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, Write},
    path::{Path, PathBuf},
};

use ed25519_dalek::{SigningKey, VerifyingKey};
use serde::{Deserialize, Serialize};

use crate::{
    Basis, CredentialError,
    chain::{Chain, ChainError, Head, Verified, verify},
    credential::{public_digits, public_key, random_key, read_secret, secret_key, write_secret},
    token::{Nonce, TokenError},
};

/// Entry of the log.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
pub struct Entry {
    /// Number of the entry, from 1 on.
    pub number: u64,
    /// Time of the event, Unix ms.
    pub at_ms: u64,
    /// Event with its details.
    #[serde(flatten)]
    pub event: Event,
}

/// Event that the log keeps.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(tag = "event", rename_all = "kebab-case")]
pub enum Event {
    /// The guard began, with a policy.
    Started {
        /// Name of the policy.
        policy: String,
        /// SHA-256 of the policy's text, hex digits.
        digest: String,
        /// Entries that followed the signed head when the log was opened.
        unsigned: u64,
    },
    /// A link presented a valid token.
    Presented {
        /// Number of the link.
        link: u64,
        /// Subject of the token.
        subject: String,
        /// Purpose of the token.
        purpose: String,
        /// Flag of an emergency.
        emergency: bool,
        /// Nonce of the token.
        nonce: Nonce,
        /// Time until which a replay is possible, Unix ms.
        until_ms: u64,
    },
    /// A link presented a token that is not valid.
    Rejected {
        /// Number of the link.
        link: u64,
        /// Reason of the rejection.
        why: TokenError,
    },
    /// A request was granted or denied.
    Decided {
        /// Number of the link.
        link: u64,
        /// Subject of the link's token; empty without a valid one.
        subject: String,
        /// Action of the request.
        action: String,
        /// Resource of the request.
        resource: String,
        /// Facts that decided, one digit each.
        facts: String,
        /// Ground of the grant; absent if the request was denied.
        basis: Option<Basis>,
        /// Number of further decisions alike since the entry that has the first of them; 0 for that.
        repeats: u64,
    },
    /// A link ended.
    Left {
        /// Number of the link.
        link: u64,
    },
}

/// Place where lines of a log go.
pub trait Store {
    /// Appends a line, and puts the head in place of the one before.
    ///
    /// # Errors
    /// The error of the operating system; the guard then grants nothing.
    fn put(&mut self, line: &str, head: &Head) -> io::Result<()>;
}

/// Log in memory, for tests and studies.
#[derive(Clone, Debug, Default)]
pub struct Memory {
    /// Lines so far.
    pub text: String,
    /// Head of these lines; `None` before the first.
    pub head: Option<Head>,
}

impl Store for std::rc::Rc<std::cell::RefCell<Memory>> {
    fn put(&mut self, line: &str, head: &Head) -> io::Result<()> {
        let mut memory = self.borrow_mut();
        memory.text.push_str(line);
        memory.head = Some(head.clone());
        Ok(())
    }
}

/// A log cannot be opened.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// A file of the log cannot be read or written.
    #[error("access log {path}")]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// The log is not as it was written.
    #[error("access log {path} is damaged; keep its files as evidence, and move them away before a new log can begin")]
    Chain {
        /// Path of the log.
        path: PathBuf,
        /// First defect.
        source: ChainError,
    },
    /// The head or the public key has another form.
    #[error("access log: {0} is damaged; keep it as evidence, and see docs/access.md")]
    Damaged(PathBuf),
    /// The key cannot be read or made.
    #[error(transparent)]
    Key(#[from] CredentialError),
}

/// Paths of a log's files, from that of its lines.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Paths {
    /// Lines of the log.
    pub log: PathBuf,
    /// Signed head.
    pub head: PathBuf,
    /// Private key that signs heads.
    pub key: PathBuf,
    /// Public key that verifies heads.
    pub public: PathBuf,
}

impl Paths {
    /// Makes the paths of the files beside a log.
    #[must_use]
    pub fn of(log: &Path) -> Self {
        let beside = |suffix: &str| {
            let mut name = log.as_os_str().to_owned();
            name.push(suffix);
            PathBuf::from(name)
        };
        Self { log: log.to_owned(), head: beside(".head"), key: beside(".key"), public: beside(".pub") }
    }
}

/// Log in files: lines that are appended, and a head that is replaced as a whole.
#[derive(Debug)]
pub struct Files {
    lines: File,
    paths: Paths,
}

/// Log that was opened: its files, key and entries.
#[derive(Debug)]
pub struct Opened {
    /// Files for further lines.
    pub files: Files,
    /// Private key that signs heads.
    pub key: SigningKey,
    /// Verified entries so far.
    pub verified: Verified,
}

impl Files {
    /// Opens a log and verifies it, or begins a new one with a key of its own.
    ///
    /// # Errors
    /// [`LogError`]; a damaged log is not continued.
    pub fn open(log: &Path) -> Result<Opened, LogError> {
        let paths = Paths::of(log);
        let failed = |path: &Path| {
            let path = path.to_owned();
            move |source| LogError::File { path, source }
        };
        let key = match read_secret(&paths.key) {
            // A log whose key is gone is not begun anew: its entries could not be verified any more.
            Err(CredentialError::File { source, .. })
                if source.kind() == io::ErrorKind::NotFound && !paths.head.exists() && !paths.log.exists() =>
            {
                begin(&paths)?
            }
            secret => secret_key(&secret?).ok_or_else(|| LogError::Damaged(paths.key.clone()))?,
        };
        let verified = read(&paths, &key.verifying_key())?;
        let lines = OpenOptions::new().append(true).create(true).open(&paths.log).map_err(failed(&paths.log))?;
        // The first run of a log dies before its head at worst once: the chain then begins at zero.
        Ok(Opened { files: Self { lines, paths }, key, verified })
    }
}

/// Makes the key of a new log, and the head of no lines.
fn begin(paths: &Paths) -> Result<SigningKey, LogError> {
    let key = random_key().map_err(CredentialError::NoRandomness)?;
    let digits = data_encoding::BASE64URL_NOPAD.encode(key.as_bytes());
    let failed = |path: &Path, source| LogError::File { path: path.to_owned(), source };
    write_secret(&paths.key, &digits).map_err(|source| failed(&paths.key, source))?;
    let public = public_digits(&key.verifying_key()) + "\n";
    fs::write(&paths.public, public).map_err(|source| failed(&paths.public, source))?;
    File::create(&paths.log).map_err(|source| failed(&paths.log, source))?;
    replace(&paths.head, &Chain::default().head(&key)).map_err(|source| failed(&paths.head, source))?;
    Ok(key)
}

/// Reads and verifies the lines of a log. The entry whose head was not written before the program was killed is
/// reported as unsigned.
///
/// # Errors
/// [`LogError`].
pub fn read(paths: &Paths, key: &VerifyingKey) -> Result<Verified, LogError> {
    let text =
        |path: &Path| fs::read_to_string(path).map_err(|source| LogError::File { path: path.to_owned(), source });
    let head = serde_json::from_str(&text(&paths.head)?).map_err(|_| LogError::Damaged(paths.head.clone()))?;
    verify(&text(&paths.log)?, &head, key).map_err(|source| LogError::Chain { path: paths.log.clone(), source })
}

/// Reads the public key of a log from its file, or from `digits` that were kept elsewhere.
///
/// # Errors
/// [`LogError`].
pub fn key(paths: &Paths, digits: Option<&str>) -> Result<VerifyingKey, LogError> {
    let read;
    let digits = match digits {
        Some(digits) => digits,
        None => {
            read = fs::read_to_string(&paths.public)
                .map_err(|source| LogError::File { path: paths.public.clone(), source })?;
            read.trim()
        }
    };
    public_key(digits).ok_or_else(|| LogError::Damaged(paths.public.clone()))
}

/// Replaces the head as a whole: a reader sees the old or the new one.
fn replace(path: &Path, head: &Head) -> io::Result<()> {
    let mut text = serde_json::to_string(head).map_err(io::Error::other)?;
    text.push('\n');
    let mut new = path.as_os_str().to_owned();
    new.push(".new");
    fs::write(&new, text)?;
    fs::rename(new, path)
}

impl Store for Files {
    fn put(&mut self, line: &str, head: &Head) -> io::Result<()> {
        // The line first: a head without its line would look like a truncation.
        self.lines.write_all(line.as_bytes())?;
        replace(&self.paths.head, head)
    }
}
