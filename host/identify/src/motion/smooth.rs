//! Smoothing of series with noise.

use nalgebra::{Matrix3, Matrix4, Vector3, Vector4};

/// Least-squares parabola through points, evaluated at one time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Parabola {
    pub(super) value: f64,
    /// First derivative at that time.
    pub(super) slope: f64,
    /// Second derivative at that time.
    pub(super) bend: f64,
    /// Variances of value and slope, relative to that of a point.
    pub(super) variance: [f64; 2],
}

impl Parabola {
    /// Fits the parabola by least squares; `None` for fewer than four finite points.
    pub(super) fn through(times: &[f64], values: &[f64], at_s: f64) -> Option<Self> {
        let mut normal = Matrix3::<f64>::zeros();
        let mut right = Vector3::<f64>::zeros();
        let mut count = 0;
        for (time_s, value) in times.iter().zip(values) {
            if value.is_finite() {
                let t = time_s - at_s;
                let row = Vector3::new(1.0, t, 0.5 * t * t);
                normal += row * row.transpose();
                right += row * *value;
                count += 1;
            }
        }
        if count < 4 {
            return None;
        }
        let inverse = normal.try_inverse()?;
        let found = inverse * right;
        Some(Self { value: found[0], slope: found[1], bend: found[2], variance: [inverse[(0, 0)], inverse[(1, 1)]] })
    }
}

/// Least-squares fit of a uniform motion plus an oscillation, with Gaussian weights around one time.
#[derive(Clone, Copy, Debug)]
pub(super) struct Swinging {
    /// First three derivatives of the sum at that time.
    pub(super) derivatives: [f64; 3],
}

impl Swinging {
    /// Fits with an oscillation at `omega` rad/s and weights of standard deviation `width_s`; `None` for fewer than
    /// four points.
    pub(super) fn through(times: &[f64], values: &[f64], at_s: f64, (omega, width_s): (f64, f64)) -> Option<Self> {
        let mut normal = Matrix4::<f64>::zeros();
        let mut right = Vector4::<f64>::zeros();
        let mut count = 0;
        for (time_s, value) in times.iter().zip(values).filter(|(_, value)| value.is_finite()) {
            let t = time_s - at_s;
            let row = Vector4::new(1.0, t / width_s, (omega * t).cos(), (omega * t).sin());
            let weight = (-0.5 * (t / width_s).powi(2)).exp();
            normal += weight * row * row.transpose();
            right += weight * row * *value;
            count += 1;
        }
        if count < 4 {
            return None;
        }
        let [_, even, cosine, sine] = normal.cholesky()?.solve(&right).into();
        let derivatives = [even / width_s + omega * sine, -omega.powi(2) * cosine, -omega.powi(3) * sine];
        Some(Self { derivatives })
    }
}

/// Smoothed series with its derivative.
#[derive(Clone, Debug)]
pub(super) struct Smooth {
    pub(super) value: Vec<f64>,
    pub(super) slope: Vec<f64>,
    /// Standard errors of value and slope.
    pub(super) noise: [f64; 2],
}

/// Numbers of points on each side of a window's middle that are tried.
const HALF_WINDOWS: [usize; 8] = [2, 3, 5, 8, 12, 18, 27, 40];

impl Smooth {
    /// Smooths with parabolas over the window length that predicts left-out points best (leave-one-out
    /// cross-validation); `None` if no window has enough points.
    pub(super) fn of(time_s: &[f64], measured: &[f64]) -> Option<Self> {
        let of = |half: usize| {
            let through = |place: usize| {
                let window = place.saturating_sub(half)..(place + half + 1).min(time_s.len());
                Parabola::through(&time_s[window.clone()], &measured[window], time_s[place])
            };
            let all: Vec<Option<Parabola>> = (0..time_s.len()).map(through).collect();
            let (mut square, mut count) = (0.0, 0.0);
            for (parabola, value) in all.iter().zip(measured) {
                let Some(parabola) = parabola.filter(|_| value.is_finite()) else { continue };
                // The residual of a left-out point is that of the fit divided by one minus its leverage.
                let share = (1.0 - parabola.variance[0]).max(1e-3);
                square += ((value - parabola.value) / share).powi(2);
                count += 1.0;
            }
            (all, square / count)
        };
        let tried = HALF_WINDOWS.iter().map(|&half| of(half)).filter(|(_, error)| error.is_finite());
        let (all, square) = tried.min_by(|a, b| a.1.total_cmp(&b.1))?;
        let known: Vec<&Parabola> = all.iter().flatten().collect();
        let middle = known.get(known.len() / 2)?;
        let noise = middle.variance.map(|variance| (square * variance).sqrt());
        // Values without enough points around keep the last one.
        let filled = |of: fn(&Parabola) -> f64, first: f64| -> Vec<f64> {
            let mut last = first;
            all.iter()
                .map(|parabola| {
                    last = parabola.as_ref().map_or(last, of);
                    last
                })
                .collect()
        };
        let first = all.iter().flatten().next()?;
        Some(Self { value: filled(|at| at.value, first.value), slope: filled(|at| at.slope, 0.0), noise })
    }
}

#[cfg(test)]
mod tests {
    use rand_distr::{Distribution, Normal};
    use rand_pcg::Pcg64Mcg;

    use super::*;

    #[test]
    fn a_parabola_comes_out_as_it_is() {
        let times: Vec<f64> = (0..9).map(|n| 0.1 * f64::from(n)).collect();
        let values: Vec<f64> = times.iter().map(|t| 1.0 + 2.0 * t - 3.0 * t * t).collect();
        let at = Parabola::through(&times, &values, 0.4).expect("nine points");
        let expected = [1.0 + 0.8 - 0.48, 2.0 - 2.4, -6.0];
        assert!([at.value, at.slope, at.bend].iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{at:?}");
        assert!(Parabola::through(&times[..3], &values[..3], 0.1).is_none());
    }

    #[test]
    fn a_swing_on_a_uniform_motion_comes_out_as_it_is() {
        let times: Vec<f64> = (0..9).map(|n| 0.1 * f64::from(n)).collect();
        let values: Vec<f64> = times.iter().map(|t| 1.0 - 2.0 * t + 3.0 * (5.0 * t).sin()).collect();
        let found = Swinging::through(&times, &values, 0.4, (5.0, 0.2)).expect("nine points").derivatives;
        let phase = 2.0_f64;
        let expected = [-2.0 + 15.0 * phase.cos(), -75.0 * phase.sin(), -375.0 * phase.cos()];
        assert!(found.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-9), "{found:?}");
        assert!(Swinging::through(&times[..3], &values[..3], 0.1, (5.0, 0.2)).is_none());
    }

    #[test]
    fn noise_goes_and_what_is_under_it_stays() {
        let mut dice = Pcg64Mcg::new(7);
        let noise = Normal::new(0.0, 0.02).expect("a deviation");
        let times: Vec<f64> = (0..2000).map(|n| 0.005 * f64::from(n)).collect();
        let truth: Vec<f64> = times.iter().map(|t| (3.0 * t).sin()).collect();
        let mut measured: Vec<f64> = truth.iter().map(|value| value + noise.sample(&mut dice)).collect();
        measured[700..705].fill(f64::NAN);
        let smooth = Smooth::of(&times, &measured).expect("points enough");
        let rms = |of: &dyn Fn(usize) -> f64| ((100..1900).map(|n| of(n).powi(2)).sum::<f64>() / 1800.0).sqrt();
        let (value, slope) =
            (rms(&|n| smooth.value[n] - truth[n]), rms(&|n| smooth.slope[n] - 3.0 * (3.0 * times[n]).cos()));
        // The standard errors are those of noise alone. The slope of a parabola over 0.2 s on each side, the longest
        // window, is off by up to a tenth of 0.2² times the third derivative, which is 27.
        assert!(value < 2.0 * smooth.noise[0] && smooth.noise[0] < 0.01, "{value} {:?}", smooth.noise);
        assert!(slope < 0.1 * 0.2 * 0.2 * 27.0 && smooth.noise[1] < 0.3, "{slope} {:?}", smooth.noise);
    }
}
