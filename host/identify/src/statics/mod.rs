//! What does not move in time: maps from a level to a steady output, laws against printed rows, and the play of a shaft
//! that is pulled from both sides.

pub mod hysteresis;
pub mod map;
pub mod table;
