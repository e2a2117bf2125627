//! The native half of the Python package `r4`, as `r4._native`: what crosses from Rust to Python and back.
//!
//! The other half, in `python/r4`, is what users import. Whatever a user of the Rust libraries would want too is in those: boards on
//! threads in [`r4_rig::BoardThread`], environments in [`r4_learn`]. Here values are changed from one language's to the other's, and
//! the interpreter is let go (`Python::detach`) while a board works.

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
