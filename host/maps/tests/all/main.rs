//! Tests of maps and planning: comparison with direct solves, closed forms and scikit-learn, and properties that must
//! hold for any input.

mod field;
mod grid;
mod gtsam;
mod matching;
mod occupancy;
mod plan;
mod process;
