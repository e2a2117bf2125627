use super::*;
use crate::effect::{
    friction::{CoulombFriction, DirectionFriction, StaticFriction},
    load::{ConstantLoad, GravityLoad},
};

const COULOMB: Effect = Effect::CoulombFriction(CoulombFriction { level: 0.5 });

#[test]
fn a_plant_below_static_friction_does_not_move_by_a_bit() {
    let sticking = Effect::StaticFriction(StaticFriction { level: 0.25, stribeck: 0.1 });
    let mut plant = motor(MOTOR, &[COULOMB, sticking]);
    plant.set_position(0.1);
    // 0.74 of 0.75 N m: 0.74 A through 1 ohm
    for _ in 0..10_000 {
        plant.advance(Drive::with_brake(0.0740), 10.0, 1e-3);
        assert_eq!((plant.speed(), plant.position()), (0.0, 0.1));
    }
    assert_close(plant.motor_current_a(), 0.74, 1e-12, "current at rest");
    plant.advance(Drive::with_brake(0.0760), 10.0, 20e-3);
    assert!(plant.speed() > 0.0, "{}", plant.speed());
}

#[test]
fn a_held_weight_stays_and_a_heavier_one_falls() {
    let weight = |force| [COULOMB, Effect::ConstantLoad(ConstantLoad { force })];
    let mut held = motor(MOTOR, &weight(0.49));
    run(&mut held, Drive::COAST, 24.0, 10_000);
    assert_eq!((held.position(), held.speed()), (0.0, 0.0));
    let mut falling = motor(MOTOR, &weight(0.6));
    run(&mut falling, Drive::COAST, 24.0, 500);
    // 0.1 N m on 0.02 kg m² for 0.5 s, no current: exact
    assert_close(falling.speed(), -2.5, 1e-12, "speed");
    assert_close(falling.position(), -0.625, 1e-12, "position");
}

#[test]
fn coulomb_friction_stops_in_the_time_of_the_closed_form() {
    let mut plant = motor(MOTOR, &[COULOMB]);
    run(&mut plant, Drive::with_brake(0.25), 24.0, 500);
    plant.advance(Drive::COAST, 24.0, 1e-3); // the current is gone
    let (speed, position) = (plant.speed(), plant.position());
    // v J / T = 5.5 · 0.02 / 0.5 = 0.22 s, and v² J / (2 T)
    let stop_s = speed * 0.02 / 0.5;
    plant.advance(Drive::COAST, 24.0, stop_s - 1e-6);
    assert_close(plant.speed(), 0.5 / 0.02 * 1e-6, 1e-12, "just before");
    plant.advance(Drive::COAST, 24.0, 2e-6);
    assert_eq!(plant.speed(), 0.0);
    assert_close(plant.position() - position, speed * speed * 0.02 / (2.0 * 0.5), 1e-12, "way");
    let at = plant.position();
    run(&mut plant, Drive::COAST, 24.0, 1000);
    assert_eq!(plant.position(), at);
}

#[test]
fn friction_by_direction_costs_more_forwards() {
    let friction = Effect::DirectionFriction(DirectionFriction { forward: 1.0, backward: 0.25 });
    let settled = |duty| {
        let mut plant = motor(MOTOR, &[friction]);
        run(&mut plant, Drive::with_brake(duty), 24.0, 1000);
        plant.speed()
    };
    // R T / k² less than 12 V / k
    assert_close(settled(0.5), 11.0, 1e-12, "forwards");
    assert_close(settled(-0.5), -11.75, 1e-12, "backwards");
}

#[test]
fn a_frictionless_pendulum_keeps_its_energy_and_one_with_friction_stops_off_centre() {
    let pendulum = Effect::GravityLoad(GravityLoad { torque_nm: 2.0, phase_rad: 0.0 });
    let energy_j = |plant: &Plant| 0.5 * 0.02 * plant.speed().powi(2) + 2.0 * (1.0 - plant.position().cos());
    let mut free = motor(MOTOR, &[pendulum]);
    free.set_position(1.0);
    let start_j = energy_j(&free);
    run(&mut free, Drive::COAST, 24.0, 10_000);
    // 10 rad/s, so 2.5e-3 rad per step: the half-way rule keeps energy to its square, here per swing and back
    assert_close(energy_j(&free) / start_j, 1.0, 1e-3, "energy");
    let mut rubbing = motor(MOTOR, &[pendulum, COULOMB]);
    rubbing.set_position(1.0);
    run(&mut rubbing, Drive::COAST, 24.0, 10_000);
    assert_eq!(rubbing.speed(), 0.0);
    assert!((2.0 * rubbing.position().sin()).abs() <= 0.5, "{}", rubbing.position());
}
