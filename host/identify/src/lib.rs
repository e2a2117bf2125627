//! Closes the loop between a model and measured data: how well the model explains what it was not fitted to, what the
//! residual depends on, which effect the model lacks, and how much better it is with it.

pub mod data;
pub mod error;
pub mod family;
pub mod fit;
pub mod motion;
pub mod report;
pub mod select;
pub mod statics;
