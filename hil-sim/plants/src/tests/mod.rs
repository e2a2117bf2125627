//! Whole plants against closed forms. The single effects' formulas are tested beside them.

mod actuator;
mod bridge;
mod effects;
mod files;
mod friction;
mod motor;

use crate::{Drive, Effect, Model, Plant, PlantSpec, model::DcGearMotor};

/// Motor with round numbers, overdamped: R/L = 1000/s, (N K)² / (R J) = 50/s.
const MOTOR: DcGearMotor = DcGearMotor {
    resistance_ohm: 1.0,
    inductance_h: 1e-3,
    torque_constant_nm_per_a: 0.04,
    gear_ratio: 25.0,
    inertia_kg_m2: 0.02,
    viscous_nm_s_per_rad: 0.0,
};

fn spec(model: Model, effects: &[Effect]) -> PlantSpec {
    PlantSpec::new(model, "a test", effects.to_vec()).unwrap()
}

fn motor(motor: DcGearMotor, effects: &[Effect]) -> Plant {
    Plant::new(&spec(Model::DcGearMotor(motor), effects), 1)
}

/// Advances in calls of 1 ms each.
fn run(plant: &mut Plant, drive: Drive, supply_v: f64, duration_ms: u32) {
    for _ in 0..duration_ms {
        plant.advance(drive, supply_v, 1e-3);
    }
}

fn assert_close(got: f64, expected: f64, tolerance: f64, what: &str) {
    assert!((got - expected).abs() <= tolerance, "{what}: {got}, expected {expected} within {tolerance}");
}
