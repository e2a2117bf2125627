//! Safety: the state machine ([`machine`], pure) and the task that feeds it ([`supervise`]).

pub mod machine;
mod task;

pub use machine::{Event, Safety};
pub use task::{SafetyPins, supervise};
