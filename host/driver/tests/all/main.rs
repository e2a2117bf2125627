//! Tests of the driver on a simulated bench.

mod compatibility;
mod simulated;
mod streams;
