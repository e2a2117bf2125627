//! Tests that every model writes a file that a simulated board loads, and that mistakes in recordings are reported.

use r4_plants::{DcGearMotor, Drive, LinearActuator, Model as PlantModel, Plant};
use r4_world::{Body as _, MAX_STEP_S, Scene, ShaftMotion};

use super::*;
use crate::data::{Quantity, Signal};

const PERIOD_S: f64 = 0.02;
const SAMPLES: usize = 150;

/// Columns of a recording: role, quantity and values.
type Columns = Vec<(&'static str, Quantity, Vec<f64>)>;

fn run(columns: Columns) -> Run {
    let samples = columns[0].2.len();
    Run {
        name: "recorded".into(),
        time_s: (0..samples).map(|at| at as f64 * PERIOD_S).collect(),
        origin_s: None,
        signals: columns
            .into_iter()
            .map(|(role, quantity, values)| (role.to_owned(), Signal { column: role.into(), quantity, values }))
            .collect(),
    }
}

/// Steps of several sizes in both directions; `seed` shifts their order.
fn steps(seed: usize) -> Vec<f64> {
    const SIZES: [f64; 8] = [0.0, 0.6, -0.3, 0.9, -0.8, 0.4, -0.6, 0.2];
    (0..SAMPLES).map(|at| SIZES[(at / 25 + seed) % SIZES.len()]).collect()
}

/// Returns a small error without a pattern, so that no fit is exact.
fn noise(at: usize) -> f64 {
    1e-4 * ((at * at) as f64 * 0.7).sin()
}

/// Returns the position of a simulated plant under these duties.
fn driven(model: PlantModel, duties: &[f64], start: f64) -> Vec<f64> {
    let mut plant = Plant::new(&PlantSpec::new(model, "a test", vec![]).unwrap(), 1);
    plant.set_position(start);
    let step = |(at, duty): (usize, &f64)| {
        let now = plant.position() + noise(at);
        plant.advance(Drive::with_brake(*duty), 12.0, PERIOD_S);
        now
    };
    duties.iter().enumerate().map(step).collect()
}

/// Returns the positions and yaw angles of a robot that turns at three quarters of the rate of its wheels.
fn driven_about(sides: &[(f64, f64)]) -> [Vec<f64>; 3] {
    let (mut x, mut y, mut yaw) = (0.0, 0.0, 0.0);
    let mut all = [const { Vec::new() }; 3];
    for (at, (left, right)) in sides.iter().enumerate() {
        for (series, value) in all.iter_mut().zip([x, y, yaw]) {
            series.push(value + noise(at));
        }
        yaw += 0.75 * 0.1 * (right - left) / 0.5 * PERIOD_S;
        x += 0.05 * (left + right) * f64::cos(yaw) * PERIOD_S;
        y += 0.05 * (left + right) * f64::sin(yaw) * PERIOD_S;
    }
    all
}

/// Returns a recording that suits the model.
fn recorded(model: &str, seed: usize) -> Run {
    let duties = steps(seed);
    run(match model {
        "dc-motor" => {
            let angle = driven(PlantModel::DcGearMotor(DcGearMotor::TYPICAL), &duties, 0.0);
            vec![("input", Quantity::Number, duties), ("output", Quantity::Angle, angle)]
        }
        "linear-actuator" => {
            let place = driven(PlantModel::LinearActuator(LinearActuator::TYPICAL), &duties, 0.05);
            vec![("input", Quantity::Number, duties), ("output", Quantity::Length, place)]
        }
        "axis" => {
            let (mut speed, mut place) = (0.0, 0.0);
            let step = |(at, force): (usize, &f64)| {
                let now = place + noise(at);
                speed += (force * 3.0 - 2.0 * speed) * PERIOD_S;
                place += speed * PERIOD_S;
                now
            };
            let places = duties.iter().enumerate().map(step).collect();
            vec![("input", Quantity::Force, duties), ("output", Quantity::Length, places)]
        }
        "servo" => {
            let mut angle = 0.0;
            let step = |(at, goal): (usize, &f64)| {
                let now = angle + noise(at);
                angle += 4.0 * (goal - angle) * PERIOD_S;
                now
            };
            let angles = duties.iter().enumerate().map(step).collect();
            vec![("input", Quantity::Angle, duties), ("output", Quantity::Angle, angles)]
        }
        "skid-steer" | "skid-steer-forward" | "skid-steer-lateral" => {
            let others = steps(seed + 3);
            let sides: Vec<_> = duties.iter().zip(&others).map(|(left, right)| (5.0 * left, 5.0 * right)).collect();
            let [x, y, yaw] = driven_about(&sides);
            let (left, right) = sides.into_iter().unzip();
            vec![
                ("left", Quantity::AngularSpeed, left),
                ("right", Quantity::AngularSpeed, right),
                ("x", Quantity::Length, x),
                ("y", Quantity::Length, y),
                ("yaw", Quantity::Angle, yaw),
            ]
        }
        "static-map" => {
            let levels: Vec<f64> = (-20..=20).map(|level| 0.05 * f64::from(level)).collect();
            let speed = |(at, level): (usize, &f64)| (level.abs() - 0.1).max(0.0).copysign(*level) * 20.0 + noise(at);
            let speeds = levels.iter().enumerate().map(speed).collect();
            vec![("input", Quantity::Number, levels), ("output", Quantity::AngularSpeed, speeds)]
        }
        "held-shaft" => {
            let pulls = |side: usize| (0..240).map(|at| f64::from(u8::from(at / 10 % 4 == side))).collect::<Vec<_>>();
            let (a, b) = (pulls(0), pulls(2));
            let mut side = 0.0;
            let held = (0..240).map(|at: usize| {
                side = if a[at] > 0.5 {
                    1.0
                } else if b[at] > 0.5 {
                    -1.0
                } else {
                    side
                };
                0.01 * side + noise(at)
            });
            let held = held.collect();
            vec![("pull_a", Quantity::Number, a), ("pull_b", Quantity::Number, b), ("output", Quantity::Angle, held)]
        }
        "table" => {
            let levels = [1.0, 2.0, 4.0, 5.0, 8.0, 10.0].to_vec();
            let places = levels.iter().enumerate().map(|(at, level)| 24.0 / level + noise(at)).collect();
            vec![("input", Quantity::Number, levels), ("output", Quantity::Length, places)]
        }
        other => panic!("no recording of {other}: record what it is of here, and see what it writes"),
    })
}

#[test]
fn every_model_writes_what_a_simulated_board_loads() {
    for info in models() {
        let geometry = [("wheel_radius_m".to_owned(), 0.1), ("track_m".to_owned(), 0.5)];
        let parameters = if info.file == FileKind::Body { geometry.into() } else { BTreeMap::new() };
        let task = Task { model: info.name.to_owned(), parameters, seed: 1, ..Task::default() };
        let (train, holdout) = (recorded(info.name, 0), recorded(info.name, 1));
        let found = identify(&task, &[train], &[holdout], vec![], &|_| ());
        let found = found.unwrap_or_else(|error| panic!("{}: {error}", info.name));
        match (&found.loadable, info.file) {
            (Loadable::Plant(text), FileKind::Plant) => {
                let spec = PlantSpec::from_toml(info.name, text).unwrap_or_else(|error| panic!("{error}\n{text}"));
                let mut plant = Plant::new(&spec, 1);
                plant.advance(Drive::with_brake(0.5), 12.0, 0.1);
                assert!(plant.position().is_finite() && plant.speed().is_finite(), "{}: {plant:?}", info.name);
            }
            (Loadable::Body(fitted), FileKind::Body) => {
                let mut body = fitted.wheeled.clone();
                let shafts = vec![ShaftMotion { position: 0.0, speed: 3.0 }; body.shafts()];
                let mut loads = vec![0.0; body.shafts()];
                // After 1 s the slowly rolling wheels have taken the body along.
                for _ in 0..4000 {
                    body.step(&mut Scene::default(), 0.0, &shafts, &mut loads, MAX_STEP_S);
                }
                assert!((0.2..0.4).contains(&body.twist().forward_m_s), "{}: {:?}", info.name, body.twist());
            }
            (loadable, file) => panic!("{} says it writes {file:?}, and wrote {loadable:?}", info.name),
        }
    }
}

/// Recordings of a motor, each with one mistake.
#[test]
fn mistakes_in_recordings_are_told() {
    fn reversed(run: &mut Run) {
        run.signals.values_mut().for_each(|signal| signal.values.reverse());
    }
    fn exchanged(run: &mut Run) {
        let [input, output] = ["input", "output"].map(|role| run.signals.remove(role).unwrap());
        run.signals.insert("input".into(), output);
        run.signals.insert("output".into(), input);
    }
    let task = Task { model: "dc-motor".into(), ..Task::default() };
    let told = |spoil: fn(&mut Run)| {
        let [train, holdout] = [1, 3].map(|seed| {
            let mut run = recorded("dc-motor", seed);
            spoil(&mut run);
            run
        });
        identify(&task, &[train], &[holdout], Vec::new(), &|_| ()).unwrap().report
    };
    assert_ne!(told(|_| ()).explained, Explained::Not);
    for (spoil, says) in [(reversed as fn(&mut Run), "backwards"), (exchanged, "exchanged")] {
        let report = told(spoil);
        assert_eq!(report.explained, Explained::Not, "{}", report.verdict);
        assert!(report.suspicions[0].contains(says) && report.verdict.contains(says), "{says}: {}", report.verdict);
    }
}

/// A second sensor in the wrong unit changes no fit, and is reported.
#[test]
fn a_second_sensor_is_compared_and_not_fitted_to() {
    let task = Task { model: "dc-motor".into(), ..Task::default() };
    let found = |with_speed: bool| {
        let [train, holdout] = [1, 3].map(|seed| {
            let mut run = recorded("dc-motor", seed);
            if with_speed {
                let angle = run.values("output").unwrap();
                let slope =
                    |at: usize| (angle[(at + 1).min(SAMPLES - 1)] - angle[at.saturating_sub(1)]) / (2.0 * PERIOD_S);
                let degrees = (0..SAMPLES).map(|at| slope(at).to_degrees()).collect();
                let speed = Signal { column: "speed_rad_s".into(), quantity: Quantity::AngularSpeed, values: degrees };
                run.signals.insert("speed".into(), speed);
            }
            run
        });
        identify(&task, &[train], &[holdout], Vec::new(), &|_| ()).unwrap().report
    };
    let (alone, compared) = (found(false), found(true));
    assert!(alone.suspicions.is_empty() && alone.notes.is_empty(), "{:?}", alone.suspicions);
    assert_eq!(compared.parameters, alone.parameters);
    let told = "degrees for radians";
    assert!(compared.suspicions[0].contains(told) && compared.notes[0].contains(told), "{:?}", compared.notes);
    assert!(compared.verdict.contains("; check the recordings: `speed_rad_s` is 57."), "{}", compared.verdict);
}

/// Rows out of order are reported before any other finding.
#[test]
fn rows_out_of_order_are_told_first() {
    let task = Task { model: "dc-motor".into(), ..Task::default() };
    let [train, holdout] = [1, 3].map(|seed| {
        let mut run = recorded("dc-motor", seed);
        // 67 and 150 have no common divisor, so each row occurs once.
        let shuffle = |values: &[f64]| (0..SAMPLES).map(|at| values[at * 67 % SAMPLES]).collect();
        run.signals.values_mut().for_each(|signal| signal.values = shuffle(&signal.values));
        run
    });
    let report = identify(&task, &[train], &[holdout], Vec::new(), &|_| ()).unwrap().report;
    assert!(report.suspicions[0].contains("out of order"), "{:?}", report.suspicions);
    assert!(report.verdict.contains("; check the recordings: successive samples"), "{}", report.verdict);
}

#[test]
fn no_effect_is_looked_for_without_time() {
    let [train, holdout] = [1, 3].map(|seed| recorded("dc-motor", seed));
    let within = |budget: Option<Duration>| {
        let task = Task { model: "dc-motor".into(), budget, ..Task::default() };
        let found = identify(&task, std::slice::from_ref(&train), std::slice::from_ref(&holdout), Vec::new(), &|_| ());
        found.unwrap().report
    };
    let [none, plenty] = [Some(Duration::ZERO), Some(Duration::from_secs(1_000_000))].map(within);
    assert!(none.notes.iter().any(|note| note.contains("--budget")), "{:?}", none.notes);
    assert!(none.rejected.is_empty() && none.baseline == none.last, "{:?}", none.rejected);
    assert_eq!(plenty, within(None));
}

#[test]
fn initial_states_are_fitted_to_what_the_protocol_says() {
    let windows = |protocol: Protocol| [1_000, 100, 10].map(|samples| protocol.window(samples));
    assert_eq!(windows(Protocol::FirstTenth), [100, 20, 10]);
    assert_eq!(windows(Protocol::First20), [20, 20, 10]);
}
