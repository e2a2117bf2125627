//! The robot on the page's floor: its outline, its pose by its wheels, and the rays of its range sensors.

use r4_driver::{Board, Clock};
use r4_protocol::Sample;
use r4_rig::{Footprint, Odometry, sides_rad};
use serde::Serialize;

/// Returns the outline for the drawing.
pub(crate) fn shape(footprint: &Footprint) -> Shape<'_> {
    let Footprint { drive, outline_m, .. } = footprint;
    Shape { outline_m, track_m: drive.track_m, wheel_radius_m: drive.wheel_radius_m }
}

/// Returns the pose after these samples, the newest of all channels; `None` unless all wheels have positions.
pub(crate) fn place<C: Clock>(
    footprint: &Footprint,
    board: &Board<C>,
    odometry: &mut Odometry,
    samples: &[Sample],
) -> Option<Place> {
    let [left_rad, right_rad] = sides_rad(board, &footprint.drive, samples)?;
    odometry.look(left_rad, right_rad);
    let place = odometry.place();
    // A page shows no more than millimetres, and fewer digits make its messages half as long.
    let millimetres = |value_m: f64| (value_m * 1e3).round() / 1e3;
    let rays = samples.iter().filter_map(|sample| footprint.ray_m(sample).map(|ray| ray.map(millimetres)));
    Some(Place {
        x_m: millimetres(place.x_m),
        y_m: millimetres(place.y_m),
        yaw_rad: (place.yaw_rad * 1e4).round() / 1e4,
        rays_m: rays.collect(),
    })
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
