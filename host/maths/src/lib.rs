//! The mathematics that identification, tuning, benchmarks and robot systems share.
//!
//! Numbers in, numbers out: no hardware, no clock, no other crate of this project. Quantities have the caller's units; where a
//! function ties units together, its documentation says how. Every function names the paper or book it follows. The tests
//! compare it with SciPy, NumPy or statsmodels (`tests/oracle/`), where these have the same function.
//!
//! | module | holds |
//! | --- | --- |
//! | [`statistics`] | quantiles and robust spread, RMSE, confidence intervals, bootstrap, hypothesis tests |
//! | [`least_squares`] | linear and nonlinear fits with standard errors (feature `matrices`) |
//!
//! Random numbers come from a seed that the caller gives: the same seed gives the same result.

#[cfg(feature = "matrices")]
pub mod least_squares;
pub mod statistics;
