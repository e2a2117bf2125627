//! Every interface of the board, from the host through the whole chain: the robot `every-interface`, which has all of them.

mod harness;

use std::{f64::consts::TAU, rc::Rc};

use harness::{Bench, bench, control_of};
use r4_boards::Robot;
use r4_driver::Board;
use r4_protocol::{Cause, Causes, ChannelId, ChannelKind, Mode, Quality, SafetyState, Sample};

fn every_interface() -> Robot {
    r4_boards::load("every-interface").expect("built in")
}

const fn channel(kind: ChannelKind, index: u8) -> ChannelId {
    ChannelId::new(kind, index)
}

/// The newest sample of a channel.
async fn sample(bench: &Bench<'_>, channel: ChannelId) -> Sample {
    let mut telemetry = bench.host.telemetry();
    bench.host.subscribe(channel, 5).await.expect("it has the channel");
    // The second one is younger than the subscription.
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
        // All of them at once: as many frames as that takes.
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
