//! Every interface of the board, from the host through the whole chain, on the robot `every-interface`, which has all
//! of them.

use std::f64::consts::TAU;

use crate::harness::{Bench, bench, bench_with_misuse, both, control_of};
use r4_boards::Robot;
use r4_protocol::{Cause, Causes, ChannelId, ChannelKind, Mode, Quality, SafetyState, Sample};

fn every_interface() -> Robot {
    r4_boards::load("every-interface").expect("built in")
}

const fn channel(kind: ChannelKind, index: u8) -> ChannelId {
    ChannelId::new(kind, index)
}

/// Newest sample of a channel.
pub(crate) async fn sample(bench: &Bench<'_>, channel: ChannelId) -> Sample {
    let mut telemetry = bench.host.telemetry();
    bench.host.subscribe(channel, 5).await.expect("it has the channel");
    // the second one is younger than the subscription
    let mut seen = 0;
    loop {
        let frame = telemetry.next().await.expect("the link is up");
        if let Some(sample) = frame.samples.iter().find(|sample| sample.channel() == channel) {
            seen += 1;
            if seen == 2 {
                bench.host.subscribe(channel, 0).await.expect("subscribed");
                return *sample;
            }
        }
    }
}

async fn scalar(bench: &Bench<'_>, of: ChannelId) -> f32 {
    match sample(bench, of).await {
        Sample::Scalar { value, .. } => value,
        other => panic!("{other:?}"),
    }
}

#[test]
fn every_channel_is_described_and_told() {
    let robot = every_interface();
    bench(&robot, async |bench| {
        let channels: Vec<_> = bench.host.channels().iter().map(|info| info.id).collect();
        assert_eq!(channels, robot.config.channels().map(|(id, _)| id).collect::<Vec<_>>());
        assert_eq!(channels.len(), 4 + 4 + 4 + 16 + 4 + 8 + 2 + 4 + 4 + 4 + 4 + 2 + 2);
        for info in bench.host.channels() {
            assert!(info.rate_hz > 0.0 && info.range.min < info.range.max, "{info:?}");
            assert_eq!(sample(bench, info.id).await.channel(), info.id);
        }
        // all channels at once: as many frames as that takes
        let mut telemetry = bench.host.telemetry();
        for id in &channels {
            bench.host.subscribe(*id, 50).await.expect("room for all");
        }
        let mut missing = channels.clone();
        while !missing.is_empty() {
            let frame = telemetry.next().await.expect("the link is up");
            missing.retain(|id| frame.samples.iter().all(|sample| sample.channel() != *id));
        }
    });
}

#[test]
fn a_rotary_motor_finds_its_zero_by_its_switch() {
    let osmc0 = channel(ChannelKind::Osmc, 0);
    bench(&every_interface(), async |bench| {
        bench.host.arm().await.unwrap();
        let Sample::Motor { homed, .. } = sample(bench, osmc0).await else { panic!("a motor") };
        assert!(!homed);
        bench.set(osmc0, Mode::Home, -1.0).await.unwrap();
        let homing = control_of(&mut every_interface().config, 0).homing.expect("it has a switch");
        loop {
            bench.sleep_ms(50).await;
            let Sample::Motor { homed, settled, position, .. } = sample(bench, osmc0).await else { panic!("a motor") };
            if homed && settled {
                let position = f64::from(position) * TAU / 2400.0;
                // It rests at the position that it took as home, within twice its band and a count, which is the
                // allowed slip.
                assert!((position - f64::from(homing.position)).abs() <= 0.008 + TAU / 2400.0, "{position} rad");
                break;
            }
            assert!(bench.clock.now_ns() < 20_000_000_000, "no zero after 20 s");
        }
        // The switch opens at -1 rad; at a fifth of the homing speed the debounce of 5 ms and a period cost 1.2 mrad,
        // and the loop's lag at least as much.
        let truth = bench.position(osmc0);
        assert!((truth - -1.0).abs() < 0.02, "{truth} rad");
        // a position is now the same for host and world
        bench.set(osmc0, Mode::Position, 0.5).await.unwrap();
        // two time constants of 2 s, in which the integral replaces the share of the supply above nominal
        bench.sleep_ms(4000).await;
        assert!((bench.position(osmc0) - 0.5).abs() < 0.02, "{} rad", bench.position(osmc0));
    });
}

#[test]
fn dhb_motors_turn_both_ways_and_stop() {
    bench(&every_interface(), async |bench| {
        bench.host.arm().await.unwrap();
        for index in 0..4 {
            let dhb = channel(ChannelKind::Dhb, index);
            let duty = if index % 2 == 0 { 0.5 } else { -0.5 };
            bench.set(dhb, Mode::Duty, duty).await.unwrap();
        }
        bench.sleep_ms(500).await;
        for index in 0..4 {
            let dhb = channel(ChannelKind::Dhb, index);
            let speed = bench.board.world().speed(dhb).expect("a motor");
            assert!(if index % 2 == 0 { speed > 1.0 } else { speed < -1.0 }, "{dhb}: {speed} rad/s");
            bench.set(dhb, Mode::Duty, if index % 2 == 0 { -0.5 } else { 0.5 }).await.unwrap();
        }
        bench.sleep_ms(500).await;
        for index in 0..4 {
            let dhb = channel(ChannelKind::Dhb, index);
            let speed = bench.board.world().speed(dhb).expect("a motor");
            assert!(if index % 2 == 0 { speed < -1.0 } else { speed > 1.0 }, "{dhb}: {speed} rad/s");
        }
        bench.host.disarm().await.unwrap();
        bench.sleep_ms(10).await;
        assert!((0..4).all(|index| bench.is_off(channel(ChannelKind::Dhb, index))));
    });
}

#[test]
fn servos_go_where_they_are_sent_and_not_faster_than_they_may() {
    let servo = |index| channel(ChannelKind::Servo, index);
    bench(&every_interface(), async |bench| {
        assert!(!bench.board.world().servo(servo(3)).unwrap().is_holding(), "no pulses before the first command");
        assert!(scalar(bench, servo(3)).await.is_nan());
        bench.host.arm().await.unwrap();
        bench.sleep_ms(100).await;
        for index in 0..16 {
            bench.set(servo(index), Mode::Position, 0.7 - 0.09 * f32::from(index)).await.unwrap();
        }
        // the first pulse is the commanded one, limited only by the servo's own speed
        bench.sleep_ms(1000).await;
        for index in 0..16 {
            let angle = bench.position(servo(index));
            // one count of the chip is 4.9 us of 1000 us for 1.57 rad: 7.7 mrad, and the servo's dead band is 2 us
            assert!((angle - (0.7 - 0.09 * f64::from(index))).abs() < 0.012, "{}: {angle} rad", servo(index));
        }
        bench.set(servo(0), Mode::Position, -0.7).await.unwrap();
        bench.sleep_ms(140).await;
        let asked = scalar(bench, servo(0)).await;
        // 5 rad/s for 140 to 160 ms from 0.7 rad
        assert!((-0.15..=0.05).contains(&asked), "{asked} rad");
        bench.host.disarm().await.unwrap();
        bench.sleep_ms(200).await;
        let at_rest = bench.position(servo(0));
        assert!(bench.board.world().servo(servo(0)).unwrap().is_holding(), "this robot's servos hold when safe");
        bench.sleep_ms(500).await;
        assert_eq!(bench.position(servo(0)), at_rest, "but do not move");
    });
}

#[test]
fn brushless_drives_run_reverse_and_brake() {
    let bldc = |index| channel(ChannelKind::Bldc, index);
    bench(&every_interface(), async |bench| {
        let throttle = |index| bench.board.world().throttle_v(bldc(index)).expect("a drive");
        // bldc3 rests at 2.05 V; one code of 5 V is 1.2 mV
        assert!(throttle(0) < 1e-3 && (throttle(3) - 2.05).abs() < 1.3e-3, "{} {}", throttle(0), throttle(3));
        bench.host.arm().await.unwrap();
        for index in [0, 3] {
            bench.set(bldc(index), Mode::Duty, 0.5).await.unwrap();
        }
        bench.sleep_ms(2000).await;
        assert!((throttle(3) - 2.56).abs() < 1.3e-3, "{} V", throttle(3));
        let speed = |index| bench.board.world().speed(bldc(index)).expect("a drive");
        assert!(speed(0) > 1.0 && speed(3) > 1.0, "{} {}", speed(0), speed(3));
        assert_eq!(scalar(bench, bldc(3)).await, 0.5);
        bench.set(bldc(3), Mode::Duty, -0.5).await.unwrap();
        // down, at rest for the time in the robot's file, and up again
        bench.sleep_ms(7000).await;
        assert!(speed(3) < -1.0, "{}", speed(3));
        // a brake in the same period as a speed is accepted
        bench.set(bldc(3), Mode::Brake, 1.0).await.unwrap();
        bench.sleep_ms(1000).await;
        assert!(speed(3).abs() < 0.01 && (throttle(3) - 2.05).abs() < 1.3e-3, "{} {}", speed(3), throttle(3));
        bench.host.stop().await.unwrap();
        bench.sleep_ms(5).await;
        assert!(throttle(0) < 1e-3, "{} V", throttle(0));
    });
}

#[test]
fn steppers_go_where_they_are_sent_and_keep_their_books_over_a_stop() {
    let stepper = |index| channel(ChannelKind::Stepper, index);
    let ((), misuse) = bench_with_misuse(&every_interface(), async |bench| {
        bench.host.arm().await.unwrap();
        for index in 0..4 {
            bench.set(stepper(index), Mode::Position, 3.0 + f32::from(index)).await.unwrap();
        }
        bench.sleep_ms(2500).await;
        for index in 0..4 {
            let truth = bench.position(stepper(index));
            // half a step of 1600 a turn
            assert!((truth - 3.0 - f64::from(index)).abs() <= TAU / 3200.0 + 1e-9, "{}: {truth} rad", stepper(index));
            let Sample::Motor { settled, .. } = sample(bench, stepper(index)).await else { panic!("a stepper") };
            assert!(settled);
        }
        // stopped at full speed: the counters lose no step, though the motor may have
        bench.set(stepper(2), Mode::Speed, -10.0).await.unwrap();
        bench.sleep_ms(400).await;
        bench.host.stop().await.unwrap();
        bench.sleep_ms(10).await;
        let Sample::Motor { position, homed, .. } = sample(bench, stepper(2)).await else { panic!("a stepper") };
        let commanded = bench.board.world().stepper(stepper(2)).unwrap().commanded();
        assert_eq!(i64::from(position), commanded);
        assert!(!homed && commanded < 5 * 1600 / 6, "{commanded} steps");
        assert!(!bench.board.world().stepper(stepper(2)).unwrap().is_enabled());
    });
    // the report of a motor that stops at once from ten times its start-stop speed, and no other
    assert!(misuse.len() == 1 && misuse[0].contains("stepper driver 0x02"), "{misuse:?}");
}

#[test]
fn a_stepper_finds_its_zero() {
    let stepper0 = channel(ChannelKind::Stepper, 0);
    bench(&every_interface(), async |bench| {
        bench.host.arm().await.unwrap();
        bench.set(stepper0, Mode::Home, -2.0).await.unwrap();
        loop {
            bench.sleep_ms(50).await;
            let Sample::Motor { homed, settled, .. } = sample(bench, stepper0).await else { panic!("a stepper") };
            if homed && settled {
                break;
            }
            assert!(bench.clock.now_ns() < 20_000_000_000, "no zero after 20 s");
        }
        bench.set(stepper0, Mode::Position, 1.0).await.unwrap();
        bench.sleep_ms(2000).await;
        // the switch opens at -0.5 rad and backing off is a tenth of 2 rad/s: 5 ms of debounce and a few periods cost 2
        // mrad
        let truth = bench.position(stepper0);
        assert!((truth - 1.0).abs() < 0.01, "{truth} rad");
    });
}

#[test]
fn encoders_and_switches_tell_what_the_world_does() {
    let encoder = |index| channel(ChannelKind::Encoder, index);
    bench(&every_interface(), async |bench| {
        bench.host.arm().await.unwrap();
        for index in 0..4 {
            bench.set(channel(ChannelKind::Osmc, index), Mode::Speed, 2.0).await.unwrap();
        }
        bench.sleep_ms(1500).await;
        for index in 0..4 {
            let Sample::Encoder { position, speed, illegal, .. } = sample(bench, encoder(index)).await else {
                panic!("an encoder")
            };
            let truth = bench.position(channel(ChannelKind::Osmc, index));
            // the sample is up to two of its 5 ms old, plus its transmission: 20 ms at 2 rad/s
            assert!((f64::from(position) * TAU / 2400.0 - truth).abs() < 0.04, "{position} counts, {truth} rad");
            assert!((speed - 2.0).abs() < 0.2, "{speed} rad/s");
            assert_eq!(illegal, 0);
        }
        // two tracks that change at once are no shaft; the timers cannot detect it, the interrupts can
        bench.board.world().pins().encoders[3].lose_edges(1);
        bench.sleep_ms(200).await;
        let Sample::Encoder { illegal, .. } = sample(bench, encoder(3)).await else { panic!("an encoder") };
        assert_eq!(illegal, 1);
        assert_eq!(scalar(bench, channel(ChannelKind::Switch, 0)).await, 0.0);
        bench.host.disarm().await.unwrap();
        bench.board.world().set_position(channel(ChannelKind::Osmc, 0), -1.5);
        bench.sleep_ms(20).await;
        assert_eq!(scalar(bench, channel(ChannelKind::Switch, 0)).await, 1.0);
    });
}

async fn reading(bench: &Bench<'_>, of: ChannelId) -> (f32, u16, Quality) {
    match sample(bench, of).await {
        Sample::Reading { value, age_ms, quality, .. } => (value, age_ms, quality),
        other => panic!("{other:?}"),
    }
}

#[test]
fn range_sensors_measure_and_stop_the_board() {
    let range = |index| channel(ChannelKind::Range, index);
    bench(&every_interface(), async |bench| {
        for (index, distance_m) in [(0, 1.0), (1, 0.1), (2, 3.5)] {
            bench.board.world().range_sensor(index).unwrap().set_distance_m(Some(distance_m));
        }
        bench.board.world().range_sensor(3).unwrap().set_distance_m(None);
        bench.sleep_ms(1500).await;
        for (index, distance_m) in [(0, 1.0), (1, 0.1), (2, 3.5)] {
            let (value, age_ms, quality) = reading(bench, range(index)).await;
            // the echo is timed to 1 us: 0.17 mm
            assert!((value - distance_m).abs() < 1e-3, "{index}: {value} m");
            // four sensors take turns of 60 ms
            assert!(age_ms <= 260 && quality == Quality::Good, "{index}: {age_ms} ms, {quality}");
        }
        assert_eq!(reading(bench, range(3)).await.2, Quality::OutOfRange);
        bench.host.arm().await.unwrap();
        // only range0 stops the board
        bench.board.world().range_sensor(2).unwrap().set_distance_m(Some(0.05));
        bench.sleep_ms(1000).await;
        assert_eq!(bench.safety().await.0, SafetyState::Armed);
        bench.board.world().range_sensor(0).unwrap().set_distance_m(Some(0.2));
        bench.sleep_ms(260).await;
        assert_eq!(bench.safety().await, (SafetyState::Tripped, Causes::only(Cause::Proximity)));
        bench.board.world().range_sensor(0).unwrap().set_distance_m(Some(2.0));
        bench.sleep_ms(1000).await;
        bench.host.clear().await.expect("three readings far away");
        bench.host.arm().await.unwrap();
        // a sensor without readings stops it too
        let now_ns = bench.clock.now_ns();
        let silent = Some(r4_sim::sensors::hc_sr04::HcSr04Fault::Silent);
        bench.board.world().range_sensor(0).unwrap().set_fault(now_ns, silent);
        bench.sleep_ms(3 * 240 + 100).await;
        assert_eq!(bench.safety().await, (SafetyState::Tripped, Causes::only(Cause::Proximity)));
    });
}

#[test]
fn analog_inputs_measure_and_tell_what_is_broken() {
    let analog = |index| channel(ChannelKind::Analog, index);
    bench(&every_interface(), async |bench| {
        for index in 0..4u8 {
            let (value, _, quality) = reading(bench, analog(index)).await;
            // a code is 0.76 mV; noise is filtered to less
            let volts = 5.0 * f32::from(index + 1);
            assert!((value - volts).abs() < 2e-3 && quality == Quality::Good, "{index}: {value} V, {quality}");
        }
        for (index, fault) in [
            (0, r4_sim::sensors::analog_input::AnalogFault::ShortToGround),
            (1, r4_sim::sensors::analog_input::AnalogFault::ShortToRail { volts: 48.0 }),
        ] {
            bench.board.world().pins().analogs[index].as_mut().unwrap().input.fault = Some(fault);
        }
        bench.sleep_ms(100).await;
        assert_eq!(reading(bench, analog(0)).await.2, Quality::Low);
        assert_eq!(reading(bench, analog(1)).await.2, Quality::High);
    });
}

#[test]
fn analog_outputs_follow_while_armed() {
    let dac = |index| channel(ChannelKind::Dac, index);
    bench(&every_interface(), async |bench| {
        let volts = |output| bench.board.world().pins().dac_v(output).unwrap();
        // a code is 0.8 mV
        assert!(volts(0) < 1e-3 && (volts(1) - 1.65).abs() < 1e-3, "{} {}", volts(0), volts(1));
        assert!(bench.set(dac(0), Mode::Voltage, 1.2).await.is_err(), "not armed");
        bench.host.arm().await.unwrap();
        bench.set(dac(0), Mode::Voltage, 1.2).await.unwrap();
        assert!(bench.set(dac(1), Mode::Voltage, 3.0).await.is_err(), "out of its range");
        bench.set(dac(1), Mode::Voltage, 2.8).await.unwrap();
        bench.sleep_ms(5).await;
        assert!((volts(0) - 1.2).abs() < 1e-3 && (volts(1) - 2.8).abs() < 1e-3, "{} {}", volts(0), volts(1));
        assert_eq!(scalar(bench, dac(1)).await, 2.8);
        bench.host.disarm().await.unwrap();
        bench.sleep_ms(5).await;
        assert!(volts(0) < 1e-3 && (volts(1) - 1.65).abs() < 1e-3, "{} {}", volts(0), volts(1));
    });
}

#[test]
fn the_auxiliary_stop_trips_and_lights_tell_the_state() {
    bench(&every_interface(), async |bench| {
        let lights = |red, green| r4_sim::Lights { red, green, blue: true };
        assert_eq!(bench.board.lights(), lights(false, false));
        bench.host.arm().await.unwrap();
        bench.sleep_ms(20).await;
        assert_eq!(bench.board.lights(), lights(false, true));
        bench.board.auxiliary_stop().set(false);
        bench.sleep_ms(2).await;
        assert_eq!(bench.board.lights(), lights(true, false));
        assert_eq!(bench.safety().await, (SafetyState::Tripped, Causes::only(Cause::AuxiliaryStop)));
        assert!(bench.host.clear().await.is_err(), "still pressed");
        assert_eq!(scalar(bench, channel(ChannelKind::DeadMan, 1)).await, 0.0);
        bench.board.auxiliary_stop().set(true);
        bench.sleep_ms(50).await;
        bench.host.clear().await.unwrap();
        assert_eq!(bench.board.lights(), lights(false, false));
        // the supervisor kicks each ms, independent of everything else
        let now_ns = bench.clock.now_ns();
        assert!(bench.board.world().pins().longest_kick_ns(now_ns) <= 2_000_000);
    });
}

#[test]
fn servos_that_hold_do_not_follow_a_command_of_before_the_stop() {
    let servo = |index| channel(ChannelKind::Servo, index);
    bench(&every_interface(), async |bench| {
        bench.host.arm().await.unwrap();
        bench.sleep_ms(100).await;
        for index in 0..16 {
            bench.set(servo(index), Mode::Position, 0.7).await.unwrap();
        }
        // their pulses are written one per period: most of them have none yet
        bench.board.dead_man().set(false);
        bench.sleep_ms(50).await;
        bench.board.dead_man().set(true);
        bench.sleep_ms(50).await;
        let here = |index| bench.position(servo(index));
        let before: Vec<_> = (0..16).map(here).collect();
        assert!(before.contains(&0.0), "some have not been told anything: {before:?}");
        bench.sleep_ms(1000).await;
        bench.host.clear().await.unwrap();
        let before: Vec<_> = (0..16).map(here).collect();
        bench.host.arm().await.unwrap();
        bench.sleep_ms(1000).await;
        assert_eq!((0..16).map(here).collect::<Vec<_>>(), before);
    });
}

#[test]
fn an_arming_begins_with_nothing_of_the_last_one() {
    let bldc0 = channel(ChannelKind::Bldc, 0);
    let dhb0 = channel(ChannelKind::Dhb, 0);
    bench(&every_interface(), async |bench| {
        // for any phase of the two requests in the control loop, also while it is late
        for phase in 0..40 {
            bench.host.arm().await.unwrap();
            bench.sleep_ms(60).await;
            bench.set(bldc0, Mode::Duty, 0.5).await.unwrap();
            bench.set(dhb0, Mode::Duty, 0.5).await.unwrap();
            bench.sleep_ms(100).await;
            assert!(bench.board.world().throttle_v(bldc0).unwrap() > 0.1);
            bench.board.world().bus.set_rate_hz(60_000);
            bench.clock.sleep(2_000_000 + 97_000 * phase).await;
            let (disarmed, armed) = both(bench.host.disarm(), bench.host.arm()).await;
            bench.board.world().bus.set_rate_hz(400_000);
            disarmed.unwrap();
            armed.unwrap();
            bench.sleep_ms(20).await;
            let world = &mut bench.board.world();
            assert!(world.throttle_v(bldc0).unwrap() < 1e-3, "phase {phase}");
            assert_eq!(world.drive(dhb0).unwrap().duty, 0.0, "phase {phase}");
        }
    });
}

#[test]
fn a_brake_released_with_a_speed_leaves_the_speed() {
    let bldc0 = channel(ChannelKind::Bldc, 0);
    bench(&every_interface(), async |bench| {
        bench.host.arm().await.unwrap();
        bench.sleep_ms(60).await;
        bench.set(bldc0, Mode::Brake, 1.0).await.unwrap();
        bench.sleep_ms(10).await;
        let (released, driven) = both(bench.set(bldc0, Mode::Brake, 0.0), bench.set(bldc0, Mode::Duty, 0.5)).await;
        released.and(driven).unwrap();
        bench.sleep_ms(1000).await;
        assert_eq!(scalar(bench, bldc0).await, 0.5);
    });
}
