//! Checks of a path against its channel's limits, before anything of it is sent: the board checks each point again as it comes.

use r4_protocol::{ChannelInfo, Mode, Range};

use super::Waypoint;

/// A path asks for more than its channel has.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum BeyondLimit {
    /// The channel follows no paths.
    #[error("it follows no paths: only motors with feedback do")]
    FollowsNone,
    /// A position is out of range.
    #[error("point {index} is at {asked:.6}, and it takes {} to {}", range.min, range.max)]
    Position {
        /// From 0.
        index: usize,
        /// rad or m
        asked: f64,
        /// rad or m
        range: Range,
    },
    /// The way to a point is too fast.
    #[error("the way to point {index} is {asked:.6} fast, and it does at most {limit}: give it more time")]
    Speed {
        /// From 0.
        index: usize,
        /// rad/s or m/s
        asked: f64,
        /// rad/s or m/s
        limit: f64,
    },
}

/// Share by which a speed may be above its limit: the board's own allowance for roundings.
const ROUNDING: f64 = 1e-4;

/// Checks the points of a path of a channel that is at `from`, at a moment of the points' time.
///
/// # Errors
/// The first point that is out of range, or too far from the one before for its time.
pub fn check(info: &ChannelInfo, from: Waypoint, points: &[Waypoint]) -> Result<(), BeyondLimit> {
    let follow = info.mode(Mode::Follow).ok_or(BeyondLimit::FollowsNone)?;
    let limit = info.mode(Mode::Speed).map_or(f64::INFINITY, |mode| f64::from(mode.range.max));
    let mut before = from;
    for (index, point) in points.iter().enumerate() {
        if !follow.range.contains(point.position as f32) {
            return Err(BeyondLimit::Position { index, asked: point.position, range: follow.range });
        }
        let asked = fastest(&before, point);
        if asked > limit * (1.0 + ROUNDING) {
            return Err(BeyondLimit::Speed { index, asked, limit });
        }
        before = *point;
    }
    Ok(())
}

/// Highest speed between two points: of the cubic where both speeds are given, else of the straight line and the given one. Infinite where
/// there is no time between them.
fn fastest(from: &Waypoint, to: &Waypoint) -> f64 {
    if to.time_s <= from.time_s {
        return f64::INFINITY;
    }
    let chord = (to.position - from.position) / (to.time_s - from.time_s);
    let ends = from.speed.unwrap_or(0.0).abs().max(to.speed.unwrap_or(0.0).abs());
    let (Some(start), Some(end)) = (from.speed, to.speed) else { return chord.abs().max(ends) };
    // The cubic's speed over the share s of the time is a parabola, start + linear s + square s².
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
        assert_eq!(check(&[at(1.0, -2.5, None)]), Err(BeyondLimit::Speed { index: 0, asked: 2.5, limit: 2.0 }));
        assert_eq!(check(&[at(1.0, 0.0, Some(-3.0))]), Err(BeyondLimit::Speed { index: 0, asked: 3.0, limit: 2.0 }));
        // 1.5 rad/s of chord between two rests are 2.25 in the middle.
        let rests = [at(1.0, 0.0, Some(0.0)), at(2.0, 1.5, Some(0.0))];
        assert_eq!(check(&rests), Err(BeyondLimit::Speed { index: 1, asked: 2.25, limit: 2.0 }));
        let far = check(&[at(6.0, 10.0, None), at(7.0, 10.5, None)]).expect_err("out of range");
        assert!(matches!(far, BeyondLimit::Position { index: 1, .. }), "{far}");
        let none = ChannelInfo { modes: Default::default(), ..info() };
        assert_eq!(super::check(&none, Waypoint::at(0.0, 0.0), &[at(1.0, 0.0, None)]), Err(BeyondLimit::FollowsNone));
    }

    proptest! {
        /// No moment of the cubic is faster than its highest speed, and some moment is as fast.
        #[test]
        fn the_highest_speed_is_that_of_the_cubic(way in -3.0..3.0f64, start in -2.0..2.0f64, end in -2.0..2.0f64) {
            let ends = [
                Waypoint { speed: Some(start), ..Waypoint::at(0.0, 0.0) },
                Waypoint { speed: Some(end), ..Waypoint::at(1.0, way) },
            ];
            let feed = Feed::new(&ends, 0.0, 0);
            let speeds = (0..=1000u64).map(|ms| feed.at(ms * 1000).expect("on it").1.abs());
            let (seen, told) = (speeds.fold(0.0, f64::max), fastest(&ends[0], &ends[1]));
            // Between samples 1 ms apart, of a second derivative up to 60, and f32 of positions.
            prop_assert!(seen <= told + 1e-4 && told <= seen + 1e-4, "{seen} {told}");
        }
    }
}
