//! Faults of recordings that show before a fit, and common mistakes: each is corrected and the base model fitted
//! again.

use std::f64::consts::PI;

use crate::{
    data::{
        Quantity, Run,
        fault::{Fault, faults},
        redundant::{Relation, compare},
    },
    family::Family,
    motion::Kind,
    skid::Output,
    task::{Task, Work, base_nrmse, models, with_family},
};

/// Largest ratio of the base model's NRMSE with a mistake corrected to that of the model found before, at which the
/// mistake is reported. Our choice; other values have not been compared.
const LESS: f64 = 0.5;

/// Role of a second sensor of an axis, which is not fitted to.
const SPEED: &str = "speed";
/// Pairs of roles that measure one quantity, or a quantity and its rate.
const REDUNDANT: [(&str, &str); 2] = [("output", SPEED), ("yaw", "gyro")];

/// Result of the checks of recordings that need no model.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Checked {
    /// Faults, worst first; each says what to do next.
    pub(crate) suspicions: Vec<String>,
    /// Comparisons of sensors that measure one quantity.
    pub(crate) notes: Vec<String>,
}

/// Looks for faults in the columns of recordings, and compares sensors of one quantity. Applies only to models of
/// motion over time: rows of a map or a table need no order.
pub(crate) fn check_recordings(model: &str, train: &[Run], holdout: &[Run]) -> Checked {
    let mut checked = Checked::default();
    // Static models have no order of samples that could be wrong.
    let is_motion = Kind::ALL.iter().any(|kind| kind.name() == model);
    if !is_motion && !Output::ALL.iter().any(|output| output.model() == model) {
        return checked;
    }
    let roles = models().into_iter().find(|known| known.name == model).map(|known| known.roles).unwrap_or_default();
    let named = |is_wanted: fn(bool, bool) -> bool| -> Vec<&str> {
        roles.iter().filter(|role| is_wanted(role.driving, role.required)).map(|role| role.name).collect()
    };
    let (inputs, outputs) = (named(|driving, required| driving && required), named(|driving, _| !driving));
    let all: Vec<&Run> = train.iter().chain(holdout).collect();
    let mut found = faults(&all, &inputs, &outputs);
    if found.is_empty() {
        // A fault of one part only may not stand out among all recordings.
        let parts = [train, holdout].map(|runs| faults(&runs.iter().collect::<Vec<_>>(), &inputs, &outputs));
        found = parts.into_iter().find(|found| !found.is_empty()).unwrap_or_default();
    }
    checked.suspicions = found.iter().map(Fault::to_string).collect();
    for (first, second) in REDUNDANT {
        let quantity = |role: &str| all.iter().find_map(|run| run.signals.get(role)).map(|signal| signal.quantity);
        let (Some(one), Some(other)) = (quantity(first), quantity(second)) else { continue };
        let Some(relation) = Relation::of(one, other) else {
            let units = format!("`{first}` is in {}, `{second}` in {}", one.si(), other.si());
            checked.notes.push(format!("{units}: neither is the rate of the other, they are not compared"));
            continue;
        };
        match compare(&all, first, second, relation) {
            Some(compared) => {
                checked.suspicions.extend(compared.finding());
                checked.notes.push(compared.to_string());
            }
            None => checked.notes.push(format!("`{first}` and `{second}` have too little motion to be compared")),
        }
    }
    checked
}

/// Mistake in a recording that can be corrected.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Mistake {
    /// The rows are in reverse order of time.
    Reversed,
    /// Input and output are exchanged.
    Swapped,
    /// Angles are in degrees under a name with rad.
    Degrees,
    /// Angles are in rad under a name with degrees.
    Radians,
    /// The output has the wrong sign.
    Inverted,
}

impl Mistake {
    const ALL: [Self; 5] = [Self::Reversed, Self::Swapped, Self::Degrees, Self::Radians, Self::Inverted];

    const fn told(self) -> &'static str {
        match self {
            Self::Reversed => "time runs backwards in the recordings: with the rows in reverse order",
            Self::Swapped => "input and output are exchanged: with each in the other's place (--map)",
            Self::Degrees => "what is called rad is in degrees: multiplied by pi/180",
            Self::Radians => "what is called degrees is in rad: multiplied by 180/pi",
            Self::Inverted => "the output has the wrong sign: with the other",
        }
    }

    /// Returns the recording with the mistake corrected; `None` if the recording cannot contain it.
    fn undone(self, run: &Run, driving: &[&str]) -> Option<Run> {
        let mut run = run.clone();
        let is_output = |role: &&String| !driving.contains(&role.as_str()) && *role != SPEED;
        let outputs: Vec<String> = run.signals.keys().filter(is_output).cloned().collect();
        let is_angular = |quantity| matches!(quantity, Quantity::Angle | Quantity::AngularSpeed);
        let is_done = match self {
            Self::Reversed => {
                let end_s = run.time_s.last().copied()?;
                run.time_s.reverse();
                run.time_s.iter_mut().for_each(|time_s| *time_s = end_s - *time_s);
                run.signals.values_mut().for_each(|signal| signal.values.reverse());
                true
            }
            Self::Swapped => {
                let inputs: Vec<&&str> = driving.iter().filter(|role| run.signals.contains_key(**role)).collect();
                // Only a single input and output can have been exchanged.
                let ([input], [output]) = (inputs.as_slice(), outputs.as_slice()) else { return None };
                let (was_input, was_output) = (run.signals.remove(**input)?, run.signals.remove(output)?);
                run.signals.insert((**input).to_owned(), was_output);
                run.signals.insert(output.clone(), was_input);
                true
            }
            Self::Degrees => scale(&mut run, &outputs, PI / 180.0, is_angular),
            Self::Radians => scale(&mut run, &outputs, 180.0 / PI, is_angular),
            Self::Inverted => scale(&mut run, &outputs, -1.0, |_| true),
        };
        is_done.then_some(run)
    }
}

/// Multiplies the signals of some roles whose quantity is meant by `factor`. Returns whether there are any.
fn scale(run: &mut Run, roles: &[String], factor: f64, is_meant: fn(Quantity) -> bool) -> bool {
    let mut any = false;
    for role in roles {
        let signal = run.signals.get_mut(role).filter(|signal| is_meant(signal.quantity));
        let Some(signal) = signal else { continue };
        signal.values.iter_mut().for_each(|value| *value *= factor);
        any = true;
    }
    any
}

/// Fits the base model alone and returns its NRMSE on held-out data.
struct Base;

impl Work for Base {
    type Done = f64;

    fn with<F: Family>(self, family: &F, train: &[F::Run], holdout: &[F::Run]) -> f64 {
        base_nrmse(family, train, holdout)
    }
}

/// Returns likely mistakes in recordings, largest improvement first. `left` is the NRMSE on held-out data without a
/// correction.
pub(crate) fn suspicions(task: &Task, train: &[Run], holdout: &[Run], left: f64) -> Vec<String> {
    let roles =
        models().into_iter().find(|model| model.name == task.model).map(|model| model.roles).unwrap_or_default();
    let driving: Vec<&str> = roles.iter().filter(|role| role.driving).map(|role| role.name).collect();
    let mut found: Vec<(f64, String)> = Mistake::ALL
        .into_iter()
        .filter_map(|mistake| {
            let undone =
                |runs: &[Run]| runs.iter().map(|run| mistake.undone(run, &driving)).collect::<Option<Vec<_>>>();
            let without = with_family(task, &undone(train)?, &undone(holdout)?, Base).ok()?;
            let told = format!(
                "{}, the base model alone leaves {:.1} % instead of {:.1} %",
                mistake.told(),
                100.0 * without,
                100.0 * left
            );
            (without <= LESS * left).then_some((without, told))
        })
        .collect();
    found.sort_by(|a, b| a.0.total_cmp(&b.0));
    found.into_iter().map(|(_, told)| told).collect()
}
