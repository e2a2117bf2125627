//! Laws declared for the printed tables of the OSMC evaluation (`data/osmc_tables` of this crate).

use r4_maths::statistics::RootMeanSquare;

use super::{About, Cause, Ladder, Law, Number, Rows, TableError, climb};

/// The printed tables of the OSMC evaluation.
pub struct Printed {
    /// Table 1 with the columns `set_deg`, `observed_deg`.
    pub rotary: Rows,
    /// Table 2 with the columns `set_mm`, `observed_mm`.
    pub linear: Rows,
    /// Tables 3 to 5 with the columns `kp`, `ki`, `kd`, `rise`, `overshoot`, `steady_state_error`.
    pub gains: Rows,
}

impl Printed {
    /// Reads the tables from `data/osmc_tables` of this crate.
    ///
    /// # Errors
    /// An error if these files are damaged.
    pub fn new() -> Result<Self, TableError> {
        let read = |text: &str| Rows::read(text.as_bytes());
        Ok(Self {
            rotary: read(include_str!("../../../data/osmc_tables/table1_rotary.csv"))?,
            linear: read(include_str!("../../../data/osmc_tables/table2_linear.csv"))?,
            gains: read(include_str!("../../../data/osmc_tables/tables345_gains.csv"))?,
        })
    }
}

const SCALE: &[Cause] = &[
    Cause { name: "missed edges", experiment: "the same move at two speeds: edges missed grow with the speed" },
    Cause { name: "counts per turn or coupling ratio", experiment: "ten turns, counted at a mark" },
    Cause { name: "protractor", experiment: "the same angles read with another instrument" },
];

/// Fits laws to Table 1: angle reached against angle set.
///
/// # Errors
/// An error for a table without its columns.
pub fn rotary(printed: &Printed, seed: u64) -> Result<Ladder, TableError> {
    let about = About { data: "OSMC Table 1", quantity: "angle", unit: "deg", columns: &["set_deg"] };
    let rows = printed.rotary.select(&["set_deg", "observed_deg"])?;
    let offset = || Number::new("offset", "deg", -10.0, 10.0);
    let share = || Number::new("share", "1", -0.1, 0.1);
    let laws = [
        Law::new("none", vec![], |_, x| x[0]),
        Law::new("constant", vec![offset()], |p, x| x[0] + p[0]),
        Law::new("scale", vec![share()], |p, x| x[0] * (1.0 + p[0])).because(SCALE),
        Law::new("offset and scale", vec![offset(), share()], |p, x| x[0] * (1.0 + p[1]) + p[0]),
    ];
    climb(&about, &rows, &laws, seed)
}

/// Returns the counts to which the released code sends the actuator for millimetres: `(960 v + 29) / 100`, with the
/// bracket misplaced.
fn commanded_counts(set_mm: f64) -> f64 {
    (960.0 * set_mm + 29.0) / 100.0
}

/// Returns the millimetres that the code then displays, truncated to whole ones.
fn displayed_mm(counts: f64) -> f64 {
    (0.104_167 * (counts - 29.0)).trunc()
}

/// Travel per count, mm.
const MM: f64 = 1.0 / 9.6;

const OVER_RUN: &[Cause] = &[
    Cause { name: "coasting on", experiment: "a log with time stamps: position after the duty went to zero" },
    Cause {
        name: "integral gathered while the operator typed",
        experiment: "the same moves after waits of 1 s and 60 s",
    },
    Cause { name: "another zero of the potentiometer", experiment: "counts at both end stops" },
];

const CONSTANT: &[Cause] = &[Cause {
    name: "constant",
    experiment: "positions by a caliper beside what the code displays, and counts at both ends",
}];

/// Fits laws to Table 2: position read against position set.
///
/// # Errors
/// An error for a table without its columns.
pub fn linear(printed: &Printed, seed: u64) -> Result<Ladder, TableError> {
    let about = About { data: "OSMC Table 2", quantity: "position", unit: "mm", columns: &["set_mm"] };
    let rows = printed.linear.select(&["set_mm", "observed_mm"])?;
    let offset = || Number::new("offset", "mm", -10.0, 10.0);
    let beyond = |name, low, high| Number { absent: Some(0.0), ..Number::new(name, "mm", low, high) };
    let laws = [
        Law::new("none", vec![], |_, x| x[0]),
        Law::new("released formula", vec![], |_, x| displayed_mm(commanded_counts(x[0]))),
        Law::new("constant", vec![offset()], |p, x| x[0] + p[0]).because(CONSTANT),
        Law::new("offset and scale", vec![offset(), Number::new("share", "1", -0.2, 0.2)], |p, x| {
            x[0] * (1.0 + p[1]) + p[0]
        }),
        Law::new("released formula, stops beyond", vec![beyond("over_run", 0.0, 6.0)], |p, x| {
            displayed_mm(commanded_counts(x[0]) + p[0] / MM)
        })
        .because(OVER_RUN),
        // Effect of a dead band or of friction: the actuator moves outwards, and its duty falls below what it needs
        // before the goal.
        Law::new("released formula, stops short", vec![beyond("short", 0.0, 6.0)], |p, x| {
            displayed_mm(commanded_counts(x[0]) - p[0] / MM)
        }),
    ];
    climb(&about, &rows, &laws, seed)
}

/// Returns the RMSE of Table 2, mm, with the released formula if the actuator stopped where its duty fell to `duty`
/// (of 255), at the released proportional gain of 2 per count.
///
/// # Errors
/// An error for a table without its columns.
pub fn linear_with_dead_band(printed: &Printed, duty: f64) -> Result<f64, TableError> {
    const KP: f64 = 2.0;
    let rows = printed.linear.select(&["set_mm", "observed_mm"])?;
    let error_mm = |row: &Vec<f64>| displayed_mm(commanded_counts(row[0]) - duty / KP) - row[1];
    Ok(rows.iter().map(error_mm).collect::<RootMeanSquare>().value().unwrap_or(0.0))
}

/// Returns the rows of the gains' table that `keep` accepts by `[kp, ki, kd]`, as `[kp, ki, kd, quantity]`. A dash
/// printed for an overshoot means none.
fn gain_rows(printed: &Printed, quantity: &str, keep: impl Fn(&[f64]) -> bool) -> Result<Vec<Vec<f64>>, TableError> {
    let mut rows = printed.gains.select(&["kp", "ki", "kd", quantity])?;
    if quantity == "overshoot" {
        let printed_rows = rows.clone();
        for mut row in printed.gains.select(&["kp", "ki", "kd", "steady_state_error"])? {
            if row[1] > 0.0 && !printed_rows.iter().any(|other| other[..3] == row[..3]) {
                row[3] = 0.0;
                rows.push(row);
            }
        }
    }
    rows.retain(|row| keep(&row[..3]));
    Ok(rows)
}

/// Fits closed forms to Tables 3 to 5 one after another, to see how far the stopping duty (of 255) explains them.
///
/// # Errors
/// An error for a table without its columns.
pub fn closed_forms(printed: &Printed, seed: u64) -> Result<Vec<Ladder>, TableError> {
    let columns: &[&str] = &["kp", "ki", "kd"];
    let about = |data, quantity, unit| About { data, quantity, unit, columns };
    let degrees = |name, high| Number::new(name, "deg", 0.0, high);
    let stopping = || Number::new("stopping_duty", "1/255", 0.0, 255.0);
    let none = || Law::new("none", vec![], |_, _| 0.0);
    let constant = || Law::new("constant", vec![degrees("value", 60.0)], |p, _| p[0]);

    let rows = gain_rows(printed, "steady_state_error", |g| g[1] == 0.0 && g[2] == 0.0)?;
    let laws = [none(), constant(), Law::new("stopping duty over Kp", vec![stopping()], |p, x| p[0] / x[0])];
    let error = climb(&about("OSMC Table 3", "steady-state error", "deg"), &rows, &laws, seed)?;
    // Table 4 is predicted with the stopping duty of Table 3.
    let duty = error.step("stopping duty over Kp").map_or(0.0, |step| step.parameters[0].value);

    let sum = || Number::new("integral_sum", "deg s", 0.0, 300.0);
    let rows = gain_rows(printed, "overshoot", |g| g[1] > 0.0 && g[2] == 0.0)?;
    let laws = [
        none(),
        Law::new("proportional to Ki", vec![Number::new("factor", "deg", 0.0, 20.0)], |p, x| p[0] * x[1]),
        Law::new("integral sum at the same stopping duty", vec![sum()], move |p, x| {
            ((x[1] * p[0] - duty) / x[0]).max(0.0)
        }),
        Law::new("integral sum at its own stopping duty", vec![sum(), stopping()], |p, x| {
            ((x[1] * p[0] - p[1]) / x[0]).max(0.0)
        }),
    ];
    let overshoot = climb(&about("OSMC Table 4", "overshoot", "deg"), &rows, &laws, seed)?;

    let rows = gain_rows(printed, "overshoot", |g| g[0] == 10.0 && g[1] == 4.0)?;
    let damped = [degrees("undamped", 60.0), Number::new("rate", "1", 0.0, 3.0)];
    let laws = [none(), constant(), Law::new("exponential in Kd", damped.to_vec(), |p, x| p[0] * (-p[1] * x[2]).exp())];
    let damping = climb(&about("OSMC Table 5", "overshoot", "deg"), &rows, &laws, seed)?;

    let seconds = |name, high| Number::new(name, "s", 0.0, high);
    let rows = gain_rows(printed, "rise", |g| g[1] == 0.0 && g[2] == 0.0)?;
    let laws = [
        none(),
        Law::new("constant", vec![seconds("value", 20.0)], |p, _| p[0]),
        Law::new("constant and inverse of Kp", vec![seconds("value", 20.0), seconds("over_kp", 100.0)], |p, x| {
            p[0] + p[1] / x[0]
        }),
    ];
    let rise = climb(&about("OSMC Table 3", "rise", "s"), &rows, &laws, seed)?;
    Ok(vec![error, overshoot, damping, rise])
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Checks both errors of a law to half of the last digit of the reference values.
    #[track_caller]
    fn scores(ladder: &Ladder, law: &str, rmse: f64, left_out: Option<f64>, last_digit: f64) {
        let step = ladder.step(law).unwrap();
        let near = |value: f64, reference: f64| (value - reference).abs() <= 0.51 * last_digit;
        assert!(near(step.rmse, rmse), "{law}: {} {rmse}", step.rmse);
        if let Some(left_out) = left_out {
            assert!(near(step.left_out_rmse, left_out), "{law}: {} {left_out}", step.left_out_rmse);
        }
    }

    // The reference values were computed independently with numpy and scipy.

    #[test]
    fn table_1_is_a_scale_and_cannot_say_whose() {
        let ladder = rotary(&Printed::new().unwrap(), 1).unwrap();
        scores(&ladder, "none", 2.12, Some(2.12), 0.01);
        scores(&ladder, "constant", 0.71, Some(0.94), 0.01);
        scores(&ladder, "scale", 0.30, Some(0.37), 0.01);
        scores(&ladder, "offset and scale", 0.22, Some(0.38), 0.01);
        assert_eq!(ladder.chosen, "scale");
        assert_eq!(ladder.rivals.len(), 3);
        assert!((ladder.best().unwrap().parameters[0].value - 0.008_52).abs() < 5e-6);
    }

    #[test]
    fn table_2_is_over_run_after_a_misplaced_bracket_or_a_constant_but_no_friction() {
        let printed = Printed::new().unwrap();
        let ladder = linear(&printed, 1).unwrap();
        scores(&ladder, "none", 2.10, None, 0.01);
        scores(&ladder, "released formula", 1.18, None, 0.01);
        scores(&ladder, "constant", 0.63, Some(0.79), 0.01);
        scores(&ladder, "offset and scale", 0.59, Some(0.98), 0.01);
        scores(&ladder, "released formula, stops beyond", 0.63, None, 0.01);
        let beyond = ladder.step("released formula, stops beyond").unwrap();
        let [low, high] = beyond.parameters[0].as_good.unwrap();
        assert!((low - 1.0).abs() < 0.05 && (high - 1.9).abs() < 0.1, "{low} {high}");
        let friction = ladder.rejected.iter().find(|refused| refused.law.ends_with("stops short")).unwrap();
        assert!(friction.reason.contains("without it"), "{friction:?}");
        assert!(ladder.rejected.iter().any(|refused| refused.law == "offset and scale"));
        assert!(ladder.rivals.iter().any(|rival| rival.name == "constant"));
        let dead_band = |duty| linear_with_dead_band(&printed, duty).unwrap();
        assert!((1.8..=2.1).contains(&dead_band(15.0)) && (2.6..=3.1).contains(&dead_band(30.0)));
    }

    #[test]
    fn tables_3_to_5_share_one_stopping_duty() {
        let ladders = closed_forms(&Printed::new().unwrap(), 1).unwrap();
        let [error, overshoot, damping, rise] = &ladders[..] else { panic!("four ladders") };
        scores(error, "none", 19.8, None, 0.1);
        scores(error, "constant", 5.7, Some(8.6), 0.1);
        scores(error, "stopping duty over Kp", 1.60, Some(2.25), 0.01);
        assert!((error.best().unwrap().parameters[0].value - 133.7).abs() < 0.05);
        scores(overshoot, "integral sum at the same stopping duty", 0.94, None, 0.01);
        scores(overshoot, "none", 11.2, None, 0.1);
        let held = overshoot.step("integral sum at the same stopping duty").unwrap();
        assert!((held.parameters[0].value - 62.3).abs() < 0.05, "{held:?}");
        let free = overshoot.step("integral sum at its own stopping duty").unwrap();
        assert!((free.rmse - 0.20).abs() < 0.005, "{free:?}");
        scores(damping, "exponential in Kd", 0.41, None, 0.01);
        scores(rise, "constant and inverse of Kp", 0.01, None, 0.01);
    }
}
