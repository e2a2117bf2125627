//! A log as the messages that the node would have published, in the order of time.

use std::collections::BTreeMap;

use r4_log::Log;
use r4_protocol::{Causes, ChannelId, HotWinding, SafetyState, Sample, Setpoint, Winding, channel::MAX_QUANTITIES};
use r4_rig::GroundDrive;

use crate::{
    Report,
    diagnose::{self, Health},
    frames::Frames,
    message::Text,
    time::Stamp,
};

/// Diagnostics are given so often where nothing changes, µs of the log: as the node does.
const DIAGNOSE_EVERY_US: u64 = 1_000_000;
/// Heat at which a board begins to warn of a winding, and at which it ends, shares of what the winding withstands: those of
/// [`Winding::hot`], which a log does not have.
const HOT_FROM: f64 = 0.90;
const HOT_UNTIL: f64 = 0.85;

/// Something of a log at one moment. Their order is that of things at the same moment.
enum Item {
    /// The link is back.
    Back {
        restarted: bool,
    },
    State(SafetyState, Causes),
    Sample(Sample),
}

/// Gives the messages of a log with their times. Stamps of a board in real time are its log's wall-clock times; those of a virtual board
/// are the board's time from the date of the recording on, as the node counts it.
pub(super) fn reports(log: &Log, drive: Option<&GroundDrive>, mut give: impl FnMut(Stamp, Report)) {
    let mut frames = Frames::new(&log.header.channels, drive, true);
    let mut health = Health {
        robot: log.header.robot.clone(),
        board: log.header.board.clone(),
        firmware: log.header.firmware.clone(),
        state: SafetyState::Disarmed,
        causes: Causes::NONE,
        hot: Vec::new(),
        node: None,
    };
    let begin = begin(log);
    let mut is_known = false;
    let mut diagnose_us = 0;
    let mut items = items(log).into_iter().peekable();
    while let Some((at_us, item)) = items.next() {
        let stamp = begin.plus_us(at_us.cast_signed());
        let mut has_changed = false;
        match item {
            Item::Back { restarted: true } => frames.restarted(),
            Item::Back { restarted: false } => {}
            Item::State(state, causes) => {
                (health.state, health.causes, is_known, has_changed) = (state, causes, true, true);
                give(stamp, Report::State(Text { data: diagnose::state(state, causes) }));
            }
            Item::Sample(first) => {
                let mut samples = vec![first];
                // A second sample of a channel at this moment is of another frame.
                while let Some((_, Item::Sample(next))) = items.next_if(|(next_us, item)| {
                    let is_new = |next: &Sample| samples.iter().all(|sample| sample.channel() != next.channel());
                    *next_us == at_us && matches!(item, Item::Sample(next) if is_new(next))
                }) {
                    samples.push(next);
                }
                for sample in &samples {
                    has_changed |= note_heat(&mut health.hot, sample);
                }
                frames.convert(stamp, at_us, &samples, |report| give(stamp, report));
            }
        }
        if is_known && (has_changed || at_us >= diagnose_us) {
            diagnose_us = at_us + DIAGNOSE_EVERY_US;
            give(stamp, Report::Diagnostics(health.diagnostics(stamp.to_time())));
        }
    }
}

/// ROS time at 0 of the log's times.
fn begin(log: &Log) -> Stamp {
    let Some(recorded) = &log.header.recorded else { return Stamp::default() };
    let unix_ns = i64::try_from(recorded.unix_ns).unwrap_or(i64::MAX);
    Stamp::from_ns(recorded.clock_offset_ns.unwrap_or(unix_ns))
}

/// Updates the list of hot windings by a sample; whether one became hot or is no longer.
fn note_heat(hot: &mut Vec<HotWinding>, sample: &Sample) -> bool {
    let Sample::Motor { channel, winding: Some(Winding { heat_percent, .. }), .. } = *sample else { return false };
    let heat = f64::from(heat_percent) / 100.0;
    let known = hot.iter().position(|winding| winding.channel == channel);
    match known {
        None if heat > HOT_FROM => hot.push(HotWinding { channel, heat_percent }),
        Some(at) if heat < HOT_UNTIL => drop(hot.remove(at)),
        Some(at) => {
            hot[at].heat_percent = heat_percent;
            return false;
        }
        None => return false,
    }
    true
}

fn items(log: &Log) -> Vec<(u64, Item)> {
    // The board counts whole microseconds, and a log has them in s: 2^53 µs are 285 years.
    let us = |time_s: f64| (time_s * 1e6).round() as u64;
    let mut items: Vec<(u64, Item)> = Vec::new();
    items.extend(log.gaps.iter().map(|gap| (us(gap.time_s), Item::Back { restarted: gap.restarted })));
    items.extend(log.states.iter().map(|change| (us(change.time_s), Item::State(change.state, change.causes))));
    let mut samples: BTreeMap<ChannelId, Vec<(f64, Sample)>> = BTreeMap::new();
    for series in &log.motors {
        let channel = series.info.id;
        samples.entry(channel).or_default().extend(series.samples.iter().map(|sample| {
            let setpoint = Setpoint { mode: sample.setpoint.mode, value: sample.setpoint.value as f32 };
            let heat_percent = (sample.winding_heat * 100.0).round() as u8;
            let winding = sample.winding_heat.is_finite().then_some(Winding { heat_percent, hot: false });
            let (speed, duty) = (sample.speed as f32, sample.duty as f32);
            let (position, settled, homed) = (sample.position_counts, sample.settled, sample.homed);
            (sample.time_s, Sample::Motor { channel, setpoint, position, speed, duty, settled, homed, winding })
        }));
    }
    for series in &log.encoders {
        let channel = series.info.id;
        samples.entry(channel).or_default().extend(series.samples.iter().map(|sample| {
            let (position, speed, illegal) = (sample.position_counts, sample.speed as f32, sample.illegal);
            (sample.time_s, Sample::Encoder { channel, position, speed, illegal })
        }));
    }
    for series in &log.readings {
        let channel = series.info.id;
        samples.entry(channel).or_default().extend(series.samples.iter().map(|sample| {
            let (value, age_ms, quality) = (sample.value as f32, sample.age_ms, sample.quality);
            (sample.time_s, Sample::Reading { channel, value, age_ms, quality })
        }));
    }
    for series in &log.sensors {
        let channel = series.info.id;
        samples.entry(channel).or_default().extend(series.samples.iter().map(|sample| {
            let mut values = [0.0; MAX_QUANTITIES];
            values.iter_mut().zip(&sample.values).for_each(|(to, from)| *to = *from as f32);
            (sample.time_s, Sample::Sensor { channel, values, age_ms: sample.age_ms, quality: sample.quality })
        }));
    }
    for series in &log.scalars {
        let channel = series.info.id;
        samples.entry(channel).or_default().extend(
            series.samples.iter().map(|(time_s, value)| (*time_s, Sample::Scalar { channel, value: *value as f32 })),
        );
    }
    // In the order of the board's channels, which is that of its frames.
    for info in &log.header.channels {
        let of_channel = samples.remove(&info.id).unwrap_or_default();
        items.extend(of_channel.into_iter().map(|(time_s, sample)| (us(time_s), Item::Sample(sample))));
    }
    // Stable: things of one moment stay in that order.
    items.sort_by_key(|(at_us, _)| *at_us);
    items
}
