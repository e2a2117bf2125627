//! Maps and planning that field robots share.
//!
//! Numbers in, numbers out: no board, no clock, no link. Lengths are m, angles rad, times s on the caller's clock; a scalar
//! field has the unit that its readings have. Axes follow REP 103: x forward, y left, yaw from +x towards +y.
//!
//! | module | holds |
//! | --- | --- |
//! | [`grid`] | a grid of cells with a frame: cells and points, neighbours, scalar fields with a unit |

pub mod grid;
pub mod pose;
