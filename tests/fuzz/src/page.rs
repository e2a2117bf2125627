//! What any browser says to the page of a board.

use r4_page::{
    Guard, Token,
    http::Head,
    socket::{MOST_MESSAGE, Socket},
};

/// Any bytes as the head of a request, and as what comes on the page's socket. A request is let in only from the page itself, and no message
/// is longer than it may be.
///
/// # Panics
/// When it is.
pub fn page(bytes: &[u8]) -> bool {
    let head = Head::parse(bytes);
    if let Ok(Some((head, len))) = &head {
        assert!(*len <= bytes.len());
        let _ = head.websocket_accept();
        let (host, origin) = (head.field("host").unwrap_or_default(), head.field("origin").unwrap_or_default());
        for guard in [Guard::of_this_machine(Token::new([1; 32])), Guard::with_key(Token::new([1; 32]))] {
            if guard.is_page(head).is_ok() {
                assert!(!host.is_empty() && origin.to_lowercase().ends_with(&host.to_lowercase()), "{head:?}");
            }
        }
    }
    let texts = Socket::server().receive(bytes).unwrap_or_default();
    assert!(texts.iter().all(|text| text.len() <= MOST_MESSAGE));
    matches!(head, Ok(Some(_))) || !texts.is_empty()
}
