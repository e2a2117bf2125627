//! Position feedback of motors in the image: index pulses, and an absolute angle sensor on the bus and by its pulses.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::f64::consts::TAU;

use crate::emulated::{Emu, Setup, image};
use r4_protocol::{ChannelId, ChannelKind, Mode, SafetyState, Sample};

const ROBOT: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/robots/feedback-bench.toml");

const fn motor(index: u8) -> ChannelId {
    ChannelId::new(ChannelKind::Osmc, index)
}

/// Returns the reported position in counts, and the flags settled and homed.
async fn told(emu: &Emu<'_>, channel: ChannelId) -> (i32, bool, bool) {
    let mut samples = emu.host.samples(channel, 1).await.unwrap();
    match samples.next().await.unwrap().sample {
        Sample::Motor { position, settled, homed, .. } => (position, settled, homed),
        other => panic!("a motor: {other:?}"),
    }
}

/// Two motors seek their index pulses, one upwards and one downwards, while two with angle sensors move to a position.
///
/// The zero of the index pulses is that of the simulated board (its tests' `index.rs`): the pulse is at true count 0 on
/// a disc of 300, and is configured to be at 0.5 rad, 191 counts.
#[test]
fn motors_find_their_zeros_and_places_by_every_sensor() {
    let setup = Setup::of(r4_boards::load(ROBOT).unwrap(), image("feedback-bench", "bare"));
    setup.bench(async |emu| {
        for (index, start) in [(2, 2.0), (3, 2.0)] {
            let (position, _, homed) = told(emu, motor(index)).await;
            let position = f64::from(position) * TAU / 4096.0;
            // The tolerance covers noise, rounding to a count, and the rounding of a frame's pulse.
            assert!(homed && (position - start).abs() < 4.0 * TAU / 4096.0, "osmc{index}: {position} rad");
        }
        emu.host.arm().await.unwrap();
        emu.set(motor(0), Mode::Home, 1.0).await.unwrap();
        emu.set(motor(1), Mode::Home, -1.0).await.unwrap();
        emu.set(motor(2), Mode::Position, 1.0).await.unwrap();
        emu.set(motor(3), Mode::Position, 1.0).await.unwrap();
        emu.sleep_ms(3500).await;
        let (state, causes) = emu.safety().await;
        assert_eq!(state, SafetyState::Armed, "{causes}");
        for index in [0, 1] {
            let (position, settled, homed) = told(emu, motor(index)).await;
            assert!(settled && homed, "osmc{index}: {position} counts");
            let true_count = (emu.position(motor(index)) / TAU * 2400.0).floor() as i32;
            let zero = (true_count - position).rem_euclid(300);
            assert!((zero - (300 - 191)).abs() <= 1, "osmc{index}: {zero}");
        }
        for index in [2, 3] {
            let (position, settled, _) = told(emu, motor(index)).await;
            let truth = emu.position(motor(index));
            let shown = f64::from(position) * TAU / 4096.0;
            println!("osmc{index}: {truth:.4} rad, shown {shown:.4}");
            assert!(settled && (shown - truth).abs() < 4.0 * TAU / 4096.0, "osmc{index}: {shown}, {truth}");
            // The tolerance is twice the settling error, to which a resting motor may be pushed, and the noise of a
            // reading.
            assert!((truth - 1.0).abs() < 0.008 + 3.0 * TAU / 4096.0, "osmc{index}: {truth}");
        }
    });
}
