//! Angles as pulses: the PWM output of an AS5600. Page numbers are those of its datasheet, v1-06 of 2018-06-20.
//!
//! A frame has 4351 periods of the sensor's clock: 128 high, as many more high as the angle has counts, the rest low, of which 128 in any
//! case (page 27). Without a magnet the line stays low (page 31), and there are no frames.

use r4_protocol::config::AS5600_COUNTS;

/// Clock periods of a frame, and of its head.
const FRAME: f32 = 4351.0;
const HEAD: f32 = 128.0;
/// How far the sensor's clock may be off: ±5 % (from memory), and as much again for a sensor that is warm.
const CLOCK_OFF: f32 = 0.1;
/// A pulse is that many counts too long or short at most: an edge's time, or one that was nearly missed.
const OFF_COUNTS: f32 = 4.0;

/// A line's pulses, from its levels and the times of their changes, in ticks of a clock of 32 bits that wraps.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Pulses {
    high: bool,
    rose: Option<u32>,
    /// From one rise to the next.
    period: Option<u32>,
    /// The newest pulse that has ended, when it began, and how long it was.
    pulse: Option<(u32, u32)>,
}

/// The newest pulse on a line.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pulse {
    /// How long it was high, and from the rise before it to its own, in tenths of a µs.
    pub high: u32,
    /// See `high`.
    pub period: u32,
    /// Since it rose, µs.
    pub age_us: u32,
}

impl Pulses {
    /// A line that is `high` and has been for longer than is known.
    #[must_use]
    pub const fn new(high: bool) -> Self {
        Self { high, rose: None, period: None, pulse: None }
    }

    /// The line is `high` since `at`; if it was before, nothing happened.
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

    /// The newest pulse, behind a whole period, at `now`; `ticks` are in a tenth of a µs. It is told for as long as the clock takes to wrap.
    #[must_use]
    pub fn newest(&self, now: u32, ticks: u32) -> Option<Pulse> {
        let ((rose, high), period) = (self.pulse?, self.period?);
        let [high, period, age] = [high, period, now.wrapping_sub(rose)].map(|time| time / ticks);
        Some(Pulse { high, period, age_us: age / 10 })
    }
}

/// Counts of a turn that `pulse` means, from a sensor that is set to `frames_hz` frames a second; `None` for what is no frame of its.
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
        /// Any angle, at any time of a clock that wraps, from a sensor whose clock is off as far as it may be.
        #[test]
        fn a_pulse_is_its_angle(angle in 0u16..4096, from: u32, hz in prop::sample::select(&[115u16, 230][..]), off in -0.09f32..0.09) {
            // 10 MHz.
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
        // 43 478 ticks are 4351 clock periods of 9.99.
        assert_eq!([frame(1279, 43_478), frame(42_199, 43_478)], [Some(0), Some(4095)]);
        // Three counts too short or long at either end, and six.
        assert_eq!([frame(1249, 43_478), frame(42_229, 43_478)], [Some(0), Some(4095)]);
        assert_eq!([frame(1219, 43_478), frame(42_259, 43_478)], [None, None]);
        // Another sensor's, set to half the rate; one that was missed; a bounce.
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
        // Of a clock of 100 MHz.
        assert_eq!(pulses.newest(150, 10), Some(Pulse { high: 3, period: 10, age_us: 0 }));
    }
}
