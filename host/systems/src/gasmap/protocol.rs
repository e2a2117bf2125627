//! A survey on a board: wheels, gyroscope, gas sensor and ultrasonic sensors by telemetry, lidars by the UART connectors.

use r4_boards::{Drive, SkidSteer};
use r4_maps::pose::Point;
use r4_protocol::{ChannelId, ChannelKind, Mode, Quality, SafetyState, Sample};
use r4_rig::{
    Error, GroundDrive, Place, Rig, Session, Velocity, inertial_reading, inertial_sensor, round::arm_again, sides_rad,
};

use super::{
    localise::{BEAMS, Frames, Localised},
    plan::Plan,
};

/// What the robot does with what it measures.
pub trait Program {
    /// Takes a sample of the gas sensor's signal, ppm, at a time, s, and a pose of the robot.
    fn sense(&mut self, time_s: f64, at: Place, signal_ppm: f64);

    /// The next velocity, with `free_m` in front; `None` at the end.
    fn drive(&mut self, time_s: f64, at: Place, free_m: f64) -> Option<Velocity>;
}

/// Period of the program and of the wheels' telemetry, ms.
const PERIOD_MS: u16 = 20;
/// Of the gas sensor's telemetry, ms.
const GAS_MS: u16 = 100;
/// Of the ultrasonic sensors', ms.
const RANGE_MS: u16 = 60;
/// Boards stop set points older than this, ms: five periods.
const SETPOINT_TTL_MS: u16 = 100;
/// Farthest reading of a lidar that is used, m: it has 12.
const FARTHEST_M: f64 = 11.5;
/// How long the gyroscope is averaged at rest before the wheels are armed, s.
const RESTS_S: f64 = 2.0;
/// How often a trip's causes are looked for to be gone, s.
const CLEAR_EVERY_S: f64 = 1.0;

/// What the program knows of its robot.
#[derive(Clone, Debug)]
pub struct Setup {
    drive: SkidSteer,
    gyroscope: ChannelId,
    gas: ChannelId,
    ranges: Vec<ChannelId>,
    zero_v: f64,
    volts_per_ppm: f64,
}

impl Setup {
    /// Of a robot's file; the gas sensor's line is what its data sheet says.
    ///
    /// # Errors
    /// In words: what the robot lacks.
    pub fn of(rig: &Rig) -> Result<Self, String> {
        let robot = rig.robot().map_err(|error| error.to_string())?;
        let gyroscope = inertial_sensor(&robot)?;
        let Some(Drive::SkidSteer(drive)) = robot.drive.clone() else {
            return Err("it has no [drive.skid-steer]".into());
        };
        let gas = robot.simulation.analogs.iter().find_map(|analog| Some((analog.channel, analog.field.as_ref()?)));
        let (gas, reading) = gas.ok_or("it has no [[simulation.analog]] with a field")?;
        let ranges: Vec<ChannelId> = robot.config.ranges.iter().map(|range| range.id).collect();
        if ranges.is_empty() {
            return Err("it has no [[range]]: it would not see people".into());
        }
        Ok(Self { drive, gyroscope, gas, ranges, zero_v: reading.zero_v, volts_per_ppm: reading.volts_per_unit })
    }
}

/// What was measured and what was true on the way.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Driven {
    /// Times, s, places by the program and true places, m, each period.
    pub path: Vec<(f64, Point, Point)>,
    /// Distance of wheels and gyroscope alone from the truth, m, each period.
    pub dead_reckoned_off_m: Vec<f64>,
    /// Beams that agreed with the plan, and that did not.
    pub beams: [u64; 2],
    /// Trips of the board that were cleared.
    pub trips: usize,
    /// Longest time between two samples of the gas sensor, s.
    pub gap_s: f64,
    /// Samples of the gas sensor.
    pub samples: usize,
    /// Time during which the robot stood for something in front, s.
    pub stood_s: f64,
}

/// Arms, runs a program to its end and disarms. Clears trips as soon as their causes are gone.
///
/// # Errors
/// When the board is not virtual, or fails otherwise than by a trip.
pub async fn run(
    session: &Session<'_>,
    setup: &Setup,
    plan: &Plan,
    program: &mut impl Program,
) -> Result<Driven, Error> {
    let board = session.board;
    let wheels: Vec<ChannelId> = setup.drive.left.iter().chain(&setup.drive.right).copied().collect();
    for channel in wheels.iter().chain([&setup.gyroscope]) {
        board.subscribe(*channel, PERIOD_MS).await?;
    }
    board.subscribe(setup.gas, GAS_MS).await?;
    for channel in &setup.ranges {
        board.subscribe(*channel, RANGE_MS).await?;
    }
    let bias_rad_s = rest(session, setup).await?;
    let start = session.true_place().unwrap_or_default();
    let mut pilot = Pilot {
        session,
        setup,
        plan,
        at: Localised::at(start, bias_rad_s),
        reckoned: Localised::at(start, bias_rad_s),
        frames: Default::default(),
        ranges_m: vec![f64::INFINITY; setup.ranges.len()],
        before: None,
        gas_at_s: None,
        driven: Driven::default(),
    };
    session.armed(async || pilot.drive(program, &wheels).await).await?;
    pilot.driven.beams = pilot.at.counts();
    Ok(pilot.driven)
}

/// Mean rate of the gyroscope at rest, rad/s.
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
    plan: &'s Plan,
    at: Localised,
    reckoned: Localised,
    frames: [Frames; 2],
    ranges_m: Vec<f64>,
    /// Time, s, and mean angle of all wheels, rad.
    before: Option<(f64, f64)>,
    gas_at_s: Option<f64>,
    driven: Driven,
}

impl Pilot<'_> {
    async fn drive(&mut self, program: &mut impl Program, wheels: &[ChannelId]) -> Result<(), Error> {
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
            // Times of the board: its frames wait on the link for different times.
            let now_s = frame.device_us as f64 * 1e-6;
            let angle_rad = f64::midpoint(left_rad, right_rad);
            if let Some((before_s, before_rad)) = self.before.replace((now_s, angle_rad)) {
                let way_m = (angle_rad - before_rad) * self.setup.drive.wheel_radius_m;
                self.at.move_on(way_m, rate_rad_s, now_s - before_s);
                self.reckoned.move_on(way_m, rate_rad_s, now_s - before_s);
            }
            self.look(turn % BEAMS.len()).await?;
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
                        // Frames that waited meanwhile still report the trip.
                        telemetry = board.telemetry();
                    }
                }
                continue;
            }
            let free_m = self.ranges_m.iter().copied().fold(f64::INFINITY, f64::min);
            let Some(velocity) = program.drive(time_s, self.at.place(), free_m) else { return Ok(()) };
            if velocity == Velocity::default() && free_m < super::survey::limits().stop_m {
                self.driven.stood_s += f64::from(PERIOD_MS) * 1e-3;
            }
            let values: Vec<f64> =
                ground.setpoints(velocity).iter().map(|(_, setpoint)| f64::from(setpoint.value)).collect();
            setpoints.set(&values)?;
        }
        Ok(())
    }

    /// Takes the samples of the gas sensor and of the ultrasonic sensors.
    fn sense(&mut self, program: &mut impl Program, time_s: f64, samples: &[Sample]) {
        for sample in samples {
            let Sample::Reading { channel, value, quality, .. } = *sample else { continue };
            let value = f64::from(value);
            if channel == self.setup.gas && quality == Quality::Good {
                let gap_s = self.gas_at_s.replace(time_s).map_or(0.0, |before_s| time_s - before_s);
                self.driven.gap_s = self.driven.gap_s.max(gap_s);
                self.driven.samples += 1;
                program.sense(time_s, self.at.place(), (value - self.setup.zero_v) / self.setup.volts_per_ppm);
            }
            if channel.kind == ChannelKind::Range
                && let Some(range) = self.setup.ranges.iter().position(|range| *range == channel)
            {
                self.ranges_m[range] = match quality {
                    Quality::Good => value,
                    Quality::OutOfRange => f64::INFINITY,
                    _ => 0.0,
                };
            }
        }
    }

    /// Reads a lidar and corrects the pose by its newest reading.
    async fn look(&mut self, port: usize) -> Result<(), Error> {
        let bytes = self.session.board.uart_read(port as u8).await?;
        let readings = self.frames[port].take(&bytes);
        let seen: Vec<f64> = readings.into_iter().flatten().filter(|reading_m| *reading_m < FARTHEST_M).collect();
        if !seen.is_empty() {
            let mean_m = seen.iter().sum::<f64>() / seen.len() as f64;
            self.at.correct(self.plan.walls_m(), BEAMS[port], mean_m, FARTHEST_M);
        }
        Ok(())
    }

    fn note(&mut self, time_s: f64) {
        let Some(truth) = self.session.true_place() else { return };
        let Place { x_m, y_m, .. } = self.at.place();
        self.driven.path.push((time_s, [x_m, y_m], [truth.x_m, truth.y_m]));
        let Place { x_m, y_m, .. } = self.reckoned.place();
        self.driven.dead_reckoned_off_m.push((x_m - truth.x_m).hypot(y_m - truth.y_m));
    }
}
