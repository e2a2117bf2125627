//! A robot that drives round a room, slows and stops for people, and goes on.
//!
//! The robot knows what the board measures: positions of wheels and ranges. Its true place comes from the simulation and goes into the
//! report only.

use std::{collections::HashMap, path::PathBuf};

use anyhow::{Context, bail};
use r4_boards::{Drive, SkidSteer};
use r4_log::Log;
use r4_protocol::{ChannelId, ChannelKind, Quality, SafetyState, Sample};
use r4_rig::{Follower, GroundDrive, Limits, Odometry, Place, Velocity};
use r4_sim::Pace;
use r4_world::{Body, Pose};
use serde::Serialize;

use super::{table_sha256, write};
use crate::{
    args::{Args, Demo},
    output,
    report::{self, Align, Cell, Column, Map, Overlay},
    session::{self, Elapsed, Session},
    table,
};

/// Corners of the way, m, from the place where it starts.
const CORNERS_M: [[f64; 2]; 4] = [[2.0, 0.0], [2.0, 2.0], [0.0, 2.0], [0.0, 0.0]];
/// Our choice: slow enough to walk beside, and room for a person's foot in front.
const LIMITS: Limits =
    Limits { speed_m_s: 0.35, turn_rate_rad_s: 1.0, braking_m_s2: 0.3, stop_m: 0.35, reached_m: 0.05 };
/// How often wheels and ranges are looked at, ms.
const LOOK_EVERY_MS: u16 = 20;
/// A robot that has not come round by then does not, s.
const TIMEOUT_S: f64 = 120.0;
/// How often a trip's causes are looked at until they are gone, s.
const CLEAR_EVERY_S: f64 = 0.5;
/// Every fifth look, each 0.1 s, is a point of the ways on the map.
const PLACE_EVERY: usize = 5;
/// Every fiftieth look, each second, the robot's outline is drawn on the map.
const OUTLINE_EVERY: usize = 50;
const NO_BODY: &str = "the robot does not stand on a floor: --world lifts it, or its file has no [body]";
/// Least distance to a person that is promised, m.
const PERSON_M: f64 = 0.05;
/// Largest error of the odometry at the end that is promised, m: 2.5 % of the way.
const ODOMETRY_M: f64 = 0.2;

/// What the robot knew at one moment, and did.
#[derive(Clone, Copy, Debug)]
struct Known {
    time_s: f64,
    /// Mean positions of the left and the right wheels, rad.
    sides_rad: [f64; 2],
    /// By the odometry.
    place: Place,
    /// In front, m; infinite with nothing in range.
    free_m: f64,
    /// Asked for.
    velocity: Velocity,
}

/// The same moment, with what was true.
#[derive(Clone, Copy, Debug)]
struct Look {
    known: Known,
    truth: Pose,
    /// Speed over the ground of the places where the left and the right wheels are, m/s.
    ground_m_s: [f64; 2],
    /// From the outline to the nearest person, m.
    person_m: f64,
}

impl Look {
    fn odometry_off_m(&self) -> f64 {
        (self.known.place.x_m - self.truth.x_m).hypot(self.known.place.y_m - self.truth.y_m)
    }
}

/// Something that happened on the way.
#[derive(Clone, Debug, Serialize)]
struct Event {
    time_s: f64,
    place_m: [f64; 2],
    what: String,
}

struct Run {
    looks: Vec<Look>,
    events: Vec<Event>,
    corners: usize,
    map: Map,
}

#[derive(Clone, Debug, Serialize)]
struct Row {
    what: &'static str,
    value: f64,
    unit: &'static str,
    /// What is promised of it, if anything.
    promised: Option<String>,
    met: bool,
}

#[derive(Serialize)]
struct Report {
    board: String,
    rows: Vec<Row>,
    events: Vec<Event>,
    simulated_s: f64,
    real_time_factor: f64,
    table_sha256: String,
    log: PathBuf,
    report: PathBuf,
}

pub(super) fn run(args: &Args, demo: &Demo, robot: &SkidSteer) -> anyhow::Result<bool> {
    let (result, log) = session::in_memory(args, Pace::Free, async |session| drive(session, robot).await);
    let (run, elapsed) = result?;
    let (log_path, report_path) = (demo.out.join("log.mcap"), demo.out.join("report.html"));
    write(&log_path, &log)?;
    let log = Log::from_bytes(&log)?;
    let rows = rows(&run);
    let title = format!("{} drives round a room", log.header.robot);
    let page = report::page(&log, &title, &[page_table(&rows)], &overlays(&run, robot), Some(&run.map));
    write(&report_path, page.as_bytes())?;
    let met = rows.iter().all(|row| row.met);
    let report = Report {
        board: args.board.to_string(),
        rows,
        events: run.events,
        simulated_s: elapsed.simulated_s,
        real_time_factor: elapsed.real_time_factor(),
        table_sha256: table_sha256(&log)?,
        log: log_path,
        report: report_path,
    };
    if args.json {
        output::json(&report)?;
    } else {
        print(&report, elapsed)?;
    }
    Ok(met)
}

/// What the board says of wheels and ranges.
struct Senses<'r> {
    robot: &'r SkidSteer,
    wheels_rad: HashMap<ChannelId, f64>,
    ranges_m: HashMap<ChannelId, f64>,
}

impl Senses<'_> {
    fn look(&mut self, session: &Session<'_>, samples: &[Sample]) {
        for sample in samples {
            match *sample {
                Sample::Motor { channel, position, .. } => {
                    let resolution = session.board.channel(channel).map_or(0.0, |info| f64::from(info.resolution));
                    self.wheels_rad.insert(channel, f64::from(position) * resolution);
                }
                Sample::Reading { channel, value, quality, .. } if channel.kind == ChannelKind::Range => {
                    self.ranges_m.insert(
                        channel,
                        match quality {
                            Quality::Good => value.into(),
                            Quality::OutOfRange => f64::INFINITY,
                            // A sensor that does not work sees nothing, so nothing is known to be free.
                            _ => 0.0,
                        },
                    );
                }
                _ => {}
            }
        }
    }

    /// Mean positions of the left and the right wheels, rad, once all are known.
    fn sides_rad(&self) -> Option<[f64; 2]> {
        let mean = |side: &[ChannelId]| {
            let angles: Option<Vec<f64>> = side.iter().map(|channel| self.wheels_rad.get(channel).copied()).collect();
            angles.map(|angles| angles.iter().sum::<f64>() / angles.len() as f64)
        };
        Some([mean(&self.robot.left)?, mean(&self.robot.right)?])
    }

    /// Way in front that is free, m.
    fn free_m(&self) -> f64 {
        self.ranges_m.values().copied().fold(f64::INFINITY, f64::min)
    }
}

async fn drive(session: &Session<'_>, robot: &SkidSteer) -> anyhow::Result<Run> {
    let board = session.board;
    let ground = GroundDrive::new(Drive::SkidSteer(robot.clone()));
    let mut odometry = Odometry::new(robot);
    let mut follower = Follower::new(LIMITS, CORNERS_M);
    let ranges: Vec<_> =
        board.channels().iter().map(|info| info.id).filter(|id| id.kind == ChannelKind::Range).collect();
    if ranges.is_empty() {
        bail!("the robot has no range sensors, so it would not see people: add [[range]] tables to its file");
    }
    // Nothing is known to be free before a sensor has said so.
    let ranges_m = ranges.iter().map(|channel| (*channel, 0.0)).collect();
    let mut senses = Senses { robot, wheels_rad: HashMap::new(), ranges_m };
    let mut telemetry = board.telemetry();
    for channel in ranges.iter().chain(&robot.left).chain(&robot.right).copied() {
        board.subscribe(channel, LOOK_EVERY_MS).await?;
    }
    let mut run = Run { looks: Vec::new(), events: Vec::new(), corners: 0, map: scene(session)? };
    let begin_s = board.now_s();
    session
        .armed(async || {
            // When a trip is to be cleared next, once the board has tripped.
            let mut clear_s: Option<f64> = None;
            let mut waits = false;
            loop {
                let frame = telemetry.next().await?;
                senses.look(session, &frame.samples);
                let Some(sides_rad) = senses.sides_rad() else { continue };
                odometry.look(sides_rad[0], sides_rad[1]);
                let time_s = board.now_s() - begin_s;
                let mut velocity = Velocity::default();
                if frame.state == SafetyState::Tripped {
                    if clear_s.is_none() {
                        run.happened(session, time_s, format!("tripped: {}", frame.causes))?;
                    }
                    let at_s = *clear_s.get_or_insert(time_s + CLEAR_EVERY_S);
                    if time_s >= at_s {
                        clear_s = Some(time_s + CLEAR_EVERY_S);
                        if again(session).await? {
                            run.happened(session, board.now_s() - begin_s, "cleared and armed again".into())?;
                            // Frames that waited meanwhile tell of the trip.
                            (clear_s, telemetry) = (None, board.telemetry());
                        }
                    }
                } else {
                    match follower.velocity(odometry.place(), senses.free_m()) {
                        Some(next) => velocity = next,
                        None => break,
                    }
                    // One after the other, so that a replay of the log sends them at the same moments.
                    for (channel, setpoint) in ground.setpoints(velocity) {
                        board.set(channel, setpoint).await.or_else(unless_tripped)?;
                    }
                    let stands = velocity == Velocity::default();
                    if stands != waits {
                        let what = if stands { "stops for what is in front" } else { "goes on" };
                        run.happened(session, time_s, what.into())?;
                        waits = stands;
                    }
                }
                run.looked(
                    session,
                    Known { time_s, sides_rad, place: odometry.place(), free_m: senses.free_m(), velocity },
                )?;
                if time_s > TIMEOUT_S {
                    break;
                }
            }
            run.corners = CORNERS_M.len() - follower.places_left();
            anyhow::Ok(())
        })
        .await?;
    Ok(run)
}

/// A set point that is refused because the board has tripped meanwhile is no error: the next frame says why.
fn unless_tripped(error: r4_driver::Error) -> Result<(), r4_driver::Error> {
    if matches!(error, r4_driver::Error::Refused { .. }) { Ok(()) } else { Err(error) }
}

/// Plays the person who has looked why the robot stopped, clears the trip and arms. Whether its cause was gone.
async fn again(session: &Session<'_>) -> anyhow::Result<bool> {
    match session.board.clear().await {
        Ok(()) => {}
        Err(r4_driver::Error::Refused { .. }) => return Ok(false),
        Err(error) => return Err(error.into()),
    }
    session.board.arm().await.context("cannot arm again")?;
    Ok(true)
}

impl Run {
    fn happened(&mut self, session: &Session<'_>, time_s: f64, what: String) -> anyhow::Result<()> {
        let Pose { x_m, y_m, .. } = session.virtual_board()?.world().pose().context(NO_BODY)?;
        let place_m = [x_m, y_m];
        self.map.events_m.push((place_m, format!("{time_s:.1} s: {what}")));
        self.events.push(Event { time_s, place_m, what });
        Ok(())
    }

    fn looked(&mut self, session: &Session<'_>, known: Known) -> anyhow::Result<()> {
        let board = session.virtual_board()?;
        let mut world = board.world();
        let (Some(truth), Some(twist)) = (world.pose(), world.twist()) else { bail!(NO_BODY) };
        let time_s = world.clock().now_ns() as f64 * 1e-9;
        let body = world.wheeled().context(NO_BODY)?;
        let mut person_m = f64::INFINITY;
        if let Some(outline) = body.outline() {
            for person in world.scene().people() {
                person_m = person_m.min(outline.distance_m(truth, person.place_m(time_s), person.radius_m));
            }
            if self.looks.len().is_multiple_of(OUTLINE_EVERY) {
                let corners = outline.corners_m().iter().map(|corner| truth.to_world(*corner));
                self.map.outlines_m.push(corners.collect());
            }
        }
        if self.looks.len().is_multiple_of(PLACE_EVERY) {
            let places = [[truth.x_m, truth.y_m], [known.place.x_m, known.place.y_m]];
            self.map.ways_m.iter_mut().zip(places).for_each(|((_, way), place)| way.push(place));
        }
        // Of the wheels' middles, along the robot.
        let half_m = body.wheels().iter().map(|wheel| wheel.place_m[1].abs()).sum::<f64>() / body.wheels().len() as f64;
        let ground_m_s = [half_m, -half_m].map(|left_m| twist.at([0.0, left_m])[0]);
        self.looks.push(Look { known, truth, ground_m_s, person_m });
        Ok(())
    }
}

/// The world as it is drawn, without the robot.
fn scene(session: &Session<'_>) -> anyhow::Result<Map> {
    let board = session.virtual_board()?;
    let world = board.world();
    let scene = world.scene();
    Ok(Map {
        title: "From above".into(),
        walls_m: scene.walls_m().collect(),
        posts_m: scene.posts_m().collect(),
        people_m: scene
            .people()
            .iter()
            .map(|person| (person.path.iter().map(|(_, place)| *place).collect(), person.radius_m))
            .collect(),
        ways_m: vec![("where the robot was".into(), Vec::new()), ("where its wheels say".into(), Vec::new())],
        ..Map::default()
    })
}

fn rows(run: &Run) -> Vec<Row> {
    let last = run.looks.last();
    let person_m = run.looks.iter().map(|look| look.person_m).fold(f64::INFINITY, f64::min);
    let error_m = last.map_or(f64::NAN, Look::odometry_off_m);
    let error_deg = last.map_or(f64::NAN, |look| (look.known.place.yaw_rad - look.truth.yaw_rad).to_degrees());
    let way = |pair: &[Look]| (pair[1].truth.x_m - pair[0].truth.x_m).hypot(pair[1].truth.y_m - pair[0].truth.y_m);
    let way_m: f64 = run.looks.windows(2).map(way).sum();
    let trips = run.events.iter().filter(|event| event.what.starts_with("tripped")).count();
    let stood_s: f64 = run
        .looks
        .windows(2)
        .filter(|pair| pair[0].known.velocity == Velocity::default())
        .map(|pair| pair[1].known.time_s - pair[0].known.time_s)
        .sum();
    let corners = run.corners as f64;
    let all = CORNERS_M.len() as f64;
    vec![
        Row {
            what: "corners reached",
            value: corners,
            unit: "",
            promised: Some(format!("{all}")),
            met: corners == all,
        },
        Row {
            what: "nearest to a person",
            value: person_m,
            unit: "m",
            promised: Some(format!("at least {PERSON_M}")),
            met: person_m >= PERSON_M,
        },
        Row {
            what: "odometry off at the end",
            value: error_m,
            unit: "m",
            promised: Some(format!("at most {ODOMETRY_M}")),
            met: error_m <= ODOMETRY_M,
        },
        Row { what: "heading off at the end", value: error_deg, unit: "deg", promised: None, met: true },
        Row { what: "way", value: way_m, unit: "m", promised: None, met: true },
        Row {
            what: "time",
            value: last.map_or(f64::NAN, |look| look.known.time_s),
            unit: "s",
            promised: None,
            met: true,
        },
        Row { what: "stood still", value: stood_s, unit: "s", promised: None, met: true },
        Row { what: "trips of the board", value: trips as f64, unit: "", promised: None, met: true },
    ]
}

fn print(report: &Report, elapsed: Elapsed) -> anyhow::Result<()> {
    output::line(format_args!("a room on {} (simulated)", report.board))?;
    let mut table = table::new(&["", "value", "promised", ""], 1..2);
    for Row { what, value, unit, promised, met } in &report.rows {
        table.add_row([
            (*what).to_owned(),
            format!("{value:.3} {unit}"),
            promised.clone().unwrap_or_default(),
            if promised.is_none() {
                ""
            } else if *met {
                "ok"
            } else {
                "not held"
            }
            .to_owned(),
        ]);
    }
    output::line(table)?;
    for Event { time_s, place_m: [x_m, y_m], what } in &report.events {
        output::line(format_args!("{time_s:>6.1} s  at {x_m:.2}, {y_m:.2} m  {what}"))?;
    }
    output::line(format_args!(
        "{:.1} s simulated in {:.2} s, {:.0} x real time",
        elapsed.simulated_s,
        elapsed.wall_s,
        elapsed.real_time_factor()
    ))?;
    output::line(format_args!("log    {} (table sha256 {})", report.log.display(), &report.table_sha256[..16]))?;
    Ok(output::line(format_args!("report {}", report.report.display()))?)
}

fn page_table(rows: &[Row]) -> report::Table {
    let column = |title: &str, align| Column { title: title.into(), unit: None, align };
    report::Table {
        caption: "The way".into(),
        note: Some(
            "Simulated robot, room and people. The robot knows its wheels and two ultrasonic sensors; where it really was only \
             the simulation knows. After a trip the demo plays the person who clears it and arms again."
                .into(),
        ),
        columns: vec![
            column("", Align::Left),
            column("Value", Align::Right),
            column("Unit", Align::Left),
            column("Promised", Align::Left),
            column("Result", Align::Left),
        ],
        rows: rows
            .iter()
            .map(|row| {
                let result = match row.promised {
                    None => Cell::Text(String::new()),
                    Some(_) => Cell::Verdict { pass: row.met, text: if row.met { "met".into() } else { "not met".into() } },
                };
                vec![
                    Cell::Text(row.what.into()),
                    Cell::Number { value: row.value, decimals: 3 },
                    Cell::Text(row.unit.into()),
                    Cell::Text(row.promised.clone().unwrap_or_default()),
                    result,
                ]
            })
            .collect(),
    }
}

/// Ranges, speeds and slip over time.
fn overlays(run: &Run, robot: &SkidSteer) -> Vec<Overlay> {
    let line = |name: &str, value: &dyn Fn(&Look) -> f64| {
        let points = run.looks.iter().map(|look| (look.known.time_s, value(look)));
        (name.to_owned(), points.filter(|(_, value)| value.is_finite()).collect::<Vec<_>>())
    };
    let slip = |name: &str, side: usize| {
        let points = run.looks.windows(2).map(|pair| {
            let (from, to) = (&pair[0], &pair[1]);
            let rolled_m = (to.known.sides_rad[side] - from.known.sides_rad[side]) * robot.wheel_radius_m;
            let rim_m_s = rolled_m / (to.known.time_s - from.known.time_s);
            (to.known.time_s, rim_m_s - f64::midpoint(from.ground_m_s[side], to.ground_m_s[side]))
        });
        (name.to_owned(), points.collect())
    };
    vec![
        Overlay {
            title: "Free way in front (m)".into(),
            since: "the start",
            lines: vec![
                line("kept free", &|_| LIMITS.stop_m),
                line("by the range sensors, at most 2 m", &|look| look.known.free_m.min(2.0)),
                line("true distance to the nearest person, at most 2 m", &|look| look.person_m.min(2.0)),
            ],
        },
        Overlay {
            title: "Speed (m/s)".into(),
            since: "the start",
            lines: vec![
                line("asked for", &|look| look.known.velocity.forward_m_s),
                line("of the robot", &|look| f64::midpoint(look.ground_m_s[0], look.ground_m_s[1])),
            ],
        },
        Overlay {
            title: "Slip: speed of the wheels' rims over the ground (m/s)".into(),
            since: "the start",
            lines: vec![line("none", &|_| 0.0), slip("left wheels", 0), slip("right wheels", 1)],
        },
        Overlay {
            title: "Error of the odometry (m)".into(),
            since: "the start",
            lines: vec![line("promised at the end", &|_| ODOMETRY_M), line("error", &Look::odometry_off_m)],
        },
    ]
}
