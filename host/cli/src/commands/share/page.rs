//! The page for browsers: where it is served, to whom, and what is said of those who leave.

use std::net::SocketAddr;

use anyhow::Context as _;
use r4_links::{Key, Listener};
use r4_page::{Guard, Left, MOST_BROWSERS, Token};

use super::super::serve::bind;
use crate::args::Args;

/// What the page's token is made for, of the key.
const PURPOSE: &str = "page";

/// Where the page is served.
pub(super) struct Door {
    pub(super) listener: Listener,
    pub(super) guard: Guard,
    at: SocketAddr,
}

impl Door {
    /// Listens for browsers: those of this machine, or any with `public` and a key.
    ///
    /// # Errors
    /// When others could reach the address without a key, its port is taken, or no token can be made.
    pub(super) fn open(args: &Args, address: SocketAddr, public: bool, key: Option<&Key>) -> anyhow::Result<Self> {
        let (socket, at) = bind(args, address, public)?;
        let guard = match key {
            Some(key) => Guard::with_key(Token::new(key.token(PURPOSE))),
            None => Guard::of_this_machine(Token::new(Key::random().context("cannot make a token")?.token(PURPOSE))),
        };
        // The key of the other links proves itself in a way that browsers do not know.
        Ok(Self { listener: Listener::new(socket, None), guard, at })
    }

    /// Address of the page.
    pub(super) fn address(&self) -> String {
        format!("http://{}/", self.at)
    }

    /// The address with all that has to be behind it.
    pub(super) fn to_be_opened(&self) -> String {
        let token = self.guard.in_address().map_or_else(String::new, |token| format!("#{token}"));
        self.address() + &token
    }
}

/// Returns the message about a browser that has left; `None` for one that just closed the page.
pub(super) fn told(left: &Left) -> Option<String> {
    let why = match left {
        Left::Answered | Left::Gone | Left::Silent => return None,
        Left::Slow => "it does not read what it is sent".to_owned(),
        Left::Full => format!("{MOST_BROWSERS} have the page open"),
        Left::Denied(why) => why.to_string(),
        Left::Malformed(why) => why.to_string(),
        Left::Broken(why) => why.to_string(),
        Left::Unknown => "it says what the page does not say: load the page anew".to_owned(),
    };
    Some(format!("r4: a browser was turned away: {why}"))
}
