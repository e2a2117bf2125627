//! Fuzz targets: the parts of R4 that read bytes, with any bytes.
//!
//! Each target is a function over bytes. It panics when a rule of the part under test is broken, and otherwise returns
//! whether the bytes were accepted: a corpus of which nothing is accepted tests nothing.
//!
//! | module | targets |
//! | --- | --- |
//! | [`frames`] | `frames`: the decoder of both directions |
//! | [`board`] | `link`, `dispatcher`: bytes, and valid frames of any content, into the link of a simulated board |
//! | [`host`] | `driver`: messages of any board to the driver; `tap`: any traffic of a link to a recording |
//! | [`files`] | `log`, `flash`, `robot`, `carrier`, `plant`, `key`, `recording`: the files that the program reads |
//! | [`config`], [`scenario`] | files that only the program itself can read |
//! | [`page`] | `page`: messages of browsers to the page of a board |
//! | [`text`] | `slcan`, `legacy`: lines of a CAN adapter, packets of the old firmware's hosts |
//! | [`secure`] | `secure`: an attacker between the two ends of an encrypted link |
//!
//! [`mutate`] makes neighbours of inputs, [`script`] reads an input as a list of actions. The same functions are called
//! by `tests/replay.rs` in every test run and by the fuzzer in `cargo-fuzz/`.

// A finding is reported by a panic.
#![allow(clippy::expect_used, clippy::unwrap_used, clippy::panic, reason = "a fuzz target fails by panicking")]

pub mod board;
pub mod config;
pub mod files;
pub mod frames;
pub mod host;
pub mod mutate;
pub mod page;
pub mod scenario;
pub mod script;
pub mod secure;
pub mod text;

/// Function that reads an input, and returns whether it accepted it.
pub type Target = fn(&[u8]) -> bool;

/// Targets by name, which is also the name of their corpus and of their fuzzer.
pub const TARGETS: [(&str, Target); 18] = [
    ("carrier", files::carrier),
    ("config", config::config),
    ("dispatcher", board::dispatcher),
    ("driver", host::driver),
    ("flash", files::flash),
    ("frames", frames::frames),
    ("key", files::key),
    ("legacy", text::legacy),
    ("link", board::link),
    ("log", files::log),
    ("page", page::page),
    ("plant", files::plant),
    ("recording", files::recording),
    ("robot", files::robot),
    ("scenario", scenario::scenario),
    ("secure", secure::secure),
    ("slcan", text::slcan),
    ("tap", host::tap),
];
