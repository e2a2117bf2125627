//! The robot on the floor: its outline, its place by its wheels, and what its range sensors see.

use r4_boards::{Drive, Mount, RangeView, Robot, SkidSteer};
use r4_driver::{Board, Clock};
use r4_protocol::{ChannelId, Quality, Sample};
use r4_rig::{Odometry, sides_rad};
use serde::Serialize;

/// A robot whose place follows from its wheels: skid-steer and differential robots.
#[derive(Clone, Debug)]
pub struct Body {
    drive: SkidSteer,
    /// Corners in the body's frame, m; none where the robot's file has no outline.
    outline_m: Vec<[f64; 2]>,
    /// Range sensors on the body.
    mounts: Vec<(ChannelId, Mount)>,
}

impl Body {
    /// As the robot's file describes it; `None` for a robot that does not drive, or whose place does not follow from its wheels' positions
    /// alone.
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

    pub(crate) fn shape(&self) -> Shape<'_> {
        Shape { outline_m: &self.outline_m, track_m: self.drive.track_m, wheel_radius_m: self.drive.wheel_radius_m }
    }

    pub(crate) fn odometry(&self) -> Odometry {
        Odometry::new(&self.drive)
    }

    /// Place after these samples, the newest of all channels; `None` unless all wheels have positions.
    pub(crate) fn place<C: Clock>(
        &self,
        board: &Board<C>,
        odometry: &mut Odometry,
        samples: &[Sample],
    ) -> Option<Place> {
        let [left_rad, right_rad] = sides_rad(board, &self.drive, samples)?;
        odometry.look(left_rad, right_rad);
        let place = odometry.place();
        let millimetres = |value_m: f64| (value_m * 1e3).round() / 1e3;
        let rays = samples.iter().filter_map(|sample| self.ray(sample).map(|ray| ray.map(millimetres)));
        Some(Place {
            x_m: millimetres(place.x_m),
            y_m: millimetres(place.y_m),
            yaw_rad: (place.yaw_rad * 1e4).round() / 1e4,
            rays_m: rays.collect(),
        })
    }

    /// From a range sensor to what it sees, in the body's frame: x and y of both ends, m.
    fn ray(&self, sample: &Sample) -> Option<[f64; 4]> {
        let Sample::Reading { channel, value, quality: Quality::Good, .. } = *sample else { return None };
        let (_, mount) = self.mounts.iter().find(|(of, _)| *of == channel)?;
        let ([x_m, y_m], distance_m, (sin, cos)) = (mount.place_m, f64::from(value), mount.yaw_rad.sin_cos());
        Some([x_m, y_m, x_m + distance_m * cos, y_m + distance_m * sin])
    }
}

/// Outline of the robot for the drawing.
#[derive(Debug, Serialize)]
pub(crate) struct Shape<'a> {
    pub(crate) outline_m: &'a [[f64; 2]],
    pub(crate) track_m: f64,
    pub(crate) wheel_radius_m: f64,
}

/// Pose of the robot, relative to its pose when the page was opened.
#[derive(Debug, PartialEq, Serialize)]
pub(crate) struct Place {
    pub(crate) x_m: f64,
    pub(crate) y_m: f64,
    /// Heading, counterclockwise from +x, rad.
    pub(crate) yaw_rad: f64,
    /// Points where range sensors detect something, m, in the body frame.
    pub(crate) rays_m: Vec<[f64; 4]>,
}

#[cfg(test)]
mod tests {
    use std::f64::consts::FRAC_PI_2;

    use r4_protocol::ChannelKind;

    use super::*;

    #[test]
    fn robots_that_drive_on_two_sides_have_a_body() {
        let of = |name| Body::of(&r4_boards::load(name).expect("built in"));
        let openscout = of("openscout").expect("it drives");
        assert_eq!(openscout.shape().outline_m.len(), 4);
        assert_eq!(openscout.mounts.len(), 2);
        // A bench does not drive; a car's place does not follow from its wheels alone.
        assert!(of("osmc-bench").is_none() && of("openpodcar").is_none());
    }

    #[test]
    fn a_range_is_a_ray_from_its_sensor() {
        let mut body = Body::of(&r4_boards::load("openscout").expect("built in")).expect("it drives");
        let channel = ChannelId::new(ChannelKind::Range, 0);
        let reading = |quality| Sample::Reading { channel, value: 0.5, age_ms: 0, quality };
        assert_eq!(body.ray(&reading(Quality::Good)), Some([0.2, 0.12, 0.7, 0.12]));
        assert_eq!(body.ray(&reading(Quality::OutOfRange)), None);
        body.mounts[0].1.yaw_rad = FRAC_PI_2;
        let [.., x_m, y_m] = body.ray(&reading(Quality::Good)).expect("seen");
        // To the left: cos of a rounded right angle is 6e-17.
        assert!((x_m - 0.2).abs() < 1e-15 && (y_m - 0.62).abs() < 1e-15);
    }
}
