//! Tests of the program as a user runs it: `cargo test -p r4 --test all`, and `--test all cli::` for one file of these.

mod access;
mod bench_link;
mod blind;
mod bridge;
mod can;
mod cli;
mod emulated;
mod flash;
mod guide;
mod identify;
mod identify_close;
mod links;
mod logs;
mod page;
mod program;
mod protocol;
mod screen;
mod systems;
mod tune;
mod world;
