//! One link to a host: frames in, answers and telemetry out.

use embassy_futures::select::{Either, select};
use embassy_sync::{
    blocking_mutex::{Mutex, raw::NoopRawMutex, raw::RawMutex},
    channel::Channel,
};
use embassy_time::{Duration, Instant, Timer};
use embedded_io_async::{Read, Write};
use heapless::Vec;
use r4_protocol::{
    ChannelId, FrameDecoder, Sample, Telemetry, ToDevice, ToHost, encode_frame, frame::MAX_FRAME, message::MAX_SAMPLES,
};

use crate::{dispatch::dispatch, shared::Shared};

/// Answers waiting for the transmitter; a host that asks faster than its link carries is held back by the link itself.
const ANSWERS: usize = 4;

/// How often a link looks whether the board has started.
const START_POLL: Duration = Duration::from_millis(1);

/// Serves one link until it fails. `number` tells the links of a board apart.
///
/// Waits for the outputs to be in a known state before it takes the first message.
pub async fn serve<M: RawMutex, R: Read, W: Write>(shared: &Shared<M>, number: u8, rx: R, tx: W) {
    while !shared.has_started() {
        Timer::after(START_POLL).await;
    }
    let answers: Channel<NoopRawMutex, ToHost, ANSWERS> = Channel::new();
    let subscriptions: Mutex<NoopRawMutex, _> = Mutex::new(core::cell::RefCell::new(Subscriptions::default()));
    let receive = receive(shared, number, rx, &answers, &subscriptions);
    let transmit = transmit(shared, tx, &answers, &subscriptions);
    // Either end failing ends the link; the supervisor then misses its heartbeat.
    select(receive, transmit).await;
}

type SharedSubscriptions = Mutex<NoopRawMutex, core::cell::RefCell<Subscriptions>>;

async fn receive<M: RawMutex, R: Read>(
    shared: &Shared<M>,
    number: u8,
    mut rx: R,
    answers: &Channel<NoopRawMutex, ToHost, ANSWERS>,
    subscriptions: &SharedSubscriptions,
) {
    let mut decoder = FrameDecoder::new();
    let mut buffer = [0; 64];
    while let Ok(len @ 1..) = rx.read(&mut buffer).await {
        for byte in &buffer[..len] {
            let Some(frame) = decoder.push::<ToDevice>(*byte) else { continue };
            shared.count(|stats| match frame {
                Ok(_) => stats.frames = stats.frames.wrapping_add(1),
                Err(_) => stats.bad_frames = stats.bad_frames.wrapping_add(1),
            });
            let Ok(message) = frame else { continue };
            let answer = subscriptions.lock(|s| dispatch(shared, number, &mut s.borrow_mut(), message));
            if let Some(answer) = answer {
                answers.send(answer).await;
            }
        }
    }
}

async fn transmit<M: RawMutex, W: Write>(
    shared: &Shared<M>,
    mut tx: W,
    answers: &Channel<NoopRawMutex, ToHost, ANSWERS>,
    subscriptions: &SharedSubscriptions,
) {
    let mut buffer = [0; MAX_FRAME];
    // Ends whatever half a frame the host may still hold from before.
    if tx.write_all(&[0]).await.is_err() {
        return;
    }
    loop {
        let due = subscriptions.lock(|s| s.borrow().next_due());
        let message = match select(answers.receive(), Timer::at(due)).await {
            Either::First(answer) => Some(answer),
            Either::Second(()) => subscriptions.lock(|s| s.borrow_mut().telemetry(shared)).map(ToHost::Telemetry),
        };
        // Every message fits: a test encodes the largest of each kind.
        let Some(Ok(frame)) = message.map(|message| encode_frame(&message, &mut buffer)) else { continue };
        if tx.write_all(frame).await.is_err() {
            return;
        }
    }
}

#[derive(Clone, Copy)]
struct Subscription {
    channel: ChannelId,
    period: Duration,
    due: Instant,
}

/// What the host of one link wants to be told, and when.
#[derive(Default)]
pub(crate) struct Subscriptions(Vec<Subscription, MAX_SAMPLES>);

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
    fn next_due(&self) -> Instant {
        self.0.iter().map(|subscription| subscription.due).min().unwrap_or(Instant::MAX)
    }

    /// The samples that are due now, if any.
    fn telemetry<M: RawMutex>(&mut self, shared: &Shared<M>) -> Option<Telemetry> {
        let now = Instant::now();
        let mut samples = Vec::new();
        let mut skipped = 0;
        for subscription in self.0.iter_mut().filter(|subscription| subscription.due <= now) {
            // As many samples as subscriptions: there is room.
            let _ = samples.push(sample(shared, subscription.channel)?);
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

fn sample<M: RawMutex>(shared: &Shared<M>, channel: ChannelId) -> Option<Sample> {
    if let Some(index) = shared.motor_index(channel) {
        let status = shared.motor(index);
        return Some(Sample::Motor {
            channel,
            setpoint: status.setpoint,
            position: status.position,
            speed: status.speed,
            duty: status.duty,
            settled: status.settled,
        });
    }
    shared.supply_index(channel).map(|index| Sample::Scalar { channel, value: shared.supply_v(index) })
}
