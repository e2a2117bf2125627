//! Emulated processor and its firmware's log, with the feature `emu`.

#[cfg(not(feature = "emu"))]
mod absent;
#[cfg(feature = "emu")]
mod board;
#[cfg(feature = "emu")]
mod link_log;

#[cfg(not(feature = "emu"))]
pub(crate) use absent::{LinkLog, bench, bench_safety, debug, debugged, image, log, start_image, tick};
#[cfg(feature = "emu")]
pub(crate) use board::{debug, debugged, image, log, start_image};
#[cfg(feature = "emu")]
pub(crate) use {
    crate::commands::bench::{firmware::run as bench, firmware::tick, safety::processor::run as bench_safety},
    link_log::LinkLog,
};
