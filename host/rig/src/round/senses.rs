//! Wheel positions and ranges, collected from telemetry.

use std::collections::HashMap;

use r4_boards::SkidSteer;
use r4_driver::Board;
use r4_protocol::{ChannelId, ChannelKind, Quality, Sample};

use crate::HostClock;

/// Latest measurements of a skid-steer robot's wheels and range sensors.
#[derive(Clone, Debug)]
pub(super) struct Senses<'r> {
    robot: &'r SkidSteer,
    wheels_rad: HashMap<ChannelId, f64>,
    ranges_m: HashMap<ChannelId, f64>,
}

impl<'r> Senses<'r> {
    /// State before the first telemetry: no wheel has a position, and each range sensor counts as blocked until it has
    /// sent a distance.
    pub(super) fn new(robot: &'r SkidSteer, ranges: &[ChannelId]) -> Self {
        let ranges_m = ranges.iter().map(|channel| (*channel, 0.0)).collect();
        Self { robot, wheels_rad: HashMap::new(), ranges_m }
    }

    /// Stores the samples of one telemetry frame.
    pub(super) fn update(&mut self, board: &Board<HostClock>, samples: &[Sample]) {
        for sample in samples {
            match *sample {
                Sample::Motor { channel, position, .. } => {
                    let resolution = board.channel(channel).map_or(0.0, |info| f64::from(info.resolution));
                    self.wheels_rad.insert(channel, f64::from(position) * resolution);
                }
                Sample::Reading { channel, value, quality, .. } if channel.kind == ChannelKind::Range => {
                    self.ranges_m.insert(channel, distance_m(value, quality));
                }
                _ => {}
            }
        }
    }

    /// Mean positions of the left and the right wheels, rad; `None` until each wheel has sent a position.
    pub(super) fn sides_rad(&self) -> Option<[f64; 2]> {
        let mean = |side: &[ChannelId]| {
            let angles: Option<Vec<f64>> = side.iter().map(|channel| self.wheels_rad.get(channel).copied()).collect();
            angles.map(|angles| angles.iter().sum::<f64>() / angles.len() as f64)
        };
        Some([mean(&self.robot.left)?, mean(&self.robot.right)?])
    }

    /// Shortest distance of all range sensors, m; infinite without an obstacle in range.
    pub(super) fn free_m(&self) -> f64 {
        self.ranges_m.values().copied().fold(f64::INFINITY, f64::min)
    }
}

/// Free distance of a reading, m. A sensor that does not work detects nothing, so that it counts as blocked.
fn distance_m(value: f32, quality: Quality) -> f64 {
    match quality {
        Quality::Good => value.into(),
        Quality::OutOfRange => f64::INFINITY,
        _ => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_working_sensor_reports_free_space() {
        assert!((distance_m(0.5, Quality::Good) - 0.5).abs() < 1e-9);
        assert_eq!(distance_m(4.0, Quality::OutOfRange), f64::INFINITY);
        let broken = [Quality::None, Quality::NoAnswer, Quality::Stuck];
        assert!(broken.into_iter().all(|quality| distance_m(4.0, quality) == 0.0));
    }
}
