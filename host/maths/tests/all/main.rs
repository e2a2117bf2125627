//! Tests that compare results with those of SciPy, NumPy and statsmodels, and of properties that must hold for any
//! input.

mod curves;
mod hypothesis;
mod kalman;
mod least_squares;
mod minimise;
mod oracle;
mod path;
mod properties;
mod statistics;
