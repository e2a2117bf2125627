//! Conversion of a velocity over the ground to set points of wheels.

use std::collections::BTreeMap;

use r4_boards::{Ackermann, Drive, SkidSteer};
use r4_driver::{Board, Clock};
use r4_protocol::{ChannelId, ChannelInfo, Mode, Sample, Setpoint};

use crate::Target;

/// Velocity of a robot over the ground, in its own frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Velocity {
    /// Forward speed, m/s, negative backwards.
    pub forward_m_s: f64,
    /// Turn rate, rad/s, counterclockwise.
    pub yaw_rad_s: f64,
}

impl Velocity {
    /// Scales both components by one factor, which keeps the curve.
    #[must_use]
    pub fn times(self, factor: f64) -> Self {
        Self { forward_m_s: self.forward_m_s * factor, yaw_rad_s: self.yaw_rad_s * factor }
    }

    /// Velocity of a robot whose left and right wheels turn at these speeds, rad/s, without slip along them.
    #[must_use]
    pub fn of_sides(robot: &SkidSteer, [left_rad_s, right_rad_s]: [f64; 2]) -> Self {
        let [left_m_s, right_m_s] = [left_rad_s, right_rad_s].map(|speed| speed * robot.wheel_radius_m);
        Self { forward_m_s: (left_m_s + right_m_s) / 2.0, yaw_rad_s: (right_m_s - left_m_s) / robot.track_m }
    }
}

/// Drive of a robot over the ground.
#[derive(Clone, Debug, PartialEq)]
pub struct GroundDrive {
    drive: Drive,
}

impl GroundDrive {
    /// Creates the drive from the description in a robot's file.
    #[must_use]
    pub fn new(drive: Drive) -> Self {
        Self { drive }
    }

    /// Drive of a board's robot; `None` where no file says how the robot drives.
    ///
    /// The board reports the name `robot` but not its drive: see [`Target::description`].
    #[must_use]
    pub fn of_board(target: &Target, robot: &str) -> Option<Self> {
        target.description(robot)?.drive.map(Self::new)
    }

    /// Description that the drive was created from.
    #[must_use]
    pub fn drive(&self) -> &Drive {
        &self.drive
    }

    /// Set points for a velocity. A velocity beyond the robot's limits, or beyond a wheel's, is scaled down and keeps its
    /// curve; one that is not finite becomes a standstill.
    #[must_use]
    pub fn setpoints(&self, velocity: Velocity) -> Vec<(ChannelId, Setpoint)> {
        let is_finite = velocity.forward_m_s.is_finite() && velocity.yaw_rad_s.is_finite();
        let velocity = if is_finite { velocity } else { Velocity::default() };
        match &self.drive {
            Drive::SkidSteer(robot) => skid_steer(robot, velocity),
            Drive::Ackermann(robot) => ackermann(robot, velocity),
        }
    }
}

/// Mean positions of the left and the right wheels in a telemetry frame, rad; `None` unless it has all of them.
#[must_use]
pub fn sides_rad<C: Clock>(board: &Board<C>, drive: &SkidSteer, samples: &[Sample]) -> Option<[f64; 2]> {
    recorded_sides_rad(board.channels(), drive, samples)
}

/// As [`sides_rad`], for a board of which only the description is there, as in a log.
#[must_use]
pub fn recorded_sides_rad(channels: &[ChannelInfo], drive: &SkidSteer, samples: &[Sample]) -> Option<[f64; 2]> {
    of_sides(drive, samples, |sample| match *sample {
        Sample::Motor { channel, position, .. } => {
            let info = channels.iter().find(|info| info.id == channel)?;
            Some(f64::from(position) * f64::from(info.resolution))
        }
        _ => None,
    })
}

/// Mean speeds of the left and the right wheels in a telemetry frame, rad/s; `None` unless it has all of them.
#[must_use]
pub fn sides_rad_s(drive: &SkidSteer, samples: &[Sample]) -> Option<[f64; 2]> {
    of_sides(drive, samples, |sample| match *sample {
        Sample::Motor { speed, .. } => Some(f64::from(speed)),
        _ => None,
    })
}

/// Means of a number over the wheels of each side; `None` unless all wheels are in the samples.
fn of_sides(drive: &SkidSteer, samples: &[Sample], number: impl Fn(&Sample) -> Option<f64>) -> Option<[f64; 2]> {
    let mean = |side: &[ChannelId]| {
        let numbers = side.iter().map(|wheel| {
            let is_motor = |sample: &&Sample| sample.channel() == *wheel && matches!(sample, Sample::Motor { .. });
            number(samples.iter().find(is_motor)?)
        });
        Some(numbers.sum::<Option<f64>>()? / side.len() as f64)
    };
    Some([mean(&drive.left)?, mean(&drive.right)?])
}

/// Factor that scales `asked` down to `most`; 1 where it is within.
fn share(asked: f64, most: f64) -> f64 {
    if asked.abs() > most { most / asked.abs() } else { 1.0 }
}

fn skid_steer(robot: &SkidSteer, asked: Velocity) -> Vec<(ChannelId, Setpoint)> {
    let slower = share(asked.forward_m_s, robot.speed_max_m_s).min(share(asked.yaw_rad_s, robot.turn_rate_max_rad_s));
    let asked = asked.times(slower);
    // Each component may be within its limit, and their sum at an outer wheel beyond the motor's.
    let outer_m_s = asked.forward_m_s.abs() + asked.yaw_rad_s.abs() * robot.track_m / 2.0;
    let Velocity { forward_m_s, yaw_rad_s } =
        asked.times(share(outer_m_s, robot.wheel_speed_max_rad_s * robot.wheel_radius_m));
    let across_m_s = yaw_rad_s * robot.track_m / 2.0;
    let speed = |rim_m_s: f64| Setpoint { mode: Mode::Speed, value: (rim_m_s / robot.wheel_radius_m) as f32 };
    let left = robot.left.iter().map(|channel| (*channel, speed(forward_m_s - across_m_s)));
    let right = robot.right.iter().map(|channel| (*channel, speed(forward_m_s + across_m_s)));
    left.chain(right).collect()
}

/// Set points of a car. It cannot turn on the spot: it stands then, with the wheels at their largest angle.
fn ackermann(robot: &Ackermann, asked: Velocity) -> Vec<(ChannelId, Setpoint)> {
    let most_m_s = robot.speed_max_m_s.min(robot.wheel_speed_max_rad_s * robot.wheel_radius_m);
    let Velocity { forward_m_s, yaw_rad_s } = asked.times(share(asked.forward_m_s, most_m_s));
    let wanted_rad = if yaw_rad_s == 0.0 { 0.0 } else { (robot.wheelbase_m * yaw_rad_s / forward_m_s).atan() };
    let angle_rad = wanted_rad.clamp(robot.steering_rad.min, robot.steering_rad.max);
    let steering = Setpoint { mode: Mode::Position, value: robot.steering_law.position_m(angle_rad) as f32 };
    let drive = match robot.full_speed_m_s {
        Some(full_m_s) => Setpoint { mode: Mode::Duty, value: (forward_m_s / full_m_s).clamp(-1.0, 1.0) as f32 },
        None => Setpoint { mode: Mode::Speed, value: (forward_m_s / robot.wheel_radius_m) as f32 },
    };
    vec![(robot.steering, steering), (robot.drive, drive)]
}

/// Newest samples of a robot's motors. A telemetry frame has the channels that are due, so that wheels with different
/// periods, or behind a broker that other clients use, come in different frames.
#[derive(Clone, Debug, Default)]
pub struct NewestMotors(BTreeMap<ChannelId, Sample>);

impl NewestMotors {
    /// Takes a frame, and returns the newest sample of each motor so far; `None` for a frame without motors.
    pub fn take(&mut self, frame: &[Sample]) -> Option<Vec<Sample>> {
        let motors = frame.iter().filter(|sample| matches!(sample, Sample::Motor { .. }));
        let mut is_new = false;
        for sample in motors {
            self.0.insert(sample.channel(), *sample);
            is_new = true;
        }
        is_new.then(|| self.0.values().copied().collect())
    }

    /// Forgets all samples, as after a restart of the board, whose wheels then count from 0.
    pub fn clear(&mut self) {
        self.0.clear();
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn robot(name: &str) -> GroundDrive {
        GroundDrive::new(r4_boards::load(name).expect("built in").drive.expect("it drives"))
    }

    fn values(drive: &GroundDrive, forward_m_s: f64, yaw_rad_s: f64) -> Vec<f32> {
        drive.setpoints(Velocity { forward_m_s, yaw_rad_s }).iter().map(|(_, setpoint)| setpoint.value).collect()
    }

    #[test]
    fn wheels_of_a_skid_steer_robot_roll_as_the_ground_goes_by() {
        let openscout = robot("openscout");
        let Drive::SkidSteer(SkidSteer { track_m, wheel_radius_m, .. }) = openscout.drive() else { panic!() };
        let straight = (0.2 / wheel_radius_m) as f32;
        assert_eq!(values(&openscout, 0.2, 0.0), [straight; 4]);
        let turning = (track_m / 2.0 / wheel_radius_m) as f32;
        assert_eq!(values(&openscout, 0.0, 1.0), [-turning, -turning, turning, turning]);
        // Left wheels first, as in the file.
        let channels: Vec<_> =
            openscout.setpoints(Velocity::default()).iter().map(|(channel, _)| channel.to_string()).collect();
        assert_eq!(channels, ["dhb0", "dhb2", "dhb1", "dhb3"]);
    }

    #[test]
    fn speeds_of_wheels_are_the_velocity_that_they_were_made_of() {
        let openscout = robot("openscout");
        let Drive::SkidSteer(drive) = openscout.drive() else { panic!() };
        for (forward_m_s, yaw_rad_s) in [(0.3, 0.0), (0.0, 1.2), (-0.2, -0.4)] {
            let [left, _, right, _] = values(&openscout, forward_m_s, yaw_rad_s)[..] else { panic!("four wheels") };
            let back = Velocity::of_sides(drive, [left, right].map(f64::from));
            // f32 at 10 rad/s: 1e-6 rad/s times 0.056 m over 0.175 m.
            assert!((back.forward_m_s - forward_m_s).abs() < 1e-6 && (back.yaw_rad_s - yaw_rad_s).abs() < 1e-6);
        }
    }

    #[test]
    fn wheels_that_come_in_different_frames_are_put_together() {
        let openscout = robot("openscout");
        let Drive::SkidSteer(drive) = openscout.drive() else { panic!() };
        let sample = |channel: &ChannelId, speed| Sample::Motor {
            channel: *channel,
            setpoint: Setpoint { mode: Mode::Speed, value: 0.0 },
            position: 0,
            speed,
            duty: 0.0,
            settled: false,
            homed: false,
            winding: None,
        };
        let side = |wheels: &[ChannelId], speed| wheels.iter().map(|wheel| sample(wheel, speed)).collect::<Vec<_>>();
        let mut motors = NewestMotors::default();
        let seen = |motors: &mut NewestMotors, frame: &[Sample]| sides_rad_s(drive, &motors.take(frame)?);
        assert_eq!(seen(&mut motors, &side(&drive.left, 1.0)), None);
        assert_eq!(seen(&mut motors, &side(&drive.right, 2.0)), Some([1.0, 2.0]));
        assert_eq!(seen(&mut motors, &side(&drive.left, 3.0)), Some([3.0, 2.0]));
        // A frame of other channels has no news of them.
        assert_eq!(seen(&mut motors, &[]), None);
        motors.clear();
        assert_eq!(seen(&mut motors, &side(&drive.right, 2.0)), None);
    }

    #[test]
    fn too_much_is_slowed_down_and_keeps_its_curve() {
        let openscout = robot("openscout");
        // The limits are 0.5 m/s and 1.5 rad/s.
        assert_eq!(values(&openscout, 2.0, 1.0), values(&openscout, 0.5, 0.25));
        assert_eq!(values(&openscout, -0.1, -3.0), values(&openscout, -0.05, -1.5));
        assert_eq!(values(&openscout, f64::NAN, 1.0), [0.0; 4]);
        assert_eq!(values(&openscout, 0.1, f64::INFINITY), [0.0; 4]);
    }

    #[test]
    fn no_wheel_is_asked_for_more_than_its_motor_takes() {
        for name in r4_boards::names() {
            let robot = r4_boards::load(name).expect("built in");
            let most = |channel: &ChannelId| {
                let motor = robot.config.motors.iter().find(|motor| motor.id == *channel).expect("it has the motor");
                motor.control.as_ref().expect("with an encoder").speed_max
            };
            let Some(drive) = robot.drive.clone().map(GroundDrive::new) else { continue };
            // To 4 m/s and 4 rad/s, at least twice the limits of every built-in robot, in all quadrants.
            for (forward, yaw) in (-8..=8).flat_map(|forward| (-8..=8).map(move |yaw| (forward, yaw))) {
                let velocity = Velocity { forward_m_s: f64::from(forward) * 0.5, yaw_rad_s: f64::from(yaw) * 0.5 };
                for (channel, setpoint) in drive.setpoints(velocity) {
                    let is_speed = setpoint.mode == Mode::Speed;
                    assert!(!is_speed || setpoint.value.abs() <= most(&channel), "{name}, {velocity:?}: {setpoint:?}");
                }
            }
        }
        // The outer wheels at their limit of 9.5 rad/s, the inner ones as far behind as the curve asks.
        let openscout = robot("openscout");
        let Drive::SkidSteer(SkidSteer { track_m, .. }) = openscout.drive() else { panic!() };
        let across_m_s = 1.5 * track_m / 2.0;
        let inner = (9.5 * (0.5 - across_m_s) / (0.5 + across_m_s)) as f32;
        let [left, _, right, _] = values(&openscout, 0.5, 1.5)[..] else { panic!("four wheels") };
        // f32 at 9.5 rad/s.
        assert!((left - inner).abs() < 1e-6 && (right - 9.5).abs() < 1e-6, "{left}, {right}");
    }

    #[test]
    fn a_car_steers_by_the_bicycle_model() {
        let openpodcar = robot("openpodcar");
        let Drive::Ackermann(car) = openpodcar.drive() else { panic!() };
        let steered = |forward_m_s, yaw_rad_s| {
            car.steering_law.angle_rad(f64::from(values(&openpodcar, forward_m_s, yaw_rad_s)[0]))
        };
        // f32 on a rod of 0.1 m: 19 rad/m times 4e-9 m.
        let near = |one: f64, other: f64| (one - other).abs() < 1e-6;
        assert!(near(steered(0.2, 0.05), (car.wheelbase_m * 0.05 / 0.2).atan()));
        // Backwards the steering angle is opposite; the velocity is scaled down by the same factor.
        assert!(near(steered(-0.4, 0.1), -steered(0.2, 0.05)));
        assert!(near(steered(0.2, 0.0), 0.0) && near(steered(0.0, 0.0), 0.0));
        assert!(near(steered(0.0, 1.0), car.steering_rad.max) && near(steered(0.0, -1.0), car.steering_rad.min));
        assert_eq!(values(&openpodcar, 0.0, 1.0)[1], 0.0);
    }
}
