//! Angle by pulse width: the PWM output of an AS5600. Page numbers are those of its datasheet, v1-06 of 2018-06-20.
//!
//! A frame has 4351 periods of the sensor's clock: 128 high, then one more high per count of the angle, the rest low,
//! of which there are at least 128 (page 27). Without a magnet the line stays low (page 31), and there are no frames.

use r4_protocol::config::AS5600_COUNTS;

use crate::platform::Pulse;

/// Clock periods of a frame, and of the high part before the angle.
const FRAME: f32 = 4351.0;
const HEAD: f32 = 128.0;
/// Tolerated error of the sensor's clock: ±5 % (from memory), and as much again for a warm sensor.
const CLOCK_OFF: f32 = 0.1;
/// Tolerated error of a pulse, counts: for the time of an edge, or one that was nearly missed.
const OFF_COUNTS: f32 = 4.0;

/// Pulses of a line, from its levels and the times of their changes, in ticks of a 32-bit clock that wraps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Pulses {
    high: bool,
    rose: Option<u32>,
    /// Ticks from one rising edge to the next.
    period: Option<u32>,
    /// Newest complete pulse: time of its rising edge, and width, in ticks.
    pulse: Option<(u32, u32)>,
}

impl Pulses {
    /// Creates a line that is `high` since an unknown time.
    #[must_use]
    pub const fn new(high: bool) -> Self {
        Self { high, rose: None, period: None, pulse: None }
    }

    /// Records that the line is `high` since `at`; without a change of level nothing happened.
    pub fn level(&mut self, high: bool, at: u32) {
        if high == self.high {
            return;
        }
        self.high = high;
        if high {
            self.period = self.rose.map(|rose| at.wrapping_sub(rose));
            self.rose = Some(at);
        } else {
            self.pulse = self.rose.map(|rose| (rose, at.wrapping_sub(rose)));
        }
    }

    /// Newest pulse that follows a complete period, at `now`; a tenth of a µs has `ticks`. It stays the newest for one
    /// wrap of the clock.
    #[must_use]
    pub fn newest(&self, now: u32, ticks: u32) -> Option<Pulse> {
        let ((rose, high), period) = (self.pulse?, self.period?);
        let [high, period, age] = [high, period, now.wrapping_sub(rose)].map(|time| time / ticks);
        Some(Pulse { high, period, age_us: age / 10 })
    }
}

/// Angle in counts of a turn from `pulse`, for a sensor set to `frames_hz` frames per second; `None` if it is not a
/// valid frame.
#[must_use]
pub fn counts(pulse: Pulse, frames_hz: u16) -> Option<u16> {
    let nominal = 1e7 / f32::from(frames_hz.max(1));
    let period = pulse.period as f32;
    if (period - nominal).abs() > CLOCK_OFF * nominal {
        return None;
    }
    let counts = pulse.high as f32 * FRAME / period - HEAD;
    let most = f32::from(AS5600_COUNTS - 1);
    let plausible = (-OFF_COUNTS..=most + OFF_COUNTS).contains(&counts);
    plausible.then(|| libm::roundf(counts.max(0.0)).min(most) as u16)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    proptest! {
        /// Any angle is decoded, at any time of a clock that wraps, from a sensor with the largest clock error allowed.
        #[test]
        fn a_pulse_is_its_angle(angle in 0u16..4096, from: u32, hz in prop::sample::select(&[115u16, 230][..]), off in -0.09f32..0.09) {
            // Tenths of a µs are ticks of 10 MHz.
            let period = 1e7 / f32::from(hz) * (1.0 + off);
            let high = period * (128.0 + f32::from(angle)) / 4351.0;
            let at = |time: f32| from.wrapping_add(time as u32);
            let mut pulses = Pulses::new(true);
            pulses.level(false, at(0.0));
            prop_assert_eq!(pulses.newest(at(1.0), 1), None);
            pulses.level(true, at(100.0));
            pulses.level(false, at(100.0 + high));
            prop_assert_eq!(pulses.newest(at(100.0 + high), 1), None, "its period is not known");
            pulses.level(true, at(100.0 + period));
            pulses.level(false, at(100.0 + period + high));
            let pulse = pulses.newest(at(100.0 + period + high + 5000.0), 1).expect("a whole one");
            prop_assert!(pulse.age_us.abs_diff(((high + 5000.0) / 10.0) as u32) <= 1);
            // A tick of 0.1 us is a tenth or a twentieth of a count, and the frame's length is off by one.
            prop_assert!(counts(pulse, hz).is_some_and(|counts| counts.abs_diff(angle) <= 1), "{pulse:?}");
        }
    }

    #[test]
    fn what_is_no_frame_is_no_angle() {
        let frame = |high, period| counts(Pulse { high, period, age_us: 0 }, 230);
        // A frame of 43 478 ticks has 4351 clock periods of 9.99 ticks.
        assert_eq!([frame(1279, 43_478), frame(42_199, 43_478)], [Some(0), Some(4095)]);
        // Pulses too short or too long by three counts, and by six, at either end.
        assert_eq!([frame(1249, 43_478), frame(42_229, 43_478)], [Some(0), Some(4095)]);
        assert_eq!([frame(1219, 43_478), frame(42_259, 43_478)], [None, None]);
        // The frame of a sensor set to half the rate; one with a missed edge; a bounce.
        assert_eq!([frame(20_000, 86_957), frame(20_000, 48_000), frame(20_000, 39_000), frame(3, 10)], [None; 4]);
        assert_eq!(counts(Pulse { high: 1, period: 0, age_us: 0 }, 0), None);
    }

    #[test]
    fn a_level_that_is_told_again_is_no_edge() {
        let mut pulses = Pulses::new(false);
        for (high, at) in [(true, 0), (true, 3), (false, 10), (false, 12), (true, 100), (false, 130)] {
            pulses.level(high, at);
        }
        assert_eq!(pulses.newest(150, 1), Some(Pulse { high: 30, period: 100, age_us: 5 }));
        // With a clock of 100 MHz.
        assert_eq!(pulses.newest(150, 10), Some(Pulse { high: 3, period: 10, age_us: 0 }));
    }
}
