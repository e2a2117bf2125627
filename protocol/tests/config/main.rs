//! The configuration, seen from outside the crate.
//!
//! | module | subject |
//! | --- | --- |
//! | `good` | a configuration that is valid and has every kind of channel |
//! | `parameters` | its numbers, read and changed by name |

mod good;
mod parameters;
