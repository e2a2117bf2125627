//! Tests of both instruction sets, of which neither was made from the other: `r4-thumb` and Unicorn.

mod common;
mod differential;
mod instructions;
mod machine;
mod probe;
