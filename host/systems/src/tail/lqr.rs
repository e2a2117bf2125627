//! Linear quadratic regulators in discrete time.

use nalgebra::SMatrix;

/// Limit of doublings for the Riccati equation. Each squares the closed loop's contraction, so that 40 suffice for
/// eigenvalues up to `1 - 1e-11`.
const DOUBLINGS: usize = 40;
/// Relative change of the solution at which it has converged: the rounding of sums of ten products.
const SETTLED: f64 = 1e-13;

/// Reason why there is no regulator.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum LqrError {
    /// No gain stabilises the system, or the weights do not contain an unstable part of it.
    #[error(
        "the Riccati equation has no stabilising solution: check that all that is unstable can be driven and is weighted"
    )]
    NotStabilisable,
    /// The weight of the inputs has no inverse.
    #[error("the weight of the inputs must be positive definite")]
    InputWeight,
}

/// Samples a system with a zero-order hold of `step_s`: `x' = A x + B u` becomes `x[k+1] = Ad x[k] + Bd u[k]`.
///
/// # Source
/// Van Loan, "Computing integrals involving the matrix exponential", IEEE TAC 23 (1978): both are blocks of one
/// exponential. Here its series is summed for a short step, which is then doubled.
#[must_use]
pub fn sampled<const N: usize, const M: usize>(
    a: &SMatrix<f64, N, N>,
    b: &SMatrix<f64, N, M>,
    step_s: f64,
) -> (SMatrix<f64, N, N>, SMatrix<f64, N, M>) {
    let doublings = (a.norm() * step_s).max(1e-300).log2().ceil().max(0.0) as u32 + 4;
    let short_s = step_s / 2f64.powi(doublings as i32);
    // Ad = I + a s + ..., and its integral.
    let mut term = SMatrix::<f64, N, N>::identity();
    let mut transition = term;
    let mut integral = term * short_s;
    // At a sixteenth of the norm the tenth term is below 1e-18.
    for order in 1..=10 {
        term = term * a * (short_s / f64::from(order));
        transition += term;
        integral += term * (short_s / f64::from(order + 1));
    }
    for _ in 0..doublings {
        integral += transition * integral;
        transition *= transition;
    }
    (transition, integral * b)
}

/// Finds the stabilising solution `P` of `P = A' P A - A' P B (R + B' P B)^-1 B' P A + Q`.
///
/// # Errors
/// [`LqrError::InputWeight`] when `R` has no inverse; [`LqrError::NotStabilisable`] when there is no such solution.
///
/// # Source
/// Chu, Fan, Lin, Wang, "Structure-preserving algorithms for periodic discrete-time algebraic Riccati equations", International Journal
/// of Control 77 (2004): the doubling algorithm, which converges quadratically.
pub fn riccati<const N: usize, const M: usize>(
    a: &SMatrix<f64, N, N>,
    b: &SMatrix<f64, N, M>,
    q: &SMatrix<f64, N, N>,
    r: &SMatrix<f64, M, M>,
) -> Result<SMatrix<f64, N, N>, LqrError> {
    let inverse = (*r).try_inverse().ok_or(LqrError::InputWeight)?;
    let (mut a, mut g, mut h) = (*a, b * inverse * b.transpose(), *q);
    for _ in 0..DOUBLINGS {
        let w = SMatrix::<f64, N, N>::identity() + g * h;
        let w = w.try_inverse().ok_or(LqrError::NotStabilisable)?;
        let next_h = h + a.transpose() * h * w * a;
        let next_g = g + a * w * g * a.transpose();
        a = a * w * a;
        let change = (next_h - h).norm();
        (g, h) = ((next_g + next_g.transpose()) * 0.5, (next_h + next_h.transpose()) * 0.5);
        if !h.norm().is_finite() {
            return Err(LqrError::NotStabilisable);
        }
        if change <= SETTLED * h.norm() {
            return Ok(h);
        }
    }
    Err(LqrError::NotStabilisable)
}

/// Computes the gain `K` of `u = -K x` that minimises the sum of `x' Q x + u' R u`.
///
/// # Errors
/// The errors of [`riccati`].
pub fn gain<const N: usize, const M: usize>(
    a: &SMatrix<f64, N, N>,
    b: &SMatrix<f64, N, M>,
    q: &SMatrix<f64, N, N>,
    r: &SMatrix<f64, M, M>,
) -> Result<SMatrix<f64, M, N>, LqrError> {
    let p = riccati(a, b, q, r)?;
    let cost = r + b.transpose() * p * b;
    Ok(cost.try_inverse().ok_or(LqrError::InputWeight)? * b.transpose() * p * a)
}

#[cfg(test)]
mod tests {
    use nalgebra::{Matrix1, Matrix2, Vector2, matrix, vector};

    use super::*;

    /// The scalar system `x[k+1] = a x + b u`, for which `P` solves a quadratic equation.
    #[test]
    fn a_scalar_has_the_closed_form() {
        for (a, b, q, r) in [(1.0, 1.0, 1.0, 1.0), (1.2, 0.3, 0.5, 2.0), (0.5, 1.0, 1.0, 0.1)] {
            let p = riccati(&Matrix1::new(a), &Matrix1::new(b), &Matrix1::new(q), &Matrix1::new(r)).unwrap()[0];
            // b² P² + (r - a² r - b² q) P - q r = 0
            let (b2, half): (f64, f64) = (b * b, 0.5 * (r - a * a * r - b * b * q));
            let expected = (-half + (half * half + b2 * q * r).sqrt()) / b2;
            assert!((p / expected - 1.0).abs() < 1e-12, "{p}, {expected}");
        }
    }

    /// Reference values of scipy 1.17.1, `solve_discrete_are` and `cont2discrete`, for an inverted pendulum at 10 ms.
    #[test]
    fn a_pendulum_has_scipys_solution() {
        let (a, b) = sampled(&matrix![0.0, 1.0; 9.0, -0.4], &vector![0.0, 2.0], 0.01);
        let [[a00, a01], [a10, a11]] = SCIPY_A;
        assert!((a - Matrix2::new(a00, a01, a10, a11)).norm() < 1e-14, "{a}");
        assert!((b - Vector2::new(SCIPY_B[0], SCIPY_B[1])).norm() < 1e-14, "{b}");
        let p = riccati(&a, &b, &Matrix2::new(10.0, 0.0, 0.0, 1.0), &Matrix1::new(0.1)).unwrap();
        let [[p00, p01], [p10, p11]] = SCIPY_P;
        // scipy uses a Schur form, whose own residual is 1e-12 of the norm.
        assert!((p - Matrix2::new(p00, p01, p10, p11)).norm() < 1e-10 * p.norm(), "{p}");
    }

    #[test]
    fn what_cannot_be_driven_is_refused() {
        let a = matrix![1.1, 0.0; 0.0, 0.9];
        let nothing = vector![0.0, 1.0];
        let refused = riccati(&a, &nothing, &Matrix2::identity(), &Matrix1::new(1.0));
        assert_eq!(refused, Err(LqrError::NotStabilisable));
        let refused = riccati(&a, &vector![1.0, 0.0], &Matrix2::identity(), &Matrix1::new(0.0));
        assert_eq!(refused, Err(LqrError::InputWeight));
    }

    const SCIPY_A: [[f64; 2]; 2] =
        [[1.000449434296585, 0.009981523710984718], [0.08983371339886247, 0.9964568248121912]];
    const SCIPY_B: [f64; 2] = [9.987428813001357e-05, 0.01996304742196944];
    const SCIPY_P: [[f64; 2]; 2] = [[567.9364296062888, 77.36071264287949], [77.36071264287949, 24.76972514141127]];
}
