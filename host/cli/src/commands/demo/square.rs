//! Demo of a driving robot: [`r4_rig::round`] in a room with people, with a report.
//!
//! The robot uses only measurements of the board: wheel positions and ranges. Its true pose comes from the simulation
//! and is used in the report only.

use std::path::PathBuf;

use anyhow::{Context, bail};
use r4_boards::SkidSteer;
use r4_log::Log;
use r4_rig::{
    Limits, Velocity,
    round::{self, Measured, Observation, Round},
};
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

/// Waypoints, m, from the place where the robot starts.
const CORNERS_M: [[f64; 2]; 4] = [[2.0, 0.0], [2.0, 2.0], [0.0, 2.0], [0.0, 0.0]];
/// Our choice: slow enough to walk beside, and room for a person's foot in front.
const LIMITS: Limits =
    Limits { speed_m_s: 0.35, turn_rate_rad_s: 1.0, braking_m_s2: 0.3, stop_m: 0.35, reached_m: 0.05 };
/// Period of the wheels' and range sensors' telemetry, ms.
const TELEMETRY_MS: u16 = 20;
/// Limit of the drive, s.
const TIMEOUT_S: f64 = 120.0;
/// Period of attempts to clear a trip, s.
const CLEAR_EVERY_S: f64 = 0.5;
/// Samples per point of the paths on the map: one point each 0.1 s.
const PLACE_EVERY: usize = 5;
/// Samples per outline of the robot on the map: one each second.
const OUTLINE_EVERY: usize = 50;
const NO_BODY: &str = "the robot does not stand on a floor: --world lifts it, or its file has no [body]";
/// Least distance to a person for which the demo passes, m.
const PERSON_M: f64 = 0.05;
/// Largest position error of the odometry at the end for which the demo passes, m: 2.5 % of the path.
const ODOMETRY_M: f64 = 0.2;

/// Measurements of a telemetry frame, with the truth of the simulation at that moment.
#[derive(Clone, Copy, Debug)]
struct Sample {
    known: Measured,
    /// True pose of the body.
    truth: Pose,
    /// True speed over the ground beside the left and the right wheels, m/s.
    ground_m_s: [f64; 2],
    /// From the outline to the nearest person, m.
    person_m: f64,
}

impl Sample {
    fn odometry_off_m(&self) -> f64 {
        (self.known.place.x_m - self.truth.x_m).hypot(self.known.place.y_m - self.truth.y_m)
    }
}

/// A change of what the robot does, with the true place of it.
#[derive(Clone, Debug, Serialize)]
struct Event {
    time_s: f64,
    place_m: [f64; 2],
    what: String,
}

struct Run {
    samples: Vec<Sample>,
    events: Vec<Event>,
    corners: usize,
    trips: usize,
    map: Map,
}

#[derive(Clone, Debug, Serialize)]
struct Row {
    what: &'static str,
    value: f64,
    unit: &'static str,
    /// Limit that the value has to meet, in words; `None` where it is only reported.
    limit: Option<String>,
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

async fn drive(session: &Session<'_>, robot: &SkidSteer) -> anyhow::Result<Run> {
    let round = Round {
        waypoints_m: CORNERS_M.to_vec(),
        limits: LIMITS,
        telemetry_ms: TELEMETRY_MS,
        clear_every_s: CLEAR_EVERY_S,
        timeout_s: TIMEOUT_S,
    };
    let mut run = Run { samples: Vec::new(), events: Vec::new(), corners: 0, trips: 0, map: scene(session)? };
    let corners = round::drive(session, robot, &round, |observation| match observation {
        Observation::Measured(measured) => run.looked(session, measured),
        Observation::Event(time_s, event) => run.happened(session, time_s, event),
    });
    let corners = corners.await?;
    Ok(Run { corners, ..run })
}

impl Run {
    fn happened(&mut self, session: &Session<'_>, time_s: f64, event: round::Event) -> anyhow::Result<()> {
        let what = event.to_string();
        self.trips += usize::from(matches!(event, round::Event::Tripped(_)));
        let Pose { x_m, y_m, .. } = session.virtual_board()?.world().pose().context(NO_BODY)?;
        let place_m = [x_m, y_m];
        self.map.events_m.push((place_m, format!("{time_s:.1} s: {what}")));
        self.events.push(Event { time_s, place_m, what });
        Ok(())
    }

    fn looked(&mut self, session: &Session<'_>, known: Measured) -> anyhow::Result<()> {
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
            if self.samples.len().is_multiple_of(OUTLINE_EVERY) {
                let corners = outline.corners_m().iter().map(|corner| truth.to_world(*corner));
                self.map.outlines_m.push(corners.collect());
            }
        }
        if self.samples.len().is_multiple_of(PLACE_EVERY) {
            let places = [[truth.x_m, truth.y_m], [known.place.x_m, known.place.y_m]];
            self.map.ways_m.iter_mut().zip(places).for_each(|((_, way), place)| way.push(place));
        }
        // Mean lateral distance of the wheels from the centre line.
        let half_m = body.wheels().iter().map(|wheel| wheel.place_m[1].abs()).sum::<f64>() / body.wheels().len() as f64;
        let ground_m_s = [half_m, -half_m].map(|left_m| twist.at([0.0, left_m])[0]);
        self.samples.push(Sample { known, truth, ground_m_s, person_m });
        Ok(())
    }
}

/// Map of the world without the robot.
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
        ways_m: vec![("true path".into(), Vec::new()), ("path by odometry".into(), Vec::new())],
        ..Map::default()
    })
}

fn rows(run: &Run) -> Vec<Row> {
    let last = run.samples.last();
    let person_m = run.samples.iter().map(|sample| sample.person_m).fold(f64::INFINITY, f64::min);
    let error_m = last.map_or(f64::NAN, Sample::odometry_off_m);
    let error_deg = last.map_or(f64::NAN, |sample| (sample.known.place.yaw_rad - sample.truth.yaw_rad).to_degrees());
    let way = |pair: &[Sample]| (pair[1].truth.x_m - pair[0].truth.x_m).hypot(pair[1].truth.y_m - pair[0].truth.y_m);
    let way_m: f64 = run.samples.windows(2).map(way).sum();
    let stood_s: f64 = run
        .samples
        .windows(2)
        // A set point of 0: waiting for a person, or after a trip.
        .filter(|pair| pair[0].known.velocity == Velocity::default())
        .map(|pair| pair[1].known.time_s - pair[0].known.time_s)
        .sum();
    let corners = run.corners as f64;
    let all = CORNERS_M.len() as f64;
    vec![
        Row { what: "corners reached", value: corners, unit: "", limit: Some(format!("{all}")), met: corners == all },
        Row {
            what: "least distance to a person",
            value: person_m,
            unit: "m",
            limit: Some(format!("at least {PERSON_M}")),
            met: person_m >= PERSON_M,
        },
        Row {
            what: "odometry error at the end",
            value: error_m,
            unit: "m",
            limit: Some(format!("at most {ODOMETRY_M}")),
            met: error_m <= ODOMETRY_M,
        },
        Row { what: "heading error at the end", value: error_deg, unit: "deg", limit: None, met: true },
        Row { what: "path length", value: way_m, unit: "m", limit: None, met: true },
        Row {
            what: "time",
            value: last.map_or(f64::NAN, |sample| sample.known.time_s),
            unit: "s",
            limit: None,
            met: true,
        },
        Row { what: "time at standstill", value: stood_s, unit: "s", limit: None, met: true },
        Row { what: "trips", value: run.trips as f64, unit: "", limit: None, met: true },
    ]
}

fn print(report: &Report, elapsed: Elapsed) -> anyhow::Result<()> {
    output::line(format_args!("a room on {} (simulated)", report.board))?;
    let mut table = table::new(&["", "value", "limit", ""], 1..2);
    for Row { what, value, unit, limit, met } in &report.rows {
        table.add_row([
            (*what).to_owned(),
            format!("{value:.3} {unit}"),
            limit.clone().unwrap_or_default(),
            if limit.is_none() {
                ""
            } else if *met {
                "ok"
            } else {
                "not met"
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
        caption: "Result".into(),
        note: Some(
            "Simulated robot, room and people. The robot drives by its wheel encoders and two ultrasonic sensors; the true path is \
             known to the simulation only. After a trip the demo clears it and arms again, as a person would."
                .into(),
        ),
        columns: vec![
            column("", Align::Left),
            column("Value", Align::Right),
            column("Unit", Align::Left),
            column("Limit", Align::Left),
            column("Result", Align::Left),
        ],
        rows: rows
            .iter()
            .map(|row| {
                let result = match row.limit {
                    None => Cell::Text(String::new()),
                    Some(_) => Cell::Verdict { pass: row.met, text: if row.met { "met".into() } else { "not met".into() } },
                };
                vec![
                    Cell::Text(row.what.into()),
                    Cell::Number { value: row.value, decimals: 3 },
                    Cell::Text(row.unit.into()),
                    Cell::Text(row.limit.clone().unwrap_or_default()),
                    result,
                ]
            })
            .collect(),
    }
}

/// Plots over time: free distance, speed, slip and odometry error.
fn overlays(run: &Run, robot: &SkidSteer) -> Vec<Overlay> {
    let line = |name: &str, value: &dyn Fn(&Sample) -> f64| {
        let points = run.samples.iter().map(|sample| (sample.known.time_s, value(sample)));
        (name.to_owned(), points.filter(|(_, value)| value.is_finite()).collect::<Vec<_>>())
    };
    // Slip is the rim's speed minus the ground speed beside the wheels, over one telemetry period.
    let slip = |name: &str, side: usize| {
        let points = run.samples.windows(2).map(|pair| {
            let (from, to) = (&pair[0], &pair[1]);
            let rolled_m = (to.known.sides_rad[side] - from.known.sides_rad[side]) * robot.wheel_radius_m;
            let rim_m_s = rolled_m / (to.known.time_s - from.known.time_s);
            (to.known.time_s, rim_m_s - f64::midpoint(from.ground_m_s[side], to.ground_m_s[side]))
        });
        (name.to_owned(), points.collect())
    };
    vec![
        Overlay {
            title: "Free distance in front (m)".into(),
            since: "the start",
            lines: vec![
                line("stop distance", &|_| LIMITS.stop_m),
                line("by the range sensors, at most 2 m", &|sample| sample.known.free_m.min(2.0)),
                line("true distance to the nearest person, at most 2 m", &|sample| sample.person_m.min(2.0)),
            ],
        },
        Overlay {
            title: "Speed (m/s)".into(),
            since: "the start",
            lines: vec![
                line("set point", &|sample| sample.known.velocity.forward_m_s),
                line("true", &|sample| f64::midpoint(sample.ground_m_s[0], sample.ground_m_s[1])),
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
            lines: vec![line("limit at the end", &|_| ODOMETRY_M), line("error", &Sample::odometry_off_m)],
        },
    ]
}
