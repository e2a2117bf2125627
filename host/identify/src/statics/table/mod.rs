//! Closed-form laws against the rows of a table: the model `table`.
//!
//! A table has few rows, so each law is judged by leave-one-out cross-validation: each row is predicted by a fit to
//! the others. Results hold for the printed numbers.

pub mod gains;
pub mod osmc;
pub mod task;

use std::io::Read;

use r4_maths::minimise::{Effort, global};
use serde::Serialize;
use statrs::distribution::{ContinuousCDF, StudentsT};
use thiserror::Error;

use crate::report::Unexplained;

/// Reason why a table cannot be used.
#[derive(Debug, Error)]
pub enum TableError {
    /// The file is not valid CSV.
    #[error("the table cannot be read: {0}; one header line, then the same number of cells in each row")]
    Csv(#[from] csv::Error),
    /// A cell is neither a number nor empty nor a dash.
    #[error("row {row}, column `{column}`: `{cell}` is no number; leave the cell empty where nothing is printed")]
    Cell {
        /// Number of the row, from 1, without the header.
        row: usize,
        /// Name of the column.
        column: String,
        /// Text of the cell.
        cell: String,
    },
    /// The table has no column of this name.
    #[error("there is no column `{column}`; the table has: {columns}")]
    NoColumn {
        /// Name of the requested column.
        column: String,
        /// Names of all columns.
        columns: String,
    },
    /// There are too few rows for cross-validation.
    #[error("{rows} rows have all of the columns {columns}; three are needed to leave one out")]
    TooFew {
        /// Number of rows with all columns.
        rows: usize,
        /// Names of the requested columns.
        columns: String,
    },
}

/// Table of numbers, as printed.
#[derive(Clone, Debug, PartialEq)]
pub struct Rows {
    columns: Vec<String>,
    /// Cells of each row; `None` where nothing is printed.
    cells: Vec<Vec<Option<f64>>>,
}

impl Rows {
    /// Reads CSV with a header. An empty cell or a dash holds no number.
    ///
    /// # Errors
    /// An error for rows of different lengths, or cells that are no numbers, except in columns without any number.
    pub fn read(csv: impl Read) -> Result<Self, TableError> {
        let mut reader = csv::ReaderBuilder::new().trim(csv::Trim::All).from_reader(csv);
        let columns: Vec<String> = reader.headers()?.iter().map(str::to_owned).collect();
        let records = reader.records().collect::<Result<Vec<_>, _>>()?;
        let empty = |cell: &str| matches!(cell, "" | "-" | "–");
        let number = |cell: &str| cell.parse::<f64>().ok().filter(|value| value.is_finite());
        let words: Vec<bool> =
            (0..columns.len()).map(|at| records.iter().all(|record| number(&record[at]).is_none())).collect();
        let mut cells = Vec::new();
        for (row, record) in records.iter().enumerate() {
            let cell = |(at, text): (usize, &str)| match number(text) {
                Some(value) => Ok(Some(value)),
                None if empty(text) || words[at] => Ok(None),
                None => Err(TableError::Cell { row: row + 1, column: columns[at].clone(), cell: text.to_owned() }),
            };
            cells.push(record.iter().enumerate().map(cell).collect::<Result<Vec<_>, _>>()?);
        }
        Ok(Self { columns, cells })
    }

    /// Iterates over the names of the columns that hold numbers.
    pub fn columns(&self) -> impl Iterator<Item = &str> {
        let holds = |at: usize| self.cells.iter().any(|row| row[at].is_some());
        self.columns.iter().enumerate().filter(move |(at, _)| holds(*at)).map(|(_, column)| column.as_str())
    }

    /// Returns the rows in which all of these columns hold a number, with the cells in the order of `columns`.
    ///
    /// # Errors
    /// [`TableError::NoColumn`] for an unknown column.
    pub fn select(&self, columns: &[&str]) -> Result<Vec<Vec<f64>>, TableError> {
        let place = |column: &&str| {
            let place = self.columns.iter().position(|name| name == column);
            place.ok_or_else(|| TableError::NoColumn { column: (*column).to_owned(), columns: self.columns.join(", ") })
        };
        let places = columns.iter().map(place).collect::<Result<Vec<_>, _>>()?;
        Ok(self.cells.iter().filter_map(|row| places.iter().map(|&at| row[at]).collect()).collect())
    }
}

/// Parameter of a law.
#[derive(Clone, Debug, PartialEq)]
pub struct Number {
    /// Name of the parameter in reports.
    pub name: &'static str,
    /// Unit of the parameter; `1` for a dimensionless number.
    pub unit: &'static str,
    /// Range in which the fit searches.
    pub bounds: (f64, f64),
    /// Value without the law's effect, if there is one.
    pub absent: Option<f64>,
}

/// Physical cause that would make a law true.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct Cause {
    /// Name of the cause.
    pub name: &'static str,
    /// Advice for a recording that separates it from the law's other causes.
    pub experiment: &'static str,
}

/// Prediction of a row's last column from the values of the law's parameters and the row's columns.
pub type Predict = Box<dyn Fn(&[f64], &[f64]) -> f64 + Send + Sync>;

/// Closed-form law with its parameters.
pub struct Law {
    /// Name of the law in reports.
    pub name: String,
    /// Parameters that are fitted.
    pub numbers: Vec<Number>,
    /// Function that predicts a row.
    pub predict: Predict,
    /// Possible causes of the law.
    pub causes: &'static [Cause],
}

impl Law {
    /// Creates a law with these parameters and no causes.
    pub fn new(
        name: impl Into<String>,
        numbers: Vec<Number>,
        predict: impl Fn(&[f64], &[f64]) -> f64 + Send + Sync + 'static,
    ) -> Self {
        Self { name: name.into(), numbers, predict: Box::new(predict), causes: &[] }
    }

    /// Returns the law with possible causes.
    #[must_use]
    pub fn because(self, causes: &'static [Cause]) -> Self {
        Self { causes, ..self }
    }
}

impl Number {
    /// Creates a parameter within bounds, without a value for absence.
    #[must_use]
    pub const fn new(name: &'static str, unit: &'static str, low: f64, high: f64) -> Self {
        Self { name, unit, bounds: (low, high), absent: None }
    }
}

/// Fitted parameter of a law.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Value {
    /// Name of the parameter.
    pub name: &'static str,
    /// Value at the best fit.
    pub value: f64,
    /// Unit of the value; `1` for a dimensionless number.
    pub unit: &'static str,
    /// Standard error by the jackknife: the fit is repeated without each row.
    pub std: f64,
    /// 95 % confidence interval by the profile of the squared error; only for laws with one parameter.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub interval: Option<[f64; 2]>,
    /// Range of values that fit equally well; only for laws with one parameter that round.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub as_good: Option<[f64; 2]>,
}

/// Fitted law with its errors.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Step {
    /// Name of the law.
    pub law: String,
    /// Fitted parameters of the law.
    pub parameters: Vec<Value>,
    /// RMSE on the rows that it was fitted to.
    pub rmse: f64,
    /// RMSE of leave-one-out cross-validation.
    pub left_out_rmse: f64,
    /// Squared leave-one-out error of each row.
    pub left_out_squares: Vec<f64>,
}

/// Law that was rejected.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Refused {
    /// Name of the law.
    pub law: String,
    /// Reason of the rejection.
    pub reason: String,
}

/// Comparison of laws for one quantity of a table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Ladder {
    /// Name of the table.
    pub data: String,
    /// Name of the column that is predicted.
    pub quantity: String,
    /// Unit of every RMSE.
    pub unit: String,
    /// Number of rows of the table.
    pub rows: usize,
    /// Fitted laws in the order in which they were given.
    pub steps: Vec<Step>,
    /// Name of the chosen law: the one with the fewest parameters that predicts left-out rows well.
    pub chosen: String,
    /// Laws, and causes of the chosen one, that these rows do not separate from it, with an experiment that would.
    pub rivals: Vec<Rivalry>,
    /// Laws that were rejected, with the reasons.
    pub rejected: Vec<Refused>,
    /// Columns that the chosen law's residual still depends on.
    pub unexplained: Vec<Unexplained>,
    /// Result in one plain sentence.
    pub verdict: String,
}

/// Alternative that explains the rows as well as what was chosen.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Rivalry {
    /// Name of the law or cause.
    pub name: String,
    /// Experiment that would separate it.
    pub experiment: String,
}

impl Ladder {
    /// Returns the fitted law with a name; `None` if there is none.
    #[must_use]
    pub fn step(&self, law: &str) -> Option<&Step> {
        self.steps.iter().find(|step| step.law == law)
    }

    /// Returns the chosen law.
    #[must_use]
    pub fn best(&self) -> Option<&Step> {
        self.step(&self.chosen)
    }
}

/// Subject of a ladder.
#[derive(Clone, Copy, Debug)]
pub struct About<'a> {
    /// Name of the table.
    pub data: &'a str,
    /// Name of the last column of each row.
    pub quantity: &'a str,
    /// Unit of the last column.
    pub unit: &'a str,
    /// Names of all columns but the last.
    pub columns: &'a [&'a str],
}

const EFFORT: Effort = Effort { points: 24, generations: 60, simplex: 600 };

fn errors<'r>(law: &'r Law, values: &'r [f64], rows: &'r [Vec<f64>]) -> impl Iterator<Item = f64> + 'r {
    rows.iter().map(|row| row.split_last().map_or(f64::NAN, |(y, x)| (law.predict)(values, x) - y))
}

fn squares(law: &Law, values: &[f64], rows: &[Vec<f64>]) -> f64 {
    errors(law, values, rows).map(|error| error * error).sum()
}

fn fit(law: &Law, rows: &[Vec<f64>], seed: u64) -> Vec<f64> {
    let bounds: Vec<(f64, f64)> = law.numbers.iter().map(|number| number.bounds).collect();
    global(&bounds, EFFORT, seed, |values| squares(law, values, rows)).at
}

/// Returns the squared error of each row after a fit to the others, with the parameters of that fit.
fn left_out(law: &Law, rows: &[Vec<f64>], seed: u64) -> Vec<(f64, Vec<f64>)> {
    let leave = |out: usize| {
        let others: Vec<Vec<f64>> =
            rows.iter().enumerate().filter(|(row, _)| *row != out).map(|(_, row)| row.clone()).collect();
        let values = fit(law, &others, seed);
        (squares(law, &values, &rows[out..=out]), values)
    };
    (0..rows.len()).map(leave).collect()
}

/// Fits and judges each law on rows whose last column it predicts; deterministic for a seed.
///
/// The law with the fewest parameters wins among those whose squared leave-one-out error is within one standard
/// error, over the rows, of the smallest (one-standard-error rule).
///
/// # Errors
/// [`TableError::TooFew`] for fewer than three rows.
pub fn climb(about: &About<'_>, rows: &[Vec<f64>], laws: &[Law], seed: u64) -> Result<Ladder, TableError> {
    if rows.len() < 3 || laws.is_empty() {
        return Err(TableError::TooFew { rows: rows.len(), columns: about.columns.join(", ") });
    }
    let mut steps = Vec::new();
    let mut errors: Vec<Vec<f64>> = Vec::new();
    let mut at_absence = Vec::new();
    for law in laws {
        let values = fit(law, rows, seed);
        let without = left_out(law, rows, seed);
        let fitted = squares(law, &values, rows);
        // A parameter whose absence fits as well only makes the prediction worse: its effect has the wrong sign.
        let gains_nothing = |(at, number): (usize, &Number)| {
            let Some(absent) = number.absent else { return false };
            let mut values = values.clone();
            values[at] = absent;
            squares(law, &values, rows) <= fitted * (1.0 + 1e-9)
        };
        at_absence.push(law.numbers.iter().enumerate().any(gains_nothing));
        steps.push(Step {
            law: law.name.clone(),
            parameters: estimates(law, &values, &without, rows),
            rmse: (fitted / rows.len() as f64).sqrt(),
            left_out_rmse: (without.iter().map(|(square, _)| square).sum::<f64>() / rows.len() as f64).sqrt(),
            left_out_squares: without.iter().map(|(square, _)| *square).collect(),
        });
        errors.push(without.into_iter().map(|(square, _)| square).collect());
    }
    let mean = |law: usize| errors[law].iter().sum::<f64>() / rows.len() as f64;
    let by_error = |a: &usize, b: &usize| mean(*a).total_cmp(&mean(*b));
    let candidates = || (0..laws.len()).filter(|&law| !at_absence[law]);
    let best = candidates().min_by(by_error).unwrap_or(0);
    let close: Vec<usize> = candidates().filter(|&law| !worse(&errors[law], &errors[best])).collect();
    let simpler = |a: &&usize, b: &&usize| laws[**a].numbers.len().cmp(&laws[**b].numbers.len()).then(by_error(a, b));
    let chosen = close.iter().min_by(simpler).copied().unwrap_or(best);
    let mut rivals: Vec<Rivalry> =
        laws[chosen].causes.iter().map(|cause| rivalry(cause.name, cause.experiment)).collect();
    // A single cause has no rival.
    if rivals.len() == 1 {
        rivals.clear();
    }
    let mut rejected = Vec::new();
    for (law, step) in steps.iter().enumerate().filter(|(law, _)| *law != chosen) {
        let numbers = laws[law].numbers.len();
        let as_many = numbers == laws[chosen].numbers.len();
        let as_good = close.contains(&law) || step.rmse <= 1.02 * steps[chosen].rmse;
        let reason = if at_absence[law] {
            "without it the fit is as good: more of it only makes it worse".to_owned()
        } else if as_many && as_good {
            let experiment =
                laws[law].causes.first().map_or("more rows, between these and beyond", |cause| cause.experiment);
            rivals.push(rivalry(&step.law, experiment));
            continue;
        } else if close.contains(&law) {
            format!("{numbers} numbers gain nothing that is more than chance on left-out rows")
        } else {
            format!(
                "error on left-out rows {:.3} against {:.3} {}",
                step.left_out_rmse, steps[chosen].left_out_rmse, about.unit
            )
        };
        rejected.push(Refused { law: step.law.clone(), reason });
    }
    let chosen_values: Vec<f64> = steps[chosen].parameters.iter().map(|value| value.value).collect();
    let residual: Vec<f64> = rows
        .iter()
        .filter_map(|row| row.split_last().map(|(y, x)| y - (laws[chosen].predict)(&chosen_values, x)))
        .collect();
    let columns: Vec<(&str, Vec<f64>)> = about
        .columns
        .iter()
        .enumerate()
        .map(|(at, column)| (*column, rows.iter().map(|row| row[at]).collect()))
        .collect();
    let step = &steps[chosen];
    let verdict = format!(
        "{} of {}, fitted to the printed tables: `{}` leaves {:.2} {} ({:.2} on left-out rows).",
        about.quantity, about.data, step.law, step.rmse, about.unit, step.left_out_rmse
    );
    Ok(Ladder {
        data: about.data.to_owned(),
        quantity: about.quantity.to_owned(),
        unit: about.unit.to_owned(),
        rows: rows.len(),
        chosen: step.law.clone(),
        unexplained: follows(&residual, &columns),
        steps,
        rivals,
        rejected,
        verdict,
    })
}

fn rivalry(name: &str, experiment: &str) -> Rivalry {
    Rivalry { name: name.to_owned(), experiment: experiment.to_owned() }
}

/// Returns whether errors are larger than others by more than one standard error of their differences, row by row.
pub(crate) fn worse(errors: &[f64], others: &[f64]) -> bool {
    let rows = errors.len() as f64;
    let differences: Vec<f64> = errors.iter().zip(others).map(|(a, b)| a - b).collect();
    let mean = differences.iter().sum::<f64>() / rows;
    let variance =
        differences.iter().map(|difference| (difference - mean).powi(2)).sum::<f64>() / (rows - 1.0).max(1.0);
    mean > (variance / rows).sqrt()
}

/// Returns the columns that a residual depends on linearly, by the t-test of its correlation at 5 % over all columns.
fn follows(residual: &[f64], columns: &[(&str, Vec<f64>)]) -> Vec<Unexplained> {
    let mut found = Vec::new();
    for (column, values) in columns {
        if let Some((share, p_value)) = correlation(values, residual) {
            let p_value = (p_value * columns.len() as f64).min(1.0);
            if p_value < 0.05 {
                found.push(Unexplained { depends_on: (*column).to_owned(), share, p_value });
            }
        }
    }
    found.sort_by(|a, b| b.share.total_cmp(&a.share));
    found
}

/// Returns the share of the variance that a straight line explains, and its p-value; `None` if either does not vary.
pub(crate) fn correlation(x: &[f64], y: &[f64]) -> Option<(f64, f64)> {
    let rows = x.len() as f64;
    if rows < 3.0 {
        return None;
    }
    let (mx, my) = (x.iter().sum::<f64>() / rows, y.iter().sum::<f64>() / rows);
    let sum = |f: &dyn Fn(f64, f64) -> f64| x.iter().zip(y).map(|(x, y)| f(x - mx, y - my)).sum::<f64>();
    let (xx, yy, xy) = (sum(&|x, _| x * x), sum(&|_, y| y * y), sum(&|x, y| x * y));
    // Rounding errors make a residual that is exactly zero look like one.
    let size: f64 = y.iter().map(|y| y.abs()).fold(0.0, f64::max).max(1e-9);
    if xx <= 0.0 || yy <= 1e-12 * size * size || yy < 1e-18 {
        return None;
    }
    let share = (xy * xy / (xx * yy)).min(1.0);
    let t = (share * (rows - 2.0) / (1.0 - share).max(1e-12)).sqrt();
    let students = StudentsT::new(0.0, 1.0, rows - 2.0).ok()?;
    Some((share, 2.0 * (1.0 - students.cdf(t))))
}

fn estimates(law: &Law, values: &[f64], without: &[(f64, Vec<f64>)], rows: &[Vec<f64>]) -> Vec<Value> {
    let count = without.len() as f64;
    let estimate = |(at, number): (usize, &Number)| {
        let mean = without.iter().map(|(_, values)| values[at]).sum::<f64>() / count;
        let spread: f64 = without.iter().map(|(_, values)| (values[at] - mean).powi(2)).sum();
        let mut value = Value {
            name: number.name,
            value: values[at],
            unit: number.unit,
            std: (spread * (count - 1.0) / count).sqrt(),
            interval: None,
            as_good: None,
        };
        if law.numbers.len() == 1 {
            profile(law, number, &mut value, rows);
        }
        value
    };
    law.numbers.iter().enumerate().map(estimate).collect()
}

/// Computes the intervals of a law's only parameter by stepping away from its best value.
fn profile(law: &Law, number: &Number, value: &mut Value, rows: &[Vec<f64>]) {
    const STEPS: u32 = 4000;
    let free = rows.len() as f64 - 1.0;
    let Ok(students) = StudentsT::new(0.0, 1.0, free) else { return };
    let least = squares(law, &[value.value], rows);
    let limit = least * (1.0 + students.inverse_cdf(0.975).powi(2) / free);
    let (low, high) = number.bounds;
    // Stepping outwards from the best value, a second minimum elsewhere does not widen the interval.
    let walk = |end: f64, limit: f64| {
        let step = (high - low) / f64::from(STEPS) * (end - value.value).signum();
        let places = (0..=STEPS).map(|at| value.value + step * f64::from(at));
        let inside = places.take_while(|&at| (low..=high).contains(&at) && squares(law, &[at], rows) <= limit);
        inside.last().unwrap_or(value.value)
    };
    value.interval = Some([walk(low, limit), walk(high, limit)]);
    let equal = least + 1e-12 * (1.0 + least);
    let as_good = [walk(low, equal), walk(high, equal)];
    if as_good[1] - as_good[0] > 1e-3 * (high - low) {
        value.as_good = Some(as_good);
    }
}

/// Returns laws for a table without declared ones: its last column against each of the others.
#[must_use]
pub fn general(columns: &[&str], rows: &[Vec<f64>]) -> Vec<Law> {
    let largest = |at: usize| rows.iter().map(|row| row[at].abs()).fold(0.0, f64::max);
    let height = largest(columns.len()).max(f64::MIN_POSITIVE);
    let any = |name, unit, scale: f64| Number::new(name, unit, -scale, scale);
    let mut laws = vec![
        Law::new("none", vec![], |_, _| 0.0),
        Law::new("constant", vec![any("value", "output", 2.0 * height)], |p, _| p[0]),
    ];
    for (at, column) in columns.iter().enumerate() {
        let span = largest(at);
        if span <= 0.0 {
            continue;
        }
        let slope = 10.0 * height / span;
        let least = rows.iter().map(|row| row[at].abs()).fold(f64::INFINITY, f64::min);
        laws.push(Law::new(format!("equal to {column}"), vec![], move |_, x| x[at]));
        laws.push(Law::new(
            format!("{column} and a constant"),
            vec![any("offset", "output", 2.0 * height)],
            move |p, x| x[at] + p[0],
        ));
        laws.push(Law::new(format!("proportional to {column}"), vec![any("factor", "1", slope)], move |p, x| {
            p[0] * x[at]
        }));
        laws.push(Law::new(
            format!("straight line over {column}"),
            vec![any("factor", "1", slope), any("offset", "output", 10.0 * height)],
            move |p, x| p[0] * x[at] + p[1],
        ));
        if least > 0.0 {
            let size = 2.0 * height * span;
            laws.push(Law::new(format!("inverse of {column}"), vec![any("factor", "1", size)], move |p, x| {
                p[0] / x[at]
            }));
            laws.push(Law::new(
                format!("constant and inverse of {column}"),
                vec![any("offset", "output", 10.0 * height), any("factor", "1", 10.0 * size)],
                move |p, x| p[0] + p[1] / x[at],
            ));
            laws.push(Law::new(
                format!("power of {column}"),
                vec![any("at_largest", "output", 2.0 * height), any("exponent", "1", 5.0)],
                move |p, x| p[0] * (x[at].abs() / span).powf(p[1]),
            ));
        }
        laws.push(Law::new(
            format!("exponential in {column}"),
            vec![any("at_zero", "output", 10.0 * height), any("rate", "1", 10.0 / span)],
            move |p, x| p[0] * (p[1] * x[at]).exp(),
        ));
        laws.push(Law::new(
            format!("saturation over {column}"),
            vec![any("limit", "output", 10.0 * height), Number::new("curvature", "1", 1e-3 / span, 30.0 / span)],
            move |p, x| -p[0] * (-p[1] * x[at]).exp_m1(),
        ));
    }
    laws
}

#[cfg(test)]
mod tests {
    use super::*;

    const ABOUT: About<'static> = About { data: "a table", quantity: "y", unit: "mm", columns: &["x"] };

    fn rows(y: impl Fn(f64) -> f64) -> Vec<Vec<f64>> {
        (1..=8).map(|x| vec![f64::from(x), y(f64::from(x))]).collect()
    }

    #[test]
    fn reads_what_is_printed_and_nothing_else() {
        let table = Rows::read("name, a,b\none,1,-\ntwo,2, 5\nthree,,6\n".as_bytes()).unwrap();
        assert_eq!(table.columns().collect::<Vec<_>>(), ["a", "b"]);
        assert_eq!(table.select(&["b", "a"]).unwrap(), [[5.0, 2.0]]);
        assert!(matches!(table.select(&["c"]), Err(TableError::NoColumn { .. })));
        let wrong = Rows::read("a,b\n1,2\n3,4?\n".as_bytes()).unwrap_err();
        assert!(matches!(&wrong, TableError::Cell { row: 2, column, .. } if column == "b"), "{wrong}");
        assert!(Rows::read("a,b\n1\n".as_bytes()).is_err());
    }

    #[test]
    fn leaving_a_row_out_has_a_closed_form_for_the_mean() {
        // The mean of the others misses row i by n/(n-1) times its distance from the mean of all.
        let rows = rows(|x| x * x);
        let law = || Law::new("constant", vec![Number::new("value", "mm", -100.0, 100.0)], |p, _| p[0]);
        let ladder = climb(&ABOUT, &rows, &[law()], 1).unwrap();
        let step = ladder.best().unwrap();
        assert!((step.left_out_rmse / step.rmse - 8.0 / 7.0).abs() < 1e-6);
        // The jackknife of a mean is its standard error.
        let variance = step.rmse.powi(2) * 8.0 / 7.0;
        assert!((step.parameters[0].std / (variance / 8.0).sqrt() - 1.0).abs() < 1e-6);
        // So is its profile, times t of 97.5 % with 7 degrees of freedom (2.3646 in tables); the steps are 0.05.
        let [low, high] = step.parameters[0].interval.unwrap();
        assert!(((high - low) / 2.0 - 2.3646 * (variance / 8.0).sqrt()).abs() < 0.06, "{low} {high}");
    }

    #[test]
    fn general_laws_find_the_one_that_made_the_rows() {
        // Alternating errors of 1 % of the largest value.
        let noisy = |y: &dyn Fn(f64) -> f64| {
            let mut rows = rows(y);
            let size = rows.iter().map(|row| row[1].abs()).fold(0.0, f64::max);
            rows.iter_mut().enumerate().for_each(|(at, row)| row[1] += [0.01, -0.01, -0.01, 0.01][at % 4] * size);
            rows
        };
        let cases: [(&str, &dyn Fn(f64) -> f64); 5] = [
            ("constant", &|_| 4.0),
            ("proportional to x", &|x| 3.0 * x),
            ("inverse of x", &|x| 12.0 / x),
            ("straight line over x", &|x| 20.0 - 2.0 * x),
            ("exponential in x", &|x| 5.0 * (-0.5 * x).exp()),
        ];
        for (name, y) in cases {
            let rows = noisy(y);
            let ladder = climb(&ABOUT, &rows, &general(&["x"], &rows), 1).unwrap();
            let alike = ladder.rivals.iter().any(|rival| rival.name == name);
            assert!(ladder.chosen == name || alike, "{name}: {} {:?}", ladder.chosen, ladder.rivals);
        }
    }

    #[test]
    fn an_effect_of_the_wrong_sign_is_refused_by_its_absence() {
        let short = Number { absent: Some(0.0), ..Number::new("short", "mm", 0.0, 5.0) };
        let laws = [Law::new("set", vec![], |_, x| x[0]), Law::new("stops short", vec![short], |p, x| x[0] - p[0])];
        let ladder = climb(&ABOUT, &rows(|x| x + 1.0), &laws, 1).unwrap();
        assert_eq!(ladder.chosen, "set");
        assert!(ladder.rejected[0].reason.contains("without it"));
    }

    #[test]
    fn a_residual_that_follows_a_column_is_said() {
        let laws = [Law::new("constant", vec![Number::new("value", "mm", -50.0, 50.0)], |p, _| p[0])];
        let ladder = climb(&ABOUT, &rows(|x| 2.0 * x), &laws, 1).unwrap();
        assert_eq!(ladder.unexplained[0].depends_on, "x");
        assert!(ladder.unexplained[0].share > 0.999);
        let flat = climb(&ABOUT, &rows(|x| [1.0, -1.0, -1.0, 1.0][x as usize % 4]), &laws, 1).unwrap();
        assert!(flat.unexplained.is_empty());
    }

    #[test]
    fn two_rows_are_too_few() {
        let rows = rows(|x| x);
        assert!(matches!(
            climb(&ABOUT, &rows[..2], &general(&["x"], &rows), 1),
            Err(TableError::TooFew { rows: 2, .. })
        ));
    }
}
