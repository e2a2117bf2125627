//! The robot on the floor: its drive, its outline, and the rays of its range sensors.

use r4_boards::{Drive, Mount, RangeView, Robot, SkidSteer};
use r4_protocol::{ChannelId, Quality, Sample};

/// A robot whose pose follows from its wheels: skid-steer and differential robots.
#[derive(Clone, Debug)]
pub struct Footprint {
    /// Drive, by which wheel angles become a pose.
    pub drive: SkidSteer,
    /// Corners in the body's frame, m; none where the robot's file has no outline.
    pub outline_m: Vec<[f64; 2]>,
    /// Range sensors on the body.
    mounts: Vec<(ChannelId, Mount)>,
}

impl Footprint {
    /// Footprint that the robot's file describes; `None` for a robot that does not drive, or whose pose does not follow
    /// from its wheels' positions alone.
    #[must_use]
    pub fn of(robot: &Robot) -> Option<Self> {
        let Some(Drive::SkidSteer(drive)) = &robot.drive else { return None };
        let body = robot.simulation.body.as_ref();
        let outline = body.and_then(|body| body.kind.outline()).map(|outline| outline.corners_m().to_vec());
        let mounts = robot.simulation.ranges.iter().filter_map(|range| match range.sees {
            RangeView::World(mount) => Some((range.channel, mount)),
            RangeView::Constant { .. } => None,
        });
        Some(Self { drive: drive.clone(), outline_m: outline.unwrap_or_default(), mounts: mounts.collect() })
    }

    /// Ray from a range sensor to the object that it detects, in the body's frame: x and y of both ends, m; `None` for
    /// samples of other channels, and for readings that are not good.
    #[must_use]
    pub fn ray_m(&self, sample: &Sample) -> Option<[f64; 4]> {
        let Sample::Reading { channel, value, quality: Quality::Good, .. } = *sample else { return None };
        let (_, mount) = self.mounts.iter().find(|(of, _)| *of == channel)?;
        let ([x_m, y_m], distance_m, (sin, cos)) = (mount.place_m, f64::from(value), mount.yaw_rad.sin_cos());
        Some([x_m, y_m, x_m + distance_m * cos, y_m + distance_m * sin])
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use r4_protocol::ChannelKind;

    use super::*;

    #[test]
    fn robots_that_drive_on_two_sides_have_a_footprint() {
        let of = |name| Footprint::of(&r4_boards::load(name).expect("built in"));
        let openscout = of("openscout").expect("it drives");
        assert_eq!((openscout.outline_m.len(), openscout.mounts.len()), (4, 2));
        // A bench does not drive; the pose of a car does not follow from its wheels alone.
        assert!(of("osmc-bench").is_none() && of("openpodcar").is_none());
    }

    #[test]
    fn a_range_is_a_ray_from_its_sensor() {
        let mut footprint = Footprint::of(&r4_boards::load("openscout").expect("built in")).expect("it drives");
        let channel = ChannelId::new(ChannelKind::Range, 0);
        let reading = |quality| Sample::Reading { channel, value: 0.5, age_ms: 0, quality };
        assert_eq!(footprint.ray_m(&reading(Quality::Good)), Some([0.2, 0.12, 0.7, 0.12]));
        assert_eq!(footprint.ray_m(&reading(Quality::OutOfRange)), None);
        footprint.mounts[0].1.yaw_rad = FRAC_PI_2;
        let [.., x_m, y_m] = footprint.ray_m(&reading(Quality::Good)).expect("seen");
        // The ray points to the left; cos of a rounded right angle is 6e-17.
        assert!((x_m - 0.2).abs() < 1e-15 && (y_m - 0.62).abs() < 1e-15);
    }
}
