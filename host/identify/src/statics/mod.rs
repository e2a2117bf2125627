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

pub mod hysteresis;
pub mod map;
pub mod table;

/// Parts of one recording for models of which one recording is enough: what to fit to, and what to hold out. Of a map every
/// `every`th row is held out, of a held shaft all after the first two pulls of each side. `None` for other models, and where the
/// recording does not have these parts.
#[must_use]
pub fn hold_out(model: &str, run: &Run, every: usize) -> Option<(Run, Run)> {
    match model {
        map::StaticMap::NAME => map::alternate_rows(run, every),
        hysteresis::HeldShaft::NAME => hysteresis::first_two_cycles(run).ok(),
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
