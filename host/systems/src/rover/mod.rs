//! What rovers that map a field have in common: the pose by wheels and gyroscope, and the drive of a program on a board.

pub mod pilot;
pub mod pose;

pub use pilot::{Driven, Fix, Program, Setup, run};
pub use pose::PoseFilter;
