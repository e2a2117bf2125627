//! Telemetry of one link: its host's subscriptions and their times.

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Duration, Instant};
use heapless::Vec;
use r4_protocol::{ChannelId, Sample, Telemetry};

use crate::shared::{MotorStatus, ReportSide, Status};

#[derive(Clone, Copy)]
struct Subscription {
    channel: ChannelId,
    period: Duration,
    due: Instant,
}

/// Subscriptions of the host of one link.
#[derive(Default)]
pub(crate) struct Subscriptions {
    all: Vec<Subscription, MAX_SUBSCRIPTIONS>,
    /// Date of the last frame, ticks: no later frame is dated earlier.
    dated: u64,
}

/// Maximum number of subscriptions: every channel of a full board.
const MAX_SUBSCRIPTIONS: usize = 80;

impl Subscriptions {
    pub(crate) fn clear(&mut self) {
        self.all.clear();
    }

    /// Sets the period of `channel`; 0 ends its subscription.
    ///
    /// # Errors
    /// `()` when there is no room for another.
    pub(crate) fn set(&mut self, channel: ChannelId, period_ms: u16, now: Instant) -> Result<(), ()> {
        self.all.retain(|subscription| subscription.channel != channel);
        if period_ms == 0 {
            return Ok(());
        }
        let period = Duration::from_millis(period_ms.into());
        // All periods start on the same grid, so that channels of one rate share their frames.
        let due = Instant::from_ticks(now.as_ticks().next_multiple_of(period.as_ticks()));
        self.all.push(Subscription { channel, period, due }).map_err(|_| ())
    }

    /// Time of the next samples. A new subscription is answered, which makes the transmitter check this again.
    pub(crate) fn next_due(&self) -> Instant {
        self.all.iter().map(|subscription| subscription.due).min().unwrap_or(Instant::MAX)
    }

    /// Samples that are due now, if any: as many as a frame holds, and the rest with the next call.
    pub(crate) fn telemetry<M: RawMutex>(&mut self, shared: ReportSide<'_, M>) -> Option<Telemetry> {
        let now = Instant::now();
        let dated = Instant::from_ticks(shared.measured(now).as_ticks().max(self.dated));
        let mut samples = Vec::new();
        let mut skipped = 0;
        for subscription in self.all.iter_mut().filter(|subscription| subscription.due <= now) {
            if samples.push(sample(shared, subscription.channel, dated)?).is_err() {
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
        if !samples.is_empty() {
            self.dated = dated.as_ticks();
        }
        (!samples.is_empty()).then(|| Telemetry {
            device_us: dated.as_micros(),
            state: view.state,
            causes: view.causes,
            samples,
        })
    }
}

fn sample<M: RawMutex>(shared: ReportSide<'_, M>, channel: ChannelId, now: Instant) -> Option<Sample> {
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
        Status::Sensor { values, quality, taken } => {
            let age_ms = now.saturating_duration_since(taken).as_millis().min(u16::MAX.into()) as u16;
            Sample::Sensor { channel, values, age_ms, quality }
        }
    })
}

#[cfg(test)]
mod tests {
    extern crate std;

    use std::vec::Vec as List;

    use r4_protocol::{Cause, Causes, Mode, Quality, SafetyState, Setpoint, config::Place, message::MAX_SAMPLES};

    use super::*;
    use crate::{
        shared::ResetCause,
        testing::{Board, Tasks, board, robot},
    };

    const MS: Duration = Duration::from_millis(1);

    /// Board with every kind of channel, and its channels.
    fn full() -> (Board, List<(ChannelId, Place)>) {
        let board = board(robot("every-interface"), ResetCause::Normal);
        (board, board.config().channels().collect())
    }

    /// Channels of the samples that are due now.
    fn told(subscriptions: &mut Subscriptions, board: Board) -> List<ChannelId> {
        let telemetry = subscriptions.telemetry(board.report());
        let samples = telemetry.into_iter().flat_map(|telemetry| telemetry.samples);
        samples.map(|sample| sample.channel()).collect()
    }

    /// Channels subscribed at different times get samples at the same moments, from the shortest period to the longest.
    #[test]
    fn samples_come_on_one_grid_for_each_period() {
        let (board, channels) = full();
        let [(one, _), (other, _), ..] = channels[..] else { panic!("two channels at least") };
        for period_ms in [1, 10, 7, u16::MAX] {
            let (mut subscriptions, mut tasks) = (Subscriptions::default(), Tasks::default());
            let period = MS * period_ms.into();
            tasks.advance(Duration::from_micros(3));
            assert_eq!(subscriptions.next_due(), Instant::MAX);
            subscriptions.set(one, period_ms, Instant::now()).expect("room");
            let first = subscriptions.next_due();
            assert!(first >= Instant::now() && first < Instant::now() + period);
            assert_eq!(first.as_ticks() % period.as_ticks(), 0);
            assert_eq!(told(&mut subscriptions, board), []);
            tasks.advance_to(first);
            // The time is on the grid, so the sample is due at once.
            subscriptions.set(other, period_ms, Instant::now()).expect("room");
            for number in 0..5 {
                assert_eq!(subscriptions.next_due(), first + period * number);
                assert_eq!(told(&mut subscriptions, board), [one, other]);
                assert_eq!(told(&mut subscriptions, board), []);
                tasks.advance(period - Duration::from_micros(1));
                assert_eq!(told(&mut subscriptions, board), []);
                tasks.advance(Duration::from_micros(1));
            }
            assert_eq!(board.report().stats().telemetry_dropped, 0);
        }
    }

    /// A link that was busy gets the newest sample once; the missed ones are counted, for each channel.
    #[test]
    fn what_a_busy_link_missed_is_counted_and_not_made_up_for() {
        let (board, channels) = full();
        let (mut subscriptions, mut tasks) = (Subscriptions::default(), Tasks::default());
        for ((channel, _), period_ms) in channels.iter().zip([10, 10, 25]) {
            subscriptions.set(*channel, period_ms, Instant::now()).expect("room");
        }
        let begin = Instant::now();
        assert_eq!(told(&mut subscriptions, board).len(), 3);
        // Six samples of 10 ms and two of 25 ms are due: of each channel the newest is sent.
        tasks.advance(MS * 69);
        assert_eq!(told(&mut subscriptions, board).len(), 3);
        assert_eq!(board.report().stats().telemetry_dropped, 5 + 5 + 1);
        assert_eq!(subscriptions.next_due(), begin + MS * 70);
        tasks.advance(MS);
        assert_eq!(told(&mut subscriptions, board).len(), 2);
        tasks.advance(MS * 5);
        assert_eq!(told(&mut subscriptions, board), [channels[2].0]);
        assert_eq!(board.report().stats().telemetry_dropped, 11);
    }

    #[test]
    fn a_period_is_changed_and_ended_and_all_channels_find_room() {
        let (board, channels) = full();
        let (mut subscriptions, mut tasks) = (Subscriptions::default(), Tasks::default());
        let now = Instant::now();
        for (channel, _) in &channels {
            for period_ms in [100, 10] {
                subscriptions.set(*channel, period_ms, now).expect("room");
            }
        }
        let (last, rest) = channels.split_last().expect("some");
        subscriptions.set(last.0, 0, now).expect("an end needs no room");
        // As many as a message holds at a time, in the order of the subscriptions.
        let mut all = List::new();
        loop {
            match told(&mut subscriptions, board) {
                none if none.is_empty() => break,
                some => {
                    assert_eq!(some.len(), MAX_SAMPLES.min(rest.len() - all.len()));
                    all.extend(some);
                }
            }
        }
        assert_eq!(all, rest.iter().map(|(channel, _)| *channel).collect::<List<_>>());
        tasks.advance(MS * 10);
        assert_eq!(told(&mut subscriptions, board).len(), MAX_SAMPLES);
        subscriptions.clear();
        assert_eq!((subscriptions.next_due(), told(&mut subscriptions, board)), (Instant::MAX, List::new()));
        // Only a channel that no board has can be one too many.
        for number in 0..=MAX_SUBSCRIPTIONS {
            let channel = ChannelId { index: number as u8, ..last.0 };
            assert_eq!(subscriptions.set(channel, 10, now).is_ok(), number < MAX_SUBSCRIPTIONS);
        }
    }

    #[test]
    fn samples_say_what_their_channels_show() {
        let (board, channels) = full();
        let (mut subscriptions, mut tasks) = (Subscriptions::default(), Tasks::default());
        let motor = MotorStatus {
            setpoint: Setpoint { mode: Mode::Speed, value: 2.0 },
            position: -7,
            speed: 1.5,
            duty: 0.25,
            settled: true,
            homed: true,
            winding: None,
        };
        let taken = Instant::now();
        let reading = |value| Status::Reading { value, quality: Quality::Good, taken };
        let place = |wanted| channels.iter().find(|(_, place)| *place == wanted).expect("it has one").0;
        for (place, status) in [
            (Place::Motor(1), Status::Motor(motor)),
            (Place::Servo(0), Status::Scalar(0.5)),
            (Place::Encoder(0), Status::Encoder { position: 9, speed: -3.0, illegal: 4 }),
            (Place::Analog(0), reading(2.5)),
        ] {
            board.publish(place, status);
        }
        let [motor_id, servo, encoder, analog] =
            [Place::Motor(1), Place::Servo(0), Place::Encoder(0), Place::Analog(0)].map(place);
        for channel in [motor_id, servo, encoder, analog] {
            subscriptions.set(channel, 1, taken).expect("room");
        }
        board.trip(Cause::Stalled);
        // An age beyond the field's range is reported as the greatest value.
        for (age_ms, told_ms) in [(0, 0), (1, 1), (65_535, 65_535), (65_536, 65_535)] {
            tasks.advance_to(taken + MS * age_ms);
            let telemetry = subscriptions.telemetry(board.report()).expect("due");
            assert_eq!(telemetry.device_us, Instant::now().as_micros());
            assert_eq!((telemetry.state, telemetry.causes), (SafetyState::Tripped, Causes::only(Cause::Stalled)));
            let MotorStatus { setpoint, position, speed, duty, settled, homed, winding } = motor;
            assert_eq!(
                telemetry.samples[..],
                [
                    Sample::Motor { channel: motor_id, setpoint, position, speed, duty, settled, homed, winding },
                    Sample::Scalar { channel: servo, value: 0.5 },
                    Sample::Encoder { channel: encoder, position: 9, speed: -3.0, illegal: 4 },
                    Sample::Reading { channel: analog, value: 2.5, age_ms: told_ms, quality: Quality::Good },
                ]
            );
        }
    }
}
