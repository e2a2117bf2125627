//! Session of the board's single host: opened, kept and closed for links, watched by the supervisor.

use embassy_time::{Duration, Instant};
use r4_protocol::Refusal;

#[derive(Clone, Copy, Debug)]
struct Session {
    id: u16,
    link: u8,
    last_heartbeat: Instant,
}

/// Number of the first session since the board started.
const FIRST: u16 = 1;

/// Present session, and the number of the next.
pub(super) struct Sessions {
    session: Option<Session>,
    next: u16,
}

impl Sessions {
    pub(super) const fn new() -> Self {
        Self { session: None, next: FIRST }
    }

    /// Checks that `link` may open a session, where one ends without a heartbeat for `timeout`.
    ///
    /// # Errors
    /// [`Refusal::InUse`] while another link's session is alive.
    pub(super) fn check(&self, link: u8, timeout: Duration, now: Instant) -> Result<(), Refusal> {
        match self.session {
            Some(session)
                if session.link != link && now.saturating_duration_since(session.last_heartbeat) <= timeout =>
            {
                Err(Refusal::InUse)
            }
            _ => Ok(()),
        }
    }

    /// Opens a session for `link`, and closes the previous one; returns its number.
    pub(super) fn open(&mut self, link: u8, now: Instant) -> u16 {
        let id = self.next;
        self.next = id.wrapping_add(1);
        self.session = Some(Session { id, link, last_heartbeat: now });
        id
    }

    pub(super) fn close(&mut self) {
        self.session = None;
    }

    /// Returns true if `link` holds the session.
    pub(super) fn is_of(&self, link: u8) -> bool {
        self.session.is_some_and(|session| session.link == link)
    }

    /// Takes a heartbeat; false when it belongs to no open session.
    pub(super) fn heartbeat(&mut self, link: u8, id: u16, now: Instant) -> bool {
        match &mut self.session {
            Some(session) if session.link == link && session.id == id => {
                session.last_heartbeat = now;
                true
            }
            _ => false,
        }
    }

    /// Time since the last heartbeat; `None` without a session.
    pub(super) fn heartbeat_age(&self, now: Instant) -> Option<Duration> {
        self.session.map(|session| now.saturating_duration_since(session.last_heartbeat))
    }

    /// Returns true if there has been a session since the board started.
    pub(super) fn heard_of_any(&self) -> bool {
        self.next != FIRST
    }

    /// Sets the result of [`Sessions::heard_of_any`].
    #[cfg(test)]
    pub(super) fn set_heard_of_any(&mut self, heard: bool) {
        self.next = FIRST + u16::from(heard);
    }
}
