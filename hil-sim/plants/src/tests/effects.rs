use proptest::prelude::*;

use super::*;
use crate::{
    EffectInfo, Fitted, InsertionPoint, PlantKind, catalogue,
    effect::{
        backlash::Backlash,
        delay::InputDelay,
        input::{DeadZone, GainCurve},
        sensor::{EncoderOffset, EncoderScale, MissedEdges},
        slew::SlewLimit,
    },
};

#[test]
fn a_delay_is_exact_whatever_the_steps() {
    // 100 us is shorter than a step, 12.3456 ms is no multiple of one
    for delay_s in [1e-4, 12.3456e-3] {
        let mut delayed = motor(MOTOR, &[Effect::InputDelay(InputDelay { delay_s })]);
        let mut plain = motor(MOTOR, &[]);
        run(&mut delayed, Drive::with_brake(1.0), 12.0, 50);
        plain.advance(Drive::with_brake(1.0), 12.0, 50e-3 - delay_s);
        assert_close(delayed.position(), plain.position(), 1e-12, "position"); // 50 roundings of time
    }
}

#[test]
fn two_delays_add_up() {
    let half = Effect::InputDelay(InputDelay { delay_s: 1e-4 });
    let whole = Effect::InputDelay(InputDelay { delay_s: 2e-4 });
    let [mut twice, mut once] = [motor(MOTOR, &[half, half]), motor(MOTOR, &[whole])];
    for plant in [&mut twice, &mut once] {
        run(plant, Drive::with_brake(1.0), 12.0, 20);
    }
    assert_close(twice.position(), once.position(), 1e-12, "position");
}

#[test]
fn a_delay_behind_a_ramp_is_one_before_it() {
    let [ramp, delay] =
        [Effect::SlewLimit(SlewLimit { rate_per_s: 10.0 }), Effect::InputDelay(InputDelay { delay_s: 1e-9 })];
    let [mut before, mut behind] = [motor(MOTOR, &[delay, ramp]), motor(MOTOR, &[ramp, delay])];
    for plant in [&mut before, &mut behind] {
        run(plant, Drive::with_brake(1.0), 12.0, 100);
    }
    assert_eq!(before.position(), behind.position());
}

#[test]
fn a_slew_limit_is_the_mean_of_its_ramp() {
    let mut plant =
        motor(DcGearMotor { inductance_h: 0.0, ..MOTOR }, &[Effect::SlewLimit(SlewLimit { rate_per_s: 10.0 })]);
    run(&mut plant, Drive::with_brake(1.0), 12.0, 50);
    // ramp into a first-order lag: 120 V/s · (t − (1 − exp(−50 t)) / 50) at 50 ms; means of 0.25 ms steps leave
    // (50/s · 0.25 ms)² / 24 of the last one
    let expected = 120.0 * (0.05 - (1.0 - (-2.5f64).exp()) / 50.0);
    assert_close(plant.speed(), expected, 1e-4, "speed");
}

#[test]
fn effects_at_one_point_act_in_the_order_of_the_file() {
    let (zone, curve) = (Effect::DeadZone(DeadZone { duty: 0.5 }), Effect::GainCurve(GainCurve { exponent: 2.0 }));
    let settled = |effects: &[Effect]| {
        let mut plant = motor(MOTOR, effects);
        run(&mut plant, Drive::with_brake(1.0), 12.0, 2000);
        plant.speed()
    };
    assert_close(settled(&[zone, curve]), 12.0 * 0.25, 1e-12, "(1 - 0.5)²");
    assert_close(settled(&[curve, zone]), 12.0 * 0.5, 1e-12, "1² - 0.5");
    let (scale, offset) =
        (Effect::EncoderScale(EncoderScale { scale: 2.0 }), Effect::EncoderOffset(EncoderOffset { offset: 1.0 }));
    assert_eq!(motor(MOTOR, &[scale, offset]).sensed_position(), 1.0);
    assert_eq!(motor(MOTOR, &[offset, scale]).sensed_position(), 2.0);
}

#[test]
fn backlash_loses_its_gap_at_every_reversal() {
    let mut plant = motor(MOTOR, &[Effect::Backlash(Backlash { gap: 0.5 })]);
    let mut without = motor(MOTOR, &[]);
    let mut widest: f64 = 0.0;
    for duty in [0.5, -0.5, 0.5] {
        for plant in [&mut plant, &mut without] {
            run(plant, Drive::with_brake(duty), 12.0, 1000);
        }
        assert_close(plant.position(), without.position() - duty * 0.5, 1e-12, "trails by half a gap");
        assert_eq!(plant.speed(), without.speed());
        widest = widest.max(without.position());
    }
    assert!(widest > 1.0);
}

#[test]
fn missed_edges_leave_the_sensor_behind_a_fast_move() {
    let effect = MissedEdges { threshold: 2.0, reference: 100.0 };
    let mut plant = motor(MOTOR, &[Effect::MissedEdges(effect)]);
    run(&mut plant, Drive::with_brake(1.0), 12.0, 1000);
    let (position, sensed) = (plant.position(), plant.sensed_position());
    run(&mut plant, Drive::with_brake(1.0), 12.0, 1000);
    // settled at 12 rad/s: 10 % lost
    assert_close(plant.sensed_position() - sensed, 0.9 * (plant.position() - position), 1e-9, "way sensed");
    let mut slow = motor(MOTOR, &[Effect::MissedEdges(effect)]);
    run(&mut slow, Drive::with_brake(0.15), 12.0, 1000);
    assert_eq!(slow.sensed_position(), slow.position());
}

#[test]
fn the_catalogue_is_consistent() {
    for (index, info) in catalogue().iter().enumerate() {
        assert_eq!(EffectInfo::named(info.name), Some(info));
        assert_eq!(info.typical.info(), info, "{}", info.name);
        assert!(!catalogue()[..index].iter().any(|other| other.name == info.name), "{} twice", info.name);
        assert!(!info.depends_on.is_empty() && !info.kinds.is_empty() && !info.parameters.is_empty());
        for kind in info.kinds {
            assert_eq!(info.typical.check(*kind), Ok(()), "{}", info.name);
        }
    }
    assert_eq!(EffectInfo::named("magic"), None);
}

#[test]
fn every_effect_at_its_typical_value_shows() {
    // A strong push to and fro from a little off the centre, sensed at its end
    for kind in [PlantKind::Rotary, PlantKind::Linear] {
        let model = Model::ALL.into_iter().find(|model| model.kind() == kind).unwrap();
        let sensed = |effects: &[Effect]| {
            let mut plant = Plant::new(&spec(model, effects), 1);
            plant.set_position(0.049);
            for duty in [0.95, -0.65, 0.3] {
                run(&mut plant, Drive::with_brake(duty), 24.0, 60);
            }
            [plant.sensed_position(), plant.position(), plant.motor_current_a()]
        };
        let plain = sensed(&[]);
        for info in catalogue().iter().filter(|info| info.kinds.contains(&kind)) {
            // a rod is far slower than the thresholds typical of a wheel, and spans the dead spot
            let needs_speed = matches!(info.name, "missed-edges" | "potentiometer-dead-spot");
            let acts_at_output = matches!(info.insertion, InsertionPoint::Sensor);
            let with = sensed(&[info.typical]);
            if !needs_speed {
                assert_ne!(with, plain, "{} does nothing on {kind} plants", info.name);
            }
            if acts_at_output {
                assert_eq!(with[1], plain[1], "{} moves the plant", info.name);
            }
        }
    }
}

/// Any effect of the catalogue with any values in its bounds, spread over the decades.
fn any_effect(kind: PlantKind) -> impl Strategy<Value = Effect> {
    (0..catalogue().len(), prop::collection::vec(0.0..=1.0f64, 4)).prop_filter_map("kind", move |(index, shares)| {
        let info = &catalogue()[index];
        let mut effect = info.typical;
        for (parameter, share) in info.parameters.iter().zip(shares) {
            let span = parameter.upper - parameter.lower;
            let value = (parameter.lower + span * share.powi(12)).clamp(parameter.lower, parameter.upper);
            effect.set(kind, parameter.name(kind), value).unwrap();
        }
        info.kinds.contains(&kind).then_some(effect)
    })
}

fn any_spec() -> impl Strategy<Value = PlantSpec> {
    prop::sample::select(Model::ALL.to_vec()).prop_flat_map(|model| {
        prop::collection::vec(any_effect(model.kind()), 0..6)
            .prop_map(move |effects| PlantSpec::new(model, "\"quoted\" \\ and\nbroken", effects).unwrap())
    })
}

proptest! {
    #[test]
    fn a_file_reads_back_to_the_bit(spec in any_spec()) {
        prop_assert_eq!(PlantSpec::from_toml("again.toml", &spec.to_toml()).unwrap(), spec);
    }

    #[test]
    fn no_plant_leaves_the_numbers(
        spec in any_spec(),
        calls in prop::collection::vec((-1.5..1.5f64, 0.0..1.2f64, 0.0..60.0f64, 1e-9..5e-3f64), 1..40),
    ) {
        let mut plant = Plant::new(&spec, 1);
        for (duty, coast, supply_v, dt_s) in calls {
            plant.advance(Drive { duty, coast }, supply_v, dt_s);
            for value in [plant.position(), plant.speed(), plant.sensed_position(), plant.supply_current_a()] {
                prop_assert!(value.is_finite(), "{:?}", plant);
            }
        }
    }
}
