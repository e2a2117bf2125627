//! The stop watch, and the truth of its results for steppers while other outputs change.

use crate::harness::{MS, US, bench, bench_with_misuse};
use r4_protocol::{ChannelId, ChannelKind, Mode};
use r4_sim::stop::{Outputs, StopWatch};

const fn channel(kind: ChannelKind, index: u8) -> ChannelId {
    ChannelId::new(kind, index)
}

/// Bridges that changed their outputs in every PWM period once made drivers lose the pulses in between.
#[test]
fn steppers_take_every_pulse_while_bridges_change() {
    let robot = r4_boards::load("every-interface").expect("built in");
    bench(&robot, async |bench| {
        bench.host.arm().await.unwrap();
        bench.set(channel(ChannelKind::Osmc, 0), Mode::Speed, 2.0).await.unwrap();
        for index in 0..4 {
            bench.set(channel(ChannelKind::Stepper, index), Mode::Position, 2.0).await.unwrap();
        }
        bench.sleep_ms(2000).await;
        for index in 0..4 {
            let stepper = channel(ChannelKind::Stepper, index);
            // 2 rad at 1600 steps a turn: 509.3
            assert_eq!(bench.board.world().stepper(stepper).expect("a stepper").commanded(), 509, "{stepper}");
        }
    });
}

#[test]
fn tells_since_when_each_kind_is_safe() {
    let robot = r4_boards::load("every-interface").expect("built in");
    bench_with_misuse(&robot, async |bench| {
        let mut watch = StopWatch::new(&bench.board);
        bench.sleep_ms(100).await;
        watch.look(&bench.board);
        let safe = |watch: &StopWatch| Outputs::ALL.map(|outputs| watch.safe_since_ns(outputs).is_some());
        assert_eq!(safe(&watch), [true; 7], "not armed");
        bench.host.arm().await.unwrap();
        bench.sleep_ms(60).await;
        bench.set(channel(ChannelKind::Stepper, 0), Mode::Speed, 10.0).await.unwrap();
        bench.set(channel(ChannelKind::Dhb, 1), Mode::Duty, 0.5).await.unwrap();
        bench.set(channel(ChannelKind::Bldc, 3), Mode::Duty, 0.5).await.unwrap();
        bench.set(channel(ChannelKind::Dac, 1), Mode::Voltage, 1.0).await.unwrap();
        bench.set(channel(ChannelKind::Servo, 5), Mode::Position, -0.7).await.unwrap();
        bench.sleep_ms(5).await;
        bench.set(channel(ChannelKind::Servo, 5), Mode::Position, 0.7).await.unwrap();
        bench.sleep_ms(200).await;
        watch.look(&bench.board);
        bench.sleep_ms(10).await;
        watch.look(&bench.board);
        assert_eq!(safe(&watch), [false; 7], "everything moves");
        let released_ns = bench.clock.now_ns();
        bench.board.dead_man().set(false);
        while bench.clock.now_ns() < released_ns + 10 * MS {
            bench.clock.sleep(20 * US).await;
            watch.look(&bench.board);
        }
        let after_ns = |outputs| watch.safe_since_ns(outputs).map(|at_ns| at_ns - released_ns);
        assert_eq!(after_ns(Outputs::Bridges), Some(20 * US), "the first look after the line");
        for outputs in Outputs::ALL {
            assert!(after_ns(outputs).is_some_and(|ns| ns <= 5 * MS), "{outputs}: {:?} ns", after_ns(outputs));
        }
        // the chips are written one after the other
        assert!(after_ns(Outputs::MotorPower) < after_ns(Outputs::BridgeChips));
        assert!(after_ns(Outputs::BridgeChips) < after_ns(Outputs::Bldcs));
    });
}
