use proptest::prelude::*;

use super::*;
use crate::{
    EffectInfo, Fitted, InsertionPoint, PlantKind, Table, Unlisted, catalogue,
    effect::{
        backlash::Backlash,
        compliance::Compliance,
        delay::InputDelay,
        friction::{CoulombFriction, FrictionWarmUp, LoadFriction, QuadraticDrag},
        input::{DeadZone, DriveLag, GainCurve, InputHold, InputSign},
        load::{Cogging, ConstantLoad},
        sensor::{EncoderOffset, EncoderScale, MissedEdges, SensorLag},
        slew::SlewLimit,
        supply::WindingHeating,
        table::{On, Over},
        unlisted::{Doing, Moment},
    },
};

#[test]
fn a_delay_is_exact_whatever_the_steps() {
    // 100 us is shorter than a step, 12.3456 ms is not a multiple of one
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
fn a_hold_is_the_drive_of_its_looks() {
    let mut held = motor(MOTOR, &[Effect::InputHold(InputHold { period_s: 0.7e-3 })]);
    let mut plain = motor(MOTOR, &[]);
    let duty = |at_s: f64| (40.0 * at_s).sin();
    // steps of 0.1 ms, so that every sample falls on one; the plain plant gets the drive sampled every 7 steps
    for step in 0..700 {
        held.advance(Drive::with_brake(duty(f64::from(step) * 1e-4)), 12.0, 1e-4);
        plain.advance(Drive::with_brake(duty(f64::from(step / 7 * 7) * 1e-4)), 12.0, 1e-4);
    }
    assert_close(held.position(), plain.position(), 1e-12, "position"); // 700 roundings
    // the same with calls longer than the hold
    let mut long = motor(MOTOR, &[Effect::InputHold(InputHold { period_s: 0.7e-3 })]);
    let mut late = motor(MOTOR, &[]);
    for plant in [&mut long, &mut late] {
        plant.advance(Drive::with_brake(0.0), 12.0, 0.1e-3);
    }
    long.advance(Drive::with_brake(1.0), 12.0, 5e-3);
    late.advance(Drive::with_brake(0.0), 12.0, 0.6e-3);
    late.advance(Drive::with_brake(1.0), 12.0, 4.4e-3);
    // the hold starts with its first sample, a brake
    assert_close(long.position(), late.position(), 1e-15, "position");
}

#[test]
fn a_lag_of_the_drive_is_one_of_the_sensor_on_a_linear_plant() {
    let mut drive = motor(MOTOR, &[Effect::DriveLag(DriveLag { time_constant_s: 0.03 })]);
    let mut sensor = motor(MOTOR, &[Effect::SensorLag(SensorLag { time_constant_s: 0.03 })]);
    for plant in [&mut drive, &mut sensor] {
        run(plant, Drive::with_brake(0.5), 12.0, 200);
    }
    // at 6 rad/s; the drive's means over steps of 0.25 ms err by (0.25/30)² / 12 of the change, and so do ramps in the
    // sensor
    assert_close(drive.sensed_position(), sensor.sensed_position(), 1e-5, "sensed");
    assert!(drive.position() + 0.1 < sensor.position());
}

#[test]
fn a_sign_turns_the_plant_round() {
    let [mut turned, mut plain] = [motor(MOTOR, &[Effect::InputSign(InputSign {})]), motor(MOTOR, &[])];
    run(&mut turned, Drive::with_brake(0.5), 12.0, 50);
    run(&mut plain, Drive::with_brake(-0.5), 12.0, 50);
    assert_eq!(turned.position(), plain.position());
}

#[test]
fn friction_by_load_takes_its_share_of_the_motors_force() {
    let load =
        [Effect::LoadFriction(LoadFriction { share: 0.25 }), Effect::CoulombFriction(CoulombFriction { level: 0.6 })];
    let mut plant = motor(MOTOR, &load);
    run(&mut plant, Drive::with_brake(0.5), 24.0, 1000);
    // k = R = 1: 0.75 i = 0.6, v = 12 - i
    assert_close(plant.speed(), 12.0 - 0.6 / 0.75, 1e-9, "speed");
    let mut held = motor(MOTOR, &load);
    run(&mut held, Drive::with_brake(0.0332), 24.0, 1000);
    assert_eq!(held.speed(), 0.0); // 0.797 A of 0.8
}

/// The force that loads a friction is that of the present voltage, not of the one before it.
#[test]
fn friction_by_load_follows_a_step_of_the_voltage_at_once() {
    let load = [Effect::LoadFriction(LoadFriction { share: 0.25 })];
    let quick = DcGearMotor { inductance_h: 0.0, ..MOTOR };
    let mut plant = motor(quick, &load);
    run(&mut plant, Drive::with_brake(0.5), 24.0, 1000);
    run(&mut plant, Drive::with_brake(0.75), 24.0, 10);
    // k = R = 1: v' = 0.75 (18 - v) / 0.02. With the current of the step before, the speed is 0.02 lower.
    assert_close(plant.speed(), 18.0 - 6.0 * (-0.75_f64 / 0.02 * 0.01).exp(), 1e-3, "speed");
}

#[test]
fn a_cold_plant_gains_speed_as_it_warms_up() {
    let mut plant = motor(MOTOR, &[Effect::FrictionWarmUp(FrictionWarmUp { level: 2.0, warm_up_s: 1.0 })]);
    run(&mut plant, Drive::with_brake(0.5), 24.0, 2000);
    // a ramp of the level is followed 1 / (50 - 1) s late at most
    assert_close(plant.speed(), 12.0 - 2.0 * (-2.0f64).exp() * 50.0 / 49.0, 1e-3, "speed");
}

#[test]
fn a_stalled_winding_settles_where_its_heat_does() {
    let heating = Effect::WindingHeating(WindingHeating { rise_per_w: 0.01, time_constant_s: 0.5 });
    let mut plant = motor(MOTOR, &[heating, Effect::CoulombFriction(CoulombFriction { level: 1e3 })]);
    run(&mut plant, Drive::with_brake(0.5), 24.0, 20_000);
    // r = 0.01 · 144 / (1 + r), so r (1 + r) = 1.44 and r = 0.8
    assert_close(plant.motor_current_a(), 12.0 / 1.8, 1e-9, "current");
    let mut cold = motor(MOTOR, &[heating, Effect::CoulombFriction(CoulombFriction { level: 1e3 })]);
    run(&mut cold, Drive::with_brake(0.5), 24.0, 10);
    assert!(cold.motor_current_a() > 11.5, "{}", cold.motor_current_a());
}

#[test]
fn an_elastic_output_trails_and_does_not_push_back() {
    let effect = Compliance { frequency_hz: 3.0, damping: 0.2 };
    let [mut elastic, mut stiff] = [motor(MOTOR, &[Effect::Compliance(effect)]), motor(MOTOR, &[])];
    let mut widest: f64 = 0.0;
    for duty in [0.5, 0.0] {
        for _ in 0..4000 {
            for plant in [&mut elastic, &mut stiff] {
                plant.advance(Drive::with_brake(duty), 12.0, 1e-3);
            }
            widest = widest.max((elastic.position() - stiff.position()).abs());
        }
        // 4 s are 15 time constants of the swing: exp(-15) of half a radian
        assert_close(elastic.position(), stiff.position(), 1e-6, "settled");
    }
    // 6 rad/s gained in 20 ms: nearly 6 / (2π · 3) · exp(-0.2 · 1.37)
    assert!((0.2..0.3).contains(&widest), "{widest}");
}

fn with_table(table: (Over, On, Option<f64>, &[f64], &[f64])) -> Plant {
    let (over, on, period, at, values) = table;
    let mut spec = spec(Model::DcGearMotor(MOTOR), &[]);
    spec.push_table(Table::new(over, on, period, at.to_vec(), values.to_vec()).unwrap());
    Plant::new(&spec, 1)
}

#[test]
fn a_table_does_what_the_effect_of_its_shape_does() {
    let corners: Vec<f64> = (0..3600).map(|index| f64::from(index) * 0.1f64.to_radians()).collect();
    let cogging: Vec<f64> = corners.iter().map(|at| 0.5 * (4.0 * at + 1.0).sin()).collect();
    let speeds: Vec<f64> = (-600..=600).map(|index| f64::from(index) * 0.02).collect();
    let drag: Vec<f64> = speeds.iter().map(|speed| -0.05 * speed * speed.abs()).collect();
    let duties: Vec<f64> = (-1000..=1000).map(|index| f64::from(index) * 1e-3).collect();
    let curve: Vec<f64> = duties.iter().map(|duty| duty * duty.abs() - duty).collect();
    let turn = Some(std::f64::consts::TAU);
    for (effect, table, tolerance) in [
        // dry friction is the same to the bit
        (
            Effect::CoulombFriction(CoulombFriction { level: 0.5 }),
            (Over::Speed, On::Force, None, &[0.0, 0.0][..], &[0.5, -0.5][..]),
            0.0,
        ),
        (Effect::ConstantLoad(ConstantLoad { force: 0.5 }), (Over::Time, On::Force, None, &[0.0], &[-0.5]), 0.0),
        // chords of a curve: 0.5 N m (4 · 0.1°)² / 8 = 3e-6, 0.05 (0.01 rad/s)², 1e-6 / 4 of 12 V; all over a second
        (
            Effect::Cogging(Cogging { amplitude: 0.5, periods: 4.0, phase_rad: 1.0 }),
            (Over::Position, On::Force, turn, &corners, &cogging),
            1e-5,
        ),
        (Effect::QuadraticDrag(QuadraticDrag { drag: 0.05 }), (Over::Speed, On::Force, None, &speeds, &drag), 1e-5),
        (Effect::GainCurve(GainCurve { exponent: 2.0 }), (Over::Input, On::Input, None, &duties, &curve), 1e-5),
    ] {
        let [mut named, mut tabulated] = [motor(MOTOR, &[effect]), with_table(table)];
        for ms in 0..1000 {
            let drive = Drive::with_brake(0.6 * (f64::from(ms) * 0.02).sin());
            for plant in [&mut named, &mut tabulated] {
                plant.advance(drive, 12.0, 1e-3);
            }
            assert_close(tabulated.position(), named.position(), tolerance, effect.name());
        }
        let mut plain = motor(MOTOR, &[]);
        run(&mut plain, Drive::with_brake(0.3), 12.0, 1000);
        run(&mut named, Drive::with_brake(0.3), 12.0, 1000);
        assert!((plain.position() - named.position()).abs() > 0.1, "{} does nothing", effect.name());
    }
}

#[test]
fn tables_of_friction_and_gain_act_by_their_own_variable() {
    // N m of friction by supply: 12 V less 0.5 V of it; none where the table is negative
    let mut rubbed = with_table((Over::Supply, On::Friction, None, &[10.0, 14.0], &[-1.0, 2.0]));
    run(&mut rubbed, Drive::with_brake(1.0), 12.0, 1000);
    assert_close(rubbed.speed(), 11.5, 1e-12, "at 12 V");
    run(&mut rubbed, Drive::with_brake(1.0), 10.0, 1000);
    assert_close(rubbed.speed(), 10.0, 1e-12, "at 10 V");
    // a negative value reduces Coulomb friction, here to 0.25 N m or to 0, but not a drag
    let drag = Effect::QuadraticDrag(QuadraticDrag { drag: 0.05 });
    let coulomb = |level| Effect::CoulombFriction(CoulombFriction { level });
    let mut less = spec(Model::DcGearMotor(MOTOR), &[coulomb(1.0), drag]);
    less.push_table(Table::new(Over::Supply, On::Friction, None, vec![6.0, 12.0], vec![-3.0, -0.75]).unwrap());
    for (supply_v, effects) in [(12.0, &[coulomb(0.25), drag][..]), (6.0, &[drag][..])] {
        let (mut less, mut plain) = (Plant::new(&less, 1), motor(MOTOR, effects));
        [&mut less, &mut plain].into_iter().for_each(|plant| run(plant, Drive::with_brake(1.0), supply_v, 1000));
        assert!(plain.speed() > 1.0);
        assert_close(less.speed(), plain.speed(), 1e-12, "less friction");
    }
    // friction by table holds at rest
    let mut held = with_table((Over::Time, On::Friction, None, &[0.0], &[0.5]));
    run(&mut held, Drive::with_brake(0.04), 12.0, 100);
    assert_eq!(held.position(), 0.0);
    let mut faded =
        with_table((Over::Time, On::Gain, None, &[0.0, 1.0, 1.0, 2.0, 2.0], &[0.25, 0.25, -0.5, -0.5, -3.0]));
    for (speed, when) in [(15.0, "first"), (6.0, "then"), (0.0, "at last")] {
        run(&mut faded, Drive::with_brake(1.0), 12.0, 1000);
        assert_close(faded.speed(), speed, 1e-9, when); // the last of 50 time constants
    }
}

#[test]
fn a_table_over_history_counts_the_way_from_the_last_turn() {
    let mut plant = with_table((Over::History, On::Friction, None, &[0.0, 1.0, 1.0], &[2.0, 2.0, 0.5]));
    let mut reached = |duty: f64, ms| {
        run(&mut plant, Drive::with_brake(duty), 12.0, ms);
        (plant.position(), plant.speed())
    };
    // a way of 1 rad with 2 N m, then 0.5 N m; the same again after it has turned round
    let (_, near) = reached(0.25, 500);
    assert_close(near, 1.0, 1e-9, "near its start"); // 25 time constants
    let (far, free) = reached(0.25, 2000);
    assert!(far > 1.0);
    assert_close(free, 2.5, 1e-9, "far from it");
    let (_, back) = reached(-0.25, 600);
    assert_close(back, -1.0, 1e-6, "after it has turned");
    let (_, free) = reached(-0.25, 2000);
    assert_close(free, -2.5, 1e-9, "and far from there");
}

#[test]
fn a_table_over_time_since_a_turn_begins_anew_at_each() {
    let mut plant = with_table((Over::SinceTurn, On::Friction, None, &[0.0, 1.0, 1.0], &[2.0, 2.0, 0.0]));
    run(&mut plant, Drive::with_brake(0.5), 12.0, 900);
    assert_close(plant.speed(), 6.0, 1e-8, "it has never turned"); // 22 time constants
    run(&mut plant, Drive::with_brake(-0.5), 12.0, 900);
    assert_close(plant.speed(), -4.0, 1e-8, "soon after a turn");
    run(&mut plant, Drive::with_brake(-0.5), 12.0, 1100);
    assert_close(plant.speed(), -6.0, 1e-8, "long after it");
}

#[test]
fn a_hysteresis_is_against_the_last_way_and_lets_go_by_pushing() {
    // The force drives in the direction of motion for the first 1 rad after each reversal, and opposes it from there
    // on.
    let mut plant = with_table((Over::History, On::Hysteresis, None, &[0.0, 2.0], &[-0.5, 0.5]));
    run(&mut plant, Drive::with_brake(0.5), 12.0, 2000);
    assert_close(plant.speed(), 6.0 - 0.5, 1e-9, "far from its start"); // 25 time constants
    let at = plant.position();
    run(&mut plant, Drive::with_brake(-0.5), 12.0, 2000);
    assert_close(plant.speed(), -6.0 + 0.5, 1e-9, "and far back");
    let free = with_table((Over::History, On::Hysteresis, None, &[0.0], &[0.5]));
    assert!(at > 2.0 && free.position() == 0.0, "at rest from the start nothing pushes");
}

#[test]
fn a_hysteresis_remembers_how_far_it_was_wound_at_a_turn() {
    // Dahl: dF/dx = (c - F sign(v)) / s, for any path.
    let (level, way) = (0.5, 0.2);
    let at: Vec<f64> = (0..400).map(|corner| 0.005 * f64::from(corner)).collect();
    let values: Vec<f64> = at.iter().map(|x| level * (1.0 - 2.0 * (-x / way).exp())).collect();
    let mut plant = with_table((Over::History, On::Hysteresis, None, &at, &values));
    let mut free = with_table((Over::History, On::Hysteresis, None, &[0.0], &[0.0]));
    let (mut position, mut force) = (0.0_f64, 0.0_f64);
    for step in 0..4000 {
        let duty = 0.4 * (0.011 * f64::from(step)).sin() + 0.2 * (0.0037 * f64::from(step)).sin();
        // The reference applies the same force as a voltage.
        run(&mut free, Drive::with_brake(duty - force / 12.0), 12.0, 1);
        run(&mut plant, Drive::with_brake(duty), 12.0, 1);
        let moved = free.position() - position;
        position = free.position();
        let slid = level.copysign(moved);
        force = slid + (force - slid) * (-moved.abs() / way).exp();
        // The knots of the table and the force, one step late, cost 0.003. Without its memory it would be 0.03 off.
        assert_close(plant.position(), position, 0.01, "both");
    }
}

#[test]
fn a_table_of_the_input_over_time_and_place_adds_to_the_duty() {
    let mut plant = with_table((Over::Time, On::Input, None, &[0.0, 1.0, 1.0, 2.0], &[0.25, 0.25, 0.5, 0.5]));
    run(&mut plant, Drive::with_brake(0.25), 12.0, 900);
    assert_close(plant.speed(), 6.0, 1e-12, "before");
    run(&mut plant, Drive::with_brake(0.25), 12.0, 1000);
    assert_close(plant.speed(), 9.0, 1e-12, "after");
    let mut spring = with_table((Over::Position, On::Input, None, &[-10.0, 10.0], &[1.0, -1.0]));
    run(&mut spring, Drive::with_brake(0.5), 12.0, 10_000);
    // 1.2 V/rad by 1 V s/rad: 1.2/s, so exp(-12) of 5 rad
    assert_close(spring.position(), 5.0, 1e-4, "where table and drive cancel");
}

/// Drives backwards from 0.5 s on, with friction and a constant force.
#[derive(Clone, Debug)]
struct Contrary;

impl Unlisted for Contrary {
    fn act(&mut self, moment: &Moment) -> Doing {
        let sign = if moment.time_s < 0.5 { 1.0 } else { -1.0 };
        Doing { duty: sign * moment.duty, friction: 0.5, force: 0.25 }
    }

    fn copied(&self) -> Box<dyn Unlisted> {
        Box::new(self.clone())
    }
}

#[test]
fn an_unlisted_effect_acts_on_duty_friction_and_force() {
    let mut plant = Plant::with_unlisted(&spec(Model::DcGearMotor(MOTOR), &[]), 1, vec![Box::new(Contrary)]);
    run(&mut plant, Drive::with_brake(0.5), 12.0, 500);
    assert_close(plant.speed(), 6.0 - 0.5 + 0.25, 1e-9, "forwards"); // 25 time constants
    let mut copy = plant.clone();
    run(&mut plant, Drive::with_brake(0.5), 12.0, 500);
    assert_close(plant.speed(), -6.0 + 0.5 + 0.25, 1e-9, "backwards");
    run(&mut copy, Drive::with_brake(0.5), 12.0, 500);
    assert_eq!(copy.position(), plant.position());
}

#[test]
fn the_catalogue_is_consistent() {
    for (index, info) in catalogue().iter().enumerate() {
        assert_eq!(EffectInfo::named(info.name), Some(info));
        assert_eq!(info.typical.info(), info, "{}", info.name);
        assert!(!catalogue()[..index].iter().any(|other| other.name == info.name), "{} twice", info.name);
        assert!(!info.depends_on.is_empty() && !info.kinds.is_empty());
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
            // a rod is far slower than thresholds typical of a wheel, and its stroke includes the dead spot
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

/// Any effect of the catalogue with any values within its bounds, spread over the decades.
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

/// Any table: over and on anything, with and without jumps and period.
fn any_table() -> impl Strategy<Value = Table> {
    let word = (prop::sample::select(Over::ALL.to_vec()), prop::sample::select(On::ALL.to_vec()));
    let corners = prop::collection::vec((-30.0..30.0f64, -2.0..2.0f64), 1..8);
    (word, any::<bool>(), any::<bool>(), corners).prop_map(|((over, on), is_circle, jumps, corners)| {
        let (mut at, values): (Vec<_>, Vec<_>) = corners.into_iter().unzip();
        at.sort_by(f64::total_cmp);
        if jumps && at.len() > 1 {
            at[1] = at[0];
        }
        Table::new(over, on, is_circle.then_some(61.0), at, values).unwrap()
    })
}

fn any_spec() -> impl Strategy<Value = PlantSpec> {
    prop::sample::select(Model::ALL.to_vec()).prop_flat_map(|model| {
        let effects = prop::collection::vec(any_effect(model.kind()), 0..6);
        (effects, prop::collection::vec(any_table(), 0..3)).prop_map(move |(effects, tables)| {
            let mut spec = PlantSpec::new(model, "\"quoted\" \\ and\nbroken", effects).unwrap();
            tables.into_iter().for_each(|table| spec.push_table(table));
            spec
        })
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
