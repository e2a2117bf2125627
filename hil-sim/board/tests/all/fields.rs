//! Sensors that read a field of the world, from the field to the value at the host.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use r4_boards::{FieldReading, Robot, SelfCharge};
use r4_protocol::{ChannelId, ChannelKind, Mode, Quality, Sample};
use r4_world::{Charge, Electric, ElectricSpec, Field, FieldKind};

use crate::{
    harness::{Bench, bench},
    whole_board::sample,
};

const INPUT: ChannelId = ChannelId::new(ChannelKind::Analog, 0);
/// Tolerance, V: a code of the divider for 5 V is 76 µV; noise of 2.3 codes and rounding stay below 1 mV.
const CLOSE_V: f64 = 1e-3;

/// A rover in a field of one charge beside it, without other effects than those of `change`.
fn rover(uniform_v_per_m: f64, change: impl FnOnce(&mut FieldReading)) -> Robot {
    let mut robot = r4_boards::load("field-rover").unwrap();
    let charges = vec![Charge { place_m: [0.0, 1.0], size_m: 1.0, peak_v_per_m: 100.0 }];
    let spec = ElectricSpec { uniform_v_per_m, charges, ..ElectricSpec::default() };
    let kind = FieldKind::Electric(Box::new(Electric::new(spec).unwrap()));
    robot.simulation.fields = vec![Field { name: "electric".into(), kind }];
    let reading = robot.simulation.analogs[0].field.as_mut().unwrap();
    (reading.lag_s, reading.charge) = (0.0, SelfCharge::NONE);
    change(reading);
    robot
}

async fn volts(bench: &Bench<'_>) -> f64 {
    let (Sample::Scalar { value, .. } | Sample::Reading { value, .. }) = sample(bench, INPUT).await else {
        panic!("a number")
    };
    value.into()
}

async fn turn(bench: &Bench<'_>, speed: f32) {
    for (index, sign) in [-1.0, 1.0, -1.0, 1.0].into_iter().enumerate() {
        let wheel = ChannelId::new(ChannelKind::Dhb, index as u8);
        bench.set(wheel, Mode::Speed, sign * speed).await.unwrap();
    }
}

#[test]
fn a_host_reads_the_field_where_the_sensor_is_while_the_body_turns() {
    let robot = rover(-50.0, |reading| reading.at_m = [0.5, 0.0]);
    bench(&robot, async |bench| {
        bench.host.arm().await.unwrap();
        turn(bench, 4.0).await;
        let mut seen = Vec::new();
        for _ in 0..8 {
            bench.sleep_ms(500).await;
            let measured_v = volts(bench).await;
            let place = bench.board.world().pose().unwrap().to_world([0.5, 0.0]);
            let field = bench.board.world().field("electric", place).unwrap();
            let expected_v = 2.5 + 0.005 * 1.4 * field;
            // the sample is up to 30 ms old: 1 rad/s at 0.5 m in a gradient of at most 61 V/m per metre
            assert!((measured_v - expected_v).abs() < 0.03 * 0.5 * 61.0 * 0.007 + CLOSE_V, "{measured_v} {expected_v}");
            seen.push(measured_v);
        }
        let spread = seen.iter().copied().fold(f64::MIN, f64::max) - seen.iter().copied().fold(f64::MAX, f64::min);
        assert!(spread > 0.1, "the charge is to the left: {seen:?}");
    });
}

/// The converter is at the end of its range, which is outside the board's plausible volts.
#[test]
fn the_input_clips_a_field_beyond_its_offset_stage() {
    for (uniform_v_per_m, clipped) in [(-2000.0, 0), (2000.0, u16::MAX)] {
        let robot = rover(uniform_v_per_m, |_| {});
        bench(&robot, async |bench| {
            bench.sleep_ms(100).await;
            {
                let mut world = bench.board.world();
                let source = world.pins().analogs[0].as_ref().unwrap();
                let sensor_v = source.field.as_ref().unwrap().volts();
                assert!(!(0.0..=5.0).contains(&sensor_v), "{sensor_v}");
                assert_eq!(source.input.code_without_noise(sensor_v), clipped);
            }
            let Sample::Reading { quality, .. } = sample(bench, INPUT).await else { panic!("a reading") };
            assert_ne!(quality, Quality::Good, "{uniform_v_per_m} V/m");
        });
    }
}

/// Wheels at 4 rad/s charge the body towards `rest + per_rad * 4 * leak`, and it discharges while they stand.
#[test]
fn wheels_charge_the_body_while_they_turn() {
    let charge = SelfCharge { rest: 5.0, per_rad: 2.0, leak_s: 1.0 };
    let robot = rover(0.0, |reading| (reading.at_m, reading.charge) = ([0.0, 0.0], charge));
    bench(&robot, async |bench| {
        bench.sleep_ms(100).await;
        let at_rest_v = volts(bench).await;
        let field = 100.0 * (-0.5_f64).exp();
        assert!((at_rest_v - (2.5 + 0.007 * (field + 5.0))).abs() < CLOSE_V, "{at_rest_v}");
        bench.host.arm().await.unwrap();
        turn(bench, 4.0).await;
        bench.sleep_ms(6000).await;
        let added = (volts(bench).await - at_rest_v) / 0.007;
        // 8 V/m; the wheels keep 4 rad/s to some percent, and turning on the spot moves the sensor by some mm, 0.6 V/m
        // per cm
        assert!((added - 8.0).abs() < 1.0, "{added} V/m");
    });
}

/// Two runs with different sampling: the truth does not depend on it.
#[test]
fn who_looks_more_often_sees_the_same_plume() {
    let mut robot = r4_boards::load("gas-scout").unwrap();
    robot.simulation.enter(r4_boards::load_world("factory").unwrap());
    robot.simulation.check_fields().unwrap();
    for field in &mut robot.simulation.fields {
        let FieldKind::Gas(plume) = &mut field.kind else { panic!("gas") };
        // a change that a scene may make before the robot is powered up
        **plume = plume.changed(|spec| (spec.source_m, spec.running_s) = ([2.25, 25.25], 30.0)).unwrap();
    }
    let place = [4.2, 25.0];
    let run = |often: bool| {
        let mut value = None;
        bench(&robot, async |bench| {
            for _ in 0..20 {
                bench.sleep_ms(100).await;
                if often {
                    bench.board.world().field("gas", place);
                    volts(bench).await;
                }
            }
            bench.clock.sleep_until(20_000_000_000).await;
            value = bench.board.world().field("gas", place);
        });
        value
    };
    let (seldom, often) = (run(false), run(true));
    assert!(seldom.is_some_and(|ppm| ppm.is_finite()), "{seldom:?}");
    assert_eq!(seldom, often);
}
