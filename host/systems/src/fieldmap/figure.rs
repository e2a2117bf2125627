//! Figure and maps of a trial.

use r4_maps::{grid::Grid, pose::distance_m};

use super::{
    OURS, SWARM_PERFECT,
    map::{self, Map},
    mill::Calibration,
    run::{self, Surveyed},
    scene::{OPEN, PLOT, Scene},
    swarm, unsuitable,
};
use crate::{Curve, Error, Figure, Panel, Trial, View};

/// Number of the path's points for each one that is drawn.
const EVERY: usize = 50;

struct Trials {
    scene: Scene,
    calibration: Calibration,
    ours: Surveyed,
    map: Map,
    until_s: f64,
}

impl Trials {
    fn of(trial: &Trial) -> Result<Self, Error> {
        // The figure shows our arm, whichever was requested.
        let trial = Trial { arm: OURS, ..trial.clone() };
        let scene = Scene::of(trial.seed, PLOT)?;
        let calibration = run::calibrated(&trial, scene.mill)?;
        let ours = run::surveyed(&trial, &scene, calibration, Vec::new())?;
        let until_s = ours.path.last().map_or(0.0, |(time_s, _)| *time_s);
        let map = mapped(&scene, &ours, &calibration, until_s, true)?;
        Ok(Self { scene, calibration, ours, map, until_s })
    }
}

fn mapped(
    scene: &Scene,
    ours: &Surveyed,
    calibration: &Calibration,
    until_s: f64,
    has_time: bool,
) -> Result<Map, Error> {
    map::by_process(scene.plot.frame()?, &run::readings(&ours.taken, calibration), until_s, has_time)
        .map_err(|error| unsuitable("the readings", error.to_string()))
}

/// Draws the drift, true and by the map, and the error of the pose.
pub(super) fn curves(trial: &Trial) -> Result<Figure, Error> {
    let Trials { scene, ours, map, .. } = Trials::of(trial)?;
    let times_s: Vec<f64> = map.time_part.iter().map(|(time_s, _)| *time_s).collect();
    let truth = times_s.iter().copied().zip(scene.drift(&times_s)?).collect();
    let mean = map.time_part.iter().map(|(_, value)| value).sum::<f64>() / map.time_part.len().max(1) as f64;
    let estimated = map.time_part.iter().map(|(time_s, value)| (*time_s, value - mean)).collect();
    let path = ours.driven.as_ref().map_or(&[][..], |driven| &driven.path);
    let off_m = path.iter().step_by(EVERY).map(|(time_s, at, truth)| (*time_s, distance_m(*at, *truth)));
    Ok(Figure {
        description: format!(
            "an electric field mapped by a rover, seed {}, on {}: the true mean over the mission with the rover's path, its map by place and \
             time, the map of cell means and that without time, the open field with the places of six robots' readings; drift and error of \
             the pose over time",
            trial.seed, trial.board
        ),
        axis: "Time (s)",
        panels: vec![
            Panel {
                title: "Drift over the plot (V/m)",
                curves: vec![
                    Curve { name: "true", points: truth },
                    Curve { name: "by the map of place and time", points: estimated },
                ],
            },
            Panel {
                title: "Error of the pose (m)",
                curves: vec![Curve { name: "wheels, gyroscope, GNSS", points: off_m.collect() }],
            },
        ],
    })
}

/// Draws the true mean with the path, the maps of the same readings, and the open field with the swarm's map.
pub(super) fn views(trial: &Trial) -> Result<Vec<View>, Error> {
    let Trials { scene, calibration, ours, map, until_s } = Trials::of(trial)?;
    let truth = scene.truth(until_s)?;
    let readings = run::readings(&ours.taken, &calibration);
    let cells = map::per_cell(scene.plot.frame()?, &readings, run::SQUARE_M);
    let without_time = mapped(&scene, &ours, &calibration, until_s, false)?;
    let path = ours.path.iter().step_by(EVERY).map(|(_, [x_m, y_m])| (*x_m, *y_m)).collect();
    let titled = |name: &str, map: &Grid<f64>| format!("{name}, error {:.1} V/m", map::rmse(map, &truth));
    let mut views = vec![
        view("True mean, and the rover's path".into(), &truth),
        view(titled("By place and time", &map.mean), &map.mean),
        view(titled("Means of cells", &cells), &cells),
        view(titled("Without time", &without_time.mean), &without_time.mean),
    ];
    views[0].paths = vec![Curve { name: "ours", points: path }];
    views.extend(open(trial)?);
    Ok(views)
}

/// Draws the open field, and its map by six robots.
fn open(trial: &Trial) -> Result<Vec<View>, Error> {
    let trial = Trial { arm: SWARM_PERFECT, ..trial.clone() };
    let scene = Scene::of(trial.seed, OPEN)?;
    let calibration = run::calibrated(&trial, scene.mill)?;
    let six = run::swarmed(&trial, &scene, calibration, 6)?;
    let reached_s = six.reached_s.unwrap_or(swarm::LATEST_S);
    let truth = scene.truth(reached_s)?;
    let map = swarm::map(scene.plot.frame()?, &six.samples, reached_s)
        .map_err(|error| unsuitable("the readings", error.to_string()))?;
    let mut views = vec![
        view("1 km2: true mean, and readings of six robots".into(), &truth),
        view(
            format!("Six robots after {:.0} minutes, error {:.1} V/m", reached_s / 60.0, map::rmse(&map, &truth)),
            &map,
        ),
    ];
    views[0].marks_m = six.samples.iter().map(|sample| sample.at).collect();
    views[0].marks_name = "reading";
    Ok(views)
}

fn view(title: String, map: &Grid<f64>) -> View {
    let frame = map.frame();
    View {
        title,
        unit: "V/m",
        side_m: frame.cell_m() * frame.columns() as f64,
        columns: frame.columns(),
        values: map.values().to_vec(),
        paths: Vec::new(),
        marks_m: Vec::new(),
        marks_name: "",
    }
}
