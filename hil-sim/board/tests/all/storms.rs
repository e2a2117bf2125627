//! Storms of edges on inputs that interrupts count, by the firmware's own rules; the emulated processor tests their
//! load.

use std::f32::consts::TAU;

use r4_firmware::sensing::storm::ENCODER_EDGES_PER_MS;
use r4_protocol::{Cause, ChannelId, ChannelKind, Mode, SafetyState, config::Feedback};
use r4_sim::sensors::{interference::SquareWave, quadrature::Channel};

use crate::harness::{Bench, MS, US, bench};

const MOTOR: ChannelId = ChannelId::new(ChannelKind::Osmc, 0);

async fn armed(bench: &Bench<'_>) {
    bench.host.arm().await.expect("nothing is wrong yet");
    bench.set(MOTOR, Mode::Duty, 0.5).await.expect("armed");
    bench.sleep_ms(100).await;
}

/// A wave of 20 ms that starts now.
fn wave(bench: &Bench<'_>, half_period_ns: u64) -> SquareWave {
    let from_ns = bench.clock.now_ns();
    SquareWave { from_ns, until_ns: from_ns + 20 * MS, half_period_ns }
}

/// The budget of a motor's encoder is at least four times its edge rate at the motor's highest speed, in each robot.
#[test]
fn the_fastest_encoder_of_a_robot_is_no_storm() {
    let mut fastest = 0.0_f32;
    for name in r4_boards::names() {
        let robot = r4_boards::load(name).expect("built in");
        for control in robot.config.motors.iter().filter_map(|motor| motor.control) {
            if let Feedback::Encoder { counts_per_turn, .. } = control.feedback {
                fastest = fastest.max(control.speed_max / TAU * counts_per_turn as f32 * 1e-3);
            }
        }
    }
    // cable-loop: 8192 counts at 14 rad/s
    assert!((18.0..19.0).contains(&fastest), "{fastest} counts a ms");
    assert!(4.0 * fastest <= ENCODER_EDGES_PER_MS as f32);
}

#[test]
fn each_input_trips_by_its_storm() {
    bench(&r4_boards::load("every-interface").expect("built in"), async |bench| {
        for input in 0..6 {
            armed(bench).await;
            let wave = wave(bench, US);
            match input {
                0 => bench.board.world().pins().encoders[3].set_interference(Channel::A, wave),
                1 => bench.board.world().pins().encoders[3].set_interference(Channel::B, wave),
                _ => bench.board.world().pins().rangers.modules[input - 2].set_interference(wave),
            }
            bench.sleep_ms(5).await;
            assert!(bench.is_off(MOTOR), "input {input}");
            let (state, causes) = bench.safety().await;
            assert!(state == SafetyState::Tripped && causes.contains(Cause::InterruptStorm), "input {input}: {causes}");
            assert!(bench.host.clear().await.is_err(), "input {input}: edges are lost yet");
            // a second until the input is enabled again, and a turn of the range sensors
            bench.sleep_ms(1700).await;
            bench.host.clear().await.expect("the storm is over");
        }
    });
}

/// Both tracks change at once, 2000 times a second: shorted tracks beside a wire that couples into both.
#[test]
fn illegal_transitions_trip_by_feedback_implausible() {
    bench(&r4_boards::load("every-interface").expect("built in"), async |bench| {
        armed(bench).await;
        let wave = wave(bench, 500 * US);
        for track in [Channel::A, Channel::B] {
            bench.board.world().pins().encoders[3].set_interference(track, wave);
        }
        bench.sleep_ms(10).await;
        assert!(bench.is_off(MOTOR));
        let (state, causes) = bench.safety().await;
        assert_eq!(state, SafetyState::Tripped);
        assert!(causes.contains(Cause::EncoderImplausible) && !causes.contains(Cause::InterruptStorm), "{causes}");
    });
}

/// Inputs that the bench does not use.
#[test]
fn an_unused_input_has_no_storm() {
    bench(&r4_boards::load("osmc-bench").expect("built in"), async |bench| {
        armed(bench).await;
        let wave = wave(bench, US);
        bench.board.world().pins().encoders[3].set_interference(Channel::A, wave);
        bench.board.world().pins().rangers.modules[0].set_interference(wave);
        assert_eq!(bench.safety().await.0, SafetyState::Armed);
    });
}
