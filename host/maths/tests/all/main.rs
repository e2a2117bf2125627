//! Results beside those of SciPy, NumPy and statsmodels, and properties that must hold for any input.

mod hypothesis;
mod least_squares;
mod oracle;
mod properties;
mod statistics;
