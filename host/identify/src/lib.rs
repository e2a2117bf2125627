//! Identification of models from measured data. It answers how well a model explains recordings that it was not
//! fitted to, what its residual depends on, which effect it lacks, and how much better it is with that effect.
//!
//! | module | subject |
//! | --- | --- |
//! | [`task`] | [`identify`]: from recordings to a [`report::Report`]; the list of [`models`] |
//! | [`data`] | recordings, read without interpolation or guessing |
//! | [`family`] | interface of a model to fitting and selection |
//! | [`fit`] | nonlinear least squares on free-run simulations (simulation error, not one-step prediction error) |
//! | [`select`] | selection of the effects that the data support |
//! | [`motion`] | one axis that moves: motors, axes, actuators, servos |
//! | [`statics`] | static maps, tables of working points, backlash of a held shaft |
//! | [`skid`] | skid-steered robots: slip, limits, lags |
//! | [`report`] | results |
//!
//! The estimator's equations are its own: it shares no formula with the plants that make simulated data, so that a
//! common mistake cannot hide.

pub mod data;
pub mod error;
mod evidence;
pub mod family;
pub mod fit;
pub mod motion;
mod parallel;
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
