//! Potentiometer: converts between converter code and position, by two calibration points.

use r4_protocol::config::PotPoint;

use super::filter::LowPass;

/// Straight line through two calibration points; the only place where codes become metres and back.
#[derive(Clone, Copy, Debug)]
pub struct PotScale {
    low: PotPoint,
    metres_per_code: f32,
}

impl PotScale {
    /// Creates the line through `low` and `high`, whose codes must differ.
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

    /// Converter code at `position_m`, not rounded.
    #[must_use]
    pub fn code(&self, position_m: f32) -> f32 {
        f32::from(self.low.code) + (position_m - self.low.position_m) / self.metres_per_code
    }
}

/// Position and speed of a rod with a potentiometer.
///
/// A code is implausible when it lies beyond the calibrated ends, towards a rail where an open or shorted wiper puts
/// it, or when it jumps as no rod does. Up to [`BRIDGED_S`] of such codes are bridged with the last position, because
/// worn tracks crackle. A code that stays at a plausible place for [`REACQUIRED_S`] is accepted as the new position.
#[derive(Clone, Debug)]
pub struct Potentiometer {
    scale: PotScale,
    /// Lowest and highest plausible code.
    codes: (f32, f32),
    jump_m: f32,
    period_s: f32,
    position_m: Option<f32>,
    implausible_s: f32,
    position_filter: LowPass,
    speed_filter: LowPass,
}

/// Share of the calibrated span that codes may lie beyond its ends, and that they may jump.
const MARGIN: f32 = 0.03;
/// Time for which implausible codes are bridged, s.
pub const BRIDGED_S: f32 = 0.005;
/// Time for which a plausible code must stay after a jump until it is accepted, s.
pub const REACQUIRED_S: f32 = 0.1;

/// Error: the wiper cannot be where the code says. It is open, shorted, or not the rod's.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Implausible;

impl Potentiometer {
    /// Creates a potentiometer calibrated at `low` and `high`, read every `period_s`, s; `filter_s` smooths its speed.
    #[must_use]
    pub fn new(low: PotPoint, high: PotPoint, period_s: f32, filter_s: f32) -> Self {
        let (lowest, highest) = (f32::from(low.code.min(high.code)), f32::from(low.code.max(high.code)));
        let margin = (highest - lowest) * MARGIN;
        Self {
            scale: PotScale::new(low, high),
            // Near a rail only half the distance to it: a wiper shorted to the rail must not pass for the end of the
            // stroke.
            codes: (lowest - margin.min(lowest / 2.0), highest + margin.min((f32::from(u16::MAX) - highest) / 2.0)),
            jump_m: (high.position_m - low.position_m) * MARGIN,
            period_s,
            position_m: None,
            implausible_s: 0.0,
            // A tenth of the speed filter removes the converter's noise and adds little lag to the loop.
            position_filter: LowPass::new(filter_s / 10.0, period_s),
            speed_filter: LowPass::new(filter_s, period_s),
        }
    }

    /// Takes the code of this period and returns position (m) and speed (m/s).
    ///
    /// # Errors
    /// [`Implausible`] for implausible codes that are no longer bridged; the position is then not changed. Before the
    /// first plausible code nothing is bridged.
    pub fn update(&mut self, code: u16) -> Result<(f32, f32), Implausible> {
        let measured_m = self.scale.position_m(code.into());
        let possible = (self.codes.0..=self.codes.1).contains(&f32::from(code));
        let Some(last_m) = self.position_m else {
            if !possible {
                return Err(Implausible);
            }
            return Ok(self.acquire(measured_m));
        };
        if possible && (measured_m - last_m).abs() <= self.jump_m {
            self.implausible_s = 0.0;
            let position_m = self.position_filter.step(measured_m);
            self.position_m = Some(position_m);
            return Ok((position_m, self.speed_filter.step((position_m - last_m) / self.period_s)));
        }
        self.implausible_s += self.period_s;
        if self.implausible_s <= BRIDGED_S {
            return Ok((last_m, self.speed_filter.step(0.0)));
        }
        if possible && self.implausible_s > REACQUIRED_S {
            self.acquire(measured_m);
        }
        Err(Implausible)
    }

    /// Restarts at rest at a position, m.
    fn acquire(&mut self, position_m: f32) -> (f32, f32) {
        self.position_filter.reset(position_m);
        self.speed_filter.reset(0.0);
        self.position_m = Some(position_m);
        self.implausible_s = 0.0;
        (position_m, 0.0)
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// One calibration serves both directions: a position commanded in metres reads back as the same position.
        #[test]
        fn code_and_position_are_inverse(
            low in 0u16..20_000, span in 1_000u16..40_000, falling: bool,
            low_m in -0.5f32..0.5, length_m in 0.01f32..1.0, share in 0.0f32..=1.0,
        ) {
            let (first, second) = if falling { (low + span, low) } else { (low, low + span) };
            let scale = PotScale::new(
                PotPoint { code: first, position_m: low_m },
                PotPoint { code: second, position_m: low_m + length_m },
            );
            let position_m = low_m + share * length_m;
            // Codes up to 65535 carry 2^-8 of rounding in f32; that times metres per code bounds the error.
            let tolerance_m = length_m / f32::from(span) * 0.02 + 1e-6;
            prop_assert!((scale.position_m(scale.code(position_m)) - position_m).abs() < tolerance_m);
        }
    }

    /// Potentiometer of the bench: 10-bit codes 29 and 989 for 0 and 100 mm.
    fn bench() -> Potentiometer {
        let point = |code, position_m| PotPoint { code, position_m };
        Potentiometer::new(point(1858, 0.0), point(63_357, 0.1), 1e-3, 0.05)
    }

    #[test]
    fn open_and_short_are_told_from_positions() {
        for code in [1858, 1500, 63_357, 64_000] {
            assert!(bench().update(code).is_ok(), "{code}");
        }
        // A wiper shorted to a rail, with hundreds of codes of converter offset.
        for code in [0, 40, 900, 64_800, u16::MAX] {
            assert_eq!(bench().update(code), Err(Implausible), "{code}");
        }
    }

    /// A change of 6 codes per period of 1 ms is 10 mm/s on the bench, in either direction.
    #[test]
    fn a_rod_s_speed_is_that_of_its_position() {
        for sign in [1, -1] {
            let mut pot = bench();
            let speeds =
                (0..1000i32).map(|period| pot.update((32_000 + sign * 6 * period) as u16).expect("plausible").1);
            let speed_m_s = speeds.last().expect("stepped");
            let expected = sign as f32 * 6.0 * pot.scale.metres_per_code * 1e3;
            // After twenty time constants; positions of 50 mm in f32 are rounded to 4e-9 m, in a period of 1 ms,
            // smoothed over 50.
            assert!((speed_m_s - expected).abs() < 1e-5, "{speed_m_s} m/s, not {expected}");
        }
    }

    /// Codes may lie 3 % of the span beyond either end, and move as much from one period to the next; here 900 codes,
    /// or 3 mm.
    #[test]
    fn a_code_may_lie_and_jump_as_far_as_the_margin() {
        let point = |code, position_m| PotPoint { code, position_m };
        let pot = || Potentiometer::new(point(20_000, 0.0), point(50_000, 0.1), 1e-3, 0.05);
        for (code, plausible) in [(19_099, false), (19_100, true), (50_900, true), (50_901, false)] {
            assert_eq!(pot().update(code).is_ok(), plausible, "{code}");
        }
        // One code more or less for rounding.
        for (code, taken) in [(30_000 + 899, true), (30_000 + 901, false), (30_000 - 899, true), (30_000 - 901, false)]
        {
            let mut pot = pot();
            let (rest_m, _) = pot.update(30_000).expect("plausible");
            assert_eq!(pot.update(code).expect("bridged").0 != rest_m, taken, "{code}");
        }
    }

    #[test]
    fn crackling_is_bridged_and_a_lost_wiper_is_not() {
        let mut pot = bench();
        let (rest_m, _) = pot.update(30_000).expect("plausible");
        for _ in 0..4 {
            assert_eq!(pot.update(0).expect("bridged").0, rest_m);
        }
        assert!(pot.update(30_000).is_ok());
        let implausible_after = (0..1000).position(|_| pot.update(0).is_err());
        assert!(implausible_after.is_some_and(|periods| periods <= 6), "{implausible_after:?} periods");
        // Code 0 is never accepted: it is no place of the rod.
        assert!((0..1000).all(|_| pot.update(0).is_err()));
    }

    #[test]
    fn a_jump_is_implausible_until_it_stays() {
        let mut pot = bench();
        pot.update(30_000).expect("plausible");
        let bad = (0..1000).filter(|_| pot.update(40_000).is_err()).count();
        // Implausible from 5 ms to 100 ms.
        assert!((90..=100).contains(&bad), "{bad} periods");
        assert!((pot.update(40_000).expect("believed").0 - pot.scale.position_m(40_000.0)).abs() < 1e-6);
    }
}
