//! Figure of a trial.

use super::{Recorded, bristle, estimate};
use crate::{Curve, Error, Figure, Panel, Trial};

/// Draws the first straight run: speeds, and its slip as tracked, as predicted by ours, and with the paper's estimate.
pub(super) fn of(trial: &Trial) -> Result<Figure, Error> {
    let Recorded { recording, .. } = Recorded::of(&Trial { arm: "ours", ..trial.clone() })?;
    let run = bristle::FirstRun::of(&recording).ok_or_else(|| super::without_estimate(trial))?;
    let speeds = run.speeds();
    let in_mm = |(time_s, slip_m): &(f64, f64)| (*time_s, slip_m * 1e3);
    let printed = estimate::printed(&recording).map(|found| found.value);
    Ok(Figure {
        description: format!("the first straight run, seed {}, on {}: speeds and slip", trial.seed, trial.board),
        axis: "Time (s)",
        panels: vec![
            Panel {
                title: "Speed (m/s)",
                curves: vec![
                    Curve::new("wheels' rims", &speeds, |(time_s, rim_m_s, _)| (*time_s, *rim_m_s)),
                    Curve::new("robot, predicted", &speeds, |(time_s, _, robot_m_s)| (*time_s, *robot_m_s)),
                ],
            },
            Panel {
                title: "Slip: travel of the wheels minus that of the robot (mm)",
                curves: vec![
                    Curve::new("tracked", &run.tracked_slip_m(), in_mm),
                    Curve::new("ours", &run.slip_m(None), in_mm),
                    Curve::new("with c_long as printed", &run.slip_m(printed), in_mm),
                ],
            },
        ],
    })
}
