//! Request to end a session in good order.

use std::sync::{
    Arc,
    atomic::{AtomicBool, Ordering},
};

/// Flag set by Ctrl-C or by another thread: the board is disarmed and the session ends with [`Interrupted`]. Clones
/// share the flag.
#[derive(Clone, Debug, Default)]
pub struct Interrupt(Arc<AtomicBool>);

/// Error of a session that an [`Interrupt`] ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("interrupted; the board is disarmed")]
pub struct Interrupted;

impl Interrupt {
    /// Requests the end of the session.
    pub fn set(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Returns true after [`Interrupt::set`].
    #[must_use]
    pub fn is_set(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }
}
