//! Figure and maps of a trial.

use r4_maps::grid::Grid;

use super::{
    CELL_M, Hall, LAWN, OURS, PRINTED, SHARE, Surveyed, errors, lawn_mower, perfectly, scene::Case, settings,
    survey::replayed, surveyed,
};
use crate::{Curve, Error, Figure, Panel, Trial, View};

/// Side of a view, m, and number of cells along it.
const SIDE_M: f64 = 60.0;
const COLUMNS: usize = 120;
/// Number of the path's points for each one that is drawn.
const EVERY: usize = 50;

struct Trials {
    hall: Hall,
    lawn: Surveyed,
    ours: Surveyed,
    truth: Grid<Option<f64>>,
}

impl Trials {
    fn of(trial: &Trial) -> Result<Self, Error> {
        let hall = Hall::of(Case::of(trial.seed), CELL_M)?;
        let lawn = lawn_mower(&hall)?;
        // The figure shows our arm, whichever was requested.
        let trial = Trial { arm: OURS, ..trial.clone() };
        let (ours, _) = surveyed(&trial, &hall, SHARE * lawn.until_s)?;
        let truth = hall.truth_ppm(lawn.until_s);
        Ok(Self { hall, lawn, ours, truth })
    }
}

/// Draws the error of the map over time by the lawn-mower, the paper's goals, and ours on the trial's board; and the
/// error of its pose.
pub(super) fn curves(trial: &Trial) -> Result<Figure, Error> {
    let Trials { hall, lawn, ours, truth } = Trials::of(trial)?;
    let printed = perfectly(&hall, settings(PRINTED, lawn.until_s))?;
    let of = |name: &'static str, arm: &str, surveyed: &Surveyed| {
        let points = errors(&hall, settings(arm, 0.0).weights, surveyed.survey.readings(), surveyed.until_s, &truth);
        Curve { name, points: points.unwrap_or_default() }
    };
    let driven = ours.driven.as_ref();
    let off = |name, off_m: &dyn Fn(usize) -> f64| {
        let path = driven.map_or(&[][..], |driven| &driven.path);
        Curve {
            name,
            points: path
                .iter()
                .enumerate()
                .step_by(EVERY)
                .map(|(index, (time_s, ..))| (*time_s, off_m(index)))
                .collect(),
        }
    };
    let by_plan = |index: usize| {
        driven.map_or(0.0, |driven| r4_maps::pose::distance_m(driven.path[index].1, driven.path[index].2))
    };
    let reckoned = |index: usize| driven.map_or(0.0, |driven| driven.dead_reckoned_off_m[index]);
    Ok(Figure {
        description: format!(
            "gas in a factory mapped by a rover, seed {}, on {}: the true mean over the mission with the rover's path, its map, error of the \
             map and of the pose over time",
            trial.seed, trial.board
        ),
        axis: "Time (s)",
        panels: vec![
            Panel {
                title: "RMS error of the map (ppm)",
                curves: vec![
                    of("lawn-mower", LAWN, &lawn),
                    of("paper's goals", PRINTED, &printed),
                    of("ours", OURS, &ours),
                ],
            },
            Panel {
                title: "Error of the pose (m)",
                curves: vec![off("wheels and gyroscope", &reckoned), off("with two beams on the plan", &by_plan)],
            },
        ],
    })
}

/// Draws the true mean with the path of the board's rover, and the map of its readings.
pub(super) fn views(trial: &Trial) -> Result<Vec<View>, Error> {
    let Trials { hall, ours, truth, lawn } = Trials::of(trial)?;
    let unsuitable = |why: String| super::unsuitable(trial, why);
    let map = |of: &Surveyed| {
        let maps = replayed(&hall.plan, settings(OURS, 0.0).weights, of.survey.readings(), of.until_s, of.until_s);
        Ok::<_, Error>(maps.map_err(unsuitable)?.pop().map_or_else(|| truth.clone(), |(_, map)| map))
    };
    let view = |title: String, map: &Grid<Option<f64>>, path: Option<(&'static str, &Surveyed)>| {
        let cell_m = SIDE_M / COLUMNS as f64;
        let value = |index: usize| {
            let centre = [index % COLUMNS, index / COLUMNS].map(|cell| (cell as f64 + 0.5) * cell_m);
            // Shelves and the outside of the hall are drawn like air without gas.
            map.at(centre).ok().copied().flatten().unwrap_or(0.0).max(0.0)
        };
        let curve = |(name, of): (&'static str, &Surveyed)| Curve {
            name,
            points: of.path.iter().step_by(EVERY).map(|(_, [x_m, y_m])| (*x_m, *y_m)).collect(),
        };
        View {
            title,
            unit: "ppm",
            side_m: SIDE_M,
            columns: COLUMNS,
            values: (0..COLUMNS * COLUMNS).map(value).collect(),
            paths: path.map(curve).into_iter().collect(),
            marks_m: vec![hall.case.source_m],
            marks_name: "leak",
        }
    };
    let minutes = |of: &Surveyed| of.until_s / 60.0;
    Ok(vec![
        view("True mean, the leak, and the rover's path".into(), &truth, Some(("ours", &ours))),
        view(format!("Ours after {:.0} minutes", minutes(&ours)), &map(&ours)?, None),
        view(format!("Lawn-mower after {:.0} minutes", minutes(&lawn)), &map(&lawn)?, None),
        view("True mean, and the lawn-mower's path".into(), &truth, Some(("lawn-mower", &lawn))),
    ])
}
