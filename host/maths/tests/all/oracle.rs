//! Reference values from `tests/oracle/oracle.json`, which `oracle.py` beside it writes.

use std::sync::LazyLock;

use serde::{Deserialize, de::DeserializeOwned};
use serde_json::Value;

static ORACLE: LazyLock<Value> =
    LazyLock::new(|| serde_json::from_str(include_str!("../oracle/oracle.json")).expect("written by oracle.py"));

/// Relative rounding error of sums of at most a few hundred numbers, in another order than NumPy's pairwise one: n ×
/// 2⁻⁵³ at most.
pub(crate) const SUMS: f64 = 1e-13;

/// Returns the cases of one kind; there is at least one.
pub(crate) fn cases<T: DeserializeOwned>(kind: &str) -> Vec<T> {
    let cases = ORACLE.get(kind).unwrap_or_else(|| panic!("oracle.json has no {kind}: run oracle.py"));
    let cases: Vec<T> = Deserialize::deserialize(cases).expect(kind);
    assert!(!cases.is_empty(), "{kind}");
    cases
}

/// Checks the relative error; 0 and infinite values must be equal.
#[track_caller]
pub(crate) fn close(found: f64, expected: f64, relative: f64) {
    let error = (found - expected).abs();
    assert!(
        error <= relative * expected.abs(),
        "{found} instead of {expected}: relative error {:e}",
        error / expected.abs()
    );
}
