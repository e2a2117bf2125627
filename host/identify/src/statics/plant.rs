//! Plant files of static models: plants that settle at the values of a map, for a simulated board.
//!
//! The plant is a motor whose full duty gives the largest output of the map, with a table on its input that bends the
//! straight line into the map. An output that is a position settles against a spring. A map does not contain the
//! settling time, which is assumed to be [`SETTLES_S`].

use std::fmt::Write;

use r4_plants::{
    DcGearMotor, Effect, InvalidField, LinearActuator, Model, PlantKind, PlantSpec, Table,
    effect::{
        backlash::Backlash,
        table::{On, Over},
    },
};

/// Assumed time constant of a plant of which only the steady state is known, s.
const SETTLES_S: f64 = 0.05;
/// Assumed supply if none was recorded, V.
const ASSUMED_V: f64 = 12.0;
/// Assumed winding resistance of a motor of which only the output is known, Ω.
const ASSUMED_OHM: f64 = 1.0;
/// Number of pieces of the table on each side of zero: a parabola over the whole range is off by 1/2000 of it.
const PIECES: u32 = 32;
/// Assumed screw lead of a rod of which only the output is known, m per revolution.
const ASSUMED_LEAD_M: f64 = 0.01;

/// Map from an input level to the steady output.
pub(super) struct SettlingMap<'m> {
    /// Unit of the output.
    pub(super) unit: &'m str,
    /// Origin of the numbers.
    pub(super) source: &'m str,
    /// Level that full duty stands for; above 0.
    pub(super) full: f64,
    /// Lowest and highest level in the recording.
    pub(super) seen: [f64; 2],
    /// Supply at which the map holds, V; `None` if it was not recorded.
    pub(super) supply_v: Option<f64>,
    /// Steady output at a level.
    pub(super) settles_at: &'m dyn Fn(f64) -> f64,
    /// Findings that the map does not contain.
    pub(super) left_out: Vec<String>,
}

/// Kind of quantity that settles.
#[derive(Clone, Copy, PartialEq)]
enum Settles {
    Speed,
    Place,
}

/// Returns whether an output in this unit turns or slides, and whether it is a speed or a position; `None` for
/// others.
fn motion(unit: &str) -> Option<(PlantKind, Settles)> {
    Some(match unit {
        "rad/s" => (PlantKind::Rotary, Settles::Speed),
        "rad" => (PlantKind::Rotary, Settles::Place),
        "m/s" => (PlantKind::Linear, Settles::Speed),
        "m" => (PlantKind::Linear, Settles::Place),
        _ => return None,
    })
}

/// Returns a motor with this force constant (N m/A or N/A) and this inertia or mass, both at the output.
fn motor(kind: PlantKind, constant: f64, inertia: f64) -> Model {
    match kind {
        PlantKind::Rotary => {
            // The torque constant stays in its allowed range; the gear ratio takes the rest.
            let gear_ratio = (constant / DcGearMotor::TYPICAL.torque_constant_nm_per_a).clamp(1e-3, 1e5);
            Model::DcGearMotor(DcGearMotor {
                resistance_ohm: ASSUMED_OHM,
                inductance_h: 0.0,
                gear_ratio,
                torque_constant_nm_per_a: constant / gear_ratio,
                inertia_kg_m2: inertia,
                viscous_nm_s_per_rad: 0.0,
            })
        }
        PlantKind::Linear => Model::LinearActuator(LinearActuator {
            resistance_ohm: ASSUMED_OHM,
            inductance_h: 0.0,
            lead_m_per_rev: ASSUMED_LEAD_M,
            torque_constant_nm_per_a: constant * ASSUMED_LEAD_M / std::f64::consts::TAU,
            efficiency: 1.0,
            rotor_inertia_kg_m2: 0.0,
            moving_mass_kg: inertia,
            viscous_n_s_per_m: 0.0,
            stroke_m: 100.0,
        }),
    }
}

impl SettlingMap<'_> {
    /// Returns the map's value at a level. Below the recorded levels it is linear to zero, above them constant. A map
    /// of one direction is mirrored. The value at level zero is 0, whatever the map says: a safe board must not move.
    fn within(&self, level: f64) -> f64 {
        let [low, high] = self.seen;
        if level == 0.0 {
            return 0.0;
        }
        let is_mirrored = (low >= 0.0 && level < 0.0) || (high <= 0.0 && level > 0.0);
        if is_mirrored {
            return -self.within(-level);
        }
        let (nearest, farthest) = if low * high < 0.0 { (0.0, level.abs()) } else { ends(low, high) };
        let size = level.abs();
        if size < nearest {
            return (self.settles_at)(nearest.copysign(level)) * size / nearest;
        }
        (self.settles_at)(size.min(farthest).copysign(level).clamp(low, high))
    }

    /// Returns the text of a plant file; if no plant can hold the map, a comment that says why.
    pub(super) fn plant_file(&self) -> String {
        let duties = (-i32::try_from(PIECES).unwrap_or(0)..=i32::try_from(PIECES).unwrap_or(0))
            .map(|piece| f64::from(piece) / f64::from(PIECES));
        let corners: Vec<(f64, f64)> = duties.map(|duty| (duty, self.within(duty * self.full))).collect();
        // Full duty reaches the largest output without the table.
        let top = corners.iter().map(|(_, settled)| settled.abs()).fold(0.0, f64::max);
        let mut text = String::new();
        // Writing to a `String` cannot fail, here and below.
        let mut say = |line: String| {
            let _ = writeln!(text, "# {line}");
        };
        let (kind, settles) = motion(self.unit).unwrap_or_else(|| {
            say(format!("A plant moves: each of the output's {} is 1 rad/s here.", self.unit));
            (PlantKind::Rotary, Settles::Speed)
        });
        say(format!("Duty 1 is the level {:?}; the levels {:?} were recorded.", self.full, self.seen));
        let supply_v = self.supply_v.unwrap_or(ASSUMED_V);
        let of_supply = if self.supply_v.is_some() { "recorded" } else { "assumed" };
        say(format!("It settles so at a supply of {supply_v:?} V ({of_supply}), and in proportion at others."));
        say(format!("Assumed: a winding of {ASSUMED_OHM} ohm, a time constant of {SETTLES_S} s."));
        if !self.left_out.is_empty() {
            say(format!("Found, but not in this file: {}.", self.left_out.join(", ")));
        }
        match self.plant(&corners, top, (kind, settles), supply_v) {
            Ok(spec) => text + &spec.to_toml(),
            Err(error) => {
                let _ = writeln!(text, "# No plant file can hold what was found: {error}.");
                text
            }
        }
    }

    fn plant(
        &self,
        corners: &[(f64, f64)],
        top: f64,
        (kind, settles): (PlantKind, Settles),
        supply_v: f64,
    ) -> Result<PlantSpec, InvalidField> {
        // A map of zeros becomes a motor that its table keeps at rest.
        let top = if top > 0.0 { top } else { 1.0 };
        let (constant, inertia, spring) = match settles {
            Settles::Speed => {
                let constant = supply_v / top;
                (constant, SETTLES_S * constant * constant / ASSUMED_OHM, None)
            }
            Settles::Place => {
                // Back-EMF damps with b = K² / R, and a spring k = K V / (R top) makes b / k the time constant. An
                // inertia of half the critical one leaves that time constant unchanged.
                let constant = SETTLES_S * supply_v / top;
                let (damping, spring) = (constant * constant / ASSUMED_OHM, constant * supply_v / (ASSUMED_OHM * top));
                (constant, damping * damping / (8.0 * spring), Some(spring))
            }
        };
        let mut spec = PlantSpec::new(motor(kind, constant, inertia), self.source, vec![])?;
        let (at, values) = corners.iter().map(|&(duty, settled)| (duty, settled / top - duty)).unzip();
        spec.push_table(Table::new(Over::Input, On::Input, None, at, values)?);
        if let Some(spring) = spring {
            let end = 10.0 * top;
            let (at, values) = (vec![-end, end], vec![spring * end, -spring * end]);
            spec.push_table(Table::new(Over::Position, On::Force, None, at, values)?);
        }
        Ok(spec)
    }
}

/// Returns the smallest and the largest magnitude of the levels of one side.
fn ends(low: f64, high: f64) -> (f64, f64) {
    (low.abs().min(high.abs()), low.abs().max(high.abs()))
}

/// Returns a typical motor with a backlash of `gap` in the unit of the output.
pub(super) fn with_play(unit: &str, gap: Option<f64>, source: &str, left_out: &[String]) -> String {
    let mut text = String::new();
    let (kind, _) = motion(unit).unwrap_or_else(|| {
        let _ = writeln!(text, "# A plant moves: each of the output's {unit} is 1 rad here.");
        (PlantKind::Rotary, Settles::Place)
    });
    let model = match kind {
        PlantKind::Rotary => Model::ALL[0],
        PlantKind::Linear => Model::ALL[1],
    };
    let _ = writeln!(
        text,
        "# A held shaft says nothing of the motor behind it: its parameters are typical ones, not fitted."
    );
    if !left_out.is_empty() {
        let _ = writeln!(text, "# Found, but not in this file: {}.", left_out.join(", "));
    }
    let effects = gap.map(|gap| Effect::Backlash(Backlash { gap })).into_iter().collect();
    match PlantSpec::new(model, source, effects) {
        Ok(spec) => text + &spec.to_toml(),
        Err(error) => {
            let _ = writeln!(text, "# No plant file can hold what was found: {error}.");
            text
        }
    }
}

#[cfg(test)]
mod tests {
    use r4_plants::{Drive, Plant};

    use super::*;

    /// Returns the position or speed of a plant after a long time at a duty.
    fn settled(spec: &PlantSpec, duty: f64, supply_v: f64, of_speed: bool) -> f64 {
        let mut plant = Plant::new(spec, 1);
        if of_speed {
            // A rod starts far from its end stops.
            plant.set_position(50.0);
        }
        // After 20 time constants the error is e^-20.
        plant.advance(Drive::with_brake(duty), supply_v, 20.0 * SETTLES_S);
        if of_speed { plant.speed() } else { plant.position() }
    }

    /// Map with a dead zone and a saturation, whose corners lie between those of the table.
    fn bent(level: f64) -> f64 {
        ((level.abs() - 20.0).max(0.0) / 10.0).min(15.0).copysign(level)
    }

    #[test]
    fn a_plant_of_a_map_settles_on_it() {
        for (unit, scale) in [("rad/s", 1.0), ("m/s", 0.01), ("rad", 0.1), ("m", 0.01), ("V", 1.0)] {
            let settles_at = |level: f64| bent(level) * scale;
            let map = SettlingMap {
                unit,
                source: "a test",
                full: 255.0,
                seen: [-255.0, 255.0],
                supply_v: (unit == "rad/s").then_some(7.4),
                settles_at: &settles_at,
                left_out: vec![],
            };
            let text = map.plant_file();
            let spec = PlantSpec::from_toml("map.toml", &text).unwrap_or_else(|error| panic!("{error}\n{text}"));
            let supply_v = map.supply_v.unwrap_or(ASSUMED_V);
            // A rod at one end stop can only be driven forwards.
            let lowest = if unit == "m" { 0 } else { -20 };
            for duty in (lowest..=20).map(|part| f64::from(part) / 20.0) {
                let of_speed = !matches!(unit, "rad" | "m");
                let (got, expected) = (settled(&spec, duty, supply_v, of_speed), settles_at(duty * 255.0));
                // Within a piece of the table the map bends by less than its slope, 0.1 per level, times half a piece
                // of 8 levels.
                let off = 0.4 * scale;
                assert!((got - expected).abs() <= off, "{unit} at {duty}: {got}, {expected}\n{text}");
            }
            let of_speed = !matches!(unit, "rad" | "m");
            assert_eq!(settled(&spec, 0.0, supply_v, of_speed), 0.0, "nothing moves at duty 0");
        }
    }

    #[test]
    fn a_map_of_one_side_holds_for_both_and_nothing_moves_at_zero() {
        let inverse = |level: f64| 100.0 / level;
        let map = SettlingMap {
            unit: "rad/s",
            source: "a test",
            full: 50.0,
            seen: [10.0, 50.0],
            supply_v: None,
            settles_at: &inverse,
            left_out: vec!["drift".into()],
        };
        let text = map.plant_file();
        assert!(text.contains("Found, but not in this file: drift."));
        let spec = PlantSpec::from_toml("map.toml", &text).unwrap();
        for (duty, expected) in [(1.0, 2.0), (0.5, 4.0), (-0.5, -4.0), (0.1, 5.0), (0.0, 0.0)] {
            let got = settled(&spec, duty, ASSUMED_V, true);
            // Points are 1.5625 levels apart; the largest curvature, 2 * 100 / 20³, makes an error of 0.008.
            assert!((got - expected).abs() < 0.02, "{duty}: {got}");
        }
    }

    #[test]
    fn play_is_in_the_file() {
        for (unit, kind) in [("rad", PlantKind::Rotary), ("m", PlantKind::Linear), ("1", PlantKind::Rotary)] {
            let text = with_play(unit, Some(0.01), "a test", &["drift".into()]);
            let spec = PlantSpec::from_toml("play.toml", &text).unwrap();
            assert_eq!(spec.effects(), [Effect::Backlash(Backlash { gap: 0.01 })]);
            assert_eq!(spec.kind(), kind);
        }
    }
}
