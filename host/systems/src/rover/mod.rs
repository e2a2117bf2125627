//! Parts shared by rovers that map a field: the pose filter, and the loop that drives a program on a board.

pub mod pilot;
pub mod pose;

pub use pilot::{Driven, Fix, Program, Setup, run};
pub use pose::PoseFilter;
