//! Conversion of a board's readings to ROS messages: frames by REP-103 and REP-105, SI units.

use r4_boards::SkidSteer;
use r4_protocol::{ChannelId, ChannelInfo, ChannelKind, Quality, Sample};
use r4_rig::{InertialReading, Odometry, Velocity, WHEEL_VARIANCE_M};

use crate::{
    BASE_FRAME, ODOM_FRAME,
    message::{
        self, BatteryState, Header, Imu, JointState, Pose, PoseWithCovariance, Quaternion, Range, TFMessage, Time,
        Transform, TransformStamped, Twist, TwistWithCovariance, Vector3,
    },
};

/// Variance of quantities that wheels do not measure: height, roll, pitch, and sideways speed. It is so large that a filter gives them
/// no weight.
pub const NOT_MEASURED: f64 = 1e6;

/// Full angle of the cone in which an HC-SR04 detects a target, rad: 15° to either side (ElecFreaks sheet: measuring angle 15 degrees).
const ULTRASOUND_FIELD_RAD: f32 = 0.524;
/// Full angle of an optical distance sensor, rad: a ray, because the board does not report the angle.
const OPTICAL_FIELD_RAD: f32 = 0.0;

/// Indices of x, y and yaw in the order x, y, z, roll, pitch, yaw.
const PLANAR: [usize; 3] = [0, 1, 5];

/// Expands a covariance of x, y and yaw to one of x, y, z, roll, pitch, yaw, row by row; the variance of the others is [`NOT_MEASURED`].
#[must_use]
pub fn covariance(planar: [[f64; 3]; 3]) -> [f64; 36] {
    let mut full = [0.0; 36];
    for unmeasured in [2, 3, 4] {
        full[unmeasured * 6 + unmeasured] = NOT_MEASURED;
    }
    for (row, entries) in PLANAR.into_iter().zip(planar) {
        for (column, entry) in PLANAR.into_iter().zip(entries) {
            full[row * 6 + column] = entry;
        }
    }
    full
}

/// Returns the covariance of forward speed, sideways speed and turn rate, averaged over `period_s`. The travel of each side has the
/// variance [`WHEEL_VARIANCE_M`] per metre.
#[must_use]
pub fn velocity_covariance(robot: &SkidSteer, velocity: Velocity, period_s: f64) -> [[f64; 3]; 3] {
    // Both results are linear in the sides' speeds, (left + right) / 2 and (right - left) / track, whose errors are independent.
    let across_m_s = velocity.yaw_rad_s * robot.track_m / 2.0;
    let [left, right] = [velocity.forward_m_s - across_m_s, velocity.forward_m_s + across_m_s]
        .map(|side_m_s| WHEEL_VARIANCE_M * side_m_s.abs() / period_s);
    let both = (right - left) / (2.0 * robot.track_m);
    let turn = (left + right) / (robot.track_m * robot.track_m);
    [[(left + right) / 4.0, 0.0, both], [0.0, NOT_MEASURED, 0.0], [both, 0.0, turn]]
}

/// Returns the message of `odom`: pose in [`ODOM_FRAME`], velocity in [`BASE_FRAME`]. `period_s` is the time over which `velocity` was
/// measured, s.
#[must_use]
pub fn odometry(
    stamp: Time,
    robot: &SkidSteer,
    odometry: &Odometry,
    velocity: Velocity,
    period_s: f64,
) -> message::Odometry {
    let place = odometry.place();
    let pose = Pose {
        position: Vector3 { x: place.x_m, y: place.y_m, z: 0.0 },
        orientation: Quaternion::of_yaw(place.yaw_rad),
    };
    let twist = Twist {
        linear: Vector3 { x: velocity.forward_m_s, ..Vector3::default() },
        angular: Vector3 { z: velocity.yaw_rad_s, ..Vector3::default() },
    };
    message::Odometry {
        header: Header::new(stamp, ODOM_FRAME),
        child_frame_id: BASE_FRAME.to_owned(),
        pose: PoseWithCovariance { pose, covariance: covariance(odometry.covariance()) },
        twist: TwistWithCovariance { twist, covariance: covariance(velocity_covariance(robot, velocity, period_s)) },
    }
}

/// Returns the message of `/tf`: the pose of `odometry` as a transform from [`ODOM_FRAME`] to [`BASE_FRAME`].
#[must_use]
pub fn transform(odometry: &message::Odometry) -> TFMessage {
    let Pose { position, orientation } = odometry.pose.pose;
    let transform = Transform { translation: position, rotation: orientation };
    TFMessage {
        transforms: vec![TransformStamped {
            header: odometry.header.clone(),
            child_frame_id: odometry.child_frame_id.clone(),
            transform,
        }],
    }
}

/// Returns the message of `joint_states`: motors, steppers and encoders of a telemetry frame under their channels' names; `None` without
/// any. A position or speed without a sensor is NaN.
#[must_use]
pub fn joint_states(stamp: Time, channels: &[ChannelInfo], samples: &[Sample]) -> Option<JointState> {
    let mut joints = JointState { header: Header::new(stamp, ""), ..JointState::default() };
    for sample in samples {
        let (channel, counts, speed) = match *sample {
            Sample::Motor { channel, position, speed, .. } | Sample::Encoder { channel, position, speed, .. } => {
                (channel, position, speed)
            }
            _ => continue,
        };
        let resolution = channels.iter().find(|info| info.id == channel).map_or(0.0, |info| info.resolution);
        joints.name.push(channel.to_string());
        // A resolution of 0 marks a channel without a position sensor.
        let position = if resolution > 0.0 { f64::from(counts) * f64::from(resolution) } else { f64::NAN };
        joints.position.push(position);
        joints.velocity.push(speed.into());
    }
    (!joints.name.is_empty()).then_some(joints)
}

/// Returns the message of `imu/data`, in the sensor's own axes, whose frame has the channel's name, and without an orientation.
#[must_use]
pub fn imu(stamp: Time, channel: ChannelId, reading: &InertialReading) -> Imu {
    let vector = |[x, y, z]: [f64; 3]| Vector3 { x, y, z };
    let mut orientation_covariance = [0.0; 9];
    // By the definition of sensor_msgs/Imu, -1 marks an orientation that is not measured.
    orientation_covariance[0] = -1.0;
    Imu {
        header: Header::new(stamp, &channel.to_string()),
        orientation: Quaternion::default(),
        orientation_covariance,
        angular_velocity: vector(reading.rate_rad_s),
        linear_acceleration: vector(reading.acceleration_m_s2),
        ..Imu::default()
    }
}

/// Returns the message of `rangeN` or `distanceN`. The distance is infinite when nothing is in range (REP-117); `None` while the sensor
/// fails, and for other channels.
#[must_use]
pub fn range(stamp: Time, info: &ChannelInfo, sample: &Sample) -> Option<Range> {
    let (value, quality) = match *sample {
        Sample::Reading { value, quality, .. } => (value, quality),
        Sample::Sensor { values, quality, .. } => (values[0], quality),
        _ => return None,
    };
    let (radiation_type, field_of_view) = match info.id.kind {
        ChannelKind::Range => (Range::ULTRASOUND, ULTRASOUND_FIELD_RAD),
        ChannelKind::Distance => (Range::INFRARED, OPTICAL_FIELD_RAD),
        _ => return None,
    };
    let range = match quality {
        Quality::Good => value,
        Quality::OutOfRange => f32::INFINITY,
        _ => return None,
    };
    let header = Header::new(stamp, &info.id.to_string());
    let (min_range, max_range) = (info.range.min, info.range.max);
    Some(Range { header, radiation_type, field_of_view, min_range, max_range, range, variance: 0.0 })
}

/// Returns the message of `battery_state` with the voltage of a supply rail, V; other quantities are unknown. The frame has the channel's
/// name.
#[must_use]
pub fn battery(stamp: Time, channel: ChannelId, voltage: f32) -> BatteryState {
    let name = channel.to_string();
    BatteryState { header: Header::new(stamp, &name), voltage, location: name, ..BatteryState::default() }
}

#[cfg(test)]
mod tests {
    use std::sync::LazyLock;

    use proptest::prelude::*;
    use r4_boards::Drive;
    use r4_protocol::{Mode, Setpoint, Unit};

    use super::*;

    /// Geometry of OpenScout, loaded once, since the property tests use it some hundred times.
    static OPENSCOUT: LazyLock<SkidSteer> = LazyLock::new(|| {
        let drive = r4_boards::load("openscout").expect("built in").drive;
        let Some(Drive::SkidSteer(robot)) = drive else { panic!("it steers by its sides") };
        robot
    });

    #[test]
    fn the_planar_covariance_is_at_x_y_and_yaw() {
        let full = covariance([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0], [7.0, 8.0, 9.0]]);
        // nav_msgs/Odometry: row-major over x, y, z, rotation about x, y, z.
        assert_eq!([full[0], full[1], full[5]], [1.0, 2.0, 3.0]);
        assert_eq!([full[6], full[7], full[11]], [4.0, 5.0, 6.0]);
        assert_eq!([full[30], full[31], full[35]], [7.0, 8.0, 9.0]);
        assert_eq!([full[14], full[21], full[28]], [NOT_MEASURED; 3]);
        assert_eq!(full.iter().filter(|entry| **entry != 0.0).count(), 12);
    }

    proptest! {
        /// The covariance is positive semidefinite in forward speed and turn rate, since filters invert it.
        #[test]
        fn a_velocity_has_a_covariance(forward_m_s in -2.0..2.0f64, yaw_rad_s in -3.0..3.0f64) {
            let [[forward, _, both], _, [_, _, turn]] =
                velocity_covariance(&OPENSCOUT, Velocity { forward_m_s, yaw_rad_s }, 0.02);
            prop_assert!(forward >= 0.0 && turn >= 0.0);
            // Allowance for the rounding of products of this magnitude.
            prop_assert!(forward * turn - both * both >= -1e-12);
        }

        /// The quaternion rotates the x axis by the yaw angle.
        #[test]
        fn a_yaw_is_a_rotation_about_z(yaw_rad in -20.0..20.0f64) {
            let Quaternion { x, y, z, w } = Quaternion::of_yaw(yaw_rad);
            prop_assert_eq!((x, y), (0.0, 0.0));
            let (forwards, left) = (1.0 - 2.0 * z * z, 2.0 * z * w);
            prop_assert!((forwards - yaw_rad.cos()).abs() < 1e-12 && (left - yaw_rad.sin()).abs() < 1e-12);
        }
    }

    #[test]
    fn one_side_that_turns_is_a_curve_around_the_other() {
        let velocity = Velocity::of_sides(&OPENSCOUT, [0.0, 2.0]);
        let [[forward, _, both], _, [_, _, turn]] = velocity_covariance(&OPENSCOUT, velocity, 0.5);
        // Calculated by hand: 0.112 m/s of the right side over 0.5 s, with a variance of 1e-4 m per metre: 2.24e-5 m²/s².
        let side = 1e-4 * 0.112 / 0.5;
        for (is, expected) in [(forward, side / 4.0), (both, side / 0.7), (turn, side / 0.35 / 0.35)] {
            assert!((is - expected).abs() < 1e-12, "{is} {expected}");
        }
    }

    #[test]
    fn odometry_says_the_same_in_its_message_and_in_its_transform() {
        let mut counted = Odometry::new(&OPENSCOUT);
        counted.look(0.0, 0.0);
        counted.look(1.0, 3.0);
        let stamp = Time { sec: 7, nanosec: 8 };
        let message = odometry(stamp, &OPENSCOUT, &counted, Velocity { forward_m_s: 0.2, yaw_rad_s: 0.1 }, 0.02);
        assert_eq!((message.header.frame_id.as_str(), message.child_frame_id.as_str()), ("odom", "base_link"));
        assert_eq!(message.twist.twist.linear.x, 0.2);
        assert_eq!(message.twist.twist.angular.z, 0.1);
        // The sides' travels differ by 2 rad at a radius of 0.056 m; the track is 0.35 m.
        let yaw_rad = 2.0 * 0.056 / 0.35;
        assert!((message.pose.pose.orientation.z - f64::sin(yaw_rad / 2.0)).abs() < 1e-12);
        let TFMessage { transforms } = transform(&message);
        let [transform] = &transforms[..] else { panic!("one transform") };
        assert_eq!(transform.header, message.header);
        assert_eq!(transform.transform.translation, message.pose.pose.position);
        assert_eq!(transform.transform.rotation, message.pose.pose.orientation);
    }

    fn info(id: ChannelId, resolution: f32) -> ChannelInfo {
        let range = r4_protocol::Range::new(0.02, 4.0);
        ChannelInfo { id, unit: Unit::M, range, rate_hz: 15.0, resolution, modes: [].into_iter().collect() }
    }

    #[test]
    fn joints_have_their_channels_names_and_units() {
        let id = ChannelId::new(ChannelKind::Dhb, 2);
        let sample = Sample::Motor {
            channel: id,
            setpoint: Setpoint { mode: Mode::Speed, value: 0.0 },
            position: -1000,
            speed: 1.5,
            duty: 0.1,
            settled: false,
            homed: false,
            winding: None,
        };
        let joints = joint_states(Time::default(), &[info(id, 0.002)], &[sample]).expect("a joint");
        assert_eq!((&joints.name[..], joints.velocity[0]), (&["dhb2".to_owned()][..], 1.5));
        // The resolution is a 32-bit float.
        assert!((joints.position[0] + 2.0).abs() < 1e-6);
        let unmeasured = joint_states(Time::default(), &[info(id, 0.0)], &[sample]).expect("a joint");
        assert!(unmeasured.position[0].is_nan());
        assert_eq!(joint_states(Time::default(), &[], &[]), None);
    }

    #[test]
    fn a_range_is_infinite_where_nothing_reflects_and_nothing_where_the_sensor_fails() {
        let channel = ChannelId::new(ChannelKind::Range, 1);
        let sonar = info(channel, 0.0);
        let of =
            |quality| range(Time::default(), &sonar, &Sample::Reading { channel, value: 1.25, age_ms: 0, quality });
        let good = of(Quality::Good).expect("a distance");
        assert_eq!(
            (good.range, good.min_range, good.max_range, good.header.frame_id.as_str()),
            (1.25, 0.02, 4.0, "range1")
        );
        assert_eq!(of(Quality::OutOfRange).expect("none in range").range, f32::INFINITY);
        assert_eq!(of(Quality::NoAnswer), None);
        assert_eq!(of(Quality::None), None);
    }
}
