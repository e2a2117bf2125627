//! Paths of dated points on the simulated bench: tracking error, and the end of a path.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use std::f64::consts::TAU;

use r4_driver::Error;
use r4_protocol::{ChannelId, Mode, PathPoint, Refusal, Sample, Setpoint, config::ProfileLimits};

use crate::harness::{Bench, LINEAR, ROTARY, US, bench, osmc_bench};

/// One encoder count of the bench, rad.
const COUNT_RAD: f64 = TAU / 2400.0;
/// Largest distance from its target at which a motor may rest, rad.
const SETTLE_RAD: f64 = 0.0027;

/// A point of a path at `at_us`.
fn point(at_us: u64, position: f64) -> PathPoint {
    PathPoint { at_us, position: position as f32, speed: None, feed_forward: 0.0 }
}

/// Position of a path at a time of the board, µs.
type Law<'l> = &'l dyn Fn(u64) -> f64;

/// Streams `law` to `channel` every `every_ms`, `ahead_ms` ahead, for `for_ms`; returns the distance of each of its
/// samples from the law, with the board's time.
async fn streamed(
    bench: &Bench<'_>,
    channel: ChannelId,
    law: Law<'_>,
    [every_ms, ahead_ms, for_ms]: [u64; 3],
) -> Vec<(u64, f64)> {
    let resolution = f64::from(bench.host.channel(channel).unwrap().resolution);
    let mut samples = bench.host.samples(channel, 1).await.unwrap();
    let mut seen = Vec::new();
    let begin_us = bench.host.device_us();
    let mut next_us = begin_us + ahead_ms * 1000;
    while bench.host.device_us() < begin_us + for_ms * 1000 {
        bench.host.follow(channel, &[point(next_us, law(next_us))]).await.unwrap();
        next_us += every_ms * 1000;
        let idle_us = (next_us - ahead_ms * 1000).saturating_sub(bench.host.device_us());
        bench.clock.sleep(idle_us * US).await;
        while let Some(sample) = samples.try_next() {
            let Sample::Motor { position, .. } = sample.sample else { panic!("a motor") };
            seen.push((sample.device_us, f64::from(position) * resolution - law(sample.device_us)));
        }
    }
    seen
}

/// Ramp of 1.5 rad/s from `begin_us` on, after half a second of acceleration.
fn ramp(begin_us: u64, at_us: u64) -> f64 {
    let t = at_us.saturating_sub(begin_us) as f64 * 1e-6;
    1.5 * if t < 0.5 { t * t } else { t - 0.25 }
}

/// Arms, and waits for the motors' supply.
async fn armed(bench: &Bench<'_>) {
    bench.host.arm().await.unwrap();
    bench.sleep_ms(100).await;
}

async fn sample_of(bench: &Bench<'_>, channel: ChannelId) -> (Setpoint, bool) {
    let mut samples = bench.host.samples(channel, 5).await.unwrap();
    match samples.next().await.unwrap().sample {
        Sample::Motor { setpoint, settled, .. } => (setpoint, settled),
        other => panic!("a motor: {other:?}"),
    }
}

/// The remaining error after 5 s is that of the integral: its time constant is kp / ki = 2 s.
#[test]
fn a_motor_without_load_is_within_two_counts_of_its_path() {
    bench(&osmc_bench(), async |bench| {
        armed(bench).await;
        let begin_us = bench.host.device_us() + 50_000;
        let law = move |at_us| ramp(begin_us, at_us);
        let seen = streamed(bench, ROTARY, &law, [20, 50, 7000]).await;
        let late = seen.iter().filter(|(at_us, _)| *at_us > begin_us + 5_500_000).map(|(_, error)| error / COUNT_RAD);
        let worst = late.fold(0.0f64, |worst, counts| worst.max(counts.abs()));
        assert!(worst > 0.0 && worst <= 2.0, "{worst} counts");
    });
}

/// A path that ends at full speed comes to rest `v² / 2 a + v a / 2 j` further on, and is held there.
#[test]
fn a_path_that_ends_is_left_along_the_profile() {
    let robot = osmc_bench();
    let ProfileLimits { acceleration, jerk, .. } = robot.config.motors[0].control.unwrap().profile;
    let (acceleration, jerk) = (f64::from(acceleration), f64::from(jerk));
    bench(&robot, async |bench| {
        armed(bench).await;
        let begin_us = bench.host.device_us() + 50_000;
        let law = move |at_us| ramp(begin_us, at_us);
        streamed(bench, ROTARY, &law, [20, 50, 1000]).await;
        bench.sleep_ms(5000).await;
        let (setpoint, settled) = sample_of(bench, ROTARY).await;
        assert!(settled && setpoint.mode == Mode::Position, "{setpoint:?}");
        // the last point was one of every 20 ms, 50 ms ahead of the second's end, and the ramp started 50 ms after it
        let (earliest, latest) = (ramp(begin_us, begin_us + 970_000), ramp(begin_us, begin_us + 1_000_000));
        let stopping = 1.5 * 1.5 / (2.0 * acceleration) + 1.5 * acceleration / (2.0 * jerk);
        let end = f64::from(setpoint.value);
        assert!((earliest + stopping..=latest + stopping).contains(&end), "{end}: {earliest} {latest} {stopping}");
        assert!((bench.position(ROTARY) - end).abs() < SETTLE_RAD + COUNT_RAD);
    });
}

/// A late point stops the motor; the next path starts at its position.
#[test]
fn a_late_point_is_refused_and_stops_the_motor() {
    bench(&osmc_bench(), async |bench| {
        armed(bench).await;
        let begin_us = bench.host.device_us() + 50_000;
        let law = move |at_us| ramp(begin_us, at_us);
        streamed(bench, ROTARY, &law, [20, 50, 1000]).await;
        let late = bench.host.follow(ROTARY, &[point(bench.host.device_us() - 1000, 0.0)]).await;
        assert!(matches!(late, Err(Error::Refused(Refusal::Late { late_us: 1000.. }))), "{late:?}");
        bench.sleep_ms(500).await;
        let (setpoint, _) = sample_of(bench, ROTARY).await;
        assert_eq!(setpoint, Setpoint { mode: Mode::Speed, value: 0.0 });
        let stands = bench.position(ROTARY);
        bench.sleep_ms(500).await;
        assert!((bench.position(ROTARY) - stands).abs() < COUNT_RAD);
        let further = stands + 0.3;
        let end_us = bench.host.device_us() + 500_000;
        let rest = PathPoint { speed: Some(0.0), ..point(end_us, further) };
        bench.host.follow(ROTARY, &[rest]).await.unwrap();
        bench.sleep_ms(2500).await;
        assert!(
            (bench.position(ROTARY) - further).abs() < SETTLE_RAD + COUNT_RAD,
            "at {} rad, not at {further} rad",
            bench.position(ROTARY)
        );
    });
}

/// Both motors wait for the same date, independent of the arrival of their points, and start in the same period.
#[test]
fn several_channels_begin_in_the_same_period() {
    bench(&osmc_bench(), async |bench| {
        armed(bench).await;
        let places = [(ROTARY, 1.0), (LINEAR, 0.004)];
        let start_us = bench.host.device_us() + 300_000;
        for (channel, way) in places {
            let here = bench.position(channel);
            let rest = |at_us, position| PathPoint { speed: Some(0.0), ..point(at_us, position) };
            let points = [rest(start_us, here), rest(start_us + 1_000_000, here + way)];
            bench.host.follow(channel, &points).await.unwrap();
            bench.sleep_ms(70).await;
        }
        // the set point reported by a motor is that of its path
        let mut left_us = Vec::new();
        for (channel, _) in places {
            bench.host.subscribe(channel, 1).await.unwrap();
        }
        let mut stream = bench.host.telemetry();
        let mut before = std::collections::BTreeMap::new();
        bench.sleep_ms(500).await;
        while let Some(frame) = stream.try_next() {
            for sample in frame.samples {
                let Sample::Motor { channel, setpoint, .. } = sample else { continue };
                let way = places.iter().find(|(other, _)| *other == channel).map_or(0.0, |(_, way)| *way);
                let last = before.insert(channel, setpoint);
                // 1 ms after the start it has covered 3e-6 of the distance
                if let Some(last) = last
                    && frame.device_us >= start_us
                    && f64::from((last.value - setpoint.value).abs()) > 1e-6 * way
                    && !left_us.iter().any(|(other, _)| *other == channel)
                {
                    left_us.push((channel, frame.device_us));
                }
            }
        }
        let [(_, first_us), (_, second_us)] = left_us[..] else { panic!("{left_us:?}") };
        assert!(first_us.abs_diff(second_us) < 1000, "{left_us:?}");
        assert!((start_us..start_us + 3000).contains(&first_us), "{first_us}: {start_us}");
    });
}
