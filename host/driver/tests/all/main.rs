//! Tests of the driver on a simulated board.

mod compatibility;
mod simulated;
mod streams;
