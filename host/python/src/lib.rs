//! Native half of the Python package `r4`, as `r4._native`: conversion between Rust and Python.
//!
//! The other half, in `python/r4`, is what users import. Functionality that users of the Rust libraries need too is in
//! those: boards on threads in [`r4_rig::BoardThread`], environments in [`r4_learn`]. Here values are converted between
//! the languages, and the interpreter's lock is released (`Python::detach`) while a board works.

mod analysis;
mod board;
mod error;
mod gym;
mod log;
mod request;
mod value;

#[pyo3::pymodule]
mod _native {
    #[pymodule_export]
    use super::{
        analysis::{identify, merge, models, study, systems},
        board::{Board, find, robots},
        gym::GoTo,
        log::read_log,
        request::Request,
        value::{Channel, Cycle, Info, Mode, Motion, PathReport, Port, Sample},
    };
}
