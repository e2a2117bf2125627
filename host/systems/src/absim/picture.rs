//! Figure and maps of a trial.

use super::{
    BOARDS, FASTER, OURS, PRINTED, abstracted, boards,
    mission::Mission,
    scene::Scene,
    wall::{Charging, Wall},
};
use crate::{Curve, Error, Figure, Panel, Trial, View};

/// Names of the robots in legends.
const ROBOTS: [&str; 4] = ["robot 1", "robot 2", "robot 3", "robot 4"];

/// Draws the error of the map over time: the paper's runs at both factors, ours, and boards.
pub(super) fn figure(trial: &Trial) -> Result<Figure, Error> {
    let mut curves = Vec::new();
    for (name, arm) in
        [("paper at 15", FASTER), ("paper at 10, slowed to 1", PRINTED), ("boards", BOARDS), ("ours", OURS)]
    {
        let mission = if arm == BOARDS { on_boards(trial)?.0 } else { abstracted(trial, arm)?.0.mission };
        curves.push(Curve { name, points: errors(&mission) });
    }
    Ok(Figure {
        description: format!(
            "soil compaction mapped by three robots, seed {}, boards on {}: the true soil with their paths, the map, its error over \
             simulated time",
            trial.seed, trial.board
        ),
        axis: "Simulated time (s)",
        panels: vec![Panel { title: "RMS error of the map (kPa)", curves }],
    })
}

/// Draws the true soil with the boards' paths, and the map of their samples.
pub(super) fn views(trial: &Trial) -> Result<Vec<View>, Error> {
    let (mission, driven) = on_boards(trial)?;
    let Scene { side_m, cells, .. } = *mission.scene();
    let path = |(name, driven): (&&'static str, &boards::Driven)| Curve {
        name,
        points: driven.path.iter().step_by(10).map(|(_, [x_m, y_m])| (*x_m, *y_m)).collect(),
    };
    let view = |title: String, values: &[f64]| View {
        title,
        unit: "kPa",
        side_m,
        columns: cells,
        values: values.to_vec(),
        paths: Vec::new(),
        marks_m: Vec::new(),
        marks_name: "sample",
    };
    let samples = mission.taken();
    let title = format!("Map after {} samples, RMS error {:.0} kPa", samples.len(), mission.rmse_kpa());
    let truth = view("True soil compaction, and the paths of three boards".into(), mission.truth_kpa());
    let paths = ROBOTS.iter().zip(&driven).map(path).collect();
    let marks_m = samples.iter().map(|sample| sample.place_m).collect();
    Ok(vec![View { paths, ..truth }, View { marks_m, ..view(title, mission.map().mean_kpa()) }])
}

fn on_boards(trial: &Trial) -> Result<(Mission, Vec<boards::Driven>), Error> {
    let scene = Scene::of(trial.seed);
    let wall = Wall::new(trial.seed, 1.0, Charging::Declared);
    let (run, driven) = boards::run(trial, Mission::new(scene), wall, None)?;
    Ok((run.mission, driven))
}

/// Error of the map over time as steps: it changes with each sample.
fn errors(mission: &Mission) -> Vec<(f64, f64)> {
    let mut points = vec![(0.0, mission.first_rmse_kpa())];
    for sample in mission.taken() {
        let at_s = sample.at_us as f64 * 1e-6;
        points.push((at_s, points[points.len() - 1].1));
        points.push((at_s, sample.rmse_kpa));
    }
    points
}
