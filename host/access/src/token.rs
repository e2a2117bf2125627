//! Tokens: claims of a subject, signed by its key.
//!
//! A token is text without spaces: `r4-token-1.CLAIMS.SIGNATURE`, both parts in base64url. The claims are JSON; the
//! Ed25519 signature (RFC 8032) is over a prefix of its own and the bytes of the claims as they stand.

use std::{fmt, io};

use data_encoding::{BASE64URL_NOPAD, HEXLOWER};
use ed25519_dalek::{Signature, Signer, SigningKey, VerifyingKey};
use serde::{Deserialize, Serialize};

/// Beginning of each token.
pub(crate) const MAGIC: &str = "r4-token-1.";
/// Longest token, bytes: names of 40 bytes give 500, and the rest is room for longer numbers.
pub(crate) const MAX_TOKEN: usize = 640;
/// Prefix of the signed bytes, so that a signature holds for nothing but a token.
const SIGNED_AS: &[u8] = b"r4 access token 1\0";

/// Random number that makes a token one of a kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Deserialize, Serialize)]
#[serde(try_from = "String", into = "String")]
pub struct Nonce([u8; 16]);

impl Nonce {
    /// Makes a random nonce. The chance of two alike among 2^32 tokens is below 2^-64.
    ///
    /// # Errors
    /// When the operating system provides no random numbers.
    pub fn random() -> io::Result<Self> {
        let mut bytes = [0; 16];
        getrandom::fill(&mut bytes).map_err(io::Error::other)?;
        Ok(Self(bytes))
    }
}

impl From<[u8; 16]> for Nonce {
    fn from(bytes: [u8; 16]) -> Self {
        Self(bytes)
    }
}

impl fmt::Display for Nonce {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&HEXLOWER.encode(&self.0))
    }
}

impl From<Nonce> for String {
    fn from(nonce: Nonce) -> Self {
        nonce.to_string()
    }
}

impl TryFrom<String> for Nonce {
    type Error = &'static str;

    fn try_from(text: String) -> Result<Self, &'static str> {
        let bytes = HEXLOWER.decode(text.as_bytes()).ok().and_then(|bytes| bytes.try_into().ok());
        bytes.map(Self).ok_or("a nonce is 32 hex digits")
    }
}

/// Claims of a token.
#[derive(Clone, Debug, PartialEq, Eq, Deserialize, Serialize)]
#[serde(deny_unknown_fields)]
pub struct Claims {
    /// Name of the subject, whose key signs.
    pub subject: String,
    /// Name of the policy for which the token is made.
    pub policy: String,
    /// Purpose of the requests.
    pub purpose: String,
    /// Declaration of an emergency.
    pub emergency: bool,
    /// Begin of validity on the client's clock, Unix ms.
    pub not_before_ms: u64,
    /// End of validity on the client's clock, Unix ms.
    pub expires_ms: u64,
    /// Number that makes the token one of a kind.
    pub nonce: Nonce,
}

/// Reason why a token is not accepted: for the log, not for the client.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error, Deserialize, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum TokenError {
    /// The text has another form.
    #[error("no token of this version")]
    Malformed,
    /// The policy has no such subject.
    #[error("the policy has no such subject")]
    UnknownSubject,
    /// The signature is not that of the subject's key over these claims.
    #[error("wrong signature")]
    WrongSignature,
    /// The token is made for another policy.
    #[error("made for another policy")]
    OtherPolicy,
    /// The token lives longer than the policy allows, or ends before it begins.
    #[error("its life is longer than the policy allows")]
    TooLong,
    /// The validity has not begun, by more than the allowance for clocks.
    #[error("not valid yet: the client's clock is ahead")]
    NotYet,
    /// The validity is over, by more than the allowance for clocks.
    #[error("expired")]
    Expired,
    /// The nonce came before.
    #[error("presented before")]
    Replayed,
    /// The subject has too many valid tokens.
    #[error("too many valid tokens of this subject")]
    TooMany,
}

impl Claims {
    /// Signs the claims. Returns the token.
    #[must_use]
    pub fn sign(&self, key: &SigningKey) -> String {
        // Claims are plain data: JSON of them cannot fail.
        let claims = serde_json::to_vec(self).unwrap_or_default();
        let signature = key.sign(&signed(&claims));
        format!("{MAGIC}{}.{}", BASE64URL_NOPAD.encode(&claims), BASE64URL_NOPAD.encode(&signature.to_bytes()))
    }

    /// Reads a token and checks its signature with the key that `key_of` returns for its subject.
    ///
    /// # Errors
    /// [`TokenError::Malformed`], [`TokenError::UnknownSubject`] and [`TokenError::WrongSignature`].
    pub fn verified(token: &str, key_of: impl FnOnce(&str) -> Option<VerifyingKey>) -> Result<Self, TokenError> {
        let (claims, signature) = parts(token).ok_or(TokenError::Malformed)?;
        // Nothing in the claims counts before the signature holds, except the name of the key.
        let read: Self = serde_json::from_slice(&claims).map_err(|_| TokenError::Malformed)?;
        let key = key_of(&read.subject).ok_or(TokenError::UnknownSubject)?;
        key.verify_strict(&signed(&claims), &signature).map_err(|_| TokenError::WrongSignature)?;
        Ok(read)
    }

    /// Checks the policy's name and the times of validity. `skew_ms` is the allowance for clocks.
    ///
    /// # Errors
    /// [`TokenError::OtherPolicy`], [`TokenError::TooLong`] and those of [`Claims::check_now`].
    pub fn check(&self, policy: &str, life_ms: u64, skew_ms: u64, now_ms: u64) -> Result<(), TokenError> {
        if self.policy != policy {
            return Err(TokenError::OtherPolicy);
        }
        if self.expires_ms.checked_sub(self.not_before_ms).is_none_or(|life| life > life_ms) {
            return Err(TokenError::TooLong);
        }
        self.check_now(skew_ms, now_ms)
    }

    /// Checks that `now_ms` is within the validity, widened by `skew_ms` on both sides.
    ///
    /// # Errors
    /// [`TokenError::NotYet`] and [`TokenError::Expired`].
    pub fn check_now(&self, skew_ms: u64, now_ms: u64) -> Result<(), TokenError> {
        if now_ms.saturating_add(skew_ms) < self.not_before_ms {
            return Err(TokenError::NotYet);
        }
        if now_ms >= self.expires_ms.saturating_add(skew_ms) {
            return Err(TokenError::Expired);
        }
        Ok(())
    }
}

/// Claims and signature of a token's text.
fn parts(token: &str) -> Option<(Vec<u8>, Signature)> {
    if token.len() > MAX_TOKEN {
        return None;
    }
    let (claims, signature) = token.strip_prefix(MAGIC)?.split_once('.')?;
    let signature: [u8; 64] = BASE64URL_NOPAD.decode(signature.as_bytes()).ok()?.try_into().ok()?;
    Some((BASE64URL_NOPAD.decode(claims.as_bytes()).ok()?, Signature::from_bytes(&signature)))
}

fn signed(claims: &[u8]) -> Vec<u8> {
    [SIGNED_AS, claims].concat()
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn claims() -> impl Strategy<Value = Claims> {
        let name = "[a-zA-Z0-9.@_-]{1,40}";
        (name, name, name, any::<(bool, u64, u64, [u8; 16])>()).prop_map(|(subject, policy, purpose, rest)| {
            let (emergency, not_before_ms, expires_ms, nonce) = rest;
            Claims { subject, policy, purpose, emergency, not_before_ms, expires_ms, nonce: nonce.into() }
        })
    }

    proptest! {
        #[test]
        fn a_token_is_read_as_it_was_signed(claims in claims(), secret in any::<[u8; 32]>()) {
            let key = SigningKey::from_bytes(&secret);
            let token = claims.sign(&key);
            prop_assert!(token.len() <= MAX_TOKEN && token.bytes().all(|byte| byte > b' '), "{}", token);
            prop_assert_eq!(Claims::verified(&token, |_| Some(key.verifying_key())), Ok(claims));
        }

        #[test]
        fn an_altered_byte_is_found(
            claims in claims(), secret in any::<[u8; 32]>(), place in any::<prop::sample::Index>(), byte in any::<u8>(),
        ) {
            let key = SigningKey::from_bytes(&secret);
            let token = claims.sign(&key);
            let mut altered = token.clone().into_bytes();
            let place = place.index(altered.len());
            altered[place] = byte;
            let Ok(altered) = String::from_utf8(altered) else { return Ok(()) };
            prop_assert_eq!(Claims::verified(&altered, |_| Some(key.verifying_key())).is_ok(), altered == token);
        }

        #[test]
        fn any_text_is_refused_without_a_panic(text in ".{0,80}") {
            let key = SigningKey::from_bytes(&[7; 32]).verifying_key();
            for text in [text.clone(), format!("{MAGIC}{text}"), format!("{MAGIC}{text}.{text}")] {
                prop_assert!(Claims::verified(&text, |_| Some(key)).is_err());
            }
        }

        /// Clocks that differ by up to the allowance, in both directions, at both ends of the validity.
        #[test]
        fn clocks_may_differ_by_the_allowance(skew_ms in 0_u64..60_000, error_ms in -120_000_i64..120_000) {
            let (client_ms, life_ms) = (1_795_824_000_000_u64, 300_000);
            let times = |claims: Claims| Claims { not_before_ms: client_ms, expires_ms: client_ms + life_ms, ..claims };
            let claims = times(Claims {
                subject: "a".into(), policy: "p".into(), purpose: "q".into(), emergency: false,
                not_before_ms: 0, expires_ms: 0, nonce: [0; 16].into(),
            });
            let check = |now_ms: u64| claims.check("p", life_ms, skew_ms, now_ms);
            // The guard's clock at the moments when the client's shows the begin and the end.
            let (begin, end) = (client_ms.saturating_add_signed(error_ms), (client_ms + life_ms).saturating_add_signed(error_ms));
            prop_assert_eq!(check(begin) == Err(TokenError::NotYet), error_ms < 0 && error_ms.unsigned_abs() > skew_ms);
            prop_assert_eq!(check(end) == Err(TokenError::Expired), error_ms >= 0 && error_ms.unsigned_abs() >= skew_ms);
        }
    }

    /// Test 1 of RFC 8032, section 7.1, so that the keys are those of other programs.
    #[test]
    fn keys_are_those_of_the_standard() {
        let secret = HEXLOWER.decode(b"9d61b19deffd5a60ba844af492ec2cc44449c5697b326919703bac031cae7f60").expect("hex");
        let public = HEXLOWER.decode(b"d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a").expect("hex");
        let key = SigningKey::from_bytes(&secret.try_into().expect("32 bytes"));
        assert_eq!(key.verifying_key().as_bytes()[..], public);
    }

    #[test]
    fn claims_with_other_fields_are_malformed() {
        let key = SigningKey::from_bytes(&[3; 32]);
        let claims = br#"{"subject":"a","policy":"p","purpose":"q","emergency":false,"not_before_ms":0,"expires_ms":1,"nonce":"00000000000000000000000000000000","role":"admin"}"#;
        let signature = BASE64URL_NOPAD.encode(&key.sign(&signed(claims)).to_bytes());
        let token = format!("{MAGIC}{}.{signature}", BASE64URL_NOPAD.encode(claims));
        assert_eq!(Claims::verified(&token, |_| Some(key.verifying_key())), Err(TokenError::Malformed));
    }
}
