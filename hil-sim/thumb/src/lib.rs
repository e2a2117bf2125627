//! The instruction set of the emulated Cortex-M7.

#![allow(dead_code, unused_imports, reason = "the executor comes later")]

mod float;
