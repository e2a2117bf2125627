//! Requests of HTTP/1.1 as the page makes them: heads without bodies, one on each connection.
//!
//! # Source
//! RFC 9110 (*HTTP Semantics*), RFC 9112 (*HTTP/1.1*), RFC 6455 (*The WebSocket Protocol*), 4.2.

use data_encoding::BASE64;
use sha1::{Digest, Sha1};

/// Most bytes of a head. Browsers send less than 1 KiB to a page without cookies.
pub const MOST_HEAD: usize = 8 * 1024;
/// Most header fields. Browsers send about 20.
const MOST_FIELDS: usize = 64;
/// Constant that the key of a WebSocket's handshake is hashed with: RFC 6455, 1.3.
const HANDSHAKE: &str = "258EAFA5-E914-47DA-95CA-C5AB0DC85B11";

/// A request that cannot be answered.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum HttpError {
    /// The head is longer than [`MOST_HEAD`].
    #[error("the head of the request is longer than {MOST_HEAD} bytes")]
    TooLong,
    /// No HTTP/1.1, or a broken head.
    #[error("no request of HTTP/1.1 ({0}): open the page's address in a browser")]
    Malformed(httparse::Error),
    /// A field that says where the request comes from or goes to is there more than once.
    #[error("the request has more than one `{0}`")]
    Repeated(&'static str),
}

/// Head of a request.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Head {
    /// `GET`, `POST` or another.
    pub method: String,
    /// Path, without a query.
    pub path: String,
    /// Names in lower case, and values.
    fields: Vec<(String, String)>,
}

impl Head {
    /// Reads a head from the first bytes of a connection. Returns `None` before its end has come, and with the head how many bytes it took.
    ///
    /// # Errors
    /// [`HttpError`]
    pub fn parse(bytes: &[u8]) -> Result<Option<(Self, usize)>, HttpError> {
        let mut fields = [httparse::EMPTY_HEADER; MOST_FIELDS];
        let mut request = httparse::Request::new(&mut fields);
        let seen = &bytes[..bytes.len().min(MOST_HEAD)];
        let len = match request.parse(seen).map_err(HttpError::Malformed)? {
            httparse::Status::Complete(len) => len,
            httparse::Status::Partial if bytes.len() >= MOST_HEAD => return Err(HttpError::TooLong),
            httparse::Status::Partial => return Ok(None),
        };
        let field = |field: &httparse::Header<'_>| {
            (field.name.to_ascii_lowercase(), String::from_utf8_lossy(field.value).trim().to_owned())
        };
        let path = request.path.unwrap_or_default();
        let head = Self {
            method: request.method.unwrap_or_default().to_owned(),
            path: path.split('?').next().unwrap_or_default().to_owned(),
            fields: request.headers.iter().map(field).collect(),
        };
        // Two of one would let this program and a proxy read different ones.
        for name in ["host", "origin", "sec-websocket-key"] {
            if head.fields.iter().filter(|(of, _)| of == name).count() > 1 {
                return Err(HttpError::Repeated(name));
            }
        }
        Ok(Some((head, len)))
    }

    /// Value of a field, by its name in lower case.
    #[must_use]
    pub fn field(&self, name: &str) -> Option<&str> {
        self.fields.iter().find(|(of, _)| of == name).map(|(_, value)| value.as_str())
    }

    /// Value that answers a WebSocket's handshake; `None` where this head asks for no WebSocket of version 13.
    #[must_use]
    pub fn websocket_accept(&self) -> Option<String> {
        let has = |name, word: &str| {
            let mut words = self.field(name).unwrap_or_default().split(',');
            words.any(|of| of.trim().eq_ignore_ascii_case(word))
        };
        let asks = has("upgrade", "websocket") && has("connection", "upgrade") && has("sec-websocket-version", "13");
        let key = self.field("sec-websocket-key").filter(|_| asks && self.method == "GET")?;
        let is_key = BASE64.decode(key.as_bytes()).is_ok_and(|bytes| bytes.len() == 16);
        is_key.then(|| BASE64.encode(&Sha1::digest([key.as_bytes(), HANDSHAKE.as_bytes()].concat())))
    }
}

/// Status of an answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Status {
    /// Status 200: the page or a part of it follows.
    Ok,
    /// Status 400: the request is malformed.
    BadRequest,
    /// Status 403: host, origin or token are refused.
    Forbidden,
    /// Status 404: there is no such path.
    NotFound,
    /// Status 405: the path exists, but not for this method.
    MethodNotAllowed,
    /// Status 503: too many browsers are connected.
    Unavailable,
}

impl Status {
    const fn line(self) -> &'static str {
        match self {
            Self::Ok => "200 OK",
            Self::BadRequest => "400 Bad Request",
            Self::Forbidden => "403 Forbidden",
            Self::NotFound => "404 Not Found",
            Self::MethodNotAllowed => "405 Method Not Allowed",
            Self::Unavailable => "503 Service Unavailable",
        }
    }
}

/// An answer with its body. No cache keeps it, no other site shows it in a frame (where it could make a user press `Arm`), and the page
/// runs no script and loads nothing but what is in it.
#[must_use]
pub fn answer(status: Status, content_type: &str, body: &str) -> String {
    format!(
        "HTTP/1.1 {}\r\n\
         Content-Type: {content_type}; charset=utf-8\r\n\
         Content-Length: {}\r\n\
         Connection: close\r\n\
         Cache-Control: no-store\r\n\
         Content-Security-Policy: default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data:; \
         connect-src 'self' ws: wss:; base-uri 'none'; form-action 'none'; frame-ancestors 'none'\r\n\
         Cross-Origin-Resource-Policy: same-origin\r\n\
         Cross-Origin-Opener-Policy: same-origin\r\n\
         Referrer-Policy: no-referrer\r\n\
         X-Content-Type-Options: nosniff\r\n\
         X-Frame-Options: DENY\r\n\
         \r\n\
         {body}",
        status.line(),
        body.len(),
    )
}

/// The answer that makes a WebSocket of a connection.
#[must_use]
pub fn switching(accept: &str) -> String {
    format!(
        "HTTP/1.1 101 Switching Protocols\r\n\
         Upgrade: websocket\r\n\
         Connection: Upgrade\r\n\
         Sec-WebSocket-Accept: {accept}\r\n\
         \r\n"
    )
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    /// The example of RFC 6455, 1.3.
    const EXAMPLE: &str = "GET /socket HTTP/1.1\r\nHost: server.example.com\r\nUpgrade: websocket\r\nConnection: keep-alive, Upgrade\r\n\
                           Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n\r\n";

    fn parsed(text: &str) -> Head {
        Head::parse(text.as_bytes()).expect("a head").expect("a whole one").0
    }

    #[test]
    fn the_handshake_of_the_rfc_is_answered_as_there() {
        let head = parsed(EXAMPLE);
        assert_eq!(head.websocket_accept().as_deref(), Some("s3pPLMBiTxaQ9kYGzzhZRbK+xOo="));
        for broken in ["Upgrade: websocket\r\n", "Connection: keep-alive, Upgrade\r\n", "Sec-WebSocket-Version: 13\r\n"]
        {
            assert_eq!(parsed(&EXAMPLE.replace(broken, "")).websocket_accept(), None, "without {broken}");
        }
        for (from, to) in [("GET", "POST"), ("Version: 13", "Version: 8"), ("b25jZQ==", "b25jZQ"), ("dGhl", "")] {
            assert_eq!(parsed(&EXAMPLE.replace(from, to)).websocket_accept(), None, "{to} for {from}");
        }
    }

    #[test]
    fn a_query_is_no_part_of_the_path_and_names_have_no_case() {
        let head = parsed("GET /?a=/stop HTTP/1.1\r\nHOST:  there \r\n\r\n");
        assert_eq!((head.method.as_str(), head.path.as_str(), head.field("host")), ("GET", "/", Some("there")));
    }

    #[test]
    fn what_is_no_request_is_refused() {
        assert!(matches!(Head::parse(b"\x16\x03\x01\x02\x00"), Err(HttpError::Malformed(_))));
        assert!(matches!(Head::parse(b"GET / HTTP/2.0\r\n\r\n"), Err(HttpError::Malformed(_))));
        let twice = "GET / HTTP/1.1\r\nHost: a\r\nhost: b\r\n\r\n";
        assert_eq!(Head::parse(twice.as_bytes()), Err(HttpError::Repeated("host")));
        let many = format!("GET / HTTP/1.1\r\n{}\r\n", "a: b\r\n".repeat(MOST_FIELDS + 1));
        assert_eq!(Head::parse(many.as_bytes()), Err(HttpError::Malformed(httparse::Error::TooManyHeaders)));
        let long = format!("GET / HTTP/1.1\r\nA: {}", "b".repeat(MOST_HEAD));
        assert_eq!(Head::parse(long.as_bytes()), Err(HttpError::TooLong));
    }

    #[test]
    fn an_answer_says_how_long_it_is() {
        let text = answer(Status::Ok, "text/html", "<p>\u{b0}");
        let (head, body) = text.split_once("\r\n\r\n").expect("a head and a body");
        assert!(head.starts_with("HTTP/1.1 200 OK\r\n") && head.contains("Content-Length: 5\r\n"), "{head}");
        assert_eq!(body.len(), 5);
    }

    proptest! {
        /// Any bytes: no panic, and the head of a request does not depend on where the network cuts it.
        #[test]
        fn any_bytes_are_a_head_or_an_error(bytes in prop::collection::vec(any::<u8>(), 0..600)) {
            let _ = Head::parse(&bytes);
        }

        #[test]
        fn a_head_is_whole_at_its_end_and_not_before(cut in 0..EXAMPLE.len(), rest in prop::collection::vec(any::<u8>(), 0..40)) {
            prop_assert_eq!(Head::parse(&EXAMPLE.as_bytes()[..cut]), Ok(None));
            let more = [EXAMPLE.as_bytes(), &rest].concat();
            let (head, len) = Head::parse(&more).expect("a head").expect("whole");
            prop_assert_eq!((head, len), (parsed(EXAMPLE), EXAMPLE.len()));
        }
    }
}
