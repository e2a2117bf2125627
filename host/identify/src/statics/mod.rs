//! What does not move in time: maps from a level to a steady output, laws against printed rows, and the play of a shaft
//! that is pulled from both sides.
//!
//! | module | model |
//! | --- | --- |
//! | [`map`] | `static-map` |
//! | [`table`] | `table` |
//! | [`hysteresis`] | `held-shaft` |

use std::fmt::Write;

use crate::data::Run;
use crate::family::{Family, Structure, Term};

pub mod bench;
pub mod hysteresis;
pub mod map;
pub mod table;

/// Parts of one recording for models of which one recording is enough: what to fit to, and what to hold out. Of a map every
/// `every`th row is held out, of a held shaft every `every`th pull of each side. `None` for other models, and where the
/// recording does not have these parts.
#[must_use]
pub fn hold_out(model: &str, run: &Run, every: usize) -> Option<(Run, Run)> {
    match model {
        map::StaticMap::NAME => map::alternate_rows(run, every),
        hysteresis::HeldShaft::NAME => hysteresis::alternate_cycles(run, every),
        _ => None,
    }
}

/// A model that no plant of the simulator is, as a file.
fn to_toml<F: Family>(model: &str, family: &F, structure: &Structure, source: &str) -> String {
    let mut text = String::new();
    let quoted = |text: &str| format!("\"{}\"", text.replace('\\', "\\\\").replace('"', "\\\""));
    let numbers = |values: &[f64]| values.iter().map(f64::to_string).collect::<Vec<_>>().join(", ");
    // Writing to a String cannot fail.
    let _ = writeln!(text, "model = {}\nsource = {}\nunit = {}", quoted(model), quoted(source), quoted(family.unit()));
    let _ = writeln!(text, "\n[parameters]");
    for (parameter, value) in family.base().iter().zip(&structure.base) {
        let _ = writeln!(text, "{} = {value:?} # {}", parameter.name, parameter.unit);
    }
    for (term, values) in structure.terms.iter().zip(&structure.added) {
        match term {
            Term::Known(index) => {
                let candidate = &family.catalogue()[*index];
                let _ = writeln!(text, "\n[[effect]]\nname = {}", quoted(candidate.name));
                for (parameter, value) in candidate.parameters.iter().zip(values) {
                    let _ = writeln!(text, "{} = {value:?} # {}", parameter.name, parameter.unit);
                }
            }
            Term::Curve(curve) => {
                let _ = writeln!(text, "\n[[effect]]\nname = \"unknown\"\nover = {}", quoted(curve.over.name()));
                let _ = writeln!(text, "at = [{}] # {}", numbers(&curve.at), curve.at_unit);
                let _ = writeln!(text, "values = [{}] # {}", numbers(values), curve.unit);
            }
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use std::{collections::BTreeMap, path::Path};

    use super::*;
    use crate::data::{Mapping, Options, read};
    use crate::task::{Task, identify};

    /// One recording of `data/`, through the task.
    fn reported(model: &str, file: &str, roles: Vec<Mapping>) -> crate::task::Identified {
        let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../data").join(file);
        let options = Options { roles, counts_per_turn: Some(4096.0), ..Options::default() };
        let recorded = read(&[file], &options).unwrap();
        let (train, holdout) = hold_out(model, &recorded.runs[0], 2).unwrap();
        let task = Task { model: model.to_owned(), parameters: BTreeMap::new(), plant: None, seed: 1 };
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
        assert!(map.plant_toml.contains("[[effect]]\nname = \"dead-zone\"\nforward = 0."), "{}", map.plant_toml);

        let roles = vec![
            Mapping::measured("output", "dut_pos_cnt"),
            Mapping::driving("goal", "dut_target_cnt"),
            Mapping::driving("pull_a", "pullA_target_cnt"),
            Mapping::driving("pull_b", "pullB_target_cnt"),
        ];
        let shaft = reported("held-shaft", "sts_servo_backlash/sts3215_single.csv", roles);
        let backlash = shaft.report.effects.iter().find(|effect| effect.name == "backlash").unwrap();
        // 0.62 degrees are published without load.
        assert!((backlash.parameters["gap"].value.to_degrees() - 0.62).abs() < 0.1, "{backlash:?}");
        assert!(shaft.report.last.holdout.rmse < 0.6 * shaft.report.baseline.holdout.rmse, "{}", shaft.report.verdict);
    }

    #[test]
    fn other_models_are_not_cut() {
        let run = Run { name: String::new(), time_s: vec![], signals: BTreeMap::new() };
        assert!(hold_out("dc-motor", &run, 2).is_none());
        assert!(hold_out("static-map", &run, 2).is_none());
        assert!(hold_out("held-shaft", &run, 2).is_none());
    }
}
