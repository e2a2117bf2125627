//! Map between the host's clock and the board's, estimated from round trips.
//!
//! The board reads its clock at some moment between the request and the answer. The middle of the two is the best guess
//! of that moment; its error is at most half the round trip, and usually far less. A line is fitted to these guesses by
//! weighted least squares: board minus host over host. The weight of a round trip falls with its excess over the
//! shortest one, and with its age.

/// Age at which a round trip has lost half its weight, µs.
const MEMORY_US: f64 = 30e6;
/// Excess over the shortest round trip that halves the weight, µs.
const EXCESS_US: f64 = 50.0;
/// Regularisation of the slope towards zero, as a sum of squares, µs². Crystals differ by some 50 ppm and guesses by
/// some 50 µs, so it weighs as much as round trips one second apart.
const NO_SLOPE_US2: f64 = 1e12;
/// Share of the difference by which each longer round trip raises the shortest one, so that an old minimum is
/// forgotten.
const SHORTEST_FORGETS: f64 = 1.0 / 256.0;
/// A clock reading farther than this outside the interval that the round trip allows means that the clock has jumped,
/// µs. Drift of two crystals takes five seconds of silence to reach it.
const JUMP_US: f64 = 1000.0;
/// Largest relative drift between the two crystals.
const DRIFT: f64 = 200e-6;

/// Map from the host's clock to the board's and back; empty before the first round trip.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct ClockMap(Option<Line>);

/// Fitted line with its running sums. `x` is the host's clock and `y` the board's minus the host's, both relative to
/// the first round trip, µs.
#[derive(Clone, Copy, Debug)]
struct Line {
    host_us: u64,
    offset_us: i64,
    weight: f64,
    mean_x: f64,
    mean_y: f64,
    sum_xx: f64,
    sum_xy: f64,
    /// Weighted sum of the squared residuals, µs².
    sum_errors: f64,
    shortest_us: f64,
    last_x: f64,
}

impl ClockMap {
    /// Adds a round trip: the board's clock read `device_us` between `sent_us` and `received_us` of the host's.
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

    /// Returns the board's clock when the host's shows `host_us`; `host_us` itself before the first round trip.
    pub(crate) fn device_us(&self, host_us: u64) -> u64 {
        let Some(line) = self.0 else { return host_us };
        host_us.saturating_add_signed(line.offset_us + line.y(line.x(host_us)).round() as i64)
    }

    /// Returns the host's clock when the board's shows `device_us`; `device_us` itself before the first round trip.
    pub(crate) fn host_us(&self, device_us: u64) -> u64 {
        let Some(line) = self.0 else { return device_us };
        let x = line.x(device_us.saturating_add_signed(-line.offset_us));
        // The slope is some 1e-4, so one step of the iteration is exact to rounding.
        let y = line.y(x - line.y(x));
        device_us.saturating_add_signed(-line.offset_us - y.round() as i64)
    }

    /// Bound of the map's error when the host's clock shows `host_us`, µs: half the shortest round trip (one direction
    /// may always take longer than the other), plus two standard deviations of the residuals, plus the drift since the
    /// last round trip. `None` before the first one.
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

    /// Adds a round trip to the sums. Returns false when the clock has jumped, so that the earlier round trips no
    /// longer count.
    fn take(&mut self, middle_us: u64, offset_us: i64, round_trip_us: f64) -> bool {
        let x = self.x(middle_us);
        let y = offset_us.wrapping_sub(self.offset_us) as f64;
        let error = y - self.y(x);
        if error.abs() > round_trip_us / 2.0 + JUMP_US {
            return false;
        }
        let forget = MEMORY_US / (MEMORY_US + (x - self.last_x).abs());
        // With a new shortest round trip, the excess of all earlier ones grows at least by the difference: their weight
        // falls.
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
        // The residual is that of the new line: the old line's error from longer round trips must not count.
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

    /// Reproducible random numbers in 0..1 (xorshift64*, Vigna 2016).
    struct Random(u64);

    impl Random {
        fn next(&mut self) -> f64 {
            self.0 ^= self.0 >> 12;
            self.0 ^= self.0 << 25;
            self.0 ^= self.0 >> 27;
            (self.0.wrapping_mul(0x2545_F491_4F6C_DD1D) >> 11) as f64 / (1_u64 << 53) as f64
        }

        /// Exponentially distributed waiting time with this mean, µs, as behind other frames in a queue.
        fn wait_us(&mut self, mean_us: f64) -> f64 {
            -mean_us * (1.0 - self.next()).ln()
        }
    }

    /// Simulated board clock that runs `ppm` fast and started long before the host's.
    struct Board {
        ppm: f64,
        start_us: f64,
    }

    impl Board {
        fn clock(&self, host_us: f64) -> u64 {
            (self.start_us + host_us * (1.0 + self.ppm * 1e-6)) as u64
        }
    }

    /// Exchanges heartbeats every 50 ms for `seconds`. Each direction waits `mean_us` on average, and one in twenty
    /// some 5 ms more. Returns, for all but the first second, pairs of the map's error over its stated bound, and the
    /// error, µs.
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

    /// The first answer of a board that has just started may be late.
    #[test]
    fn a_long_round_trip_counts_for_nothing_beside_a_short_one() {
        let mut map = ClockMap::default();
        assert_eq!((map.device_us(5), map.host_us(5), map.uncertainty_us(5)), (5, 5, None));
        // A round trip of 80 ms, all of it on the way to the board: the map is wrong by 40 ms.
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
        // After a restart the board's clock starts from 0.
        map.seen(5_000_000, 300, 5_000_400);
        assert_eq!(map.device_us(5_000_200), 300);
        // The clock loses 2 ms, as in a simulation that fell behind real time.
        map.seen(5_050_000, 48_300, 5_050_400);
        assert_eq!(map.device_us(5_050_200), 48_300);
    }
}
