//! Models without motion in time: maps from a level to a steady output, laws of printed tables, and the play of a
//! shaft that is pulled from both sides.
//!
//! | module | model |
//! | --- | --- |
//! | [`map`] | `static-map` |
//! | [`table`] | `table` |
//! | [`hysteresis`] | `held-shaft` |

use r4_plants::Dependence;

use crate::data::Run;
use crate::family::{Family, Structure, Term};

pub mod hysteresis;
pub mod map;
mod plant;
pub mod table;

/// Divides one recording into a part to fit to and a held-out part, for models of which one recording is enough. Of a
/// map every `every`th row is held out, of a held shaft every `every`th pull of each side. `None` for other models,
/// and if the recording does not have these parts.
#[must_use]
pub fn hold_out(model: &str, run: &Run, every: usize) -> Option<(Run, Run)> {
    match model {
        map::StaticMap::NAME => map::alternate_rows(run, every),
        hysteresis::HeldShaft::NAME => hysteresis::alternate_cycles(run, every),
        _ => None,
    }
}

/// Returns the terms of a structure that depend on the level alone, and the names of the other terms, which a map
/// over the level cannot hold.
fn of_the_level<F: Family>(family: &F, structure: &Structure) -> (Structure, Vec<String>) {
    use Dependence::{Direction, Input, Speed};
    let mut kept = Structure { terms: vec![], base: structure.base.clone(), added: vec![] };
    let mut others = Vec::new();
    for (term, values) in structure.terms.iter().zip(&structure.added) {
        let (is_kept, name) = match term {
            Term::Known(index) => {
                let candidate = &family.catalogue()[*index];
                // The map is evaluated from rest, so it includes static friction.
                let of_level = |over: &Dependence| matches!(over, Input | Direction | Speed);
                let starts = candidate.name == "static-friction";
                (starts || candidate.depends_on.iter().all(of_level), candidate.name.to_owned())
            }
            Term::Curve(curve) => (curve.over == Input, format!("a curve over {}", curve.over.name())),
        };
        if is_kept {
            kept.terms.push(term.clone());
            kept.added.push(values.clone());
        } else {
            others.push(name);
        }
    }
    (kept, others)
}

#[cfg(test)]
mod tests {
    use std::{collections::BTreeMap, path::Path};

    use r4_plants::{Effect, PlantSpec};

    use super::*;
    use crate::data::{Mapping, Options, read};
    use crate::task::{Task, identify};

    /// Runs the task on one recording of `data/`.
    fn reported(model: &str, file: &str, roles: Vec<Mapping>) -> crate::task::Identified {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data").join(file);
        let options = Options { roles, counts_per_turn: Some(4096.0), ..Options::default() };
        let recorded = read(&[file], &options).unwrap();
        let (train, holdout) = hold_out(model, &recorded.runs[0], 2).unwrap();
        let task = Task { model: model.to_owned(), seed: 1, ..Task::default() };
        identify(&task, &[train], &[holdout], vec![], &|_| ()).unwrap()
    }

    #[test]
    fn one_recording_is_enough_for_what_does_not_move_in_time() {
        let roles = vec![
            Mapping::driving("input", "command_duty256"),
            Mapping::measured("output", "right_rpm"),
            Mapping::driving("supply", "battery_mV"),
        ];
        let map = reported("static-map", "micromouse_drv8833/static_3.csv", roles);
        assert_eq!(map.report.unit, "rad/s");
        assert!(map.report.last.holdout.rmse < 0.1 * map.report.baseline.holdout.rmse, "{}", map.report.verdict);
        let plant = PlantSpec::from_toml("plant.toml", map.loadable.plant().unwrap()).unwrap();
        let [table] = plant.tables() else { panic!("{plant:?}") };
        // The plant's table cancels a duty within the identified dead zone.
        let dead = map.report.effects.iter().find(|effect| effect.name == "dead-zone").unwrap();
        let level = 0.5 * dead.parameters["forward"].value;
        assert!((level + table.value(level)).abs() < 1e-3, "{} of {level}", table.value(level));

        let roles = vec![
            Mapping::measured("output", "dut_pos_cnt"),
            Mapping::driving("goal", "dut_target_cnt"),
            Mapping::driving("pull_a", "pullA_target_cnt"),
            Mapping::driving("pull_b", "pullB_target_cnt"),
        ];
        let shaft = reported("held-shaft", "sts_servo_backlash/sts3215_single.csv", roles);
        let backlash = shaft.report.effects.iter().find(|effect| effect.name == "backlash").unwrap();
        let plant = PlantSpec::from_toml("plant.toml", shaft.loadable.plant().unwrap()).unwrap();
        assert!(matches!(plant.effects(), [Effect::Backlash(found)] if found.gap == backlash.parameters["gap"].value));
        // The published gap without load is 0.62 degrees.
        assert!((backlash.parameters["gap"].value.to_degrees() - 0.62).abs() < 0.1, "{backlash:?}");
        assert!(shaft.report.last.holdout.rmse < 0.6 * shaft.report.baseline.holdout.rmse, "{}", shaft.report.verdict);
    }

    #[test]
    fn other_models_are_not_cut() {
        let run = Run { name: String::new(), time_s: vec![], origin_s: None, signals: BTreeMap::new() };
        assert!(hold_out("dc-motor", &run, 2).is_none());
        assert!(hold_out("static-map", &run, 2).is_none());
        assert!(hold_out("held-shaft", &run, 2).is_none());
    }
}
