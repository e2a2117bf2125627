//! Access to the page and its use: pure checks of a request's head and of a token.
//!
//! | against | how |
//! | --- | --- |
//! | another machine, without a key | the program listens on this machine alone |
//! | a page of another site that opens a socket or posts here | its `Origin` is another than the `Host`; it cannot read the token, which is in the page or only in the address of those who have the key |
//! | a name of another site that resolves to this machine (DNS rebinding) | without a key, `Host` must be an address of this machine or `localhost` |
//! | guessing a token | 256 bits, compared in constant time |
//!
//! Not hidden from the network: HTTP is not encrypted. Who reads it has the token, not the key that the token was made of.

use std::{fmt, net::IpAddr};

use data_encoding::HEXLOWER_PERMISSIVE;
use subtle::ConstantTimeEq;

use crate::http::Head;

/// Field with the token in a request that is posted. Other sites cannot send it: browsers ask first, and are not allowed.
pub const TOKEN_FIELD: &str = "x-r4-token";

/// Secret that the page must know to be served: 32 bytes, 64 hex digits in texts.
#[derive(Clone)]
pub struct Token([u8; 32]);

impl fmt::Debug for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("Token(..)")
    }
}

impl Token {
    /// A token of 32 bytes.
    #[must_use]
    pub const fn new(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    /// As the page has it.
    #[must_use]
    pub fn hex(&self) -> String {
        HEXLOWER_PERMISSIVE.encode(&self.0)
    }

    /// Returns true if `text` is this token, in a time that does not depend on where they differ.
    #[must_use]
    pub fn is(&self, text: &str) -> bool {
        HEXLOWER_PERMISSIVE.decode(text.trim().as_bytes()).is_ok_and(|bytes| self.0[..].ct_eq(&bytes[..]).into())
    }
}

/// Why a request is denied.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Denied {
    /// The request does not say where it goes.
    #[error("the request names no host")]
    NoHost,
    /// The request goes to another name than this machine's own.
    #[error(
        "the page is served as 127.0.0.1 and localhost, not as {host}: give r4 serve a --key to serve it under other names"
    )]
    ForeignHost {
        /// As the request has it.
        host: String,
    },
    /// A page of another site makes the request.
    #[error("the request was made by a page of {origin}, not by this one")]
    ForeignOrigin {
        /// As the request has it; empty where it does not say.
        origin: String,
    },
    /// The token is missing, or another.
    #[error("this is not the key of the page: open the address that r4 serve has printed, with what is behind its #")]
    WrongToken,
}

/// The rule by which requests are let in.
#[derive(Clone, Debug)]
pub struct Guard {
    token: Token,
    /// True if the page contains the token, so that opening it is enough.
    is_in_page: bool,
}

impl Guard {
    /// For a page that only this machine can open: a token of this run, which is in the page.
    #[must_use]
    pub const fn of_this_machine(token: Token) -> Self {
        Self { token, is_in_page: true }
    }

    /// For users who have a key, of which `token` is made: it is in the address that they open, behind its `#`, or entered there.
    #[must_use]
    pub const fn with_key(token: Token) -> Self {
        Self { token, is_in_page: false }
    }

    /// The token that the page is served with; empty where its user has to have it.
    #[must_use]
    pub fn in_page(&self) -> String {
        if self.is_in_page { self.token.hex() } else { String::new() }
    }

    /// The token that is behind the `#` of the address to be opened; `None` where it is in the page.
    #[must_use]
    pub fn in_address(&self) -> Option<String> {
        (!self.is_in_page).then(|| self.token.hex())
    }

    /// Checks that the page may be sent.
    ///
    /// # Errors
    /// [`Denied::NoHost`], [`Denied::ForeignHost`]
    pub fn reads(&self, head: &Head) -> Result<(), Denied> {
        let host = head.field("host").filter(|host| !host.is_empty()).ok_or(Denied::NoHost)?;
        if self.is_in_page && !is_this_machine(host) {
            return Err(Denied::ForeignHost { host: host.to_owned() });
        }
        Ok(())
    }

    /// Checks that the request comes from the page itself, by its origin.
    ///
    /// # Errors
    /// As [`Guard::reads`]; [`Denied::ForeignOrigin`]
    pub fn is_page(&self, head: &Head) -> Result<(), Denied> {
        self.reads(head)?;
        let (host, origin) = (head.field("host").unwrap_or_default(), head.field("origin").unwrap_or_default());
        // By a proxy that adds encryption the scheme is another.
        let of = origin.strip_prefix("http://").or_else(|| origin.strip_prefix("https://"));
        match of {
            Some(of) if of.eq_ignore_ascii_case(host) => Ok(()),
            _ => Err(Denied::ForeignOrigin { origin: origin.to_owned() }),
        }
    }

    /// Checks the token that the page has sent.
    ///
    /// # Errors
    /// [`Denied::WrongToken`]
    pub fn has_token(&self, token: &str) -> Result<(), Denied> {
        if self.token.is(token) { Ok(()) } else { Err(Denied::WrongToken) }
    }
}

/// Returns true if a `Host` is this machine by an address of its own, or by the name that browsers never ask the network for.
fn is_this_machine(host: &str) -> bool {
    let name = match host.rsplit_once(':') {
        Some((name, port)) if !port.is_empty() && port.bytes().all(|digit| digit.is_ascii_digit()) => name,
        _ => host,
    };
    let address = name.strip_prefix('[').and_then(|name| name.strip_suffix(']')).unwrap_or(name);
    name.eq_ignore_ascii_case("localhost") || address.parse().is_ok_and(|address: IpAddr| address.is_loopback())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn head(host: &str, origin: &str) -> Head {
        let text = format!("GET / HTTP/1.1\r\nHost: {host}\r\nOrigin: {origin}\r\n\r\n");
        Head::parse(text.as_bytes()).expect("a head").expect("whole").0
    }

    fn token() -> Token {
        Token::new(std::array::from_fn(|at| at as u8 * 7))
    }

    #[test]
    fn without_a_key_only_this_machines_own_names_are_served() {
        let guard = Guard::of_this_machine(token());
        for host in ["127.0.0.1:8404", "127.8.9.1", "localhost:1", "LOCALHOST", "[::1]:8404", "[::1]"] {
            assert_eq!(guard.reads(&head(host, "")), Ok(()), "{host}");
        }
        for host in
            ["evil.example", "127.0.0.1.evil.example", "localhost.evil.example:8404", "192.168.1.2", "[::2]", "::1:x"]
        {
            assert_eq!(guard.reads(&head(host, "")), Err(Denied::ForeignHost { host: host.to_owned() }));
            assert_eq!(Guard::with_key(token()).reads(&head(host, "")), Ok(()), "{host}");
        }
        assert_eq!(guard.reads(&head("", "")), Err(Denied::NoHost));
    }

    #[test]
    fn only_the_page_itself_opens_a_socket() {
        for guard in [Guard::of_this_machine(token()), Guard::with_key(token())] {
            let here = "127.0.0.1:8404";
            assert_eq!(guard.is_page(&head(here, "http://127.0.0.1:8404")), Ok(()));
            // The same machine, and another page: a program of another user, for one.
            for origin in ["http://127.0.0.1:8405", "http://evil.example", "null", "", "file://", "http://"] {
                let denied = Denied::ForeignOrigin { origin: origin.to_owned() };
                assert_eq!(guard.is_page(&head(here, origin)), Err(denied));
            }
        }
    }

    #[test]
    fn a_token_is_in_the_page_or_with_its_user() {
        let digits = token().hex();
        let (own, keyed) = (Guard::of_this_machine(token()), Guard::with_key(token()));
        assert_eq!((own.in_page(), own.in_address()), (digits.clone(), None));
        assert_eq!((keyed.in_page(), keyed.in_address()), (String::new(), Some(digits.clone())));
        assert_eq!(keyed.has_token(&format!(" {}\n", digits.to_uppercase())), Ok(()));
        assert!(!format!("{keyed:?}").contains(&digits[..8]));
    }

    proptest! {
        #[test]
        fn one_wrong_digit_is_no_token(at in 0..64usize, digit in "[0-9a-f]") {
            let right = token().hex();
            let mut wrong = right.clone();
            wrong.replace_range(at..=at, &digit);
            prop_assert_eq!(token().is(&wrong), wrong == right);
            prop_assert!(!token().is(&right[..at]));
        }

        #[test]
        fn any_text_is_no_token(text in ".{0,80}") {
            prop_assert!(!token().is(&text));
        }
    }
}
