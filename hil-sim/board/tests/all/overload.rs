//! Overload protection of motors on the simulated robots: trips of blocked motors, and no trips in normal work.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use crate::{
    harness::{Bench, HostClock, MS, bench, plant_with},
    restart::Restarts,
};
use r4_boards::{Robot, SimulatedAnalog};
use r4_driver::Board;
use r4_firmware::{ResetCause, control::overload::COOLED};
use r4_plants::{Effect, Plant, effect::friction::CoulombFriction};
use r4_protocol::{
    Cause, Causes, ChannelId, ChannelKind, HotWinding, Mode, Range, SafetyState, Sample, Setpoint, Winding,
    config::{AnalogConfig, CurrentSense},
};
use r4_sim::Clock;

const WHEEL: ChannelId = ChannelId::new(ChannelKind::Dhb, 0);
/// Friction that none of the motors overcomes, N m.
const BLOCKED_NM: f64 = 1e4;

fn openscout() -> Robot {
    r4_boards::load("openscout").expect("built in")
}

fn block(bench: &Bench<'_>, robot: &Robot, channel: ChannelId) {
    let friction = CoulombFriction { level: BLOCKED_NM };
    bench.device().add_effect(robot, channel, Effect::CoulombFriction(friction));
}

/// Time from setting `duty` on a blocked `channel` to the trip, s; `None` if there is none within `limit_s`.
async fn trips_after(bench: &Bench<'_>, channel: ChannelId, duty: f32, limit_s: f64) -> Option<f64> {
    if bench.host.safety().0 != SafetyState::Armed {
        bench.host.arm().await.unwrap();
    }
    bench.set(channel, Mode::Duty, duty).await.unwrap();
    let since_ns = bench.clock.now_ns();
    let after_s = || (bench.clock.now_ns() - since_ns) as f64 * 1e-9;
    while bench.host.safety().0 != SafetyState::Tripped {
        if after_s() > limit_s {
            return None;
        }
        bench.sleep_ms(5).await;
    }
    let after_s = after_s();
    assert_eq!(bench.safety().await.1, Causes::only(Cause::Overload), "duty {duty}");
    Some(after_s)
}

/// Predicted time of the trip, s: the heat follows `(i / rated)²` with a lag, from the value assumed at a restart.
fn predicted_s(robot: &Robot, channel: ChannelId, duty: f32, supply_v: f32) -> Option<f64> {
    let winding = robot.config.motors.iter().find(|motor| motor.id == channel)?.winding?;
    let current_a = f64::from((duty.abs() - winding.dead_duty) * supply_v / winding.resistance_ohm);
    let settled = (current_a / f64::from(winding.rated_a)).powi(2);
    (settled > 1.0).then(|| f64::from(winding.thermal_s) * ((settled - COOLED) / (settled - 1.0)).ln())
}

/// Below the duty of a stall, overload is the only protection of a motor with an open-loop duty.
#[test]
fn a_blocked_wheel_trips_when_its_heat_is_predicted_to_reach_the_limit() {
    let robot = openscout();
    let duties = [0.20, 0.30, 0.35, -0.45, 0.59];
    let tripped = duties.map(|duty| {
        bench(&robot, async |bench| {
            block(bench, &robot, WHEEL);
            trips_after(bench, WHEEL, duty, 20.0).await
        })
    });
    for (duty, tripped_s) in duties.into_iter().zip(tripped) {
        // 12.6 V minus the drop on 0.05 ohm by the motor's share of the current: within 0.5 %. Half a second for relay,
        // slew and heartbeats until the host is informed.
        let predicted_s = predicted_s(&robot, WHEEL, duty, 12.6);
        println!("duty {duty}: tripped after {tripped_s:?} s, predicted {predicted_s:?} s");
        match (tripped_s, predicted_s) {
            (None, None) => {}
            (Some(tripped_s), Some(predicted_s)) => {
                let [soonest_s, latest_s] = [predicted_s, 1.03 * predicted_s + 0.3];
                assert!((soonest_s..=latest_s).contains(&tripped_s), "duty {duty}: {tripped_s} s, not {predicted_s} s");
            }
            other => panic!("duty {duty}: {other:?}"),
        }
    }
    assert_eq!(tripped[0], None, "1.15 A are less than the rated current");
}

/// Every motor back and forth without a rest at the speed of its path, as in a robot's daily work, on a board that has
/// just started, with motors that count as hot.
#[test]
fn normal_work_of_every_robot_never_trips() {
    for name in ["osmc-bench", "openscout", "openagribot", "openpodcar"] {
        let robot = r4_boards::load(name).expect("built in");
        bench(&robot, async |bench| {
            bench.host.arm().await.unwrap();
            for cycle in 0..6 {
                let sign = if cycle % 2 == 0 { 1.0 } else { -1.0 };
                for motor in &robot.config.motors {
                    let Some(control) = motor.control else { continue };
                    let (mode, value) = if control.feedback.turns() {
                        (Mode::Speed, sign * control.profile.speed)
                    } else {
                        let Range { min, max } = control.position;
                        (Mode::Position, min + (0.5 + 0.2 * sign) * (max - min))
                    };
                    bench.set(motor.id, mode, value).await.unwrap();
                }
                bench.sleep_ms(2000).await;
            }
            assert_eq!(bench.safety().await, (SafetyState::Armed, Causes::NONE), "{name}");
        });
    }
}

/// Brakes a driving wheel of openagribot hard on a supply that cannot take energy back. Returns the highest voltage of
/// the rail, and the supervisor's state afterwards.
fn brakes(robot: &Robot) -> (f64, SafetyState) {
    let rail = ChannelId::new(ChannelKind::Supply, 0);
    let wheel = ChannelId::new(ChannelKind::Osmc, 0);
    bench(robot, async |bench| {
        bench.host.arm().await.unwrap();
        bench.set(wheel, Mode::Duty, 0.8).await.unwrap();
        bench.sleep_ms(1000).await;
        bench.set(wheel, Mode::Duty, 0.2).await.unwrap();
        let mut highest_v = 0.0;
        for _ in 0..1000 {
            bench.sleep_ms(1).await;
            highest_v = f64::max(highest_v, bench.board.world().rail_v(rail).expect("the robot has it"));
        }
        (highest_v, bench.safety().await.0)
    })
}

/// The energy of the wheel charges the rail's capacitance. Without the limit the board trips, and the vehicle coasts.
#[test]
fn braking_on_a_supply_that_takes_nothing_back_stays_below_the_trip() {
    let mut robot = r4_boards::load("openagribot").expect("built in");
    robot.simulation.rails[0].capacitance_f = Some(0.010);
    let limited = brakes(&robot);
    robot.config.supplies[0].regeneration_v = None;
    let unlimited = brakes(&robot);
    println!("limited {limited:?}, unlimited {unlimited:?}");
    assert_eq!(unlimited.1, SafetyState::Tripped);
    assert_eq!(limited.1, SafetyState::Armed);
    let trip_v = f64::from(robot.config.supplies[0].range_v.max);
    assert!(limited.0 < trip_v && unlimited.0 > trip_v, "{limited:?} {unlimited:?}");
}

/// The openscout with a Hall sensor of 0.5 V/A around 2.5 V for its first wheel.
fn with_current_sensor() -> Robot {
    let mut robot = openscout();
    let channel = ChannelId::new(ChannelKind::Analog, 0);
    let supply = robot.config.supplies[0];
    let analog = AnalogConfig {
        id: channel,
        volts_per_code: supply.volts_per_code,
        offset_v: 0.0,
        plausible_v: Range::new(0.2, 4.8),
    };
    robot.config.analogs.push(analog).expect("it has none yet");
    let volts_per_code = f64::from(supply.volts_per_code);
    robot.simulation.analogs.push(SimulatedAnalog {
        channel,
        volts: 2.5,
        volts_per_code,
        noise_rms_codes: 2.3,
        field: None,
        reads: None,
    });
    let winding = robot.config.motors[0].winding.as_mut().expect("measured motors have one");
    winding.current_sense = Some(CurrentSense { analog: 0, zero_v: 2.5, volts_per_a: 0.5 });
    robot
}

fn sense(bench: &Bench<'_>, volts: f64) {
    bench.board.world().pins().analogs[0].as_mut().expect("the sensor's").volts = volts;
}

/// A valid current sensor replaces the current that is computed from the duty.
#[test]
fn a_measured_current_takes_the_place_of_the_computed_one() {
    let robot = with_current_sensor();
    let tripped = |volts: f64, duty: f32| {
        bench(&robot, async |bench| {
            block(bench, &robot, WHEEL);
            bench.host.arm().await.unwrap();
            sense(bench, volts);
            trips_after(bench, WHEEL, duty, 5.0).await
        })
    };
    // Twice the rated current: 40 s ln((4 - 0.8) / (4 - 1)) = 2.58 s. Reading and heartbeats take 0.3 s at most, as
    // above.
    let twice = tripped(2.5 + 0.5 * 2.8, 0.1);
    assert!(twice.is_some_and(|after_s| (2.5..2.9).contains(&after_s)), "{twice:?}");
    // A reading of 0 A is used at any duty; with its wire cut, the current is computed again.
    let duty = 0.5;
    let predicted_s = predicted_s(&robot, WHEEL, duty, 12.6).expect("more than the rated current");
    assert!(predicted_s < 4.0, "{predicted_s} s");
    assert_eq!(tripped(2.5, duty), None);
    let broken = tripped(0.0, duty);
    assert!(broken.is_some_and(|after_s| (predicted_s..predicted_s + 0.3).contains(&after_s)), "{broken:?}");
}

/// Reported state of a motor's winding.
async fn winding(host: &Board<HostClock>, channel: ChannelId) -> Winding {
    let mut telemetry = host.telemetry();
    host.subscribe(channel, 5).await.unwrap();
    let frame = telemetry.next().await.unwrap();
    host.subscribe(channel, 0).await.unwrap();
    let heat = frame.samples.iter().find_map(|sample| match *sample {
        Sample::Motor { channel: of, winding, .. } if of == channel => winding,
        _ => None,
    });
    heat.expect("every motor of openscout has a winding")
}

/// Warms a blocked wheel of openscout by the current of `duty` until it has this heat, %.
async fn warm(host: &Board<HostClock>, clock: &Clock, duty: f32, heat_percent: u8) {
    host.arm().await.unwrap();
    while winding(host, WHEEL).await.heat_percent < heat_percent {
        assert_eq!(host.safety(), (SafetyState::Armed, Causes::NONE));
        host.set(WHEEL, Setpoint { mode: Mode::Duty, value: duty }).await.unwrap();
        clock.sleep(20 * MS).await;
    }
}

/// The board with a blocked first wheel.
fn blocked(robot: &Robot) -> Restarts {
    let board = Restarts::new(robot);
    let plant = plant_with(robot, WHEEL, Effect::CoulombFriction(CoulombFriction { level: BLOCKED_NM }));
    board.board.world().set_plant(WHEEL, Plant::new(&plant, 1));
    board
}

/// Hosts are warned before the trip, in heartbeats and in telemetry; the warning ends after the trip.
#[test]
fn a_warning_comes_before_the_trip_and_ends_when_the_winding_has_cooled() {
    let robot = openscout();
    blocked(&robot).session(async |host, _, clock| {
        assert_eq!(winding(host, WHEEL).await, Winding { heat_percent: 79, hot: false }, "80 %, and it cools");
        warm(host, clock, 0.35, 92).await;
        let Winding { heat_percent, hot } = winding(host, WHEEL).await;
        assert!(hot && (92..=94).contains(&heat_percent), "{heat_percent} %");
        clock.sleep(60 * MS).await;
        let told = host.hot_windings();
        assert!(matches!(told[..], [HotWinding { channel: WHEEL, heat_percent: 92..=94 }]), "{told:?}");
        while host.safety().0 == SafetyState::Armed {
            host.set(WHEEL, Setpoint { mode: Mode::Duty, value: 0.5 }).await.ok();
            clock.sleep(50 * MS).await;
        }
        assert_eq!(host.safety(), (SafetyState::Tripped, Causes::only(Cause::Overload)));
        assert!(winding(host, WHEEL).await.heat_percent >= 99);
        let mut ended_at = None;
        for _ in 0..400 {
            clock.sleep(100 * MS).await;
            let Winding { heat_percent, hot } = winding(host, WHEEL).await;
            assert!(hot || heat_percent < 85, "{heat_percent} %");
            if !hot {
                ended_at = Some(heat_percent);
                break;
            }
        }
        assert_eq!(ended_at, Some(84));
        clock.sleep(60 * MS).await;
        assert_eq!(host.hot_windings(), []);
    });
}

/// For any kind of reset the winding is as hot after it as before.
#[test]
fn heat_outlives_a_reset() {
    let robot = openscout();
    for cause in [ResetCause::Normal, ResetCause::Watchdog, ResetCause::Clock] {
        let mut board = blocked(&robot);
        let before = board.session(async |host, _, clock| {
            warm(host, clock, 0.35, 90).await;
            winding(host, WHEEL).await
        });
        assert!(before.hot && (90..=91).contains(&before.heat_percent), "{before:?}");
        board.restart(cause);
        let (after, other) = board.session(async |host, _, _| {
            let other = winding(host, ChannelId::new(ChannelKind::Dhb, 1)).await;
            (winding(host, WHEEL).await, other)
        });
        // 0.05 % of rounding up, and some 20 ms of cooling in 40 s
        assert!(after.hot && before.heat_percent.abs_diff(after.heat_percent) <= 1, "{cause:?}: {before:?}, {after:?}");
        assert!(other.heat_percent < 80 && !other.hot, "{cause:?}: {other:?} of a motor that has cooled");
    }
}

/// A reset is no way around a trip: the winding still has to cool.
#[test]
fn a_reset_does_not_end_an_overload() {
    let robot = openscout();
    let mut board = blocked(&robot);
    board.session(async |host, _, clock| {
        warm(host, clock, 0.45, 95).await;
        while host.safety().0 == SafetyState::Armed {
            clock.sleep(10 * MS).await;
        }
    });
    board.restart(ResetCause::Normal);
    board.session(async |host, _, _| {
        let refused = host.arm().await;
        assert!(refused.is_err(), "armed with a winding at {:?}", winding(host, WHEEL).await);
        let (state, causes) = host.safety();
        assert_eq!((state, causes), (SafetyState::Tripped, Causes::only(Cause::Overload)));
        assert!(host.clear().await.is_err());
    });
}

/// A damaged word that the processor kept: the motor starts as after power-on, and the others keep their heat.
#[test]
fn a_damaged_word_is_not_taken_for_a_heat() {
    let robot = openscout();
    let mut board = blocked(&robot);
    board.session(async |host, board, clock| {
        warm(host, clock, 0.35, 90).await;
        *board.world().kept_word(1).expect("it is kept") ^= 1 << 30;
    });
    board.restart(ResetCause::Watchdog);
    board.session(async |host, _, _| {
        assert!(winding(host, WHEEL).await.heat_percent >= 89);
        let other = winding(host, ChannelId::new(ChannelKind::Dhb, 1)).await;
        assert_eq!((other.heat_percent, other.hot), (79, false));
    });
}
