//! Private key of a subject in a file, from which its client makes tokens.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, Write},
    path::{Path, PathBuf},
};

use data_encoding::BASE64URL_NOPAD;
use ed25519_dalek::{SigningKey, VerifyingKey};
use serde::{Deserialize, Serialize};

use crate::token::{Claims, Nonce};

/// Longest name of a subject, policy, role or purpose, bytes.
pub(crate) const MAX_NAME: usize = 40;

/// True for 1 to 40 letters, digits and `.-_@` of ASCII.
pub(crate) fn is_name(text: &str) -> bool {
    let is_of = |byte: u8| byte.is_ascii_alphanumeric() || b".-_@".contains(&byte);
    !text.is_empty() && text.len() <= MAX_NAME && text.bytes().all(is_of)
}

/// Key of the base64url digits that policies have; `None` for other text, and for weak keys.
pub(crate) fn public_key(text: &str) -> Option<VerifyingKey> {
    let bytes: [u8; 32] = BASE64URL_NOPAD.decode(text.as_bytes()).ok()?.try_into().ok()?;
    // Signatures under a key of small order hold for any message.
    VerifyingKey::from_bytes(&bytes).ok().filter(|key| !key.is_weak())
}

/// Digits of a public key, as policies have them.
pub(crate) fn public_digits(key: &VerifyingKey) -> String {
    BASE64URL_NOPAD.encode(key.as_bytes())
}

/// Key that is read from a file or made.
///
/// # Errors
/// The error of the operating system that provides no random numbers.
pub(crate) fn random_key() -> io::Result<SigningKey> {
    let mut secret = [0; 32];
    getrandom::fill(&mut secret).map_err(io::Error::other)?;
    Ok(SigningKey::from_bytes(&secret))
}

/// Private key of a subject, with the claims of the tokens that it signs.
#[derive(Clone, Debug)]
pub struct Credential {
    /// Name of the subject in the policy.
    pub subject: String,
    /// Name of the policy.
    pub policy: String,
    /// Purpose of the requests.
    pub purpose: String,
    /// Life of a token, s.
    pub life_s: u64,
    key: SigningKey,
}

/// Content of a credential's file.
#[derive(Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
struct Content {
    subject: String,
    policy: String,
    purpose: String,
    life_s: u64,
    secret: String,
}

/// A file with a secret cannot be read or written.
#[derive(Debug, thiserror::Error)]
pub enum CredentialError {
    /// The file cannot be read or written.
    #[error("{path}")]
    File {
        /// Path of the file.
        path: PathBuf,
        /// Error of the operating system.
        source: io::Error,
    },
    /// Other users may read the file.
    #[error("other users may read the secret {0}: `chmod 600 {0}`")]
    Open(PathBuf),
    /// The file has another form.
    #[error("{path} is no credential ({why}): make one with `r4 access key`")]
    Form {
        /// Path of the file.
        path: PathBuf,
        /// Reason in words, without any of the secret.
        why: String,
    },
    /// A name that cannot be in a token.
    #[error("`{0}` is no name: use 1 to 40 letters, digits and the characters . - _ @")]
    BadName(String),
    /// The operating system provides no random numbers.
    #[error("cannot make a key: {0}")]
    NoRandomness(io::Error),
}

impl Credential {
    /// Makes a credential with a new key.
    ///
    /// # Errors
    /// [`CredentialError::BadName`]; [`CredentialError::NoRandomness`].
    pub fn make(subject: &str, policy: &str, purpose: &str, life_s: u64) -> Result<Self, CredentialError> {
        let key = random_key().map_err(CredentialError::NoRandomness)?;
        Self::with_key(subject, policy, purpose, life_s, key)
    }

    /// Makes a credential of a key that exists.
    ///
    /// # Errors
    /// [`CredentialError::BadName`].
    pub fn with_key(
        subject: &str,
        policy: &str,
        purpose: &str,
        life_s: u64,
        key: SigningKey,
    ) -> Result<Self, CredentialError> {
        if let Some(bad) = [subject, policy, purpose].into_iter().find(|name| !is_name(name)) {
            return Err(CredentialError::BadName(bad.to_owned()));
        }
        Ok(Self { subject: subject.to_owned(), policy: policy.to_owned(), purpose: purpose.to_owned(), life_s, key })
    }

    /// Reads a credential from a file that only its owner may read.
    ///
    /// # Errors
    /// [`CredentialError`] names the reason.
    pub fn read(path: &Path) -> Result<Self, CredentialError> {
        let form = |why: String| CredentialError::Form { path: path.to_owned(), why };
        let text = read_secret(path)?;
        // The parser's own message would quote the line, which may be the secret.
        let content: Content = toml::from_str(&text).map_err(|error| form(error.message().to_owned()))?;
        let key = secret_key(&content.secret).ok_or_else(|| form("its secret is not 43 digits of base64url".into()))?;
        Self::with_key(&content.subject, &content.policy, &content.purpose, content.life_s, key)
    }

    /// Writes the credential into a new file that only its owner may read.
    ///
    /// # Errors
    /// [`CredentialError::File`], also if the file exists.
    pub fn write(&self, path: &Path) -> Result<(), CredentialError> {
        let content = Content {
            subject: self.subject.clone(),
            policy: self.policy.clone(),
            purpose: self.purpose.clone(),
            life_s: self.life_s,
            secret: BASE64URL_NOPAD.encode(self.key.as_bytes()),
        };
        let failed = |source| CredentialError::File { path: path.to_owned(), source };
        let text = toml::to_string(&content).map_err(|error| failed(io::Error::other(error)))?;
        write_secret(path, &text).map_err(failed)
    }

    /// Public key, as a policy's `[[subject]]` has it.
    #[must_use]
    pub fn public_key(&self) -> String {
        public_digits(&self.key.verifying_key())
    }

    /// Private key that signs the tokens.
    #[must_use]
    pub const fn signing_key(&self) -> &SigningKey {
        &self.key
    }

    /// Makes a token with a new nonce that is valid from `now_ms` on, Unix ms.
    ///
    /// # Errors
    /// [`CredentialError::NoRandomness`].
    pub fn token(&self, is_emergency: bool, now_ms: u64) -> Result<String, CredentialError> {
        let nonce = Nonce::random().map_err(CredentialError::NoRandomness)?;
        Ok(self.claims(is_emergency, nonce, now_ms).sign(&self.key))
    }

    /// Claims of a token with this nonce.
    #[must_use]
    pub fn claims(&self, is_emergency: bool, nonce: Nonce, now_ms: u64) -> Claims {
        Claims {
            subject: self.subject.clone(),
            policy: self.policy.clone(),
            purpose: self.purpose.clone(),
            emergency: is_emergency,
            not_before_ms: now_ms,
            expires_ms: now_ms.saturating_add(self.life_s.saturating_mul(1000)),
            nonce,
        }
    }
}

/// Key of the digits of a secret.
pub(crate) fn secret_key(digits: &str) -> Option<SigningKey> {
    let bytes: [u8; 32] = BASE64URL_NOPAD.decode(digits.trim().as_bytes()).ok()?.try_into().ok()?;
    Some(SigningKey::from_bytes(&bytes))
}

/// Reads a file with a secret, which only its owner may read.
pub(crate) fn read_secret(path: &Path) -> Result<String, CredentialError> {
    let failed = |source| CredentialError::File { path: path.to_owned(), source };
    let file = File::open(path).map_err(failed)?;
    if is_open_to_others(&file.metadata().map_err(failed)?) {
        return Err(CredentialError::Open(path.to_owned()));
    }
    io::read_to_string(file).map_err(failed)
}

/// Writes a secret into a new file that only its owner may read.
pub(crate) fn write_secret(path: &Path, text: &str) -> io::Result<()> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true);
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::mode(&mut options, 0o600);
    let mut file = options.open(path)?;
    file.write_all(text.as_bytes())?;
    file.sync_all()
}

/// Returns true if group or others have any permission. As `r4-links` judges the file of a link's key; a copy, because this crate
/// depends on no other of the project.
#[cfg(unix)]
fn is_open_to_others(metadata: &fs::Metadata) -> bool {
    std::os::unix::fs::PermissionsExt::mode(&metadata.permissions()) & 0o077 != 0
}

/// Windows has no mode to check: a user's own folder is closed to others.
#[cfg(not(unix))]
fn is_open_to_others(_: &fs::Metadata) -> bool {
    false
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_credential_is_read_as_it_was_written() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("alice.toml");
        let made = Credential::make("alice", "ward-3", "operation", 60).expect("made");
        made.write(&path).expect("written");
        let read = Credential::read(&path).expect("read");
        assert_eq!((read.public_key(), &read.subject, read.life_s), (made.public_key(), &made.subject, 60));
        assert!(public_key(&read.public_key()).is_some());
        // An existing key is not overwritten.
        assert!(matches!(made.write(&path), Err(CredentialError::File { .. })));
        assert!(matches!(Credential::make("al ice", "p", "q", 60), Err(CredentialError::BadName(_))));
    }

    #[test]
    #[cfg(unix)]
    fn a_secret_that_others_may_read_is_refused() {
        use std::os::unix::fs::PermissionsExt;
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("alice.toml");
        Credential::make("alice", "ward-3", "operation", 60).expect("made").write(&path).expect("written");
        fs::set_permissions(&path, fs::Permissions::from_mode(0o640)).expect("set");
        assert!(matches!(Credential::read(&path), Err(CredentialError::Open(_))));
    }

    #[test]
    fn weak_and_malformed_keys_are_none() {
        // The neutral element and a point of order 8: Bernstein et al., "Ed25519 for ..., small order".
        for bytes in [[0; 32], {
            let mut one = [0; 32];
            one[0] = 1;
            one
        }] {
            assert!(public_key(&BASE64URL_NOPAD.encode(&bytes)).is_none());
        }
        assert!(public_key("").is_none() && public_key("abc").is_none());
    }

    #[test]
    fn an_error_does_not_quote_the_secret() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("bad.toml");
        write_secret(&path, "secret = \"TOPSECRET\nsubject = 3\n").expect("written");
        let error = Credential::read(&path).expect_err("malformed").to_string();
        assert!(error.contains("r4 access key") && !error.contains("TOPSECRET"), "{error}");
    }
}
