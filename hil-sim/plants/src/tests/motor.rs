use super::*;
use crate::effect::{
    friction::{CoulombFriction, QuadraticDrag},
    load::{Cogging, ConstantLoad},
};

/// Closed-form speed and position after a step of `u` volts from rest, without friction: two real eigenvalues.
fn closed_form(motor: &DcGearMotor, u: f64, t: f64) -> (f64, f64) {
    let k = motor.gear_ratio * motor.torque_constant_nm_per_a;
    let (electrical, viscous) =
        (motor.resistance_ohm / motor.inductance_h, motor.viscous_nm_s_per_rad / motor.inertia_kg_m2);
    let half_trace = 0.5 * (electrical + viscous);
    let determinant = electrical * viscous + k * k / (motor.inductance_h * motor.inertia_kg_m2);
    let root = (half_trace * half_trace - determinant).sqrt();
    let (fast, slow) = (half_trace + root, determinant / (half_trace + root));
    let settled = u * k / (motor.inductance_h * motor.inertia_kg_m2) / determinant;
    let speed = settled * (1.0 - (fast * (-slow * t).exp() - slow * (-fast * t).exp()) / (fast - slow));
    let area = |rate: f64| (1.0 - (-rate * t).exp()) / rate;
    (speed, settled * (t - (fast * area(slow) - slow * area(fast)) / (fast - slow)))
}

#[test]
fn a_voltage_step_follows_the_closed_form() {
    let model = DcGearMotor { viscous_nm_s_per_rad: 0.1, ..MOTOR };
    let mut plant = motor(model, &[]);
    for ms in 1..=200 {
        plant.advance(Drive::with_brake(0.5), 24.0, 1e-3);
        let (speed, position) = closed_form(&model, 12.0, f64::from(ms) * 1e-3);
        // the step is exact; 800 of them add up their rounding
        assert_close(plant.speed(), speed, 1e-11, "speed");
        assert_close(plant.position(), position, 1e-12, "position");
    }
}

#[test]
fn an_oscillating_motor_conserves_what_the_resistance_does_not_take() {
    // L large, J small: complex eigenvalues. Energy from the supply = heat + kinetic + magnetic, by fine quadrature.
    let model = DcGearMotor { inductance_h: 0.05, inertia_kg_m2: 1e-3, ..MOTOR };
    let mut plant = motor(model, &[]);
    let (mut supplied_j, mut heat_j) = (0.0, 0.0);
    let (dt_s, mut before_a) = (1e-5, 0.0);
    for _ in 0..20_000 {
        plant.advance(Drive::with_brake(1.0), 12.0, dt_s);
        let after_a = plant.motor_current_a();
        let mean_square = (before_a * before_a + before_a * after_a + after_a * after_a) / 3.0;
        supplied_j += 12.0 * 0.5 * (before_a + after_a) * dt_s;
        heat_j += mean_square * dt_s;
        before_a = after_a;
    }
    let stored_j = 0.5 * 0.05 * before_a * before_a + 0.5 * 1e-3 * plant.speed() * plant.speed();
    // trapezia of 10 us against oscillation at 141 rad/s: (1.4e-3)² / 12 = 1.7e-7
    assert_close((heat_j + stored_j) / supplied_j, 1.0, 1e-6, "energy");
}

#[test]
fn without_inductance_the_motor_is_first_order() {
    for inductance_h in [0.0, 1e-7] {
        let mut plant = motor(DcGearMotor { inductance_h, ..MOTOR }, &[]);
        run(&mut plant, Drive::with_brake(1.0), 12.0, 20);
        // rate 50/s, so one time constant; settled at 12 V / 1 V s/rad
        assert_close(plant.speed(), 12.0 * (1.0 - (-1.0f64).exp()), 1e-12, "speed");
        assert_close(plant.motor_current_a(), 12.0 * (-1.0f64).exp(), 1e-12, "current");
    }
}

#[test]
fn a_tiny_inductance_joins_the_case_without() {
    // on both sides of the switch at L/R = 1 us, and a little above, where the matrix is stiff
    let speed = |inductance_h| {
        let mut plant = motor(DcGearMotor { inductance_h, ..MOTOR }, &[]);
        run(&mut plant, Drive::with_brake(1.0), 12.0, 20);
        plant.speed()
    };
    // omission of an electrical time constant T shifts the answer by T: 600 rad/s² · exp(-1) · 1.1 us = 2.4e-4
    assert_close(speed(1.1e-6), speed(0.0), 3e-4, "at the switch");
    assert_close(speed(1e-5), speed(0.0), 3e-3, "above it");
}

#[test]
fn under_load_the_motor_settles_where_torques_balance() {
    let effects =
        [Effect::CoulombFriction(CoulombFriction { level: 0.5 }), Effect::ConstantLoad(ConstantLoad { force: 1.5 })];
    let mut plant = motor(DcGearMotor { viscous_nm_s_per_rad: 0.5, ..MOTOR }, &effects);
    run(&mut plant, Drive::with_brake(1.0), 12.0, 1000);
    // k = 1, R = 1: i = 12 − v = 0.5 v + 2.0; a second is 75 time constants
    assert_close(plant.speed(), 10.0 / 1.5, 1e-12, "speed");
    assert_close(plant.motor_current_a(), 12.0 - 10.0 / 1.5, 1e-12, "current");
    let mut drag = motor(MOTOR, &[Effect::QuadraticDrag(QuadraticDrag { drag: 0.25 })]);
    run(&mut drag, Drive::with_brake(1.0), 12.0, 1000);
    // 12 − v = v²/4
    assert_close(drag.speed(), (13.0f64.sqrt() - 1.0) * 2.0, 1e-9, "speed with drag");
}

#[test]
fn the_result_does_not_depend_on_how_time_is_cut() {
    let cuts: [&[f64]; 4] = [&[1e-3], &[0.25e-3; 4], &[0.1e-3, 0.37e-3, 0.53e-3], &[1e-9, 0.9e-3, 0.1e-3 - 1e-9]];
    let after = |effects: &[Effect], cut: &[f64]| {
        let mut plant = motor(MOTOR, effects);
        for ms in 0..400 {
            let drive = Drive::with_brake(0.6 * (f64::from(ms) * 0.03).sin());
            cut.iter().for_each(|dt_s| plant.advance(drive, 24.0, *dt_s));
        }
        plant.position()
    };
    let coulomb = Effect::CoulombFriction(CoulombFriction { level: 0.8 });
    let cogging = Effect::Cogging(Cogging { amplitude: 0.5, periods: 12.0, phase_rad: 0.3 });
    // Linear: rounding. Friction: a reversal breaks away up to a step of 0.25 ms late; by then the torque has grown by
    // 0.1 N m (0.43 V/ms), the speed would be 1.3e-3 rad/s, and the difference decays in 20 ms: 3e-5 rad. Cogging, by
    // the half-way rule, adds (12 · 10 rad/s · 0.25 ms)² / 24 of its 0.5 N m, which is less.
    for (effects, tolerance) in [(&[][..], 1e-12), (&[coulomb][..], 3e-5), (&[coulomb, cogging][..], 5e-5)] {
        let reference = after(effects, cuts[0]);
        assert!(reference.abs() > 0.01);
        for cut in &cuts[1..] {
            assert_close(after(effects, cut), reference, tolerance, "position");
        }
    }
}

#[test]
fn same_seed_same_bits() {
    let random = Effect::RandomLoad(crate::effect::load::RandomLoad { deviation: 0.2, correlation_s: 0.01 });
    let spec = spec(Model::DcGearMotor(MOTOR), &[random]);
    let after = |seed| {
        let mut plant = Plant::new(&spec, seed);
        run(&mut plant, Drive::with_brake(0.3), 12.0, 500);
        plant.position().to_bits()
    };
    assert_eq!(after(5), after(5));
    assert_ne!(after(5), after(6));
}

#[test]
fn bad_input_is_ignored_or_clipped() {
    let mut plant = motor(MOTOR, &[]);
    run(&mut plant, Drive::with_brake(0.5), 12.0, 10);
    let before = format!("{plant:?}");
    for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        plant.advance(Drive::with_brake(bad), 12.0, 1e-3);
        plant.advance(Drive { duty: 0.5, coast: bad }, 12.0, 1e-3);
        plant.advance(Drive::with_brake(0.5), bad, 1e-3);
        plant.advance(Drive::with_brake(0.5), 12.0, bad);
        plant.set_position(bad);
    }
    plant.advance(Drive::with_brake(0.5), 12.0, 0.0);
    plant.advance(Drive::with_brake(0.5), 12.0, -1.0);
    assert_eq!(format!("{plant:?}"), before);

    let [mut clipped, mut full] = [motor(MOTOR, &[]), motor(MOTOR, &[])];
    run(&mut clipped, Drive { duty: 7.0, coast: -3.0 }, 12.0, 10);
    run(&mut full, Drive::with_brake(1.0), 12.0, 10);
    assert_eq!(clipped.speed(), full.speed());
}

/// A load set from outside equals a constant load to the bit: both enter one sum of forces.
#[test]
fn a_load_from_outside_acts_as_a_constant_one() {
    let load = Effect::ConstantLoad(ConstantLoad { force: -0.7 });
    let friction = Effect::CoulombFriction(CoulombFriction { level: 0.2 });
    let mut loaded = motor(MOTOR, &[load, friction]);
    let mut pushed = motor(MOTOR, &[friction]);
    for load in [f64::NAN, f64::INFINITY, 0.7, f64::NEG_INFINITY] {
        pushed.set_load(load);
    }
    for drive in [Drive::with_brake(0.3), Drive::COAST, Drive::BRAKE] {
        run(&mut loaded, drive, 12.0, 50);
        run(&mut pushed, drive, 12.0, 50);
        assert_eq!((loaded.position(), loaded.speed()), (pushed.position(), pushed.speed()));
    }
    assert!(pushed.speed() > 0.0);
    pushed.set_load(0.0);
    run(&mut pushed, Drive::BRAKE, 0.0, 500);
    assert_eq!(pushed.speed(), 0.0);
}
