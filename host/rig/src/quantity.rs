//! Numbers with units, as users type and read them.

use std::{f64::consts::TAU, fmt, str::FromStr};

use r4_protocol::Unit;

/// A number in SI units, with its unit for printing: that in which it was typed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Quantity {
    /// Value in SI units.
    pub value: f64,
    /// SI unit of the value.
    pub unit: Unit,
    /// Unit in which it is printed.
    pub shown: Shown,
}

/// Unit and precision of a printed quantity.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Shown {
    /// Factor from SI to the printed unit.
    per_si: f64,
    name: &'static str,
    decimals: usize,
}

/// Known units: name, SI unit, SI units in one of it, and decimals that show the board's resolution.
const UNITS: [(&str, Unit, f64, usize); 19] = [
    ("deg/s", Unit::RadPerS, TAU / 360.0, 1),
    ("rad/s", Unit::RadPerS, 1.0, 3),
    ("rpm", Unit::RadPerS, TAU / 60.0, 2),
    ("mm/s", Unit::MPerS, 1e-3, 2),
    ("m/s", Unit::MPerS, 1.0, 5),
    ("deg", Unit::Rad, TAU / 360.0, 2),
    ("°", Unit::Rad, TAU / 360.0, 2),
    ("rad", Unit::Rad, 1.0, 4),
    ("turns", Unit::Rad, TAU, 4),
    ("turn", Unit::Rad, TAU, 4),
    ("mm", Unit::M, 1e-3, 2),
    ("cm", Unit::M, 1e-2, 3),
    ("m", Unit::M, 1.0, 5),
    ("mV", Unit::V, 1e-3, 0),
    ("V", Unit::V, 1.0, 2),
    ("mN", Unit::N, 1e-3, 0),
    ("N", Unit::N, 1.0, 2),
    // A share is printed without a unit, also when it was typed in %.
    ("%", Unit::Duty, 1e-2, 3),
    ("", Unit::Duty, 1.0, 3),
];

impl FromStr for Quantity {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let text = text.trim();
        // The unit is everything after the last digit or point.
        let split = text.rfind(|c: char| c.is_ascii_digit() || c == '.').map_or(0, |last| last + 1);
        let (number, unit) = text.split_at(split);
        let (name, unit, factor, decimals) =
            UNITS.into_iter().find(|(name, ..)| *name == unit.trim()).ok_or_else(|| {
                let known: Vec<_> = UNITS.iter().map(|(name, ..)| *name).filter(|name| !name.is_empty()).collect();
                format!("write a number and its unit without a space, as in 90deg; units are {}", known.join(" "))
            })?;
        match number.trim().parse::<f64>() {
            Ok(value) if value.is_finite() && unit == Unit::Duty => Ok(Self::new(value * factor, unit)),
            Ok(value) if value.is_finite() => {
                Ok(Self { value: value * factor, unit, shown: Shown { per_si: 1.0 / factor, name, decimals } })
            }
            _ => Err(format!("`{number}` is not a number")),
        }
    }
}

impl Quantity {
    /// Creates a quantity that is printed in the unit customary for users.
    #[must_use]
    pub fn new(value: f64, unit: Unit) -> Self {
        let (per_si, name, decimals) = human(unit);
        Self { value, unit, shown: Shown { per_si, name, decimals } }
    }

    /// Creates a quantity of `value` in `unit`, printed like this one where the SI unit agrees.
    #[must_use]
    pub fn like(self, value: f64, unit: Unit) -> Self {
        if unit == self.unit { Self { value, ..self } } else { Self::new(value, unit) }
    }

    /// Formats the number without its unit.
    #[must_use]
    pub fn number(self) -> String {
        let Shown { per_si, decimals, .. } = self.shown;
        let number = format!("{:.decimals$}", self.value * per_si);
        // A value that rounds to zero is printed without a sign.
        let is_zero = !number.contains(|digit: char| ('1'..='9').contains(&digit));
        if is_zero { number.trim_start_matches('-').to_owned() } else { number }
    }
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self.shown.name {
            "" => f.write_str(&self.number()),
            unit => write!(f, "{} {unit}", self.number()),
        }
    }
}

/// Unit customary for users: factor from SI, symbol, and decimals that show the board's resolution.
#[must_use]
pub fn human(unit: Unit) -> (f64, &'static str, usize) {
    match unit {
        Unit::Rad => (360.0 / TAU, "deg", 2),
        Unit::RadPerS => (360.0 / TAU, "deg/s", 1),
        Unit::M => (1e3, "mm", 2),
        Unit::MPerS => (1e3, "mm/s", 2),
        Unit::Duty => (1.0, "", 3),
        Unit::V => (1.0, "V", 2),
        Unit::Bool => (1.0, "", 0),
        Unit::MPerS2 => (1.0, "m/s2", 3),
        Unit::A => (1.0, "A", 3),
        Unit::N => (1.0, "N", 2),
    }
}

/// Unit of a motor's speed, from the unit of its position.
#[must_use]
pub fn speed_unit(position: Unit) -> Unit {
    if position == Unit::M { Unit::MPerS } else { Unit::RadPerS }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn people_and_si() {
        for (text, value, unit) in [
            ("90deg", TAU / 4.0, Unit::Rad),
            ("-0.5turn", -TAU / 2.0, Unit::Rad),
            ("60rpm", TAU, Unit::RadPerS),
            ("25mm", 0.025, Unit::M),
            ("10 mm/s", 0.01, Unit::MPerS),
            ("-30%", -0.3, Unit::Duty),
            (".5", 0.5, Unit::Duty),
            ("1e-2m", 0.01, Unit::M),
            ("1200mV", 1.2, Unit::V),
        ] {
            let read: Quantity = text.parse().unwrap();
            // One rounding of the product.
            assert!((read.value - value).abs() < 1e-15 && read.unit == unit, "{text}: {read:?}");
        }
        for bad in ["", "deg", "12parsec", "1,5mm", "nan", "inf", "--3", "1e999rad"] {
            assert!(bad.parse::<Quantity>().is_err(), "{bad}");
        }
    }

    #[test]
    fn what_was_typed_is_what_is_printed() {
        for (typed, printed) in [
            ("60rpm", "60.00 rpm"),
            ("1.5rad/s", "1.500 rad/s"),
            ("90deg", "90.00 deg"),
            ("-0.25turns", "-0.2500 turns"),
            ("2cm", "2.000 cm"),
            ("1200mV", "1200 mV"),
            ("30%", "0.300"),
        ] {
            let quantity: Quantity = typed.parse().unwrap();
            assert_eq!(quantity.to_string(), printed);
        }
        let typed: Quantity = "60rpm".parse().unwrap();
        assert_eq!(typed.like(TAU / 60.0, Unit::RadPerS).to_string(), "1.00 rpm");
        assert_eq!(typed.like(TAU / 4.0, Unit::Rad).to_string(), "90.00 deg");
    }

    #[test]
    fn shown_millimetres_are_not_truncated() {
        let shown = |value| Quantity::new(value, Unit::M).to_string();
        assert_eq!(shown(0.02499), "24.99 mm");
        assert_eq!(shown(0.009_996), "10.00 mm");
        assert_eq!(shown(-0.000_001), "0.00 mm");
    }
}
