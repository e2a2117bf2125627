//! Paths of motors over time: parsed from a table, sent ahead of time, followed together, and graded by the motors'
//! tracking error.

mod feed;
mod limits;

use std::collections::BTreeMap;

use r4_driver::Error as DriverError;
use r4_protocol::{ChannelId, ChannelInfo, Mode, SafetyState, Sample, Unit, message::PATH_POINTS};

use crate::{Error, Session, Unsuitable};

pub use feed::Feed;
pub use limits::{BeyondLimit, check};

/// Point of a motor's path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Waypoint {
    /// Time since the start of the path, s.
    pub time_s: f64,
    /// Position, rad or m.
    pub position: f64,
    /// Speed, rad/s or m/s; `None` lets the board compute it from the neighbouring points.
    pub speed: Option<f64>,
    /// Feed-forward duty from the point before to this one, added to the board's own.
    pub feed_forward: f64,
}

impl Waypoint {
    /// Creates a point from its time, s, and position, rad or m, with a derived speed and no feed-forward.
    #[must_use]
    pub fn at(time_s: f64, position: f64) -> Self {
        Self { time_s, position, speed: None, feed_forward: 0.0 }
    }
}

/// Paths of several channels over a common time.
#[derive(Clone, Debug, PartialEq)]
pub struct Paths {
    /// Points of each channel, in the order of time; at least two.
    pub channels: Vec<(ChannelId, Vec<Waypoint>)>,
}

/// Error of a table or of points that are no valid path.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum PathError {
    /// The first line does not name valid columns.
    #[error(
        "the first line must name the columns: time_s, osmc0.position_rad and optionally osmc0.speed_rad_s and osmc0.duty; {0}"
    )]
    Header(String),
    /// A line cannot be parsed.
    #[error("line {line}: {why}")]
    Line {
        /// Line number, from 1 on.
        line: usize,
        /// Reason for the user, in words.
        why: String,
    },
    /// A point is not valid.
    #[error("point {index} of {channel}: {why}")]
    Points {
        /// Channel of the point.
        channel: ChannelId,
        /// Index of the point, from 0 on.
        index: usize,
        /// Reason for the user, in words.
        why: &'static str,
    },
    /// A path has fewer than two points.
    #[error("a path needs at least two points")]
    Short,
}

/// Meaning of a table's column.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Column {
    Time,
    Position(ChannelId, Unit),
    Speed(ChannelId, Unit),
    Duty(ChannelId),
}

impl Column {
    fn parse(name: &str) -> Result<Self, String> {
        if name == "time_s" {
            return Ok(Self::Time);
        }
        let unknown = || format!("unknown column `{name}`");
        let (channel, field) = name.split_once('.').ok_or_else(unknown)?;
        let channel = channel.parse().map_err(|_| unknown())?;
        Ok(match field {
            "position_rad" => Self::Position(channel, Unit::Rad),
            "position_m" => Self::Position(channel, Unit::M),
            "speed_rad_s" => Self::Speed(channel, Unit::Rad),
            "speed_m_s" => Self::Speed(channel, Unit::M),
            "duty" => Self::Duty(channel),
            _ => return Err(unknown()),
        })
    }
}

/// Minimum time between points, s; closer ones are omitted. The board keeps 32 points, which must last longer than a
/// transfer takes.
pub const THIN_S: f64 = 0.008;
/// Rounding of times in s with three decimals or more.
const ROUNDING_S: f64 = 1e-9;
/// Time from sending a path to its first point, s; longer when the motor must first move to that point.
const LEAD_S: f64 = 0.3;
/// Period at which points are sent, s.
const SEND_EVERY_S: f64 = 0.02;
/// Telemetry period of the motors, ms.
const LOOK_EVERY_MS: u16 = 5;
/// Time for a motor to settle after its last point, s.
const SETTLE_S: f64 = 5.0;

impl Paths {
    /// Parses a table whose first line names the columns: `time_s`, and for each channel `osmc0.position_rad`
    /// (`actuator1.position_m`) and, optionally, `osmc0.speed_rad_s` and `osmc0.duty`, as in recordings. Values are
    /// separated by commas.
    ///
    /// # Errors
    /// [`PathError`] for a table that is not valid.
    pub fn parse(text: &str) -> Result<Self, PathError> {
        // Numbered before blank lines are removed: errors name the line as an editor shows it.
        let mut lines = text.lines().enumerate().filter(|(_, line)| !line.trim().is_empty());
        let header = lines.next().map_or("", |(_, line)| line);
        let columns: Result<Vec<_>, _> = header.split(',').map(|name| Column::parse(name.trim())).collect();
        let columns = columns.map_err(PathError::Header)?;
        let header = |why: &str| PathError::Header(why.to_owned());
        // A repeated column would silently replace the first one.
        let twice = columns.iter().enumerate().any(|(place, column)| columns[..place].contains(column));
        let time = columns.iter().position(|column| *column == Column::Time);
        let time =
            time.filter(|_| !twice).ok_or_else(|| header("time_s is required, and each column may occur only once"))?;
        let positions = columns.iter().filter_map(|column| match column {
            Column::Position(channel, unit) => Some((*channel, *unit)),
            _ => None,
        });
        let units: BTreeMap<ChannelId, Unit> = positions.collect();
        // Speed and duty need a position column of the same channel, the speed in the same unit.
        let alone = columns.iter().any(|column| match column {
            Column::Speed(channel, unit) => units.get(channel) != Some(unit),
            Column::Duty(channel) => !units.contains_key(channel),
            Column::Time | Column::Position(..) => false,
        });
        if alone || units.is_empty() {
            return Err(header("each channel needs a position column, and its speed the same unit"));
        }
        let mut paths: BTreeMap<ChannelId, Vec<Waypoint>> = BTreeMap::new();
        let mut last_s = f64::NEG_INFINITY;
        for (number, line) in lines {
            let wrong = |why: String| PathError::Line { line: number + 1, why };
            let values: Result<Vec<f64>, _> = line.split(',').map(|value| number_of(value.trim())).collect();
            let values = values.map_err(wrong)?;
            if values.len() != columns.len() {
                return Err(wrong(format!("it has {} values for {} columns", values.len(), columns.len())));
            }
            let time_s = values[time];
            // The board interpolates between points, which needs a positive duration.
            if time_s <= last_s {
                return Err(wrong("its time must be later than the one before".to_owned()));
            }
            last_s = time_s;
            for channel in units.keys() {
                let mut point = Waypoint { time_s, position: 0.0, speed: None, feed_forward: 0.0 };
                for (column, value) in columns.iter().zip(&values) {
                    match column {
                        Column::Position(of, _) if of == channel => point.position = *value,
                        Column::Speed(of, _) if of == channel => point.speed = Some(*value),
                        Column::Duty(of) if of == channel => point.feed_forward = *value,
                        _ => {}
                    }
                }
                paths.entry(*channel).or_default().push(point);
            }
        }
        if paths.values().any(|points| points.len() < 2) || paths.is_empty() {
            return Err(PathError::Short);
        }
        Ok(Self { channels: paths.into_iter().map(|(channel, points)| (channel, thinned(points))).collect() })
    }

    /// Creates paths from points: at least two for each channel, each later than the one before, all numbers finite.
    /// Points closer than [`THIN_S`] to the one before are omitted, as from a table.
    ///
    /// # Errors
    /// [`PathError::Points`] for a point that is not valid; [`PathError::Short`] for fewer than two.
    pub fn new(channels: impl IntoIterator<Item = (ChannelId, Vec<Waypoint>)>) -> Result<Self, PathError> {
        let mut made = Vec::new();
        for (channel, points) in channels {
            let mut last_s = f64::NEG_INFINITY;
            for (index, point) in points.iter().enumerate() {
                let numbers = [point.time_s, point.position, point.speed.unwrap_or(0.0), point.feed_forward];
                let why = match numbers.iter().all(|number| number.is_finite()) {
                    false => "it has a number that is not finite",
                    true if point.time_s <= last_s => "its time is not later than the one before",
                    true => {
                        last_s = point.time_s;
                        continue;
                    }
                };
                return Err(PathError::Points { channel, index, why });
            }
            if points.len() < 2 {
                return Err(PathError::Short);
            }
            made.push((channel, thinned(points)));
        }
        if made.is_empty() { Err(PathError::Short) } else { Ok(Self { channels: made }) }
    }

    /// Time from the first point to the last, s.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        let ends = self.channels.iter().filter_map(|(_, points)| Some((points.first()?.time_s, points.last()?.time_s)));
        ends.map(|(first, last)| last - first).fold(0.0, f64::max)
    }
}

fn number_of(text: &str) -> Result<f64, String> {
    let number = text.parse::<f64>().ok().filter(|number| number.is_finite());
    number.ok_or_else(|| format!("`{text}` is not a number"))
}

/// Removes points closer than [`THIN_S`] to the one before; the last point is kept.
#[must_use]
pub fn thinned(points: Vec<Waypoint>) -> Vec<Waypoint> {
    let mut kept: Vec<Waypoint> = Vec::new();
    let last = points.last().copied();
    for point in points {
        if kept.last().is_none_or(|before| point.time_s - before.time_s > THIN_S - ROUNDING_S) {
            kept.push(point);
        }
    }
    if kept.last() != last.as_ref()
        && let Some(last) = last
    {
        // At least two points remain, and the last is not too close to the one before it.
        if kept.len() > 1 && kept.last().is_some_and(|before| last.time_s - before.time_s < THIN_S) {
            kept.pop();
        }
        kept.push(last);
    }
    kept
}

/// Result of following a path with one motor.
#[derive(Clone, Debug)]
pub struct Followed {
    /// Description of the channel by the board.
    pub info: ChannelInfo,
    /// Number of points that were sent.
    pub points: usize,
    /// Largest tracking error, rad or m, without a sign, by the motor's own sensor.
    pub worst: f64,
    /// RMS tracking error, rad or m.
    pub rms: f64,
    /// Lag of the motion behind the path, s, by least squares; 0 for a path without motion.
    pub lag_s: f64,
    /// Final position, rad or m.
    pub end: f64,
    /// True when the motor came to rest at the path's last point.
    pub settled: bool,
}

/// Path while it is sent to the board.
struct Sending<'p> {
    info: ChannelInfo,
    points: &'p [Waypoint],
    /// Points on their way to the board; empty until the board's clock at the start of the path is known.
    feed: Feed,
    /// Set point (rad or m), measured position (rad or m) and time on the board's clock (µs) of each sample.
    seen: Vec<(f64, f64, u64)>,
    /// Last measured position (rad or m), whether the motor is settled, and its mode; `None` before the first sample.
    end: Option<(f64, bool, Mode)>,
}

impl Session<'_> {
    /// Arms, lets motors follow their paths with a common start, waits until they rest, and disarms. A motor that is
    /// not at its first point moves there first, at a third of its speed limit. The paths begin at `begin_s` on the
    /// driver's clock, so that several boards can follow theirs together; `None` begins as soon as possible.
    ///
    /// # Errors
    /// [`Unsuitable`], before anything is sent, for a channel that cannot follow a path; the error of the board when it
    /// refuses points, which stops the channel, or does not arm or disarm; the error of the link.
    pub async fn follow(&self, paths: &Paths, begin_s: Option<f64>) -> Result<Vec<Followed>, Error> {
        let mut sending = self.prepared(paths).await?;
        self.armed(async || self.send(&mut sending, begin_s).await).await?;
        Ok(sending.into_iter().map(Sending::judged).collect())
    }

    /// Follows paths as [`Session::follow`], on a board that is armed and stays so.
    ///
    /// # Errors
    /// The errors of [`Session::follow`]; a board that is not armed refuses the points.
    pub async fn follow_armed(&self, paths: &Paths, begin_s: Option<f64>) -> Result<Vec<Followed>, Error> {
        let mut sending = self.prepared(paths).await?;
        self.send(&mut sending, begin_s).await?;
        Ok(sending.into_iter().map(Sending::judged).collect())
    }

    /// Checks the channels and subscribes to them, before the first points are sent.
    async fn prepared<'p>(&self, paths: &'p Paths) -> Result<Vec<Sending<'p>>, Error> {
        let mut sending = Vec::new();
        for (channel, points) in &paths.channels {
            let info = self.board.channel(*channel)?.clone();
            if info.mode(Mode::Follow).is_none() {
                let why = "cannot follow a path: only motors with feedback can".to_owned();
                return Err(Unsuitable { channel: *channel, why }.into());
            }
            sending.push(Sending { info, points, feed: Feed::default(), seen: Vec::new(), end: None });
        }
        // Only after all channels were checked: an unsuitable one changes nothing.
        for path in &sending {
            self.board.subscribe(path.info.id, LOOK_EVERY_MS).await?;
        }
        Ok(sending)
    }

    async fn send(&self, sending: &mut [Sending<'_>], begin_s: Option<f64>) -> Result<(), Error> {
        let board = self.board;
        let mut telemetry = board.telemetry();
        let mut look = |sending: &mut [Sending<'_>]| {
            while let Some(frame) = telemetry.try_next() {
                for sample in &frame.samples {
                    let Sample::Motor { channel, setpoint, position, settled, .. } = *sample else { continue };
                    let Some(path) = sending.iter_mut().find(|path| path.info.id == channel) else { continue };
                    let position = f64::from(position) * f64::from(path.info.resolution);
                    path.end = Some((position, settled, setpoint.mode));
                    if setpoint.mode == Mode::Follow {
                        path.seen.push((setpoint.value.into(), position, frame.device_us));
                    }
                }
            }
        };
        // After 0.1 s the motors' supply is on, and each motor has been sampled.
        board.sleep_s(0.1).await;
        look(sending);
        let ways_s = sending.iter().map(|path| path.way_s());
        // Without a common start, the motor with the longest move to its first point determines the lead.
        let lead_s = begin_s.map_or_else(|| ways_s.fold(LEAD_S, f64::max), |begin_s| begin_s - board.now_s());
        let begin_us = board.device_us() + (lead_s * 1e6) as u64;
        // A table may start at any time: its earliest point is the start of all paths.
        let first_s = sending.iter().map(|path| path.points[0].time_s).fold(f64::INFINITY, f64::min);
        for path in sending.iter_mut() {
            path.feed = Feed::new(path.points, first_s, begin_us);
        }
        loop {
            for path in sending.iter_mut() {
                let (channel, points) = (path.info.id, path.feed.next(board.device_us(), PATH_POINTS));
                if !points.is_empty() {
                    board.follow(channel, &points).await?;
                }
            }
            look(sending);
            if sending.iter().all(|path| path.feed.is_sent()) {
                break;
            }
            board.sleep_s(SEND_EVERY_S).await;
        }
        let end_us = sending.iter().filter_map(|path| path.feed.end_us()).max().unwrap_or_default();
        let give_up_us = end_us + (SETTLE_S * 1e6) as u64;
        while board.device_us() < give_up_us {
            board.sleep_s(SEND_EVERY_S).await;
            // Without this check a trip would only show as a motor that does not settle.
            if let (SafetyState::Tripped | SafetyState::Disarmed, causes) = board.safety() {
                return Err(DriverError::Stopped { causes }.into());
            }
            look(sending);
            // After the last point the board holds the position, in the mode for positions.
            let rests = |path: &Sending<'_>| matches!(path.end, Some((_, true, Mode::Position)));
            if board.device_us() > end_us && sending.iter().all(rests) {
                break;
            }
        }
        Ok(())
    }
}

impl Sending<'_> {
    /// Time of the move to the first point, s.
    fn way_s(&self) -> f64 {
        let Some((position, ..)) = self.end else { return 0.0 };
        let fastest = self.info.mode(Mode::Speed).map_or(f64::INFINITY, |mode| mode.range.max.into());
        // The peak speed of a cubic from rest to rest is one and a half times its mean; a third of the limit makes 4.5.
        4.5 * (self.points[0].position - position).abs() / fastest
    }

    fn judged(self) -> Followed {
        let begin_us = self.feed.begin_us().unwrap_or_default();
        // The move to the first point is not part of the path.
        let on_path: Vec<_> = self.seen.iter().filter(|(.., at_us)| *at_us >= begin_us).collect();
        let errors = on_path.iter().map(|(reference, position, _)| reference - position);
        let worst = errors.clone().fold(0.0, |worst: f64, error| worst.max(error.abs()));
        let rms = (errors.map(|error| error * error).sum::<f64>() / on_path.len().max(1) as f64).sqrt();
        // A lag causes an error of speed times lag, so it is the regression coefficient of the error on the speed.
        let (mut product, mut square) = (0.0, 0.0);
        for pair in on_path.windows(2) {
            let [(before, _, before_us), (reference, position, at_us)] = pair else { continue };
            let speed = (reference - before) / ((at_us - before_us).max(1) as f64 * 1e-6);
            product += speed * (reference - position);
            square += speed * speed;
        }
        let (end, settled) =
            self.end.map_or((f64::NAN, false), |(end, settled, mode)| (end, settled && mode == Mode::Position));
        // A path without motion does not determine a lag.
        let lag_s = if square > 0.0 { product / square } else { 0.0 };
        Followed { points: self.feed.sent(), info: self.info, worst, rms, lag_s, end, settled }
    }
}

#[cfg(test)]
mod tests {
    use r4_protocol::ChannelKind;

    use super::*;

    const OSMC0: ChannelId = ChannelId::new(ChannelKind::Osmc, 0);

    #[test]
    fn a_table_is_read_by_its_names() {
        let text = "actuator1.position_m, time_s,osmc0.position_rad,osmc0.speed_rad_s,osmc0.duty\n\
                    0.05,0,0,0,0\n\n0.06,0.5,1.5,-2,0.25\n";
        let paths = Paths::parse(text).expect("a table");
        let rod = ChannelId::new(ChannelKind::Actuator, 1);
        let point = |time_s, position, speed, feed_forward| Waypoint { time_s, position, speed, feed_forward };
        let motor = vec![point(0.0, 0.0, Some(0.0), 0.0), point(0.5, 1.5, Some(-2.0), 0.25)];
        let actuator = vec![point(0.0, 0.05, None, 0.0), point(0.5, 0.06, None, 0.0)];
        assert_eq!(paths.channels, [(OSMC0, motor), (rod, actuator)]);
        assert_eq!(paths.duration_s(), 0.5);
    }

    #[test]
    fn what_is_no_table_says_where_it_is_wrong() {
        for (text, says) in [
            (
                "",
                "the first line must name the columns: time_s, osmc0.position_rad and optionally osmc0.speed_rad_s and osmc0.duty; unknown column ``",
            ),
            ("time_s\n0\n1\n", "each channel needs a position column, and its speed the same unit"),
            ("osmc0.position_rad\n0\n1\n", "time_s is required, and each column may occur only once"),
            ("time_s,time_s,osmc0.position_rad\n", "time_s is required, and each column may occur only once"),
            ("time_s,osmc0.position_deg\n", "unknown column `osmc0.position_deg`"),
            ("time_s,wheel0.position_rad\n", "unknown column `wheel0.position_rad`"),
            (
                "time_s,osmc0.position_rad,osmc0.speed_m_s\n",
                "each channel needs a position column, and its speed the same unit",
            ),
            ("time_s,osmc0.position_rad\n0,0\n", "a path needs at least two points"),
            ("time_s,osmc0.position_rad\n0,0\n1,x\n", "line 3: `x` is not a number"),
            ("time_s,osmc0.position_rad\n0,0\n1,nan\n", "line 3: `nan` is not a number"),
            ("time_s,osmc0.position_rad\n0,0\n1\n", "line 3: it has 1 values for 2 columns"),
            ("time_s,osmc0.position_rad\n1,0\n1,0\n", "line 3: its time must be later than the one before"),
        ] {
            let error = Paths::parse(text).expect_err(text).to_string();
            assert!(error.ends_with(says), "{text:?}: {error}");
        }
    }

    #[test]
    fn points_of_a_program_are_checked_as_those_of_a_table() {
        let point = |time_s, position| Waypoint { time_s, position, speed: None, feed_forward: 0.0 };
        let paths = |points: &[(f64, f64)]| Paths::new([(OSMC0, points.iter().map(|(t, p)| point(*t, *p)).collect())]);
        let text = "time_s,osmc0.position_rad\n0,0\n0.001,0.5\n0.5,1\n";
        assert_eq!(paths(&[(0.0, 0.0), (0.001, 0.5), (0.5, 1.0)]), Paths::parse(text));
        assert_eq!(paths(&[(0.0, 0.0)]), Err(PathError::Short));
        assert_eq!(Paths::new([]), Err(PathError::Short));
        for (bad, index) in
            [([(0.0, 0.0), (0.0, 1.0)], 1), ([(f64::NAN, 0.0), (1.0, 1.0)], 0), ([(0.0, 0.0), (1.0, f64::INFINITY)], 1)]
        {
            let error = paths(&bad).expect_err("bad");
            assert!(matches!(error, PathError::Points { index: at, .. } if at == index), "{error}");
        }
    }

    #[test]
    fn points_close_together_are_thinned_and_the_ends_kept() {
        let lines: Vec<String> = (0..=100).map(|ms| format!("{},{ms}", f64::from(ms) * 1e-3)).collect();
        let text = format!("time_s,osmc0.position_rad\n{}\n", lines.join("\n"));
        let paths = Paths::parse(&text).expect("a table");
        let times: Vec<_> = paths.channels[0].1.iter().map(|point| (point.time_s * 1e3).round() as u32).collect();
        assert_eq!(times, [0, 8, 16, 24, 32, 40, 48, 56, 64, 72, 80, 88, 100]);
        let two = Paths::parse("time_s,osmc0.position_rad\n0,0\n0.001,0\n").expect("a table");
        assert_eq!(two.channels[0].1.len(), 2);
    }
}
