//! Order and end of an inflation, as pure functions of the measured pressures.

use std::collections::VecDeque;

use r4_maths::statistics::mean;

/// Order in which membranes are inflated: groups of line numbers, each filled at the same time.
pub type Order = &'static [&'static [usize]];
/// Sequence A: middle, then outers.
pub const MIDDLE_FIRST: Order = &[&[1], &[0, 2]];
/// Sequence B: outers, then middle.
pub const OUTERS_FIRST: Order = &[&[0, 2], &[1]];

/// Limits of a fill by volume.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Flow of each syringe, m³/s. Our choice: no other rate was tried.
    pub rate_m3_s: f64,
    /// Largest volume that a syringe displaces, m³.
    pub volume_max_m3: f64,
    /// Gauge pressure above which a line's syringe stops and withdraws, Pa; `None` disables the interlock. It is below
    /// 0.2 bar by what the pump still displaces until it stops.
    pub pressure_max_pa: Option<f64>,
    /// Pressure drop below the trend that ends the fill, Pa; `None` disables the detection.
    pub drop_pa: Option<f64>,
    /// Time for which a filled group is watched before the next one starts, s: a rim that leaks takes time to detach.
    pub watched_s: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            rate_m3_s: 0.8e-6,
            volume_max_m3: 6e-6,
            pressure_max_pa: Some(18e3),
            // Six standard deviations of the difference between the trend and the mean. 4.5 % of 1000 trials detach
            // undetected.
            drop_pa: Some(120.0),
            watched_s: 1.0,
        }
    }
}

/// Windows of the detector, in samples: the newest pressures, the gap before them, and the trend before that.
const NEWEST: usize = 4;
const GAP: usize = 8;
const TREND: usize = 36;

/// Detector of a detachment: compares a line's newest pressure with a straight line through earlier ones. A strip that
/// relaxes at once drops the pressure.
#[derive(Clone, Debug, Default)]
pub struct Signature {
    samples_pa: VecDeque<f64>,
}

impl Signature {
    /// Clears the samples. The caller restarts the detector when a syringe starts or stops, which changes the trend.
    pub fn restart(&mut self) {
        self.samples_pa.clear();
    }

    /// Takes one sample and returns the distance of the newest samples below the trend, Pa; `None` until the windows
    /// are full. Call it once for each sample.
    pub fn drop_pa(&mut self, pressure_pa: f64) -> Option<f64> {
        self.samples_pa.push_back(pressure_pa);
        if self.samples_pa.len() <= NEWEST + GAP + TREND {
            return None;
        }
        self.samples_pa.pop_front();
        let trend = || self.samples_pa.iter().take(TREND).enumerate();
        // Least-squares line over places 0..TREND, whose mean place is known in closed form.
        let middle = (TREND - 1) as f64 / 2.0;
        let mean_pa = trend().map(|(_, pa)| pa).sum::<f64>() / TREND as f64;
        let (mut over, mut squares) = (0.0, 0.0);
        for (place, pa) in trend() {
            let from = place as f64 - middle;
            over += from * (pa - mean_pa);
            squares += from * from;
        }
        let newest: Vec<f64> = self.samples_pa.iter().skip(TREND + GAP).copied().collect();
        let at = (TREND + GAP) as f64 + (NEWEST - 1) as f64 / 2.0;
        Some(mean_pa + over / squares * (at - middle) - mean(&newest).ok()?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_step_is_a_drop_and_a_slope_is_none() {
        let mut signature = Signature::default();
        let slope = |place: usize| 8e3 - 12.0 * place as f64;
        let mut dropped = Vec::new();
        for place in 0..200 {
            let step_pa = if place >= 120 { 300.0 } else { 0.0 };
            dropped.push(signature.drop_pa(slope(place) - step_pa));
        }
        assert!(dropped[..48].iter().all(Option::is_none));
        // A straight line is its own trend, to rounding errors.
        assert!(dropped[48..120].iter().flatten().all(|pa| pa.abs() < 1e-6));
        let seen = dropped[120..].iter().flatten().take_while(|pa| **pa < 299.0).count();
        assert!(seen < NEWEST, "{seen} samples late");
        signature.restart();
        assert_eq!(signature.drop_pa(0.0), None);
    }
}
