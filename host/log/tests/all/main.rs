//! Tests of recordings: written, read and damaged ones.

mod common;
mod damage;
mod round_trip;
mod signals;
mod tap;
