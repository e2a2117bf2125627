//! Loop that runs a rover's program on a board. Telemetry carries wheels, gyroscope, the field sensor and ultrasonic
//! sensors; the UART connectors carry the readings that correct the pose.

use r4_boards::{Drive, SkidSteer};
use r4_maps::pose::Point;
use r4_protocol::{ChannelId, ChannelKind, Mode, Quality, SafetyState, Sample};
use r4_rig::{
    Error, GroundDrive, Place, Rig, Session, Velocity, inertial_reading, inertial_sensor, round::arm_again, sides_rad,
};

use super::pose::PoseFilter;

/// Behaviour of the robot: consumes measurements, returns velocities.
pub trait Program {
    /// Takes a sample of the field sensor's signal, in the unit of [`Setup`], with its time, s, and the estimated pose
    /// of the robot.
    fn sense(&mut self, time_s: f64, at: Place, signal: f64);

    /// Takes the mean absolute angle of all wheels since the last call, rad.
    fn rolled(&mut self, time_s: f64, angle_rad: f64) {
        let _ = (time_s, angle_rad);
    }

    /// Returns the next velocity; `free_m` is the shortest ultrasonic range, m. `None` ends the program.
    fn drive(&mut self, time_s: f64, at: Place, free_m: f64) -> Option<Velocity>;
}

impl<P: Program + ?Sized> Program for &mut P {
    fn sense(&mut self, time_s: f64, at: Place, signal: f64) {
        (**self).sense(time_s, at, signal);
    }

    fn rolled(&mut self, time_s: f64, angle_rad: f64) {
        (**self).rolled(time_s, angle_rad);
    }

    fn drive(&mut self, time_s: f64, at: Place, free_m: f64) -> Option<Velocity> {
        (**self).drive(time_s, at, free_m)
    }
}

/// Source of pose corrections, such as a GNSS receiver on a UART connector.
pub trait Fix {
    /// UART connector to read in this cycle of the program; `None` for none.
    fn port(&self, turn: usize) -> Option<u8>;

    /// Corrects the pose by bytes received on a connector.
    fn correct(&mut self, port: u8, bytes: &[u8], pose: &mut PoseFilter);

    /// Readings that corrected the pose, and readings that the gate rejected.
    fn counts(&self) -> [u64; 2];
}

/// Period of the program and of the wheels' telemetry, ms.
const PERIOD_MS: u16 = 20;
/// Period of the field sensor's telemetry, ms.
const SIGNAL_MS: u16 = 100;
/// Period of the ultrasonic sensors' telemetry, ms.
const RANGE_MS: u16 = 60;
/// Time to live of set points, ms: five periods of the program.
const SETPOINT_TTL_MS: u16 = 100;
/// Time over which the gyroscope is averaged at rest before the wheels are armed, s.
const RESTS_S: f64 = 2.0;
/// Period of the attempts to clear a trip, s.
const CLEAR_EVERY_S: f64 = 1.0;

/// Channels and scales that the program needs of its robot.
#[derive(Clone, Debug)]
pub struct Setup {
    drive: SkidSteer,
    gyroscope: ChannelId,
    sensor: ChannelId,
    ranges: Vec<ChannelId>,
    zero_v: f64,
    volts_per_unit: f64,
    /// Distance that the program keeps free in front, m.
    stop_m: f64,
}

impl Setup {
    /// Reads the setup from a robot's file, with the field sensor's offset and gain from its datasheet. The robot's
    /// program keeps `stop_m` free in front, m.
    ///
    /// # Errors
    /// The channel or section that the robot lacks, in words.
    pub fn of(rig: &Rig, stop_m: f64) -> Result<Self, String> {
        let robot = rig.robot().map_err(|error| error.to_string())?;
        let gyroscope = inertial_sensor(&robot)?;
        let Some(Drive::SkidSteer(drive)) = robot.drive.clone() else {
            return Err("it has no [drive.skid-steer]".into());
        };
        let sensor = robot.simulation.analogs.iter().find_map(|analog| Some((analog.channel, analog.field.as_ref()?)));
        let (sensor, reading) = sensor.ok_or("it has no [[simulation.analog]] with a field")?;
        let ranges: Vec<ChannelId> = robot.config.ranges.iter().map(|range| range.id).collect();
        if ranges.is_empty() {
            return Err("it has no [[range]]: it would not see people".into());
        }
        Ok(Self {
            drive,
            gyroscope,
            sensor,
            ranges,
            zero_v: reading.zero_v,
            volts_per_unit: reading.volts_per_unit,
            stop_m,
        })
    }
}

impl Setup {
    /// Returns the same setup with the sensor's voltage as its signal, V.
    #[must_use]
    pub fn in_volts(self) -> Self {
        Self { zero_v: 0.0, volts_per_unit: 1.0, ..self }
    }
}

/// Record of a run: estimated and true path, corrections and interruptions.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Driven {
    /// Time, s, estimated position and true position, m, once each period.
    pub path: Vec<(f64, Point, Point)>,
    /// Distance between the dead-reckoned position (wheels and gyroscope only) and the true one, m, once each period.
    pub dead_reckoned_off_m: Vec<f64>,
    /// Readings that corrected the pose, and readings that the gate rejected.
    pub fixes: [u64; 2],
    /// Trips of the board that were cleared.
    pub trips: usize,
    /// Longest time between two samples of the field sensor, s.
    pub gap_s: f64,
    /// Samples of the field sensor.
    pub samples: usize,
    /// Time during which the robot stood because of an obstacle in front, s.
    pub stood_s: f64,
}

/// Arms, runs a program to its end and disarms. Clears trips as soon as their causes are gone.
///
/// # Errors
/// The board's error, other than a trip; [`Error::NoReadings`] when the gyroscope sends nothing at rest.
pub async fn run(
    session: &Session<'_>,
    setup: &Setup,
    fix: &mut impl Fix,
    program: &mut impl Program,
) -> Result<Driven, Error> {
    let board = session.board;
    let wheels: Vec<ChannelId> = setup.drive.left.iter().chain(&setup.drive.right).copied().collect();
    for channel in wheels.iter().chain([&setup.gyroscope]) {
        board.subscribe(*channel, PERIOD_MS).await?;
    }
    board.subscribe(setup.sensor, SIGNAL_MS).await?;
    for channel in &setup.ranges {
        board.subscribe(*channel, RANGE_MS).await?;
    }
    let bias_rad_s = rest(session, setup).await?;
    // The robot starts at a known place; that of a real one is the origin.
    let start = session.true_place().unwrap_or_default();
    let mut pilot = Pilot {
        session,
        setup,
        at: PoseFilter::at(start, bias_rad_s),
        reckoned: PoseFilter::at(start, bias_rad_s),
        ranges_m: vec![f64::INFINITY; setup.ranges.len()],
        before: None,
        sides_rad: [0.0; 2],
        signal_at_s: None,
        driven: Driven::default(),
    };
    session.armed(async || pilot.drive(fix, program, &wheels).await).await?;
    pilot.driven.fixes = fix.counts();
    Ok(pilot.driven)
}

/// Averages the gyroscope's yaw rate at rest, rad/s: its bias.
async fn rest(session: &Session<'_>, setup: &Setup) -> Result<f64, Error> {
    let mut telemetry = session.board.telemetry();
    let until_s = session.board.now_s() + RESTS_S;
    let (mut sum_rad_s, mut count) = (0.0, 0.0);
    while session.board.now_s() < until_s {
        if let Some(reading) = inertial_reading(setup.gyroscope, &telemetry.next().await?.samples) {
            sum_rad_s += reading.rate_rad_s[2];
            count += 1.0;
        }
    }
    if count == 0.0 { Err(Error::NoReadings { channel: setup.gyroscope }) } else { Ok(sum_rad_s / count) }
}

struct Pilot<'s> {
    session: &'s Session<'s>,
    setup: &'s Setup,
    at: PoseFilter,
    reckoned: PoseFilter,
    ranges_m: Vec<f64>,
    /// Time of the last frame, s, and mean angle of all wheels then, rad.
    before: Option<(f64, f64)>,
    /// Angles of the left and right wheels in the last frame, rad.
    sides_rad: [f64; 2],
    signal_at_s: Option<f64>,
    driven: Driven,
}

impl Pilot<'_> {
    async fn drive(
        &mut self,
        fix: &mut impl Fix,
        program: &mut impl Program,
        wheels: &[ChannelId],
    ) -> Result<(), Error> {
        let board = self.session.board;
        let ground = GroundDrive::new(Drive::SkidSteer(self.setup.drive.clone()));
        let speeds: Vec<_> = wheels.iter().map(|channel| (*channel, Mode::Speed)).collect();
        let mut telemetry = board.telemetry();
        let mut setpoints = board.stream(&speeds, SETPOINT_TTL_MS).await?;
        let begin_s = board.now_s();
        let mut tripped_at_s: Option<f64> = None;
        let mut rate_rad_s = 0.0;
        for turn in 0usize.. {
            let frame = telemetry.next().await?;
            if let Some(reading) = inertial_reading(self.setup.gyroscope, &frame.samples) {
                rate_rad_s = reading.rate_rad_s[2];
            }
            self.sense(program, board.now_s() - begin_s, &frame.samples);
            let Some([left_rad, right_rad]) = sides_rad(board, &self.setup.drive, &frame.samples) else { continue };
            // Stamps of the board, not arrival times: frames wait on the link for different durations.
            let now_s = frame.device_us as f64 * 1e-6;
            let angle_rad = f64::midpoint(left_rad, right_rad);
            if let Some((before_s, before_rad)) = self.before.replace((now_s, angle_rad)) {
                let way_m = (angle_rad - before_rad) * self.setup.drive.wheel_radius_m;
                self.at.move_on(way_m, rate_rad_s, now_s - before_s);
                self.reckoned.move_on(way_m, rate_rad_s, now_s - before_s);
                program.rolled(board.now_s() - begin_s, rolled_rad([left_rad, right_rad], self.sides_rad));
            }
            self.sides_rad = [left_rad, right_rad];
            if let Some(port) = fix.port(turn) {
                let bytes = board.uart_read(port).await?;
                fix.correct(port, &bytes, &mut self.at);
            }
            let time_s = board.now_s() - begin_s;
            self.note(time_s);
            if frame.state == SafetyState::Tripped {
                let since_s = *tripped_at_s.get_or_insert(time_s);
                if time_s - since_s >= CLEAR_EVERY_S {
                    tripped_at_s = Some(time_s);
                    if arm_again(self.session).await? {
                        self.driven.trips += 1;
                        tripped_at_s = None;
                        setpoints = board.stream(&speeds, SETPOINT_TTL_MS).await?;
                        // Frames that were queued meanwhile still report the trip.
                        telemetry = board.telemetry();
                    }
                }
                continue;
            }
            let free_m = self.ranges_m.iter().copied().fold(f64::INFINITY, f64::min);
            let Some(velocity) = program.drive(time_s, self.at.place(), free_m) else { return Ok(()) };
            if velocity == Velocity::default() && free_m < self.setup.stop_m {
                self.driven.stood_s += f64::from(PERIOD_MS) * 1e-3;
            }
            let values: Vec<f64> =
                ground.setpoints(velocity).iter().map(|(_, setpoint)| f64::from(setpoint.value)).collect();
            setpoints.set(&values)?;
        }
        Ok(())
    }

    /// Passes samples of the field sensor to the program and stores the ultrasonic ranges, m.
    fn sense(&mut self, program: &mut impl Program, time_s: f64, samples: &[Sample]) {
        for sample in samples {
            let Sample::Reading { channel, value, quality, .. } = *sample else { continue };
            let value = f64::from(value);
            if channel == self.setup.sensor && quality == Quality::Good {
                let gap_s = self.signal_at_s.replace(time_s).map_or(0.0, |before_s| time_s - before_s);
                self.driven.gap_s = self.driven.gap_s.max(gap_s);
                self.driven.samples += 1;
                program.sense(time_s, self.at.place(), (value - self.setup.zero_v) / self.setup.volts_per_unit);
            }
            if channel.kind == ChannelKind::Range
                && let Some(range) = self.setup.ranges.iter().position(|range| *range == channel)
            {
                // No echo means free space; any other fault counts as an obstacle at 0 m, which is the safe side.
                self.ranges_m[range] = match quality {
                    Quality::Good => value,
                    Quality::OutOfRange => f64::INFINITY,
                    _ => 0.0,
                };
            }
        }
    }

    fn note(&mut self, time_s: f64) {
        let Some(truth) = self.session.true_place() else { return };
        let Place { x_m, y_m, .. } = self.at.place();
        self.driven.path.push((time_s, [x_m, y_m], [truth.x_m, truth.y_m]));
        let Place { x_m, y_m, .. } = self.reckoned.place();
        self.driven.dead_reckoned_off_m.push((x_m - truth.x_m).hypot(y_m - truth.y_m));
    }
}

/// Mean absolute angle by which both sides' wheels turned, rad.
fn rolled_rad(now_rad: [f64; 2], before_rad: [f64; 2]) -> f64 {
    f64::midpoint((now_rad[0] - before_rad[0]).abs(), (now_rad[1] - before_rad[1]).abs())
}
