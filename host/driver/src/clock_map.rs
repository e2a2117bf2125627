//! The board's clock in terms of ours, from round trips.
//!
//! A round trip shows the board's clock at some moment between two of ours. The middle of the two is the best guess, wrong by
//! at most half the round trip, and mostly by far less. A line is fitted to these guesses: board minus host over host, by
//! least squares, with a weight that falls with what a round trip took longer than the shortest, and with the time since.

/// Round trips lose half their weight in this time, µs.
const MEMORY_US: f64 = 30e6;
/// A round trip longer than the shortest by this has half its weight, µs.
const EXCESS_US: f64 = 50.0;
/// What a slope is believed before anything is seen, as the sum of squares that it weighs: crystals differ by some 50 ppm, and
/// guesses by some 50 µs, so as much as round trips a second apart. µs²
const NO_SLOPE_US2: f64 = 1e12;
/// The shortest round trip is forgotten by this share of the difference with each longer one.
const SHORTEST_FORGETS: f64 = 1.0 / 256.0;
/// A clock that is farther than this outside what a round trip leaves possible has jumped, µs. Two crystals take five seconds
/// of silence for it.
const JUMP_US: f64 = 1000.0;
/// By how much two crystals drift apart at worst.
const DRIFT: f64 = 200e-6;

/// Maps the host's clock to the board's and back.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ClockMap(Option<Line>);

/// The line, and the sums it is made of. `x` is the host's clock and `y` the board's minus the host's, both from the first
/// round trip on.
#[derive(Clone, Copy, Debug)]
struct Line {
    host_us: u64,
    offset_us: i64,
    weight: f64,
    mean_x: f64,
    mean_y: f64,
    sum_xx: f64,
    sum_xy: f64,
    /// Of the squares of what the line was wrong by.
    sum_errors: f64,
    shortest_us: f64,
    last_x: f64,
}

impl ClockMap {
    /// Takes the board's clock as read between `sent_us` and `received_us` of ours.
    pub(crate) fn seen(&mut self, sent_us: u64, device_us: u64, received_us: u64) {
        let round_trip_us = received_us.saturating_sub(sent_us);
        let middle_us = sent_us + round_trip_us / 2;
        let offset_us = device_us.wrapping_sub(middle_us).cast_signed();
        let round_trip_us = round_trip_us as f64;
        if let Some(line) = &mut self.0
            && line.take(middle_us, offset_us, round_trip_us)
        {
            return;
        }
        self.0 = Some(Line {
            host_us: middle_us,
            offset_us,
            weight: 1.0,
            mean_x: 0.0,
            mean_y: 0.0,
            sum_xx: 0.0,
            sum_xy: 0.0,
            sum_errors: 0.0,
            shortest_us: round_trip_us,
            last_x: 0.0,
        });
    }

    /// The board's clock when ours shows `host_us`; ours, as long as nothing is known.
    pub(crate) fn device_us(&self, host_us: u64) -> u64 {
        let Some(line) = self.0 else { return host_us };
        host_us.saturating_add_signed(line.offset_us + line.y(line.x(host_us)).round() as i64)
    }

    /// Our clock when the board's shows `device_us`.
    pub(crate) fn host_us(&self, device_us: u64) -> u64 {
        let Some(line) = self.0 else { return device_us };
        let x = line.x(device_us.saturating_add_signed(-line.offset_us));
        // The slope is so small that one step of the iteration leaves nothing.
        let y = line.y(x - line.y(x));
        device_us.saturating_add_signed(-line.offset_us - y.round() as i64)
    }

    /// How wrong the map may be when our clock shows `host_us`, µs: half the shortest round trip, for one way may always take
    /// longer than the other; the spread of what was seen; the drift since. `None` when nothing is known.
    pub(crate) fn uncertainty_us(&self, host_us: u64) -> Option<f64> {
        let line = self.0?;
        let spread = (line.sum_errors / line.weight).sqrt();
        Some(line.shortest_us / 2.0 + 2.0 * spread + (line.x(host_us) - line.last_x).abs() * DRIFT)
    }
}

impl Line {
    fn x(&self, host_us: u64) -> f64 {
        host_us.wrapping_sub(self.host_us).cast_signed() as f64
    }

    fn y(&self, x: f64) -> f64 {
        self.mean_y + self.sum_xy / (self.sum_xx + NO_SLOPE_US2) * (x - self.mean_x)
    }

    /// False when the clock has jumped, so that nothing of before counts.
    fn take(&mut self, middle_us: u64, offset_us: i64, round_trip_us: f64) -> bool {
        let x = self.x(middle_us);
        let y = offset_us.wrapping_sub(self.offset_us) as f64;
        let error = y - self.y(x);
        if error.abs() > round_trip_us / 2.0 + JUMP_US {
            return false;
        }
        let forget = MEMORY_US / (MEMORY_US + (x - self.last_x).abs());
        // All that was taken before was longer than the new shortest by this at least.
        let keep = forget * weight(self.shortest_us - round_trip_us);
        self.last_x = x;
        let longer_us = round_trip_us - self.shortest_us;
        self.shortest_us += if longer_us < 0.0 { longer_us } else { longer_us * SHORTEST_FORGETS };

        let weight = weight(longer_us);
        self.weight = self.weight * keep + weight;
        let (dx, dy) = (x - self.mean_x, y - self.mean_y);
        self.mean_x += dx * weight / self.weight;
        self.mean_y += dy * weight / self.weight;
        self.sum_xx = self.sum_xx * keep + weight * dx * (x - self.mean_x);
        self.sum_xy = self.sum_xy * keep + weight * dx * (y - self.mean_y);
        // Of the new line: that the old one was made of longer round trips is not this one's error.
        let error = y - self.y(x);
        self.sum_errors = self.sum_errors * keep + weight * error * error;
        true
    }
}

fn weight(excess_us: f64) -> f64 {
    let excess = excess_us.max(0.0) / EXCESS_US;
    1.0 / (1.0 + excess * excess)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Numbers from 0 to 1 that are the same in each run (xorshift64*, Vigna 2016).
    struct Random(u64);

    impl Random {
        fn next(&mut self) -> f64 {
            self.0 ^= self.0 >> 12;
            self.0 ^= self.0 << 25;
            self.0 ^= self.0 >> 27;
            (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11) as f64 / (1_u64 << 53) as f64
        }

        /// A wait with this mean, µs, as one behind others has it.
        fn wait_us(&mut self, mean_us: f64) -> f64 {
            -mean_us * (1.0 - self.next()).ln()
        }
    }

    /// A board whose clock runs `ppm` fast, and began long before ours.
    struct Board {
        ppm: f64,
        start_us: f64,
    }

    impl Board {
        fn clock(&self, host_us: f64) -> u64 {
            (self.start_us + host_us * (1.0 + self.ppm * 1e-6)) as u64
        }
    }

    /// Heartbeats each 50 ms for `seconds`, each way with a wait of this mean and each twentieth with 5 ms more. What the map
    /// was wrong by, both ways, between the heartbeats of all but the first second; µs, sorted.
    fn errors(board: &Board, mean_us: f64, seconds: u64, seed: u64) -> Vec<f64> {
        let (mut map, mut random, mut errors) = (ClockMap::default(), Random(seed), Vec::new());
        for beat in 0..seconds * 20 {
            let sent_us = (beat * 50_000) as f64 + 1e9;
            let mut way_us = || {
                let held_up = if random.next() < 0.05 { 5000.0 } else { 0.0 };
                40.0 + random.wait_us(mean_us) + random.wait_us(1.0) * held_up
            };
            let there_us = sent_us + way_us();
            let back_us = there_us + way_us();
            map.seen(sent_us as u64, board.clock(there_us), back_us as u64);
            if beat > 20 {
                let host_us = back_us + 20_000.0;
                let error = map.device_us(host_us as u64) as f64 - board.clock(host_us) as f64;
                let back = map.host_us(board.clock(host_us)) as f64 - host_us;
                let told = map.uncertainty_us(host_us as u64).unwrap();
                assert!((error + back).abs() < 3.0, "one way {error}, the other {back}");
                errors.extend([error.abs() / told.max(1.0), error.abs()]);
            }
        }
        errors
    }

    #[test]
    fn jitter_and_drift_leave_less_than_200_us() {
        for (ppm, mean_us) in [(0.0, 30.0), (50.0, 30.0), (-150.0, 100.0), (20.0, 300.0), (150.0, 300.0)] {
            for seed in 1..=5 {
                let board = Board { ppm, start_us: 7e9 };
                let errors = errors(&board, mean_us, 60, seed);
                let mut wrong_us: Vec<f64> = errors.iter().skip(1).step_by(2).copied().collect();
                wrong_us.sort_by(f64::total_cmp);
                let p99_us = wrong_us[wrong_us.len() * 99 / 100];
                assert!(p99_us <= 200.0, "{ppm} ppm, {mean_us} us, seed {seed}: {p99_us} us");
                let beyond = errors.iter().step_by(2).filter(|of_told| **of_told > 1.0).count();
                assert!(beyond * 100 < wrong_us.len(), "{ppm} ppm, {mean_us} us: {beyond} times more than was told");
            }
        }
    }

    #[test]
    fn a_steady_link_leaves_nothing_but_rounding() {
        let board = Board { ppm: 100.0, start_us: 0.0 };
        let mut map = ClockMap::default();
        for beat in 0..2400_u64 {
            let sent_us = beat * 50_000;
            map.seen(sent_us, board.clock(sent_us as f64 + 200.0), sent_us + 400);
        }
        let host_us = 2400 * 50_000;
        assert!(map.device_us(host_us).abs_diff(board.clock(host_us as f64)) <= 2);
        assert!(map.host_us(board.clock(host_us as f64)).abs_diff(host_us) <= 2);
    }

    /// A board answers its first host late, when it has started.
    #[test]
    fn a_long_round_trip_counts_for_nothing_beside_a_short_one() {
        let mut map = ClockMap::default();
        assert_eq!((map.device_us(5), map.host_us(5), map.uncertainty_us(5)), (5, 5, None));
        // 80 ms, all of it on the way there: 40 ms wrong.
        map.seen(0, 1_000_000 + 80_000, 80_000);
        assert_eq!(map.device_us(80_000), 1_000_000 + 120_000);
        assert!(map.uncertainty_us(80_000).unwrap() >= 40_000.0);
        map.seen(100_000, 1_100_200, 100_400);
        assert!(map.device_us(100_000).abs_diff(1_100_000) <= 1, "{}", map.device_us(100_000));
    }

    #[test]
    fn a_clock_that_jumps_is_followed_at_once() {
        let mut map = ClockMap::default();
        for beat in 0..100 {
            map.seen(beat * 50_000, 9_000_000 + beat * 50_000 + 200, beat * 50_000 + 400);
        }
        // The board has restarted, and its clock with it.
        map.seen(5_000_000, 300, 5_000_400);
        assert_eq!(map.device_us(5_000_200), 300);
        // 2 ms of lost time, as of a simulation that fell behind.
        map.seen(5_050_000, 48_300, 5_050_400);
        assert_eq!(map.device_us(5_050_200), 48_300);
    }
}
