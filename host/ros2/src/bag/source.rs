//! Conversion of a log to the messages that the node would have published, in the order of time.

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

/// Period of diagnostics while nothing changes, µs of the log: that of the node.
const DIAGNOSE_EVERY_US: u64 = 1_000_000;
/// Heat above which a board warns of a winding, and below which the warning ends, as shares of the winding's thermal limit. The
/// thresholds are those of [`Winding::hot`], which a log does not contain.
const HOT_FROM: f64 = 0.90;
const HOT_UNTIL: f64 = 0.85;

/// Entry of a log. At the same time, entries are in the order of the variants.
enum Item {
    /// The link is back after a gap.
    Back {
        restarted: bool,
    },
    State(SafetyState, Causes),
    Sample(Sample),
}

/// Passes the messages of a log to `give`, with their times. A board in real time has stamps in wall-clock time. A virtual board has its
/// own clock, which starts at the date of the recording, as in the node.
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
                // Samples with the same time form a frame; a second sample of a channel starts another one.
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

/// Returns the ROS time at time 0 of the log.
fn begin(log: &Log) -> Stamp {
    let Some(recorded) = &log.header.recorded else { return Stamp::default() };
    let unix_ns = i64::try_from(recorded.unix_ns).unwrap_or(i64::MAX);
    Stamp::from_ns(recorded.clock_offset_ns.unwrap_or(unix_ns))
}

/// Updates the list of hot windings by a sample, and returns true when a winding was added or removed.
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

/// Returns the entries of a log with their times, µs, sorted by time.
fn items(log: &Log) -> Vec<(u64, Item)> {
    // A log has the board's whole microseconds as seconds in double precision. Rounding restores them: 2^53 µs are 285 years.
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
    // A board sends the samples of a frame in the order of its channels.
    for info in &log.header.channels {
        let of_channel = samples.remove(&info.id).unwrap_or_default();
        items.extend(of_channel.into_iter().map(|(time_s, sample)| (us(time_s), Item::Sample(sample))));
    }
    // The sort is stable: entries with the same time keep the order above.
    items.sort_by_key(|(at_us, _)| *at_us);
    items
}
