//! Maps and planning that field robots share.
//!
//! Numbers in, numbers out: no board, no clock, no link. Lengths are m, angles rad, times s on the caller's clock; a scalar
//! field has the unit that its readings have. Axes follow REP 103: x forward, y left, yaw from +x towards +y.
//!
//! | module | holds |
//! | --- | --- |
//! | [`grid`] | a grid of cells with a frame: cells and points, neighbours, scalar fields with a unit |
//! | [`field`] | a scalar field on the free cells from readings that age, with calibrated variances |
//! | [`occupancy`] | log-odds of obstacles from range readings, distances to obstacles, room for a robot, scan matching |
//! | [`process`] | Gaussian-process regression of place and time, and where to measure next |
//! | [`plan`] | distances and routes over free cells, and the dynamic window that follows them |

pub mod field;
pub mod grid;
pub mod occupancy;
pub mod plan;
pub mod pose;
pub mod process;
