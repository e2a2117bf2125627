//! Safety: the state machine ([`machine`], pure) and the task that feeds it ([`supervise`]).

pub mod machine;
pub mod stop;
mod task;
#[cfg(test)]
mod tests;

pub use machine::{Event, Safety};
pub use task::{SafetyPins, supervise};
