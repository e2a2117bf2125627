//! Effects without a name: a piecewise linear curve over the quantity they depend on.
//!
//! In a plant file, among the others:
//!
//! ```toml
//! [[effects]]
//! effect = "table"
//! over = "position"        # input, speed, position, time, supply, history or since-turn
//! on = "force"             # or "friction", "gain", "input", "hysteresis"; "force" if it is not said
//! period = 6.283185307     # if the axis is a circle, such as a turn
//! at = [0.0, 1.5, 4.0]
//! values = [0.1, -0.2, 0.05]
//! ```

use super::{dependence::Dependence, direction::Direction};
use crate::error::{InvalidField, Problem};

/// Quantity on the abscissa of a [`Table`].
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Over {
    /// The duty: for a table on the input, after the named input effects; for the others, after the plant's delays.
    Input,
    /// Speed of the motor side, rad/s or m/s.
    Speed,
    /// Position of the motor side, rad or m.
    Position,
    /// Seconds since the start of the simulation.
    Time,
    /// Supply voltage without load, V.
    Supply,
    /// Travel of the motor side since its last reversal, unsigned, rad or m.
    History,
    /// Seconds since the motor side's last reversal; beyond every knot before the first one.
    SinceTurn,
}

impl Over {
    /// All variants, in the order of declaration.
    pub const ALL: [Self; 7] =
        [Self::Input, Self::Speed, Self::Position, Self::Time, Self::Supply, Self::History, Self::SinceTurn];

    /// Word for the quantity in plant files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::SinceTurn => "since-turn",
            _ => self.dependence().name(),
        }
    }

    /// Corresponding quantity in reports.
    #[must_use]
    pub const fn dependence(self) -> Dependence {
        match self {
            Self::Input => Dependence::Input,
            Self::Speed => Dependence::Speed,
            Self::Position => Dependence::Position,
            Self::Time => Dependence::Time,
            Self::Supply => Dependence::Supply,
            Self::History | Self::SinceTurn => Dependence::History,
        }
    }
}

/// Quantity that the values of a [`Table`] act on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum On {
    /// A force towards positive positions at the motor side, N m or N.
    Force,
    /// Dry friction at the motor side, N m or N: a force against motion that also holds at rest. A negative value
    /// reduces other dry friction; where the sum is negative there is none.
    Friction,
    /// Gain of the drive's voltage: it is multiplied by 1 + value, at least 0.
    Gain,
    /// Duty added behind all other input effects.
    Input,
    /// A force against the direction in which the motor side moved last, also at rest, N m or N.
    ///
    /// Over [`Over::History`] without a period, the values are those after a long travel in the other direction. The
    /// force does not jump to the first value `h(0)`: from the force `F` at the reversal, also one half-way, it
    /// approaches the last value `h(∞)` as the table does, `h(x) + (F - h(0)) (h(∞) - h(x)) / (h(∞) - h(0))`, with
    /// forces counted against the new direction. With `h(x) = c (1 - 2 exp(-x / s))` this is Dahl's friction.
    ///
    /// # Source
    /// Dahl, *A solid friction model*, The Aerospace Corporation TOR-0158(3107-18)-1, 1968.
    Hysteresis,
}

impl On {
    /// All variants, in the order of declaration.
    pub const ALL: [Self; 5] = [Self::Force, Self::Friction, Self::Gain, Self::Input, Self::Hysteresis];

    /// Word for the quantity in plant files.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Force => "force",
            Self::Friction => "friction",
            Self::Gain => "gain",
            Self::Input => "input",
            Self::Hysteresis => "hysteresis",
        }
    }
}

/// Piecewise linear curve, constant beyond both ends or periodic. The only constructor checks every number, so all are
/// in range.
///
/// Two neighbouring knots at the same place are a jump, as dry friction has at speed 0. The part of a force over speed
/// that opposes motion acts like friction: it stops a plant and holds it, but does not reverse it.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    over: Over,
    on: On,
    period: Option<f64>,
    at: Vec<f64>,
    values: Vec<f64>,
}

/// Largest number of knots of a table.
pub const MAX_CORNERS: usize = 4096;

/// Largest magnitude of a number in a table.
const LARGEST: f64 = 1e9;

impl Table {
    /// A curve through `values` at the knots `at`.
    ///
    /// # Errors
    /// [`InvalidField`] names `at`, `values` or `period`: no or too many knots, lists of different lengths, NaN or a
    /// number beyond 1e9, knots that do not increase (two may be at one place), or a period that is not longer than
    /// their span.
    pub fn new(over: Over, on: On, period: Option<f64>, at: Vec<f64>, values: Vec<f64>) -> Result<Self, InvalidField> {
        let fault = |field: &str, problem| Err(InvalidField { field: field.into(), problem });
        if at.is_empty() || at.len() > MAX_CORNERS {
            return fault("at", Problem::Corners { corners: at.len(), most: MAX_CORNERS });
        }
        if values.len() != at.len() {
            return fault("values", Problem::Lengths { corners: at.len(), values: values.len() });
        }
        for (field, numbers) in [("at", &at), ("values", &values)] {
            if let Some(&value) = numbers.iter().find(|number| !(-LARGEST..=LARGEST).contains(*number)) {
                return fault(field, Problem::OutOfRange { value, lower: -LARGEST, upper: LARGEST, unit: "1" });
            }
        }
        let falls = at.windows(2).position(|pair| pair[1] < pair[0]).map(|index| index + 1);
        let three = at.windows(3).position(|three| three[0] == three[2]).map(|index| index + 2);
        if let Some(corner) = falls.or(three) {
            return fault("at", Problem::NotIncreasing { corner });
        }
        let span = at[at.len() - 1] - at[0];
        match period {
            Some(period) if !(period > span && period <= LARGEST) => {
                fault("period", Problem::OutOfRange { value: period, lower: span, upper: LARGEST, unit: "1" })
            }
            _ => Ok(Self { over, on, period, at, values }),
        }
    }

    /// Quantity on the abscissa.
    #[must_use]
    pub fn over(&self) -> Over {
        self.over
    }

    /// Quantity that the values act on.
    #[must_use]
    pub fn on(&self) -> On {
        self.on
    }

    /// Period of the abscissa; `None` if the curve is not periodic.
    #[must_use]
    pub fn period(&self) -> Option<f64> {
        self.period
    }

    /// Knots of the curve, not decreasing.
    #[must_use]
    pub fn at(&self) -> &[f64] {
        &self.at
    }

    /// Values at the knots.
    #[must_use]
    pub fn values(&self) -> &[f64] {
        &self.values
    }

    /// Value at `x`; at a jump, that on its upper side.
    #[must_use]
    pub fn value(&self, x: f64) -> f64 {
        self.between(x, |at, x| at <= x)
    }

    /// Value at `x`; at a jump, that on its lower side.
    fn value_below(&self, x: f64) -> f64 {
        self.between(x, |at, x| at < x)
    }

    fn between(&self, x: f64, is_passed: impl Fn(f64, f64) -> bool) -> f64 {
        let last = self.at.len() - 1;
        let first_at = self.at[0];
        let x = match self.period {
            Some(period) => {
                let ahead = x - first_at;
                first_at + (ahead - period * libm::floor(ahead / period))
            }
            None => x,
        };
        let passed = self.at.partition_point(|&at| is_passed(at, x));
        let line = |x0: f64, y0: f64, x1: f64, y1: f64| y0 + (y1 - y0) * ((x - x0) / (x1 - x0)).clamp(0.0, 1.0);
        match (passed, self.period) {
            (0, None) => self.values[0],
            (passed, None) if passed > last => self.values[last],
            (passed, Some(period)) if passed == 0 || passed > last => {
                let x = if passed == 0 { x + period } else { x };
                let (x0, y0) = (self.at[last], self.values[last]);
                y0 + (self.values[0] - y0) * ((x - x0) / (first_at + period - x0)).clamp(0.0, 1.0)
            }
            (passed, _) => line(self.at[passed - 1], self.values[passed - 1], self.at[passed], self.values[passed]),
        }
    }
}

/// A force over speed, split into a part that drives and a part that opposes motion.
#[derive(Clone, Debug)]
pub(crate) struct SpeedForce {
    table: Table,
    /// Driving force at rest, N m or N.
    at_rest: f64,
}

impl SpeedForce {
    /// Splits a table of a force over speed.
    pub(crate) fn new(table: &Table) -> Self {
        let (below, above) = (table.value_below(0.0), table.value(0.0));
        // common part of both sides of speed 0; the remainder holds like friction
        let at_rest = if below * above <= 0.0 { 0.0 } else { below.abs().min(above.abs()).copysign(above) };
        Self { table: table.clone(), at_rest }
    }

    fn moving(&self, direction: Direction, speed: f64) -> f64 {
        let value = match direction {
            Direction::Forward => self.table.value(speed),
            Direction::Backward => self.table.value_below(-speed),
        };
        value - self.at_rest
    }

    /// Force against motion in `direction` at an unsigned speed; not negative.
    pub(crate) fn against(&self, direction: Direction, speed: f64) -> f64 {
        (-direction.sign() * self.moving(direction, speed)).max(0.0)
    }

    /// Remaining force towards positive positions at a signed speed.
    pub(crate) fn push(&self, speed: f64) -> f64 {
        if speed == 0.0 {
            return self.at_rest;
        }
        let direction = Direction::of(speed);
        self.at_rest + direction.sign() * (direction.sign() * self.moving(direction, speed.abs())).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table(over: Over, period: Option<f64>, at: &[f64], values: &[f64]) -> Table {
        Table::new(over, On::Force, period, at.to_vec(), values.to_vec()).unwrap()
    }

    #[test]
    fn a_curve_is_straight_between_corners_and_constant_beyond_them() {
        let curve = table(Over::Position, None, &[0.0, 1.0, 3.0], &[1.0, 3.0, -1.0]);
        for (x, y) in [(-5.0, 1.0), (0.0, 1.0), (0.5, 2.0), (1.0, 3.0), (2.5, 0.0), (3.0, -1.0), (9.0, -1.0)] {
            assert_eq!(curve.value(x), y, "{x}");
        }
        assert_eq!(table(Over::Time, None, &[2.0], &[7.0]).value(0.0), 7.0);
    }

    #[test]
    fn a_circle_goes_on_from_its_last_corner_to_its_first() {
        let curve = table(Over::Position, Some(4.0), &[0.0, 1.0, 3.0], &[1.0, 3.0, -1.0]);
        for (x, y) in [(3.5, 0.0), (4.0, 1.0), (4.5, 2.0), (-0.5, 0.0), (-3.0, 3.0), (41.0, 3.0)] {
            assert_eq!(curve.value(x), y, "{x}");
        }
        assert_eq!(table(Over::Position, Some(1.0), &[0.25], &[7.0]).value(0.1), 7.0);
    }

    #[test]
    fn a_jump_is_friction_where_it_is_against_motion_and_a_push_where_it_is_not() {
        // dry friction of 2 backwards and 1 forwards, the latter falling with speed, and a driving force from 3 rad/s
        // on
        let force =
            SpeedForce::new(&table(Over::Speed, None, &[-1.0, 0.0, 0.0, 2.0, 4.0], &[2.0, 2.0, -1.0, -1.0, 1.0]));
        assert_eq!([force.against(Direction::Forward, 0.0), force.against(Direction::Backward, 0.0)], [1.0, 2.0]);
        assert_eq!([force.against(Direction::Forward, 2.0), force.against(Direction::Forward, 4.0)], [1.0, 0.0]);
        assert_eq!([0.0, 2.0, 4.0, -1.0].map(|speed| force.push(speed)), [0.0, 0.0, 1.0, 0.0]);
        // a weight, and friction of 1 around it
        let force = SpeedForce::new(&table(Over::Speed, None, &[0.0, 0.0], &[-1.0, -3.0]));
        assert_eq!([0.0, 1.0, -1.0].map(|speed| force.push(speed)), [-1.0, -1.0, -1.0]);
        assert_eq!([force.against(Direction::Forward, 0.0), force.against(Direction::Backward, 0.0)], [2.0, 0.0]);
    }

    #[test]
    fn a_bad_table_is_refused() {
        let new = |period, at: &[f64], values: &[f64]| {
            Table::new(Over::Time, On::Input, period, at.to_vec(), values.to_vec()).unwrap_err().to_string()
        };
        for (period, at, values, expected) in [
            (None, &[][..], &[][..], "at: 0 corners; write 1 to 4096"),
            (None, &[0.0, 1.0], &[0.0], "values: 1 of them for 2 corners; write one for each in at"),
            (None, &[0.0, f64::NAN], &[0.0, 0.0], "at: NaN is outside"),
            (None, &[0.0, 1.0], &[0.0, f64::INFINITY], "values: inf is outside"),
            (None, &[0.0, 2.0, 1.0], &[0.0; 3], "at: corner 2 is not above the one before"),
            (None, &[1.0, 1.0, 1.0], &[0.0; 3], "at: corner 2 is not above the one before"),
            (Some(1.0), &[0.0, 1.0], &[0.0; 2], "period: 1 is outside 1.0..="),
            (Some(f64::NAN), &[0.0], &[0.0], "period: NaN is outside"),
        ] {
            let message = new(period, at, values);
            assert!(message.starts_with(expected), "{message}\nexpected {expected}");
        }
    }
}
