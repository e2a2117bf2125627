//! Piecewise cubic curves through knots.

use thiserror::Error;

/// Reason why no curve goes through the knots.
#[derive(Clone, Copy, Debug, PartialEq, Error)]
pub enum SplineError {
    /// Knots and values differ in number, or there are none.
    #[error("{knots} knots for {values} values: give one value for each of at least one knot")]
    Count {
        /// Number of knots given.
        knots: usize,
        /// Number of values given.
        values: usize,
    },
    /// A knot is not greater than the previous one, or a number is not finite.
    #[error(
        "knot {index} is not greater than the one before, or it or its value is not finite: sort and clean the table"
    )]
    Knot {
        /// Position of the knot, from 0.
        index: usize,
    },
}

/// Piecewise cubic through knots: constant beyond both ends, or periodic.
#[derive(Clone, Debug, PartialEq)]
pub struct Spline {
    knots: Vec<f64>,
    /// Polynomial coefficients per piece, in powers of the distance from its left knot.
    pieces: Vec<[f64; 4]>,
    period: Option<f64>,
}

impl Spline {
    /// Makes a cubic Bessel interpolation: at each knot the slope is that of a parabola through three knots.
    ///
    /// Linear in the values, so that a fit can differentiate it; one value changes at most two pieces on each side.
    /// `knots` increase, over less than a `period`. Nothing is checked: this is for use inside of a fit, and
    /// [`Self::bessel`] is for tables.
    ///
    /// # Source
    /// de Boor, *A Practical Guide to Splines*, Springer 1978, chapter IV (cubic Bessel interpolation).
    ///
    /// ```
    /// use r4_maths::spline::Spline;
    /// let once = Spline::through(&[0.0, 1.0, 2.0], &[0.0, 1.0, 4.0], None);
    /// assert_eq!(once.value(1.5), 2.25);
    /// ```
    #[must_use]
    pub fn through(knots: &[f64], values: &[f64], period: Option<f64>) -> Self {
        let at = knots;
        let count = at.len().min(values.len());
        // Straight pieces from each knot to the next: length and slope.
        let straight = |knot: usize| {
            let next = (knot + 1) % count;
            let round = if next == 0 { period.unwrap_or(0.0) } else { 0.0 };
            let length = at[next] + round - at[knot];
            (length, if length > 0.0 { (values[next] - values[knot]) / length } else { 0.0 })
        };
        let parabola = |(near, slope): (f64, f64), (far, other): (f64, f64), inside: bool| {
            let both = near + far;
            match (both > 0.0, inside) {
                (false, _) => slope,
                (true, true) => (far * slope + near * other) / both,
                (true, false) => slope + near * (slope - other) / both,
            }
        };
        let slope = |knot: usize| match (knot, period) {
            _ if count < 2 => 0.0,
            (_, Some(_)) => parabola(straight((knot + count - 1) % count), straight(knot), true),
            _ if count == 2 => straight(0).1,
            (0, None) => parabola(straight(0), straight(1), false),
            _ if knot + 1 == count => parabola(straight(knot - 1), straight(knot - 2), false),
            _ => parabola(straight(knot - 1), straight(knot), true),
        };
        let slopes: Vec<f64> = (0..count).map(slope).collect();
        Self::hermite(&at[..count], &values[..count], &slopes, period)
    }

    /// Makes the same curve as [`Self::through`] from a table that a user wrote, which is checked.
    ///
    /// # Errors
    /// [`SplineError`].
    ///
    /// # Source
    /// de Boor, *A Practical Guide to Splines*, Springer 1978, chapter IV (cubic Bessel interpolation).
    ///
    /// ```
    /// use r4_maths::spline::{Spline, SplineError};
    /// assert_eq!(Spline::bessel(&[1.0, 1.0], &[0.0, 1.0]), Err(SplineError::Knot { index: 1 }));
    /// ```
    pub fn bessel(knots: &[f64], values: &[f64]) -> Result<Self, SplineError> {
        checked(knots, values)?;
        Ok(Self::through(knots, values, None))
    }

    /// Makes a natural cubic spline: two continuous derivatives, no curvature at the ends. Overshoots beside steps.
    ///
    /// # Errors
    /// [`SplineError`].
    ///
    /// # Source
    /// de Boor, *A Practical Guide to Splines*, Springer 1978, chapter IV (free-end condition).
    ///
    /// ```
    /// use r4_maths::spline::Spline;
    /// let hill = Spline::natural(&[0.0, 1.0, 2.0], &[0.0, 1.0, 0.0]).unwrap();
    /// assert_eq!((hill.value(0.5), hill.slope(1.0)), (0.6875, 0.0));
    /// ```
    pub fn natural(knots: &[f64], values: &[f64]) -> Result<Self, SplineError> {
        let straight = checked(knots, values)?;
        let last = straight.len();
        if last == 0 {
            return Ok(Self::hermite(knots, values, &[0.0], None));
        }
        // Continuous second derivatives: a tridiagonal system for the slopes, solved from the first to the last and back
        // (Thomas). Its diagonal is twice the sum of the others, so that nothing is divided by 0.
        let row = |knot: usize| {
            let [before, after] = [knot.checked_sub(1), Some(knot).filter(|knot| *knot < last)]
                .map(|piece| piece.map_or((0.0, 0.0), |piece: usize| (1.0 / straight[piece].0, straight[piece].1)));
            (before.0, 2.0 * (before.0 + after.0), after.0, 3.0 * (before.0 * before.1 + after.0 * after.1))
        };
        let mut swept: Vec<(f64, f64)> = Vec::with_capacity(last + 1);
        for knot in 0..=last {
            let (left, middle, right, side) = row(knot);
            let (above, known) = swept.last().copied().unwrap_or((0.0, 0.0));
            let pivot = middle - left * above;
            swept.push((right / pivot, (side - left * known) / pivot));
        }
        let mut slopes = vec![0.0; last + 1];
        let mut next = 0.0;
        for (slope, (above, known)) in slopes.iter_mut().zip(swept).rev() {
            *slope = known - above * next;
            next = *slope;
        }
        Ok(Self::hermite(knots, values, &slopes, None))
    }

    /// Makes a monotone cubic (PCHIP): nowhere beyond its neighbouring values, one continuous derivative. For tables of
    /// quantities that cannot overshoot, such as a valve's flow.
    ///
    /// # Errors
    /// [`SplineError`].
    ///
    /// # Source
    /// Fritsch, Butland, "A Method for Constructing Local Monotone Piecewise Cubic Interpolants", SIAM Journal on Scientific and
    /// Statistical Computing 5, 1984; ends as Moler, *Numerical Computing with MATLAB*, SIAM 2004, 3.4.
    ///
    /// ```
    /// use r4_maths::spline::Spline;
    /// let step = Spline::monotone(&[0.0, 1.0, 2.0, 3.0], &[0.0, 0.0, 1.0, 1.0]).unwrap();
    /// assert_eq!((step.value(0.5), step.value(1.5), step.value(2.5)), (0.0, 0.5, 1.0));
    /// ```
    pub fn monotone(knots: &[f64], values: &[f64]) -> Result<Self, SplineError> {
        let straight = checked(knots, values)?;
        let last = straight.len();
        let end = |(near, slope): (f64, f64), (far, other): (f64, f64)| {
            // Slope of the parabola through three knots, limited so that the end piece stays monotone (Moler, 3.4).
            let estimate = ((2.0 * near + far) * slope - near * other) / (near + far);
            if estimate * slope <= 0.0 {
                0.0
            } else if slope * other <= 0.0 && estimate.abs() > 3.0 * slope.abs() {
                3.0 * slope
            } else {
                estimate
            }
        };
        let slope = |knot: usize| match knot {
            _ if last == 0 => 0.0,
            _ if last == 1 => straight[0].1,
            0 => end(straight[0], straight[1]),
            _ if knot == last => end(straight[last - 1], straight[last - 2]),
            _ => {
                let ((before, a), (after, b)) = (straight[knot - 1], straight[knot]);
                let (first, second) = (2.0 * after + before, after + 2.0 * before);
                // Flat at a local extreme; otherwise a weighted harmonic mean, which never exceeds three times the
                // lower slope.
                if a * b <= 0.0 { 0.0 } else { (first + second) / (first / a + second / b) }
            }
        };
        let slopes: Vec<f64> = (0..knots.len()).map(slope).collect();
        Ok(Self::hermite(knots, values, &slopes, None))
    }

    /// Makes cubics with these values and slopes at the knots.
    fn hermite(knots: &[f64], values: &[f64], slopes: &[f64], period: Option<f64>) -> Self {
        let count = knots.len();
        let piece = |knot: usize| {
            let is_last = knot + 1 == count;
            // Constant beyond the last knot.
            if count < 2 || (is_last && period.is_none()) {
                return [values[knot], 0.0, 0.0, 0.0];
            }
            let next = (knot + 1) % count;
            let length = knots[next] + if next == 0 { period.unwrap_or(0.0) } else { 0.0 } - knots[knot];
            // Only for unchecked knots: a piece without length is constant.
            if length <= 0.0 {
                return [values[knot], 0.0, 0.0, 0.0];
            }
            let straight = (values[next] - values[knot]) / length;
            let (from, to) = (slopes[knot], slopes[next]);
            let (square, cube) = ((3.0 * straight - 2.0 * from - to) / length, (from + to - 2.0 * straight) / length);
            [values[knot], from, square, cube / length]
        };
        Self { knots: knots.to_vec(), pieces: (0..count).map(piece).collect(), period }
    }

    /// Returns the value at `x`; 0 without any knot.
    ///
    /// ```
    /// use r4_maths::spline::Spline;
    /// let line = Spline::bessel(&[0.0, 2.0], &[0.0, 1.0]).unwrap();
    /// assert_eq!([-1.0, 0.5, 9.0].map(|x| line.value(x)), [0.0, 0.25, 1.0]);
    /// ```
    #[must_use]
    #[inline]
    pub fn value(&self, x: f64) -> f64 {
        let Some((knot, distance)) = self.piece(x) else { return self.pieces.first().map_or(0.0, |piece| piece[0]) };
        let [value, slope, square, cube] = self.pieces[knot];
        // Beyond the last knot the distance may be infinite, which must not be multiplied by 0.
        if slope == 0.0 && square == 0.0 && cube == 0.0 {
            return value;
        }
        value + distance * (slope + distance * (square + distance * cube))
    }

    /// Returns the first derivative at `x`; 0 beyond the ends, where the value is constant.
    ///
    /// ```
    /// use r4_maths::spline::Spline;
    /// let parabola = Spline::bessel(&[0.0, 1.0, 3.0], &[0.0, 1.0, 9.0]).unwrap();
    /// assert!((parabola.slope(2.0) - 4.0).abs() < 1e-12);
    /// assert_eq!(parabola.slope(3.5), 0.0);
    /// ```
    #[must_use]
    pub fn slope(&self, x: f64) -> f64 {
        let Some((knot, distance)) = self.piece(x) else { return 0.0 };
        let [_, slope, square, cube] = self.pieces[knot];
        if slope == 0.0 && square == 0.0 && cube == 0.0 {
            return 0.0;
        }
        slope + distance * (2.0 * square + distance * 3.0 * cube)
    }

    /// Returns the index of the piece at `x`: that of the knot before it, or 0 before the first knot.
    ///
    /// ```
    /// use r4_maths::spline::Spline;
    /// let line = Spline::bessel(&[0.0, 2.0], &[0.0, 1.0]).unwrap();
    /// assert_eq!([-1.0, 0.5, 9.0].map(|x| line.piece_at(x)), [0, 0, 1]);
    /// ```
    #[must_use]
    pub fn piece_at(&self, x: f64) -> usize {
        self.piece(x).map_or(0, |(knot, _)| knot)
    }

    /// Compares each piece with that of another curve through the same knots; true where they differ.
    ///
    /// ```
    /// use r4_maths::spline::Spline;
    /// let [one, other] =
    ///     [0.0, 1.0].map(|last| Spline::bessel(&[0.0, 1.0, 2.0, 3.0, 4.0], &[0.0, 0.0, 0.0, 0.0, last]).unwrap());
    /// assert_eq!(one.pieces_unlike(&other).collect::<Vec<_>>(), [false, false, true, true, true]);
    /// ```
    pub fn pieces_unlike(&self, other: &Self) -> impl Iterator<Item = bool> {
        self.pieces.iter().zip(&other.pieces).map(|(piece, other)| piece != other)
    }

    /// Returns the index of the piece at `x`, and the distance from its knot; `None` before the first knot.
    #[inline]
    fn piece(&self, x: f64) -> Option<(usize, f64)> {
        let first = *self.knots.first()?;
        let x = self.period.map_or(x, |period| first + (x - first).rem_euclid(period));
        // Few knots: counting them all is faster than a binary search.
        let knot = self.knots.iter().filter(|&&knot| knot <= x).count().checked_sub(1)?;
        Some((knot, x - self.knots[knot]))
    }

    /// Returns knots and values of a polyline that follows the curve, with `each` straight pieces for one of the
    /// curve's.
    ///
    /// ```
    /// use r4_maths::spline::Spline;
    /// let parabola = Spline::bessel(&[0.0, 1.0, 2.0], &[0.0, 1.0, 4.0]).unwrap();
    /// assert_eq!(parabola.polyline(2), (vec![0.0, 0.5, 1.0, 1.5, 2.0], vec![0.0, 0.25, 1.0, 2.25, 4.0]));
    /// ```
    #[must_use]
    pub fn polyline(&self, each: u32) -> (Vec<f64>, Vec<f64>) {
        let first = self.knots.first().unwrap_or(&0.0);
        let ends = self.knots.iter().skip(1).copied().chain(self.period.map(|period| first + period));
        let inside = self.knots.iter().zip(ends).flat_map(|(&from, to)| {
            (0..each.max(1)).map(move |part| from + (to - from) * f64::from(part) / f64::from(each.max(1)))
        });
        // A periodic curve goes on at its first knot, which is listed already.
        let last = if self.period.is_none() { self.knots.last().copied() } else { None };
        let at: Vec<f64> = inside.chain(last).collect();
        let values = at.iter().map(|&at| self.value(at)).collect();
        (at, values)
    }
}

/// Checks the knots and returns the length and slope of each straight piece.
fn checked(knots: &[f64], values: &[f64]) -> Result<Vec<(f64, f64)>, SplineError> {
    if knots.is_empty() || knots.len() != values.len() {
        return Err(SplineError::Count { knots: knots.len(), values: values.len() });
    }
    let is_bad = |index: &usize| {
        // Written so that NaN, which compares false, counts as bad.
        let before = index.checked_sub(1).map_or(f64::NEG_INFINITY, |before| knots[before]);
        !(knots[*index] > before && knots[*index].is_finite() && values[*index].is_finite())
    };
    if let Some(index) = (0..knots.len()).find(is_bad) {
        return Err(SplineError::Knot { index });
    }
    let pairs = knots.windows(2).zip(values.windows(2));
    Ok(pairs.map(|(x, y)| (x[1] - x[0], (y[1] - y[0]) / (x[1] - x[0]))).collect())
}
