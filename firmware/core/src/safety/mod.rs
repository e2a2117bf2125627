//! Safety as pure functions: the state machine, and stops that brake. [`supervise`](crate::supervisor::supervise) feeds them.

pub mod machine;
pub mod stop;

pub use machine::{Event, Safety};
