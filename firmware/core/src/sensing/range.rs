//! Ultrasonic range sensor (HC-SR04): from the width of its echo to a distance, and to a decision to stop.

use embassy_time::Instant;
use heapless::HistoryBuf;
use r4_protocol::{Quality, config::RangeConfig};

/// Number of readings whose median is the distance.
const MEDIAN_OF: usize = 3;
/// Multiple of the limit beyond which a reading counts towards releasing a stop.
const RELEASE: f32 = 1.1;
/// Number of consecutive readings beyond the release distance that release a stop.
const RELEASE_READINGS: u8 = 3;
/// Number of consecutive pings without a usable answer after which the sensor is lost.
pub const LOST_AFTER: u8 = 3;

/// Result of a ping.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Echo {
    /// Time for which the echo line was high, µs: the round trip of the sound, or the sensor's time-out (38 ms).
    Width(u32),
    /// The echo line never rose: no supply, or a cut wire.
    None,
    /// The echo line did not fall: a short. Some clones do this for 200 ms when nothing reflects.
    Stuck,
}

/// Reading of a range sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RangeReading {
    /// Last good distance, m; 0 before the first.
    pub distance_m: f32,
    /// Time of the newest echo in range; `None` before the first.
    pub measured: Option<Instant>,
    /// Quality of the distance.
    pub quality: Quality,
    /// True if the board must stop: something is nearer than the limit, or the sensor is lost. Always false without a
    /// limit.
    pub stop: bool,
    /// Time at which the ping of this reading ended.
    pub updated: Instant,
}

impl RangeReading {
    /// Reading of a sensor that has not pinged yet.
    pub const NONE: Self =
        Self { distance_m: 0.0, measured: None, quality: Quality::None, stop: false, updated: Instant::MIN };

    /// Age of the distance, ms; `u16::MAX` for a greater age and before the first distance.
    #[must_use]
    pub fn age_ms(&self, now: Instant) -> u16 {
        let age_ms = self.measured.map(|at| now.saturating_duration_since(at).as_millis());
        age_ms.and_then(|age_ms| age_ms.try_into().ok()).unwrap_or(u16::MAX)
    }
}

/// One range sensor.
///
/// The distance is the median of the last three usable readings, where one without an echo in range counts as
/// infinitely far; of two it is the nearer. So a jump is accepted when two of three readings agree. A missing answer is
/// reported at once and leaves the distance unchanged; a lost sensor's readings are discarded.
///
/// Stopping errs on the safe side: one reading nearer than the limit is enough, before any median; so is a lost sensor,
/// which a sensor that has never answered is from its first ping on. Three readings in a row beyond 1.1 times the limit
/// release the stop, so that the median is then beyond it too.
#[derive(Debug)]
pub struct RangeSensor {
    m_per_us: f32,
    max_m: f32,
    limit_m: Option<f32>,
    readings_m: HistoryBuf<f32, MEDIAN_OF>,
    reading: RangeReading,
    /// Consecutive pings without a usable answer.
    missed: u8,
    /// Consecutive readings beyond the release distance.
    released: u8,
}

impl RangeSensor {
    /// Creates a sensor in air of `temperature_c`, °C.
    #[must_use]
    pub fn new(config: &RangeConfig, temperature_c: f32) -> Self {
        // Speed of sound in an ideal gas, linear around 0 °C: 0.2 % error from 0 to 40 °C. Half of it below, because
        // sound travels there and back.
        let sound_m_s = 331.3 + 0.606 * temperature_c;
        Self {
            m_per_us: sound_m_s * 1e-6 / 2.0,
            max_m: config.range_m.max,
            limit_m: config.stop_below_m,
            readings_m: HistoryBuf::new(),
            reading: RangeReading::NONE,
            missed: LOST_AFTER - 1,
            released: 0,
        }
    }

    /// Takes the result of a ping that ended at `now`.
    pub fn update(&mut self, echo: Echo, now: Instant) -> RangeReading {
        self.reading.updated = now;
        match echo {
            Echo::Width(width_us) => self.take(width_us as f32 * self.m_per_us, now),
            Echo::None => self.miss(Quality::NoAnswer),
            Echo::Stuck => self.miss(Quality::Stuck),
        }
        self.reading
    }

    fn take(&mut self, measured_m: f32, now: Instant) {
        self.missed = 0;
        // The time-out of 38 ms is at least 5.8 m in any air: beyond every range that a configuration may have.
        let in_range = measured_m <= self.max_m;
        self.readings_m.write(if in_range { measured_m } else { f32::INFINITY });
        if in_range {
            self.reading.measured = Some(now);
        }
        let median_m = median(self.readings_m.as_slice());
        self.reading.quality = if median_m.is_finite() {
            self.reading.distance_m = median_m;
            Quality::Good
        } else {
            Quality::OutOfRange
        };
        let Some(limit_m) = self.limit_m else { return };
        self.released = if measured_m > limit_m * RELEASE { (self.released + 1).min(RELEASE_READINGS) } else { 0 };
        if measured_m < limit_m {
            self.reading.stop = true;
        } else if self.released == RELEASE_READINGS {
            self.reading.stop = false;
        }
    }

    fn miss(&mut self, quality: Quality) {
        self.reading.quality = quality;
        self.released = 0;
        self.missed = (self.missed + 1).min(LOST_AFTER);
        if self.missed == LOST_AFTER {
            self.readings_m.clear();
            self.reading.stop = self.limit_m.is_some();
        }
    }
}

/// Median of three values; the smallest of fewer.
fn median(values: &[f32]) -> f32 {
    match values {
        [a, b, c] => a.min(*b).max(a.max(*b).min(*c)),
        fewer => fewer.iter().copied().fold(f32::INFINITY, f32::min),
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use r4_protocol::{ChannelId, ChannelKind, Range};

    use super::*;

    const LIMIT_M: f32 = 0.5;
    /// Time-out of the datasheet, which is beyond the range.
    const TIME_OUT: Echo = Echo::Width(38_000);

    fn sensor(stop_below_m: Option<f32>) -> RangeSensor {
        let id = ChannelId::new(ChannelKind::Range, 0);
        RangeSensor::new(&RangeConfig { id, range_m: Range::new(0.02, 4.0), stop_below_m }, 20.0)
    }

    /// Echo of an object `distance_m` away in air of 20 °C: 343.42 m/s, there and back.
    fn echo(distance_m: f32) -> Echo {
        Echo::Width(libm::roundf(distance_m * 2e6 / 343.42) as u32)
    }

    fn feed(sensor: &mut RangeSensor, echoes: &[Echo]) -> RangeReading {
        echoes.iter().map(|echo| sensor.update(*echo, Instant::from_millis(1))).last().expect("at least one echo")
    }

    #[test]
    fn distance_follows_the_speed_of_sound_in_the_air() {
        // A round trip of 10 ms at 331.3 m/s, 343.42 m/s and 355.54 m/s.
        for (temperature_c, expected_m) in [(0.0, 1.6565), (20.0, 1.7171), (40.0, 1.7777)] {
            let config = RangeConfig {
                id: ChannelId::new(ChannelKind::Range, 0),
                range_m: Range::new(0.02, 4.0),
                stop_below_m: None,
            };
            let reading = RangeSensor::new(&config, temperature_c).update(Echo::Width(10_000), Instant::MIN);
            // Rounding: f32 carries 1e-7 of 2 m through four operations.
            assert!((reading.distance_m - expected_m).abs() < 1e-6, "{temperature_c} °C: {reading:?}");
        }
    }

    #[test]
    fn a_jump_is_believed_the_second_time() {
        // Rounding of half a microsecond is 0.09 mm.
        let near = |reading: RangeReading, expected_m: f32| (reading.distance_m - expected_m).abs() < 1e-4;
        let mut sensor = sensor(None);
        assert_eq!(sensor.reading, RangeReading::NONE);
        assert!(near(feed(&mut sensor, &[echo(2.0)]), 2.0), "one reading is what there is");
        assert!(near(feed(&mut sensor, &[echo(1.9)]), 1.9), "of two the nearer");
        assert!(near(feed(&mut sensor, &[echo(2.1)]), 2.0));
        assert!(near(feed(&mut sensor, &[echo(0.7)]), 1.9), "once is no jump");
        assert!(near(feed(&mut sensor, &[echo(0.6)]), 0.7));
        assert!(near(feed(&mut sensor, &[TIME_OUT]), 0.7), "once is not far away");
        assert_eq!(sensor.reading.quality, Quality::Good);
        let far = feed(&mut sensor, &[TIME_OUT]);
        assert!(near(far, 0.7) && far.quality == Quality::OutOfRange, "{far:?}");
        assert_eq!(feed(&mut sensor, &[echo(1.0)]).quality, Quality::OutOfRange);
        let back = feed(&mut sensor, &[echo(1.1)]);
        assert!(near(back, 1.1) && back.quality == Quality::Good, "{back:?}");
    }

    #[test]
    fn quality_tells_what_is_wrong_and_the_distance_grows_old() {
        let mut sensor = sensor(None);
        let at = Instant::from_millis;
        assert_eq!(sensor.update(Echo::None, at(10)).age_ms(at(10)), u16::MAX);
        let good = sensor.update(echo(1.0), at(100));
        for (echo, quality) in [(Echo::None, Quality::NoAnswer), (Echo::Stuck, Quality::Stuck)] {
            let reading = sensor.update(echo, at(200));
            assert_eq!((reading.quality, reading.distance_m, reading.stop), (quality, good.distance_m, false));
            assert_eq!((reading.updated, reading.age_ms(at(205))), (at(200), 105));
        }
        assert_eq!(sensor.reading.age_ms(at(70_000)), u16::MAX);
        assert_eq!(sensor.update(TIME_OUT, at(300)).age_ms(at(300)), 200, "an echo out of range measures nothing");
        feed(&mut sensor, &[Echo::None, Echo::None]);
        // Lost at the third miss: earlier readings are no part of the median any more.
        feed(&mut sensor, &[Echo::None]);
        assert_eq!(feed(&mut sensor, &[TIME_OUT]).quality, Quality::OutOfRange);
        // End of the range to the microsecond: 4 m are 23295.1 us.
        assert_eq!(feed(&mut self::sensor(None), &[Echo::Width(23_295)]).quality, Quality::Good);
        assert_eq!(feed(&mut self::sensor(None), &[Echo::Width(23_296)]).quality, Quality::OutOfRange);
    }

    #[test]
    fn one_near_reading_stops_and_three_far_ones_go_on() {
        let mut sensor = sensor(Some(LIMIT_M));
        assert!(!feed(&mut sensor, &[echo(2.0), echo(2.0), TIME_OUT, echo(0.51)]).stop);
        let stopped = feed(&mut sensor, &[echo(0.49)]);
        assert!(stopped.stop && stopped.distance_m > LIMIT_M, "before the median has it: {stopped:?}");
        // Beyond the limit, but not by a tenth of it.
        assert!(feed(&mut sensor, &[echo(0.54); 10]).stop);
        assert!(feed(&mut sensor, &[echo(0.56), echo(0.56)]).stop);
        for interrupted in [echo(0.54), Echo::None, Echo::Stuck] {
            assert!(feed(&mut sensor, &[interrupted, echo(0.56), TIME_OUT]).stop, "three in a row: {interrupted:?}");
        }
        assert!(!feed(&mut sensor, &[TIME_OUT]).stop, "far away is beyond the limit");
        assert!(feed(&mut sensor, &[Echo::Width(0)]).stop, "an echo at once is near, whatever it is");
    }

    #[test]
    fn a_lost_sensor_stops() {
        for lost in [Echo::None, Echo::Stuck] {
            let mut sensor = sensor(Some(LIMIT_M));
            feed(&mut sensor, &[TIME_OUT]);
            assert!(!feed(&mut sensor, &[lost, lost, echo(2.0), lost, lost]).stop);
            assert!(feed(&mut sensor, &[lost]).stop);
            assert!(feed(&mut sensor, &[echo(2.0), echo(2.0)]).stop);
            assert!(!feed(&mut sensor, &[echo(2.0)]).stop);
            assert!(feed(&mut self::sensor(Some(LIMIT_M)), &[lost]).stop, "never heard of");
            assert!(!feed(&mut self::sensor(None), &[lost; 10]).stop, "no limit, no stop");
        }
    }

    #[test]
    fn the_median_is_the_middle_in_any_order() {
        for values in
            [[1.0, 2.0, 3.0], [1.0, 3.0, 2.0], [2.0, 1.0, 3.0], [2.0, 3.0, 1.0], [3.0, 1.0, 2.0], [3.0, 2.0, 1.0]]
        {
            assert_eq!(median(&values), 2.0, "{values:?}");
        }
        assert_eq!(median(&[5.0, f32::INFINITY, 5.0]), 5.0);
    }

    fn any_echo() -> impl Strategy<Value = Echo> {
        prop_oneof![4 => (0u32..6000).prop_map(Echo::Width), 2 => any::<u32>().prop_map(Echo::Width),
            1 => Just(Echo::None), 1 => Just(Echo::Stuck)]
    }

    proptest! {
        /// The stop rule, checked against the history of results.
        #[test]
        fn it_stops_and_goes_on_as_the_history_says(echoes in prop::collection::vec(any_echo(), 1..100)) {
            let mut sensor = sensor(Some(LIMIT_M));
            let distance_m = |echo: &Echo| if let Echo::Width(us) = echo { Some(*us as f32 * 1.7171e-4) } else { None };
            let mut expected = false;
            let mut answered = false;
            for (index, echo) in echoes.iter().enumerate() {
                let reading = sensor.update(*echo, Instant::MIN);
                answered |= distance_m(echo).is_some();
                let last: heapless::Vec<_, 3> = echoes[..=index].iter().rev().take(3).map(distance_m).collect();
                let near = last[0].is_some_and(|distance_m| distance_m < LIMIT_M);
                let lost = !answered || last.len() == 3 && last.iter().all(Option::is_none);
                let clear = last.len() == 3 && last.iter().all(|far| far.is_some_and(|far_m| far_m > LIMIT_M * 1.1));
                expected = near || lost || expected && !clear;
                prop_assert_eq!(reading.stop, expected, "after {:?}", &echoes[..=index]);
                let good_and_near = reading.quality == Quality::Good && reading.distance_m < LIMIT_M;
                prop_assert!(!good_and_near || reading.stop, "a near median stops too: {:?}", reading);
                prop_assert!(reading.distance_m.is_finite() && reading.distance_m <= 4.0);
            }
        }
    }
}
