//! Tests of the configuration, from outside the crate.
//!
//! | module | subject |
//! | --- | --- |
//! | `good` | a configuration that is valid and has every kind of channel |
//! | `parameters` | its numbers, read and changed by name |
//! | `random` | any configuration at all: nothing panics |
//! | `rules` | every rule broken by one change to it, and the ends of what is allowed |

mod good;
mod parameters;
mod random;
mod rules;
