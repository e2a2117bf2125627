use super::*;
use crate::effect::supply::SupplySag;

fn spinning() -> Plant {
    let mut plant = motor(DcGearMotor { viscous_nm_s_per_rad: 0.02, ..MOTOR }, &[]);
    run(&mut plant, Drive::with_brake(0.5), 24.0, 300);
    plant
}

#[test]
fn a_coasting_motor_loses_its_current_and_then_only_viscous_friction_brakes() {
    for supply_v in [24.0, 0.0] {
        let mut plant = spinning();
        let before = plant.speed();
        // 0.24 A against 24 V decay in 10 us; against the back-EMF of a dead supply in 20 us
        plant.advance(Drive::COAST, supply_v, 1e-3);
        assert_eq!(plant.motor_current_a(), 0.0);
        run(&mut plant, Drive::COAST, supply_v, 999);
        assert_eq!(plant.motor_current_a(), 0.0);
        assert_eq!(plant.supply_current_a(), 0.0);
        // B/J = 1/s. The current still gives its charge L i²/(2 V) ~ 1e-6 A s / 0.02 kg m²: at most 1e-4 rad/s
        assert_close(plant.speed(), before * (-1.0f64).exp(), 1e-4, "speed after 1 s");
    }
}

#[test]
fn a_large_current_is_driven_back_into_the_supply() {
    // stalled by its inertia: 20 A in 5 mH after the terminals open
    let model = DcGearMotor { inductance_h: 5e-3, inertia_kg_m2: 1e3, ..MOTOR };
    let mut plant = motor(model, &[]);
    run(&mut plant, Drive::with_brake(1.0), 24.0, 100);
    assert_close(plant.motor_current_a(), 24.0, 0.01, "stalled");
    // i(t) = (24 + 25.4) exp(-t / 5 ms) − 25.4, zero at 5 ms · ln(49.4 / 25.4) = 3.33 ms
    plant.advance(Drive::COAST, 24.0, 2e-3);
    assert_close(plant.motor_current_a(), 49.4 * (-0.4f64).exp() - 25.4, 0.01, "decaying"); // 1/1000 kg m² of motion
    assert_eq!(plant.supply_current_a(), -plant.motor_current_a());
    plant.advance(Drive::COAST, 24.0, 1.4e-3);
    assert_eq!(plant.motor_current_a(), 0.0);
}

#[test]
fn brake_stops_faster_than_coast() {
    let [mut braked, mut coasting] = [spinning(), spinning()];
    let before = braked.speed();
    run(&mut braked, Drive::BRAKE, 24.0, 20);
    run(&mut coasting, Drive::COAST, 24.0, 20);
    // brake: one time constant of 20 ms, delayed by the electrical 1 ms
    assert!(braked.speed() < 0.42 * before && braked.speed() > 0.33 * before, "{}", braked.speed());
    assert!(coasting.speed() > 0.97 * before, "{}", coasting.speed());
}

#[test]
fn fast_decay_gives_less_than_slow_decay() {
    let held = DcGearMotor { inertia_kg_m2: 1e3, ..MOTOR };
    let [mut slow, mut fast] = [motor(held, &[]), motor(held, &[])];
    run(&mut slow, Drive::with_brake(0.75), 24.0, 20);
    run(&mut fast, Drive::with_coast(0.75), 24.0, 20);
    // 0.75 · 24 V against 0.75 · 24 V − 0.25 · (24 V + 2 · 0.7 V) over 1 ohm; 1000 kg m² hardly move
    assert_close(slow.motor_current_a(), 18.0, 0.01, "slow decay");
    assert_close(fast.motor_current_a(), 18.0 - 0.25 * 25.4, 0.01, "fast decay");
    assert_close(fast.supply_current_a(), 0.5 * fast.motor_current_a(), 1e-12, "supply");
}

#[test]
fn supply_sag_acts_as_duty_squared_times_its_resistance() {
    let sag = SupplySag { source_ohm: 0.5 };
    let held = DcGearMotor { inertia_kg_m2: 1e6, ..MOTOR };
    let mut plant = motor(held, &[Effect::SupplySag(sag)]);
    run(&mut plant, Drive::with_brake(0.5), 24.0, 50);
    // i = 0.5 V / R with V = 24 − 0.5 · (0.5 i); 50 electrical time constants, and 1e6 kg m² do not move
    let current_a = plant.motor_current_a();
    assert_close(current_a, 12.0 / 1.125, 1e-5, "current");
    assert_eq!(plant.supply_current_a(), 0.5 * current_a);
    assert_close(0.5 * sag.apply(24.0, plant.supply_current_a()), current_a, 1e-5, "Ohm's law at the terminals");
}
