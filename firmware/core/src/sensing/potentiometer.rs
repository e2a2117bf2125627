//! Potentiometer: a converter code to a position, by two calibration points, both ways.

use r4_protocol::config::PotPoint;

use super::filter::LowPass;

/// The wiper is open or shorted this share of the calibrated span beyond its ends.
const BEYOND_ENDS: f32 = 0.03;

/// The straight line through two calibration points. The one place where codes become metres and back.
#[derive(Clone, Copy, Debug)]
pub struct PotScale {
    low: PotPoint,
    metres_per_code: f32,
}

impl PotScale {
    /// The line through `low` and `high`, whose codes must differ.
    #[must_use]
    pub fn new(low: PotPoint, high: PotPoint) -> Self {
        let codes = f32::from(high.code) - f32::from(low.code);
        Self { low, metres_per_code: (high.position_m - low.position_m) / codes }
    }

    /// Position at `code`, m.
    #[must_use]
    pub fn position_m(&self, code: f32) -> f32 {
        self.low.position_m + (code - f32::from(self.low.code)) * self.metres_per_code
    }

    /// Code at `position_m`.
    #[must_use]
    pub fn code(&self, position_m: f32) -> f32 {
        f32::from(self.low.code) + (position_m - self.low.position_m) / self.metres_per_code
    }
}

/// Position and speed of a rod with a potentiometer.
#[derive(Clone, Debug)]
pub struct Potentiometer {
    scale: PotScale,
    plausible_m: (f32, f32),
    period_s: f32,
    position: Option<f32>,
    position_filter: LowPass,
    speed_filter: LowPass,
}

/// The wiper cannot be where the code says: it is open or shorted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Implausible;

impl Potentiometer {
    /// A potentiometer calibrated at `low` and `high`, read every `period_s`; `filter_s` smooths its speed.
    #[must_use]
    pub fn new(low: PotPoint, high: PotPoint, period_s: f32, filter_s: f32) -> Self {
        let margin = (high.position_m - low.position_m) * BEYOND_ENDS;
        Self {
            scale: PotScale::new(low, high),
            plausible_m: (low.position_m - margin, high.position_m + margin),
            period_s,
            position: None,
            // A tenth of the speed filter: takes the converter's noise, adds little lag to the loop.
            position_filter: LowPass::new(filter_s / 10.0, period_s),
            speed_filter: LowPass::new(filter_s, period_s),
        }
    }

    /// Takes the code of this period and returns position (m) and speed (m/s).
    ///
    /// # Errors
    /// [`Implausible`] when the code lies 3 % of the calibrated span beyond its ends; the position is then not changed.
    pub fn update(&mut self, code: u16) -> Result<(f32, f32), Implausible> {
        let measured_m = self.scale.position_m(code.into());
        if measured_m < self.plausible_m.0 || measured_m > self.plausible_m.1 {
            return Err(Implausible);
        }
        let last_m = *self.position.get_or_insert_with(|| {
            self.position_filter.reset(measured_m);
            measured_m
        });
        let position_m = self.position_filter.step(measured_m);
        self.position = Some(position_m);
        Ok((position_m, self.speed_filter.step((position_m - last_m) / self.period_s)))
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// One calibration serves both directions: what is commanded in metres is what is read back in metres.
        #[test]
        fn code_and_position_are_inverse(
            low in 0u16..20_000, span in 1_000u16..40_000, falling: bool,
            length_m in 0.01f32..1.0, share in 0.0f32..=1.0,
        ) {
            let (first, second) = if falling { (low + span, low) } else { (low, low + span) };
            let scale = PotScale::new(
                PotPoint { code: first, position_m: 0.0 },
                PotPoint { code: second, position_m: length_m },
            );
            let position_m = share * length_m;
            // Codes up to 65535 carry 2^-8 of rounding in f32; that times metres per code bounds the error.
            let tolerance_m = length_m / f32::from(span) * 0.02 + 1e-6;
            prop_assert!((scale.position_m(scale.code(position_m)) - position_m).abs() < tolerance_m);
        }
    }

    #[test]
    fn open_and_short_are_told_from_positions() {
        let mut pot = Potentiometer::new(
            PotPoint { code: 1858, position_m: 0.0 },
            PotPoint { code: 63_357, position_m: 0.1 },
            1e-3,
            0.05,
        );
        assert!(pot.update(1858).is_ok());
        assert!(pot.update(63_357).is_ok());
        assert_eq!(pot.update(0), Err(Implausible));
        assert_eq!(pot.update(u16::MAX), Err(Implausible));
    }
}
