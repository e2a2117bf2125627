//! Exact discretisation of a linear system whose inputs are constant over the step.
//!
//! For `dx/dt = A x + b` with constant `b`, a step of `h` is `x(h) = E x(0) + P b` and its integral
//! `∫x = P x(0) + Q b`, with `E = exp(A h)`, `P = ∫E`, `Q = ∫P`. The inputs, not the stiffness of the system, limit the
//! step: the electrical time constant of a motor sets no limit.

/// Discretised first-order system `dx/dt = b - rate · x`, for one step length.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct FirstOrder {
    /// Transition `E = exp(-rate · h)`: share of the initial state that remains after the step.
    pub(crate) kept: f64,
    /// Integral `P = ∫E` over the step, s.
    pub(crate) integral: f64,
    /// Double integral `Q = ∫P` over the step, s².
    pub(crate) double_integral: f64,
}

impl FirstOrder {
    /// Discretises for `rate`, 1/s, not negative, and a step of `step_s`.
    pub(crate) fn new(rate: f64, step_s: f64) -> Self {
        let z = rate * step_s;
        if z < 1e-2 {
            // Below 1e-2 the closed form loses 1/z of its digits; the omitted terms of this series are below z⁵/2520 =
            // 4e-14.
            let double = 0.5 - z * (1.0 / 6.0 - z * (1.0 / 24.0 - z * (1.0 / 120.0 - z / 720.0)));
            let double_integral = step_s * step_s * double;
            let integral = step_s - rate * double_integral;
            return Self { kept: 1.0 - rate * integral, integral, double_integral };
        }
        let lost = -libm::expm1(-z);
        let integral = lost / rate;
        Self { kept: 1.0 - lost, integral, double_integral: (step_s - integral) / rate }
    }
}

/// Matrix `a I + b A` for a 2 x 2 matrix `A` known by trace and determinant. Every function of `A` has this form
/// (Cayley-Hamilton), so a product of two takes a few multiplications.
#[derive(Clone, Copy, Debug)]
struct Polynomial {
    a: f64,
    b: f64,
}

impl Polynomial {
    fn plus(self, other: Self) -> Self {
        Self { a: self.a + other.a, b: self.b + other.b }
    }

    fn scaled(self, factor: f64) -> Self {
        Self { a: factor * self.a, b: factor * self.b }
    }

    /// Product of two polynomials, reduced by `A² = trace · A - determinant · I`.
    fn times(self, other: Self, trace: f64, determinant: f64) -> Self {
        let square = self.b * other.b;
        Self { a: self.a * other.a - square * determinant, b: self.a * other.b + self.b * other.a + square * trace }
    }

    /// Product with `A` itself.
    fn times_matrix(self, trace: f64, determinant: f64) -> Self {
        Self { a: -self.b * determinant, b: self.a + self.b * trace }
    }

    fn of(self, matrix: [[f64; 2]; 2]) -> [[f64; 2]; 2] {
        let [[m00, m01], [m10, m11]] = matrix;
        [[self.a + self.b * m00, self.b * m01], [self.b * m10, self.a + self.b * m11]]
    }
}

/// Reciprocals 1/3, 1/4 … 1/16: a multiplication is several times as fast as a division.
const RECIPROCALS: [f64; 14] = {
    let mut table = [1.0; 14];
    let mut n = 0;
    while n < table.len() {
        table[n] = 1.0 / (n as f64 + 3.0);
        n += 1;
    }
    table
};

/// Discretised second-order system `dx/dt = A x + b`, for one step length.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SecondOrder {
    /// Transition `E = exp(A h)`: state after the step from the state before.
    pub(crate) transition: [[f64; 2]; 2],
    /// Integral `P = ∫E`: state after the step from the constant input `b`.
    pub(crate) integral: [[f64; 2]; 2],
    /// Double integral `Q = ∫P`: integral of the state over the step from the constant input `b`.
    pub(crate) double_integral: [[f64; 2]; 2],
}

impl SecondOrder {
    /// Discretises by scaling and squaring: a power series over a step short against every time constant, doubled until
    /// it spans `step_s`. Serves overdamped, critical and oscillating systems alike.
    ///
    /// # Source
    /// Moler, Van Loan, *Nineteen dubious ways to compute the exponential of a matrix, twenty-five years later*,
    /// SIAM Review 45 (2003), method 3; the integrals doubled along with it.
    pub(crate) fn new(matrix: [[f64; 2]; 2], step_s: f64) -> Self {
        let [[m00, m01], [m10, m11]] = matrix;
        let (trace, determinant) = (m00 + m11, m00 * m11 - m01 * m10);
        // upper bound of the eigenvalues' magnitudes: their sum is the trace, their product the determinant
        let fastest = trace.abs() + libm::sqrt(determinant.abs());
        let (mut h, mut doublings) = (step_s, 0);
        while fastest * h >= 0.5 {
            h *= 0.5;
            doublings += 1;
        }

        // Terms h^(n+2) A^n / (n+2)! of Q; P = h I + A Q and E = I + A P follow. fastest · h is below 1/2, so what follows the
        // last term is below 2^-17 / 17! = 2e-20 of E; a short step needs fewer terms.
        let mut term = Polynomial { a: 0.5 * h * h, b: 0.0 };
        let mut q = term;
        let mut size = 1.0;
        for reciprocal in &RECIPROCALS {
            let per_n = h * reciprocal;
            term = term.times_matrix(trace, determinant).scaled(per_n);
            q = q.plus(term);
            size *= fastest * per_n;
            if size < 1e-18 {
                break;
            }
        }
        let mut p = q.times_matrix(trace, determinant).plus(Polynomial { a: h, b: 0.0 });
        let mut e = p.times_matrix(trace, determinant).plus(Polynomial { a: 1.0, b: 0.0 });
        // exp over 2h from exp over h; Q before P before E, because each update uses the undoubled values of the others
        for _ in 0..doublings {
            q = q.plus(p.scaled(h)).plus(e.times(q, trace, determinant));
            p = p.plus(e.times(p, trace, determinant));
            e = e.times(e, trace, determinant);
            h *= 2.0;
        }
        Self { transition: e.of(matrix), integral: p.of(matrix), double_integral: q.of(matrix) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn first_order_agrees_with_its_closed_form_on_both_sides_of_the_series() {
        for z in [0.0, 1e-9, 0.0099, 0.0101, 1.0, 40.0] {
            let (rate, step_s) = (z / 0.25, 0.25);
            let got = FirstOrder::new(rate, step_s);
            let kept = (-z).exp();
            assert!((got.kept - kept).abs() < 1e-15, "{z}");
            if z > 1e-3 {
                // the closed form of Q loses 1/z² of its digits: 1e-16 · 1e4 at the series' end
                let double_integral = (step_s - (1.0 - kept) / rate) / rate;
                assert!((got.double_integral / double_integral - 1.0).abs() < 1e-11, "{z}");
            } else {
                assert!((got.double_integral / (0.5 * step_s * step_s) - 1.0).abs() < 1e-9, "{z}");
            }
        }
    }

    #[test]
    fn a_diagonal_system_is_two_first_order_ones_even_when_stiff() {
        let got = SecondOrder::new([[-8e5, 0.0], [0.0, -3.0]], 2.5e-4);
        let [fast, slow] = [FirstOrder::new(8e5, 2.5e-4), FirstOrder::new(3.0, 2.5e-4)];
        for (index, expected) in [fast, slow].iter().enumerate() {
            // 8 doublings double the rounding of the start 8 times: 1e-16 · 256
            assert!((got.transition[index][index] - expected.kept).abs() < 1e-13);
            assert!((got.integral[index][index] / expected.integral - 1.0).abs() < 1e-9);
            assert!((got.double_integral[index][index] / expected.double_integral - 1.0).abs() < 1e-9);
        }
    }

    #[test]
    fn an_oscillator_turns_in_a_circle() {
        let (omega, step_s) = (40.0, 0.3);
        let got = SecondOrder::new([[0.0, omega], [-omega, 0.0]], step_s);
        let (sin, cos) = f64::sin_cos(omega * step_s);
        // 6 doublings of a rounding error
        assert!((got.transition[0][0] - cos).abs() < 1e-13 && (got.transition[0][1] - sin).abs() < 1e-13);
        assert!((got.integral[0][0] - sin / omega).abs() < 1e-14);
        assert!((got.double_integral[0][0] - (1.0 - cos) / omega.powi(2)).abs() < 1e-14);
    }
}
