//! Tests of two instruction sets that were developed independently: `r4-thumb` and Unicorn.

mod common;
mod differential;
mod instructions;
mod machine;
mod probe;
