//! What any bytes do to the parts of R4 that read bytes.
//!
//! Each target is a function over bytes. It panics when something does what it never may, and says otherwise whether the
//! bytes were taken for what they stand for: a corpus of which nothing is taken tests nothing.
//!
//! | module | targets |
//! | --- | --- |
//! | [`frames`] | `frames`: the decoder of both directions |
//! | [`board`] | `link`, `dispatcher`: bytes, and sound frames of any content, into the link of a simulated board |
//! | [`host`] | `driver`: what any board says to the driver; `tap`: what any link says to a recording |
//! | [`files`] | `log`, `flash`, `robot`, `carrier`, `plant`, `key`, `recording`: the files that the program reads |
//! | [`config`], [`scenario`] | those of them that only the program itself can read |
//! | [`page`] | `page`: what browsers say to the page of a board |
//! | [`text`] | `slcan`, `legacy`: lines of a CAN adapter, packets of the old firmware's hosts |
//! | [`secure`] | `secure`: somebody between the two ends of an encrypted link |
//!
//! [`mutate`] makes neighbours of inputs, [`script`] reads an input as a list of things to do. The same functions are
//! called by `tests/replay.rs` in every test run and by the fuzzer in `cargo-fuzz/`.

// What is found is told by a panic.
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

/// Takes an input; whether it was taken for what the target reads.
pub type Target = fn(&[u8]) -> bool;

/// Every target by its name, which is that of its corpus and of its fuzzer too.
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
