use super::*;
use crate::{
    LinearActuator,
    effect::{friction::CoulombFriction, load::ConstantLoad},
};

const ACTUATOR: LinearActuator = LinearActuator {
    resistance_ohm: 2.0,
    inductance_h: 1e-3,
    torque_constant_nm_per_a: 0.02,
    lead_m_per_rev: 0.002,
    efficiency: 0.4,
    rotor_inertia_kg_m2: 1e-6,
    moving_mass_kg: 1.0,
    viscous_n_s_per_m: 100.0,
    stroke_m: 0.1,
};

fn actuator(effects: &[Effect]) -> Plant {
    Plant::new(&spec(Model::LinearActuator(ACTUATOR), effects), 1)
}

#[test]
fn the_rod_settles_where_the_screw_leaves_its_share() {
    let mut plant = actuator(&[Effect::CoulombFriction(CoulombFriction { level: 20.0 })]);
    run(&mut plant, Drive::with_brake(1.0), 12.0, 500);
    let k = std::f64::consts::TAU / 0.002 * 0.02;
    // 0.4 k i = 100 v + 20 with i = (12 − k v) / 2
    let speed = (0.4 * k * 6.0 - 20.0) / (100.0 + 0.2 * k * k);
    // the screw's loss takes the current from the start of each step: nil once it has settled
    assert_close(plant.speed(), speed, 1e-9, "speed");
    assert_eq!(plant.kind(), crate::PlantKind::Linear);
}

#[test]
fn the_rod_stays_between_its_stops_and_stalls_there() {
    let mut plant = actuator(&[]);
    for (duty, end_m) in [(1.0, 0.1), (-1.0, 0.0), (0.3, 0.1)] {
        for _ in 0..20_000 {
            plant.advance(Drive::with_brake(duty), 12.0, 1e-3);
            assert!((0.0..=0.1).contains(&plant.position()), "{}", plant.position());
        }
        assert_eq!((plant.position(), plant.speed()), (end_m, 0.0));
        assert_close(plant.motor_current_a(), duty * 6.0, 1e-12, "stall current");
    }
    plant.set_position(5.0);
    assert_eq!(plant.position(), 0.1);
}

#[test]
fn a_screw_without_power_holds_what_its_friction_does() {
    // pushing at the rod: the screw's loss holds nothing of its own, friction does
    let push = |force| {
        let mut plant = actuator(&[
            Effect::CoulombFriction(CoulombFriction { level: 50.0 }),
            Effect::ConstantLoad(ConstantLoad { force }),
        ]);
        plant.set_position(0.05);
        run(&mut plant, Drive::COAST, 12.0, 1000);
        plant.position()
    };
    assert_eq!(push(49.0), 0.05);
    assert!(push(80.0) < 0.05);
}
