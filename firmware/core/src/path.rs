//! Path of a motor: its future points.

use heapless::Deque;
use r4_protocol::{
    ChannelId, PathPoint, Refusal,
    message::{MAX_POINTS, PATH_POINTS},
};

/// Maximum lead of a path's date, µs: a host that dates it further has a wrong estimate of the board's clock.
const AHEAD_MAX_US: u64 = 60_000_000;

/// Point of a path with its speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Knot {
    /// Time of the point on the board's clock, µs.
    pub(crate) at_us: u64,
    /// Position, in rad or m.
    pub(crate) position: f32,
    /// Speed, in rad/s or m/s.
    pub(crate) speed: f32,
    /// Feed-forward duty on the way to this point.
    pub(crate) feed_forward: f32,
}

/// Segment of a motor's path: the point that it passed last, and the next.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Leg {
    pub(crate) passed: Option<Knot>,
    pub(crate) next: Option<Knot>,
}

/// Limits that a path is checked against.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Limits {
    pub(crate) channel: ChannelId,
    /// Present position of the motor, rad or m.
    pub(crate) position: f32,
    /// Highest speed, in rad/s or m/s.
    pub(crate) speed_max: f32,
    pub(crate) now_us: u64,
}

/// Path of a motor from the last point that it has passed.
#[derive(Clone, Debug, Default)]
pub(crate) struct Path {
    points: Deque<PathPoint, PATH_POINTS>,
    passed: Option<Knot>,
}

impl Path {
    pub(crate) fn clear(&mut self) {
        self.points.clear();
        self.passed = None;
    }

    /// Checks that [`Path::splice`] can take `points`, whose numbers are finite and in the channel's range.
    ///
    /// # Errors
    /// [`Refusal::BadPath`] for no points or times that do not increase, [`Refusal::Late`] for a first point in the
    /// past, [`Refusal::ClockAhead`] for one too far ahead, [`Refusal::PathFull`] without room, [`Refusal::TooFast`]
    /// beyond the highest speed.
    pub(crate) fn check(&self, points: &[PathPoint], limits: &Limits) -> Result<(), Refusal> {
        let Limits { channel, position, speed_max, now_us } = *limits;
        let (Some(first), Some(last)) = (points.first(), points.last()) else {
            return Err(Refusal::BadPath { channel });
        };
        if points.windows(2).any(|pair| pair[0].at_us >= pair[1].at_us) {
            return Err(Refusal::BadPath { channel });
        }
        if first.at_us <= now_us {
            return Err(Refusal::Late { late_us: u32::try_from(now_us - first.at_us).unwrap_or(u32::MAX) });
        }
        let ahead_us = last.at_us - now_us;
        if ahead_us > AHEAD_MAX_US {
            return Err(Refusal::ClockAhead { ahead_ms: u32::try_from(ahead_us / 1000).unwrap_or(u32::MAX) });
        }
        let kept = || self.kept(first.at_us, now_us);
        let room = PATH_POINTS - kept().count();
        if points.len() > room {
            return Err(Refusal::PathFull { room: room as u8 });
        }
        let here = PathPoint { at_us: now_us, position, speed: None, feed_forward: 0.0 };
        let mut before = kept().last().copied().unwrap_or(here);
        for point in points {
            let asked = fastest(&before, point);
            // Tolerance of 1e-4 for rounding in the host.
            if asked > speed_max * 1.0001 {
                return Err(Refusal::TooFast { channel, asked, limit: speed_max });
            }
            before = *point;
        }
        Ok(())
    }

    /// Inserts `points`, which were checked, in place of the stored ones from the first of them on.
    pub(crate) fn splice(&mut self, points: &[PathPoint], now_us: u64) {
        let Some(first) = points.first() else { return };
        let passed = self.points.iter().take_while(|point| point.at_us <= now_us).count();
        let kept = passed + self.kept(first.at_us, now_us).count();
        while self.points.len() > kept {
            self.points.pop_back();
        }
        for point in points {
            // The oldest go if the ring is full of points that have been passed but not yet polled.
            if self.points.is_full() {
                self.points.pop_front();
            }
            // There is always room: the oldest point has been removed.
            let _ = self.points.push_back(*point);
        }
    }

    /// Stored points that are still to come before `from_us`.
    fn kept(&self, from_us: u64, now_us: u64) -> impl Iterator<Item = &PathPoint> {
        self.points.iter().filter(move |point| point.at_us > now_us && point.at_us < from_us)
    }

    /// Segment of the path at `now_us`.
    pub(crate) fn leg(&mut self, now_us: u64) -> Leg {
        while let Some(next) = self.next() {
            if next.at_us > now_us {
                return Leg { passed: self.passed, next: Some(next) };
            }
            self.points.pop_front();
            self.passed = Some(next);
        }
        Leg { passed: self.passed, next: None }
    }

    /// Next point, with its given speed or one derived from its neighbours.
    fn next(&self) -> Option<Knot> {
        let mut points = self.points.iter();
        let PathPoint { at_us, position, speed, feed_forward } = *points.next()?;
        let slope = |(from_us, from): (u64, f32), (to_us, to): (u64, f32)| {
            let span_s = to_us.saturating_sub(from_us) as f32 * 1e-6;
            ((to - from) / span_s, span_s)
        };
        let here = (at_us, position);
        let before = self.passed.map(|knot| slope((knot.at_us, knot.position), here));
        let after = points.next().map(|point| slope(here, (point.at_us, point.position)));
        let derived = match (before, after) {
            // Slope of the parabola through the three points.
            (Some((before, before_s)), Some((after, after_s))) => {
                (before * after_s + after * before_s) / (before_s + after_s)
            }
            (Some((only, _)), None) | (None, Some((only, _))) => only,
            (None, None) => 0.0,
        };
        Some(Knot { at_us, position, speed: speed.unwrap_or(derived), feed_forward })
    }
}

/// Highest speed between two points: of the chord, or of the cubic if both speeds are given.
fn fastest(from: &PathPoint, to: &PathPoint) -> f32 {
    let chord = (to.position - from.position) / (to.at_us.saturating_sub(from.at_us) as f32 * 1e-6);
    let ends = from.speed.unwrap_or(0.0).abs().max(to.speed.unwrap_or(0.0).abs());
    let (Some(start), Some(end)) = (from.speed, to.speed) else { return chord.abs().max(ends) };
    // The speed of the cubic is a parabola over the time from 0 to 1.
    let (square, linear) = (3.0 * (start + end) - 6.0 * chord, 6.0 * chord - 4.0 * start - 2.0 * end);
    let at = -linear / (2.0 * square);
    // A straight line gives NaN, for which the comparison is false.
    let top = if at > 0.0 && at < 1.0 { start + linear * at / 2.0 } else { start };
    ends.max(top.abs())
}

const _: () = assert!(MAX_POINTS <= PATH_POINTS, "a message fits");

#[cfg(test)]
mod tests {
    use r4_protocol::ChannelKind;

    use super::*;

    const CHANNEL: ChannelId = ChannelId::new(ChannelKind::Osmc, 0);

    fn point(at_us: u64, position: f32) -> PathPoint {
        PathPoint { at_us, position, speed: None, feed_forward: 0.0 }
    }

    fn limits(now_us: u64) -> Limits {
        Limits { channel: CHANNEL, position: 0.0, speed_max: 2.0, now_us }
    }

    fn taken(path: &mut Path, points: &[PathPoint], now_us: u64) -> Result<(), Refusal> {
        path.check(points, &limits(now_us))?;
        path.splice(points, now_us);
        Ok(())
    }

    #[test]
    fn points_are_taken_in_order_ahead_of_time_and_within_the_speed() {
        let bad = Err(Refusal::BadPath { channel: CHANNEL });
        let check = |points: &[PathPoint]| Path::default().check(points, &limits(1_000_000));
        assert_eq!(check(&[]), bad);
        assert_eq!(check(&[point(3_000_000, 0.0), point(3_000_000, 0.0)]), bad, "two at one moment");
        assert_eq!(check(&[point(3_000_000, 0.0), point(2_000_000, 0.0)]), bad, "backwards");
        assert_eq!(check(&[point(1_000_000, 0.0)]), Err(Refusal::Late { late_us: 0 }), "now is late");
        assert_eq!(check(&[point(999_000, 0.0)]), Err(Refusal::Late { late_us: 1000 }));
        assert_eq!(check(&[point(1_000_001, 0.0)]), Ok(()));
        assert_eq!(check(&[point(61_000_000, 0.0)]), Ok(()));
        assert_eq!(check(&[point(61_000_001, 0.0)]), Err(Refusal::ClockAhead { ahead_ms: 60_000 }));
        // From the motor's position, between points, at a point, and on the cubic between two points that are slow
        // enough.
        let fast = |asked| Err(Refusal::TooFast { channel: CHANNEL, asked, limit: 2.0 });
        assert_eq!(check(&[point(2_000_000, 2.0)]), Ok(()));
        assert_eq!(check(&[point(2_000_000, -2.5)]), fast(2.5));
        assert_eq!(check(&[point(2_000_000, 0.0), point(3_000_000, 2.5)]), fast(2.5));
        let at = |at_us, position, speed| PathPoint { speed: Some(speed), ..point(at_us, position) };
        assert_eq!(check(&[at(2_000_000, 0.0, -3.0)]), fast(3.0));
        // A chord of 1.5 m/s between two rests gives 2.25 in the middle.
        assert_eq!(check(&[at(2_000_000, 0.0, 0.0), at(3_000_000, 1.5, 0.0)]), fast(2.25));
        assert_eq!(check(&[at(2_000_000, 0.0, 1.5), at(3_000_000, 1.5, 1.5)]), Ok(()), "a straight line");
    }

    #[test]
    fn later_points_replace_those_from_the_first_of_them_on() {
        let mut path = Path::default();
        let all: [PathPoint; MAX_POINTS] = core::array::from_fn(|index| point(index as u64 * 100 + 100, 0.0));
        assert_eq!(taken(&mut path, &all, 0), Ok(()));
        assert_eq!(taken(&mut path, &[point(250, 0.0), point(900, 0.0)], 0), Ok(()));
        let dates =
            |path: &Path| path.points.iter().map(|point| point.at_us).collect::<heapless::Vec<u64, PATH_POINTS>>();
        assert_eq!(dates(&path), [100, 200, 250, 900]);
        // Replaced by one before all of them.
        assert_eq!(taken(&mut path, &[point(50, 0.0)], 0), Ok(()));
        assert_eq!(dates(&path), [50]);
    }

    /// Points that have been passed do not count, whether the motor has polled since or not.
    #[test]
    fn a_full_ring_says_how_much_room_it_has() {
        let mut path = Path::default();
        for batch in 0..8u64 {
            let points: [PathPoint; MAX_POINTS] =
                core::array::from_fn(|index| point(4 * batch + index as u64 + 1, 0.0));
            assert_eq!(taken(&mut path, &points, 0), Ok(()));
        }
        assert_eq!(taken(&mut path, &[point(33, 0.0)], 0), Err(Refusal::PathFull { room: 0 }));
        let three = [point(33, 0.0), point(34, 0.0), point(35, 0.0)];
        assert_eq!(taken(&mut path, &three, 2), Err(Refusal::PathFull { room: 2 }));
        assert_eq!(taken(&mut path, &three, 3), Ok(()));
        assert_eq!(path.points.len(), PATH_POINTS);
        assert_eq!(path.points.iter().filter(|point| point.at_us > 3).count(), PATH_POINTS);
    }

    /// Position t² sampled at 0, 100, 300 and 400 ms: the parabola's slope is exact, at the end it is the chord's.
    #[test]
    fn speeds_that_were_not_given_follow_from_the_neighbours() {
        let mut path = Path::default();
        let parabola = |at_us: u64| point(at_us, (at_us as f32 * 1e-6) * (at_us as f32 * 1e-6));
        let points = [100_000, 300_000, 400_000].map(parabola);
        assert_eq!(taken(&mut path, &points, 0), Ok(()));
        let leg = |path: &mut Path, now_us| path.leg(now_us);
        let close = |a: f32, b: f32| assert!((a - b).abs() < 1e-5, "{a} and {b}");
        let first = leg(&mut path, 50_000);
        assert_eq!(first.passed, None);
        close(first.next.expect("one").speed, 0.4);
        let second = leg(&mut path, 100_000);
        assert_eq!(second.passed.expect("one").at_us, 100_000);
        close(second.next.expect("one").speed, (0.4 * 0.1 + 0.7 * 0.2) / 0.3);
        close(leg(&mut path, 399_999).next.expect("one").speed, 0.7);
        let ended = leg(&mut path, 400_000);
        assert_eq!((ended.passed.expect("one").at_us, ended.next), (400_000, None));
        path.clear();
        assert_eq!(leg(&mut path, 500_000), Leg { passed: None, next: None });
        assert_eq!(taken(&mut path, &[point(600_000, 0.2)], 500_000), Ok(()));
        close(leg(&mut path, 500_000).next.expect("one").speed, 0.0);
    }
}
