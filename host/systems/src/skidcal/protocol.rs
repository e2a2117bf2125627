//! Both tests of the paper, driven on a board.

use futures::future::try_join_all;
use r4_boards::{Drive, Robot, SimulatedBody, SkidSteer};
use r4_driver::TelemetryStream;
use r4_protocol::{ChannelId, Mode, Setpoint};
use r4_rig::{Error, Session, inertial_reading, inertial_sensor, sides_rad};

use super::{bristle, scene::Noise};

/// Telemetry period of the wheels, ms.
const WHEELS_EVERY_MS: u16 = 10;
/// Period of the tracker, s: the rate of the paper's positions.
pub(super) const TRACKED_EVERY_S: f64 = 0.05;
/// Shares of the robot's speed limit: that before a straight run, and those of its steps. No wheel is slower, since the
/// law does not contain the friction of a tyre that hardly rolls.
const SLOW: f64 = 0.3;
const STEPS: [f64; 4] = [0.94, 0.6, 0.94, 0.3];
/// Time at the slow speed after a turn, before a run is recorded, s. The prediction starts with bristles at rest; the
/// oscillation that a turn leaves in soft tyres would bias it.
const TURNS_S: f64 = 1.4;
/// Time at the slow speed before the first step of a run, s.
pub(super) const LEAD_S: f64 = 0.3;
/// Duration of each speed, s: twice that of the ramp at 1 m/s², so that half of it is steady.
const STEP_S: f64 = 0.8;
/// Turning rate of the spin with wheels that do not slip, rad/s: the paper's.
pub(super) const SPIN_RAD_S: f64 = 1.0;
/// Settling time of the spin before the measurement, and duration of the measurement, s: at least two rotations.
pub(super) const SPIN_SETTLES_S: f64 = 3.0;
pub(super) const SPIN_S: f64 = 20.0;
/// Rest for the gyroscope's bias, s: known to 0.1 mrad/s then, with half the time to 0.14 mrad/s.
const REST_S: f64 = 4.0;
/// End of the repeated straight runs: half-width of the 95 % interval as a share of the estimate, or this number of
/// runs. Half the share takes four times the runs.
const NARROW: f64 = 0.04;
pub(super) const MOST_RUNS: usize = 100;

/// A skid-steer robot with its premeasured dimensions.
#[derive(Clone, Debug)]
pub struct SkidRobot {
    /// Wheels and speed limits.
    pub drive: SkidSteer,
    /// Half the wheelbase and half the track between the wheels' middles, m.
    pub half_m: [f64; 2],
    /// Mass of the robot, kg: weighed before.
    pub mass_kg: f64,
    /// Inertial sensor whose yaw rate is recorded; `None` for none.
    pub gyroscope: Option<ChannelId>,
}

/// Number of repetitions of the straight runs.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Repeats {
    /// One run there and back.
    Once,
    /// This number of runs there and back.
    Times(usize),
    /// Runs until the interval of `c_long` is narrow, at most `MOST_RUNS`.
    UntilNarrow,
}

/// Travel of the wheels at one moment, m: means over each side.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct WheelSample {
    /// Time on the host's clock, s.
    pub time_s: f64,
    /// Travel of the left and the right side, m.
    pub travel_m: [f64; 2],
}

/// Tracked pose of the robot at one moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tracked {
    /// Time on the host's clock, s.
    pub time_s: f64,
    /// True x and y, m, and heading, rad, without noise.
    exact: [f64; 3],
    /// Noise of x and y, m, and of the heading, rad.
    noise: [f64; 3],
}

/// A sample of the inertial sensor.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Felt {
    /// Time on the host's clock, s.
    pub time_s: f64,
    /// True specific force forwards, m/s², without noise.
    exact_m_s2: f64,
    /// Noise of the specific force, m/s².
    noise_m_s2: f64,
}

/// A reading of the board's gyroscope.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turned {
    /// Time on the host's clock, s.
    pub time_s: f64,
    /// Yaw rate, rad/s, positive to the left.
    pub rate_rad_s: f64,
}

/// Samples of one stretch of time.
#[derive(Clone, Debug, Default)]
pub struct Run {
    /// Samples of the wheels, each time that they were read.
    pub wheels: Vec<WheelSample>,
    /// Tracked poses, each time that the robot was tracked.
    pub tracked: Vec<Tracked>,
    /// Samples of the inertial sensor, simulated.
    pub felt: Vec<Felt>,
    /// Readings of the board's gyroscope, if it is recorded.
    pub turned: Vec<Turned>,
}

/// Recording of both tests.
#[derive(Clone, Debug)]
pub struct Recording {
    /// Robot that was driven.
    pub robot: SkidRobot,
    /// Straight runs, one for each direction.
    pub straight: Vec<Run>,
    /// Number of times the robot went there and back.
    pub runs: usize,
    /// Samples at rest before the first run; empty unless a gyroscope is recorded.
    pub rest: Run,
    /// Samples of the spin after it has settled.
    pub spin: Run,
    /// Standard deviation of the offset between the clocks of wheels and tracker, s.
    pub clock_s: f64,
}

impl SkidRobot {
    /// Reads the robot of a virtual board, with the wheels at the positions of its body.
    ///
    /// # Errors
    /// The part that the robot lacks, in words.
    pub fn of(robot: &Robot, mass_kg: f64) -> Result<Self, String> {
        let Some(Drive::SkidSteer(drive)) = &robot.drive else {
            return Err("it has no [drive.skid-steer]".into());
        };
        let Some(body) = robot.simulation.body.as_ref().and_then(SimulatedBody::wheeled) else {
            return Err("it has no [body.wheeled]".into());
        };
        let wheels = body.wheels();
        let mean = |axis: usize| {
            let sum: f64 = wheels.iter().map(|wheel| wheel.place_m[axis].abs()).sum();
            sum / wheels.len().max(1) as f64
        };
        if wheels.len() != 4 {
            return Err(format!("it has {} wheels, and the protocol is for four", wheels.len()));
        }
        Ok(Self { drive: drive.clone(), half_m: [mean(0), mean(1)], mass_kg, gyroscope: None })
    }

    /// Adds the robot's first inertial sensor, whose readings are then recorded.
    ///
    /// # Errors
    /// The reason in words when the robot has none.
    pub fn with_gyroscope(self, robot: &Robot) -> Result<Self, String> {
        Ok(Self { gyroscope: Some(inertial_sensor(robot)?), ..self })
    }

    /// Straight runs there and back: rim speeds, left and right, m/s, and the duration of each, s. The first speed of
    /// each direction is before the run.
    pub(super) fn straight(&self) -> [Vec<([f64; 2], f64)>; 2] {
        let most_m_s = self.drive.speed_max_m_s;
        [1.0, -1.0].map(|way| {
            let steps = STEPS.map(|share| (share, STEP_S));
            let all = [(SLOW, TURNS_S), (SLOW, LEAD_S)].into_iter().chain(steps);
            all.map(|(share, seconds)| ([way * share * most_m_s; 2], seconds)).collect()
        })
    }

    /// Rim speeds of the spin, left and right, m/s.
    pub(super) fn spin(&self) -> [f64; 2] {
        let rim_m_s = SPIN_RAD_S * self.half_m[1];
        [-rim_m_s, rim_m_s]
    }
}

impl Tracked {
    /// Creates a tracked pose: x and y, m, and heading, rad, with their noise.
    #[must_use]
    pub fn new(time_s: f64, exact: [f64; 3], noise: [f64; 3]) -> Self {
        Self { time_s, exact, noise }
    }

    /// Measured x and y, m, and heading, rad, including noise.
    #[must_use]
    pub fn measured(&self) -> [f64; 3] {
        [0, 1, 2].map(|axis| self.exact[axis] + self.noise[axis])
    }
}

impl Felt {
    /// Creates a sample of the forward specific force, m/s², with its noise.
    #[must_use]
    pub fn new(time_s: f64, exact_m_s2: f64, noise_m_s2: f64) -> Self {
        Self { time_s, exact_m_s2, noise_m_s2 }
    }

    /// Measured specific force, m/s², including noise.
    #[must_use]
    pub fn measured_m_s2(&self) -> f64 {
        self.exact_m_s2 + self.noise_m_s2
    }
}

impl Run {
    pub(super) fn without_noise(&self) -> Self {
        let tracked = self.tracked.iter().map(|tracked| Tracked { noise: [0.0; 3], ..*tracked });
        let felt = self.felt.iter().map(|felt| Felt { noise_m_s2: 0.0, ..*felt });
        Self { tracked: tracked.collect(), felt: felt.collect(), ..self.clone() }
    }
}

impl Recording {
    /// Creates an empty recording of a robot.
    pub(super) fn new(robot: SkidRobot, clock_s: f64) -> Self {
        Self { robot, straight: Vec::new(), runs: 0, rest: Run::default(), spin: Run::default(), clock_s }
    }

    /// Returns the recording of a tracker without noise.
    #[must_use]
    pub fn without_noise(&self) -> Self {
        let straight = self.straight.iter().map(Run::without_noise).collect();
        Self { straight, spin: self.spin.without_noise(), ..self.clone() }
    }

    /// Number of further straight runs that make the interval narrow; 0 when it is narrow, or the limit of runs is
    /// reached.
    pub(super) fn more(&self, repeats: Repeats) -> usize {
        // Without a run there is no interval yet.
        if self.runs == 0 {
            return 1;
        }
        match repeats {
            Repeats::Once => return 0,
            Repeats::Times(runs) => return runs.saturating_sub(self.runs),
            Repeats::UntilNarrow if self.runs >= MOST_RUNS => return 0,
            Repeats::UntilNarrow => {}
        }
        let width = bristle::c_long(self).and_then(|found| Some((found.value, found.interval?)));
        let wide = match width {
            Some((value, interval)) if value > 0.0 => interval.width() / 2.0 / value / NARROW,
            _ => f64::INFINITY,
        };
        if wide <= 1.0 {
            return 0;
        }
        // A standard error falls with the square root of the number of runs.
        let needed = (self.runs as f64 * wide * wide).ceil().min(MOST_RUNS as f64) as usize;
        needed.saturating_sub(self.runs).max(1)
    }
}

/// Drives both tests. `noise` is added to the true pose and acceleration of a virtual board's robot.
///
/// # Errors
/// The error of the board when it does not arm or stops; [`Error::NoReadings`] when the gyroscope sends nothing at
/// rest.
pub async fn drive(
    session: &Session<'_>,
    robot: &SkidRobot,
    repeats: Repeats,
    mut noise: Noise,
) -> Result<Recording, Error> {
    let mut recording = Recording::new(robot.clone(), session.board.clock_uncertainty_us() * 1e-6);
    session
        .armed(async || {
            let mut rider = Rider::new(session, robot, &mut noise).await?;
            if let Some(channel) = robot.gyroscope {
                rider.hold([0.0; 2], REST_S, Some(&mut recording.rest)).await?;
                if recording.rest.turned.is_empty() {
                    return Err(Error::NoReadings { channel });
                }
            }
            loop {
                let more = recording.more(repeats);
                for _ in 0..more {
                    for way in robot.straight() {
                        let mut run = Run::default();
                        for (index, (rim_m_s, seconds)) in way.into_iter().enumerate() {
                            rider.hold(rim_m_s, seconds, (index > 0).then_some(&mut run)).await?;
                        }
                        recording.straight.push(run);
                    }
                    recording.runs += 1;
                }
                if more == 0 {
                    break;
                }
            }
            rider.hold(robot.spin(), SPIN_SETTLES_S, None).await?;
            rider.hold(robot.spin(), SPIN_S, Some(&mut recording.spin)).await?;
            Ok::<_, Error>(())
        })
        .await?;
    // The uncertainty may have grown during the runs: the larger value counts.
    recording.clock_s = recording.clock_s.max(session.board.clock_uncertainty_us() * 1e-6);
    Ok(recording)
}

/// Drive at constant speeds, which records telemetry and tracker meanwhile.
struct Rider<'s> {
    session: &'s Session<'s>,
    robot: &'s SkidRobot,
    telemetry: TelemetryStream,
    noise: &'s mut Noise,
    tracked_at_s: f64,
}

impl<'s> Rider<'s> {
    async fn new(session: &'s Session<'s>, robot: &'s SkidRobot, noise: &'s mut Noise) -> Result<Self, Error> {
        let telemetry = session.board.telemetry();
        for channel in robot.drive.left.iter().chain(&robot.drive.right).chain(&robot.gyroscope) {
            session.board.subscribe(*channel, WHEELS_EVERY_MS).await?;
        }
        Ok(Self { session, robot, telemetry, noise, tracked_at_s: session.board.now_s() })
    }

    async fn hold(&mut self, rim_m_s: [f64; 2], seconds: f64, mut run: Option<&mut Run>) -> Result<(), Error> {
        let board = self.session.board;
        let drive = &self.robot.drive;
        // All wheels at once: sides that step one after the other turn the robot.
        let sides = [&drive.left, &drive.right].into_iter().zip(rim_m_s);
        let wheels = sides.flat_map(|(side, rim_m_s)| side.iter().map(move |channel| (*channel, rim_m_s)));
        let sets = wheels.map(|(channel, rim_m_s)| {
            let value = (rim_m_s / drive.wheel_radius_m) as f32;
            board.set(channel, Setpoint { mode: Mode::Speed, value })
        });
        try_join_all(sets).await?;
        let end_s = board.now_s() + seconds;
        while board.now_s() < end_s {
            let frame = self.telemetry.next().await?;
            if frame.state == r4_protocol::SafetyState::Tripped {
                return Err(r4_driver::Error::Stopped { causes: frame.causes }.into());
            }
            let reading = self.robot.gyroscope.and_then(|sensor| inertial_reading(sensor, &frame.samples));
            if let (Some(run), Some(reading)) = (run.as_deref_mut(), reading) {
                // The gyroscope's sample is older than its frame.
                let time_s = board.host_us(frame.device_us) as f64 * 1e-6 - reading.age_s;
                run.turned.push(Turned { time_s, rate_rad_s: reading.rate_rad_s[2] });
            }
            let sides = sides_rad(board, drive, &frame.samples);
            let (Some(run), Some(sides_rad)) = (run.as_deref_mut(), sides) else { continue };
            let time_s = board.host_us(frame.device_us) as f64 * 1e-6;
            run.wheels
                .push(WheelSample { time_s, travel_m: sides_rad.map(|angle_rad| angle_rad * drive.wheel_radius_m) });
            let now_s = board.now_s();
            if let Some(forward_m_s2) = self.forward_m_s2() {
                run.felt.push(Felt::new(now_s, forward_m_s2, self.noise.inertial_m_s2()));
            }
            if now_s >= self.tracked_at_s
                && let Some(place) = self.session.true_place()
            {
                let exact = [place.x_m, place.y_m, place.yaw_rad];
                run.tracked.push(Tracked::new(now_s, exact, self.noise.place()));
                self.tracked_at_s = now_s + TRACKED_EVERY_S;
            }
        }
        Ok(())
    }

    /// True specific force along the robot, m/s², from a virtual board; `None` on others. The sensor is simulated here,
    /// not read over the board's bus.
    fn forward_m_s2(&self) -> Option<f64> {
        let mut world = self.session.virtual_board().ok()?.world();
        world.catch_up();
        Some(world.body()?.inertial().specific_force_m_s2[0])
    }
}
