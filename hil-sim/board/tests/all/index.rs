//! Index pulses of an encoder on the simulated bench: homing by them, and lost counts.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::f64::consts::TAU;

use r4_boards::Robot;
use r4_protocol::{
    Cause, ChannelId, ChannelKind, Mode, SafetyState, Sample,
    config::{Feedback, HomingConfig, SwitchConfig},
};

use crate::harness::{Bench, ROTARY, bench, control_of, osmc_bench};

/// One encoder count of the bench, rad.
const COUNT_RAD: f64 = TAU / 2400.0;
/// Counts per index pulse: a disc on the motor side of an 8:1 gear.
const COUNTS_PER_INDEX: u32 = 300;
/// Configured position of the index pulse, rad.
const HOME_RAD: f32 = 0.5;

/// The bench with an encoder whose index pulse is wired to its switch pin, found at up to 2.5 rad/s.
fn robot() -> Robot {
    let mut robot = osmc_bench();
    robot.config.switches.clear();
    let switch = SwitchConfig { id: ChannelId::new(ChannelKind::Switch, 0), active_low: false };
    robot.config.switches.push(switch).unwrap();
    let control = control_of(&mut robot.config, 0);
    let Feedback::Encoder { counts_per_index, .. } = &mut control.feedback else { panic!("an encoder") };
    *counts_per_index = COUNTS_PER_INDEX;
    control.homing = Some(HomingConfig { switch: 0, position: HOME_RAD, speed_max: 2.5 });
    robot
}

/// Reported position, counts, and the homed flag.
async fn told(bench: &Bench<'_>) -> (i32, bool) {
    let mut samples = bench.host.samples(ROTARY, 1).await.unwrap();
    match samples.next().await.unwrap().sample {
        Sample::Motor { position, homed, .. } => (position, homed),
        other => panic!("a motor: {other:?}"),
    }
}

/// From several positions, in both directions, slowly and at the bench's highest speed: the same place of the disc, to
/// the count.
#[test]
fn the_zero_by_index_is_the_same_to_a_count() {
    let mut zeros = Vec::new();
    for (start, speed) in [(0.1, 0.3), (0.3, 2.5), (0.3, -0.3), (0.6, -2.5), (-0.4, 1.0)] {
        let zero = bench(&robot(), async |bench| {
            bench.board.world().set_position(ROTARY, start);
            bench.sleep_ms(50).await;
            bench.host.arm().await.unwrap();
            bench.set(ROTARY, Mode::Home, speed).await.unwrap();
            bench.sleep_ms(6000).await;
            let (position, homed) = told(bench).await;
            assert!(homed, "{start} {speed}");
            // the board rests at the pulse's configured position, within the settling error
            assert!((f64::from(position) * COUNT_RAD - f64::from(HOME_RAD)).abs() < 0.004 + COUNT_RAD, "{position}");
            // offset of the board's count from the shaft's true one, on the disc
            let true_count = (bench.position(ROTARY) / COUNT_RAD).floor() as i32;
            (true_count - position).rem_euclid(COUNTS_PER_INDEX as i32)
        });
        zeros.push(zero);
    }
    // The pulse is at true count 0, and its configured position is 0.5 rad: 191 counts. A backlash in between would add
    // its own.
    let exact = (-191i32).rem_euclid(COUNTS_PER_INDEX as i32);
    assert!(zeros.iter().all(|zero| (zero - exact).abs() <= 1), "{zeros:?}, not {exact}");
}

/// Two lines of the disc that the counter missed: at the next pulse the board stops, and is no longer homed.
#[test]
fn lost_lines_are_seen_within_a_turn_of_the_disc() {
    bench(&robot(), async |bench| {
        bench.sleep_ms(50).await;
        bench.host.arm().await.unwrap();
        bench.set(ROTARY, Mode::Home, 1.0).await.unwrap();
        bench.sleep_ms(4000).await;
        assert!(told(bench).await.1);
        bench.set(ROTARY, Mode::Speed, 2.0).await.unwrap();
        // several turns of the disc at full speed without a loss
        bench.sleep_ms(3000).await;
        assert_eq!(bench.safety().await.0, SafetyState::Armed);
        bench.board.world().pins().encoders[0].lose_edges(8);
        // a turn of the disc takes 0.4 s
        bench.sleep_ms(500).await;
        let (state, causes) = bench.safety().await;
        assert_eq!(state, SafetyState::Tripped);
        assert!(causes.contains(Cause::EncoderImplausible), "{causes:?}");
        assert!(!told(bench).await.1);
    });
}
