//! Figure of a trial: every motor's set points by the paper's controller and by ours.

use super::{HOLD_S, OURS, PAPER, bench::Bench, driven, response::Purpose, scene};
use crate::{Curve, Error, Figure, Panel, Trial};

/// Part of the hold that is drawn, s.
const HOLD_DRAWN_S: f64 = 2.0;

/// Draws true positions and requested positions over time.
pub(super) fn of(trial: &Trial) -> Result<Figure, Error> {
    let scene = scene(trial)?;
    let mut panels = Vec::new();
    for (index, motor) in scene.motors.iter().enumerate() {
        let bench = motor.bench;
        let of = |arm| driven(&scene, index, &Trial { arm, ..trial.clone() }, HOLD_DRAWN_S.min(HOLD_S));
        let (paper, ours) = (of(PAPER)?, of(OURS)?);
        panels.push(Panel {
            title: title(&bench),
            curves: vec![
                Curve { name: "asked for, ours", points: asked(&bench, &ours) },
                Curve { name: "plain PID", points: positions(&bench, &paper) },
                Curve { name: "ours", points: positions(&bench, &ours) },
            ],
        });
    }
    let hidden: Vec<&str> =
        scene.motors.iter().map(|motor| motor.truth.as_ref().map_or("nothing", |truth| truth.name)).collect();
    Ok(Figure {
        description: format!(
            "set points of the OSMC evaluation, seed {}, on {}; hidden in the small motor, the geared one and the actuator: {}",
            trial.seed,
            trial.board,
            hidden.join(", ")
        ),
        axis: "Time (s)",
        panels,
    })
}

const fn title(bench: &Bench) -> &'static str {
    match bench.name.as_bytes() {
        b"small" => "Small motor (deg)",
        b"geared" => "Geared motor (deg)",
        _ => "Actuator (mm)",
    }
}

/// True positions, deg or mm, over the time since the first set point, s.
pub(super) fn positions(bench: &Bench, driven: &super::Driven) -> Vec<(f64, f64)> {
    let begin_s = begin_s(driven);
    let looks = driven.response.looks.iter().filter(|look| look.at_s >= begin_s);
    looks.map(|look| (look.at_s - begin_s, look.truth * bench.per_si())).collect()
}

/// Requested true positions, deg or mm, over the same time.
fn asked(bench: &Bench, driven: &super::Driven) -> Vec<(f64, f64)> {
    let begin_s = begin_s(driven);
    let segments = driven.response.segments.iter().filter(|segment| segment.purpose != Purpose::Hold);
    let ends = segments.flat_map(|segment| {
        let set = driven.calibration.asked(bench, segment.set) * bench.per_si();
        [(segment.from_s - begin_s, set), (segment.until_s - begin_s, set)]
    });
    ends.collect()
}

fn begin_s(driven: &super::Driven) -> f64 {
    driven.response.segments.first().map_or(0.0, |segment| segment.from_s)
}
