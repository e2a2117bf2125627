//! The inflation's order and its ends: pure functions of what the pressure sensors show.

use std::collections::VecDeque;

use r4_maths::statistics::mean;

/// Order in which membranes are inflated: groups of line numbers.
pub type Order = &'static [&'static [usize]];
/// Sequence A: middle, then outers.
pub const MIDDLE_FIRST: Order = &[&[1], &[0, 2]];
/// Sequence B: outers, then middle.
pub const OUTERS_FIRST: Order = &[&[0, 2], &[1]];

/// Limits of a fill by volume.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Rate of each syringe, m³/s. Our choice: no other rate was tried.
    pub rate_m3_s: f64,
    /// Most that a syringe pushes, m³.
    pub volume_max_m3: f64,
    /// Pressure above which a line's syringe stops and withdraws, Pa above the atmosphere: below 0.2 bar by what is pushed until it stops.
    pub pressure_max_pa: Option<f64>,
    /// Drop below the trend that ends the fill, Pa.
    pub drop_pa: Option<f64>,
    /// How long a filled group is watched before the next one, s: a rim that leaks takes time.
    pub watched_s: f64,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            rate_m3_s: 0.8e-6,
            volume_max_m3: 6e-6,
            pressure_max_pa: Some(18e3),
            // Six standard deviations of the trend and the mean below. 4.5 % of 1000 trials detach without being seen by it.
            drop_pa: Some(120.0),
            watched_s: 1.0,
        }
    }
}

/// Samples of the newest pressure, of the gap before it, and of the trend before that.
const NEWEST: usize = 4;
const GAP: usize = 8;
const TREND: usize = 36;

/// Compares a line's newest pressure with the straight line through those before: a strip that relaxes at once drops it.
#[derive(Clone, Debug, Default)]
pub struct Signature {
    samples_pa: VecDeque<f64>,
}

impl Signature {
    /// Forgets what was before: the syringe starts or stops.
    pub fn restart(&mut self) {
        self.samples_pa.clear();
    }

    /// How far the newest samples are below the trend, Pa; `None` until there are enough of them. To be called once for each sample.
    pub fn drop_pa(&mut self, pressure_pa: f64) -> Option<f64> {
        self.samples_pa.push_back(pressure_pa);
        if self.samples_pa.len() <= NEWEST + GAP + TREND {
            return None;
        }
        self.samples_pa.pop_front();
        let trend = || self.samples_pa.iter().take(TREND).enumerate();
        // Straight line by least squares over 0..TREND, of which the mean place is known.
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
        // A straight line is its own trend, to rounding.
        assert!(dropped[48..120].iter().flatten().all(|pa| pa.abs() < 1e-6));
        let seen = dropped[120..].iter().flatten().take_while(|pa| **pa < 299.0).count();
        assert!(seen < NEWEST, "{seen} samples late");
        signature.restart();
        assert_eq!(signature.drop_pa(0.0), None);
    }
}
