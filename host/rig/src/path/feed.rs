//! Queue of a motor's path points for the board, which keeps only the next few.

use r4_protocol::{PathPoint, message::PATH_POINTS};

use super::Waypoint;

/// Time after its date for which a point may still take room on the board, µs.
const STILL_KEPT_US: u64 = 5_000;
/// Maximum time by which points are sent ahead of their dates, µs: a board refuses points beyond 60 s.
const AHEAD_US: u64 = 30_000_000;

/// Points with their dates on the board's clock, and the number of those already sent.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Feed {
    points: Vec<PathPoint>,
    sent: usize,
}

impl Feed {
    /// Creates a queue of a path's points, none of them sent. The path's time `zero_s`, s, is `begin_us` on the board's clock, µs.
    #[must_use]
    pub fn new(points: &[Waypoint], zero_s: f64, begin_us: u64) -> Self {
        let point = |point: &Waypoint| PathPoint {
            at_us: begin_us.saturating_add_signed(((point.time_s - zero_s) * 1e6).round() as i64),
            position: point.position as f32,
            speed: point.speed.map(|speed| speed as f32),
            feed_forward: point.feed_forward as f32,
        };
        Self { points: points.iter().map(point).collect(), sent: 0 }
    }

    /// Returns the next points for which the board has room at `now_us` on its clock, at most `most`, and counts them as sent.
    pub fn next(&mut self, now_us: u64, most: usize) -> Vec<PathPoint> {
        let kept = self.points[..self.sent].iter().filter(|point| point.at_us + STILL_KEPT_US > now_us).count();
        let near = self.points[self.sent..].iter().take_while(|point| point.at_us <= now_us + AHEAD_US);
        let count = near.take(PATH_POINTS.saturating_sub(kept).min(most)).count();
        let begin = self.sent;
        self.sent += count;
        self.points[begin..self.sent].to_vec()
    }

    /// Returns the number of sent points.
    #[must_use]
    pub fn sent(&self) -> usize {
        self.sent
    }

    /// Returns true when all points were sent.
    #[must_use]
    pub fn is_sent(&self) -> bool {
        self.sent == self.points.len()
    }

    /// Returns the date of the first point on the board's clock, µs; `None` without points.
    #[must_use]
    pub fn begin_us(&self) -> Option<u64> {
        self.points.first().map(|point| point.at_us)
    }

    /// Returns the date of the last point on the board's clock, µs; `None` without points.
    #[must_use]
    pub fn end_us(&self) -> Option<u64> {
        self.points.last().map(|point| point.at_us)
    }

    /// Returns the position (rad or m) and speed (rad/s or m/s) of the path at `at_us` on the board's clock, µs, by the cubic that the
    /// board follows; `None` before the first point and after the last.
    #[must_use]
    pub fn at(&self, at_us: u64) -> Option<(f64, f64)> {
        let next = self.points.iter().position(|point| point.at_us >= at_us)?;
        let to = &self.points[next];
        if to.at_us == at_us {
            return Some((to.position.into(), self.speed(next)));
        }
        let before = next.checked_sub(1)?;
        let from = &self.points[before];
        let span_s = (to.at_us - from.at_us) as f64 * 1e-6;
        let share = (at_us - from.at_us) as f64 * 1e-6 / span_s;
        // Cubic Hermite polynomial in the share of the segment's duration.
        let (from_position, to_position) = (f64::from(from.position), f64::from(to.position));
        let (start, end) = (self.speed(before) * span_s, self.speed(next) * span_s);
        let way = to_position - from_position;
        let (square, cube) = (3.0 * way - 2.0 * start - end, start + end - 2.0 * way);
        let position = from_position + share * (start + share * (square + share * cube));
        Some((position, (start + share * (2.0 * square + share * 3.0 * cube)) / span_s))
    }

    /// Returns the speed at a point, rad/s or m/s: as given, or else the slope of the parabola through it and its two neighbours; at an end
    /// of the path, the mean speed to its neighbour.
    fn speed(&self, index: usize) -> f64 {
        let slope = |from: usize, to: usize| {
            let (from, to) = (self.points.get(from)?, self.points.get(to)?);
            let span_s = to.at_us.saturating_sub(from.at_us) as f64 * 1e-6;
            Some(((f64::from(to.position) - f64::from(from.position)) / span_s, span_s))
        };
        let given = self.points.get(index).and_then(|point| point.speed).map(f64::from);
        given.unwrap_or_else(|| {
            match (index.checked_sub(1).and_then(|before| slope(before, index)), slope(index, index + 1)) {
                // Weights are the durations of the opposite segments, which is exact for a parabola.
                (Some((before, before_s)), Some((after, after_s))) => {
                    (before * after_s + after * before_s) / (before_s + after_s)
                }
                (Some((only, _)), None) | (None, Some((only, _))) => only,
                (None, None) => 0.0,
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn points(count: u32, every_s: f64) -> Vec<Waypoint> {
        (0..count).map(|at| Waypoint::at(f64::from(at) * every_s, f64::from(at))).collect()
    }

    #[test]
    fn the_board_is_given_what_it_has_room_for() {
        let mut feed = Feed::new(&points(40, 0.1), 0.0, 1_000_000);
        assert_eq!(feed.next(500_000, 4).len(), 4);
        assert_eq!(feed.next(500_000, 100).len(), PATH_POINTS - 4);
        assert_eq!(feed.next(500_000, 100), []);
        // Two points have passed, the second less than 5 ms ago, so only one has made room.
        assert_eq!(feed.next(1_100_001, 100).len(), 1);
        assert_eq!(feed.next(2_000_000, 100).len(), 7);
        assert!(feed.is_sent() && feed.sent() == 40);
        assert_eq!((feed.begin_us(), feed.end_us()), (Some(1_000_000), Some(4_900_000)));
    }

    /// Points more than 30 s ahead wait, since a board refuses dates more than 60 s ahead.
    #[test]
    fn points_far_ahead_wait() {
        let mut feed = Feed::new(&points(20, 5.0), 0.0, 0);
        assert_eq!(feed.next(0, 100).len(), 7);
        assert_eq!(feed.next(5_000_000, 100).len(), 1);
    }

    proptest! {
        /// For a parabola with any sampling, the derived speeds are exact, and so is the cubic between points with two neighbours.
        #[test]
        fn a_parabola_is_followed(spans in prop::collection::vec(0.01..0.5f64, 4..12), share in 0.0..1.0f64, curve in -2.0..2.0f64) {
            let mut time_s = 0.0;
            let mut points = vec![Waypoint::at(0.0, 0.0)];
            for span_s in spans {
                time_s += span_s;
                points.push(Waypoint::at(time_s, curve * time_s * time_s));
            }
            let feed = Feed::new(&points, 0.0, 0);
            let inner = (points[1].time_s, points[points.len() - 2].time_s);
            let at_s = inner.0 + share * (inner.1 - inner.0);
            let (position, speed) = feed.at((at_s * 1e6) as u64).expect("on the path");
            // Tolerances of 32-bit positions and of dates in whole µs, for at most 10 s and 40 rad/s.
            prop_assert!((position - curve * at_s * at_s).abs() < 1e-3, "{position}");
            prop_assert!((speed - 2.0 * curve * at_s).abs() < 2e-2, "{speed}");
        }
    }
}
