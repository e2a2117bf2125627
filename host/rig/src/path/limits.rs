//! Check of a path against its channel's limits before any point is sent. The board checks each point again on arrival.

use r4_protocol::{ChannelInfo, Mode, Range};

use super::Waypoint;

/// Error of a path that exceeds the limits of its channel.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum BeyondLimit {
    /// The channel cannot follow paths.
    #[error("it cannot follow a path: only motors with feedback can")]
    FollowsNone,
    /// A position is out of range.
    #[error("its point at {time_s:.3} s is at {asked:.6}, outside the range {} to {}", range.min, range.max)]
    Position {
        /// Time of the point, s.
        time_s: f64,
        /// Requested position, rad or m.
        asked: f64,
        /// Allowed positions, rad or m.
        range: Range,
    },
    /// The motion to a point is too fast.
    #[error(
        "its point at {time_s:.3} s needs a speed of {asked:.6}, and at most {limit} is allowed: give it more time"
    )]
    Speed {
        /// Time of the point, s.
        time_s: f64,
        /// Requested speed, rad/s or m/s, without a sign.
        asked: f64,
        /// Speed limit of the channel, rad/s or m/s.
        limit: f64,
    },
    /// A point is not later than the start, or than the point before.
    #[error("its point at {time_s:.3} s is too early: the motion towards it starts at {start_s:.3} s")]
    Early {
        /// Time of the point, s.
        time_s: f64,
        /// Time of the start or of the point before, s.
        start_s: f64,
    },
}

/// Share by which a speed may exceed its limit: the board's own allowance for rounding.
const ROUNDING: f64 = 1e-4;

/// Checks the points of a path for a channel that starts from `from`, in the same time as the points.
///
/// # Errors
/// [`BeyondLimit::FollowsNone`] for a channel that cannot follow paths; otherwise for the first point that is out of range
/// ([`BeyondLimit::Position`]), not later than the one before ([`BeyondLimit::Early`]), or too far from it for the time
/// between them ([`BeyondLimit::Speed`]).
pub fn check(info: &ChannelInfo, from: Waypoint, points: &[Waypoint]) -> Result<(), BeyondLimit> {
    let follow = info.mode(Mode::Follow).ok_or(BeyondLimit::FollowsNone)?;
    let limit = info.mode(Mode::Speed).map_or(f64::INFINITY, |mode| f64::from(mode.range.max));
    let mut before = from;
    for point in points {
        let time_s = point.time_s;
        if !follow.range.contains(point.position as f32) {
            return Err(BeyondLimit::Position { time_s, asked: point.position, range: follow.range });
        }
        if time_s <= before.time_s {
            return Err(BeyondLimit::Early { time_s, start_s: before.time_s });
        }
        let asked = fastest(&before, point);
        if asked > limit * (1.0 + ROUNDING) {
            return Err(BeyondLimit::Speed { time_s, asked, limit });
        }
        before = *point;
    }
    Ok(())
}

/// Returns the highest speed between two points, without a sign: that of the cubic when both speeds are given, otherwise the larger of
/// the mean speed and the given one. `to` is later than `from`.
fn fastest(from: &Waypoint, to: &Waypoint) -> f64 {
    let chord = (to.position - from.position) / (to.time_s - from.time_s);
    let ends = from.speed.unwrap_or(0.0).abs().max(to.speed.unwrap_or(0.0).abs());
    // Without both speeds the cubic depends on further neighbours; the mean speed is a lower bound of its highest speed.
    let (Some(start), Some(end)) = (from.speed, to.speed) else { return chord.abs().max(ends) };
    // The speed of the cubic over the share s of the time is a parabola, start + linear s + square s².
    let square = 3.0 * (start + end) - 6.0 * chord;
    let linear = 6.0 * chord - 4.0 * start - 2.0 * end;
    let share = -linear / (2.0 * square);
    let top = if share > 0.0 && share < 1.0 { start + linear * share / 2.0 } else { 0.0 };
    ends.max(top.abs())
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use r4_protocol::{ChannelId, ChannelKind, ModeInfo, Unit};

    use super::*;
    use crate::path::Feed;

    fn info() -> ChannelInfo {
        let range = Range::new(-10.0, 10.0);
        let mode = |mode, unit, range| ModeInfo { mode, unit, range };
        let modes = [mode(Mode::Follow, Unit::Rad, range), mode(Mode::Speed, Unit::RadPerS, Range::new(-2.0, 2.0))];
        ChannelInfo {
            id: ChannelId::new(ChannelKind::Osmc, 0),
            unit: Unit::Rad,
            range,
            rate_hz: 1000.0,
            resolution: 0.001,
            modes: modes.into_iter().collect(),
        }
    }

    #[test]
    fn what_the_board_would_refuse_is_refused_before() {
        let at = |time_s, position, speed| Waypoint { speed, ..Waypoint::at(time_s, position) };
        let check = |points: &[Waypoint]| check(&info(), Waypoint::at(0.0, 0.0), points);
        assert_eq!(check(&[at(1.0, 2.0, None)]), Ok(()));
        assert_eq!(check(&[at(1.0, -2.5, None)]), Err(BeyondLimit::Speed { time_s: 1.0, asked: 2.5, limit: 2.0 }));
        assert_eq!(check(&[at(1.0, 0.0, Some(-3.0))]), Err(BeyondLimit::Speed { time_s: 1.0, asked: 3.0, limit: 2.0 }));
        // A mean of 1.5 rad/s between two points at rest has its peak of 2.25 rad/s in the middle.
        let rests = [at(1.0, 0.0, Some(0.0)), at(2.0, 1.5, Some(0.0))];
        assert_eq!(check(&rests), Err(BeyondLimit::Speed { time_s: 2.0, asked: 2.25, limit: 2.0 }));
        let far = check(&[at(6.0, 10.0, None), at(7.0, 10.5, None)]).expect_err("out of range");
        assert!(matches!(far, BeyondLimit::Position { time_s: 7.0, .. }), "{far}");
        assert_eq!(check(&[at(0.0, 0.0, None)]), Err(BeyondLimit::Early { time_s: 0.0, start_s: 0.0 }));
        let none = ChannelInfo { modes: Default::default(), ..info() };
        assert_eq!(super::check(&none, Waypoint::at(0.0, 0.0), &[at(1.0, 0.0, None)]), Err(BeyondLimit::FollowsNone));
    }

    proptest! {
        /// The highest speed is an upper bound of the cubic's speed, and the cubic reaches it.
        #[test]
        fn the_highest_speed_is_that_of_the_cubic(way in -3.0..3.0f64, start in -2.0..2.0f64, end in -2.0..2.0f64) {
            let ends = [
                Waypoint { speed: Some(start), ..Waypoint::at(0.0, 0.0) },
                Waypoint { speed: Some(end), ..Waypoint::at(1.0, way) },
            ];
            let feed = Feed::new(&ends, 0.0, 0);
            let speeds = (0..=1000u64).map(|ms| feed.at(ms * 1000).expect("on it").1.abs());
            let (seen, told) = (speeds.fold(0.0, f64::max), fastest(&ends[0], &ends[1]));
            // Allowance for samples 1 ms apart at a second derivative of up to 60, and for 32-bit positions.
            prop_assert!(seen <= told + 1e-4 && told <= seen + 1e-4, "{seen} {told}");
        }
    }
}
