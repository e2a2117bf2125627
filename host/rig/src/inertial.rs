//! Readings of a board's inertial sensors.

use r4_boards::Robot;
use r4_protocol::{ChannelId, ChannelKind, Quality, Sample};

/// A reading of an inertial sensor, in the sensor's axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InertialReading {
    /// Specific force: acceleration minus that of free fall, m/s².
    pub acceleration_m_s2: [f64; 3],
    /// Turn rates about the axes, counterclockwise positive, rad/s.
    pub rate_rad_s: [f64; 3],
    /// Age of the measurement at the time of the sample, s.
    pub age_s: f64,
}

/// Returns the first inertial sensor of a robot.
///
/// # Errors
/// A robot without an `[[imu]]`, in words.
pub fn inertial_sensor(robot: &Robot) -> Result<ChannelId, String> {
    let sensor = robot.config.sensors.iter().find(|sensor| sensor.id.kind == ChannelKind::Imu);
    Ok(sensor.ok_or("it has no [[imu]]")?.id)
}

/// Returns the reading of an inertial sensor in a telemetry frame; `None` without a good one.
#[must_use]
pub fn inertial_reading(sensor: ChannelId, samples: &[Sample]) -> Option<InertialReading> {
    samples.iter().find_map(|sample| match *sample {
        Sample::Sensor { channel, values, age_ms, quality: Quality::Good } if channel == sensor => {
            let [a, b, c, d, e, f] = values.map(f64::from);
            Some(InertialReading {
                acceleration_m_s2: [a, b, c],
                rate_rad_s: [d, e, f],
                age_s: f64::from(age_ms) * 1e-3,
            })
        }
        _ => None,
    })
}
