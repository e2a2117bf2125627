//! Roots of functions of one number.

use thiserror::Error;

/// Reason why no root was found.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum RootError {
    /// The function has the same sign at both ends.
    #[error(
        "the function is {at_low} at one end and {at_high} at the other: choose ends with a change of sign between them"
    )]
    SameSign {
        /// Value of the function at the lower end.
        at_low: f64,
        /// Value of the function at the upper end.
        at_high: f64,
    },
    /// One of the ends, or the tolerance, is not usable.
    #[error("{0} is no end of an interval, or no tolerance")]
    Input(f64),
    /// The function is NaN somewhere between the ends.
    #[error("the function has no value at {at}")]
    NotANumber {
        /// Argument at which it is NaN.
        at: f64,
    },
}

/// Limit of the number of halvings: more than f64 has between its greatest and its least difference.
const MOST: usize = 2200;

/// Finds a root between `low` and `high` by bisection, to `tolerance` (in their unit) or the last bit that f64 has
/// there.
///
/// Slow and reliable: one evaluation for each bit. Where the function jumps over 0, returns the jump.
///
/// # Errors
/// [`RootError`].
///
/// # Source
/// Press, Teukolsky, Vetterling, Flannery, *Numerical Recipes*, 3rd edition, Cambridge 2007, 9.1.1.
///
/// ```
/// let root = r4_maths::root::bisect(|x| x * x - 2.0, 0.0, 2.0, 1e-12).unwrap();
/// assert!((root - 2.0f64.sqrt()).abs() <= 1e-12);
/// ```
pub fn bisect(f: impl Fn(f64) -> f64, low: f64, high: f64, tolerance: f64) -> Result<f64, RootError> {
    let (mut a, mut b) = ends(&f, low, high, tolerance)?;
    for _ in 0..MOST {
        let middle = f64::midpoint(a.0, b.0);
        if a.1 == 0.0 || (b.0 - a.0).abs() <= tolerance || middle == a.0 || middle == b.0 {
            break;
        }
        let value = number(&f, middle)?;
        if value == 0.0 {
            return Ok(middle);
        }
        if value.signum() == a.1.signum() { a = (middle, value) } else { b = (middle, value) }
    }
    Ok(if a.1.abs() < b.1.abs() { a.0 } else { b.0 })
}

/// Finds a root between `low` and `high` by Brent's method, to `tolerance` (in their unit) or a few last bits.
///
/// As reliable as [`bisect`], and for smooth functions several times faster.
///
/// # Errors
/// [`RootError`].
///
/// # Source
/// Brent, *Algorithms for Minimization without Derivatives*, Prentice Hall 1973, chapter 4.
///
/// ```
/// // Where a motor's friction torque equals that of its current: 0.05 + 0.002 w = 0.3 - 0.01 w, w in rad/s.
/// let speed_rad_s = r4_maths::root::brent(|w| 0.3 - 0.01 * w - 0.05 - 0.002 * w, 0.0, 100.0, 1e-9).unwrap();
/// assert!((speed_rad_s - 0.25 / 0.012).abs() < 1e-9);
/// ```
pub fn brent(f: impl Fn(f64) -> f64, low: f64, high: f64, tolerance: f64) -> Result<f64, RootError> {
    let (mut a, mut b) = ends(&f, low, high, tolerance)?;
    // b is the best point, c is on the other side of the root, a is the previous b.
    let mut c = a;
    let mut step = b.0 - a.0;
    let mut before = step;
    for _ in 0..MOST {
        // The last step did not cross the root: a is on its other side, and the bracket starts again there.
        if b.1.signum() == c.1.signum() {
            c = a;
            step = b.0 - a.0;
            before = step;
        }
        if c.1.abs() < b.1.abs() {
            (a, b, c) = (b, c, b);
        }
        let nearest = 2.0 * f64::EPSILON * b.0.abs() + 0.5 * tolerance;
        let half = 0.5 * (c.0 - b.0);
        if half.abs() <= nearest || b.1 == 0.0 {
            break;
        }
        // Earlier steps were tiny or did not improve: interpolation fails here, so bisect.
        if before.abs() < nearest || a.1.abs() <= b.1.abs() {
            (step, before) = (half, half);
        } else {
            let s = b.1 / a.1;
            // With two distinct points a secant, with three inverse quadratic interpolation; the step is p / q.
            let (mut p, mut q) = if a.0 == c.0 {
                (2.0 * half * s, 1.0 - s)
            } else {
                let (q, r) = (a.1 / c.1, b.1 / c.1);
                (s * (2.0 * half * q * (q - r) - (b.0 - a.0) * (r - 1.0)), (q - 1.0) * (r - 1.0) * (s - 1.0))
            };
            if p > 0.0 {
                q = -q
            } else {
                p = -p
            }
            // Accepted only well inside of the bracket, and below half of the step before the last, so that steps
            // shrink.
            let is_inside = 2.0 * p < (3.0 * half * q - (nearest * q).abs()).min((before * q).abs());
            (before, step) = if is_inside { (step, p / q) } else { (half, half) };
        }
        a = b;
        // At least the tolerance, or the points could not close in from both sides.
        let to = b.0 + if step.abs() > nearest { step } else { nearest.copysign(half) };
        b = (to, number(&f, to)?);
    }
    Ok(b.0)
}

type Point = (f64, f64);

fn ends(f: &impl Fn(f64) -> f64, low: f64, high: f64, tolerance: f64) -> Result<(Point, Point), RootError> {
    if let Some(value) = [low, high].into_iter().find(|value| !value.is_finite()) {
        return Err(RootError::Input(value));
    }
    if !(tolerance.is_finite() && tolerance >= 0.0) {
        return Err(RootError::Input(tolerance));
    }
    let (a, b) = ((low, number(f, low)?), (high, number(f, high)?));
    // An end that is the root has no other sign to bracket with.
    if a.1 == 0.0 {
        return Ok((a, a));
    }
    if b.1 == 0.0 {
        return Ok((b, b));
    }
    if a.1.signum() == b.1.signum() {
        return Err(RootError::SameSign { at_low: a.1, at_high: b.1 });
    }
    Ok((a, b))
}

fn number(f: &impl Fn(f64) -> f64, at: f64) -> Result<f64, RootError> {
    let value = f(at);
    if value.is_nan() { Err(RootError::NotANumber { at }) } else { Ok(value) }
}
