//! Scale of a plant's quantities: effects are sampled in proportion to it.

use r4_plants::{Drive, Effect, Model, Plant, PlantKind, PlantSpec, effect::friction::CoulombFriction};

/// Friction level that no motor overcomes, N m or N.
const BLOCKED: f64 = 1e6;
/// Time step of the test runs, s.
const STEP_S: f64 = 5e-3;

/// Scale of a plant with its own effects, before anything is hidden in it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Scale {
    pub(crate) kind: PlantKind,
    pub(crate) supply_v: f64,
    /// Resistance of the cold winding, Ω.
    pub(crate) resistance_ohm: f64,
    /// Speed of the output at full duty, rad/s or m/s.
    pub(crate) speed: f64,
    /// Torque or force of the motor at the output when blocked at full duty, screw losses subtracted; N m or N.
    pub(crate) force: f64,
    /// Power lost in the winding in that state, W.
    pub(crate) power_w: f64,
    /// Duty from which on the plant moves.
    pub(crate) threshold: f64,
    /// Distance that it travels in about a second, rad or m: a length for effects that depend on position.
    pub(crate) way: f64,
    /// Middle of its position range.
    pub(crate) centre: f64,
}

impl Scale {
    /// Measures the scale of a plant.
    pub(crate) fn of(spec: &PlantSpec, supply_v: f64) -> Self {
        let (resistance_ohm, force_per_a, centre, stroke) = match spec.model() {
            Model::DcGearMotor(motor) => {
                (motor.resistance_ohm, motor.gear_ratio * motor.torque_constant_nm_per_a, 0.0, f64::INFINITY)
            }
            Model::LinearActuator(rod) => {
                let per_m = std::f64::consts::TAU / rod.lead_m_per_rev;
                let force_per_a = per_m * rod.torque_constant_nm_per_a * rod.efficiency;
                (rod.resistance_ohm, force_per_a, 0.5 * rod.stroke_m, rod.stroke_m)
            }
        };
        let mut held = spec.clone();
        // This level is in range on every plant.
        let _ = held.push_effect(Effect::CoulombFriction(CoulombFriction { level: BLOCKED }));
        let mut held = Plant::new(&held, 0);
        held.advance(Drive::with_brake(1.0), supply_v, 1.0);
        let current_a = held.motor_current_a().abs();

        let mut free = Plant::new(spec, 0);
        free.set_position(centre);
        let mut speed = 0.0f64;
        for _ in 0..400 {
            free.advance(Drive::with_brake(1.0), supply_v, STEP_S);
            speed = speed.max(free.speed().abs());
        }
        // A new plant for each duty: static friction counts only from rest.
        let threshold = (1..20).map(|step| 0.05 * f64::from(step)).find(|&duty| {
            let mut plant = Plant::new(spec, 0);
            plant.set_position(centre);
            plant.advance(Drive::with_brake(duty), supply_v, 0.4);
            plant.speed().abs() > 0.02 * speed
        });
        Self {
            kind: spec.kind(),
            supply_v,
            resistance_ohm,
            speed: speed.max(1e-6),
            force: (force_per_a * current_a).max(1e-6),
            power_w: current_a * current_a * resistance_ohm,
            // One step back: the last duty at which it did not move.
            threshold: threshold.unwrap_or(0.9) - 0.05,
            way: match spec.kind() {
                PlantKind::Rotary => std::f64::consts::TAU,
                PlantKind::Linear => speed.min(0.3 * stroke).max(1e-6),
            },
            centre,
        }
    }
}
