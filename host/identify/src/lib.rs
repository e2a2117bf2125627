//! Closes the loop between a model and measured data: how well the model explains what it was not fitted to, what the
//! residual depends on, which effect the model lacks, and how much better it is with it.
//!
//! | module | subject |
//! | --- | --- |
//! | [`task`] | [`identify`]: from recordings to a [`report::Report`]; the list of [`models`] |
//! | [`data`] | recordings, read without inventing anything |
//! | [`family`] | what fitting and choosing need to know of a model |
//! | [`fit`] | least squares on free runs |
//! | [`select`] | which effects the data ask for |
//! | [`motion`] | one axis that moves: motors, axes, actuators, servos |
//! | [`statics`] | maps, tables, play of a held shaft |
//! | [`skid`] | skid-steered robots: slip, limits, lags |
//! | [`report`] | what comes out |
//!
//! Everything here is the estimator's own: it shares no formula with the plants that make simulated data.

pub mod data;
pub mod error;
mod evidence;
pub mod family;
pub mod fit;
pub mod motion;
mod question;
pub mod report;
mod residual;
pub mod select;
pub mod skid;
pub mod statics;
mod suspect;
pub mod task;

pub use error::IdentifyError;
pub use question::{Question, Recordings};
pub use task::{Identified, ModelInfo, Progress, Task, identify, models};
