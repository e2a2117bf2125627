//! Scenarios: files of timed steps for a virtual board, their outcomes, and comparisons of these between a simulated and an
//! emulated board. `docs/scenarios.md` lists the steps.

mod compare;
mod error;
mod file;
mod play;

pub use compare::{Compared, Difference, differences};
pub use error::ScenarioError;
pub use file::{Action, Scenario, Step};
pub use play::{Checkpoint, Motion, Outcome, play};
