//! Absolute angle sensor: from readings within one turn, each with its time, to a position over many turns and its
//! speed.

use embassy_time::{Duration, Instant};
use r4_protocol::config::{ANGLE_READINGS_LOST, AS5600_COUNTS};

use crate::within::Within;

/// One reading of the sensor.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Reading {
    /// Counts within one turn, 0 to 4095; higher bits are ignored.
    pub counts: u16,
    /// Time at which the reading was taken.
    pub taken: Instant,
    /// Nominal time between two readings.
    pub period: Duration,
}

/// Position and speed of a shaft with an absolute angle sensor.
///
/// Each reading moves the position by the shortest path: correct while the shaft turns less than half a turn between
/// two accepted readings. The speed is that of a tracking loop of second order, stepped by the true time between
/// readings (an alpha-beta filter, critically damped); between readings the position is extrapolated at that speed by
/// the age of the newest. A shaft at constant speed is therefore shown where it is now, whatever the rate of readings;
/// one that accelerates at `a` is shown at most `a T²/2` behind, at the end of a period `T` of readings.
///
/// A reading that no shaft could give after the last one, or that comes late, is rejected. The sensor is lost when no
/// reading was accepted for [`ANGLE_READINGS_LOST`] of its periods, or none has come yet; the first one after that is
/// accepted at any position.
///
/// # Source
/// Brookner, *Tracking and Kalman Filtering Made Easy*, Wiley 1998, 1.2.6 (critically damped g-h filter).
#[derive(Clone, Debug)]
pub struct Angle {
    inverted: bool,
    /// Sensor angle at position 0, counts.
    zero: u16,
    /// Middle of the range, counts, if the range is within a turn: the position is then known without its past, and a
    /// first reading counts in the turn around this middle.
    middle: Option<i32>,
    /// Speed that no shaft exceeds, counts/s.
    fastest: f32,
    /// Time constant of each of the two poles of the tracking loop, s.
    pole_s: f32,
    /// Newest accepted reading; its counts are the position's.
    position: i32,
    taken: Instant,
    period: Duration,
    found: bool,
    /// Tracking loop: estimated position minus `position`, counts, and speed, counts/s.
    beyond: f32,
    speed: f32,
}

/// Mounting of a channel's sensor, and limits of its shaft.
#[derive(Clone, Copy, Debug)]
pub struct Mounting {
    /// Sensor angle at position 0, rad.
    pub zero: f32,
    /// True if the sensor angle falls while the position rises.
    pub inverted: bool,
    /// Lowest and highest position, rad.
    pub range: (f32, f32),
    /// Highest speed, rad/s.
    pub speed_max: f32,
    /// Permitted lag of the speed, s.
    pub filter_s: f32,
}

/// Factor on the highest speed and margin in counts beyond which a movement counts as a jump of the sensor; as for the
/// watch over motors.
const JUMP_SPEEDS: f32 = 4.0;
const JUMP_COUNTS: f32 = 8.0;
const TURN: i32 = AS5600_COUNTS as i32;
const PER_RAD: f32 = AS5600_COUNTS as f32 / core::f32::consts::TAU;

/// Shortest displacement from 0 to `counts`, which may be of several turns: from half a turn backwards to less than
/// half a turn forwards.
const fn shortest(counts: i32) -> i32 {
    (counts.wrapping_add(TURN / 2) & (TURN - 1)) - TURN / 2
}

impl Angle {
    /// Creates a sensor that has not been read yet.
    #[must_use]
    pub fn new(mounting: Mounting) -> Self {
        let Mounting { zero, inverted, range: (min, max), speed_max, filter_s } = mounting;
        let within_a_turn = max - min <= core::f32::consts::TAU;
        Self {
            inverted,
            zero: libm::roundf(zero * PER_RAD) as u16,
            middle: within_a_turn.then(|| libm::roundf((min + max) / 2.0 * PER_RAD) as i32),
            fastest: JUMP_SPEEDS * speed_max * PER_RAD,
            // Two poles lag as long as one of twice their time constant.
            pole_s: filter_s / 2.0,
            position: 0,
            taken: Instant::MIN,
            period: Duration::MIN,
            found: false,
            beyond: 0.0,
            speed: 0.0,
        }
    }

    /// Returns true if a first reading gives the position without its past.
    #[must_use]
    pub const fn is_absolute(&self) -> bool {
        self.middle.is_some()
    }

    /// Takes the newest reading, which may be an old one again, and returns position (counts) and speed (counts/s) at
    /// `now`; `None` while the sensor is lost.
    pub fn update(&mut self, newest: Option<Reading>, now: Instant) -> Option<(f64, f32)> {
        self.found &= now.saturating_duration_since(self.taken) <= self.period * ANGLE_READINGS_LOST.into();
        if let Some(reading) = newest.filter(|reading| !self.found || reading.taken > self.taken) {
            let age = now.saturating_duration_since(reading.taken);
            if age <= reading.period * ANGLE_READINGS_LOST.into() {
                self.take(reading);
            }
        }
        let age_s = now.saturating_duration_since(self.taken).as_micros() as f32 * 1e-6;
        self.found.then(|| (f64::from(self.position) + f64::from(self.speed * age_s), self.speed))
    }

    fn take(&mut self, Reading { counts, taken, period }: Reading) {
        let up = i32::from(counts) - i32::from(self.zero);
        let counts = if self.inverted { -up } else { up };
        if !self.found {
            // Without a middle the turn is that of the last position, which is 0 after power-on.
            let near = self.middle.unwrap_or(self.position);
            self.position = near.wrapping_add(shortest(counts.wrapping_sub(near)));
            (self.found, self.beyond, self.speed) = (true, 0.0, 0.0);
            (self.taken, self.period) = (taken, period);
            return;
        }
        let dt_s = (taken - self.taken).as_micros() as f32 * 1e-6;
        let moved = shortest(counts.wrapping_sub(self.position));
        if (moved as f32).abs() > self.fastest * dt_s + JUMP_COUNTS {
            return;
        }
        // Share of a deviation that remains after this time, for each pole.
        let left = self.pole_s / (self.pole_s + dt_s);
        let surprise = moved as f32 - (self.beyond + self.speed * dt_s);
        self.beyond = -left * left * surprise;
        let speed = self.speed + (1.0 - left) * (1.0 - left) * surprise / dt_s;
        self.speed = speed.within(-self.fastest, self.fastest);
        self.position = self.position.wrapping_add(moved);
        (self.taken, self.period) = (taken, period);
    }
}

#[cfg(test)]
mod tests {
    extern crate std;

    use core::f32::consts::TAU;

    use proptest::prelude::*;

    use super::*;

    const MS: Duration = Duration::from_millis(1);

    fn mounting() -> Mounting {
        Mounting { zero: 0.0, inverted: false, range: (-3.0, 3.0), speed_max: 20.0, filter_s: 0.01 }
    }

    fn at(ms: u64) -> Instant {
        Instant::from_millis(1000 + ms)
    }

    fn reading(counts: i32, taken: Instant) -> Option<Reading> {
        Some(Reading { counts: (counts & 0xFFF) as u16, taken, period: MS })
    }

    #[test]
    fn the_shortest_way_is_half_a_turn_at_most() {
        let ways = [(0, 0), (2047, 2047), (2048, -2048), (4095, -1), (4096, 0), (-1, -1), (-2049, 2047), (9000, 808)];
        for (counts, way) in ways {
            assert_eq!(shortest(counts), way, "{counts}");
        }
    }

    proptest! {
        /// For any zero, direction and range within a turn, the first reading is the position.
        #[test]
        fn a_first_reading_is_the_position_in_a_range_within_a_turn(
            zero in 0.0f32..TAU, inverted: bool, min in -20.0f32..20.0, length in 0.1f32..6.2, share in 0.0f32..1.0,
        ) {
            let position = min + share * length;
            let angle = if inverted { zero - position } else { zero + position };
            let counts = libm::roundf(angle * PER_RAD) as i32;
            let mut sensor = Angle::new(Mounting { zero, inverted, range: (min, min + length), ..mounting() });
            let (shown, speed) = sensor.update(reading(counts, at(0)), at(0)).expect("read");
            // Rounding of the zero and of the reading, at most a count each.
            prop_assert!((shown as f32 - position * PER_RAD).abs() <= 1.5, "{shown} for {}", position * PER_RAD);
            prop_assert_eq!(speed, 0.0);
            prop_assert!(sensor.is_absolute());
        }

        /// Any walk of less than half a turn between readings is followed exactly, over any number of turns.
        #[test]
        fn position_follows_any_walk(steps in prop::collection::vec(-1500i32..=1500, 1..100)) {
            for inverted in [false, true] {
                // A speed of 2400 rad/s is 1565 counts per ms.
                let wide = Mounting { inverted, range: (-1e4, 1e4), speed_max: 600.0, ..mounting() };
                let mut sensor = Angle::new(wide);
                let mut total = 0;
                sensor.update(reading(total, at(0)), at(0));
                for (ms, step) in (1..).zip(&steps) {
                    total += step;
                    let counts = if inverted { -total } else { total };
                    let (shown, _) = sensor.update(reading(counts, at(ms)), at(ms)).expect("read");
                    prop_assert_eq!(shown, f64::from(total));
                }
            }
        }
    }

    /// With readings at uneven times the speed is that of the shaft, and the position is correct between them.
    #[test]
    fn speed_and_place_are_those_of_the_shaft_at_uneven_times() {
        for (period_ms, jitter_ms) in [(1, [0, 0, 0]), (2, [0, 1, 1]), (4, [0, 2, 1])] {
            for rad_s in [10.0, -10.0] {
                let mut sensor = Angle::new(Mounting { range: (-100.0, 100.0), ..mounting() });
                let place = |at: Instant| rad_s * PER_RAD * (at - self::at(0)).as_micros() as f32 * 1e-6;
                let (mut newest, mut worst, mut shown_speed) = (None, 0.0f32, 0.0);
                for ms in 0..400 {
                    let now = at(ms);
                    let reads = ms % period_ms == jitter_ms[(ms / period_ms % 3) as usize] % period_ms;
                    if reads {
                        let counts = libm::floorf(place(now)) as i32;
                        newest =
                            reading(counts, now).map(|reading| Reading { period: MS * period_ms as u32, ..reading });
                    }
                    let Some((shown, speed)) = sensor.update(newest, now) else { continue };
                    if ms > 200 {
                        worst = worst.max((shown as f32 - place(now)).abs());
                        shown_speed = speed / PER_RAD;
                    }
                }
                // One count of quantisation, and the error of the speed over the longest gap, 7 ms.
                assert!(worst <= 2.0, "{period_ms} ms, {rad_s} rad/s: {worst} counts");
                // One count, 1.5 mrad, of uneven time, behind two poles of 5 ms: (1 ms / 6 ms)² of it per ms.
                assert!((shown_speed - rad_s).abs() < 0.06, "{period_ms} ms: {shown_speed} rad/s, not {rad_s}");
            }
        }
    }

    /// Lag of two poles of half the time constant each: half of a step of speed is seen after 1.68 of them, all but 1 %
    /// after 6.6.
    #[test]
    fn the_speed_lags_as_long_as_it_may() {
        let mut sensor = Angle::new(Mounting { range: (-100.0, 100.0), filter_s: 0.04, ..mounting() });
        sensor.update(reading(0, at(0)), at(0));
        let after = |share: f32, sensor: &mut Angle| {
            (1..400u64).find(|ms| {
                let (_, speed) = sensor.update(reading(10 * *ms as i32, at(*ms)), at(*ms)).expect("read");
                speed >= share * 10_000.0
            })
        };
        // Backward steps of 1 ms add one to each pole of 20 ms.
        let (half, most) = (after(0.5, &mut sensor.clone()), after(0.99, &mut sensor));
        assert!(half.is_some_and(|ms| (33..=36).contains(&ms)), "{half:?} ms");
        assert!(most.is_some_and(|ms| (130..=142).contains(&ms)), "{most:?} ms");
    }

    /// The limit of a jump is 4 · 20 rad/s in a ms plus eight counts: 60.
    #[test]
    fn a_jump_is_not_believed_and_the_sensor_is_lost_when_it_stays() {
        for (jump, taken) in [(60, true), (61, false), (-61, false), (256, false)] {
            let mut sensor = Angle::new(mounting());
            sensor.update(reading(0, at(0)), at(0));
            let (shown, _) = sensor.update(reading(jump, at(1)), at(1)).expect("known since 1 ms");
            assert_eq!(shown as f32 != 0.0, taken, "{jump}");
        }
        let mut sensor = Angle::new(mounting());
        sensor.update(reading(0, at(0)), at(0));
        let lost =
            (1..100).find(|ms| sensor.update(reading(1800, at(*ms)), at(*ms)).is_none_or(|(shown, _)| shown > 1e3));
        assert_eq!(lost, Some(6), "and then it is where it is");
        assert_eq!(sensor.update(reading(1800, at(7)), at(7)), Some((1800.0, 0.0)));
    }

    #[test]
    fn a_sensor_that_is_silent_is_lost_and_one_that_comes_back_is_where_it_is() {
        for (range, is_absolute) in [((-3.0, 3.0), true), ((-30.0, 30.0), false)] {
            let mut sensor = Angle::new(Mounting { range, ..mounting() });
            assert_eq!(sensor.update(None, at(0)), None);
            assert_eq!(sensor.is_absolute(), is_absolute);
            let newest = reading(-10, at(0));
            assert_eq!(sensor.update(newest, at(0)), Some((-10.0, 0.0)));
            for ms in 1..=5 {
                assert_eq!(sensor.update(newest, at(ms)), Some((-10.0, 0.0)), "{ms}");
            }
            assert_eq!(sensor.update(newest, at(6)), None);
            // A repeated reading does not count as new.
            assert_eq!(sensor.update(newest, at(7)), None);
            assert_eq!(sensor.update(reading(500, at(8)), at(8)), Some((500.0, 0.0)));
        }
    }
}
