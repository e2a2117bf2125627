//! Tests of recordings: written, read, damaged.

mod common;
mod damage;
mod round_trip;
mod signals;
mod tap;
