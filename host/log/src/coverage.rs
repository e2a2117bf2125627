//! Completeness of a recording.

use std::collections::BTreeMap;

use r4_protocol::{ChannelId, Request};

use crate::{Gap, Log};

/// Completeness of one channel in a recording.
#[derive(Clone, Debug, PartialEq)]
pub struct Coverage {
    /// Channel that was recorded.
    pub channel: ChannelId,
    /// Number of samples in the recording.
    pub samples: usize,
    /// Mean rate, Hz; `None` for a single sample.
    pub rate_hz: Option<f64>,
    /// Longest time between two samples, s; `None` for a single sample.
    pub longest_gap_s: Option<f64>,
    /// Number of samples that were subscribed to and never came; `None` if the log holds no subscriptions of the
    /// channel.
    pub missing: Option<u64>,
}

impl Log {
    /// Returns the coverage of every channel with samples or with a subscription, in the header's order.
    #[must_use]
    pub fn coverage(&self) -> Vec<Coverage> {
        let mut subscriptions: BTreeMap<ChannelId, Vec<(f64, u16)>> = BTreeMap::new();
        for logged in &self.requests {
            if let Request::Subscribe { channel, period_ms } = logged.request {
                subscriptions.entry(channel).or_default().push((logged.time_s, period_ms));
            }
        }
        let end_s = self.time_span_s().map_or(0.0, |(_, end_s)| end_s);
        let channels = self.header.channels.iter().map(|info| info.id);
        channels
            .filter_map(|channel| {
                let times = self.sample_times(channel);
                let asked = subscriptions.get(&channel);
                if times.is_empty() && asked.is_none() {
                    return None;
                }
                let run_s = times.last().zip(times.first()).map_or(0.0, |(last, first)| last - first);
                let gaps = times.windows(2).map(|pair| pair[1] - pair[0]);
                Some(Coverage {
                    channel,
                    samples: times.len(),
                    rate_hz: (run_s > 0.0).then(|| (times.len() - 1) as f64 / run_s),
                    longest_gap_s: gaps.max_by(f64::total_cmp),
                    missing: asked.map(|asked| missing(asked, &times, &self.gaps, end_s)),
                })
            })
            .collect()
    }

    /// Returns the time of each sample of `channel`, s.
    fn sample_times(&self, channel: ChannelId) -> Vec<f64> {
        let mut times = Vec::new();
        times.extend(self.motor(channel).iter().flat_map(|series| &series.samples).map(|sample| sample.time_s));
        times.extend(self.encoder(channel).iter().flat_map(|series| &series.samples).map(|sample| sample.time_s));
        times.extend(self.sensor(channel).iter().flat_map(|series| &series.samples).map(|sample| sample.time_s));
        times.extend(self.reading(channel).iter().flat_map(|series| &series.samples).map(|sample| sample.time_s));
        times.extend(self.scalar(channel).iter().flat_map(|series| &series.samples).map(|sample| sample.0));
        times
    }
}

/// Counts the samples that should have come in each subscription's time and did not. A subscription ends with its
/// link. One sample less than fit is not missing: the first comes within a period of the subscription, and the last
/// may be on its way at the end. `asked` holds the start (s) and the period (ms) of each subscription.
fn missing(asked: &[(f64, u16)], times: &[f64], gaps: &[Gap], end_s: f64) -> u64 {
    let mut missing = 0;
    for (index, &(from_s, period_ms)) in asked.iter().enumerate() {
        if period_ms == 0 {
            continue;
        }
        let period_s = f64::from(period_ms) / 1000.0;
        let until_s = asked.get(index + 1).map_or(end_s, |next| next.0);
        // A subscription ends when its link is lost; the host subscribes again after it.
        let gap = gaps.iter().find(|gap| gap.time_s > from_s);
        let until_s = gap.map_or(until_s, |gap| until_s.min(gap.time_s - gap.without_link_s));
        let within = times.iter().copied().filter(|time_s| (from_s..=until_s).contains(time_s));
        let mut before_s = from_s;
        for time_s in within.chain([until_s]) {
            // As many periods as fit, less the one that ends at this sample; half a period of jitter is allowed.
            missing += ((time_s - before_s) / period_s - 0.5).floor().max(0.0) as u64;
            before_s = time_s;
        }
    }
    missing
}
