//! What the host of one link wants to be told, and when.

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Duration, Instant};
use heapless::Vec;
use r4_protocol::{ChannelId, Sample, Telemetry};

use crate::shared::{MotorStatus, Shared, Status};

#[derive(Clone, Copy)]
struct Subscription {
    channel: ChannelId,
    period: Duration,
    due: Instant,
}

/// What the host of one link wants to be told, and when.
#[derive(Default)]
pub(crate) struct Subscriptions(Vec<Subscription, MAX_SUBSCRIPTIONS>);

/// Every channel of a full board can be subscribed to.
const MAX_SUBSCRIPTIONS: usize = 80;

impl Subscriptions {
    pub(crate) fn clear(&mut self) {
        self.0.clear();
    }

    /// Sets the period of `channel`; 0 ends it.
    ///
    /// # Errors
    /// `()` when there is no room for another.
    pub(crate) fn set(&mut self, channel: ChannelId, period_ms: u16, now: Instant) -> Result<(), ()> {
        self.0.retain(|subscription| subscription.channel != channel);
        if period_ms == 0 {
            return Ok(());
        }
        let period = Duration::from_millis(period_ms.into());
        // All periods start on the same grid, so that channels of one rate share their frames.
        let due = Instant::from_ticks(now.as_ticks().next_multiple_of(period.as_ticks()));
        self.0.push(Subscription { channel, period, due }).map_err(|_| ())
    }

    /// When the next samples are due. A new subscription is answered, which makes the transmitter look again.
    pub(crate) fn next_due(&self) -> Instant {
        self.0.iter().map(|subscription| subscription.due).min().unwrap_or(Instant::MAX)
    }

    /// The samples that are due now, if any; as many as a frame holds, and the rest with the next call.
    pub(crate) fn telemetry<M: RawMutex>(&mut self, shared: &Shared<M>) -> Option<Telemetry> {
        let now = Instant::now();
        let mut samples = Vec::new();
        let mut skipped = 0;
        for subscription in self.0.iter_mut().filter(|subscription| subscription.due <= now) {
            if samples.push(sample(shared, subscription.channel, now)?).is_err() {
                break;
            }
            let behind = (now - subscription.due).as_ticks() / subscription.period.as_ticks();
            skipped += behind as u32;
            subscription.due += subscription.period * (behind as u32 + 1);
        }
        if skipped > 0 {
            shared.count(|stats| stats.telemetry_dropped = stats.telemetry_dropped.wrapping_add(skipped));
        }
        let view = shared.safety();
        (!samples.is_empty()).then(|| Telemetry {
            device_us: now.as_micros(),
            state: view.state,
            causes: view.causes,
            samples,
        })
    }
}

fn sample<M: RawMutex>(shared: &Shared<M>, channel: ChannelId, now: Instant) -> Option<Sample> {
    let place = shared.config().place(channel)?;
    Some(match shared.status(place) {
        Status::Motor(MotorStatus { setpoint, position, speed, duty, settled, homed, winding }) => {
            Sample::Motor { channel, setpoint, position, speed, duty, settled, homed, winding }
        }
        Status::Scalar(value) => Sample::Scalar { channel, value },
        Status::Encoder { position, speed, illegal } => Sample::Encoder { channel, position, speed, illegal },
        Status::Reading { value, quality, taken } => {
            let age_ms = now.saturating_duration_since(taken).as_millis().min(u16::MAX.into()) as u16;
            Sample::Reading { channel, value, age_ms, quality }
        }
    })
}
