//! Units from the names of columns.

use std::f64::consts::TAU;

use super::Quantity;

/// Unit of a column's numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Unit {
    /// Quantity that is measured.
    pub quantity: Quantity,
    /// SI value of one unit.
    pub factor: f64,
    /// True if the name states a unit; otherwise the column is a dimensionless number.
    pub stated: bool,
    /// True for encoder counts, or counts per second, whose number per turn is unknown.
    pub counts: bool,
}

const NUMBER: Unit = Unit { quantity: Quantity::Number, factor: 1.0, stated: false, counts: false };

/// Endings of names in lower case, each with the quantity and its SI value. `nm` is N m everywhere in this project.
const UNITS: &[(&str, Quantity, f64)] = &[
    ("rad", Quantity::Angle, 1.0),
    ("mrad", Quantity::Angle, 1e-3),
    ("deg", Quantity::Angle, TAU / 360.0),
    ("degrees", Quantity::Angle, TAU / 360.0),
    ("turn", Quantity::Angle, TAU),
    ("turns", Quantity::Angle, TAU),
    ("rev", Quantity::Angle, TAU),
    ("rad_s", Quantity::AngularSpeed, 1.0),
    ("mrad_s", Quantity::AngularSpeed, 1e-3),
    ("deg_s", Quantity::AngularSpeed, TAU / 360.0),
    ("dps", Quantity::AngularSpeed, TAU / 360.0),
    ("rev_s", Quantity::AngularSpeed, TAU),
    ("rpm", Quantity::AngularSpeed, TAU / 60.0),
    ("1_min", Quantity::AngularSpeed, TAU / 60.0),
    ("m", Quantity::Length, 1.0),
    ("cm", Quantity::Length, 1e-2),
    ("mm", Quantity::Length, 1e-3),
    ("um", Quantity::Length, 1e-6),
    ("m_s", Quantity::Speed, 1.0),
    ("cm_s", Quantity::Speed, 1e-2),
    ("mm_s", Quantity::Speed, 1e-3),
    ("mps", Quantity::Speed, 1.0),
    ("km_h", Quantity::Speed, 1.0 / 3.6),
    ("v", Quantity::Voltage, 1.0),
    ("mv", Quantity::Voltage, 1e-3),
    ("n", Quantity::Force, 1.0),
    ("kn", Quantity::Force, 1e3),
    ("nm", Quantity::Torque, 1.0),
    ("n_m", Quantity::Torque, 1.0),
    ("mnm", Quantity::Torque, 1e-3),
    ("a", Quantity::Current, 1.0),
    ("ma", Quantity::Current, 1e-3),
    ("c", Quantity::Temperature, 1.0),
    ("degc", Quantity::Temperature, 1.0),
    ("celsius", Quantity::Temperature, 1.0),
    ("pct", Quantity::Number, 1e-2),
    ("percent", Quantity::Number, 1e-2),
    ("permille", Quantity::Number, 1e-3),
    ("s", Quantity::Number, 1.0),
    ("ms", Quantity::Number, 1e-3),
    ("us", Quantity::Number, 1e-6),
    ("ns", Quantity::Number, 1e-9),
];

/// Endings of names in encoder counts.
const COUNTS: [&str; 5] = ["cnt", "count", "counts", "tick", "ticks"];

/// Returns the unit of a column, from the end of its name (`speed_rad_s`) or from brackets (`speed [rad/s]`).
///
/// Counts become angles if `counts_per_turn` is known. `duty256` is a duty in parts of 256.
#[must_use]
pub fn unit(column: &str, counts_per_turn: Option<f64>) -> Unit {
    let column = column.trim();
    if let Some(inside) = bracketed(column) {
        return of_ending(&plain(inside), counts_per_turn).unwrap_or(NUMBER);
    }
    let words: Vec<String> =
        column.split(|c: char| !c.is_alphanumeric()).filter(|word| !word.is_empty()).map(str::to_lowercase).collect();
    let ending =
        |from: usize| words[from..].iter().filter(|word| *word != "per").cloned().collect::<Vec<_>>().join("_");
    // The longest ending first: `rad_s` also ends in `s`.
    for length in [3, 2, 1] {
        let Some(from) = words.len().checked_sub(length) else { continue };
        let ending = ending(from);
        // A name of a single letter is no unit: `v` is as often a speed as a voltage.
        if from == 0 && ending.len() < 2 {
            continue;
        }
        if let Some(found) = of_ending(&ending, counts_per_turn) {
            return found;
        }
    }
    NUMBER
}

/// Returns the text in brackets at the end of a name.
fn bracketed(column: &str) -> Option<&str> {
    let (open, inside) = match column.chars().last()? {
        ']' => ('[', column.strip_suffix(']')?),
        ')' => ('(', column.strip_suffix(')')?),
        _ => return None,
    };
    let at = inside.rfind(open)?;
    (at > 0).then(|| inside[at + open.len_utf8()..].trim())
}

/// Returns a unit as an ending of names: `rad/s` as `rad_s`, `N m` as `nm`, `°/s` as `deg_s`.
fn plain(unit: &str) -> String {
    let mut plain = String::new();
    for c in unit.chars() {
        match c {
            '/' => plain.push('_'),
            '°' => plain.push_str("deg"),
            '%' => plain.push_str("pct"),
            '‰' => plain.push_str("permille"),
            'µ' | 'μ' => plain.push('u'),
            c if c.is_whitespace() || matches!(c, '·' | '*' | '.') => {}
            c => plain.extend(c.to_lowercase()),
        }
    }
    plain
}

fn of_ending(ending: &str, counts_per_turn: Option<f64>) -> Option<Unit> {
    if let Some(&(_, quantity, factor)) = UNITS.iter().find(|(name, ..)| *name == ending) {
        return Some(Unit { quantity, factor, stated: true, counts: false });
    }
    let per_second = ending.strip_suffix("_s");
    if COUNTS.contains(&per_second.unwrap_or(ending)) {
        let quantity = if per_second.is_some() { Quantity::AngularSpeed } else { Quantity::Angle };
        return Some(match counts_per_turn {
            Some(counts) => Unit { quantity, factor: TAU / counts, stated: true, counts: false },
            None => Unit { quantity: Quantity::Number, factor: 1.0, stated: true, counts: true },
        });
    }
    let parts: u32 = ending.strip_prefix("duty")?.parse().ok()?;
    (parts > 0).then(|| Unit {
        quantity: Quantity::Number,
        factor: 1.0 / f64::from(parts),
        stated: true,
        counts: false,
    })
}

/// Returns the seconds in one unit of a time column; `None` if its name has no unit of time.
pub(super) fn seconds(column: &str) -> Option<f64> {
    let column = column.trim().to_lowercase();
    let ending = match bracketed(&column) {
        Some(inside) => plain(inside),
        None => {
            column.rsplit(|c: char| !c.is_alphanumeric()).next().filter(|word| word.len() < column.len())?.to_owned()
        }
    };
    match ending.as_str() {
        "s" | "sec" | "secs" | "seconds" => Some(1.0),
        "ms" | "millis" => Some(1e-3),
        "us" | "micros" => Some(1e-6),
        "ns" | "nanos" => Some(1e-9),
        "min" => Some(60.0),
        _ => None,
    }
}

/// Returns whether the name of a column, without its unit, means time.
pub(super) fn is_time(column: &str) -> bool {
    let column = column.trim().to_lowercase();
    let bare = match column.find(['[', '(']) {
        Some(at) => column[..at].trim_end(),
        None if seconds(&column).is_some() => {
            column.rsplit_once(|c: char| !c.is_alphanumeric()).map_or("", |(name, _)| name)
        }
        None => &column,
    };
    matches!(bare.trim_end_matches('_'), "t" | "time" | "timestamp" | "stamp" | "elapsed")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_end_of_a_name_is_its_unit() {
        let cases = [
            ("theta_rad", Quantity::Angle, 1.0),
            ("theta_deg", Quantity::Angle, std::f64::consts::PI / 180.0),
            ("wheel_left_rad_s", Quantity::AngularSpeed, 1.0),
            ("gyro_z_deg_per_s", Quantity::AngularSpeed, std::f64::consts::PI / 180.0),
            ("left_rpm", Quantity::AngularSpeed, std::f64::consts::PI / 30.0),
            ("rpm", Quantity::AngularSpeed, std::f64::consts::PI / 30.0),
            ("x_m", Quantity::Length, 1.0),
            ("x_mm", Quantity::Length, 1e-3),
            ("v_mm_s", Quantity::Speed, 1e-3),
            ("u_V", Quantity::Voltage, 1.0),
            ("battery_mV", Quantity::Voltage, 1e-3),
            ("load_N", Quantity::Force, 1.0),
            ("torque_nm", Quantity::Torque, 1.0),
            ("motor_A", Quantity::Current, 1.0),
            ("temp_C", Quantity::Temperature, 1.0),
            ("load_permille", Quantity::Number, 1e-3),
            ("duty_pct", Quantity::Number, 1e-2),
            ("command_duty256", Quantity::Number, 1.0 / 256.0),
            ("osmc0.position_rad", Quantity::Angle, 1.0),
            ("speed [rad/s]", Quantity::AngularSpeed, 1.0),
            ("angle (°)", Quantity::Angle, std::f64::consts::PI / 180.0),
            ("torque [N m]", Quantity::Torque, 1.0),
        ];
        for (column, quantity, factor) in cases {
            let found = unit(column, None);
            assert!(found.stated, "{column}");
            assert_eq!(found.quantity, quantity, "{column}");
            // The product is rounded twice.
            assert!((found.factor / factor - 1.0).abs() < 1e-15, "{column}: {}", found.factor);
        }
    }

    #[test]
    fn a_name_without_a_unit_is_a_plain_number() {
        for column in ["duty", "v", "theta", "left_mode", "kp", "", "_", "speed [furlong]", "]", "[]", "duty0"] {
            assert_eq!(unit(column, None), NUMBER, "{column}");
        }
    }

    #[test]
    fn counts_are_angles_once_a_turn_is_known() {
        assert!(unit("dut_pos_cnt", None).counts);
        let position = unit("dut_pos_cnt", Some(4096.0));
        assert_eq!((position.quantity, position.factor), (Quantity::Angle, TAU / 4096.0));
        assert_eq!(unit("dut_speed_cnt_s", Some(4096.0)).quantity, Quantity::AngularSpeed);
    }

    #[test]
    fn time_is_found_with_and_without_a_unit() {
        for (column, factor) in [
            ("t_s", Some(1.0)),
            ("time_ms", Some(1e-3)),
            ("Time [us]", Some(1e-6)),
            ("timestamp_ns", Some(1e-9)),
            ("time", None),
            ("t", None),
        ] {
            assert!(is_time(column), "{column}");
            assert_eq!(seconds(column), factor, "{column}");
        }
        for column in ["theta_s", "settling_time_s", "x", "", "s"] {
            assert!(!is_time(column), "{column}");
        }
    }
}
