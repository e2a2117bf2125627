//! Smooth curves through corners.

/// A cubic through each pair of corners, with the slope of a parabola through three at each: it is linear in the values, so
/// that a fit can follow it, and one value moves no more than two pieces on each side.
///
/// # Source
/// C. de Boor, *A Practical Guide to Splines*, Springer 1978, chapter IV (cubic Bessel interpolation).
#[derive(Clone, Debug, PartialEq)]
pub struct Spline {
    at: Vec<f64>,
    /// From each corner on, by powers of the way from there.
    pieces: Vec<[f64; 4]>,
    period: Option<f64>,
}

impl Spline {
    /// Through a value at each of some increasing corners; constant beyond both ends, or round a circle as long as the
    /// period.
    #[must_use]
    pub fn through(at: &[f64], values: &[f64], period: Option<f64>) -> Self {
        let count = at.len().min(values.len());
        // The piece from a corner to the next: its length, and its slope if it were straight.
        let straight = |corner: usize| {
            let next = (corner + 1) % count;
            let round = if next == 0 { period.unwrap_or(0.0) } else { 0.0 };
            let length = at[next] + round - at[corner];
            (length, if length > 0.0 { (values[next] - values[corner]) / length } else { 0.0 })
        };
        let parabola = |(near, slope): (f64, f64), (far, other): (f64, f64), inside: bool| {
            let both = near + far;
            match (both > 0.0, inside) {
                (false, _) => slope,
                (true, true) => (far * slope + near * other) / both,
                (true, false) => slope + near * (slope - other) / both,
            }
        };
        let slope = |corner: usize| match (corner, period) {
            _ if count < 2 => 0.0,
            (_, Some(_)) => parabola(straight((corner + count - 1) % count), straight(corner), true),
            _ if count == 2 => straight(0).1,
            (0, None) => parabola(straight(0), straight(1), false),
            _ if corner + 1 == count => parabola(straight(corner - 1), straight(corner - 2), false),
            _ => parabola(straight(corner - 1), straight(corner), true),
        };
        let slopes: Vec<f64> = (0..count).map(slope).collect();
        let piece = |corner: usize| {
            let is_last = corner + 1 == count;
            if count < 2 || (is_last && period.is_none()) {
                return [values[corner], 0.0, 0.0, 0.0];
            }
            let (length, straight) = straight(corner);
            let (from, to) = (slopes[corner], slopes[(corner + 1) % count]);
            if length <= 0.0 {
                return [values[corner], 0.0, 0.0, 0.0];
            }
            let (square, cube) = ((3.0 * straight - 2.0 * from - to) / length, (from + to - 2.0 * straight) / length);
            [values[corner], from, square, cube / length]
        };
        Self { at: at[..count].to_vec(), pieces: (0..count).map(piece).collect(), period }
    }

    /// The value at `x`; 0 without any corner.
    #[must_use]
    pub fn value(&self, x: f64) -> f64 {
        let (Some(&first), Some(piece)) = (self.at.first(), self.pieces.first()) else { return 0.0 };
        let x = self.period.map_or(x, |period| first + (x - first).rem_euclid(period));
        // Few corners: counting them all is faster than looking for the right one.
        let Some(corner) = self.at.iter().filter(|&&at| at <= x).count().checked_sub(1) else { return piece[0] };
        let ([value, slope, square, cube], way) = (self.pieces[corner], x - self.at[corner]);
        if slope == 0.0 && square == 0.0 && cube == 0.0 {
            return value;
        }
        value + way * (slope + way * (square + way * cube))
    }

    /// Corners of straight pieces that follow it, so many for each of its own.
    #[must_use]
    pub fn corners(&self, each: u32) -> (Vec<f64>, Vec<f64>) {
        let ends =
            self.at.iter().skip(1).copied().chain(self.period.map(|period| self.at.first().unwrap_or(&0.0) + period));
        let inside = self.at.iter().zip(ends).flat_map(|(&from, to)| {
            (0..each.max(1)).map(move |part| from + (to - from) * f64::from(part) / f64::from(each.max(1)))
        });
        let last = if self.period.is_none() { self.at.last().copied() } else { None };
        let at: Vec<f64> = inside.chain(last).collect();
        let values = at.iter().map(|&at| self.value(at)).collect();
        (at, values)
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::TAU;

    use super::*;

    #[test]
    fn a_parabola_is_itself_and_ends_are_constant() {
        let at = [-1.0, 0.0, 0.5, 2.0, 2.5];
        let of = |x: f64| 1.0 - 2.0 * x + 0.5 * x * x;
        let spline = Spline::through(&at, &at.map(of), None);
        for x in [-1.0, -0.3, 0.0, 0.2, 1.1, 1.9, 2.3, 2.5] {
            assert!((spline.value(x) - of(x)).abs() < 1e-12, "{x}: {}", spline.value(x));
        }
        assert_eq!([spline.value(-9.0), spline.value(f64::INFINITY)], [of(-1.0), of(2.5)]);
    }

    #[test]
    fn a_wave_goes_round_without_a_seam() {
        let at: Vec<f64> = (0..12).map(|n| f64::from(n) * TAU / 12.0).collect();
        let values: Vec<f64> = at.iter().map(|x| (x + 1.0).sin()).collect();
        let spline = Spline::through(&at, &values, Some(TAU));
        let (fine, told) = spline.corners(8);
        assert_eq!((fine.len(), fine[8], told[8]), (96, at[1], values[1]));
        for n in -200..200 {
            let x = 0.1 * f64::from(n);
            // Slopes are off by h² / 6 (h = TAU / 12), which moves a cubic by h times 0.096 of that; the rest is less.
            assert!((spline.value(x) - (x + 1.0).sin()).abs() < 0.003, "{x}: {}", spline.value(x));
        }
    }

    #[test]
    fn few_corners_are_lines() {
        assert_eq!(Spline::through(&[], &[], None).value(1.0), 0.0);
        assert_eq!(Spline::through(&[3.0], &[2.0], None).value(1.0), 2.0);
        assert_eq!(Spline::through(&[3.0], &[2.0], Some(1.0)).value(7.5), 2.0);
        let line = Spline::through(&[0.0, 2.0], &[0.0, 1.0], None);
        assert_eq!([-1.0, 0.5, 9.0].map(|x| line.value(x)), [0.0, 0.25, 1.0]);
    }
}
