//! Check that runs hold the data which a model requires.

use super::{DataError, Quantity, Run, unit::unit};

/// Requirement of a model on one role.
#[derive(Clone, Debug, PartialEq)]
pub struct Need {
    /// Name of the role, such as `input`.
    pub role: String,
    /// Meaning of the role, for messages.
    pub what: String,
    /// Allowed quantities; any if empty.
    pub quantities: Vec<Quantity>,
    /// True if the model cannot do without it.
    pub required: bool,
    /// True for an input of the model, false for an output that is compared with it.
    pub driving: bool,
    /// True if a constant signal cannot be used.
    pub varies: bool,
    /// Smallest number of finite samples over all runs.
    pub samples: usize,
}

/// Checks `runs` against `needs`, in the order of `needs`.
///
/// # Errors
/// [`DataError::NoRole`], [`DataError::Unit`], [`DataError::TooShort`], [`DataError::ConstantInput`] and
/// [`DataError::ConstantOutput`]; each says what to record.
pub fn check(runs: &[Run], needs: &[Need]) -> Result<(), DataError> {
    for need in needs {
        let signals: Vec<_> = runs.iter().filter_map(|run| run.signals.get(&need.role)).collect();
        let Some(first) = signals.first() else {
            if need.required {
                return Err(DataError::NoRole { role: need.role.clone(), what: need.what.clone() });
            }
            continue;
        };
        let (role, column) = (need.role.clone(), first.column.clone());
        if !need.quantities.is_empty() && !need.quantities.contains(&first.quantity) {
            return Err(wrong_unit(need, &column, first.quantity));
        }
        // Missing values neither count as samples nor as a change.
        let values = || signals.iter().flat_map(|signal| &signal.values).copied().filter(|value| value.is_finite());
        let samples = values().count();
        if samples < need.samples {
            return Err(DataError::TooShort { role, column, samples, needed: need.samples });
        }
        let (Some(value), true) = (values().next(), need.varies) else { continue };
        if values().all(|other| other == value) {
            return Err(if need.driving {
                DataError::ConstantInput { role, column, value }
            } else {
                DataError::ConstantOutput { role, column, value }
            });
        }
    }
    Ok(())
}

fn wrong_unit(need: &Need, column: &str, found: Quantity) -> DataError {
    let stated = unit(column, None);
    let endings: Vec<String> = need.quantities.iter().map(|quantity| ending(*quantity).to_owned()).collect();
    let endings = endings.join(" or ");
    let (problem, cure) = if stated.counts {
        ("it is in counts".to_owned(), "tell how many make a turn, as in `--param counts_per_turn=4096`".to_owned())
    } else if stated.stated {
        (format!("it is {}", name(found)), format!("name a column that ends in {endings}"))
    } else {
        ("its name has no unit".to_owned(), format!("let it end in {endings}"))
    };
    DataError::Unit { column: column.to_owned(), role: need.role.clone(), problem, cure }
}

fn name(quantity: Quantity) -> &'static str {
    match quantity {
        Quantity::Angle => "an angle",
        Quantity::AngularSpeed => "an angular speed",
        Quantity::Length => "a length",
        Quantity::Speed => "a speed",
        Quantity::Voltage => "a voltage",
        Quantity::Force => "a force",
        Quantity::Torque => "a torque",
        Quantity::Current => "a current",
        Quantity::Temperature => "a temperature",
        Quantity::Number => "a plain number",
    }
}

fn ending(quantity: Quantity) -> &'static str {
    match quantity {
        Quantity::Angle => "`_rad` or `_deg`",
        Quantity::AngularSpeed => "`_rad_s`, `_deg_s` or `_rpm`",
        Quantity::Length => "`_m` or `_mm`",
        Quantity::Speed => "`_m_s` or `_mm_s`",
        Quantity::Voltage => "`_V` or `_mV`",
        Quantity::Force => "`_N`",
        Quantity::Torque => "`_nm` (N m)",
        Quantity::Current => "`_A` or `_mA`",
        Quantity::Temperature => "`_C`",
        Quantity::Number => "nothing, `_pct` or `_permille`",
    }
}
