//! Subscriptions of the clients, and the period at which the board has to be subscribed for them.

use std::collections::BTreeMap;

use r4_protocol::{ChannelId, Telemetry};

/// Period at which the board is subscribed to each channel, ms.
pub(crate) type Periods = BTreeMap<ChannelId, u16>;

/// Subscriptions of one client.
#[derive(Default)]
pub(crate) struct Subscriptions(Vec<Subscription>);

struct Subscription {
    channel: ChannelId,
    period_ms: u16,
    /// Time of the last sample that was sent to the client, on the board's clock, µs; `None` before the first.
    last_us: Option<u64>,
}

impl Subscriptions {
    /// Sets the period of a channel, ms; 0 ends the subscription. Returns the period before, 0 for none.
    pub(crate) fn set(&mut self, channel: ChannelId, period_ms: u16) -> u16 {
        let before = self.period_ms(channel);
        self.0.retain(|one| one.channel != channel);
        if period_ms > 0 {
            self.0.push(Subscription { channel, period_ms, last_us: None });
        }
        before
    }

    /// Returns the period of a channel, ms; 0 for none.
    pub(crate) fn period_ms(&self, channel: ChannelId) -> u16 {
        self.0.iter().find(|one| one.channel == channel).map_or(0, |one| one.period_ms)
    }

    pub(crate) fn channels(&self) -> impl Iterator<Item = ChannelId> {
        self.0.iter().map(|one| one.channel)
    }

    /// Returns the samples of a board's frame that are due for this client, `None` if none is. `periods` are those at
    /// which the board is subscribed.
    pub(crate) fn due(&mut self, frame: &Telemetry, periods: &Periods) -> Option<Telemetry> {
        let mut samples = frame.samples.clone();
        samples.retain(|sample| {
            let channel = sample.channel();
            let Some(wanted) = self.0.iter_mut().find(|one| one.channel == channel) else { return false };
            // The board samples at the common divisor of all clients' periods.
            let of_board_ms = periods.get(&channel).copied().unwrap_or(wanted.period_ms);
            // Samples come on a grid of the board's period with less than half a period of jitter.
            let due_us = |last_us: u64| last_us + u64::from(wanted.period_ms) * 1000 - u64::from(of_board_ms) * 500;
            let is_due = of_board_ms == wanted.period_ms
                || wanted.last_us.is_none_or(|last_us| frame.device_us >= due_us(last_us));
            if is_due {
                wanted.last_us = Some(frame.device_us);
            }
            is_due
        });
        (!samples.is_empty()).then(|| Telemetry { samples, ..frame.clone() })
    }
}

/// Returns the greatest common divisor of the periods `wanted`, ms, at which the board has to be subscribed; 0 for
/// none.
pub(crate) fn common_ms(wanted: impl Iterator<Item = u16>) -> u16 {
    wanted.fold(0, |mut a, mut b| {
        while b != 0 {
            (a, b) = (b, a % b);
        }
        a
    })
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use r4_protocol::{Causes, ChannelKind, SafetyState, Sample};

    use super::*;

    const CHANNEL: ChannelId = ChannelId::new(ChannelKind::Analog, 0);

    fn frame(device_us: u64) -> Telemetry {
        let samples = [Sample::Scalar { channel: CHANNEL, value: 0.0 }].into_iter().collect();
        Telemetry { device_us, state: SafetyState::Disarmed, causes: Causes::NONE, samples }
    }

    proptest! {
        /// Two clients of one channel with different periods, and frames that are late by up to 0.4 of the board's
        /// period.
        #[test]
        fn each_client_has_samples_of_its_own_period(
            periods in [1_u16..60, 1_u16..60],
            late in prop::collection::vec(0.0..0.4, 400),
        ) {
            let common = common_ms(periods.into_iter());
            prop_assert!(common > 0 && periods.iter().all(|period| period % common == 0));
            let board = Periods::from([(CHANNEL, common)]);
            for period in periods {
                let mut client = Subscriptions::default();
                prop_assert_eq!(client.set(CHANNEL, period), 0);
                let step = (period / common) as usize;
                for (number, late) in late.iter().enumerate() {
                    let date = (number as f64 + late) * f64::from(common) * 1000.0;
                    let due = client.due(&frame(date as u64), &board);
                    prop_assert_eq!(due.is_some(), number % step == 0, "{} of {}", number, step);
                }
            }
        }
    }

    #[test]
    fn channels_of_others_are_left_out() {
        let mut client = Subscriptions::default();
        let board = Periods::from([(CHANNEL, 10)]);
        assert_eq!(client.due(&frame(0), &board), None);
        client.set(CHANNEL, 10);
        assert_eq!(client.due(&frame(0), &board), Some(frame(0)));
        assert_eq!((client.set(CHANNEL, 0), client.period_ms(CHANNEL)), (10, 0));
        assert_eq!(client.due(&frame(10_000), &board), None);
        assert_eq!(common_ms(std::iter::empty()), 0);
    }
}
