//! Tasks on R4 boards as environments for learning: observations, actions and rewards, on many boards at once.
//!
//! A task runs at two [fidelities](Fidelity): the **full** board, firmware, chips, motors and tyres on virtual time, and a **kinematic**
//! model whose numbers were identified from full boards ([`kinematic`]). The rule: train on the kinematic model, which is thousands
//! of times faster, and report only what the full board does with the result.
//!
//! ```
//! use r4_learn::{Environments, Fidelity};
//!
//! let mut environments = Environments::new(2, Fidelity::Full)?;
//! let first = environments.reset(&[1, 2])?;
//! let steps = environments.step(&[[1.0, 0.0], [0.0, 1.0]])?;
//! assert!(steps[0].observation[3] > first[0][3], "it drives");
//! # Ok::<(), r4_learn::Error>(())
//! ```

mod environments;
mod full;
pub mod goal;
pub mod kinematic;
mod wheels;

pub use environments::{Environments, Fidelity};
pub use goal::{
    ACTIONS, Action, BOUNDS, EPISODE_STEPS, Goal, OBSERVATIONS, Observation, REACHED_M, STEP_S, Step, Truth,
};

/// An environment cannot go on.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// An action is outside of its range, or no number.
    #[error("action {action} of environment {index} is {value}: each is from -1 to 1; clip what a policy samples")]
    BadAction {
        /// Which environment, from 0.
        index: usize,
        /// Which of its actions, from 0.
        action: usize,
        /// The action.
        value: f64,
    },
    /// Another number of seeds or actions than there are environments.
    #[error("{given} {what} for {expected} environments: give one for each")]
    WrongCount {
        /// Seeds or actions.
        what: &'static str,
        /// How many were given.
        given: usize,
        /// How many there are.
        expected: usize,
    },
    /// There is no episode.
    #[error("environment {index} has no episode: reset it before its first step")]
    NotReset {
        /// Which environment, from 0.
        index: usize,
    },
    /// The robot does not drive as the task needs.
    #[error("{robot} is no skid-steer robot with two wheels on each side, which this task drives")]
    NoSkidSteer {
        /// Its name.
        robot: String,
    },
    /// The full board failed otherwise than by a trip.
    #[error(transparent)]
    Rig(#[from] r4_rig::Error),
    /// The operating system gives no thread.
    #[error("cannot start a thread for a board: {0}")]
    Thread(std::io::Error),
    /// The thread of a board is gone, by a defect.
    #[error("the thread of environment {index} has ended: this is a defect")]
    Gone {
        /// Which environment, from 0.
        index: usize,
    },
}
