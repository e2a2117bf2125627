//! Tasks on R4 boards as environments for learning: observations, actions and rewards, on many boards at once.
//!
//! A task runs at two [fidelities](Fidelity): the **full** board, firmware, chips, motors and tyres on virtual time,
//! and a **kinematic** model whose parameters were identified from full boards ([`kinematic`]). The rule: train on the
//! kinematic model, which is thousands of times faster, and report only results of the full board.
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

/// Error of an environment.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// An action is outside its range, or not a number.
    #[error("action {action} of environment {index} is {value}: each is from -1 to 1; clip what a policy samples")]
    BadAction {
        /// Number of the environment, from 0 on.
        index: usize,
        /// Index of the number in the action, from 0 on.
        action: usize,
        /// Value of the action.
        value: f64,
    },
    /// The number of seeds or actions differs from that of the environments.
    #[error("{given} {what} for {expected} environments: give one for each")]
    WrongCount {
        /// Kind of the argument, `seeds` or `actions`.
        what: &'static str,
        /// Number that was given.
        given: usize,
        /// Number of environments in the set.
        expected: usize,
    },
    /// The environment has no episode.
    #[error("environment {index} has no episode: reset it before its first step")]
    NotReset {
        /// Number of the environment, from 0 on.
        index: usize,
    },
    /// The robot does not have the drive that the task needs.
    #[error("{robot} is no skid-steer robot with two wheels on each side, which this task drives")]
    NoSkidSteer {
        /// Name of the robot.
        robot: String,
    },
    /// The full board failed otherwise than by a trip.
    #[error(transparent)]
    Rig(#[from] r4_rig::Error),
    /// The operating system gives no thread.
    #[error("cannot start a thread for a board: {0}")]
    Thread(std::io::Error),
    /// The thread of a board has ended because of a defect.
    #[error("the thread of environment {index} has ended: this is a defect")]
    Gone {
        /// Number of the environment, from 0 on.
        index: usize,
    },
}
