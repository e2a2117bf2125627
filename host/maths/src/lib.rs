//! Mathematics that identification, tuning, benchmarks and robot systems share.
//!
//! Numbers in, numbers out: no hardware, no clock, no other crate of this project. Quantities have the caller's units;
//! where a function relates units to each other, its documentation says how. Every function names the paper or book
//! that it follows. The tests compare it with SciPy, NumPy or statsmodels (`tests/oracle/`), where these have the same
//! function.
//!
//! | module | holds |
//! | --- | --- |
//! | [`statistics`] | quantiles and robust spread, RMSE, confidence intervals, bootstrap, hypothesis tests |
//! | [`least_squares`] | linear and nonlinear fits with standard errors (feature `matrices`) |
//! | [`minimise`] | minima within bounds, local and global, without derivatives (feature `optimise`) |
//! | [`root`] | roots of functions of one number |
//! | [`spline`] | curves through knots |
//! | [`kalman`] | Kalman filter, linear and extended (feature `matrices`) |
//! | [`path`] | shortest paths, on graphs and grids |
//!
//! Random numbers come from a seed that the caller gives: the same seed gives the same result.

#[cfg(feature = "matrices")]
pub mod kalman;
#[cfg(feature = "matrices")]
pub mod least_squares;
#[cfg(feature = "optimise")]
pub mod minimise;
pub mod path;
pub mod root;
pub mod spline;
pub mod statistics;
